"""Derivatives d ln U/d ln y of checks, compared with finite differences of independent solutions.

The reference integrators take only the ratios of the structure from the package.
"""

import math

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


def test_derivatives_of_overturning_scales_follow_from_similarity(solved):
    """U = limit/factor is proportional to the motion, and depends only on ratios of masses."""
    check = next(y for y in solved.report.evaluation.checks if y.kind.name == "overturning-scale")
    slopes = check.sensitivities
    assert slopes["motion"] == pytest.approx(1.0, abs=1e-9)
    assert slopes["column_mass"] == pytest.approx(-slopes["beam_mass"], abs=1e-9)
    assert slopes["positions"] == slopes["beam_depth"] == 0
