"""Derivatives of the values of checks with respect to the logarithms of n + 1 factors.

The first n factors multiply the n inputs of the structure that are in `Problem.variables`. The last factor
multiplies the motion. The derivatives are evaluated at factors of 1, whose logarithms are 0. A scene is the
structure under one motion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._engine.solve import prepare_slopes, solve_with_slopes
from rockjax._excitations.base import AbstractExcitation
from rockjax._options import Options
from rockjax._outputs.registry import variables_of
from rockjax._responses.arguments import as_start
from rockjax._results import REST
from rockjax._structures import Podium
from rockjax._types import Value

from .entry import Entry
from .problem import Problem
from .scenes import Scenes
from .store import dataset_of, fingerprint

if TYPE_CHECKING:
    import xarray

# Function () ↦ (value, derivatives of the value with respect to the n + 1 logarithms).
SlopesFunction = Callable[[], tuple[Any, Any]]


def log_slopes(scenes: Scenes, entry: Entry, functions: Mapping[int, SlopesFunction]) -> xarray.Dataset:
    """Return a dataset of the values of a check [SI] and their logarithmic derivatives.

    The variable `value` has the dimension `motion`. The variable `slope`, d ln(value)/d ln y, has the
    dimensions `motion` and `parameter`. The parameters y are the inputs of the structure and, if the check
    uses a set of motions, the factor on the motion.

    - `scenes`: the scenes of the problem; `entry`: the entry of the check
    - `functions`: index of a motion or pulse → function that returns the value of the check under this
      motion, and the derivatives of the value
    """
    import xarray

    problem, motions = scenes.problem, list(functions)
    names = [*problem.variables, *(["motion"] if entry.motions else [])]
    identities = [scenes.motion_set(entry.motions).identities[k] for k in motions] if entry.motions else []
    joints, settings = problem.joints.model_dump(), (entry.kind, dict(entry.arguments))
    inputs_hash = fingerprint(problem.podium, identities, problem.options, settings, names, motions, joints)

    def solve() -> xarray.Dataset:
        scenes.describe(f"derivatives of {entry.id}")
        pairs = [function() for function in functions.values()]
        values = np.array([float(value) for value, _ in pairs])
        slopes = np.array([np.asarray(slope)[: len(names)] for _, slope in pairs])
        with np.errstate(divide="ignore", invalid="ignore"):  # a value may be 0
            slopes = slopes / values[:, None]
        return xarray.Dataset(
            {"slope": (("motion", "parameter"), slopes), "value": ("motion", values)},
            coords={"parameter": names, "motion": motions},
        )

    return scenes.store.get(f"slopes.{entry.id}", inputs_hash, solve)


def slopes_of(
    problem: Problem, function: Callable[[Podium, Value], Value], *, jit: bool = False
) -> SlopesFunction:
    """Return a function that computes `function` and its derivatives with respect to `logs`, at `logs` = 0.

    - `function`: function (podium, logs) ↦ value, with the logarithms `logs` of the factors, (n + 1,). The
      inputs of `podium` are already multiplied by their factors. The function itself must multiply the motion
      by exp(logs[-1])
    - `jit`: whether to compile the derivative as one program, instead of one program for each operation. A
      function that solves scenes needs no jit, because rockjax compiles the solution of scenes
    """
    derivative = jax.value_and_grad(lambda logs: function(varied(problem, logs), logs))
    return lambda: (jax.jit(derivative) if jit else derivative)(jnp.zeros(len(problem.variables) + 1))


def varied(problem: Problem, logs: Any) -> Podium:
    """Return the structure with its inputs multiplied by the first n factors, exp(logs[:-1]).

    The result is exact to first order in the logarithms `logs`, (n + 1,). The last factor applies to the
    motion and is not used.
    """
    leaves, treedef = jax.tree.flatten(problem.differentiable_podium)
    changed = [
        jnp.asarray(y, float) + J @ logs[:-1] for y, J in zip(leaves, problem.leaf_derivatives, strict=True)
    ]
    return jax.tree.unflatten(treedef, changed)


def scene_answers(scenes: Scenes, name: str, motion: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return name → (value, derivatives) for each differentiable answer of a scene, such as "peak_rotation".

    The last axis of the derivatives runs over the logarithms. One solution gives the derivatives of all
    answers. Records are padded to a few common lengths. Motions of the same class and padded length share one
    compiled program.

    - `scenes`: the scenes of the problem
    - `name`: name of the set of motions; `motion`: index of the motion in the set
    """
    problem, motions, options = scenes.problem, scenes.motion_set(name), _options(scenes, name)
    excitation = motions.excitations[motion]
    inputs_hash = fingerprint(problem.podium, motions.identities[motion], options, problem.variables)

    def solve() -> xarray.Dataset:
        scenes.describe(f"derivatives of {motions.names[motion]}")
        answers = solved_answers(problem, excitation, options)
        # The value and its derivatives are one variable, because the time to write a file grows with the
        # square of the number of variables.
        return dataset_of({key: np.concatenate([y[..., None], dy], -1) for key, (y, dy) in answers.items()})

    data = scenes.store.get(f"derivatives.{name}.{motion}", inputs_hash, solve)
    return {str(key): (y.values[..., 0], y.values[..., 1:]) for key, y in data.items()}


