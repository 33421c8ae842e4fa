"""Kinds of checks that search for the least factor on a motion, or the least amplitude of a pulse, at which
the columns lift or overturn.

In all of these checks the limit is a minimum.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from rockjax._boundaries.boundary import MAX_ACCELERATION_RATIO, overturning_acceleration
from rockjax._excitations.pulses import PULSES
from rockjax._problem import models
from rockjax._problem.models import require_one
from rockjax._problem.reading import Reader, pulse_periods
from rockjax._report.cells import number_cell, slug
from rockjax._report.derivatives import SlopesFunction, slopes_of
from rockjax._report.entry import CheckKeys, Entry
from rockjax._report.problem import Problem
from rockjax._report.scales import (
    BOUNDARY_ERROR,
    boundary_options,
    just_below,
    least_factor_slopes,
    least_factors,
    start_search,
)
from rockjax._report.scenes import Scenes
from rockjax._report.store import fingerprint
from rockjax._report.tables import Table
from rockjax._structures import Podium, g_tan_alpha
from rockjax._types import Value

from .base import Kind, Values, statistic_of

if TYPE_CHECKING:
    import xarray


def searched_values(
    values: np.ndarray, errors: np.ndarray, end: float, entry: Entry, **fields: Any
) -> Values:
    """Return the `Values` of a search.

    - `values`, `errors`: fields of `Values`, (n,); a value is inf if the search found nothing
    - `end`: largest searched value, in the unit of the values. A value of inf is only known to exceed `end`.
      If the statistic satisfies the limit with inf, but violates it with `end` in place of inf, these values
      count as unanswered
    - `entry`: the entry of the check
    - `fields`: other fields of `Values`
    """
    is_missing = ~np.isfinite(values)
    result = Values(
        values,
        errors,
        locations=("",) * len(values),
        unanswered=("",) * len(values),
        states=tuple("none" if missing else "" for missing in is_missing),
        **fields,
    )
    greatest, least = (
        statistic_of(result._replace(values=y), entry.keys.statistic, True)[0]
        for y in (values, np.where(is_missing, end, values))
    )
    if not greatest >= entry.limit > least:
        return result
    reason = "the limit is beyond the searched range"
    return result._replace(unanswered=tuple(reason if missing else "" for missing in is_missing))


@dataclasses.dataclass(frozen=True)
class ScaleKind(Kind):
    """A check of factors on the motions of a set. The value of a motion is the least factor at which the
    columns lift (`event` = "uplift") or overturn (`event` = "overturning")."""

    event: str = "overturning"

    def start(self, entry: Entry, scenes: Scenes) -> bool:
        return start_search(scenes, str(entry.motions), self.event)

    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, variation: str = "") -> Values:
        del law, variation
        data = least_factors(scenes, str(entry.motions), self.event)
        values = np.asarray(data["factor"], float)
        end = float(data.attrs["limit"])
        texts = tuple("" if np.isfinite(y) else f"no {self.event} up to {end:.3g}" for y in values)
        names = scenes.motion_set(str(entry.motions)).names
        errors = np.asarray(data["error"], float)
        return searched_values(values, errors, end, entry, texts=texts, names=names)

    def slopes_function(self, entry: Entry, scenes: Scenes, case: int) -> SlopesFunction | None:
        return least_factor_slopes(scenes, self.event, str(entry.motions), case)

    def tested_scenes(self, entry: Entry, scenes: Scenes) -> xarray.Dataset | None:
        name = str(entry.motions)
        factors = just_below(least_factors(scenes, name, self.event)["factor"].values)
        return scenes.peaks_with_factors(f"boundary.{name}.{self.event}", name, factors)


@dataclasses.dataclass(frozen=True)
class PulseKind(Kind):
    """A check of the least amplitudes of pulses that overturn the columns, with one value for each period of
    the pulse."""

    def read(self, keys: CheckKeys, reader: Reader, file: models.Problem, podium: Podium) -> dict[str, Any]:
        arguments = super().read(keys, reader, file, podium)
        require_one(arguments, "pulse")
        require_one(arguments, "T_p", "frequency_ratio")
        arguments |= {"pulse": PULSES[arguments["pulse"]], "T_p": pulse_periods(keys, podium)}
        arguments.pop("frequency_ratio", None)
        return arguments

    def quantity_of(self, keys: CheckKeys, file: models.Problem) -> str:
        del file
        return "number" if getattr(keys, "ratio", False) else self.quantity

    def _settings(self, entry: Entry, scenes: Scenes) -> dict[str, Any]:
        """Return the keyword arguments of `overturning_acceleration`."""
        given = {
            name: y for name, y in entry.arguments.items() if name in ("max_acceleration_ratio", "width")
        }
        defaults = {
            "options": boundary_options(scenes.problem),
            "max_acceleration_ratio": MAX_ACCELERATION_RATIO,
        }
        return defaults | given

    def _unit(self, entry: Entry, podium: Podium) -> Value:
        """Return the unit of the amplitudes and of the limit [m/s²]: g tan α if the check has the key
        `ratio`, otherwise 1."""
        return g_tan_alpha(podium.alpha, podium.g) if entry.arguments.get("ratio") else jnp.ones(())

    def _amplitudes(self, entry: Entry, scenes: Scenes) -> np.ndarray:
        """Return the least overturning amplitude for each period, in the unit of the limit. The amplitude is
        inf if no searched amplitude overturns the columns."""
        import xarray

        podium = scenes.problem.podium
        inputs_hash = fingerprint(podium, entry.arguments, scenes.problem.options.overturn_ratio)

        def solve() -> xarray.Dataset:
            cases = range(np.size(entry.arguments["T_p"]))
            amplitudes = [float(self._amplitude(entry, scenes, k, podium)) for k in cases]
            return xarray.Dataset({"amplitude": ("pulse", amplitudes)})

        return scenes.store.get(f"pulses.{entry.id}", inputs_hash, solve)["amplitude"].values

    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, variation: str = "") -> Values:
        del law, variation
        amplitudes = self._amplitudes(entry, scenes)
        end = self._settings(entry, scenes)["max_acceleration_ratio"]
        texts = tuple("" if np.isfinite(y) else f"no overturning up to {end:g} g tan α" for y in amplitudes)
        pulse = entry.arguments["pulse"].__name__
        names = tuple(f"{pulse}, T_p = {y:.4g} s" for y in np.atleast_1d(entry.arguments["T_p"]))
        errors = np.where(np.isfinite(amplitudes), amplitudes * BOUNDARY_ERROR, np.nan)
        podium = scenes.problem.podium
        largest = end * float(g_tan_alpha(podium.alpha, podium.g) / self._unit(entry, podium))
        return searched_values(amplitudes, errors, largest, entry, texts=texts, names=names)

    def slopes_function(self, entry: Entry, scenes: Scenes, case: int) -> SlopesFunction:
        return slopes_of(scenes.problem, lambda podium, logs: self._amplitude(entry, scenes, case, podium))

    def _amplitude(self, entry: Entry, scenes: Scenes, case: int, podium: Podium) -> Value:
        """Return the least overturning amplitude of a pulse, in the unit of the limit.

        - `entry`, `scenes`: the entry, and the scenes of the problem
        - `case`: index of the pulse; `podium`: the structure
        """
        period = float(np.atleast_1d(entry.arguments["T_p"])[case])
        settings, pulse = self._settings(entry, scenes), entry.arguments["pulse"]
        return overturning_acceleration(podium, pulse, period, **settings) / self._unit(entry, podium)

    def tested_scenes(self, entry: Entry, scenes: Scenes) -> xarray.Dataset | None:
        podium = scenes.problem.podium
        end = self._settings(entry, scenes)["max_acceleration_ratio"]
        largest = end * float(g_tan_alpha(podium.alpha, podium.g))
        amplitudes = just_below(self._amplitudes(entry, scenes) * float(self._unit(entry, podium)), largest)
        pulse = entry.arguments["pulse"]
        periods = np.atleast_1d(entry.arguments["T_p"])
        pulses = [pulse(float(a), float(T)) for a, T in zip(amplitudes, periods, strict=True)]
        # No set has the name "", so the outputs that checks of sets need are left out.
        options = scenes.options("")
        return scenes.peaks_under(f"boundary.{entry.id}", options, pulses)

    def scope(self, entry: Entry, problem: Problem) -> str:
        del problem
        count = len(np.atleast_1d(entry.arguments["T_p"]))
        return f"{entry.arguments['pulse'].__name__} pulses, least of {count}"

    def tables(self, entry: Entry, values: Values, scenes: Scenes) -> list[Table]:
        podium = scenes.problem.podium
        unit, threshold = float(self._unit(entry, podium)), float(g_tan_alpha(podium.alpha, podium.g))
        columns = {"Pulse": None, "Least a_p that overturns": "acceleration", "a_p/(g tan α)": "number"}
        rows = [
            (
                name,
                number_cell(y * unit, "acceleration", text=text),
                number_cell(y * unit / threshold, "number", text=text),
            )
            for name, y, text in zip(values.names, values.values, values.texts, strict=True)
        ]
        caption = f"Pulses that overturn the columns, check {entry.id}"
        return [Table.from_rows(f"pulses-{slug(entry.id)}", caption, columns, rows)]
