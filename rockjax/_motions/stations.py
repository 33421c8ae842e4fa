"""Pairs of horizontal and vertical motions of one station and event."""

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
    """Return the horizontal motions in their order, each with the vertical component, as
    [`rockjax.Motions.paired`][] describes."""
    vertical: dict[tuple, list[M]] = defaultdict(list)
    horizontal: list[M] = []
    for motion in motions:
        if _is_vertical(motion):
            vertical[_station_key(motion)].append(motion)
        else:
            horizontal.append(motion)
    problems, pairs = [], []
    for motion in horizontal:
        matches = _match_depth(motion, vertical.get(_station_key(motion), [])) or _match_name(
            motion, vertical
        )
        if len(matches) == 1:
            pairs.append(dataclasses.replace(motion, vertical=_orient_upwards(matches[0])))
        else:
            names = ", ".join(other.name for other in matches)
            problems.append(f"{motion.name}: " + (f"matches {names}" if names else "has no vertical motion"))
    if problems:
        raise ValueError(
            "\n  ".join(
                [f"paired: {len(problems)} motions do not match exactly one vertical motion", *problems]
            )
        )
    if not pairs:
        raise ValueError("paired: there is no horizontal motion")
    return tuple(pairs)


def _component(motion: Accelerogram) -> str:
    return str(motion.metadata.get("component", "")).strip()


def _is_vertical(motion: Accelerogram) -> bool:
    component = _component(motion)
    return is_vertical(component) if component else split_name(motion.name)[1] != ""


def _station_key(motion: Accelerogram) -> tuple[str, ...]:
    """Return a key for motions that belong together: station, event and date. If the header states no
    station, the key is the name of the motion."""
    key = [str(motion.metadata.get(name) or "") for name in ("station", "event", "date")]
    return tuple(key) if key[0] else ("", motion.name)


def _match_name(motion: M, vertical: dict[tuple, list[M]]) -> list[M]:
    """Return the vertical motions whose stem (name without the component) is a prefix of the name of
    `motion`; if there are several such stems, those with the longest. Empty if the header of the motion
    states a station."""
    if motion.metadata.get("station"):
        return []
    stems = [(split_name(other.name)[0], other) for others in vertical.values() for other in others]
    stems = [(stem, other) for stem, other in stems if stem and motion.name.startswith(stem)]
    longest = max((len(stem) for stem, _ in stems), default=0)
    return [other for stem, other in stems if len(stem) == longest]


def _match_depth(motion: M, others: list[M]) -> list[M]:
    """Return the vertical motions of a station (`others`) from the same depth as `motion`; all of `others` if
    no depth matches. In KiK-net, components that end in 1 are from the borehole, and in 2 from the surface,
    so UD1 belongs to EW1."""
    if len(others) < 2:
        return others

    def depth_number(motion: M) -> str:
        words = _component(motion).split()
        return re.search(r"\d*$", words[0] if words else "")[0]  # pyright: ignore[reportOptionalSubscript]

    return [other for other in others if depth_number(other) == depth_number(motion)] or others


def _orient_upwards(motion: M) -> M:
    """Return a vertical motion that is positive upwards: change the sign if the component points down."""
    if not points_down(_component(motion) or split_name(motion.name)[1]):
        return motion
    return dataclasses.replace(motion, acceleration=-motion.acceleration)
