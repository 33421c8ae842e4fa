"""Values computed in threads."""

import threading

import jax
import jax.numpy as jnp
import pytest

from rockjax._machine.threads import cores, map_in_threads


def test_values_are_in_order_and_have_the_precision_of_the_caller():
    assert map_in_threads(lambda y: y * y, range(50)) == [y * y for y in range(50)]
    assert map_in_threads(str, []) == []
    names = set(map_in_threads(lambda y: threading.current_thread().name, range(50)))
    assert 1 <= len(names) <= cores()
    assert {y.dtype for y in map_in_threads(lambda y: jnp.ones(3) * y, range(4))} == {jnp.ones(3).dtype}
    with jax.enable_x64(False):
        assert {y.dtype for y in map_in_threads(lambda y: jnp.ones(3) * y, range(4))} == {
            jnp.dtype("float32")
        }


def test_an_exception_leaves_out_the_rest():
    computed = []

    def fail(y):
        if y == 3:
            raise RuntimeError("no value")
        computed.append(y)
        threading.Event().wait(0.01)

    with pytest.raises(RuntimeError, match="no value"):
        map_in_threads(fail, range(1000))
    assert len(computed) < 1000
