"""Draws the pictures of one scene, of `pictures.md` and the README: `python docs/pictures.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import rockjax as rj
from rockjax import plots
from rockjax._files import write_figure

IMAGES = Path(__file__).parent / "images"


def main() -> None:
    podium = rj.Podium.from_dimensions(
        width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3, top_mass=300e3, period=0.5, damping=0.05
    )
    data = rj.simulate(podium, rj.Ricker(a_p=3.7, T_p=1.0), t_end=8.0).dataset()
    write_figure(IMAGES / "response.png", plots.response(data))
    for name, draw in (
        ("phase-portrait", plots.phase_portrait),
        ("moment-rotation", plots.moment_rotation),
        ("energy", plots.energy_balance),
    ):
        ax = draw(data)
        ax.figure.set_size_inches(6.4, 4.4)
        write_figure(IMAGES / f"{name}.png", ax.figure)
    plots.save_animation(IMAGES / "rocking.gif", data, start=-0.8, end=6.0, fps=20, dpi=80, exaggerate=2.0)


if __name__ == "__main__":
    main()
