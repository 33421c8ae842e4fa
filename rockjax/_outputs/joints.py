"""Base classes of outputs at the joints, forces of the end columns, and bounds on forces, (F17).

Forces are per column and divided by m_c [m/s²], as in `joint_forces`.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import jax
import jax.numpy as jnp

from rockjax import _results as results
from rockjax._engine.bounds import Bounds
from rockjax._engine.coefficients import Coefficients, present
from rockjax._outputs.joint_forces import column_forces
from rockjax._sincos import sincos
from rockjax._structures import Podium
from rockjax._types import Flag, Flags, Value, Values

from .base import JOINTS, AbstractOutput
from .views import Bounces, Ended, Moment, Start

Pair = tuple[Value, Value]  # values at the bottom and the top joint


@jax.custom_jvp
def quarter_tangent(tangential: Values, axial: Values) -> Values:
    """Return tan(φ/4) ∈ [−1, 1] for the angle φ = atan2(T, N) of a force from the vertical; 0 for no force.

    Like φ, the result is smooth at N = 0. Square roots are used because an arc tangent is much slower in
    batches.
    """
    squares, is_zero = _squares(tangential, axial)
    size = jnp.sqrt(squares)
    large = jnp.sqrt(0.5 * (1 + jnp.abs(axial) / size))  # the larger one of |sin φ/2| and cos φ/2
    small = 0.5 * tangential / (size * large)
    numerator = jnp.where(axial < 0, jnp.where(tangential < 0, -large, large), small)
    denominator = 1 + jnp.where(axial < 0, jnp.abs(small), large)
    return jnp.where(is_zero, 0.0, numerator / denominator)


@quarter_tangent.defjvp
def _quarter_tangent_jvp(forces, rates):
    (tangential, axial), (tangential_rate, axial_rate) = forces, rates
    quarter = quarter_tangent(tangential, axial)
    squares, is_zero = _squares(tangential, axial)
    slope = jnp.where(is_zero, 0.0, 0.25 * (1 + quarter**2) / squares)
    return quarter, slope * (axial * tangential_rate - tangential * axial_rate)


def _squares(tangential: Values, axial: Values) -> tuple[Values, Flags]:
    """Return T² + N², or 1 if it is zero, and whether it is zero."""
    squares = tangential**2 + axial**2
    return jnp.where(squares == 0, 1.0, squares), squares == 0


def friction_of(quarter: Values) -> Values:
    """Return the friction demand |T|/N = tan φ for `quarter` = tan(φ/4) ≥ 0. The result is inf for φ ≥ π/2,
    where a joint would open, and NaN for NaN."""
    half = 2 * quarter / (1 - jnp.where(quarter < 1, quarter, 0.0) ** 2)
    is_closed = ~((quarter >= 1) | (half >= 1))
    return jnp.where(is_closed, 2 * half / (1 - jnp.where(is_closed, half, 0.0) ** 2), jnp.inf)


def end_offsets(c: Coefficients) -> tuple[Value, Value] | None:
    """Return the positions of the first and the last column relative to the mean of all columns [m]; None if
    no elevation is given. Forces and friction are monotone from column to column, so one of these two is the
    worst."""
    arms = present(c.joints).arms
    return None if arms is None else (jnp.min(arms.offsets), jnp.max(arms.offsets))


def end_forces(moment: Moment) -> tuple[Value, ...]:
    """Return T of the end columns at the bottom joint, then at the top joint, and then N in the same order
    [m/s²]."""
    c, sigma, _, ground, x, v, a = moment
    tangential, axial = column_forces(c, sigma, ground, x, v, a, end_offsets(c))
    return (*tangential, *axial)


T = TypeVar("T")


def halves(row: Sequence[T]) -> tuple[Sequence[T], Sequence[T]]:
    """Return the two halves of a row."""
    half = len(row) // 2
    return row[:half], row[half:]


def all_of(flags: Iterable[Flag]) -> Flag:
    """Return whether all flags hold."""
    return functools.reduce(jnp.logical_and, flags)


@dataclasses.dataclass(frozen=True)
class AbstractForceOutput(AbstractOutput):
    """An output that needs joint forces. It has an answer only if it is requested."""

    needs_flat = True
    of_joints = True

    def is_unchanged(self, bounds: JointBounds, accumulator: Any) -> Flag:
        """Return whether no forces within the bounds change the accumulator."""
        raise NotImplementedError

    def over_bounces(self, bounces: Bounces, accumulator: Any) -> Flag | bool:
        return self.is_unchanged(JointBounds.over(bounces), accumulator)

    def is_final(self, bounds: Bounds, accumulator: Any) -> Flag | bool:
        return self.is_unchanged(JointBounds.of(bounds), accumulator)

    def nan_if_weightless(self, ended: Ended, values: Values | Sequence[Value]) -> Values:
        """Return the values as an array, or NaN if the scene ended because vertical motion would open all
        joints."""
        return jnp.where(ended.code == results.WEIGHTLESS, jnp.nan, jnp.asarray(values))

    def absent(self, ended: Ended) -> dict[str, Any]:
        del ended
        return {}


@dataclasses.dataclass(frozen=True)
class AbstractJointOutput(AbstractForceOutput):
    """An output with an answer for each joint, (2,). The accumulator is a tuple of scalars for the end
    columns at the bottom joint, then for the end columns at the top joint."""

    axis = JOINTS
    joints: ClassVar[int] = 2

    columns: int = 1  # columns in the accumulator: the mean column (1) or, with an elevation, both ends (2)

    def of(self, podium: Podium) -> Self:
        return dataclasses.replace(self, columns=1 if podium.elevation is None else 2)

    def worst(self, accumulator: Sequence[Value]) -> Pair:
        """Return the largest value of the columns at each joint."""
        bottom, top = halves(accumulator)
        return functools.reduce(jnp.maximum, bottom), functools.reduce(jnp.maximum, top)

    def filled(self, start: Start, value: float) -> tuple[Value, ...]:
        """Return an accumulator in which all columns and joints have this value."""
        return (jnp.full((), value, start.t.dtype),) * (self.joints * self.columns)


class Devices(NamedTuple):
    """Bounds on the sum of some restrainers' forces [m/s²]."""

    least: Value
    least_vertical: Value  # lower bound of the vertical component, force times cos(θ/2)
    largest: Value


