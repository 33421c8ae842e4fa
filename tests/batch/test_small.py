"""What small batches save."""

import jax
import numpy as np
import pytest

import rockjax as rj
from rockjax._module import filled
from tests.scenes import PODIUMS


def test_methods_are_plain_ones_that_can_be_compiled():
    pulse = rj.Ricker(2.0, 1.0)
    assert pulse.scaled.__self__ is pulse
    scaled = jax.jit(pulse.scaled)(0.5)
    assert float(scaled.a_p) == 1.0
    spectrum = jax.vmap(pulse.scaled)(np.arange(3.0))
    np.testing.assert_array_equal(spectrum.a_p, [0.0, 2.0, 4.0])


def test_a_module_filled_is_one_that_was_made():
    fields = {
        "theta": np.array(0.1),
        "theta_dot": np.array(0.0),
        "u_t": np.array(0.0),
        "u_t_dot": np.array(0.0),
    }
    state = filled(rj.State, **fields)
    assert jax.tree.structure(state) == jax.tree.structure(rj.State(**fields))
    assert jax.tree.leaves(state) == jax.tree.leaves(fields)


@pytest.mark.parametrize("name", ["rigid", "elastic"])
def test_one_program_serves_batches_of_all_sizes(name):
    from rockjax._programs.program import COUNTS

    of = lambda n: rj.peak_responses(PODIUMS[name], rj.Ricker(np.linspace(2.0, 6.0, n), 1.0), threads=1)
    many = of(200)
    before = COUNTS["compiled"] + COUNTS["loaded"]
    for n in (1, 7, 64):
        assert np.all(np.isfinite(of(n).peak_rotation))
    assert COUNTS["compiled"] + COUNTS["loaded"] == before
    few = rj.peak_responses(PODIUMS[name], rj.Ricker(np.linspace(2.0, 6.0, 200)[:9], 1.0), threads=1)
    np.testing.assert_allclose(few.peak_rotation, many.peak_rotation[:9], rtol=1e-7)
