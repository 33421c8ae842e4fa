"""What a program depends on besides its arguments: where they are, and JAX's settings."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Hashable
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

ARRAYS = np.ndarray | np.generic | jax.Array  # tracers are instances, too


@functools.cache
def device() -> Any:
    return jax.local_devices(backend="cpu")[0]


@functools.cache
def _sharding() -> jax.sharding.Sharding:
    return jax.sharding.SingleDeviceSharding(device())


def types_here(leaves: list[Any]) -> tuple[Hashable, ...] | None:
    """What a program is compiled for of numbers and arrays, where arrays of NumPy and of JAX are the same;
    None unless all are known, and on the CPU that programs are kept for."""
    here, found = _sharding(), []
    for leaf in leaves:
        if type(leaf) is np.ndarray or isinstance(leaf, np.generic):
            found.append((leaf.shape, leaf.dtype, False))
        elif isinstance(leaf, Tracer):
            return None
        elif isinstance(leaf, ARRAYS):
            if isinstance(leaf, jax.Array) and leaf.sharding != here:
                return None
            found.append((leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)))
        else:
            found.append(type(leaf))
    return tuple(found)


def usual() -> bool:
    """Whether programs run as usual: on one CPU, and not looked into by one of JAX's settings for
    debugging."""
    settings: Any = jax.config
    chosen = settings.jax_default_device
    if jax.default_backend() != "cpu" or not (chosen is None or chosen == "cpu" or chosen == device()):
        return False
    unusual = (
        settings.jax_disable_jit,
        settings.jax_debug_nans,
        settings.jax_debug_infs,
        settings.jax_check_tracer_leaks,
    )
    return not any(unusual) and jax.process_count() == 1


_AS_IT_IS = contextlib.nullcontext()


def nans_allowed() -> contextlib.AbstractContextManager[Any]:
    """A context without JAX's search for NaN and inf: in answers they stand for "none" and "not wanted"."""
    settings: Any = jax.config
    if not (settings.jax_debug_nans or settings.jax_debug_infs):
        return _AS_IT_IS
    found = contextlib.ExitStack()
    found.enter_context(jax.debug_nans(False))
    found.enter_context(jax.debug_infs(False))
    return found


def present_settings() -> tuple[Any, ...]:
    """Settings that a program is traced under and that may change within a process."""
    settings: Any = jax.config
    return (
        settings.jax_enable_x64,
        settings.jax_default_matmul_precision,
        settings.jax_numpy_dtype_promotion,
        settings.jax_numpy_rank_promotion,
    )
