import functools
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import rockjax as rj
from rockjax._excitations import pulses
from rockjax._excitations.ground import SharedPieces
from rockjax._excitations.names import PULSE_CLASSES
from rockjax._excitations.piecewise import DEGREE, PiecewiseMotion
from rockjax._excitations.pulses import BETA
from rockjax._problem import models
from tests.scenes import shaking

PULSES = [rj.Ricker, rj.AntisymmetricRicker, rj.OneSine, rj.OneCosine, rj.HalfSine]
MOTIONS = [
    *(pulse(a_p=3.0, T_p=0.8) for pulse in PULSES),
    rj.Ricker(-3.0, 0.8),
    rj.MavroeidisPapageorgiou(A=0.5, f_p=1.2, gamma=2.3, nu=0.7),
    rj.Gabor(a_p=3.0, T_p=0.8, gamma=3.0, phi=0.4),
    shaking(100),
]
LABELS = [type(m).__name__ + ("-negative" if k == 5 else "") for k, m in enumerate(MOTIONS)]


def grid(motion, n=40001, over=0.2):
    start, end = (float(t) for t in motion.support)
    return np.linspace(start - over, end + over, n)


@pytest.mark.parametrize("pulse", PULSES)
def test_amplitude_and_support(pulse):
    motion = pulse(a_p=3.0, T_p=0.8)
    a = np.abs(np.asarray(motion(grid(motion))))
    assert a.max() == pytest.approx(3.0, rel=1e-6)
    start, end = (float(t) for t in motion.support)
    outside = np.asarray(motion(np.array([start - 1e-3, end + 1e-3])))
    assert np.all(np.abs(outside) <= 3e-18 * 3.0)


def test_formulas_of_the_paper():
    """Eq. (32)."""
    t, T = np.linspace(-1.5, 1.5, 7), 0.9
    x = 2 * np.pi**2 * t**2 / T**2
    np.testing.assert_allclose(rj.Ricker(2.0, T)(t), 2.0 * (1 - x) * np.exp(-x / 2), rtol=1e-12)
    y = 4 * np.pi**2 * t**2 / (3 * T**2)
    expected = 2.0 / 1.380119 * (y - 3) * 2 * np.pi * t / (np.sqrt(3) * T) * np.exp(-y / 2)
    np.testing.assert_allclose(rj.AntisymmetricRicker(2.0, T)(t), expected, rtol=1e-6)
    assert pytest.approx(1.380119, abs=5e-7) == BETA


def test_derivative_of_the_velocity_pulse():
    A, f, gamma, nu = 0.5, 1.2, 2.3, 0.7
    motion = rj.MavroeidisPapageorgiou(A, f, gamma, nu)
    w = 2 * np.pi * f
    velocity = lambda t: 0.5 * A * (1 + jnp.cos(w * t / gamma)) * jnp.cos(w * t + nu)
    t = jnp.linspace(-0.9, 0.9, 11)
    np.testing.assert_allclose(motion(t), jax.vmap(jax.grad(velocity))(t), rtol=1e-12)


@pytest.mark.parametrize("pulse", PULSES)
def test_tables_of_a_shape(pulse):
    """Antiderivative, zeros and turning points, which the lookahead uses."""
    tau = np.linspace(*pulse.span, 9)[1:-1]
    rate = jax.vmap(jax.grad(lambda z: jnp.asarray(pulse.velocity(z))))(jnp.asarray(tau))
    np.testing.assert_allclose(rate, pulse.shape(tau), atol=1e-12)
    slope = jax.grad(lambda z: jnp.asarray(pulse.shape(z)))
    for z in pulse.turning:
        assert abs(float(slope(jnp.asarray(z)))) < 1e-11
    for z in pulse.zeros:
        assert abs(float(pulse.shape(np.float64(z)))) < 1e-12


