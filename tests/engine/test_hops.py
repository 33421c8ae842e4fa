"""Many hops at once: the same scene as hop by hop, to the last impact."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._engine.flat import run
from rockjax._engine.scene import plan_for, prepare
from rockjax._engine.solve import answers
from rockjax._responses.estimate import companion
from rockjax._results import REST, code_of
from tests.scenes import elastic, pulse

OPTIONS = rj.Options(
    rtol=1e-8,
    atol=1e-10,
    rest_velocity=1e-5,
    outputs=("peak_rotation", "peak_deformation", "peak_shear", "impacts"),
)
MOTION = pulse()
T_END = jnp.asarray(40.0)


def bouncing(T_s, zeta: Any = 0.05) -> rj.Podium:
    """Columns that lose nothing at impacts."""
    return elastic(T_s, zeta=zeta).replace(restitution=1.0)


@pytest.fixture(scope="module")
def solved():
    """(floats, integers) of a scene and the derivatives of its floats by T_s, many hops at once or not."""

    def solve(T_s, many: bool):
        podium = bouncing(T_s)
        plan = dataclasses.replace(plan_for(podium, OPTIONS, False), many_hops=many)
        scene, state = prepare(podium, MOTION, REST, T_END, OPTIONS, plan)
        return answers(scene, plan, run(scene, plan, state, 3_000_000))

    def both(T_s, many: bool):
        return jax.jvp(lambda T_s: solve(T_s, many), (T_s,), (1.0,))

    program = jax.jit(both, static_argnums=1)
    return {many: program(1.0, many) for many in (True, False)}


@pytest.mark.slow
def test_the_same_as_hop_by_hop(solved):
    """Answers, the number of impacts, and the time of the last of them, to the tolerance; in fewer steps."""
    (floats, integers), _ = solved[True]
    (wanted, counted), _ = solved[False]
    assert int(integers["code"]) == int(counted["code"])
    assert int(integers["impacts"]) == int(counted["impacts"]) > 100_000
    assert int(integers["steps"]) < 0.05 * int(counted["steps"])
    for name in ("peak_rotation", "peak_deformation", "peak_shear", "end_time"):
        assert float(floats[name]) == pytest.approx(float(wanted[name]), rel=1e-8), name


@pytest.mark.slow
def test_derivatives_are_those_of_hop_by_hop(solved):
    _, (slopes, _) = solved[True]
    _, (wanted, _) = solved[False]
    for name in ("peak_rotation", "peak_deformation", "peak_shear", "end_time"):
        assert float(slopes[name]) == pytest.approx(float(wanted[name]), rel=1e-6, abs=1e-9), name


@pytest.mark.slow
def test_columns_that_lose_nothing_come_to_an_end():
    """With the rest velocity of the tolerance, which takes 10⁸ hops: no step limit, in a batch and alone."""
    options = OPTIONS.replace(rest_velocity=None, max_steps=200_000)
    periods, damping = np.linspace(0.8, 1.2, 4), np.linspace(0.02, 0.1, 4)
    batch = rj.peak_responses(
        bouncing(periods, damping), MOTION, t_end=T_END, options=options, sensitivities=("T_s",)
    )
    assert set(np.asarray(code_of(batch.result))) <= {0, 1, 2}
    alone = rj.peak_response(bouncing(periods[0], damping[0]), MOTION, t_end=T_END, options=options)
    for name in ("peak_rotation", "peak_deformation", "peak_shear"):
        assert float(getattr(batch, name)[0]) == pytest.approx(float(getattr(alone, name)), rel=1e-7)
    assert batch.sensitivities is not None
    assert batch.sensitivities.peak_shear is not None

    def shear(T_s):
        return rj.peak_response(bouncing(T_s, damping[0]), MOTION, t_end=T_END, options=options).peak_shear

    wanted = periods[0] * float(jax.grad(shear)(periods[0]))
    assert float(batch.sensitivities.peak_shear[0, 0]) == pytest.approx(wanted, rel=1e-6)


def test_who_does_not_need_it_does_not_compile_it():
    """Both laws take enough at every impact, and a program without it is smaller."""
    assert plan_for(bouncing(0.5), OPTIONS, False).many_hops
    assert not plan_for(elastic(0.5), OPTIONS, False).many_hops
    assert not plan_for(elastic(0.5).replace(restitution="compatible"), OPTIONS, False).many_hops
    assert not plan_for(bouncing(0.5), OPTIONS, True).many_hops


@pytest.mark.slow
def test_error_estimates_take_about_as_many_steps():
    """The second solution lets columns rest at half the speed: at a ten-thousandth it took 63 621 steps here
    for the 4891 of the first, and with `rtol` = 1e-10 it ran out of a million."""
    podium = rj.Podium(
        0.038814444511175425,
        0.5283545218942546,
        0.007044159876112568,
        rj.Elastic(1000.0, 10.0, 0.0569460480916092),
        restitution=1.0,
    )
    motion = rj.Ricker(11.033978539903167, 2.987027976318021)
    initial = rj.State(0.01064042997340475, -0.012279135564400814, 0.004008696402648775, 0.01495654980462765)
    options = rj.Options(rtol=1e-8, atol=1e-10, outputs=("peak_rotation",))
    steps, again = (
        int(peak.stats.steps + peak.stats.rejected)
        for o in (options, companion(options))
        for peak in [rj.peak_response(podium, motion, initial=initial, options=o)]
    )
    assert steps > 2000
    assert again < 3 * steps
