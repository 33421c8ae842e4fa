"""Largest responses of linear oscillators on a floor.

The acceleration a of the floor is a piecewise polynomial. The equations (L5) to (L8) are in docs/floors.md
and docs/equations.md. An oscillator has the displacement x relative to the floor [m], the circular frequency
ω [rad/s], the damping ratio ζ and the damped frequency ω_d = ω√(1 − ζ²). Its equation is ẍ + 2ζωẋ + ω²x = −a.
Let λ = −ζω + iω_d, with the conjugate λ̄. The complex unknown z = ẋ − λ̄x [m/s] replaces x and ẋ, and the
equation becomes ż = λz − a. A velocity jump Δv of the floor changes z by −Δv.

A piece is a time interval in which a is one polynomial. The solution over a piece is exact up to rounding.
Two responses are computed: x, and 2ζωẋ + ω²x, which is minus the absolute acceleration. Both have the form
q = Re(c z) with a complex factor c, and the same search finds the largest |q| of each.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial import polynomial

from rockjax._checks import array_module
from rockjax._excitations.sampled import common_size
from rockjax._programs.program import StoredProgram

# Least number of pieces per period T_e of an oscillator. Pieces longer than T_e/8 are divided, so that most
# pieces contain no turning point.
PIECES_PER_PERIOD = 8
# Number of terms of power series in s = λh, with the length h of a piece; enough for h up to T_e/8.
SERIES_TERMS = 16
EXPONENTIAL = np.array([1 / math.factorial(j) for j in range(SERIES_TERMS)])  # coefficients of e^s
# Largest number of oscillators (lanes) in a group. The shortest period of a group determines its pieces.
LANES = 256
FEW_LANES = 16  # groups are padded to this number of oscillators times a power of 4
PIECES_PER_BLOCK = 8  # number of pieces in a block; only states at the starts of blocks are stored
BLOCKS_PER_CALL = 32  # number of blocks that one call of the compiled program solves
PAIRS = 20_000  # largest number of pairs (block, oscillator) that are searched together
NEWTON_STEPS = 5  # iterations for a turning point, from a start in the same quarter of a piece
TIE_TOLERANCE = 1e-10  # relative difference below which peaks count as equal; the first one is returned


Response = Literal["displacement", "acceleration"]
RESPONSES: tuple[Response, ...] = ("displacement", "acceleration")  # x, and 2ζωẋ + ω²x


class Load(NamedTuple):
    """A piecewise polynomial floor acceleration, or its derivative with respect to a parameter.

    - `start`, `length`: start and length h of the n pieces, contiguous and ascending, shape (n,) [s]
    - `terms`: coefficients c_k of a = Σ c_k (τ/h)^k, with the time τ from the start of the piece, shape
      (n, m+1) [m/s²]
    - `kick`: velocity jump at the start of each piece, shape (n,) [m/s]: Δv for an acceleration, and
      Δv' − (a⁺ − a⁻)·`start_slope` for a derivative. Δv' is the derivative of Δv, and a⁻ and a⁺ are the floor
      accelerations just before and just after the start of the piece
    - `shift`: zero for an acceleration, and Δv·`start_slope` for a derivative, shape (n,) [m]
    - `start_slope`: zero for an acceleration; for a derivative, the derivative of the start of each piece
      with respect to the parameter, shape (n,) [s]

    At the start of a piece, z jumps by λ·`shift` − `kick`. For a derivative this is the jump (L8), which
    includes the effect of the start moving with the parameter. The units of a derivative, except those of
    `start` and `length`, are divided by the unit of the parameter.
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
        share = 1 / counts[parent]  # length of a new piece divided by the length of the old piece
        offset, degree = index_in_parent * share, self.terms.shape[1] - 1
        terms = self.terms[parent]
        # Taylor expansion about the start of each new piece.
        terms = np.stack(
            [
                share**k
                * sum(math.comb(i, k) * terms[:, i] * offset ** (i - k) for i in range(k, degree + 1))
                for k in range(degree + 1)
            ],
            axis=1,
        )
        length = self.length[parent] * share
        is_first = index_in_parent == 0
        at_start = (np.where(is_first, y[parent], 0.0) for y in (self.kick, self.shift, self.start_slope))
        return type(self)(self.start[parent] + index_in_parent * length, length, terms, *at_start)


