"""Hard cases, each with its expected outcome; docs/verification.md lists them."""

import math

import jax
import numpy as np
import pytest
from scipy.integrate import quad

import rockjax as rj
from tests.scenes import PODIUMS, G, elastic, options, pulse, shaking

BLOCK = PODIUMS["block"]
UPLIFT = float(BLOCK.uplift_acceleration)
ENDED = (rj.RESULTS.settled, rj.RESULTS.end_of_time, rj.RESULTS.overturned)


@pytest.mark.slow(but=["Ricker-*", "OneCosine-rigid"])
@pytest.mark.parametrize(
    "podium", [BLOCK, PODIUMS["rigid"], elastic(0.5, eta=0.0)], ids=["block", "rigid", "elastic"]
)
@pytest.mark.parametrize("kind", [rj.Ricker, rj.OneSine, rj.OneCosine])
def test_amplitude_at_uplift(podium, kind):
    """Amplitudes of 1 ± 1e-12 times the uplift amplitude: at or below it the columns never lift, above it the
    rotation is below 1e-9 α."""
    up = float(podium.uplift_acceleration)
    for factor in (1 - 1e-12, 1.0, 1 + 1e-12):
        peak = rj.peak_response(podium, kind(up * factor, 0.9))
        assert peak.result in ENDED
        assert float(peak.peak_rotation) < 1e-9
        if factor <= 1:
            assert not bool(peak.uplifted)
            assert float(peak.peak_rotation) == 0.0
        elif not isinstance(podium.superstructure, rj.Elastic):
            assert bool(peak.uplifted)


@pytest.mark.filterwarnings(
    "ignore::rockjax.PlausibilityWarning"
)  # the weak pulse lifts columns by resonance
def test_tangent_uplift():
    """If the demand of Eq. (9) only touches the threshold, the rotation grows continuously from zero."""
    podium = elastic(0.6, eta=20.0)
    lifts = lambda a: np.asarray(rj.peak_responses(podium, rj.Ricker(a, 0.8)).uplifted)
    lo, hi = 0.1, 40.0
    for _ in range(8):
        a = np.linspace(lo, hi, 65)
        k = int(np.argmax(lifts(a)))
        lo, hi = a[k - 1], a[k]
    assert hi - lo < 1e-9
    below, above, well = (
        rj.peak_response(podium, rj.Ricker(a, 0.8))
        for a in (lo * (1 - 1e-9), hi * (1 + 1e-9), hi * (1 + 1e-6))
    )
    assert float(below.peak_rotation) == 0.0
    assert bool(above.uplifted)
    assert 0 < float(above.peak_rotation) < float(well.peak_rotation) < 1e-6


def test_grazing_impact():
    """Grazing impact: the columns land with zero speed. The answer is continuous like the square root of the
    distance, and never NaN."""
    motion = rj.HalfSine(-2.5 * UPLIFT, 2.0)  # acts against the fall during the pulse
    state = lambda speed: rj.State(0.05, -speed)
    solve = lambda speed: rj.simulate(
        BLOCK, motion, initial=state(speed), t_end=0.6, options=options(1e-11, "dopri8")
    )
    touches = lambda speed: int(solve(speed).impacts) > 0
    lo, hi = 0.01, 2.0
    assert touches(hi)
    assert not touches(lo)
    for _ in range(45):
        middle = 0.5 * (lo + hi)
        lo, hi = (lo, middle) if touches(middle) else (middle, hi)
    missed, grazed = solve(lo), solve(hi)
    assert int(missed.impacts) == 0
    assert int(grazed.impacts) >= 1
    for response in (missed, grazed):
        assert response.result in ENDED
        assert np.isfinite(float(response(0.6).theta))
    assert float(missed(0.6).theta) == pytest.approx(float(grazed(0.6).theta), abs=1e-5)


