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


RICKER = [rj.Ricker(4.0, 1.0), rj.Ricker(1.5, 1.0)]
SINE = [rj.OneSine(3.0, 0.8)]
# The same pulses at the sampling times of the records, which have the program of the records.
TIMES = 0.02 * np.arange(-150, 151)
SAMPLED = [rj.Record(np.asarray(pulse(TIMES)), 0.02, t_start=-3.0) for pulse in (*RICKER, *SINE)]


def numbers(podium, motions) -> list[int]:
    """Return the numbers of impacts before the peak, which are those of the histories."""
    counts = []
    for motion in motions:
        peak = rj.peak_response(podium, motion, options=OUTPUTS)
        times = np.asarray(rj.simulate(podium, motion).impact_times)
        counts.append(int(np.sum(times < float(peak.peak_rotation_time))))
        assert int(peak.impacts_before_peak) == counts[-1]
    return counts


@pytest.mark.parametrize(
    ("name", "motions"), [("block", [*RICKER, *RECORDS]), ("elastic", [*SAMPLED, *RECORDS])]
)
def test_the_number_is_that_of_the_history(name, motions):
    counts = numbers(PODIUMS[name], motions)
    assert min(counts) == 0
    assert max(counts) >= 3


@pytest.mark.slow
@pytest.mark.parametrize(("name", "motions"), [("block", SINE), ("elastic", [*RICKER, *SINE])])
def test_the_number_under_other_pulses(name, motions):
    assert numbers(PODIUMS[name], motions)


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
