"""Elastic podiums under a motion and under its mirror image: equal answers, in equally many steps.

Scenes under a full sine are slow; Ricker pulses and noise run the same code."""

import jax
import numpy as np
import pytest

import rockjax as rj
from benchmarks import agreement
from rockjax._report.uplift import UpliftRatio

COUNT = 60
PULSES = {"ricker": rj.Ricker, "one-sine": rj.OneSine}
ROTATION = rj.Options(outputs=("peak_rotation",))  # no other output shortens steps in full contact


def assert_mirrored(a, b, names):
    """Check that answers and numbers of trial steps are the same."""
    for name in names:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    for name in ("steps", "rejected"):
        np.testing.assert_array_equal(getattr(a.stats, name), getattr(b.stats, name), err_msg=name)


@pytest.mark.slow(but=["ricker"])
@pytest.mark.parametrize("pulse", PULSES)
def test_demand_that_just_reaches_or_misses_uplift(pulse):
    """A step in full contact must end where the demand turns, at a positive or a negative value: otherwise
    the polynomial of the step decides whether the columns lift."""
    rng = np.random.default_rng(3)
    uniform = lambda low, high: rng.uniform(low, high, COUNT)
    podium = rj.Podium(
        alpha=uniform(0.1, 0.3),
        R=uniform(1, 3),
        gamma=uniform(0.5, 20),
        superstructure=rj.Elastic(10 ** uniform(-1, 2), 10 ** uniform(-1.3, 0.3), uniform(0.01, 0.1)),
    )
    T_p, a_p = uniform(0.1, 2), 0.1 * np.asarray(podium.uplift_ground_acceleration)
    fine = rj.Options(rtol=1e-13, atol=1e-15, outputs=(UpliftRatio(),))
    for _ in range(2):  # the demand is proportional to the motion until uplift
        a_p *= 0.999 / np.asarray(
            rj.peak_responses(podium, PULSES[pulse](a_p, T_p), options=fine).uplift_ratio
        )
    a_p /= 0.999
    for change in (1e-5, 1e-7, -1e-7, -1e-5):
        motion = PULSES[pulse](a_p * (1 + change), T_p)
        positive, negative = (
            rj.peak_responses(podium, y, options=ROTATION) for y in (motion, motion.scaled(-1))
        )
        np.testing.assert_array_equal(positive.uplifted, change > 0)
        assert_mirrored(positive, negative, ("uplifted", "uplift_time", "peak_rotation"))


@pytest.mark.slow(but=["rough", "rest"])
@pytest.mark.parametrize("motion", ["rough", "rest", "one-sine"])
def test_random_scenes(motion):
    """Scenes that start at rest are included: there the rates of all quantities are zero."""
    batch = agreement.scenes(agreement.SceneKind("elastic", "free", "horizontal", motion), COUNT, seed=7)
    mirrored = batch._replace(
        motion=batch.motion.scaled(-np.ones(COUNT)), initial=jax.tree.map(np.negative, batch.initial)
    )
    names = rj.Options().outputs
    first, second = (agreement.solve(y, names, 1e-8) for y in (batch, mirrored))
    assert_mirrored(first, second, names)
