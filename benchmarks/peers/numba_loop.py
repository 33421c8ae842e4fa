"""A scalar loop over the scenes, compiled by Numba and optimised for this model.

- Each scene is solved with its own steps, without allocations.
- A small generator writes each Runge–Kutta step as straight-line code with the coefficients of the tableau.
- Steps have Nyström form: only θ̈ and ü_t are stored per stage, and the stages of θ and u_t use A·A.
- sin ψ and cos ψ are inlined polynomials (|ψ| < 0.8, error 1e-17).
- A podium with a rigid superstructure has separate code: two states, and uplift at a root of the pulse.
- An impact is located by the quintic Hermite polynomial of the step, and then by Newton's method for the
  length of a repeated step (usually one repetition). Peaks that may exceed the recorded peak are located too.
- After an impact the length of the first step follows from the flight time 2θ̇/|θ̈|.
- A scene ends as soon as its energy, plus the largest energy that the rest of the pulse can add (a closed
  form), proves that the recorded peak is final or that no uplift can follow.

A state is (θ, θ̇) or (θ, θ̇, u_t, u̇_t), with accelerations (θ̈,) or (θ̈, ü_t). In full contact it is (u_t,
u̇_t) with (ü_t,). `side` is the sign of θ. Times are relative to the middle of the pulse.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from math import cos, exp, sin, sqrt
from typing import Any, NamedTuple

import numba  # pyright: ignore[reportMissingImports]
import numpy as np
from scipy.integrate import DOP853

from ..measure import Family, G  # noqa: TID252

REST_VELOCITY = 1e-6  # a podium that is slower after an impact is at rest [p α]
MAX_STEPS = 2_000_000  # largest number of steps of a phase
MAX_PHASES = 100_000

_jit = numba.njit(fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
_inline = numba.njit(fastmath={"contract", "nsz", "arcp"}, error_model="numpy", forceinline=True)


# ------------------------------------------------------------------------------------------- podium and pulse
class Podium(NamedTuple):
    """Constants of the podium; energies are divided by N m_c."""

    alpha: float
    sin_alpha: float
    cos_alpha: float
    R2: float  # 2R
    p: float
    restitution: float
    uplift: float  # demand that lifts the columns
    feedback: float  # 2η/(1+2γ), factor of the superstructure's force in the demand
    omega: float
    omega2: float  # ω_s²
    damping: float  # 2ζω_s
    damped: float  # √(1+4ζ²)
    eta: float  # 0 if rigid; the mass is then in γ
    coupling: float  # the inertia of θ̈ is 1 + coupling sin²ψ, in units of 3γ + ¾(1+λ)
    gravity: float  # factor of sin ψ in θ̈
    shaking: float  # factor of ü_g cos ψ in θ̈
    pull: float  # factor of the superstructure's force in θ̈
    rotation: float  # R²(4γ+1+λ), in the kinetic energy
    translation: float  # 4ηR², in the kinetic energy
    weight: float  # 2Rg(η+γ+½), in the potential energy
    half_mass: float  # (1+γ+η)/2


def _podium(family: Family) -> Podium:
    alpha, R, gamma, eta, lam = family.alpha, family.R, family.gamma, family.eta, family.lam
    omega = 2 * math.pi / family.T_s if family.T_s else 0.0
    if not omega:
        gamma, eta = gamma + eta, 0.0
    p2, inertia = 0.75 * G / R, 3 * gamma + 0.75 * (1 + lam)
    loss = sin(alpha) ** 2 * (2 * gamma + 2 * eta + 0.5) / (0.25 * (1 + lam) + gamma + eta)
    return Podium(
        alpha=alpha,
        sin_alpha=sin(alpha),
        cos_alpha=cos(alpha),
        R2=2 * R,
        p=sqrt(p2),
        restitution=max(1 - loss, 0.0),
        uplift=G * math.tan(alpha) * (1 + 2 * gamma + 2 * eta) / (1 + 2 * gamma),
        feedback=2 * eta / (1 + 2 * gamma),
        omega=omega,
        omega2=omega**2,
        damping=2 * family.zeta * omega,
        damped=sqrt(1 + 4 * family.zeta**2),
        eta=eta,
        coupling=3 * eta / inertia,
        gravity=p2 * (2 * eta + 2 * gamma + 1) / inertia,
        shaking=p2 * (2 * gamma + 1) / G / inertia,
        pull=1.5 * eta / R / inertia,
        rotation=R**2 * (4 * gamma + 1 + lam),
        translation=4 * eta * R**2,
        weight=2 * R * G * (eta + gamma + 0.5),
        half_mass=0.5 * (1 + gamma + eta),
    )


class Ricker(NamedTuple):
    """The pulse a_p (1 − 2x) exp(−x) with x = (rate·t)²."""

    a_p: float
    rate: float


@_inline
def ground(t, pulse):
    x = (pulse.rate * t) * (pulse.rate * t)
    return pulse.a_p * (1.0 - 2.0 * x) * exp(-x)


@_inline
def ground_rate(t, pulse):
    x = (pulse.rate * t) * (pulse.rate * t)
    return pulse.a_p * (2.0 * x - 3.0) * 2.0 * pulse.rate * pulse.rate * t * exp(-x)


@_inline
def remaining_pulse(t, pulse):
    """Return ∫|ü_g| from t on if the pulse no longer changes sign; else −1."""
    x = (pulse.rate * t) * (pulse.rate * t)
    if t <= 0.0 or x < 0.5:
        return -1.0
    return abs(pulse.a_p) * t * exp(-x)


@_jit
def _level(r, low, high, x, rising):
    """Return x in [low, high] with |1 − 2x| exp(−x) = r, by Newton's method from `x`; `rising`: whether the
    left side increases with x."""
    sign = 1.0 if high <= 0.5 else -1.0
    for _ in range(200):
        f = sign * (1.0 - 2.0 * x) * exp(-x) - r
        slope = sign * (2.0 * x - 3.0) * exp(-x)
        if (f < 0.0) == rising:
            low = x
        else:
            high = x
        new = x - f / slope if (slope > 0.0) == rising and slope != 0.0 else low - 1.0
        if not (new >= low and new <= high):
            new = 0.5 * (low + high)
        if abs(new - x) <= 1e-15 * x:
            return new
        x = new
    return x


@_jit
def lifting_times(pulse, threshold):
    """Return t1, t2, t3 with |ü_g| > threshold for |t| < t1 and for t2 < |t| < t3; −1 for empty intervals."""
    r = threshold / abs(pulse.a_p) if pulse.a_p != 0.0 else 2.0
    t1 = t2 = t3 = -1.0
    if r < 1.0:
        t1 = sqrt(_level(r, 0.0, 0.5, 0.5 * (1.0 - r), False)) / pulse.rate
    if r < 2.0 * exp(-1.5):
        t2 = sqrt(_level(r, 0.5, 1.5, 0.8, True)) / pulse.rate
        t3 = sqrt(_level(r, 1.5, 800.0, 3.0, False)) / pulse.rate
    return t1, t2, t3


@_jit
def next_lift(t, a_p, times):
    """Return the first time from t on at which |ü_g| exceeds the threshold, and the sign of ü_g.

    (inf, 0) if there is none.
    """
    t1, t2, t3 = times
    sign = 1.0 if a_p > 0.0 else -1.0
    if t2 > 0.0 and t < -t2:
        return max(t, -t3), -sign
    if t1 > 0.0 and t < t1:
        return max(t, -t1), sign
    if t2 > 0.0 and t < t3:
        return max(t, t2), -sign
    return math.inf, 0.0


# -------------------------------------------------------------------------------------------------- equations
SIN = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(9))
COS = tuple((-1) ** k / math.factorial(2 * k) for k in range(10))


@_inline
def sin_cos(x):
    if abs(x) < 0.8:
        z = x * x
        z2 = z * z
        z4 = z2 * z2
        odd = (SIN[1] + z * SIN[2] + z2 * (SIN[3] + z * SIN[4])) + z4 * (
            SIN[5] + z * SIN[6] + z2 * (SIN[7] + z * SIN[8])
        )
        even = (COS[1] + z * COS[2] + z2 * (COS[3] + z * COS[4])) + z4 * (
            COS[5] + z * COS[6] + z2 * (COS[7] + z * COS[8] + z4 * COS[9])
        )
        return x + x * z * odd, 1.0 + z * even
    return sin(x), cos(x)


@_inline
def rigid_rocking(t, y, side, pulse, c):
    s, co = sin_cos(side * c.alpha - y[0])
    return (-(c.gravity * s + c.shaking * ground(t, pulse) * co),)


@_inline
def elastic_rocking(t, y, side, pulse, c):
    th, v, u, w = y
    a = ground(t, pulse)
    s, co = sin_cos(side * c.alpha - th)
    f = c.omega2 * (u - c.R2 * (side * c.sin_alpha - s)) + c.damping * (w - c.R2 * v * co)
    k = (c.coupling * v * v * s * co - c.gravity * s - c.shaking * a * co + c.pull * co * f) / (
        1.0 + c.coupling * s * s
    )
    return k, -a - f


@_inline
def elastic_contact(t, y, side, pulse, c):
    return (-ground(t, pulse) - c.damping * y[1] - c.omega2 * y[0],)


@_inline
def rigid_demand(t, y, pulse, c):
    return ground(t, pulse)


@_inline
def elastic_demand(t, y, pulse, c):
    return ground(t, pulse) - c.feedback * (c.omega2 * y[2] + c.damping * y[3])


@_inline
def rigid_energy(y, side, c):
    co = sin_cos(side * c.alpha - y[0])[1]
    return 0.5 * c.rotation * y[1] * y[1] + c.weight * (co - c.cos_alpha)


@_inline
def elastic_energy(y, side, c):
    th, v, u, w = y
    s, co = sin_cos(side * c.alpha - th)
    stretch = u - c.R2 * (side * c.sin_alpha - s)
    return (
        0.5 * (c.rotation + c.translation * s * s) * v * v
        + c.weight * (co - c.cos_alpha)
        + 0.5 * c.eta * (w * w + c.omega2 * stretch * stretch)
    )


@_inline
def rigid_weights(y, rtol, atol, c):
    """Return 1 divided by the allowed error of each component."""
    th, v = y
    return 1.0 / (atol * c.alpha + rtol * abs(th)), 1.0 / (atol * c.p * c.alpha + rtol * abs(v))


@_inline
def contact_weights(y, rtol, atol, c):
    u, w = y
    size = c.R2 * c.sin_alpha
    return 1.0 / (atol * size + rtol * abs(u)), 1.0 / (atol * max(c.omega, c.p) * size + rtol * abs(w))


@_inline
def elastic_weights(y, rtol, atol, c):
    th, v, u, w = y
    a, b = rigid_weights((th, v), rtol, atol, c)
    d, e = contact_weights((u, w), rtol, atol, c)
    return a, b, d, e


@_inline
def shift2(y, k, dt):
    """Return the state after a short time dt."""
    return y[0] + dt * y[1] + 0.5 * dt * dt * k[0], y[1] + dt * k[0]


@_inline
def shift4(y, k, dt):
    return (
        y[0] + dt * y[1] + 0.5 * dt * dt * k[0],
        y[1] + dt * k[0],
        y[2] + dt * y[3] + 0.5 * dt * dt * k[1],
        y[3] + dt * k[1],
    )


@_inline
def landed2(y, v):
    return 0.0, v


@_inline
def landed4(y, v):
    return 0.0, v, y[2], y[3]


# -------------------------------------------------------------------------- Runge–Kutta steps, code generator
class Tableau(NamedTuple):
    A: np.ndarray
    b: np.ndarray
    c: np.ndarray
    errors: list[np.ndarray]  # weights of the errors, with one more entry for the end of the step
    order: int


def _tableau(method: str) -> Tableau:
    if method == "dop853":
        return Tableau(DOP853.A, DOP853.B, DOP853.C, [DOP853.E5, DOP853.E3], 8)
    if method != "tsit5":
        raise ValueError(f"method must be 'dop853' or 'tsit5', not {method!r}")
    A = np.zeros((6, 6))
    A[1, :1] = [0.161]
    A[2, :2] = [-0.008480655492356989, 0.335480655492357]
    A[3, :3] = [2.8971530571054935, -6.359448489975075, 4.3622954328695815]
    A[4, :4] = [5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525]
    A[5, :5] = [
        5.86145544294642,
        -12.92096931784711,
        8.159367898576159,
        -0.071584973281401,
        -0.028269050394068383,
    ]
    b = [
        0.09646076681806523,
        0.01,
        0.4798896504144996,
        1.379008574103742,
        -3.290069515436081,
        2.324710524099774,
    ]
    error = [-0.00178001105222577714, -0.0008164344596567469, 0.007880878010261995, -0.1447110071732629]
    error += [0.5823571654525552, -0.45808210592918697, 1 / 66]
    return Tableau(
        A, np.array(b), np.array([0, 0.161, 0.327, 0.9, 0.9800255409045097, 1]), [np.array(error)], 5
    )


def _sum(weights: np.ndarray, names: list[str]) -> str:
    terms = [f"{float(x)!r}*{name}" for x, name in zip(weights, names, strict=False) if abs(x) > 1e-14]
    return f"({' + '.join(terms)})" if terms else "0.0"


def _tuple(names: list[str]) -> str:
    return f"({', '.join(names)},)"


def _step(
    acceleration: Callable, degrees: int, tableau: Tableau, with_error: bool, uses_velocity: bool = True
) -> Callable:
    """Generate step(t, h, y, k, side, pulse, c) → (y, k) at t + h.

    y = (x0, v0, x1, v1, …) has `degrees` positions; k0_i, k1_i, … are their accelerations at stage i.
    `with_error` adds the argument `weights` and returns the error as well; errors up to 1 are accepted.
    """
    A, b, c, errors, _ = tableau
    stages, each = len(b), range(degrees)
    k = [[f"k{j}_{i}" for i in range(stages + 1)] for j in each]  # the last is at the end of the step
    code = [f"def step(t, h, y, k, side, pulse, c{', weights' if with_error else ''}):", "h2 = h*h"]
    code += [f"x{j}, v{j}, k{j}_0 = y[{2 * j}], y[{2 * j + 1}], k[{j}]" for j in each]

    def stage(i: int, time: float, velocity: np.ndarray, position: np.ndarray) -> None:
        for j in each:
            code.append(f"X{j} = x{j} + h*({time!r}*v{j}) + h2*{_sum(position, k[j])}")
            code.append(
                f"V{j} = v{j} + h*{_sum(velocity, k[j])}" if uses_velocity or i == stages else f"V{j} = v{j}"
            )
        state = _tuple([f"{name}{j}" for j in each for name in "XV"])
        code.append(
            f"{_tuple([k[j][i] for j in each])} = acceleration(t + {time!r}*h, {state}, side, pulse, c)"
        )

    for i in range(1, stages):
        stage(i, float(c[i]), A[i, :i], (A @ A)[i, :i])
    stage(stages, 1.0, b, b @ A)
    result = [_tuple([f"{name}{j}" for j in each for name in "XV"]), _tuple([k[j][stages] for j in each])]
    if with_error:
        for n, E in enumerate(errors):
            parts = []
            for j in each:
                code.append(f"ex{j} = h2*{_sum(E[:stages] @ A + E[stages] * b, k[j])}*weights[{2 * j}]")
                code.append(f"ev{j} = h*{_sum(E, k[j])}*weights[{2 * j + 1}]")
                parts.append(f"ex{j}*ex{j} + ev{j}*ev{j}")
            code.append(f"e{n} = {' + '.join(parts)}")
        if len(errors) == 2:
            code.append("both = e0 + 0.01*e1")
            code.append(f"error = e0/sqrt(both*{2.0 * degrees}) if both > 0.0 else 0.0")
        else:
            code.append(f"error = sqrt(e0/{2.0 * degrees})")
        result.append("error")
    code.append(f"return {', '.join(result)}")
    names: dict[str, Any] = {"acceleration": acceleration, "sqrt": sqrt}
    exec("\n    ".join(code), names)
    return (_inline if with_error else _jit)(names["step"])


# --------------------------------------------------------------------------------------- events within a step
@_jit
def quintic(x0, v0, a0, x1, v1, a1, h, z):
    """Return the Hermite polynomial through position, velocity and acceleration at both ends, 0 ≤ z ≤ 1."""
    v0, v1, a0, a1 = v0 * h, v1 * h, a0 * h * h, a1 * h * h
    d = x1 - x0 - v0 - 0.5 * a0
    dv = v1 - v0 - a0
    da = a1 - a0
    c3, c4, c5 = 10.0 * d - 4.0 * dv + 0.5 * da, -15.0 * d + 7.0 * dv - da, 6.0 * d - 3.0 * dv + 0.5 * da
    return x0 + z * (v0 + z * (0.5 * a0 + z * (c3 + z * (c4 + z * c5))))


@_jit
def quintic_root(x0, v0, a0, x1, v1, a1, h):
    """Return z at which the polynomial of `quintic` (< 0 at z = 1) falls through zero; −1 if never > 0."""
    v0, v1, a0, a1 = v0 * h, v1 * h, a0 * h * h, a1 * h * h
    d = x1 - x0 - v0 - 0.5 * a0
    dv = v1 - v0 - a0
    da = a1 - a0
    c3, c4, c5 = 10.0 * d - 4.0 * dv + 0.5 * da, -15.0 * d + 7.0 * dv - da, 6.0 * d - 3.0 * dv + 0.5 * da
    low, high, z = 0.0, 1.0, 0.5
    for _ in range(40):
        if x0 + z * (v0 + z * (0.5 * a0 + z * (c3 + z * (c4 + z * c5)))) > 0.0:
            low = z
            break
        high = z
        z *= 0.5
    if low == 0.0:
        return -1.0
    z = 0.5 * (low + high)
    for _ in range(60):
        f = x0 + z * (v0 + z * (0.5 * a0 + z * (c3 + z * (c4 + z * c5))))
        slope = v0 + z * (a0 + z * (3.0 * c3 + z * (4.0 * c4 + z * 5.0 * c5)))
        if f > 0.0:
            low = z
        else:
            high = z
        new = z - f / slope if slope != 0.0 else z
        if not (new > low and new < high):
            new = 0.5 * (low + high)
        if abs(new - z) < 1e-12:
            return new
        z = new
    return z


@_inline
def cubic(x0, v0, x1, v1):
    """Return c2 and c3 of the Hermite polynomial x0 + v0 z + c2 z² + c3 z³ on 0 ≤ z ≤ 1."""
    d = x1 - x0
    return 3.0 * d - 2.0 * v0 - v1, v0 + v1 - 2.0 * d


@_jit
def cubic_zero(v0, a0, v1, a1, h):
    """Return the zero of the cubic Hermite polynomial of the velocity, which changes its sign."""
    a0, a1 = a0 * h, a1 * h
    c2, c3 = cubic(v0, a0, v1, a1)
    low, high, z = 0.0, 1.0, v0 / (v0 - v1)
    for _ in range(60):
        f = v0 + z * (a0 + z * (c2 + z * c3))
        slope = a0 + z * (2.0 * c2 + z * 3.0 * c3)
        if (f > 0.0) == (v0 > 0.0):
            low = z
        else:
            high = z
        new = z - f / slope if slope != 0.0 else -1.0
        if not (new > low and new < high):
            new = 0.5 * (low + high)
        if abs(new - z) < 1e-10:
            return new
        z = new
    return z


@_jit
def land(step, shift, z, t, h, y, k, side, pulse, c, rtol):
    """Return the length of the step that ends at θ = 0, close to z h, and the state at θ = 0."""
    low, high, dt = 0.0, h, z * h
    new, rate = y, k
    for _ in range(40):
        new, rate = step(t, dt, y, k, side, pulse, c)
        if side * new[0] > 0.0:
            low = dt
        else:
            high = dt
        falling = side * new[1] < 0.0
        change = -new[0] / new[1] if falling else 0.0
        if falling and change * change < 1e-2 * rtol * dt * dt and abs(change) < 1e-5 * dt:
            return dt + change, shift(new, rate, change), rate
        if high - low < 1e-15 * (abs(t) + h):
            break
        dt += change
        if not (dt > low and dt < high):
            dt = 0.5 * (low + high)
    return dt, new, rate


@_jit
def crest(step, z, t, h, y, k, side, pulse, c):
    """Return the largest |θ| inside a step, near z h, by Newton's method for θ̇ = 0."""
    dt, highest = z * h, 0.0
    for _ in range(6):
        new, rate = step(t, dt, y, k, side, pulse, c)
        change = -new[1] / rate[0] if side * rate[0] < 0.0 else 0.0
        highest = side * (new[0] + change * new[1] + 0.5 * change * change * rate[0])
        dt = min(h, max(0.0, dt + change))
        if abs(change) < 1e-4 * h or change == 0.0:
            break
    return highest


