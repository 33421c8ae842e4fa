"""Problem files with options: options override the tables of the file; then the models check the result."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rockjax._parameters.table import MOTION, STRUCTURE
from rockjax._problem import models

from ._context import MASSES

if TYPE_CHECKING:
    import rockjax as rj
    from rockjax._motions.motion import Motions
    from rockjax._structures import AbstractSuperstructure

_TOP = tuple(models.Superstructure.model_fields)
_STRUCTURE = [*models.ByRatios.model_fields, *_TOP, *models.ByDimensions.model_fields]
_COLUMN_DIMENSIONS = ("width", "height", "column_mass")
_PULSE = [name for name in models.Pulses.model_fields if name != "vertical_ratio"]
_MOTION = [*models.Pulses.model_fields, *models.Record.model_fields]
_ALTERNATIVES = {name: y.instead_of[0] for name, y in (STRUCTURE | MOTION).items() if len(y.instead_of) == 1}


def problem_file(problem: Path | None, example: str | None) -> Path | None:
    """Return the path of the user's problem file or of an example of rockjax, None if there is neither.

    Raises `ValueError` if both are given.
    """
    if example is None:
        return problem
    if problem is not None:
        raise ValueError(f"--example replaces a problem file; leave out --example or {problem}")
    return Path(__file__).parent.parent / "examples" / f"{example}.toml"


class Request:
    """A problem file (or none) with options that override it.

    - `command`: name of the command, whose table becomes `settings`
    - `path`: path of the problem file, or None
    - `values`: key → value of all options, also by default
    - `explicit`: key → (flag, value) of the options on the command line
    """

    def __init__(
        self,
        command: str,
        path: Path | None,
        values: Mapping[str, Any],
        explicit: Mapping[str, tuple[str, Any]],
    ):
        from rockjax._problem import reading

        self.command, self.path = command, path
        self.values = {name: value for name, value in values.items() if value is not None}
        for name in ("file", "vertical"):  # paths in a problem file are relative to it, these are not
            if name in self.values:
                self.values[name] = str(Path(values[name]).absolute())
        self.flags = {name: flag for name, (flag, _) in explicit.items() if name in values}
        self.table = {} if path is None else reading.load_table(path)
        self.reader = reading.Reader(path, explicit)
        self.keys = getattr(models, command.title(), models.Keys).model_fields  # of the table of the command
        self.merged = self._merged(values)
        self.problem = self.reader.check(models.Problem, self.merged)
        self.settings: Any = getattr(self.problem, command, None)

    def chosen(self, names: Iterable[str]) -> dict[str, Any]:
        """Return the options of these keys that the command line sets."""
        return {name: self.values[name] for name in names if name in self.flags}

    def _merged(self, options: Iterable[str]) -> dict[str, Any]:
        """Return the tables of the file, overridden by the options."""
        merged = dict(self.table)
        if self.command in models.Problem.model_fields:
            own = merged.get(self.command, {})
            merged[self.command] = own | self.chosen(self.keys) if isinstance(own, dict) else own
        else:
            merged |= self.chosen(("starts", "seed"))
        merged["options"] = self._options(merged.get("options", {}))
        if "R" in options:
            merged["structure"] = self._structure(merged.get("structure"))
        if "kind" in options:
            merged["motions"] = self._motions(merged)
        return {name: value for name, value in merged.items() if value is not None}

    def _options(self, values: Any) -> Any:
        """Return each option from the command line, else from the file, else the default of the command."""
        names = [
            name for name in models.Options.model_fields if name in self.values and name not in self.keys
        ]
        explicit = self.chosen(names)
        if not isinstance(values, dict):
            return values
        merged = {name: self.values[name] for name in names} | values | explicit
        if "rtol" in explicit or ("rtol" in names and "atol" not in values):
            merged["atol"] = 0.01 * merged["rtol"] if isinstance(merged["rtol"], float) else None
        return {name: value for name, value in merged.items() if value is not None}

    def _structure(self, table: Any) -> Any:
        """Return the table of the structure, overridden by the options."""
        panels = self.command in ("spectrum", "overturning")  # these set the superstructure themselves
        explicit = self.chosen(name for name in _STRUCTURE if not (panels and name in ("T_s", "zeta")))
        if table is None and not any(name in explicit for name in _COLUMN_DIMENSIONS):
            left_out = ("T_s", "zeta", "stories") if panels else ()
            names = [name for name in _STRUCTURE if name in self.values and name not in left_out]
            return self._by_ratios({}, {name: self.values[name] for name in names}) or None
        if not isinstance(table, dict | None):
            return table
        if table is not None and "column_mass" not in table:
            return self._by_ratios(table, explicit)
        merged = (table or {}) | explicit
        if "zeta" in merged:
            merged["damping"] = merged.pop("zeta")
        return merged

    def _by_ratios(self, table: dict[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the table of a structure by ratios, overridden by values."""
        merged = self._override(table, {name: y for name, y in values.items() if name not in _TOP})
        top = merged.pop("superstructure", {})
        changes = {name: values[name] for name in _TOP if name in values}
        if changes and isinstance(top, dict):
            top = top | changes
            if top.get("T_s") == 0:  # rigid
                if "stories" in self.flags:
                    raise ValueError("--stories needs the period of the building; give --T-s > 0")
                top = {"eta": top["eta"]} if "eta" in top else {}
            if "T_s" not in top and "zeta" not in self.flags:
                top.pop("zeta", None)
            if "eta" not in top and not self.chosen(("T_s", "zeta")):
                top = {}
            if "eta" in changes and top.get("eta") == 0:
                top = {}
        return merged | ({"superstructure": top} if top else {})

    def _override(self, entry: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
        """Return an entry, overridden by values.

        Of two alternative keys, such as `a_p` and `acceleration_ratio`, the one on the command line stays.
        """
        merged = {**entry, **values}
        for pair in _ALTERNATIVES.items():
            given = [name for name in pair if name in self.flags]
            if len(given) == 2:
                raise ValueError(
                    f"{self.flags[pair[0]]} and {self.flags[pair[1]]} are alternatives; give one"
                )
            if given and all(name in merged for name in pair):
                merged.pop(pair[1] if given == [pair[0]] else pair[0])
        return merged

    def _motions(self, merged: Any) -> Any:
        """Return the sets of motions; options override the entries of the chosen set."""
        explicit, sets, own = self.chosen(_MOTION), merged.get("motions", {}), merged[self.command]
        if "file" in explicit:
            merged[self.command] = {**own, "motion": "record", "number": 1}
            return {"record": explicit}
        if not sets:
            pulse = {name: self.values[name] for name in _PULSE if name in self.values}
            return {"pulse": self._override({}, pulse | explicit)}
        name = (
            own.get("motion", next(iter(sets)) if len(sets) == 1 else None) if isinstance(own, dict) else None
        )
        if not explicit or not isinstance(sets, dict) or name not in sets:
            return sets
        entries = sets[name] if isinstance(sets[name], list) else [sets[name]]
        return sets | {
            name: [self._override(entry, explicit) for entry in entries if isinstance(entry, dict)]
        }

    @property
    def changes_motion(self) -> bool:
        """True if options change a motion, or choose one of a set."""
        return bool(self.chosen((*_MOTION, "number")))

    def options(self, **changes: Any) -> rj.Options:
        """Return the options; `changes` are defaults for those that neither file nor command line gives."""
        return self.reader.options(self.problem.options, **changes)

    def podium(self) -> rj.Podium:
        """Return the structure."""
        given, attributes = self.problem.structure, {}  # attributes for the files of the command
        if isinstance(given, models.ByDimensions):
            masses = ("column_mass", "beam_mass", "top_mass", "story_masses")
            kilograms = {f"{name}_kg": y for name, y in given.as_arguments().items() if name in masses}
            attributes = {"columns": given.columns or len(given.positions or (0, 1))} | kilograms
        MASSES.set(attributes)
        return self.reader.structure(given)

    def panels(self) -> Panels:
        """Return podiums for each mass ratio η/γ and each (longest) period T_s, 0 for a rigid top."""
        from rockjax._structures import superstructure_of

        podium, settings = self.podium(), self.settings
        given = {*self.flags, *settings.model_fields_set}
        gamma, eta, top = float(podium.gamma), float(podium.eta), podium.superstructure
        has_structure = "structure" in self.table or isinstance(self.problem.structure, models.ByDimensions)
        if {"eta", "eta_over_gamma"} <= self.flags.keys():
            raise ValueError("--eta and --eta-over-gamma are alternatives; give one")
        if "eta" in self.flags or (has_structure and "eta_over_gamma" not in given):
            ratios, etas = [eta / gamma if gamma else float("inf") if eta else 0.0], [eta]
        else:
            ratios = settings.eta_over_gamma
            etas = [ratio * gamma for ratio in ratios]
        stories = _equal_stories(self.problem.structure) or self.values.get("stories")
        changed = [name for name in ("T_s", "zeta", "eta", "eta_over_gamma") if name in given]
        if has_structure and changed and not stories and top is not None and top.has_mode_axis:
            raise ValueError(
                f"--{changed[0].replace('_', '-')} cannot change a superstructure with several modes or "
                "stories; give equal stories, or change the file"
            )
        period, damping = _longest(top)
        zeta = float(self.values.get("zeta", 0.05) if damping is None or "zeta" in given else damping)
        if has_structure and not changed:
            return Panels([podium], ratios, [period], zeta)
        periods = settings.T_s if not has_structure or "T_s" in given else [period]
        with self.reader.at("structure"):
            tops = [superstructure_of(eta, T or None, zeta, stories) for eta in etas for T in periods]
        return Panels([podium.replace(superstructure=top) for top in tops], ratios, periods, zeta)

    def set_name(self, name: str | None, key: str = "motion") -> str:
        """Return the name of the chosen set of motions."""
        sets = self.problem.motions
        if name is None and len(sets) > 1:
            which = f"{key} is missing: which of {', '.join(sets)}?"
            self.reader.fail(self.command, f"{which} ([{self.command}] {key}, or --{key})")
        return self.reader.require_set(sets, name, f"{self.command}.{key}")

    def motion(self, podium: rj.Podium) -> Any:
        """Return the chosen motion, a record with its name and source."""
        name, number = self.set_name(self.settings.motion), self.settings.number
        found = self.reader.members(self.problem.motions, name, podium)
        holds = f"holds {len(found)} motions"
        if number is None and len(found) > 1:
            selection = f"([{self.command}] number, or --number, 1 to {len(found)})"
            self.reader.fail(f"motions.{name}", f"{holds}: which? {selection}")
        if number is not None and number > len(found):
            self.reader.fail(f"motions.{name}", f"{holds}, there is no number {number}")
        return found[(number or 1) - 1]


class Panels(NamedTuple):
    """Podiums of panels, η/γ outermost."""

    podiums: list[rj.Podium]
    ratios: list[float]
    periods: list[float]  # the longest ones
    zeta: float  # of those


def read_records(reader: Any, paths: list[Path], keys: Mapping[str, Any]) -> Motions:
    """Return the motions of files, folders and tables; `keys` are further keys of their entries."""
    from rockjax._motions.readers import is_table

    entries = []
    for path in paths:
        source = "suite" if path.is_dir() or is_table(path) else "file"
        entry_keys = {name: y for name, y in keys.items() if name != "pattern" or path.is_dir()}
        entries.append({source: str(path.absolute())} | entry_keys)
    return reader.records(reader.check(models.Problem, {"motions": {"files": entries}}).motions, "files")


def _equal_stories(structure: Any) -> int | None:
    """Return the number of equal stories of a structure, None without."""
    return getattr(structure, "stories", None) or getattr(
        getattr(structure, "superstructure", None), "stories", None
    )


def _longest(top: AbstractSuperstructure | None) -> tuple[float, float | None]:
    """Return the longest period of a superstructure [s], 0 if rigid, and the damping ratio of that mode."""
    import numpy as np

    found = None if top is None else top.oscillators
    if found is None:
        return 0.0, None
    periods, damping = np.atleast_1d(found.T_s), np.atleast_1d(found.zeta)
    first = int(np.argmax(periods))
    return float(periods[first]), float(damping[min(first, len(damping) - 1)])
