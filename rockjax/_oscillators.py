"""Largest responses of linear oscillators to a piecewise polynomial floor acceleration a, (L5) to (L8).

With z = ẋ − λ̄x and λ = −ζω + iω_d, the equation ẍ + 2ζωẋ + ω²x = −a becomes ż = λz − a, with one complex
unknown instead of two real ones, and a velocity jump Δv of the floor becomes z⁺ = z⁻ − Δv. The solution over
a piece is exact. The relative displacement x and the absolute acceleration 2ζωẋ + ω²x are responses of the
form q = Re(c z) with different complex factors c, so one search finds the largest value of either.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple, Self

import numpy as np

# Least number of pieces per period. Longer pieces are divided, so that few pieces contain a turning point.
PIECES_PER_PERIOD = 8
SERIES_TERMS = 18  # terms of power series in s = λh; enough for pieces of an eighth of a period
EXPONENTIAL = np.array([1 / math.factorial(j) for j in range(SERIES_TERMS)])  # coefficients of e^s
LANES = 512  # number of lanes, that is, of oscillators that are computed together
NEWTON_STEPS = 5  # iterations for a turning point, starting within a quarter of a piece
TIE_TOLERANCE = 1e-10  # relative difference below which peaks count as equal; the first peak is returned


class Load(NamedTuple):
    """A piecewise polynomial floor acceleration, or its derivative with respect to a parameter.

    - `start`, `length`: start and length h of the n pieces, contiguous and ascending, shape (n,) [s]
    - `terms`: coefficients c_k of a = Σ c_k (τ/h)^k, with the time τ from the start of the piece, shape
      (n, m+1) [m/s²]
    - `kick`: velocity jump Δv at the start of each piece, shape (n,) [m/s]
    - `shift`: Δv times `start_slope`, shape (n,)
    - `start_slope`: derivative of the start of each piece with respect to the parameter, shape (n,); zero
      for a load that is not a derivative
    """

    start: np.ndarray
    length: np.ndarray
    terms: np.ndarray
    kick: np.ndarray
    shift: np.ndarray
    start_slope: np.ndarray

    @property
    def end(self) -> float:
        """End of the last piece [s]."""
        return float(self.start[-1] + self.length[-1])

    def divided(self, longest: float) -> Self:
        """Return the same acceleration in pieces of at most `longest` [s]."""
        counts = np.maximum(np.ceil(self.length / longest * (1 - 1e-12)), 1).astype(int)
        if counts.max() == 1:
            return self
        parent = np.repeat(np.arange(counts.size), counts)  # index of the old piece that contains a new piece
        first_new = np.cumsum(counts) - counts
        index_in_parent = np.arange(parent.size) - np.repeat(first_new, counts)
        width = 1 / counts[parent]
        offset, degree = index_in_parent * width, self.terms.shape[1] - 1
        terms = self.terms[parent]
        # Taylor expansion about the start of each new piece.
        terms = np.stack(
            [
                width**k
                * sum(math.comb(i, k) * terms[:, i] * offset ** (i - k) for i in range(k, degree + 1))
                for k in range(degree + 1)
            ],
            axis=1,
        )
        length = self.length[parent] * width
        is_first = index_in_parent == 0
        at_start = (np.where(is_first, y[parent], 0.0) for y in (self.kick, self.shift, self.start_slope))
        return type(self)(self.start[parent] + index_in_parent * length, length, terms, *at_start)


class Peaks(NamedTuple):
    """Largest responses of N oscillators.

    - `displacement`: S_d = max|x|, shape (N,) [m]; `time`: time at which S_d is first reached [s]
    - `acceleration`: S_a, the largest absolute acceleration, (L6), shape (N,) [m/s²]
    - `slopes`: derivatives of S_d and S_a with respect to each parameter, shape (2, parameters, N)
    - `later`: largest |x| of free vibration after the end of the load, shape (N,) [m]
    - `envelope`: √(ẋ² + ω²x²)/ω at the end of the load, shape (N,) [m]
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
    """Return the largest responses of oscillators that start at rest relative to their floor, (L5)–(L8).

    - `load`: acceleration of the floor
    - `period`, `damping`: T_e > 0 [s] and ζ in [0, 1) [–] of N oscillators, shape (N,)
    - `rests`: True if the floor stays at rest after the end of the load; free vibration then counts as well
    - `slopes`: derivatives of the load with respect to parameters, in the same pieces
    """
    order = np.argsort(period)
    groups: list[Peaks] = []
    start = 0
    while start < order.size:
        group = order[start : start + LANES]
        shortest = float(period[group[0]])
        if load.length.max() > shortest / PIECES_PER_PERIOD:
            group = group[period[group] <= 2 * shortest]
        loads = [y.divided(shortest / PIECES_PER_PERIOD) for y in (load, *slopes)]
        groups.append(_largest(loads[0], loads[1:], period[group], damping[group], rests))
        start += group.size
    original_order = np.argsort(order)
    return Peaks(*(np.concatenate(y, axis=-1)[..., original_order] for y in zip(*groups, strict=True)))


