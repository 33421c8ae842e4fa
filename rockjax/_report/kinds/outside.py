"""Checks of effects that the model does not contain, and checks that others make."""

from __future__ import annotations

import dataclasses
import math

from rockjax._report.entry import BOUNDS, CheckKeys, Entry
from rockjax._report.problem import Problem
from rockjax._report.scenes import Scenes

from .base import Kind, Values


@dataclasses.dataclass(frozen=True)
class OutsideModel(Kind):
    """A check of an effect that the model does not contain. It is never made; `reason` states why."""

    reason: str = ""

    def limit(self, keys: CheckKeys, quantity: str, g: float) -> float:
        # The check is never made, so an entry may leave out the limit.
        is_given = any(getattr(keys, name) is not None for name in BOUNDS)
        return super().limit(keys, quantity, g) if self.has_limit and is_given else math.nan

    def missing(self, entry: Entry, problem: Problem) -> str:
        del entry, problem
        return self.reason

    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, variation: str = "") -> Values:
        raise NotImplementedError


@dataclasses.dataclass(frozen=True)
class ByOthers(OutsideModel):
    """A check that others make. The key `text` states what is checked, and the key `reference` states
    where."""

    def missing(self, entry: Entry, problem: Problem) -> str:
        del problem
        texts = [entry.arguments.get(name) for name in ("text", "reference")]
        return ": ".join(filter(None, texts)) or "Made by others."
