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
# # Spectra and boundaries
#
# When does a podium overturn? A rocking spectrum gives a first answer, on a grid. This notebook goes on to
# the boundary itself, to the windows of survival above it, and to how sure an answer is.

# %%
import math
import os

import matplotlib.pyplot as plt
import numpy as np

import rockjax as rj
from rockjax import plots

REDUCED = os.environ.get("ROCKJAX_NOTEBOOKS") == "reduced"  # small grids, for the tests

podium = rj.Podium(alpha=math.atan(0.15), R=1.5, gamma=10.0, superstructure=rj.Rigid(eta=100.0))
unit = podium.g * math.tan(podium.alpha)  # g tan α

# %% [markdown]
# ## A rocking spectrum
#
# Peak rotation over the frequency and the amplitude of a pulse. Each point is a scene of its own, with all
# its impacts. Beside the rotation this notebook asks for the overturning margin and for estimated errors,
# of which more below.

# %%
n = 16 if REDUCED else 120
options = rj.Options(outputs=("peak_rotation", "margin", "errors"))
spectrum = rj.rocking_spectrum(
    podium, rj.Ricker, np.linspace(1, 8, n), np.linspace(1, 12, n), options=options
)
ax = plots.rocking_spectrum(spectrum)
plots.dimensional_axes(spectrum, ax)
bar = plots.rotation_bar(ax, pad=0.15)

# %% [markdown]
# The least overturning amplitude can be read off the grid, to within a step of it.

# %%
least = rj.minimum_overturning(spectrum)
print(least.sel(frequency_ratio=3, method="nearest").item(), "± a step of", round(11 / (n - 1), 3))

# %% [markdown]
# ## The margin
#
# Near the boundary the peak rotation climbs to 1 ever more steeply, and stays there beyond. The overturning
# margin goes through zero with a slope. It is the energy to spare at the turning point where that is least,
# over the depth of the well; below zero it says how hard the columns fall.
# [Overturning](../docs/overturning.md) has the definition.

# %%
ratio = np.linspace(0.8, 5, 40 if REDUCED else 400)
line = rj.rocking_spectrum(podium, rj.Ricker, [3.0], ratio, options=options).sel(frequency_ratio=3.0)

ax = plt.figure(figsize=(6, 3.2), layout="constrained").add_subplot()
ax.plot(ratio, line.peak_rotation, color=plots.COLOURS[2], label="peak " + plots.ROTATION)
ax.plot(ratio, line.margin, color=plots.COLOURS[1], linestyle="--", label="overturning margin")
ax.axhline(0, color="0.7", lw=0.6, zorder=0)
ax.set(xlabel=plots.ACCELERATION_RATIO, ylabel="[–]", xlim=(ratio[0], ratio[-1]))
ax.grid(alpha=0.3)
legend = ax.legend()

# %% [markdown]
# ## The boundary
#
# `overturning_acceleration` is the least amplitude that overturns, from a scan and a refinement of its lowest
# change. Under `jax.grad` it has derivatives, see [`07_gradients_explained`](07_gradients_explained.py).

# %%
T_p = 2 * math.pi / (3 * podium.p)  # ω_p/p = 3
least = rj.overturning_acceleration(podium, rj.Ricker, T_p)
print(f"overturns from {least:.6f} m/s² = {least / unit:.6f} g tan α")

# %% [markdown]
# ## All boundaries over frequency
#
# Survival is not monotone: above the least overturning amplitude there are windows in which the podium
# survives again, after another sequence of impacts. `overturning_spectrum` finds the boundaries. The shaded
# parts are windows of survival.

# %%
frequencies = np.linspace(1.2, 6, 7 if REDUCED else 121)
boundaries = rj.overturning_spectrum(podium, rj.Ricker, frequencies)
ax = plots.overturning_spectrum(boundaries, color=plots.COLOURS[2])
plots.dimensional_axes(boundaries, ax)
ax.grid(alpha=0.3)

# %% [markdown]
# At $\omega_p/p=2$ alone there are fifteen boundaries. The numbers in brackets are the impacts before
# overturning.

# %%
at_two = rj.overturning_spectrum(podium, rj.Ricker, [2.0], max_acceleration_ratio=3.0).isel(frequency_ratio=0)
for place, impacts in zip(at_two.boundaries.values, at_two.impacts.values, strict=True):
    print(f"{place:.6f} ({impacts})", end="  ")

# %% [markdown]
# Near the lowest boundary, at longer pulses, the windows are wide enough to matter: a stronger pulse may be
# survived where a weaker one is not. A design must not rely on them. It must stay below the lowest.

# %%
x = np.linspace(1.5, 2.1, 5 if REDUCED else 121)
windows = rj.overturning_spectrum(podium, rj.Ricker, x, max_acceleration_ratio=3.0)
ax = plots.overturning_spectrum(windows, color=plots.COLOURS[2])
ax.set_ylim(1.4, 3.0)
ax.grid(alpha=0.3)

# %% [markdown]
# ## How sure is an answer?
#
# With `"errors"` each scene is solved a second time in another way, and the difference estimates its error.
# Where the estimate leaves open whether the columns overturn, the scene is `undecided`: it lies that close
# to a boundary. Here with a very loose tolerance, among the bands at $\omega_p/p=2$:

# %%
n = 20 if REDUCED else 100
x, y = np.linspace(1.9, 2.1, n), np.linspace(2.0, 2.6, n)
loose = options.replace(rtol=1e-3, atol=1e-5)
checked = rj.rocking_spectrum(podium, rj.Ricker, x, y, options=loose)

ax = plots.rocking_spectrum(checked)
row, column = np.nonzero(checked.undecided.values)
ax.plot(x[column], y[row], ".", ms=4, color=plots.COLOURS[1], label="undecided at rtol = 1e-3")
legend = ax.legend(loc="lower right")

# %% [markdown]
# With tighter tolerances fewer are left. Nothing is compiled for that: tolerances are numbers.

# %%
for rtol in (1e-3, 1e-5, 1e-8):
    tolerances = options.replace(rtol=rtol, atol=0.01 * rtol)
    solved = rj.rocking_spectrum(podium, rj.Ricker, x, y, options=tolerances)
    print(f"rtol {rtol:.0e}: {int(solved.undecided.sum()):4d} of {solved.undecided.size} scenes undecided")

# %% [markdown]
# ## Next
#
# - [`04_column_sizing`](04_column_sizing.py): from boundaries to dimensions
# - [`05_records_and_fragility`](05_records_and_fragility.py): records in the place of pulses
# - [`06_speed_and_accuracy`](06_speed_and_accuracy.py): what an error costs
# - [Overturning](../docs/overturning.md): the margin, the search, and its limits
