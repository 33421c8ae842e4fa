"""Roots of functions in brackets: bisection, Newton's method inside a bracket, and division into many parts.

A bracket is an interval with a function value > 0 at one end and ≤ 0 at the other, in either order. All
functions work on arrays of brackets.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

MAX_ROUNDS = 64  # largest number of rounds of `narrow_brackets`
# The secant root of a bracket is the root of the straight line through the function values at both ends.
# `narrow_brackets` evaluates points on both sides of the secant root. The offset is the typical distance of
# these points from the secant root, divided by the length of the bracket.
FIRST_OFFSET = 0.02  # offset in the first round
# Offset in later rounds, divided by the expected error of the secant root. This error is also divided by the
# length of the bracket.
OFFSET_FACTOR = 3.0
MAX_OFFSET = 0.03  # brackets with a larger offset are divided into equal parts


def bisect(is_positive: Callable[[Any], Any], positive, negative, count: int, xp: Any = np):
    """Return the ends of brackets after `count` bisections: (positive, negative).

    - `is_positive`: points ↦ booleans, True if the function is > 0
    - `positive`, `negative`: ends of the brackets at which the function is > 0 and ≤ 0
    - `count`: number of bisections
    - `xp`: `numpy`, or `jax.numpy` for a loop in a compiled program
    """

    def halve(_, ends):
        middle = 0.5 * (ends[0] + ends[1])
        middle_is_positive = is_positive(middle)
        return xp.where(middle_is_positive, middle, ends[0]), xp.where(middle_is_positive, ends[1], middle)

    if xp is jnp:
        return jax.lax.fori_loop(0, count, halve, (positive, negative))
    for k in range(count):
        positive, negative = halve(k, (positive, negative))
    return positive, negative


def newton(f: Callable[[Array], Array], positive: Array, negative: Array, count: int):
    """Return (positive end, negative end, root, slope) of brackets after `count` Newton steps from their
    middles.

    - `f`: JAX function, elementwise
    - `positive`, `negative`: ends of the brackets at which f is > 0 and ≤ 0
    - `count`: number of steps

    A Newton step that would leave the bracket is replaced by a bisection. The slope is the derivative of f at
    the last evaluated point.
    """

    def step(_, carry):
        positive, negative, point, _ = carry
        value, slope = jax.jvp(f, (point,), (jnp.ones_like(point),))
        positive = jnp.where(value > 0, point, positive)
        negative = jnp.where(value > 0, negative, point)
        next_point = point - value / jnp.where(slope == 0, jnp.inf, slope)
        is_inside = (slope != 0) & ((next_point - positive) * (next_point - negative) <= 0)
        return positive, negative, jnp.where(is_inside, next_point, 0.5 * (positive + negative)), slope

    middle = 0.5 * (positive + negative)
    return jax.lax.fori_loop(0, count, step, (positive, negative, middle, middle))


def points_near_root(at_a, at_b, even: int, offsets, xp: Any = np):
    """Return points inside n brackets from a to b, as ascending fractions of the way from a to b, shape
    (n, even + 2k).

    - `at_a`, `at_b`: values at the ends a and b, one > 0 and the other ≤ 0, shape (n,)
    - `even`: number of equally spaced points, which narrow the bracket of any function
    - `offsets`: distances of k further points on each side of the secant root, divided by the length of the
      bracket, shape (k,) or (n, k). These points quickly narrow the brackets of smooth functions
    - `xp`: `numpy` or `jax.numpy`
    """
    drop = xp.where(at_a == at_b, 1.0, at_a - at_b)
    root = (at_a / drop)[..., None]
    spaced = xp.broadcast_to(_even_fractions(even), (*at_a.shape, even))
    return xp.sort(xp.clip(xp.concatenate([spaced, root - offsets, root + offsets], axis=-1), 0, 1), axis=-1)


def _even_fractions(count: int) -> np.ndarray:
    """Return `count` equally spaced numbers between 0 and 1, without the ends."""
    return np.arange(1, count + 1) / (count + 1)


class Brackets(NamedTuple):
    """n brackets, as arrays of shape (n,), with an output that `narrow_brackets` evaluates together with the
    function."""

    a: np.ndarray  # ends at which the function is > 0
    b: np.ndarray  # ends at which the function is ≤ 0
    at_a: np.ndarray  # values at a
    at_b: np.ndarray  # values at b
    output_at_b: np.ndarray  # outputs at b


def narrow_brackets(
    brackets: Brackets,
    evaluate: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
    relative_width: float,
    lanes: int,
) -> Brackets:
    """Narrow brackets to a relative width, in at most `MAX_ROUNDS` rounds, with NumPy.

    - `brackets`: brackets to narrow
    - `evaluate`: (indices of brackets (m,), points (m, k)) ↦ (values, outputs), both of shape (m, k).
      A value NaN counts as > 0
    - `relative_width`: width to reach, divided by the larger absolute value of the two ends
    - `lanes`: number of points that are evaluated in a round, in all brackets together. At least two points
      are evaluated in each bracket, even if their number then exceeds `lanes`

    A round evaluates some equally spaced points in each bracket, and points on both sides of the secant root.
    The distances from the secant root follow from the error of the secant root in the previous round. If
    these distances are large, for example because the function jumps, the bracket is divided into equal
    parts.
    """
    a, b, at_a, at_b, output_at_b = brackets = Brackets(*map(np.array, brackets))
    offset = np.full(a.size, FIRST_OFFSET)
    for _ in range(MAX_ROUNDS):
        size = np.maximum(np.abs(a), np.abs(b))
        wide = np.flatnonzero(np.abs(b - a) > relative_width * size)
        if wide.size == 0:
            break
        count, start, length = max(2, lanes // wide.size), a[wide], (b - a)[wide]
        pairs = max(1, 3 * count // 8)
        min_offset = 0.4 * relative_width * size[wide] / np.abs(length)
        # Each pair of points is ten times as far from the root as the pair before it.
        offsets = offset[wide, None] * 10.0 ** (np.arange(pairs) - pairs // 2)
        fractions = points_near_root(
            at_a[wide], at_b[wide], count - 2 * pairs, np.maximum(offsets, min_offset[:, None])
        )
        fractions = np.where(offset[wide, None] <= MAX_OFFSET, fractions, _even_fractions(count))
        points = start[:, None] + length[:, None] * fractions
        values, outputs = evaluate(wide, points)
        row, first = np.arange(wide.size), np.argmax(np.append(values, at_b[wide, None], axis=1) <= 0, axis=1)
        root = _secant_root(*(y[wide] for y in brackets[:4]))
        for ends, inner in ((a, points), (at_a, np.nan_to_num(values, nan=1.0))):
            ends[wide] = np.append(ends[wide, None], inner, axis=1)[row, first]
        for ends, inner in ((b, points), (at_b, values), (output_at_b, outputs)):
            ends[wide] = np.append(inner, ends[wide, None], axis=1)[row, first]
        error = np.abs(_secant_root(*(y[wide] for y in brackets[:4])) - root)
        # `error` is the error of the old secant root. For a smooth function, the error of the new secant root
        # is about `error` times (new length of the bracket / old length)².
        offset[wide] = OFFSET_FACTOR * error * np.abs((b - a)[wide]) / length**2
    return brackets


def _secant_root(a, b, at_a, at_b):
    """Return the root of the straight line through the ends of brackets."""
    return a + (b - a) * at_a / (at_a - at_b)
