"""Independent solution for podiums with round column ends: Eqs. (R1)–(R4), SciPy's DOP853 with events.

Arcs of radius r_c continue both flat faces of a column tangentially at its corners. A column lifts like one
with flat ends, then rolls on the ground and under the beam without sliding. Masses are divided by N m_c.
There are no restrainers.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import CubicHermiteSpline

from tests.restrained import G


@dataclasses.dataclass
class RoundFrame:
    """Parameters of a podium whose columns have flat faces of width 2B and the height 2H.

    - `alpha`, `R`, `gamma`, `lam`: parameters, with α and R of the flat faces
    - `radius`: r_c [m]
    - `eta`, `T`, `zeta`: of an elastic superstructure
    - `positions`, `beam_height`, `top_height`: x_i, h_b and h above the tops of the columns [m], for forces
    """

    alpha: float = 0.15
    R: float = 1.5
    gamma: float = 10.0
    radius: float = 0.0
    lam: float = 1 / 3
    eta: float = 0.0
    T: float = 1.0
    zeta: float = 0.05
    positions: tuple[float, ...] = (-3.0, 3.0)
    beam_height: float = 0.0
    top_height: float = 0.0

    @property
    def B(self) -> float:
        return self.R * math.sin(self.alpha)

    @property
    def H(self) -> float:
        return self.R * math.cos(self.alpha)

    @property
    def overturning(self) -> float:
        """Overturning angle θ_o, (R3)."""
        return math.atan(self.B / (self.H - self.radius))

    @property
    def restitution(self) -> float:
        """Velocity factor e, Eq. (27), in which the top mass moves with the beam."""
        carried = self.gamma + self.eta
        return 1 - math.sin(self.alpha) ** 2 * (2 * carried + 0.5) / (0.25 * (1 + self.lam) + carried)

    # ------------------------------------------------------------------------------------------ kinematics
    def arms(self, theta, s: int):
        """Return L and K of (R1)."""
        flat = self.H - self.radius
        L = self.radius + s * self.B * np.sin(theta) + flat * np.cos(theta)
        return L, s * self.B * np.cos(theta) - flat * np.sin(theta)

    def displacement(self, theta, s: int):
        """Return u_b, (R1)."""
        rolled = self.radius * theta + s * self.B * (1 - np.cos(theta))
        return 2 * (rolled + (self.H - self.radius) * np.sin(theta))

    def lift(self, theta, s: int):
        """Return v_b, (R1)."""
        return 2 * (s * self.B * np.sin(theta) - (self.H - self.radius) * (1 - np.cos(theta)))

    # -------------------------------------------------------------------------------------------- dynamics
    def spring(self, y, s: int):
        """Return ω²(u − u_b) + 2ζω(u̇ − u̇_b) in states (θ, θ̇, u, u̇)."""
        w, L = 2 * math.pi / self.T, self.arms(y[0], s)[0]
        return w**2 * (y[2] - self.displacement(y[0], s)) + 2 * self.zeta * w * (y[3] - 2 * L * y[1])

    def angular(self, y, s: int, ground):
        """Return θ̈, (R2)."""
        theta, omega = y[0], y[1]
        L, K = self.arms(theta, s)
        beam, eta = 1 + 4 * self.gamma, self.eta
        inertia = self.lam * self.R**2 + beam * (L**2 + K**2) + 4 * eta * K**2
        bent = beam * self.radius * K + 4 * eta * K * (self.radius - L)
        load = (1 + 2 * self.gamma + 2 * eta) * G * K + (1 + 2 * self.gamma) * ground * L
        pull = 2 * L * eta * self.spring(y, s) if eta else 0.0
        return -(bent * omega**2 + load - pull) / inertia

    def rate(self, t, y, s: int, ground: Callable):
        a = ground(t)
        spring = self.spring(y, s) if self.eta else 0.0
        if s == 0:
            return np.array([0.0, 0.0, y[3], -a - spring])
        return np.array([y[1], self.angular(y, s, a), y[3], -a - spring])

    def excess(self, t, y, ground: Callable):
        """Return |q| minus its threshold, Eq. (9), and q."""
        spring = self.spring((0.0, 0.0, y[2], y[3]), 1) if self.eta else 0.0
        half = 1 + 2 * self.gamma
        q = ground(t) - 2 * self.eta / half * spring
        return abs(q) - G * math.tan(self.alpha) * (half + 2 * self.eta) / half, q

    def quarter_period(self, theta: float) -> float:
        """Return the time from rest at θ > 0 to θ = 0 without a superstructure, by quadrature (x = θ −
        z²)."""
        weight = (self.gamma + 0.5) * G

        def over(z):
            L, K = self.arms(theta - z * z, 1)
            J = self.lam * self.R**2 + (1 + 4 * self.gamma) * (L**2 + K**2)
            middle = theta - 0.5 * z * z  # V(θ) − V(x) over z², without cancellation
            slope = self.B * math.cos(middle) - (self.H - self.radius) * math.sin(middle)
            fall = 2 * weight * slope * np.sinc(0.5 * z * z / math.pi)
            return 2 * math.sqrt(J / (2 * fall))

        return quad(over, 0.0, math.sqrt(theta), epsabs=0.0, epsrel=1e-13, limit=200)[0]

    # ---------------------------------------------------------------------------------------------- forces
    def forces(self, y, s: int, ground):
        """Return T and N divided by m_c g, axes (columns, joints, times): (R4) with (F3), (F6), (F8),
        (F9)."""
        theta, omega = y[0], y[1]
        L, K = self.arms(theta, s)
        alpha = self.angular(y, s, ground)
        a_b = ground + 2 * (L * alpha + K * omega**2)
        rise = 2 * (K * alpha + (self.radius - L) * omega**2)
        spring, drift = (self.spring(y, s), y[2] - self.displacement(theta, s)) if self.eta else (0.0, 0.0)
        N_t, T_t = (self.gamma + self.eta) * (G + rise), self.gamma * a_b - self.eta * spring
        N_b, T_b = N_t + G + 0.5 * rise, T_t + 0.5 * (a_b + ground)
        moment = -self.gamma * self.beam_height * a_b
        moment = moment + self.eta * (self.top_height * spring + (G + rise) * drift)
        extra = self.transfer(moment + (s * self.B + self.radius * theta) * N_t)
        T = np.stack([T_b - extra * K / L, T_t - extra * K / L], axis=1)
        return T / G, np.stack([N_b + extra, N_t + extra], axis=1) / G

    def transfer(self, moment):
        """Return the axial forces of the columns minus their mean, (F8), axes (columns, times); `moment` is
        the moment of these differences about the tops of the columns, divided by N m_c."""
        x = np.array(self.positions) - np.mean(self.positions)
        return x[:, None] / np.mean(x**2) * moment

    def forces_in_contact(self, ground):
        """Return T and N in full contact divided by m_c g, without a superstructure, axes (columns, joints,
        times): (F3), (F6), (F8), (F10), (F11) with the dimensions of the flat faces."""
        ground = np.asarray(ground, float)
        N_t = self.gamma * G * np.ones_like(ground)
        N_b, T_t, T_b = N_t + G, self.gamma * ground, (1 + self.gamma) * ground
        xi = -(T_b + T_t) / (math.tan(self.alpha) * (N_b + N_t))
        extra = self.transfer(-self.gamma * self.beam_height * ground + xi * self.B * N_t)
        lean = xi * math.tan(self.alpha) * extra
        T = np.stack([T_b - lean, T_t - lean], axis=1)
        return T / G, np.stack([N_b + extra, N_t + extra], axis=1) / G

    def impulses(self, s: int, omega: float):
        """Return (J_T, J_N) divided by m_c of an impact without a superstructure, axes (columns, joints, 2):
        (F12) to (F14) with the dimensions of the flat faces; `s` is the side before the impact and `omega`
        the size of the rate before it. All impulses act at the new edges."""
        e = self.restitution
        sway, rise = 2 * self.H * (1 - e) * s * omega, 2 * self.B * (1 + e) * omega
        J_N = np.array([(self.gamma + 0.5) * rise, self.gamma * rise])
        J_T = np.array([(self.gamma + 0.5) * sway, self.gamma * sway])
        moment = -self.gamma * self.beam_height * sway - s * self.B * J_N[1]
        extra = self.transfer(np.array([moment]))
        return np.stack([J_T + s * math.tan(self.alpha) * extra, J_N + extra], axis=-1)


@dataclasses.dataclass
class Stretch:
    """States (θ, θ̇, u, u̇) between two events, axes (4, times); `side` is 0 in full contact."""

    side: int
    t: np.ndarray
    y: np.ndarray


def simulate(
    frame: RoundFrame,
    end: float,
    ground: Callable,
    start: float = 0.0,
    theta: float = 0.0,
    max_step: float = 0.02,
) -> list[Stretch]:
    """Solve a scene from rest at `theta` until `end`, or until |θ| = θ_o. `ground` is a function of time
    without jumps; `max_step` is the longest step [s]."""
    y, t, s = np.array([theta, 0.0, 0.0, 0.0]), start, int(np.sign(theta))
    found: list[Stretch] = []
    while t < end:
        events = [_event(lambda time, yy: frame.excess(time, yy, ground)[0], 1)]
        if s:
            limit = frame.overturning
            events = [
                _event(lambda time, yy, s=s: s * yy[0], -1),
                _event(lambda time, yy, s=s, limit=limit: s * yy[0] - limit, 1),
            ]
        step = solve_ivp(
            lambda time, yy, s=s: frame.rate(time, yy, s, ground), (t, end), y, method="DOP853",
            rtol=1e-12, atol=1e-15, max_step=max_step, first_step=1e-6, events=events,
        )  # fmt: skip
        new = np.append(True, np.diff(step.t) > 0)
        found.append(Stretch(s, step.t[new], step.y[:, new]))
        if step.status != 1 or (s and step.t_events[1].size):
            break
        t, y = float(step.t[-1]), step.y[:, -1].copy()
        if s:
            y[0], y[1], s = 0.0, frame.restitution * y[1], -s
            if abs(y[1]) < 1e-9:
                y[1], s = 0.0, 0
        if s == 0:
            over, q = frame.excess(t, y, ground)
            s = -int(np.sign(q)) if over > -1e-9 else 0
    return found


def peak_displacement(frame: RoundFrame, stretches: list[Stretch]) -> float:
    """Return max|u_b| of a scene, by cubic interpolation between steps [m]."""
    best = 0.0
    for each in stretches:
        if each.side == 0 or each.t.size < 2:
            continue
        best = max(best, float(np.max(np.abs(frame.displacement(each.y[0], each.side)))))
        flow = CubicHermiteSpline(each.t, each.y[0], each.y[1])
        turns = flow.derivative().roots(extrapolate=False)
        if turns.size:
            best = max(best, float(np.max(np.abs(frame.displacement(flow(turns), each.side)))))
    return best


def joint_extremes(
    frame: RoundFrame, stretches: list[Stretch], ground: Callable
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return least N, largest N and largest |T|/N of the worst column at the bottom and the top joint, over
    the steps of a scene in which it rocks."""
    N, ratios = [], []
    for each in stretches:
        if each.side:
            T, axial = frame.forces(each.y, each.side, np.array([ground(t) for t in each.t]))
            N.append(axial)
            ratios.append(np.abs(T) / axial)
    joined = np.concatenate(N, axis=-1)
    return joined.min((0, 2)), joined.max((0, 2)), np.concatenate(ratios, axis=-1).max((0, 2))


def _event(function: Any, direction: int) -> Any:
    function.direction, function.terminal = direction, True
    return function
