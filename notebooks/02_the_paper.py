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
# # The paper, reproduced
#
# rockjax solves the equations of one paper on rocking podium structures. [The model](../docs/model.md) lists
# them with their numbers. This notebook reproduces two figures of the paper and shows three contradictions in
# it. No parameter is adjusted to reach a printed value. [Reproduction](../docs/reproduction.md) lists all
# results with more digits.

# %%
import math
import os

import matplotlib.pyplot as plt
import numpy as np

import rockjax as rj
from rockjax import plots

REDUCED = os.environ.get("ROCKJAX_NOTEBOOKS") == "reduced"  # small grids, for the tests

# %% [markdown]
# The columns of the paper have $\tan\alpha=0.15$ and $R=1.5$ m, so they are about 3 m high. Accelerations are
# divided by $g\tan\alpha$, the acceleration that lifts a rigid frame.

# %%
column = rj.Podium(alpha=math.atan(0.15), R=1.5, gamma=10.0)
unit = float(column.g) * 0.15
rotation = rj.Options(outputs=("peak_rotation",))
print(f"p = {column.p:.4f} rad/s; a pulse of 1 s has ω_p/p = {2 * math.pi / column.p:.3f}")

# %% [markdown]
# ## Rocking spectra: Fig. 6 of the paper
#
# Peak rotation under symmetric Ricker pulses, for three mass ratios $\eta/\gamma$ and four periods of the
# building. "$T_s=0$" means a rigid building. The paper does not give the damping ratio; here it is 0.05.

# %%
ratios, periods = ((1.0, 10.0), (0.0,)) if REDUCED else ((1.0, 5.0, 10.0), (0.0, 0.1, 0.5, 1.0))
n = 12 if REDUCED else 60


def building(eta, T_s):
    return rj.Rigid(eta) if T_s == 0 else rj.Elastic(eta, T_s)


podiums = [column.replace(superstructure=building(10 * ratio, T_s)) for ratio in ratios for T_s in periods]
axes_of_spectra = np.linspace(1, 8, n), np.linspace(1, 12, n)  # ω_p/p and a_p/(g tan α)
spectra = [rj.rocking_spectrum(podium, rj.Ricker, *axes_of_spectra, options=rotation) for podium in podiums]

# %%
figure = plt.figure(figsize=(2.6 * len(periods), 2.3 * len(ratios)), layout="constrained")
axes = figure.subplots(len(ratios), len(periods), sharex=True, sharey=True, squeeze=False)
for panel, ax, podium in zip(spectra, axes.flat, podiums, strict=True):
    plots.rocking_spectrum(panel, ax)
    ax.set_title(
        rf"$\eta/\gamma = {podium.superstructure.eta / 10:g}$, $T_s = {panel.attrs['T_s_s']:g}$ s", fontsize=9
    )
    ax.label_outer()
bar = plots.rotation_bar(axes)

# %% [markdown]
# Scenes that overturn are blank. A flexible building changes the overturning amplitudes: it raises those
# under short pulses.
#
# ## Least overturning acceleration: Fig. 7 of the paper

# %%
figure = plt.figure(figsize=(3.4 * len(ratios), 3), layout="constrained")
axes = figure.subplots(1, len(ratios), sharey=True)
for row, (ax, ratio) in enumerate(zip(axes, ratios, strict=True)):
    for k, T_s in enumerate(periods):
        panel = spectra[row * len(periods) + k]
        style = {"color": plots.COLOURS[k], "linestyle": plots.STYLES[k]}
        plots.overturning_curve(panel, ax, label=rf"$T_s = {T_s:g}$ s", **style)
    ax.set(title=rf"$\eta/\gamma = {ratio:g}$", ylim=(0, 12))
    ax.grid(alpha=0.3)
    ax.label_outer()
legend = axes[0].legend()

# %% [markdown]
# The curves have steps because of the grid. `rockjax overturning` and the next notebook compute the
# boundaries without a grid.
#
# ## First contradiction: Eq. (6) counts the columns twice
#
# Eq. (6) is the virtual work at incipient uplift. Its third term contains the mass of the columns instead of
# the mass of the building. Eqs. (8) and (9) follow only with the mass of the building. With $\gamma=10$ and
# $\eta=100$:

# %%
gamma, eta = 10.0, 100.0
podium = column.replace(superstructure=rj.Elastic(eta, T_s=0.5))
as_printed = (1 + 2 * gamma + 1) / (1 + 2 * gamma)
with_building = (1 + 2 * gamma + 2 * eta) / (1 + 2 * gamma)
print(f"Eq. (6) as printed   {as_printed:8.4f} g tan α")
print(f"with the building    {with_building:8.4f} g tan α")
print(f"rockjax, Eq. (9)     {podium.uplift_demand / unit:8.4f} g tan α")

# %% [markdown]
# ## Second contradiction: Eqs. (26) and (27) at an impact
#
# In Eq. (26) the top mass keeps its velocity at an impact; Eq. (27), the velocity factor $e$, assumes that it
# moves with the beam. With (26), the angular momentum about the new edges leads to another factor. rockjax
# provides both factors: `"paper"`, the default, and `"compatible"`.
#
# Which factor is correct for a very stiff building? The podium is released from $\alpha/2$. After the first
# impact the building vibrates until damping stops it. The energy has then been multiplied by the square of an
# effective velocity factor.

