"""The model: equations of motion, uplift demand, impact map and energy, each once, with the paper's numbers.

σ ∈ {−1, 0, +1} is the mode: 0 is full contact, ±1 rocking with the sign of θ. One field serves all of them:
with σ = 0 and θ = θ̇ = 0 the angle ψ = σα − θ vanishes, so do u_b and u̇_b, and Eq. (22) becomes Eq. (4).

States are positions x and velocities v, both tuples over the degrees of freedom: (θ,) where nothing is
elastic, (θ, u_t) with an elastic superstructure. Which of the two is known before tracing.

Restrainers add what each of them says of an elongation and its rate; their equations are numbered (C1) … in
docs/control.md. A podium without any never looks at them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax._excitations.base import Shaking
from rockjax._restrainers.base import AbstractRestrainer
from rockjax._restrainers.together import apparent_mass, stiffness
from rockjax._structures import Elastic, Podium
from rockjax._types import Value, Vector

from .sincos import sincos


class Coefficients(NamedTuple):
    """What the equations need of a podium, computed once per scene. Numbers per N m_c where they carry
    mass."""

    alpha: Value
    sin_alpha: Value
    cos_alpha: Value
    p: Value
    restitution: Value  # e of Eq. (27) or its alternatives
    uplift: Value  # q_up, Eq. (9)
    two_R: Value
    inertia: Value  # 3γ + ¾(1+λ), Eq. (24)
    centrifugal: Value  # 3η
    gravity: Value  # p² (2η+2γ+1)
    ground: Value  # p² (2γ+1)/g
    weight: Value  # 2Rg (η+γ+½), Eq. (19)
    spin: Value  # (1+λ+4γ) R², Eq. (18)
    impulse: Value  # C of the energy bound, see `energy_after`
    g: Value
    eta: Value
    # None, and never looked at, where nothing is elastic:
    coupling: Value  # 3η/(2R)
    demand: Value  # 2η/(1+2γ), Eq. (9)
    omega2: Value  # ω_s²
    damping: Value  # 2ζω_s
    uplifted_frequency: Value  # Eq. (31)
    # Likewise where nothing restrains:
    restrainers: tuple[AbstractRestrainer, ...]
    slip: Value  # rate of the elongation over Rp below which forces without a slope are rounded
    well: Value  # θ_w: |θ| at the top of the potential well
    apparent_mass: Value  # μ, None where there is no inerter
    restrained_frequency: Value  # of rocking against the stiffness of tendons alone, None where there is none
    # Likewise where the ground moves horizontally alone:
    tilt: Value  # K = tan α (1+2γ+2η)/(1+2γ), (C10)

    @property
    def elastic(self) -> bool:
        return self.omega2 is not None

    @property
    def steep(self) -> bool:
        """Whether a force has no slope where θ̇ = 0."""
        return any(each.steep for each in self.restrainers)


SLIP = 1e-8  # the tolerance that forces without a slope are rounded for, unless it is said
ROUNDED = 10.0  # times the tolerance, over pα: the rate of rotation below which they are
SLOWING, GATHERING = (
    0.75,
    3.0,
)  # of the time to a stop, and of that since one: steps close to it are no longer


def coefficients(podium: Podium, slip: Value | float = SLIP, vertical: bool = False) -> Coefficients:
    """The constants of Eqs. (9), (19), (22), (24), (27) for one podium (scalars; batches go through `vmap`).

    `slip` is the tolerance; ten times it is the rate |θ̇|/(pα) below which dampers with ν < 1 are rounded.
    `vertical` says whether the ground moves vertically as well.
    """
    elastic = podium.superstructure if isinstance(podium.superstructure, Elastic) else None
    eta = podium.eta
    gamma = podium.gamma if elastic else podium.gamma + eta  # a rigid superstructure is part of the beam
    moving = eta if elastic else jnp.zeros_like(eta)
    lam, R, g, p = podium.lam, podium.R, podium.g, podium.p
    spin = 1 + lam + 4 * gamma
    absent: Any = None
    return Coefficients(
        alpha=podium.alpha,
        sin_alpha=jnp.sin(podium.alpha),
        cos_alpha=jnp.cos(podium.alpha),
        p=p,
        restitution=podium.restitution_factor,
        # Touching it is not uplift, and rounding may not decide about it.
        uplift=podium.uplift_acceleration * (1 + 64 * jnp.finfo(R.dtype).eps),
        two_R=2 * R,
        inertia=3 * gamma + 0.75 * (1 + lam),
        centrifugal=3 * moving,
        gravity=p**2 * (2 * moving + 2 * gamma + 1),
        ground=p**2 * (2 * gamma + 1) / g,
        weight=2 * R * g * (moving + gamma + 0.5),
        spin=spin * R**2,
        impulse=jnp.sqrt((1 + 2 * gamma) ** 2 / (2 * spin) + moving / 2),
        g=g,
        eta=moving,
        coupling=1.5 * eta / R if elastic else absent,
        demand=2 * eta / (1 + 2 * gamma) if elastic else absent,
        omega2=elastic.omega_s**2 if elastic else absent,
        damping=2 * elastic.zeta * elastic.omega_s if elastic else absent,
        uplifted_frequency=podium.uplifted_frequency if elastic else absent,
        **_of_restrainers(podium, slip),
        tilt=jnp.tan(podium.alpha) * (1 + 2 * (gamma + moving)) / (1 + 2 * gamma) if vertical else absent,
    )


def _of_restrainers(podium: Podium, slip: Value | float) -> dict[str, Any]:
    """The constants of the restrainers; nothing where there are none."""
    restrainers = podium.restrainers
    names = ("slip", "well", "apparent_mass", "restrained_frequency")
    if not restrainers:
        return {"restrainers": ()} | dict.fromkeys(names)
    sin_alpha, kappa = jnp.sin(podium.alpha), stiffness(restrainers)
    gamma = podium.gamma if isinstance(podium.superstructure, Elastic) else podium.gamma + podium.eta
    k = None if kappa is None else 4 * kappa * sin_alpha**2 / (3 * gamma + 0.75 * (1 + podium.lam))
    return {
        "restrainers": restrainers,
        "slip": jax.lax.stop_gradient(2 * sin_alpha * ROUNDED * slip * podium.alpha),
        "well": jax.lax.stop_gradient(jnp.minimum(podium.stability_angle, 0.5 * math.pi)),
        "apparent_mass": apparent_mass(restrainers),
        "restrained_frequency": None if k is None else jax.lax.stop_gradient(podium.p * jnp.sqrt(k)),
    }


def steady_for(c: Coefficients, theta_dot: Value, theta_ddot: Value) -> Value:
    """How long the rate of rotation stays of the same size, where forces are steep at θ̇ = 0 [s].

    A share of the time that it takes to stop, or that it has taken to come to its rate. Steps that are no
    longer close in on a moment without motion in quarters, so that their error is that of the method although
    the forces have no slope there; not in states alone, whose error tells, but in their derivatives as well,
    whose error does not.
    """
    speed, change = jnp.abs(theta_dot), jnp.abs(theta_ddot)
    rounded = c.slip / (2 * c.sin_alpha)  # over p
    share = jnp.where(theta_dot * theta_ddot < 0, SLOWING, GATHERING)
    still = 0.5 * jnp.sqrt(rounded / c.alpha) / c.p  # from an uplift on, θ̇ ~ t²
    span = share * (speed + rounded * c.p) / jnp.where(change > 0, change, 1.0)
    span = jnp.where(change > 0, span, jnp.inf)
    return jnp.where(speed > 0, span, jnp.minimum(span, still))


class Elongation(NamedTuple):
    """ℓ of (C1) and its derivative by θ, over R; both are zero in full contact."""

    stretch: Value
    lever: Value


def elongation(c: Coefficients, sigma: Value, theta: Value) -> Elongation:
    """How far a column's joints are open."""
    return _elongation(c, sigma, *sincos(0.5 * theta))


