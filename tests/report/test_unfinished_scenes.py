"""Scenes that overturn or do not finish, in made-up datasets: they do not govern, and their numbers are not
shown as those of other scenes."""

import math
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import rockjax as rj
from rockjax._report.assumptions import ASSUMPTIONS, Outcome
from rockjax._report.evaluate import _spread
from rockjax._report.evaluation import Check
from rockjax._report.kinds import KINDS
from rockjax._report.kinds.base import Values
from rockjax._report.scales import _estimate_uplift_factors
from rockjax._report.sections import accuracy, assumptions, building, joints, motions, rocking, summary
from rockjax._report.sections.common import drifts_of
from rockjax._report.tables import Quantity, plain
from rockjax._report.units import Units
from rockjax._results import NAMES, result_of

PODIUM = rj.Podium.from_dimensions(width=0.6, height=3.0, beam_mass=60e3, column_mass=2700.0)
MIXED = ("out_of_steps", "weightless", "overturned", "end_of_time", "settled")  # the fifth scene governs
WITHOUT_SURVIVORS = ("overturned", "out_of_steps", "not_finite")


def peaks_of(names):
    """Peaks that rise from one surviving scene to the next. Those of other scenes are larger or NaN."""
    codes, count = np.array([NAMES.index(name) for name in names]), len(names)
    peaks = np.where(codes > 2, [math.nan if k % 2 else 9.0 for k in range(count)], 1.0)
    peaks = np.where(codes < 2, 0.1 * (1 + np.arange(count)), peaks)
    data = dict.fromkeys(("peak_rotation", "peak_shear", "peak_foundation_shear"), ("motion", peaks))
    data |= {f"{name}_error": ("motion", np.full(count, 1e-9)) for name in tuple(data)}
    zeros = ("uplift_time", "peak_rotation_time", "impacts", "impacts_before_peak", "overturn_time", "steps")
    data |= {name: ("motion", np.zeros(count)) for name in zeros}
    data |= {"undecided": ("motion", codes > 2), "uplifted": ("motion", np.zeros(count, bool))}
    data |= {"result": ("motion", codes), "overturned": ("motion", codes == 2)}
    data["peak_drift"] = data["peak_floor_acceleration"] = ("motion", "story"), peaks[:, None]
    forces = np.stack([peaks - 0.05] * 2, axis=-1)
    data |= dict.fromkeys(("peak_friction", "least_axial_force"), (("motion", "joint"), forces))
    return xarray.Dataset(data)


def evaluation_of(names):
    data, motions = peaks_of(names), SimpleNamespace(names=tuple(f"M{k}" for k in range(len(names))))
    names = ("input_energy", "mechanical_energy", "impact_energy", "damping_energy")
    energies = {name: ("time", np.zeros(2)) for name in names} | {"initial_energy": 0.0, "result": 0}
    history = xarray.Dataset(energies, coords={"time": [0.0, 1.0]})
    scenes = SimpleNamespace(peaks=lambda *_: data, motion_set=lambda _: motions, history=lambda *_: history)
    podium = SimpleNamespace(alpha=PODIUM.alpha, R=PODIUM.R, elevation=object())
    scenes.problem = SimpleNamespace(
        podium=podium,
        column_enlargement=1.0,
        motions={"set": motions},
        options=rj.Options(),
        joints=SimpleNamespace(friction=0.6),
        story_heights=np.array([30.0]),
        missing_positions="",
    )
    outcomes = {"set": {y.id: y.test(scenes.problem, data) for y in ASSUMPTIONS[:1] + ASSUMPTIONS[6:]}}
    return SimpleNamespace(scenes=scenes, problem=scenes.problem, checks=(), assumptions=outcomes)


def texts_of(row):
    return ["number" if isinstance(cell, Quantity) else cell.text for cell in row]


def test_the_governing_row_survives():
    """The highlighted row is that of the drawn history; without a surviving scene there is none."""
    table = rocking._table(evaluation_of(MIXED), "set")
    assert table.governing == (4,)
    assert texts_of(table.rows[0]) == ["M0", *["out of steps"] * 7, "not asked"]
    assert texts_of(table.rows[1]) == ["M1", *["weightless"] * 7, "not asked"]
    assert texts_of(table.rows[4])[:3] == ["M4", "no uplift", "number"]
    assert rocking._table(evaluation_of(WITHOUT_SURVIVORS), "set").governing == ()


def test_governing_shears_are_those_of_surviving_scenes():
    for names, label, count in ((MIXED, "M4", "3 of 5"), (WITHOUT_SURVIVORS, "no scene survives", "3 of 3")):
        evaluation = evaluation_of(names)
        foundation, base = (
            joints._shears(evaluation, ["set"]).rows[0],
            building._shear(evaluation, "set"),
        )
        for row in (foundation, base):
            assert texts_of(row)[1] == label
            assert row[0].note == f"{count} scenes left out: overturned or did not finish"
    assert "(3 of 5 scenes left out" in building._stories(evaluation_of(MIXED), "set").caption


