"""Base class of the kinds of checks, such as "peak-rotation".

A scene is the structure under one motion. A case of a check is one of its motions or pulses. The governing
case decides the check. An entry is a table `[[checks]]` or `[[targets]]` of the problem file.
"""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rockjax import _results as results
from rockjax._problem import models
from rockjax._report.derivatives import SlopesFunction
from rockjax._report.entry import BOUNDS, CheckKeys, Entry
from rockjax._report.problem import Problem
from rockjax._report.scenes import Scenes
from rockjax._report.tables import Quantity, Table, Text
from rockjax._report.units import to_si
from rockjax._responses.estimate import SAFETY

if TYPE_CHECKING:
    import xarray

    from rockjax._problem.reading import Reader
    from rockjax._structures import Podium

ROUNDING = 8 * np.finfo(float).eps  # least relative error that a value is assumed to have [–]
STATISTICS = {"max": "largest", "mean": "mean", "median": "median", "p84": "84 % quantile"}
STATISTICS_OF_MINIMA = STATISTICS | {"max": "least", "p84": "16 % quantile"}


class Values(NamedTuple):
    """The n values of a check: one value for each case, or a single value (n = 1) for all cases.

    - `values`: (n,) [SI]; ±inf where a text replaces the number. A scene that did not finish may have NaN
    - `errors`: (n,) estimated errors [SI]; NaN or inf where unknown
    - `texts`: (n,) texts that replace numbers, such as "overturned at 5.85 s"; "" for numbers
    - `locations`: (n,) storey, joint or time of each value; "" for none
    - `unanswered`: for each scene, the reason why it has no decided answer, such as "undecided"; "" if it has
      one. For an estimated probability, the tuple has at most one reason. The tuple is empty for values that
      always have an answer
    - `names`: (n,) names of the cases; empty for a single value for all cases
    - `interval`: lower bound, upper bound [SI] and confidence of an interval for the single value; () if
      unknown
    - `remark`: text that the summary adds to the value, or ""
    - `error_factor`: a check passes only if value ± `error_factor` · error satisfies the limit
    - `states`: (n,) meanings of the texts, from `tables.STATES`; "" for numbers. Empty if all values are
      numbers
    """

    values: np.ndarray
    errors: np.ndarray
    texts: tuple[Text, ...]
    locations: tuple[Text, ...]
    unanswered: tuple[str, ...]
    names: tuple[str, ...]
    remark: str = ""
    error_factor: float = SAFETY
    states: tuple[str, ...] = ()
    interval: tuple[float, ...] = ()


def one_value(value: float, error: float = np.nan, **fields: Any) -> Values:
    """Return the `Values` of a check that has a single value [SI]; `fields`: other fields of `Values`."""
    return Values(
        np.array([value]), np.array([error]), ("",), ("",), fields.pop("unanswered", ()), (), **fields
    )


class Statistic(NamedTuple):
    """A statistic of the n values of a check.

    - `value`: the statistic [SI]; NaN if a value that it needs is NaN
    - `error`: its estimated error [SI]; NaN if no value has a finite error
    - `bounds`: least and largest statistic of the values ± `Values.error_factor` · error [SI]
    - `weights`: (n,) weights of the values in the statistic, with the sum 1
    - `governing`: index of the worst value with a nonzero weight
    """

    value: float
    error: float
    bounds: tuple[float, float]
    weights: np.ndarray
    governing: int

    @property
    def has_one_case(self) -> bool:
        """True if the statistic is one of the values."""
        return np.count_nonzero(self.weights) == 1


def statistic_of(values: Values, statistic: str, is_minimum: bool) -> Statistic:
    """Return a statistic of values.

    - `values`: values of a check. A NaN cannot be the largest or least value, but it makes the mean, the
      median and the quantile NaN
    - `statistic`: "max" (the largest value, or the least for a minimum), "mean", "median" or "p84" (the 84 %
      quantile, or the 16 % quantile for a minimum). Quantiles are interpolated linearly between two values
    - `is_minimum`: whether the value must be at least the limit

    An infinite error makes the bounds of its value infinite. An unknown error (NaN) is replaced by the
    rounding error.
    """
    y = values.values
    finite = np.where(np.isfinite(y), y, 0.0)
    errors = np.where(np.isnan(values.errors), 0.0, values.errors)
    errors = np.where(np.isfinite(y), np.maximum(errors, ROUNDING * np.abs(finite)), 0.0)
    value, weights = _weighted(y, statistic, is_minimum)
    low, high = (
        _weighted(y + sign * values.error_factor * errors, statistic, is_minimum)[0] for sign in (-1, 1)
    )
    error = math.nan
    if np.isfinite(values.errors).any() and math.isfinite(value):
        known = np.where(np.isfinite(values.errors), values.errors, 0.0)
        error = float(weights @ known)
        for shifted, others in (_weighted(y + sign * known, statistic, is_minimum) for sign in (-1, 1)):
            if not np.array_equal(others, weights):  # the errors change which values enter the statistic
                error = max(error, abs(shifted - value))
    used = np.flatnonzero(weights)
    signed = np.where(np.isnan(y), -np.inf, -y if is_minimum else y)
    return Statistic(value, error, (low, high), weights, int(used[np.argmax(signed[used])]))