def prepare_answers(scenes: Scenes, name: str) -> None:
    """Start to load or compile the program of `scene_answers` for a set in another thread. This
    is not done if the checks of the set need no outputs, or if derivatives of the set are stored."""
    if scenes.needed[name].outputs and not any(
        key.startswith(f"derivatives.{name}.") for key in scenes.store.data
    ):
        prepare_solved_answers(scenes, name, _options(scenes, name))


def prepare_solved_answers(scenes: Scenes, name: str, options: Options) -> None:
    """Start to load or compile the program of `solved_answers` for the motions of a set in another thread."""
    podium = scenes.problem.differentiable_podium
    excitation = scenes.motion_set(name).excitations[0]
    prepare_slopes(podium, excitation, as_start("report", REST, podium), None, options)


def _options(scenes: Scenes, name: str) -> Options:
    """Return the options of scenes of the set `name` that are solved with derivatives."""
    return scenes.problem.options.replace(outputs=tuple(scenes.needed[name].outputs), throw=False)


def solved_answers(
    problem: Problem, excitation: AbstractExcitation, options: Options
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Solve one scene, and return its answers in the form of `scene_answers`."""
    podium = problem.differentiable_podium
    initial = as_start("report", REST, podium)
    answers, slopes, indices = solve_with_slopes(podium, excitation, initial, None, options)
    directions = leaf_directions(problem, excitation, options.of_joints)
    directions = np.array([directions[i] for i in indices])
    return {
        key: (np.asarray(answers[key]), np.tensordot(np.asarray(slopes[key]), directions, axes=(0, 0)))
        for key in variables_of(options.outputs)
        if key in slopes
    }


def leaf_directions(
    problem: Problem, excitation: AbstractExcitation, with_elevation: bool
) -> list[np.ndarray]:
    """Return, for each leaf of a scene, its derivatives with respect to the logarithms, (n + 1,).

    The leaves are those of the pytree (podium.split_rows(), excitation.common_form()). A solution is
    differentiated with respect to scalar leaves only, so the derivatives of other leaves are not used.

    - `problem`, `excitation`: the problem, and the motion of the scene
    - `with_elevation`: whether the leaves of `Podium.elevation` are among the leaves
    """
    count, split = len(problem.variables), problem.split_derivatives
    of_podium = jax.tree.leaves(split if with_elevation else split.without_elevation())
    # Each leaf of the motion is constant or proportional to the factor on the motion. Its change from factor
    # 1 to factor 2 is therefore its derivative. The derivative of a leaf with several values is not used; the
    # mean is a placeholder.
    original, doubled = (jax.tree.leaves(excitation.scaled(factor).common_form()) for factor in (1.0, 2.0))
    of_motion = [np.mean(np.asarray(z) - np.asarray(y)) for y, z in zip(original, doubled, strict=True)]
    return [np.append(np.asarray(y), 0.0) for y in of_podium] + [
        np.append(np.zeros(count), y) for y in of_motion
    ]
