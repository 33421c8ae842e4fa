# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Gradients explained
#
# A rocking column lifts, strikes the ground, and rocks on. Between these events its motion is smooth; at an
# impact the velocity jumps. What is the derivative of such a motion? This notebook computes the jump of the
# sensitivities at an impact by hand, compares gradients with finite differences, differentiates a boundary,
# and shows points without a derivative. [Gradients through events](../docs/gradients.md) has the theory.

# %%
import math
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import rockjax as rj
from rockjax import plots

REDUCED = os.environ.get("ROCKJAX_NOTEBOOKS") == "reduced"  # small grids, for the tests

podium = rj.Podium(alpha=math.atan(0.15), R=1.5, gamma=10.0, superstructure=rj.Rigid(eta=100.0))
unit = podium.g * math.tan(podium.alpha)  # g tan α
# Tight tolerances, because finite differences amplify errors.
tight = rj.Options(rtol=1e-12, atol=1e-14, outputs=("peak_rotation",), history=1024)

# %% [markdown]
# ## The jump at an impact
#
# The podium is released from $\theta_0$ on ground at rest. How does the state at a later time depend on
# $\theta_0$? With a slightly larger $\theta_0$ the impact comes slightly later. A derivative must include
# this shift of the impact time, not only the velocity jump.
#
# `simulate` can be differentiated. `jax.jvp` returns the state and its derivative.


# %%
@jax.jit
def state_and_slope(theta_0, t):
    def state(theta_0):
        history = rj.simulate(podium, rj.Rest(), initial=rj.State(theta_0), t_end=6.0, options=tight)
        at = history(t)
        return jnp.stack([at.theta, at.theta_dot]), history.impact_times

    return jax.jvp(state, (theta_0,), (jnp.ones_like(theta_0),))


theta_0 = 0.5 * podium.alpha
t = np.linspace(0, 5, 501)
(_, times), (_, d_times) = state_and_slope(theta_0, t)
impact, moved = float(times[0]), float(d_times[0])
print(f"the first impact at {impact:.6f} s; it moves by {moved:.6f} s per rad")

# %% [markdown]
# The following cell compares the derivatives $Y$ of the states just before and after the impact. With the
# accelerations $\ddot\theta^\pm$ on both sides, the saltation rule for an impact with the velocity factor $e$
# is
#
# $$Y_\theta^+=e\,Y_\theta^-,\qquad
# Y_{\dot\theta}^+=e\,Y_{\dot\theta}^-+\frac{\ddot\theta^+-e\,\ddot\theta^-}{\dot\theta^-}\,Y_\theta^-.$$

# %%
h = 1e-7  # s, to either side of the impact
# As many times as above, so that the compiled program can be used again.
sample_times = np.concatenate([impact + h * np.array([-2, -1, 1, 2]), t[4:]])
(x, _), (Y, _) = jax.tree.map(np.asarray, state_and_slope(theta_0, sample_times))
x, Y = x[:, :4], Y[:, :4]
before, after = (x[1, 1] - x[1, 0]) / h, (x[1, 3] - x[1, 2]) / h  # accelerations
e = float(podium.restitution_factor)
rule = np.array([e * Y[0, 1], e * Y[1, 1] + (after - e * before) / x[1, 1] * Y[0, 1]])
print("                        Y_θ          Y_θ̇")
print(f"before           {Y[0, 1]:10.6f}   {Y[1, 1]:10.6f}")
print(f"after            {Y[0, 2]:10.6f}   {Y[1, 2]:10.6f}")
print(f"by the rule      {rule[0]:10.6f}   {rule[1]:10.6f}")
print(f"velocity alone   {e * Y[0, 1]:10.6f}   {e * Y[1, 1]:10.6f}")
assert np.allclose(Y[:, 2], rule, rtol=1e-4)

# %% [markdown]
# The last printed line only multiplies the derivatives by $e$, and its error is large.
#
# The next picture shows the state over time, and its sensitivity, which jumps at every impact. Finite
# differences agree with it.

# %%
step = 1e-5
(x, _), (Y, _) = state_and_slope(theta_0, t)
(up, _), _ = state_and_slope(theta_0 + step, t)
(down, _), _ = state_and_slope(theta_0 - step, t)
differences = (up[0] - down[0]) / (2 * step)

axes = plt.figure(figsize=(7, 4.4), layout="constrained").subplots(2, 1, sharex=True)
axes[0].plot(t, x[0] / podium.alpha, color=plots.COLOURS[2])
axes[0].set(ylabel=plots.ROTATION)
axes[1].plot(t, Y[0], color=plots.COLOURS[1], label="derivative")
axes[1].plot(t[::10], differences[::10], ".", color=plots.COLOURS[0], ms=4, label="finite differences")
axes[1].set(ylabel=r"$\partial\theta/\partial\theta_0$", xlabel="time [s]", xlim=(0, 5))
axes[1].legend()
for ax in axes:
    ax.grid(alpha=0.3)

# %% [markdown]
# ## A gradient through many impacts
#
# This pulse, with $\omega_p/p=2$, leads to many impacts. Finite differences need a step that is neither too
# large nor too small; the gradient needs none.


# %%
@jax.jit
def rotation(alpha, pulse):
    """Return the peak rotation, its derivative with respect to α, and the peak response."""

    def value(alpha):
        peak = rj.peak_response(podium.replace(alpha=alpha), pulse, options=tight)
        return peak.peak_rotation, peak

    (value, peak), slope = jax.value_and_grad(value, has_aux=True)(alpha)
    return value, slope, peak


