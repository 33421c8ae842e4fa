"""Designs: variables, targets and their derivatives, the method on problems with known answers, the studies,
files."""

import dataclasses
import functools
import itertools
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import optimise
import rockjax as rj
from benchmarks import studies
from optimise._cli import design_command, design_record
from optimise._fit import _covariance
from optimise._results import result_name
from optimise._suite import Suite
from optimise._targets import _smoothed_quantile
from optimise._variables import make_variables
from rockjax._files import as_json
from rockjax._programs.program import COUNTS, finish_writing, forget
from tests.compiling import compiled_by
from tests.scenes import Stops

BLOCK = rj.Podium(alpha=0.15, R=1.5)
DRAWING = optimise.Dimensions(
    width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3, top_mass=300e3, period=0.5
)
SLENDER = BLOCK.replace(alpha=0.06)
OPTIONS = rj.Options(rtol=1e-9, atol=1e-11, throw=False)
BEYOND = rj.Options(overturn_ratio=1.2)  # the margin is not defined beyond the stability angle
TWO = np.array([0.3, 0.4])


class Analytic(optimise.AbstractTarget):
    """Target without a simulation."""

    name: str | None
    function: Callable

    def __init__(self, function, name=None):
        self.function, self.name = function, name

    def margins(self, podium, options):
        return jnp.atleast_1d(self.function(podium))

    def describe(self):
        return "analytic"


def _alpha(podium):
    return podium.alpha


# Suites


def test_suites_side_by_side_keep_their_order():
    """Motions of one kind form a group, and results have the order of the motions."""
    pulse, wave = lambda a: rj.Ricker(a, 1.0), lambda a: rj.HalfSine(a, 1.0)
    first, second = (
        Suite.of([pulse(1.0), wave(2.0), pulse(3.0)]),
        Suite.of([wave(4.0), pulse(5.0), rj.OneSine(6.0, 1.0)]),
    )
    both = first.merged_with(second).merged_with(Suite.of([pulse(7.0)]))
    assert [type(group) for group in both.groups] == [rj.Ricker, rj.HalfSine, rj.OneSine]
    assert both.map_motions(lambda motion: motion.a_p).tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]


@pytest.mark.slow
def test_a_later_design_compiles_nothing(caplog):
    """The later design has another structure and a new function for the same objective, and compiles not even
    a single operation. Motions that two targets use are simulated once, in one loop."""
    motions = [rj.Ricker(4.0, 0.6), rj.Ricker(3.0, 1.0)]

    def answer(height):
        column = dataclasses.replace(DRAWING, height=height, top_mass=0.0)
        targets = [
            optimise.PeakRotation(0.4, motions),
            optimise.NoOverturning([motion.scaled(1.5) for motion in motions]),
        ]
        least = lambda podium: 2 * podium.alpha
        return optimise.design(column, {"width": (0.2, 1.5)}, least, targets)

    first = answer(3.0)
    assert first.satisfied
    before = dict(COUNTS)
    finish_writing()
    forget()
    second = answer(3.2)
    assert {"loaded": before["loaded"] + 1, "compiled": before["compiled"]} == COUNTS
    assert not compiled_by(lambda: answer(3.1), caplog)
    assert second.satisfied
    assert second.variables["width"] != first.variables["width"]


# Variables


def test_a_width_keeps_the_height():
    varied = make_variables(DRAWING.podium(), {"width": (0.3, 0.9)})
    podium = varied.podium(varied.scaled(jnp.array([0.6])))
    assert np.allclose([podium.width, podium.height], [0.6, 3.0], rtol=1e-14)
    assert float(podium.gamma) == float(DRAWING.podium().gamma)
    tall = make_variables(DRAWING.podium(), {"height": (2.0, 6.0)}).podium(jnp.array([0.5]))
    assert np.allclose([tall.width, tall.height], [0.45, 4.0], rtol=1e-14)
    both = make_variables(DRAWING.podium(), {"height": (2.0, 6.0), "width": (0.1, 0.3)}).podium(
        jnp.array([0.5, 0.5])
    )
    assert np.allclose([both.width, both.height], [0.2, 4.0], rtol=1e-14)


def test_masses_vary_and_every_ratio_follows():
    varied = make_variables(DRAWING, {"column_mass": (1e3, 4e3), "top_mass": (1e5, 4e5)})
    podium = varied.podium(varied.scaled(jnp.array([2e3, 2e5])))
    assert np.isclose(podium.gamma, 30e3 / 4e3)
    assert np.isclose(podium.superstructure.eta, 2e5 / 4e3)


def test_scaling_meets_the_bounds_and_inverts():
    varied = make_variables(BLOCK.replace(gamma=3.0), {"gamma": (0.5, 50.0), "alpha": (0.1, 0.3)})
    assert varied.logarithmic == (True, False)
    assert varied.values(jnp.array([0.0, 1.0])).tolist() == [0.5, 0.3]
    x = jnp.array([0.3, 0.7])
    assert np.allclose(varied.scaled(varied.values(x)), x, atol=1e-14)
    assert np.isclose(varied.values(x)[0], 0.5 * 100**0.3)
    # Derivatives are correct up to the bounds.
    slopes = [jnp.diag(jax.jacfwd(varied.values)(jnp.full(2, end))) for end in (0.0, 1.0)]
    assert np.allclose(slopes, [[0.5 * math.log(100), 0.2], [50 * math.log(100), 0.2]], rtol=1e-12)
    outside = make_variables(BLOCK, {"alpha": (0.2, 0.3)})
    assert outside.start().tolist() == [0.0]


@pytest.mark.parametrize(
    ("podium", "vary", "words"),
    [
        (BLOCK, {}, "at least one variable"),
        (BLOCK, {"slenderness": (0, 1)}, "parameters of this podium that can vary are alpha"),
        (BLOCK, {"beam_mass": (0, 1)}, r"masses and dimensions vary with an optimise\.Dimensions"),
        (
            BLOCK,
            {"alpha": (0.1, 0.2), "width": (0.1, 0.2)},
            "alpha and width, which describe the same dimension",
        ),
        (BLOCK, {"alpha": (0.2, 0.1)}, "lowest < highest"),
        (BLOCK, {"alpha": (0.1, math.inf)}, "must be finite"),
        (BLOCK, {"alpha": 0.2}, "must be a pair"),
        (BLOCK, {"alpha": ("0.1", "0.2")}, "must be a pair"),
        (BLOCK, {"R": "12"}, "must be a pair"),
        (BLOCK, {"R": {1, 2}}, "must be a pair"),
        (BLOCK, {3: (1, 2)}, "vary names 3; parameters of this podium"),
        (BLOCK, {"alpha": (0.1, 2.0)}, "exceeds the admissible range: Podium: alpha"),
        (BLOCK, {"superstructure.eta": (1.0, 2.0)}, "no superstructure"),
        (
            BLOCK.replace(superstructure=rj.Rigid(1.0)),
            {"superstructure.T_s": (0.1, 2.0)},
            "a Rigid superstructure",
        ),
        (BLOCK, {"restitution": (0.8, 0.9)}, "give it a factor"),
        (DRAWING, {"alpha": (0.1, 0.2)}, "dimensions that can vary are width"),
        (DRAWING.replace(period=None), {"period": (0.1, 0.2)}, "give it a period"),
        (DRAWING.replace(top_mass=0.0), {"top_mass": (1.0, 2.0)}, "give a top_mass"),
        (dataclasses.replace(BLOCK, alpha=jnp.array([0.1, 0.2])), {"R": (1.0, 2.0)}, "scalar parameters"),
        ("podium", {"R": (1.0, 2.0)}, r"must be a rockjax\.Podium"),
    ],
)
def test_errors_of_variables_name_the_valid_values(podium, vary, words):
    with pytest.raises(ValueError, match=words):
        optimise.design(podium, vary, _alpha)


