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
# # Records and fragility
#
# This notebook reads a suite of earthquake records, computes intensity measures, and scales the records until
# the podium overturns. The results are a fragility curve and the sensitivities of its median.

# %%
import os

import matplotlib.pyplot as plt
import numpy as np

import rockjax as rj
from rockjax import plots

REDUCED = os.environ.get("ROCKJAX_NOTEBOOKS") == "reduced"  # small grids, for the tests

podium = rj.Podium.from_dimensions(width=0.36, height=2.4, column_mass=1.5e3, beam_mass=30e3, top_mass=300e3)

# %% [markdown]
# ## A suite of files
#
# **Use your own records here.** Fill the folder `suite/` with files of PEER, ESM, CSMIP, COSMOS, K-NET, or
# plain text, and omit the next cell. [Ground motion files](../docs/records.md) describes formats, units and
# tables of scale factors.
#
# The next cell writes synthetic motions: filtered noise under an envelope, with a velocity pulse as in
# records near a fault. They serve as an example and do not replace records.

# %%
pulse = rj.MavroeidisPapageorgiou(A=0.5, f_p=0.7, gamma=2.0, nu=0.5)
count = 6 if REDUCED else 40
for motion in rj.synthetic_motions(
    count, seed=1, duration=8.0 if REDUCED else 20.0, dt=0.02, pga=2.0, pulse=pulse
):
    motion.save(f"suite/{motion.name}.AT2")

# %%
suite = rj.read_suite("suite")
suite

# %% [markdown]
# The picture shows acceleration and velocity of one motion. The pulse is visible in the
# velocity.

# %%
motion = suite[0]
axes = plt.figure(figsize=(8, 3.6), layout="constrained").subplots(2, 1, sharex=True)
axes[0].plot(motion.time, motion.acceleration / podium.g, color=plots.COLOURS[0], lw=0.8)
axes[1].plot(motion.time, motion.velocity, color=plots.COLOURS[2])
axes[0].set(ylabel=r"$\ddot u_g$ [g]", title=motion.name)
axes[1].set(xlabel="time [s]", ylabel=r"$\dot u_g$ [m/s]", xlim=(0, motion.duration))
for ax in axes:
    ax.grid(alpha=0.3)

# %% [markdown]
# ## Intensity measures
#
# Intensity measures are an `xarray.Dataset` with units. With a podium it also contains the ratios that govern
# rocking: for bare columns or a rigid building, $\mathrm{PGA}/(g\tan\alpha)$ must exceed 1 for uplift.

# %%
measures = rj.intensity_measures(suite, periods=(0.5, 1.0), podium=podium)
for name in ("PGA", "PGV", "CAV", "D5_95", "acceleration_ratio", "velocity_ratio"):
    values, units = measures[name].values, measures[name].attrs["units"]
    print(f"{name:20s} {np.median(values):8.3f}  from {values.min():.3f} to {values.max():.3f}  [{units}]")

# %% [markdown]
# ## Incremental dynamic analysis
#
# Every record is scaled to increasing intensities. `rj.Records` stores the samples once for all scenes, even
# if lengths and intervals differ. The intensity is PGA here; `rj.Measure` defines others. The analysis
# computes the responses at the levels and the least overturning intensity of each record.

# %%
records = rj.Records.of(suite.records())
levels = np.linspace(0.5, 6.0, 8 if REDUCED else 60)
resolution = 32 if REDUCED else 128  # number of intervals of the first scan for boundaries
options = rj.Options(rtol=1e-9, atol=1e-11, method="tsit5", outputs=("peak_rotation",))
analysis = rj.incremental_dynamic_analysis(
    podium,
    records,
    levels,
    names=suite.names,
    sensitivities=("alpha", "R"),
    resolution=resolution,
    options=options,
)
print(
    f"{analysis.attrs['scenes']} scenes; "
    f"{int(np.isfinite(analysis.capacity).sum())} of {len(records)} records overturn"
)

# %%
ax = plots.incremental_dynamic_analysis(analysis)

# %% [markdown]
# A stronger motion may rotate the columns less, so the curves also decrease. Under some records the podium
# survives again above the first overturning intensity.

# %%
with_windows = (analysis.boundaries.notnull().sum("boundary") > 1).sum().item()
print(f"windows of survival above the least overturning intensity: {with_windows} of {len(records)} records")

# %% [markdown]
# ## Fragility
#
# A lognormal distribution is fitted to the capacities (the least overturning intensities) by maximum
# likelihood. Of records that do not overturn the podium, the fit uses only that their capacity is above the
# highest level. The confidence band follows from the profile likelihood.

# %%
fragility = rj.fragility(analysis)
low, high = fragility.interval.sel(quantity="median_capacity").values
print(f"median {fragility.median_capacity.item():.3f} m/s² (90 %: {low:.3f} to {high:.3f})")
print(f"dispersion {fragility.dispersion.item():.3f}")

# %%
ax = plots.fragility(fragility)

# %% [markdown]
# ## Sensitivities of the median
#
# The derivative of the median follows from the derivatives of the capacities, by the implicit function
# theorem at the maximum of the likelihood. The cell prints the change of the median in per cent if the
# slenderness or the size increases by one per cent:

# %%
for name in fragility.parameter.values:
    print(f"{name:6s} {fragility.median_sensitivity.sel(parameter=name).item():+.3f} % per %")

# %% [markdown]
# As a check, the next cell computes the median for columns of the same size with an $\alpha$
# larger by five per cent:

# %%
wider = rj.incremental_dynamic_analysis(
    podium.replace(alpha=1.05 * podium.alpha), records, levels, resolution=resolution, options=options
)
shifted = rj.fragility(wider, confidence=None)
ratio = np.log(shifted.median_capacity.item() / fragility.median_capacity.item()) / np.log(1.05)
print(f"from two analyses: {ratio:+.3f} % per %")

# %% [markdown]
# Both values agree only if no capacity jumps to another overturning window. A jump shifts the median, and
# derivatives do not include it.
#
# ## Next
#
# - [`07_gradients_explained`](07_gradients_explained.py): derivatives of boundaries
# - `optimise.OverturningProbability` in [Design](../docs/design.md): columns for a given probability
# - [Ground motion files](../docs/records.md), [Fragility](../docs/fragility.md)
