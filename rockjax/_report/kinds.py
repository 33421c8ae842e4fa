"""Kinds of checks: what they evaluate, and which keys they have. Those of peaks are made from the outputs."""

from __future__ import annotations

import abc
import dataclasses
import functools
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from pydantic import create_model

from rockjax._outputs.base import JOINT_NAMES, JOINTS, STORIES
from rockjax._outputs.registry import REGISTRY, VARIABLES
from rockjax._problem.models import key
from rockjax._structures import Podium
from rockjax._types import Value

from .keys import CheckKeys
from .problem import Problem
from .scenes import Scenes, Traced
from .units import KINDS as QUANTITIES
from .units import to_si

QUANTITY_OF_UNIT = {"1": "number", "m": "displacement", "m s-2": "acceleration", "m s-1": "velocity"}


class Values(NamedTuple):
    """Values of a check for each motion of its set, or one value for the set.

    - `values`: (n,) in SI; ±inf where there is a word instead
    - `errors`: (n,) estimated errors, NaN where unknown
    - `words`: (n,) what replaces a number, such as "overturned at 5.85 s"; "" elsewhere
    - `places`: (n,) storey or joint and time of the value; "" without
    - `unanswered`: (n,) names of results without an answer, or "undecided"; "" elsewhere
    - `is_of_set`: whether the value belongs to the whole set, so that no motion governs
    """

    values: np.ndarray
    errors: np.ndarray
    words: tuple[str, ...]
    places: tuple[str, ...]
    unanswered: tuple[str, ...]
    is_of_set: bool = False


@dataclasses.dataclass(frozen=True)
class Kind(abc.ABC):
    """A kind of check.

    - `name`: in problem files; `title`: on the page
    - `quantity`: kind of its numbers, as in `units.KINDS`
    - `is_minimum`: whether the value must be at least the limit
    - `section`: section of the page with the details
    - `keys`: further keys: name → (type, description)
    """

    name: str
    title: str
    quantity: str
    is_minimum: bool = False
    section: int = 4
    keys: tuple[tuple[str, Any, str], ...] = ()
    needs_motions: bool = True
    needs_limit: bool = True

    def limit(self, entry: CheckKeys, g: float) -> float:
        """Return the limit [SI] of a check. Raises `ValueError` for none, two, or a unit of another kind."""
        own = "at_least" if self.is_minimum else "at_most"
        given = {name: getattr(entry, name) for name in ("limit", "at_least", "at_most")}
        given = {name: value for name, value in given.items() if value is not None}
        if not given and not self.needs_limit:
            return 1.0
        if len(given) != 1:
            raise ValueError(f"{self.name} needs exactly one of limit and {own}, got {len(given)}")
        ((name, value),) = given.items()
        if name not in ("limit", own):
            raise ValueError(f"{self.name} is a check with limit or {own}, got {name}")
        if entry.unit is None:
            return value
        return to_si(value, entry.unit, self.quantity, g=g, owner="unit", subject=self.name)

    def check(self, entry: CheckKeys, podium: Podium) -> None:
        """Raise `ValueError` for keys that contradict each other."""
        limit = self.limit(entry, float(podium.g))
        if not self.is_minimum and limit <= 0:
            raise ValueError(f"the limit of {self.name} must be > 0, got {limit:g}")

    def missing(self, entry: CheckKeys, problem: Problem) -> str:
        """Return why the check cannot be made, and what would make it possible; "" if it can be made."""
        if entry.vertical and entry.motions and not problem.motions[entry.motions].has_vertical:
            return (
                f"The motions of {entry.motions} have no vertical component; give one by the keys vertical, "
                "vertical_ratio or paired of the set."
            )
        return ""

    def outputs(self, entry: CheckKeys) -> tuple[str, ...]:
        """Return the outputs of the scenes of its set that it needs."""
        del entry
        return ()

    @abc.abstractmethod
    def values(self, entry: CheckKeys, scenes: Scenes, law: str | None = None, change: str = "") -> Values:
        """Return the values of the check.

        - `entry`: its keys; `scenes`: solves scenes and keeps their answers
        - `law`: law of impact instead of that of the structure
        - `change`: one of `Scenes.changes`; "" for the structure itself
        """

    def traced(self, entry: CheckKeys, scenes: Scenes, motion: int) -> Traced | None:
        """Return the value under one motion as a function that can be differentiated; None if there is
        none."""
        del entry, scenes, motion
        return None

    @property
    def powers(self) -> dict[str, float]:
        """Inputs that multiply the value besides their effect on the structure: key → exponent."""
        return {}

    @property
    def repeats(self) -> bool:
        """True if the check is evaluated again for other laws and for changed parameters."""
        return False


