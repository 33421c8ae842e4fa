"""Overturning under Gaussian motions counted by a sweep: `python -m benchmarks.risk_sweep MOTIONS STORE`.

Every motion is one scene for each density: the same u, scaled. Stopped at any moment, the same command goes
on. What is counted, and what it took, is kept as a table.
"""

from __future__ import annotations

import os
import resource
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import rockjax as rj
from rockjax._risk.structure import OPTIONS

from .measure import keep, show
from .risk import BLOCK, CASES, motion_of

COUNTED = ("block 1e-4", "block 1e-5")
BLOCKS = 100_000  # motions that are drawn at once


def scenes(motions: int) -> rj.Record:
    """So many motions times the densities of the cases, shape (motions, densities)."""
    first = motion_of(CASES[COUNTED[0]])
    samples = np.empty((motions, 1, first.n))
    for k, start in enumerate(range(0, motions, BLOCKS)):
        size = min(BLOCKS, motions - start)
        u = np.random.default_rng([13, k]).standard_normal((size, first.dimension))
        samples[start : start + size, 0] = first.acceleration(jnp.asarray(u))
    # Motions are linear in √S₀.
    scale = np.sqrt([CASES[name].S_0 / CASES[COUNTED[0]].S_0 for name in COUNTED])
    return rj.Record(samples, first.dt, scale)


def main(motions: int, store: Path) -> None:
    before = os.times()
    data = rj.sweep(
        BLOCK,
        scenes(motions),
        ["motion", "density"],
        store=store,
        options=OPTIONS,
        outputs=("margin",),
        progress=sys.stderr.isatty(),
    )
    after = os.times()
    assert not isinstance(data, rj.SweepPlan)
    result = data["result"].to_numpy()
    shared = {
        "scenes": result.size,
        "cpu s": after.user + after.system - before.user - before.system,
        "peak memory [MiB]": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10,
        "disk [MiB]": sum(file.stat().st_size for file in store.rglob("*") if file.is_file()) / 2**20,
        "chunks": int(np.prod([len(sizes) for sizes in data["margin"].chunks or ()])),
        "without an answer": int((result > 2).sum()),
    }
    rows = [
        {"case": name, "motions": motions, "failures": int((result[:, k] == 2).sum())} | shared
        for k, name in enumerate(COUNTED)
    ]
    keep("risk-sweep", rows)
    show(rows, {key: "" if isinstance(y, str) else ".0f" for key, y in rows[0].items()})


if __name__ == "__main__":
    main(int(float(sys.argv[1])), Path(sys.argv[2]))
