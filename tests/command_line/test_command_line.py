"""Commands, called as by a user."""

import contextlib
import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
import typer
import xarray
from typer.testing import CliRunner

import optimise
import rockjax as rj
from optimise._chart import _smallest_safe_value
from rockjax._cli import app, main
from rockjax._cli._context import MASSES
from rockjax._cli._response import residual_share
from rockjax._problem import models
from rockjax._problem.reading import Reader
from rockjax._results import OUT_OF_STEPS, OVERTURNED
from tests.scenes import Stops

PROBLEMS = Path(__file__).parents[2] / "rockjax" / "examples"

RUN = CliRunner()


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """Return a function that runs `rockjax …` in an empty folder and returns exit status, stdout and
    stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "400")

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["rockjax", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        message = capsys.readouterr()
        return ended.value.code or 0, message.out, message.err

    return call


def words(line):
    return line.split()


def attributes(path):
    with xarray.open_dataset(path) as data:
        return {name: value for name, value in data.attrs.items() if name != "command"}


FRAME = """
[structure]
tan_alpha = 0.15
R = 2.0
superstructure = { eta = 5.0 }
[motions.pulses]
kind = "ricker"
acceleration_ratio = [2.0, 3.0]
T_p = 0.8
[motions.one]
kind = "ricker"
a_p = 3.0
T_p = 0.7
[response]
motion = "one"
t_end = 2.0
[options]
rtol = 1e-7
"""


def test_a_response_by_options_is_that_of_the_file(run, tmp_path):
    (tmp_path / "frame.toml").write_text(FRAME)
    code, out, _ = run("response", "frame.toml", "-o", "a", "--json")
    assert code == 0
    message = json.loads(out)
    assert message["files"] == ["a.nc", "a.png"]
    assert message["command"] == "rockjax response frame.toml -o a --json"
    flags = words("--tan-alpha 0.15 --R 2 --gamma 0 --eta 5 --T-s 0 --a-p 3 --T-p 0.7 --t-end 2 --rtol 1e-7")
    assert run("response", *flags, "-o", "b")[0] == 0
    a, b = attributes("a.nc"), attributes("b.nc")
    assert a == b
    podium = rj.Podium(math.atan(0.15), 2.0, 0.0, rj.Rigid(5.0))
    exact = rj.peak_response(podium, rj.Ricker(3.0, 0.7), t_end=2.0)
    assert message["peak_rotation"] == pytest.approx(float(exact.peak_rotation), abs=1e-5)
    assert message["overturn_time"] is None
    # Options override the file: here another set and its second motion, an acceleration and the columns.
    code, out, _ = run(
        "response", "frame.toml", "--motion", "pulses", "--number", 2, "--alpha", 0.2, "-o", "c"
    )
    assert code == 0
    assert "peak rotation" in out
    c = attributes("c.nc")
    assert c["alpha_rad"] == 0.2
    assert c["a_p_m_s2"] == pytest.approx(3 * 9.80665 * math.tan(0.2))
    assert c["rtol"] == 1e-7
    assert run("response", "frame.toml", "--frequency-ratio", 4, "--rtol", 1e-6, "-o", "d")[:2][0] == 0
    d = attributes("d.nc")
    assert d["T_p_s"] == pytest.approx(2 * math.pi / (4 * d["p_rad_s"]))
    assert (d["rtol"], d["atol"]) == (1e-6, 1e-8)


def test_a_response_to_a_record(run, tmp_path):
    (tmp_path / "record.txt").write_text("\n".join(f"{a:.4f}" for a in 0.3 * np.sin(np.arange(50) * 0.2)))
    same = words("--gamma 0 --eta 0 --t-end 1 --units g --dt 0.02")
    # The final velocity exceeds a fifth of PGV, and one line states this.
    code, out, err = run("response", *same, "--record", "record.txt", "--scale", 1.5, "-o", "a")
    assert code == 0
    assert "rockjax: warning: " in err
    assert "record.txt: the motion ends with a velocity of" in err
    assert "wrote a.nc" in out
    with xarray.open_dataset("a.nc") as data:
        assert float(abs(data["ground_acceleration"]).max()) == pytest.approx(1.5 * 0.3 * 9.80665, rel=1e-2)


def test_a_scene_without_an_answer_is_one(run, tmp_path):
    (tmp_path / "short.toml").write_text(FRAME + "max_steps = 3\n")
    code, out, err = run("response", "short.toml", "--quiet", "-o", "a")
    assert code == 1
    assert out == ""
    assert err.startswith("rockjax: the scene did not finish. out_of_steps: ")
    assert (tmp_path / "a.nc").exists()


def test_a_spectrum_of_a_file(run, tmp_path):
    code, out, err = run(
        "spectrum", PROBLEMS / "spectrum.toml", "--points", 5, "--T-s", "0", "--verbose", "-o", "a"
    )
    assert code == 0
    assert "podiums × frequencies × accelerations: 1 × 5 × 5 = 25 scenes" in err
    assert "programs compiled" in err
    assert "25 scenes: " in out
    data = xarray.load_dataset("a.nc")
    assert data.attrs["pulse"] == "OneSine"
    assert float(data["frequency_ratio"][-1]) == 6.0
    assert float(data["eta_over_gamma"][0]) == 5.0
    podium = rj.Podium(math.atan(0.15), 1.5, 10.0, rj.Rigid(50.0))
    options = rj.Options(outputs=("peak_rotation",))
    one = rj.rocking_spectrum(
        podium, rj.OneSine, data["frequency_ratio"], data["acceleration_ratio"], options=options
    )
    np.testing.assert_array_equal(data["peak_rotation"].squeeze(), one["peak_rotation"])
    assert sorted(os.listdir()) == ["a-overturning.png", "a-rotation.png", "a.nc"]


def request(command, model, defaults, arguments, read):
    """Return what `read` returns from the `Request` of a command, which is not run. One of the arguments may
    be the table of a problem file."""
    from rockjax._cli import _options, _request

    table = next((a for a in arguments if isinstance(a, dict)), None)
    arguments = [str(a) for a in arguments if not isinstance(a, dict)]
    context = typer.main.get_command(app).commands[command].make_context(command, arguments)
    options = _options.structure_options(**getattr(_options, defaults)) | _options.options_of(model)
    explicit = [name for name in options if context.get_parameter_source(name).name == "COMMANDLINE"]
    values = {
        name: None if context.params[name] is None else one.convert(one.flag, context.params[name])
        for name, one in options.items()
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rockjax._problem.reading.load_table", lambda _: table)
        explicit = {name: (options[name].flag, values[name]) for name in explicit}
        return read(_request.Request(command, table and Path("a.toml"), values, explicit))


def panels(*arguments, table=None):
    """Return the podiums of a spectrum."""
    given = arguments if table is None else (*arguments, table)
    return request("spectrum", models.Spectrum, "PANEL_DEFAULTS", given, lambda found: found.panels())


def structure(*arguments):
    """Return the structure of `rockjax response`."""
    return request("response", models.Response, "SINGLE_DEFAULTS", arguments, lambda found: found.podium())


BUILDING = {"width": 0.6, "height": 3.0, "column_mass": 2.7e3, "beam_mass": 30e3}
RATIOS = {"R": 1.5, "tan_alpha": 0.15, "gamma": 1.0}
HEIGHTS = "--beam-depth", 0.6, "--top-height", 8.4


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--positions", "-4,0,5", *HEIGHTS), rj.Elevation([-4.0, 0.0, 5.0], 0.6, 8.4)),
        (("--positions", "0,4"), rj.Elevation([0.0, 4.0])),
        (
            ("--positions", "0,0,6", "--stories", 2, "--top-height", "3,6.5"),
            rj.Elevation([0.0, 0.0, 6.0], 0.0, [3.0, 6.5]),
        ),
        (
            (*words("--width 0.45 --height 3 --column-mass 1500 --beam-mass 3e4 --positions 0,4"), *HEIGHTS),
            rj.Elevation([0.0, 4.0], 0.6, 8.4),
        ),
        (
            ("--positions", "0,5", "--residual-height", 2,
             {"structure": RATIOS | {"elevation": {"columns": [0, 4], "beam_depth": 0.5}}}),
            rj.Elevation([0.0, 5.0], 0.5, 0.0, 2.0),
        ),
        (
            ("--beam-depth", 0.7, {"structure": BUILDING | {"positions": [0, 4, 8]}}),
            rj.Elevation([0.0, 4.0, 8.0], 0.7),
        ),
    ],
)  # fmt: skip
def test_options_of_the_elevation(arguments, expected):
    assert repr(structure(*arguments).elevation) == repr(expected)
    np.testing.assert_array_equal(structure(*arguments).elevation.columns, expected.columns)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--beam-depth", 0.6), "--beam-depth needs the positions of the columns as well; give --positions"),
        (("--top-height", 3, "--width", 0.45, "--height", 3, "--column-mass", 1500), "top_height needs the"),
        (("--positions", "nan,3"), "--positions: must be a list of numbers"),
        (("--positions", 3), "must hold the positions of 2 columns or more"),
        (("--positions", "0,4", "--beam-depth", -1), "--beam-depth: must be a number >= 0, got -1"),
        (("--positions", "0,4", "--top-height", "3,6"), r"top_height must be one number .*got \[3.0, 6.0\]"),
        (("--positions", "0,0.1"), "must be at least the width of a column apart"),
    ],
)
def test_wrong_options_of_the_elevation(arguments, message):
    with pytest.raises(ValueError, match=message):
        structure(*arguments)


def test_the_elevation_of_panels():
    """Heights belong to the superstructures of the panels."""
    found = panels("--eta", 30, "--T-s", 0.5, "--stories", 2, "--positions", "0,4", "--top-height", "3,6")
    (podium,) = found.podiums
    np.testing.assert_array_equal(podium.elevation.top_height, [3.0, 6.0])
    assert podium.superstructure.stories == 2


def test_panels_of_buildings():
    found = panels("--eta", 30, "--gamma", 10, "--T-s", "0.5,1", "--stories", 3)
    assert [each.superstructure.stories for each in found.podiums] == [3, 3]
    assert [float(each.superstructure.modes.T[0]) for each in found.podiums] == pytest.approx([0.5, 1.0])
    assert float(found.podiums[0].eta) == pytest.approx(30.0)


def test_panels_of_a_building_in_a_file():
    """A panel has the longest period of a building, and no option silently removes the building."""
    alike = {"structure": BUILDING | {"stories": 3, "top_mass": 60e3, "period": 0.4}}
    (podium,), _, periods, zeta = panels(table=alike)
    assert (podium.superstructure.stories, periods, zeta) == (3, [pytest.approx(0.4)], 0.05)
    (podium,), _, periods, zeta = panels("--zeta", 0.02, table=alike)
    assert (podium.superstructure.stories, periods, zeta) == (3, [pytest.approx(0.4)], 0.02)
    found = panels("--T-s", "0,0.5", "--eta-over-gamma", 2, table=alike).podiums
    assert [type(podium.superstructure).__name__ for podium in found] == ["Rigid", "ShearBuilding"]
    assert float(found[1].superstructure.modes.T[0]) == pytest.approx(0.5)
    own = {"structure": BUILDING | {"story_masses": [2e4, 1e4], "story_stiffnesses": [12e6, 9e6]}}
    (podium,), _, (period,), _ = panels(table=own)
    assert period == pytest.approx(float(podium.superstructure.modes.T[0]))
    for option in ("--zeta", "--T-s", "--eta-over-gamma"):
        with pytest.raises(ValueError, match=f"{option} cannot change a superstructure with several modes"):
            panels(option, 0.1, table=own)


def test_panels_keep_the_number_of_modes():
    tall = {"structure": BUILDING | {"stories": 10, "modes": 3, "top_mass": 60e3, "period": 0.4}}
    (podium,) = panels("--T-s", 0.5, table=tall).podiums
    assert podium.superstructure.retained == 3
    assert float(podium.superstructure.modes.T[0]) == pytest.approx(0.5)


def test_files_of_panels_state_no_mass_that_an_option_replaced():
    table = {"structure": BUILDING | {"top_mass": 300e3, "period": 0.4}}
    masses = {"columns": 2, "column_mass_kg": 2.7e3, "beam_mass_kg": 30e3}
    panels(table=table)
    assert MASSES.get() == masses | {"top_mass_kg": 300e3}
    panels("--eta-over-gamma", 5, table=table)
    assert MASSES.get() == masses


def test_panels_without_a_beam_need_eta():
    for table in (
        None,
        {"structure": {"alpha": 0.2, "R": 1.5, "gamma": 0.0}, "spectrum": {"eta_over_gamma": [5]}},
    ):
        with pytest.raises(ValueError, match="η/γ needs a beam; give --gamma > 0, or --eta"):
            panels(*(() if table else ("--gamma", 0)), table=table)
    alone = panels("--gamma", 0, "--eta", 0, "--T-s", 0)
    assert (alone.ratios, len(alone.podiums)) == ([0.0], 1)
    assert float(panels("--gamma", 0, "--eta", 5).podiums[0].eta) == 5.0


def test_atol_follows_rtol():
    """`atol` is 0.01 `rtol` in every problem, even if the command has no default of `rtol`."""
    read = lambda **keys: Reader().options(models.Options(**keys)).atol
    assert read(rtol=1e-6) == pytest.approx(1e-8, rel=1e-12)
    assert read(rtol=1e-14) == pytest.approx(1e-16, rel=1e-12)
    assert read(rtol=1e-6, atol=1e-9) == 1e-9
    assert read() == rj.Options().atol


def test_options_and_file_determine_the_panels():
    every = panels()
    assert (every.ratios, every.periods, len(every.podiums)) == ([1, 5, 10], [0, 0.1, 0.5, 1], 12)
    assert float(every.podiums[-1].eta) == 100
    one = panels("--eta", 20, "--T-s", "0,0.5", "--zeta", 0.1)
    assert (one.ratios, one.periods) == ([2.0], [0.0, 0.5])
    assert isinstance(one.podiums[0].superstructure, rj.Rigid)
    assert float(one.podiums[1].superstructure.zeta) == pytest.approx(0.1)
    drawn = words("--width 0.45 --height 3 --column-mass 1500 --beam-mass 30e3 --top-mass 6e4 --period 0.5")
    (podium,), ratios, periods, _ = panels(*drawn)
    assert (ratios, periods) == ([2.0], [0.5])
    assert float(podium.width) == pytest.approx(0.45)
    block = {"structure": {"alpha": 0.2, "R": 2.0}}
    (podium,), ratios, periods, _ = panels(table=block)
    assert podium.superstructure is None
    assert (ratios, periods) == ([0.0], [0.0])
    assert float(panels("--R", 3, "--tan-alpha", 0.1, table=block).podiums[0].alpha) == pytest.approx(
        math.atan(0.1)
    )
    many = panels("--gamma", 4, "--eta-over-gamma", "1,2", table=block)
    assert [float(podium.eta) for podium in many.podiums] == [4, 8]


WRONG = [  # one case for each message
    ("response none.toml", "none.toml: the file cannot be read: No such file"),
    ("response bad.toml", "bad.toml: structure.foo: unknown key; valid keys are alpha, tan_alpha, R, gamma"),
    ("spectrum worse.toml", "worse.toml: spektrum: unknown key; did you mean spectrum?"),
    ("response text.toml", "text.toml: structure.tan_alpha: must be a number > 0, got '0.15'"),
    ("design goals.toml", "goals.toml: targets[0]: limit must be a number or a key of this file with a"),
    ("design good.toml", "good.toml: file: vary is missing"),
    ("design", "rockjax design needs a problem file (TOML), or --example column"),
    ("design --example table", "'table' is not one of 'annual-frequency', 'column'"),
    (
        "response good.toml --example response",
        "--example and a problem file are alternatives; leave out --example or good.toml",
    ),
    ("spectrum good.toml --points 1", "--points: must be a whole number ≥ 2, got 1"),
    ("spectrum --points 100000", "--points: 120000000000 scenes need about 17.5 TiB of memory"),
    (
        "spectrum --frequency 8 1",
        "--frequency: must be two numbers [lowest, highest] with 0 < lowest < highest",
    ),
    ("spectrum --T-s a,b", "--T-s needs numbers separated by commas, got 'a,b'"),
    ("spectrum --eta 5 --eta-over-gamma 3", "--eta and --eta-over-gamma are alternatives; give one"),
    ("spectrum --pulse sinus", "'sinus' is not one of 'ricker'"),
    (
        "response good.toml",
        "response: the file has several sets of motions; choose one of a, b by motion in [response], or",
    ),
    (
        "response good.toml --motion c",
        "response.motion: must name a set under [motions], got 'c'; the sets are a, b",
    ),
    (
        "response good.toml --motion a --T-p 2",
        "motions.a: number must be from 1 to 2, got none; give --number, or number in [response]",
    ),
    ("response --number 2", "motions.pulse: number must be from 1 to 1, got 2; give --number"),
    (
        "response good.toml --motion b --scale 2",
        "--scale: unknown key; valid keys are kind, acceleration_ratio",
    ),
    ("response --T-p 1 --frequency-ratio 2", "--frequency-ratio and --T-p are alternatives; give one"),
    ("response --T-p -1", "--T-p: must be a number > 0 or a list of such numbers, got -1.0"),
    ("response --width 0.4", "structure: height is missing"),
    ("response --width 0.4 --R 2", "--width: unknown key; valid keys are alpha, tan_alpha, R"),
    ("response --restitution lawless", "--restitution: must be 'paper', 'compatible' or a factor in [0, 1]"),
    ("response --rtol 2", "options: Options: rtol must be in [1e-14, 0.1], got rtol = 2.0"),
    ("response --record none.AT2", "none.AT2: the file cannot be read: No such file"),
    (
        "response --record record.txt",
        "record.txt: the file does not state the unit of its samples; give units (on the command line",
    ),
    ("response --record record.txt --T-p 2", "--T-p: unknown key; valid keys are units, dt, component"),
    ("spectrum -o out.csv", "--output out.csv: .csv files are not supported; give a prefix"),
    ("sweep --axis R=1,2 -o out.nc", "--output out.nc: a sweep is written to a zarr store"),
    (
        "sweep --axis tan_alpha=-0.1,0.2",
        "sweep.axes: grid: tan_alpha must be finite and > 0, got tan_alpha = -0",
    ),
    ("sweep --axis R=1,2 --axis R=3,4", "--axis gives R twice; give each axis once"),
    ("peaks --t-end nan", "--t-end: must be a number, got nan"),
    ("response -o x.xlsx", "`rockjax report` writes tables (--xlsx FILE, --csv FOLDER)"),
    ("fragility", "rockjax fragility needs records: files, folders or tables, --synthetic N, or a problem"),
    (
        "fragility good.toml --motions b",
        "motions.b: must have records (file, suite or synthetic) here, not pulses",
    ),
    ("fragility good.toml bad.toml", "give at most one problem file, got good.toml and bad.toml"),
    ("fragility --synthetic 3 --measure Sa", "--measure Sa needs --measure-period"),
    ("fragility --synthetic 3 --measure-period 1", "--measure-period applies only to Sa"),
    ("fragility --synthetic 3 record.txt", "--synthetic and files of records are alternatives; give one"),
    *[
        (f"fragility --synthetic 3 {flags}", f"{words(flags)[0]} applies only to files on the command line;")
        for flags in ("--units g", "--dt 0.1", "--component 1", "--pattern *.AT2", "--paired")
    ],
    ("fragility good.toml --synthetic 3 --motions b", "--motions applies only to a set of the problem file"),
    ("fragility good.toml record.txt --motions b", "--motions applies only to a set of the problem file"),
    ("fragility record.txt --seed 1", "--seed applies only to --synthetic; leave it out\n"),
    (
        "fragility good.toml --motions b --seed 1",
        "--seed applies only to --synthetic; leave it out, or set seed in the table of the set",
    ),
    (
        "fragility good.toml --motions b --dt 1",
        "--dt applies only to files on the command line; leave it out, or set dt in the table of the set",
    ),
    ("plot none.nc", "none.nc: there is no such file"),
    ("quake", "No such command 'quake'"),
]
VALID_PROBLEM = """[structure]
alpha = 0.2
R = 1.0
[motions.a]
kind = "ricker"
a_p = [1.0, 2.0]
T_p = 1.0
[motions.b]
kind = "ricker"
a_p = 1.0
T_p = 1.0
"""


@pytest.mark.parametrize(("line", "words"), WRONG, ids=[line for line, _ in WRONG])
def test_wrong_input_is_named_and_ends_with_two(run, tmp_path, line, words):
    for name, text in (
        ("good", VALID_PROBLEM),
        ("bad", "[structure]\nalpha = 0.1\nR = 1.0\nfoo = 2\n"),
        ("worse", VALID_PROBLEM + "[spektrum]\npoints = 3\n"),
        ("text", VALID_PROBLEM.replace("alpha = 0.2", 'tan_alpha = "0.15"')),
        (
            "goals",
            VALID_PROBLEM
            + '[vary]\nR = [1.0, 2.0]\n[[targets]]\nkind = "peak-rotation"\nlimit = "0.4"\nmotions = "a"\n',
        ),
    ):
        (tmp_path / f"{name}.toml").write_text(text)
    (tmp_path / "record.txt").write_text("0\n1\n-1\n0\n")
    there = set(os.listdir())
    code, out, err = run(*line.split())
    assert code == 2, err
    assert out == ""
    assert words in err
    assert "Traceback" not in err
    assert set(os.listdir()) == there


def test_sweeps_accept_urls(run):
    code, out, err = run(
        *["sweep", "--axis", "R=1,2", "--T-s", "0", "--dry-run", "--json", "-o", "memory://bucket/x.zarr"]
    )
    assert code == 0, err
    assert json.loads(out)["store"] == "memory://bucket/x.zarr"


def test_pulses_have_the_names_of_the_report(run, tmp_path):
    (tmp_path / "good.toml").write_text(VALID_PROBLEM)
    code, out, err = run(*["peaks", "good.toml", "--motion", "a", "--outputs", "peak_rotation", "--json"])
    assert code == 0, err
    assert [row["motion"] for row in json.loads(out)["motions"]] == ["Ricker(1, 1)", "Ricker(2, 1)"]


def test_floor_spectra_of_unfinished_scenes_end_with_one(run, tmp_path):
    (tmp_path / "few.toml").write_text(VALID_PROBLEM + "[options]\nmax_steps = 5\n")
    code, out, err = run(*["floors", "few.toml", "--motion", "a", "--number", "2", "--points", "2", "--json"])
    assert code == 1, err
    assert "1 of 1 scenes did not finish. 1 out_of_steps" in err
    assert json.loads(out)["files"] == ["rockjax-floors.nc", "rockjax-floors.png"]


def test_the_largest_floor_values_name_scenes_that_cover_less_time(run, monkeypatch):
    dims = ("motion", "level", "damping", "period")
    data = xarray.Dataset(
        {name: (dims, np.ones((3, 1, 1, 2))) for name in ("pseudo_acceleration", "remaining_ratio")}
        | {name: (dims[:2], np.ones((3, 1))) for name in ("peak_acceleration", "peak_velocity_jump")}
        | {
            "overturned": ("motion", [False, True, False]),
            "result": ("motion", [0, OVERTURNED, OUT_OF_STEPS]),
        },
        {"level": ["deck"], "period": [0.1, 1.0]},
    )
    monkeypatch.setattr(rj, "floor_spectrum", lambda *_, **__: data)
    monkeypatch.setattr("rockjax._cli._run.Console.draw", lambda *_, **__: None)
    code, out, _ = run("floors", "--points", 2)
    assert code == 1
    assert out.startswith(
        "3 scenes; 1 overturned, 1 did not finish, and the values of these scenes cover only the time until "
        "then; largest values:\n"
    )
    message = json.loads(run("floors", "--points", 2, "--json")[1])
    assert (message["scenes"], message["without_answer"]) == (3, 1)


@pytest.mark.parametrize("options", [(), ("--quiet",), ("--json",), ("--json", "--quiet")])
def test_the_schema_is_printed(run, options):
    code, out, _ = run("schema", *options)
    found = json.loads(out)
    assert code == 0
    assert "structure" in (found["schema"] if "--json" in options else found)["properties"]


@pytest.mark.parametrize(
    "name", ["spectrum", "overturning", "response", "fragility --synthetic 2", "design --example column"]
)
def test_unwritable_paths_are_reported_before_computing(run, tmp_path, monkeypatch, name):
    (tmp_path / "file").touch()
    (tmp_path / "taken.nc").mkdir()
    (tmp_path / "taken.json").mkdir()
    for verb in ("rocking_spectra", "overturning_spectrum", "simulate", "incremental_dynamic_analysis"):
        monkeypatch.setattr(rj, verb, None)
    for output, words in (
        ("file/below", r"file/below\S+ could not be written: Not a directory"),
        ("taken", r"taken\.(nc|json) could not be written: it is a folder"),
    ):
        code, out, err = run(*name.split(), "-o", output, "-q")
        assert code == 1
        assert out == ""
        assert re.search(words, err)
    assert sorted(os.listdir()) == ["file", "taken.json", "taken.nc"]


def test_a_folder_holds_the_files_and_a_suffix_is_their_format(run, tmp_path):
    (tmp_path / "frame.toml").write_text(FRAME)
    (tmp_path / "there").mkdir()
    for output, files in (
        ("there", ["there/rockjax-response.nc", "there/rockjax-response.png"]),
        ("new/", ["new/rockjax-response.nc", "new/rockjax-response.png"]),
        ("a.pdf", ["a.nc", "a.pdf"]),
        ("v1.2", ["v1.2.nc", "v1.2.png"]),
        ("b.nc", ["b.nc", "b.png"]),
    ):
        code, out, err = run("response", "frame.toml", "-o", output, "--json")
        assert code == 0, err
        assert json.loads(out)["files"] == files
        assert all(Path(name).is_file() for name in files)
    assert Path("a.pdf").read_bytes().startswith(b"%PDF")
    assert attributes("b.nc")["Conventions"] == "CF-1.8"
    assert run("plot", "b.nc", "-o", "c.svg")[0] == 0
    assert Path("c-response.svg").is_file()


def test_a_pipe_that_is_closed_early_is_no_error(tmp_path):
    """`| head -1` closes the pipe early. Further text is discarded, and the files are written."""
    (tmp_path / "record.txt").write_text("0\n1\n-1\n0\n")
    command = [sys.executable, "-m", "rockjax", *words("motions record.txt --units g --dt 0.1 -o a")]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        running.stdout.close()
        message = running.stderr.read().decode()
        assert running.wait(timeout=300) == 0, message
    assert "Broken pipe" not in message
    assert "Traceback" not in message
    assert (tmp_path / "a.nc").exists()


def test_wrong_input_ends_a_process_with_a_line(tmp_path):
    command = [sys.executable, "-m", "rockjax", "spectrum", "--points", "100000"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith(
        "rockjax: --points: 120000000000 scenes need about 17.5 TiB of memory, but only "
    )


def test_ctrl_c_ends_with_130(run, monkeypatch):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(rj, "simulate", stopped)
    monkeypatch.setattr(rj, "incremental_dynamic_analysis", stopped)
    for line in ("response --json", "fragility --synthetic 2 -q"):
        code, out, err = run(*line.split())
        assert code == 130
        assert out == ""
        assert "rockjax: stopped; no results were saved" in err
    assert os.listdir() == []


@pytest.mark.slow(but=["spectrum"])
@pytest.mark.parametrize("command", ["spectrum", "overturning"])
def test_ctrl_c_while_files_are_written_loses_nothing(run, monkeypatch, command):
    line = f"{command} --gamma 10 --eta 20 --T-s 0 --frequency 2 4 --points 3 -q -o study".split()

    def stopped(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as context:
        context.setattr("rockjax._files.write_dataset", stopped)
        code, _, err = run(*line)
    assert code == 130
    assert "saved in study.partial.nc; repeat the command with --resume to continue" in err
    monkeypatch.setattr(rj, "overturning_spectrum", stopped)
    assert run(*line, "--resume")[0] == 0
    assert "study.nc" in os.listdir()
    assert "study.partial.nc" not in os.listdir()
    drawn = "overturning" if command == "spectrum" else "boundaries"
    assert f"study-{drawn}.png" in os.listdir()


@pytest.mark.slow
def test_a_fragility_of_a_file_and_its_pictures(run, tmp_path, monkeypatch):
    """Run the example with fewer records and levels, and then with the same records from files."""
    text = (
        (PROBLEMS / "fragility.toml")
        .read_text()
        .replace("synthetic = 20", "synthetic = 5")
        .replace("15.0", "8.0")
    )
    (tmp_path / "small.toml").write_text(text.replace('["alpha", "gamma"]', "[]"))
    few = ("--levels", 3, "--intensity", 0.3, 0.9)
    code, out, err = run("fragility", "small.toml", *few, "-o", "a", "--json")
    assert code == 0, err
    message = json.loads(out)
    curve, analysis = (xarray.load_dataset("a.nc", group=group) for group in (None, "analysis"))
    assert message["median"] == float(curve["median_capacity"])
    assert message["median_interval"] == curve["interval"].values[0].tolist()
    assert "median_sensitivity" not in message
    assert message["files"] == ["a.nc", "a-fragility.png", "a-ida.png"]
    assert curve.attrs["command"].startswith("rockjax fragility small.toml")
    noise = rj.synthetic_motions(5, seed=1, duration=8.0)
    np.testing.assert_allclose(analysis["measure"], [motion.pgv for motion in noise], rtol=1e-12)
    assert analysis["record"].values.tolist() == noise.names
    assert analysis["intensity"].values.tolist() == pytest.approx([0.3, 0.6, 0.9])
    drawn = [(tmp_path / name).read_bytes() for name in message["files"][1:]]
    for name in message["files"][1:]:
        (tmp_path / name).unlink()
    assert run("plot", "a.nc")[0] == 0
    assert [(tmp_path / name).read_bytes()[:8] for name in message["files"][1:]] == [
        picture[:8] for picture in drawn
    ]
    # With sensitivities of the capacities, here inserted by hand, the sensitivity of the median is printed
    # and written.
    analysis["sensitivity"] = ("parameter", "record"), np.array([[1.0] * 5, [-0.5] * 5])
    analysis = analysis.assign_coords(parameter=["alpha", "gamma"])
    asked = []
    with monkeypatch.context() as patch:
        patch.setattr(rj, "incremental_dynamic_analysis", lambda *_, **given: asked.append(given) or analysis)
        code, out, err = run("fragility", "small.toml", *few, "--sensitivities", "alpha,gamma", "-o", "d")
        assert code == 0, err
        message = json.loads(
            run("fragility", "small.toml", *few, "--sensitivities", "alpha,gamma", "-o", "d", "--json")[1]
        )
    assert [given["sensitivities"] for given in asked] == [["alpha", "gamma"]] * 2
    expected = rj.fragility(analysis, confidence=None)["median_sensitivity"].values
    assert expected[0] == pytest.approx(-2 * expected[1])
    for name, value in zip(("alpha", "gamma"), expected, strict=True):
        assert f"d ln(median)/d ln {name}: {value:.4g}\n" in out
        assert message["median_sensitivity"][name] == pytest.approx(value)
    # If nothing overturns there is no curve; the analysis is written and a message states the reason.
    for k, motion in enumerate(noise):
        motion.save(tmp_path / "suite" / f"{k}.AT2")
    frame = words("--tan-alpha 0.2 --eta 50 --T-s 0 --measure PGV --levels 3 --intensity 0.01 0.02")
    code, out, err = run("fragility", "suite", *frame, "-q", "-o", "b")
    assert code == 1
    assert out == ""
    assert "no curve: fragility: only 0 of 5 records overturn up to the highest intensity 0.02, but" in err
    assert xarray.load_dataset("b.nc").attrs["kind"] == "incremental-dynamic-analysis"
    assert run("plot", "b.nc", "-o", "c")[0] == 0
    assert (tmp_path / "c-ida.png").exists()


def test_a_design_takes_options_over_its_file(run, monkeypatch, tmp_path):
    from optimise import _cli

    found = []

    def design_command(problem, *rest):
        found.append((problem, *rest))
        raise KeyboardInterrupt

    monkeypatch.setattr(_cli, "design_command", design_command)
    flags = ("--top-mass", 4e5, "--zeta", 0.1, "--rtol", 1e-6, "--starts", 2)
    assert run("design", PROBLEMS / "column.toml", *flags)[0] == 130
    problem, output, quiet, suffix = found[0]
    assert problem.podium.top_mass == 4e5
    assert problem.podium.damping == 0.1
    assert problem.podium.width == 0.45
    assert (problem.options.rtol, problem.options.atol) == (1e-6, 1e-8)
    assert (str(output), problem.settings, quiet, suffix) == ("rockjax-design", {"starts": 2}, False, ".png")
    code, _, err = run("design", PROBLEMS / "column.toml", "--gamma", 2)
    assert code == 2
    assert "--gamma: unknown key; valid keys are width, height, column_mass" in err


def test_friction_of_a_design_overrides_its_file(run, calls, monkeypatch, tmp_path):
    from optimise import _cli

    monkeypatch.setattr(_cli, "design_command", lambda *_: (SimpleNamespace(podium=None), [], None))
    monkeypatch.setattr(_cli, "joint_peaks", lambda *_: None)
    found = calls("rockjax._cli._design.joint_warnings")
    (tmp_path / "column.toml").write_text("friction = 0.5\n" + (PROBLEMS / "column.toml").read_text())
    for flags in ((), ("--friction", 0.2)):
        run("design", "column.toml", *flags)
    assert [arguments[2] for arguments, _ in found] == [0.5, 0.2]


def test_ctrl_c_during_a_design_writes_the_best_one(run, monkeypatch, tmp_path):
    (tmp_path / "p.toml").write_text(
        "[structure]\ntan_alpha = 0.15\nR = 1.5\n[vary]\nalpha = [0.05, 0.5]\n[minimise]\nquantity = "
        '"alpha"\n'
    )

    monkeypatch.setattr("optimise._design.bar_of", lambda *_: contextlib.nullcontext(Stops(3)))
    code, out, err = run("design", "p.toml", "-o", "d")
    assert code == 130
    assert re.search("^rockjax: stopped after [0-9]+ iterations; the best design so far is saved$", err, re.M)
    assert "interrupted, targets satisfied" in out
    account = json.loads((tmp_path / "d.json").read_text())
    assert account["result"] == "interrupted"
    assert 0.05 <= account["variables"]["alpha"] < math.atan(0.15)
    assert (tmp_path / "d-convergence.png").exists()
    assert "wrote d-convergence.png" in out


ON_FLOORS = """
[[contents]]
name = "cabinet"
width = 0.16
height = 1.6
[[contents]]
alpha = 0.3
R = 0.5
vertical = false
[[oscillators]]
period = 0.3
damping = 0.02
"""


@pytest.mark.slow
def test_a_response_has_blocks_and_oscillators_on_the_floors(run, tmp_path):
    pulse = "[motions.pulse]\nkind = 'ricker'\na_p = 3.2\nT_p = 1.0\n"
    podium = "[structure]\nalpha = 0.15\nR = 1.5\ngamma = 10.0\n"
    problem = tmp_path / "floors.toml"
    problem.write_text(podium + pulse + ON_FLOORS)
    code, out, _ = run("response", problem, "-o", "a")
    assert code == 0
    assert "block 1" in out and "block 2" in out and "oscillator 3" in out  # noqa: PT018
    systems = rj.Contents.from_dimensions(0.16, 1.6), rj.Contents(0.3, 0.5, vertical=False)
    one = rj.peak_response(
        rj.Podium(0.15, 1.5, 10.0),
        rj.Ricker(3.2, 1.0),
        options=rj.Options(rtol=1e-8, atol=1e-10),
        on_floors=(*systems, rj.Oscillator(0.3, 0.02)),
    )
    with xarray.open_dataset("a.nc") as data:
        found = data["contents_peak_rotation"].sel(contents=["cabinet", "contents-2"])
        np.testing.assert_allclose(found, [y.peak_rotation for y in one.on_floors[:2]], rtol=1e-5)
        found = float(data["oscillator_pseudo_acceleration"].sel(oscillator="oscillators-1"))
        np.testing.assert_allclose(found, one.on_floors[2].pseudo_acceleration, rtol=1e-5)
    message = json.loads(run("response", problem, "-o", "a", "--json")[1])
    assert message["contents_overturned"].keys() == {"cabinet", "contents-2"}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("width = 0.16", "", "contents[0]: needs alpha or width"),
        ("height = 1.6", "", "contents[0]: needs alpha and R, or width and height"),
        ("height = 1.6", "height = 1.6\nR = 1.0", "contents[0]: needs alpha and R, or width and height"),
        ("alpha = 0.3", "alpha = 3", "contents[1].alpha: must be less than 1.57"),
        ("vertical = false", "level = 0", "contents[1].level: must be 'deck' or the number of a story ≥ 1"),
        ("vertical = false", "overturn_ratio = 9.0", "contents[1]: Contents: overturn_ratio times alpha"),
        ("vertical = false", 'name = "cabinet"', "contents[1]: name must not repeat an earlier name"),
        ("damping = 0.02", "damping = 1.0", "oscillators[0].damping: must be a number in [0, 1)"),
    ],
)  # fmt: skip
def test_wrong_keys_of_blocks_and_oscillators_are_named(run, tmp_path, old, new, words):
    problem = tmp_path / "floors.toml"
    problem.write_text("[structure]\nalpha = 0.15\nR = 1.5\n" + ON_FLOORS.replace(old, new, 1))
    code, _, err = run("response", problem, "--a-p", "3.2", "--T-p", "1")
    assert code == 2
    assert f"floors.toml: {words}" in err


@pytest.mark.slow
def test_a_fragility_has_a_table_of_contents(run, tmp_path):
    problem = tmp_path / "floors.toml"
    motions = "[motions.noise]\nsynthetic = 6\nseed = 1\nduration = 5.0\n"
    podium = "[structure]\nalpha = 0.15\nR = 1.5\ngamma = 10.0\n"
    problem.write_text(podium + motions + ON_FLOORS + "[fragility]\nintensity = [0.7, 9.0]\nlevels = 8\n")
    code, out, err = run("fragility", problem, "-o", "a", "--damage-states", "0,1")
    assert code == 0, err
    rows = [line.split() for line in out.splitlines() if line.startswith(("cabinet", "contents-2"))]
    with xarray.open_dataset("a.nc", group="contents") as data:
        assert data["damage_state"].values.tolist() == [0.0, 1.0]
        medians = data["median_capacity"].values.ravel()
    assert [row[1] for row in rows] == ["rocks", "1", "rocks", "1"]
    np.testing.assert_allclose([float(row[2]) for row in rows], medians, rtol=1e-3)
    assert np.isfinite(medians[0])
    assert (tmp_path / "a-contents.png").exists()
    facts = json.loads(run("fragility", problem, "-o", "a", "--json")[1])["contents"]
    assert len(facts) == 6


def test_floors_writes_spectra_and_their_picture(run, tmp_path):
    problem = tmp_path / "floors.toml"
    table = "[floors]\nmotion = 'pulses'\nperiods = [0.1, 1.0]\npoints = 4\nt_end = 4.0\n"
    problem.write_text(FRAME + table)
    code, out, _ = run("floors", problem, "--oscillator-damping", "0.02,0.05", "-o", "f.pdf")
    assert code == 0
    assert re.search(r"deck +acceleration 0\.\d+ g, velocity jump 0\.\d+ m/s, spectrum", out)
    with xarray.open_dataset(tmp_path / "f.nc") as data:
        assert data["pseudo_acceleration"].sizes == {"motion": 2, "level": 2, "damping": 2, "period": 4}
        assert data["ground_pseudo_acceleration"].dims == ("motion", "damping", "period")
        np.testing.assert_allclose(data["period"], np.geomspace(0.1, 1.0, 4))
    assert (tmp_path / "f.pdf").exists()
    assert run("plot", "f.nc")[0] == 0
    assert (tmp_path / "f-floors.png").exists()
    code, out, _ = run("floors", problem, "--number", "1", "--levels", "deck", "--json")
    assert json.loads(out)["levels"]["deck"]["peak_velocity_jump"] > 0
    code, _, err = run("floors", problem, "--levels", "3")
    assert (code, "story from 1 to 1, got level = 3" in err) == (2, True)


@pytest.fixture
def calls(monkeypatch):
    """Return a function that replaces a function by one that stops the command. It returns a list, in which
    the arguments of the call are recorded as (positional arguments, keyword arguments)."""

    def record(target):
        found = []

        def stop(*arguments, **given):
            found.append((arguments, given))
            raise KeyboardInterrupt

        monkeypatch.setattr(target, stop)
        return found

    return record


@pytest.mark.parametrize(
    ("command", "function"),
    [("peaks", "peak_responses"), ("floors", "floor_spectrum"), ("ensemble", "ensemble"), ("sweep", "grid")],
)
def test_a_number_in_the_file_selects_one_motion(run, calls, tmp_path, command, function):
    found = calls(f"rockjax.{function}")
    axis = ("--axis", "gamma=1,2") if command == "sweep" else ()
    for number in (2, 3):
        (tmp_path / "frame.toml").write_text(FRAME + f"[{command}]\nmotion = 'pulses'\nnumber = {number}\n")
        code, _, err = run(command, "frame.toml", *axis)
        if number == 2:
            ((_, motion, *_),) = [arguments for arguments, _ in found]
            assert np.ravel(motion.a_p) == pytest.approx([3.0 * 0.15 * 9.80665])
        else:
            assert (code, "motions.pulses: number must be from 1 to 2, got 3" in err) == (2, True)


@pytest.mark.parametrize(
    ("command", "function"), [("peaks", "peak_responses"), ("ensemble", "ensemble"), ("sweep", "sweep")]
)
def test_outputs_of_the_command_replace_those_of_the_options(run, calls, tmp_path, command, function):
    found = calls(f"rockjax.{function}")
    axis = ("--axis", "gamma=1,2") if command == "sweep" else ()
    common = FRAME + "outputs = ['peak_shear']\n"
    table = f"[{command}]\nmotion = 'pulses'\n"
    for text, flags in (
        (table, ()),
        (table + "outputs = ['margin']\n", ()),
        (table + "outputs = ['margin']\n", ("--outputs", "peak_rotation")),
    ):
        (tmp_path / "frame.toml").write_text(common + text)
        run(command, "frame.toml", *axis, *flags)
    assert [given["options"].outputs for _, given in found] == [
        ("peak_shear",),
        ("margin",),
        ("peak_rotation",),
    ]


def test_peaks_of_every_motion_of_a_set(run, tmp_path):
    problem = tmp_path / "frame.toml"
    problem.write_text(FRAME.replace("[2.0, 3.0]", "[2.0, 20.0]") + "[peaks]\nmotion = 'pulses'\n")
    code, out, err = run("peaks", problem, "-o", "p.pdf")
    assert code == 0, err
    assert "50.0% overturned (peaks until overturning)" in out
    assert "impact law       paper, e = 0.956678" in out
    ((time,),) = [
        re.findall(r"overturned  until (\S+) s ", line) for line in out.splitlines() if "until " in line
    ][1:]
    assert "not checked, because the structure has no elevation" in out
    data = xarray.load_dataset("p.nc")
    assert data["overturned"].values.tolist() == [False, True]
    assert data.attrs["kind"] == "peaks"
    assert float(time) == pytest.approx(float(data["overturn_time"][1]), rel=1e-3)
    assert (tmp_path / "p.pdf").exists()
    assert run("plot", "p.nc")[0] == 0
    assert (tmp_path / "p-peaks.png").exists()
    code, out, _ = run("peaks", problem, "--json", "-o", "again", "--number", 1)
    (row,) = json.loads(out)["motions"]
    assert row["result"] == "settled"
    assert row["θ/α [–]"] == float(data["peak_rotation"][0])
    code, out, _ = run("peaks", problem, "--json", "-o", "larger", "--number", 1, "--factor", 10)
    assert json.loads(out)["motions"][0]["result"] == "overturned"
    code, _, err = run("peaks", problem, "--outputs", "peak_drift")
    assert (code, "peak_drift" in err) == (2, True)
    code, out, _ = run("peaks", problem, "--outputs", "impacts", "-o", "numbers")
    assert (code, "impacts" in out) == (0, True)
    assert (tmp_path / "numbers.nc").exists()
    assert not (tmp_path / "numbers.png").exists()
    code, _, err = run("plot", "numbers.nc")
    assert (code, "no peaks to draw" in err) == (2, True)


def test_cells_of_peaks_without_a_finite_value():
    from rockjax._cli._peaks import _format_cell

    cells = [_format_cell(y) for y in (0.25, np.inf, np.nan, "settled")]
    assert cells == ["0.25", "infinite", "no value", "settled"]


def test_an_ensemble_writes_its_scenes_and_a_picture_for_each_peak(run, tmp_path):
    problem, spread = tmp_path / "frame.toml", "\n[ensemble.spread]\n"
    table = "[ensemble]\nmotion = 'pulses'\nn = 50\noutputs = ['peak_rotation', 'peak_shear']\n"
    laws = (
        "R = { kind = 'lognormal', median = 2.0, cov = 0.1 }\ntan_alpha = { kind = 'normal', mean = 0.15, "
        "cov = 0.05, low = 0.1, high = 0.2 }\nscale = { kind = 'uniform', low = 0.9, high = 1.1 }\n"
        "'initial.theta' = 0.001\n"
    )
    problem.write_text(FRAME + table + spread + laws)
    code, out, err = run("ensemble", problem, "--seed", 3, "-o", "e.pdf")
    assert code == 0, err
    assert out.startswith("Ensemble of 50 scenes: ")
    assert re.search(r"^ +tan_alpha \[–\] +0\.1\d+ ", out, re.M)
    assert (tmp_path / "e-peak-rotation.pdf").exists()
    assert (tmp_path / "e-peak-shear.pdf").exists()
    found = rj.Ensemble(xarray.load_dataset("e.nc"))
    assert set(found.data["motion"].values.tolist()) == {"Ricker(2.942, 0.8)", "Ricker(4.413, 0.8)"}
    assert np.all(np.abs(found.draws["scale"] - 1) <= 0.1)
    assert set(found.draws["initial.theta"]) == {0.001}
    assert np.log(found.draws["R"] / 2).std() == pytest.approx(0.1, rel=0.3)
    assert run("plot", "e.nc")[0] == 0
    assert (tmp_path / "e-peak-shear.png").exists()
    code, out, _ = run("ensemble", problem, "--seed", 3, "--json", "-o", "again")
    message = json.loads(out)
    assert message["scenes"] == 50
    assert message["quantiles"]["peak_shear"]["0.5"][0] == float(
        found.quantiles("peak_shear", 0.5)["quantile"][0]
    )
    low, high = message["overturning_interval"]
    assert low <= message["overturning"] <= high
    for wrong, words in (
        ("alhpa = 0.1", "ensemble: names in spread must each be one of .* did you mean 'alpha'"),
        (
            "R = { kind = 'gumbel' }",
            "ensemble.spread.R.kind: must be one of 'normal', 'lognormal', 'uniform'",
        ),
        ("R = { kind = 'normal', mean = 2.0 }", "ensemble.spread.R: needs std or cov"),
        ("R = { kind = 'normal', mean = 0.0, cov = 0.1 }", "cov needs a mean other than 0"),
        ("R = { kind = 'uniform', low = 2.0, high = 1.0 }", "low must be less than high, got 2 and 1"),
        (
            "R = { kind = 'normal', mean = 1.0, std = 1.0 }",
            "must be finite and > 0, but .* of 50 draws are not",
        ),
        ("R = 'wide'", "ensemble.spread.R: must be a number, got 'wide'"),
    ):
        problem.write_text(FRAME + table + spread + wrong)
        code, _, err = run("ensemble", problem)
        assert code == 2
        assert re.search(words, err), err


def test_an_ensemble_is_compared_with_another_law_and_with_a_file(run, tmp_path):
    problem = tmp_path / "frame.toml"
    table = "[ensemble]\nmotion = 'pulses'\nn = 50\nt_end = 20.0\noutputs = ['peak_rotation', 'peak_shear']\n"
    problem.write_text(
        FRAME + table + "[ensemble.spread]\nR = { kind = 'lognormal', median = 2.0, cov = 0.1 }\n"
    )
    code, out, err = run("ensemble", problem, "--against", "0.5", "--seed", 3, "--json", "-o", "e")
    assert code == 0, err
    first, second = (rj.Ensemble(xarray.load_dataset(f"e{name}.nc")) for name in ("", "-against"))
    assert (first.data.attrs["seed"], second.data.attrs["seed"]) == (3, 4)
    assert second.data.attrs["restitution_factor"] == 0.5
    found, expected = json.loads(out)["comparisons"]["peak_rotation"], first.compare(second)
    assert found["statistic"] == expected.statistic > 0.3
    assert found["p_value"] == pytest.approx(expected.p_value)
    assert (tmp_path / "e-peak-rotation-quantiles.png").exists()
    code, out, err = run("ensemble", problem, "--against", "e-against.nc", "--seed", 3, "-o", "f")
    assert code == 0, err
    assert (
        f"peak_rotation against e-against.nc: largest distance of the distributions {expected.statistic:.4g}"
        in out
    )
    for against, words in (
        ("e.nc", "ensemble.against: the file has the seed 3, like this ensemble"),
        ("g.nc", "ensemble.against: must be a file of `rockjax ensemble` or a law, got 'g.nc'"),
        ("rigid", "ensemble.against: .*restitution"),
    ):
        code, _, err = run("ensemble", problem, "--against", against, "--seed", 3, "-o", "g")
        assert (code, bool(re.search(words, err))) == (2, True), err


def test_ctrl_c_during_an_ensemble_writes_the_solved_scenes(run, monkeypatch, tmp_path):
    monkeypatch.setattr("rockjax._progress.bar", lambda *_, **__: contextlib.nullcontext(Stops(50)))
    table = "[ensemble]\nmotion = 'pulses'\nn = 50\noutputs = ['peak_rotation', 'peak_shear']\n"
    (tmp_path / "p.toml").write_text(FRAME + table + "[ensemble.spread]\nR = 2.0\n")
    code, _, err = run("ensemble", "p.toml")
    assert code == 130
    assert "written so far: rockjax-ensemble.nc" in err
    assert rj.Ensemble(xarray.load_dataset("rockjax-ensemble.nc")).size == 50


MIXED = (
    FRAME
    + """
