"""Designs with fresh samples of motions in every step: the samples, the results of searches, and their
reports."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import optimise
import rockjax as rj
from optimise._suite import Suite

BLOCK = rj.Podium(alpha=0.3, R=1.0)
BOX = {"alpha": (0.05, 0.5)}
ADAM = optax.adam(0.02)
HAZARD = rj.Hazard([0.5, 2.0, 8.0, 30.0], [5e-2, 5e-3, 2e-4, 2e-5])
MOTION = rj.GaussianMotion(31, 0.1, 0.02)


def records(count: int, seed: int = 0) -> list[rj.Record]:
    """Return records whose largest sample is e^x, where x has the mean 0 and the standard deviation 0.4."""
    x = np.random.default_rng(seed).normal(scale=0.4, size=count)
    x -= x.mean()
    return [rj.Record(np.array([0.0, np.exp(y), 0.0]), 0.1) for y in x]


class OfFormula(optimise.MedianCapacity):
    """Target with a formula for the capacities: 10 α R divided by the largest sample."""

    def least_scales(self, podium, options):
        del options

        def least(motion):
            return 10 * podium.alpha * podium.R / (motion.scale * motion.acceleration[motion.which, 1])

        return self.suite.map_motions(least)


class OfSeparateColumns(OfFormula):
    """Target with a formula that depends on the positions of the columns."""

    def least_scales(self, podium, options):
        return super().least_scales(podium, options) * jnp.sum(podium.elevation.columns**2)


Known: Any = OfFormula


def slenderness(podium):
    return podium.alpha


def slender_and_small(podium):
    return podium.alpha + 0.1 * podium.R**2


def design_block(at_least=2.0, batch=16, verify=256, box=BOX, minimise=slenderness, seed=0, **how):
    fresh = optimise.FreshSamples(records(400), batch, verify=verify, seed=seed)
    how = {"method": ADAM, "starts": 3} | how
    return optimise.design(BLOCK, box, minimise, Known(at_least, fresh), **how)


def test_drawn_motions():
    fresh = optimise.FreshSamples(MOTION, 8, verify=16, seed=3)
    first, again, other = fresh.draw(0), fresh.draw(0), fresh.draw(1)
    assert first.acceleration.shape == (8, 31)
    assert np.array_equal(first.acceleration, again.acceleration)
    assert not np.array_equal(first.acceleration, other.acceleration)
    assert not np.array_equal(first.acceleration, optimise.FreshSamples(MOTION, 8, verify=8).draw(0).table)
    parts = fresh.sample(0)
    assert [len(part.which) for part in parts] == [8, 8]
    assert not np.array_equal(parts[0].acceleration, parts[1].acceleration)
    # A million samples have the dispersion of the motion.
    many = optimise.FreshSamples(MOTION, 4000, verify=4000).draw(0)
    assert np.allclose(np.std(many.acceleration, axis=0), MOTION.standard_deviation(), rtol=0.05, atol=1e-12)
    of_list = optimise.FreshSamples(records(50), 8, verify=8)
    assert of_list.draw(0).acceleration.shape[0] == 50  # stored once
    assert "8 of 50 records" in repr(of_list)
    drawn = np.concatenate([of_list.draw(k).which for k in range(100)])
    assert set(drawn) == set(range(50))


def test_a_frequency_draws_records_of_unit_intensity():
    fresh = optimise.FreshSamples(records(20), 8, verify=8)
    target = optimise.AnnualFrequency(4e-4, HAZARD, fresh)
    source = target.suite.fresh_samples
    assert source is not None
    tops = Suite.of(source).map_motions(lambda m: m.scale * jnp.max(jnp.abs(m.acceleration[m.which])))
    assert np.allclose(tops, 1.0)


def test_a_search_by_fresh_samples_finds_the_design_of_the_suite():
    """The median of all records gives 10 α = 2 e^0. The search adds an allowance for the scatter between two
    samples, 2.33 · 0.4/√256, and for the scatter of the mean of the steps."""
    answer = design_block()
    assert answer.satisfied
    assert answer.result == optimise.RESULTS.averaged
    ends = [start.objective for start in answer.starts]
    assert all(start.satisfied for start in answer.starts)
    assert np.allclose(ends, 0.2, rtol=0.15)
    assert min(ends) > 0.2 * 0.96
    (name,) = answer.margins
    assert 0 <= answer.margins[name][0] < 0.2
    assert answer.standard_errors[name][0] == pytest.approx(0.4 / 16, rel=0.3)
    assert answer.multipliers[name][0] == pytest.approx(0.2, rel=0.15)  # d ln α with respect to the median
    assert "from an independent sample" in repr(answer)
    assert answer.stats.scenes >= 3 * (300 * 16 + 256)
    # Equal seeds give equal results, other seeds do not.
    short = [design_block(seed=seed, max_iterations=20, starts=1).objective for seed in (0, 0, 1)]
    assert short[0] == short[1] != short[2]
    # Larger samples give a more accurate result.
    fine = design_block(batch=64, verify=4096)
    assert abs(fine.objective - 0.2) < abs(answer.objective - 0.2)
    assert fine.objective == pytest.approx(0.2, rel=0.03)


def test_two_variables_by_fresh_samples():
    """The minimum of α + R²/10 with 10 α R ≥ 2 (1 + allowance): the multiplier balances both."""
    box = {"alpha": (0.05, 0.8), "R": (0.3, 3.0)}
    answer = design_block(
        box=box, minimise=slender_and_small, batch=32, verify=1024, max_iterations=600, starts=2
    )
    assert answer.satisfied
    alpha, R = answer.variables["alpha"], answer.variables["R"]
    assert alpha * R == pytest.approx(0.2, rel=0.1)
    assert (
        pytest.approx(alpha / R, rel=0.15) == 0.2 * R
    )  # ratio of ∂f/∂R and ∂f/∂α, equal to that of the target


def test_starts_without_a_valid_structure_are_left_out():
    """The columns of some random starts overlap."""
    column = optimise.Dimensions(
        width=0.2, height=3.0, column_mass=500.0, beam_mass=3e4, positions=[0.0, 1.0]
    )
    target: Any = OfSeparateColumns(1.0, optimise.FreshSamples(records(40), 4, verify=4))
    box = {"width": (0.2, 0.9), "position_1": (0.0, 0.75)}
    answer = optimise.design(column, box, slenderness, target, method=ADAM, starts=4, max_iterations=2)
    is_finite = [np.isfinite(start.objective) for start in answer.starts]
    assert any(is_finite)
    assert not all(is_finite)


def test_infeasible_targets_are_reported():
    answer = design_block(at_least=20.0)
    assert not answer.satisfied
    assert answer.result == optimise.RESULTS.infeasible
    assert answer.variables["alpha"] == pytest.approx(0.5)


def test_a_target_that_stays_is_kept_beside_them():
    stays = optimise.FreshSamples(records(400), 16)
    wide = Known(2.4, records(40, seed=1), name="stays")
    answer = optimise.design(BLOCK, BOX, slenderness, [Known(2.0, stays), wide], method=ADAM)
    assert answer.satisfied
    assert answer.objective == pytest.approx(0.24, rel=0.02)
    assert list(answer.standard_errors) == ["median overturning scale ≥ 2"]
    assert answer.margins["stays"][0] >= 0


class Stops:
    """Progress bar that acts like Ctrl-C."""

    n = 0

    def update(self, count):
        self.n += count
        if self.n == 40:
            raise KeyboardInterrupt


def test_ctrl_c_keeps_the_mean_so_far():
    with pytest.raises(rj.Interrupted, match=r"stopped after \d+ iterations") as stopped:
        design_block(progress=Stops(), max_iterations=50)
    assert stopped.value.partial.result == optimise.RESULTS.interrupted
    assert np.isfinite(stopped.value.partial.objective)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: optimise.FreshSamples(MOTION, 1), "batch must be"),
        (lambda: optimise.FreshSamples(MOTION, 16, verify=24), "multiple of batch = 16"),
        (lambda: optimise.FreshSamples(MOTION, 16, verify=8), "verify must be"),
        (lambda: optimise.FreshSamples(rj.Ricker(1.0, 1.0)), "must be a rockjax.GaussianMotion or records"),
        (lambda: optimise.FreshSamples(records(1)), "at least two records"),
        (
            lambda: optimise.AnnualFrequency(1e-3, HAZARD, optimise.FreshSamples(MOTION)),
            "must be drawn from records",
        ),
        (lambda: design_block(method="sqp"), "need a gradient transformation"),
        (
            lambda: optimise.design(
                BLOCK, BOX, None, optimise.PeakRotation(0.4, optimise.FreshSamples(MOTION)), method=ADAM
            ),
            "give the PeakRotation fixed motions",
        ),
        (
            lambda: optimise.design(
                BLOCK,
                BOX,
                optimise.ExpectedLoss(
                    slenderness,
                    1.0,
                    optimise.AnnualFrequency(1e-3, HAZARD, optimise.FreshSamples(records(4))),
                ),
                method=ADAM,
            ),
            "give the AnnualFrequency of the objective fixed motions",
        ),
    ],
)
def test_invalid_arguments_are_rejected(make, words):
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.slow
def test_slopes_of_a_batch_are_those_of_its_capacities():
    target = optimise.MedianCapacity(
        1.0, optimise.FreshSamples(rj.GaussianMotion(61, 0.06, 0.02), 4), width=1e-3
    )
    options = rj.Options(rtol=1e-10, atol=1e-12, throw=False)

    def of_alpha(a):
        scales = target.least_scales(BLOCK.replace(alpha=a), options)
        return scales, target.margins_of_scales(scales)

    both = jax.jit(lambda a: jax.jvp(of_alpha, (a,), (1.0,)))
    ((low, _), _), ((scales, _), (slopes, slope)), ((high, _), _) = map(
        both, 0.15 + np.array([-1e-6, 0, 1e-6])
    )
    # For other records, chaotic rocking opens or closes a window narrower than `width` below the boundary,
    # which then jumps.
    steady = np.abs(high - low) < 1e-4 * scales
    assert steady.sum() >= 2
    np.testing.assert_allclose(slopes[steady], (high - low)[steady] / 2e-6, rtol=1e-4)
    _, expected = jax.jvp(target.margins_of_scales, (scales,), (slopes,))
    np.testing.assert_allclose(slope, expected, rtol=1e-9)
    assert slope[0] > 0
