"""Results compared with closed forms and published values."""

import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import rockjax as rj
from tests import saltation
from tests.scenes import ALPHA, PODIUMS, G, options, pulse, shaking

OPTIONS = options(1e-11, "dopri8", outputs=("peak_rotation",))


def block(b: float, h: float, **more) -> rj.Podium:
    return rj.Podium(alpha=math.atan(b / h), R=math.hypot(b, h), g=9.81, **more)


def overturning(podium, kind, T_p: float, lo: float, hi: float) -> float:
    """Return the amplitude in g at which the outcome changes between lo and hi (it changes once)."""
    for _ in range(9):
        a = np.linspace(lo, hi, 33)
        over = rj.peak_responses(podium, kind(a * 9.81, T_p), options=OPTIONS).overturned
        k = int(np.argmax(over != over[0]))
        assert k > 0
        lo, hi = a[k - 1], a[k]
    return 0.5 * (lo + hi)


def test_free_rocking_impacts_published():
    podium = block(0.5, 1.5, restitution=0.85)
    response = rj.simulate(podium, rj.Rest(), initial=rj.State(podium.alpha / 2), options=OPTIONS)
    published = [0.612367284, 1.491124089, 2.177387280, 2.731958356, 3.188262125]
    np.testing.assert_allclose(response.impact_times[:5], published, atol=1.5e-8)
    assert response.result == rj.RESULTS.settled


@pytest.mark.parametrize("name", ["block", "frame", "rigid"])
def test_free_rocking_impacts_by_quadrature(name):
    """Times of all impacts follow from quarter periods, and amplitudes from the energy factor c = e²."""
    podium = PODIUMS[name]
    alpha, e = float(podium.alpha), float(podium.restitution_factor)
    p = float(podium.equivalent_block().p)
    theta0 = 0.8 * alpha
    well = lambda th: math.cos(alpha - th) - math.cos(alpha)

    def quarter(top):
        # the substitution θ = top sin² removes the square roots at both ends
        def f(s):
            th = top * math.sin(s) ** 2
            return 2 * top * math.sin(s) * math.cos(s) / (p * math.sqrt(2 * (well(top) - well(th))))

        return quad(f, 0, math.pi / 2, epsabs=1e-11, epsrel=1e-11, limit=200)[0]

    times, t, height = [], 0.0, well(theta0)
    for n in range(8):
        top = alpha - math.acos(min(1.0, math.cos(alpha) + height))
        t += quarter(top) * (1 if n == 0 else 2)
        # two quarter periods pass between impacts
        times.append(t)
        height *= e * e
    response = rj.simulate(podium, rj.Rest(), initial=rj.State(theta0), options=OPTIONS, t_end=100.0)
    np.testing.assert_allclose(response.impact_times[:8], times, atol=1e-9)


@pytest.mark.slow(but=["one-sine"])
@pytest.mark.parametrize(
    ("podium", "kind", "T_p", "lo", "hi", "exact"),
    [
        (block(0.2, 0.6), rj.HalfSine, 1.0, 0.5, 0.65, 0.574724),
        (block(0.5, 1.5), rj.OneCosine, 1.0, 0.60, 0.66, 0.625845),
        (block(0.5, 1.5, restitution=0.85), rj.OneSine, 1.0, 0.45, 0.48, 0.468727),
        (
            rj.Podium(alpha=math.radians(15), R=0.75 * 9.81 / 4, g=9.81),
            rj.OneCosine,
            2.0,
            0.30,
            0.33,
            0.315034,
        ),
    ],
    ids=["half-sine", "one-cosine", "one-sine", "one-cosine p=2"],
)
def test_published_overturning_accelerations(podium, kind, T_p, lo, hi, exact):
    assert overturning(podium, kind, T_p, lo, hi) == pytest.approx(exact, abs=6e-7)


def test_safe_windows_between_overturning():
    """Overturning is not monotone in amplitude: 15 changes, some windows 1e-3 wide."""
    podium = PODIUMS["rigid"]
    T_p = 2 * math.pi / (2 * float(podium.p))
    ratio = np.linspace(2.0, 2.6, 6001)
    over = rj.peak_responses(podium, rj.Ricker(ratio * G * 0.15, T_p), options=OPTIONS).overturned
    changes = ratio[1:][np.diff(over.astype(int)) != 0]
    assert len(changes) == 15
    assert changes[0] == pytest.approx(2.1038, abs=2e-4)
    assert changes[1] == pytest.approx(2.3107, abs=2e-4)
    assert changes[-1] == pytest.approx(2.528, abs=5e-4)


def test_section_4_of_the_paper():
    """The equations of the paper give 2.89 and 0.458 instead of the printed 3.5 and 0.29; T_p = 0.80 s gives
    3.47 and 0.290."""
    podium = PODIUMS["rigid"]
    ratio = np.linspace(2.5, 4.0, 1501)
    for T_p, least, rotation in ((1.0, 2.89, 0.458), (0.80, 3.47, 0.290)):
        peaks = rj.peak_responses(podium, rj.Ricker(ratio * G * 0.15, T_p), options=OPTIONS)
        assert ratio[np.argmax(peaks.overturned)] == pytest.approx(least, abs=6e-3)
        assert peaks.peak_rotation[0] == pytest.approx(rotation, abs=6e-4)


