"""Refinement of changes of sign, for margins given by formulas."""

import numpy as np
import pytest

from rockjax._roots import MAX_ROUNDS, Brackets, narrow_brackets

CLOSE = 1e-12
ROOTS = np.random.default_rng(0).uniform(0.3, 1.7, 70)


def smooth(y, root):
    return np.tanh(3 * (root - y)) * (1 + 0.3 * np.sin(5 * y))


def jump(y, root):
    return np.where(y < root, 0.3 + y, -0.4)


def kink(y, root):
    return np.where(y < root, 20.0, 0.1) * (root - y)


def noisy(y, root):
    """Return a margin with small jumps, as rounding and step sizes cause, and a zero at each of them."""
    return root - y + 1e-9 * np.sin(1e8 * y)


def search(margin, roots, places=200):
    """Return (position, values at b, number of rounds) of one change on each line."""
    rounds, step = [], 2 / (places - 1)

    def evaluate(rows, y):
        rounds.append(y.size)
        assert np.all((y >= 0) & (y <= 2))
        return margin(y, roots[rows, None]), (y > roots[rows, None]).astype(int)

    a = np.floor(roots / step) * step
    b, ones = a + step, np.ones(roots.size, int)
    found = narrow_brackets(Brackets(a, b, margin(a, roots), margin(b, roots), ones), evaluate, CLOSE, 128)
    return 0.5 * (found.a + found.b), found.output_at_b, rounds


@pytest.mark.parametrize("margin", [smooth, jump, kink])
def test_changes_are_found_to_the_width(margin):
    y, impacts, rounds = search(margin, ROOTS)
    np.testing.assert_allclose(y, ROOTS, rtol=CLOSE)
    np.testing.assert_array_equal(impacts, 1)  # on the overturned side
    assert len(rounds) < MAX_ROUNDS


def test_brackets_may_lie_either_way_around():
    """Survival is above the change, as at the upper end of a window of overturning."""
    rows = np.arange(ROOTS.size)
    value = lambda y: -smooth(y, ROOTS)
    ends = Brackets(ROOTS + 0.01, ROOTS - 0.02, value(ROOTS + 0.01), value(ROOTS - 0.02), rows)
    found = narrow_brackets(ends, lambda of, y: (-smooth(y, ROOTS[of, None]), y), CLOSE, 128)
    np.testing.assert_allclose(found.a, ROOTS, rtol=CLOSE)
    assert np.all(found.a > found.b)


def test_smooth_margins_need_few_rounds():
    """For a straight line, each round reduces the error in proportion to the bracket."""
    assert len(search(smooth, ROOTS)[2]) <= 4
    assert len(search(smooth, ROOTS[:1])[2]) <= 3


def test_jumps_are_divided_evenly():
    """Two scenes divide a bracket by three, which takes 1.26 times as many scenes as halving."""
    rounds = search(jump, ROOTS)[2]
    assert sum(rounds) < 1.26 * 1.1 * ROOTS.size * np.log2(2 / 200 / (CLOSE * ROOTS.min()))


def test_a_noisy_margin_ends_at_one_of_its_zeros():
    y, _, rounds = search(noisy, ROOTS)
    np.testing.assert_allclose(y, ROOTS, rtol=0, atol=3e-9)
    assert np.all(noisy(y * (1 - CLOSE), ROOTS) * noisy(y * (1 + CLOSE), ROOTS) <= 0)
    assert len(rounds) < MAX_ROUNDS
