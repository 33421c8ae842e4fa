"""Options of simulations."""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING, Any, Literal

import equinox as eqx
import jax

from rockjax._tree import Module

from ._checks import as_strings, require
from ._engine.methods import EXPLICIT, solver_of
from ._outputs.base import AbstractOutput
from ._outputs.registry import REGISTRY, VARIABLES, name_if_registered
from ._structures import Podium
from ._text.representations import format_html

if TYPE_CHECKING:
    import diffrax

OUTPUTS = tuple(REGISTRY)
DEFAULT_OUTPUTS = tuple(name for name, output in REGISTRY.items() if output.by_default)
LEAST_ATOL = 1e-17  # smallest accepted `atol`
HISTORY = 4096  # default of `Options.history`
# Further names of answers and attributes of scenes, which no user-defined output may have.
RESERVED = (
    "exceeded_alpha", "overturned", "overturn_time", "uplifted", "uplift_time", "end_time", "impacts",
    "smallest_impact_speed", "values", "sensitivities", "on_floors", "errors", "undecided", "result", "stats",
    "steps", "user_outputs", "joints_closed", "energetic", "last_energetic", "fall", "fall_time",
    "edge_distance", "has_elevation",
)  # fmt: skip


def _check_names(outputs: list[AbstractOutput]) -> None:
    """Raise `ValueError` if a name of a user-defined output or of one of its answers is not an identifier, or
    is in use."""
    owners: dict[str, AbstractOutput] = {}
    for output in outputs:
        for name in (output.name, *(variable.name for variable in output.variables)):
            if name in (*OUTPUTS, *VARIABLES, *RESERVED) or not name.isidentifier():
                raise ValueError(
                    "Options: the name of a user-defined output and of each of its answers must be a Python "
                    f"identifier, and not the name of a built-in output or answer, got {name!r}"
                )
            if owners.setdefault(name, output) != output:
                raise ValueError(
                    "Options: the names of user-defined outputs and of their answers must differ, got "
                    f"{name!r} from {type(owners[name]).__name__} and {type(output).__name__}; rename one"
                )


def _follows_steps(output: AbstractOutput) -> bool:
    """Return whether a user-defined output overrides methods that the segments engine does not call."""
    methods = "over_step", "at_impact", "update"
    overrides = any(getattr(type(output), y) is not getattr(AbstractOutput, y) for y in methods)
    return overrides and output.name not in REGISTRY


def _normalise_outputs(outputs) -> tuple[str | AbstractOutput, ...]:
    """Return the requested outputs. Outputs of the registry become names; user-defined outputs are kept."""
    requested: tuple[Any, ...] = as_strings("Options", "outputs", outputs)
    return tuple(name_if_registered(y) if isinstance(y, AbstractOutput) else y for y in requested)


