"""Names that `optimise` uses beyond the public face. Not for users: they change without notice."""

from ._boundaries.boundary import BOUNDARY
from ._boundaries.crossings import scan
from ._boundaries.margin import DEFAULT_WIDTH
from ._checks import (
    array_module,
    as_array,
    as_float,
    concrete,
    format_value,
    require,
    require_instance,
    require_number,
    require_whole,
)
from ._excitations.pulses import PULSES
from ._files import as_json, write_atomically, write_figure
from ._lognormal import fit_capacities
from ._motions.convert import AnyMotion, AnyMotions, as_excitation, as_motions, as_pulse, single_motions
from ._motions.intensity import measure_by_label
from ._options import PEAKS
from ._parameters.table import (
    DIMENSIONS,
    ROWS_OF_DIMENSIONS,
    STRUCTURE,
    Parameter,
    find_clash,
    motion_parameter,
    numbered_parameter,
    variable_attributes,
)
from ._parameters.variants import find_parameter, has_parameter, parameters_of, read, with_values
from ._problem import models
from ._problem.models import key as problem_key
from ._problem.reading import Reader, load_table, pulse_periods
from ._programs.key import TracedFunction
from ._programs.program import KeptProgram
from ._progress import bar
from ._responses.datasets import describe_options
from ._responses.peak import UNTIL_OVERTURNING, AbstractPeak
from ._restrainers.damper import as_exponent
from ._risk.rays import Rays, probability_at, sample_rays, solve_factor
from ._risk.rocking import limit_state
from ._risk.structure import parse_limit, records_from_samples
from ._text.cards import card, format_call
from ._text.tables import align_rows, html
from ._tree import Module
from ._units import MM_PER_M, STANDARD_GRAVITY, displayed

__all__ = [
    "BOUNDARY",
    "DEFAULT_WIDTH",
    "DIMENSIONS",
    "MM_PER_M",
    "PEAKS",
    "PULSES",
    "ROWS_OF_DIMENSIONS",
    "STANDARD_GRAVITY",
    "STRUCTURE",
    "UNTIL_OVERTURNING",
    "AbstractPeak",
    "AnyMotion",
    "AnyMotions",
    "KeptProgram",
    "Module",
    "Parameter",
    "Rays",
    "Reader",
    "TracedFunction",
    "align_rows",
    "array_module",
    "as_array",
    "as_excitation",
    "as_exponent",
    "as_float",
    "as_json",
    "as_motions",
    "as_pulse",
    "bar",
    "card",
    "concrete",
    "describe_options",
    "displayed",
    "find_clash",
    "find_parameter",
    "fit_capacities",
    "format_call",
    "format_value",
    "has_parameter",
    "html",
    "limit_state",
    "load_table",
    "measure_by_label",
    "models",
    "motion_parameter",
    "numbered_parameter",
    "parameters_of",
    "parse_limit",
    "probability_at",
    "problem_key",
    "pulse_periods",
    "read",
    "records_from_samples",
    "require",
    "require_instance",
    "require_number",
    "require_whole",
    "sample_rays",
    "scan",
    "single_motions",
    "solve_factor",
    "variable_attributes",
    "with_values",
    "write_atomically",
    "write_figure",
]
