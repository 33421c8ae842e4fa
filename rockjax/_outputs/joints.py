"""The base class of outputs of the joints, forces of the end columns, and bounds of forces, (F17)."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, ClassVar, NamedTuple, Self

import jax.numpy as jnp

from rockjax import _results as results
from rockjax._engine.bounds import Bounds
from rockjax._engine.coefficients import Coefficients, Joints, present
from rockjax._outputs.joint_forces import column_forces
from rockjax._sincos import sincos
from rockjax._structures import Podium
from rockjax._types import Value, Values

from .base import JOINTS, AbstractOutput
from .views import Ended, Moment, Start


def quarter_tangent(across: Values, axial: Values) -> Values:
    """Return tan(φ/4) of the angle φ = atan2(T, N) of a force with the axis of a column, in [−1, 1]; 0 where
    there is no force.

    It passes N = 0 smoothly as φ does, and takes roots where φ takes an arc tangent, which is a hundred times
    slower in a batch.
    """
    none = (across == 0) & (axial == 0)
    size = jnp.sqrt(jnp.where(none, 1.0, across**2 + axial**2))
    large = jnp.sqrt(0.5 * (1 + jnp.abs(axial) / size))  # the larger one of |sin φ/2| and cos φ/2
    small = 0.5 * across / (size * large)
    pulls = jnp.where(across < 0, -large, large) / (1 + jnp.abs(small))
    return jnp.where(axial < 0, pulls, small / (1 + large))


def angle_of(quarter: Values) -> Values:
    """Return φ of tan(φ/4) [rad]."""
    return 4 * jnp.arctan(quarter)


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
        return type(self)(1 if podium.elevation is None else 2)

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


class JointBounds:
    """Bounds of forces in the joints from a state on, (F17). Without restrainers those of devices are 0.

    - `bounds`: bounds of the motion
    """

    def __init__(self, bounds: Bounds):
        self.bounds, self.c = bounds, bounds.c
        self.joints: Joints = present(bounds.c.joints)
        c, most = bounds.c, bounds
        springs = None if c.vibration is None else most.springs(c.etas)
        self._springs = jnp.zeros_like(c.alpha) if springs is None else springs
        resting = jnp.zeros_like(c.alpha)
        self._turning = most.either(resting, most.angular_at_most(springs))  # |θ̈| + θ̇²|sin ψ|
        self._spin2 = most.either(resting, 2 * most.energy / c.spin)  # ϑ²
        self._angle = most.either(resting, most.well)  # θ_w

    @functools.cached_property
    def _sway(self) -> Value:
        """Bound of |ü_b|."""
        return self.c.two_R * self._turning

    @functools.cached_property
    def _rise(self) -> Value:
        """Bound of |v̈_b|."""
        return self.c.two_R * (self.bounds.steepest * self._turning + self._spin2)

    def _devices(self, number: int) -> Devices:
        """Return bounds of f_2 (`number` = 2) or f_1."""
        c, zero = self.c, jnp.zeros_like(self.c.alpha)
        if c.restraint is None:
            return Devices(zero, zero, zero)
        s, cos = sincos(0.5 * self._angle)
        stretch, rate = 4 * c.sin_alpha * s, 2 * c.sin_alpha * jnp.sqrt(self._spin2) / c.p
        slip, least, most = c.restraint.slip, zero, zero
        for each in c.restraint.restrainers:
            if each.joints != number:
                continue
            at_rest, opened = (each.force(y, zero, slip) for y in (zero, stretch))
            moves = each.force(zero, rate, slip) - at_rest
            least, most = least + c.g * (at_rest - moves), most + c.g * (opened + moves)
            if each.apparent_mass is not None:
                push = 0.5 * c.two_R * each.apparent_mass * c.sin_alpha
                push = push * (2 * self._turning + self._spin2 * s)
                least, most = least - push, most + push
        return Devices(least, jnp.minimum(least, cos * least), most)

    @functools.cached_property
    def _over_both(self) -> Devices:
        return self._devices(2)

    @functools.cached_property
    def _over_one(self) -> Devices:
        return self._devices(1)

    @functools.cached_property
    def _mean_top(self) -> tuple[Value, Value]:
        """Bounds N⁻ and N⁺ of N_t of the mean column."""
        c, heavy = self.c, self.joints.gamma + self.c.eta
        light = c.g - self.bounds.vertical - self._rise
        weight = c.g + self.bounds.vertical + self._rise
        return heavy * light + self._over_both.low, heavy * weight + jnp.maximum(self._over_both.most, 0.0)

    @functools.cached_property
    def _more(self) -> Value:
        """Bound of the axial force that an end column carries above or below the mean."""
        arms, c = self.joints.arms, self.c
        if arms is None:
            return jnp.zeros_like(c.alpha)
        moment = jnp.abs(arms.beam) * (self.bounds.ground + self._sway)
        if c.vibration is not None:
            sway = self.bounds.of_sum(c.etas / jnp.sqrt(c.vibration.omega2))
            lifted = (c.g + self.bounds.vertical + self._rise) * sway
            moment = moment + self.bounds.springs(jnp.abs(present(arms.modes))) + lifted
        pressed = jnp.maximum(*map(jnp.abs, self._mean_top))
        return (moment + 0.5 * c.two_R * c.sin_alpha * pressed) / arms.core_distance

    @functools.cached_property
    def least_axial(self) -> Values:
        """Lower bounds n_b and n_t of N of all columns, the bottom joint first [m/s²]."""
        top = self._mean_top[0] - self._more
        weight = self.c.g - self.bounds.vertical - 0.5 * self._rise
        return jnp.stack([top + weight + 2 * self._over_one.low, top])

    @functools.cached_property
    def most_axial(self) -> Values:
        """Upper bounds of N of all columns, the bottom joint first [m/s²]."""
        top = self._mean_top[1] + self._more
        weight = self.c.g + self.bounds.vertical + 0.5 * self._rise
        return jnp.stack([top + weight + 2 * jnp.maximum(self._over_one.most, 0.0), top])

    @functools.cached_property
    def foundation_shear(self) -> Value:
        """Bound of |V| [m/s²]."""
        gamma = self.joints.gamma
        return (1 + gamma) * self.bounds.ground + (0.5 + gamma) * self._sway + self._springs

    @functools.cached_property
    def friction(self) -> Values:
        """Bounds of |T|/N of all columns, the bottom joint first; inf where N may vanish."""
        c = self.c
        steepest = jnp.maximum(c.alpha, self._angle - c.alpha)  # ψ̂
        tan, cos = jnp.tan(steepest), jnp.cos(steepest)
        devices = [jnp.maximum(jnp.abs(y.least), jnp.abs(y.most)) for y in (self._over_both, self._over_one)]
        inertia = 0.25 * self.joints.lam * c.two_R * self._turning
        couple = c.cos_alpha * (devices[0] + devices[1]) * jnp.sin(0.5 * self._angle)
        k = (inertia + couple) / cos
        weight = c.g + self.bounds.vertical + 0.5 * self._rise
        j = 0.5 * (self.bounds.ground + 0.5 * self._sway + weight * tan + 2 * devices[1] / cos)
        least = self.least_axial
        return jnp.where(least > 0, tan + (j + k) / jnp.where(least > 0, least, 1.0), jnp.inf)
