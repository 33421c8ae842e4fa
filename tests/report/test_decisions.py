"""Results of checks (PASS, FAIL, UNDECIDED, NOT VALID), and statistics over a set."""

import dataclasses
import hashlib
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray

import rockjax as rj
from rockjax._report.evaluate import (
    _compute,
    _evaluate,
    _sensitivities,
    decide,
    statistic_of,
    utilisations_of,
)
from rockjax._report.evaluation import Check, Evaluation, verdict
from rockjax._report.kinds import KINDS
from rockjax._report.kinds.base import Values, worst_of
from rockjax._report.kinds.risk import FailureKind
from rockjax._report.plausibility import warnings_of
from rockjax._report.scales import UnfinishedScenesError
from rockjax._report.scenes import Scenes
from rockjax._report.sections import structure, summary
from rockjax._report.sections.common import governing_scene
from rockjax._report.store import Store
from rockjax._report.tables import plain
from rockjax._report.units import Units
from rockjax._responses.estimate import SAFETY
from rockjax._results import NAMES

FILE = """
[structure]
width = 0.6
height = 3.0
column_mass = 2700.0
beam_mass = 60e3
[joints]
friction = 0.5
[motions.pulses]
kind = "ricker"
a_p = [2.5, 3.0]
T_p = 1.0
"""
CHECK = '[[checks]]\nkind = "peak-rotation"\nlimit = 0.5\nmotions = "pulses"\n'


def problem(tmp_path, checks=CHECK, file=FILE):
    path = Path(tmp_path) / "problem.toml"
    path.write_text(file + checks, encoding="utf-8")
    return rj.read_problem(path)


def values_of(*numbers, errors=None):
    blank = ("",) * len(numbers)
    return Values(
        np.array(numbers), np.zeros(len(numbers)) if errors is None else errors, blank, blank, blank, ()
    )


def result(value, limit, error=0.0, minimum=False, without=False, violated=False):
    found = statistic_of(values_of(value, errors=np.array([error])), "max", minimum)
    low, high = found.bounds
    return decide(utilisations_of(low, found.value, high, limit, minimum), without, violated)


def test_limits_close_to_the_value():
    """A value of 1 ± 1e-6 times the limit is decided; a difference of 1e-14 is rounding."""
    assert result(0.4, 0.4 * (1 + 1e-6)) == "PASS"
    assert result(0.4, 0.4 * (1 - 1e-6)) == "FAIL"
    assert result(0.4, 0.4 * (1 + 1e-14)) == result(0.4, 0.4 * (1 - 1e-14)) == "UNDECIDED"
    assert result(0.4, 0.41, error=2e-3) == "UNDECIDED"  # ten times the error exceeds the difference
    assert result(0.4, 0.41, error=5e-4) == "PASS"


def test_minima():
    """The utilisation of a minimum is limit/value, and infinite for a value that is not positive."""
    assert result(1.2, 1.0, minimum=True) == "PASS"
    assert result(0.9, 1.0, minimum=True) == "FAIL"
    assert result(-0.574, 0.1, minimum=True) == "FAIL"
    assert utilisations_of(-0.574, -0.574, -0.574, 0.1, True)[1] == math.inf
    assert utilisations_of(1.0214, 1.0214, 1.0214, 1.5, True)[1] == pytest.approx(1.4686, abs=5e-5)


def test_order_of_words():
    """FAIL comes before UNDECIDED, and both before NOT VALID."""
    assert result(math.inf, 0.5, without=True, violated=True) == "FAIL"
    assert result(0.4, 0.5, without=True, violated=True) == "UNDECIDED"
    assert result(0.4, 0.5, violated=True) == "NOT VALID"


@pytest.mark.parametrize(
    ("statistic", "expected"), [("max", 4.0), ("mean", 2.5), ("median", 2.5), ("p84", 1 + 3 * 0.84)]
)
def test_statistics(statistic, expected):
    """Quantiles are interpolated; an overturned scene makes mean and maximum infinite, not 1 α."""
    assert statistic_of(values_of(1.0, 2.0, 3.0, 4.0), statistic, False).value == pytest.approx(expected)
    overturned = statistic_of(values_of(1.0, 2.0, 3.0, math.inf), statistic, False).value
    assert overturned == (pytest.approx(2.5) if statistic == "median" else math.inf)


