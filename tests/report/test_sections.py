"""Cells and formulas of sections, from made-up motions, windows, histories and results."""

import dataclasses
import html
import os
import signal
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray

import rockjax as rj
from rockjax._practice.registry import METHODS
from rockjax._problem.reading import Reader
from rockjax._report import formulas
from rockjax._report.assemble import _unused_keys
from rockjax._report.blocks import Figure, Pair
from rockjax._report.evaluation import Check
from rockjax._report.kinds import KINDS
from rockjax._report.plausibility import warnings_of
from rockjax._report.problem import MotionSet
from rockjax._report.report import _write_both
from rockjax._report.sections import assumptions, influences, instants, methods, motions, rocking, summary
from rockjax._report.sections.accuracy import open_energy
from rockjax._report.sections.common import column_offsets, in_page_units, in_pairs, stored_figure
from rockjax._report.sections.force_equations import contact_area, in_weights, total_weight
from rockjax._report.sections.structure import column_count
from rockjax._report.store import Store
from rockjax._report.tables import Quantity, format_number, plain
from rockjax._report.units import Units


def record(samples=(0.0, 1.0, -1.0, 0.0), vertical=None, **metadata):
    acceleration = np.array(samples) if len(samples) > 4 else np.repeat(samples, 50)
    return rj.Motion(acceleration, 0.01, "record", None, metadata, vertical=vertical)


def test_every_method_has_its_formula():
    assert methods.FORMULAS.keys() == METHODS.keys()
    for name, names in methods.FORMULAS.items():
        assert [formulas.source(y) for y in names] == [METHODS[name].equation] * len(names)


def test_corrections_and_warnings_of_records():
    """The header of a file names filters and processing; a drift of the baseline is a warning."""
    assert motions._corrections(record()).state == "none"
    filtered = motions._corrections(record(processing="uncorrected", high_pass_Hz=0.1, low_pass_Hz=25.0))
    assert filtered.text == "uncorrected; high pass 0.1 Hz; low pass 25 Hz"
    drifting = motions._corrections(record((0.0, 1.0, 1.0, 0.0)))
    assert drifting.state == "undecided"
    assert "its baseline drifts" in drifting.text
    below = motions._corrections(record(vertical=record((0.0, 1.0, 1.0, 0.0))))
    assert "warning, vertical component" in below.text


def test_motions_have_whole_hashes_and_vertical_components():
    member = record(vertical=record((0.0, 0.5, -0.5, 0.0)))
    of_set = MotionSet("design", "475 years", (member, record()), ("a", "b"))
    table = motions._hashes(of_set)
    assert [len(row[1].text[0].text) for row in table.rows] == [64, 64]
    assert len(table.rows[0][2].text[0].text) == 64
    assert table.rows[1][2].state == "none"
    cells = motions._cells(member, 2.0, None, True)
    assert (cells[2].value, cells[7].value) == (1.0, 0.5)


def test_narrow_windows_of_overturning_are_shown():
    values = {"factor": [1.0214, np.inf], "survives_from": [1.02182, np.nan]}
    values |= {"overturns_again_from": [np.nan, np.nan], "end": [0.5, 5.0], "window_end": [2.0428, np.nan]}
    values["is_open"] = [True, False]
    windows = xarray.Dataset({name: ("motion", y) for name, y in values.items()})
    factor, width, survives, again = rocking._window_cells(windows, 0)
    assert width.value == pytest.approx(0.00042 / 1.0214)
    assert width.kind == "ratio"
    assert factor.is_input  # six digits
    assert factor.note == "or less: known up to 0.5 only"  # scenes at lower factors did not finish
    assert survives.is_input
    assert again.text == "none up to 2.04"
    assert [cell.text for cell in rocking._window_cells(windows, 1)] == ["none up to 5", *["none"] * 3]


def test_pulses_have_intensity_measures():
    """PGV and PGD of a Ricker pulse a_p (1 − 2x) exp(−x), x = (πt/T)², are those of its integrals
    a_p t exp(−x) and −a_p T²/(2π²) exp(−x). An oscillator of a short period moves with the ground."""
    a_p, T = 2.0, 1.5
    *_, pga, pgv, pgd, spectral, ratio, _ = motions._cells(rj.Ricker(a_p, T), 4.0, 0.01, False)
    assert pga.value == pytest.approx(a_p, rel=1e-12)
    assert pgv.value == pytest.approx(a_p * T / (np.pi * np.sqrt(2 * np.e)), rel=1e-5)
    assert pgd.value == pytest.approx(a_p * T**2 / (2 * np.pi**2), rel=1e-5)
    assert spectral.value == pytest.approx(a_p, rel=1e-3)
    assert ratio.value == pytest.approx(0.5)


