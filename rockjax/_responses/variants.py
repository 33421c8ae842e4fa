"""Variants of a structure and a ground motion, with other values of named parameters."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from rockjax._checks import as_array, concrete
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import GroundMotion
from rockjax._excitations.pulses import AbstractPulse
from rockjax._motions.convert import AnyMotions, as_records, combine_motions, single_motions
from rockjax._motions.motion import Motion
from rockjax._motions.records import RecordPairs, Records
from rockjax._parameters.dimensions import parameters_of_dimensions, podium_of
from rockjax._parameters.registry import MOTION, STRUCTURE, Parameter, common_factor, find_clash
from rockjax._parameters.variants import (
    check_values,
    has_parameter,
    lists_of,
    parameters_of,
    pulse_acceleration,
    pulse_period,
    read,
    with_values,
)
from rockjax._structures import Dimensions, Podium

from .sensitivities import scalar_fields, with_scalars

# Largest ratio of a mass or stiffness of a story to its original value. A larger ratio means another unit.
MOST_RATIO = 100.0
# Dimensionless parameters of a pulse, which replace a_p or T_p.
_RATIOS = tuple(name for name, parameter in MOTION.items() if parameter.instead_of)


def labelled_motion(
    owner: str, excitation: AnyMotions, name: str = "excitation"
) -> tuple[AbstractExcitation, np.ndarray | None]:
    """Return (motion, labels). One motion has the labels None. Several motions become a batch of shape (k,)
    with k labels: the names of the motions, or numbers from 1 if any of them has no name.

    - `owner`: name of the calling function, for messages
    - `excitation`: one motion, or several (`Motions`, `Records` or a list)
    - `name`: name of the argument, for messages
    """
    if isinstance(excitation, Records) and excitation.which.ndim:
        records, _ = as_records(owner, excitation, name)
        return records, np.arange(1, len(records) + 1)
    if isinstance(excitation, AbstractExcitation | Motion):
        members, _ = single_motions(owner, excitation, name)
        return members[0], None
    members, names = single_motions(owner, excitation, name)
    labels = np.arange(1, len(members) + 1) if names is None else np.array(names)
    return combine_motions(owner, members, name), labels


def pick_motions(motions: AbstractExcitation, which: np.ndarray) -> AbstractExcitation:
    """Return the motions with the indices `which`, an array of any shape, from a batch of shape (k,).

    The indices may be floats with integer values, because a scan over scenes (`_boundaries/crossings.py`)
    passes all coordinates of the scenes as floats.
    """
    which = which.astype(np.int32)
    if isinstance(motions, Records | RecordPairs):
        return motions.pick(which)
    # NumPy saves time here, because JAX compiles a program for every shape.
    return jax.tree.map(lambda y: as_array(np.asarray(y)[which]), motions)


def structure_parameters(structure: Podium | Dimensions) -> dict[str, Parameter]:
    """Return the parameters of a structure that `with_parameters` can change, by name.

    For a podium, these are its parameters, `restitution` even if the podium has a law of restitution, and the
    attribute path of each list of values, such as `superstructure.masses`, for a factor on all its values. A
    structure by dimensions has these parameters and its own, which replace those of the same name.
    """
    podium = structure.podium() if isinstance(structure, Dimensions) else structure
    factors = {path: common_factor(path) for path in lists_of(podium)}
    found = parameters_of(podium) | {"restitution": STRUCTURE["restitution"]} | factors
    return found | (parameters_of_dimensions(structure) if isinstance(structure, Dimensions) else {})


def variable_parameters(
    structure: Podium | Dimensions, motion: AbstractExcitation, is_single: bool
) -> list[str]:
    """Return the names of the parameters that `with_parameters` can change.

    - `structure`, `motion`: the structure, and one motion or a batch of motions
    - `is_single`: whether `motion` is one motion
    """
    pulse = motion.horizontal if isinstance(motion, GroundMotion) else motion
    ratios = _RATIOS if isinstance(pulse, AbstractPulse) and is_single else ()
    return [*structure_parameters(structure), *(scalar_fields(motion) if is_single else {}), *ratios, "scale"]


def check_names(owner: str, argument: str, names: Sequence[str], valid: Sequence[str]) -> None:
    """Raise `ValueError` for a name that is not valid, and for two names of the same quantity.

    - `owner`, `argument`: names of the calling function and of its argument, for messages
    - `names`, `valid`: the given and the accepted names
    """
    for name in names:
        if name not in valid:
            similar = difflib.get_close_matches(str(name), valid, 1)
            hint = f"; did you mean {similar[0]!r}?" if similar else ""
            raise ValueError(
                f"{owner}: {argument} must each be one of {', '.join(valid)} for this structure and motion, "
                f"got {name!r}{hint}"
            )
    clash = find_clash(names)
    if clash is not None:
        raise ValueError(f"{owner}: {clash[0]} and {clash[1]} describe the same quantity; give one of them")


def with_parameters(
    owner: str, structure: Podium | Dimensions, motion: AbstractExcitation, values: Mapping[str, Any]
) -> tuple[Podium, AbstractExcitation]:
    """Return a podium and a motion with other values of parameters.

    - `owner`: name of the calling function, for messages
    - `structure`: the structure
    - `motion`: one motion, or a batch of motions
    - `values`: arrays whose shapes broadcast with each other, by parameter name (see `variable_parameters`).
      Parameters of a podium are set after those of a structure by dimensions, so they replace what follows
      from dimensions and masses

    Raises `ValueError` for values out of range.
    """
    parameters = structure_parameters(structure)
    structure_values = {name: values[name] for name in parameters if name in values}
    check_values(owner, structure_values, parameters)
    check_values(owner, {name: values[name] for name in _RATIOS if name in values})
    if isinstance(structure, Dimensions):
        own = [name for name in parameters_of_dimensions(structure) if name in values]
        structure = podium_of(structure, {name: structure_values.pop(name) for name in own})
    podium = _podium_with(owner, structure, structure_values)
    changes: dict[str, Any] = {
        field: values[name] for name, field in scalar_fields(motion).items() if name in values
    }
    component = "horizontal." if isinstance(motion, GroundMotion) else ""
    if "acceleration_ratio" in values:
        changes[f"{component}a_p"] = pulse_acceleration(podium, values["acceleration_ratio"])
    if "frequency_ratio" in values:
        changes[f"{component}T_p"] = pulse_period(podium.p, values["frequency_ratio"])
    motion = with_scalars(motion, changes)
    return podium, motion.scaled(values["scale"]) if "scale" in values else motion


def _podium_with(owner: str, podium: Podium, values: Mapping[str, Any]) -> Podium:
    """Return a podium with other values of parameters. A law of restitution is replaced by the factor in
    `values`. Factors on lists multiply the other values."""
    if "restitution" in values and not has_parameter(podium, STRUCTURE["restitution"]):
        podium = podium.replace(restitution=1.0)
    for name, value in values.items():
        if name.startswith(("story_mass_", "story_stiffness_")):
            _check_is_ratio(owner, name, value, read(podium, name))
    lists = lists_of(podium)
    podium = with_values(podium, {name: y for name, y in values.items() if name not in lists})
    scaled = {
        number: read(podium, number) * values[path]
        for path, numbers in lists.items()
        if path in values
        for number in numbers
    }
    return with_values(podium, scaled)


def _check_is_ratio(owner: str, name: str, value: Any, original: Any) -> None:
    """Raise `ValueError` if the mass or stiffness of a story in a podium seems to be in kg or N/m."""
    value, original = concrete(value), concrete(original)
    if value is None or original is None or np.all(value <= MOST_RATIO * original):
        return
    kind = "mass m/(N m_c) [–]" if name.startswith("story_mass_") else "stiffness k/(N m_c) [1/s²]"
    raise ValueError(
        f"{owner}: {name} of a rockjax.Podium is the {kind}, in this podium "
        f"{float(np.ravel(original)[0]):.4g}, got {float(np.max(value)):g}; for kg and N/m give an "
        "optimise.Dimensions, or a problem file with a structure by dimensions"
    )
