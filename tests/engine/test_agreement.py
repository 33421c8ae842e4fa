"""Random scenes of every kind: every difference of an answer or a derivative has an accepted cause."""

import itertools

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


def faults(group, motion):
    kind = SceneKind(*f"{group}-{motion}".split("-"))
    deviations = agreement.compare(kind, agreement.scenes(kind, COUNT, seed=1))
    return [str(each) for each in deviations if each.name == "FAULT"]


@pytest.mark.slow(but=["none-power-vertical"])
@pytest.mark.parametrize("group", GROUPS)
def test_under_records_and_from_rest(group):
    assert not [fault for motion in SAMPLED for fault in faults(group, motion)]


@pytest.mark.slow(but=["OneSine-none-free-horizontal"])
@pytest.mark.parametrize("group", PULSES)
@pytest.mark.parametrize("pulse", ["OneSine", "OneCosine"])
def test_under_pulses(group, pulse):
    assert not faults(group, pulse)
