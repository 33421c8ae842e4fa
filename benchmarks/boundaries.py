"""Test of the search for overturning boundaries: does it miss windows of overturning?

`python -m benchmarks.boundaries [number of motions] [structure …] [--records FOLDER] [--store FOLDER]`

For each structure and each motion, plain responses are computed at scales a quarter of `WIDTH` of the range
apart, from the last scale without uplift to the first wide window of overturning. The width of each window
is measured. Then the boundary is searched as users do. No window below it may be wider than `certain_width`,
and the structure must overturn just above it. Half of the synthetic motions have a velocity pulse, and some
are pulses alone. `--records` uses the records of a folder instead (text with times and accelerations in any
unit, because the range is in terms of PGA), cut to 1000 samples from 400 before their peak.

The responses do not depend on the search. `--store` keeps them in a folder, one file for each structure and
motion. The same command continues an interrupted run, and another search can be compared with stored
responses.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

import rockjax as rj

from .measure import RESULTS, show, store_rows

WIDTH = 1e-4  # of the range
SCALE_STEP = 0.25 * WIDTH  # from one scale that is tried to the next
OVERTURNING_RUN = 64  # scales in a row that overturn: what is above them is no window any more
BLOCK = 4096  # scales that are tried at once
INSIDE = 200  # scales in a step at whose ends the outcome changes
RANGE = 10.0  # scales up to so many g tan α over PGA
COARSE = 256  # scales that tell from where on the columns lift
LOOKING = rj.Options(rtol=1e-7, atol=1e-9, method="tsit5", outputs=("margin",))
CLOSE_MARGIN = 0.02  # a margin as small is worked out again …
SHARP = rj.Options(rtol=1e-11, atol=1e-13, outputs=("margin",))  # … at the accuracy of a boundary
SAMPLES_BEFORE_PEAK, SAMPLES = 400, 1000  # of a record: so many before its peak, and altogether
SLENDER, STOCKY = math.atan(0.15), 0.25
STRUCTURES = {
    "solitary column": rj.Podium(0.2, 1.0),
    "large column": rj.Podium(STOCKY, 4.0),
    "rocking frame": rj.Podium(SLENDER, 1.5, 4.0),
    "podium, rigid": rj.Podium(SLENDER, 1.5, 10.0, rj.Rigid(50.0)),
    "podium, T_s = 0.2 s": rj.Podium(SLENDER, 1.5, 10.0, rj.Elastic(50.0, 0.2, 0.05)),
    "podium, T_s = 0.8 s": rj.Podium(0.2, 2.0, 10.0, rj.Elastic(100.0, 0.8, 0.05)),
}
SHAPES = [
    (f_p, gamma, nu) for f_p in (0.5, 1.0, 1.6) for gamma, nu in ((1.2, 0.0), (2.0, math.pi / 2), (3.0, 1.0))
]


def motions(count: int) -> rj.Records:
    """Noise, noise with a pulse, and a pulse alone in every fifth place; 10 s at 0.02 s, PGA 1 m/s² of the
    noise."""
    pulses = [rj.MavroeidisPapageorgiou(0.15, *SHAPES[k % len(SHAPES)]) for k in range(count)]
    plain = rj.synthetic_motions(count, seed=11, duration=10.0, dt=0.02, pga=1.0).records()
    mixed = rj.synthetic_motions(count, seed=12, duration=10.0, dt=0.02, pga=1.0, pulse=pulses).records()
    alone = rj.synthetic_motions(count, seed=13, duration=10.0, dt=0.02, pga=1e-6, pulse=pulses).records()
    return rj.Records.of([(alone if k % 5 == 4 else mixed if k % 2 else plain)[k] for k in range(count)])


def read_records(folder: Path, count: int) -> rj.Records:
    """The records in a folder, around their peaks."""
    cut = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rj.RecordWarning)  # of PGA in another unit
        suite = rj.read_suite(folder, units="m/s2", pattern="*.dat")
    for motion in suite:
        samples = np.asarray(motion.acceleration)
        first = max(0, int(np.argmax(np.abs(samples))) - SAMPLES_BEFORE_PEAK)
        cut.append(rj.Record(samples[first : first + SAMPLES], motion.dt))
    return rj.Records.of(cut[:count])


def overturns(podium: rj.Podium, records: rj.Records, j: int, scales: np.ndarray) -> np.ndarray:
    """Whether scales of one record overturn; those that are close to it at the full accuracy."""
    results = peaks(podium, records, j, scales, LOOKING)
    over = np.array(results.overturned)
    near = np.flatnonzero(np.abs(np.asarray(results.margin)) < CLOSE_MARGIN)
    if near.size:
        over[near] = np.asarray(peaks(podium, records, j, scales[near], SHARP).overturned)
    return over


def peaks(podium: rj.Podium, records: rj.Records, j: int, scales: np.ndarray, options: rj.Options) -> rj.Peak:
    """Of one record at some scales."""
    motion = records.pick(np.full(scales.size, j, np.int32)).scaled(scales)
    return rj.peak_responses(podium, motion, options=options)


def largest_resting_scale(podium: rj.Podium, records: rj.Records, j: int, end: float) -> float:
    """The last of some coarse scales that lifts nothing: columns at rest feel the motion in proportion."""
    scales = np.linspace(0.0, end, COARSE)
    uplifted = np.asarray(peaks(podium, records, j, scales, LOOKING).uplifted)
    return float(scales[np.argmax(uplifted) - 1] if uplifted.any() else end)


def scan_windows(podium: rj.Podium, records: rj.Records, j: int, limit: float) -> dict:
    """What plain responses tell about one record: `windows` of overturning, (from, to), up to the first wide
    one, whose end is not looked for."""
    began = time.process_time()
    scales = np.arange(largest_resting_scale(podium, records, j, limit), limit, SCALE_STEP * limit)
    over = np.zeros(0, bool)
    for first in range(0, scales.size, BLOCK):
        over = np.append(over, overturns(podium, records, j, scales[first : first + BLOCK]))
        in_a_row = np.convolve(over, np.ones(OVERTURNING_RUN), mode="valid")
        wide = np.flatnonzero(in_a_row > OVERTURNING_RUN - 0.5)
        if wide.size:
            over = over[: wide[0] + OVERTURNING_RUN]
            break
    found = windows(podium, records, j, scales[: over.size], over)
    return {"windows": found, "scenes": int(over.size), "cpu_s": time.process_time() - began}


def windows(
    podium: rj.Podium, records: rj.Records, j: int, scales: np.ndarray, overturned: np.ndarray
) -> list[list[float]]:
    """Beginnings and ends of the windows that overturn among ascending scales of one record."""
    changes = np.flatnonzero(np.diff(np.concatenate([[False], overturned, [False]]).astype(int)))
    edges = []
    for change in changes:
        lo, hi = scales[max(change - 1, 0)], scales[min(change, scales.size - 1)]
        finer = np.linspace(lo, hi, INSIDE)
        at = np.flatnonzero(np.diff(overturns(podium, records, j, finer).astype(int)))
        edges.append(float(finer[at[0]] if at.size else lo))
    return [edges[k : k + 2] for k in range(0, len(edges), 2)]


def cached(path: Path, work: Callable[[], Any]) -> Any:
    """Return what `work` returns, from the file if it is there; anything that JSON can hold."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_suffix(".part")
        unfinished.write_text(json.dumps(work()))
        os.replace(unfinished, path)
    return json.loads(path.read_text())


