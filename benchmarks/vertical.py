"""With and without the vertical component of records: `python -m benchmarks.vertical --records FOLDER`.

The folder holds horizontal and vertical components of stations, in files or in a table `suite.csv`, as
`rockjax.read_suite(FOLDER).paired()` reads them. Every pair is scaled as a whole so that its horizontal PGA
is a multiple of g tan α. Peak rotations with the vertical component over those without it; then, for the
shorter pairs, the least prestress that keeps all of them under 0.4 α, with and without, from ten starts, and
beside it a scan of the prestress. `--design` does the second part only.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from scipy.stats import wilcoxon

import rockjax as rj

from .device_design import FORMATS, LIMIT, OPTIONS, RIGID, fresh_peaks, least_force, row_of
from .measure import keep, show

DT = 0.02  # of all motions [s]
PART = (0.01, 0.97)  # of the Arias intensity of the horizontal component, that is kept
RATIOS = (1.5, 2.0, 3.0)  # PGA over g tan α
SIZES = (0.5, 1.0, 2.0)  # of the columns, over those of the other studies
DESIGN = 2.0  # of the ratios, for the design
UNMOVED = 1e-3  # of α: smaller rotations say nothing
SHORT = 2000  # samples; of the design
SCAN = np.linspace(60e3, 130e3, 701)  # prestress [N]: below no design stands, above all do
SCANNED = "least of the scan [N]", "throughout from [N]", "satisfied between", "changes"
Pairs = list[rj.GroundMotion]


def read(folder: Path) -> rj.Motions:
    """The pairs of a folder, at one interval and without what comes before and after the strong shaking."""
    return rj.read_suite(folder).paired().map(lambda pair: pair.resampled(DT).trimmed(*PART))


def pairs_of(motions: rj.Motions, pga: float) -> Pairs:
    """Pairs of records of one length, filled up with zeros, each scaled to a horizontal PGA [m/s²]."""
    size = max(len(y) for motion in motions for y in (motion, motion.vertical))

    def record(samples: np.ndarray, scale: float) -> rj.Record:
        return rj.Record(np.pad(scale * samples, (0, size - len(samples))), DT)

    return [
        rj.GroundMotion(
            record(motion.acceleration, pga / motion.pga),
            record(motion.vertical.acceleration, pga / motion.pga),
        )
        for motion in motions
    ]


def horizontal(pairs: Pairs) -> list[rj.AbstractExcitation]:
    return [pair.horizontal for pair in pairs]


def compared(motions: rj.Motions, size: float, ratio: float) -> list[dict]:
    """A row for every pair: largest rotations with and without the vertical component, and its PGA."""
    podium = rj.Podium.from_dimensions(**RIGID)
    podium = podium.replace(R=size * podium.R)
    pairs = pairs_of(motions, ratio * float(podium.g * jnp.tan(podium.alpha)))
    both, alone = (fresh_peaks(podium, list(ms), OPTIONS) for ms in (pairs, horizontal(pairs)))
    return [
        {
            "record": motion.name,
            "component": str(motion.metadata.get("component")),
            "PGA [g]": motion.pga / 9.80665,
            "V/H": motion.vertical.pga / motion.pga,
            "R [m]": float(podium.R),
            "ratio": ratio,
            "with": float(both.peak_rotation[k]),
            "without": float(alone.peak_rotation[k]),
            "overturned with": bool(both.overturned[k]),
            "overturned without": bool(alone.overturned[k]),
        }
        for k, motion in enumerate(motions)
    ]


def summary(rows: list[dict]) -> dict:
    """What the vertical component does to the rotations of those that rock and stand in both cases."""
    stood = [row for row in rows if not (row["overturned with"] or row["overturned without"])]
    pairs = np.array([[row["with"], row["without"]] for row in stood if row["without"] > UNMOVED])
    logs = np.log(pairs[:, 0] / pairs[:, 1])
    return {
        "pairs": len(rows),
        "compared": len(logs),
        "median": float(np.exp(np.median(logs))),
        "smallest": float(np.exp(logs.min())),
        "largest": float(np.exp(logs.max())),
        "larger with": int(np.sum(logs > 0)),
        "p": float(wilcoxon(logs).pvalue),
        "overturned with": sum(row["overturned with"] for row in rows),
        "overturned without": sum(row["overturned without"] for row in rows),
    }


def scanned(case: list[rj.AbstractExcitation]) -> dict[str, float]:
    """Where the prestress of a scan satisfies the limit: from its least value there, and from which one on
    throughout."""
    podiums = rj.Podium.from_dimensions(**RIGID, tendon_force=jnp.asarray(SCAN))
    peaks = [rj.peak_responses(podiums, motion, options=OPTIONS) for motion in case]
    satisfied = np.all([(p.peak_rotation <= LIMIT) & ~p.overturned for p in peaks], axis=0)
    first, last = np.argmax(satisfied), len(SCAN) - np.argmin(satisfied[::-1])
    changes = np.sum(satisfied[1:] != satisfied[:-1])
    values = SCAN[first], SCAN[last], satisfied[first:last].mean(), changes
    return dict(zip(SCANNED, map(float, values), strict=True))


def designs(motions: rj.Motions) -> list[dict]:
    """The least prestress for the shorter pairs, with and without the vertical component."""
    podium = rj.Podium.from_dimensions(**RIGID)
    short = rj.Motions(tuple(motion for motion in motions if len(motion) < SHORT))
    print(f"{len(short)} pairs of less than {SHORT} samples", flush=True)
    pairs = pairs_of(short, DESIGN * float(podium.g * jnp.tan(podium.alpha)))
    cases: dict[str, list[rj.AbstractExcitation]] = {"with": list(pairs), "without": horizontal(pairs)}
    return [row_of(name, least_force(case)) | scanned(case) for name, case in cases.items()]


def comparison(motions: rj.Motions) -> None:
    tables = [compared(motions, size, ratio) for size in SIZES for ratio in RATIOS]
    rows = [row for table in tables for row in table]
    show(rows, {"record": "", "component": "", "PGA [g]": ".3f", "V/H": ".2f", "R [m]": ".2f", "ratio": "g"}
         | {"without": ".4f", "with": ".4f"})  # fmt: skip
    keep("device-vertical", rows)
    sums = [{"R [m]": t[0]["R [m]"], "ratio": t[0]["ratio"]} | summary(t) for t in tables] + [summary(rows)]
    show(sums, {key: ".3f" if isinstance(value, float) else "" for key, value in sums[0].items()})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--records", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--design", action="store_true", help="the design only")
    arguments = parser.parse_args()
    motions = read(arguments.records)
    print(f"{len(motions)} pairs, {min(map(len, motions))} to {max(map(len, motions))} samples", flush=True)
    if not arguments.design:
        comparison(motions)
    found = designs(motions)
    keep("device-vertical-design", found)
    forms = FORMATS | dict.fromkeys(SCANNED, ".6g")
    show(found, {key: form for key, form in forms.items() if any(key in row for row in found)})
    print(f"limit {LIMIT} α at PGA = {DESIGN:g} g tan α")


if __name__ == "__main__":
    main()
