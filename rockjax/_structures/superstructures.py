"""Superstructures on the podium: the base class, `Rigid`, `Elastic`, and `Oscillators` for the engine.

For the engine, a superstructure consists of oscillators in parallel on the beam and of a mass that moves with
the beam. Mass ratios are masses divided by N m_c, the mass of all N columns. JAX compiles a separate program
for each number of oscillators, for each value of a property that is a Python bool, and for each combination
of properties that are None. docs/equations.md states where equations with a letter, such as (C15), are.
"""

from __future__ import annotations

import abc
import math
from typing import ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from rockjax._checks import array_module, as_number, concrete, require, require_not_negative
from rockjax._text.representations import PrintedModule
from rockjax._types import Array, Number


class AbstractSuperstructure(PrintedModule):
    """A superstructure. Subclasses define its oscillators and the mass that moves with the beam."""

    rows: ClassVar[tuple[str, ...]] = ()  # fields with one value for each mode or story along the last axis

    @property
    @abc.abstractmethod
    def oscillators(self) -> Elastic | Oscillators | None:
        """The oscillators; None if nothing vibrates."""

    @property
    @abc.abstractmethod
    def carried(self) -> Number | None:
        """Mass ratio of the mass that moves with the beam [–]; None if there is no such mass."""

    @property
    @abc.abstractmethod
    def mass_ratio(self) -> Number:
        """Mass ratio of the whole superstructure, m_t/(N m_c) [–]."""

    @property
    def elastic(self) -> bool:
        """True if the superstructure is elastic; a Python bool, known when JAX compiles."""
        return True

    @property
    def count(self) -> int:
        """The number of oscillators."""
        oscillators = self.oscillators
        return 0 if oscillators is None else oscillators.count

    @property
    def has_mode_axis(self) -> bool:
        """True if displacements and deformations have an axis of modes; a Python bool."""
        return False

    @property
    def floors(self) -> Array | None:
        """Γ_i φ_ji, the participation factor of mode i times its shape at floor j, shape (floors, modes) [–],
        (C11); None if there are no floors."""
        return None

    @property
    def story_weights(self) -> Array | None:
        """Weights of the modes in the motion of the stories, (L2), shape (stories, modes); None if there are
        no stories. `Elastic` and `Rigid` count as one story. The weight of the motion of the beam is 1 minus
        the sum of the weights of the modes."""
        return self.floors

    @property
    def height_count(self) -> int | None:
        """Number of heights in `Elevation.top_height`, one for each mode or floor; None for one height."""
        return None

    @property
    def own_heights(self) -> Array | None:
        """Heights of the floors above the beam [m]; None if `Elevation.top_height` gives the heights."""
        return None

    def check_heights(self, owner: str, heights: Number) -> None:
        """Raise `ValueError` for heights of an elevation that do not suit the superstructure; the message
        begins with `owner`."""
        del owner, heights

    def first_moments(self, heights: Number, residual_height: Number) -> tuple[Number | None, Number | None]:
        """Return the first moments η_i h_i of the oscillators (None if nothing vibrates) and η_r h_r of the
        mass that moves with the beam (None if there is no such mass), (F7) [m].

        - `heights`: heights of the modes or floors above the tops of the columns [m]: a scalar, or
          `height_count` values along the last axis
        - `residual_height`: height of the mass that is in no mode, above the tops of the columns [m]
        """
        oscillators, carried = self.oscillators, self.carried
        if oscillators is None:
            return None, None if carried is None else carried * heights
        return oscillators.eta * heights, None if carried is None else carried * residual_height

    def split_rows(self) -> Self:
        """Return the superstructure with each row over modes or stories as a tuple of its elements, so that
        every leaf has one value per podium of a batch."""
        return self

    def without_heights(self) -> Self:
        """Return the superstructure without heights of its own, which do not affect the motion."""
        return self

    def resolved(self) -> AbstractSuperstructure:
        """Return the superstructure in the form that the engine uses: `Rigid`, `Elastic` or `Oscillators`."""
        return self


