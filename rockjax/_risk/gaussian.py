"""Gaussian ground motions: white noise passed through the filters of Kanai–Tajimi and Clough–Penzien.

The noise has the value w_j = u_j e(t_j) √(2π S₀/dt) in the sampling interval from t_j to t_j + dt. Here u ∈
ℝⁿ is a vector of independent standard normal numbers, e(t) the envelope, and S₀ the spectral density. The
noise passes through two filters, which start from rest: a soil layer with the frequency ω_g and the damping
ratio ζ_g, and a high-pass filter with ω_f and ζ_f. With the relative displacement x and the absolute
acceleration a_g of the layer, and the state y of the high-pass filter,

    ẍ + 2ζ_g ω_g ẋ + ω_g² x = −w,   a_g = −(2ζ_g ω_g ẋ + ω_g² x),
    ÿ + 2ζ_f ω_f ẏ + ω_f² y = a_g,   ü_g(t_j) = ÿ(t_j).

Further filters may follow. All filters are linear, and ü_g(t_j) depends only on earlier noise. Therefore
ü_g = A u, where A is lower triangular with a zero diagonal. A recurrence computes the product A u in O(n)
operations. Reverse-mode differentiation multiplies by the transpose of A, which also takes O(n) operations. A
model may also have a random pulse, which is added to A u and depends on three further entries of u.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm
from jaxtyping import Array, Float

from rockjax._checks import as_float, require, require_finite, require_positive, require_whole
from rockjax._excitations.wavelets import MavroeidisPapageorgiou
from rockjax._lognormal import Lognormal
from rockjax._motions.convert import as_motions
from rockjax._motions.intensity import intensity_measures
from rockjax._motions.record import Record
from rockjax._motions.records import Records
from rockjax._parameters.registry import as_variable
from rockjax._programs.program import StoredProgram
from rockjax._tree import Module

from .filters import Filter, append_filters

if TYPE_CHECKING:
    import xarray

Number = Float[Array, ""]
MAX_SQUARINGS = 48  # largest number of squarings in a matrix exponential; enough for a norm up to 1e14


class Envelope(Module):
    """Envelope of the noise [–]: (t/t₁)² up to t₁, 1 up to t₂, then e^(−c(t − t₂)).

    - `t_1`: end of the rise, > 0 [s]; `t_2`: start of the decay, ≥ t₁ [s]; `c`: rate of the decay, ≥ 0 [1/s]

    A `GaussianMotion` also accepts any other function t ↦ e(t) that maps an array of times to an array of the
    same shape. Raises `ValueError` for parameters outside their ranges.
    """

    t_1: Number = eqx.field(converter=as_float, default=2.0)
    t_2: Number = eqx.field(converter=as_float, default=6.0)
    c: Number = eqx.field(converter=as_float, default=0.6)

    def __check_init__(self):
        require_positive("Envelope", t_1=self.t_1)
        require("Envelope", "c", self.c, lambda v: v >= 0, "finite and >= 0")
        require(
            "Envelope",
            "t_2 − t_1",
            self.t_2 - self.t_1,
            lambda v: v >= 0,
            ">= 0, because the decay follows the rise",
        )

    def __call__(self, t: Float[Array, "*m"]) -> Float[Array, "*m"]:
        rise = (jnp.minimum(t, self.t_1) / self.t_1) ** 2
        return rise * jnp.exp(-self.c * jnp.maximum(t - self.t_2, 0.0))


class RandomPulse(Module):
    """A near-fault pulse of random amplitude, period and phase (Mavroeidis & Papageorgiou 2003).

    The pulse is added to the filtered noise. Its amplitude, period and phase follow from the last three
    entries of the vector u, which determines the motion, by inverse transform sampling.

    - `amplitude`: distribution of the velocity amplitude A, a [`rockjax.Lognormal`][] [m/s]
    - `period`: distribution of the period T_p = 1/f_p, a [`rockjax.Lognormal`][] [s]
    - `gamma`: number of oscillations, > 1 [–]; `centre`: time of the middle of the pulse [s]

    The phase ν is uniform in [0, 2π]. Raises `ValueError` for parameters outside their ranges, for a median
    that is not > 0, and for a dispersion < 0.
    """

    amplitude: Lognormal
    period: Lognormal
    gamma: Number = eqx.field(converter=as_float, default=2.0)
    centre: Number = eqx.field(converter=as_float, default=4.0)

    dimension = 3

    def __check_init__(self):
        for name, y in (("amplitude", self.amplitude), ("period", self.period)):
            require("RandomPulse", f"{name}.median", y.median, lambda v: v > 0, "finite and > 0")
            require("RandomPulse", f"{name}.dispersion", y.dispersion, lambda v: v >= 0, "finite and >= 0")
        require("RandomPulse", "gamma", self.gamma, lambda v: v > 1, "finite and > 1")
        require_finite("RandomPulse", centre=self.centre)

    def __call__(self, u: Float[Array, " 3"], t: Float[Array, " n"]) -> Float[Array, " n"]:
        """Return ü_g of the pulse that u determines, at times t [s], shape (n,) [m/s²]."""
        amplitude, period = (
            y.median * jnp.exp(y.dispersion * u[k]) for k, y in enumerate((self.amplitude, self.period))
        )
        phase = 2 * math.pi * norm.cdf(u[2])
        pulse = MavroeidisPapageorgiou(amplitude, 1 / period, self.gamma, phase)
        pulse_time = t - self.centre
        start, end = pulse.support
        piece = jax.vmap(pulse.piece(jnp.ones((), jnp.int32)))
        return jnp.where((pulse_time >= start) & (pulse_time <= end), piece(pulse_time), 0.0)


def _as_tuple(filters: Any) -> tuple:
    return tuple(filters) if isinstance(filters, Iterable) else (filters,)


class GaussianMotion(Module):
    """Random ground motions: white noise passed through the filters of Kanai–Tajimi and Clough–Penzien.

    A vector u of independent standard normal numbers determines the motion. Without a pulse the ground
    acceleration is ü_g = A u, where the matrix A depends only on the parameters. The pulse is optional and is
    added to A u.

    - `n`: number of samples, ≥ 2; `dt`: sampling interval, > 0 [s]
    - `S_0`: two-sided spectral density of the white noise, > 0 [m²/s³]
    - `omega_g`, `zeta_g`: frequency [rad/s] and damping ratio [–] of the soil, > 0
    - `omega_f`, `zeta_f`: frequency [rad/s] and damping ratio [–] of the high-pass filter, > 0
    - `envelope`: function t ↦ e(t), by default a [`rockjax.Envelope`][]
    - `pulse`: a [`rockjax.RandomPulse`][], or None
    - `filters`: one [`rockjax.Filter`][] or more, which follow the soil and the high-pass filter in this
      order

    Motions are differentiable with respect to u and every parameter. [`rockjax.synthetic_motions`][] is a
    different model. It filters stationary noise first, then applies Saragoni & Hart's envelope, corrects the
    motion so that it ends at rest, and scales it to a PGA. Here the envelope comes before the filters, so
    velocity and displacement decay without a correction.

    Raises `ValueError` for parameters outside their ranges.
    """

    n: int = eqx.field(static=True)
    dt: Number = eqx.field(converter=as_float)
    S_0: Number = eqx.field(converter=as_float)
    omega_g: Number = eqx.field(converter=as_float, default=15.0)
    zeta_g: Number = eqx.field(converter=as_float, default=0.6)
    omega_f: Number = eqx.field(converter=as_float, default=1.5)
    zeta_f: Number = eqx.field(converter=as_float, default=0.6)
    envelope: Any = eqx.field(default_factory=Envelope)
    pulse: RandomPulse | None = None
    filters: tuple[Filter, ...] = eqx.field(default=(), converter=_as_tuple)

    def __check_init__(self):
        require_whole("GaussianMotion", "n", self.n, 2)
        parameters = {
            name: getattr(self, name) for name in ("dt", "S_0", "omega_g", "zeta_g", "omega_f", "zeta_f")
        }
        require_positive("GaussianMotion", **parameters)
        if not callable(self.envelope):
            raise ValueError(f"GaussianMotion: envelope must be a function of time, got {self.envelope!r}")
        for stage in self.filters:
            if not isinstance(stage, Filter):
                raise ValueError(
                    f"GaussianMotion: filters must be one or more instances of rockjax.Filter, got {stage!r}"
                )

    @property
    def dimension(self) -> int:
        """Length of u: n, plus 3 if there is a pulse."""
        return self.n + (0 if self.pulse is None else self.pulse.dimension)

    @property
    def t(self) -> Float[Array, " n"]:
        """Times of the samples [s]."""
        return jnp.arange(self.n, dtype=float) * self.dt

    def acceleration(self, u: Float[Array, "*batch d"]) -> Float[Array, "*batch n"]:
        """Return ü_g at the samples, shape (…, n) [m/s²], for u of shape (…, dimension)."""
        u = as_float(u)
        if u.ndim == 0 or u.shape[-1] != self.dimension:
            raise ValueError(f"GaussianMotion: u must have shape (…, {self.dimension}), got {u.shape}")
        return _acceleration(self, u)

    def _single_acceleration(self, u: Float[Array, " d"]) -> Float[Array, " n"]:
        """Return ü_g, shape (n,) [m/s²], for one u, shape (d,)."""
        transition, gain, output = self._discrete_filters()

        def advance(state, w):
            return transition @ state + w * gain, output @ state

        noise = u[: self.n] * self._noise_deviation()
        _, motion = jax.lax.scan(advance, jnp.zeros(len(output), u.dtype), noise)
        return motion if self.pulse is None else motion + self.pulse(u[self.n :], self.t)

    def _noise_deviation(self) -> Float[Array, " n"]:
        """Return the standard deviation of the noise w at every sample, shape (n,) [m/s²]."""
        return self.envelope(self.t) * jnp.sqrt(2 * math.pi * self.S_0 / self.dt)

    def record(self, u: Float[Array, "*batch d"]) -> Record:
        """Return the motion that u determines as a record; a batch of records if u has batch axes."""
        return Record(self.acceleration(u), self.dt)

    def _discrete_filters(self) -> tuple[Float[Array, "k k"], Float[Array, " k"], Float[Array, " k"]]:
        """Return the matrices (Φ, Γ, C) that describe the filters in discrete time. The states s are x, ẋ, y,
        ẏ, and two more for each further filter. Over a sampling interval with the noise w, they advance from
        s to Φ s + Γ w. This is exact, because w is constant in the interval. The motion is ü_g = C s."""
        zero, one = jnp.zeros(()), jnp.ones(())
        stiff_g, damp_g = self.omega_g**2, 2 * self.zeta_g * self.omega_g
        stiff_f, damp_f = self.omega_f**2, 2 * self.zeta_f * self.omega_f
        output = jnp.stack([-stiff_g, -damp_g, -stiff_f, -damp_f])
        dynamics = jnp.stack(
            [
                jnp.stack([zero, one, zero, zero]),
                jnp.stack([-stiff_g, -damp_g, zero, zero]),
                jnp.stack([zero, zero, zero, one]),
                output,
            ]
        )
        dynamics, output = append_filters(dynamics, output, self.filters)
        size = len(output)
        block = jnp.zeros((size + 1, size + 1)).at[:size, :size].set(dynamics).at[1, size].set(-1.0)
        # If the period of a filter is much shorter than dt, the matrix is large and needs many squarings.
        block = jax.scipy.linalg.expm(block * self.dt, max_squarings=MAX_SQUARINGS)
        return block[:size, :size], block[:size, size], output

    def standard_deviation(self) -> Float[Array, " n"]:
        """Return the exact standard deviation of ü_g at the samples, without the pulse, shape (n,)
        [m/s²]."""
        transition, gain, output = self._discrete_filters()

        def advance(covariance, s):
            added = s**2 * jnp.outer(gain, gain)
            return transition @ covariance @ transition.T + added, output @ covariance @ output

        _, variance = jax.lax.scan(advance, jnp.zeros_like(transition), self._noise_deviation())
        # The first sample has the variance 0, at which the square root has no derivative.
        is_positive = variance > 0
        return jnp.where(is_positive, jnp.sqrt(jnp.where(is_positive, variance, 1.0)), 0.0)

    def scaled(self, factor) -> Self:
        """Return the model whose motions are `factor` times as strong, with `factor` > 0.

        S₀ is multiplied by the square of the factor, and the median amplitude of the pulse by the factor.
        """
        motion = eqx.tree_at(lambda m: m.S_0, self, self.S_0 * jnp.asarray(factor, float) ** 2)
        if self.pulse is None:
            return motion
        median = self.pulse.amplitude.median * factor
        return eqx.tree_at(lambda m: m.pulse.amplitude.median, motion, jnp.asarray(median, float))

    def response_spectrum(
        self,
        periods: Iterable[float] = (0.1, 0.2, 0.5, 1.0, 2.0),
        *,
        damping: float = 0.05,
        count: int = 200,
        seed: int = 0,
    ) -> xarray.Dataset:
        """Return statistics of the pseudo-acceleration spectra of sampled motions.

        - `periods`: periods, ≥ 0 [s]; `damping`: damping ratio, 0 ≤ ζ < 1 [–]
        - `count`: number of motions, ≥ 2; `seed`: seed of the random numbers; equal seeds give equal results

        Returns a Dataset over `period`: `median`, `fractile_16` and `fractile_84` of Sa [m/s²], and
        `dispersion`, the standard deviation of ln Sa [–]. Motions are taken to be linear between samples; for
        such motions Sa is exact. Raises `ValueError` for arguments outside their ranges.
        """
        owner = "GaussianMotion.response_spectrum"
        require_whole(owner, "count", count, 2)
        import xarray

        records = Records.of([self.record(u) for u in np.asarray(self.samples(count, seed=seed))])
        motions = as_motions(owner, records)
        measures = intensity_measures(motions, periods=periods, damping=damping, owner=owner)
        Sa, period = measures["Sa"].values, measures["period"]
        low, middle, high = np.quantile(Sa, [0.16, 0.5, 0.84], axis=0)
        dispersion = np.std(np.log(Sa), axis=0, ddof=1)
        return xarray.Dataset(
            {
                "median": as_variable("period", middle, "m s-2", "median Sa"),
                "fractile_16": as_variable("period", low, "m s-2", "16 % fractile of Sa"),
                "fractile_84": as_variable("period", high, "m s-2", "84 % fractile of Sa"),
                "dispersion": as_variable("period", dispersion, "1", "dispersion of Sa over motions"),
            },
            coords={"period": period},
            attrs={"title": "Response spectrum of a GaussianMotion", "damping": damping, "count": count},
        )

    def samples(self, count: int, *, seed: int) -> Float[Array, "count d"]:
        """Return standard normal u, shape (count, dimension); equal seeds give equal samples."""
        require_whole("GaussianMotion.samples", "count", count, 1)
        return as_float(np.random.default_rng(seed).standard_normal((count, self.dimension)))


def _filtered(motion: GaussianMotion, u: Float[Array, "*batch d"]) -> Float[Array, "*batch n"]:
    """Return ü_g, shape (…, n) [m/s²], for a batch of u, shape (…, d)."""
    return jnp.vectorize(motion._single_acceleration, signature="(d)->(n)")(u)


_acceleration = StoredProgram(_filtered)
