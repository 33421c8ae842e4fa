"""Pulses of near-fault records: tables of Mavroeidis–Papageorgiou pulses, and fits of a pulse to a record.

[`rockjax.MavroeidisPapageorgiou`][] defines the parameters of a pulse: velocity amplitude A [m/s], frequency
f_p [Hz], number of oscillations γ > 1 [–] and phase ν [rad].
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from rockjax._checks import as_float, as_strings, concrete, require_instance, require_number
from rockjax._excitations.wavelets import MavroeidisPapageorgiou
from rockjax._programs.program import StoredProgram
from rockjax._text.reading import csv_table, read_text
from rockjax._units import DEGREE, UNITS

from .convert import AnyMotion, as_motions
from .motion import Motion

COLUMNS = ("A", "f_p", "gamma", "nu")
QUANTITIES = ("velocity", "displacement")
PERIODS = (0.3, 12.0)  # default range of initial periods 1/f_p [s]; they are at most the record's duration
OSCILLATIONS = (1.05, 1.5, 2.0, 3.0, 5.0)  # initial values of γ
FREQUENCIES = 40  # number of initial frequencies
STARTS = 4  # number of initial pulses from which least-squares fits start


class PulseTable(NamedTuple):
    """Pulses with names.

    - `pulses`: a batch of [`rockjax.MavroeidisPapageorgiou`][] with fields of shape (k,)
    - `names`: names of the k pulses
    """

    pulses: MavroeidisPapageorgiou
    names: tuple[str, ...]


def read_pulses(path: str | Path) -> PulseTable:
    """Read a table of Mavroeidis–Papageorgiou pulses.

    - `path`: CSV file with one pulse in each row

    The first row names the columns: the amplitude `A` [m/s] or `A_cm_s` [cm/s]; the frequency `f_p` [Hz]; the
    number of oscillations `gamma` [–]; and the phase `nu` [rad] or `nu_deg` [°]. The column `name` is
    optional; without it, the names are the numbers of the pulses, from 1. Lines that begin with `#` are
    comments.

    Raises `ValueError` for a missing column, for a cell that is not a finite number, and for parameters
    outside their ranges.
    """
    path = Path(path)
    lines = ["" if line.lstrip().startswith("#") else line for line in read_text(path).splitlines()]
    headings, iterator = csv_table(path, "\n".join(lines))
    rows = list(iterator)
    if not rows:
        raise ValueError(f"{path}: the file has no pulses; its columns must be {', '.join(COLUMNS)}")
    alternatives = {"A": ("A_cm_s", UNITS["cm/s"].factor), "nu": ("nu_deg", DEGREE)}
    values = {}
    for name in COLUMNS:
        column, factor = (name, 1.0) if name in headings else alternatives.get(name, (name, 1.0))
        if column not in headings:
            accepted = " or ".join(filter(None, (name, alternatives.get(name, ("",))[0])))
            raise ValueError(
                f"{path}: column {accepted} is missing; the columns are {', '.join(sorted(headings))}"
            )
        if name in alternatives and {name, alternatives[name][0]} <= set(headings):
            raise ValueError(f"{path}: the columns {name} and {alternatives[name][0]} exclude each other")
        values[name] = factor * np.array([_number(path, k, column, row) for k, (_, row) in enumerate(rows)])
    names = [row.get("name", str(k)) for k, (_, row) in enumerate(rows, start=1)]
    return PulseTable(MavroeidisPapageorgiou(**values), as_strings("read_pulses", "names", names))


def _number(path: Path, k: int, column: str, row: dict[str, str]) -> float:
    """Return the number in a column of row k, counted from 0. Raises `ValueError` unless it is finite."""
    text = row.get(column, "")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{path}: pulse {k + 1}: {column} must be a finite number, got {text!r}")
    return value


@dataclasses.dataclass(frozen=True)
class PulseFit:
    """A pulse fitted to a record.

    - `pulse`: the pulse, centred on t = 0
    - `time`: time of the pulse's centre in the record [s]
    - `share`: the explained share 1 − ∫(y − y_p)² dt / ∫y² dt, where y is the velocity or displacement of the
      record, and y_p that of the pulse [–]
    - `quantity`: the fitted quantity y, `"velocity"` or `"displacement"`
    """

    pulse: MavroeidisPapageorgiou
    time: Float[Array, ""]
    share: Float[Array, ""]
    quantity: str

    def velocity(self, times) -> Float[Array, " n"]:
        """Return the velocity of the pulse, shape (n,) [m/s]. `times` counts from the start of the record
        [s]."""
        return _velocity(self.pulse, jnp.asarray(times, float) - self.time)

    def residual(self, motion: Motion) -> Motion:
        """Return the motion minus the pulse. A vertical component is not changed."""
        pulse = np.asarray(self.pulse(jnp.asarray(motion.time) - self.time))
        return dataclasses.replace(motion, acceleration=motion.acceleration - pulse)

    def __repr__(self):
        if concrete(self.share) is None:
            return "PulseFit(traced)"
        return f"PulseFit: {self.pulse!r} at {float(self.time):.4g} s, {float(self.share):.0%} of the record"


jax.tree_util.register_dataclass(PulseFit, ["pulse", "time", "share"], ["quantity"])


def fit_pulse(
    motion: AnyMotion,
    *,
    quantity: Literal["velocity", "displacement"] = "velocity",
    shortest: float = PERIODS[0],
    longest: float = PERIODS[1],
) -> PulseFit:
    """Fit a Mavroeidis–Papageorgiou pulse to a record, by least squares on velocity or displacement.

    - `motion`: one [`rockjax.Motion`][] or [`rockjax.Record`][], which starts at rest
    - `quantity`: the fitted quantity. The displacement gives more weight to long periods, and needs a
      record without baseline drift
    - `shortest`, `longest`: range of the initial periods 1/f_p, 0 < shortest < longest; periods longer than
      the record are not used [s]

    First, a correlation with the velocity gives the best time, amplitude and phase of a pulse for each of 40
    initial periods and 5 initial numbers of oscillations. For each period, the best number of oscillations is
    kept. Then least-squares fits (Levenberg–Marquardt) start from up to four of these pulses: those at the
    largest local maxima of the explained share ([`rockjax.PulseFit`][]) over the period. The fit with the
    largest share is returned. [`rockjax.refit_pulse`][] gives derivatives of the pulse with respect to the
    samples.

    Raises `ValueError` for traced samples, for none or several motions, for a motion that is zero throughout,
    and for an invalid `quantity` or range of periods.
    """
    owner = "fit_pulse"
    motions = as_motions(owner, motion)
    if len(motions) != 1:
        raise ValueError(f"{owner}: motion must be one motion, got {len(motions)}; call it for each of them")
    if quantity not in QUANTITIES:
        raise ValueError(f"{owner}: quantity must be 'velocity' or 'displacement', got {quantity!r}")
    shortest = require_number(owner, "shortest", shortest, lambda v: v > 0, "finite and > 0 s")
    longest = require_number(
        owner, "longest", longest, lambda v: v > shortest, "finite and longer than shortest"
    )
    record = motions[0]
    if not np.any(record.velocity):
        raise ValueError(f"{owner}: {record.name} is zero throughout")
    # If the record is shorter than `shortest`, the range of periods is very narrow, but not empty.
    longest = max(min(longest, record.duration), 1.0001 * shortest)
    starts = _starting_pulses(
        record.velocity, record.dt, np.geomspace(1 / longest, 1 / shortest, FREQUENCIES)
    )
    # The first start is repeated until there are STARTS of them, so that the number of starts does not change
    # the compiled program.
    starts += starts[:1] * (STARTS - len(starts))
    stacked_starts = jax.tree.map(lambda *ys: np.stack(ys), *starts)
    leaves = _refit_stacked(record.acceleration, record.dt, stacked_starts, quantity=quantity)
    treedef = jax.tree.structure(dataclasses.replace(starts[0], quantity=quantity))
    fits = jax.tree.unflatten(treedef, [np.asarray(y) for y in leaves])
    best = int(np.nanargmax(fits.share))
    return jax.tree.map(lambda y: as_float(y[best]), fits)


def _refit_leaves(acceleration, dt, starts: PulseFit, *, quantity: str) -> list[Array]:
    fits = jax.vmap(lambda start: refit_pulse(acceleration, dt, start, quantity=quantity))(starts)
    return jax.tree.leaves(fits)  # a stored program can return arrays, but no modules such as pulses


_refit_stacked = StoredProgram(_refit_leaves)


def _starting_pulses(velocity: np.ndarray, dt: float, frequencies: np.ndarray) -> list[PulseFit]:
    """Return at most four pulses from which least-squares fits start, the one with the largest explained
    share first. Each has one of `frequencies` [Hz] at which the explained share has a local maximum, with the
    best γ, time, amplitude and phase. `velocity` is that of the record, shape (n,) [m/s]."""
    total = float(velocity @ velocity)
    best = [max(_best_pulse(velocity, dt, f, gamma) for gamma in OSCILLATIONS) for f in frequencies]
    shares = np.array([explained for explained, *_ in best]) / total
    maxima = [k for k in range(len(best)) if shares[k] == shares[max(k - 1, 0) : k + 2].max()]
    starts = []
    for k in sorted(maxima, key=lambda k: -shares[k])[:STARTS]:
        _, time, A, gamma, nu = best[k]
        pulse = MavroeidisPapageorgiou(A, float(frequencies[k]), gamma, nu)
        starts.append(PulseFit(pulse, as_float(time), as_float(shares[k]), "velocity"))
    return starts


def _best_pulse(velocity: np.ndarray, dt: float, f_p: float, gamma: float) -> tuple[float, ...]:
    """Return the best pulse with a given frequency [Hz] and number of oscillations: the explained part of Σv²
    [m²/s²], the time of the pulse's centre [s], A [m/s], γ [–] and ν [rad]. `velocity` is that of the record,
    shape (n,) [m/s]."""
    from scipy.signal import fftconvolve

    half_count = math.floor(0.5 * gamma / f_p / dt)  # number of samples on each side of the centre
    phase = 2 * math.pi * f_p * dt * np.arange(-half_count, half_count + 1)
    window = 0.5 * (1 + np.cos(phase / gamma))
    shapes = np.stack([window * np.cos(phase), -window * np.sin(phase)])
    # The pulse is a·shapes[0] + b·shapes[1]. The first shape is even and the second odd, so the equations of
    # least squares for a and b are independent of each other.
    correlations = np.stack([fftconvolve(velocity, shape[::-1], mode="full") for shape in shapes])
    norms = np.maximum(np.sum(shapes**2, axis=1), 1e-300)[:, None]
    explained = np.sum(correlations**2 / norms, axis=0)
    k = int(np.argmax(explained))
    a, b = (correlations / norms)[:, k]
    return float(explained[k]), (k - half_count) * dt, math.hypot(a, b), gamma, math.atan2(b, a)


def refit_pulse(
    acceleration: Float[Array, " n"],
    dt,
    start: PulseFit,
    *,
    quantity: str | None = None,
) -> PulseFit:
    """Refine a pulse by least squares. The function is differentiable with respect to the samples, and works
    under `jit` and `vmap`.

    - `acceleration`: samples of a record that is linear between samples and starts at rest, shape (n,) [m/s²]
    - `dt`: sampling interval [s]
    - `start`: the pulse to refine, such as the result of [`rockjax.fit_pulse`][]
    - `quantity`: the fitted quantity, `"velocity"` or `"displacement"`; None for `start.quantity`

    Derivatives follow from the implicit function theorem at the minimum of the sum of squares.
    """
    import optimistix as optx

    require_instance("refit_pulse", "start", start, PulseFit, "a rockjax.PulseFit")
    quantity = quantity or start.quantity
    acceleration = jnp.asarray(acceleration, float)
    t = dt * jnp.arange(acceleration.shape[-1], dtype=float)
    target = _ground_velocity(acceleration, dt)
    if quantity == "displacement":
        # The velocity is a parabola between samples, so this trapezoidal rule with end correction is exact.
        increments = dt * (0.5 * (target[1:] + target[:-1])) - dt**2 / 12 * jnp.diff(acceleration)
        target = jnp.concatenate([jnp.zeros(1), jnp.cumsum(increments)])
    amplitude = jax.lax.stop_gradient(jnp.max(jnp.abs(target)))
    fitted = _velocity if quantity == "velocity" else _displacement

    def residual(y, target):
        return (fitted(_pulse(y), t - y[4]) - target) / amplitude

    pulse = start.pulse
    y = jnp.stack([pulse.A, jnp.log(pulse.f_p), jnp.log(pulse.gamma - 1), pulse.nu, jnp.asarray(start.time)])
    solver = optx.LevenbergMarquardt(1e-10, 1e-10)
    y = optx.least_squares(
        residual, solver, jax.lax.stop_gradient(y), target, max_steps=200, throw=False
    ).value
    share = 1 - jnp.sum(residual(y, target) ** 2) / jnp.sum((target / amplitude) ** 2)
    return PulseFit(_normalise(_pulse(y)), y[4], share, quantity)


def _ground_velocity(acceleration: Float[Array, " n"], dt) -> Float[Array, " n"]:
    """Return the velocity at the samples, starting from rest [m/s]."""
    increments = 0.5 * dt * (acceleration[1:] + acceleration[:-1])
    return jnp.concatenate([jnp.zeros(1), jnp.cumsum(increments)])


def _pulse(y: Float[Array, " 5"]) -> MavroeidisPapageorgiou:
    """Return the pulse with the unknowns y = (A, ln f_p, ln(γ − 1), ν, time of the centre) of the least
    squares. The pulse does not depend on the time."""
    return MavroeidisPapageorgiou(y[0], jnp.exp(y[1]), 1 + jnp.exp(y[2]), y[3])


def _normalise(pulse: MavroeidisPapageorgiou) -> MavroeidisPapageorgiou:
    """Return the same pulse with A ≥ 0 and −π < ν ≤ π."""
    phase = jnp.where(pulse.A < 0, pulse.nu + math.pi, pulse.nu)
    nu = phase - 2 * math.pi * jax.lax.stop_gradient(jnp.ceil(phase / (2 * math.pi) - 0.5))
    return dataclasses.replace(pulse, A=jnp.abs(pulse.A), nu=nu)


def _velocity(pulse: MavroeidisPapageorgiou, t: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return the velocity of the pulse at times `t` after its centre, shape (n,) [m/s]."""
    phase = 2 * math.pi * pulse.f_p * t
    is_inside = jnp.abs(t) <= 0.5 * pulse.gamma / pulse.f_p
    shape = 0.5 * (1 + jnp.cos(phase / pulse.gamma)) * jnp.cos(phase + pulse.nu)
    return jnp.where(is_inside, pulse.A * shape, 0.0)


def _displacement(pulse: MavroeidisPapageorgiou, t: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return the displacement of the pulse at times `t` after its centre, shape (n,) [m]. Before the pulse,
    it is zero."""
    half, omega = 0.5 * pulse.gamma / pulse.f_p, 2 * math.pi * pulse.f_p

    def integral(time):
        terms = ((0.5, omega), (0.25, omega * (1 + 1 / pulse.gamma)), (0.25, omega * (1 - 1 / pulse.gamma)))
        return sum(
            (weight / rate * jnp.sin(rate * time + pulse.nu) for weight, rate in terms), jnp.zeros_like(time)
        )

    clipped = jnp.clip(t, -half, half)
    return pulse.A * (integral(clipped) - integral(-half))
