"""Batches on several devices, in a separate process because their number must be set before JAX starts."""

import json
import os
import re
import subprocess
import sys
import threading
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import jax
import numpy as np
import pytest

import rockjax as rj
from rockjax._batch.batch import layout, responses
from rockjax._batch.executors import DeviceExecutor, ThreadExecutor, _on_mesh, executor_for
from rockjax._batch.lanes import idle_lanes
from rockjax._batch.scenes import NO_SCENES, SceneIndices, broadcast
from tests.scenes import PODIUMS, G, elastic, options, shaking

DEVICES = 3


def amplitudes(n):
    return np.linspace(0.5, 6.0, n) * G * 0.15


def suite(n):
    """Return two records in one table, at n scales."""
    table = rj.Records.of([shaking(k, seed=k) for k in (100, 120)])
    return table.pick(np.arange(2)[:, None]).scaled(np.linspace(0.5, 2, n))


def distinct_records(n):
    """Return scenes with separate records, which are not moved between lanes."""
    return rj.Record(np.stack([shaking(90, seed=k).acceleration for k in range(n)]), 0.02)


# The programs are few and small, because each takes seconds to compile.
COARSE_OPTIONS = options(1e-5, "bosh3", outputs=("peak_rotation", "impacts"))
ERRORS = COARSE_OPTIONS.replace(outputs=("peak_rotation", "errors"), max_steps=400)


class Case(NamedTuple):
    podium: rj.Podium
    motion: rj.AbstractExcitation
    options: rj.Options
    devices: list[int]  # number of devices


CASES = {
    "elastic, errors, out of steps": Case(elastic(0.4), rj.Ricker(amplitudes(500), 0.9), ERRORS, [2]),
    "rigid, a suite in one table": Case(PODIUMS["rigid"], suite(97), COARSE_OPTIONS, [3]),
    "rigid, several chunks": Case(PODIUMS["rigid"], suite(4801), COARSE_OPTIONS, [3]),
    "block, a record each": Case(PODIUMS["block"], distinct_records(5), COARSE_OPTIONS, [1, 3]),
    "block, fewer scenes than devices": Case(PODIUMS["block"], distinct_records(2), COARSE_OPTIONS, [3]),
}
STOPPED = "rigid, several chunks"


class StopsAtOnce(threading.Event):
    """Progress bar that stops the batch after the first scenes have ended."""

    def update(self, count):
        self.set()


def largest_difference(a: rj.Peak, b: rj.Peak, where=...) -> float:
    """Return the largest difference, relative to the largest value of each answer; inf if integers or flags
    differ."""
    worst = 0.0
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        x, y = x[where], y[where]
        expected = np.isfinite(x)
        if not np.array_equal(x[~expected], y[~expected], equal_nan=True) or (
            x.dtype != float and not np.array_equal(x, y)
        ):
            return np.inf
        if x.dtype == float and expected.any():
            worst = max(
                worst,
                float(np.max(np.abs(x[expected] - y[expected])) / max(1e-300, np.max(np.abs(x[expected])))),
            )
    return worst


def report() -> dict:
    devices = jax.local_devices()
    device_results: dict = {"devices": len(devices)}
    for name, (podium, motion, how, numbers) in CASES.items():
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "[0-9]+ of .* scenes did not finish", RuntimeWarning)
            run = lambda chosen, p=podium, m=motion, o=how: rj.peak_responses(p, m, options=o, devices=chosen)
            alone = run(None)
            device_results[name] = {k: largest_difference(run(devices[:k]), alone) for k in numbers}
        device_results[name]["results"] = sorted(
            {str(rj._results.NAMES[k]) for k in np.unique(alone.result._value)}
        )
        device_results[name]["shape"] = alone.peak_rotation.shape
        if name == STOPPED:
            stop = StopsAtOnce()
            try:
                responses(podium, motion, rj.State(), None, how, stop, stop, devices)
            except rj.Interrupted as interrupted:
                some = interrupted.partial
                ended = np.asarray(some.result != rj.RESULTS.interrupted)
                device_results["stopped"] = {
                    "ended": int(ended.sum()),
                    "of": ended.size,
                    "apart": largest_difference(some, alone, ended),
                }
    return device_results


