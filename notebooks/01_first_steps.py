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
# # First steps
#
# This notebook defines a podium by its dimensions and computes its response to a ground motion: the peak
# response, the history with its pictures, and a rocking spectrum. The last sections are about units, errors
# and options.
#
# A podium structure stands on free columns, which lift off at one edge and rock in a strong earthquake. If
# the rotation $\theta$ reaches the slenderness $\alpha$ of a column, the structure overturns.

# %%
import os

import matplotlib.pyplot as plt
import numpy as np

import rockjax as rj
from rockjax import plots

REDUCED = os.environ.get("ROCKJAX_NOTEBOOKS") == "reduced"  # small grids and a rigid building, for the tests

# %% [markdown]
# ## A podium
#
# Widths and heights are full dimensions in metres, masses are in kilograms, and there are two columns unless
# `columns=` gives another number. The building on top has a period of half a second on a fixed base. Without
# `period` it would be rigid; without `top_mass` there would be none.

# %%
podium = rj.Podium.from_dimensions(
    width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3, top_mass=300e3, period=None if REDUCED else 0.5
)
podium

# %% [markdown]
# The theory uses the slenderness $\alpha$, the half diagonal $R$, and the masses of beam and building divided
# by the mass of the columns, $\gamma$ and $\eta$. Quantities that follow from them are properties. `replace`
# returns a variant; a podium itself never changes.

# %%
print(f"frequency parameter p   {podium.p:.4f} rad/s")
print(f"the ground lifts it at  {podium.uplift_ground_acceleration / podium.g:.4f} g, applied slowly")
print(f"velocity factor e       {podium.restitution_factor:.4f}")
print(f"α of a wider column     {podium.replace(alpha=0.2).alpha} rad")

# %% [markdown]
# ## A ground motion
#
# Pulses have an amplitude in m/s² and a period in seconds. They are functions of time.

# %%
pulse = rj.Ricker(a_p=3.2, T_p=1.0)
t = np.linspace(*pulse.support, 400)

ax = plt.figure(figsize=(6, 2.4), layout="constrained").add_subplot()
ax.plot(t, pulse(t) / podium.g, color=plots.COLOURS[0])
ax.set(xlabel="time [s]", ylabel=r"$\ddot u_g$ [g]", title="Symmetric Ricker pulse")
ax.grid(alpha=0.3)

# %% [markdown]
# ## The peak response
#
# The first call compiles a program, which takes some seconds. Later calls with other values take about a
# millisecond.

# %%
peak = rj.peak_response(podium, pulse)
peak

# %% [markdown]
# `peak_rotation` is $\max|\theta|/\alpha$; 1 means overturning. `peak_shear` is the base shear of the
# building divided by its weight.

# %%
print(f"rotation     {peak.peak_rotation:.4f} α = {np.degrees(peak.peak_rotation * podium.alpha):.2f}°")
print(f"deformation  {1e3 * peak.peak_deformation:.1f} mm")
print(f"shear        {peak.peak_shear:.3f} of the weight of the building")

# %% [markdown]
# ## The history
#
# `simulate` returns the whole history. It can be evaluated at any time, with the accuracy of the solution.

# %%
history = rj.simulate(podium, pulse, t_end=8.0)
state = history(np.linspace(0, 2, 5))  # theta, theta_dot, u_t, u_t_dot
print("rotation [rad]", np.asarray(state.theta).round(5))
print("impacts at [s]", np.asarray(history.impact_times[:5]).round(4))

# %%
data = history.dataset()  # the same as an xarray.Dataset, with energies and moment
figure = plots.response(data)

# %% [markdown]
# The strip under the rotation shows full contact and rocking to the left or right. Each impact dissipates
# energy and makes the building sway.
#
# The next picture shows the rate against the rotation. Impacts are jumps towards zero rate. The dashed curves
# bound the states from which a rigid frame returns to rest without further ground motion; outside them it
# overturns.

# %%
ax = plots.phase_portrait(data)

