"""Objectives of a design. An objective has one or more values; the largest is minimised."""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp

import rockjax as rj
from rockjax._outputs.base import AbstractOutput
from rockjax._units import displayed_or_empty
from rockjax.internal import Module, as_float, require_instance

from ._annual import AnnualFrequency
from ._peak_targets import limited_output, output_title, output_values, overturning_depths, with_margin
from ._suite import Suite, Values
from ._targets import AbstractResponses, require_limit, severity


class AbstractObjective(Module):
    """Base class of objectives: the largest entry of `values` is minimised.

    Subclasses implement `values` and `describe`.
    """

    @abc.abstractmethod
    def values(self, podium: rj.Podium, options: rj.Options) -> Values:
        """Return the objective values (k,) of a podium; JAX can trace and differentiate this method.

        - `podium`: the structure; `options`: options of the simulations
        """

    @abc.abstractmethod
    def describe(self) -> str:
        """Return the description of the objective in reports."""

    def while_searching(self) -> Self:
        """Return a cheaper objective for the search, or this objective itself."""
        return self

    @property
    def scenes(self) -> int:
        """Number of scenes (one podium under one motion) of one evaluation; the search for one overturning
        amplitude counts as one."""
        return 0


class AbstractWorst(AbstractObjective, AbstractResponses):
    """Base class of objectives on the largest peak response to a suite of motions."""

    suite: Suite

    def __init__(self, excitations):
        self.suite = Suite.of(excitations, type(self).__name__)

    def values(self, podium: rj.Podium, options: rj.Options) -> Values:
        return self.read(self.suite.responses(podium, options, self.outputs), options)

    @property
    def scenes(self) -> int:
        return len(self.suite)


class WorstRotation(AbstractWorst):
    """The largest peak rotation max|θ|/α under a motion or a list of motions [–].

    Where the columns overturn, the value is `Options.overturn_ratio` − M, where M < 0 is the overturning
    margin. This value increases with the speed of the fall.
    """

    outputs: ClassVar[tuple[str, ...]] = ("peak_rotation", "margin")

    def __init__(self, excitations):
        super().__init__(excitations)

    def read(self, peaks: rj.Peak, options: rj.Options) -> Values:
        return severity(peaks, options)

    def describe(self) -> str:
        return "worst peak rotation / α"


class WorstPeak(AbstractWorst):
    """The largest value of an output, over all motions and all modes, stories, floors or joints.

    - `output`: an output that is a peak: a name in `rockjax.Options.outputs`, such as `"peak_shear"`, or an
      instance of [`rockjax.AbstractOutput`][]
    - `excitations`: a motion or a list of motions

    Where the columns overturn, the peak until overturning underestimates the response. This peak is therefore
    multiplied by (1 − M), where M < 0 is the overturning margin. To exclude such designs, add a target such
    as [`optimise.NoOverturning`][].

    Raises `ValueError` for an output that is not a peak, and for a peak that can be infinite, such as
    `"peak_friction"`. The evaluation raises `ValueError` for a podium that does not have the output.
    """

    output: AbstractOutput = eqx.field(static=True)
    until_overturning: ClassVar[bool] = True

    def __init__(self, output: str | AbstractOutput, excitations):
        super().__init__(excitations)
        self.output = limited_output(type(self).__name__, output)
        # If an output can be infinite, `for_limit` returns another output, which only targets can use.
        if self.output.for_limit(1.0)[0] != self.output:
            raise ValueError(
                f"{type(self).__name__}: {self.output.name} can be infinite, so it cannot be minimised; "
                "limit it by a target instead, such as optimise.PeakFriction"
            )

    @property
    def outputs(self) -> tuple[str | AbstractOutput, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return with_margin(self.output)

    def read(self, peaks: rj.Peak, options: rj.Options) -> Values:
        values = output_values(self, self.output, peaks)
        overturned, depth = overturning_depths(peaks, len(values))
        return jnp.where(overturned, (1 + depth) * values, values)

    def describe(self) -> str:
        unit = displayed_or_empty(self.output.unit)
        return f"worst {output_title(self.output)}" + (f" [{unit}]" if unit else "")


class WorstShear(WorstPeak):
    """The largest shear of the superstructure, divided by its weight, under a motion or a list of motions
    [–]."""

    def __init__(self, excitations):
        super().__init__("peak_shear", excitations)

    def describe(self) -> str:
        return "worst peak shear / m_t g"


class WorstDeformation(WorstPeak):
    """The largest deformation of the superstructure under a motion or a list of motions [m]; with several
    modes, the largest deformation of any mode."""

    def __init__(self, excitations):
        super().__init__("peak_deformation", excitations)


class WorstDrift(WorstPeak):
    """The largest drift of any story of a building under a motion or a list of motions [m].

    The evaluation raises `ValueError` for a podium without stories.
    """

    def __init__(self, excitations):
        super().__init__("peak_drift", excitations)


class WorstFloorAcceleration(WorstPeak):
    """The largest absolute horizontal acceleration of any floor under a motion or a list of motions [m/s²].

    The evaluation raises `ValueError` for a podium without stories.
    """

    def __init__(self, excitations):
        super().__init__("peak_floor_acceleration", excitations)


class PodiumFunction(AbstractObjective):
    """A function of the podium that returns a number, or a vector whose largest entry is minimised."""

    function: Callable[[rj.Podium], Any] = eqx.field(static=True)

    def values(self, podium: rj.Podium, options: rj.Options) -> Values:
        label = "design: the value of the function of the podium"
        value = as_float(self.function(podium), label)
        if value.ndim > 1 or not value.size:
            raise ValueError(f"{label} must be a number or a vector, got an array of shape {value.shape}")
        return jnp.atleast_1d(value)

    def describe(self) -> str:
        name = getattr(self.function, "__name__", "")
        return "objective" if name in ("", "<lambda>") else name


class ExpectedLoss(AbstractObjective):
    """Annual cost of the podium plus expected annual loss by overturning: function(podium) + loss · λ_f.

    - `function`: function of the podium that returns its annual cost [currency/year]
    - `loss`: loss by one overturning, > 0 [currency]
    - `risk`: an `optimise.AnnualFrequency`, which gives the annual frequency of overturning λ_f [1/year].
      `risk.at_most` is ignored. The same object may also be a target

    Raises `ValueError` for invalid arguments.
    """

    cost: PodiumFunction
    loss: Any
    risk: AnnualFrequency

    def __init__(self, function: Callable[[rj.Podium], Any], loss, risk: AnnualFrequency):
        owner = type(self).__name__
        if not callable(function):
            raise ValueError(f"{owner}: function must be a function of a podium, got {function!r}")
        require_instance(owner, "risk", risk, AnnualFrequency, "an optimise.AnnualFrequency")
        self.cost, self.loss, self.risk = PodiumFunction(function), require_limit(owner, "loss", loss), risk

    def values(self, podium: rj.Podium, options: rj.Options) -> Values:
        return self.cost.values(podium, options) + self.loss * self.risk.frequency(podium, options)

    def while_searching(self) -> Self:
        return eqx.tree_at(lambda o: o.risk, self, self.risk.while_searching())

    @property
    def scenes(self) -> int:
        return self.risk.scenes

    def describe(self) -> str:
        return f"{self.cost.describe()} and expected loss"
