"""Derivatives of peaks with respect to the logarithms of named parameters."""

from __future__ import annotations

import dataclasses
import operator
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
from rockjax._parameters.registry import STRUCTURE
from rockjax._parameters.sensitivities import check_parameters, with_factors
from rockjax._structures import Podium
from rockjax._tree import Module


class Sensitivities(Module):
    """Derivatives of peaks with respect to the logarithms of parameters y. The other parameters are held
    constant.

    - `parameters`: names of the parameters, in the order of the last axis of the following arrays
    - `peak_rotation` [–], `peak_deformation` [m], `peak_shear` [–], `margin` [–], …: derivative of the answer
      of this name with respect to y, times y; zero if y = 0. None if the answer was not requested, if the
      structure has no such answer, or if the answer has no derivative. Axes of modes, stories and joints
      precede the axis of parameters
    - `values`: the same derivatives as a dict by name
    """

    parameters: tuple[str, ...] = eqx.field(static=True)
    values: dict[str, Any]

    def __getattr__(self, name: str) -> Any:
        return by_name(self, name)


def sensitivities_of(
    floats, names: tuple[str, ...], outputs: Sequence[str | AbstractOutput]
) -> Sensitivities | None:
    """Return the sensitivities of requested peaks, or None if `names` is empty.

    - `floats`: outputs of the scenes by name, and their derivatives by the names that `slope_name` returns
    - `names`: names of the parameters
    - `outputs`: requested outputs
    """
    if not names:
        return None
    slopes = {name: slope_name(name) for name in variables_of(outputs)}
    return Sensitivities(names, {name: floats[slope] for name, slope in slopes.items() if slope in floats})


def slope_name(answer: str) -> str:
    """Return the name under which outputs and datasets hold the sensitivities of an answer."""
    return f"{answer}_sensitivity"


def scalar_fields(motion: AbstractExcitation) -> dict[str, str]:
    """Return a dict of the scalar parameters of a motion: name of the parameter → path of its field.

    A parameter has the name of its field, with the prefix `excitation.` if the structure has a parameter of
    this name. In a `GroundMotion`, the path of a field starts with `horizontal.` or `vertical.`. The name of
    a parameter starts with `vertical.` if it belongs to the vertical motion, and has no such prefix if it
    belongs to the horizontal motion.
    """
    if isinstance(motion, GroundMotion):
        components = {part: scalar_fields(getattr(motion, part)) for part in PARTS}
        fields = {name: f"horizontal.{field}" for name, field in components["horizontal"].items()}
        return fields | {
            f"vertical.{field}": f"vertical.{field}" for field in components["vertical"].values()
        }
    excluded = {*motion.own_dimensions, "which", "scale"}
    names = [field.name for field in dataclasses.fields(motion) if field.name not in excluded]
    scalars = [name for name in names if _is_float_array(getattr(motion, name))]
    return {f"excitation.{field}" if field in STRUCTURE else field: field for field in scalars}


def _is_float_array(value: Any) -> bool:
    return isinstance(value, jax.Array | np.ndarray) and jnp.issubdtype(value.dtype, jnp.floating)


def with_scalars(motion: AbstractExcitation, values: Mapping[str, Any]) -> AbstractExcitation:
    """Return the motion with other values of scalar parameters. The keys of `values` are paths of fields, as
    in `scalar_fields`."""
    for path, value in values.items():
        part, _, field = path.rpartition(".")
        if part:
            changed = dataclasses.replace(getattr(motion, part), **{field: value})
            motion = dataclasses.replace(motion, **{part: changed})
    fields = {path: value for path, value in values.items() if "." not in path}
    return dataclasses.replace(motion, **fields)


def check_sensitivities(
    owner: str, podium: Podium, motion: AbstractExcitation, names: Sequence[str]
) -> tuple[str, ...]:
    """Check the names of requested parameters, and return them as a tuple.

    - `owner`: name of the calling function, for messages
    - `podium`, `motion`: structure and ground motion of the scenes
    - `names`: requested parameters

    Raises `ValueError` for a name that is not a parameter of the structure or the motion, for a parameter
    without a derivative, for a name that occurs twice, and for two names of the same quantity, such as
    `alpha` and `tan_alpha`.
    """
    names = _checks.as_strings(owner, "sensitivities", names)
    if not names:
        return names
    check_parameters(owner, podium, names, more=[*scalar_fields(motion), "scale"])
    return names


def with_unit_factors(
    podium: Podium, motion: AbstractExcitation, names: Sequence[str], factors: Float[Array, " n"]
) -> tuple[Podium, AbstractExcitation]:
    """Return the structure and the ground motion with each named parameter multiplied by a factor of 1.

    - `podium`, `motion`: structure and ground motion of the scene
    - `names`: n parameters, as returned by `check_sensitivities`
    - `factors`: the factors, all equal to 1, shape (n,)

    The values stay exactly the same. The caller differentiates with respect to the factors, which gives the
    derivatives with respect to the logarithms of the parameters.
    """
    factor_of = dict(zip(names, factors, strict=True))
    fields = {
        field: factor_of.pop(name) for name, field in scalar_fields(motion).items() if name in factor_of
    }
    scale = factor_of.pop("scale", None)
    new_motion = with_scalars(
        motion, {path: y * operator.attrgetter(path)(motion) for path, y in fields.items()}
    )
    new_motion = new_motion if scale is None else new_motion.scaled(scale)
    new_podium = podium
    if factor_of:
        new_podium = with_factors(podium, list(factor_of), jnp.asarray(list(factor_of.values())))
    return _with_derivatives(podium, new_podium), _with_derivatives(motion, new_motion)


def _with_derivatives(original: Any, changed: Any) -> Any:
    """Return a tree with exactly the values of `original` and the derivatives of `changed`."""
    constant = jax.lax.stop_gradient
    return jax.tree.map(lambda y, z: y if z is y else y + (z - constant(z)), original, changed)