def test_a_single_oscillator_is_a_storey():
    """Its drift is the deformation, and its acceleration is V/m, of the scenes that survive."""
    evaluation = evaluation_of(("settled", "overturned", "settled"))
    data = evaluation.scenes.peaks("set").drop_vars(["peak_drift", "peak_floor_acceleration"])
    data = data.assign(peak_deformation=("motion", [0.02, 9.0, 0.04]), peak_shear=("motion", [0.3, 9.0, 0.1]))
    evaluation.scenes.peaks, evaluation.problem.story_heights = lambda *_: data, None
    evaluation.problem.podium.g = 10.0
    (row,) = building._stories(evaluation, "set").rows
    assert texts_of(row) == ["storey 1", "number", "number", "no height", "number", "number"]
    assert [row[k].value for k in (1, 2, 4, 5)] == pytest.approx([0.04, 0.03, 3.0, 2.0])
    several = data.assign(peak_deformation=(("motion", "mode"), np.ones((3, 2))))
    assert drifts_of(several) is None


def test_the_largest_value_is_that_of_a_finished_scene():
    """The largest values are those of the overturned scene; an unfinished scene has larger ones."""
    blocks = accuracy.section(evaluation_of(MIXED), None).blocks
    rows = next(block for block in blocks if getattr(block, "name", "") == "errors").rows
    assert [row[1].value for row in rows] == [1.0] * 3


def test_assumptions_in_scenes_that_did_not_finish():
    """An assumption holds only if all scenes finished; a NaN is not the worst value."""
    evaluation = evaluation_of(("weightless", "out_of_steps", "settled"))
    outcome = evaluation.assumptions["set"]["A7"]
    assert isinstance(outcome, Outcome)
    assert (outcome.worst, outcome.unfinished) == (pytest.approx(0.25), 2)
    row = assumptions._row(next(y for y in ASSUMPTIONS if y.id == "A7"), evaluation)
    assert row[3].text == "undecided"
    text = plain(row[4].text, Units.si(9.81))
    assert text == "set: least axial force 0.2500 m_c g of a column; 2 of 3 scenes did not finish."
    assert [part.value for part in row[4].text if isinstance(part, Quantity)] == [outcome.worst, 2, 3]
    for outcome in (
        evaluation_of(("weightless", "out_of_steps")).assumptions["set"][y] for y in ("A7", "A9")
    ):
        assert outcome == "Not tested: no scene finished."


def row_of(name, evaluation):
    return assumptions._row(next(y for y in ASSUMPTIONS if y.id == name), evaluation)


def test_assumptions_that_were_not_tested_in_every_set():
    """An assumption holds only if it was tested in every set and in every scene."""
    evaluation, reason = evaluation_of(("settled",) * 3), "Not tested: the demand is unknown."
    assert row_of("A1", evaluation)[3].text == "holds"
    evaluation.assumptions["strong"] = {"A1": reason}
    assert row_of("A1", evaluation)[3].text == "not tested in every set"
    assert plain(row_of("A1", evaluation)[4].text, Units.si(9.81)).endswith(f" strong: {reason}")
    evaluation.assumptions = {name: {"A1": reason} for name in ("set", "strong")}
    assert [cell.text for cell in row_of("A1", evaluation)[3:]] == ["not tested", reason]


@pytest.mark.parametrize(
    ("friction", "at_impacts", "expected"),
    [
        (0.3, 0.0, "holds"),
        (0.3, 0.7, "violated"),
        (0.7, 0.0, "violated"),
        (math.inf, 0.0, "not tested in every scene"),
    ],
)
def test_columns_may_slide_at_impacts(friction, at_impacts, expected):
    """The friction coefficient is 0.6; the demand is infinite if a joint opens."""
    evaluation = evaluation_of(("settled",) * 2)
    data = evaluation.scenes.peaks()
    data["peak_friction"] = ("motion", "joint"), [[0.2, 0.2], [friction, 0.2]]
    data["peak_impact_friction"] = ("motion", "joint"), [[0.0, 0.0], [at_impacts, 0.1]]
    evaluation.assumptions["set"]["A1"] = ASSUMPTIONS[0].test(evaluation.problem, data)
    assert row_of("A1", evaluation)[3].text == expected


def test_weightless_scenes_violate_and_unfinished_scenes_may_violate():
    for names, expected in (
        (("settled", "out_of_steps"), "undecided"),
        (("settled", "weightless"), "violated"),
        (("settled", "overturned"), "holds"),
    ):
        evaluation = evaluation_of(names)
        data = evaluation.scenes.peaks()
        evaluation.assumptions["set"]["A2"] = ASSUMPTIONS[1].test(evaluation.problem, data)
        assert row_of("A2", evaluation)[3].text == expected


