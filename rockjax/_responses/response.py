"""Time history of a scene (one podium under one ground motion): the class `Response`, with the motion at any
time, and quantities that follow from the motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from rockjax._checks import as_array, as_float, concrete
from rockjax._engine.flat import Nodes
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import GroundMotion
from rockjax._options import Options
from rockjax._outputs.base import JOINTS, MODES, STORIES
from rockjax._parameters.registry import as_variable
from rockjax._programs.program import nans_allowed
from rockjax._results import RESULTS, State
from rockjax._structures import Podium

from . import history, joint_forces
from .datasets import describe_excitation, describe_options, describe_podium
from .floor import DECK, FloorMotion, floor_weights
from .floor_answers import floor_variables
from .history import Energies
from .joint_forces import JointForces
from .peak import AbstractPeak, own_axis, peak_variables

if TYPE_CHECKING:
    import xarray

HISTORY_SAMPLES = 4001  # number of equally spaced times of a history, from the start to the end of the scene

# Unit and description of each series.
_SERIES = {
    "theta": ("rad", "rotation of the columns θ"),
    "theta_dot": ("rad s-1", "rate of rotation"),
    "u_t": ("m", "displacement of the top mass relative to the ground u_t"),
    "u_t_dot": ("m s-1", "velocity of the top mass relative to the ground"),
    "deformation": ("m", "deformation of the superstructure u_t − u_b"),
    "drift": ("m", "drift of the stories"),
    "floor_acceleration": ("m s-2", "absolute horizontal acceleration of the floors"),
    "ground_acceleration": ("m s-2", "ground acceleration ü_g"),
    "vertical_acceleration": ("m s-2", "vertical ground acceleration v̈_g, upwards"),
    "restoring_moment": ("1", "restoring moment divided by its value at uplift"),
    "mode": ("1", "contact mode: full contact (0), or rocking to one side (1, −1)"),
    "mechanical_energy": ("m2 s-2", "mechanical energy relative to the ground per N m_c"),
    "input_energy": ("m2 s-2", "work of the ground since the start per N m_c"),
    "impact_energy": ("m2 s-2", "energy lost at the impacts since the start per N m_c"),
    "damping_energy": ("m2 s-2", "energy lost in the damper of the superstructure since the start per N m_c"),
    "damper_energy": ("m2 s-2", "energy lost in the dampers of the columns since the start per N m_c"),
}

_IMPACTS = {
    "impact_times": ("s", "times of the impacts"),
    "theta_dot_before": ("rad s-1", "rate of rotation before the impact"),
    "theta_dot_after": ("rad s-1", "rate of rotation after the impact"),
}


class Response(AbstractPeak):
    """Time history of one scene: everything in [`rockjax.Peak`][], and the motion.

    `response(t)` returns the state at any times of the scene, by one step of the integration method from the
    preceding node. Nodes are the ends of the accepted steps. The state is as accurate as the solution. At the
    time of an impact, `response(t)` is the state after the impact, or with `left=True` the state before it.
    Methods that take times return NaN before the start and after the end of the scene. If the columns have
    come to rest for good under a rigid superstructure or none, the history has no end.

    - `impact_times`: times of the impacts [s], ascending; padded with NaN under `jit`
    - `times`: times of the nodes [s]; padded with inf under `jit`
    - `podium`, `excitation`, `options`: structure, ground motion and options of the scene
    - `nodes`: states at the nodes
    - `origin`: name, source, factor and seed of a [`rockjax.Motion`][], as pairs (name, value); empty for
      other excitations

    Equations with a number alone are in docs/model.md, (C11) is in docs/modes.md, (L1) to (L3) are in
    docs/floors.md, and the others are in docs/forces.md or docs/equations.md.
    """

    impact_times: Float[Array, " impacts"]
    podium: Podium
    excitation: AbstractExcitation
    nodes: Nodes
    options: Options
    origin: tuple[tuple[str, str | float], ...] = eqx.field(static=True, default=(), kw_only=True)

    @property
    def times(self) -> Float[Array, " nodes"]:
        return self.nodes.t

    @property
    def span(self) -> tuple[float, float]:
        """Start and end of the part of the scene that plots show [s]. If the columns under a rigid
        superstructure or none come to rest for good before the ground motion ends, this part ends with the
        ground motion. Otherwise it ends with the scene."""
        start, end = float(np.asarray(self.times)[0]), float(self.stats.end_time)
        if not self.podium.vibrates and bool(self.result == RESULTS.settled):
            end = max(end, float(self.excitation.support[1]))
        return start, end if end > start else start + 1 / float(self.podium.p)

    def __call__(self, t: Float[ArrayLike, "*times"], left: bool = False) -> State:
        """Return the state at times t [s]. At an impact this is the state just after it, or with `left` just
        before it."""
        theta, theta_dot, *of_modes = self._values_at(t, "theta", "theta_dot", "u_t", "u_t_dot", left=left)
        return State(theta, theta_dot, *map(self._over_modes, of_modes))

    def deformation(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """Return the deformation of the superstructure u_t − u_b at times t [s], in m; 0 without an elastic
        superstructure. Several modes are along the last axis."""
        return self._over_modes(*self._values_at(t, "deformation"))

    def drift(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times stories"]:
        """Return the drift of each story of a building at times t [s], in m, the lowest first, (C11).

        Raises `ValueError` if the superstructure is not an elastic `ShearBuilding`.
        """
        self._check_stories("drift")
        return self._values_at(t, "drift")[0]

    def floor_acceleration(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times stories"]:
        """Return the absolute horizontal acceleration of each floor at times t [s], in m/s², the lowest
        first.

        Raises `ValueError` if the superstructure is not an elastic `ShearBuilding`.
        """
        self._check_stories("floor_acceleration")
        return self._values_at(t, "floor_acceleration")[0]

    def base_shear(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """Return the shear at the base of the superstructure, Eq. (7), divided by the weight of the
        superstructure [–], at times t [s]."""
        return self._values_at(t, "base_shear")[0]

    def _check_stories(self, name: str) -> None:
        top = self.podium.superstructure
        if top is None or not top.elastic or top.floors is None:
            raise ValueError(f"Response.{name}: the superstructure must be an elastic ShearBuilding")

    def _over_modes(self, values: Array) -> Array:
        """Add an axis of length 1 if the superstructure has an axis of modes but was solved as a single
        oscillator without this axis."""
        top = self.podium.superstructure
        is_missing = top is not None and top.has_mode_axis and not top.resolved().has_mode_axis
        return values[..., None] if is_missing else values

    def energy(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """Return the mechanical energy relative to the ground, divided by the mass N m_c of all columns, Eqs.
        (16)–(19), at times t [s], in m²/s²."""
        return self._values_at(t, "mechanical_energy")[0]

    def mode(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """Return the contact mode σ at times t [s]: 0 in full contact, ±1 while rocking, with the sign of θ
        [–]."""
        return self._values_at(t, "mode")[0]

    def restoring_moment(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """Return the restoring moment divided by its value at uplift [–], at times t [s].

        In full contact the result is −q/q_up, from −1 to 1, with the uplift demand q and its threshold q_up,
        Eq. (9). While rocking, without restrainers, it is the moment of the vertical forces on the
        foundation, (sin ψ/sin α)[1 + (2γ+2η+½)/(2γ+2η+1) v̈_b/g], with ψ = σα − θ, the mass ratios γ of the
        beam and η of the superstructure, and the vertical acceleration v̈_b of the beam, Eq. (15). A vertical
        ground acceleration v̈_g adds v̈_g/g in the brackets. Restrainers add their moment, (C22). Without
        restrainers and vertical accelerations, the result is about σ − θ/α.
        """
        return self._values_at(t, "restoring_moment")[0]

    def damper_energy(self, t: Float[ArrayLike, "*times"] | None = None) -> Float[Array, "*times"]:
        """Return the energy that the dampers of the columns, [`rockjax.Damper`][], have dissipated up to
        times t [s], divided by the mass N m_c of all columns: ∫(C/m_c)|ℓ̇|^(1+ν) dt, in m²/s². Each of the N
        columns has a damper with the force C|ℓ̇|^ν at the rate ℓ̇ of elongation, so N cancels. By default t is
        the end of the scene."""
        return self.energies(self.stats.end_time if t is None else t).dampers

    def floor(
        self, level: str | int = DECK, *, weights: Float[ArrayLike, " modes"] | None = None
    ) -> FloorMotion:
        """Return the motion of the deck, of a story, or of a weighted sum of modes, (L1) to (L3).

        - `level`: `"deck"` (the beam), or the number of a story, from 1, the lowest; `Elastic` and `Rigid`
          have one story
        - `weights`: instead of a level, weights W_i of the modes, shape (modes,) [–]; the deck has the weight
          1 − ΣW_i

        Raises `ValueError` if the structure does not have the level, or if `weights` does not have one value
        for each mode.
        """
        row = floor_weights("Response.floor", self.podium, level, weights)
        podium, excitation, nodes, limit, method, rtol = self._scene()
        return FloorMotion(
            weights=as_array(row),
            impulse_times=self.impact_times,
            podium=podium,
            excitation=excitation,
            nodes=nodes,
            end_time=self.stats.end_time,
            _limit=limit,
            _rtol=rtol,
            _method=method,
            level=level if weights is None else "weights",
        )

    def joint_forces(self, t: Float[ArrayLike, "*times"], left: bool = False) -> JointForces:
        """Return the forces in the joints of all columns, divided by the weight m_c g of a column, at times t
        [s], (F3) to (F11). At the time of an impact, these are the forces after the impact, or with
        `left=True` before it.

        If the podium has no elevation, the only column is the mean column. Forces follow from the motion and
        do not affect it. The forces are valid until a joint is in tension or would slide for the first time.
        """
        series = self._joint_series(t, left)
        return JointForces(series["joint_shear"], series["joint_axial_force"])

    def friction(
        self, t: Float[ArrayLike, "*times"], left: bool = False
    ) -> Float[Array, "*times columns joints"]:
        """Return the friction demand |T|/N of all joints [–] at times t [s]; inf where a joint is in
        tension, 0 where it carries no force. `left` as for `joint_forces`."""
        return self._joint_series(t, left)["joint_friction"]

    def eccentricity(self, t: Float[ArrayLike, "*times"], left: bool = False) -> Float[Array, "*times"]:
        """Return the position of the resultants at all joints relative to the centre line of a column,
        divided by half the width of the column [–], at times t [s]: ξ of (F10) in full contact, and σ while
        rocking. For |ξ| ≤ ⅓ the whole width is compressed. `left` as for `joint_forces`."""
        return self._joint_series(t, left)["joint_eccentricity"]

    def foundation_shear(self, t: Float[ArrayLike, "*times"], left: bool = False) -> Float[Array, "*times"]:
        """Return the horizontal force V on the foundation divided by the total weight W_0 [–], at times t
        [s], (F5). `left` as for `joint_forces`."""
        return self._joint_series(t, left)["foundation_shear"]

    def foundation_reaction(
        self, t: Float[ArrayLike, "*times"], left: bool = False
    ) -> Float[Array, "*times"]:
        """Return the vertical force W on the foundation divided by the total weight W_0 [–], at times t [s],
        (F5). `left` as for `joint_forces`."""
        return self._joint_series(t, left)["foundation_reaction"]

    def overturning_moment(self, t: Float[ArrayLike, "*times"], left: bool = False) -> Float[Array, "*times"]:
        """Return the overturning moment on the columns, clockwise, divided by the weight N m_c g of all
        columns, at times t [s], in m, (F6). `left` as for `joint_forces`.

        Raises `ValueError` if the podium has no elevation.
        """
        if self.podium.elevation is None:
            raise ValueError("Response.overturning_moment: the podium needs an elevation, Elevation(...)")
        return self._joint_series(t, left)["overturning_moment"]

    @property
    def impulses(self) -> Float[Array, "impacts columns joints 2"]:
        """Impulses in the joints at the impacts, divided by the mass m_c of a column [m/s], (F12) to (F14).
        The axes are impacts, columns, joints (bottom, top), and (J_T, J_N), the horizontal and the axial
        impulse. Under `jit`, entries after the last impact are NaN."""
        times = self.impact_times
        padded_times, _ = history.pad_times(times, np.zeros(times.size, bool))
        impulses = joint_forces.impulses_at(self._scene(with_elevation=True), padded_times)
        with nans_allowed():
            return _truncate(impulses, times.size)

    def _joint_series(self, t: Float[ArrayLike, "*times"], left: bool) -> dict[str, Array]:
        """Return the quantities of `joint_forces.SERIES` at times t, by name."""
        t = as_float(t)
        times, flags = history.pad_times(t.ravel(), np.full(t.size, left))
        series = joint_forces.series_at(self._scene(with_elevation=True), times, flags)
        with nans_allowed():
            return {name: _truncate(y, t.size).reshape(*t.shape, *y.shape[1:]) for name, y in series.items()}

    def energies(self, t: Float[ArrayLike, "*times"]) -> Energies:
        """Return the balance of energy at times t [s], an [`rockjax.Energies`][]. Dissipated energies and the
        work of the ground are integrals over all steps up to t."""
        t = as_float(t)
        _, energies = self._history(t.ravel(), np.zeros(t.size, bool))
        with nans_allowed():
            return jax.tree.map(lambda y: y.reshape(t.shape) if y.ndim else y, energies)

    def dataset(self, t: Float[ArrayLike, " times"] | None = None) -> xarray.Dataset:
        """Return the history as a dataset, at times t [s], shape (n,); by default at `HISTORY_SAMPLES` times
        from start to end of `span`.

        Variables with the dim `time` are the states, the deformation, the ground acceleration, the contact
        mode, the restoring moment and the energies. An elastic building also has drifts and floor
        accelerations, and a scene with an output of the joints also has joint forces. Variables with the dim
        `impact` are the times of the impacts, and the rates of rotation before and after them. Answers of
        [`rockjax.Peak`][] are included and have neither dim. Every variable has `units` and `long_name`; the
        attributes contain parameters, options and versions. Raises `ValueError` for times that are not
        1-D.
        """
        if t is None:
            t = np.linspace(*self.span, HISTORY_SAMPLES)
        t = np.asarray(t, float)
        if t.ndim != 1:
            raise ValueError(f"Response.dataset: t must be a 1-D array of times, got shape {t.shape}")
        impact_times = np.asarray(self.impact_times)
        impact_times = impact_times[np.isfinite(impact_times)]
        # One call computes the motion at times t and just before the impacts.
        times, left = np.append(t, impact_times), np.arange(t.size + impact_times.size) >= t.size
        samples, energies = self._history(times, left)
        before = np.asarray(samples["theta_dot"])[t.size :]
        after = np.asarray(self.nodes.v[0])[np.isfinite(self.nodes.impact_time)]
        samples, energies = jax.tree.map(
            lambda y: np.asarray(y)[: t.size] if y.ndim else np.asarray(y), (samples, energies)
        )
        impacts = {"impact_times": impact_times, "theta_dot_before": before, "theta_dot_after": after}
        return _dataset(self, t, samples, energies, impacts)

    def _values_at(self, t: Float[ArrayLike, "*times"], *names: str, left: bool = False) -> list[Array]:
        """Return the named quantities at times t; an axis of modes or stories is the last axis."""
        t = as_float(t)
        times, flags = history.pad_times(t.ravel(), np.full(t.size, left))
        quantities = history.quantities_at(self._scene(), times, flags)
        with nans_allowed():
            values = [quantities[name] for name in names]
            return [_truncate(y, t.size).reshape(*t.shape, *y.shape[1:]) for y in values]

    def _history(self, t, left) -> tuple[dict, Energies]:
        """Return all quantities and energies at times t (n,), or just before them where `left` (n,)."""
        size = t.size
        times, flags = history.pad_times(t, left)
        samples, *terms, initial = history.balance(self._scene(), times, flags)
        with nans_allowed():
            if not self.podium.restrainers:
                terms.append(0.0 * terms[-1])  # no dampers; NaN outside the scene
            samples, terms = jax.tree.map(lambda y: _truncate(y, size), (samples, terms))
            samples |= {name: self._over_modes(samples[name]) for name in ("u_t", "u_t_dot", "deformation")}
        return samples, Energies(*terms, initial=initial)

    def _scene(self, with_elevation: bool = False) -> history.Solved:
        """Return the solved scene in the form of `history.Solved`; only joint forces need the elevation."""
        # The segments engine accepts any Diffrax solver. Between the nodes of its history, dopri8 is used.
        method = self.options.method if self.options.engine == "flat" else "dopri8"
        at_rest = (self.result == RESULTS.settled) & (not self.podium.vibrates)
        end = jnp.where(at_rest, jnp.inf, self.stats.end_time)
        rtol = self.options.rtol if self.podium.restrainers else None
        podium = self.podium.split_rows()
        podium = podium if with_elevation else podium.without_elevation()
        return podium, self.excitation.common_form(), history.pad_nodes(self.nodes), end, method, rtol


def _truncate(values: Array, count: int) -> Array:
    """Return the first `count` entries of an array. NumPy is used for concrete arrays, because JAX would
    compile a program for every count."""
    host_values = concrete(values)
    return values[:count] if host_values is None else as_array(host_values[:count])


def _ground_acceleration(excitation: AbstractExcitation, t: np.ndarray) -> np.ndarray:
    """Return the ground acceleration at times t (n,) [m/s²]."""
    times, _ = history.pad_times(t, np.zeros(t.size, bool))
    return np.asarray(history.ground_acceleration(excitation.common_form(), times))[: t.size]


def _dataset(
    response: Response,
    t: np.ndarray,
    samples: Mapping[str, Any],
    energies: Energies,
    impacts: Mapping[str, Any],
) -> xarray.Dataset:
    """Return the dataset of `Response.dataset`, from quantities (`samples`) and energies at times t."""
    import xarray

    values = dict(samples) | {
        "ground_acceleration": _ground_acceleration(response.excitation, t),
        "mechanical_energy": energies.mechanical,
        "input_energy": energies.input,
        "impact_energy": energies.impacts,
        "damping_energy": energies.damping,
        "damper_energy": energies.dampers,
    }
    if not response.podium.restrainers:
        del values["damper_energy"]
    if isinstance(response.excitation, GroundMotion):
        values["vertical_acceleration"] = _ground_acceleration(response.excitation.vertical, t)
    data = xarray.Dataset(
        {
            name: as_variable(
                _dims(name, np.ndim(values[name])), np.asarray(values[name]), *unit_and_description
            )
            for name, unit_and_description in _SERIES.items()
            if name in values
        },
        coords={"time": as_variable("time", t, "s", "time")},
    )
    data["mode"].attrs |= {
        "flag_values": [-1.0, 0.0, 1.0],
        "flag_meanings": "rocking_left full_contact rocking_right",
    }
    for name, (unit, description) in _IMPACTS.items():
        data[name] = as_variable("impact", np.asarray(impacts[name]), unit, description)
    if response.options.of_joints:
        data = with_joints(data, response)
    initial, long_name = np.asarray(energies.initial), "mechanical energy at the start per N m_c"
    data["initial_energy"] = as_variable((), initial, "m2 s-2", long_name)
    for name, scalar, attrs in peak_variables(response, response.options.outputs):
        data[name] = (own_axis(name, scalar.ndim), scalar, attrs)
    data = data.assign(floor_variables(response.on_floors, ()))
    for axis in {MODES, STORIES} & set(map(str, data.dims)):
        data.coords[axis] = np.arange(1, data.sizes[axis] + 1)
    data.attrs = {"title": "Response history", "kind": "response", **describe_excitation(response.excitation)}
    data.attrs |= dict(response.origin)
    data.attrs |= describe_podium(response.podium) | describe_options(response.options)
    return data


def with_joints(data: xarray.Dataset, response: Response) -> xarray.Dataset:
    """Add joint forces and the friction demand at impacts to the dataset of a response."""
    series = response._joint_series(data["time"].values, False)
    for name, (unit, description) in joint_forces.SERIES.items():
        if name in series:
            dims = joint_forces.series_dims(series[name].ndim)
            data[name] = as_variable(dims, np.asarray(series[name]), unit, description)
    horizontal, axial = np.moveaxis(np.asarray(response.impulses)[: data.sizes["impact"]], -1, 0)
    # Outside jit every operation compiles separately.
    demand = np.asarray(jax.jit(lambda *forces: JointForces(*forces).friction)(horizontal, axial))
    dims = ("impact", joint_forces.COLUMNS, JOINTS)
    long_name = "friction demand |J_T|/J_N at the impact, inf where the joint is in tension"
    data["impact_friction"] = as_variable(dims, demand, "1", long_name)
    return data.assign_coords(joint_forces.coordinates(demand.shape[1]))


def _dims(name: str, dimensions: int) -> tuple[str, ...]:
    """Return the dims of a series: time, and also modes or stories if the series has two dimensions."""
    if dimensions == 1:
        return ("time",)
    return "time", STORIES if name in ("drift", "floor_acceleration") else MODES