def _weighted(y: np.ndarray, statistic: str, is_minimum: bool) -> tuple[float, np.ndarray]:
    """Return a statistic of values, and the weights of the values, (n,). Arguments as for `statistic_of`."""
    weights, has_nan = np.zeros(len(y)), bool(np.isnan(y).any())
    if statistic == "max":
        last = math.inf if is_minimum else -math.inf
        weights[(np.argmin if is_minimum else np.argmax)(np.where(np.isnan(y), last, y))] = 1.0
    elif statistic == "mean":
        weights[:] = 1 / len(y)
        return float(np.mean(y)), weights
    else:
        share = {"median": 0.5, "p84": 0.84}[statistic]
        position = (1 - share if is_minimum else share) * (len(y) - 1)
        order, low, high = np.argsort(y, kind="stable"), math.floor(position), math.ceil(position)
        weights[order[low]] = 1 - (position - low)
        weights[order[high]] += position - low
        if has_nan:
            return math.nan, weights
    used = np.flatnonzero(weights)
    return float(np.sum(weights[used] * y[used])), weights


def worst_of(
    y: np.ndarray, errors: np.ndarray, is_minimum: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the worst value of each row, its error, and its column, each (n,).

    The worst value is the largest, or the least for a minimum. Its error covers the other values of the row:
    value ± `SAFETY` · error contains the worst value of the row if each value is wrong by `SAFETY` times its
    own error.

    - `y`, `errors`: values and estimated errors, (n, m). A NaN is the worst value only in a row of NaN
    - `is_minimum`: whether the value must be at least the limit
    """
    sign, rows = -1.0 if is_minimum else 1.0, np.arange(len(y))
    signed = np.where(np.isnan(y), -np.inf, sign * y)
    columns = np.argmax(signed, axis=-1)
    worst = signed[rows, columns]
    reach = np.max(signed + SAFETY * np.where(np.isnan(errors), 0.0, errors), axis=-1)
    with np.errstate(invalid="ignore"):
        other = np.where(np.isfinite(worst), (reach - worst) / SAFETY, np.nan)
    own = errors[rows, columns]
    return y[rows, columns], np.where(other > own, other, own), columns


@dataclasses.dataclass(frozen=True)
class Kind(abc.ABC):
    """A kind of check.

    - `name`: name in problem files; `title`: title on the page
    - `quantity`: what the value measures, one of `units.KINDS`
    - `is_minimum`: whether the value must be at least the limit
    - `section`: number of the section of the page with the details
    - `keys`: keys that only this kind has: name → (type, description)
    - `needs_motions`: whether the check needs a set of motions; `has_limit`: whether it has a limit
    - `has_one_value`: whether the check has a single value for all motions. Then no motion governs, and no
      statistic applies
    - `no_laws`: why the check is not evaluated again with other laws of impact; "" if it is
    - `skip_name`: name in `evaluate(skip=…)` that leaves out checks of this kind; "" if there is no such name
    """

    name: str
    title: str
    quantity: str
    is_minimum: bool = False
    section: int = 4
    keys: Mapping[str, tuple[Any, str]] = dataclasses.field(default_factory=dict)
    needs_motions: bool = True
    has_limit: bool = True
    has_one_value: bool = False
    no_laws: str = ""
    skip_name: str = ""

    def start(self, entry: Entry, scenes: Scenes) -> bool:
        """Start a long computation for an entry in another thread. Return True if its result is not available
        yet; the check of the entry is then evaluated after the others."""
        del entry, scenes
        return False

    # ------------------------------------------------------------------------------------------------ reading
    def read(self, keys: CheckKeys, reader: Reader, file: models.Problem, podium: Podium) -> dict[str, Any]:
        """Return the arguments of an entry, from the keys that only its kind has and from other tables of the
        file.

        - `keys`: table of the entry
        - `reader`, `file`: reader of the problem file, and the tables of the file
        - `podium`: the structure

        Raises `ValueError` for keys that contradict each other.
        """
        del reader, file, podium
        return keys.as_arguments(*CheckKeys.model_fields)

    def quantity_of(self, keys: CheckKeys, file: models.Problem) -> str:
        """Return what the value of an entry measures, one of `units.KINDS`."""
        del keys, file
        return self.quantity

    def uses_motions(self, arguments: Mapping[str, Any]) -> bool:
        """Return whether an entry with these arguments belongs to a set of motions."""
        del arguments
        return self.needs_motions

    def limit(self, keys: CheckKeys, quantity: str, g: float) -> float:
        """Return the limit [SI] of an entry; 1 for kinds without a limit, and NaN for a limit that is a key
        which the file does not have.

        - `keys`: table of the entry; `g`: gravity [m/s²]
        - `quantity`: what the value of the entry measures, one of `units.KINDS`

        An entry gives its limit by the key `limit`, or by `at_least` if the limit is a minimum and by
        `at_most` if it is a maximum. Raises `ValueError` unless the entry has exactly one of these keys.
        Raises `ValueError` also for a wrong unit, for a maximum that is not positive, and for a limit of a
        kind that has none.
        """
        bound = "at_least" if self.is_minimum else "at_most"
        given = {name: getattr(keys, name) for name in BOUNDS if getattr(keys, name) is not None}
        if not self.has_limit:
            if given:
                raise ValueError(f"{self.name} has no limit; leave out {next(iter(given))}")
            return 1.0
        if len(given) != 1:
            raise ValueError(
                f"{self.name} needs exactly one of limit and {bound}, got {' and '.join(given) or 'neither'}"
            )
        ((name, value),) = given.items()
        if name not in ("limit", bound):
            raise ValueError(f"{self.name} takes limit or {bound}, got {name}")
        if isinstance(value, str):
            return math.nan
        if keys.unit is not None:
            value = to_si(value, keys.unit, quantity, g=g, owner="unit", subject=self.name)
        if not self.is_minimum and value <= 0:
            raise ValueError(f"the limit of {self.name} must be > 0, got {value:g} in SI units")
        return value

    def check(self, keys: CheckKeys, uses_motions: bool) -> None:
        """Raise `ValueError` if an entry gives a statistic or motions that do not apply to its kind."""
        if keys.statistic != "max" and (self.has_one_value or not uses_motions):
            raise ValueError(
                f"statistic must be left out: {self.name} does not have a value for each motion of a set"
            )
        if not uses_motions and not self.needs_motions:
            for name in ("motions", "vertical"):
                if getattr(keys, name):
                    raise ValueError(f"{name} must be left out: {self.name} belongs to no set of motions")

    # --------------------------------------------------------------------------------------------- evaluation
    def missing(self, entry: Entry, problem: Problem) -> str:
        """Return a text that states why the check cannot be made and what would make it possible. Return ""
        if the check can be made."""
        reasons = [
            f"The file has no {key}, which is the limit of the check."
            for key in (getattr(entry.keys, name) for name in BOUNDS)
            if isinstance(key, str)
        ]
        if entry.keys.vertical and entry.motions and not problem.motions[entry.motions].has_vertical:
            reasons.append(
                f"Some motions of {entry.motions} have no vertical component; give the set one of the keys "
                "vertical, vertical_ratio and paired."
            )
        return " ".join(reasons)

    def outputs(self, entry: Entry) -> tuple[str, ...]:
        """Return the outputs that the check needs from the scenes of its set of motions."""
        del entry
        return ()

    def on_floors(self, entry: Entry) -> Mapping[tuple[str, str], Any]:
        """Return the blocks or oscillators on floors that the check needs in the scenes of its set: (dim,
        name) → object. `dim` is the dimension of these objects in datasets."""
        del entry
        return {}

    @abc.abstractmethod
    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, variation: str = "") -> Values:
        """Return the values of the check.

        - `entry`: the entry
        - `scenes`: solves and stores scenes
        - `law`: law of impact that replaces the law of the structure; None for no change
        - `variation`: one of `Scenes.variations`, such as "width+"; "" for none
        """

    def slopes_function(self, entry: Entry, scenes: Scenes, case: int) -> SlopesFunction | None:
        """Return a function that computes the value of a case, and its derivatives with respect to the
        logarithms that `derivatives.py` defines. Return None if the value has no derivatives.

        - `case`: index of the motion or pulse
        """
        del entry, scenes, case
        return None

    def known_slopes(self, entry: Entry, scenes: Scenes) -> dict[str, float]:
        """Return parameter y → d ln U/d ln y of a check with a single value, as far as the derivatives are
        known."""
        del entry, scenes
        return {}

    def tested_scenes(self, entry: Entry, scenes: Scenes) -> xarray.Dataset | None:
        """Return the scenes in which the assumptions of the model are tested; None if they are not tested."""
        return scenes.peaks(entry.motions) if entry.motions else None

    @property
    def is_of_joints(self) -> bool:
        """True if the values are forces or friction demands of the joints."""
        return False

    @property
    def has_variants(self) -> bool:
        """True if the check is evaluated again with changed inputs."""
        return False

    # --------------------------------------------------------------------------------------------------- page
    def scope(self, entry: Entry, problem: Problem) -> Text:
        """Return the set of motions and the statistic in words."""
        if not entry.motions:
            return "no motions"
        count = Quantity(len(problem.motions[entry.motions]), "count")
        words = STATISTICS_OF_MINIMA if self.is_minimum else STATISTICS
        if self.has_one_value:
            return f"{entry.motions}, all ", count, " motions"
        return f"{entry.motions}, {words[entry.keys.statistic]} of ", count

    def tables(self, entry: Entry, values: Values, scenes: Scenes) -> list[Table]:
        """Return tables with the details of a check. If several checks return tables of the same name, the
        page shows only the first of these tables."""
        del entry, values, scenes
        return []

    def notices(self, entry: Entry, scenes: Scenes) -> Iterator[Text]:
        """Yield notices for the top of the page."""
        del entry, scenes
        yield from ()


def overturned_at(time: float) -> Text:
    """Return the text of a value that is infinite because something overturned at a time [s]."""
    return "overturned at ", Quantity(time, "time")


def with_texts(
    scenes: Scenes,
    entry: Entry,
    data: Any,
    values: np.ndarray,
    errors: np.ndarray,
    locations: Sequence[Text],
    is_minimum: bool,
) -> Values:
    """Return the `Values` of n scenes. A text replaces the value of a scene in which the columns overturn. If
    they overturn in only one of the two solutions, the value is NaN, and the text is "undecided". If the
    columns do not overturn but the value is infinite, a joint opens, and the text states this.

    - `scenes`, `entry`: the scenes and the entry
    - `data`: dataset of the scenes, whose dimension `motion` has the length n
    - `values`, `errors`, `locations`: fields of `Values`, (n,)
    - `is_minimum`: whether the value must be at least the limit
    """
    texts: list[Text] = []
    states, unanswered = [], unanswered_scenes(data)
    worst = -np.inf if is_minimum else np.inf
    values = np.array(values, float)
    for k, is_overturned in enumerate(np.asarray(data["overturned"])):
        if is_overturned and unanswered[k]:
            values[k] = np.nan
            texts.append(unanswered[k])
            states.append("unanswered")
        elif is_overturned:
            values[k] = worst
            texts.append(overturned_at(float(data["overturn_time"][k])))
            states.append("overturned")
        else:
            state = "joint opens" if values[k] == worst else ""
            texts.append(state)
            states.append(state)
    return Values(
        values,
        np.asarray(errors, float),
        tuple(texts),
        tuple(locations),
        tuple(unanswered),
        scenes.motion_set(str(entry.motions)).names,
        states=tuple(states),
    )


def errors_of(data: Any, variable: str) -> np.ndarray:
    """Return the estimated errors of a variable, in its shape; NaN if the scenes have none."""
    name = f"{variable}_error"
    return np.asarray(data[name], float) if name in data else np.full(data[variable].shape, np.nan)


def unanswered_scenes(data: Any) -> list[str]:
    """Return for each scene why it has no decided answer, such as "undecided"; "" if it has one."""
    undecided = np.asarray(data["undecided"], bool) if "undecided" in data else np.zeros(data.sizes["motion"])
    return [
        results.NAMES[int(code)] if results.did_not_finish(code) else "undecided" if is_undecided else ""
        for code, is_undecided in zip(np.asarray(data["result"]), undecided, strict=True)
    ]
