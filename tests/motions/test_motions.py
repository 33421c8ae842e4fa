"""Ground motions: integrals, resampling, baselines, suites, intensity measures, synthetic
motions, commands."""

import dataclasses
import json
import math
import re
import warnings
from pathlib import Path

import jax
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.signal
import xarray
from typer.testing import CliRunner

import optimise
import rockjax as rj
from rockjax._cli import app
from rockjax._motions.convert import make_unique
from rockjax._motions.files import read
from rockjax._motions.intensity import spectral_acceleration
from rockjax._motions.readers import is_table
from rockjax._motions.synthetic import Soil, _noise, envelope, spectral_density

G = 9.80665
RUN = CliRunner()


def wave(a=2.0, T=0.5, periods=4, dt=0.005, name="wave"):
    """Return complete periods of a sine, which end at rest."""
    t = np.arange(round(periods * T / dt) + 1) * dt
    return rj.Motion(a * np.sin(2 * np.pi / T * t), dt, name)


@pytest.fixture(scope="module")
def suite() -> rj.Motions:
    return rj.synthetic_motions(3, seed=7, duration=10.0)


def test_integrals_are_those_of_straight_lines():
    samples = np.array([0.3, -1.0, 2.5, 0.7, -2.0])
    motion = rj.Motion(samples, 0.1)
    t = np.linspace(0, 0.4, 40001)
    a = np.interp(t, motion.time, samples)
    v = scipy.integrate.cumulative_trapezoid(a, t, initial=0)
    u = scipy.integrate.cumulative_simpson(v, x=t, initial=0)
    np.testing.assert_allclose(motion.velocity, v[::10000], atol=1e-12)
    np.testing.assert_allclose(motion.displacement, u[::10000], atol=1e-10)
    assert motion.pga == 2.5
    # The peaks lie inside sampling intervals.
    assert motion.pgv == pytest.approx(np.abs(v).max(), abs=1e-9)
    assert motion.pgv > np.abs(motion.velocity).max() + 1e-3
    assert motion.pgd == pytest.approx(np.abs(u).max(), abs=1e-9)
    assert motion.duration == pytest.approx(0.4)
    record = motion.record(scale=2.0)
    np.testing.assert_array_equal(record.acceleration, samples)
    assert (float(record.dt), float(record.scale)) == (0.1, 2.0)


def test_motions_are_their_own():
    samples, notes = np.ones(3), {"station": "A"}
    motion = rj.Motion(samples, 0.1, metadata=notes)
    samples[0], notes["station"] = 9.0, "B"
    assert motion.acceleration[0] == 1
    assert motion.metadata["station"] == "A"
    with pytest.raises(ValueError, match="read-only"):
        motion.acceleration[0] = 2.0
    assert motion.scaled(2.0).scaled(3.0).metadata["scale"] == 6.0
    assert "scale" not in motion.metadata
    shown = rj.Motion(np.ones(3), 0.1, "<b>", metadata={"station": "x<y"})
    assert "Motion '<b>'" in repr(shown)
    assert "3 every 0.1 s" in repr(shown)
    assert "x&lt;y" in shown._repr_html_()
    assert "<b>" not in shown._repr_html_()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda m: rj.Motion(np.ones((2, 2)), 0.1), ["shape (n,)", "(2, 2)"]),
        (lambda m: rj.Motion([1.0], 0.1), ["n >= 2"]),
        (lambda m: rj.Motion([1.0, np.nan], 0.1), ["finite", "sample 1"]),
        (lambda m: rj.Motion([1.0, 2.0], 0.0), ["dt must be", "0.0"]),
        (lambda m: m.scaled(np.inf), ["factor", "inf"]),
        (lambda m: m.resampled(-1.0), ["dt must be", "-1.0"]),
        (lambda m: m.resampled(5.0), ["exceeds the duration"]),
        (lambda m: m.resampled(0.005 / math.pi**2 * 0.9), ["ratio of whole numbers"]),
        (lambda m: m.resampled(1e-7), ["ratio of whole numbers"]),
        (lambda m: m.resampled(0.005 * math.sqrt(2)), ["ratio of whole numbers"]),
        (lambda m: m.baseline_corrected(0), ["order", "1 to 8"]),
        (lambda m: m.baseline_corrected(2.0), ["order", "2.0"]),
        (lambda m: m.trimmed(0.5, 0.5), ["lower < upper"]),
        (lambda m: rj.Motion(np.zeros(3), 0.1).trimmed(), ["zero throughout"]),
        (lambda m: m.save("a.txt"), ["a.txt", ".AT2 or .csv"]),
        (lambda m: rj.Motions((1,)), ["must hold rockjax.Motion"]),
        (lambda m: rj.Motions((m,)).scaled_to("PGX", 1.0), ["PGA", "Sa", "'PGX'"]),
        (lambda m: rj.Motions((m,)).scaled_to("PGA", -1.0), ["value", "-1.0"]),
        (lambda m: rj.Motions((m,)).scaled_to("PGA", 1.0, period=1.0), ["applies to Sa only"]),
        (lambda m: rj.Motions((m,)).scaled_to("Sa", 1.0), ["needs a period"]),
        (
            lambda m: rj.Motions((rj.Motion(np.zeros(3), 0.1, "none"),)).scaled_to("PGA", 1.0),
            ["PGA of none is zero"],
        ),
        (lambda m: rj.Motions((m,)).scaled_to("Sa", 1.0, period=-1.0), ["scaled_to: period must be", "-1.0"]),
        (
            lambda m: rj.intensity_measures(m, periods=(-1.0,)),
            ["intensity_measures: periods must be", "-1.0"],
        ),
        (lambda m: rj.intensity_measures(m, damping=1.0), ["intensity_measures: damping must be", "1.0"]),
        (lambda m: rj.intensity_measures(m, podium=rj.Podium(np.array([0.1, 0.2]), 1.0)), ["single"]),
        (lambda m: rj.synthetic_motions(0, seed=1), ["count", ">= 1"]),
        (lambda m: rj.synthetic_motions(1, seed=-1), ["seed", ">= 0"]),
        (lambda m: rj.synthetic_motions(1, seed=1, dt=0.0), ["dt", "> 0"]),
        (lambda m: rj.synthetic_motions(1, seed=1, duration=0.1), ["at least 49 dt (50 samples)"]),
        (lambda m: rj.synthetic_motions(1, seed=1, envelope_end=1.0), ["envelope_end", "< 1"]),
        (
            lambda m: rj.synthetic_motions(
                2, seed=1, pulse=rj.MavroeidisPapageorgiou(np.array([1.0, 2.0]), 1.0)
            ),
            ["synthetic_motions: pulse must be a single motion, but its A is an array", "pass a list"],
        ),
        (lambda m: rj.Motion([0.0, 1.0], 0.1, metadata=None), ["Motion: metadata must be a dict, got None"]),
        (
            lambda m: rj.synthetic_motions(1, seed=1, pulse=rj.MavroeidisPapageorgiou(1.0, 0.05)),
            ["does not fit", "40 s"],
        ),
        (
            lambda m: rj.synthetic_motions(3, seed=1, pulse=[rj.MavroeidisPapageorgiou(1.0, 1.0)] * 2),
            ["one for each of 3"],
        ),
    ],
)
def test_invalid_arguments_are_named(make, words):
    with pytest.raises(ValueError) as error:
        make(wave())
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize("dt", [0.0025, 0.004, 0.01, 0.0125])
def test_resampling_keeps_frequencies_below_both_nyquist_frequencies(dt):
    t = np.arange(0, 8.0005, 0.005)
    hump = np.exp(-((t - 4) ** 2))
    slow = hump * np.sin(2 * np.pi * 8 * t)
    motion = rj.Motion(slow, 0.005, "both", metadata={"station": "A"})
    new = motion.resampled(dt)
    exact = np.exp(-((new.time - 4) ** 2)) * np.sin(2 * np.pi * 8 * new.time)
    assert new.dt == dt
    assert new.duration <= motion.duration + 1e-12
    assert new.metadata["station"] == "A"
    np.testing.assert_allclose(new.acceleration, exact, atol=3e-3)
    linear = np.interp(new.time, t, slow)
    if dt not in (0.01,):  # coarser samples differ from the curve
        assert np.abs(linear - exact).max() > 3 * np.abs(new.acceleration - exact).max()


