"""Facts 19 to 21 of the worked example: eight storeys on sixteen columns under three sets of motions."""

from pathlib import Path

import numpy as np
import pytest

import rockjax as rj
from rockjax._report.scales import least_factors
from rockjax._report.scenes import Scenes
from rockjax._report.store import Store

PROBLEM = Path(__file__).parents[2] / "docs" / "reports" / "eight-storeys.toml"


@pytest.fixture(scope="module")
def problem():
    return rj.read_problem(PROBLEM)


def peaks(problem, name, podium):
    options = problem.options.replace(outputs=("peak_rotation",), throw=False)
    return rj.peak_responses(podium, problem.motions[name].excitations, options=options)


@pytest.mark.slow
def test_rotation_under_both_laws_of_impact(problem):
    """Facts 19 and 20: rotation under the paper's and the compatible law."""
    podium = problem.podium
    largest = peaks(problem, "maximum", podium)
    k = int(np.argmax(largest.peak_rotation))
    assert k == 8
    np.testing.assert_allclose(largest.peak_rotation[k], 0.467476379, rtol=2e-6)
    np.testing.assert_allclose(largest.peak_rotation_time[k], 6.859404981, rtol=1e-5)
    np.testing.assert_allclose(largest.uplift_time[k], 3.022122992, rtol=1e-8)
    design = np.asarray(peaks(problem, "design", podium).peak_rotation)
    assert np.argmax(design) == 8
    assert design.max() == pytest.approx(0.095611, abs=1e-6)
    other = podium.replace(restitution="compatible")
    np.testing.assert_allclose(other.restitution_factor, 0.5213818050, rtol=1e-10)
    compatible = np.asarray(peaks(problem, "maximum", other).peak_rotation)
    assert np.argmax(compatible) == 1
    assert compatible.max() == pytest.approx(0.232319, abs=1e-6)


@pytest.mark.slow
def test_the_window_of_overturning(problem):
    """Fact 21: a window of 0.04 % begins 2.1 % above the motion."""
    import dataclasses

    motions = problem.motions["maximum"]
    one = dataclasses.replace(motions, members=motions.members[8:9], names=motions.names[8:9])
    scenes = Scenes(dataclasses.replace(problem, motions={"maximum": one}), Store(), {})
    window = least_factors(scenes, "maximum", "overturning")
    pga = one.members[0].pga
    np.testing.assert_allclose(window["factor"] * pga, [4.70744], atol=1e-5)
    np.testing.assert_allclose(window["survives_from"] * pga, [4.70937], atol=1e-5)
    assert float(window["factor"][0]) == pytest.approx(1.0214, abs=5e-5)
