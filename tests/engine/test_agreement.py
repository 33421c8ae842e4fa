"""Random scenes of every kind: every difference of an answer or a derivative has an accepted cause."""

import itertools

import numpy as np
import pytest

from benchmarks import agreement
from benchmarks.agreement import DEVICES, DIRECTIONS, SAMPLED, TOPS, SceneKind

COUNT = 60
GROUPS = ["-".join(parts) for parts in itertools.product(TOPS, DEVICES, DIRECTIONS)]
PULSES = [
    "none-free-horizontal",
    "rigid-power-horizontal",
    "elastic-free-horizontal",
    "truncated-free-vertical",
]


# Scenes with an extremum at a time that depends strongly on both parameters, or where a damper with a small
# exponent changes the acceleration suddenly. The derivatives are those with respect to ln α and the logarithm
# of the scale, from differences that settle.
TURNS = [
    ("modes-free-horizontal-rough", 9, "peak_shear", (11.732441, -5.802766)),
    ("modes-free-horizontal-steps", 40, "peak_shear", (0.01172791, None)),
    ("modes-free-horizontal-steps", 50, "peak_shear", (0.08971475, 0.66294137)),
    ("modes-free-horizontal-steps", 58, "peak_shear", (-1.0926493, 2.4837612)),
    ("modes-free-horizontal-one-sine", 24, "peak_shear", (0.44265801, -0.31773207)),
    ("modes-free-horizontal-ricker", 58, "peak_shear", (3.1930449, 0.8981375)),
    ("elastic-free-horizontal-half-sine", 32, "peak_shear", (0.66474609, 0.38071704)),
    ("elastic-power-horizontal-rest", 58, "margin", (0.8551364, None)),
    ("elastic-power-horizontal-rough", 35, "margin", (2.7477686, None)),
    ("elastic-power-vertical-rough", 10, "margin", (4.8444713, -1.7055603)),
    ("modes-power-vertical-steps", 7, "margin", (4.18381, None)),
]


def faults(group, motion):
    kind = SceneKind.from_name(f"{group}-{motion}")
    deviations = agreement.compare(kind, agreement.scenes(kind, COUNT, seed=1))
    return [str(each) for each in deviations if each.name == "FAULT"]


@pytest.mark.slow(but=["none-power-vertical"])
@pytest.mark.parametrize("group", GROUPS)
def test_under_records_and_from_rest(group):
    assert not [fault for motion in SAMPLED for fault in faults(group, motion)]


@pytest.mark.slow(but=["one-sine-none-free-horizontal"])
@pytest.mark.parametrize("group", PULSES)
@pytest.mark.parametrize("pulse", ["one-sine", "one-cosine"])
def test_under_pulses(group, pulse):
    assert not faults(group, pulse)


@pytest.mark.slow(but=["modes-free-horizontal-steps-58", "elastic-power-horizontal-rest-58"])
@pytest.mark.parametrize(
    ("name", "scene", "output", "right"), TURNS, ids=[f"{name}-{scene}" for name, scene, *_ in TURNS]
)
def test_derivatives_at_turning_points(name, scene, output, right):
    kind = SceneKind.from_name(name)
    batch = agreement.scenes(kind, COUNT, seed=58)
    for rtol in (1e-8, 1e-10, 1e-11, 1e-12):
        peaks = agreement.solve(batch, agreement.OUTPUTS[kind.top], rtol, sensitivities=agreement.PARAMETERS)
        slopes = np.asarray(getattr(peaks.sensitivities, output))[scene]
        for slope, expected in zip(slopes, right, strict=True):
            assert expected is None or slope == pytest.approx(expected, rel=1.5e-5), rtol