@_inline
def contact_demand(t, y, k, pulse, c):
    """Return the demand of an elastic superstructure in full contact, and its rate."""
    q = ground(t, pulse) - c.feedback * (c.omega2 * y[0] + c.damping * y[1])
    return q, ground_rate(t, pulse) - c.feedback * (c.omega2 * y[1] + c.damping * k[0])


@_jit
def highest_demand(step, z, sign, t, h, y, k, pulse, c):
    """Return (length, demand, rate) at the largest demand inside a step, close to z h, by Newton's method."""
    dt = z * h
    for _ in range(4):
        new, rate = step(t, dt, y, k, 0.0, pulse, c)
        slope = contact_demand(t + dt, new, rate, pulse, c)[1]
        e = 1e-4 * h
        curvature = (ground_rate(t + dt + e, pulse) - ground_rate(t + dt - e, pulse)) / (2.0 * e)
        jerk = -ground_rate(t + dt, pulse) - c.damping * rate[0] - c.omega2 * new[1]
        curvature -= c.feedback * (c.omega2 * rate[0] + c.damping * jerk)
        change = -slope / curvature if curvature != 0.0 else 0.0
        if change == 0.0 or not (dt + change > 0.0 and dt + change < h):
            break
        dt += change
        if abs(change) < 1e-9 * h:
            break
    new, rate = step(t, dt, y, k, 0.0, pulse, c)
    q, slope = contact_demand(t + dt, new, rate, pulse, c)
    return dt, sign * q, sign * slope