# The method, on problems with known solutions


def test_multiplier_is_the_price_of_the_target():
    target = Analytic(lambda p: p.R * p.alpha / 0.2 - 1)
    answer = optimise.design(
        BLOCK, {"alpha": (0.05, 0.5), "R": (0.5, 2.0)}, lambda p: p.alpha + 0.01 * p.R, target
    )
    assert result_name(answer.result) == "converged"
    assert np.isclose(answer.variables["alpha"], 0.1, rtol=1e-5)
    assert answer.variables["R"] == 2.0
    # α = 0.1 (1 − ε) if the limit is relaxed by ε.
    assert np.isclose(answer.multipliers["analytic"][0], 0.1, rtol=1e-4)
    assert 0 <= answer.margins["analytic"][0] < 1e-5


def test_curved_problem_with_two_binding_targets():
    # max α R with α² + (R/5)² ≤ 0.1 and R ≥ 1.2: both are active, with the multipliers of ∇f = μ₁∇c₁ + μ₂∇c₂.
    circle = Analytic(lambda p: 1 - (p.alpha**2 + (p.R / 5) ** 2) / 0.1, "circle")
    floor = Analytic(lambda p: p.R / 1.2 - 1, "floor")
    vary = {"alpha": (0.05, 0.5), "R": (0.5, 2.0)}
    answer = optimise.design(BLOCK, vary, lambda p: -p.alpha * p.R, (circle, floor))
    alpha = math.sqrt(0.1 - 0.24**2)
    first = 1.2 / (20 * alpha)
    assert np.allclose([answer.variables["alpha"], answer.variables["R"]], [alpha, 1.2], rtol=1e-5)
    assert np.isclose(answer.multipliers["circle"][0], first, rtol=1e-4)
    assert np.isclose(answer.multipliers["floor"][0], 1.2 * (0.96 * first - alpha), rtol=1e-3)
    assert answer.satisfied


def test_targets_of_one_name_are_numbered():
    answer = optimise.design(
        BLOCK, {"alpha": (0.05, 0.5)}, _alpha, [Analytic(lambda p: p.alpha), Analytic(lambda p: p.R)]
    )
    assert list(answer.margins) == ["analytic", "analytic (2)"]


def test_a_design_with_a_small_restitution_factor_warns():
    """The factor of rigid faces is 1 − 1.5 sin²α."""
    with pytest.warns(rj.PlausibilityWarning, match=r"rigid faces: e = 0\.9 < 0\.9408") as caught:
        optimise.design(BLOCK.replace(restitution=0.9), {"alpha": (0.2, 0.5)}, _alpha)
    assert [warning.filename for warning in caught] == [__file__]


def test_minimax_is_met_at_its_kink():
    def worst(p):
        return jnp.stack([(p.R - 1) ** 2 + p.alpha, (p.R - 1.5) ** 2 + 0.5 - p.alpha])

    answer = optimise.design(BLOCK, {"alpha": (0.05, 0.5), "R": (0.5, 2.0)}, worst)
    assert np.allclose([answer.variables["alpha"], answer.variables["R"]], [0.25, 1.25], atol=1e-5)
    assert np.isclose(answer.objective, 0.3125, atol=1e-9)


def test_a_kink_inside_one_response_is_met():
    # A margin that is the smaller of two branches; its slope is that of the active branch.
    target = Analytic(lambda p: jnp.minimum(p.alpha - 0.3 * (p.R - 1), p.alpha + 0.6 * (p.R - 1)) / 0.2 - 1)
    answer = optimise.design(BLOCK, {"alpha": (0.05, 0.5), "R": (0.5, 2.0)}, _alpha, target)
    assert np.allclose([answer.variables["alpha"], answer.variables["R"]], [0.2, 1.0], atol=1e-5)
    assert answer.satisfied


def test_a_jump_ends_at_the_jump_and_ends():
    target = Analytic(lambda p: jnp.where(p.alpha > 0.2371, 0.5 + p.alpha, -0.5 + p.alpha))
    answer = optimise.design(BLOCK, {"alpha": (0.05, 0.5)}, _alpha, target, starts=3)
    assert answer.satisfied
    assert result_name(answer.result) == "stalled"
    assert np.isclose(answer.variables["alpha"], 0.2371, atol=1e-5)


def test_iterations_of_corrections_are_counted():
    class Corrected(Analytic):
        """Target whose margin in the verification is smaller than in the search."""

        def margins(self, podium, options):
            return super().margins(podium, options) - jnp.where(options.rtol <= 1e-11, 5e-5, 0.0)

    target = Corrected(lambda p: p.alpha / 0.2 - 1)
    answer = optimise.design(BLOCK, {"alpha": (0.05, 0.5)}, _alpha, target)
    assert answer.satisfied
    (start,) = answer.starts
    searched = answer.history[-1].iteration  # without those of corrections
    assert start.iterations == answer.stats.iterations > searched


def test_unreachable_targets_return_the_closest_design():
    # The violations of both targets are equal at α = 0.25.
    targets = [Analytic(lambda p: p.alpha / 0.2 - 2, "wide"), Analytic(lambda p: 0.5 - p.alpha / 0.2, "slim")]
    answer = optimise.design(BLOCK, {"alpha": (0.05, 0.5)}, _alpha, targets, starts=2)
    assert result_name(answer.result) == "infeasible"
    assert not answer.satisfied
    assert np.isclose(answer.variables["alpha"], 0.25, atol=1e-5)
    assert np.allclose(list(answer.failing.values()), -0.75, atol=1e-4)
    assert "not satisfied: wide" in repr(answer) or "not satisfied: slim" in repr(answer)
    assert np.isnan(answer.multipliers["wide"]).all()


