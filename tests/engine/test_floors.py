"""Motion of the deck and of floors: facts in closed form, (L1) to (L4), records of floors, bad input."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._engine.coefficients import coefficients
from rockjax._engine.model import acceleration, beam_absolute_acceleration
from rockjax._oscillators import Load
from rockjax._responses.floor import largest_acceleration
from tests.scenes import shaking

FINE = rj.Options(rtol=1e-12, atol=1e-14)
FRAME = rj.Podium(alpha=0.15, R=1.5, gamma=10.0, lam=1 / 3)
TOP = FRAME.replace(superstructure=rj.Elastic(30.0, 0.5, 0.05))
THETA = 0.1


@pytest.fixture(scope="module")
def free():
    """Return the history of free rocking of the rigid frame until rest."""
    return rj.simulate(FRAME, rj.Rest(), initial=rj.State(theta=THETA), t_end=200.0, options=FINE)


@pytest.fixture(scope="module")
def frame():
    return rj.simulate(FRAME, rj.Ricker(3.2, 1.0), t_end=8.0, options=FINE)


def released(**changes):
    """Return the history of the elastic structure, released without deformation."""
    u_b = 2 * 1.5 * (math.sin(0.15) - math.sin(0.15 - THETA))
    initial = rj.State(theta=THETA, u_t=u_b)
    return rj.simulate(TOP.replace(**changes), rj.Rest(), initial=initial, t_end=1.0, options=FINE)


def jump_ratio(podium):
    """Return (1−e)/((1+e) tan α), the ratio |Δv_b|/Δw."""
    e = float(podium.restitution_factor)
    return (1 - e) / ((1 + e) * math.tan(float(podium.alpha)))


def test_free_rocking_has_the_jumps_of_its_closed_form(free):
    deck = free.floor()
    jumps, vertical = np.asarray(deck.velocity_jumps), np.asarray(deck.vertical_velocity_jumps)
    np.testing.assert_allclose(
        free(deck.impulse_times[0], left=True).theta_dot, -0.2574759207580854, rtol=1e-9
    )
    np.testing.assert_allclose(jumps[:2], [0.03383684907358092, -0.03233776427829034], rtol=1e-9)
    np.testing.assert_allclose(vertical[0], 0.2257463849669109, rtol=1e-9)
    np.testing.assert_allclose(np.abs(jumps).sum(), 0.7637542311316412, rtol=1e-9)
    np.testing.assert_allclose(vertical.sum(), 5.095473172050416, rtol=1e-9)
    assert deck.peak_velocity_jump == np.abs(jumps).max()
    np.testing.assert_allclose(np.abs(jumps[:9] / vertical[:9]), 0.1498887748680476, rtol=1e-9)


def test_jumps_of_frames_have_their_ratio():
    """Fact 17: the ratio of the jumps of frames."""
    block = rj.Podium(alpha=0.15, R=1.5)
    for podium, exact in (
        (FRAME, 0.1498887748680476),
        (block, 0.1127077997631335),
        (TOP, 0.1508158376214710),
        (TOP.replace(restitution="compatible"), 0.5885876281403821),
        (block.replace(restitution=math.cos(0.3)), math.tan(0.15)),
    ):
        np.testing.assert_allclose(jump_ratio(podium), exact, rtol=1e-12)


@pytest.mark.parametrize(("gamma", "exact"), [(10.0, 0.006562912782958232), (0.0, -0.4665023668442045)])
def test_a_jump_of_the_ground_acceleration_reaches_the_deck_in_part(gamma, exact):
    """Fact 4: k_g at ψ = α, and 1 in full contact."""
    c = coefficients(FRAME.replace(gamma=gamma).split_rows(), 1e-8, False)
    x = v = (jnp.zeros(()),)

    def deck(sigma, ground):
        a = acceleration(c, sigma, ground, x, v)
        return float(beam_absolute_acceleration(c, sigma, ground, x, v, a))

    for sigma in (-1.0, 1.0):
        np.testing.assert_allclose(deck(sigma, 1.0) - deck(sigma, 0.0), exact, rtol=1e-12)
    assert deck(0.0, 0.7) == 0.7


def test_free_rocking_has_the_accelerations_of_its_closed_form(free):
    deck = free.floor()
    first = deck.impulse_times[0]
    found = [
        deck.acceleration(0.0),
        deck.acceleration(first, left=True),
        deck.acceleration(first),
        deck.vertical_acceleration(first, left=True),
    ]
    exact = [0.4974111019972249, 1.442682607714104, 1.445257705404386, 0.4191802867300486]
    np.testing.assert_allclose(np.abs(found), exact, rtol=1e-9)
    np.testing.assert_allclose(deck.peak_acceleration, 1.472403095026547, rtol=1e-9)


def test_velocity_and_displacement_belong_to_the_acceleration(frame):
    deck, excitation = frame.floor(), frame.excitation
    t, h = np.linspace(-1.0, 3.0, 12) + 0.013, 1e-5
    relative = deck.acceleration(t) - excitation(t)
    np.testing.assert_allclose((deck.velocity(t + h) - deck.velocity(t - h)) / (2 * h), relative, atol=1e-6)
    speed = (deck.displacement(t + h) - deck.displacement(t - h)) / (2 * h)
    np.testing.assert_allclose(speed, deck.velocity(t), atol=1e-8)


def test_peaks_of_a_pulse_agree_with_the_reference(frame):
    deck = frame.floor()
    np.testing.assert_allclose(deck.peak_acceleration, 1.486677823722, rtol=1e-9)
    np.testing.assert_allclose(deck.peak_velocity_jump, 0.0282409011033, rtol=1e-9)
    np.testing.assert_allclose(np.max(deck.vertical_velocity_jumps), 0.188412381969, rtol=1e-9)


@pytest.mark.parametrize(("top", "largest"), [(0.05, 0.01), (1.05, 0.009975)])
def test_a_largest_acceleration_is_inside_its_piece(top, largest):
    """A maximum just after the start of a piece counts, and one just after its end does not."""
    terms = 0.01 * np.array([[1 - top**2, 2 * top, -1.0]])
    start, zero = np.zeros(1), np.zeros(1)
    one = Load(start, np.ones(1), terms, zero, zero, zero)
    np.testing.assert_allclose(largest_acceleration(one), largest, rtol=1e-12)


def test_accelerations_of_the_ground_jump_at_its_breakpoints():
    still = rj.simulate(FRAME, rj.OneCosine(0.123, 1.0), options=FINE).floor()
    start = float(still.excitation.support[0])
    np.testing.assert_allclose(
        still.acceleration(np.array([start, start + 0.5])), [0.123, -0.123], rtol=1e-12
    )
    assert np.isnan(still.acceleration(start, left=True))
    end = float(still.excitation.support[1])
    assert still.acceleration(end) == 0
    np.testing.assert_allclose(still.acceleration(end, left=True), 0.123, rtol=1e-9)
    assert still.peak_acceleration == pytest.approx(0.123, rel=1e-12)
    assert still.vertical_acceleration(start + 0.3) == 0
    rocking = rj.simulate(FRAME, rj.OneCosine(4.0, 1.0), options=FINE)
    end, deck = float(rocking.excitation.support[1]), rocking.floor()
    psi, inertia = 0.15 - abs(float(rocking(end).theta)), 3 * 10 + 0.75 * 4 / 3
    k_g = 1 - 3 * (1 + 2 * 10) * math.cos(psi) ** 2 / (2 * inertia)
    assert psi < 0.15
    jump = deck.acceleration(end) - deck.acceleration(end, left=True)
    np.testing.assert_allclose(jump, -4 * k_g, rtol=1e-6)


@pytest.mark.parametrize(("law", "after"), [("paper", -1.3884663521), ("compatible", -1.2753912728)])
def test_an_impact_makes_a_finite_jump_on_an_elastic_top(law, after):
    scene = released(restitution=law)
    top, first = scene.floor(1), scene.impact_times[0]
    np.testing.assert_allclose(scene(first, left=True).theta_dot, -0.25532599748, rtol=1e-10)
    found = [top.acceleration(first, left=True), top.acceleration(first)]
    np.testing.assert_allclose(found, [-1.4308869259, after], rtol=1e-9)
    assert not np.any(top.velocity_jumps)
    jump = 2 * 0.05 * (2 * math.pi / 0.5) * scene.floor().velocity_jumps[0]
    np.testing.assert_allclose(found[1] - found[0], jump, rtol=1e-9)
    np.testing.assert_allclose(top.vertical_acceleration(first), scene.floor().vertical_acceleration(first))
    ratio = np.abs(scene.floor().velocity_jumps) / scene.floor().vertical_velocity_jumps
    np.testing.assert_allclose(ratio, jump_ratio(scene.podium), rtol=1e-9)


def test_the_top_agrees_with_the_shear_of_the_history():
    top = released()
    t = np.linspace(0.05, 0.95, 7)
    np.testing.assert_allclose(top.floor(1).acceleration(t), -top.base_shear(t) * top.podium.g, rtol=1e-12)
    np.testing.assert_allclose(top.floor(1).displacement(t), top(t).u_t, rtol=1e-12)
    assert top.floor(1).peak_acceleration == pytest.approx(
        float(top.peak_shear) * float(top.podium.g), rel=1e-7
    )


def test_floors_of_a_building_with_few_modes_keep_a_share_of_the_jumps():
    shares = {
        1: [0.5137908, 0.0185937, -0.3075188],
        2: [0.2069200, -0.1863701, 0.0944136],
        3: [0.0, 0.0, 0.0],
    }
    for modes, exact in shares.items():
        building = rj.ShearBuilding([3.0, 3.0, 2.0], [900.0, 700.0, 500.0], modes=modes)
        found = 1 - np.asarray(building.story_weights).sum(axis=-1)
        np.testing.assert_allclose(found, exact, atol=6e-8)
    podium = FRAME.replace(superstructure=rj.ShearBuilding([3.0, 3.0, 2.0], [900.0, 700.0, 500.0], modes=1))
    scene = rj.simulate(podium, rj.Rest(), initial=rj.State(theta=0.05), t_end=1.0)
    deck, lowest, weighted = scene.floor(), scene.floor(1), scene.floor(weights=np.ones(1))
    np.testing.assert_allclose(lowest.velocity_jumps, 0.5137908 * deck.velocity_jumps, rtol=1e-6)
    assert np.abs(deck.velocity_jumps).max() > 1e-3
    assert not np.any(weighted.velocity_jumps)
    t = np.linspace(0.1, 0.9, 5)
    np.testing.assert_allclose(lowest.acceleration(t), scene.floor_acceleration(t)[:, 0], rtol=1e-12)


def test_a_rigid_top_moves_with_the_deck(free):
    podium = FRAME.replace(gamma=4.0, superstructure=rj.Rigid(6.0))
    scene = rj.simulate(podium, rj.Rest(), initial=rj.State(theta=THETA), t_end=2.0, options=FINE)
    t = np.linspace(0.1, 1.9, 5)
    np.testing.assert_allclose(scene.floor(1).acceleration(t), free.floor().acceleration(t), rtol=1e-8)


@pytest.mark.parametrize("direction", ["horizontal", "vertical"])
def test_records_of_floors_keep_velocity_and_displacement(frame, direction):
    deck = frame.floor()
    end, dt = 8.0, 0.013
    record = deck.to_record(dt, direction)
    t = float(record.t_start) + dt * np.arange(record.acceleration.size)
    a = np.asarray(record.acceleration)
    speed, place = dt * a.sum(), dt * (a * (end - t)).sum()
    if direction == "vertical":
        theta, theta_dot = (float(y) for y in (frame(end).theta, frame(end).theta_dot))
        psi = np.sign(theta) * 0.15 - theta
        assert speed == pytest.approx(3.0 * theta_dot * math.sin(psi), abs=1e-7)
        assert place == pytest.approx(3.0 * (math.cos(psi) - math.cos(0.15)), abs=1e-7)
        index = np.arange(a.size)
        places = [dt**2 * (a[:n] * (n - index[:n])).sum() for n in (200, 250, 300)]
        theta = np.array([abs(float(frame(t[n]).theta)) for n in (200, 250, 300)])
        assert theta.max() > 0.01
        np.testing.assert_allclose(places, 3.0 * (np.cos(0.15 - theta) - math.cos(0.15)), atol=1e-7)
        return
    ground = rj.Motion(np.asarray(frame.excitation(np.linspace(-3, end, 11001))), 0.001)
    assert speed == pytest.approx(float(deck.velocity(end)) + ground.velocity[-1], abs=1e-6)
    assert place == pytest.approx(float(deck.displacement(end)) + ground.displacement[-1], abs=1e-6)


def test_the_impact_that_ends_a_scene_is_part_of_loads_and_records():
    podium, initial = rj.Podium(0.2, 1.0, gamma=1.0, restitution=0.0), rj.State(theta=0.1)
    deck = rj.simulate(podium, rj.Rest(), initial=initial).floor()
    record, vertical = deck.to_record(0.01), deck.to_record(0.01, "vertical")
    # The deck starts and ends at rest.
    assert 0.01 * float(record.acceleration.sum()) == pytest.approx(0.0, abs=1e-8)
    assert 0.01 * float(vertical.acceleration.sum()) == pytest.approx(0.0, abs=1e-8)
    kick = np.abs(deck.load().kick).max()
    assert kick == pytest.approx(deck.peak_velocity_jump, rel=1e-12)
    assert kick > 0.1


def test_floors_work_under_jit():
    def jumps(theta):
        scene = rj.simulate(
            FRAME, rj.Rest(), initial=rj.State(theta=theta), t_end=1.0, options=FINE.replace(history=64)
        )
        deck = scene.floor()
        return deck.velocity_jumps[0], deck.acceleration(0.3)

    value, slope = jax.jvp(jax.jit(jumps), (THETA,), (1.0,))
    # |θ̇⁻|² = 2J(cos(α−θ_0) − cos α); derivatives of the deck's acceleration at a fixed time by differences.
    change = (np.array(jax.jit(jumps)(THETA + 1e-6)) - np.array(jax.jit(jumps)(THETA - 1e-6))) / 2e-6
    np.testing.assert_allclose(value[0], 0.03383684907358092, rtol=1e-9)
    np.testing.assert_allclose(slope[1], change[1], rtol=1e-6)


@pytest.mark.parametrize("level", ["roof", 0, 2, 1.0, True, None])
def test_levels_that_are_not_there_are_refused(level):
    with pytest.raises(ValueError, match=r"Response.floor: level must be 'deck' or a story from 1 to 1, got"):
        released().floor(level)


def test_floors_refuse_other_bad_input(free):
    with pytest.raises(ValueError, match="level must be 'deck', got level = 1"):
        free.floor(1)
    with pytest.raises(ValueError, match="weights must have one value for each of the 0 modes"):
        free.floor(weights=np.ones(1))
    with pytest.raises(ValueError, match="direction must be one of"):
        free.floor().to_record(0.01, "up")
    with pytest.raises(ValueError, match="dt must be finite and > 0"):
        free.floor().to_record(0.0)


def test_the_deck_keeps_the_vertical_acceleration_of_the_ground_in_full_contact():
    pair = rj.GroundMotion(rj.OneSine(0.5, 0.8), rj.OneSine(2.0, 0.5))
    deck = rj.simulate(FRAME, pair, options=FINE).floor()
    t = np.linspace(0.01, 0.49, 7)
    np.testing.assert_allclose(deck.vertical_acceleration(t), pair.vertical(t), rtol=1e-12)
    np.testing.assert_allclose(deck.acceleration(t), pair.horizontal(t), rtol=1e-12)
    assert np.abs(pair.vertical(t)).max() > 1


def test_a_record_in_full_contact_moves_the_deck():
    record = shaking(peak=0.5)
    deck = rj.simulate(FRAME, record).floor()
    assert deck.peak_acceleration == pytest.approx(0.5, rel=1e-12)
