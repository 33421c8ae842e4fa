"""Pairs of horizontal and vertical motions: components of stations, tables of pairs, spectra, files."""

import dataclasses

import numpy as np
import pytest

import rockjax as rj
from rockjax._motions.convert import as_records
from rockjax._problem.models import Problem
from rockjax._problem.reading import Reader

FRAME = rj.Podium(0.15, 1.5, 10.0)
OPTIONS = rj.Options(outputs=("peak_rotation",))


def named(name: str, k: int = 0, factor: float = 1.0, **metadata) -> rj.Motion:
    samples = factor * np.sin(np.linspace(0, 2 * np.pi * (4 + k), 61)) * 3.0
    return rj.Motion(samples, 0.05, name, metadata=metadata)


def test_components_of_stations_by_their_headers():
    suite = rj.Motions(
        (
            named("a", 0, station="A", component="000"),
            named("b", 1, 0.5, station="A", component="UP"),
            named("c", 2, station="B", component="H1"),
            named("d", 3, 0.5, station="B", component="DWN"),
            named("e", 4, station="A", component="090"),
        )
    )
    pairs = suite.paired()
    assert pairs.names == ["a", "c", "e"]
    assert [pair.vertical.name for pair in pairs if pair.vertical] == ["b", "d", "b"]
    vertical = pairs[1].vertical
    assert vertical is not None
    np.testing.assert_array_equal(vertical.acceleration, -suite[3].acceleration)  # upwards


def test_components_of_stations_by_the_names_of_files():
    pairs = rj.Motions((named("RSN1_ABC000"), named("RSN1_ABC-UP", 1), named("RSN10_X1"), named("RSN10_X-V")))
    assert [pair.vertical and pair.vertical.name for pair in pairs.paired()] == ["RSN1_ABC-UP", "RSN10_X-V"]
    borehole = [named(c + d, station="K", component=c + d) for d in "12" for c in ("EW", "UD")]
    assert [y.vertical and y.vertical.name for y in rj.Motions(tuple(borehole)).paired()] == ["UD1", "UD2"]
    with pytest.raises(
        ValueError, match="paired: 1 motions do not match exactly one vertical motion\n  other: has no"
    ):
        rj.Motions((named("RSN1_ABC000"), named("RSN1_ABC-UP"), named("other"))).paired()
    with pytest.raises(ValueError, match="matches UP1, UP2"):
        rj.Motions((
            named("H", station="K", component="H"), named("UP1", station="K", component="UP"),
            named("UP2", station="K", component="UP"),
        )).paired()  # fmt: skip


def test_names_are_not_divided_within_numbers():
    suite = (named("A1"), named("A1-UP"), named("A10"), named("A1_2"))
    with pytest.raises(ValueError, match=r"1 motions do not .*\n  A10: has no vertical motion$"):
        rj.Motions(suite).paired()
    others = (*suite[:2], suite[3], named("A1140"))
    assert rj.Motions(others).paired().names == ["A1", "A1_2", "A1140"]


def test_selected_and_scaled_pairs_become_complete_tables():
    suite = [dataclasses.replace(named(f"m{k}", k), vertical=named("v", k + 3, 0.6)) for k in range(3)]
    pairs, names = as_records("", suite)
    assert names == ["m0", "m1", "m2"]
    table, _ = as_records("", pairs.pick([2, 0]).scaled(2.0))
    assert len(table) == 2
    for part in ("horizontal", "vertical"):
        found, original = getattr(table, part), np.asarray(getattr(pairs, part).acceleration)
        np.testing.assert_array_equal(found.acceleration, 2 * original[[2, 0]])
        np.testing.assert_array_equal(found.which, [0, 1])
        assert found.scale == 1
    with pytest.raises(ValueError, match=r"IDA: records must be a table of shape \(k,\), got shape \(3, 1\)"):
        as_records("IDA", pairs.pick(np.arange(3)[:, None]))


