"""Targets on a probability of failure: rays through failing samples, and designs that satisfy a target."""

import math
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.stats import norm

import optimise
import rockjax as rj
from optimise._answer import Effort, SampleEstimates, SearchResult, build_design
from optimise._descent import End, Evaluation
from optimise._failure import RayTarget, _largest_difference
from optimise._results import CONVERGED, INTERRUPTED
from optimise._sampling import SampledTargets, _StructureParameters
from optimise._variables import make_variables
from rockjax._risk.limit_state import FunctionLimitState
from rockjax._risk.rays import probability_at, sample_rays, solve_factor

MOTION = rj.GaussianMotion(61, 0.06, 0.02)
BLOCK = rj.Podium(alpha=0.2, R=1.0)


class Bowl(FunctionLimitState):
    """Limit state with failure at z ≥ b + w²/5, where w is half of (u₀ − u₁)², in five variables."""

    bend = 0.2

    def __init__(self, b):
        self.b = b
        super().__init__(lambda u: b + self.bend * self.across(u) ** 2 - self.along(u), 5)

    @staticmethod
    def along(u):
        return jnp.sum(u[2:]) / jnp.sqrt(3.0)

    @staticmethod
    def across(u):
        return (u[0] - u[1]) / jnp.sqrt(2.0)

    def log_slopes(self, u, names):
        value, slope = self.gradients(u)
        return value, np.sum(slope * u, axis=1), np.full((len(u), 1), self.b)

    @classmethod
    def probability(cls, b, factor):
        """Return the probability of failure for factor · u."""
        return quad(
            lambda w: norm.pdf(w) * norm.sf((b + cls.bend * (factor * w) ** 2) / factor), -9, 9, epsrel=1e-10
        )[0]


@pytest.fixture(scope="module")
def rays():
    return sample_rays(Bowl(2.0), 1e-3, 400, 0.05, 0)


def test_rays_carry_a_probability_to_other_limit_states(rays):
    assert rays.factor != 1
    for b, factor in ((2.0, rays.factor), (2.2, rays.factor), (2.0, 1.1 * rays.factor)):
        expected = Bowl.probability(b, factor)
        assert probability_at(Bowl(b), rays, factor) == pytest.approx(expected, rel=0.2)


def test_the_factor_that_makes_a_probability_and_its_derivative(rays):
    cut = solve_factor(Bowl(2.0), rays, 1e-3, ("b",), 1.0)
    exact = [brentq(lambda k, b=b: Bowl.probability(b, k) - 1e-3, 0.3, 1.5) for b in (2.0, 2.001)]
    assert cut.factor == pytest.approx(exact[0], rel=0.01)
    assert cut.sensitivities[0] == pytest.approx(math.log(exact[1] / exact[0]) / math.log(1.0005), rel=0.05)
    # For fixed rays the derivative is exact.
    up, down = (solve_factor(Bowl(2.0 * f), rays, 1e-3, ("b",), 1.0).factor for f in (1 + 1e-4, 1 - 1e-4))
    assert cut.sensitivities[0] == pytest.approx(math.log(up / down) / 2e-4, rel=1e-5)
    assert cut.jumps == 0
    assert cut.effective > 200


def test_a_structure_that_is_far_too_strong_has_the_last_factor(rays):
    cut = solve_factor(Bowl(2000.0), rays, 1e-3, ("b",), 1.0)
    assert cut.factor == 100
    assert not cut.sensitivities.any()


def test_rays_of_a_sample_that_has_not_converged_are_refused(monkeypatch):
    monkeypatch.setattr("rockjax._risk.rays.MAX_SCENES", 1000)
    with pytest.raises(ValueError, match=r"of a probability near 0.001 is .*, not 0.02; raise cov"):
        sample_rays(Bowl(2.0), 1e-3, 64, 0.02, 0)


def test_a_check_that_has_not_converged_leaves_the_rays_alone(monkeypatch):
    """The answer reports it, and no margin changes."""
    target = optimise.FailureProbability(1e-2, MOTION, cov=0.5, rays=16)
    monkeypatch.setattr("optimise._failure.sample_rays", lambda *_: None)
    sampled = RayTarget(target, BLOCK)
    monkeypatch.setattr(
        "rockjax._risk.structure.StructureLimitState._values", lambda self, u: 1.0 + u[:, 0] ** 2
    )
    assert sampled.check(BLOCK) == 0
    assert sampled._ratio(BLOCK) == 1
    found: Any = sampled.checked_estimate(BLOCK)
    assert not found.converged


