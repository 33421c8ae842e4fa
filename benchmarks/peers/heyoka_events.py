"""Solution by heyoka: Taylor series in time, whose order follows from the tolerance, with event detection.

Each ODE system is compiled once for a tolerance; the podium, the pulse and the side of rocking are runtime
parameters. Uplift, impact and overturning are terminal events, handled between two propagations; the largest
rotations are non-terminal events, evaluated by dense output. `solve` solves one scene after another.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import heyoka as hy  # pyright: ignore[reportMissingImports]
import numpy as np
from scipy.special import lambertw

from ..measure import Family, G  # noqa: TID252

FALLING, RISING = hy.event_direction.negative, hy.event_direction.positive
UPLIFT = IMPACT = -1  # outcome of a propagation that ends at the first terminal event
OVERTURNED = -2  # outcome of a propagation that ends at the second terminal event
SUPPORT = 2.2  # the pulse is zero beyond ±SUPPORT·T_p
# Longest step in full contact, divided by T_p. Without it, steps from rest would pass over the pulse.
STRIDE = 0.25
# Values for θ = 0 and θ̇ = 0 at the start of a phase, because a root of an event there hides the next root.
TINY_ROTATION, TINY_RATE = 1e-40, 1e-20


def _acceleration(a_p: hy.expression, rate: hy.expression) -> hy.expression:
    """Return the symmetric Ricker pulse at the time of the integrator; rate = (π/T_p)²."""
    x = rate * hy.time * hy.time
    return a_p * (1.0 - 2.0 * x) * hy.exp(-x)


@functools.cache
def _contact(tol: float) -> hy.taylor_adaptive_dbl:
    """Return the integrator for full contact with parameters a_p, rate, ω_s², 2ζω_s, 2η/(1+2γ), q_up²."""
    u, w = hy.make_vars("u", "w")
    a_p, rate, stiffness, damping, ratio, q_up2 = (hy.par[i] for i in range(6))
    a = _acceleration(a_p, rate)
    f = stiffness * u + damping * w
    q = a - ratio * f
    uplift = hy.t_event(q * q - q_up2, direction=RISING, cooldown=0.0)
    return hy.taylor_adaptive(
        [(u, w), (w, -a - f)], [0.0] * 2, tol=tol, fast_math=True, pars=[0.0] * 6, t_events=[uplift]
    )


@functools.cache
def _rocking(rigid: bool, tol: float) -> tuple[hy.taylor_adaptive_dbl, list[float]]:
    """Return the integrator for rocking to the side σ, and the list to which it adds peaks of σθ.

    Its parameters are σ, σα, α, a_p, rate and the coefficients.
    """
    theta, v, u, w = hy.make_vars("theta", "v", "u", "w")
    par = [hy.par[i] for i in range(14)]
    side, side_alpha, alpha, a_p, rate = par[:5]
    a = _acceleration(a_p, rate)
    sin, cos = hy.sin(side_alpha - theta), hy.cos(side_alpha - theta)
    if rigid:
        weight, inertia = par[5:7]
        system = [(theta, v), (v, -(weight * sin + inertia * a * cos))]
    else:
        weight, inertia, mass, top, coupling, diameter, side_b, stiffness, damping = par[5:]
        f = stiffness * (u - side_b + diameter * sin) + damping * (w - diameter * v * cos)
        drive = cos * (top * v * v * sin - inertia * a + coupling * f) - weight * sin
        system = [(theta, v), (v, drive / (mass + top * sin * sin)), (u, w), (w, -a - f)]
    peaks: list[float] = []

    def peak(ta: hy.taylor_adaptive_dbl, time: float, _: int) -> None:
        ta.update_d_output(time)
        peaks.append(abs(ta.d_output[0]))

    ta = hy.taylor_adaptive(
        system,
        [0.0] * len(system),
        tol=tol,
        fast_math=True,
        pars=[0.0] * (7 if rigid else 14),
        t_events=[
            hy.t_event(side * theta, direction=FALLING, cooldown=0.0),
            hy.t_event(side * theta - alpha, direction=RISING, cooldown=0.0),
        ],
        nt_events=[hy.nt_event(side * v, peak, direction=FALLING)],
    )
    return ta, peaks


def _rigid_uplifts(family: Family, q_up: float) -> np.ndarray:
    """Return the times at which |ü_g| rises through q_up on the three lobes of every pulse, shape (n, 3).

    NaN for lobes that stay below. With x = (πt/T_p)², (1 − 2x) exp(−x) = ±q_up/a_p is solved by Lambert's W.
    """
    level = 0.5 * math.exp(0.5) * q_up / family.a_p
    outer, inner, centre = (lambertw(z, branch) for z, branch in ((-level, -1), (-level, 0), (level, 0)))
    x = 0.5 - np.stack([outer, centre, inner], axis=-1)
    x[level > math.exp(-1), ::2] = np.nan  # the side lobes stay below
    x[family.a_p <= q_up, 1] = np.nan
    time = np.sqrt(x.real) * [-1.0, -1.0, 1.0] * (family.T_p / math.pi)[:, None]
    return np.where(np.abs(time) < SUPPORT * family.T_p[:, None], time, np.nan)


class _Podium:
    """The podium of a family, and the solution of its scenes phase by phase."""

    def __init__(self, family: Family, rtol: float) -> None:
        alpha, R, lam = family.alpha, family.R, family.lam
        self.rigid = family.T_s == 0
        self.period = family.T_s
        omega = 0.0 if self.rigid else 2 * math.pi / family.T_s
        gamma, eta = (family.gamma + family.eta, 0.0) if self.rigid else (family.gamma, family.eta)
        p2 = 0.75 * G / R
        self.alpha, self.R, self.eta, self.p = alpha, R, eta, math.sqrt(p2)
        self.sin_alpha, self.cos_alpha = math.sin(alpha), math.cos(alpha)
        self.stiffness, self.damping = omega**2, 2 * family.zeta * omega
        self.ratio = 2 * eta / (1 + 2 * gamma)
        self.q_up = G * math.tan(alpha) * (1 + 2 * gamma + 2 * eta) / (1 + 2 * gamma)
        restitution_loss = self.sin_alpha**2 * (2 * gamma + 2 * eta + 0.5) / (0.25 * (1 + lam) + gamma + eta)
        self.restitution = max(0.0, 1 - restitution_loss)
        self.rest_speed = rtol * self.p * alpha
        # The root finder misses flights that are much shorter than the step, so after slow impacts the first
        # step is short.
        self.slow, self.hop = 1e-2 * self.p * alpha, 2 / (p2 * alpha)
        self.inertia = 0.5 * (1 + lam + 4 * gamma) * R * R
        self.lift = 2 * R * G * (eta + gamma + 0.5)

        self.rocking, self.peaks = _rocking(self.rigid, rtol)
        self.rocking.pars[2] = alpha
        mass, weight, drive = (
            3 * gamma + 0.75 * (1 + lam),
            p2 * (2 * eta + 2 * gamma + 1),
            p2 * (2 * gamma + 1) / G,
        )
        if self.rigid:
            self.rocking.pars[5:] = weight / mass, drive / mass
        else:
            self.rocking.pars[5:11] = weight, drive, mass, 3 * eta, 1.5 * eta / R, 2 * R
            self.rocking.pars[12:] = self.stiffness, self.damping
            self.contact = _contact(rtol)
            self.contact.pars[2:] = self.stiffness, self.damping, self.ratio, self.q_up**2

    def potential(self, theta: float) -> float:
        """Return the potential energy of the weights, divided by N m_c."""
        return self.lift * (math.cos(self.alpha - abs(theta)) - self.cos_alpha)

    def energy(self, side: float, theta: float, v: float, u: float, w: float) -> float:
        """Return the total energy, divided by N m_c."""
        sin, cos = math.sin(side * self.alpha - theta), math.cos(side * self.alpha - theta)
        stretch, rise = u - 2 * self.R * (side * self.sin_alpha - sin), 2 * self.R * v * sin
        energy = 0.5 * self.eta * (w * w + rise * rise + self.stiffness * stretch * stretch)
        return energy + self.inertia * v * v + self.lift * (cos - self.cos_alpha)

    def stays(self, u: float, w: float) -> bool:
        """Return True if free vibration in full contact has too little energy to lift the columns."""
        swing = (self.stiffness + self.damping**2) * (self.stiffness * u * u + w * w)
        return self.ratio**2 * swing < self.q_up**2

    def scene(self, a_p: float, T_p: float, uplifts: list[float]) -> tuple[float, bool]:
        """Return (largest |θ|, overturned). `uplifts`: times of `_rigid_uplifts`, for rigid scenes only."""
        rocking, state, pars, peaks = self.rocking, self.rocking.state, self.rocking.pars, self.peaks
        rate, excitation_end = (math.pi / T_p) ** 2, SUPPORT * T_p
        contact: Any = None
        swing: Any = None
        end = excitation_end + 30 / self.p
        pars[3:5] = a_p, rate
        if not self.rigid:
            contact, swing = self.contact, self.contact.state
            contact.pars[:2] = a_p, rate

        def demand() -> float:
            x = rate * t * t
            return a_p * (1 - 2 * x) * math.exp(-x) - self.ratio * (self.stiffness * u + self.damping * w)

        t, side, theta, v, u, w = -excitation_end, 0.0, 0.0, 0.0, 0.0, 0.0
        largest, energy_at_largest, hop = 0.0, 0.0, math.inf
        while t < end:
            if t >= excitation_end and self.energy(side, theta, v, u, w) < energy_at_largest:
                break
            if side == 0:
                if self.rigid:
                    t = min((later for later in uplifts if later > t), default=end)
                    if t == end:
                        break
                else:
                    if t >= excitation_end and self.stays(u, w):
                        break
                    contact.time = t
                    swing[0], swing[1] = u, w
                    stop = excitation_end if t < excitation_end else min(t + self.period, end)
                    outcome = int(contact.propagate_until(stop, max_delta_t=STRIDE * T_p)[0])
                    t, u, w = contact.time, float(swing[0]), float(swing[1])
                    if outcome != UPLIFT:
                        continue
                side = -math.copysign(1.0, demand())
            rocking.time = t
            pars[0], pars[1] = side, side * self.alpha
            state[0], state[1] = theta or side * TINY_ROTATION, v or side * TINY_RATE
            if not self.rigid:
                pars[11] = 2 * self.R * side * self.sin_alpha
                state[2], state[3] = u, w
            peaks.clear()
            outcome = int(
                rocking.propagate_until(min(t + hop, excitation_end if t < excitation_end else end))[0]
            )
            if outcome == OVERTURNED:
                return self.alpha, True
            t, theta, v = rocking.time, float(state[0]), float(state[1])
            if not self.rigid:
                u, w = float(state[2]), float(state[3])
            highest = max(peaks, default=0.0)
            if outcome == IMPACT:
                theta, v = 0.0, self.restitution * v
                if abs(v) > self.rest_speed:
                    side = -side
                    hop = abs(v) * self.hop if abs(v) < self.slow else math.inf
                else:
                    v, hop, q = 0.0, math.inf, demand()
                    side = 0.0 if abs(q) <= self.q_up else -math.copysign(1.0, q)
            else:
                highest = max(highest, abs(theta))
                hop *= 8
            if highest > largest:
                largest, energy_at_largest = highest, self.potential(highest)
        return min(largest, self.alpha), False


def solve(family: Family, rtol: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (max|θ|/α, at most 1; overturned) of every scene, solved one after another on one core."""
    podium = _Podium(family, rtol)
    uplifts = _rigid_uplifts(family, podium.q_up).tolist() if podium.rigid else [[]] * len(family)
    scenes = zip(family.a_p.tolist(), family.T_p.tolist(), uplifts, strict=True)
    peak, overturned = zip(*(podium.scene(*scene) for scene in scenes), strict=True)
    return np.array(peak) / family.alpha, np.array(overturned)
