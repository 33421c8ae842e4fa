"""The number of impacts before the peak rotation, against the impact times of histories."""

import jax
import numpy as np
import pytest

import rockjax as rj

OUTPUTS = rj.Options(outputs=("peak_rotation", "impacts_before_peak"))
NOISE = np.random.default_rng(4).normal(0.0, 2.5, (3, 301))
RECORDS = [rj.Record(np.convolve(row, np.ones(8) / 3, "same"), dt=0.02) for row in NOISE]
PODIUMS = {
    "block": rj.Podium(alpha=0.2, R=1.5, gamma=0.0),
    "elastic": rj.Podium(alpha=0.2, R=1.5, gamma=1.0, superstructure=rj.Elastic(eta=2.0, T_s=0.4, zeta=0.05)),
}


@pytest.mark.parametrize("name", PODIUMS)
def test_the_number_is_that_of_the_history(name):
    podium, counts = PODIUMS[name], []
    motions = [rj.Ricker(4.0, 1.0), rj.OneSine(3.0, 0.8), rj.Ricker(1.5, 1.0), *RECORDS]
    for motion in motions:
        peak = rj.peak_response(podium, motion, options=OUTPUTS)
        times = np.asarray(rj.simulate(podium, motion).impact_times)
        counts.append(int(np.sum(times < float(peak.peak_rotation_time))))
        assert int(peak.impacts_before_peak) == counts[-1]
    assert min(counts) == 0
    assert max(counts) >= 3


def test_batches_and_derivatives():
    podium, motions = PODIUMS["block"], [rj.Ricker(4.0, 1.0), rj.Ricker(1.5, 1.0)]
    batch = rj.peak_responses(podium, motions, options=OUTPUTS)
    single = [int(rj.peak_response(podium, y, options=OUTPUTS).impacts_before_peak) for y in motions]
    np.testing.assert_array_equal(batch.impacts_before_peak, single)

    def rotation(alpha):
        peak = rj.peak_response(podium.replace(alpha=alpha), motions[0], options=OUTPUTS)
        return peak.peak_rotation + peak.impacts_before_peak

    plain = lambda alpha: rj.peak_response(podium.replace(alpha=alpha), motions[0]).peak_rotation
    np.testing.assert_allclose(jax.grad(rotation)(0.2), jax.grad(plain)(0.2), rtol=1e-6)
    assert np.isnan(rj.peak_response(podium, motions[0]).impacts_before_peak)  # not requested
