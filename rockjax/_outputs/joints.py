"""Base classes of outputs at the joints, and forces of the end columns.

T is the horizontal and N the vertical force in a joint, compression positive. Forces are per column and
divided by the mass m_c of a column [m/s²], as in `joint_forces`. The end columns are the first and the last
column. From column to column, forces and friction demands either only increase or only decrease, so their
extremes are always at an end column.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import jax.numpy as jnp

from rockjax import _results as results
from rockjax._engine.bounds import Bounds
from rockjax._engine.coefficients import Coefficients, not_none
from rockjax._excitations.ground import GroundMotion
from rockjax._outputs.joint_forces import column_forces, mean_forces
from rockjax._programs.barrier import barrier
from rockjax._types import Flag, Flags, Value, Values

from .base import JOINTS, AbstractOutput
from .joint_bounds import JointBounds
from .views import Bounces, Course, Ended, Moment, Rest, Step

# At a joint without dead load, a force up to this size, divided by m_c g, counts as rounding.
NO_FORCE = 1e-12


class Force(NamedTuple):
    """Size |T| of the horizontal part, and axial part N, of a force or an impulse in a joint. Where two
    forces are compared, the steeper one has the larger angle from the vertical, atan2(|T|, N)."""

    size: Values
    axial: Values

    def is_steeper(self, other: Force) -> Flags:
        """Return whether the angle from the vertical is larger than that of another force. If N decreases to
        negative values, the angle continues to increase, but |T|/N does not. A force of zero is not steeper
        than any other force."""
        return self.size * other.axial > other.size * self.axial

    def steeper(self, other: Force) -> Force:
        """Return the steeper one of two forces; `other` if they are equally steep."""
        return other.replaced(self.is_steeper(other), self)

    def replaced(self, where: Flags, other: Force) -> Force:
        """Return `other` where the flag holds, and this force elsewhere."""
        return Force(*[jnp.where(where, new, old) for new, old in zip(other, self, strict=True)])

    @property
    def demand(self) -> Values:
        """The friction demand |T|/N; inf for N ≤ 0, except 0 for T = N = 0; NaN if T or N is NaN."""
        is_closed, is_zero = self.axial > 0, (self.size == 0) & (self.axial == 0)
        ratio = self.size / jnp.where(is_closed, self.axial, 1.0)
        is_open = ~is_closed & ~jnp.isnan(self.size + self.axial)
        return jnp.where(is_open, jnp.where(is_zero, 0.0, jnp.inf), ratio)


def end_offsets(c: Coefficients) -> tuple[Value, Value] | None:
    """Return the positions of the first and the last column relative to the mean of all columns [m]; None if
    no elevation is given."""
    arms = not_none(c.joints).arms
    return None if arms is None else (jnp.min(arms.offsets), jnp.max(arms.offsets))


T = TypeVar("T")


class EndForces(NamedTuple, Generic[T]):
    """Forces of the end columns; without an elevation, the means of all columns [m/s²].

    - `tangential`, `axial`: T and N. Each has a tuple for the bottom joint and a tuple for the top joint. A
      tuple contains the values of both end columns; without an elevation, only the mean
    - `foundation`: the horizontal force V on the foundation, mean of the columns
    """

    tangential: tuple[tuple[T, ...], tuple[T, ...]]
    axial: tuple[tuple[T, ...], tuple[T, ...]]
    foundation: T

    @classmethod
    def from_row(cls, row: Sequence[T]) -> EndForces[T]:
        """Return the forces from a row, the result of `end_forces`."""
        n = len(row) // 4
        parts = [tuple(row[k * n : (k + 1) * n]) for k in range(4)]
        return cls((parts[0], parts[1]), (parts[2], parts[3]), row[-1])


def end_forces(moment: Moment) -> tuple[Value, ...]:
    """Return a row of forces [m/s²]: T of the end columns at the bottom joint, T at the top joint, N in the
    same order, and finally the horizontal force V on the foundation (mean of the columns)."""
    c, sigma, _, ground, x, v, a = moment
    mean = barrier(mean_forces(c, sigma, ground, x, v, a))
    tangential, axial = column_forces(c, mean, end_offsets(c))
    return (*tangential, *axial, mean.foundation[0])


def over_step(step: Step) -> EndForces[Course]:
    """Return the forces over a step."""
    return EndForces.from_row(step.courses(end_forces, through_middle=True))


def over_rest(rest: Rest) -> list[EndForces[Value]]:
    """Return the forces at the least and the largest ground acceleration while a rigid podium is in full
    contact. The extremes of N and of the horizontal force V on the foundation are among them, because N and V
    are linear in ü_g."""
    c = rest.scene.c
    # Under vertical ground motion or with restrainers, no rest is skipped (`needs_simple_contact`), so this
    # function is not called.
    assert not isinstance(rest.scene.excitation, GroundMotion)
    zero = jnp.zeros_like(c.alpha)
    return [
        EndForces.from_row(end_forces(Moment(c, zero, zero, ground, (zero,), (zero,), (zero,))))
        for ground in rest.extreme_ground_accelerations
    ]


def all_of(flags: Iterable[Flag]) -> Flag:
    """Return whether all flags hold."""
    return functools.reduce(jnp.logical_and, flags)


@dataclasses.dataclass(frozen=True)
class AbstractForceOutput(AbstractOutput):
    """An output of forces or impulses in the joints, or of the force on the foundation. If such an output is
    not requested, its answers are missing, whereas the answers of most other outputs are then NaN."""

    needs_flat = True
    of_joints = True
    needs_simple_contact: ClassVar[bool] = True

    def is_unchanged(self, bounds: JointBounds, accumulator: Any) -> Flag:
        """Return whether no forces within the bounds can change the accumulator."""
        raise NotImplementedError

    def over_bounces(self, bounces: Bounces, accumulator: Any) -> Flag | bool:
        return self.is_unchanged(JointBounds.over(bounces), accumulator)

    def is_final(self, bounds: Bounds, accumulator: Any) -> Flag | bool:
        return self.is_unchanged(JointBounds.from_bounds(bounds), accumulator)

    def nan_if_weightless(self, ended: Ended, values: Values | Sequence[Value]) -> Values:
        """Return the values as an array, or NaN if the scene ended because vertical motion would open all
        joints."""
        return jnp.where(ended.code == results.WEIGHTLESS, jnp.nan, jnp.asarray(values))

    def nan_if_unknown(self, ended: Ended, values: Values | Sequence[Value]) -> Values:
        """Return the values as `nan_if_weightless` does, but NaN also if the initial state is overturned, so
        that no step was made."""
        starts_overturned = ended.overturn_time <= ended.scene.start  # False for the time NaN
        return jnp.where(starts_overturned, jnp.nan, self.nan_if_weightless(ended, values))

    def absent(self, ended: Ended) -> dict[str, Any]:
        del ended
        return {}


@dataclasses.dataclass(frozen=True)
class AbstractJointOutput(AbstractForceOutput):
    """An output whose answers have one value for each joint, shape (2,), the bottom joint first. Each value
    is that of the worst column. Accumulators of forces are tuples with an entry for each joint."""

    axis = JOINTS
