"""Intensity measures of ground motions.

The measures are exact for motions that are linear between samples, with one exception: the significant
duration interpolates the Arias intensity linearly between samples. The pseudo-spectral acceleration Sa is a
maximum over all times, whereas the packages eqsig and pyRotd take the maximum over the samples. ü_g is the
ground acceleration.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from rockjax._checks import as_float, require, require_instance, require_number
from rockjax._files import CONVENTIONS
from rockjax._oscillators import ground_load, largest
from rockjax._parameters.registry import as_variable
from rockjax._structures import Podium, g_tan_alpha
from rockjax._units import STANDARD_GRAVITY

from .accelerogram import Accelerogram

if TYPE_CHECKING:
    import xarray


def energy(motion: Accelerogram) -> np.ndarray:
    """Return ∫ü_g² dt from the first sample to each sample, shape (n,) [m²/s³]."""
    a, b = motion.acceleration[:-1], motion.acceleration[1:]
    return np.concatenate([[0.0], np.cumsum(motion.dt / 3 * (a * a + a * b + b * b))])


def arias_intensity(motion: Accelerogram) -> float:
    """Return π/(2g) ∫ü_g² dt (Arias 1970) [m/s]."""
    return float(math.pi / (2 * STANDARD_GRAVITY) * energy(motion)[-1])


def cumulative_absolute_velocity(motion: Accelerogram) -> float:
    """Return ∫|ü_g| dt [m/s]."""
    a, b = np.abs(motion.acceleration[:-1]), np.abs(motion.acceleration[1:])
    divisor = np.where(a + b > 0, a + b, 1.0)
    crosses_zero = motion.acceleration[:-1] * motion.acceleration[1:] < 0
    return float(0.5 * motion.dt * np.sum(np.where(crosses_zero, (a * a + b * b) / divisor, a + b)))


def significant_duration(motion: Accelerogram) -> float:
    """Return the time in which the Arias intensity grows from 5 % to 95 % of its final value (Trifunac &
    Brady 1975) [s]; 0 for a motion that is zero throughout. Between samples, the intensity is interpolated
    linearly."""
    cumulative_energy = energy(motion)
    if cumulative_energy[-1] == 0:
        return 0.0
    levels = [0.05 * cumulative_energy[-1], 0.95 * cumulative_energy[-1]]
    start, end = np.interp(levels, cumulative_energy, motion.time)
    return float(end - start)


def spectral_acceleration(motion: Accelerogram, period: float, damping: float = 0.05) -> float:
    """Return the pseudo-spectral acceleration Sa(T) = ω² max|u| [m/s²] of a linear oscillator that is
    initially at rest. u is its displacement relative to the ground, ω = 2π/T, and T ≥ 0 the `period` [s]; 0
    gives PGA. The damping ratio is in [0, 1).

    The maximum is exact for a motion that is linear between samples and zero after the last sample. The
    maximum may occur between samples, or during the free vibration after the motion.
    """
    return float(spectral_accelerations(motion, np.array([period]), damping)[0])


def spectral_accelerations(motion: Accelerogram, periods: np.ndarray, damping: float) -> np.ndarray:
    """Return Sa [m/s²] at each of the `periods` [s], both of shape (n,). The arguments have the ranges of
    `spectral_acceleration`."""
    accelerations, is_positive = np.full(periods.shape, motion.pga), periods > 0
    if is_positive.any():
        T = periods[is_positive]
        load, zeta = ground_load(motion.acceleration, motion.dt), np.full(T.shape, damping)
        peaks = largest(load, T, zeta, rests=True, responses=("displacement",))
        accelerations[is_positive] = (2 * math.pi / T) ** 2 * peaks.values[0]
    return accelerations


def measure_motion(
    owner: str, motion: Accelerogram, measure: str, period: float | None, damping: float
) -> tuple[float, int]:
    """Return the value of an intensity measure in SI units, and an exponent n: if the motion is multiplied by
    a factor f ≥ 0, the value is multiplied by fⁿ.

    - `measure`: `"PGA"`, `"PGV"`, `"PGD"`, `"CAV"`, `"arias_intensity"` or `"Sa"`
    - `period`: period of Sa, ≥ 0 [s]; None for other measures
    - `damping`: damping ratio of Sa, 0 ≤ ζ < 1 [–]

    Raises `ValueError` for an unknown measure, for Sa without a period or with a period outside its range,
    and for other measures with a period.
    """
    scalar_measures = {
        "PGA": (lambda: motion.pga, 1),
        "PGV": (lambda: motion.pgv, 1),
        "PGD": (lambda: motion.pgd, 1),
        "CAV": (lambda: cumulative_absolute_velocity(motion), 1),
        "arias_intensity": (lambda: arias_intensity(motion), 2),
    }
    if measure == "Sa":
        if period is None:
            raise ValueError(f"{owner}: Sa needs a period, such as period=1.0 [s]")
        period = require_number(owner, "period", period, lambda v: v >= 0, "finite and >= 0")
        return spectral_acceleration(motion, period, damping), 1
    if measure not in scalar_measures:
        raise ValueError(
            f"{owner}: measure must be one of {', '.join((*scalar_measures, 'Sa'))}, got {measure!r}"
        )
    if period is not None:
        raise ValueError(f"{owner}: period applies to Sa only; leave it out for {measure}")
    compute, power = scalar_measures[measure]
    return compute(), power


SA_LABEL = re.compile(r"Sa\((?P<period>[0-9.eE+-]+) s\)")


def period_of(owner: str, label: str) -> float | None:
    """Return the period of a label such as `"Sa(0.5 s)"` [s]; None for `"PGA"` and `"PGV"`. Raises
    `ValueError` for other labels."""
    match = SA_LABEL.fullmatch(label)
    if match is None and label not in ("PGA", "PGV"):
        raise ValueError(
            f"{owner}: intensity measure must be PGA, PGV or a label such as 'Sa(0.5 s)', got {label!r}"
        )
    return None if match is None else float(match["period"])


def measure_by_label(owner: str, motion: Accelerogram, label: str) -> float:
    """Return the value of an intensity measure in SI units, by its label in hazard and fragility curves:
    `"PGA"`, `"PGV"`, or a label such as `"Sa(0.5 s)"`; Sa has 5 % damping. Raises `ValueError` for other
    labels."""
    period = period_of(owner, label)
    return measure_motion(owner, motion, label if period is None else "Sa", period, 0.05)[0]


def intensity_measures(
    motion: Accelerogram | Sequence[Accelerogram],
    periods: Iterable[float],
    damping: float,
    podium: Podium | None = None,
    owner: str = "intensity_measures",
) -> xarray.Dataset:
    """Return [`rockjax.intensity_measures`][] of a motion as scalars, or of a sequence of motions as arrays
    with the dimension `motion`. Error messages name `owner`."""
    import xarray

    is_sequence = not isinstance(motion, Accelerogram)
    motions = list(motion) if is_sequence else [motion]
    values = tuple(periods) if isinstance(periods, Iterable) and not isinstance(periods, str) else periods
    T = np.atleast_1d(np.asarray(as_float(values, f"{owner}: periods")))
    require(owner, "periods", T, lambda v: v >= 0, "finite and >= 0")
    require_number(owner, "damping", damping, lambda v: 0 <= v < 1, ">= 0 and < 1")
    columns: dict[str, tuple[str, str, list]] = {
        "dt": ("s", "sampling interval", [m.dt for m in motions]),
        "duration": ("s", "duration", [m.duration for m in motions]),
        "PGA": ("m s-2", "peak ground acceleration", [m.pga for m in motions]),
        "PGV": ("m s-1", "peak ground velocity", [m.pgv for m in motions]),
        "PGD": ("m", "peak ground displacement", [m.pgd for m in motions]),
        "PGV_PGA": ("s", "PGV/PGA", [m.pgv / m.pga if m.pga > 0 else math.nan for m in motions]),
        "arias_intensity": ("m s-1", "Arias intensity", [arias_intensity(m) for m in motions]),
        "CAV": ("m s-1", "cumulative absolute velocity", [cumulative_absolute_velocity(m) for m in motions]),
        "D5_95": (
            "s",
            "significant duration, 5–95 % of Arias intensity",
            list(map(significant_duration, motions)),
        ),
        "scale": (
            "1",
            "scale factor relative to the file",
            [float(m.metadata.get("scale", 1.0)) for m in motions],
        ),
    }
    attrs: dict[str, float] = {"damping_ratio": damping}
    if podium is not None:
        require_instance(owner, "podium", podium, Podium, "a rockjax.Podium, or None")
        if np.ndim(podium.alpha) or np.ndim(podium.R) or np.ndim(podium.g):
            raise ValueError(f"{owner}: podium must be a single podium, got arrays of parameters")
        uplift, p = float(g_tan_alpha(podium.alpha, podium.g)), float(podium.p)
        attrs |= {"alpha_rad": float(podium.alpha), "R_m": float(podium.R), "p_rad_s-1": p}
        columns["acceleration_ratio"] = ("1", "PGA/(g tan α)", [m.pga / uplift for m in motions])
        columns["velocity_ratio"] = ("1", "p PGV/(g tan α)", [p * m.pgv / uplift for m in motions])
    dims = ("motion",) if is_sequence else ()
    as_column = lambda values: values if is_sequence else values[0]
    data = xarray.Dataset(
        {
            name: as_variable(dims, as_column(values), unit, long_name)
            for name, (unit, long_name, values) in columns.items()
        },
        coords={
            "motion": (dims, as_column([m.name for m in motions])),
            "period": ("period", T, {"units": "s"}),
        },
        attrs={"title": "Intensity measures", "Conventions": CONVENTIONS, **attrs},
    )
    spectra = [spectral_accelerations(m, T, damping) for m in motions]
    shape = (len(motions), len(T)) if is_sequence else (len(T),)
    Sa = np.reshape(spectra, shape)
    data["Sa"] = as_variable((*dims, "period"), Sa, "m s-2", "pseudo-spectral acceleration")
    return data
