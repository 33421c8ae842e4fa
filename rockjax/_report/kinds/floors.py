"""Kinds of checks of things on floors: rotations of contents, and spectra of oscillators."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from rockjax import _results as results
from rockjax._problem import models
from rockjax._problem.reading import Reader
from rockjax._report.cells import of_scene, slug
from rockjax._report.derivatives import LogFunction, of_logs
from rockjax._report.entry import CheckKeys, Entry
from rockjax._report.problem import Problem
from rockjax._report.scenes import Scenes
from rockjax._report.tables import Column, Table, Word
from rockjax._responses.on_floors import checked
from rockjax._responses.simulate import peak_response
from rockjax._structures import Podium
from rockjax._types import Value

from .base import Kind, Values, with_words

if TYPE_CHECKING:
    import xarray


@dataclasses.dataclass(frozen=True)
class FloorKind(Kind):
    """A check of things on floors: the largest answer of those that it names, by default of all.

    - `table`: the table of the file that holds them; `dim`: their dim in datasets of scenes
    - `answer`: name of the answer; `head`: heading of its column
    """

    table: str = ""
    dim: str = ""
    answer: str = ""
    head: str = ""

    @property
    def variable(self) -> str:
        """Name of the answer in datasets of scenes."""
        return f"{self.dim}_{self.answer}"

    @property
    def repeats(self) -> bool:
        return True

    def read(self, keys: CheckKeys, reader: Reader, file: models.Problem, podium: Podium) -> dict[str, Any]:
        things = getattr(reader, self.table)(getattr(file, self.table))
        chosen = (getattr(keys, self.table) or list(things)) if things else []
        for name in chosen:
            if name not in things:
                raise ValueError(f"{self.table} must be of {', '.join(things)}, got {name!r}")
        checked(self.table, podium, tuple(things[name] for name in chosen))
        return {self.table: {name: things[name] for name in chosen}}

    def missing(self, entry: Entry, problem: Problem) -> str:
        if not entry.arguments[self.table]:
            return f"The file has no [[{self.table}]]; give what stands on the floors."
        return super().missing(entry, problem)

    def things(self, entry: Entry) -> Mapping[str, Any]:
        return entry.arguments[self.table]

    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, change: str = "") -> Values:
        name, things = str(entry.motions), list(self.things(entry))
        peaks = scenes.peaks(name, law, change)
        data = peaks.sel({self.dim: things})
        every = np.array(data[self.variable].values, float)
        every[self._fallen(data)] = np.inf
        worst, rows = np.argmax(every, axis=-1), np.arange(len(every))
        errors = np.full(len(every), np.nan)
        if f"{self.variable}_error" in data:
            errors = data[f"{self.variable}_error"].values[rows, worst]
        places = [things[k] for k in worst]
        found = with_words(scenes, entry, data, every[rows, worst], errors, places, False)
        words, unanswered = list(found.words), list(found.unanswered)
        code = data[f"{self.dim}_result"].values
        for k in rows:
            if words[k] == "joint opens":  # an infinite answer of a scene that did not overturn
                time = float(data["contents_overturn_time"].values[k, worst[k]])
                words[k] = f"{places[k]} overturned at {time:.2f} s"
            elif not words[k] and (code[k] > results.OVERTURNED).any():
                unanswered[k] = results.NAMES[int(code[k].max())]
            elif not words[k] and np.isinf(errors[k]):
                unanswered[k] = "undecided"
        return found._replace(words=tuple(words), unanswered=tuple(unanswered))

    def _fallen(self, data: xarray.Dataset) -> np.ndarray:
        """Return which things overturned, along motions and things; oscillators do not."""
        if self.dim == "contents":
            return data["contents_overturned"].values
        return np.zeros(data[self.variable].shape, bool)

    def traced(self, entry: Entry, scenes: Scenes, case: int) -> LogFunction:
        things = tuple(self.things(entry).values())
        options = scenes.problem.options.replace(outputs=("peak_rotation",), throw=False)
        excitation = scenes.motion_set(str(entry.motions)).excitations[case]

        def value(podium: Podium, factor: Value) -> Value:
            peak = peak_response(podium, excitation.scaled(factor), options=options, on_floors=things)
            return jnp.max(jnp.stack([getattr(y, self.answer) for y in peak.on_floors]))

        return of_logs(scenes.problem, value)

    def tables(self, entry: Entry, values: Values, scenes: Scenes) -> list[Table]:
        del values
        name, data = str(entry.motions), scenes.peaks(str(entry.motions))
        things = [str(y) for y in data[self.dim].values]
        fallen, rows = self._fallen(data), []
        for k, motion in enumerate(scenes.motion_set(name).names):
            cells = []
            for j in range(len(things)):
                value = data[self.variable].values[k, j]
                cells.append(
                    Word(
                        f"overturned at {float(data['contents_overturn_time'].values[k, j]):.2f} s",
                        "overturned",
                    )
                    if fallen[k, j]
                    else of_scene(data, k, value, self.quantity)
                )
            rows.append((Word(motion), *cells))
        columns = (Column("Motion"), *(Column(f"{self.head}, {y}", self.quantity) for y in things))
        return [Table(f"{self.table}-{slug(name)}", f"{self.title}, set {name}", columns, tuple(rows))]
