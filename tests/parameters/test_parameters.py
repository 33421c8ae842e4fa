"""Structures, motions, commands and designs agree with the registry of parameters."""

import dataclasses
import inspect
import math

import jax
import numpy as np
import pytest

import rockjax as rj
from optimise._variables import Dimensions, make_variables
from rockjax._parameters import registry, variants
from rockjax._parameters.sensitivities import check_parameters, with_factors
from rockjax._problem.models import ByDimensions, ByRatios, Elevation, Superstructure

DEVICES = rj.Tendon(5.0, 100.0), rj.Damper(4.0, 0.5), rj.Inerter(8.0)
COLUMNS = rj.Elevation((-3.0, 3.0), 0.6, 8.4, 1.0)
RESTRAINED = rj.Podium(0.2, 1.5, 10.0, rj.Elastic(50.0, 0.5, 0.03), 0.3, 0.9, 9.7, DEVICES, COLUMNS)
UNRESTRAINED = rj.Podium(0.2, 1.5)

# Other parameters that change with a parameter.
DEPENDENT = {
    "alpha": {"tan_alpha", "width", "height"},
    "tan_alpha": {"alpha", "width", "height"},
    "R": {"width", "height"},
    "width": {"alpha", "tan_alpha", "R"},
    "height": {"alpha", "tan_alpha", "R"},
}


@pytest.mark.parametrize("name", registry.STRUCTURE)
def test_a_parameter_is_read_where_it_is_set(name):
    value = float(variants.read(RESTRAINED, name)) * 1.01
    changed = variants.with_values(RESTRAINED, {name: value})
    assert float(variants.read(changed, name)) == pytest.approx(value, rel=1e-14)
    others = set(registry.STRUCTURE) - {name} - DEPENDENT.get(name, set())
    for other in others:
        assert float(variants.read(changed, other)) == pytest.approx(
            float(variants.read(RESTRAINED, other)), rel=1e-14
        ), other


def test_which_parameters_a_podium_has():
    assert set(variants.parameters_of(RESTRAINED)) == {*registry.STRUCTURE, "position_1", "position_2"}
    left_out = {"eta", "T_s", "zeta", "restitution"}
    left_out |= {"prestress", "stiffness", "coefficient", "exponent", "inertance_ratio"}
    left_out |= {"beam_depth", "top_height", "residual_height"}
    assert set(variants.parameters_of(UNRESTRAINED)) == set(registry.STRUCTURE) - left_out
    assert "eta" in variants.parameters_of(rj.Podium(0.2, 1.5, 1.0, rj.Rigid(5.0)))
    with pytest.raises(
        ValueError, match=r"one of the parameters of this podium, alpha, tan_alpha, .*; got 'T_s'"
    ):
        variants.read(UNRESTRAINED, "T_s")


def test_damping_ratios_of_several_podiums_are_not_rows_of_modes():
    """There are as many podiums as modes; the axis of podiums must not be taken for that of modes."""
    building = rj.ShearBuilding.uniform(stories=2, eta=5.0, T=0.5)
    podium, ratios = rj.Podium(0.2, 1.5, 5.0, building), np.array([0.02, 0.05])
    for values in (ratios, np.array([0.02, 0.03, 0.05])):
        top = variants.with_values(podium, {"story_damping": values}).superstructure
        np.testing.assert_array_equal(top.damping, values[:, None] * np.ones(2))


TALL = rj.Podium(
    0.15,
    1.5,
    10.0,
    rj.ShearBuilding((3.0, 3.0, 2.0), (900.0, 700.0, 500.0), modes=2, heights=(4.0, 3.0, 3.5)),
    elevation=rj.Elevation([-2.0, 2.0, 5.0], 0.5),
)


@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("story_height_2", lambda f: heights_of((4.0, 3.0 * f, 3.5))),
        ("story_heights", lambda f: heights_of((4.0 * f, 3.0 * f, 3.5 * f))),
        ("positions", lambda f: TALL.replace(elevation=rj.Elevation([-2 * f, 2 * f, 5 * f], 0.5))),
        ("position_3", lambda f: TALL.replace(elevation=rj.Elevation([-2.0, 2.0, 5 * f], 0.5))),
        ("beam_depth", lambda f: TALL.replace(elevation=rj.Elevation([-2.0, 2.0, 5.0], 0.5 * f))),
    ],
)
def test_factors_on_positions_and_heights(name, changed, split):
    """Also in the form of compiled programs, in which rows are tuples of numbers."""
    podium = TALL.split_rows() if split else TALL
    found = with_factors(podium, [name], [np.array(1.25)]).resolved().elevation
    expected = changed(1.25).resolved().elevation
    for y, z in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(y, z, rtol=1e-14)


def heights_of(heights):
    return TALL.replace(superstructure=dataclasses.replace(TALL.superstructure, heights=heights))


def test_factors_on_several_heights_of_an_elevation():
    podium = rj.Podium(
        0.2, 1.5, 5.0, rj.Modes((3.0, 1.0), (0.5, 0.1)), elevation=rj.Elevation([0, 4], 0.5, [6, -2])
    )
    found = with_factors(podium, ["top_height"], [np.array(1.5)])
    np.testing.assert_allclose(found.elevation.top_height, [9.0, -3.0])


