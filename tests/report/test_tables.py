"""Tables of reports: cells reject non-numbers, and numbers have the correct digits."""

import math
import re

import numpy as np
import pytest

from rockjax._report import blocks
from rockjax._report.cells import slug
from rockjax._report.tables import (
    Bare,
    Column,
    Link,
    Quantity,
    Series,
    Strong,
    Table,
    TextCell,
    column_heading,
    format_error,
    format_number,
    format_series,
    plain,
    plain_cell,
)
from rockjax._report.units import Units

UNITS = Units.parse("kN,m,deg,g,mm")


@pytest.mark.parametrize(
    ("quantity", "digits", "error"),
    [
        (Quantity(0.467476379, "number", 7e-11), "0.4675", "7·10⁻¹¹"),
        (Quantity(0.467476379, "number", 2e-3), "0.467", "0.002"),
        (Quantity(0.467476379, "number", 9.6e-3), "0.47", "0.01"),
        (Quantity(0.001, "number", 0.02), "0.00", "0.02"),
        (Quantity(1234.0, "number", 200.0), "1200", "200"),
        (Quantity(4.7e-5, "number", 1e-5), "5·10⁻⁵", "1·10⁻⁵"),
        (Quantity(0.0, "number", 1e-3), "0.000", "0.001"),
        (Quantity(0.0, "number"), "0", ""),
        (Quantity(-0.0, "number"), "0", ""),
        (Quantity(9.9996, "number"), "10.00", ""),
        (Quantity(1.609e-4, "rate"), "1.609·10⁻⁴", ""),
        (Quantity(0.0009999999, "number"), "0.001000", ""),
        (Quantity(4.05e6, "number"), "4.050·10⁶", ""),
        (Quantity(-123456.0, "number"), "−123\u202f500", ""),
        (Quantity(0.0055801, "ratio"), "0.5580", ""),
        (Quantity(20.194, "acceleration"), "2.059", ""),
        (Quantity(0.3248819502, "displacement"), "324.9", ""),
        (Quantity(0.2292319, "angle"), "13.13", ""),
        (Quantity(-858.9e3, "force"), "−858.9", ""),
        (Quantity(12227, "count"), "12\u202f227", ""),
        (Quantity(16, "count"), "16", ""),
        (Quantity(1.5 * 9.80665, "acceleration", is_input=True), "1.5", ""),
        (Quantity(0.0075, "ratio", is_input=True), "0.75", ""),
        (Quantity(2e-4, "rate", is_input=True), "2·10⁻⁴", ""),
        (Quantity(400e3, "mass", is_input=True), "400", ""),
        (Quantity(0.9349, "utilisation"), "0.93", ""),
        (Quantity(-5.758, "derivative"), "−5.8", ""),
        (Quantity(0.0294, "derivative"), "+0.029", ""),
        (Quantity(12.34, "derivative"), "+12", ""),
        (Quantity(0.9996, "utilisation"), "0.9996", ""),
        (Quantity(1.0004, "utilisation"), "1.0004", ""),
        (Quantity(1 - 1e-14, "utilisation"), "0.99999999999999", ""),
        (Quantity(1.0, "utilisation"), "1.00", ""),
        (Quantity(12.3456, "utilisation"), "12.35", ""),
    ],
)
def test_digits(quantity, digits, error):
    assert (format_number(quantity, UNITS), format_error(quantity, UNITS)) == (digits, error)


def test_series_of_equal_numbers():
    masses = Series((260e3,) * 7 + (220e3,), "mass", is_input=True)
    assert format_series(masses, UNITS) == "7 × 260, 220"
    assert plain_cell(masses, UNITS) == "7 × 260, 220\u00a0t"
    with pytest.raises(ValueError, match="values must not be empty"):
        Series((), "mass")


def test_other_units_change_the_factor_only():
    for unit, factor in (("N", 1.0), ("kN", 1e3), ("MN", 1e6)):
        assert Units((unit,)).show(1495.5e3, "force") == 1495.5e3 / factor


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, None, "", "a"])
def test_a_quantity_is_a_finite_number(value):
    with pytest.raises(ValueError, match=r"Quantity: value must be (finite|a number)"):
        Quantity(value, "force")


def test_a_quantity_checks_kind_and_error():
    with pytest.raises(ValueError, match="kind must be one of force"):
        Quantity(1.0, "forces")
    with pytest.raises(ValueError, match="error must not be negative"):
        Quantity(1.0, "force", -1.0)
    with pytest.raises(ValueError, match="error must be finite"):
        Quantity(1.0, "force", math.nan)
    assert type(Quantity(np.float64(1.0), "force", np.float64(0.1)).value) is float


@pytest.mark.parametrize(
    "text", ["", "  ", "-", "–", "—", "…", "nan", "NaN", "inf", "-inf", "∞", "None", "null", None, 3, ()]
)
def test_a_word_is_a_word(text):
    with pytest.raises(ValueError, match=r"TextCell\.text must be"):
        TextCell(text)


def test_a_word_has_a_known_state():
    assert TextCell("overturned at 5.85 s", "overturned").tone == "bad"
    with pytest.raises(ValueError, match="state must be one of text, pass"):
        TextCell("overturned", "fallen")


