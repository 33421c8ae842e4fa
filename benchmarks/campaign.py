"""What a stress campaign keeps, so that it can be stopped at any moment and gone on with.

Every batch of scenes is a `rockjax.sweep` into a store of its own name: scenes come from a seed, so the same
call finds the same store, verifies what is in it and solves what is missing. What is worked out besides is a
JSON file each, written when it is whole. A report is made from the folder alone.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

import rockjax as rj
from rockjax._sweep.store import Store

Answers = dict[str, np.ndarray]
CHUNK = 65536  # scenes: as much as a stop costs at most; with fewer, all wait more often for the slowest
SCALES = 256  # of a scan below a boundary
HIGHEST = 10.0  # scale that is looked at
PART = 8  # boundaries that are found together


class Kept:
    """A folder with the stores of a campaign."""

    def __init__(self, folder: Path):
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def solve(self, name: str, scenes: tuple[rj.Podium, rj.AbstractExcitation], **more: Any) -> Answers:
        """Answers of some scenes as named arrays, solved unless they are kept."""
        data = rj.sweep(*scenes, store=self.folder / f"{name}.zarr", chunk=CHUNK, progress=False, **more)
        assert not isinstance(data, rj.SweepPlan)
        return {str(key): np.asarray(values) for key, values in data.data_vars.items()}

    def whole(self, name: str) -> bool:
        """Whether all scenes of this name are solved."""
        found = Store.open(self.folder / f"{name}.zarr")
        return found is not None and bool(np.isfinite(found.rows()[:, 0]).all())

    def remember(self, name: str, work: Callable[[], Any]) -> Any:
        """What `work` returns, worked out unless it is kept; anything that JSON can hold."""
        path = self.folder / f"{name}.json"
        if not path.exists():
            beside = path.with_suffix(".part")
            beside.write_text(json.dumps(work()))
            os.replace(beside, path)
        return json.loads(path.read_text())


def scan(kept: Kept, name: str, podium: rj.Podium, record: rj.Record) -> dict[str, int]:
    """Overturning boundaries of structures on records, and scans of the scales below them.

    `missed`: boundaries below which a scale of the scan overturns.
    """
    count = len(np.asarray(podium.alpha))

    def part(first: int) -> list[float]:
        some = slice(first, min(first + PART, count))
        pick = lambda y: y[some] if np.ndim(y) and np.shape(y)[0] == count else y
        columns, motion = jax.tree.map(pick, podium), (np.asarray(y)[some] for y in (record.dt, record.scale))
        one = lambda podium, dt, scale: rj.overturning_scale(
            podium, rj.Record(record.acceleration, dt, scale), max_scale=HIGHEST
        )
        axes = jax.tree.map(lambda y: 0 if np.ndim(y) else None, columns)
        return np.asarray(jax.vmap(one, in_axes=(axes, 0, 0))(columns, *motion)).tolist()

    found = np.concatenate(
        [kept.remember(f"{name}-{first}", lambda first=first: part(first)) for first in range(0, count, PART)]
    )
    # Below each boundary, or up to the highest scale where there is none; not so close that rounding decides.
    top = np.where(np.isfinite(found), found * (1 - 1e-6), HIGHEST)
    scales = np.linspace(0.0, 1.0, SCALES + 1)[1:]
    across = lambda y: y[:, None] if np.ndim(y) else y
    motion = rj.Record(
        record.acceleration, np.asarray(record.dt)[:, None], np.asarray(record.scale * top)[:, None] * scales
    )
    answers = kept.solve(
        f"{name}-scan", (jax.tree.map(across, podium), motion), options=rj.Options(outputs=("peak_rotation",))
    )
    below = answers["overturned"].astype(bool).any(axis=1)
    return {
        "boundaries": count,
        "found": int(np.isfinite(found).sum()),
        "missed": int(below.sum()),
        "scanned": below.size * SCALES,
    }