def test_without_objective_the_nearest_design_is_found():
    # A straight line in scaled variables.
    target = Analytic(lambda p: (p.alpha + p.R / 1.5 * 0.45 - 0.9) / 0.45)
    answer = optimise.design(
        BLOCK.replace(alpha=0.05, R=0.5), {"alpha": (0.05, 0.5), "R": (0.5, 2.0)}, None, target
    )
    x = [(answer.variables["alpha"] - 0.05) / 0.45, (answer.variables["R"] - 0.5) / 1.5]
    assert answer.satisfied
    assert np.isclose(x[0], x[1], atol=1e-4)


def test_not_finite_start_is_named_and_other_starts_go_on():
    target = Analytic(lambda p: jnp.where(p.alpha < 0.1, jnp.nan, p.alpha / 0.2 - 1))
    alone = optimise.design(BLOCK.replace(alpha=0.06), {"alpha": (0.05, 0.5)}, _alpha, target)
    assert result_name(alone.result) == "not_finite"
    assert "raise max_steps or history of options" in repr(alone)
    assert not alone.satisfied
    answer = optimise.design(BLOCK.replace(alpha=0.06), {"alpha": (0.05, 0.5)}, _alpha, target, starts=4)
    assert answer.satisfied
    assert result_name(answer.starts[0].result) == "not_finite"


def test_out_of_iterations_says_so():
    answer = optimise.design(
        BLOCK,
        {"alpha": (0.05, 0.5), "R": (0.5, 2)},
        lambda p: (p.R**2 - p.alpha) ** 2 + p.R,
        max_iterations=1,
    )
    assert result_name(answer.result) == "out_of_iterations"


def test_seed_decides_the_starts():
    def run(seed):
        return optimise.design(
            BLOCK, {"alpha": (0.05, 0.5), "R": (0.5, 2)}, lambda p: p.alpha * p.R, starts=3, seed=seed
        )

    one, same, other = run(1), run(1), run(2)
    assert [h.objective for h in one.history] == [h.objective for h in same.history]
    assert one.variables == same.variables
    assert not np.array_equal(one.history[1].x, other.history[1].x) or not np.array_equal(
        one.history[2].x, other.history[2].x
    )


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"method": "simplex"},
            "method must be 'sqp', 'adam' or an Optax gradient transformation such as optax.adam",
        ),
        ({"method": optax.adam}, "method must be 'sqp', 'adam' or an Optax gradient transformation"),
        ({"method": optax.lbfgs()}, r"must not need value_fn.*linesearch=None"),
        ({"starts": 0}, "starts must be a whole number"),
        ({"tolerance": 1.0}, "tolerance must be in"),
        ({"targets": ["PeakRotation"]}, r"targets\[0\] must be a target"),
        ({"minimise": 3}, "minimise must be an objective or a function"),
        ({"minimise": None}, "nothing to do"),
        ({"minimise": lambda p: jnp.ones((2, 2))}, "a number or a vector"),
        ({"minimise": lambda p: jnp.ones(0)}, "a number or a vector"),
        ({"minimise": lambda p: None}, "value of the function of the podium must be a number"),
        (
            {"targets": optimise.NoOverturning(rj.Ricker(3.0, 1.0)), "options": BEYOND},
            "design: options.overturn_ratio must be <= θ_s/α = 1 for the margin",
        ),
        ({"minimise": optimise.WorstRotation(rj.Ricker(3.0, 1.0)), "options": BEYOND}, "for the margin"),
        (
            {
                "targets": optimise.ContentsRotation(0.5, rj.Ricker(3.0, 1.0), rj.Contents(alpha=0.2, R=1.0)),
                "options": BEYOND,
            },
            "for the margin",
        ),
        ({"options": rj.Options(overturn_ratio=12.0)}, r"overturn_ratio must be <= π/\(2α\) = 10.472"),
    ],
)
def test_errors_of_arguments_name_the_valid_values(changes, words):
    with pytest.raises(ValueError, match=words):
        optimise.design(BLOCK, {"alpha": (0.05, 0.5)}, **({"minimise": _alpha} | changes))


COLUMNS = optimise.Dimensions(width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3, positions=(0.0, 5.0))
ROUND = COLUMNS.replace(positions=None, end_radius=0.3)


@pytest.mark.parametrize(
    ("column", "vary", "minimise", "expected"),
    [
        (COLUMNS, {"position_2": (-3.0, 8.0)}, lambda podium: jnp.abs(podium.elevation.offsets), 0.225),
        (COLUMNS, {"width": (0.2, 1.2), "position_2": (1.0, 6.0)}, lambda podium: -podium.width, -1.2),
        (ROUND, {"end_radius": (0.2, 1.4), "height": (1.0, 5.0)}, lambda podium: -podium.R, None),
    ],
)
def test_parameters_that_do_not_fit_each_other_are_avoided(column, vary, minimise, expected):
    """Columns of the best design do not overlap, and the radius of their ends is less than half their height,
    although the bounds allow both."""
    design = optimise.design(column, vary, minimise, starts=3)
    assert design.satisfied
    assert design.structure.podium().R == design.podium.R  # a valid structure
    if expected is not None:
        assert np.isclose(design.objective, expected, rtol=1e-4)


def _valley(podium):
    """A curved valley in which a descent is slow; the minimum is at alpha = 0.3, R = 1.5·(0.3/0.15)²."""
    x, y = podium.alpha / 0.15, podium.R / 1.5
    return (x - 2) ** 2 + 10 * (y - x**2) ** 2


@pytest.mark.parametrize("margin", [lambda p: jnp.log(p.alpha / 0.1073), lambda p: 1 - 0.1073 / p.alpha])
def test_a_later_ctrl_c_gives_no_worse_design(margin):
    objectives = []
    for count in range(2, 40):
        try:
            optimise.design(
                SLENDER, {"alpha": (0.05, 0.3)}, _alpha, Analytic(margin), starts=2, progress=Stops(count)
            )
        except rj.Interrupted as stop:
            objectives.append(stop.partial.objective if stop.partial.satisfied else math.inf)
    assert len(objectives) > 5
    assert objectives[-1] == pytest.approx(0.1073, rel=1e-5)
    assert all(b <= a * (1 + 1e-5) for a, b in itertools.pairwise(objectives))


class Shifted(Analytic):
    """Target whose margin is smaller in the verification, so that the search must correct its design."""

    def margins(self, podium, options):
        return super().margins(podium, options) - 3e-6 * (options.rtol < 1e-10)


def test_ctrl_c_before_a_correction_is_not_infeasible():
    target, results, verified = Shifted(lambda podium: podium.alpha / 0.1073 - 1), [], []
    for count in range(2, 40):
        try:
            design = optimise.design(SLENDER, {"alpha": (0.05, 0.3)}, _alpha, target, progress=Stops(count))
            break
        except rj.Interrupted as stop:
            results.append(result_name(stop.partial.result))
            verified.append(stop.partial.satisfied)
    assert design.satisfied
    assert not all(verified)
    assert set(results) <= {"interrupted", "converged"}


