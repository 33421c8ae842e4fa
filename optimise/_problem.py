"""Design problems in TOML files: the tables `vary`, `minimise` and `targets` of problem files."""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Discriminator, Field, Tag, create_model, model_validator

import rockjax as rj
from rockjax._motions.convert import as_motions
from rockjax._outputs.registry import REGISTRY
from rockjax._problem import models
from rockjax._problem.models import key
from rockjax._problem.reading import Reader, load_table
from rockjax._report.entry import Entry
from rockjax._report.kinds import KINDS, check_model
from rockjax._report.reading import read_checks
from rockjax._studies.fragility import measure_of
from rockjax._text.representations import format_call
from rockjax.internal import parameters_of, read

from ._annual import AnnualFrequency
from ._answer import Design, aligned
from ._design import design
from ._failure import FailureProbability
from ._floor_targets import ContentsRotation, FloorSpectrum
from ._objectives import (
    AbstractObjective,
    ExpectedLoss,
    WorstDeformation,
    WorstDrift,
    WorstFloorAcceleration,
    WorstPeak,
    WorstRotation,
    WorstShear,
)
from ._peak_targets import (
    LeastAxialForce,
    PeakDeformation,
    PeakDrift,
    PeakFloorAcceleration,
    PeakFoundationShear,
    PeakFriction,
    PeakLimit,
    PeakRotation,
    PeakShear,
)
from ._targets import (
    AbstractTarget,
    MedianCapacity,
    NoOverturning,
    OverturningAcceleration,
    OverturningProbability,
    OverturningScale,
)
from ._variables import Dimensions, Structure, as_podium, make_variables

EXPECTED_LOSS = "expected-loss"
# Outputs that a target can limit: name in problem files → name of the output.
PEAKS = {
    name.replace("_", "-"): name
    for name, output in REGISTRY.items()
    if any(y.name == name and y.until_overturning for y in output.variables)
}
# Name in problem files → class of an objective on the largest peak of all motions, or function that makes the
# objective.
WORST: dict[str, Any] = {
    kind: functools.partial(WorstPeak, name)
    for kind, name in PEAKS.items()
    if REGISTRY[name].for_limit(1.0)[0] == REGISTRY[name]
} | {
    "peak-rotation": WorstRotation,
    "peak-shear": WorstShear,
    "peak-deformation": WorstDeformation,
    "peak-drift": WorstDrift,
    "peak-floor-acceleration": WorstFloorAcceleration,
}
Positive = models.Positive
_SET_TEXT = "Name of a set of motions."
_WIDTH_TEXT = (
    "A range of overturning intensities that is narrower than this fraction of max_intensity may be missed "
    "[–]."
)
_HAZARD_TEXT = "File of a hazard curve, relative to the folder of this file."
_MAX_INTENSITY_TEXT = (
    "Largest searched intensity, in the SI unit of the hazard; by default the last point of the hazard."
)


# Kind of an entry of `[[targets]]` → class of the target, or function that makes the target. The keys of each
# kind are in `rockjax/_report/kinds`.
TARGETS: dict[str, Callable[..., AbstractTarget]] = {
    **{kind: functools.partial(PeakLimit, output) for kind, output in PEAKS.items()},
    "peak-rotation": PeakRotation,
    "peak-shear": PeakShear,
    "peak-deformation": PeakDeformation,
    "peak-drift": PeakDrift,
    "peak-floor-acceleration": PeakFloorAcceleration,
    "peak-friction": PeakFriction,
    "peak-foundation-shear": PeakFoundationShear,
    "least-axial-force": LeastAxialForce,
    "contents-rotation": ContentsRotation,
    "floor-spectrum": FloorSpectrum,
    "no-overturning": NoOverturning,
    "overturning-acceleration": OverturningAcceleration,
    "overturning-scale": OverturningScale,
    "median-capacity": MedianCapacity,
    "annual-frequency": AnnualFrequency,
    "overturning-probability": OverturningProbability,
    "failure-probability": FailureProbability,
}
# Keys whose values are passed to the class of a target by position: after the limit, before the motions.
POSITIONAL = ("hazard", "pulse", "motion")


