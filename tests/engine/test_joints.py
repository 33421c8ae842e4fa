"""Forces in the joints: exact statements, free bodies, an independent integrator, derivatives, bounds.

Facts are independent statements with numbers. `tests.reference_joints` cuts columns, beam and floors free and
solves for all joint forces at once, along its own solution of the motion.
"""

import dataclasses
import functools
import itertools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._engine.bounds import Bounds
from rockjax._engine.coefficients import coefficients, not_none
from rockjax._engine.model import acceleration, restraint_bound
from rockjax._engine.scene import plan_for, prepare
from rockjax._excitations.base import Shaking
from rockjax._outputs import joint_forces as joints
from rockjax._outputs.joint_bounds import JointBounds, Rotation
from rockjax._outputs.joints import end_offsets
from tests import restrained
from tests.reference_joints import peaks, structure_of

G = 9.80665
OUTPUTS = "peak_friction", "axial_force", "peak_foundation_shear", "impact_friction"
JOINT_PEAKS = (
    "peak_friction", "least_axial_force", "peak_axial_force", "peak_foundation_shear", "peak_impact_friction",
    "least_impulse_share",
)  # fmt: skip
TIGHT = rj.Options(rtol=1e-10, atol=1e-12, outputs=OUTPUTS)
DEFAULT = rj.Options(outputs=OUTPUTS)
K = rj.Podium(alpha=0.25, R=1.2)
LEVELS = rj.Elevation([-3.0, 3.0], beam_depth=0.6, top_height=8.4)  # h = 9 m above the columns
S = rj.Podium(0.15, 1.5, 10.0, elevation=rj.Elevation([-3.0, 3.0], 0.6))
S_R = rj.Podium(0.15, 1.5, 10.0, rj.Rigid(50.0), elevation=LEVELS)
S_E = rj.Podium(0.15, 1.5, 10.0, rj.Elastic(50.0, 0.5, 0.05), elevation=LEVELS)
DEVICES = rj.Tendon(5.0, 100.0), rj.Damper(4.0), rj.Inerter(8.0)
SAME_OVER_ONE = (
    rj.Tendon(10.0, 400.0, joints=1),
    rj.Damper(16.0, joints=1),
    rj.Inerter(32.0, joints=1),
)


# -------------------------------------------------------------------------------- forces of given states
class Found(NamedTuple):
    """Forces divided by m_c g, one row for each state; T and N have the axes (joints, columns), and (joints)
    for the mean column."""

    theta_ddot: Any
    devices: Any  # forces at the bottom and the top joint
    mean_T: Any
    mean_N: Any
    T: Any
    N: Any
    V: Any  # divided by the total weight
    W: Any
    eccentricity: Any
    moment: Any  # divided by N m_c g [m]


class States(NamedTuple):
    """States of a motion: θ, θ̇, u, u̇, ü_g, v̈_g; arrays along a first axis, u and u̇ over the modes."""

    theta: Any
    theta_dot: Any
    u: Any
    u_dot: Any
    ground: Any
    vertical: Any


@functools.partial(jax.jit, static_argnames=("moves_up",))
def _forces(podium: rj.Podium, sigma, states: States, moves_up: bool) -> Found:
    c = coefficients(podium, 1e-14, moves_up, joints=True)
    constants = not_none(c.joints)
    arms = constants.arms
    weight = (1 + constants.gamma + c.eta) * c.g
    several = c.vibration is not None and jnp.ndim(c.vibration.omega2)

    def at(state: States) -> Found:
        ground = Shaking(state.ground, state.vertical) if moves_up else state.ground
        x, v = (state.theta,), (state.theta_dot,)
        if c.vibration is not None:
            x += (state.u if several else state.u[0],)
            v += (state.u_dot if several else state.u_dot[0],)
        a = acceleration(c, sigma, ground, x, v)
        complete = c, sigma, ground, x, v, a
        mean = joints.mean_forces(*complete)
        T, N = joints.of_all_columns(joints.column_forces, c, mean, arms=arms)
        of_devices = joints.device_forces(c, sigma, x, v, a)
        moment = jnp.nan if arms is None else mean.moment
        in_g = lambda *values: jnp.stack([jnp.asarray(y, float) for y in values]) / c.g
        V, W = mean.foundation
        return Found(
            a[0], in_g(*of_devices), in_g(mean.bottom[0], mean.top[0]), in_g(mean.bottom[1], mean.top[1]),
            T / c.g, N / c.g, V / weight, W / weight, mean.eccentricity, in_g(moment)[0],
        )  # fmt: skip

    return jax.vmap(at)(states)


def found_at(podium: rj.Podium, sigma: int, states: States) -> Found:
    """Return the forces in states with one contact mode σ."""
    states = States(*(jnp.asarray(np.asarray(y, float)) for y in states))
    moves_up = bool(np.any(np.asarray(states.vertical)))
    return Found(*map(np.asarray, _forces(podium.split_rows(), jnp.asarray(float(sigma)), states, moves_up)))


def at(podium, sigma, theta=0.0, theta_dot=0.0, ground=0.0, vertical=0.0, u=(), u_dot=()) -> Found:
    """Return the forces in one state."""
    numbers = theta, theta_dot, u, u_dot, ground, vertical
    return Found(*(y[0] for y in found_at(podium, sigma, States(*(np.array([y]) for y in numbers)))))


def of_free_bodies(podium: rj.Podium, sigma: int, states: States):
    """Return the same forces from the independent implementation."""
    columns = [np.asarray(y, float).reshape(len(np.asarray(states.theta)), -1) for y in states[:4]]
    y = np.concatenate([*columns, np.zeros((len(columns[0]), 1))], axis=1)
    return structure_of(podium).forces(sigma, y, np.asarray(states.ground), np.asarray(states.vertical))


def near(found, expected, digits=1e-13, size=None):
    """Check agreement relative to the largest value."""
    found, expected = np.asarray(found), np.asarray(expected)
    size = np.max(np.abs(expected)) if size is None else size
    assert found.shape == expected.shape
    assert np.max(np.abs(found - expected)) <= digits * size


# -------------------------------------------------------------------------------------------------- facts
def test_block_of_zhang_and_makris():
    """Fact 1: Eq. (20) of Zhang and Makris for λ = ⅓."""
    found = at(K, 1, 0.1, -0.4, 3.0)
    near(found.mean_T, [-0.02629186743966190, 0.0], 5e-15)
    near(found.mean_N, [0.9299909692350224, 0.0], 5e-15)
    psi, p2, ground = 0.25 - 0.1, 0.75 * G / 1.2, 3.0 / G
    s, c, s2, c2 = math.sin(psi), math.cos(psi), math.sin(2 * psi), math.cos(2 * psi)
    above = (5 - 3 * c2) * ground - 3 * s2 + 6 * s * 0.16 / p2
    below = 5 - 3 * s2 * ground + 3 * c2 - 6 * c * 0.16 / p2
    assert found.mean_T[0] / found.mean_N[0] == pytest.approx(above / below, rel=1e-13)


def test_block_that_a_jump_lifts():
    """Fact 2: Eqs. (7) and (51) of Zhang and Makris."""
    for ground, expected, size in (
        (2.5 * G * math.tan(0.25), 0.3449263734170140, 1.0),
        (6 * 0.25 * G, 1.995790619921605, math.tan(0.25)),
    ):
        found = at(K, -1, ground=ground)
        assert abs(found.mean_T[0] / found.mean_N[0]) / size == pytest.approx(expected, rel=1e-14)


@pytest.mark.slow
def test_block_under_one_sine():
    """Fact 3; their figure shows 2.5 tan α."""
    block = rj.Podium(0.25, 0.75 * 9.81 / 2.14**2, restitution=0.9, g=9.81)
    found = rj.peak_response(block, rj.OneSine(2.22 * 9.81, 2 * math.pi / 15.7), options=TIGHT)
    assert float(found.peak_friction[0]) == pytest.approx(0.6212181948105, abs=1e-9)


def test_slow_uplift_without_devices():
    """Facts 4 to 6, and "Full contact counts": T/N = −ξ tan α at every joint."""
    tan = math.tan(0.15)
    uplift = at(S_R, 1, ground=-G * tan)
    assert abs(uplift.theta_ddot) < 1e-14
    near(np.abs(uplift.T / uplift.N), np.full((2, 2), 0.1511352180582951), 1e-14)
    assert uplift.moment == pytest.approx(68.46425378040767, rel=1e-14)
    near(uplift.N[1], [32.69543809898947, 87.30456190101053], 1e-14)
    lever = (10 * 0.3 + 50 * 9) / 60
    share = 1 - (lever * tan + 1.5 * math.sin(0.15)) / float(S_R.core_distance)
    assert share == pytest.approx(0.5449239683164911, rel=1e-14)
    assert uplift.N[1, 0] / 60 == pytest.approx(share, rel=1e-13)
    # The height of the carried mass at which the beam lifts off.
    height = 18.36661789986579
    top = (60 * height - 10 * 0.3) / 50 - 0.6
    assert (
        abs(at(S_R.replace(elevation=rj.Elevation([-3.0, 3.0], 0.6, top)), 1, ground=-G * tan).N[1, 0])
        < 2e-12
    )
    near(uplift.N[1].mean(), np.asarray(S_R.dead_load)[1], 1e-14)
    contact = at(S_R, 0, ground=0.7)
    near(contact.T / contact.N, np.full((2, 2), -contact.eccentricity * tan), 1e-14)
    near(contact.T / contact.N, np.full((2, 2), 0.7 / G), 1e-14)
    assert contact.eccentricity == pytest.approx(-0.7 / (G * tan), rel=1e-14)