def test_spectra_of_pulses_and_records_are_drawn():
    members = rj.Ricker(2.0, 1.5), record()
    of_set = MotionSet("design", "475 years", members, ("a $pulse", "b" * 400))
    figure = motions._draw_spectra(of_set, 5.0, 0, Units.parse("g"))
    assert "T₁ = 5 s" in figure.svg
    assert "a $pulse" in figure.svg
    assert "S_a [g]" in figure.svg
    values = [rj.intensity_measures(motions.as_record(y), periods=[5.0])["Sa"].item() for y in members]
    assert plain(figure.description, Units.parse("g")).endswith(
        f"the mean at T_1 = 5 s is {np.mean(values) / 9.80665:.4g}\xa0g."
    )
    assert "a $pulse, with the largest rotation" in figure.caption


def test_a_picture_that_cannot_be_drawn_is_a_note():
    evaluation = SimpleNamespace(scenes=SimpleNamespace(store=Store()))

    def fail():
        raise ValueError("no axes")

    note = stored_figure(evaluation, "history", 1, fail)
    assert plain(note.text, Units.si()) == "The picture history is missing: ValueError: no axes"
    figure = Figure("<svg>", "caption", "title", "description")
    assert in_pairs([figure, figure, note, figure]) == [Pair(figure, figure), note, figure]


def made_windows(**changes):
    values = {"factor": 1.0214, "survives_from": 1.02182, "overturns_again_from": np.nan}
    return xarray.Dataset(values | {"end": 10.0, "window_end": 2.0428, "is_open": False} | changes)


def test_factors_on_the_governing_motion_are_drawn():
    """The picture has a point for each scene that survives, and counts those that did not finish."""
    peaks = xarray.Dataset(
        {
            "peak_rotation": ("motion", [0.1, 0.4, 1.0, 0.0]),
            "overturned": ("motion", [False, False, True, False]),
            "result": ("motion", [0, 0, 1, 6]),
        }
    )
    data = rocking._analysis_of_factors(peaks, np.array([0.4, 0.8, 1.2, 1.6]), made_windows(), 1.0)
    np.testing.assert_array_equal(data["boundaries"].values, [[1.0214, 1.02182, np.nan]])
    lines = {1.0: "as given", 1.5: "limit of C4 $x_y"}
    figure = rocking._draw_analysis(data, "factors", "title", "description", "caption", lines, Units.si())
    texts = html.unescape(figure.svg)
    assert all(text in texts for text in ("as given", "limit of C4 $x_y", "boundaries of survival windows"))
    assert "left out: 1 of 4 scenes, which did not finish" in texts


@pytest.mark.parametrize("last", [1.2, 1.65, 3.2, 10.0])
def test_factors_of_the_picture_include_the_motion_as_given(last):
    factors = rocking._factors_up_to(last)
    assert factors.size == rocking.FACTORS
    assert 1.0 in factors
    assert factors[-1] == last
    assert np.all(np.diff(factors) > 0.4 * last / factors.size)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, "the least factor that overturns the columns is 1.0214; they survive again from 1.02182"),
        (
            {"is_open": True, "end": 0.5, "survives_from": np.nan},
            "the least factor that overturns the columns is 1.0214, or less, because scenes above 0.5 did "
            "not finish",
        ),
        ({"factor": np.inf, "survives_from": np.nan}, "no factor up to 10 overturns the columns"),
    ],
)
def test_the_picture_of_factors_names_the_least_one(changes, text):
    assert rocking._windows_text(made_windows(**changes)) == text


def test_pictures_have_the_units_of_the_page():
    """Intensities are converted, and probabilities are not."""
    unit = {"units": "m s-2"}
    variables = {"capacity": ("record", [9.80665], unit), "probability": ("at", [0.5], {"units": "1"})}
    curve = xarray.Dataset(variables, {"at": ("at", [19.6133], unit)}, {"median": 9.80665})
    data = in_page_units(curve, Units.parse("g"))
    assert (data["at"].item(), data["at"].attrs["units"]) == (2.0, "g")
    assert (data["capacity"].item(), data["probability"].item(), data.attrs["median"]) == (1.0, 0.5, 1.0)


