"""The compiled program of a trial step."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._engine.scene import plan_for, prepare
from rockjax._engine.step import trial
from rockjax._results import REST
from tests.scenes import PODIUMS

LANES = 64
TENDON = (rj.Tendon(0.1, 0.2),)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("podium", "outputs"),
    [
        (PODIUMS["rigid"], ("peak_rotation",)),
        (PODIUMS["elastic"], ("peak_rotation",)),
        (PODIUMS["elastic"], rj.Options().outputs),
        (PODIUMS["elastic"].replace(restrainers=TENDON), ("peak_rotation",)),
    ],
    ids=["rigid", "elastic", "all peaks", "restrained"],
)
def test_kernels_of_a_trial_share_values(podium, outputs):
    """The compiled step has few more operations than the traced one. Without barriers, kernels would
    recompute shared values."""
    motion, options = rj.Record(np.sin(np.arange(100)), 0.02), rj.Options(outputs=outputs)
    podium = podium.split_rows()
    plan = plan_for(podium, options, history=False)
    scene, state = jax.jit(lambda: prepare(podium, motion, REST, None, options, plan))()
    lanes = jax.tree.map(lambda y: jnp.broadcast_to(y, (LANES, *jnp.shape(y))), state)
    written = jax.jit(jax.vmap(lambda lane: trial(scene, plan, lane)[0])).lower(lanes)
    made = written.compile().cost_analysis()
    assert made["flops"] < 1.12 * written.cost_analysis()["flops"]


def test_stages_of_rigid_steps_divide_by_nothing():
    """The stages do not divide by the inertia, because a division takes as long as ten products or more."""
    podium, options = PODIUMS["rigid"].split_rows(), rj.Options(outputs=("peak_rotation",))
    plan = plan_for(podium, options, history=False)
    motion = rj.Record(np.sin(np.arange(100)), 0.02)
    scene, state = prepare(podium, motion, REST, None, options, plan)
    program = jax.jit(lambda state: trial(scene, plan, state)[0]).lower(state).as_text()
    (field,) = re.findall(r"func\.func private @field\(.*?\n  }", program, re.DOTALL)
    assert "stablehlo.multiply" in field
    for divisor in re.findall(r"stablehlo.divide %\w+, (%\w+) :", field):  # division by 1, which XLA removes
        assert f"{divisor} = stablehlo.constant dense<1.000000e+00>" in field