@pytest.mark.parametrize("dt", [0.02, 0.005, 0.0125, 0.015])
@pytest.mark.parametrize(("offset", "slope"), [(0.79, 0.0), (-30.0, 0.0), (0.2, 0.01)])
def test_resampling_and_baselines_agree_in_both_orders(offset, slope, dt):
    """A record whose offset or drift is much larger than its motion, as in raw files."""
    t = np.arange(6000) * 0.01
    quake = 1e-3 * np.sin(9 * t) * np.exp(-(((t - 30) / 6) ** 2))
    raw = rj.Motion(quake + offset + slope * t, 0.01)
    order = 2 if slope else 1
    before = raw.baseline_corrected(order).resampled(dt)
    after = raw.resampled(dt).baseline_corrected(order)
    assert after.pga == pytest.approx(np.abs(quake).max(), rel=0.01)
    np.testing.assert_allclose(after.acceleration, before.acceleration, atol=0.01 * before.pga)


def test_resampling_folds_nothing_back():
    t = np.arange(0, 8.0005, 0.005)
    fast = np.exp(-((t - 4) ** 2)) * np.sin(2 * np.pi * 70 * t)
    assert rj.Motion(fast, 0.005).resampled(0.01).pga < 1e-2
    assert np.abs(fast[::2]).max() > 0.9  # every second sample would alias to 30 Hz


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_baseline_of_a_drifting_motion(order):
    t = np.arange(0, 20.0001, 0.01)
    true = rj.Motion(np.exp(-((t - 8) ** 2)) * np.sin(2 * np.pi * 2 * (t - 8)), 0.01)
    drift = 0.02 * sum((t / 20) ** k for k in range(order))
    corrected = rj.Motion(true.acceleration + drift, 0.01).baseline_corrected(order)
    assert abs(corrected.velocity[-1]) < 1e-14
    # The drift is a polynomial of the fit; the remainder is the part of the motion that the fit removes.
    assert np.abs(corrected.acceleration - true.acceleration).max() < 2e-3
    assert corrected.metadata["baseline_order"] == order


def test_trimming_by_arias_intensity():
    motion = wave(periods=8)
    quiet = np.zeros(1000)
    long = rj.Motion(np.concatenate([quiet, motion.acceleration, quiet]), motion.dt)
    trimmed = long.trimmed()
    assert motion.duration * 0.97 < trimmed.duration <= motion.duration
    arias = [float(rj.intensity_measures(m, periods=())["arias_intensity"]) for m in (long, trimmed)]
    assert 0.998 <= arias[1] / arias[0] <= 1
    middle = long.trimmed(0.25, 0.75)
    assert middle.duration == pytest.approx(motion.duration / 2, abs=0.13)


def test_measures_of_a_sine():
    a, T, periods = 2.0, 0.5, 4
    motion = wave(a, T, periods, dt=T / 2000)
    data = rj.intensity_measures(motion, periods=(0.0,))
    exact = {
        "PGA": a,
        "PGV": a * T / np.pi,  # a/ω (1 − cos ωt)
        "PGD": a * T / (2 * np.pi) * periods * T,  # it drifts with its mean velocity
        "PGV_PGA": T / np.pi,
        "arias_intensity": np.pi / (2 * G) * a**2 / 2 * periods * T,
        "CAV": 2 / np.pi * a * periods * T,
        "duration": periods * T,
    }
    for name, value in exact.items():
        assert float(data[name]) == pytest.approx(value, rel=2e-6), name
        assert data[name].attrs["units"]
    # Husid's curve is t/D − sin(2ωt)/(2ωD); its values 5 % and 95 %.
    husid = lambda t: t / (periods * T) - np.sin(4 * np.pi * t / T) / (4 * np.pi * periods)
    start, end = (scipy.optimize.brentq(lambda t, x=x: husid(t) - x, 0, periods * T) for x in (0.05, 0.95))
    assert float(data["D5_95"]) == pytest.approx(end - start, rel=1e-5)
    assert float(data["Sa"].sel(period=0.0)) == a


