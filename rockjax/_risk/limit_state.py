"""Limit states: functions G(u) of a vector u of independent standard normal numbers, evaluated in batches.

Failure is G ≤ 0.
"""

from __future__ import annotations

import abc
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

# Least and largest number of points in a batch. Batches are padded to powers of two, so that few sizes are
# compiled.
MIN_BATCH, MAX_BATCH = 8, 4096


class AbstractLimitState(abc.ABC):
    """Interface of a limit state for the search for design points and for the estimators.

    - `dimension`: length d of u
    - `mirrored`: True if G(−u) = G(u) for all u
    - `scenes`: number of points u at which G has been evaluated
    """

    dimension: int
    mirrored = False

    def __init__(self, dimension: int):
        self.dimension = dimension
        self.scenes = 0

    def values(self, u: np.ndarray) -> np.ndarray:
        """Return G, shape (m,), at the rows of u, shape (m, d). Raises `ValueError` if a value is NaN."""
        self.scenes += len(u)
        if len(u) == 0:
            return np.zeros(0)
        return self._require_no_nan(u, np.asarray(self._values(u), float))

    def gradients(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return G, shape (m,), and ∇G, shape (m, d), at the rows of u. Raises `ValueError` if G is NaN."""
        self.scenes += len(u)
        value, slope = self._gradients(u)
        return self._require_no_nan(u, np.asarray(value, float)), np.asarray(slope, float)

    def with_sensitivities(
        self, u: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]] | None:
        """Return G, shape (m,), ∇G, shape (m, d), and ∂G/∂y, shape (m,), by the name of the parameter y; None
        if the limit state has no named parameters."""
        del u
        return None

    @staticmethod
    def _require_no_nan(u: np.ndarray, value: np.ndarray) -> np.ndarray:
        """Return `value`, the values of G at the rows of u. Raises `ValueError` if one is NaN."""
        is_nan = np.isnan(value)
        if is_nan.any():
            distance = np.linalg.norm(u[np.argmax(is_nan)])
            raise ValueError(
                f"limit state: G is NaN at a distance of {distance:.3g} from the origin; a function G must "
                "return a number for every u, and every scene of a structure must finish"
            )
        return value

    @abc.abstractmethod
    def _values(self, u: np.ndarray) -> np.ndarray:
        """Return G, as `values` does, without its check."""

    @abc.abstractmethod
    def _gradients(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return G and ∇G, as `gradients` does, without its check."""


def evaluate_padded(u: np.ndarray, call: Callable) -> tuple[np.ndarray, ...]:
    """Evaluate `call` for the rows of u, shape (m, d), in batches of a few fixed sizes, which are padded with
    copies of their last row. `call` maps a batch, shape (k, d), to a tuple of arrays of length k."""
    results = []
    for start in range(0, len(u), MAX_BATCH):
        batch = u[start : start + MAX_BATCH]
        size = max(MIN_BATCH, 1 << (len(batch) - 1).bit_length())
        padded = np.concatenate([batch, np.repeat(batch[-1:], size - len(batch), axis=0)])
        results.append(tuple(np.asarray(y)[: len(batch)] for y in call(jnp.asarray(padded))))
    return tuple(np.concatenate(ys) for ys in zip(*results, strict=True))


class FunctionLimitState(AbstractLimitState):
    """Limit state with G given as a differentiable JAX function of one vector u, shape (dimension,)."""

    def __init__(self, G: Callable, dimension: int):
        super().__init__(dimension)
        self._jitted_value = jax.jit(lambda u: (jax.vmap(G)(u),))
        self._value_and_grad = jax.vmap(jax.value_and_grad(G))
        self._jitted_value_and_grad = jax.jit(self._value_and_grad)

    def _values(self, u):
        return evaluate_padded(u, self._jitted_value)[0]

    def _gradients(self, u):
        value, slope = evaluate_padded(u, self._jitted_value_and_grad)
        # If G uses `jnp.min`, compiled code may return a zero gradient: the derivative of `jnp.min` looks for
        # the entry that equals the minimum, and finds none if the entry and the minimum are rounded
        # differently. Outside jit the entry is found, so zero gradients are computed again there.
        is_zero = ~slope.any(axis=1)
        if is_zero.any():
            outside_jit = self._value_and_grad(jnp.asarray(u[is_zero]))
            value[is_zero], slope[is_zero] = (np.asarray(y) for y in outside_jit)
        return value, slope
