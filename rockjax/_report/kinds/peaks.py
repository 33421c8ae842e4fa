"""Kinds of checks of peaks: one kind for each peak among the outputs, and some for quantities derived from
peaks."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from rockjax._outputs.base import JOINT_NAMES, JOINTS, STORIES
from rockjax._outputs.registry import REGISTRY, VARIABLES
from rockjax._report.derivatives import SlopesFunction, scene_answers, slopes_of
from rockjax._report.entry import Entry
from rockjax._report.problem import Problem
from rockjax._report.scenes import Scenes
from rockjax._report.tables import Quantity, Text
from rockjax._report.units import kind_of_unit
from rockjax._structures import Podium
from rockjax._types import Value

from .base import Kind, Values, errors_of, with_texts, worst_of


@dataclasses.dataclass(frozen=True)
class PeakKind(Kind):
    """A check of a peak, which may be multiplied by a factor that depends on the structure.

    - `variable`: name of the peak in datasets of scenes
    - `factor`: function (problem, podium) ↦ one factor, or one for each joint, storey or mode; None for the
      factor 1
    - `needs`: function (problem) ↦ sentence about missing inputs; "" if no input is missing
    - `powers`: pairs (input, exponent) for the inputs that `factor` takes from the problem. A variation
      changes the podium, but not the problem. Therefore, if a variation multiplies such an input by y, the
      value of the check is multiplied by y ** exponent
    - `convert`: function (podium, multiplied peak) ↦ value of the check; None for no conversion
    """

    variable: str = ""
    factor: Callable[[Problem, Podium], Any] | None = None
    needs: Callable[[Problem], str] = lambda problem: ""
    powers: tuple[tuple[str, float], ...] = ()
    convert: Callable[[Podium, Any], Any] | None = None

    @property
    def has_variants(self) -> bool:
        return True

    @property
    def is_of_joints(self) -> bool:
        return VARIABLES[self.variable][0].axis == JOINTS

    def missing(self, entry: Entry, problem: Problem) -> str:
        positions = problem.missing_positions if self.is_of_joints else ""
        if positions:
            positions = f"The file has no {positions}, which the forces in the joints of each column need."
        reasons = super().missing(entry, problem), self.needs(problem), positions
        reason = " ".join(filter(None, reasons))
        variable, output = VARIABLES[self.variable]
        if not reason and not REGISTRY[output].applies(problem.podium):
            need = "a building with stories" if variable.axis == STORIES else "a superstructure"
            if output in ("peak_drift", "peak_deformation"):
                need += " that vibrates"
            return f"The structure has no {variable.description}; the check needs {need}."
        return reason

    def outputs(self, entry: Entry) -> tuple[str, ...]:
        return (VARIABLES[self.variable][1],)

    def conversion(self, problem: Problem, podium: Podium) -> Callable[[Any], Any]:
        """Return the function that converts peaks to values of the check. The last axis of its argument may
        run over joints, storeys or modes."""
        factor = None if self.factor is None else self.factor(problem, podium)
        convert = self.convert

        def values(peaks: Any) -> Any:
            scaled = peaks if factor is None else peaks * jnp.broadcast_to(factor, np.shape(peaks))
            return scaled if convert is None else convert(podium, scaled)

        return values

    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, variation: str = "") -> Values:
        problem = scenes.problem
        data = scenes.peaks(str(entry.motions), law, variation)
        podium, axis = scenes.podium(law, variation), VARIABLES[self.variable][0].axis
        raw = np.asarray(data[self.variable], float)
        to_values = self.conversion(problem, podium)
        all_values = np.asarray(to_values(raw))
        shifted = np.asarray(to_values(raw + errors_of(data, self.variable)))
        with np.errstate(invalid="ignore"):
            error = np.abs(shifted - all_values)
        factors = scenes.factors(variation)
        for name, exponent in self.powers:
            all_values, error = (y * factors.get(name, 1.0) ** exponent for y in (all_values, error))
        locations: list[Text] = [""] * len(raw)
        if axis is not None and all_values.ndim > 1:  # buildings with a single mode have no axis of modes
            all_values, error, worst = worst_of(all_values, error, self.is_minimum)
            location_names = {
                JOINTS: lambda k: f"{JOINT_NAMES[k]} joint",
                STORIES: lambda k: f"storey {k + 1}",
            }
            locations = [location_names.get(axis, lambda k: f"mode {k + 1}")(int(k)) for k in worst]
        if self.variable == "peak_rotation":
            times = data["peak_rotation_time"].values
            locations = [(Quantity(t, "time"),) if np.isfinite(t) else "" for t in times]
        return with_texts(scenes, entry, data, all_values, error, locations, self.is_minimum)

    def slopes_function(self, entry: Entry, scenes: Scenes, case: int) -> SlopesFunction | None:
        answers, problem = scene_answers(scenes, str(entry.motions), case), scenes.problem
        exponents = np.array([dict(self.powers).get(key, 0.0) for key in (*problem.variables, "motion")])
        peaks, slopes = answers[self.variable]
        if self.factor is None and self.convert is None:
            worst = np.argmin(peaks) if self.is_minimum else np.argmax(peaks)
            value = np.ravel(peaks)[worst]
            return lambda: (value, slopes.reshape(-1, exponents.size)[worst] + value * exponents)

        def value(podium: Podium, logs: Any) -> Value:
            all_values = self.conversion(problem, podium)(peaks + slopes @ logs)
            worst = jnp.min(all_values) if self.is_minimum else jnp.max(all_values)
            return worst * jnp.exp(exponents @ logs)

        return slopes_of(problem, value, jit=True)


@dataclasses.dataclass(frozen=True)
class NoOverturning(Kind):
    """A check that no motion overturns the columns. The value is max|θ|/α divided by the option
    `overturn_ratio`, so the limit is 1."""

    @property
    def has_variants(self) -> bool:
        return True

    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, variation: str = "") -> Values:
        data = scenes.peaks(str(entry.motions), law, variation)
        ratio = float(scenes.problem.options.overturn_ratio)
        values = np.asarray(data["peak_rotation"], float) / ratio
        errors = errors_of(data, "peak_rotation") / ratio
        return with_texts(scenes, entry, data, values, errors, [""] * len(values), False)


def _share_of_dead_load(podium: Podium, force: Any, without_load: float) -> Any:
    """Return axial forces divided by the dead loads of the joints, (…, 2). `without_load`: result for a joint
    without dead load, such as the top of a column that carries nothing."""
    load = jnp.broadcast_to(podium.dead_load, np.shape(force))
    return jnp.where(load > 0, force / jnp.where(load > 0, load, 1.0), without_load)


def _per_height(problem: Problem, podium: Podium) -> np.ndarray:
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
    """Return the contact pressure of a column [Pa] under the axial force m_c g."""
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
    """Return the displacement of the deck u_b [m], Eq. (13) of docs/model.md. `rotation`: |θ|/α [–]."""
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


def peak_kinds() -> list[Kind]:
    """Return a kind for each peak among the outputs, and kinds for quantities derived from peaks."""
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
            kind_of_unit(variable.unit),
            is_minimum=name.startswith("least"),
            section=4 if name == "peak_rotation" else section,
            variable=name,
        )
        if name.endswith("axial_force"):  # joints without dead load do not govern
            without_load = np.inf if name.startswith("least") else 0.0
            make = functools.partial(
                make, convert=functools.partial(_share_of_dead_load, without_load=without_load)
            )
        kinds.append(make())
    kinds += [
        PeakKind(
            "peak-drift-ratio",
            "Storey drift / height",
            "ratio",
            section=6,
            variable="peak_drift",
            factor=_per_height,
            needs=_needs_heights,
            powers=(("story_heights", -1.0), ("superstructure.heights", -1.0)),
        ),
        PeakKind(
            "contact-pressure",
            "Contact pressure at a column edge",
            "stress",
            section=5,
            variable="peak_axial_force",
            factor=_pressure,
            needs=_needs_contact,
            powers=(("column_mass", 1.0),),
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