def computed(values, tmp_path, statistic, kind="peak-rotation", limit=0.5):
    """Return the check of a set with these values. Its slopes function gives the slopes 1, 2, … of the
    motions."""
    bound = "at_least" if KINDS[kind].is_minimum else "at_most"
    text = f'[[checks]]\nkind = "{kind}"\n{bound} = {limit}\nmotions = "pulses"\nstatistic = "{statistic}"\n'
    found = problem(tmp_path, text)
    motions = dataclasses.replace(found.motions["pulses"], names=values.names)
    blank = SimpleNamespace(identities=values.names, names=values.names)
    scenes = SimpleNamespace(
        problem=dataclasses.replace(found, motions={"pulses": motions}),
        motion_set=lambda name: blank,
        store=Store(),
        describe=lambda text: None,
        with_spread=True,
        variations=("width-", "width+"),
    )

    class Made(type(KINDS[kind])):
        def values(self, entry, scenes, law=None, variation=""):
            return values

        def tested_scenes(self, entry, scenes):
            return None

        def slopes_function(self, entry, scenes, case):
            v = float(values.values[case])
            return lambda: (v, v * (case + 1) * np.ones(6))

    fields = {field.name: getattr(KINDS[kind], field.name) for field in dataclasses.fields(KINDS[kind])}
    return _compute(found.checks[0], Made(**fields), scenes)


def named(*numbers, texts=None, states=None, errors=None):
    blank, names = ("",) * len(numbers), tuple(f"M{k + 1}" for k in range(len(numbers)))
    made = values_of(*numbers, errors=errors)._replace(names=names, unanswered=blank)
    return made._replace(texts=texts or blank, states=states or blank)


@pytest.mark.parametrize("statistic", ["max", "mean", "median", "p84"])
def test_one_overturned_motion_fails_every_statistic(tmp_path, statistic):
    """The check fails also under other laws of impact and with changed inputs, and has no derivatives."""
    for event, text in (("overturned", "overturned at 5.85 s"), ("joint opens", "joint opens")):
        count = 11
        texts, states = ("",) * (count - 1) + (text,), ("",) * (count - 1) + (event,)
        values = named(*[0.1] * (count - 1), math.inf, texts=texts, states=states)
        check = computed(values, tmp_path, statistic)
        assert (check.result, check.utilisation) == ("FAIL", math.inf)
        assert f"M11: {text}" in check.reason or check.text == text
        assert {word for _, word in check.laws.values()} == {"FAIL"}
        assert check.spread["width"] == (math.inf, math.inf)
        assert check.spread_events["width", 0] == f"{event} (M11)"
        assert check.sensitivities == {}
        assert math.isfinite(check.value) == (statistic in ("median", "p84"))


def test_a_mean_of_a_value_without_derivatives_has_none(tmp_path, monkeypatch):
    """The derivatives of the other values would not add up to that of the mean."""
    values = named(0.2, 0.3)
    assert computed(values, tmp_path, "mean").sensitivities
    check = computed(values, tmp_path, "mean")
    kind = type(check.kind)
    slopes = kind.slopes_function
    monkeypatch.setattr(
        kind, "slopes_function", lambda self, entry, scenes, k: slopes(self, entry, scenes, k) if k else None
    )
    assert _sensitivities(check, None) == {}


def test_an_overturned_motion_fails_a_set_with_an_unfinished_scene(tmp_path):
    values = named(
        0.1, math.nan, math.inf, texts=("", "", "overturned at 5.85 s"), states=("", "", "overturned")
    )
    values = values._replace(unanswered=("", "out_of_steps", ""))
    assert {computed(values, tmp_path, y).result for y in ("max", "mean", "median", "p84")} == {"FAIL"}


def test_values_without_a_utilisation_have_no_derivatives(tmp_path, monkeypatch):
    """For a value below 0 that must exceed a limit above 0, the derivative of ln|value| is not that of U."""
    check = computed(named(-1.365, 2.0), tmp_path, "max", "least-axial-force", 0.1)
    assert (check.result, check.utilisation, check.sensitivities) == ("FAIL", math.inf, {})
    monkeypatch.setattr(summary, "instant_of_check", lambda *_: None)
    row = summary._row(check, SimpleNamespace(problem=SimpleNamespace(motions={"pulses": (1, 2)})))
    assert row.sensitivities == "no finite value"