@_jit
def lift(step, t, h, y, k, sign, q0, d0, q1, d1, pulse, c, rtol):
    """Return the length of the step that ends at uplift, and the state at uplift."""
    c2, c3 = cubic(q0, d0 * h, q1, d1 * h)
    low, high = 0.0, 1.0
    for _ in range(60):
        z = 0.5 * (low + high)
        if q0 + z * (d0 * h + z * (c2 + z * c3)) < c.uplift:
            low = z
        else:
            high = z
    dt = 0.5 * (low + high) * h
    low, high, new = 0.0, h, y
    for _ in range(30):
        new, rate = step(t, dt, y, k, 0.0, pulse, c)
        q, slope = contact_demand(t + dt, new, rate, pulse, c)
        q, slope = sign * q - c.uplift, sign * slope
        if q < 0.0:
            low = dt
        else:
            high = dt
        change = -q / slope if slope > 0.0 else 0.0
        if slope > 0.0 and change * change < 1e-2 * rtol * h * h and abs(change) < 1e-5 * h:
            return dt + change, shift2(new, rate, change)
        if high - low < 1e-15 * (abs(t) + h):
            break
        dt += change
        if not (dt > low and dt < high):
            dt = 0.5 * (low + high)
    return dt, new


# ----------------------------------------------------------------------------------------------- full contact
@_inline
def new_length(h, error, order, max_factor):
    return h * min(max_factor, max(0.2, 0.9 * (error + 1e-30) ** (-1.0 / order)))


