"""Solutions φ of the equation F(φ) = φ of a method.

F(φ) is the rotation, divided by α, that a method computes from an assumed rotation φ = θ/α.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

LOWEST, HIGHEST = 0.01, 0.999  # range of the scanned rotations φ = θ/α [–]
SCAN_POINTS = 1001  # points of the scan
REFINEMENT_POINTS = 64  # points of each of the two refinements of a bracket


class Roots(NamedTuple):
    """Roots φ = θ/α of F(φ) = φ, ascending [–].

    - `stable`: roots with F(φ) > φ just below and F(φ) < φ just above
    - `unstable`: roots with F(φ) < φ just below and F(φ) > φ just above
    - `overturns`: whether F(φ) ≥ φ at the end of the scan, φ = 0.999
    """

    stable: np.ndarray
    unstable: np.ndarray
    overturns: bool

    @property
    def answer(self) -> float:
        """Largest stable solution θ/α [–]; 1 for overturning, 0 without a stable root."""
        return 1.0 if self.overturns else float(self.stable.max(initial=0.0))

    @property
    def answers(self) -> tuple[float, ...]:
        """All stable solutions θ/α, ascending; 1 stands for overturning [–]."""
        return (*map(float, self.stable), *([1.0] if self.overturns else []))


def find_roots(excess: Callable[[np.ndarray], np.ndarray]) -> Roots:
    """Return the roots of F(φ) − φ in 0.01 ≤ φ ≤ 0.999.

    `excess` is evaluated at 1001 equally spaced points. Two roots between neighbouring points are missed. The
    interval around a root is divided into 63 parts, and the part that contains the root into 63 smaller
    parts. In the last part, `excess` is interpolated linearly.

    - `excess`: F(φ) − φ, or a quantity of the same sign, for an array of φ [–]
    """
    phi = np.linspace(LOWEST, HIGHEST, SCAN_POINTS)
    values = excess(phi)
    is_positive = values > 0
    first = np.flatnonzero(is_positive[:-1] != is_positive[1:])
    is_falling = is_positive[first]
    roots = _refine_roots(excess, phi[first], phi[first + 1], np.where(is_falling, 1.0, -1.0))
    return Roots(roots[is_falling], roots[~is_falling], bool(values[-1] >= 0))


def _refine_roots(
    excess: Callable[[np.ndarray], np.ndarray], low: np.ndarray, high: np.ndarray, sign: np.ndarray
) -> np.ndarray:
    """Return the root in each bracket, shape (roots,).

    - `excess`: as for `find_roots`
    - `low`, `high`: ends of the brackets, shape (roots,) each
    - `sign`: sign of `excess` at `low`, shape (roots,)
    """
    if not low.size:
        return low
    rows = np.arange(low.size)
    at_low = at_high = low
    for _ in range(2):
        points = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, REFINEMENT_POINTS)
        values = sign[:, None] * excess(points.ravel()).reshape(points.shape)
        # Index of the last point before the largest root in the bracket.
        last = REFINEMENT_POINTS - 2 - np.argmax((values[:, :-1] > 0)[:, ::-1], axis=1)
        low, high = points[rows, last], points[rows, last + 1]
        at_low, at_high = values[rows, last], values[rows, last + 1]
    return low + (high - low) * at_low / (at_low - at_high)
