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
# How wide must the columns of a podium be? First by hand, with sliders. Then by targets and exact
# gradients, as a chart over pulse periods, and from a problem file. The pulses here are examples. Choose
# yours, and the margins, for the site and for what [the model leaves
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
# `Dimensions` are those of the drawing. Unlike those of a `Podium`, its masses may vary too.

# %%
column = optimise.Dimensions(
    width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3, top_mass=300e3, period=None if REDUCED else 0.5
)
column.podium()

# %% [markdown]
# ## By hand
#
# Sliders for what may vary, of the structure and of the motion. The response at first stays in grey.
# Overturning ends a curve. An answer takes some hundredths of a second, most of it for the picture.

# %%
ranges = {"width": (0.2, 1.5), "beam_mass": (3e3, 300e3), "a_p": (0.5, 6.0), "T_p": (0.3, 2.0)}
ranges |= {} if REDUCED else {"period": (0.1, 1.5)}
study = optimise.explore(column, rj.Ricker(a_p=3.2, T_p=1.0), ranges)
study

# %% [markdown]
# The sliders can be moved by code as well, and say where they stand.

# %%
study.sliders["width"].value = 0.6
print(study.values)
print(f"peak rotation {float(study.peak.peak_rotation):.4f} α, margin {float(study.peak.margin):.3f}")

# %% [markdown]
# ## By targets
#
# The slimmest columns whose rotation stays below 0.4 α for these pulses, while the shear of the building
# stays below 0.45 of its weight. Wider columns turn less, but they hold the building harder. The margins
# and their derivatives are exact, through uplift and all impacts.

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
# A margin of 0 is a target that binds. Its shadow price says by how much the objective would fall if the
# limit were relaxed. Filled dots are designs that keep the targets, and each line is a start.

# %%
ax = optimise.convergence(answer)

# %% [markdown]
# Before and after, under the longest pulse.

# %%
figure = optimise.before_after(column.podium(), answer, pulses[2])

# %% [markdown]
# The design was simulated anew with a tolerance of 1e-11 before it was called satisfied.

# %%
print(answer.satisfied, {name: float(values.min()) for name, values in answer.margins.items()})
wide = float(answer.variables["width"])
print(f"width {wide:.4f} m; α = {answer.podium.alpha:.4f} rad")

# %% [markdown]
# ## A chart
#
# The least safe width for a Ricker pulse of given amplitude, over its period. Widths above the line
# survive; dots are further boundaries below it.

# %%
periods = np.linspace(0.6, 1.4, 3 if REDUCED else 25)
chart = optimise.design_chart(column, ("width", (0.1, 1.5)), rj.Ricker, [2.0, 3.0], periods)
ax = optimise.plot_chart(chart)

# %% [markdown]
# ## A problem file
#
# The same problem as text, for `rockjax design` or for `optimise.load`. Errors in it name the file and the
# entry.

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
# `problem.design()` finds the same columns as above, and so does `rockjax design column.toml`, with a
# table, the convergence and a response before and after as files.

# %% [markdown]
# ## How far does the answer reach?
#
# The design met its pulses. Others are in a spectrum. Where the blank part begins is what the columns can
# bear.

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
# - [`07_gradients_explained`](07_gradients_explained.py): where the derivatives come from
# - [Design](../docs/design.md): all targets, the method, and five studies