@_jit
def contact_of_rigid(step, step_error, order, t, t_end, h, y, times, pulse, c, rtol, atol, well, stuck):
    """Solve full contact of a rigid superstructure from t on.

    Returns (time of uplift, next step, state, sign of the demand); the sign is 0 if the scene is over. With
    `stuck`, after repeated uplifts at one time, the time advances slightly.
    """
    if stuck:
        t += 1e-9 * math.pi / pulse.rate
    t, sign = next_lift(t, pulse.a_p, times)
    return t, h, y, sign if t < t_end else 0.0


@_jit
def contact_of_elastic(step, step_error, order, t, t_end, h, y, times, pulse, c, rtol, atol, well, stuck):
    """Solve full contact of an elastic superstructure; `well` is the energy at the recorded peak."""
    z = (y[2], y[3])
    k = elastic_contact(t, z, 0.0, pulse, c)
    q, d = contact_demand(t, z, k, pulse, c)
    max_factor = 5.0
    for _ in range(MAX_STEPS):
        if t >= t_end:
            break
        if abs(q) > c.uplift * (1.0 + 1e-15) and not stuck:
            return t, h, (0.0, 0.0, z[0], z[1]), math.copysign(1.0, q)
        last = t + h * 1.0000001 >= t_end
        dt = t_end - t if last else h
        z1, k1, error = step_error(t, dt, z, k, 0.0, pulse, c, contact_weights(z, rtol, atol, c))
        if not error <= 1.0:
            h = new_length(dt, error, order, 1.0)
            max_factor = 1.0
            continue
        q1, d1 = contact_demand(t + dt, z1, k1, pulse, c)
        up = abs(q1) > c.uplift
        if up or max(abs(q), abs(q1)) > 0.5 * c.uplift:
            sign = math.copysign(1.0, q1 if up else q + q1)
            q0, d0, qtop, dtop = sign * q, sign * d, sign * q1, sign * d1
            if not up and d0 > 0.0 and dtop < 0.0:  # the demand may exceed the limit only inside the step
                c2, c3 = cubic(q0, d0 * dt, qtop, dtop * dt)
                x = d0 * dt / (sqrt(c2 * c2 - 3.0 * c3 * d0 * dt) - c2)  # the cubic's maximum
                if q0 + x * (d0 * dt + x * (c2 + x * c3)) > 0.95 * c.uplift:
                    dt_at_top, qtop, dtop = highest_demand(step, x, sign, t, dt, z, k, pulse, c)
                    if qtop > c.uplift:
                        up = True
                        dt = dt_at_top
            if up:
                dt, z1 = lift(step, t, dt, z, k, sign, q0, d0, qtop, dtop, pulse, c, rtol)
                if dt >= 0.999 * h or error > 0.5:
                    h = new_length(dt, error, order, max_factor)
                return t + dt, h, (0.0, 0.0, z1[0], z1[1]), sign
        t = t_end if last else t + dt
        z, k, q, d = z1, k1, q1, d1
        if dt >= 0.999 * h or error > 0.5:
            h = new_length(dt, error, order, max_factor)
        max_factor = 5.0
        remaining = remaining_pulse(t, pulse)
        if remaining >= 0.0:
            root = sqrt(0.5 * c.eta * (z[1] * z[1] + c.omega2 * z[0] * z[0])) + sqrt(c.half_mass) * remaining
            if root * root < well:
                break
            falls = (pulse.rate * t) * (pulse.rate * t) >= 1.5
            swing = c.feedback * c.omega * c.damped * root * sqrt(2.0 / c.eta)
            if falls and abs(ground(t, pulse)) + swing < c.uplift:
                break
    return t, h, (0.0, 0.0, z[0], z[1]), 0.0


