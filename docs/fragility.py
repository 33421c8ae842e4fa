"""Draw the pictures of `fragility.md`: `python docs/fragility.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import rockjax as rj
from rockjax import plots
from rockjax._files import write_figure

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    motions = rj.synthetic_motions(40, seed=1)
    table = rj.Records.of(motions.records())
    levels = np.linspace(0.5, 9.0, 18)
    podium = rj.Podium(alpha=0.15, R=1.5, gamma=10.0)
    elastic = podium.replace(superstructure=rj.Elastic(eta=50.0, T_s=0.5))
    analyses = {
        name: rj.incremental_dynamic_analysis(structure, table, levels, names=motions.names)
        for name, structure in (("beam only", podium), ("elastic building", elastic))
    }
    with plt.style.context(plots.STYLE):
        figure = plt.figure(figsize=(9.5, 4.2), layout="constrained")
        left, right = figure.subplots(1, 2)
        plots.incremental_dynamic_analysis(analyses["beam only"], left)
        for (name, analysis), colour in zip(analyses.items(), plots.COLOURS[2:0:-1], strict=True):
            plots.fragility(rj.fragility(analysis), right, label=name, colour=colour)
        write_figure(IMAGES / "fragility.png", figure)


if __name__ == "__main__":
    main()