# %% [markdown]
# The restoring moment decreases while the frame rocks, from its value at uplift to zero at $\alpha$. The
# weight and the size of the structure keep it upright, not a stiffness.

# %%
ax = plots.moment_rotation(data)

# %% [markdown]
# The work of the ground equals the energy of the structure plus the energy that impacts and damping have
# dissipated.

# %%
ax = plots.energy_balance(data)

# %% [markdown]
# ## A spectrum
#
# A rocking spectrum is the peak rotation as a function of the ratios $\omega_p/p$ and $a_p/(g\tan\alpha)$ of
# a pulse. A scene is one structure under one ground motion; all scenes of the spectrum are solved in one
# batch on all cores. Only the rotation is requested here, so nothing else is computed.

# %%
n = 12 if REDUCED else 80
only = rj.Options(outputs=("peak_rotation",))
spectrum = rj.rocking_spectrum(podium, rj.Ricker, np.linspace(1, 8, n), np.linspace(1, 12, n), options=only)
ax = plots.rocking_spectrum(spectrum)
plots.rotation_bar(ax)
print(
    f"{spectrum.overturned.values.mean():.0%} of {spectrum.peak_rotation.size} scenes overturn: the blank "
    f"part"
)

# %% [markdown]
# A spectrum is an `xarray.Dataset` with units and parameters in its attributes.
# `spectrum.to_netcdf("spectrum.nc")` writes it to a file.

# %%
print(spectrum.peak_rotation.attrs)
print(
    {name: spectrum.attrs[name] for name in ("alpha_rad", "R_m", "eta", "T_s_s", "rtol", "rockjax_version")}
)
print(spectrum.peak_rotation.sel(frequency_ratio=3, acceleration_ratio=2, method="nearest").item())

# %% [markdown]
# ## Units
#
# All quantities are in metres, kilograms, seconds and radians. Accelerations are in m/s², so half of $g$ is
# `0.5 * podium.g`. Quantities whose names end in `_ratio` are dimensionless.
#
# ## Results
#
# Every scene has a named result. `settled` and `end_of_time` mean survival, `overturned` means overturning.
# Other results, such as `out_of_steps` or `not_finite`, mean that the scene did not finish; a single scene
# then raises an error.

# %%
strong = rj.peak_response(podium, rj.Ricker(a_p=5.0, T_p=1.0))
print(bool(strong.result == rj.RESULTS.overturned), f"at t = {strong.overturn_time:.3f} s")
print(bool(peak.result == rj.RESULTS.settled), rj.RESULTS[peak.result])

# %% [markdown]
# Invalid inputs raise an error that names the input and the reason.

# %%
try:
    rj.Ricker(a_p=3.0, T_p=-1.0)
except ValueError as error:
    print(error)

# %% [markdown]
# ## Options
#
# The default of `rtol` is 1e-8. Other tolerances use the same compiled program; other `outputs` need another
# program.

# %%
exact = rj.peak_response(podium, pulse, options=rj.Options(rtol=1e-12, atol=1e-14)).peak_rotation
for rtol in (1e-4, 1e-6, 1e-8, 1e-10):
    rotation = rj.peak_response(podium, pulse, options=rj.Options(rtol=rtol, atol=0.01 * rtol)).peak_rotation
    print(f"rtol {rtol:.0e}: peak rotation {rotation:.12f}, off by {abs(rotation - exact):.0e}")

# %% [markdown]
# ## Next
#
# - [`02_the_paper`](02_the_paper.py): the figures of the underlying paper, and three contradictions in it
# - [`03_spectra_and_boundaries`](03_spectra_and_boundaries.py): when does a podium overturn?
# - [`04_column_sizing`](04_column_sizing.py): how wide must the columns be?
# - [`07_gradients_explained`](07_gradients_explained.py): derivatives through uplift and all impacts
# - [Getting started](../docs/getting-started.md), [the model](../docs/model.md), [sharp
#   bits](../docs/sharp-bits.md)
