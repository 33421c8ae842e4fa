"""Base class and results of the simplified methods of practice.

The methods are Eqs. (P1) to (P7) of docs/practice.md. That page also explains the stable solutions of (P3),
(P4) and (P5), the methods that compute a rotation.
"""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from rockjax._motions.motion import Motion
from rockjax._structures import Podium

from .block import Block
from .roots import Roots


class Quantity(NamedTuple):
    """An intermediate number of a method.

    - `value`: a number, or one number for each motion, shape (motions,); None if undefined
    - `unit`: unit of the value; `"1"` for ratios
    - `meaning`: symbol and meaning of the value
    """

    value: float | np.ndarray | None
    unit: str
    meaning: str


@dataclasses.dataclass(frozen=True)
class Case:
    """A podium and the ground motions under which a method evaluates it.

    - `podium`: a single podium
    - `block`: the rigid block that replaces the podium
    - `motions`: horizontal ground motions
    - `friction`: coefficient of friction μ, ≥ 0 [–]; None if it is not given
    - `vertical`: largest vertical ground acceleration A_v, ≥ 0 [m/s²]; None if it is not given
    - `confidence_factor`: confidence factor FC of the Italian Circolare 7/2019, ≥ 1 [–]
    """

    podium: Podium
    block: Block
    motions: tuple[Motion, ...]
    friction: float | None
    vertical: float | None
    confidence_factor: float

    def for_each_motion(self, function: Callable[[Motion], float]) -> np.ndarray:
        """Return the values of a function for the motions, shape (motions,)."""
        return np.array([function(motion) for motion in self.motions])

    @property
    def pga(self) -> np.ndarray:
        """Peak ground accelerations, shape (motions,) [m/s²]."""
        return self.for_each_motion(lambda motion: motion.pga)


