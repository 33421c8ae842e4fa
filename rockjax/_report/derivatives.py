"""Derivatives of the values of checks with respect to the logarithms of the inputs.

A `LogFunction` returns the value of a check for the logarithms of n + 1 factors: one on each input, and the
last on the motion. The function is differentiated at zero, where it is exact to first order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._responses.simulate import peak_response
from rockjax._structures import Podium
from rockjax._types import Value

from .entry import Entry
from .problem import Problem
from .scenes import Scenes
from .store import fingerprint

if TYPE_CHECKING:
    import xarray

LogFunction = Callable[[Any], Value]


def log_slopes(scenes: Scenes, entry: Entry, functions: Mapping[int, LogFunction]) -> xarray.Dataset:
    """Return d ln(value)/d ln y of a check for every input y and the factor on the motion, along `motion` and
    `parameter`.

    - `entry`: the check; `functions`: index of a motion or pulse → value of the check
    """
    import xarray

    problem, motions = scenes.problem, list(functions)
    names = [*problem.variables, *(["motion"] if entry.motions else [])]
    hashes = [scenes.motion_set(entry.motions).hashes[k] for k in motions] if entry.motions else []
    joints, settings = problem.joints.model_dump(), (entry.kind, dict(entry.arguments))
    inputs_hash = fingerprint(problem.podium, hashes, problem.options, settings, names, motions, joints)

    def solve() -> xarray.Dataset:
        scenes.say(f"derivatives of {entry.id}")
        origin = jnp.zeros(len(problem.variables) + 1)
        pairs = [jax.value_and_grad(function)(origin) for function in functions.values()]
        values = np.array([float(value) for value, _ in pairs])
        slopes = np.array([np.asarray(slope)[: len(names)] for _, slope in pairs]) / values[:, None]
        return xarray.Dataset(
            {"slope": (("motion", "parameter"), slopes), "value": ("motion", values)},
            coords={"parameter": names, "motion": motions},
        )

    return scenes.store.get(f"slopes.{entry.id}", inputs_hash, solve)


def of_logs(problem: Problem, function: Callable[[Podium, Value], Value]) -> LogFunction:
    """Turn a function of the podium and the factor on the motion into a `LogFunction`."""
    return lambda logs: function(varied(problem, logs), jnp.exp(logs[-1]))


def varied(problem: Problem, logs: Any) -> Podium:
    """Return the structure with its inputs multiplied by factors, exact to first order in `logs`, (n + 1,).
    The last factor belongs to the motion and has no effect here."""
    leaves, structure = jax.tree.flatten(problem.podium)
    changed = [
        jnp.asarray(y, float) + J @ logs[:-1] for y, J in zip(leaves, problem.leaf_derivatives, strict=True)
    ]
    return jax.tree.unflatten(structure, changed)


def scene_answers(scenes: Scenes, name: str, motion: int) -> Callable[[Any], dict[str, Any]]:
    """Return the outputs of a scene as a function of the logarithms, exact to first order.

    One forward pass differentiates all outputs of the scene, and one program serves all motions of a set.

    - `name`: the set; `motion`: index of the motion
    """
    import xarray

    problem, motions = scenes.problem, scenes.motion_set(name)
    excitation = motions.excitations[motion].common_form()
    options = problem.options.replace(outputs=tuple(scenes.needed[name].outputs), throw=False)
    inputs_hash = fingerprint(problem.podium, motions.hashes[motion], options, problem.variables)

    def values(logs: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        scaled = excitation.scaled(jnp.exp(logs[-1]))
        peak = peak_response(varied(problem, logs), scaled, options=options)
        answers = {key: y for key, y in peak.values.items() if y is not None}
        return answers, answers

    def solve() -> xarray.Dataset:
        scenes.say(f"derivatives of {motions.names[motion]}")
        slopes, answers = jax.jacfwd(values, has_aux=True)(jnp.zeros(len(problem.variables) + 1))
        data = {}
        for key, y in answers.items():
            dims = tuple(f"{key}_axis{k}" for k in range(y.ndim))
            data[key] = dims, np.asarray(y)
            data[f"{key}_slope"] = (*dims, "parameter"), np.asarray(slopes[key])
        return xarray.Dataset(data)

    data = scenes.store.get(f"derivatives.{name}.{motion}", inputs_hash, solve)

    def first_order(logs: Any) -> dict[str, Any]:
        names = [str(key) for key in data if not str(key).endswith("_slope")]
        return {key: data[key].values + data[f"{key}_slope"].values @ logs for key in names}

    return first_order
