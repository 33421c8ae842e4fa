"""True errors on records against their estimates: `python -m benchmarks.calibration [scenes] [--records
FOLDER]`.

Random structures of ordinary proportions under synthetic records, and under those in a folder
(`benchmarks/boundaries.py` says which), at amplitudes from just above what lifts the columns to eight times
that. Each scene is solved as asked for with its error estimate and again at `TRUTH`, which stands for the
truth. Scenes whose class differs from that of the truth are counted by themselves: a peak is then no longer a
number with an error.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

import rockjax as rj
from rockjax._results import code_of

from .boundaries import motions, recorded
from .measure import keep, show

QUANTITIES = ("peak_rotation", "peak_shear")
TOLERANCES = (1e-4, 1e-6, 1e-8)
TRUTH = 1e-13
ROUNDING = 1e-12  # of a rotation over α: errors as small are those of the truth


def podiums(kind: str, n: int, rng: np.random.Generator) -> rj.Podium:
    eta = rng.uniform(1.0, 100.0, n)
    top = (
        rj.Rigid(eta)
        if kind == "rigid"
        else rj.Elastic(eta, rng.uniform(0.1, 1.5, n), rng.uniform(0.0, 0.1, n))
    )
    return rj.Podium(rng.uniform(0.08, 0.35, n), rng.uniform(0.8, 5.0, n), rng.uniform(0.0, 12.0, n), top)


def shaken(podium: rj.Podium, records: rj.Records, n: int, rng: np.random.Generator) -> rj.Records:
    """One of the records each, PGA from 0.9 to eight times what lifts the columns."""
    which = rng.integers(0, len(records), n).astype(np.int32)
    pga = np.asarray(records.sizes()).max(axis=1)[which]
    lifts = np.asarray(podium.g) * np.tan(np.asarray(podium.alpha))
    return records.pick(which).scaled(np.exp(rng.uniform(math.log(0.9), math.log(8.0), n)) * lifts / pga)


def options(rtol: float, *more: str) -> rj.Options:
    return rj.Options(rtol=rtol, atol=0.01 * rtol, outputs=(*QUANTITIES, *more))


def compared(source: str, kind: str, records: rj.Records, n: int) -> list[dict]:
    rng = np.random.default_rng([5, *f"{source} {kind}".encode()])
    podium = podiums(kind, n, rng)
    motion = shaken(podium, records, n, rng)
    truth = rj.peak_responses(podium, motion, options=options(TRUTH))
    rows = []
    for rtol in TOLERANCES:
        peak = rj.peak_responses(podium, motion, options=options(rtol, "errors"))
        assert peak.errors is not None
        lifted = np.asarray(truth.uplifted)
        answered = (np.asarray(code_of(peak.result)) <= 2) & (np.asarray(code_of(truth.result)) <= 2)
        other = np.asarray(peak.overturned) != np.asarray(truth.overturned)
        undecided = np.asarray(peak.errors.undecided)
        stands = answered & lifted & ~other & ~np.asarray(truth.overturned)
        row = {
            "records": source,
            "structure": kind,
            "rtol": rtol,
            "scenes": n,
            "no answer": int((~answered).sum()),
        }
        row |= {
            "flips": int((answered & other).sum()),
            "unflagged": int((answered & other & ~undecided).sum()),
        }
        row |= {"undecided": float(np.mean(undecided)), "compared": int(stands.sum())}
        for name in QUANTITIES:
            error = np.abs(np.asarray(getattr(peak, name)) - np.asarray(getattr(truth, name)))[stands]
            estimate = np.asarray(getattr(peak.errors, name))[stands]
            ratio = np.maximum(error - ROUNDING, 0.0) / np.maximum(estimate, 1e-300)
            row |= {
                f"{name}: over 1 x": float(np.mean(ratio > 1)),
                f"{name}: over 10 x": float(np.mean(ratio > 10)),
            }
            row |= {f"{name}: over 100 x": float(np.mean(ratio > 100)), f"{name}: most": float(np.max(ratio))}
            row |= {
                f"{name}: median error": float(np.median(error)),
                f"{name}: largest error": float(np.max(error)),
            }
            # What stands out: how large an error is that an estimate misses.
            row |= {f"{name}: largest beyond 10 x": float(np.max(np.where(ratio > 10, error, 0.0)))}
        rows.append(row)
    return rows


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument(
        "scenes", nargs="?", type=int, default=2000, help="of each kind of structure and of record"
    )
    arguments.add_argument("--records", type=Path, help="a folder of records, *.dat")
    given = arguments.parse_args()
    suites = {"synthetic": motions(40)}
    if given.records is not None:
        suites["recorded"] = recorded(given.records, 40)
    rows = []
    for source, records in suites.items():
        for kind in ("rigid", "elastic"):
            rows += compared(source, kind, records, given.scenes)
            keep("calibration", rows)
    show(
        rows,
        {
            key: "" if isinstance(y, str) else "d" if isinstance(y, int) else ".3g"
            for key, y in rows[0].items()
        },
    )


if __name__ == "__main__":
    main()