def test_a_design_without_a_converged_check_is_unverified():
    here = Evaluation(np.zeros(1), np.array([0.1, 0.2]), np.zeros((1, 1)), np.zeros((2, 1)), np.zeros(3))
    ends = [End(np.array([0.5]), np.zeros(2), 0, 3, here)]
    found = SearchResult(ends, [here], {"rotation": 1, "failure": 1}, 1.0, [], Effort(1, 1, 1, 1.0))
    with pytest.warns(RuntimeWarning, match="has not converged"):
        chance = rj.reliability(lambda u: 1.0 + u[0] ** 2, 2)
    box = make_variables(BLOCK, {"alpha": (0.1, 0.4)})
    answer = build_design(BLOCK, box, None, found, lambda _: SampleEstimates({1: chance}))
    assert not answer.satisfied
    assert not answer.starts[0].satisfied
    assert answer.result == optimise.RESULTS.unverified
    assert answer.margins["rotation"] == 0.1
    assert np.isnan(answer.margins["failure"]).all()
    assert list(answer.failing) == ["failure"]
    assert "not verified: failure" in repr(answer)
    assert "(no interval), not converged in" in repr(answer)


@pytest.mark.parametrize(
    ("code", "result"),
    [(CONVERGED, optimise.RESULTS.unverified), (INTERRUPTED, optimise.RESULTS.interrupted)],
)
def test_a_design_without_a_sample_is_unverified(code, result):
    here = Evaluation(np.zeros(1), np.array([0.2]), np.zeros((1, 1)), np.zeros((1, 1)), np.zeros(2))
    ends = [End(np.array([0.5]), np.zeros(1), code, 3, here)]
    found = SearchResult(ends, [here], {"failure": 1}, 1.0, [], Effort(1, 1, 1, 1.0))
    box = make_variables(BLOCK, {"alpha": (0.1, 0.4)})
    sampled = SampledTargets(box, [optimise.FailureProbability(1e-2, MOTION)])
    unsampled: Any = SimpleNamespace(checked_estimate=lambda podium: None)
    sampled._ray_targets[0] = unsampled
    answer = build_design(BLOCK, box, None, found, sampled.probabilities)
    assert not answer.satisfied
    assert answer.result == result
    assert np.isnan(answer.margins["failure"]).all()
    assert not answer.probabilities
    assert "not verified: failure" in repr(answer)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: optimise.FailureProbability(0.0, MOTION), "at_most must be"),
        (lambda: optimise.FailureProbability(0.5, MOTION), r"in \[1e-9, 0.3\]"),
        (lambda: optimise.FailureProbability(1e-3, rj.Ricker(1.0, 1.0)), "motion must be a rockjax.Gaussian"),
        (lambda: optimise.FailureProbability(1e-3, MOTION, cov=2.0), "cov must be"),
        (lambda: optimise.FailureProbability(1e-3, MOTION, rays=3), "rays must be"),
        (
            lambda: optimise.design(
                BLOCK,
                {"alpha": (0.1, 0.4)},
                None,
                optimise.FailureProbability(1e-3, MOTION, limit=("shear", 1)),
            ),
            "needs a superstructure",
        ),
    ],
)
def test_targets_that_make_no_sense_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_a_file_says_the_same(tmp_path):
    path = tmp_path / "column.toml"
    path.write_text(
        '[structure]\nalpha = 0.2\nR = 1.0\n[vary]\nalpha = [0.15, 0.4]\n[minimise]\nquantity = "alpha"\n'
        '[[targets]]\nkind = "failure-probability"\nat_most = 0.02\ncov = 0.3\nrays = 16\n'
        "motion = {n = 61, dt = 0.06, S_0 = 0.02, envelope = {t_1 = 1.0, t_2 = 2.0, c = 1.0}}\n"
    )
    asked = optimise.load(path)
    (target,) = asked.targets
    envelope = rj.Envelope(t_1=1.0, t_2=2.0, c=1.0)
    expected = optimise.FailureProbability(
        0.02, rj.GaussianMotion(61, 0.06, 0.02, envelope=envelope), cov=0.3, rays=16
    )
    assert eqx.tree_equal(target, expected)
    path.write_text(path.read_text().replace("n = 61", "n = 1"))
    with pytest.raises(ValueError, match=r"column.toml: targets\[0\].motion.n: must be"):
        optimise.load(path)


