"""Skipped samples of records, and skipped bounces."""

import dataclasses
import functools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import rockjax as rj
from rockjax._batch.batch import run_batch
from rockjax._batch.scenes import broadcast
from rockjax._engine.coefficients import coefficients
from rockjax._engine.fast_forward.samples import skip_sample, skip_samples
from rockjax._engine.model import acceleration
from rockjax._engine.runge_kutta import step
from rockjax._engine.scene import plan_for, prepare
from rockjax._engine.step import trial
from rockjax._engine.tableaus import nystrom, tableau
from rockjax._outputs.joint_samples import SampleForces
from rockjax._outputs.joints import end_forces
from rockjax._outputs.views import Moment, Sample
from rockjax._responses.estimate import second_options
from tests.scenes import PODIUMS, G

# With a number for the restitution, all values of it share programs.
PODIUM = PODIUMS["rigid"].replace(restitution=float(PODIUMS["rigid"].restitution_factor))
OUTPUTS = ("peak_rotation", "peak_shear", "margin")
USUAL = rj.Options(outputs=OUTPUTS)
# With methods of lower order no samples are skipped.
EVERY = rj.Options(method="tsit5", rtol=1e-12, atol=1e-14, outputs=(*OUTPUTS, "impacts"))


def records(count=6, samples=1500, dt=0.01):
    rows = [
        np.asarray(motion.acceleration)[:samples] for motion in rj.synthetic_motions(count, seed=5, dt=dt)
    ]
    return rj.Records.of([rj.Record(row * 0.15 * G / np.abs(row).max(), dt) for row in rows])


def scenes():
    """Return scenes that never lift, scenes that rock for long, and scenes that overturn."""
    return records().pick(np.arange(6)[:, None]).scaled(np.array([0.8, 1.2, 1.6, 2.2, 3.0, 5.0, 9.0]))


def test_the_nystrom_method_is_of_its_order():
    """The test equation is θ̈ = −(sin(α − θ) + g(t) cos(α − θ)); the error estimate is that of a method two
    orders lower."""

    def field(t, x, v):
        return (-(jnp.sin(0.2 - x[0]) + (0.3 - 0.4 * t) * jnp.cos(0.2 - x[0])),)

    def state_and_error(method, n):
        x, v, estimate = (jnp.asarray(0.1),), (jnp.asarray(0.3),), 0.0
        for t in np.arange(n) / n:
            new = step(method, field, t, jnp.asarray(1 / n), x, v, field(t, x, v))
            x, v, estimate = new.x, new.v, max(estimate, abs(float(new.v_error[0])))
        return np.array([x[0], v[0]]), estimate

    exact, _ = state_and_error(tableau(diffrax.Dopri8()), 64)
    (coarse, first), (fine, second) = state_and_error(nystrom(), 2), state_and_error(nystrom(), 4)
    assert np.log2(np.abs(coarse - exact) / np.abs(fine - exact)).min() > 7.4
    assert 6.4 < np.log2(first / second) < 7.8  # error of one step, h⁷


def test_peaks_are_those_with_a_trial_of_every_sample():
    motions = scenes()
    found = rj.peak_responses(PODIUM, motions, options=USUAL)
    expected = rj.peak_responses(PODIUM, motions, options=EVERY)
    np.testing.assert_array_equal(found.overturned, expected.overturned)
    assert 3 < found.overturned.sum() < 39
    assert (~found.uplifted).any()
    for name in OUTPUTS:
        # After many impacts the errors of both solutions grow.
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-6, atol=1e-8)
        off = np.abs(np.asarray(getattr(found, name)) - np.asarray(getattr(expected, name)))
        assert np.median(off) < 1e-11


def test_most_samples_are_passed():
    motions, podium = scenes(), PODIUM
    batch, _ = broadcast("test", podium, motions, jax.tree.map(np.asarray, rj.State()), None)
    _, integers, tally = run_batch(batch, USUAL, False)
    assert integers["steps"].sum() > 5000
    assert tally.useful < 0.5 * integers["steps"].sum()


@pytest.mark.slow(but=["rigid"])
@pytest.mark.parametrize("name", ["rigid", "elastic"])
def test_most_impacts_are_landed_on_at_once(name):
    """Few trials are rejected to find impacts, and the impacts agree with those of other steps."""
    podium = PODIUM if name == "rigid" else PODIUMS[name]

    how = USUAL.replace(outputs=(*OUTPUTS, "impacts"), rest_velocity=1e-8)
    found = rj.peak_responses(podium, scenes(), options=how)
    rejected, impacts = found.stats.rejected.sum(), found.impacts.sum()
    assert impacts > 5000
    assert rejected < 0.1 * impacts
    if name == "rigid":
        expected = rj.peak_responses(podium, scenes(), options=EVERY.replace(rest_velocity=1e-8))
        np.testing.assert_array_equal(found.impacts, expected.impacts)