class Quantity(models.Keys):
    """Objective: a parameter of the podium, or a peak under motions."""

    quantity: str = key(..., f"A parameter of the podium, or one of {', '.join(WORST)}.")
    motions: str | None = key(None, _SET_TEXT)


class LossKeys(models.Keys):
    """Objective: annual cost of the podium plus expected annual loss by overturning."""

    quantity: Literal["expected-loss"]
    cost: Annotated[dict[str, Positive], Field(min_length=1)] = key(
        ..., "Annual cost per unit of parameters: name of the parameter = cost."
    )
    loss: Positive = key(..., "Loss by one overturning, in the currency of the cost.")
    hazard: str = key(..., _HAZARD_TEXT)
    motions: str = key(..., _SET_TEXT)
    max_intensity: Positive | None = key(None, _MAX_INTENSITY_TEXT)
    width: Positive | None = key(None, _WIDTH_TEXT)


def _objective_tag(table: Any) -> str:
    """Return the tag of the model that validates the table `minimise`."""
    return "Loss" if isinstance(table, dict) and table.get("quantity") == EXPECTED_LOSS else "Quantity"


class ProblemFile(models.Problem):
    """Contents of a problem file for a design."""

    structure: models.Structure = key(..., "The structure, by ratios or by dimensions.")
    vary: dict[str, models.Bounds] = key(..., "Design variables: name = [lowest, highest].")
    minimise: (
        Annotated[
            Annotated[LossKeys, Tag("Loss")] | Annotated[Quantity, Tag("Quantity")],
            Discriminator(_objective_tag),
        ]
        | None
    ) = key(None, "The objective; by default the distance from the given structure.")

    @model_validator(mode="after")
    def _check(self) -> ProblemFile:
        if self.minimise is None and not self.targets:
            raise ValueError("there is nothing to do; give [minimise], [[targets]] or both")
        return self


def problem_schema() -> dict[str, Any]:
    """Return the JSON schema of problem files, with the keys of every kind of check and target."""
    kinds = functools.reduce(operator.or_, map(check_model, KINDS))
    entries: Any = list[Annotated[kinds, Field(discriminator="kind")]]
    fields: Any = {
        "checks": (entries, key([], "Checks of the report.")),
        "targets": (
            entries,
            key([], "Conditions that the design must satisfy; a report checks them as well."),
        ),
    }
    return create_model("ProblemFile", __base__=ProblemFile, **fields).model_json_schema()


SETTINGS = ("starts", "seed", "tolerance", "max_iterations")  # arguments of `design` that a file may set


class Problem(NamedTuple):
    """Design problem of a file: the arguments of [`optimise.design`][], and the sets of motions.

    - `podium`, `vary`, `minimise`, `targets`, `options`: arguments of [`optimise.design`][]
    - `settings`: name → value, for those of the arguments `starts`, `seed`, `tolerance` and `max_iterations`
      that the file sets
    - `motions`: name → set of motions
    """

    podium: Structure
    vary: dict[str, tuple[float, float]]
    minimise: AbstractObjective | Callable[[rj.Podium], Any] | None
    targets: tuple[AbstractTarget, ...]
    options: rj.Options
    settings: dict[str, Any]
    motions: dict[str, list[rj.AbstractExcitation]]

    def design(self, **changes) -> Design:
        """Solve the problem; `changes` add or replace arguments of [`optimise.design`][]."""
        settings: dict[str, Any] = {"options": self.options} | self.settings | changes
        return design(self.podium, self.vary, self.minimise, self.targets, **settings)

    def __repr__(self):
        return _format_problem(self)


