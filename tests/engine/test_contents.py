"""Blocks and oscillators on floors: closed forms, an independent integrator, derivatives, bad input."""

import dataclasses
import math
from types import SimpleNamespace
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import rockjax as rj
from rockjax._engine.scene import plan_for, prepare
from rockjax._engine.transitions import jolt
from rockjax._excitations.base import Shaking
from rockjax._excitations.piecewise import DEGREE, PiecewiseMotion
from rockjax._progress import BAR_LOCK
from rockjax._responses.on_floors import JoltFriction, _solve
from tests import reference_contents, restrained
from tests.scenes import shaking

FINE = rj.Options(rtol=1e-11, atol=1e-13)
FRAME = rj.Podium(alpha=0.15, R=1.5, gamma=10.0)
TOP = FRAME.replace(superstructure=rj.Elastic(30.0, 0.5, 0.05))
HEAVY = TOP.replace(restitution="compatible")
BLOCK = rj.Contents(0.2, 0.5)
PULSE = rj.Ricker(3.0, 1.0)


@jax.jit
def answers_to_a_jump(jump, alpha):
    """Return the floats and integers of a block at rest under a single velocity jump of its floor."""
    times = jnp.array([0.0, 0.5, 6.0])
    across, up = (
        PiecewiseMotion(times, jnp.zeros((3, DEGREE + 1)), jnp.array([0.0, 1.0, 0.0]) * y)
        for y in (jump, 0.0)
    )
    options = FINE.replace(outputs=("peak_rotation", JoltFriction()))
    return _solve(rj.Podium(alpha, 0.5), rj.GroundMotion(across, up), times[-1], options, False)


def started_by(jump: float, alpha=0.2):
    """Return the peak [rad] of a block under a single velocity jump, whether it overturns, and its friction
    demands at the jump and at its own impacts."""
    floats, integers, _ = answers_to_a_jump(jump, alpha)
    friction = float(floats["jolt_friction"]), float(rj.Podium(alpha, 0.5).impact_friction[0])
    return float(floats["peak_rotation"]) * alpha, bool(integers["overturned"]), friction


def test_a_jump_starts_a_block():
    """Facts 14 and 19: peak after one jump, overturning jump, friction demands."""
    peak, _, friction = started_by(0.3)
    np.testing.assert_allclose(peak, 0.03658828377247352, rtol=1e-9)
    np.testing.assert_allclose(friction, [1.914665005873861, 0.1504866019045806], rtol=1e-12)
    np.testing.assert_allclose(started_by(0.3, 0.3)[2], [1.490024380734774, 0.2265818444748230], rtol=1e-12)
    limit = 0.5209128360247842
    assert not started_by(limit * (1 - 1e-6))[1]
    assert started_by(limit * (1 + 1e-6))[1]


def test_a_jump_moves_a_rocking_block():
    """Facts 14 to 16; an upward jump alone never lifts a block at rest."""
    still = rj.GroundMotion(rj.Rest(), rj.Rest())

    def after(theta, side, across, up, block=rj.Podium(0.2, 0.5)):
        scene, _ = prepare(block.split_rows(), still, rj.State(), None, FINE, plan_for(block, FINE, False))
        x, v = (jnp.asarray(theta),), (jnp.zeros(()),)
        at_rest = Shaking(jnp.zeros(()), jnp.zeros(()))
        return jolt(scene, jnp.asarray(side), x, v, at_rest, Shaking(jnp.asarray(across), jnp.asarray(up)))

    for up, rate in ((0.09122700786751294, 1.030674369188189), (0.0, 1.081223289597132)):
        lifted = after(0.0, 0.0, 0.6036118453365736, up, rj.Podium(0.3, 0.4))
        np.testing.assert_allclose(float(lifted.v[0]), -rate, rtol=1e-12)
    np.testing.assert_allclose(float(after(0.05, 1.0, 0.3, 0.1).v[0]), -0.4673627049422589, rtol=1e-12)
    lifted = after(0.0, 0.0, 0.3, 0.0)
    np.testing.assert_allclose(float(lifted.v[0]), -0.3 * 1.470099866761862, rtol=1e-12)
    assert float(lifted.sigma) == -1
    for up, sigma in ((0.3 / math.tan(0.2) * (1 + 1e-9), 0), (0.3 / math.tan(0.2) * (1 - 1e-6), -1)):
        assert float(after(0.0, 0.0, 0.3, up).sigma) == sigma
    assert float(after(0.0, 0.0, 0.0, 0.3).sigma) == 0