class Peaks(NamedTuple):
    """Largest responses of N oscillators.

    - `values`: S_d = max|x| [m] and the largest absolute acceleration S_a [m/s²], (L6), or only the requested
      one, shape (responses, N)
    - `times`: times at which these values are first reached, shape (responses, N) [s]
    - `slopes`: derivatives of these values with respect to each parameter, shape (responses, parameters, N)
    - `later`: largest |x| of free vibration after the end of the load, shape (N,) [m]
    - `envelope`: √(ẋ² + ω²x²)/ω at the end of the load, shape (N,) [m]
    """

    values: np.ndarray
    times: np.ndarray
    slopes: np.ndarray
    later: np.ndarray
    envelope: np.ndarray


def largest(
    load: Load,
    period: np.ndarray,
    damping: np.ndarray,
    rests: bool,
    slopes: tuple[Load, ...] = (),
    responses: tuple[Response, ...] = RESPONSES,
) -> Peaks:
    """Return the largest responses of oscillators that start at rest relative to their floor.

    - `load`: acceleration of the floor
    - `period`, `damping`: T_e > 0 [s] and 0 ≤ ζ < 1 of N oscillators, shape (N,)
    - `rests`: True if the floor stays at rest after the end of the load; free vibration then counts as well
    - `slopes`: derivatives of the load with respect to parameters, in the same pieces
    - `responses`: names of the responses to return; the result has them in the order of `RESPONSES`
    """
    order = np.argsort(period)
    groups: list[Peaks] = []
    for first in range(0, order.size, LANES):
        group = order[first : first + LANES]
        loads = [y.divided(float(period[group[0]]) / PIECES_PER_PERIOD) for y in (load, *slopes)]
        groups.append(_largest(loads[0], loads[1:], period[group], damping[group], rests, responses))
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

    omega: Any  # ω
    zeta: Any  # ζ
    pole: Any  # λ

    @property
    def damped_frequency(self) -> Any:
        """ω_d [rad/s]."""
        return array_module(self.pole).imag(self.pole)

    @property
    def factors(self) -> tuple[Any, Any]:
        """The factors c of x and of 2ζωẋ + ω²x."""
        omega, zeta = self.omega, self.zeta
        displacement = -1j / self.damped_frequency
        return displacement, 2 * zeta * omega + omega**2 * (1 - 2 * zeta**2) * displacement


def _oscillators(period: Any, damping: Any) -> _Oscillators:
    omega, s = 2 * math.pi / period, array_module(damping).sqrt(1 - damping**2)
    return _Oscillators(omega, damping, omega * (-damping + 1j * s))


def _series(length: np.ndarray, terms: np.ndarray) -> np.ndarray:
    """Return the coefficients of powers of λ in e^(λh) and in −h Σ c_k k! φ_{k+1}(λh), (L7), up to the power
    `SERIES_TERMS` − 1.

    - `length`, `terms`: lengths h and coefficients c_k of n pieces, shapes (n,) and (n, m+1); the result has
      shape (2, n, `SERIES_TERMS`)
    """
    factorials = [math.factorial(k) for k in range(terms.shape[1] + SERIES_TERMS)]
    weights = [
        [factorials[k] / factorials[j + k + 1] for j in range(SERIES_TERMS)] for k in range(terms.shape[1])
    ]
    powers = polynomial.polyvander(length, SERIES_TERMS - 1)
    return np.stack([powers * EXPONENTIAL, powers * -length[:, None] * (terms @ np.array(weights))])


class _States(NamedTuple):
    """States z of N oscillators, and sizes of their responses.

    - `starts`: z at the start of each block of pieces, before a velocity jump, shape (blocks, N)
    - `end`: z at the end of the last piece, shape (N,)
    - `sizes`: largest |q| of each response at the ends of the pieces of a block, before and after velocity
      jumps, shape (responses, blocks, N)
    """

    starts: np.ndarray
    end: np.ndarray
    sizes: np.ndarray


