"""Cells and formulas of sections, from made-up motions, windows, histories and results."""

import numpy as np
import pytest
import xarray

import rockjax as rj
from rockjax._practice.registry import METHODS
from rockjax._report import formulas
from rockjax._report.problem import MotionSet
from rockjax._report.sections import instants, methods, motions, rocking
from rockjax._report.sections.accuracy import open_energy


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
    cells = motions._cells(member, 2.0, None)
    assert (cells[2].value, cells[7].value) == (1.0, 0.5)


def test_narrow_windows_of_overturning_are_shown():
    values = {"factor": [1.0214, np.inf], "survives_from": [1.02182, np.nan]}
    values |= {"overturns_again_from": [np.nan, np.nan], "end": [10.0, 5.0], "window_end": [2.0428, np.nan]}
    windows = xarray.Dataset({name: ("motion", y) for name, y in values.items()})
    factor, width, survives, again = rocking._window_cells(windows, 0)
    assert width.value == pytest.approx(0.00042 / 1.0214)
    assert width.kind == "ratio"
    assert factor.is_input  # six digits
    assert survives.is_input
    assert again.text == "none up to 2.04"
    assert [cell.text for cell in rocking._window_cells(windows, 1)] == ["none up to 5", *["none"] * 3]


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


def test_open_energy_of_a_history():
    variables = {
        "initial_energy": 1.0,
        "input_energy": ("time", [0.0, 4.0]),
        "mechanical_energy": ("time", [1.0, 2.0]),
        "impact_energy": ("time", [0.0, 1.0]),
        "damping_energy": ("time", [0.0, 1.5]),
    }
    assert open_energy(xarray.Dataset(variables)) == (0.5, 4.0)
