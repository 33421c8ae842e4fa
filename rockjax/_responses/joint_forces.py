"""Joint forces along a history (the accepted steps of a scene), and impulses at the impacts.

m_c is the mass of a column, and N the number of columns in N m_c; otherwise N is the axial force of a joint.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from rockjax._engine.coefficients import not_none
from rockjax._engine.model import acceleration
from rockjax._outputs.base import JOINT_NAMES, JOINTS
from rockjax._outputs.joint_forces import (
    column_forces,
    impulses_of_columns,
    mean_forces,
    of_all_columns,
    sway_of_modes,
    total_weight,
)
from rockjax._outputs.joints import Force
from rockjax._programs.program import StoredProgram
from rockjax._tree import Module

from . import history

COLUMNS = "column"  # axis of the columns, numbered from 1 in the order of their positions

# Unit and description of each series. All series have an axis of times; the first three also have axes of
# columns and joints.
SERIES = {
    "joint_shear": ("1", "horizontal force of the joint on the body above it T/(m_c g)"),
    "joint_axial_force": ("1", "axial force of the joint N/(m_c g), compression positive"),
    "joint_friction": ("1", "friction demand of the joint |T|/N, inf where it is in tension"),
    "joint_eccentricity": ("1", "position of the resultants divided by half the width of a column"),
    "foundation_shear": ("1", "horizontal force on the foundation divided by the total weight V/W_0"),
    "foundation_reaction": ("1", "vertical force on the foundation divided by the total weight W/W_0"),
    "overturning_moment": ("m", "overturning moment on the columns, clockwise, divided by N m_c g"),
}


class JointForces(Module):
    """Forces (T, N) of the joints on the bodies above them, divided by the weight m_c g of a column. The axes
    are times, columns and joints (bottom, top). If the podium has no elevation, the only column is the mean
    column.

    - `horizontal`: T, positive in the direction of positive displacements [–]
    - `axial`: N, upwards, so that compression is positive [–]
    """

    horizontal: Float[Array, "*times columns joints"]
    axial: Float[Array, "*times columns joints"]

    @property
    def friction(self) -> Float[Array, "*times columns joints"]:
        """Friction demand |T|/N [–]; inf where a joint is in tension, 0 where it carries no force."""
        return Force(jnp.abs(self.horizontal), self.axial).demand


@StoredProgram
def series_at(scene: history.Solved, t, left) -> dict[str, Array]:
    """Return the quantities of `SERIES` at times t (n,), or just before them where `left` (n,), by name."""
    podium, excitation, nodes, end, method, rtol = scene
    c, nodes = history.constants(podium, excitation, rtol, joints=True), jax.tree.map(jnp.asarray, nodes)
    arms = not_none(c.joints).arms
    weight = total_weight(c)

    def at_time(time, is_left):
        node = history.node_before(nodes, time, is_left)
        instant = history.sample(c, excitation, nodes, method, node, time)
        is_inside = (time >= nodes.t[0]) & (time <= end)
        x, v = (tuple(jnp.where(is_inside, y, jnp.nan) for y in ys) for ys in (instant.x, instant.v))
        sigma, ground = instant.sigma, instant.ground
        state = c, sigma, ground, x, v, acceleration(c, sigma, ground, x, v)
        mean = mean_forces(*state)
        horizontal, axial = of_all_columns(column_forces, c, mean, arms=arms)
        forces = JointForces(horizontal.T / c.g, axial.T / c.g)
        series = {
            "joint_shear": forces.horizontal,
            "joint_axial_force": forces.axial,
            "joint_friction": forces.friction,
            "joint_eccentricity": mean.eccentricity,
            "foundation_shear": mean.foundation[0] / weight,
            "foundation_reaction": mean.foundation[1] / weight,
        }
        series = {name: jnp.where(is_inside, y, jnp.nan) for name, y in series.items()}
        if arms is None:
            return series
        return series | {"overturning_moment": not_none(mean.moment) / c.g}

    return jax.vmap(at_time)(t, left)


@StoredProgram
def impulses_at(scene: history.Solved, times) -> Array:
    """Return the impulses (J_T, J_N), horizontal and axial, at the times of impacts, divided by m_c [m/s].
    The axes are impacts, columns, joints and (J_T, J_N). If a time is NaN, so are the impulses."""
    podium, excitation, nodes, _, method, rtol = scene
    c, nodes = history.constants(podium, excitation, rtol, joints=True), jax.tree.map(jnp.asarray, nodes)
    arms = not_none(c.joints).arms

    def at_impact(impact_time):
        is_impact = jnp.isfinite(impact_time)
        time = jnp.where(is_impact, impact_time, nodes.t[0])
        node = history.node_before(nodes, time, is_impact)
        before = history.sample(c, excitation, nodes, method, node, time)
        x = (jnp.zeros_like(time), *before.x[1:])  # θ = 0 at an impact
        state = c, before.sigma, jnp.abs(before.v[0]), sway_of_modes(c, before.sigma, x)
        impulses = of_all_columns(impulses_of_columns, *state, arms=arms)
        return jnp.where(is_impact, jnp.stack([y.T for y in impulses], axis=-1), jnp.nan)

    return jax.vmap(at_impact)(times)


def series_dims(dimensions: int) -> tuple[str, ...]:
    """Return the dims that a quantity of `SERIES` with this number of dimensions has in a dataset."""
    return ("time",) if dimensions == 1 else ("time", COLUMNS, JOINTS)


def coordinates(columns: int) -> dict[str, Any]:
    """Return the coordinates of columns and joints in a dataset."""
    return {COLUMNS: np.arange(1, columns + 1), JOINTS: list(JOINT_NAMES)}
