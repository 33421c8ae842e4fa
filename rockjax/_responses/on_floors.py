"""Light secondary systems on floors: blocks (contents) and oscillators.

The motion of the structure is computed first, and then excites the systems. (L15) is in docs/equations.md.
"""

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
from rockjax._engine.coefficients import not_none
from rockjax._engine.flat import solve_scene
from rockjax._engine.scene import plan_for, prepare
from rockjax._engine.solve import answers
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import SharedPieces
from rockjax._options import Options
from rockjax._oscillators import next_turns
from rockjax._outputs.base import AbstractOutput
from rockjax._outputs.joints import Force
from rockjax._outputs.views import Ended, Start, Step, StepEnd
from rockjax._programs.derivatives import differentiable, is_concrete, with_derivatives, with_slopes
from rockjax._programs.program import StoredProgram
from rockjax._results import REST
from rockjax._sincos import sincos
from rockjax._structures import Contents, Elastic, GivenRestitution, Oscillator, Podium
from rockjax._types import Value, Values

from .floor import DECK, DIRECTIONS, floor_weights, in_direction, with_beam
from .floor_answers import ContentsAnswer, OscillatorAnswer
from .floor_course import NEVER_LIFTS, FloorCourse, end_with_oscillators, floor_course, without_fast_forwards
from .floor_end import bound_after_end, ratio_after_end

BOTTOM = 0  # index of the bottom joint, between a block and the floor
UNREACHABLE = 1e300  # rest velocity so large that no velocity jump of the floor starts rocking
OSCILLATOR_ATOL = 1e-4  # factor on `atol` for oscillators, whose displacements are small for short periods


@dataclasses.dataclass(frozen=True)
class JoltFriction(AbstractOutput):
    """The largest friction demand of a block at velocity jumps of the floor, (L15).

    The horizontal and the vertical velocity of the floor jump by Δv and Δw. A jump counts only if |Δv| + |Δw|
    exceeds 2R_c times the rest velocity, where R_c is the half diagonal of the block. The rest velocity is
    the rate |θ̇| below which an impact brings the block to rest.

    The accumulator (the value so far) is the impulse with the largest angle from the vertical. The note
    (further data) is 1 if the block started to rock at a jump, else 0.
    """

    name = "jolt_friction"
    needs_flat = True

    def start(self, start: Start) -> tuple[Force, Value]:
        zero = jnp.zeros_like(start.t)
        return Force(zero, zero + 1), zero

    def over_step(self, step: Step, accumulator: Force) -> None:
        del step, accumulator

    def update(self, end: StepEnd, accumulator: Force, note: Any, largest: Any) -> tuple[Force, Value]:
        del largest
        jolt, state, c = not_none(end.jolt), end.step.state, end.step.c
        jump: Any = jolt.jump
        s, cos = sincos(jolt.side * c.alpha - end.x[0])
        velocity_from_rotation = jnp.where(jolt.sigma == 0, 0.0, 0.5 * c.two_R * jolt.change[0])
        horizontal = jump.horizontal + velocity_from_rotation * cos
        impulse = Force(jnp.abs(horizontal), jump.vertical + velocity_from_rotation * s)
        # The direction (Δv, Δw) of smaller jumps depends on details of how the structure comes to rest.
        size = jnp.abs(jump.horizontal) + jnp.abs(jump.vertical)
        counts = end.accepted & (size > c.two_R * end.step.scene.rest_speed)
        started = end.accepted & jolt.lifts & ~state.uplifted
        accumulator = accumulator.replaced(counts & impulse.is_steeper(accumulator), impulse)
        return accumulator, jnp.where(started, 1.0, note)

    def answer(self, ended: Ended, accumulator: Force, note: Any) -> dict[str, Any]:
        return {self.name: accumulator.demand, "started_by_impulse": note}


