"""Answers of the joints in batches, spectra, sweeps, datasets and error estimates, and their derivatives by
every number of the podium and of the motion."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import rockjax as rj

OUTPUTS = "peak_friction", "axial_force", "peak_foundation_shear", "impact_friction"
ANSWERS = (
    "peak_friction", "least_axial_force", "peak_axial_force", "peak_foundation_shear", "peak_impact_friction",
    "least_impulse_share",
)  # fmt: skip
OPTIONS = rj.Options(outputs=OUTPUTS)
PODIUM = rj.Podium(0.15, 1.5, 10.0, rj.Rigid(50.0), elevation=rj.Elevation([-3.0, 3.0], 0.6, 8.4))
PULSE = rj.Ricker(3.0, 1.0)


def assert_same(found, expected, rtol: float = 1e-9) -> None:
    """Compare all answers of the joints."""
    for name in ANSWERS:
        np.testing.assert_allclose(found[name], expected[name], rtol=rtol, atol=1e-12, err_msg=name)


def answers(peak: Any) -> dict[str, np.ndarray]:
    return {name: np.asarray(getattr(peak, name)) for name in ANSWERS}


def test_a_spectrum_and_a_batch_hold_the_answers_of_single_scenes():
    ratios = np.array([1.5, 3.0])
    data = rj.rocking_spectrum(PODIUM, rj.Ricker, np.array([4.0]), ratios, options=OPTIONS, progress=False)
    for k, ratio in enumerate(ratios):
        motion = rj.Ricker(
            ratio * float(PODIUM.uplift_ground_acceleration), 2 * np.pi / (4.0 * float(PODIUM.p))
        )
        single = answers(rj.peak_response(PODIUM, motion, options=OPTIONS))
        here = data.isel(acceleration_ratio=k, frequency_ratio=0)
        assert_same({name: here[name].values for name in ANSWERS}, single, rtol=1e-6)
        batch = rj.peak_responses(PODIUM, rj.Ricker([motion.a_p], motion.T_p), options=OPTIONS)
        assert_same({name: y[0] for name, y in answers(batch).items()}, single, rtol=1e-6)


@pytest.mark.slow
def test_a_sweep_stores_the_answers_of_a_batch(tmp_path):
    """Parameters of the sweep include positions and heights."""
    grid = rj.grid(PODIUM, PULSE, position_2=np.array([3.0, 4.5]), top_height=np.array([6.0, 8.4]))
    rj.sweep(*grid, store=tmp_path / "store", outputs=OUTPUTS, chunk=2, progress=False)
    data = xarray.open_zarr(tmp_path / "store", consolidated=False)
    expected = answers(rj.peak_responses(*grid[:2], options=OPTIONS))
    assert data["least_axial_force"].dims == ("position_2", "top_height", "joint")
    assert_same({name: data[name].values for name in ANSWERS}, expected)
    assert np.ptp(expected["least_axial_force"][..., 1]) > 1.0


def test_a_dataset_holds_the_forces_of_a_history():
    """The series of the dataset are the values of the methods, with the unit and a description."""
    response = rj.simulate(PODIUM, PULSE, options=OPTIONS)
    t = np.linspace(-1.0, 1.0, 9)
    data, forces = response.dataset(t), response.joint_forces(t)
    for name, values, dims, unit in (
        ("joint_shear", forces.horizontal, 3, "1"),
        ("joint_axial_force", forces.axial, 3, "1"),
        ("joint_friction", response.friction(t), 3, "1"),
        ("joint_eccentricity", response.eccentricity(t), 1, "1"),
        ("foundation_shear", response.foundation_shear(t), 1, "1"),
        ("foundation_reaction", response.foundation_reaction(t), 1, "1"),
        ("overturning_moment", response.overturning_moment(t), 1, "m"),
    ):
        assert data[name].dims == ("time", "column", "joint")[:dims]
        assert data[name].attrs["units"] == unit
        assert data[name].attrs["long_name"]
        np.testing.assert_array_equal(data[name], values, err_msg=name)
    assert data["joint"].values.tolist() == ["bottom", "top"]
    assert data["column"].values.tolist() == [1, 2]


def test_errors_of_the_answers_are_estimated():
    """The true error is within ten times the estimated one, which is small."""
    coarse = rj.Options(rtol=1e-6, atol=1e-8, outputs=("peak_rotation", *OUTPUTS, "errors"))
    tight = rj.Options(rtol=1e-11, atol=1e-13, outputs=OUTPUTS)
    peak: Any = rj.peak_response(PODIUM, PULSE, options=coarse)
    exact = answers(rj.peak_response(PODIUM, PULSE, options=tight))
    assert peak.errors is not None
    for name in ANSWERS:
        estimate = np.asarray(peak.errors.values[name])
        assert estimate.shape == exact[name].shape
        assert np.all(estimate >= 0)
        assert np.all(estimate < 1e-3 * np.abs(exact[name]))
        true = np.abs(np.asarray(getattr(peak, name)) - exact[name])
        assert np.all(true <= 10 * estimate + 1e-10), name


TIGHT = rj.Options(rtol=1e-12, atol=1e-14, outputs=OUTPUTS)
LEVELS = rj.Elevation([-4.0, -1.0, 6.0], 0.5, [8.0, -2.0], 5.0)
EVERYTHING = rj.Podium(
    0.15,
    1.5,
    10.0,
    rj.Modes((24.0, 6.0), (0.5, 0.15), (0.05, 0.03), 1.5),
    restitution=0.9,
    restrainers=(rj.Tendon(5.0, 60.0), rj.Damper(3.0, 0.7), rj.Inerter(2.0), rj.Tendon(1.0, 9.0, joints=1)),
    elevation=LEVELS,
)
OWN_HEIGHTS = rj.Podium(
    0.15,
    1.5,
    10.0,
    rj.ShearBuilding((3.0, 3.0, 2.0), (900.0, 700.0, 500.0), 0.04, 2, heights=(4.0, 3.0, 3.0)),
    elevation=rj.Elevation([-2.0, 2.0], 0.5),
)


def noise(n: int = 40) -> rj.Record:
    """Return a record of a few samples."""
    values = np.convolve(np.random.default_rng(2).normal(size=n + 8), np.hanning(9), "valid")
    return rj.Record(3.0 * values / np.abs(values).max(), 0.04)


@pytest.mark.slow
def test_sensitivities_to_positions_and_heights_by_name():
    """Derivatives by positions, depth and story heights are those of central differences."""
    names, step = ("positions", "beam_depth", "story_heights"), 1e-5
    factors = np.concatenate([np.ones((1, 3)), *(1 + y * step * np.eye(3) for y in (1, -1))])
    columns, depth, heights = factors.T[:, :, None]
    building = rj.ShearBuilding((30.0, 20.0), (9e3, 7e3), modes=0, heights=heights * np.array([4.0, 3.2]))
    elevation = rj.Elevation(columns * np.array([-3.0, 0.0, 4.5]), 0.6 * depth[:, 0])
    podiums = rj.Podium(0.15, 1.5, 10.0, building, elevation=elevation)
    options = rj.Options(rtol=1e-12, atol=1e-14, outputs=("axial_force",))
    peaks = rj.peak_responses(podiums, PULSE, options=options, sensitivities=names)
    for name in ("least_axial_force", "peak_axial_force"):
        peak = np.asarray(getattr(peaks, name))
        expected = np.moveaxis((peak[1:4] - peak[4:]) / (2 * step), 0, -1)
        size = np.abs(peak[0]).max()
        np.testing.assert_allclose(getattr(peaks.sensitivities, name)[0], expected, atol=1e-6 * size)
        assert np.abs(expected).min() > 1e-3 * size


SCENES = {
    "everything": (EVERYTHING, rj.Ricker(3.6, 0.9), 0.7),
    "own heights": (OWN_HEIGHTS, rj.Ricker(2.6, 0.9), 0.5),
    "record": (PODIUM, noise(), 1.4),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_derivatives_by_every_number(name):
    """Forward derivatives of all answers by all numbers of podium and motion, and reverse derivatives of the
    least axial force, against central differences of fourth order."""
    podium, motion, t_end = SCENES[name]
    parameters, static = eqx.partition((podium, motion), eqx.is_inexact_array_like)
    leaves, tree = jax.tree.flatten(parameters)
    sizes = [np.size(leaf) for leaf in leaves]
    y = np.concatenate([np.ravel(np.asarray(leaf, float)) for leaf in leaves])

    def values(y):
        parts = jnp.split(y, np.cumsum(sizes)[:-1])
        given = [part.reshape(np.shape(leaf)) for part, leaf in zip(parts, leaves, strict=True)]
        podium, motion = eqx.combine(jax.tree.unflatten(tree, given), static)
        peak = rj.peak_response(podium, motion, t_end=t_end, options=TIGHT)
        return jnp.concatenate([jnp.ravel(getattr(peak, answer)) for answer in ANSWERS])

    forward = np.asarray(jax.jit(jax.jacfwd(values))(y))
    function, h = jax.jit(values), 1e-4 * np.where(y == 0, 1.0, np.abs(y))
    shifts = np.diag(h)
    points = np.stack([y + k * row for k in (1, -1, 2, -2) for row in shifts])
    found = np.stack([np.asarray(function(point)) for point in points]).reshape(4, len(y), -1)
    expected = ((8 * (found[0] - found[1]) - (found[2] - found[3])) / (12 * h[:, None])).T
    size = np.where(y == 0, 1.0, np.abs(y))
    scale = np.max(np.abs(expected) * size, axis=1, keepdims=True) + 1e-9
    error = np.abs(forward - expected) * size / scale
    assert np.all(error <= 1e-5), error.max(axis=0)
    row = list(ANSWERS).index("least_axial_force") * 2 + 1  # the top joint
    reverse = np.asarray(jax.grad(lambda y: values(y)[row])(jnp.asarray(y)))
    np.testing.assert_allclose(reverse * size, forward[row] * size, rtol=0, atol=1e-9 * scale[row, 0])


def test_heights_have_no_effect_where_no_mass_has_them():
    """`residual_height` without a residual mass, and `top_height` without a superstructure."""
    alone = dataclasses.replace(PODIUM, superstructure=None)
    elevation: Any = PODIUM.elevation
    for podium, height in ((PODIUM, "residual_height"), (alone, "top_height")):
        taller = podium.replace(elevation=dataclasses.replace(elevation, **{height: 4.0}))
        arms: Any = taller.resolved().elevation
        expected: Any = podium.resolved().elevation
        assert float(arms.beam) == float(expected.beam)
        assert (arms.modes is None) == (expected.modes is None)
