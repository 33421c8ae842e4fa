"""Equations of motion, compared with automatic derivatives of the Lagrangian."""

import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._engine import guard, hermite, model
from rockjax._engine.coefficients import coefficients
from rockjax._engine.energy import energy, energy_after, potential
from rockjax._engine.runge_kutta import Step
from rockjax._engine.scene import default_end, plan_for, prepare
from rockjax._engine.transitions import after_impact, contact_mode
from rockjax._outputs import views
from rockjax._outputs.maxima import Cubic, Quartic
from rockjax._programs.program import ARRAYS
from rockjax._responses.work import power, restoring_moment
from tests.scenes import PODIUMS, G

ELASTIC = rj.Podium(alpha=0.25, R=1.7, gamma=3.0, superstructure=rj.Elastic(8.0, 0.6, 0.07), lam=0.29)
STATES = np.random.default_rng(0).normal(size=(20, 5)) * [0.1, 0.5, 0.2, 0.6, 3.0]


def lagrangian_parts(podium, sigma):
    """Return T and V of Eqs. (16)–(19) divided by N m_c, and the damping force of Eq. (20)."""
    c, top = podium, podium.superstructure
    w = 2 * jnp.pi / top.T_s

    def displacements(q):
        psi = sigma * c.alpha - q[0]
        u_b = 2 * c.R * (sigma * jnp.sin(c.alpha) - jnp.sin(psi))
        v_b = 2 * c.R * (jnp.cos(psi) - jnp.cos(c.alpha))
        return u_b, v_b

    def kinetic(q, rate):
        u_b_dot, v_b_dot = jax.jvp(displacements, (q,), (rate,))[1]
        beam = 0.5 * c.gamma * (u_b_dot**2 + v_b_dot**2)
        columns = 0.5 * (1 + c.lam) * c.R**2 * rate[0] ** 2
        return 0.5 * top.eta * (rate[1] ** 2 + v_b_dot**2) + beam + columns

    def potential(q, ground):
        u_b, v_b = displacements(q)
        gravity = c.g * (top.eta + c.gamma + 0.5) * v_b
        spring = 0.5 * top.eta * w**2 * (q[1] - u_b) ** 2
        return gravity + spring + ground * (top.eta * q[1] + (c.gamma + 0.5) * u_b)

    def damping(q, rate):
        """Return the generalised forces −2ζω_s η (u̇_t − u̇_b)·∂(u_t − u_b)/∂q."""
        stretch = lambda q: q[1] - displacements(q)[0]
        speed = jax.jvp(stretch, (q,), (rate,))[1]
        return -2 * top.zeta * w * top.eta * speed * jax.grad(stretch)(q)

    return kinetic, potential, damping


@pytest.mark.parametrize("sigma", [1.0, -1.0])
def test_equations_of_motion_are_those_of_lagrange(sigma):
    """Eqs. (10), (22), (24)."""
    kinetic, potential, damping = lagrangian_parts(ELASTIC, sigma)
    c = coefficients(ELASTIC)

    @jax.jit
    def both(state):
        q, rate, ground = state[:2], state[2:4], state[4]
        mass = jax.hessian(kinetic, 1)(q, rate)
        # d/dt ∂T/∂q̇ = M q̈ + (∂²T/∂q̇∂q) q̇
        gyroscopic = jax.jacfwd(jax.grad(kinetic, 1), 0)(q, rate) @ rate
        forces = jax.grad(kinetic)(q, rate) - jax.grad(potential)(q, ground) + damping(q, rate) - gyroscopic
        paper = model.acceleration(c, jnp.asarray(sigma), ground, (q[0], q[1]), (rate[0], rate[1]))
        return jnp.linalg.solve(mass, forces), jnp.stack(paper)

    for state in STATES:
        state = jnp.asarray(state).at[0].set(sigma * abs(state[0]))
        lagrange, paper = both(state)
        np.testing.assert_allclose(paper, lagrange, rtol=1e-11, atol=1e-11)


