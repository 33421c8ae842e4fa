"""Checks of arguments, and conversion of arguments to arrays.

Only concrete values are checked. Values that `jax.jit`, `jax.vmap` or `jax.grad` traces pass unchecked. If a
traced value is invalid, for example NaN, the `result` of the scene may show it, but most invalid values
remain unnoticed. Messages begin with the class or function (`owner`), or with the argument (`label`, `name`).
"""

import functools
from collections.abc import Callable, Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array


def float_type() -> np.dtype:
    """Return JAX's default floating-point type: float64, or float32 if `jax_enable_x64` is off."""
    return _FLOAT64 if jax.config.jax_enable_x64 else _FLOAT32  # pyright: ignore[reportAttributeAccessIssue]


_FLOAT64, _FLOAT32 = np.dtype(np.float64), np.dtype(np.float32)


def as_float(x, label: str = "the value") -> Array:
    """Return `x` as an array of the default floating-point type, see `float_type`.

    A Python or NumPy scalar becomes a read-only NumPy array, because the first JAX array of a process starts
    threads, and a process with threads must not be forked. Raises `ValueError` for anything but numbers, and
    for gaps (missing values). The message begins with `label`.
    """
    if isinstance(x, jax.Array) and x.dtype == float_type() and not x.weak_type:  # pyright: ignore[reportAttributeAccessIssue]
        return x
    if type(x) is np.ndarray and x.ndim == 0 and x.dtype == float_type() and not x.flags.writeable:
        return x  # pyright: ignore[reportReturnType]
    refuse_gaps(label, x)
    try:
        if x is None or isinstance(x, str | bytes) or _contains_string(x):
            raise TypeError
        if isinstance(x, np.ndarray | np.generic) and x.dtype.kind in "cmMSUV":
            raise TypeError
        is_plain = isinstance(x, float | int | np.ndarray | np.generic) or _is_python_numbers(x)
        if is_plain and np.asarray(x).dtype.kind in "fiub":
            array = np.array(x, float_type())
            if array.ndim:
                return as_array(array)
            array.flags.writeable = False
            return array  # pyright: ignore[reportReturnType]
        return jnp.asarray(x, dtype=float_type())
    except (TypeError, ValueError):
        raise ValueError(f"{label} must be a number or an array of numbers, got {format_value(x)}") from None


def as_numpy_unless_traced(x, label: str = "the value") -> Any:
    """Return `as_float(x)`, converted to a NumPy array unless `x` is traced. NumPy needs no compilation,
    whereas outside jit every jnp call compiles separately."""
    x = as_float(x, label)
    return x if isinstance(x, Tracer) else np.asarray(x)


def as_array(x) -> Array:
    """Return `x` as a JAX array, without compiling a program for the shape of `x`."""
    if isinstance(x, jax.Array):
        return x
    refuse_gaps("the value", x)
    return jax.device_put(np.array(x))


def refuse_gaps(name: str, x) -> None:
    """Raise `ValueError` if `x` has missing values. The message names the first gap.

    Missing values are masked values, None in a list or tuple, and elements of an array of objects that are
    not numbers, such as None and NA.
    """
    if isinstance(x, list | tuple):
        for y in x:
            if not isinstance(y, float | int):
                refuse_gaps(name, y)
    if isinstance(x, np.ma.MaskedArray):
        gaps = np.ma.getmaskarray(x)
    elif isinstance(x, np.ndarray) and x.dtype.kind == "O":
        gaps = np.array([not isinstance(y, float | int | np.number | Tracer | jax.Array) for y in x.ravel()])
    elif isinstance(x, list | tuple):
        gaps = np.array([y is None or y is np.ma.masked for y in x], bool)
    else:
        return
    if gaps.any():
        where = f"{_describe_first_run(gaps.ravel())} of {gaps.size}"
        raise ValueError(f"{name} has a gap: no number at {where}; {_CURE}")


_CURE = "cut the gap out or fill it"
# Absolute values that digitisers and libraries write for missing samples: 999, 999.9, 999.99, 9999, …; the
# limits of integers and of float32; and the fill values of SAC, SMC and netCDF files.
_SENTINELS = (
    *(10**k - 10**-d for k in range(3, 10) for d in range(3)),
    *(12345, 32768, 65535, 8388608, 2147483647, 2147483648),
    *(1e10, 1e20, 1e30, 1.7e38, 3.4028235e38, 9.969209968386869e36),
)