def test_a_jump_that_reverses_a_block_is_a_turning_point():
    """The second jump presses the rising block down. The block rises less at its other edge."""
    across = PiecewiseMotion(
        jnp.array([0.0, 0.5, 0.6, 6.0]), jnp.zeros((4, DEGREE + 1)), jnp.array([0.0, 0.3, -0.2, 0.0])
    )
    still = PiecewiseMotion(across.times, across.coefficients, jnp.zeros(4))
    block, options = rj.Podium(0.2, 0.5), FINE.replace(outputs=("peak_rotation", "margin"))
    floats, _, _ = _solve(block, rj.GroundMotion(across, still), jnp.asarray(6.0), options, False)
    # Until the second jump the block moves freely: θ̈ = −p² sin(α − θ).
    motion = scipy.integrate.solve_ivp(
        lambda t, y: (y[1], -(float(block.p) ** 2) * math.sin(0.2 - y[0])),
        (0.5, 0.6),
        (0.0, 0.3 * 1.470099866761862),
        rtol=1e-12,
        atol=1e-14,
    )
    angle = motion.y[0, -1]
    np.testing.assert_allclose(float(floats["peak_rotation"]), angle / 0.2, rtol=1e-8)
    np.testing.assert_allclose(float(floats["peak_rotation_time"]), 0.6, rtol=1e-12)
    lowest = (math.cos(0.2 - angle) - math.cos(0.2)) / (1 - math.cos(0.2))
    np.testing.assert_allclose(float(floats["margin"]), 1 - lowest, rtol=1e-7)


def test_one_impact_starts_a_block():
    """Facts 16 and 19: a frame that comes to rest at its first impact, with and without vertical motion of
    the block."""
    podium = FRAME.replace(restitution=0.0)
    systems = rj.Contents(0.3, 0.4), rj.Contents(0.3, 0.4, vertical=False)
    response = rj.simulate(
        podium, rj.Rest(), initial=rj.State(theta=0.05), t_end=4.0, options=FINE, on_floors=systems
    )
    found, deck = response.on_floors, response.floor()
    np.testing.assert_allclose(deck.velocity_jumps, [0.6036118453365736], rtol=1e-9)
    np.testing.assert_allclose(deck.vertical_velocity_jumps, [0.09122700786751294], rtol=1e-9)
    for each, peak in zip(found, (0.1221296327300025, 0.1393632265028351), strict=True):
        np.testing.assert_allclose(each.peak_rotation, peak / 0.3, rtol=1e-9)
        np.testing.assert_allclose(each.uplift_time, 0.5285930092632813, rtol=1e-9)
        assert each.started_by_impulse
    demands = [each.friction_demand for each in found]
    np.testing.assert_allclose(demands, [0.9844854941904820, 1.490024380734774], rtol=1e-9)


@pytest.mark.slow
def test_an_impact_of_a_building_starts_a_block():
    """Fact 18: an impact under a building starts a block on the deck."""
    # `test_derivatives_agree_with_differences` has the same kinds of systems, so the program is the same.
    systems = rj.Contents(0.4, 0.5), rj.Contents(0.25, 0.3, level=1), rj.Oscillator(0.2)
    scene: Any = {"t_end": 8.0, "options": FINE, "on_floors": systems}
    found, *_ = rj.peak_response(HEAVY, rj.Ricker(2.4, 1.0), **scene).on_floors
    np.testing.assert_allclose(found.uplift_time, 0.61680535044807, rtol=1e-9)
    np.testing.assert_allclose(found.peak_rotation, 0.0504477897294 / 0.4, rtol=1e-8)
    assert found.started_by_impulse


