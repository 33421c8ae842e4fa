"""Intensity measures of motions in any form: the public function `intensity_measures`."""

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
      `motion`. If a motion has a vertical component, the measures describe the horizontal one
    - `periods`: periods T of Sa(T), ≥ 0 [s]
    - `damping`: damping ratio of Sa, 0 ≤ ζ < 1 [–]
    - `podium`: podium for two additional measures (Dimitrakopoulos & Paraskeva 2015), or None

    The dataset has these variables:

    - `dt`, `duration`: sampling interval, and time from the first to the last sample [s]
    - `PGA`, `PGV`, `PGD`: peak ground acceleration [m/s²], velocity [m/s] and displacement [m]
    - `PGV_PGA`: PGV/PGA [s]; NaN for a PGA of zero
    - `arias_intensity`: π/(2g) ∫ü_g² dt [m/s], with the ground acceleration ü_g
    - `CAV`: cumulative absolute velocity ∫|ü_g| dt [m/s]
    - `D5_95`: significant duration, in which the Arias intensity grows from 5 % to 95 % of its final value
      [s]. Between samples, the growth is assumed to be linear
    - `scale`: scale factor relative to the file [–]
    - `Sa`: pseudo-spectral acceleration along the dimension `period` [m/s²]
    - `acceleration_ratio`, `velocity_ratio`: PGA/(g tan α) and p PGV/(g tan α) [–], with slenderness α and
      frequency parameter p of the podium. If a podium at rest has a rigid superstructure or none, a
      horizontal motion lifts its columns only if the acceleration ratio exceeds 1

    Raises `ValueError` for motions without samples, for periods and damping outside their ranges, and for a
    podium with arrays of parameters.
    """
    motions = as_motions("intensity_measures", motion)
    motion_or_list = motions[0] if isinstance(motion, Motion | Record) else motions
    return intensity.intensity_measures(motion_or_list, periods, damping, podium)
