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
# # Motion of the floors
#
# This notebook compares eight stories on a podium whose columns rock with the same stories fixed at the base:
# floor response spectra, and the rocking of a cabinet and a bookshelf on several floors.
# [Floors](../docs/floors.md) has the equations.

# %%
import os

import matplotlib.pyplot as plt
import numpy as np

import rockjax as rj

REDUCED = os.environ.get("ROCKJAX_NOTEBOOKS") == "reduced"  # fewer motions and levels, for the tests

# %% [markdown]
# ## Two buildings
#
# The podium has columns of 0.45 m by 3 m. With α = 1 the columns are wider than high and never lift under
# this motion, so the building on them is the same building with a fixed base.

# %%
podium = rj.Podium.from_dimensions(
    width=0.45,
    height=3.0,
    column_mass=1500.0,
    beam_mass=60e3,
    top_mass=400e3,
    period=0.8,
    stories=8,
)
fixed = podium.replace(alpha=1.0)
motion = rj.Ricker(3.5, 0.7)
rocking = rj.peak_response(podium, motion)
rocking, bool(rj.peak_response(fixed, motion).uplifted)

# %% [markdown]
# ## Floor response spectra
#
# Impacts of the columns change the velocity of the deck in an instant. The spectra contain these impulses
# exactly. If a building has all its modes, no horizontal impulse reaches its stories. Vertically every floor
# has the impulses of the deck.

# %%
periods = np.geomspace(0.05, 4.0, 40 if REDUCED else 200)
levels = ("deck", 8) if REDUCED else ("deck", 1, 4, 8)
spectra = rj.floor_spectrum(podium, motion, periods, level=levels, fixed_base=True)
rj.plots.floor_spectrum(spectra)

# %% [markdown]
# ## Vertical impulses
#
# The vertical jump of the deck's velocity at an impact is several times the horizontal one. Under a rigid
# building the vertical spectrum nevertheless exceeds the horizontal one only at periods below 0.07 s. The
# reason is that the columns come to rest in ever shorter hops. The deck's acceleration changes its sign at
# each of their impacts, which excites oscillators of all periods. The horizontal spectrum is therefore flat
# at eight times the deck's peak acceleration of 1.5 m/s². Under eight stories the deck is light, and the
# stories shake it between the impacts. The vertical impulses govern for stiff equipment on a rigid structure:
# for a period of 0.05 s, [Floors](../docs/floors.md#reading-the-numbers) has an example with 21.6 m/s²
# vertically and 5.4 m/s² horizontally.

# %%
stiff = rj.Podium.from_dimensions(
    width=0.45, height=3.0, column_mass=1500.0, beam_mass=60e3, top_mass=400e3
)  # without a period the building is rigid
fig, axes = plt.subplots(1, 2, sharey=True, figsize=(8, 4), layout="constrained")
for ax, structure, title in zip(axes, (stiff, podium), ("rigid building", "eight stories"), strict=True):
    for direction in ("horizontal", "vertical"):
        spectrum = rj.floor_spectrum(structure, motion, periods, level="deck", direction=direction)
        ax.loglog(periods, np.squeeze(spectrum.pseudo_acceleration), label=direction)
    ax.set(xlabel="period $T_e$ [s]", title=f"deck, {title}")
axes[0].set_ylabel("pseudo-acceleration [m/s²]")
axes[0].legend()

# %% [markdown]
# ## A cabinet and a bookshelf on each floor
#
# Both are light blocks that rock and do not slide. Their rotations are divided by the angle at which they
# overturn; 1 means overturning. `friction_demand` is the friction coefficient that keeps them from sliding.

# %%
stories = (1, 8) if REDUCED else tuple(range(1, 9))
systems = [
    rj.Contents.from_dimensions(width=width, height=height, level=level)
    for width, height in ((0.6, 1.8), (0.35, 2.0))
    for level in stories
]
answers = {
    name: rj.peak_response(structure, motion, on_floors=systems).on_floors
    for name, structure in (("podium", podium), ("fixed base", fixed))
}
rotations = {
    name: np.array([float(answer.peak_rotation) for answer in found]).reshape(2, -1)
    for name, found in answers.items()
}
fig, axes = plt.subplots(1, 2, sharey=True, figsize=(8, 4), layout="constrained")
titles = "cabinet, 0.6 m by 1.8 m", "bookshelf, 0.35 m by 2.0 m"
for row, (ax, title) in enumerate(zip(axes, titles, strict=True)):
    for name, mark in (("podium", "o-"), ("fixed base", "s--")):
        ax.plot(rotations[name][row], stories, mark, label=name)
    ax.set(xlabel=r"peak rotation $|\varphi|/\alpha_c$", title=title, xlim=(-0.05, 1.05), yticks=stories)
axes[0].set_ylabel("story")
axes[0].legend()

# %%
[float(answer.friction_demand) for answer in answers["podium"]]

# %% [markdown]
# The cabinets on the fifth and sixth story overturn in the building with a fixed base and stand on the
# podium. All bookshelves overturn, except the one on the first story above the podium. The impacts add short
# periods to the motions of the stories, but the podium removes the long periods, which overturn large blocks.
# The friction demands on the podium are between 0.21 and 0.54.
#
# ## Next
#
# - [Floors](../docs/floors.md): equations, suites, derivatives, and the limits of these spectra
# - [`11_joints`](11_joints.py): forces in the joints of the columns
