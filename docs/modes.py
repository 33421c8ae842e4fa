"""Draw the picture of `modes.md` and print its table: `python docs/modes.py`.

The building has five stories and stands on a podium or on a fixed base.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import rockjax as rj
from rockjax import plots

IMAGES = Path(__file__).parent / "images"
# Number of stories; mass [kg], stiffness [N/m] and height [m] of each story.
STORIES, MASS, STIFFNESS, HEIGHT = 5, 20e3, 12e6, 3.0
COLUMNS: dict[str, Any] = {
    "width": 0.6,
    "height": 3.0,
    "column_mass": 2700.0,
    "beam_mass": 30e3,
    "columns": 4,
}
MOTIONS = 20


def podium(**changes: Any) -> rj.Podium:
    """Return the building on its podium, which has concrete columns of 0.6 m by 0.6 m."""
    building = {
        "story_masses": [MASS] * STORIES,
        "story_stiffnesses": [STIFFNESS] * STORIES,
        "story_heights": [HEIGHT] * STORIES,
    }
    return rj.Podium.from_dimensions(**COLUMNS, **building, **changes)


def fixed() -> rj.Podium:
    """Return the same building on columns that are too stocky to lift."""
    return podium().replace(alpha=1.5)


def main() -> None:
    """Draw the peaks under a pulse; print these peaks and their medians over synthetic motions."""
    rocking, still = podium(), fixed()
    pulse = rj.Ricker(0.5 * 9.80665, 0.7)
    histories = [rj.simulate(structure, pulse) for structure in (rocking, still)]
    figure = plt.figure(figsize=(9.5, 4.2), layout="constrained")
    plots.stories(histories[0], figure, label="on the podium", beside={"fixed at its base": histories[1]})
    figure.savefig(IMAGES / "stories.png", dpi=120)
    rows = [("Ricker pulse, 0.5 g, 0.7 s", [*map(summary, histories)])]
    motions = rj.synthetic_motions(MOTIONS, pga=0.5 * 9.80665, seed=1)
    suites = [rj.peak_responses(structure, motions) for structure in (rocking, still)]
    rows.append((f"{MOTIONS} synthetic motions, PGA 0.5 g, medians", [*map(summary, suites)]))
    top: Any = rocking.superstructure
    print("fixed-base periods [s]", np.round(np.asarray(top.modes.T), 3))
    lifts, e = float(rocking.uplift_ground_acceleration) / 9.80665, float(rocking.restitution_factor)
    print(f"lifts at {lifts:.3f} g, e = {e:.3f}")
    for name, (of_rocking, of_still) in rows:
        print(name)
        for what in of_rocking:
            print(f"  {what}: {of_rocking[what]:.3f} on the podium, {of_still[what]:.3f} fixed")
    print("overturned", int(np.sum(suites[0].overturned)))


def summary(peaks: Any) -> dict[str, float]:
    """Return the peaks of a scene, or their medians over several scenes."""
    median = lambda y: float(np.median(np.atleast_1d(y)))
    return {
        "base shear over weight": median(peaks.peak_shear),
        "largest drift over height [%]": median(np.max(np.asarray(peaks.peak_drift), axis=-1) / HEIGHT * 100),
        "largest floor acceleration [g]": median(
            np.max(np.asarray(peaks.peak_floor_acceleration), axis=-1) / 9.80665
        ),
        "peak rotation over α": median(peaks.peak_rotation),
    }


if __name__ == "__main__":
    main()