def test_a_value_with_a_larger_error_decides():
    """The largest value passes, but another one may exceed the limit; a failure of one value is certain."""
    values = values_of(0.495, 0.494, errors=np.array([1e-11, 9e-4]))
    found = statistic_of(values, "max", False)
    assert found.bounds[1] == pytest.approx(0.494 + 9e-3)
    assert found.governing == 0
    assert found.error == 1e-11
    low, high = found.bounds
    assert decide(utilisations_of(low, found.value, high, 0.5, False), False, False) == "UNDECIDED"
    certain = statistic_of(values_of(0.51, 0.40, errors=np.array([1e-11, 0.02])), "max", False)
    low, high = certain.bounds
    assert decide(utilisations_of(low, certain.value, high, 0.5, False), False, False) == "FAIL"
    least = statistic_of(values_of(0.505, 0.506, errors=np.array([1e-11, 9e-4])), "max", True)
    low, high = least.bounds
    assert decide(utilisations_of(low, least.value, high, 0.5, True), False, False) == "UNDECIDED"


def test_an_unbounded_error_is_undecided():
    """The error is infinite if a joint opens in only one of the two solutions of a scene."""
    assert result(0.1, 0.5, error=math.inf) == "UNDECIDED"
    assert result(0.1, 0.5, error=math.nan) == "PASS"
    assert math.isnan(statistic_of(values_of(0.1, errors=np.array([math.nan])), "max", False).error)


def test_the_worst_joint_has_the_error_of_other_joints():
    values, errors, joints = worst_of(np.array([[0.49, 0.495]]), np.array([[2e-3, 1e-9]]), False)
    assert (values[0], joints[0]) == (0.495, 1)
    assert values[0] + SAFETY * errors[0] == pytest.approx(0.51)
    values, errors, joints = worst_of(np.array([[math.nan, 0.5, 0.51]]), np.array([[0.0, 0.0, 2e-3]]), True)
    assert (values[0], joints[0]) == (0.5, 1)
    assert values[0] - SAFETY * errors[0] == pytest.approx(0.49)


@pytest.mark.parametrize(
    ("statistic", "slope", "governs"),
    [
        ("max", 4.0, "M4"),
        ("mean", (0.2 * 1 + 0.1 * 2 + 0.3 * 3 + 0.4 * 4) / 1.0, "all (mean)"),
        ("median", (0.2 * 1 + 0.3 * 3) / 0.5, "M1 and M3"),
        ("p84", (0.48 * 0.3 * 3 + 0.52 * 0.4 * 4) / (0.48 * 0.3 + 0.52 * 0.4), "M3 and M4"),
    ],
)
def test_derivatives_are_those_of_the_statistic(tmp_path, statistic, slope, governs):
    check = computed(named(0.2, 0.1, 0.3, 0.4), tmp_path, statistic)
    assert check.sensitivities["width"] == pytest.approx(slope)
    assert summary._governs(check) == governs


def test_scenes_without_an_answer():
    """A value of NaN is no failure; a failure in another scene is."""
    blank = ("",) * 2
    for minimum, limit, fails, passes in ((False, 0.5, 0.6, 0.4), (True, 0.5, 0.4, 0.6)):
        for other, expected in ((math.nan, "UNDECIDED"), (passes, "UNDECIDED"), (fails, "FAIL")):
            values = Values(np.array([math.nan, other]), np.zeros(2), blank, blank, ("weightless", ""), ())
            found = statistic_of(values, "max", minimum)
            low, high = found.bounds
            utilisations = utilisations_of(low, found.value, high, limit, minimum)
            assert decide(utilisations, True, False) == expected
            assert found.governing == (0 if math.isnan(other) else 1)
    for statistic in ("mean", "median", "p84"):
        assert math.isnan(statistic_of(values_of(0.3, math.nan), statistic, False).value)


def test_verdict():
    words = ["PASS"] * 2 + ["FAIL"] * 5 + ["NOT VALID"] * 5 + ["NOT MADE"] * 2
    assert verdict(words) == "Not verified: of 14 checks 2 pass, 5 fail, 5 are not valid, 2 were not made."
    assert verdict(["PASS"] * 14) == "Verified: all 14 checks pass."
    assert verdict(["PASS", "BY OTHERS"]) == "Verified: the only check passes. 1 more is made by others."
    assert verdict(["BY OTHERS"]) == "Not verified: every check is made by others."
    for results, is_verified in ((["BY OTHERS"], False), (["PASS", "BY OTHERS"], True), (["FAIL"], False)):
        checks = tuple(Check(None, None, result) for result in results)
        assert Evaluation(None, None, checks, {}, (), dict).is_verified == is_verified
    assert verdict(["UNDECIDED"]) == "Not verified: of one check 0 pass, 1 is undecided."


