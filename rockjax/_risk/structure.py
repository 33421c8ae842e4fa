"""Limit states of podiums under Gaussian motions.

A vector u of independent standard normal numbers determines a Gaussian motion. Without a pulse, the motion is
ü_g = A u with a fixed matrix A. A limit state is a function G(u) that is ≤ 0 if and only if the podium fails.
G follows from the simulated response to the motion. A scene is the podium under one motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from rockjax import _results as results
from rockjax._batch.batch import peak_responses
from rockjax._checks import array_module, as_array, as_float, product, require_number
from rockjax._engine.solve import solve
from rockjax._motions.records import Records
from rockjax._options import Options
from rockjax._outputs.axial_force import Unloading
from rockjax._outputs.base import AbstractOutput
from rockjax._outputs.registry import REGISTRY, name_if_registered
from rockjax._programs.program import StoredProgram
from rockjax._responses.simulate import REST
from rockjax._structures import Podium, ShearBuilding

from .gaussian import GaussianMotion
from .limit_state import AbstractLimitState

BATCH = 256  # number of records in a batch, fixed so that one compiled program serves all batches
GRADIENT_BATCH = 8  # number of scenes whose derivatives are computed together
# The sampling interval of the motion limits the length of most solver steps, so a tight tolerance costs
# little.
OPTIONS = Options(rtol=1e-9, atol=1e-11)


class Limit(NamedTuple):
    """Definition of failure: a peak reaches a value, or the podium overturns.

    G = 1 − peak/value, but at most 0 if the podium overturns. If only overturning counts as failure, G is the
    overturning margin of docs/overturning.md.
    """

    output: str  # name of the peak in the answer of a scene; "margin" if only overturning counts as failure
    value: float  # value of the peak at failure; not used for the margin
    request: str | AbstractOutput  # the output that computes the peak, for `Options.outputs`


class _LimitKind(NamedTuple):
    """A peak that users may limit."""

    output: str | AbstractOutput  # the output that computes the peak, or its name
    unit: str  # unit or definition of the peak
    structure: str  # key of `STRUCTURES`: the kind of structure that has this output


# Kind of structure ↦ function that returns True for podiums of this kind.
STRUCTURES: dict[str, Callable[[Podium], bool]] = {
    "columns": lambda podium: True,
    "a superstructure": lambda podium: podium.superstructure is not None,
    "an elastic superstructure": lambda podium: podium.vibrates,
    "a building of stories, a rockjax.ShearBuilding": lambda podium: (
        podium.vibrates and isinstance(podium.superstructure, ShearBuilding)
    ),
}
SUPERSTRUCTURE, ELASTIC, BUILDING = list(STRUCTURES)[1:]

# Limit states other than overturning.
LIMITS = {
    "rotation": _LimitKind("peak_rotation", "max|θ|/α", "columns"),
    "deformation": _LimitKind("peak_deformation", "m", ELASTIC),
    "shear": _LimitKind("peak_shear", "V_s/(m_t g)", SUPERSTRUCTURE),
    "drift": _LimitKind("peak_drift", "m", BUILDING),
    "floor acceleration": _LimitKind("peak_floor_acceleration", "m/s²", BUILDING),
    "friction": _LimitKind("peak_friction", "|T|/N", "columns"),
    "unloading": _LimitKind(Unloading(), "1 − N/N_0", "columns"),
    "foundation shear": _LimitKind("peak_foundation_shear", "divided by the weight", "columns"),
}


def parse_limit(owner: str, limit: Any, podium: Podium | None = None) -> Limit:
    """Convert the argument `limit`, `"overturning"` or a tuple of a key of `LIMITS` and a number > 0, to a
    `Limit`. Raises `ValueError` for other values, for traced numbers, and if `podium` is given and does not
    have the output of the limit."""
    if isinstance(limit, str) and limit == "overturning":
        return Limit("margin", 1.0, "margin")
    if isinstance(limit, tuple) and len(limit) == 2 and limit[0] in list(LIMITS):
        name, value = limit
        kind = LIMITS[name]
        if podium is not None and not STRUCTURES[kind.structure](podium):
            raise ValueError(f"{owner}: limit {name!r} needs {kind.structure}; this podium has none")
        if isinstance(value, Tracer):
            raise ValueError(f"{owner}: limit {name!r} must be a number, not a traced value")
        label = f"limit {name!r} [{kind.unit}]"
        value = require_number(owner, label, value, lambda v: v > 0, "finite and > 0")
        if name == "rotation" and value >= 1:
            raise ValueError(f"{owner}: limit 'rotation' must be < 1, got {value!r}; 1 is 'overturning'")
        output = REGISTRY[kind.output] if isinstance(kind.output, str) else kind.output
        # A peak that can be infinite is replaced by a finite measure, which has its own limit.
        output, value = output.for_limit(value)
        return Limit(output.name, value, name_if_registered(output))
    names = ", ".join(f"({name!r}, value)" for name in LIMITS)
    raise ValueError(f"{owner}: limit must be 'overturning' or one of {names}, got {limit!r}")


class StructureLimitState(AbstractLimitState):
    """Limit state of a podium under the motions of a `GaussianMotion`.

    - `podium`: structure; `motion`: model of its ground motions; `limit`: definition of failure
    - `options`: options of the scenes; `outputs` and `throw` are replaced
    """

    def __init__(self, podium: Podium, motion: GaussianMotion, limit: Limit, options: Options = OPTIONS):
        super().__init__(motion.dimension)
        # As arrays, all floats of the motion are arguments of the compiled programs and have derivatives.
        self.motion = jax.tree.map(lambda y: as_float(y) if isinstance(y, float) else y, motion)
        self.podium, self.limit = podium, limit
        # Without a pulse, −u reverses the motion. By symmetry, the podium then fails under −u if and only if
        # it fails under u.
        self.mirrored = motion.pulse is None
        self.options = options.replace(outputs=(limit.request,), throw=False)

    def _values(self, u):
        # Scenes with u = 0 fill the last batch. Without a pulse they stay at rest and cost almost nothing.
        padded = np.concatenate([u, np.zeros((-len(u) % BATCH, self.dimension))])
        answers = [
            self._batch_values(padded[start : start + BATCH]) for start in range(0, len(padded), BATCH)
        ]
        return np.concatenate(answers)[: len(u)]

    def _batch_values(self, u: np.ndarray) -> np.ndarray:
        """Return G, shape (m,), at the rows of u, m ≤ `BATCH`; NaN for scenes that do not finish."""
        peaks = self._peaks(u)
        value = _limit_value(getattr(peaks, self.limit.output), peaks.overturned, self.limit)
        unfinished = results.did_not_finish(np.asarray(results.code_of(peaks.result)))
        return np.where(unfinished, np.nan, np.asarray(value))

    def _peaks(self, u: np.ndarray, names: Sequence[str] = (), *outputs: str):
        """Return the peaks of the scenes that the rows of u, shape (m, d), m ≤ `BATCH`, determine.

        - `names`: parameters for sensitivities: names of parameters of the podium, and `"scale"`, the factor
          on the motion
        - `outputs`: outputs that are requested in addition to the output of the limit
        """
        padded = np.concatenate([u, np.zeros((BATCH - len(u), self.dimension))])
        records = records_from_samples(self.motion, as_float(padded)).pick(np.arange(len(u), dtype=np.int32))
        options = self.options.replace(outputs=(*self.options.outputs, *outputs))
        return peak_responses(self.podium, records, options=options, sensitivities=names)

    def log_slopes(self, u: np.ndarray, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return G and its logarithmic derivatives at the rows of u, shape (m, d): G, shape (m,); the
        derivative of G with respect to ln|u| in the direction of u, shape (m,); and the derivatives with
        respect to the logarithms of the parameters `names` of the podium, shape (m, names)."""
        # Without a pulse, the motion is proportional to |u|, so the derivative with respect to ln|u| is the
        # sensitivity with respect to the scale of the motion.
        scale_name = () if self.motion.pulse is not None else ("scale",)
        if len(u) == 0:
            return np.zeros(0), np.zeros(0), np.zeros((0, len(names)))
        self.scenes += len(u)
        batches = [self._log_slopes(u[k : k + BATCH], (*names, *scale_name)) for k in range(0, len(u), BATCH)]
        value, slopes = (np.concatenate(ys) for ys in zip(*batches, strict=True))
        if scale_name:
            return value, slopes[:, -1], slopes[:, :-1]
        _, slope = self.gradients(u)
        return value, np.sum(slope * u, axis=1), slopes

    def _log_slopes(self, u: np.ndarray, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Return G, shape (m,), and its derivatives with respect to the logarithms of named parameters, shape
        (m, names). Unlike in `values`, overturning alone does not make G ≤ 0 here."""
        peaks = self._peaks(u, names)
        value = np.asarray(getattr(peaks, self.limit.output))
        slopes = np.zeros((*value.shape, 0))
        if names:
            slopes = np.asarray(getattr(peaks.sensitivities, self.limit.output))
        if value.ndim > 1:
            worst = np.argmax(value, axis=1)[:, None]
            value = np.take_along_axis(value, worst, axis=1)[:, 0]
            slopes = np.take_along_axis(slopes, worst[..., None], axis=1)[:, 0]
        if self.limit.output == "margin":
            return value, slopes
        return 1 - value / self.limit.value, -slopes / self.limit.value

    def _gradients(self, u):
        value, slope, _ = self.with_sensitivities(u)
        return value, slope

    def with_sensitivities(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Return G, shape (m,), ∇G, shape (m, d), and the derivatives of G with respect to all parameters of
        podium and motion, shape (m,) each, by the locations of the parameters as in `_by_location`."""
        results_of_batches = []
        for start in range(0, len(u), GRADIENT_BATCH):
            batch = u[start : start + GRADIENT_BATCH]
            padded = np.concatenate([batch, np.repeat(batch[-1:], GRADIENT_BATCH - len(batch), axis=0)])
            answers = _slopes(as_float(padded), self.podium, self.motion, self.options, self.limit)
            results_of_batches.append(jax.tree.map(lambda y, n=len(batch): np.asarray(y)[:n], answers))
        value, slope, leaves = jax.tree.map(lambda *ys: np.concatenate(ys), *results_of_batches)
        arrays, _ = eqx.partition((self.podium, self.motion), eqx.is_inexact_array)
        return value, slope, _by_location(*jax.tree.unflatten(jax.tree.structure(arrays), leaves))

    def impacts(self, u: np.ndarray) -> np.ndarray:
        """Return the number of impacts in the scenes of the rows of u, shape (m,). In scenes that overturn,
        impacts before overturning are counted. NaN for scenes that do not finish."""
        impacts = np.asarray(self._peaks(u).impacts)
        if not np.isnan(impacts).any():
            return impacts
        # Here NaN marks scenes that did not finish, and also scenes that ended before their last impact
        # because all requested outputs were final. With the output `impacts`, only unfinished scenes have
        # NaN.
        return np.asarray(self._peaks(u, (), "impacts").impacts)


def records_from_samples(motion: GaussianMotion, u: Float[Array, "k d"]) -> Records:
    """Return the motions that the rows of u, shape (k, d), determine as records."""
    count, ones = len(u), np.ones(len(u))
    samples, start = as_array(np.full(count, motion.n, np.int32)), as_float(0 * ones)
    intervals = as_float(product(ones, motion.dt))
    return Records(motion.acceleration(u), samples, intervals, start, np.arange(count))


def _limit_value(value, overturned, limit: Limit):
    """Return G, which is ≤ 0 if and only if the podium fails. If `value`, the peak that `limit` names, has a
    last axis of modes, stories, floors or joints, the largest counts."""
    xp = array_module(value, overturned)
    if np.ndim(value) > np.ndim(overturned):
        value = xp.max(xp.asarray(value), axis=-1)
    if limit.output == "margin":
        # A margin that rounds to zero without overturning must not count as failure.
        return xp.where(overturned, xp.minimum(value, 0.0), xp.maximum(value, 1e-300))
    margin = 1 - xp.divide(value, limit.value)
    return xp.where(overturned, xp.minimum(margin, 0.0), margin)


def _value_and_slopes(
    u: Float[Array, "k d"], podium: Podium, motion: GaussianMotion, options: Options, limit: Limit
):
    """Return G, shape (k,), ∇G, shape (k, d), and the derivatives of G with respect to all parameters of
    podium and motion as a list of arrays."""
    parameters, static = eqx.partition((podium, motion), eqx.is_inexact_array)

    def G(u, parameters):
        podium, motion = eqx.combine(parameters, static)
        (floats, _), (integers, _) = solve(podium, motion.record(u), REST, None, options)
        return _limit_value(floats[limit.output], integers["overturned"], limit)

    value, (slope, parameter_slopes) = jax.vmap(jax.value_and_grad(G, (0, 1)), (0, None))(u, parameters)
    # A `StoredProgram` cannot return a tree of modules, so the leaves of the tree are returned.
    return value, slope, jax.tree.leaves(parameter_slopes)


_slopes = StoredProgram(_value_and_slopes)


def _by_location(*slopes: Any) -> dict[str, np.ndarray]:
    """Return derivatives, shape (k,) each, by the locations of the parameters. Each of `slopes` is a tree of
    parameters, with its derivatives at k points in place of each parameter, shape (k, …). Locations are in
    Python notation: `alpha`, `restrainers[0].prestress`, `superstructure.masses[2]`."""
    slopes_by_location = {}
    for tree in slopes:
        for path, y in jax.tree_util.tree_leaves_with_path(tree):
            name, values = jax.tree_util.keystr(path).lstrip("."), np.asarray(y)
            for index in np.ndindex(values.shape[1:]):
                slopes_by_location[name + "".join(f"[{i}]" for i in index)] = values[:, *index]
    return slopes_by_location