def test_energy_is_that_of_the_lagrangian():
    kinetic, potential, _ = lagrangian_parts(ELASTIC, 1.0)
    c = coefficients(ELASTIC)
    for state in STATES:
        q, rate = jnp.asarray([abs(state[0]), state[1]]), jnp.asarray(state[2:4])
        expected = kinetic(q, rate) + potential(q, 0.0)
        assert float(energy(c, jnp.ones(()), (q[0], q[1]), (rate[0], rate[1]))) == pytest.approx(
            float(expected)
        )


@pytest.mark.parametrize("name", ["block", "frame", "rigid", "elastic"])
def test_energy_rate_and_its_bound(name):
    """dE/dt is the power of the ground minus that of the damper; the ground increases √E at most at the rate
    C|ü_g|."""
    podium = PODIUMS[name]
    c = coefficients(podium)
    n = 2 if c.vibration else 1

    @jax.jit
    def rates(state):
        x, v = (state[0], state[1])[:n], (state[2], state[3])[:n]
        a = model.acceleration(c, jnp.ones(()), state[4], x, v)
        E, rate = jax.jvp(lambda x, v: energy(c, jnp.ones(()), x, v), (x, v), (v, a))
        stretch = v[1] - model.beam(c, jnp.ones(()), x[0], v[0])[1] if c.vibration else jnp.zeros(())
        loss = c.eta * c.vibration.damping * stretch**2 if c.vibration else jnp.zeros(())
        return E, rate, loss

    for state in STATES:
        state = jnp.asarray(state).at[0].set(abs(state[0]) * 0.5)
        E, rate, loss = rates(state)
        growth = float(rate + loss) / (2 * np.sqrt(float(E)))
        assert growth <= float(c.impulse_factor) * abs(float(state[4])) * (1 + 1e-12)
        still = rates(state.at[4].set(0.0))
        assert float(still[1]) == pytest.approx(-float(still[2]), rel=1e-9, abs=1e-9 * float(E))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_uplift_is_where_rocking_would_start(side):
    """Eq. (9) is Eq. (24) with θ = θ̇ = θ̈ = 0. Eq. (6) as printed counts the columns twice and leads to
    another threshold."""
    c = coefficients(ELASTIC)
    u, u_dot = jnp.asarray(0.03), jnp.asarray(-0.2)
    zero = jnp.zeros(())
    mode = c.vibration
    force = mode.omega2 * u + mode.damping * u_dot
    ground = -side * c.uplift + mode.demand * force
    assert float(model.uplift_demand(c, ground, (zero, u), (zero, u_dot))) == pytest.approx(
        -side * float(c.uplift)
    )
    start = model.acceleration(c, jnp.asarray(side), ground, (zero, u), (zero, u_dot))
    assert abs(float(start[0])) < 1e-12
    gamma, eta, t = 3.0, 8.0, np.tan(0.25)
    # virtual work of Eq. (6) at u_t = 0, with columns of m_c = 1/2, so that N m_c = 1
    corrected = G * t * (0.5 + gamma + eta) / (0.5 + gamma)
    printed = G * t * (0.5 + gamma + 0.5) / (0.5 + gamma)
    assert float(c.uplift) == pytest.approx(corrected, rel=1e-12)
    assert abs(float(c.uplift) - printed) > 1.0


def test_contact_is_equation_4():
    c = coefficients(ELASTIC)
    zero = jnp.zeros(())
    theta_ddot, u_ddot = model.acceleration(
        c, zero, jnp.asarray(1.3), (zero, jnp.asarray(0.02)), (zero, jnp.asarray(0.1))
    )
    w, z = 2 * np.pi / 0.6, 0.07
    assert float(theta_ddot) == 0
    assert float(u_ddot) == pytest.approx(-1.3 - 2 * z * w * 0.1 - w**2 * 0.02)


def test_impact_and_uplift_maps():
    c = coefficients(ELASTIC)
    assert float(model.impact(c, jnp.asarray(-0.4))) == pytest.approx(
        -0.4 * float(ELASTIC.restitution_factor)
    )
    stocky = coefficients(rj.Podium(alpha=1.2, R=1.0))
    assert float(stocky.restitution) < 0
    assert float(model.impact(stocky, jnp.asarray(-0.4))) == 0
    up = c.uplift
    assert float(contact_mode(c, up)) == 0
    assert float(contact_mode(c, up * (1 + 1e-12))) == -1
    assert float(contact_mode(c, -up * (1 + 1e-12))) == 1