@pytest.mark.parametrize(
    "names",
    [
        ("N-S", "E-W", "U-D"), ("NS", "EW", "UD"), ("N", "E", "VRT"), ("HNN", "HNE", "VERT."),
        ("BHN00", "BHE00", "BHZ00"), ("H1", "H2", "UP-DOWN"), ("000", "090", "Vertical"),
        ("EW1", "NS1", "UD1"),
        ("00.HNN", "00.HNE", "00.HNZ"), ("X", "Y", "Z"), ("Long", "Tran", "Dn"), ("L", "T", "V"),
        ("CHAN 1: 360", "CHAN 2: 090", "CHAN 3: VERT"), ("Acc NS", "Acc EW", "Acc UD"),
        ("1 (N)", "2 (E)", "3 (UP)"),
        ("AZ 000", "AZ 090", "Vertikal"), ("A.HNN", "A.HNE", "A.DWN"),
    ],
)  # fmt: skip
def test_vertical_components_under_the_names_of_networks(names):
    motions = [named(name, k, station="A", component=name) for k, name in enumerate(names)]
    pairs = rj.Motions(tuple(motions)).paired()
    assert pairs.names == list(names[:2])
    sign = -1 if names[2] in ("Dn", "A.DWN") else 1
    for pair in pairs:
        assert pair.vertical is not None
        np.testing.assert_array_equal(pair.vertical.acceleration, sign * motions[2].acceleration)


@pytest.mark.parametrize("end", ["-VRT", "_U-D", ".BHZ00", "_VERT", "-UD2", "_DOWN", "HNZ"])
def test_vertical_components_by_the_ends_of_names(end):
    pairs = rj.Motions((named("RSN1_ABC000"), named(f"RSN1_ABC{end}", 1))).paired()
    assert [pair.vertical and pair.vertical.name for pair in pairs] == [f"RSN1_ABC{end}"]


@pytest.mark.parametrize(
    "name", ["SANTA CRUZ", "LA PAZ", "Vancouver", "Kyiv", "Group", "Culvert", "Riyadh_SAUD"]
)
def test_names_of_places_are_no_vertical_components(name):
    pairs = rj.Motions((named(name), named(f"{name}-UP", 1))).paired()
    assert [pair.vertical and pair.vertical.name for pair in pairs] == [f"{name}-UP"]


def test_operations_apply_to_the_vertical_motion_too():
    motion = dataclasses.replace(named("a"), vertical=named("v", 1, 0.5))
    vertical = motion.vertical
    assert vertical is not None
    for change in (
        lambda y: y.scaled(2.0),
        lambda y: y.resampled(0.025),
        lambda y: y.baseline_corrected(),
    ):
        np.testing.assert_array_equal(change(motion).vertical.acceleration, change(vertical).acceleration)
    trimmed = motion.trimmed(0.1, 0.9)
    assert trimmed.vertical is not None
    first = int(np.flatnonzero(motion.acceleration == trimmed.acceleration[0])[0])
    np.testing.assert_array_equal(
        trimmed.vertical.acceleration, vertical.acceleration[first : first + len(trimmed)]
    )
    with pytest.raises(ValueError, match="a file holds one component"):
        motion.save("motion.csv")
    with pytest.raises(ValueError, match=r"Motion: vertical must be a rockjax\.Motion or None, got 3\.0"):
        dataclasses.replace(motion, vertical=3.0)


@pytest.mark.slow
def test_tables_of_pairs():
    suite = rj.Motions(
        tuple(dataclasses.replace(named(f"m{k}", k), vertical=named("v", k + 3, 0.6)) for k in range(3))
    )
    found = rj.peak_responses(FRAME, suite, options=OPTIONS)
    one = rj.peak_response(FRAME, suite[1], options=OPTIONS)
    assert 0.01 < float(one.peak_rotation) < 1
    assert float(found.peak_rotation[1]) == pytest.approx(float(one.peak_rotation), rel=1e-9)


