"""Accuracy of the engine, compared with an independent implementation, with other tolerances and with the
segments engine."""

import itertools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._engine.model import impact
from tests import restrained
from tests.scenes import PODIUMS, G, elastic, options, pulse, shaking

SCENES = {
    "block, sine": (PODIUMS["block"], rj.OneSine(4.0, 1.2)),
    "block, cosine with jumps": (PODIUMS["block"], rj.OneCosine(3.6, 0.9)),
    "frame, antisymmetric": (PODIUMS["frame"], rj.AntisymmetricRicker(4.0, 0.9)),
    "frame, half sine": (PODIUMS["frame"], rj.HalfSine(3.0, 1.0)),
    "rigid, Ricker": (PODIUMS["rigid"], pulse()),
    "rigid, record": (PODIUMS["rigid"], shaking()),
    "T_s = 0.1 s": (elastic(0.1), pulse()),
    "T_s = 0.5 s": (elastic(0.5), pulse()),
    "T_s = 1 s": (elastic(1.0), pulse(ratio=4.0, T_p=0.9)),
    "light top, record": (elastic(0.4, eta=10.0), shaking(seed=3)),
    "Gabor": (elastic(0.6, eta=20.0), rj.Gabor(4.0, 0.9, 2.5, 0.3)),
    "Mavroeidis": (PODIUMS["frame"], rj.MavroeidisPapageorgiou(0.45, 1.0, 2.2, 1.0)),
    "overturns": (PODIUMS["rigid"], pulse(ratio=4.0)),
}


@pytest.fixture(scope="module")
def references():
    expected = {}

    def reference(name):
        if name not in expected:
            podium, motion = SCENES[name]
            if isinstance(motion, rj.Record):
                times, a = np.asarray(motion.breakpoints), np.asarray(motion.acceleration)
                acceleration = lambda t: float(np.interp(t, times, a, left=0.0, right=0.0))
            elif isinstance(motion, rj.AbstractPulse):
                a_p, T_p, (lo, hi) = float(motion.a_p), float(motion.T_p), motion.span
                inside = lambda t: (lo * T_p <= t <= hi * T_p) or not motion.compact
                acceleration = lambda t: a_p * float(motion.shape(np.float64(t / T_p))) if inside(t) else 0.0
            else:
                f = jax.jit(lambda t, m=motion: m(t))
                acceleration = lambda t: float(f(t))
            start, end = (float(t) for t in motion.support)
            breaks = [float(b) for b in np.asarray(motion.breakpoints)]
            frame = restrained.frame_of(podium)
            expected[name] = restrained.simulate(frame, end + 2.5, acceleration, breaks=breaks, start=start)
        return expected[name]

    return reference


@pytest.mark.slow(but=["1e-10-dopri8-1e-08-[!f]*", "1e-10-dopri8-1e-08-frame, antisymmetric"])
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize(
    ("rtol", "method", "within"),
    [(1e-8, "tsit5", 1e-6), (1e-10, "tsit5", 1e-8), (1e-10, "dopri8", 1e-8)],
)
def test_against_an_independent_implementation(references, name, rtol, method, within):
    podium, motion = SCENES[name]
    reference = references(name)
    end = float(motion.support[1]) + 2.5
    response = rj.simulate(podium, motion, t_end=end, options=options(rtol, method))
    assert float(response.peak_rotation) == pytest.approx(reference.peak, abs=within)
    assert float(response.uplift_time) == pytest.approx(reference.uplift_time, abs=within)
    assert bool(response.overturned) == (reference.overturn_time == reference.overturn_time)
    if bool(response.overturned):
        assert float(response.overturn_time) == pytest.approx(reference.overturn_time, abs=within)
    n = min(8, len(reference.impacts))
    np.testing.assert_allclose(response.impact_times[:n], reference.impacts[:n], atol=within)
    if isinstance(podium.superstructure, rj.Elastic):
        # the reference takes these from samples of its interpolant
        assert float(response.peak_deformation) == pytest.approx(reference.deformation, rel=max(within, 3e-7))
        assert float(response.peak_shear) == pytest.approx(reference.shear, rel=max(within, 3e-7))