def test_impact_and_uplift_at_once():
    """Impact and uplift at once: with e = 0 and a demand above the threshold, the columns come to rest and
    lift at the same instant, to the side of Eq. (9)."""
    podium = BLOCK.replace(restitution=0.0)
    motion = rj.Record(np.full(400, 3.0 * UPLIFT), 0.01)
    response = rj.simulate(podium, motion, initial=rj.State(0.05, -0.5), t_end=0.5)
    hit = float(response.impact_times[0])
    nodes = response.nodes
    k = int(np.searchsorted(np.asarray(nodes.t), hit, side="right")) - 1
    assert float(nodes.t[k]) == pytest.approx(hit, abs=1e-12)
    assert float(nodes.sigma[k]) == -1.0
    assert float(nodes.v[0][k]) == 0.0
    assert float(response(hit + 0.05).theta) < 0


def test_free_rocking_to_rest():
    """Free rocking to rest: infinitely many impacts end at the sum of their flight times, from
    quadratures."""
    alpha, e, p, theta0 = float(BLOCK.alpha), float(BLOCK.restitution_factor), float(BLOCK.p), 0.2
    p *= math.sqrt(1 / 0.75 / (4 / 3))  # p of the solitary block
    # cos(α−θ) − cos α without cancellation.
    well = lambda th: 2 * math.sin(0.5 * th) * math.sin(alpha - 0.5 * th)
    top_of = lambda height: (
        alpha - math.acos(math.cos(alpha) + height) if height > 1e-7 else height / math.sin(alpha)
    )

    def quarter(top):
        def f(s):
            th = top * math.sin(s) ** 2
            drop = 2 * math.sin(0.5 * (top - th)) * math.sin(alpha - 0.5 * (top + th))
            return 2 * top * math.sin(s) * math.cos(s) / (p * math.sqrt(2 * drop))

        return quad(f, 0, math.pi / 2, epsabs=1e-14, epsrel=1e-12, limit=200)[0]

    height, total = well(theta0), quarter(theta0)
    for _ in range(2000):
        height *= e * e
        flight = 2 * quarter(top_of(height))
        total += flight
        if flight < 1e-9:
            break
    total += flight * e / (1 - e)
    finest = options(1e-12, "dopri8", rest_velocity=1e-11, outputs=("impacts",))
    peak = rj.peak_response(BLOCK, rj.Rest(), initial=rj.State(theta0), t_end=100.0, options=finest)
    assert peak.result == rj.RESULTS.settled
    assert float(peak.stats.end_time) == pytest.approx(total, abs=1e-8)


@pytest.mark.slow(but=["*chattering"])
@pytest.mark.parametrize(("T_s", "e", "cause"), [(1.0, 1.0, "chattering"), (0.004, 0.9, "too_stiff")])
def test_scenes_out_of_steps_name_the_reason(T_s, e, cause):
    """Endless vibration and endless impacts have named results, which raise an error unless `throw` is
    False."""
    podium = elastic(T_s).replace(restitution=e)
    limited = rj.Options(outputs=("impacts",), max_steps=60_000)
    with pytest.raises(RuntimeError, match=cause):
        rj.peak_response(podium, pulse(), t_end=200.0, options=limited)
    peak = rj.peak_response(podium, pulse(), t_end=200.0, options=limited.replace(throw=False))
    assert peak.result == getattr(rj.RESULTS, cause)
    assert int(peak.stats.steps + peak.stats.rejected) == 60_000


def test_massless_beam_and_superstructure():
    """With γ = η = 0 the podium rocks like a solitary block, for every massless superstructure."""
    motion = rj.Ricker(1.6 * UPLIFT, 0.9)
    alone = rj.peak_response(BLOCK, motion)
    for top in (rj.Rigid(0.0), rj.Elastic(0.0, 0.4)):
        peak = rj.peak_response(BLOCK.replace(superstructure=top), motion)
        assert float(peak.peak_rotation) == pytest.approx(float(alone.peak_rotation), abs=1e-8)
        assert bool(peak.overturned) is bool(alone.overturned)


