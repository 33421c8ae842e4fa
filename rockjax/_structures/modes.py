"""A superstructure of several modes: oscillators in parallel on the beam.

A row is an array with one value for each mode, story or column along its last axis. Equations with a C are in
docs/modes.md.
"""

from __future__ import annotations

from typing import Any, ClassVar, Self, cast

import jax.numpy as jnp
import numpy as np

from rockjax._checks import array_module, as_float, concrete, require, require_not_negative
from rockjax._types import Array, Number

from .superstructures import AbstractSuperstructure, Elastic, Oscillators

ROUNDING = 1e-9  # if the modal masses exceed the total mass by less than this fraction, this is rounding

# In structures that `split_rows` returns, a row is a tuple of its elements instead of an array.
Row = Array


def as_row(owner: str, name: str, values, what: str) -> Array:
    """Return a row, with one value for each mode, story or column (`what`) along the last axis, as an array
    of floats. Raises `ValueError` for a scalar, for an empty axis, and for values that are not numbers."""
    array = as_float(values, f"{owner}: {name}")
    if array.ndim == 0 or array.shape[-1] == 0:
        raise ValueError(
            f"{owner}: {name} must be an array with a number for each {what} along its last axis, got "
            f"{'one number' if array.ndim == 0 else 'none'}"
        )
    return array


def split_row(values: Row | tuple[Number, ...]) -> tuple[Number, ...]:
    """Return the elements of a row. Each is a scalar, or an array over a batch of podiums."""
    if isinstance(values, tuple):
        return values
    values = stack_row(values)
    return tuple(values[..., k] for k in range(values.shape[-1]))


def stack_row(values: Row | tuple[Number, ...]) -> Array:
    """Return a row as an array with its elements along the last axis. Values that are not traced use NumPy,
    because outside jit every jnp call compiles separately."""
    if isinstance(values, tuple):
        xp = array_module(values)
        return xp.stack(xp.broadcast_arrays(*values), axis=-1)
    host_values = concrete(values)
    return values if host_values is None else cast(Array, host_values.astype(values.dtype))


def repeat_scalar(values: Any, count: int) -> Any:
    """Return a row unchanged, or a scalar repeated `count` times."""
    return (values,) * count if not isinstance(values, tuple) and jnp.ndim(values) == 0 else values


def split_unless_scalar(values: Any) -> Any:
    """Return the elements of a row, or a scalar unchanged."""
    return values if not isinstance(values, tuple) and jnp.ndim(values) == 0 else split_row(values)


def is_concrete_zero(value) -> bool:
    """Return whether a value is zero and not traced."""
    number = concrete(value)
    return number is not None and not np.any(number)


