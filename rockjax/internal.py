"""Private names of rockjax that several modules of the package `optimise` use.

Other private names are imported from the modules that define them. Private names may change without notice.
"""

from ._boundaries.margin import DEFAULT_WIDTH
from ._checks import (
    array_module,
    as_float,
    concrete,
    format_value,
    require_instance,
    require_number,
    require_whole,
)
from ._lognormal import fit_capacities
from ._motions.convert import AnyMotion, AnyMotions, as_excitation, single_motions
from ._parameters.registry import DIMENSIONS
from ._parameters.variants import find_parameter, parameters_of, read, with_values
from ._tree import Module
from ._units import displayed

__all__ = [
    "DEFAULT_WIDTH",
    "DIMENSIONS",
    "AnyMotion",
    "AnyMotions",
    "Module",
    "array_module",
    "as_excitation",
    "as_float",
    "concrete",
    "displayed",
    "find_parameter",
    "fit_capacities",
    "format_value",
    "parameters_of",
    "read",
    "require_instance",
    "require_number",
    "require_whole",
    "single_motions",
    "with_values",
]
