"""Kinds of checks other than peaks: values agree with the functions of the package; targets are checks."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
import xarray

import optimise
import rockjax as rj
from optimise._problem import TARGETS
from rockjax._boundaries.crossings import Crossings
from rockjax._report import scales
from rockjax._report.assemble import page_of
from rockjax._report.blocks import Figure
from rockjax._report.entry import Entry
from rockjax._report.evaluate import decide, evaluate, needs_of_sets, utilisations_of
from rockjax._report.evaluation import Check
from rockjax._report.kinds import KINDS, check_model, peaks, risk, searches
from rockjax._report.kinds.base import statistic_of
from rockjax._report.kinds.searches import UNFINISHED, searched_values
from rockjax._report.scales import boundary_options, least_factors
from rockjax._report.scenes import Needs, Scenes, with_given_restitution
from rockjax._report.sections import summary
from rockjax._report.store import Store
from rockjax._report.tables import plain
from rockjax._report.units import Units
from rockjax._results import NAMES
from rockjax._risk.gaussian import Envelope

FILE = """
[structure]
width = 0.6
height = 3.0
column_mass = 2700.0
beam_mass = 60e3
[motions.pulses]
kind = "ricker"
a_p = [2.5, 3.5]
T_p = 1.0
[report]
laws = []
"""
SCALE = '[[targets]]\nkind = "overturning-scale"\nlimit = 1.5\n'
SHARE = '[[targets]]\nkind = "overturning-probability"\nat_most = 0.6\nintensity = 4.0\n'
FAILURE = """
[[checks]]
kind = "failure-probability"
at_most = 0.2
cov = 0.3
motion = { n = 61, dt = 0.06, S_0 = 0.2, envelope = { t_1 = 1.0, t_2 = 2.0, c = 1.0 } }
"""
PULSES = """
[[targets]]
kind = "overturning-acceleration"
at_least = 0.1
unit = "g"
pulse = "one-sine"
T_p = [1.0, 1.2]
"""
FLOORS = """
[[contents]]
name = "cabinet"
width = 0.4
height = 1.8
[[contents]]
name = "shelf"
width = 0.2
height = 2.0
[[oscillators]]
name = "cabinet"
period = 0.3
[[checks]]
kind = "contents-rotation"
limit = 0.9
[[targets]]
kind = "floor-spectrum"
limit = 1.5
unit = "g"
"""


def read(folder, checks, file=FILE):
    path = folder / "problem.toml"
    path.write_text(file + checks, encoding="utf-8")
    return rj.read_problem(path)


def texts_of(values):
    return [plain(text, Units.si(9.80665)) for text in values.texts]


def result_of_minimum(values, limit):
    found = statistic_of(values, "max", True)
    low, high = found.bounds
    utilisations = utilisations_of(low, found.value, high, limit, True)
    return decide(utilisations, any(values.unanswered), False)


def test_every_target_is_a_kind_of_check():
    assert TARGETS.keys() <= KINDS.keys()
    assert set(check_model("peak-rotation").model_fields) < set(check_model("annual-frequency").model_fields)


def test_a_design_reads_the_keys_of_checks(tmp_path):
    """Units, keys of the file, `limit` for `at_least`, ids and clauses lead to the same limits in designs and
    reports."""
    more = (
        "[joints]\nfriction = 0.5\n[vary]\nwidth = [0.4, 1.0]\n[minimise]\nquantity = 'width'\n"
        '[[targets]]\nkind = "overturning-scale"\nlimit = 1.5\nid = "S"\nclause = "4.2"\nname = "Scale"\n'
        '[[targets]]\nkind = "peak-friction"\nlimit = "joints.friction"\n'
    )
    found = read(tmp_path, SHARE + PULSES + more)
    problem = optimise.load(tmp_path / "problem.toml")
    assert [entry.id for entry in found.checks] == ["T1", "T2", "S", "T4"]
    assert [entry.limit for entry in found.checks] == [0.6, pytest.approx(0.980665), 1.5, 0.5]
    share, pulses, scale, friction = problem.targets
    assert (share.at_most, pulses.at_least, scale.at_least) == (0.6, pytest.approx(0.980665), 1.5)
    assert (scale.name, friction.given_limit) == ("Scale", 0.5)
    for given, words in (
        ('kind = "uplift-scale"\nlimit = 0.5\n', "can only be a check of a report"),
        ('kind = "peak-rotation"\nlimit = 0.5\nstatistic = "mean"\n', "statistic: must be max"),
        ('kind = "peak-rotation"\nlimit = 0.5\nvertical = true\n', "no vertical component"),
    ):
        read(tmp_path, f"[vary]\nwidth = [0.4, 1.0]\n[[targets]]\n{given}")
        with pytest.raises(ValueError, match=words):
            optimise.load(tmp_path / "problem.toml")


@pytest.mark.slow
def test_columns_so_stocky_that_no_factor_of_restitution_is_positive(tmp_path):
    """Rocking ends at the first impact. Checks under other laws and with changed inputs are made, and the
    laws of impact agree."""
    structure = FILE.index("[structure]"), FILE.index("[motions")
    ratios = "[structure]\ntan_alpha = 1.2\nR = 2.0\ngamma = 5.0\n"
    file = FILE.replace(FILE[slice(*structure)], ratios).replace("laws = []", 'laws = ["compatible"]')
    check = '[[checks]]\nkind = "peak-rotation"\nlimit = 0.5\n'
    problem = read(tmp_path, check, file.replace("[2.5, 3.5]", "[12.0, 14.0]"))
    assert problem.podium.restitution_factor < 0
    (found,) = evaluate(problem, skip=("methods",)).checks
    assert found.result == "PASS"
    assert found.value > 0
    assert found.laws["compatible"][0] == found.utilisation
    low, high = found.spread["motion"]
    assert low < found.utilisation < high


def test_a_change_without_a_valid_structure_is_left_out(tmp_path):
    check = '[[checks]]\nkind = "peak-rotation"\nlimit = 0.9\n'
    file = FILE.replace("height = 3.0", "height = 3.0\nrestitution = 0.98")
    report = rj.report(read(tmp_path, check, file), skip=("methods",))
    low, high = report.evaluation.checks[0].spread["restitution"]
    assert low > 0
    assert np.isnan(high)
    row = next(row for row in report.tables["influences-c1"].rows if row[0].text == "restitution")
    assert (row[2].value, row[3].text) == (low, "no value")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.* scenes did not finish:RuntimeWarning")
def test_scenes_that_end_after_too_few_steps_are_undecided(tmp_path):
    """The check is UNDECIDED, the page names the cause, and the scenes have no numbers."""
    check = '[options]\nmax_steps = 5\n[[checks]]\nkind = "peak-rotation"\nlimit = 0.9\n'
    report = rj.report(read(tmp_path, check), skip=("spread", "methods"))
    (found,) = report.evaluation.checks
    assert (found.result, found.sensitivities) == ("UNDECIDED", {})
    text = [plain(found.reason, Units.si()), report.evaluation.verdict]
    assert text == [
        "2 of 2 scenes have no decided answer: out_of_steps",
        "Not verified: of one check 0 pass, 1 is undecided.",
    ]
    rows = report.tables["rotation-pulses"].rows
    assert all({cell.text for cell in row[1:-1]} == {"out of steps"} for row in rows)
    assert not re.search(r"\b(nan|inf)\b", report.html)


def test_share_of_motions_that_overturn(tmp_path):
    """One of two motions overturns; the count agrees with that of the design target."""
    problem = read(tmp_path, SHARE)
    (check,) = evaluate(problem, skip=("spread",)).checks
    target = optimise.OverturningProbability(0.6, problem.motions["pulses"].excitations, 4.0)
    assert check.value == target.exact(problem.podium)
    assert check.is_target
    assert check.utilisation == check.value / 0.6
    assert check.result == ("PASS" if check.value <= 0.6 else "FAIL")


@pytest.mark.parametrize(
    ("check", "reason"),
    [
        ('kind = "median-capacity"\nlimit = 0.5', r"no table \[fragility\]"),
        ('kind = "peak-rotation"\nlimit = "joints.friction"', "no joints.friction, which is the limit"),
        ('kind = "contents-rotation"\nlimit = 0.5', r"no \[\[contents\]\]"),
        ('kind = "floor-spectrum"\nlimit = 0.5', r"no \[\[oscillators\]\]"),
        ('kind = "failure-probability"\nlimit = 0.1', "give its key motion"),
        ('kind = "annual-frequency"\nlimit = 0.1', "give risk.hazard"),
    ],
)
def test_a_check_without_its_input_is_not_made(tmp_path, check, reason):
    (found,) = evaluate(read(tmp_path, f"[[checks]]\n{check}\n")).checks
    assert found.result == "NOT MADE"
    assert re.search(reason, found.reason)


@pytest.mark.parametrize(
    ("check", "message"),
    [
        (PULSES + "frequency_ratio = 2.0\n", r"targets\[0\]: needs T_p or frequency_ratio, not both"),
        (PULSES + 'motions = "pulses"\n', "belongs to no set of motions"),
        (PULSES + 'statistic = "mean"\n', "statistic must be left out"),
        (SHARE + 'statistic = "mean"\n', "statistic must be left out"),
        (FLOORS + 'oscillators = ["pump"]\n', "oscillators must each be one of cabinet, got 'pump'"),
        (FLOORS.replace("period = 0.3", "period = 0.3\nlevel = 2"), "oscillators"),
        (SCALE + 'unit = "mm"\n', r"targets\[0\]\.unit: overturning-scale is a number, got 'mm'; use '–'"),
        (FAILURE.replace("n = 61", "n = 1"), r"checks\[0\]\.motion\.n: must be"),
    ],
)
def test_wrong_keys(tmp_path, check, message):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, check)


RISK = """
[[checks]]
kind = "annual-frequency"
at_most = 1e-3
[risk]
hazard = "hazard.csv"
"""


def test_the_curve_of_risk(tmp_path):
    """A median and a dispersion need no scenes and no motions; one of them alone is an error."""
    (tmp_path / "hazard.csv").write_text("PGA [m/s2],rate [1/year]\n1.0,0.02\n3.0,0.002\n10.0,0.00005\n")
    report = rj.report(read(tmp_path, RISK + "median = 5.0\ndispersion = 0.4\n"), skip=("methods",))
    (check,) = report.evaluation.checks
    hazard = rj.Hazard.from_file(tmp_path / "hazard.csv")
    reference = rj.annual_frequency(rj.Lognormal(np.array(5.0), np.array(0.4)), hazard)
    assert check.value == float(reference.frequency)
    assert check.motions is None
    assert "curve of [risk]" in check.reason
    with_set = RISK.replace("1e-3", '1e-3\nmotions = "pulses"')
    unused = read(tmp_path, with_set + "median = 5.0\ndispersion = 0.4\n")
    notices = KINDS["annual-frequency"].notices(unused.checks[0], report.evaluation.scenes)
    assert "C1 does not use its keys (motions" in next(notices)
    assert {"fragility-given", "annual-c1"} <= report.tables.keys()
    assert "Annual frequency of check C1" in [
        block.title for block in report.page.sections[6].blocks if isinstance(block, Figure)
    ]
    with pytest.raises(ValueError, match="needs both median and dispersion"):
        read(tmp_path, RISK + "median = 5.0\n")
    with pytest.raises(ValueError, match="`structure` applies only to a fragility model of OpenQuake"):
        read(tmp_path, RISK + 'median = 5.0\ndispersion = 0.4\nstructure = "A"\n')


def test_the_curve_of_another_structure_is_refused(tmp_path):
    from rockjax._problem.risk import check_structure
    from rockjax._responses.datasets import describe_podium

    problem = read(tmp_path, SHARE)

    class Curve:
        attrs = describe_podium(problem.podium)

    check_structure(Curve(), problem.podium, "curve.nc")
    with pytest.raises(ValueError, match=r"curve\.nc is for another structure: alpha_rad is"):
        check_structure(Curve(), problem.varied({"width": 1.01}), "curve.nc")


@pytest.mark.parametrize(
    ("table", "unit"),
    [("", "number"), ("[fragility]\n", "acceleration"), ('[fragility]\nmeasure = "PGV"', "velocity")],
)
def test_a_median_has_the_unit_of_its_measure(tmp_path, table, unit):
    """Without a table `[fragility]`, the median is a factor on the motions, in reports and in designs."""
    (entry,) = read(tmp_path, f'[[checks]]\nkind = "median-capacity"\nat_least = 1.5\n{table}').checks
    assert isinstance(entry, Entry)
    assert entry.quantity == unit


def test_a_design_takes_the_median_in_the_same_measure(tmp_path):
    """The motions have unit PGA, so factors are intensities."""
    file = FILE.replace('kind = "ricker"\na_p = [2.5, 3.5]\nT_p = 1.0', "synthetic = 2\nduration = 4.0")
    target = '[[targets]]\nkind = "median-capacity"\nat_least = 4.0\n'
    read(tmp_path, f"[vary]\nwidth = [0.4, 1.0]\n{target}[fragility]\n", file)
    (median,) = optimise.load(tmp_path / "problem.toml").targets
    peaks = [float(np.abs(median.suite.motion(k).acceleration).max()) for k in range(2)]
    scales = [float(median.suite.motion(k).scale) for k in range(2)]
    np.testing.assert_allclose(np.array(peaks) * scales, 1.0)


@pytest.mark.slow
def test_a_changed_sampling_interval_solves_the_scenes_again(tmp_path):
    """The samples, and so their hashes, stay the same."""
    np.savetxt(tmp_path / "noise.txt", 4 * np.sin(np.linspace(0, 8 * np.pi, 400)) * np.hanning(400))
    store, rotations = Store(), []
    for dt in (0.01, 0.02):
        motions = f'[motions.noise]\nfile = "noise.txt"\nunits = "m/s2"\ndt = {dt}\n'
        problem = read(tmp_path, "", FILE.split("[motions.pulses]")[0] + motions + SCALE)
        scenes = Scenes(problem, store, {"noise": Needs({"peak_rotation": None})})
        options = problem.options.replace(outputs=("peak_rotation",), throw=False)
        expected = rj.peak_responses(problem.podium, problem.motions["noise"].excitations, options=options)
        rotations.append(scenes.peaks("noise")["peak_rotation"].values)
        np.testing.assert_array_equal(rotations[-1], expected.peak_rotation)
    assert np.all(rotations[0] != rotations[1])


@pytest.mark.slow
def test_another_pulse_with_vertical_motion_solves_the_scenes_again(tmp_path):
    """The numbers of the pulses stay the same."""
    store, rotations = Store(), []
    for pulse in ("ricker", "one-sine"):
        file = FILE.replace('"ricker"', f'"{pulse}"\nvertical_ratio = 0.3')
        scenes = Scenes(read(tmp_path, SCALE, file), store, {})
        rotations.append(scenes.peaks("pulses")["peak_rotation"].values)
    assert np.all(rotations[0] != rotations[1])


def test_medians_have_intervals_in_place_of_errors(tmp_path, monkeypatch):
    """A median has an interval and no error. Tables of curves in different measures have different names."""
    names = ("median_capacity", "dispersion")
    curve = xarray.Dataset(
        {"median_capacity": 2.0, "dispersion": 0.3, "is_open": ("record", [False, False])}
        | {"interval": (("quantity", "bound"), [[1.5, 2.5], [0.2, 0.5]])}
        | {"at": ("at", [1.0], {"units": "1"})},
        coords={"quantity": list(names), "bound": ["lower", "upper"]},
        attrs={"measure": "PGA"},
    )
    found, kind = [], KINDS["median-capacity"]
    for measure in ("", '[fragility]\nmeasure = "Sa"\nmeasure_period = 0.7\n'):
        problem = read(tmp_path, f'[[checks]]\nkind = "median-capacity"\nat_least = 1.0\n{measure}')
        scenes = Scenes(problem, Store(), {})
        monkeypatch.setattr(scenes.store, "get", lambda *arguments: curve)
        found += [table.name for table in kind.tables(problem.checks[0], None, scenes)]
        values = kind.values(problem.checks[0], scenes)
    assert found == ["fragility-pulses-scale", "fragility-pulses-sa-0-7"]
    statistic = statistic_of(values, "max", True)
    assert np.isnan(statistic.error)
    check = Check(
        problem.checks[0], kind, "PASS", value=statistic.value, error=statistic.error, values=values
    )
    cell = summary._value(check, problem, None)
    assert cell.error is None
    assert [getattr(part, "value", part) for part in cell.note] == [0.9, " interval ", 1.5, " to ", 2.5]


@pytest.mark.slow
def test_searches_are_repeated_under_other_laws_of_impact(tmp_path):
    """The factors are boundaries under the other law. No law changes factors that lift the columns."""
    motions = "[motions.noise]\nsynthetic = 3\nseed = 1\nduration = 8.0\npga = 4.0\n"
    file = FILE.split("[motions.pulses]")[0].replace("beam_mass", "restitution = 0.7\nbeam_mass") + motions
    checks = SCALE + '[[checks]]\nkind = "uplift-scale"\nlimit = 0.1\n[report]\nlaws = ["paper"]\n'
    problem = read(tmp_path, checks, file)
    evaluation = evaluate(problem, skip=("spread", "methods"))
    scenes, (uplift, overturning) = evaluation.scenes, evaluation.checks
    assert uplift.laws["paper"] == (uplift.utilisation, uplift.result)
    factors = least_factors(scenes, "noise", "overturning", "paper")["factor"].values
    singly = [float(rj.overturning_scale(problem.podium, y)) for y in problem.motions["noise"].excitations]
    np.testing.assert_array_equal(overturning.values.values, singly)  # bit for bit
    assert overturning.laws["paper"][0] == 1.5 / factors.min()
    assert np.any(factors != overturning.values.values)
    podium = with_given_restitution(problem.podium.replace(restitution="paper"))
    options = boundary_options(problem).replace(throw=False)
    for side, expected in ((1 - 1e-6, False), (1 + 1e-6, True)):
        pairs = zip(problem.motions["noise"].excitations, side * factors, strict=True)
        answers = rj.peak_responses(podium, [y.scaled(f) for y, f in pairs], options=options)
        assert np.all(np.asarray(answers.overturned) == expected)


def test_blocks_and_oscillators_may_have_the_same_name(tmp_path):
    needed = needs_of_sets(read(tmp_path, FLOORS))["pulses"].on_floors
    assert [name for _, name in needed] == ["cabinet", "shelf", "cabinet"]


def test_motions_that_do_not_overturn_are_tested_at_the_end_of_the_search(tmp_path, monkeypatch):
    problem = read(tmp_path, '[[checks]]\nkind = "median-capacity"\nlimit = 1.0\n')
    curve = {"scale": ("record", [2.0, np.nan]), "largest_scale": ("record", [4.0, 5.0])}
    monkeypatch.setattr(Scenes, "peaks_with_factors", lambda scenes, label, name, factors: factors)
    (entry,) = problem.checks
    scenes = Scenes(problem, Store(), {})
    monkeypatch.setattr(scenes.store, "get", lambda *arguments: xarray.Dataset(curve))
    tested = KINDS["median-capacity"].tested_scenes(entry, scenes)
    assert tested == pytest.approx([2.0, 5.0], rel=1e-5)


def test_windows_of_overturning(tmp_path):
    """The check gives the least overturning factor, the end of its window and the start of the next one."""
    motions = "[motions.noise]\nsynthetic = 3\nseed = 1\nduration = 8.0\npga = 4.0\n"
    problem = read(tmp_path, "", FILE.split("[motions.pulses]")[0] + motions + SCALE)
    windows = least_factors(Scenes(problem, Store(), {}), "noise", "overturning")
    factors = np.array([windows[y] for y in ("factor", "survives_from", "overturns_again_from")])
    assert np.all(np.diff(factors, axis=0) > 0)
    excitations = problem.motions["noise"].excitations
    options = boundary_options(problem).replace(throw=False)
    scenes = [[y.scaled(f) for y, f in zip(excitations, row, strict=True)] for row in factors]
    for side, expected in ((-1e-6, [False, True, False]), (1e-6, [True, False, True])):
        for row, overturns in zip(scenes, expected, strict=True):
            answers = rj.peak_responses(problem.podium, [y.scaled(1 + side) for y in row], options=options)
            assert np.all(np.asarray(answers.overturned) == overturns)


@pytest.mark.slow
def test_pulses(tmp_path):
    problem = read(tmp_path, PULSES)
    evaluation = evaluate(problem)
    (check,) = evaluation.checks
    options = boundary_options(evaluation.problem)
    reference = [
        rj.overturning_acceleration(problem.podium, rj.OneSine, T, options=options) for T in (1.0, 1.2)
    ]
    np.testing.assert_array_equal(check.values.values, reference)
    assert check.result == "PASS"
    h = 1e-4
    sides = [
        rj.overturning_acceleration(problem.varied({"width": 1 + y}), rj.OneSine, 1.2, options=options)
        for y in (-h, h)
    ]
    slope = float(np.log(sides[1] / sides[0])) / (2 * h)
    assert check.governing == 1
    assert check.sensitivities["width"] == pytest.approx(-slope, rel=1e-6)


@pytest.mark.slow
def test_random_motions(tmp_path):
    problem = read(tmp_path, FAILURE)
    (check,) = evaluate(problem).checks
    motion = rj.GaussianMotion(61, 0.06, 0.2, envelope=Envelope(t_1=1.0, t_2=2.0, c=1.0))
    reference = rj.failure_probability(problem.podium, motion, cov=0.3)
    assert (check.value, check.error) == (reference.probability, reference.standard_error)
    assert check.result == ("FAIL" if reference.probability > 0.2 else "PASS")
    (skipped,) = evaluate(problem, skip=("risk",)).checks
    assert skipped.result == "NOT MADE"


@pytest.mark.slow
def test_blocks_and_oscillators_on_floors(tmp_path):
    """Values are bitwise those of a batch. One block overturns, so the check fails. Spectra are those of
    `rj.floor_spectrum`."""
    problem = read(tmp_path, FLOORS)
    report = rj.report(problem, skip=("spread", "methods"))
    contents, spectrum = report.evaluation.checks
    motions = problem.motions["pulses"].excitations
    systems = [
        rj.Contents.from_dimensions(0.4, 1.8),
        rj.Contents.from_dimensions(0.2, 2.0),
        rj.Oscillator(0.3),
    ]
    options = report.evaluation.scenes.options("pulses")
    peaks = rj.peak_responses(problem.podium, motions, options=options, on_floors=systems)
    np.testing.assert_array_equal(spectrum.values.values, peaks.on_floors[2].pseudo_acceleration)
    reference = [rj.floor_spectrum(problem.podium, y, [0.3])["pseudo_acceleration"].item() for y in motions]
    np.testing.assert_allclose(spectrum.values.values, reference, rtol=1e-6)
    assert spectrum.result == "PASS"
    assert contents.result == "FAIL"
    assert contents.text.startswith("shelf overturned at")
    assert {"contents-pulses", "oscillators-pulses"} <= report.tables.keys()
    h = 1e-4
    rows = [
        rj.peak_response(problem.podium, motions[1].scaled(1 + y), options=options, on_floors=systems[2:])
        for y in (-h, h)
    ]
    low, high = (float(row.on_floors[0].pseudo_acceleration) for row in rows)
    assert spectrum.sensitivities["motion"] == pytest.approx(np.log(high / low) / (2 * h), abs=1e-4)


JOINTS = """
[joints]
friction = 0.5
[[checks]]
kind = "least-axial-force"
at_least = 0.1
[[checks]]
kind = "peak-friction"
limit = "joints.friction"
"""


def test_joint_forces_without_positions(tmp_path):
    """The checks are not made, nothing is solved, and the page names the missing key."""
    report = rj.report(read(tmp_path, JOINTS), skip=("spread", "methods"))
    assert [(check.result, check.reason) for check in report.evaluation.checks] == [
        (
            "NOT MADE",
            "The file has no structure.positions, which the forces in the joints of each column need.",
        )
    ] * 2
    assert not any(name.startswith("peaks.") for name in report.evaluation.scenes.store.used)
    (notice,) = [y for y in page_of(report.evaluation).notices if "positions" in str(y)]
    assert notice.endswith("joint forces, A1 and A7.")


OF_JOINTS = [name for name, kind in KINDS.items() if kind.is_of_joints]


@pytest.mark.parametrize("kind", OF_JOINTS)
def test_checks_of_joint_forces_name_each_missing_key(tmp_path, kind):
    """Positions of columns are missing unless all columns have the same forces. Contact pressures also need
    the contact area."""
    given = {"structure.positions": "beam_depth = 0.5\npositions = [-2.0, 2.0]\n"}
    if kind == "contact-pressure":
        given |= {
            "joints.contact_width": "contact_width = 0.1\n",
            "joints.contact_depth": "contact_depth = 0.6\n",
        }
    bound = "at_least" if KINDS[kind].is_minimum else "at_most"
    check = f'[[checks]]\nkind = "{kind}"\n{bound} = 0.5\n'

    def reason(missing, **texts):
        joints = "".join(text for key, text in given.items() if key not in missing and "joints" in key)
        structure = "" if "structure.positions" in missing else given["structure.positions"]
        file = texts.get("file", FILE).replace(
            "[motions.pulses]", f"{structure}[joints]\n{joints}[motions.pulses]"
        )
        problem = read(tmp_path, check, file)
        return KINDS[kind].missing(problem.checks[0], problem)

    assert reason(()) == ""
    for key in given:
        assert key in reason((key,))
        assert not any(other in reason((key,)) for other in given if other != key)
    assert all(key in reason(tuple(given)) for key in given)
    for equal in ("columns = 1\nheight", "height"):
        file = FILE.replace("height", equal)
        file = file if "columns" in equal else file.replace("beam_mass = 60e3\n", "")
        assert reason(("structure.positions",), file=file) == ""


def test_the_shear_of_the_foundation_needs_no_positions(tmp_path):
    """It is a sum over all columns."""
    assert {"peak-friction", "least-axial-force", "contact-pressure", "least-impulse-share"} <= set(OF_JOINTS)
    problem = read(tmp_path, '[[checks]]\nkind = "peak-foundation-shear"\nlimit = 0.5\n')
    assert KINDS["peak-foundation-shear"].missing(problem.checks[0], problem) == ""


def test_a_frequency_without_a_curve_is_not_made(tmp_path):
    """The hazard is given, but neither a table [fragility] nor a curve in [risk]."""
    (tmp_path / "hazard.csv").write_text("PGA [m/s2],rate [1/year]\n1.0,0.02\n3.0,0.002\n")
    for more, reason in (
        ("", "no table [fragility], no risk.fragility, and no risk.median and risk.dispersion"),
        ("[fragility]\n", ""),
    ):
        problem = read(tmp_path, RISK + more)
        assert reason in (found := KINDS["annual-frequency"].missing(problem.checks[0], problem))
        assert bool(found) == bool(reason)


def test_a_search_without_overturning_is_not_an_open_joint(tmp_path):
    """A check passes if no searched factor overturns the columns, unless its limit is a larger factor; the
    cell is not red."""
    file = FILE.replace("a_p = [2.5, 3.5]", "a_p = [0.01, 0.02]")
    problem = read(tmp_path, SCALE, file)
    report = rj.report(problem, skip=("spread", "methods"))
    (check,) = report.evaluation.checks
    assert (check.result, check.text, check.state) == ("PASS", "no overturning up to 10", "none")
    (row,) = page_of(report.evaluation).sections[0].blocks[0].rows
    assert (row.value.state, row.value.tone) == ("none", "plain")
    (check,) = evaluate(read(tmp_path, SCALE.replace("1.5", "15.0"), file), skip=("spread",)).checks
    assert check.result == "UNDECIDED"
    assert check.reason.endswith("have no decided answer: the limit is beyond the searched range")


@pytest.mark.parametrize(
    ("statistic", "limit"), [("max", 11.0), ("mean", 8.0), ("median", 8.0), ("p84", 4.0)]
)
def test_a_search_without_overturning_gives_a_lower_bound(tmp_path, statistic, limit):
    """A factor that was not found exceeds the searched ones, but may be close to them."""
    text = SCALE.replace("limit = 1.5", f'limit = {limit}\nstatistic = "{statistic}"')
    names = ("first", "second")
    for factors, is_decided in (((np.inf, np.inf), limit < 10), ((2.0, np.inf), False), ((2.0, 3.0), True)):
        (entry,) = read(tmp_path, text).checks
        values = searched_values(np.array(factors), np.zeros(2), 10.0, entry, texts=("", ""), names=names)
        value = statistic_of(values, statistic, True).value
        assert any(values.unanswered) == (not is_decided and value >= limit)


def faked_search(monkeypatch, factors, finished_to, margin):
    """Replace the scan and the scenes above its boundaries; `margin`: function of the factors."""
    found = np.flatnonzero(np.isfinite(factors))
    y = np.array(factors)[found] / scales.MAX_SCALE
    crossings = Crossings(found, y, found >= 0, found)
    scan = SimpleNamespace(crossings=crossings, finished_to=np.array(finished_to) / scales.MAX_SCALE)
    monkeypatch.setattr(scales, "scan", lambda *_, **__: scan)
    monkeypatch.setattr(scales, "margins", lambda _, x, y, options: (margin(y), np.zeros(y.size), None))


@pytest.mark.parametrize(
    ("factor", "finished_to", "limit", "result"),
    [
        (np.inf, 6.1, 1.5, "PASS"),
        (np.inf, 6.1, 7.0, "UNDECIDED"),
        (4.0, 0.99, 2.0, "UNDECIDED"),
        (4.0, 0.99, 5.0, "FAIL"),
        (4.0, 3.0, 2.0, "PASS"),
        (4.0, 10.0, 2.0, "PASS"),
    ],
)
def test_scenes_that_did_not_finish_end_the_search(tmp_path, monkeypatch, factor, finished_to, limit, result):
    """A lower factor may overturn the columns, so only the range below the first such scene is certain."""
    problem = read(tmp_path, SCALE.replace("1.5", str(limit)))
    faked_search(monkeypatch, [factor, np.inf], [finished_to, 10.0], lambda y: np.full(y.shape, -1.0))
    scenes, (entry,), tested = Scenes(problem, Store(), {}), problem.checks, []
    values = KINDS[entry.kind].values(entry, scenes)
    assert result_of_minimum(values, limit) == result
    assert texts_of(values) == [
        "" if np.isfinite(factor) else "no overturning up to 6.1",
        "no overturning up to 10",
    ]
    assert set(values.unanswered) <= {"", UNFINISHED, "the limit is beyond the searched range"}
    monkeypatch.setattr(Scenes, "peaks_with_factors", lambda *arguments: tested.append(arguments[-1]))
    KINDS[entry.kind].tested_scenes(entry, scenes)
    assert tested[0] == pytest.approx([min(factor, finished_to) if factor > 9 else factor, 10.0], rel=1e-5)


@pytest.mark.parametrize(
    ("unfinished", "expected"),
    [((3.0, 3.0), [2.5, 3.2, 4.0]), ((2.7, 3.5), [2.5, np.nan, 2.7]), ((2.1, 3.5), [np.nan, np.nan, 2.1])],
)
def test_windows_end_before_scenes_that_did_not_finish(tmp_path, monkeypatch, unfinished, expected):
    """The columns survive between the factors 2.5 and 3.2."""

    def margin(y):
        outcome = np.where((y >= 2.5) & (y < 3.2), 0.5, -0.5)
        return np.where((y >= unfinished[0]) & (y < unfinished[1]), np.nan, outcome)

    faked_search(monkeypatch, [2.0, np.inf], [10.0, 10.0], margin)
    windows = least_factors(Scenes(read(tmp_path, SCALE), Store(), {}), "pulses", "overturning")
    names = ("survives_from", "overturns_again_from", "window_end")
    found = np.array([windows[name] for name in names])
    assert found[:2, 0] == pytest.approx(expected[:2], rel=1e-9, nan_ok=True)
    assert expected[2] - 0.3 < found[2, 0] <= expected[2]
    assert np.all(np.isnan(found[:, 1]))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.* scenes did not finish:RuntimeWarning")
def test_motions_whose_vertical_component_carries_the_weight(tmp_path):
    """From the factor g/(0.8 · 2 m/s²) = 6.13, scenes do not finish."""
    motion = 'kind = "one-sine"\na_p = 2.0\nT_p = 0.05\nvertical_ratio = 0.8'
    file = FILE.replace('kind = "ricker"\na_p = [2.5, 3.5]\nT_p = 1.0', motion)
    (check,) = evaluate(read(tmp_path, SCALE, file), skip=("spread",)).checks
    assert check.result == "PASS"
    assert check.text.startswith("no overturning up to 6.1")


def test_amplitudes_of_pulses_below_which_scenes_did_not_finish(tmp_path, monkeypatch):
    for scale, end, limit, result in (
        (3.0, 1.0, 2.0, "UNDECIDED"),
        (3.0, 2.5, 2.0, "PASS"),
        (3.0, 1.0, 4.0, "FAIL"),
        (np.inf, 1.5, 2.0, "UNDECIDED"),
        (3.0, 20.0, 2.0, "PASS"),
    ):
        problem = read(tmp_path, PULSES.replace("0.1\nunit", f"{limit / 9.80665}\nunit"))
        boundary = SimpleNamespace(scale=scale, finished_to=end)
        monkeypatch.setattr(searches, "acceleration_boundary", lambda *_, y=boundary, **__: y)
        (entry,) = problem.checks
        values = KINDS[entry.kind].values(entry, Scenes(problem, Store(), {}))
        assert result_of_minimum(values, limit) == result
        threshold = 9.80665 * 0.2  # g tan α
        text = f"no overturning up to {end / threshold:.4g} g tan α"
        assert texts_of(values) == ["" if np.isfinite(scale) else text] * 2


def test_pulses_are_repeated_under_other_laws_of_impact(tmp_path, monkeypatch):
    """The amplitudes belong to the factor of restitution of each law."""
    problem = read(tmp_path, PULSES, FILE.replace("laws = []", 'laws = ["paper", "compatible"]'))
    found = lambda podium, *_, **__: SimpleNamespace(
        scale=2 * float(podium.restitution_factor), finished_to=9.0
    )
    monkeypatch.setattr(searches, "acceleration_boundary", found)
    (entry,), kind, scenes = problem.checks, KINDS["overturning-acceleration"], Scenes(problem, Store(), {})
    assert scenes.laws == ("compatible",)
    for law in (None, "paper", "compatible"):
        factor = float(problem.podium.replace(restitution=law or "paper").restitution_factor)
        assert kind.values(entry, scenes, law).values.tolist() == [2 * factor] * 2
    assert not kind.no_laws
    without = {name for name, kind in KINDS.items() if kind.no_laws}
    assert without == {"median-capacity", "annual-frequency", "failure-probability"}


def test_derivatives_of_capacities_by_the_keys_of_the_file(tmp_path, monkeypatch):
    """They stand beside those by the parameters in [fragility]. Motions without a capacity have none."""
    problem = read(tmp_path, SCALE)
    analysis = xarray.Dataset(
        {"capacity": ("record", [3.0, np.nan]), "measure": ("record", [1.5, 1.0])}
        | {"sensitivity": (("parameter", "record"), [[0.5, np.nan]])},
        coords={"parameter": ["gamma"], "record": ["a", "b"]},
    )
    monkeypatch.setattr(
        risk, "overturning_slopes", lambda problem, motion, factor, _: factor * np.arange(6.0)
    )
    found = risk._with_sensitivities(analysis, problem, problem.motions["pulses"])["sensitivity"]
    keys = [f"structure.{name}" for name in ("width", "height", "column_mass", "beam_mass")]
    assert found["parameter"].values.tolist() == ["gamma", *keys, "e"]
    np.testing.assert_array_equal(found.sel(record="a"), [0.5, 0.0, 1.0, 2.0, 3.0, 4.0])
    assert np.isnan(found.sel(record="b")).all()


def test_capacities_below_which_scenes_did_not_finish(tmp_path, monkeypatch):
    """The first motion is certain, the second has unfinished scenes below its capacity, the third above, and
    the fourth between the levels."""
    result = np.zeros((4, 3), int)
    result[1, 1] = result[2, 2] = NAMES.index("out_of_steps")
    analysis = xarray.Dataset(
        {
            "result": (("record", "intensity"), result),
            "capacity": ("record", [3.5, 3.5, 2.5, np.nan]),
            "certain_width": ("record", [4e-4, 4e-4, 4e-4, 1.0]),
            "measure": ("record", [1.0, 2.0, 1.0, 1.0]),
        },
        coords={"intensity": [1.0, 2.0, 4.0]},
    )
    drawn = ("peak_rotation", "overturned", "boundaries")
    analysis = analysis.assign(dict.fromkeys(drawn, analysis["result"]))
    fitted = xarray.Dataset({"median_capacity": 3.0}, attrs={"method_of_fit": "stripes"})
    assert risk._with_search(fitted, analysis)["is_open"].values.tolist() == [False, True, True, False]
    curve = risk._with_search(fitted.assign_attrs(method_of_fit="capacities"), analysis)
    assert curve["is_open"].values.tolist() == [False, True, False, True]
    np.testing.assert_array_equal(curve["scale"], [3.5, 1.75, 2.5, np.nan])
    np.testing.assert_array_equal(curve["largest_scale"], [4.0, 0.5, 2.0, 4.0])
    (entry,) = read(tmp_path, '[[checks]]\nkind = "median-capacity"\nat_least = 1.5\n').checks
    monkeypatch.setattr(risk.FragilityKind, "curve", lambda *_: curve)
    assert KINDS[entry.kind].values(entry, None).unanswered == ("", UNFINISHED, "", UNFINISHED)


def test_a_set_whose_checks_need_no_outputs(tmp_path):
    (check,) = evaluate(read(tmp_path, '[[checks]]\nkind = "no-overturning"\n'), skip=("spread",)).checks
    assert check.result == "PASS"


STORIES = """
[structure]
alpha = 0.2
R = 2.0
gamma = 8.0
[structure.superstructure]
masses = [4.0, 3.0]
stiffnesses = [3000.0, 2500.0]
heights = [3.0, 3.5]
"""
STORIES_BY_DIMENSIONS = """
[structure]
width = 0.6
height = 3.0
column_mass = 2700.0
story_masses = [3e4, 2e4]
story_stiffnesses = [3e7, 2e7]
story_heights = [3.0, 3.5]
"""


@pytest.mark.parametrize(
    ("structure", "key"),
    [(STORIES, "superstructure.heights"), (STORIES_BY_DIMENSIONS, "story_heights")],
)
def test_drift_ratios_change_with_the_heights(tmp_path, monkeypatch, structure, key):
    """Changed heights of stories change the drift ratios, but not the drifts."""
    file = structure + FILE[FILE.index("[motions") :]
    problem = read(tmp_path, '[[checks]]\nkind = "peak-drift-ratio"\nlimit = 0.01\n', file)
    drifts = np.array([[0.01, 0.02], [0.03, 0.01]])
    data = {"peak_drift": (("motion", "story"), drifts), "peak_drift_error": (("motion", "story"), drifts)}
    data |= {name: ("motion", np.zeros(2, int)) for name in ("overturned", "result")}
    monkeypatch.setattr(Scenes, "_peaks", lambda *arguments: xarray.Dataset(data))
    scenes, (entry,) = Scenes(problem, Store(), {}), problem.checks
    kind = KINDS[entry.kind]
    assert key in problem.variables
    expected = kind.values(entry, scenes).values / 1.05
    assert kind.values(entry, scenes, variation=f"{key}+").values == pytest.approx(expected)
    answers = {"peak_drift": (drifts[0], np.zeros((2, len(problem.variables) + 1)))}
    monkeypatch.setattr(peaks, "scene_answers", lambda *arguments: answers)
    value, slopes = kind.slopes_function(entry, scenes, 0)()
    expected = [-1.0 if name == key else 0.0 for name in (*problem.variables, "motion")]
    assert np.asarray(slopes) / value == pytest.approx(expected)


@pytest.mark.parametrize("kind", ["least-axial-force", "peak-axial-force"])
def test_derivatives_of_forces_of_a_column_that_carries_nothing(tmp_path, monkeypatch, kind):
    """The top joint has no dead load. The dead load of the bottom joint is the weight of the column."""
    file = FILE.replace("beam_mass = 60e3\n", "")
    problem = read(tmp_path, f'[[checks]]\nkind = "{kind}"\nlimit = 0.5\n', file)
    slopes = np.array([[0.1, -0.2, 0.0, 0.05, 0.3], [0.0] * 5])
    monkeypatch.setattr(
        peaks, "scene_answers", lambda *_: {kind.replace("-", "_"): (np.array([0.9, 0.0]), slopes)}
    )
    (entry,) = problem.checks
    value, found = KINDS[kind].slopes_function(entry, Scenes(problem, Store(), {}), 0)()
    assert float(value) == pytest.approx(0.9)
    assert np.asarray(found) == pytest.approx(slopes[0])


def test_a_motion_without_acceleration_lifts_nothing(tmp_path):
    problem = read(tmp_path, '[[checks]]\nkind = "uplift-scale"\nlimit = 1.0\n', FILE.replace("2.5", "0.0"))
    (check,) = evaluate(problem, skip=("spread",)).checks
    assert (check.result, check.reason) == (
        "NOT MADE",
        "ValueError: Ricker(0, 1) has no horizontal acceleration, so no factor on it lifts the columns",
    )
