"""The largest horizontal force on the foundation over a scene."""

from __future__ import annotations

import dataclasses
from typing import Any

from rockjax._engine.bounds import Bounds
from rockjax._engine.joints import mean_forces
from rockjax._types import Flag, Value

from .base import AbstractOutput
from .joints import JointBounds, answered
from .views import Ended, Moment


@dataclasses.dataclass(frozen=True)
class PeakFoundationShear(AbstractOutput):
    """The peak shear on the foundation over the total weight max|V|/W_0, (F5)."""

    name = "peak_foundation_shear"
    unit = "1"
    description = "peak shear on the foundation over the total weight max|V|"
    symbol = "max |V|/W_0"
    needs_flat = True
    of_joints = True

    def quantity(self, moment: Moment) -> Value:
        c, sigma, _, ground, x, v, a = moment
        return mean_forces(c, sigma, ground, x, v, a).foundation[0] / _weight(c)

    def absent(self, ended: Ended) -> dict[str, Any]:
        del ended
        return {}

    def is_final(self, bounds: Bounds, record: Value) -> Flag:
        return JointBounds(bounds).foundation_shear < record * _weight(bounds.c)

    def answer(self, ended: Ended, record: Value, note: Any) -> dict[str, Any]:
        return {self.name: answered(ended, record)}


def _weight(c: Any) -> Value:
    """Return the total weight per N m_c [m/s²]."""
    return (1 + c.joints.gamma + c.eta) * c.g
