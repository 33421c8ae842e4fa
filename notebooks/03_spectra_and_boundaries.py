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
# When does a podium overturn? A rocking spectrum gives a first answer, on a grid. This notebook also computes
# the least amplitude that overturns the podium, the windows of survival above it, and the errors of the
# results.

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
# The spectrum is the peak rotation against the frequency and the amplitude of a pulse. Each point is a
# separate simulation with all impacts. The overturning margin and estimated errors are explained below.

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
# The grid gives the least overturning amplitude with the accuracy of one grid step.

# %%
least = rj.minimum_overturning(spectrum)
print(least.sel(frequency_ratio=3, method="nearest").item(), "± a step of", round(11 / (n - 1), 3))

# %% [markdown]
# ## The overturning margin
#
# The *boundary* is the amplitude at which the outcome changes between survival and overturning. Towards the
# boundary the peak rotation rises to 1 ever more steeply, and beyond the boundary it is 1. The overturning
# margin passes through zero with a finite slope. If the podium survives, the margin is roughly the energy
# that was missing for overturning, divided by the energy that overturns the podium from rest. If it is
# negative, the podium overturns. [Overturning](../docs/overturning.md) has the definition.

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
# `overturning_acceleration` scans the amplitudes and refines the least one that overturns. It can be
# differentiated by `jax.grad`; see [`07_gradients_explained`](07_gradients_explained.py).

# %%
T_p = 2 * math.pi / (3 * podium.p)  # ω_p/p = 3
least = rj.overturning_acceleration(podium, rj.Ricker, T_p)
print(f"overturns from {least:.6f} m/s² = {least / unit:.6f} g tan α")

# %% [markdown]
# ## All boundaries against frequency
#
# Above the least overturning amplitude there are windows in which the podium survives again, after another
# sequence of impacts. `overturning_spectrum` finds their boundaries. Windows of survival are shaded.

# %%
frequencies = np.linspace(1.2, 6, 7 if REDUCED else 121)
boundaries = rj.overturning_spectrum(podium, rj.Ricker, frequencies)
ax = plots.overturning_spectrum(boundaries, color=plots.COLOURS[2])
plots.dimensional_axes(boundaries, ax)
ax.grid(alpha=0.3)

# %% [markdown]
# At $\omega_p/p=2$ there are fifteen boundaries. The numbers of impacts before overturning are in brackets.

# %%
at_two = rj.overturning_spectrum(podium, rj.Ricker, [2.0], max_acceleration_ratio=3.0).isel(frequency_ratio=0)
for place, impacts in zip(at_two.boundaries.values, at_two.impacts.values, strict=True):
    print(f"{place:.6f} ({impacts})", end="  ")

# %% [markdown]
# Under longer pulses the windows near the lowest boundary are wide: the podium may survive a stronger pulse
# although a weaker one overturns it. A design must not rely on such windows: the amplitudes of its motions
# must stay below the lowest boundary.

# %%
x = np.linspace(1.5, 2.1, 5 if REDUCED else 121)
windows = rj.overturning_spectrum(podium, rj.Ricker, x, max_acceleration_ratio=3.0)
ax = plots.overturning_spectrum(windows, color=plots.COLOURS[2])
ax.set_ylim(1.4, 3.0)
ax.grid(alpha=0.3)

# %% [markdown]
# ## How accurate is a result?
#
# With `"errors"` each scene is solved a second time with another tolerance, and the difference is an estimate
# of the error. A scene is `undecided` if it is so close to a boundary that an error of ten times the estimate
# could change the outcome, or if the two solutions diverge. The following example has a very large tolerance
# and amplitudes among the fifteen boundaries at $\omega_p/p=2$:

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
# With smaller tolerances fewer scenes are undecided. Other tolerances use the same compiled
# program.

# %%
for rtol in (1e-3, 1e-5, 1e-8):
    tolerances = options.replace(rtol=rtol, atol=0.01 * rtol)
    solved = rj.rocking_spectrum(podium, rj.Ricker, x, y, options=tolerances)
    print(f"rtol {rtol:.0e}: {int(solved.undecided.sum()):4d} of {solved.undecided.size} scenes undecided")

# %% [markdown]
# ## Next
#
# - [`04_column_sizing`](04_column_sizing.py): from boundaries to dimensions
# - [`05_records_and_fragility`](05_records_and_fragility.py): records instead of pulses
# - [`06_speed_and_accuracy`](06_speed_and_accuracy.py): run time and accuracy
# - [Overturning](../docs/overturning.md): the overturning margin, the search, and its limits