def test_ctrl_c_keeps_the_best_design_so_far():
    box = {"alpha": (0.05, 0.5), "R": (1.0, 12.0)}
    targets = [Analytic(lambda podium: 0.29 - podium.alpha, "slender")]
    ask = lambda **more: optimise.design(BLOCK, box, _valley, targets, starts=2, **more)
    complete = ask()
    assert complete.satisfied
    seen = []
    for after in (2, 5, 12):
        with pytest.raises(rj.Interrupted, match=r"stopped after \d+ iterations") as stopped:
            ask(progress=Stops(after))
        best = stopped.value.partial
        assert best.result == optimise.RESULTS.interrupted
        assert best.satisfied
        assert best.margins["slender"][0] >= 0
        assert np.isnan(best.multipliers["slender"]).all()
        assert best.objective == pytest.approx(float(_valley(best.podium)))
        assert best.stats.evaluations <= 2 * (after + 1)
        assert "interrupted, targets satisfied" in str(best)
        seen.append(best.objective)
    assert seen[0] > seen[1] > seen[2] >= complete.objective
    # Before the first evaluation there is no result; at the end the result is complete.
    with pytest.raises(rj.Interrupted, match="before the first evaluation") as stopped:
        ask(progress=Stops(1))
    assert stopped.value.partial is None
    calls = complete.stats.evaluations  # for both starts, so more than the number of calls
    progress = Stops(0)
    ask(progress=progress)
    with pytest.raises(rj.Interrupted) as stopped:
        ask(progress=Stops(-progress.left))
    assert calls > -progress.left
    last = stopped.value.partial
    assert last.result == complete.result
    assert last.variables == complete.variables


def test_progress_is_reported():
    class Counter:
        count = 0

        def update(self, number):
            self.count += number

    counter = Counter()
    answer = optimise.design(BLOCK, {"alpha": (0.05, 0.5)}, _alpha, progress=counter)
    assert counter.count >= len(answer.history)


# Gradient transformations, followed by quadratic programming

ADAM = optax.adam(0.02)
BOX = {"alpha": (0.05, 0.5), "R": (0.5, 2.0)}
CIRCLE = Analytic(lambda p: 1 - (p.alpha**2 + (p.R / 5) ** 2) / 0.1, "circle")
FLOOR = Analytic(lambda p: p.R / 1.2 - 1, "floor")


def _area(podium):
    return -podium.alpha * podium.R


@pytest.mark.parametrize(
    "transformation",
    [
        "adam",
        optax.sgd(0.05, momentum=0.9),
        optax.lbfgs(0.5, linesearch=None),
        optax.chain(optax.adam(0.02), optax.contrib.reduce_on_plateau()),
    ],
    ids=["adam", "momentum", "lbfgs", "of the value"],
)
def test_a_transformation_and_the_quadratic_programming_find_the_same_design(transformation):
    ask = lambda method, **how: optimise.design(
        BLOCK, BOX, _area, (CIRCLE, FLOOR), starts=2, method=method, **how
    )
    expected, answer = ask("sqp"), ask(transformation, max_iterations=30)
    assert result_name(answer.result) == "converged"
    assert [start.satisfied for start in answer.starts] == [True] * 2
    assert np.isclose(answer.objective, expected.objective, rtol=1e-5)
    for name, prices in expected.multipliers.items():
        assert prices[0] > 0.01
        assert np.allclose(answer.multipliers[name], prices, rtol=0.01)
    for k in range(2):
        iterations = [row.iteration for row in answer.history if row.start == k]
        assert iterations == sorted(iterations)
        assert answer.starts[k].iterations >= iterations[-1] >= 30


def test_steps_of_adam_lead_close_to_the_design():
    answer = optimise.design(BLOCK, BOX, _area, (CIRCLE, FLOOR), method=ADAM)
    steps = [row for row in answer.history if row.iteration < 100]
    assert len(steps) == 100
    assert steps[-1].objective == pytest.approx(answer.objective, rel=0.03)
    assert len(answer.history) < 115


def test_adam_ends_in_a_named_result():
    wide = Analytic(lambda p: p.alpha / 0.2 - 2, "wide")
    slim = Analytic(lambda p: 0.5 - p.alpha / 0.2, "slim")
    unreachable = optimise.design(BLOCK, {"alpha": (0.05, 0.5)}, _alpha, [wide, slim], method=ADAM)
    assert result_name(unreachable.result) == "infeasible"
    assert np.isclose(unreachable.variables["alpha"], 0.25, atol=1e-4)

    hole = Analytic(lambda p: jnp.where(p.alpha < 0.1, jnp.nan, p.alpha / 0.2 - 1))
    lost = optimise.design(BLOCK.replace(alpha=0.06), {"alpha": (0.05, 0.5)}, _alpha, hole, method=ADAM)
    assert result_name(lost.result) == "not_finite"


def test_adam_keeps_within_bounds_and_skips_values_that_are_not_finite():
    # The descent enters a region without answers at R > 1.6; the optimum is at R = 1.5 and at the bound of
    # alpha.
    hole = lambda p: jnp.where(p.R > 1.6, jnp.nan, (p.R - 1.5) ** 2 + p.alpha)
    answer = optimise.design(BLOCK.replace(R=0.6, alpha=0.4), BOX, hole, method=optax.adam(0.2))
    assert result_name(answer.result) == "converged"
    assert answer.variables["alpha"] == 0.05
    assert np.isclose(answer.variables["R"], 1.5, atol=1e-4)
    assert all((row.x >= 0).all() and (row.x <= 1).all() for row in answer.history)


def test_ctrl_c_keeps_the_best_of_adam_too():
    target = Analytic(lambda podium: 0.29 - podium.alpha, "slender")
    box = {"alpha": (0.05, 0.5), "R": (1.0, 12.0)}
    seen = []
    for after in (3, 60):
        with pytest.raises(rj.Interrupted, match=r"stopped after \d+ iterations") as stopped:
            optimise.design(BLOCK, box, _valley, target, starts=2, method=ADAM, progress=Stops(after))
        best = stopped.value.partial
        assert best.result == optimise.RESULTS.interrupted
        assert best.satisfied
        seen.append(best.objective)
    assert seen[1] < seen[0]


# Targets


MOTIONS = [rj.Ricker(3.0, 0.9), rj.Ricker(3.8, 1.2)]
RECORDS = rj.synthetic_motions(3, seed=2, duration=4.0, dt=0.04).records()
HAZARD = rj.Hazard([0.5, 2.0, 8.0, 30.0], [5e-2, 5e-3, 2e-4, 2e-5])
IN_G = rj.Hazard([0.1, 1.0], [1e-2, 1e-4], units="g")
OVER_PGD = rj.Hazard([0.1, 1.0], [1e-2, 1e-4], measure="PGD")


@functools.cache
def annual_risk() -> optimise.AnnualFrequency:
    return optimise.AnnualFrequency(4e-4, HAZARD, RECORDS, width=1e-3)


