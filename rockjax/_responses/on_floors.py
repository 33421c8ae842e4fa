"""Light things on the floors of one scene: their answers from the history of the structure."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer

from rockjax import _results as results
from rockjax._checks import concrete, format_value
from rockjax._engine.coefficients import present
from rockjax._engine.flat import run
from rockjax._engine.scene import plan_for, prepare
from rockjax._engine.solve import answers
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import GroundMotion
from rockjax._options import Options
from rockjax._outputs.base import AbstractOutput
from rockjax._outputs.joints import friction_of, quarter_tangent
from rockjax._outputs.views import Ended, Start, Step, StepEnd
from rockjax._programs.derivatives import differentiable, is_concrete, with_jacobian, with_jacobian_rule
from rockjax._programs.program import StoredProgram
from rockjax._results import REST
from rockjax._sincos import sincos
from rockjax._structures import Contents, Elastic, GivenRestitution, Oscillator, Podium
from rockjax._types import Value, Values

from .floor import DECK, DIRECTIONS, floor_weights, in_direction, with_beam
from .floor_answers import ContentsAnswer, OscillatorAnswer
from .floor_course import NEVER_LIFTS, FloorCourse, end_with_oscillators, floor_course, followed

BOTTOM = 0  # the joint of a block with the floor
# A rest velocity that no jolt exceeds, and the factor on `atol` that makes it one of short oscillators.
NEVER, FINER = 1e300, 1e-4


@dataclasses.dataclass(frozen=True)
class JoltFriction(AbstractOutput):
    """The largest friction demand of a block at velocity jumps of its floor beyond the rest velocity, (L15),
    as tan(φ/4) of the angle of the impulse; and whether a jump started it, as a note."""

    name = "jolt_friction"
    needs_flat = True

    def start(self, start: Start) -> tuple[Value, Value]:
        return jnp.zeros_like(start.t), jnp.zeros_like(start.t)

    def over_step(self, step: Step, record: Value) -> None:
        del step, record

    def update(self, end: StepEnd, record: Value, note: Any, largest: Any) -> tuple[Value, Value]:
        del largest
        jolt, state, c = present(end.jolt), end.step.state, end.step.c
        jump: Any = jolt.jump
        s, cos = sincos(jolt.side * c.alpha - end.x[0])
        turn = jnp.where(jolt.sigma == 0, 0.0, 0.5 * c.two_R * jolt.change[0])
        demand = jnp.abs(quarter_tangent(jump.horizontal + turn * cos, jump.vertical + turn * s))
        # Below the rest velocity the direction of a jump depends on how the structure comes to rest.
        size = jnp.abs(jump.horizontal) + jnp.abs(jump.vertical)
        raises = end.accepted & (size > c.two_R * end.step.scene.rest_speed) & (demand > record)
        started = end.accepted & jolt.lifts & ~state.uplifted
        return jnp.where(raises, demand, record), jnp.where(started, 1.0, note)

    def answer(self, ended: Ended, record: Value, note: Any) -> dict[str, Any]:
        return {self.name: friction_of(record), "started_by_impulse": note}


def _rock(block: Contents, g: Value, weights: Values, course: FloorCourse, options: Options):
    """Return the answers of a block by name: floats, and integers and flags.

    - `weights`: of the bodies, horizontally and vertically, shape (2, bodies)
    - `course`, `options`: motion of the bodies, and options of the scene
    """
    outputs = "peak_rotation", "margin", "peak_friction", JoltFriction()
    options = options.replace(outputs=outputs, overturn_ratio=block.overturn_ratio)
    motion = GroundMotion(*map(course.motion, weights))
    solitary = block.block(g)
    floats, integers = _solve(solitary, motion, course.end, options)
    joints, impacts = floats["peak_friction"][BOTTOM], integers["impacts"]
    at_impacts = jnp.where(impacts > 0, solitary.impact_friction[BOTTOM], 0.0)
    demand = jnp.maximum(jnp.maximum(joints, floats["jolt_friction"]), at_impacts)
    names = "peak_rotation", "peak_rotation_time", "margin", "uplift_time", "overturn_time"
    started = floats["started_by_impulse"] > 0
    return {name: floats[name] for name in names} | {"friction_demand": demand}, integers | {
        "started_by_impulse": started
    }


def _vibrate(oscillator: Oscillator, g: Value, weights: Values, course: FloorCourse, options: Options):
    """Return the answers of an oscillator by name, as `_rock` does.

    It is the superstructure without mass of a podium that never lifts: its columns are almost flat, and the
    rest velocity keeps jolts from lifting them.
    """
    flat = Podium(NEVER_LIFTS, 1.0, superstructure=Elastic(0.0, oscillator.period, oscillator.damping), g=g)
    outputs = "peak_rotation", "peak_deformation", "peak_shear"
    finer = options.replace(
        outputs=outputs,
        overturn_ratio=1.0,
        rest_velocity=NEVER,
        atol=jnp.maximum(FINER * options.atol, 1e-17),
    )
    motion = course.motion(weights[DIRECTIONS.index(oscillator.direction)])
    floats, integers = _solve(flat, motion, course.end, finer)
    displacement = floats["peak_deformation"]
    return {
        "relative_displacement": displacement,
        "pseudo_acceleration": (2 * jnp.pi / oscillator.period) ** 2 * displacement,
        "absolute_acceleration": g * floats["peak_shear"],
    }, integers


def _solve(structure: Podium, motion: AbstractExcitation, end: Value, options: Options):
    """Return the answers of a structure on a floor, to the end of the floor's motion."""
    structure = structure.split()
    plan = followed(plan_for(structure, options, history=True))
    scene, state = prepare(structure, motion, REST, end, options, plan)
    return answers(scene, plan, run(scene, plan, state, options.max_steps))


