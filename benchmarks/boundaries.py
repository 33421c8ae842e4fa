"""Test of the search for overturning boundaries: does it miss overturning windows?

`python -m benchmarks.boundaries [number of motions] [structure …] [--records FOLDER] [--store FOLDER]`

For each structure and each motion, responses are computed at scales in steps of `WIDTH`/4 times the range,
from the last scale without uplift to the first wide overturning window. The width of each window is measured.
Then `rockjax.overturning_boundary` finds the boundary. No window below the boundary may be wider than its
`certain_width`, and the structure must overturn just above it. Half of the synthetic motions have a velocity
pulse, and some are pulses alone. `--records` uses the records of a folder instead (text with times and
accelerations in any unit, because the range is relative to PGA), cut to 1000 samples around the peak.

The responses do not depend on the search. `--store` saves them in a folder, one file for each structure and
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

WIDTH = 1e-4  # requested width of the search, divided by the range
SCALE_STEP = 0.25 * WIDTH  # step between scales, divided by the range
OVERTURNING_RUN = 64  # number of successive overturning scales that end the scan of a record
BLOCK = 4096  # number of scales in a batch
INSIDE = 200  # number of scales within a step if the outcome differs between its ends
RANGE = 10.0  # PGA at the end of the range of scales, divided by g tan α
COARSE = 256  # number of scales in the search for uplift
SCAN = rj.Options(rtol=1e-7, atol=1e-9, method="tsit5", outputs=("margin",))
CLOSE_MARGIN = 0.02  # scenes with a smaller absolute margin are solved again with `SHARP`
SHARP = rj.Options(rtol=1e-11, atol=1e-13, outputs=("margin",))  # the accuracy of a boundary
SAMPLES_BEFORE_PEAK, SAMPLES = 400, 1000  # numbers of samples of a record before its peak, and in total
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
    """Return synthetic motions of 10 s at 0.02 s: noise, noise with a pulse, and every fifth a pulse alone.

    The noise has a PGA of 1 m/s².
    """
    pulses = [rj.MavroeidisPapageorgiou(0.15, *SHAPES[k % len(SHAPES)]) for k in range(count)]
    plain = rj.synthetic_motions(count, seed=11, duration=10.0, dt=0.02, pga=1.0)
    mixed = rj.synthetic_motions(count, seed=12, duration=10.0, dt=0.02, pga=1.0, pulse=pulses)
    alone = rj.synthetic_motions(count, seed=13, duration=10.0, dt=0.02, pga=1e-6, pulse=pulses)
    return rj.Records.of([(alone if k % 5 == 4 else mixed if k % 2 else plain)[k] for k in range(count)])


def read_records(folder: Path, count: int) -> rj.Records:
    """Return the records in a folder, cut around their peaks."""
    shortened = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rj.RecordWarning)  # the unit is not known, so the PGA may be unusual
        suite = rj.read_suite(folder, units="m/s2", pattern="*.dat")
    for motion in suite:
        samples = np.asarray(motion.acceleration)
        first = max(0, int(np.argmax(np.abs(samples))) - SAMPLES_BEFORE_PEAK)
        shortened.append(rj.Record(samples[first : first + SAMPLES], motion.dt))
    return rj.Records.of(shortened[:count])


def overturns(podium: rj.Podium, records: rj.Records, j: int, scales: np.ndarray) -> np.ndarray:
    """Return a mask of the scales of record j that overturn; doubtful scales are solved with `SHARP`."""
    results = peaks(podium, records, j, scales, SCAN)
    overturned = np.array(results.overturned)
    close = np.flatnonzero(np.abs(np.asarray(results.margin)) < CLOSE_MARGIN)
    if close.size:
        overturned[close] = np.asarray(peaks(podium, records, j, scales[close], SHARP).overturned)
    return overturned


def peaks(podium: rj.Podium, records: rj.Records, j: int, scales: np.ndarray, options: rj.Options) -> rj.Peak:
    """Return the peaks under record j at some scales."""
    motion = records.pick(np.full(scales.size, j, np.int32)).scaled(scales)
    return rj.peak_responses(podium, motion, options=options)


def largest_resting_scale(podium: rj.Podium, records: rj.Records, j: int, end: float) -> float:
    """Return the largest of `COARSE` scales at which the columns do not lift.

    Without uplift, forces are proportional to the scale, so columns do not lift at smaller scales either.
    """
    scales = np.linspace(0.0, end, COARSE)
    uplifted = np.asarray(peaks(podium, records, j, scales, SCAN).uplifted)
    return float(scales[np.argmax(uplifted) - 1] if uplifted.any() else end)


def scan_windows(podium: rj.Podium, records: rj.Records, j: int, limit: float) -> dict:
    """Scan record j for overturning windows, up to the first wide window, whose end is not searched.

    Returns the `windows` as (start, end), the number of scenes and the CPU time.
    """
    start = time.process_time()
    scales = np.arange(largest_resting_scale(podium, records, j, limit), limit, SCALE_STEP * limit)
    overturned = np.zeros(0, bool)
    for first in range(0, scales.size, BLOCK):
        overturned = np.append(overturned, overturns(podium, records, j, scales[first : first + BLOCK]))
        run_lengths = np.convolve(overturned, np.ones(OVERTURNING_RUN), mode="valid")
        wide = np.flatnonzero(run_lengths > OVERTURNING_RUN - 0.5)
        if wide.size:
            overturned = overturned[: wide[0] + OVERTURNING_RUN]
            break
    edges = windows(podium, records, j, scales[: overturned.size], overturned)
    return {"windows": edges, "scenes": int(overturned.size), "cpu_s": time.process_time() - start}


def windows(
    podium: rj.Podium, records: rj.Records, j: int, scales: np.ndarray, overturned: np.ndarray
) -> list[list[float]]:
    """Return the (start, end) of each overturning window among ascending scales of record j."""
    changes = np.flatnonzero(np.diff(np.concatenate([[False], overturned, [False]]).astype(int)))
    edges = []
    for change in changes:
        lo, hi = scales[max(change - 1, 0)], scales[min(change, scales.size - 1)]
        finer = np.linspace(lo, hi, INSIDE)
        change_in = np.flatnonzero(np.diff(overturns(podium, records, j, finer).astype(int)))
        edges.append(float(finer[change_in[0]] if change_in.size else lo))
    return [edges[k : k + 2] for k in range(0, len(edges), 2)]


def cached(path: Path, work: Callable[[], Any]) -> Any:
    """Return the JSON value that `work` returns, from a file if it exists; otherwise write the file."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_suffix(".part")
        unfinished.write_text(json.dumps(work()))
        os.replace(unfinished, path)
    return json.loads(path.read_text())


