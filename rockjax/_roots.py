"""Roots of functions in brackets: halving, Newton's method inside a bracket, and division into several parts.

A bracket lies between a place where a function is > 0 and one where it is not, in either order. All methods
work on arrays of brackets side by side.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

MAX_ROUNDS = 64  # greatest number of divisions of a bracket
FIRST_OFFSET = 0.02  # half the distance of the first two places beside the root of a straight line [bracket]
OFFSET_FACTOR = 3.0  # places beside that root are this many times its last error away
MAX_OFFSET = 0.03  # brackets whose places would be farther from the root are divided evenly


def bisect(is_positive: Callable[[Any], Any], positive, negative, count: int, xp: Any = np):
    """Return the ends of brackets after `count` halvings: (positive, negative).

    - `is_positive`: places → whether the function is > 0 there
    - `positive`, `negative`: ends of the brackets at which the function is > 0, and not
    - `count`: number of halvings
    - `xp`: `numpy`, or `jax.numpy` for a loop in a program
    """

    def halve(_, ends):
        middle = 0.5 * (ends[0] + ends[1])
        above = is_positive(middle)
        return xp.where(above, middle, ends[0]), xp.where(above, ends[1], middle)

    if xp is jnp:
        return jax.lax.fori_loop(0, count, halve, (positive, negative))
    for k in range(count):
        positive, negative = halve(k, (positive, negative))
    return positive, negative


def newton(f: Callable[[Array], Array], positive: Array, negative: Array, count: int):
    """Return the ends of brackets, the root and the last slope after `count` steps from the middle.

    - `f`: JAX function of one place
    - `positive`, `negative`: ends of the bracket at which f is > 0, and not
    - `count`: number of steps

    Newton's steps that leave the bracket become halvings.
    """

    def step(_, carry):
        positive, negative, point, _ = carry
        value, slope = jax.jvp(f, (point,), (jnp.ones_like(point),))
        positive = jnp.where(value > 0, point, positive)
        negative = jnp.where(value > 0, negative, point)
        next_point = point - value / jnp.where(slope == 0, jnp.inf, slope)
        inside = (slope != 0) & ((next_point - positive) * (next_point - negative) <= 0)
        return positive, negative, jnp.where(inside, next_point, 0.5 * (positive + negative)), slope

    middle = 0.5 * (positive + negative)
    return jax.lax.fori_loop(0, count, step, (positive, negative, middle, middle))


def points_near_root(at_a, at_b, even: int, offsets, xp: Any = np):
    """Return places inside brackets, as shares of the bracket from a to b, ascending: (n, even + 2·offsets).

    - `at_a`, `at_b`: values at the ends, of different signs, (n,)
    - `even`: number of equally spaced places, for certainty
    - `offsets`: distances of further places on both sides of the root of the straight line, for speed
    - `xp`: `numpy` or `jax.numpy`
    """
    drop = xp.where(at_a == at_b, 1.0, at_a - at_b)
    root = (at_a / drop)[..., None]
    spaced = xp.broadcast_to(_even_fractions(even), (*at_a.shape, even))
    return xp.sort(xp.clip(xp.concatenate([spaced, root - offsets, root + offsets], axis=-1), 0, 1), axis=-1)


def _even_fractions(count: int) -> np.ndarray:
    return np.arange(1, count + 1) / (count + 1)


class Brackets(NamedTuple):
    """Places `a` with values > 0 and `b` with values ≤ 0, and further outputs `more_at_b` at `b`; all
    (n,)."""

    a: np.ndarray
    b: np.ndarray
    at_a: np.ndarray
    at_b: np.ndarray
    more_at_b: np.ndarray


def narrow_brackets(
    brackets: Brackets,
    evaluate: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
    close: float,
    lanes: int,
) -> Brackets:
    """Return brackets no wider than the share `close` of their places (host).

    The root of the straight line through the ends is tried on both sides, at a distance that follows from the
    error of the last root. Where this fails, for example where the function jumps, the bracket is divided
    evenly.

    - `brackets`: brackets to narrow
    - `evaluate`: (brackets (m,), places (m, k)) → values, and further outputs for places with values ≤ 0; NaN
      values count as > 0
    - `close`: width to reach, relative to the place
    - `lanes`: number of places that are evaluated side by side
    """
    a, b, at_a, at_b, more_at_b = brackets = Brackets(*map(np.array, brackets))
    offset = np.full(a.size, FIRST_OFFSET)
    for _ in range(MAX_ROUNDS):
        size = np.maximum(np.abs(a), np.abs(b))
        wide = np.flatnonzero(np.abs(b - a) > close * size)
        if wide.size == 0:
            break
        count, start, length = max(2, lanes // wide.size), a[wide], (b - a)[wide]
        pairs = max(1, 3 * count // 8)
        least = 0.4 * close * size[wide] / np.abs(length)
        offsets = offset[wide, None] * 10.0 ** (np.arange(pairs) - pairs // 2)
        part = points_near_root(
            at_a[wide], at_b[wide], count - 2 * pairs, np.maximum(offsets, least[:, None])
        )
        part = np.where(offset[wide, None] <= MAX_OFFSET, part, _even_fractions(count))
        points = start[:, None] + length[:, None] * part
        values, more = evaluate(wide, points)
        row, first = np.arange(wide.size), np.argmax(np.append(values, at_b[wide, None], axis=1) <= 0, axis=1)
        root = _secant_root(*(y[wide] for y in brackets[:4]))
        for ends, inside in ((a, points), (at_a, np.nan_to_num(values, nan=1.0))):
            ends[wide] = np.append(ends[wide, None], inside, axis=1)[row, first]
        for ends, inside in ((b, points), (at_b, values), (more_at_b, more)):
            ends[wide] = np.append(inside, ends[wide, None], axis=1)[row, first]
        error = np.abs(_secant_root(*(y[wide] for y in brackets[:4])) - root)
        offset[wide] = OFFSET_FACTOR * error * np.abs((b - a)[wide]) / length**2
    return brackets


def _secant_root(a, b, at_a, at_b):
    return a + (b - a) * at_a / (at_a - at_b)
