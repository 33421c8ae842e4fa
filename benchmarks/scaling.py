"""Cost per scene and memory from 10³ to 10⁶ scenes: `python -m benchmarks.scaling`."""

from __future__ import annotations

import resource
import time

import jax
import numpy as np

import rockjax as rj
from rockjax._batch.batch import run_batch
from rockjax._batch.scenes import broadcast

from .families import family
from .measure import keep, options, podium, show


def resident() -> float:
    """Largest resident size so far [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    rows = []
    for name in ("rigid", "T_s = 0.5 s"):
        structure, how = podium(family(name, 2)), options(1e-8)
        for points in (32, 100, 316, 1000):
            scenes = family(name, points)
            motions = rj.Ricker(scenes.a_p, scenes.T_p)
            if points == 32:
                rj.peak_responses(structure, motions, options=how)  # compiles
            before = resident()
            batch, _ = broadcast("scaling", structure, motions, jax.tree.map(np.asarray, rj.State()), None)
            best = np.inf
            for _ in range(1 if points == 1000 else 3):
                began = time.perf_counter()
                _, _, tally = run_batch(batch, how, False)
                best = min(best, time.perf_counter() - began)
            row = {"family": name, "scenes": len(scenes), "us": best / len(scenes) * 1e6}
            rows.append(
                row | {"occupancy": tally.useful / tally.possible, "growth [MiB]": resident() - before}
            )
            print(rows[-1], flush=True)
    keep("scaling", rows)
    show(rows, {"family": "", "scenes": "d", "us": ".2f", "occupancy": ".3f", "growth [MiB]": ".0f"})


if __name__ == "__main__":
    main()
