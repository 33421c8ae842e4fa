"""Friction demand and lift-off of the joints at the impacts of a scene (one podium under one excitation).

J_T and J_N are the horizontal and the vertical (axial) impulse in a joint, m_c is the mass of a column, and
|θ̇⁻| is the angular speed of the columns just before the impact. (F12) is in docs/forces.md, (F14) in
docs/equations.md.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp

from rockjax._engine.bounds import Bounds
from rockjax._engine.coefficients import Coefficients, not_none
from rockjax._outputs.joint_forces import sway_of_modes
from rockjax._types import Flag, Value, Values

from .base import AbstractEventOutput, Variable
from .joints import JOINTS, AbstractJointOutput, Force, all_of, end_offsets
from .views import Bounces, Ended, Impact, Start, Step

Extremes = tuple[Value, Value]
ROUNDING = 1e-12  # relative differences below this are rounding


def _impulse_gradient(c: Coefficients, sway: Value | float) -> Value:
    """Return the difference between the axial impulses of two columns, divided by m_c, by |θ̇⁻| and by the
    distance between the columns, (F14) [–], at an impact from the contact mode σ = 1.

    - `sway`: Σ η_id_i over the modes i, with their mass ratios η_i and deformations d_i [m]
    """
    joints = not_none(c.joints)
    arms, mean = not_none(joints.arms), joints.impulses
    lever = joints.impulse_eccentricity * arms.lever(0.5 * c.two_R * c.sin_alpha, c.sin_alpha / c.cos_alpha)
    moment = mean.rise * sway - arms.beam * mean.sway - lever * mean.axial[1]
    return moment / arms.mean_square


@dataclasses.dataclass(frozen=True)
class ImpactFriction(AbstractJointOutput, AbstractEventOutput):
    """The friction demand and the lift-off at impacts, (F12), (F14), at the bottom and the top joint [–].

    The first answer is the largest |J_T|/J_N over all impacts and columns, or 0 without impacts. The second
    answer is the least ratio of the J_N of a column to the mean J_N of all columns, or 1 without impacts. If
    this ratio is negative, a joint would open.

    At an impact from σ = 1, the axial impulse J_N/(m_c |θ̇⁻|) of column i differs from the mean of all columns
    by x_i times the gradient `_impulse_gradient`, where x_i is the position of the column relative to the
    mean position. An impact from σ = −1 is the mirror image: the sway and the gradient change their signs.
    All answers are monotone in the gradient. The accumulator (the value up to the present time) therefore
    contains the largest gradient, and the largest value of the gradient times −1. Both are −inf before the
    first impact.
    """

    name = "impact_friction"
    needs_simple_contact = False

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (
            Variable(
                "peak_impact_friction",
                "1",
                "largest friction demand max|J_T|/J_N of the joints at impacts",
                "max |J_T|/J_N",
                JOINTS,
            ),
            Variable(
                "least_impulse_share",
                "1",
                "least axial impulse of a column divided by the mean of all columns",
                "min J_N/mean",
                JOINTS,
            ),
        )

    def start(self, start: Start) -> tuple[Extremes, None]:
        unset = jnp.full((), -jnp.inf, start.t.dtype)
        return (unset, unset), None

    def over_step(self, step: Step, accumulator: Extremes) -> None:
        del step, accumulator

    def at_impact(self, impact: Impact) -> Extremes:
        c, sigma = impact.c, impact.sigma
        if not_none(c.joints).arms is None:
            zero = jnp.zeros_like(c.alpha)
            return zero, zero
        gradient = sigma * _impulse_gradient(c, sigma * sway_of_modes(c, sigma, impact.x))
        return gradient, -gradient

    def over_bounces(self, bounces: Bounces, accumulator: Extremes) -> Flag:
        return _is_unchanged(bounces.c, 0.0, accumulator)

    def is_final(self, bounds: Bounds, accumulator: Extremes) -> Flag:
        c, sway = bounds.c, 0.0
        if c.vibration is not None and not_none(c.joints).arms is not None:
            sway = bounds.modal_sum(c.etas / jnp.sqrt(c.vibration.omega2))
        return bounds.rests | _is_unchanged(c, sway, accumulator)

    def answer(self, ended: Ended, accumulator: Extremes, note: Any) -> dict[str, Any]:
        c = ended.scene.c
        has_impact, joints = accumulator[0] > -jnp.inf, not_none(c.joints)
        lean = joints.impulse_eccentricity * c.sin_alpha / c.cos_alpha
        gradients = [jnp.where(has_impact, y, 0.0) for y in (accumulator[0], -accumulator[1])]
        changes = [x * gradient for x in end_offsets(c) or (0.0,) for gradient in gradients]
        demands, shares = [], []
        for horizontal, axial in zip(joints.impulses.horizontal, joints.impulses.axial, strict=True):
            is_loaded = axial > 0
            mean = jnp.where(is_loaded, axial, 1.0)
            forces = [Force(jnp.abs(horizontal + lean * change), axial + change) for change in changes]
            demand = functools.reduce(jnp.maximum, [force.demand for force in forces])
            share = functools.reduce(jnp.minimum, [force.axial / mean for force in forces])
            is_valid = has_impact & is_loaded
            demands.append(jnp.where(has_impact, demand, 0.0))
            shares.append(jnp.where(is_valid, share, 1.0))
        rows: tuple[Values, Values] = jnp.stack(demands), jnp.stack(shares)
        friction, share = (self.nan_if_weightless(ended, y) for y in rows)
        return {"peak_impact_friction": friction, "least_impulse_share": share}


def _is_unchanged(c: Coefficients, sway: Value | float, accumulator: Extremes) -> Flag:
    """Return whether no impact with |Σ η_id_i| up to `sway` [m] can change the answers."""
    largest, negative = jax.lax.stop_gradient(accumulator)
    ends = end_offsets(c)
    if ends is None:  # without an elevation, all impacts have the same answers
        return largest > -jnp.inf
    bound = jax.lax.stop_gradient(
        jnp.maximum(jnp.abs(_impulse_gradient(c, sway)), jnp.abs(_impulse_gradient(c, -sway)))
        * jnp.maximum(-ends[0], ends[1])
    )
    raised = jnp.maximum(ends[1] * largest, -ends[0] * negative)  # largest increase of an axial impulse
    lowered = jnp.maximum(ends[1] * negative, -ends[0] * largest)
    return all_of(bound <= so_far * (1 + ROUNDING) for so_far in jax.lax.stop_gradient((raised, lowered)))