def test_slow_uplift_with_prestress():
    """Fact 7: slow uplift with prestress."""
    found = at(S_R.replace(restrainers=(rj.Tendon(5.0),)), 1, ground=-G * math.tan(0.15) * (1 + 5 / 60.5))
    # At the top 60 (1 + 5/60.5) tan α/65; the fact has only 12 digits.
    near(np.abs(found.mean_T / found.mean_N), [0.1512298431635156, 0.15103913718222495], 1e-14)
    near(found.N[1], [35.43577517054906, 94.56422482945094], 1e-14)


STATE_8: dict[str, Any] = {
    "theta": 0.05, "theta_dot": -0.2, "ground": 1.0, "vertical": -2.0, "u": [0.14], "u_dot": [-0.4],
}  # fmt: skip


def test_all_parts_at_once():
    """Fact 8: all parts of a podium together."""
    found = at(S_E.replace(restrainers=DEVICES), 1, **STATE_8)
    assert found.theta_ddot == pytest.approx(-3.732558097634604, rel=1e-13)
    near(found.devices, np.full(2, 5.021443454137038))
    near([found.mean_T[0], found.mean_N[0]], [-4.835061376702524, 45.94606663582224])
    near([found.mean_T[1], found.mean_N[1]], [-4.369573541770700, 45.21309475362966])
    assert found.moment == pytest.approx(-49.70576950806513, rel=1e-13)
    near([found.V, found.W], [-0.08132105552112998, 0.6709211852629033])
    near(found.N[1], [58.40340436798422, 32.02278513927510])
    near(found.T[1], [-5.693018931632531, -3.046128151908870])


def test_devices_in_the_bottom_joint():
    """Fact 9: the motion is the same, with twice the force in the bottom joint and none in the top joint."""
    both, one = (at(S_E.replace(restrainers=y), 1, **STATE_8) for y in (DEVICES, SAME_OVER_ONE))
    for name in ("theta_ddot", "V", "W", "moment"):
        assert getattr(one, name) == pytest.approx(getattr(both, name), rel=1e-13)
    near(one.mean_N, [50.96594097060738, 40.19322041884452])
    near(one.devices, [2 * both.devices[0], 0.0])


def test_full_contact():
    """Fact 10: forces in full contact."""
    found = at(S_E, 0, ground=0.8, u=[0.01], u_dot=[0.05])
    assert found.eccentricity == pytest.approx(0.8218952989423373, rel=1e-14)
    assert found.moment == pytest.approx(75.60065626495714, rel=1e-14)
    assert found.N[1, 0] == pytest.approx(31.11510628813108, rel=1e-13)
    assert found.T[1, 0] == pytest.approx(-3.967932588389778, rel=1e-13)


def test_columns_without_mass():
    """Fact 11: columns without mass are two-force members."""
    heavy = S.replace(gamma=1e9)
    found = at(heavy, 1, 0.05, -0.3, 1.0)
    near(found.T / found.N, np.full((2, 2), -0.1003346720854505), 2e-9)


def test_impulses():
    """Facts 12 to 15: impulses of impacts."""
    exact = 3 * math.sin(0.25) * math.cos(0.25) / (4 - 3 * math.sin(0.25) ** 2)
    near(K.impact_friction, [0.1884349745390735, 0.0], 1e-14)
    assert float(K.impact_friction[0]) == pytest.approx(exact, rel=1e-14)
    assert float(K.impact_eccentricity) == pytest.approx(1.0, rel=1e-14)
    given = K.replace(restitution=0.85)
    assert float(given.impact_friction[0]) == pytest.approx(0.3175392457821033, rel=1e-14)
    assert float(given.impact_eccentricity) == pytest.approx(1.685139643311062, rel=1e-14)
    near(S_R.impact_friction, np.full(2, 0.1509217062493743), 1e-14)
    assert float(S_R.impact_eccentricity) == pytest.approx(1.0, rel=1e-13)
    lever = (10 * 0.3 + 50 * 9) / 60
    e = float(S_R.restitution_factor)
    top = 1 - (lever * (1 - e) / ((1 + e) * math.tan(0.15)) + 1.5 * math.sin(0.15)) / float(S_R.core_distance)
    assert top == pytest.approx(0.5454613063689417, rel=1e-13)
    _, axial = impulses_at(S_R, 1, -0.3)
    shares = axial / axial.mean(axis=1, keepdims=True)
    near(shares.min(axis=1), [0.5492178244981240, 0.5454613063689417], 1e-13)
    assert float(S_E.impact_eccentricity) == pytest.approx(0.1712968634201230, rel=1e-13)
    near(S_E.impact_friction, [0.02619302339865174, 0.02515361770822905], 1e-13)
    compatible = S_E.replace(restitution="compatible")
    assert float(compatible.restitution_factor) == pytest.approx(0.7649785963187355, rel=1e-14)
    assert float(compatible.impact_eccentricity) == pytest.approx(1.0, rel=1e-14)
    near(compatible.impact_friction, [0.1529101168327331, 0.1468422550536564], 1e-14)
    inert = compatible.replace(restrainers=(rj.Inerter(8.0),))
    near(inert.impact_friction, [0.1529842168984364, 0.1467705722344943], 1e-14)
    assert float(inert.impact_eccentricity) == pytest.approx(1.0, rel=1e-14)
    # A factor below (C13) requires tension at the old edges.
    assert float(compatible.replace(restitution=0.7).impact_eccentricity) > 1
    # After an impact that ends rocking, the ratios are those of e = 0.
    stocky = S_R.replace(alpha=1.2, elevation=None)
    assert float(stocky.restitution_factor) < 0
    near(stocky.impact_friction, stocky.replace(restitution=0.0).impact_friction, 1e-15)


def test_lever_arms_of_buildings():
    """Fact 16: lever arms of the modes of buildings."""
    building = rj.ShearBuilding([3.0, 3.0, 2.0], [900.0, 700.0, 500.0], heights=[3.0] * 3)
    frame = rj.Podium(0.15, 1.5, 10.0, building, elevation=rj.Elevation([-3.0, 3.0]))
    arms: Any = frame.resolved().elevation
    near(
        arms.modes / building.modes.eta,
        [6.494341338131906, -1.071018307919391, 0.8266769697874856],
        1e-13,
    )
    assert float(arms.modes.sum()) == pytest.approx(45.0, rel=1e-14)
    one = rj.ShearBuilding([3.0, 3.0, 2.0], [900.0, 700.0, 500.0], modes=1, heights=[3.0] * 3)
    arms = frame.replace(superstructure=one).resolved().elevation
    assert float(arms.beam / one.modes.residual) == pytest.approx(-0.5870338458125549, rel=1e-12)
    # The elevation may give the heights of the floors instead.
    bare = rj.ShearBuilding([3.0, 3.0, 2.0], [900.0, 700.0, 500.0], modes=1)
    given = frame.replace(superstructure=bare, elevation=rj.Elevation([-3.0, 3.0], 0.0, [3.0, 6.0, 9.0]))
    of_given: Any = given.resolved().elevation
    near(of_given.modes, arms.modes, 1e-15)
    near(of_given.beam, arms.beam, 1e-15)


def test_release_from_rest():
    """Fact 17: forces at release from rest."""
    found = at(S, 1, 0.12)
    near([found.mean_T[0], found.mean_N[0]], [-0.3198886313399403, 10.99040046102530], 1e-14)
    assert found.N[1, 0] == pytest.approx(9.213884448565149, rel=1e-14)


def test_dead_load_and_core():
    near(S_R.dead_load, [61.0, 60.0], 1e-15)
    near(S_R.replace(restrainers=(rj.Tendon(5.0), rj.Damper(4.0))).dead_load, [66.0, 65.0], 1e-15)
    # A stiffness of 10 across the bottom joint is equivalent to 5 across both joints.
    near(S_R.replace(restrainers=(rj.Tendon(10.0, joints=1),)).dead_load, [71.0, 60.0], 1e-15)
    near(K.dead_load, [1.0, 0.0], 1e-15)
    for count in (2, 3, 5, 16):
        even = rj.Elevation(6.0 * np.arange(count))
        assert float(even.core_distance) == pytest.approx(6.0 * (count + 1) / 6, rel=1e-14)
    lines = S_R.replace(elevation=rj.Elevation(np.repeat([0.0, 6.0, 12.0, 18.0], 4), 0.6, 8.4))
    assert float(lines.core_distance) == pytest.approx(6.0 * 5 / 6, rel=1e-14)


