"""Parameters of a structure by dimensions, and podiums with other values of these parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._structures import Dimensions, Podium

from .registry import DIMENSIONS, ROWS_OF_DIMENSIONS, Parameter, common_factor, numbered_parameter

_LISTS = ("story_masses", "story_stiffnesses", "story_heights", "positions", "top_height")
_HEIGHTS = ("beam_depth", "top_height", "residual_height")  # need positions


def parameters_of_dimensions(base: Dimensions) -> dict[str, Parameter]:
    """Return the parameters of a structure by dimensions, by name: its numbers, in the units of the fields of
    `Dimensions`, each number of a list, such as `story_mass_1` [kg], and each list, such as `story_masses`,
    whose value is a factor on all its numbers [–]."""
    has_stories = base.story_masses is not None
    left_out = {"top_mass", "period"} if has_stories else {"period"} if base.period is None else set()
    left_out |= {"damping"} if base.period is None and not has_stories else set()
    left_out |= set(_HEIGHTS) if base.positions is None else set()
    left_out |= {"top_height"} if base.story_heights is not None else set()  # then it must be 0
    entries = {name: y for name, y in DIMENSIONS.items() if not y.is_integer and name not in left_out}
    for entry in ROWS_OF_DIMENSIONS.values():
        row = getattr(base, entry.attribute_path)
        numbered = [numbered_parameter(entry, k + 1) for k in range(len(row) if np.ndim(row) else 0)]
        entries |= {parameter.name: parameter for parameter in numbered}
    lists = [name for name in _LISTS if np.ndim(getattr(base, name))]
    return entries | {name: common_factor(name) for name in lists}


def podium_of(base: Dimensions, values: Mapping[str, Any]) -> Podium:
    """Return the podium of a structure by dimensions with other values of its parameters.

    - `values`: name (see `parameters_of_dimensions`) → value; arrays broadcast with each other and define a
      batch of podiums, whose rows are split as by `Podium.split_rows`. If a value is a factor on a list with
      numbers that vary as well, it multiplies the varied numbers

    Raises `ValueError` for values that do not define a podium.
    """
    shape = np.broadcast_shapes(*(np.shape(y) for y in values.values()))
    if not shape:
        return Podium.from_dimensions(**_arguments(base, values))
    flat = {name: jnp.asarray(np.broadcast_to(y, shape).ravel(), float) for name, y in values.items()}
    if "damping" in flat and not (
        base.stories is None and base.story_masses is None
    ):  # a value for each mode
        building = base.podium().superstructure
        assert building is not None
        flat["damping"] = jnp.repeat(flat["damping"][:, None], building.count, axis=1)
    make = lambda given: Podium.from_dimensions(**_arguments(base, given)).split_rows()
    podiums = jax.jit(jax.vmap(make))(flat)
    # `replace` checks the podiums, whose values were traced above.
    return jax.tree.map(lambda y: _without_equal_axes(np.asarray(y).reshape(shape)), podiums).replace()


def _arguments(base: Dimensions, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of `Podium.from_dimensions` for a structure with other values."""
    arguments = {name: getattr(base, name) for name in type(base).__dataclass_fields__}
    for name, value in values.items():
        row, _, position = name.rpartition("_")
        if row in ROWS_OF_DIMENSIONS and position.isdecimal():
            field = ROWS_OF_DIMENSIONS[row].attribute_path
            arguments[field] = jnp.asarray(arguments[field]).at[int(position) - 1].set(value)
        elif name not in _LISTS or not np.ndim(getattr(base, name)):
            arguments[name] = value
    for name in _LISTS:
        if name in values and np.ndim(getattr(base, name)):
            arguments[name] = jnp.asarray(arguments[name]) * values[name]
    return arguments


def _without_equal_axes(values: np.ndarray) -> np.ndarray:
    """Return values of a batch of podiums with length 1 for each axis along which they do not vary; a scalar
    if they do not vary at all."""
    for axis in range(values.ndim):
        first = values.take([0], axis)
        values = first if np.array_equal(np.broadcast_to(first, values.shape), values) else values
    return values.reshape(()) if values.size == 1 else values