class Modes(AbstractSuperstructure):
    """A superstructure of n modes: oscillators in parallel on the beam, (C9).

    - `eta`: mass ratios η_i of the modes, ≥ 0 [–], along the last axis: the modal masses divided by N m_c,
      the mass of all N columns. A mode with η_i = 0 responds to the beam but does not act on the beam
    - `T`: fixed-base periods T_i, > 0 [s]; they may be equal
    - `zeta`: damping ratios ζ_i, ≥ 0 [–]; one value for all modes, or one for each
    - `residual`: mass ratio η_r of the mass that belongs to no mode, ≥ 0 [–]. This mass moves with the beam;
      the answer `peak_shear` leaves out the impulses that act on it at impacts

    For one mode without `residual` use [`rockjax.Elastic`][], and for no mode `Rigid(residual)`. The last
    axis of the displacements in [`rockjax.State`][] and of `peak_deformation` is the axis of modes. Raises
    `ValueError` for unequal lengths and for values outside these ranges; traced values are not checked.
    """

    rows: ClassVar[tuple[str, ...]] = ("eta", "T", "zeta")

    eta: Row
    T: Row
    zeta: Row
    residual: Number  # `split_rows` replaces 0 by None

    def __init__(self, eta: Any, T: Any, zeta: Any = 0.05, residual: Any = 0.0):
        self.eta = as_row("Modes", "eta", eta, "mode")
        self.T = as_row("Modes", "T", T, "mode")
        self.zeta = as_float(zeta, "Modes: zeta")
        self.residual = as_float(residual, "Modes: residual")

    def __check_init__(self):
        count = len(split_row(self.eta))
        for name in ("T", "zeta"):
            values = getattr(self, name)
            if jnp.ndim(values) and values.shape[-1] != count:
                raise ValueError(
                    f"Modes: {name} must be as long as eta, which has {count} modes, got {values.shape[-1]}"
                )
        require_not_negative("Modes", eta=self.eta, zeta=self.zeta, residual=self.residual)
        require("Modes", "T", self.T, lambda v: v > 0, "finite and > 0")

    @classmethod
    def of_total(cls, mass_ratio, eta, T, zeta=0.05) -> Self:
        """Return modes of a superstructure with a given total mass. The mass that belongs to no mode becomes
        the `residual`.

        - `mass_ratio`: mass ratio m_t/(N m_c) of the whole superstructure [–]
        - `eta`, `T`, `zeta`: as for [`rockjax.Modes`][]

        Raises `ValueError` if the sum of `eta` exceeds `mass_ratio`, and for values that
        [`rockjax.Modes`][] rejects.
        """
        eta, total = (
            as_row("Modes.of_total", "eta", eta, "mode"),
            as_float(mass_ratio, "Modes.of_total: mass_ratio"),
        )
        remainder = total - jnp.sum(eta, axis=-1)
        host_remainder, host_total = concrete(remainder), concrete(total)
        if (
            host_remainder is not None
            and host_total is not None
            and np.any(host_remainder < -ROUNDING * np.abs(host_total))
        ):
            raise ValueError(
                "Modes.of_total: mass_ratio must be at least the sum of eta, "
                f"{float(np.max(np.sum(np.asarray(eta), axis=-1))):g}, got {float(np.min(host_total)):g}"
            )
        return cls(eta, T, zeta, residual=jnp.maximum(remainder, 0.0))

    @property
    def modes(self) -> Modes:
        return self

    @property
    def count(self) -> int:
        """The number n of modes."""
        return len(split_row(self.eta))

    @property
    def oscillators(self) -> Oscillators:
        return Oscillators(stack_row(self.eta), stack_row(self.T), stack_row(self.zeta))

    @property
    def carried(self) -> Number | None:
        return None if self.residual is None or is_concrete_zero(self.residual) else self.residual

    @property
    def mass_ratio(self) -> Number:
        vibrating_mass = self.oscillators.vibrating_mass
        return vibrating_mass if self.carried is None else vibrating_mass + self.carried

    @property
    def has_mode_axis(self) -> bool:
        return True

    @property
    def height_count(self) -> int:
        return self.count

    def first_moments(self, heights: Number, residual_height: Number) -> tuple[Number | None, Number | None]:
        modal_moments, carried = super().first_moments(heights, residual_height)
        # `resolved` converts a single mode without a residual to `Elastic`, whose moment has no mode axis.
        if modal_moments is not None and carried is None and self.count == 1:
            return modal_moments[..., 0], None
        return modal_moments, carried

    def split_rows(self) -> Self:
        values = {"eta": split_row(self.eta), "T": split_row(self.T), "zeta": split_unless_scalar(self.zeta)}
        values["residual"] = self.carried
        return with_fields(self, values)

    def resolved(self) -> AbstractSuperstructure:
        if self.count == 1 and self.carried is None:
            zeta = split_row(repeat_scalar(self.zeta, 1))
            return Elastic(*(y[0] for y in (split_row(self.eta), split_row(self.T), zeta)))
        modes = self.oscillators
        return Oscillators(modes.eta, modes.T_s, modes.zeta, self.carried)


def with_fields(structure, values):
    """Return a copy with some fields replaced. The new values are neither converted nor checked."""
    copy = object.__new__(type(structure))
    for name, value in (vars(structure) | values).items():
        object.__setattr__(copy, name, value)
    return copy
