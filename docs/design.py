"""Draw the pictures of `design.md`: `python docs/design.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

import optimise
import rockjax as rj
from rockjax import plots
from rockjax._files import write_figure

IMAGES = Path(__file__).parent / "images"


def slenderness(podium: rj.Podium):
    return podium.alpha


def main() -> None:
    """Solve the example of the page and draw its pictures."""
    column = optimise.Dimensions(
        width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3, top_mass=300e3, period=0.5
    )
    pulses = [rj.Ricker(4.0, 0.6), rj.Ricker(3.25, 1.0), rj.Ricker(2.5, 1.4)]
    stronger = [pulse.scaled(1.5) for pulse in pulses]
    targets = [optimise.PeakRotation(0.4, pulses), optimise.NoOverturning(stronger)]
    answer = optimise.design(column, {"width": (0.2, 1.5)}, slenderness, targets, starts=4)
    print(answer)
    with plt.style.context(plots.STYLE):
        ax = optimise.convergence(answer)
        write_figure(IMAGES / "design-convergence.png", ax.figure)
        nearest = max(stronger, key=lambda pulse: float(rj.peak_response(answer.podium, pulse).peak_rotation))
        figure = optimise.before_after(column.podium(), answer, nearest)
        write_figure(IMAGES / "design-response.png", figure)


if __name__ == "__main__":
    main()