@pytest.mark.slow
def test_grids_of_pairs():
    suite = rj.Motions(
        tuple(dataclasses.replace(named(f"m{k}", k), vertical=named("v", k + 3, 0.6)) for k in range(3))
    )
    grid = rj.grid(FRAME, suite, scale=[1.0, 1.5])
    assert grid.shape == (3, 2)
    swept = rj.peak_responses(*grid[:2], options=OPTIONS)
    other = rj.peak_response(FRAME, suite[2].scaled(1.5), options=OPTIONS)
    assert float(swept.peak_rotation[2, 1]) == pytest.approx(float(other.peak_rotation), rel=1e-9)
    pair = rj.GroundMotion(rj.OneSine(2.5, 0.8), rj.OneSine(-4.0, 0.5))
    one = rj.grid(FRAME, pair, **{"vertical.a_p": np.array([1.0, 2.0])})
    np.testing.assert_array_equal(one.excitations.vertical.a_p, [1.0, 2.0])  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.slow
def test_fragility_of_pairs():
    suite = rj.Motions(
        tuple(dataclasses.replace(named(f"m{k}", k), vertical=named("v", k + 3, 0.6)) for k in range(3))
    )
    analysis = rj.incremental_dynamic_analysis(FRAME, suite, np.linspace(1.0, 8.0, 4), width=1e-2)
    capacity = float(analysis["capacity"][0])
    assert np.isfinite(capacity)
    for factor, falls in ((1 - 1e-7, False), (1 + 1e-7, True)):
        scaled = suite[0].scaled(factor * capacity / suite[0].pga)
        options = rj.Options(rtol=1e-10, atol=1e-12, outputs=("peak_rotation",))
        assert bool(rj.peak_response(FRAME, scaled, options=options).overturned) is falls


def test_spectra_vary_the_components_that_their_function_varies():
    fixed = rj.OneSine(-4.0, 0.5)
    pulse = lambda a_p, T_p: rj.GroundMotion(rj.OneSine(a_p, T_p), fixed)
    spectrum = rj.rocking_spectrum(FRAME, pulse, [3.0, 4.0], [1.5, 2.0], options=OPTIONS)
    a_p, T_p = float(spectrum["a_p"][1]), float(spectrum["T_p"][0])
    one = rj.peak_response(FRAME, pulse(a_p, T_p), options=OPTIONS)
    assert float(spectrum["peak_rotation"][1, 0]) == pytest.approx(float(one.peak_rotation), rel=1e-9)


@pytest.mark.slow
def test_boundaries_over_the_amplitude_leave_a_fixed_vertical_motion():
    fixed = rj.OneSine(-4.0, 0.5)
    pulse = lambda a_p, T_p: rj.GroundMotion(rj.OneSine(a_p, T_p), fixed)
    found = float(rj.overturning_acceleration(FRAME, pulse, 0.8, width=1e-2))
    options = rj.Options(rtol=1e-11, atol=1e-13, outputs=("peak_rotation",))
    for factor, falls in ((1 - 1e-8, False), (1 + 1e-8, True)):
        assert bool(rj.peak_response(FRAME, pulse(factor * found, 0.8), options=options).overturned) is falls
    together = rj.overturning_scale(FRAME, pulse(0.9 * found, 0.8), max_scale=1.5, width=1e-2)
    assert abs(0.9 * float(together) - 1) > 1e-3  # the scale of a pair applies to both components


def test_problem_files(tmp_path):
    reader = Reader(tmp_path / "problem.toml")
    read = lambda entry: reader.members(reader.check(Problem, {"motions": {"a": entry}}).motions, "a", FRAME)
    (motion,) = read({"kind": "ricker", "a_p": 3.0, "T_p": 0.8, "vertical_ratio": 0.5})
    assert isinstance(motion, rj.GroundMotion)
    assert float(motion.vertical.a_p) == 1.5  # pyright: ignore[reportAttributeAccessIssue]
    named("h").save(tmp_path / "h.csv")
    named("v", 1).save(tmp_path / "v.csv")
    entry = {"file": "h.csv", "vertical": "v.csv", "scale": 2.0}
    (motion,) = read(entry)
    assert motion.vertical is not None
    np.testing.assert_allclose(motion.vertical.acceleration, 2 * named("v", 1).acceleration)
    with pytest.raises(ValueError, match="has both vertical_ratio and a vertical record"):
        read(entry | {"vertical_ratio": 0.5})
    with pytest.raises(ValueError, match=r"motions\.a\.vertical_ratio: must be a number"):
        read({"kind": "ricker", "a_p": 3.0, "T_p": 0.8, "vertical_ratio": "half"})