def test_a_text_follows_the_units_of_the_page():
    text = ("top displaced by ", Quantity(0.325, "displacement"), " (", Strong("0.467 α"), "), √(")
    text += (Bare(Quantity(0.35, "length", is_input=True)), "² + …), see ", Link("section 4", "s4"))
    expected = "top displaced by 325.0\u00a0mm (0.467 α), √(0.35² + …), see section 4"
    assert plain(text, UNITS) == expected
    assert plain(text, Units.si()).startswith("top displaced by 0.3250\u00a0m ")


def test_a_heading_has_its_unit():
    assert column_heading(Column("PGA", "acceleration"), UNITS) == "PGA [g]"
    assert column_heading(Column("PGA", "acceleration"), Units.si()) == "PGA [m/s²]"
    assert column_heading(Column("θ/α", "number"), UNITS) == column_heading(Column("θ/α"), UNITS) == "θ/α"


def test_tables_are_complete():
    columns = {"No.": None, "PGA": "acceleration"}
    table = Table.from_rows(
        "motions", "Motions", columns, [["1", 2.942], ["2", TextCell("not asked", "not asked")]]
    )
    assert table.rows[0] == (TextCell("1"), Quantity(2.942, "acceleration"))
    for rows, message in (
        ([], "needs at least one row"),
        ([["1", Quantity(1.0, "force")]], "row 0 has a force in the column 'PGA' of kind acceleration"),
        ([["1", ""]], r"TextCell\.text must be text"),
        ([["1", math.nan]], "value must be finite"),
    ):
        with pytest.raises(ValueError, match=message):
            Table.from_rows("motions", "Motions", columns, rows)
    with pytest.raises(ValueError, match="row 0 has 1 cells for 2 columns"):
        Table("motions", "Motions", table.columns, ((TextCell("1"),),))
    with pytest.raises(ValueError, match="name must have lower-case letters"):
        Table.from_rows("Motions!", "Motions", columns, [["1", 1.0]])
    with pytest.raises(ValueError, match="1 ids for 2 rows"):
        Table.from_rows("motions", "Motions", columns, [["1", 1.0], ["2", 1.0]], ids=("A1",))


def test_rows_of_the_summary_are_complete():
    row = {
        "id": "C1",
        "name": "Rotation",
        "scope": "design",
        "value": Quantity(0.1, "number"),
        "limit": blocks.Limit("≤", Quantity(0.2, "number")),
        "utilisation": Quantity(0.5, "utilisation"),
        "result": "PASS",
        "governs": "motion 9",
        "sensitivities": "width −7.1",
        "spread": "0.41 … 0.62",
    }
    made = blocks.SummaryRow(**row)
    assert (made.state, made.symbol) == ("pass", "✓")
    for change, message in (
        ({"id": " "}, r"SummaryRow\.id must be text"),
        ({"result": "OK"}, "result must be one of PASS, FAIL"),
        ({"governs": ""}, "SummaryRow C1: governs must be text"),
        ({"utilisation": Quantity(0.5, "number")}, "utilisation must be of kind"),
    ):
        with pytest.raises(ValueError, match=message):
            blocks.SummaryRow(**row | change)
    with pytest.raises(ValueError, match="ids must differ, got C1 more than once"):
        blocks.Summary((made, made), "U = value/limit.")
    table = blocks.Summary((made,), "U = value/limit.").table()
    assert len(table.rows) == 1


def number(digits):
    """Return the number that a page shows."""
    mantissa, _, power = digits.replace("−", "-").replace("\u202f", "").partition("·10")
    plain_power = power.translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-"))
    return float(f"{mantissa}e{plain_power or 0}")


def test_digits_of_random_numbers():
    """Four digits are accurate to 5e-4, or to half of the error's first digit; rounding does not move U
    across 1."""
    draw = np.random.default_rng(60)
    for _ in range(3000):
        value = float(draw.choice([-1, 1]) * 10 ** draw.uniform(-12, 12))
        error = abs(value) * 10 ** float(draw.uniform(-14, 2))
        unit = 10.0 ** math.floor(math.log10(float(f"{error:.0e}")))
        exact, estimated = Quantity(value, "number"), Quantity(value, "number", error)
        assert number(format_number(exact, UNITS)) == pytest.approx(value, rel=5.01e-4)
        assert abs(number(format_number(estimated, UNITS)) - value) <= max(5.01e-4 * abs(value), 0.501 * unit)
        assert number(format_error(estimated, UNITS)) == pytest.approx(error, rel=0.34)
        given = Quantity(value, "number", is_input=True)
        assert number(format_number(given, UNITS)) == pytest.approx(value, rel=5.01e-6)
        used = 1 + float(draw.choice([-1, 1]) * 10 ** draw.uniform(-15, 0))
        seen = number(format_number(Quantity(used, "utilisation"), UNITS))
        assert (seen > 1, seen < 1) == (used > 1, used < 1)


def test_names_of_tables_of_different_sets_differ():
    names = ["design", "a b", "a-b", "a.b", "проект", "предел", 60 * "x", 61 * "x"]
    slugs = [slug(name) for name in names]
    assert len(set(slugs)) == len(names)
    assert slugs[0] == "design"
    assert all(re.fullmatch("[a-z0-9-]{1,60}", y) for y in slugs)