def test_derivatives_of_the_summary_have_two_digits():
    numbers = {-54.27: "−54", 9.996: "+10", 0.99999: "+1.0", -0.0456: "−0.046", 120.0: "+120", 0.0: "+0.0"}
    units = Units.si(9.81)
    assert {y: format_number(Quantity(y, "derivative"), units) for y in numbers} == numbers


def made_history():
    """Return a history of two columns in which the left joint opens at the top after 2 s."""
    times = np.arange(5.0)
    axial = np.full((5, 2, 2), 3.0)
    axial[2, 0, 1], axial[3, 0, 1], axial[1, 1, 0] = -1.0, -2.0, 7.0
    shear = np.full((5, 2, 2), 0.5)
    with np.errstate(divide="ignore"):
        friction = np.where(axial < 0, np.inf, shear / axial)
    joints, ones = ("time", "column", "joint"), np.ones(5)
    drift = np.outer([0.0, 1.0, -3.0, 2.0, np.nan], [1.0, 0.5])
    variables = {
        "joint_axial_force": (joints, axial),
        "joint_shear": (joints, shear),
        "joint_friction": (joints, friction),
        "joint_eccentricity": ("time", -ones),
        "overturning_moment": ("time", 4 * ones),
        "foundation_shear": ("time", np.array([0, 0.1, 0.2, -0.4, 0.0])),
        "drift": (("time", "story"), drift),
        "impact_times": ("impact", [1.5, 2.5]),
        "theta_dot_before": ("impact", [1.0, -0.5]),
        "theta_dot_after": ("impact", [0.9, -0.1]),
    }
    return xarray.Dataset(variables, coords={"time": times})


def test_instants_of_a_history():
    podium = rj.Podium(0.2, 2.0, 5.0)
    found = instants.find_instants(podium, made_history())
    least, largest = found["least_axial_force", 1], found["peak_axial_force", 0]
    assert (least.time, least.column, least.axial, least.mean_axial) == (3.0, 0, -2.0, 0.5)
    assert (largest.time, largest.column, largest.axial) == (1.0, 1, 7.0)
    assert found["opening", -1].time == found["peak_friction", 1].time == 2.0
    assert found["peak_foundation_shear", -1].time == 3.0
    assert [found["peak_drift", k].time for k in (0, 1)] == [2.0, 2.0]
    assert found["peak_velocity_jump", -1].time == 2.5
    assert (least.moment, least.eccentricity) == (4.0, -1.0)


def test_extremes_are_those_of_scenes_that_survive():
    variables = {
        "least_axial_force": (("motion", "joint"), [[1.0, 2.0], [0.0, 3.0], [-9.0, -9.0]]),
        "peak_friction": (("motion", "joint"), [[0.1, 0.2], [0.4, 0.3], [9.0, 9.0]]),
        "peak_foundation_shear": ("motion", [0.5, 0.1, 9.0]),
        "overturned": ("motion", [False, False, True]),
        "result": ("motion", [0, 0, 0]),
    }
    found = list(instants.extremes_of(xarray.Dataset(variables)))
    assert found == [
        ("least_axial_force", 0, 1),
        ("least_axial_force", 1, 0),
        ("peak_friction", 0, 1),
        ("peak_foundation_shear", -1, 0),
    ]


def test_changes_name_what_overturns():
    """The summary and section 8 name the motion that overturns with a changed input."""
    entry = SimpleNamespace(id="C1", motions="set", keys=SimpleNamespace(name="p"))
    kind = SimpleNamespace(name="contact-pressure", has_limit=True, is_minimum=False)
    spread = {"width": (np.inf, 0.5), "height": (0.6, np.inf)}
    events = {("width", 0): "overturned (M9)", ("height", 1): "joint opens (M3)"}
    check = Check(entry, kind, "PASS", utilisation=0.6, spread=spread, spread_events=events)
    text = plain(summary._spread(check), Units.si())
    assert text == "from 0.50; overturned (M9) with width −; joint opens (M3) with height +"
    events["height", 1] = "overturned (M9)"  # the same event with two inputs
    text = plain(summary._spread(check), Units.si())
    assert text == "from 0.50; overturned (M9) with width −, height +"
    rows = {row[0].text: row for row in influences._table(check, 0.05).rows}
    assert (rows["width"][2].text, rows["width"][2].state) == ("overturned (M9)", "overturned")
    assert rows["height"][2].value == 0.6
    for name in ("limit", "joints.contact_width", "joints.contact_depth"):  # U is inversely proportional
        assert [cell.value for cell in rows[name][1:]] == [-1, 0.6 / 0.95, 0.6 / 1.05]


