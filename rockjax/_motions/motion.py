"""Ground motions as NumPy arrays: samples with a name, a source and the contents of the file header.

Use a [`rockjax.Motion`][] to read, change and save a ground motion outside JAX. `Motion.record` converts the
motion to a [`rockjax.Record`][], the excitation of a scene. Both are linear between samples.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Self, overload

import numpy as np

from rockjax._checks import format_value, require_number
from rockjax._excitations.ground import GroundMotion
from rockjax._files import write_atomically
from rockjax._structures import Podium
from rockjax._text import tables
from rockjax._units import STANDARD_GRAVITY

from .accelerogram import Accelerogram
from .formats.peer import OWN_TITLE
from .intensity import energy, intensity_measures, measure_motion
from .record import Record
from .stations import pair_motions

if TYPE_CHECKING:
    import xarray

_AT2_SMALLEST = 1e-99  # smaller samples are written to .AT2 files as 0 [g]
_MAX_RATIO = 1000  # largest numerator and denominator of the ratio of sampling intervals


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Motion(Accelerogram):
    """A ground motion as a NumPy array of samples, linear between samples and zero outside.

    - `acceleration`: samples of the ground acceleration ü_g, shape (n,), n ≥ 2 [m/s²]; stored as a read-only
      copy
    - `dt`: sampling interval, > 0 [s]
    - `name`: name of the motion
    - `source`: the file from which the motion was read, or None
    - `metadata`: contents of the file header, such as station, component, event, date, unit in the file
      and corner frequencies of filters
    - `vertical`: vertical component of the same ground motion, upwards positive, or None.
      [`rockjax.Motions.paired`][] adds it. Methods that change a motion change its vertical component in the
      same way. Intensity measures describe only the horizontal component

    Raises `ValueError` for dt ≤ 0, for fewer than two samples, for samples that are not finite, and for gaps:
    masked samples, and values such as -999 or 999999 that stand for missing samples.
    """

    vertical: Motion | None = None

    def __post_init__(self):
        super().__post_init__()
        if not isinstance(self.vertical, Motion | None):
            raise ValueError(
                f"Motion: vertical must be a rockjax.Motion or None, got {format_value(self.vertical)}"
            )

    def record(self, scale: float = 1.0) -> Record | GroundMotion:
        """Return the motion as an excitation: a [`rockjax.Record`][], or a [`rockjax.GroundMotion`][] if the
        motion has a vertical component.

        - `scale`: factor on the samples [–]
        """
        record = Record(self.acceleration, self.dt, scale)
        return record if self.vertical is None else GroundMotion(record, self.vertical.record(scale))

    def scaled(self, factor: float) -> Self:
        """Return the motion multiplied by `factor` [–]. In the result, `metadata["scale"]` is the product of
        this factor and all earlier ones."""
        factor = require_number("scaled", "factor", factor, math.isfinite, "finite")
        note = {"scale": float(factor) * self.metadata.get("scale", 1.0)}
        scaled = self._with_samples(factor * self.acceleration, **note)
        return scaled._with_vertical(lambda vertical: vertical.scaled(factor))

    def _with_samples(self, acceleration: np.ndarray, dt: float | None = None, **notes) -> Self:
        dt = self.dt if dt is None else dt
        return dataclasses.replace(
            self, acceleration=acceleration, dt=dt, metadata=dict(self.metadata) | notes
        )

    def _with_vertical(self, change: Callable[[Motion], Motion]) -> Self:
        """Apply a change to the vertical component, if there is one."""
        return self if self.vertical is None else dataclasses.replace(self, vertical=change(self.vertical))

    def resampled(self, dt: float) -> Self:
        """Return the motion with the sampling interval `dt` [s], resampled with the filter of
        `scipy.signal.resample_poly`.

        The filter removes frequencies above the Nyquist frequency of the longer of the two sampling
        intervals, so that none are aliased. It keeps lower frequencies. Only the difference from the straight
        line through the first and the last sample is filtered, so that an offset does not ring at the ends.
        The time of the first sample does not change.

        Raises `ValueError` for dt ≤ 0 and for a dt longer than the duration. The ratio of the two intervals
        must be a ratio of whole numbers up to 1000, or `ValueError` is raised.
        """
        dt = require_number("resampled", "dt", dt, lambda v: v > 0, "finite and > 0 s")
        if dt > self.duration:
            raise ValueError(
                f"resampled: dt = {dt:g} s exceeds the duration of {self.duration:g} s; pass a shorter dt"
            )
        ratio = Fraction(self.dt / dt).limit_denominator(_MAX_RATIO)
        if not 0 < ratio.numerator <= _MAX_RATIO or abs(float(ratio) * dt / self.dt - 1) > 1e-6:
            raise ValueError(
                f"resampled: dt = "
                f"{dt:g} s and the present {self.dt:g} s must be in a ratio of whole numbers up to "
                f"{_MAX_RATIO}; pass another dt"
            )
        from scipy.signal import resample_poly

        up, down = ratio.numerator, ratio.denominator
        count = (len(self) - 1) * up // down + 1
        # The line is not filtered, because the gain of the filter for a constant varies by 1e-3 between
        # samples.
        first, last = self.acceleration[[0, -1]]
        line = lambda times: first + (last - first) / self.duration * times
        filtered = resample_poly(self.acceleration - line(self.time), up, down)[:count]
        resampled = self._with_samples(filtered + line(np.arange(count) * dt), dt)
        return resampled._with_vertical(lambda vertical: vertical.resampled(dt))

    def baseline_corrected(self, order: int = 2) -> Self:
        """Return the motion without its drift: a polynomial is subtracted from the velocity, and its
        derivative from ü_g.

        - `order`: degree of the polynomial in the velocity, 1 to 8. From the acceleration, order 1 removes
          a constant, 2 a straight line, 3 a parabola

        The polynomial is zero at the start and equals the velocity at the end, so the corrected motion
        starts and ends at rest. In between, the polynomial is fitted to the velocity by least squares.

        Raises `ValueError` for another order.
        """
        if not isinstance(order, int) or isinstance(order, bool) or not 1 <= order <= 8:
            raise ValueError(
                f"baseline_corrected: order must be a whole number from 1 to 8, got order = {order!r}"
            )
        s = np.linspace(0.0, 1.0, len(self))  # time divided by the duration T
        end = self.velocity[-1]
        # The polynomial is v(T) s + Σ c_k (s^k − s) with k = 2 … order; the sum is zero at both ends.
        powers = np.arange(2, order + 1)
        shapes = s[:, None] ** powers - s[:, None]
        c = np.linalg.lstsq(shapes, self.velocity - end * s, rcond=None)[0]
        slope = end + (powers * s[:, None] ** (powers - 1) - 1) @ c
        corrected = self._with_samples(self.acceleration - slope / self.duration, baseline_order=order)
        # Between samples, the correction is linear, whereas the derivative of the polynomial may be curved.
        # The velocity at the end is therefore not exactly zero; subtracting a constant acceleration makes it
        # zero.
        corrected = corrected._with_samples(corrected.acceleration - corrected.velocity[-1] / self.duration)
        return corrected._with_vertical(lambda vertical: vertical.baseline_corrected(order))

    def trimmed(self, lower: float = 0.001, upper: float = 0.999) -> Self:
        """Return the part of the motion in which the Arias intensity grows from the fraction `lower` to the
        fraction `upper` of its final value [–].

        The velocity at the end of the result may differ from zero; [`rockjax.Motion.baseline_corrected`][]
        corrects this. The vertical component is cut at the same times. If it has fewer than two samples
        between these times, the result has no vertical component.

        Raises `ValueError` unless 0 ≤ lower < upper ≤ 1, for a motion that is zero throughout, and for a
        vertical component with another sampling interval.
        """
        for name, value in (("lower", lower), ("upper", upper)):
            require_number("trimmed", name, value, lambda v: 0 <= v <= 1, "in [0, 1], and lower < upper")
        if not lower < upper:
            raise ValueError(
                f"trimmed: lower and upper must satisfy 0 <= lower < upper <= 1, got lower = {lower!r} and "
                f"upper = {upper!r}"
            )
        cumulative_energy = energy(self)
        if cumulative_energy[-1] == 0:
            raise ValueError(
                f"trimmed: {self.name} is zero throughout, so it has no strong part; leave it out"
            )
        first = int(np.searchsorted(cumulative_energy, lower * cumulative_energy[-1], side="right")) - 1
        last = int(np.searchsorted(cumulative_energy, upper * cumulative_energy[-1]))
        window = slice(max(first, 0), max(last, first + 1) + 1)
        trimmed, vertical = self._with_samples(self.acceleration[window]), self.vertical
        if vertical is None:
            return trimmed
        if vertical.dt != self.dt:
            raise ValueError(
                f"trimmed: the vertical motion of {self.name} is sampled every {vertical.dt:g} s, the "
                f"horizontal one every {self.dt:g} s; resample one of them"
            )
        if len(vertical.acceleration[window]) < 2:
            return dataclasses.replace(trimmed, vertical=None)
        return dataclasses.replace(trimmed, vertical=vertical._with_samples(vertical.acceleration[window]))

    def save(self, path: str | Path) -> Path:
        """Write the motion to a file, atomically. The suffix, `.AT2` or `.csv`, determines the format.

        `.AT2` (PEER) contains the acceleration in g with 8 significant digits, and 0 for samples smaller than
        1e-99 g. `.csv` contains the time [s] and the exact acceleration [m/s²]. [`rockjax.read_motion`][]
        reads both without further arguments.

        Raises `ValueError` for another suffix and for a motion with a vertical component. Raises
        `OSError`, which names the file and the cause, if the file cannot be written.
        """
        suffix = Path(path).suffix.lower()
        if self.vertical is not None:
            raise ValueError(
                f"{path}: a file holds one component; save motion.vertical by itself, and the horizontal one "
                "as dataclasses.replace(motion, vertical=None)"
            )
        if suffix not in (".at2", ".csv"):
            raise ValueError(f"{path}: a motion is saved as .AT2 or .csv, got {Path(path).suffix!r}")
        lines = self._at2() if suffix == ".at2" else self._csv()
        return write_atomically(
            path, lambda name: Path(name).write_text("\n".join([*lines, ""]), encoding="utf-8")
        )

    def _at2(self) -> list[str]:
        header_text = lambda key, default: " ".join(
            str(self.metadata.get(key) or default).replace(",", ";").split()
        )
        event, date, station, component = (
            header_text(key, default)
            for key, default in (("event", self.name), ("date", ""), ("station", ""), ("component", ""))
        )
        # Smaller samples would need exponents of three digits, which leave no blank between the columns.
        samples = np.where(
            np.abs(self.acceleration) < _AT2_SMALLEST * STANDARD_GRAVITY, 0.0, self.acceleration
        )
        numbers = [f"{a:15.7E}" for a in samples / STANDARD_GRAVITY]
        return [
            OWN_TITLE,
            f"{event}, {date}, {station}, {component}",
            "ACCELERATION TIME SERIES IN UNITS OF G",
            f"NPTS= {len(self):6d}, DT= {self.dt!r} SEC",
            *("".join(numbers[k : k + 5]) for k in range(0, len(numbers), 5)),
        ]

    def _csv(self) -> list[str]:
        rows = (f"{t:.15g},{float(a)!r}" for t, a in zip(self.time, self.acceleration, strict=True))
        return ["time [s],acceleration [m/s2]", *rows]

    def _facts(self) -> dict[str, str]:
        facts = {
            "samples": f"{len(self)} every {self.dt:g} s, {self.duration:.4g} s",
            "PGA": f"{self.pga:.3g} m/s² ({self.pga / STANDARD_GRAVITY:.3g} g)",
            "PGV": f"{self.pgv:.3g} m/s",
            "PGD": f"{self.pgd:.3g} m",
        }
        if self.vertical is not None:
            facts["vertical"] = f"{self.vertical.name}, {self.vertical.pga:.3g} m/s²"
        notes = {key: str(value) for key, value in self.metadata.items() if value not in (None, "")}
        return facts | dict(list(notes.items())[:8])

    def __repr__(self) -> str:
        return "\n  ".join(
            [f"Motion {self.name!r}", *(f"{key}: {value}" for key, value in self._facts().items())]
        )

    def _repr_html_(self) -> str:
        return tables.html(list(self._facts().items()), caption=self.name, headings="column")


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Motions(Sequence[Motion]):
    """Several ground motions, of any lengths and sampling intervals: a sequence of [`rockjax.Motion`][].

    An index returns a `Motion`, a slice returns `Motions`. The accelerations include the scale factors that
    `scales` lists.

    - `motions`: the motions
    """

    motions: tuple[Motion, ...]

    def __post_init__(self):
        if isinstance(self.motions, Motion) or not isinstance(self.motions, Iterable):
            raise ValueError(f"Motions: motions must hold rockjax.Motion, got {format_value(self.motions)}")
        motions = tuple(self.motions)
        for motion in motions:
            if not isinstance(motion, Motion):
                raise ValueError(f"Motions: motions must hold rockjax.Motion, got {format_value(motion)}")
        object.__setattr__(self, "motions", motions)

    @overload
    def __getitem__(self, index: int) -> Motion: ...
    @overload
    def __getitem__(self, index: slice) -> Motions: ...
    def __getitem__(self, index):
        return Motions(self.motions[index]) if isinstance(index, slice) else self.motions[index]

    def __len__(self) -> int:
        return len(self.motions)

    @property
    def names(self) -> list[str]:
        """Names of the motions, in their order."""
        return [motion.name for motion in self]

    @property
    def scales(self) -> np.ndarray:
        """Factor on each motion relative to its file, shape (motions,) [–]."""
        return np.array([float(motion.metadata.get("scale", 1.0)) for motion in self])

    def map(self, change: Callable[[Motion], Motion]) -> Motions:
        """Apply `change` to every motion, such as `lambda motion: motion.resampled(0.01)`."""
        return Motions(tuple(change(motion) for motion in self))

    def records(self) -> list[Record | GroundMotion]:
        """Return every motion as an excitation: a [`rockjax.Record`][], or a [`rockjax.GroundMotion`][]
        if it has a vertical component."""
        return [motion.record() for motion in self]

    def paired(self) -> Motions:
        """Return the horizontal motions, each with the vertical component of its station and event.

        Two motions belong together if their headers state the same station, event and date. If the header of
        a horizontal motion states no station, the names decide: the name of the vertical motion, without a
        suffix such as UP, must be the beginning of the name of the horizontal motion and must not divide a
        number, except before an azimuth of three digits: E06-UP belongs to E06-NS and E06140, but not to
        E061. A vertical component that is positive downwards is multiplied by −1.

        Raises `ValueError` if there is no horizontal motion, or if any horizontal motion does not match
        exactly one vertical motion; the message lists all such motions.
        """
        return Motions(pair_motions(self.motions))

    def scaled_to(
        self, measure: str, value: float, *, period: float | None = None, damping: float = 0.05
    ) -> Motions:
        """Return the motions, each scaled so that its `measure` equals `value`.

        - `measure`: `"PGA"` [m/s²], `"PGV"` [m/s], `"PGD"` [m], `"CAV"` [m/s], `"arias_intensity"` [m/s], or
          `"Sa"` [m/s²]
        - `value`: target, > 0, in the unit of the measure
        - `period`: period of Sa [s]; None for other measures
        - `damping`: damping ratio ζ of Sa, 0 ≤ ζ < 1 [–]

        Raises `ValueError` for an unknown measure, for a value ≤ 0, for another damping ratio, for Sa without
        a period, for other measures with a period, and for a motion whose measure is zero.
        """
        require_number("scaled_to", "value", value, lambda v: v > 0, "finite and > 0")
        require_number("scaled_to", "damping", damping, lambda v: 0 <= v < 1, ">= 0 and < 1")

        def scaled(motion: Motion) -> Motion:
            current, power = measure_motion("scaled_to", motion, measure, period, damping)
            if current == 0:
                raise ValueError(
                    f"scaled_to: {measure} of {motion.name} is zero, so no factor changes it; leave the "
                    "motion out"
                )
            return motion.scaled((value / current) ** (1 / power))

        return self.map(scaled)

    def dataset(
        self,
        *,
        periods: Iterable[float] = (0.1, 0.2, 0.5, 1.0, 2.0),
        damping: float = 0.05,
        podium: Podium | None = None,
    ) -> xarray.Dataset:
        """Return the intensity measures of the motions along the dimension `motion`.

        - `periods`, `damping`, `podium`: as for [`rockjax.intensity_measures`][]
        """
        return intensity_measures(self, periods, damping, podium)

    def _rows(self) -> list[tuple[str, ...]]:
        return [
            ("name", "dt [s]", "duration [s]", "PGA [m/s²]", "PGV [m/s]", "scale"),
            *(
                (m.name, f"{m.dt:g}", f"{m.duration:.4g}", f"{m.pga:.3g}", f"{m.pgv:.3g}", f"{scale:.4g}")
                for m, scale in zip(self, self.scales, strict=True)
            ),
        ]

    def __repr__(self) -> str:
        return "\n  ".join([f"{len(self)} motions", *tables.align_rows(self._rows(), numbers=True)])

    def _repr_html_(self) -> str:
        return tables.html(self._rows(), headings="row")