def test_absolute_velocity_counts_crossings_exactly():
    motion = rj.Motion([0.0, 1.0, -3.0, -1.0, 1.0], 0.2)
    exact = 0.2 * (0.5 + 0.5 * (0.25 * 1 + 0.75 * 3) + 2.0 + 0.5 * (0.5 + 0.5))
    assert float(rj.intensity_measures(motion, periods=())["CAV"]) == pytest.approx(exact, rel=1e-14)


@pytest.mark.parametrize(("period", "damping"), [(0.03, 0.05), (0.3, 0.02), (1.0, 0.05), (6.0, 0.2)])
def test_spectral_acceleration_against_an_integration(suite, period, damping):
    motion = suite[0]
    w = 2 * np.pi / period
    rate = lambda t, y: [
        y[1],
        -np.interp(t, motion.time, motion.acceleration, right=0) - 2 * damping * w * y[1] - w * w * y[0],
    ]
    end = motion.duration + period
    exact = scipy.integrate.solve_ivp(
        rate, (0, end), [0, 0], method="LSODA", rtol=1e-9, atol=1e-12, max_step=motion.dt
    )
    assert spectral_acceleration(motion, period, damping) == pytest.approx(
        w * w * np.abs(exact.y[0]).max(), rel=1e-3
    )


def test_a_slow_oscillator_swings_after_the_end():
    push = rj.Motion(np.sin(np.pi * np.linspace(0, 1, 101)), 0.001)  # a tenth of a second
    assert spectral_acceleration(push, 10.0, 0.0) == pytest.approx(2 * np.pi / 10 * push.pgv, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("damping", [0.0, 0.05, 0.3])
@pytest.mark.parametrize(("period", "finer"), [(0.05, 512), (0.3, 512), (5.0, 64), (12.0, 64)])
def test_spectral_acceleration_is_exact_inside_of_intervals(period, finer, damping):
    """The reference has samples 64 or 512 times as close, and a parabola through the highest three. Values at
    samples alone are up to 4e-4 too low at long periods."""
    motion = rj.synthetic_motions(1, seed=3, duration=10.0, dt=0.02, omega_g=2.0, omega_f=0.5)[0]
    h, w = motion.dt / finer, 2 * np.pi / period
    # State: u, u̇, ü_g and its slope.
    of_state = [[0, 1, 0, 0], [-w * w, -2 * damping * w, -1, 0], [0, 0, 0, 1], [0, 0, 0, 0]]
    step = scipy.linalg.expm(np.array(of_state) * h)
    values, vectors = np.linalg.eig(step[:2, :2])
    samples = np.interp(
        np.arange((len(motion) - 1) * finer + 1) / finer, np.arange(len(motion)), motion.acceleration
    )
    load = np.concatenate([samples, np.zeros(round(period / h))])
    slopes = np.append(np.diff(samples) / h, np.zeros(round(period / h)))
    load[len(samples) - 1] = 0  # it ends with a jump
    inputs = np.linalg.solve(vectors, step[:2, 2:] @ np.stack([load[:-1], slopes]))
    modes = [
        scipy.signal.lfilter([1.0], [1.0, -value], row) for value, row in zip(values, inputs, strict=True)
    ]
    u = w * w * np.abs((vectors @ modes)[0].real)
    k = 1 + int(np.argmax(u[1:-1]))
    before, top, after = u[k - 1 : k + 2]
    exact = top - (before - after) ** 2 / (8 * (before - 2 * top + after))
    assert spectral_acceleration(motion, period, damping) == pytest.approx(exact, rel=1e-9)


def test_spectral_acceleration_against_a_podium_in_full_contact(suite):
    """The top of a slender tower that never lifts is the oscillator."""
    motion = suite[0].scaled(1e-3)
    podium = rj.Podium(0.3, 2.0, 1.0, rj.Elastic(5.0, 0.5, 0.05))
    deformation = float(rj.peak_response(podium, motion.record()).peak_deformation)
    w = 2 * np.pi / 0.5
    assert spectral_acceleration(motion, 0.5, 0.05) == pytest.approx(w * w * deformation, rel=1e-3)


def test_measures_of_several_motions_with_a_podium(suite):
    podium = rj.Podium(0.15, 1.5)
    data = suite.dataset(periods=(0.5, 1.0), podium=podium)
    assert data.sizes == {"motion": 3, "period": 2}
    assert list(data["motion"].values) == suite.names
    p = float(podium.p)
    for k, motion in enumerate(suite):
        one = rj.intensity_measures(motion, periods=(0.5, 1.0), podium=podium)
        xarray.testing.assert_equal(data.isel(motion=k), one)
        assert float(one["acceleration_ratio"]) == pytest.approx(motion.pga / (G * math.tan(0.15)))
        assert float(one["velocity_ratio"]) == pytest.approx(p * motion.pgv / (G * math.tan(0.15)))


def test_numbered_names_are_different():
    """A name of the list may look like a numbered one."""
    assert make_unique(["a", "b", "a"]) == ["a (1)", "b", "a (2)"]
    assert make_unique(["a", "a", "a (1)"]) == ["a (2)", "a (3)", "a (1)"]


def test_records_without_names_are_numbered(suite):
    a, b, c = suite.records()
    for motions, names in (
        ([a, b], ["record 1", "record 2"]),
        (
            [a, suite[1], [b, rj.Records.of([c, a])]],
            ["record 1", suite[1].name, *map("record {}".format, (3, 4, 5))],
        ),
        (rj.Records.of([a, b]).pick([1, 0]), ["record 1", "record 2"]),
    ):
        assert rj.intensity_measures(motions, periods=[1.0])["motion"].values.tolist() == names


@pytest.mark.parametrize("measure", ["PGA", "PGV", "PGD", "CAV", "arias_intensity", "Sa"])
def test_scaling_to_a_measure(suite, measure):
    period = 1.0 if measure == "Sa" else None
    scaled = suite.scaled_to(measure, 0.7, period=period)
    found = scaled.dataset(periods=(1.0,))[measure].values.ravel()
    np.testing.assert_allclose(found, 0.7, rtol=1e-12)
    np.testing.assert_allclose(scaled[1].acceleration, scaled.scales[1] * suite[1].acceleration, rtol=1e-12)


def test_motions_are_a_sequence(suite):
    assert len(suite) == 3
    assert suite[-1] is suite.motions[2]
    assert isinstance(suite[1:], rj.Motions)
    assert [m.name for m in suite[::2]] == ["synthetic-0001", "synthetic-0003"]
    assert suite[0] in suite
    assert len(suite.map(lambda m: m.resampled(0.02))[0]) == 501
    assert all(isinstance(record, rj.Record) for record in suite.records())
    lines = repr(suite).splitlines()
    assert lines[0] == "3 motions"
    assert len(lines) == 5
    assert suite._repr_html_().count("<tr>") == 4


@pytest.mark.parametrize(("suffix", "rtol"), [("AT2", 1e-6), ("csv", 0)])
def test_saving_and_reading(tmp_path, suite, suffix, rtol):
    motion = suite[0]
    path = motion.save(tmp_path / "new" / f"one.{suffix}")
    again = rj.read_motion(path)
    np.testing.assert_allclose(again.acceleration, motion.acceleration, rtol=rtol, atol=1e-7 if rtol else 0)
    assert again.dt == pytest.approx(motion.dt, rel=1e-12)
    assert again.name == "one"
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    if suffix == "AT2":
        assert again.metadata["event"] == "synthetic"
    named = rj.Motion(
        motion.acceleration,
        0.01,
        metadata={"event": "A, B", "date": "1/2/1999", "station": "S", "component": "90"},
    )
    notes = rj.read_motion(named.save(tmp_path / "named.AT2")).metadata
    assert {"event": "A; B", "date": "1/2/1999", "station": "S", "component": "90"}.items() <= notes.items()


@pytest.mark.parametrize(
    "notes",
    [
        {"event": "M 5.9", "date": "1996/08/11 03:12:00", "station": "AKT013", "component": "E-W"},
        {"event": "E", "date": "20190728", "station": "KO.ARC", "component": "HNE"},
        {"event": "Velocity time history in units of cm, raw", "date": "", "station": "S", "component": "1"},
        {"event": "two\r\u2028lines", "date": "2018 February 12", "station": "", "component": "HNZ"},
        {"event": "1999/8/17 Kocaeli", "date": "", "station": "A\x85B", "component": ""},
    ],
)
@pytest.mark.parametrize("dt", [0.01, 1 / 3, 1 / 199.99, 0.01 + 1e-13])
def test_header_and_interval_of_saved_files_are_read_back(tmp_path, suite, notes, dt):
    motion = rj.Motion(0.1 * suite[0].acceleration, dt, metadata=notes)
    found = read(motion.save(tmp_path / "a.AT2"), None, None)
    assert found.dt == dt
    assert {key: " ".join(value.replace(",", ";").split()) for key, value in notes.items()}.items() <= (
        found.metadata.items()
    )
    assert "processing" not in found.metadata
    assert read(motion.save(tmp_path / "a.csv"), None, None).dt == pytest.approx(dt, rel=1e-15)


def test_a_motion_that_cannot_be_written_leaves_nothing(tmp_path, suite):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=r"file/a\.AT2 could not be written"):
        suite[0].save(tmp_path / "file" / "a.AT2")
    folder = tmp_path / "a.csv"
    folder.mkdir()
    with pytest.raises(OSError, match=r"a\.csv could not be written"):
        suite[0].save(folder)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.csv", "file"]


