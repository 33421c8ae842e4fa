"""What the keys of problem files may hold: of which kind each is, in words and how to tell."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from ._excitations.pulses import PULSES
from ._parameters import table

# Everything that a file may hold: one file can serve all commands.
DESIGN = ("vary", "minimise", "targets", "starts", "seed", "tolerance", "max_iterations")
MEASURES = ("PGA", "PGV", "Sa", "scale")
FITS = ("capacities", "stripes")
SOURCES = ("kind", "file", "suite", "synthetic")


class Kind(NamedTuple):
    """What a key holds, in words, and whether a value is that."""

    words: str
    holds: Callable[[Any], bool]


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def is_list(value: Any, holds: Callable[[Any], bool]) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and all(map(holds, value))


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_range(value: Any) -> bool:
    return is_list(value, is_number) and len(value) == 2 and value[0] < value[1]


def _number_in(allowed: table.Range) -> Kind:
    words = f"a number {allowed.words}".rstrip()
    return Kind(words, lambda value: is_number(value) and bool(allowed.holds(value)))


NUMBER = Kind("a number", is_number)
POSITIVE = _number_in(table.POSITIVE)
NOT_NEGATIVE = _number_in(table.NOT_NEGATIVE)
NOT_NEGATIVES = Kind("a list of numbers >= 0", lambda value: is_list(value, NOT_NEGATIVE.holds))
ONE_OR_MORE = Kind(
    "a number or a list of numbers", lambda value: is_number(value) or is_list(value, is_number)
)
POSITIVE_RANGE = Kind(
    "two numbers [lowest, highest] with 0 < lowest < highest", lambda value: _is_range(value) and value[0] > 0
)
AMPLITUDES = Kind(
    "two numbers [lowest, highest] with 0 <= lowest < highest",
    lambda value: _is_range(value) and value[0] >= 0,
)
LEVELS = Kind(
    "two numbers [lowest, highest] with 0 < lowest <= highest",
    lambda value: is_list(value, is_number) and len(value) == 2 and 0 < value[0] <= value[1],
)
TEXT = Kind("a text", _is_text)
TEXTS = Kind("a list of texts", lambda value: value in ([], ()) or is_list(value, _is_text))
LABEL = Kind("a whole number or text", lambda value: _is_text(value) or _is_whole(value))
TRUTH = Kind("true or false", lambda value: isinstance(value, bool))
TABLE = Kind("a table", lambda value: isinstance(value, dict))
LAW = Kind("'paper', 'compatible' or a factor in [0, 1]", lambda value: _is_text(value) or is_number(value))


def whole(least: int) -> Kind:
    return Kind(f"a whole number ≥ {least}", lambda value: _is_whole(value) and value >= least)


def one_of(names: Iterable[str]) -> Kind:
    return Kind(f"one of {', '.join(names)}", lambda value: isinstance(value, str) and value in names)


def kind_of(parameter: table.Parameter) -> Kind:
    """What the key of a parameter may hold."""
    if parameter.name == "restitution":
        return LAW
    if parameter.whole:
        return whole(int(parameter.range.low))
    words, holds = _number_in(parameter.range)
    return Kind(f"{words}; {parameter.note}" if parameter.note else words, holds)


def _kinds(parameters: Mapping[str, table.Parameter]) -> dict[str, Kind]:
    return {name: kind_of(parameter) for name, parameter in parameters.items()}


_RATIOS = {name: entry for name, entry in table.STRUCTURE.items() if name not in table.SIDES}
SUPERSTRUCTURE = _kinds({name: y for name, y in _RATIOS.items() if y.place.startswith("superstructure.")})
SUPERSTRUCTURE |= _kinds(table.BUILDING)
_POSITIVES = Kind("a list of numbers > 0", lambda value: is_list(value, POSITIVE.holds))
_SHARES = Kind(
    "a number >= 0 or a list of them", lambda value: NOT_NEGATIVE.holds(value) or NOT_NEGATIVES.holds(value)
)
# Superstructures with rows of numbers: modes, and buildings.
MODES = {"eta": NOT_NEGATIVES, "T": _POSITIVES, "zeta": _SHARES, "residual": NOT_NEGATIVE}
BUILDING = {
    "masses": _POSITIVES,
    "stiffnesses": _POSITIVES,
    "damping": _SHARES,
    "modes": whole(0),
    "heights": _POSITIVES,
}
BY_RATIOS = {
    **_kinds({name: y for name, y in _RATIOS.items() if name not in SUPERSTRUCTURE}),
    "superstructure": TABLE,
}
RESTRAINERS = {name for name, y in _RATIOS.items() if y.place.startswith("restrainers.")}
OF_BUILDINGS = _kinds(table.BUILDING) | {
    "story_masses": _POSITIVES,
    "story_stiffnesses": _POSITIVES,
    "story_heights": _POSITIVES,
    "modes": whole(0),
}
BY_DIMENSIONS = _kinds(table.DIMENSIONS) | OF_BUILDINGS
OPTIONS: dict[str, Kind] = {
    "rtol": POSITIVE,
    "atol": POSITIVE,
    "method": TEXT,
    "engine": TEXT,
    "overturn_ratio": POSITIVE,
    "rest_velocity": POSITIVE,
    "max_steps": whole(1),
    "outputs": TEXTS,
    "history": whole(1),
    "throw": TRUTH,
}
_PANELS: dict[str, Kind] = {
    "pulse": one_of(PULSES),
    "vertical_ratio": NUMBER,
    "frequency_ratio": POSITIVE_RANGE,
    "points": whole(2),
    "eta_over_gamma": NOT_NEGATIVES,
    "T_s": NOT_NEGATIVES,
}
COMMANDS: dict[str, dict[str, Kind]] = {
    "response": {"motion": TEXT, "number": whole(1), "t_end": NUMBER},
    "spectrum": _PANELS | {"acceleration_ratio": AMPLITUDES, "sensitivities": TEXTS},
    "overturning": _PANELS | {"max_acceleration_ratio": POSITIVE, "sensitivities": TEXTS},
    "fragility": {
        "motions": TEXT,
        "measure": one_of(MEASURES),
        "measure_period": POSITIVE,
        "intensity": LEVELS,
        "levels": whole(1),
        "method": one_of(FITS),
        "confidence": Kind("a number in (0, 1)", lambda value: is_number(value) and 0 < value < 1),
        "seed": whole(0),
        "sensitivities": TEXTS,
    },
    "risk": {
        "fragility": TEXT,
        "structure": TEXT,
        "median": NUMBER,
        "dispersion": NUMBER,
        "hazard": TEXT,
        "site": whole(0),
        "years": NUMBER,
    },
    "sweep": {"motion": TEXT, "number": whole(1), "outputs": TEXTS, "chunk": whole(1), "axes": TABLE},
}
_RECORD: dict[str, Kind] = {
    "units": TEXT,
    "dt": POSITIVE,
    "scale": NUMBER,
    "component": LABEL,
    "vertical_ratio": NUMBER,
}
RECORDED: dict[str, tuple[Kind, dict[str, Kind]]] = {
    "file": (TEXT, _RECORD | {"vertical": TEXT, "vertical_component": LABEL}),
    "suite": (TEXT, _RECORD | {"pattern": TEXT, "paired": TRUTH}),
    "synthetic": (
        whole(1),
        {
            "seed": whole(0),
            "dt": POSITIVE,
            "duration": POSITIVE,
            "pga": POSITIVE,
            "omega_g": POSITIVE,
            "zeta_g": POSITIVE,
            "vertical_ratio": NUMBER,
        },
    ),
}
