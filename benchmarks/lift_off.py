"""Where the beam lifts off: axial forces and friction of the twelve structures of Fig. 6.

`python -m benchmarks.lift_off [POINTS]` draws the maps of docs/validation/lift-off.md for 2, 3 and 5 columns
and prints its tables, on POINTS × POINTS pulses (60 by default). `python -m benchmarks.lift_off 60
compatible` prints the tables of the restitution law "compatible".
"""

from __future__ import annotations

import dataclasses
import math
import sys
from typing import Any

import numpy as np
import xarray

import rockjax as rj
from rockjax import plots
from rockjax._cli._panels import combine_panels
from rockjax._files import write_figure

from .measure import IMAGES, PERIODS, report

FLOORS = (1, 5, 10)  # numbers of floors, equal to η/γ because every floor weighs as much as the beam
BAY, STORY, DEPTH = 6.0, 3.2, 0.6  # distance of columns, height of stories, depth of the beam [m]
COLUMNS = (2, 3, 5)
OUTPUTS = ("peak_rotation", "axial_force", "peak_friction", "impact_friction")
PRESSED = 0.1  # friction is reported for scenes whose least N is at least this share of the dead load
STRUCTURES = [(floors, T_s) for floors in FLOORS for T_s in PERIODS.values()]


def podium(floors: int, T_s: float, positions: np.ndarray, restitution: Any = "paper") -> rj.Podium:
    """Return a podium of the paper's Fig. 6. The mass of the superstructure lies at the mean height of its
    floors."""
    eta = 10.0 * floors
    top = rj.Elastic(eta, T_s, 0.05) if T_s else rj.Rigid(eta)
    elevation = rj.Elevation(positions, DEPTH, STORY * (floors + 1) / 2)
    return rj.Podium(math.atan(0.15), 1.5, 10.0, top, restitution=restitution, elevation=elevation)


def spectra(podiums: list[rj.Podium], points: int) -> list[xarray.Dataset]:
    axes = np.linspace(1.0, 8.0, points), np.linspace(1.0, 12.0, points)
    return rj.rocking_spectra(podiums, rj.Ricker, *axes, options=rj.Options(outputs=OUTPUTS))


@dataclasses.dataclass(frozen=True)
class Surviving:
    """Scenes of a spectrum that do not overturn, with the values at the worst joint of each scene.

    - `share`: least N divided by the dead load; `impulse`: least share of an impulse [–]
    - `friction`, `impact`: friction demand of the motion and of the impacts [–]
    - `ratio`: a_p/(g tan α)
    """

    share: np.ndarray
    impulse: np.ndarray
    friction: np.ndarray
    impact: np.ndarray
    ratio: np.ndarray

    @classmethod
    def of(cls, data: xarray.Dataset) -> Surviving:
        survives = ~data["overturned"].values
        ratio = np.broadcast_to(data["acceleration_ratio"].values[:, None], survives.shape)
        pick = lambda values: values.transpose("acceleration_ratio", "frequency_ratio").values[survives]
        return cls(
            pick((data["least_axial_force"] / data["dead_load"]).min("joint")),
            pick(data["least_impulse_share"].min("joint")),
            pick(data["peak_friction"].max("joint")),
            pick(data["peak_impact_friction"].max("joint")),
            ratio[survives],
        )

    def row(self) -> dict[str, Any]:
        """Return the row: least amplitude at which a joint opens, and share of scenes with an open joint."""
        opens, pressed = self.share < 0, self.share >= PRESSED
        return {
            "least N": float(self.share.min()),
            "opens from": float(self.ratio[opens].min()) if opens.any() else None,
            "open scenes": float(opens.mean()),
            "friction": float(self.friction[pressed].max()) if pressed.any() else None,
            "least impulse": float(self.impulse.min()),
            "impact friction": float(self.impact.max()),
        }


def static_distance(floors: int) -> float:
    """Return the core distance h̄ tan α + B [m] at which a joint of a rigid structure opens at uplift. The
    centre of mass of beam and floors is at the height h̄ above the columns."""
    structure = podium(floors, 0.0, np.array([-3.0, 3.0]))
    tan, eta = math.tan(float(structure.alpha)), float(structure.eta)
    height = (10.0 * DEPTH / 2 + eta * (DEPTH + STORY * (floors + 1) / 2)) / (10.0 + eta)
    return height * tan + float(structure.width) / 2


def needed_distances(points: int, steps: int = 6) -> list[float]:
    """Return the least core distance ℓ_p [m] of each structure that keeps joints closed in surviving scenes.

    The positions of columns affect the forces of the end columns only through ℓ_p, (F8), so two columns at
    ±ℓ_p are solved. The least N is a decreasing, concave function of 1/ℓ_p; regula falsi finds its root.
    """

    def least_force(inverse: np.ndarray) -> np.ndarray:
        ends = [1 / y * np.array([-1.0, 1.0]) for y in inverse]
        podiums = [podium(*structure, x) for structure, x in zip(STRUCTURES, ends, strict=True)]
        return np.array([Surviving.of(data).share.min() for data in spectra(podiums, points)])

    low, high = np.full(len(STRUCTURES), 1 / 40), np.full(len(STRUCTURES), 1 / 0.5)
    at_low, at_high = least_force(low), least_force(high)
    assert np.all(at_low > 0)
    assert np.all(at_high < 0)
    for _ in range(steps):
        middle = low + (high - low) * at_low / (at_low - at_high)
        at_middle = least_force(middle)
        closed = at_middle >= 0
        low, at_low = np.where(closed, middle, low), np.where(closed, at_middle, at_low)
        high, at_high = np.where(closed, high, middle), np.where(closed, at_high, at_middle)
    return list(map(float, 1 / low))


def main(size: str = "60", restitution: str = "paper") -> None:
    points = int(size)
    rows = [{"η/γ": floors, "T_s": T_s, "static ℓ_p": static_distance(floors)} for floors, T_s in STRUCTURES]
    for count in COLUMNS:
        positions = BAY * (np.arange(count) - (count - 1) / 2)
        datasets = spectra([podium(*structure, positions, restitution) for structure in STRUCTURES], points)
        if restitution == "paper":
            panels = combine_panels(datasets, list(map(float, FLOORS)), list(PERIODS.values()), 0.05)
            write_figure(IMAGES / f"lift-off-{count}.png", plots.lift_off_spectra(panels))
        for row, data in zip(rows, datasets, strict=True):
            row |= {f"{count}: {name}": value for name, value in Surviving.of(data).row().items()}
    if restitution == "paper":
        for row, distance in zip(rows, needed_distances(points), strict=True):
            row |= {"needed ℓ_p": distance, "over static": distance / row["static ℓ_p"]}
            row |= {"columns": max(2, math.ceil(6 * distance / BAY - 1))}
    report("lift_off" if restitution == "paper" else f"lift_off_{restitution}", rows)


if __name__ == "__main__":
    main(*sys.argv[1:])