def _states(load: Load, pole: np.ndarray, factors: tuple[np.ndarray, ...]) -> _States:
    """Return the states of oscillators that start from rest, and the sizes of the responses with the factors
    c = `factors`."""
    count, lanes, rows = pole.size, common_size(pole.size, FEW_LANES, 4), PIECES_PER_BLOCK * BLOCKS_PER_CALL
    padding = -load.length.size % rows
    # The compiled program gets complex numbers as pairs of real numbers. The number of oscillators is padded,
    # so that few programs are compiled.
    as_pairs = lambda y: np.pad(
        np.stack([np.real(y), np.imag(y)], axis=-2), [(0, 0)] * y.ndim + [(0, lanes - count)]
    )
    length, kick, shift = (np.pad(y, (0, padding)) for y in (load.length, load.kick, load.shift))
    series = _series(length, np.pad(load.terms, [(0, padding), (0, 0)]))
    powers = polynomial.polyvander(pole, SERIES_TERMS - 1).T
    constants = as_pairs(powers), as_pairs(np.reshape(factors, (-1, count)))
    state: Any = np.zeros((2, lanes))
    starts, sizes = [], []
    with jax.enable_x64(True):
        for first in range(0, kick.size, rows):
            part = slice(first, first + rows)
            state, *answers = _solve_blocks(state, series[:, part], kick[part], shift[part], *constants)
            starts.append(np.asarray(answers[0]))
            sizes.append(np.asarray(answers[1]))
    as_complex = lambda y: y[..., 0, :count] + 1j * y[..., 1, :count]
    all_sizes = np.concatenate(sizes)[..., :count].swapaxes(0, 1)
    return _States(as_complex(np.concatenate(starts)), as_complex(np.asarray(state)), all_sizes)


@StoredProgram
def _solve_blocks(state, series, kick, shift, powers, factors):
    """Return z after `BLOCKS_PER_CALL` blocks, z at the start of each block, and the largest |q| at the ends
    of the pieces of each block. Complex numbers are pairs of real numbers.

    - `state`: z of N oscillators at the start, shape (2, N)
    - `series`: coefficients from `_series`, shape (2, pieces, `SERIES_TERMS`)
    - `kick`, `shift`: jumps at the starts of the pieces, shape (pieces,)
    - `powers`: powers of λ, shape (`SERIES_TERMS`, 2, N)
    - `factors`: c of each response, shape (responses, 2, N)
    """
    decay, forced = jnp.einsum("apj,jcn->apcn", series, powers)
    pole = powers[1]

    def size(z):
        return jnp.abs(factors[:, 0] * z[0][None] - factors[:, 1] * z[1][None])

    def solve_block(z, pieces):
        start, largest = z, size(z)
        for decay, forced, kick, shift in zip(*pieces, strict=True):
            z = z[0] + shift * pole[0] - kick, z[1] + shift * pole[1]
            largest = jnp.maximum(largest, size(z))
            z = decay[0] * z[0] - decay[1] * z[1] + forced[0], decay[0] * z[1] + decay[1] * z[0] + forced[1]
            largest = jnp.maximum(largest, size(z))
        return z, (jnp.stack(start), largest)

    blocks = (
        y.reshape(BLOCKS_PER_CALL, PIECES_PER_BLOCK, *y.shape[1:]) for y in (decay, forced, kick, shift)
    )
    end, (starts, sizes) = jax.lax.scan(solve_block, tuple(state), tuple(blocks))
    return jnp.stack(end), starts, sizes


def _taylor(z: np.ndarray, pole: np.ndarray, length: np.ndarray, terms: np.ndarray) -> np.ndarray:
    """Return the coefficients Z_n of z = Σ Z_n (τ/h)^n in k pieces, shape (`SERIES_TERMS`, k). They follow
    from ż = λz − a.

    - `z`, `pole`, `length`: z at the start of each piece, λ, and the length h of the piece, shape (k,)
    - `terms`: coefficients c_n of the acceleration in each piece, shape (k, m+1)
    """
    coefficients = np.empty((SERIES_TERMS, z.size), complex)
    coefficients[0], s = z, pole * length
    for n in range(SERIES_TERMS - 1):
        rate = s * coefficients[n]
        if n < terms.shape[1]:
            rate -= length * terms[:, n]
        coefficients[n + 1] = rate / (n + 1)
    return coefficients