@pytest.mark.slow
def test_oscillators_agree_with_their_closed_form():
    """Fact 9; every level of a building agrees with floor spectra, which use another method."""
    periods = np.array([0.05, 0.5, 2.0])
    systems = [rj.Oscillator(T) for T in periods] + [rj.Oscillator(T, direction="vertical") for T in periods]
    found = rj.peak_response(FRAME, rj.Ricker(3.2, 1.0), t_end=8.0, options=FINE, on_floors=systems).on_floors
    values = [float(each.pseudo_acceleration) for each in found]
    reference = [5.42355969, 5.68864346, 8.75070007, 21.63090363, 2.85445778]
    np.testing.assert_allclose(values[:5], reference, rtol=1e-8)
    building = FRAME.replace(superstructure=rj.ShearBuilding([3, 3, 2], [900, 700, 500], modes=2))
    levels = "deck", 1, 3
    systems = [rj.Oscillator(T, 0.02, level) for level in levels for T in periods]
    options = rj.Options(rtol=1e-9, atol=1e-11)
    found = rj.peak_response(building, rj.OneSine(3.0, 0.9), t_end=6.0, options=options, on_floors=systems)
    exact = [
        rj.floor_spectrum(
            building, rj.OneSine(3.0, 0.9), periods, damping=0.02, level=level, t_end=6.0, options=options
        )
        for level in levels
    ]
    for name in ("relative_displacement", "absolute_acceleration"):
        values = [float(getattr(each, name)) for each in found.on_floors]
        expected = np.concatenate([np.ravel(each[name]) for each in exact])
        np.testing.assert_allclose(values, expected, rtol=1e-6)


def test_free_vibration_on_a_floor_at_rest_counts_after_the_end():
    """Fact 6, whose peaks follow the pulse, in a scene that ends with the pulse. Answers are proportional to
    a_p; if all times grow with s, displacements grow with s²."""

    def values(y):
        a_p, T_p, T_e = y
        motion = rj.OneSine(a_p, T_p)
        oscillator = rj.Oscillator(T_e, 0.02)
        end = motion.support[1]
        (found,) = rj.peak_response(FRAME, motion, t_end=end, options=FINE, on_floors=oscillator).on_floors
        sizes = jnp.stack([found.relative_displacement, found.absolute_acceleration])
        return sizes, (sizes, found.remaining_ratio)

    y = jnp.array([1.0, 0.8, 1.5])
    slopes, (sizes, ratio) = jax.jacfwd(values, has_aux=True)(y)
    np.testing.assert_allclose(sizes, [0.07941081624380533, 1.394454688752405], rtol=1e-9)
    np.testing.assert_allclose(ratio, 1.0, rtol=1e-12)
    np.testing.assert_allclose(slopes[:, 0], sizes, rtol=1e-9)
    np.testing.assert_allclose(slopes[:, 1:] @ y[1:], sizes * np.array([2.0, 0.0]), atol=1e-9)


def test_later_displacements_stay_below_the_remaining_ratio():
    """(L17) on a frame that still rocks at the end, and no bound vertically."""
    systems = [
        rj.Oscillator(T, direction=way) for way in ("horizontal", "vertical") for T in (0.05, 0.5, 2.0)
    ]
    scene: Any = {"options": FINE, "on_floors": systems}
    early, late = (rj.peak_response(FRAME, rj.Ricker(3.2, 1.0), t_end=t, **scene) for t in (2.6, 8.0))
    for k, (now, later) in enumerate(zip(early.on_floors, late.on_floors, strict=True)):
        bound = now.remaining_ratio * now.relative_displacement
        assert later.relative_displacement <= jnp.maximum(now.relative_displacement, bound)
        assert np.isinf(now.remaining_ratio) == (k >= 3)
    spectrum = rj.floor_spectrum(FRAME, rj.Ricker(3.2, 1.0), [0.05, 0.5, 2.0], t_end=2.6, options=FINE)
    ratios = [float(each.remaining_ratio) for each in early.on_floors[:3]]
    np.testing.assert_allclose(ratios, spectrum["remaining_ratio"].values.ravel(), rtol=1e-6)


