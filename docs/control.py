"""Draw the pictures of `control.md` and prints their numbers: `python docs/control.py [potentials]
[spectra]`."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import rockjax as rj
from rockjax import plots
from rockjax._engine.coefficients import coefficients
from rockjax._engine.energy import potential

IMAGES = Path(__file__).parent / "images"
FRAME = rj.Podium(alpha=0.15, R=1.5, gamma=10.0)
CRITICAL = float(FRAME.critical_stiffness)
CASES = (
    ("gravity alone", ()),
    (r"$\kappa = 0.6\,\kappa_{cr}$", (rj.Tendon(0.0, 0.6 * CRITICAL),)),
    (r"$\kappa = \kappa_{cr}$", (rj.Tendon(0.0, CRITICAL),)),
    (r"$\kappa = 1.4\,\kappa_{cr}$", (rj.Tendon(0.0, 1.4 * CRITICAL),)),
    (r"$\tau = 5$, $\kappa = 0$", (rj.Tendon(5.0),)),
)


def potentials() -> None:
    """Draw the potential V and the restoring moment for negative, zero and positive stiffness."""
    theta = jnp.linspace(0.0, 4 * 0.15, 241)
    figure = plt.figure(figsize=(10, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True)
    depth = float(potential(coefficients(FRAME), jnp.ones(()), jnp.asarray(0.15)))
    for k, (label, restrainers) in enumerate(CASES):
        podium = FRAME.replace(restrainers=restrainers)
        potential_energy = lambda angle, c=coefficients(podium): potential(c, jnp.ones(()), angle)
        energy, moment = jax.vmap(jax.value_and_grad(potential_energy))(theta)
        line_style = {
            "color": plots.COLOURS[k % len(plots.COLOURS)],
            "ls": plots.STYLES[k % len(plots.STYLES)],
        }
        left.plot(theta / 0.15, energy / depth, label=label, **line_style)
        start = 2 * 1.5 * 9.80665 * math.sin(0.15) * 10.5  # V' of gravity alone at uplift [m²/s²]
        right.plot(theta / 0.15, moment / start, **line_style)
        top = float(podium.stability_angle)
        if top < float(theta[-1]):
            left.plot(
                top / 0.15,
                float(potential_energy(jnp.asarray(top))) / depth,
                "X",
                color=line_style["color"],
                ms=7,
            )
            right.plot(top / 0.15, 0, "X", color=line_style["color"], ms=7)
    left.set(
        xlabel=r"$|\theta|\,/\,\alpha$",
        ylabel=r"$V\,/\,V_\mathrm{gravity}(\alpha)$",
        ylim=(-1.0, 6.0),
        xlim=(0, 4),
    )
    right.set(xlabel=r"$|\theta|\,/\,\alpha$", ylabel=r"$V'\,/\,V'_\mathrm{gravity}(0)$", ylim=(-1.0, 2.0))
    for ax in (left, right):
        ax.axhline(0, color="0.7", lw=0.6, zorder=0)
        ax.axvline(1, color="0.7", lw=0.6, zorder=0)
        ax.grid(alpha=0.3)
    left.legend(loc="upper left", fontsize="small")
    figure.savefig(IMAGES / "tendons.png", dpi=120)
    print(np.round([float(FRAME.replace(restrainers=r).stability_angle) / 0.15 for _, r in CASES], 3))


# τ, κ and δ of a frame of 0.45 m by 3 m columns, each of 1.5 t: about 30 kN, 390 kN/m and 44 kN s/m.
DEVICES = {
    "bare": (),
    "tendons": (rj.Tendon(2.0, 40.0),),
    "tendons and dampers": (rj.Tendon(2.0, 40.0), rj.Damper(10.0)),
    "inerters": (rj.Inerter(20.0),),
}


def spectra(points: int = 60) -> None:
    """Draw rocking spectra of bare and restrained podiums, and their overturning accelerations."""
    frequency, acceleration = np.linspace(0.5, 8.0, points), np.linspace(1.0, 12.0, points)
    figure = plt.figure(figsize=(10, 7.2), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    options = rj.Options(outputs=("peak_rotation",))
    panels = list(DEVICES.items())[:3]
    for ax, (name, devices) in zip(axes.flat, panels, strict=False):
        podium = FRAME.replace(restrainers=devices)
        data = rj.rocking_spectrum(podium, rj.Ricker, frequency, acceleration, options=options)
        plots.rocking_spectrum(data, ax)
        ax.set_title(name)
        print(f"{name}: {float(data['overturned'].mean()):.3f} of the grid overturns")
    plots.rotation_bar(axes)
    last = axes[1, 1]
    at = np.linspace(0.5, 8.0, 31)
    for k, (name, devices) in enumerate(DEVICES.items()):
        podium = FRAME.replace(restrainers=devices)
        data = rj.overturning_spectrum(podium, rj.Ricker, at, max_acceleration_ratio=12.0, width=1e-3)
        line_style = {"color": plots.COLOURS[k], "ls": plots.STYLES[k]}
        plots.overturning_curve(data, last, label=name, **line_style)
    last.set_title("least overturning acceleration")
    last.legend(loc="lower right", fontsize="x-small", handlelength=1.6)
    for ax in axes.flat:
        ax.label_outer()
    figure.savefig(IMAGES / "restrained-spectra.png", dpi=100)


if __name__ == "__main__":
    names = sys.argv[1:]
    for draw in (potentials, spectra):
        if not names or draw.__name__ in names:
            draw()
