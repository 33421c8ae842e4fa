"""What small batches save: arrays that cross into programs together, threads that are kept, plain methods."""

import contextlib
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._batch.packed import Packed, on_host, packed
from rockjax._machine.threads import borrowed_pool
from rockjax._module import filled
from tests.scenes import PODIUMS

TREE = {
    "x": np.arange(6.0).reshape(2, 3),
    "k": np.array(7),
    "flags": (np.array([True, False]), None),
    "y": np.array(2.5),
    "n": np.zeros((0, 4), int),
}


def assert_same(a, b):
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert x.dtype == y.dtype
        assert x.shape == y.shape
        np.testing.assert_array_equal(x, y)


def test_a_packed_tree_is_an_array_for_each_type_and_comes_back_whole():
    few = packed(TREE)
    assert sorted(str(y.dtype) for y in few.arrays) == ["bool", "float64", "int64"]
    assert len(jax.tree.leaves(few)) == 3
    assert_same(few.tree(), TREE)
    assert on_host(few) is few.tree()
    assert_same(on_host(jax.tree.map(jnp.asarray, TREE)), TREE)


def test_packed_trees_cross_into_programs_and_out_of_them():
    @jax.jit
    def double(few: Packed) -> Packed:
        return packed(jax.tree.map(lambda y: y if y.dtype == bool else 2 * y, few.tree()))

    doubled = double(packed(TREE))
    assert isinstance(doubled, Packed)
    assert all(isinstance(y, jax.Array) for y in doubled.arrays)
    assert_same(doubled.tree(), jax.tree.map(lambda y: y if y.dtype == bool else 2 * y, TREE))


def test_the_threads_of_a_pool_are_those_of_the_next():
    at_once = threading.Barrier(2)

    def name() -> str:
        at_once.wait(10)
        return threading.current_thread().name

    def names() -> set[str]:
        with borrowed_pool(2) as pool:
            return {future.result() for future in [pool.submit(name) for _ in range(2)]}

    first = names()
    assert len(first) == 2
    assert names() == names() == first


def test_a_pool_is_left_when_all_is_done_and_lent_to_one_at_a_time():
    ended, go_on = [], threading.Event()
    with contextlib.suppress(KeyboardInterrupt), borrowed_pool(2) as pool:
        pool.submit(lambda: (go_on.wait(10), ended.append(1)))
        with borrowed_pool(2) as other:
            assert other is not pool
            assert other.submit(int).result() == 0
        threading.Timer(0.05, go_on.set).start()
        raise KeyboardInterrupt
    assert ended == [1]
    with borrowed_pool(2) as again:
        assert again.submit(int).result() == 0


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
    from rockjax._programs.kept import COUNTS

    of = lambda n: rj.peak_responses(PODIUMS[name], rj.Ricker(np.linspace(2.0, 6.0, n), 1.0), threads=1)
    many = of(200)
    before = COUNTS["compiled"] + COUNTS["loaded"]
    for n in (1, 7, 64):
        assert np.all(np.isfinite(of(n).peak_rotation))
    assert COUNTS["compiled"] + COUNTS["loaded"] == before
    few = rj.peak_responses(PODIUMS[name], rj.Ricker(np.linspace(2.0, 6.0, 200)[:9], 1.0), threads=1)
    np.testing.assert_allclose(few.peak_rotation, many.peak_rotation[:9], rtol=1e-7)
