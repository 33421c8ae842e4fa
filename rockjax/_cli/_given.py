"""What a problem file and options ask for together: options are laid over the tables of the file, which one
reader reads."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import typer

from rockjax._parameters.table import BUILDING, DIMENSIONS, MOTION, SIDES, STRUCTURE

from ._options import EXAMPLES, Accuracy, Column, Motion, Panels
from ._run import MASSES, Flags, flag

if TYPE_CHECKING:
    import rockjax as rj
    from rockjax._structures import AbstractSuperstructure

F = TypeVar("F", bound=Flags)

# Parameters of the column itself, of what stands on it, and those that only dimensions have; "zeta" is of
# both.
_COLUMN = tuple(
    name for name, y in STRUCTURE.items() if name not in (*SIDES, "restitution") and "." not in y.place
)
_TOP = tuple(name for name, y in (STRUCTURE | BUILDING).items() if y.place.startswith("superstructure."))
_RATIOS = tuple(name for name in (*_COLUMN, *_TOP) if name not in (*DIMENSIONS, *BUILDING, "zeta"))
_DIMENSIONS = tuple(name for name in DIMENSIONS if name in SIDES or name not in (*STRUCTURE, "damping"))
_PULSE = ("pulse", "acceleration_ratio", "a_p", "T_p", "frequency_ratio")
_RECORD = ("units", "dt", "component", "scale", "vertical")
_EITHER = {name: y.instead_of[0] for name, y in (STRUCTURE | MOTION).items() if len(y.instead_of) == 1}


def numbers(name: str, value: str | list) -> list[float]:
    """Numbers from an option, or from a file."""
    if isinstance(value, list):
        return [float(y) for y in value]
    try:
        return [float(part) for part in value.split(",")]
    except ValueError:
        raise typer.BadParameter(
            f"{flag(name)}: expected numbers separated by commas, got {value!r}"
        ) from None


def ascending(
    option: str, ends: tuple[float, float], least: float = 0.0, open_below: bool = True
) -> tuple[float, float]:
    """The ends of a range, the lowest first. Raises `ValueError` that names the option."""
    low, high = ends
    above = low > least if open_below else low >= least
    if not (above and low < high and math.isfinite(high)):
        sign = "<" if open_below else "<="
        raise ValueError(f"{option}: must have {least:g} {sign} lowest < highest, got {low:g} and {high:g}")
    return low, high


def names(value: str | list) -> list[str]:
    """Names from an option, or from a file."""
    return value if isinstance(value, list) else [name.strip() for name in value.split(",") if name.strip()]


def component(value: str | None) -> int | str | None:
    return int(value) if value is not None and value.isdecimal() else value


def problem_file(problem: Path | None, example: str | None) -> Path | None:
    """The problem file that is meant: one of the user's, or one that comes with rockjax. Raises `ValueError`
    for both."""
    if example is None:
        return problem
    if problem is not None:
        raise ValueError(f"--example: stands for a problem file; {problem} is one already")
    if example not in EXAMPLES:
        raise ValueError(f"--example: must be one of {', '.join(EXAMPLES)}, got {example!r}")
    return Path(__file__).parent.parent / "examples" / f"{example}.toml"


class Given:
    """The tables of a problem file, or none, with options over them. `where` names both for complaints."""

    def __init__(self, command: str, problem: Path | None, *groups: Flags):
        from rockjax._problem import COMMANDS, Reader, load_table

        self.command = command
        self.problem = problem
        self.table: dict[str, Any] = {} if problem is None else load_table(problem)
        over = [flag(name) for group in groups for name in sorted(group.given)]
        self.where = "" if problem is None else f"{problem} with {', '.join(over)}" if over else str(problem)
        self.reader = Reader(problem, self.where)
        self.reader.whole(self.table)
        self.own = self.reader.settings(self.table, command) if command in COMMANDS else {}

    def settings(self, flags: F) -> F:
        """Options of this command, from its table where they do not stand on the command line."""
        fields = {field.name for field in dataclasses.fields(flags) if field.init}
        changes = {name: value for name, value in self.own.items() if name in fields - flags.given}
        changed = dataclasses.replace(flags, **changes)
        changed.given = flags.given | changes.keys()
        return changed

    def options(self, flags: Accuracy | Flags, **defaults) -> rj.Options:
        """Tolerances and method: options, else the file, else what the command takes."""
        given = self.table.get("options", {})
        with self.reader.at("options"):
            if not isinstance(given, dict):
                raise ValueError(f"must be a table, got {given!r}")
        explicit, values = flags.explicit(), flags.values()
        chosen = {name: values[name] for name in ("rtol", "method") if name in values}
        merged = defaults | chosen | given | {name: explicit[name] for name in chosen if name in explicit}
        if "limit" in explicit:
            merged["overturn_ratio"] = explicit["limit"]
        if ("atol" not in given or "rtol" in explicit) and isinstance(merged["rtol"], float):
            merged["atol"] = 0.01 * merged["rtol"]
        return self.reader.options({"options": merged})

    def structure_table(self, flags: Column) -> dict[str, Any]:
        """The table of the structure, options over it."""
        explicit, table = flags.explicit(), self.table.get("structure")
        if isinstance(flags, Panels):  # what stands on the columns is set panel by panel
            explicit = {name: value for name, value in explicit.items() if name not in ("T_s", "zeta")}
        by_dimensions = [name for name in _DIMENSIONS if name in explicit]
        by_ratios = [name for name in _RATIOS if name in explicit]
        if by_dimensions and by_ratios:
            raise ValueError(
                f"{flag(by_ratios[0])} and {flag(by_dimensions[0])}: give the structure by ratios or by "
                f"dimensions, not both"
            )
        if table is None and by_dimensions:
            return _over_dimensions({}, explicit)
        if table is None:
            left_out = ("T_s", "zeta", "stories") if isinstance(flags, Panels) else ()
            values = {
                name: value
                for name, value in flags.values().items()
                if value is not None and name not in left_out
            }
            return _over_ratios({}, values, explicit)
        if not isinstance(table, dict):
            return table
        if "column_mass" in table:
            if by_ratios:
                self.reader.fail(
                    "structure", f"is given by dimensions: {flag(by_ratios[0])} cannot change it"
                )
            return _over_dimensions(table, explicit)
        if by_dimensions:
            self.reader.fail("structure", f"is given by ratios: {flag(by_dimensions[0])} cannot change it")
        return _over_ratios(table, explicit, explicit)

    def podium(self, flags: Column) -> rj.Podium:
        table = self.structure_table(flags)
        MASSES.set(_masses(table))
        return self.reader.structure(table)

    def panels(self, flags: Panels) -> PanelsOf:
        """Podiums for each mass ratio η/γ and each period T_s, 0 for a rigid superstructure, the longest of a
        building."""
        from rockjax._structures import superstructure_of

        podium, swept = self.podium(flags), self.settings(flags)
        gamma, eta, top = float(podium.gamma), float(podium.eta), podium.superstructure
        whole = "structure" in self.table or any(name in flags.given for name in _DIMENSIONS)
        if {"eta", "eta_over_gamma"} <= flags.given:
            raise ValueError("--eta and --eta-over-gamma: give one of them")
        if "eta" in flags.given or (whole and "eta_over_gamma" not in swept.given):
            ratios, etas = [eta / gamma if gamma else float("inf") if eta else 0.0], [eta]
        else:
            ratios = numbers("eta_over_gamma", swept.eta_over_gamma)
            etas = [ratio * gamma for ratio in ratios]
        stories = _alike_stories(self.structure_table(flags)) or flags.values().get("stories")
        of_top = ("T_s", "zeta", "eta", "eta_over_gamma")
        changed = [name for name in of_top if name in flags.given or name in swept.given]
        if whole and changed and not stories and top is not None and top.several:
            raise ValueError(
                f"{flag(changed[0])}: the superstructure has several modes or stories, each with its own "
                "numbers, which no single one can change; give stories that are alike, or change its table"
            )
        period, damping = _longest(top)
        zeta = flags.values()["zeta"] if damping is None or "zeta" in flags.given else damping
        zeta = float(0.05 if zeta is None else zeta)
        if whole and not changed:
            return PanelsOf([podium], ratios, [period], zeta)
        periods = numbers("T_s", swept.T_s) if not whole or "T_s" in swept.given else [period]
        with self.reader.at("structure"):
            tops = [superstructure_of(eta, T or None, zeta, stories) for eta in etas for T in periods]
        return PanelsOf([podium.replace(superstructure=top) for top in tops], ratios, periods, zeta)

    def excitation(self, flags: Motion, podium: rj.Podium) -> rj.AbstractExcitation:
        """The one motion that is meant."""
        import rockjax as rj

        found = self.motion(flags, podium)
        return found.record() if isinstance(found, rj.Motion) else found

    def motion(self, flags: Motion, podium: rj.Podium) -> rj.AbstractExcitation | rj.Motion:
        """The one motion that is meant, a record with its name and source."""
        import rockjax as rj

        found = self._motion(flags, podium)
        if flags.vertical_ratio is None:
            return found
        if isinstance(found, rj.Motion):
            if found.vertical is not None:
                raise ValueError("--vertical-ratio: the motion has a vertical component already")
            return dataclasses.replace(found, vertical=found.scaled(flags.vertical_ratio))
        if isinstance(found, rj.GroundMotion):
            raise ValueError("--vertical-ratio: the motion has a vertical component already")
        return rj.GroundMotion(found, found.scaled(flags.vertical_ratio))

    def _motion(self, flags: Motion, podium: rj.Podium) -> rj.AbstractExcitation | rj.Motion:
        explicit = flags.explicit()
        pulse, record = (
            [name for name in group if name in explicit] for group in (_PULSE, ("record", *_RECORD))
        )
        if pulse and record:
            raise ValueError(f"{flag(record[0])} and {flag(pulse[0])}: give a pulse or a record, not both")
        sets = self.reader.sets(self.table.get("motions", {}))
        if "record" in explicit:
            entry = {"file": str(flags.record and flags.record.absolute())} | _taken(explicit, _RECORD)
            return self.reader.members(entry, "record", podium)[0]
        if not sets:
            if record:
                raise ValueError(f"{flag(record[0])}: is of a record; give --record FILE")
            for name in ("motion", "number"):
                if name in explicit:
                    raise ValueError(
                        f"{flag(name)}: chooses among the motions of a problem file; there are none"
                    )
            start = {
                name: value for name, value in flags.values().items() if name in _PULSE and value is not None
            }
            return self.reader.motion_set(_over({}, start | explicit, explicit, _PULSE), "motion", podium)[0]
        swept = self.settings(flags)
        name = swept.motion
        if name is None:
            if len(sets) > 1:
                self.reader.fail(
                    self.command,
                    f"motion is missing: which of {', '.join(sets)}? ([{self.command}] motion, or --motion)",
                )
            name = next(iter(sets))
        entries = self.reader.set_named(name, f"{self.command}.motion", sets)
        key = f"motions.{name}"
        if pulse or record:
            entry = entries[0] if isinstance(entries, list) and len(entries) == 1 else entries
            if not isinstance(entry, dict) or any(isinstance(value, list) for value in entry.values()):
                self.reader.fail(
                    key, f"holds several motions, which {flag((pulse + record)[0])} cannot change one by one"
                )
            if bool(pulse) != ("kind" in entry):
                kind = "a pulse" if "kind" in entry else "records"
                self.reader.fail(key, f"holds {kind}; {flag((pulse + record)[0])} has no meaning for it")
            entries = _over(entry, explicit, explicit, _PULSE if pulse else _RECORD)
        found = self.reader.members(entries, key, podium)
        number = swept.number
        if number is None and len(found) > 1:
            self.reader.fail(
                key,
                f"holds {len(found)} motions: which? "
                f"([{self.command}] number, or --number, 1 to {len(found)})",
            )
        if number is not None and number > len(found):
            self.reader.fail(key, f"holds {len(found)} motions, there is no number {number}")
        return found[(number or 1) - 1]


class PanelsOf(NamedTuple):
    podiums: list[rj.Podium]
    ratios: list[float]
    periods: list[float]  # the longest ones
    zeta: float  # of those


def _alike_stories(table: Any) -> int | None:
    """The number of stories of a structure's table where they are alike."""
    if not isinstance(table, dict):
        return None
    top = table.get("superstructure")
    return table.get("stories") or (top.get("stories") if isinstance(top, dict) else None)


