"""Calibration of error estimates and confidence intervals: `python -m benchmarks.calibration
errors|intervals`.

`errors [scenes] [--records FOLDER]` solves random structures of ordinary proportions under synthetic records,
and under the records of a folder (see `benchmarks/boundaries.py`), with a PGA from 0.9 to 8 times the uplift
threshold. It solves each scene with an error estimate, and again with `REFERENCE_RTOL` for the reference.
Scenes whose outcome differs from the reference are counted separately; their peaks are not compared.

`intervals [trials]` counts how often confidence intervals of fragility curves contain the true value. It
draws samples of capacities from a lognormal distribution, some of them censored. For each sample it computes
a fit and 90 % intervals with the functions of `rockjax.fragility`. In samples of stripes (numbers of records
that overturn at each level), records may survive at levels above their capacity. Samples with fewer than two
different capacities have no fit and do not count.
"""

from __future__ import annotations

import argparse
import math
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import xarray
from scipy.special import ndtri

import rockjax as rj
from rockjax._lognormal import fit_capacities, fit_counts
from rockjax._results import code_of, did_not_finish
from rockjax._studies.intervals import Capacities, profile_intervals

from .boundaries import motions, read_records
from .measure import report, store_rows

QUANTITIES = ("peak_rotation", "peak_shear")
TOLERANCES = (1e-4, 1e-6, 1e-8)
REFERENCE_RTOL = 1e-13
ROUNDING = 1e-12  # error of the reference in max|θ|/α


def podiums(structure: str, n: int, rng: np.random.Generator) -> rj.Podium:
    eta = rng.uniform(1.0, 100.0, n)
    top = (
        rj.Rigid(eta)
        if structure == "rigid"
        else rj.Elastic(eta, rng.uniform(0.1, 1.5, n), rng.uniform(0.0, 0.1, n))
    )
    return rj.Podium(rng.uniform(0.08, 0.35, n), rng.uniform(0.8, 5.0, n), rng.uniform(0.0, 12.0, n), top)


def scale_records(podium: rj.Podium, records: rj.Records, n: int, rng: np.random.Generator) -> rj.Records:
    """Return one record for each podium, with a PGA from 0.9 to 8 times the uplift threshold."""
    index = rng.integers(0, len(records), n).astype(np.int32)
    pga = np.asarray(records.magnitudes()).max(axis=1)[index]
    uplift = np.asarray(podium.g) * np.tan(np.asarray(podium.alpha))
    return records.pick(index).scaled(np.exp(rng.uniform(math.log(0.9), math.log(8.0), n)) * uplift / pga)


def options(rtol: float, *more: str) -> rj.Options:
    return rj.Options(rtol=rtol, atol=0.01 * rtol, outputs=(*QUANTITIES, *more))


def compare_errors(source: str, structure: str, records: rj.Records, n: int) -> list[dict]:
    rng = np.random.default_rng([5, *f"{source} {structure}".encode()])
    podium = podiums(structure, n, rng)
    motion = scale_records(podium, records, n, rng)
    reference = rj.peak_responses(podium, motion, options=options(REFERENCE_RTOL))
    rows = []
    for rtol in TOLERANCES:
        peak = rj.peak_responses(podium, motion, options=options(rtol, "errors"))
        assert peak.errors is not None
        lifted = np.asarray(reference.uplifted)
        codes = [np.asarray(code_of(y.result)) for y in (peak, reference)]
        answered = ~np.any(did_not_finish(np.array(codes)), axis=0)
        flipped = np.asarray(peak.overturned) != np.asarray(reference.overturned)
        undecided = np.asarray(peak.errors.undecided)
        survived = answered & lifted & ~flipped & ~np.asarray(reference.overturned)
        row = {"records": source, "structure": structure, "rtol": rtol, "scenes": n}
        row |= {"no answer": int((~answered).sum()), "flips": int((answered & flipped).sum())}
        row["unflagged"] = int((answered & flipped & ~undecided).sum())
        row |= {"undecided": float(np.mean(undecided)), "compared": int(survived.sum())}
        for name in QUANTITIES:
            error = np.abs(np.asarray(getattr(peak, name)) - np.asarray(getattr(reference, name)))[survived]
            estimate = np.asarray(getattr(peak.errors, name))[survived]
            ratio = np.maximum(error - ROUNDING, 0.0) / np.maximum(estimate, 1e-300)
            for factor in (1, 10, 100):
                row[f"{name}: over {factor} x"] = float(np.mean(ratio > factor))
            row |= {f"{name}: most": float(np.max(ratio)), f"{name}: median error": float(np.median(error))}
            row[f"{name}: largest error"] = float(np.max(error))
            # The largest error of scenes whose error exceeds ten times the estimate.
            row[f"{name}: largest beyond 10 x"] = float(np.max(np.where(ratio > 10, error, 0.0)))
        rows.append(row)
    return rows


def errors(scenes: int, folder: Path | None) -> None:
    suites = {"synthetic": motions(40)}
    if folder is not None:
        suites["recorded"] = read_records(folder, 40)
    rows = []
    for source, records in suites.items():
        for kind in ("rigid", "elastic"):
            rows += compare_errors(source, kind, records, scenes)
            store_rows("calibration", rows)
    report("calibration", rows)