def _rock(
    block: Contents, g: Value, weights: Values, course: FloorCourse, options: Options, reversible: bool
):
    """Return the answers of a block in two dicts by name: first floats, then integers and flags.

    - `block`, `g`: the block, and the acceleration of gravity [m/s²]
    - `weights`: weights of the bodies in the motion of the floor, as returned by `_weights_of`
    - `course`, `options`: motion of modes and beam, and options of the scene
    - `reversible`: whether to integrate in a loop that reverse mode can differentiate
    """
    outputs = "peak_rotation", "margin", "peak_friction", JoltFriction()
    options = options.replace(outputs=outputs, overturn_ratio=block.overturn_ratio)
    motion = SharedPieces(*map(course.motion, weights))
    solitary = block.block(g)
    floats, integers, _ = _solve(solitary, motion, course.end, options, reversible)
    joints, impacts = floats["peak_friction"][BOTTOM], integers["impacts"]
    at_impacts = jnp.where(impacts > 0, solitary.impact_friction[BOTTOM], 0.0)
    demand = jnp.maximum(jnp.maximum(joints, floats["jolt_friction"]), at_impacts)
    # A block beyond its stability angle α_c may still return, so there is no margin beyond this angle.
    margin = jnp.where(block.overturn_ratio > 1, jnp.nan, floats["margin"])
    names = "peak_rotation", "peak_rotation_time", "uplift_time", "overturn_time"
    started = floats["started_by_impulse"] > 0
    answers_of_block = {name: floats[name] for name in names} | {"margin": margin, "friction_demand": demand}
    return answers_of_block, integers | {"started_by_impulse": started}


def _vibrate(
    oscillator: Oscillator, g: Value, weights: Values, course: FloorCourse, options: Options, reversible: bool
):
    """Return the answers of an oscillator. Arguments and results correspond to those of `_rock`.

    The oscillator is solved as a massless superstructure on a podium that never lifts. Very wide columns and
    a very large rest velocity prevent uplift.
    """
    fixed_podium = Podium(
        NEVER_LIFTS, 1.0, superstructure=Elastic(0.0, oscillator.period, oscillator.damping), g=g
    )
    outputs = "peak_rotation", "peak_deformation", "peak_shear"
    finer = options.replace(
        outputs=outputs,
        overturn_ratio=1.0,
        rest_velocity=UNREACHABLE,
        atol=jnp.maximum(OSCILLATOR_ATOL * options.atol, 1e-17),
    )
    motion = course.motion(weights[DIRECTIONS.index(oscillator.direction)])
    floats, integers, (x, rate) = _solve(fixed_podium, motion, course.end, finer, reversible)
    omega, zeta = 2 * jnp.pi / oscillator.period, oscillator.damping
    mode_weights, is_vertical = weights[0, :-2], oscillator.direction == "vertical"
    remaining_impulse = bound_after_end(course.ending, mode_weights, zeta, is_vertical)
    # If the floor rests for good, the oscillator vibrates freely after the end, and its next turning point
    # counts as well. Later turning points are not larger.
    rests = course.ending.rests & (remaining_impulse == 0)
    at_next_turn = next_turns(oscillator.period, zeta, x[1], rate[1])
    so_far = floats["peak_deformation"], g * floats["peak_shear"]
    displacement, acceleration = (
        jnp.where(rests, jnp.maximum(a, b), a) for a, b in zip(so_far, at_next_turn, strict=True)
    )
    envelope = jnp.hypot(rate[1] / omega, x[1])
    later = jnp.where(rests, jnp.minimum(at_next_turn[0], displacement), envelope + remaining_impulse / omega)
    return {
        "relative_displacement": displacement,
        "pseudo_acceleration": omega**2 * displacement,
        "absolute_acceleration": acceleration,
        "remaining_ratio": ratio_after_end(*jax.lax.stop_gradient((later, displacement))),
    }, integers