# ------------------------------------------------------------------------------------------- peaks of scenes
@dataclasses.dataclass(frozen=True)
class PeakKind(Kind):
    """A check of a peak: `variable` is its answer, multiplied by a factor of the structure."""

    variable: str = ""
    factor: Callable[[Problem, Podium], Any] = lambda problem, podium: 1.0  # number, or one for each place
    needs: Callable[[Problem], str] = lambda problem: ""
    explicit: tuple[tuple[str, float], ...] = ()  # inputs that multiply the value besides: key, exponent
    convert: Callable[[Podium, Any], Any] | None = None  # podium, value ↦ value, if it is no multiple

    @property
    def powers(self) -> dict[str, float]:
        return dict(self.explicit)

    @property
    def repeats(self) -> bool:
        return True

    def missing(self, entry: CheckKeys, problem: Problem) -> str:
        reason = super().missing(entry, problem) or self.needs(problem)
        variable, output = VARIABLES[self.variable]
        if not reason and not REGISTRY[output].applies(problem.podium):
            what = "a building with stories" if variable.axis == STORIES else "a structure that has it"
            return f"The structure has no {variable.description}; it needs {what}."
        return reason

    def outputs(self, entry: CheckKeys) -> tuple[str, ...]:
        return (VARIABLES[self.variable][1],)

    def of_array(self, values: Any, problem: Problem, podium: Podium) -> Any:
        """Return the values of the check from answers whose last axis are places, if they have one."""
        scaled = values * self.factor(problem, podium)
        return scaled if self.convert is None else self.convert(podium, scaled)

    def values(self, entry: CheckKeys, scenes: Scenes, law: str | None = None, change: str = "") -> Values:
        problem = scenes.problem
        data = scenes.peaks(str(entry.motions), law, change)
        podium, axis = scenes.podium(law, change), VARIABLES[self.variable][0].axis
        raw = np.asarray(data[self.variable], float)
        every = np.asarray(self.of_array(raw, problem, podium))
        name = f"{self.variable}_error"
        error = np.asarray(data[name], float) if name in data else np.full_like(raw, np.nan)
        moved = np.asarray(self.of_array(raw + error, problem, podium))
        with np.errstate(invalid="ignore"):
            error = np.abs(moved - every)
        factors = scenes.factors(change)
        for key_, power in self.explicit:
            every, error = (y * factors.get(key_, 1.0) ** power for y in (every, error))
        places = [""] * len(raw)
        if axis is not None:
            worst = np.argmin(every, axis=-1) if self.is_minimum else np.argmax(every, axis=-1)
            rows = np.arange(len(raw))
            every, error = every[rows, worst], error[rows, worst]
            words = {JOINTS: lambda k: f"{JOINT_NAMES[k]} joint", STORIES: lambda k: f"storey {k + 1}"}
            places = [words.get(axis, lambda k: f"mode {k + 1}")(int(k)) for k in worst]
        if self.variable == "peak_rotation":
            places = [f"{float(t):.3f} s" for t in data["peak_rotation_time"].values]
        return with_words(data, every, error, places, self.is_minimum)

    def traced(self, entry: CheckKeys, scenes: Scenes, motion: int) -> Traced | None:
        from rockjax._responses.simulate import peak_response

        variable, output = VARIABLES[self.variable]
        options = scenes.problem.options.replace(outputs=(output,), throw=False)

        def value(podium: Podium, excitation: Any) -> Value:
            peak = peak_response(podium, excitation, options=options)
            every = self.of_array(peak.values[self.variable], scenes.problem, podium)
            if variable.axis is None:
                return every
            return jnp.min(every) if self.is_minimum else jnp.max(every)

        return value


def with_words(data: Any, values: np.ndarray, errors: np.ndarray, places: list[str], least: bool) -> Values:
    """Return values of scenes, with words for scenes that overturned and for joints that open.

    - `data`: dataset of the scenes; `values`, `errors`, `places`: (n,)
    - `least`: whether the value must be at least a limit
    """
    from rockjax import _results as results

    overturned, code = np.asarray(data["overturned"]), np.asarray(data["result"])
    words, unanswered = [], []
    worst = -np.inf if least else np.inf
    values = np.array(values, float)
    for k in range(len(values)):
        word, without = "", ""
        if overturned[k]:
            word = f"overturned at {float(data['overturn_time'][k]):.2f} s"
            values[k] = worst
        elif code[k] > results.OVERTURNED:
            without = results.NAMES[int(code[k])]
        elif "undecided" in data and bool(data["undecided"][k]):
            without = "undecided"
        if not word and np.isinf(values[k]):
            word = "joint opens"
        words.append(word)
        unanswered.append(without)
    return Values(values, np.asarray(errors, float), tuple(words), tuple(places), tuple(unanswered))


def _dead_load(problem: Problem, podium: Podium) -> Any:
    del problem
    return 1 / podium.dead_load