def test_checks_that_other_laws_do_not_repeat_are_named():
    def check(name, result, laws):
        kind = SimpleNamespace(no_laws="samples take long")
        return SimpleNamespace(id=name, values=(), result=result, laws=laws, kind=kind)

    made = [check("C1", "NOT VALID", {"paper": (0.4, "PASS")}), check("C2", "FAIL", {})]
    texts = {"set": {"A6": "Checks are repeated."}}
    for checks, word, text in (
        (made[:1], "makes no difference", "Results that change: none."),
        (
            made,
            "no difference in the repeated checks",
            "Results that change: none. Not repeated, because samples take long: C2.",
        ),
        (made[1:], "not tested", "No check was repeated."),
        ([check("C1", "FAIL", {"paper": (0.4, "PASS")})], "matters", "Results that change: C1."),
    ):
        row = row_of("A6", SimpleNamespace(checks=checks, assumptions=texts))
        assert row[3].text == word
        assert row[4].text == f"Checks are repeated. {text}"


def test_the_largest_velocity_jump_is_that_of_its_own_motion():
    evaluation = evaluation_of(("settled", "settled", "out_of_steps"))
    jumps = np.array([0.3, 0.1, 9.0])
    evaluation.scenes.peaks()["peak_velocity_jump"] = "motion", jumps
    row = building._shear(evaluation, "set")
    assert (row[1].text, row[3].value, row[3].note) == ("M1", 0.3, "M0")
    evaluation.scenes.peaks()["peak_velocity_jump"] = "motion", np.full(3, math.nan)
    assert building._shear(evaluation, "set")[3].text == "no impact"


def test_the_worst_value_of_a_minimum_keeps_its_sign():
    evaluation = evaluation_of(("settled", "settled"))
    data = evaluation.scenes.peaks()
    data["least_axial_force"] = ("motion", "joint"), [[0.4, -1.4], [0.6, 0.5]]
    data["least_axial_force_error"] = ("motion", "joint"), np.full((2, 2), 1e-9)
    blocks = accuracy.section(evaluation, None).blocks
    rows = next(block for block in blocks if getattr(block, "name", "") == "errors").rows
    assert -1.4 in [row[1].value for row in rows]


def test_sets_of_checks_that_were_not_made_are_not_called_unused():
    names = ("a", "b")
    problem = SimpleNamespace(motions=dict.fromkeys(names), podium=PODIUM)
    evaluation = SimpleNamespace(
        problem=problem, assumptions={}, checks=[SimpleNamespace(motions="a", values=None)]
    )
    units = Units.si(9.81)
    found = [plain(block.text, units) for block in motions.section(evaluation, units).blocks]
    assert found == ["No check uses the sets b.", "No check was made with the sets a."]


@pytest.mark.parametrize(
    ("value", "unanswered", "expected"),
    [
        (0.4, "", 0.8),
        (0.4, "out_of_steps", math.nan),
        (0.6, "out_of_steps", 1.2),
        (math.inf, "weightless", math.inf),
    ],
)
def test_changes_after_which_a_scene_does_not_finish(value, unanswered, expected):
    """U of a changed input has no value, unless the other scenes show that it exceeds 1."""

    def values(entry, scenes, law, variation):
        blank = ("",) * 2
        is_changed = variation == "width+"
        y = np.array([value if is_changed else 0.3, 0.1])
        return Values(y, np.zeros(2), blank, blank, ("", unanswered if is_changed else ""), ())

    kind = SimpleNamespace(values=values, is_minimum=False)
    entry = SimpleNamespace(limit=0.5, keys=SimpleNamespace(statistic="max"))
    check = Check(entry, kind, "PASS", utilisation=0.6)
    spread = _spread(check, SimpleNamespace(variations=("width-", "width+")))["spread"]
    assert spread["width"] == pytest.approx((0.6, expected), nan_ok=True)
    text = plain(summary._spread(Check(entry, kind, "PASS", utilisation=0.6, spread=spread)), Units.si(9.81))
    assert ("no value with width +" in text) == math.isnan(expected)


def test_outcomes_of_scenes_without_an_answer():
    """Such scenes do not count as surviving."""
    entry = SimpleNamespace(motions="set", id="C1", arguments={})
    scenes = evaluation_of(MIXED).scenes
    (table,) = KINDS["overturning-probability"].tables(entry, None, scenes)
    words = ["out of steps", "weightless", "overturned", "survives", "survives"]
    assert [row[1].text for row in table.rows] == words


