"""Pulses of near-fault records: tables of Mavroeidis–Papageorgiou pulses, and the pulse in a record."""

from __future__ import annotations

import csv
import dataclasses
import math
import warnings
from pathlib import Path
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from rockjax._checks import as_float, concrete, require_instance, require_number, texts
from rockjax._excitations.wavelets import MavroeidisPapageorgiou
from rockjax._programs.program import KeptProgram
from rockjax._text.reading import read_text
from rockjax._units import DEGREE, UNITS

from .convert import AnyMotion, as_motions
from .motion import Motion

COLUMNS = ("A", "f_p", "gamma", "nu")
QUANTITIES = ("velocity", "displacement")
PERIODS = (0.3, 12.0)  # range of the periods of pulses [s]; the upper limit is at most the record's duration
OSCILLATIONS = (1.05, 1.5, 2.0, 3.0, 5.0)  # initial values of γ
FREQUENCIES = 40
STARTS = 4


class PulseTable(NamedTuple):
    """Pulses with names.

    - `pulses`: a batch of [`rockjax.MavroeidisPapageorgiou`][] with fields of shape (k,); `names`: of each
    """

    pulses: MavroeidisPapageorgiou
    names: tuple[str, ...]


def read_pulses(path: str | Path) -> PulseTable:
    """Read a table of Mavroeidis–Papageorgiou pulses (host).

    The file is a CSV with the columns `A` [m/s] or `A_cm_s` [cm/s], `f_p` [Hz], `gamma` [–], `nu` [rad] or
    `nu_deg` [°], and optionally `name`. Lines that begin with # are comments. Raises a `ValueError` that
    names pulse and column for anything else, and for pulses outside their ranges.
    """
    path = Path(path)
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    rows = list(csv.DictReader(line for line in lines if not line.lstrip().startswith("#")))
    if not rows:
        raise ValueError(f"{path}: holds no pulses; columns are {', '.join(COLUMNS)}")
    heads = {head.strip() for head in rows[0] if head}
    other = {"A": ("A_cm_s", UNITS["cm/s"].factor), "nu": ("nu_deg", DEGREE)}
    values = {}
    for name in COLUMNS:
        found, factor = (name, 1.0) if name in heads else other.get(name, (name, 1.0))
        if found not in heads:
            known = " or ".join(filter(None, (name, other.get(name, ("",))[0])))
            raise ValueError(f"{path}: column {known} is missing; the columns are {', '.join(sorted(heads))}")
        values[name] = factor * np.array([_number(path, k, found, row) for k, row in enumerate(rows)])
    names = [str(row.get("name") or k + 1).strip() for k, row in enumerate(rows)]
    return PulseTable(MavroeidisPapageorgiou(**values), texts("read_pulses", "names", names))


def _number(path: Path, k: int, column: str, row: dict) -> float:
    text = {str(head).strip(): value for head, value in row.items()}.get(column)
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{path}: pulse {k + 1}: {column} must be a number, got {text!r}")
    return value


