"""Problems in TOML files: a structure, ground motions, options, and what each command is to do with them.

[structure]                      # by ratios: alpha [rad] or tan_alpha, R [m], gamma, lam, restitution, g …
tan_alpha = 0.15
R = 1.5
gamma = 10.0
superstructure = { eta = 100.0, T_s = 0.5, zeta = 0.05 }   # without T_s a rigid one; optional

# superstructure = { eta = 100.0, T_s = 0.9, stories = 5 }   # … of a building with stories that are alike
# superstructure = { eta = [24.0, 6.0], T = [0.5, 0.15], zeta = 0.05, residual = 1.0 }   # … or of modes
# superstructure = { masses = [3.0, 2.0], stiffnesses = [900.0, 500.0] }   # … or a building, story by story

[structure]                      # … or by dimensions, as Podium.from_dimensions
width = 0.45
height = 3.0
column_mass = 1500.0
beam_mass = 30e3
top_mass = 300e3
period = 0.5

[motions.pulses]                 # sets of motions, by names of your own
kind = "ricker"                  # antisymmetric-ricker, one-sine, one-cosine, half-sine
a_p = [3.0, 4.0]                 # [m/s²], or acceleration_ratio: multiples of g tan α of the structure above
T_p = [0.8, 1.2]                 # [s], or frequency_ratio: ω_p/p of the structure above
                                 # lists of one length go together, a single number goes with all
vertical_ratio = 0.5             # optional, of any motion: its vertical component over the horizontal one

[[motions.records]]              # a set may have several entries
file = "record.csv"              # beside this file; any format that rockjax.read_motion reads
units = "g"                      # or "m/s2", "cm/s2", "gal", "mm/s2"; only where the file does not say it
dt = 0.01                        # only where the file does not say it, as one column does [s]
scale = 1.0                      # optional
component = 1                    # number or name of a channel, where the file has several
[[motions.records]]
suite = "folder"                 # or "suite.csv": all motions that rockjax.read_suite reads from it
pattern = "*.AT2"                # optional, of a folder; as are units, dt, scale and component
[[motions.records]]
synthetic = 20                   # of rockjax.synthetic_motions; optional: seed, dt, duration, pga, omega_g …

[options]                        # optional: rtol, atol, method, … of rockjax.Options
rtol = 1e-8

[response]                       # of `rockjax response`
motion = "pulses"                # which set; optional where there is one
number = 1                       # which motion of it; optional where there is one
t_end = 10.0                     # [s], optional

[spectrum]                       # of `rockjax spectrum`; everything is optional
pulse = "ricker"
frequency_ratio = [1.0, 8.0]     # range of ω_p/p
acceleration_ratio = [1.0, 12.0] # range of a_p/(g tan α)
sensitivities = ["alpha"]        # parameters y of ∂(max|θ|/α)/∂ ln y
points = 100                     # along each axis
eta_over_gamma = [1.0, 5.0]      # one panel for each instead of that of the structure
T_s = [0.0, 0.5]                 # … and for each of these [s], 0 is rigid

[overturning]                    # as [spectrum], without acceleration_ratio
max_acceleration_ratio = 12.0    # end of the search, a_p/(g tan α)
sensitivities = ["alpha"]        # parameters y of d a_ov/d ln y

[fragility]                      # of `rockjax fragility`; everything is optional
motions = "records"              # which set; optional where there is one
measure = "PGA"                  # "PGV", "Sa" with measure_period [s], "scale"
intensity = [0.5, 8.0]           # lowest and highest level, in units of the measure
levels = 20
method = "capacities"            # or "stripes"
confidence = 0.9
seed = 0                         # of --synthetic motions
sensitivities = ["alpha"]        # parameters y of d ln(median)/d ln y

[risk]                           # of `rockjax risk`
hazard = "site.csv"              # beside this file: two columns, such as PGA [g],annual_rate; or OpenQuake's
site = 0                         # row of an OpenQuake file, where it has several
fragility = "curve.nc"           # of `rockjax fragility`, or a model (.xml) with structure = "name" …
median = 3.5                     # … or a lognormal curve: median, in SI units of the hazard, and dispersion
dispersion = 0.4
years = 50.0                     # time in which the probability is wanted, optional

[sweep]                          # of `rockjax sweep`
motion = "records"               # which set; optional where there is one. Several are an axis of their own
outputs = ["peak_rotation"]      # optional
chunk = 100000                   # scenes in a chunk, optional

[sweep.axes]                     # as rockjax.grid: names of the structure and of the motion
alpha = [0.12, 0.15, 0.18]
gamma = { from = 1.0, to = 100.0, points = 7, log = true }

What `rockjax design` reads besides is at the head of optimise/_problem.py.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ._excitations.base import AbstractExcitation
from ._excitations.ground import GroundMotion
from ._excitations.pulses import PULSES, AbstractPulse
from ._motions.motion import Motion, Motions
from ._motions.readers import read_motion, read_suite
from ._motions.synthetic import synthetic_motions
from ._options import Options
from ._parameters.table import STRUCTURE
from ._parameters.variants import pulse_acceleration, pulse_period
from ._problem_keys import (
    BUILDING,
    BY_DIMENSIONS,
    BY_RATIOS,
    COMMANDS,
    DESIGN,
    MODES,
    NUMBER,
    ONE_OR_MORE,
    OPTIONS,
    RECORDED,
    RESTRAINERS,
    SOURCES,
    SUPERSTRUCTURE,
    Kind,
    is_list,
    is_number,
    whole,
)
from ._restrainers import KINDS
from ._restrainers.base import AbstractRestrainer
from ._structures import AbstractSuperstructure, Modes, Podium, ShearBuilding, superstructure_of
from ._text.reading import read_text


class Reported(ValueError):
    """An error that names the file and the key already."""


def load_table(path: Path) -> dict[str, Any]:
    """The table of a TOML file. Raises `ValueError` that names the file and the cause."""
    try:
        return tomllib.loads(read_text(path, utf8_only=True))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: is not TOML: {error}") from None


def axis_values(value: Any) -> np.ndarray:
    """The values of an axis: a list of them, or { from, to, points } with `log` for equal ratios.

    Raises `ValueError` for anything else, and for a range that makes none.
    """
    if is_list(value, is_number):
        return np.asarray(value, float)
    names = {"from", "to", "points", "log"}
    if not isinstance(value, dict) or not {"from", "to", "points"} <= value.keys() <= names:
        raise ValueError(
            f"must be a list of numbers, or {{ from, to, points }} and log = true, got {value!r}"
        )
    low, high, points, log = value["from"], value["to"], value["points"], value.get("log", False)
    if not (is_number(low) and is_number(high) and isinstance(log, bool) and whole(2).holds(points)):
        raise ValueError(
            f"from and to must be numbers, points a whole number ≥ 2, log true or false, got {value!r}"
        )
    if log and not (low > 0 and high > 0):
        raise ValueError(f"equal ratios need from and to > 0, got {low:g} and {high:g}")
    return np.geomspace(low, high, points) if log else np.linspace(low, high, points)


class Reader:
    """Reads tables; every error names the file, the key and the cause.

    - `path`: the file, which others are named relative to; None for tables that come from no file
    - `where`: what complaints begin with, by default the path
    - `by_dimensions`: what is made of a structure that is given by dimensions
    """

    def __init__(
        self,
        path: Path | None = None,
        where: str | None = None,
        by_dimensions: Callable[..., Any] = Podium.from_dimensions,
    ):
        self.folder = Path() if path is None else path.parent
        where = ("" if path is None else str(path)) if where is None else where
        self.prefix = f"{where}: " if where else ""
        self.by_dimensions = by_dimensions

    @contextlib.contextmanager
    def at(self, key: str) -> Iterator[None]:
        try:
            yield
        except Reported:
            raise
        except (ValueError, TypeError) as error:
            raise Reported(f"{self.prefix}{key}: {error}") from None

    def fail(self, key: str, why: str) -> NoReturn:
        raise Reported(f"{self.prefix}{key}: {why}")

    def table(
        self, value, key: str, needed: tuple[str, ...], optional: tuple[str, ...] = ()
    ) -> dict[str, Any]:
        if not isinstance(value, dict):
            self.fail(key, f"must be a table, got {value!r}")
        for name in value:
            if name not in needed + optional:
                self.fail(
                    f"{key}.{name}" if key else name,
                    f"is not known; known are {', '.join(needed + optional)}",
                )
        for name in needed:
            if name not in value:
                self.fail(key or "file", f"{name} is missing")
        return value

    def whole(self, table: dict[str, Any], needed: tuple[str, ...] = ()) -> dict[str, Any]:
        """The table of a whole file."""
        everything = ("structure", "motions", "options", *COMMANDS, *DESIGN)
        return self.table(table, "", needed, tuple(name for name in everything if name not in needed))

    def typed(self, value, key: str, kinds: Mapping[str, Kind]) -> dict[str, Any]:
        """A table of optional keys, each of its kind."""
        return self.entries(self.table(value, key, (), tuple(kinds)), key, kinds)

    def entries(self, table: Mapping[str, Any], key: str, kinds: Mapping[str, Kind]) -> dict[str, Any]:
        """Those of a table's entries that have a kind here, checked."""
        known = {name: entry for name, entry in table.items() if name in kinds}
        for name, entry in known.items():
            if not kinds[name].holds(entry):
                self.fail(f"{key}.{name}" if key else name, f"must be {kinds[name].words}, got {entry!r}")
        return known

    def settings(self, table: Mapping[str, Any], command: str) -> dict[str, Any]:
        """What a file says to a command."""
        return self.typed(table.get(command, {}), command, COMMANDS[command])

    def options(self, table: Mapping[str, Any], **changes) -> Options:
        """The options of a file; `changes` are what it need not say."""
        given = self.typed(table.get("options", {}), "options", OPTIONS)
        chosen: dict[str, Any] = {"throw": False} | changes | given
        with self.at("options"):
            return Options(**chosen)

    def numbers(self, value, key: str) -> np.ndarray:
        if not ONE_OR_MORE.holds(value):
            self.fail(key, f"must be {ONE_OR_MORE.words}, got {value!r}")
        return np.asarray(value, float)

    def structure(self, value) -> Any:
        key = "structure"
        if not isinstance(value, dict):
            self.fail(key, f"must be a table, got {value!r}")
        if "column_mass" in value:
            needed = ("width", "height", "column_mass")
            self.table(value, key, needed, tuple(name for name in BY_DIMENSIONS if name not in needed))
            self.typed(value, key, BY_DIMENSIONS)
            with self.at(key):
                return self.by_dimensions(**value)
        slenderness = [name for name in ("alpha", "tan_alpha") if name in value]
        if len(slenderness) != 1:
            self.fail(key, "needs alpha or tan_alpha with R, or width, height and column_mass")
        needed, either = (slenderness[0], "R"), ("alpha", "tan_alpha")
        self.table(value, key, needed, tuple(name for name in BY_RATIOS if name not in (*needed, *either)))
        numbers = dict(self.typed(value, key, BY_RATIOS))
        if "tan_alpha" in numbers:
            numbers["alpha"] = math.atan(numbers.pop("tan_alpha"))
        if "superstructure" in numbers:
            numbers["superstructure"] = self.superstructure(
                numbers["superstructure"], f"{key}.superstructure"
            )
        with self.at(key):
            restrainers = self.restrainers(numbers)
            return Podium(**numbers, restrainers=restrainers)

    def restrainers(self, numbers: dict[str, Any]) -> tuple[AbstractRestrainer, ...]:
        """The restrainers of the numbers that are theirs, which are taken out."""
        found: dict[str, dict[str, Any]] = {}
        for name in RESTRAINERS & numbers.keys():
            _, kind, field = STRUCTURE[name].place.split(".")
            found.setdefault(kind, {})[field] = numbers.pop(name)
        if "Damper" in found and "coefficient" not in found["Damper"]:
            raise ValueError("exponent needs the coefficient of a damper")
        least = {"Tendon": {"prestress": 0.0}}
        return tuple(
            kind(**least.get(name, {}) | found[name]) for name, kind in KINDS.items() if name in found
        )

    def superstructure(self, value, key: str) -> AbstractSuperstructure:
        rows: Any = {"masses": (ShearBuilding, BUILDING, 2), "T": (Modes, MODES, 2)}
        for name, (kind, keys, count) in rows.items():
            if isinstance(value, dict) and name in value:
                needed, optional = tuple(keys)[:count], tuple(keys)[count:]
                top = self.typed(self.table(value, key, needed, optional), key, keys)
                with self.at(key):
                    return kind(**top)
        top = self.typed(self.table(value, key, ("eta",), ("T_s", "zeta", "stories")), key, SUPERSTRUCTURE)
        for name in ("zeta", "stories"):
            if name in top and "T_s" not in top:
                self.fail(key, f"{name} needs T_s; without it the superstructure is rigid")
        with self.at(key):
            return superstructure_of(**top)

    def motions(self, value, podium: Podium) -> dict[str, list[AbstractExcitation]]:
        """All sets of motions, to simulate with."""
        return {
            name: self.motion_set(entries, f"motions.{name}", podium)
            for name, entries in self.sets(value).items()
        }

    def sets(self, value) -> dict[str, Any]:
        if not isinstance(value, dict):
            self.fail("motions", f"must be tables [motions.name], got {value!r}")
        return value

    def motion_set(self, entries, key: str, podium: Podium) -> list[AbstractExcitation]:
        """The motions of a set, to simulate with."""
        members = self.members(entries, key, podium)
        return [member.record() if isinstance(member, Motion) else member for member in members]

    def members(self, entries, key: str, podium: Podium | None) -> list[Motion | AbstractExcitation]:
        """The motions of a set: pulses, and records with their names and sources.

        `podium`: which ratios of pulses refer to, None where there is none
        """
        found: list[Motion | AbstractExcitation] = []
        for entry, at, source in self._entries(entries, key):
            if source == "kind":
                found += self.pulses(entry, at, podium)
            else:
                found += self.recorded(entry, at, source)
        if not found:
            self.fail(key, "is empty")
        return found

    def recorded_set(self, entries, key: str) -> Motions:
        """A set of records only, with their names."""
        found = []
        for entry, at, source in self._entries(entries, key):
            if source == "kind":
                self.fail(f"{at}.kind", "is of a pulse; only records are wanted: file, suite or synthetic")
            found += list(self.recorded(entry, at, source))
        if not found:
            self.fail(key, "is empty")
        return Motions(tuple(found))

    def _entries(self, entries, key: str) -> Iterator[tuple[dict, str, str]]:
        several = isinstance(entries, list)
        for k, entry in enumerate(entries if several else [entries]):
            at = f"{key}[{k}]" if several else key
            sources = [name for name in SOURCES if isinstance(entry, dict) and name in entry]
            if len(sources) != 1:
                self.fail(
                    at,
                    "needs one of kind (of a pulse), file (of a record), suite (of records) and synthetic "
                    "(how many)",
                )
            yield entry, at, sources[0]

    def pulse(self, value, key: str) -> type[AbstractPulse]:
        if not isinstance(value, str) or value not in PULSES:
            self.fail(key, f"must be one of {', '.join(PULSES)}, got {value!r}")
        return PULSES[value]

    def either(self, entry: dict, key: str, plain: str, ratio: str) -> tuple[np.ndarray, bool]:
        """The numbers of one of two keys, and whether it is the ratio."""
        given = [name for name in (plain, ratio) if name in entry]
        if len(given) != 1:
            self.fail(key, f"needs {plain} or {ratio}")
        return self.numbers(entry[given[0]], f"{key}.{given[0]}"), given[0] == ratio

    def periods(self, entry: dict, key: str, podium: Podium | None) -> np.ndarray:
        numbers, ratio = self.either(entry, key, "T_p", "frequency_ratio")
        if not (numbers > 0).all():
            name = "frequency_ratio" if ratio else "T_p"
            self.fail(f"{key}.{name}", f"must be > 0, got {entry[name]!r}")
        return pulse_period(float(self.needed(podium, key).p), numbers) if ratio else numbers

    def needed(self, podium: Podium | None, key: str) -> Podium:
        """The podium that ratios refer to."""
        if podium is None:
            self.fail(key, "is given by ratios, which need a table [structure]")
        return podium

    def pulses(self, entry: dict, key: str, podium: Podium | None) -> list[AbstractExcitation]:
        keys = ("a_p", "acceleration_ratio", "T_p", "frequency_ratio", "vertical_ratio")
        self.table(entry, key, ("kind",), keys)
        vertical = self.entries(entry, key, {"vertical_ratio": NUMBER}).get("vertical_ratio")
        kind = self.pulse(entry["kind"], f"{key}.kind")
        a_p, ratio = self.either(entry, key, "a_p", "acceleration_ratio")
        a_p = np.asarray(pulse_acceleration(self.needed(podium, key), a_p)) if ratio else a_p
        T_p = self.periods(entry, key, podium)
        if a_p.size > 1 and T_p.size > 1 and a_p.size != T_p.size:
            self.fail(key, f"has {len(a_p)} amplitudes and {len(T_p)} periods; give as many of both, or one")
        with self.at(key):
            pairs = zip(*(np.atleast_1d(y) for y in np.broadcast_arrays(a_p, T_p)), strict=True)
            make = kind if vertical is None else GroundMotion.in_proportion(kind, vertical)
            return [make(float(a), float(T)) for a, T in pairs]

    def recorded(self, entry: dict, key: str, source: str) -> Motions:
        """The records of one entry."""
        own, others = RECORDED[source]
        self.typed(self.table(entry, key, (source,), tuple(others)), key, {source: own} | others)
        more: dict[str, Any] = {name: entry[name] for name in entry if name != source}
        with self.at(key):
            ratio, paired = more.pop("vertical_ratio", None), more.pop("paired", False)
            if ratio is not None and (paired or "vertical" in more):
                raise ValueError("vertical_ratio and a vertical record: give one of them")
            if source == "synthetic":
                seeded: dict[str, Any] = {"seed": 0} | more
                found = synthetic_motions(entry[source], **seeded)
            elif source == "suite":
                found = read_suite(self.folder / entry[source], **more)
            else:
                found = Motions((self._record(self.folder / entry[source], more),))
            if ratio is not None:
                found = found.map(lambda motion: dataclasses.replace(motion, vertical=motion.scaled(ratio)))
            return found.paired() if paired else found

    def _record(self, path: Path, more: dict[str, Any]) -> Motion:
        """The record of a file, with its vertical one where there is one."""
        scale, file = more.pop("scale", 1.0), more.pop("vertical", None)
        component = more.pop("vertical_component", None)
        motion = read_motion(path, **more)
        if file is None and component is not None:
            raise ValueError("vertical_component needs vertical, the file of the vertical record")
        if file is not None:
            own = {name: y for name, y in more.items() if name != "component"}
            vertical = read_motion(self.folder / file, **own, component=component)
            motion = dataclasses.replace(motion, vertical=vertical)
        return motion if scale == 1 else motion.scaled(scale)

    def chosen(self, entry: dict, key: str, motions: Mapping[str, Any]) -> Any:
        """The set that `entry["motions"]` names."""
        return self.set_named(entry["motions"], f"{key}.motions", motions)

    def set_named(self, name, key: str, motions: Mapping[str, Any]) -> Any:
        if not isinstance(name, str) or name not in motions:
            self.fail(
                key,
                f"must name a set under [motions], got {name!r}; there are {', '.join(motions) or 'none'}",
            )
        return motions[name]
