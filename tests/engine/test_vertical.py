"""Vertical ground motion: exact statements, an independent integrator, balances, derivatives, invalid
inputs."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax import _results as results
from rockjax._engine import bounds, model
from rockjax._engine.coefficients import coefficients
from rockjax._engine.energy import vertical_impulse_weight
from rockjax._excitations.base import Shaking
from rockjax._excitations.ground import GroundMotion, check_weight
from rockjax._responses.work import restoring_moment
from tests import restrained
from tests.restrained import Frame

S: dict[str, Any] = {"alpha": 0.15, "R": 1.5, "gamma": 10.0}
G = 9.80665
TIGHT_OPTIONS = rj.Options(
    rtol=1e-10, atol=1e-12, outputs=("peak_rotation", "peak_deformation", "peak_shear")
)
ELASTIC = rj.Elastic(30.0, 0.5, 0.05)
RIGID = rj.Podium(**S)
DEVICES = (rj.Tendon(5.0, 100.0), rj.Damper(4.0), rj.Inerter(8.0))
PAIR = rj.GroundMotion(rj.OneSine(2.5, 0.8), rj.OneSine(-4.0, 0.5))


def pair(a_h, a_v, T_h=0.8, T_v=0.5) -> rj.GroundMotion:
    return rj.GroundMotion(rj.OneSine(a_h, T_h), rj.OneSine(a_v, T_v))


def peak(podium, motion, **more):
    return rj.peak_response(podium, motion, **({"t_end": 3.0, "options": TIGHT_OPTIONS} | more))


# Numbers


def test_uplift_and_the_bound_of_energy():
    """Facts 3 and 27: threshold of uplift and bound of the energy."""
    podium = rj.Podium(**S, superstructure=ELASTIC, restrainers=(rj.Tendon(5.0),))
    c = coefficients(podium, vertical=True)
    none = (jnp.zeros(()), jnp.zeros(()))
    ground = Shaking(jnp.asarray(5.279206567886627), jnp.asarray(-0.2 * G))
    assert float(model.uplift_demand(c, ground, none, none)) == pytest.approx(float(c.uplift), rel=1e-13)
    c = coefficients(rj.Podium(**S, superstructure=ELASTIC), vertical=True)
    assert float(c.impulse_factor) == pytest.approx(4.509398786906614, rel=1e-14)
    vertical = c.impulse_factor * vertical_impulse_weight(c, c.sin_alpha)
    assert float(vertical) == pytest.approx(1.290150147295639, rel=1e-14)


def test_the_demand_and_its_rates():
    c, zero = coefficients(rj.Podium(**S, superstructure=ELASTIC), vertical=True), jnp.zeros(())
    u, ground = lambda t: 0.01 * jnp.sin(7 * t), lambda t: Shaking(jnp.sin(3 * t), 2 * jnp.cos(5 * t))
    rates = lambda f, t: jax.jvp(f, (t,), (jnp.ones_like(t),))[1]
    moves, ground_rate = lambda t: rates(u, t), lambda t: rates(ground, t)
    accelerates = lambda t: rates(moves, t)
    demand = lambda t: model.uplift_demand(c, ground(t), (zero, u(t)), (zero, moves(t)))
    t = jnp.asarray(0.37)
    x, v, a, jerk = ((zero, f(t)) for f in (u, moves, accelerates, lambda t: rates(accelerates, t)))
    found = model.demand_jet(
        c, (ground(t), ground_rate(t), rates(ground_rate, t)), ((x, v), (v, a), (a, jerk))
    )
    exact = demand(t), rates(demand, t), rates(lambda t: rates(demand, t), t)
    np.testing.assert_allclose(found, exact, rtol=1e-12)


def test_uplift_under_motions_in_proportion():
    """Fact 19: v̈_g = r ü_g."""
    for a, level in ((3.0, 1.603286731022941), (-3.0, 1.377998159975468)):
        found = float(peak(RIGID, pair(a, 0.5 * a, T_v=0.8)).uplift_time)
        exact = 0.8 / (2 * math.pi) * math.asin(level / 3.0)
        assert found == pytest.approx(exact, abs=1e-14)


@pytest.mark.parametrize(
    ("motion", "g"), [(PAIR, G), (pair(2.5, -11.0), 12.0), (pair(1.2, 7.0, T_v=0.11), G)]
)
def test_first_uplift_is_the_first_root_of_the_combined_signal(motion, g):
    podium = rj.Podium(**S, g=g)
    t = np.linspace(0.0, 0.8, 2_000_001)
    signal = np.abs(motion(t)) - math.tan(0.15) * np.asarray(motion.vertical(t))
    above = np.flatnonzero(signal > g * math.tan(0.15))
    found = peak(podium, motion)
    if not above.size:
        assert not found.uplifted
    else:
        assert t[above[0] - 1] - 1e-12 <= float(found.uplift_time) <= t[above[0]] + 1e-12


def test_alone_it_never_lifts():
    for motion in (rj.GroundMotion(rj.Rest(), rj.OneSine(9.0, 0.5)), pair(1.0, 4.0)):
        found = peak(RIGID, motion)
        assert not found.uplifted
        assert float(found.peak_rotation) == 0


# An independent integration

SCENES = {
    "rigid": (Frame(), RIGID, 2.5),
    "devices": (
        Frame(tau=5.0, kappa=100.0, delta=4.0, mu=8.0),
        rj.Podium(**S, restrainers=DEVICES),
        3.2,
    ),
    "elastic": (Frame(modes=((30.0, 0.5, 0.05),)), rj.Podium(**S, superstructure=ELASTIC), 2.5),
}


@pytest.mark.parametrize(
    "name", ["rigid", pytest.param("devices", marks=pytest.mark.slow), pytest.param("elastic")]
)
def test_peaks_of_an_independent_integration(name):
    frame, podium, a_p = SCENES[name]
    answer = restrained.simulate(
        frame,
        3.0,
        restrained.one_sine(a_p, 0.8),
        restrained.one_sine(-4.0, 0.5),
        breaks=(0.5, 0.8),
        rest=1e-8,
    )
    found = peak(podium, pair(a_p, -4.0))
    restrained.check_peaks(found, answer, frame, rotation=1e-9)


@pytest.mark.parametrize("a_p", [2.5, -2.5])
def test_a_jump_that_lifts_after_the_vertical_motion_has_begun(a_p):
    """Full contact lasts until the jump of the ground motion and ends there at once."""
    podium = rj.Podium(**S, superstructure=ELASTIC)
    podium = podium.replace(restitution=float(podium.restitution_factor))  # the program of the next test
    found = peak(podium, rj.GroundMotion(rj.OneCosine(8 * a_p, 0.3), rj.Ricker(-3.0, 0.2)))
    assert found.uplift_time == 0
    start, cosine = -0.44, lambda t: 8 * a_p * math.cos(2 * math.pi * t / 0.3) if 0 <= t <= 0.3 else 0.0
    ricker = restrained.ricker(-3.0, 0.2)
    answer = restrained.simulate(
        Frame(modes=((30.0, 0.5, 0.05),)), 3.0 - start, lambda t: cosine(t + start),
        lambda t: ricker(t + start), breaks=(-start, 0.3 - start), rest=1e-8,
    )  # fmt: skip
    assert 0.1 < answer.peak < 0.95
    assert float(found.peak_rotation) == pytest.approx(answer.peak, abs=1e-8)


def test_a_large_jump_after_the_vertical_motion_has_begun():
    """The columns lift at the jump, also with a large tolerance."""
    podium = rj.Podium(0.13, 0.93, 3.3, rj.Elastic(73.6, 2.8, 0.05), restitution="compatible")
    podium = podium.replace(restitution=float(podium.restitution_factor))
    motion = rj.GroundMotion(rj.OneCosine(47.7, 0.93), rj.Ricker(-3.46, 0.13))
    found = peak(podium, motion, t_end=20.0, options=TIGHT_OPTIONS.replace(rtol=1e-4, atol=1e-6))
    assert found.stats.steps < 5000
    assert found.uplift_time == 0
    assert bool(found.overturned)


def of_samples(samples, dt):
    times = np.arange(len(samples)) * dt
    return lambda t: float(np.interp(t, times, samples)) if 0 <= t <= times[-1] else 0.0


RECORDS = (
    1.5 * np.array([0.4, 1.0, 2.2, 3.1, 2.0, 1.0, -2.4, -3.4, -2.0, 1.0, 2.5, 1.5, -2.0, 0.6]),
    np.array([1.0, -2.0, 3.0, 2.0, -4.0, -1.0, 2.0, 3.5, -3.0, 0.5, 1.5]),
)


@pytest.mark.parametrize("step", [0.06, 0.07], ids=["one sampling", "two samplings"])
def test_records(step):
    """Samples at equal and at different times: steps end at the breakpoints of both components."""
    horizontal, vertical = RECORDS
    breaks = np.unique(np.concatenate([np.arange(1, 14) * 0.06, np.arange(1, 11) * step]))
    both = of_samples(horizontal, 0.06), of_samples(vertical, step)
    answer = restrained.simulate(Frame(), 3.0, *both, breaks=tuple(breaks), rest=1e-8)
    motion = rj.GroundMotion(rj.Record(horizontal, 0.06), rj.Record(vertical, step))
    found = peak(RIGID, motion)
    assert 0.1 < answer.peak < 0.95
    assert float(found.peak_rotation) == pytest.approx(answer.peak, abs=1e-9)
    assert float(found.uplift_time) == pytest.approx(answer.uplift_time, abs=1e-11)


# Exact statements about scenes


@pytest.mark.slow(but=["None"])
@pytest.mark.parametrize("top", [None, pytest.param(ELASTIC, marks=pytest.mark.slow)])
def test_a_constant_is_another_gravity(top):
    """Fact 18: constant vertical acceleration acts like another g."""
    a, nu = -2.0, 0.5
    ratio = G / (G + a)
    make = lambda g, force, damper: rj.Podium(
        **S, g=g, superstructure=top, restitution=0.93,
        restrainers=(rj.Tendon(5.0 * force, 100.0 * force), rj.Damper(4.0 * damper, nu), rj.Inerter(8.0)),
    )  # fmt: skip
    horizontal, steady = rj.OneSine(3.0, 0.8), rj.Record([a, a], 9.0)
    with_motion = peak(make(G, 1.0, 1.0), rj.GroundMotion(horizontal, steady))
    other = peak(make(G + a, ratio, ratio ** (1 - nu / 2)), rj.GroundMotion(horizontal, rj.Rest()))
    assert 0.1 < float(other.peak_rotation) < 1
    assert float(with_motion.peak_rotation) == pytest.approx(float(other.peak_rotation), rel=2e-9)


def test_nothing_vertical_changes_nothing():
    bare, zero = peak(RIGID, rj.OneSine(2.5, 0.8)), peak(RIGID, pair(2.5, 0.0))
    assert float(zero.peak_rotation) == pytest.approx(float(bare.peak_rotation), rel=1e-11)
    assert float(zero.uplift_time) == pytest.approx(float(bare.uplift_time), abs=1e-15)


def test_mirror():
    """Fact 23: −ü_g with the same v̈_g mirrors the response; −v̈_g does not."""
    one, other, another = (peak(RIGID, pair(a, b)) for a, b in ((2.5, -4.0), (-2.5, -4.0), (2.5, 4.0)))
    assert float(one.peak_rotation) == pytest.approx(float(other.peak_rotation), rel=1e-13)
    assert abs(float(another.peak_rotation) - float(one.peak_rotation)) > 1e-3


def test_the_pair_is_scaled_together():
    found = peak(RIGID, pair(1.25, -2.0).scaled(2.0))
    assert float(found.peak_rotation) == float(peak(RIGID, PAIR).peak_rotation)


def test_energy_balance():
    """Fact 24: the work of both components equals the energy of the podium plus the dissipated energy."""
    response = rj.simulate(RIGID, PAIR, t_end=3.0, options=TIGHT_OPTIONS)
    energies = response.energies(np.linspace(0, 3, 60))
    assert np.max(np.abs(energies.input)) > 1
    assert np.max(np.abs(energies.residual)) < 1e-8
    data = response.dataset(np.linspace(0, 3, 60))
    np.testing.assert_allclose(data["vertical_acceleration"], PAIR.vertical(np.linspace(0, 3, 60)))
    assert data.attrs["vertical_a_p_m_s2"] == -4.0
    # While rocking, the moment is that of the forces at the edges, which carry the weights with g + v̈_g
    # (C22).
    c = coefficients(RIGID, vertical=True)
    ground, x, v = Shaking(*map(jnp.asarray, (0.4, -2.0))), (jnp.asarray(0.05),), (jnp.asarray(0.3),)
    theta_ddot = float(model.acceleration(c, jnp.ones(()), ground, x, v)[0])
    psi = 0.15 - 0.05
    rises = 3.0 * (theta_ddot * math.sin(psi) - 0.09 * math.cos(psi))
    held = math.sin(psi) * (21.0 * (G - 2.0) + 20.5 * rises) / (G * math.sin(0.15) * 21.0)
    assert float(restoring_moment(c, jnp.ones(()), ground, x, v)) == pytest.approx(held, rel=1e-13)


@pytest.mark.slow
def test_settled_answers_stand():
    """With the impulses of both components, scenes that the certificate ends early have the answers of
    complete scenes."""
    a_p = np.linspace(1.6, 5.0, 18)
    motions = rj.GroundMotion(rj.OneSine(a_p, 0.8), rj.OneSine(-4.0, 1.4))
    short = rj.peak_responses(RIGID, motions, options=TIGHT_OPTIONS)
    complete = rj.peak_responses(
        RIGID, motions, options=TIGHT_OPTIONS.replace(outputs=("peak_rotation", "impacts"))
    )
    np.testing.assert_allclose(short.peak_rotation, complete.peak_rotation, rtol=1e-11)
    np.testing.assert_array_equal(short.overturned, complete.overturned)
    assert 0 < np.sum(short.overturned) < 18
    assert np.sum(short.stats.steps) < np.sum(complete.stats.steps)
    one = peak(RIGID, rj.GroundMotion(rj.OneSine(a_p[3], 0.8), rj.OneSine(-4.0, 1.4)))
    assert float(one.peak_rotation) == pytest.approx(float(short.peak_rotation[3]), rel=1e-12)


@pytest.mark.slow
def test_segments_engine():
    options = rj.Options(rtol=1e-10, atol=1e-12, engine="segments", outputs=("peak_rotation",))
    found = rj.peak_response(RIGID, PAIR, t_end=3.0, options=options)
    assert float(found.peak_rotation) == pytest.approx(float(peak(RIGID, PAIR).peak_rotation), abs=1e-9)


def test_a_scene_without_vertical_motion_does_not_look_at_it(monkeypatch):
    def never(*_):
        raise AssertionError("vertical motion was looked at")

    monkeypatch.setattr(model, "_threshold_ratio", never)
    monkeypatch.setattr(bounds, "vertical_impulse_weight", never)
    for name in ("parts", "tie"):
        monkeypatch.setattr(GroundMotion, name, never)
    from rockjax._engine.solve import _solve

    options = rj.Options(outputs=("peak_rotation", "margin"))
    trace = lambda podium, motion: _solve(podium, motion, rj.State(), None, options)
    for top in (None, ELASTIC):
        jax.make_jaxpr(trace)(rj.Podium(**S, superstructure=top), rj.OneSine(2.2, 0.8))
    with pytest.raises(AssertionError, match="looked at"):
        jax.make_jaxpr(trace)(RIGID, PAIR)


# Derivatives


def test_derivatives_by_numbers_of_both_motions():
    values = jnp.array([2.5, 0.8, -4.0, 0.5])

    def peak_rotation(numbers):
        a_h, T_h, a_v, T_v = numbers
        return peak(RIGID, pair(a_h, a_v, T_h, T_v)).peak_rotation

    forward, reverse = jax.jacfwd(peak_rotation)(values), jax.jacrev(peak_rotation)(values)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    sharp = TIGHT_OPTIONS.replace(rtol=1e-13, atol=1e-15)
    for k, y in enumerate(np.asarray(values)):
        h = 2e-4 * abs(y)
        rows = np.asarray(values) + h * np.array([-2, -1, 1, 2])[:, None] * np.eye(4)[k]
        at = [float(peak(RIGID, pair(a, b, T, U), options=sharp).peak_rotation) for a, T, b, U in rows]
        slope = (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * h)
        assert float(forward[k]) == pytest.approx(slope, rel=1e-6)


@pytest.mark.slow
def test_derivatives_where_jumps_of_both_fall_together():
    """Coinciding breakpoints whose times have different derivatives."""

    def peak_rotation(T_h, T_v):
        motion = rj.GroundMotion(rj.OneCosine(2.6, T_h), rj.OneCosine(-3.0, T_v))
        return peak(RIGID, motion).peak_rotation

    by_h, by_v = jax.jacfwd(peak_rotation, (0, 1))(0.5, 0.5)
    h = 1e-4
    for slope, along in ((by_h, (h, 0.0)), (by_v, (0.0, h))):
        at = [float(peak_rotation(0.5 + s * along[0], 0.5 + s * along[1])) for s in (-2, -1, 1, 2)]
        assert float(slope) == pytest.approx((at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * h), rel=1e-5)


@pytest.mark.slow
def test_size_and_time_scale():
    """Fact 22: multiplying R by s and all times by √s changes no rotation."""

    def peak_rotation(R, T_h, T_v):
        return peak(rj.Podium(0.15, R, 10.0), pair(2.5, -4.0, T_h, T_v)).peak_rotation

    by_R, by_h, by_v = (float(y) for y in jax.grad(peak_rotation, (0, 1, 2))(1.5, 0.8, 0.5))
    assert 2 * 1.5 * by_R + 0.8 * by_h + 0.5 * by_v == pytest.approx(0, abs=1e-8 * abs(0.8 * by_h))


# Invalid inputs


def test_invalid_pairs():
    with pytest.raises(ValueError, match="GroundMotion: horizontal must be a rockjax motion, got"):
        rj.GroundMotion(3.0, rj.Rest())
    with pytest.raises(ValueError, match="GroundMotion: vertical must be one component"):
        rj.GroundMotion(rj.OneSine(2.5, 0.8), PAIR)


@pytest.mark.slow
def test_weight_that_touches_zero():
    """g + v̈_g of 1e-9 g or of one unit in the last place is solved; zero or less is an error."""
    most = lambda a: pair(2.0, -a)
    found = peak(RIGID, most(G * (1 - 1e-9)))
    motions = restrained.one_sine(2.0, 0.8), restrained.one_sine(-G * (1 - 1e-9), 0.5)
    answer = restrained.simulate(Frame(), 3.0, *motions, breaks=(0.5, 0.8), rest=1e-8)
    restrained.check_peaks(found, answer, Frame(), rotation=1e-9)
    nearly = peak(RIGID, most(math.nextafter(G, 0.0)))
    assert float(nearly.peak_rotation) == pytest.approx(float(found.peak_rotation), abs=1e-8)
    for a in (G, math.nextafter(G, 99.0)):
        with pytest.raises(ValueError, match=r"g \+ v̈_g must be positive at all times"):
            peak(RIGID, most(a))
        with pytest.warns(RuntimeWarning, match="weightless"):
            batch = rj.peak_responses(
                RIGID, pair(2.0, np.array([-4.0, -a])), t_end=3.0, options=TIGHT_OPTIONS
            )
        assert [results.NAMES[int(k)] for k in results.code_of(batch.result)][1] == "weightless"
        assert np.isfinite(batch.peak_rotation[0])


@pytest.mark.parametrize(
    "motion",
    [
        lambda a: rj.Ricker(-a, 0.5),
        lambda a: rj.OneCosine(a, 0.5),
        lambda a: rj.Record([0.0, 1.0, -a, 2.0], 0.1),
        lambda a: rj.Gabor(-a, 0.5, 3.0, 0.0),
    ],
    ids=["ricker", "one cosine", "record", "gabor"],
)
def test_every_motion_knows_where_it_is_lowest(motion):
    """A motion for which g + v̈_g touches zero is an error, for every class of motions; 10⁻⁷ g above zero is
    none."""
    with pytest.raises(ValueError, match=r"g \+ v̈_g must be positive"):
        check_weight("scene", rj.GroundMotion(rj.Rest(), motion(G)), jnp.asarray(G))
    check_weight("scene", rj.GroundMotion(rj.Rest(), motion(G * (1 - 1e-7))), jnp.asarray(G))


def test_no_weight():
    words = r"peak_response: g \+ v̈_g must be positive at all times, got 9.80665 -12 m/s² at t = 0.125 s"
    with pytest.raises(ValueError, match=words):
        peak(RIGID, pair(2.5, -12.0))
    motions = rj.GroundMotion(rj.OneSine(2.5, 0.8), rj.OneSine(np.array([-4.0, -12.0]), 0.5))
    with pytest.warns(RuntimeWarning, match="weightless"):
        found = rj.peak_responses(RIGID, motions, t_end=3.0, options=TIGHT_OPTIONS)
    assert float(found.peak_rotation[0]) == pytest.approx(float(peak(RIGID, PAIR).peak_rotation), rel=1e-12)
    assert results.NAMES[int(results.code_of(found.result)[1])] == "weightless"
    traced = jax.jit(lambda a: rj.peak_response(RIGID, pair(2.5, a), t_end=3.0, options=TIGHT_OPTIONS).result)
    assert traced(-12.0) == rj.RESULTS.weightless
    assert traced(12.0) == rj.RESULTS.weightless
    # At t_end the energy equals that of the peak, so rounding decides the result.
    result = traced(-4.0)
    assert (result == rj.RESULTS.settled) | (result == rj.RESULTS.end_of_time)
