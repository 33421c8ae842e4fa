"""Design problems in TOML files: their tables besides structure, motions and options."""

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
from ._targets import (
    AbstractTarget,
    LeastAxialForce,
    MedianCapacity,
    NoOverturning,
    OverturningAcceleration,
    OverturningProbability,
    OverturningScale,
    PeakDeformation,
    PeakDrift,
    PeakFloorAcceleration,
    PeakFoundationShear,
    PeakFriction,
    PeakLimit,
    PeakRotation,
    PeakShear,
)
from ._variables import Dimensions, Structure, as_podium, make_variables

EXPECTED_LOSS = "expected-loss"
# Outputs that a limit can be set to, by their kind in a problem file.
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
_SET, _WIDTH = (
    "Name of a set of motions.",
    "Width down to which windows are found, over the range searched [–].",
)
_HAZARD, _END = "File of a hazard curve, beside this file.", "End of the search, in SI units of the hazard."


class EnvelopeKeys(models.Keys):
    """The envelope of a random motion."""

    t_1: Positive | None = key(None, "End of the rise [s].")
    t_2: Positive | None = key(None, "Begin of the decay [s].")
    c: Positive | None = key(None, "Rate of the decay [1/s].")


class GaussianKeys(models.Keys):
    """A random motion, as `rockjax.GaussianMotion`."""

    n: models.Points = key(..., "Number of samples.")
    dt: Positive = key(..., "Sampling interval [s].")
    S_0: Positive = key(..., "Spectral density of the noise [m²/s³].")
    omega_g: Positive | None = key(None, "Frequency of the soil [rad/s].")
    zeta_g: Positive | None = key(None, "Damping ratio of the soil [–].")
    omega_f: Positive | None = key(None, "Frequency of the high-pass filter [rad/s].")
    zeta_f: Positive | None = key(None, "Its damping ratio [–].")
    envelope: EnvelopeKeys | None = key(None, "Envelope of the motion.")


