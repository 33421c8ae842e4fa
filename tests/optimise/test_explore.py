import io
import logging

import jax
import matplotlib.image
import numpy as np
import pytest

import optimise
import rockjax as rj

pytest.importorskip("ipywidgets")

COLUMN = optimise.Dimensions(
    width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3, top_mass=300e3, period=0.5
)
PULSE = rj.Ricker(3.2, 1.0)


RANGES = {"width": (0.2, 1.5), "period": (0.1, 1.5), "a_p": (0.5, 8.0), "T_p": (0.3, 2.0)}


@pytest.fixture(scope="module")
def study():
    return optimise.explore(COLUMN, PULSE, RANGES)


def shown_in_a_browser(explorer):
    """Act like a browser that shows sliders: round every value to the nearest position from `min`, and send
    it back."""
    for slider in explorer.sliders.values():
        place = round((slider.value - slider.min) / slider.step)
        slider.set_state({"value": slider.min + place * slider.step})


def test_sliders_move_the_scene(study):
    for name, value in {"width": 0.6, "period": 0.8, "a_p": 4.0, "T_p": 0.7}.items():
        study.sliders[name].value = value
    assert study.values == {"width": 0.6, "period": 0.8, "a_p": 4.0, "T_p": 0.7}
    expected = COLUMN.replace(width=0.6, period=0.8).podium()
    assert study.podium.alpha == pytest.approx(float(expected.alpha), rel=1e-15)
    assert study.excitation.a_p == 4.0
    peak = rj.peak_response(expected, rj.Ricker(4.0, 0.7), options=rj.Options())
    for field in ("peak_rotation", "peak_deformation", "peak_shear"):
        assert getattr(study.peak, field) == pytest.approx(float(getattr(peak, field)), rel=1e-6)
    assert 0 < study.peak.margin < 1
    assert study._image.value == study.picture


def test_initial_values_are_exact_until_a_slider_is_moved():
    odd = COLUMN.replace(width=0.45371234567, period=1 / 3)
    study = optimise.explore(odd, rj.Ricker(3.2001, 0.77), RANGES)
    given, peak, picture = study.values, float(study.peak.peak_rotation), study.picture
    assert given == {"width": 0.45371234567, "period": 1 / 3, "a_p": 3.2001, "T_p": 0.77}
    shown_in_a_browser(study)
    assert study.values == given
    assert float(study.podium.width) == pytest.approx(0.45371234567, rel=1e-15)
    assert (float(study.peak.peak_rotation), study.picture) == (peak, picture)
    for slider, value in zip(study.sliders.values(), given.values(), strict=True):
        assert slider.value == pytest.approx(value, rel=1e-5)
        assert 200 <= (slider.max - slider.min) / slider.step <= 500_000
    # Moved, and moved back.
    study.sliders["a_p"].set_state({"value": 0.5 + 27 * 0.1})
    assert study.values["a_p"] == 3.2
    study.sliders["a_p"].set_state({"value": 3.2001 + 1e-13})
    assert study.values == given


def test_round_numbers_stay_round_numbers(study):
    for name, value in {"width": 0.45, "period": 0.5, "a_p": 3.2, "T_p": 1.0}.items():
        slider = study.sliders[name]
        assert slider.step == pytest.approx(float(f"{slider.step:.0e}"))  # step of one significant digit
        slider.value = 0.5 * (slider.min + slider.max)
        slider.set_state({"value": slider.min + round((value - slider.min) / slider.step) * slider.step})
        assert study.values[name] == value  # not 0.45000000000000007


def test_pictures_follow(study):
    study.sliders["a_p"].value = 1.0
    low = study.picture
    study.sliders["a_p"].value = 8.0
    study.sliders["width"].value = 0.3
    assert study.peak.overturned
    assert "overturns at" in study._text.value
    low, high = (matplotlib.image.imread(io.BytesIO(png)) for png in (low, study.picture))
    assert low.shape == high.shape == (960, 1280, 4)  # twice as many pixels as on the screen
    assert np.any(low != high)


def test_no_compilation_when_sliders_move(study, caplog):
    study.sliders["a_p"].value = 2.0  # independent of the first answer
    with jax.log_compiles(), caplog.at_level(logging.DEBUG, "jax"):
        for name, slider in study.sliders.items():
            for part in (0.1, 0.5, 0.9):
                slider.value = slider.min + part * (slider.max - slider.min)
            assert study.values[name] == slider.value
        assert not [record for record in caplog.records if "ompil" in record.getMessage()]
        jax.jit(lambda x: x + 1)(0.0)
        # A change would be visible.
        assert [record for record in caplog.records if "ompil" in record.getMessage()]