shaken = rj.Ricker(2.35 * unit, 1.4187)
value, exact, _ = rotation(podium.alpha, shaken)
response = rj.simulate(podium, shaken, options=tight)
before = np.asarray(response.impact_times) < float(response.peak_rotation_time)
print(
    f"peak rotation "
    f"{value:.4f} α after {before.sum()} of {before.size} impacts; derivative {exact:.6f} per rad"
)

steps = 10.0 ** -np.arange(3, 12, 1.0 if REDUCED else 0.25)
estimates = [
    (rotation(podium.alpha + h, shaken)[0] - rotation(podium.alpha - h, shaken)[0]) / (2 * h) for h in steps
]
relative_error = np.abs(np.array(estimates) / exact - 1)

ax = plt.figure(figsize=(6, 3.2), layout="constrained").add_subplot()
ax.loglog(steps, relative_error, "o-", ms=4, color=plots.COLOURS[2])
ax.set(xlabel="step of the finite differences [rad]", ylabel="relative distance\nto the gradient")
ax.grid(alpha=0.3)
assert relative_error.min() < 1e-5

# %% [markdown]
# Small steps amplify rounding errors. With large steps the differences are biased, or the order of events
# changes.
#
# ## The gradient of a boundary
#
# Near the overturning boundary $a^*$ the derivative of the peak grows without limit, because the column
# lingers at its unstable equilibrium. The boundary itself depends smoothly on $\alpha$. It is a zero of the
# overturning margin $M(a,\alpha)$, so by the implicit function theorem $\mathrm da^*/\mathrm
# d\alpha=-(\partial M/\partial\alpha)/(\partial M/\partial a)$.


# %%
@jax.jit
@jax.value_and_grad
def boundary(alpha):
    return rj.overturning_acceleration(podium.replace(alpha=alpha), rj.Ricker, T_p=1.0)


least, slope = boundary(podium.alpha)
h = 1e-5
differences = (boundary(podium.alpha + h)[0] - boundary(podium.alpha - h)[0]) / (2 * h)
print(f"the podium overturns from {least:.8f} m/s²")
print(f"derivative {slope:.6f}, by differences {differences:.6f} m/s² per rad")
assert abs(slope / differences - 1) < 1e-6

# %% [markdown]
# The derivative of the peak rotation of the same scene, at decreasing distances below the boundary:

# %%
for distance in (1e-1, 1e-2, 1e-3, 1e-4, 1e-6):
    value, slope_of_peak, _ = rotation(podium.alpha, rj.Ricker(least * (1 - distance), 1.0))
    print(f"{distance:.0e} below: peak {value:.6f} α, derivative {slope_of_peak:12.2f} per rad")
value, slope_of_peak, _ = rotation(podium.alpha, rj.Ricker(least * 1.001, 1.0))
print(f"just above:  peak {value:.6f} α, derivative {slope_of_peak:12.2f} per rad")

# %% [markdown]
# Beyond the boundary the peak is 1 by convention and its derivative is 0, so an optimiser needs the margin.
#
# ## Points without a derivative
#
# The picture shows the peak rotation over the amplitude, and its derivative with respect to $\alpha$. Where
# another maximum becomes the largest, the peak has a kink and its derivative jumps. Close to a grazing
# impact, an impact at almost no speed, the derivative is large and valid only in a small neighbourhood. It
# also grows towards each overturning boundary; where the columns overturn, the curves have gaps.

# %%
amplitude = np.linspace(1.9, 2.6, 60 if REDUCED else 2000)
rows = []
for ratio in amplitude:
    value, slope, peak = rotation(podium.alpha, rj.Ricker(ratio * unit, 1.4187))
    rows.append((value, slope, peak.smallest_impact_speed) if not peak.overturned else 3 * (np.nan,))
value, slope, speed = np.array(rows).T

axes = plt.figure(figsize=(8, 5), layout="constrained").subplots(3, 1, sharex=True)
axes[0].plot(amplitude, value, ".", ms=2, color=plots.COLOURS[2])
axes[1].semilogy(amplitude, np.abs(slope), ".", ms=2, color=plots.COLOURS[1])
axes[2].semilogy(amplitude, speed, ".", ms=2, color=plots.COLOURS[3])
axes[0].set(ylabel="peak " + plots.ROTATION)
axes[1].set(ylabel="absolute derivative\n[1/rad]")
axes[2].set(
    ylabel="slowest impact\nbefore the peak [rad/s]", xlabel=plots.ACCELERATION_RATIO, xlim=(1.9, 2.6)
)
for ax in axes:
    ax.grid(alpha=0.3)

# %% [markdown]
# `smallest_impact_speed` shows how close a scene is to a grazing impact. Derivatives after an impact grow
# like the inverse of its speed.
#
# Second derivatives raise an error: event times have correct first derivatives only, so second derivatives
# would be wrong.

# %%
try:
    jax.grad(lambda alpha: rotation(alpha, shaken)[1])(podium.alpha)
except NotImplementedError as error:
    print(error)

# %% [markdown]
# ## Next
#
# - [`04_column_sizing`](04_column_sizing.py): an application of gradients
# - [Gradients through events](../docs/gradients.md): uplift, peaks, reverse mode, records
# - [Overturning](../docs/overturning.md): margin and boundary
