"""Search for the vertical motion that belongs to a horizontal motion: same station, same event."""

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
    """Return the horizontal motions in their order, each with its vertical component.
    [`rockjax.Motions.paired`][] describes the rules and the errors."""
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
    """Return the key by which motions belong together: station, event and date. If the header states no
    station, the key contains the name of the motion instead."""
    key = [str(motion.metadata.get(name) or "") for name in ("station", "event", "date")]
    return tuple(key) if key[0] else ("", motion.name)


def _match_name(motion: M, vertical: dict[tuple, list[M]]) -> list[M]:
    """Return the vertical motions that match `motion` by name. The list is empty if the header of `motion`
    states a station. A vertical motion matches if its stem, the name without the suffix of the component, is
    the beginning of the name of `motion` and does not divide a number. Only the matches with the longest stem
    are returned."""
    if motion.metadata.get("station"):
        return []
    stems = [(split_name(other.name)[0], other) for others in vertical.values() for other in others]
    stems = [(stem, other) for stem, other in stems if stem and _begins_with(motion.name, stem)]
    longest = max((len(stem) for stem, _ in stems), default=0)
    return [other for stem, other in stems if len(stem) == longest]


def _begins_with(name: str, stem: str) -> bool:
    """Return whether a name begins with a stem that does not divide a number, as A1 does in A10. Three digits
    at the end of the name are an azimuth, such as 140 in E06140."""
    is_divided = re.match(r"\d\d", name[len(stem) - 1 :]) and not re.fullmatch(r"\d{3}", name[len(stem) :])
    return name.startswith(stem) and not is_divided


def _match_depth(motion: M, others: list[M]) -> list[M]:
    """Return the vertical motions among `others`, all from one station, that are from the same depth as
    `motion`. If there is none, or if `others` has only one element, return `others`. In KiK-net, the names of
    components end in 1 in the borehole and in 2 at the surface, so UD1 belongs to EW1."""
    if len(others) < 2:
        return others

    def depth_number(motion: M) -> str:
        words = _component(motion).split()
        return re.search(r"\d*$", words[0] if words else "")[0]  # pyright: ignore[reportOptionalSubscript]

    return [other for other in others if depth_number(other) == depth_number(motion)] or others


def _orient_upwards(motion: M) -> M:
    """Return a vertical motion with upwards positive: if it is positive downwards, its sign is changed."""
    if not points_down(_component(motion) or split_name(motion.name)[1]):
        return motion
    return dataclasses.replace(motion, acceleration=-motion.acceleration)