@pytest.mark.parametrize("pulse", PULSES)
def test_a_pulse_passes_a_threshold_to_rounding(pulse):
    """Thresholds between the two ends of each monotone interval, up to the flat maximum."""
    knots = np.asarray(pulse.knots())
    tops = np.abs(pulse.shape(knots))
    rng = np.random.default_rng(0)
    levels = np.concatenate(
        [rng.random(300), *(top * (1 - 10.0 ** rng.uniform(-15, -1, 200)) for top in tops[tops > 1e-9])]
    )
    lookahead = jax.jit(jax.vmap(lambda level: pulse(1.0, 1.0).lookahead(level)))(jnp.asarray(levels))
    s = lambda z: np.abs(pulse.shape(np.asarray(z)))
    passed = 0
    for k, (left, right) in enumerate(itertools.pairwise(knots)):
        # The motion is above the threshold before one time and after the other.
        for roots, side in ((lookahead.lead, -1), (lookahead.trail, 1)):
            root = np.asarray(roots)[:, k]
            inside = (root > left) & (root < right)
            z, level = root[inside], levels[inside]
            slope = np.abs(s(z + 1e-6) - s(z - 1e-6)) / 2e-6
            before = np.clip(z - 1e-14 - 4e-15 / np.maximum(slope, 1e-7), left, right)
            assert (side * (s(z) - level) >= -1e-15).all()
            assert (side * (s(before) - level) <= 1e-15).all()
            passed += z.size
    assert passed > 500


@pytest.mark.parametrize("motion", MOTIONS, ids=LABELS)
def test_lookahead_is_true(motion):
    """Exceedances, remaining impulse and remaining peak agree with the motion."""
    start, end = (float(t) for t in motion.support)
    times = grid(motion, over=0.0)
    a = np.abs(np.asarray(motion(times)))
    for level in (0.05, 0.3, 0.7, 0.95, 1.1):
        lookahead = motion.lookahead(jnp.asarray(level * a.max()))
        following = jax.jit(lambda t, o=lookahead: o.next_exceedance(t, motion.locate(t)))
        for t in np.linspace(start - 0.1, end - 1e-9, 23):
            found = float(following(jnp.asarray(t)))
            later = (times >= t) & (a > level * a.max())
            if not later.any():
                assert math.isinf(found)
                continue
            assert found >= t
            assert found <= times[later][0] + 1e-9
            assert found >= times[later][0] - (times[1] - times[0]) - 1e-9
            assert abs(float(motion(found))) >= level * a.max() * (1 - 1e-12)
    lookahead, exceeding = motion.lookahead(None), motion.lookahead(jnp.asarray(0.5 * a.max()))
    for t in np.linspace(start, end, 12)[:-1]:
        piece = motion.locate(jnp.asarray(t))
        rest = times >= t
        area = np.trapezoid(a[rest], times[rest])
        assert float(lookahead.impulse(jnp.asarray(t), piece)) >= area * (1 - 1e-3)
        now = jnp.abs(motion(t))
        assert float(lookahead.peak(jnp.asarray(t), piece, now)) >= a[rest].max() * (1 - 1e-9)
        highest = float(exceeding.highest_time(jnp.asarray(t), jnp.asarray(np.inf)))
        assert abs(float(motion(highest))) >= a[rest].max() * (1 - 1e-9)
    after = jnp.asarray(end + 1.0)
    assert float(lookahead.impulse(after, motion.locate(after))) < 1e-15
    assert float(lookahead.peak(after, motion.locate(after), jnp.abs(motion(after)))) < 1e-15


