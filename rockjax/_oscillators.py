"""Largest answers of linear oscillators to an acceleration that is a polynomial in pieces, (L5) to (L8).

With z = ẋ − λ̄x and λ = −ζω + iω_d, the equation ẍ + 2ζωẋ + ω²x = −a becomes ż = λz − a, z⁺ = z⁻ − Δv:
one complex unknown instead of two real ones. Over a piece of length h its solution is exact. Both answers
are q = Re(c z) with a complex number c, so the same search finds the largest value of either.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple, Self

import numpy as np

# Smallest number of pieces in a period. Longer pieces are divided, so that answers turn rarely in one.
PIECES = 8
TERMS = 18  # of the series of φ_k; on pieces of an eighth of a period they are exact to rounding
LANES = 512  # number of oscillators that are computed together
NEWTON = 5  # iterations to the root of the rate of an answer, from a quarter of a piece
TIED = 1e-10  # relative difference of equal peaks, of which the first counts


class Load(NamedTuple):
    """The acceleration of a floor in pieces, or the derivative of one with respect to a parameter.

    - `start`, `length`: of the n pieces, contiguous and ascending [s]
    - `terms`: coefficients c_k of a = Σ c_k (τ/h)^k, shape (n, m+1) [m/s²]
    - `kick`: jump of velocity Δv at the start of each piece, shape (n,) [m/s]
    - `shift`: Δv times the derivative of its time; `moved`: derivatives of the times at which pieces start,
      both zero except in derivatives
    """

    start: np.ndarray
    length: np.ndarray
    terms: np.ndarray
    kick: np.ndarray
    shift: np.ndarray
    moved: np.ndarray

    @property
    def end(self) -> float:
        """End of the last piece [s]."""
        return float(self.start[-1] + self.length[-1])

    def divided(self, longest: float) -> Self:
        """Return the same acceleration in pieces of at most `longest` [s]."""
        parts = np.maximum(np.ceil(self.length / longest * (1 - 1e-12)), 1).astype(int)
        if parts.max() == 1:
            return self
        which = np.repeat(np.arange(parts.size), parts)
        number = np.arange(which.size) - np.repeat(np.cumsum(parts) - parts, parts)
        share = 1 / parts[which]
        place, degree = number * share, self.terms.shape[1] - 1
        terms = self.terms[which]
        # Taylor expansion about the start of each part.
        terms = np.stack(
            [
                share**k * sum(math.comb(i, k) * terms[:, i] * place ** (i - k) for i in range(k, degree + 1))
                for k in range(degree + 1)
            ],
            axis=1,
        )
        length = self.length[which] * share
        first = number == 0
        at_start = (np.where(first, y[which], 0.0) for y in (self.kick, self.shift, self.moved))
        return type(self)(self.start[which] + number * length, length, terms, *at_start)


class Peaks(NamedTuple):
    """Largest answers of N oscillators.

    - `displacement`: S_d = max|x| [m], first reached at `time` [s]; `acceleration`: S_a [m/s²], (L6)
    - `slopes`: derivatives of both with respect to q parameters, shape (2, q, N)
    - `later`: largest |x| of free vibration after the end [m]; `envelope`: √(ẋ² + ω²x²)/ω then [m]
    """

    displacement: np.ndarray
    time: np.ndarray
    acceleration: np.ndarray
    slopes: np.ndarray
    later: np.ndarray
    envelope: np.ndarray


def largest(
    load: Load, period: np.ndarray, damping: np.ndarray, rests: bool, slopes: tuple[Load, ...] = ()
) -> Peaks:
    """Return the largest answers of oscillators, from rest relative to their floor at the start, (L5)–(L8).

    - `load`: acceleration of the floor
    - `period`, `damping`: T_e > 0 [s] and ζ in [0, 1) [–] of N oscillators, shape (N,)
    - `rests`: whether the floor rests for good after the end, so that free vibration counts
    - `slopes`: derivatives of the load with respect to parameters, in the same pieces
    """
    order = np.argsort(period)
    found: list[Peaks] = []
    while sum(peaks.time.size for peaks in found) < order.size:
        ahead = order[sum(peaks.time.size for peaks in found) :][:LANES]
        shortest = float(period[ahead[0]])
        if load.length.max() > shortest / PIECES:
            ahead = ahead[period[ahead] <= 2 * shortest]
        loads = [each.divided(shortest / PIECES) for each in (load, *slopes)]
        found.append(_largest(loads[0], loads[1:], period[ahead], damping[ahead], rests))
    back = np.argsort(order)
    return Peaks(*(np.concatenate(parts, axis=-1)[..., back] for parts in zip(*found, strict=True)))


def ground_load(acceleration: np.ndarray, dt: float) -> Load:
    """Return a ground acceleration that is linear between samples, zero after the last.

    - `acceleration`: samples, shape (n,), n ≥ 2 [m/s²]
    - `dt`: sampling interval [s]
    """
    count = acceleration.size - 1
    none = np.zeros(count)
    terms = np.stack([acceleration[:-1], np.diff(acceleration)], axis=1)
    return Load(dt * np.arange(count), np.full(count, dt), terms, none, none, none)


class _Oscillators(NamedTuple):
    omega: np.ndarray
    zeta: np.ndarray
    pole: np.ndarray  # λ

    @property
    def damped(self) -> np.ndarray:
        return np.imag(self.pole)

    @property
    def answers(self) -> tuple[np.ndarray, np.ndarray]:
        """The numbers c of x and of 2ζωẋ + ω²x."""
        omega, zeta = self.omega, self.zeta
        displacement = -1j / self.damped
        return displacement, 2 * zeta * omega + omega**2 * (1 - 2 * zeta**2) * displacement


def _of(period: np.ndarray, damping: np.ndarray) -> _Oscillators:
    omega = 2 * math.pi / period
    return _Oscillators(omega, damping, omega * (-damping + 1j * np.sqrt(1 - damping**2)))


def _integrals(s: np.ndarray, degree: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return e^s, and k! φ_{k+1}(s) for k = 0 … degree, (L7). The highest is a series; the others follow
    from it without cancellation."""
    phi = np.zeros_like(s)
    for j in reversed(range(TERMS)):
        phi = phi * s + 1 / math.factorial(j + degree + 1)
    found = [math.factorial(degree) * phi]
    for k in reversed(range(degree)):
        phi = 1 / math.factorial(k + 1) + s * phi
        found.append(math.factorial(k) * phi)
    return 1 + s * phi, found[::-1]


