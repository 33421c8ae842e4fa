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
# # Devices and vertical motion
#
# Tendons and dampers beside rocking columns, and ground that moves vertically as well: what they do to the
# motion, to its energy, and to the peak rotation. [Tendons, dampers, inerters](../docs/control.md) has the
# equations.

# %%
import os

import jax
import matplotlib.pyplot as plt
import numpy as np

import rockjax as rj
from rockjax import plots

REDUCED = os.environ.get("ROCKJAX_NOTEBOOKS") == "reduced"  # small grids, for the tests

unrestrained = rj.Podium(alpha=0.15, R=1.5, gamma=10.0)
restrained = unrestrained.replace(
    restrainers=(rj.Tendon(prestress=2.0, stiffness=60.0), rj.Damper(coefficient=15.0))
)
pulse = rj.OneSine(3.0, 0.8)
for name, podium in (("bare", unrestrained), ("held", restrained)):
    lifts, stable = float(podium.uplift_ground_acceleration), float(podium.stability_angle)
    print(f"{name}: columns lift at {lifts:.3f} m/s², static stability ends at {stable:.3f} rad")

# %% [markdown]
# ## Loops and energy
#
# The moment over the rotation falls for bare columns; tendons lift it, and the damper opens a loop. What the
# damper took is a part of the balance of energy.

# %%
history = rj.simulate(restrained, pulse, t_end=6.0)
print(history)
figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
plots.moment_rotation(history, ax=axes[0])
plots.energy_balance(history, ax=axes[1])

# %% [markdown]
# ## A vertical component
#
# `GroundMotion` is a horizontal and a vertical motion as one, upwards positive. Here the vertical one is the
# same pulse, $r$ times as large. The columns lift where $\ddot u_g = g\tan\alpha/(1 - r\tan\alpha)$, a little
# later for an upward motion; the peak may go either way.

# %%
ratio = np.linspace(-0.9, 0.9, 7 if REDUCED else 61)
motions = rj.GroundMotion(rj.OneSine(2.5, 0.8), rj.OneSine(2.5 * ratio, 0.8))
options = rj.Options(outputs=("peak_rotation",))
fig, ax = plt.subplots(layout="constrained")
for podium, label in ((unrestrained, "bare columns"), (restrained, "tendons and dampers")):
    peaks = rj.peak_responses(podium, motions, options=options)
    ax.plot(ratio, peaks.peak_rotation, label=label)
ax.set(xlabel=r"$\ddot v_g/\ddot u_g$", ylabel=r"peak rotation $|\theta|/\alpha$")
ax.legend()

# %% [markdown]
# ## Spectra
#
# Over all pulses at once, by the same call as for bare columns: peak rotation over $\omega_p/p$ and
# $a_p/(g\tan\alpha)$, white where the columns overturn.

# %%
points = 9 if REDUCED else 50
frequency, acceleration = np.linspace(0.5, 8.0, points), np.linspace(1.0, 12.0, points)
fig, axes = plt.subplots(1, 2, figsize=(10, 4), sharey=True, layout="constrained")
for ax, podium, label in zip(
    axes, (unrestrained, restrained), ("bare columns", "tendons and dampers"), strict=True
):
    data = rj.rocking_spectrum(podium, rj.Ricker, frequency, acceleration, options=options)
    plots.rocking_spectrum(data, ax)
    ax.set_title(f"{label}: {float(data['overturned'].mean()):.0%} overturn")
plots.rotation_bar(axes)

# %% [markdown]
# ## What to change
#
# The derivative of the peak by every number of the devices, in one pass: what a little more of each would do.

# %%
value, slope = jax.value_and_grad(
    lambda podium: rj.peak_response(podium, pulse, options=options).peak_rotation
)(restrained)
print(f"peak rotation {value:.3f} α")
for device in slope.restrainers:
    print(device)

# %% [markdown]
# ## Next
#
# - [Tendons, dampers, inerters](../docs/control.md): equations, and what counts as overturned
# - [`04_column_sizing`](04_column_sizing.py): design, which also varies the numbers of devices
# - [`05_records_and_fragility`](05_records_and_fragility.py): suites of records; `Motions.paired` adds their
#   vertical components
