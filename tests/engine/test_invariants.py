"""Properties of all structures and motions, tested with random ones.

Two solutions of a scene may differ by the estimated errors.
"""

import math
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import rockjax as rj
from rockjax._engine import model
from rockjax._engine.coefficients import coefficients
from rockjax._engine.energy import energy
from tests.scenes import shaking

OPTIONS = rj.Options(
    rtol=1e-9,
    atol=1e-11,
    outputs=("peak_rotation", "peak_deformation", "peak_shear", "errors"),
    throw=False,
    max_steps=100_000,
)
KINDS = ("none", "rigid", "elastic")
# Random values may be valid but implausible, such as 455 g.
pytestmark = pytest.mark.filterwarnings("ignore::rockjax.PlausibilityWarning")


def examples(count):
    return settings(
        max_examples=count,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=[HealthCheck.too_slow],
    )


def numbers(low, high):
    """Return a strategy for numbers between two positive bounds, uniform in the logarithm."""
    return st.floats(0, 1).map(lambda u: low * (high / low) ** u)


def podiums(kind, law=None):
    eta, gamma = (st.one_of(st.just(0.0), numbers(1e-2, 200.0)) for _ in range(2))
    zeta = st.sampled_from([0.0, 0.02, 0.3, 1.0])
    top = {
        "none": st.none(),
        "rigid": st.builds(rj.Rigid, eta),
        "elastic": st.builds(rj.Elastic, eta, numbers(0.05, 3.0), zeta),
    }[kind]
    e = st.one_of(st.sampled_from([0.0, 1.0]), st.floats(0.2, 0.99)) if law is None else st.just(law)
    return st.builds(rj.Podium, numbers(0.03, 0.9), numbers(0.2, 20.0), gamma, top, st.floats(0.0, 1.0), e)


@st.composite
def scenes(draw, kind, motion=rj.Ricker, law=None):
    podium = draw(podiums(kind, law))
    a_p = float(podium.uplift_acceleration) * draw(numbers(0.9, 8.0))
    return podium, motion(a_p, 2 * math.pi / (float(podium.p) * draw(numbers(0.5, 10.0))))


def solve(podium, motion, options=OPTIONS, **more):
    peak = rj.peak_response(podium, motion, options=options, **more)
    assume(peak.result in (rj.RESULTS.settled, rj.RESULTS.end_of_time, rj.RESULTS.overturned))
    return peak


def assert_same(a, b, length=1.0):
    """Check that two solutions of a scene agree within ten times their estimated errors."""
    if bool(a.errors.undecided) or bool(b.errors.undecided):
        return
    assert bool(a.overturned) == bool(b.overturned)
    for name, factor in (("peak_rotation", 1.0), ("peak_deformation", length), ("peak_shear", 1.0)):
        x, y = float(getattr(a, name)), float(getattr(b, name))
        doubt = 10 * (float(getattr(a.errors, name)) + float(getattr(b.errors, name)) / factor)
        assert x == pytest.approx(y / factor, abs=doubt + 1e-9 * abs(x) + 1e-12)


@pytest.mark.slow(but=["rigid"])
@pytest.mark.parametrize("kind", KINDS)
def test_mirrored_motion_mirrors_the_response(kind):
    @examples(25)
    @given(scenes(kind))
    def check(scene):
        podium, motion = scene
        a, b = solve(podium, motion), solve(podium, motion.scaled(-1.0))
        for name in (
            "peak_rotation",
            "peak_rotation_time",
            "peak_deformation",
            "peak_shear",
            "uplift_time",
            "impacts",
        ):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))

    check()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rigid", "elastic"])
def test_time_has_no_origin(kind):
    record = shaking(120, peak=1.0)

    @examples(15)
    @given(podiums(kind), numbers(1.0, 6.0), st.floats(-50.0, 50.0))
    def check(podium, factor, shift):
        scale = factor * float(podium.uplift_acceleration)
        here, there = (rj.Record(record.acceleration, 0.02, scale, t) for t in (0.0, shift))
        a, b = solve(podium, here), solve(podium, there)
        assert_same(a, b)
        if bool(a.uplifted) and not bool(a.errors.undecided):
            assert float(a.uplift_time) + shift == pytest.approx(
                float(b.uplift_time), abs=1e-6 / float(podium.p)
            )

    check()


