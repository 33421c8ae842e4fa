"""Design problems in TOML files: the tables `vary`, `minimise` and `targets`."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import Discriminator, Field, Tag, create_model, model_validator

import rockjax as rj
from rockjax._excitations.pulses import PULSES
from rockjax._outputs.registry import REGISTRY
from rockjax._problem import models
from rockjax._problem.models import key
from rockjax._problem.reading import Reader, load_table, pulse_periods
from rockjax._text.cards import format_call
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
_SET = "Name of a set of motions."
_WIDTH = "Narrowest overturning window that is found, divided by the range searched [–]."
_HAZARD = "File of a hazard curve, relative to the folder of this file."
_END = "End of the search, in SI units of the hazard."


class EnvelopeKeys(models.Keys):
    """The envelope of a random motion."""

    t_1: Positive | None = key(None, "End of the rise [s].")
    t_2: Positive | None = key(None, "Start of the decay [s].")
    c: Positive | None = key(None, "Rate of the decay [1/s].")


class GaussianKeys(models.Keys):
    """A random motion, as `rockjax.GaussianMotion`."""

    n: models.Points = key(..., "Number of samples.")
    dt: Positive = key(..., "Sampling interval [s].")
    S_0: Positive = key(..., "Spectral density of the noise [m²/s³].")
    omega_g: Positive | None = key(None, "Frequency of the soil [rad/s].")
    zeta_g: Positive | None = key(None, "Damping ratio of the soil [–].")
    omega_f: Positive | None = key(None, "Frequency of the high-pass filter [rad/s].")
    zeta_f: Positive | None = key(None, "Damping ratio of the high-pass filter [–].")
    envelope: EnvelopeKeys | None = key(None, "Envelope of the motion.")


# Keys of targets: name → type and description.
TARGET_KEYS: dict[str, tuple[Any, str]] = {
    "limit": (
        Positive,
        "Largest peak: |θ|/α, |φ|/α_c, V/(m_t g), |T|/N, V/W_0 [–], deformation [m], acceleration [m/s²].",
    ),
    "at_least": (
        Positive,
        "Least factor on the motions, share of a load [–]; of pulses [m/s²] or a_p/(g tan α).",
    ),
    "at_most": (Positive, "Largest probability [–], or frequency [1/year]."),
    "hazard": (str, _HAZARD),
    "motions": (str, _SET),
    "motion": (GaussianKeys, "The random motion."),
    "pulse": (models.PulseName, "Kind of the pulse."),
    "T_p": (models.Periods, "Periods of the pulse [s]."),
    "frequency_ratio": (models.Periods, "Frequencies ω_p/p of the pulse [–], instead of its periods."),
    "ratio": (bool, "Whether at_least is a_p/(g tan α)."),
    "max_acceleration_ratio": (Positive, "End of the search, a_p/(g tan α) [–]."),
    "max_scale": (Positive, "End of the search, a factor on the motions [–]."),
    "max_intensity": (Positive, _END),
    "width": (Positive, _WIDTH),
    "intensity": (Positive, "Factor on the motions [–]."),
    "smoothing": (Positive, "Width h of the smoothed count [–]."),
    "cov": (Positive, "Coefficient of variation of the estimate [–]."),
    "rays": (Annotated[int, Field(ge=8)], "Number of rays."),
    "seed": (models.Index, "Seed of the rays."),
    "contents": (list[str], "Names of [[contents]]; by default all."),
    "oscillators": (list[str], "Names of [[oscillators]]; by default all."),
    "name": (str, "Name in reports."),
}
# Targets: kind → class, required keys in the order of the first arguments, and optional keys.
TARGETS: dict[str, tuple[Callable[..., AbstractTarget], str, str]] = {
    **{kind: (functools.partial(PeakLimit, output), "limit motions", "") for kind, output in PEAKS.items()},
    "peak-rotation": (PeakRotation, "limit motions", ""),
    "peak-shear": (PeakShear, "limit motions", ""),
    "peak-deformation": (PeakDeformation, "limit motions", ""),
    "peak-drift": (PeakDrift, "limit motions", ""),
    "peak-floor-acceleration": (PeakFloorAcceleration, "limit motions", ""),
    "peak-friction": (PeakFriction, "limit motions", ""),
    "peak-foundation-shear": (PeakFoundationShear, "limit motions", ""),
    "least-axial-force": (LeastAxialForce, "at_least motions", ""),
    "contents-rotation": (ContentsRotation, "limit motions", "contents"),
    "floor-spectrum": (FloorSpectrum, "limit motions", "oscillators"),
    "no-overturning": (NoOverturning, "motions", ""),
    "overturning-acceleration": (
        OverturningAcceleration,
        "at_least pulse",
        "T_p frequency_ratio ratio max_acceleration_ratio width",
    ),
    "overturning-scale": (OverturningScale, "at_least motions", "max_scale width"),
    "median-capacity": (MedianCapacity, "at_least motions", "max_scale width"),
    "annual-frequency": (AnnualFrequency, "at_most hazard motions", "max_intensity width"),
    "overturning-probability": (OverturningProbability, "at_most motions", "intensity smoothing"),
    "failure-probability": (FailureProbability, "at_most motion", "cov rays seed"),
}


def _target(kind: str) -> Any:
    """Return the model of the table of a target."""
    _, required, optional = TARGETS[kind]
    fields: Any = {name: (TARGET_KEYS[name][0], key(..., TARGET_KEYS[name][1])) for name in required.split()}
    for name in (*optional.split(), "name"):
        fields[name] = TARGET_KEYS[name][0] | None, key(None, TARGET_KEYS[name][1])
    fields["kind"] = Literal[kind], key(..., "Kind of the target.")
    return create_model(kind, __base__=models.Keys, **fields)


if TYPE_CHECKING:
    Target = Any
else:
    Target = Annotated[functools.reduce(operator.or_, map(_target, TARGETS)), Field(discriminator="kind")]


class Quantity(models.Keys):
    """Objective: a parameter of the podium, or a peak under motions."""

    quantity: str = key(..., f"A parameter of the podium, {', '.join(WORST)}.")
    motions: str | None = key(None, _SET)


class LossKeys(models.Keys):
    """Objective: cost of the podium and expected loss by overturning."""

    quantity: Literal["expected-loss"]
    cost: Annotated[dict[str, Positive], Field(min_length=1)] = key(
        ..., "Cost for each unit of some parameters."
    )
    loss: Positive = key(..., "Loss by one overturning, in the unit of the cost.")
    hazard: str = key(..., _HAZARD)
    motions: str = key(..., _SET)
    max_intensity: Positive | None = key(None, _END)
    width: Positive | None = key(None, _WIDTH)


def _objective_tag(table: Any) -> str:
    """Return the tag of the model that validates the table `minimise`."""
    return "Loss" if isinstance(table, dict) and table.get("quantity") == EXPECTED_LOSS else "Quantity"


class ProblemFile(models.Problem):
    """A problem file with a design."""

    structure: models.Structure = key(..., "The structure, by ratios or by dimensions.")
    vary: dict[str, models.Bounds] = key(..., "Design variables: name = [lowest, highest].")
    minimise: (
        Annotated[
            Annotated[LossKeys, Tag("Loss")] | Annotated[Quantity, Tag("Quantity")],
            Discriminator(_objective_tag),
        ]
        | None
    ) = key(None, "The objective, by default the distance from the start.")
    targets: list[Target] = key([], "Conditions that the design must satisfy.")

    @model_validator(mode="after")
    def _check(self) -> ProblemFile:
        if self.minimise is None and not self.targets:
            raise ValueError("there is nothing to do; give [minimise], [[targets]] or both")
        return self


SETTINGS = ("starts", "seed", "tolerance", "max_iterations")


class Problem(NamedTuple):
    """Design problem of a file: the arguments of [`optimise.design`][], and the sets of motions by name.

    - `podium`, `vary`, `minimise`, `targets`, `options`: arguments of [`optimise.design`][]
    - `settings`: its further arguments, `starts`, `seed`, `tolerance` and `max_iterations`, as far as given
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
        """Return the design; `changes` are further arguments of [`optimise.design`][], or replace some."""
        settings: dict[str, Any] = {"options": self.options} | self.settings | changes
        return design(self.podium, self.vary, self.minimise, self.targets, **settings)

    def __repr__(self):
        return _format_problem(self)