def test_on_a_podium_that_never_lifts_a_block_stands_on_the_ground():
    """Fact 21: the block rocks as on the ground, with and without vertical motion."""
    stocky = rj.Podium(0.6, 2.0, gamma=5.0)
    pulse = rj.OneSine(2.6, 0.8)
    pair = rj.GroundMotion(pulse, rj.OneSine(1.5, 0.5))
    systems = BLOCK, dataclasses.replace(BLOCK, vertical=False)
    answers = rj.peak_response(stocky, pair, options=FINE, on_floors=systems).on_floors
    for found, motion in zip(answers, (pair, pulse), strict=True):
        ground = rj.peak_response(rj.Podium(0.2, 0.5), motion, options=FINE)
        np.testing.assert_allclose(found.peak_rotation, ground.peak_rotation, rtol=1e-8)
        np.testing.assert_allclose(found.uplift_time, ground.uplift_time, rtol=1e-9)
        assert found.impacts > 0
        assert not found.started_by_impulse


@pytest.mark.parametrize(("velocity", "cycles"), [(0.2, 4.0), (0.25, 8.0)])
def test_a_pulse_of_many_cycles_reaches_a_block_on_a_deck_in_full_contact(velocity, cycles):
    """The tolerance does not limit the steps in full contact, but they resolve the pulse."""
    pulse, end = rj.MavroeidisPapageorgiou(velocity, 1.0, gamma=cycles, nu=0.0), cycles + 3.0
    stocky, block = rj.Podium(1.2, 1.5, gamma=10.0), rj.Contents(0.1, 2.0)
    (found,) = rj.peak_response(stocky, pulse, t_end=end, options=FINE, on_floors=block).on_floors
    ground = rj.peak_response(rj.Podium(0.1, 2.0), pulse, t_end=end, options=FINE)
    np.testing.assert_allclose(found.peak_rotation, ground.peak_rotation, rtol=1e-10)
    np.testing.assert_allclose(found.uplift_time, ground.uplift_time, rtol=0, atol=1e-10)


# Structure, pulse, ratio of the vertical motion, and blocks with the mode weights of their floors.
SCENES = {
    "rigid deck": (FRAME, ("ricker", 3.2, 1.0), 0.0, [(rj.Contents(0.12, 0.4), ())]),
    "building": (
        HEAVY,
        ("one_sine", 3.0, 0.9),
        0.4,
        [
            (rj.Contents(0.1, 0.8), (0.0,)),
            (rj.Contents(0.3, 0.6, vertical=False), (0.0,)),
            (rj.Contents(0.18, 0.6, level=1), (1.0,)),
            (rj.Contents(0.15, 0.5, level=1, restitution=0.7), (1.0,)),
        ],
    ),
}


