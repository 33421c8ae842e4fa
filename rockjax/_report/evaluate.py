"""Evaluation of the checks of a problem: values, utilisations U (value/limit, or limit/value for a minimum)
and results.

A scene is the structure under one motion.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .assemble import tables_of
from .assumptions import ASSUMPTIONS, INVALIDATING, Outcome
from .derivatives import log_slopes, prepare_answers
from .entry import Entry
from .evaluation import Check, Evaluation, describe_error
from .kinds import KINDS
from .kinds.base import Kind, Statistic, Values, statistic_of
from .kinds.outside import ByOthers
from .problem import Problem
from .reading import read_problem
from .scales import UnfinishedScenesError
from .scenes import Needs, NoProgress, Scenes
from .store import Store
from .tables import Quantity, Text, joined, plain
from .units import Units

SKIPPABLE = ("risk", "methods", "spread")  # valid names in the argument `skip`


def evaluate(
    problem: Problem | str | Path, *, skip: tuple[str, ...] = (), store: Any = None, progress: Any = None
) -> Evaluation:
    """Evaluate all checks of a problem. The function cannot be called inside `jax.jit`.

    - `problem`: a [`rockjax.Problem`][], or the path of a problem file
    - `skip`: parts that are left out: `"risk"` (annual frequency, median capacity, failure probability),
      `"methods"` (the simplified methods) and `"spread"` (the checks repeated with one input at a time
      decreased or increased)
    - `store`: path of a file NAME.nc with the scenes of an earlier report, which are not solved again; None
      for no file. `evaluate` does not write NAME.nc. [`rockjax.report`][] writes it if you pass the
      evaluation and an `output`. If `evaluate` takes long or is interrupted, it writes NAME.partial.nc, from
      which a later call continues
    - `progress`: object with the methods `update(number_of_scenes)` and `describe(text)`; None shows nothing

    Returns a [`rockjax.Evaluation`][]. Raises `ValueError` for a problem file that is invalid or cannot be
    read, and for unknown names in `skip`. Raises `OSError` if an interrupted evaluation cannot write
    NAME.partial.nc.
    """
    if isinstance(problem, str | Path):
        problem = read_problem(problem)
    check_skip(skip)
    path = None if store is None else Path(os.path.expanduser(store))
    return evaluate_with_store(problem, skip, Store(path), progress)


def check_skip(skip: tuple[str, ...]) -> None:
    """Raise `ValueError` for unknown names in the argument `skip` of `evaluate`."""
    for name in skip:
        if name not in SKIPPABLE:
            raise ValueError(f"evaluate: skip may contain only {', '.join(SKIPPABLE)}, got {name!r}")


def evaluate_with_store(
    problem: Problem,
    skip: tuple[str, ...],
    store: Store,
    progress: Any = None,
    start_page: Callable[[Scenes, Sequence[str]], None] | None = None,
) -> Evaluation:
    """Evaluate all checks of a problem.

    - `problem`, `skip`, `progress`: as for `evaluate`
    - `store`: stores the scenes
    - `start_page`: function of the scenes and the names of the used sets. It is called as soon as the peaks
      under the sets are known, to start computations for the page in other threads
    """
    made, with_spread = made_entries(problem, skip), "spread" not in skip
    scenes = Scenes(problem, store, needs_of_sets(problem), progress or NoProgress(), with_spread)
    with store.saved_on_interruption():
        is_started = {entry.id: _start(entry, scenes) for entry in made}
        for name in dict.fromkeys(entry.motions for entry in made if KINDS[entry.kind].has_variants):
            with contextlib.suppress(Exception):  # the checks of the set report the error
                scenes.start_variants(str(name))
                prepare_answers(scenes, str(name))
        if start_page is not None:
            with contextlib.suppress(Exception):
                start_page(scenes, list(dict.fromkeys(str(entry.motions) for entry in made if entry.motions)))
        # Checks that wait for another thread are evaluated last.
        last = sorted(problem.checks, key=lambda entry: is_started.get(entry.id, False))
        by_id = {entry.id: _evaluate(entry, scenes, skip) for entry in last}
        checks = tuple(by_id[entry.id] for entry in problem.checks)
        used = dict.fromkeys(check.motions for check in checks if check.values is not None)
        found = {name: _outcomes(name, scenes) for name in problem.motions if name in used}
        outcomes = {name: outcome for name, outcome in found.items() if outcome}
    return Evaluation(problem, scenes, checks, outcomes, tuple(skip), tables_of)


def _start(entry: Entry, scenes: Scenes) -> bool:
    """Start the long computation of an entry, as `Kind.start` does. Return False also after an error; the
    check of the entry reports the error."""
    try:
        return KINDS[entry.kind].start(entry, scenes)
    except Exception:
        return False


def _outcomes(name: str, scenes: Scenes) -> dict[str, Outcome | str]:
    """Return the id of each assumption → outcome of its test in the scenes of a set; {} if these scenes
    cannot be solved. If a test raises an error, its outcome is a text with the error."""
    try:
        data = scenes.peaks(name)
    except Exception:
        return {}
    outcomes: dict[str, Outcome | str] = {}
    for assumption in ASSUMPTIONS:
        try:
            outcomes[assumption.id] = assumption.test(scenes.problem, data)
        except Exception as error:
            outcomes[assumption.id] = f"Not tested: {describe_error(error)}."
    return outcomes


def made_entries(problem: Problem, skip: tuple[str, ...]) -> list[Entry]:
    """Return the entries whose checks can be made and are not left out by `skip`."""
    return [entry for entry in problem.checks if not _reason_not_made(entry, problem, skip)]


def needs_of_sets(problem: Problem) -> dict[str, Needs]:
    """Return for each set of motions the outputs, blocks and oscillators that its checks need. Checks that
    are left out on request count too, so that a later run without this request can use the stored scenes."""
    needed = {name: Needs({}, {}) for name in problem.motions}
    for entry in made_entries(problem, ()):
        if entry.motions:
            kind = KINDS[entry.kind]
            needed[entry.motions].outputs.update(dict.fromkeys(kind.outputs(entry)))
            needed[entry.motions].on_floors.update(kind.on_floors(entry))
    return needed


def _reason_not_made(entry: Entry, problem: Problem, skip: tuple[str, ...]) -> str:
    """Return the reason for not evaluating a check; "" if it is to be evaluated."""
    kind = KINDS[entry.kind]
    reason = kind.missing(entry, problem)
    if not reason and kind.skip_name in skip and not isinstance(kind, ByOthers):
        reason = f"Left out on request (skip {kind.skip_name})."
    return reason


def _evaluate(entry: Entry, scenes: Scenes, skip: tuple[str, ...]) -> Check:
    """Return the check of an entry. If the evaluation raises an error, the result is NOT MADE, with the error
    as the reason, or UNDECIDED if the value is unknown because scenes did not finish."""
    kind, reason = KINDS[entry.kind], _reason_not_made(entry, scenes.problem, skip)
    if isinstance(kind, ByOthers):
        return Check(entry, kind, "BY OTHERS", reason)
    if reason:
        return Check(entry, kind, "NOT MADE", reason)
    try:
        return _compute(entry, kind, scenes)
    except UnfinishedScenesError as error:
        return Check(entry, kind, "UNDECIDED", str(error))
    except Exception as error:
        return Check(entry, kind, "NOT MADE", describe_error(error))


def _compute(entry: Entry, kind: Kind, scenes: Scenes) -> Check:
    """Return the check of an entry whose inputs are all present."""
    values = kind.values(entry, scenes)
    statistic, utilisations = _utilisations(entry, kind, values)
    violated = _violated(kind, entry, scenes)
    causes = sorted({name for name in values.unanswered if name})
    result = decide(utilisations, bool(causes), bool(violated))
    reason: Text = values.remark or _events(entry, values)
    if causes and result == "UNDECIDED":
        counts = [Quantity(y, "count") for y in (sum(map(bool, values.unanswered)), len(values.unanswered))]
        reason = counts[0], " of ", counts[1], f" scenes have no decided answer: {', '.join(causes)}"
    text: Text = ""
    state = ""
    governing, is_mean = statistic.governing, entry.keys.statistic == "mean"
    if not math.isfinite(statistic.value):
        text, state = "no finite value", "unanswered" if math.isnan(statistic.value) else "none"
        if values.texts[governing]:
            text, state = values.texts[governing], values.states[governing]
    location = values.locations[governing] if statistic.has_one_case else ""
    units = Units.si(float(scenes.problem.podium.g))
    check = Check(
        entry,
        kind,
        result,
        plain(reason, units),
        violated,
        statistic.value,
        statistic.error,
        plain(text, units),
        state,
        utilisations[1],
        None if kind.has_one_value or is_mean else governing,
        plain(location, units),
        values,
        tuple(statistic.weights.tolist()),
        parts={"reason": reason, "text": text, "location": location},
    )
    slopes = _sensitivities(check, scenes)
    # The derivatives of a mean are left out if |d ln U/d ln y| · spread > 1 for an input y, because a motion
    # under which the columns barely rock may dominate them.
    spread = scenes.problem.report.spread
    is_smooth = not is_mean or all(abs(y) * spread <= 1 for y in slopes.values())
    return dataclasses.replace(
        check,
        sensitivities=slopes if is_smooth else {},
        no_slopes=Check.no_slopes if is_smooth else "not smooth",
        **(_spread(check, scenes) if scenes.with_spread and kind.has_variants else {}),
        laws=_laws(check, scenes) if not kind.no_laws else {},
    )


def _overturned_or_open(values: Values) -> list[int]:
    """Return the indices of the cases in which columns or blocks overturn or a joint opens."""
    return [k for k, state in enumerate(values.states) if state in ("overturned", "joint opens")]


def _events(entry: Entry, values: Values) -> Text:
    """Return a text that names the cases in which columns or blocks overturn or a joint opens. Return "" if
    there are none, or if the statistic is the worst value, because its own text names the event."""
    cases = _overturned_or_open(values) if entry.keys.statistic != "max" else []
    named: list[Text] = [joined((f"{values.names[k]}: ", values.texts[k]), "") for k in cases[:3]]
    if len(cases) > 3:
        named.append(("and ", Quantity(len(cases) - 3, "count"), " more"))
    return joined(named, "; ")


def _utilisations(entry: Entry, kind: Kind, values: Values) -> tuple[Statistic, tuple[float, float, float]]:
    """Return the statistic of the values of a check, and the least, the estimated and the largest utilisation
    [–]. If columns or blocks overturn or a joint opens in one case, all three utilisations are inf, whatever
    the statistic is."""
    statistic = statistic_of(values, entry.keys.statistic, kind.is_minimum)
    if _overturned_or_open(values):
        return statistic, (math.inf, math.inf, math.inf)
    low, high = statistic.bounds
    return statistic, utilisations_of(low, statistic.value, high, entry.limit, kind.is_minimum)


def utilisations_of(
    low: float, value: float, high: float, limit: float, is_minimum: bool
) -> tuple[float, float, float]:
    """Return the least, the estimated and the largest utilisation [–] of a value between two bounds.

    - `low`, `value`, `high`: least value, value and largest value [SI]; `limit`: the limit [SI]
    - `is_minimum`: whether the value must be at least the limit

    The utilisation is NaN if the value is NaN. For a maximum, an infinite value has the utilisation inf. For
    a minimum, the value inf has the utilisation 0. A value ≤ 0 that must be at least the limit has the
    utilisation 0 if it satisfies a limit ≤ 0, otherwise inf.
    """

    def utilisation(y: float) -> float:
        if math.isnan(y):
            return math.nan
        if not is_minimum:
            return y / limit
        if y == math.inf:
            return 0.0
        if y > 0:
            return limit / y
        # For y ≤ 0 the ratio limit/y is no measure of safety.
        return math.inf if limit > 0 else 0.0 if y >= limit else math.inf

    results = [utilisation(y) for y in ((low, value, high) if math.isfinite(value) else (value,) * 3)]
    return min(results), results[1], max(results)


def decide(utilisations: tuple[float, float, float], is_unanswered: bool, is_violated: bool) -> str:
    """Return the result of a check: "PASS", "FAIL", "UNDECIDED" or "NOT VALID".

    - `utilisations`: least, estimated and largest utilisation, from `utilisations_of`
    - `is_unanswered`: whether a scene of the set is undecided or has no answer
    - `is_violated`: whether an assumption in `INVALIDATING` is violated
    """
    least, _, largest = utilisations
    if least > 1:
        return "FAIL"
    if is_unanswered or largest > 1 or math.isnan(largest):
        return "UNDECIDED"
    return "NOT VALID" if is_violated else "PASS"


def _violated(kind: Kind, entry: Entry, scenes: Scenes) -> tuple[str, ...]:
    """Return the ids, such as "A7", of the assumptions in `INVALIDATING` that are violated in at least one
    tested scene of a check."""
    data = kind.tested_scenes(entry, scenes)
    if data is None:
        return ()
    outcomes = {assumption.id: assumption.test(scenes.problem, data) for assumption in INVALIDATING}
    return tuple(
        name for name, outcome in outcomes.items() if isinstance(outcome, Outcome) and outcome.violated.any()
    )


def _sensitivities(check: Check, scenes: Scenes) -> dict[str, float]:
    """Return input y → d ln U/d ln y; empty if there are no derivatives or U is 0 or infinite."""
    u = check.utilisation
    if check.kind.has_one_value:
        return check.kind.known_slopes(check.entry, scenes) if math.isfinite(u) and u else {}
    if not math.isfinite(u) or u == 0 or not math.isfinite(check.value):
        return {}
    assert check.values is not None
    weights = np.array(check.weights)
    motions = np.flatnonzero(weights).tolist()
    if any(check.values.unanswered[k] for k in motions if check.values.unanswered):
        return {}
    found = {k: check.kind.slopes_function(check.entry, scenes, k) for k in motions}
    functions = {k: function for k, function in found.items() if function is not None}
    if len(functions) < len(motions):  # the statistic has a derivative only if all its values have one
        return {}
    data = log_slopes(scenes, check.entry, functions)
    # The statistic is Σ w v, so its logarithmic derivative is Σ w v s / Σ w v with s = d ln v/d ln y.
    shares = weights[motions] * data["value"].values
    slopes = shares @ np.where(shares[:, None] == 0, 0.0, data["slope"].values) / shares.sum()
    sign = -1 if check.kind.is_minimum else 1
    return {str(name): sign * float(y) for name, y in zip(data["parameter"].values, slopes, strict=True)}


def _repeat(check: Check, scenes: Scenes, law: str | None = None, variation: str = "") -> Any:
    """Evaluate a check again with another law of impact, or with a changed input or factor on the motions.
    Return the least, the estimated and the largest utilisation, and the values.

    - `check`, `scenes`: the check, and the scenes of the problem
    - `law`, `variation`: law of impact and name of the change, as for `Kind.values`
    """
    values = check.kind.values(check.entry, scenes, law, variation)
    return _utilisations(check.entry, check.kind, values)[1], values


def _spread(check: Check, scenes: Scenes) -> dict[str, dict[Any, Any]]:
    """Return the fields `spread` and `spread_events` of a check."""
    events: dict[tuple[str, int], str] = {}

    def utilisation(variation: str) -> float:
        (least, estimated, _), values = _repeat(check, scenes, variation=variation)
        for k in _overturned_or_open(values)[:1]:
            name = values.names[k] if values.names else ""
            events[variation[:-1], "-+".index(variation[-1])] = f"{values.states[k]} ({name})"
        return math.nan if any(values.unanswered) and not least > 1 else estimated

    varied = {variation: utilisation(variation) for variation in scenes.variations}
    names = dict.fromkeys(variation[:-1] for variation in scenes.variations)
    spread = {name: (varied.get(f"{name}-", math.nan), varied.get(f"{name}+", math.nan)) for name in names}
    return {"spread": spread, "spread_events": events}


def _laws(check: Check, scenes: Scenes) -> dict[str, tuple[float, str]]:
    """Return law of impact → (U [–], result). Violated assumptions are ignored."""
    laws = {}
    for law in scenes.problem.report.laws:
        utilisations, values = _repeat(check, scenes, law=law)
        laws[law] = utilisations[1], decide(utilisations, any(values.unanswered), False)
    return laws
