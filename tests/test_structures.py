import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._engine.coefficients import coefficients
from rockjax._engine.model import acceleration

from .scenes import PODIUMS, G


def test_parameters_of_the_paper():
    podium = PODIUMS["elastic"]
    assert float(podium.p) == pytest.approx(2.2143, abs=1e-4)
    assert float(podium.uplift_demand) == pytest.approx(G * 0.15 * 221 / 21, rel=1e-13)
    assert float(podium.restitution_factor) == pytest.approx(
        1 - 0.0225 / 1.0225 * 220.5 / (110 + 1 / 3), rel=1e-13
    )
    assert float(PODIUMS["rigid"].uplift_demand) == pytest.approx(G * 0.15, rel=1e-13)
    assert float(podium.uplift_acceleration) == float(podium.uplift_demand)
    assert float(podium.uplift_ground_acceleration) == pytest.approx(G * 0.15, rel=1e-13)


def test_from_dimensions():
    podium = rj.Podium.from_dimensions(
        width=0.45, height=3.0, column_mass=1000.0, beam_mass=30e3, columns=3, top_mass=6000.0, period=0.4
    )
    assert float(podium.alpha) == pytest.approx(math.atan(0.15))
    assert float(podium.R) == pytest.approx(math.hypot(0.45, 3.0) / 2)
    assert float(podium.gamma) == pytest.approx(10.0)
    assert isinstance(podium.superstructure, rj.Elastic)
    assert float(podium.eta) == pytest.approx(2.0)
    assert float(podium.width) == pytest.approx(0.45)
    assert float(podium.height) == pytest.approx(3.0)
    assert isinstance(rj.Podium.from_dimensions(0.4, 3.0, 1000.0, top_mass=50.0).superstructure, rj.Rigid)
    assert rj.Podium.from_dimensions(0.4, 3.0, 1000.0).superstructure is None


def test_heights_of_equal_stories_may_differ():
    arguments = 0.5, 3.0, 1500.0, 9e3, 4, 60e3, 0.5
    make = lambda heights: rj.Podium.from_dimensions(*arguments, stories=3, story_heights=heights)
    uniform, different = make(3.0).superstructure, make([4.0, 3.0, 3.0]).superstructure
    np.testing.assert_array_equal(uniform.heights, [3.0, 3.0, 3.0])
    np.testing.assert_array_equal(different.heights, [4.0, 3.0, 3.0])
    np.testing.assert_array_equal(different.stiffnesses, uniform.stiffnesses)
    with pytest.raises(ValueError, match="heights"):
        make([4.0, 3.0])


@pytest.mark.parametrize("columns", [2.5, 0, -1, np.nan, True, "2"])
def test_the_number_of_columns_is_whole(columns):
    with pytest.raises(ValueError, match=r"Podium.from_dimensions: columns must be a whole number >= 1, got"):
        rj.Podium.from_dimensions(0.4, 3.0, 1000.0, columns=columns)


def test_restitution_laws():
    block = rj.Podium(alpha=0.3, R=1.0)
    assert float(block.restitution_factor) == pytest.approx(1 - 1.5 * math.sin(0.3) ** 2)  # Housner
    frame = rj.Podium(alpha=0.3, R=1.0, gamma=4.0)
    # Makris & Vassiliou: an array of columns under a beam
    assert float(frame.restitution_factor) == pytest.approx(
        (1 - 1.5 * math.sin(0.3) ** 2 + 12 * math.cos(0.6)) / 13
    )
    # Both laws agree without a superstructure, and for a rigid one, which is part of the beam.
    for podium in (block, frame, PODIUMS["rigid"]):
        compatible = dataclasses.replace(podium, restitution="compatible")
        assert float(compatible.restitution_factor) == pytest.approx(
            float(podium.restitution_factor), rel=1e-13
        )
    elastic = dataclasses.replace(PODIUMS["elastic"], restitution="compatible")
    assert 0.60 < float(elastic.restitution_factor) < 0.63
    assert float(dataclasses.replace(block, restitution=0.9).restitution_factor) == 0.9


@pytest.mark.parametrize("eta", [1.0, 100.0])
def test_uplifted_frequency_is_an_eigenvalue_of_the_linearised_equations(eta):
    """Eqs. (29)–(31), from the equations of motion themselves."""
    podium = PODIUMS["elastic"].replace(superstructure=rj.Elastic(eta, 0.5, 0.0))
    c = coefficients(podium)
    one, zero = jnp.ones(()), jnp.zeros(())

    def a(x):
        return jnp.stack(acceleration(c, one, zero, (x[0], x[1]), (zero, zero)))

    # The paper neglects gravity and the θ in ψ, so the only stiffness is that of the spring.
    with_spring = -jax.jacfwd(a)(jnp.zeros(2))
    assert c.vibration
    c0 = c._replace(vibration=c.vibration._replace(omega2=zero, damping=zero))
    without = -jax.jacfwd(lambda x: jnp.stack(acceleration(c0, one, zero, (x[0], x[1]), (zero, zero))))(
        jnp.zeros(2)
    )
    frequencies = np.sort(np.linalg.eigvals(np.asarray(with_spring - without)).real)
    assert frequencies[0] == pytest.approx(0.0, abs=1e-9 * frequencies[1])
    assert frequencies[1] == pytest.approx(float(podium.uplifted_frequency) ** 2, rel=1e-10)


def test_uplifted_frequency_of_equal_roots():
    """A massless superstructure whose frequency is that of rocking due to the tendons, ω_s² = 4p²κ sin²α/J
    with J = 3γ + ¾(1 + λ) = 31; rounding of the difference of equal numbers is no error."""
    kappa = np.random.default_rng(0).uniform(10.0, 1000.0, 100)
    p2 = 0.75 * 9.80665 / 1.5
    omega = np.sqrt(4 * p2 * kappa * math.sin(0.15) ** 2 / 31)
    top = rj.Elastic(np.zeros(100), 2 * math.pi / omega, 0.05)
    podium = rj.Podium(0.15, 1.5, 10.0, top, lam=1 / 3, restrainers=(rj.Tendon(0.0, kappa),))
    np.testing.assert_allclose(podium.uplifted_frequency, omega, rtol=1e-6)


def test_uplifted_frequency_limit():
    heavy = PODIUMS["elastic"].replace(superstructure=rj.Elastic(1e12, 0.5))
    ratio = float(heavy.uplifted_frequency) / (2 * math.pi / 0.5)
    assert ratio == pytest.approx(1 / math.sin(float(heavy.alpha)), rel=1e-6)
    with pytest.raises(ValueError, match="Elastic"):
        _ = PODIUMS["rigid"].uplifted_frequency


def test_equivalent_block():
    block = PODIUMS["rigid"].equivalent_block()
    assert float(block.p) == pytest.approx(float(PODIUMS["rigid"].p) * math.sqrt(221 / 331))
    assert block.superstructure is None
    assert float(block.gamma) == 0
    with pytest.raises(ValueError, match="no equivalent block"):
        PODIUMS["elastic"].equivalent_block()


def test_structures_are_pytrees_of_arrays():
    leaves = jax.tree.leaves(PODIUMS["elastic"])
    assert len(leaves) == 8
    assert all(isinstance(y, jax.Array | np.ndarray) and y.dtype == jnp.float64 for y in leaves)
    doubled = jax.tree.map(lambda y: 2 * y, PODIUMS["elastic"])
    assert float(doubled.alpha) == 2 * float(PODIUMS["elastic"].alpha)
