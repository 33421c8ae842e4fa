"""The base classes of outputs.

An output computes one or more answers of a scene (one podium under one excitation), such as the peak
rotation. The accumulator of an output holds the value up to the present time. Methods of the output update
the accumulator after each step, and in parts of the scene that are skipped without steps. A rigid podium is a
podium with a rigid superstructure or none.
"""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._engine.bounds import Bounds
from rockjax._outputs.maxima import Maximum, larger
from rockjax._structures import Podium
from rockjax._types import Flag, Values

from .views import Bounces, Ended, Impact, Moment, Rest, Sample, Start, Step, StepEnd

# Names of the axes of answers. Stories and modes are numbered from 1, stories from the bottom. Joints have
# names.
MODES, STORIES, JOINTS = "vibration_mode", "story", "joint"
JOINT_NAMES = ("bottom", "top")


class Variable(NamedTuple):
    """One answer of an output, for datasets, pictures and tables.

    - `name`, `unit`, `description`, `symbol`: texts for datasets and for the axes of pictures
    - `axis`: None for a scalar, or the name of the answer's axis: `"vibration_mode"`, `"story"` or `"joint"`
    - `sensitive`: whether batches can compute the sensitivities of the answer (its derivatives with respect
      to parameters)
    - `estimated`: whether the error of the answer is estimated if the output `"errors"` is requested
    - `until_overturning`: whether the answer of a scene that overturns covers only the time before
      overturning
    """

    name: str
    unit: str
    description: str
    symbol: str = ""
    axis: str | None = None
    sensitive: bool = True
    estimated: bool = True
    until_overturning: bool = True


def worst_component(name: str, values: np.ndarray) -> np.ndarray:
    """Return the worst value over the modes, stories or joints of an answer, shape (n,). The worst value is
    the least one if the name of the answer starts with "least", else the largest one.

    - `name`: name of the answer
    - `values`: answers of n scenes, (n,), or (n, m) with m modes, stories or joints
    """
    if values.ndim == 1:
        return values
    return values.min(axis=-1) if name.startswith("least") else values.max(axis=-1)


