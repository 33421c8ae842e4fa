"""Run time of a scene: `python -m benchmarks.cost COMMAND`, with a command from the next paragraph.

`motions` solves the grid of Fig. 6 with several pulse shapes. `restrained` compares podiums that have a
tendon and a linear damper with the same podiums without devices. Accelerations are relative to the uplift
threshold, so that both podiums rock alike. `forces` compares batches with and without forces in the joints,
for pulses and for records; `forces-single` compares single scenes. `floors` times floor spectra with a
thousand periods. `scaling` measures time and memory from 10³ to 10⁶ scenes. `processors` compares the devices
of JAX with threads on the CPU, including differences between the answers; without an accelerator,
`processors --host-devices 2` uses two parts of the CPU as devices.
"""

from __future__ import annotations

import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import rockjax as rj
from rockjax._batch.batch import Tally, run_batch
from rockjax._batch.scenes import SceneBatch, broadcast
from rockjax._oscillators import ground_load, largest

from .measure import Family, family, options, podium, report, shortest_time, show
from .records import DT, Suite

FAMILIES = ("rigid", "T_s = 0.5 s")
MOTIONS: dict[str, Callable[[Family], rj.AbstractExcitation]] = {
    **{
        name: lambda scenes, name=name: getattr(rj, name)(scenes.a_p, scenes.T_p)
        for name in ("Ricker", "AntisymmetricRicker", "OneSine", "OneCosine", "HalfSine")
    },
    "MavroeidisPapageorgiou": lambda scenes: rj.MavroeidisPapageorgiou(
        scenes.a_p * scenes.T_p / (2 * np.pi), 1 / scenes.T_p, 2.0, 0.3
    ),
    "Gabor": lambda scenes: rj.Gabor(scenes.a_p, scenes.T_p, 2.0, 0.3),
    "GroundMotion of two": lambda scenes: rj.GroundMotion(
        rj.OneSine(scenes.a_p, scenes.T_p), rj.OneSine(0.3 * scenes.a_p, 0.4 * scenes.T_p)
    ),
}


def motions(points: int = 100) -> None:
    rows: list[dict[str, Any]] = []
    for name in FAMILIES:
        for motion, make in MOTIONS.items():
            scenes = family(name, points)
            structure, motions, settings = podium(scenes), make(scenes), options(1e-8)
            trials = float(np.mean(rj.peak_responses(structure, motions, options=settings).stats.steps))
            solve = lambda: rj.peak_responses(structure, motions, options=settings)  # noqa: B023
            seconds = shortest_time(solve) / len(scenes)
            row = {"family": name, "motion": motion, "us": seconds * 1e6, "trials": trials}
            rows.append(row | {"ns a trial": seconds * 1e9 / trials})
            print(rows[-1], flush=True)
    report("motions", rows)


# -------------------------------------------------------------------------------- restrainers
RATIOS = np.linspace(1, 10, 100)
ALPHA = math.atan(0.15)
STRUCTURES = {
    "solitary block": rj.Podium(ALPHA, 1.5),
    "rigid": rj.Podium(ALPHA, 1.5, 10.0, rj.Rigid(100.0)),
    "elastic": rj.Podium(ALPHA, 1.5, 10.0, rj.Elastic(100.0, 0.5)),
}
PRESTRESS, STIFFNESS, DAMPING = 0.18, 0.5, 1.4  # divided by the weight per column


def time_restrained(runs: int = 7) -> None:
    cases: dict[tuple[str, bool], tuple[rj.Podium, np.ndarray]] = {}
    for name, plain in STRUCTURES.items():
        weight = float(plain.gamma + plain.eta) + 0.5
        devices = rj.Tendon(PRESTRESS * weight, STIFFNESS * weight), rj.Damper(DAMPING * weight)
        cases[name, False] = plain, RATIOS
        cases[name, True] = plain.replace(restrainers=devices), RATIOS * (1 + PRESTRESS)

    def spectrum(case: tuple[rj.Podium, np.ndarray]):
        settings = rj.Options(outputs=("peak_rotation",))
        return rj.rocking_spectrum(case[0], rj.Ricker, RATIOS, case[1], options=settings)

    def seconds(case: tuple[rj.Podium, np.ndarray]) -> float:
        start = time.perf_counter()
        spectrum(case)
        return time.perf_counter() - start

    trials = {key: float(spectrum(case).steps.mean()) for key, case in cases.items()}
    best = dict.fromkeys(cases, math.inf)
    for _ in range(runs):  # the cases alternate, so that other load of the machine affects all of them
        best = {key: min(best[key], seconds(case)) for key, case in cases.items()}
    rows = [
        {
            "structure": name,
            "steps without": trials[name, False],
            "with": trials[name, True],
            "µs a scene without": 1e6 * best[name, False] / RATIOS.size**2,
            "restrained": 1e6 * best[name, True] / RATIOS.size**2,
            "ratio": best[name, True] / best[name, False],
        }
        for name in STRUCTURES
    ]
    report("restrained", rows)


