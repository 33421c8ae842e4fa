"""Full contact: scenes that never lift, and derivatives through the first uplift."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from tests.scenes import PODIUMS, elastic, options, pulse, shaking

ROTATION = ("peak_rotation",)
UPLIFT = float(PODIUMS["elastic"].uplift_acceleration)
WEAK = 0.35  # factor on the uplift acceleration, with which columns lift late or never


def test_scenes_that_never_lift_settle():
    for T_s in (0.01, 0.1, 1.0):
        podium = elastic(T_s)
        peak = rj.peak_response(
            podium, rj.Ricker(WEAK * UPLIFT / 10, 1.0), options=options(1e-9, outputs=ROTATION)
        )
        assert not bool(peak.uplifted)
        assert peak.result == rj.RESULTS.settled


def test_peaks_of_the_superstructure_are_those_of_the_history():
    podium, motion = elastic(0.5), rj.Ricker(WEAK * UPLIFT / 2, 1.0)
    history = rj.simulate(podium, motion, options=options(1e-10))
    peak = rj.peak_response(podium, motion, options=options(1e-10))
    assert float(peak.peak_deformation) == pytest.approx(float(history.peak_deformation), rel=1e-8)
    assert float(peak.peak_shear) == pytest.approx(float(history.peak_shear), rel=1e-8)


@pytest.mark.slow(but=["record"])
@pytest.mark.parametrize("motion", [pulse(ratio=1.8), shaking(200, peak=4.0)], ids=["pulse", "record"])
def test_derivatives_through_full_contact(motion):
    """Forward and reverse derivatives agree with finite differences, also for parameters that change
    breakpoints."""

    def peak(y, o):
        podium = elastic(0.25).replace(
            alpha=y[0], gamma=10 * y[1], superstructure=rj.Elastic(100.0 * y[2], 0.25 * y[3], 0.05 * y[4])
        )
        if isinstance(motion, rj.Record):
            moved = rj.Record(motion.acceleration, motion.dt * y[5], t_start=0.1 * y[6])
        else:
            moved = rj.Ricker(motion.a_p * y[5], motion.T_p * y[6])
        return rj.peak_response(podium, moved, options=o).peak_rotation

    y = jnp.array([0.15, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    o, fine = options(1e-11, outputs=ROTATION), options(1e-13, "dopri8", outputs=ROTATION)
    forward, reverse = jax.jacfwd(peak)(y, o), jax.grad(peak)(y, o)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-12)
    numeric = []
    for k in range(len(y)):
        d = 1e-5 * jnp.zeros_like(y).at[k].set(1.0)
        slope = lambda h, d=d: (peak(y + h * d, fine) - peak(y - h * d, fine)) / (2e-5 * h)
        numeric.append((4 * slope(0.5) - slope(1.0)) / 3)
    np.testing.assert_allclose(forward, numeric, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("shear", [False, True])
def test_scenes_side_by_side_share_the_samples_of_records(shear):
    """The program must not copy the table of samples into every lane."""
    table = rj.Records.of([shaking(61, seed=k) for k in range(3)])

    def peak(scale):
        outputs = ("peak_rotation", "peak_shear") if shear else ("peak_rotation",)
        motion, options = table.pick(1).scaled(scale), rj.Options(outputs=outputs)
        return rj.peak_response(PODIUMS["rigid"], motion, options=options).peak_rotation

    program = jax.jit(jax.vmap(peak)).lower(jnp.linspace(0.5, 2.0, 5)).as_text()
    assert "tensor<3x61xf64>" in program
    assert "tensor<5x3x61xf64>" not in program
