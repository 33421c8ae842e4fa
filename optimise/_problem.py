"""Design problems in TOML files.

starts = 4                       # optional; as are seed, tolerance, max_iterations
seed = 0

[structure]                      # by ratios: alpha (or tan_alpha), R, gamma, lam, restitution, g …
tan_alpha = 0.15
R = 1.5
gamma = 10.0
superstructure = { eta = 100.0, T_s = 0.5, zeta = 0.05 }   # without T_s a rigid one; optional

[structure]                      # … or by dimensions, as optimise.Dimensions
width = 0.45
height = 3.0
column_mass = 1500.0
beam_mass = 30e3
top_mass = 300e3
period = 0.5

[vary]                           # name = [lowest, highest]
width = [0.2, 1.5]

[motions.pulses]                 # sets of motions, by names of your own
kind = "ricker"                  # antisymmetric-ricker, one-sine, one-cosine, half-sine
a_p = [3.0, 4.0]                 # [m/s²], or acceleration_ratio: multiples of g tan α of the structure above
T_p = [0.8, 1.2]                 # [s], or frequency_ratio: ω_p/p of the structure above
                                 # lists of one length go together, a single number goes with all

[[motions.records]]              # a set may have several entries
file = "record.csv"              # beside this file; any format that rockjax.read_motion reads
units = "g"                      # or "m/s2", "cm/s2", "gal", "mm/s2"; only where the file does not say it, as text does
dt = 0.01                        # only where the file does not say it, as one column does [s]
scale = 1.0                      # optional
component = 1                    # number or name of a channel, where the file has several
[[motions.records]]
suite = "folder"                 # or "suite.csv": all motions that rockjax.read_suite reads from it
pattern = "*.AT2"                # optional, of a folder; as are units, dt, scale, component for all of its motions

[minimise]                       # optional
quantity = "alpha"               # a number of the podium: alpha, R, gamma, width, height, or
                                 # peak-rotation, peak-shear, peak-deformation with motions = "…"

[[targets]]
kind = "peak-rotation"           # peak-shear, peak-deformation: limit, motions
limit = 0.4
motions = "pulses"
[[targets]]
kind = "no-overturning"          # motions
[[targets]]
kind = "overturning-acceleration"  # at_least, pulse, T_p or frequency_ratio, ratio, max_acceleration_ratio
[[targets]]
kind = "overturning-scale"       # at_least, motions, max_scale
[[targets]]
kind = "overturning-probability" # at_most, motions, intensity, smoothing

[options]                        # optional: rtol, atol, method, … of rockjax.Options
rtol = 1e-8
"""

from __future__ import annotations

import contextlib
import math
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import rockjax as rj
from rockjax._pulses import PULSES

from ._design import Design, design
from ._objectives import AbstractObjective, WorstDeformation, WorstRotation, WorstShear
from ._targets import (
    AbstractTarget,
    NoOverturning,
    OverturningAcceleration,
    OverturningProbability,
    OverturningScale,
    PeakDeformation,
    PeakRotation,
    PeakShear,
)
from ._variables import Dimensions, Structure, as_podium, variables

NUMBERS = ("alpha", "R", "gamma", "width", "height")
WORST: dict[str, type] = {"peak-rotation": WorstRotation, "peak-shear": WorstShear, "peak-deformation": WorstDeformation}


class Problem(NamedTuple):
    """What a file asks for: the arguments of [`optimise.design`][], and the sets of motions by name."""

    podium: Structure
    vary: dict[str, tuple[float, float]]
    minimise: AbstractObjective | Callable[[rj.Podium], Any] | None
    targets: tuple[AbstractTarget, ...]
    options: rj.Options
    settings: dict[str, Any]  # starts, seed, tolerance, max_iterations
    motions: dict[str, list[rj.AbstractExcitation]]

    def design(self, **changes) -> Design:
        """The design; `changes` are further arguments of [`optimise.design`][] or replace those of the file."""
        settings: dict[str, Any] = {"options": self.options} | self.settings | changes
        return design(self.podium, self.vary, self.minimise, self.targets, **settings)


