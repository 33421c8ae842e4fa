"""All outputs with fast-forwards switched on and off, and user-defined outputs.

In the tests that are not slow, all fast-forwards and the certificate are off together, for three structures;
the slow tests switch them off in turn, for all structures."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._engine.flat import run
from rockjax._engine.scene import plan_for, prepare
from rockjax._engine.solve import answers
from rockjax._options import RESERVED
from rockjax._outputs.axial_force import Unloading
from rockjax._outputs.friction import FrictionUse
from rockjax._outputs.registry import REGISTRY, VARIABLES

FRAME = rj.Podium(alpha=0.15, R=1.5, gamma=10.0)
BUILDING = rj.ShearBuilding((3.0, 3.0, 2.0), (900.0, 700.0, 500.0), 0.04, 2)
STIFF = rj.ShearBuilding((3.0, 3.0, 2.0), (9e5, 7e5, 5e5), modes=0)
DEVICES = rj.Tendon(2.0, 20.0), rj.Damper(1.0), rj.Inerter(3.0)
COLUMNS = rj.Elevation((-3.0, 0.5, 3.0), 0.6, (3.2, 6.4, 9.6))
TWO = rj.Elevation((-3.0, 3.0), 0.6, 8.4)
COLUMNS_OFF_CENTRE = rj.Elevation((-3.0, -2.0, 0.0, 6.0), 0.6, 8.4)
AT_BOTTOM = rj.Tendon(2.0, 20.0, joints=1), rj.Damper(2.0, joints=1), rj.Inerter(6.0, joints=1)
PODIUMS = {
    "columns": FRAME,
    "rigid": FRAME.replace(superstructure=rj.Rigid(40.0), elevation=TWO),
    "rigid off centre": FRAME.replace(superstructure=rj.Rigid(40.0), elevation=COLUMNS_OFF_CENTRE),
    "elastic": FRAME.replace(superstructure=rj.Elastic(40.0, 0.4, 0.05), elevation=TWO),
    "modes": FRAME.replace(superstructure=rj.Modes((24.0, 6.0), (0.5, 0.15), (0.05, 0.03), 1.5)),
    "building": FRAME.replace(superstructure=BUILDING, elevation=COLUMNS),
    "round ends": rj.Podium.from_dimensions(
        0.45, 3.0, 1500.0, 3e3, end_radius=0.9, positions=(-3.0, 3.0), beam_depth=0.6
    ),
    "rigid with devices": FRAME.replace(
        superstructure=rj.Rigid(40.0), restrainers=(*DEVICES, *AT_BOTTOM), elevation=TWO
    ),
    "building with devices": FRAME.replace(superstructure=BUILDING, restrainers=AT_BOTTOM, elevation=COLUMNS),
}
OPTIONS = rj.Options(rtol=1e-10, atol=1e-12, outputs=tuple(REGISTRY))


def rough(seed: int, vertical: bool = False):
    """Return noise of a few samples with an offset and an interval of zeros in the middle."""
    rng = np.random.default_rng(seed)
    noise = np.convolve(rng.normal(size=308), np.hanning(9), "valid")
    noise[100:150] = 0.0
    record = rj.Record(2.4 * noise / np.abs(noise).max() + 0.1, 0.02)
    return rj.GroundMotion(record, record.scaled(0.5)) if vertical else record


def solved(podium: rj.Podium, motion, outputs, change=None):
    """Return the answers of a scene, and the plan of its program after `change`."""
    podium = podium.split_rows()
    options = OPTIONS.replace(outputs=outputs)
    plan = plan_for(podium, options, history=False, vertical=isinstance(motion, rj.GroundMotion))
    plan = plan if change is None else change(plan)

    def scene(podium, motion):
        ready, state = prepare(podium, motion, rj.State(), None, options, plan)
        return answers(ready, plan, run(ready, plan, state, options.max_steps))[0]

    return jax.jit(scene)(podium, motion), plan


def without(name: str, plan):
    """Return a plan without a fast-forward; if full contact is integrated, no samples are skipped."""
    gone = {name, "samples"} if name == "rest" else {name}
    return dataclasses.replace(plan, fast_forwards=tuple(y for y in plan.fast_forwards if y not in gone))


def to_the_end(plan):
    """Return a plan whose scenes are not ended by a certificate."""
    return dataclasses.replace(plan, to_the_end=True)


def outputs_of(podium: rj.Podium, joints: bool = False) -> tuple[str, ...]:
    # Numbers of impacts and "errors" need every bounce; without them, other outputs allow skipping. Forces in
    # the joints allow it without restrainers and vertical motion; friction at impacts always does.
    left_out = {"errors"} | {
        name for name, y in REGISTRY.items() if y.follows_impacts or y.of_joints != joints
    }
    return tuple(name for name, y in REGISTRY.items() if y.applies(podium) and name not in left_out)


def same(found, expected):
    for name in VARIABLES:
        if name in found:
            np.testing.assert_allclose(found[name], expected[name], rtol=2e-7, atol=1e-9, err_msg=name)


MOTIONS = {
    "Ricker": rj.Ricker(3.2, 1.0),
    "rough": rough(3),
    "rough and vertical": rough(4, vertical=True),
}
CASES = [
    (kind, motion)
    for kind in PODIUMS
    for motion in MOTIONS
    if "vertical" not in motion or kind in ("rigid", "building", "rigid with devices")
]
AT_IMPACTS = "impact_friction", "peak_velocity_jump"


@functools.cache
def usual(kind, motion, outputs):
    """Return the answers of a scene and the plan of its program."""
    return solved(PODIUMS[kind], MOTIONS[motion], outputs)


def with_every_trial(plan):
    """Return a plan without fast-forwards whose scenes are not ended by a certificate."""
    return dataclasses.replace(plan, fast_forwards=(), to_the_end=True)


@pytest.mark.slow(but=["rigid-rough-True", "building with devices-Ricker-False"])
@pytest.mark.parametrize(
    ("kind", "motion", "joints"),
    [
        ("rigid", "rough", False),
        ("rigid", "rough", True),
        ("rigid", "rough", None),
        ("rigid with devices", "rough and vertical", False),
        ("rigid with devices", "rough and vertical", True),
        ("rigid with devices", "rough and vertical", None),
        ("building with devices", "Ricker", False),
    ],
)
def test_no_answer_needs_every_trial(kind, motion, joints):
    """All fast-forwards and the certificate are switched off together. The outputs are those of the
    structure, of its joints, or of its impacts."""
    outputs = AT_IMPACTS if joints is None else outputs_of(PODIUMS[kind], joints)
    expected, _ = usual(kind, motion, outputs)
    same(solved(PODIUMS[kind], MOTIONS[motion], outputs, with_every_trial)[0], expected)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "motion"), CASES)
def test_no_fast_forward_changes_an_output(kind, motion):
    """Each fast-forward and the certificate are switched off in turn, with all outputs of the structure."""
    podium, shaking = PODIUMS[kind], MOTIONS[motion]
    for outputs in (outputs_of(podium), outputs_of(podium, joints=True), AT_IMPACTS):
        expected, plan = usual(kind, motion, outputs)
        changes = [functools.partial(without, name) for name in plan.fast_forwards]
        for change in (*changes, to_the_end):
            same(solved(podium, shaking, outputs, change)[0], expected)


@pytest.mark.slow(but=["unloading"])
@pytest.mark.parametrize("output", [Unloading(), FrictionUse(0.16)], ids=lambda output: output.name)
def test_no_margin_needs_every_trial(output):
    """The outputs of design targets are the same without all fast-forwards and the certificate."""
    expected, _ = usual("rigid", "rough", (output,))
    found, _ = solved(PODIUMS["rigid"], MOTIONS["rough"], (output,), with_every_trial)
    np.testing.assert_allclose(found[output.name], expected[output.name], rtol=2e-7, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rigid", "building with devices"])
@pytest.mark.parametrize("output", [Unloading(), FrictionUse(0.16)], ids=lambda output: output.name)
def test_no_fast_forward_changes_a_margin(kind, output):
    """The outputs of design targets are the same with and without each fast-forward."""
    podium, shaking = PODIUMS[kind], MOTIONS["rough"]
    expected, plan = usual(kind, "rough", (output,))
    for change in (*(functools.partial(without, name) for name in plan.fast_forwards), to_the_end):
        found = solved(podium, shaking, (output,), change)[0]
        np.testing.assert_allclose(found[output.name], expected[output.name], rtol=2e-7, atol=1e-9)


@pytest.mark.slow(but=["rigid-peak_rotation", "rigid-margin", "rigid-peak_velocity_jump"])
@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind in ("rigid", "elastic") for name in outputs_of(PODIUMS[kind])]
)
def test_an_output_does_not_depend_on_other_requested_outputs(kind, name):
    """The other requested outputs determine what is skipped and when the scene ends. The cases that are not
    slow are those of the three rules for the end."""
    expected, _ = usual(kind, "rough", outputs_of(PODIUMS[kind]))
    alone, _ = usual(kind, "rough", (name,))
    same({y.name: alone[y.name] for y in REGISTRY[name].variables}, expected)


def test_all_fast_forwards_are_allowed_by_all_outputs_of_rigid_podiums():
    plan = plan_for(
        PODIUMS["rigid"].split_rows(), OPTIONS.replace(outputs=("peak_rotation", "peak_shear")), False
    )
    assert plan.fast_forwards == ("rest", "bounces", "samples")
    building = FRAME.replace(superstructure=STIFF)
    assert plan_for(
        building.split_rows(), OPTIONS.replace(outputs=outputs_of(building)), False
    ).fast_forwards == (plan.fast_forwards)
    forces = OPTIONS.replace(outputs=outputs_of(PODIUMS["rigid"], joints=True))
    assert plan_for(PODIUMS["rigid"].split_rows(), forces, False).fast_forwards == plan.fast_forwards
    assert not plan_for(PODIUMS["rigid"].split_rows(), forces, False, vertical=True).fast_forwards
    assert not plan_for(PODIUMS["rigid with devices"].split_rows(), forces, False).fast_forwards


def test_floors_of_a_rigid_building_move_with_the_beam():
    building = FRAME.replace(superstructure=STIFF)
    alone, _ = solved(building, MOTIONS["rough"], ("peak_floor_acceleration",))
    beside, _ = solved(building, MOTIONS["rough"], ("peak_floor_acceleration", "peak_shear"))
    np.testing.assert_allclose(alone["peak_floor_acceleration"], beside["peak_floor_acceleration"], rtol=1e-9)
    np.testing.assert_allclose(alone["peak_floor_acceleration"], beside["peak_shear"] * building.g, rtol=1e-9)


# ------------------------------------------------------------------------------------- user-defined outputs
class PeakBeamSpeed(rj.AbstractOutput):
    """Largest horizontal speed of the beam relative to the ground."""

    name, unit, description = "peak_beam_speed", "m s-1", "peak speed of the beam"

    def quantity(self, moment):
        psi = moment.sigma * moment.c.alpha - moment.x[0]
        return moment.c.two_R * moment.v[0] * jnp.cos(psi)


class PeakVelocityJump(rj.AbstractOutput):
    """Largest jump of the beam's horizontal velocity at an impact; the quantity does not exist between
    impacts."""

    name, unit = "peak_jump", "m s-1"

    def quantity(self, moment):
        return jnp.zeros_like(moment.t)

    def at_impact(self, impact):
        return impact.c.two_R * impact.c.cos_alpha * jnp.abs(impact.v_after[0] - impact.v[0])


OWN = rj.Options(rtol=1e-10, atol=1e-12, outputs=("peak_rotation", PeakBeamSpeed(), PeakVelocityJump()))


class ScaledRotation(rj.AbstractOutput):
    """Largest rotation |θ| times a factor."""

    name = "scaled_rotation"

    def __init__(self, factor):
        self.factor = factor

    def quantity(self, moment):
        return self.factor * jnp.abs(moment.x[0])


def test_own_outputs_with_other_parameters_are_other_outputs():
    podium, motion = PODIUMS["rigid"], rj.Ricker(3.2, 1.0)
    solve = lambda output: rj.peak_response(podium, motion, options=rj.Options(outputs=(output,)))
    once, twice = (float(solve(ScaledRotation(factor)).scaled_rotation) for factor in (1.0, 2.0))
    assert twice == pytest.approx(2 * once, rel=1e-6) != 0
    assert ScaledRotation(1.0) == ScaledRotation(1.0) != ScaledRotation(2.0)
    assert len({ScaledRotation(1.0), ScaledRotation(1.0), ScaledRotation(2.0)}) == 2
    assert PeakBeamSpeed() == PeakBeamSpeed() != PeakVelocityJump()
    factors = np.ones(2)
    assert ScaledRotation(factors) != ScaledRotation(factors)  # arrays have no hash


def test_names_of_own_outputs_differ():
    """Of two answers with one name, one would be lost."""
    twice = rj.Options(outputs=(ScaledRotation(1.0), ScaledRotation(1.0)))
    assert len(twice.outputs) == 2
    with pytest.raises(ValueError, match="must differ, got 'scaled_rotation' from ScaledRotation and"):
        rj.Options(outputs=(ScaledRotation(1.0), ScaledRotation(2.0)))


@pytest.mark.parametrize("kind", ["rigid", "elastic"])
def test_own_outputs_of_one_scene(kind):
    """Comparison with a dense history; the jump is (1 − e) times the speed before the impact."""
    podium, motion = PODIUMS[kind], rj.Ricker(3.2, 1.0)
    peak = rj.peak_response(podium, motion, options=OWN)
    history = rj.simulate(podium, motion, options=OWN.replace(outputs=("peak_rotation",)))
    before_impacts = np.asarray(history.impact_times) - 1e-9
    t = np.concatenate([np.linspace(-2.0, float(history.stats.end_time), 100_001), before_impacts])
    state = history(t)
    psi = np.sign(state.theta) * float(podium.alpha) - np.asarray(state.theta)
    speed = np.abs(2 * float(podium.R) * np.asarray(state.theta_dot) * np.cos(psi))
    assert float(peak.peak_beam_speed) == pytest.approx(speed.max(), rel=1e-5)
    assert float(peak.peak_rotation) == pytest.approx(float(history.peak_rotation), rel=1e-8)
    before = np.abs(np.asarray(history(before_impacts).theta_dot))
    jump = 2 * float(podium.R * np.cos(podium.alpha)) * (1 - float(podium.restitution_factor)) * before.max()
    assert float(peak.peak_jump) == pytest.approx(jump, rel=1e-6)


@pytest.mark.parametrize("kind", ["rigid", pytest.param("elastic", marks=pytest.mark.slow)])
def test_own_outputs_have_derivatives(kind):
    """Forward and reverse derivatives and sensitivities of a batch agree with differences."""
    podium, motion = PODIUMS[kind], rj.Ricker(3.2, 1.0)

    def peaks(alpha):
        found = rj.peak_response(podium.replace(alpha=alpha), motion, options=OWN)
        return jnp.stack([found.peak_beam_speed, found.peak_jump])

    alpha, h = float(podium.alpha), 1e-4
    halved, complete = ((peaks(alpha + y) - peaks(alpha - y)) / (2 * y) for y in (h / 2, h))
    expected = np.asarray(4 * halved - complete) / 3  # Richardson extrapolation removes the error of order h²
    forward = np.asarray(jax.jacfwd(peaks)(alpha))
    np.testing.assert_allclose(forward, expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(jax.jacrev(peaks)(alpha), forward, rtol=1e-10)
    batch = rj.peak_responses(
        podium, rj.Ricker(np.array([3.2, 2.5]), 1.0), options=OWN, sensitivities=("alpha",)
    )
    assert float(batch.peak_beam_speed[0]) == pytest.approx(float(peaks(alpha)[0]), rel=1e-8)
    slopes = batch.sensitivities
    assert slopes is not None
    found = np.array([slopes.peak_beam_speed[0, 0], slopes.peak_jump[0, 0]])
    np.testing.assert_allclose(found, alpha * forward, rtol=1e-6)


def test_own_outputs_are_in_datasets():
    peaks = rj.peak_responses(PODIUMS["rigid"], rj.Ricker(np.linspace(1, 4, 5), 1.0), options=OWN)
    data = peaks.dataset()
    assert data.peak_beam_speed.attrs["units"] == "m s-1"
    np.testing.assert_array_equal(data.peak_jump, peaks.peak_jump)
    spectrum = rj.rocking_spectrum(PODIUMS["rigid"], rj.Ricker, [4.0, 8.0], [2.0, 3.0], options=OWN)
    assert spectrum.peak_beam_speed.shape == spectrum.peak_rotation.shape
    assert (spectrum.peak_beam_speed > 0).all()


@pytest.mark.parametrize(
    "name", ["peak_shear", "not a name", "least_axial_force", "uplift_time", "overturned", "end_time", "fall"]
)
def test_own_outputs_need_a_name_of_their_own(name):
    named = type("Named", (rj.AbstractOutput,), {"name": name, "quantity": lambda self, moment: moment.t})
    with pytest.raises(ValueError, match="identifier, and not the name of a built-in output"):
        rj.Options(outputs=("peak_rotation", named()))
    variables = (rj.Variable(name, "1", ""),)
    several = type("Several", (rj.AbstractOutput,), {"name": "own", "variables": variables})
    with pytest.raises(ValueError, match=f"answers must be .* got '{name}'"):
        rj.Options(outputs=("peak_rotation", several()))


def test_names_of_attributes_of_peaks_are_reserved():
    peak = rj.peak_response(PODIUMS["rigid"], rj.Ricker(3.2, 1.0), options=OWN)
    fields = {field.name for field in dataclasses.fields(peak)} | {*peak.dataset()}
    assert fields - {"peak_beam_speed", "peak_jump"} <= {*VARIABLES, *REGISTRY, *RESERVED}


def test_own_outputs_at_impacts_need_the_flat_engine():
    with pytest.raises(ValueError, match="'peak_jump' needs engine='flat', got 'segments'"):
        rj.Options(outputs=("peak_rotation", PeakVelocityJump()), engine="segments")
    rj.Options(outputs=("peak_rotation", PeakBeamSpeed()), engine="segments")


def test_unknown_outputs_are_refused():
    with pytest.raises(ValueError, match="one or more of"):
        rj.Options(outputs=("peak_rotatoin",))
    with pytest.raises(ValueError, match="one or more of"):
        rj.Options(outputs=(3,))
