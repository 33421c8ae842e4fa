"""A report that is solved once: the example of the package without its building, under pulses, with checks of
the overturning scale and of the annual frequency."""

from __future__ import annotations

import dataclasses
import re
import shutil
from pathlib import Path

import rockjax as rj

EXAMPLES = Path(rj.__file__).parent / "examples"
OTHERS = "peak-shear|least-axial-force|contact-pressure|peak-velocity-jump"
MORE = """
[[checks]]
kind = "overturning-scale"
at_least = 1.5

[[checks]]
kind = "annual-frequency"
at_most = 1e-3

[risk]
hazard = "hazard.csv"
median = 5.0
dispersion = 0.4
"""


def problem_text() -> str:
    """Return the problem file. It has every key of the example, except those of the building and of records.
    Its scenes have the programs of those of `test_report.py`, because no check needs other outputs."""
    text = (EXAMPLES / "report.toml").read_text(encoding="utf-8")
    changes = (
        (r"^(top_mass|period|damping|top_height) =.*\n", "", 4),
        (r"^synthetic = 8\nseed = 3\npga = 2.9\n", 'kind = "ricker"\na_p = [2.5, 3.5]\nT_p = 1.0\n', 1),
        (r"^positions = \[.*?\]", "positions = [-4.0, 0.0, 4.0]", 1),
        (r'^"structure.top_mass" =.*\n', "", 1),
        (r"^\[report\]\n", '[report]\nlaws = ["paper"]\n', 1),
        (rf'^\[\[checks\]\]\nkind = "({OTHERS})"\n(?:.+\n)+\n', "", 4),
    )
    for pattern, replacement, count in changes:
        text, found = re.subn(pattern, replacement, text, flags=re.MULTILINE)
        assert found == count, pattern
    return text + MORE


@dataclasses.dataclass
class Solved:
    """The folder with problem.toml and the files of its report, page.html, page.json and page.nc."""

    folder: Path
    report: rj.Report

    @property
    def text(self) -> str:
        return (self.folder / "problem.toml").read_text(encoding="utf-8")

    def copy(self, folder: Path, text: str) -> tuple[Path, Path]:
        """Write a problem file into another folder, with the solved scenes. Return its path and that of the
        page."""
        shutil.copy(EXAMPLES / "hazard.csv", folder)
        path = folder / "problem.toml"
        path.write_text(text, encoding="utf-8")
        shutil.copy(self.folder / "page.nc", folder)
        return path, folder / "page.html"


def solve(folder: Path) -> Solved:
    shutil.copy(EXAMPLES / "hazard.csv", folder)
    (folder / "problem.toml").write_text(problem_text(), encoding="utf-8")
    return Solved(folder, rj.report(folder / "problem.toml", folder / "page.html"))
