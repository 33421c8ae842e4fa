"""Grids and ensembles of structures by dimensions vary kilograms, newtons per metre and metres."""

import jax
import numpy as np
import pytest
from scipy import stats

import optimise
import rockjax as rj
from optimise._variables import make_variables, value_of
from rockjax._parameters.dimensions import parameters_of_dimensions, podium_of

COLUMNS = {
    "width": 0.7,
    "height": 3.0,
    "column_mass": 3.675e3,
    "beam_mass": 311e3,
    "positions": [-6.0, 0.0, 6.0],
}
MASSES, STIFFNESSES = [220e3, 200e3, 180e3], [300e6, 250e6, 200e6]
STORIES = {"story_masses": MASSES, "story_stiffnesses": STIFFNESSES, "story_heights": [4.0, 3.0, 3.0]}
BUILDING = COLUMNS | STORIES | {"beam_depth": 0.6}
SWAYING = COLUMNS | {"top_mass": 600e3, "period": 0.7, "top_height": 9.0, "tendon_force": 10e3}
MOTION = rj.Ricker(3.0, 0.7)
FIELDS = {
    "story_mass": "story_masses",
    "story_stiffness": "story_stiffnesses",
    "story_height": "story_heights",
    "position": "positions",
}
LISTS = "story_masses", "story_stiffnesses", "story_heights", "positions"


def changed(given, values):
    """Return the arguments of `Podium.from_dimensions` with other values of parameters."""
    arguments = {name: list(y) if isinstance(y, list) else y for name, y in given.items()}
    for name, value in values.items():
        row, _, number = name.rpartition("_")
        if row in FIELDS:
            arguments[FIELDS[row]][int(number) - 1] = value
        elif name not in LISTS:
            arguments[name] = value
    factors = {name: value for name, value in values.items() if name in LISTS}
    return arguments | {name: [factor * y for y in arguments[name]] for name, factor in factors.items()}


@pytest.mark.parametrize(
    ("given", "left_out"),
    [(BUILDING, {"tendon_force", "tendon_stiffness", "inertance"}), (SWAYING, {"end_radius"})],
    ids=["stories", "period"],
)
def test_every_parameter_gives_the_podium_of_its_value(given, left_out):
    """Every podium of a batch is that of `from_dimensions` with the values of the batch, to rounding."""
    base = optimise.Dimensions(**given)
    parameters = parameters_of_dimensions(base)
    assert {"column_mass", "beam_mass", "position_2", "positions", "beam_depth"} < set(parameters)
    assert {"zeta", "T_s", "columns"}.isdisjoint(parameters)
    assert ("story_mass_3" in parameters) == ("period" not in parameters) == (given is BUILDING)
    left_out = left_out | {"damper_coefficient", "damper_exponent"}
    values = {}
    for name in set(parameters) - left_out:
        row, _, number = name.rpartition("_")
        original = given[FIELDS[row]][int(number) - 1] if row in FIELDS else getattr(base, name)
        is_number = np.ndim(original) == 0 and not isinstance(original, str)
        factor = (float(original) or (-0.5 if row == "position" else 0.1)) if is_number else 0.9
        values[name] = np.array([1.01, 1.04]) * factor
    batch = podium_of(base, values)
    for k in range(2):
        single = changed(given, {name: float(y[k]) for name, y in values.items()})
        if given is BUILDING:
            single["damping"] = [single["damping"]] * 3  # a batch has a damping ratio for each mode
        expected = jax.tree.leaves(rj.Podium.from_dimensions(**single).split_rows())
        for found, leaf in zip(jax.tree.leaves(batch), expected, strict=True):
            picked = np.asarray(found)[k] if np.ndim(found) else found
            np.testing.assert_allclose(picked, leaf, rtol=1e-12)


@pytest.mark.parametrize(
    ("given", "names"),
    [
        (BUILDING, ["width", "story_mass_2", "story_height_1", "position_1", "damping", "beam_depth"]),
        (SWAYING, ["height", "top_mass", "period", "damping", "position_3", "top_height", "tendon_force"]),
    ],
    ids=["stories", "period"],
)
def test_designs_vary_the_same_dimensions_as_grids(given, names):
    base = optimise.Dimensions(**given)
    originals = {name: float(value_of(base, name)) for name in names}
    variables = make_variables(base, {name: tuple(sorted((y, 1.1 * y))) for name, y in originals.items()})
    x = np.linspace(0.2, 0.8, len(names))
    expected = podium_of(base, dict(zip(names, variables.values(x), strict=True)))
    for found, leaf in zip(
        *(jax.tree.leaves(y.split_rows()) for y in (variables.podium(x), expected)), strict=True
    ):
        np.testing.assert_allclose(found, leaf, rtol=1e-14)
    with pytest.raises(ValueError, match=r"vary names 'positions'; dimensions that can vary are width, .*"):
        make_variables(base, {"positions": (0.9, 1.1)})


