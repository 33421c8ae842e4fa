"""Headings of columns: quantity, unit and investigation time."""

import pytest

from rockjax._motions.headings import parse_heading
from rockjax._units import unit_of


@pytest.mark.parametrize(
    ("text", "quantity", "kind", "unit", "years"),
    [
        ("PGA [g]", "PGA", "acceleration", "g", None),
        ("pga (CM/S^2)", "PGA", "acceleration", "cm/s2", None),
        ("Acc, cm/sec/sec", "Acc", "acceleration", "cm/s2", None),
        ("a / g", "a", "acceleration", "g", None),
        ("accel_mg", "accel", "acceleration", "mg", None),
        ("acc_m_s2", "acc", "acceleration", "m/s2", None),
        ("Acc NS_cmps2", "Acc NS", "acceleration", "cm/s2", None),
        ("PGV_cm_s", "PGV", "velocity", "cm/s", None),
        ("time_s", "time", "time", "s", None),
        ("Acceleration m s-2", "Acceleration", "acceleration", "m/s2", None),
        ("N-S [gal]", "N-S", "acceleration", "gal", None),
        ("UD (m/s²)", "UD", "acceleration", "m/s2", None),
        ("Acc (N-S) [g]", "Acc (N-S)", "acceleration", "g", None),
        (
            "a_g",
            "a_g",
            "acceleration",
            None,
            None,
        ),  # a_g is the ground acceleration of Eurocode 8, not a unit g
        ("N S", "N S", "", None, None),  # N S is a direction, not a unit of time
        ("TIME [MS]", "TIME", "time", "ms", None),
        ("Time (msec)", "Time", "time", "ms", None),
        ("t / µs", "t", "time", "us", None),
        ("time in s", "time", "time", "s", None),
        ("", "", "index", None, None),
        ("Unnamed: 0", "Unnamed: 0", "index", None, None),
        ("[s]", "", "time", "s", None),
        ("vel, cm/s", "vel", "velocity", "cm/s", None),
        ("Sa(0.30) (g)", "Sa(0.3 s)", "acceleration", "g", None),
        ("SA(T1=1.0 s), g", "Sa(1 s)", "acceleration", "g", None),
        ("probability of exceedance in 50 years", "probability of exceedance", "probability", None, 50),
        ("PoE (50 yr)", "PoE", "probability", None, 50),
        ("poe_475y [%]", "poe", "probability", "%", 475),
        ("annual probability of exceedance", "annual probability of exceedance", "probability", None, 1),
        ("probability of exceedance", "probability of exceedance", "probability", None, None),
        ("annual_rate", "annual_rate", "rate", None, None),
        ("Mean annual frequency (1/yr)", "Mean annual frequency", "rate", "1/year", None),
        ("return period [years]", "return period", "return period", "year", None),
        ("Acc [cm/s²] corrected", "Acc corrected", "acceleration", "cm/s2", None),
        ("Acc (gal) N-S", "Acc N-S", "acceleration", "gal", None),
        ("Acc (1) N-S", "Acc (1) N-S", "acceleration", None, None),
        ("Peak Ground Acceleration (m/s2)", "PGA", "acceleration", "m/s2", None),
        ("tiempo (seg)", "tiempo", "time", "s", None),
        ("Wiederkehrperiode [Jahre]", "Wiederkehrperiode", "return period", "year", None),
        ("Wahrscheinlichkeit in 50 Jahren", "Wahrscheinlichkeit", "probability", None, 50),
        ("Probabilité de dépassement en 50 ans", "Probabilité de dépassement", "probability", None, 50),
        ("AEP [%]", "AEP", "probability", "%", 1),
        ("annual_freq", "annual_freq", "rate", None, None),
    ],
)
def test_headings_say_quantity_unit_and_years(text, quantity, kind, unit, years):
    found = parse_heading("file.csv:1", text)
    assert (found.quantity, found.kind, found.unit, found.years) == (quantity, kind, unit, years)
    assert found.text == text


@pytest.mark.parametrize(
    "text",
    [
        "acc [furlongs]",
        "Time (UTC)",
        "time (ns)",
        "Time (h)",
        "Acc (cm/s)",
        "time [g]",
        "PGV [m/s2]",
        "rate [g]",
    ],
)
def test_headings_that_are_not_understood_are_quoted(text):
    with pytest.raises(ValueError, match=r"^file\.csv:1: ") as error:
        parse_heading("file.csv:1", text)
    assert repr(text) in str(error.value)


def test_units_in_many_spellings():
    for text in ("m/s/s", "M/S^2", "m s-2", "ms-2", "m/sec2", "m/s**2", "m·s⁻²", "[m/s²]"):
        assert unit_of(text) == "m/s2"
    for text in ("m_s2", "m_s_s", "mps2", "M_S^2", "mps^2"):
        assert unit_of(text) == "m/s2"
    spellings = {
        "cm_s": "cm/s",
        "mmps": "mm/s",
        "ms": "ms",
        "N_S": None,
        "G": "g",
        "g's": "g",
        "Gals": "gal",
        "CM/SEC/SEC": "cm/s2",
        "mG": "mg",
        "furlong": None,
        "": None,
    }
    assert {text: unit_of(text) for text in spellings} == spellings