def _elongation(c: Coefficients, sigma: Value, s: Value, cos: Value) -> Elongation:
    """The same from sin θ/2 and cos θ/2."""
    return Elongation(4 * c.sin_alpha * sigma * s, 2 * c.sin_alpha * sigma * cos)


def _angles(c: Coefficients, sigma: Value, theta: Value) -> tuple[Value, Value, Elongation]:
    """sin ψ, cos ψ and the elongation by one sine and cosine, of θ/2; cos ψ is not to be asked of full
    contact."""
    s, cos = sincos(0.5 * theta)
    sin_theta, cos_theta = 2 * s * cos, 1 - 2 * s * s
    sin_side = sigma * c.sin_alpha
    sin_psi = sin_side * cos_theta - c.cos_alpha * sin_theta
    return sin_psi, c.cos_alpha * cos_theta + sin_side * sin_theta, _elongation(c, sigma, s, cos)


def _restraint(c: Coefficients, open_by: Elongation, theta_dot: Value) -> tuple[Value, Value | float]:
    """What restrainers take from the right side of Eq. (24), and what they add to its inertia, (C8)."""
    stretch, lever = open_by
    rate = lever * theta_dot / c.p
    against = c.p**2 * lever * sum(each.force(stretch, rate, c.slip) for each in c.restrainers)
    if c.apparent_mass is None:
        return against, 0.0
    push = 0.75 * c.apparent_mass * lever
    return against - 0.25 * push * stretch * theta_dot**2, push * lever


