"""Write the MathML of the formulas of design reports: `python docs/report_formulas.py`.

`rockjax/_report/formulas.json` holds their LaTeX sources, from which math-core makes the MathML that the
package keeps: reports need no library for formulas. `tests/report/test_page.py` compares both.
"""

from __future__ import annotations

import json
from pathlib import Path

from math_core import LatexToMathML

PATH = Path(__file__).parents[1] / "rockjax/_report/formulas.json"
translate = LatexToMathML(fancy_error=False).convert_with_local_state


def translated(formulas: dict[str, dict[str, str]]) -> dict[str, dict[str, str]]:
    """Return formulas with MathML made from their sources."""
    return {
        name: {**entry, "mathml": translate(entry["latex"], displaystyle=True)}
        for name, entry in formulas.items()
    }


if __name__ == "__main__":
    made = translated(json.loads(PATH.read_text(encoding="utf-8")))
    PATH.write_text(json.dumps(made, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")
