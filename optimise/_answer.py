"""The result of a design: the outcome of the search from each starting point (start), and the best design.

A target holds where its margins are ≥ 0. Verified values are those of the verification, which
`Design.satisfied` describes.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from html import escape
from typing import NamedTuple

import equinox as eqx
import numpy as np

import rockjax as rj
from rockjax._responses.peak import UNTIL_OVERTURNING
from rockjax._text.tables import align_rows, html
from rockjax.internal import Module, require_instance

from ._descent import End, Evaluation, Iterate
from ._objectives import AbstractObjective
from ._results import CONVERGED, INFEASIBLE, NAMES, NOT_FINITE, RESULTS, STALLED, UNVERIFIED, result_of_code
from ._variables import Structure, Variables, as_podium, is_logarithmic, make_variables


class Outcome(NamedTuple):
    """Outcome of one start.

    - `variables`: name → value in the unit of the parameter; `objective`: verified value of the objective
    - `margin`: least verified margin [–]; inf without targets, NaN if any margin is NaN
    - `satisfied`: whether objective and margins are finite and all margins are ≥ 0
    - `result`: a member of `optimise.RESULTS`; `iterations`: number of iterations, including those that
      correct the design after an independent sample or the verification (see `Design.satisfied`)
    """

    variables: dict[str, float]
    objective: float
    margin: float
    satisfied: bool
    result: RESULTS
    iterations: int


class Effort(NamedTuple):
    """Cost of a design.

    - `evaluations`: number of design points at which values and derivatives were computed
    - `scenes`: number of simulated scenes; the search for one overturning amplitude counts as one scene
    - `iterations`: sum of the iterations of all starts, counted as in `Outcome`; `seconds`: wall time,
      including compilation [s]
    """

    evaluations: int
    scenes: int
    iterations: int
    seconds: float


class Design(Module):
    """The best design of a search, and a record of the search.

    - `podium`: the designed podium; `structure`: the design in the type that was passed to
      `optimise.design`, a `Podium` or `Dimensions`
    - `variables`: name → value, in `units`; `objective`: value of the objective at the design, the largest
      entry if it is a vector
    - `satisfied`: whether, in the verification, objective and margins are finite and all margins are ≥ 0.
      The verification is a simulation with rtol ≤ 1e-11 and atol ≤ 1e-13 or, for targets on a probability of
      failure and targets with fresh samples, an independent sample
    - `margins`: name of the target → verified margins [–]; NaN for a probability of failure without an
      independent sample that has converged
    - `multipliers`: name of the target → shadow price of each margin [unit of the objective]. If the margin
      may be −ε instead of 0, the objective decreases by the price times ε. For most targets, this means that
      the limit is relaxed by the small fraction ε. The price is 0 if the limit does not bind. All prices are
      NaN if any target is violated or unverified, or if the search was interrupted before it determined them
    - `result`: a member of `optimise.RESULTS`
    - `stats`: numbers of `evaluations`, simulated `scenes` and `iterations`, and wall time `seconds` [s]
    - `history`: the iterations of all starts. Each has `start`, `iteration`, `x` (scaled variables),
      `objective`, `margin` (the least one), `residual` (of the optimality conditions), `radius` (of the trust
      region), `penalty` (of the violation), `step` (largest change of a scaled variable) and `accepted`.
      Iterations that correct the design after an independent sample or the verification are included only if
      targets have fresh samples
    - `starts`: the outcome of every start, with `variables`, `objective`, `margin`, `satisfied`, `result` and
      `iterations`; `best`: index of the start that gave this design, from 0
    - `bounds`: name → (lowest, highest); `units`: name → unit; `minimised`: name of the objective
    - `probabilities`: name of each target on a probability of failure → estimate of this probability from an
      independent sample
    - `standard_errors`: name of each target with fresh samples → standard errors of its margins in an
      independent sample [–]
    - `overturned`: name of the target or objective → number of scenes in which the columns overturn, for
      targets and objectives whose peaks cover only the time until overturning. Targets and objectives without
      overturned scenes are left out. A scene is one structure under one ground motion
    """

    podium: rj.Podium
    structure: Structure
    variables: dict[str, float]
    objective: float
    satisfied: bool
    margins: dict[str, np.ndarray]
    multipliers: dict[str, np.ndarray]
    result: RESULTS
    history: tuple[Iterate, ...]
    stats: Effort
    starts: tuple[Outcome, ...]
    best: int
    bounds: dict[str, tuple[float, float]]
    units: dict[str, str]
    minimised: str
    probabilities: dict[str, rj.FailureProbability] = eqx.field(static=True, default_factory=dict)
    standard_errors: dict[str, np.ndarray] = eqx.field(default_factory=dict)
    overturned: dict[str, int] = eqx.field(static=True, default_factory=dict)

    @property
    def failing(self) -> dict[str, float]:
        """Violated and unverified targets: name → least margin, negative or NaN [–]. The worst target comes
        first unless a margin is NaN."""
        worst = {name: float(np.min(values)) for name, values in self.margins.items()}
        return {
            name: value for name, value in sorted(worst.items(), key=lambda item: item[1]) if not value >= 0
        }

    def __repr__(self):
        headline, *tables = _tabulate(self)
        lines = [f"Design: {headline}", *(line for rows in tables for line in aligned(rows))]
        return "\n".join([*lines, *(f"  {sentence}" for sentence in _remarks(self))])

    def _repr_html_(self) -> str:
        return _html(self)


def _tabulate(design: Design) -> tuple[str, list[list[str]], list[list[str]]]:
    """Return the headline, the table of variables and the table of targets. Each table starts with a row of
    headings."""
    state = "satisfied" if design.satisfied else "not satisfied"
    remark = f" ({UNTIL_OVERTURNING})" if design.minimised in design.overturned else ""
    result = NAMES[int(design.result._value)]
    headline = f"{result}, targets {state}; {design.minimised} = {design.objective:.6g}{remark}"
    variables = [["variable", "value", "unit", "bounds"]]
    for name, value in design.variables.items():
        low, high = design.bounds[name]
        a, x, b = np.log([low, value, high]) if is_logarithmic(low, high) else (low, value, high)
        bound_remark = " (at bound)" if min(x - a, b - x) <= 1e-6 * (b - a) else ""
        variables.append([name, f"{value:.6g}", design.units[name], f"{low:g} … {high:g}{bound_remark}"])
    targets = [["target", "worst margin", "margins", "shadow price"]]
    for name, margins in design.margins.items():
        price = float(np.sum(design.multipliers[name]))
        price_text = "0" if abs(price) <= 1e-9 * abs(design.objective) else f"{price:.4g}"
        targets.append([name, f"{float(np.min(margins)):+.3g}", str(len(margins)), price_text])
    return headline, variables, targets


def check_design(owner: str, design) -> None:
    """Raise `ValueError` unless `design` is a `Design`."""
    require_instance(owner, "design", design, Design, "an optimise.Design, the result of optimise.design")


def aligned(rows: list[list[str]]) -> list[str]:
    """Return the aligned lines of a table; no lines if the table has only its heading row."""
    return [f"  {line}" for line in align_rows(rows)] if len(rows) > 1 else []


def _remarks(design: Design) -> list[str]:
    """Return sentences about a design: its result, failing targets, starts, samples and cost."""
    remarks = [RESULTS[design.result]]
    remarks += [
        f"not verified: {name}" if np.isnan(value) else f"not satisfied: {name}, worst margin {value:.3g}"
        for name, value in design.failing.items()
    ]
    satisfied_count = sum(outcome.satisfied for outcome in design.starts)
    if len(design.starts) > 1:
        remarks.append(
            f"{satisfied_count} of {len(design.starts)} starts satisfied the targets; "
            f"best: start {design.best}"
        )
    remarks += [
        f"{name}: the columns overturn in {count} of its scenes; the peaks of these scenes cover only the "
        f"time {UNTIL_OVERTURNING}"
        for name, count in design.overturned.items()
    ]
    for name, errors in design.standard_errors.items():
        margin, error = float(np.min(design.margins[name])), float(np.max(errors))
        remarks.append(
            f"{name}: margin {margin:+.3g} ± {error:.2g} (standard error), from an independent sample"
        )
    for name, estimate in design.probabilities.items():
        state = "independent sample" if estimate.converged else f"not converged in {estimate.scenes} scenes"
        remarks.append(f"{name}: P = {estimate.probability:.3g} ({estimate.described_interval}), {state}")
    cost = design.stats
    remarks.append(
        f"{cost.iterations} iterations, "
        f"{cost.evaluations} evaluations, {cost.scenes} scenes, {cost.seconds:.1f} s"
    )
    return remarks


def _html(design: Design) -> str:
    """Return the design as HTML for notebooks."""
    headline, *tables = _tabulate(design)
    parts = [f"<p><b>Design</b>: {escape(headline)}</p>"]
    parts += [html(rows, headings="row") for rows in tables if len(rows) > 1]
    parts += [f"<p>{escape(sentence)}</p>" for sentence in _remarks(design)]
    return "".join(parts)


class SampleEstimates(NamedTuple):
    """Estimates from independent samples at a design.

    - `probabilities`: index of each target on a probability of failure → estimate of this probability, None
      without a sample at this design
    - `errors`: index of the target → standard errors of its margins (k,) [–]
    """

    probabilities: Mapping[int, rj.FailureProbability | None]
    errors: Mapping[int, np.ndarray] = {}


class SearchResult(NamedTuple):
    """Result of a search.

    - `ends`: end of the search from each start; `evaluations`: verified evaluations at the ends
    - `margin_counts`: name of the target → number of its margins
    - `scale`: number by which the search divides the objective
    - `history`: iterates of all starts; `effort`: cost of the search
    """

    ends: list[End]
    evaluations: list[Evaluation]
    margin_counts: dict[str, int]
    scale: float
    history: list[Iterate]
    effort: Effort


def build_design(
    original: Structure,
    variables: Variables,
    objective: AbstractObjective | None,
    search: SearchResult,
    estimate_samples: Callable[[np.ndarray], SampleEstimates],
) -> Design:
    """Return the best of the designs at which the searches from the starts ended, with all outcomes. Without
    an objective, it is the design nearest to `original`. `estimate_samples` takes scaled variables (n,) and
    returns the estimates from independent samples there."""
    pairs = zip(search.ends, search.evaluations, strict=True)
    outcomes = tuple(_outcome(variables, end, evaluation) for end, evaluation in pairs)
    best = min(range(len(outcomes)), key=lambda k: _rank_outcome(outcomes[k], bool(search.margin_counts)))
    best_outcome, best_end, evaluation = outcomes[best], search.ends[best], search.evaluations[best]
    offsets = np.cumsum([0, *search.margin_counts.values()])
    spans = [slice(first, end) for first, end in itertools.pairwise(offsets)]
    estimates = estimate_samples(best_end.x)
    margins = evaluation.c.copy()
    probabilities = {k: y for k, y in estimates.probabilities.items() if y is not None}
    unverified = [
        k for k in estimates.probabilities if k not in probabilities or not probabilities[k].converged
    ]
    if unverified:
        for k in unverified:
            margins[spans[k]] = np.nan
        is_interrupted = best_outcome.result == RESULTS.interrupted
        if best_outcome.satisfied and not is_interrupted:
            best_outcome = best_outcome._replace(result=result_of_code(UNVERIFIED))
        best_outcome = best_outcome._replace(margin=np.nan, satisfied=False)
        outcomes = (*outcomes[:best], best_outcome, *outcomes[best + 1 :])
    prices = search.scale * best_end.multipliers if best_outcome.satisfied else np.full(offsets[-1], np.nan)
    lower_and_upper = np.asarray(variables.lower).tolist(), np.asarray(variables.upper).tolist()
    bounds = dict(zip(variables.names, zip(*lower_and_upper, strict=True), strict=True))
    minimised = "distance from the start" if objective is None else objective.describe()
    # `original` is used because `variables.base` has arrays in place of the user's numbers.
    structure = make_variables(original, bounds).structure(best_end.x)
    names = list(search.margin_counts)
    return Design(
        podium=as_podium(structure),
        structure=structure,
        variables=best_outcome.variables,
        objective=best_outcome.objective,
        satisfied=best_outcome.satisfied,
        margins={name: margins[span] for name, span in zip(search.margin_counts, spans, strict=True)},
        multipliers={name: prices[span] for name, span in zip(search.margin_counts, spans, strict=True)},
        result=best_outcome.result,
        history=tuple(search.history),
        stats=search.effort,
        starts=outcomes,
        best=best,
        bounds=bounds,
        units=dict(zip(variables.names, variables.units, strict=True)),
        minimised=minimised,
        probabilities={names[k]: estimate for k, estimate in probabilities.items()},
        standard_errors={names[k]: errors for k, errors in estimates.errors.items()},
        overturned={
            name: int(count)
            for name, count in zip([*names, minimised], evaluation.overturned, strict=True)
            if count
        },
    )


def _outcome(variables: Variables, end: End, evaluation: Evaluation) -> Outcome:
    """Return the outcome of a start. The result of the search changes if the verified evaluation contradicts
    it: to `not_finite` if the evaluation is not finite, from `converged` or `stalled` to `infeasible` if a
    target is violated, and from `infeasible` to `stalled` if all targets hold."""
    is_finite = bool(np.isfinite(evaluation.c).all() and np.isfinite(evaluation.f).all())
    satisfied = is_finite and evaluation.violation == 0
    code = end.result if is_finite else NOT_FINITE
    if code in (CONVERGED, STALLED) and not satisfied:
        code = INFEASIBLE
    if code == INFEASIBLE and satisfied:
        code = STALLED
    values = variables.values(end.x)
    values_by_name = dict(zip(variables.names, map(float, values), strict=True))
    worst_margin = float(np.min(evaluation.c, initial=np.inf))
    objective, result = float(np.max(evaluation.f)), result_of_code(code)
    return Outcome(values_by_name, objective, worst_margin, satisfied, result, end.iterations)


def _rank_outcome(outcome: Outcome, has_targets: bool) -> tuple[int, float]:
    """Return the sort key of an outcome. Satisfied outcomes come first, the smallest objective first; then
    violated ones, the largest margin first; then non-finite ones."""
    if not np.isfinite([outcome.objective, outcome.margin if has_targets else 0.0]).all():
        return (2, 0.0)
    return (0, outcome.objective) if outcome.satisfied else (1, -outcome.margin)
