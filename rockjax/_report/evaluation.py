"""Results of a report: the check with its result, and the evaluation of all checks of a problem."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from .assumptions import Outcome
from .entry import Entry
from .kinds.base import Kind, Values
from .problem import Problem
from .scenes import Scenes

if TYPE_CHECKING:
    from .tables import Table, Text


@dataclasses.dataclass(frozen=True)
class Check:
    """A check with its result.

    - `id`, `name`, `kind`, `clause`: as in the problem file; `is_target`: whether the check is a design
      target
    - `motions`: name of the set of motions; `statistic`: statistic over the set, such as "max"
    - `result`: `"PASS"`, `"FAIL"`, `"UNDECIDED"`, `"NOT VALID"`, `"NOT MADE"` or `"BY OTHERS"`
    - `reason`: why there is no value, why the result is undecided, or a remark on the value; "" for none
    - `violated`: ids of the assumptions that do not hold, such as `"A7"`
    - `limit`, `value`, `error`: limit, value and estimated error of the value [SI]; NaN if missing or
      unknown. If `value` is infinite, `text` states the event that it stands for
    - `text`: text that is shown if the value is not finite, such as "overturned at 5.85 s"; otherwise ""
    - `parts`: "reason", "text" and "location" → the text of this name with its numbers as quantities in SI,
      for the page
    - `state`: meaning of `text` for programs, one of `tables.STATES`; "" without a text
    - `utilisation`: U = value/limit, or limit/value for a minimum [–]. inf if columns or blocks overturn or a
      joint opens under one of the motions, even if the statistic is a finite median, and for a value ≤ 0
      below a minimum; NaN if there is no value
    - `governing`: index of the motion or pulse with the governing value. For a quantile between two values,
      index of the worse one. None if the check was not made or has a single value, and for a mean
    - `location`: storey, joint, mode, block or time of the governing value; "" for none
    - `values`: the values of all motions or pulses; None if the check was not made
    - `weights`: weights of the values in the statistic, with the sum 1; () if the check was not made
    - `sensitivities`: input y → derivative d ln U/d ln y; "motion" is the factor on the motions. If there are
      no derivatives, `no_slopes` is the reason
    - `spread`: input → (U with the input decreased, U with the input increased); empty if not computed. U is
      NaN if the changed input is not valid, or if a scene has no decided answer and the others do not show
      that U > 1
    - `spread_events`: (input, 0 or 1) → event that makes the entry of `spread` for the decreased (0) or the
      increased (1) input infinite, such as "overturned (motion 9)"
    - `laws`: law of impact → (U, result), where violated assumptions are ignored; empty if not computed
    """

    entry: Entry
    kind: Kind
    result: str
    reason: str = ""
    violated: tuple[str, ...] = ()
    value: float = math.nan
    error: float = math.nan
    text: str = ""
    state: str = ""
    utilisation: float = math.nan
    governing: int | None = None
    location: str = ""
    values: Values | None = None
    weights: tuple[float, ...] = ()
    sensitivities: Mapping[str, float] = dataclasses.field(default_factory=dict)
    no_slopes: str = "no derivative"
    parts: Mapping[str, Text] = dataclasses.field(default_factory=dict)
    spread: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    spread_events: Mapping[tuple[str, int], str] = dataclasses.field(default_factory=dict)
    laws: Mapping[str, tuple[float, str]] = dataclasses.field(default_factory=dict)

    @property
    def id(self) -> str:
        return self.entry.id

    @property
    def name(self) -> str:
        return self.entry.keys.name or self.kind.title

    @property
    def clause(self) -> str:
        return self.entry.keys.clause or ""

    @property
    def motions(self) -> str | None:
        return self.entry.motions

    @property
    def statistic(self) -> str:
        return self.entry.keys.statistic

    @property
    def limit(self) -> float:
        return self.entry.limit if self.kind.has_limit else math.nan

    @property
    def is_target(self) -> bool:
        return self.entry.is_target

    @property
    def is_verified(self) -> bool:
        """True if the check passes or is made by others."""
        return self.result in ("PASS", "BY OTHERS")


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """An evaluated problem, from [`rockjax.evaluate`][].

    - `problem`: the problem; `scenes`: its solved scenes (a scene is the structure under one motion)
    - `checks`: a `Check` for every entry of `[[checks]]` and `[[targets]]`
    - `assumptions`: set of motions → id of the assumption, such as `"A7"` → result of its test, or a text
      that states why it was not tested. The result has the fields `violated` (a boolean for each scene),
      `worst`, `text` and `unfinished`. A set is left out if no check of this set has `values`
    - `skipped`: the argument `skip` of `evaluate`
    - `make_tables`: function that returns the tables of an evaluation
    """

    problem: Problem
    scenes: Scenes
    checks: tuple[Check, ...]
    assumptions: Mapping[str, Mapping[str, Outcome | str]]
    skipped: tuple[str, ...]
    make_tables: Callable[[Evaluation], dict[str, Table]]

    @property
    def is_verified(self) -> bool:
        """True if every check passes or is made by others, and at least one passes."""
        return all(y.is_verified for y in self.checks) and any(y.result == "PASS" for y in self.checks)

    @property
    def verdict(self) -> str:
        """The verdict at the top of the report, one or two sentences."""
        return verdict([check.result for check in self.checks])

    @property
    def tables(self) -> dict[str, Table]:
        """All tables of the report: name → table."""
        return self.make_tables(self)


def describe_error(error: Exception) -> str:
    """Return the type and the message of an error."""
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__


def verdict(results: list[str]) -> str:
    """Return the verdict on the results of all checks, for example "Verified: all 14 checks pass."."""
    own_results = [result for result in results if result != "BY OTHERS"]
    others = len(results) - len(own_results)
    count = {word: own_results.count(word) for word in ("PASS", "FAIL", "UNDECIDED", "NOT VALID", "NOT MADE")}
    by_others = f" {others} more {'is' if others == 1 else 'are'} made by others." if others else ""
    if count["PASS"] == len(own_results) and own_results:
        return (
            f"Verified: {'all ' if len(own_results) > 1 else 'the only '}{_checks_pass(len(own_results))}."
            + by_others
        )
    if not own_results:
        return "Not verified: every check is made by others."
    phrases = {
        "PASS": ("passes", "pass"),
        "FAIL": ("fails", "fail"),
        "UNDECIDED": ("is undecided", "are undecided"),
        "NOT VALID": ("is not valid", "are not valid"),
        "NOT MADE": ("was not made", "were not made"),
    }
    parts = [f"{n} {phrases[word][n != 1]}" for word, n in count.items() if n or word == "PASS"]
    total = f"{len(own_results)} checks" if len(own_results) > 1 else "one check"
    return f"Not verified: of {total} {', '.join(parts)}.{by_others}"


def _checks_pass(count: int) -> str:
    return f"{count} checks pass" if count > 1 else "check passes"