# --------------------------------------------------------------------- identities at states of any kind
BUILDING = rj.ShearBuilding((3.0, 3.0, 2.0), (900.0, 700.0, 500.0), 0.04, heights=(4.0, 3.0, 3.0))
TRUNCATED = rj.ShearBuilding((3.0, 3.0, 2.0), (900.0, 700.0, 500.0), 0.04, 2, heights=(4.0, 3.0, 3.0))
TWO_MODES = rj.Modes((24.0, 6.0), (0.5, 0.15), (0.05, 0.03), 1.5)
MIXED = (
    rj.Tendon(4.0, 60.0),
    rj.Tendon(3.0, 90.0, joints=1),
    rj.Damper(2.0),
    rj.Damper(5.0, joints=1),
    rj.Inerter(6.0),
    rj.Inerter(9.0, joints=1),
)
ROOT_DAMPERS = rj.Damper(2.0, 0.5), rj.Damper(3.0, 0.5, joints=1)
FRAME = S.replace(elevation=None)
KINDS = {
    "block": K,
    "frame": FRAME,
    "anchor plate": rj.Podium(0.2, 1.3, restrainers=DEVICES, elevation=rj.Elevation([0.0, 5.0], 0.3)),
    "rigid": S_R.replace(restrainers=MIXED),
    "elastic": S_E.replace(restrainers=SAME_OVER_ONE, elevation=rj.Elevation([0.0, 3.0, 7.0], 0.6, 8.4)),
    "modes": FRAME.replace(
        superstructure=TWO_MODES,
        restrainers=(*MIXED, *ROOT_DAMPERS),
        elevation=rj.Elevation([-4.0, -1.0, 2.0, 6.0], 0.5, [8.0, -2.0], 5.0),
    ),
    "building": FRAME.replace(superstructure=BUILDING, elevation=rj.Elevation([2.0, -5.0, 2.0, -2.0], 0.5)),
    "truncated": FRAME.replace(
        superstructure=TRUNCATED, restrainers=ROOT_DAMPERS, elevation=rj.Elevation([-2.0, 2.0, 5.0], 0.5)
    ),
}  # fmt: skip
COUNT = 30


def modes_of(podium: rj.Podium) -> int:
    return len(structure_of(podium).frame.modes)


def random_states(podium: rj.Podium, sigma: int, seed: int, vertical: bool = True) -> States:
    rng, n = np.random.default_rng(seed), modes_of(podium)
    theta = sigma * float(podium.alpha) * rng.uniform(0.0, 1.5, COUNT)
    return States(
        theta, 0.5 * rng.normal(size=COUNT) * abs(sigma), 0.1 * rng.normal(size=(COUNT, n)),
        0.5 * rng.normal(size=(COUNT, n)), 3 * rng.normal(size=COUNT),
        2 * rng.normal(size=COUNT) * vertical + 0.1 * vertical,
    )  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_free_bodies(kind):
    """Forces of all columns agree with free bodies, while rocking to both sides and in full contact."""
    podium = KINDS[kind]
    structure = structure_of(podium)
    for sigma in (1, -1, 0):
        states = random_states(podium, sigma, 3 + sigma)
        found, expected = found_at(podium, sigma, states), of_free_bodies(podium, sigma, states)
        size = np.max(np.abs(expected.N)) / G
        near(found.theta_ddot, expected.theta_ddot, 1e-11, max(1.0, np.max(np.abs(expected.theta_ddot))))
        near(found.N, expected.N / G, 1e-11, size)
        near(found.T, expected.T / G, 1e-11, size)
        near(found.V, expected.V / structure.weight, 1e-11, 1.0)
        near(found.W, expected.W / structure.weight, 1e-11, 1.0)
        near(
            found.eccentricity, expected.eccentricity, 1e-11, max(1.0, np.max(np.abs(expected.eccentricity)))
        )


@pytest.mark.parametrize("kind", KINDS)
def test_balance_of_columns(kind):
    """Fact 20: (F4) is equivalent to (C8), ground reactions equal foundation forces, and joint forces have no
    power."""
    podium = KINDS[kind]
    alpha, R, lam = (float(getattr(podium, name)) for name in ("alpha", "R", "lam"))
    H = R * math.cos(alpha)
    for sigma in (1, -1):
        states = random_states(podium, sigma, 10 + sigma)
        found = found_at(podium, sigma, states)
        psi, half = sigma * alpha - states.theta, 0.5 * states.theta
        f_b, f_t = found.devices.T
        terms = [
            R * np.sin(psi) * found.mean_N.sum(axis=1),
            R * np.cos(psi) * found.mean_T.sum(axis=1),
            H * (f_b + f_t) * np.sin(half),
            lam * R**2 * found.theta_ddot / G,
        ]
        size = np.max(np.abs(terms), axis=0)
        assert np.max(np.abs(sum(terms)) / size) <= 1e-13
        if found.T.shape[2] > 1:
            count = found.T.shape[2]
            size = np.max(np.abs(found.T), axis=(1, 2))
            assert np.max(np.abs(found.T.sum(axis=2) - count * found.mean_T) / size[:, None]) <= 1e-13 * count
            size = np.max(np.abs(found.N), axis=(1, 2))
            assert np.max(np.abs(found.N.sum(axis=2) - count * found.mean_N) / size[:, None]) <= 1e-13 * count
        # The power on one column, including devices, is the rate of its energy; forces at the ground have no
        # power.
        weight = 1 + states.vertical / G
        for T, N in zip(np.moveaxis(found.T, 2, 0), np.moveaxis(found.N, 2, 0), strict=True):
            w = states.theta_dot
            u_b, v_b = 2 * R * np.cos(psi) * w, 2 * R * np.sin(psi) * w
            u_b2 = 2 * R * (np.cos(psi) * found.theta_ddot + np.sin(psi) * w**2)
            v_b2 = 2 * R * (np.sin(psi) * found.theta_ddot - np.cos(psi) * w**2)
            opening = sigma * R * math.sin(alpha) * np.cos(half) * w  # rate of opening of one joint
            work = [
                -T[:, 1] * u_b, -N[:, 1] * v_b,
                f_t * (u_b * np.sin(half) + v_b * np.cos(half)), -(f_b + f_t) * opening,
            ]  # fmt: skip
            gain = [
                0.5 * u_b * (states.ground + 0.5 * u_b2) / G, 0.5 * v_b * (weight + 0.5 * v_b2 / G),
                lam * R**2 * found.theta_ddot * w / G,
            ]  # fmt: skip
            size = np.max(np.abs(work + gain), axis=0)
            assert np.max(np.abs(sum(work) - sum(gain)) / size) <= 1e-12


def impulses_at(podium: rj.Podium, sigma: int, theta_dot: float, u=()) -> tuple[np.ndarray, np.ndarray]:
    """Return (J_T, J_N) of all columns divided by m_c."""
    c = coefficients(podium.split_rows(), joints=True)
    arms = not_none(c.joints).arms
    several = c.vibration is not None and jnp.ndim(c.vibration.omega2)
    x: tuple = (jnp.asarray(0.0),)
    if c.vibration is not None:
        x += (jnp.asarray(u) if several else jnp.asarray(u)[0],) if len(u) else (jnp.zeros(()),)
    mode = jnp.asarray(float(sigma))
    state = c, mode, jnp.abs(jnp.asarray(theta_dot)), joints.sway_of_modes(c, mode, x)
    found = joints.of_all_columns(joints.impulses_of_columns, *state, arms=arms)
    return np.asarray(found[0]), np.asarray(found[1])


@pytest.mark.parametrize("kind", KINDS)
def test_impulses_of_free_bodies(kind):
    """(F12) to (F15), for the podium's own restitution factor and for given ones."""
    rng = np.random.default_rng(5)
    for e in (None, 0.6, 0.0):
        podium = KINDS[kind] if e is None else KINDS[kind].replace(restitution=e)
        structure, n = structure_of(podium), modes_of(podium)
        alpha, R, lam = (float(getattr(podium, name)) for name in ("alpha", "R", "lam"))
        factor = max(float(podium.restitution_factor), 0.0)
        for sigma in (1, -1):
            rate, u = -sigma * rng.uniform(0.1, 0.5), 0.1 * rng.normal(size=n)
            T, N = impulses_at(podium, sigma, rate, u)
            y = np.concatenate([[0.0, rate], u, np.zeros(n), [0.0]])
            expected_T, expected_N, xi = structure.impulses(sigma, y)
            size = np.max(np.abs(expected_N))
            near(T, expected_T, 1e-11, size)
            near(N, expected_N, 1e-11, size)
            assert float(podium.impact_eccentricity) == pytest.approx(xi, rel=1e-11)
            means = np.mean(T, axis=1), np.mean(N, axis=1)
            near(np.abs(means[0]), np.asarray(podium.impact_friction) * means[1], 1e-13, size)
            # (F15): the work of the impulses is the energy that the impact dissipates.
            gamma, eta = map(float, podium.mass_ratios)
            mu = sum(map(float, podium.inertances)) / 2
            taken = -0.5 * (1 + lam + 4 * gamma + 4 * (eta + mu) * math.sin(alpha) ** 2) * R**2
            taken *= (1 - factor**2) * rate**2
            work = -R * math.sin(alpha) * abs(rate) * means[1].sum()
            work *= ((1 - factor) + float(podium.impact_eccentricity) * (1 + factor)) / 2
            scale = 0.5 * (1 + lam + 4 * gamma + 4 * (eta + mu) * math.sin(alpha) ** 2) * R**2 * rate**2
            assert abs(work - taken) <= 1e-13 * scale