# Things that may stand on floors: how their answers are computed, and in which class they are returned.
KINDS: dict[type, tuple[Any, type]] = {
    Contents: (_rock, ContentsAnswer),
    Oscillator: (_vibrate, OscillatorAnswer),
}


Things = Sequence[Contents | Oscillator] | Contents | Oscillator


def on_floors(structures, excitation, initial, t_end, options: Options, *, history: int):
    """Return the answers of things on the floors of a scene, a tuple of floats for each, and of integers.

    - `structures`: the podium, and the things on its floors
    - `excitation`, `initial`, `t_end`, `options`: of the scene
    - `history`: number of steps that the history of the floors can hold
    """
    leaves, structure = jax.tree.flatten((structures, excitation, initial, t_end, options))

    def function(*leaves):
        (podium, things), excitation, initial, t_end, options = jax.tree.unflatten(structure, leaves)
        if t_end is None:
            periods = [thing.period for thing in things if isinstance(thing, Oscillator)]
            t_end = end_with_oscillators(podium, excitation, functools.reduce(jnp.maximum, periods, 0.0))
        course, code = floor_course(podium, excitation, initial, t_end, options, history)
        groups: dict[Any, list[int]] = {}  # things of the same kind are solved together
        for k, thing in enumerate(things):
            groups.setdefault((type(thing), getattr(thing, "direction", None)), []).append(k)
        found = {}
        for members in groups.values():
            group = [things[k] for k in members]
            found |= dict(zip(members, _of_group(podium, group, course, options), strict=True))
        failed = code > results.OVERTURNED
        floats, integers = zip(*(found[k] for k in range(len(things))), strict=True)
        floats = jax.tree.map(lambda y: jnp.where(failed, jnp.nan, y), floats)
        flags = {"until_overturning": code == results.OVERTURNED}
        integers = tuple(y | flags | {"code": jnp.where(failed, code, y["code"])} for y in integers)
        return floats, (integers, code)

    return with_jacobian_rule(function, function, True)(*leaves)


def _of_group(podium: Podium, things: list[Any], course: FloorCourse, options: Options) -> list[Any]:
    """Return the answers of things of one kind, computed in lanes."""
    answer, _ = KINDS[type(things[0])]
    weights = jnp.stack([_weights_of(podium, thing) for thing in things])
    lanes = jax.tree.map(lambda *y: jnp.stack(y), *map(_uniform, things))
    found = jax.vmap(lambda thing, w: answer(thing, podium.g, w, course, options))(lanes, weights)
    return [jax.tree.map(functools.partial(jnp.take, indices=k, axis=0), found) for k in range(len(things))]


