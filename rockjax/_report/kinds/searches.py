"""Kinds of checks that search for the least factor on a motion, or the least amplitude of a pulse, at which
the columns lift or overturn.

In all of these checks the limit is a minimum.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from rockjax._boundaries.boundary import MAX_ACCELERATION_RATIO, Boundary, acceleration_boundary
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
from rockjax._report.scenes import Scenes, with_given_restitution
from rockjax._report.store import fingerprint
from rockjax._report.tables import Quantity, Table, Text
from rockjax._structures import Podium, g_tan_alpha
from rockjax._types import Value

from .base import Kind, Values, statistic_of

if TYPE_CHECKING:
    import xarray

UNFINISHED = "scenes at lower amplitudes did not finish"


def searched_values(
    values: np.ndarray,
    errors: np.ndarray,
    end: float | np.ndarray,
    entry: Entry,
    is_open: np.ndarray | None = None,
    **fields: Any,
) -> Values:
    """Return the `Values` of a search.

    - `values`, `errors`: fields of `Values`, (n,); a value is inf if the search found nothing
    - `end`: largest searched value, in the unit of the values; a number or (n,). A value is only known to
      exceed `end` if it is inf, or if `is_open` is True for it. If the statistic satisfies the limit with
      these values, but violates it with `end` in their place, they count as unanswered
    - `entry`: the entry of the check
    - `is_open`: whether scenes below each value did not finish, (n,); None if all finished
    - `fields`: other fields of `Values`
    """
    is_missing = ~np.isfinite(values)
    is_open = np.zeros(values.shape, bool) if is_open is None else is_open
    result = Values(
        values,
        errors,
        locations=("",) * len(values),
        unanswered=("",) * len(values),
        states=tuple("none" if missing else "" for missing in is_missing),
        **fields,
    )
    greatest, least = (
        statistic_of(result._replace(values=y), entry.keys.statistic, True).value
        for y in (values, np.where(is_missing | is_open, end, values))
    )
    if not greatest >= entry.limit > least:
        return result
    reasons = np.where(is_missing, "the limit is beyond the searched range", "")
    return result._replace(unanswered=tuple(np.where(is_open, UNFINISHED, reasons).tolist()))


@dataclasses.dataclass(frozen=True)
class ScaleKind(Kind):
    """A check of factors on the motions of a set. The value of a motion is the least factor at which the
    columns lift (`event` = "uplift") or overturn (`event` = "overturning")."""

    event: str = "overturning"

    def start(self, entry: Entry, scenes: Scenes) -> bool:
        return start_search(scenes, str(entry.motions), self.event)

    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, variation: str = "") -> Values:
        del variation
        data = least_factors(scenes, str(entry.motions), self.event, law)
        values = np.asarray(data["factor"], float)
        ends, is_open = data["end"].values, data["is_open"].values.astype(bool)
        texts = tuple(
            "" if np.isfinite(y) else (f"no {self.event} up to ", Quantity(end, "number", is_input=True))
            for y, end in zip(values, ends, strict=True)
        )
        names = scenes.motion_set(str(entry.motions)).names
        errors = np.asarray(data["error"], float)
        return searched_values(values, errors, ends, entry, is_open, texts=texts, names=names)

    def slopes_function(self, entry: Entry, scenes: Scenes, case: int) -> SlopesFunction | None:
        return least_factor_slopes(scenes, self.event, str(entry.motions), case)

    def tested_scenes(self, entry: Entry, scenes: Scenes) -> xarray.Dataset | None:
        name = str(entry.motions)
        data = least_factors(scenes, name, self.event)
        factors = just_below(data["factor"].values, data["end"].values)
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
        """Return the keyword arguments of `acceleration_boundary`."""
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

    def _amplitudes(self, entry: Entry, scenes: Scenes, law: str | None = None) -> xarray.Dataset:
        """Return a dataset along `pulse`, in the unit of the limit: the least overturning `amplitude` for
        each period, and the amplitude `end` up to which all scenes finished. The variable `is_open` is True
        if scenes below `amplitude` did not finish. `amplitude` is inf if no searched amplitude overturns the
        columns. `law`: law of impact that replaces the law of the structure; None for no change."""
        import xarray

        law = law if law in scenes.laws else None
        podium = with_given_restitution(scenes.podium(law))
        inputs_hash = fingerprint(podium, entry.arguments, scenes.problem.options.overturn_ratio)

        def solve() -> xarray.Dataset:
            cases = range(np.size(entry.arguments["T_p"]))
            boundaries = [self._boundary(entry, scenes, k, podium) for k in cases]
            found = [(y.scale, y.finished_to) for y in boundaries]
            unit = float(self._unit(entry, podium))
            amplitude, end = (np.array([float(y) for y in z]) / unit for z in zip(*found, strict=True))
            is_open = np.isfinite(amplitude) & (end < just_below(amplitude))
            data = {"amplitude": amplitude, "end": end, "is_open": is_open}
            return xarray.Dataset({name: ("pulse", y) for name, y in data.items()})

        return scenes.store.get(f"pulses.{entry.id}" + (f".{law}" if law else ""), inputs_hash, solve)

    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, variation: str = "") -> Values:
        del variation
        data = self._amplitudes(entry, scenes, law)
        amplitudes, ends, is_open = (data[name].values for name in ("amplitude", "end", "is_open"))
        podium = scenes.problem.podium
        ratios = ends * float(self._unit(entry, podium) / g_tan_alpha(podium.alpha, podium.g))
        texts = tuple(
            "" if np.isfinite(y) else ("no overturning up to ", Quantity(ratio, "number"), " g tan α")
            for y, ratio in zip(amplitudes, ratios, strict=True)
        )
        pulse = entry.arguments["pulse"].__name__
        names = tuple(f"{pulse}, T_p = {y:.4g} s" for y in np.atleast_1d(entry.arguments["T_p"]))
        errors = np.where(np.isfinite(amplitudes), amplitudes * BOUNDARY_ERROR, np.nan)
        is_open = is_open.astype(bool)
        return searched_values(amplitudes, errors, ends, entry, is_open, texts=texts, names=names)

    def slopes_function(self, entry: Entry, scenes: Scenes, case: int) -> SlopesFunction:
        def amplitude(podium: Podium, logs: Any) -> Value:
            del logs
            return self._boundary(entry, scenes, case, podium).scale / self._unit(entry, podium)

        return slopes_of(scenes.problem, amplitude)

    def _boundary(self, entry: Entry, scenes: Scenes, case: int, podium: Podium) -> Boundary:
        """Return the boundary of overturning under a pulse, whose scale is the least amplitude [m/s²].

        - `entry`, `scenes`: the entry, and the scenes of the problem
        - `case`: index of the pulse; `podium`: the structure
        """
        period = float(np.atleast_1d(entry.arguments["T_p"])[case])
        settings, pulse = self._settings(entry, scenes), entry.arguments["pulse"]
        return acceleration_boundary(podium, pulse, period, **settings)

    def tested_scenes(self, entry: Entry, scenes: Scenes) -> xarray.Dataset | None:
        podium = scenes.problem.podium
        data = self._amplitudes(entry, scenes)
        amplitudes = just_below(data["amplitude"].values, data["end"].values)
        amplitudes = amplitudes * float(self._unit(entry, podium))
        pulse = entry.arguments["pulse"]
        periods = np.atleast_1d(entry.arguments["T_p"])
        pulses = [pulse(float(a), float(T)) for a, T in zip(amplitudes, periods, strict=True)]
        # No set has the name "", so the outputs that checks of sets need are left out.
        options = scenes.options("")
        return scenes.peaks_under(f"boundary.{entry.id}", options, pulses)

    def scope(self, entry: Entry, problem: Problem) -> Text:
        del problem
        count = Quantity(np.size(entry.arguments["T_p"]), "count")
        return f"{entry.arguments['pulse'].__name__} pulses, least of ", count

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