def test_impact_keeps_angular_momentum():
    """The compatible law conserves angular momentum about the new pivots, with a constant horizontal velocity
    of the top mass."""
    podium = ELASTIC.replace(restitution="compatible")
    a, eta, gamma, lam = 0.25, 8.0, 3.0, 0.29
    before = -0.7
    after = float(podium.restitution_factor) * before
    # Closed form of the balance: (1+λ+4γ+4η sin²α) θ̇⁺ = (λ+cos 2α + 4γ cos 2α − 4η sin²α) θ̇⁻
    s2 = np.sin(a) ** 2
    left = (1 + lam + 4 * gamma + 4 * eta * s2) * after
    right = (lam + 1 - 2 * s2 + 4 * gamma * (1 - 2 * s2) - 4 * eta * s2) * before
    assert left == pytest.approx(right, rel=1e-12)


@pytest.mark.parametrize("name", PODIUMS)
def test_coefficients_by_hand(name):
    """Coefficients of the equations from masses and heights: columns have the total mass 1, the beam γ, the
    top η."""
    podium = PODIUMS[name]
    c = coefficients(podium)
    R, g, alpha, lam = (float(getattr(podium, k)) for k in ("R", "g", "alpha", "lam"))
    gamma, eta = float(podium.gamma), float(podium.eta)
    top = podium.superstructure
    moving = eta if isinstance(top, rj.Elastic) else 0.0
    beam = gamma + eta - moving  # a rigid superstructure is part of the beam
    spin = (1 + lam) * R**2 + beam * (2 * R) ** 2
    weight = g * (R * 1 + 2 * R * (beam + moving))  # columns rise by half as much as the beam
    pushed = R * 1 + 2 * R * beam  # by the ground acceleration; the top mass acts only through its spring
    per = 0.75 / R**2  # unit of Eq. (24)
    expected = {
        "spin": spin,
        "weight": weight,
        "inertia": per * spin,
        "gravity": per * weight,
        "ground": per * pushed,
        "centrifugal": per * (2 * R) ** 2 * moving,
        "two_R": 2 * R,
        "g": g,
        "eta": moving,
        "alpha": alpha,
        "sin_alpha": np.sin(alpha),
        "cos_alpha": np.cos(alpha),
        "p": np.sqrt(3 * g / (4 * R)),
        "impulse_factor": np.sqrt(pushed**2 / (2 * spin) + moving / 2),
        "restitution": float(podium.restitution_factor),
        "uplift": g * np.tan(alpha) * (0.5 + beam + moving) / (0.5 + beam),
    }
    if moving:
        w = 2 * np.pi / float(top.T_s)
        expected |= {"omega2": w**2, "damping": 2 * float(top.zeta) * w, "demand": eta / (gamma + 0.5)}
        expected |= {"coupling": per * 2 * R * eta, "uplifted_frequency": float(podium.uplifted_frequency)}
    found = c._asdict() | ({} if c.vibration is None else c.vibration._asdict())
    found = {field: value for field, value in found.items() if isinstance(value, ARRAYS)}
    assert set(expected) == set(found)
    for field, value in expected.items():
        assert float(found[field]) == pytest.approx(value, rel=1e-12), field


