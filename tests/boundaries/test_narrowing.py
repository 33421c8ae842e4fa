"""Changes narrowed down, of margins that are formulas."""

import numpy as np
import pytest

from rockjax._boundaries.looked import Known
from rockjax._boundaries.narrowing import MOST, narrowed, zero

CLOSE = 1e-12
ROOTS = np.random.default_rng(0).uniform(0.3, 1.7, 70)


def smooth(y, root):
    return np.tanh(3 * (root - y)) * (1 + 0.3 * np.sin(5 * y))


def jump(y, root):
    return np.where(y < root, 0.3 + y, -0.4)


def kink(y, root):
    return np.where(y < root, 20.0, 0.1) * (root - y)


def noisy(y, root):
    """As rounding and step sizes make it: with jumps that are small, and another zero for each of them."""
    return root - y + 1e-9 * np.sin(1e8 * y)


def search(margin, roots, sign=1.0, places=200):
    """(y, impacts, rounds) of one change on each line."""
    rounds = []

    def look(line, y, sharp, wanted):
        rounds.append(line.size)
        assert sharp
        assert not wanted
        assert np.all((y >= 0) & (y <= 2))
        value = sign * margin(y, roots[line])
        impacts = (y > roots[line]).astype(int)
        return Known(line, y, value, impacts, np.zeros(y.size), np.ones(y.size, bool))

    lines = np.repeat(np.arange(roots.size), places)
    known = look(lines, np.tile(np.linspace(0, 2, places), roots.size), True, False)
    at = known.changes()
    np.testing.assert_array_equal(known.line[at], np.arange(roots.size))
    rounds.clear()
    y, impacts = narrowed(known, at, look, CLOSE, 128)
    return y, impacts, rounds


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("margin", [smooth, jump, kink])
def test_changes_are_found_to_the_width(margin, sign):
    y, impacts, rounds = search(margin, ROOTS, sign)
    np.testing.assert_allclose(y, ROOTS, rtol=CLOSE)
    np.testing.assert_array_equal(impacts, 1 if sign > 0 else 0)  # on the overturned side
    assert len(rounds) < MOST


def test_smooth_margins_need_few_rounds():
    """A straight line through the ends of the bracket took 7 where scenes are few, 3 where they are many."""
    assert len(search(smooth, ROOTS)[2]) <= 4
    assert len(search(smooth, ROOTS[:1])[2]) <= 2


def test_jumps_are_halved_where_there_are_many():
    """One scene for each halving; three that divide a bracket by four took half as many again."""
    rounds = search(jump, ROOTS)[2]
    assert sum(rounds) < 1.25 * ROOTS.size * np.log2(2 / 200 / (CLOSE * ROOTS.min()))


def test_a_noisy_margin_ends_at_one_of_its_zeros():
    y, _, rounds = search(noisy, ROOTS)
    np.testing.assert_allclose(y, ROOTS, rtol=0, atol=3e-9)
    assert np.all(noisy(y * (1 - CLOSE), ROOTS) * noisy(y * (1 + CLOSE), ROOTS) <= 0)
    assert len(rounds) < MOST


def test_the_zero_of_four_places():
    """Exact where y is a cubic of the margin; what does not fall, or is not known, is left out."""
    margin = np.array([[0.9, 0.4, -0.3, -1.1]])
    y = 1.2 - 0.7 * margin + 0.2 * margin**2 - 0.05 * margin**3
    assert zero(y, margin)[0] == pytest.approx(1.2, abs=1e-14)
    quadratic = 1.2 - 0.7 * margin + 0.2 * margin**2
    unknown = np.where(np.arange(4) == 0, np.nan, margin)
    assert zero(quadratic, unknown)[0] == pytest.approx(1.2, abs=1e-14)
    rising = margin + np.array([0, 0, 0, 2.0])
    assert zero(quadratic, rising)[0] == pytest.approx(1.2, abs=1e-14)
    ends = np.array([[0.0, 0.4, -0.4, 0.0]])
    root, error = zero(np.array([[0.0, 1.0, 2.0, 3.0]]), ends)
    assert root == pytest.approx(1.5)
    assert 0 < error < 0.1