@pytest.fixture
def folder(tmp_path, suite):
    suite[1].save(tmp_path / "b.AT2")
    suite[0].save(tmp_path / "a.csv")
    (tmp_path / ".hidden").write_text("nothing")
    (tmp_path / "sub").mkdir()
    return tmp_path


def test_a_folder_is_a_suite(folder, suite):
    found = rj.read_suite(folder, scale=2.0)
    assert found.names == ["a", "b"]
    np.testing.assert_array_equal(found[0].acceleration, 2 * suite[0].acceleration)
    np.testing.assert_array_equal(found.scales, 2.0)
    assert rj.read_suite(folder, pattern="*.AT2").names == ["b"]
    (folder / "notes.pdf").write_bytes(b"%PDF\x00")
    (folder / "short.txt").write_text("1\n2\nx\n")
    with pytest.raises(ValueError) as error:
        rj.read_suite(folder)
    lines = str(error.value).splitlines()
    assert lines[0].startswith(f"{folder}: 2 of 4 files cannot be read; a pattern such as ")
    assert lines[1].startswith(f"  {folder / 'notes.pdf'}:1: the file is not text")
    assert lines[2].startswith(f"  {folder / 'short.txt'}:3: 'x' is not a number")
    with pytest.raises(ValueError, match=r"the folder has no file \*\.V2"):
        rj.read_suite(folder, pattern="*.V2")
    with pytest.raises(ValueError, match=r"none: the file cannot be read: No such file"):
        rj.read_suite(folder / "none")


def test_a_table_is_a_suite(folder, suite):
    (folder / "plain.txt").write_text("\n".join(f"{a / G:.12f}" for a in suite[2].acceleration))
    table = folder / "suite.csv"
    table.write_text(
        "file,name,scale,units,dt,site\nb.AT2,second,,,,rock\n\nplain.txt,third,0.5,g,0.01,\na.csv,,3\n",
        encoding="utf-8",
    )
    for place in (table, folder):
        found = rj.read_suite(place, scale=2.0)
        assert found.names == ["second", "third", "a"]
        np.testing.assert_allclose(found.scales, [2, 1, 6])
        np.testing.assert_allclose(found[1].acceleration, suite[2].acceleration, atol=1e-9)
        assert found[0].metadata["site"] == "rock"
        assert "site" not in found[1].metadata
    assert rj.read_suite(folder, pattern="*.AT2").names == ["b"]