class Deceleration(NamedTuple):
    """Bounds on the deceleration s = −σθ̈ of rocking columns: slope·sin ψ − offset ≤ s ≤ largest [1/s²]."""

    largest: Value
    slope: Value
    offset: Value


class ModalBounds(NamedTuple):
    """Bounds on sums over the modes i, with spring forces F_i, heights h_i and deformations d_i."""

    springs: Value  # |Σ η_iF_i| [m/s²]
    moment: Value  # |Σ η_ih_iF_i| [m²/s²]
    sway: Value  # |Σ η_id_i| [m]


class JointBounds:
    """Bounds on joint forces, (F17), from bounds on the motion.

    - `c`: constants of the podium
    - `ground`, `vertical`: bounds on |ü_g| and |v̈_g| [m/s²]
    - `eccentricity`: bound on the eccentricity |χ| of the resultants, 1 while the columns rock [–]
    - `angle`, `speed_squared`: bounds on |θ| [rad] and on θ̇² [1/s²]
    - `least_sin`: lower bound on sin ψ, not used if there are restrainers
    - `deceleration`: bounds on the deceleration of the columns
    - `modes`: bounds for the vibrating superstructure; None if nothing vibrates
    """

    def __init__(
        self,
        c: Coefficients,
        ground: Value,
        vertical: Value | float,
        eccentricity: Value,
        angle: Value,
        speed_squared: Value,
        least_sin: Value,
        deceleration: Deceleration,
        modes: ModalBounds | None,
    ):
        self.c, self.joints = c, present(c.joints)
        self.ground, self.vertical, self.eccentricity = ground, vertical, eccentricity
        self.angle, self.speed_squared = angle, speed_squared
        self.deceleration, self.modes = deceleration, modes
        # Sine and cosine of the largest |ψ|, which exceeds α only if there are restrainers.
        is_free = c.restraint is None
        steepest = jnp.maximum(c.alpha, angle - c.alpha)
        at_steepest = (c.sin_alpha, c.cos_alpha) if is_free else (jnp.sin(steepest), jnp.cos(steepest))
        self.sin, self.cos = at_steepest
        # Upper bound on the acceleration −s = σθ̈, then lower and upper bounds on σü_b and v̈_b of the beam,
        # Eqs. (14), (15).
        self._acceleration = jnp.maximum(deceleration.offset - deceleration.slope * least_sin, 0.0)
        sin, slowing, speeding = self.sin, deceleration.largest, self._acceleration
        centripetal = 0.0 if is_free else speed_squared * sin  # ψ < 0 is possible only with restrainers
        self._sway = -c.two_R * (slowing + centripetal), c.two_R * (speeding + speed_squared * sin)
        self._rise = -c.two_R * (slowing * sin + speed_squared), c.two_R * (speeding * sin + centripetal)

    @classmethod
    def of(cls, bounds: Bounds) -> Self:
        """Return the bounds on forces after a state, computed once for all outputs."""
        return bounds.shared(cls._of)

    @classmethod
    def _of(cls, bounds: Bounds) -> Self:
        c, zero = bounds.c, jnp.zeros_like(bounds.c.alpha)
        modes = None
        if c.vibration is not None:
            arms = present(c.joints).arms
            moment = zero if arms is None else bounds.springs(jnp.abs(present(arms.modes)))
            sway = zero if arms is None else bounds.modal_sum(c.etas / jnp.sqrt(c.vibration.omega2))
            modes = ModalBounds(bounds.springs(c.etas), moment, sway)
        speed_squared, springs = 2 * bounds.energy / c.spin, None if modes is None else modes.springs
        deceleration = (
            _deceleration_with_restrainers(bounds, springs)
            if c.restraint is not None
            else _deceleration(c, bounds.ground, bounds.vertical, speed_squared, springs)
        )
        # The potential energy, Eq. (19), increases with cos ψ.
        least_sin = jnp.sqrt(jnp.maximum(1 - (c.cos_alpha + bounds.energy / c.weight) ** 2, 0.0))
        zero_at_rest = lambda rocking: bounds.either(zero, rocking)
        eccentricity = one = jnp.ones_like(zero)
        if not isinstance(bounds.rests, bool):
            eccentricity = bounds.either(bounds.demand / c.uplift, one)
        return cls(
            c, bounds.ground, bounds.vertical, eccentricity, zero_at_rest(bounds.well),
            zero_at_rest(speed_squared), least_sin, Deceleration(*map(zero_at_rest, deceleration)), modes,
        )  # fmt: skip

    @classmethod
    def over(cls, bounces: Bounces) -> Self:
        """Return the bounds on forces during bounces of a rigid podium."""
        c, speed_squared = bounces.c, bounces.speed**2
        deceleration = _deceleration(c, bounces.ground, 0.0, speed_squared, None)
        least_sin = jnp.maximum(c.sin_alpha - bounces.height, 0.0)
        one = jnp.ones_like(c.alpha)
        return cls(c, bounces.ground, 0.0, one, bounces.height, speed_squared, least_sin, deceleration, None)

    def _devices(self, joint_count: int) -> Devices:
        """Bound the sum of forces of the restrainers that span `joint_count` joints, f_1 or f_2 of (F2)."""
        c, zero = self.c, jnp.zeros_like(self.c.alpha)
        if c.restraint is None:
            return Devices(zero, zero, zero)
        s, cos = sincos(0.5 * self.angle)
        stretch, rate = 4 * c.sin_alpha * s, 2 * c.sin_alpha * jnp.sqrt(self.speed_squared) / c.p
        slip, least, most = c.restraint.slip, zero, zero
        for restrainer in c.restraint.restrainers:
            if restrainer.joints != joint_count:
                continue
            at_rest, stretched = (restrainer.force(y, zero, slip) for y in (zero, stretch))
            damping = restrainer.force(zero, rate, slip) - at_rest
            least, most = least + c.g * (at_rest - damping), most + c.g * (stretched + damping)
            if restrainer.apparent_mass is not None:
                inertia = 0.5 * c.two_R * restrainer.apparent_mass * c.sin_alpha
                inertia = inertia * (2 * self.deceleration.largest + self.speed_squared * s)
                least, most = least - inertia, most + inertia
        return Devices(least, jnp.minimum(least, cos * least), most)

    @functools.cached_property
    def _over_both(self) -> Devices:
        return self._devices(2)

    @functools.cached_property
    def _over_one(self) -> Devices:
        return self._devices(1)

    def _weight(self, share: float) -> tuple[Value, Value]:
        """Return lower and upper bounds on g + v̈_g + `share`·v̈_b."""
        least, most = (self.c.g + share * y for y in self._rise)
        return least - self.vertical, most + self.vertical

    @functools.cached_property
    def _mean_top(self) -> tuple[Value, Value]:
        """Lower and upper bounds on N_t of the mean column."""
        mass, (least, largest) = self.joints.gamma + self.c.eta, self._weight(1.0)
        devices = self._over_both
        return mass * least + devices.least_vertical, mass * largest + jnp.maximum(devices.largest, 0.0)

    @functools.cached_property
    def _top(self) -> tuple[Value, Value]:
        """Lower and upper bounds on N_t of all columns: N_t (1 ± χB/ℓ_p) ± M/ℓ_p at the end columns, (F8)."""
        arms, c, mean = self.joints.arms, self.c, self._mean_top
        if arms is None:
            return mean
        beam_moments = -arms.beam * (self._sway[0] - self.ground), -arms.beam * (self._sway[1] + self.ground)
        modal_moment = jnp.zeros_like(c.alpha)
        if self.modes is not None:
            modal_moment = self.modes.moment + self._weight(1.0)[1] * self.modes.sway
        moments = jnp.minimum(*beam_moments) - modal_moment, jnp.maximum(*beam_moments) + modal_moment
        lever = 0.5 * c.two_R * c.sin_alpha * self.eccentricity  # χB
        core = arms.core_distance
        extremes = [
            (axial * (core + side * lever) + side * moment) / core
            for side, axial, moment in itertools.product((-1, 1), mean, moments)
        ]
        return functools.reduce(jnp.minimum, extremes), functools.reduce(jnp.maximum, extremes)

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
        """Bound on |V| [m/s²]: the smaller of the bounds that follow from (F5) and from (F9)."""
        c = self.c
        gamma, sway = self.joints.gamma, jnp.maximum(*map(jnp.abs, self._sway))
        springs = 0.0 if self.modes is None else self.modes.springs
        from_masses = (1 + gamma) * self.ground + (0.5 + gamma) * sway + springs
        if c.restraint is not None:
            return from_masses
        axial = self._mean_top[1] + self._weight(0.5)[1]
        fastest = jnp.maximum(self.deceleration.largest, self._acceleration)
        inertia = 0.5 * c.two_R * jnp.abs(1 - self.joints.lam) * fastest
        from_axial = axial * self.eccentricity * self.sin + 0.5 * (self.ground * self.cos + inertia)
        return jnp.minimum(from_masses, from_axial / self.cos)

    @functools.cached_property
    def friction(self) -> Pair:
        """Bounds on |T|/N of all columns at the bottom and the top joint; inf where N may vanish."""
        return self._friction_at(0), self._friction_at(1)

    def _friction_at(self, joint: int) -> Value:
        """Return the bound of |T|/N at the bottom (0) or the top joint (1).

        With s = −σθ̈ and g_v = g + v̈_g, (F9) without restrainers is
        |T|/N = |tan ψ − ½[σü_g + g_v tan ψ − (1 − λ)Rs/cos ψ]/N| at the bottom joint and
        |T|/N = |tan ψ + ½[σü_g + g_v tan ψ − (1 + λ)Rs/cos ψ]/N| at the top joint.
        """
        c, lam, least, most = self.c, self.joints.lam, self.least_axial[joint], self.most_axial[joint]
        steepest = self.sin / self.cos * self.eccentricity
        fastest = jnp.maximum(self.deceleration.largest, self._acceleration)
        inertia = 0.5 * c.two_R * (1 + lam if joint else jnp.abs(1 - lam)) / self.cos
        forces = [
            jnp.maximum(jnp.abs(y.least), jnp.abs(y.largest)) for y in (self._over_both, self._over_one)
        ]
        couple = c.cos_alpha * (forces[0] + forces[1]) * sincos(0.5 * self.angle)[0]
        of_devices = 2 * (couple + forces[1]) / self.cos
        weight = (c.g + self.vertical) * steepest
        others = self.ground + of_devices
        # Bounds on the bracket above where it increases |T|/N beyond tan ψ (`along`), and where it reverses T
        # (`opposite`).
        opposite = others + weight + inertia * fastest
        # The largest demand is at ψ = α if N is at least half the weight of the column.
        is_heavy = least > 0.5 * (c.g + self.vertical)
        if c.restraint is not None:
            along = opposite
        elif joint:
            least_deceleration = self.deceleration.slope * c.sin_alpha - self.deceleration.offset  # at ψ = α
            along = others + weight
            along = along + inertia * jnp.where(is_heavy, -least_deceleration, self.deceleration.offset)
        else:
            along = others + inertia * fastest
            along = along - jnp.where(is_heavy, (c.g - self.vertical) * steepest, 0.0)
        is_closed, carries_nothing = least > 0, (most == 0) & (least == 0)
        least, most = (jnp.where(is_closed, y, 1.0) for y in (least, most))
        demand = steepest + 0.5 * along / jnp.where(along > 0, least, most)
        demand = jnp.maximum(demand, 0.5 * opposite / least)
        return jnp.where(is_closed, demand, jnp.where(carries_nothing, 0.0, jnp.inf))


def _deceleration(
    c: Coefficients, ground: Value, vertical: Value | float, speed_squared: Value, springs: Value | None
) -> Deceleration:
    """Bound the deceleration of a podium without restrainers, Eq. (24)."""
    least, most = (c.gravity * (1 + sign * vertical / c.g) for sign in (-1, 1))
    forcing = c.ground * ground
    if springs is None:
        return Deceleration(
            (most * c.sin_alpha + forcing) / c.inertia, least / c.inertia, forcing / c.inertia
        )
    forcing = forcing + 3 * springs / c.two_R
    offset = (forcing + c.centrifugal * speed_squared * c.sin_alpha) / c.inertia
    slope = least / (c.inertia + c.centrifugal * c.sin_alpha**2)
    return Deceleration((most * c.sin_alpha + forcing) / c.inertia, slope, offset)


def _deceleration_with_restrainers(bounds: Bounds, springs: Value | None) -> Deceleration:
    """Bound the deceleration of a podium with restrainers: |s| ≤ largest."""
    most = bounds.angular_acceleration_bound(springs)
    return Deceleration(most, jnp.zeros_like(most), most)
