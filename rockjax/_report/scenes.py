"""The scenes of a report: each is solved once, when a check or a section first needs it."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._options import Options
from rockjax._outputs.registry import REGISTRY
from rockjax._responses.estimate import companion
from rockjax._responses.floor_answers import VARIABLES
from rockjax._responses.peak import data_variables
from rockjax._structures import Podium, ShearBuilding
from rockjax._structures.modes import with_fields
from rockjax._types import Value

from .entry import Entry
from .problem import MotionSet, Problem
from .store import Store, fingerprint
from .uplift import UpliftRatio

if TYPE_CHECKING:
    import xarray

Traced = Callable[[Any], Value]  # ln of the factors on every input and on the motion, (n + 1,) ↦ value

BASE = ("peak_rotation", "impacts", "errors")
JOINT_OUTPUTS = ("peak_friction", "axial_force", "impact_friction")
MAX_SCALE = 10.0  # end of the search for overturning factors
NEAR = 1e-6  # relative distance of scenes from the boundary
BOUNDARY_ERROR = 1e-9  # relative error of overturning factors at the tolerances of boundaries


class Needs(NamedTuple):
    """Outputs and things on floors (by name) that the checks of a set of motions need."""

    outputs: dict[str, None] = {}
    things: dict[str, Any] = {}


class Scenes:
    """The scenes of a problem.

    - `problem`: the problem; `store`: keeps their answers
    - `needed`: set of motions → what its checks need
    - `progress`: object with `update(number)` and `describe(text)`, or None
    """

    def __init__(self, problem: Problem, store: Store, needed: Mapping[str, Needs], progress: Any = None):
        self.problem, self.store, self.needed, self.progress = problem, store, needed, progress
        # Checks and sections ask for the same structures and scenes many times.
        self.podium, self.peaks = functools.cache(self._podium), functools.cache(self._peaks)
        self._changed_peaks = functools.cache(self._solve_changes)

    def say(self, text: str) -> None:
        """Show what is computed."""
        if self.progress is not None:
            self.progress.describe(text)

    @functools.cached_property
    def changes(self) -> tuple[str, ...]:
        """Names of the changed structures: each input ± spread, such as "width+" and "width-", and
        "motion+", "motion-" for the factor on all motions."""
        return tuple(f"{name}{sign}" for name in (*self.problem.variables, "motion") for sign in "-+")

    def factors(self, change: str) -> dict[str, float]:
        """Return key → factor of a change."""
        spread = self.problem.report.spread
        return {change[:-1]: 1 + spread if change[-1] == "+" else 1 - spread} if change else {}

    def _podium(self, law: str | None = None, change: str = "") -> Podium:
        """Return the structure with a law of impact and a change."""
        factors = {name: y for name, y in self.factors(change).items() if name != "motion"}
        podium = self.problem.varied(factors) if factors else self.problem.podium
        return podium if law is None else podium.replace(restitution=law)

    def motion_set(self, name: str) -> MotionSet:
        """Return a set of motions."""
        return self.problem.motions[name]

    @functools.cached_property
    def used_sets(self) -> tuple[str, ...]:
        """Names of the sets that a check uses, in the order of the file."""
        used = {entry.motions for entry in self.problem.checks}
        return tuple(name for name in self.problem.motions if name in used)

    def outputs(self, name: str) -> tuple[str, ...]:
        """Return the outputs of the scenes of a set: those of its checks, of the joints if the structure has
        an elevation, and of the tables of the page."""
        podium = self.problem.podium
        wanted: dict[str, None] = dict.fromkeys(BASE)
        for output in ("peak_shear", "peak_drift", "peak_floor_acceleration", "peak_velocity_jump"):
            if podium.superstructure is not None and REGISTRY[output].applies(podium):
                wanted[output] = None
        wanted |= self.needed.get(name, Needs()).outputs
        if podium.elevation is not None:
            wanted |= dict.fromkeys((*JOINT_OUTPUTS, "peak_foundation_shear"))
        return tuple(wanted)

    def options(self, name: str) -> Options:
        """Return the options of the scenes of a set."""
        return self.problem.options.replace(outputs=self.outputs(name), throw=False)

    # -------------------------------------------------------------------------------------------------- peaks
    def _peaks(
        self, name: str, law: str | None = None, change: str = "", factor: float = 1.0
    ) -> xarray.Dataset:
        """Return the peaks of the scenes of a set, along `motion`.

        - `name`: the set; `law`: law of impact instead of that of the structure
        - `change`: one of `changes`; `factor`: on all motions
        """
        if change:
            return self._changed_peaks(name, factor).sel(change=change)
        law = None if law is None or self._is_own_law(law) else law
        motions, options, podium = self.motion_set(name), self.options(name), self.podium(law)
        things = self.things(name)
        mark = fingerprint(podium, motions.hashes, options, things, factor)

        def solve() -> xarray.Dataset:
            self.say(f"scenes of {name}" + (f", law {law}" if law else ""))
            data = self._solve(podium, motions.scaled(factor), options, ("motion",), things)
            return self._with_floor_errors(data, podium, motions.scaled(factor), options, things)

        return self.store.get(f"peaks.{name}.{law or 'own'}{_suffix(factor)}", mark, solve)

    def things(self, name: str) -> dict[str, Any]:
        """Return the things on floors that checks of a set need: name → thing."""
        return self.needed.get(name, Needs()).things

    def _with_floor_errors(
        self, data: xarray.Dataset, podium: Podium, excitations: Any, options: Options, things: dict[str, Any]
    ) -> xarray.Dataset:
        """Return the peaks of scenes with estimated errors of the things on floors, from a second solution:
        inf where the solutions differ in what overturns."""
        if not things:
            return data
        finer = companion(options).replace(outputs=("peak_rotation",))
        other = self._solve(podium, excitations, finer, ("motion",), things)
        for name in ("contents_peak_rotation", "oscillator_pseudo_acceleration"):
            if name in data:
                error = np.abs(data[name].values - other[name].values)
                if name.startswith("contents"):
                    differs = data["contents_overturned"].values != other["contents_overturned"].values
                    error = np.where(differs, np.inf, error)
                data[f"{name}_error"] = data[name].dims, error
        return data

    def _is_own_law(self, law: str) -> bool:
        return fingerprint(self.podium(law)) == fingerprint(self.problem.podium)

    def _solve_changes(self, name: str, factor: float = 1.0) -> xarray.Dataset:
        """Return the peaks of a set with every change, along `change` and `motion`."""
        motions, options, things = self.motion_set(name), self.options(name), self.things(name)
        podiums = [self.podium(None, change) for change in self.changes]
        spread = self.problem.report.spread
        mark = fingerprint(podiums, self.changes, motions.hashes, options, spread, things, factor)

        def solve() -> xarray.Dataset:
            self.say(f"scenes of {name} with changed parameters")
            by_change = []
            for sign in ("-", "+"):  # the unchanged structure, with all motions smaller, then larger
                scaled = motions.scaled(factor * self.factors(f"motion{sign}")["motion"])
                by_change.append(self._solve(self.problem.podium, scaled, options, ("motion",), things))
            stacked, excitations = _stacked(podiums[:-2]), motions.scaled(factor)
            data = self._solve(stacked, excitations, options, ("change", "motion"), things)
            import xarray

            return xarray.concat(
                [data, *[y.expand_dims("change") for y in by_change]], "change"
            ).assign_coords(change=list(self.changes))

        return self.store.get(f"spread.{name}{_suffix(factor)}", mark, solve)

    def _solve(
        self,
        podium: Podium,
        excitations: Any,
        options: Options,
        dims: tuple[str, ...],
        things: Mapping[str, Any] = MappingProxyType({}),
    ) -> xarray.Dataset:
        """Return the peaks of a batch as a dataset.

        - `podium`, `excitations`, `options`: of the batch; `dims`: its dims
        - `things`: things on floors: name → thing; the names are coordinates of their dims
        """
        import xarray

        from rockjax._batch.batch import peak_responses

        progress, on_floors = self.progress or False, tuple(things.values())
        peaks = peak_responses(podium, excitations, options=options, progress=progress, on_floors=on_floors)
        data = xarray.Dataset(data_variables(peaks, options.outputs, dims))
        names = {
            dim: [
                name for name, answer in zip(things, peaks.on_floors, strict=True) if isinstance(answer, kind)
            ]
            for kind, (dim, _) in VARIABLES.items()
        }
        return data.assign_coords({dim: found for dim, found in names.items() if found})

    # ----------------------------------------------------------------------------------------------- searches
    def scales(self, name: str, event: str) -> xarray.Dataset:
        """Return the least factors on the motions of a set that lift or overturn the columns, along `motion`,
        with estimates of their errors.

        - `name`: the set; `event`: "uplift" or "overturning"
        """
        motions, podium, options = self.motion_set(name), self.problem.podium, self.problem.options
        mark = fingerprint(podium, motions.hashes, options, event, MAX_SCALE)
        solve = self._uplift if event == "uplift" else self._overturning
        return self.store.get(f"scales.{name}.{event}", mark, lambda: solve(motions))

    def _uplift(self, motions: MotionSet) -> xarray.Dataset:
        import xarray

        self.say(f"uplift factors of {motions.name}")
        factor = self._uplift_guess(motions)
        # Close to uplift, where the tolerance of the scenes is that of the factor.
        scaled = [y.scaled(0.9 * f) for y, f in zip(motions.excitations, factor, strict=True)]
        data = self._solve(self.problem.podium, scaled, self._uplift_options, ("motion",))
        factor = 0.9 * factor / data["uplift_ratio"].values
        error = factor * data["uplift_ratio_error"].values / data["uplift_ratio"].values
        return xarray.Dataset(
            {"factor": ("motion", factor), "error": ("motion", error)}, attrs={"limit": np.inf}
        )

    @property
    def _uplift_options(self) -> Options:
        return self.problem.options.replace(outputs=(UpliftRatio(), "peak_rotation", "errors"), throw=False)

    def _uplift_guess(self, motions: MotionSet) -> np.ndarray:
        """Return factors on the motions from scenes that do not lift the columns."""
        from rockjax._batch.batch import peak_responses

        podium = self.problem.podium
        threshold = float(podium.uplift_ground_acceleration)
        largest = np.array([_largest_acceleration(y) for y in motions.excitations])
        scale = 0.3 * threshold / largest
        for _ in range(20):
            scaled = [y.scaled(f) for y, f in zip(motions.excitations, scale, strict=True)]
            peaks = peak_responses(podium, scaled, options=self._uplift_options)
            if not np.any(peaks.uplifted):
                return scale / np.asarray(peaks.uplift_ratio)
            scale = np.where(peaks.uplifted, scale / 3, scale)
        raise RuntimeError(f"report: no factor keeps the columns of {motions.name} in contact")

    def _overturning(self, motions: MotionSet) -> xarray.Dataset:
        import xarray

        factors = []
        for name, excitation in zip(motions.names, motions.excitations, strict=True):
            self.say(f"overturning factor of {name}")
            factors.append(float(self._overturning_scale(self.problem.podium, excitation)))
        found = np.array(factors)
        # Boundaries are bisected to rounding, so that the error is that of their scenes.
        error = np.where(np.isfinite(found), found * BOUNDARY_ERROR, np.nan)
        return xarray.Dataset(
            {"factor": ("motion", found), "error": ("motion", error)}, attrs={"limit": MAX_SCALE}
        )

    @property
    def boundary_options(self) -> dict[str, Any]:
        """Arguments of searches for boundaries of overturning."""
        from rockjax._boundaries.boundary import BOUNDARY

        return {"options": BOUNDARY.replace(overturn_ratio=self.problem.options.overturn_ratio)}

    def _overturning_scale(self, podium: Podium, excitation: Any) -> Value:
        from rockjax._boundaries.boundary import overturning_scale

        return overturning_scale(podium, excitation, max_scale=MAX_SCALE, **self.boundary_options)

    def scale_function(self, event: str, name: str, motion: int) -> Traced:
        """Return the least factor on a motion as a function, for derivatives."""
        from rockjax._responses.simulate import peak_response

        excitation = self.motion_set(name).excitations[motion]
        if event == "overturning":
            return self.by_logs(lambda podium, y: self._overturning_scale(podium, excitation.scaled(y)))
        scale = 0.9 * float(self.scales(name, event)["factor"][motion])
        options = self._uplift_options.replace(outputs=(UpliftRatio(),))

        def least_factor(podium: Podium, factor: Value) -> Value:
            peak = peak_response(podium, excitation.scaled(scale * factor), options=options)
            return scale / peak.uplift_ratio

        return self.by_logs(least_factor)

    def scaled(self, label: str, name: str, factors: np.ndarray) -> xarray.Dataset:
        """Return the peaks of the motions of a set, each with its factor; `label`: name in the store."""
        motions = self.motion_set(name).excitations
        return self.of_excitations(label, name, [y.scaled(f) for y, f in zip(motions, factors, strict=True)])

    def of_excitations(self, label: str, name: str, excitations: list[Any]) -> xarray.Dataset:
        """Return the peaks of excitations.

        - `label`: name in the store; `name`: set whose outputs are requested
        """
        options, podium = self.options(name), self.problem.podium
        mark = fingerprint(podium, excitations, options)

        def solve() -> xarray.Dataset:
            self.say("scenes at the boundary")
            return self._solve(podium, excitations, options, ("motion",))

        return self.store.get(label, mark, solve)

    # ------------------------------------------------------------------------------------------- derivatives
    def slopes(self, entry: Entry, functions: Mapping[int, Traced]) -> xarray.Dataset:
        """Return d ln(value)/d ln y of a check for every input y and the factor on the motion, along `motion`
        and `parameter`.

        - `entry`: the check; `functions`: number of a case → its value as a function
        """
        import xarray

        problem, motions = self.problem, list(functions)
        names = [*problem.variables, *(["motion"] if entry.motions else [])]
        hashes = [self.motion_set(entry.motions).hashes[k] for k in motions] if entry.motions else []
        joints, about = problem.joints.model_dump(), (entry.kind, dict(entry.arguments))
        mark = fingerprint(problem.podium, hashes, problem.options, about, names, motions, joints)

        def solve() -> xarray.Dataset:
            self.say(f"derivatives of {entry.id}")
            origin = jnp.zeros(len(problem.variables) + 1)
            pairs = [jax.value_and_grad(function)(origin) for function in functions.values()]
            values = np.array([float(value) for value, _ in pairs])
            slopes = np.array([np.asarray(slope)[: len(names)] for _, slope in pairs]) / values[:, None]
            return xarray.Dataset(
                {"slope": (("motion", "parameter"), slopes), "value": ("motion", values)},
                coords={"parameter": names, "motion": motions},
            )

        return self.store.get(f"slopes.{entry.id}", mark, solve)

    def by_logs(self, function: Callable[[Podium, Value], Value]) -> Traced:
        """Turn a function of podium and factor on the motion into one of the logarithms of all factors."""
        return lambda logs: function(self.varied(logs), jnp.exp(logs[-1]))

    def varied(self, logs: Any) -> Podium:
        """Return the structure with its inputs multiplied by factors, to first order in their logarithms,
        `logs`, (n + 1,). The last one, of the factor on the motion, has no effect."""
        leaves, structure = jax.tree.flatten(self.problem.podium)
        changed = [
            jnp.asarray(y, float) + J @ logs[:-1] for y, J in zip(leaves, self._leaves_by_input, strict=True)
        ]
        return jax.tree.unflatten(structure, changed)

    @functools.cached_property
    def _leaves_by_input(self) -> list[Any]:
        """Derivatives of the leaves of the podium with respect to ln y of each input, along the last axis."""
        problem = self.problem

        def to_leaves(logs: Any) -> list[Any]:
            factors = dict(zip(problem.variables, jnp.exp(logs), strict=True))
            return [jnp.asarray(y, float) for y in jax.tree.leaves(problem.varied(factors))]

        return jax.jit(jax.jacfwd(to_leaves))(jnp.zeros(len(problem.variables)))

    def answers(self, name: str, motion: int) -> Callable[[Any], dict[str, Any]]:
        """Return the answers of a scene to first order: a function of the logarithms of the factors on the
        inputs and on the motion, with exact values and derivatives at zero.

        All answers of a scene are differentiated together, by one program for all motions of a set.
        """
        import xarray

        from rockjax._responses.simulate import peak_response

        problem, motions = self.problem, self.motion_set(name)
        excitation = motions.excitations[motion].common_form()
        options = problem.options.replace(outputs=tuple(self.needed[name].outputs), throw=False)
        mark = fingerprint(problem.podium, motions.hashes[motion], options, problem.variables)

        def values(logs: Any) -> tuple[dict[str, Any], dict[str, Any]]:
            scaled = excitation.scaled(jnp.exp(logs[-1]))
            peak = peak_response(self.varied(logs), scaled, options=options)
            found = {key: y for key, y in peak.values.items() if y is not None}
            return found, found

        def solve() -> xarray.Dataset:
            self.say(f"derivatives of {motions.names[motion]}")
            slopes, found = jax.jacfwd(values, has_aux=True)(jnp.zeros(len(problem.variables) + 1))
            dims = lambda key, y: tuple(f"{key}_axis{k}" for k in range(y.ndim))
            data = {key: (dims(key, y), np.asarray(y)) for key, y in found.items()}
            more = {
                f"{key}_slope": ((*dims(key, found[key]), "parameter"), np.asarray(y))
                for key, y in slopes.items()
            }
            return xarray.Dataset(data | more)

        data = self.store.get(f"derivatives.{name}.{motion}", mark, solve)

        def near(logs: Any) -> dict[str, Any]:
            names = [str(key) for key in data if not str(key).endswith("_slope")]
            return {key: data[key].values + data[f"{key}_slope"].values @ logs for key in names}

        return near

    # ---------------------------------------------------------------------------------------------- histories
    def history(self, name: str, motion: int) -> xarray.Dataset:
        """Return the history of a motion of a set, as [`rockjax.Response.dataset`][]."""
        from rockjax._responses.response import with_joints
        from rockjax._responses.simulate import simulate

        motions, podium = self.motion_set(name), self.problem.podium
        options = self.problem.options.replace(throw=False)
        mark = fingerprint(podium, motions.hashes[motion], options)

        def solve() -> xarray.Dataset:
            self.say(f"history of {motions.names[motion]}")
            response = simulate(podium, motions.members[motion], options=options)
            data = response.dataset()
            return data if podium.elevation is None else with_joints(data, response)

        return self.store.get(f"history.{name}.{motion}", mark, solve)


def _suffix(factor: float) -> str:
    """Return the end of the name of scenes in the store whose motions have a factor."""
    return "" if factor == 1 else f".times {factor!r}".replace(".", " ")


def _largest_acceleration(excitation: Any) -> float:
    """Return the largest horizontal acceleration of an excitation [m/s²]."""
    horizontal = getattr(excitation, "horizontal", excitation)
    samples = getattr(horizontal, "acceleration", None)
    if samples is not None:
        return float(np.abs(np.asarray(samples)).max()) * float(abs(horizontal.scale))
    start, end = (float(y) for y in horizontal.support)
    return float(np.abs(np.asarray(jax.vmap(horizontal)(jnp.linspace(start, end, 1001)))).max())


def _stacked(podiums: list[Podium]) -> Podium:
    """Return podiums as a batch of shape (n, 1)."""
    split = [_with_row_of_damping(podium.split()) for podium in podiums]
    return jax.tree.map(lambda *y: np.stack([np.asarray(v, float) for v in y])[:, None], *split)


def _with_row_of_damping(podium: Podium) -> Podium:
    """Return a split podium with a damping ratio for each mode: a batch of single ratios would be taken for
    ratios of modes."""
    top = podium.superstructure
    for name in ("damping", "zeta"):
        value = getattr(top, name, None)
        if top is not None and top.has_mode_axis and value is not None and not isinstance(value, tuple):
            count = top.retained if isinstance(top, ShearBuilding) else top.count
            podium = with_fields(podium, {"superstructure": with_fields(top, {name: (value,) * count})})
    return podium


@dataclasses.dataclass
class Silent:
    """Progress that is not shown."""

    def update(self, count: int = 1) -> None:
        """Ignore the number of scenes."""

    def describe(self, text: str) -> None:
        """Ignore the description."""
