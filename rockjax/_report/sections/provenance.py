"""Section 12: versions of the software, hashes of the files, and the problem file."""

from __future__ import annotations

import hashlib
import platform
from importlib.metadata import version
from typing import TYPE_CHECKING

from rockjax._motions.motion import Motion
from rockjax._report.blocks import Paragraph, Section, Verbatim
from rockjax._report.tables import Code, Column, Table, TextCell
from rockjax._report.units import Units
from rockjax._version import __version__

if TYPE_CHECKING:
    from rockjax._report.evaluation import Evaluation
    from rockjax._report.problem import Problem


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 12 of the page."""
    del units
    problem = evaluation.problem
    # Histories and scenes under multiples of a motion are not counted, because only new pictures need them.
    # Searches store no scenes.
    scenes = sum(
        int(data["result"].size)
        for name, data in evaluation.scenes.store.used.items()
        if "result" in data and not name.startswith(("history.", "factors."))
    )
    rows = [
        ("rockjax", __version__),
        *((name, version(name)) for name in ("jax", "diffrax", "numpy")),
        ("Python", platform.python_version()),
        ("Platform", f"{platform.system()} {platform.machine()}"),
        ("Problem file", f"{problem.path.name}, SHA-256 {problem.sha256}"),
        ("Scenes of this report, without those of searches and pictures", str(scenes)),
    ]
    rows += [(label, _digest(problem, name)) for label, name in _files(problem).items()]
    members = [member for motions in problem.motions.values() for member in motions.members]
    seeds = {str(y.metadata["seed"]) for y in members if isinstance(y, Motion) and "seed" in y.metadata}
    if seeds:
        rows.append(("Seeds of motions", ", ".join(sorted(seeds))))
    table = Table(
        "provenance",
        "Versions and files",
        (Column("Item"), Column("Version or hash")),
        tuple((TextCell(name), TextCell(value)) for name, value in rows),
    )
    intro = Paragraph(("The problem file ", Code(problem.path.name), ", verbatim:"))
    return Section(12, "Provenance", (table, intro, Verbatim(problem.text)))


def _files(problem: Problem) -> dict[str, str]:
    """Return label → path, relative to the folder of the problem file, of the files that the problem names
    besides its motions."""
    files = {}
    if problem.risk.hazard is not None:
        source = problem.sources.get("risk.hazard")
        files["Hazard curve" + (f" ({source})" if source else "")] = problem.risk.hazard
    if problem.risk.fragility is not None:
        files["Fragility curve"] = problem.risk.fragility
    for entry in problem.checks:
        own = getattr(entry.keys, "hazard", None)
        if own is not None:
            files[f"Hazard curve of {entry.id}"] = own
    return files


def _digest(problem: Problem, name: str) -> str:
    path = problem.path.parent / name
    digest = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "file not found"
    return f"{path.name}, SHA-256 {digest}"
