"""Variants of a structure and a ground motion, with other values of named parameters."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from rockjax._checks import as_array
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import GroundMotion
from rockjax._excitations.pulses import AbstractPulse
from rockjax._motions.convert import AnyMotions, as_records, combine_motions, single_motions
from rockjax._motions.motion import Motion
from rockjax._motions.records import RecordPairs, Records
from rockjax._parameters.registry import MOTION, find_clash
from rockjax._parameters.variants import (
    check_values,
    parameters_of,
    pulse_acceleration,
    pulse_period,
    with_values,
)
from rockjax._structures import Podium

from .sensitivities import scalar_fields, with_scalars

_HINTS = {"restitution": "; restitution can vary only in a podium with a factor, such as restitution=0.9"}
# Dimensionless parameters of a pulse, which replace a_p or T_p.
_RATIOS = tuple(name for name, parameter in MOTION.items() if parameter.instead_of)


def labelled_motion(
    owner: str, excitation: AnyMotions, name: str = "excitation"
) -> tuple[AbstractExcitation, np.ndarray | None]:
    """Return (motion, labels). One motion has the labels None. Several motions become a batch of shape (k,)
    with k labels: the names of the motions, or numbers from 1 if the motions have no names.

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


def variable_parameters(podium: Podium, motion: AbstractExcitation, is_single: bool) -> list[str]:
    """Return the names of the parameters that `with_parameters` can change.

    - `podium`, `motion`: the structure, and one motion or a batch of motions
    - `is_single`: whether `motion` is one motion
    """
    pulse = motion.horizontal if isinstance(motion, GroundMotion) else motion
    ratios = _RATIOS if isinstance(pulse, AbstractPulse) and is_single else ()
    return [*parameters_of(podium), *(scalar_fields(motion) if is_single else {}), *ratios, "scale"]


def check_names(owner: str, argument: str, names: Sequence[str], valid: Sequence[str]) -> None:
    """Raise `ValueError` for a name that is not valid, and for two names of the same quantity.

    - `owner`, `argument`: names of the calling function and of its argument, for messages
    - `names`, `valid`: the given and the accepted names
    """
    for name in names:
        if name not in valid:
            similar = difflib.get_close_matches(str(name), valid, 1)
            hint = f"; did you mean {similar[0]!r}?" if similar else _HINTS.get(name, "")
            raise ValueError(
                f"{owner}: {argument} must each be one of {', '.join(valid)} for this podium and motion, got "
                f"{name!r}{hint}"
            )
    clash = find_clash(names)
    if clash is not None:
        raise ValueError(f"{owner}: {clash[0]} and {clash[1]} describe the same quantity; give one of them")


def with_parameters(
    owner: str, podium: Podium, motion: AbstractExcitation, values: Mapping[str, Any]
) -> tuple[Podium, AbstractExcitation]:
    """Return a podium and a motion with other values of parameters.

    - `owner`: name of the calling function, for messages
    - `podium`: the structure
    - `motion`: one motion, or a batch of motions
    - `values`: arrays whose shapes broadcast with each other, by parameter name (see `variable_parameters`)

    Raises `ValueError` for values out of range.
    """
    podium_values = {name: values[name] for name in parameters_of(podium) if name in values}
    check_values(owner, podium_values)
    check_values(owner, {name: values[name] for name in _RATIOS if name in values})
    podium = with_values(podium, podium_values)
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
