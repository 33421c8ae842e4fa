"""The campaigns of `benchmarks/` report every scene without an answer. All answers are made up."""

import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import rockjax as rj
from rockjax import _results as results

if sys.version_info < (3, 12):
    pytest.skip("the benchmarks need Python 3.12", allow_module_level=True)
pytest.importorskip("tqdm")

from benchmarks import agreement, measure, stress

OUTPUTS = ("peak_rotation", "margin")
KIND = agreement.SceneKind("none", "free", "horizontal", "rest")


def made_up_peaks(rotation, codes, **more):
    rotation, zeros = np.asarray(rotation, float), np.zeros(len(codes))
    slopes = np.zeros((len(codes), 2))
    return SimpleNamespace(
        peak_rotation=rotation,
        margin=zeros,
        overturned=zeros > 0,
        smallest_impact_speed=zeros,
        result=results.result_of(np.asarray(codes)),
        sensitivities=SimpleNamespace(peak_rotation=slopes, margin=slopes),
        errors=SimpleNamespace(peak_rotation=zeros, undecided=zeros > 0),
        **more,
    )


def compare(monkeypatch, peaks, settled=False):
    """Return the differences of four scenes; the batch with `impacts` among its outputs has these peaks."""
    agreed = made_up_peaks(np.full(4, 0.5), np.zeros(4, int))
    monkeypatch.setattr(
        agreement, "solve", lambda _, names, *__, **___: peaks if "impacts" in names else agreed
    )
    values = np.zeros((2, 4, 2))
    sides = np.full_like(values, np.nan), np.full_like(values, np.nan)
    differences = agreement.Differences(values, np.full(values.shape, settled), sides)
    monkeypatch.setattr(agreement, "differentiate", lambda *_: differences)
    batch = SimpleNamespace(t_end=np.zeros(4), podium=rj.Podium(0.1, 1.0))
    return agreement.compare(KIND, batch, OUTPUTS, with_ways=True)


def test_scenes_without_an_answer_are_counted(monkeypatch):
    codes = [results.OVERTURNED, results.OUT_OF_STEPS, results.NOT_FINITE, 0]
    found = compare(monkeypatch, made_up_peaks([0.5, 0.1, 0.1, 0.5], codes))
    assert [(y.scene, y.answer, y.name) for y in found] == [
        (1, "result", agreement.NOT_COMPARED),
        (2, "result", "FAULT"),
    ]
    first = agreement.table(KIND, found, 4)[0]
    assert "1 not compared" in first
    assert "1 FAULT" in first


def test_nan_in_a_finished_scene_is_a_fault(monkeypatch):
    found = compare(monkeypatch, made_up_peaks([0.5, np.nan, 0.6, 0.5], [0, 0, 0, 0]))
    assert [(y.scene, y.name) for y in found] == [(1, "FAULT"), (2, "grazing")]


def test_scenes_that_did_not_finish_have_no_rotation():
    codes = [0, results.OUT_OF_STEPS, results.OVERTURNED]
    rotation, overturned = measure.rotations_and_outcomes(made_up_peaks([0.5, 0.2, 1.0], codes))
    np.testing.assert_array_equal(rotation, [0.5, np.nan, 1.0])
    error = measure.difference_quantiles((rotation, overturned), (np.array([0.5, 0.2, 1.0]), overturned))
    assert all(math.isnan(error[name]) for name in ("median", "p99", "max"))


def answers(codes):
    """Return answers of rigid podiums in the form of `stress.Batch.answers`."""
    names = (*stress.QUANTITIES, "peak_rotation_error", "overturned", "uplifted", "undecided")
    table = {name: np.zeros(len(codes)) for name in names}
    table |= {"result": np.array(codes), "steps": np.ones(len(codes))}
    return table | dict.fromkeys(("overturn_time", "uplift_time"), np.full(len(codes), np.nan))


def test_campaigns_name_every_result_and_count_compared_scenes():
    findings = stress.Findings()
    scenes = SimpleNamespace(options=rj.Options())
    codes = [0, 1, results.WEIGHTLESS, results.HISTORY_FULL, results.OUT_OF_STEPS]
    truth = [0, results.OUT_OF_STEPS, 0, 0, 0]
    stress.judge(findings, scenes, answers(codes), answers(truth), str)
    assert findings.failures == {
        "steps: out_of_steps": 1,
        "result: weightless": 1,
        "result: history_full": 1,
    }
    (row,) = stress.table({"all": [findings]})
    assert (row["number"], row["compared"]) == (5, 1)


def test_references_of_scenes_that_did_not_finish_are_failures(monkeypatch):
    peak = made_up_peaks([0.1], [results.OUT_OF_STEPS], stats=SimpleNamespace(end_time=1.0))
    single = SimpleNamespace(**{**vars(peak), "result": results.result_of(np.array(results.OUT_OF_STEPS))})
    monkeypatch.setattr(rj, "peak_response", lambda *_, **__: single)
    monkeypatch.setattr(
        stress.control, "by_scipy", lambda *_: SimpleNamespace(overturn_time=np.nan, peak=0.1)
    )
    row = stress.against_reference((stress.Group("rigid", "paper", "Ricker"), 1e-9, 2, 1, 0))
    rows = np.array(
        [row, (1e-14, 0.0, True, False), (np.nan, 0.0, True, False), (0.1, 0.0, False, True)], float
    )
    answer, is_failure = stress.count_reference_errors(rows)
    assert list(is_failure) == [True, False, True, False]
    assert answer["beyond estimate"] == 2
