"""Labelled grids of scenes: structures and ground motions that vary along named axes.

A scene is one structure under one ground motion.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from rockjax._checks import as_axis, require_instance
from rockjax._excitations.base import AbstractExcitation
from rockjax._motions.convert import AnyMotions
from rockjax._motions.provenance import describe_motions
from rockjax._responses.variants import (
    check_names,
    labelled_motion,
    pick_motions,
    structure_parameters,
    variable_parameters,
    with_parameters,
)
from rockjax._structures import Dimensions, Podium


class Coords(dict[str, np.ndarray]):
    """Labels along each axis of a grid, by name of the axis.

    - `motions`: attributes that describe the motions of the grid, see `describe_motions`
    - `attributes`: attributes of the labels, such as their unit, by name of the axis
    """

    motions: dict[str, Any]
    attributes: dict[str, dict[str, str]]


class Grid(NamedTuple):
    """All combinations of values along named axes.

    The first two fields are arguments of [`rockjax.peak_responses`][], all three are arguments of
    [`rockjax.sweep`][].

    - `structures`, `excitations`: a podium and a motion whose parameters broadcast to the shape of the grid
    - `coords`: name of each axis → labels along the axis, in the order of the axes
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
        axes = (f"{name}: {_describe_labels(labels)}" for name, labels in self.coords.items())
        return "\n  ".join([f"Grid of {self.size} scenes", *axes])


def _describe_labels(labels: np.ndarray) -> str:
    ends = [f"{y:.6g}" if labels.dtype.kind == "f" else str(y) for y in (labels[0], labels[-1])]
    return f"{len(labels)} × {ends[0]}" if len(labels) == 1 else f"{len(labels)} from {ends[0]} to {ends[1]}"


def grid(structure: Podium | Dimensions, excitation: AnyMotions, **axes: Float[ArrayLike, " _"]) -> Grid:
    """Return a grid of scenes over named axes. The axes have the order of the arguments. Call this function
    outside jit.

    - `structure`: a single podium, or an [`optimise.Dimensions`][], whose parameters the axes vary
    - `excitation`: a pulse, wavelet or record; or several motions (`Motions`, `Records`, a list), which
      form the first axis `motion`, labelled by their names; a pulse is named by its class
      and parameters, such as `Ricker(3, 0.7)`. Motions without names have numbers from 1
    - `axes`: values along each axis, shape (n,). Their names are

        - parameters of the podium: `alpha`, `tan_alpha`, `width`, `height`, `R`, `gamma`, `lam`, `g`, `eta`,
          `T_s`, `zeta`, `story_mass_1` = m/(N m_c) [–], `story_stiffness_1` = k/(N m_c) [1/s²], …, and
          `restitution`, which replaces a law by a factor
        - of an `optimise.Dimensions` also its numbers, such as `column_mass` and `top_mass` [kg], `period`
          [s], `damping` [–] and `position_1` [m]. Its `story_mass_1` is in kg, and its `story_stiffness_1` in
          N/m. Ratios such as `gamma` replace the ratio that follows from the masses
        - lists: the value is a factor on all numbers of the list. For a podium they are named by their place,
          as in `superstructure.stiffnesses`, for an `optimise.Dimensions` by their field, as in
          `story_stiffnesses`
        - `scale`, a factor on the motion (on both components of a [`rockjax.GroundMotion`][])
        - parameters of a single motion, such as `a_p`, `T_p`, `f_p`. If the podium has a parameter of the
          same name, the prefix `excitation.` is needed, as in `excitation.gamma`. Parameters of the vertical
          component of a `GroundMotion` have the prefix `vertical.`, as in `vertical.a_p`
        - `acceleration_ratio` = a_p/(g tan α) and `frequency_ratio` = ω_p/p of a single pulse, with
          ω_p = 2π/T_p

    Names with a dot are given as `**{"excitation.gamma": …}`. Axes broadcast, so a grid of 10⁸ scenes takes
    no more memory than the values along its axes.

    Raises `ValueError` for a batch of podiums, for unknown or contradictory names, and for values that are
    not one-dimensional or outside their ranges. Masses and stiffnesses of stories of a podium that are more
    than 100 times larger than in the podium count as out of range, because they seem to be in kg or N/m.
    """
    accepted = "a rockjax.Podium or an optimise.Dimensions"
    require_instance("grid", "structure", structure, Podium | Dimensions, accepted)
    # Values for each mode, story or column become scalars; an array that remains is a batch of podiums.
    podium = (structure.podium() if isinstance(structure, Dimensions) else structure).split_rows()
    structure = structure if isinstance(structure, Dimensions) else podium
    shapes = {jnp.shape(y) for y in jax.tree.leaves(podium)} - {()}
    if shapes:
        raise ValueError(
            f"grid: structure must be a single podium, got arrays of shape {shapes}; give the values as axes"
        )
    motion, labels = labelled_motion("grid", excitation)
    coords = Coords({} if labels is None else {"motion": labels})
    coords.motions = describe_motions(excitation)
    for name, values in axes.items():
        coords[name] = as_axis("grid", name, values)
    parameters = structure_parameters(structure)
    coords.attributes = {name: parameters[name].variable_attributes for name in axes if name in parameters}
    check_names("grid", "axes", tuple(axes), variable_parameters(structure, motion, labels is None))
    axis_values = {
        name: values.reshape(tuple(-1 if k == j else 1 for k in range(len(coords))))
        for j, (name, values) in enumerate(coords.items())
    }
    if labels is not None:
        shape = axis_values.pop("motion").shape
        motion = pick_motions(motion, np.arange(len(labels)).reshape(shape))
    podium, motion = with_parameters("grid", structure, motion, axis_values)
    return Grid(podium.split_rows(), motion, coords)