def test_derivatives_of_annual_frequencies_and_medians(monkeypatch):
    """U is proportional to the frequency, and inversely proportional to the median."""
    kinds = KINDS["annual-frequency"], KINDS["median-capacity"]
    slopes = {"sensitivity": ("parameter", [-3.0, 0.9, -4.62, 0.1])}
    annual = xarray.Dataset(slopes, coords={"parameter": ["median", "dispersion", "alpha", "gamma"]})
    monkeypatch.setattr(type(kinds[0]), "_annual", lambda *_: annual)
    assert kinds[0].known_slopes(None, None) == {"alpha": -4.62, "gamma": 0.1}
    curve = xarray.Dataset({"median_sensitivity": ("parameter", [1.02])}, coords={"parameter": ["alpha"]})
    monkeypatch.setattr(type(kinds[1]), "curve", lambda *_: curve)
    assert kinds[1].known_slopes(None, None) == {"alpha": -1.02}


def test_open_energy_of_a_history():
    variables = {
        "initial_energy": 1.0,
        "input_energy": ("time", [0.0, 4.0]),
        "mechanical_energy": ("time", [1.0, 2.0]),
        "impact_energy": ("time", [0.0, 1.0]),
        "damping_energy": ("time", [0.0, 1.5]),
    }
    assert open_energy(xarray.Dataset(variables)) == (0.5, 4.0)


def warned(problem, *checks, **changes):
    """Return the plausibility warnings of a problem with made-up checks, as plain texts."""
    problem = dataclasses.replace(problem, **changes)
    evaluation = SimpleNamespace(problem=problem, checks=checks)
    return [plain(text, Units.si()).replace("\N{NO-BREAK SPACE}", " ") for text in warnings_of(evaluation)]


def made_check(kind, limit=1.0, utilisation=0.5, statistic="max", motions=None):
    return SimpleNamespace(
        id="C1",
        kind=SimpleNamespace(name=kind),
        limit=limit,
        utilisation=utilisation,
        statistic=statistic,
        motions=motions,
    )


@pytest.fixture(scope="module")
def eight_storeys():
    return rj.read_problem(Path(__file__).parents[2] / "docs" / "reports" / "eight-storeys.toml")


def test_numbers_in_the_usual_range_are_not_warned_of(eight_storeys):
    checks = [made_check("peak-drift", 0.02), made_check("peak-drift-ratio", 0.0075)]
    assert warned(eight_storeys, *checks) == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"column_mass": 4.725}, "The columns have 2.500 kg/m³; 300 to 8000 kg/m³ are usual"),
        ({"column_mass": 4.725e5}, "The mean stress of the columns is 2.447·10⁸ Pa"),
        ({"story_stiffnesses": [1e13] * 8}, "The first period of the building is"),
        ({"story_stiffnesses": [1e5] * 8}, "The first period of the building is"),
        ({"damping": 5.0}, "The largest damping ratio of the building is 5.000; at most 0.3"),
    ],
)
def test_implausible_structures(eight_storeys, changes, message):
    """Masses in tonnes, stiffnesses in other units than N/m, and damping in percent."""
    structure = eight_storeys.structure.model_copy(update=changes)
    if "column_mass" in changes:
        texts = warned(eight_storeys, structure=structure)
    else:
        podium = Reader().structure(structure)
        texts = warned(eight_storeys, structure=structure, podium=podium)
    assert any(text.startswith(message) for text in texts), texts


@pytest.mark.parametrize(
    ("check", "message"),
    [
        (made_check("peak-drift", 0.5), "The limit of C1 exceeds a tenth of a storey height"),
        (made_check("peak-drift-ratio", 0.75), "The limit of C1 exceeds a tenth of the height"),
        (made_check("peak-shear", utilisation=0.004), "The utilisation of C1 is below 0.01"),
        (made_check("peak-shear", statistic="mean", motions="near_fault"), "C1 is a mean over 3 motions"),
    ],
)
def test_implausible_checks(eight_storeys, check, message):
    (text,) = warned(eight_storeys, check)
    assert text.startswith(message)


