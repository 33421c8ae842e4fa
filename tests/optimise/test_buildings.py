"""Designs, limit states and analyses of buildings, whose peaks have an additional axis."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import optimise
import rockjax as rj
from optimise._cli import design_record
from optimise._suite import Suite
from optimise._variables import make_variables
from rockjax import _results as results
from rockjax._risk.structure import StructureLimitState, parse_limit

BUILDING = rj.ShearBuilding(masses=[3.0, 2.0], stiffnesses=[900.0, 500.0], heights=[3.0, 3.0])
PODIUM = rj.Podium(alpha=0.15, R=1.5, gamma=10.0, superstructure=BUILDING)
MOTIONS = [rj.OneSine(2.0, 0.8), rj.OneSine(2.4, 0.6)]  # as many as there are stories and modes
OPTIONS = rj.Options(rtol=1e-8, atol=1e-10, throw=False)
OUTPUTS = ("peak_deformation", "peak_drift", "peak_floor_acceleration", "peak_shear")


@pytest.fixture(scope="module")
def peaks():
    return Suite.of(MOTIONS).responses(PODIUM, OPTIONS, OUTPUTS)


def test_every_story_has_a_margin(peaks):
    for target, objective, output in (
        (optimise.PeakDrift, optimise.WorstDrift, "peak_drift"),
        (optimise.PeakFloorAcceleration, optimise.WorstFloorAcceleration, "peak_floor_acceleration"),
        (optimise.PeakDeformation, optimise.WorstDeformation, "peak_deformation"),
    ):
        values = np.asarray(getattr(peaks, output))
        assert values.shape == (2, 2)
        assert (values > 0).all()
        limit = float(np.median(values))
        assert np.allclose(target(limit, MOTIONS).read(peaks, OPTIONS), 1 - values.ravel() / limit)
        assert np.array_equal(objective(MOTIONS).read(peaks, OPTIONS), values.ravel())
    shear = optimise.PeakShear(0.3, MOTIONS).read(peaks, OPTIONS)
    assert np.allclose(shear, 1 - np.asarray(peaks.peak_shear) / 0.3)


@pytest.mark.parametrize(
    ("target", "objective", "output"),
    [
        (optimise.PeakShear, optimise.WorstShear, "peak_shear"),
        (optimise.PeakDeformation, optimise.WorstDeformation, "peak_deformation"),
        (optimise.PeakDrift, optimise.WorstDrift, "peak_drift"),
        (optimise.PeakFloorAcceleration, optimise.WorstFloorAcceleration, "peak_floor_acceleration"),
    ],
)
def test_a_scene_that_overturned_holds_no_target(peaks, target, objective, output):
    """Peaks cover the time until overturning and are here far below the limit."""
    values = peaks.values | {"margin": jnp.array([-0.3, 0.5])}
    fell = dataclasses.replace(peaks, overturned=jnp.array([True, False]), values=values)
    values = np.asarray(getattr(peaks, output)).reshape(2, -1)
    margins = np.reshape(target(10 * values.max(), MOTIONS).read(fell, OPTIONS), values.shape)
    assert (margins[0] == -0.3).all()
    assert (margins[1] > 0.89).all()
    worst = np.reshape(objective(MOTIONS).read(fell, OPTIONS), values.shape)
    np.testing.assert_allclose(worst, values * [[1.3], [1.0]])
    tight = np.reshape(target(0.1 * values.min(), MOTIONS).read(fell, OPTIONS), values.shape)
    assert (tight <= -9 * (1 - 1e-12)).all()  # and at most the margin from the peaks


@pytest.mark.slow
def test_a_design_under_a_motion_that_overturns_is_not_satisfied():
    found = optimise.design(
        PODIUM,
        {"gamma": (9.0, 11.0)},
        lambda podium: podium.gamma,
        optimise.PeakShear(50.0, rj.OneSine(9.0, 1.0), name="shear"),
        max_iterations=2,
    )
    assert not found.satisfied
    assert found.failing["shear"] < 0
    assert found.overturned == {"shear": 1}


@pytest.mark.slow
def test_a_design_marks_peaks_of_scenes_that_overturned():
    """Without a target, only this mark shows that the columns do not survive the second motion."""
    motions = [rj.OneSine(2.0, 0.8), rj.OneSine(9.0, 1.0)]
    found = optimise.design(
        PODIUM, {"gamma": (9.0, 11.0)}, optimise.WorstShear(motions), options=OPTIONS, max_iterations=1
    )
    assert found.overturned == {"worst peak shear / m_t g": 1}
    assert f"worst peak shear / m_t g = {found.objective:.6g} (until overturning)" in str(found)
    assert "overturn in 1 of its scenes; the peaks of these scenes cover only the time until" in str(found)
    assert "until overturning" in found._repr_html_()
    assert design_record(found)["overturned"] == found.overturned
    upright = optimise.design(
        PODIUM, {"gamma": (9.0, 11.0)}, optimise.WorstShear(motions[:1]), options=OPTIONS, max_iterations=1
    )
    assert not upright.overturned
    assert "until overturning" not in str(upright)


def test_scenes_without_an_answer_are_nan_in_all_their_stories(peaks, monkeypatch):
    """There are as many motions as stories, so the length does not identify the axis."""
    one = jax.tree.map(lambda y: jnp.asarray(y)[0], peaks)

    def answered_when_weak(podium, motion, *, options):
        code = jnp.where(motion.a_p < 2.2, results.SETTLED, results.OUT_OF_STEPS)
        return dataclasses.replace(one, overturned=jnp.zeros_like(code, bool), result=results.result_of(code))

    monkeypatch.setattr(rj, "peak_response", answered_when_weak)
    found = Suite.of(MOTIONS).responses(PODIUM, OPTIONS, OUTPUTS)
    assert np.array_equal(found.peak_drift[0], peaks.peak_drift[0])
    assert np.isnan(found.peak_drift[1]).all()


def test_a_podium_without_stories_is_refused(peaks):
    none = dataclasses.replace(peaks, values={y: z for y, z in peaks.values.items() if y != "peak_drift"})
    with pytest.raises(ValueError, match="PeakDrift: this podium has no peak_drift"):
        optimise.PeakDrift(0.01, MOTIONS).read(none, OPTIONS)
    with pytest.raises(ValueError, match="WorstDrift: this podium has no peak_drift"):
        optimise.WorstDrift(MOTIONS).read(none, OPTIONS)


def test_problem_files_name_drifts_and_floor_accelerations(tmp_path):
    (tmp_path / "problem.toml").write_text(
        """
        [structure]
        alpha = 0.15
        R = 1.5
        gamma = 10.0
        superstructure = { masses = [3.0, 2.0], stiffnesses = [900.0, 500.0] }

        [motions]
        pulses = [{ kind = "one-sine", a_p = 2.0, T_p = 0.8 }]

        [vary]
        alpha = [0.1, 0.2]

        [minimise]
        quantity = "peak-floor-acceleration"
        motions = "pulses"

        [[targets]]
        kind = "peak-drift"
        limit = 0.03
        motions = "pulses"
        """
    )
    problem = optimise.load(tmp_path / "problem.toml")
    assert isinstance(problem.minimise, optimise.WorstFloorAcceleration)
    (target,) = problem.targets
    assert isinstance(target, optimise.PeakDrift)
    assert target.describe() == "peak drift ≤ 0.03 m"


@pytest.mark.slow
def test_an_analysis_of_a_building_has_its_modes_and_stories():
    motions = rj.synthetic_motions(2, seed=1, dt=0.05, duration=3.0)
    options = rj.Options(rtol=1e-6, atol=1e-8, outputs=("peak_rotation", *OUTPUTS[:2]))
    found = rj.incremental_dynamic_analysis(
        PODIUM, motions, [1.0, 6.0], width=0.05, resolution=32, options=options
    )
    assert found["peak_rotation"].dims == ("record", "intensity")
    assert found["peak_deformation"].dims == ("record", "intensity", "vibration_mode")
    assert found["peak_drift"].dims == ("record", "intensity", "story")


@pytest.mark.slow
def test_limit_states_of_buildings_take_the_worst_story():
    motion = rj.GaussianMotion(41, 0.06, 0.02)
    limit = parse_limit("test", ("drift", 0.02), PODIUM)
    state = StructureLimitState(PODIUM, motion, limit)
    u = np.random.default_rng(0).normal(size=(3, motion.dimension))
    peaks = state._peaks(u)
    expected = 1 - np.asarray(peaks.peak_drift).max(axis=1) / 0.02
    value, slope, _ = state.with_sensitivities(u)
    assert np.allclose(value, np.where(peaks.overturned, np.minimum(expected, 0), expected), rtol=1e-9)
    h = 1e-6 * slope[0] / np.linalg.norm(slope[0])
    ends = state.values(np.stack([u[0] + h, u[0] - h]))
    assert np.isclose((ends[0] - ends[1]) / 2e-6, np.linalg.norm(slope[0]), rtol=1e-5)
    same, _, by_name = state.log_slopes(u, ("alpha",))
    assert np.allclose(same, value, rtol=1e-9)
    moved = [PODIUM.replace(alpha=float(PODIUM.alpha) * (1 + d)) for d in (1e-6, -1e-6)]
    up, down = (StructureLimitState(each, motion, limit).values(u) for each in moved)
    assert np.allclose(by_name[:, 0], (up - down) / 2e-6, rtol=1e-4, atol=1e-6)


def test_limit_states_of_stories_need_stories():
    for name in ("drift", "floor acceleration"):
        words = re.escape(f"limit {name!r} needs a building of stories, a rockjax.ShearBuilding; this podium")
        with pytest.raises(ValueError, match=words):
            parse_limit("test", (name, 0.1), PODIUM.replace(superstructure=rj.Elastic(8.0, 0.5, 0.05)))
        assert parse_limit("test", (name, 0.1), PODIUM).value == 0.1


DRAWING = optimise.Dimensions(
    width=0.6,
    height=3.0,
    column_mass=2700.0,
    columns=4,
    beam_mass=30e3,
    story_masses=[20e3, 15e3],
    story_stiffnesses=[12e6, 8e6],
    story_heights=[3.0, 3.0],
)


def test_stories_vary_by_ratios_and_by_dimensions():
    ratios, drawing = (
        make_variables(base, {"story_stiffness_2": bounds, "story_mass_1": masses})
        for base, bounds, masses in (
            (PODIUM, (200.0, 900.0), (1.0, 4.0)),
            (DRAWING, (2e6, 2e7), (1e4, 3e4)),
        )
    )
    assert ratios.units == ("1/s²", "–")
    assert drawing.units == ("N/m", "kg")
    assert np.allclose(ratios.values(ratios.start()), (500.0, 3.0))
    assert np.allclose(drawing.values(drawing.start()), (8e6, 20e3))
    x = jnp.asarray([0.25, 0.5])
    for varied, unit in ((ratios, 1.0), (drawing, 4 * 2700.0)):
        building = varied.podium(x).superstructure
        assert isinstance(building, rj.ShearBuilding)
        expected = np.asarray(varied.values(x)) / unit
        assert np.allclose((building.stiffnesses[1], building.masses[0]), expected)
        slope = jax.jacfwd(lambda x, v=varied: v.podium(x).superstructure.stiffnesses)(x)
        assert (slope[0] == 0).all()
        assert slope[1, 0] > 0


def test_stories_that_are_not_there_cannot_vary():
    with pytest.raises(ValueError, match=r"dimensions that can vary are .*story_mass_2, story_stiffness_1"):
        make_variables(DRAWING, {"story_stiffness_3": (1e6, 1e7)})
    with pytest.raises(ValueError, match="vary names 'story_stiffness_3'"):
        make_variables(PODIUM, {"story_stiffness_3": (100.0, 200.0)})


def test_uniform_buildings_vary_by_their_period():
    three = DRAWING.replace(
        top_mass=60e3, period=0.5, stories=3, story_masses=None, story_stiffnesses=None, story_heights=3.0
    )
    varied = make_variables(three, {"period": (0.3, 0.9)})
    modes = varied.podium(jnp.ones(1)).superstructure.modes
    assert float(modes.T[0]) == pytest.approx(0.9)


@pytest.mark.slow
def test_a_story_is_made_as_stiff_as_its_drift_asks_for():
    target = optimise.PeakDrift(0.03, MOTIONS[:1])
    found = optimise.design(
        PODIUM,
        {"story_stiffness_1": (300.0, 3000.0)},
        lambda podium: podium.superstructure.stiffnesses[0] / 1000,
        target,
        options=OPTIONS,
    )
    assert found.satisfied
    peak = rj.peak_response(found.podium, MOTIONS[0], options=OPTIONS.replace(outputs=OUTPUTS))
    assert float(jnp.max(peak.peak_drift)) == pytest.approx(0.03, rel=1e-4)