@pytest.mark.parametrize("sigma", [1.0, -1.0])
def test_beam_and_shear_from_the_geometry(sigma):
    """Eqs. (12)–(14) by time derivatives of the geometry; the shear from spring and damper, and from
    inertia."""
    R, alpha = 1.7, 0.25
    theta = lambda t: sigma * (0.1 + 0.3 * t - 0.7 * t**2)
    psi = lambda t: sigma * alpha - theta(t)
    u_b = lambda t: 2 * R * (sigma * jnp.sin(alpha) - jnp.sin(psi(t)))
    rate, second = jax.grad(u_b), jax.grad(jax.grad(u_b))
    x, v, a = theta(0.2), jax.grad(theta)(0.2), jax.grad(jax.grad(theta))(0.2)
    s = jnp.asarray(sigma)
    for podium in (ELASTIC, ELASTIC.replace(superstructure=rj.Rigid(8.0))):
        c = coefficients(podium)
        np.testing.assert_allclose(model.beam(c, s, x, v), [u_b(0.2), rate(0.2)], rtol=1e-12)
        assert float(model.beam_acceleration(c, s, x, v, a)) == pytest.approx(float(second(0.2)), rel=1e-12)
        if not c.vibration:
            expected = -(float(second(0.2)) + 1.3) / G
            assert float(model.shear(c, s, jnp.asarray(1.3), (x,), (v,), (a,))) == pytest.approx(
                expected, rel=1e-12
            )
    c = coefficients(ELASTIC)
    w, z = 2 * np.pi / 0.6, 0.07
    u, u_dot, ground = jnp.asarray(0.11), jnp.asarray(-0.4), jnp.asarray(1.3)
    acc = model.acceleration(c, s, ground, (x, u), (v, u_dot))
    spring = w**2 * (0.11 - float(u_b(0.2))) + 2 * z * w * (-0.4 - float(rate(0.2)))
    assert float(model.shear(c, s, ground, (x, u), (v, u_dot), acc)) == pytest.approx(spring / G, rel=1e-12)


@pytest.mark.parametrize("name", ["frame", "rigid", "elastic"])
@pytest.mark.parametrize("sigma", [1.0, -1.0])
def test_power_and_moment_by_hand(name, sigma):
    """The power of ground and damper is the rate of the energy; the restoring moment is that of the vertical
    forces."""
    podium = PODIUMS[name]
    c = coefficients(podium)
    n, s = (2 if c.vibration else 1), jnp.asarray(sigma)
    R, alpha, g = (float(y) for y in (podium.R, podium.alpha, podium.g))
    heavy = float(podium.gamma + podium.eta)  # beam and top mass, which rise equally

    @jax.jit
    def evaluated(x, v, ground):
        a = model.acceleration(c, s, ground, x, v)
        _, rate = jax.jvp(lambda x, v: energy(c, s, x, v), (x, v), (v, a))
        return a[0], rate, *power(c, s, ground, x, v), restoring_moment(c, s, ground, x, v)

    for state in STATES[:6]:
        theta = sigma * abs(state[0])
        x, v = (
            (jnp.asarray(theta), jnp.asarray(state[2]))[:n],
            (jnp.asarray(state[1]), jnp.asarray(state[3]))[:n],
        )
        acceleration, rate, given, taken, moment = (float(y) for y in evaluated(x, v, jnp.asarray(state[4])))
        psi, omega = sigma * alpha - theta, float(v[0])
        u_b_dot = 2 * R * omega * np.cos(psi)
        top = float(podium.eta) * (float(v[1]) if c.vibration else u_b_dot)
        assert given == pytest.approx(-state[4] * ((0.5 + float(podium.gamma)) * u_b_dot + top), rel=1e-12)
        if c.vibration:
            damper = 2 * float(podium.superstructure.zeta * podium.superstructure.omega_s * podium.eta)
            assert taken == pytest.approx(damper * (float(v[1]) - u_b_dot) ** 2, rel=1e-12)
        else:
            assert taken == 0
        assert rate == pytest.approx(given - taken, rel=1e-9, abs=1e-10)
        rises = 2 * R * (acceleration * np.sin(psi) - omega**2 * np.cos(psi))
        # The beam rises twice as much as the columns.
        arm, at_uplift = np.sin(psi), np.sin(alpha) * g * (2 * heavy + 1)
        assert moment == pytest.approx(
            arm * (2 * heavy * (g + rises) + g + 0.5 * rises) / at_uplift, rel=1e-11
        )
    zero = jnp.zeros(())
    q = 0.4 * float(c.uplift)
    down = restoring_moment(c, zero, jnp.asarray(q), (zero,) * n, (zero,) * n)
    assert float(down) == pytest.approx(-0.4, rel=1e-12)


