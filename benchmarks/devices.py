"""Accelerators, or the devices that JAX has, against the cores of this machine: `python -m
benchmarks.devices`.

The same scenes by the threads of a process that JAX runs on the CPU, and by all devices of one where it
chooses itself: scenes a second over the size of the batch, and how far the answers are apart, in float64.

Without an accelerator `--host-devices 2` takes so many parts of the CPU instead, which shows that it runs and
no more.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import rockjax as rj

from .families import family
from .measure import keep, options, podium, shortest, show

POINTS = (100, 316, 1000)  # along both axes
FAMILIES = ("rigid", "T_s = 0.5 s")


def measure(path: Path, devices: bool) -> None:
    """Times and answers of all batches, into a file."""
    import jax

    found: dict[str, Any] = {
        "name": f"{len(jax.local_devices())} × {jax.local_devices()[0].device_kind}" if devices else "threads"
    }
    for name in FAMILIES:
        structure, how = podium(family(name, 2)), options(1e-8)
        for points in POINTS:
            scenes = family(name, points)
            motions = rj.Ricker(scenes.a_p, scenes.T_p)
            who: dict[str, Any] = {"devices": jax.local_devices()} if devices else {}
            solve = lambda: rj.peak_responses(structure, motions, options=how, **who)  # noqa: B023
            found[f"{name} {points} s"] = shortest(solve, 2)
            peaks = solve()
            found[f"{name} {points} peaks"] = peaks.peak_rotation
            found[f"{name} {points} overturned"] = peaks.overturned
    np.savez(path, **found)


def run(folder: Path, devices: bool, environment: dict[str, str]) -> Any:
    path = folder / f"{'devices' if devices else 'threads'}.npz"
    command = [
        sys.executable,
        "-m",
        "benchmarks.devices",
        "--into",
        str(path),
        "devices" if devices else "threads",
    ]
    subprocess.run(command, check=True, env=os.environ | environment)
    return np.load(path)


def main() -> None:
    arguments = sys.argv[1:]
    if arguments[:1] == ["--into"]:
        measure(Path(arguments[1]), arguments[2] == "devices")
        return
    parts = arguments[1] if arguments[:1] == ["--host-devices"] else ""
    more = {"JAX_PLATFORMS": "cpu", "JAX_NUM_CPU_DEVICES": parts} if parts else {}
    with tempfile.TemporaryDirectory() as name:
        here = run(Path(name), False, {"JAX_PLATFORMS": "cpu"})
        there = run(Path(name), True, more)
        rows = []
        for label in FAMILIES:
            for points in POINTS:
                key = f"{label} {points}"
                same = here[f"{key} overturned"] == there[f"{key} overturned"]
                apart = np.abs(here[f"{key} peaks"] - there[f"{key} peaks"])[same]
                a, b = float(here[f"{key} s"]), float(there[f"{key} s"])
                rows.append(
                    {
                        "family": label,
                        "scenes": points**2,
                        "threads [1/s]": points**2 / a,
                        "devices [1/s]": points**2 / b,
                        "ratio": a / b,
                        "apart": float(apart.max()),
                        "other class": int((~same).sum()),
                    }
                )
        print(f"devices: {there['name']}")
        formats = {
            "family": "",
            "scenes": "d",
            "threads [1/s]": ".0f",
            "devices [1/s]": ".0f",
            "ratio": ".2f",
            "apart": ".1e",
        }
        show(rows, formats | {"other class": "d"})
        if not parts:
            keep("devices", [row | {"devices": str(there["name"])} for row in rows])


if __name__ == "__main__":
    main()