@pytest.mark.slow(but=["rigid deck"])
@pytest.mark.parametrize("name", SCENES)
def test_blocks_agree_with_an_independent_integrator(name):
    podium, (kind, a_p, T_p), up, blocks = SCENES[name]
    pulse = {"ricker": rj.Ricker, "one_sine": rj.OneSine}[kind](a_p, T_p)
    start, stop = (float(y) for y in pulse.support)
    horizontal = restrained.ricker(a_p, T_p) if kind == "ricker" else restrained.one_sine(a_p, T_p)
    motion = rj.GroundMotion(pulse, pulse.scaled(up)) if up else pulse
    systems = [block for block, _ in blocks]
    if podium is FRAME:  # the kinds of systems, and so the program, of the test of batches
        systems += [rj.Oscillator(0.3), rj.Contents(0.4, 0.5)]
    answers = rj.peak_response(podium, motion, t_end=start + 3.5, options=FINE, on_floors=systems).on_floors
    motions = horizontal, lambda t: up * horizontal(t)
    for found, (block, weights) in zip(answers[: len(blocks)], blocks, strict=True):
        e = float(block.block(podium.g).restitution_factor)
        numbers = float(block.alpha), float(block.R), 1 / 3, block.vertical
        scene: Any = {"weights": np.array(weights), "breaks": (start, stop), "start": start}
        frame, one = restrained.frame_of(podium), reference_contents.Block(*numbers, e)
        reference = reference_contents.block_on_floor(frame, one, start + 3.5, *motions, **scene)
        np.testing.assert_allclose(found.peak_rotation, reference.peak, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found.uplift_time, reference.uplift_time, rtol=1e-6)
        np.testing.assert_allclose(found.overturn_time, reference.overturn_time, rtol=1e-6)
        assert bool(found.started_by_impulse) == reference.by_impulse
        assert reference.peak > 0


