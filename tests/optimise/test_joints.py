"""Targets on the joints: margins, derivatives through lift-off, and designs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import optimise
import rockjax as rj

TIGHT = rj.Options(rtol=1e-11, atol=1e-13)
HEIGHT = 9.0


def elevation(height=HEIGHT, distance=3.0, depth=0.6) -> rj.Elevation:
    return rj.Elevation([-distance, distance], beam_depth=depth, top_height=height)


PODIUM = rj.Podium(0.15, 1.5, 10.0, rj.Elastic(50.0, 0.5), elevation=elevation())
MOTIONS = [rj.Ricker(2.4, 1.0), rj.Ricker(1.8, 0.7)]
TARGETS = {
    "friction": optimise.PeakFriction(0.25, MOTIONS),
    "axial force": optimise.LeastAxialForce(0.1, MOTIONS),
    "foundation shear": optimise.PeakFoundationShear(0.16, MOTIONS),
}


def histories():
    """Return axial forces, shears and foundation shears along densely sampled histories."""
    for motion in MOTIONS:
        response = rj.simulate(PODIUM, motion, options=TIGHT)
        start, end = float(response.times[0]), float(response.stats.end_time)
        t = np.linspace(start, end, 200_001)
        left = np.asarray(response.times)[1 : int(response.nodes.used)]
        sides = [(t, False), (left, True)]
        forces = [response.joint_forces(time, left=side) for time, side in sides]
        shears = [response.foundation_shear(time, left=side) for time, side in sides]
        T, N = (
            np.concatenate([np.asarray(getattr(f, name)) for f in forces]) for name in ("horizontal", "axial")
        )
        yield T, N, np.concatenate([np.asarray(V) for V in shears])


def test_margins_are_those_of_histories():
    """Margins of both joints of both motions, one of which lifts off, from forces along histories."""
    load, expected = np.asarray(PODIUM.dead_load), {name: [] for name in TARGETS}
    for T, N, V in histories():
        expected["friction"].append(np.nanmin(0.25 * N - np.abs(T), axis=(0, 1)) / (0.25 * load))
        expected["axial force"].append(np.nanmin(N, axis=(0, 1)) / load - 0.1)
        expected["foundation shear"].append([(0.16 - np.nanmax(np.abs(V))) / 0.16])
    assert np.min(expected["axial force"]) < -0.1  # a joint is in tension
    for name, target in TARGETS.items():
        found = np.asarray(target.margins(PODIUM, TIGHT))
        np.testing.assert_allclose(found, np.concatenate(expected[name]), atol=2e-6)


def varied(name, value):
    if name in ("height", "distance", "depth"):
        return PODIUM.replace(elevation=elevation(**{name: value}))
    return PODIUM.replace(**{name: value})


START = {"height": HEIGHT, "distance": 3.0, "depth": 0.6, "alpha": 0.15, "gamma": 10.0}


@pytest.mark.slow
@pytest.mark.parametrize("name", START)
def test_derivatives_through_lift_off(name):
    """Forward and reverse derivatives of all margins against central differences. All targets read the same
    peaks."""
    at, targets = START[name], TARGETS.values()
    outputs = tuple(dict.fromkeys(output for target in targets for output in target.outputs))

    def margins(y):
        peaks = TARGETS["friction"].suite.responses(varied(name, y), TIGHT, outputs)
        return jnp.concatenate([target.read(peaks, TIGHT) for target in targets])

    h = 1e-5 * at
    expected = (np.asarray(margins(at + h)) - np.asarray(margins(at - h))) / (2 * h)
    assert expected.size == 10
    scale = 1e-6 * (1 + np.abs(expected))
    assert np.all(np.abs(np.asarray(jax.jacfwd(margins)(at)) - expected) <= 3 * scale)
    assert np.all(np.abs(np.asarray(jax.jacrev(margins)(at)) - expected) <= 3 * scale)


@pytest.mark.slow
def test_a_joint_without_dead_load_that_pulls():
    """A damper pulls a weightless beam off the columns. Without the damper, the beam carries no force."""
    motions, block = [rj.Ricker(6.5105, 0.7931)], rj.Podium(0.25, 1.2)
    pulled = block.replace(restrainers=(rj.Damper(4.0),))
    outputs = rj.Options(outputs=("axial_force", "peak_friction"))
    peak = rj.peak_response(pulled, motions[0], options=outputs)
    assert not bool(peak.joints_closed)
    least = float(np.asarray(peak.least_axial_force)[1])
    assert least < 0
    margins = np.asarray(optimise.LeastAxialForce(0.2, motions).margins(pulled, rj.Options()))
    assert margins[1] == pytest.approx(least - 0.2, rel=1e-6)
    assert np.asarray(optimise.PeakFriction(0.5, motions).margins(pulled, rj.Options()))[1] < 0
    for target in (optimise.LeastAxialForce(0.2, motions), optimise.PeakFriction(0.5, motions)):
        margin = np.asarray(target.margins(block, rj.Options()))[1]
        assert margin == (0.8 if isinstance(target, optimise.LeastAxialForce) else 1.0)


def test_bad_input():
    for share in (-0.1, 1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match=r"LeastAxialForce: at_least must be in \[0, 1\), got"):
            optimise.LeastAxialForce(share, MOTIONS)
    with pytest.raises(ValueError, match="PeakFriction: limit must be finite and > 0"):
        optimise.PeakFriction(0.0, MOTIONS)
    with pytest.raises(ValueError, match="peak_friction can be infinite, so it cannot be minimised"):
        optimise.WorstPeak("peak_friction", MOTIONS)


def test_friction_coefficient_inside_jit():
    """A target made outside jit works inside; a traced coefficient is refused with the cure."""
    target = TARGETS["friction"]
    inside = jax.jit(lambda podium: target.margins(podium, TIGHT))(PODIUM)
    np.testing.assert_allclose(inside, target.margins(PODIUM, TIGHT), rtol=0, atol=1e-9)
    margins = lambda limit: optimise.PeakFriction(limit, MOTIONS).margins(PODIUM, TIGHT)
    with pytest.raises(
        ValueError, match="limit must be a number, not a traced value; create the PeakFriction outside jit"
    ):
        jax.jit(margins)(0.25)


@pytest.mark.slow
def test_where_columns_overturn_margins_are_those_of_overturning():
    pulses = [rj.Ricker(20.0, 1.5)]
    overturned = float(
        rj.peak_response(PODIUM, pulses[0], options=rj.Options(outputs=("margin",), throw=False)).margin
    )
    assert overturned < 0
    for make in (optimise.PeakFriction, optimise.LeastAxialForce, optimise.PeakFoundationShear):
        assert np.all(np.asarray(make(0.5, pulses).margins(PODIUM, rj.Options(throw=False))) <= overturned)


# --------------------------------------------------------------------------------------------- studies
DRAWING = optimise.Dimensions(
    width=0.45, height=3.0, column_mass=3e3, beam_mass=60e3, top_mass=180e3, period=0.5,
    positions=(0.0, 6.0), beam_depth=0.6, top_height=HEIGHT,
)  # fmt: skip
SUITE = [rj.Ricker(2.4, 1.0), rj.Ricker(2.0, 0.7), rj.OneSine(1.8, 1.2)]
CLOSED = optimise.LeastAxialForce(0.0, SUITE)
HOW = rj.Options(rtol=1e-9, atol=1e-11)


def starts_agree(design: optimise.Design, digits: float = 1e-4):
    """Check that all converged starts have the same objective."""
    assert design.satisfied
    found = [start.objective for start in design.starts if start.satisfied]
    assert len(found) >= 8
    assert np.ptp(found) <= digits * abs(design.objective)


def keeps_joints_closed(design: optimise.Design) -> bool:
    """Return whether all joints of a design stay closed under the suite, also at impacts, where a force of
    zero up to the tolerance of the search is closed."""
    options = HOW.replace(outputs=("axial_force", "impact_friction"))
    peaks = [rj.peak_response(design.podium, motion, options=options) for motion in SUITE]
    least = min(float(np.min(np.asarray(peak.least_axial_force))) for peak in peaks)
    share = min(float(np.min(np.asarray(peak.least_impulse_share))) for peak in peaks)
    return least > -1e-4 and share >= 0


def least_force(drawing: optimise.Dimensions) -> float:
    """Return the least axial force of all joints under the suite [m_c g]."""
    options = TIGHT.replace(outputs=("axial_force",))
    peaks = [rj.peak_response(drawing.podium(), motion, options=options) for motion in SUITE]
    return min(float(np.min(np.asarray(peak.least_axial_force))) for peak in peaks)


@pytest.mark.slow
def test_least_spacing_that_keeps_joints_closed():
    """The result of ten starts agrees with a root of the margin that is found separately."""
    spacing = lambda podium: podium.elevation.columns[1] - podium.elevation.columns[0]
    design = optimise.design(
        DRAWING, {"position_2": (3.0, 20.0)}, spacing, [CLOSED], starts=10, options=HOW, progress=False
    )
    starts_agree(design)
    assert keeps_joints_closed(design)
    worst = lambda distance: least_force(DRAWING.replace(positions=(0.0, distance)))
    assert design.objective == pytest.approx(brentq(worst, 3.0, 20.0, xtol=1e-9), rel=1e-4)


@pytest.mark.slow
def test_tendons_do_not_close_joints_that_the_spacing_opens():
    """Neither a scan of forces nor a search from ten starts finds a sufficient force."""
    drawing = DRAWING.replace(positions=(0.0, 5.5), tendon_force=20e3, tendon_stiffness=2e6)
    forces = (1e3, 20e3, 60e3, 120e3, 200e3, 400e3)
    assert max(least_force(drawing.replace(tendon_force=force)) for force in forces) < 0
    design = optimise.design(
        drawing, {"tendon_force": (1e3, 400e3)}, lambda podium: podium.restrainers[0].prestress,
        [CLOSED], starts=10, options=HOW, progress=False,
    )  # fmt: skip
    assert not design.satisfied
    assert np.min(np.asarray(CLOSED.margins(design.podium, TIGHT))) < 0


@pytest.mark.slow
def test_width_for_a_number_of_columns():
    """In ten starts the rotation determines the width. A third column between the same outer ones changes the
    width by less than 0.1 %. New simulations confirm both designs; columns that are 1 % narrower fail."""
    rotation, widths = optimise.PeakRotation(0.4, SUITE), []
    for count in (2, 3):
        drawing = DRAWING.replace(positions=tuple(np.linspace(0.0, 14.0, count)), columns=count)
        design = optimise.design(
            drawing, {"width": (0.3, 0.9)}, lambda podium: podium.width, [rotation, CLOSED],
            starts=10, options=HOW, progress=False,
        )  # fmt: skip
        starts_agree(design)
        for target in (rotation, CLOSED):
            assert np.all(np.asarray(target.margins(design.podium, TIGHT)) >= -1e-5)
        narrower = drawing.replace(width=0.99 * design.objective).podium()
        margins = [np.asarray(target.margins(narrower, TIGHT)) for target in (rotation, CLOSED)]
        assert np.min(np.concatenate(margins)) < 0
        widths.append(design.objective)
    assert widths[0] == pytest.approx(widths[1], rel=1e-3)


@pytest.mark.slow
def test_columns_sized_with_and_without_the_joints():
    """With 7 m between the columns, the rotation determines the width. The joints stay closed, and a target
    on them changes nothing. New simulations confirm both designs."""
    rotation = optimise.PeakRotation(0.4, SUITE)
    with_joints, without = (
        optimise.design(
            DRAWING.replace(positions=(0.0, 7.0)), {"width": (0.3, 0.9)}, lambda podium: podium.width,
            targets, starts=10, options=HOW, progress=False,
        )
        for targets in ([rotation, CLOSED], [rotation])
    )  # fmt: skip
    assert with_joints.satisfied
    assert without.satisfied
    for design in (with_joints, without):
        assert np.all(np.asarray(rotation.margins(design.podium, TIGHT)) >= -1e-5)
        assert np.all(np.asarray(CLOSED.margins(design.podium, TIGHT)) > 0.05)
    assert with_joints.objective == pytest.approx(without.objective, rel=1e-4)
    narrower = DRAWING.replace(positions=(0.0, 7.0), width=0.99 * without.objective).podium()
    assert np.min(np.asarray(rotation.margins(narrower, TIGHT))) < 0


def peaks_of(drawing: optimise.Dimensions) -> np.ndarray:
    """Return the least axial force divided by the dead load, and the largest rotation [α] under the suite."""
    podium = drawing.podium()
    load = np.asarray(podium.dead_load)
    options = HOW.replace(outputs=("peak_rotation", "axial_force"))
    peaks = [rj.peak_response(podium, motion, options=options) for motion in SUITE]
    least = min(float(np.min(np.asarray(peak.least_axial_force) / load)) for peak in peaks)
    return np.array([least, max(float(peak.peak_rotation) for peak in peaks)])


@pytest.mark.slow
def test_wider_columns_do_not_close_joints_that_the_spacing_opens():
    """Wider columns rotate less, but a joint opens with each width at which the columns do not overturn."""
    drawing = DRAWING.replace(positions=(0.0, 5.5))
    found = np.array([peaks_of(drawing.replace(width=width)) for width in (0.45, 0.5, 0.7, 0.9)])
    assert np.all(found[:, 0] < 0)
    assert np.all(np.diff(found[:, 1]) < 0)
    assert found[0, 1] < 1


@pytest.mark.slow
def test_width_and_spacing_with_and_without_the_joints():
    """In ten starts the rotation determines the width, and the target on the joints the spacing, which
    otherwise is as small as allowed. With the same distance of the outer columns, three and five columns
    unload more."""
    rotation, bounds = optimise.PeakRotation(0.4, SUITE), {"width": (0.3, 0.9), "position_2": (4.0, 20.0)}
    size = lambda podium: podium.width + 0.01 * (podium.elevation.columns[1] - podium.elevation.columns[0])
    with_joints, without = (
        optimise.design(DRAWING, bounds, size, targets, starts=10, options=HOW, progress=False)
        for targets in ([rotation, CLOSED], [rotation])
    )
    spacings = [
        float(np.ptp(np.asarray(design.podium.elevation.columns))) for design in (with_joints, without)
    ]
    assert with_joints.satisfied
    assert without.satisfied
    assert keeps_joints_closed(with_joints)
    assert not keeps_joints_closed(without)
    assert spacings[1] == pytest.approx(4.0, abs=1e-6)
    assert spacings[0] > 5.0
    assert np.min(np.asarray(CLOSED.margins(with_joints.podium, TIGHT))) == pytest.approx(0.0, abs=1e-4)
    assert np.min(np.asarray(rotation.margins(with_joints.podium, TIGHT))) == pytest.approx(0.0, abs=1e-4)
    assert with_joints.objective > without.objective
    # ℓ_p of N columns at equal distances is (N+1)/(3(N−1)) of the half span.
    drawing = DRAWING.replace(width=float(with_joints.podium.width))
    least = [
        peaks_of(drawing.replace(positions=tuple(np.linspace(0.0, spacings[0], count)), columns=count))[0]
        for count in (2, 3, 5)
    ]
    assert least[0] == pytest.approx(0.0, abs=0.01)
    assert least[0] > least[1] > least[2]


def test_descriptions_of_targets_on_friction_state_the_given_limit():
    assert optimise.PeakFriction(0.25, MOTIONS).describe() == "friction demand ≤ 0.25"
    assert optimise.PeakLimit("peak_friction", 0.25, MOTIONS).describe() == "peak friction ≤ 0.25"
