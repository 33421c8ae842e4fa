"""Entries (tables `[[checks]]` and `[[targets]]` of a problem file), and the keys of all kinds of checks."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from rockjax._problem import models
from rockjax._problem.models import described_as, key

Bound = Annotated[float | str, described_as("a number or a key of this file")]
BOUNDS = ("limit", "at_least", "at_most")


class CheckKeys(models.Keys):
    """Keys that all kinds of checks have."""

    kind: str = key(..., "Kind of the check.")
    id: models.Text | None = key(
        None, "Identifier in the report; by default C1, C2 …, and T1, T2 … for targets."
    )
    name: models.Text | None = key(None, "Name in reports.")
    clause: models.Text | None = key(None, "Clause that asks for the check.")
    motions: str | None = key(None, "Name of a set of motions; by default the only one.")
    statistic: Literal["max", "mean", "median", "p84"] = key("max", "Statistic over the motions of the set.")
    unit: str | None = key(None, "Unit of the limit; by default the SI unit.")
    vertical: bool = key(False, "Whether the motions must have a vertical component.")
    limit: Bound | None = key(None, "Limit in `unit`, or a key that holds it, such as 'joints.friction'.")
    at_least: Bound | None = key(None, "Least permitted value in `unit`, for kinds with a minimum.")
    at_most: Bound | None = key(None, "Largest permitted value in `unit`, for kinds with a maximum.")


@dataclasses.dataclass(frozen=True)
class Entry:
    """An entry of `[[checks]]` or `[[targets]]`.

    - `id`: identifier in the report, such as "C1"; `kind`: name of the kind, such as "peak-rotation"
    - `keys`: pydantic model of the table after validation
    - `arguments`: name → value of the keys that only this kind has, or an object made from the value, such as
      a class of pulses
    - `motions`: name of the set of motions; None for a check without one
    - `quantity`: what the value of the check measures, one of `units.KINDS`
    - `limit`: limit [SI]; 1 if the kind has no limit, and NaN if an entry outside the model gives none or if
      the file does not have the key that is the limit
    - `is_target`: whether the entry is a design target
    """

    id: str
    kind: str
    keys: CheckKeys
    arguments: Mapping[str, Any]
    motions: str | None
    quantity: str
    limit: float
    is_target: bool

    @property
    def uses_hazard_of_file(self) -> bool:
        """True if the check uses the hazard curve of the table `[risk]`, not one of its own."""
        return "hazard" in self.arguments and getattr(self.keys, "hazard", None) is None