TARGETS = {  # made where they are used, because some of them compute
    "rotation": lambda: optimise.PeakRotation(0.4, MOTIONS),
    "shear": lambda: optimise.PeakShear(0.5, MOTIONS),
    "overturning": lambda: optimise.NoOverturning(MOTIONS),
    # The unit of the acceleration ratio changes too; the median depends on all scales. No window is so narrow
    # that the default width would find another boundary.
    "ratio": lambda: optimise.OverturningAcceleration(3.0, rj.OneSine, [0.9, 1.2], ratio=True, width=1e-3),
    "median": lambda: optimise.MedianCapacity(1.5, MOTIONS, width=1e-3),
    "risk": annual_risk,
    "probability": lambda: optimise.OverturningProbability(0.3, MOTIONS, intensity=1.2, smoothing=0.1),
}


@pytest.mark.slow(but=["rotation"])
@pytest.mark.parametrize("name", list(TARGETS))
def test_margins_have_exact_derivatives(name):
    """Targets on the building, on rotations or with records have an elastic building; the others compile
    faster without one."""
    target = TARGETS[name]()
    elastic = name in ("rotation", "shear", "risk")
    podium = DRAWING.replace(width=0.5, period=DRAWING.period if elastic else None).podium()
    options = rj.Options(rtol=1e-11, atol=1e-13, throw=False)

    def margins(width):
        return target.margins(
            podium.replace(alpha=jnp.arctan(width / 3), R=0.5 * jnp.hypot(width, 3.0)), options
        )

    # One program computes values and slopes.
    both = jax.jit(lambda width: jax.jvp(margins, (width,), (1.0,)))
    h = 1e-6
    (low, _), (value, slope), (high, _) = (both(0.5 + step) for step in (-h, 0.0, h))
    assert np.all(np.isfinite(value))
    assert np.allclose(slope, (high - low) / (2 * h), rtol=2e-5, atol=1e-6)
    assert np.all(slope != 0)


@pytest.mark.slow
def test_the_annual_frequency_of_a_target_is_that_of_the_analysis():
    podium, target = BLOCK.replace(alpha=0.2), annual_risk()
    options = rj.Options(rtol=1e-10, atol=1e-12)
    levels = np.linspace(2.0, 30.0, 4)
    analysis = rj.incremental_dynamic_analysis(podium, RECORDS, levels, options=options)
    assert np.isfinite(analysis["capacity"]).all()
    expected = rj.annual_frequency(rj.fragility(analysis, confidence=None), HAZARD).frequency
    assert float(target.frequency(podium, options)) == pytest.approx(float(expected), rel=1e-6)
    loss = optimise.ExpectedLoss(lambda podium: 100 * podium.alpha, 5e4, target)
    assert float(loss.values(podium, options)[0]) == pytest.approx(20.0 + 5e4 * float(expected), rel=1e-6)
    # If nothing overturns, the margin is a bound without a slope.
    stocky = podium.replace(alpha=1.0, R=20.0)
    assert float(target.frequency(stocky, options)) == pytest.approx(float(HAZARD(jnp.asarray(30.0))))


def test_an_annual_frequency_takes_vertical_motions_with_it():
    pairs = rj.synthetic_motions(2, seed=2, duration=4.0, dt=0.04)
    pairs = pairs.map(lambda motion: dataclasses.replace(motion, vertical=motion.scaled(0.5)))
    suite = optimise.AnnualFrequency(4e-4, HAZARD, pairs).suite
    tops = suite.map_motions(lambda motion: jnp.stack([jnp.max(jnp.abs(y)) for y in motion_samples(motion)]))
    assert np.allclose(tops, [[1.0, 0.5], [1.0, 0.5]])  # PGA of 1 m/s², vertically half as much


def motion_samples(motion):
    assert isinstance(motion, rj.GroundMotion)
    return [part.scale * part.acceleration for part in (motion.horizontal, motion.vertical)]


@pytest.mark.slow
def test_severity_goes_on_where_the_columns_fall():
    pulses = [rj.Ricker(a, 1.0) for a in (2.0, 8.0, 14.0)]
    margins = optimise.PeakRotation(0.5, pulses).margins(BLOCK, OPTIONS)
    assert margins[0] > -1
    assert (margins[1:] < -2).all()
    slope = jax.jacfwd(lambda a: optimise.PeakRotation(0.5, pulses).margins(BLOCK.replace(alpha=a), OPTIONS))(
        0.15
    )
    assert (slope[1:] != 0).all()


@pytest.mark.slow
def test_an_amplitude_out_of_range_counts_as_its_end():
    target = optimise.OverturningAcceleration(2.0, rj.Ricker, 0.1, ratio=True, max_acceleration_ratio=3.0)
    value, slope = jax.jvp(lambda a: target.margins(BLOCK.replace(alpha=a), OPTIONS), (0.15,), (1.0,))
    assert np.allclose(value, 0.5)
    assert np.allclose(slope, 0.0)


def test_overturning_scales_are_unknown_if_simulations_below_them_do_not_finish(monkeypatch):
    def search(podium, motion, *, max_scale, options, width):
        unfinished = jnp.where(motion.T_p > 1, 0.5, 0.5 * width)  # shares of the range
        return SimpleNamespace(scale=jnp.inf, certain_width=unfinished * max_scale)

    monkeypatch.setattr(rj, "overturning_boundary", search)
    for target in (
        optimise.OverturningScale(2.0, MOTIONS, max_scale=3.0),
        optimise.OverturningAcceleration(2.0, rj.OneSine, [0.9, 1.2], ratio=True, max_acceleration_ratio=3.0),
    ):
        np.testing.assert_allclose(target.margins(BLOCK, OPTIONS), [0.5, np.nan])
    scales = jnp.array([1.0, 2.0, np.nan])
    assert np.isnan(optimise.MedianCapacity(1.0, MOTIONS).margins_of_scales(scales)).all()
    assert np.isnan(annual_risk().margins_of_scales(scales)).all()


def test_without_a_fitted_distribution_the_mean_of_the_scales_counts():
    """Equal scales have no dispersion."""
    median, risk = optimise.MedianCapacity(1.0, MOTIONS, max_scale=3.0), annual_risk()
    for scales, expected in (([0.3, 0.3], 0.3), ([0.75, np.inf], 1.5), ([np.inf, np.inf], 3.0)):
        np.testing.assert_allclose(median.margins_of_scales(jnp.array(scales)), expected - 1)
    rates = np.asarray(HAZARD(jnp.array([2.0, 30.0])))
    for scales, rate in (([2.0, 2.0], rates[0]), ([2.0, np.inf], rates.mean()), ([np.inf] * 2, rates[1])):
        np.testing.assert_allclose(risk.margins_of_scales(jnp.array(scales)), np.log(4e-4 / rate))


