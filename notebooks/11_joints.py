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
# # Do the joints hold?
#
# The model assumes that joints do not slide and that the beam stays on all columns. This notebook checks both
# assumptions, and designs a frame for which they hold: spacing, width and number of the columns, and tendons.
# [Forces in the joints](../docs/forces.md) has the equations.

# %%
import os

import matplotlib.pyplot as plt
import numpy as np

import optimise
import rockjax as rj

REDUCED = os.environ.get("ROCKJAX_NOTEBOOKS") == "reduced"  # fewer starts and motions, for the tests
STARTS = 1 if REDUCED else 10

# %% [markdown]
# ## Forces along a history
#
# Two columns, 6 m apart, carry a building of T = 0.5 s whose mass is 9 m above the beam.

# %%
frame = optimise.Dimensions(
    width=0.45,
    height=3.0,
    column_mass=3e3,
    beam_mass=60e3,
    top_mass=180e3,
    period=0.5,
    positions=(0.0, 6.0),
    beam_depth=0.6,
    top_height=9.0,
)
podium = frame.podium()
motions = (
    [rj.Ricker(2.4, 1.0)] if REDUCED else [rj.Ricker(2.4, 1.0), rj.Ricker(2.0, 0.7), rj.OneSine(1.8, 1.2)]
)
outputs = ("peak_rotation", "peak_friction", "axial_force", "impact_friction")
options = rj.Options(outputs=outputs)
rj.peak_response(podium, motions[0], options=options)

# %%
response = rj.simulate(podium, motions[0], options=options)
t = np.linspace(float(response.times[0]), float(response.stats.end_time), 4000)
forces = response.joint_forces(t)
figure, axes = plt.subplots(2, 1, sharex=True, figsize=(8, 5), layout="constrained")
for column, label in enumerate(("left column", "right column")):
    axes[0].plot(t, forces.axial[:, column, 1], label=label, lw=1)
    axes[1].plot(t, np.minimum(forces.friction[:, column, 1], 1.0), label=label, lw=1)
axes[0].axhline(float(podium.dead_load[1]), color="0.6", lw=1, label="dead load")
axes[0].axhline(0.0, color="k", lw=1)
axes[1].axhline(float(np.tan(podium.alpha)), color="0.6", lw=1, label="tan α")
axes[0].set_ylabel("N / (m_c g), top joint")
axes[1].set(xlabel="t [s]", ylabel="|T|/N, top joint")
for ax in axes:
    ax.legend(fontsize="small")

# %% [markdown]
# The friction demand stays near tan α unless N is small. More critical is the axial force, which comes close
# to zero; below zero the beam would lift off.

# %% [markdown]
# ## The least spacing that keeps every joint closed
#
# `LeastAxialForce(0.0, …)` requires N ≥ 0 in every joint. Its margin is smooth through lift-off, so a search
# may start from a design with tension in the joints.

# %%
closed = optimise.LeastAxialForce(0.0, motions)


def spacing(podium):
    return podium.elevation.columns[1] - podium.elevation.columns[0]


narrowest = optimise.design(frame, {"position_2": (3.0, 20.0)}, spacing, [closed], starts=STARTS)
narrowest

# %% [markdown]
# ## Columns sized for rotation, with and without targets on the joints
#
# Wider columns rotate less, but they transmit a larger shear, which tends to lift the beam off some columns.
# So a larger width does not keep the joints closed.

# %%
rotation = optimise.PeakRotation(0.4, motions)


def width(podium):
    return podium.width


placed = frame.replace(positions=(0.0, float(narrowest.objective) * 1.05))
for targets in ([rotation], [rotation, closed]):
    print(optimise.design(placed, {"width": (0.3, 0.9)}, width, targets, starts=STARTS), "\n")

# %% [markdown]
# ## Tendon force against lift-off
#
# Tendons across both joints press the beam on the columns at rest. Is there a force that keeps the joints
# closed if the spacing is nine tenths of the least spacing found above?


# %%
def force(podium):
    return podium.restrainers[0].prestress


tight = frame.replace(
    positions=(0.0, 0.9 * float(narrowest.objective)), tendon_force=20e3, tendon_stiffness=2e6
)
optimise.design(tight, {"tendon_force": (1e3, 400e3)}, force, [closed], starts=STARTS)

# %% [markdown]
# ## The number of columns and their width
#
# Here more columns carry the same weight, and the distance between the outer columns stays the same. The
# middle columns carry a part of the load but little of the moment, so the joints open at a smaller moment.

# %%
for count in (2, 3) if REDUCED else (2, 3, 5):
    line = np.linspace(0.0, 1.4 * float(narrowest.objective), count)
    variant = frame.replace(positions=tuple(line), columns=count)
    answer = optimise.design(variant, {"width": (0.3, 0.9)}, width, [rotation, closed], starts=STARTS)
    print(f"{count} columns: width {answer.objective:.3f} m, satisfied {answer.satisfied}")

# %% [markdown]
# ## Next
#
# - [Forces in the joints](../docs/forces.md): equations, and what to do when a joint opens
# - [`04_column_sizing`](04_column_sizing.py): columns for rotation and overturning