def _longest(top: AbstractSuperstructure | None) -> tuple[float, float | None]:
    """The longest period of a superstructure, 0 where it is rigid, and the damping of that mode."""
    import numpy as np

    found = None if top is None else top.oscillators
    if found is None:
        return 0.0, None
    periods, damping = np.atleast_1d(found.T_s), np.atleast_1d(found.zeta)
    first = int(np.argmax(periods))
    return float(periods[first]), float(damping[min(first, len(damping) - 1)])


def _taken(values: Mapping[str, Any], wanted: tuple[str, ...]) -> dict[str, Any]:
    taken = {name: values[name] for name in wanted if name in values}
    if isinstance(taken.get("vertical"), Path):
        taken["vertical"] = str(taken["vertical"].absolute())
    return taken | ({"component": component(taken["component"])} if "component" in taken else {})


def _over(
    entry: Mapping[str, Any], values: Mapping[str, Any], explicit: Mapping[str, Any], wanted
) -> dict[str, Any]:
    """An entry with values over it. Of two ways to say the same, the explicit one stays."""
    taken = _taken(values, wanted)
    merged = dict(entry) | {"kind" if name == "pulse" else name: value for name, value in taken.items()}
    for pair in _EITHER.items():
        said = [name for name in pair if name in explicit]
        if len(said) == 2:
            raise ValueError(f"{flag(pair[0])} and {flag(pair[1])}: give one of them")
        if said and all(name in merged for name in pair):
            merged.pop(pair[1] if said == [pair[0]] else pair[0])
    return merged