@pytest.mark.slow
def test_records_and_rigid_buildings():
    motion = rj.synthetic_motions(1, seed=3, duration=4.0, dt=0.02)[0]
    podium = rj.Podium(alpha=0.15, R=1.5, gamma=10.0, superstructure=rj.Rigid(20.0))
    study = optimise.explore(podium, motion.record(), {"scale": (0.1, 5.0), "alpha": (0.1, 0.3)})
    study.sliders["scale"].value = 3.0
    expected = rj.peak_response(podium, motion.record(3.0)).peak_rotation
    assert study.peak.peak_rotation == pytest.approx(float(expected), rel=1e-6)
    assert len(study._drawing.figure.axes) == 2  # without a superstructure there is no deformation panel


@pytest.mark.slow
def test_buildings_under_both_components():
    building = COLUMN.replace(
        top_mass=0.0, period=None, story_masses=[100e3, 80e3], story_stiffnesses=[40e6, 30e6]
    )
    motion = rj.GroundMotion(rj.OneSine(2.5, 0.8), rj.OneSine(-1.0, 0.5))
    study = optimise.explore(building, motion, {"width": (0.2, 1.5), "story_stiffness_1": (1e7, 1e8)})
    study.sliders["story_stiffness_1"].value = 2e7
    expected = rj.peak_response(building.replace(story_stiffnesses=[2e7, 30e6]).podium(), motion)
    for field in ("peak_rotation", "peak_drift", "peak_floor_acceleration"):
        found, requested = (np.asarray(getattr(peak, field)) for peak in (study.peak, expected))
        np.testing.assert_allclose(found, requested, rtol=1e-6)
    assert [ax.get_ylabel() for ax in study._drawing.figure.axes][1] == "roof\n[mm]"
    largest = 1e3 * float(np.max(expected.peak_drift))
    assert f"{largest:.3g}" in study._text.value


@pytest.mark.parametrize(
    ("vary", "output"),
    [
        ({}, "must name at least one parameter"),
        ({"widht": (0.2, 1.0)}, "widht"),  # codespell:ignore
        ({"width": 0.5}, "must be a pair"),
        ({"a_p": ("1", "5")}, "must be a pair"),
        ({"a_p": (0.0, np.inf)}, "must be finite"),
        ({"width": (0.5, 1.0)}, "must be a range that contains the present value 0.45"),
        ({"a_p": "no"}, "must be a pair"),
        ({"T_p": (2.0, 0.5)}, "must be a range that contains the present value 1"),
        (
            {"T_p": (-1.0, 2.0)},
            r"vary\['T_p'\] = \(-1, 2\) exceeds the admissible range: Ricker: T_p must be",
        ),
    ],
)
def test_invalid_arguments_are_named(vary, output):
    with pytest.raises(ValueError, match=output):
        optimise.explore(COLUMN, PULSE, vary)


def test_other_things_are_not_explored():
    with pytest.raises(ValueError, match="must be a rockjax motion"):
        optimise.explore(COLUMN, "Ricker", {"width": (0.2, 1.0)})
    with pytest.raises(ValueError, match=r"optimise\.Dimensions"):
        optimise.explore("podium", PULSE, {"a_p": (1.0, 5.0)})
    with pytest.raises(ValueError, match=r"explore: options.overturn_ratio must be <= π/\(2α\)"):
        optimise.explore(COLUMN, PULSE, {"a_p": (1.0, 5.0)}, options=rj.Options(overturn_ratio=12.0))


def test_a_structure_for_which_the_overturn_ratio_is_too_large_is_valid(study, monkeypatch):
    monkeypatch.setattr(study, "_options", study._options.replace(overturn_ratio=3.5))
    peak, picture = study.peak, study.picture
    study.sliders["width"].value = 1.5
    assert "options.overturn_ratio must be" in study._text.value
    assert (study.peak, study.picture) == (peak, picture)
    assert float(study.podium.width) == study.structure.width == 1.5


def test_values_without_a_valid_structure_are_reported():
    column = optimise.Dimensions(0.45, 3.0, 1.5e3, 30e3, positions=(0.0, 5.0))
    study = optimise.explore(column, PULSE, {"width": (0.3, 1.2), "position_2": (1.0, 8.0)})
    study.sliders["position_2"].value = 1.0
    peak, picture = study.peak, study.picture
    study.sliders["width"].value = 1.2
    assert "at least the width of a column apart" in study._text.value
    assert (study.peak, study.picture) == (peak, picture)
    with pytest.raises(ValueError, match="at least the width of a column apart"):
        _ = study.podium
    study.sliders["width"].value = 0.9
    assert "peak rotation" in study._text.value
