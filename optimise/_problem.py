"""Design problems in TOML files: structure, motions and options as at the head of rockjax/_problem.py, and
besides

starts = 4                       # optional; as are seed, tolerance, max_iterations
seed = 0

[vary]                           # name = [lowest, highest]
width = [0.2, 1.5]

[minimise]                       # optional
quantity = "alpha"               # a parameter of the podium: alpha, R, gamma, width, height, eta …, or
                                 # peak-rotation, peak-shear, peak-deformation, peak-drift,
                                 # peak-floor-acceleration with motions = "…"; or
quantity = "expected-loss"       # cost, a number for each unit of parameters: {width = 2e4}; loss, hazard,
                                 # motions, max_intensity, width as for annual-frequency

[[targets]]
kind = "peak-rotation"           # peak-shear, peak-deformation, and of buildings peak-drift,
                                 # peak-floor-acceleration: limit, motions
limit = 0.4
motions = "pulses"
[[targets]]
kind = "no-overturning"          # motions
[[targets]]
kind = "overturning-acceleration"  # at_least, pulse, T_p or frequency_ratio, ratio, max_acceleration_ratio
[[targets]]
kind = "overturning-scale"       # at_least, motions, max_scale, width
[[targets]]
kind = "median-capacity"         # at_least, motions, max_scale, width
[[targets]]
kind = "annual-frequency"        # at_most, hazard: a file as in [risk], motions, max_intensity, width
[[targets]]
kind = "overturning-probability" # at_most, motions, intensity, smoothing
[[targets]]
kind = "failure-probability"     # at_most, motion = {n, dt, S_0, omega_g, zeta_g, omega_f, zeta_f, envelope =
                                 # {t_1, t_2, c}}, cov, rays, seed
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import rockjax as rj
from rockjax.internal import (
    POSITIVE,
    TEXT,
    TRUTH,
    Kind,
    Reader,
    load_table,
    parameters_of,
    read,
    readable,
    whole_number,
)

from ._annual import AnnualFrequency
from ._answer import Design, aligned
from ._design import design
from ._failure import FailureProbability
from ._objectives import (
    AbstractObjective,
    ExpectedLoss,
    WorstDeformation,
    WorstDrift,
    WorstFloorAcceleration,
    WorstRotation,
    WorstShear,
)
from ._targets import (
    AbstractTarget,
    MedianCapacity,
    NoOverturning,
    OverturningAcceleration,
    OverturningProbability,
    OverturningScale,
    PeakDeformation,
    PeakDrift,
    PeakFloorAcceleration,
    PeakRotation,
    PeakShear,
)
from ._variables import Dimensions, Structure, as_podium, variables

SETTINGS: dict[str, Kind] = {
    "starts": whole_number(1),
    "seed": whole_number(0),
    "tolerance": POSITIVE,
    "max_iterations": whole_number(1),
}
TARGET: dict[str, Kind] = {
    "limit": POSITIVE,
    "loss": POSITIVE,
    "at_least": POSITIVE,
    "at_most": POSITIVE,
    "max_scale": POSITIVE,
    "max_acceleration_ratio": POSITIVE,
    "smoothing": POSITIVE,
    "intensity": POSITIVE,
    "max_intensity": POSITIVE,
    "width": POSITIVE,
    "hazard": TEXT,
    "ratio": TRUTH,
    "name": TEXT,
    "cov": POSITIVE,
    "rays": whole_number(8),
    "seed": whole_number(0),
}
GAUSSIAN: dict[str, Kind] = {
    "n": whole_number(2),
    **dict.fromkeys(("dt", "S_0", "omega_g", "zeta_g", "omega_f", "zeta_f"), POSITIVE),
}
ENVELOPE: dict[str, Kind] = dict.fromkeys(("t_1", "t_2", "c"), POSITIVE)
EXPECTED_LOSS = "expected-loss"
WORST: dict[str, type] = {
    "peak-rotation": WorstRotation,
    "peak-shear": WorstShear,
    "peak-deformation": WorstDeformation,
    "peak-drift": WorstDrift,
    "peak-floor-acceleration": WorstFloorAcceleration,
}


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
        """The design; `changes` are further arguments of [`optimise.design`][] or replace those of the
        file."""
        settings: dict[str, Any] = {"options": self.options} | self.settings | changes
        return design(self.podium, self.vary, self.minimise, self.targets, **settings)

    def __repr__(self):
        return _described(self)


def _described(asked: Problem) -> str:
    """What a file asks for in lines: variables where they start, targets with their scenes, sets of
    motions."""
    wanted = asked.minimise
    if wanted is None:
        least = "the nearest design"
    elif isinstance(wanted, AbstractObjective):
        least = f"least {wanted.describe()}"
    else:
        least = f"least {getattr(wanted, '__name__', 'objective')}"
    box = variables(asked.podium, asked.vary)
    start = box.values(box.start())
    rows = [["variable", "start", "unit", "bounds"]]
    for name, value, unit in zip(box.names, start, box.units, strict=True):
        low, high = asked.vary[name]
        rows.append([name, f"{float(value):.6g}", unit, f"{low:g} … {high:g}"])
    targets = [
        ["target", "scenes"],
        *([target.name or target.describe(), str(target.scenes)] for target in asked.targets),
    ]
    sets = [["motions", "count"], *([name, str(len(motions))] for name, motions in asked.motions.items())]
    lines = [f"Problem: {least}", f"  {readable(asked.podium)}"]
    return "\n".join([*lines, *aligned(rows), *aligned(targets), *aligned(sets)])


def load(path: str | Path) -> Problem:
    """The design problem in a TOML file; the schema is at the head of this module and of rockjax/_problem.py.

    Raises `ValueError` that names the file, the key and the cause.
    """
    path = Path(path)
    return problem_of(load_table(path), path)


def problem_of(table: dict[str, Any], path: Path, where: str | None = None) -> Problem:
    """The design problem in the table of a file; `where` is what complaints begin with, by default its
    path."""
    return _Reader(path, where).problem(table)


class _Number:
    """One parameter of a podium, named in reports."""

    def __init__(self, name: str):
        self.__name__ = name

    def __call__(self, podium: rj.Podium):
        return read(podium, self.__name__)


class _Cost:
    """So much for each unit of some parameters of a podium."""

    __name__ = "cost"

    def __init__(self, rates: dict[str, float]):
        self.rates = rates

    def __call__(self, podium: rj.Podium):
        return sum(rate * read(podium, name) for name, rate in self.rates.items())


class _Reader(Reader):
    """Reads what a design needs besides."""

    def __init__(self, path: Path, where: str | None = None):
        super().__init__(path, where, by_dimensions=Dimensions)

    def problem(self, table: dict) -> Problem:
        self.whole(table, ("structure", "vary"))
        settings = self.entries(table, "", SETTINGS)
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
        targets = tuple(
            self.target(entry, f"targets[{k}]", motions, podium) for k, entry in enumerate(entries)
        )
        options = self.options(table)
        minimise = self.minimise(table["minimise"], motions, podium) if "minimise" in table else None
        if minimise is None and not targets:
            self.fail("targets", "nothing to do: give [minimise], [[targets]] or both")
        return Problem(
            structure, {k: tuple(v) for k, v in vary.items()}, minimise, targets, options, settings, motions
        )

    def minimise(self, value, motions: dict, podium: rj.Podium):
        if isinstance(value, dict) and value.get("quantity") == EXPECTED_LOSS:
            return self.expected_loss(value, motions, podium)
        entry = self.table(value, "minimise", ("quantity",), ("motions",))
        quantity = entry["quantity"]
        if not isinstance(quantity, str):
            self.fail("minimise.quantity", f"must be a text, got {quantity!r}")
        if quantity in parameters_of(podium):
            if "motions" in entry:
                self.fail("minimise.motions", f"has no meaning for {quantity}")
            return _Number(quantity)
        if quantity not in WORST:
            self.fail(
                "minimise.quantity",
                f"must be one of {', '.join((*parameters_of(podium), *WORST, EXPECTED_LOSS))}, "
                f"got {quantity!r}",
            )
        if "motions" not in entry:
            self.fail("minimise", f"motions is missing: {quantity} under which?")
        return WORST[quantity](self.chosen(entry, "minimise", motions))

    def expected_loss(self, value, motions: dict, podium: rj.Podium) -> ExpectedLoss:
        """Cost and what overturning loses in a year; `at_most` of the risk is not looked at."""
        needed = ("quantity", "cost", "loss", "hazard", "motions")
        entry = self.table(value, "minimise", needed, ("max_intensity", "width"))
        rates = self.table(entry["cost"], "minimise.cost", (), tuple(parameters_of(podium)))
        rates = self.entries(rates, "minimise.cost", dict.fromkeys(rates, POSITIVE))
        if not rates:
            self.fail("minimise.cost", "is empty: give a number for each unit of a parameter")
        numbers = self.entries(entry, "minimise", TARGET)
        how = {name: numbers[name] for name in ("max_intensity", "width") if name in numbers}
        with self.at("minimise"):
            suite = self.chosen(entry, "minimise", motions)
            risk = AnnualFrequency(1.0, self.hazard(numbers["hazard"]), suite, **how)
            return ExpectedLoss(_Cost(rates), numbers["loss"], risk)

    def hazard(self, name: str) -> rj.Hazard:
        """The hazard curve in a file beside this one."""
        return rj.Hazard.from_file(self.folder / name).in_si()

    def target(self, entry, key: str, motions: dict, podium: rj.Podium) -> AbstractTarget:
        kinds: dict[str, tuple[type[AbstractTarget], tuple[str, ...], tuple[str, ...]]] = {
            "peak-rotation": (PeakRotation, ("limit", "motions"), ()),
            "peak-shear": (PeakShear, ("limit", "motions"), ()),
            "peak-deformation": (PeakDeformation, ("limit", "motions"), ()),
            "peak-drift": (PeakDrift, ("limit", "motions"), ()),
            "peak-floor-acceleration": (PeakFloorAcceleration, ("limit", "motions"), ()),
            "no-overturning": (NoOverturning, ("motions",), ()),
            "overturning-acceleration": (
                OverturningAcceleration,
                ("at_least", "pulse"),
                ("T_p", "frequency_ratio", "ratio", "max_acceleration_ratio", "width"),
            ),
            "overturning-scale": (OverturningScale, ("at_least", "motions"), ("max_scale", "width")),
            "median-capacity": (MedianCapacity, ("at_least", "motions"), ("max_scale", "width")),
            "annual-frequency": (
                AnnualFrequency,
                ("at_most", "hazard", "motions"),
                ("max_intensity", "width"),
            ),
            "overturning-probability": (
                OverturningProbability,
                ("at_most", "motions"),
                ("intensity", "smoothing"),
            ),
            "failure-probability": (
                FailureProbability,
                ("at_most", "motion"),
                ("cov", "rays", "seed"),
            ),
        }
        if not isinstance(entry, dict) or "kind" not in entry:
            self.fail(key, "kind is missing")
        if not isinstance(entry["kind"], str) or entry["kind"] not in kinds:
            self.fail(f"{key}.kind", f"must be one of {', '.join(kinds)}, got {entry['kind']!r}")
        kind, needed, optional = kinds[entry["kind"]]
        self.table(entry, key, ("kind", *needed), (*optional, "name"))
        self.entries(entry, key, TARGET)
        numbers = {
            name: value
            for name, value in entry.items()
            if name not in ("kind", "motion", "motions", "pulse", "T_p", "frequency_ratio")
        }
        with self.at(key):
            if kind is OverturningAcceleration:
                pulse, T_p = self.pulse(entry["pulse"], f"{key}.pulse"), self.periods(entry, key, podium)
                at_least = numbers.pop("at_least")
                return OverturningAcceleration(at_least, pulse, T_p, **numbers)
            if kind is FailureProbability:
                at_most, motion = numbers.pop("at_most"), self.gaussian(entry["motion"], f"{key}.motion")
                return FailureProbability(at_most, motion, **numbers)
            if "hazard" in numbers:
                numbers["hazard"] = self.hazard(numbers["hazard"])
            first = {name: numbers.pop(name) for name in needed if name in numbers}
            make: Any = kind
            return make(*first.values(), self.chosen(entry, key, motions), **numbers)

    def gaussian(self, value, key: str) -> rj.GaussianMotion:
        """A random ground motion in a table of its numbers."""
        entry = self.table(value, key, ("n", "dt", "S_0"), (*list(GAUSSIAN)[3:], "envelope"))
        numbers = self.entries({k: y for k, y in entry.items() if k != "envelope"}, key, GAUSSIAN)
        if "envelope" in entry:
            envelope = self.table(entry["envelope"], f"{key}.envelope", (), tuple(ENVELOPE))
            numbers["envelope"] = rj.Envelope(**self.entries(envelope, f"{key}.envelope", ENVELOPE))
        with self.at(key):
            return rj.GaussianMotion(**numbers)
