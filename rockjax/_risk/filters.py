"""Additional filters of Gaussian ground motions, after the soil layer and the high-pass filter."""

from __future__ import annotations

from typing import Any, Self

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from rockjax._checks import as_float, require_finite, require_positive
from rockjax._tree import Module


class Filter(Module):
    """A second-order filter with the transfer function (b₂ s² + b₁ s + b₀)/(s² + a₁ s + a₀).

    s is the Laplace variable. The filter starts from rest. Filters in series form a filter of higher order.

    - `numerator`: (b₂, b₁, b₀), shape (3,) [–, 1/s, 1/s²]
    - `denominator`: (a₁, a₀), shape (2,), both > 0, so that the filter is stable [1/s, 1/s²]

    Motions are differentiable with respect to all coefficients. Raises `ValueError` for other shapes, for
    coefficients that are not finite, and for a denominator that is not > 0.
    """

    numerator: Float[Array, " 3"] = eqx.field(converter=as_float)
    denominator: Float[Array, " 2"] = eqx.field(converter=as_float)

    def __check_init__(self):
        for name, y, count in (("numerator", self.numerator, 3), ("denominator", self.denominator, 2)):
            if jnp.shape(y) != (count,):
                raise ValueError(
                    f"Filter: {name} must have shape ({count},), got an array of shape {jnp.shape(y)}"
                )
        require_finite("Filter", numerator=self.numerator)
        require_positive("Filter", denominator=self.denominator)

    @classmethod
    def high_pass(cls, omega: Any, zeta: Any = 0.6) -> Self:
        """Return the filter s²/(s² + 2ζω s + ω²), which removes frequencies far below ω.

        - `omega`: frequency ω, > 0 [rad/s]; `zeta`: damping ratio ζ, > 0 [–]
        """
        omega, zeta = _as_positive("high_pass", omega, zeta)
        return cls(jnp.array([1.0, 0.0, 0.0]), _denominator(omega, zeta))

    @classmethod
    def low_pass(cls, omega: Any, zeta: Any = 0.7) -> Self:
        """Return the filter ω²/(s² + 2ζω s + ω²), which removes frequencies far above ω.

        - `omega`: frequency ω, > 0 [rad/s]; `zeta`: damping ratio ζ, > 0 [–]
        """
        omega, zeta = _as_positive("low_pass", omega, zeta)
        return cls(jnp.array([0.0, 0.0, 1.0]) * omega**2, _denominator(omega, zeta))

    @classmethod
    def layer(cls, omega: Any, zeta: Any) -> Self:
        """Return the filter (2ζω s + ω²)/(s² + 2ζω s + ω²), a soil layer (Kanai 1957, Tajimi 1960).

        It maps the ground acceleration of an oscillator to the absolute acceleration of its mass.

        - `omega`: frequency ω, > 0 [rad/s]; `zeta`: damping ratio ζ, > 0 [–]
        """
        omega, zeta = _as_positive("layer", omega, zeta)
        denominator = _denominator(omega, zeta)
        return cls(jnp.pad(denominator, (1, 0)), denominator)


def _as_positive(name: str, omega: Any, zeta: Any) -> tuple[Array, Array]:
    """Return frequency and damping ratio as arrays. Raises `ValueError` unless both are > 0."""
    omega, zeta = as_float(omega), as_float(zeta)
    require_positive(f"Filter.{name}", omega=omega, zeta=zeta)
    return omega, zeta


def _denominator(omega: Array, zeta: Array) -> Array:
    return jnp.stack([2 * zeta * omega, omega**2])


def append_filters(
    dynamics: Float[Array, "m m"], output: Float[Array, " m"], filters: tuple[Filter, ...]
) -> tuple[Float[Array, "k k"], Float[Array, " k"]]:
    """Add filters in series, in the order in which the output passes them, to a system ż = A z with the
    output C z, and return the new A and C.

    Each filter adds the states x and ẋ with ẍ + a₁ẋ + a₀x = input. Its output is b₂ẍ + b₁ẋ + b₀x. The output
    of the last filter is the output of the new system. The new A has k = m + 2·(number of filters) rows.
    """
    size = len(output)
    added = 2 * len(filters)
    dynamics, output = jnp.pad(dynamics, (0, added)), jnp.pad(output, (0, added))
    for k, stage in enumerate(filters):
        x, v = size + 2 * k, size + 2 * k + 1
        (b_2, b_1, b_0), (a_1, a_0) = stage.numerator, stage.denominator
        acceleration = output.at[jnp.array([x, v])].add(jnp.stack([-a_0, -a_1]))
        dynamics = dynamics.at[x, v].set(1.0).at[v].set(acceleration)
        output = b_2 * acceleration
        output = output.at[jnp.array([x, v])].add(jnp.stack([b_0, b_1]))
    return dynamics, output
