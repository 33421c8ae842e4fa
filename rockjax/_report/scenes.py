"""The scenes of a report: a scene is the structure under one motion. Answers of scenes are computed when they
are first needed, and then stored."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from rockjax._motions.convert import as_batch
from rockjax._options import Options
from rockjax._outputs.registry import suitable_outputs
from rockjax._responses.arguments import check_overturn_ratio
from rockjax._responses.estimate import second_options
from rockjax._responses.floor_answers import VARIABLES
from rockjax._responses.peak import data_variables
from rockjax._structures import Podium, ShearBuilding
from rockjax._structures.modes import with_fields

from .problem import MotionSet, Problem
from .store import Store, Stored, fingerprint

if TYPE_CHECKING:
    import xarray


class Needs(NamedTuple):
    """Outputs and objects that the checks of a set of motions need.

    - `outputs`: names of the outputs, as the keys of a dict
    - `on_floors`: (dim, name) → block or oscillator on a floor; `dim` is the dimension of such objects in
      datasets
    """

    outputs: dict[str, None] = {}  # an ordered set of names
    on_floors: dict[tuple[str, str], Any] = {}


class Scenes:
    """The scenes of a problem.

    - `problem`: the problem; `store`: stores the solved scenes
    - `needed`: set of motions → outputs and objects on floors that the checks of this set need
    - `progress`: object with the methods `update(number)` and `describe(text)`; None shows nothing
    - `with_spread`: whether scenes with changed inputs (`variations`) are solved too
    """

    def __init__(
        self,
        problem: Problem,
        store: Store,
        needed: Mapping[str, Needs],
        progress: Any = None,
        with_spread: bool = True,
    ):
        self.problem, self.store, self.needed, self.progress = problem, store, needed, progress
        self.with_spread = with_spread
        # Cached, because checks and sections ask for the same structures and scenes many times.
        self.podium, self.peaks = functools.cache(self._podium), functools.cache(self._peaks)
        self._stored_peaks = functools.cache(self._make_stored_peaks)
        self._stored_finer_peaks = functools.cache(self._make_stored_finer_peaks)
        self._stored_variations = functools.cache(self._make_stored_variations)

    def describe(self, text: str) -> None:
        """Show a text about the current computation."""
        if self.progress is not None:
            self.progress.describe(text)

    def update(self, count: int = 1) -> None:
        """Show that `count` more scenes were solved. Raise `Interrupted` if Ctrl-C has ended the report."""
        self.store.raise_if_stopped()
        if self.progress is not None:
            self.progress.update(count)

    @functools.cached_property
    def variations(self) -> tuple[str, ...]:
        """Names of the variations, each of which changes one input; empty unless `with_spread`.

        The variation "width-" multiplies the input `width` by 1 − s, and "width+" by 1 + s. The number s is
        the key `spread` of the table `[report]`. "motion-" and "motion+" multiply all motions by these
        factors. A variation is left out if its structure is invalid, such as one with a factor of
        restitution above 1, or if the option `overturn_ratio` is too large for it.
        """

        def is_valid(variation: str) -> bool:
            try:
                check_overturn_ratio("report", self.podium(None, variation), self.problem.options)
            except ValueError:
                return False
            return True

        names = (*self.problem.variables, "motion") if self.with_spread else ()
        return tuple(filter(is_valid, (f"{name}{sign}" for name in names for sign in "-+")))

    @functools.cached_property
    def laws(self) -> tuple[str, ...]:
        """The laws of impact in the table `[report]` that differ from the law of the structure."""
        own = fingerprint(self.problem.podium)
        return tuple(law for law in self.problem.report.laws if fingerprint(self.podium(law)) != own)

    def factors(self, variation: str) -> dict[str, float]:
        """Return input → factor of a variation, such as {"width": 1.05} for "width+". For "" (no variation),
        return {}."""
        spread = self.problem.report.spread
        return {variation[:-1]: 1 + spread if variation[-1] == "+" else 1 - spread} if variation else {}

    def _podium(self, law: str | None = None, variation: str = "") -> Podium:
        """Return the structure with the law of impact `law` (None for no change), changed by `variation` (""
        for no change)."""
        factors = {name: y for name, y in self.factors(variation).items() if name != "motion"}
        podium = self.problem.varied(factors) if factors else self.problem.podium
        return podium if law is None else podium.replace(restitution=law)

    def motion_set(self, name: str) -> MotionSet:
        """Return a set of motions."""
        return self.problem.motions[name]

    def outputs(self, name: str) -> tuple[str, ...]:
        """Return the outputs of the scenes of a set: the outputs that the page shows and the outputs that the
        checks need."""
        needed = self.needed.get(name, Needs()).outputs
        return tuple(dict.fromkeys((*suitable_outputs(self.problem.podium), *needed)))

    def options(self, name: str) -> Options:
        """Return the options of the scenes of a set."""
        return self.problem.options.replace(outputs=self.outputs(name), throw=False)

    def on_floors(self, name: str) -> dict[tuple[str, str], Any]:
        """Return (dim, name) → block or oscillator on a floor, for all checks of a set."""
        return self.needed.get(name, Needs()).on_floors

    # -------------------------------------------------------------------------------------------------- peaks
    def _peaks(
        self, name: str, law: str | None = None, variation: str = "", factor: float = 1.0
    ) -> xarray.Dataset:
        """Return the peaks of the scenes of a set, along `motion`.

        - `name`: the set; `law`: one of the laws of `[report]`, or None for the law of the structure
        - `variation`: one of `variations`, or ""; `factor`: factor on all motions
        """
        if variation:
            return self.store.get(*self._stored_variations(name, factor)).sel(variant=variation)
        law = law if law in self.laws else None
        data = self.store.get(*self._stored_peaks(name, law, factor))
        if not self.on_floors(name):
            return data
        return _with_floor_errors(data, self.store.get(*self._stored_finer_peaks(name, law, factor)))

    def _make_stored_peaks(self, name: str, law: str | None, factor: float) -> Stored:
        """Return the arguments of `Store.get` for the peaks of a set. The inputs of the structure are
        unchanged; `law` may replace its law of impact."""
        return self._stored_solution("peaks", self.options(name), name, law, factor)

    def _make_stored_finer_peaks(self, name: str, law: str | None, factor: float) -> Stored:
        """Return the arguments of `Store.get` for the second solution of the scenes of a set, which estimates
        the errors of blocks and oscillators on floors. It is a dataset of its own, so that an interruption of
        the second solution keeps the first."""
        options = second_options(self.options(name)).replace(outputs=("peak_rotation",))
        label, inputs_hash, solve = self._stored_solution("finer", options, name, law, factor)
        return label, inputs_hash, lambda: _of_floors(solve())

    def _stored_solution(
        self, label: str, options: Options, name: str, law: str | None, factor: float
    ) -> Stored:
        """Return the arguments of `Store.get` for a solution of the scenes of a set.

        - `label`: first part of the name in the store; `options`: options of the scenes
        - `name`, `law`, `factor`: as for `_peaks`
        """
        motions, on_floors = self.motion_set(name), self.on_floors(name)
        podium = with_given_restitution(self.podium(law))
        inputs_hash = fingerprint(podium, motions.identities, options, on_floors, factor)

        def solve() -> xarray.Dataset:
            self.describe(f"scenes of {name}" + (f" with the law {law}" if law else ""))
            return self.solve(podium, motions.scaled(factor), options, ("motion",), on_floors)

        return f"{label}.{name}{f'.{law}' if law else ''}{_suffix(factor)}", inputs_hash, solve

    def start_variants(self, name: str) -> None:
        """Start to solve the scenes of a set with other laws of impact and with changed inputs, in other
        threads."""
        for law in self.laws:
            self.store.start(*self._stored_peaks(name, law, 1.0))
            if self.on_floors(name):
                self.store.start(*self._stored_finer_peaks(name, law, 1.0))
        if self.variations:
            self.store.start(*self._stored_variations(name, 1.0))

    def _make_stored_variations(self, name: str, factor: float) -> Stored:
        """Return the arguments of `Store.get` for the peaks of a set with changed inputs, along `variant` and
        `motion`. These peaks have no estimated errors."""
        podiums = [with_given_restitution(self.podium(None, variation)) for variation in self.variations]
        factors = [factor * self.factors(variation).get("motion", 1.0) for variation in self.variations]
        needed = self.needed.get(name, Needs()).outputs
        outputs = tuple(dict.fromkeys(("peak_rotation", *needed)))
        motions, on_floors = self.motion_set(name), self.on_floors(name)
        options = self.problem.options.replace(outputs=outputs, throw=False)
        inputs_hash = fingerprint(podiums, factors, motions.identities, options, on_floors)

        def solve() -> xarray.Dataset:
            self.describe(f"scenes of {name} for {len(podiums)} variants of the structure")
            excitations = as_batch("report", motions.excitations).scaled(np.array(factors)[:, None])
            data = self.solve(_stacked(podiums), excitations, options, ("variant", "motion"), on_floors)
            return data.assign_coords(variant=list(self.variations))

        return f"variations.{name}{_suffix(factor)}", inputs_hash, solve

    def solve(
        self,
        podium: Podium,
        excitations: Any,
        options: Options,
        dims: tuple[str, ...],
        on_floors: Mapping[tuple[str, str], Any] = MappingProxyType({}),
    ) -> xarray.Dataset:
        """Return the peaks of a batch as a dataset.

        - `podium`, `excitations`, `options`: structure, motions and options of the batch
        - `dims`: names of the axes of the batch
        - `on_floors`: (dim, name) → block or oscillator; the names become coordinates
        """
        import xarray

        from rockjax._batch.batch import peak_responses

        objects = tuple(on_floors.values())
        peaks = peak_responses(podium, excitations, options=options, progress=self, on_floors=objects)
        data = xarray.Dataset(data_variables(peaks, options.outputs, dims))
        names = {dim: [name for of, name in on_floors if of == dim] for dim, _ in VARIABLES.values()}
        return data.assign_coords({dim: labels for dim, labels in names.items() if labels})

    def peaks_with_factors(self, label: str, name: str, factors: np.ndarray) -> xarray.Dataset:
        """Return the peaks under the motions of a set, each of which is multiplied by its own factor.

        - `label`: name in the store; `name`: the set; `factors`: a factor for each motion
        """
        motions = self.motion_set(name).excitations
        excitations = [y.scaled(f) for y, f in zip(motions, factors, strict=True)]
        return self.peaks_under(label, self.options(name), excitations)

    def peaks_under(self, label: str, options: Options, excitations: Sequence[Any]) -> xarray.Dataset:
        """Return the peaks of the structure under excitations, along `motion`.

        - `label`: name in the store; `options`: options of the scenes
        """
        podium = with_given_restitution(self.problem.podium)
        inputs_hash = fingerprint(podium, excitations, options)

        def solve() -> xarray.Dataset:
            self.describe("scenes at the boundary")
            return self.solve(podium, list(excitations), options, ("motion",))

        return self.store.get(label, inputs_hash, solve)

    # ---------------------------------------------------------------------------------------------- histories
    def history(self, name: str, motion: int) -> xarray.Dataset:
        """Return the response history under one motion of a set, in the form of
        [`rockjax.Response.dataset`][]. Its times include the impacts, just after which forces and
        accelerations often are largest. It contains joint forces unless `Podium.elevation` is None.

        - `name`: the set; `motion`: index of the motion in the set
        """
        return self.store.get(*self.stored_history(name, motion))

    def start_history(self, name: str, motion: int) -> None:
        """Start to compute a `history` in another thread."""
        self.store.start(*self.stored_history(name, motion))

    def stored_history(self, name: str, motion: int) -> Stored:
        """Return the arguments of `Store.get` for a history."""
        from rockjax._responses.response import HISTORY_SAMPLES, with_joints
        from rockjax._responses.simulate import simulate

        motions, podium = self.motion_set(name), self.problem.podium
        options = self.problem.options.replace(throw=False)
        inputs_hash = fingerprint(podium, motions.identities[motion], options)

        def solve() -> xarray.Dataset:
            self.describe(f"history of {motions.names[motion]}")
            response = simulate(podium, motions.members[motion], options=options)
            times = np.union1d(np.linspace(*response.span, HISTORY_SAMPLES), response.impact_times)
            data = response.dataset(times)
            return data if podium.elevation is None else with_joints(data, response)

        return f"history.{name}.{motion}", inputs_hash, solve


_FLOOR_PEAKS = ("contents_peak_rotation", "oscillator_pseudo_acceleration")  # peaks with estimated errors


def _of_floors(data: xarray.Dataset) -> xarray.Dataset:
    """Return the variables of the second solution that estimate the errors of blocks and oscillators."""
    return data[[name for name in (*_FLOOR_PEAKS, "contents_overturned") if name in data]]


def _with_floor_errors(data: xarray.Dataset, other: xarray.Dataset) -> xarray.Dataset:
    """Return peaks with the estimated errors of blocks and oscillators on floors.

    The error is the difference from the second solution `other`. If a block overturns in only one of the two
    solutions, the error of its rotation is inf.
    """
    errors: dict[str, Any] = {}
    for name in _FLOOR_PEAKS:
        if name in data:
            error = np.abs(data[name].values - other[name].values)
            if name.startswith("contents"):
                differs = data["contents_overturned"].values != other["contents_overturned"].values
                error = np.where(differs, np.inf, error)
            errors[f"{name}_error"] = data[name].dims, error
    return data.assign(errors)


def _suffix(factor: float) -> str:
    """Return the ending that states the factor on the motions in the name of a dataset; "" for the factor
    1."""
    # The factor is written without a dot, because dots separate the parts of a name (see `Store.get`).
    return "" if factor == 1 else f".times {factor!r}".replace(".", " ")


def with_given_restitution(podium: Podium) -> Podium:
    """Return a podium with its factor of restitution, at least 0, in place of the law of impact. Podiums with
    different laws then share a compiled program, and can form a batch."""
    return podium.replace(restitution=max(float(podium.restitution_factor), 0.0))


def _stacked(podiums: list[Podium]) -> Podium:
    """Return n podiums as a batch of shape (n, 1)."""
    # `split_rows` turns arrays over modes or stories into tuples of numbers, which can be stacked.
    split = [_with_mode_damping(podium.split_rows()) for podium in podiums]
    return jax.tree.map(lambda *y: np.stack([np.asarray(v, float) for v in y])[:, None], *split)


def _with_mode_damping(podium: Podium) -> Podium:
    """Return a podium from `Podium.split_rows` with a tuple of damping ratios, one for each mode, in place of
    a single ratio. Without the tuple, a batch of n podiums would have n single ratios, which would be taken
    for the ratios of n modes."""
    top = podium.superstructure
    for name in ("damping", "zeta"):
        value = getattr(top, name, None)
        if top is not None and top.has_mode_axis and value is not None and not isinstance(value, tuple):
            count = top.retained if isinstance(top, ShearBuilding) else top.count
            podium = with_fields(podium, {"superstructure": with_fields(top, {name: (value,) * count})})
    return podium


@dataclasses.dataclass
class NoProgress:
    """Progress that is not shown."""

    def update(self, count: int = 1) -> None:
        """Ignore the number of scenes."""

    def describe(self, text: str) -> None:
        """Ignore the description."""
