"""Record spectra against the size of the structure."""

import dataclasses
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest

import rockjax as rj
from rockjax import _results as results
from rockjax import plots
from rockjax._boundaries.crossings import Crossings, Scan
from rockjax._motions.provenance import describe_motions
from rockjax._studies import record_spectra

BLOCK = rj.Podium(alpha=0.2, R=1.0)
RECORDS = rj.synthetic_motions(2, seed=3, duration=4.0, dt=0.04, pga=3.0)
SIZES = np.array([0.6, 0.7, 3.0])


@pytest.fixture(scope="module")
def spectrum():
    return rj.record_spectrum(BLOCK, RECORDS, SIZES, width=1e-3)


@pytest.mark.slow
def test_every_size_is_a_structure_of_its_own(spectrum):
    assert np.allclose(np.sqrt(0.75 * 9.80665 / spectrum["R"]), SIZES)
    podium = BLOCK.replace(R=float(spectrum["R"][2]))
    for k, record in enumerate(RECORDS.records()):
        least = float(rj.overturning_scale(podium, record, max_scale=10.0, width=1e-3))
        assert float(spectrum["demand"][k, 2]) == pytest.approx(1 / least, rel=1e-6)
        peak = rj.peak_response(podium, record)
        assert float(spectrum["peak_rotation"][k, 2]) == pytest.approx(float(peak.peak_rotation), rel=1e-6)
        assert bool(spectrum["overturned"][k, 2]) == bool(peak.overturned)
    # Ten times the record does not overturn the largest structure.
    assert np.isnan(spectrum["demand"][:, 0]).all()


def test_far_from_overturning_the_top_moves_as_far_at_every_size(spectrum):
    moved = spectrum["top_displacement"].values
    rotation = spectrum["peak_rotation"].values
    assert np.all(rotation[:, 0] < 0.1)
    assert np.allclose(moved[:, 0], moved[:, 1], rtol=0.05)
    R, alpha = spectrum["R"].values, 0.2
    assert np.allclose(moved[:, :2], 2 * R[:2] * (np.sin(alpha) - np.sin(alpha * (1 - rotation[:, :2]))))


def test_records_are_identified_by_samples_seeds_and_files(spectrum):
    expected = describe_motions(RECORDS)
    assert spectrum["sha256"].values.tolist() == expected["record_sha256"]
    assert spectrum["seed"].values.tolist() == expected["record_seed"] == [3, 3]
    assert "source" not in spectrum.coords
    assert describe_motions(rj.Records.of(RECORDS.records()))["record_pga_m_s2"] == pytest.approx([3.0, 3.0])
    assert describe_motions(RECORDS[0])["record_name"] == expected["record_name"][0] == RECORDS.names[0]
    assert describe_motions(rj.Ricker(1.0, 1.0)) == {}


@pytest.mark.slow
def test_the_overturning_acceleration_follows_the_known_laws():
    """For one pulse, from small to large blocks: the uplift acceleration if the pulse is long, ∝ 1/p if it is
    an impulse."""
    t, duration = np.linspace(0, 1, 26), 1.0
    record = rj.Record(np.sin(np.pi * t), duration / 25)
    sizes = np.array([0.04, 0.08, 60.0])
    found = rj.record_spectrum(BLOCK, [record], sizes, max_scale=200.0, width=1e-3)
    least = 1 / found["demand"].values[0]  # PGA is 1 m/s²
    assert least[2] == pytest.approx(9.80665 * np.tan(0.2), rel=0.02)
    assert least[0] / least[1] == pytest.approx(2.0, rel=0.02)


@pytest.mark.slow
def test_where_the_ground_only_moves_away_the_law_is_that_of_displacements():
    """A full sine leaves no velocity but a displacement D = aT²/2π. At its end a large block has rotated by
    p²D/g, and it overturns if this is α, so the least acceleration is proportional to 1/p². The block is
    slender, because the change of cos(α − θ) otherwise leaves some velocity."""
    t = np.linspace(0, 1, 41)
    record = rj.Record(np.sin(2 * np.pi * t), 1 / 40)
    sizes, alpha = np.array([0.02, 0.04]), 0.02
    slender = BLOCK.replace(alpha=alpha)
    found = rj.record_spectrum(slender, [record], sizes, max_scale=4000.0, width=1e-2)
    least = 1 / found["demand"].values[0]  # PGA is 1 m/s²
    assert least[0] / least[1] == pytest.approx(4.0, rel=0.01)
    assert np.allclose(least, 2 * np.pi * alpha * 9.80665 / sizes**2, rtol=0.01)