def test_a_scene_that_overturns_below_the_limit_violates_it():
    peaks: Any = SimpleNamespace(
        overturned=jnp.array([True, False]),
        margin=jnp.array([-0.05, 0.3]),
        peak_rotation=jnp.array([0.3, 0.2]),
    )
    margins = optimise.PeakRotation(0.4, MOTIONS).read(peaks, rj.Options(overturn_ratio=0.3))
    np.testing.assert_allclose(margins, [-0.05, 0.5])


def test_smoothed_quantile_has_the_sign_of_the_probability():
    rng = np.random.default_rng(3)
    values = jnp.asarray(rng.normal(0.3, 0.5, 60))
    for share in (0.02, 0.05, 0.3, 0.9):
        m = _smoothed_quantile(values, share, 0.05)
        assert np.isclose(np.mean(jax.scipy.stats.norm.cdf((m - values) / 0.05)), share, atol=1e-9)
        slope = jax.grad(lambda v, s=share: _smoothed_quantile(v, s, 0.05))(values)
        assert np.isclose(slope.sum(), 1.0)
        bumped = _smoothed_quantile(values.at[7].add(1e-5), share, 0.05)
        assert np.isclose((bumped - m) / 1e-5, slope[7], atol=1e-4)


def test_probability_counts_and_smooths():
    suite = [rj.Ricker(a, 1.0) for a in np.linspace(2.0, 8.0, 13)]
    target = optimise.OverturningProbability(0.5, suite, smoothing=0.05)
    counted = np.mean([bool(rj.peak_response(BLOCK, motion).overturned) for motion in suite])
    assert target.exact(BLOCK) == counted
    assert abs(target.smoothed(BLOCK) - counted) < 0.1
    sign = float(target.margins(BLOCK, rj.Options(throw=False))[0])
    assert (sign >= 0) == (target.smoothed(BLOCK) <= 0.5)
    assert optimise.OverturningProbability(0.5, suite, intensity=3.0).exact(BLOCK) > counted
    unfinished = rj.Options(max_steps=1)
    for probability in (target.exact, target.smoothed):
        with pytest.warns(RuntimeWarning, match="13 of 13 scenes did not finish"):
            assert np.isnan(probability(BLOCK, unfinished))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: optimise.PeakRotation(1.2, MOTIONS), r"limit must be finite and in \(0, 1\)"),
        (lambda: optimise.PeakRotation(MOTIONS, 0.5), "PeakRotation: limit must be finite"),
        (lambda: optimise.PeakShear(-1.0, MOTIONS), "limit must be finite and > 0"),
        (lambda: optimise.NoOverturning([]), "at least one"),
        (lambda: optimise.NoOverturning([*MOTIONS, 3.0]), r"excitations\[2\] must be a rockjax motion"),
        (lambda: optimise.OverturningAcceleration(3.0, "ricker", 1.0), "pulse must be a class"),
        (lambda: optimise.OverturningAcceleration(3.0, rj.Ricker, -1.0), "T_p must be"),
        (
            lambda: optimise.OverturningAcceleration(13.0, rj.Ricker, 1.0, ratio=True),
            "below max_acceleration_ratio",
        ),
        (lambda: optimise.OverturningScale(2.0, MOTIONS, max_scale=1.5), "must exceed at_least"),
        (lambda: optimise.MedianCapacity(2.0, MOTIONS, max_scale=1.5), "must exceed at_least"),
        (lambda: optimise.MedianCapacity(2.0, MOTIONS[:1]), "two motions or more"),
        (lambda: optimise.AnnualFrequency(0.0, HAZARD, RECORDS), "at_most must be"),
        (lambda: optimise.AnnualFrequency(1e-3, [0.1, 1.0], RECORDS), "hazard must be a rockjax.Hazard"),
        (lambda: optimise.ExpectedLoss(3.0, 1.0, annual_risk()), "must be a function of a podium"),
        (lambda: optimise.ExpectedLoss(float, -1.0, annual_risk()), "loss must be"),
        (lambda: optimise.ExpectedLoss(float, 1.0, HAZARD), "risk must be an optimise.AnnualFrequency"),
        (lambda: optimise.AnnualFrequency(1e-3, IN_G, RECORDS), r"got 'g'; convert it with hazard\.in_si"),
        (lambda: optimise.AnnualFrequency(1e-5, HAZARD, RECORDS), "give a higher max_intensity"),
        (lambda: optimise.AnnualFrequency(1e-3, HAZARD, RECORDS[0]), "two motions or more"),
        (lambda: optimise.AnnualFrequency(1e-3, HAZARD, MOTIONS), "samples a motion at times t"),
        (
            lambda: optimise.AnnualFrequency(1e-3, OVER_PGD, RECORDS),
            r"PGA, PGV or a label such as 'Sa\(0\.5 s\)', got 'PGD'",
        ),
        (lambda: optimise.OverturningProbability(0.0, MOTIONS), "at_most must be"),
        (lambda: optimise.PeakRotation(TWO, MOTIONS), "limit must be finite"),
        (lambda: optimise.PeakShear(TWO, MOTIONS), "limit must be finite"),
        (lambda: optimise.LeastAxialForce(TWO, MOTIONS), r"at_least must be in \[0, 1\)"),
        (lambda: optimise.LeastAxialForce("0.2", MOTIONS), r"at_least must be in \[0, 1\)"),
        (lambda: optimise.OverturningAcceleration(TWO, rj.Ricker, 1.0, ratio=True), "at_least must be"),
        (lambda: optimise.OverturningAcceleration(3.0, rj.Ricker, []), "at least one period"),
        (lambda: optimise.OverturningScale(TWO, MOTIONS), "at_least must be"),
        (lambda: optimise.OverturningProbability(TWO, MOTIONS), "at_most must be"),
        (lambda: optimise.AnnualFrequency(TWO, HAZARD, RECORDS), "at_most must be"),
        (lambda: optimise.WorstPeak(["peak_shear"], MOTIONS), "output must be one of"),
    ],
)
def test_errors_of_targets_name_the_valid_values(make, words):
    with pytest.raises(ValueError, match=words):
        make()


# Studies


@pytest.mark.slow
def test_slimmest_column_from_several_starts():
    answers = [studies.slimmest(seed, count=2) for seed in range(4)]
    assert all(answer.satisfied for answer in answers)
    assert np.ptp([answer.objective for answer in answers]) < 1e-5
    # The shadow price is the slope of the optimum with respect to the limit.
    podium, target = answers[0].structure, optimise.PeakRotation(0.4 * 1.01, studies.pulses(2))
    looser = optimise.design(podium, {"width": (0.2, 1.5)}, _alpha, target, options=studies.OPTIONS)
    price = sum(values.sum() for values in answers[0].multipliers.values())
    assert np.isclose((answers[0].objective - looser.objective) / 0.01, price, rtol=0.05)


