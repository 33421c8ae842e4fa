"""Draw the picture of `ensembles.md`: `python docs/ensembles.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from scipy import stats

import rockjax as rj
from rockjax import plots
from rockjax._files import write_figure

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    podium = rj.Podium(alpha=0.15, R=1.5, gamma=10.0, restitution=0.9)
    motions = rj.synthetic_motions(10, seed=1, duration=10.0, pga=3.5)
    spread = {
        "alpha": stats.truncnorm(-3.0, 3.0, 0.15, 0.0075),
        "restitution": stats.uniform(0.85, 0.1),
        "initial.theta": stats.norm(0.0, 0.001),
    }
    others = {name: spread[name] for name in ("alpha", "initial.theta")}
    law = podium.replace(restitution="paper")
    ensembles = {
        "e from 0.85 to 0.95": rj.ensemble(podium, motions, spread=spread, n=1000, seed=1),
        "e of Eq. (27)": rj.ensemble(law, motions, spread=others, n=1000, seed=2),
    }
    with plt.style.context(plots.STYLE):
        figure = plt.figure(figsize=(9.5, 4.2), layout="constrained")
        left, right = figure.subplots(1, 2)
        plots.ensemble(ensembles, left)
        plots.quantile_quantile(ensembles, right)
        write_figure(IMAGES / "ensembles.png", figure)


if __name__ == "__main__":
    main()
