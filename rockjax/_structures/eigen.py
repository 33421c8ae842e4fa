"""Eigenvalues and eigenvectors of small symmetric matrices.

NumPy's where the numbers are known. Inside a program Jacobi's method, by rotations alone: what JAX has calls
LAPACK, by addresses that a program which is kept and loaded by another process does not have there.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from rockjax._checks import concrete
from rockjax._types import Array

SWEEPS = 12  # over all pairs: more than matrices of some tens of rows take


def eigh(matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues, ascending along the last axis, and eigenvectors in columns."""
    if concrete(matrix) is not None:
        return np.linalg.eigh(np.asarray(matrix))  # pyright: ignore[reportReturnType]
    batch, size = matrix.shape[:-2], matrix.shape[-1]
    values, vectors = jax.vmap(_jacobi)(matrix.reshape(-1, size, size))
    return values.reshape(*batch, size), vectors.reshape(*batch, size, size)


@jax.custom_jvp
def _jacobi(matrix: Array) -> tuple[Array, Array]:
    size = matrix.shape[-1]
    rounds = _rounds(size)
    same = jnp.eye(size, dtype=matrix.dtype)

    def rotate(k, carry):
        matrix, vectors = carry
        p, q = jnp.asarray(rounds)[k % len(rounds)]
        apart, between = matrix[q, q] - matrix[p, p], matrix[p, q]
        turns = between != 0
        cotangent = apart / jnp.where(turns, 2 * between, 1.0)  # of twice the angle
        tangent = jnp.where(cotangent < 0, -1.0, 1.0) / (jnp.abs(cotangent) + jnp.sqrt(1 + cotangent**2))
        tangent = jnp.where(turns, tangent, 0.0)
        cos = 1 / jnp.sqrt(1 + tangent**2)
        sin = tangent * cos
        rotation = same.at[p, p].set(cos).at[q, q].set(cos).at[p, q].set(sin).at[q, p].set(-sin)
        return rotation.T @ matrix @ rotation, vectors @ rotation

    matrix, vectors = jax.lax.fori_loop(0, SWEEPS * len(rounds), rotate, (matrix, same))
    values = jnp.diagonal(matrix)
    order = jnp.argsort(values)
    return values[order], vectors[:, order]


@_jacobi.defjvp
def _jacobi_jvp(primals, tangents):
    values, vectors = _jacobi(*primals)
    inner = vectors.T @ tangents[0] @ vectors
    gaps = values[None, :] - values[:, None] + jnp.eye(values.size)
    turning = inner / gaps * (1 - jnp.eye(values.size))
    return (values, vectors), (jnp.diagonal(inner), vectors @ turning)


def _rounds(size: int) -> np.ndarray:
    """Every pair of rows once, as many side by side as there can be: (rounds, 2, pairs)."""
    players = [*range(size), *([-1] if size % 2 else [])]
    rounds = []
    for _ in range(max(len(players) - 1, 1)):
        half = len(players) // 2
        pairs = [
            pair for pair in zip(players[:half], reversed(players[half:]), strict=True) if -1 not in pair
        ]
        rounds.append(np.array(pairs, np.int32).reshape(-1, 2).T)
        players = [players[0], players[-1], *players[1:-1]]
    return np.stack(rounds)
