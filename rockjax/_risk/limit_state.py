"""Limit states G(u) of standard normal u, evaluated in batches; G ≤ 0 is failure."""

from __future__ import annotations

import abc
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

SMALLEST = 8  # points of a batch; batches are filled up to powers of two, so that few sizes are compiled
LARGEST = 4096


class AbstractLimitState(abc.ABC):
    """Interface of a limit state for the search and the estimators.

    `scenes` counts evaluations, `gradients_taken` those with derivatives.
    """

    dimension: int
    mirrored = False  # G(−u) = G(u)

    def __init__(self, dimension: int):
        self.dimension = dimension
        self.scenes = 0
        self.gradients_taken = 0

    def values(self, u: np.ndarray) -> np.ndarray:
        """Return G at the rows of u, shape (m, d): (m,). Raises `ValueError` if G is not a number."""
        self.scenes += len(u)
        if len(u) == 0:
            return np.zeros(0)
        return self._checked(u, np.asarray(self._values(u), float))

    def gradients(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return G and ∇G at the rows of u: (m,), (m, d)."""
        self.scenes += len(u)
        self.gradients_taken += len(u)
        value, slope = self._gradients(u)
        return self._checked(u, np.asarray(value, float)), np.asarray(slope, float)

    def with_sensitivities(
        self, u: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]] | None:
        """Return G (m,), ∇G (m, d) and ∂G/∂y (m,) for every named number y of the limit state, or None if it
        has none."""
        del u
        return None

    @staticmethod
    def _checked(u: np.ndarray, value: np.ndarray) -> np.ndarray:
        bad = np.isnan(value)
        if bad.any():
            at = u[np.argmax(bad)]
            raise ValueError(
                f"reliability: G is not a number at a point {np.linalg.norm(at):.3g} from the origin; "
                "return a "
                "finite value for every u, negative for failure"
            )
        return value

    @abc.abstractmethod
    def _values(self, u: np.ndarray) -> np.ndarray: ...

    @abc.abstractmethod
    def _gradients(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...


def filled(u: np.ndarray, call: Callable) -> tuple[np.ndarray, ...]:
    """Evaluate `call` for the rows of u in batches of a few fixed sizes, padded by repeating the last row."""
    parts = []
    for start in range(0, len(u), LARGEST):
        part = u[start : start + LARGEST]
        size = max(SMALLEST, 1 << (len(part) - 1).bit_length())
        whole = np.concatenate([part, np.repeat(part[-1:], size - len(part), axis=0)])
        parts.append(tuple(np.asarray(y)[: len(part)] for y in call(jnp.asarray(whole))))
    return tuple(np.concatenate(ys) for ys in zip(*parts, strict=True))


class OfFunction(AbstractLimitState):
    """A differentiable function of one u, shape (dimension,)."""

    def __init__(self, G: Callable, dimension: int):
        super().__init__(dimension)
        self._value = jax.jit(lambda u: (jax.vmap(G)(u),))
        self._plain = jax.vmap(jax.value_and_grad(G))
        self._slope = jax.jit(self._plain)

    def _values(self, u):
        return filled(u, self._value)[0]

    def _gradients(self, u):
        value, slope = filled(u, self._slope)
        # The derivative of `jnp.min` needs the entry that equals the minimum. Fused into other code, that
        # entry may be rounded differently and not be found, and the derivative is zero. Operation by
        # operation it is found.
        flat = ~slope.any(axis=1)
        if flat.any():
            value[flat], slope[flat] = (np.asarray(y) for y in self._plain(jnp.asarray(u[flat])))
        return value, slope
