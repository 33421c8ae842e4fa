"""How far the scale of a motion may change before a scene may overturn, against derivatives of the margin."""

import numpy as np
import pytest

import rockjax as rj
from rockjax._batch.batch import responses_with_reach
from rockjax._batch.reach import SMALL

COUNT = 150
RECORD = np.convolve(np.random.default_rng(3).normal(size=500), np.hanning(12) / 3, "same")
MOTIONS = {
    "pulse": lambda: rj.Ricker(np.linspace(0.5, 5.0, COUNT), 1.0),
    "record": lambda: (
        rj.Records.of([rj.Record(RECORD, 0.02)])
        .pick(np.zeros(COUNT, np.int32))
        .scaled(np.linspace(0.2, 1.2, COUNT))
    ),
}
PODIUMS = {
    "rigid": rj.Podium(0.15, 1.5, 10.0, rj.Rigid(50.0)),
    "elastic": rj.Podium(0.15, 1.5, 10.0, rj.Elastic(eta=50.0, T_s=0.4)),
}


@pytest.mark.parametrize("structure", PODIUMS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_the_reach_is_that_of_the_margin_or_of_another_turning_point(motion, structure):
    podium, motions = PODIUMS[structure], MOTIONS[motion]()
    options = rj.Options(outputs=("margin",), rtol=1e-9, atol=1e-11)
    floats, integers = responses_with_reach(podium, motions, options, False)
    peaks = rj.peak_responses(podium, motions, options=options, sensitivities=["scale"])
    np.testing.assert_allclose(floats["margin"], peaks.margin, rtol=1e-6, atol=1e-9)
    assert np.all(np.isinf(floats["reach"][~integers["uplifted"]]))
    counts = ~integers["overturned"] & integers["uplifted"] & (floats["margin"] < SMALL)
    assert counts.sum() > 20
    reach = floats["reach"][counts]
    slope = np.asarray(peaks.sensitivities.margin)[counts, 0]
    told = floats["margin"][counts] / np.abs(slope)
    assert np.all(reach <= told * (1 + 1e-5))
    assert np.mean(reach > told * (1 - 1e-5)) > 0.1