@pytest.mark.parametrize("kind", ["frame", "rigid", "elastic", "modes", "truncated"])
def test_continuous_at_uplift(kind):
    """At the uplift threshold, the forces of full contact equal those of rocking in every joint."""
    podium = KINDS[kind]
    states = random_states(podium, 0, 8)
    gamma, eta = map(float, podium.mass_ratios)
    structure = structure_of(podium)
    prestress = structure.frame.tau
    q_up = math.tan(structure.frame.alpha) * (
        (G + states.vertical) * (1 + 2 * gamma + 2 * eta) + 2 * G * prestress
    )
    q_up = q_up / (1 + 2 * gamma)
    _, springs = structure._modes(0, np.concatenate(
        [np.zeros((COUNT, 2)), states.u, states.u_dot, np.zeros((COUNT, 1))], axis=1
    ))  # fmt: skip
    etas = np.array([k[0] for k in structure.frame.modes])
    of_modes = springs @ etas * 2 / (1 + 2 * gamma) if len(etas) else 0.0
    for sigma in (1, -1):
        at_uplift = states._replace(ground=of_modes - sigma * q_up)
        held, lifted = (found_at(podium, mode, at_uplift) for mode in (0, sigma))
        assert np.max(np.abs(lifted.theta_ddot)) < 1e-12
        near(held.eccentricity, np.full(COUNT, float(sigma)), 1e-12)
        for name in ("T", "N", "V", "W"):
            near(getattr(held, name), getattr(lifted, name), 1e-12)


def test_columns_at_equal_distances():
    """Fact 18: the middle column of three is the mean column; at twice the distance the differences are half
    as large."""
    podium = KINDS["truncated"].replace(elevation=rj.Elevation([-4.0, 0.0, 4.0], 0.5))
    wide = podium.replace(elevation=rj.Elevation([-8.0, 0.0, 8.0], 0.5))
    for sigma in (1, -1, 0):
        states = random_states(podium, sigma, 20)
        found, far = found_at(podium, sigma, states), found_at(wide, sigma, states)
        near(found.T[..., 1], found.mean_T, 1e-14)
        near(found.N[..., 1], found.mean_N, 1e-14)
        near(2 * (far.N - far.N[..., 1:2]), found.N - found.N[..., 1:2], 1e-13, np.max(np.abs(found.N)))
        # Order and origin of the positions have no effect; equal positions are columns of one line.
        moved = found_at(podium.replace(elevation=rj.Elevation([14.0, 6.0, 10.0], 0.5)), sigma, states)
        near(moved.N, found.N[..., [2, 0, 1]], 1e-13)


def mirrored(states: States) -> States:
    return States(-states.theta, -states.theta_dot, -states.u, -states.u_dot, -states.ground, states.vertical)


def test_mirror():
    for kind in ("rigid", "modes"):
        podium = KINDS[kind]
        elevation: Any = podium.elevation
        other = podium.replace(
            elevation=rj.Elevation(-np.asarray(elevation.columns), *elevation_heights(elevation))
        )
        for sigma in (1, 0):
            states = random_states(podium, sigma, 21)
            found, back = found_at(podium, sigma, states), found_at(other, -sigma, mirrored(states))
            near(back.T, -found.T, 1e-13)
            near(back.N, found.N, 1e-13)


def elevation_heights(elevation: rj.Elevation) -> tuple:
    return elevation.beam_depth, elevation.top_height, elevation.residual_height


def test_size():
    """Fact 19: if lengths are multiplied by s and times by √s, forces divided by weights stay the same."""
    podium, s = KINDS["modes"], 2.7
    elevation: Any = podium.elevation
    large = podium.replace(
        R=podium.R * s,
        superstructure=rj.Modes(TWO_MODES.eta, math.sqrt(s) * np.asarray(TWO_MODES.T), TWO_MODES.zeta, 1.5),
        elevation=rj.Elevation(
            s * np.asarray(elevation.columns), *(s * np.asarray(y) for y in elevation_heights(elevation))
        ),
    )
    for sigma in (1, 0):
        states = random_states(podium, sigma, 22)
        scaled = states._replace(
            theta_dot=states.theta_dot / math.sqrt(s), u=s * states.u, u_dot=math.sqrt(s) * states.u_dot
        )
        found, same = found_at(podium, sigma, states), found_at(large, sigma, scaled)
        near(same.T, found.T, 1e-13)
        near(same.N, found.N, 1e-13)


def test_vertical_acceleration_that_is_constant():
    """Fact 19: a constant v̈_g is equivalent to another g, with other dimensionless parameters."""
    a, podium = 2.3, S_E.replace(restrainers=DEVICES)
    ratio = G / (G + a)
    other = podium.replace(
        g=G + a,
        restrainers=(
            rj.Tendon(5.0 * ratio, 100.0 * ratio), rj.Damper(4.0 * math.sqrt(ratio)), rj.Inerter(8.0),
        ),
    )  # fmt: skip
    for sigma in (1, 0):
        states = random_states(podium, sigma, 23)._replace(vertical=np.full(COUNT, a))
        found, same = (
            found_at(podium, sigma, states),
            found_at(other, sigma, states._replace(vertical=0 * states.theta)),
        )
        near(same.T * (G + a), found.T * G, 1e-13)
        near(same.N * (G + a), found.N * G, 1e-13)


# ------------------------------------------------------------------------------------ peaks of scenes
@dataclasses.dataclass
class Scene:
    """A scene for both implementations; `vertical` is the vertical motion divided by the horizontal one."""

    podium: rj.Podium
    pulse: Any  # (name, a_p, T_p), or a record
    end: float
    vertical: float = 0.0
    theta: float = 0.0

    @property
    def horizontal(self):
        """Return ü_g as a function of time, and its breakpoints."""
        if isinstance(self.pulse, rj.Record):
            values = np.asarray(self.pulse.acceleration, float)
            times = float(self.pulse.dt) * np.arange(len(values))
            return (lambda t: float(np.interp(t, times, values, 0.0, 0.0))), tuple(times)
        name, a_p, T_p = self.pulse
        return getattr(restrained, name)(a_p, T_p), (T_p,) if name == "one_sine" else ()

    @property
    def motion(self) -> rj.AbstractExcitation:
        if isinstance(self.pulse, rj.Record):
            horizontal: rj.AbstractExcitation = self.pulse
        else:
            name, a_p, T_p = self.pulse
            horizontal = {"ricker": rj.Ricker, "one_sine": rj.OneSine}[name](a_p, T_p)
        return rj.GroundMotion(horizontal, horizontal.scaled(self.vertical)) if self.vertical else horizontal

    def found(self, options: rj.Options, change=lambda podium: podium) -> rj.Peak:
        podium, initial = change(self.podium), rj.State(self.theta)
        return rj.peak_response(podium, self.motion, initial=initial, t_end=self.end, options=options)

    def expected(self, change=lambda podium: podium, a_p: float | None = None):
        """Return the peaks from the independent implementation."""
        structure = structure_of(change(self.podium))
        horizontal, breaks = (
            self.horizontal
            if a_p is None
            else dataclasses.replace(self, pulse=(self.pulse[0], a_p, self.pulse[2])).horizontal
        )
        start = float(self.motion.support[0])
        state = (self.theta, *(0.0,) * 2 * len(structure.frame.modes)) if self.theta else ()
        return peaks(
            structure, self.end, horizontal, lambda t: self.vertical * horizontal(t),
            breaks=breaks, start=start, state=state,
        )  # fmt: skip


def rough(seed: int = 3, peak: float = 2.6, n: int = 200) -> rj.Record:
    """Return noise of a few samples."""
    noise = np.convolve(np.random.default_rng(seed).normal(size=n + 8), np.hanning(9), "valid")
    return rj.Record(peak * noise / np.abs(noise).max(), 0.02)


THREE = rj.Elevation([0.0, 3.5, 8.0], 0.6, 8.4)
TENDONS = rj.Tendon(5.0, 60.0), rj.Damper(3.0)
RICKER = "ricker", 3.0, 1.0
SCENES = {
    "block": Scene(K, ("ricker", 6.5105, 0.7931), 1.6),
    "rigid": Scene(S_R, RICKER, 4.0),
    "rigid with tendons": Scene(S_R.replace(restrainers=TENDONS), ("ricker", 3.6, 1.0), 4.0),
    "elastic on three columns": Scene(S_E.replace(elevation=THREE), ("ricker", 2.4, 1.1), 4.0),
    "lift-off": Scene(
        FRAME.replace(superstructure=rj.Elastic(100.0, 1.0), elevation=rj.Elevation([-3.0, 3.0], 0.6, 22.0)),
        RICKER, 2.5,
    ),
    "modes and vertical motion": Scene(
        KINDS["modes"].replace(restrainers=(rj.Tendon(5.0, 60.0), rj.Damper(3.0))),
        ("one_sine", 2.8, 0.8), 1.6, vertical=0.4,
    ),
    "truncated building on four columns": Scene(
        KINDS["truncated"].replace(restrainers=(), elevation=rj.Elevation([-5.0, -2.0, 2.0, 2.0], 0.5)),
        ("one_sine", 2.2, 0.8), 1.6,
    ),
    "rough record": Scene(S_R, rough(), 4.5),
    "never lifts": Scene(S_E, ("one_sine", 1.0, 1.3), 3.0),
    "overturns": Scene(S_R.replace(superstructure=rj.Rigid(20.0)), ("ricker", 12.0, 1.0), 4.0),
    "devices in the bottom joint": Scene(S_E.replace(restrainers=SAME_OVER_ONE), ("ricker", 3.0, 1.0), 3.0),
    "mixed devices and vertical motion": Scene(
        S_R.replace(restrainers=(*MIXED, rj.Damper(1.0))), ("one_sine", 2.6, 0.8), 2.0, vertical=-0.5
    ),
    "root dampers in both joints": Scene(
        S_R.replace(restrainers=ROOT_DAMPERS, elevation=THREE), ("one_sine", 2.4, 0.8), 2.0
    ),
    "released": Scene(S_R, ("ricker", 0.0, 1.0), 3.0, theta=0.08),
}  # fmt: skip