def restraint_at_most(c: Coefficients, theta: Value, theta_dot: Value) -> Value:
    """A bound of what restrainers take from the right side of Eq. (24), up to |θ| and |θ̇| inside the well,
    (C20)."""
    s, _ = sincos(0.5 * theta)
    lever = 2 * c.sin_alpha
    forces = sum(each.force(2 * lever * s, lever * theta_dot / c.p, c.slip) for each in c.restrainers)
    most = c.p**2 * lever * forces
    if c.apparent_mass is not None:
        most = most + 0.75 * c.apparent_mass * (c.sin_alpha * theta_dot) ** 2
    return most


def rotational_inertia(c: Coefficients, sigma: Value, theta: Value) -> Value:
    """The inertia of Eq. (24) where the superstructure moves with the beam, with that of inerters, (C21)."""
    total = c.inertia + c.centrifugal
    if c.apparent_mass is None:
        return total
    return total + 0.75 * c.apparent_mass * elongation(c, sigma, theta).lever ** 2


def spin_with_inerters(c: Coefficients, sigma: Value, theta: Value) -> Value:
    """What ½θ̇² of the kinetic energy of Eq. (18) is of, with inerters, (C17)."""
    if c.apparent_mass is None:
        return c.spin
    return c.spin + c.apparent_mass * (0.5 * c.two_R * elongation(c, sigma, theta).lever) ** 2


def horizontal(ground: Value | Shaking) -> Value:
    """ü_g of a ground motion."""
    return ground.horizontal if isinstance(ground, Shaking) else ground


def _weight(c: Coefficients, ground: Value | Shaking) -> Value:
    """What gravity is multiplied with in Eq. (24): g becomes g + v̈_g in all weights."""
    return c.gravity * (1 + ground.vertical / c.g) if isinstance(ground, Shaking) else c.gravity


def _relief(c: Coefficients, ground: Shaking) -> Value:
    """q_up(t) over its static value, (C10): positive as long as g + v̈_g is."""
    return 1 + c.tilt * ground.vertical / c.uplift


def beam(c: Coefficients, sigma: Value, theta: Value, theta_dot: Value) -> tuple[Value, Value]:
    """Horizontal displacement and velocity of the beam (u_b, u̇_b), Eqs. (13), (14)."""
    s, cos = sincos(sigma * c.alpha - theta)
    return c.two_R * (sigma * c.sin_alpha - s), c.two_R * theta_dot * cos