def test_every_output_with_a_peak_has_a_kind_of_check():
    """Kinds are generated from the list of outputs, so every new output is available as a check."""
    from rockjax._outputs.registry import VARIABLES

    peaks = {name.replace("_", "-") for name, (y, _) in VARIABLES.items() if y.until_overturning}
    assert peaks <= KINDS.keys()
    assert all(KINDS[name].is_minimum == name.startswith("least") for name in peaks)


@pytest.mark.parametrize(
    ("check", "message"),
    [
        ('kind = "peak-rotatoin"\nlimit = 1.0', "did you mean peak-rotation"),
        ('kind = "peak-rotation"', r"exactly one of limit and at_most, got neither"),
        (
            'kind = "peak-rotation"\nlimit = 1.0\nat_most = 1.0',
            "exactly one of limit and at_most, got limit and at_most",
        ),
        ('kind = "peak-rotation"\nat_least = 1.0', "limit or at_most, got at_least"),
        ('kind = "peak-rotation"\nlimit = -1.0', "must be > 0"),
        ('kind = "displacement"\nlimit = 1.0\nunit = "kN"', r"is a displacement, got 'kN'; use"),
        ('kind = "peak-rotation"\nlimit = 1.0\nmotions = "design"', r"the sets are pulses"),
        ('kind = "peak-rotation"\nlimit = 1.0\nstatistic = "most"', "statistic"),
        ('kind = "peak-friction"\nlimit = "joints.frictoin"', "must be a number or a key of this file"),
        ('kind = "no-overturning"\nlimit = 1.0', "no-overturning has no limit"),
        ("limit = 1.0", "kind is missing"),
        ('kind = "peak-rotation"\nlimit = 1.0\nid = " "', r"checks\[0\].id: must be a text other than"),
        ('kind = "peak-rotation"\nlimit = 1.0\nclause = "nan"', r"checks\[0\].clause: must be a text"),
        ('kind = "by-others"\ntext = "–"', r"checks\[0\].text: must be a text"),
    ],
)
def test_wrong_checks(tmp_path, check, message):
    with pytest.raises(ValueError, match=message):
        problem(tmp_path, f"[[checks]]\n{check}\n")


def test_wrong_files(tmp_path):
    with pytest.raises(ValueError, match=r"needs \[\[checks\]\] or \[\[targets\]\]"):
        problem(tmp_path, "")
    with pytest.raises(ValueError, match="is the id of another check"):
        problem(tmp_path, (CHECK + 'id = "A"\n') * 2)
    with pytest.raises(ValueError, match="'a' is the id of another check"):
        problem(tmp_path, CHECK + 'id = "A"\n' + CHECK + 'id = "a"\n')
    with pytest.raises(ValueError, match=r"motions.Pulses: is the name of another set"):
        problem(tmp_path, CHECK, FILE + FILE[FILE.index("[motions") :].replace("pulses", "Pulses"))
    with pytest.raises(ValueError, match=r"motions.nan: must be a text .*, got 'nan'"):
        problem(tmp_path, CHECK, FILE.replace("motions.pulses", "motions.nan"))
    with pytest.raises(ValueError, match="is not a key of this file"):
        problem(tmp_path, CHECK, '[sources]\n"structure.widht" = "drawing"\n' + FILE)
    with pytest.raises(ValueError, match=r"sources.structure: must be a text .*needs quotes"):
        problem(tmp_path, CHECK, '[sources]\nstructure.width = "drawing"\n' + FILE)
    with pytest.raises(ValueError, match=r"report.units: 'kn' is not a known unit; did you mean 'kN'"):
        problem(tmp_path, CHECK, '[report]\nunits = ["kn"]\n' + FILE)
    with pytest.raises(ValueError, match=r"joints.contact_width: must be at most the width .*, 0.6 m, got 1"):
        problem(tmp_path, CHECK, FILE.replace("[joints]", "[joints]\ncontact_width = 1.0"))


def test_unfinished_scenes_of_a_search_for_uplift_are_undecided(tmp_path, monkeypatch):
    def fail(*_):
        raise UnfinishedScenesError("1 of 2 scenes did not finish")

    monkeypatch.setattr("rockjax._report.kinds.searches.least_factors", fail)
    found = problem(tmp_path, CHECK.replace("peak-rotation", "uplift-scale"))
    check = _evaluate(found.checks[0], SimpleNamespace(problem=found), ())
    assert (check.result, check.reason) == ("UNDECIDED", "1 of 2 scenes did not finish")
    assert summary._row(check, SimpleNamespace(problem=found)).value.state == "unanswered"