def test_balanced_on_the_edge():
    """θ_0 = α with overturn_ratio > 1, exactly or one unit in the last place beside it: the columns stay,
    fall or return, and the result names it."""
    lenient = rj.Options(overturn_ratio=1.5, throw=False)
    alpha = float(BLOCK.alpha)
    for theta in (alpha, np.nextafter(alpha, 0), np.nextafter(alpha, 1)):
        for sign in (1, -1):
            peak = rj.peak_response(
                BLOCK, rj.Rest(), initial=rj.State(sign * theta), t_end=60.0, options=lenient
            )
            assert peak.result in ENDED
            assert float(peak.peak_rotation) >= 1 - 1e-15
    back = rj.peak_response(
        BLOCK, rj.Rest(), initial=rj.State(alpha * (1 - 1e-6)), t_end=60.0, options=lenient
    )
    gone = rj.peak_response(
        BLOCK, rj.Rest(), initial=rj.State(alpha * (1 + 1e-6)), t_end=60.0, options=lenient
    )
    assert not bool(back.overturned)
    assert bool(gone.overturned)


@pytest.mark.parametrize("zeta", [0.0, 0.05, 1.0])
def test_superstructure_a_hundred_times_faster_than_the_pulse(zeta):
    """T_s of a hundredth of the pulse period takes thousands of small steps, and the error matches the
    tolerance."""
    podium = elastic(0.01, eta=20.0, zeta=zeta)
    motion = pulse(ratio=3.0)
    requested = ("peak_rotation", "errors")
    peak, fine = (
        rj.peak_response(podium, motion, options=options(r, "dopri8", outputs=requested))
        for r in (1e-7, 1e-11)
    )
    assert peak.result in ENDED
    assert float(peak.peak_rotation) == pytest.approx(float(fine.peak_rotation), abs=1e-5)
    assert bool(peak.overturned) == bool(fine.overturned)


def finely(record, times):
    """Return the same motion with `times` as many samples."""
    n = record.acceleration.shape[0]
    fine = np.interp(np.arange((n - 1) * times + 1) / times, np.arange(n), record.acceleration)
    return rj.Record(fine, record.dt / times)


@pytest.mark.slow(but=["rigid"])
@pytest.mark.parametrize("podium", [PODIUMS["rigid"], elastic(0.4, eta=10.0)], ids=["rigid", "elastic"])
def test_a_record_of_200000_samples(podium):
    """A record of 200 000 samples has the same answer as the same motion with 2000, with a step for each
    sample."""
    t = 0.0137 * np.arange(2001)
    coarse = rj.Record(2.6 * np.exp(-(((t - 12) / 2) ** 2)) * np.sin(5.2 * t), 0.0137)
    long = finely(coarse, 100)
    assert long.acceleration.shape == (200_001,)
    few, many = (rj.peak_response(podium, m, options=options(1e-10, "tsit5")) for m in (coarse, long))
    assert bool(few.uplifted)
    assert float(many.peak_rotation) == pytest.approx(float(few.peak_rotation), abs=1e-8)
    assert float(many.uplift_time) == pytest.approx(float(few.uplift_time), abs=1e-8)


def test_a_record_with_a_constant_offset():
    """A constant offset below the threshold is harmless, including its jumps at both ends; above it, the
    columns overturn."""
    t = 0.01 * np.arange(3000)
    swing = 0.4 * UPLIFT * np.sin(3 * t) * np.exp(-(((t - 10) / 4) ** 2))
    quiet = rj.peak_response(BLOCK, rj.Record(swing + 0.5 * UPLIFT, 0.01))
    assert not bool(quiet.uplifted)
    lifted = rj.peak_response(BLOCK, rj.Record(swing + 0.7 * UPLIFT, 0.01))
    assert bool(lifted.uplifted)
    assert lifted.result in ENDED
    gone = rj.peak_response(BLOCK, rj.Record(swing + 1.05 * UPLIFT, 0.01))
    assert bool(gone.overturned)
    assert float(gone.uplift_time) == 0.0


