"""The motion of floors along a history, and secondary systems on hand-made floor motions, in closed form."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import rockjax as rj
from rockjax._excitations.piecewise import DEGREE, NODES, PiecewiseMotion
from rockjax._responses.floor_course import FloorCourse, course_of, floor_course
from rockjax._responses.floor_end import Ending, ending
from rockjax._responses.history import pad_nodes
from rockjax._responses.on_floors import _rock, _vibrate

FINE = rj.Options(rtol=1e-12, atol=1e-14)
FRAME = rj.Podium(alpha=0.15, R=1.5, gamma=10.0, lam=1 / 3)
FIRST, E_FRAME = 0.2574759207580854, 0.9556966787294318  # |θ̇| before the first impact (fact 1), and e
G = 9.80665


def course_along(response, has_fallen=False):
    """The course along a history, whose unused nodes are padded, and the used nodes."""
    podium, excitation, nodes, limit, method, rtol = response.floor().scene
    along = lambda nodes, fallen: course_of((podium, excitation, nodes, limit, method, rtol), fallen)
    course = jax.jit(along)(pad_nodes(nodes), jnp.asarray(has_fallen))
    return jax.tree.map(np.asarray, course), jax.tree.map(np.asarray, nodes)


def test_a_course_of_free_rocking_has_its_closed_form():
    """Facts 1 and 2, (L4) at all nodes of all steps, and (L17) at the end."""
    response = rj.simulate(FRAME, rj.Rest(), initial=rj.State(theta=0.1), t_end=6.0, options=FINE)
    course, nodes = course_along(response)
    used = int(nodes.used)
    assert course.times.size > used
    np.testing.assert_array_equal(course.times[:used], nodes.t[:used])
    assert np.isinf(course.times[used:]).all()
    assert course.end == nodes.t[used - 1] == 6.0
    (impacts,) = np.nonzero(np.isfinite(nodes.impact_time[:used]))
    assert impacts.size > 2
    jumps = course.jumps[impacts]
    np.testing.assert_allclose(jumps[:2, 0], [0.03383684907358092, -0.03233776427829034], rtol=1e-9)
    np.testing.assert_allclose(jumps[0, 1], 0.2257463849669109, rtol=1e-9)
    assert np.count_nonzero(course.jumps[:, 0]) == impacts.size
    t = nodes.t[: used - 1, None] + np.diff(nodes.t[:used])[:, None] * (1 + NODES) / 2
    count = np.searchsorted(nodes.t[impacts], nodes.t[: used - 1], side="right")[:, None]  # of impacts
    J = 3 * G / 4 / 1.5 * 21 / 31
    psi = (-1) ** count * 0.15 - np.asarray(response(t[:, 1:-1]).theta)
    c = math.cos(0.15) + E_FRAME ** (2 * count) * (math.cos(0.05) - math.cos(0.15))
    across = -2 * 1.5 * J * np.sin(psi) * (3 * np.cos(psi) - 2 * c)
    up = -2 * 1.5 * J * (1 - 3 * np.cos(psi) ** 2 + 2 * c * np.cos(psi))
    found = course.accelerations[: used - 1]
    np.testing.assert_allclose(found[:, 1:-1, 0], across, atol=1e-9)
    np.testing.assert_allclose(found[:, 1:-1, 1], up, atol=1e-9)
    before, after = found[impacts[0] - 1, -1], found[impacts[0], 0]
    np.testing.assert_allclose(before, [-1.442682607714104, -0.4191802867300486], rtol=1e-9)
    np.testing.assert_allclose(after[0], 1.445257705404386, rtol=1e-9)
    ended = course.ending
    assert not ended.rests
    speed = 3 * math.cos(0.15) * FIRST * E_FRAME**impacts.size
    np.testing.assert_allclose(ended.impact_speed, speed, rtol=1e-9)
    assert 0 < ended.speed < speed
    np.testing.assert_allclose(ended.restitution, E_FRAME, rtol=1e-12)
    assert np.isinf(course_along(response, has_fallen=True)[0].ending.speed)


def test_a_course_of_an_elastic_top_has_its_jump_of_acceleration():
    """Fact 13, with the mode split into two: the velocities of modes do not jump at an impact."""
    u_b = 2 * 1.5 * (math.sin(0.15) - math.sin(0.05))
    modes = rj.Modes([12.0, 18.0], [0.5, 0.5], [0.05, 0.05])
    initial = rj.State(theta=0.1, u_t=u_b)
    split = FRAME.replace(superstructure=modes)
    course, nodes = course_along(rj.simulate(split, rj.Rest(), initial=initial, t_end=1.0, options=FINE))
    k = int(np.flatnonzero(np.isfinite(nodes.impact_time))[0])
    for mode in (0, 1):
        found = course.accelerations[k - 1, -1, mode], course.accelerations[k, 0, mode]
        np.testing.assert_allclose(found, [-1.4308869259, -1.3884663521], rtol=1e-9)
    e = float(split.restitution_factor)
    across = (1 - e) * 3 * math.cos(0.15) * 0.25532599748
    up = (1 + e) * 3 * math.sin(0.15) * 0.25532599748
    np.testing.assert_allclose(course.jumps[k], [0.0, 0.0, across, up], rtol=1e-9)


def test_a_top_in_free_vibration_has_its_bounds():
    """(L16) in full contact, where |z| decays like e^(−ζωt): ∫|2ζωu̇ + ω²u| dt ≤ |z|/(ζs), and the columns
    stay in contact for good if the largest force, ηω|z|/s, is below (½+γ+η) g tan α."""
    omega, end, alpha = 4 * math.pi, 1e-3, 0.005
    for zeta in (0.05, 0.3, 0.998, 0.0):
        s = math.sqrt(1 - zeta**2)
        podium = FRAME.replace(alpha=alpha, superstructure=rj.Elastic(30.0, 0.5, zeta))
        limit = 40.5 * G * math.tan(alpha) * s / (30 * omega) * math.exp(zeta * omega * end)  # of |z(0)|
        rate = limit / math.hypot(1 + 0.3 * zeta, 0.3 * s)  # with ωu = 0.3 u̇
        for factor in (0.999, 1.001, 0.0):
            initial = rj.State(u_t=0.3 * factor * rate / omega, u_t_dot=factor * rate)
            response = rj.simulate(podium, rj.Rest(), initial=initial, t_end=end, options=FINE)
            ended = ending(response.floor().scene, np.asarray(end))
            assert ended.rests == (factor < 1)
            z = factor * limit * math.exp(-zeta * omega * end)
            bound = z / (zeta * s) if zeta else math.inf if z else 0.0
            np.testing.assert_allclose(ended.modes, bound, rtol=1e-9)


def test_a_course_in_full_contact_is_the_ground_motion():
    """The acceleration of a cosine jumps at its start and end."""
    motion = rj.OneCosine(1.0, 0.8)
    start, end = (float(y) for y in motion.support)
    solve = lambda t: floor_course(FRAME, motion, rj.State(), t, FINE.replace(engine="flat"), 128, False)
    course, _ = jax.tree.map(np.asarray, jax.jit(solve)(end + 0.5))
    steps = course.times[np.isfinite(course.times)]
    t = steps[:-1, None] + np.diff(steps)[:, None] * (1 + NODES) / 2
    shape = np.abs(np.cos(2 * math.pi * (t - start) / 0.8))
    during = steps[:-1] < end
    found = np.abs(course.accelerations[: t.shape[0], :, 0])
    np.testing.assert_allclose(found[during], shape[during], rtol=1e-9, atol=1e-12)
    assert (found[~during] == 0).all()
    assert during.any()
    assert (~during).any()


def test_a_frame_without_restitution_has_one_jump():
    """Fact 16."""
    response = rj.simulate(
        FRAME.replace(restitution=0.0), rj.Rest(), initial=rj.State(theta=0.05), t_end=1.0, options=FINE
    )
    course, _ = course_along(response)
    jumps = course.jumps
    np.testing.assert_allclose(jumps.max(axis=0), [0.6036118453365736, 0.09122700786751294], rtol=1e-9)
    assert np.count_nonzero(jumps) == 2
    assert course.ending.restitution == 0
    assert course.ending.rests
    assert not course_along(response, has_fallen=True)[0].ending.rests


def test_a_motion_through_values_is_the_polynomial_through_them():
    rng = np.random.default_rng(4)
    times = np.array([0.5, 0.8, 2.0, np.inf, np.inf])
    coefficients = rng.normal(size=(5, DEGREE + 1))
    values = np.array([[np.polyval(row[::-1], z) for z in NODES] for row in coefficients])
    jumps = np.array([0.1, -0.2, 0.3, 0.0, 0.0])
    motion = PiecewiseMotion.through(jnp.asarray(times), jnp.asarray(values), jnp.asarray(jumps))
    np.testing.assert_allclose(motion.coefficients, coefficients, atol=1e-12)
    t = np.array([0.2, 0.5, 0.6, 0.8, 1.7, 1.999, 2.5])
    z = [None, -1.0, 2 * 0.1 / 0.3 - 1, -1.0, 2 * 0.9 / 1.2 - 1, 2 * 1.199 / 1.2 - 1, None]
    row = [0, 0, 0, 1, 1, 1, 0]
    exact = [0.0 if y is None else np.polyval(coefficients[k][::-1], y) for k, y in zip(row, z, strict=True)]
    np.testing.assert_allclose(motion(t), exact, rtol=1e-11, atol=1e-12)
    assert [int(motion.locate(jnp.asarray(y))) for y in t] == [0, 1, 1, 2, 2, 2, 3]
    assert [float(motion.breakpoint(jnp.asarray(k))) for k in (0, 2, 5)] == [0.5, 2.0, math.inf]
    assert [float(motion.velocity_jump(jnp.asarray(k))) for k in (0, 1, 2, 5)] == [0.1, -0.2, 0.3, 0.0]
    assert tuple(map(float, motion.support)) == (0.5, 2.0)
    lowest, time = motion.lowest()
    fine = np.linspace(0.5, 2.0, 20001)[:-1]
    np.testing.assert_allclose(lowest, motion(fine).min(), atol=0.05)
    np.testing.assert_allclose(motion(float(time)), lowest, atol=1e-9)


def course_with_jumps(across, up, rests=True, end=6.0, a=(0.0, 0.0)):
    """A course of one mode with the weight 0.4, the beam and the vertical motion, whose floor jumps at 0.5 s
    and 0.55 s."""
    jumps = np.zeros((5, 3))
    jumps[1:3, 1], jumps[1:3, 2] = np.asarray(across) / 0.6, up
    times = np.array([0.0, 0.5, 0.55, end, np.inf])
    accelerations = np.broadcast_to([a[0], a[0], a[1]], (5, DEGREE + 1, 3))
    ending = Ending(np.asarray(rests), np.array([0.2]), np.asarray(0.3), np.asarray(0.4), np.asarray(0.95))
    times, accelerations, jumps, end = map(jnp.asarray, (times, accelerations, jumps, end))
    return FloorCourse(times, accelerations, jumps, end, jax.tree.map(jnp.asarray, ending))


HORIZONTAL, VERTICAL = [0.4, 0.6, 0.0], [0.0, 0.0, 1.0]
WITHOUT_MODE = [0.0, 0.6, 0.0]  # a floor whose motion contains no mode


@jax.jit
def rock(course, alpha, R, restitution, weights):
    block = rj.Contents(alpha, R, restitution=restitution)
    return _rock(block, jnp.asarray(G), weights, course, FINE, reversible=False)


def rocked(course, alpha, R, vertical=True, restitution=None):
    e = 1 - 1.5 * math.sin(alpha) ** 2 if restitution is None else restitution
    weights = jnp.asarray([HORIZONTAL, np.asarray(VERTICAL) * vertical])
    floats, integers = rock(course, alpha, R, jnp.asarray(e), weights)
    return {name: y.item() for name, y in (floats | integers).items()}


def test_blocks_under_jumps_of_the_floor_have_their_closed_forms():
    """Facts 14, 16 and 19: peaks and friction demands."""
    one = (0.3, 0.0), (0.0, 0.0)
    found = rocked(course_with_jumps(*one), 0.2, 0.5)
    np.testing.assert_allclose(found["peak_rotation"], 0.03658828377247352 / 0.2, rtol=1e-9)
    np.testing.assert_allclose(found["friction_demand"], 1.914665005873861, rtol=1e-9)
    assert found["uplift_time"] == 0.5
    assert found["started_by_impulse"]
    assert found["impacts"] > 0
    jump = (0.6036118453365736, 0.0), (0.09122700786751294, 0.0)
    for vertical, peak, friction in (
        (True, 0.1221296327300025, 0.9844854941904820),
        (False, 0.1393632265028351, 1.490024380734774),
    ):
        found = rocked(course_with_jumps(*jump), 0.3, 0.4, vertical)
        np.testing.assert_allclose(found["peak_rotation"], peak / 0.3, rtol=1e-9)
        np.testing.assert_allclose(found["friction_demand"], friction, rtol=1e-9)
    stops = rocked(course_with_jumps(*one), 0.2, 0.5, restitution=0.0)  # at its first impact
    np.testing.assert_allclose(stops["friction_demand"], 1 / math.tan(0.2), rtol=1e-12)
    assert stops["impacts"] == 1


def test_friction_demands_of_blocks_at_rest():
    """At rest |a|/(g + a_w); at a jump on which a block rests on |Δv|/Δw; jumps far below the rest velocity
    do not count."""
    none = (0.0, 0.0), (0.0, 0.0)
    found = rocked(course_with_jumps(*none, a=(-0.5, 0.3)), 0.2, 0.5)
    np.testing.assert_allclose(found["friction_demand"], 0.5 / (G + 0.3), rtol=1e-12)
    assert not found["uplifted"]
    assert not found["started_by_impulse"]
    found = rocked(course_with_jumps((0.03, 0.0), (0.2, 0.0)), 0.2, 0.5)
    np.testing.assert_allclose(found["friction_demand"], 0.15, rtol=1e-12)
    assert not found["uplifted"]
    found = rocked(course_with_jumps((-1e-13, 0.0), (0.0, 0.0)), 0.2, 0.5)
    assert found["friction_demand"] == 0
    assert not found["uplifted"]


def test_friction_demand_of_a_jump_under_a_rocking_block():
    """The impulse on the foot, from (L13) and an independent integration up to the second jump."""
    alpha, R, (across, up) = 0.2, 0.5, ((-0.5, -0.2), (0.0, 0.002))
    P2 = 3 * G / (4 * R)
    rate = P2 / G * math.cos(alpha) * 0.5  # (L14), σ_c = 1
    rocks = lambda t, y: [y[1], -P2 * math.sin(alpha - y[0])]
    phi = solve_ivp(rocks, (0, 0.05), [0.0, rate], rtol=1e-12, atol=1e-14).y[0, -1]
    psi = alpha - phi
    change = -P2 / G * (math.cos(psi) * across[1] + math.sin(psi) * up[1])
    friction = abs(across[1] + R * change * math.cos(psi)) / (up[1] + R * change * math.sin(psi))
    assert friction > 1.914665005873861  # the demand of the first jump
    found = rocked(course_with_jumps(across, up), alpha, R)
    np.testing.assert_allclose(found["friction_demand"], friction, rtol=1e-9)


@jax.jit
def vibrate(course, weights):
    return [
        _vibrate(rj.Oscillator(0.5, 0.05, direction=way), jnp.asarray(G), weights, course, FINE, False)[0]
        for way in ("horizontal", "vertical")
    ]


OMEGA, ZETA = 4 * math.pi, 0.05
S = math.sqrt(1 - ZETA**2)
X, X_A, R_TURN = 0.9266920209946192, 0.9313448608105514, 0.8544678930067565  # fact 5


@pytest.mark.parametrize("end", [0.57, 6.0])
def test_oscillators_after_a_jump_of_the_floor_have_their_closed_forms(end):
    """(L9), and (L16), (L17) after the end: a turning point on a floor at rest, else a bound."""
    course = course_with_jumps((0.0, 0.3), (0.0, 0.7), True, end)
    tau = end - 0.55
    turns = math.ceil((tau * OMEGA * S - math.acos(ZETA)) / math.pi)  # turning points up to the end
    for found, jump in zip(vibrate(course, jnp.asarray([WITHOUT_MODE, VERTICAL])), (0.3, 0.7), strict=True):
        np.testing.assert_allclose(found["relative_displacement"], X * jump / OMEGA, rtol=1e-9)
        np.testing.assert_allclose(found["pseudo_acceleration"], X * jump * OMEGA, rtol=1e-9)
        np.testing.assert_allclose(found["absolute_acceleration"], X_A * jump * OMEGA, rtol=1e-9)
        np.testing.assert_allclose(found["remaining_ratio"], R_TURN ** max(turns, 0), rtol=1e-8)
    # A mode that still vibrates, ∫|ü_i + ü_g| dt ≤ 0.2 m/s, and columns that still rock.
    decay, phase = math.exp(-ZETA * OMEGA * tau) / S, OMEGA * S * tau
    x = 0.3 * decay * math.sin(phase) / OMEGA
    rate = 0.3 * decay * (S * math.cos(phase) - ZETA * math.sin(phase))
    largest = X * 0.3 / OMEGA if end == 6.0 else abs(x)
    damped = 2 * X * 0.7 / (1 - R_TURN)
    for rests, remaining in ((True, 0.4 * 0.2), (False, damped)):
        course = course_with_jumps((0.0, 0.3), (0.0, 0.7), rests, end)
        found, upwards = vibrate(course, jnp.asarray([HORIZONTAL, VERTICAL]))
        np.testing.assert_allclose(found["relative_displacement"], largest, rtol=1e-8)
        later = (math.hypot(rate, OMEGA * x) + remaining) / OMEGA
        np.testing.assert_allclose(found["remaining_ratio"], later / largest, rtol=1e-8)
        assert np.isinf(upwards["remaining_ratio"]) == (not rests)