@pytest.mark.slow(but=["tsit5-T_s = 0.5 s"])
@pytest.mark.parametrize("name", ["rigid, Ricker", "T_s = 0.5 s", "rigid, record"])
@pytest.mark.parametrize("method", ["tsit5", "dopri8"])
def test_error_falls_with_the_tolerance(name, method):
    podium, motion = SCENES[name]
    requested = ("peak_rotation",)
    best = float(rj.peak_response(podium, motion, options=options(1e-13, outputs=requested)).peak_rotation)
    tolerances = 10.0 ** np.arange(-4, -12.5, -1)
    errors, steps = [], []
    for rtol in tolerances:
        peak = rj.peak_response(podium, motion, options=options(rtol, method, outputs=requested))
        errors.append(abs(float(peak.peak_rotation) - best))
        steps.append(int(peak.stats.steps))
    errors = np.array(errors)
    assert np.all(errors < 300 * tolerances + 3e-14)
    assert errors[-1] < 1e-11
    if name != "rigid, record":  # there the samples, not the tolerance, determine the steps
        # the order of the method: slope of the error against the number of steps, over the whole range
        good = errors > 1e-13
        slope = np.polyfit(np.log(np.array(steps)[good]), np.log(errors[good]), 1)[0]
        assert slope < (-4.0 if method == "tsit5" else -5.5)


@pytest.mark.slow(but=["rigid, record"])
@pytest.mark.parametrize("name", ["block, cosine with jumps", "rigid, record", "light top, record"])
def test_breakpoints_cost_no_order(name):
    """Steps end on jumps, kinks and samples, so errors match the tolerance."""
    podium, motion = SCENES[name]
    best = rj.peak_response(podium, motion, options=options(1e-13, "dopri8"))
    fine = rj.peak_response(podium, motion, options=options(1e-11, "tsit5"))
    for quantity in ("peak_rotation", "peak_deformation", "peak_shear", "uplift_time"):
        assert float(getattr(fine, quantity)) == pytest.approx(
            float(getattr(best, quantity)), rel=1e-9, abs=1e-10
        )


@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("block, cosine with jumps", "tsit5"),
        ("block, cosine with jumps", "kvaerno5"),
        ("rigid, Ricker", "dopri8"),
        ("T_s = 0.5 s", "dopri8"),
        ("light top, record", "tsit5"),
    ],
)
@pytest.mark.slow(but=["rigid, Ricker-dopri8"])
def test_segments_engine_agrees(name, method):
    podium, motion = SCENES[name]
    end = float(motion.support[1]) + 1.5
    flat = rj.simulate(podium, motion, t_end=end, options=options(1e-12, "dopri8"))
    rtol, within = (1e-7, 3e-5) if method == "kvaerno5" else (1e-10, 3e-9)
    segments = rj.simulate(podium, motion, t_end=end, options=options(rtol, method, engine="segments"))
    assert segments.result == flat.result
    for quantity in ("peak_rotation", "uplift_time", "peak_deformation", "peak_shear", "overturn_time"):
        a, b = float(getattr(segments, quantity)), float(getattr(flat, quantity))
        assert a == pytest.approx(b, rel=within, abs=within, nan_ok=True)
    n = min(6, int(flat.impacts))
    np.testing.assert_allclose(segments.impact_times[:n], flat.impact_times[:n], atol=within)
    t = np.linspace(float(flat.times[0]), float(flat.stats.end_time), 301)
    np.testing.assert_allclose(segments(t).theta, flat(t).theta, atol=10 * within)
    peak = rj.peak_response(podium, motion, t_end=end, options=options(rtol, method, engine="segments"))
    assert float(peak.peak_rotation) == pytest.approx(float(flat.peak_rotation), abs=within)


