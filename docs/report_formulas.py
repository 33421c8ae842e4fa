"""Write the formulas of design reports as MathML, and a font for them: `python docs/report_formulas.py`.

`rockjax/_report/formulas.json` holds the LaTeX sources, from which math-core makes the MathML that the
package keeps; `formulas.woff` holds the characters that occur in it, from STIX Two Math (SIL Open Font
License, which the font names). Reports need neither library. `tests/report/test_page.py` compares sources and
MathML.
"""

from __future__ import annotations

import html
import io
import json
import re
from importlib.resources import files
from pathlib import Path

from fontTools import subset
from math_core import LatexToMathML

FOLDER = Path(__file__).parents[1] / "rockjax/_report"
# First letter of a plain alphabet, first letter of its italic form, number of letters.
ITALICS = ((0x41, 0x1D434, 26), (0x61, 0x1D44E, 26), (0x391, 0x1D6E2, 25), (0x3B1, 0x1D6FC, 25))
LARGEST = 60_000  # bytes of the font
translate = LatexToMathML(fancy_error=False).convert_with_local_state


def translated(formulas: dict[str, dict[str, str]]) -> dict[str, dict[str, str]]:
    """Return formulas with MathML made from their sources."""
    return {
        name: {**entry, "mathml": translate(entry["latex"], displaystyle=True)}
        for name, entry in formulas.items()
    }


def characters(formulas: dict[str, dict[str, str]]) -> set[int]:
    """Return the code points of formulas. Browsers set single letters in italics."""
    text = html.unescape(re.sub(r"<[^>]+>", "", "".join(entry["mathml"] for entry in formulas.values())))
    codes = {ord(character) for character in text}
    for plain, italic, count in ITALICS:
        codes |= {code - plain + italic for code in codes if plain <= code < plain + count}
    return codes | {0x210E, 0x221A}  # the italic h, and the sign of <msqrt>


def font(codes: set[int]) -> bytes:
    """Return a font with these characters, as WOFF."""
    source = files("ziamath").joinpath("fonts/STIXTwoMath-Regular.ttf").read_bytes()
    options = subset.Options(flavor="woff", layout_features=["ssty"], hinting=False, name_IDs=["*"])
    with subset.load_font(io.BytesIO(source), options) as made:
        subsetter = subset.Subsetter(options)
        subsetter.populate(unicodes=codes)
        subsetter.subset(made)
        made.flavor = options.flavor
        target = io.BytesIO()
        made.save(target)
    return target.getvalue()


if __name__ == "__main__":
    path = FOLDER / "formulas.json"
    made = translated(json.loads(path.read_text(encoding="utf-8")))
    path.write_text(json.dumps(made, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")
    content = font(characters(made))
    if len(content) > LARGEST:
        raise SystemExit(f"formulas.woff has {len(content)} bytes, more than {LARGEST}")
    (FOLDER / "formulas.woff").write_bytes(content)
