"""Forces in the joints along a history, and impulses at its impacts."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from rockjax._engine.coefficients import present
from rockjax._engine.model import acceleration
from rockjax._outputs.base import JOINT_NAMES, JOINTS
from rockjax._outputs.joint_forces import (
    column_forces,
    impulses_of_columns,
    mean_forces,
    overturning_moment,
    sway_of_modes,
    total_weight,
)
from rockjax._outputs.joints import friction_of, quarter_tangent
from rockjax._programs.program import KeptProgram
from rockjax._tree import Module

from . import history

COLUMNS = "column"  # axis of the columns, numbered from 1 in the order of their positions

# name: (unit, description); forces have axes of columns and joints
SERIES = {
    "joint_shear": ("1", "horizontal force of the joint on the body above it T/(m_c g)"),
    "joint_axial_force": ("1", "axial force of the joint N/(m_c g), compression positive"),
    "joint_friction": ("1", "friction demand of the joint |T|/N, inf where it pulls"),
    "joint_eccentricity": ("1", "place of the resultants over half the width of a column"),
    "foundation_shear": ("1", "horizontal force on the foundation over the total weight V/W_0"),
    "foundation_reaction": ("1", "vertical force on the foundation over the total weight W/W_0"),
    "overturning_moment": ("m", "overturning moment on the columns, clockwise, over N m_c g"),
}


class JointForces(Module):
    """Forces (T, N) of the joints on the bodies above them over m_c g, with axes of times, columns and joints
    (bottom, top). Without an elevation there is one column, the mean of all.

    - `horizontal`: T along the motion [–]
    - `axial`: N upwards, compression positive [–]
    """

    horizontal: Float[Array, "*times columns joints"]
    axial: Float[Array, "*times columns joints"]

    @property
    def friction(self) -> Float[Array, "*times columns joints"]:
        """Friction demand |T|/N, inf where a joint pulls, 0 where it carries nothing [–]."""
        return friction_of(jnp.abs(quarter_tangent(self.horizontal, self.axial)))


@KeptProgram
def along(scene: history.Solved, t, left) -> dict[str, Array]:
    """Return the quantities of `SERIES` at times t (n,), just before them where `left` (n,)."""
    podium, excitation, nodes, end, method, rtol = scene
    c, nodes = history.constants(podium, excitation, rtol, joints=True), jax.tree.map(jnp.asarray, nodes)
    arms = present(c.joints).arms
    weight = total_weight(c)

    def at(s, left):
        here = history.sample(c, excitation, nodes, method, history.node_before(nodes, s, left), s)
        inside = (s >= nodes.t[0]) & (s <= end)
        x, v = (tuple(jnp.where(inside, y, jnp.nan) for y in ys) for ys in (here.x, here.v))
        state = c, here.sigma, here.ground, x, v, acceleration(c, here.sigma, here.ground, x, v)
        mean = mean_forces(*state)
        across, axial = column_forces(*state, None if arms is None else arms.offsets)
        forces = JointForces(across.T / c.g, axial.T / c.g)
        found = {
            "joint_shear": forces.horizontal,
            "joint_axial_force": forces.axial,
            "joint_friction": forces.friction,
            "joint_eccentricity": mean.eccentricity,
            "foundation_shear": mean.foundation[0] / weight,
            "foundation_reaction": mean.foundation[1] / weight,
        }
        found = {name: jnp.where(inside, y, jnp.nan) for name, y in found.items()}
        return found if arms is None else found | {"overturning_moment": overturning_moment(*state) / c.g}

    return jax.vmap(at)(t, left)


@KeptProgram
def at_impacts(scene: history.Solved, times) -> Array:
    """Return (J_T, J_N) over m_c at impacts, with axes of impacts, columns, joints and the two; NaN where
    there is no impact [m/s]."""
    podium, excitation, nodes, _, method, rtol = scene
    c, nodes = history.constants(podium, excitation, rtol, joints=True), jax.tree.map(jnp.asarray, nodes)
    arms = present(c.joints).arms

    def at(s):
        there = jnp.isfinite(s)
        time = jnp.where(there, s, nodes.t[0])
        here = history.sample(c, excitation, nodes, method, history.node_before(nodes, time, there), time)
        x = (jnp.zeros_like(s), *here.x[1:])
        offsets = None if arms is None else arms.offsets
        sway = sway_of_modes(c, here.sigma, x)
        found = impulses_of_columns(c, here.sigma, jnp.abs(here.v[0]), sway, offsets)
        return jnp.where(there, jnp.stack([y.T for y in found], axis=-1), jnp.nan)

    return jax.vmap(at)(times)


def series_dims(dimensions: int) -> tuple[str, ...]:
    """Return the dims of a quantity of `SERIES` in a dataset, from their number."""
    return ("time",) if dimensions == 1 else ("time", COLUMNS, JOINTS)


def coordinates(columns: int) -> dict[str, Any]:
    """Return the coordinates of columns and joints in a dataset."""
    return {COLUMNS: np.arange(1, columns + 1), JOINTS: list(JOINT_NAMES)}