@pytest.mark.slow(but=["rigid"])
@pytest.mark.parametrize("name", ["rigid", "elastic"])
def test_under_pulses_as_well_where_all_impacts_are_wanted(name):
    podium = PODIUM if name == "rigid" else PODIUMS[name]
    amplitude = np.linspace(1.2, 4.0, 8) * G * np.tan(podium.alpha)
    pulses = rj.Ricker(amplitude[:, None], 2 * np.pi / (podium.p * np.linspace(1.5, 6.0, 8)))

    def count(**options):
        how = rj.Options(outputs=("peak_rotation", "impacts"), **options)
        return rj.peak_responses(podium, pulses, options=how)

    found = count()
    assert found.impacts.sum() > 5000
    assert found.stats.rejected.sum() < 0.15 * found.impacts.sum()
    closer = count(rest_velocity=rj.Options().rtol, rtol=1e-11, atol=1e-13)
    np.testing.assert_array_equal(found.impacts, closer.impacts)


def start(motion, options=USUAL):
    podium = PODIUM.split_rows()
    plan = plan_for(podium, options, history=False)
    return plan, *prepare(podium, motion, rj.State(), None, options, plan)


def with_shear(plan, state, shear):
    """Return the accumulators with another shear."""
    names = [output.name for output in plan.outputs]
    return tuple(
        jnp.asarray(shear) if name == "peak_shear" else accumulator
        for name, accumulator in zip(names, state.accumulators, strict=True)
    )


def rocking(motion, options=USUAL):
    """Return the scene some trials after its uplift, where samples can be skipped."""
    plan, scene, state = start(motion, options)
    i = int(np.argmax(np.abs(np.asarray(motion.acceleration)) > 0.2 * G)) + 1
    at = float(motion.dt) * i
    state = state._replace(
        t=jnp.asarray(at),
        event_time=jnp.asarray(at),
        x=(jnp.asarray(0.03),),
        v=(jnp.asarray(0.2),),
        sigma=jnp.asarray(1.0),
        piece=jnp.asarray(i + 1, state.piece.dtype),
        accumulators=with_shear(plan, state, 9.0),
        may_skip=jnp.asarray(True),
    )
    return plan, scene, state


def one(samples=400, dt=0.01, scale=2.0):
    row = np.asarray(rj.synthetic_motions(1, seed=5, dt=dt)[0].acceleration)[:samples]
    return rj.Record(row * scale * 0.15 * G / np.abs(row).max(), dt)


def test_a_sample_that_is_passed_is_a_trial_that_meets_nothing():
    plan, scene, state = rocking(one())
    onward = jax.jit(functools.partial(skip_sample, scene, plan))
    passed, ahead = 0, onward(state)
    while ahead.may_skip:
        after, info = trial(scene, plan, state)
        passed += 1
        assert info.accepted
        for name in ("t", "event_time", "x", "v", "sigma", "piece", "impacts", "steps"):
            np.testing.assert_allclose(getattr(ahead, name), getattr(after, name), rtol=1e-12)
        state, ahead = ahead, onward(ahead)
    assert 5 < passed < 200
    assert ahead.t == state.t
    all_of_them = skip_samples(scene, plan, rocking(one())[2])
    assert all_of_them.t == state.t
    assert not all_of_them.may_skip


@pytest.mark.parametrize(
    "change",
    [
        {"x": 0.0005, "v": -0.3},  # an impact before the next sample
        {"x": 0.1499, "v": 0.5},  # overturning
        {"x": 0.03, "v": 1e-4},  # a turning point
        {"shear": 1e-3},  # a larger shear
        {"may_skip": False},
        {"piece": 399},  # up to the last sample, after which the ground rests
    ],
)
def test_samples_at_which_something_happens_are_not_passed(change):
    plan, scene, state = rocking(one())
    values = {
        name: (jnp.asarray(y),) if name in "xv" else jnp.asarray(y, jnp.asarray(getattr(state, name)).dtype)
        for name, y in change.items()
        if name != "shear"
    }
    state = state._replace(**values)
    if "shear" in change:
        state = state._replace(accumulators=with_shear(plan, state, change["shear"]))
    if (
        "v" in change and change["v"] == 1e-4
    ):  # from increasing to decreasing rotation, for either sign of the ground motion
        a = trial(scene, plan, state)[0].v[0] - 1e-4
        state = state._replace(v=(-jnp.sign(a) * 1e-4,))
    ahead = skip_sample(scene, plan, state)
    assert not ahead.may_skip
    for name in ("t", "x", "v", "piece", "steps"):
        np.testing.assert_array_equal(getattr(ahead, name), getattr(state, name))


