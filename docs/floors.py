"""Draws the picture of `floors.md`: `python docs/floors.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np

import rockjax as rj
from rockjax import plots
from rockjax._files import write_figure

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    building = rj.ShearBuilding.uniform(stories=3, eta=30.0, T=0.5)
    podium = rj.Podium(alpha=0.15, R=1.5, gamma=10.0, superstructure=building)
    periods = np.geomspace(0.05, 5.0, 200)
    spectrum = rj.floor_spectrum(
        podium, rj.Ricker(4.0, 1.0), periods, level=["deck", 1, 2, 3], fixed_base=True
    )
    write_figure(IMAGES / "floor-spectrum.png", plots.floor_spectrum(spectrum))


if __name__ == "__main__":
    main()