class Elastic(AbstractSuperstructure):
    """An elastic single-degree-of-freedom superstructure, Eqs. (4), (22).

    - `eta`: mass ratio η = m_t/(N m_c), ≥ 0 [–]. With η = 0 the superstructure responds to the beam but does
      not act on the beam.
    - `T_s`: fixed-base period, > 0 [s]. For T_s = 0 use [`rockjax.Rigid`][], not a small period.
    - `zeta`: fixed-base damping ratio ζ ≥ 0 [–].
    """

    eta: Number = eqx.field(converter=as_number("Elastic: eta"))
    T_s: Number = eqx.field(converter=as_number("Elastic: T_s"))
    zeta: Number = eqx.field(converter=as_number("Elastic: zeta"), default=0.05)

    def __check_init__(self):
        require_not_negative("Elastic", eta=self.eta, zeta=self.zeta)
        require(
            "Elastic",
            "T_s",
            self.T_s,
            lambda v: v > 0,
            "finite and > 0 (for a rigid superstructure use Rigid(eta))",
        )

    @property
    def omega_s(self) -> Number:
        """Fixed-base circular frequency ω_s = 2π/T_s [rad/s]."""
        return 2 * math.pi / self.T_s

    @property
    def oscillators(self) -> Elastic:
        return self

    @property
    def count(self) -> int:
        return 1

    @property
    def vibrating_mass(self) -> Number:
        """Mass ratio of the vibrating mass [–]."""
        return self.eta

    @property
    def carried(self) -> None:
        return None

    @property
    def mass_ratio(self) -> Number:
        return self.eta

    @property
    def story_weights(self) -> Array:
        return array_module(self.eta).ones((1, 1))


class Rigid(AbstractSuperstructure):
    """A rigid superstructure, T_s = 0. Its mass is added to the mass of the beam: γ + η replaces γ.

    - `eta`: mass ratio η = m_t/(N m_c), ≥ 0 [–].
    """

    eta: Number = eqx.field(converter=as_number("Rigid: eta"))

    def __check_init__(self):
        require_not_negative("Rigid", eta=self.eta)

    @property
    def oscillators(self) -> None:
        return None

    @property
    def carried(self) -> Number:
        return self.eta

    @property
    def mass_ratio(self) -> Number:
        return self.eta

    @property
    def elastic(self) -> bool:
        return False

    @property
    def story_weights(self) -> Array:
        return array_module(self.eta).zeros((1, 0))


class Oscillators(AbstractSuperstructure):
    """Oscillators in the form that the engine uses, with the modes along the last axis of arrays. The fields
    have the meanings of those of [`rockjax.Modes`][]; `T_s` corresponds to `T`."""

    eta: Array
    T_s: Array
    zeta: Array  # one value for all modes, or one for each
    residual: Number | None = None  # mass ratio of the mass that moves with the beam; None if there is none
    shapes: Array | None = None  # Γ_i φ_ji of a building, see `floors`

    @property
    def omega_s(self) -> Array:
        """Fixed-base circular frequencies [rad/s]."""
        return 2 * math.pi / self.T_s

    @property
    def oscillators(self) -> Oscillators:
        return self

    @property
    def count(self) -> int:
        return self.eta.shape[-1]

    @property
    def vibrating_mass(self) -> Number:
        """Mass ratio of the vibrating mass [–]."""
        return self.eta.sum(axis=-1)

    @property
    def carried(self) -> Number | None:
        return self.residual

    @property
    def mass_ratio(self) -> Number:
        return self.vibrating_mass if self.residual is None else self.vibrating_mass + self.residual

    @property
    def has_mode_axis(self) -> bool:
        return True

    @property
    def floors(self) -> Array | None:
        return self.shapes


def eigh(matrix: Array) -> tuple[Array, Array]:
    """Return the eigenvalues of symmetric matrices, ascending along the last axis, and the eigenvectors as
    columns. Concrete matrices use NumPy."""
    constant = concrete(matrix)
    return jnp.linalg.eigh(matrix) if constant is None else np.linalg.eigh(constant)  # pyright: ignore[reportReturnType]