@pytest.mark.slow(but=["Ricker", "record"])
@pytest.mark.parametrize(
    "motion", [pulse(), pulse(rj.OneCosine, 1.6), shaking(200)], ids=["Ricker", "cosine", "record"]
)
def test_a_frame_rocks_like_its_equivalent_block(motion):
    frame = PODIUMS["rigid"]
    a = rj.peak_response(frame, motion, options=OPTIONS)
    b = rj.peak_response(frame.equivalent_block(), motion, options=OPTIONS, t_end=a.stats.end_time + 20)
    assert float(a.peak_rotation) == pytest.approx(float(b.peak_rotation), abs=1e-9)
    assert 0 < float(a.peak_rotation) < 1


@pytest.mark.smoke
def test_rigid_and_beam_mass_are_the_same():
    a = rj.peak_response(PODIUMS["rigid"], pulse(), options=OPTIONS)
    b = rj.peak_response(rj.Podium(ALPHA, 1.5, gamma=110.0), pulse(), options=OPTIONS)
    assert float(a.peak_rotation) == pytest.approx(float(b.peak_rotation), abs=1e-12)


@pytest.mark.smoke
def test_elastic_contact_is_a_linear_oscillator():
    """Without uplift, Eq. (4) has a closed form: free vibration from an initial displacement."""
    T, z, u0 = 0.5, 0.05, 0.004
    podium = PODIUMS["elastic"]
    response = rj.simulate(
        podium, rj.Rest(), initial=rj.State(0.0, 0.0, u0, 0.0), t_end=3.0, options=options(1e-11, "dopri8")
    )
    w = 2 * math.pi / T
    wd = w * math.sqrt(1 - z * z)
    t = np.linspace(0, 3, 61)
    exact = u0 * np.exp(-z * w * t) * (np.cos(wd * t) + z * w / wd * np.sin(wd * t))
    state = response(t)
    np.testing.assert_allclose(state.u_t, exact, atol=1e-11)
    assert float(response.peak_deformation) == pytest.approx(u0, rel=1e-12)
    assert np.all(np.asarray(state.theta) == 0)
    assert not bool(response.uplifted)


@pytest.mark.slow
def test_derivatives_of_linearised_rocking():
    """Times of forty impacts of slender blocks, α = 1e-6, and their derivatives with respect to R, φ₀, e and
    κ agree to 1e-9.

    The blocks rock from bouncing (θ₀ ≪ α) to wide swings under a constant acceleration κ g tan α. Between
    impacts φ'' = φ − (1 + σκ) with φ = |θ|/α and time in units of 1/p, so a half swing with the initial speed
    v lasts 2 arcosh(w/√(w² − v²)), w = 1 + σκ, and the next one starts with e v."""
    alpha, impacts = 1e-6, 40

    def exact(y):
        R, phi, e, kappa = y
        w = 1 + kappa
        times = [jnp.arccosh(w / (w - phi))]
        v2 = w**2 - (w - phi) ** 2
        for n in range(1, impacts):
            v2, w = e**2 * v2, 1 + kappa * (-1) ** n
            times.append(times[-1] + 2 * jnp.arccosh(w / jnp.sqrt(w**2 - v2)))
        return jnp.stack(times) / jnp.sqrt(0.75 * G / R)

    def found(y):
        R, phi, e, kappa = y
        push = rj.Record(np.full(2, G * math.tan(alpha)), 1e3, kappa)
        fine = options(1e-13, "dopri8", history=2048, rest_velocity=1e-12)
        podium, start = rj.Podium(alpha, R, restitution=e), rj.State(phi * alpha)
        return rj.simulate(podium, push, initial=start, t_end=900.0, options=fine).impact_times[:impacts]

    y = np.array(
        [
            [2.0, 0.5, 0.9, 0.0],
            [0.3, 0.05, 0.97, 0.1],
            [10.0, 0.25, 0.99, 0.2],
            [1.0, 1e-3, 0.95, 0.3],
            [5.0, 0.4, 0.85, -0.05],
            [1.5, 0.6, 0.999, 0.02],
        ]
    )
    both = lambda f: jax.jit(jax.vmap(lambda y: (f(y), jax.jacfwd(f)(y))))(y)
    (times, slopes), (true_times, true_slopes) = both(found), both(exact)
    np.testing.assert_allclose(times, true_times, rtol=1e-11)
    np.testing.assert_allclose(slopes, true_slopes, rtol=1e-9)


def test_peak_gradients_at_thirty_digits():
    """Peaks and derivatives agree to 1e-8 with a Taylor integrator with saltation matrices
    (tests/saltation.py)."""
    table = json.loads(saltation.TABLE.read_text())
    assert table.keys() == saltation.SCENES.keys()
    for name, scene in table.items():
        assert {key: scene[key] for key in saltation.SCENES[name]} == saltation.SCENES[name]

        def peak(y, kind=getattr(rj, scene["pulse"])):
            podium, start = rj.Podium(y[0], y[1], restitution=y[2]), rj.State(y[5], y[6])
            fine = options(1e-13, "dopri8", outputs=("peak_rotation",))
            return rj.peak_response(
                podium, kind(y[3], y[4]), initial=start, t_end=2.6, options=fine
            ).peak_rotation

        y = jnp.array([float(scene[key]) for key in saltation.PARAMETERS])
        value, gradient = jax.jit(jax.value_and_grad(peak))(y)
        assert float(value) == pytest.approx(float(scene["peak_rotation"]), rel=1e-12)
        np.testing.assert_allclose(gradient, [float(x) for x in scene["gradient"].values()], rtol=1e-8)
