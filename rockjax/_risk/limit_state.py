"""Limit states G(u) of standard normal u, evaluated in batches; G ≤ 0 is failure."""

from __future__ import annotations

import abc
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

MIN_BATCH = 8  # points of a batch; batches are filled up to powers of two, so that few sizes are compiled
MAX_BATCH = 4096


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


def evaluate_padded(u: np.ndarray, call: Callable) -> tuple[np.ndarray, ...]:
    """Evaluate `call` for the rows of u in batches of a few fixed sizes, padded by repeating the last row."""
    parts = []
    for start in range(0, len(u), MAX_BATCH):
        part = u[start : start + MAX_BATCH]
        size = max(MIN_BATCH, 1 << (len(part) - 1).bit_length())
        padded = np.concatenate([part, np.repeat(part[-1:], size - len(part), axis=0)])
        parts.append(tuple(np.asarray(y)[: len(part)] for y in call(jnp.asarray(padded))))
    return tuple(np.concatenate(ys) for ys in zip(*parts, strict=True))


class FunctionLimitState(AbstractLimitState):
    """A differentiable function of one u, shape (dimension,)."""

    def __init__(self, G: Callable, dimension: int):
        super().__init__(dimension)
        self._value = jax.jit(lambda u: (jax.vmap(G)(u),))
        self._value_and_grad = jax.vmap(jax.value_and_grad(G))
        self._slope = jax.jit(self._value_and_grad)

    def _values(self, u):
        return evaluate_padded(u, self._value)[0]

    def _gradients(self, u):
        value, slope = evaluate_padded(u, self._slope)
        # The derivative of `jnp.min` needs the entry that equals the minimum. Fused into other code, that
        # entry may be rounded differently and not be found, and the derivative is zero. Operation by
        # operation it is found.
        flat = ~slope.any(axis=1)
        if flat.any():
            value[flat], slope[flat] = (np.asarray(y) for y in self._value_and_grad(jnp.asarray(u[flat])))
        return value, slope