def _restitution(text: Any) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


def _over_ratios(
    table: Mapping[str, Any], values: Mapping[str, Any], explicit: Mapping[str, Any]
) -> dict[str, Any]:
    merged = _over(table, values, explicit, _COLUMN)
    if "restitution" in values:
        merged["restitution"] = _restitution(values["restitution"])
    top = merged.get("superstructure", {})
    changes = {name: values[name] for name in _TOP if name in values}
    if not changes or not isinstance(top, dict):
        return merged
    top = top | changes
    if top.get("T_s") == 0:  # rigid
        top = {"eta": top["eta"]} if "eta" in top else {}
        if "stories" in explicit:
            raise ValueError("--stories: a building has a period, --T-s > 0")
    if "T_s" not in top and "zeta" not in explicit:
        top.pop("zeta", None)
    if "eta" not in top and not (explicit.keys() & {"T_s", "zeta"}):
        top = {}
    if top.get("eta") == 0 and "eta" in changes:
        top = {}
    merged.pop("superstructure", None)
    return merged | ({"superstructure": top} if top else {})


def _masses(table: Any) -> dict[str, Any]:
    """Number of columns and masses of a structure by dimensions, for the attributes of a file."""
    if not isinstance(table, dict) or "column_mass" not in table:
        return {}
    given = {"columns": 2} | table
    found = {
        f"{name}_kg": given[name]
        for name in ("column_mass", "beam_mass", "top_mass", "story_masses")
        if name in given
    }
    return {"columns": given["columns"]} | found


def _over_dimensions(table: Mapping[str, Any], explicit: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(table) | {name: explicit[name] for name in DIMENSIONS | BUILDING if name in explicit}
    if "zeta" in explicit:
        merged["damping"] = explicit["zeta"]
    if "restitution" in explicit:
        merged["restitution"] = _restitution(explicit["restitution"])
    for name in ("width", "height", "column_mass"):
        if name not in merged:
            raise ValueError(f"{flag(name)} is missing: dimensions need --width, --height and --column-mass")
    return merged
