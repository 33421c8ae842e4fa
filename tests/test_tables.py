"""Tables as text and HTML, and the display of structures, motions and options in notebooks."""

import dataclasses
import re

import jax
import numpy as np
import pytest

import optimise
import rockjax as rj
from rockjax._text import tables
from rockjax._text.representations import format_html

SHOWN = (
    rj.Podium(0.15, 1.5, 10.0, rj.Elastic(100.0, 0.5)),
    rj.Elastic(100.0, 0.5),
    rj.Rigid(3.0),
    rj.Elevation((-3.0, 3.0), 0.6, 8.4),
    optimise.Dimensions(width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3),
    rj.Options(),
    rj.Ricker(3.7, 1.0),
    rj.AntisymmetricRicker(3.7, 1.0),
    rj.HalfSine(3.7, 1.0),
    rj.MavroeidisPapageorgiou(1.0, 1.0, 2.0, 0.5),
    rj.Gabor(1.0, 1.0, 0.5, 0.2),
    rj.Record([1.0, -2.0, 3.0], 0.01),
)


def cells(html: str) -> list[list[str]]:
    return [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in re.findall(r"<tr>(.*?)</tr>", html)]


@pytest.mark.parametrize("shown", SHOWN, ids=lambda shown: type(shown).__name__)
def test_every_number_is_shown_with_its_meaning(shown):
    """The meanings come from the registry of parameters and the models of problem files."""
    rows = {name: (value, meaning) for name, value, meaning in cells(shown._repr_html_())}
    names = [field.name for field in dataclasses.fields(shown) if field.name[0] != "_"]
    for name in names:
        value, meaning = rows[name]
        assert value
        given = getattr(shown, name)
        assert meaning or not isinstance(given, float | jax.Array) or np.ndim(given), name
    assert f"<caption>{type(shown).__name__}</caption>" in shown._repr_html_()


def test_a_podium_shows_its_superstructure_and_derived_values():
    podium = rj.Podium.from_dimensions(
        width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3, top_mass=300e3, period=0.5
    )
    rows = {row[0]: row[1:] for row in cells(podium._repr_html_())}
    assert rows["superstructure.eta"] == ["100", "Mass ratio of the superstructure η = m_t/(N m_c) [–]"]
    assert rows["width"] == ["0.45", "Full width of a column 2B [m]"]
    assert rows["p"] == [f"{float(podium.p):.6g}", "Frequency parameter p [rad/s]"]
    standing = podium.replace(elevation=rj.Elevation([0.0, 6.0]))
    rows = {row[0]: row[1:] for row in cells(standing._repr_html_())}
    assert rows["elevation.columns"][1] == "Position of the column x [m]"
    bare = {row[0]: row[1] for row in cells(podium.replace(superstructure=None)._repr_html_())}
    assert bare["superstructure"] == "None"
    assert "superstructure.eta" not in bare


def test_dimensions_are_shown_as_numbers():
    column = optimise.Dimensions(
        width=np.float64(0.45), height=jax.numpy.asarray(3.0), column_mass=1.5e3, period=None
    )
    assert repr(column).startswith(
        "Dimensions(width=0.45, height=3, column_mass=1500, beam_mass=0, columns=None,"
    )


def test_batches_and_traced_numbers_are_shown_as_such():
    assert "array(shape (2,), 1 … 3)" in rj.Ricker(np.array([1.0, 3.0]), 1.0)._repr_html_()
    seen = []
    jax.jit(lambda a: seen.append(format_html(rj.Ricker(a, 1.0))) or a)(2.0)
    assert seen[0].count("traced") == 1


def test_text_is_escaped_and_aligned():
    rows = [("name", "value"), ("a < b", "1.25"), ("c", "10")]
    assert tables.align_rows(rows) == ["name   value", "a < b  1.25", "c      10"]
    assert tables.align_rows(rows, numbers=True) == ["name   value", "a < b   1.25", "c         10"]
    made = tables.html(rows, caption="<x>", headings="row")
    assert "<caption>&lt;x&gt;</caption>" in made
    assert "a &lt; b" in made
    assert made.count("<th") == 2
    assert made.count("<td") == 4
    assert 'colspan="2">only</td>' in tables.html([("only", "")])
