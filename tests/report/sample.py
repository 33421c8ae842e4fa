"""A page with every kind of block and cell, with numbers of the eight-story example."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from rockjax._report.blocks import (
    Equation,
    Equations,
    Figure,
    Limit,
    Page,
    Pair,
    Paragraph,
    Section,
    Summary,
    SummaryRow,
    Verbatim,
    check_anchor,
)
from rockjax._report.tables import (
    Bare,
    Code,
    Column,
    Formula,
    Link,
    Quantity,
    Series,
    Strong,
    Table,
    TextCell,
)

G = 9.80665
HOSTILE = ("<script>alert(1)</script>", "=1+1", "ж" * 400, "{{ 7 * 7 }}", "\"'&</style>", "Проверка №1")
SVG = '<svg viewBox="0 0 80 40" role="img" aria-label="line"><path d="M0 20H80" stroke="currentColor"/></svg>'
LIMITS = {
    "C1": ("Rotation max|θ|/α", "design, largest of 11", 0.095611, 0.20, "number", "–", "PASS"),
    "C2": ("Rotation max|θ|/α", "maximum, largest of 11", 0.467476379, 0.50, "number", "–", "NOT VALID"),
    "C6": ("Story drift / height", "design, largest of 11", 0.00558, 0.0075, "ratio", "%", "PASS"),
    "C7": ("Floor acceleration", "design, largest of 11", 2.0593 * G, 1.5 * G, "acceleration", "g", "FAIL"),
    "C8": ("Base shear / weight", "maximum, largest of 11", 0.40478, 0.45, "number", "–", "UNDECIDED"),
    "C11": ("Contact pressure", "maximum, largest of 11", 30.4e6, 34e6, "stress", "MPa", "NOT VALID"),
    "C12": ("Annual frequency", "design × hazard", 1.609e-4, 2e-4, "rate", "1/year", "PASS"),
}


def summary(count: int = 14, text: str = "design brief 4.2") -> Summary:
    """Return a summary with at least nine and at most `count` rows."""
    return Summary(
        tuple(_rows(text))[:count],
        "U = value/limit (limit/value for “≥”). The line in the bar is U = 1. “Changes with”: per cent of U "
        "for 1 % more of the parameter. “U with spread”: the whole set with each parameter 5 % up and down.",
    )


def _rows(text: str) -> Iterator[SummaryRow]:
    for k, (id, (name, scope, value, limit, kind, unit, result)) in enumerate(LIMITS.items()):
        invalid = ("A7",) if result == "NOT VALID" else ()
        yield SummaryRow(
            id=id,
            name=name,
            scope=scope,
            value=Quantity(value, kind, 1e-11 * value),
            limit=Limit("≤", Quantity(limit, kind, is_input=True), unit),
            utilisation=Quantity(value / limit, "utilisation"),
            result=result,
            governs=("synthetic-0009, storey 7, ", Quantity(6.859404981, "time")),
            sensitivities="story_stiffnesses −5.2, story_masses +5.0, motion +2.2, height +1.9",
            spread="from 0.87; overturned (synthetic-0009) with story_stiffnesses −, motion +",
            section=k % 3 + 1,
            assumptions=invalid,
            flags=(Link("extrap.", "s3"),) if id == "C12" else (),
            clause=text,
            is_target=id == "C8",
        )
    yield SummaryRow(
        id="C9",
        name="Friction demand |T|/N at the joints",
        scope="maximum, largest of 11",
        value=TextCell("no finite value", "joint opens", ("joint opens at ", Quantity(3.061, "time"))),
        limit=Limit("≤", Quantity(0.45, "number", is_input=True), note=Code("joints.friction").text),
        utilisation=TextCell("> 1"),
        result="FAIL",
        governs="motion 9",
        sensitivities="no derivative",
        spread="joint opens in 16 of 16",
        section=1,
        assumptions=("A7",),
    )
    for id, reason in (
        ("C13", "Not in the model: columns are held at their pivots."),
        ("C14", "No vertical record is given: add vertical or vertical_ratio to motions.maximum."),
        *((f"C{number}", "Not in the model: the ground is rigid.") for number in (15, 16, 17)),
    ):
        yield SummaryRow(
            id=id,
            name="Sliding displacement",
            scope="maximum",
            value=TextCell("not made", "not made"),
            limit=Limit("≤", Quantity(0.02, "displacement", is_input=True), "cm"),
            utilisation=TextCell("no value"),
            result="NOT MADE",
            reason=reason,
            section=3,
        )
    yield SummaryRow(
        id="B1",
        name=text,
        scope="by others",
        value=TextCell("by others", "by others"),
        limit=TextCell("by others", "by others"),
        utilisation=TextCell("no value"),
        result="BY OTHERS",
        reason="report G-02",
        section=3,
    )


def inputs(text: str = "drawing S-101 rev C") -> Table:
    rows = (
        (
            TextCell("Width of a column 2B", note=(Code("structure.width"),)),
            Quantity(0.7, "length", is_input=True),
        ),
        (TextCell("Mass of a column"), Quantity(4725.0, "mass", is_input=True)),
        (TextCell("Columns N"), Quantity(16, "count")),
        (TextCell("Story masses"), Series((260e3,) * 7 + (220e3,), "mass", is_input=True)),
        (TextCell("Damping ratio of all modes ζ"), Quantity(0.05, "ratio", is_input=True)),
        (TextCell("Law of impact"), TextCell(("paper, e = ", Quantity(0.8969973, "number")))),
    )
    sources = [TextCell(text)] * (len(rows) - 1) + [TextCell("no source given", "no source")]
    columns = (Column("Quantity", note="key in the problem file"), Column("Value"), Column("Source"))
    made = tuple((*row, source) for row, source in zip(rows, sources, strict=True))
    return Table("inputs", "Inputs", columns, made)


def derived() -> Table:
    numbers = ("√(", Bare(Quantity(0.35, "length", is_input=True)), "² + ")
    numbers += (Bare(Quantity(1.5, "length", is_input=True)), "²)")
    return Table.from_rows(
        "derived",
        "Derived quantities",
        {"Equation": None, "with numbers": None, "Result": None, "Source": None},
        [
            [Formula("slenderness"), "0.700 / 3.000", Quantity(0.2292319, "angle"), "Model, Eq. (1)"],
            [Formula("half_diagonal"), numbers, Quantity(1.5402922, "length"), "Model, Eq. (1)"],
            [
                Formula("restitution_paper"),
                "sin²α = 0.051634",
                Quantity(0.8969973, "number"),
                "Model, Eq. (27)",
            ],
        ],
    )


def motions(text: str = "synthetic, seed 475") -> Table:
    rows = []
    for number in range(1, 41):
        fallen = TextCell("overturned", "overturned", ("at ", Quantity(5.0 + number / 7, "time")))
        rotation = fallen if number % 4 == 0 else Quantity(0.004 * number, "number", 1e-6 * number)
        source = TextCell(text, note="SHA-256 158bb9e58a69…")
        rows.append([str(number), source, 2.9 + number / 100, 0.2 + number / 50, rotation])
    columns = {
        "No.": None,
        "Source": None,
        "PGA": "acceleration",
        "PGV": "velocity",
        "θ/α": "number",
    }
    return Table.from_rows("motions", "Motions", columns, rows, governing=(8,))


def assumptions() -> Table:
    rows = [
        ["A1", "Columns do not slide", TextCell("no", "violated"), "mean column |T|/N = 0.249 ≤ 0.45"],
        [
            "A7",
            "The beam rests on all columns",
            TextCell("violated", "violated"),
            "an outer line is in tension",
        ],
    ]
    columns = {"No.": None, "Assumption": None, "Conservative?": None, "Tested": None}
    return Table.from_rows("assumptions", "Assumptions", columns, rows, ids=("A1", "A7"))


def page(
    date: str = "2026-11-26", text: str = "Example", svg: str = SVG, drawing: str = SVG, right: str = SVG
) -> Page:
    """Return a page. `text` occurs wherever a text of a problem file can."""
    figure = Figure(svg, ("Spectra of “design”, PGA ", Quantity(2.942, "acceleration")), text, text)
    content = [
        ("Summary of checks", [summary(text=text)]),
        (
            "Structure and inputs",
            [
                Figure(drawing, "Elevation to scale.", "Elevation", "Four lines", is_narrow=True),
                inputs(text),
                derived(),
                Paragraph(("Periods: ", Quantity(0.7005, "time"), ", see ", Link("A7", "A7"))),
            ],
        ),
        ("Ground motions", [Pair(figure, dataclasses.replace(figure, svg=right)), motions(text)]),
        (
            "Joint forces",
            [
                Equations(
                    (
                        Equation(Formula("axial_force"), label="F8"),
                        Equation(
                            Formula("dead_load"), "32.28 · 4.725 · 9.807", Quantity(1495.5e3, "force"), "F3"
                        ),
                        Equation(Formula("spectral_uplift"), label="P2"),
                    )
                ),
                Paragraph(
                    (
                        "Least force ",
                        Strong("in tension", "bad"),
                        " ",
                        Quantity(-858.9e3, "force", 1e-3),
                        "; see ",
                        Link("C2", check_anchor("C2")),
                        " and ",
                        Formula("friction"),
                        ".",
                    )
                ),
                Paragraph("A derivative belongs to one motion and one order of impacts.", is_note=True),
            ],
        ),
        ("Assumptions and what is left out", [assumptions()]),
    ]
    sections = [Section(k, title, tuple(blocks)) for k, (title, blocks) in enumerate(content, 1)]
    annex = Section(13, "Annex: the problem file", (Verbatim(f'[project]\ntitle = "{text}"\n'),), False)
    return Page(
        title=f"{text} podium",
        head={"Project": "2026-114", "Revision": text, "Author": "A. N. Example", "Date": date},
        verdict="Not verified: of 14 checks 3 pass, 2 fail.",
        notices=(
            ("C2 rests on ", Link("A7", "A7"), "."),
            text,
            ("Inputs without a source: 4 of 18 (", Code("structure.damping, joints.friction"), ")."),
            ("No check uses the sets of motions ", Code("near_fault"), "."),
        ),
        sections=(*sections, annex),
        subject=f"Checks of {text}",
        origin={
            "Problem file": (Code("example.toml"), ", SHA-256 d7d65884253b…"),
            "Command": (Code("rockjax report"),),
        },
        footer=f"{text} · rev. B · rockjax",
    )
