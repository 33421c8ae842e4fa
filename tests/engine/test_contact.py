"""Full contact crossed in panels: exact, and nothing but faster."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax import _results
from rockjax._engine import contact
from rockjax._engine import flat as _flat
from rockjax._engine.contact import _combine, _interpolation, cross_full_contact
from rockjax._engine.flat import runs
from rockjax._engine.scene import plan_for, prepare
from rockjax._engine.step import step
from rockjax._programs.program import forget
from tests.scenes import PODIUMS, elastic, options, pulse, shaking

ROTATION = ("peak_rotation",)
DEFAULT = rj.Options().outputs
UP = float(PODIUMS["elastic"].uplift_acceleration)
WEAK = 0.35  # of the uplift acceleration: lifts late, or never


def start(podium, motion, outputs=ROTATION):
    o = options(1e-13, "dopri8", outputs=outputs)
    plan = plan_for(podium, o, history=False)
    scene, lane = prepare(podium, motion, rj.State(), None, o, plan)
    return scene, plan, lane


def stepped_to(scene, plan, lane, t):
    """The same by Runge–Kutta steps, not ended by any certificate."""
    scene, plan = scene._replace(end=t), dataclasses.replace(plan, to_the_end=True)
    return jax.jit(
        lambda lane: jax.lax.while_loop(lambda y: runs(y, 100_000), lambda y: step(scene, plan, y)[0], lane)
    )(lane)


@pytest.mark.parametrize(
    ("T_s", "zeta", "motion"),
    [
        (0.02, 0.05, pulse(ratio=1.2, T_p=2.0)),
        (0.1, 0.05, pulse(ratio=1.2)),
        (0.5, 0.0, pulse(rj.AntisymmetricRicker, ratio=1.0)),
        (1.0, 0.3, pulse(ratio=2.0, T_p=0.5)),
        (8.0, 0.05, pulse(ratio=12.0, T_p=0.5)),
        (0.3, 0.05, pulse(rj.OneCosine, ratio=0.2)),
        (0.3, 0.05, shaking(200, peak=0.5)),
        (3.0, 0.05, shaking(200, peak=3.0)),
    ],
)
@pytest.mark.slow(but=["0.5-0.0-motion2", "0.3-0.05-motion6"])
def test_panels_are_exact(T_s, zeta, motion):
    """Against high-accuracy steps, from stiff to soft, for smooth pulses, one that starts with a jump, and
    records."""
    scene, plan, lane = start(elastic(T_s, zeta=zeta), motion)
    crossed = jax.jit(lambda lane: cross_full_contact(scene, plan, lane))(lane)
    assert float(crossed.t) > float(lane.t)
    stepped = stepped_to(scene, plan, lane, crossed.t)
    assert int(stepped.code) == _results.END_OF_TIME
    assert not bool(stepped.uplifted)
    scale = max(abs(float(stepped.x[1])), 1e-6)
    speed = scale * 2 * np.pi / T_s
    assert float(crossed.x[1]) == pytest.approx(float(stepped.x[1]), abs=1e-9 * scale)
    assert float(crossed.v[1]) == pytest.approx(float(stepped.v[1]), abs=1e-9 * speed)
    assert int(crossed.steps) <= int(stepped.steps) or isinstance(motion, rj.Record)


def test_a_stiff_superstructure_costs_nothing_before_uplift(monkeypatch):
    podium, motion = elastic(0.02), pulse(ratio=1.5)
    o = options(1e-9, outputs=ROTATION)
    with_panels = rj.peak_response(podium, motion, options=o)
    monkeypatch.setenv("ROCKJAX_CACHE", "off")
    forget()
    monkeypatch.setattr(_flat, "cross_full_contact", lambda scene, plan, lane: lane)
    without = rj.peak_response(podium, motion, options=o)
    forget()
    assert float(with_panels.peak_rotation) == pytest.approx(float(without.peak_rotation), rel=1e-8)
    assert float(with_panels.uplift_time) == pytest.approx(float(without.uplift_time), abs=1e-8)
    np.testing.assert_array_equal(with_panels.impacts, without.impacts)
    assert int(with_panels.stats.steps) < 0.7 * int(without.stats.steps)


def test_scenes_that_never_lift_are_over_in_a_few_steps():
    for T_s in (0.01, 0.1, 1.0):
        podium = elastic(T_s)
        peak = rj.peak_response(
            podium, rj.Ricker(WEAK * UP / 10, 1.0), options=options(1e-9, outputs=ROTATION)
        )
        assert not bool(peak.uplifted)
        assert peak.result == rj.RESULTS.settled
        assert int(peak.stats.steps) < 60


def test_peaks_of_the_superstructure_are_not_skipped():
    """Where deformation or shear is wanted only what is below the tolerance is crossed unseen."""
    podium, motion = elastic(0.5), rj.Ricker(WEAK * UP / 2, 1.0)
    history = rj.simulate(podium, motion, options=options(1e-10))
    peak = rj.peak_response(podium, motion, options=options(1e-10))
    assert float(peak.peak_deformation) == pytest.approx(float(history.peak_deformation), rel=1e-8)
    assert float(peak.peak_shear) == pytest.approx(float(history.peak_shear), rel=1e-8)


def test_more_damping_than_panels_know_is_left_to_the_steps():
    for zeta in (0.94, 1.0, 1.7):
        podium, motion = elastic(0.4, zeta=zeta), pulse(ratio=2.0)
        quick = rj.peak_response(podium, motion, options=options(1e-10, outputs=ROTATION))
        whole = rj.simulate(podium, motion, options=options(1e-10))
        assert float(quick.peak_rotation) == pytest.approx(float(whole.peak_rotation), rel=1e-7)


@pytest.mark.slow(but=["record"])
@pytest.mark.parametrize("motion", [pulse(ratio=1.8), shaking(200, peak=4.0)], ids=["pulse", "record"])
def test_derivatives_through_panels(motion):
    """Forward = reverse = finite differences, also with respect to what moves the panels' ends."""

    def peak(y, o):
        podium = elastic(0.25).replace(
            alpha=y[0], gamma=10 * y[1], superstructure=rj.Elastic(100.0 * y[2], 0.25 * y[3], 0.05 * y[4])
        )
        if isinstance(motion, rj.Record):
            moved = rj.Record(motion.acceleration, motion.dt * y[5], t_start=0.1 * y[6])
        else:
            moved = rj.Ricker(motion.a_p * y[5], motion.T_p * y[6])
        return rj.peak_response(podium, moved, options=o).peak_rotation

    y = jnp.array([0.15, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    o, fine = options(1e-11, outputs=ROTATION), options(1e-13, "dopri8", outputs=ROTATION)
    forward, reverse = jax.jacfwd(peak)(y, o), jax.grad(peak)(y, o)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-12)
    numeric = []
    for k in range(len(y)):
        d = 1e-5 * jnp.zeros_like(y).at[k].set(1.0)
        slope = lambda h, d=d: (peak(y + h * d, fine) - peak(y - h * d, fine)) / (2e-5 * h)
        numeric.append((4 * slope(0.5) - slope(1.0)) / 3)
    np.testing.assert_allclose(forward, numeric, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("outputs", [ROTATION, DEFAULT], ids=["rotation", "all peaks"])
@pytest.mark.parametrize("kind", ["one mode", "stories", "vertical"])
def test_solutions_under_each_power_add_up(kind, outputs, monkeypatch):
    """To the same as a solution under all of the ground motion of a panel, and to as sharp a bound."""
    motion, podium = shaking(400, peak=0.6), elastic(0.3)
    if kind == "stories":
        building = rj.ShearBuilding((3.0, 3.0, 2.0), (900.0, 700.0, 500.0), modes=2)
        podium = podium.replace(superstructure=building)
    if kind == "vertical":
        motion = rj.GroundMotion(motion, shaking(400, peak=0.3, seed=7))
    scene, plan, lane = start(podium, motion, outputs)
    # With records that are not broken at once.
    known = {name: getattr(lane, name) for name in ("deformation", "shear", "drifts", "floors")}
    lane = lane._replace(**{name: None if y is None else y + 1.0 for name, y in known.items()})
    cross = lambda: jax.jit(lambda lane: cross_full_contact.__wrapped__(scene, plan, lane))(lane)
    added = cross()
    monkeypatch.setattr(contact, "_FEW", -1)
    solved = cross()
    assert int(solved.steps) > 20
    assert int(added.steps) == int(solved.steps)
    np.testing.assert_array_equal(added.t, solved.t)
    for one, other, unit in zip((added.x, added.v), (solved.x, solved.v), (1e-2, 0.1), strict=True):
        np.testing.assert_allclose(one[1], other[1], rtol=1e-11, atol=1e-12 * unit)


@pytest.mark.parametrize("degree", [1, 16])
def test_interpolation(degree):
    nodes, to_powers, to_tail = _interpolation(degree)
    rng = np.random.default_rng(0)
    polynomial = rng.normal(size=degree + 1)
    values = np.polynomial.polynomial.polyval(nodes, polynomial)
    np.testing.assert_allclose(
        np.stack(_combine(to_powers, jnp.asarray(values))), polynomial, rtol=1e-8, atol=1e-9
    )
    assert len(to_tail) == (0 if degree == 1 else 2)
    if degree > 1:
        exact = np.polynomial.chebyshev.poly2cheb(polynomial)[-2:]
        np.testing.assert_allclose(
            np.stack(_combine(to_tail, jnp.asarray(values))), exact, rtol=1e-7, atol=1e-9
        )


@pytest.mark.parametrize("shear", [False, True])
def test_scenes_side_by_side_share_the_samples_of_records(shear):
    """Of rigid podiums the whole table was copied into every lane in every step."""
    table = rj.Records.of([shaking(61, seed=k) for k in range(3)])

    def peak(scale):
        outputs = ("peak_rotation", "peak_shear") if shear else ("peak_rotation",)
        motion, options = table.pick(1).scaled(scale), rj.Options(outputs=outputs)
        return rj.peak_response(PODIUMS["rigid"], motion, options=options).peak_rotation

    program = jax.jit(jax.vmap(peak)).lower(jnp.linspace(0.5, 2.0, 5)).as_text()
    assert "tensor<3x61xf64>" in program
    assert "tensor<5x3x61xf64>" not in program
