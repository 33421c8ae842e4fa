"""Bounds on forces in the joints, from bounds on the remaining motion of a scene (one podium under one
excitation).

T and N are the horizontal and the vertical force in a joint, and V is the horizontal force on the foundation.
Forces are per column and divided by the mass m_c of a column [m/s²], as in `joint_forces`. The bounds on
forces of rocking columns are written for the contact mode σ = 1; rocking with σ = −1 is the mirror image.
F_i is the force of spring and damper of mode i divided by the modal mass [m/s²], and d_i is the deformation
of mode i [m]. Equations without a letter are those of docs/model.md; (F…) are in docs/forces.md and
docs/equations.md.
"""

from __future__ import annotations

import functools
import itertools
from typing import NamedTuple, Self

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import Bounds
from rockjax._engine.coefficients import Coefficients, Vibration, not_none, weighted
from rockjax._engine.model import restraint_bound
from rockjax._engine.ratio import safe_ratio
from rockjax._programs.barrier import barrier
from rockjax._sincos import sincos
from rockjax._types import Flag, Value, Values

from .views import Bounces

Pair = tuple[Value, Value]  # values at the bottom and the top joint
Span = tuple[Value, Value]  # lower and upper bound


def _product(a: Span, b: Span) -> Span:
    """Bound the product of two values with given bounds."""
    products = [x * y for x, y in itertools.product(a, b)]
    return functools.reduce(jnp.minimum, products), functools.reduce(jnp.maximum, products)


def _sum(*terms: tuple[Value | float, tuple[Value | float, Value | float]]) -> Span:
    """Bound Σ factor·value. Each of the `terms` is a factor and the bounds on its value."""
    low = [jnp.minimum(factor * a, factor * b) for factor, (a, b) in terms]
    high = [jnp.maximum(factor * a, factor * b) for factor, (a, b) in terms]
    return functools.reduce(jnp.add, low), functools.reduce(jnp.add, high)


class Devices(NamedTuple):
    """Bounds on the sum of the forces of a group of restrainers [m/s²]."""

    least: Value
    least_vertical: Value  # lower bound on the vertical component of the sum, which is the sum times cos(θ/2)
    largest: Value


class Rotation(NamedTuple):
    """Bounds on the rotation and on the factors of Eq. (24). If the columns rest for good, `angle`,
    `speed_squared` and `flexibility` are zero.

    - `angle`: bound on |θ| [rad]
    - `sin`, `cos`: bounds on sin ψ and cos ψ, with ψ = α − θ
    - `speed_squared`: bound on θ̇² [1/s²]
    - `flexibility`: bounds on the reciprocal of the factor of θ̈ in Eq. (24) [–]
    - `resisting`: bound on the moment of the restrainers on the right side of Eq. (24) [1/s²]
    """

    angle: Value
    sin: Span
    cos: Span
    speed_squared: Value
    flexibility: Span
    resisting: Value | float


