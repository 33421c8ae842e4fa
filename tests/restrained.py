"""Independent implementation of podiums: the Lagrangian in SI units with virtual work, SciPy's DOP853.

Equations and events are written separately; only the parameters of a structure come from the package. There
are two columns of 700 kg. Each has a tendon (N, N/m), a damper (N(s/m)^ν) and an inerter (kg) over both
joints. Modes of a superstructure are parallel oscillators on the beam. Vertical ground acceleration is added
to gravity in all weights.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import rockjax as rj

COLUMNS, COLUMN = 2, 700.0  # number, mass [kg]
G = 9.80665


@dataclasses.dataclass
class Frame:
    """Parameters of a podium: the ratios of the model, and dimensionless parameters of devices."""

    alpha: float = 0.15
    R: float = 1.5
    gamma: float = 10.0
    lam: float = 1 / 3
    modes: tuple = ()  # of (η, T, ζ)
    residual: float = 0.0  # mass of the superstructure that moves with the beam
    shapes: tuple = ()  # Γφ of the floors, each over the modes
    tau: float = 0.0
    kappa: float = 0.0
    delta: float = 0.0
    nu: float = 1.0
    mu: float = 0.0
    # Restitution; by default from the angular momentum, with the top masses moving with the beam.
    e: float | None = None
    g: float = G

    @property
    def p(self):
        return math.sqrt(3 * self.g / (4 * self.R))

    @property
    def restitution(self):
        if self.e is not None:
            return self.e
        top = self.residual + sum(m[0] for m in self.modes)
        s2 = math.sin(self.alpha) ** 2
        after = 1 + self.lam + 4 * (self.gamma + top) + 4 * self.mu * s2
        before = after - 2 * s2 * (1 + 4 * (self.gamma + top + self.mu))
        return before / after


@dataclasses.dataclass
class Answer:
    peak: float = 0.0  # max|θ|/α
    peak_time: float = math.nan
    deformation: Any = 0.0  # first mode
    shear: Any = 0.0
    deformations: Any = 0.0  # all modes
    drifts: Any = 0.0  # each story
    floors: Any = 0.0  # absolute accelerations
    uplift_time: float = math.nan
    overturn_time: float = math.nan
    impacts: list = dataclasses.field(default_factory=list)
    damper: float = 0.0  # energy dissipated by dampers, divided by N m_c
    time: float = math.nan


class _Motion:
    """Equations of one frame under one ground motion, with the state (θ, θ̇, u_i, u̇_i, energy dissipated by
    dampers)."""

    def __init__(self, frame: Frame, horizontal: Callable, vertical: Callable):
        f, m = frame, COLUMN
        self.frame, self.h, self.v = frame, horizontal, vertical
        self.n = len(f.modes)
        self.beam, self.tops = (
            (f.gamma + f.residual) * COLUMNS * m,
            np.array([k[0] for k in f.modes]) * COLUMNS * m,
        )
        self.w = np.array([2 * math.pi / k[1] for k in f.modes])
        self.z = np.array([k[2] for k in f.modes])
        self.P, self.K = f.tau * m * f.g, f.kappa * m * f.g / f.R
        self.C, self.b = f.delta * m * f.g / (f.R * f.p) ** f.nu, f.mu * m
        self.half = self.beam + 0.5 * COLUMNS * m

    def springs(self, s, y):
        """Return the force of each mode on the beam divided by the modal mass, and the deformation of the
        mode."""
        f, n = self.frame, self.n
        psi = s * f.alpha - y[0]
        u_b, v_b = 2 * f.R * (s * math.sin(f.alpha) - math.sin(psi)), 2 * f.R * y[1] * math.cos(psi)
        d, rate = y[2 : 2 + n] - u_b, y[2 + n : 2 + 2 * n] - v_b
        return self.w**2 * d + 2 * self.z * self.w * rate, d

    def rocking(self, t, y, s):
        f, n = self.frame, self.n
        theta, omega = y[0], y[1]
        psi = s * f.alpha - theta
        sn, cs, a, weight = math.sin(psi), math.cos(psi), self.h(t), f.g + self.v(t)
        spring, _ = self.springs(s, y)
        # ℓ = 4R sin α sin(σθ/2), its first two derivatives with respect to θ, and the forces of the devices
        length = 4 * f.R * math.sin(f.alpha) * math.sin(0.5 * s * theta)
        by = 2 * s * f.R * math.sin(f.alpha) * math.cos(0.5 * theta)
        by2 = -f.R * math.sin(f.alpha) * math.sin(0.5 * s * theta)
        rate = by * omega
        damper = self.C * abs(rate) ** f.nu * np.sign(rate)
        pull = COLUMNS * (self.P + self.K * length + damper)
        top = self.tops.sum()
        inertia = 4 * f.R**2 * self.beam + COLUMNS * COLUMN * f.R**2 * (1 + f.lam) + 4 * f.R**2 * top * sn**2
        inertia += COLUMNS * self.b * by**2
        moment = 4 * f.R**2 * top * omega**2 * cs * sn - 2 * f.R * weight * (top + self.half) * sn
        moment += -2 * f.R * a * self.half * cs + 2 * f.R * float(self.tops @ spring) * cs
        moment += -pull * by - COLUMNS * self.b * by * by2 * omega**2
        taken = damper * rate / COLUMN
        return np.concatenate([[omega, moment / inertia], y[2 + n : 2 + 2 * n], -a - spring, [taken]])

    def contact(self, t, y, s=0):
        n = self.n
        u, v = y[2 : 2 + n], y[2 + n : 2 + 2 * n]
        return np.concatenate([[0.0, 0.0], v, -self.h(t) - 2 * self.z * self.w * v - self.w**2 * u, [0.0]])

    def spare(self, t, y):
        """Return the threshold minus the demand (≥ 0 in full contact), and the demand, as accelerations of
        the beam and half of the columns."""
        n = self.n
        spring = self.w**2 * y[2 : 2 + n] + 2 * self.z * self.w * y[2 + n : 2 + 2 * n]
        q = self.h(t) - float(self.tops @ spring) / self.half
        weight = (self.frame.g + self.v(t)) * (self.tops.sum() + self.half) + COLUMNS * self.P
        return math.tan(self.frame.alpha) * weight / self.half - abs(q), q


def _event(function: Any, direction: int, terminal: bool = True) -> Any:
    function.direction, function.terminal = direction, terminal
    return function


def simulate(
    frame: Frame,
    end,
    horizontal=lambda t: 0.0,
    vertical=lambda t: 0.0,
    *,
    breaks=(),
    start=0.0,
    state=(),
    limit=None,
    rest=1e-12,
    watch: Any = None,
) -> Answer:
    """Solve a scene from `start` to `end`, or until |θ|/α = `limit`.

    After every stretch between events, `watch.stretch(mode, found, clip)` receives the contact mode, SciPy's
    solution and a function that clips times to the stretch. `watch.impact(mode, state)` is called before
    every impact.
    """
    m, f, out = _Motion(frame, horizontal, vertical), frame, Answer()
    y = np.zeros(3 + 2 * m.n)
    y[: len(state)] = state
    limit = f.alpha if limit is None else limit
    t, s = start, int(np.sign(y[0]) or np.sign(y[1]))
    out.peak, out.peak_time = abs(y[0]) / f.alpha, start
    stops = sorted({b for b in breaks if start < b < end} | {end})
    eps = 1e-12
    while t < end:
        stop = next(b for b in stops if b > t)
        clip = lambda time, lo=t, hi=stop: min(max(time, lo + eps), hi - eps)
        if s == 0 and m.spare(clip(t), y)[0] < 0:
            s = -int(np.sign(m.spare(clip(t), y)[1]))
            out.uplift_time = t if math.isnan(out.uplift_time) else out.uplift_time
        if s:
            # A power law has no slope at zero rate, so the integration restarts where the columns turn.
            events = [
                _event(lambda time, yy, s=s: s * yy[0], -1),
                _event(lambda time, yy, s=s: s * yy[0] - limit, 1),
                _event(lambda time, yy: yy[1], -s, f.nu < 1 and y[1] != 0),
            ]
            kick = m.rocking(clip(t), y, s)[1]
            hop = abs(y[1] / kick) if y[0] == 0 and y[1] * kick < 0 else 1.0
            first = min(1e-3 / f.p if f.nu == 1 else 1e-9, 0.3 * hop, stop - t)
            flow = lambda time, yy, s=s, clip=clip: m.rocking(clip(time), yy, s)
        else:
            events = [_event(lambda time, yy, clip=clip: -m.spare(clip(time), yy)[0], 1)]
            first, flow = min(1e-3, stop - t), lambda time, yy, clip=clip: m.contact(clip(time), yy)
        found = solve_ivp(
            flow, (t, stop), y, method="DOP853", rtol=3e-14, atol=1e-16, events=events, first_step=first,
            max_step=0.02, dense_output=m.n > 0 or watch is not None,
        )  # fmt: skip
        if watch is not None:
            watch.stretch(s, found, clip)
        if s:
            _turns(out, f, found)
        _extremes(out, m, s, found, clip)
        t, y = found.t[-1], found.y[:, -1].copy()
        if abs(y[0]) / f.alpha > out.peak:
            out.peak, out.peak_time = abs(y[0]) / f.alpha, t
        if found.status != 1:
            t = stop
        elif not s:
            s = -int(np.sign(m.spare(clip(t), y)[1]))
            y[0] = y[1] = 0.0
            out.uplift_time = t if math.isnan(out.uplift_time) else out.uplift_time
        elif len(found.t_events[1]):
            out.overturn_time, out.peak, out.peak_time = t, limit / f.alpha, t
            break
        elif len(found.t_events[0]):
            out.impacts.append(t)
            if watch is not None:
                watch.impact(s, y)
            y[0], y[1] = 0.0, max(f.restitution, 0.0) * y[1]
            s = int(np.sign(y[1])) if abs(y[1]) > rest * f.p * f.alpha else 0
            y[1] = y[1] if s else 0.0
        else:
            y[1] = 0.0  # at a turning point
    out.damper, out.time = y[-1], t
    return out


def _turns(out: Answer, f: Frame, found) -> None:
    for time, yy in zip(found.t_events[2], found.y_events[2], strict=True):
        if abs(yy[0]) / f.alpha > out.peak:
            out.peak, out.peak_time = abs(yy[0]) / f.alpha, time


def _extremes(out: Answer, m: _Motion, s: int, found, clip) -> None:
    """Return the largest deformations, shear, drifts and floor accelerations, from samples between the
    steps."""
    if not m.n:
        return
    t = np.linspace(found.t[0], found.t[-1], 60 * len(found.t))
    states = found.sol(t).T
    springs = [m.springs(s, y) for y in states]
    force, d = (np.array(part) for part in zip(*springs, strict=True))
    base = np.zeros(len(t))
    if m.frame.residual or m.frame.shapes:  # mass on the beam feels its acceleration
        flow = m.rocking if s else m.contact
        rates = np.array([flow(clip(time), y, s) for time, y in zip(t, states, strict=True)])
        psi = s * m.frame.alpha - states[:, 0]
        base = 2 * m.frame.R * (rates[:, 1] * np.cos(psi) + states[:, 1] ** 2 * np.sin(psi))
        base += np.array([m.h(clip(time)) for time in t])
    residual = m.frame.residual * COLUMNS * COLUMN
    total = m.tops.sum() + residual
    quantities = {"deformation": d[:, 0], "deformations": d, "shear": (force @ m.tops - residual * base)}
    quantities["shear"] /= total * m.frame.g
    if m.frame.shapes:
        shapes = np.array(m.frame.shapes)
        quantities["drifts"] = d @ np.diff(shapes, axis=0, prepend=0.0).T
        quantities["floors"] = force @ shapes.T - np.outer(base, 1 - shapes.sum(axis=1))
    for name, values in quantities.items():
        of_each = [_largest(np.abs(column)) for column in np.reshape(values, (len(t), -1)).T]
        best = np.array(of_each) if values.ndim > 1 else of_each[0]
        setattr(out, name, np.maximum(getattr(out, name), best))


def _largest(values: np.ndarray) -> float:
    """Return the maximum from samples, by a parabola through the largest and its neighbours."""
    k = int(values.argmax())
    if 0 < k < len(values) - 1:
        a, b, c = values[k - 1 : k + 2]
        return b + (a - c) ** 2 / (8 * (2 * b - a - c)) if 2 * b > a + c else b
    return values[k]


def frame_of(podium: rj.Podium) -> Frame:
    """Return the frame with the parameters of a podium."""
    top, numbers = podium.superstructure, {}
    rows: tuple[tuple[float, ...], ...] = ()
    gamma, residual = float(podium.gamma), 0.0
    if isinstance(top, rj.Rigid):
        gamma += float(top.eta)
    elif isinstance(top, rj.Elastic):
        rows = ((float(top.eta), float(top.T_s), float(top.zeta)),)
    elif isinstance(top, rj.Modes | rj.ShearBuilding):
        modes: Any = top.resolved()
        columns = modes.eta, modes.T_s, np.broadcast_to(modes.zeta, modes.eta.shape)
        rows = tuple(tuple(map(float, row)) for row in zip(*columns, strict=True))
        residual = float(modes.residual or 0.0)
    for device in podium.restrainers:
        if isinstance(device, rj.Tendon):
            numbers |= {"tau": float(device.prestress), "kappa": float(device.stiffness)}
        elif isinstance(device, rj.Damper):
            numbers |= {"delta": float(device.coefficient), "nu": float(device.exponent)}
        elif isinstance(device, rj.Inerter):
            numbers |= {"mu": float(device.inertance)}
    alpha, R, lam, g = (float(getattr(podium, name)) for name in ("alpha", "R", "lam", "g"))
    e = float(podium.restitution_factor)
    return Frame(alpha, R, gamma, lam, rows, residual, e=e, g=g, **numbers)


def ricker(a_p: float, T_p: float) -> Callable:
    """Return a symmetric Ricker pulse, centred at 0."""
    x = lambda t: (math.pi * t / T_p) ** 2
    return lambda t: a_p * (1 - 2 * x(t)) * math.exp(-x(t))


def one_sine(a_p: float, T_p: float) -> Callable:
    """Return one full sine that starts at 0."""
    return lambda t: a_p * math.sin(2 * math.pi * t / T_p) if 0 <= t <= T_p else 0.0


def check_peaks(found, answer, frame: Frame, rotation: float) -> None:
    """Compare peaks and first uplift with the independent integration; `rotation`: tolerance of the
    rotation."""
    assert 0.1 < answer.peak < 0.95
    assert abs(float(found.peak_rotation) - answer.peak) <= rotation
    assert abs(float(found.uplift_time) - answer.uplift_time) <= 1e-11
    assert abs(float(found.peak_deformation) - answer.deformation) <= 1e-9
    if frame.modes:
        assert abs(float(found.peak_shear) - answer.shear) <= 1e-8
