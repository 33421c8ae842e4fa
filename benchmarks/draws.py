"""Random numbers of scenes."""

from __future__ import annotations

import math

import numpy as np


def log_uniform(rng: np.random.Generator, low: float, high: float, n: int) -> np.ndarray:
    return np.exp(rng.uniform(math.log(low), math.log(high), n))


def some(
    rng: np.random.Generator, values: np.ndarray, special: tuple[float, ...], share: float = 0.15
) -> np.ndarray:
    """The values, a share of them replaced by special ones."""
    chosen = rng.choice(special, len(values))
    return np.where(rng.random(len(values)) < share, chosen, values)
