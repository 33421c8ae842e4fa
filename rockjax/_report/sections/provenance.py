"""Section 12: versions of the software, hashes of the files, and the problem file."""

from __future__ import annotations

import hashlib
import platform
from importlib.metadata import version
from typing import TYPE_CHECKING

from rockjax._report.blocks import Paragraph, Section, Verbatim
from rockjax._report.tables import Code, Column, Table, TextCell
from rockjax._report.units import Units
from rockjax._version import __version__

if TYPE_CHECKING:
    from rockjax._report.evaluation import Evaluation


def section(evaluation: Evaluation, units: Units) -> Section:
    """Return section 12 of the page."""
    del units
    problem = evaluation.problem
    # Histories are not counted, because only new pictures need them.
    scenes = sum(
        int(data["result"].size)
        for name, data in evaluation.scenes.store.used.items()
        if "result" in data and not name.startswith("history.")
    )
    rows = [
        ("rockjax", __version__),
        *((name, version(name)) for name in ("jax", "diffrax", "numpy")),
        ("Python", platform.python_version()),
        ("Platform", f"{platform.system()} {platform.machine()}"),
        ("Problem file", f"{problem.path.name}, SHA-256 {problem.sha256}"),
        ("Scenes of this report", str(scenes)),
    ]
    if problem.risk.hazard is not None:
        path = problem.path.parent / problem.risk.hazard
        digest = hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else "file not found"
        rows.append(("Hazard curve", f"{path.name}, SHA-256 {digest}"))
    table = Table(
        "provenance",
        "Versions and files",
        (Column("Item"), Column("Version or hash")),
        tuple((TextCell(name), TextCell(value)) for name, value in rows),
    )
    intro = Paragraph(("The problem file ", Code(problem.path.name), ", verbatim:"))
    return Section(12, "Provenance", (table, intro, Verbatim(problem.text)))
