"""The equations against the Lagrangian they come from, differentiated by machine."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax import _model as model
from rockjax._scene import contact_mode

from .scenes import PODIUMS, G

ELASTIC = rj.Podium(alpha=0.25, R=1.7, gamma=3.0, superstructure=rj.Elastic(8.0, 0.6, 0.07), lam=0.29)
STATES = np.random.default_rng(0).normal(size=(20, 5)) * [0.1, 0.5, 0.2, 0.6, 3.0]


def lagrangian_parts(podium, sigma):
    """T and V of Eqs. (16)–(19) per N m_c, and the damping force of Eq. (20)."""
    c, top = podium, podium.superstructure
    w = 2 * jnp.pi / top.T_s

    def places(q):
        psi = sigma * c.alpha - q[0]
        u_b = 2 * c.R * (sigma * jnp.sin(c.alpha) - jnp.sin(psi))
        v_b = 2 * c.R * (jnp.cos(psi) - jnp.cos(c.alpha))
        return u_b, v_b

    def kinetic(q, rate):
        u_b_dot, v_b_dot = jax.jvp(places, (q,), (rate,))[1]
        beam = 0.5 * c.gamma * (u_b_dot**2 + v_b_dot**2)
        columns = 0.5 * (1 + c.lam) * c.R**2 * rate[0] ** 2
        return 0.5 * top.eta * (rate[1] ** 2 + v_b_dot**2) + beam + columns

    def potential(q, ground):
        u_b, v_b = places(q)
        gravity = c.g * (top.eta + c.gamma + 0.5) * v_b
        spring = 0.5 * top.eta * w**2 * (q[1] - u_b) ** 2
        return gravity + spring + ground * (top.eta * q[1] + (c.gamma + 0.5) * u_b)

    def damping(q, rate):
        """Generalised forces −2ζω_s η (u̇_t − u̇_b)·∂(u_t − u_b)/∂q."""
        stretch = lambda q: q[1] - places(q)[0]
        speed = jax.jvp(stretch, (q,), (rate,))[1]
        return -2 * top.zeta * w * top.eta * speed * jax.grad(stretch)(q)

    return kinetic, potential, damping


@pytest.mark.parametrize("sigma", [1.0, -1.0])
def test_equations_of_motion_are_those_of_lagrange(sigma):
    """Eqs. (10), (22), (24)."""
    kinetic, potential, damping = lagrangian_parts(ELASTIC, sigma)
    c = model.coefficients(ELASTIC)

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
    c = model.coefficients(ELASTIC)
    for state in STATES:
        q, rate = jnp.asarray([abs(state[0]), state[1]]), jnp.asarray(state[2:4])
        expected = kinetic(q, rate) + potential(q, 0.0)
        assert float(model.energy(c, jnp.ones(()), (q[0], q[1]), (rate[0], rate[1]))) == pytest.approx(float(expected))


@pytest.mark.parametrize("name", ["block", "frame", "rigid", "elastic"])
def test_energy_rate_and_its_bound(name):
    """dE/dt is the ground's power minus the damper's; the ground's share grows √E at most at the rate C|ü_g|."""
    podium = PODIUMS[name]
    c = model.coefficients(podium)
    n = 2 if c.elastic else 1

    @jax.jit
    def rates(state):
        x, v = (state[0], state[1])[:n], (state[2], state[3])[:n]
        a = model.acceleration(c, jnp.ones(()), state[4], x, v)
        E, rate = jax.jvp(lambda x, v: model.energy(c, jnp.ones(()), x, v), (x, v), (v, a))
        stretch = v[1] - model.beam(c, jnp.ones(()), x[0], v[0])[1] if c.elastic else jnp.zeros(())
        loss = c.eta * c.damping * stretch**2 if c.elastic else jnp.zeros(())
        return E, rate, loss

    for state in STATES:
        state = jnp.asarray(state).at[0].set(abs(state[0]) * 0.5)
        E, rate, loss = rates(state)
        growth = float(rate + loss) / (2 * np.sqrt(float(E)))
        assert growth <= float(c.impulse) * abs(float(state[4])) * (1 + 1e-12)
        still = rates(state.at[4].set(0.0))
        assert float(still[1]) == pytest.approx(-float(still[2]), rel=1e-9, abs=1e-9 * float(E))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_uplift_is_where_rocking_would_start(side):
    """Eq. (9) is Eq. (24) with θ = θ̇ = θ̈ = 0; Eq. (6) as printed counts the columns twice and does not give it."""
    c = model.coefficients(ELASTIC)
    u, u_dot = jnp.asarray(0.03), jnp.asarray(-0.2)
    zero = jnp.zeros(())
    force = c.omega2 * u + c.damping * u_dot
    ground = -side * c.uplift + c.demand * force
    assert float(model.uplift_demand(c, ground, (zero, u), (zero, u_dot))) == pytest.approx(-side * float(c.uplift))
    start = model.acceleration(c, jnp.asarray(side), ground, (zero, u), (zero, u_dot))
    assert abs(float(start[0])) < 1e-12
    gamma, eta, t = 3.0, 8.0, np.tan(0.25)
    # virtual work of Eq. (6), columns m_c = 1/2 each so that N m_c = 1, at u_t = 0
    corrected = G * t * (0.5 + gamma + eta) / (0.5 + gamma)
    printed = G * t * (0.5 + gamma + 0.5) / (0.5 + gamma)
    assert float(c.uplift) == pytest.approx(corrected, rel=1e-12)
    assert abs(float(c.uplift) - printed) > 1.0


def test_contact_is_equation_4():
    c = model.coefficients(ELASTIC)
    zero = jnp.zeros(())
    theta_ddot, u_ddot = model.acceleration(c, zero, jnp.asarray(1.3), (zero, jnp.asarray(0.02)), (zero, jnp.asarray(0.1)))
    w, z = 2 * np.pi / 0.6, 0.07
    assert float(theta_ddot) == 0
    assert float(u_ddot) == pytest.approx(-1.3 - 2 * z * w * 0.1 - w**2 * 0.02)


def test_impact_and_uplift_maps():
    c = model.coefficients(ELASTIC)
    assert float(model.impact(c, jnp.asarray(-0.4))) == pytest.approx(-0.4 * float(ELASTIC.restitution_factor))
    stocky = model.coefficients(rj.Podium(alpha=1.2, R=1.0))
    assert float(stocky.restitution) < 0
    assert float(model.impact(stocky, jnp.asarray(-0.4))) == 0
    up = c.uplift
    assert float(contact_mode(c, up)) == 0
    assert float(contact_mode(c, up * (1 + 1e-12))) == -1
    assert float(contact_mode(c, -up * (1 + 1e-12))) == 1


def test_impact_keeps_angular_momentum():
    """The compatible law: angular momentum about the new pivots, the top mass keeping its horizontal velocity."""
    podium = ELASTIC.replace(restitution="compatible")
    a, eta, gamma, lam = 0.25, 8.0, 3.0, 0.29
    before = -0.7
    after = float(podium.restitution_factor) * before
    # Closed form of the balance: (1+λ+4γ+4η sin²α) θ̇⁺ = (λ+cos 2α + 4γ cos 2α − 4η sin²α) θ̇⁻
    s2 = np.sin(a) ** 2
    left = (1 + lam + 4 * gamma + 4 * eta * s2) * after
    right = (lam + 1 - 2 * s2 + 4 * gamma * (1 - 2 * s2) - 4 * eta * s2) * before
    assert left == pytest.approx(right, rel=1e-12)