@pytest.mark.parametrize("component", ["090", "90"])
@pytest.mark.parametrize("heading", ['"file","name","component"', "\nname, component, file,,"])
def test_tables_are_recognised_and_select_components_by_number(tmp_path, suite, component, heading):
    """Names of components may be numbers; spreadsheets quote headings, drop zeros and add commas."""
    one = dataclasses.replace(suite[0], metadata={"station": "S", "component": "090"})
    one.save(tmp_path / "a.AT2")
    cells = {"file": "a.AT2", "name": "first", "component": component}
    row = ",".join(cells.get(name.strip('" '), "") for name in heading.strip().split(","))
    table = tmp_path / "list.csv"
    table.write_text(f"{heading}\n{row}\n,,,\n")
    assert is_table(table)
    assert rj.read_suite(table).names == ["first"]
    result = RUN.invoke(app, ["motions", str(table), "--json"])
    assert result.exit_code == 0, result.output
    result = RUN.invoke(app, ["motions", str(tmp_path / "a.AT2"), "--component", component])
    assert result.exit_code == 0, result.output
    with pytest.raises(ValueError, match="has one motion, not component 'Up'; it is '090'"):
        rj.read_suite(tmp_path, pattern="*.AT2", component="Up")


@pytest.mark.parametrize("separator", [";", "\t"])
def test_tables_of_spreadsheets_with_decimal_commas(tmp_path, suite, separator):
    suite[0].save(tmp_path / "a.AT2")
    (tmp_path / "suite.csv").write_text(
        "file,name,scale\na.AT2,x,1.5\n".replace(",", separator).replace(".5", ",5")
    )
    motion = rj.read_suite(tmp_path)[0]
    assert motion.name == "x"
    assert motion.pga == pytest.approx(1.5 * suite[0].pga)


def test_columns_of_a_table_have_priority_over_the_header(tmp_path, suite):
    suite[0].save(tmp_path / "a.AT2")  # without a station
    (tmp_path / "suite.csv").write_text("file,station,event,site\na.AT2,ARC,Kocaeli,rock\n")
    notes = rj.read_suite(tmp_path)[0].metadata
    assert (notes["station"], notes["event"], notes["site"]) == ("ARC", "Kocaeli", "rock")
    assert notes["units"] == "g"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name,scale\na,1\n", [":1:", "column 'file'"]),
        ("file,file\na,b\n", [":1:", "two columns"]),
        ("file\n", ["the table lists no file"]),
        ("file,scale\na.csv,big\n", [":2:", "scale", "'big'"]),
        ("file,scale\na.csv,inf\n", [":2:", "scale", "'inf'"]),
        ("file,scale\na.csv,1,2\n", [":2:", "3 cells", "2 headings"]),
        ("file,scale\n,1\n", [":2:", "the cell of the column 'file' is empty"]),
        (
            "file,units\nb.AT2,gal\nc.AT2,\n",
            ["2 of 2 files", "the unit as g", "c.AT2: the file cannot be"],
        ),
        ("", [":1:", "column 'file'"]),
        ("file;scale\nb.AT2;1.5.0\n", [":2:", "scale", "'1.5.0'"]),
        ("file,scale [-]\nb.AT2,2\n", ["heading 'scale [-]'", "contains factors, call it 'scale'"]),
        ("file,dt (ms)\nb.AT2,5\n", ["heading 'dt (ms)'", "contains intervals in s, call it 'dt'"]),
        ("file,Unit\nb.AT2,g\n", ["heading 'Unit'", "contains units, call it 'units'"]),
    ],
)
def test_tables_that_cannot_be_read_say_why(folder, text, words):
    table = folder / "list.csv"
    table.write_text(text)
    with pytest.raises(ValueError) as error:
        rj.read_suite(table)
    assert str(error.value).startswith(str(table))
    for word in words:
        assert word in str(error.value)
    with pytest.raises(
        ValueError, match="pattern applies to folders, but this is not a folder; leave pattern out"
    ):
        rj.read_suite(table, pattern="*")


def test_the_noise_has_its_spectral_density():
    """Spectral density of many samples, in frequency bands, including the edge of the high-pass filter."""
    soil, count, dt = Soil(), 2000, 0.01
    noise = np.array([_noise(3, k, count, dt, soil) for k in range(400)])
    f, density = scipy.signal.welch(noise, 1 / dt, nperseg=1000, detrend=False, scaling="density")
    mean = density.mean(axis=0)
    target = 2 * dt * spectral_density(2 * np.pi * f, soil)  # one-sided, for white noise with variance 1
    for low, high in ((0.5, 1), (1, 2), (2, 3), (3, 5), (5, 10), (10, 25), (25, 45)):
        band = (f >= low) & (f < high)
        assert mean[band].mean() == pytest.approx(target[band].mean(), rel=0.05), (low, high)
    assert spectral_density(np.array([0.0, soil.omega_g]), soil) == pytest.approx(
        [0, (1 + 1 / (4 * 0.36)) * 1e4 / ((1 - 100) ** 2 + 4 * 0.36 * 100)], rel=1e-12
    )


def test_synthetic_spectra_follow_the_target():
    """Spectra of complete motions, divided by their energies, agree with the density from the soil's to high
    frequencies."""
    motions = rj.synthetic_motions(300, seed=11, dt=0.01, duration=20.0)
    a = np.array([m.acceleration / np.sqrt(np.sum(m.acceleration**2)) for m in motions])
    f = np.fft.rfftfreq(a.shape[1], 0.01)
    power = (np.abs(np.fft.rfft(a)) ** 2).mean(axis=0)
    target = spectral_density(2 * np.pi * f, Soil())
    power, target = power / power.sum(), target / target.sum()
    for low, high in ((0.5, 1), (1, 2), (2, 3), (3, 5), (5, 10), (10, 20), (20, 40)):
        band = (f >= low) & (f < high)
        assert power[band].sum() == pytest.approx(target[band].sum(), rel=0.07), (low, high)
    energy = np.cumsum((a**2).mean(axis=0))
    e2 = np.cumsum(envelope(motions[0].time, 20.0, 0.2, 0.05) ** 2)
    np.testing.assert_allclose(energy, e2 / e2[-1], atol=0.03)