@pytest.mark.slow(but=["0.0137", "0.5"])
@pytest.mark.parametrize("dt", [0.0137, 0.5, 1e-4])
def test_sampling_unequal_to_the_step(dt):
    """Steps end on samples of any interval, so coarse and fine samples of one motion agree."""
    n = max(8, round(3.0 / dt))
    a = 1.8 * UPLIFT * np.sin(np.linspace(0, 9, n)) ** 3
    record = rj.Record(a, dt)
    podium = PODIUMS["frame"]
    one, other = (
        rj.peak_response(podium, m, options=options(1e-10, "dopri8")) for m in (record, finely(record, 3))
    )
    assert one.result in ENDED
    assert float(one.peak_rotation) == pytest.approx(float(other.peak_rotation), abs=1e-8)


@pytest.mark.slow
def test_single_precision_on_purpose():
    """In float32, answers have single precision, also in batches, and smaller tolerances raise an error."""
    with jax.enable_x64(False) if hasattr(jax, "enable_x64") else jax.experimental.enable_x64(False):
        podium = rj.Podium(0.3, 2.0)
        motions = rj.OneSine(np.linspace(1.2, 2.0, 40) * UPLIFT, 1.0)
        with pytest.raises(ValueError, match="rtol"):
            rj.peak_responses(podium, motions)
        o = rj.Options(rtol=1e-5, atol=1e-6, outputs=("peak_rotation", "errors"))
        single = rj.peak_responses(podium, motions, options=o)
        assert single.peak_rotation.dtype == np.float32
    double = rj.peak_responses(BLOCK, rj.OneSine(np.linspace(1.2, 2.0, 40) * UPLIFT, 1.0))
    stands = ~double.overturned & ~single.overturned
    assert stands.sum() > 10
    np.testing.assert_allclose(single.peak_rotation[stands], double.peak_rotation[stands], atol=2e-3)
    assert np.all((single.overturned == double.overturned) | single.errors.undecided)


@pytest.mark.slow
def test_estimated_errors_are_an_output_like_others():
    """Estimated errors can be requested in every way, have no derivatives, and include the rotation."""
    o = rj.Options(outputs=("peak_rotation", "peak_shear", "errors"))
    podium, motion = PODIUMS["elastic"], pulse()
    single = rj.peak_response(podium, motion, options=o)
    assert 0 < float(single.errors.peak_rotation) < 1e-7
    assert math.isnan(float(single.errors.peak_deformation))
    assert not bool(single.errors.undecided)
    assert "±" in repr(single)
    batch = rj.peak_responses(podium, rj.Ricker(G * 0.15 * np.array([2.5, 30.0]), 1.0), options=o)
    np.testing.assert_allclose(batch.errors.peak_rotation[0], single.errors.peak_rotation, rtol=0.5)
    assert bool(batch.overturned[1])
    assert batch.errors.peak_rotation[1] == 0
    estimate = lambda a: rj.peak_response(podium, rj.Ricker(a, 1.0), options=o).errors.peak_rotation
    assert float(jax.grad(estimate)(3.0)) == 0.0
    assert float(rj.simulate(podium, motion, options=o).errors.peak_rotation) == pytest.approx(
        float(single.errors.peak_rotation), rel=0.9
    )
    assert rj.peak_response(podium, motion).errors is None
    for bad in ({"outputs": ("errors",)}, {"outputs": ("peak_rotation", "errors"), "engine": "segments"}):
        with pytest.raises(ValueError, match="errors"):
            rj.Options(**bad)


