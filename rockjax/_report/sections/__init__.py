"""Sections of the page, one module each, in the order of `SECTIONS`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from rockjax._report.blocks import Section
from rockjax._report.units import Units

from . import (
    accuracy,
    assumptions,
    building,
    influences,
    joints,
    methods,
    motions,
    provenance,
    risk,
    rocking,
    structure,
    summary,
)

if TYPE_CHECKING:
    from rockjax._report.evaluation import Evaluation

# Functions (evaluation, units) ↦ section of the page. `units` are the units of pictures and their captions.
# All other numbers of a section are in SI.
SECTIONS: tuple[Callable[[Evaluation, Units], Section], ...] = (
    summary.section,
    structure.section,
    motions.section,
    rocking.section,
    joints.section,
    building.section,
    risk.section,
    influences.section,
    methods.section,
    assumptions.section,
    accuracy.section,
    provenance.section,
)
