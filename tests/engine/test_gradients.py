"""Forward and reverse derivatives, compared with finite differences of accurate solutions and with closed
forms."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from tests import restrained
from tests.scenes import ALPHA, PODIUMS, G, options, shaking

TIGHT_OPTIONS = options(1e-13, "dopri8")
ELASTIC = np.array([ALPHA, 1.5, 10.0, 100.0, 0.5, 0.05, 1 / 3, 0.956, G, 2.2 * G * 0.15, 1.0])
RIGID = np.array([ALPHA, 1.5, 10.0, 100.0, 1 / 3, 0.951, G, 2.5 * G * 0.15, 1.0])


def elastic_scene(y, kind):
    top = rj.Elastic(y[3], y[4], y[5])
    podium = rj.Podium(y[0], y[1], y[2], top, lam=y[6], restitution=y[7], g=y[8])
    return podium, kind(y[9], y[10])


def rigid_scene(y, kind):
    podium = rj.Podium(y[0], y[1], y[2], rj.Rigid(y[3]), lam=y[4], restitution=y[5], g=y[6])
    return podium, kind(y[7], y[8])


def differences(f, y, relative=1e-4):
    """Return central differences of fourth order, and an estimate of their error from two steps."""
    y = np.asarray(y, float)
    rows, errors = [], []
    for i in range(y.size):
        estimates = []
        for h in (relative * abs(y[i]), 0.5 * relative * abs(y[i])):
            at = lambda k, i=i, h=h: np.asarray(f(jnp.asarray(y).at[i].add(k * h)))
            estimates.append((8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * h))
        rows.append(estimates[1])
        errors.append(np.abs(estimates[1] - estimates[0]))
    return np.stack(rows, -1), np.stack(errors, -1)


QUANTITIES = ("peak_rotation", "peak_deformation", "peak_shear", "peak_rotation_time", "uplift_time")
CASES = {
    "elastic, Ricker": (elastic_scene, ELASTIC, rj.Ricker, 2.6),
    "elastic, cosine with jumps": (
        elastic_scene,
        np.append(ELASTIC[:9], [1.6 * G * 0.15, 0.8]),
        rj.OneCosine,
        2.6,
    ),
    "rigid, Ricker": (rigid_scene, RIGID, rj.Ricker, 5.0),
    "rigid, cosine with jumps": (rigid_scene, np.append(RIGID[:7], [1.5 * G * 0.15, 1.0]), rj.OneCosine, 5.0),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "method"),
    [
        ("elastic, Ricker", "dopri8"),
        ("elastic, cosine with jumps", "dopri8"),
        ("rigid, cosine with jumps", "tsit5"),
    ],
)
@pytest.mark.slow(but=["elastic, Ricker-dopri8"])
def test_every_number_of_structure_and_pulse(case, method):
    """Forward, reverse and batched derivatives through several impacts and re-contact agree with finite
    differences to 1e-6."""
    scene, y, kind, t_end = CASES[case]

    def peaks(y, options=options(1e-10, method)):
        peak = rj.peak_response(*scene(y, kind), t_end=t_end, options=options)
        return jnp.stack([getattr(peak, name) for name in QUANTITIES])

    response = rj.simulate(*scene(y, kind), t_end=t_end, options=options(1e-10))
    assert int(response.impacts) >= 2
    assert 0.05 < float(response.peak_rotation) < 0.95
    forward = np.asarray(jax.jacfwd(peaks)(y))
    reverse = np.asarray(jax.jacrev(peaks)(y))
    assert np.all(np.isfinite(forward))
    np.testing.assert_allclose(reverse, forward, rtol=1e-8, atol=1e-11)
    if scene is rigid_scene:  # a separate program
        batched = np.asarray(jax.vmap(jax.jacrev(peaks))(jnp.stack([y, y * 1.0001]))[0])
        np.testing.assert_allclose(batched, forward, rtol=3e-7, atol=1e-9)
    numeric, own_error = differences(lambda y: peaks(y, TIGHT_OPTIONS), y)
    size = np.abs(np.asarray(y)) * np.abs(numeric)  # d(quantity)/d(ln y), to distinguish zero from small
    scale = size.max(axis=1, keepdims=True) / np.abs(np.asarray(y))
    excess = np.abs(forward - numeric) - 3 * own_error - 1e-8 * scale
    bad = excess > 1e-6 * np.abs(numeric)
    assert not bad.any(), [
        (QUANTITIES[i], int(k), forward[i, k], numeric[i, k], own_error[i, k]) for i, k in np.argwhere(bad)
    ]


@pytest.mark.slow
def test_against_an_independent_solution():
    """Comparison with finite differences of the SciPy implementation, which finds events separately."""
    T_p, t_end = 1.0, 2.6

    def reference(alpha, a_p):
        podium = PODIUMS["elastic"].replace(alpha=alpha)
        acceleration = lambda t: a_p * float(rj.Ricker.shape(np.float64(t / T_p)))
        frame = restrained.frame_of(podium)
        return restrained.simulate(frame, t_end, acceleration, start=-2.2 * T_p).peak

    def ours(alpha, a_p):
        podium = PODIUMS["elastic"].replace(alpha=alpha)
        return rj.peak_response(
            podium, rj.Ricker(a_p, T_p), t_end=t_end, options=options(1e-10, "dopri8")
        ).peak_rotation

    a_p = 2.2 * G * 0.15
    gradient = jax.grad(ours, argnums=(0, 1))(ALPHA, a_p)
    for k, (x, h) in enumerate(((ALPHA, 2e-4 * ALPHA), (a_p, 2e-4 * a_p))):
        at = lambda s, k=k, h=h: reference(ALPHA + s * h * (k == 0), a_p + s * h * (k == 1))
        numeric = (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * h)
        assert float(gradient[k]) == pytest.approx(numeric, rel=3e-6)
        del x


@pytest.mark.smoke
def test_free_rocking_closed_form():
    """The peak after n impacts is θ_n = α − arccos(cos α + e²ⁿ[cos(α−θ₀) − cos α]), with closed-form
    derivatives."""
    alpha, theta0, R, e = 0.3, 0.2, 2.0, 0.9

    def closed(alpha, theta0, e):
        return alpha - jnp.arccos(jnp.cos(alpha) + e**4 * (jnp.cos(alpha - theta0) - jnp.cos(alpha)))

    def top_of_third_excursion(alpha, theta0, e):
        podium = rj.Podium(alpha, R, restitution=e)
        response = rj.simulate(
            podium, rj.Rest(), initial=rj.State(theta0), t_end=5.0, options=options(1e-11, "dopri8")
        )
        # between the second and the third impact; θ̇ = 0 at the maximum, so its time need not be exact
        middle = jax.lax.stop_gradient(0.5 * (response.impact_times[1] + response.impact_times[2]))
        return jnp.abs(response(middle).theta)

    point = (alpha, theta0, e)
    assert float(top_of_third_excursion(*point)) == pytest.approx(float(closed(*point)), rel=1e-9)
    expected = jax.grad(closed, argnums=(0, 1, 2))(*point)
    for derivative in (jax.grad, jax.jacfwd):
        found = derivative(top_of_third_excursion, argnums=(0, 1, 2))(*point)
        np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.slow
def test_impact_times_of_free_rocking():
    """A quarter period is proportional to √(R/g)."""

    def times(R, g):
        podium = rj.Podium(0.3, R, g=g)
        options_ = options(1e-10, "dopri8", history=256)
        response = rj.simulate(podium, rj.Rest(), initial=rj.State(0.2), t_end=3.0, options=options_)
        return response.impact_times[:4]

    value = times(2.0, G)
    by_R, by_g = jax.jacfwd(times, argnums=(0, 1))(2.0, G)
    np.testing.assert_allclose(by_R, value / 4.0, rtol=1e-8)
    np.testing.assert_allclose(by_g, -value / (2 * G), rtol=1e-8)
    np.testing.assert_allclose(jax.jacrev(times)(2.0, G), by_R, rtol=1e-9)


def test_uplift_and_overturn_times():
    block = PODIUMS["block"]
    o = options(1e-11, "dopri8")

    def times(a_p, T_p):
        peak = rj.peak_response(block, rj.OneSine(a_p, T_p), options=o)
        return jnp.stack([peak.uplift_time, peak.overturn_time])

    a_p, T_p = 8.0, 1.2
    by_a, by_T = jax.jacfwd(times, argnums=(0, 1))(a_p, T_p)
    # t_up = T/2π asin(g tan α/a_p), in closed form
    r = G * math.tan(0.3) / a_p
    assert float(by_a[0]) == pytest.approx(-T_p / (2 * math.pi) * r / a_p / math.sqrt(1 - r * r), rel=1e-10)
    assert float(by_T[0]) == pytest.approx(math.asin(r) / (2 * math.pi), rel=1e-10)
    numeric, _ = differences(lambda y: times(y[0], y[1]), [a_p, T_p])
    np.testing.assert_allclose([by_a[1], by_T[1]], numeric[1], rtol=1e-6)


@pytest.mark.slow
def test_initial_state_through_559_impacts():
    """The columns come to rest in ever smaller hops before the pulse, and then lift again."""
    podium = PODIUMS["elastic"]

    def peak(y, options=options(1e-10, "dopri8")):
        initial = rj.State(y[0], y[1], y[2], y[3])
        return rj.peak_response(
            podium, rj.Ricker(2.0, 1.0), initial=initial, t_end=1.8, options=options
        ).peak_rotation

    y = jnp.array([0.01, 0.01, 0.01, 0.02])
    assert 0.1 < float(peak(y)) < 0.9
    response = rj.simulate(
        podium, rj.Ricker(2.0, 1.0), initial=rj.State(*y), t_end=1.8, options=options(1e-12, "dopri8")
    )
    assert int(response.impacts) > 400
    forward, reverse = jax.jacfwd(peak)(y), jax.grad(peak)(y)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    numeric, _ = differences(lambda y: peak(y, TIGHT_OPTIONS), y)
    np.testing.assert_allclose(forward, numeric, rtol=5e-6)
    np.testing.assert_allclose(jax.jacfwd(lambda y: peak(y, TIGHT_OPTIONS))(y), numeric, rtol=1e-6)


def test_a_peak_at_the_end_moves_with_it():
    block = PODIUMS["block"]

    def peak(t_end):
        return rj.peak_response(
            block, rj.Rest(), initial=rj.State(0.05, 0.3), t_end=t_end, options=options(1e-11)
        ).peak_rotation

    response = rj.simulate(block, rj.Rest(), initial=rj.State(0.05, 0.3), t_end=0.1, options=options(1e-11))
    slope = float(response(0.1, left=True).theta_dot) / 0.3
    assert slope > 0.1
    assert float(jax.grad(peak)(0.1)) == pytest.approx(slope, rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "method"), [("rigid", "tsit5"), ("elastic", "dopri8")])
def test_all_samples_of_a_record(name, method):
    """Reverse mode with respect to all samples is correct, independently of the compiler's rounding."""
    podium, record = PODIUMS[name], shaking(160, 0.03, seed=5)
    o = options(1e-10, method, max_steps=4096, outputs=("peak_rotation",))

    @jax.jit
    def peak(samples, options=o):
        return rj.peak_response(podium, rj.Record(samples, record.dt), options=options).peak_rotation

    samples = record.acceleration
    gradient = jax.jit(jax.grad(peak))(samples)
    assert np.all(np.isfinite(gradient))
    assert 0.05 < float(peak(samples)) < 0.95
    rng = np.random.default_rng(0)
    for _ in range(2):
        direction = jnp.asarray(rng.normal(size=samples.shape))
        at = lambda k, d=direction: float(peak(samples + k * 1e-5 * d, TIGHT_OPTIONS))
        numeric = (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / 12e-5
        assert float(gradient @ direction) == pytest.approx(numeric, rel=1e-6, abs=1e-9)
    forward = jax.jit(lambda d: jax.jvp(peak, (samples,), (d,))[1])(direction)
    assert float(forward) == pytest.approx(float(gradient @ direction), rel=1e-8)


@pytest.mark.slow
def test_records_side_by_side_have_the_gradients_of_each_alone():
    """The stored values of each step are written by row; no step selects between complete buffers."""
    many = 3001
    o = options(1e-6, "bosh3", max_steps=many, outputs=("peak_rotation",))

    def peak(samples):
        return rj.peak_response(PODIUMS["block"], rj.Record(samples, 0.03), options=o).peak_rotation

    samples = jnp.stack([shaking(80, 0.03, peak=6.0, seed=k).acceleration for k in (1, 2)])
    lowered = jax.jit(jax.vmap(jax.value_and_grad(peak))).lower(samples)
    chosen = [line for line in lowered.as_text().splitlines() if "stablehlo.select" in line]
    assert chosen
    assert not [line for line in chosen if str(many) in line]
    peaks, gradients = lowered.compile()(samples)
    assert np.all(peaks > 0.05)
    single = jax.jit(jax.grad(peak))
    for own, gradient in zip(samples, gradients, strict=True):
        assert np.abs(gradient).max() > 1e-3
        np.testing.assert_allclose(gradient, single(own), rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_history_can_be_differentiated():
    podium = PODIUMS["rigid"]
    t = np.array([-0.2, 0.3, 0.9, 1.6, 2.4])

    def rotation(a_p):
        o = options(1e-10, "dopri8", history=512)
        return rj.simulate(podium, rj.Ricker(a_p, 1.0), t_end=2.5, options=o)(t).theta

    a_p = 2.5 * G * 0.15
    forward, reverse = jax.jacfwd(rotation)(a_p), jax.jacrev(rotation)(a_p)
    h = 1e-4
    numeric = (
        8 * (rotation(a_p + h) - rotation(a_p - h)) - (rotation(a_p + 2 * h) - rotation(a_p - 2 * h))
    ) / (12 * h)
    np.testing.assert_allclose(forward, numeric, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)


@pytest.mark.slow
def test_grazing_and_hopeless_scenes_give_finite_derivatives():
    """Derivatives grow near grazing impacts but are never NaN, also for scenes that never lift or that
    overturn."""
    for name in ("rigid", "elastic"):
        podium = PODIUMS[name]

        @jax.jit
        @jax.vmap
        def slopes(a_p, podium=podium):
            peak = lambda a: rj.peak_response(podium, rj.Ricker(a, 1.1))
            return jax.grad(lambda a: peak(a).peak_rotation)(a_p), peak(a_p).smallest_impact_speed

        gradient, speed = slopes(jnp.linspace(0.0, 5.0, 60) * G * 0.15)
        assert np.all(np.isfinite(gradient))
        assert np.all(np.asarray(speed) > 0)


def test_gradients_under_jit_and_vmap_are_the_same():
    podium = PODIUMS["rigid"]
    f = lambda alpha: (
        rj.peak_response(
            podium.replace(alpha=alpha), rj.Ricker(3.3, 1.0), options=options(1e-9)
        ).peak_rotation
    )
    alphas = jnp.array([0.14, 0.15, 0.16])
    one_by_one = [float(jax.grad(f)(a)) for a in alphas]
    np.testing.assert_allclose(jax.jit(jax.vmap(jax.grad(f)))(alphas), one_by_one, rtol=1e-7)


def test_second_derivatives_are_refused():
    f = lambda a: rj.peak_response(PODIUMS["rigid"], rj.Ricker(a, 1.0)).peak_rotation
    with pytest.raises(NotImplementedError, match="first derivatives only"):
        jax.grad(jax.grad(f))(3.0)
    o = rj.Options(engine="segments")
    with pytest.raises(NotImplementedError, match="engine='flat'"):
        jax.grad(lambda a: rj.peak_response(PODIUMS["rigid"], rj.Ricker(a, 1.0), options=o).peak_rotation)(
            3.0
        )


@pytest.mark.slow
def test_a_short_scene_beside_a_long_one_has_its_gradient_by_samples():
    """Lanes whose scene has ended continue with the others; their values must not affect the gradient."""
    o = options(1e-4, "bosh3", max_steps=800, outputs=("peak_shear",))

    def shear(samples):
        return rj.peak_response(PODIUMS["elastic"], rj.Record(samples, 0.1), options=o).peak_shear

    samples = shaking(24, 0.1).acceleration
    several = jnp.stack([samples, 0.1 * samples, 0.0 * samples, 2.0 * samples])
    gradients = jax.jit(jax.vmap(jax.grad(shear)))(several)
    assert np.all(np.isfinite(gradients))
    one = jax.jit(jax.grad(shear))
    for k in (0, 3):
        np.testing.assert_allclose(gradients[k], one(several[k]), rtol=1e-8, atol=1e-12)