@pytest.mark.parametrize(
    "name", ["rigid, Ricker", "T_s = 0.5 s", "light top, record", "block, cosine with jumps"]
)
@pytest.mark.slow(but=["T_s = 0.5 s"])
def test_peak_response_is_simulate_without_history(name):
    podium, motion = SCENES[name]
    """To the tolerance of the solve."""
    end = float(motion.support[1]) + 2.5
    response = rj.simulate(podium, motion, t_end=end, options=options(1e-9))
    peak = rj.peak_response(podium, motion, t_end=end, options=options(1e-9))
    for quantity in ("peak_rotation", "peak_deformation", "peak_shear", "uplift_time", "peak_rotation_time"):
        assert float(getattr(peak, quantity)) == pytest.approx(
            float(getattr(response, quantity)), rel=1e-8, abs=1e-9
        )
    # Impacts are counted to the end or not at all.
    assert (
        np.isnan(peak.impacts)
        if peak.result == rj.RESULTS.settled
        else int(peak.impacts) == int(response.impacts)
    )
    assert ("not counted to the end" in repr(peak)) is bool(np.isnan(peak.impacts))
    assert f"impacts          {int(response.impacts)}" in repr(response)
    assert int(peak.stats.steps) <= int(response.stats.steps)
    counting = options(1e-9, outputs=("peak_rotation", "impacts"))
    counted = rj.peak_response(podium, motion, t_end=end, options=counting)
    assert int(counted.impacts) == int(response.impacts)


@pytest.mark.slow
@pytest.mark.parametrize("outputs", [("peak_rotation",), ("peak_deformation",), ("peak_shear",)])
@pytest.mark.parametrize(
    "name", ["T_s = 0.1 s", "T_s = 0.5 s", "T_s = 1 s", "rigid, Ricker", "light top, record"]
)
def test_certificate_changes_nothing(name, outputs):
    """A scene that ends settled has the same answers as a scene that runs to its end, within the tolerance,
    because steps end at different times."""
    podium, motion = SCENES[name]
    complete = rj.simulate(podium, motion, options=options(1e-9))
    early = rj.peak_response(podium, motion, options=options(1e-9, outputs=outputs))
    assert float(early.stats.end_time) <= float(complete.stats.end_time) + 1e-9
    assert float(getattr(early, outputs[0])) == pytest.approx(float(getattr(complete, outputs[0])), rel=1e-8)
    assert bool(early.overturned) == bool(complete.overturned)


@pytest.mark.slow(but=["*dopri8"])
@pytest.mark.parametrize("method", ["tsit5", "dopri8"])
@pytest.mark.parametrize("name", ["rigid, Ricker", "T_s = 0.5 s"])
def test_history_has_the_accuracy_of_the_solve(name, method):
    podium, motion = SCENES[name]
    end = 4.0
    reference = rj.simulate(podium, motion, t_end=end, options=options(1e-13, "dopri8"))
    response = rj.simulate(podium, motion, t_end=end, options=options(1e-9, method))
    t = np.linspace(float(response.times[0]), end, 2001)
    away = np.min(np.abs(t[:, None] - np.asarray(reference.impacts)), axis=1) > 1e-7
    scale = float(podium.alpha)
    np.testing.assert_allclose(response(t).theta / scale, reference(t).theta / scale, atol=2e-7)
    np.testing.assert_allclose(response(t).theta_dot[away], reference(t).theta_dot[away], atol=2e-7)
    np.testing.assert_allclose(response(t).u_t, reference(t).u_t, atol=2e-7)


@pytest.mark.parametrize("name", ["rigid, Ricker", "T_s = 0.5 s"])
def test_history_on_both_sides_of_an_impact(name):
    podium, motion = SCENES[name]
    response = rj.simulate(podium, motion, t_end=4.0, options=options(1e-10))
    e = float(podium.restitution_factor)
    t = np.asarray(response.impact_times)[:5]
    before, after = response(t, left=True), response(t)
    np.testing.assert_allclose(before.theta, 0, atol=1e-10)
    np.testing.assert_allclose(after.theta, 0, atol=0)
    np.testing.assert_allclose(after.theta_dot, e * np.asarray(before.theta_dot), rtol=1e-7)
    np.testing.assert_allclose(after.u_t_dot, before.u_t_dot, atol=1e-7)
    outside = response(np.array([float(response.times[0]) - 1, float(response.stats.end_time) + 1]))
    assert np.isnan(outside.theta[0])


