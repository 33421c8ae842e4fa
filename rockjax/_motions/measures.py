"""Intensity measures of motions in any form."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from rockjax._structures import Podium

from . import intensity
from .convert import AnyMotions, as_motions
from .motion import Motion
from .record import Record

if TYPE_CHECKING:
    import xarray


def intensity_measures(
    motion: AnyMotions,
    *,
    periods: Iterable[float] = (0.1, 0.2, 0.5, 1.0, 2.0),
    damping: float = 0.05,
    podium: Podium | None = None,
) -> xarray.Dataset:
    """Return intensity measures of one or several motions, as an `xarray.Dataset` with units.

    - `motion`: motions with samples. A [`rockjax.Motion`][] or [`rockjax.Record`][] gives scalars;
      [`rockjax.Motions`][], [`rockjax.Records`][] or a list of motions give arrays with the dimension
      `motion`. Of a motion with a vertical component, the horizontal component is measured
    - `periods`: periods T of Sa(T), ≥ 0 [s]
    - `damping`: damping ratio of Sa, 0 ≤ ζ < 1 [–]
    - `podium`: podium for two additional dimensionless measures (Dimitrakopoulos & Paraskeva 2015), or None:
      `acceleration_ratio` PGA/(g tan α) and `velocity_ratio` p·PGV/(g tan α), with the slenderness α and the
      frequency parameter p of the podium. Under a horizontal motion, a rigid podium at rest lifts only if the
      acceleration ratio exceeds 1

    Variables: `dt`, `duration` [s], `PGA` [m/s²], `PGV` [m/s], `PGD` [m], `PGV_PGA` [s] (NaN for a PGA of
    zero), `arias_intensity` π/(2g)∫ü_g² dt [m/s], `CAV` ∫|ü_g| dt [m/s], `D5_95` [s], `scale` (scale factor
    relative to the file) [–], and the pseudo-acceleration `Sa` [m/s²] along `period`. `D5_95` is the time in
    which the Arias intensity grows from 5 % to 95 % of the final value; between samples, the growth is taken
    to be linear.

    Raises `ValueError` for motions without samples, for periods and damping outside their ranges, and for a
    podium with arrays of parameters.
    """
    motions = as_motions("intensity_measures", motion)
    motion_or_list = motions[0] if isinstance(motion, Motion | Record) else motions
    return intensity.intensity_measures(motion_or_list, periods=periods, damping=damping, podium=podium)