def test_values_by_key_units_and_targets(tmp_path):
    """A limit may be a key of the file, or have a unit; design targets are checks as well."""
    found = problem(
        tmp_path,
        '[[checks]]\nkind = "peak-friction"\nlimit = "joints.friction"\n'
        '[[checks]]\nkind = "displacement"\nlimit = 60\nunit = "mm"\nid = "U"\n'
        '[[targets]]\nkind = "overturning-scale"\nat_least = 1.5\nmotions = "pulses"\n',
    )
    assert [entry.id for entry in found.checks] == ["C1", "U", "T1"]
    assert [entry.limit for entry in found.checks] == [0.5, pytest.approx(0.06), 1.5]
    assert [entry.is_target for entry in found.checks] == [False, False, True]
    assert found.motions["pulses"].names == ("Ricker(2.5, 1)", "Ricker(3, 1)")


def test_changed_inputs(tmp_path):
    """Inputs change by factors, lists by a common one, and derivatives pass through them."""
    found = problem(tmp_path)
    assert found.variables == ("width", "height", "column_mass", "beam_mass", "e")
    reduced = found.varied({"e": 0.9, "width": 1.05})
    assert float(reduced.restitution_factor) == pytest.approx(
        0.9 * float(found.varied({"width": 1.05}).restitution_factor)
    )
    given = problem(tmp_path, file=FILE.replace("beam_mass", "restitution = 0.8\nbeam_mass"))
    assert given.variables == ("width", "height", "column_mass", "beam_mass", "restitution")
    wider = found.varied({"width": 1.05})
    assert float(wider.width) == pytest.approx(0.63)
    assert float(found.varied({"column_mass": 2.0}).gamma) == pytest.approx(float(found.podium.gamma) / 2)


def test_scenes_without_an_answer_have_no_history_and_no_derivatives(tmp_path):
    """Scenes in which the weight vanishes cannot be solved again for these."""
    (entry,) = problem(tmp_path, CHECK + 'statistic = "mean"\n').checks
    values = values_of(0.3, 0.0)._replace(unanswered=("", "weightless"))
    check = Check(entry, KINDS["peak-rotation"], "UNDECIDED", value=0.15, utilisation=0.3, values=values)
    assert _sensitivities(dataclasses.replace(check, weights=(0.5, 0.5)), None) == {}
    names = ["weightless", "end_of_time", "overturned", "out_of_steps"]
    data = {"result": [NAMES.index(name) for name in names], "peak_rotation": [0.0, 0.0, 0.5, np.nan]}
    data["overturned"] = [name == "overturned" for name in names]
    for count, expected in ((4, ("pulses", 1)), (1, None)):
        peaks = xarray.Dataset({name: ("motion", y[:count]) for name, y in data.items()})
        scenes = SimpleNamespace(peaks=lambda name, peaks=peaks: peaks)
        assert governing_scene(scenes, ["pulses"]) == expected


def test_the_hash_of_a_file_with_a_byte_order_mark(tmp_path):
    """The hash is that of the bytes, so that `sha256sum` gives the same."""
    path = tmp_path / "problem.toml"
    path.write_text(FILE + CHECK, encoding="utf-8-sig")
    assert rj.read_problem(path).sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_changes_that_the_solver_refuses_are_left_out(tmp_path):
    """The overturn ratio must be at most π/(2α); 5 % more of the width raises α."""
    ratio = np.pi / 2 / np.arctan(0.2) * 0.99
    found = problem(tmp_path, CHECK + f"[options]\noverturn_ratio = {ratio}\n")
    variations = Scenes(found, Store(), {}).variations
    assert {"width-", "height+", "motion+", "motion-"} <= set(variations)
    assert not {"width+", "height-"} & set(variations)


@pytest.mark.parametrize(("limit", "expected"), [(0.09, "UNDECIDED"), (0.17, "UNDECIDED"), (0.18, "PASS")])
def test_the_interval_of_a_probability_is_lognormal(tmp_path, monkeypatch, limit, expected):
    """For p = 0.1 with the standard error 0.03, the 95 % interval ends at 0.1 exp(1.96 √ln 1.09) = 0.178."""
    spread = math.exp(1.96 * math.sqrt(math.log(1.09)))
    numbers = {"probability": 0.1, "standard_error": 0.03, "converged": 1.0}
    data = xarray.Dataset(numbers | {"interval": ("bound", [0.1 / spread, 0.1 * spread])})
    monkeypatch.setattr(FailureKind, "_data", lambda *_: data)
    values = KINDS["failure-probability"].values(None, None)
    found = statistic_of(values, "max", False)
    low, high = found.bounds
    utilisations = utilisations_of(low, found.value, high, limit, False)
    assert decide(utilisations, False, False) == expected


