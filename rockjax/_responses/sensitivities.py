"""Derivatives of the peaks of scenes with respect to the logarithms of named parameters."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from rockjax import _checks
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import PARTS, GroundMotion
from rockjax._outputs.base import AbstractOutput
from rockjax._outputs.registry import variables_of
from rockjax._outputs.values import by_name
from rockjax._parameters.sensitivities import check_parameters, with_factors
from rockjax._parameters.table import STRUCTURE
from rockjax._structures import Podium
from rockjax._tree import Module


class Sensitivities(Module):
    """Derivatives of peaks with respect to the logarithms ln y of some parameters y, with the others
    constant.

    - `parameters`: their names; they are along the last axis of the following arrays
    - `peak_rotation` [–], `peak_deformation` [m], `peak_shear` [–], `margin` [–], …: y ∂(…)/∂y of the answers
      of these names, held by `values`; None for those that were not requested or do not exist; zero where a
      parameter is zero. Axes of modes and stories come before that of the parameters
    """

    parameters: tuple[str, ...] = eqx.field(static=True)
    values: dict[str, Any]

    def __getattr__(self, name: str) -> Any:
        return by_name(self, name)


def sensitivities_of(
    floats, names: tuple[str, ...], outputs: Sequence[str | AbstractOutput]
) -> Sensitivities | None:
    """Collect the sensitivities of requested peaks from the outputs of lanes; None without parameters."""
    if not names:
        return None
    slopes = {name: slope_name(name) for name in variables_of(outputs)}
    return Sensitivities(names, {name: floats[slope] for name, slope in slopes.items() if slope in floats})


def slope_name(answer: str) -> str:
    """Return the name of the derivatives of an output."""
    return f"{answer}_sensitivity"


def number_fields(motion: AbstractExcitation) -> dict[str, str]:
    """Return where a motion holds its single numbers, by parameter name.

    Numbers of the vertical motion of a pair are named `vertical.…`.
    """
    if isinstance(motion, GroundMotion):
        of_each = {part: number_fields(getattr(motion, part)) for part in PARTS}
        places = {name: f"horizontal.{field}" for name, field in of_each["horizontal"].items()}
        return places | {f"vertical.{field}": f"vertical.{field}" for field in of_each["vertical"].values()}
    left_out = {*motion.own_dimensions, "which", "scale"}
    fields = [field.name for field in dataclasses.fields(motion) if field.name not in left_out]
    numbers = [name for name in fields if _varies(getattr(motion, name))]
    return {f"excitation.{field}" if field in STRUCTURE else field: field for field in numbers}


def _varies(value: Any) -> bool:
    return isinstance(value, jax.Array | np.ndarray) and jnp.issubdtype(value.dtype, jnp.floating)


def with_numbers(motion: AbstractExcitation, values: Mapping[str, Any]) -> AbstractExcitation:
    """Return the motion with other values of some numbers."""
    for place, value in values.items():
        part, _, field = place.rpartition(".")
        if part:
            changed = dataclasses.replace(getattr(motion, part), **{field: value})
            motion = dataclasses.replace(motion, **{part: changed})
    fields = {place: value for place, value in values.items() if "." not in place}
    return dataclasses.replace(motion, **fields)


def of_scenes(
    owner: str, podium: Podium, motion: AbstractExcitation, names: Sequence[str]
) -> tuple[str, ...]:
    """Return names of parameters of a structure and a ground motion, checked.

    - `owner`: name of the calling function, for messages
    - `podium`, `motion`: of the scenes
    - `names`: requested parameters

    Raises `ValueError` for a name that neither has, that occurs twice, or that determines the same number as
    another.
    """
    names = _checks.as_strings(owner, "sensitivities", names)
    if not names:
        return names
    check_parameters(owner, podium, names, more=[*number_fields(motion), "scale"])
    if len(set(names)) < len(names):
        raise ValueError(f"{owner}: sensitivities name a parameter twice: {list(names)}")
    return names


def moved(
    podium: Podium, motion: AbstractExcitation, names: Sequence[str], factors: Float[Array, " n"]
) -> tuple[Podium, AbstractExcitation]:
    """Return a structure and a ground motion of unchanged values that depend on factors on named parameters.

    - `podium`, `motion`: of the scene
    - `names`: parameters, as checked by `of_scenes`
    - `factors`: factor on each, equal to 1, for derivatives, (n,)
    """
    factor = dict(zip(names, factors, strict=True))
    fields = {field: factor.pop(name) for name, field in number_fields(motion).items() if name in factor}
    scale = factor.pop("scale", None)
    changed = with_numbers(motion, {place: y * _value_at(motion, place) for place, y in fields.items()})
    changed = changed if scale is None else changed.scaled(scale)
    structure = with_factors(podium, list(factor), jnp.asarray(list(factor.values()))) if factor else podium
    return _as_is(podium, structure), _as_is(motion, changed)


def _value_at(motion: AbstractExcitation, place: str) -> Any:
    return functools.reduce(getattr, place.split("."), motion)


def _as_is(now: Any, changed: Any) -> Any:
    """Return exactly the values of `now`, with the derivatives of `changed`."""
    constant = jax.lax.stop_gradient
    return jax.tree.map(lambda y, z: y if z is y else y + (z - constant(z)), now, changed)
