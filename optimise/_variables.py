"""Design variables: parameters of a podium, or dimensions and masses, scaled to [0, 1] between their bounds.

Unscaled values are in the unit of the parameter, such as m or rad.
"""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Iterator, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import rockjax as rj
from rockjax._parameters import variants
from rockjax._parameters.dimensions import (
    changed_fields,
    entry_of_list,
    lists_of_dimensions,
    parameters_of_dimensions,
)
from rockjax._parameters.registry import Parameter, find_clash, numbered_parameter
from rockjax._structures.dimensions import Dimensions
from rockjax.internal import DIMENSIONS, Module, array_module, as_float, displayed, find_parameter

LOG_RATIO = 10.0  # a positive range is scaled logarithmically if highest/lowest is above this ratio


Structure = rj.Podium | Dimensions


def as_podium(structure: Structure) -> rj.Podium:
    """Return the podium of a structure, a `rockjax.Podium` or an `optimise.Dimensions`."""
    with _without_unit_warnings():
        return structure if isinstance(structure, rj.Podium) else structure.podium()


@contextlib.contextmanager
def _without_unit_warnings() -> Iterator[None]:
    """Suppress warnings about units, which are useful only for values that a user has typed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rj.PlausibilityWarning)
        yield


class Variables(Module):
    """The varied parameters of a structure, scaled to x in [0, 1]ⁿ.

    - `base`: the structure, which gives the parameters that do not vary
    - `lower`, `upper`: unscaled bounds (n,); `names`: names of the variables, in the order of x
    - `logarithmic`: for each variable, whether it is scaled by its logarithm
    """

    base: Structure
    lower: Float[Array, " n"]
    upper: Float[Array, " n"]
    names: tuple[str, ...] = eqx.field(static=True)
    logarithmic: tuple[bool, ...] = eqx.field(static=True)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the variables; "–" for ratios."""
        return tuple(displayed(parameter(self.base, name).unit) for name in self.names)

    def values(self, x: Float[Array, " n"] | np.ndarray) -> Float[Array, " n"]:
        """Return the unscaled variables (n,) at x; the entries 0 and 1 of x give exactly the bounds."""
        is_log, xp = np.asarray(self.logarithmic), array_module(self, x)
        lower, upper = xp.asarray(self.lower), xp.asarray(self.upper)
        log_lower, log_upper = (xp.log(xp.where(is_log, bound, 1.0)) for bound in (lower, upper))
        exponential = xp.exp(log_lower * (1 - x) + log_upper * x)
        values = xp.where(is_log, exponential, lower * (1 - x) + upper * x)
        # Rounding may move values out of the bounds. The clip is not differentiated, because its derivative
        # at a bound is ½.
        clipped = xp.clip(values, lower, upper)
        return clipped if xp is np else values + jax.lax.stop_gradient(clipped - values)

    def scaled(self, values: Float[Array, " n"]) -> Float[Array, " n"]:
        """Return the scaled variables (n,) of unscaled values (n,), which are first clipped to the bounds."""
        is_log, xp = np.asarray(self.logarithmic), array_module(self, values)
        lower, upper = xp.asarray(self.lower), xp.asarray(self.upper)
        values = xp.clip(values, lower, upper)
        log_lower, log_upper, logs = (xp.log(xp.where(is_log, v, 1.0)) for v in (lower, upper, values))
        span = xp.where(is_log, log_upper - log_lower, upper - lower)
        return xp.where(is_log, logs - log_lower, values - lower) / span

    def structure(self, x: Float[Array, " n"] | np.ndarray) -> Structure:
        """Return the structure at scaled variables x, of the same type as `base`."""
        values = self.values(x)
        # Values are 0-d arrays, as in a traced structure. As Python numbers, 0 would remove a device from the
        # podium, and an exponent 1 would be a constant of compiled programs.
        return with_variables(self.base, {name: values[k, ...] for k, name in enumerate(self.names)})

    def podium(self, x: Float[Array, " n"] | np.ndarray) -> rj.Podium:
        """Return the podium at scaled variables x."""
        return as_podium(self.structure(x))

    def start(self) -> Float[Array, " n"]:
        """Return the scaled variables (n,) of the base structure, clipped to the bounds."""
        values = [as_float(value_of(self.base, name)) for name in self.names]
        return self.scaled(array_module(values).stack(values))


