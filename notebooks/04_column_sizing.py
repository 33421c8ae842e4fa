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
# # Sizing columns
#
# How wide must the columns of a podium be? This notebook finds the width in four ways: by hand with sliders,
# by targets and exact gradients, by a chart against the pulse period, and by a problem file. The pulses are
# examples. Choose pulses and margins for your site and for the effects that [the model leaves
# out](../docs/sharp-bits.md#what-the-model-leaves-out).

# %%
import os
from pathlib import Path

import numpy as np

import optimise
import rockjax as rj
from rockjax import plots

REDUCED = os.environ.get("ROCKJAX_NOTEBOOKS") == "reduced"  # small grids and a rigid building, for the tests

# %% [markdown]
# ## A structure
#
# `Dimensions` describe a structure by lengths and masses. Any of them can be a design variable.

# %%
column = optimise.Dimensions(
    width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3, top_mass=300e3, period=None if REDUCED else 0.5
)
column.podium()

# %% [markdown]
# ## By hand
#
# Each slider varies a parameter of the structure or of the motion. The first response remains visible in
# grey. A curve ends if the podium overturns.

# %%
ranges = {"width": (0.2, 1.5), "beam_mass": (3e3, 300e3), "a_p": (0.5, 6.0), "T_p": (0.3, 2.0)}
ranges |= {} if REDUCED else {"period": (0.1, 1.5)}
study = optimise.explore(column, rj.Ricker(a_p=3.2, T_p=1.0), ranges)
study

# %% [markdown]
# Code can also set the sliders and read their values.

# %%
study.sliders["width"].value = 0.6
print(study.values)
print(f"peak rotation {float(study.peak.peak_rotation):.4f} α, margin {float(study.peak.margin):.3f}")

# %% [markdown]
# ## By targets
#
# The design problem is to find the slimmest columns whose rotation stays below 0.4 α under these pulses,
# while the shear of the building stays below 0.45 of its weight. Wider columns rotate less, but they
# transmit larger forces to the building. The derivatives of the margins are exact, through uplift and all
# impacts.

# %%
pulses = [rj.Ricker(4.0, 0.6), rj.Ricker(3.25, 1.0), rj.Ricker(2.5, 1.4)]


def slenderness(podium):
    return podium.alpha


answer = optimise.design(
    column,
    vary={"width": (0.2, 1.5)},
    minimise=slenderness,
    targets=[optimise.PeakRotation(0.4, pulses), optimise.PeakShear(0.45, pulses)],
    starts=4,
)
print(answer)

# %% [markdown]
# A target with a margin of 0 is active. Its shadow price is the decrease of the objective per relative
# increase of the limit. In the picture each line is a start, and filled dots are designs that satisfy the
# targets.

# %%
ax = optimise.convergence(answer)

# %% [markdown]
# The response before and after the design, under the longest pulse.

# %%
figure = optimise.before_after(column.podium(), answer, pulses[2])

# %% [markdown]
# Before the design is reported as satisfied, it is simulated again with a tolerance of 1e-11.

# %%
print(answer.satisfied, {name: float(values.min()) for name, values in answer.margins.items()})
wide = float(answer.variables["width"])
print(f"width {wide:.4f} m; α = {answer.podium.alpha:.4f} rad")

# %% [markdown]
# ## A chart
#
# The chart shows the smallest safe width for a Ricker pulse of given amplitude against the period of the
# pulse. Columns with widths above the line survive. Dots are further boundaries below the line.

# %%
periods = np.linspace(0.6, 1.4, 3 if REDUCED else 25)
chart = optimise.design_chart(column, ("width", (0.1, 1.5)), rj.Ricker, [2.0, 3.0], periods)
ax = optimise.plot_chart(chart)

# %% [markdown]
# ## A problem file
#
# A problem file describes the same problem for `rockjax design` or `optimise.load`. Error messages name the
# file and the entry.

# %%
period = "" if REDUCED else "period = 0.5  # s"
Path("column.toml").write_text(f"""
starts = 4

[structure]
width = 0.45          # m
height = 3.0          # m
column_mass = 1500.0  # kg
beam_mass = 30e3      # kg
top_mass = 300e3      # kg
{period}

[vary]
width = [0.2, 1.5]

[[motions.pulses]]
kind = "ricker"
a_p = [4.0, 3.25, 2.5]  # m/s²
T_p = [0.6, 1.0, 1.4]   # s

[minimise]
quantity = "alpha"

[[targets]]
kind = "peak-rotation"
limit = 0.4
motions = "pulses"

[[targets]]
kind = "peak-shear"
limit = 0.45
motions = "pulses"
""")
problem = optimise.load("column.toml")
print(problem.vary, problem.targets, sep="\n")

# %% [markdown]
# `problem.design()` finds the same columns as above. `rockjax design column.toml` does the same, prints a
# table, and writes pictures of the convergence and of the response before and after.

# %% [markdown]
# ## Other pulses
#
# The design satisfies the targets for three pulses. A spectrum shows the response to others. Where the
# spectrum is blank, the columns overturn.

# %%
n = 12 if REDUCED else 60
spectrum = rj.rocking_spectrum(
    answer.podium,
    rj.Ricker,
    np.linspace(1, 8, n),
    np.linspace(0.5, 6, n),
    options=rj.Options(outputs=("peak_rotation",)),
)
ax = plots.rocking_spectrum(spectrum)
plots.dimensional_axes(spectrum, ax)
unit = spectrum.attrs["g_m_s2"] * np.tan(spectrum.attrs["alpha_rad"])
p = spectrum.attrs["p_rad_s"]
x, y = (
    [float(v) for v in values]
    for values in zip(*((2 * np.pi / p / q.T_p, q.a_p / unit) for q in pulses), strict=True)
)
ax.plot(x, y, "o", color=plots.COLOURS[1], label="the pulses of the design")
bar = plots.rotation_bar(ax, pad=0.15)
legend = ax.legend()

# %% [markdown]
# ## Next
#
# - [`05_records_and_fragility`](05_records_and_fragility.py): records, and the probability of overturning
# - [`07_gradients_explained`](07_gradients_explained.py): how the derivatives are computed
# - [Design](../docs/design.md): all targets, the method, and five studies
