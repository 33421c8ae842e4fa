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
# How do the slenderness of the columns and the mass of the building affect overturning under a suite of
# earthquakes? This is a study of structures × records × scales. The notebook solves it in chunks that are
# saved on disk, reads the results, and shows the recovery of a damaged chunk.

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
# Columns of equal half diagonal carry a rigid building. Their slenderness, the mass of the building, the
# synthetic record and its scale vary. Every combination is a scene. The grid stores only its axes.

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
# ## Expected cost
#
# A dry run solves a sample of the scenes and estimates time, memory and disk space.

# %%
rj.sweep(*scenes, store="study.zarr", outputs=["peak_rotation"], dry_run=True, progress=False)

# %% [markdown]
# ## The sweep
#
# All cores of this machine solve the chunks one after another and write them to the store. With `client=` a
# Dask cluster solves them; see [Sweeps and clusters](../docs/cluster.md). The chunks are small here, so that
# there are several.

# %%
data = rj.sweep(
    *scenes, store="study.zarr", outputs=["peak_rotation"], chunk=scenes.size // 5, progress=False
)
data

# %% [markdown]
# The dataset is lazy: its values are read when they are needed. The picture shows the share of the suite that
# overturns the podium, for one mass of the building.

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
# The next picture compares a light and a heavy building. As in the paper, the mass of the building has little
# effect, because the whole frame rocks like one larger block.

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
# ## Recovery of damaged chunks
#
# The store contains a checksum of each chunk. Here a file of one chunk is cut in half, as a full disk might
# do. The same call verifies all chunks and solves the damaged one again, with a warning.

# %%
victim = sorted(Path("study.zarr/peak_rotation/c").rglob("*"))[-1]
before = data["peak_rotation"].compute()
victim.write_bytes(victim.read_bytes()[: victim.stat().st_size // 2])

# %%
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    data = rj.sweep(*scenes, store="study.zarr", outputs=["peak_rotation"], progress=False)
print(*{str(warning.message) for warning in caught}, sep="\n")
print("equal results:", bool((data["peak_rotation"] == before).all()))

# %% [markdown]
# Another study cannot use this store by mistake:

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
# - [Sweeps and clusters](../docs/cluster.md): SSH, Slurm and Kubernetes, and failures of machines
# - [`05_records_and_fragility`](05_records_and_fragility.py): fragility curves with confidence bands
