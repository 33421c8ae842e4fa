"""Draws the picture of `control.md`: `python docs/control.py`."""

from __future__ import annotations

import math
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


def main() -> None:
    """V(θ), and the moment that brings the columns back, for negative, zero and positive stiffness."""
    theta = jnp.linspace(0.0, 4 * 0.15, 241)
    figure = plt.figure(figsize=(10, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True)
    depth = float(potential(coefficients(FRAME), jnp.ones(()), jnp.asarray(0.15)))
    for k, (label, restrainers) in enumerate(CASES):
        podium = FRAME.replace(restrainers=restrainers)
        held = lambda angle, c=coefficients(podium): potential(c, jnp.ones(()), angle)
        energy, moment = jax.vmap(jax.value_and_grad(held))(theta)
        look = {"color": plots.COLOURS[k % len(plots.COLOURS)], "ls": plots.STYLES[k % len(plots.STYLES)]}
        left.plot(theta / 0.15, energy / depth, label=label, **look)
        start = 2 * 1.5 * 9.80665 * math.sin(0.15) * 10.5  # of gravity alone at uplift
        right.plot(theta / 0.15, moment / start, **look)
        top = float(podium.stability_angle)
        if top < float(theta[-1]):
            left.plot(top / 0.15, float(held(jnp.asarray(top))) / depth, "X", color=look["color"], ms=7)
            right.plot(top / 0.15, 0, "X", color=look["color"], ms=7)
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


if __name__ == "__main__":
    main()
