"""The base class of outputs of the joints, forces of the end columns, and bounds of forces, (F17)."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from typing import Any, ClassVar, NamedTuple, Self

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


@jax.custom_jvp
def quarter_tangent(across: Values, axial: Values) -> Values:
    """Return tan(φ/4) of the angle φ = atan2(T, N) of a force with the axis of a column, in [−1, 1]; 0 where
    there is no force.

    It passes N = 0 smoothly as φ does, and takes roots where φ takes an arc tangent, which is a hundred times
    slower in a batch.
    """
    squares, none = _squares(across, axial)
    size = jnp.sqrt(squares)
    large = jnp.sqrt(0.5 * (1 + jnp.abs(axial) / size))  # the larger one of |sin φ/2| and cos φ/2
    small = 0.5 * across / (size * large)
    over = jnp.where(axial < 0, jnp.where(across < 0, -large, large), small)
    under = 1 + jnp.where(axial < 0, jnp.abs(small), large)
    return jnp.where(none, 0.0, over / under)


@quarter_tangent.defjvp
def _turn(forces, rates):
    (across, axial), (across_rate, axial_rate) = forces, rates
    quarter = quarter_tangent(across, axial)
    squares, none = _squares(across, axial)
    slope = jnp.where(none, 0.0, 0.25 * (1 + quarter**2) / squares)
    return quarter, slope * (axial * across_rate - across * axial_rate)


def _squares(across: Values, axial: Values) -> tuple[Values, Flags]:
    """Return T² + N², 1 where there is no force, and whether there is none."""
    squares = across**2 + axial**2
    return jnp.where(squares == 0, 1.0, squares), squares == 0


def friction_of(quarter: Values) -> Values:
    """Return the friction demand |T|/N = tan φ of tan(φ/4) ≥ 0; inf from π/2 on, where joints pull; NaN of
    NaN."""
    half = 2 * quarter / (1 - jnp.where(quarter < 1, quarter, 0.0) ** 2)
    holds = ~((quarter >= 1) | (half >= 1))
    return jnp.where(holds, 2 * half / (1 - jnp.where(holds, half, 0.0) ** 2), jnp.inf)


def end_offsets(c: Coefficients) -> Values | None:
    """Return the positions of the first and the last column from their mean [m]; None without an elevation.
    Forces and friction are monotone over the columns, so these two are the worst."""
    arms = present(c.joints).arms
    return None if arms is None else jnp.stack([jnp.min(arms.offsets), jnp.max(arms.offsets)])


def end_forces(moment: Moment) -> Values:
    """Return T at the joints of the end columns, then N, in one row: joint by joint, the bottom first
    [m/s²]."""
    c, sigma, _, ground, x, v, a = moment
    found = column_forces(c, sigma, ground, x, v, a, end_offsets(c))
    return jnp.concatenate([y.ravel() for y in found])


def halves(row: Values) -> tuple[Values, Values]:
    """Return the two halves of a row."""
    half = row.shape[-1] // 2
    return row[..., :half], row[..., half:]


@dataclasses.dataclass(frozen=True)
class AbstractOfForces(AbstractOutput):
    """An output that needs forces of the joints. It has no answer unless it is requested."""

    needs_flat = True
    of_joints = True

    def stands(self, bounds: JointBounds, record: Values) -> Flag:
        """Return whether the record stands, whatever happens within bounds of the forces."""
        raise NotImplementedError

    def over_bounces(self, bounces: Bounces, record: Values) -> Flag | bool:
        return self.stands(JointBounds.over(bounces), record)

    def is_final(self, bounds: Bounds, record: Values) -> Flag | bool:
        return self.stands(JointBounds.of(bounds), record)

    def answered(self, ended: Ended, values: Values) -> Values:
        """Return answers, NaN for a scene in which joints would open vertically."""
        return jnp.where(ended.code == results.WEIGHTLESS, jnp.nan, values)

    def absent(self, ended: Ended) -> dict[str, Any]:
        del ended
        return {}


@dataclasses.dataclass(frozen=True)
class AbstractOfJoints(AbstractOfForces):
    """An output of the joints. Its record is a row over the end columns of the bottom and the top joint; its
    answers have an axis of joints."""

    axis = JOINTS
    joints: ClassVar[int] = 2

    columns: int = 1  # that are followed: both ends, or the mean column

    def of(self, podium: Podium) -> Self:
        return dataclasses.replace(self, columns=1 if podium.elevation is None else 2)

    def worst(self, record: Values) -> Values:
        """Return the largest record of the columns at each joint."""
        return jnp.max(record.reshape(self.joints, self.columns), axis=-1)

    def zeros(self, start: Start, rows: int = 1) -> Values:
        """Return zeros for some rows of a record."""
        return jnp.zeros(rows * self.joints * self.columns, start.t.dtype)


class Devices(NamedTuple):
    """Bounds of the forces of some devices: least, and least times the cosine of the chord, and largest
    [m/s²]."""

    least: Value
    low: Value
    most: Value


class Fall(NamedTuple):
    """Bounds of how fast rocking columns slow down, s = −σθ̈ ≤ `most` and s ≥ `slope`·sin ψ − `off` [1/s²]."""

    most: Value
    slope: Value
    off: Value


class Superstructure(NamedTuple):
    """Bounds of |Σ η_iF_i| [m/s²], of |Σ η_ih_iF_i| [m²/s²] and of |Σ η_id_i| [m]."""

    springs: Value
    moment: Value
    sway: Value


class JointBounds:
    """Bounds of forces in the joints, (F17), from those of a motion.

    - `c`: constants of the podium
    - `ground`, `vertical`: bounds of |ü_g| and |v̈_g| [m/s²]
    - `lean`: bound of the eccentricity of resultants, 1 while the columns rock
    - `angle`, `spin2`: bounds of |θ| [rad] and of θ̇² [1/s²]
    - `foot`: lower bound of sin ψ, without restrainers
    - `fall`: bounds of the deceleration
    - `above`: bounds of the vibrating superstructure; None without one
    """

    def __init__(
        self,
        c: Coefficients,
        ground: Value,
        vertical: Value | float,
        lean: Value,
        angle: Value,
        spin2: Value,
        foot: Value,
        fall: Fall,
        above: Superstructure | None,
    ):
        self.c, self.joints = c, present(c.joints)
        self.ground, self.vertical, self.lean = ground, vertical, lean
        self.angle, self.spin2, self.fall, self.above = angle, spin2, fall, above
        steepest = jnp.maximum(c.alpha, angle - c.alpha)  # |ψ|
        plain = c.restraint is None  # ψ ≤ α
        at_steepest = (c.sin_alpha, c.cos_alpha) if plain else (jnp.sin(steepest), jnp.cos(steepest))
        self.sin, self.cos = at_steepest
        # −s wherever the columns speed up, and bounds of the beam's accelerations on the side to which they
        # rock, Eqs. (14), (15).
        self._speeds_up, steep = jnp.maximum(fall.off - fall.slope * foot, 0.0), self.sin
        back = 0.0 if plain else spin2 * steep  # beyond α
        self._sway = -c.two_R * (fall.most + back), c.two_R * (self._speeds_up + spin2 * steep)
        self._rise = -c.two_R * (fall.most * steep + spin2), c.two_R * (self._speeds_up * steep + back)

    @classmethod
    def of(cls, bounds: Bounds) -> Self:
        """Return the bounds of forces from a state on. Outputs share them."""
        return bounds.shared(cls._of)

    @classmethod
    def _of(cls, bounds: Bounds) -> Self:
        c, zero = bounds.c, jnp.zeros_like(bounds.c.alpha)
        above = None
        if c.vibration is not None:
            arms = present(c.joints).arms
            of_modes = zero if arms is None else bounds.springs(jnp.abs(present(arms.modes)))
            sway = zero if arms is None else bounds.of_sum(c.etas / jnp.sqrt(c.vibration.omega2))
            above = Superstructure(bounds.springs(c.etas), of_modes, sway)
        spin2, springs = 2 * bounds.energy / c.spin, None if above is None else above.springs
        fall = (
            _with_restrainers(bounds, springs)
            if c.restraint is not None
            else _fall(c, bounds.ground, bounds.vertical, spin2, springs)
        )
        # The potential energy, Eq. (19), grows with cos ψ.
        foot = jnp.sqrt(jnp.maximum(1 - (c.cos_alpha + bounds.energy / c.weight) ** 2, 0.0))
        either = lambda rocking: bounds.either(zero, rocking)
        lean = one = jnp.ones_like(zero)
        if not isinstance(bounds.rests, bool):
            lean = bounds.either(bounds.demand / c.uplift, one)
        return cls(
            c, bounds.ground, bounds.vertical, lean, either(bounds.well), either(spin2), foot,
            Fall(*map(either, fall)), above,
        )  # fmt: skip

    @classmethod
    def over(cls, bounces: Bounces) -> Self:
        """Return the bounds of forces over bounces of a rigid podium."""
        c, spin2 = bounces.c, bounces.speed**2
        fall = _fall(c, bounces.ground, 0.0, spin2, None)
        foot = jnp.maximum(c.sin_alpha - bounces.height, 0.0)
        return cls(c, bounces.ground, 0.0, jnp.ones_like(c.alpha), bounces.height, spin2, foot, fall, None)

    def _devices(self, number: int) -> Devices:
        """Return bounds of f_2 (`number` = 2) or f_1."""
        c, zero = self.c, jnp.zeros_like(self.c.alpha)
        if c.restraint is None:
            return Devices(zero, zero, zero)
        s, cos = sincos(0.5 * self.angle)
        stretch, rate = 4 * c.sin_alpha * s, 2 * c.sin_alpha * jnp.sqrt(self.spin2) / c.p
        slip, least, most = c.restraint.slip, zero, zero
        for each in c.restraint.restrainers:
            if each.joints != number:
                continue
            at_rest, opened = (each.force(y, zero, slip) for y in (zero, stretch))
            moves = each.force(zero, rate, slip) - at_rest
            least, most = least + c.g * (at_rest - moves), most + c.g * (opened + moves)
            if each.apparent_mass is not None:
                push = 0.5 * c.two_R * each.apparent_mass * c.sin_alpha
                push = push * (2 * self.fall.most + self.spin2 * s)
                least, most = least - push, most + push
        return Devices(least, jnp.minimum(least, cos * least), most)

    @functools.cached_property
    def _over_both(self) -> Devices:
        return self._devices(2)

    @functools.cached_property
    def _over_one(self) -> Devices:
        return self._devices(1)

    def _weight(self, share: float) -> tuple[Value, Value]:
        """Bounds of g + v̈_g + `share`·v̈_b."""
        least, most = (self.c.g + share * y for y in self._rise)
        return least - self.vertical, most + self.vertical

    @functools.cached_property
    def _mean_top(self) -> tuple[Value, Value]:
        """Bounds N⁻ and N⁺ of N_t of the mean column."""
        heavy, (light, weight) = self.joints.gamma + self.c.eta, self._weight(1.0)
        return heavy * light + self._over_both.low, heavy * weight + jnp.maximum(self._over_both.most, 0.0)

    @functools.cached_property
    def _top(self) -> tuple[Value, Value]:
        """Bounds of N_t of all columns. N_t,i = N_t (1 ± χB/ℓ_p) ± M/ℓ_p at the ends, (F8)."""
        arms, c, mean = self.joints.arms, self.c, self._mean_top
        if arms is None:
            return mean
        ends = -arms.beam * (self._sway[0] - self.ground), -arms.beam * (self._sway[1] + self.ground)
        more = jnp.zeros_like(c.alpha)
        if self.above is not None:
            more = self.above.moment + self._weight(1.0)[1] * self.above.sway
        moment = jnp.minimum(*ends) - more, jnp.maximum(*ends) + more
        tilt = 0.5 * c.two_R * c.sin_alpha * self.lean
        core = arms.core_distance
        found = [
            (axial * (core + side * tilt) + side * tips) / core
            for side, axial, tips in itertools.product((-1, 1), mean, moment)
        ]
        return functools.reduce(jnp.minimum, found), functools.reduce(jnp.maximum, found)

    @functools.cached_property
    def least_axial(self) -> Values:
        """Lower bounds n_b and n_t of N of all columns, the bottom joint first [m/s²]."""
        top = self._top[0]
        return jnp.stack([top + self._weight(0.5)[0] + 2 * self._over_one.low, top])

    @functools.cached_property
    def most_axial(self) -> Values:
        """Upper bounds of N of all columns, the bottom joint first [m/s²]."""
        top = self._top[1]
        return jnp.stack([top + self._weight(0.5)[1] + 2 * jnp.maximum(self._over_one.most, 0.0), top])

    @functools.cached_property
    def foundation_shear(self) -> Value:
        """Bound of |V| [m/s²]: of its parts, (F5), or by the friction demand of the mean column, (F9)."""
        c = self.c
        gamma, sway = self.joints.gamma, jnp.maximum(*map(jnp.abs, self._sway))
        springs = 0.0 if self.above is None else self.above.springs
        of_parts = (1 + gamma) * self.ground + (0.5 + gamma) * sway + springs
        if c.restraint is not None:
            return of_parts
        axial = self._mean_top[1] + self._weight(0.5)[1]
        inertia = 0.5 * c.two_R * jnp.abs(1 - self.joints.lam) * jnp.maximum(self.fall.most, self._speeds_up)
        leans = axial * self.lean * self.sin + 0.5 * (self.ground * self.cos + inertia)
        return jnp.minimum(of_parts, leans / self.cos)

    @functools.cached_property
    def friction(self) -> Values:
        """Bounds of |T|/N of all columns, the bottom joint first; inf where N may vanish.

        With s = −σθ̈, (F9) is |T|/N = |tan ψ − ½[σü_g + g_v tan ψ − (1 − λ)Rs/cos ψ]/N| at the bottom and
        |tan ψ + ½[σü_g + g_v tan ψ − (1 + λ)Rs/cos ψ]/N| at the top, without devices.
        """
        c, least, most = self.c, self.least_axial, self.most_axial
        cos, R, lam = self.cos, 0.5 * c.two_R, self.joints.lam
        steepest = jnp.stack([self.sin / cos] * 2) * self.lean
        fastest = jnp.maximum(self.fall.most, self._speeds_up)
        inertia = R * jnp.stack([jnp.abs(1 - lam), 1 + lam]) / cos
        forces = [jnp.maximum(jnp.abs(y.least), jnp.abs(y.most)) for y in (self._over_both, self._over_one)]
        couple = c.cos_alpha * (forces[0] + forces[1]) * sincos(0.5 * self.angle)[0]
        of_devices = 2 * (couple + forces[1]) / cos
        weight = (c.g + self.vertical) * steepest
        others = self.ground + of_devices
        opposite = others + weight + inertia * fastest  # where T has the other sign
        if c.restraint is not None:
            ahead = opposite
        else:
            # The largest value is at ψ = α as long as N is not far below the weight of the column.
            heavy = least > 0.5 * (c.g + self.vertical)
            foot = self.fall.slope * c.sin_alpha - self.fall.off
            bottom = inertia[0] * fastest - jnp.where(heavy[0], (c.g - self.vertical) * steepest[0], 0.0)
            top = weight[1] + inertia[1] * jnp.where(heavy[1], -foot, self.fall.off)
            ahead = others + jnp.stack([bottom, top])
        closed = least > 0
        least, most = (jnp.where(closed, y, 1.0) for y in (least, most))
        found = steepest + 0.5 * ahead / jnp.where(ahead > 0, least, most)
        found = jnp.maximum(found, 0.5 * opposite / least)
        bare = (most == 0) & (self.least_axial == 0)  # no joint
        return jnp.where(closed, found, jnp.where(bare, 0.0, jnp.inf))


def _fall(
    c: Coefficients, ground: Value, vertical: Value | float, spin2: Value, springs: Value | None
) -> Fall:
    """Return bounds of the deceleration from Eq. (24), without restrainers."""
    least, most = (c.gravity * (1 + sign * vertical / c.g) for sign in (-1, 1))
    pushed = c.ground * ground
    if springs is None:
        return Fall((most * c.sin_alpha + pushed) / c.inertia, least / c.inertia, pushed / c.inertia)
    pushed = pushed + 3 * springs / c.two_R
    off = (pushed + c.centrifugal * spin2 * c.sin_alpha) / c.inertia
    slope = least / (c.inertia + c.centrifugal * c.sin_alpha**2)
    return Fall((most * c.sin_alpha + pushed) / c.inertia, slope, off)


def _with_restrainers(bounds: Bounds, springs: Value | None) -> Fall:
    """Return bounds of the deceleration, of either sign."""
    most = bounds.angular_at_most(springs)
    return Fall(most, jnp.zeros_like(most), most)