# --------------------------------------------------------------------------------------------------- the loop
@functools.cache
def _compile(rigid: bool, method: str, parallel: bool) -> Callable:
    """Return the function sweep(a_p, T_p, c, rtol, atol, peak, overturned); it fills peak and overturned."""
    tableau = _tableau(method)
    order = float(tableau.order)
    accelerations = rigid_rocking if rigid else elastic_rocking
    demand = rigid_demand if rigid else elastic_demand
    energy = rigid_energy if rigid else elastic_energy
    weights = rigid_weights if rigid else elastic_weights
    shift = shift2 if rigid else shift4
    landed = landed2 if rigid else landed4
    contact = contact_of_rigid if rigid else contact_of_elastic
    degrees = 1 if rigid else 2
    at_rest = (0.0,) * (2 * degrees)
    step = _step(accelerations, degrees, tableau, False, not rigid)
    step_error = _step(accelerations, degrees, tableau, True, not rigid)
    contact_step = _step(elastic_contact, 1, tableau, False)
    contact_step_error = _step(elastic_contact, 1, tableau, True)

    @_jit
    def scene(a_p, T_p, c, rtol, atol):
        pulse = Ricker(a_p, math.pi / T_p)
        times = lifting_times(pulse, c.uplift) if rigid else (-1.0, -1.0, -1.0)
        t, t_end = -2.2 * T_p, 2.2 * T_p + 30.0 / c.p
        y = at_rest
        h = 0.01 * T_p if rigid else min(0.01 * T_p, 0.1 / c.omega)
        side = 0.0
        bounced = False
        peak = well = 0.0
        lifted_at, consecutive = -math.inf, 0
        for _ in range(MAX_PHASES):
            if side == 0.0:
                t, h, y, sign = contact(
                    contact_step,
                    contact_step_error,
                    order,
                    t,
                    t_end,
                    h,
                    y,
                    times,
                    pulse,
                    c,
                    rtol,
                    atol,
                    well,
                    consecutive >= 5,
                )
                if sign == 0.0:
                    return peak / c.alpha, False
                consecutive = consecutive + 1 if t - lifted_at < 1e-12 * (1.0 + abs(t)) else 0
                lifted_at = t
                side = -sign
                bounced = False
            # ------------------------------------------------------------------ rocking to one side
            k = accelerations(t, y, side, pulse, c)
            if bounced and side * k[0] < 0.0:
                h = min(h, 2.2 * abs(y[1] / k[0]))
            max_factor = 5.0
            first = True
            landing = False
            for _ in range(MAX_STEPS):
                if t >= t_end:
                    return peak / c.alpha, False
                last = t + h * 1.0000001 >= t_end
                dt = t_end - t if last else h
                y1, k1, error = step_error(t, dt, y, k, side, pulse, c, weights(y, rtol, atol, c))
                if not error <= 1.0:
                    h = new_length(dt, error, order, 1.0) if error > 1.0 else 0.1 * dt
                    max_factor = 1.0
                    continue
                trial_dt = dt
                x0, v0, a0 = 0.0 if first else side * y[0], side * y[1], side * k[0]
                x1, v1, a1 = side * y1[0], side * y1[1], side * k1[0]
                landing = x1 < 0.0
                if not landing and v0 < 0.0 and v1 > 0.0:  # θ may change sign twice inside the step
                    z = cubic_zero(v0, a0, v1, a1, dt)
                    if quintic(x0, v0, a0, x1, v1, a1, dt, z) < 1e-3 * c.alpha:
                        low, klow = step(t, z * dt, y, k, side, pulse, c)
                        if side * low[0] < 0.0:
                            landing = True
                            dt, y1, k1 = z * dt, low, klow
                            x1, v1, a1 = side * y1[0], side * y1[1], side * k1[0]
                if landing:
                    z = quintic_root(x0, v0, a0, x1, v1, a1, dt)
                    if z < 0.0:
                        if dt > 1e-10 * (1.0 + abs(t)) and dt > 1e-9 / c.p:
                            h = 0.1 * dt
                            max_factor = 1.0
                            continue
                        y = landed(y, 0.0)  # full contact again at once
                        side = 0.0
                        h = max(trial_dt, 1e-6 * T_p)
                        break
                    dt, y1, k1 = land(step, shift, z, t, dt, y, k, side, pulse, c, rtol)
                    x1, v1, a1 = 0.0, side * y1[1], side * k1[0]
                # -------------------------------------------------------------- peak
                highest = x1
                if v0 > 0.0 and v1 < 0.0:
                    z = cubic_zero(v0, a0, v1, a1, dt)
                    if quintic(x0, v0, a0, x1, v1, a1, dt, z) > 0.999 * peak:
                        highest = max(highest, crest(step, z, t, dt, y, k, side, pulse, c))
                if highest >= c.alpha:
                    return 1.0, True
                if highest > peak:
                    peak = highest
                    well = c.weight * (cos(c.alpha - peak) - c.cos_alpha)
                # -------------------------------------------------------------- accept
                t = t_end if last and not landing else t + dt
                y, k = y1, k1
                first = False
                if trial_dt >= 0.999 * h or error > 0.5:
                    h = new_length(trial_dt, error, order, max_factor)
                max_factor = 5.0
                if landing:
                    v = c.restitution * y[1]
                    if h < 1e-3 / c.p:
                        h = min(1e-2 / c.p, 1.0 if rigid else 0.3 / c.omega)
                    bounced = abs(v) > REST_VELOCITY * c.p * c.alpha
                    y = landed(y, v if bounced else 0.0)
                    if bounced:
                        side = 1.0 if v > 0.0 else -1.0
                    else:
                        q = demand(t, y, pulse, c)
                        side = 0.0 if abs(q) <= c.uplift else -math.copysign(1.0, q)
                remaining = remaining_pulse(t, pulse)
                if remaining >= 0.0:
                    root = (
                        sqrt(max(energy(y, side if side != 0.0 else 1.0, c), 0.0))
                        + sqrt(c.half_mass) * remaining
                    )
                    if root * root < well:
                        return peak / c.alpha, False
                if landing:
                    break
        return math.nan, False  # more phases than any scene has

    def sweep(a_p, T_p, c, rtol, atol, peak, overturned):
        for i in numba.prange(a_p.size):
            peak[i], overturned[i] = scene(a_p[i], T_p[i], c, rtol, atol)

    return numba.njit(parallel=parallel, error_model="numpy")(sweep)


def solve(
    family: Family, rtol: float, method: str = "dop853", parallel: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Return (max|θ|/α, at most 1; overturned) of every scene; atol = rtol/100.

    `method` is "dop853" or "tsit5"; the first call of each kind compiles. atol is in units of α, p α, 2R sin
    α, ….
    """
    peak, overturned = np.empty(len(family)), np.empty(len(family), bool)
    sweep = _compile(family.T_s == 0, method, parallel)
    a_p, T_p = (np.ascontiguousarray(x, float) for x in (family.a_p, family.T_p))
    sweep(a_p, T_p, _podium(family), rtol, rtol / 100, peak, overturned)
    return peak, overturned
