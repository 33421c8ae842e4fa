"""Columns sized for a risk, each from ten starts: `python -m benchmarks.risk_design [names]`.

`probability` finds the slimmest column that overturns with a probability of at most 10⁻³ under a random
ground motion. `frequency` finds the slimmest column that overturns at most 4·10⁻⁴ times a year on a given
hazard. `loss` minimises cost plus expected loss. `curves` computes both risks against the slenderness.
`fresh` repeats `frequency` with new samples of 400 records in each step, and with fixed suites for
comparison.

Each design is tested with motions that the search did not use: 200 other records, another seed of subset
simulation, or counting. Results that are already in the table are not computed again.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

import optimise
import rockjax as rj
from optimise._evaluator import _least_scales, options_as_arrays
from rockjax.internal import fit_capacities

from .measure import IMAGES, show, store_rows, stored_rows_if_any
from .studies import OPTIONS, shaking

STARTS = 10
HAZARD = rj.Hazard([0.5, 1, 2, 4, 8, 16], [3.5e-2, 1.2e-2, 3.4e-3, 7.5e-4, 1.2e-4, 1.1e-5])  # over PGA
MOTION = rj.GaussianMotion(101, 0.05, 0.02)
FREQUENCY, PROBABILITY = 4e-4, 1e-3  # limits: [1/year], [–]
WIDTHS = (0.4, 0.5, 0.6, 0.7, 0.8, 0.95)  # of the curves [m]
RECORDS, INDEPENDENT_RECORDS = 6, 200  # of the suite, and independent ones
STEPS = 120  # of Adam
WIDTH = 1e-3  # of the windows of overturning that may be missed, over the largest intensity
COLUMN: dict[str, Any] = {"height": 3.0, "column_mass": 1.5e3, "beam_mass": 30e3}
VARY = {"width": (0.3, 1.5)}
NARROW = {"width": (0.3, 1.0)}  # all of these are overturned by the last intensity of the hazard, or nearly
LOSS = 1e3  # of one overturning, where a year of a column of 1 m × 3 m costs 1


def slenderness(podium: rj.Podium):
    """tan α."""
    return jnp.tan(podium.alpha)


def cost(podium: rj.Podium):
    """Of the column in a year: by its width, as the height is given."""
    return podium.width


def records(first: int, count: int) -> list[rj.AbstractExcitation]:
    """Synthetic near-fault records of 7 s; one number, one record."""
    return [shaking(first + k, n=175, dt=0.04) for k in range(count)]


def drawing() -> optimise.Dimensions:
    return optimise.Dimensions(width=0.6, **COLUMN)


def of_frequency(at_most: float) -> optimise.AnnualFrequency:
    return optimise.AnnualFrequency(at_most, HAZARD, records(0, RECORDS), width=WIDTH)


def of_probability(at_most: float) -> optimise.FailureProbability:
    return optimise.FailureProbability(at_most, MOTION, cov=0.1, rays=64)


def least(target, vary: dict[str, tuple[float, float]], starts: int = 1, **how: Any) -> optimise.Design:
    return optimise.design(drawing(), vary, slenderness, target, starts=starts, options=OPTIONS, **how)


def capacities(podium: rj.Podium, motions: list[rj.AbstractExcitation]) -> np.ndarray:
    """Least overturning PGA under each of some records [m/s²], inf above the last point of the hazard."""
    target = optimise.AnnualFrequency(1e-3, HAZARD, motions, width=WIDTH)
    return np.asarray(_least_scales(target, options_as_arrays(OPTIONS), podium))


@jax.jit
def _frequency(capacities: jnp.ndarray) -> jnp.ndarray:
    curve = fit_capacities(capacities, jnp.full(capacities.shape, HAZARD.intensity[-1]))
    return rj.annual_frequency(curve, HAZARD).frequency


def frequency_of(found: np.ndarray) -> float:
    """λ_f by capacities."""
    return float(_frequency(jnp.asarray(found)))


def sampled_frequency(podium: rj.Podium) -> dict[str, float]:
    """λ_f by records that took no part in a design, and the interval of it by 300 samples of them."""
    parts = [capacities(podium, records(1000 + first, 50)) for first in range(0, INDEPENDENT_RECORDS, 50)]
    found = np.concatenate(parts)
    rng = np.random.default_rng(3)

    resampled = [frequency_of(rng.choice(found, found.size)) for _ in range(300)]
    low, high = np.quantile(resampled, (0.025, 0.975))
    return {"sampled": frequency_of(found), "from": float(low), "to": float(high)}


def sampled_probability(podium: rj.Podium) -> dict[str, float]:
    """P by subset simulation from a seed that took no part in a design."""
    found = rj.failure_probability(podium, MOTION, method="subset", cov=0.1, seed=77)
    return {"sampled": found.probability, "from": found.interval[0], "to": found.interval[1]}


def row_of(answer: optimise.Design, began: float) -> dict[str, Any]:
    """A design as a row: where its starts ended, what it took."""
    ends = [start.objective for start in answer.starts if start.satisfied]
    (price,) = [float(np.sum(y)) for y in answer.multipliers.values()] or [None]
    return {
        "tan α": float(jnp.tan(answer.podium.alpha)),
        **answer.variables,
        "objective": answer.objective,
        "satisfied": len(ends),
        "spread": max(ends) / min(ends) - 1 if ends else None,
        "ends": [start.objective for start in answer.starts],
        "price": price,
        "margin": min((float(np.min(y)) for y in answer.margins.values()), default=None),
        "result": str(optimise.RESULTS[answer.result]),
        "evaluations": answer.stats.evaluations,
        "scenes": answer.stats.scenes,
        "cpu s": time.process_time() - began,
    }


Row = Callable[[], dict[str, Any]]


def frequency_row() -> dict[str, Any]:
    began = time.process_time()
    answer = least(of_frequency(FREQUENCY), NARROW, STARTS)
    return row_of(answer, began) | {"limit": FREQUENCY} | sampled_frequency(answer.podium)


def probability_row() -> dict[str, Any]:
    began = time.process_time()
    answer = least(of_probability(PROBABILITY), VARY, STARTS)
    (inner,) = answer.probabilities.values()
    own = {
        "verified": inner.probability,
        "verified from": inner.interval[0],
        "verified to": inner.interval[1],
    }
    return row_of(answer, began) | {"limit": PROBABILITY} | own | sampled_probability(answer.podium)


def loss_row() -> dict[str, Any]:
    began = time.process_time()
    objective = optimise.ExpectedLoss(cost, LOSS, of_frequency(FREQUENCY))
    answer = optimise.design(drawing(), NARROW, objective, starts=STARTS, options=OPTIONS)
    risk_of_suite = {"frequency": float(objective.risk.frequency(answer.podium, OPTIONS))}
    return row_of(answer, began) | risk_of_suite | sampled_frequency(answer.podium)


def frequency_point(width: float) -> Row:
    """λ_f of a column by the suite, and by the other records."""

    def row() -> dict[str, Any]:
        podium = drawing().replace(width=width).podium()
        own = frequency_of(capacities(podium, records(0, RECORDS)))
        known = {"width": width, "tan α": float(slenderness(podium)), "frequency": own}
        return known | sampled_frequency(podium)

    return row


def probability_point(width: float) -> Row:
    """P of a column."""

    def row() -> dict[str, Any]:
        podium = drawing().replace(width=width).podium()
        return {"width": width, "tan α": float(slenderness(podium))} | sampled_probability(podium)

    return row


def fresh_row(seed: int) -> Row:
    """By Adam, with records drawn anew in each step: 6 of 400, as many as the suite that stays has."""

    def row() -> dict[str, Any]:
        began = time.process_time()
        drawn = optimise.FreshSamples(records(2000, 400), RECORDS, verify=40 * RECORDS, seed=seed)
        target = optimise.AnnualFrequency(FREQUENCY, HAZARD, drawn, width=WIDTH)
        answer = least(target, NARROW, method=optax.adam(0.02), max_iterations=STEPS)
        (error,) = answer.standard_errors.values()
        known = {"limit": FREQUENCY, "error": float(error[0])}
        return row_of(answer, began) | known | sampled_frequency(answer.podium)

    return row


STUDIES: dict[str, dict[str, Row]] = {
    "frequency": {"ten starts": frequency_row},
    "probability": {"ten starts": probability_row},
    "fresh": {f"seed {seed}": fresh_row(seed) for seed in range(3)},
    "loss": {"ten starts": loss_row},
    "curves": {f"λ of {1e3 * y:.0f} mm": frequency_point(y) for y in WIDTHS}
    | {f"P of {1e3 * y:.0f} mm": probability_point(y) for y in (0.45, 0.5, 0.55, 0.6, 0.65)},
}
COLUMNS = (
    "study", "case", "tan α", "objective", "satisfied", "spread", "price", "limit", "sampled", "from", "to",
    "evaluations", "scenes", "cpu s",
)  # fmt: skip


def missing(names: list[str], rows: list[dict[str, Any]]) -> Iterator[tuple[str, str, Row]]:
    """What is not in the table yet."""
    known = {(row["study"], row["case"]) for row in rows}
    for study in names:
        for case, row in STUDIES[study].items():
            if (study, case) not in known:
                yield study, case, row


def picture(rows: list[dict[str, Any]]) -> None:
    """Both risks over the slenderness, by independent samples, with the designs from ten starts."""
    import matplotlib.pyplot as plt

    from rockjax import plots
    from rockjax._files import write_figure

    of = {(row["study"], row["case"]): row for row in rows}
    with plt.style.context(plots.STYLE):
        figure = plt.figure(figsize=(9.5, 3.8), layout="constrained")
        axes = figure.subplots(1, 2)
        words = (r"$\lambda_f$ [1/year]", "probability of overturning $P$ [–]")
        for ax, letter, limit, word in zip(axes, "λP", (FREQUENCY, PROBABILITY), words, strict=True):
            points = [row for (study, case), row in of.items() if study == "curves" and case[0] == letter]
            x, y, low, high = (
                np.array([row[k] for row in points]) for k in ("tan α", "sampled", "from", "to")
            )
            label = "200 other records, 95 %" if letter == "λ" else "subset simulation, 95 %"
            ax.errorbar(x, y, (y - low, high - y), fmt="o-", ms=4, capsize=3, lw=1, label=label)
            if letter == "λ":
                own = [row["frequency"] for row in points]
                ax.plot(x, own, "s--", ms=4, lw=1, color=plots.COLOURS[1], label=f"the suite of {RECORDS}")
            found = of.get((("frequency", "probability")[letter == "P"], "ten starts"))
            if found is not None:
                ax.plot(found["tan α"], limit, "k*", ms=11, label="design, limit")
            ax.axhline(limit, color="0.5", lw=0.8, ls="-", zorder=0)
            ax.set(xlabel=r"$\tan\alpha$", ylabel=word, yscale="log")
            ax.legend()
        write_figure(IMAGES / "risk-design.png", figure)


def main() -> None:
    rows = stored_rows_if_any("risk-design")
    for study, case, row in missing(sys.argv[1:] or list(STUDIES), rows):
        rows.append({"study": study, "case": case} | row())
        print(rows[-1], flush=True)
        store_rows("risk-design", rows)
    show(rows, COLUMNS)
    picture(rows)


if __name__ == "__main__":
    main()
