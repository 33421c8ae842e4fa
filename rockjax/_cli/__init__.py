"""The command line. Commands import slow packages only when they run, so that help appears at once."""

from ._app import app, main
from ._cache import cache
from ._design import design
from ._ensemble import ensemble
from ._floors import floors
from ._fragility import fragility
from ._motions import motions, synthetic
from ._overturning import overturning
from ._peaks import peaks
from ._plot import plot
from ._report import report
from ._response import response
from ._risk import risk
from ._schema import schema
from ._spectrum import spectrum
from ._sweep import sweep

for _function in (
    spectrum,
    overturning,
    response,
    peaks,
    floors,
    ensemble,
    fragility,
    risk,
    report,
    design,
    sweep,
    motions,
    synthetic,
    plot,
    schema,
    cache,
):
    app.command()(_function)

__all__ = ["app", "main"]