def test_keys_that_no_check_uses_are_named(eight_storeys):
    kind = SimpleNamespace(name="peak-rotation", is_of_joints=False)
    evaluation = SimpleNamespace(problem=eight_storeys, checks=[SimpleNamespace(kind=kind)])
    expected = ["joints.contact_width", "joints.contact_depth", "fragility", "risk"]
    assert list(_unused_keys(evaluation)) == expected  # assumption A1 uses the friction
    tables = {name: getattr(eight_storeys, name) for name in ("joints", "fragility", "risk")}
    evaluation.problem = SimpleNamespace(podium=SimpleNamespace(elevation=None), **tables)
    assert list(_unused_keys(evaluation)) == ["joints.friction", *expected]
    kinds = (("peak-friction", True), ("contact-pressure", True), ("annual-frequency", False))
    used = [SimpleNamespace(kind=SimpleNamespace(name=y, is_of_joints=z)) for y, z in kinds]
    assert list(_unused_keys(SimpleNamespace(problem=eight_storeys, checks=used))) == []


def test_a_page_and_its_numbers_are_written_together(tmp_path):
    """If one of the two files cannot be written, the other one keeps its old content."""
    page, numbers = tmp_path / "page.html", tmp_path / "page.json"
    page.write_text("old")
    numbers.mkdir()  # cannot be replaced by a file
    with pytest.raises(OSError, match=r"page\.json"):
        _write_both((page, b"new"), (numbers, b"new"))
    assert page.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] in (
        ["page.html", "page.json"],
        ["page.json", "page.html"],
    )
    numbers.rmdir()
    assert _write_both((page, b"new"), (numbers, b"1")) == [page, numbers]
    assert (page.read_text(), numbers.read_text()) == ("new", "1")
    page.unlink()
    page.mkdir()
    with pytest.raises(OSError, match=r"page\.html"):
        _write_both((page, b"newer"), (numbers, b"2"))
    assert numbers.read_text() == "1"
    numbers.unlink()
    with pytest.raises(OSError, match=r"page\.html"):
        _write_both((page, b"newer"), (numbers, b"2"))
    assert not numbers.exists()


def test_ctrl_c_does_not_come_between_a_page_and_its_numbers(tmp_path, monkeypatch):
    replace = os.replace

    def interrupted(*paths):
        replace(*paths)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("rockjax._files.os.replace", interrupted)
    page, numbers = tmp_path / "page.html", tmp_path / "page.json"
    with pytest.raises(KeyboardInterrupt):
        _write_both((page, b"new"), (numbers, b"1"))
    assert (page.read_text(), numbers.read_text()) == ("new", "1")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize(
    ("results", "state"),
    [((), "not tested"), (("PASS",), "holds"), (("PASS", "FAIL"), "violated"), (("NOT VALID",), "undecided")],
)
def test_sharp_edges_are_tested_by_contact_pressures(results, state):
    kind = SimpleNamespace(name="contact-pressure")
    checks = [
        SimpleNamespace(id=f"C{k}", kind=kind, values=(), result=word, utilisation=0.89)
        for k, word in enumerate(results)
    ]
    cell, text = assumptions._contact_pressure(SimpleNamespace(checks=checks))
    assert cell.state == state
    shown = plain(text, Units.si())
    assert all(f"C{k}: U = 0.89, {word}." in shown for k, word in enumerate(results))


def test_columns_are_measured_from_their_mean(eight_storeys):
    podium = eight_storeys.podium
    np.testing.assert_array_equal(column_offsets(podium), np.asarray(podium.elevation.offsets))
    assert column_count(eight_storeys) == 16
    total = 16 * (1 + 5.291005291 + 26.984126984)
    assert total_weight(eight_storeys) == pytest.approx(total, rel=1e-9)
    assert in_weights(eight_storeys, 1.0).value == pytest.approx(4725 * 9.80665)
    assert contact_area(eight_storeys) == pytest.approx(0.135)


def test_derivatives_that_are_unknown_or_rounding_errors_are_left_out():
    check = SimpleNamespace(value=1.0, utilisation=0.5, no_slopes="no derivative")
    rounding = {"column_mass": -3e-12}
    for known, text in (
        ({"gamma": 0.5} | rounding, "gamma +0.50"),
        (rounding, "all derivatives are 0"),
        ({}, "no derivative"),
    ):
        check.sensitivities = {"alpha": float("nan")} | known
        assert plain(summary._slopes(check), Units.si(9.81)) == text
