"""Edge distances (changes of scale before a scene may overturn), compared with differences of the margin."""

import numpy as np
import pytest

import rockjax as rj
from rockjax._batch.batch import raw_responses
from rockjax._batch.edge_distance import MARGIN_USED_BELOW

COUNT = 150
STEP = 1e-7  # change of the scale for differences
RECORD = np.convolve(np.random.default_rng(3).normal(size=500), np.hanning(12) / 3, "same")
# Podiums, and scales of the record between no uplift and overturning.
PODIUMS = {
    "rigid": (rj.Podium(0.15, 1.5, 10.0, rj.Rigid(50.0)), (1.1, 1.2)),
    "elastic": (rj.Podium(0.15, 1.5, 10.0, rj.Elastic(eta=50.0, T_s=0.4)), (0.3, 0.7)),
}


def motions_of(kind: str, scales: tuple[float, float], factor: np.ndarray):
    if kind == "pulse":
        return rj.Ricker(np.linspace(0.5, 5.0, COUNT), 1.0).scaled(factor)
    records = rj.Records.of([rj.Record(RECORD, 0.02)])
    return records.pick(np.zeros(COUNT, np.int32)).scaled(np.linspace(*scales, COUNT) * factor)


@pytest.mark.slow(but=["record-rigid"])
@pytest.mark.parametrize("structure", PODIUMS)
@pytest.mark.parametrize("motion", ["pulse", "record"])
def test_the_edge_distance_is_that_of_the_margin_or_of_another_turning_point(motion, structure):
    podium, scales = PODIUMS[structure]
    options = rj.Options(outputs=("margin", "impacts"), rtol=1e-11, atol=1e-13)
    at, above, below = (
        raw_responses(
            podium, motions_of(motion, scales, np.full(COUNT, 1 + step)), options, False, edge_distance=True
        )
        for step in (0.0, STEP, -STEP)
    )
    floats, integers = at
    assert np.all(np.isinf(floats["edge_distance"][~integers["uplifted"]]))
    # If the edge distance is short, derivatives change within a step.
    counts = (
        integers["uplifted"]
        & (floats["margin"] < MARGIN_USED_BELOW)
        & (floats["edge_distance"] > 1000 * STEP)
    )
    for _, same in (above, below):  # the number of impacts stays the same
        counts &= ~same["overturned"] & (same["impacts"] == integers["impacts"])
    assert counts.sum() >= 15
    slope = ((above[0]["margin"] - below[0]["margin"]) / (2 * STEP))[counts]
    distance, expected = floats["edge_distance"][counts], floats["margin"][counts] / np.abs(slope)
    assert np.all(distance <= expected * (1 + 1e-3))
    assert np.mean(distance > expected * (1 - 1e-3)) > 0.1