def _heights(problem: Problem, podium: Podium) -> np.ndarray:
    del podium
    assert problem.story_heights is not None
    return 1 / problem.story_heights


def _needs_heights(problem: Problem) -> str:
    return (
        ""
        if problem.story_heights is not None
        else ("The heights of the stories are missing; give story_heights in [structure].")
    )


def _pressure(problem: Problem, podium: Podium) -> Any:
    joints, mass = problem.joints, problem.column_mass
    assert mass is not None
    assert joints.contact_width is not None
    assert joints.contact_depth is not None
    return mass * podium.g / (joints.contact_width * joints.contact_depth)


def _needs_contact(problem: Problem) -> str:
    names = [name for name in ("contact_width", "contact_depth") if getattr(problem.joints, name) is None]
    missing = [f"joints.{name}" for name in names]
    if problem.column_mass is None:
        missing.append("structure.column_mass")
    return f"The file has no {', no '.join(missing)}." if missing else ""


def deck_displacement(podium: Podium, rotation: Any) -> Any:
    """Return u_b of Eq. (13) at |θ|/α [m]."""
    alpha = podium.alpha
    return 2 * podium.R * (jnp.sin(alpha) - jnp.sin(alpha - rotation * alpha))


_TITLES = {
    "peak_rotation": "Rotation max|θ|/α",
    "peak_deformation": "Deformation of the superstructure",
    "peak_shear": "Base shear / weight of the building",
    "peak_drift": "Storey drift",
    "peak_floor_acceleration": "Floor acceleration",
    "peak_friction": "Friction demand |T|/N of the joints",
    "least_axial_force": "Least compression of a column / its share of the weight",
    "peak_axial_force": "Largest compression of a column / its share of the weight",
    "peak_foundation_shear": "Foundation shear / total weight",
    "peak_impact_friction": "Friction demand |J_T|/J_N at impacts",
    "least_impulse_share": "Least share of a column in an impulse",
    "peak_deck_acceleration": "Deck acceleration",
    "peak_velocity_jump": "Velocity jump of the deck at an impact",
}


def _peak_kinds() -> list[Kind]:
    """Return a kind for each answer that has a peak of a scene."""
    kinds: list[Kind] = []
    for name, (variable, _) in VARIABLES.items():
        if not variable.until_overturning:
            continue
        title = _TITLES.get(name) or variable.description[:1].upper() + variable.description[1:]
        section = 5 if variable.axis == JOINTS or "foundation" in name or "impulse" in name else 6
        make = functools.partial(
            PeakKind,
            name.replace("_", "-"),
            title,
            QUANTITY_OF_UNIT.get(variable.unit, "number"),
            is_minimum=name.startswith("least"),
            section=4 if name == "peak_rotation" else section,
            variable=name,
        )
        kinds.append(make(factor=_dead_load) if name.endswith("axial_force") else make())
    kinds += [
        PeakKind(
            "peak-drift-ratio",
            "Storey drift / height",
            "ratio",
            section=6,
            variable="peak_drift",
            factor=_heights,
            needs=_needs_heights,
            explicit=(("story_heights", -1.0),),
        ),
        PeakKind(
            "contact-pressure",
            "Contact pressure at a column edge",
            "stress",
            section=5,
            variable="peak_axial_force",
            factor=_pressure,
            needs=_needs_contact,
            explicit=(("column_mass", 1.0),),
        ),
        PeakKind(
            "displacement",
            "Displacement of the deck u_b at max|θ|",
            "displacement",
            variable="peak_rotation",
            convert=deck_displacement,
        ),
    ]
    return kinds


# -------------------------------------------------------------------------------------------------- searches
@dataclasses.dataclass(frozen=True)
class NoOverturning(Kind):
    """No motion overturns the columns: max|θ|/α at most `overturn_ratio`."""

    @property
    def repeats(self) -> bool:
        return True

    def outputs(self, entry: CheckKeys) -> tuple[str, ...]:
        del entry
        return ("peak_rotation",)

    def limit(self, entry: CheckKeys, g: float) -> float:
        del g
        if any(getattr(entry, name) is not None for name in ("limit", "at_least", "at_most")):
            raise ValueError("no-overturning has no limit; peak-rotation has one")
        return 1.0

    def values(self, entry: CheckKeys, scenes: Scenes, law: str | None = None, change: str = "") -> Values:
        data = scenes.peaks(str(entry.motions), law, change)
        ratio = float(scenes.problem.options.overturn_ratio)
        values = np.asarray(data["peak_rotation"], float) / ratio
        errors = np.asarray(data["peak_rotation_error"], float) / ratio
        return with_words(data, values, errors, [""] * len(values), False)


