"""Kinds of checks on floors: rotations of contents, and spectral accelerations of oscillators."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from rockjax import _results as results
from rockjax._problem import models
from rockjax._problem.reading import Reader
from rockjax._report.cells import peak_cell, slug
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
    """A check of blocks or oscillators on floors: the largest answer of the named ones, by default of all.

    - `table`: table of the file with the blocks or oscillators; `dim`: dim in datasets of scenes
    - `answer`: name of the answer; `head`: heading of the column of answers
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
    def is_repeated(self) -> bool:
        return True

    def read(self, keys: CheckKeys, reader: Reader, file: models.Problem, podium: Podium) -> dict[str, Any]:
        things = getattr(reader, self.table)(getattr(file, self.table))
        chosen = (getattr(keys, self.table) or list(things)) if things else []
        for name in chosen:
            if name not in things:
                raise ValueError(f"{self.table} must be some of {', '.join(things)}, got {name!r}")
        checked(self.table, podium, tuple(things[name] for name in chosen))
        return {self.table: {name: things[name] for name in chosen}}

    def missing(self, entry: Entry, problem: Problem) -> str:
        if not entry.arguments[self.table]:
            return f"The file has no [[{self.table}]]; give such a table."
        return super().missing(entry, problem)

    def things(self, entry: Entry) -> Mapping[str, Any]:
        return entry.arguments[self.table]

    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, change: str = "") -> Values:
        name, things = str(entry.motions), list(self.things(entry))
        peaks = scenes.peaks(name, law, change)
        data = peaks.sel({self.dim: things})
        answers = np.array(data[self.variable].values, float)
        answers[self._overturned(data)] = np.inf
        worst, rows = np.argmax(answers, axis=-1), np.arange(len(answers))
        errors = np.full(len(answers), np.nan)
        if f"{self.variable}_error" in data:
            errors = data[f"{self.variable}_error"].values[rows, worst]
        places = [things[k] for k in worst]
        result = with_words(scenes, entry, data, answers[rows, worst], errors, places, False)
        words, unanswered = list(result.words), list(result.unanswered)
        code = data[f"{self.dim}_result"].values
        for k in rows:
            if words[k] == "joint opens":  # an infinite answer of a scene that did not overturn
                time = float(data["contents_overturn_time"].values[k, worst[k]])
                words[k] = f"{places[k]} overturned at {time:.2f} s"
            elif not words[k] and (code[k] > results.OVERTURNED).any():
                unanswered[k] = results.NAMES[int(code[k].max())]
            elif not words[k] and np.isinf(errors[k]):
                unanswered[k] = "undecided"
        return result._replace(words=tuple(words), unanswered=tuple(unanswered))

    def _overturned(self, data: xarray.Dataset) -> np.ndarray:
        """Return which blocks overturned, (motions, blocks); oscillators never do."""
        if self.dim == "contents":
            return data["contents_overturned"].values
        return np.zeros(data[self.variable].shape, bool)

    def value_function(self, entry: Entry, scenes: Scenes, case: int) -> LogFunction:
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
        overturned, rows = self._overturned(data), []
        for k, motion in enumerate(scenes.motion_set(name).names):
            cells = []
            for j in range(len(things)):
                value = data[self.variable].values[k, j]
                cells.append(
                    Word(
                        f"overturned at {float(data['contents_overturn_time'].values[k, j]):.2f} s",
                        "overturned",
                    )
                    if overturned[k, j]
                    else peak_cell(data, k, value, self.quantity)
                )
            rows.append((Word(motion), *cells))
        columns = (Column("Motion"), *(Column(f"{self.head}, {y}", self.quantity) for y in things))
        return [Table(f"{self.table}-{slug(name)}", f"{self.title}, set {name}", columns, tuple(rows))]
