"""Derivatives d ln U/d ln y of checks, compared with finite differences of independent solutions.

The reference integrators take only the ratios of the structure from the package.
"""

import dataclasses
import math
import re

import numpy as np
import pytest

import rockjax as rj
from tests import restrained
from tests.reference_joints import peaks, structure_of

STEP = 1e-4  # relative change of an input
DIMENSIONS = {
    "width": 0.6,
    "height": 3.0,
    "column_mass": 2700.0,
    "positions": np.array([-4.0, 0.0, 4.0]),
    "beam_mass": 60e3,
    "beam_depth": 0.5,
}


def assert_slopes(check, utilisation, names, tolerance=1e-6):
    """Compare the derivatives of a check with central differences of fourth order.

    `utilisation`: function of an input and its factor
    """
    for name in names:
        logs = [math.log(utilisation(name, math.exp(k * STEP))) for k in (-2, -1, 1, 2)]
        difference = (logs[0] - 8 * logs[1] + 8 * logs[2] - logs[3]) / (12 * STEP)
        assert check.sensitivities[name] == pytest.approx(difference, rel=tolerance, abs=tolerance), name


def values_of(found, dimensions):
    """Return the value of each kind of check from independent peaks."""
    alpha = math.atan(dimensions["width"] / dimensions["height"])
    angle = found.answer.peak * alpha
    diagonal = math.hypot(dimensions["width"], dimensions["height"])
    weight = dimensions["column_mass"] * 9.80665
    beam = dimensions["beam_mass"] / len(dimensions["positions"]) / dimensions["column_mass"]
    return {
        "peak-rotation": found.answer.peak,
        "displacement": diagonal * (math.sin(alpha) - math.sin(alpha - angle)),
        "peak-friction": max(found.friction),
        "least-axial-force": min(found.least_axial / np.array([beam + 1, beam])),
        "contact-pressure": max(found.most_axial) * weight / (0.12 * 0.60),
        "peak-foundation-shear": found.shear,
    }


def independent_values(a_p, name, factor):
    """Return the values under a Ricker pulse with an input multiplied by a factor."""
    changed = DIMENSIONS | ({name: DIMENSIONS[name] * factor} if name in DIMENSIONS else {})
    structure = structure_of(rj.Podium.from_dimensions(**changed))
    motion = restrained.ricker(a_p * (factor if name == "motion" else 1.0), 1.0)
    return values_of(peaks(structure, 2.5, motion, start=-2.0), changed)


def assert_slopes_under_pulse(checks, kinds):
    """Compare the derivatives of checks, all of which are governed by the stronger pulse."""
    made = {}
    for check in (y for y in checks if y.kind.name in kinds and y.statistic == "max"):
        assert check.governing == 1

        def utilisation(name, factor, check=check):
            if (name, factor) not in made:
                made[name, factor] = independent_values(3.5, name, factor)
            value = made[name, factor][check.kind.name]
            return check.limit / value if check.kind.is_minimum else value / check.limit

        assert utilisation("width", 1.0) == pytest.approx(check.utilisation, rel=1e-7)
        assert_slopes(check, utilisation, (*DIMENSIONS, "motion"))


def test_derivatives_of_rotations_displacements_and_frictions(solved):
    kinds = ("peak-rotation", "displacement", "peak-friction")
    assert_slopes_under_pulse(solved.report.evaluation.checks, kinds)


MORE = """
[[checks]]
kind = "least-axial-force"
at_least = 0.1
[[checks]]
kind = "contact-pressure"
limit = 20e6
[[checks]]
kind = "peak-foundation-shear"
limit = 0.3
"""


@pytest.mark.slow
def test_derivatives_of_forces_in_joints(solved, tmp_path):
    """The scenes are stored, and one solution gives the derivatives of all checks."""
    text = re.sub(r"(?s)\[\[checks\]\].*", "", solved.text)
    path, page = solved.copy(tmp_path, text + MORE)
    checks = rj.evaluate(path, store=page.with_suffix(".nc"), skip=("methods", "spread")).checks
    assert_slopes_under_pulse(checks, [check.kind.name for check in checks])


BUILDING = {
    "width": 0.6,
    "height": 3.0,
    "columns": 4,
    "column_mass": 2700.0,
    "beam_mass": 60e3,
    "story_masses": np.array([40e3, 30e3]),
    "story_stiffnesses": np.array([20e6, 15e6]),
    "damping": 0.05,
}
PULSE = 3.0, 0.8  # amplitude [m/s²] and period [s]
STORIES = {
    "peak-shear": lambda answer: answer.shear,
    "peak-drift": lambda answer: max(answer.drifts),
    "peak-floor-acceleration": lambda answer: max(answer.floors),
}


def independent_building(name, factor):
    """Return the answer of a building under the pulse with an input multiplied by a factor."""
    changed = BUILDING | ({name: BUILDING[name] * factor} if name in BUILDING else {})
    podium = rj.Podium.from_dimensions(**changed)
    shapes = tuple(tuple(map(float, floor)) for floor in np.asarray(podium.superstructure.shapes))
    frame = dataclasses.replace(structure_of(podium).frame, shapes=shapes)
    if name == "e":
        frame = dataclasses.replace(frame, e=frame.e * factor)
    motion = restrained.ricker(PULSE[0] * (factor if name == "motion" else 1.0), PULSE[1])
    return restrained.simulate(frame, 3.0, motion, start=-1.6)


@pytest.mark.slow
def test_derivatives_of_a_building(tmp_path):
    """Shear, drift and floor acceleration."""
    numbers = "".join(
        f"{name} = {y.tolist() if isinstance(y, np.ndarray) else y}\n" for name, y in BUILDING.items()
    )
    pulse = f'kind = "ricker"\na_p = {PULSE[0]}\nT_p = {PULSE[1]}\n'
    checks = "".join(f'[[checks]]\nkind = "{kind}"\nlimit = 1.0\n' for kind in STORIES)
    path = tmp_path / "problem.toml"
    path.write_text(f"[structure]\n{numbers}[motions.pulse]\n{pulse}[report]\nlaws = []\n{checks}")
    found = rj.evaluate(path, skip=("methods", "spread")).checks
    made = {}
    for check in found:

        def utilisation(name, factor, check=check):
            if (name, factor) not in made:
                made[name, factor] = independent_building(name, factor)
            return float(STORIES[check.kind.name](made[name, factor]))

        answer = made.setdefault(("width", 1.0), independent_building("width", 1.0))
        assert answer.impacts
        assert utilisation("width", 1.0) == pytest.approx(check.utilisation, rel=1e-7)
        assert_slopes(check, utilisation, (*[y for y in BUILDING if y != "columns"], "e", "motion"))


def test_derivatives_of_overturning_scales_follow_from_similarity(solved):
    """U = limit/factor is proportional to the motion, and depends only on ratios of masses."""
    check = next(y for y in solved.report.evaluation.checks if y.kind.name == "overturning-scale")
    slopes = check.sensitivities
    assert slopes["motion"] == pytest.approx(1.0, abs=1e-9)
    assert slopes["column_mass"] == pytest.approx(-slopes["beam_mass"], abs=1e-9)
    assert slopes["positions"] == slopes["beam_depth"] == 0
