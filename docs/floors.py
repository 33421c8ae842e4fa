"""Draw the pictures of `floors.md`: `python docs/floors.py`."""

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
    contents = {
        "cabinet": rj.Contents.from_dimensions(width=0.45, height=1.9, level=3),
        "shelf": rj.Contents.from_dimensions(width=0.35, height=1.8, level=1),
    }
    suite = rj.synthetic_motions(40, duration=10.0, pga=3.0, seed=1)
    curves = rj.contents_fragility(podium, contents, suite, np.linspace(0.5, 4.0, 15))
    write_figure(IMAGES / "contents-fragility.png", plots.contents_fragility(curves))


if __name__ == "__main__":
    main()
