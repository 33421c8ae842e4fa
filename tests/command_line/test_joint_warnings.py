"""Warnings of commands about joints: a line for each assumption that is violated or not checked."""

import re
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rockjax as rj
from rockjax._cli import main
from rockjax._cli._joints import joint_warnings
from rockjax._results import END_OF_TIME, NOT_FINITE, OUT_OF_STEPS, SETTLED

FRAME = rj.Podium(0.15, 1.5, 10.0, rj.Rigid(50.0), elevation=rj.Elevation([-3.0, 3.0], 0.6, 8.4))


def found(
    axial: Any = (0.5, 0.4),
    share: Any = (1.0, 0.9),
    friction: Any = (0.2, 0.15),
    at_impact: Any = (0.1, 0.1),
    overturned: Any = False,
    result: Any = 0,
):
    """Return peaks of one scene or of several, bottom joint first."""
    return SimpleNamespace(
        least_axial_force=np.array(axial),
        least_impulse_share=np.array(share),
        peak_friction=np.array(friction),
        peak_impact_friction=np.array(at_impact),
        overturned=np.array(overturned),
        result=np.broadcast_to(result, np.shape(overturned)),
    )


@pytest.mark.parametrize(
    ("peaks", "mu", "expected"),
    [
        (found(), None, []),
        (found(), 0.2, []),
        (found(axial=(0.5, -0.1)), None, [r"a joint opens \(least N = -0.1 m_c g, least share .* 0.9\)"]),
        (found(share=(-0.2, 1.0)), None, [r"a joint opens \(least N = 0.4 m_c g, least share .* -0.2\)"]),
        (found(), 0.18, ["the motion needs friction 0.2 in a joint, more than μ = 0.18$"]),
        (found(at_impact=(0.1, 0.3)), 0.25, ["an impact needs friction 0.3 in a joint, more than μ = 0.25$"]),
        (
            found(axial=(0.5, -0.1), friction=(np.inf, 0.1), at_impact=(0.4, 0.1)),
            0.3,
            ["a joint opens", "the motion needs friction inf", "an impact needs friction 0.4"],
        ),
        (
            found(
                *[((1.0, 1.0), (-0.3, 1.0), (-0.7, 1.0))] * 2,
                *[((0.1, 0.1), (0.1, 0.2), (0.1, 0.9))] * 2,
                overturned=(False, False, True),
            ),
            0.15,
            [r"opens in 1 of 2 surviving scenes \(least N = -0.3", "0.2 .* 1 of 2", "0.2 .* 1 of 2"],
        ),
        (
            found(
                *[((1.0, 1.0), (-0.3, 1.0), (np.nan, np.nan), (-0.7, 1.0))] * 2,
                overturned=(False, False, False, False),
                friction=((0.1, 0.1),) * 4,
                at_impact=((0.1, 0.1),) * 4,
                result=(SETTLED, END_OF_TIME, NOT_FINITE, OUT_OF_STEPS),
            ),
            0.15,
            [r"opens in 1 of 2 surviving scenes \(least N = -0.3 m_c g, least share .* -0.3\)"],
        ),
    ],
)
def test_one_line_for_each_assumption_that_fails(peaks, mu, expected):
    lines = list(joint_warnings(FRAME, peaks, mu))
    assert len(lines) == len(expected)
    for line, pattern in zip(lines, expected, strict=True):
        assert line.startswith("warning: ")
        assert "\n" not in line
        assert re.search(pattern, line), line


def test_restitution_below_that_of_compatible_impacts_warns():
    """ξ_J = 1 at the restitution factor of (C13), which causes no warning."""
    assert not list(joint_warnings(FRAME, None, None))
    compatible = float(FRAME.restitution_factor)
    (line,) = joint_warnings(FRAME.replace(restitution=0.9 * compatible), None, None)
    assert re.search(r"warning: e = .* old edges would need tension \(impact_eccentricity = .* > 1\)", line)


def test_without_an_elevation_the_unchecked_assumptions_are_named():
    (line,) = joint_warnings(FRAME.replace(elevation=None), None, 0.3)
    assert line.startswith("not checked, because the structure has no elevation: friction in the joints, and")


PROBLEM = """
[structure]
tan_alpha = 0.15
R = 1.5
gamma = 10.0
superstructure = { eta = 50.0 }
[structure.elevation]
columns = [-1.0, 1.0]
beam_depth = 0.6
top_height = 8.4
"""
PULSE = '{ kind = "ricker", a_p = 2.0, T_p = 1.0 }'
DESIGN = f"""
friction = 0.1
{PROBLEM}
[vary]
alpha = [0.14, 0.3]
[minimise]
quantity = "alpha"
[motions]
pulse = {PULSE}
[[targets]]
kind = "no-overturning"
motions = "pulse"
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "text", "arguments"),
    [
        ("response", PROBLEM + f"[motions]\npulse = {PULSE}\n", ("--motion", "pulse", "--friction", 0.1)),
        ("peaks", PROBLEM + f"[motions]\npulse = {PULSE}\n", ("--friction", 0.1)),
        ("design", DESIGN, ()),
        (
            "fragility",
            PROBLEM,
            ("--synthetic", 2, "--intensity", 0.5, 2.0, "--levels", 2, "--friction", 0.1),
        ),
    ],
)
def test_commands_warn_of_a_beam_that_lifts_off(command, text, arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "400")
    (tmp_path / "p.toml").write_text(text)
    monkeypatch.setattr(sys, "argv", ["rockjax", command, "p.toml", *map(str, arguments), "-o", "out"])
    with pytest.raises(SystemExit):
        main()
    output = capsys.readouterr()
    assert re.search(
        r"^ *warning: a joint opens.*from then on the model does not apply$", output.out, re.M
    ), output
    assert re.search(r"^ *warning: the motion needs friction .* more than μ = 0\.1", output.out, re.M), (
        output.out
    )
