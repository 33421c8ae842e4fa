"""Several processes, and JAX's settings for debugging."""

import os
import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor

import pytest


def run(script, **environment):
    """Return the output of a script without messages about programs."""
    # JAX's own cache is off unless the test sets it.
    inherited = {name: y for name, y in os.environ.items() if not name.startswith("JAX_COMPILATION_CACHE")}
    ended = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", textwrap.dedent(script)],
        env=inherited | environment,
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.split()


SCENES = """
import rockjax as rj, numpy as np
from rockjax._programs.program import COUNTS
podium = rj.Podium(alpha=0.15, R=1.5, gamma=10.0, superstructure=rj.Rigid(eta=100.0))
peaks = rj.peak_responses(podium, rj.Ricker(np.array([1.0, 2.0, 3.0]), 1.0))
alone = rj.peak_response(podium, rj.Ricker(2.0, 1.0)).peak_rotation
print(*[float(y).hex() for y in (*peaks.peak_rotation, alone)], COUNTS["loaded"], COUNTS["compiled"])
"""


@pytest.mark.slow
def test_several_processes_at_once(tmp_path):
    """Processes that write the same programs at the same time have equal answers, also a process that loads
    and one that compiles them."""
    with ThreadPoolExecutor() as pool:
        both = list(pool.map(lambda _: run(SCENES, ROCKJAX_CACHE_DIR=str(tmp_path)), range(2)))
    later = run(SCENES, ROCKJAX_CACHE_DIR=str(tmp_path))
    alone = run(SCENES, ROCKJAX_CACHE="off")
    assert both[0][:4] == both[1][:4] == later[:4] == alone[:4]
    assert later[4:] == ["3", "0"]


@pytest.mark.slow
def test_programs_from_the_cache_of_jax_are_not_stored(tmp_path):
    """Such programs would be stored without their code, because XLA serialises only what it has compiled
    itself."""
    own = {"JAX_COMPILATION_CACHE_DIR": f"{tmp_path}/jax", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    first, again, *other = (
        run(SCENES, ROCKJAX_CACHE_DIR=f"{tmp_path}/{folder}", **own)
        for folder in ("one", "one", "two", "two")
    )
    assert again == [*first[:4], "3", "0"]
    assert all(answers[:5] == [*first[:4], "0"] for answers in other)


def test_a_program_that_needs_lapack_finds_it_in_a_later_process(tmp_path):
    script = """
        import numpy as np, jax, rockjax
        from rockjax._programs.program import COUNTS, StoredProgram
        solve = StoredProgram(lambda a, b: jax.numpy.linalg.solve(a, b), name="rockjax.solve")
        print(*solve(np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([3.0, 4.0])), COUNTS["loaded"])
    """
    for loaded in ("0", "1"):
        assert run(script, ROCKJAX_CACHE_DIR=str(tmp_path)) == ["1.0", "1.0", loaded]


def test_importing_leaves_settings_of_jax_open():
    """The platform can be chosen until JAX's backend starts."""
    script = """
        import jax, rockjax
        from jax.extend import backend
        jax.config.update("jax_num_cpu_devices", 3)  # an error once it has started
        print(len(backend.backends()["cpu"].devices()))
    """
    assert run(script) == ["3"]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows has no fork")
def test_structures_and_pulses_made_before_a_fork_serve_the_child():
    script = """
        import os, faulthandler
        import rockjax as rj
        podium = rj.Podium(0.15, 1.5, 10.0, rj.Elastic(5.0, 0.5), restrainers=(rj.Damper(1.0, 0.5),))
        motion = rj.Ricker(3.0, 1.0)
        if child := os.fork():
            os.waitpid(child, 0)
        else:
            faulthandler.dump_traceback_later(100, exit=True)
            print(float(rj.peak_response(podium, motion).peak_rotation) > 0, flush=True)
            os._exit(0)
    """
    assert run(script) == ["True"]


def test_answers_are_the_same_while_jax_looks_for_nan():
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
    assert run(script) == ["True", "True"]