def uplifted_squares(
    oscillators: Elastic | Oscillators, inertia: Number, stiffness: Number, cos_alpha: Number
) -> Number:
    """Return the squares x of the n+1 circular frequencies of a podium with lifted columns, ascending along
    the last axis [rad²/s²]. `inertia` and `stiffness` are Λ [–] and k [1/s²] of (C15).

    The squares x solve (C15), Λ − k/x + 3cos²α Σ η_iω_i²/(ω_i² − x) = 0. They are the eigenvalues of a
    symmetric matrix, which has ω_i² on the diagonal, and a first row and column for the rotation. Rotation
    and oscillators are scaled by the square roots of their inertias.
    """
    squares, masses = oscillators.omega_s**2, 3 * oscillators.eta
    if isinstance(oscillators, Elastic):
        squares, masses = squares[..., None], masses[..., None]
    inertia, stiffness, cos_alpha = (jnp.asarray(y)[..., None] for y in (inertia, stiffness, cos_alpha))
    return jnp.maximum(_uplifted_eigenvalues(squares, masses, inertia, stiffness, cos_alpha), 0.0)


def _bordered_matrix(
    squares: Array, masses: Array, inertia: Array, stiffness: Array, cos_alpha: Array
) -> Array:
    """Return the matrix of `uplifted_squares`."""
    corner = (stiffness + cos_alpha**2 * jnp.sum(masses * squares, axis=-1, keepdims=True)) / inertia
    border = -cos_alpha * jnp.sqrt(masses / inertia) * squares
    size = squares.shape[-1] + 1
    matrix = jnp.zeros((*jnp.broadcast_shapes(corner.shape[:-1], border.shape[:-1]), size, size))
    matrix = matrix.at[..., 0, 0].set(corner[..., 0])
    matrix = matrix.at[..., 0, 1:].set(border).at[..., 1:, 0].set(border)
    diagonal = jnp.arange(1, size)
    return matrix.at[..., diagonal, diagonal].set(squares)


@jax.custom_jvp
def _uplifted_eigenvalues(
    squares: Array, masses: Array, inertia: Array, stiffness: Array, cos_alpha: Array
) -> Array:
    """Return the eigenvalues of `_bordered_matrix`."""
    return jnp.asarray(eigh(_bordered_matrix(squares, masses, inertia, stiffness, cos_alpha))[0])


@_uplifted_eigenvalues.defjvp
def _uplifted_eigenvalues_jvp(primals, tangents):
    """Differentiate the eigenvalues as Rayleigh quotients, which are stationary with respect to the mode
    shapes. Derivatives of mode shapes, which do not exist if periods are equal, are therefore not needed.
    Derivatives of the square roots of masses, which do not exist if a mass is zero, are not needed either."""
    squares, masses, inertia, _, cos_alpha = primals
    values, vectors = eigh(_bordered_matrix(*primals))
    rotation, shapes = vectors[..., 0, :] / jnp.sqrt(inertia), vectors[..., 1:, :]
    has_mass = masses[..., :, None] > 0
    detuning = squares[..., :, None] - values[..., None, :]
    # In a mode, a massless oscillator follows the beam, or vibrates alone at its natural frequency.
    driven = (
        (cos_alpha * rotation)[..., None, :] * squares[..., :, None] / jnp.where(detuning == 0, 1.0, detuning)
    )
    motions = shapes / jnp.sqrt(jnp.where(has_mass, masses[..., :, None], 1.0))
    motions = jnp.where(has_mass, motions, jnp.where(detuning == 0, 0.0, driven))
    massless = jnp.where(has_mass, 0.0, shapes**2)

    def rayleigh_quotient(squares, masses, inertia, stiffness, cos_alpha):
        squares, masses = squares[..., :, None], masses[..., :, None]
        stretch = masses * (motions - (cos_alpha * rotation)[..., None, :]) ** 2 + massless
        potential_energy = stiffness * rotation**2 + jnp.sum(squares * stretch, axis=-2)
        return potential_energy / (inertia * rotation**2 + jnp.sum(masses * motions**2 + massless, axis=-2))

    return jnp.asarray(values), jax.jvp(rayleigh_quotient, primals, tangents)[1]
