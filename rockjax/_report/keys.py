"""Keys that all checks of a problem file have."""

from __future__ import annotations

from typing import Literal

from rockjax._problem import models
from rockjax._problem.models import key


class CheckKeys(models.Keys):
    """Keys of all checks."""

    kind: str = key(..., "Kind of the check.")
    id: str | None = key(None, "Identifier in the report; by default C1, C2 …, and T1, T2 … for targets.")
    name: str | None = key(None, "Name in the report.")
    clause: str | None = key(None, "Clause that asks for the check.")
    motions: str | None = key(None, "Name of a set of motions.")
    statistic: Literal["max", "mean", "median", "p84"] = key("max", "Statistic over the motions of the set.")
    unit: str | None = key(None, "Unit of the limit; by default the SI unit.")
    vertical: bool = key(False, "Whether the motions must have a vertical component.")
    limit: float | None = key(None, "Limit, in `unit`; at most, or at least for kinds that need a minimum.")
    at_least: float | None = key(None, "Least admissible value, in `unit`.")
    at_most: float | None = key(None, "Largest admissible value, in `unit`.")
