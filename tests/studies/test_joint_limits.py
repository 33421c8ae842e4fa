"""Joints that open or slide as limit states of fragilities and of random motions."""

import numpy as np
import pytest

import rockjax as rj

PODIUM = rj.Podium(0.15, 1.5, 10.0, rj.Rigid(50.0), elevation=rj.Elevation([-2.4, 2.4], 0.6, 9.0))
OUTPUTS = "peak_rotation", "axial_force", "peak_friction"


@pytest.fixture(scope="module")
def analysis():
    records = rj.synthetic_motions(6, seed=3, dt=0.02, duration=8.0)
    options = rj.Options(rtol=1e-8, atol=1e-10, outputs=OUTPUTS, throw=False)
    return rj.incremental_dynamic_analysis(PODIUM, records, np.linspace(0.5, 6.0, 8), options=options)


def test_a_fragility_of_joints_that_open(analysis):
    limit = float(analysis["least_axial_force"].min("joint").median())
    curve = rj.fragility(analysis, limit=("least_axial_force", limit), confidence=None)
    opened = (np.asarray(analysis["least_axial_force"].min("joint")) < limit) | analysis["overturned"].values
    np.testing.assert_array_equal(curve["observed"], opened.mean(axis=0))
    assert curve.attrs["limit_state"] == f"least_axial_force < {limit:g}"
    assert curve.attrs["method_of_fit"] == "stripes"
    assert float(curve["median_capacity"]) < float(rj.fragility(analysis, confidence=None)["median_capacity"])


def test_a_limit_that_is_never_exceeded_is_overturning(analysis):
    curve = rj.fragility(analysis, limit=("least_axial_force", -1e9), confidence=None)
    expected = rj.fragility(analysis, method="stripes", confidence=None)
    assert float(curve["median_capacity"]) == float(expected["median_capacity"])


def test_bad_limits(analysis):
    with pytest.raises(ValueError, match=r"limit must be \(name, value\) with one of the peaks"):
        rj.fragility(analysis, limit=("peak_impact_friction", 0.3))
    with pytest.raises(ValueError, match='method must be "stripes" with a limit'):
        rj.fragility(analysis, limit=("peak_friction", 0.3), method="capacities")


@pytest.mark.slow
def test_limit_states_of_random_motions():
    """G of both kinds of limit agrees with peaks under the same motions."""
    from rockjax._risk.structure import OPTIONS, StructureLimitState, parse_limit, records_from_samples

    motion = rj.GaussianMotion(n=200, dt=0.02, S_0=0.02)
    u = np.random.default_rng(2).normal(size=(5, motion.dimension))
    motions = records_from_samples(motion, u)
    peaks = rj.peak_responses(PODIUM, motions, options=OPTIONS.replace(outputs=OUTPUTS, throw=False))
    least, friction = np.asarray(peaks.least_axial_force), np.asarray(peaks.peak_friction)
    load = np.asarray(PODIUM.dead_load)
    expected = np.min(least / load, axis=-1) / 0.7 - 0.3 / 0.7  # 1 − (1 − N/N_0)/0.7
    found = StructureLimitState(PODIUM, motion, parse_limit("test", ("unloading", 0.7), PODIUM)).values(u)
    np.testing.assert_allclose(
        found, np.where(peaks.overturned, np.minimum(expected, 0), expected), atol=1e-7
    )
    found = StructureLimitState(PODIUM, motion, parse_limit("test", ("friction", 0.2), PODIUM)).values(u)
    fails = np.asarray(peaks.overturned) | (np.max(friction, axis=-1) >= 0.2)
    np.testing.assert_array_equal(np.asarray(found) <= 0, fails)
    shears = rj.peak_responses(
        PODIUM, motions, options=OPTIONS.replace(outputs=("peak_foundation_shear",), throw=False)
    )
    expected = 1 - np.asarray(shears.peak_foundation_shear) / 0.14
    limit = parse_limit("test", ("foundation shear", 0.14), PODIUM)
    found = StructureLimitState(PODIUM, motion, limit).values(u)
    np.testing.assert_allclose(
        found, np.where(peaks.overturned, np.minimum(expected, 0), expected), atol=1e-7
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limit", "value"), [("unloading", 0.7), ("friction", 0.2), ("foundation shear", 0.14)]
)
def test_slopes_of_limit_states(limit, value):
    """Derivatives of G with respect to the size of the motion and to parameters, against differences."""
    from rockjax._parameters.variants import with_values
    from rockjax._risk.structure import StructureLimitState, parse_limit

    motion, names = rj.GaussianMotion(n=200, dt=0.02, S_0=0.02), ("alpha", "position_2", "top_height")
    u = np.random.default_rng(2).normal(size=(3, motion.dimension))
    state = lambda podium: StructureLimitState(podium, motion, parse_limit("test", (limit, value), podium))
    G, by_size, by_names = state(PODIUM).log_slopes(u, names)
    np.testing.assert_allclose(G, state(PODIUM).values(u), atol=1e-9)
    h = 1e-4

    def slope(value_at):
        return (8 * (value_at(h) - value_at(-h)) - (value_at(2 * h) - value_at(-2 * h))) / (12 * h)

    expected = slope(lambda step: state(PODIUM).values(u * (1 + step)))
    np.testing.assert_allclose(by_size, expected, rtol=1e-4, atol=1e-5)
    given = {"alpha": 0.15, "position_2": 2.4, "top_height": 9.0}
    for k, name in enumerate(names):
        varied = lambda step, name=name: with_values(PODIUM, {name: given[name] * (1 + step)})
        expected = slope(lambda step, varied=varied: state(varied(step)).values(u))
        np.testing.assert_allclose(by_names[:, k], expected, rtol=1e-4, atol=1e-5, err_msg=name)