def beam_acceleration(
    c: Coefficients, sigma: Value, theta: Value, theta_dot: Value, theta_ddot: Value
) -> Value:
    """Horizontal acceleration of the beam ü_b, Eq. (14)."""
    s, cos = sincos(sigma * c.alpha - theta)
    return c.two_R * (theta_ddot * cos + theta_dot**2 * s)


def acceleration(c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector) -> Vector:
    """The equations of motion: θ̈ from Eq. (24), ü_t from Eq. (22), under the ground acceleration `ground` =
    ü_g, or ü_g and v̈_g, (C8).

    In full contact (σ = 0) θ̈ = 0 and Eq. (22) is Eq. (4).
    """
    against, added, gravity, ground = 0.0, 0.0, _weight(c, ground), horizontal(ground)
    if c.restrainers:
        s, cos, open_by = _angles(c, sigma, x[0])
        against, added = _restraint(c, open_by, v[0])
    else:
        s, cos = sincos(sigma * c.alpha - x[0])
    if not c.elastic:
        rocks = -jnp.abs(sigma)
        return (rocks * _plus(gravity * s + c.ground * ground * cos, against) / _plus(c.inertia, added),)
    deformation = x[1] - c.two_R * (sigma * c.sin_alpha - s)
    rate = v[1] - c.two_R * v[0] * cos
    spring = c.omega2 * deformation + c.damping * rate  # V_s/m_t, Eq. (7)
    moment = s * (c.centrifugal * v[0] ** 2 * cos - gravity) + cos * (c.coupling * spring - c.ground * ground)
    theta_ddot = jnp.abs(sigma) * _plus(moment, -against) / _plus(c.inertia + c.centrifugal * s**2, added)
    return theta_ddot, -ground - spring


def _plus(value: Value, more: Value | float) -> Value:
    """The sum, where there is something to add: known before tracing."""
    return value if isinstance(more, float) else value + more


def uplift_demand(c: Coefficients, ground: Value | Shaking, x: Vector, v: Vector) -> Value:
    """q of Eq. (9) in full contact; the columns uplift where |q| exceeds `c.uplift`, to the side −sign q.

    Where the ground moves vertically it is what q would be without, at the same share of q_up(t), (C10).
    """
    q = _demand(c, ground, x, v)
    return q / _relief(c, ground) if isinstance(ground, Shaking) else q


def _demand(c: Coefficients, ground: Value | Shaking, x: Vector, v: Vector) -> Value:
    """q of Eq. (9)."""
    ground = horizontal(ground)
    if not c.elastic:
        return ground
    return ground - c.demand * (c.omega2 * x[1] + c.damping * v[1])


def demand_jet(c: Coefficients, grounds, states) -> tuple[Value, Value, Value]:
    """The demand with its first two derivatives in time, from those of the ground motion and of the state
    (x, v): everything is linear in full contact but the weight that vertical motion takes off."""
    if not isinstance(grounds[0], Shaking):
        return tuple(uplift_demand(c, ground, *y) for ground, y in zip(grounds, states, strict=True))  # pyright: ignore[reportReturnType]
    q, q1, q2 = (_demand(c, ground, *y) for ground, y in zip(grounds, states, strict=True))
    r, r1, r2 = _relief(c, grounds[0]), *(c.tilt * ground.vertical / c.uplift for ground in grounds[1:])
    share = q / r
    rate = (q1 - share * r1) / r
    return share, rate, (q2 - 2 * rate * r1 - share * r2) / r


def impact(c: Coefficients, theta_dot: Value) -> Value:
    """θ̇ after an impact: Eq. (27) for θ̇, the same sense of rotation; u_t and u̇_t are continuous, Eq. (26).

    Where e ≤ 0 the result is 0: rocking ends.
    """
    return jnp.maximum(c.restitution, 0.0) * theta_dot