class JointBounds:
    """Bounds on joint forces, from bounds on the motion.

    A force is a sum of terms with θ̈, θ̇², the ground acceleration, the F_i and the d_i. Eq. (24) replaces θ̈ by
    the other quantities. All terms with F_i are then bounded together, and the energy of the scene bounds the
    sum of the energies of rotation and vibration.

    - `c`: constants of the podium
    - `ground`, `vertical`: bounds on |ü_g| and |v̈_g| [m/s²]
    - `eccentricity`: bound on |χ|, the distance of the joint forces from the centre line of a column divided
      by half the width of a column [–]; 1 unless the columns rest for good
    - `rotation`: bounds on the rotation
    - `bounds`: bounds on the motion, including the vibration; None for a rigid podium
    """

    def __init__(
        self,
        c: Coefficients,
        ground: Value,
        vertical: Value | float,
        eccentricity: Value,
        rotation: Rotation,
        bounds: Bounds | None,
    ):
        self.c, self.joints = c, not_none(c.joints)
        self.ground, self.vertical, self.eccentricity = ground, vertical, eccentricity
        self.rotation, self.bounds = rotation, bounds
        # Sine and cosine of the largest |ψ|, which can exceed α only with restrainers.
        self.sin = c.sin_alpha if c.restraint is None else jnp.maximum(-rotation.sin[0], rotation.sin[1])
        self.cos = rotation.cos[0]
        # Bounds on θ̈, including θ̈ = 0 of full contact. The bounds on the vertical acceleration v̈_b of the
        # beam follow by Eq. (15).
        zero, one = jnp.zeros_like(c.alpha), jnp.ones_like(c.alpha)
        least, self._most_turning = self._extremes(rotation, 0.0, (one, one), (zero, zero), 0.0)
        least, self._most_turning = barrier((least, self._most_turning))
        self._turning = turning = jnp.minimum(least, 0.0), jnp.maximum(self._most_turning, 0.0)
        drop = rotation.speed_squared * rotation.cos[1]
        least, most = _product(turning, rotation.sin)
        self._rise = barrier((c.two_R * (least - drop), c.two_R * most))

    @classmethod
    def from_bounds(cls, bounds: Bounds) -> Self:
        """Return the bounds on forces that follow from bounds on the motion. All outputs share the result,
        which is computed once."""
        return bounds.shared(cls._compute)

    @classmethod
    def _compute(cls, bounds: Bounds) -> Self:
        c, zero, one = bounds.c, jnp.zeros_like(bounds.c.alpha), jnp.ones_like(bounds.c.alpha)
        speed_squared = 2 * bounds.energy / c.spin
        # The potential energy, Eq. (19), increases with cos ψ, so the energy bounds cos ψ.
        largest_cos = jnp.minimum(c.cos_alpha + bounds.energy / c.weight, 1.0)
        sin, cos = (jnp.sqrt(1 - largest_cos**2), c.sin_alpha), (c.cos_alpha, largest_cos)
        added = resisting = 0.0
        if c.restraint is not None:
            beyond = jnp.maximum(bounds.well - c.alpha, 0.0)
            sin, cos = (-jnp.sin(beyond), c.sin_alpha), (jnp.minimum(c.cos_alpha, jnp.cos(beyond)), one)
            resisting = restraint_bound(c, c.restraint, bounds.well, jnp.sqrt(speed_squared))
            if c.restraint.apparent_mass is not None:
                added = 3 * c.restraint.apparent_mass * c.sin_alpha**2
        least_sin = jnp.maximum(sin[0], 0.0)
        steepest = jnp.maximum(-sin[0], sin[1])
        flexibility = (
            1 / (c.inertia + c.centrifugal * steepest**2 + added),
            1 / (c.inertia + c.centrifugal * least_sin**2),
        )
        zero_at_rest = lambda rocking: bounds.either(zero, rocking)
        eccentricity = one
        if not isinstance(bounds.rests, bool):
            eccentricity = bounds.either(bounds.demand / c.uplift, one)
        rotation = Rotation(
            zero_at_rest(bounds.well), sin, cos, zero_at_rest(speed_squared),
            (zero_at_rest(flexibility[0]), zero_at_rest(flexibility[1])), resisting,
        )  # fmt: skip
        rotation = barrier(rotation)
        modes = None if c.vibration is None else bounds
        return cls(c, bounds.ground, bounds.vertical, eccentricity, rotation, modes)

    @classmethod
    def over(cls, bounces: Bounces) -> Self:
        """Return the bounds on forces during bounces of a rigid podium."""
        c, one = bounces.c, jnp.ones_like(bounces.c.alpha)
        sin = jnp.maximum(c.sin_alpha - bounces.height, 0.0), c.sin_alpha
        cos = c.cos_alpha, jnp.minimum(c.cos_alpha + bounces.height * c.sin_alpha, 1.0)
        flexibility = 1 / c.inertia, 1 / c.inertia
        rotation = Rotation(bounces.height, sin, cos, bounces.speed**2, flexibility, 0.0)
        return cls(c, bounces.ground, 0.0, one, rotation, None)

    def _extremes(
        self,
        rotation: Rotation,
        axial: Value | float,
        turning: Span,
        centripetal: Span,
        push: Value | float,
        modal: Values | float = 0.0,
        sway: Value | float = 0.0,
    ) -> Span:
        """Bound a·(g + v̈_g) + n θ̈ − z θ̇² + b ü_g + Σ w_iF_i + k Σ η_id_i [m/s²] while the columns rock. The
        sums are over the modes i, and η_i is the mass ratio of mode i.

        - `rotation`: bounds on the rotation
        - `axial`: a
        - `turning`, `centripetal`: bounds on n and z
        - `push`: b
        - `modal`, `sway`: w_i and k

        Eq. (24) replaces θ̈ by terms with the other quantities.
        """
        c, (_, sin, cos, speed_squared, flexibility, resisting) = self.c, rotation
        moment = _product(turning, flexibility)
        along, across = _product(moment, sin), _product(moment, cos)
        # Weights, ground motion and restrainers.
        weights = _sum((1.0, (axial, axial)), (-c.gravity / c.g, along))
        levels = [c.g] if isinstance(self.vertical, float) else [c.g - self.vertical, c.g + self.vertical]
        least = functools.reduce(jnp.minimum, [weights[0] * y for y in levels])
        most = functools.reduce(jnp.maximum, [weights[1] * y for y in levels])
        by_ground = _sum((1.0, (push, push)), (-c.ground, across))
        others = jnp.maximum(-by_ground[0], by_ground[1]) * self.ground
        if c.restraint is not None:
            others = others + jnp.maximum(-moment[0], moment[1]) * resisting
        # Rotation and modes. The terms with θ̇² are at least −rates[1]·θ̇² and at most −rates[0]·θ̇².
        if c.vibration is None:
            lower, upper = (jnp.maximum(y, 0.0) * speed_squared for y in (centripetal[1], -centripetal[0]))
            return least - others - lower, most + others + upper
        rates = _sum((1.0, centripetal), (-c.centrifugal, _product(along, cos)))
        turned = 3 * across[0] / c.two_R, 3 * across[1] / c.two_R
        lower, upper = self._vibration(rotation, modal, turned, sway, (rates[1], -rates[0]))
        return barrier((least - others - lower, most + others + upper))

    def _extremes_in_contact(
        self, axial: Value, push: Value | float, modal: Values | float, sway: Value | float
    ) -> Span:
        """Bound a·(g + v̈_g) + b ü_g + Σ w_iF_i + k Σ η_id_i in full contact, with a, b, w_i and k as for
        `_extremes`."""
        c, others = self.c, jnp.abs(push) * self.ground
        if c.vibration is not None:
            modes, zero = c.vibration, jnp.zeros_like(c.etas)
            stiffness = jnp.sqrt(modes.omega2 + modes.damping**2)
            weights = jnp.abs(modal + zero) * stiffness + jnp.abs(sway) * c.etas / jnp.sqrt(modes.omega2)
            others = others + not_none(self.bounds).modal_sum(weights)
        others = others + jnp.abs(axial) * self.vertical
        return axial * c.g - others, axial * c.g + others

    def _vibration(
        self, rotation: Rotation, modal: Values | float, turned: Span, sway: Value | float, rates: Span
    ) -> Pair:
        """Bound |Σ (w_i + u η_i) F_i| + |k Σ η_id_i| + r θ̇² for two values of r; r < 0 counts as 0.

        - `rotation`: bounds on the rotation
        - `modal`, `sway`: w_i and k
        - `turned`: bounds on u
        - `rates`: both values of r

        Let m² = Σ η_i(u̇_i² + ω_i²d_i²) and y² = J θ̇², where J is `Coefficients.spin`. The expression is at
        most P m + Q y + r y²/J. The term with P bounds the effect of the modes, and the term with Q that of
        the beam, which moves one end of each damper. The bound E on the energy gives m² + y² ≤ 2E = ρ². For
        y = sρ with 0 ≤ s ≤ 1, m ≤ ρ√(1 − s²) ≤ ρ(1 − ½s²). The expression is therefore at most
        Pρ + Qρ s + (rρ²/J − ½Pρ) s². The function returns the largest value of this parabola for s from 0 to
        1. `by_modes` is Pρ, and `by_beam` is Qρ.
        """
        c, bounds = self.c, not_none(self.bounds)
        modes: Vibration = not_none(c.vibration)
        middle, spread = 0.5 * (turned[0] + turned[1]), 0.5 * (turned[1] - turned[0])
        weights = jnp.abs(modal + middle * c.etas) + spread * c.etas
        stiffness = jnp.sqrt(modes.omega2 + modes.damping**2)
        by_modes = bounds.modal_sum(weights * stiffness + jnp.abs(sway) * c.etas / jnp.sqrt(modes.omega2))
        by_beam = c.two_R * rotation.cos[1] * weighted(weights, modes.damping)
        by_beam = by_beam * jnp.sqrt(rotation.speed_squared)

        def bound(rate: Value) -> Value:
            excess = jnp.maximum(rate, 0.0) * rotation.speed_squared - 0.5 * by_modes
            s = jnp.where(
                excess < 0, jnp.minimum(-0.5 * by_beam / jnp.where(excess < 0, excess, -1.0), 1.0), 1.0
            )
            return by_modes + s * (by_beam + s * excess)

        return bound(rates[0]), bound(rates[1])

    def _devices(self, joint_count: int) -> Devices:
        """Bound the sum of the forces of the restrainers that span `joint_count` joints (1 or 2), f_1 or f_2
        of (F2)."""
        c, zero = self.c, jnp.zeros_like(self.c.alpha)
        if c.restraint is None:
            return Devices(zero, zero, zero)
        s, cos = sincos(0.5 * self.rotation.angle)
        stretch, rate = 4 * c.sin_alpha * s, 2 * c.sin_alpha * jnp.sqrt(self.rotation.speed_squared) / c.p
        slip, least, most = c.restraint.slip, zero, zero
        for restrainer in c.restraint.restrainers:
            if restrainer.joints != joint_count:
                continue
            at_rest, stretched = (restrainer.force(y, zero, slip) for y in (zero, stretch))
            damping = restrainer.force(zero, rate, slip) - at_rest
            least, most = least + c.g * (at_rest - damping), most + c.g * (stretched + damping)
            if restrainer.apparent_mass is not None:
                inertia = 0.5 * c.two_R * restrainer.apparent_mass * c.sin_alpha
                inertia = inertia * (
                    2 * jnp.maximum(-self._turning[0], self._turning[1]) + self.rotation.speed_squared * s
                )
                least, most = least - inertia, most + inertia
        return Devices(least, jnp.minimum(least, cos * least), most)

    @functools.cached_property
    def _over_both(self) -> Devices:
        return self._devices(2)

    @functools.cached_property
    def _over_one(self) -> Devices:
        return self._devices(1)

    def _weight(self, share: float) -> Span:
        """Return lower and upper bounds on g + v̈_g + `share`·v̈_b [m/s²]."""
        least, most = (self.c.g + share * y for y in self._rise)
        return least - self.vertical, most + self.vertical

    @property
    def _levers(self) -> tuple[Value, ...]:
        """Least and largest `Arms.lever` in the direction of χ, for columns with round ends [m]. For flat
        ends, the single value χB."""
        arms, (_, sin, cos, *_) = self.joints.arms, self.rotation
        flat = 0.5 * self.c.two_R * self.c.sin_alpha
        if arms is None or arms.raised is None:
            return (flat * self.eccentricity,)
        leans = _product(sin, (1 / cos[1], 1 / cos[0]))
        return tuple(arms.lever(flat, lean) * self.eccentricity for lean in leans)

    @functools.cached_property
    def _top(self) -> Span:
        """Lower and upper bounds on N at the top joint of all columns [m/s²]. The extremes are at the end
        columns. By (F8) they are N_t (1 ± χB/ℓ_p) ± M/ℓ_p. N_t is the mean of N, M the overturning moment
        divided by the mass of all columns, B half the width of a column and ℓ_p the core distance. For round
        ends, `Arms.lever` replaces χB; the extremes are then at one of its bounds `_levers`."""
        c, arms, devices, rotation = self.c, self.joints.arms, self._over_both, self.rotation
        mass, spans = self.joints.gamma + c.eta, []
        for side, lever in itertools.product((0.0,) if arms is None else (-1.0, 1.0), self._levers):
            share, beam, modal, sway = jnp.ones_like(c.alpha), jnp.zeros_like(c.alpha), 0.0, 0.0
            if arms is not None:
                factor = side / arms.core_distance
                share = 1 + factor * lever
                beam = factor * arms.beam
                if c.vibration is not None:
                    heaviest = c.g + self.vertical + jnp.maximum(-self._rise[0], self._rise[1])
                    modal, sway = factor * not_none(arms.modes), factor * heaviest
            axial = mass * share
            turning = _sum((c.two_R * axial, rotation.sin), (-c.two_R * beam, rotation.cos))
            centripetal = _sum((c.two_R * axial, rotation.cos), (c.two_R * beam, rotation.sin))
            forces = devices.least_vertical, jnp.maximum(devices.largest, 0.0)
            of_devices = _product((share, share), forces)
            for span in (
                self._extremes(rotation, axial, turning, centripetal, -beam, modal, sway),
                self._extremes_in_contact(axial, beam, modal, sway),
            ):
                spans.append((span[0] + of_devices[0], span[1] + of_devices[1]))
        lower, upper = zip(*spans, strict=True)
        return barrier((functools.reduce(jnp.minimum, lower), functools.reduce(jnp.maximum, upper)))

    @functools.cached_property
    def least_axial(self) -> Pair:
        """Lower bounds on N of all columns at the bottom and the top joint [m/s²]."""
        top = self._top[0]
        return top + self._weight(0.5)[0] + 2 * self._over_one.least_vertical, top

    @functools.cached_property
    def most_axial(self) -> Pair:
        """Upper bounds on N of all columns at the bottom and the top joint [m/s²]."""
        top = self._top[1]
        return top + self._weight(0.5)[1] + 2 * jnp.maximum(self._over_one.largest, 0.0), top

    @functools.cached_property
    def foundation_shear(self) -> Value:
        """Bound on |V| [m/s²], (F5). In full contact, (F10) also gives V = ½[ü_g − ξ tan α (N_b + N_t)], and
        the smaller of both bounds holds. ξ is χ in full contact, and N_b and N_t are the axial forces at the
        bottom and the top joint of the mean column."""
        c, rotation = self.c, self.rotation
        swaying = c.two_R * (0.5 + self.joints.gamma)
        turning = _sum((swaying, rotation.cos))
        centripetal = _sum((-swaying, rotation.sin))
        least, most = self._extremes(rotation, 0.0, turning, centripetal, 1 + self.joints.gamma, -c.etas)
        axial = (1 + 2 * (self.joints.gamma + c.eta)) * (c.g + self.vertical)
        axial = axial + 2 * jnp.maximum(self._over_both.largest + self._over_one.largest, 0.0)
        by_eccentricity = 0.5 * (self._contact_eccentricity * axial * c.sin_alpha / c.cos_alpha + self.ground)
        zero = jnp.zeros_like(c.alpha)
        by_masses = self._extremes_in_contact(zero, 1 + self.joints.gamma, c.etas, zero)[1]
        return jnp.maximum(jnp.maximum(-least, most), jnp.minimum(by_eccentricity, by_masses))

    @functools.cached_property
    def friction(self) -> Pair:
        """Bounds on |T|/N of all columns at the bottom and the top joint; inf if N may vanish, but 0 for a
        joint that carries no axial force at all."""
        return self._friction_at(0), self._friction_at(1)

    def _friction_at(self, joint: int) -> Value:
        """Bound |T|/N of all columns at the bottom (0) or the top joint (1).

        Without restrainers, with g_v = g + v̈_g and σ = 1, (F9) gives

            |T|/N = |tan ψ − ½X/N|,   X = ü_g + g_v tan ψ + (1 − λ)Rθ̈/cos ψ   at the bottom joint,
            |T|/N = |tan ψ + ½X/N|,   X = ü_g + g_v tan ψ + (1 + λ)Rθ̈/cos ψ   at the top joint.
        """
        c, lam, least, most = self.c, self.joints.lam, self.least_axial[joint], self.most_axial[joint]
        steepest = self.sin / self.cos * self.eccentricity
        lightest, heaviest = c.g - self.vertical, c.g + self.vertical
        arm = 0.5 * c.two_R * (1 + lam if joint else 1 - lam)
        # If N is at least half the weight of the column, the largest demand is at ψ = α.
        is_heavy = least > 0.5 * heaviest
        # `along` is an upper bound on the term that increases |T|/N beyond tan ψ: −X at the bottom joint, X
        # at the top joint. `opposite` is an upper bound on −1 times this term, which may reverse T.
        weight = heaviest * steepest
        lever = arm / self.cos
        slowing, speeding = _product((lever, lever), self._turning)  # the first is ≤ 0, the second ≥ 0
        if c.restraint is not None:
            forces = [
                jnp.maximum(jnp.abs(y.least), jnp.abs(y.largest)) for y in (self._over_both, self._over_one)
            ]
            couple = c.cos_alpha * (forces[0] + forces[1]) * sincos(0.5 * self.rotation.angle)[0]
            along = self.ground + jnp.maximum(-slowing, speeding) + weight
            along = opposite = along + 2 * (couple + forces[1]) / self.cos
        elif joint:
            along = self._without_weight(is_heavy, arm)[1] + weight
            opposite = self.ground - slowing
        else:
            along = -self._without_weight(is_heavy, arm)[0] - jnp.where(is_heavy, lightest * steepest, 0.0)
            opposite = self.ground + speeding + weight
        is_closed, carries_nothing = least > 0, (most == 0) & (least == 0)
        least, most = (jnp.where(is_closed, y, 1.0) for y in (least, most))
        demand = steepest + 0.5 * along / jnp.where(along > 0, least, most)
        demand = jnp.maximum(demand, 0.5 * opposite / least)
        if c.restraint is None:
            demand = jnp.maximum(demand, self._friction_in_contact(joint, is_heavy, least))
        return jnp.where(is_closed, demand, jnp.where(carries_nothing, 0.0, jnp.inf))

    def _without_weight(self, at_uplift: Flag, arm: Value) -> Span:
        """Bound ü_g + `arm`·θ̈/cos ψ [m/s²], the part of X in `_friction_at` without the weight; only at ψ = α
        if `at_uplift`."""
        c, rotation, zero = self.c, self.rotation, jnp.zeros_like(self.c.alpha)
        uplift = (c.sin_alpha,) * 2, (c.cos_alpha,) * 2, (rotation.flexibility[0],) * 2
        bounds = rotation.sin, rotation.cos, rotation.flexibility
        sin, cos, flexibility = jax.tree.map(functools.partial(jnp.where, at_uplift), uplift, bounds)
        rotation = rotation._replace(sin=sin, cos=cos, flexibility=flexibility)
        turning = _product((arm, arm), (1 / cos[1], 1 / cos[0]))
        return self._extremes(rotation, 0.0, turning, (zero, zero), 1.0)

    def _friction_in_contact(self, joint: int, is_heavy: Flag, least: Value) -> Value:
        """Bound |T|/N in full contact without restrainers, (F11). If nothing vibrates,
        |T|/N = |ü_g|/(g + v̈_g).

        - `joint`: 0 for the bottom joint, 1 for the top joint
        - `is_heavy`: whether N is at least half the largest weight of the column
        - `least`: lower bound on N [m/s²]
        """
        c = self.c
        lean = self._contact_eccentricity * c.sin_alpha / c.cos_alpha
        if c.vibration is None:
            return jnp.minimum(lean, self.ground / jnp.maximum(c.g - self.vertical, 0.01 * c.g))
        if joint:
            return lean + 0.5 * (self.ground + (c.g + self.vertical) * lean) / least
        return lean + 0.5 * (self.ground - jnp.where(is_heavy, (c.g - self.vertical) * lean, 0.0)) / least

    @functools.cached_property
    def _contact_eccentricity(self) -> Value:
        """Bound on |ξ| in full contact, (F10).

        Eq. (24) at ψ = α and θ̇ = 0 has a value of θ̈, although the columns do not rotate in full contact. It
        is (1 − ξ) θ̈_w, where θ̈_w < 0 is its value under the weights alone. Thus ξ = 1 + θ̈/|θ̈_w|, and an upper
        bound on θ̈ gives an upper bound on ξ."""
        c = self.c
        if c.restraint is not None:
            return self.eccentricity
        falling = self.rotation.flexibility[0] * c.gravity * (1 + self.vertical / c.g) * c.sin_alpha
        share = 1 + safe_ratio(self._most_turning, falling, falling > 0)
        return self.eccentricity * jnp.clip(share, 0.0, 1.0)
