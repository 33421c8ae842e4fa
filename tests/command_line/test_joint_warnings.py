"""Warnings of commands about joints: a line for each assumption that is violated or not checked."""

import json
import re
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rockjax as rj
from rockjax._cli import main
from rockjax._cli._joints import joint_warnings
from rockjax._cli._run import Console
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


def matching_lines(peaks, mu, expected):
    """Return the warnings, one for each expected pattern."""
    lines = list(joint_warnings(FRAME, peaks, mu))
    assert len(lines) == len(expected)
    for line, pattern in zip(lines, expected, strict=True):
        assert re.search(pattern, line), line
    return lines


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
    for line in matching_lines(peaks, mu, expected):
        assert line.startswith("warning: ")
        assert "\n" not in line


def test_restitution_below_that_of_compatible_impacts_warns():
    """ξ_J = 1 at the restitution factor of (C13), which causes no warning."""
    assert not list(joint_warnings(FRAME, found(), None))
    compatible = float(FRAME.restitution_factor)
    (line,) = joint_warnings(FRAME.replace(restitution=0.9 * compatible), found(), None)
    assert re.search(r"warning: e = .* old edges would need tension \(impact_eccentricity = .* > 1\)", line)


def test_without_an_elevation_the_unchecked_assumptions_are_named():
    (line,) = joint_warnings(FRAME.replace(elevation=None), None, 0.3)
    assert line.startswith("not checked, because the structure has no elevation: friction in the joints, and")


def without(*names: str):
    """Return peaks without some of the variables."""
    peaks = found(axial=(0.5, -0.1), friction=(0.2, 0.4))
    for name in names:
        delattr(peaks, name)
    return peaks


OPENS = "a joint opens"
SLIDES = r"the motion needs friction 0\.4"
IMPACT_MISSING = r"not checked completely: .* the beam stays on all columns .*outputs impact_friction\)"


@pytest.mark.parametrize(
    ("peaks", "mu", "expected"),
    [
        (None, 0.3, ["not checked, because there are no motions: friction in the joints, and whether"]),
        (
            found(*[[(1.0, 1.0)] * 2] * 4, overturned=(True, False), result=(SETTLED, NOT_FINITE)),
            0.3,
            ["not checked, because no scene survives: friction"],
        ),
        (without("least_impulse_share"), None, [IMPACT_MISSING, OPENS]),
        (without("least_axial_force"), None, [r"not checked completely: .*outputs axial_force\)"]),
        (without("peak_friction", "peak_impact_friction"), None, [OPENS]),
        (
            without("least_impulse_share", "peak_impact_friction"),
            0.3,
            [
                r"not checked completely: .*, and friction in the joints \(.*outputs impact_friction\)",
                OPENS,
                SLIDES,
            ],
        ),
        (
            without("least_axial_force", "least_impulse_share", "peak_friction", "peak_impact_friction"),
            0.3,
            [r"not checked completely: .* \(.*outputs axial_force, impact_friction, peak_friction\)"],
        ),
    ],
)
def test_checks_without_their_answers_are_named(peaks, mu, expected):
    matching_lines(peaks, mu, expected)


def test_warnings_are_in_the_json_object_and_on_stderr_if_quiet(capsys):
    lines = ["warning: a joint opens", "not checked: friction"]
    for quiet, as_json, out, err in (
        (False, False, "  warning: a joint opens\n  not checked: friction\n", ""),
        (False, True, "", ""),
        (True, False, "", "rockjax: warning: a joint opens\n"),
    ):
        console = Console(quiet=quiet, json=as_json)
        console.say_warnings(iter(lines), indent="  ")
        assert console.json_object["warnings"] == lines
        printed = capsys.readouterr()
        assert (printed.out, printed.err) == (out, err)


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


LOSSY = PROBLEM.replace("gamma = 10.0", "gamma = 10.0\nrestitution = 0.5") + f"[motions]\npulse = {PULSE}\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "text", "arguments", "pattern"),
    [
        (
            "peaks",
            PROBLEM + f"[motions]\npulse = {PULSE}\n",
            ("--outputs", "peak_rotation,peak_friction", "--friction", 0.1),
            r"not checked completely: .*outputs axial_force, impact_friction\)",
        ),
        (
            "response",
            LOSSY,
            ("--motion", "pulse", "--friction", 0.1),
            r"warning: e = 0\.5 is too small for rigid faces",
        ),
        (
            "response",
            LOSSY,
            ("--motion", "pulse", "--friction", 0.1),
            r"warning: an impact needs friction .* in a joint, more than μ = 0\.1",
        ),
    ],
)
def test_lines_of_commands(command, text, arguments, pattern, tmp_path, monkeypatch, capsys):
    """The warnings of a command are lines of its JSON object."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "p.toml").write_text(text)
    given = [*map(str, arguments), "--json", "-o", "out"]
    monkeypatch.setattr(sys, "argv", ["rockjax", command, "p.toml", *given])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code in (None, 0)
    lines = json.loads(capsys.readouterr().out)["warnings"]
    assert any(re.search(pattern, line) for line in lines), lines
