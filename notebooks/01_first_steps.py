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
# A podium defined by its dimensions, a ground motion, and how the one answers the other: the peak response,
# the history with its pictures, a rocking spectrum. Then what to know about units, results and options.
#
# A podium structure stands on free columns. In a strong earthquake they lift off at their edges and rock.
# If $\theta$ reaches the slenderness $\alpha$ of a column, the weight passes its edge, and the structure
# overturns.

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
# Full widths and heights in metres, masses in kilograms, two columns unless `columns=` says otherwise. The
# building on top has a period of half a second on a fixed base. Without `period` it would be rigid, without
# `top_mass` there would be none.

# %%
podium = rj.Podium.from_dimensions(
    width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3, top_mass=300e3, period=None if REDUCED else 0.5
)
podium

# %% [markdown]
# The theory uses ratios: slenderness $\alpha$, half diagonal $R$, the masses of beam and building over that
# of the columns, $\gamma$ and $\eta$. What follows from them are properties. `replace` makes a variant; a
# podium itself never changes.

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
# The first call of a kind compiles for some seconds. Later ones take a millisecond, whatever the numbers.

# %%
peak = rj.peak_response(podium, pulse)
peak

# %% [markdown]
# `peak_rotation` is $\max|\theta|/\alpha$: 1 is overturning. `peak_shear` is the base shear of the building
# over its weight.

# %%
print(f"rotation     {peak.peak_rotation:.4f} α = {np.degrees(peak.peak_rotation * podium.alpha):.2f}°")
print(f"deformation  {1e3 * peak.peak_deformation:.1f} mm")
print(f"shear        {peak.peak_shear:.3f} of the weight of the building")

# %% [markdown]
# ## The history
#
# `simulate` keeps the motion itself. It can be evaluated at any time, with the accuracy of the solution.

# %%
history = rj.simulate(podium, pulse, t_end=8.0)
state = history(np.linspace(0, 2, 5))  # theta, theta_dot, u_t, u_t_dot
print("rotation [rad]", np.asarray(state.theta).round(5))
print("impacts at [s]", np.asarray(history.impact_times[:5]).round(4))

# %%
data = history.dataset()  # the same as an xarray.Dataset, with energies and moment
figure = plots.response(data)

# %% [markdown]
# The strip under the rotation tells full contact from rocking to the left and to the right. Each impact
# takes energy out of the structure, and makes the building sway.
#
# In the phase plane impacts are jumps towards rest. The dashed curves are the separatrices of the rigid
# frame: outside them, with the ground still, it would overturn.

# %%
ax = plots.phase_portrait(data)

# %% [markdown]
# The moment that holds the frame up falls while it rocks, from its value at uplift to nothing at $\alpha$.
# Rocking is not stiffness: the structure is held by its weight and its size.

# %%
ax = plots.moment_rotation(data)

# %% [markdown]
# Where the energy goes. What the ground puts in is what the structure has, plus what impacts and damper
# have taken.

# %%
ax = plots.energy_balance(data)

# %% [markdown]
# ## A spectrum
#
# All amplitudes and frequencies of a pulse, in the ratios of the field: $\omega_p/p$ and
# $a_p/(g\tan\alpha)$. The scenes are solved at once, on all cores. Only the rotation is asked for here, so
# nothing else is computed.

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
# A spectrum is an `xarray.Dataset`. It holds units and parameters, and is written to a file with
# `spectrum.to_netcdf("spectrum.nc")`.

# %%
print(spectrum.peak_rotation.attrs)
print(
    {name: spectrum.attrs[name] for name in ("alpha_rad", "R_m", "eta", "T_s_s", "rtol", "rockjax_version")}
)
print(spectrum.peak_rotation.sel(frequency_ratio=3, acceleration_ratio=2, method="nearest").item())

# %% [markdown]
# ## Units
#
# Metres, kilograms, seconds and radians, everywhere. Accelerations are in m/s², so half of $g$ is `0.5 *
# podium.g`. Names that end in `_ratio` have no unit.
#
# ## Results
#
# Every scene ends in a named result. `settled` and `end_of_time` are survival, `overturned` is what it
# says. A scene that runs `out_of_steps` or is `not_finite`, for instance, has no answer, and raises an error.

# %%
strong = rj.peak_response(podium, rj.Ricker(a_p=5.0, T_p=1.0))
print(bool(strong.result == rj.RESULTS.overturned), f"at t = {strong.overturn_time:.3f} s")
print(bool(peak.result == rj.RESULTS.settled), rj.RESULTS[peak.result])

# %% [markdown]
# Inputs that make no sense are errors that say which, and why.

# %%
try:
    rj.Ricker(a_p=3.0, T_p=-1.0)
except ValueError as error:
    print(error)

# %% [markdown]
# ## Options
#
# Tolerances are 1e-8 unless you say otherwise. Other tolerances compile nothing new, other `outputs` do.

# %%
exact = rj.peak_response(podium, pulse, options=rj.Options(rtol=1e-12, atol=1e-14)).peak_rotation
for rtol in (1e-4, 1e-6, 1e-8, 1e-10):
    rotation = rj.peak_response(podium, pulse, options=rj.Options(rtol=rtol, atol=0.01 * rtol)).peak_rotation
    print(f"rtol {rtol:.0e}: peak rotation {rotation:.12f}, off by {abs(rotation - exact):.0e}")

# %% [markdown]
# ## Next
#
# - [`02_the_paper`](02_the_paper.py): the theory's source, its figures, and where it contradicts itself
# - [`03_spectra_and_boundaries`](03_spectra_and_boundaries.py): when does it overturn?
# - [`04_column_sizing`](04_column_sizing.py): how wide must the columns be?
# - [`07_gradients_explained`](07_gradients_explained.py): every number can be differentiated, through uplift
#   and all impacts
# - [Getting started](../docs/getting-started.md), [the model](../docs/model.md), [sharp
#   bits](../docs/sharp-bits.md)