# %%
theta = column.alpha / 2
u_b = 2 * column.R * (np.sin(column.alpha) - np.sin(column.alpha - theta))  # the building starts undeformed


def effective_factor(podium):
    history = rj.simulate(podium, rj.Rest(), initial=rj.State(theta, 0.0, u_b, 0.0), t_end=2.5)
    first, second = history.impact_times[:2]
    before, after = history.energy(np.array([0.99 * first, 0.5 * (first + second)]))
    return np.sqrt(after / before)


stiff = [0.05, 0.02] if REDUCED else [0.2, 0.1, 0.05, 0.02, 0.01, 0.005]
factors = {}
for law in ("paper", "compatible"):
    e = podium.replace(
        restitution=law
    ).restitution_factor  # given as a number, so that one program serves both laws
    stiffer = [column.replace(superstructure=rj.Elastic(eta, T_s), restitution=e) for T_s in stiff]
    factors[law] = [effective_factor(each) for each in stiffer]
rigid = column.replace(superstructure=rj.Rigid(eta)).restitution_factor

# %%
ax = plt.figure(figsize=(6, 3), layout="constrained").add_subplot()
for k, (law, values) in enumerate(factors.items()):
    ax.semilogx(
        stiff,
        values,
        "os"[k],
        color=plots.COLOURS[k + 1],
        linestyle=plots.STYLES[k],
        label=f"{law} restitution",
    )
ax.axhline(rigid, color=plots.COLOURS[0], linestyle=":", label="rigid building")
ax.set(xlabel=r"period of the building $T_s$ [s]", ylabel="effective velocity factor")
ax.grid(alpha=0.3)
legend = ax.legend()

# %% [markdown]
# As $T_s\to0$, the effective factor of the compatible law tends to the factor of the rigid building. With the
# law of the paper it does not: much less energy is dissipated. Therefore "$T_s=0$" means `Rigid` in rockjax,
# not a small period.
#
# ## Third contradiction: the numbers quoted in Section 4
#
# For a rigid building, $\gamma+\eta=110$ and a Ricker pulse of 1 s, the text states "3.5 times the uplift
# acceleration to overturn" and "$\theta/\alpha=0.29$ at 2.5 times". The equations lead to other values.
# `overturning_acceleration` finds the exact boundary.

# %%
frame = column.replace(superstructure=rj.Rigid(100.0))


def section_four(podium, T_p):
    least = rj.overturning_acceleration(podium, rj.Ricker, T_p) / unit
    peak = rj.peak_response(podium, rj.Ricker(2.5 * unit, T_p), options=rotation)
    return f"overturns from {least:.3f}, θ/α = {peak.peak_rotation:.3f} at 2.5"


factor = (1 + 2 * 110) / (1 + 3 * 110)
print("the paper's text             overturns from 3.5,   θ/α = 0.29 at 2.5")
print("its equations, T_p = 1 s    ", section_four(frame, 1.0))
print("its equations, T_p = 0.8 s  ", section_four(frame, 0.8))
print("the factor of (25) twice    ", section_four(frame.replace(R=frame.R / factor), 1.0))

# %% [markdown]
# A pulse of 0.8 s would lead to the printed values. The factor $(1+2\gamma)/(1+3\gamma)$ of the
# equivalent block, applied twice, agrees less with them but better with other remarks of the section. The
# text does not reveal how the printed values were computed.
#
# ## Survival is not monotone
#
# At $\omega_p/p=2$ the outcome for the same frame changes fifteen times between survival and overturning as
# the amplitude increases. Bisection finds one of these changes, and a coarse scan misses bands.

# %%
amplitude = np.linspace(2.0, 2.6, 600 if REDUCED else 6000)
line = rj.rocking_spectrum(frame, rj.Ricker, [2.0], amplitude, options=rotation).sel(frequency_ratio=2.0)
overturned = line.overturned.values
changes = amplitude[1:][np.diff(overturned)]

ax = plt.figure(figsize=(8, 2.8), layout="constrained").add_subplot()
ax.fill_between(amplitude, 0, 1, where=overturned, step="mid", color="0.85", label="overturns")
ax.plot(
    amplitude, line.peak_rotation.where(~line.overturned), ".", ms=3, color=plots.COLOURS[2], label="survives"
)
ax.set(xlabel=plots.ACCELERATION_RATIO, ylabel="peak " + plots.ROTATION, xlim=(2.0, 2.6), ylim=(0, 1.05))
ax.legend(loc="lower right")
print(f"{len(changes)} changes on this grid, the first at {changes[0]:.4f}, the last at {changes[-1]:.4f}")

# %% [markdown]
# ## Next
#
# - [`03_spectra_and_boundaries`](03_spectra_and_boundaries.py) finds such bands without a fine grid.
# - [Reproduction](../docs/reproduction.md) compares published overturning accelerations and free rocking with
#   results of rockjax.
# - [The model](../docs/model.md) describes how rockjax resolves open points of the paper.
