"""Labelled grids of scenes: structures and ground motions that vary along named axes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from rockjax._checks import as_float, require_instance
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import GroundMotion
from rockjax._excitations.pulses import AbstractPulse
from rockjax._motions.convert import AnyMotions, as_records, combine_motions, single_motions
from rockjax._motions.motion import Motion
from rockjax._motions.records import RecordPairs, Records
from rockjax._parameters.table import MOTION, find_clash
from rockjax._parameters.variants import (
    check_values,
    parameters_of,
    pulse_acceleration,
    pulse_period,
    with_values,
)
from rockjax._responses.sensitivities import number_fields, with_numbers
from rockjax._structures import Podium

Coords = dict[str, np.ndarray]


class Grid(NamedTuple):
    """All combinations of values along named axes.

    Its first two fields are arguments of [`rockjax.peak_responses`][]; all three are arguments of
    [`rockjax.sweep`][].

    - `structures`, `excitations`: a podium and a motion whose parameters broadcast to the shape of the grid
    - `coords`: labels of each axis, in the order of the axes
    """

    structures: Podium
    excitations: AbstractExcitation
    coords: Coords

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of scenes along each axis."""
        return tuple(len(labels) for labels in self.coords.values())

    @property
    def size(self) -> int:
        """Number of scenes."""
        return math.prod(self.shape)

    def __repr__(self) -> str:
        axes = (f"{name}: {_span(labels)}" for name, labels in self.coords.items())
        return "\n  ".join([f"Grid of {self.size} scenes", *axes])


def _span(labels: np.ndarray) -> str:
    ends = [f"{y:.6g}" if labels.dtype.kind == "f" else str(y) for y in (labels[0], labels[-1])]
    return f"{len(labels)} × {ends[0]}" if len(labels) == 1 else f"{len(labels)} from {ends[0]} to {ends[1]}"


def grid(structure: Podium, excitation: AnyMotions, **axes: Float[ArrayLike, " _"]) -> Grid:
    """Return a grid of scenes over named axes, in the order of the arguments (host).

    - `structure`: podium with scalar parameters; the scenes are variants of it
    - `excitation`: a pulse, wavelet or record; or several motions (`Motions`, `Records`, a list), which
      form the first axis `motion`
    - `axes`: values along each axis, shape (n,). Their names are

        - parameters of the podium: `alpha`, `tan_alpha`, `width`, `height`, `R`, `gamma`, `lam`, `g`, `eta`,
          `T_s`, `zeta`, …, and `restitution` if it is a given factor
        - `scale`, a factor on the motion (on both components of a [`rockjax.GroundMotion`][])
        - parameters of a single motion, such as `a_p`, `T_p`, `f_p`. If the podium has a parameter of the
          same name: `excitation.gamma`. For the vertical component of a `GroundMotion`: `vertical.a_p`
        - `acceleration_ratio` = a_p/(g tan α) and `frequency_ratio` = ω_p/p of a single pulse

    Names with a dot are given as `**{"excitation.gamma": …}`. Axes are broadcast, so a grid of 10⁸ scenes
    takes no more memory than its axes.

    Raises `ValueError` for a podium that contains arrays, for unknown or contradictory names, and for values
    that are not one-dimensional or outside their ranges.
    """
    require_instance("grid", "structure", structure, Podium, "a rockjax.Podium")
    shapes = {jnp.shape(y) for y in jax.tree.leaves(structure)} - {()}
    if shapes:
        raise ValueError(
            f"grid: structure must have scalar parameters, got arrays of shape {shapes}; give them as axes"
        )
    motion, labels = _as_motion(excitation)
    coords: Coords = {} if labels is None else {"motion": labels}
    for name, values in axes.items():
        values = np.asarray(as_float(values, f"grid: {name}"))
        if values.ndim != 1 or not len(values):
            raise ValueError(
                f"grid: {name} must be one-dimensional with at least one value, got shape {values.shape}"
            )
        coords[name] = values
    _check_names(structure, motion, tuple(axes), single=labels is None)
    axis_values = {
        name: values.reshape(tuple(-1 if k == j else 1 for k in range(len(coords))))
        for j, (name, values) in enumerate(coords.items())
    }
    if labels is not None:
        shape = axis_values.pop("motion").shape
        if isinstance(motion, Records | RecordPairs):
            motion = motion.pick(np.arange(len(labels), dtype=np.int32).reshape(shape))
        else:
            motion = jax.tree.map(lambda y: y.reshape(shape), motion)
    podium_values = {name: axis_values[name] for name in parameters_of(structure) if name in axis_values}
    check_values("grid", podium_values)
    podium = with_values(structure, podium_values)
    return Grid(podium, _vary_motion(motion, podium, axis_values), coords)


def _as_motion(excitation) -> tuple[AbstractExcitation, np.ndarray | None]:
    """Return a motion and None, or a batch of motions and the labels of its axis `motion`."""
    if isinstance(excitation, Records) and excitation.which.ndim:
        records, _ = as_records("grid", excitation, "excitation")
        return records, np.arange(len(records))
    if isinstance(excitation, AbstractExcitation | Motion):
        members, _ = single_motions("grid", excitation, "excitation")
        return members[0], None
    members, names = single_motions("grid", excitation, "excitation")
    labels = np.arange(len(members)) if names is None else np.array(names)
    return combine_motions("grid", members, "excitation"), labels


_RATIOS = tuple(name for name, parameter in MOTION.items() if parameter.instead_of)


def _check_names(structure: Podium, motion: AbstractExcitation, names: Sequence[str], single: bool) -> None:
    motion_parameters = number_fields(motion) if single else {}
    pulse = motion.horizontal if isinstance(motion, GroundMotion) else motion
    ratios = _RATIOS if isinstance(pulse, AbstractPulse) and single else ()
    valid = [*parameters_of(structure), *motion_parameters, *ratios, "scale"]
    for name in names:
        if name not in valid:
            raise ValueError(
                f"grid: axes must be some of {', '.join(valid)} for this podium and motion, got {name!r}"
            )
    clash = find_clash(names)
    if clash is not None:
        raise ValueError(
            f"grid: {clash[0]} and {clash[1]} describe the same quantity; give one of them as an axis"
        )


def _vary_motion(
    base: AbstractExcitation, podium: Podium, axis_values: dict[str, np.ndarray]
) -> AbstractExcitation:
    changes: dict[str, Any] = {
        field: axis_values[name] for name, field in number_fields(base).items() if name in axis_values
    }
    check_values("grid", {name: axis_values[name] for name in _RATIOS if name in axis_values})
    component = "horizontal." if isinstance(base, GroundMotion) else ""
    if "acceleration_ratio" in axis_values:
        changes[f"{component}a_p"] = pulse_acceleration(podium, axis_values["acceleration_ratio"])
    if "frequency_ratio" in axis_values:
        changes[f"{component}T_p"] = pulse_period(podium.p, axis_values["frequency_ratio"])
    motion = with_numbers(base, changes)
    return motion.scaled(axis_values["scale"]) if "scale" in axis_values else motion
