"""The motion of the deck and of modes along a history, as motions of the ground for what stands on floors."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from rockjax._engine.flat import run_with_history
from rockjax._engine.scene import default_end, plan_for, prepare
from rockjax._engine.state import Plan
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.piecewise import NODES, PiecewiseMotion
from rockjax._options import Options
from rockjax._results import State
from rockjax._structures import Podium
from rockjax._types import Values

from . import history
from .floor import bodies

NEVER_LIFTS = 1.57  # slenderness α of columns that no ground motion lifts [rad]
PERIODS = 5  # of the longest oscillator on a floor, that a scene lasts at least after the ground motion


def end_with_oscillators(podium: Podium, excitation: AbstractExcitation, longest: Any) -> Any:
    """Return the default end of a scene with oscillators on its floors [s]: that of histories, or `PERIODS`
    times the `longest` period [s] after the ground motion, if that is later."""
    return jnp.maximum(default_end(podium.resolved(), excitation), excitation.support[1] + PERIODS * longest)


class FloorCourse(NamedTuple):
    """Accelerations and velocity jumps of the modes and of the beam along a history; the beam's vertical
    motion comes last."""

    times: Float[Array, " n"]  # of the nodes, with the derivatives of events; inf after the last one [s]
    accelerations: Float[Array, " n nodes bodies"]  # absolute, at the `NODES` of each step [m/s²]
    jumps: Float[Array, " n bodies"]  # of the velocities at the nodes [m/s]
    end: Float[Array, ""]  # last time [s]

    def motion(self, weights: Values) -> PiecewiseMotion:
        """Return the motion with these weights of the bodies, (L2), (L3)."""
        return PiecewiseMotion.through(self.times, self.accelerations @ weights, self.jumps @ weights)


def course_of(scene: history.Solved) -> FloorCourse:
    """Return the motion of modes and beam along a history whose steps end at breakpoints."""
    nodes = scene[2]
    rows = jnp.arange(nodes.t.shape[0])
    valid = rows < nodes.used
    last = jnp.max(jnp.where(valid, nodes.t, -jnp.inf))
    times = jnp.where(valid, nodes.event_time, last)
    starts = jax.lax.stop_gradient(jnp.where(valid, nodes.t, last))
    lengths = jnp.append(jnp.diff(starts), 0.0)
    at_end = NODES[-1] == NODES
    t = starts[:, None] + lengths[:, None] * (0.5 + 0.5 * jnp.asarray(NODES))[None, :]
    left = jnp.broadcast_to(at_end, t.shape)
    node = jnp.broadcast_to(jnp.where(valid, rows, 0)[:, None], t.shape)
    inner = bodies(scene, t.ravel(), left.ravel(), node.ravel())
    # An impact multiplies the rate of rotation by e, and its vertical part changes sign, (L3). The velocities
    # of modes do not jump. The impact that ends the rocking is the first of infinitely many with this e.
    struck = jnp.isfinite(nodes.impact_time) & valid
    which = jnp.where(struck, rows, 0)
    before = bodies(scene, times[which], jnp.ones(rows.shape, bool), jnp.maximum(which - 1, 0))
    e = jnp.maximum(scene[0].restitution_factor, 0.0)
    across, up = (1 - e) * -before.velocity[:, -1], (1 + e) * -before.climb
    of_modes = jnp.zeros((rows.size, inner.acceleration.shape[-1] - 1))
    jumps = jnp.concatenate([of_modes, across[:, None], up[:, None]], axis=-1)
    jumps = jnp.where(struck[:, None], jumps, 0.0)
    finite = jnp.where(valid, times, jnp.inf)
    return FloorCourse(finite, inner.accelerations.reshape(*t.shape, -1), jumps, times[-1])


def followed(plan: Plan) -> Plan:
    """Return a plan that passes over nothing."""
    return dataclasses.replace(plan, fast_forwards=())


def floor_course(
    podium: Podium,
    excitation: AbstractExcitation,
    initial: State,
    t_end: Any,
    options: Options,
    capacity: int,
) -> tuple[FloorCourse, Array]:
    """Solve a scene for its floors, with nothing passed over. Return their motion, and the result code."""
    plan = followed(plan_for(podium, options, history=True))
    scene, state = prepare(podium, excitation, initial, t_end, options, plan)
    state, nodes = run_with_history(scene, plan, state, options.max_steps, capacity)
    rtol = options.rtol if podium.restrainers else None
    return course_of((podium, excitation, nodes, jnp.asarray(jnp.inf), options.method, rtol)), state.code