def make_variables(
    base: Structure, vary: Mapping[str, tuple[float, float]], owner: str = "design"
) -> Variables:
    """Return the variables of a structure. `vary` is name → (lowest, highest), unscaled. Raises `ValueError`
    for a structure with arrays of parameters, for an empty `vary`, for unknown names, for two names of the
    same quantity, and for bounds that are not a range or that define no valid structure."""
    if not isinstance(base, Structure):
        raise ValueError(f"{owner}: podium must be a rockjax.Podium or an optimise.Dimensions, got {base!r}")
    if not isinstance(vary, Mapping) or not vary:
        raise ValueError(
            f'{owner}: vary must name at least one variable with its bounds, e.g. {{"alpha": (0.1, 0.2)}}'
        )
    shapes = {jnp.shape(leaf) for leaf in jax.tree.leaves(as_podium(base).split_rows())} - {()}
    if shapes:
        raise ValueError(
            f"{owner}: podium must be a single podium with scalar parameters, got arrays of shape "
            f"{', '.join(map(str, sorted(shapes)))}"
        )
    for name in vary:
        _check_name(owner, base, name)
    names = tuple(vary)
    parameter_names = [parameter(base, name).name for name in names]
    repeated = [name for name in parameter_names if parameter_names.count(name) > 1]
    if repeated:
        raise ValueError(f"{owner}: vary names {repeated[0]} twice; leave one of them out")
    clash = find_clash(parameter_names)
    if clash is not None:
        raise ValueError(
            f"{owner}: vary names {clash[0]} and {clash[1]}, which describe the same dimension; vary one "
            "of them"
        )
    bounds = []
    for name, pair in vary.items():
        low, high = as_bounds(owner, name, pair)
        if not low < high:
            raise ValueError(f"{owner}: vary[{name!r}] must have lowest < highest, got ({low}, {high})")
        for bound in (low, high):
            try:
                with_variables(base, {name: bound})
            except ValueError as error:
                raise ValueError(
                    f"{owner}: vary[{name!r}] = ({low}, {high}) exceeds the admissible range: {error}"
                ) from None
        bounds.append((low, high))
    lower, upper = (as_float(np.array(column)) for column in zip(*bounds, strict=True))
    logarithmic = tuple(is_logarithmic(low, high) for low, high in bounds)
    return Variables(numbers_as_arrays(base), lower, upper, names, logarithmic)


def is_logarithmic(low: float, high: float) -> bool:
    """Return whether a variable with these bounds is scaled by its logarithm."""
    return low > 0 and high / low > LOG_RATIO


def as_bounds(owner: str, name: str, pair: Any) -> tuple[float, float]:
    """Return the bounds of a variable as floats. Raises `ValueError`, with `owner` in the message, unless
    `pair` is two finite numbers."""
    try:
        low, high = map(float, as_float(pair).tolist())
    except (TypeError, ValueError):
        raise ValueError(
            f"{owner}: vary[{name!r}] must be a pair (lowest, highest) of numbers, got {pair!r}"
        ) from None
    if not (math.isfinite(low) and math.isfinite(high)):
        raise ValueError(f"{owner}: vary[{name!r}] must be finite, got ({low}, {high})")
    return low, high


