"""Derivatives of batches, compared with those of single scenes."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._engine.scene import plan_for, prepare
from rockjax._engine.state import DIFFERENTIATED
from rockjax._engine.step import trial
from rockjax._outputs.registry import VARIABLES
from rockjax._parameters.variants import parameters_of, read
from rockjax._parameters.variants import with_values as variant
from rockjax._responses.sensitivities import check_sensitivities, with_unit_factors
from tests.scenes import PODIUMS, G, elastic, options, shaking

NAMES = ("alpha", "R", "gamma", "a_p", "T_p")
PEAKS = ("peak_rotation", "peak_deformation", "peak_shear")
SENSITIVE = [name for name, (variable, _) in VARIABLES.items() if variable.sensitive]
TIGHT_OPTIONS = options(1e-9, "dopri8", outputs=(*PEAKS, "margin"))
A_P = np.linspace(0.5, 4.5, 150) * G * 0.15
SOME = (1, 40, 70, 80, 95, 140)


def of_single_scene(podium, motion, names, how):
    """Return y ∂/∂y of the peaks of one scene, by `jax.jacfwd`."""

    def peaks(factors):
        found = rj.peak_response(*with_unit_factors(podium, motion, names, factors), options=how)
        return {name: getattr(found, name) for name in SENSITIVE}

    return jax.jacfwd(peaks)(jnp.ones(len(names)))


def compare(podium, rtol, landed):
    """Compare a batch with refilled lanes with single scenes; `landed`: peaks on which a step ends."""
    batch = rj.peak_responses(podium, rj.Ricker(A_P, 1.0), options=TIGHT_OPTIONS, sensitivities=NAMES)
    assert batch.sensitivities.parameters == NAMES
    assert batch.overturned.any()
    for k in SOME:
        single = of_single_scene(podium, rj.Ricker(A_P[k], 1.0), NAMES, TIGHT_OPTIONS)
        for peak in SENSITIVE:
            if single[peak] is None:  # only for several stories
                assert getattr(batch.sensitivities, peak) is None
                continue
            found, expected = getattr(batch.sensitivities, peak)[k], np.asarray(single[peak])
            allowed = rtol if peak in ("peak_rotation", "margin") else landed
            np.testing.assert_allclose(
                found, expected, rtol=0, atol=allowed * max(0.01, np.abs(expected).max())
            )
    largest = np.abs(batch.sensitivities.peak_rotation[~batch.overturned]).max()
    assert largest > 1
    assert np.abs(batch.sensitivities.peak_rotation[batch.overturned]).max() < 1e-12
    return batch


@pytest.mark.slow
def test_derivatives_of_a_batch_are_those_of_its_scenes():
    podium = PODIUMS["rigid"]
    batch = compare(podium, rtol=1e-12, landed=1e-9)
    plain = rj.peak_responses(podium, rj.Ricker(A_P, 1.0), options=TIGHT_OPTIONS)
    assert plain.sensitivities is None
    np.testing.assert_allclose(batch.peak_rotation, plain.peak_rotation, rtol=1e-11)
    data = batch.dataset()
    assert data["peak_shear_sensitivity"].dims == ("scene_0", "parameter")
    assert list(data["parameter"].values) == list(NAMES)
    # Both also agree with differences of values.
    step, how = 1e-6, TIGHT_OPTIONS.replace(rtol=1e-12, atol=1e-14)
    slopes = rj.peak_responses(podium, rj.Ricker(A_P, 1.0), options=how, sensitivities=NAMES).sensitivities
    up, down = (
        rj.peak_responses(variant(podium, {"R": float(podium.R) * (1 + s)}), rj.Ricker(A_P, 1.0), options=how)
        for s in (step, -step)
    )
    for peak in ("peak_rotation", "peak_shear", "margin"):
        expected = (getattr(up, peak) - getattr(down, peak)) / (2 * step)
        np.testing.assert_allclose(getattr(slopes, peak)[:90:5, 1], expected[:90:5], rtol=1e-4, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("T_s", [0.5, 0.1])
def test_derivatives_of_a_batch_of_elastic_scenes(T_s):
    # The difference is as large as the effect of a change in the last digit of the amplitude: dozens of
    # impacts amplify rounding, and steps end on a maximum of the vibration only within the tolerance.
    compare(elastic(T_s), rtol=1e-7, landed=1e-5)


@pytest.mark.slow
def test_records_and_their_scale():
    how = options(1e-9, "dopri8", outputs=("peak_rotation",))
    motions = [shaking(120, seed=k).scaled(0.7) for k in range(3)]
    batch = rj.peak_responses(PODIUMS["rigid"], motions, options=how, sensitivities=["alpha", "scale"])
    own = np.stack([motion.scale * motion.acceleration for motion in motions])
    each = rj.Record(own, 0.02)
    each = rj.peak_responses(PODIUMS["rigid"], each, options=how, sensitivities=["alpha", "dt"])
    assert not batch.overturned.all()
    for k, motion in enumerate(motions):
        single = of_single_scene(PODIUMS["rigid"], motion, ("alpha", "scale", "dt"), how)
        expected = np.asarray(single["peak_rotation"])
        np.testing.assert_allclose(batch.sensitivities.peak_rotation[k], expected[:2], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(
            each.sensitivities.peak_rotation[k], expected[[0, 2]], rtol=1e-9, atol=1e-12
        )


def test_a_scene_moves_with_its_parameters():
    """The derivative of a scene matches differences of variants, and the value stays bitwise identical."""
    podium, motion = PODIUMS["elastic"], rj.Gabor(0.4, 1.2, 3.0, 0.3)
    names = ("width", "T_s", "lam", "excitation.gamma", "scale")

    def leaves(factors):
        return jax.tree.leaves(with_unit_factors(podium, motion, names, factors))

    def changed(factors):
        values = {name: f * read(podium, name) for name, f in zip(names[:3], factors, strict=False)}
        shaken = dataclasses.replace(motion, gamma=factors[3] * motion.gamma).scaled(factors[4])
        return jax.tree.leaves((variant(podium, values), shaken))

    one = jnp.ones(len(names))
    for now, there in zip(leaves(one), jax.tree.leaves((podium, motion)), strict=True):
        assert now == there
    for slopes, expected in zip(jax.jacfwd(leaves)(one), jax.jacfwd(changed)(one), strict=True):
        np.testing.assert_allclose(slopes, expected, rtol=1e-14)


@pytest.mark.slow
def test_fields_without_derivatives_are_constant():
    """Derivatives are propagated for the fields in `DIFFERENTIATED`, so no other field may change a peak."""
    podium, motion = PODIUMS["elastic"], rj.Ricker(3.0, 1.0)
    plan = plan_for(podium, TIGHT_OPTIONS, history=False)

    def after(factor):
        scene, state = prepare(
            *with_unit_factors(podium, motion, ("T_s",), factor), rj.State(), None, TIGHT_OPTIONS, plan
        )
        return trial(scene, plan, trial(scene, plan, state)[0])[0]

    _, slopes = jax.jvp(after, (jnp.ones(1),), (jnp.ones(1),))
    reported = {"notes", "uplift_time", "overturn_time", "min_impact_speed", "min_impact_speed_before_peak"}
    for name in set(slopes._fields) - set(DIFFERENTIATED) - reported:
        for slope in jax.tree.leaves(getattr(slopes, name)):
            assert slope.dtype == jax.dtypes.float0 or slope == 0, name
    assert all(slopes.x[1:])


def test_invalid_parameters_are_rejected():
    for names, words in (
        (["weight"], "must each be one of"),
        (["T_s"], "must each be one of"),
        (["alpha", "alpha"], "each parameter once"),
        (["alpha", "width"], "at the same time"),
        ("alpha", "a list of strings"),
    ):
        with pytest.raises(ValueError, match=f"peak_responses: sensitivities .*{words}"):
            rj.peak_responses(PODIUMS["rigid"], rj.Ricker(A_P, 1.0), sensitivities=names)


MODES = rj.Modes([3.0, 1.0], [0.5, 0.1], [0.05, 0.02])
STRUCTURES = {
    "linear": {"restrainers": (rj.Damper(4.0),)},
    "linear from dimensions": {
        "restrainers": rj.Podium.from_dimensions(0.45, 3, 1500, 30e3, damper_coefficient=1e4).restrainers
    },
    "one joint": {"restrainers": (rj.Damper(4.0, 1, joints=1), rj.Tendon(1.0), rj.Inerter(0.0))},
    "power law": {"restrainers": (rj.Damper(4.0, 0.5),)},
    "array": {"restrainers": (rj.Damper(4.0, np.array(1.0)),)},
    "modes": {"superstructure": MODES},
    "one mode": {"superstructure": rj.Modes([3.0], [0.5])},
    "modes and more mass": {"superstructure": dataclasses.replace(MODES, residual=0.5)},
    "building": {"superstructure": rj.ShearBuilding.uniform(3, 5.0, 0.5, modes=2)},
    "given restitution": {"restitution": 0.9, "superstructure": rj.Rigid(0.0)},
}
FIXED = {
    "linear": "exponent",
    "linear from dimensions": "exponent",
    "one joint": "exponent",
    "modes": "residual",
    "one mode": "residual",
}


@pytest.mark.parametrize("name", STRUCTURES)
def test_a_listed_parameter_has_a_derivative_or_one_line_says_why_not(name):
    podium, motion = rj.Podium(0.15, 1.5, 10.0, **STRUCTURES[name]), rj.Ricker(3.0, 1.0)
    refused = {}
    for parameter in parameters_of(podium):
        try:
            check_sensitivities("here", podium, motion, [parameter])
        except ValueError as error:
            refused[parameter] = str(error)
            continue
        move = lambda factors, names=(parameter,): with_unit_factors(
            podium.split_rows(), motion, names, factors
        )
        _, slopes = jax.jvp(move, (jnp.ones(1),), (jnp.ones(1),))
        assert all(np.isfinite(slope).all() for slope in jax.tree.leaves(slopes))
    assert list(refused) == ([FIXED[name]] if name in FIXED else [])
    for parameter, words in refused.items():
        start = f"here: sensitivities contain '{parameter}', which is fixed at"
        assert re.fullmatch(
            rf"{start} \d in this podium before tracing and has no derivative; give .*", words
        )


@pytest.mark.parametrize(
    "call",
    [
        lambda podium, names: rj.peak_responses(podium, rj.Ricker([2.0, 3.0], 1.0), sensitivities=names),
        lambda podium, names: rj.overturning_spectrum(podium, rj.Ricker, [1.0], sensitivities=names),
        lambda podium, names: rj.rocking_spectrum(podium, rj.Ricker, [2.0], [1.0], sensitivities=names),
    ],
)
def test_a_fixed_parameter_is_refused_by_every_function(call):
    podium = rj.Podium(0.15, 1.5, 10.0, restrainers=(rj.Damper(4.0),))
    with pytest.raises(ValueError, match="'exponent', which is fixed at 1") as refused:
        call(podium, ["exponent"])
    assert len(str(refused.value)) < 200