@dataclasses.dataclass(frozen=True)
class PulseFit:
    """The pulse in a record.

    - `pulse`: centred on t = 0, as all of its kind; `time`: time of its centre in the record [s]
    - `share`: of the energy ∫v² dt of the record that the pulse explains, or of ∫d² dt [–]
    - `quantity`: the fitted quantity, `"velocity"` or `"displacement"`
    """

    pulse: MavroeidisPapageorgiou
    time: Float[Array, ""]
    share: Float[Array, ""]
    quantity: str

    def velocity(self, times) -> Float[Array, " n"]:
        """Return v of the pulse at times of the record, shape (n,) [m/s]."""
        return _velocity(self.pulse, jnp.asarray(times, float) - self.time)

    def residual(self, motion: Motion) -> Motion:
        """Return the motion less the pulse (host)."""
        pulse = np.asarray(self.pulse(jnp.asarray(motion.time) - self.time))
        return dataclasses.replace(motion, acceleration=motion.acceleration - pulse)

    def rest(self, motion: Motion) -> Motion:
        """Former name of `residual`."""
        warnings.warn("PulseFit.rest is called PulseFit.residual now", DeprecationWarning, stacklevel=2)
        return self.residual(motion)

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
    """Fit a Mavroeidis–Papageorgiou pulse to a record, by least squares on its velocity or displacement
    (host).

    - `motion`: a [`rockjax.Motion`][] or [`rockjax.Record`][], from rest
    - `quantity`: the fitted quantity; the displacement weighs long periods more, and needs a record with a
      correct displacement
    - `shortest`, `longest`: range of initial periods 1/f_p [s]

    For each of many periods and numbers of oscillations the best place in the record is found by correlation;
    least squares start from the best of them (Levenberg–Marquardt). For derivatives of the pulse by the
    samples see [`rockjax.refit_pulse`][]. Raises `ValueError` for other motions, for one that is zero, and
    for invalid periods.
    """
    owner = "fit_pulse"
    found = as_motions(owner, motion)
    if len(found) != 1:
        raise ValueError(f"{owner}: motion must be one motion, got {len(found)}; call it once for each")
    if quantity not in QUANTITIES:
        raise ValueError(f"{owner}: quantity must be 'velocity' or 'displacement', got {quantity!r}")
    shortest = require_number(owner, "shortest", shortest, lambda v: v > 0, "finite and > 0 s")
    longest = require_number(
        owner, "longest", longest, lambda v: v > shortest, "finite and longer than shortest"
    )
    one = found[0]
    if not np.any(one.velocity):
        raise ValueError(f"{owner}: {one.name} is zero throughout")
    longest = max(min(longest, one.duration), 1.0001 * shortest)
    starts = _starts(one.velocity, one.dt, np.geomspace(1 / longest, 1 / shortest, FREQUENCIES))
    # Equally many for every record, so that one program serves all.
    starts += starts[:1] * (STARTS - len(starts))
    stacked_starts = jax.tree.map(lambda *ys: np.stack(ys), *starts)
    found = _refit_stacked(one.acceleration, one.dt, stacked_starts, quantity=quantity)
    form = jax.tree.structure(dataclasses.replace(starts[0], quantity=quantity))
    fits = jax.tree.unflatten(form, [np.asarray(y) for y in found])
    best = int(np.nanargmax(fits.share))
    return jax.tree.map(lambda y: as_float(y[best]), fits)


def _refit_leaves(acceleration, dt, starts: PulseFit, *, quantity: str) -> list[Array]:
    fits = jax.vmap(lambda start: refit_pulse(acceleration, dt, start, quantity=quantity))(starts)
    return jax.tree.leaves(fits)  # a tree of modules cannot be returned


_refit_stacked = KeptProgram(_refit_leaves)


def _starts(velocity: np.ndarray, dt: float, frequencies: np.ndarray) -> list[PulseFit]:
    """Return the best pulses of a grid of periods and numbers of oscillations, each at its best place, one
    for a period."""
    total = float(velocity @ velocity)
    best = [max(_best_place(velocity, dt, f, gamma) for gamma in OSCILLATIONS) for f in frequencies]
    shares = np.array([explained for explained, *_ in best]) / total
    # Local maxima of the share over the period.
    maxima = [k for k in range(len(best)) if shares[k] == shares[max(k - 1, 0) : k + 2].max()]
    found = []
    for k in sorted(maxima, key=lambda k: -shares[k])[:STARTS]:
        _, time, A, gamma, nu = best[k]
        pulse = MavroeidisPapageorgiou(A, float(frequencies[k]), gamma, nu)
        found.append(PulseFit(pulse, as_float(time), as_float(shares[k]), "velocity"))
    return found


def _best_place(velocity: np.ndarray, dt: float, f_p: float, gamma: float) -> tuple[float, ...]:
    """Return Σv² that a pulse explains at its best place, the time of its centre, A, γ and ν."""
    from scipy.signal import fftconvolve

    half = math.floor(0.5 * gamma / f_p / dt)
    phase = 2 * math.pi * f_p * dt * np.arange(-half, half + 1)
    window = 0.5 * (1 + np.cos(phase / gamma))
    shapes = np.stack([window * np.cos(phase), -window * np.sin(phase)])
    # Normal equations at every place; they are diagonal because the shapes are even and odd.
    sides = np.stack([fftconvolve(velocity, shape[::-1], mode="full") for shape in shapes])
    sizes = np.maximum(np.sum(shapes**2, axis=1), 1e-300)[:, None]
    explained = np.sum(sides**2 / sizes, axis=0)
    at = int(np.argmax(explained))
    a, b = (sides / sizes)[:, at]
    return float(explained[at]), (at - half) * dt, math.hypot(a, b), gamma, math.atan2(b, a)