@pytest.mark.parametrize("kind", KINDS)
def test_lengths_times_and_gravity_scale_together(kind):
    @examples(20)
    @given(scenes(kind), numbers(0.1, 10.0), numbers(0.1, 10.0))
    def check(scene, length, time):
        podium, motion = scene
        top = podium.superstructure
        if kind == "elastic":
            top = rj.Elastic(top.eta, top.T_s * time, top.zeta)
        big = podium.replace(R=podium.R * length, superstructure=top, g=podium.g * length / time**2)
        assert_same(
            solve(podium, motion),
            solve(big, rj.Ricker(motion.a_p * length / time**2, motion.T_p * time)),
            length,
        )

    check()


@pytest.mark.parametrize("kind", ["none", "rigid"])
def test_a_frame_is_its_equivalent_block(kind):
    @examples(25)
    @given(scenes(kind))
    def check(scene):
        podium, motion = scene
        a, b = (solve(p, motion) for p in (podium, podium.equivalent_block()))
        if not (bool(a.errors.undecided) or bool(b.errors.undecided)):
            doubt = 10 * float(a.errors.peak_rotation + b.errors.peak_rotation)
            assert float(a.peak_rotation) == pytest.approx(float(b.peak_rotation), abs=doubt + 1e-9)

    check()


@st.composite
def pushed(draw, kind):
    """Return free rocking from a random state inside the potential well."""
    podium = draw(podiums(kind))
    alpha, p = float(podium.alpha), float(podium.p)
    theta = draw(st.floats(-0.8, 0.8)) * alpha
    sway = draw(st.floats(-1.0, 1.0)) * float(podium.width)
    return podium, rj.State(
        theta, draw(st.floats(-0.3, 0.3)) * p * alpha, sway, draw(st.floats(-1.0, 1.0)) * p * sway
    )


@pytest.mark.slow(but=["none"])
@pytest.mark.parametrize("kind", ["none", "elastic"])
def test_without_shaking_energy_only_falls(kind):
    """Energy decreases between impacts by the damper and at each impact by Eq. (27). The columns never enter
    the ground: while σ = ±1, σθ ≥ 0."""

    @examples(15)
    @given(pushed(kind))
    def check(scene):
        podium, initial = scene
        end = 12 / float(podium.p)
        options = OPTIONS.replace(rtol=1e-10, atol=1e-12, rest_velocity=1e-8, history=16384)
        response = rj.simulate(podium, rj.Rest(), initial=initial, t_end=end, options=options)
        assume(response.result != rj.RESULTS.out_of_steps)
        nodes = response.nodes
        c = coefficients(podium)
        E = np.asarray(jax.vmap(lambda s, x, v: energy(c, s, x, v))(nodes.sigma, nodes.x, nodes.v))
        scale = E.max()
        assert np.all(np.diff(E) <= 1e-8 * scale + 1e-15)
        # Subnormal angles are replaced by zero.
        assert np.all(np.asarray(nodes.sigma) * np.asarray(nodes.x[0]) >= -1e-300)
        hits = np.asarray(response.impact_times)[:3]
        before, after = response(hits, left=True), response(hits)
        e = max(float(podium.restitution_factor), 0.0)
        fast = np.abs(np.asarray(before.theta_dot)) > 1e-3 * float(podium.p * podium.alpha)
        np.testing.assert_allclose(after.theta_dot[fast], e * before.theta_dot[fast], rtol=1e-5, atol=1e-12)

    check()


def test_restitution_compatible_with_a_rigid_superstructure():
    """With the compatible law, the angular momentum after vibrations have decayed equals that of Rigid."""

    @examples(100)
    @given(podiums("elastic", "compatible"))
    def check(podium):
        s2, lam = math.sin(float(podium.alpha)) ** 2, float(podium.lam)
        gamma, eta = float(podium.gamma), float(podium.superstructure.eta)
        e = float(podium.restitution_factor)
        all_of_it = 1 + lam + 4 * gamma + 4 * eta
        moving = (all_of_it - 4 * eta * (1 - s2)) * e + 4 * eta * (1 - s2)
        for law in ("paper", "compatible"):
            rigid = podium.replace(superstructure=rj.Rigid(eta), restitution=law)
            assert moving / all_of_it == pytest.approx(float(rigid.restitution_factor), abs=1e-12)

    check()