@pytest.mark.parametrize("name", ["rigid, Ricker", "T_s = 0.5 s"])
def test_energy_balance(name):
    """After the pulse, the energy decreases only by the damper between impacts and by Eq. (27) at impacts."""
    podium, motion = SCENES[name]
    if isinstance(podium.superstructure, rj.Elastic):
        podium = podium.replace(superstructure=rj.Elastic(100.0, 0.5, 0.0))
        motion = pulse(ratio=2.0)
    response = rj.simulate(podium, motion, t_end=9.0, options=options(1e-11, "dopri8"))
    hits = np.asarray(response.impact_times)
    hits = hits[hits > float(motion.support[1])]
    assert len(hits) >= 2
    edges = np.append(float(motion.support[1]), hits)
    for lo, hi in itertools.pairwise(edges):
        E = np.asarray(response.energy(np.linspace(lo, hi - 1e-9, 9)))
        np.testing.assert_allclose(E, E[0], rtol=1e-8)
    c = rj._engine.coefficients.coefficients(podium)
    for t in hits[:3]:
        drop = float(response.energy(t)) - float(response.energy(t - 1e-10))
        before = float(response(t, left=True).theta_dot)
        after = float(impact(c, jnp.asarray(before)))
        # η v̇_b² contributes because the top mass moves up with the beam
        spin = float(c.spin) + float(c.eta) * float(c.two_R * c.sin_alpha) ** 2
        assert drop == pytest.approx(0.5 * spin * (after**2 - before**2), rel=1e-6)
        assert drop < 0


@pytest.mark.slow(but=["Bosh3*"])
@pytest.mark.parametrize(("method", "rtol"), [("Bosh3", 1e-7), ("Heun", 1e-5), ("Dopri5", 1e-9)])
def test_solvers_of_ones_choice(method, rtol):
    podium, motion = SCENES["rigid, Ricker"]
    solved = lambda how: rj.peak_response(podium, motion, t_end=6.0, options=how)
    best = float(solved(options(1e-12)).peak_rotation)
    peak = solved(options(rtol, getattr(diffrax, method)()))
    assert float(peak.peak_rotation) == pytest.approx(best, abs=300 * rtol)


def test_amplitude_mirrors_the_response():
    for podium in PODIUMS.values():
        a = rj.simulate(podium, pulse(ratio=2.0), t_end=3.0)
        b = rj.simulate(podium, pulse(ratio=-2.0), t_end=3.0)
        t = np.linspace(-2.2, float(a.stats.end_time), 101)
        np.testing.assert_array_equal(a(t).theta, -np.asarray(b(t).theta))
        assert float(a.peak_rotation) == float(b.peak_rotation)


def test_time_shift():
    record = shaking(200)
    later = rj.Record(record.acceleration, record.dt, t_start=7.0)
    for podium in PODIUMS.values():
        a, b = (rj.peak_response(podium, m, options=options(1e-10)) for m in (record, later))
        assert float(a.peak_rotation) == pytest.approx(float(b.peak_rotation), abs=1e-9)


def test_lengths_times_and_gravity_scale_together():
    scale_length, scale_time = 3.0, 1.7
    for podium in (PODIUMS["rigid"], PODIUMS["elastic"]):
        top = podium.superstructure
        big_top = rj.Elastic(top.eta, top.T_s * scale_time, top.zeta) if isinstance(top, rj.Elastic) else top
        g = G * scale_length / scale_time**2
        big = podium.replace(R=podium.R * scale_length, superstructure=big_top, g=g)
        a = rj.peak_response(podium, rj.Ricker(3.0, 1.0), t_end=6.0, options=options(1e-10))
        pulse = rj.Ricker(3.0 * g / G, scale_time)
        b = rj.peak_response(big, pulse, t_end=6.0 * scale_time, options=options(1e-10))
        assert float(a.peak_rotation) == pytest.approx(float(b.peak_rotation), rel=1e-9)
        assert float(a.peak_shear) == pytest.approx(float(b.peak_shear), rel=1e-8)
        assert float(a.peak_deformation) * scale_length == pytest.approx(float(b.peak_deformation), rel=1e-8)