def test_blocks_that_did_not_finish():
    """The largest peak is that of another block; the cell has the result of the block."""
    codes = [[NAMES.index("out_of_steps"), 1], [NAMES.index("out_of_steps"), 2]]
    overturned, dims = np.array([[False, False], [False, True]]), ("motion", "contents")
    data = peaks_of(("settled", "settled")).assign(
        contents_peak_rotation=(dims, [[math.nan, 0.5], [math.nan, 1.0]]),
        contents_overturned=(dims, overturned),
        contents_overturn_time=(dims, np.where(overturned, 2.0, math.nan)),
        contents_result=(dims, codes),
    )
    scenes = evaluation_of(("settled", "settled")).scenes
    scenes.peaks = lambda *_: data.assign_coords(contents=["cabinet", "shelf"])
    kind = KINDS["contents-rotation"]
    entry = SimpleNamespace(motions="set", arguments={"contents": {"cabinet": None, "shelf": None}})
    values = kind.values(entry, scenes)
    assert values.values.tolist() == [0.5, math.inf]
    assert plain(values.texts[1], Units.si(9.81)) == "shelf overturned at 2.000\N{NO-BREAK SPACE}s"
    assert values.unanswered == ("out_of_steps", "")
    (table,) = kind.tables(entry, values, scenes)
    assert texts_of(table.rows[0])[1:] == ["out of steps", "number"]


def test_uplift_factors_need_finished_scenes(monkeypatch):
    """If the weight vanishes, the factors are reduced, because the columns lift before; other scenes that do
    not finish have no factor."""
    motions = SimpleNamespace(name="set", names=("M0",), excitations=(rj.Ricker(2.0, 1.0),))
    problem = SimpleNamespace(podium=PODIUM, options=rj.Options())
    codes = iter(["weightless", "settled", "out_of_steps"])

    def solved(*_, **__):
        code = jnp.array([NAMES.index(next(codes))])
        uplifted = np.array([False])
        return SimpleNamespace(uplifted=uplifted, uplift_ratio=np.array([0.5]), result=result_of(code))

    monkeypatch.setattr("rockjax._batch.batch.peak_responses", solved)
    scenes = SimpleNamespace(problem=problem)
    first = 0.3 * float(PODIUM.uplift_ground_acceleration) / 2.0
    assert _estimate_uplift_factors(scenes, motions) == pytest.approx([first / 3 / 0.5], rel=1e-3)
    with pytest.raises(RuntimeError, match="uplift factors of set are unknown: 1 of 1 scenes did not finish"):
        _estimate_uplift_factors(scenes, motions)


def test_oscillators_that_may_grow_after_the_end():
    """The peak of an oscillator is final if the bound of its later displacement is at most this peak."""
    dims = ("motion", "oscillator")
    data = peaks_of(("settled", "settled", "overturned")).assign(
        oscillator_pseudo_acceleration=(dims, [[1.0, 2.0]] * 3),
        oscillator_remaining_ratio=(dims, [[1.0, 0.5], [math.inf, 0.5], [1.5, 1.5]]),
        oscillator_result=(dims, [[1, 1], [1, 1], [2, 2]]),
    )
    scenes = evaluation_of(("settled",) * 3).scenes
    scenes.peaks = lambda *_: data.assign_coords(oscillator=["pump", "tank"])
    entry = SimpleNamespace(motions="set", arguments={"oscillators": {"pump": None, "tank": None}})
    values = KINDS["floor-spectrum"].values(entry, scenes)
    assert values.unanswered == ("", "response may still grow after the end", "")


def test_joints_without_dead_load():
    """The top joint of a column that carries nothing has no force; it is left out."""
    column = rj.Podium.from_dimensions(width=0.6, height=3.0, column_mass=2700.0)
    assert np.asarray(column.dead_load).tolist() == [1.0, 0.0]
    forces = ("motion", "joint"), [[0.8, 0.0], [0.9, 0.0]]
    data = peaks_of(("settled", "settled")).drop_vars("peak_friction")
    data = data.assign(least_axial_force=forces, peak_axial_force=forces)
    evaluation = evaluation_of(("settled", "settled"))
    scenes, entry = evaluation.scenes, SimpleNamespace(motions="set")
    scenes.peaks, scenes.podium, scenes.factors = lambda *_: data, lambda *_: column, lambda _: {}
    for kind in ("least-axial-force", "peak-axial-force"):
        values = KINDS[kind].values(entry, scenes)
        assert values.values.tolist() == [0.8, 0.9]
        assert values.locations == ("bottom joint",) * 2
        assert values.texts == ("", "")
        share = lambda y, kind=kind: jnp.min(
            KINDS[kind].conversion(None, column.replace(gamma=y))(jnp.array(forces[1]))
        )
        assert np.isfinite(jax.grad(share)(0.0))
    evaluation.problem.podium = column
    table = joints._table(evaluation, "set")
    rows = [texts_of(row)[1:] for row in table.rows]
    assert rows == [["bottom", "number", "number"], ["top", "no dead load", "no dead load"]] * 2