def ground_load(acceleration: np.ndarray, dt: float) -> Load:
    """Return the load of a ground acceleration that is linear between samples and zero after the last one.

    - `acceleration`: samples, shape (n,), n ≥ 2 [m/s²]
    - `dt`: sampling interval [s]
    """
    count = acceleration.size - 1
    zeros = np.zeros(count)
    terms = np.stack([acceleration[:-1], np.diff(acceleration)], axis=1)
    return Load(dt * np.arange(count), np.full(count, dt), terms, zeros, zeros, zeros)


class _Oscillators(NamedTuple):
    """Constants of N oscillators, shape (N,)."""

    omega: np.ndarray  # ω
    zeta: np.ndarray  # ζ
    pole: np.ndarray  # λ

    @property
    def damped_frequency(self) -> np.ndarray:
        """ω_d [rad/s]."""
        return np.imag(self.pole)

    @property
    def factors(self) -> tuple[np.ndarray, np.ndarray]:
        """The factors c of x and of 2ζωẋ + ω²x."""
        omega, zeta = self.omega, self.zeta
        displacement = -1j / self.damped_frequency
        return displacement, 2 * zeta * omega + omega**2 * (1 - 2 * zeta**2) * displacement


def _oscillators(period: np.ndarray, damping: np.ndarray) -> _Oscillators:
    omega = 2 * math.pi / period
    return _Oscillators(omega, damping, omega * (-damping + 1j * np.sqrt(1 - damping**2)))


def _series(terms: np.ndarray) -> np.ndarray:
    """Return coefficients d_j with Σ c_k k! φ_{k+1}(s) = Σ d_j s^j, (L7), for j < `SERIES_TERMS`.

    - `terms`: coefficients c_k of n accelerations, shape (n, m+1); the result has shape (n, `SERIES_TERMS`)
    """
    factorials = [math.factorial(k) for k in range(terms.shape[1] + SERIES_TERMS)]
    weights = [
        [factorials[k] / factorials[j + k + 1] for j in range(SERIES_TERMS)] for k in range(terms.shape[1])
    ]
    return terms @ np.array(weights)


class _States(NamedTuple):
    """States z of N oscillators.

    - `starts`: z at the starts of the n pieces, after velocity jumps, and at the end; shape (n+1, N)
    - `kicks`: indices of the pieces that start with a velocity jump
    - `before`: z just before these jumps, shape (number of jumps, N)
    """

    starts: np.ndarray
    kicks: np.ndarray
    before: np.ndarray

    def at_end(self, piece: np.ndarray, lane: np.ndarray) -> np.ndarray:
        """Return z of lanes at the end of pieces, before the velocity jump that may follow."""
        index = np.searchsorted(self.kicks, piece + 1)
        is_kick = np.isin(piece + 1, self.kicks)
        before = self.before[np.where(is_kick, index, 0), lane] if self.kicks.size else 0.0
        return np.where(is_kick, before, self.starts[piece + 1, lane])