@pytest.mark.parametrize("name", PODIUMS)
def test_potential_is_the_work_against_gravity(name):
    podium = PODIUMS[name]
    c = coefficients(podium)
    n = 2 if c.vibration else 1
    for sigma, theta in ((1.0, 0.04), (-1.0, -0.11), (1.0, 0.3)):
        s, angle = jnp.asarray(sigma), jnp.asarray(theta)
        u_b, _ = model.beam(c, s, angle, jnp.zeros(()))
        still = energy(c, s, (angle, u_b)[:n], (jnp.zeros(()),) * n)
        assert float(potential(c, s, angle)) == pytest.approx(float(still), rel=1e-12)
        lift = (
            2 * float(podium.R) * (np.cos(sigma * float(podium.alpha) - theta) - np.cos(float(podium.alpha)))
        )
        total = 0.5 + float(podium.gamma) + float(podium.eta)
        assert float(still) == pytest.approx(float(podium.g) * total * lift, rel=1e-12)
    zero = jnp.zeros(())
    assert float(potential(c, zero, zero)) == 0
    assert float(energy(c, zero, (zero,) * n, (zero,) * n)) == 0
    now, impulse = jnp.asarray(0.3), jnp.asarray(0.7)
    most = (np.sqrt(0.3) + float(c.impulse_factor) * 0.7) ** 2
    assert float(energy_after(c, now, impulse)) == pytest.approx(most, rel=1e-12)
    assert float(energy_after(c, -now, impulse)) == pytest.approx(
        (float(c.impulse_factor) * 0.7) ** 2, rel=1e-12
    )


@pytest.mark.parametrize("name", ["rigid", "elastic"])
def test_arrows_of_the_automaton(name):
    """After an impact the columns rock to the other side; below the rest velocity they come to rest, or lift
    again under the demand."""
    podium = PODIUMS[name]
    scene, _ = prepared(podium)
    e, rest, up = float(podium.restitution_factor), float(scene.rest_speed), float(scene.c.uplift)
    assert rest == pytest.approx(1e-8 * float(podium.p * podium.alpha))
    fast, slow = 3 * rest / e, 0.5 * rest / e
    for side in (1.0, -1.0):
        for q, mode in ((0.0, 0.0), (1.1 * up, -1.0), (-1.1 * up, 1.0)):
            after = lambda speed, q=q, side=side: [
                float(y)
                for y in after_impact(scene, jnp.asarray(side), jnp.asarray(-side * speed), jnp.asarray(q))
            ]
            assert after(fast) == [pytest.approx(-side * 3 * rest), -side]
            assert after(slow) == [0.0, mode]


def test_default_end():
    block, stiff, soft = (
        PODIUMS["block"],
        PODIUMS["elastic"],
        PODIUMS["elastic"].replace(superstructure=rj.Elastic(1.0, 9.0)),
    )
    assert float(default_end(block, rj.OneSine(1.0, 0.7))) == pytest.approx(0.7 + 30 / float(block.p))
    assert float(default_end(stiff, rj.OneSine(1.0, 0.7))) == pytest.approx(0.7 + 30 / float(stiff.p))
    assert float(default_end(soft, rj.OneSine(1.0, 0.7))) == pytest.approx(0.7 + 90)


def prepared(podium):
    options = rj.Options()
    plan = plan_for(podium, options, False)
    zero = jnp.zeros(())
    return prepare(
        podium,
        rj.OneSine(jnp.asarray(4.0), jnp.asarray(0.8)),
        rj.State(zero, zero, zero, zero),
        None,
        options,
        plan,
    )