@pytest.mark.slow
def test_scenes_on_the_boundary_are_undecided():
    """Scenes within the error of the overturning boundary are undecided on both sides; other scenes are
    decided."""
    T_p = 0.8
    limit = float(rj.overturning_acceleration(PODIUMS["frame"], rj.Ricker, T_p))
    away = np.array([-1e-2, -1e-3, -1e-12, -1e-14, 1e-14, 1e-12, 1e-3, 1e-2])
    o = rj.Options(rtol=1e-5, atol=1e-7, outputs=("peak_rotation", "errors"))
    peaks = rj.peak_responses(PODIUMS["frame"], rj.Ricker(limit * (1 + away), T_p), options=o)
    np.testing.assert_array_equal(peaks.errors.undecided, np.abs(away) < 1e-9)


@pytest.mark.slow
def test_estimates_on_records_see_errors_of_landing():
    """If samples determine the steps, the second solution must land on impacts differently, or estimates are
    too small."""
    rng = np.random.default_rng(6)
    n = 400
    suite = rj.Records.of(rj.synthetic_motions(8, seed=11, duration=10.0, dt=0.02, pga=UPLIFT))
    motion = suite.pick(rng.integers(0, 8, n).astype(np.int32)).scaled(rng.uniform(1.5, 6.0, n))
    podium = rj.Podium(math.atan(0.15), rng.uniform(0.8, 5.0, n), rng.uniform(0.0, 12.0, n), rj.Rigid(50.0))
    o = rj.Options(rtol=1e-4, atol=1e-6, outputs=("peak_rotation", "errors"))
    peaks, truth = (
        rj.peak_responses(podium, motion, options=o.replace(**k))
        for k in ({}, {"rtol": 1e-12, "atol": 1e-14})
    )
    stands = truth.uplifted & ~truth.overturned & ~peaks.overturned
    error = np.abs(peaks.peak_rotation - truth.peak_rotation)[stands]
    assert stands.sum() > 100
    assert error.max() > 1e-7
    assert np.mean(error > 10 * peaks.errors.peak_rotation[stands] + 1e-10) < 0.01


@pytest.mark.slow
def test_estimates_on_records_do_not_repeat_the_steps_of_the_first_solution():
    """If a short period determines the steps, the second solution must divide the intervals of the record
    differently. Otherwise both solutions have common errors of the shear, and estimates are too small."""
    podium = elastic(0.12)
    motion = shaking(400).scaled(np.linspace(0.8, 2.6, 96))
    o = rj.Options(rtol=1e-4, atol=1e-6, outputs=("peak_rotation", "peak_shear", "errors"))
    peaks, truth = (
        rj.peak_responses(podium, motion, options=o.replace(**k))
        for k in ({}, {"rtol": 1e-12, "atol": 1e-14})
    )
    stands = truth.uplifted & ~truth.overturned & ~peaks.overturned
    assert stands.sum() > 60
    for name in ("peak_rotation", "peak_shear"):
        error = np.abs(getattr(peaks, name) - getattr(truth, name))[stands]
        assert error.max() > 1e-7
        assert np.mean(error > 10 * getattr(peaks.errors, name)[stands] + 1e-11) < 0.05


def with_classes_at_tighter_tolerances(podium, motion, start, ratio, rtol):
    """Return peaks, and for which scenes the outcome changes at a ten-thousandth of the tolerance."""
    outputs = ("peak_rotation", "peak_deformation", "peak_shear", "errors")
    o = rj.Options(rtol=rtol, atol=rtol / 100, outputs=outputs, overturn_ratio=ratio)
    tight = o.replace(rtol=rtol / 1e4, atol=rtol / 1e6)
    peaks, others = (rj.peak_responses(podium, motion, initial=start, options=x) for x in (o, tight))
    return peaks, peaks.overturned != others.overturned