def test_envelope_has_its_peak_and_its_end():
    t = np.linspace(0, 10, 10001)
    e = envelope(t, 10.0, 0.3, 0.1)
    assert t[np.argmax(e)] == pytest.approx(3.0)
    assert e.max() == pytest.approx(1, rel=1e-12)
    assert e[0] == e[-1] == 0
    before = np.exp(np.log(0.1) * (1 + np.log(0.95 / 0.3) - 0.95 / 0.3) / (1 + np.log(1 / 0.3) - 1 / 0.3))
    assert e[9500] == pytest.approx(before)  # just before the taper


@pytest.mark.parametrize("pulse", [None, rj.MavroeidisPapageorgiou(0.6, 0.8, 2.2, 0.7)])
def test_synthetic_motions_end_at_rest(pulse):
    motions = rj.synthetic_motions(5, seed=2, dt=0.02, duration=15.0, pga=2.5, pulse=pulse)
    for motion in motions:
        assert len(motion) == 751
        assert abs(motion.velocity[-1]) < 1e-12
        assert abs(motion.acceleration[[0, -1]]).max() < 1e-12
        if pulse is None:
            assert motion.pga == pytest.approx(2.5, rel=1e-12)
            assert abs(motion.displacement[-1]) < 1e-12
        assert motion.metadata["seed"] == 2
        assert motion.metadata["format"] == "synthetic"
        assert motion.metadata["zeta_g"] == 0.6


def test_the_pulse_is_that_of_the_engine():
    pulse = rj.MavroeidisPapageorgiou(0.6, 0.8, 2.2, 0.7)
    with_pulse, without = (rj.synthetic_motions(1, seed=2, dt=0.002, pulse=p)[0] for p in (pulse, None))
    added = rj.Motion(with_pulse.acceleration - without.acceleration, 0.002)
    exact = np.asarray(pulse(added.time - 4.0))
    np.testing.assert_allclose(added.acceleration, exact, atol=2e-3 * np.abs(exact).max())
    phase = 2 * np.pi * 0.8 * (added.time - 4.0)
    v = np.where(np.abs(phase) <= 2.2 * np.pi, 0.3 * (1 + np.cos(phase / 2.2)) * np.cos(phase + 0.7), 0.0)
    np.testing.assert_allclose(added.velocity, v, atol=1e-3)
    assert with_pulse.metadata["pulse_A"] == 0.6


def test_a_seed_gives_the_same_motions_for_ever():
    first = rj.synthetic_motions(2, seed=5)
    more = rj.synthetic_motions(3, seed=5)
    for one, other in zip(first, more, strict=False):
        np.testing.assert_array_equal(one.acceleration, other.acceleration)
    assert not np.allclose(more[0].acceleration, more[1].acceleration)
    assert not np.allclose(rj.synthetic_motions(1, seed=6)[0].acceleration, first[0].acceleration)
    # Stored values; they depend only on bits of PCG64 and on elementary functions.
    np.testing.assert_allclose(first[0].acceleration[[100, 500, 1000]], GOLDEN, rtol=1e-9)


GOLDEN = [-0.18488684853026052, 0.5792233838544345, 0.5227878467997814]


def test_motions_on_the_command_line(folder):
    prefix = folder / "out"
    flags = [
        "--periods",
        "0.5,1",
        "--tan-alpha",
        "0.15",
        "--R",
        "1.5",
        "-o",
        str(prefix),
        "--pattern",
        "*.AT2",
    ]
    result = RUN.invoke(app, ["motions", str(folder), str(folder / "a.csv"), *flags])
    assert result.exit_code == 0, result.output
    lines = result.output.splitlines()
    assert lines[0].split()[0] == "name"
    assert "Sa(0.5 s) [g]" in lines[0]
    assert "p PGV/(g tan α)" in lines[0]
    assert [line.split()[0] for line in lines[1:3]] == ["b", "a"]
    data = xarray.load_dataset(f"{prefix}.nc")
    assert list(data["motion"].values) == ["b", "a"]
    assert f"{float(data['PGA'][0]) / G:.4g}" in lines[1]
    assert data.attrs["alpha_rad"] == pytest.approx(math.atan(0.15))
    drifting = folder / "drift.txt"
    drifting.write_text("0\n1\n1\n0\n")
    result = RUN.invoke(app, ["motions", str(drifting), "--units", "m/s2", "--dt", "0.01"])
    assert result.exit_code == 0
    assert "rockjax: warning: " in result.output
    assert RUN.invoke(app, ["motions", str(drifting), "--R", "1"]).exit_code == 2
    assert RUN.invoke(app, ["motions", str(drifting), "--periods", "a"]).exit_code == 2
    failed = RUN.invoke(app, ["motions", str(drifting)])
    assert isinstance(failed.exception, ValueError)
    assert "give units" in str(failed.exception)


LISTED = """
[structure]
tan_alpha = 0.2
R = 1.0
[motions.pulses]
kind = "one-sine"
acceleration_ratio = [2.0, 3.0]
T_p = 0.8
vertical_ratio = 0.5
[[motions.records]]
file = "b.AT2"
scale = 2.0
vertical_ratio = 0.25
[[motions.records]]
suite = "."
pattern = "*.AT2"
[[motions.records]]
synthetic = 1
seed = 3
dt = 0.02
duration = 10.0
pga = 1.5
"""