class _States(NamedTuple):
    """States z of N oscillators: `starts` of the n pieces after their kicks, and at the end, shape (n+1, N);
    `kicks`: pieces that start with a kick; `before`: z before these, shape (number of kicks, N)."""

    starts: np.ndarray
    kicks: np.ndarray
    before: np.ndarray

    def at_end(self, piece: np.ndarray, lane: np.ndarray) -> np.ndarray:
        """Return z at the end of pieces."""
        number = np.searchsorted(self.kicks, piece + 1)
        is_kick = np.isin(piece + 1, self.kicks)
        before = self.before[np.where(is_kick, number, 0), lane] if self.kicks.size else 0.0
        return np.where(is_kick, before, self.starts[piece + 1, lane])


def _states(load: Load, pole: np.ndarray) -> _States:
    """Return the states of oscillators that start from rest."""
    grid = 1e-13 * load.length.max()
    lengths, which = np.unique(np.round(load.length / grid), return_inverse=True)
    lengths = (grid * lengths)[:, None]
    decay, integrals = _integrals(pole * lengths, load.terms.shape[1] - 1)
    weights = np.stack(integrals, axis=1) * -lengths[..., None]
    starts = np.empty((which.size + 1, pole.size), complex)
    forced = starts[1:].view(float)  # real and imaginary parts
    order = np.argsort(which, kind="stable")
    ends = np.cumsum(np.bincount(which))
    for weight, first, last in zip(weights.view(float), [0, *ends[:-1]], ends, strict=True):
        row = slice(None) if last - first == which.size else order[first:last]
        forced[row] = load.terms[row] @ weight
    kicks = np.flatnonzero((load.kick != 0) | (load.shift != 0))
    jumps = dict(zip(kicks.tolist(), load.kick[kicks, None] - pole * load.shift[kicks, None], strict=True))
    before, z, decayed = [], np.zeros(pole.size, complex), np.empty(pole.size, complex)
    starts[0] = 0
    for k, number in enumerate(which.tolist()):
        if k in jumps:
            before.append(starts[k].copy())
            starts[k] -= jumps[k]
        z = starts[k + 1]
        np.multiply(decay[number], starts[k], out=decayed)
        z += decayed
    return _States(starts, kicks, np.array(before).reshape(kicks.size, pole.size))


