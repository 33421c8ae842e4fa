"""Samples of a ground motion, quantities derived from the samples, and plausibility checks.

The ground acceleration ü_g is linear between samples. For such motions, velocity, displacement and their
peaks are exact.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rockjax._checks import as_float, require_finite_samples, require_instance, require_number
from rockjax._unit_warnings import PlausibilityWarning, warn_about_units
from rockjax._units import STANDARD_GRAVITY

# Limits of plausible values. PGA and PGV are the peak ground acceleration [m/s²] and velocity [m/s].
HIGHEST_PGA = 3 * STANDARD_GRAVITY  # a larger PGA suggests samples in gal that were read as m/s²
LOWEST_PGA = 1e-4 * STANDARD_GRAVITY  # a smaller PGA also suggests a wrong unit
# If the user has given the unit m/s², a PGA below this value suggests samples in g.
LOWEST_USER_PGA = 0.05 * STANDARD_GRAVITY
SHORTEST_DT, LONGEST_DT = 1e-4, 0.1  # range of sampling intervals without a warning [s]
RAW = "raw"  # metadata["processing"] starts with this word for uncorrected data
MAX_FINAL_VELOCITY = 0.2  # |final velocity|/PGV; a larger value suggests a record that is cut or drifts


class RecordWarning(PlausibilityWarning):
    """Warning about a ground motion whose units or baseline look wrong."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Accelerogram:
    """Base class of [`rockjax.Motion`][], without a vertical component. `Motion` describes the fields."""

    acceleration: np.ndarray
    dt: float
    name: str = "motion"
    source: Path | None = None
    metadata: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self):
        samples = np.array(as_float(self.acceleration, "Motion: acceleration"), float)
        if samples.ndim != 1 or len(samples) < 2:
            raise ValueError(
                f"Motion: acceleration must have the shape (n,) with n >= 2, got {samples.shape}"
            )
        require_finite_samples("Motion", samples)
        require_number("Motion", "dt", self.dt, lambda v: v > 0, "finite and > 0 s")
        require_instance("Motion", "metadata", self.metadata, Mapping, "a dict")
        samples.flags.writeable = False
        for name, value in {
            "acceleration": samples,
            "dt": float(self.dt),
            "metadata": dict(self.metadata),
        }.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.acceleration)

    @property
    def duration(self) -> float:
        """Time between the first and the last sample [s]."""
        return (len(self) - 1) * self.dt

    @property
    def time(self) -> np.ndarray:
        """Times of the samples, from 0, shape (n,) [s]."""
        return np.arange(len(self)) * self.dt

    @functools.cached_property
    def velocity(self) -> np.ndarray:
        """Ground velocity at the samples, starting from rest, shape (n,) [m/s]."""
        steps = 0.5 * self.dt * (self.acceleration[1:] + self.acceleration[:-1])
        return np.concatenate([[0.0], np.cumsum(steps)])

    @functools.cached_property
    def displacement(self) -> np.ndarray:
        """Ground displacement at the samples, starting from rest, shape (n,) [m]."""
        # The velocity is a parabola between samples. For parabolas, the trapezoidal rule with the end
        # correction of Euler & Maclaurin is exact.
        steps = 0.5 * self.dt * (self.velocity[1:] + self.velocity[:-1])
        trapezoids = np.concatenate([[0.0], np.cumsum(steps)])
        return trapezoids - self.dt**2 / 12 * (self.acceleration - self.acceleration[0])

    @property
    def pga(self) -> float:
        """Peak ground acceleration max|ü_g| [m/s²]."""
        return float(np.abs(self.acceleration).max())

    @property
    def pgv(self) -> float:
        """Peak ground velocity [m/s]. The peak may lie between two samples, where ü_g crosses zero."""
        a, next_a, velocity = self.acceleration[:-1], self.acceleration[1:], self.velocity[:-1]
        crosses_zero = a * next_a < 0
        increase = 0.5 * self.dt * a[crosses_zero] ** 2 / (a[crosses_zero] - next_a[crosses_zero])
        return float(np.abs(np.concatenate([self.velocity, velocity[crosses_zero] + increase])).max())

    @property
    def pgd(self) -> float:
        """Peak ground displacement [m]. The peak may lie between two samples, where the velocity is zero."""
        a, v, u, dt = self.acceleration[:-1], self.velocity[:-1], self.displacement[:-1], self.dt
        slope = np.diff(self.acceleration) / dt
        # At the time τ after a sample, the velocity is v + aτ + ½ slope τ². It is zero at τ = 2v/stable_sum
        # and at τ = stable_sum/slope. Both terms of `stable_sum` have the same sign, so no digits cancel.
        root = np.sqrt(np.maximum(a * a - 2 * slope * v, 0))
        stable_sum = -(a + np.copysign(root, a))
        with np.errstate(divide="ignore", invalid="ignore"):
            times = np.stack([2 * v / stable_sum, stable_sum / slope])
        times = np.where((times > 0) & (times < dt), times, 0.0)
        peaks = u + times * (v + times * (a / 2 + times * slope / 6))
        return float(np.abs(np.append(peaks, self.displacement[-1])).max())


def warn_if_implausible(
    motion: Accelerogram, where: str, stacklevel: int, *, unit_from_user: bool = False
) -> None:
    """Warn (`RecordWarning`) if PGA, sampling interval or final velocity of a motion is implausible, if the
    file is damaged, or if the data are raw (not corrected). The final velocity of raw data is not checked.
    `unit_from_user` states that the user has passed `units`; if the unit is m/s², the lowest plausible PGA is
    then `LOWEST_USER_PGA`. A `stacklevel` of 1 is this function."""
    if not LOWEST_PGA <= motion.pga <= HIGHEST_PGA:
        warn_about_units(
            f"{where}: PGA is {motion.pga / STANDARD_GRAVITY:.3g} g; are the units right?",
            stacklevel,
            RecordWarning,
        )
    elif unit_from_user and motion.metadata.get("units") == "m/s2" and motion.pga < LOWEST_USER_PGA:
        warn_about_units(
            f"{where}: PGA is {motion.pga:.3g} m/s², {motion.pga / STANDARD_GRAVITY:.3g} g; if the file is "
            "in g, pass units='g'",
            stacklevel,
            RecordWarning,
        )
    if not SHORTEST_DT <= motion.dt <= LONGEST_DT:
        warn_about_units(
            f"{where}: the sampling interval is {motion.dt:.3g} s, which is unusual for an accelerograph; "
            "are the times in seconds?",
            stacklevel,
            RecordWarning,
        )
    if damage := motion.metadata.get("damaged"):
        warn_about_units(
            f"{where}: the file is damaged, and only {len(motion)} samples could be read: {damage}",
            stacklevel,
            RecordWarning,
        )
    processing = str(motion.metadata.get("processing", ""))
    if processing.startswith(RAW):
        warn_about_units(
            f"{where}: the motion is {processing}, not corrected, so it contains offset and drift; "
            "Motion.baseline_corrected(1) removes an offset",
            stacklevel,
            RecordWarning,
        )
        return
    final_velocity = abs(float(motion.velocity[-1]))
    if final_velocity > MAX_FINAL_VELOCITY * motion.pgv:
        warn_about_units(
            f"{where}: the motion ends with a velocity of "
            f"{final_velocity:.3g} m/s, {final_velocity / motion.pgv:.0%} of PGV, so its baseline drifts or "
            "it is cut; Motion.baseline_corrected() removes a drift",
            stacklevel,
            RecordWarning,
        )
