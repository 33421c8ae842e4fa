"""`fit`: identify parameters of a podium from a measured rotation by least squares.

The search has one or more starting points (starts). Scaled variables x are 0 and 1 at their bounds.
"""

from __future__ import annotations

import time
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Float

import rockjax as rj
from rockjax._responses.arguments import check_overturn_ratio
from rockjax.internal import (
    AnyMotion,
    Module,
    as_excitation,
    as_float,
    require_instance,
    require_number,
    require_whole,
)

from ._suite import has_answer
from ._variables import Structure, Variables, as_podium, make_variables

# Lengths of successive time windows, as fractions of the duration of strong rotation; the last window covers
# all times.
WINDOWS = (0.15, 0.25, 0.4, 0.6, 1.0)
# Strong rotation lasts from the first to the last time at which |θ| is at least this fraction of its peak.
STRONG_RATIO = 0.1
# Smallest distance of starting points from the bounds, in scaled variables. At a bound the slope of
# `_to_unit_interval` is zero, so a search that started there would stay there.
MIN_BOUND_DISTANCE = 1e-3
MAX_STEPS = 40  # largest number of steps of the solver in each window
DRAWS_PER_START = 16  # random points for each start after the first; the best in the first window is used


class Fit(Module):
    """A fitted podium with its standard errors.

    - `podium`: the fitted podium; `structure`: the fitted structure in the type that was passed to
      `optimise.fit`, a `rockjax.Podium` or an `optimise.Dimensions`
    - `variables`: name → value, in `units`; `errors`: name → standard error, in `units`, from the Jacobian
      and the scatter of the residuals. All errors are inf if the measurement does not determine every
      variable or has no more times than there are variables; the error of a variable at a bound is only a
      rough indication
    - `covariance`: covariance matrix of the variables, in `units` and in the order of `variables`
    - `residuals`: measured minus fitted θ at each time, shape (n,) [rad]; `rms`: their root mean square
      [rad]. Both are inf if no start led to a podium whose simulation finishes
    - `starts`: `rms` of the fit from every start [rad]; `best`: index of the start with the returned fit;
      `converged`: whether the solver converged for this start in the last time window
    - `units`: name → unit
    - `seconds`: wall time, including compilation [s]
    """

    podium: rj.Podium
    structure: Structure
    variables: dict[str, float]
    errors: dict[str, float]
    covariance: np.ndarray
    rms: float
    residuals: np.ndarray
    starts: np.ndarray
    best: int
    converged: bool
    units: dict[str, str]
    seconds: float

    def __repr__(self):
        state = "converged" if self.converged else "not converged"
        if not np.isfinite(self.rms):
            state = "a simulation did not finish; raise history or max_steps of options"
        lines = [f"Fit: rms {self.rms:.3g} rad, {state}"]
        width = max(len(name) for name in self.variables)
        lines += [
            f"  {name.ljust(width)}  {value:.8g} ± {self.errors[name]:.2g} {self.units[name]}"
            for name, value in self.variables.items()
        ]
        count = int(np.sum(self.starts <= 1.01 * self.rms))
        lines.append(f"  {count} of {len(self.starts)} starts reached this fit; {self.seconds:.1f} s")
        return "\n".join(lines)


