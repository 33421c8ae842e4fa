"""Reading of problem files: check their tables against the models, and build structures, motions and options.

A table is a dictionary key ↦ value. A model (`models.Keys`) is the pydantic class of a table.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np
from pydantic import ValidationError

from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import GroundMotion
from rockjax._excitations.pulses import PULSES
from rockjax._motions.motion import Motion, Motions
from rockjax._motions.readers import read_motion, read_suite
from rockjax._motions.synthetic import synthetic_motions
from rockjax._options import LEAST_ATOL, Options
from rockjax._parameters.registry import STRUCTURE
from rockjax._parameters.variants import pulse_acceleration, pulse_period
from rockjax._restrainers import KINDS
from rockjax._structures import (
    Contents,
    Elevation,
    Modes,
    Oscillator,
    Podium,
    ShearBuilding,
    superstructure_of,
)
from rockjax._text.reading import read_text

from . import models

K = TypeVar("K", bound=models.Keys)
T = TypeVar("T")


class LocatedError(ValueError):
    """An error whose message already names the file and the key."""


def load_table(path: Path) -> dict[str, Any]:
    """Return the contents of a TOML file as a table. Raises a `ValueError` that names the file, the line and
    the cause."""
    text = read_text(path, utf8_only=True)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        number = re.search(r"at line (\d+)", str(error))
        line = text.splitlines()[int(number[1]) - 1] if number else ""
        cure = "; write decimal commas as points" if re.search(r"=\s*[+-]?\d+,\d", line) else ""
        cure = "; write straight quotes" if re.search("[“”„‘’«»]", line) else cure
        location = f"{path}:{number[1]}" if number else f"{path}"
        raise ValueError(f"{location}: the file is not valid TOML: {error}{cure}") from None


class Reader:
    """Reader of the tables of a problem file. Errors name the file, the key and the cause.

    - `path`: the problem file, or None for tables without a file. Paths in the tables are relative to the
      folder of the file, or to the working directory
    - `options`: key ↦ (flag, value) for keys that the command line has set. An error about such a value names
      the flag instead of the file and the key
    """

    def __init__(self, path: Path | None = None, options: Mapping[str, tuple[str, Any]] | None = None):
        self.folder = Path() if path is None else path.parent
        self.prefix = "" if path is None else f"{path}: "
        self.set_by_options = options or {}

    def option_values(self, names: Iterable[str]) -> dict[str, Any]:
        """Return key ↦ value for the keys in `names` that the command line has set."""
        return {name: self.set_by_options[name][1] for name in names if name in self.set_by_options}

    @contextlib.contextmanager
    def errors_at(self, key: str) -> Iterator[None]:
        """Return a context that replaces a `ValueError` or `TypeError` by a `LocatedError`. Its message also
        names the file and `key`."""
        try:
            yield
        except LocatedError:
            raise
        except (ValueError, TypeError) as error:
            self.fail(key, str(error))

    def fail(self, key: str, reason: str) -> NoReturn:
        """Raise a `LocatedError` with a message that names the file, `key` and `reason`."""
        raise LocatedError(f"{self.prefix}{key}: {reason}")

    def check(self, model: type[K], table: Any, where: str = "") -> K:
        """Return a table as an instance of a model.

        - `model`: class of the model
        - `table`: the table
        - `where`: key of the table in the file, for messages; "" for the file as a whole

        Raises `LocatedError` for the first error in the table.
        """
        try:
            return model.model_validate(table)
        except ValidationError as error:
            key, reason, value = _explain_first_error(error, table)
        flag, chosen = self.set_by_options.get(key.rpartition(".")[2], ("", None))
        if flag and (chosen is value or chosen == value):  # `is` for NaN, which differs from itself
            raise LocatedError(f"{flag}: {reason}")
        # `_explain_first_error` returns the key "file" for the table itself.
        path = [where, *([key] if key != "file" else [])] if where else [key]
        return self.fail(".".join(path), reason)

    def options(self, given: models.Options, **defaults: Any) -> Options:
        """Return the options of the solver. `defaults` are values of keys that neither the command line nor
        the file sets. If only `rtol` is set, `atol` is 0.01 `rtol`. A scene that does not finish raises no
        error, unless the file sets `throw`."""
        arguments: dict[str, Any] = {"throw": False} | defaults | given.as_arguments()
        if "rtol" in arguments and "atol" not in arguments:
            arguments["atol"] = max(0.01 * arguments["rtol"], LEAST_ATOL)
        with self.errors_at("options"):
            return Options(**arguments)

    def structure(
        self,
        given: models.ByRatios | models.ByDimensions,
        by_dimensions: Callable[..., Any] = Podium.from_dimensions,
    ) -> Any:
        """Return the podium of a structure.

        - `given`: the table of the structure, by ratios or by dimensions
        - `by_dimensions`: function that makes the result from the keys of a table of dimensions; by default
          it makes a podium
        """
        parameters = given.as_arguments("superstructure", "elevation")
        with self.errors_at("structure"):
            if isinstance(given, models.ByDimensions):
                return by_dimensions(**parameters)
            if "tan_alpha" in parameters:
                parameters["alpha"] = math.atan(parameters.pop("tan_alpha"))
            devices: dict[str, dict[str, Any]] = {}
            for name in [
                name for name in parameters if STRUCTURE[name].attribute_path.startswith("restrainers.")
            ]:
                _, class_name, field = STRUCTURE[name].attribute_path.split(".")
                devices.setdefault(class_name, {})[field] = parameters.pop(name)
            if "Damper" in devices and "coefficient" not in devices["Damper"]:
                raise ValueError("exponent also needs coefficient, the coefficient of the damper")
            defaults = {"Tendon": {"prestress": 0.0}}
            restrainers = tuple(
                KINDS[name](**defaults.get(name, {}) | devices[name]) for name in KINDS if name in devices
            )
            with self.errors_at("structure.elevation"):
                elevation = given.elevation and Elevation(**given.elevation.as_arguments())
            return Podium(
                **parameters,
                superstructure=self.superstructure(given.superstructure),
                restrainers=restrainers,
                elevation=elevation,
            )

    def superstructure(self, given: Any) -> Any:
        """Return the superstructure of a table. If there is no table, return None."""
        if given is None:
            return None
        classes: dict[type, Callable[..., Any]] = {
            models.Building: ShearBuilding,
            models.ModesOfSuperstructure: Modes,
        }
        with self.errors_at("structure.superstructure"):
            return classes.get(type(given), superstructure_of)(**given.as_arguments())

    def contents(self, given: Iterable[models.Contents]) -> dict[str, Contents]:
        """Return the blocks on floors by name."""
        return self._build_named("contents", given, _contents)

    def oscillators(self, given: Iterable[models.Oscillator]) -> dict[str, Oscillator]:
        """Return the oscillators on floors by name."""
        return self._build_named("oscillators", given, Oscillator)

    def _build_named(self, table: str, given: Iterable[Any], make: Callable[..., T]) -> dict[str, T]:
        """Return the objects that a list of entries describes, by name.

        - `table`: name of the list in the file. Entry k without a name is called `table`-k, counted from 1
        - `given`: the entries
        - `make`: function that makes an object from the keys of an entry

        Raises `LocatedError` for a name that occurs twice.
        """
        objects: dict[str, T] = {}
        for k, entry in enumerate(given):
            with self.errors_at(f"{table}[{k}]"):
                name = entry.name or f"{table}-{k + 1}"
                if name in objects:
                    raise ValueError(f"name must not repeat an earlier name, got {name!r}")
                objects[name] = make(**entry.as_arguments("name"))
        return objects

    def motions(
        self, sets: Mapping[str, models.MotionSet], podium: Podium
    ) -> dict[str, list[AbstractExcitation]]:
        """Return the motions of all sets as lists of excitations, by name of the set.

        - `sets`: all sets by name
        - `podium`: structure for pulses that are given by ratios
        """
        return {name: [to_excitation(y) for y in self.members(sets, name, podium)] for name in sets}

    def members(
        self, sets: Mapping[str, models.MotionSet], name: str, podium: Podium | None
    ) -> list[Motion | AbstractExcitation]:
        """Return the motions of a set: pulses as excitations, and records as `Motion` with name and source.

        - `sets`: all sets by name
        - `name`: name of the set
        - `podium`: structure for pulses that are given by ratios; None if there is none
        """
        motions, is_list = [], isinstance(sets[name], list)
        for k, entry in enumerate(entries_of(sets[name])):
            with self.errors_at(f"motions.{name}[{k}]" if is_list else f"motions.{name}"):
                motions += (
                    _pulses(entry, podium) if isinstance(entry, models.Pulses) else self._records(entry)
                )
        return motions

    def records(self, sets: Mapping[str, models.MotionSet], name: str) -> Motions:
        """Return the records of a set with their names. Raises `LocatedError` if the set contains a pulse."""
        if has_pulses(sets[name]):
            self.fail(f"motions.{name}", "must have records (file, suite or synthetic) here, not pulses")
        return Motions(tuple(self.members(sets, name, None)))  # pyright: ignore[reportArgumentType]

    def require_set(self, sets: Mapping[str, Any], name: str | None, key: str) -> str:
        """Return `name`, after a check that a set of motions has this name. If `name` is None, return the
        name of the only set.

        Raises a `LocatedError` that names `key` if no set has the name. For None, the error is raised unless
        there is exactly one set.
        """
        if name is None and len(sets) == 1:
            return next(iter(sets))
        if name is None or name not in sets:
            got = "" if name is None else f", got {name!r}"
            choice = f"the sets are {', '.join(sets)}" if sets else "there are no sets"
            self.fail(key, f"must name a set under [motions]{got}; {choice}")
        return name

    def _records(self, entry: Any) -> Motions:
        """Return the records of an entry of a set."""
        arguments = entry.as_arguments("vertical_ratio", "paired", "file", "suite", "synthetic")
        if isinstance(entry, models.Synthetic):
            scale = arguments.pop("scale", 1.0)
            motions = synthetic_motions(entry.synthetic, **{"seed": 0} | arguments)
            motions = motions if scale == 1 else motions.map(lambda motion: motion.scaled(scale))
        elif isinstance(entry, models.Suite):
            motions = read_suite(self.folder / entry.suite, **arguments)
        else:
            motions = Motions((self._record(self.folder / entry.file, arguments),))
        if (ratio := entry.vertical_ratio) is not None:
            motions = motions.map(lambda motion: dataclasses.replace(motion, vertical=motion.scaled(ratio)))
        return motions.paired() if getattr(entry, "paired", False) else motions

    def _record(self, path: Path, arguments: dict[str, Any]) -> Motion:
        """Return the record of a file.

        - `path`: path of the file
        - `arguments`: arguments of `read_motion`; also `scale`, and for a vertical component its file
          `vertical` and its channel `vertical_component`
        """
        scale, vertical_file, component = (
            arguments.pop(name, None) for name in ("scale", "vertical", "vertical_component")
        )
        motion = read_motion(path, **arguments)
        if vertical_file is not None:
            vertical = read_motion(self.folder / vertical_file, **arguments | {"component": component})
            motion = dataclasses.replace(motion, vertical=vertical)
        return motion if scale in (None, 1) else motion.scaled(scale)


def _explain_first_error(error: ValidationError, table: Any) -> tuple[str, str, Any]:
    """Return the key, the cause and the invalid value for the first error in a table.

    - `error`: error of pydantic
    - `table`: the table

    The key is "file" if the error concerns the table itself. The value is None if a key is missing, or if the
    kind of an entry is missing or unknown.
    """
    first_error = error.errors(include_url=False)[0]
    location, value, reason = "", table, first_error["msg"].removeprefix("Value error, ")
    for step in first_error["loc"]:  # steps that are not in the table are tags of unions; they are omitted
        if isinstance(value, dict) and step in value:
            location, value = f"{location}.{step}".lstrip("."), value[step]
        elif isinstance(value, list) and isinstance(step, int) and step < len(value):
            location, value = f"{location}[{step}]", value[step]
        elif step == "[key]":  # the error concerns the key, not its value
            value = first_error["input"]
    error_type, context = first_error["type"], first_error.get("ctx", {})
    if error_type == "missing":
        return location or "file", f"{first_error['loc'][-1]} is missing", None
    if error_type == "unknown":
        return f"{location}.{context['key']}".lstrip("."), reason, value[context["key"]]
    if error_type == "union_tag_invalid":
        return f"{location}.kind", f"must be one of {context['expected_tags']}, got {context['tag']!r}", None
    if error_type == "union_tag_not_found":
        return location, "kind is missing", None
    if error_type in ("model_type", "dict_type"):
        reason = "must be a table"
    reason = reason.replace("Input should be", "must be").replace("a valid string", "a string")
    return location or "file", f"{reason}, got {value!r}" if reason.startswith("must") else reason, value


def _contents(**given: Any) -> Contents:
    """Return a block on a floor from its keys: width and height, or alpha and R."""
    return Contents.from_dimensions(**given) if "width" in given else Contents(**given)


def entries_of(motions: models.MotionSet) -> list[Any]:
    """Return the entries of a set of motions."""
    return motions if isinstance(motions, list) else [motions]


def has_pulses(motions: models.MotionSet) -> bool:
    """Return whether a set of motions contains pulses."""
    return any(isinstance(entry, models.Pulses) for entry in entries_of(motions))


def to_excitation(member: Motion | AbstractExcitation) -> AbstractExcitation:
    """Return a member of a set as an excitation."""
    return member.record() if isinstance(member, Motion) else member


def _pulses(entry: models.Pulses, podium: Podium | None) -> list[AbstractExcitation]:
    """Return the pulses of an entry of a set.

    - `entry`: the entry
    - `podium`: structure for pulses that are given by ratios, or None if there is no structure

    Raises `ValueError` for ratios without a structure.
    """
    pulse_class = PULSES[entry.kind]
    a_p = (
        entry.a_p
        if entry.acceleration_ratio is None
        else np.asarray(pulse_acceleration(_require_structure(podium), np.asarray(entry.acceleration_ratio)))
    )
    pairs = np.broadcast_arrays(*np.atleast_1d(a_p, pulse_periods(entry, podium)))
    make = (
        pulse_class
        if entry.vertical_ratio is None
        else GroundMotion.in_proportion(pulse_class, entry.vertical_ratio)
    )
    return [make(float(a), float(T)) for a, T in zip(*pairs, strict=True)]


def pulse_periods(entry: Any, podium: Podium | None) -> Any:
    """Return the periods T_p of the pulses of an entry [s]. The entry gives either T_p or ω_p/p. Here
    ω_p = 2π/T_p is the frequency of the pulse, and p the frequency parameter of the podium."""
    if entry.frequency_ratio is None:
        return entry.T_p
    return pulse_period(float(_require_structure(podium).p), np.asarray(entry.frequency_ratio))


def _require_structure(podium: Podium | None) -> Podium:
    """Return the podium. Raises `ValueError` if there is none."""
    if podium is None:
        raise ValueError("the pulse is given by ratios, which need a table [structure]")
    return podium