def test_uplifted_frequency_of_the_linearised_engine():
    """Eqs. (30) and (31) follow from the derivative of the engine's equations of motion at rest on the
    edge."""

    @jax.jit
    def stiffness(podium):
        c = coefficients(podium)

        def accelerations(x):
            still = (jnp.zeros(()), jnp.zeros(()))
            return jnp.stack(model.acceleration(c, jnp.ones(()), jnp.zeros(()), (x[0], x[1]), still))

        def relative(x):  # in terms of θ and the deformation
            return jnp.stack([x[0], x[1] - model.beam(c, jnp.ones(()), x[0], jnp.zeros(()))[0]])

        to = jax.jacfwd(relative)(jnp.zeros(2))
        return to @ jax.jacfwd(accelerations)(jnp.zeros(2)) @ jnp.linalg.inv(to)

    @examples(50)
    @given(podiums("elastic"))
    def check(podium):
        fast = podium.replace(superstructure=rj.Elastic(podium.superstructure.eta, 1e-4 / podium.p, 0.0))
        K = np.asarray(stiffness(fast))
        assert -K[1, 1] == pytest.approx(float(fast.uplifted_frequency) ** 2, rel=1e-6)

    check()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_batch_single_and_reversed_order_agree(kind):
    """The order of batches is also in `tests/batch/test_batch.py`, and single scenes are compared with
    batches in `tests/studies/test_spectra.py` and `test_joint_outputs.py`."""

    @examples(4)
    @given(st.lists(scenes(kind), min_size=12, max_size=12))
    def check(some):
        stacked, motions = jax.tree.map(lambda *y: jnp.stack(y), *some)
        batch = rj.peak_responses(stacked, motions, options=OPTIONS)
        flip = lambda tree: jax.tree.map(lambda y: y[::-1], tree)
        reverse = flip(rj.peak_responses(flip(stacked), flip(motions), options=OPTIONS))
        np.testing.assert_array_equal(batch.peak_rotation, reverse.peak_rotation)
        np.testing.assert_array_equal(batch.errors.undecided, reverse.errors.undecided)
        for k, (podium, motion) in enumerate(some):
            place = jax.tree.map(lambda y, k=k: y[k], batch)
            if place.result != rj.RESULTS.out_of_steps:
                assert_same(rj.peak_response(podium, motion, options=OPTIONS), place)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # some scenes run out of steps
        check()


@pytest.mark.parametrize("kind", KINDS)
def test_tolerances_converge_and_estimates_hold(kind):
    """The error at a large tolerance is nearly always within ten times its estimate, and every changed
    outcome is flagged."""
    outside, flips = [], []

    @examples(40)
    @given(scenes(kind), st.sampled_from([1e-4, 1e-6, 1e-8]))
    def check(scene, rtol):
        loose = solve(*scene, OPTIONS.replace(rtol=rtol, atol=0.01 * rtol))
        fine = solve(*scene, OPTIONS.replace(rtol=1e-12, atol=1e-14))
        if bool(loose.overturned) != bool(fine.overturned):
            flips.append(not bool(loose.errors.undecided))
            return
        error = abs(float(loose.peak_rotation) - float(fine.peak_rotation))
        outside.append(error > 10 * float(loose.errors.peak_rotation) + 1e-12)
        assert error < 3e3 * rtol or bool(loose.errors.undecided)

    check()
    assert sum(outside) <= 1
    assert not any(flips)


@pytest.mark.slow
def test_forward_and_reverse_derivatives_agree():
    def rotation(y):
        podium = rj.Podium(y[0], y[1], y[2], rj.Elastic(y[3], y[4], 0.05), restitution=0.9)
        options = OPTIONS.replace(outputs=("peak_rotation",))
        return rj.peak_response(podium, rj.Ricker(y[5], y[6]), options=options).peak_rotation

    forward, reverse = jax.jit(jax.jacfwd(rotation)), jax.jit(jax.jacrev(rotation))

    @examples(15)
    @given(scenes("elastic"))
    def check(scene):
        podium, motion = scene
        top = podium.superstructure
        y = jnp.stack([podium.alpha, podium.R, podium.gamma, top.eta, top.T_s, motion.a_p, motion.T_p])
        a, b = forward(y), reverse(y)
        assert np.all(np.isfinite(a))
        np.testing.assert_allclose(b, a, rtol=1e-7, atol=1e-9 * float(np.abs(a).max()))

    check()