def refit_pulse(
    acceleration: Float[Array, " n"],
    dt,
    start: PulseFit,
    *,
    quantity: str | None = None,
) -> PulseFit:
    """Refine a pulse by least squares: differentiable with respect to the samples, under `jit` and `vmap`.

    - `acceleration`: of the record, linear between samples, shape (n,) [m/s²]; `dt`: its interval [s]
    - `start`: from [`rockjax.fit_pulse`][]; `quantity`: the fitted quantity, by default that of `start`

    Derivatives are those of the implicit function theorem at the least squares.
    """
    import optimistix as optx

    quantity = quantity or start.quantity
    require_instance("refit_pulse", "start", start, PulseFit, "a rockjax.PulseFit")
    acceleration = jnp.asarray(acceleration, float)
    t = dt * jnp.arange(acceleration.shape[-1], dtype=float)
    target = _integral(acceleration, dt)
    if quantity == "displacement":
        # The integral of a parabola between samples.
        parts = dt * (0.5 * (target[1:] + target[:-1])) - dt**2 / 12 * jnp.diff(acceleration)
        target = jnp.concatenate([jnp.zeros(1), jnp.cumsum(parts)])
    size = jax.lax.stop_gradient(jnp.max(jnp.abs(target)))
    shape = _velocity if quantity == "velocity" else _displacement

    def residual(y, target):
        return (shape(_pulse(y), t - y[4]) - target) / size

    pulse = start.pulse
    y = jnp.stack([pulse.A, jnp.log(pulse.f_p), jnp.log(pulse.gamma - 1), pulse.nu, jnp.asarray(start.time)])
    solver = optx.LevenbergMarquardt(1e-10, 1e-10)
    found = optx.least_squares(residual, solver, jax.lax.stop_gradient(y), target, max_steps=200, throw=False)
    remainder = residual(found.value, target)
    share = 1 - jnp.sum(remainder**2) / jnp.sum((target / size) ** 2)
    return PulseFit(_normalise(_pulse(found.value)), found.value[4], share, quantity)


def _integral(acceleration: Float[Array, " n"], dt) -> Float[Array, " n"]:
    parts = 0.5 * dt * (acceleration[1:] + acceleration[:-1])
    return jnp.concatenate([jnp.zeros(1), jnp.cumsum(parts)])


def _pulse(y: Float[Array, " 5"]) -> MavroeidisPapageorgiou:
    return MavroeidisPapageorgiou(y[0], jnp.exp(y[1]), 1 + jnp.exp(y[2]), y[3])


def _normalise(pulse: MavroeidisPapageorgiou) -> MavroeidisPapageorgiou:
    """Return an equal pulse with A ≥ 0 and −π < ν ≤ π."""
    phase = jnp.where(pulse.A < 0, pulse.nu + math.pi, pulse.nu)
    nu = phase - 2 * math.pi * jax.lax.stop_gradient(jnp.ceil(phase / (2 * math.pi) - 0.5))
    return dataclasses.replace(pulse, A=jnp.abs(pulse.A), nu=nu)


def _velocity(pulse: MavroeidisPapageorgiou, t: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return v of the pulse, shape (n,) [m/s]."""
    phase = 2 * math.pi * pulse.f_p * t
    inside = jnp.abs(t) <= 0.5 * pulse.gamma / pulse.f_p
    shape = 0.5 * (1 + jnp.cos(phase / pulse.gamma)) * jnp.cos(phase + pulse.nu)
    return jnp.where(inside, pulse.A * shape, 0.0)


def _displacement(pulse: MavroeidisPapageorgiou, t: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return ∫v dt from before the pulse, shape (n,) [m]."""
    half, omega = 0.5 * pulse.gamma / pulse.f_p, 2 * math.pi * pulse.f_p

    def integral(t):
        terms = ((0.5, omega), (0.25, omega * (1 + 1 / pulse.gamma)), (0.25, omega * (1 - 1 / pulse.gamma)))
        return sum(
            (weight / rate * jnp.sin(rate * t + pulse.nu) for weight, rate in terms), jnp.zeros_like(t)
        )

    inside = jnp.clip(t, -half, half)
    return pulse.A * (integral(inside) - integral(-half))
