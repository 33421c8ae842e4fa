"""Parameters of a structure by dimensions, and podiums with other values of these parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._structures import Dimensions, Podium

from .registry import DIMENSIONS, ROWS_OF_DIMENSIONS, Parameter, common_factor, numbered_parameter

_HEIGHTS = ("beam_depth", "top_height", "residual_height")  # need positions


def lists_of_dimensions(base: Dimensions) -> dict[str, Parameter]:
    """Return the fields of a structure by dimensions that are lists of numbers: name of the field, such as
    `story_masses` → parameter of its numbers."""
    entries = ROWS_OF_DIMENSIONS.values()
    return {y.attribute_path: y for y in entries if np.ndim(getattr(base, y.attribute_path))}


def entry_of_list(name: str) -> tuple[Parameter, int] | None:
    """Return the parameter of the numbers of a list and the position in the list, from 1, that a name
    denotes: `story_mass_2` denotes position 2 of `story_masses`. Return None for other names."""
    row, _, position = name.rpartition("_")
    is_in_list = row in ROWS_OF_DIMENSIONS and position.isdecimal()
    return (ROWS_OF_DIMENSIONS[row], int(position)) if is_in_list else None


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
    lists = lists_of_dimensions(base)
    for field, entry in lists.items():
        numbered = [numbered_parameter(entry, k + 1) for k in range(len(getattr(base, field)))]
        entries |= {parameter.name: parameter for parameter in numbered}
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
        return _with_values(base, values)
    flat = {name: jnp.asarray(np.broadcast_to(y, shape).ravel(), float) for name, y in values.items()}
    is_building = base.stories is not None or base.story_masses is not None
    if "damping" in flat and is_building:  # a value for each mode
        building = base.podium().superstructure
        assert building is not None
        flat["damping"] = jnp.repeat(flat["damping"][:, None], building.count, axis=1)
    make = lambda given: _with_values(base, given).split_rows()
    podiums = jax.jit(jax.vmap(make))(flat)
    # `replace` checks the podiums, whose values were traced above.
    return jax.tree.map(lambda y: _without_equal_axes(np.asarray(y).reshape(shape)), podiums).replace()


def changed_fields(base: Dimensions, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a structure by dimensions that change, field → new value, if parameters have other
    values.

    - `values`: name (see `parameters_of_dimensions`) → value. A factor on a list also multiplies the new
      numbers of this list
    """
    changes: dict[str, Any] = {}
    lists = lists_of_dimensions(base)
    for name, value in values.items():
        entry = entry_of_list(name)
        if entry is not None:
            field, position = entry[0].attribute_path, entry[1]
            changes[field] = jnp.asarray(changes.get(field, getattr(base, field))).at[position - 1].set(value)
        elif name not in lists:
            changes[name] = value
    for name in lists:
        if name in values:
            changes[name] = jnp.asarray(changes.get(name, getattr(base, name))) * values[name]
    return changes


def _with_values(base: Dimensions, values: Mapping[str, Any]) -> Podium:
    """Return the podium of a structure with other values, which may be traced."""
    fields = {name: getattr(base, name) for name in type(base).__dataclass_fields__}
    return Podium.from_dimensions(**fields | changed_fields(base, values))


def _without_equal_axes(values: np.ndarray) -> np.ndarray:
    """Return values of a batch of podiums with length 1 for each axis along which they do not vary; a scalar
    if they do not vary at all."""
    for axis in range(values.ndim):
        first = values.take([0], axis)
        values = first if np.array_equal(np.broadcast_to(first, values.shape), values) else values
    return values.reshape(()) if values.size == 1 else values