def check_peaks(found, expected, podium, tolerance: float) -> None:
    """Compare peaks, with axial forces relative to the dead load."""
    dead = np.where(np.asarray(podium.dead_load) > 0, np.asarray(podium.dead_load), 1.0)
    pairs = {
        "peak_friction": (found.peak_friction, expected.friction),
        "least_axial_force": (found.least_axial_force / dead, expected.least_axial / dead),
        "peak_axial_force": (found.peak_axial_force / dead, expected.most_axial / dead),
        "peak_foundation_shear": (found.peak_foundation_shear, expected.shear),
        "peak_impact_friction": (found.peak_impact_friction, expected.impact_friction),
        "least_impulse_share": (found.least_impulse_share, expected.least_share),
    }
    for name, (number, reference) in pairs.items():
        np.testing.assert_allclose(number, reference, rtol=0, atol=tolerance, err_msg=name)


@pytest.mark.slow(but=["block"])
@pytest.mark.parametrize("name", SCENES)
def test_peaks_of_an_independent_integrator(name):
    scene = SCENES[name]
    expected = scene.expected()
    for options, tolerance in ((TIGHT, 1e-8), (DEFAULT, 1e-6)):
        check_peaks(scene.found(options), expected, scene.podium, tolerance)


# ---------------------------------------------------------------------------------------- derivatives
# Location of a peak at an event: least N, friction at the bottom, least N. Other peaks of these scenes are
# inside steps.
PLACES = {
    "just before an impact": Scene(S_R, RICKER, 3.0),
    "at uplift": Scene(S_E, ("one_sine", 4.0, 0.6), 0.45),
    "inside a step": Scene(S_E.replace(elevation=THREE), ("ricker", 2.4, 1.1), 3.0),
}


def numbers_of(scene: Scene) -> np.ndarray:
    podium = scene.podium
    elevation: Any = podium.elevation
    columns = np.asarray(elevation.columns, float)
    of_elevation = float(elevation.beam_depth), float(elevation.top_height), columns[0]
    return np.array([float(podium.alpha), float(podium.gamma), scene.pulse[1], *of_elevation])


def changed(podium: rj.Podium, y) -> rj.Podium:
    elevation: Any = podium.elevation
    others = np.asarray(elevation.columns, float)[1:]
    columns = jnp.concatenate([jnp.stack([jnp.asarray(y[5], float)]), jnp.asarray(others)])
    return podium.replace(alpha=y[0], gamma=y[1], elevation=rj.Elevation(columns, y[3], y[4]))


def in_a_row(found) -> Any:
    return jnp.concatenate([jnp.atleast_1d(getattr(found, name)) for name in JOINT_PEAKS])