class Options(Module):
    """Accuracy, method and scope of a simulation.

    - `rtol`, `atol`: relative and absolute tolerance of the step-size control [–]. `atol` is in natural
      units: α for the rotation θ, pα for θ̇, u = min(2R sin α, g tan α/ω_s²) for the displacement u_t of the
      superstructure, and u·max(p, ω_s) for u̇_t, with α, R, p and g of [`rockjax.Podium`][] and the circular
      frequency ω_s of the superstructure
    - `method`: `"dopri8"` (usually the fastest), `"tsit5"`, `"dopri5"`, `"bosh3"`, or a Diffrax solver.
      The flat engine accepts explicit Runge–Kutta methods with an error estimate. The segments engine accepts
      all Diffrax solvers, and also the name `"kvaerno5"`. For `"dopri8"`, the flat engine uses the Nyström
      method RKN8(6)9FM of the same order if accelerations do not depend on velocities. This is the case for a
      podium with a rigid superstructure or none and without restrainers (tendons, dampers and inerters)
    - `engine`: `"flat"`, one loop over the trial steps of a scene; or, for cross-checks, `"segments"`, one
      `diffrax.diffeqsolve` from each event to the next
    - `overturn_ratio`: |θ|/α at which a scene counts as overturned [–]. The angle `overturn_ratio`·α must not
      exceed π/2. With the output `"margin"` it must not exceed [`rockjax.Podium.stability_angle`][]
    - `rest_velocity`: an impact that leaves |θ̇| ≤ `rest_velocity`·pα brings the columns to rest [–];
      by default equal to `rtol`
    - `max_steps`: limit of the number of trial steps of a scene, accepted and rejected together
    - `outputs`: requested outputs: `"peak_rotation"`, `"peak_deformation"`, `"peak_shear"`, `"impacts"`,
      `"impacts_before_peak"`, `"margin"`, `"errors"`; for buildings also `"peak_drift"` and
      `"peak_floor_acceleration"`; for the deck `"peak_deck_acceleration"` and `"peak_velocity_jump"`; and for
      the joints `"peak_friction"`, `"axial_force"`, `"peak_foundation_shear"` and `"impact_friction"`. The
      scene ends as soon as it is certain that none of the requested outputs can change. Outputs that are not
      requested are NaN or None. Unless `"impacts"` is requested, the number of impacts may be NaN or inexact,
      see [`rockjax.Peak`][]. `"errors"` estimates the errors of the peaks by a second solution. Instances of
      subclasses of [`rockjax.AbstractOutput`][] are user-defined outputs
    - `history`: number of steps that a history can hold under `jit`; outside jit the history grows
      automatically
    - `throw`: True to raise an error if a scene does not finish, for example with the result `out_of_steps`
      or `not_finite`. If JAX traces a value, no error is raised

    Raises `ValueError` for values out of range, such as tolerances below rounding or above 0.1; for unknown
    methods, engines or outputs; and for engines, methods and outputs that cannot be combined.
    """

    rtol: float = 1e-8
    atol: float = 1e-10
    method: str | diffrax.AbstractSolver = eqx.field(static=True, default="dopri8")
    engine: Literal["flat", "segments"] = eqx.field(static=True, default="flat")
    overturn_ratio: float = 1.0
    rest_velocity: float | None = None
    max_steps: int = eqx.field(static=True, default=1_000_000)
    outputs: tuple[str | AbstractOutput, ...] = eqx.field(
        static=True, default=DEFAULT_OUTPUTS, converter=_normalise_outputs
    )
    history: int = eqx.field(static=True, default=HISTORY)
    throw: bool = eqx.field(static=True, default=True)
    # Factor on the longest step. A factor below 1 marks the second solution, which estimates errors. In that
    # solution, `_engine/scene.py` also uses other tolerances for landing on events and another rest velocity.
    _stride: float = 1.0

    def __check_init__(self):
        require("Options", "rtol", self.rtol, lambda v: (v >= 1e-14) & (v <= 0.1), "in [1e-14, 0.1]")
        require("Options", "atol", self.atol, lambda v: (v >= LEAST_ATOL) & (v <= 0.1), "in [1e-17, 0.1]")
        require("Options", "overturn_ratio", self.overturn_ratio, lambda v: v > 0, "finite and > 0")
        if self.rest_velocity is not None:
            require(
                "Options", "rest_velocity", self.rest_velocity, lambda v: v > 0, "finite and > 0, or None"
            )
        for name in ("max_steps", "history"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 1:
                raise ValueError(f"Options: {name} must be a whole number ≥ 1, got {name} = {value!r}")
        if self.engine not in ("flat", "segments"):
            raise ValueError(f"Options: engine must be 'flat' or 'segments', got {self.engine!r}")
        user_outputs = [y for y in self.outputs if isinstance(y, AbstractOutput)]
        unknown = [y for y in self.outputs if y not in user_outputs and y not in OUTPUTS]
        if unknown or not self.outputs:
            raise ValueError(
                f"Options: outputs must be one or more of {OUTPUTS}, or instances of a subclass of "
                f"rockjax.AbstractOutput, got {self.outputs!r}"
            )
        _check_names(user_outputs)
        for output in self.requested:
            if (output.needs_flat or _follows_steps(output)) and self.engine != "flat":
                raise ValueError(
                    f"Options: the output {output.name!r} needs engine='flat', got {self.engine!r}"
                )
        if "errors" in self.outputs and "peak_rotation" not in self.outputs:
            raise ValueError(
                "Options: the output 'errors' needs the output 'peak_rotation'; add it to outputs"
            )
        if not isinstance(self.method, str) or self.method not in EXPLICIT:
            self._check_solver()

    def _check_solver(self) -> None:
        import diffrax

        solver = self.solver  # raises for an unknown name
        if self.engine == "flat" and not isinstance(solver, diffrax.AbstractERK):
            raise ValueError(
                f"Options: the flat engine needs an explicit Runge–Kutta method with an error estimate, got "
                f"{type(solver).__name__}; use engine='segments' for it"
            )

    def _repr_html_(self):
        from ._problem.models import Options as OptionsModel

        return format_html(
            self, {name: field.description or "" for name, field in OptionsModel.model_fields.items()}
        )

    @property
    def requested(self) -> tuple[AbstractOutput, ...]:
        """The requested outputs."""
        return tuple(y if isinstance(y, AbstractOutput) else REGISTRY[y] for y in self.outputs)

    @property
    def of_joints(self) -> bool:
        """True if forces in the joints are requested."""
        return any(output.of_joints for output in self.requested)

    @property
    def solver(self) -> diffrax.AbstractSolver:
        """Diffrax solver of `method`."""
        return solver_of(self.method)

    def replace(self, **changes) -> Options:
        """Return the options with some fields changed."""
        return dataclasses.replace(self, **changes)


def canonical_options(podium: Podium, options: Options) -> Options:
    """Return the canonical form of options. Requests with the same canonical form share a compiled program.

    In the canonical form, `history` and `throw` have their defaults, and `rest_velocity` is a number. Outputs
    are in the order of the registry, user-defined outputs last. Outputs that do not apply to the podium are
    removed, unless none would remain.
    """
    if options.rest_velocity is None:
        options = options.replace(rest_velocity=options.rtol)
    parameters, treedef = jax.tree.flatten(options)
    applicable = frozenset(name for name, output in REGISTRY.items() if output.applies(podium))
    return jax.tree.unflatten(_canonical_treedef(treedef, applicable), parameters)


@functools.lru_cache(maxsize=256)
def _canonical_treedef(treedef, applicable: frozenset[str]):
    """Return the tree structure of the canonical options."""
    # Any valid number can stand for the parameters, because only the structure is returned.
    options = jax.tree.unflatten(treedef, [1e-3] * treedef.num_leaves)
    user_outputs = tuple(y for y in options.outputs if not isinstance(y, str))
    select = lambda names: tuple(name for name in REGISTRY if name in names and name in applicable)
    outputs = select(options.outputs) or (() if user_outputs else options.outputs)
    if outputs == select(DEFAULT_OUTPUTS):
        outputs = DEFAULT_OUTPUTS
    return jax.tree.structure(options.replace(outputs=(*outputs, *user_outputs), history=HISTORY, throw=True))
