"""Many hops at once: columns that bounce on, with impacts that take almost nothing.

Where e is 1, or so close to it that the difference does not tell, columns under a vibrating superstructure
lose speed to its damper only: hops get ever shorter, and until the rest velocity is reached there are of the
order of 1/`rtol` of them. Two hops, over and back, are then a map of (t, u_t, u̇_t, |θ̇⁺|) that is close to
the identity, and n times two hops are the flow over a "time" n of a smooth field: the logarithm of the map.
Central differences of the map and its inverse give that field; the scene's own Runge–Kutta method, with its
error estimate, follows it over as many hops as the tolerance lets it. As n is a whole number, what comes out
is the state after an impact, phase of the bouncing included.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from rockjax import _results as results
from rockjax._types import Flag, Value

from .attempt import GroundMotion, factor, units
from .coefficients import present
from .hermite import turning_point
from .maxima import NEAR_RECORD, cubic
from .model import acceleration
from .records import larger
from .settled import certificate
from .state import LoopState, Plan, Scene
from .tableaus import Tableau
from .transitions import restart

OFTEN = 64  # impacts from one look for many hops to the next
SHORT = 0.02  # radians of the vibration on lifted columns over two hops, at most
SMOOTH = 0.3  # times the fourth root of the tolerance: radians of the superstructure's own over two hops
FEWEST = 8  # pairs of hops that are worth it
ARC, FINE_ARC = 0.5, 2.0  # radians of the superstructure's own; times the fourth root of rtol near a record
LOW = 0.5  # of the recorded rotation: hops may be so high …
LESS = 0.9  # … where the overturning margin is wanted, and below this
UNCOUNTED = 2**30  # impacts: beyond, they are not counted any more

Pair = Float[Array, "2"]  # deformation and absolute acceleration of the superstructure
Hop = Float[Array, "4"]  # t, u_t, u̇_t at an impact, and the speed |θ̇| that it leaves


def chatters(state: LoopState) -> Flag:
    """Whether it is time to look for many hops: just after an impact, and there were many."""
    return (state.sigma != 0) & (state.x[0] == 0) & (state.impacts >= present(state.look))


@functools.partial(jax.jit, static_argnames=("plan", "max_steps"))
def many_hops(scene: Scene, plan: Plan, state: LoopState, max_steps: int) -> LoopState:
    """Follow hops in large numbers for as long as they are short, from an impact on to another."""
    if not plan.many_hops:
        return state

    class Way(NamedTuple):
        state: LoopState
        pairs: Value  # of hops that the controller proposes
        goes: Flag

    def body(way: Way) -> Way:
        state, pairs, goes = _follow(scene, plan, way.state, way.pairs)
        goes &= (state.code == results.RUNNING) & (state.steps + state.rejected < max_steps)
        return Way(state, pairs, goes)

    starts = chatters(state) & (state.code == results.RUNNING)
    start = Way(state, jnp.asarray(jnp.inf, state.t.dtype), starts)
    state = jax.lax.while_loop(lambda way: way.goes, body, start)[0]
    return state._replace(look=jnp.where(starts, state.impacts + OFTEN, present(state.look)))


def _follow(scene: Scene, plan: Plan, state: LoopState, pairs: Value) -> tuple[LoopState, Value, Flag]:
    """The state some pairs of hops later, how many to try next, and whether to go on like this."""
    constant = jax.lax.stop_gradient
    c, tab, ground_at = scene.c, plan.tableau, scene.excitation.piece(state.piece)

    @jax.jit
    def field(y: Hop) -> Hop:
        return _flow(scene, tab, ground_at, y, constant(state.sigma))

    def crest(y: Hop) -> Pair:
        return _crest(scene, ground_at, y)

    start = _at_impact(scene, ground_at, state)
    rate = field(start)
    duration = constant(jnp.where(rate[0] > 0, rate[0], jnp.inf))  # of two hops
    one = present(c.vibration)
    omega, root = jnp.sqrt(one.omega2), jnp.sqrt(jnp.sqrt(scene.rtol))
    record = constant(_record(plan, state, c.g))
    near = lambda values: jnp.any(constant(values) > record * (1 - NEAR_RECORD))
    coarse, fine = ARC / omega, jnp.minimum(FINE_ARC * root, ARC) / omega  # [s]

    # How many: not past the stop, and to half the speed at most or nearly to rest.
    stop = constant(jnp.minimum(scene.excitation.breakpoint(state.piece), scene.end))
    most = jnp.minimum(jnp.where(near(crest(start)), fine, coarse), 0.4 * (stop - start[0])) / duration
    spare = jnp.minimum(0.5 * start[3], 0.9 * (start[3] - scene.rest))
    most = jnp.minimum(most, spare / jnp.maximum(-rate[3], 1e-300))
    count = jnp.floor(jnp.minimum(constant(most), pairs))
    stiff = one.damping * one.uplifted_frequency**2 / one.omega2
    fast = jnp.maximum(jnp.maximum(one.uplifted_frequency, c.p), stiff)
    short = (fast * duration < SHORT) & (omega * duration < SMOOTH * root) & jnp.all(jnp.isfinite(rate))
    low = _height(scene, ground_at, start) < LOW * state.peak
    if plan.margin:  # at half the rotation it is larger than that of a peak that has so little
        low &= present(state.margin) < LESS
    goes = constant(short & low & (count >= FEWEST) & (start[3] > scene.rest))

    count = jnp.where(goes, count, 0.0)
    change, error = _increment(tab, lambda _, y: field(y), start, count)
    end = start + change
    sure = jnp.all(jnp.isfinite(end)) & (end[3] > scene.rest) & (_height(scene, ground_at, end) < state.peak)
    off = constant(_over_tolerance(scene, start, end, error))
    crests = _largest(crest, (start, rate), (end, field(end)), count)
    too_coarse = near(crests) & (count * duration > 1.001 * fine)
    accepted = goes & constant(sure) & (off <= 1) & ~too_coarse
    proposed = count * jnp.where(sure, factor(plan, off), 0.25)
    proposed = jnp.where(too_coarse, jnp.minimum(proposed, fine / duration), proposed)
    arrived = _arrived(scene, plan, state, end, crests, count)
    tried = state._replace(rejected=state.rejected + goes.astype(jnp.int32))
    state = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), arrived, tried)
    return state, constant(proposed), goes & (constant(proposed) >= FEWEST)


def _at_impact(scene: Scene, ground_at: GroundMotion, state: LoopState) -> Hop:
    """The state at the moving time of the impact, from that at its stamp."""
    delta = state.event_time - jax.lax.stop_gradient(state.event_time)
    angular, a = acceleration(scene.c, state.sigma, ground_at(state.t), state.x, state.v)
    speed = state.sigma * (state.v[0] + delta * angular)
    u, u_dot = state.x[1] + delta * state.v[1], state.v[1] + delta * a
    return jnp.stack([state.event_time, u, u_dot, speed])


def _arrived(scene: Scene, plan: Plan, state: LoopState, end: Hop, crests: Pair, count: Value) -> LoopState:
    """The state after the last of the hops, an impact, with what they leave in the records."""
    now, u, u_dot, speed = end
    stamp = jax.lax.stop_gradient(now)
    # θ = 0 that differs between lanes, as its derivative does.
    x, v = (jax.lax.stop_gradient(state.x[0]), u), (state.sigma * speed, u_dot)
    hops = jnp.minimum(2 * count, float(UNCOUNTED)).astype(jnp.int32)
    arrived = state._replace(
        t=stamp,
        event_time=now,
        x=x,
        v=v,
        deformation=larger(crests[0], present(state.deformation)) if plan.deformation else None,
        shear=larger(crests[1] / scene.c.g, present(state.shear)) if plan.shear else state.shear,
        impacts=jnp.minimum(jnp.minimum(state.impacts, UNCOUNTED - hops) + hops, UNCOUNTED),
        slowest=jnp.minimum(state.slowest, speed / scene.c.restitution),
        steps=state.steps + 1,
    )
    ground = scene.excitation.piece(state.piece)(stamp)
    settled = certificate(scene, plan, arrived, state.piece, ground)
    x, v = restart(scene, stamp, now - stamp, x, v, state.sigma, state.piece)
    return arrived._replace(x=x, v=v, code=jnp.where(settled, results.SETTLED, state.code).astype(jnp.int32))


def _flow(scene: Scene, tab: Tableau, ground_at: GroundMotion, y: Hop, sigma: Value) -> Hop:
    """The field whose flow over 1 is two hops from y, beginning on the side σ.

    With F(y) = y after two hops, log F = (8(F − F⁻¹) − (F² − F⁻²))/12 to the fifth order.
    """
    alternate = jnp.array([1.0, -1.0, 1.0, -1.0], y.dtype)

    def hops(way: Value) -> Float[Array, "4 4"]:
        def one(carry: tuple[Hop, Hop], side: Value):
            y, moved = carry
            change = _hop(scene, tab, ground_at, y, side, way)
            return (y + change, moved + change), moved + change

        return jax.lax.scan(one, (y, jnp.zeros_like(y)), sigma * way * alternate)[1]

    onward, back = jax.vmap(hops)(jnp.array([1.0, -1.0], y.dtype))
    return (8 * (onward[1] - back[1]) - (onward[3] - back[3])) / 12


def _hop(scene: Scene, tab: Tableau, ground_at: GroundMotion, y: Hop, side: Value, way: Value) -> Hop:
    """What one hop on a side changes; backwards (`way` = −1) what the hop before the impact had changed."""
    c = scene.c
    t, u, u_dot, speed = y
    leaves = jnp.where(way > 0, side * speed, -side * speed / c.restitution)

    def rate(s: Value, z: Array) -> Array:
        angular, a = acceleration(c, side, ground_at(t + s), (z[0], z[1]), (z[2], z[3]))
        return jnp.stack([z[2], z[3], angular, a])

    start = jnp.stack([jnp.zeros_like(u), u, leaves, u_dot])
    h = -2 * leaves / rate(jnp.zeros_like(t), start)[2]
    change = slopes = start
    late = jnp.zeros_like(h)
    for _ in range(2):
        h = h + late
        change, _ = _increment(tab, rate, start, h)
        slopes = rate(h, start + change)
        # The end of the hop is so close that a parabola leads there.
        angle, velocity = change[0], leaves + change[2]
        late = -angle / velocity
        late = -angle / (velocity + 0.5 * late * slopes[2])
    change = change + late * slopes
    velocity = leaves + change[2]
    after = jnp.where(way > 0, -side * c.restitution * velocity, side * velocity)
    return jnp.stack([h + late, change[1], change[3], after - speed])


def _increment(tab: Tableau, rate, y: Array, h: Value) -> tuple[Array, Array]:
    """What a Runge–Kutta step of length h changes, and its estimated error.

    Stage by stage in a loop, so that the field is compiled once; apart from y, which may be much larger.
    """

    def stage(k: Array, part: tuple[Array, Array, Array]) -> tuple[Array, None]:
        i, node, weights = part
        return k.at[i].set(rate(node * h, y + h * jnp.sum(weights[:, None] * k, axis=0))), None

    parts = (jnp.arange(len(tab.c)), jnp.asarray(tab.c, y.dtype), jnp.asarray(tab.A, y.dtype))
    k, _ = jax.lax.scan(stage, jnp.zeros((len(tab.c), *y.shape), y.dtype), parts)
    combined = lambda weights: h * jnp.sum(jnp.asarray(weights, y.dtype)[:, None] * k, axis=0)
    return combined(tab.b), combined(tab.error)


def _over_tolerance(scene: Scene, start: Hop, end: Hop, error: Hop) -> Value:
    """Root mean square of the estimated error over tolerance, in the units of the steps."""
    x_unit, v_unit = units(scene.c)
    unit = jnp.stack([1 / scene.c.p, x_unit[1], v_unit[1], v_unit[0]])
    size = jnp.maximum(jnp.abs(start), jnp.abs(end)).at[0].set(0.0)
    scale = scene.atol * unit + scene.rtol * size
    scale = scale.at[0].set(scene.rtol / present(scene.c.vibration).uplifted_frequency)
    return jnp.sqrt(jnp.mean((error / scale) ** 2))


def _restoring(scene: Scene, ground_at: GroundMotion, y: Hop, side: float) -> Value:
    """−σθ̈ of columns that lift to a side."""
    one, zero = jnp.ones_like(y[0]), jnp.zeros_like(y[0])
    return -side * acceleration(scene.c, side * one, ground_at(y[0]), (zero, y[1]), (zero, y[2]))[0]


def _height(scene: Scene, ground_at: GroundMotion, y: Hop) -> Value:
    """|θ| that hops reach, but for their own shortness; inf where they are none."""
    least = jnp.minimum(_restoring(scene, ground_at, y, 1.0), _restoring(scene, ground_at, y, -1.0))
    return jnp.where(least > 0, 0.5 * y[3] ** 2 / jnp.where(least > 0, least, 1.0), jnp.inf)


def _crest(scene: Scene, ground_at: GroundMotion, y: Hop) -> Pair:
    """Largest deformation [m] and absolute acceleration [m/s²] of the superstructure over a hop on each side.

    Over a hop the beam goes along a parabola, u_b = 2R cos α s (wτ − aτ²/2), and what the damper makes of it
    is in u̇_t as well: the acceleration is that of the impact less 2R cos α s (κU + D U̇) with D = 2ζω_s and
    κ = ω_s² − D².
    """
    c = scene.c
    _, u, u_dot, w = y
    one = present(c.vibration)
    omega2, damping = one.omega2, one.damping
    arm, kappa = c.two_R * c.cos_alpha, omega2 - damping**2
    force = omega2 * u + damping * u_dot
    deformation, shear = jnp.abs(u), jnp.abs(force) + arm * damping * w
    for side in (1.0, -1.0):
        a = _restoring(scene, ground_at, y, side)
        a = jnp.where(a > 0, a, jnp.inf)
        deformation = larger(jnp.abs(u - side * arm * 0.5 * w**2 / a), deformation)
        bends = jnp.abs(kappa) * w > damping * a
        rate = jnp.where(bends, damping * a / jnp.where(bends, kappa, 1.0), 0.0)
        rate = jnp.where(jnp.isfinite(rate), rate, 0.0)
        middle = kappa * (w**2 - rate**2) / (2 * a) + damping * rate
        shear = larger(jnp.where(bends, jnp.abs(force - side * arm * middle), 0.0), shear)
    return jnp.stack([deformation, shear])


def _record(plan: Plan, state: LoopState, g: Value) -> Pair:
    """What is recorded of both, inf where it is not wanted."""
    never = jnp.full_like(state.t, jnp.inf)
    return jnp.stack(
        [
            present(state.deformation) if plan.deformation else never,
            present(state.shear) * g if plan.shear else never,
        ]
    )


def _largest(crest, start: tuple[Hop, Hop], end: tuple[Hop, Hop], count: Value) -> Pair:
    """The largest of `crest` along the flow between two states, from its values and rates there."""
    values = [jax.jvp(crest, (y,), (rate,)) for y, rate in (start, end)]
    found = []
    for k in range(2):
        (f0, s0), (f1, s1) = ((value[k], slope[k]) for value, slope in values)
        path = cubic(f0, s0, f1, s1, count)
        turned = (s0 > 0) & (s1 < 0)
        z = turning_point(jax.lax.stop_gradient(path), jnp.ones_like(turned))
        most = larger(f1, f0)
        found.append(jnp.where(turned, larger(path.value(z), most), most))
    return jnp.stack(found)