@pytest.mark.slow
def test_vertical_motions_are_not_left_out():
    """The spectrum of pairs equals that of each single pair."""
    pairs = RECORDS.map(lambda motion: dataclasses.replace(motion, vertical=motion.scaled(0.5)))
    found = rj.record_spectrum(BLOCK, pairs, SIZES[2:], max_scale=3.0, width=1e-2)
    podium = BLOCK.replace(R=float(found["R"][0]))
    for k, pair in enumerate(pairs.records()):
        peak = rj.peak_response(podium, pair)
        assert float(found["peak_rotation"][k, 0]) == pytest.approx(float(peak.peak_rotation), rel=1e-6)
        alone = rj.peak_response(podium, pair.horizontal)
        assert float(peak.peak_rotation) != pytest.approx(float(alone.peak_rotation), rel=1e-3)


def test_options_need_not_request_the_rotation(monkeypatch):
    requested = []
    codes = np.zeros(4, int)
    peaks = SimpleNamespace(result=results.result_of(codes), peak_rotation=codes * 0.1, overturned=codes > 0)
    crossings = Crossings(np.zeros(0, int), np.zeros(0), np.zeros(0, bool), np.zeros(0, int))
    search = Scan(crossings, codes < 9, np.ones(4), np.zeros(4), 100, np.ones(4), -np.ones(4))

    def solve(*_, options, **__):
        requested.extend(options.outputs)
        return peaks

    monkeypatch.setattr(record_spectra, "peak_responses", solve)
    monkeypatch.setattr(record_spectra, "scan", lambda *_, **__: search)
    monkeypatch.setattr(record_spectra, "precompile_scan", lambda *_: None)
    rj.record_spectrum(BLOCK, RECORDS, SIZES[:2], options=rj.Options(outputs=("margin",)))
    assert requested == ["margin", "peak_rotation"]


def test_scenes_that_did_not_finish_have_no_peaks(monkeypatch):
    codes, rotation = np.array([0, 9, 2, 3]), np.array([0.5, 0.0, 1.0, 0.3])
    peaks = SimpleNamespace(result=results.result_of(codes), peak_rotation=rotation, overturned=codes == 2)
    crossings = Crossings(np.array([2]), np.array([0.5]), np.array([True]), np.array([0]))
    search = Scan(crossings, codes < 9, np.ones(4), np.array([0.001, 9.0, 0.001, 8.0]), 100, *np.ones((2, 4)))
    monkeypatch.setattr(record_spectra, "peak_responses", lambda *_, **__: peaks)
    monkeypatch.setattr(record_spectra, "scan", lambda *_, **__: search)
    monkeypatch.setattr(record_spectra, "precompile_scan", lambda *_: None)
    found = rj.record_spectrum(BLOCK, RECORDS, SIZES[:2])
    np.testing.assert_array_equal(found["result"], codes.reshape(2, 2))
    np.testing.assert_array_equal(found["peak_rotation"], [[0.5, np.nan], [1.0, np.nan]])
    np.testing.assert_array_equal(np.isnan(found["top_displacement"]), [[False, True], [True, True]])
    np.testing.assert_array_equal(found["certain_width"], [[0.001, 9.0], [0.001, 8.0]])
    assert "weightless" in found["result"].attrs["flag_meanings"]


def test_it_is_drawn(spectrum):
    figure = plots.record_spectrum(spectrum)
    assert len(figure.axes) == 2
    assert "overturning PGA" in figure.axes[0].get_ylabel()
    plt.close(figure)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: rj.record_spectrum(BLOCK, RECORDS, [3.0, 1.0]), "ascending"),
        (lambda: rj.record_spectrum(BLOCK, RECORDS, [-1.0, 1.0]), "finite and > 0 rad/s"),
        (lambda: rj.record_spectrum(BLOCK, RECORDS, [1.0], names=["a", "a"]), "2 different strings"),
        (lambda: rj.record_spectrum(BLOCK, RECORDS, [1.0], max_scale=-1.0), "max_scale"),
        (lambda: rj.record_spectrum(BLOCK.replace(alpha=[0.1, 0.2]), RECORDS, [1.0]), "scalar parameters"),
    ],
)
def test_errors_name_the_valid_values(call, words):
    with pytest.raises(ValueError, match=words):
        call()
