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
# This notebook shows the effects of tendons, dampers and vertical ground motion on the response, its energy
# and the peak rotation. [Tendons, dampers, inerters](../docs/control.md) has the equations.

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
for name, podium in (("bare", unrestrained), ("with devices", restrained)):
    uplift, stable = float(podium.uplift_ground_acceleration), float(podium.stability_angle)
    print(f"{name}: columns lift at {uplift:.3f} m/s², static stability ends at {stable:.3f} rad")

# %% [markdown]
# ## Loops and energy
#
# The restoring moment of columns without devices decreases with the rotation. Tendons increase the moment,
# and the damper adds a loop. The energy balance contains the energy that the damper dissipates.

# %%
history = rj.simulate(restrained, pulse, t_end=6.0)
print(history)
figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
plots.moment_rotation(history, ax=axes[0])
plots.energy_balance(history, ax=axes[1])

# %% [markdown]
# ## A vertical component
#
# `GroundMotion` combines a horizontal and a vertical motion, which is positive upwards. Here the vertical
# motion is the same pulse multiplied by $r$. Columns without devices lift at $\ddot u_g = g\tan\alpha/(1 -
# r\tan\alpha)$, so an upward acceleration delays uplift; the peak may be larger or smaller.

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
# The spectra show the peak rotation against $\omega_p/p$ and $a_p/(g\tan\alpha)$, without and with devices.
# Scenes that overturn are white.

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
# ## Sensitivities to the devices
#
# One call computes the derivatives of the peak with respect to all parameters of the devices.

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
# - [Tendons, dampers, inerters](../docs/control.md): equations, and the definition of overturning
# - [`04_column_sizing`](04_column_sizing.py): design, which can also vary parameters of devices
# - [`05_records_and_fragility`](05_records_and_fragility.py): suites of records; `Motions.paired` adds their
#   vertical components