def reference_slope(scene: Scene, y: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return central differences of fourth order of the independent peaks along a direction."""

    def at(step: float) -> np.ndarray:
        z = y + step * direction
        found = scene.expected(lambda podium: changed(podium, z), z[2])
        return np.concatenate([
            found.friction, found.least_axial, found.most_axial, [found.shear],
            found.impact_friction, found.least_share,
        ])  # fmt: skip

    h = 1e-4
    return (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)


def test_derivatives_along_a_direction():
    """Derivatives with respect to all numbers together; `test_derivatives` separates them."""
    scene = PLACES["just before an impact"]
    y = numbers_of(scene)
    direction = np.where(y == 0, 1.0, y) * [1.0, -0.7, 0.4, 0.9, -0.3, 0.6]
    motion: Any = scene.motion

    def values(y):
        podium, shaking = changed(scene.podium, y), dataclasses.replace(motion, a_p=y[2])
        return in_a_row(rj.peak_response(podium, shaking, t_end=scene.end, options=TIGHT))

    _, slopes = jax.jvp(values, (jnp.asarray(y),), (jnp.asarray(direction),))
    expected = reference_slope(scene, y, direction)
    np.testing.assert_allclose(slopes, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
def test_derivatives(place):
    """Forward and reverse derivatives and sensitivities of a batch agree with differences of the independent
    peaks.

    The largest friction of the last scene ends a hop of microseconds. The derivative of its time has an error
    of 2e-5 at rtol = 1e-10, which falls with the tolerance.
    """
    scene = PLACES[place]
    tight = TIGHT.replace(rtol=1e-12, atol=1e-14) if place == "inside a step" else TIGHT
    y = numbers_of(scene)
    motion: Any = scene.motion

    def values(y):
        podium, shaking = changed(scene.podium, y), dataclasses.replace(motion, a_p=y[2])
        return in_a_row(rj.peak_response(podium, shaking, t_end=scene.end, options=tight))

    size = np.where(y == 0, 1.0, np.abs(y))
    expected = np.stack([reference_slope(scene, y, row) for row in np.diag(size)], axis=-1) / size
    scale = np.max(np.abs(expected) * size, axis=1, keepdims=True)
    forward = np.asarray(jax.jacfwd(values)(jnp.asarray(y)))
    reverse = np.asarray(jax.jacrev(values)(jnp.asarray(y)))
    error = np.abs(forward - expected) * size
    assert np.all(error <= 1e-6 * scale + 1e-12), (error / scale).max(axis=0)
    np.testing.assert_allclose(reverse * size, forward * size, rtol=0, atol=1e-10 * scale.max())
    names = "alpha", "gamma", "a_p", "beam_depth", "top_height", "position_1"
    pulses = dataclasses.replace(motion, a_p=np.array([y[2], 0.9 * y[2]]))
    batch: Any = rj.peak_responses(
        scene.podium, pulses, t_end=scene.end, options=tight, sensitivities=names
    ).sensitivities
    found = [np.asarray(getattr(batch, name)[0]) for name in JOINT_PEAKS]
    rows = np.concatenate([y.reshape(-1, len(names)) for y in found])
    assert np.all(np.abs(rows - expected * y) <= 1e-6 * scale + 1e-12)


# ------------------------------------------------------------------------------------ scenes without forces
def test_scenes_without_forces_pay_nothing():
    """Without requested forces, an elevation changes no operation and no bit."""
    plain = S_E.replace(elevation=None)

    def operations(podium: rj.Podium, outputs: tuple[str, ...]) -> str:
        options = rj.Options(outputs=outputs)
        peak = lambda a_p: rj.peak_response(podium, rj.Ricker(a_p, 1.0), options=options).peak_rotation
        return str(jax.make_jaxpr(peak)(3.0))

    outputs = rj.Options().outputs
    assert operations(S_E, outputs) == operations(plain, outputs)
    assert len(operations(S_E, (*outputs, "axial_force"))) > len(operations(S_E, outputs))
    pulses = rj.Ricker(np.linspace(1.5, 4.0, 6), 1.0)
    found, expected = (rj.peak_responses(podium, pulses) for podium in (S_E, plain))
    for name in (*outputs, "overturned", "uplift_time"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


# ------------------------------------------------------------------------------------------ histories
def states_at(scene: Scene, response, t: np.ndarray, left: bool = False) -> States:
    """Return states of a history; ground accelerations come from formulas."""
    found, n = response(t, left=left), modes_of(scene.podium)
    of_modes = [np.asarray(y).reshape(len(t), -1)[:, :n] for y in (found.u_t, found.u_t_dot)]
    ground = np.array([scene.horizontal[0](time) for time in t])
    u, u_dot = of_modes
    rotation = np.asarray(found.theta), np.asarray(found.theta_dot)
    return States(*rotation, u, u_dot, ground, scene.vertical * ground)


def between_nodes(response, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the Gauss points of all steps of a history and their weights, one row for each step."""
    nodes = np.asarray(response.times)
    ends = np.append(nodes[np.isfinite(nodes)], float(response.stats.end_time))
    ends = np.unique(ends)
    z, w = np.polynomial.legendre.leggauss(points)
    h = np.diff(ends)[:, None]
    return ends[:-1, None] + 0.5 * h * (1 + z), 0.5 * h * w


HISTORIES = {
    "devices in the bottom joint": SCENES["devices in the bottom joint"],
    "modes and vertical motion": SCENES["modes and vertical motion"],
    "rigid with tendons": dataclasses.replace(SCENES["rigid with tendons"], end=3.0),
    "truncated building on four columns": SCENES["truncated building on four columns"],
    "rough record": dataclasses.replace(SCENES["rough record"], end=3.5),
}


def momentum(scene: Scene, states: States, side: np.ndarray) -> np.ndarray:
    """Return P of (F18), axes (component, states), divided by N m_c [m/s]."""
    podium = scene.podium
    gamma, eta = map(float, podium.mass_ratios)
    etas = np.array([k[0] for k in structure_of(podium).frame.modes])
    psi = side * float(podium.alpha) - states.theta
    u_b, v_b = 2 * float(podium.R) * states.theta_dot * np.array([np.cos(psi), np.sin(psi)])
    of_modes = states.u_dot @ etas if len(etas) else 0.0
    return np.array([(0.5 + gamma) * u_b + of_modes, (0.5 + gamma + eta) * v_b])


def momentum_jumps(scene: Scene, before: States, after: States) -> np.ndarray:
    """Return the changes of P at impacts, axes (component, impacts)."""
    return momentum(scene, after, np.sign(after.theta_dot)) - momentum(
        scene, before, -np.sign(before.theta_dot)
    )


def momentum_defect(scene: Scene, response, t: np.ndarray, w: np.ndarray) -> float:
    """Return the residual of (F18) over a history, divided by the impulse of the weight; `t` and `w` are
    times and weights of `between_nodes`."""
    states = states_at(scene, response, t.ravel())
    gamma, eta = map(float, scene.podium.mass_ratios)
    weight = 1 + gamma + eta
    shear, reaction = response.foundation_shear(t.ravel()), response.foundation_reaction(t.ravel())
    horizontal = weight * (G * np.asarray(shear) - states.ground)
    vertical = weight * (G * np.asarray(reaction) - (G + states.vertical))
    found = np.array([np.sum(y.reshape(t.shape) * w) for y in (horizontal, vertical)])
    times = np.asarray(response.impact_times)
    # The number of times is the same, so the programs are reused.
    more = np.resize(times, t.size) if len(times) else t.ravel()
    before, after = (
        States(*(y[: len(times)] for y in states_at(scene, response, more, left))) for left in (True, False)
    )
    jumps = momentum_jumps(scene, before, after)
    span = float(response.times[0]), float(response.stats.end_time)
    ends = States(*(y[:2] for y in states_at(scene, response, np.resize(span, t.size))))
    change = momentum(scene, ends, np.sign(ends.theta))
    scale = weight * G * scene.end
    return float(np.max(np.abs(change[:, 1] - change[:, 0] - found - jumps.sum(axis=1)))) / scale


def random_scene(seed: int) -> Scene:
    """Return a scene with a random structure on 2 to 5 columns, devices, and a record with or without
    vertical motion."""
    rng = np.random.default_rng(seed)
    kind = list(KINDS)[seed % len(KINDS)]
    podium = KINDS[kind].replace(
        alpha=rng.uniform(0.1, 0.25), R=rng.uniform(1.0, 3.0), lam=rng.uniform(0.1, 1.0)
    )
    if kind not in ("block", "anchor plate"):
        podium = podium.replace(gamma=rng.uniform(0.5, 20.0))
    if podium.elevation is not None:
        columns = np.cumsum(rng.uniform(2.0, 6.0, rng.integers(2, 6)))
        podium = podium.replace(elevation=dataclasses.replace(podium.elevation, columns=tuple(columns)))
    threshold = float(podium.uplift_ground_acceleration)
    record = rough(seed, rng.uniform(1.5, 2.5) * threshold, 60)
    return Scene(podium, record, 2.0, vertical=float(rng.choice([0.0, 0.3])))


@pytest.mark.slow(but=["0"])
@pytest.mark.parametrize("seed", range(12))
def test_momentum_of_random_scenes(seed):
    """(F18): the change of the momentum of all masses is the impulse of the forces on the foundation, of
    gravity and of the impacts."""
    scene = random_scene(seed)
    options = TIGHT.replace(throw=False)
    response = rj.simulate(scene.podium, scene.motion, t_end=scene.end, options=options)
    assert response.uplifted
    assert momentum_defect(scene, response, *between_nodes(response, 10)) <= 1e-9


@pytest.mark.slow(but=["devices in the bottom joint"])
@pytest.mark.parametrize("name", HISTORIES)
def test_histories(name):
    """Forces of all columns agree with free bodies; momentum (F18) holds; both sides of impacts are
    returned."""
    scene = HISTORIES[name]
    podium, structure = scene.podium, structure_of(scene.podium)
    response = rj.simulate(
        podium, scene.motion, initial=rj.State(scene.theta), t_end=scene.end, options=TIGHT
    )
    t, w = between_nodes(response, 10)
    states = states_at(scene, response, t.ravel())
    forces = response.joint_forces(t.ravel())
    contact = (states.theta == 0) & (states.theta_dot == 0)
    sides = np.where(contact, 0, np.sign(states.theta))
    assert {*sides} >= {0, 1, -1}
    friction, eccentricity = response.friction(t.ravel()), response.eccentricity(t.ravel())
    shear, reaction = response.foundation_shear(t.ravel()), response.foundation_reaction(t.ravel())
    for side in (0, 1, -1):
        here = sides == side
        expected = of_free_bodies(podium, side, States(*(y[here] for y in states)))
        size = np.max(np.abs(expected.N)) / G
        near(np.moveaxis(np.asarray(forces.axial)[here], 1, 2), expected.N / G, 1e-11, size)
        near(np.moveaxis(np.asarray(forces.horizontal)[here], 1, 2), expected.T / G, 1e-11, size)
        near(np.asarray(shear)[here], expected.V / structure.weight, 1e-11, 1.0)
        near(np.asarray(reaction)[here], expected.W / structure.weight, 1e-11, 1.0)
        near(np.asarray(eccentricity)[here], expected.eccentricity, 1e-10, 1.0)
    demand = np.abs(np.asarray(forces.horizontal)) / np.asarray(forces.axial)
    np.testing.assert_allclose(friction, np.where(np.asarray(forces.axial) > 0, demand, np.inf), rtol=1e-12)
    assert np.all(np.asarray(friction).max(axis=(0, 1)) <= np.asarray(response.peak_friction) + 1e-9)
    assert np.all(np.asarray(forces.axial).min(axis=(0, 1)) >= np.asarray(response.least_axial_force) - 1e-7)
    times = np.asarray(response.impact_times)
    assert len(times)
    assert momentum_defect(scene, response, t, w) <= 1e-9
    # The number of times is the same, so the programs are reused.
    more = np.resize(times, t.size)
    before, after = (
        States(*(y[: len(times)] for y in states_at(scene, response, more, left))) for left in (True, False)
    )
    side, jumps = np.sign(before.theta_dot) * -1.0, momentum_jumps(scene, before, after)
    # Impulses, also at the ground.
    impulses = np.asarray(response.impulses)
    for k in range(min(len(times), 5)):
        y = np.concatenate([[0.0, before.theta_dot[k]], before.u[k], before.u_dot[k], [0.0]])
        T, N, _ = structure.impulses(int(side[k]), y)
        near(impulses[k, ..., 0].T, T, 1e-9, np.max(np.abs(N)))
        near(impulses[k, ..., 1].T, N, 1e-9, np.max(np.abs(N)))
        assert impulses[k, :, 0, 0].mean() == pytest.approx(jumps[0, k], rel=1e-9)
    # The values before and after an impact, which the peaks include.
    for left, states_there, sign in ((True, before, side), (False, after, np.sign(after.theta_dot))):
        there = response.joint_forces(more, left=left)
        for k in range(min(len(times), 3)):
            if sign[k] == 0:
                continue
            one = States(*(y[k : k + 1] for y in states_there))
            expected = of_free_bodies(podium, int(sign[k]), one)
            size = np.max(np.abs(expected.N)) / G
            near(np.asarray(there.axial)[k].T, expected.N[0] / G, 1e-9, size)
            near(np.asarray(there.horizontal)[k].T, expected.T[0] / G, 1e-9, size)


@pytest.mark.slow
def test_moment_and_shape_of_histories():
    """Axes are times, columns and joints. Without an elevation, forces are those of the mean column and there
    is no moment."""
    response = rj.simulate(S_R, rj.Ricker(3.0, 1.0), t_end=1.0, options=TIGHT)
    t = np.linspace(-1.0, 1.0, 12).reshape(3, 4)
    forces = response.joint_forces(t)
    assert forces.horizontal.shape == forces.axial.shape == (3, 4, 2, 2)
    assert response.impulses.shape == (len(response.impact_times), 2, 2, 2)
    moment = np.asarray(response.overturning_moment(t))
    side, places = np.asarray(response.eccentricity(t)), np.array([-3.0, 3.0])
    axial = np.asarray(forces.axial)[..., 1]
    width = 1.5 * math.sin(0.15)
    near((axial * places).mean(axis=-1), moment + side * width * axial.mean(axis=-1), 1e-13)
    assert np.isnan(response.joint_forces(1.5).axial).all()
    mean = rj.simulate(S_R.replace(elevation=None), rj.Ricker(3.0, 1.0), t_end=1.0, options=TIGHT)
    found = mean.joint_forces(t)
    assert found.axial.shape == (3, 4, 1, 2)
    near(found.axial[..., 0, :], np.asarray(forces.axial).mean(axis=-2), 1e-9)
    with pytest.raises(ValueError, match="elevation"):
        mean.overturning_moment(t)


# ---------------------------------------------------------------------------------------- bounds
class Followed(rj.AbstractOutput):
    """An output that allows no fast-forward, so that histories have nodes in full contact."""

    name = "followed"

    def start(self, start):
        return jnp.zeros_like(start.t), None

    def over_step(self, step, accumulator):
        return None


FOLLOWED = TIGHT.replace(outputs=(*OUTPUTS, Followed()))


def small(a_p: float, T_p: float = 1.0) -> tuple:
    return "one_sine", a_p, T_p


ROUND = rj.Podium.from_dimensions(
    0.45, 3.0, 1500.0, 3e3, end_radius=0.9, positions=(-3.0, 0.5, 2.0), beam_depth=0.6
)  # γ = ⅔
BOUNDED = {
    "rigid": Scene(S_R, small(1.9), 4.0),
    "rigid with tendons": Scene(S_R.replace(restrainers=TENDONS), small(2.4), 4.0),
    "columns with devices in the bottom joint": Scene(
        S.replace(restrainers=(rj.Tendon(2.0, 40.0, joints=1), rj.Damper(6.0, joints=1))), small(2.0), 4.0
    ),
    "mixed devices and vertical motion": Scene(
        S_R.replace(restrainers=(*MIXED, rj.Damper(1.0))), small(2.2, 0.8), 3.0, vertical=-0.3
    ),
    "elastic": Scene(S_E, small(1.6), 6.0),
    "devices in the bottom joint": Scene(S_E.replace(restrainers=SAME_OVER_ONE), ("ricker", 1.8, 1.0), 5.0),
    "modes and vertical motion": Scene(
        KINDS["modes"].replace(restrainers=(*MIXED, rj.Damper(1.0))), small(2.0, 0.8), 6.0, vertical=0.4
    ),
    "truncated building": Scene(KINDS["truncated"].replace(restrainers=()), small(1.8, 0.8), 6.0),
    "rough record": Scene(S_R, rough(5, 1.9), 6.0),
    "rough record and vertical motion": Scene(S_E.replace(elevation=THREE), rough(6, 1.7), 8.0, vertical=0.3),
    "block": Scene(K, small(3.2, 0.6), 4.0),
    "round ends": Scene(ROUND, small(1.9), 4.0),
}  # fmt: skip


def bounds_along(scene: Scene, response, podium: rj.Podium) -> dict[str, np.ndarray]:
    """Return `JointBounds` from each node of a history, and whether the columns rest for good."""
    podium = podium.split_rows().without_idle_restrainers()
    motion = response.excitation.common_form()
    plan = plan_for(podium, FOLLOWED, history=False)
    ready, state = prepare(podium, motion, rj.State(), jnp.asarray(scene.end), FOLLOWED, plan)
    nodes, used = response.nodes, int(response.nodes.used)
    nodes = jax.tree.map(lambda y: y[:used], (nodes.t, nodes.x, nodes.v, nodes.sigma, nodes.piece))

    @jax.jit
    def along(nodes):
        def at(t, x, v, sigma, piece):
            here = state._replace(t=t, event_time=t, x=x, v=v, sigma=sigma, piece=piece)
            bounds = Bounds.after_step(ready, here, piece, motion.piece(piece)(t), plan.follows_contact)
            found = JointBounds.from_bounds(bounds)
            return {
                "holds": bounds.stays_inside | bounds.rests,
                "rests": jnp.asarray(bounds.rests),
                "least": jnp.stack(found.least_axial),
                "most": jnp.stack(found.most_axial),
                "shear": found.foundation_shear,
                "friction": jnp.stack(found.friction),
            }

        return jax.vmap(at)(*nodes)

    return {name: np.asarray(y) for name, y in along(nodes).items()}


@pytest.mark.slow(but=["devices in the bottom joint"])
@pytest.mark.parametrize("name", BOUNDED)
def test_no_later_force_is_beyond_its_bound(name):
    """`JointBounds` hold after every node of a history at which the energy keeps the columns inside the
    potential well."""
    scene = BOUNDED[name]
    structure = structure_of(scene.podium)
    response = rj.simulate(scene.podium, scene.motion, t_end=scene.end, options=FOLLOWED)
    bounds = bounds_along(scene, response, scene.podium)
    assert bounds["holds"].sum() > 20
    starts = np.asarray(response.times)[: len(bounds["holds"])]
    t, _ = between_nodes(response, 6)
    events = np.unique(starts)
    times = np.concatenate([t.ravel(), events, events[1:]])
    forces = [
        (response.joint_forces(part, left=left), response.foundation_shear(part, left=left))
        for part, left in ((np.concatenate([t.ravel(), events]), False), (events[1:], True))
    ]
    T, N = (
        np.concatenate([np.asarray(getattr(f, which)) for f, _ in forces]) * G
        for which in ("horizontal", "axial")
    )
    V = np.abs(np.concatenate([np.asarray(v) for _, v in forces])) * structure.weight
    demand = np.where(N > 0, np.abs(T) / np.where(N > 0, N, 1.0), np.where((N == 0) & (T == 0), 0.0, np.inf))
    order = np.argsort(times, kind="stable")
    later = lambda values: np.maximum.accumulate(values[order][::-1], axis=0)[::-1]
    least, most = -later(-N.min(axis=1)), later(N.max(axis=1))
    shear, friction = later(V), later(demand.max(axis=1))
    # Values after a node; the value just before an impact at the node does not count.
    first = np.searchsorted(times[order], starts, side="right")
    inside = bounds["holds"] & (first < len(times))
    first, size = first[inside], structure.weight
    assert np.all(least[first] >= bounds["least"][inside] - 1e-9 * size)
    assert np.all(most[first] <= bounds["most"][inside] + 1e-9 * size)
    assert np.all(shear[first] <= bounds["shear"][inside] + 1e-9 * size)
    assert np.all(friction[first] <= bounds["friction"][inside] + 1e-9)


def test_bounds_on_columns_that_the_joint_forces_unload():
    """Columns at 0, 2B and 2B have the core distance 2B/3, less than B, so weights and tendons above their
    corners unload the first column."""
    width = 2 * 1.5 * math.sin(0.15)
    podium = rj.Podium(
        0.15, 1.5, 10.0, restrainers=(rj.Tendon(0.0, 2000.0),),
        elevation=rj.Elevation((0.0, width, width), 1e-6),
    )  # fmt: skip
    c = coefficients(podium.split_rows().resolved(), 1e-8, True, True)
    zero, one, angle, vertical = jnp.zeros(()), jnp.ones(()), jnp.asarray(0.05), jnp.asarray(2.0)
    ground = 0.999 * c.uplift * (c.g + vertical) / c.g
    sin, cos = (jnp.sin(0.1), c.sin_alpha), (c.cos_alpha, jnp.cos(0.1))
    flexibility = 1 / (c.inertia + c.centrifugal * sin[1] ** 2), 1 / (c.inertia + c.centrifugal * sin[0] ** 2)
    resisting = restraint_bound(c, not_none(c.restraint), angle, zero)
    rotation = Rotation(angle, sin, cos, zero, flexibility, resisting)
    bounds = JointBounds(c, ground, vertical, one, rotation, None)
    for sigma, theta in ((0, 0.0), (1, 0.05), (-1, -0.05)):
        for share, v_g in itertools.product((-1, 1), (-vertical, vertical)):
            shaking, x, still = Shaking(share * ground, v_g), (jnp.asarray(theta),), (zero,)
            if not sigma and v_g < 0:
                continue  # the columns would lift
            a = acceleration(c, jnp.asarray(sigma), shaking, x, still)
            mean = joints.mean_forces(c, jnp.asarray(sigma), shaking, x, still, a)
            _, axial = joints.column_forces(c, mean, end_offsets(c))
            least, most = (np.repeat(np.asarray(y), 2) for y in (bounds.least_axial, bounds.most_axial))
            assert np.all(least <= np.asarray(axial))
            assert np.all(np.asarray(axial) <= most)


# ----------------------------------------------------------------------------------- edge conventions
def test_nothing_on_a_block():
    """A block has no top joint: force 0, friction 0, impulse share 1, never open, also with a device in the
    bottom joint."""
    for podium in (K, K.replace(restrainers=(rj.Tendon(0.5, 2.0, joints=1),))):
        found: Any = rj.peak_response(podium, rj.Ricker(6.5105, 0.7931), t_end=2.0, options=TIGHT)
        for name in ("peak_friction", "least_axial_force", "peak_axial_force", "peak_impact_friction"):
            assert float(getattr(found, name)[1]) == 0.0
            assert float(getattr(found, name)[0]) > 0
        assert float(found.least_impulse_share[1]) == 1.0
        assert bool(found.joints_closed)
        at_top = at(podium, 1, 0.1, -0.4, 3.0)
        assert at_top.mean_T[1] == at_top.mean_N[1] == 0.0


def test_facts_of_pulses_on_a_block():
    """Fact 23: peaks of a block under pulses."""
    found: Any = rj.peak_response(K, rj.Ricker(6.5105, 0.7931), t_end=8.0, options=TIGHT)
    assert float(found.peak_friction[0]) == pytest.approx(0.3379389035215, abs=1e-11)
    assert float(found.least_axial_force[0]) == pytest.approx(0.9127220237832, abs=1e-11)
    assert float(found.peak_axial_force[0]) == pytest.approx(1.0652206394536, abs=1e-11)


SLENDER = math.atan(0.15)


@pytest.mark.slow
def test_facts_of_pulses_on_frames():
    """Facts 24 and 25: peaks of frames under pulses."""
    rigid = S_R.replace(alpha=SLENDER)
    found: Any = rj.peak_response(rigid, rj.Ricker(3.2362, 1.0134), options=TIGHT)
    near(found.peak_friction, [0.1508196540676, 0.1509532734530], 1e-11)
    assert float(found.least_axial_force[1]) == pytest.approx(31.4798837640244, rel=1e-11)
    assert float(found.peak_axial_force[0]) == pytest.approx(89.9308242299222, rel=1e-11)
    assert float(found.peak_foundation_shear) == pytest.approx(0.1532312734918, rel=1e-11)
    elastic = S_E.replace(alpha=SLENDER)
    found = rj.peak_response(elastic, rj.Ricker(2.3536, 1.0913), t_end=5.08, options=TIGHT)
    near(found.peak_friction, [0.1564236813805, 0.1912378850045], 1e-9)
    assert float(found.least_axial_force[1]) == pytest.approx(7.6786031102, abs=1e-8)
    assert float(found.peak_axial_force[0]) == pytest.approx(127.371501744, rel=1e-10)
    assert float(found.peak_foundation_shear) == pytest.approx(0.1593768753025, rel=1e-10)


@pytest.mark.slow
def test_open_joints_do_not_stop_a_scene():
    """Friction is inf with derivative 0; least N and its derivative stay finite. Without impacts, impact
    friction is 0 and the impulse share 1."""
    scene = SCENES["lift-off"]

    def values(height):
        elevation = rj.Elevation([-3.0, 3.0], 0.6, height)
        podium = scene.podium.replace(elevation=elevation)
        found: Any = rj.peak_response(podium, scene.motion, t_end=scene.end, options=TIGHT)
        return jnp.concatenate([found.peak_friction, found.least_axial_force]), found

    slopes, found = jax.jacfwd(values, has_aux=True)(22.0)
    assert found.result == rj.RESULTS.end_of_time
    assert np.all(np.isinf(found.peak_friction))
    assert np.all(np.asarray(found.least_axial_force) < 0)
    assert not bool(found.joints_closed)
    assert np.all(slopes[:2] == 0)
    h = 1e-3
    up, down = (np.asarray(values(22.0 + k * h)[0][2:]) for k in (1, -1))
    np.testing.assert_allclose(slopes[2:], (up - down) / (2 * h), rtol=1e-6)
    rests: Any = rj.peak_response(scene.podium, rj.Ricker(0.1, 1.0), t_end=2.5, options=TIGHT)
    assert np.isnan(rests.uplift_time)
    assert np.all(np.asarray(rests.peak_impact_friction) == 0)
    assert np.all(np.asarray(rests.least_impulse_share) == 1)
    assert bool(rests.joints_closed)
    # The initial state is included.
    swings = rj.State(0.0, 0.0, 0.4, 0.0)
    at_start: Any = rj.peak_response(
        scene.podium, scene.motion, initial=swings, t_end=float(scene.motion.support[0]) + 1e-3, options=TIGHT
    )
    assert float(at_start.least_axial_force[1]) < float(rests.least_axial_force[1]) - 1.0


@pytest.mark.slow
def test_weightless_scenes_have_no_forces():
    motion = rj.GroundMotion(rj.OneSine(3.0, 0.8), rj.OneSine(12.0, 0.8))
    peak = jax.jit(lambda f: rj.peak_response(S_R, motion.scaled(f), options=TIGHT))
    found: Any = peak(1.0)
    assert found.result == rj.RESULTS.weightless
    for name in JOINT_PEAKS:
        assert np.all(np.isnan(getattr(found, name))), name
    assert not bool(found.joints_closed)


@pytest.mark.slow
def test_mirror_of_a_scene():
    """−ü_g with −x_i has the same peaks, and so has −ü_g alone for symmetric positions."""
    podium, other = (
        S_E.replace(elevation=rj.Elevation(y, 0.6, 8.4)) for y in ([0.0, 3.5, 8.0], [0.0, -3.5, -8.0])
    )
    peaks_of = lambda podium, a_p: rj.peak_response(podium, rj.Ricker(a_p, 1.1), t_end=3.0, options=TIGHT)
    for a, b in (
        (peaks_of(podium, 2.4), peaks_of(other, -2.4)),
        (peaks_of(S_E, 2.4), peaks_of(S_E, -2.4)),
    ):
        for name in JOINT_PEAKS:
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-9)
    assert not np.allclose(peaks_of(podium, 2.4).least_axial_force, peaks_of(podium, -2.4).least_axial_force)


