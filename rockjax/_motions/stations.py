"""Grouping of motions by station and event, as components of one ground motion."""

from __future__ import annotations

import dataclasses
import re
from collections import defaultdict
from collections.abc import Sequence
from typing import TypeVar

from .accelerogram import Accelerogram
from .components import is_vertical, points_down, split_name

M = TypeVar("M", bound=Accelerogram)


def pair_motions(motions: Sequence[M]) -> tuple[M, ...]:
    """Return the horizontal motions, each with the vertical one of its station, in the given order."""
    vertical: dict[tuple, list[M]] = defaultdict(list)
    horizontal: list[M] = []
    for motion in motions:
        if _is_vertical(motion):
            vertical[_station(motion)].append(motion)
        else:
            horizontal.append(motion)
    problems, found = [], []
    for motion in horizontal:
        of_station = _match_depth(motion, vertical.get(_station(motion), [])) or _match_name(motion, vertical)
        if len(of_station) == 1:
            found.append(dataclasses.replace(motion, vertical=_orient_upwards(of_station[0])))
        else:
            names = ", ".join(other.name for other in of_station)
            problems.append(
                f"{motion.name}: " + (f"could have {names}" if names else "has no vertical motion")
            )
    if problems:
        raise ValueError(
            "\n  ".join([f"paired: {len(problems)} motions have not one vertical one", *problems])
        )
    if not found:
        raise ValueError("paired: there is no horizontal motion")
    return tuple(found)


def _component(motion: Accelerogram) -> str:
    return str(motion.metadata.get("component", "")).strip()


def _is_vertical(motion: Accelerogram) -> bool:
    component = _component(motion)
    return is_vertical(component) if component else split_name(motion.name)[1] != ""


def _station(motion: Accelerogram) -> tuple[str, ...]:
    """Return station, event and date; the name if the header has no station."""
    description = [str(motion.metadata.get(key) or "") for key in ("station", "event", "date")]
    return tuple(description) if description[0] else ("", motion.name)


def _match_name(motion: M, vertical: dict[tuple, list[M]]) -> list[M]:
    """Return vertical motions whose names differ from this one's only in their ends; of several the most
    similar."""
    if motion.metadata.get("station"):
        return []
    stems = [(split_name(other.name)[0], other) for others in vertical.values() for other in others]
    stems = [(stem, other) for stem, other in stems if stem and motion.name.startswith(stem)]
    longest = max((len(stem) for stem, _ in stems), default=0)
    return [other for stem, other in stems if len(stem) == longest]


def _match_depth(motion: M, others: list[M]) -> list[M]:
    """Return the instrument of the same number at a station (EW1 and UD1, EW2 and UD2)."""
    if len(others) < 2:
        return others
    number = lambda of: re.search(r"\d*$", _component(of).split()[0] if _component(of) else "")
    own = number(motion)
    return [other for other in others if own and (same := number(other)) and same[0] == own[0]] or others


def _orient_upwards(motion: M) -> M:
    """Return the motion with upwards positive: a component that is labelled down changes its sign."""
    if not points_down(_component(motion) or split_name(motion.name)[1]):
        return motion
    return dataclasses.replace(motion, acceleration=-motion.acceleration)