def refuse_sentinels(name: str, samples: np.ndarray) -> None:
    """Raise `ValueError` if samples contain a value that stands for missing samples, such as -999. The
    message names the longest gap.

    A value of `_SENTINELS`, with either sign, stands for missing samples in two cases:

    - The absolute value is more than three times the largest absolute value of all other samples.
    - The value fills at least three successive samples, and at a start or an end of a run of this value the
      samples jump by more than half of the absolute value.
    """
    sizes = np.abs(samples)
    if not sizes.size or sizes.max() < _SENTINELS[0] - 1:
        return
    for size in _SENTINELS:
        matches = np.abs(sizes - size) <= 1e-7 * size
        if not matches.any() or matches.all():
            continue
        starts, ends = np.flatnonzero(np.diff(matches, prepend=False, append=False)).reshape(-1, 2).T
        jumps = np.abs(np.diff(samples))[[*(starts[starts > 0] - 1), *(ends[ends < matches.size] - 1)]]
        has_runs = (ends - starts).max() >= 3 and jumps.max() > 0.5 * size
        if has_runs or 3 * sizes[~matches].max() < size:
            first = int(starts[(ends - starts).argmax()])  # of the longest run
            value = f"{samples[first]:.10g}, which stands for missing samples"
            matches[:first] = False
            raise ValueError(
                f"{name} has a gap: {value}, at {_describe_first_run(matches)} of {matches.size}; {_CURE}"
            )


def require_finite_samples(owner: str, samples: np.ndarray) -> None:
    """Raise `ValueError` if a sample is not finite, or has a value that stands for a missing sample (see
    `refuse_sentinels`). The message names the first such sample and its gap. Time is the last axis."""
    not_finite = ~np.isfinite(samples)
    if not_finite.any():
        index = tuple(np.argwhere(not_finite)[0])
        run = _describe_first_run(not_finite[index[:-1]])
        gap = f" ({run} of {samples.shape[-1]}: a gap?)" if not_finite.sum() > 1 else ""
        raise ValueError(
            f"{owner}: acceleration must be finite, got {samples[index]} at sample {int(index[-1])}{gap}"
        )
    if not samples.size or np.abs(samples).max() < _SENTINELS[0] - 1:
        return
    for row in samples.reshape(-1, samples.shape[-1]):
        refuse_sentinels(f"{owner}: acceleration", row)


def _describe_first_run(flags: np.ndarray) -> str:
    """Return the first run of True in words, such as "samples 3 to 7"."""
    first = int(flags.argmax())
    remaining = flags[first:]
    last = first + (int(np.argmin(remaining)) if not remaining.all() else remaining.size) - 1
    return f"sample {first}" if last == first else f"samples {first} to {last}"


def _is_python_numbers(x) -> bool:
    """Return whether `x` is a list or tuple, possibly nested, of Python numbers."""
    return isinstance(x, list | tuple) and all(isinstance(y, float | int) or _is_python_numbers(y) for y in x)


def _contains_string(x) -> bool:
    """Return whether `x` is a list or tuple, possibly nested, that contains a string."""
    return isinstance(x, list | tuple) and any(isinstance(y, str | bytes) or _contains_string(y) for y in x)


def as_number(name: str) -> Callable[..., Array]:
    """Return `as_float` as a converter of a field of a class. Its error messages begin with `name`."""
    return functools.partial(as_float, label=name)


def check_dtype(owner: str, name: str, tree) -> None:
    """Raise `ValueError` if a pytree contains floats whose type is not `float_type()`, because they were
    created under another setting of jax_enable_x64."""
    expected = float_type()
    for leaf in jax.tree.leaves(tree):
        if (
            isinstance(leaf, jax.Array | np.ndarray)
            and leaf.dtype != expected
            and jnp.issubdtype(leaf.dtype, jnp.floating)
        ):
            switch = "on" if expected == jnp.float64 else "off"
            raise ValueError(
                f"{owner}: numbers of "
                f"{name} are {leaf.dtype}, but jax_enable_x64 is {switch} here, so that all must be "
                f"{expected}; create {name} under the same setting"
            )


def as_axis(owner: str, name: str, values, ascending: bool = False) -> np.ndarray:
    """Return values along an axis as an array of shape (n,). Raises `ValueError` for another shape, for no
    values and, if `ascending`, for values that do not ascend."""
    axis = np.asarray(as_float(values, f"{owner}: {name}"))
    if axis.ndim != 1 or axis.size == 0:
        raise ValueError(f"{owner}: {name} must be a 1-D array with values, got shape {axis.shape}")
    if ascending and np.any(np.diff(axis) <= 0):
        raise ValueError(
            f"{owner}: {name} must be a 1-D array of ascending values, got {format_value(values)}"
        )
    return axis