def _check_measurement(times, theta, variable_count: int, earliest: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times and rotations as arrays; raise `ValueError` if they are invalid, if there are fewer than
    variables, or if they begin before `earliest`, the start of the excitation [s]."""
    times, theta = (
        np.asarray(as_float(y, f"fit: {name}")) for name, y in (("times", times), ("theta", theta))
    )
    if times.ndim != 1 or times.shape != theta.shape or len(times) < 2:
        raise ValueError(
            f"fit: times and theta must be vectors of equal length ≥ 2, got {times.shape} and {theta.shape}"
        )
    if not (np.isfinite(times).all() and np.isfinite(theta).all() and (np.diff(times) > 0).all()):
        raise ValueError("fit: times and theta must be finite, and times must be ascending")
    if len(times) < variable_count:
        raise ValueError(
            f"fit: {len(times)} measurements do not determine {variable_count} variables; give more "
            "measurements or vary fewer"
        )
    if times[0] < earliest:
        raise ValueError(
            f"fit: times must not begin before the excitation, which starts at {earliest:g} s; got "
            f"times[0] = {times[0]:g} s"
        )
    return times, theta


def fit(
    podium: Structure,
    vary: Mapping[str, tuple[float, float]],
    excitation: AnyMotion,
    times: Float[ArrayLike, " n"],
    theta: Float[ArrayLike, " n"],
    *,
    initial: rj.State = rj.State(),
    starts: int = 1,
    seed: int = 0,
    options: rj.Options = rj.Options(rtol=1e-9, atol=1e-11, history=1024, throw=False),
    tolerance: float = 1e-8,
) -> Fit:
    """Fit parameters of a podium to a measured rotation θ(t) by least squares; outside jit.

    - `podium`, `vary`: as in [`optimise.design`][]; `podium` is the first start
    - `excitation`: the ground motion of the measurement
    - `times`: times of the measurement, ascending, not before the start of the excitation [s]; n ≥ 2, and at
      least the number of variables
    - `theta`: rotation measured at `times` [rad]
    - `initial`: the state at the start of the excitation
    - `starts`: number of starting points, ≥ 1; every start after the first is the best of 16 random points
    - `seed`: seed of the random numbers, ≥ 0
    - `options`: options of the simulations. A simulation with more than `options.history` steps does not
      finish; `options.throw` is ignored
    - `tolerance`: relative and absolute tolerance of the least-squares solver, > 0 [–]

    If the simulated rotation is out of phase with the measured one, the search direction is poor. The fit
    therefore starts with the measurements in a short time window, which covers the first impacts, and
    continues with longer windows. The method is Levenberg–Marquardt in transformed variables that stay within
    the bounds. Raises `ValueError` for invalid inputs.
    """
    start_time = time.perf_counter()
    variables = make_variables(podium, vary, "fit")
    excitation = as_excitation("fit", excitation)
    require_instance("fit", "options", options, rj.Options, "rockjax.Options")
    check_overturn_ratio("fit", variables.podium(np.asarray(variables.start())), options)
    require_number("fit", "tolerance", tolerance, lambda v: v > 0, "finite and > 0")
    require_whole("fit", "seed", seed, 0)
    times, theta = _check_measurement(times, theta, len(vary), float(excitation.support[0]))
    require_whole("fit", "starts", starts, 1)
    scene = _Scene(
        variables, excitation, jnp.asarray(times), jnp.asarray(theta), initial, options.replace(throw=False)
    )
    # Residuals are divided by the peak of the measured rotation, so that tolerances are relative.
    peak = jnp.asarray(float(np.max(np.abs(theta))) or 1.0)
    rng = np.random.default_rng(seed)
    n = len(variables.names)
    user_point = np.asarray(variables.start())
    draws = rng.uniform(size=(starts * DRAWS_PER_START, n))
    draws[0] = user_point
    windows = [_window_weights(times, theta, fraction) for fraction in WINDOWS]
    draw_costs = np.asarray(_costs(scene, jnp.asarray(draws), jnp.asarray(windows[0]), peak))
    # The first start begins at the user's structure, every other start at its draw with the least cost.
    best_draws = [
        k * DRAWS_PER_START + int(np.argmin(draw_costs[k * DRAWS_PER_START : (k + 1) * DRAWS_PER_START]))
        for k in range(starts)
    ]
    z = _from_unit_interval(
        jnp.clip(
            jnp.asarray(draws[best_draws]).at[0].set(user_point), MIN_BOUND_DISTANCE, 1 - MIN_BOUND_DISTANCE
        )
    )
    has_converged = None
    for window in windows:
        z, has_converged = _solve_window(scene, z, jnp.asarray(window), peak, jnp.asarray(tolerance))
    assert has_converged is not None
    ends = np.asarray(_to_unit_interval(z))
    residuals, slopes = (np.asarray(y) for y in _evaluate_residuals(scene, jnp.asarray(ends)))
    rms = np.sqrt(np.mean(residuals**2, axis=1))
    best = int(np.nanargmin(np.where(np.isfinite(rms), rms, np.inf)))
    value_slopes = np.asarray(jax.jacfwd(variables.values)(jnp.asarray(ends[best])))
    covariance = _covariance(residuals[best], slopes[best] @ np.linalg.inv(value_slopes))
    values = np.asarray(variables.values(jnp.asarray(ends[best])))
    fitted_values = dict(zip(variables.names, map(float, values), strict=True))
    bounds = zip(np.asarray(variables.lower).tolist(), np.asarray(variables.upper).tolist(), strict=True)
    structure = make_variables(podium, dict(zip(variables.names, bounds, strict=True))).structure(
        jnp.asarray(ends[best])
    )
    return Fit(
        podium=as_podium(structure),
        structure=structure,
        variables=fitted_values,
        errors=dict(zip(variables.names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        covariance=covariance,
        rms=float(rms[best]),
        residuals=residuals[best],
        starts=rms,
        best=best,
        converged=bool(np.asarray(has_converged)[best]),
        units=dict(zip(variables.names, variables.units, strict=True)),
        seconds=time.perf_counter() - start_time,
    )


class _Scene(Module):
    """A structure with varied parameters, its motion, and the rotation `theta` measured at `times`."""

    variables: Variables
    excitation: rj.AbstractExcitation
    times: Float[Array, " n"]
    theta: Float[Array, " n"]
    initial: rj.State
    options: rj.Options

    def residuals(self, x: Float[Array, " k"]) -> Float[Array, " n"]:
        """Return measured minus simulated rotation (n,) [rad] for scaled variables x; inf if the simulation
        did not finish. After overturning, the simulated rotation is α with the sign of the rotation at
        overturning. It is 0 after the columns have come to rest for good."""
        podium = self.variables.podium(x)
        response = rj.simulate(
            podium, self.excitation, initial=self.initial, t_end=self.times[-1], options=self.options
        )
        theta = response(self.times).theta
        last_time = jnp.where(jnp.isfinite(response.overturn_time), response.overturn_time, self.times[-1])
        sign = jnp.sign(response(jnp.minimum(last_time, response.stats.end_time), left=True).theta)
        is_overturned = self.times > last_time
        theta = jnp.where(is_overturned, sign * podium.alpha, jnp.where(jnp.isfinite(theta), theta, 0.0))
        return jnp.where(has_answer(response), self.theta - theta, jnp.inf)


def _window_weights(times: np.ndarray, theta: np.ndarray, fraction: float) -> np.ndarray:
    """Return the weights (n,) of the times in a window: 1 in the window, 0 after it. Its length is `fraction`
    times the duration of strong rotation (see `STRONG_RATIO`). It also covers all times before strong
    rotation and, with a fraction of 1, all times."""
    strong_times = times[np.abs(theta) >= STRONG_RATIO * np.max(np.abs(theta))]
    window_end = strong_times[0] + fraction * (strong_times[-1] - strong_times[0])
    return (times <= (window_end if fraction < 1 else np.inf)).astype(float)


def _to_unit_interval(z):
    """Map real numbers to [0, 1]."""
    return 0.5 * (1 + jnp.sin(z))


def _from_unit_interval(x):
    """Invert `_to_unit_interval`."""
    return jnp.arcsin(2 * x - 1)


@eqx.filter_jit
def _costs(scene: _Scene, points, weights, peak):
    """Return the mean square of the weighted residuals of each point [–], shape (k,); inf where the
    simulation did not finish. `points` are scaled variables (k, n), `weights` those of the times, (times,),
    and `peak` is the largest absolute measured rotation [rad], by which residuals are divided."""

    def cost(x):
        residuals = weights * scene.residuals(x) / peak
        return jnp.where(jnp.isfinite(residuals).all(), jnp.mean(residuals**2), jnp.inf)

    return jax.lax.map(cost, points, batch_size=8)


@eqx.filter_jit
def _solve_window(scene: _Scene, z, weights, peak, tolerance):
    """Fit one window from every start; return the transformed variables z (starts, n), as from
    `_from_unit_interval`, at the end, and whether the solver converged for each start. Other arguments are as
    for `_costs`."""
    solver = optx.LevenbergMarquardt(rtol=tolerance, atol=tolerance)

    def solve_start(z):
        solution = optx.least_squares(
            lambda z, _: weights * scene.residuals(_to_unit_interval(z)) / peak,
            solver,
            z,
            max_steps=MAX_STEPS,
            throw=False,
        )
        is_finite = jnp.isfinite(solution.value).all()
        return jnp.where(is_finite, solution.value, z), solution.result == optx.RESULTS.successful

    return jax.vmap(solve_start)(z)


@eqx.filter_jit
def _evaluate_residuals(scene: _Scene, points):
    """Return the residuals (starts, times) [rad] and their Jacobians (starts, times, n) at `points` (starts,
    n). Points and Jacobians are in scaled variables."""

    def at_point(x):
        def with_value(x):
            residuals = scene.residuals(x)
            return residuals, residuals

        slope, value = jax.jacfwd(with_value, has_aux=True)(x)
        return value, slope

    return jax.vmap(at_point)(points)


def _covariance(residuals: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return the covariance matrix s²(JᵀJ)⁻¹ of the unscaled variables (n, n), with the variance s² of the
    residuals (times,) [rad] and their Jacobian J (times, n). All entries are inf if J is rank-deficient, or
    square, so that the residuals do not show their scatter."""
    count, n = slope.shape
    information = slope.T @ slope
    norms = np.sqrt(np.diag(information))  # norms of the columns of J
    is_determined = (norms > 0).all() and np.linalg.cond(information / np.outer(norms, norms)) <= 1e14
    if count == n or not is_determined:
        return np.full((n, n), np.inf)
    return float(residuals @ residuals) / (count - n) * np.linalg.inv(information)