def _series_of_block(
    load: Load, z: np.ndarray, pole: np.ndarray, block: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Solve k blocks of pieces together: the first piece of every block, then the second piece of every
    block, and so on.

    - `z`, `pole`: z at the start of each block, before a velocity jump, and λ, shape (k,)
    - `block`: indices of the blocks in the load, shape (k,)

    Yields three arrays each time: the positions in `block` of the blocks that have such a piece (the last
    block of a load may have fewer pieces), the indices of the pieces in the load, and the coefficients of z
    in these pieces from `_taylor`.
    """
    index, z = np.arange(z.size), z.copy()
    for row in range(PIECES_PER_BLOCK):
        index = index[block[index] * PIECES_PER_BLOCK + row < load.length.size]
        piece, p = block[index] * PIECES_PER_BLOCK + row, pole[index]
        after = z[index] - load.kick[piece] + p * load.shift[piece]
        series = _taylor(after, p, load.length[piece], load.terms[piece])
        z[index] = series.sum(axis=0)
        yield index, piece, series


def _series_in_piece(load: Load, states: _States, pole: np.ndarray, piece: np.ndarray) -> np.ndarray:
    """Return the coefficients of z (see `_taylor`) in one piece for each oscillator; `piece` has the indices
    of these pieces in the load."""
    found = np.empty((SERIES_TERMS, piece.size), complex)
    block, lanes = piece // PIECES_PER_BLOCK, np.arange(piece.size)
    for index, reached, series in _series_of_block(load, states.starts[block, lanes], pole, block):
        is_here = reached == piece[index]
        found[:, index[is_here]] = series[:, is_here]
    return found


def _turning_points(series: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the turning points of a response as two arrays: the index of the piece and the fraction τ/h.

    - `series`: coefficients of the response q in powers of τ/h, in k pieces, shape (`SERIES_TERMS`, k)

    A turning point is found in a quarter of a piece if q̇ has different signs at the ends of the quarter; zero
    counts as positive.
    """
    quarters = np.linspace(0.0, 1.0, 5)
    rate = polynomial.polyder(series)
    rates = polynomial.polyvander(quarters, len(rate) - 1) @ rate
    grows = rates >= 0
    quarter, index = np.nonzero(grows[:-1] != grows[1:])
    rate, sign = rate[:, index], np.where(grows[quarter, index], 1, -1)
    second = polynomial.polyder(rate)
    low, high = quarters[quarter], quarters[quarter + 1]
    fraction = low + 0.25 * rates[quarter, index] / (rates[quarter, index] - rates[quarter + 1, index])
    for _ in range(NEWTON_STEPS):
        value, slope = (polynomial.polyval(fraction, y, tensor=False) for y in (rate, second))
        low, high = np.where(sign * value > 0, fraction, low), np.where(sign * value > 0, high, fraction)
        step = fraction - value / np.where(slope == 0, np.inf, slope)
        fraction = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
    return index, fraction


class _Peak(NamedTuple):
    """The largest |q| of each oscillator: the value of q at this peak, and the piece and the fraction τ/h at
    which the peak is first reached. The free vibration after the end of the load counts as one more piece,
    whose `fraction` is the time after this end [s]."""

    value: np.ndarray
    piece: np.ndarray
    fraction: np.ndarray


def _response(factor: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return q = Re(c z)."""
    q = np.imag(z) * -np.imag(factor)
    return q if not np.real(factor).any() else q + np.real(z) * np.real(factor)


def _search(
    load: Load, oscillators: _Oscillators, factor: np.ndarray, states: _States, sizes: np.ndarray
) -> _Peak:
    """Return the largest responses up to the end of the last piece. Only pieces that may contain the largest
    response of an oscillator are searched for turning points.

    - `load`, `oscillators`, `factor`: the load, N oscillators, and c of the response q = Re(c z)
    - `states`: states of the oscillators
    - `sizes`: largest |q| at the ends of the pieces of each block, shape (blocks, N)
    """
    best = sizes.max(axis=0)
    # A piece is searched if |q| at one of its ends is at least `min_size`. The equation ż = λz − a gives
    # q̈ + 2ζωq̇ + ω²q = Re(c λ̄) a − Re(c) ȧ. Let L be a bound of the right-hand side, and P the largest |q|. If
    # P is reached inside a piece of length h, then q̇ = 0 there. The derivative of e^(2ζωt) q̇ is
    # e^(2ζωt) (q̈ + 2ζωq̇), and |q̈ + 2ζωq̇| ≤ L + ω²P. At a time s ≤ h/2 before or after the peak, |q̇| is thus
    # at most e^(ζωh) (L + ω²P) s. With d = e^(ζωh) h²/8, |q| ≥ P − d (L + ω²P) at its nearer end.
    # Since P ≥ `best` and ω²d < 1, this is at least `min_size` = (1 − ω²d) `best` − d L.
    h, omega, terms = load.length, oscillators.omega, np.abs(load.terms)
    largest_load = (terms.sum(axis=1) * h**2).max() * np.abs(np.real(factor * oscillators.pole.conj()))
    steepest = ((terms @ np.arange(terms.shape[1])) * h).max() * np.abs(np.real(factor))
    growth = np.exp(oscillators.zeta * omega * h.max()) / 8  # d/h²
    min_size = (1 - growth * (omega * h.max()) ** 2) * best - growth * (largest_load + steepest)
    is_searched = sizes >= np.where(best > 0, min_size, np.inf)
    is_searched[0] = True  # the first block always, and only this block if all states are zero
    block, lane = np.nonzero(is_searched)
    peaks = []
    for first in range(0, block.size, PAIRS):
        blocks, block_lanes = block[first : first + PAIRS], lane[first : first + PAIRS]
        z, found = states.starts[blocks, block_lanes], []
        for index, pieces, series in _series_of_block(load, z, oscillators.pole[block_lanes], blocks):
            lanes = block_lanes[index]
            q = _response(factor[lanes], series)
            at_ends = np.maximum(np.abs(q[0]), np.abs(q.sum(axis=0)))
            near = np.flatnonzero((at_ends >= min_size[lanes]) | (pieces == 0))
            found.append((q[:, near], lanes[near], pieces[near]))
        q, lanes, pieces = (np.concatenate(y, axis=-1) for y in zip(*found, strict=True))
        turn, fraction = _turning_points(q)
        inner = polynomial.polyval(fraction, q[:, turn], tensor=False)
        peaks += [
            (q[0], lanes, pieces, np.zeros(lanes.size)),
            (inner, lanes[turn], pieces[turn], fraction),
            (q.sum(axis=0), lanes, pieces, np.ones(lanes.size)),
        ]
    value, lanes, pieces, fraction = map(np.concatenate, zip(*peaks, strict=True))
    return _first_peak(value, lanes, pieces, fraction, omega.size)


def _first_peak(
    value: np.ndarray, lane: np.ndarray, piece: np.ndarray, fraction: np.ndarray, count: int
) -> _Peak:
    """Return the largest |q| of each lane (oscillator); if several are equal, the first in time.

    - `value`, `lane`, `piece`, `fraction`: values of q, with the lane, the piece and τ/h of each value
    - `count`: number of lanes
    """
    size = np.zeros(count)
    np.maximum.at(size, lane, np.abs(value))
    tied = np.flatnonzero(np.abs(value) >= size[lane] * (1 - TIE_TOLERANCE))
    order = tied[np.lexsort((fraction[tied], piece[tied], lane[tied]))]
    first = order[np.unique(lane[order], return_index=True)[1]]
    return _Peak(value[first], piece[first], fraction[first])


def _delay(oscillators: _Oscillators, factor: Any, z: Any) -> Any:
    """Return the time from the state z to the next turning point of q in free vibration [s]."""
    xp = array_module(oscillators, factor, z)
    angle = xp.mod(0.5 * math.pi - xp.angle(factor * oscillators.pole * z), math.pi)
    return angle / oscillators.damped_frequency


def _next_turn(oscillators: _Oscillators, factor: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return q at the next turning point in free vibration from the state z, and the time until this point
    [s]. Later values of |q| are not larger."""
    delay = _delay(oscillators, factor, z)
    return np.real(factor * z * np.exp(oscillators.pole * delay)), delay


def next_turns(period: Any, damping: Any, x: Any, rate: Any) -> tuple[Any, Any]:
    """Return |x| [m] and |2ζωẋ + ω²x| [m/s²] at their next turning points in free vibration. The function can
    be compiled and differentiated by JAX.

    - `period`, `damping`: T_e [s] and ζ [–]
    - `x`, `rate`: displacement relative to the floor [m] and its rate ẋ [m/s] at the start
    """
    oscillators = _oscillators(period, damping)
    z = rate - jnp.conj(oscillators.pole) * x

    def largest_response(factor: Any) -> Any:
        # At the turning point q̇ is zero, so a change of the delay does not change q to first order.
        delay = jax.lax.stop_gradient(_delay(oscillators, factor, z))
        return jnp.abs(jnp.real(factor * z * jnp.exp(oscillators.pole * delay)))

    displacement, acceleration = map(largest_response, oscillators.factors)
    return displacement, acceleration


def _largest(
    load: Load,
    slopes: list[Load],
    period: np.ndarray,
    damping: np.ndarray,
    rests: bool,
    responses: tuple[Response, ...],
) -> Peaks:
    """Return the largest responses as `largest` does, for pieces of at most an eighth of every period."""
    oscillators = _oscillators(period, damping)
    pole, last = oscillators.pole, load.length.size
    requested = [response in responses for response in RESPONSES]
    factors = tuple(itertools.compress(oscillators.factors, requested))
    states = _states(load, pole, factors)
    slope_states = [_states(slope, pole, ()) for slope in slopes]
    values, times, changes = [], [], []
    end = states.end
    for factor, sizes in zip(factors, states.sizes, strict=True):
        peak = _search(load, oscillators, factor, states, sizes)
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
    return Peaks(np.stack(values), np.stack(times), np.stack(changes), later, envelope)


def _slope(
    load: Load,
    oscillators: _Oscillators,
    factor: np.ndarray,
    states: _States,
    peak: _Peak,
    slope: Load,
    slope_states: _States,
) -> np.ndarray:
    """Return the derivative of the largest responses with respect to a parameter, (L8).

    - `load`, `oscillators`, `factor`: the load, N oscillators, and c of the response q = Re(c z)
    - `states`, `peak`: states of the oscillators under the load, and their largest |q|
    - `slope`, `slope_states`: derivative of the load with respect to a parameter, and states under this
      derivative

    The derivative of a peak is the derivative of q at a fixed time. If the peak is at an end of a piece, q̇
    times the derivative of the time of this end is added.
    """
    pole, last = oscillators.pole, load.length.size
    is_free, k = peak.piece == last, np.minimum(peak.piece, last - 1)  # in free vibration after the load
    at_start, at_end = ~is_free & (peak.fraction == 0), ~is_free & (peak.fraction == 1)
    fraction = np.where(is_free, 0.0, peak.fraction)
    series = _series_in_piece(load, states, pole, k)
    slope_series = _series_in_piece(slope, slope_states, pole, k)
    z = polynomial.polyval(fraction, slope_series, tensor=False)
    z = np.where(is_free, slope_states.end * np.exp(pole * np.where(is_free, peak.fraction, 0.0)), z)
    state = np.where(at_end, series.sum(axis=0), series[0])
    a = np.where(at_end, load.terms[k].sum(axis=1), load.terms[k, 0])
    start_slope = np.append(slope.start_slope, 0.0)[np.where(at_end, k + 1, k)]
    rate = np.real(factor * (pole * state - a)) * np.where(at_start | at_end, start_slope, 0.0)
    return np.sign(peak.value) * (np.real(factor * z) + rate)