def concrete(x) -> np.ndarray | None:
    """Return the value of `x` as a NumPy array; None if `x` is traced or not numeric, such as a placeholder
    in a pytree."""
    if isinstance(x, Tracer):
        return None
    try:
        return np.asarray(x, dtype=float)
    except (TypeError, ValueError):
        return None


def array_module(*values) -> Any:
    """Return `jax.numpy` if a value is traced, otherwise `numpy`, which needs no compilation."""
    return jnp if any(isinstance(y, Tracer) for y in jax.tree.leaves(values)) else np


def product(a, b) -> Any:
    """Return a·b, computed with NumPy unless a or b is traced."""
    return array_module(a, b).multiply(a, b)


def require(owner: str, name: str, x, ok: Callable[[np.ndarray], np.ndarray], accepted: str) -> None:
    """Raise `ValueError` unless every number in `x` is finite and accepted by `ok`. The message names the
    first rejected number.

    - `owner`, `name`: class or function, and its argument, for the message
    - `x`: number or array; traced values pass
    - `ok`: array ↦ array of booleans, True for accepted values
    - `accepted`: the accepted values in words
    """
    if isinstance(x, str | bytes):
        raise ValueError(f"{owner}: {name} must be {accepted}, got the string {name} = {x!r}")
    value = concrete(x)
    if value is None and any(isinstance(y, Tracer) for y in jax.tree.leaves(x)):
        return
    if value is None or isinstance(x, str | bytes):
        raise ValueError(f"{owner}: {name} must be {accepted}, got {format_value(x)}")
    is_accepted = np.isfinite(value) & ok(value)
    if not is_accepted.all():
        first_rejected = value if value.ndim == 0 else value[~is_accepted].ravel()[0]
        raise ValueError(f"{owner}: {name} must be {accepted}, got {name} = {float(first_rejected)!r}")


def require_number(owner: str, name: str, value, ok: Callable[[float], bool], accepted: str) -> float:
    """Return `value` as a float. Raises `ValueError` unless it is a single finite number that `ok` accepts.

    - `owner`, `name`: class or function, and its argument, for the message
    - `value`: the number
    - `ok`: number ↦ boolean, True for accepted values
    - `accepted`: the accepted values in words
    """
    try:
        number = float("nan") if isinstance(value, str | bytes) else float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not (np.isfinite(number) and ok(number)):
        raise ValueError(f"{owner}: {name} must be {accepted}, got {name} = {format_value(value)}")
    return number


def require_whole(owner: str, name: str, value, least: int) -> int:
    """Return `value` as an int. Raises `ValueError` unless it is a whole number ≥ `least`.

    - `owner`, `name`: class or function, and its argument, for the message
    - `value`: the number
    - `least`: the smallest accepted number
    """
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
        raise ValueError(
            f"{owner}: {name} must be a whole number >= {least}, got {name} = {format_value(value)}"
        )
    return int(value)


def as_strings(owner: str, name: str, values) -> tuple[str, ...]:
    """Return the elements of an iterable, such as a list of strings, as a tuple. Raises `ValueError` for
    a single string, and for a value that is not iterable."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise ValueError(f"{owner}: {name} must be a list of strings, got {format_value(values)}")
    return tuple(values)


def require_positive(owner: str, **arguments) -> None:
    """Raise `ValueError` unless all numbers are finite and > 0; traced values pass."""
    for name, x in arguments.items():
        require(owner, name, x, lambda v: v > 0, "finite and > 0")


def require_not_negative(owner: str, **arguments) -> None:
    """Raise `ValueError` unless all numbers are finite and ≥ 0; traced values pass."""
    for name, x in arguments.items():
        require(owner, name, x, lambda v: v >= 0, "finite and >= 0")


def require_finite(owner: str, **arguments) -> None:
    """Raise `ValueError` unless all numbers are finite; traced values pass."""
    for name, x in arguments.items():
        require(owner, name, x, np.isfinite, "finite")


def format_value(value) -> str:
    """Return the representation of a value for a message, or only its type if the representation is longer
    than a line of 80 characters."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    representation = repr(value)
    is_short = len(representation) <= 80 and "\n" not in representation
    return representation if is_short else f"a {type(value).__name__}"


def require_instance(owner: str, name: str, value, accepted_type: Any, type_in_words: str) -> None:
    """Raise `ValueError` unless `value` is an instance of `accepted_type`.

    - `owner`, `name`: class or function, and its argument, for the message
    - `value`: the value
    - `accepted_type`: a type or a union of types
    - `type_in_words`: the accepted type in words
    """
    if not isinstance(value, accepted_type):
        raise ValueError(f"{owner}: {name} must be {type_in_words}, got {format_value(value)}")