# Keys of targets: type and meaning.
TARGET_KEYS: dict[str, tuple[Any, str]] = {
    "limit": (
        Positive,
        "Largest peak: |θ|/α, V/(m_t g), |T|/N, V/W_0 [–], deformation [m], acceleration [m/s²].",
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
    "name": (str, "Name in reports."),
}
# Targets: class, the keys of its first arguments in order, and further keys.
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
    """Return the model of a target."""
    _, needed, further = TARGETS[kind]
    fields: Any = {name: (TARGET_KEYS[name][0], key(..., TARGET_KEYS[name][1])) for name in needed.split()}
    for name in (*further.split(), "name"):
        fields[name] = TARGET_KEYS[name][0] | None, key(None, TARGET_KEYS[name][1])
    fields["kind"] = Literal[kind], key(..., "Kind of the target.")
    return create_model(kind, __base__=models.Keys, **fields)


if TYPE_CHECKING:
    Target = Any
else:
    Target = Annotated[functools.reduce(operator.or_, map(_target, TARGETS)), Field(discriminator="kind")]


class Quantity(models.Keys):
    """A parameter of the podium, or a peak under motions."""

    quantity: str = key(..., f"A parameter of the podium, {', '.join(WORST)}.")
    motions: str | None = key(None, _SET)


class LossKeys(models.Keys):
    """Cost of the podium and loss by overturning."""

    quantity: Literal["expected-loss"]
    cost: Annotated[dict[str, Positive], Field(min_length=1)] = key(..., "Cost for each unit of parameters.")
    loss: Positive = key(..., "Loss of an overturning, in the unit of the cost.")
    hazard: str = key(..., _HAZARD)
    motions: str = key(..., _SET)
    max_intensity: Positive | None = key(None, _END)
    width: Positive | None = key(None, _WIDTH)


def _quantity(given: Any) -> str:
    return "Loss" if isinstance(given, dict) and given.get("quantity") == EXPECTED_LOSS else "Quantity"


class ProblemFile(models.Problem):
    """A problem file with a design."""

    structure: models.Structure = key(..., "The structure, by ratios or by dimensions.")
    vary: dict[str, models.Bounds] = key(..., "What may vary: name = [lowest, highest].")
    minimise: (
        Annotated[
            Annotated[LossKeys, Tag("Loss")] | Annotated[Quantity, Tag("Quantity")], Discriminator(_quantity)
        ]
        | None
    ) = key(None, "What is to be least; the nearest design where not given.")
    targets: list[Target] = key([], "What the design must keep.")

    @model_validator(mode="after")
    def _check(self) -> ProblemFile:
        if self.minimise is None and not self.targets:
            raise ValueError("nothing to do: give [minimise], [[targets]] or both")
        return self


SETTINGS = ("starts", "seed", "tolerance", "max_iterations")


class Problem(NamedTuple):
    """Problem of a file: the arguments of [`optimise.design`][], and the sets of motions by name."""

    podium: Structure
    vary: dict[str, tuple[float, float]]
    minimise: AbstractObjective | Callable[[rj.Podium], Any] | None
    targets: tuple[AbstractTarget, ...]
    options: rj.Options
    settings: dict[str, Any]  # starts, seed, tolerance, max_iterations
    motions: dict[str, list[rj.AbstractExcitation]]

    def design(self, **changes) -> Design:
        """Solve the problem; `changes` add to the arguments of [`optimise.design`][] or replace them."""
        settings: dict[str, Any] = {"options": self.options} | self.settings | changes
        return design(self.podium, self.vary, self.minimise, self.targets, **settings)

    def __repr__(self):
        return _format_problem(self)


def _format_problem(problem: Problem) -> str:
    """Return a problem as text: variables at the start, targets with their scenes, sets of motions."""
    objective = problem.minimise
    if objective is None:
        least = "the nearest design"
    elif isinstance(objective, AbstractObjective):
        least = f"least {objective.describe()}"
    else:
        least = f"least {getattr(objective, '__name__', 'objective')}"
    box = make_variables(problem.podium, problem.vary)
    start = box.values(box.start())
    rows = [["variable", "start", "unit", "bounds"]]
    for name, value, unit in zip(box.names, start, box.units, strict=True):
        low, high = problem.vary[name]
        rows.append([name, f"{float(value):.6g}", unit, f"{low:g} … {high:g}"])
    targets = [
        ["target", "scenes"],
        *([target.name or target.describe(), str(target.scenes)] for target in problem.targets),
    ]
    sets = [["motions", "count"], *([name, str(len(motions))] for name, motions in problem.motions.items())]
    lines = [f"Problem: {least}", f"  {format_call(problem.podium)}"]
    return "\n".join([*lines, *aligned(rows), *aligned(targets), *aligned(sets)])


def load(path: str | Path) -> Problem:
    """Read the design problem of a TOML file.

    Raises `ValueError` that names the file, the key and the cause.
    """
    path = Path(path)
    return problem_of(load_table(path), path)


def problem_of(
    table: dict[str, Any], path: Path, options: Mapping[str, tuple[str, Any]] | None = None
) -> Problem:
    """Return the design problem of the table of a file; `options` as in `rockjax._problem.reading.Reader`."""
    return _Reader(path, options).problem(table)


class _Number:
    """Function that returns one parameter of a podium, with its name."""

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
    """Reads the tables of a design."""

    def problem(self, table: dict[str, Any]) -> Problem:
        """Return the problem of a table. Raises `ValueError` that names the file, the key and the cause."""
        given = self.check(ProblemFile, table)
        structure = self.structure(given.structure, Dimensions)
        podium = as_podium(structure)
        motions = self.motions(given.motions, podium)
        with self.at("vary"):
            make_variables(structure, given.vary)
        targets = tuple(
            self.target(entry, f"targets[{k}]", motions, podium) for k, entry in enumerate(given.targets)
        )
        minimise = None if given.minimise is None else self.minimise(given.minimise, motions, podium)
        settings = {name: value for name, value in given.as_arguments().items() if name in SETTINGS}
        return Problem(
            structure, given.vary, minimise, targets, self.options(given.options), settings, motions
        )

    def minimise(self, entry: Quantity | LossKeys, motions: Mapping[str, Any], podium: rj.Podium) -> Any:
        """Return the objective."""
        known = tuple(parameters_of(podium))
        if isinstance(entry, LossKeys):
            for name in entry.cost:
                if name not in known:
                    self.fail(f"minimise.cost.{name}", f"is not known; known are {', '.join(known)}")
            with self.at("minimise"):
                suite = motions[self.require_set(motions, entry.motions, "minimise.motions")]
                risk = AnnualFrequency(
                    1.0,
                    self.hazard(entry.hazard),
                    suite,
                    **entry.as_arguments("quantity", "cost", "loss", "hazard", "motions"),
                )
                return ExpectedLoss(_Cost(entry.cost), entry.loss, risk)
        if entry.quantity in known and entry.motions is not None:
            self.fail("minimise.motions", f"leave it out: {entry.quantity} does not depend on motions")
        if entry.quantity in known:
            return _Number(entry.quantity)
        if entry.quantity not in WORST:
            every = ", ".join((*known, *WORST, EXPECTED_LOSS))
            self.fail("minimise.quantity", f"must be one of {every}, got {entry.quantity!r}")
        if entry.motions is None:
            self.fail("minimise", f"motions is missing; name the set of [motions] for {entry.quantity}")
        return WORST[entry.quantity](motions[self.require_set(motions, entry.motions, "minimise.motions")])

    def hazard(self, name: str) -> rj.Hazard:
        """Return the hazard curve in a file beside this one."""
        return rj.Hazard.from_file(self.folder / name).in_si()

    def target(
        self, entry: Any, location: str, motions: Mapping[str, Any], podium: rj.Podium
    ) -> AbstractTarget:
        """Return a target; its required keys are the first arguments of its class, in order.

        - `entry`: table of the target; `location`: its key, for errors
        - `motions`: sets of motions by name; `podium`: the structure at the start
        """
        with self.at(location):
            given: dict[str, Any] = entry.as_arguments("kind")
            if "motions" in given:
                given["motions"] = motions[self.require_set(motions, entry.motions, f"{location}.motions")]
            if "hazard" in given:
                given["hazard"] = self.hazard(entry.hazard)
            if "pulse" in given:
                models.require_one(given, "T_p", "frequency_ratio")
                given |= {"pulse": PULSES[entry.pulse], "T_p": pulse_periods(entry, podium)}
                given.pop("frequency_ratio", None)
            if "motion" in given:
                with self.at(f"{location}.motion"):
                    numbers = entry.motion.as_arguments()
                    if "envelope" in numbers:
                        numbers["envelope"] = rj.Envelope(**numbers["envelope"].as_arguments())
                    given["motion"] = rj.GaussianMotion(**numbers)
            make, needed, _ = TARGETS[entry.kind]
            first = [given.pop(name) for name in needed.split()]
            return make(*first, **given)