def test_guard_breaks_where_the_mode_ends():
    """The clearance of the guard is zero on the ground, at the overturning angle, and at the threshold of Eq.
    (9)."""
    scene, _ = prepared(PODIUMS["elastic"])
    overturn_angle, up = float(scene.overturn_angle), float(scene.c.uplift)
    zero = jnp.zeros(())
    path = lambda value, slope: hermite.Quintic(*(jnp.asarray(y) for y in (value, slope, 0.3, 0.0, 0.0, 0.0)))
    yes, no = jnp.asarray(True), jnp.asarray(False)
    for rocking, falling, value, slope, left in (
        (yes, yes, 0.02, -0.1, 0.02),
        (yes, no, 0.7 * overturn_angle, 0.1, 0.3 * overturn_angle),
        (no, no, 0.6 * up, 0.5, 0.4 * up),
        (no, no, -0.6 * up, -0.5, 0.4 * up),
    ):
        clearance = guard._clearance(scene, rocking, path(value, slope), jnp.asarray(value), falling)
        assert float(clearance.value(zero)) == pytest.approx(left)
        assert float(clearance.slope(zero)) == pytest.approx(-abs(slope))


@pytest.mark.parametrize("sigma", [0.0, 1.0, -1.0])
def test_guard_follows_the_motion(sigma):
    """The guard is σθ while rocking and the demand in full contact. Value, slope and curvature at both ends
    follow from derivatives of Eq. (9) along Eq. (4)."""
    scene, lane = prepared(PODIUMS["elastic"])
    plan = plan_for(PODIUMS["elastic"], rj.Options(), False)
    c, s = scene.c, jnp.asarray(sigma)
    ground = lambda t: 2.0 * jnp.sin(3.0 * t)
    h = jnp.asarray(0.05)

    def state(t):  # both ends lie on the smooth motion u_t = 0.02 sin 5t, under the ground motion of Eq. (4)
        angle = sigma * (0.03 + 0.2 * t) * jnp.ones(())
        return (angle, 0.02 * jnp.sin(5 * t)), (sigma * 0.2 * jnp.ones(()), 0.1 * jnp.cos(5 * t))

    t0 = lane.t
    (x0, v0), (x1, v1) = state(t0), state(t0 + h)
    a0, a1 = (model.acceleration(c, s, ground(t), x, v) for t, x, v in ((t0, x0, v0), (t0 + h, x1, v1)))
    lane = lane._replace(sigma=s, x=x0, v=v0)
    path, at_end = guard._paths(scene, plan, lane, ground, h, a0, Step(x1, v1, a1, x1, v1))
    for t, x, v, a, z in ((t0, x0, v0, a0, 0.0), (t0 + h, x1, v1, a1, 1.0)):
        if sigma:
            expected = sigma * float(x[0]), sigma * float(v[0]), sigma * float(a[0])
        else:
            g, g1, g2 = 2 * np.sin(3 * float(t)), 6 * np.cos(3 * float(t)), -18 * np.sin(3 * float(t))
            k, w2, d = map(float, c.vibration[1:4])
            u, r, b = float(x[1]), float(v[1]), float(a[1])
            jerk = -g1 - d * b - w2 * r
            expected = g - k * (w2 * u + d * r), g1 - k * (w2 * r + d * b), g2 - k * (w2 * b + d * jerk)
        found = (
            float(path.value(z)),
            float(path.slope(z)) / float(h),
            float(path.curvature(z)) / float(h) ** 2,
        )
        np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose([at_end.c0, at_end.c1, 2 * at_end.c2], expected, rtol=1e-12)


def test_a_step_has_both_polynomials_of_a_quantity():
    """A step returns the cubic and the quartic of the same quantity, whichever comes first."""
    scene, lane = prepared(PODIUMS["rigid"])
    zero = jnp.zeros(())
    trial = Step((zero + 0.04,), (zero + 0.2,), (zero,), (zero + 0.04,), (zero + 0.2,))
    attempt = types.SimpleNamespace(h=zero + 0.05, a0=(zero,), end=trial)
    lane = lane._replace(sigma=zero + 1, x=(zero + 0.03,), v=(zero + 0.2,))
    step = views.Step(scene, False, lane, jnp.zeros_like, attempt, None, zero, zero)
    quantity = lambda moment: (moment.x[0] ** 4,)
    paths = [step.courses(quantity, through_middle)[0].path for through_middle in (False, True, False)]
    assert [type(path) for path in paths] == [Cubic, Quartic, Cubic]