@pytest.mark.parametrize("level", [None, 0], ids=["usual", "not optimised"])
@pytest.mark.parametrize("kind", ["wavelet", "pair"])
def test_a_search_ends_however_it_is_compiled(kind, level):
    """The search of a wavelet ends for every rounding at a crossing, which depends on the compiler and its
    optimisation level."""
    wavelet = rj.MavroeidisPapageorgiou(A=0.5, f_p=1.2, gamma=2.3, nu=0.7)
    motion = wavelet if kind == "wavelet" else rj.GroundMotion(wavelet, shaking(100))
    highest = float(np.abs(np.asarray(wavelet(grid(wavelet, over=0.0)))).max())
    tilt = () if kind == "wavelet" else (jnp.asarray(0.2),)
    options = None if level is None else {"xla_backend_optimization_level": level}

    start, end = (float(t) for t in wavelet.support)
    for share in (0.3, 0.7):
        lookahead = motion.lookahead(jnp.asarray(share * highest), *tilt)

        @functools.partial(jax.jit, compiler_options=options)
        def following(t, lookahead=lookahead):
            return lookahead.next_exceedance(t, motion.locate(t))

        for t in np.linspace(start - 0.1, end - 1e-9, 23):
            found = float(following(t))
            assert found >= t
            if kind == "wavelet" and np.isfinite(found):
                assert abs(float(wavelet(found))) >= share * highest * (1 - 1e-12)


@pytest.mark.parametrize("n", [2, 3, 64, 65, 300])
def test_the_highest_sample_of_any_part(n):
    rng = np.random.default_rng(n)
    record = rj.Record(rng.normal(size=n), 0.01, scale=-2.0, t_start=0.3)
    lookahead = record.lookahead(jnp.asarray(0.5))
    highest_time = jax.jit(jax.vmap(lambda start, end: lookahead.highest_time(start, end)))
    samples = 0.3 + 0.01 * np.arange(n)
    start, end = np.sort(rng.uniform(0.25, samples[-1] + 0.05, (2, 200)), axis=0)
    start[::3] = rng.choice(samples, start[::3].size)
    end[::5] = rng.choice(samples, end[::5].size)
    end = np.maximum(start, end)
    found = np.asarray(highest_time(start, end))
    start, end = np.clip([start, end], 0.3, samples[-1])
    assert np.all((start <= found) & (found <= end))
    size = lambda t: np.abs(np.asarray(record(t)))
    inside = (start[:, None] <= samples) & (samples <= end[:, None])
    highest = np.where(inside, size(samples), 0.0).max(axis=1)
    np.testing.assert_allclose(
        size(found), np.maximum(highest, np.maximum(size(start), size(end))), rtol=1e-12
    )


@pytest.mark.parametrize("pulse", PULSES)
def test_remaining_impulse_of_a_pulse_is_exact(pulse):
    motion = pulse(a_p=3.0, T_p=0.8)
    start, end = (float(t) for t in motion.support)
    for t in np.linspace(start, end, 7)[:-1]:
        area = quad(lambda s: abs(float(3.0 * pulse.shape(np.float64(s / 0.8)))), t, end, limit=400)[0]
        assert float(motion.lookahead(None).impulse(jnp.asarray(t), 0)) == pytest.approx(
            area, rel=1e-7, abs=1e-12
        )


def test_record_is_linear_between_samples_and_zero_outside():
    record = rj.Record(np.array([1.0, 3.0, -1.0]), 0.5, scale=2.0, t_start=1.0)
    t = np.array([0.99, 1.0, 1.25, 1.5, 1.75, 2.0, 2.01])
    np.testing.assert_allclose(record(t), [0.0, 2.0, 4.0, 6.0, 2.0, -2.0, 0.0])
    np.testing.assert_allclose(record.breakpoints, [1.0, 1.5, 2.0])
    for index, t in ((0, 0.5), (1, 1.0), (1, 1.49), (2, 1.5), (3, 2.0)):
        assert int(record.locate(jnp.asarray(t))) == index


def test_record_locates_every_one_of_its_samples():
    record = rj.Record(np.ones(5000), 0.007, t_start=-0.3)
    where = jax.vmap(record.locate)(record.breakpoints)
    np.testing.assert_array_equal(where, np.arange(1, 5001))


def test_rest_is_silent():
    assert float(rj.Rest()(0.3)) == 0.0
    assert rj.Rest().support == (0.0, 0.0)