def test_grids_of_kilograms():
    """N m_c = 11 025 kg, so 260 t are the mass ratio 23.58."""
    base = optimise.Dimensions(**BUILDING)
    axes = {"story_mass_1": [220e3, 260e3], "scale": [1.0, 2.0, 3.0], "width": [0.7, 0.8]}
    grid = rj.grid(base, MOTION, **axes)
    top = grid.structures.superstructure
    np.testing.assert_allclose(np.ravel(top.masses[0]), [220e3 / 11025, 260e3 / 11025])
    assert [np.shape(y) for y in top.masses] == [(2, 1, 1), (), ()]
    assert np.shape(grid.structures.alpha) == (1, 1, 2)
    assert grid.shape == (2, 3, 2)
    assert grid.coords.attributes["story_mass_1"]["units"] == "kg"
    damped = rj.grid(base, MOTION, damping=[0.02, 0.03], gamma=[1.0, 2.0]).structures
    np.testing.assert_array_equal(damped.superstructure.damping, [[[0.02], [0.03]]] * 3)
    np.testing.assert_array_equal(damped.gamma, [[1.0, 2.0]])
    podium = base.podium()
    with pytest.raises(
        ValueError, match=r"story_mass_1 of a rockjax.Podium is the mass m/\(N m_c\) \[–\], .* 19.95"
    ):
        rj.grid(podium, MOTION, story_mass_1=[260e3])
    with pytest.raises(ValueError, match=r"story_stiffness_2 of a rockjax\.Podium is the stiffness"):
        rj.ensemble(podium, MOTION, spread={"story_stiffness_2": stats.norm(250e6, 1e6)}, n=3)
    with pytest.raises(ValueError, match="story_mass_1 must be finite and > 0"):
        rj.grid(base, MOTION, story_mass_1=[-1.0])
    with pytest.raises(ValueError, match="did you mean 'story_mass_1'"):
        rj.grid(base, MOTION, story_mas_1=[1.0])
    with pytest.raises(ValueError, match=r"must be at least the width of a column apart.* got 0\.5 m"):
        rj.grid(base, MOTION, width=[0.7, 0.8], position_2=[0.0, 5.5])
    with pytest.raises(ValueError, match=r"R must be finite and > 0"):
        rj.grid(base, MOTION, end_radius=[0.1, 1.6])
    with pytest.raises(ValueError, match="end_radius"):
        rj.grid(optimise.Dimensions(**SWAYING), MOTION, end_radius=[0.1])


def test_a_common_factor_multiplies_all_stories():
    """√f times stiffer stories have √f times higher frequencies."""
    podium = optimise.Dimensions(**BUILDING).podium()
    frequencies = podium.superstructure.frequencies
    by_path = rj.grid(podium, MOTION, **{"superstructure.stiffnesses": [0.81, 1.44]}).structures
    by_name = rj.grid(optimise.Dimensions(**BUILDING), MOTION, story_stiffnesses=[0.81, 1.44]).structures
    for structures in (by_path, by_name):
        found = structures.superstructure.frequencies
        np.testing.assert_allclose(found, [0.9 * frequencies, 1.2 * frequencies], rtol=1e-12)
    wider = rj.grid(podium, MOTION, **{"elevation.columns": [1.5], "position_1": [-8.0]}).structures
    np.testing.assert_allclose(np.ravel(wider.elevation.columns), [-12.0, 0.0, 9.0])


def test_a_factor_replaces_a_law_of_restitution():
    podium = rj.Podium(0.2, 1.5)
    grid = rj.grid(podium, MOTION, restitution=[0.8, 0.9], alpha=[0.2, 0.25])
    np.testing.assert_array_equal(grid.structures.restitution.e, [[0.8], [0.9]])
    with pytest.raises(ValueError, match=r"restitution must be in \[0, 1\]"):
        rj.grid(podium, MOTION, restitution=[1.2])
