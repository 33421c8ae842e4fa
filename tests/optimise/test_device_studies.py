"""Studies that size devices: their reports of designs, and pairs of records."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from benchmarks import device_design


def test_pairs_have_one_length_and_one_factor():
    motions = rj.synthetic_motions(3, seed=5, duration=2.0)
    upwards = rj.synthetic_motions(3, seed=6, duration=3.0)
    motions = rj.Motions(
        tuple(dataclasses.replace(a, vertical=b) for a, b in zip(motions, upwards, strict=True))
    )
    pairs = device_design.pairs_of(motions, 2.0)
    assert {pair.horizontal.acceleration.shape for pair in pairs} == {(301,)}
    for pair, motion, up in zip(pairs, motions, upwards, strict=True):
        assert np.abs(pair.horizontal.acceleration).max() == pytest.approx(2.0)
        assert np.abs(pair.vertical.acceleration).max() == pytest.approx(2.0 * up.pga / motion.pga)


def test_a_summary_omits_scenes_without_rocking_or_with_overturning():
    row = {"overturned with": False, "overturned without": False}
    rocked = [row | {"with": 0.1 * factor, "without": 0.1} for factor in (0.5, 0.9, 1.1, 1.25)]
    others = [
        row | {"with": 1e-9, "without": 1e-8},
        row | {"with": 1.0, "without": 0.2, "overturned with": True},
    ]
    found = device_design.summary([*rocked, *others])
    assert (found["pairs"], found["compared"], found["larger with"]) == (6, 4, 2)
    assert (found["overturned with"], found["overturned without"]) == (1, 0)
    assert found["smallest"] == pytest.approx(0.5)
    assert found["largest"] == pytest.approx(1.25)
    assert found["median"] == pytest.approx(np.sqrt(0.9 * 1.1))


def test_the_force_of_a_tendon():
    podium = rj.Podium.from_dimensions(**device_design.RIGID, tendon_force=50e3, tendon_stiffness=2e6)
    length = 4 * float(podium.R * jnp.sin(podium.alpha) * jnp.sin(0.3 * podium.alpha / 2))  # (C1)
    expected = (50e3 + 2e6 * length) / device_design.WEIGHT
    assert float(device_design.force_at(podium, 0.3)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.slow
def test_a_design_is_checked_by_simulations_of_its_own():
    problem = device_design.least_force(device_design.pulses(2))
    answer = problem.solve()
    found = device_design.check(problem, answer)
    (prices,) = answer.multipliers.values()
    assert 0 <= found.margin < 1e-5
    assert found.rotation == pytest.approx(device_design.LIMIT, rel=1e-5)
    assert found.price == pytest.approx(np.sum(prices), rel=1e-4)
    assert found.residual < 1e-5
    more = answer.structure.replace(tendon_force=1.1 * answer.variables["tendon_force"])
    elsewhere = device_design.check(problem, dataclasses.replace(answer, structure=more))
    assert elsewhere.margin > 1e-3
    assert elsewhere.residual > 1e-3  # until the target is active