def _solve(structure: Podium, motion: AbstractExcitation, end: Value, options: Options, reversible: bool):
    """Solve a structure on a floor up to the time `end` [s]. Return three results: the floats by name; the
    integers and flags by name; and (positions, velocities) at the end."""
    structure = structure.split_rows()
    plan = without_fast_forwards(plan_for(structure, options, history=True))
    scene, state = prepare(structure, motion, REST, end, options, plan)
    state, final, _ = solve_scene(scene, plan, state, options.max_steps, None, reversible)
    return *answers(scene, plan, state, final), (state.x, state.v)


# For each class of secondary systems: the function that computes the answers, and the class of the answers.
KINDS: dict[type, tuple[Any, type]] = {
    Contents: (_rock, ContentsAnswer),
    Oscillator: (_vibrate, OscillatorAnswer),
}


SecondarySystems = Sequence[Contents | Oscillator] | Contents | Oscillator


def _on_floors(structures, excitation, initial, t_end, options: Options, *, capacity: int, reversible: bool):
    """Return the answers of secondary systems on the floors of a scene.

    - `structures`: a pair: the podium, and the systems on its floors
    - `excitation`, `initial`, `t_end`, `options`: the scene; if `t_end` is None, the scene ends at the time
      that `end_with_oscillators` returns
    - `capacity`: number of steps that the history of the floors can hold
    - `reversible`: whether to integrate in loops that reverse mode can differentiate

    The result is (floats, (integers, code)): for each system a dict of floats and a dict of integers, and the
    result code of the scene.
    """
    podium, systems = structures
    if t_end is None:
        periods = [system.period for system in systems if isinstance(system, Oscillator)]
        t_end = end_with_oscillators(podium, excitation, functools.reduce(jnp.maximum, periods, 0.0))
    course, code = floor_course(podium, excitation, initial, t_end, options, capacity, reversible)
    groups: dict[Any, list[int]] = {}  # systems of the same class and direction are solved together
    for k, system in enumerate(systems):
        groups.setdefault((type(system), getattr(system, "direction", None)), []).append(k)
    answer_of = {}
    for members in groups.values():
        answers_of_group = _solve_group(podium, [systems[k] for k in members], course, options, reversible)
        answer_of |= dict(zip(members, answers_of_group, strict=True))
    has_failed = results.did_not_finish(code)
    floats, integers = zip(*(answer_of[k] for k in range(len(systems))), strict=True)
    floats = jax.tree.map(lambda y: jnp.where(has_failed, jnp.nan, y), floats)
    flags = {"until_overturning": code == results.OVERTURNED}
    integers = tuple(y | flags | {"code": jnp.where(has_failed, code, y["code"])} for y in integers)
    return floats, (integers, code)


on_floors = with_derivatives(_on_floors)
PROGRAM = StoredProgram(on_floors, description="the program for secondary systems on floors")
SLOPES = StoredProgram(with_slopes(_on_floors), description="the program for secondary systems on floors")


def _solve_group(
    podium: Podium, systems: list[Any], course: FloorCourse, options: Options, reversible: bool
) -> list[Any]:
    """Return the answers of systems of one class and direction, solved together under `vmap`."""
    solve, _ = KINDS[type(systems[0])]
    weights = jnp.stack([_weights_of(podium, system) for system in systems])
    stacked = jax.tree.map(lambda *y: jnp.stack(y), *map(_stackable, systems))
    solve_one = lambda system, row: solve(system, podium.g, row, course, options, reversible)
    answers = jax.vmap(solve_one)(stacked, weights)
    return [
        jax.tree.map(functools.partial(jnp.take, indices=k, axis=0), answers) for k in range(len(systems))
    ]


def _weights_of(podium: Podium, system: Any) -> Values:
    """Return the weights of modes and beam in the motion of the floor under a system, shape (2, modes + 2).

    The first row gives the horizontal and the second the vertical motion of the floor. The columns belong to
    the modes, then to the horizontal and the vertical motion of the beam. The second row is zero for contents
    that ignore the vertical motion.
    """
    with_beam_weight = with_beam(jnp.asarray(floor_weights("on_floors", podium, system.level)))
    horizontal, vertical = (in_direction(with_beam_weight, direction) for direction in DIRECTIONS)
    return jnp.stack([horizontal, float(getattr(system, "vertical", True)) * vertical])