class _Places(NamedTuple):
    """Pieces of oscillators: z at the start, λ, c, and the acceleration, all of shape (k,) or (k, m+1)."""

    z: np.ndarray
    pole: np.ndarray
    answer: np.ndarray
    length: np.ndarray
    terms: np.ndarray

    def chosen(self, which: np.ndarray) -> Self:
        return type(self)(*(y[which] for y in self))

    def state(self, part: np.ndarray) -> np.ndarray:
        """Return z at a part of each piece, in [0, 1]."""
        decay, integrals = _integrals(self.pole * self.length * part, self.terms.shape[1] - 1)
        load = sum(self.terms[:, k] * part**k * y for k, y in enumerate(integrals))
        return decay * self.z - self.length * part * load

    def value_and_rates(self, part: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return q, and its first two derivatives in τ/h."""
        z, powers = self.state(part), range(self.terms.shape[1])
        a = sum(self.terms[:, k] * part**k for k in powers)
        slope = sum((k * self.terms[:, k] * part ** (k - 1) for k in powers[1:]), 0.0 * a) / self.length
        rate = self.pole * z - a
        second = self.pole * rate - slope
        h = self.length
        return (
            np.real(self.answer * z),
            h * np.real(self.answer * rate),
            h * h * np.real(self.answer * second),
        )


def _turns(places: _Places) -> tuple[np.ndarray, np.ndarray]:
    """Return which pieces have a turn of their answer inside a quarter, and the part of the piece where."""
    quarters = np.linspace(0.0, 1.0, 5)
    rates = np.array([places.value_and_rates(np.full(places.length.shape, y))[1] for y in quarters])
    quarter, which = np.nonzero(rates[:-1] * rates[1:] < 0)
    here, sign = places.chosen(which), np.sign(rates[quarter, which])
    low, high = quarters[quarter], quarters[quarter + 1]
    part = low + 0.25 * rates[quarter, which] / (rates[quarter, which] - rates[quarter + 1, which])
    for _ in range(NEWTON):
        _, rate, second = here.value_and_rates(part)
        low, high = np.where(sign * rate > 0, part, low), np.where(sign * rate > 0, high, part)
        step = part - rate / np.where(second == 0, np.inf, second)
        part = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
    return which, part


class _Found(NamedTuple):
    """The largest |q| of each oscillator: value with its sign, and the piece and part where it is first
    reached. Free vibration after the end counts as one more piece, and `part` is then its duration [s]."""

    value: np.ndarray
    piece: np.ndarray
    part: np.ndarray


def _answer(answer: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return q = Re(c z)."""
    found = np.imag(z) * -np.imag(answer)
    return found if not np.real(answer).any() else found + np.real(z) * np.real(answer)


def _search(load: Load, oscillators: _Oscillators, answer: np.ndarray, states: _States) -> _Found:
    """Return the largest answers up to the end of the last piece."""
    size = np.abs(_answer(answer, states.starts))
    before = np.abs(_answer(answer, states.before))
    best = np.maximum(size.max(axis=0), before.max(axis=0, initial=0.0))
    # A piece with a turn can exceed its ends by h²/8 max|q̈| at most. There |q̇| ≤ h max|q̈|, and
    # q̈ + 2ζωq̇ + ω²q is a load known in advance.
    h, omega, sizes = load.length, oscillators.omega, np.abs(load.terms)
    largest_load = (sizes.sum(axis=1) * h**2).max() * np.abs(np.real(answer * oscillators.pole))
    steepest = ((sizes @ np.arange(sizes.shape[1])) * h).max() * np.abs(np.real(answer))
    room = 8 * np.maximum(1 - 2 * oscillators.zeta * omega * h.max(), 0.2)
    least = (best - (largest_load + steepest) / room) / (1 + (omega * h.max()) ** 2 / room)
    size[0, :] = np.inf  # the first piece is always looked at
    points, lanes = np.nonzero((size >= least) & ((best > 0) | np.isinf(size)))
    kick, of_kick = np.nonzero(before >= least)
    ends = states.kicks[kick] - 1
    piece, lane = np.concatenate([points, points - 1, ends]), np.concatenate([lanes, lanes, of_kick])
    inside = (piece >= 0) & (piece < h.size)
    piece, lane = np.unravel_index(np.unique(piece[inside] * omega.size + lane[inside]), (h.size, omega.size))
    z = states.starts[piece, lane]
    places = _Places(z, oscillators.pole[lane], answer[lane], h[piece], load.terms[piece])
    which, part = _turns(places)
    inner = places.chosen(which).value_and_rates(part)[0]
    none, one = np.zeros(piece.size), np.ones(piece.size)
    last = _answer(answer[lane], states.at_end(piece, lane))
    return _first(
        np.concatenate([_answer(answer[lane], z), inner, last]),
        np.concatenate([lane, lane[which], lane]),
        np.concatenate([piece, piece[which], piece]),
        np.concatenate([none, part, one]),
        omega.size,
    )


def _first(value: np.ndarray, lane: np.ndarray, piece: np.ndarray, part: np.ndarray, count: int) -> _Found:
    """Return the first of the largest |values| of each lane."""
    most = np.zeros(count)
    np.maximum.at(most, lane, np.abs(value))
    tied = np.flatnonzero(np.abs(value) >= most[lane] * (1 - TIED))
    order = tied[np.lexsort((part[tied], piece[tied], lane[tied]))]
    first = order[np.unique(lane[order], return_index=True)[1]]
    return _Found(value[first], piece[first], part[first])


def _next_turn(oscillators: _Oscillators, answer: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return q at its first turn in free vibration from the state z, where it is largest, and the time until
    then [s]."""
    angle = np.mod(0.5 * math.pi - np.angle(answer * oscillators.pole * z), math.pi)
    delay = angle / oscillators.damped
    return np.real(answer * z * np.exp(oscillators.pole * delay)), delay


def _largest(load: Load, slopes: list[Load], period: np.ndarray, damping: np.ndarray, rests: bool) -> Peaks:
    oscillators = _of(period, damping)
    pole, last = oscillators.pole, load.length.size
    states = _states(load, pole)
    moved_states = [_states(each, pole) for each in slopes]
    values, times, changes = [], [], []
    end = states.starts[-1]
    for answer in oscillators.answers:
        found = _search(load, oscillators, answer, states)
        if rests:
            value, delay = _next_turn(oscillators, answer, end)
            later = np.abs(value) > np.abs(found.value) * (1 + TIED)
            new = value, np.full(period.size, last), delay
            found = _Found(*(np.where(later, a, b) for a, b in zip(new, found, strict=True)))
        inside = np.minimum(found.piece, last - 1)
        time = np.where(
            found.piece == last, load.end + found.part, load.start[inside] + load.length[inside] * found.part
        )
        values.append(np.abs(found.value))
        times.append(time)
        slope_of = functools.partial(_slope, load, oscillators, answer, states, found)
        pairs = zip(slopes, moved_states, strict=True)
        changes.append(np.array([slope_of(*pair) for pair in pairs]).reshape(len(slopes), period.size))
    answer = oscillators.answers[0]
    x = np.real(answer * end)
    rate = np.real(end) - damping * oscillators.omega * x
    later = np.abs(_next_turn(oscillators, answer, end)[0])
    envelope = np.hypot(rate / oscillators.omega, x)
    return Peaks(values[0], times[0], values[1], np.stack(changes), later, envelope)


def _slope(
    load: Load,
    oscillators: _Oscillators,
    answer: np.ndarray,
    states: _States,
    found: _Found,
    slope: Load,
    moved_states: _States,
) -> np.ndarray:
    """Return the derivative of the largest answers, (L8): that at a fixed time, and the rate times the
    derivative of the time for a peak at an end of a piece that moves."""
    pole, lanes, last = oscillators.pole, np.arange(answer.size), load.length.size
    free, k = found.piece == last, np.minimum(found.piece, last - 1)
    at_start, at_end = ~free & (found.part == 0), ~free & (found.part == 1)
    part = np.where(free, 0.0, found.part)
    places = _Places(moved_states.starts[k, lanes], pole, answer, load.length[k], slope.terms[k])
    z = np.where(at_end, moved_states.at_end(k, lanes), places.state(part))
    z = np.where(free, moved_states.starts[-1] * np.exp(pole * np.where(free, found.part, 0.0)), z)
    state = np.where(at_end, states.at_end(k, lanes), states.starts[k, lanes])
    a = np.where(at_end, load.terms[k].sum(axis=1), load.terms[k, 0])
    moved = np.append(slope.moved, 0.0)[np.where(at_end, k + 1, k)]
    rate = np.real(answer * (pole * state - a)) * np.where(at_start | at_end, moved, 0.0)
    return np.sign(found.value) * (np.real(answer * z) + rate)
