"""The page of a report: one HTML file without scripts or network requests.

The template is `page.html.jinja`, and the style is `page.css`. Equal pages give equal bytes.
"""

from __future__ import annotations

import base64
import functools
import re
from importlib.resources import files

import jinja2
from markupsafe import Markup

from . import markup
from .blocks import Limit, Page
from .tables import SPACE, Quantity, TextCell, format_number, with_unit
from .units import Units, in_unit

# Result of a check → class of page.css, for the colour of its row in the summary.
COLOURS = {
    "PASS": "pass",
    "FAIL": "fail",
    "UNDECIDED": "inv",
    "NOT VALID": "inv",
    "NOT MADE": "none",
    "BY OTHERS": "none",
}
_LARGEST_U = 1.5  # utilisation at the right end of the bar


def render(page: Page, units: Units) -> str:
    """Return the HTML of a page.

    - `page`: content of the page [SI]
    - `units`: units in which numbers are shown

    All texts are escaped. A limit that has another unit in the problem file is shown in both units.
    """
    in_units = {
        name: functools.partial(function, units=units)
        for name, function in {
            "text": markup.text,
            "value": markup.value,
            "table": markup.table,
            "checked_value": _value,
            "limit": _limit,
            "utilisation": _utilisation,
        }.items()
    }
    return _template().render(
        page=page,
        css=Markup(_read("page.css")),
        font=_font(),
        footer=Markup(css_string(page.footer or page.title)),
        colours=COLOURS,
        scroll_box_start=markup.SCROLL_BOX_START,
        formula=markup.formula,
        kind_of=lambda block: type(block).__name__,
        breakable=lambda content: Markup(content.replace("_", Markup("_<wbr>"))),
        **in_units,
    )


def css_string(text: str) -> str:
    """Return a text for use within a CSS string. All characters except letters, digits, "_" and spaces are
    escaped. U+FFFD replaces U+0000, which cannot be escaped."""
    return re.sub(r"[^\w ]", lambda match: f"\\{ord(match[0]) or 0xFFFD:06x} ", text)


def _limit(limit: Limit | TextCell, units: Units) -> Markup:
    """Return the limit of a check in the unit of the page. If the problem file has another unit, add the
    limit in this unit."""
    if isinstance(limit, TextCell):
        return markup.value(limit, units)
    quantity = limit.quantity
    digits = with_unit(format_number(quantity, units), quantity.kind, units)
    content = Markup("{}{}{}").format(limit.comparison, SPACE, _breakable(digits))
    if limit.unit is not None and limit.unit != units.unit(quantity.kind):
        given = f"{in_unit(quantity.value, limit.unit, quantity.kind, units.g):.6g} {limit.unit}"
        content += Markup("<small>given as {}</small>").format(given)
    return content + markup.second_line(limit.note, units)


def _value(cell: Quantity | TextCell, units: Units) -> Markup:
    """Return the value of a check with its error."""
    return Markup(_breakable(markup.value(cell, units)))


def _breakable(content: str) -> str:
    """Return a number with a line break allowed before its unit, for narrow columns."""
    return content.replace(SPACE, " ")


def _utilisation(cell: Quantity | TextCell, units: Units) -> Markup:
    """Return a utilisation with a bar before it, which has a mark at 1. A text is returned without a bar."""
    if isinstance(cell, TextCell):
        return Markup('<span class="nb">{}</span>').format(markup.text(cell.text, units))
    percent = 100 * min(max(cell.value, 0.0), _LARGEST_U) / _LARGEST_U
    attributes = ' class="above"' if cell.value > 1 else ""
    bar = Markup('<span class="bar"><i{} style="width:{:.0f}%"></i><b></b></span>').format(
        Markup(attributes), percent
    )
    return Markup('<span class="u">{}<span>{}</span></span>').format(bar, format_number(cell, units))


@functools.cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=lambda value: value if isinstance(value, Markup | int | float) else markup.safe(str(value)),
    )
    return environment.from_string(_read("page.html.jinja"))


@functools.cache
def _font() -> str:
    """Return the font of the formulas, encoded in base 64."""
    return base64.b64encode(files("rockjax._report").joinpath("formulas.woff").read_bytes()).decode()


def _read(name: str) -> str:
    return files("rockjax._report").joinpath(name).read_text(encoding="utf-8")