@pytest.mark.slow
def test_lightest_beam_and_one_that_cannot_be():
    answer = studies.lightest(0, frequencies=4)
    assert answer.satisfied
    assert 0.1 < answer.objective < 10
    closest = studies.infeasible(0, frequencies=4)
    assert result_name(closest.result) == "infeasible"
    assert closest.variables["gamma"] > 99
    assert -0.1 < next(iter(closest.failing.values())) < 0


@pytest.mark.slow
def test_least_shear_over_two_variables():
    answer = studies.least_shear(0, records=2, starts=2)
    assert answer.satisfied
    worse = [start.objective for start in answer.starts if start.satisfied]
    assert answer.objective == min(worse)


@pytest.mark.slow
def test_rare_overturning_and_its_bias():
    answer, smoothed, counted = studies.slimmest_for_suite(1, records=20)
    assert answer.satisfied
    assert smoothed <= 0.05 + 1e-6
    assert abs(smoothed - counted) <= 0.05 + 1e-6


@pytest.mark.slow
def test_fit_recovers_the_truth():
    fit = studies.measured_fit(4, starts=2)
    truth = studies.measured(4)[0]
    assert fit.converged
    for name, value in (("alpha", truth.alpha), ("restitution", truth.restitution_factor)):
        assert abs(fit.variables[name] - float(value)) < 4 * fit.errors[name] < 0.01
    assert np.isclose(fit.rms, 0.01 * np.abs(studies.measured(4, noise=0.0)[3]).max(), rtol=0.15)
    assert "±" in repr(fit)


def test_fit_rejects_invalid_arguments():
    vary, motion = {"alpha": (0.1, 0.3)}, rj.Ricker(3.0, 1.0)
    with pytest.raises(ValueError, match="vectors of equal length"):
        optimise.fit(BLOCK, vary, motion, [0.0, 1.0], [0.0])
    with pytest.raises(ValueError, match="times must be ascending"):
        optimise.fit(BLOCK, vary, motion, [1.0, 0.0], [0.0, 0.0])
    with pytest.raises(ValueError, match="do not determine"):
        optimise.fit(BLOCK, {**vary, "R": (1, 2), "gamma": (0, 1)}, motion, [0.0, 1.0], [0.0, 0.0])
    with pytest.raises(ValueError, match="not begin before the excitation"):
        optimise.fit(BLOCK, vary, motion, [-9.0, 1.0], [0.0, 0.0])
    with pytest.raises(ValueError, match=r"fit: options.overturn_ratio must be <= π/\(2α\) = 10.472"):
        optimise.fit(BLOCK, vary, motion, [0.0, 1.0], [0.0, 0.0], options=BEYOND.replace(overturn_ratio=12))


def test_errors_are_unknown_without_more_measurements_than_variables():
    slope = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    assert np.isinf(_covariance(np.zeros(2), slope[:2])).all()
    assert np.isfinite(_covariance(np.full(3, 0.1), slope)).all()


@pytest.mark.slow
def test_a_fit_names_the_cure_if_no_simulation_finishes():
    options = rj.Options(history=4)
    fit = optimise.fit(
        BLOCK, {"alpha": (0.1, 0.3)}, rj.Ricker(3.0, 1.0), [0.0, 1.0], [0.0, 0.1], options=options
    )
    assert fit.rms == np.inf
    assert not fit.converged
    assert "raise history or max_steps" in repr(fit)


# Files and reports

FILE = """
starts = 2
[structure]
tan_alpha = 0.15
R = 1.5
gamma = 4.0
[vary]
alpha = [0.1, 0.4]
[motions.pulses]
kind = "ricker"
acceleration_ratio = [2.0, 2.5]
frequency_ratio = 4.0
[[motions.records]]
file = "one.txt"
units = "g"
dt = 0.01
[[motions.records]]
file = "two.csv"
units = "m/s2"
[minimise]
quantity = "alpha"
[[targets]]
kind = "peak-rotation"
limit = 0.4
motions = "pulses"
[options]
rtol = 1e-9
"""


@pytest.fixture
def folder(tmp_path) -> Path:
    (tmp_path / "one.txt").write_text("# a record\n0.0\n0.1\n-0.1\n0.0\n")
    (tmp_path / "two.csv").write_text("time,acceleration\n0.00,0.0\n0.02,0.5\n0.04,-0.5\n0.06,0.0\n")
    return tmp_path


def write_problem(folder: Path, text: str) -> Path:
    path = folder / "problem.toml"
    path.write_text(text)
    return path


def test_a_file_is_the_problem_it_says(folder):
    problem = optimise.load(write_problem(folder, FILE))
    assert np.isclose(problem.podium.alpha, math.atan(0.15))
    first, second = problem.motions["pulses"]
    assert np.isclose(first.a_p, 2 * 9.80665 * 0.15)
    assert np.isclose(second.omega_p / problem.podium.p, 4.0)
    one, two = problem.motions["records"]
    assert np.allclose(one.acceleration, [0, 0.980665, -0.980665, 0])
    assert np.isclose(two.dt, 0.02)
    assert problem.settings == {"starts": 2}
    assert problem.options.rtol == 1e-9
    assert problem.targets[0].limit == 0.4
    assert problem.vary == {"alpha": (0.1, 0.4)}
    assert re.search(r"^  alpha +0\.14889 +rad +0\.1 … 0\.4$", repr(problem), re.M), repr(problem)
    assert re.search(r"^  records +2$", repr(problem), re.M)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("R = 1.5", "", r"structure: R is missing"),
        ("R = 1.5", "R = -1.5", r"structure\.R: must be a number > 0"),
        ("R = 1.5", "radius = 1.5", r"structure\.radius: unknown key"),
        ("tan_alpha = 0.15", "", r"needs alpha or tan_alpha"),
        ("alpha = [0.1, 0.4]", "beta = [0.1, 0.4]", r"vary: .*names 'beta'"),
        ('kind = "ricker"', 'kind = "mexican"', r"motions\.pulses\.kind: must be 'ricker'"),
        ("frequency_ratio = 4.0", "", r"motions\.pulses: needs T_p or frequency_ratio"),
        ("frequency_ratio = 4.0", "T_p = [1.0, 1.1, 1.2]", r"2 amplitudes and 3 periods"),
        ("one.txt", "none.txt", r"motions\.records\[0\]: .*none\.txt: the file cannot be read: No such file"),
        ('units = "g"', 'units = "ft"', r"motions\.records\[0\]\.units: must be 'g', 'm/s2', .*, got 'ft'"),
        ("dt = 0.01", "", r"give dt"),
        ('motions = "pulses"', 'motions = "quakes"', r"targets\[0\]\.motions: must name a set"),
        ("limit = 0.4", "limit = 4", r"targets\[0\]: PeakRotation: limit"),
        (
            "limit = 0.4",
            "",
            r"targets\[0\]: peak-rotation needs exactly one of limit and at_most, got neither",
        ),
        (
            'kind = "peak-rotation"',
            'kind = "peak"',
            r"targets\[0\]: kind must be a kind of check, got 'peak'",
        ),
        ('quantity = "alpha"', 'quantity = "peak-shear"', r"minimise: motions is missing"),
        ("rtol = 1e-9", "rtol = 9", r"options: Options: rtol"),
        ("[options]", "[options", r"is not valid TOML"),
    ],
)
def test_errors_of_files_name_the_fault(folder, old, new, words):
    assert old in FILE
    path = write_problem(folder, FILE.replace(old, new, 1))
    with pytest.raises(ValueError, match=words) as caught:
        optimise.load(path)
    assert "problem.toml" in str(caught.value)


