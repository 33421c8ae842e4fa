"""Translate the formulas of the site to MathML and add a font for them.

Browsers then need no script and no network to display formulas. This hook of `mkdocs.yml` translates the
formulas that the Markdown extension `pymdownx.arithmatex` marks.
"""

from __future__ import annotations

import html
import io
import re
from importlib.resources import files as package_files

from fontTools import subset
from math_core import LatexError, LatexToMathML
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

MARKED = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
TAG = re.compile(r"\\tag\{([^}]*)\}")
FONT = "stylesheets/formulas.woff"  # named in stylesheets/site.css
# ASCII, accents, Greek, punctuation, arrows, operators, brackets, italic letters.
CHARACTERS = (
    *(
        (0x20, 0xFF),
        (0x2B0, 0x36F),
        (0x391, 0x3F6),
        (0x2000, 0x206F),
        (0x2100, 0x214F),
        (0x2190, 0x2194),
        (0x2200, 0x22FF),
    ),
    *((0x27E8, 0x27E9), (0x1D434, 0x1D467), (0x1D6E2, 0x1D71B)),
)
translate = LatexToMathML(annotation=True, fancy_error=False).convert_with_local_state


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add a font for mathematics; without one, browsers would put subscripts beside their letters."""
    options = subset.Options(flavor="woff", layout_features=["ssty"], hinting=False)
    source = package_files("ziamath").joinpath("fonts/STIXTwoMath-Regular.ttf").read_bytes()
    with subset.load_font(io.BytesIO(source), options) as font:
        subsetter = subset.Subsetter(options)
        subsetter.populate(unicodes=[code for first, last in CHARACTERS for code in range(first, last + 1)])
        subsetter.subset(font)
        target = io.BytesIO()
        font.flavor = options.flavor
        font.save(target)
    files.append(File.generated(config, FONT, content=target.getvalue()))
    return files


def on_page_content(content: str, *, page: Page, **_) -> str:
    """Translate the formulas of a page; a formula that cannot be translated stops the build."""

    def formula(found: re.Match) -> str:
        element, latex = found[1], html.unescape(found[2]).strip()
        number = TAG.search(latex)
        try:
            made = translate(TAG.sub("", latex), displaystyle=element == "div")
        except LatexError as error:
            raise PluginError(
                f"{page.file.src_uri}: the formula {latex!r} cannot be translated: {error}"
            ) from error
        if number:
            made += f'<span class="number">({html.escape(number[1])})</span>'
        return f'<{element} class="formula">{made}</{element}>'

    return MARKED.sub(formula, content)