# -------------------------------------------------------------------------------- forces
FORCES = "peak_friction", "axial_force", "peak_foundation_shear", "impact_friction"


def _structures() -> dict[str, rj.Podium]:
    """Return the structures with positions of two columns and heights of the masses."""
    structures = {}
    for name, plain in STRUCTURES.items():
        heights = {} if plain.superstructure is None else {"top_height": 9.0}
        elevation = rj.Elevation([-3.0, 3.0], beam_depth=0.6, **heights)
        structures[name] = plain if name == "solitary block" else plain.replace(elevation=elevation)
    return structures


def _uplift(structure: rj.Podium) -> float:
    """Return the ground acceleration that lifts a rigid structure [m/s²]."""
    return float(structure.g * jnp.tan(structure.alpha))


def time_single_scenes(runs: int = 15) -> None:
    """Time single scenes with the default outputs, and with all forces as additional outputs."""
    suite, rows = Suite(), []
    outputs = rj.Options().outputs
    selections = {"without": outputs, "with all": (*outputs, *FORCES)}
    for name, structure in _structures().items():
        levels, periods = _uplift(structure) * np.array([1.5, 3.0, 5.0]), (0.5, 1.0, 2.0)
        pulses = [rj.Ricker(level, period) for level in levels for period in periods]
        records = [
            rj.Record(row, DT, level / np.abs(row).max()) for row in suite.samples[:3] for level in levels
        ]
        for motions, excitations in (("pulses", pulses), ("records", records)):
            best = np.full((len(selections), len(excitations)), np.inf)
            for run in range(runs + 1):
                for i, selection in enumerate(selections.values()):
                    for k, excitation in enumerate(excitations):
                        start = time.perf_counter()
                        options = rj.Options(outputs=selection)
                        jax.block_until_ready(rj.peak_response(structure, excitation, options=options))
                        if run:  # the first run compiles
                            best[i, k] = min(best[i, k], time.perf_counter() - start)
            ratios = best[1] / best[0]
            row = {"structure": name, "motions": motions, "ms without": 1e3 * float(best[0].mean())}
            row |= {"mean ratio": float(best[1].sum() / best[0].sum()), "largest ratio": float(ratios.max())}
            rows.append(row)
            print(row, flush=True)
    report("forces-single", rows)


def time_forces(runs: int = 5) -> None:
    """Time batches with the default outputs, and with forces as additional outputs."""
    cases: dict[tuple[str, str], tuple[rj.Podium, Any]] = {}
    suite = Suite()
    for name, structure in _structures().items():
        pulses = rj.Ricker(_uplift(structure) * np.linspace(1, 6, 40)[:, None], np.geomspace(0.2, 3, 40))
        cases[name, "40 × 40 Ricker pulses"] = structure, pulses
        cases[name, "20 records × 50 scales"] = structure, suite.scenes
    rows = []
    default = rj.Options().outputs
    for (name, motions), (structure, excitations) in cases.items():
        selections = {"default": default, **{force: (*default, force) for force in FORCES}}
        selections["all"] = (*default, *FORCES)
        best, trials = dict.fromkeys(selections, math.inf), {}
        for run in range(runs + 1):  # the selections alternate, so that other load affects all of them
            for key, outputs in selections.items():
                start = time.perf_counter()
                peaks = rj.peak_responses(structure, excitations, options=rj.Options(outputs=outputs))
                trials[key] = float(np.mean(peaks.stats.steps + peaks.stats.rejected))
                if run:  # the first run compiles
                    best[key] = min(best[key], time.perf_counter() - start)
        row: dict[str, Any] = {"structure": name, "motions": motions, "ms without": 1e3 * best["default"]}
        row |= {f"with {key}": best[key] / best["default"] for key in selections if key != "default"}
        rows.append(row | {"trials without": trials["default"], "trials with": trials["all"]})
        print(rows[-1], flush=True)
    report("forces", rows)


# -------------------------------------------------------------------------------- scaling
def time_floors(runs: int = 7) -> None:
    (motion,) = rj.synthetic_motions(1, seed=1, duration=20.0, dt=0.02, pga=3.0)
    building = rj.ShearBuilding.uniform(stories=3, eta=30.0, T=0.5)
    structure = rj.Podium(0.15, 1.5, 10.0, building)
    samples, rows = np.asarray(motion.acceleration), []
    for shortest in (0.05, 0.01):
        periods = np.geomspace(shortest, 5.0, 1000)
        load = ground_load(samples, float(motion.dt))
        cases = {
            "record, oscillators": lambda load=load, T=periods: largest(load, T, np.full(1000, 0.05), False),
            "story 3, scene and oscillators": lambda T=periods: rj.floor_spectrum(
                structure, motion, T, level=3
            ),
        }
        for name, solve in cases.items():
            rows.append({"floor": name, "shortest period [s]": shortest, "s": shortest_time(solve, runs)})
    report("floors", rows)