@pytest.fixture(scope="module")
def device_results():
    root = Path(__file__).parents[2]
    cache = {
        "JAX_COMPILATION_CACHE_DIR": str(jax.config.jax_compilation_cache_dir),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "1",
    }
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "tests.batch.test_devices"],
        cwd=root,
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ
        | cache
        | {"JAX_PLATFORMS": "cpu", "JAX_NUM_CPU_DEVICES": str(DEVICES), "PYTHONPATH": str(root)},
    )
    assert done.returncode == 0, done.stderr
    assert not [line for line in done.stderr.splitlines() if not line.startswith("compiling a program")], (
        done.stderr
    )
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_devices_answer_as_threads_do(device_results, name):
    """Answers are identical at present; another compiler may round the two programs differently."""
    assert device_results["devices"] == DEVICES
    for k in CASES[name].devices:
        assert device_results[name][str(k)] < 1e-9


@pytest.mark.slow
def test_the_cases_match_their_names(device_results):
    assert "out_of_steps" in device_results["elastic, errors, out of steps"]["results"]
    assert {"overturned", "settled"} <= set(device_results["rigid, several chunks"]["results"])
    sizes = {name: int(np.prod(device_results[name]["shape"])) for name in CASES}
    assert sizes["block, fewer scenes than devices"] < DEVICES
    assert sizes["rigid, several chunks"] > 3 * DEVICES * 1024
    assert sizes["rigid, several chunks"] % DEVICES


@pytest.mark.slow
def test_a_stopped_batch_on_devices_keeps_solved_scenes(device_results):
    stopped = device_results["stopped"]
    assert 0 < stopped["ended"] < stopped["of"]
    assert stopped["apart"] < 1e-9


def test_threads_and_devices_that_cannot_be():
    run = lambda **executor: rj.peak_responses(PODIUMS["block"], rj.Ricker(3.0, 1.0), **executor)
    (device, *_) = jax.local_devices()
    for executor, words in (
        ({"threads": 0}, "threads must be a whole number ≥ 1, got threads = 0"),
        ({"threads": 1.5}, "threads must be a whole number"),
        ({"devices": []}, "devices must be one or more JAX devices"),
        ({"devices": ["cpu"]}, "devices must be one or more JAX devices"),
        ({"devices": [device, device]}, "different devices of one platform"),
        ({"devices": [device], "threads": 2}, "devices or threads, not both"),
    ):
        with pytest.raises(ValueError, match=words):
            run(**executor)
    assert executor_for("", threads=3).threads == 3
    assert executor_for("", devices=[device]).threads == 1


def test_scenes_are_dealt_out_in_turn():
    scenes, _ = broadcast("", PODIUMS["block"], rj.Ricker(np.arange(10.0), 1.0), rj.State(), None)
    seven = SceneIndices(2, 1, 7)
    (dealt,) = [y for y in scenes.leaves_of_chunk(seven, 4, 3) if np.ndim(y)]
    np.testing.assert_array_equal(dealt.reshape(3, 4), [[2, 5, 8, 2], [3, 6, 2, 2], [4, 7, 2, 2]])
    first, stride, count = seven.split(3)
    np.testing.assert_array_equal(first, [2, 3, 4])
    assert stride == 3
    np.testing.assert_array_equal(count, [3, 2, 2])
    (odd,) = [y for y in scenes.leaves_of_chunk(SceneIndices(1, 2, 5), 6) if np.ndim(y)]
    np.testing.assert_array_equal(odd, [1, 3, 5, 7, 9, 1])
    (none,) = [y for y in scenes.leaves_of_chunk(NO_SCENES, 2, 3) if np.ndim(y)]
    assert none.shape == (6,)