def potential(c: Coefficients, sigma: Value, theta: Value) -> Value:
    """Gravity part of Eq. (19) per N m_c with what restrainers store, zero in full contact [m²/s²], (C3)."""
    if c.restrainers:
        return _restrained_potential(c, sigma, theta)
    _, cos = sincos(sigma * c.alpha - theta)
    return c.weight * jnp.where(sigma == 0, 0.0, cos - c.cos_alpha)


def _restrained_potential(c: Coefficients, sigma: Value, theta: Value) -> Value:
    """V of (C3), without cancellation at small rotations."""
    stretch, lever = elongation(c, sigma, theta)
    # cos ψ − cos α = 2 sin(A/2) sin(α − A/2)
    rise = 0.5 * stretch * (0.5 * sigma * lever - 0.25 * stretch * c.cos_alpha / c.sin_alpha) / c.sin_alpha
    stored = sum((each.potential(stretch) for each in c.restrainers if each.stores), jnp.zeros_like(rise))
    return c.weight * rise + 0.5 * c.two_R * c.g * stored


def potential_slope(c: Coefficients, theta: Value) -> Value:
    """V' of (C5) at |θ| = `theta`, per N m_c [m²/s²]."""
    one = jnp.ones_like(theta)
    return jax.jvp(lambda angle: potential(c, one, angle), (theta,), (one,))[1]


def energy(c: Coefficients, sigma: Value, x: Vector, v: Vector) -> Value:
    """Mechanical energy relative to the ground per N m_c, Eqs. (16)–(19) without the ground's terms [m²/s²],
    (C17)."""
    s, cos = sincos(sigma * c.alpha - x[0])
    if c.restrainers:
        total = 0.5 * spin_with_inerters(c, sigma, x[0]) * v[0] ** 2 + _restrained_potential(c, sigma, x[0])
    else:
        total = 0.5 * c.spin * v[0] ** 2 + c.weight * jnp.where(sigma == 0, 0.0, cos - c.cos_alpha)
    if c.elastic:
        deformation = x[1] - c.two_R * (sigma * c.sin_alpha - s)
        top = v[1] ** 2 + (c.two_R * v[0] * s) ** 2  # v̇_t = v̇_b, Eqs. (15), (17)
        total = total + 0.5 * c.eta * (top + c.omega2 * deformation**2)
    return total


def damper_power(c: Coefficients, sigma: Value, x: Vector, v: Vector) -> Value:
    """What restrainers take, (C/m_c)|ℓ̇|^(1+ν) of dampers, per N m_c [m²/s³]."""
    rate = elongation(c, sigma, x[0]).lever * v[0] / c.p
    taken = sum((each.power(rate, c.slip) for each in c.restrainers), jnp.zeros_like(rate))
    return 0.5 * c.two_R * c.g * c.p * taken


def power(
    c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector
) -> tuple[Value, Value]:
    """What the ground gives and what the damper takes, per N m_c [m²/s³]; between impacts Ė is their
    difference.

    The ground gives −ü_g[(½+γ)u̇_b + η u̇_t], the work of its inertia forces in Eq. (19); the damper of Eq.
    (22) takes 2ζω_s η (u̇_t − u̇_b)². Vertical motion gives −v̈_g w v̇_b, (C18).
    """
    _, beam_rate = beam(c, sigma, x[0], v[0])
    heavy = 0.5 * c.ground * c.g / c.p**2  # ½+γ
    lifted = 0.0
    if isinstance(ground, Shaking):
        rises, _ = sincos(sigma * c.alpha - x[0])
        lifted = -ground.vertical * 0.5 * c.gravity / c.p**2 * c.two_R * v[0] * rises
        ground = ground.horizontal
    if not c.elastic:
        return _plus(-ground * heavy * beam_rate, lifted), jnp.zeros_like(beam_rate)
    given = _plus(-ground * (heavy * beam_rate + c.eta * v[1]), lifted)
    return given, c.eta * c.damping * (v[1] - beam_rate) ** 2


