"""Detection of bounces that certainly end at rest, and can be skipped.

After a slow impact, columns continue in ever shorter hops (motions from one impact to the next). Each impact
multiplies their angular speed by the restitution factor e, so the time until rest has an upper bound. If the
ground motion cannot lift the columns until then, and no hop can change an output, the bounces are skipped:
the columns are put to rest at the first impact. This is done only for rigid podiums (with a rigid
superstructure or none). Eq. (24) is in docs/model.md.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.model import horizontal
from rockjax._engine.state import Decision, LoopState, Plan, Scene
from rockjax._excitations.base import Shaking
from rockjax._outputs.views import Bounces
from rockjax._programs.barrier import barrier
from rockjax._types import Flag, Index, Value

# The ground motion is bounded over this multiple of the estimated duration of the bounces.
AHEAD = 2.0


class Skipped(NamedTuple):
    """Skipped bounces after an impact."""

    to_rest: Flag  # the bounces are skipped, and the columns rest
    impacts: Index  # number of skipped impacts; 0 unless `to_rest`
    # Least |θ̇| before this impact and the skipped impacts [rad/s]. For the last skipped impact, the upper
    # bound `Scene.min_impact_speed` is used.
    min_impact_speed: Value


def skipped_bounces(
    scene: Scene,
    plan: Plan,
    state: LoopState,
    now: tuple[Value, Index, Value | Shaking],
    hit: Flag,
    speed: Value,
    replayed: Decision | None,
) -> Skipped:
    """Return the `Skipped` bounces after the impact at the end of a step.

    - `scene`: the prepared scene; `plan`: settings that are fixed at compilation, such as the outputs
    - `state`: state before the step that ends with the impact
    - `now`: time [s], piece of the excitation and ground acceleration [m/s²] at the impact
    - `hit`: True if the step ends with an impact
    - `speed`: |θ̇| before the impact [rad/s]
    - `replayed`: recorded decision of an accepted step to repeat; None if the step is decided here

    Bounces are skipped only for rigid podiums without restrainers, if no output needs every impact, and if
    `AbstractExcitation.at_most` can bound the excitation over a time interval. A replayed step does not count
    skipped impacts; their number is that of the recorded run.
    """
    if replayed is not None:  # the recorded contact mode shows whether the impact ended at rest
        return Skipped(hit & (replayed.mode == 0), jnp.zeros_like(state.impacts), speed)
    to_rest = None
    if "bounces" in plan.fast_forwards and scene.c.restraint is None:
        to_rest = _bounces_to_rest(scene, plan, state, now, scene.c.restitution * speed)
    if to_rest is None:
        return Skipped(jnp.zeros_like(hit), jnp.zeros_like(state.impacts), speed)
    to_rest = barrier(hit & to_rest)
    impacts = barrier(jnp.where(to_rest, _impact_count(scene, scene.c.restitution * speed), 0))
    return Skipped(to_rest, impacts, jnp.where(to_rest, jnp.minimum(speed, scene.min_impact_speed), speed))


def _bounces_to_rest(
    scene: Scene,
    plan: Plan,
    state: LoopState,
    now: tuple[Value, Index, Value | Shaking],
    speed: Value,
) -> Flag | None:
    """Return whether it is certain that the columns come to rest and that no output changes before. Return
    None if the excitation has no formula for `AbstractExcitation.at_most`.

    - `scene`, `plan`, `state`, `now`: as in `skipped_bounces`
    - `speed`: |θ̇| after the impact [rad/s]

    Hop k = 0, 1, … starts with the speed w eᵏ, where w is `speed`. If the angular deceleration is at least a,
    the largest |θ| of hop k is at most w² e²ᵏ/(2a), and hop k lasts at most 2w eᵏ/a. All hops together last
    at most 2w/(a(1 − e)).
    """
    scene, state, now, speed = jax.lax.stop_gradient((scene, state, now, speed))
    c, (t, piece, shaking) = scene.c, now
    ground = jnp.abs(horizontal(shaking))

    def restoring_moment(ground: Value) -> Value:
        """Return the moment of Eq. (24) that pulls columns back to θ = 0 at the start of a hop. `ground` is
        |ü_g|, taken in the direction that lifts the columns further."""
        return c.gravity * c.sin_alpha - c.ground * ground * c.cos_alpha

    # The duration of all hops is 2w/(a(1 − e)) with a = moment/inertia.
    momentum, loss = 2 * speed * c.inertia, 1 - c.restitution
    divisor, remaining = restoring_moment(ground) * loss, scene.excitation.breakpoint(piece) - t
    span = jnp.minimum(AHEAD * momentum / jnp.where(divisor > 0, divisor, 1.0), remaining)
    span = jnp.where((divisor > 0) & jnp.isfinite(span), span, 0.0)
    max_ground = scene.excitation.at_most(piece, t, span, ground)
    if max_ground is None:
        return None
    moment = restoring_moment(max_ground)
    # Bound on |θ|, valid if at least half of the moment is left at the largest |θ| of a hop, as `rests`
    # requires.
    height = speed**2 * c.inertia / jnp.where(moment > 0, moment, 1.0)
    # From θ = 0 to the largest |θ| of a hop, |sin ψ| decreases by at most |θ|, and cos ψ increases by at most
    # |θ| sin α.
    moment_at_top = moment - height * (c.gravity + c.ground * max_ground * c.sin_alpha)
    rests = (moment > 0) & (moment_at_top > 0.5 * moment) & (momentum < span * moment_at_top * loss)
    bounces = Bounces(c, scene.overturn_angle, max_ground, height, speed, scene.min_impact_speed)
    for output, accumulator in zip(plan.outputs, state.accumulators, strict=True):
        rests &= output.over_bounces(bounces, accumulator)
    return rests


def _impact_count(scene: Scene, speed: Value) -> Index:
    """Return the number of impacts that reduce |θ̇| from `speed` to the rest velocity or below."""
    speed = jax.lax.stop_gradient(speed)
    count = jnp.ceil(jnp.log(jnp.maximum(speed / scene.rest_speed, 1.0)) / scene.log_restitution)
    return jnp.where(jnp.isfinite(count), count, 0.0).astype(jnp.int32)