def test_coarse_samples_are_left_to_the_method():
    """Coarse samples use ordinary trials if the error of a step exceeds the tolerance, and in the second
    solution of an estimate."""
    motion = one(dt=0.01)
    coarse = dataclasses.replace(motion, dt=jnp.asarray(0.4))
    fine = rj.Options(rtol=1e-13, atol=1e-15, outputs=OUTPUTS)
    assert rocking_passes(motion, USUAL)
    assert not rocking_passes(coarse, fine)
    assert not rocking_passes(motion, second_options(USUAL))
    assert start(motion, EVERY)[2].may_skip is None
    assert start(rj.Ricker(3.0, 1.0))[2].may_skip is None


def rocking_passes(motion, options):
    plan, scene, state = rocking(motion, options)
    return bool(skip_sample(scene, plan, state).may_skip)


def test_derivatives_are_those_with_a_trial_of_every_sample():
    row = np.asarray(records(3, 900).acceleration)[1] * 1.7

    def peaks(numbers, how):
        alpha, R, scale, dt, begin = numbers
        podium = PODIUM.replace(alpha=alpha, R=R)
        found = rj.peak_response(podium, rj.Record(row, dt, scale=scale, t_start=begin), options=how)
        return jnp.stack([found.peak_rotation, found.peak_shear, found.margin, found.peak_rotation_time])

    at = jnp.array([0.15, 1.5, 1.1, 0.01, 0.3])
    found = jax.jacfwd(peaks)(at, USUAL)
    expected = jax.jacfwd(peaks)(at, EVERY)
    assert np.abs(expected).max() > 10
    scale = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=1e-6, atol=1e-8)
    h = 1e-6 * np.asarray(at)
    for k in (0, 2, 3):
        ahead, back = (peaks(at.at[k].add(sign * h[k]), EVERY) for sign in (1, -1))
        numeric = np.asarray(ahead - back) / (2 * h[k])
        np.testing.assert_allclose(found[:, k] / scale[:, 0], numeric / scale[:, 0], atol=1e-4)


@pytest.mark.slow
def test_sensitivities_of_a_batch_are_derivatives_of_its_scenes():
    motions = records(3, 900).pick(np.array([0, 1, 2])).scaled(np.array([1.5, 1.9, 1.3]))
    how = rj.Options(outputs=("peak_rotation", "margin"))
    batch = rj.peak_responses(PODIUM, motions, options=how, sensitivities=["alpha", "R"])
    for k in range(3):

        def peak(factors, k=k):
            podium = PODIUM.replace(alpha=PODIUM.alpha * factors[0], R=PODIUM.R * factors[1])
            motion = motions.pick(np.asarray(k)).scaled(motions.scale[k])
            return rj.peak_response(podium, motion, options=how).peak_rotation

        expected = np.asarray(jax.jacfwd(peak)(jnp.ones(2)))
        np.testing.assert_allclose(batch.sensitivities.peak_rotation[k], expected, rtol=1e-9, atol=1e-11)


@pytest.mark.slow
def test_derivatives_by_all_samples_are_those_by_their_scale():
    record = one(300, scale=1.9)

    def peak(samples, scale):
        found = rj.peak_response(PODIUM, rj.Record(samples, 0.01, scale=scale), options=USUAL)
        return found.peak_shear + found.margin

    samples = np.asarray(record.acceleration)
    by_scale = float(jax.grad(peak, 1)(samples, 1.0))
    assert abs(by_scale) > 0.1
    assert float(jax.grad(peak)(samples, 1.0) @ samples) == pytest.approx(by_scale, rel=1e-7)


@pytest.mark.parametrize("restitution", ["usual", 0.97])
def test_bounces_that_are_not_followed_change_nothing(restitution):
    """Compare with options that count impacts, with which no bounce is skipped."""
    podium = PODIUM if restitution == "usual" else PODIUM.replace(restitution=float(restitution))
    motions = scenes()
    found = rj.peak_responses(podium, motions, options=USUAL)
    counted = rj.peak_responses(podium, motions, options=USUAL.replace(outputs=(*OUTPUTS, "impacts")))
    np.testing.assert_array_equal(found.overturned, counted.overturned)
    # Some scenes amplify rounding by 10⁸, as another method shows.
    other = rj.peak_responses(podium, motions, options=EVERY)
    for name in (*OUTPUTS, "peak_rotation_time", "uplift_time", "overturn_time"):
        ours, theirs, others = (np.asarray(getattr(y, name)) for y in (found, counted, other))
        expected = np.isfinite(theirs)
        np.testing.assert_array_equal(np.isfinite(ours), expected)
        np.testing.assert_array_equal(np.isfinite(others), expected)
        off, unsure = np.abs(ours - theirs)[expected], np.abs(theirs - others)[expected]
        assert (off <= 1e-12 + 1e-9 * np.abs(theirs[expected]) + 0.1 * unsure).all(), name
        assert np.median(unsure) < 1e-9
    assert found.stats.steps.sum() < counted.stats.steps.sum()
    # Impacts of overturned scenes are counted too, except one or two of each skipped series.
    counts = (np.asarray(y.impacts)[found.overturned] for y in (found, counted))
    np.testing.assert_allclose(*counts, rtol=0.05, atol=2)
    slowest = np.asarray(found.smallest_impact_speed), np.asarray(counted.smallest_impact_speed)
    both = np.isfinite(slowest[1])
    assert both.any()
    rest = 1e-8 * np.sqrt(0.75 * G / float(podium.R)) * float(podium.alpha)
    np.testing.assert_allclose(slowest[0][both], slowest[1][both], rtol=1e-8, atol=2 * rest)


