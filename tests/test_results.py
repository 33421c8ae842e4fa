"""Texts of results state the cause and the remedy."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rockjax import _results as results
from rockjax._responses.peak import Peak


def test_failures_are_counted_with_their_cures():
    codes = np.array([[results.SETTLED, results.OUT_OF_STEPS], [results.OUT_OF_STEPS, results.WEIGHTLESS]])
    text = results.explain_failures(codes)
    assert text.startswith("3 of 4 scenes did not finish. 2 out_of_steps: ")
    assert "raise max_steps" in text
    assert "1 weightless: " in text


def test_finished_scenes_need_no_explanation():
    assert (
        results.explain_failures(np.array([results.SETTLED, results.END_OF_TIME, results.OVERTURNED])) == ""
    )


@pytest.mark.parametrize("code", range(results.OVERTURNED + 1, len(results.NAMES)))
def test_every_failure_names_a_cure(code):
    assert "; " in results.explain(code)


def test_joints_of_scenes_that_did_not_finish_are_not_closed():
    codes = np.array([results.END_OF_TIME, results.OUT_OF_STEPS])
    values = {"least_axial_force": np.ones((2, 2)), "peak_friction": np.zeros((2, 2))}
    peak: Any = SimpleNamespace(
        values=values, result=results.result_of(codes), overturned=np.zeros(2, bool), has_elevation=True
    )
    closed: Any = Peak.joints_closed
    np.testing.assert_array_equal(closed.fget(peak), [True, False])
