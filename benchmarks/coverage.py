"""How often intervals of fragility curves hold the truth: `python -m benchmarks.coverage [trials]`.

Capacities are drawn from a lognormal distribution, some of them censored; a fit and its 90 % intervals are
found for each sample, with the functions of `rockjax.fragility`. For stripes each record survives again at
levels above its capacity, by chance. Samples without a fit, with fewer than two capacities that differ, are
drawn but do not count.
"""

from __future__ import annotations

import sys
import warnings

import jax
import numpy as np
import xarray
from scipy.special import ndtri

import rockjax as rj
from rockjax._studies.intervals import Capacities, of_capacities
from rockjax._studies.lognormal import fit_capacities, fit_counts

from .measure import keep, show

CONFIDENCE = 0.9
DISPERSION = 0.4
BATCH = 500
FRACTILES = (0.1, 0.9)  # where the band is looked at
AGAIN, SPAN = 0.3, 0.7  # chance of surviving a level above the capacity, up to so much in ln(x)

_fits = jax.jit(jax.vmap(fit_capacities))


def _held(bounds, truth) -> np.ndarray:
    return (bounds[0] <= truth) & (truth <= bounds[1])


def capacities(count: int, censored: float, trials: int, seed: int = 0) -> dict:
    """Coverage with `count` records, of which a share `censored` is expected above the limit."""
    rng = np.random.default_rng(seed)
    limit = np.exp(DISPERSION * ndtri(1 - censored)) if censored else 1e6
    held = []
    for _ in range(-(-trials // BATCH)):
        drawn = np.exp(DISPERSION * rng.normal(size=(BATCH, count)))
        drawn = np.where(drawn < limit, drawn, np.inf)
        median, dispersion = (np.asarray(y) for y in _fits(drawn, np.full_like(drawn, limit)))
        good = np.isfinite(median)
        z = ndtri(FRACTILES)[:, None]
        found = of_capacities(
            Capacities.of(drawn[good], limit),
            median[good],
            dispersion[good],
            np.exp(DISPERSION * z),
            CONFIDENCE,
        )
        truth = zip((found.log_median, found.log_dispersion), (0.0, np.log(DISPERSION)), strict=True)
        held.append(np.stack([*(_held(y, value) for y, value in truth), *_held(found.probit, z)]))
    share = np.concatenate(held, axis=1)
    return _row("capacities", count, f"{censored:.0%} censored", share)


def stripes(count: int, levels: int, again: float, trials: int, seed: int = 0) -> dict:
    """Coverage of counts at `levels`, with a chance `again` of surviving above the capacity."""
    rng = np.random.default_rng(seed)
    x = np.linspace(0.25, 3.0, levels)

    def overturned(count: int) -> np.ndarray:
        log = DISPERSION * rng.normal(size=(count, 1))
        spared = (rng.random((count, levels)) < again) & (np.log(x) < log + SPAN)
        return (np.log(x) >= log) & ~spared

    many = 400_000
    truth = fit_counts(x, overturned(many).sum(axis=0).astype(float), np.full(levels, float(many)))
    median, dispersion = (float(y) for y in truth)
    z = ndtri(FRACTILES)
    held = []
    for _ in range(trials):
        try:
            curve = rj.fragility(
                _analysis(x, overturned(count)), method="stripes", at=median * np.exp(dispersion * z)
            )
        except ValueError:
            continue
        (a, b), (c, d) = curve["interval"].values
        share = [a <= median <= b, c <= dispersion <= d]
        held.append([*share, *_held((curve["lower"].values, curve["upper"].values), FRACTILES)])
    return _row("stripes", count, f"{levels} levels, {again:.0%} again", np.transpose(held))


def _analysis(x: np.ndarray, overturned: np.ndarray) -> xarray.Dataset:
    """What `fragility` looks at of an analysis."""
    first = np.where(overturned.any(axis=1), x[np.argmax(overturned, axis=1)], np.nan)
    return xarray.Dataset(
        {"capacity": ("record", first), "overturned": (("record", "intensity"), overturned)},
        coords={"intensity": ("intensity", x, {"units": "1"})},
        attrs={"kind": "incremental-dynamic-analysis", "measure": "scale"},
    )


def _row(method: str, count: int, case: str, held: np.ndarray) -> dict:
    names = ("median", "dispersion", *(f"P = {p:g}" for p in FRACTILES))
    shares = dict(zip(names, held.mean(axis=1).tolist(), strict=True))
    return {"method": method, "records": count, "case": case, "samples": held.shape[1], **shares}


def main(trials: int = 2000) -> None:
    warnings.filterwarnings("ignore", "fragility: the intervals rest on")
    rows = []
    for count in (5, 10, 40):
        for censored in (0.0, 0.25, 0.5, 0.75):
            rows.append(capacities(count, censored, trials))
            print(rows[-1], flush=True)
    for count in (5, 10, 40):
        for again in (0.0, AGAIN):
            rows.append(stripes(count, 12, again, trials // 2))
            print(rows[-1], flush=True)
    keep("coverage", rows)
    columns = dict.fromkeys(("median", "dispersion", *(f"P = {p:g}" for p in FRACTILES)), ".3f")
    show(rows, {"method": "", "records": "d", "case": "", "samples": "d", **columns})


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