[[motions.mixed]]
synthetic = 2
seed = 3
dt = 0.04
duration = 4.0
scale = 1.5
[[motions.mixed]]
kind = "ricker"
a_p = [3.0, 30.0]
T_p = 0.8
"""
)


def test_peaks_of_a_set_of_records_and_pulses(run, tmp_path):
    (tmp_path / "m.toml").write_text(MIXED)
    flags = ("m.toml", "--motion", "mixed", "--outputs", "peak_rotation")
    code, _, err = run("peaks", *flags, "-o", "m")
    assert code == 0, err
    data = xarray.load_dataset("m.nc")
    names = ["synthetic-0001", "synthetic-0002", "Ricker(3, 0.8)", "Ricker(30, 0.8)"]
    assert data["motion"].values.tolist() == names
    assert data["overturned"].values.tolist() == [False, False, False, True]
    assert data.attrs["record_sha256"][2:] == ["", ""]
    assert data.attrs["record_scale"].tolist() == [1.5, 1.5, 1.0, 1.0]
    for number in (2, 3):
        assert run("peaks", *flags, "--number", number, "-o", "one")[0] == 0
        one = xarray.load_dataset("one.nc")
        assert one["motion"].values.tolist() == [names[number - 1]]
        assert float(one["peak_rotation"][0]) == pytest.approx(
            float(data["peak_rotation"][number - 1]), rel=1e-9
        )
        assert one.attrs.get("record_seed") == (3 if number == 2 else None)
    for command in ("sweep", "ensemble"):
        code, _, err = run(command, *flags, *(("--axis", "R=1,2") if command == "sweep" else ()))
        assert code == 2
        assert (
            f"m.toml: motions.mixed: `rockjax {command}` needs motions of one kind, got 2 Record, 2 Ricker"
            in err
        )


COMMANDS = (
    "spectrum",
    "overturning",
    "response",
    "peaks",
    "floors",
    "ensemble",
    "fragility",
    "design",
    "motions",
    "synthetic",
    "plot",
    "schema",
    "cache",
)


@pytest.mark.smoke
@pytest.mark.parametrize("name", COMMANDS)
def test_help_teaches(run, name):
    """The help shows units, which are not interpreted as markup, and groups options in panels; its examples
    are valid."""
    command = typer.main.get_command(app).commands[name]
    code, out, _ = run(name, "--help")
    assert code == 0
    shown = re.sub(r"[\s│]+", "", out)
    description = command.help.partition("\b")[0].replace("\\[", "[")
    assert re.sub(r"\s+", "", description) in shown
    for parameter in command.params:
        text = (parameter.help or "").replace("\\[", "[")
        assert re.sub(r"\s+", "", text) in shown, parameter.name
        assert parameter.name in ("help", "ctx") or text
    for panel in {getattr(parameter, "rich_help_panel", None) for parameter in command.params} - {None}:
        assert f" {panel} " in out
    written = re.sub(r"\\\s*\n", " ", out.split("Examples:")[1])  # continued lines
    examples = re.findall(rf"^ +rockjax {name}\b(.*)$", written, re.M)
    assert len(examples) >= 2
    for example in examples:
        command.make_context(name, example.split())


@pytest.mark.parametrize("name", COMMANDS)
def test_numbers_have_units_in_the_help(run, name):
    lines = [line for line in run(name, "--help")[1].splitlines() if re.search(r"<float|FLOAT", line)]
    assert lines or name in ("plot", "schema", "cache")
    for line in lines:
        assert re.search(r"\[(m|s|rad|Hz|–|kg|N|N/m|N \(s/m\)\^ν|m/s|m/s²|rad/s)\]", line), line


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_survive_80_columns(run, monkeypatch, name):
    monkeypatch.setenv("COLUMNS", "80")
    command = typer.main.get_command(app).commands[name]
    given = [line.strip() for line in command.help.split("Examples:")[1].splitlines() if line.strip()]
    shown = [line.strip() for line in run(name, "--help")[1].splitlines()]
    assert given
    assert [line for line in given if line not in shown] == []


def test_no_colour_means_no_codes():
    for variables, coded in (({}, True), ({"NO_COLOR": "1"}, False)):
        environment = {name: value for name, value in os.environ.items() if name != "NO_COLOR"} | {
            "FORCE_COLOR": "1"
        }
        done = subprocess.run(
            [sys.executable, "-m", "rockjax", "--help"],
            capture_output=True,
            text=True,
            env=environment | variables,
        )
        assert "Rocking podium structures" in done.stdout
        assert ("\x1b[" in done.stdout) is coded


def test_examples_come_with_the_package():
    from rockjax._cli._options import Example

    choices = get_args(get_args(get_args(Example)[0])[0])
    assert sorted(path.stem for path in PROBLEMS.glob("*.toml")) == sorted(choices)
    assert optimise.load(PROBLEMS / "column.toml").settings == {"starts": 4}
    assert optimise.__version__ == rj.__version__
    assert (Path(optimise.__file__).parent / "py.typed").exists()


def test_version_and_completion(run, monkeypatch):
    assert run("--version") == (0, f"rockjax {rj.__version__}\n", "")
    for line, words in (
        ("rockjax spec", "spectrum"),
        ("rockjax spectrum --pulse half", "half-sine"),
        ("rockjax response --restitution comp", "compatible"),
        ("rockjax fragility --meas", "--measure"),
    ):
        environment = {
            "COMP_WORDS": line,
            "COMP_CWORD": str(len(line.split()) - 1),
            "_ROCKJAX_COMPLETE": "complete_bash",
        }
        result = RUN.invoke(app, [], prog_name="rockjax", env=environment)
        assert words in result.output.split(), result.output


@pytest.mark.parametrize("arguments", [["--help"], ["spectrum", "--help"], ["--version"]])
def test_help_and_version_load_nothing_heavy(arguments):
    loaded = modules_of([sys.executable, "-m", "rockjax", *arguments])
    heavy = {
        "jax",
        "jaxlib._jax",  # only the version of jaxlib is needed
        "jaxlib.xla_client",
        "numpy",
        "equinox",
        "matplotlib",
        "xarray",
        "netCDF4",
        "tqdm",
        "optimise",
        "clarabel",
        "pandas",
    }
    assert "rockjax._cli._spectrum" in loaded
    assert not heavy & loaded


@pytest.mark.smoke
def test_imports_of_the_package():
    loaded = modules_of([sys.executable, "-c", "import rockjax"])
    assert {"jax", "rockjax._engine.solve"} <= loaded
    late = {"diffrax", "optimistix", "lineax", "xarray", "matplotlib", "scipy", "pandas", "tqdm", "optimise"}
    late |= {"jinja2", "xlsxwriter", "rockjax._report"}
    assert not late & loaded


def modules_of(command):
    """Return the modules that a Python process imports."""
    environment = os.environ | {"PYTHONPROFILEIMPORTTIME": "1"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)
    assert done.returncode == 0, done.stderr
    return {
        line.split("|")[-1].strip() for line in done.stderr.splitlines() if line.startswith("import time:")
    }


@pytest.mark.smoke
def test_every_public_name_is_there():
    assert set(rj.__all__) <= set(dir(rj))
    for name in rj.__all__:
        assert getattr(rj, name).__name__ == name
    done = subprocess.run(
        [sys.executable, "-c", "import rockjax as rj; print(rj.plots.spectra.__name__)"],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.stdout == "spectra\n", done.stderr
    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = rj.no_such_thing


def test_the_command_line_computes_in_float64(tmp_path):
    script = tmp_path / "rockjax"  # the name of the installed command
    script.write_text("import rockjax; import jax; print(jax.numpy.ones(1).dtype, rockjax.Podium.__name__)")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == ["float64", "Podium"], done.stderr


@pytest.mark.slow
def test_a_response_of_the_example(run):
    """The second motion is the pulse of the README."""
    code, out, err = run("response", PROBLEMS / "response.toml", "--number", 2, "--json")
    assert code == 0, err
    message = json.loads(out)
    assert message["result"] == "end_of_time"
    assert message["peak_rotation"] == pytest.approx(0.831162, abs=1e-6)
    assert message["files"] == ["rockjax-response.nc", "rockjax-response.png"]


def test_overturning_writes_its_spectrum_and_pictures(tmp_path):
    prefix = tmp_path / "study"
    flags = [
        "--points",
        "9",
        "--T-s",
        "0",
        "--eta-over-gamma",
        "1,5",
        "--sensitivities",
        "alpha",
        "-o",
        str(prefix),
    ]
    result = RUN.invoke(app, ["overturning", *flags])
    assert result.exit_code == 0, result.output
    data = xarray.load_dataset(f"{prefix}.nc")
    assert data.sizes["eta_over_gamma"] == 2
    assert data.sizes["T_s"] == 1
    assert (data["T_s"].attrs["units"], data["eta_over_gamma"].attrs["units"]) == ("s", "1")
    podium = rj.Podium(math.atan(0.15), 1.5, 10.0, rj.Rigid(50.0))
    one = data.sel(eta_over_gamma=5.0, T_s=0.0).isel(frequency_ratio=2)
    exact = float(rj.overturning_acceleration(podium, rj.Ricker, float(one["T_p"]))) / (
        float(podium.g) * 0.15
    )
    assert float(one["minimum"]) == pytest.approx(exact, rel=1e-10)
    for suffix in ("boundaries", "sensitivity"):
        assert (tmp_path / f"study-{suffix}.png").read_bytes().startswith(b"\x89PNG")
    assert "least overturning a_p/(g tan α), η/γ = 5" in result.output


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ("", "No design within the bounds was found"),
        ("[options]\nmax_steps = 5\n", "A response is not finite, a simulation did not finish"),
    ],
)
def test_design_that_cannot_be_ends_with_one(tmp_path, options, reason):
    problem = tmp_path / "problem.toml"
    problem.write_text(
        "[structure]\nalpha = 0.1\nR = 2.0\n[vary]\nalpha = [0.05, 0.12]\n"
        '[motions.pulses]\nkind = "ricker"\na_p = 6.0\nT_p = 1.5\n'
        '[[targets]]\nkind = "no-overturning"\nmotions = "pulses"\n' + options
    )
    result = RUN.invoke(app, ["design", str(problem), "-o", str(tmp_path / "out")])
    assert result.exit_code == 1
    assert re.search("not (satisfied|verified): no overturning", result.output)
    assert f"rockjax: the targets are not satisfied. {reason}" in " ".join(result.output.split())
    assert (tmp_path / "out.json").exists()


@pytest.mark.slow
def test_chart_of_the_slimmest_safe_column():
    block = rj.Podium(alpha=0.15, R=1.5)
    T_p = np.linspace(0.5, 0.9, 7)
    chart = optimise.design_chart(block, ("alpha", (0.05, 0.4)), rj.Ricker, 3.0, T_p)
    least = chart["smallest_safe_value"].values[0]
    safe, fallen = (
        rj.peak_responses(block.replace(alpha=least * side), rj.Ricker(3.0, T_p)).overturned
        for side in (1 + 1e-7, 1 - 1e-7)
    )
    assert not np.any(safe)
    assert np.all(fallen)
    # If α is the smallest safe slenderness for a_p, then a_p is the least amplitude that overturns α.
    again = rj.overturning_acceleration(block.replace(alpha=least[3]), rj.Ricker, T_p[3])
    assert float(again) == pytest.approx(3.0, rel=1e-9)


def test_values_of_charts_whose_simulations_did_not_finish_are_not_safe():
    """The columns survive from the boundary 2 or in the whole range from 1; the other simulations may
    overturn."""
    boundaries = np.array([[2.0], [2.0], [2.0], [np.nan], [np.nan], [2.0]])
    lower_end_survives = np.array([False, False, False, True, True, True])
    last_unfinished = np.array([-np.inf, 1.5, 2.5, -np.inf, 1.0, -np.inf])
    values = _smallest_safe_value(boundaries, lower_end_survives, last_unfinished, 1.0)
    np.testing.assert_array_equal(values, [2.0, 2.0, np.nan, 1.0, np.nan, np.nan])


def test_invalid_charts_name_the_reason():
    block = rj.Podium(alpha=0.15, R=1.5)
    ask = lambda **more: optimise.design_chart(
        block, **({"vary": ("alpha", (0.1, 0.2)), "pulse": rj.Ricker, "a_p": 3.0, "T_p": [0.5, 1.0]} | more)
    )
    for change, words in (
        ({"vary": "alpha"}, "vary must be a pair"),
        ({"vary": ("beta", (0.1, 0.2))}, "names 'beta'"),
        ({"T_p": [1.0, 0.5]}, "ascending"),
        ({"a_p": -1.0}, "a_p must be finite and > 0"),
        ({"resolution": 3}, "resolution must be"),
    ):
        with pytest.raises(ValueError, match=words):
            ask(**change)


@pytest.mark.parametrize(
    ("top", "share"),
    [
        (None, 0.0),
        (rj.Rigid(3.0), 0.0),
        (rj.Elastic(3.0, 0.5, 0.05), 0.0),
        (rj.ShearBuilding([3.0, 3.0, 2.0], [900.0, 700.0, 500.0]), 0.0),
        (rj.ShearBuilding([3.0, 3.0, 2.0], [900.0, 700.0, 500.0], modes=1), 0.12276447943),
        (rj.ShearBuilding([3.0, 3.0, 2.0], [900.0, 700.0, 500.0], modes=0), 1.0),
        (rj.Modes([3.0, 1.0], [0.5, 0.2]), 0.0),
        (rj.Modes([3.0, 1.0], [0.5, 0.2], residual=1.0), 0.2),
    ],
)
def test_responses_know_the_mass_that_is_in_no_mode(top, share):
    """Shears and floor accelerations exclude the impulses on the residual mass, and the summary states
    this."""
    assert residual_share(rj.Podium(0.15, 1.5, 10.0, top)) == pytest.approx(share, rel=1e-9)


@pytest.mark.slow
def test_response_reports_omitted_modes(tmp_path):
    building = "masses = [3.0, 3.0, 2.0], stiffnesses = [900.0, 700.0, 500.0]"
    for modes, says in ((1, True), (3, False)):
        path = tmp_path / f"{modes}.toml"
        path.write_text(
            "[structure]\ntan_alpha = 0.15\nR = 1.5\ngamma = 10.0\n"
            f"superstructure = {{ {building}, modes = {modes} }}\n"
            '[motions.pulse]\nkind = "one-sine"\na_p = 2.0\nT_p = 0.6\n'
        )
        result = RUN.invoke(app, ["response", str(path), "-o", str(tmp_path / "out")])
        assert result.exit_code == 0, result.output
        assert ("12% of the mass of the superstructure is in no mode" in result.output) is says