def _states(load: Load, pole: np.ndarray) -> _States:
    """Return the states of oscillators that start from rest. In the series of (L7), s^j = (λh)^j is the
    product of a power of λ h_max, the same for all pieces, and a power of h/h_max, the same for all
    oscillators."""
    longest, degrees = load.length.max(), np.arange(SERIES_TERMS)
    powers = ((pole * longest) ** degrees[:, None]).view(float)  # real and imaginary parts
    ratio = np.round(load.length / longest, 13)
    starts = np.zeros((ratio.size + 1, pole.size), complex)
    forced = -load.length[:, None] * ratio[:, None] ** degrees * _series(load.terms)
    np.matmul(forced, powers, out=starts[1:].view(float))
    ratios, length_index = np.unique(ratio, return_inverse=True)
    decay = (ratios[:, None] ** degrees * EXPONENTIAL @ powers).view(complex)
    kicks = np.flatnonzero((load.kick != 0) | (load.shift != 0))
    jumps = dict(zip(kicks.tolist(), load.kick[kicks, None] - pole * load.shift[kicks, None], strict=True))
    before, decayed = [], np.empty(pole.size, complex)
    for k, row in enumerate(length_index.tolist()):
        if k in jumps:
            before.append(starts[k].copy())
            starts[k] -= jumps[k]
        np.multiply(decay[row], starts[k], out=decayed)
        starts[k + 1] += decayed
    return _States(starts, kicks, np.array(before).reshape(kicks.size, pole.size))


