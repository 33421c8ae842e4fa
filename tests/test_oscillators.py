"""Responses of linear oscillators to polynomial accelerations with velocity jumps, compared with SciPy's
integrator."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rockjax._oscillators import RESPONSES, SERIES_TERMS, Load, _turning_points, ground_load, largest

T, ZETA = np.array([2.0, 0.15, 0.7, 0.4]), np.array([0.05, 0.1, 0.0, 0.4])
START, LENGTH = np.array([0.3, 0.9, 1.0, 1.8]), np.array([0.6, 0.1, 0.8, 0.5])
TERMS = np.array([[1.0, -4.0, 3.0], [-2.0, 1.0, 0.5], [0.4, 2.0, -3.5], [0.1, 0.3, 0.2]])
KICKS = np.array([0.0, 0.3, 0.0, -0.5])


def load(terms=TERMS, start=START, length=LENGTH, kick=KICKS):
    none = np.zeros(len(start))
    return Load(start, length, terms, kick, none, none)


def reference(one, period, zeta):
    """Return max|x| with its time, max of the absolute acceleration, and the state at the end."""
    omega = 2 * math.pi / period
    state, best, absolute = np.zeros(2), (0.0, 0.0), 0.0

    def acceleration(t, k):
        part = (t - one.start[k]) / one.length[k]
        return np.polyval(one.terms[k][::-1], part)

    def field(t, y, k):
        return [y[1], -acceleration(t, k) - 2 * zeta * omega * y[1] - omega**2 * y[0]]

    def felt(y):
        return 2 * zeta * omega * y[1] + omega**2 * y[0]

    def turns(t, y, k):
        return y[1]

    def felt_turns(t, y, k):
        return 2 * zeta * omega * field(t, y, k)[1] + omega**2 * y[1]

    for k in range(one.start.size):
        state = state - [0.0, one.kick[k]]
        ends = one.start[k], one.start[k] + one.length[k]
        settings = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-15, "max_step": period / 20}
        found = solve_ivp(field, ends, state, args=(k,), events=[turns, felt_turns], **settings)
        after = found.y[:, -1]
        times = [ends[0], *found.t_events[0], ends[1]]
        for t, y in zip(times, [state, *found.y_events[0], after], strict=True):
            best = max(best, (abs(y[0]), -t))
        absolute = max(absolute, *(abs(felt(y)) for y in (state, *found.y_events[1], after)))
        state = after
    return best[0], -best[1], absolute, state


def test_answers_agree_with_an_integrator():
    found = largest(load(), T, ZETA, False)
    for k, (period, zeta) in enumerate(zip(T, ZETA, strict=True)):
        size, time, absolute, (x, rate) = reference(load(), period, zeta)
        assert found.values[0, k] == pytest.approx(size, rel=1e-10)
        assert found.times[0, k] == pytest.approx(time, abs=1e-6)
        assert found.values[1, k] == pytest.approx(absolute, rel=1e-10)
        assert found.envelope[k] == pytest.approx(math.hypot(x, rate * period / (2 * math.pi)), rel=1e-9)


def test_free_vibration_after_the_end_counts_where_the_floor_rests():
    longer = load(
        np.append(TERMS, np.zeros((1, 3)), axis=0),
        np.append(START, 2.3),
        np.append(LENGTH, 5.0),
        np.append(KICKS, 0.0),
    )
    rests, later = largest(load(), T, ZETA, True), largest(longer, T, ZETA, False)
    for name in ("values", "times"):
        np.testing.assert_allclose(getattr(rests, name), getattr(later, name), rtol=1e-8)
    assert (rests.times[0] > 2.3).any()
    assert (rests.times[0] < 2.3).any()
    only_later = largest(
        load(0 * TERMS, kick=np.array([0.0, 0.0, 0.0, 1.0]), length=1e-6 * LENGTH), T, ZETA, True
    )
    np.testing.assert_allclose(only_later.later, only_later.values[0], rtol=1e-12)


def test_groups_of_oscillators_keep_their_order():
    rng = np.random.default_rng(3)
    periods, damping = np.exp(rng.uniform(-3.0, 1.0, 700)), rng.uniform(0.0, 0.5, 700)
    together = largest(load(), periods, damping, True)
    for k in range(0, 700, 97):
        alone = largest(load(), periods[k : k + 1], damping[k : k + 1], True)
        assert together.values[0, k] == pytest.approx(alone.values[0][0], rel=1e-11)
        assert together.values[1, k] == pytest.approx(alone.values[1][0], rel=1e-11)


def test_a_peak_in_the_middle_of_a_piece_is_found():
    """A peak between the ends of a piece slightly exceeds an earlier peak at the end of a piece."""
    period, speed = 0.8, np.zeros(17)
    length = np.full(17, period / 8)
    length[8] = period / 16  # the peaks before this piece are at ends of pieces, those after it in the middle
    speed[[0, 8]] = 1.0, 0.002
    pulses = load(np.zeros((17, 1)), np.append(0.0, np.cumsum(length)[:-1]), length, speed)
    found = largest(pulses, np.array([period]), np.zeros(1), False)
    omega = 2 * math.pi / period
    np.testing.assert_allclose(found.values[:, 0], [1.002 / omega, 1.002 * omega], rtol=1e-12)


def test_a_peak_under_a_load_is_found_at_half_of_the_critical_damping():
    """The load increases slowly to 1, so that |q̈ + 2ζωq̇ + ω²q| is twice ω²|q| at the peak after the kick."""
    omega, h, ramp, count = 2 * math.pi, 1 / 32, 320, 337
    terms = np.zeros((count, 2))
    terms[:ramp] = np.stack([np.arange(ramp), np.ones(ramp)], axis=1) / ramp
    terms[ramp:, 0] = 1.0
    terms[-1, 0] -= omega * h
    kick = np.zeros(count)
    kick[-1] = -2.001 / omega
    one = load(terms, h * np.arange(count), np.full(count, h), kick)
    found, expected = (
        largest(y, np.ones(1), np.full(1, 0.5), False, responses=("acceleration",))
        for y in (one, one.divided(h / 64))
    )
    assert found.values[0, 0] == pytest.approx(expected.values[0, 0], rel=1e-10)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_turning_point_between_two_quarters_is_found(sign):
    series = np.zeros((SERIES_TERMS, 1))
    series[1:3, 0] = sign, -sign  # q = ±(τ/h)(1 − τ/h)
    piece, fraction = _turning_points(series)
    np.testing.assert_array_equal(piece, [0])
    np.testing.assert_array_equal(fraction, [0.5])


@pytest.mark.parametrize("index", [0, 1])
def test_one_response_is_that_of_both(index):
    both = largest(load(), T, ZETA, True, (load(2 * TERMS),))
    one = largest(load(), T, ZETA, True, (load(2 * TERMS),), responses=(RESPONSES[index],))
    for name in ("values", "times", "slopes"):
        np.testing.assert_array_equal(getattr(one, name)[0], getattr(both, name)[index])


def moving(p):
    """Return a load whose accelerations, velocity jump and event time depend on p."""
    event = 0.9 + 0.2 * p
    start, length = np.array([0.0, event]), np.array([event, 2.0 - event])
    before, after = (1 + p) * np.array([1.0, 2.0]), np.array([-0.5 + p, 1.5 * (1 - p)])
    terms = np.array(
        [[before[0], before[1] * event], [after[0] + after[1] * event, after[1] * (2.0 - event)]]
    )
    return load(terms, start, length, np.array([0.0, 0.4 * (1 + 3 * p)]))


@pytest.mark.parametrize("rests", [False, True])
def test_derivatives_agree_with_differences(rests):
    now = moving(0.0)
    event, rate = 0.9, 0.2
    slopes = np.array([[1.0, 2.0 * event], [1.0 - 1.5 * event, -1.5 * (2.0 - event)]])
    jump = now.terms[0].sum() - now.terms[1, 0]
    kick, times = np.array([0.0, jump * rate + 1.2]), np.array([0.0, rate])
    slope = Load(now.start, now.length, slopes, kick, now.kick * times, times)
    periods = np.array([0.05, 0.1, 0.3, 1.0, 2.0, 5.0])
    damping = np.array([0.3, 0.6, 0.05, 0.0, 0.05, 0.1])
    found = largest(now, periods, damping, rests, (slope,))
    ends = [largest(moving(h), periods, damping, rests) for h in (1e-6, -1e-6)]
    change = (ends[0].values - ends[1].values) / 2e-6
    np.testing.assert_allclose(found.slopes[:, 0], change, rtol=1e-6, atol=1e-9)


def test_an_answer_is_largest_just_before_a_kick():
    periods, damping, event, rate = np.array([1.0, 2.0]), np.array([0.5, 0.3]), 0.2, 0.3

    def braked(p):
        moved = event + rate * p
        terms = np.array([[-2.0 * (1 + p), 0.0], [0.0, 0.0]])
        return load(terms, np.array([0.0, moved]), np.array([moved, 1.0]), np.array([-0.05, 0.6]))

    now, times = braked(0.0), np.array([0.0, rate])
    slopes = np.array([[-2.0, 0.0], [0.0, 0.0]])
    slope = Load(now.start, now.length, slopes, np.array([0.0, -2.0 * rate]), now.kick * times, times)
    found = largest(now, periods, damping, False, (slope,))
    for k in range(2):
        assert found.values[1, k] == pytest.approx(reference(now, periods[k], damping[k])[2], rel=1e-10)
    first = load(*(y[:1] for y in (now.terms, now.start, now.length, now.kick)))
    alone = largest(first, periods, damping, False)
    np.testing.assert_allclose(found.values[1], alone.values[1], rtol=1e-12)
    change = (
        largest(braked(1e-6), periods, damping, False).values[1]
        - largest(braked(-1e-6), periods, damping, False).values[1]
    )
    np.testing.assert_allclose(found.slopes[1, 0], change / 2e-6, rtol=1e-6)


def test_short_pieces_find_no_larger_answers():
    rng = np.random.default_rng(5)
    periods, damping = np.exp(rng.uniform(-2.0, 1.0, 100)), rng.uniform(0.0, 0.6, 100)
    terms = rng.normal(size=(12, 4)) * np.array([1.0, 3.0, -9.0, 6.0])
    length = rng.uniform(0.05, 0.5, 12)
    kick = np.where(rng.uniform(size=12) < 0.4, rng.normal(size=12), 0.0)
    one = load(terms, np.cumsum(length) - length, length, kick)
    found, fine = (largest(y, periods, damping, False) for y in (one, one.divided(1e-3)))
    np.testing.assert_allclose(found.values[0], fine.values[0], rtol=1e-10)
    np.testing.assert_allclose(found.values[1], fine.values[1], rtol=1e-10)


def test_loads_divide_without_change():
    a = np.random.default_rng(1).normal(size=30)
    one = ground_load(a, 0.1)
    parts = one.divided(0.03)
    assert parts.start.size == 4 * 29
    np.testing.assert_allclose(parts.terms[:, 0], np.interp(parts.start, 0.1 * np.arange(30), a), atol=1e-14)
    assert parts.end == pytest.approx(one.end)
    assert one.divided(0.1) is one