@dataclasses.dataclass(frozen=True, eq=False)
class MethodResult:
    """Result of a simplified method for one podium and n motions.

    - `name`: name for programs; `title`: name for readers; `source`: publication and clause
    - `equation`: number of the formula in docs/practice.md, such as "(P1)"; `formula`: the formula as text
    - `quantity`, `unit`: the quantity that `capacity` and `demand` measure, and its unit (`"1"` for ratios)
    - `capacity`: capacity [`unit`]; None if it was not computed
    - `demand`: demand in each motion, shape (n,) [`unit`]; None if it was not computed
    - `statistic`: `"max"` or `"mean"`: whether `governing_demand` is the maximum or the mean of the n demands
    - `passes`: True if the method accepts the podium, False if not, None if there is no verdict. A method
      that computes a rotation accepts the podium if no motion overturns it. Any other method accepts the
      podium if the governing demand does not exceed the capacity
    - `answers`: for each motion, a tuple of all stable solutions θ/α of the method's equation, ascending [–].
      The value 1 stands for overturning. The tuple is empty if there is no stable solution ≥ 0.01, which
      counts as no uplift. None for methods that compute no rotation
    - `rotation_ratio`: for each motion, the largest of `answers`, or 0 if there is none, shape (n,) [–]. None
      for methods that compute no rotation
    - `values`: intermediate numbers by name, each with `value`, `unit` and `meaning`
    - `conservative`: whether the method is on the safe side: `"yes"`, `"no"` or `"depends"`
    - `reliability`: text on the reliability of the method
    - `missing`: texts on the parts that were not computed, with the reasons
    - `motions`: names of the motions
    """

    name: str
    title: str
    source: str
    equation: str
    formula: str
    quantity: str
    unit: str
    capacity: float | None
    demand: np.ndarray | None
    statistic: Literal["max", "mean"]
    passes: bool | None
    rotation_ratio: np.ndarray | None
    answers: tuple[tuple[float, ...], ...] | None
    values: Mapping[str, Quantity]
    conservative: Literal["yes", "no", "depends"]
    reliability: str
    missing: tuple[str, ...]
    motions: tuple[str, ...]

    @property
    def governing_demand(self) -> float | None:
        """Maximum or mean of the demands, according to `statistic` [`unit`]; None if there are no demands."""
        if self.demand is None:
            return None
        return float(self.demand.max() if self.statistic == "max" else self.demand.mean())

    @property
    def utilisation(self) -> float | None:
        """Governing demand divided by capacity [–]; inf for a capacity ≤ 0, None if one of them is
        missing."""
        demand = self.governing_demand
        if demand is None or self.capacity is None:
            return None
        return demand / self.capacity if self.capacity > 0 else math.inf

    @property
    def stable_roots(self) -> np.ndarray | None:
        """Number of `answers` for each motion, including overturning, shape (n,); 0 if the method predicts
        no uplift. None for methods that compute no rotation."""
        return None if self.answers is None else np.array([len(stable) for stable in self.answers])

    def __repr__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        demand, capacity = (
            "not computed" if value is None else f"{value:.4g}{unit}"
            for value in (self.governing_demand, self.capacity)
        )
        verdict = {True: "passes", False: "fails", None: "no verdict"}[self.passes]
        return f"{self.title} {self.equation}: {self.quantity} {demand}, capacity {capacity}: {verdict}"


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Results of a method for a case.

    - `rotations`: roots θ/α of the method's equation for each motion; None for methods that compute no
      rotation
    - `is_complete`: whether capacity and demand suffice for a verdict
    - other fields: as in `MethodResult`
    """

    capacity: float | None = None
    demand: np.ndarray | None = None
    rotations: tuple[Roots, ...] | None = None
    values: Mapping[str, Quantity] = dataclasses.field(default_factory=dict)
    is_complete: bool = True
    missing: tuple[str, ...] = ()


class AbstractMethod(abc.ABC):
    """A simplified method. Subclasses define the method `outcome` and the class variables, which are fields
    of `MethodResult`."""

    name: ClassVar[str]
    title: ClassVar[str]
    source: ClassVar[str]
    equation: ClassVar[str]
    formula: ClassVar[str]
    quantity: ClassVar[str]
    unit: ClassVar[str]
    statistic: ClassVar[Literal["max", "mean"]] = "max"
    conservative: ClassVar[Literal["yes", "no", "depends"]]
    reliability: ClassVar[str]
    missing: ClassVar[tuple[str, ...]] = ()  # parts that are never computed, with the reasons

    @abc.abstractmethod
    def outcome(self, case: Case) -> Outcome:
        """Return the results of the method for a case."""

    def obstacles(self, case: Case) -> tuple[str, ...]:
        """Return the reasons why the method cannot be applied to a case; by default there are none."""
        del case
        return ()

    def evaluate(self, case: Case) -> MethodResult:
        """Return the result of the method for a case."""
        obstacles = (*restrainer_obstacles(case), *self.obstacles(case))
        outcome = Outcome(is_complete=False, missing=obstacles) if obstacles else self.outcome(case)
        roots = outcome.rotations
        result = MethodResult(
            capacity=outcome.capacity,
            demand=outcome.demand,
            passes=None,
            rotation_ratio=None if roots is None else np.array([root.answer for root in roots]),
            answers=None if roots is None else tuple(root.answers for root in roots),
            values=outcome.values,
            missing=(*outcome.missing, *self.missing),
            motions=tuple(motion.name for motion in case.motions),
            **self._texts(),
        )
        utilisation = result.utilisation
        if not outcome.is_complete or utilisation is None:
            return result
        passes = utilisation <= 1 if roots is None else not any(root.overturns for root in roots)
        return dataclasses.replace(result, passes=passes)

    def _texts(self) -> dict[str, Any]:
        """Return the fields of `MethodResult` that are class variables of the method."""
        names = "name title source equation formula quantity unit statistic conservative reliability"
        return {name: getattr(self, name) for name in names.split()}


def restrainer_obstacles(case: Case) -> tuple[str, ...]:
    """Return the reason why no method applies to a podium with tendons, dampers or inerters; () for other
    podiums."""
    if case.podium.without_idle_restrainers().restrainers:
        return ("no simplified method covers tendons, dampers or inerters",)
    return ()


def damping_obstacles(damping: float) -> tuple[str, ...]:
    """Return the reason why a method cannot use a damping ratio outside [0, 1); () for ratios in this
    range."""
    if math.isfinite(damping) and 0 <= damping < 1:
        return ()
    return (f"the equivalent damping ratio must be in [0, 1), got {damping:.3g} from the restitution factor",)
