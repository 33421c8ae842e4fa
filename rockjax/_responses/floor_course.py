"""The motion of modes and beam (the bodies) in a scene, as the excitation of secondary systems on floors.

The history of a scene is the sequence of its accepted steps; the ends of the steps are its nodes. (L2) and
(L3) are in docs/floors.md.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from rockjax import _results as results
from rockjax._engine.flat import solve_scene
from rockjax._engine.scene import default_end, plan_for, prepare
from rockjax._engine.state import Plan
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.piecewise import NODES, PiecewiseMotion
from rockjax._options import Options
from rockjax._results import State
from rockjax._structures import Podium
from rockjax._types import Values

from . import history
from .floor import MOTION_PIECES, bodies
from .floor_end import Ending, ending

NEVER_LIFTS = 1.57  # slenderness α of columns so wide that no real ground motion lifts them [rad]
# By default, a scene with oscillators on floors continues after the ground motion for at least this many
# periods of the slowest oscillator.
PERIODS = 5


def end_with_oscillators(podium: Podium, excitation: AbstractExcitation, longest: Any) -> Any:
    """Return the default end of a scene with oscillators on its floors [s].

    The result is the later of two times: the default end of `simulate`, and the end of the ground motion plus
    `PERIODS` times the `longest` period of an oscillator [s].
    """
    return jnp.maximum(default_end(podium.resolved(), excitation), excitation.support[1] + PERIODS * longest)


class FloorCourse(NamedTuple):
    """Accelerations and velocity jumps of modes and beam along a history. The vertical motion of the beam
    counts as the last body.

    - `times`: times of the n nodes of the history [s]; inf after the last node. At events, their derivatives
      are those of the event times
    - `accelerations`: absolute accelerations at the Chebyshev points of each step, `NODES` of
      `_excitations/piecewise.py` [m/s²]
    - `jumps`: velocity jumps at the nodes of the history [m/s]
    - `end`: time of the last node [s]
    - `ending`: quantities that bound the motion after the end; the bound is inf if the podium overturned
    """

    times: Float[Array, " n"]
    accelerations: Float[Array, " n nodes bodies"]
    jumps: Float[Array, " n bodies"]
    end: Float[Array, ""]
    ending: Ending

    def motion(self, weights: Values) -> PiecewiseMotion:
        """Return the motion of a floor: the sum of the motions of the bodies with these weights, (L2),
        (L3)."""
        return PiecewiseMotion.through(self.times, self.accelerations @ weights, self.jumps @ weights)


def course_of(scene: history.Solved, has_fallen: Array) -> FloorCourse:
    """Return the motion of modes and beam along a history in which no step passes a breakpoint.

    - `scene`: solved scene; `has_fallen`: whether the podium overturned
    """
    nodes = scene[2]
    rows = jnp.arange(nodes.t.shape[0])
    is_used = rows < nodes.used
    used_rows = jnp.minimum(rows, nodes.used - 1)
    last = jnp.max(jnp.where(is_used, nodes.t, -jnp.inf))
    times = jnp.where(is_used, nodes.event_time, last)
    starts = jax.lax.stop_gradient(jnp.where(is_used, nodes.t, last))
    lengths = jnp.append(jnp.diff(starts), 0.0)
    # The motion is evaluated first at the `NODES` of every step, and then just before the impacts. The last
    # of the `NODES` is the end of the step; there, the motion just before the end is used.
    is_impact = jnp.isfinite(nodes.impact_time) & is_used
    t = starts[:, None] + lengths[:, None] * (0.5 + 0.5 * jnp.asarray(NODES))[None, :]
    left = jnp.broadcast_to(NODES[-1] == NODES, t.shape)
    node = jnp.broadcast_to(used_rows[:, None], t.shape)
    motion = bodies(
        scene,
        jnp.append(t, jnp.where(is_impact, times, times[0])),
        jnp.append(left, jnp.ones_like(is_impact)),
        jnp.append(node, jnp.where(is_impact, rows - 1, 0)),
    )
    accelerations = motion.accelerations[: t.size].reshape(*t.shape, -1)
    speed, vertical_velocity = motion.velocity[t.size :, -1], motion.vertical_velocity[t.size :]
    # An impact multiplies the horizontal velocity of the beam by e and the vertical velocity by −e, (L3). The
    # velocities of modes do not jump. The impact that ends rocking is no exception: in the model, infinitely
    # many smaller impacts would follow it, and only these bring the beam to rest.
    e = jnp.maximum(scene[0].restitution_factor, 0.0)
    of_modes = jnp.zeros((rows.size, accelerations.shape[-1] - 2))
    of_beam = jnp.stack([(1 - e) * -speed, (1 + e) * -vertical_velocity], axis=-1)
    jumps = jnp.concatenate([of_modes, of_beam], axis=-1)
    jumps = jnp.where(is_impact[:, None], jumps, 0.0)
    finite_times = jnp.where(is_used, times, jnp.inf)
    ended = jax.lax.stop_gradient(ending(scene, last))
    ended = ended._replace(rests=ended.rests & ~has_fallen, speed=jnp.where(has_fallen, jnp.inf, ended.speed))
    return FloorCourse(finite_times, accelerations, jumps, times[-1], ended)


def without_fast_forwards(plan: Plan) -> Plan:
    """Return the plan without fast-forwards, which skip parts of a scene."""
    return dataclasses.replace(plan, fast_forwards=())


def floor_course(
    podium: Podium,
    excitation: AbstractExcitation,
    initial: State,
    t_end: Any,
    options: Options,
    capacity: int,
    reversible: bool,
) -> tuple[FloorCourse, Array]:
    """Solve a scene without fast-forwards. Return the motion of modes and beam, and the result code.

    - `podium`, `excitation`, `initial`, `t_end`, `options`: the scene
    - `capacity`: number of steps that the history can hold
    - `reversible`: whether to integrate in a loop that reverse-mode differentiation supports
    """
    plan = without_fast_forwards(plan_for(podium, options, history=True))
    scene, state = prepare(podium, excitation, initial, t_end, options, plan)
    # In full contact the state of a rigid podium (with a rigid superstructure or none) is constant, so the
    # tolerance does not limit its steps. A fraction of the duration of the ground motion limits them instead.
    start, excitation_end = excitation.support
    piece = jax.lax.stop_gradient((excitation_end - start) / MOTION_PIECES)
    longest = jnp.where(piece > 0, jnp.minimum(scene.max_excited_step, piece), scene.max_excited_step)
    scene = scene._replace(max_excited_step=longest)
    nodes: Any
    _, final, nodes = solve_scene(scene, plan, state, options.max_steps, capacity, reversible)
    rtol = options.rtol if podium.restrainers else None
    solved = podium, excitation, nodes, jnp.asarray(jnp.inf), options.method, rtol
    return course_of(solved, final.code == results.OVERTURNED), final.code