def test_motions_of_a_problem_file_on_the_command_line(folder):
    """All sets are listed with their numbers, in the order of `--number`."""
    path = folder / "problem.toml"
    path.write_text(LISTED)
    result = RUN.invoke(app, ["motions", str(path), "--json"])
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout)["motions"]
    assert [(row["set"], row["number"]) for row in rows] == [
        *(("pulses", k) for k in (1, 2)),
        *(("records", k) for k in (1, 2, 3)),
    ]
    pulse, _, scaled, suite, noise = rows
    assert "OneSine" in pulse["name"]
    assert pulse["dt [s]"] is None
    assert pulse["duration [s]"] == pytest.approx(0.8)
    assert pulse["PGA [g]"] == pytest.approx(0.4)
    assert pulse["vertical PGA [g]"] == pytest.approx(0.2)
    alone = rj.read_motion(folder / "b.AT2")
    assert (scaled["name"], scaled["source"]) == ("b", "b.AT2")
    assert scaled["dt [s]"] == alone.dt
    assert scaled["duration [s]"] == pytest.approx(alone.duration)
    assert scaled["PGA [g]"] == pytest.approx(2 * alone.pga / G)
    assert scaled["vertical PGA [g]"] == pytest.approx(0.5 * alone.pga / G)
    assert suite["source"] == "b.AT2"
    assert suite["PGA [g]"] == pytest.approx(alone.pga / G)
    assert suite["vertical PGA [g]"] is None
    assert (noise["source"], noise["dt [s]"]) == ("synthetic", 0.02)
    assert noise["PGA [g]"] == pytest.approx(1.5 / G)
    text = RUN.invoke(app, ["motions", str(path)]).output.splitlines()
    assert len(text) == 1 + len(rows)
    assert text[0].split()[:4] == ["set", "number", "name", "source"]


@pytest.mark.parametrize(
    ("change", "flags", "words"),
    [
        (lambda text: text, ["--dt", "0.01"], "--dt applies to files"),
        (lambda text: text, ["--periods", "0.5"], "--periods applies to files"),
        (lambda text: text, ["--output", "out"], "--output applies to files"),
        (lambda text: text, ["problem.toml"], "2 paths"),
        (lambda text: text.split("[motions")[0], [], "problem.toml: motions: "),
        (lambda text: text.replace("b.AT2", "none.AT2"), [], "motions.records[0]: "),
        (lambda text: text[text.index("[motions") :], [], "motions.pulses: the pulse is given by ratios"),
        (lambda text: text + "[motion]", [], "motion: unknown key"),
    ],
)
def test_motions_of_a_problem_file_that_cannot_be_listed(folder, change, flags, words):
    path = folder / "problem.toml"
    path.write_text(change(LISTED))
    result = RUN.invoke(app, ["motions", str(path), *flags])
    assert isinstance(result.exception, ValueError)
    assert words in str(result.exception)


def test_synthetic_motions_on_the_command_line(tmp_path):
    flags = ["--count", "2", "--seed", "4", "--duration", "10", "--pga", "2", "--pulse", "0.5", "1", "2", "0"]
    result = RUN.invoke(app, ["synthetic", *flags, "-o", str(tmp_path / "made")])
    assert result.exit_code == 0, result.output
    assert sorted(p.name for p in (tmp_path / "made").iterdir()) == [
        "suite.csv",
        "synthetic-0001.AT2",
        "synthetic-0002.AT2",
    ]
    found = rj.read_suite(tmp_path / "made")
    pulse = rj.MavroeidisPapageorgiou(0.5, 1.0, 2.0, 0.0)
    for one, made in zip(
        found, rj.synthetic_motions(2, seed=4, duration=10.0, pga=2.0, pulse=pulse), strict=True
    ):
        np.testing.assert_allclose(one.acceleration, made.acceleration, atol=2e-6)
        assert one.name == made.name
        assert one.metadata["pulse_A"] == "0.5"


PROBLEM = """[structure]
alpha = 0.2
R = 2.0
[vary]
alpha = [0.1, 0.4]
[minimise]
quantity = "alpha"
[[targets]]
kind = "no-overturning"
motions = "records"
"""


def test_problems_take_suites(folder, suite):
    path = folder / "problem.toml"
    path.write_text(
        PROBLEM
        + '[[motions.records]]\nsuite = "."\npattern = "*.AT2"\nscale = 2.0\n[[motions.records]]\nfile = '
        '"a.csv"\n'
    )
    one, two = optimise.load(path).motions["records"]
    np.testing.assert_allclose(one.acceleration, 2 * suite[1].acceleration, atol=1e-6)
    np.testing.assert_array_equal(two.acceleration, suite[0].acceleration)
    for entry, words in (
        ('suite = "."\nfile = "a.csv"', "needs one of kind"),
        ('suite = "none"', "motions.records: .*none: the file cannot be read"),
        ("suite = 1", "suite: must be a string, got 1"),
        ('file = "a.csv"\npattern = "*"', "pattern: unknown key"),
        ('suite = "."\ncomponent = 1.5', "component: must be a whole number or text"),
    ):
        path.write_text(f"{PROBLEM}[motions.records]\n{entry}\n")
        with pytest.raises(ValueError, match=words):
            optimise.load(path)


@pytest.mark.slow
def test_code_of_the_page_on_records_runs(tmp_path, monkeypatch, capsys):
    """The blocks of the page run in order in an empty folder."""
    page = Path(__file__).parents[2] / "docs" / "records.md"
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S):
        exec(compile(block, str(page), "exec"), names)
    message = capsys.readouterr().out
    assert "the header gives the unit as g, but" in message
    assert "table.txt:3: 'oops' is not a number" in message
    assert "offset.txt: ends with a velocity of" in message
    assert names["suite"].names == ["third", "first"]


