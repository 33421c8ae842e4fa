"""The base classes of outputs: names, units, and the methods that update an accumulator (the value up to the
present time) during a scene."""

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

# Axes of answers. Stories are numbered from 1 at the bottom, modes from 1; joints have names.
MODES, STORIES, JOINTS = "vibration_mode", "story", "joint"
JOINT_NAMES = ("bottom", "top")


class Variable(NamedTuple):
    """One answer of an output, for datasets, pictures and tables.

    - `name`, `unit`, `description`, `symbol`: texts for datasets and for the axes of pictures
    - `axis`: None for a scalar, or the name of the answer's axis: `"vibration_mode"`, `"story"` or `"joint"`
    - `sensitive`: whether batches can compute the sensitivities of the answer
    - `estimated`: whether the output `"errors"` estimates the error of the answer
    - `until_overturning`: whether the answer of a scene that overturns covers only the time until then
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
    """Return the worst value over the modes, stories or joints of an answer, (n,): the least value if the
    name of the answer starts with "least", else the largest.

    - `name`: name of the answer
    - `values`: answers of n scenes, (n,), or (n, m) with m modes, stories or joints
    """
    if values.ndim == 1:
        return values
    return values.min(axis=-1) if name.startswith("least") else values.max(axis=-1)


@dataclasses.dataclass(frozen=True)
class AbstractOutput:
    """An output of a scene. Subclass it, set the class attributes, and define `quantity`:

        class PeakBeamSpeed(rockjax.AbstractOutput):
            name, unit, description = "peak_beam_speed", "m s-1", "peak speed of the beam"

            def quantity(self, moment):
                psi = moment.sigma * moment.c.alpha - moment.x[0]
                return moment.c.two_R * moment.v[0] * jnp.cos(psi)

    and pass it in `Options(outputs=("peak_rotation", PeakBeamSpeed()))`. In this example, the quantity is the
    horizontal velocity 2R θ̇ cos ψ of the beam relative to the ground, with ψ = σα − θ. The answer is the
    largest absolute value of the quantity in the scene, and can be differentiated. Override `over_step`,
    `at_impact`, `update` or `answer` for other forms of answers. Override further methods to save time. A
    scene ends early if `is_final` returns True for every output. Parts of a scene can be skipped only if
    every output overrides the method for them: `over_rest` for rests (full contact of a rigid podium),
    `over_sample` for samples of the ground motion, `over_bounces` for bounces.

    - `name`: name in `Options.outputs` and of the answer
    - `unit`, `description`, `symbol`, `axis`, `sensitive`, `estimated`, `until_overturning`: properties of
      the answer, as in [`rockjax.Variable`][]; an output with several answers lists them in `variables`
    - `by_default`: whether the output is requested by default
    - `needs_flat`: whether the output requires `Options(engine="flat")`, the default
    - `follows_impacts`: whether the output needs every impact, however slow
    - `of_joints`: whether the output needs the constants of the joints, `moment.c.joints`
    - `needs_simple_contact`: whether no part of a scene may be skipped if there are restrainers or vertical
      ground motion
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
        """Return this output for a podium, with those attributes set that depend on the structure."""
        del podium
        return self

    def for_limit(self, limit: float) -> tuple[AbstractOutput, float]:
        """Return the output that a design target with this limit uses instead of this output, and the limit
        of that output. Override this method for answers that can be infinite."""
        return self, limit

    # ------------------------------------------------------------------------------------- following a scene
    def quantity(self, moment: Moment) -> Values:
        """Return the quantity at a moment: a scalar, or an array of shape (k,)."""
        raise NotImplementedError(f"{type(self).__name__}: define the method `quantity`")

    def start(self, start: Start) -> tuple[Any, Any]:
        """Return the accumulator (the value up to the present time) and the note (further data, such as the
        time of a peak) at the start of a scene; either may be None. Batches compute derivatives of
        accumulators, not of notes."""
        shape = jax.eval_shape(lambda: self.quantity(start.moment()))
        return jnp.zeros(shape.shape, shape.dtype), None

    def over_step(self, step: Step, accumulator: Any) -> Maximum | None:
        """Return the maximum of the quantity over a step, or None if the accumulator depends only on the
        ends of steps."""
        return step.largest(step.course(self.quantity), accumulator)

    def at_impact(self, impact: Impact) -> Any:
        """Return the value at an impact of a quantity that exists only at impacts; None for other
        quantities."""
        del impact
        return None

    def update(self, end: StepEnd, accumulator: Any, note: Any, largest: Any) -> tuple[Any, Any]:
        """Return the accumulator and the note after an accepted step. `largest` is the value of the maximum
        that `over_step` returned, or None if `over_step` returned None."""
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


class AbstractEventOutput(AbstractOutput):
    """An output whose accumulator changes only at turning points of the rotation and at events. The
    accumulator stays the same in full contact of a rigid podium, and in a sampling interval with monotone
    rotation."""

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