def test_a_file_asks_for_cost_and_expected_loss(tmp_path):
    path = tmp_path / "column.toml"
    (tmp_path / "hazard.csv").write_text("PGA [g],annual_rate\n0.1,1e-2\n0.4,8e-4\n1.6,2e-5\n")
    text = (
        "[structure]\nwidth = 0.6\nheight = 3.0\ncolumn_mass = 1500.0\n[vary]\nwidth = [0.3, 1.0]\n"
        "[[motions.shaking]]\nsynthetic = 2\nduration = 4.0\ndt = 0.05\n"
        '[minimise]\nquantity = "expected-loss"\ncost = {width = 2e4, height = 1e3}\nloss = 5e6\n'
        'hazard = "hazard.csv"\nmotions = "shaking"\nmax_intensity = 12.0\n'
    )
    path.write_text(text)
    asked = optimise.load(path)
    hazard = rj.Hazard.from_file(tmp_path / "hazard.csv").in_si()
    risk = optimise.AnnualFrequency(1.0, hazard, asked.motions["shaking"], max_intensity=12.0)
    podium = rj.Podium.from_dimensions(width=0.6, height=3.0, column_mass=1500.0)
    minimise: Any = asked.minimise
    assert minimise.cost.function(podium) == pytest.approx(2e4 * 0.6 + 1e3 * 3.0, rel=1e-12)
    assert minimise.loss == 5e6
    assert eqx.tree_equal(minimise.risk, risk)
    assert "cost and expected loss" in repr(asked)
    for wrong, words in {
        "cost = {}": r"minimise.cost: .* at least 1",
        "cost = {breadth = 1.0}": r"minimise.cost.breadth",
        "cost = {width = -1.0}": r"minimise.cost.width: must be",
    }.items():
        path.write_text(text.replace("cost = {width = 2e4, height = 1e3}", wrong))
        with pytest.raises(ValueError, match=words):
            optimise.load(path)
    path.write_text(text.replace("loss = 5e6\n", ""))
    with pytest.raises(ValueError, match="minimise: loss is missing"):
        optimise.load(path)


def test_devices_that_start_at_zero_have_derivatives():
    """A damper with the coefficient 0 stays in the podium, so that its derivative is not left out."""
    dimensions = optimise.Dimensions(width=0.6, height=3.0, column_mass=1.5e3, beam_mass=30e3)
    parameters = _StructureParameters(make_variables(dimensions, {"damper_coefficient": (0.0, 1e5)}))
    for x in (0.0, 0.5):
        podium, log_slopes = parameters(np.array([x]))
        assert len(podium.restrainers) == 1
        assert log_slopes["coefficient"] > 0
    damped = BLOCK.replace(restrainers=(rj.Damper(0.5, exponent=0.7),))
    (damper,) = make_variables(damped, {"exponent": (0.3, 1.0)}).podium(np.ones(1)).restrainers
    assert isinstance(damper, rj.Damper)
    assert not damper.linear
    assert _largest_difference(np.ones(2), np.ones(3)) == math.inf


def test_levers_of_round_columns_must_be_fixed():
    column = optimise.Dimensions(
        width=0.45, height=3.0, column_mass=1.5e3, beam_mass=3e4, positions=[0.0, 2.0], end_radius=0.5
    )
    sliding, overturning = (
        optimise.FailureProbability(1e-2, MOTION, limit=limit) for limit in (("friction", 0.5), "overturning")
    )
    for start, name in ((column, "height"), (column.replace(end_radius=0.0), "end_radius")):
        box = make_variables(start, {name: (0.0, 0.6) if name == "end_radius" else (2.0, 4.0)})
        with pytest.raises(ValueError, match=f"limit 'friction' has no derivatives with respect to {name}"):
            SampledTargets(box, [sliding])
        assert SampledTargets(box, [overturning]).targets
    assert SampledTargets(make_variables(column, {"width": (0.3, 0.6)}), [sliding]).targets
    flat = make_variables(column.replace(end_radius=0.0), {"height": (2.0, 4.0)})
    assert SampledTargets(flat, [sliding]).targets


@pytest.mark.slow
def test_margins_have_derivatives_by_the_variables():
    """Derivatives also with respect to a parameter that is zero, and one that changes several parameters of
    the podium. Windows that open and close on rays make the margins of each sample rough, so the mean of
    several samples is tested."""
    box, h = make_variables(BLOCK.replace(gamma=0.0), {"width": (0.2, 0.8), "gamma": (0.0, 4.0)}), 0.03
    x = np.array(box.start())
    slopes, differences = [], []
    for seed in range(3):
        target = optimise.FailureProbability(0.05, MOTION, cov=0.4, rays=64, seed=seed)
        sampled = SampledTargets(box, (target,))
        row = sampled.at(x)[0]
        slopes.append(row.slope)
        differences.append([(sampled.at(x + h * e)[0].margin - row.margin) / h for e in np.eye(2)])
    np.testing.assert_allclose(np.mean(slopes, axis=0), np.mean(differences, axis=0), rtol=0.3)


@pytest.mark.slow
def test_a_design_keeps_a_probability_and_an_independent_sample_says_so():
    target = optimise.FailureProbability(0.05, MOTION, cov=0.3, rays=16)
    answer = optimise.design(BLOCK, {"alpha": (0.12, 0.4)}, lambda podium: podium.alpha, target)
    assert answer.satisfied
    (found,) = answer.probabilities.values()
    assert found.probability <= 0.05
    assert found.probability > 0.01  # not far from the limit
    assert target.probability(answer.podium, seed=99).interval[0] <= 0.05
    assert "independent sample" in repr(answer)