# ------------------------------------------------------------------------------- functions that take motions
@pytest.mark.slow
def test_all_functions_accept_motions_of_readers(suite):
    podium, options = rj.Podium(0.2, 1.0), rj.Options(rtol=1e-6, atol=1e-8)
    records = suite.records()
    complete = rj.peak_responses(podium, rj.Records.of(records), options=options).peak_rotation
    for several in (suite, list(suite), [suite[0], *records[1:]]):
        np.testing.assert_array_equal(
            rj.peak_responses(podium, several, options=options).peak_rotation, complete
        )
    one = rj.peak_response(podium, suite[1], options=options)
    assert one.peak_rotation == rj.peak_response(podium, records[1], options=options).peak_rotation
    assert rj.peak_response(podium, [suite[1]], options=options).peak_rotation == one.peak_rotation
    for same in (list(suite), records, rj.Records.of(suite), [suite]):
        data = rj.intensity_measures(same)
        np.testing.assert_allclose(data["PGA"], rj.intensity_measures(suite)["PGA"], rtol=1e-15)
    assert isinstance(rj.simulate(podium, suite[1], options=options).excitation, rj.Record)
    target = optimise.PeakRotation(0.3, suite)
    assert target.scenes == 3
    assert optimise.NoOverturning([suite, rj.Ricker(3.0, 1.0)]).scenes == 4
    with pytest.raises(ValueError, match=r"must be one motion, got 3; .* rockjax.peak_responses"):
        rj.peak_response(podium, suite)
    with pytest.raises(
        ValueError, match=r"got the class Ricker; pass an instance of the class: rockjax\.Ricker\(a_p, T_p\)"
    ):
        rj.simulate(podium, rj.Ricker)
    with pytest.raises(ValueError, match=r"the instance Ricker.* pass the class rockjax.Ricker"):
        rj.rocking_spectrum(podium, rj.Ricker(3.0, 1.0), [1.0], [1.0])
    with pytest.raises(ValueError, match=r"function \(a_p, T_p\).*, got the class Gabor"):
        rj.overturning_acceleration(podium, rj.Gabor, 1.0)


# ----------------------------------------------------------------------------------------------- plausibility
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda: rj.Podium.from_dimensions(450, 3000, 1500.0),
            "450 m by 3000 m has R = 1517 m; .* meant in mm",
        ),
        (
            lambda: rj.Podium.from_dimensions(0.45, 3.0, 1.5, 30.0),
            r"1.5 kg makes a square column of 0.45 m by 0.45 m by 3 m 2.47 kg/m³ .* meant in t\?",
        ),
        (lambda: rj.Podium.from_dimensions(0.45, [3.0, 4.0], [1500.0, 1e4]), "by 4 m 1.23e[+]04 kg/m³"),
        (lambda: rj.Podium.from_dimensions(0.3, 3.0, 80.0), "296 kg/m³ dense, outside 300 to 8000"),
        (
            lambda: rj.Record([0.0, 1.0], 0.01, t_start=1.7e9),
            r"t_start = 1\.7e[+]09 s; .* rounded to 2e-07 s",
        ),
        (lambda: rj.Ricker(400.0, 1.0), "Ricker: a_p = 400 m/s² is 40.8 g; did you pass gal"),
        (
            lambda: rj.peak_response(rj.Podium(0.2, 1.0), rj.Ricker(0.4, 1.0)),
            r"a_p = 0\.4 m/s² is 0\.0408 g, and the columns lift at 0\.203 g; was a_p meant in g\?",
        ),
    ],
)
def test_numbers_of_another_system_are_doubted(make, words):
    with pytest.warns(rj.PlausibilityWarning, match=words) as message:
        make()
    assert message[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rj.PlausibilityWarning)
        make()


def test_masses_in_tonnes_are_doubted_in_dimensions_and_problem_files(tmp_path):
    words = "2.5 kg/m³ dense, outside 300 to 8000"
    with pytest.warns(rj.PlausibilityWarning, match=words):
        optimise.Dimensions(width=0.6, height=3.0, column_mass=2.7)
    (tmp_path / "a.toml").write_text(
        "[structure]\nwidth = 0.6\nheight = 3.0\ncolumn_mass = 2.7\n[vary]\nwidth = [0.3, 1.0]\n"
        "[minimise]\nquantity = 'width'\n"
        "[motions]\na = { kind = 'ricker', a_p = 3.0, T_p = 1.0 }\n"
        "[[targets]]\nkind = 'peak-rotation'\nlimit = 0.5\nmotions = 'a'\n"
    )
    with pytest.warns(rj.PlausibilityWarning, match=words):
        optimise.load(tmp_path / "a.toml")


def test_the_environment_silences_doubts(monkeypatch, tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("\n".join(f"{a:.6f}" for a in 0.45 * np.sin(np.linspace(0, 4 * np.pi, 101))))
    for word in ("off", "0", "No"):
        monkeypatch.setenv("ROCKJAX_PLAUSIBILITY", word)
        rj.Ricker(400.0, 1.0)  # warnings are errors here
        rj.read_motion(path, units="m/s2", dt=0.01)
    monkeypatch.setenv("ROCKJAX_PLAUSIBILITY", "on")
    with pytest.warns(rj.PlausibilityWarning):
        rj.Ricker(400.0, 1.0)


def test_a_file_in_g_read_as_metres_is_doubted(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("\n".join(f"{a:.6f}" for a in 0.45 * np.sin(np.linspace(0, 4 * np.pi, 101))))
    with pytest.warns(
        rj.RecordWarning, match=r"PGA is 0\.449 m/s², 0\.0458 g; if the file is in g, pass units='g'"
    ):
        rj.read_motion(path, units="m/s2", dt=0.01)
    assert rj.read_motion(path, units="g", dt=0.01).pga == pytest.approx(0.45 * G, rel=1e-2)


def test_plausible_inputs_cause_no_warning():
    """Plausible inputs cause no warning: a tall pier, a museum piece, weak and strong pulses, sweeps, a
    traced size."""
    for width, height, mass in ((6.0, 60.0, 5e6), (0.05, 0.2, 1.3), (0.4, 4.0, 250.0), (0.1, 2.0, 157.0)):
        rj.Podium.from_dimensions(width, height, mass)
    for a_p in (0.4, 30.0, np.linspace(0, 1000, 5)):
        rj.Ricker(a_p, 1.0)
    rj.Record([0.0, 1.0], 0.01, t_start=-3600.0)
    jax.jit(lambda height: rj.Podium.from_dimensions(450.0, height, 1.0).R)(3000.0)