# ---------------------------------------------------------------------------------------- bad input
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"columns": [1.0]}, "2 columns or more"),
        ({"columns": [2.0, 2.0, 2.0]}, "two lines or more.* 2 m"),
        ({"columns": [0.0, math.nan]}, "columns"),
        ({"columns": [0.0, math.inf]}, "columns"),
        ({"columns": [0.0, 3.0], "beam_depth": -0.1}, "beam_depth.*-0.1"),
        ({"columns": [0.0, 3.0], "beam_depth": math.nan}, "beam_depth"),
        ({"columns": [0.0, 3.0], "top_height": math.inf}, "top_height"),
        ({"columns": [0.0, 3.0], "residual_height": math.nan}, "residual_height"),
    ],
)
def test_bad_elevations(arguments, message):
    with pytest.raises(ValueError, match=f"Elevation: .*{message}"):
        rj.Elevation(**arguments)


@pytest.mark.parametrize(
    ("podium", "columns", "height", "message"),
    [
        (S_R, [0.0, 0.44, 6.0], 9.0, r"columns.*0\.44 m"),  # 2B = 0.448 m
        (FRAME.replace(superstructure=TWO_MODES), [0.0, 6.0], [9.0], "top_height.*2"),
        (FRAME.replace(superstructure=TWO_MODES), [0.0, 6.0], [9.0, 1.0, 2.0], "top_height.*2"),
        (FRAME.replace(superstructure=BUILDING), [0.0, 6.0], [3.0, 6.0, 9.0], "its own heights"),
        (
            FRAME.replace(superstructure=rj.ShearBuilding([1.0, 1.0], [9.0, 9.0])),
            [0.0, 6.0], [3.0, 6.0, 9.0], "top_height.*2",
        ),
        (
            FRAME.replace(superstructure=rj.ShearBuilding([1.0, 1.0], [9.0, 9.0])),
            [0.0, 6.0], [6.0, 3.0], "top_height.*ascending",
        ),
        (K, [0.0, 6.0], 0.0, "solitary block"),
        (K.replace(restrainers=(rj.Tendon(1.0, joints=1),)), [0.0, 6.0], 0.0, "solitary block"),
        (K.replace(superstructure=rj.Rigid(0.0)), [0.0, 6.0], 9.0, "solitary block"),
        (K.replace(superstructure=rj.Elastic(0.0, 0.5)), [0.0, 6.0], 9.0, "solitary block"),
    ],
)  # fmt: skip
def test_elevations_that_do_not_fit(podium, columns, height, message):
    with pytest.raises(ValueError, match=message):
        podium.replace(elevation=rj.Elevation(columns, 0.6, height))