@pytest.mark.slow
def test_rough_records_have_the_peaks_of_another_method():
    """Two thousand scenes of coarse noise, some with an initial rotation: columns are lifted by jumps, turn
    twice within a sample, graze the ground, or bounce before the next uplift."""
    count, rng = 2000, np.random.default_rng(1)
    draw = functools.partial(rng.uniform, size=count)
    alpha, gamma = draw(0.05, 0.5), rng.choice([0.01, 0.5, 2.0, 10.0, 50.0], count)
    podium = rj.Podium(
        alpha=alpha,
        R=10 ** draw(-0.3, 1),
        gamma=gamma,
        superstructure=rj.Rigid(10 ** draw(-1, 2)),
        restitution=draw(0.3, 0.98),
    )
    noise = [np.convolve(rng.normal(size=208), np.hanning(9), "valid") for _ in range(40)]
    rows = [
        row / np.abs(row).max() + (rng.uniform(-0.3, 0.3) if k % 3 == 0 else 0.0)
        for k, row in enumerate(noise)
    ]
    strength = draw(0.9, 6) * rng.choice([-1, 1], count) * np.asarray(podium.uplift_ground_acceleration)
    table = rj.Records.of([rj.Record(row, 0.02) for row in rows])
    motions = table.pick(rng.integers(0, 40, count)).scaled(strength)
    turned = np.where(draw(0, 1) < 0.4, alpha * 10 ** draw(-8, -0.3) * rng.choice([-1, 1], count), 0.0)
    answer = functools.partial(rj.peak_responses, podium, motions, initial=rj.State(theta=turned))
    found, expected = (
        answer(options=each)
        for each in (USUAL.replace(rtol=1e-10, atol=1e-12), EVERY.replace(outputs=OUTPUTS))
    )
    np.testing.assert_array_equal(found.overturned, expected.overturned)
    for name in (*OUTPUTS, "peak_rotation_time", "uplift_time", "overturn_time"):
        ours, theirs = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-8, err_msg=name)


@pytest.mark.parametrize("theta", [0.1, 1.3])
def test_bounds_on_the_curvature_of_joint_forces(theta):
    """The bounds hold for a superstructure that hangs below the beam, and beyond 2α. The motion is solved by
    SciPy with a ground acceleration that is linear in time."""
    elevation = rj.Elevation((-3.0, 3.0), 0.6, -8.0)
    podium = rj.Podium(0.15, 1.5, 10.0, rj.Rigid(40.0), elevation=elevation)
    c = coefficients(podium.split_rows().resolved(), 1e-8, False, True)
    h, sigma, n = 0.02, jnp.ones(()), 32
    ground = lambda t: 1.0 - 0.3 * t / h

    @jax.jit
    def at(t, x, v):
        a = acceleration(c, sigma, ground(t), (x,), (v,))
        return a[0], jnp.stack(end_forces(Moment(c, sigma, t, ground(t), (x,), (v,), a)))

    times = np.linspace(0.0, h, n + 1)
    rate = lambda t, y: [y[1], float(at(t, *y)[0])]
    motion = solve_ivp(
        rate, (0.0, h), [theta, 0.2], method="DOP853", t_eval=times, rtol=1e-13, atol=1e-15, max_step=h / n
    ).y
    acceleration_of, forces = (np.asarray(y) for y in jax.vmap(at)(times, *motion))
    ends = [
        (jnp.asarray(ground(times[k])), *((jnp.asarray(y[k]),) for y in (*motion, acceleration_of)))
        for k in (0, n)
    ]
    bounds = SampleForces.from_sample(Sample(c, sigma, jnp.asarray(h), *ends)).curvature
    row = [y for joints in (*bounds.tangential, *bounds.axial) for y in joints]
    found = np.abs(np.diff(forces, 2, axis=0)).max(axis=0) * n**2
    assert found.min() > 1e-6
    assert np.all(found <= np.asarray([*row, bounds.foundation]) * (1 + 1e-6))
