"""Other processes and JAX's settings for debugging."""

import os
import subprocess
import sys
import textwrap

import pytest


def run(script, tmp_path, **environment):
    """What a script prints, without the programs' remarks."""
    path = tmp_path / "script.py"
    path.write_text(textwrap.dedent(script))
    ended = subprocess.run(
        [sys.executable, "-W", "ignore", path],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.split()


@pytest.mark.parametrize(
    "made",
    [
        "rj.Podium(0.15, 1.5, 1.0)",
        "rj.Podium(0.15, 1.5, 10.0, rj.Elastic(5.0, 0.5), restrainers=(rj.Damper(1.0, 0.5),))",
        "rj.Podium.from_dimensions(0.45, 3.0, 1500.0, 30e3, top_mass=3e4, tendon_force=1e4)",
        "rj.Podium(0.15, 1.5).replace(R=2.0)",
    ],
)
@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows has no fork")
def test_structures_and_pulses_made_before_a_fork_serve_the_child(made, tmp_path):
    script = f"""
        import os, faulthandler
        import rockjax as rj
        podium, motion = {made}, rj.Ricker(3.0, 1.0)
        if child := os.fork():
            os.waitpid(child, 0)
        else:
            faulthandler.dump_traceback_later(100, exit=True)
            print(float(rj.peak_response(podium, motion).peak_rotation) > 0, flush=True)
            os._exit(0)
    """
    assert run(script, tmp_path) == ["True"]


def test_processes_that_are_spawned(tmp_path):
    script = """
        import multiprocessing
        import rockjax as rj

        def peak(given):
            return float(rj.peak_response(*given).peak_rotation)

        if __name__ == "__main__":
            podium = rj.Podium(0.15, 1.5, 1.0)
            here = [peak((podium, rj.Ricker(a, 1.0))) for a in (3.0, 3.7)]
            with multiprocessing.get_context("spawn").Pool(2) as pool:
                there = pool.map(peak, [(podium, rj.Ricker(a, 1.0)) for a in (3.0, 3.7)])
            print(here == there)
    """
    assert run(script, tmp_path) == ["True"]


def test_answers_are_the_same_while_jax_looks_for_nan(tmp_path):
    script = """
        import jax
        import numpy as np
        import rockjax as rj

        def answers():
            block, motion = rj.Podium(0.15, 1.5), rj.Ricker(3.0, 1.0)
            top = rj.ShearBuilding.uniform(2, 5.0, 0.5)
            building = rj.Podium(0.15, 1.5, 10.0, top, restrainers=(rj.Damper(4.0),))
            errors = rj.Options(outputs=("peak_rotation", "errors"))
            history = rj.simulate(building, motion)
            yield rj.peak_response(block, motion)
            yield rj.peak_response(block, motion, options=errors)
            yield rj.peak_responses(block, rj.Ricker([1.0, 9.0], 1.0), sensitivities=["alpha"])
            yield history([-9.0, 1.0]), history.drift([-9.0, 1.0]), history.energies([-9.0, 1.0])
            yield history.dataset(np.linspace(-9.0, 1.0, 3))["theta"].values
            yield rj.overturning_acceleration(block, rj.Ricker, 1.0)
            yield jax.grad(lambda a: rj.peak_response(block.replace(alpha=a), motion).peak_rotation)(0.15)

        plain = jax.tree.leaves(list(answers()))
        with jax.debug_nans(True), jax.debug_infs(True):
            searched = jax.tree.leaves(list(answers()))
        print(len(plain) == len(searched))
        print(all(np.array_equal(a, b, equal_nan=True) for a, b in zip(plain, searched)))
    """
    assert run(script, tmp_path) == ["True", "True"]