# ----------------------------------------------------------------------------------------------- intervals
CONFIDENCE = 0.9
DISPERSION = 0.4
BATCH = 500
FRACTILES = (0.1, 0.9)  # probabilities at which the band is tested
SURVIVAL_CHANCE, SPAN = 0.3, 0.7  # chance of survival above the capacity, up to a distance of SPAN in ln(x)

_fits = jax.jit(jax.vmap(fit_capacities))


def _coverage(bounds, true_value) -> np.ndarray:
    return (bounds[0] <= true_value) & (true_value <= bounds[1])


def capacities(count: int, censored: float, trials: int, seed: int = 0) -> dict:
    """Return the coverage for `count` records, of which the fraction `censored` is censored on average."""
    rng = np.random.default_rng(seed)
    limit = np.exp(DISPERSION * ndtri(1 - censored)) if censored else 1e6
    is_covered = []
    for _ in range(-(-trials // BATCH)):
        sampled = np.exp(DISPERSION * rng.normal(size=(BATCH, count)))
        sampled = np.where(sampled < limit, sampled, np.inf)
        median, dispersion = (np.asarray(y) for y in _fits(sampled, np.full_like(sampled, limit)))
        has_fit = np.isfinite(median)
        z = ndtri(FRACTILES)[:, None]
        bounds = profile_intervals(
            Capacities.from_values(sampled[has_fit], limit),
            median[has_fit],
            dispersion[has_fit],
            np.exp(DISPERSION * z),
            CONFIDENCE,
        )
        truth = zip((bounds.log_median, bounds.log_dispersion), (0.0, np.log(DISPERSION)), strict=True)
        is_covered.append(
            np.stack([*(_coverage(y, value) for y, value in truth), *_coverage(bounds.probit, z)])
        )
    coverage = np.concatenate(is_covered, axis=1)
    return _row("capacities", count, f"{censored:.0%} censored", coverage)


def stripes(count: int, levels: int, survival_chance: float, trials: int, seed: int = 0) -> dict:
    """Return the coverage for counts of `count` records at `levels` levels.

    Above its capacity, a record survives a level with the probability `survival_chance`.
    """
    rng = np.random.default_rng(seed)
    x = np.linspace(0.25, 3.0, levels)

    def overturned(count: int) -> np.ndarray:
        log = DISPERSION * rng.normal(size=(count, 1))
        survives = (rng.random((count, levels)) < survival_chance) & (np.log(x) < log + SPAN)
        return (np.log(x) >= log) & ~survives

    large = 400_000
    counts = overturned(large).sum(axis=0).astype(float), np.full(levels, float(large))
    truth = fit_counts(jnp.asarray(x), *map(jnp.asarray, counts))
    median, dispersion = (float(y) for y in truth)
    z = ndtri(FRACTILES)
    is_covered = []
    for _ in range(trials):
        try:
            curve = rj.fragility(
                _analysis(x, overturned(count)), method="stripes", at=median * np.exp(dispersion * z)
            )
        except ValueError:
            continue
        (a, b), (c, d) = curve["interval"].values
        is_inside = [a <= median <= b, c <= dispersion <= d]
        is_covered.append([*is_inside, *_coverage((curve["lower"].values, curve["upper"].values), FRACTILES)])
    return _row("stripes", count, f"{levels} levels, {survival_chance:.0%} again", np.transpose(is_covered))


def _analysis(x: np.ndarray, overturned: np.ndarray) -> xarray.Dataset:
    """Return the variables of an analysis that `fragility` reads."""
    first = np.where(overturned.any(axis=1), x[np.argmax(overturned, axis=1)], np.nan)
    return xarray.Dataset(
        {"capacity": ("record", first), "overturned": (("record", "intensity"), overturned)},
        coords={"intensity": ("intensity", x, {"units": "1"})},
        attrs={"kind": "incremental-dynamic-analysis", "measure": "scale"},
    )


def _row(method: str, count: int, case: str, is_covered: np.ndarray) -> dict:
    names = ("median", "dispersion", *(f"P = {p:g}" for p in FRACTILES))
    shares = dict(zip(names, is_covered.mean(axis=1).tolist(), strict=True))
    return {"method": method, "records": count, "case": case, "samples": is_covered.shape[1], **shares}


def intervals(trials: int) -> None:
    warnings.filterwarnings("ignore", "fragility: the intervals rest on")
    rows = []
    for count in (5, 10, 40):
        rows += [capacities(count, censored, trials) for censored in (0.0, 0.25, 0.5, 0.75)]
    for count in (5, 10, 40):
        rows += [
            stripes(count, 12, survival_chance, trials // 2) for survival_chance in (0.0, SURVIVAL_CHANCE)
        ]
    report("coverage", rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=("errors", "intervals"))
    parser.add_argument("number", nargs="?", type=int, default=2000, help="scenes per structure, or trials")
    parser.add_argument("--records", type=Path, help="a folder of records, *.dat")
    arguments = parser.parse_args()
    if arguments.what == "errors":
        errors(arguments.number, arguments.records)
    else:
        intervals(arguments.number)


if __name__ == "__main__":
    main()
