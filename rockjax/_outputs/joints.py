"""Base classes of outputs at the joints, and forces of the end columns.

Forces are per column and divided by m_c [m/s²], as in `joint_forces`.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, Self, TypeVar

import jax
import jax.numpy as jnp

from rockjax import _results as results
from rockjax._engine.bounds import Bounds
from rockjax._engine.coefficients import Coefficients, present
from rockjax._outputs.joint_forces import column_forces
from rockjax._structures import Podium
from rockjax._types import Flag, Flags, Value, Values

from .base import JOINTS, AbstractOutput
from .joint_bounds import JointBounds, Pair
from .views import Bounces, Ended, Moment, Start


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