def test_a_motion_of_ones_own():
    """A subclass of `AbstractExcitation` that defines the abstract members works everywhere, as
    documented."""

    class Chirp(rj.Gabor):
        @property
        def support(self):
            return -1.0 + 0 * self.T_p, 1.0 + 0 * self.T_p

    assert float(Chirp(1.0, 1.0)(0.0)) == pytest.approx(1.0)


def test_methods_can_be_compiled():
    pulse = rj.Ricker(2.0, 1.0)
    assert float(jax.jit(pulse.scaled)(0.5).a_p) == 1.0
    np.testing.assert_array_equal(jax.vmap(pulse.scaled)(np.arange(3.0)).a_p, [0.0, 2.0, 4.0])


def test_problem_files_know_every_pulse():
    assert set(pulses.PULSES.values()) == set(PULSES)
    for name, kind in pulses.PULSES.items():
        assert kind.__name__ == PULSE_CLASSES[name]
        assert models.Pulses(kind=name, a_p=1.0, T_p=1.0).kind == name
    with pytest.raises(ValueError, match="one-sine"):
        models.Pulses(kind="two-sines", a_p=1.0, T_p=1.0)


@pytest.mark.parametrize("cycles", [2.0, 12.0, 50.0])
def test_the_highest_time_of_any_part_of_a_wavelet(cycles):
    rng = np.random.default_rng(0)
    for motion in (rj.Gabor(1.0, 1.0, cycles, 1.0), rj.MavroeidisPapageorgiou(0.5, 1.2, cycles, 1.6)):
        lookahead = motion.lookahead(jnp.asarray(0.5))
        first, last = (float(t) for t in motion.support)
        start, end = np.sort(rng.uniform(first, last, (2, 12)), axis=0)
        start[:2], end[:2] = (-np.inf, 0.0), np.inf
        times = np.linspace(first, last, 400_001)
        values = np.asarray(motion(times))
        for side in (None, jnp.asarray(1.0), jnp.asarray(-1.0)):
            highest_time = jax.jit(jax.vmap(lambda a, b, s=side, o=lookahead: o.highest_time(a, b, s)))
            found = np.asarray(motion(highest_time(start, end)))
            signed = np.abs if side is None else lambda y, s=float(side): s * y
            for k in range(start.size):
                largest = signed(values[(start[k] <= times) & (times <= end[k])]).max()
                assert signed(found[k]) >= largest - 1e-6 * abs(largest) - 1e-12


def test_a_pair_with_shared_breakpoints_has_as_many_pieces_as_one_component():
    times = np.append(np.linspace(0.0, 350.0, 70_000), np.inf)
    long = PiecewiseMotion(jnp.asarray(times), jnp.zeros((70_001, DEGREE + 1)), jnp.zeros(70_001))
    assert SharedPieces(long, long).most_pieces == long.most_pieces
    with pytest.raises(ValueError, match="below 2³¹"):
        rj.GroundMotion(long, long)
    rng = np.random.default_rng(1)
    times = jnp.asarray([0.0, 0.4, 0.5, 2.0, np.inf])
    first, second = (
        PiecewiseMotion(times, jnp.asarray(rng.normal(size=(5, DEGREE + 1))), jnp.asarray(rng.normal(size=5)))
        for _ in range(2)
    )
    shared, pair = SharedPieces(first, second), rj.GroundMotion(first, second)
    end = jnp.ones((), bool)
    for t in (-0.1, 0.0, 0.3, 0.4, 1.0, 2.0, 3.0):
        here, there = (motion.locate(jnp.asarray(t)) for motion in (shared, pair))
        here, there = shared.past(here, end), pair.past(there, end)
        assert shared.parts(here) == pair.parts(there)
        assert shared.breakpoint(here) == pair.breakpoint(there)
        assert shared.velocity_jump(here) == pair.velocity_jump(there)
        assert shared.piece(here)(jnp.asarray(t)) == pair.piece(there)(jnp.asarray(t))
        assert shared.parts(shared.before(here)) == pair.parts(pair.before(there))
    assert shared.last_piece == 5
