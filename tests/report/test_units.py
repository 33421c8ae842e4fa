"""Units of reports: their sizes, the selection of one unit per kind, and messages for invalid selections."""

import math

import pytest

from rockjax._report.units import KINDS, Units, in_unit, si_unit, to_si, unit_of_kind

# Sizes in SI from the definitions of the units.
SIZES = {
    ("force", "MN"): 1e6,
    ("length", "cm"): 0.01,
    ("displacement", "mm"): 0.001,
    ("angle", "deg"): math.pi / 180,
    ("acceleration", "g"): 9.80665,
    ("mass", "t"): 1000.0,
    ("stress", "MPa"): 1e6,
    ("moment", "kNm"): 1e3,
    ("stiffness", "MN/m"): 1e6,
    ("ratio", "%"): 0.01,
}


@pytest.mark.parametrize(("kind", "unit"), SIZES)
def test_size_of_a_unit(kind, unit):
    assert Units((unit,)).factor(kind) == SIZES[kind, unit]
    assert to_si(3.0, unit, kind) == 3.0 * SIZES[kind, unit]


def test_one_unit_of_a_kind_is_chosen():
    units = Units.parse("kN,m,deg,g,mm")
    chosen = {kind: units.unit(kind) for kind in ("force", "length", "displacement", "angle", "acceleration")}
    assert chosen == {"force": "kN", "length": "m", "displacement": "mm", "angle": "deg", "acceleration": "g"}
    assert units == Units.parse(["kN", "m", "°", "g", "mm"])
    assert Units.parse("mm, m").unit("length") == "m"  # any order is valid
    assert (Units.parse("cm").unit("length"), Units.parse("cm").unit("displacement")) == ("cm", "cm")
    assert units.symbol("angle") == "°"


def test_kinds_without_a_choice_have_their_usual_unit():
    units = Units()
    assert {kind: units.unit(kind) for kind in KINDS} == {kind: entry.usual for kind, entry in KINDS.items()}


def test_si_units_have_the_factor_one():
    units = Units.si()
    assert {units.factor(kind) for kind in KINDS} == {1.0}
    assert [units.unit(kind) for kind in KINDS] == [si_unit(kind) for kind in KINDS]


def test_gravity_is_that_of_the_file():
    assert Units(("g",), g=10.0).show(5.0, "acceleration") == 0.5
    assert to_si(0.5, "g", "acceleration", g=10.0) == 5.0


def test_a_number_and_its_unit_come_back():
    for value, unit, kind in ((20.0, "mm", "displacement"), (0.75, "%", "ratio"), (34.0, "MPa", "stress")):
        assert in_unit(to_si(value, unit, kind), unit, kind) == value


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ("kN,furlong", "'furlong' is not a known unit; known units include"),
        ("kn", "'kn' is not a known unit; did you mean 'kN'"),
        ("Mpa", "did you mean 'MPa'"),
        ("kPa,MPa", "stress has two units, kPa and MPa; give one of them"),
        ("m,cm,mm", "at most two different units of length are possible, got m, cm, mm"),
        ("m,m", "at most two different units of length"),
    ],
)
def test_units_that_cannot_be_chosen(names, message):
    with pytest.raises(ValueError, match=message):
        Units.parse(names)


def test_gravity_is_positive():
    for g in (0.0, -9.8, math.nan, math.inf):
        with pytest.raises(ValueError, match="g must be positive and finite"):
            Units(g=g)


def test_the_unit_of_a_limit_is_of_its_kind():
    with pytest.raises(ValueError) as error:
        to_si(5.0, "mm", "ratio", owner="checks[5].unit", subject="peak-drift-ratio")
    assert str(error.value) == "checks[5].unit: peak-drift-ratio is a ratio, got 'mm'; use '%' or '–'"
    with pytest.raises(ValueError, match=r"the value is an acceleration, got 'mm'; use 'g' or 'm/s²'"):
        to_si(5.0, "mm", "acceleration")
    assert to_si(5.0, "m/s2", "acceleration") == to_si(5.0, "m/s^2", "acceleration") == 5.0
    assert unit_of_kind("m/s^2", "acceleration") == "m/s²"
    assert to_si(5.0, "-", "ratio") == to_si(5.0, "1", "ratio") == 5.0
