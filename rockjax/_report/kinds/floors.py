"""Kinds of checks on floors: rotations of contents (rocking blocks), and spectral accelerations of
oscillators."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from rockjax import _results as results
from rockjax._problem import models
from rockjax._problem.reading import Reader
from rockjax._report.cells import peak_cell, slug, unanswered_cell
from rockjax._report.derivatives import SlopesFunction, slopes_of
from rockjax._report.entry import CheckKeys, Entry
from rockjax._report.problem import Problem
from rockjax._report.scenes import Scenes
from rockjax._report.tables import Column, Table, TextCell, joined
from rockjax._responses.on_floors import as_systems
from rockjax._responses.simulate import peak_response
from rockjax._structures import Podium
from rockjax._types import Value

from .base import Kind, Values, errors_of, overturned_at, with_texts, worst_of

if TYPE_CHECKING:
    import xarray


@dataclasses.dataclass(frozen=True)
class FloorKind(Kind):
    """A check of blocks or oscillators on floors. The value is the largest of their peaks.

    - `table`: name of the tables of the problem file that define the blocks or oscillators. A check lists the
      names of its blocks or oscillators under a key of the same name; by default it has all
    - `dim`: dimension of the blocks or oscillators in datasets
    - `peak`: name of the peak, such as "peak_rotation"; `symbol`: symbol of the peak in headings
    """

    table: str = ""
    dim: str = ""
    peak: str = ""
    symbol: str = ""

    @property
    def variable(self) -> str:
        """Name of the peak in datasets of scenes."""
        return f"{self.dim}_{self.peak}"

    @property
    def has_variants(self) -> bool:
        return True

    def read(self, keys: CheckKeys, reader: Reader, file: models.Problem, podium: Podium) -> dict[str, Any]:
        defined = getattr(reader, self.table)(getattr(file, self.table))
        names = (getattr(keys, self.table) or list(defined)) if defined else []
        for name in names:
            if name not in defined:
                raise ValueError(f"{self.table} must each be one of {', '.join(defined)}, got {name!r}")
        as_systems(self.table, podium, tuple(defined[name] for name in names))
        return {self.table: {name: defined[name] for name in names}}

    def missing(self, entry: Entry, problem: Problem) -> str:
        if not entry.arguments[self.table]:
            return f"The file has no [[{self.table}]]; give such a table."
        return super().missing(entry, problem)

    def on_floors(self, entry: Entry) -> Mapping[tuple[str, str], Any]:
        return {(self.dim, name): y for name, y in entry.arguments[self.table].items()}

    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, variation: str = "") -> Values:
        names = list(entry.arguments[self.table])
        data = scenes.peaks(str(entry.motions), law, variation).sel({self.dim: names})
        peaks = np.array(data[self.variable].values, float)
        peaks[self._overturned(data)] = np.inf
        # A NaN, of a block that did not finish, is not the largest peak.
        values, errors, worst = worst_of(peaks, errors_of(data, self.variable), False)
        locations = [names[k] for k in worst]
        result = with_texts(scenes, entry, data, values, errors, locations, False)
        texts, states, unanswered = list(result.texts), list(result.states), list(result.unanswered)
        codes = data[f"{self.dim}_result"].values
        ratio = f"{self.dim}_remaining_ratio"  # only oscillators have it
        may_grow = (data[ratio].values > 1).any(axis=-1) if ratio in data else np.zeros(len(values), bool)
        for k in range(len(values)):
            # `with_texts` gives this state to every infinite value. Here the block has overturned.
            if states[k] == "joint opens":
                time = float(data["contents_overturn_time"].values[k, worst[k]])
                texts[k] = joined((locations[k], overturned_at(time)), " ")
                states[k] = "overturned"
            elif not texts[k] and results.did_not_finish(codes[k]).any():
                unanswered[k] = results.NAMES[int(codes[k].max())]
            elif not texts[k] and np.isinf(errors[k]):
                unanswered[k] = "undecided"
            elif not texts[k] and may_grow[k]:
                unanswered[k] = "response may still grow after the end"
        return result._replace(texts=tuple(texts), states=tuple(states), unanswered=tuple(unanswered))

    def _overturned(self, data: xarray.Dataset) -> np.ndarray:
        """Return whether each block overturned, (motions, blocks); oscillators never overturn."""
        if self.dim == "contents":
            return data["contents_overturned"].values
        return np.zeros(data[self.variable].shape, bool)

    def slopes_function(self, entry: Entry, scenes: Scenes, case: int) -> SlopesFunction:
        on_floors = tuple(self.on_floors(entry).values())
        options = scenes.problem.options.replace(outputs=("peak_rotation",), throw=False)
        excitation = scenes.motion_set(str(entry.motions)).excitations[case]

        def value(podium: Podium, logs: Any) -> Value:
            scaled = excitation.scaled(jnp.exp(logs[-1]))
            response = peak_response(podium, scaled, options=options, on_floors=on_floors)
            return jnp.max(jnp.stack([getattr(y, self.peak) for y in response.on_floors]))

        return slopes_of(scenes.problem, value)

    def tables(self, entry: Entry, values: Values, scenes: Scenes) -> list[Table]:
        del values
        name, data = str(entry.motions), scenes.peaks(str(entry.motions))
        labels = [str(y) for y in data[self.dim].values]
        overturned, codes, rows = self._overturned(data), data[f"{self.dim}_result"].values, []
        for k, motion in enumerate(scenes.motion_set(name).names):
            cells = []
            for j in range(len(labels)):
                value = data[self.variable].values[k, j]
                cells.append(
                    TextCell(
                        overturned_at(float(data["contents_overturn_time"].values[k, j])),
                        "overturned",
                    )
                    if overturned[k, j]
                    else unanswered_cell(codes[k, j]) or peak_cell(data, k, value, self.quantity)
                )
            rows.append((TextCell(motion), *cells))
        columns = (Column("Motion"), *(Column(f"{self.symbol}, {y}", self.quantity) for y in labels))
        return [Table(f"{self.table}-{slug(name)}", f"{self.title}, set {name}", columns, tuple(rows))]