def test_a_building_with_its_own_heights_changes_inside_jit():
    podium = FRAME.replace(superstructure=BUILDING, elevation=rj.Elevation([0.0, 6.0], 0.6))
    changed = jax.jit(lambda podium, alpha: podium.replace(alpha=alpha).dead_load)(podium, 0.3)
    np.testing.assert_allclose(changed, podium.replace(alpha=0.3).dead_load, rtol=1e-14)


def test_elevations_that_do_fit():
    width = float(S_R.width)
    for columns in ([0.0, width], [6.0, 0.0, 0.0, 6.0], [3.0, -1.0, 10.0]):
        assert S_R.replace(elevation=rj.Elevation(columns, 0.6, 9.0)).elevation is not None
    # Negative lever arms are valid for higher modes; values may be traced.
    FRAME.replace(superstructure=TWO_MODES, elevation=rj.Elevation([0.0, 6.0], 0.6, [9.0, -2.0]))
    jax.jit(lambda x: rj.Elevation([x, x], x, x))(-1.0)
    K.replace(restrainers=(rj.Tendon(1.0),), elevation=rj.Elevation([0.0, 6.0]))


def test_other_bad_input():
    with pytest.raises(ValueError, match="elevation"):
        S_R.replace(elevation=3.0)
    with pytest.raises(ValueError, match="elevation"):
        _ = FRAME.core_distance
    for name in OUTPUTS:
        with pytest.raises(ValueError, match=name):
            rj.Options(outputs=(name,), engine="segments")
    dimensions: Any = {"width": 0.45, "height": 3.0, "column_mass": 700.0, "beam_mass": 1.4e4}
    made = rj.Podium.from_dimensions(**dimensions, positions=[0.0, 6.0, 12.0], beam_depth=0.6)
    assert float(made.gamma) == pytest.approx(1.4e4 / 2100)
    assert float(made.core_distance) == pytest.approx(4.0)
    with pytest.raises(ValueError, match="columns must be the number of positions"):
        rj.Podium.from_dimensions(**dimensions, columns=2, positions=[0.0, 6.0, 12.0])
    with pytest.raises(ValueError, match="beam_depth needs the positions"):
        rj.Podium.from_dimensions(**dimensions, beam_depth=0.6)
    with pytest.raises(ValueError, match="width of a column"):
        rj.Podium.from_dimensions(**dimensions, positions=[0.0, 0.4])
