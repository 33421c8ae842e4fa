"""Conventions for special cases."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from tests import restrained
from tests.scenes import ALPHA, PODIUMS, G, elastic, options, pulse

BLOCK = PODIUMS["block"]
UPLIFT = float(BLOCK.uplift_acceleration)


@pytest.mark.parametrize("podium", [BLOCK, PODIUMS["rigid"], PODIUMS["elastic"]])
def test_touching_the_threshold_is_not_uplift(podium):
    if isinstance(podium.superstructure, rj.Elastic):
        podium = podium.replace(superstructure=rj.Elastic(0.0, 0.5))  # q = ü_g
    up = float(podium.uplift_acceleration)
    for factor, lifts in ((1 - 1e-9, False), (1.0, False), (1 + 1e-6, True)):
        peak = rj.peak_response(podium, rj.Ricker(up * factor, 1.0))
        assert bool(peak.uplifted) is lifts
        assert math.isnan(float(peak.uplift_time)) is not lifts
    assert float(peak.peak_rotation) < 1e-6


def test_a_slow_ground_acceleration_lifts_at_g_tan_alpha():
    """The spring transmits the inertia of the top mass to the beam, so the demand is ten times the ground
    acceleration."""
    podium = elastic(0.5)
    ground = float(podium.uplift_ground_acceleration)
    assert ground == pytest.approx(G * 0.15, rel=1e-12)
    assert float(podium.uplift_acceleration) > 10 * ground
    outputs = rj.Options(outputs=("peak_rotation",))
    peaks = [
        rj.peak_response(podium, rj.Ricker(ground * factor, 100.0), options=outputs)
        for factor in (0.999, 1.003)
    ]
    assert [bool(peak.uplifted) for peak in peaks] == [False, True]
    assert float(peaks[0].impacts) == 0  # it never lifts, so the count is known
    swaying = rj.peak_response(
        podium, rj.OneCosine(0.6 * ground, 10.0), options=outputs
    )  # starts with a jump
    assert swaying.uplifted


@pytest.mark.parametrize("podium", [BLOCK, elastic(0.5)])
def test_a_jump_above_the_threshold_lifts_at_once(podium):
    up = float(podium.uplift_acceleration)
    peak = rj.peak_response(podium, rj.OneCosine(1.2 * up, 0.8))
    assert float(peak.uplift_time) == 0.0
    record = rj.Record(1.2 * up * np.ones(20), 0.01)
    assert float(rj.peak_response(podium, record).uplift_time) == 0.0
    late = rj.Record(np.r_[np.zeros(5), 1.2 * up * np.ones(20)], 0.01)
    assert 0.04 < float(rj.peak_response(podium, late).uplift_time) < 0.05


@pytest.mark.slow(but=["dopri8"])
@pytest.mark.parametrize("method", ["tsit5", "dopri8"])
def test_a_short_excursion_above_the_threshold_is_found(method):
    """The demand exceeds q_up for a few milliseconds, with a tolerance that allows long steps."""
    for podium in (BLOCK, elastic(0.5, eta=0.0)):
        up = float(podium.uplift_acceleration)
        motion = rj.Ricker(up * (1 + 1e-5), 1.0)
        rough = rj.Options(rtol=1e-3, atol=1e-4, method=method, outputs=("peak_rotation", "impacts"))
        peak = rj.peak_response(podium, motion, options=rough)
        assert bool(peak.uplifted)
        assert int(peak.impacts) >= 1


def test_a_lift_and_landing_inside_one_step_is_found():
    """Many tiny hops: the first ones are counted with large and small tolerances alike."""
    podium = elastic(0.5)
    loose = rj.simulate(
        podium, pulse(), t_end=0.5, options=rj.Options(rtol=1e-4, atol=1e-6, rest_velocity=1e-8)
    )
    tight = rj.simulate(podium, pulse(), t_end=0.5, options=options(1e-11, "dopri8", rest_velocity=1e-8))
    assert int(loose.impacts) == int(tight.impacts)
    np.testing.assert_allclose(loose.impact_times, tight.impact_times, atol=3e-4)


def test_initial_velocity_on_the_ground_starts_rocking():
    for sign in (1, -1):
        response = rj.simulate(BLOCK, rj.Rest(), initial=rj.State(0.0, sign * 0.2), t_end=3.0)
        assert bool(response.uplifted)
        assert float(response.uplift_time) == 0.0
        assert np.sign(float(response(0.05).theta)) == sign
        v0, c = 0.2, rj._engine.coefficients.coefficients(BLOCK)
        top = 0.5 * float(c.spin) * v0**2 / float(c.weight) + math.cos(0.3)
        assert float(response.peak_rotation) == pytest.approx((0.3 - math.acos(top)) / 0.3, abs=1e-8)


@pytest.mark.parametrize("ratio", [1.0, 1.5])
def test_initial_rotation_at_the_limit_is_overturned(ratio):
    o = rj.Options(overturn_ratio=ratio)
    for theta, at_once in ((0.3 * ratio, True), (-0.31 * ratio, True), (np.nextafter(0.3 * ratio, 0), False)):
        peak = rj.peak_response(BLOCK, rj.Rest(), initial=rj.State(theta), options=o, t_end=1e-6)
        assert (bool(peak.overturned) and float(peak.overturn_time) == 0) is at_once
        assert float(peak.peak_rotation) == pytest.approx(ratio)
        assert int(peak.stats.steps) == 0 or not at_once


def test_a_scene_is_followed_until_it_overturns_at_a_small_ratio():
    """After the first impact this block still passes α/2. Without the rotation among the outputs, the scene
    must not end before."""
    block, initial = rj.Podium(0.25, 1.2), rj.State(theta=1e-3, theta_dot=-0.66)
    solve = lambda *outputs: rj.peak_response(
        block, rj.Rest(), initial=initial, options=rj.Options(outputs=outputs, overturn_ratio=0.5)
    )
    peak, expected = solve("peak_velocity_jump"), solve("peak_rotation")
    assert bool(expected.overturned)
    assert bool(peak.overturned)
    assert float(peak.overturn_time) == pytest.approx(float(expected.overturn_time), rel=1e-12)


def test_joint_forces_of_a_scene_that_starts_overturned_are_unknown():
    tower = rj.Podium(0.3, 1.0, 2.0, elevation=rj.Elevation([-1.0, 1.0]))
    options = rj.Options(outputs=("peak_friction", "axial_force", "peak_foundation_shear"))
    peak = rj.peak_response(tower, rj.Rest(), initial=rj.State(theta=0.31), options=options)
    assert bool(peak.overturned)
    for values in (peak.peak_friction, peak.least_axial_force, peak.peak_axial_force):
        assert np.isnan(values).all()
    assert np.isnan(float(peak.peak_foundation_shear))


def test_past_alpha_and_back():
    """During shaking a column can pass α and return. It is overturned by the paper's criterion, not with a
    larger ratio."""
    motion = rj.OneSine(np.linspace(1, 8, 701) * UPLIFT, 1.0)
    strict = rj.peak_responses(BLOCK, motion)
    lenient = rj.peak_responses(BLOCK, motion, options=rj.Options(overturn_ratio=3.0))
    came_back = strict.overturned & ~lenient.overturned
    assert came_back.any()
    assert np.all(lenient.exceeded_alpha[came_back])
    assert np.all(lenient.peak_rotation[came_back] > 1)
    assert np.all(strict.overturned[lenient.overturned])
    assert np.all(strict.peak_rotation[strict.overturned] == 1.0)
    upright = rj.peak_response(
        BLOCK, rj.OneSine(6.0, 3.0), options=rj.Options(overturn_ratio=math.pi / 2 / 0.3)
    )
    assert bool(upright.overturned)


def test_no_restitution_ends_rocking():
    podium = rj.Podium(alpha=1.2, R=1.0)
    assert float(podium.restitution_factor) < 0
    response = rj.simulate(podium, rj.Rest(), initial=rj.State(0.3), t_end=10.0)
    assert int(response.impacts) == 1
    assert response.result == rj.RESULTS.settled
    assert float(response(9.0).theta) == 0.0


def test_free_rocking_ends_and_does_not_hang():
    """There are infinitely many impacts in finite time; for small amplitudes their times form a geometric
    series."""
    ends = []
    for rest in (1e-4, 1e-6, 1e-8):
        o = rj.Options(rtol=1e-10, atol=1e-12, rest_velocity=rest)
        response = rj.simulate(BLOCK, rj.Rest(), initial=rj.State(0.1), options=o)
        assert response.result == rj.RESULTS.settled
        ends.append(float(response.stats.end_time))
    e = float(BLOCK.restitution_factor)
    flights = np.diff(np.asarray(response.impact_times))
    # at small amplitudes each flight lasts e times as long as the previous one
    np.testing.assert_allclose(flights[-20:] / flights[-21:-1], e, rtol=1e-3)
    limit = ends[2] + flights[-1] * e / (1 - e)
    errors = [abs(limit - t) for t in ends]
    assert errors[1] < 0.02 * errors[0]
    assert errors[2] < 0.02 * errors[1]


def test_no_dissipation_rocks_on():
    podium = BLOCK.replace(restitution=1.0)
    response = rj.simulate(
        podium, rj.Rest(), initial=rj.State(0.1), t_end=30.0, options=options(1e-11, "dopri8")
    )
    assert response.result == rj.RESULTS.end_of_time
    flights = np.diff(np.asarray(response.impact_times))
    np.testing.assert_allclose(flights, flights[0], rtol=1e-7)
    assert float(response.energy(29.9)) == pytest.approx(float(response.energy(0.0)), rel=1e-8)


def test_results_converge_as_the_rest_velocity_vanishes():
    podium = elastic(1.0, eta=10.0)
    motion = pulse(ratio=3.0, T_p=0.9)
    peaks = [
        float(
            rj.peak_response(
                podium, motion, options=options(1e-11, "dopri8", rest_velocity=rest)
            ).peak_rotation
        )
        for rest in (1e-3, 1e-5, 1e-7, 1e-12)
    ]
    errors = np.abs(np.array(peaks[:-1]) - peaks[-1])
    assert errors[1] < 1e-4
    assert errors[2] < 1e-6


def test_an_impact_on_a_breakpoint_counts_once():
    response = rj.simulate(
        BLOCK, rj.Rest(), initial=rj.State(0.1), t_end=3.0, options=options(1e-12, "dopri8")
    )
    first = float(response.impact_times[0])
    for shift in (0.0, 1e-15, -1e-15, 1e-12, -1e-12):
        # a record of zeros with a sample at the impact
        record = rj.Record(np.zeros(41), (first + shift) / 10)
        again = rj.simulate(BLOCK, record, initial=rj.State(0.1), t_end=3.0, options=options(1e-12, "dopri8"))
        assert int(again.impacts) == int(response.impacts)
        np.testing.assert_allclose(again.impact_times, response.impact_times, atol=1e-9)


def test_a_weightless_superstructure_is_driven_but_does_not_act_back():
    top, none = elastic(0.5, eta=0.0), PODIUMS["rigid"].replace(superstructure=None)
    a, b = (rj.simulate(p, pulse(), t_end=3.0, options=options(1e-11)) for p in (top, none))
    t = np.linspace(-2, 3, 101)
    np.testing.assert_allclose(a(t).theta, b(t).theta, atol=1e-10)
    assert float(a.peak_deformation) > 1e-3
    assert float(a.peak_shear) > 0.01
    assert math.isfinite(float(a.peak_shear))


def test_zero_excitation_and_no_excitation():
    for podium in PODIUMS.values():
        for motion in (rj.Ricker(0.0, 1.0), rj.Rest(), rj.Record(np.zeros(5), 0.1)):
            peak = rj.peak_response(podium, motion)
            assert float(peak.peak_rotation) == 0
            assert not bool(peak.uplifted)
            assert int(peak.impacts) == 0
            assert peak.result in (rj.RESULTS.settled, rj.RESULTS.end_of_time)


def test_peak_of_free_rocking_is_where_it_starts():
    peak = rj.peak_response(BLOCK, rj.Rest(), initial=rj.State(-0.2))
    assert float(peak.peak_rotation) == pytest.approx(0.2 / 0.3)
    assert float(peak.peak_rotation_time) == 0.0


def test_t_end_cuts():
    complete = rj.simulate(PODIUMS["elastic"], pulse())
    part = rj.peak_response(PODIUMS["elastic"], pulse(), t_end=0.2)
    assert part.result == rj.RESULTS.end_of_time
    assert float(part.stats.end_time) == 0.2
    t = np.linspace(-2, 0.2, 4001)
    assert float(part.peak_rotation) == pytest.approx(np.abs(complete(t).theta).max() / ALPHA, rel=1e-6)


def test_smallest_impact_speed_is_before_the_peak():
    response = rj.simulate(PODIUMS["rigid"], pulse(), options=options(1e-10))
    t = np.asarray(response.impact_times)
    speeds = np.abs(np.asarray(response(t, left=True).theta_dot))[t < float(response.peak_rotation_time)]
    assert float(response.smallest_impact_speed) == pytest.approx(speeds.min(), rel=1e-8)
    assert math.isinf(float(rj.peak_response(BLOCK, rj.Rest()).smallest_impact_speed))


@pytest.mark.slow
def test_rigid_limit_of_the_compatible_restitution():
    """As T_s → 0, the compatible law tends to the rigid superstructure after vibrations have decayed; the
    paper's law does not."""

    def ratio(podium):
        initial = rj.State(0.5 * ALPHA, 0.0, 2 * 1.5 * (math.sin(ALPHA) - math.sin(0.5 * ALPHA)), 0.0)
        o = options(1e-9, "dopri8")
        response = rj.simulate(podium, rj.Rest(), initial=initial, t_end=2.2, options=o)
        t = np.linspace(float(response.impact_times[0]) + 0.05, 2.2, 4001)
        return np.abs(np.asarray(response(t).theta)).max()

    rigid = ratio(PODIUMS["rigid"])
    stiff = [ratio(elastic(T, zeta=0.3).replace(restitution="compatible")) for T in (0.04, 0.02, 0.01)]
    gaps = np.abs(np.array(stiff) / rigid - 1)
    assert gaps[2] < 0.02
    assert gaps[2] < gaps[1] < gaps[0]
    paper = ratio(elastic(0.01, zeta=0.3))
    assert paper / rigid - 1 > 0.05