def load(path: str | Path) -> Problem:
    """The design problem in a TOML file; the schema is at the head of this module.

    Raises `ValueError` that names the file, the key and the cause.
    """
    path = Path(path)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: is not TOML: {error}") from None
    return _Reader(path).problem(table)


class _Number:
    """One number of a podium, named in reports."""

    def __init__(self, name: str):
        self.__name__ = name

    def __call__(self, podium: rj.Podium):
        return getattr(podium, self.__name__)


class _Reader:
    """Reads tables; every complaint names the file and the key."""

    def __init__(self, path: Path):
        self.path = path

    @contextlib.contextmanager
    def at(self, key: str) -> Iterator[None]:
        try:
            yield
        except _Reported:
            raise
        except (ValueError, TypeError) as error:
            raise _Reported(f"{self.path}: {key}: {error}") from None

    def fail(self, key: str, why: str):
        raise _Reported(f"{self.path}: {key}: {why}")

    def table(self, value, key: str, needed: tuple[str, ...], optional: tuple[str, ...] = ()) -> dict[str, Any]:
        if not isinstance(value, dict):
            self.fail(key, f"must be a table, got {value!r}")
        for name in value:
            if name not in needed + optional:
                self.fail(f"{key}.{name}" if key else name, f"is not known; known are {', '.join(needed + optional)}")
        for name in needed:
            if name not in value:
                self.fail(key or "file", f"{name} is missing")
        return value

    def numbers(self, value, key: str) -> np.ndarray:
        good = isinstance(value, int | float) or (
            isinstance(value, list) and value and all(isinstance(v, int | float) for v in value)
        )
        if not good or np.asarray(value).dtype == bool:
            self.fail(key, f"must be a number or a list of numbers, got {value!r}")
        return np.asarray(value, float)

    def problem(self, table: dict) -> Problem:
        settings = ("starts", "seed", "tolerance", "max_iterations")
        self.table(table, "", ("structure", "vary"), ("motions", "minimise", "targets", "options", *settings))
        structure = self.structure(table["structure"])
        podium = as_podium(structure)
        motions = self.motions(table.get("motions", {}), podium)
        vary = table["vary"]
        if not isinstance(vary, dict):
            self.fail("vary", f"must be a table of name = [lowest, highest], got {vary!r}")
        with self.at("vary"):
            variables(structure, vary)
        entries = table.get("targets", [])
        if not isinstance(entries, list):
            self.fail("targets", "must be an array of tables, [[targets]]")
        targets = tuple(self.target(entry, f"targets[{k}]", motions, podium) for k, entry in enumerate(entries))
        with self.at("options"):
            given = table.get("options", {})
            options = rj.Options(**({"throw": False} | given))
        minimise = self.minimise(table["minimise"], motions) if "minimise" in table else None
        if minimise is None and not targets:
            self.fail("targets", "nothing to do: give [minimise], [[targets]] or both")
        chosen = {name: table[name] for name in settings if name in table}
        return Problem(structure, {k: tuple(v) for k, v in vary.items()}, minimise, targets, options, chosen, motions)

    def structure(self, value) -> Structure:
        key = "structure"
        if not isinstance(value, dict):
            self.fail(key, f"must be a table, got {value!r}")
        if "column_mass" in value:
            names = ("beam_mass", "columns", "top_mass", "period", "damping", "lam", "restitution", "g")
            self.table(value, key, ("width", "height", "column_mass"), names)
            with self.at(key):
                return Dimensions(**value)
        slenderness = [name for name in ("alpha", "tan_alpha") if name in value]
        if len(slenderness) != 1:
            self.fail(key, "needs alpha or tan_alpha with R, or width, height and column_mass")
        optional = ("gamma", "superstructure", "lam", "restitution", "g")
        numbers = dict(self.table(value, key, (slenderness[0], "R"), optional))
        with self.at(key):
            if "tan_alpha" in numbers:
                numbers["alpha"] = math.atan(numbers.pop("tan_alpha"))
            if "superstructure" in numbers:
                top = self.table(numbers["superstructure"], f"{key}.superstructure", ("eta",), ("T_s", "zeta"))
                if "zeta" in top and "T_s" not in top:
                    self.fail(f"{key}.superstructure", "zeta needs T_s; without it the superstructure is rigid")
                numbers["superstructure"] = rj.Elastic(**top) if "T_s" in top else rj.Rigid(**top)
            return rj.Podium(**numbers)

    def motions(self, value, podium: rj.Podium) -> dict[str, list[rj.AbstractExcitation]]:
        if not isinstance(value, dict):
            self.fail("motions", f"must be tables [motions.name], got {value!r}")
        sets: dict[str, list[rj.AbstractExcitation]] = {}
        for name, entries in value.items():
            several = isinstance(entries, list)
            found = []
            for k, entry in enumerate(entries if several else [entries]):
                key = f"motions.{name}" + (f"[{k}]" if several else "")
                sources = [name for name in ("kind", "file", "suite") if isinstance(entry, dict) and name in entry]
                if len(sources) != 1:
                    self.fail(key, "needs one of kind (of a pulse), file (of a record) and suite (of records)")
                found += self.pulses(entry, key, podium) if sources == ["kind"] else self.records(entry, key, sources[0])
            if not found:
                self.fail(f"motions.{name}", "is empty")
            sets[name] = found
        return sets

    def pulse(self, value, key: str) -> type[rj.AbstractPulse]:
        if not isinstance(value, str) or value not in PULSES:
            self.fail(key, f"must be one of {', '.join(PULSES)}, got {value!r}")
        return PULSES[value]

    def either(self, entry: dict, key: str, plain: str, ratio: str) -> tuple[np.ndarray, bool]:
        """The numbers of one of two keys, and whether it is the ratio."""
        given = [name for name in (plain, ratio) if name in entry]
        if len(given) != 1:
            self.fail(key, f"needs {plain} or {ratio}")
        return self.numbers(entry[given[0]], f"{key}.{given[0]}"), given[0] == ratio

    def periods(self, entry: dict, key: str, podium: rj.Podium) -> np.ndarray:
        numbers, ratio = self.either(entry, key, "T_p", "frequency_ratio")
        if not (numbers > 0).all():
            self.fail(key, f"periods and frequencies must be > 0, got {numbers.tolist()}")
        return 2 * math.pi / (float(podium.p) * numbers) if ratio else numbers

    def pulses(self, entry: dict, key: str, podium: rj.Podium) -> list[rj.AbstractExcitation]:
        self.table(entry, key, ("kind",), ("a_p", "acceleration_ratio", "T_p", "frequency_ratio"))
        kind = self.pulse(entry["kind"], f"{key}.kind")
        a_p, ratio = self.either(entry, key, "a_p", "acceleration_ratio")
        a_p = a_p * float(podium.g) * math.tan(float(podium.alpha)) if ratio else a_p
        T_p = self.periods(entry, key, podium)
        if a_p.ndim and T_p.ndim and len(a_p) != len(T_p):
            self.fail(key, f"has {len(a_p)} amplitudes and {len(T_p)} periods; give as many of both, or one")
        with self.at(key):
            pairs = zip(*(np.atleast_1d(y) for y in np.broadcast_arrays(a_p, T_p)), strict=True)
            return [kind(float(a), float(T)) for a, T in pairs]

    def records(self, entry: dict, key: str, source: str) -> list[rj.AbstractExcitation]:
        kinds: dict[str, tuple[str, tuple[type, ...]]] = {
            source: ("text", (str,)),
            "units": ("text", (str,)),
            "dt": ("number", (int, float)),
            "scale": ("number", (int, float)),
            "component": ("whole number or text", (int, str)),
        }
        if source == "suite":
            kinds["pattern"] = ("text", (str,))
        self.table(entry, key, (source,), tuple(kinds)[1:])
        for name, value in entry.items():
            words, kind = kinds[name]
            if not isinstance(value, kind) or isinstance(value, bool):
                self.fail(f"{key}.{name}", f"must be a {words}, got {value!r}")
        with self.at(key):
            path, more = self.path.parent / entry[source], {name: entry[name] for name in entry if name != source}
            if source == "suite":
                return list(rj.read_suite(path, **more).records())
            return [rj.Record.from_file(path, **more)]

    def chosen(self, entry: dict, key: str, motions: dict) -> list[rj.AbstractExcitation]:
        name = entry["motions"]
        if not isinstance(name, str) or name not in motions:
            self.fail(
                f"{key}.motions", f"must name a set under [motions], got {name!r}; there are {', '.join(motions) or 'none'}"
            )
        return motions[name]

    def minimise(self, value, motions: dict):
        entry = self.table(value, "minimise", ("quantity",), ("motions",))
        quantity = entry["quantity"]
        if not isinstance(quantity, str):
            self.fail("minimise.quantity", f"must be a text, got {quantity!r}")
        if quantity in NUMBERS:
            if "motions" in entry:
                self.fail("minimise.motions", f"has no meaning for {quantity}")
            return _Number(quantity)
        if quantity not in WORST:
            self.fail("minimise.quantity", f"must be one of {', '.join((*NUMBERS, *WORST))}, got {quantity!r}")
        if "motions" not in entry:
            self.fail("minimise", f"motions is missing: {quantity} under which?")
        return WORST[quantity](self.chosen(entry, "minimise", motions))

    def target(self, entry, key: str, motions: dict, podium: rj.Podium) -> AbstractTarget:
        kinds: dict[str, tuple[type[AbstractTarget], tuple[str, ...], tuple[str, ...]]] = {
            "peak-rotation": (PeakRotation, ("limit", "motions"), ()),
            "peak-shear": (PeakShear, ("limit", "motions"), ()),
            "peak-deformation": (PeakDeformation, ("limit", "motions"), ()),
            "no-overturning": (NoOverturning, ("motions",), ()),
            "overturning-acceleration": (
                OverturningAcceleration,
                ("at_least", "pulse"),
                ("T_p", "frequency_ratio", "ratio", "max_acceleration_ratio"),
            ),
            "overturning-scale": (OverturningScale, ("at_least", "motions"), ("max_scale",)),
            "overturning-probability": (OverturningProbability, ("at_most", "motions"), ("intensity", "smoothing")),
        }
        if not isinstance(entry, dict) or "kind" not in entry:
            self.fail(key, "kind is missing")
        if not isinstance(entry["kind"], str) or entry["kind"] not in kinds:
            self.fail(f"{key}.kind", f"must be one of {', '.join(kinds)}, got {entry['kind']!r}")
        kind, needed, optional = kinds[entry["kind"]]
        self.table(entry, key, ("kind", *needed), (*optional, "name"))
        numbers = {
            name: value
            for name, value in entry.items()
            if name not in ("kind", "motions", "pulse", "T_p", "frequency_ratio")
        }
        with self.at(key):
            if kind is OverturningAcceleration:
                pulse, T_p = self.pulse(entry["pulse"], f"{key}.pulse"), self.periods(entry, key, podium)
                at_least = numbers.pop("at_least")
                return OverturningAcceleration(at_least, pulse, T_p, **numbers)
            first = {name: numbers.pop(name) for name in needed if name in numbers}
            make: Any = kind
            return make(*first.values(), self.chosen(entry, key, motions), **numbers)


class _Reported(ValueError):
    """A complaint that names the file already."""
