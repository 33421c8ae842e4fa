"""Answers of light secondary systems (blocks and oscillators) on the floors of a structure, and their rows in
tables and datasets. (L6) and (L15) are in docs/equations.md."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from rockjax import _results as results
from rockjax._parameters.registry import as_variable
from rockjax._results import RESULTS
from rockjax._tree import Module


class ContentsAnswer(Module):
    """The answers of [`rockjax.Contents`][], a block with the rotation φ [rad] and the slenderness α_c [rad].

    - `peak_rotation`: max|φ|/α_c, at most the `overturn_ratio` of the block [–]; `peak_rotation_time`: time
      at which this rotation is first reached [s]
    - `margin`: overturning margin of the block [–], as in [`rockjax.Peak`][]: 1 if the block never rocks,
      negative if it overturns; NaN if the `overturn_ratio` of the block is above 1, because a block that is
      rotated beyond α_c may still return
    - `uplifted`: True if the block rocks; `uplift_time`: time at which it first starts to rock [s], NaN if it
      never rocks; `started_by_impulse`: True if an impact of the structure started
      the block
    - `overturned`: True if |φ| reached `overturn_ratio`·α_c; `overturn_time`: time of overturning [s], NaN if
      the block did not overturn
    - `impacts`: number of impacts of the block on the floor
    - `friction_demand`: largest |T|/N with the horizontal force T and the vertical force N at the foot of the
      block [–], (L15), at rest, while rocking, at impacts on the floor and at velocity jumps of the floor;
      inf if the foot would lift off
    - `until_overturning`: True if the structure overturned; the answers then cover the time until it did
    - `result`: result of the block, a [`rockjax.RESULTS`][]. If the scene of the structure did not finish,
      `result` is that of the structure, and all numbers except `impacts` are NaN
    """

    peak_rotation: Float[Array, "*batch"]
    peak_rotation_time: Float[Array, "*batch"]
    margin: Float[Array, "*batch"]
    uplifted: Bool[Array, "*batch"]
    uplift_time: Float[Array, "*batch"]
    started_by_impulse: Bool[Array, "*batch"]
    overturned: Bool[Array, "*batch"]
    overturn_time: Float[Array, "*batch"]
    impacts: Int[Array, "*batch"]
    friction_demand: Float[Array, "*batch"]
    until_overturning: Bool[Array, "*batch"]
    result: RESULTS


class OscillatorAnswer(Module):
    """The answers of an [`rockjax.Oscillator`][], (L6).

    The answers cover the time up to the end of the scene. If the floor rests for good, they also cover the
    free vibration of the oscillator after the end. The oscillator has the frequency ω = 2π/period [rad/s],
    the damping ratio ζ, and the displacement x relative to the floor [m].

    - `relative_displacement`: S_d = max|x| [m]
    - `pseudo_acceleration`: PSA = ω²S_d [m/s²]
    - `absolute_acceleration`: S_a = max|2ζωẋ + ω²x| [m/s²]; the values just before and just after velocity
      jumps of the floor count as well
    - `remaining_ratio`: upper bound of |x| after the end of the scene, divided by S_d [–]; inf if no bound is
      known. S_d is final if this ratio is at most 1
    - `until_overturning`: True if the structure overturned; the answers then cover the time until it did
    - `result`: result of the oscillator, a [`rockjax.RESULTS`][]. If the scene of the structure did not
      finish, `result` is that of the structure, and the numbers are NaN
    """

    relative_displacement: Float[Array, "*batch"]
    pseudo_acceleration: Float[Array, "*batch"]
    absolute_acceleration: Float[Array, "*batch"]
    remaining_ratio: Float[Array, "*batch"]
    until_overturning: Bool[Array, "*batch"]
    result: RESULTS


# For each class of answers: its dim in datasets, which is also the prefix of its variables; and the unit and
# description of each variable.
VARIABLES: dict[type, tuple[str, dict[str, tuple[str, str]]]] = {
    ContentsAnswer: (
        "contents",
        {
            "peak_rotation": ("1", "peak rotation of the block max|φ|/α_c"),
            "peak_rotation_time": ("s", "time of the peak rotation of the block"),
            "margin": ("1", "overturning margin of the block"),
            "uplifted": ("1", "the block rocks"),
            "uplift_time": ("s", "time at which the block starts to rock"),
            "started_by_impulse": ("1", "an impact of the structure started the block"),
            "overturned": ("1", "the block overturned"),
            "overturn_time": ("s", "time at which the block overturned"),
            "impacts": ("1", "impacts of the block on its floor"),
            "friction_demand": ("1", "largest friction demand |T|/N at the foot of the block"),
        },
    ),
    OscillatorAnswer: (
        "oscillator",
        {
            "relative_displacement": ("m", "largest displacement of the oscillator relative to its floor"),
            "pseudo_acceleration": ("m s-2", "pseudo-acceleration of the oscillator"),
            "absolute_acceleration": ("m s-2", "largest absolute acceleration of the oscillator"),
            "remaining_ratio": (
                "1",
                "bound of |x| after the end of the scene, divided by max|x|; max|x| is final if at most 1",
            ),
        },
    ),
}


def floor_variables(answers: Sequence[Any], dims: tuple[str, ...]) -> dict[str, Any]:
    """Return the variables of a dataset for secondary systems on floors. Variables of blocks, such as
    `contents_peak_rotation`, have the last dim `contents`; variables of oscillators, such as
    `oscillator_pseudo_acceleration`, have the last dim `oscillator`.

    - `answers`: answers for one scene or a batch, in the order in which the systems were given
    - `dims`: dims of the scenes; empty if the caller adds these dims
    """
    data: dict[str, Any] = {}
    for answer_class, (dim, variables) in VARIABLES.items():
        members = [answer for answer in answers if isinstance(answer, answer_class)]
        if not members:
            continue
        stacked = lambda read, members=members: np.stack([np.asarray(read(y)) for y in members], axis=-1)
        for name, (unit, description) in variables.items():
            values = stacked(lambda y, name=name: getattr(y, name))
            data[f"{dim}_{name}"] = as_variable((*dims, dim), values, unit, description)
        code = stacked(lambda y: results.code_of(y.result)).astype(np.int8)
        result = as_variable((*dims, dim), code, "1", f"result of the {dim}", **results.FLAGS)
        data[f"{dim}_result"] = result
    return data


def floor_rows(answers: Sequence[Any]) -> Iterator[tuple[str, str]]:
    """Yield rows (label, value) about secondary systems on floors, for the printed table of a scene."""
    for k, answer in enumerate(answers, 1):
        code = int(results.code_of(answer.result))
        is_block = isinstance(answer, ContentsAnswer)
        if results.did_not_finish(code):
            value = results.NAMES[code]
        elif is_block:
            value = _block_in_words(answer)
        else:
            later = ", may still grow after the end" if answer.remaining_ratio > 1 else ""
            sizes = float(answer.pseudo_acceleration), float(answer.relative_displacement)
            value = f"{sizes[0]:.6g} m/s², {sizes[1]:.6g} m{later}"
        yield f"{'block' if is_block else 'oscillator'} {k}", value


def _block_in_words(answer: ContentsAnswer) -> str:
    friction = f"friction demand {float(answer.friction_demand):.4g}"
    if not answer.uplifted:
        return f"never rocks, {friction}"
    if answer.overturned:
        return f"overturned at {float(answer.overturn_time):.6g} s, {friction}"
    peak = f"{float(answer.peak_rotation):.6g} α_c at t = {float(answer.peak_rotation_time):.6g} s"
    return f"{peak}, {int(answer.impacts)} impacts, {friction}"