def test_a_default_device_is_where_batches_run(monkeypatch):
    (device, *_) = jax.local_devices(backend="cpu")
    monkeypatch.setattr(jax, "default_backend", lambda: "cpu")
    assert isinstance(executor_for(""), ThreadExecutor)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(
        jax, "local_devices", lambda backend=None: {"gpu": ["a", "b"], "cpu": [device]}[backend]
    )
    monkeypatch.setattr(rj._batch.executors, "DeviceExecutor", list)
    assert executor_for("") == ["a", "b"]
    assert executor_for("", threads=2).threads == 2
    for chosen in (device, "cpu"):
        with jax.default_device(chosen):
            threads = executor_for("")
            assert isinstance(threads, ThreadExecutor)
    # Threads use the CPU even if accelerators are the default.
    with threads._on_cpu():
        assert jax.config.jax_default_device == device


def test_accelerators_have_more_lanes(monkeypatch):
    def lanes(scenes, devices, platform="gpu", samples=None):
        batch = np.ones(scenes) if samples is None else np.ones((scenes, samples))
        motion = rj.Ricker(batch, 1.0) if samples is None else rj.Record(batch, 0.02)
        made, _ = broadcast("", PODIUMS["block"], motion, rj.State(), None)
        chosen = layout(made, SimpleNamespace(platform=platform, devices=devices))  # pyright: ignore[reportArgumentType]
        assert chosen.size % chosen.lanes == 0
        return chosen.lanes, chosen.size

    assert lanes(100, 1) == (1024, 1024)
    assert lanes(10_000, 4) == (4096, 4096)
    assert lanes(500_000, 2) == (32768, 4 * 32768)
    assert lanes(500_000, 2, "cpu") == lanes(1, 2, "cpu") == (32, 1024)
    # A record of 100 samples, and its padding.
    monkeypatch.setattr(rj._batch.batch, "ACCELERATOR_VALUES", 2**20)
    assert lanes(2000, 1, samples=100) == (512, 512)


@pytest.mark.parametrize("name", ["elastic, errors, out of steps", "rigid, a suite in one table"])
def test_a_program_for_accelerators_uses_supported_operations(name):
    """The program uses float64 throughout, no custom calls and no callbacks to the CPU."""
    podium, motion, how, _ = CASES[name]
    executor = DeviceExecutor(jax.local_devices()[:1])
    executor.platform = "cuda"
    scenes, _ = broadcast("", podium, motion, rj.State(), None)
    plan = layout(scenes, executor)
    assert plan.lanes >= 1024
    leaves, numbers = scenes.leaves_of_chunk(SceneIndices(0, 1, scenes.total), plan.size), np.zeros(1, int)
    program = _on_mesh(executor.mesh).trace(
        idle_lanes(scenes, how, plan), leaves, numbers, 1, numbers, 0, how, layout=plan
    )
    text = program.lower(lowering_platforms=("cuda",)).as_text()
    assert "stablehlo.while" in text
    assert set(re.findall(r"tensor<(?:\d+x)*(\w+)>", text)) <= {"f64", "i64", "i32", "i1"}
    assert "custom_call" not in text


GPUS = [] if jax.default_backend() == "cpu" else jax.local_devices()
on_a_gpu = pytest.mark.skipif(not GPUS, reason="no GPU here")


@on_a_gpu
@pytest.mark.parametrize("name", CASES)
def test_gpus_answer_as_threads_do(name):
    podium, motion, how, _ = CASES[name]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "[0-9]+ of .* scenes did not finish", RuntimeWarning)
        there, here = (rj.peak_responses(podium, motion, options=how, threads=k) for k in (None, 2))
    np.testing.assert_array_equal(there.overturned, here.overturned)
    np.testing.assert_allclose(there.peak_rotation, here.peak_rotation, atol=1e-7)


@on_a_gpu
@pytest.mark.parametrize("name", ["rigid", "elastic"])
def test_a_gpu_has_the_derivatives_of_a_cpu(name):
    def ask(a_p):
        return rj.peak_response(PODIUMS[name], rj.Ricker(a_p, 1.0)).peak_rotation

    device_results = []
    for device in (GPUS[0], jax.local_devices(backend="cpu")[0]):
        with jax.default_device(device):
            device_results.append([float(y) for y in jax.jit(jax.value_and_grad(ask))(2.5 * G * 0.15)])
    np.testing.assert_allclose(*device_results, rtol=1e-6)


if __name__ == "__main__":
    print(json.dumps(report()))
