"""Instants of governing values, from the response histories of their scenes.

A scene is the structure under one motion. The values themselves come from the peaks of the scenes, which are
more accurate than the samples of a history.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rockjax._outputs.base import JOINT_NAMES
from rockjax._report.kinds import KINDS
from rockjax._report.kinds.base import statistic_of
from rockjax._report.kinds.peaks import PeakKind
from rockjax._report.tables import Quantity, Text
from rockjax._structures.building import ShearBuilding

from .common import column_offsets, governing_scene, sets_with_scenes, surviving_scenes

if TYPE_CHECKING:
    import xarray

    from rockjax._report.evaluation import Check, Evaluation
    from rockjax._report.problem import Problem
    from rockjax._report.scenes import Scenes
    from rockjax._report.store import Stored
    from rockjax._structures import Podium

# Output → variable of a history, and the function of its samples that is largest at the governing instant.
_SERIES = {
    "least_axial_force": ("joint_axial_force", np.negative),
    "peak_axial_force": ("joint_axial_force", np.positive),
    "peak_friction": ("joint_friction", np.positive),
    "peak_foundation_shear": ("foundation_shear", np.abs),
    "peak_drift": ("drift", np.abs),
    "peak_floor_acceleration": ("floor_acceleration", np.abs),
    "peak_deformation": ("deformation", np.abs),
}
_OF_FORCES = ("least_axial_force", "peak_axial_force", "peak_friction", "peak_foundation_shear")
_OPENING = "opening"  # name of the first instant at which a joint is in tension
_MISSING = -1e300  # in place of NaN, so that the largest value is a number


class Instant(NamedTuple):
    """An instant of a history. Forces are divided by the weight m_c g of a column.

    - `time`: time [s]
    - `column`: index of the column; NaN for an output that has no column, such as a drift
    - `axial`, `shear`: forces N and T in the joint of the column [–]; NaN without a column
    - `mean_axial`: axial force in this joint of the mean column [–]
    - `moment`: overturning moment M on the columns, divided by N m_c g [m]
    - `eccentricity`: χ, the contact mode σ while rocking, otherwise ξ [–]
    """

    time: float
    column: float = np.nan
    axial: float = np.nan
    shear: float = np.nan
    mean_axial: float = np.nan
    moment: float = np.nan
    eccentricity: float = np.nan


Instants = dict[tuple[str, int], Instant]  # (output, index of the joint, storey or mode or −1) → instant


def instants_of(evaluation: Evaluation, name: str, motion: int) -> Instants:
    """Return the instants of the largest values (the least, for a minimum) of all outputs in the history of a
    scene.

    - `evaluation`: the evaluated problem
    - `name`: name of the set of motions; `motion`: index of the motion in the set
    """
    scenes = evaluation.scenes
    if (name, motion) == governing_scene(scenes, sets_with_scenes(evaluation)):  # the page draws its history
        return find_instants(scenes.problem.podium, scenes.history(name, motion))
    data = scenes.store.get(*_stored(scenes, name, motion))
    keys = zip(data["output"].values, data["row"].values, strict=True)
    return {(str(y), int(k)): Instant(*z) for (y, k), z in zip(keys, data["instant"].values, strict=True)}


def known_instants(evaluation: Evaluation, name: str, motion: int) -> Instants:
    """Return the result of `instants_of`, or {} if no picture, no check and no extreme force in a joint needs
    this history."""
    scenes = evaluation.scenes
    is_needed = (name, motion) == governing_scene(scenes, sets_with_scenes(evaluation)) or any(
        (check.motions, check.governing) == (name, motion) and _shows_instant(check)
        for check in evaluation.checks
    )
    if scenes.problem.podium.elevation is not None:
        extremes = extremes_of(scenes.peaks(name))
        is_needed |= any(k == motion for output, _, k in extremes if output != "peak_foundation_shear")
    return instants_of(evaluation, name, motion) if is_needed else {}


def start(scenes: Scenes, names: Sequence[str]) -> None:
    """Start to find the instants of governing values in other threads.

    - `scenes`: the scenes of the problem; `names`: names of the sets of motions on the page
    """
    drawn = governing_scene(scenes, names)
    for name, motion in dict.fromkeys(_governing(scenes, names)):
        if (name, motion) != drawn:
            scenes.store.start(*_stored(scenes, name, motion))


def _stored(scenes: Scenes, name: str, motion: int) -> Stored:
    """Return the arguments of `Store.get` for the instants of a scene. The history itself is not stored."""
    label, inputs_hash, solve = scenes.stored_history(name, motion)

    def compute() -> xarray.Dataset:
        import xarray

        found = find_instants(scenes.problem.podium, solve())
        variables = {
            "output": ("entry", [output for output, _ in found]),
            "row": ("entry", [row for _, row in found]),
            "instant": (("entry", "field"), np.array(list(found.values()), float).reshape(len(found), -1)),
        }
        return xarray.Dataset(variables)

    return label.replace("history.", "instants.", 1), inputs_hash, compute


def _governing(scenes: Scenes, names: Sequence[str]) -> Iterator[tuple[str, int]]:
    """Yield (set, index of the motion) of the scenes with the governing values of checks, and with the
    extreme forces in the joints."""
    for entry in scenes.problem.checks:
        kind = KINDS[entry.kind]
        if (
            entry.motions
            and entry.motions in names
            and isinstance(kind, PeakKind)
            and entry.keys.statistic == "max"
            and not kind.missing(entry, scenes.problem)
        ):
            values = kind.values(entry, scenes)
            governing = statistic_of(values, entry.keys.statistic, kind.is_minimum).governing
            if values.states[governing] != "overturned" and _has_instant(kind.variable):
                yield entry.motions, governing
    for name in names if scenes.problem.podium.elevation is not None else ():
        for output, _, motion in extremes_of(scenes.peaks(name)):
            if output != "peak_foundation_shear":
                yield name, motion


def _shows_instant(check: Check) -> bool:
    """Return whether the page shows the instant of a check: that of a largest or least value, or the one at
    which a joint opens. A mean or a quantile has no instant."""
    return (
        isinstance(check.kind, PeakKind)
        and check.governing is not None
        and check.state != "overturned"
        and (check.statistic == "max" or check.state == "joint opens")
        and _has_instant(check.kind.variable)
    )


def _has_instant(variable: str) -> bool:
    return variable in (*_SERIES, "peak_shear", "peak_velocity_jump")


def extremes_of(data: xarray.Dataset) -> Iterator[tuple[str, int, int]]:
    """Yield (output, index of the joint or −1, index of the motion) of the least and the largest axial force
    in each joint, and of the largest friction demand and foundation shear, among the scenes that survive.

    `data`: peaks of a set
    """
    survivors = np.flatnonzero(surviving_scenes(data))
    for output in _OF_FORCES if survivors.size else ():
        if output not in data:
            continue
        values = data[output].values[survivors]
        values = values[:, None] if values.ndim == 1 else values
        worst = np.argmin if output.startswith("least") else np.argmax
        motions = survivors[worst(values, axis=0)]
        if output == "peak_friction":  # of the joint with the larger demand
            joint = int(np.argmax(values.max(axis=0)))
            yield output, joint, int(motions[joint])
        elif output == "peak_foundation_shear":
            yield output, -1, int(motions[0])
        else:
            yield from ((output, joint, int(k)) for joint, k in enumerate(motions))


def find_instants(podium: Podium, history: xarray.Dataset) -> Instants:
    """Return the instants of the largest values of all outputs in a history. A friction demand may be
    infinite because a joint opens; its instant is then the first one with an infinite demand.

    - `podium`, `history`: the structure, and the dataset of a history
    """
    found: Instants = {}
    series = {y: function(history[z].values) for y, (z, function) in _SERIES.items() if z in history}
    shear = _shear(podium, history)
    if shear is not None:
        series["peak_shear"] = shear
    for output, values in series.items():
        rows = [(-1, values)] if values.ndim == 1 else [(k, values[..., k]) for k in range(values.shape[-1])]
        for row, of_row in rows:
            at = np.unravel_index(int(np.argmax(np.where(np.isnan(of_row), _MISSING, of_row))), of_row.shape)
            found[output, row] = _instant(history, int(at[0]), row, *map(int, at[1:]))
    if history.sizes.get("impact"):
        jump = np.abs(history["theta_dot_after"].values - history["theta_dot_before"].values)
        at_impacts = history["impact_times"].values
        jump = np.where(np.isnan(jump) | np.isnan(at_impacts), _MISSING, jump)
        found["peak_velocity_jump", -1] = Instant(float(at_impacts[int(np.argmax(jump))]))
    if "joint_axial_force" in history:
        is_open = history["joint_axial_force"].values < 0
        samples = np.flatnonzero(is_open.any(axis=(1, 2)))
        if samples.size:
            column, joint = np.argwhere(is_open[samples[0]])[0]
            found[_OPENING, -1] = _instant(history, int(samples[0]), int(joint), int(column))
    return found


def _instant(history: xarray.Dataset, sample: int, joint: int, column: int | None = None) -> Instant:
    """Return an instant from a sample of a history, with the forces in a joint of a column."""
    time = float(history["time"].values[sample])
    if column is None:
        return Instant(time)
    axial, shear = (history[y].values[sample, :, joint] for y in ("joint_axial_force", "joint_shear"))
    # Without positions of the columns, the only column is the mean column.
    moment = history["overturning_moment"].values[sample] if "overturning_moment" in history else np.nan
    eccentricity = history["joint_eccentricity"].values[sample]
    return Instant(
        time, column, axial[column], shear[column], float(axial.mean()), float(moment), float(eccentricity)
    )


def _shear(podium: Podium, history: xarray.Dataset) -> np.ndarray | None:
    """Return the absolute shear at the base of the building, up to a constant factor, (times,). Return None
    for a superstructure other than a building of stories or a single mode."""
    building = podium.superstructure
    if isinstance(building, ShearBuilding) and "floor_acceleration" in history:
        return np.abs(history["floor_acceleration"].values @ np.asarray(building.masses, float))
    oscillators = None if building is None else building.oscillators
    if oscillators is None or "deformation" not in history or np.size(oscillators.T_s) != 1:
        return None
    omega, zeta = 2 * np.pi / float(np.squeeze(oscillators.T_s)), float(np.squeeze(oscillators.zeta))
    deformation = history["deformation"].values.reshape(history.sizes["time"])
    rate = np.gradient(deformation, history["time"].values)
    return np.abs(omega**2 * deformation + 2 * zeta * omega * rate)


def column_text(problem: Problem, instant: Instant) -> Text:
    """Return the position of the column of an instant from the mean position of all columns, such as
    "x = 7.5 m"; "mean column" if the structure has no positions."""
    if problem.podium.elevation is None:
        return "mean column"
    if np.isnan(instant.column):
        return "whole structure"
    offsets = column_offsets(problem.podium)
    return "x = ", Quantity(float(offsets[int(instant.column)]), "length", is_input=True)


def opening_of(evaluation: Evaluation, name: str, motion: int) -> Instant | None:
    """Return the first instant at which a joint is in tension under a motion of a set; None if the samples of
    the history have none."""
    return instants_of(evaluation, name, motion).get((_OPENING, -1))


def instant_of_check(check: Check, evaluation: Evaluation) -> Instant | None:
    """Return the instant of the governing value of a check of a peak; None if the page does not show it.

    If the value is infinite because a joint opens, the result is the first instant at which a joint is in
    tension.
    """
    if not _shows_instant(check):
        return None
    kind = check.kind
    assert isinstance(kind, PeakKind)
    assert check.governing is not None
    if check.state == "joint opens":
        return opening_of(evaluation, str(check.motions), check.governing)
    row = -1
    if check.location:  # from `PeakKind.values`, such as "top joint" or "storey 3"
        words = check.location.split()
        row = JOINT_NAMES.index(words[0]) if words[0] in JOINT_NAMES else int(words[-1]) - 1
    return instants_of(evaluation, str(check.motions), check.governing).get((kind.variable, row))