class _Pairs(NamedTuple):
    """Pairs of a piece and an oscillator: z at the start of the piece, λ, c and the length of the piece,
    shape (k,), and the coefficients of the acceleration, shape (k, m+1)."""

    z: np.ndarray
    pole: np.ndarray
    factor: np.ndarray
    length: np.ndarray
    terms: np.ndarray

    def select(self, indices: np.ndarray) -> Self:
        return type(self)(*(y[indices] for y in self))

    def state(self, fraction: np.ndarray) -> np.ndarray:
        """Return z at a fraction τ/h of each piece, in [0, 1]."""
        s = self.pole * self.length * fraction
        powers = np.vander(fraction, self.terms.shape[1], increasing=True)
        forced = (self.length * fraction)[:, None] * _series(self.terms * powers)
        terms = EXPONENTIAL[:, None] * self.z - forced.T
        z = terms[-1]
        for term in terms[-2::-1]:
            z *= s
            z += term
        return z

    def value_and_rates(self, fraction: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return q and its first two derivatives with respect to τ/h, at a fraction τ/h of each piece."""
        z, degrees = self.state(fraction), np.arange(self.terms.shape[1])
        powers = np.vander(fraction, degrees.size, increasing=True)
        a = (self.terms * powers).sum(axis=1)
        slope = (self.terms[:, 1:] * degrees[1:] * powers[:, :-1]).sum(axis=1) / self.length
        rate = self.pole * z - a
        second = self.pole * rate - slope
        h = self.length
        return (
            np.real(self.factor * z),
            h * np.real(self.factor * rate),
            h * h * np.real(self.factor * second),
        )


def _turning_points(pairs: _Pairs) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of pairs whose response has a turning point, and the fraction τ/h of this point. A
    quarter of a piece has a turning point if the rate has different signs at its ends."""
    quarters = np.linspace(0.0, 1.0, 5)
    tiled = pairs.select(np.tile(np.arange(pairs.length.size), quarters.size))
    fractions = np.repeat(quarters, pairs.length.size)
    rates = tiled.value_and_rates(fractions)[1].reshape(quarters.size, -1)
    quarter, index = np.nonzero(rates[:-1] * rates[1:] < 0)
    turning, sign = pairs.select(index), np.sign(rates[quarter, index])
    low, high = quarters[quarter], quarters[quarter + 1]
    fraction = low + 0.25 * rates[quarter, index] / (rates[quarter, index] - rates[quarter + 1, index])
    for _ in range(NEWTON_STEPS):
        _, rate, second = turning.value_and_rates(fraction)
        low, high = np.where(sign * rate > 0, fraction, low), np.where(sign * rate > 0, high, fraction)
        step = fraction - rate / np.where(second == 0, np.inf, second)
        fraction = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
    return index, fraction


class _Peak(NamedTuple):
    """The largest |q| of each oscillator: q with its sign, and the piece and the fraction τ/h where it is
    first reached. Free vibration after the end counts as one more piece, whose `fraction` is the time since
    the end [s]."""

    value: np.ndarray
    piece: np.ndarray
    fraction: np.ndarray


def _response(factor: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return q = Re(c z)."""
    q = np.imag(z) * -np.imag(factor)
    return q if not np.real(factor).any() else q + np.real(z) * np.real(factor)


def _search(load: Load, oscillators: _Oscillators, factor: np.ndarray, states: _States) -> _Peak:
    """Return the peaks up to the end of the last piece. Only pieces that may contain a peak are searched."""
    size = np.abs(_response(factor, states.starts))
    before = np.abs(_response(factor, states.before))
    best = np.maximum(size.max(axis=0), before.max(axis=0, initial=0.0))
    # In a piece with a turning point, |q| is at most h²/8 max|q̈| larger than at the ends, and |q̇| ≤ h max|q̈|.
    # The load alone determines q̈ + 2ζωq̇ + ω²q, so a bound of this sum also bounds max|q̈|.
    h, omega, sizes = load.length, oscillators.omega, np.abs(load.terms)
    largest_load = (sizes.sum(axis=1) * h**2).max() * np.abs(np.real(factor * oscillators.pole))
    steepest = ((sizes @ np.arange(sizes.shape[1])) * h).max() * np.abs(np.real(factor))
    divisor = 8 * np.maximum(1 - 2 * oscillators.zeta * omega * h.max(), 0.2)
    min_size = (best - (largest_load + steepest) / divisor) / (1 + (omega * h.max()) ** 2 / divisor)
    size[0, :] = np.inf  # the first piece is always searched, and only this piece if all states are zero
    points, lanes = np.divmod(np.flatnonzero(size >= np.where(best > 0, min_size, np.inf)), omega.size)
    kick, kick_lanes = np.nonzero(before >= min_size)
    ends = states.kicks[kick] - 1
    piece, lane = np.concatenate([points, points - 1, ends]), np.concatenate([lanes, lanes, kick_lanes])
    is_piece = (piece >= 0) & (piece < h.size)
    indices = np.unique(piece[is_piece] * omega.size + lane[is_piece])
    piece, lane = np.unravel_index(indices, (h.size, omega.size))
    z = states.starts[piece, lane]
    pairs = _Pairs(z, oscillators.pole[lane], factor[lane], h[piece], load.terms[piece])
    index, fraction = _turning_points(pairs)
    inner = pairs.select(index).value_and_rates(fraction)[0]
    at_ends = _response(factor[lane], states.at_end(piece, lane))
    return _first_peak(
        np.concatenate([_response(factor[lane], z), inner, at_ends]),
        np.concatenate([lane, lane[index], lane]),
        np.concatenate([piece, piece[index], piece]),
        np.concatenate([np.zeros(piece.size), fraction, np.ones(piece.size)]),
        omega.size,
    )


def _first_peak(
    value: np.ndarray, lane: np.ndarray, piece: np.ndarray, fraction: np.ndarray, count: int
) -> _Peak:
    """Return the largest |value| of each lane; if several are equal, the first in time.

    - `value`, `lane`, `piece`, `fraction`: values q, with the lane, the piece and τ/h of each
    - `count`: number of lanes
    """
    size = np.zeros(count)
    np.maximum.at(size, lane, np.abs(value))
    tied = np.flatnonzero(np.abs(value) >= size[lane] * (1 - TIE_TOLERANCE))
    order = tied[np.lexsort((fraction[tied], piece[tied], lane[tied]))]
    first = order[np.unique(lane[order], return_index=True)[1]]
    return _Peak(value[first], piece[first], fraction[first])


def _next_turn(oscillators: _Oscillators, factor: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return q at the first turning point in free vibration from the state z, where |q| is largest, and the
    time until this point [s]."""
    angle = np.mod(0.5 * math.pi - np.angle(factor * oscillators.pole * z), math.pi)
    delay = angle / oscillators.damped_frequency
    return np.real(factor * z * np.exp(oscillators.pole * delay)), delay


def _largest(load: Load, slopes: list[Load], period: np.ndarray, damping: np.ndarray, rests: bool) -> Peaks:
    """Return the largest responses as `largest` does; pieces must be at most an eighth of every period."""
    oscillators = _oscillators(period, damping)
    pole, last = oscillators.pole, load.length.size
    states = _states(load, pole)
    slope_states = [_states(slope, pole) for slope in slopes]
    values, times, changes = [], [], []
    end = states.starts[-1]
    for factor in oscillators.factors:
        peak = _search(load, oscillators, factor, states)
        if rests:
            value, delay = _next_turn(oscillators, factor, end)
            is_later = np.abs(value) > np.abs(peak.value) * (1 + TIE_TOLERANCE)
            later_peak = value, np.full(period.size, last), delay
            peak = _Peak(*(np.where(is_later, a, b) for a, b in zip(later_peak, peak, strict=True)))
        piece = np.minimum(peak.piece, last - 1)
        at_fraction = load.start[piece] + load.length[piece] * peak.fraction
        time = np.where(peak.piece == last, load.end + peak.fraction, at_fraction)
        values.append(np.abs(peak.value))
        times.append(time)
        slope_of = functools.partial(_slope, load, oscillators, factor, states, peak)
        rows = [slope_of(*y) for y in zip(slopes, slope_states, strict=True)]
        changes.append(np.array(rows).reshape(len(slopes), period.size))
    factor = oscillators.factors[0]
    x = np.real(factor * end)
    rate = np.real(end) - damping * oscillators.omega * x
    later = np.abs(_next_turn(oscillators, factor, end)[0])
    envelope = np.hypot(rate / oscillators.omega, x)
    return Peaks(values[0], times[0], values[1], np.stack(changes), later, envelope)


def _slope(
    load: Load,
    oscillators: _Oscillators,
    factor: np.ndarray,
    states: _States,
    peak: _Peak,
    slope: Load,
    slope_states: _States,
) -> np.ndarray:
    """Return the derivative of the largest responses, (L8).

    - `load`, `oscillators`, `factor`: the load, N oscillators, and c of the response q = Re(c z)
    - `states`, `peak`: states of the oscillators under the load, and their largest |q|
    - `slope`, `slope_states`: derivative of the load with respect to a parameter, and states under it

    The derivative of a peak is the derivative of q at a fixed time. For a peak at an end of a piece, it also
    contains the rate of q times the derivative of the time of this end.
    """
    pole, lanes, last = oscillators.pole, np.arange(factor.size), load.length.size
    is_free, k = peak.piece == last, np.minimum(peak.piece, last - 1)  # in free vibration after the load
    at_start, at_end = ~is_free & (peak.fraction == 0), ~is_free & (peak.fraction == 1)
    fraction = np.where(is_free, 0.0, peak.fraction)
    pairs = _Pairs(slope_states.starts[k, lanes], pole, factor, load.length[k], slope.terms[k])
    z = np.where(at_end, slope_states.at_end(k, lanes), pairs.state(fraction))
    z = np.where(is_free, slope_states.starts[-1] * np.exp(pole * np.where(is_free, peak.fraction, 0.0)), z)
    state = np.where(at_end, states.at_end(k, lanes), states.starts[k, lanes])
    a = np.where(at_end, load.terms[k].sum(axis=1), load.terms[k, 0])
    start_slope = np.append(slope.start_slope, 0.0)[np.where(at_end, k + 1, k)]
    rate = np.real(factor * (pole * state - a)) * np.where(at_start | at_end, start_slope, 0.0)
    return np.sign(peak.value) * (np.real(factor * z) + rate)