def restoring_moment(c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector) -> Value:
    """The moment about the edges that holds the frame up, over its value at uplift [–].

    Full contact bears what is asked of it, −q/q_up, Eq. (9). While rocking, the vertical forces of the ground
    act at the edges: they bear the weights and what lifts them, (sin ψ/sin α)[1 + (2γ+2η+½)/(2γ+2η+1) v̈_b/g]
    with v̈_b of Eq. (15). The columns' centres rise half as fast as the beam. Both are σ at uplift, where
    v̈_b = 0. Restrainers add their forces times their levers, (C22).
    """
    s, cos = sincos(sigma * c.alpha - x[0])
    theta_ddot = acceleration(c, sigma, ground, x, v)[0]
    rises = c.two_R * (theta_ddot * s - v[0] ** 2 * cos)
    share = 1 + (1 - 0.5 * c.p**2 / c.gravity) * rises / c.g
    if isinstance(ground, Shaking):
        share = share + ground.vertical / c.g
    rocking = s / c.sin_alpha * share
    if c.restrainers:
        rocking = _with_restrainers(c, sigma, x[0], v[0], theta_ddot, rocking)
    return jnp.where(sigma == 0, -_demand(c, ground, x, v) / c.uplift, rocking)


def _with_restrainers(
    c: Coefficients, sigma: Value, theta: Value, theta_dot: Value, theta_ddot: Value, rocking: Value
) -> Value:
    """The moment of weights over their own at uplift, with that of restrainers and over that of both."""
    stretch, lever = elongation(c, sigma, theta)
    rate = lever * theta_dot / c.p
    zero = jnp.zeros_like(stretch)
    forces = sum((each.force(stretch, rate, c.slip) for each in c.restrainers), zero)
    pressed = sum((each.force(zero, zero, c.slip) for each in c.restrainers), zero)
    if c.apparent_mass is not None:
        lengthening = lever * theta_ddot - 0.25 * stretch * theta_dot**2  # ℓ̈/R
        forces = forces + 0.5 * c.two_R / c.g * c.apparent_mass * lengthening
    weight = c.weight / (c.two_R * c.g)  # w
    return (weight * rocking + 0.5 * forces * lever / c.sin_alpha) / (weight + pressed)


def vertical_impulse(c: Coefficients, steepest: Value) -> Value:
    """C_v of (C19) over C, with `steepest` the largest |sin ψ|: what ∫|v̈_g| dt counts beside ∫|ü_g| dt."""
    spin, weight = c.spin / (0.5 * c.two_R) ** 2, c.gravity / c.p**2
    return weight * steepest / jnp.sqrt(2 * (spin + 4 * c.eta * steepest**2)) / c.impulse


def energy_after(c: Coefficients, now: Value, impulse: Value) -> Value:
    """The most that the energy can ever be again, when ∫|ü_g| dt = `impulse` is still to come.

    The ground does work at the rate −ü_g[(½+γ)u̇_b + η u̇_t] per N m_c; by Cauchy–Schwarz that is at most
    2C|ü_g|√T with C² = (1+2γ)²/(2(1+λ+4γ)) + η/2, so √E grows at most at the rate C|ü_g|. Damping and impacts
    only take. Valid while the potential cannot be negative, that is within |θ| ≤ 2α without restrainers.
    """
    return (jnp.sqrt(jnp.maximum(now, 0.0)) + c.impulse * impulse) ** 2


def shear(c: Coefficients, sigma: Value, ground: Value | Shaking, x: Vector, v: Vector, a: Vector) -> Value:
    """Shear of the superstructure over its weight, V_s/(m_t g), Eq. (7): its absolute horizontal acceleration
    over −g."""
    ground = horizontal(ground)
    if c.elastic:
        return -(a[1] + ground) / c.g
    return -(beam_acceleration(c, sigma, x[0], v[0], a[0]) + ground) / c.g
