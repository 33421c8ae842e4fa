"""The podium: a frame of rocking columns, its superstructure and its restrainers.

All classes of structures are frozen dataclasses and pytrees: `dataclasses.replace` makes a variant, and
parameters may be traced, batched or differentiated. Parameters are in SI units (m, kg, s, rad). Their values
are checked unless JAX traces them. Plain equation numbers are those of docs/model.md; docs/equations.md
states where equations with a letter, such as (C10), are.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from rockjax._checks import (
    as_float,
    as_number,
    as_numpy_unless_traced,
    concrete,
    format_value,
    require,
    require_not_negative,
    require_positive,
    require_whole,
)
from rockjax._parameters.registry import STRUCTURE, WIDTH_AND_HEIGHT
from rockjax._restrainers.base import AbstractRestrainer
from rockjax._restrainers.combined import (
    apparent_mass,
    as_restrainers,
    devices_by_joints,
    prestress,
    stability_angle,
    stiffness,
)
from rockjax._restrainers.dimensions import restrainers_of
from rockjax._text.representations import PrintedModule, format_html
from rockjax._types import Number
from rockjax._units import STANDARD_GRAVITY

from .building import ShearBuilding
from .column import check_column_units, enlargement, g_tan_alpha, slenderness_and_size
from .elevation import Arms, Elevation
from .impulses import impulse_eccentricity, impulses
from .modes import is_concrete_zero, with_fields
from .restitution import Restitution, as_restitution
from .superstructures import (
    AbstractSuperstructure,
    Elastic,
    Oscillators,
    Rigid,
    uplifted_squares,
)


class Podium(PrintedModule):
    """A podium frame of free-standing rocking columns under a rigid beam, with or without a superstructure.

    - `alpha`: column slenderness α = atan(B/H), with half width B and half height H of a column,
      0 < α < π/2 [rad], Eq. (1)
    - `R`: half diagonal of a column, > 0 [m]
    - `gamma`: mass ratio of the beam γ = m_b/(N m_c), with the mass m_b of the beam and N columns of mass
      m_c, ≥ 0 [–], Eq. (2); 0 for Housner's solitary block
    - `superstructure`: `None`, [`rockjax.Rigid`][], [`rockjax.Elastic`][], [`rockjax.Modes`][] or
      [`rockjax.ShearBuilding`][]
    - `lam`: column inertia factor λ = I_c/(m_c R²), with the moment of inertia I_c about the centre of the
      column, ≥ 0 [–], Eq. (3); 1/3 for a uniform block
    - `restitution`: `"paper"` for Eq. (27), `"compatible"` for conservation of angular momentum with
      Eq. (26), or a velocity factor from 0 to 1 [–]
    - `g`: acceleration of gravity, > 0 [m/s²]
    - `restrainers`: [`rockjax.Tendon`][], [`rockjax.Damper`][] and [`rockjax.Inerter`][], which act in
      parallel on every column. Each restrainer spans both joints of a column, from the ground to the beam,
      or with `joints=1` only the bottom joint
    - `elevation`: an [`rockjax.Elevation`][] with positions of columns and heights of masses, for forces in
      the joints of each column; None if only forces averaged over the columns (the "mean column") are needed

    Parameters may be arrays: a podium with arrays is a batch of podiums, for `jax.vmap` and
    `rockjax.peak_responses`. Raises `ValueError` for values outside these ranges; traced values are not
    checked.
    """

    alpha: Number = eqx.field(converter=as_number("Podium: alpha"))
    R: Number = eqx.field(converter=as_number("Podium: R"))
    gamma: Number = eqx.field(converter=as_number("Podium: gamma"), default=0.0)
    superstructure: AbstractSuperstructure | None = None
    lam: Number = eqx.field(converter=as_number("Podium: lam"), default=1 / 3)
    restitution: Restitution = eqx.field(converter=as_restitution, default="paper")
    g: Number = eqx.field(converter=as_number("Podium: g"), default=STANDARD_GRAVITY)
    restrainers: tuple[AbstractRestrainer, ...] = eqx.field(converter=as_restrainers, default=())
    elevation: Elevation | Arms | None = None

    def __check_init__(self):
        require(
            "Podium",
            "alpha",
            self.alpha,
            lambda v: (v > 0) & (v < np.pi / 2),
            "in (0, π/2) rad, not in degrees",
        )
        require_positive("Podium", R=self.R, g=self.g)
        require_not_negative("Podium", gamma=self.gamma, lam=self.lam)
        if not isinstance(self.superstructure, None | AbstractSuperstructure):
            raise ValueError(
                "Podium: superstructure must be None, Elastic(...), Rigid(...), Modes(...) or "
                f"ShearBuilding(...), got {self.superstructure!r}"
            )
        self._check_elevation()

    def _check_elevation(self) -> None:
        elevation = self.elevation
        if elevation is None:
            return
        if not isinstance(elevation, Elevation):
            raise ValueError(
                f"Podium: elevation must be None or Elevation(...), got {format_value(elevation)}"
            )
        masses = [self.gamma, *([] if self.superstructure is None else [self.superstructure.mass_ratio])]
        has_mass = any(mass is None or np.any(mass) for mass in map(concrete, masses))
        if not has_mass and all(restrainer.joints == 1 for restrainer in self.restrainers):
            raise ValueError(
                "Podium: an elevation needs something on the columns: a beam, a superstructure with a mass, "
                "or restrainers across both joints; this is a solitary block with gamma = 0"
            )
        elevation.check(self.superstructure, self.width)

    @classmethod
    def from_dimensions(
        cls,
        width,
        height,
        column_mass,
        beam_mass: ArrayLike = 0.0,
        columns: int | None = None,
        top_mass: ArrayLike = 0.0,
        period=None,
        damping: ArrayLike = 0.05,
        lam: ArrayLike = 1 / 3,
        restitution: str | ArrayLike = "paper",
        g: ArrayLike = STANDARD_GRAVITY,
        tendon_force: ArrayLike = 0.0,
        tendon_stiffness: ArrayLike = 0.0,
        damper_coefficient: ArrayLike = 0.0,
        damper_exponent: ArrayLike = 1.0,
        inertance: ArrayLike = 0.0,
        stories: int | None = None,
        story_masses=None,
        story_stiffnesses=None,
        story_heights=None,
        modes: int | None = None,
        positions=None,
        beam_depth: ArrayLike = 0.0,
        top_height: ArrayLike = 0.0,
        residual_height: ArrayLike = 0.0,
        end_radius: ArrayLike = 0.0,
    ) -> Podium:
        """Return a podium from dimensions and masses.

        - `width`, `height`: full column width 2B and height 2H, > 0 [m]
        - `column_mass`: mass of one column m_c, > 0 [kg]
        - `beam_mass`, `top_mass`: masses of the beam m_b and of the superstructure m_t, ≥ 0 [kg]
        - `columns`: number of columns N; by default the number of `positions`, or 2 without `positions`
        - `period`, `damping`: T_s [s] and ζ of the superstructure. Without `period` and stories, the
          superstructure is rigid, or None if `top_mass` is the Python number 0
        - `lam`, `restitution`, `g`: as for [`rockjax.Podium`][]
        - `tendon_force`, `tendon_stiffness`: initial force P₀ [N] and axial stiffness K [N/m] of the tendon
          of a column
        - `damper_coefficient`, `damper_exponent`: C [N(s/m)^ν] and ν of the damper of a column
        - `inertance`: b of the inerter of a column [kg]
        - `stories`: number of stories of a building with equal stories, total mass `top_mass` and longest
          period `period`
        - `story_masses`, `story_stiffnesses`: masses [kg] and stiffnesses [N/m] of the stories of any
          building, from the bottom; cannot be combined with `stories`, `top_mass` or `period`
        - `story_heights`: heights of the stories [m], as in [`rockjax.ShearBuilding`][]; with `stories`, also
          one height for all stories
        - `modes`: number of modes of a building, as in [`rockjax.ShearBuilding`][]
        - `positions`: positions of the columns in the direction of motion [m], for forces in their joints
        - `beam_depth`, `top_height`, `residual_height`: heights [m] as in [`rockjax.Elevation`][]; they need
          `positions`
        - `end_radius`: radius r_c of round column ends, 0 ≤ r_c < H [m]. Each end has a flat face of width 2B
          between two arcs of this radius, which join the face tangentially. Cannot be combined with tendons,
          dampers and inerters

        With round ends, the result is an approximately equivalent podium with flat ends and the same α, (R5).
        Its `R`, `width` and `height` are larger than those of the real columns by the factor H/(H − r_c), and
        its rotations are smaller by the factor (H − r_c)/H. Displacements u_b of the beam are too small, and
        overturning amplitudes too large. For tan α = 0.15 and r_c = H/2, tests with Ricker pulses give errors
        of at most 0.65 % for peaks of u_b up to half of the displacement at overturning, and of at most 1.3 %
        for overturning amplitudes. For r_c = 0.8 H these errors are at most 3.4 % and 15 %. They grow with α
        and with the period of the pulse. The section "Round column ends" on the page on forces in the joints
        has the tests.

        Tendons, dampers and inerters act between the ground and the beam. A device is omitted if its
        parameters, not counting the exponent, are the Python number 0.

        Warns ([`rockjax.PlausibilityWarning`][]) if R exceeds 100 m, or if a square column of this width has
        less than 300 kg/m³ or more than 8000 kg/m³. Raises `ValueError` for invalid or inconsistent values.
        """
        owner = "Podium.from_dimensions"
        heights = {"beam_depth": beam_depth, "top_height": top_height, "residual_height": residual_height}
        columns, elevation = _count_and_elevation(owner, columns, positions, heights)
        for name, value in ({"damping": damping} | ({} if period is None else {"period": period})).items():
            as_float(value, f"{owner}: {name}")
        require_positive(owner, width=width, height=height, column_mass=column_mass)
        require_not_negative(owner, beam_mass=beam_mass, top_mass=top_mass)
        width, height, column_mass = map(as_numpy_unless_traced, (width, height, column_mass))
        check_column_units(width, height, column_mass)
        columns_mass = columns * column_mass
        eta = as_numpy_unless_traced(top_mass) / columns_mass
        building = stories, story_masses, story_stiffnesses
        has_stories = any(argument is not None for argument in building)
        if not has_stories:
            _refuse_without_building(owner, modes=modes, story_heights=story_heights)
        if has_stories:
            superstructure = _make_building(
                owner, columns_mass, *building, eta, period, damping, modes, story_heights
            )
        elif period is not None:
            superstructure = Elastic(eta=eta, T_s=period, zeta=damping)
        elif isinstance(top_mass, int | float) and top_mass == 0:
            superstructure = None
        else:
            superstructure = Rigid(eta=eta)
        alpha, R = slenderness_and_size(width, height)
        device_values = tendon_force, tendon_stiffness, damper_coefficient, damper_exponent, inertance
        devices = restrainers_of(owner, column_mass, R, as_numpy_unless_traced(g), *device_values)
        radius = as_numpy_unless_traced(end_radius, f"{owner}: end_radius")
        if not is_concrete_zero(radius):
            R, elevation = _with_round_ends(owner, radius, height, R, devices, elevation)
        return cls(
            alpha=alpha,
            R=R,
            gamma=as_numpy_unless_traced(beam_mass) / columns_mass,
            superstructure=superstructure,
            lam=lam,
            restitution=restitution,
            g=g,
            restrainers=devices,
            elevation=elevation,
        )

    @property
    def p(self) -> Number:
        """Frequency parameter p = √(3g/4R) [rad/s], Eq. (25)."""
        return jnp.sqrt(0.75 * self.g / self.R)

    @property
    def width(self) -> Number:
        """Full column width 2B = 2R sin α [m]."""
        return 2 * self.R * jnp.sin(self.alpha)

    @property
    def height(self) -> Number:
        """Full column height 2H = 2R cos α [m]."""
        return 2 * self.R * jnp.cos(self.alpha)

    @property
    def eta(self) -> Number:
        """Mass ratio η of the superstructure [–]; 0 without a superstructure."""
        return jnp.zeros_like(self.gamma) if self.superstructure is None else self.superstructure.mass_ratio

    @property
    def vibrates(self) -> bool:
        """True if the superstructure is elastic; a Python bool, known when JAX compiles."""
        return self.superstructure is not None and self.superstructure.elastic

    @property
    def mass_ratios(self) -> tuple[Number, Number]:
        """Masses divided by N m_c [–]: of the beam with everything that moves with it, and of the vibrating
        part of the superstructure."""
        superstructure = self.superstructure
        oscillators = None if superstructure is None else superstructure.oscillators
        if superstructure is None or oscillators is None:
            return (self.gamma if superstructure is None else self.gamma + self.eta), jnp.zeros_like(self.eta)
        carried = superstructure.carried
        return (self.gamma if carried is None else self.gamma + carried), oscillators.vibrating_mass

    @property
    def uplift_ground_acceleration(self) -> Number:
        """Ground acceleration that lifts the columns of a podium at rest, g tan α, Eq. (5) [m/s²]. Tendons of
        prestress τ raise it to g tan α (1 + τ/w), where w = γ+η+½.

        With a rigid superstructure or none, columns lift as soon as |ü_g| exceeds this value. With an elastic
        superstructure this holds for slow motions, in which the spring transmits the inertia of the top mass.
        Faster motions have other thresholds. If the top mass vibrates, columns can lift at less than g tan α.
        At a jump of the ground acceleration from rest, the spring has not responded yet, and columns lift
        immediately only if the acceleration exceeds `uplift_demand`.
        """
        threshold = g_tan_alpha(self.alpha, self.g)
        if any(restrainer.has_static_force for restrainer in self.restrainers):
            threshold = threshold * (
                1 + prestress(self.restrainers, self.gamma) / (self.gamma + self.eta + 0.5)
            )
        return threshold

    @property
    def uplift_demand(self) -> Number:
        """Threshold of the demand |q|, above which the columns lift [m/s²], Eq. (9).

        The demand is q = ü_g with a rigid superstructure or none. With an `Elastic` superstructure whose mass
        is displaced by u_t relative to the ground, q = ü_g − (ω_s² u_t + 2ζω_s u̇_t)·2η/(1+2γ), which
        includes the forces of spring and damper. `uplift_ground_acceleration` is a threshold of ü_g alone.

        The threshold is g tan α (1+2γ+2η)/(1+2γ) with an elastic superstructure, and g tan α with a rigid one
        or none, Eq. (5). Tendons of prestress τ add 2gτ tan α/(1+2γ), (C10). In these formulas, γ includes
        all mass that moves with the beam.
        """
        threshold = self.uplift_ground_acceleration
        if self.vibrates:
            gamma, eta = self.mass_ratios
            threshold = threshold * (1 + 2 * gamma + 2 * eta) / (1 + 2 * gamma)
        return threshold

    @property
    def uplift_acceleration(self) -> Number:
        """Alias of `uplift_demand`. The ground acceleration that lifts the columns is
        `uplift_ground_acceleration`."""
        return self.uplift_demand

    @property
    def restitution_factor(self) -> Number:
        """Velocity factor e = |θ̇⁺/θ̇⁻| of an impact [–], according to the law `restitution`. Rocking ends at
        an impact if e ≤ 0.

        The laws count all mass that moves with the beam, such as a rigid superstructure, as part of the beam.
        """
        gamma, eta = self.mass_ratios
        return self.restitution.factor(
            jnp.sin(self.alpha) ** 2, gamma, eta, self.lam, apparent_mass(self.restrainers)
        )

    @property
    def inertances(self) -> tuple[Number, Number]:
        """μ_b and μ_t, the inertances that act on the bottom and on the top joint, divided by m_c [–].

        A device that spans only the bottom joint has twice the force of the equivalent device that spans both
        joints, (F2).
        """
        both_joints, bottom_joint = map(apparent_mass, devices_by_joints(self.restrainers))
        top = jnp.zeros_like(self.gamma) + (0.0 if both_joints is None else both_joints)
        return (top if bottom_joint is None else top + 2 * bottom_joint), top

    @property
    def dead_load(self) -> Number:
        """Axial force at rest divided by m_c g, averaged over the columns, at the bottom and the top joint
        along the last axis [–], (F3)."""
        both_joints, bottom_joint = devices_by_joints(self.restrainers)
        carried = self.gamma + self.eta
        top = carried + prestress(both_joints, carried)
        return jnp.stack([top + 1 + 2 * prestress(bottom_joint, carried), top], axis=-1)

    @property
    def impact_eccentricity(self) -> Number:
        """ξ_J, the distance of the resultant of the impulses at an impact from the centre line of a column,
        divided by half the width of the column [–], (F13).

        ξ_J is 1 if all impulses act at the new contact edges, as with `"compatible"`, or with `"paper"` and
        no elastic superstructure. ξ_J is less than 1 if impulses also act at the old edges, about which the
        columns rotated before the impact. A value above 1 would need tensile impulses at the old edges, which
        the faces of the joints cannot transmit.
        """
        gamma, eta = self.mass_ratios
        sin2, (bottom, top) = jnp.sin(self.alpha) ** 2, self.inertances
        return impulse_eccentricity(sin2, gamma, eta, self.lam, 0.5 * (bottom + top), self._impact_factor)

    @property
    def impact_friction(self) -> Number:
        """Friction demand |J_T|/J_N of an impact at the bottom and the top joint, along the last axis [–],
        (F12). J_T and J_N are the horizontal and the axial impulse, averaged over the columns. The demand is
        0 at the top joint of a solitary block."""
        gamma, eta = self.mass_ratios
        geometry = 2 * self.R, jnp.sin(self.alpha), jnp.cos(self.alpha)
        mean_column = impulses(*geometry, gamma, eta, self.inertances, self._impact_factor)
        ratios = (
            jnp.where(axial > 0, horizontal / jnp.where(axial > 0, axial, 1.0), 0.0)
            for horizontal, axial in zip(mean_column.horizontal, mean_column.axial, strict=True)
        )
        return jnp.stack(jnp.broadcast_arrays(*ratios), axis=-1)

    @property
    def core_distance(self) -> Number:
        """Core distance ℓ_p of the columns [m]. All columns are in compression if the resultant of their
        axial forces is within ±ℓ_p of their mean position. Raises `ValueError` without an elevation."""
        if not isinstance(self.elevation, Elevation):
            raise ValueError("Podium.core_distance needs an elevation: Podium(..., elevation=Elevation(...))")
        return self.elevation.core_distance

    @property
    def _impact_factor(self) -> Number:
        """Velocity factor of an impact [–]; 0 if rocking ends at the impact."""
        return jnp.maximum(self.restitution_factor, 0.0)

    @property
    def stability_angle(self) -> Number:
        """θ_s: the smallest rotation in (0, π/2] from which a column at rest does not return [rad], (C7).

        θ_s is α without tendons, larger with tendons, and inf if the column returns from every rotation up to
        π/2.
        """
        return stability_angle(self.alpha, self.gamma + self.eta + 0.5, self.restrainers)

    @property
    def critical_stiffness(self) -> Number:
        """κ_cr = w cos α/(2 sin²α) [–] with w = γ+η+½, (C6): if the tendon stiffness K R/(m_c g) exceeds
        κ_cr, the stiffness of the podium at small rotations is positive. κ_cr does not depend on the tendons
        of this podium.
        """
        return (self.gamma + self.eta + 0.5) * jnp.cos(self.alpha) / (2 * jnp.sin(self.alpha) ** 2)

    @property
    def uplifted_frequency(self) -> Number:
        """Circular frequency of the superstructure while the podium is uplifted [rad/s], Eq. (31).

        With tendons, inerters or several modes, this is the largest of `uplifted_frequencies`. Raises
        `ValueError` without an elastic superstructure.
        """
        oscillators = self._require_oscillators("uplifted_frequency")
        if isinstance(oscillators, Oscillators):
            return self.uplifted_frequencies[..., -1]
        mass_term = self.lam + 1 + 4 * self.gamma
        if self.restrainers:
            return self._restrained_frequency(oscillators)
        ratio = (mass_term + 4 * self.eta) / (mass_term + 4 * self.eta * jnp.sin(self.alpha) ** 2)
        return jnp.sqrt(ratio) * oscillators.omega_s

    @property
    def uplifted_frequencies(self) -> Number:
        """All n+1 circular frequencies of the uplifted podium, ascending along the last axis [rad/s], (C15).
        One belongs to rocking against the stiffness of the tendons and is 0 without tendons. The others
        belong to the n modes of the superstructure.

        The equations are linearised without gravity and prestress. Raises `ValueError` without an elastic
        superstructure.
        """
        modes = self._require_oscillators("uplifted_frequencies")
        squares = uplifted_squares(modes, *self._uplifted_constants())
        if stiffness(self.restrainers) is None:  # exactly zero, without rounding
            squares = squares.at[..., 0].set(0.0)
        return jnp.sqrt(squares)

    def _uplifted_constants(self) -> tuple[Number, Number, Number]:
        """Return the arguments `inertia`, `stiffness` and `cos_alpha` of `uplifted_squares`."""
        gamma, eta = self.mass_ratios
        sin2 = jnp.sin(self.alpha) ** 2
        mu, kappa = apparent_mass(self.restrainers), stiffness(self.restrainers)
        inertia = 3 * gamma + 0.75 * (1 + self.lam) + 3 * (eta + (0.0 if mu is None else mu)) * sin2
        stiffness_term = jnp.zeros_like(sin2) if kappa is None else 4 * self.p**2 * kappa * sin2
        return inertia, stiffness_term, jnp.cos(self.alpha)

    def fastest_frequency(self) -> Number:
        """Return `uplifted_frequency` for the choice of step lengths. With several modes its derivatives are
        zero."""
        oscillators = self._require_oscillators("uplifted_frequency")
        if isinstance(oscillators, Elastic):
            return self.uplifted_frequency
        lifted = jax.lax.stop_gradient((oscillators, *self._uplifted_constants()))
        return jnp.sqrt(uplifted_squares(*lifted)[..., -1])

    def _require_oscillators(self, name: str) -> Elastic | Oscillators:
        superstructure = self.superstructure
        oscillators = None if superstructure is None else superstructure.oscillators
        if oscillators is None:
            raise ValueError(f"Podium.{name} needs an elastic superstructure, such as Elastic(...)")
        return oscillators

    def _restrained_frequency(self, oscillator: Elastic) -> Number:
        """Return `uplifted_frequency` with restrainers and one oscillator."""
        inertia, stiffness_term, cos_alpha = self._uplifted_constants()
        omega2 = oscillator.omega_s**2
        middle = 0.5 * (stiffness_term + omega2 * (inertia + 3 * self.eta * cos_alpha**2))
        # Rounding can make the square negative if both roots are equal.
        square = jnp.maximum(middle**2 - inertia * stiffness_term * omega2, 0.0)
        return jnp.sqrt((middle + jnp.sqrt(square)) / inertia)

    def equivalent_block(self) -> Podium:
        """Return the solitary block (λ = 1/3) that rocks exactly like this frame under every excitation.

        The block has the same α and e as the frame, and a frequency parameter p̂ with
        p̂² = p² (2γ+1)/(3γ+¾(1+λ)), where γ includes a rigid superstructure. Its restrainers have τ/(1+2γ),
        κ/(1+2γ), δ (p̂/p)^ν/(1+2γ), ν and μ/(3γ+¾(1+λ)) instead of τ, κ, δ, ν and μ (symbols of the table
        below (C1) in docs/control.md). Raises `ValueError` for an elastic superstructure, which has no
        equivalent block.
        """
        if self.vibrates:
            raise ValueError(
                "Podium.equivalent_block: a frame with an elastic superstructure has no equivalent "
                "block; make it Rigid"
            )
        gamma = self.gamma + self.eta
        weight, inertia = 2 * gamma + 1, 3 * gamma + 0.75 * (1 + self.lam)
        ratio = weight / inertia
        devices = tuple(
            restrainer.for_equivalent_block(weight, inertia, jnp.sqrt(ratio))
            for restrainer in self.restrainers
        )
        return Podium(
            alpha=self.alpha,
            R=self.R / ratio,
            restitution=self.restitution_factor,
            g=self.g,
            restrainers=devices,
        )

    def split_rows(self) -> Podium:
        """Return the podium with each array over columns, modes or stories split into a tuple of its
        elements, so that every leaf has one value per podium of a batch."""
        podium = self.without_elevation() if self.elevation is None else self
        superstructure, elevation = podium.superstructure, podium.elevation
        if isinstance(elevation, Elevation):
            elevation = elevation.split_rows(superstructure)
        return podium._with_parts(None if superstructure is None else superstructure.split_rows(), elevation)

    def without_idle_restrainers(self) -> Podium:
        """Return the podium without restrainers of zero strength, which have no effect but cost time."""
        active = tuple(restrainer for restrainer in self.restrainers if not restrainer.has_no_strength)
        if len(active) == len(self.restrainers):
            return self
        return eqx.tree_at(lambda podium: podium.restrainers, self, active)

    def without_elevation(self) -> Podium:
        """Return the podium without its elevation and the heights of its superstructure, which do not affect
        the motion."""
        superstructure = self.superstructure
        return self._with_parts(None if superstructure is None else superstructure.without_heights(), None)

    def resolved(self) -> Podium:
        """Return the podium in the form that the engine uses, with the superstructure as oscillators."""
        superstructure, elevation = self.superstructure, self.elevation
        if isinstance(elevation, Elevation):
            elevation = elevation.resolved(self.gamma, superstructure)
        return self._with_parts(None if superstructure is None else superstructure.resolved(), elevation)

    def _with_parts(
        self, superstructure: AbstractSuperstructure | None, elevation: Elevation | Arms | None
    ) -> Podium:
        """Return a copy with another superstructure and elevation, which are not checked."""
        if superstructure is self.superstructure and elevation is self.elevation:
            return self
        return with_fields(self, {"superstructure": superstructure, "elevation": elevation})

    def replace(self, **changes) -> Podium:
        """Return a podium with some fields changed, like `dataclasses.replace`."""
        return dataclasses.replace(self, **changes)

    def _repr_html_(self):
        return format_html(
            self,
            {
                "p": "Frequency parameter p [rad/s]",
                **{name: STRUCTURE[name].heading for name in WIDTH_AND_HEIGHT},
                "restitution_factor": "Velocity factor of an impact e [–]",
                "uplift_ground_acceleration": "Slow ground acceleration that lifts the columns [m/s²]",
            },
        )


def _count_and_elevation(
    owner: str, columns: int | None, positions, heights: Mapping[str, Any]
) -> tuple[int, Elevation | None]:
    """Return the number of columns and the elevation of `Podium.from_dimensions`. `heights` are the fields of
    `Elevation` and their values [m]. Raises `ValueError` for heights other than 0 without positions, for a
    number of columns that is not a whole number ≥ 1, and if `columns` is not the number of positions."""
    if positions is None:
        for name, value in heights.items():
            if not is_concrete_zero(as_float(value, f"{owner}: {name}")):
                raise ValueError(
                    f"{owner}: {name} needs the positions of the columns as well, got {name} = "
                    f"{format_value(value)} alone"
                )
        return (2 if columns is None else require_whole(owner, "columns", columns, 1)), None
    fields = {name: as_float(value, f"{owner}: {name}") for name, value in heights.items()}
    elevation = Elevation(as_float(positions, f"{owner}: positions"), **fields)
    if columns is not None and columns != elevation.count:
        raise ValueError(
            f"{owner}: columns must be the number of positions, {elevation.count}, or be left out; got "
            f"{columns!r}"
        )
    return elevation.count, elevation


def _with_round_ends(
    owner: str,
    radius: Number,
    height: Number,
    R: Number,
    devices: tuple[AbstractRestrainer, ...],
    elevation: Elevation | None,
) -> tuple[Number, Elevation | None]:
    """Return R and the elevation of the podium with flat ends that is equivalent to a podium with round ends,
    (R5). `height` and `R` are those of a column between its flat faces [m].

    The equivalent columns are taller than the real columns. `Elevation._raised` is the distance between the
    tops of both. All heights of masses refer to the tops of the real columns. `Arms.lever` is the lever of
    the axial forces about these tops. Raises `ValueError` for a radius out of range, and for restrainers,
    because round ends stretch them more than flat ends do.
    """
    ratio = enlargement(owner, radius, height)
    if devices:
        names = ", ".join(type(device).__name__ for device in devices)
        shown = float(radius) if isinstance(radius, np.ndarray) and not radius.ndim else format_value(radius)
        raise ValueError(
            f"{owner}: end_radius excludes tendons, dampers and inerters, because round ends stretch them "
            f"more than the flat ends of the model; got end_radius = {shown} and {names}"
        )
    if elevation is not None:
        elevation = dataclasses.replace(elevation, _raised=0.5 * height * (ratio - 1))
    return R * ratio, elevation


def _refuse_without_building(owner: str, **arguments: object) -> None:
    """Raise `ValueError` for arguments other than None that apply only to a building."""
    for name, value in arguments.items():
        if value is not None:
            raise ValueError(
                f"{owner}: {name} applies only to buildings; give stories, or story_masses and "
                f"story_stiffnesses, as well; got {name} = {format_value(value)} alone"
            )


def _make_building(
    owner: str, columns_mass, stories, masses, stiffnesses, eta, period, damping, modes, heights
) -> ShearBuilding:
    """Return the building of `Podium.from_dimensions`. `columns_mass` is N m_c [kg] and `eta` is m_t/(N m_c)
    [–]. Raises `ValueError` for missing or redundant arguments."""
    if stories is not None:
        if masses is not None or stiffnesses is not None or period is None or is_concrete_zero(eta):
            raise ValueError(
                f"{owner}: stories needs top_mass > 0 and period, and excludes story_masses and "
                "story_stiffnesses"
            )
        if np.ndim(heights) == 0:  # None, or one height for all stories
            return ShearBuilding.uniform(stories, eta, period, damping, modes, height=heights)
        uniform = ShearBuilding.uniform(stories, eta, period, damping, modes)
        return ShearBuilding(uniform.masses, uniform.stiffnesses, damping, modes, heights=heights)
    if masses is None or stiffnesses is None:
        raise ValueError(f"{owner}: story_masses and story_stiffnesses must be given together")
    if period is not None or np.any(concrete(eta)):
        raise ValueError(
            f"{owner}: story_masses and story_stiffnesses exclude top_mass and period; give one pair or "
            "the other"
        )
    masses, stiffnesses = (
        as_float(y, f"{owner}: {name}") / columns_mass[..., None]
        for name, y in (("story_masses", masses), ("story_stiffnesses", stiffnesses))
    )
    return ShearBuilding(masses, stiffnesses, damping, modes, heights=heights)