def _stackable(system: Any) -> Any:
    """Return the system in a form that can be stacked with others of its class.

    Only systems with equal static fields can be stacked. `level` and `vertical` therefore get fixed values;
    the weights of `_weights_of` contain their effect. The value of the restitution factor replaces the law of
    restitution.
    """
    system = dataclasses.replace(system, level=DECK)
    if isinstance(system, Contents):
        e = GivenRestitution(system.block(jnp.ones(())).restitution_factor)
        system = dataclasses.replace(system, vertical=True, restitution=e)
    return jax.tree.map(jnp.asarray, system)


def answers_on_floors(
    owner: str, podium: Podium, excitation, initial, t_end, options: Options, systems: Any
) -> tuple[Any, ...]:
    """Return the answers of secondary systems on the floors of one scene.

    - `owner`: name of the calling function, for messages
    - `podium`, `excitation`, `initial`, `t_end`, `options`: arguments of the scene, which are already checked
    - `systems`: [`rockjax.Contents`][] and [`rockjax.Oscillator`][], one or a sequence of them

    Raises `ValueError` for systems of another class, and for levels that the structure does not have.
    """
    systems = as_systems(owner, podium, systems)
    if not systems:
        return ()
    podium = podium.without_elevation().split_rows().without_idle_restrainers()
    options, capacity = floor_options(options), options.history
    arguments = (podium, systems), excitation.common_form(), initial, t_end, options
    leaves, treedef = jax.tree.flatten(arguments)
    while True:
        if any(isinstance(y, Tracer) for y in leaves) and all(map(is_concrete, leaves)):
            answer = differentiable(PROGRAM, SLOPES, treedef, capacity)(*leaves)
        else:
            answer = PROGRAM(*arguments, capacity=capacity)
        floats, (integers, code) = answer
        if concrete(code) != results.HISTORY_FULL or capacity >= options.max_steps + 2:
            return as_answers(systems, floats, integers)
        capacity *= 4


def floor_options(options: Options) -> Options:
    """Return options for the history of the floors: the flat engine, and only the output `"peak_rotation"`,
    which takes little time. If the given options have another engine, the method becomes dopri8."""
    method = options.method if options.engine == "flat" else "dopri8"
    return options.replace(outputs=("peak_rotation",), engine="flat", method=method)


def as_answers(systems: tuple, floats: tuple, integers: tuple) -> tuple[Any, ...]:
    """Convert the answers of systems to `ContentsAnswer` and `OscillatorAnswer`.

    - `systems`: the systems
    - `floats`, `integers`: for each system, a dict of its answers, as returned by `on_floors`
    """
    answers = []
    for system, floats_of, integers_of in zip(systems, floats, integers, strict=True):
        answer_class = KINDS[type(system)][1]
        fields = {field.name for field in dataclasses.fields(answer_class)}
        own_integers = {name: y for name, y in integers_of.items() if name in fields}
        answers.append(
            answer_class(**floats_of, **own_integers, result=results.result_of(integers_of["code"]))
        )
    return tuple(answers)


def as_systems(owner: str, podium: Podium, on_floors: Any) -> tuple[Any, ...]:
    """Convert secondary systems on floors to a tuple. Raises `ValueError` as `answers_on_floors` does."""
    systems = (on_floors,) if isinstance(on_floors, tuple(KINDS)) else on_floors
    if not isinstance(systems, Sequence) or not all(isinstance(system, tuple(KINDS)) for system in systems):
        classes = " or ".join(f"rockjax.{y.__name__}" for y in KINDS)
        raise ValueError(f"{owner}: on_floors must hold {classes}, got {format_value(on_floors)}")
    for system in systems:
        floor_weights(f"{owner}: on_floors", podium, system.level)
    return tuple(systems)