def _format_problem(problem: Problem) -> str:
    """Return a problem as text: objective, structure, variables, targets with their numbers of scenes, and
    sets of motions."""
    objective = problem.minimise
    if objective is None:
        aim = "the nearest design"
    elif isinstance(objective, AbstractObjective):
        aim = f"least {objective.describe()}"
    else:
        aim = f"least {getattr(objective, '__name__', 'objective')}"
    variables = make_variables(problem.podium, problem.vary)
    start = variables.values(variables.start())
    variable_rows = [["variable", "start", "unit", "bounds"]]
    for name, value, unit in zip(variables.names, start, variables.units, strict=True):
        low, high = problem.vary[name]
        variable_rows.append([name, f"{float(value):.6g}", unit, f"{low:g} … {high:g}"])
    targets = [
        ["target", "scenes"],
        *([target.name or target.describe(), str(target.scenes)] for target in problem.targets),
    ]
    sets = [["motions", "count"], *([name, str(len(motions))] for name, motions in problem.motions.items())]
    lines = [f"Problem: {aim}", f"  {format_call(problem.podium)}"]
    return "\n".join([*lines, *aligned(variable_rows), *aligned(targets), *aligned(sets)])


def load(path: str | Path) -> Problem:
    """Read a design problem from a TOML file.

    Raises `ValueError` for an invalid file; the message names the file, the key and the cause.
    """
    path = Path(path)
    return problem_of(load_table(path), path)


def problem_of(
    table: dict[str, Any], path: Path, options: Mapping[str, tuple[str, Any]] | None = None
) -> Problem:
    """Return the design problem in the contents `table` of a file. `options` are the keys that the command
    line has set, key → (flag, value). Raises `ValueError`, which names the file, the key and the cause, for
    an invalid file."""
    return _Reader(path, options).problem(table)


class _ParameterOf:
    """A function that returns one parameter of a podium. Its `__name__` is the name of the parameter."""

    def __init__(self, name: str):
        self.__name__ = name

    def __call__(self, podium: rj.Podium):
        return read(podium, self.__name__)


class _Cost:
    """Cost of a podium: the sum of its parameters, each multiplied by the cost per unit (`rates`)."""

    __name__ = "cost"

    def __init__(self, rates: dict[str, float]):
        self.rates = rates

    def __call__(self, podium: rj.Podium):
        return sum(rate * read(podium, name) for name, rate in self.rates.items())


