"""Margins of targets on probabilities of failure, which are estimated by sampling (sampled targets).

A target holds where its margin is ≥ 0. Slopes are derivatives with respect to the scaled variables, which are
0 and 1 at their bounds. A scene is one structure under one ground motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

import rockjax as rj
from rockjax.internal import parameters_of, read, with_values

from ._answer import SampleEstimates
from ._failure import FailureProbability, RayTarget
from ._quadratic import Vector
from ._targets import AbstractTarget
from ._variables import Dimensions, Variables

ZERO_REPLACEMENT = 1e-9  # replaces varied parameters that are 0 and therefore have no logarithm
JOINT_LIMITS = ("friction", "unloading", "foundation shear")  # limits on forces in the joints


# A margin, and its derivatives (n,) with respect to the scaled variables.
MarginSlope = tuple[float, Vector]


class _StructureParameters:
    """The parameters of the podium as functions of the scaled variables x, with their derivatives."""

    def __init__(self, variables: Variables):
        self.variables = variables
        podium = variables.podium(variables.start())
        self.names = tuple(name for name, entry in parameters_of(podium).items() if entry.attribute_path)

        def parameters(x):
            podium = variables.podium(x)
            return jnp.stack([jnp.asarray(read(podium, name), float) for name in self.names])

        self._values_and_slopes = jax.jit(lambda x: (parameters(x), jax.jacfwd(parameters)(x)))

    def __call__(self, x: Vector) -> tuple[rj.Podium, dict[str, Vector]]:
        """Return the podium at x (n,), and name → derivatives d ln y/dx (n,) for every parameter y that
        depends on x. Such a parameter is replaced by `ZERO_REPLACEMENT` if it is 0."""
        y, slope = (np.asarray(array) for array in self._values_and_slopes(jnp.asarray(x)))
        is_varied = slope.any(axis=1)
        podium = self.variables.podium(jnp.asarray(x))
        zeros = [name for name, is_zero in zip(self.names, is_varied & (y == 0), strict=True) if is_zero]
        podium = with_values(podium, dict.fromkeys(zeros, ZERO_REPLACEMENT)) if zeros else podium
        y = np.where(y == 0, ZERO_REPLACEMENT, y)
        log_slopes = dict(zip(self.names, slope / y[:, None], strict=True))
        return podium, {
            name: log_slopes[name] for name, varied in zip(self.names, is_varied, strict=True) if varied
        }


class SampledTargets:
    """The sampled targets of a design; outside jit.

    - `variables`: the design variables; `targets`: all targets of the design

    The attribute `targets` contains only the sampled targets: index among all targets → target. Raises
    `ValueError` for limits on forces in the joints if the height or the end radius of round columns varies.
    """

    def __init__(self, variables: Variables, targets: Sequence[AbstractTarget]):
        self.targets = {k: t for k, t in enumerate(targets) if isinstance(t, FailureProbability)}
        for target in self.targets.values():
            _check_levers(variables, target)
        self._parameters = _StructureParameters(variables) if self.targets else None
        self._first_podium = variables.podium(variables.start()) if self.targets else None
        self._ray_targets: dict[int, RayTarget] = {}
        self._cache: dict[bytes, dict[int, MarginSlope]] = {}

    @property
    def scenes(self) -> int:
        """Number of scenes that all sampled targets have simulated."""
        return sum(ray_target.scenes for ray_target in self._ray_targets.values())

    def use_accurate(self) -> None:
        """Switch to verification: margins then include no allowance for the scatter between samples."""
        for ray_target in self._ray_targets.values():
            ray_target.is_verifying = True
        self._cache.clear()

    def at(self, x: Vector) -> Mapping[int, MarginSlope]:
        """Return index of the target → margin and slope, at scaled variables x (n,)."""
        if self._parameters is None:
            return {}
        key = np.asarray(x, float).tobytes()
        if key not in self._cache:
            podium, log_slopes = self._parameters(x)
            margins = {}
            for k, ray_target in self._create_ray_targets().items():
                margin, sensitivities = ray_target.at(podium, tuple(log_slopes))
                # The chain rule over the logarithms of the parameters.
                terms = (a * b for a, b in zip(sensitivities, log_slopes.values(), strict=True))
                margins[k] = margin, sum(terms, np.zeros(np.size(x)))
            self._cache[key] = margins
        return self._cache[key]

    def _create_ray_targets(self) -> dict[int, RayTarget]:
        """Return index of the target → `RayTarget`. The first call draws rays for the user's structure."""
        for k, target in self.targets.items():
            if k not in self._ray_targets:
                assert self._first_podium is not None
                self._ray_targets[k] = RayTarget(target, self._first_podium)
        return self._ray_targets

    def check(self, x: Vector) -> tuple[bool, bool]:
        """Take an independent sample at x (n,) for each target that has no sample there. Returns whether a
        sample was taken, and whether a new sample differs from the estimate of the search by more than the
        allowance for scatter between two samples (`RayTarget.spread`)."""
        if self._parameters is None:
            return False, False
        podium, _ = self._parameters(x)
        is_new = differs = False
        for ray_target in self._create_ray_targets().values():
            change = ray_target.check(podium)
            if change is not None:
                is_new = True
                differs = differs or abs(change) > ray_target.spread
                self._cache.clear()
        return is_new, differs

    def probabilities(self, x: Vector) -> SampleEstimates:
        """Return the estimates from the independent samples that were taken at x (n,); None for a target
        without such a sample."""
        if self._parameters is None:
            return SampleEstimates({})
        podium, _ = self._parameters(x)
        ray_targets = self._create_ray_targets()
        return SampleEstimates(
            {k: ray_target.checked_estimate(podium) for k, ray_target in ray_targets.items()}
        )


def _check_levers(variables: Variables, target: FailureProbability) -> None:
    """Raise `ValueError` if the variables change the levers of forces in the joints of round columns, and the
    limit of the target is on such forces. No named parameter describes these levers, so their part of the
    derivative would be missing."""
    varied = [name for name in ("height", "end_radius") if name in variables.names]
    if not varied or target.limit[0] not in JOINT_LIMITS or not isinstance(variables.base, Dimensions):
        return
    podium = jax.eval_shape(variables.podium, jax.ShapeDtypeStruct((len(variables.names),), float))
    if podium.elevation is not None and podium.elevation._raised is not None:
        raise ValueError(
            f"FailureProbability: with round columns, the limit {target.limit[0]!r} has no derivatives with "
            f"respect to {' and '.join(varied)}; keep the dimension fixed, or limit another response"
        )
