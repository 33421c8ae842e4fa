"""Draw the picture of `records.md`: `python docs/records.py`."""

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
    podium = rj.Podium(alpha=0.2, R=1.0, gamma=10.0, superstructure=rj.Rigid(50.0))
    motions = rj.synthetic_motions(4, seed=3, duration=10.0, dt=0.02, pga=3.0)
    spectrum = rj.record_spectrum(podium, motions, np.geomspace(0.6, 4, 40))
    write_figure(IMAGES / "record-spectrum.png", plots.record_spectrum(spectrum))


if __name__ == "__main__":
    main()