class _Reader(Reader):
    """Reader of problem files for a design."""

    def problem(self, table: dict[str, Any]) -> Problem:
        """Return the problem of a file with the contents `table`. Raises `ValueError`, which names the file,
        the key and the cause, for invalid contents."""
        checked = self.check(ProblemFile, table)
        structure = self.structure(checked.structure, Dimensions)
        podium = as_podium(structure)
        motions = self.motions(checked.motions, podium)
        with self.errors_at("vary"):
            make_variables(structure, checked.vary)
        targets = tuple(
            self.target(entry, f"targets[{k}]", motions)
            for k, entry in enumerate(read_checks(self, table, checked, podium, ("targets",)))
        )
        minimise = None if checked.minimise is None else self.minimise(checked.minimise, motions, podium)
        settings = {name: value for name, value in checked.as_arguments().items() if name in SETTINGS}
        return Problem(
            structure, checked.vary, minimise, targets, self.options(checked.options), settings, motions
        )

    def minimise(self, entry: Quantity | LossKeys, motions: Mapping[str, Any], podium: rj.Podium) -> Any:
        """Return the objective of the table `minimise`. `motions` are the sets of motions by name."""
        parameters = tuple(parameters_of(podium))
        if isinstance(entry, LossKeys):
            for name in entry.cost:
                if name not in parameters:
                    self.fail(
                        f"minimise.cost.{name}",
                        f"is not a parameter of the podium; parameters are {', '.join(parameters)}",
                    )
            with self.errors_at("minimise"):
                suite = motions[self.require_set(motions, entry.motions, "minimise.motions")]
                risk = AnnualFrequency(
                    1.0,  # `at_most`, which an `ExpectedLoss` ignores
                    self.hazard(entry.hazard),
                    suite,
                    **entry.as_arguments("quantity", "cost", "loss", "hazard", "motions"),
                )
                return ExpectedLoss(_Cost(entry.cost), entry.loss, risk)
        if entry.quantity in parameters and entry.motions is not None:
            self.fail(
                "minimise.motions", f"must be left out, because {entry.quantity} does not depend on motions"
            )
        if entry.quantity in parameters:
            return _ParameterOf(entry.quantity)
        if entry.quantity not in WORST:
            quantities = ", ".join((*parameters, *WORST, EXPECTED_LOSS))
            self.fail("minimise.quantity", f"must be one of {quantities}, got {entry.quantity!r}")
        if entry.motions is None:
            self.fail("minimise", f"motions is missing; name a set of [motions] for {entry.quantity}")
        return WORST[entry.quantity](motions[self.require_set(motions, entry.motions, "minimise.motions")])

    def hazard(self, name: str) -> rj.Hazard:
        """Read a hazard curve; `name` is relative to the folder of the problem file."""
        return rj.Hazard.from_file(self.folder / name).in_si()

    def target(self, entry: Entry, where: str, motions: Mapping[str, Any]) -> AbstractTarget:
        """Return the target of an entry of `[[targets]]`; `where` is the key of the entry, `motions` are the
        sets of motions by name. Raises `ValueError` for invalid entries, and for kinds and values that are
        allowed only in checks of a report."""
        kind, arguments = KINDS[entry.kind], dict(entry.arguments)
        if entry.kind not in TARGETS:
            self.fail(
                f"{where}.kind", f"can only be a check of a report; kinds of targets are {', '.join(TARGETS)}"
            )
        if entry.keys.statistic != "max":
            self.fail(f"{where}.statistic", "must be max, because a target must hold under every motion")
        if kind.has_limit and math.isnan(entry.limit):
            self.fail(where, "the limit is a key that the file does not have; give the key or a number")
        suite = []
        if kind.needs_motions:
            suite = motions[self.require_set(motions, entry.keys.motions, f"{where}.motions")]
            if entry.keys.vertical and not all(hasattr(motion, "vertical") for motion in suite):
                self.fail(
                    f"{where}.vertical", f"the motions of {entry.keys.motions} have no vertical component"
                )
        arguments.pop("curve", None)  # a stored fragility curve is valid only for the structure in the file
        with self.errors_at(where):
            measure, period = arguments.pop("measure", ("scale", None))
            if entry.kind == "median-capacity" and measure != "scale":
                if "max_scale" in arguments:
                    raise ValueError(
                        f"max_scale is a factor on the motions; leave it out with the measure {measure}: the "
                        "search then ends at the intensity 3·at_least"
                    )
                suite = _with_unit_intensity(where, suite, measure, period)
            for table in {"contents", "oscillators"} & arguments.keys():
                if not arguments[table]:
                    raise ValueError(f"needs entries [[{table}]] in the file; add at least one")
                arguments[table] = list(arguments[table].values())
            positional = [entry.limit] if kind.has_limit else []
            positional += [arguments.pop(name) for name in POSITIONAL if name in arguments]
            positional += [suite] if kind.needs_motions else []
            return TARGETS[entry.kind](*positional, **arguments, name=entry.keys.name)


def _with_unit_intensity(owner: str, suite: Sequence[Any], measure: str, period: float | None) -> list[Any]:
    """Return the motions scaled to unit intensity, so that factors on them are intensities. Measure and
    period are as for `measure_of`. Raises `ValueError` for a motion whose intensity is 0."""
    measured = np.asarray(measure_of(measure, period, rj.Motions(tuple(as_motions(owner, suite)))).values)
    if not measured.all():
        raise ValueError(f"motion {np.argmin(measured) + 1} has {measure} = 0; leave it out")
    return [motion.scaled(1 / float(intensity)) for motion, intensity in zip(suite, measured, strict=True)]
