"""What `optimise` needs of rockjax beyond its public face, in one place. Not for users: it changes without notice."""

from ._boundaries.boundaries import boundaries
from ._boundaries.boundary import BOUNDARY
from ._boundaries.verdict import NARROWEST, has_margin
from ._checks import as_float, concrete, of_kind, require, shown, single, whole
from ._files import as_json, write_figure, write_whole
from ._motions.convert import AnyMotion, AnyMotions, as_excitation, as_pulse, several
from ._problem import Reader, load_table
from ._problem_keys import POSITIVE, TEXT, TRUTH, Kind
from ._problem_keys import whole as whole_number
from ._progress import bar
from ._repr import readable
from ._responses.datasets import describe_options
from ._studies.lognormal import fit_capacities
from ._tables import html, lines

__all__ = [
    "BOUNDARY",
    "NARROWEST",
    "POSITIVE",
    "TEXT",
    "TRUTH",
    "AnyMotion",
    "AnyMotions",
    "Kind",
    "Reader",
    "as_excitation",
    "as_float",
    "as_json",
    "as_pulse",
    "bar",
    "boundaries",
    "concrete",
    "describe_options",
    "fit_capacities",
    "has_margin",
    "html",
    "lines",
    "load_table",
    "of_kind",
    "readable",
    "require",
    "several",
    "shown",
    "single",
    "whole",
    "whole_number",
    "write_figure",
    "write_whole",
]
