"""A five-storey building on a podium against the same building fixed at its base: `python -m
benchmarks.building_design`.

Width of the columns and prestress of a tendon in each of them for the least drift, and for the least base
shear, while no motion rotates the columns by more than 0.4 α; each from ten starts, and verified by fresh
simulations. Beside them the building without a podium and the podium as it is drawn, under the same motions.
"""

from __future__ import annotations

import numpy as np

import optimise
import rockjax as rj

from .device_design import FORMATS, LIMIT, Motions, Problem, fresh_peaks, row_of
from .measure import keep, show
from .studies import OPTIONS, shaking

STORIES, HEIGHT = 5, 3.0
BUILDING = optimise.Dimensions(
    width=0.6, height=3.0, column_mass=2700.0, columns=4, beam_mass=30e3,
    story_masses=[20e3] * STORIES, story_stiffnesses=[12e6] * STORIES, story_heights=[HEIGHT] * STORIES,
)  # fmt: skip
VARY = {"width": (0.3, 1.2), "tendon_force": (0.0, 200e3)}
SEARCH = OPTIONS.replace(rtol=1e-7, atol=1e-9)


def motions() -> Motions:
    """Ten synthetic near-fault records of 7 s with a peak of 3 m/s²."""
    return [shaking(k, 3.0) for k in range(10)]


def problems() -> dict[str, Problem]:
    records = motions()
    target = optimise.PeakRotation(LIMIT, records)
    objectives = {
        "least drift": optimise.WorstDrift(records),
        "least base shear": optimise.WorstShear(records),
    }
    return {
        name: Problem(BUILDING, VARY, objective, (target,), records, SEARCH)
        for name, objective in objectives.items()
    }


def demands(podium: rj.Podium) -> dict[str, float]:
    """The largest demands of the motions on a building."""
    outputs = ("peak_rotation", "peak_drift", "peak_shear", "peak_floor_acceleration")
    peak = fresh_peaks(podium, motions(), SEARCH.replace(outputs=outputs))
    return {
        "drift [%]": 100 * float(np.max(np.asarray(peak.peak_drift))),
        "base shear": float(np.max(np.asarray(peak.peak_shear))),
        "floor acceleration [g]": float(np.max(np.asarray(peak.peak_floor_acceleration))) / 9.80665,
        "rotation": float(np.max(np.asarray(peak.peak_rotation))),
    }


def fixed() -> rj.Podium:
    """The same building on columns so stocky that they never lift."""
    return BUILDING.podium().replace(alpha=1.5)


def main() -> None:
    rows = []
    for name, problem in problems().items():
        row = row_of(name, problem)
        sized = BUILDING.replace(width=row["width"], tendon_force=row["tendon_force"])
        rows.append(row | demands(sized.podium()))
    for name, podium in (("as drawn", BUILDING.podium()), ("fixed", fixed())):
        rows.append({"study": name} | demands(podium))
    keep("building-design", rows)
    forms = {"study": "", "width": ".4f"} | FORMATS
    forms |= dict.fromkeys(demands(fixed()), ".4f")
    show(rows, {key: form for key, form in forms.items() if any(key in row for row in rows)})


if __name__ == "__main__":
    main()