def _weights_of(podium: Podium, thing: Any) -> Values:
    """Return the weights of the bodies in the motion of a thing's floor, horizontally and vertically."""
    modes = with_beam(jnp.asarray(floor_weights("on_floors", podium, thing.level)))
    across, up = (in_direction(modes, direction) for direction in DIRECTIONS)
    return jnp.stack([across, float(getattr(thing, "vertical", True)) * up])


def _uniform(thing: Any) -> Any:
    """Return a thing without what its weights say already, and with a number for its law of restitution, so
    that all of its kind can be stacked."""
    thing = dataclasses.replace(thing, level=DECK)
    if isinstance(thing, Contents):
        e = GivenRestitution(thing.block(jnp.ones(())).restitution_factor)
        thing = dataclasses.replace(thing, vertical=True, restitution=e)
    return jax.tree.map(jnp.asarray, thing)


def _with_slopes(structures, excitation, initial, t_end, options, numbers, *, history: int):
    """Return the answers, and the derivatives of their floats with respect to the leaves with the indices
    `numbers`, one row per leaf."""
    leaves, structure = jax.tree.flatten((structures, excitation, initial, t_end, options))
    function = lambda *leaves: on_floors(*jax.tree.unflatten(structure, leaves), history=history)
    floats, jacobian, integers = with_jacobian(function, leaves, numbers)
    return (floats, integers), jacobian


PROGRAM = StoredProgram(on_floors, words="the program for things on floors")
SLOPES = StoredProgram(_with_slopes, words="the program for things on floors")


def answers_on_floors(
    owner: str, podium: Podium, excitation, initial, t_end, options: Options, things: Any
) -> tuple[Any, ...]:
    """Return the answers of things on the floors of one scene.

    - `owner`: name of the calling function, for messages
    - `podium`, `excitation`, `initial`, `t_end`, `options`: checked arguments of the scene
    - `things`: [`rockjax.Contents`][] and [`rockjax.Oscillator`][]s

    Raises `ValueError` for things of another kind, and for levels that the structure does not have.
    """
    things = checked(owner, podium, things)
    if not things:
        return ()
    podium = podium.without_elevation().split().without_idle_restrainers()
    options, capacity = floor_options(options), options.history
    arguments = (podium, things), excitation.common_form(), initial, t_end, options
    leaves, structure = jax.tree.flatten(arguments)
    while True:
        if any(isinstance(y, Tracer) for y in leaves) and all(map(is_concrete, leaves)):
            answer = differentiable(PROGRAM, SLOPES, structure, capacity)(*leaves)
        else:
            answer = PROGRAM(*arguments, history=capacity)
        floats, (integers, code) = answer
        if concrete(code) != results.HISTORY_FULL or capacity >= options.max_steps + 2:
            return named(things, floats, integers)
        capacity *= 4


def floor_options(options: Options) -> Options:
    """Return the options of the history of floors."""
    method = options.method if options.engine == "flat" else "dopri8"
    return options.replace(outputs=("peak_rotation",), engine="flat", method=method)


def named(things: tuple, floats: tuple, integers: tuple) -> tuple[Any, ...]:
    """Return the answers of things in their classes."""
    found = []
    for thing, mine, counts in zip(things, floats, integers, strict=True):
        kind = KINDS[type(thing)][1]
        fields = {field.name for field in dataclasses.fields(kind)}
        flags = {name: y for name, y in counts.items() if name in fields}
        found.append(kind(**mine, **flags, result=results.named(counts["code"])))
    return tuple(found)


def checked(owner: str, podium: Podium, on_floors: Any) -> tuple[Any, ...]:
    """Return things on floors as a tuple. Raises `ValueError` as `answers_on_floors` does."""
    things = (on_floors,) if isinstance(on_floors, tuple(KINDS)) else on_floors
    if not isinstance(things, Sequence) or not all(isinstance(thing, tuple(KINDS)) for thing in things):
        kinds = " or ".join(f"rockjax.{kind.__name__}" for kind in KINDS)
        raise ValueError(f"{owner}: on_floors must hold {kinds}, got {format_value(on_floors)}")
    for thing in things:
        floor_weights(f"{owner}: on_floors", podium, thing.level)
    return tuple(things)