def _format_problem(problem: Problem) -> str:
    """Return a problem as text: variables at the start, targets with their scenes, sets of motions."""
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
    """Read the design problem of a TOML file.

    Raises `ValueError`, which names the file, the key and the cause.
    """
    path = Path(path)
    return problem_of(load_table(path), path)


def problem_of(
    table: dict[str, Any], path: Path, options: Mapping[str, tuple[str, Any]] | None = None
) -> Problem:
    """Return the design problem of a table.

    - `table`: contents of the file; `path`: path of the file
    - `options`: as in `rockjax._problem.reading.Reader`
    """
    return _Reader(path, options).problem(table)


class _ParameterOf:
    """Function that returns one parameter of a podium; its `__name__` is the name of the parameter."""

    def __init__(self, name: str):
        self.__name__ = name

    def __call__(self, podium: rj.Podium):
        return read(podium, self.__name__)


class _Cost:
    """Cost of a podium: a rate for each unit of some parameters."""

    __name__ = "cost"

    def __init__(self, rates: dict[str, float]):
        self.rates = rates

    def __call__(self, podium: rj.Podium):
        return sum(rate * read(podium, name) for name, rate in self.rates.items())


class _Reader(Reader):
    """Reader of the tables of a design problem."""

    def problem(self, table: dict[str, Any]) -> Problem:
        """Return the problem of a table. Raises `ValueError`, which names the file, the key and the cause."""
        checked = self.check(ProblemFile, table)
        structure = self.structure(checked.structure, Dimensions)
        podium = as_podium(structure)
        motions = self.motions(checked.motions, podium)
        with self.at("vary"):
            make_variables(structure, checked.vary)
        things = {
            "contents": self.contents(checked.contents),
            "oscillators": self.oscillators(checked.oscillators),
        }
        targets = tuple(
            self.target(entry, f"targets[{k}]", motions, podium, things)
            for k, entry in enumerate(checked.targets)
        )
        minimise = None if checked.minimise is None else self.minimise(checked.minimise, motions, podium)
        settings = {name: value for name, value in checked.as_arguments().items() if name in SETTINGS}
        return Problem(
            structure, checked.vary, minimise, targets, self.options(checked.options), settings, motions
        )

    def minimise(self, entry: Quantity | LossKeys, motions: Mapping[str, Any], podium: rj.Podium) -> Any:
        """Return the objective.

        - `entry`: table of the objective
        - `motions`: sets of motions by name; `podium`: the structure at the start
        """
        parameters = tuple(parameters_of(podium))
        if isinstance(entry, LossKeys):
            for name in entry.cost:
                if name not in parameters:
                    self.fail(
                        f"minimise.cost.{name}",
                        f"is not a parameter of the podium; they are {', '.join(parameters)}",
                    )
            with self.at("minimise"):
                suite = motions[self.require_set(motions, entry.motions, "minimise.motions")]
                risk = AnnualFrequency(
                    1.0,
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
            self.fail("minimise", f"motions is missing; name the set of [motions] for {entry.quantity}")
        return WORST[entry.quantity](motions[self.require_set(motions, entry.motions, "minimise.motions")])

    def hazard(self, name: str) -> rj.Hazard:
        """Return the hazard curve of a file, whose name is relative to the folder of the problem file."""
        return rj.Hazard.from_file(self.folder / name).in_si()

    def target(
        self,
        entry: Any,
        location: str,
        motions: Mapping[str, Any],
        podium: rj.Podium,
        things: Mapping[str, Mapping[str, Any]],
    ) -> AbstractTarget:
        """Return a target; its required keys are the first arguments of its class, in order.

        - `entry`: table of the target; `location`: its key, for errors
        - `motions`: sets of motions by name; `podium`: the structure at the start
        - `things`: contents and oscillators of the file by name
        """
        with self.at(location):
            arguments: dict[str, Any] = entry.as_arguments("kind")
            if "motions" in arguments:
                set_name = self.require_set(motions, entry.motions, f"{location}.motions")
                arguments["motions"] = motions[set_name]
            if "hazard" in arguments:
                arguments["hazard"] = self.hazard(entry.hazard)
            if "pulse" in arguments:
                models.require_one(arguments, "T_p", "frequency_ratio")
                arguments |= {"pulse": PULSES[entry.pulse], "T_p": pulse_periods(entry, podium)}
                arguments.pop("frequency_ratio", None)
            if "motion" in arguments:
                with self.at(f"{location}.motion"):
                    motion_arguments = entry.motion.as_arguments()
                    if "envelope" in motion_arguments:
                        envelope = motion_arguments["envelope"]
                        motion_arguments["envelope"] = rj.Envelope(**envelope.as_arguments())
                    arguments["motion"] = rj.GaussianMotion(**motion_arguments)
            make, required, optional = TARGETS[entry.kind]
            for table in set(optional.split()) & things.keys():
                arguments[table] = self.chosen_things(table, things[table], arguments.get(table))
            positional = [arguments.pop(name) for name in required.split()]
            return make(*positional, **arguments)

    def chosen_things(self, table: str, things: Mapping[str, Any], names: list[str] | None) -> list[Any]:
        """Return the things of a table with these names, or all. Raises `ValueError` for other names, and
        without any."""
        if not things:
            raise ValueError(f"needs [[{table}]], what stands on the floors")
        for name in names or ():
            if name not in things:
                raise ValueError(f"{table} must be of {', '.join(things)}, got {name!r}")
        return [things[name] for name in names or things]