def test_derivatives_agree_with_differences():
    """Forward and reverse derivatives with respect to the podium, the motion and the secondary systems. Fact
    22: scaling of all lengths."""

    def values(y):
        podium = HEAVY.replace(alpha=y[0], R=y[1], superstructure=rj.Elastic(30.0, y[8], 0.05))
        systems = rj.Contents(y[4], y[5]), rj.Contents(0.25, y[7], level=1), rj.Oscillator(y[6])
        found = rj.peak_response(podium, rj.Ricker(y[2], y[3]), t_end=6.0, options=FINE, on_floors=systems)
        block, other, oscillator = found.on_floors
        of_block = block.peak_rotation, block.uplift_time, block.peak_rotation_time
        of_others = other.peak_rotation, oscillator.relative_displacement, oscillator.absolute_acceleration
        return jnp.stack([*of_block, *of_others])

    y = np.array([0.15, 1.5, 2.4, 1.0, 0.4, 0.5, 0.2, 0.3, 0.5])
    base = np.asarray(values(jnp.asarray(y)))
    forward, reverse = (np.asarray(way(values)(jnp.asarray(y))) for way in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(forward, reverse, rtol=1e-12, atol=1e-12)
    # Lengths grow with s, periods with √s: the derivative with respect to ln s, times 2.
    sizes, times = [1, 5, 7], [3, 6, 8]
    by_size = 2 * forward[:, sizes] @ y[sizes] + forward[:, times] @ y[times]
    np.testing.assert_allclose(by_size, base * [0, 1, 1, 0, 2, 0], rtol=1e-6, atol=1e-6)
    for k, number in enumerate(y):
        h, unit = 1e-4 * number, np.eye(y.size)[k]
        at = lambda step, unit=unit: np.asarray(values(jnp.asarray(y + step * unit)))
        slope = (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)
        np.testing.assert_allclose(forward[:, k], slope, rtol=1e-5, atol=1e-6 * np.abs(base / number).max())


@pytest.mark.slow
def test_derivatives_with_respect_to_samples_agree_with_differences():
    """Forward and reverse derivatives for a block and an oscillator, on the deck and on the top."""
    dt, (noise, direction) = 0.1, np.random.default_rng(2).normal(size=(2, 24))
    t = dt * np.arange(24)
    samples = 2.6 * np.sin(2 * np.pi * t / 0.9) * np.exp(-t) + 0.3 * noise
    blocks = rj.Contents(0.4, 0.5), rj.Contents(0.2, 0.5, level=1)
    systems = *blocks, rj.Oscillator(0.2), rj.Oscillator(0.3, level=1)

    def values(samples):
        found = rj.peak_response(HEAVY, rj.Record(samples, dt), t_end=4.0, options=FINE, on_floors=systems)
        deck, top, *oscillators = found.on_floors
        of_blocks = deck.peak_rotation, deck.uplift_time, top.uplift_time, top.overturn_time
        friction = deck.friction_demand, top.friction_demand
        of_oscillators = (y for x in oscillators for y in (x.relative_displacement, x.absolute_acceleration))
        return jnp.stack([*of_blocks, *friction, *of_oscillators])

    _, forward = jax.jvp(values, (samples,), (direction,))
    reverse = jax.jacrev(values)(samples)
    np.testing.assert_allclose(reverse @ direction, forward, rtol=1e-6)
    at = lambda step: np.asarray(values(samples + step * direction))
    h = 1e-4
    slope = (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)
    np.testing.assert_allclose(forward, slope, rtol=1e-6)


def test_nothing_acts_back_and_batches_agree_with_single_scenes():
    """Fact 23: the podium's answers are bitwise identical; mirrored motions and another order change
    nothing."""
    systems = rj.Contents(0.12, 0.4), rj.Oscillator(0.3), rj.Contents(0.4, 0.5, overturn_ratio=1.5)
    pulses = rj.Ricker(np.array([[2.0, 3.2], [-3.2, 9.0]]), 1.0)
    is_locked = []
    progress = SimpleNamespace(update=lambda _: is_locked.append(BAR_LOCK.locked()))
    batch = rj.peak_responses(FRAME, pulses, t_end=6.0, on_floors=systems, progress=progress)
    assert len(is_locked) > 1
    assert all(is_locked)  # only one thread at a time updates the progress
    plain = rj.peak_responses(FRAME, pulses, t_end=6.0)
    assert np.array_equal(batch.peak_rotation, plain.peak_rotation)
    assert plain.on_floors == ()
    for index in ((0, 0), (0, 1), (1, 1)):
        pulse = rj.Ricker(pulses.a_p[index], 1.0)
        single = rj.peak_response(FRAME, pulse, t_end=6.0, on_floors=systems)
        assert float(single.peak_rotation) == float(rj.peak_response(FRAME, pulse, t_end=6.0).peak_rotation)
        for one, many in zip(single.on_floors, batch.on_floors, strict=True):
            for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(many), strict=True):
                np.testing.assert_allclose(a, b[index], rtol=1e-7)
    blocks = batch.on_floors[0]
    np.testing.assert_allclose(blocks.peak_rotation[1, 0], blocks.peak_rotation[0, 1], rtol=1e-9)
    assert np.all(np.isfinite(blocks.margin))
    assert np.all(np.isnan(batch.on_floors[2].margin))  # a block beyond α_c may still return
    assert batch.overturned[1, 1]
    assert list(blocks.until_overturning.ravel()) == [False, False, False, True]
    turned = rj.peak_responses(FRAME, pulses, t_end=6.0, on_floors=systems[::-1])  # the same program
    for one, other in zip(batch.on_floors, turned.on_floors[::-1], strict=True):
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f")


@pytest.mark.slow
def test_modes_without_mass_and_split_modes_change_nothing():
    """Facts 8 and 23: an oscillator on the deck is a mode without mass, and two modes of one period are one
    mode, for the podium and for all secondary systems on it."""
    systems = rj.Contents(0.12, 0.4), rj.Oscillator(0.3, 0.02)
    u_b = 2 * 1.5 * (math.sin(0.15) - math.sin(0.05))
    for initial in (rj.State(), rj.State(theta=0.1, u_t=u_b, u_t_dot=0.0)):
        scene: Any = {"initial": initial, "t_end": 4.0, "options": FINE, "on_floors": systems}
        reference = rj.peak_response(TOP, PULSE, **scene)
        for eta in ([30.0, 0.0, 0.0], [12.0, 18.0, 0.0]):
            modes = rj.Modes(eta, [0.5, 0.5, 0.3], [0.05, 0.05, 0.02])
            found = rj.peak_response(FRAME.replace(superstructure=modes), PULSE, **scene)
            np.testing.assert_allclose(found.peak_rotation, reference.peak_rotation, rtol=1e-9)
            block, oscillator = found.on_floors
            displacement = oscillator.relative_displacement
            np.testing.assert_allclose(found.peak_deformation[2], displacement, rtol=1e-8)
            exact_block, exact_oscillator = reference.on_floors
            np.testing.assert_allclose(displacement, exact_oscillator.relative_displacement, rtol=1e-8)
            np.testing.assert_allclose(block.peak_rotation, exact_block.peak_rotation, rtol=1e-8)
            np.testing.assert_allclose(block.friction_demand, exact_block.friction_demand, rtol=1e-8)
            assert block.impacts == exact_block.impacts


