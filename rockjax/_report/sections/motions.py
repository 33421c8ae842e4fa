"""Section 3: the ground motions."""

from __future__ import annotations

import functools
import warnings
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np

from rockjax._motions.accelerogram import warn_if_implausible
from rockjax._motions.intensity import spectral_acceleration, spectral_accelerations
from rockjax._motions.motion import Motion
from rockjax._report.blocks import Figure, Paragraph, Section
from rockjax._report.cells import slug
from rockjax._report.pictures import to_svg
from rockjax._report.tables import Cell, Code, Column, Quantity, Table, TextCell, plain
from rockjax._report.units import Units
from rockjax._structures import g_tan_alpha

from .common import governing_motion, in_pairs, plot_label, sets_with_scenes, stored_figure, unused_sets

if TYPE_CHECKING:
    from rockjax._report.evaluation import Evaluation
    from rockjax._report.problem import MotionSet

PERIODS = np.geomspace(0.05, 4.0, 60)  # periods of the drawn spectra [s]
LAST_PERIOD = 1.25  # the spectra extend to at least this multiple of the first period of the building
SAMPLES = 8001  # number of samples of a pulse for its spectrum and its intensity measures
DAMPING = 0.05  # damping ratio of the spectra [–]


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 3 of the page; `units`: units of its pictures."""
    problem = evaluation.problem
    period = _first_period(problem.podium)
    used = sets_with_scenes(evaluation)
    pictures = []
    for name in used:
        motions, governing = (
            problem.motions[name],
            governing_motion(evaluation.scenes.peaks(name), "peak_rotation"),
        )
        unit = units.unit("acceleration"), units.g
        inputs = motions.name, motions.names, motions.identities, period, governing, unit
        draw = functools.partial(_draw_spectra, motions, period, governing, units)
        pictures.append(stored_figure(evaluation, f"spectra-{slug(name)}", inputs, draw))
    blocks: list[Any] = [*in_pairs(pictures)]
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
    has_vertical = any(getattr(member, "vertical", None) is not None for member in motions.members)
    columns = (
        Column("Motion"),
        Column("Source"),
        Column("Samples"),
        Column("PGA", "acceleration"),
        Column("PGV", "velocity"),
        Column("PGD", "displacement"),
        Column("S_a(T_1)", "acceleration"),
        Column("PGA / uplift acceleration" if has_prestress else "PGA / (g tan α)", "number"),
        *([Column("Vertical PGA", "acceleration")] if has_vertical else []),
        Column("Corrections and warnings"),
    )
    rows = [
        (TextCell(name), *_cells(member, threshold, period, has_vertical))
        for name, member in zip(motions.names, motions.members, strict=True)
    ]
    label = f", {motions.label}" if motions.label != motions.name else ""
    key = f"motions.{motions.name}"
    source = evaluation.problem.sources_of_inputs({motions.name})[key] or "not given"
    caption = f"Motions of the set {motions.name}{label}; source: {source}"
    if not has_vertical:
        caption += "; no vertical components"
    return Table(f"motions-{slug(motions.name)}", caption, columns, tuple(rows))


def _cells(member: Any, threshold: float, period: float | None, has_vertical: bool) -> tuple[Cell, ...]:
    """Return the cells of a motion in the table of its set, without its name.

    - `member`: record or pulse; `threshold`: least ground acceleration that lifts the columns [m/s²]
    - `period`: first period of the building [s], or None
    - `has_vertical`: whether the table has a column for vertical components
    """
    source, samples, corrections = TextCell("problem file"), TextCell("pulse"), TextCell("none", "none")
    record = as_record(member)
    if isinstance(member, Motion):
        name = str(member.source) if member.source is not None else "synthetic"
        if "seed" in member.metadata:
            name += f", seed {member.metadata['seed']}"
        if member.metadata.get("scale") not in (None, 1, 1.0):
            name += f", scale {float(member.metadata['scale']):.6g}"
        source, samples = TextCell(name.rpartition("/")[2]), TextCell(f"{len(member)} every {member.dt:g} s")
        corrections = _corrections(member)
    spectral: Cell = TextCell("rigid", "none")
    if period is not None:
        spectral = Quantity(spectral_acceleration(record, period, DAMPING), "acceleration")
    vertical = getattr(member, "vertical", None)
    vertical_cell: Cell = TextCell("no vertical component", "none")
    if vertical is not None:
        pga = vertical.pga if isinstance(vertical, Motion) else as_record(vertical).pga
        vertical_cell = Quantity(pga, "acceleration")
    return (
        source,
        samples,
        Quantity(record.pga, "acceleration"),
        Quantity(record.pgv, "velocity"),
        Quantity(record.pgd, "displacement"),
        spectral,
        Quantity(record.pga / threshold, "number"),
        *([vertical_cell] if has_vertical else []),
        corrections,
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


def _draw_spectra(motions: MotionSet, period: float | None, governing: int | None, units: Units) -> Figure:
    """Draw the pseudo-acceleration spectra of a set of motions.

    - `motions`: the set; `units`: units of the drawing
    - `period`: first period of the building [s], which is marked; None for no mark
    - `governing`: index of the motion with the largest rotation, which is highlighted; None for none
    """
    import matplotlib.pyplot as plt

    from rockjax.plots._style import COLOURS, in_style

    last = max(PERIODS[-1], LAST_PERIOD * (period or 0.0))
    T = np.union1d(np.geomspace(PERIODS[0], last, PERIODS.size), [period or last])
    of_motions = [spectral_accelerations(as_record(member), T, DAMPING) for member in motions.members]
    mean, unit = np.mean(of_motions, axis=0), units.factor("acceleration")
    values = np.array(of_motions) / unit
    with in_style():
        figure, axes = plt.subplots(figsize=(4.8, 3.2), layout="constrained")
        axes.plot(T, values.T, "-", color="0.6", linewidth=0.6)
        if governing is not None:
            label = plot_label(motions.names[governing])
            axes.plot(T, values[governing], "-", color=COLOURS[1], linewidth=1.0, label=label)
        if len(motions) > 1:
            axes.plot(T, mean / unit, "-", color=COLOURS[0], linewidth=1.6, label="mean")
        if period is not None:
            axes.axvline(
                period, color=COLOURS[2], linestyle="--", linewidth=1.0, label=f"T₁ = {period:.3g} s"
            )
        axes.set(xlabel="period T [s]", ylabel=f"S_a [{units.symbol('acceleration')}]", xlim=(0, T[-1]))
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
        axes.legend()
    title = f"Response spectra of the set {motions.name}"
    where, largest = "the largest value of the mean", mean.max()
    if period is not None:
        where, largest = f"the mean at T_1 = {period:.3g} s", mean[np.searchsorted(T, period)]
    description = (
        f"Pseudo-acceleration spectra of {len(motions)} motions with 5 % damping, and their mean; "
        f"{where} is ",
        Quantity(float(largest), "acceleration"),
        ".",
    )
    label = f" ({motions.label})" if motions.label != motions.name else ""
    caption = f"Spectra of the set {motions.name}{label}, 5 % damping"
    if governing is not None:
        caption += f"; coloured: {motions.names[governing]}, with the largest rotation"
    svg = to_svg(figure, f"spectra-{slug(motions.name)}", title, plain(description, units))
    return Figure(svg, f"{caption}.", title, description)


def as_record(member: Any) -> Motion:
    """Return the horizontal component of a motion as a `Motion`. A pulse is sampled at `SAMPLES` times."""
    if isinstance(member, Motion):
        return member
    pulse = getattr(member, "horizontal", member)
    start, end = (float(y) for y in pulse.support)
    return Motion(np.asarray(_sample(pulse, np.linspace(start, end, SAMPLES))), (end - start) / (SAMPLES - 1))


@eqx.filter_jit
def _sample(pulse: Any, times: Any) -> jax.Array:
    return jax.vmap(pulse)(times)
