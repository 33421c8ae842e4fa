"""The base class of outputs for stories and floors of buildings."""

from __future__ import annotations

import dataclasses
from typing import Any, Self

import jax.numpy as jnp

from rockjax._structures import Podium, ShearBuilding

from .base import STORIES, AbstractOutput
from .views import Ended


@dataclasses.dataclass(frozen=True)
class AbstractStoryOutput(AbstractOutput):
    """An output of buildings (`ShearBuilding`). Its answer has one value for each story or floor, shape
    (stories,)."""

    axis = STORIES

    stories: int = 0  # number of stories; 0 unless the superstructure is a building
    elastic: bool = True  # whether the superstructure vibrates

    def applies(self, podium: Podium) -> bool:
        return self.of(podium).stories > 0

    def of(self, podium: Podium) -> Self:
        building = podium.superstructure
        return type(self)(building.stories if isinstance(building, ShearBuilding) else 0, podium.vibrates)

    def absent(self, ended: Ended) -> dict[str, Any]:
        return self.in_all_stories(jnp.full_like(ended.t, jnp.nan))

    def in_all_stories(self, value: Any) -> dict[str, Any]:
        """Return an answer with the same value in all stories; no answer if the podium has no stories."""
        return {self.name: jnp.broadcast_to(value, (self.stories,))} if self.stories else {}