@dataclasses.dataclass(frozen=True, eq=False)
class AbstractOutput:
    """An output of a scene. To define an output, subclass this class, set the class attributes, and define
    the method `quantity`:

        class PeakBeamSpeed(rockjax.AbstractOutput):
            name, unit, description = "peak_beam_speed", "m s-1", "peak speed of the beam"

            def quantity(self, moment):
                psi = moment.sigma * moment.c.alpha - moment.x[0]
                return moment.c.two_R * moment.v[0] * jnp.cos(psi)

    Request the output with `Options(outputs=("peak_rotation", PeakBeamSpeed()))`. In this example, the
    quantity is the horizontal velocity 2R θ̇ cos ψ of the beam relative to the ground, with ψ = σα − θ. The
    answer is the largest absolute value of the quantity in the scene. It can be differentiated. For other
    forms of answers, override `over_step`, `at_impact`, `update` or `answer`.

    Outputs of one class are equal if their attributes are equal; equal outputs share compiled programs. An
    output with an attribute that has no hash, such as an array, equals only itself.

    Further methods save time:

    - `is_final`: a scene may end early only if this method returns True for every output; by default it
      returns False
    - `over_rest`, `over_sample`, `over_bounces`: rests (full contact of a rigid podium), sampling intervals
      of a record, and bounces after an impact at low speed are skipped only if every output overrides the
      method for them

    Class attributes:

    - `name`: name in `Options.outputs` and of the answer
    - `unit`, `description`, `symbol`, `axis`, `sensitive`, `estimated`, `until_overturning`: properties of
      the answer, as in [`rockjax.Variable`][]; an output with several answers overrides `variables` instead
    - `by_default`: whether the output is requested by default
    - `needs_flat`: whether the output requires `Options(engine="flat")`, the default. Outputs that override
      `over_step`, `at_impact` or `update` always require it
    - `follows_impacts`: whether the output needs every impact, however slow
    - `of_joints`: whether the output needs the constants of the joints, `moment.c.joints`
    - `needs_simple_contact`: whether `over_rest`, `over_sample` and `over_bounces` are valid only without
      restrainers and without vertical ground motion; if True, no part of other scenes is skipped
    """

    name: ClassVar[str]
    unit: ClassVar[str] = "1"
    description: ClassVar[str] = ""
    symbol: ClassVar[str] = ""
    axis: ClassVar[str | None] = None
    by_default: ClassVar[bool] = False
    needs_flat: ClassVar[bool] = False
    sensitive: ClassVar[bool] = True
    estimated: ClassVar[bool] = True
    until_overturning: ClassVar[bool] = True
    follows_impacts: ClassVar[bool] = False
    of_joints: ClassVar[bool] = False
    needs_simple_contact: ClassVar[bool] = False

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        if not isinstance(other, AbstractOutput) or type(self) is not type(other):
            return False
        return _identity(self) == _identity(other)

    def __hash__(self) -> int:
        return hash((type(self), _identity(self)))

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The answers."""
        fields = "unit", "description", "symbol", "axis", "sensitive", "estimated", "until_overturning"
        return (Variable(self.name, *(getattr(self, name) for name in fields)),)

    def applies(self, podium: Podium) -> bool:
        """Return whether this output exists for a podium."""
        del podium
        return True

    def of(self, podium: Podium) -> AbstractOutput:
        """Return this output for a podium. An output with attributes that depend on the podium returns a copy
        in which they are set."""
        del podium
        return self

    def for_limit(self, limit: float) -> tuple[AbstractOutput, float]:
        """Return the output that a design target with this limit uses instead of this output, and the limit
        on that output; by default the same output and limit. Override this method for answers that can be
        infinite."""
        return self, limit

    # ------------------------------------------------------------------------------------- following a scene
    def quantity(self, moment: Moment) -> Values:
        """Return the quantity at a moment: a scalar, or an array of shape (k,) for k values."""
        raise NotImplementedError(f"{type(self).__name__}: define the method `quantity`")

    def start(self, start: Start) -> tuple[Any, Any]:
        """Return the accumulator (the value up to the present time) and the note (further data, such as the
        time of a peak) at the start of a scene. Each may be None. Batches compute derivatives of
        accumulators, but not of notes."""
        shape = jax.eval_shape(lambda: self.quantity(start.moment()))
        return jnp.zeros(shape.shape, shape.dtype), None

    def over_step(self, step: Step, accumulator: Any) -> Maximum | None:
        """Return the maximum of the quantity over a step, or None if the accumulator depends only on the
        ends of steps."""
        return step.largest(step.course(self.quantity), accumulator)

    def at_impact(self, impact: Impact) -> Any:
        """Return the quantity at an impact if it exists only at impacts, else None."""
        del impact
        return None

    def update(self, end: StepEnd, accumulator: Any, note: Any, largest: Any) -> tuple[Any, Any]:
        """Return the accumulator and the note after an accepted step. `largest` is the field `value` of the
        maximum that `over_step` returned, or None if `over_step` returned None."""
        if largest is not None:
            accumulator = jax.tree.map(larger, largest, accumulator)
        value = self.at_impact(end.impact)
        if value is not None:
            raised = lambda new, old: jnp.where(end.hit & (new > old), new, old)
            accumulator = jax.tree.map(raised, value, accumulator)
        return accumulator, note

    def after_rejection(self, accumulator: Any) -> Any:
        """Return the accumulator after a rejected step; by default it stays the same."""
        return accumulator

    def answer(self, ended: Ended, accumulator: Any, note: Any) -> dict[str, Any]:
        """Return the answers by name."""
        del ended, note
        return {self.name: accumulator}

    def absent(self, ended: Ended) -> dict[str, Any]:
        """Return the answers of a scene for which this output was not requested: by default NaN."""
        return {self.name: jnp.full_like(ended.t, jnp.nan)}

    # ---------------------------------------------------------------------------- skipping parts of a scene
    def over_rest(self, rest: Rest, accumulator: Any) -> Any:
        """Return the accumulator after a rest, the time in which a rigid podium stays in full contact."""
        raise NotImplementedError

    def over_sample(self, sample: Sample, accumulator: Any) -> Flag | bool:
        """Return whether the accumulator certainly stays the same in a sampling interval. Otherwise the
        interval is not skipped, but solved by trial steps."""
        raise NotImplementedError

    def over_bounces(self, bounces: Bounces, accumulator: Any) -> Flag | bool:
        """Return whether the accumulator certainly stays the same in bounces. Otherwise the bounces are not
        skipped."""
        raise NotImplementedError

    def is_final(self, bounds: Bounds, accumulator: Any) -> Flag | bool:
        """Return whether no motion within the bounds can change the accumulator."""
        del bounds, accumulator
        return False

    def passes(self, method: str) -> bool:
        """Return whether this class overrides `method`, which is "over_rest", "over_sample" or
        "over_bounces"."""
        return getattr(type(self), method) is not getattr(AbstractOutput, method)


def _identity(output: AbstractOutput) -> Any:
    """Return the attributes of an output, sorted by name; the `id` of the output if one has no hash."""
    attributes = tuple(sorted(vars(output).items(), key=lambda item: item[0]))
    try:
        hash(attributes)
    except TypeError:
        return id(output)
    return attributes


class AbstractEventOutput(AbstractOutput):
    """An output whose accumulator changes only at turning points of the rotation and at events (uplift,
    impact, overturning). The accumulator stays the same in full contact of a rigid podium, and in a sampling
    interval with monotone rotation."""

    def over_rest(self, rest: Rest, accumulator: Any) -> Any:
        del rest
        return accumulator

    def over_sample(self, sample: Sample, accumulator: Any) -> bool:
        del sample, accumulator
        return True


class AbstractInternalOutput(AbstractEventOutput):
    """An output without public answers, and without a maximum over a step."""

    @property
    def variables(self) -> tuple[Variable, ...]:
        return ()

    def start(self, start: Start) -> tuple[Any, Any]:
        del start
        return None, None

    def over_step(self, step: Step, accumulator: Any) -> None:
        del step, accumulator

    def answer(self, ended: Ended, accumulator: Any, note: Any) -> dict[str, Any]:
        del ended, accumulator, note
        return {}

    def absent(self, ended: Ended) -> dict[str, Any]:
        del ended
        return {}