def test_float32_on_purpose():
    with (
        jax.experimental.enable_x64(False)
        if hasattr(jax.experimental, "enable_x64")
        else jax.enable_x64(False)
    ):
        podium = rj.Podium(alpha=ALPHA, R=1.5, gamma=10.0, superstructure=rj.Rigid(100.0))
        with pytest.raises(ValueError, match="rtol"):
            rj.peak_response(podium, pulse())
        peak = rj.peak_response(podium, pulse(), options=rj.Options(rtol=1e-5, atol=1e-6))
        assert peak.peak_rotation.dtype == jnp.float32
    assert float(peak.peak_rotation) == pytest.approx(0.458271, abs=2e-4)


def test_numbers_of_another_precision_are_refused_before_tracing(tmp_path):
    """Objects made with float64 and used without it, or the reverse, raise an error that names the object and
    the remedy, in all functions."""
    switched = jax.enable_x64 if hasattr(jax, "enable_x64") else jax.experimental.enable_x64
    make = lambda: (
        rj.Podium(alpha=ALPHA, R=1.5),
        rj.Ricker(3.0, 1.0),
        rj.Record(np.sin(np.arange(50)), 0.02),
    )
    loose = rj.Options(rtol=1e-4, atol=1e-5)

    def entrances(podium, motion):
        yield lambda: rj.peak_response(podium, motion, options=loose)
        yield lambda: rj.simulate(podium, motion, options=loose)
        yield lambda: rj.peak_responses(podium, motion, options=loose)
        yield lambda: rj.overturning_boundary(podium, motion, max_scale=4.0, options=loose)
        yield lambda: rj.sweep(podium, motion, store=tmp_path / "a.zarr", options=loose, progress=False)
        # Without float64, JAX converts single numbers to float32, which is correct; arrays keep their type.
        if jax.config.jax_enable_x64 or motion is record:
            yield lambda: jax.jit(rj.peak_response)(podium, motion, options=loose)

    def check_refused(podium, motion, words):
        for call in entrances(podium, motion):
            with pytest.raises(ValueError, match=words):
                call()

    podium, ricker, record = make()
    with switched(False):
        single = make()
        check_refused(
            podium, single[1], r"numbers of \w+ are float64, but jax_enable_x64 is off here.*create \w+ under"
        )
        for motion in (ricker, record):
            check_refused(single[0], motion, r"numbers of \w+ are float64, but jax_enable_x64 is off here")
        peak = jax.jit(rj.peak_response)(podium, ricker, options=loose).peak_rotation
        assert peak == rj.peak_response(single[0], single[1], options=loose).peak_rotation
        assert peak.dtype == jnp.float32
    check_refused(
        single[0],
        ricker,
        r"numbers of \w+ are float32, but jax_enable_x64 is on here, so that all must be float64",
    )
    check_refused(podium, single[2], r"numbers of \w+ are float32")


def test_the_independent_implementation_is_itself_right():
    """The independent implementation agrees with the closed form of a free rocking block."""
    podium = rj.Podium(alpha=math.atan(1 / 3), R=math.hypot(0.5, 1.5), g=9.81, restitution=0.85)
    answer = restrained.simulate(restrained.frame_of(podium), 2.5, state=(math.atan(1 / 3) / 2, 0.0))
    np.testing.assert_allclose(answer.impacts[:3], [0.612367284, 1.491124089, 2.177387280], atol=2e-9)
