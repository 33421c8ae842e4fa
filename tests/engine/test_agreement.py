"""Random scenes of every kind: every difference of an answer or a derivative has an accepted cause.

Scenes under pulses are slow; derivatives of pulses are also in `test_bouncing.py` and `test_deck_outputs.py`.
"""

import itertools

import numpy as np
import pytest

from benchmarks import agreement
from benchmarks.agreement import DEVICES, DIRECTIONS, SAMPLED, TOPS, SceneKind

COUNT = 60
TOLERANCES = (1e-8, 1e-10, 1e-11, 1e-12)
GROUPS = ["-".join(parts) for parts in itertools.product(TOPS, DEVICES, DIRECTIONS)]
FORCES = [
    *itertools.product(("none-free-horizontal", "rigid-free-horizontal", "modes-free-horizontal"), SAMPLED),
    ("elastic-free-horizontal", "rough"),
    ("elastic-free-horizontal", "rest"),
    ("elastic-free-horizontal", "one-sine"),
]
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

# Scenes in which a force in a joint turns at such a time: seed, scene, answer, joint, and the derivatives.
FORCE_TURNS = [
    ("elastic-free-horizontal-rough", 1, 46, "peak_axial_force", 1, (421.11389, -287.95270)),
    ("elastic-free-horizontal-rough", 1, 46, "peak_foundation_shear", None, (1.7415540, -0.84602201)),
    ("elastic-free-horizontal-rough", 58, 49, "least_axial_force", 0, (-18.361946, 2.1179151)),
    ("elastic-free-horizontal-steps", 1, 16, "peak_axial_force", 0, (-31.537348, 103.27511)),
    ("elastic-free-horizontal-steps", 1, 35, "least_axial_force", 0, (434.59993, -1419.4371)),
    ("elastic-free-horizontal-steps", 58, 28, "peak_axial_force", 1, (20.838188, -11.243084)),
    ("elastic-free-horizontal-one-sine", 1, 19, "peak_friction", 1, (0.63469997, -0.15500349)),
]


def faults(group, motion, answers=None):
    kind = SceneKind.from_name(f"{group}-{motion}")
    batch = agreement.scenes(kind, COUNT, seed=1)
    deviations = agreement.compare(kind, batch, answers or agreement.OUTPUTS[kind.top])
    return [str(each) for each in deviations if each.name == "FAULT"]


@pytest.mark.slow(but=["none-power-vertical"])
@pytest.mark.parametrize("group", GROUPS)
def test_under_records_and_from_rest(group):
    assert not [fault for motion in SAMPLED for fault in faults(group, motion)]


@pytest.mark.slow
@pytest.mark.parametrize(("group", "motion"), FORCES, ids=["-".join(case) for case in FORCES])
def test_forces_in_the_joints(group, motion):
    assert not faults(group, motion, agreement.FORCES)


@pytest.mark.slow
@pytest.mark.parametrize("group", PULSES)
@pytest.mark.parametrize("pulse", ["one-sine", "one-cosine"])
def test_under_pulses(group, pulse):
    assert not faults(group, pulse)


@pytest.mark.slow(but=["elastic-power-horizontal-rest-58"])
@pytest.mark.parametrize(
    ("name", "scene", "output", "right"), TURNS, ids=[f"{name}-{scene}" for name, scene, *_ in TURNS]
)
def test_derivatives_at_turning_points(name, scene, output, right):
    kind = SceneKind.from_name(name)
    batch = agreement.scenes(kind, COUNT, seed=58).only(scene)
    for rtol in TOLERANCES:
        peaks = agreement.solve(batch, agreement.OUTPUTS[kind.top], rtol, sensitivities=agreement.PARAMETERS)
        slopes = np.asarray(getattr(peaks.sensitivities, output))[0]
        for slope, expected in zip(slopes, right, strict=True):
            assert expected is None or slope == pytest.approx(expected, rel=1.5e-5), rtol


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed", "scene", "answer", "joint", "right"),
    FORCE_TURNS,
    ids=[f"{name}-{scene}-{answer}" for name, _, scene, answer, *_ in FORCE_TURNS],
)
def test_derivatives_of_forces_at_turning_points(name, seed, scene, answer, joint, right):
    batch = agreement.scenes(SceneKind.from_name(name), COUNT, seed).only(scene)
    for rtol in TOLERANCES:
        peaks = agreement.solve(batch, agreement.FORCES, rtol, sensitivities=agreement.PARAMETERS)
        slopes = np.asarray(getattr(peaks.sensitivities, answer))[0]
        slopes = slopes if joint is None else slopes[joint]
        assert slopes == pytest.approx(right, rel=3e-5), rtol


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["rough", "steps"])
def test_friction_demand_is_infinite_where_a_joint_opens(motion):
    """In some of these scenes T changes its sign while the joint is open."""
    batch = agreement.scenes(SceneKind("elastic", "free", "horizontal", motion), COUNT, seed=1)
    for rtol in TOLERANCES:
        peaks = agreement.solve(batch, agreement.FORCES, rtol, sensitivities=agreement.PARAMETERS)
        opens = np.asarray(peaks.least_axial_force) < 0
        assert opens.any()
        assert not opens.all()
        np.testing.assert_array_equal(np.isinf(peaks.peak_friction), opens)
        assert np.all(np.asarray(peaks.peak_friction) >= 0)
