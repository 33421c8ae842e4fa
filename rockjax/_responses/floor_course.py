"""The motion of deck and modes along a history, as the excitation of things on floors."""

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
# By default, a scene lasts at least this multiple of the longest period of its oscillators after the ground
# motion.
PERIODS = 5


def end_with_oscillators(podium: Podium, excitation: AbstractExcitation, longest: Any) -> Any:
    """Return the default end of a scene with oscillators on its floors [s].

    It is the default end of `simulate`, or `PERIODS` times the `longest` period [s] after the ground motion
    if that is later.
    """
    return jnp.maximum(default_end(podium.resolved(), excitation), excitation.support[1] + PERIODS * longest)


class FloorCourse(NamedTuple):
    """Accelerations and velocity jumps of modes and beam along a history. The axis of bodies ends with the
    vertical motion of the beam.

    - `times`: times of the n nodes of the history, with the derivatives of events [s]; inf after the last
      node
    - `accelerations`: absolute accelerations at the `NODES` of each step [m/s²]
    - `jumps`: velocity jumps at the nodes of the history [m/s]
    - `end`: time of the last node [s]
    """

    times: Float[Array, " n"]
    accelerations: Float[Array, " n nodes bodies"]
    jumps: Float[Array, " n bodies"]
    end: Float[Array, ""]

    def motion(self, weights: Values) -> PiecewiseMotion:
        """Return the motion of a floor, the sum of the bodies with these weights, (L2), (L3)."""
        return PiecewiseMotion.through(self.times, self.accelerations @ weights, self.jumps @ weights)


def course_of(scene: history.Solved) -> FloorCourse:
    """Return the motion of modes and beam along a history whose steps end at breakpoints."""
    nodes = scene[2]
    rows = jnp.arange(nodes.t.shape[0])
    is_used = rows < nodes.used
    last = jnp.max(jnp.where(is_used, nodes.t, -jnp.inf))
    times = jnp.where(is_used, nodes.event_time, last)
    starts = jax.lax.stop_gradient(jnp.where(is_used, nodes.t, last))
    lengths = jnp.append(jnp.diff(starts), 0.0)
    at_end = NODES[-1] == NODES
    t = starts[:, None] + lengths[:, None] * (0.5 + 0.5 * jnp.asarray(NODES))[None, :]
    left = jnp.broadcast_to(at_end, t.shape)
    node = jnp.broadcast_to(jnp.where(is_used, rows, 0)[:, None], t.shape)
    motion = bodies(scene, t.ravel(), left.ravel(), node.ravel())
    # An impact multiplies the rate of rotation by e, and its vertical part changes sign, (L3). The velocities
    # of modes do not jump. The impact that ends the rocking is the first of infinitely many with this e.
    is_impact = jnp.isfinite(nodes.impact_time) & is_used
    impact_rows = jnp.where(is_impact, rows, 0)
    is_left = jnp.ones(rows.shape, bool)
    before = bodies(scene, times[impact_rows], is_left, jnp.maximum(impact_rows - 1, 0))
    e = jnp.maximum(scene[0].restitution_factor, 0.0)
    of_modes = jnp.zeros((rows.size, motion.acceleration.shape[-1] - 1))
    of_beam = jnp.stack([(1 - e) * -before.velocity[:, -1], (1 + e) * -before.climb], axis=-1)
    jumps = jnp.concatenate([of_modes, of_beam], axis=-1)
    jumps = jnp.where(is_impact[:, None], jumps, 0.0)
    finite_times = jnp.where(is_used, times, jnp.inf)
    return FloorCourse(finite_times, motion.accelerations.reshape(*t.shape, -1), jumps, times[-1])


def without_fast_forwards(plan: Plan) -> Plan:
    """Return the plan without fast-forwards, so that every step is a trial step."""
    return dataclasses.replace(plan, fast_forwards=())


def floor_course(
    podium: Podium,
    excitation: AbstractExcitation,
    initial: State,
    t_end: Any,
    options: Options,
    capacity: int,
) -> tuple[FloorCourse, Array]:
    """Solve a scene without fast-forwards. Return the motion of its floors, and the result code.

    - `podium`, `excitation`, `initial`, `t_end`, `options`: the scene
    - `capacity`: number of steps that the history can hold
    """
    plan = without_fast_forwards(plan_for(podium, options, history=True))
    scene, state = prepare(podium, excitation, initial, t_end, options, plan)
    state, nodes = run_with_history(scene, plan, state, options.max_steps, capacity)
    rtol = options.rtol if podium.restrainers else None
    return course_of((podium, excitation, nodes, jnp.asarray(jnp.inf), options.method, rtol)), state.code