def test_names_of_positions_and_heights():
    check_parameters("here", TALL, ("positions", "story_heights", "beam_depth"))
    for names, message in (
        (("positions", "position_2"), "positions and position_2, which cannot vary at the same time"),
        (("story_heights", "story_height_1"), "story_heights and story_height_1, which cannot vary"),
        (("top_height",), "must each be one of"),
    ):
        with pytest.raises(ValueError, match=message):
            check_parameters("here", TALL, names)
    for name in ("positions", "story_heights", "story_height_1"):
        with pytest.raises(ValueError, match="must each be one of"):
            check_parameters("here", TALL.replace(elevation=None), (name,))


def test_width_and_height_are_slenderness_and_size():
    podium = variants.with_values(UNRESTRAINED, {"width": 0.6, "height": 4.0})
    assert (float(podium.alpha), float(podium.R)) == pytest.approx(
        (math.atan(0.15), math.hypot(0.3, 2.0)), rel=1e-14
    )
    wider = variants.with_values(UNRESTRAINED, {"width": 0.6})
    assert float(wider.height) == pytest.approx(float(UNRESTRAINED.height), rel=1e-14)
    with pytest.raises(ValueError, match="R and width describe the same"):
        variants.with_values(UNRESTRAINED, {"width": 0.6, "R": 2.0})


@pytest.mark.parametrize("name", registry.STRUCTURE)
def test_the_range_is_that_of_the_structure(name):
    """Values just outside the range raise an error, and values just inside are accepted."""
    low, high = registry.STRUCTURE[name].range.low, registry.STRUCTURE[name].range.high
    for end, inwards in ((low, 1e-9), (high, -1e-9)):
        if math.isinf(end):
            continue
        assert registry.STRUCTURE[name].range.holds(end + inwards)
        assert not registry.STRUCTURE[name].range.holds(end - inwards)
        variants.with_values(RESTRAINED, {name: end + inwards})
        with pytest.raises(ValueError, match=r"must be"):
            variants.check_values("here", {name: end - inwards})
        if name not in (*registry.WIDTH_AND_HEIGHT, "tan_alpha"):
            with pytest.raises(ValueError, match=r"must be"):
                variants.with_values(RESTRAINED, {name: end - inwards})


def test_dimensions_are_the_arguments_of_the_constructor():
    arguments = set(inspect.signature(rj.Podium.from_dimensions).parameters)
    assert set(registry.DIMENSIONS) < arguments
    assert arguments == {field.name for field in dataclasses.fields(Dimensions)}


def test_problem_files_know_all_parameters():
    of_ratios = {*ByRatios.model_fields, *Superstructure.model_fields, *Elevation.model_fields}
    tables = {"superstructure", "elevation", "columns"}
    assert {*of_ratios, *registry.WIDTH_AND_HEIGHT} == {*registry.STRUCTURE, *registry.BUILDING, *tables}
    assert set(ByDimensions.model_fields) == set(inspect.signature(rj.Podium.from_dimensions).parameters)


def test_parameters_of_motions_are_fields_of_theirs():
    kinds = (
        rj.Ricker(1.0, 1.0),
        rj.Gabor(1.0, 1.0),
        rj.MavroeidisPapageorgiou(1.0, 1.0),
        rj.Record(np.ones(3), 0.1),
    )
    fields = {field.name for motion in kinds for field in dataclasses.fields(motion)}
    ratios = {name for name, entry in registry.MOTION.items() if entry.instead_of}
    of_pairs = {"vertical_ratio"}  # parameters that turn one motion into a pair
    assert set(registry.MOTION) - ratios - of_pairs == fields - {"acceleration"}


def test_designs_take_names_and_places_of_parameters():
    by_name = make_variables(RESTRAINED, {"T_s": (0.3, 0.6), "tan_alpha": (0.1, 0.3)})
    by_place = make_variables(RESTRAINED, {"superstructure.T_s": (0.3, 0.6), "tan_alpha": (0.1, 0.3)})
    assert by_name.units == by_place.units == ("s", "–")
    x = by_name.start()
    for box in (by_name, by_place):
        podium = box.podium(x)
        assert float(podium.superstructure.T_s) == pytest.approx(0.5)
        assert float(podium.alpha) == pytest.approx(0.2)
    with pytest.raises(ValueError, match="vary names T_s twice"):
        make_variables(RESTRAINED, {"T_s": (0.3, 0.6), "superstructure.T_s": (0.3, 0.6)})


def test_names_of_files():
    names = [registry.attribute_name(registry.STRUCTURE[name]) for name in ("alpha", "R", "lam", "T_s", "g")]
    assert names == ["alpha_rad", "R_m", "lambda", "T_s_s", "g_m_s2"]
    assert registry.variable_attributes("excitation.gamma")["long_name"].startswith("number of oscillations")


def test_names_of_structures_and_pulses_are_checked_by_their_own_ranges():
    """γ = 0 is a block without a beam; γ is also the number of oscillations of a pulse, which is positive."""
    from rockjax._responses.variants import with_parameters

    pulse = rj.OneSine(3.0, 1.0)
    podium, _ = with_parameters(
        "test", rj.Podium(0.2, 2.0, gamma=1.0), pulse, {"gamma": np.array([0.0, 0.5])}
    )
    np.testing.assert_array_equal(podium.gamma, [0.0, 0.5])
    with pytest.raises(ValueError, match="gamma must be finite and >= 0"):
        with_parameters("test", rj.Podium(0.2, 2.0, gamma=1.0), pulse, {"gamma": np.array([-0.1, 0.5])})
