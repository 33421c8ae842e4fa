"""How far the scale of a motion may change before a scene may overturn, against derivatives of the margin."""

import numpy as np
import pytest

import rockjax as rj
from rockjax._batch.batch import responses_with_reach
from rockjax._batch.reach import SMALL

COUNT = 150
RECORD = np.convolve(np.random.default_rng(3).normal(size=500), np.hanning(12) / 3, "same")
# Podiums, and scales of the record between rest and overturning.
PODIUMS = {
    "rigid": (rj.Podium(0.15, 1.5, 10.0, rj.Rigid(50.0)), (0.9, 1.3)),
    "elastic": (rj.Podium(0.15, 1.5, 10.0, rj.Elastic(eta=50.0, T_s=0.4)), (0.2, 1.2)),
}


def motions_of(kind: str, scales: tuple[float, float]):
    if kind == "pulse":
        return rj.Ricker(np.linspace(0.5, 5.0, COUNT), 1.0)
    records = rj.Records.of([rj.Record(RECORD, 0.02)])
    return records.pick(np.zeros(COUNT, np.int32)).scaled(np.linspace(*scales, COUNT))


@pytest.mark.parametrize("structure", PODIUMS)
@pytest.mark.parametrize("motion", ["pulse", "record"])
def test_the_reach_is_that_of_the_margin_or_of_another_turning_point(motion, structure):
    podium, scales = PODIUMS[structure]
    motions = motions_of(motion, scales)
    options = rj.Options(outputs=("margin",), rtol=1e-9, atol=1e-11)
    floats, integers = responses_with_reach(podium, motions, options, False)
    peaks = rj.peak_responses(podium, motions, options=options, sensitivities=["scale"])
    np.testing.assert_allclose(floats["margin"], peaks.margin, rtol=1e-6, atol=1e-9)
    assert np.all(np.isinf(floats["reach"][~integers["uplifted"]]))
    counts = ~integers["overturned"] & integers["uplifted"] & (floats["margin"] < SMALL)
    assert counts.sum() >= 15
    reach = floats["reach"][counts]
    slope = np.asarray(peaks.sensitivities.margin)[counts, 0]
    told = floats["margin"][counts] / np.abs(slope)
    assert np.all(reach <= told * (1 + 1e-5))
    assert np.mean(reach > told * (1 - 1e-5)) > 0.1