NEIGHBOURS = 1 + 1e-7 * np.linspace(0, 1, 96)
# (frame, superstructure, restitution, motion, initial state, overturn_ratio, rtol, least number of changed
# outcomes)
CHAOTIC = {
    # Two solutions survive by chance with equal earlier peaks, while a third overturns.
    "squat": (
        (1.055429171615247, 38.025852721841, 0.007033951931859461),
        (2.791043851687052, 0.01, 0.0011588894808684225),
        "compatible",
        rj.OneCosine(296.2059928435207 * NEIGHBOURS, 1.1493395088813456),
        rj.State(-0.40535098402972825, 0.0, 25.322696064313092, 11.136825913335656),
        1.0,
        1e-6,
        10,
    ),
    # Both solutions survive.
    "slender": (
        (0.06733776828081249, 3.890294038149851, 0.015474651059458848),
        (0.745569903998054, 0.22716101037004283, 0.0032855725886379136),
        "compatible",
        rj.OneCosine(0.6613578431086233 * NEIGHBOURS, 5.0293609675786035),
        rj.State(0.037116524191064135, 0.0, 0.21635487298093595, 0.29748593477118324),
        1.3,
        1e-3,
        90,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CHAOTIC)
def test_chaotic_scenes_are_undecided(name):
    """Chaotic rocking with a lightly damped superstructure: every scene whose outcome changes with a smaller
    tolerance is undecided."""
    frame, top, restitution, motion, start, ratio, rtol, least = CHAOTIC[name]
    podium = rj.Podium(*frame, rj.Elastic(*top), restitution=restitution)
    peaks, changes = with_classes_at_tighter_tolerances(podium, motion, start, ratio, rtol)
    assert changes.sum() >= least
    assert peaks.errors.undecided[changes].all()


@pytest.mark.slow
def test_chaotic_solutions_hardly_agree_by_chance():
    """Both solutions overturn although none does with a smaller tolerance. Their times of overturning differ,
    and are close only by chance."""
    podium = rj.Podium(
        0.01123144244003005,
        1.839910557815006,
        0.006415617289600464,
        rj.Elastic(0.09164057344160052, 0.01440282234241553, 0.003116518691464157),
        restitution=0.2,
    )
    motion = rj.Ricker(2.644053892636998 * np.linspace(1, 1.01, 6000), 0.3914862595526814)
    start = rj.State(0.0, 0.0, 0.00039868105362099156, 0.0007971099147272847)
    peaks, changes = with_classes_at_tighter_tolerances(podium, motion, start, 1.3, 1e-4)
    assert changes.sum() > 1000
    assert (changes & ~peaks.errors.undecided).sum() <= 0.002 * changes.sum()


@pytest.mark.slow
def test_regular_scenes_are_decided():
    """Regular rocking: no scene is undecided, and no outcome changes."""
    motion = rj.Ricker(UPLIFT * np.linspace(1.1, 3.0, 96), 1.0)
    peaks, changes = with_classes_at_tighter_tolerances(PODIUMS["elastic"], motion, rj.State(), 1.0, 1e-6)
    assert peaks.uplifted.all()
    assert not changes.any()
    assert not peaks.errors.undecided.any()


def test_an_estimate_beside_a_scene_out_of_steps():
    """Without enough steps the estimate is infinite and the scene is undecided."""
    o = rj.Options(outputs=("peak_rotation", "errors"), max_steps=20, throw=False)
    peak = rj.peak_response(PODIUMS["elastic"], pulse(), options=o)
    assert peak.result == rj.RESULTS.out_of_steps
    assert math.isinf(float(peak.errors.peak_rotation))
    assert bool(peak.errors.undecided)


# Scenes from the stress campaign.
@pytest.mark.parametrize(
    ("podium", "motion", "initial"),
    [
        (
            rj.Podium(
                0.21522563603, 1.10394697208, 0.02771789496665, rj.Rigid(0.31505109006815), 0.7464616498943617
            ),
            rj.Ricker(2.653983437460101, 1.2883568517419943),
            rj.State(),
        ),
        (
            rj.Podium(
                0.4321641252350571, 26.714706214843513, 0.00991747834323966, rj.Rigid(0.12137533392615375)
            ),
            rj.Ricker(12.339765371439125, 39.979796326011666),
            rj.State(-0.22950515523155085),
        ),
        (
            rj.Podium(0.5406443021004188, 0.10566189090450993, 1000.0, rj.Rigid(1.3208579996895535)),
            rj.Ricker(-5.892875584996671, 0.5688330104423671),
            rj.State(-0.12232870847508827, 2.418544391987501),
        ),
    ],
)
def test_shear_of_the_last_hops(podium, motion, initial):
    """In the last hops before rest, at rtol = 1e-12, the shear has maxima due to rounding. Steps must not end
    on them endlessly."""
    tight = options(1e-12, "dopri8", outputs=("peak_rotation", "peak_shear"), max_steps=20_000)
    peak = rj.peak_response(podium, motion, initial=initial, options=tight)
    loose = rj.peak_response(podium, motion, initial=initial, options=tight.replace(rtol=1e-9, atol=1e-11))
    assert float(peak.peak_rotation) == pytest.approx(float(loose.peak_rotation), abs=1e-8)
    assert float(peak.peak_shear) == pytest.approx(float(loose.peak_shear), rel=1e-7)
    assert bool(peak.overturned) == bool(loose.overturned)
    assert int(peak.stats.steps + peak.stats.rejected) < 5000


def test_the_effect_of_the_rest_velocity_is_estimated():
    """With little restitution, an impact may leave a speed below the rest velocity of both solutions while
    the ground lifts the columns again. The error estimate must include this effect."""
    block = BLOCK.replace(restitution=1e-8)
    motion = rj.Record(np.r_[np.full(30, 1.4 * UPLIFT), np.full(30, -0.5 * UPLIFT)], 0.02)
    solve = lambda rtol: rj.peak_response(
        block,
        motion,
        initial=rj.State(0.05, -0.5),
        options=options(rtol, "dopri8", outputs=("peak_rotation", "errors")),
    )
    peak, truth = solve(1e-6), solve(1e-12)
    error = abs(float(peak.peak_rotation) - float(truth.peak_rotation))
    assert 1e-10 < error < 1e-6
    assert peak.errors is not None
    assert 0.1 * error < float(peak.errors.peak_rotation) < 10 * error


def test_hops_that_would_not_end_are_estimated():
    """Columns without losses hop below the rest velocity until the ground lifts them, while both solutions
    put them to rest. The error estimate must include this effect."""
    block = BLOCK.replace(restitution=1.0)
    motion = rj.Record(UPLIFT * np.r_[np.full(8, 0.8), np.full(20, 1.2), np.full(10, -0.9)], 0.02)
    initial = rj.State(0.0, 0.9e-4 * float(block.p * block.alpha))
    how = lambda rtol: options(rtol, "dopri8", outputs=("peak_rotation", "errors"))
    peak, truth = (rj.peak_response(block, motion, initial=initial, options=how(r)) for r in (1e-4, 1e-12))
    error = abs(float(peak.peak_rotation) - float(truth.peak_rotation))
    assert error > 1e-6
    assert peak.errors is not None
    assert 0.1 * error < float(peak.errors.peak_rotation) < 10 * error


@pytest.mark.parametrize("change", [0.0, 1e-7, 1e-9, -1e-7, -1e-12])
def test_an_impact_just_after_a_sample(change):
    """The predicted rotation over a sampling interval is zero just after its start and again near its end.
    The search for the first zero must not end too early, or trials become ever shorter."""
    record = rj.synthetic_motions(66, seed=1, dt=0.02, duration=20.0, pga=0.3 * 9.80665)[65]
    podium = rj.Podium(np.radians(10.0), 3.5606506330096086)
    peak = rj.peak_response(podium, record.record(2.1890039397029293 * (1 + change)))
    assert int(peak.stats.steps + peak.stats.rejected) < 500
    assert float(peak.overturn_time) == pytest.approx(6.0587038386, abs=1e-4)