def peaks_with_outcomes(overturned, undecided):
    data = {"overturned": overturned, "undecided": undecided, "overturn_time": [2.0] * len(overturned)}
    data["result"] = [NAMES.index("overturned" if y else "end_of_time") for y in overturned]
    data |= {"peak_rotation": [0.1] * len(overturned), "peak_rotation_time": [1.0] * len(overturned)}
    return xarray.Dataset({name: ("motion", y) for name, y in data.items()})


@pytest.mark.parametrize(
    ("kind", "overturned", "undecided", "expected"),
    [
        ("peak-rotation", [True, False], [True, False], "UNDECIDED"),
        ("peak-rotation", [True, True], [True, False], "FAIL"),
        ("no-overturning", [True, False], [True, False], "UNDECIDED"),
        ("no-overturning", [True, False], [False, False], "FAIL"),
        ("overturning-probability", [True, False, False], [True, False, False], "UNDECIDED"),
        ("overturning-probability", [True, True, True], [True, False, False], "FAIL"),
        ("overturning-probability", [True, True, False], [False, False, True], "FAIL"),
        ("overturning-probability", [False, False, False], [False, False, False], "PASS"),
    ],
)
def test_undecided_overturning_is_no_failure(tmp_path, monkeypatch, kind, overturned, undecided, expected):
    """The columns overturn in one solution and survive in the other."""
    limit = "" if kind == "no-overturning" else "limit = 0.5\n"
    found = problem(tmp_path, f'[[checks]]\nkind = "{kind}"\n{limit}')
    (entry,), data = found.checks, peaks_with_outcomes(overturned, undecided)
    monkeypatch.setattr(Scenes, "_peaks", lambda *_: data)
    values = KINDS[kind].values(entry, Scenes(found, Store(), {}))
    found = statistic_of(values, "max", False)
    low, high = found.bounds
    utilisations = utilisations_of(low, found.value, high, entry.limit, False)
    assert decide(utilisations, any(values.unanswered), False) == expected


def test_names_of_motions_that_look_like_missing_values(tmp_path):
    """The table of motions could not show them."""
    samples = "\n".join(map(str, 4 * np.sin(np.linspace(0, 8 * np.pi, 400)) * np.hanning(400)))
    for name, expected in (("-", "motion 1"), ("null", "motion 1"), ("noise", "noise")):
        (tmp_path / f"{name}.txt").write_text(samples)
        files = f'[motions.files]\nfile = "{name}.txt"\nunits = "m/s2"\ndt = 0.01\n'
        found = problem(tmp_path, CHECK.replace("pulses", "files"), FILE + files)
        assert found.motions["files"].names == (expected,)


ROUND = FILE.replace("height = 3.0", "height = 3.0\nend_radius = 0.75").replace("2700.0", "2160.0")


def test_columns_with_round_ends(tmp_path):
    """The density and the note belong to the columns in the file, not to the twice as large columns of the
    model, whose density would be 250 kg/m³."""
    flat, round_ends = problem(tmp_path), problem(tmp_path, CHECK, ROUND)
    assert (flat.column_enlargement, structure._round_ends(flat)) == (1.0, [])
    assert round_ends.column_size == (0.6, 3.0)
    assert round_ends.column_enlargement == pytest.approx(float(round_ends.podium.height) / 3.0)
    (note,) = structure._round_ends(round_ends)
    assert "2 times as large" in note.text
    evaluation = SimpleNamespace(problem=round_ends, checks=())
    assert not any("kg/m³" in plain(text, Units()) for text in warnings_of(evaluation))


def test_positions_of_columns_are_no_number_of_columns(tmp_path):
    ratios = "[structure]\nalpha = 0.2\nR = 1.5\ngamma = 5.0\n[structure.elevation]\ncolumns = [-2.5, 2.5]\n"
    found = problem(tmp_path, CHECK, ratios + FILE[FILE.index("[joints]") :])
    (entry,) = (y for y in found.inputs if y.key == "elevation.columns")
    meaning, _, value, _ = structure._row(entry)
    assert (meaning.text, value.kind, value.values) == ("Positions of the columns x", "length", (-2.5, 2.5))
