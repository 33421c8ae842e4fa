"""What `optimise` needs of rockjax beyond its public face, in one place. Not for users: it changes without notice."""

from ._boundaries.boundaries import boundaries
from ._boundaries.boundary import BOUNDARY
from ._boundaries.verdict import has_margin
from ._checks import concrete, require
from ._files import as_json, write_figure, write_whole
from ._problem import Reader, load_table
from ._problem_keys import POSITIVE, TEXT, TRUTH, Kind, whole
from ._progress import bar
from ._repr import readable
from ._responses.datasets import describe_options
from ._studies.lognormal import fit_capacities
from ._tables import html, lines

__all__ = [
    "BOUNDARY",
    "POSITIVE",
    "TEXT",
    "TRUTH",
    "Kind",
    "Reader",
    "as_json",
    "bar",
    "boundaries",
    "concrete",
    "describe_options",
    "fit_capacities",
    "has_margin",
    "html",
    "lines",
    "load_table",
    "readable",
    "require",
    "whole",
    "write_figure",
    "write_whole",
]
