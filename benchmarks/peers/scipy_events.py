r"""Solution by SciPy: `solve_ivp` with terminal events, one phase of contact after another.

| phase | state | ends by |
|---|---|---|
| full contact, rigid | – | uplift, a root of the pulse: nothing is integrated |
| full contact, elastic | u_t, u̇_t | uplift: the demand reaches its limit |
| rocking, rigid | θ, θ̇ | θ = 0 (impact), \|θ\| = α (overturned) |
| rocking, elastic | θ, θ̇, u_t, u̇_t | the same |

After the pulse, a phase also ends if the energy is too small for another uplift or a larger peak.

`solve_ivp` finds an event only if its function changes sign between the ends of a step, and a rocking phase
starts at the zero of its event. Therefore the first step of a phase follows from the flight time, and other
steps are limited. If an extreme of θ shows that θ changed sign inside a step, the phase is repeated to there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from ..measure import Family, G  # noqa: TID252

REST_VELOCITY = 1e-6  # a podium that is slower after an impact is at rest [p α]
MAX_PHASES = 10_000


def _event(function: Any, terminal: bool = True, direction: float = -1) -> Callable:
    function.terminal, function.direction = terminal, direction
    return function


class Podium:
    """Equations of motion and energy, divided by N m_c, of a family."""

    def __init__(self, family: Family) -> None:
        self.alpha, self.R, self.lam, self.zeta = family.alpha, family.R, family.lam, family.zeta
        self.rigid = family.T_s == 0
        self.omega = 0.0 if self.rigid else 2 * math.pi / family.T_s
        self.gamma = family.gamma + family.eta if self.rigid else family.gamma
        self.eta = 0.0 if self.rigid else family.eta
        self.p = math.sqrt(0.75 * G / self.R)
        total = self.gamma + self.eta
        loss = math.sin(self.alpha) ** 2 * (2 * total + 0.5) / (0.25 * (1 + self.lam) + total)
        self.restitution = max(1 - loss, 0.0)
        self.uplift = G * math.tan(self.alpha) * (1 + 2 * total) / (1 + 2 * self.gamma)
        size = 2 * self.R * math.sin(self.alpha)
        units = [self.alpha, self.p * self.alpha, size, max(self.omega, self.p) * size]
        self.units = np.array(units[:2] if self.rigid else units)

    def demand(self, a: float, u: float, w: float) -> float:
        return a - (self.omega**2 * u + 2 * self.zeta * self.omega * w) * 2 * self.eta / (1 + 2 * self.gamma)

    def contact(self, a: float, u: float, w: float) -> list[float]:
        return [w, -a - 2 * self.zeta * self.omega * w - self.omega**2 * u]

    def rocking(self, a: float, y: np.ndarray, side: int) -> list[float]:
        th, v, *top = y.tolist()
        psi = side * self.alpha - th
        s, c = math.sin(psi), math.cos(psi)
        p2, gamma, eta, omega = self.p**2, self.gamma, self.eta, self.omega
        inertia = 3 * gamma + 0.75 * (1 + self.lam) + 3 * eta * s * s
        moment = -p2 * (2 * eta + 2 * gamma + 1) * s - a / G * p2 * (2 * gamma + 1) * c
        if self.rigid:
            return [v, moment / inertia]
        u, w = top
        force = omega**2 * (u - 2 * self.R * (side * math.sin(self.alpha) - s))
        force += 2 * self.zeta * omega * (w - 2 * self.R * v * c)
        return [v, (moment + 3 * eta * (v * v * s * c + c * force / (2 * self.R))) / inertia, w, -a - force]

    def energy(self, y: np.ndarray, side: int) -> float:
        th, v, *top = y.tolist()
        psi = side * self.alpha - th
        s, c = math.sin(psi), math.cos(psi)
        kinetic = 0.5 * (1 + self.lam + 4 * self.gamma + 4 * self.eta * s * s) * (self.R * v) ** 2
        energy = kinetic + 2 * self.R * G * (self.eta + self.gamma + 0.5) * (c - math.cos(self.alpha))
        if self.rigid:
            return energy
        u, w = top
        stretch = u - 2 * self.R * (side * math.sin(self.alpha) - s)
        return energy + 0.5 * self.eta * (w**2 + (self.omega * stretch) ** 2)

    def potential_energy(self, peak: float) -> float:
        """Return the potential energy of a rotation."""
        return (
            2
            * self.R
            * G
            * (self.eta + self.gamma + 0.5)
            * (math.cos(self.alpha - peak) - math.cos(self.alpha))
        )

    def contact_energy(self) -> float:
        """Return the energy of an elastic superstructure from which vibration alone can lift the columns."""
        force = self.omega * math.sqrt(1 + 4 * self.zeta**2) * 2 * self.eta / (1 + 2 * self.gamma)
        return 0.5 * self.eta * (self.uplift / force) ** 2


def _next_lift(acceleration: Callable, t: float, T_p: float, threshold: float) -> float:
    """Return the first time from t on at which |ü_g| exceeds the threshold; inf if there is none."""
    if abs(acceleration(t)) > threshold:
        return t
    excess = lambda t: abs(acceleration(t)) - threshold
    crest, zero = math.sqrt(1.5) * T_p / math.pi, math.sqrt(0.5) * T_p / math.pi
    for low, high in ((-2.2 * T_p, -crest), (-zero, 0.0), (zero, crest)):  # where |ü_g| rises
        low = max(low, t)
        if low < high and excess(high) > 0:
            if excess(low) >= 0:
                return low
            root: Any = brentq(excess, low, high, xtol=1e-15, rtol=1e-15)  # pyright: ignore[reportArgumentType]
            return root
    return math.inf


def _scene(podium: Podium, a_p: float, T_p: float, rtol: float, method: str) -> tuple[float, bool]:
    alpha, p, omega, rigid = podium.alpha, podium.p, podium.omega, podium.rigid

    def acceleration(t: float) -> float:
        x = (math.pi * t / T_p) ** 2
        return a_p * (1 - 2 * x) * math.exp(-x)

    t, pulse_end, t_end = -2.2 * T_p, 2.2 * T_p, 2.2 * T_p + 30 / p
    options = {"method": method, "rtol": rtol}
    options["max_step"] = min(T_p / 4, 1 / p, math.inf if rigid else 2 / omega)
    y = np.zeros(len(podium.units))
    side, starts_at_zero, peak = 0, False, 0.0
    for _ in range(MAX_PHASES):
        if t >= t_end:
            return peak / alpha, False
        until, settles = (pulse_end, False) if t < pulse_end else (t_end, True)
        if side == 0:  # ------------------------------------------------------------------ full contact
            if rigid:
                t = _next_lift(acceleration, t, T_p, podium.uplift)
                if t >= pulse_end:
                    return peak / alpha, False
            else:
                enough = max(podium.potential_energy(peak), podium.contact_energy())
                if settles and podium.energy(y, 1) < enough:
                    return peak / alpha, False
                if abs(podium.demand(acceleration(t), y[2], y[3])) <= podium.uplift * (1 + 1e-14):
                    lift = lambda t, z: abs(podium.demand(acceleration(t), z[0], z[1])) - podium.uplift
                    events = [_event(lift, direction=1)]
                    if settles:
                        calm = lambda t, z, enough=enough: (
                            0.5 * podium.eta * (z[1] ** 2 + (omega * z[0]) ** 2) - enough
                        )
                        events.append(_event(calm))
                    s = solve_ivp(
                        lambda t, z: podium.contact(acceleration(t), *z.tolist()),
                        (t, until),
                        y[2:],
                        atol=rtol / 100 * podium.units[2:],
                        events=events,
                        **options,
                    )
                    t, y[2:] = s.t[-1], s.y[:, -1]
                    if settles and len(s.t_events[1]):
                        return peak / alpha, False
                    if not len(s.t_events[0]):
                        continue
            q = acceleration(t) if rigid else podium.demand(acceleration(t), y[2], y[3])
            side, starts_at_zero = (-1 if q > 0 else 1), True
            y[:2] = 0
            continue
        # ------------------------------------------------------------------------------------ rocking
        enough = podium.potential_energy(peak)
        if settles and podium.energy(y, side) < enough:
            return peak / alpha, False
        first = None
        if starts_at_zero:
            first = 1e-5 / p
            if y[1] != 0:
                push = podium.rocking(acceleration(t), y, side)[1]
                first = min(0.01 / p, abs(0.2 * y[1] / push) if push else math.inf)
            first = min(first, options["max_step"], 0.5 * (until - t))
        events = [  # zeros at the start of a phase do not count
            _event(lambda t, z, side, start=t: side * z[0] if t > start else 1.0),
            _event(lambda t, z, side: side * z[0] - alpha, direction=1),
            _event(
                lambda t, z, side, start=t: side * z[1] if t > start else 1.0, terminal=False, direction=0
            ),
        ]
        if settles:
            events.append(_event(lambda t, z, side, enough=enough: podium.energy(z, side) - enough))
        while True:
            s = solve_ivp(
                lambda t, z, side: podium.rocking(acceleration(t), z, side),
                (t, until),
                y,
                atol=rtol / 100 * podium.units,
                first_step=first,
                events=events,
                args=(side,),
                **options,
            )
            dips = [
                dip
                for dip, z in zip(s.t_events[2], s.y_events[2], strict=True)
                if t < dip < s.t[-1] and side * z[0] < 0
            ]
            if not dips:
                break
            until = dips[0]  # θ changed sign inside a step; end a step at this extreme
            first = first and min(first, 0.5 * (until - t))
        t, y, starts_at_zero = s.t[-1], s.y[:, -1].copy(), False
        if len(s.t_events[1]):
            return 1.0, True
        peak = max([peak, side * y[0]] + [side * z[0] for z in s.y_events[2]])
        if settles and len(s.t_events[3]):
            return peak / alpha, False
        if len(s.t_events[0]):  # impact
            y[0] = 0
            y[1] *= podium.restitution
            starts_at_zero = True
            if abs(y[1]) > REST_VELOCITY * p * alpha:
                side = 1 if y[1] > 0 else -1
            else:
                y[1] = 0
                q = acceleration(t) if rigid else podium.demand(acceleration(t), y[2], y[3])
                side = 0 if abs(q) <= podium.uplift else (-1 if q > 0 else 1)
    raise RuntimeError(f"more than {MAX_PHASES} phases for a_p = {a_p}, T_p = {T_p}")


def solve(family: Family, rtol: float, method: str = "DOP853") -> tuple[np.ndarray, np.ndarray]:
    """Return (max|θ|/α, at most 1; overturned) of all scenes, solved one after another.

    `method` is "DOP853" or "LSODA"; atol is rtol/100 in units of α, p α, 2R sin α, ….
    """
    podium = Podium(family)
    scenes = zip(family.a_p.tolist(), family.T_p.tolist(), strict=True)
    peak, overturned = zip(*(_scene(podium, a_p, T_p, rtol, method) for a_p, T_p in scenes), strict=True)
    return np.array(peak), np.array(overturned)