def scan_all(
    name: str, source: str, records: rj.Records, limits: np.ndarray, store: Path | None
) -> list[dict]:
    """`scan_windows` of all records, from a folder where it is kept."""
    podium, rows = STRUCTURES[name], []
    for j, limit in enumerate(map(float, limits)):
        work = lambda j=j, limit=limit: scan_windows(podium, records, j, limit)
        if store is None:
            rows.append(work())
            continue
        numbers = [
            *jax.tree.leaves(podium),
            *jax.tree.leaves(records.pick(np.int32(j))),
            limit,
            SCALE_STEP,
            OVERTURNING_RUN,
        ]
        digest = hashlib.sha256(b"".join(np.asarray(y, float).tobytes() for y in numbers)).hexdigest()[:12]
        words = "".join(letter if letter.isalnum() else "-" for letter in f"{name}-{source}")
        rows.append(cached(store / f"{words}-{j}-{digest}.json", work))
    return rows


def compare_search(name: str, source: str, records: rj.Records, store: Path | None) -> dict:
    """A row of the table: the boundaries that a search finds, against all scales below them."""
    podium = STRUCTURES[name]
    limits = RANGE * float(podium.g) * math.tan(float(podium.alpha)) / np.asarray(records.sizes()).max(axis=1)
    truth = scan_all(name, source, records, limits, store)
    began = time.process_time()

    def search(which, limit):
        return rj.overturning_boundary(podium, records.pick(which), max_scale=limit, width=WIDTH)

    found = jax.vmap(search)(np.arange(len(records), dtype=np.int32), limits)
    seconds = time.process_time() - began
    scale, certain = np.asarray(found.scale), np.asarray(found.certain_width)
    below, doubtful = [], []
    for j, limit in enumerate(limits):
        top = scale[j] - SCALE_STEP * limit / (INSIDE - 1)  # what begins closer is the boundary itself
        for lo, hi in truth[j]["windows"]:
            hi = min(hi, scale[j])  # scales between that survive are not seen where they are closer
            if lo < top:
                below.append(
                    {"motion": j, "from": lo, "width": (hi - lo) / limit, "boundary": float(scale[j])}
                    | {"wider": bool(hi - lo > certain[j])}
                )
        if np.isfinite(scale[j]) and not overturns(podium, records, j, scale[j : j + 1] * (1 + 1e-10)).all():
            doubtful.append(j)
    return {
        "structure": name,
        "source": source,
        "motions": len(records),
        "overturned": int(np.isfinite(scale).sum()),
        "certain_to": float(np.max(certain / limits)),
        "scenes_tried": sum(row["scenes"] for row in truth),
        "windows": below,
        "narrower": sum(not window["wider"] for window in below),
        "missed": sum(window["wider"] for window in below),
        "standing": len(doubtful),
        "cpu_s_search": seconds,
        "cpu_s_trials": sum(row["cpu_s"] for row in truth),
    }


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("motions", nargs="?", type=int, default=40)
    arguments.add_argument("structures", nargs="*", help=", ".join(STRUCTURES))
    arguments.add_argument(
        "--records", type=Path, help="a folder of records, *.dat, to take instead of synthetic ones"
    )
    arguments.add_argument("--store", type=Path, help="a folder that keeps what the scales tell")
    given = arguments.parse_args()
    source = "synthetic" if given.records is None else "recorded"
    records = motions(given.motions) if given.records is None else read_records(given.records, given.motions)
    path = RESULTS / "boundaries.json"
    rows = json.loads(path.read_text())["rows"] if path.exists() else []
    for name in given.structures or STRUCTURES:
        others = [row for row in rows if (row["structure"], row["source"]) != (name, source)]
        rows = [*others, compare_search(name, source, records, given.store)]
        store_rows("boundaries", rows)
    show(rows, [name for name in rows[0] if name != "windows"])


if __name__ == "__main__":
    main()
