"""Columns sized for a risk, each from ten starts: `python -m benchmarks.risk_design [names]`.

`probability` finds the slimmest column that overturns with a probability of at most 10⁻³ under a random
ground motion. `frequency` finds the slimmest column that overturns at most 4·10⁻⁴ times a year for a hazard
curve. `loss` minimises cost plus expected loss. `curves` computes both risks against the slenderness.
`fresh` repeats `frequency`, but draws six of 400 records anew in each step.

Each design is tested with motions that the search did not use: 200 other records, or subset simulation with
another seed. Results that are already in the table are not computed again.
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
FREQUENCY, PROBABILITY = 4e-4, 1e-3  # limits [1/year], [–]
WIDTHS = (0.4, 0.5, 0.6, 0.7, 0.8, 0.95)  # widths of the columns in the curves [m]
RECORDS, INDEPENDENT_RECORDS = 6, 200  # number of records of the suite, and of independent records
STEPS = 120  # number of steps of Adam
WIDTH = 1e-3  # width of overturning windows that may be missed, divided by the largest intensity
COLUMN: dict[str, Any] = {"height": 3.0, "column_mass": 1.5e3, "beam_mass": 30e3}
VARY = {"width": (0.3, 1.5)}
NARROW = {"width": (0.3, 1.0)}  # the largest intensity of the hazard overturns nearly all of these columns
LOSS = 1e3  # cost of overturning divided by the annual cost of a column of 1 m × 3 m


def slenderness(podium: rj.Podium):
    """Return tan α."""
    return jnp.tan(podium.alpha)


def cost(podium: rj.Podium):
    """Return the annual cost of a column, which is proportional to its width at constant height."""
    return podium.width


def records(first: int, count: int) -> list[rj.AbstractExcitation]:
    """Return `count` synthetic near-fault records of 7 s, with seeds from `first` on."""
    return [shaking(first + k, n=175, dt=0.04) for k in range(count)]


def initial_column() -> optimise.Dimensions:
    return optimise.Dimensions(width=0.6, **COLUMN)


def frequency_target(at_most: float) -> optimise.AnnualFrequency:
    return optimise.AnnualFrequency(at_most, HAZARD, records(0, RECORDS), width=WIDTH)


def probability_target(at_most: float) -> optimise.FailureProbability:
    return optimise.FailureProbability(at_most, MOTION, cov=0.1, rays=64)


def slimmest(target, vary: dict[str, tuple[float, float]], starts: int = 1, **settings) -> optimise.Design:
    settings |= {"starts": starts, "options": OPTIONS}
    return optimise.design(initial_column(), vary, slenderness, target, **settings)


def capacities(podium: rj.Podium, motions: list[rj.AbstractExcitation]) -> np.ndarray:
    """Return the least overturning PGA of each record [m/s²]; inf beyond the last point of the hazard."""
    target = optimise.AnnualFrequency(1e-3, HAZARD, motions, width=WIDTH)
    return np.asarray(_least_scales(target, options_as_arrays(OPTIONS), podium))


@jax.jit
def _frequency(capacities: jnp.ndarray) -> jnp.ndarray:
    curve = fit_capacities(capacities, jnp.full(capacities.shape, HAZARD.intensity[-1]))
    return rj.annual_frequency(curve, HAZARD).frequency


def frequency_of(capacity: np.ndarray) -> float:
    """Return the annual frequency λ_f from capacities."""
    return float(_frequency(jnp.asarray(capacity)))


def sampled_frequency(podium: rj.Podium) -> dict[str, float]:
    """Return λ_f from records that a design has not used, with an interval from 300 bootstrap samples."""
    parts = [capacities(podium, records(1000 + first, 50)) for first in range(0, INDEPENDENT_RECORDS, 50)]
    capacity = np.concatenate(parts)
    rng = np.random.default_rng(3)

    resampled = [frequency_of(rng.choice(capacity, capacity.size)) for _ in range(300)]
    low, high = np.quantile(resampled, (0.025, 0.975))
    return {"sampled": frequency_of(capacity), "from": float(low), "to": float(high)}


def sampled_probability(podium: rj.Podium) -> dict[str, float]:
    """Return P by subset simulation with a seed that a design has not used."""
    estimate = rj.failure_probability(podium, MOTION, method="subset", cov=0.1, seed=77)
    return {"sampled": estimate.probability, "from": estimate.interval[0], "to": estimate.interval[1]}


def row_of(answer: optimise.Design, start_time: float) -> dict[str, Any]:
    """Return the row of a design: results of its starts, numbers of evaluations and time."""
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
        "cpu s": time.process_time() - start_time,
    }


MakeRow = Callable[[], dict[str, Any]]


def frequency_row() -> dict[str, Any]:
    start_time = time.process_time()
    answer = slimmest(frequency_target(FREQUENCY), NARROW, STARTS)
    return row_of(answer, start_time) | {"limit": FREQUENCY} | sampled_frequency(answer.podium)


def probability_row() -> dict[str, Any]:
    start_time = time.process_time()
    answer = slimmest(probability_target(PROBABILITY), VARY, STARTS)
    (estimate,) = answer.probabilities.values()
    verified = {
        "verified": estimate.probability,
        "verified from": estimate.interval[0],
        "verified to": estimate.interval[1],
    }
    return row_of(answer, start_time) | {"limit": PROBABILITY} | verified | sampled_probability(answer.podium)


def loss_row() -> dict[str, Any]:
    start_time = time.process_time()
    objective = optimise.ExpectedLoss(cost, LOSS, frequency_target(FREQUENCY))
    answer = optimise.design(initial_column(), NARROW, objective, starts=STARTS, options=OPTIONS)
    risk_of_suite = {"frequency": float(objective.risk.frequency(answer.podium, OPTIONS))}
    return row_of(answer, start_time) | risk_of_suite | sampled_frequency(answer.podium)


def frequency_point(width: float) -> MakeRow:
    """Return a row with λ_f of a column from the suite, and from independent records."""

    def row() -> dict[str, Any]:
        podium = initial_column().replace(width=width).podium()
        frequency_of_suite = frequency_of(capacities(podium, records(0, RECORDS)))
        point = {"width": width, "tan α": float(slenderness(podium)), "frequency": frequency_of_suite}
        return point | sampled_frequency(podium)

    return row


def probability_point(width: float) -> MakeRow:
    """Return a row with P of a column."""

    def row() -> dict[str, Any]:
        podium = initial_column().replace(width=width).podium()
        return {"width": width, "tan α": float(slenderness(podium))} | sampled_probability(podium)

    return row


def fresh_row(seed: int) -> MakeRow:
    """Return a row of a design by Adam that draws 6 of 400 records in each step."""

    def row() -> dict[str, Any]:
        start_time = time.process_time()
        samples = optimise.FreshSamples(records(2000, 400), RECORDS, verify=40 * RECORDS, seed=seed)
        target = optimise.AnnualFrequency(FREQUENCY, HAZARD, samples, width=WIDTH)
        answer = slimmest(target, NARROW, method=optax.adam(0.02), max_iterations=STEPS)
        (error,) = answer.standard_errors.values()
        fresh_facts = {"limit": FREQUENCY, "error": float(error[0])}
        return row_of(answer, start_time) | fresh_facts | sampled_frequency(answer.podium)

    return row


STUDIES: dict[str, dict[str, MakeRow]] = {
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


def missing(names: list[str], rows: list[dict[str, Any]]) -> Iterator[tuple[str, str, MakeRow]]:
    """Yield the cases that the table does not contain yet."""
    computed = {(row["study"], row["case"]) for row in rows}
    for study in names:
        for case, row in STUDIES[study].items():
            if (study, case) not in computed:
                yield study, case, row


def picture(rows: list[dict[str, Any]]) -> None:
    """Draw both risks over the slenderness, from independent samples, with the designs from ten starts."""
    import matplotlib.pyplot as plt

    from rockjax import plots
    from rockjax._files import write_figure

    designs = {row["study"]: row for row in rows if row["case"] == "ten starts"}
    with plt.style.context(plots.STYLE):
        figure = plt.figure(figsize=(9.5, 3.8), layout="constrained")
        axes = figure.subplots(1, 2)
        risks = (r"$\lambda_f$ [1/year]", "probability of overturning $P$ [–]")
        for ax, letter, limit, risk in zip(axes, "λP", (FREQUENCY, PROBABILITY), risks, strict=True):
            points = [row for row in rows if row["study"] == "curves" and row["case"][0] == letter]
            x, y, low, high = (
                np.array([row[k] for row in points]) for k in ("tan α", "sampled", "from", "to")
            )
            label = "200 other records, 95 %" if letter == "λ" else "subset simulation, 95 %"
            ax.errorbar(x, y, (y - low, high - y), fmt="o-", ms=4, capsize=3, lw=1, label=label)
            if letter == "λ":
                label, by_suite = f"the suite of {RECORDS}", [row["frequency"] for row in points]
                ax.plot(x, by_suite, "s--", ms=4, lw=1, color=plots.COLOURS[1], label=label)
            design = designs.get("probability" if letter == "P" else "frequency")
            if design is not None:
                ax.plot(design["tan α"], limit, "k*", ms=11, label="design, limit")
            ax.axhline(limit, color="0.5", lw=0.8, ls="-", zorder=0)
            ax.set(xlabel=r"$\tan\alpha$", ylabel=risk, yscale="log")
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
