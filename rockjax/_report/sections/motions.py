"""Section 3: the ground motions."""

from __future__ import annotations

import functools
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._motions.accelerogram import warn_if_implausible
from rockjax._motions.intensity import spectral_acceleration
from rockjax._motions.motion import Motion
from rockjax._report.blocks import Figure, Paragraph, Section
from rockjax._report.cells import number_cell, slug
from rockjax._report.pictures import to_svg
from rockjax._report.tables import Cell, Code, Column, Quantity, Table, TextCell
from rockjax._report.units import Units
from rockjax._structures import g_tan_alpha

from .common import sets_with_scenes, stored_figure, unused_sets

if TYPE_CHECKING:
    from rockjax._report.evaluation import Evaluation
    from rockjax._report.problem import MotionSet

PERIODS = np.geomspace(0.05, 4.0, 60)  # periods of the drawn spectra [s]
DAMPING = 0.05  # damping ratio of the spectra [–]


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 3 of the page; `units`: units of its pictures."""
    problem = evaluation.problem
    period = _first_period(problem.podium)
    used = sets_with_scenes(evaluation)
    blocks: list[Any] = []
    for name in used:
        motions = problem.motions[name]
        if all(isinstance(member, Motion) for member in motions.members):
            inputs = motions.name, motions.identities, period, units.unit("acceleration"), units.g
            draw = functools.partial(_draw_spectra, motions, period, units)
            blocks.append(stored_figure(evaluation, f"spectra-{slug(name)}", inputs, draw))
    for name in used:
        blocks.append(_table(evaluation, problem.motions[name], period))
        blocks.append(_hashes(problem.motions[name]))
    unused = unused_sets(evaluation)
    if unused:
        blocks.append(Paragraph(("No check uses the sets ", Code(", ".join(unused)), "."), is_note=True))
    without = [name for name in problem.motions if name not in (*used, *unused)]
    if without:
        blocks.append(
            Paragraph(("No check was made with the sets ", Code(", ".join(without)), "."), is_note=True)
        )
    if not blocks:
        blocks.append(Paragraph("No check was made with ground motions."))
    return Section(3, "Ground motions", tuple(blocks))


def _first_period(podium: Any) -> float | None:
    """Return the first period of the building on a fixed base [s]; None if there is no building that
    vibrates."""
    superstructure = podium.superstructure
    oscillators = None if superstructure is None else superstructure.oscillators
    return None if oscillators is None else float(np.max(np.asarray(oscillators.T_s)))


def _table(evaluation: Evaluation, motions: MotionSet, period: float | None) -> Table:
    """Return the table of the motions of a set: name, source, samples, intensity measures and hash."""
    podium = evaluation.problem.podium
    threshold = float(podium.uplift_ground_acceleration)
    has_prestress = not np.isclose(threshold, float(g_tan_alpha(podium.alpha, podium.g)), rtol=1e-9)
    columns = (
        Column("Motion"),
        Column("Source"),
        Column("Samples"),
        Column("PGA", "acceleration"),
        Column("PGV", "velocity"),
        Column("PGD", "displacement"),
        Column("S_a(T_1)", "acceleration"),
        Column("PGA / uplift acceleration" if has_prestress else "PGA / (g tan α)", "number"),
        Column("Vertical PGA", "acceleration"),
        Column("Corrections and warnings"),
    )
    rows = [
        (TextCell(name), *_cells(member, threshold, period))
        for name, member in zip(motions.names, motions.members, strict=True)
    ]
    label = f", {motions.label}" if motions.label != motions.name else ""
    key = f"motions.{motions.name}"
    source = evaluation.problem.sources_of_inputs({motions.name})[key] or "not given"
    caption = f"Motions of the set {motions.name}{label}; source: {source}"
    return Table(f"motions-{slug(motions.name)}", caption, columns, tuple(rows))


def _cells(member: Any, threshold: float, period: float | None) -> tuple[Cell, ...]:
    """Return the cells of a motion in the table of its set, without its name.

    - `member`: record or pulse; `threshold`: least ground acceleration that lifts the columns [m/s²]
    - `period`: first period of the building [s], or None
    """
    vertical = getattr(member, "vertical", None)
    vertical_cell: Cell = TextCell("no vertical component", "none")
    if not isinstance(member, Motion):
        no_value = TextCell("not computed", "none")
        amplitude = float(getattr(getattr(member, "horizontal", member), "a_p", np.nan))
        if vertical is not None:
            largest = float(getattr(vertical, "a_p", np.nan))
            vertical_cell = number_cell(largest, "acceleration", text="not computed")
        return (
            TextCell("problem file"),
            TextCell("pulse"),
            number_cell(amplitude, "acceleration", text="none"),
            *[no_value] * 3,
            number_cell(amplitude / threshold, "number"),
            vertical_cell,
            TextCell("none", "none"),
        )
    source = str(member.source) if member.source is not None else "synthetic"
    if "seed" in member.metadata:
        source += f", seed {member.metadata['seed']}"
    if member.metadata.get("scale") not in (None, 1, 1.0):
        source += f", scale {float(member.metadata['scale']):.6g}"
    spectral: Cell = TextCell("rigid", "none")
    if period is not None:
        spectral = Quantity(spectral_acceleration(member, period, DAMPING), "acceleration")
    if vertical is not None:
        vertical_cell = number_cell(vertical.pga, "acceleration")
    return (
        TextCell(source.rpartition("/")[2]),
        TextCell(f"{len(member)} every {member.dt:g} s"),
        number_cell(member.pga, "acceleration"),
        number_cell(member.pgv, "velocity"),
        number_cell(member.pgd, "displacement"),
        spectral,
        number_cell(member.pga / threshold, "number"),
        vertical_cell,
        _corrections(member),
    )


def _corrections(member: Motion) -> TextCell:
    """Return a cell with the corrections that the header of a record names, and the warnings about it."""
    metadata = member.metadata
    texts = [str(metadata["processing"])] if metadata.get("processing") else []
    texts += [
        f"{words} {float(metadata[key]):g} Hz"
        for key, words in (("high_pass_Hz", "high pass"), ("low_pass_Hz", "low pass"))
        if key in metadata
    ]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_if_implausible(member, "warning", 1)
        if member.vertical is not None:
            warn_if_implausible(member.vertical, "warning, vertical component", 1)
    # Other threads may warn at the same time.
    caught = [y for y in caught if str(y.message).startswith("warning")]
    texts += [str(y.message) for y in caught]
    return (
        TextCell("; ".join(texts), "undecided" if caught else "text") if texts else TextCell("none", "none")
    )


def _hashes(motions: MotionSet) -> Table:
    """Return the table of the hashes of a set: of the samples of records, as little-endian 64-bit numbers, or
    of the parameters of pulses."""
    columns = [Column("Motion"), Column("SHA-256")]
    if any("+" in sha for sha in motions.hashes):
        columns.append(Column("SHA-256 of the vertical component"))
    rows = []
    for name, sha in zip(motions.names, motions.hashes, strict=True):
        first, _, second = sha.partition("+")
        last = TextCell((Code(second),)) if second else TextCell("no vertical component", "none")
        rows.append((TextCell(name), TextCell((Code(first),)), last)[: len(columns)])
    are_records = {isinstance(member, Motion) for member in motions.members}
    kinds = [("samples (little-endian float64)", True), ("parameters", False)]
    hashed = " or ".join(words for words, is_record in kinds if is_record in are_records)
    caption = f"SHA-256 of the {hashed} of the set {motions.name}"
    return Table(f"hashes-{slug(motions.name)}", caption, tuple(columns), tuple(rows))


def _draw_spectra(motions: MotionSet, period: float | None, units: Units) -> Figure:
    """Draw the pseudo-acceleration spectra of a set of records.

    - `motions`: the set; `units`: units of the drawing
    - `period`: first period of the building [s], which is marked; None for no mark
    """
    import matplotlib.pyplot as plt

    from rockjax._motions.intensity import spectral_accelerations
    from rockjax.plots._style import in_style

    records = [member for member in motions.members if isinstance(member, Motion)]
    values = np.array([spectral_accelerations(record, PERIODS, DAMPING) for record in records])
    unit_size = units.factor("acceleration")
    with in_style():
        figure, axes = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
        axes.plot(PERIODS, values.T / unit_size, color="0.6", linewidth=0.6)
        axes.plot(PERIODS, values.mean(axis=0) / unit_size, color="0.0", label="mean")
        if period is not None:
            axes.axvline(period, color="0.3", linestyle="--", linewidth=0.8, label=f"T₁ = {period:.3g} s")
        axes.set(xlabel="period T [s]", ylabel=f"S_a [{units.symbol('acceleration')}]", xlim=(0, PERIODS[-1]))
        axes.set_ylim(bottom=0)
        axes.legend()
    title = f"Response spectra of the set {motions.name}"
    peak = float(values.mean(axis=0).max())
    description = (
        f"Pseudo-acceleration spectra of {len(motions)} motions with 5 % damping, and their mean. The "
        f"largest value of the mean is {peak:.4g} m/s²."
    )
    caption = f"Spectra of the set {motions.name}, 5 % damping."
    return Figure(
        to_svg(figure, f"spectra-{slug(motions.name)}", title, description), caption, title, description
    )