def timed_batch(batch: SceneBatch, options: rj.Options) -> tuple[float, Tally]:
    """Return the time of a batch [s] and its counts of lanes."""
    start = time.perf_counter()
    _, _, tally = run_batch(batch, options, False)
    return time.perf_counter() - start, tally


def scaling() -> None:
    peak_memory = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # [MiB]
    rows = []
    for name in FAMILIES:
        structure, settings = podium(family(name, 2)), options(1e-8)
        for points in (32, 100, 316, 1000):
            scenes = family(name, points)
            motions = rj.Ricker(scenes.a_p, scenes.T_p)
            if points == 32:
                rj.peak_responses(structure, motions, options=settings)  # compiles
            before = peak_memory()
            batch, _ = broadcast("scaling", structure, motions, jax.tree.map(np.asarray, rj.State()), None)
            runs = [timed_batch(batch, settings) for _ in range(1 if points == 1000 else 3)]
            best, tally = min(runs, key=lambda run: run[0])
            row = {"family": name, "scenes": len(scenes), "us": best / len(scenes) * 1e6}
            rows.append(
                row | {"occupancy": tally.useful / tally.possible, "growth [MiB]": peak_memory() - before}
            )
            print(rows[-1], flush=True)
    report("scaling", rows)


# -------------------------------------------------------------------------------- processors
POINTS = (100, 316, 1000)  # number of points along each axis


def time_batches(path: str, devices: str) -> None:
    """Write times and answers of all batches to a file; `devices` is "devices" to use the devices of JAX."""
    local_devices = jax.local_devices()
    results: dict[str, Any] = {"name": f"{len(local_devices)} × {local_devices[0].device_kind}"}
    device_arguments: dict[str, Any] = {"devices": local_devices} if devices == "devices" else {}
    for name in FAMILIES:
        structure, settings = podium(family(name, 2)), options(1e-8)
        for points in POINTS:
            scenes = family(name, points)
            pulses = rj.Ricker(scenes.a_p, scenes.T_p)
            solve = lambda: rj.peak_responses(structure, pulses, options=settings, **device_arguments)  # noqa: B023
            results[f"{name} {points} s"] = shortest_time(solve, 2)
            peaks = solve()
            results[f"{name} {points} peaks"] = peaks.peak_rotation
            results[f"{name} {points} overturned"] = peaks.overturned
    np.savez(path, **results)


def processors(option: str = "", count: str = "") -> None:
    """Compare CPU threads with the devices of JAX, each in a process with its own environment."""
    on_host = {"JAX_PLATFORMS": "cpu", "JAX_NUM_CPU_DEVICES": count} if option == "--host-devices" else {}
    environments = {"threads": {"JAX_PLATFORMS": "cpu"}, "devices": on_host}
    with tempfile.TemporaryDirectory() as folder:
        for case, environment in environments.items():
            path = str(Path(folder) / f"{case}.npz")
            command = [sys.executable, "-m", "benchmarks.cost", "timed", path, case]
            subprocess.run(command, check=True, env=os.environ | environment)
        threads, devices = (dict(np.load(Path(folder) / f"{case}.npz")) for case in environments)
    rows = []
    for label in FAMILIES:
        for points in POINTS:
            key = f"{label} {points}"
            same = threads[f"{key} overturned"] == devices[f"{key} overturned"]
            difference = np.abs(threads[f"{key} peaks"] - devices[f"{key} peaks"])[same]
            a, b = float(threads[f"{key} s"]), float(devices[f"{key} s"])
            row = {"family": label, "scenes": points**2, "threads [1/s]": points**2 / a}
            row |= {"devices [1/s]": points**2 / b, "ratio": a / b, "difference": float(difference.max())}
            rows.append(row | {"outcomes that differ": int((~same).sum()), "devices": str(devices["name"])})
    if on_host:
        show(rows)
    else:
        report("processors", rows)


COMMANDS = {
    "motions": motions,
    "restrained": time_restrained,
    "forces": time_forces,
    "forces-single": time_single_scenes,
    "floors": time_floors,
    "scaling": scaling,
    "processors": processors,
    "timed": time_batches,
}

if __name__ == "__main__":
    command, *arguments = sys.argv[1:]
    takes_numbers = command in ("motions", "restrained", "forces", "forces-single", "floors")
    COMMANDS[command](*(map(int, arguments) if takes_numbers else arguments))