def test_histories_and_records_have_things_on_floors():
    """Outside jit the history of the floors grows until it holds all 660 steps."""
    block = rj.Contents(0.13, 10.0)
    record, large, small = shaking(n=300), rj.Options(history=1024), rj.Options(history=256)
    peak = rj.peak_response(FRAME, record, options=large, on_floors=block).on_floors[0]
    response = rj.simulate(FRAME, record, options=large, on_floors=(block,))
    np.testing.assert_allclose(response.on_floors[0].peak_rotation, peak.peak_rotation, rtol=1e-9)
    grown = rj.peak_response(FRAME, record, options=small, on_floors=block).on_floors[0]
    assert float(grown.peak_rotation) == float(peak.peak_rotation)
    assert 0.1 < float(peak.peak_rotation) < 1
    assert 256 < int(response.nodes.used) < 1024


def test_a_floor_that_falls_faster_than_gravity_is_named():
    """g + v̈_g stays positive on the ground, but g + a_w becomes negative on the rocking deck."""
    pair = rj.GroundMotion(rj.OneSine(6.0, 0.8), rj.OneSine(9.7, 0.8))
    (found,) = rj.peak_response(FRAME, pair, on_floors=BLOCK).on_floors
    assert found.result == rj.RESULTS.weightless


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rj.Contents(1.6, 0.5), r"alpha must be in \(0, π/2\)"),
        (lambda: rj.Contents(0.2, 0.0), "R must be"),
        (lambda: rj.Contents(0.2, 0.5, lam=-0.1), "lam must be"),
        (lambda: rj.Contents(0.2, 0.5, restitution=1.2), "Contents: restitution must be"),
        (lambda: rj.Contents(0.2, 0.5, overturn_ratio=9.0), "overturn_ratio"),
        (lambda: rj.Contents(0.2, 0.5, level=0), "level must be 'deck'"),
        (lambda: rj.Contents(0.2, 0.5, vertical=cast(Any, "no")), "vertical must be True or False"),
        (lambda: rj.Oscillator(0.0), "period must be"),
        (lambda: rj.Oscillator(0.3, 1.0), r"damping must be in \[0, 1\)"),
        (lambda: rj.Oscillator(0.3, direction=cast(Any, "up")), "direction must be"),
        (lambda: rj.peak_response(FRAME, PULSE, on_floors=rj.Contents(0.2, 0.5, level=1)), "level must be"),
        (lambda: rj.peak_response(FRAME, PULSE, on_floors=cast(Any, (FRAME,))), "on_floors must hold"),
        (lambda: rj.peak_responses(TOP, PULSE, on_floors=rj.Oscillator(0.2, level=2)), "level must be"),
    ],
)  # fmt: skip
def test_bad_input_is_named(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_blocks_from_dimensions():
    block = rj.Contents.from_dimensions(0.4, 1.8, level="deck", vertical=False)
    np.testing.assert_allclose(float(block.alpha), math.atan(0.4 / 1.8))
    np.testing.assert_allclose(float(block.R), 0.5 * math.hypot(0.4, 1.8))
    assert "alpha=0.218669" in repr(block)
