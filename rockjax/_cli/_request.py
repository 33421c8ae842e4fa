"""Problem of a command: the tables of a problem file, overridden by command-line options and validated.

A key is the name of an entry in a table of the problem file. An option sets the key of the same name.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rockjax._parameters.registry import MOTION, STRUCTURE
from rockjax._problem import models

from ._context import MASSES

if TYPE_CHECKING:
    import rockjax as rj
    from rockjax._motions.motion import Motions
    from rockjax._structures import AbstractSuperstructure

# Keys of problem files that have options.
_SUPERSTRUCTURE_KEYS = tuple(models.Superstructure.model_fields)
_STRUCTURE_KEYS = [*models.ByRatios.model_fields, *_SUPERSTRUCTURE_KEYS, *models.ByDimensions.model_fields]
# Options of the elevation ↦ keys of `[structure.elevation]`, for structures by ratios.
_ELEVATION_KEYS = {{"columns": "positions"}.get(name, name): name for name in models.Elevation.model_fields}
_COLUMN_DIMENSIONS = ("width", "height", "column_mass")
_PULSE_KEYS = [name for name in models.Pulses.model_fields if name != "vertical_ratio"]
_MOTION_KEYS = [*models.Pulses.model_fields, *models.Record.model_fields]
# Key ↦ alternative key for the same quantity, such as acceleration_ratio ↦ a_p.
_ALTERNATIVES = {name: y.instead_of[0] for name, y in (STRUCTURE | MOTION).items() if len(y.instead_of) == 1}


def problem_file(problem: Path | None, example: str | None) -> Path | None:
    """Return the path of the problem file. Raises `ValueError` if both arguments are given.

    - `problem`: path that the user has given, or None
    - `example`: name of an example of the package, or None. If both arguments are None, the result is None
    """
    if example is None:
        return problem
    if problem is not None:
        raise ValueError(f"--example and a problem file are alternatives; leave out --example or {problem}")
    return Path(__file__).parent.parent / "examples" / f"{example}.toml"


class Request:
    """The problem of a command. Options override the problem file, if there is one.

    The attribute `problem` is the validated problem, and `settings` is the table of the command.

    - `command`: name of the command
    - `path`: path of the problem file; None if there is none
    - `values`: key ↦ value of each option, which may be a default; None if an option has no value
    - `explicit`: key ↦ (flag, value) of each option that the user has given
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
        # Paths in options are relative to the working directory, whereas paths in a problem file are relative
        # to the folder of the file. Therefore paths in options are made absolute.
        for name in ("file", "vertical"):
            if name in self.values:
                self.values[name] = str(Path(values[name]).absolute())
        self.flags = {name: flag for name, (flag, _) in explicit.items() if name in values}
        self.file_tables = {} if path is None else reading.load_table(path)
        # The option --positions sets the key `columns` of `[structure.elevation]`.
        renamed = {"columns": explicit["positions"]} if "positions" in explicit else {}
        self.reader = reading.Reader(path, renamed | dict(explicit))
        # Keys that the table of this command may have in the problem file.
        self.keys = getattr(models, command.title(), models.Keys).model_fields
        self.tables = self._merge(values)
        self.problem = self.reader.check(models.Problem, self.tables)
        self.settings: Any = getattr(self.problem, command, None)

    def option_values(self, names: Iterable[str]) -> dict[str, Any]:
        """Return key ↦ value for those keys in `names` that the user has set on the command line."""
        return {name: self.values[name] for name in names if name in self.flags}

    def _merge(self, option_names: Iterable[str]) -> dict[str, Any]:
        """Return the tables of the problem file, overridden by the options."""
        merged = dict(self.file_tables)
        if self.command in models.Problem.model_fields:
            table = merged.get(self.command, {})
            merged[self.command] = table | self.option_values(self.keys) if isinstance(table, dict) else table
        else:
            merged |= self.option_values(("starts", "seed", "friction"))
        merged["options"] = self._options(merged.get("options", {}))
        if "R" in option_names:  # the command has options of structures
            merged["structure"] = self._structure(merged.get("structure"))
        if "kind" in option_names:  # the command has options of motions
            merged["motions"] = self._motions(merged)
        return {name: value for name, value in merged.items() if value is not None}

    def _options(self, table: Any) -> Any:
        """Return the table `[options]`. For each key, the command line has priority over the file, and the
        file over the default of the command.

        If the command line sets `rtol`, `atol` is 0.01 `rtol`, whatever the file states.
        """
        names = [
            name for name in models.Options.model_fields if name in self.values and name not in self.keys
        ]
        explicit = self.option_values(names)
        if not isinstance(table, dict):
            return table  # an error; `Reader.check` raises it with an explanation
        merged = {name: self.values[name] for name in names} | table | explicit
        if "rtol" in explicit:
            merged["atol"] = 0.01 * merged["rtol"] if isinstance(merged["rtol"], float) else None
        return {name: value for name, value in merged.items() if value is not None}

    def _structure(self, table: Any) -> Any:
        """Return the table of the structure, overridden by the options."""
        # In these two commands, the method `panels` makes the superstructures from T_s and ζ.
        has_panels = self.command in ("spectrum", "overturning")
        explicit = self.option_values(
            name for name in _STRUCTURE_KEYS if not (has_panels and name in ("T_s", "zeta"))
        )
        if table is None and not any(name in explicit for name in _COLUMN_DIMENSIONS):
            excluded = ("T_s", "zeta", "stories") if has_panels else ()
            names = [name for name in _STRUCTURE_KEYS if name in self.values and name not in excluded]
            return self._by_ratios({}, {name: self.values[name] for name in names}) or None
        if not isinstance(table, dict | None):
            return table
        if table is not None and "column_mass" not in table:
            return self._by_ratios(table, explicit)
        merged = (table or {}) | explicit
        if "zeta" in merged:  # in a structure by dimensions, the key of the damping ratio is `damping`
            merged["damping"] = merged.pop("zeta")
        return merged

    def _by_ratios(self, table: dict[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the table of a structure by ratios, overridden by `values`.

        The options of the elevation set the keys of the table `elevation`. Raises `ValueError` for heights
        without positions.

        If `values` contain keys of the superstructure, the superstructure is changed as follows. T_s = 0
        makes it rigid. Values with η = 0 remove it. It is also removed if η is missing, unless the command
        line sets T_s or ζ.
        """
        merged = self._override(
            table,
            {name: y for name, y in values.items() if name not in (*_SUPERSTRUCTURE_KEYS, *_ELEVATION_KEYS)},
        )
        elevation = {key: values[name] for name, key in _ELEVATION_KEYS.items() if name in values}
        if elevation and isinstance(merged.setdefault("elevation", {}), dict):
            merged["elevation"] = merged["elevation"] | elevation
            if "columns" not in merged["elevation"]:
                flag = next(self.flags[name] for name in _ELEVATION_KEYS if name in values)
                raise ValueError(f"{flag} needs the positions of the columns as well; give --positions")
        superstructure = merged.pop("superstructure", {})
        changes = {name: values[name] for name in _SUPERSTRUCTURE_KEYS if name in values}
        if changes and isinstance(superstructure, dict):
            superstructure = superstructure | changes
            if superstructure.get("T_s") == 0:  # rigid
                if "stories" in self.flags:
                    raise ValueError("--stories needs the period of the building; give --T-s > 0, not 0")
                superstructure = {"eta": superstructure["eta"]} if "eta" in superstructure else {}
            if "T_s" not in superstructure and "zeta" not in self.flags:
                superstructure.pop("zeta", None)
            if "eta" not in superstructure and not self.option_values(("T_s", "zeta")):
                superstructure = {}
            if "eta" in changes and superstructure.get("eta") == 0:
                superstructure = {}
        return merged | ({"superstructure": superstructure} if superstructure else {})

    def _override(self, entry: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
        """Return an entry, overridden by `values`.

        Two keys for the same quantity, such as `a_p` and `acceleration_ratio`, are alternatives. If the
        command line sets one of them, the other one is removed. Raises `ValueError` if it sets both.
        """
        merged = {**entry, **values}
        for pair in _ALTERNATIVES.items():
            explicit = [name for name in pair if name in self.flags]
            if len(explicit) == 2:
                raise ValueError(
                    f"{self.flags[pair[0]]} and {self.flags[pair[1]]} are alternatives; give one"
                )
            if explicit and all(name in merged for name in pair):
                merged.pop(pair[1] if explicit == [pair[0]] else pair[0])
        return merged

    def _motions(self, merged: Any) -> Any:
        """Return the sets of motions.

        A record on the command line replaces all sets of the file. Without sets in the file, the options and
        their defaults define a set with one pulse. Otherwise options override the entries of the chosen set.
        """
        explicit, sets, table = (
            self.option_values(_MOTION_KEYS),
            merged.get("motions", {}),
            merged[self.command],
        )
        if "file" in explicit:
            merged[self.command] = {**table, "motion": "record", "number": 1}
            return {"record": explicit}
        if not sets:
            pulse = {name: self.values[name] for name in _PULSE_KEYS if name in self.values}
            return {"pulse": self._override({}, pulse | explicit)}
        only_set = next(iter(sets)) if len(sets) == 1 else None
        name = table.get("motion", only_set) if isinstance(table, dict) else None
        if not explicit or not isinstance(sets, dict) or name not in sets:
            return sets
        entries = sets[name] if isinstance(sets[name], list) else [sets[name]]
        return sets | {
            name: [self._override(entry, explicit) for entry in entries if isinstance(entry, dict)]
        }

    def options(self, **defaults: Any) -> rj.Options:
        """Return the options of the solver. `defaults` are values of keys that neither the command line nor
        the problem file sets. Outputs in the table of the command replace those in `[options]`."""
        given = self.problem.options
        outputs = None if self.settings is None else self.settings.as_arguments().get("outputs")
        if outputs:
            given = given.model_copy(update={"outputs": outputs})
        return self.reader.options(given, **defaults)

    def podium(self) -> rj.Podium:
        """Return the structure. Also sets `MASSES`, the attributes of output files. Raises `ValueError` for
        several heights of a superstructure with a single mass."""
        podium: Any = self._podium()
        top, elevation = podium.superstructure, podium.elevation
        if elevation is not None and elevation.top_height.ndim and getattr(top, "height_count", None) is None:
            self.reader.fail(
                "structure",
                "top_height must be one number for a superstructure without several modes or floors, got "
                f"{elevation.top_height.tolist()}",
            )
        return podium

    def _podium(self) -> rj.Podium:
        """Return the structure, which may still lack its superstructure."""
        structure, attributes = self.problem.structure, {}
        if isinstance(structure, models.ByDimensions):
            masses = ("column_mass", "beam_mass", "top_mass", "story_masses")
            kilograms = {f"{name}_kg": y for name, y in structure.as_arguments().items() if name in masses}
            attributes = {"columns": structure.columns or len(structure.positions or (0, 1))} | kilograms
        MASSES.set(attributes)
        return self.reader.structure(structure)

    def structure(self) -> Any:
        """Return the structure: an `optimise.Dimensions` for a table by dimensions, otherwise the podium.
        Also sets `MASSES`, as `podium` does."""
        from rockjax._structures import Dimensions

        podium, given = self.podium(), self.problem.structure
        return self.reader.structure(given, Dimensions) if isinstance(given, models.ByDimensions) else podium

    def contents(self) -> dict[str, rj.Contents]:
        """Return the blocks on floors in the problem file, by name."""
        return self.reader.contents(self.problem.contents)

    def oscillators(self) -> dict[str, rj.Oscillator]:
        """Return the oscillators on floors in the problem file, by name."""
        return self.reader.oscillators(self.problem.oscillators)

    def panels(self) -> Panels:
        """Return the podiums of a spectrum: one for each mass ratio η/γ and period T_s (0 for rigid).

        There is only one podium if the problem file contains a structure, or if the structure is given by
        dimensions. However, if an option or the table of the command sets η, η/γ, T_s or ζ, these values
        replace the superstructure. Raises `ValueError` for contradictory options, and for options that cannot
        change the superstructure.
        """
        from rockjax._structures import superstructure_of

        podium, settings = self._podium(), self.settings
        explicit_keys = {*self.flags, *settings.model_fields_set}
        gamma, eta, top = float(podium.gamma), float(podium.eta), podium.superstructure
        has_structure = "structure" in self.file_tables or isinstance(
            self.problem.structure, models.ByDimensions
        )
        if {"eta", "eta_over_gamma"} <= self.flags.keys():
            raise ValueError("--eta and --eta-over-gamma are alternatives; give one")
        if "eta" in self.flags or (has_structure and "eta_over_gamma" not in explicit_keys):
            ratios, etas = [eta / gamma if gamma else float("inf") if eta else 0.0], [eta]
        else:
            ratios = settings.eta_over_gamma
            if not gamma and any(ratios):
                raise ValueError(
                    "η/γ needs a beam; give --gamma > 0, or --eta (0 for no superstructure) instead of "
                    "--eta-over-gamma"
                )
            etas = [ratio * gamma for ratio in ratios]
        stories = _equal_stories(self.problem.structure) or self.values.get("stories")
        changed = [name for name in ("T_s", "zeta", "eta", "eta_over_gamma") if name in explicit_keys]
        if has_structure and changed and not stories and top is not None and top.has_mode_axis:
            raise ValueError(
                f"--{changed[0].replace('_', '-')} cannot change a superstructure with several modes or "
                "stories that differ; give equal stories, or change the problem file"
            )
        period, damping = _longest_period(top)
        zeta = float(self.values.get("zeta", 0.05) if damping is None or "zeta" in explicit_keys else damping)
        if has_structure and not changed:
            return Panels([podium], ratios, [period], zeta)
        periods = settings.T_s if not has_structure or "T_s" in explicit_keys else [period]
        modes = getattr(self.problem.structure, "modes", None)  # of a building by dimensions
        with self.reader.errors_at("structure"):
            tops = [superstructure_of(eta, T or None, zeta, stories, modes) for eta in etas for T in periods]
        # The new superstructures do not have the masses that the file states.
        replaced = ("top_mass_kg", "story_masses_kg")
        MASSES.set({name: y for name, y in MASSES.get().items() if name not in replaced})
        return Panels([podium.replace(superstructure=top) for top in tops], ratios, periods, zeta)

    def motion_set_name(self, name: str | None, key: str = "motion") -> str:
        """Return the name of the chosen set of motions.

        - `name`: name of the set, or None for the only set
        - `key`: key of the table of the command that chooses the set; the option has the same name

        Raises `ValueError` if there is no such set, or if `name` is None and there are several sets.
        """
        sets = self.problem.motions
        if name is None and len(sets) > 1:
            self.reader.fail(
                self.command,
                f"the file has several sets of motions; choose one of {', '.join(sets)} by {key} in "
                f"[{self.command}], or by --{key}",
            )
        return self.reader.require_set(sets, name, f"{self.command}.{key}")

    def motion(self, podium: rj.Podium) -> Any:
        """Return the chosen motion of the chosen set. Raises `ValueError` if the number of the motion is
        invalid, or missing although the set has several motions."""
        name, number = self.motion_set_name(self.settings.motion), self.settings.number
        members = self.reader.members(self.problem.motions, name, podium)
        if (number is None and len(members) > 1) or (number is not None and number > len(members)):
            self.reader.fail(
                f"motions.{name}",
                f"number must be from 1 to {len(members)}, got {'none' if number is None else number}; give "
                f"--number, or number in [{self.command}]",
            )
        return members[(number or 1) - 1]

    def motion_or_set(self, podium: rj.Podium, mixed: bool = False) -> Any:
        """Return all motions of the chosen set. Return a single motion if options change one, if a number
        selects one, or if the set has only one. Records are returned as `Motion`, with name and source.

        - `podium`: structure for pulses that are given by ratios
        - `mixed`: whether the set may have motions of several kinds, such as records and pulses

        Raises `ValueError` for motions of several kinds, unless `mixed`.
        """
        from rockjax._motions.convert import group_by_kind
        from rockjax._motions.motion import Motion, Motions
        from rockjax._problem.reading import to_excitation

        sets, name = self.problem.motions, self.settings.motion
        is_single = self.settings.number is not None or bool(self.option_values(_MOTION_KEYS))
        if (name is None and len(sets) > 1) or is_single:
            return self.motion(podium)
        name = self.motion_set_name(name)
        members = self.reader.members(sets, name, podium)
        if len(members) == 1:
            return members[0]
        kinds = group_by_kind([to_excitation(member) for member in members])
        if len(kinds) > 1 and not mixed:
            counts = ", ".join(f"{len(indices)} {kind}" for kind, indices in kinds.items())
            self.reader.fail(
                f"motions.{name}",
                f"`rockjax {self.command}` needs motions of one kind, got {counts}; put each kind into a set "
                f"of its own and choose one by --motion, or choose one motion by --number",
            )
        suite = tuple(member for member in members if isinstance(member, Motion))
        return Motions(suite) if len(suite) == len(members) else members


class Panels(NamedTuple):
    """Podiums of a spectrum, one for each panel of the picture. All periods of the first mass ratio come
    first, then all periods of the second, …"""

    podiums: list[rj.Podium]
    ratios: list[float]  # mass ratios η/γ [–]
    periods: list[float]  # longest periods of the superstructures [s]; 0 if rigid
    zeta: float  # damping ratio of the modes with these periods [–]


def read_records(reader: Any, paths: list[Path], keys: Mapping[str, Any]) -> Motions:
    """Return the motions of files, folders and tables.

    - `reader`: a `rockjax._problem.reading.Reader`, which checks and reads the paths
    - `paths`: the files, folders and tables
    - `keys`: key ↦ value for all these paths, such as `units` and `dt`; `pattern` applies only to folders
    """
    from rockjax._motions.readers import is_table

    entries = []
    for path in paths:
        source = "suite" if path.is_dir() or is_table(path) else "file"
        entry_keys = {name: y for name, y in keys.items() if name != "pattern" or path.is_dir()}
        entries.append({source: str(path.absolute())} | entry_keys)
    return reader.records(reader.check(models.Problem, {"motions": {"files": entries}}).motions, "files")


def _equal_stories(structure: Any) -> int | None:
    """Return the number of stories of a building with equal stories; None for other structures."""
    return getattr(structure, "stories", None) or getattr(
        getattr(structure, "superstructure", None), "stories", None
    )


def _longest_period(superstructure: AbstractSuperstructure | None) -> tuple[float, float | None]:
    """Return the longest period of a superstructure [s], and the damping ratio of the mode with this period
    [–]. Without a superstructure or without modes, return (0, None)."""
    import numpy as np

    oscillators = None if superstructure is None else superstructure.oscillators
    if oscillators is None:
        return 0.0, None
    periods, damping = np.atleast_1d(oscillators.T_s), np.atleast_1d(oscillators.zeta)
    longest = int(np.argmax(periods))
    return float(periods[longest]), float(damping[min(longest, len(damping) - 1)])