def numbers_as_arrays(base: Structure) -> Structure:
    """Turn the Python numbers of an `optimise.Dimensions`, which compiled programs contain as constants, into
    arrays, so that other values need no other compilation. Zeros stay Python numbers, because a zero may mean
    that a component is absent: a top mass of 0 means no superstructure."""
    if isinstance(base, rj.Podium):
        return base
    is_unchanged = lambda y: isinstance(y, str) or array_module(y).all(y == 0)
    return jax.tree.map(lambda y: y if is_unchanged(y) else as_float(y), base)


def _check_name(owner: str, base: Structure, name: str) -> None:
    """Raise `ValueError` unless `name` denotes a parameter of the structure that can vary."""
    if isinstance(base, Dimensions):
        _check_dimension(owner, base, name)
        return
    entry = find_parameter(str(name))
    if entry is None:
        hint = " (masses and dimensions vary with an optimise.Dimensions)" if name in DIMENSIONS else ""
        available = ", ".join(variants.parameters_of(base))
        raise ValueError(
            f"{owner}: vary names {name!r}{hint}; parameters of this podium that can vary are {available}"
        )
    if variants.has_parameter(base, entry):
        return
    if entry.name == "restitution":
        raise ValueError(_law_message(owner, base.restitution))
    if entry.attribute_path.startswith("restrainers."):
        device = entry.attribute_path.split(".")[1]
        raise ValueError(
            f"{owner}: vary names {name!r}, which needs exactly one {device} among the podium's restrainers"
        )
    superstructure = base.superstructure
    description = (
        "no superstructure"
        if superstructure is None
        else f"a {type(superstructure).__name__} superstructure, which has no such parameter"
    )
    raise ValueError(f"{owner}: vary names {name!r}, but the podium has {description}")


def _check_dimension(owner: str, base: Dimensions, name: str) -> None:
    """Raise `ValueError` unless `name` denotes a dimension that can vary."""
    names = [y for y in parameters_of_dimensions(base) if y not in lists_of_dimensions(base)]
    is_elastic = base.period is not None or base.story_masses is not None
    if name == "restitution" and isinstance(base.restitution, str):
        raise ValueError(_law_message(owner, base.restitution))
    if name == "period" and not is_elastic:
        raise ValueError(
            f"{owner}: vary names 'period', but the superstructure is rigid or absent; give it a period"
        )
    if name == "damping" and not is_elastic:
        raise ValueError(
            f"{owner}: vary names 'damping', but the podium has no elastic superstructure; give it a period"
        )
    if name not in names:
        raise ValueError(f"{owner}: vary names {name!r}; dimensions that can vary are {', '.join(names)}")
    if name == "top_mass" and array_module(base.top_mass).all(base.top_mass == 0):
        raise ValueError(f"{owner}: vary names 'top_mass', but top_mass = 0; give a top_mass to start from")


def _law_message(owner: str, law) -> str:
    return (
        f"{owner}: vary names 'restitution', but the restitution of the podium is the law {law!r}; give it a "
        "factor in [0, 1]"
    )


def parameter(base: Structure, name: str) -> Parameter:
    """Return the parameter that the name of a variable denotes. Raises `KeyError` for an unknown name."""
    if isinstance(base, Dimensions):
        numbered = entry_of_list(name)
        return DIMENSIONS[name] if numbered is None else numbered_parameter(*numbered)
    entry = find_parameter(name)
    if entry is None:
        raise KeyError(name)
    return entry


def value_of(base: Structure, name: str):
    """Return the unscaled value of a variable in a structure."""
    if not isinstance(base, Dimensions):
        return variants.read(base, name)
    numbered = entry_of_list(name)
    if numbered is None:
        return getattr(base, name)
    entry, position = numbered
    return getattr(base, entry.attribute_path)[position - 1]


def with_variables(base: Structure, values: Mapping[str, Any]) -> Structure:
    """Return a variant of a structure in which some variables have other (unscaled) values."""
    if not isinstance(base, Dimensions):
        return variants.with_values(base, values)
    with _without_unit_warnings():
        return base.replace(**changed_fields(base, values))