def scan_all(
    name: str, source: str, records: rj.Records, limits: np.ndarray, store: Path | None
) -> list[dict]:
    """Return `scan_windows` of all records, stored in a folder."""
    podium, rows = STRUCTURES[name], []
    for j, limit in enumerate(map(float, limits)):
        work = lambda j=j, limit=limit: scan_windows(podium, records, j, limit)
        if store is None:
            rows.append(work())
            continue
        parameters = [
            *jax.tree.leaves(podium),
            *jax.tree.leaves(records.pick(np.int32(j))),
            limit,
            SCALE_STEP,
            OVERTURNING_RUN,
        ]
        digest = hashlib.sha256(b"".join(np.asarray(y, float).tobytes() for y in parameters)).hexdigest()[:12]
        words = "".join(letter if letter.isalnum() else "-" for letter in f"{name}-{source}")
        rows.append(cached(store / f"{words}-{j}-{digest}.json", work))
    return rows


def compare_search(name: str, source: str, records: rj.Records, store: Path | None) -> dict:
    """Return the table row that compares the boundaries of a search with all windows below them. `standing`
    is the number of motions under which the structure stands just above the boundary."""
    podium = STRUCTURES[name]
    limits = (
        RANGE * float(podium.g) * math.tan(float(podium.alpha)) / np.asarray(records.magnitudes()).max(axis=1)
    )
    truth = scan_all(name, source, records, limits, store)
    start = time.process_time()

    def search(index, limit):
        return rj.overturning_boundary(podium, records.pick(index), max_scale=limit, width=WIDTH)

    boundary = jax.vmap(search)(np.arange(len(records), dtype=np.int32), limits)
    seconds = time.process_time() - start
    scale, certain = np.asarray(boundary.scale), np.asarray(boundary.certain_width)
    below, doubtful = [], []
    for j, limit in enumerate(limits):
        # A window that starts above this scale is the boundary itself.
        highest_start = scale[j] - SCALE_STEP * limit / (INSIDE - 1)
        for lo, hi in truth[j]["windows"]:
            hi = min(hi, scale[j])  # the window may contain the boundary
            if lo < highest_start:
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
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("motions", nargs="?", type=int, default=40)
    parser.add_argument("structures", nargs="*", help=", ".join(STRUCTURES))
    parser.add_argument(
        "--records", type=Path, help="a folder of records, *.dat, instead of synthetic motions"
    )
    parser.add_argument("--store", type=Path, help="a folder in which the windows are stored")
    arguments = parser.parse_args()
    source = "synthetic" if arguments.records is None else "recorded"
    records = (
        motions(arguments.motions)
        if arguments.records is None
        else read_records(arguments.records, arguments.motions)
    )
    path = RESULTS / "boundaries.json"
    rows = json.loads(path.read_text())["rows"] if path.exists() else []
    for name in arguments.structures or STRUCTURES:
        others = [row for row in rows if (row["structure"], row["source"]) != (name, source)]
        rows = [*others, compare_search(name, source, records, arguments.store)]
        store_rows("boundaries", rows)
    show(rows, [name for name in rows[0] if name != "windows"])


if __name__ == "__main__":
    main()