ON_FLOORS = """
[[contents]]
name = "cabinet"
alpha = 0.2
R = 0.5
[[contents]]
width = 0.4
height = 1.8
[[oscillators]]
period = 0.3
"""
OF_FLOORS = """
[[targets]]
kind = "contents-rotation"
limit = 0.5
motions = "pulses"
contents = ["cabinet"]
[[targets]]
kind = "floor-spectrum"
limit = 9.0
motions = "pulses"
"""


def test_targets_on_floors_name_things_of_the_file(folder):
    *_, rotation, spectrum = optimise.load(write_problem(folder, FILE + ON_FLOORS + OF_FLOORS)).targets
    assert isinstance(rotation, optimise.ContentsRotation)
    assert isinstance(spectrum, optimise.FloorSpectrum)
    assert (rotation.limit, spectrum.limit) == (0.5, 9.0)
    assert [float(block.alpha) for block in rotation.systems] == [0.2]
    assert [float(y.period) for y in spectrum.systems] == [0.3]
    every = OF_FLOORS.replace('contents = ["cabinet"]', "")
    assert len(optimise.load(write_problem(folder, FILE + ON_FLOORS + every)).targets[-2].systems) == 2
    for text, words in (
        (OF_FLOORS, r"targets\[\d\]: needs entries \[\[contents\]\]"),
        (
            ON_FLOORS + OF_FLOORS.replace("cabinet", "shelf"),
            r"contents must each be one of cabinet, contents-2",
        ),
        (ON_FLOORS + OF_FLOORS.replace("limit = 0.5", "limit = 1.5"), "ContentsRotation: limit"),
    ):
        with pytest.raises(ValueError, match=words):
            optimise.load(write_problem(folder, FILE + text))


def test_intensities_of_a_file_are_no_factors(folder):
    text = FILE.replace(
        'kind = "peak-rotation"\nlimit = 0.4\nmotions = "pulses"',
        'kind = "median-capacity"\nat_least = 4.0\nmotions = "records"',
    )
    pga = text + '[fragility]\nmeasure = "PGA"\n'
    (target,) = optimise.load(write_problem(folder, pga)).targets
    assert isinstance(target, optimise.MedianCapacity)
    assert float(target.max_scale) == pytest.approx(12.0)
    with pytest.raises(
        ValueError, match=r"targets\[0\]: max_scale is a factor on the motions; .* measure PGA"
    ):
        optimise.load(write_problem(folder, pga.replace("at_least = 4.0", "at_least = 4.0\nmax_scale = 3.0")))
    (folder / "two.csv").write_text("time,acceleration\n0.00,0.0\n0.02,0.0\n0.04,0.0\n")
    message = r"targets\[0\]: motion 2 has PGA = 0; leave it out"
    with pytest.warns(rj.PlausibilityWarning), pytest.raises(ValueError, match=message):
        optimise.load(write_problem(folder, pga))


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"none\.toml: the file cannot be read"):
        optimise.load(tmp_path / "none.toml")


@pytest.mark.smoke
def test_the_command_writes_everything(folder, capsys):
    design_command(optimise.load(write_problem(folder, FILE)), folder / "out", quiet=True)
    assert capsys.readouterr().out == ""
    account = json.loads((folder / "out.json").read_text())
    assert account["satisfied"] is True
    assert account["variables"]["alpha"] == pytest.approx(account["podium"]["alpha"])
    assert {"x", "objective", "margin", "step", "accepted"} <= set(account["history"][0])
    assert account["stats"]["scenes"] == 2 * account["stats"]["evaluations"]
    for name in ("out-convergence.png", "out-response.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")


def test_pictures_use_the_options_of_the_problem(monkeypatch, tmp_path):
    def simulate(podium, excitation, *, options=None):
        raise RuntimeError(f"options: {options == OPTIONS}")

    monkeypatch.setattr(rj, "simulate", simulate)
    monkeypatch.setattr("optimise._cli._decisive_motion", lambda *_: MOTIONS[0])
    design = optimise.design(BLOCK, {"alpha": (0.1, 0.2)}, _alpha)
    problem: Any = SimpleNamespace(
        design=lambda **_: design, motions={"pulses": MOTIONS}, podium=BLOCK, options=OPTIONS
    )
    with pytest.raises(RuntimeError, match="options: True"):
        design_command(problem, tmp_path / "out", quiet=True)


def test_a_record_of_a_design_describes_devices_and_elevation():
    """The JSON file describes the whole podium."""
    column = COLUMNS.replace(tendon_force=1e4, inertance=30.0, beam_depth=0.5)
    design = optimise.design(
        column, {"tendon_force": (1e4, 5e4)}, lambda podium: podium.restrainers[0].prestress
    )
    podium = json.loads(as_json(design_record(design)))["podium"]
    devices = {y["kind"]: y for y in podium["restrainers"]}
    assert devices["Tendon"]["prestress"] == pytest.approx(1e4 / (1.5e3 * 9.80665))
    assert devices["Inerter"]["inertance"] == pytest.approx(0.02)
    assert podium["elevation"]["columns"] == [0.0, 5.0]
    assert podium["elevation"]["beam_depth"] == 0.5


def test_bounds_of_logarithmic_variables_are_marked_where_they_are_met():
    for least, remark in ((1e-3, "(at bound)"), (2e-3, "")):
        target = Analytic(lambda podium, least=least: podium.gamma / least - 1)
        design = optimise.design(
            BLOCK.replace(gamma=1.0), {"gamma": (1e-3, 1e4)}, lambda podium: podium.gamma, target
        )
        row = next(line for line in repr(design).splitlines() if line.startswith("  gamma"))
        assert row.endswith(f"0.001 … 10000 {remark}".rstrip())


def test_reports_are_readable():
    target = Analytic(lambda p: p.alpha / 0.2 - 1, "width < enough & more")
    answer = optimise.design(BLOCK, {"alpha": (0.05, 0.5)}, _alpha, target, starts=2)
    text = repr(answer)
    assert "converged, targets satisfied" in text
    assert "alpha     0.2" in text
    assert "2 of 2 starts" in text
    assert "width &lt; enough &amp; more" in answer._repr_html_()
    axes = optimise.convergence(answer)
    assert axes.get_ylabel() == "_alpha"
