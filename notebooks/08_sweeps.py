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
# # Sweeps
#
# How do the proportions of the columns and the mass on top of them decide what a suite of earthquakes does?
# That is a study of structures × records × scales. This notebook runs it in chunks that are kept on disk,
# reads them back, and shows what happens when a chunk is lost.

# %%
import os
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import rockjax as rj
from rockjax import plots

REDUCED = os.environ.get("ROCKJAX_NOTEBOOKS") == "reduced"  # small grids, for the tests

# %% [markdown]
# ## The scenes
#
# Columns of one half diagonal under a rigid building: slenderness and building mass vary, under a suite of
# synthetic records, scaled. Every combination is a scene. The grid holds only its axes.

# %%
podium = rj.Podium(alpha=0.15, R=1.5, gamma=10.0, superstructure=rj.Rigid(50.0))
suite = rj.synthetic_motions(
    4 if REDUCED else 20, seed=3, duration=8.0 if REDUCED else 15.0, dt=0.02, pga=2.0
)
fine = 5 if REDUCED else 25
scenes = rj.grid(
    podium,
    suite,
    tan_alpha=np.linspace(0.08, 0.24, fine),
    eta=np.geomspace(5.0, 500.0, 3 if REDUCED else 7),
    scale=np.linspace(0.25, 4.0, fine),
)
scenes

# %% [markdown]
# ## What will it take?
#
# The dry run solves a sample of the scenes. For a study of hours, this is the time to think again.

# %%
rj.sweep(*scenes, store="study.zarr", outputs=["peak_rotation"], dry_run=True, progress=False)

# %% [markdown]
# ## The sweep
#
# All cores of this machine, chunk by chunk into the store. With `client=` a Dask cluster does the same,
# see [Sweeps and clusters](../docs/cluster.md). Small chunks here, to have some.

# %%
data = rj.sweep(
    *scenes, store="study.zarr", outputs=["peak_rotation"], chunk=scenes.size // 5, progress=False
)
data

# %% [markdown]
# The dataset is lazy: nothing has been read yet. How large a share of the suite overturns, at one building
# mass?

# %%
share = data["overturned"].mean("motion").compute()
middle = share.isel(eta=share.sizes["eta"] // 2)
fig, ax = plt.subplots(figsize=(6, 4), layout="constrained")
filled = middle.transpose("scale", "tan_alpha")
shown = ax.contourf(filled["tan_alpha"], filled["scale"], filled, np.linspace(0, 1, 11), cmap="cividis")
ax.set(
    xlabel=r"$\tan\alpha$", ylabel="factor on the suite [–]", title=rf"$\eta$ = {float(middle['eta']):.3g}"
)
fig.colorbar(shown, label="share of the suite that overturns [–]")
plt.show()

# %% [markdown]
# Along the other axis: a heavier building on the same columns. As in the paper, the mass on top hardly
# matters: the whole frame rocks like one larger block.

# %%
fig, ax = plt.subplots(figsize=(6, 4), layout="constrained")
styles = ["-", "--", ":"]
for k, (style, colour) in enumerate(zip(styles, plots.COLOURS, strict=False)):
    line = share.isel(tan_alpha=(k + 1) * fine // 4, eta=[0, -1])
    for j, width in ((0, 1.0), (1, 2.2)):
        label = rf"tan α = {float(line['tan_alpha']):.2f}, η = {float(line['eta'][j]):.3g}"
        ax.plot(line["scale"], line.isel(eta=j), style, color=colour, lw=width, label=label)
ax.set(xlabel="factor on the suite [–]", ylabel="share that overturns [–]")
ax.legend(loc="lower right")
plt.show()

# %% [markdown]
# ## When something is lost
#
# The store knows which chunks it holds, and the checksum of each. Here a file of the second chunk is cut in
# half, as a full disk or a failing one would leave it. The same call finds it, and solves that chunk again:
# the others are verified and left. (The warning is what a user sees.)

# %%
victim = sorted(Path("study.zarr/peak_rotation/c").rglob("*"))[-1]
before = data["peak_rotation"].compute()
victim.write_bytes(victim.read_bytes()[: victim.stat().st_size // 2])

# %%
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    data = rj.sweep(*scenes, store="study.zarr", outputs=["peak_rotation"], progress=False)
print(*{str(warning.message) for warning in said}, sep="\n")
print("the same numbers:", bool((data["peak_rotation"] == before).all()))

# %% [markdown]
# Another study does not get into this store by accident:

# %%
try:
    rj.sweep(
        *scenes, store="study.zarr", outputs=["peak_rotation"], options=rj.Options(rtol=1e-6), progress=False
    )
except ValueError as error:
    print(error)

# %% [markdown]
# ## Next
#
# - `rockjax sweep` does the same from a [problem file](../docs/command-line.md), with `--workers` or
#   `--scheduler`.
# - [Sweeps and clusters](../docs/cluster.md): SSH, Slurm and Kubernetes, and what happens when machines die.
# - [`05_records_and_fragility`](05_records_and_fragility.py) makes a curve of such shares, with its bands.