@dataclasses.dataclass(frozen=True)
class ScaleKind(Kind):
    """The least factor on the motions that lifts or overturns the columns; `event` is "uplift" or
    "overturning"."""

    event: str = "overturning"

    def values(self, entry: CheckKeys, scenes: Scenes, law: str | None = None, change: str = "") -> Values:
        del law, change
        data = scenes.scales(str(entry.motions), self.event)
        values = np.asarray(data["factor"], float)
        words = [
            "" if np.isfinite(y) else f"no {self.event} up to {float(data.attrs['limit']):.3g}"
            for y in values
        ]
        blank = ("",) * len(values)
        return Values(values, np.asarray(data["error"], float), tuple(words), blank, blank)

    def traced(self, entry: CheckKeys, scenes: Scenes, motion: int) -> Traced | None:
        return scenes.scale_function(self.event, str(entry.motions), motion)


@dataclasses.dataclass(frozen=True)
class RiskKind(Kind):
    """Annual frequency, or median capacity, by the tables `[fragility]` and `[risk]`."""

    variable: str = "frequency"

    def missing(self, entry: CheckKeys, problem: Problem) -> str:
        if self.variable == "frequency" and problem.risk.hazard is None:
            return "The file has no hazard curve; give risk.hazard."
        return super().missing(entry, problem)

    def values(self, entry: CheckKeys, scenes: Scenes, law: str | None = None, change: str = "") -> Values:
        del law, change
        data = scenes.risk(str(entry.motions), self.variable == "frequency")
        blank = ("",)
        return Values(
            np.atleast_1d(float(data[self.variable])), np.full(1, np.nan), blank, blank, blank, True
        )


# ------------------------------------------------------------------------------- checks outside of the model
@dataclasses.dataclass(frozen=True)
class OutsideModel(Kind):
    """A check that is known and not in the model."""

    reason: str = ""

    def check(self, entry: CheckKeys, podium: Podium) -> None:
        self.limit(entry, float(podium.g))

    def missing(self, entry: CheckKeys, problem: Problem) -> str:
        del entry, problem
        return self.reason

    def values(self, entry: CheckKeys, scenes: Scenes, law: str | None = None, change: str = "") -> Values:
        raise NotImplementedError


@dataclasses.dataclass(frozen=True)
class ByOthers(OutsideModel):
    """A check that others make; `text` and `reference` say which."""

    def limit(self, entry: CheckKeys, g: float) -> float:
        del entry, g
        return 1.0


_SEARCH = tuple(  # settings of design targets, which have no effect on reports
    (name, float | None, "A setting of `rockjax design`.") for name in ("max_scale", "width", "max_intensity")
)
_OTHERS = (("text", str, "What is checked."), ("reference", str, "Where it is checked."))
KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        *_peak_kinds(),
        NoOverturning("no-overturning", "No motion overturns the columns", "number", needs_limit=False),
        ScaleKind(
            "overturning-scale", "Least factor on the motions that overturns", "number", True, keys=_SEARCH
        ),
        ScaleKind(
            "uplift-scale",
            "Least factor on the motions that lifts the columns",
            "number",
            True,
            event="uplift",
        ),
        RiskKind(
            "median-capacity",
            "Median overturning intensity of the set",
            "number",
            True,
            7,
            keys=_SEARCH,
            variable="median",
        ),
        RiskKind(
            "annual-frequency",
            "Annual frequency of overturning",
            "rate",
            section=7,
            keys=(*_SEARCH, ("hazard", str, "Of design targets; a report uses risk.hazard.")),
        ),
        OutsideModel(
            "sliding-displacement",
            "Sliding displacement",
            "displacement",
            section=10,
            reason="Columns do not slide in the model (A1); peak-friction shows the demand.",
        ),
        OutsideModel(
            "soil-rotation",
            "Rotation of the soil",
            "angle",
            section=10,
            reason="The ground is rigid in the model (A5); a model with soil springs would be needed.",
        ),
        OutsideModel(
            "two-directions",
            "Motion in two directions",
            "number",
            section=10,
            needs_limit=False,
            reason="Motion is in a plane in the model (A3); a spatial model would be needed.",
        ),
        ByOthers(
            "by-others",
            "By others",
            "number",
            section=10,
            keys=_OTHERS,
            needs_motions=False,
            needs_limit=False,
        ),
    )
}
assert {kind.quantity for kind in KINDS.values()} <= set(QUANTITIES)


@functools.cache
def check_model(kind: str) -> type[CheckKeys]:
    """Return the model of the table of a check."""
    fields: Any = {name: (type_ | None, key(None, meaning)) for name, type_, meaning in KINDS[kind].keys}
    fields["kind"] = Literal[kind], key(..., "Kind of the check.")
    return create_model(f"Check_{kind}", __base__=CheckKeys, **fields)
