"""Round column ends: the map (R5) against an independent integration of (R2) and the forces of (R4)."""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import optimise
import rockjax as rj
from optimise._variables import make_variables
from rockjax._parameters import variants
from rockjax._problem import models
from rockjax._problem.reading import Reader
from rockjax._structures.elevation import Arms

from .reference_round import RoundFrame, joint_extremes, peak_displacement, simulate
from .restrained import ricker
from .scenes import G

FACTS = {  # r_c/H: θ_o, u_b(θ_o), quarter period from θ = .12; computed to 40 digits and rounded
    0.5: (0.2935384595703356, 0.8836779060483668, 0.8598183656073165),
    0.8: (0.6471239202526718, 1.983972196268234, 0.7554683899391804),
}
COLUMNS: Any = {"width": 0.45, "height": 3.0, "column_mass": 1500.0, "beam_mass": 30e3}  # γ = 10
MODEL = rj.Options(rtol=1e-10, atol=1e-12)


def frame(share: float, alpha: float = 0.15, **more) -> RoundFrame:
    """Return a frame of R = 1.5 m whose radius is given as a fraction of H."""
    flat = RoundFrame(alpha=alpha, **more)
    return dataclasses.replace(flat, radius=share * flat.H)


def podium_of(real: RoundFrame, **more) -> rj.Podium:
    """Return the podium of a frame, from dimensions, with two columns of 1 t."""
    if real.eta:
        more |= {"top_mass": 2000 * real.eta, "period": real.T, "damping": real.zeta}
    return rj.Podium.from_dimensions(
        2 * real.B, 2 * real.H, 1000.0, 2000 * real.gamma, lam=real.lam, end_radius=real.radius, **more
    )


def beam_displacement(podium: rj.Podium, ratio) -> float:
    """Return u_b of the podium with flat ends at θ = ratio · α [m]."""
    alpha = float(podium.alpha)
    return 2 * float(podium.R) * (math.sin(alpha) - math.sin(alpha - float(ratio) * alpha))


@pytest.mark.parametrize("share", FACTS)
def test_the_reference_has_the_facts(share):
    """Facts 21 and 22: overturning angle, displacement and quarter period, the last also by time
    integration."""
    real = frame(share)
    limit, reach, quarter = FACTS[share]
    assert real.overturning == pytest.approx(limit, rel=2e-15)
    assert real.displacement(limit, 1) == pytest.approx(reach, rel=2e-15)
    assert real.arms(limit, 1)[1] == pytest.approx(0.0, abs=1e-15)
    assert real.quarter_period(0.12) == pytest.approx(quarter, rel=1e-14)
    falling = simulate(real, 1.5, lambda t: 0.0, theta=0.12)
    assert falling[0].t[-1] == pytest.approx(quarter, rel=1e-12)


def test_the_reference_conserves_energy_and_is_the_frame_with_flat_ends_without_radius():
    """Kinetic and potential energy of (R2) during one hop; comparison with an independent solver for r_c =
    0."""
    for eta in (0.0, 50.0):
        real = frame(0.6, eta=eta, T=0.5, zeta=0.0)
        hop = simulate(real, 0.3, lambda t: 0.0, theta=0.12)[0]
        theta, omega, u, rate = hop.y
        L, K = real.arms(theta, 1)
        inertia = real.lam * real.R**2 + (1 + 4 * real.gamma) * (L**2 + K**2) + 4 * eta * K**2
        energy = 0.5 * inertia * omega**2 + G * (real.gamma + eta + 0.5) * real.lift(theta, 1)
        stored = (2 * math.pi / real.T) ** 2 * (u - real.displacement(theta, 1)) ** 2
        energy = energy + 0.5 * eta * (rate**2 + stored)
        assert np.abs(energy / energy[0] - 1).max() < 1e-11
    flat, g = frame(0.0), ricker(3.0, 1.0)
    found = rj.peak_response(podium_of(flat), rj.Ricker(3.0, 1.0), t_end=2.0, options=MODEL)
    answer = peak_displacement(flat, simulate(flat, 2.0, g, -2.2))
    assert beam_displacement(podium_of(flat), found.peak_rotation) == pytest.approx(answer, rel=1e-7)


def test_the_map():
    real = frame(0.5)
    podium, flat = podium_of(real), podium_of(frame(0.0))
    assert float(podium.R) == pytest.approx(2 * 1.5, rel=1e-14)
    same = dataclasses.replace(podium, R=flat.R)
    assert all(np.array_equal(a, b) for a, b in zip(*map(jax.tree.leaves, (same, flat)), strict=True))
    radii = np.array([0.0, 0.5, 1.0])
    batch = rj.Podium.from_dimensions(**COLUMNS | {"end_radius": radii})
    size = float(rj.Podium.from_dimensions(**COLUMNS).R)
    assert np.allclose(batch.R, size * 1.5 / (1.5 - radii), rtol=1e-15)


def test_flat_ends_are_those_of_a_podium_without_a_radius_to_the_last_bit():
    given = COLUMNS | {"top_mass": 9e4, "period": 0.5, "positions": [-3.0, 3.0], "beam_depth": 0.6}
    without = jax.tree.leaves(rj.Podium.from_dimensions(**given))
    for radius in (0, 0.0, np.zeros(())):
        flat = jax.tree.leaves(rj.Podium.from_dimensions(**given | {"end_radius": radius}))
        assert all(np.array_equal(a, b) for a, b in zip(flat, without, strict=True))
    traced = jax.jit(lambda radius: rj.Podium.from_dimensions(**COLUMNS, end_radius=radius).R)(0.0)
    assert float(traced) == float(rj.Podium.from_dimensions(**COLUMNS).R)


SLENDER, STEEP = math.atan(0.15), 0.25
# α, r_c/H, amplitude divided by the uplift amplitude and period of a Ricker pulse; fraction by which u_b may
# be too small
PEAKS = [
    (SLENDER, 0.5, 1.5, 1.0, 0.0012),
    (SLENDER, 0.5, 2.5, 1.0, 0.0012),
    (SLENDER, 0.5, 3.0, 1.0, 0.004),
    (SLENDER, 0.5, 3.5, 1.0, 0.007),  # 0.64 of the displacement at overturning
    (SLENDER, 0.5, 1.5, 2.006, 0.0065),
    (SLENDER, 0.8, 1.5, 1.0, 0.002),
    (SLENDER, 0.8, 2.5, 1.0, 0.002),
    (SLENDER, 0.8, 3.5, 1.0, 0.007),
    (SLENDER, 0.8, 6.0, 1.0, 0.022),
    (SLENDER, 0.8, 1.5, 3.172, 0.034),
    (STEEP, 0.5, 2.5, 1.0, 0.003),
    (STEEP, 0.5, 3.0, 1.0, 0.011),
    (STEEP, 0.5, 4.0, 1.0, 0.04),  # 0.77
    (STEEP, 0.5, 1.5, 2.006, 0.015),
    (STEEP, 0.8, 2.5, 1.0, 0.005),
    (STEEP, 0.8, 7.0, 1.0, 0.031),
    (STEEP, 0.8, 1.5, 3.172, 0.072),
]


@pytest.mark.parametrize(("alpha", "share", "ratio", "T_p", "bound"), PEAKS)
def test_peak_displacements_are_those_of_round_ends(alpha, share, ratio, T_p, bound):
    """Errors of the peaks are within the values of docs/forces.md."""
    real, a_p = frame(share, alpha), ratio * G * math.tan(alpha)
    podium = podium_of(real)
    found: Any = rj.peak_response(podium, rj.Ricker(a_p, T_p), t_end=2 * T_p, options=MODEL)
    exact = peak_displacement(real, simulate(real, 2 * T_p, ricker(a_p, T_p), -2.2 * T_p))
    error = beam_displacement(podium, found.peak_rotation) / exact - 1
    assert -bound < error < 1e-4


@pytest.mark.parametrize(
    ("alpha", "share", "T_p", "falls", "excess"),
    [
        (SLENDER, 0.5, 1.0, 4.0374, 0.0128),
        (SLENDER, 0.8, 1.4, 4.6064, 0.146),
        (STEEP, 0.5, 1.0, 4.3735, 0.051),
        (STEEP, 0.8, 1.4, 4.5078, 0.707),
    ],
)
def test_overturning_takes_more_than_with_round_ends(alpha, share, T_p, falls, excess):
    """Errors of the overturning amplitude are within the values of docs/forces.md."""
    real = frame(share, alpha)
    unit = G * math.tan(alpha)
    for ratio, overturns in ((0.995 * falls, False), (1.005 * falls, True)):
        last = simulate(real, 2 * T_p, ricker(ratio * unit, T_p), -2.2 * T_p)[-1]
        assert (abs(last.y[0, -1]) > 0.999 * real.overturning) == overturns
    needed = falls * (1 + excess)
    for ratio, overturns in ((0.995 * needed, False), (1.005 * needed, True)):
        found: Any = rj.peak_response(
            podium_of(real), rj.Ricker(ratio * unit, T_p), t_end=2 * T_p, options=MODEL
        )
        assert bool(found.overturned) == overturns


LEVELS: Any = {"positions": [-3.0, 3.0], "beam_depth": 0.6, "top_height": 8.4}


@pytest.mark.parametrize(("share", "of_load", "relative"), [(0.5, 0.001, 0.0015), (0.8, 0.0025, 0.004)])
def test_forces_are_those_of_round_ends(share, of_load, relative):
    """Forces of (R4) along a scene with a building; errors are within the values of docs/forces.md."""
    more = {"eta": 50.0, "T": 0.5, "beam_height": 0.3, "top_height": 9.0}
    real = frame(share, SLENDER, **more)
    podium, a_p, T_p = podium_of(real, **LEVELS), 1.5 * G * 0.15, {0.5: 1.6, 0.8: 2.5}[share]
    options = MODEL.replace(outputs=("peak_rotation", "peak_friction", "axial_force"))
    found: Any = rj.peak_response(podium, rj.Ricker(a_p, T_p), t_end=2 * T_p, options=options)
    scene = simulate(real, 2 * T_p, ricker(a_p, T_p), -2.2 * T_p, max_step=2e-3)
    least, most, friction = joint_extremes(real, scene, ricker(a_p, T_p))
    load = np.asarray(podium.dead_load)
    assert np.abs(np.asarray(found.least_axial_force) - least).max() < of_load * load.max()
    assert np.abs(np.asarray(found.peak_axial_force) - most).max() < of_load * load.max()
    assert np.asarray(found.peak_friction) == pytest.approx(friction, rel=relative)
    assert np.all(least > 0)


LIGHT: Any = {"gamma": 1.0, "beam_height": 0.3}  # the weight of the columns matters
LIGHT_LEVELS: Any = {"positions": [-3.0, 3.0], "beam_depth": 0.6}


@pytest.mark.parametrize(("share", "of_load"), [(0.5, 0.001), (0.8, 0.0025)])
def test_forces_of_light_beams_are_those_of_round_ends(share, of_load):
    """Forces of (R4) along a scene; exact forces in full contact and exact impulses at impacts."""
    real = frame(share, SLENDER, **LIGHT)
    podium, a_p, T_p = podium_of(real, **LIGHT_LEVELS), 1.5 * G * 0.15, {0.5: 1.6, 0.8: 2.5}[share]
    options = MODEL.replace(outputs=("peak_rotation", "axial_force"))
    found: Any = rj.simulate(podium, rj.Ricker(a_p, T_p), t_end=2 * T_p, options=options)
    scene = simulate(real, 2 * T_p, ricker(a_p, T_p), -2.2 * T_p, max_step=2e-3)
    least, most, _ = joint_extremes(real, scene, ricker(a_p, T_p))
    load = np.asarray(podium.dead_load)
    assert np.abs(np.asarray(found.least_axial_force) - least).max() < of_load * load.max()
    assert np.abs(np.asarray(found.peak_axial_force) - most).max() < of_load * load.max()

    t = np.linspace(-2.2 * T_p, float(found.uplift_time) - 1e-6, 9)
    T, N = real.forces_in_contact([ricker(a_p, T_p)(y) for y in t])
    forces = found.joint_forces(t)
    np.testing.assert_allclose(np.moveaxis(forces.horizontal, 0, -1), T, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.moveaxis(forces.axial, 0, -1), N, rtol=0, atol=1e-12)

    time = np.asarray(found.impact_times)[:1]
    before = float(found(time - 1e-9).theta[0])
    rate = abs(float(found(time, left=True).theta_dot[0])) * real.H / (real.H - real.radius)
    expected = real.impulses(int(np.sign(before)), rate)
    np.testing.assert_allclose(found.impulses[0], expected, rtol=1e-9, atol=1e-12)


def test_heights_are_above_the_real_columns():
    """Heights of several modes and a residual mass are the same as with flat ends, also after the elevation
    is changed."""
    heights: Any = {"positions": [-3.0, 3.0], "beam_depth": 0.6}
    building: Any = {"story_masses": [1e4, 1e4], "story_stiffnesses": [2e6, 2e6], "modes": 1}
    for given in ({"top_height": [3.0, 6.0]}, {"story_heights": [3.0, 3.0]}):
        made = COLUMNS | building | heights | given
        podium, flat = (rj.Podium.from_dimensions(**made, end_radius=r).resolved() for r in (0.75, 0.0))
        arms, flat_arms = podium.elevation, flat.elevation
        assert isinstance(arms, Arms)
        assert isinstance(flat_arms, Arms)
        assert arms.modes is not None
        assert flat_arms.modes is not None
        assert float(arms.beam) == float(flat_arms.beam)
        assert np.array_equal(arms.modes, flat_arms.modes)
        assert arms.raised is not None
        assert float(arms.raised) == pytest.approx(1.5)  # half of the height, doubled
    podium = rj.Podium.from_dimensions(**COLUMNS, **heights, end_radius=0.75)
    deeper = variants.with_values(podium, {"beam_depth": 0.8})
    first, second = podium.resolved().elevation, deeper.resolved().elevation
    assert isinstance(first, Arms)
    assert isinstance(second, Arms)
    assert float(second.beam - first.beam) == pytest.approx(1.0)


def test_derivatives_by_the_radius():
    motion = rj.Ricker(3.5, 1.0)

    def sway(radius):
        podium = rj.Podium.from_dimensions(**COLUMNS, end_radius=radius)
        ratio = rj.peak_response(podium, motion, t_end=2.0, options=MODEL).peak_rotation
        return 2 * podium.R * (jnp.sin(podium.alpha) - jnp.sin((1 - ratio) * podium.alpha))

    h = 1e-4
    differences = (8 * (sway(0.6 + h) - sway(0.6 - h)) - (sway(0.6 + 2 * h) - sway(0.6 - 2 * h))) / (12 * h)
    assert float(jax.grad(sway)(0.6)) == pytest.approx(float(differences), rel=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"end_radius": 1.5},
            r"end_radius must be less than half the height, 1\.5 m .*never overturns.* 1\.5",
        ),
        ({"end_radius": [0.5, 1.6]}, r"end_radius must be less than half the height, 1\.5 m .*1\.6"),
        ({"end_radius": 1.0, "height": [3.0, 1.8]}, r"end_radius must be less than half the height, 0\.9 m"),
        ({"end_radius": -0.1}, r"end_radius must be finite and >= 0, got end_radius = -0\.1"),
        ({"end_radius": math.nan}, "end_radius must be finite"),
        ({"end_radius": "0"}, "end_radius must be a number"),
        ({"end_radius": None}, "end_radius must be a number"),
        ({"end_radius": 0.5, "tendon_force": 1e4}, r"end_radius excludes tendons.* 0\.5 and Tendon"),
        ({"end_radius": 0.5, "damper_coefficient": 1e4}, r"end_radius excludes .* and Damper"),
        ({"end_radius": 0.5, "inertance": 1e4}, r"end_radius excludes .* and Inerter"),
    ],
)
def test_bad_input(changes, message):
    with pytest.raises(ValueError, match=f"Podium.from_dimensions: {message}"):
        rj.Podium.from_dimensions(**COLUMNS | changes)


def test_round_ends_stretch_devices_more():
    """Opening of a joint at overturning, as stated in docs/forces.md for devices, to first order in α."""
    for share in (0.5, 0.8):
        real = frame(share, 1e-4)
        A = real.overturning
        across = real.radius * (A - math.sin(A)) + real.B * (1 - math.cos(A))
        up = real.B * math.sin(A) + real.radius * (1 - math.cos(A))
        flat = 2 * real.B * math.sin(A / 2)
        assert math.hypot(across, up) / flat - 1 == pytest.approx(share / (2 * (1 - share)), rel=1e-3)


def test_designs_and_problem_files():
    column = optimise.Dimensions(**COLUMNS, end_radius=0.75)
    variables = make_variables(column, {"end_radius": (0.1, 1.2), "width": (0.3, 0.6)})
    assert variables.units == ("m", "m")
    assert float(variables.podium(variables.start()).R) == pytest.approx(float(column.podium().R), rel=1e-12)
    with pytest.raises(ValueError, match=r"exceeds the admissible range: .* less than half the height"):
        make_variables(column, {"end_radius": (0.1, 1.6)})
    reader = Reader(None, {})
    given = reader.check(models.Problem, {"structure": COLUMNS | {"end_radius": 0.75}}).structure
    assert given is not None
    assert float(reader.structure(given).R) == float(column.podium().R)
    with pytest.raises(ValueError, match=r"structure\.end_radius"):
        reader.check(models.Problem, {"structure": COLUMNS | {"end_radius": -1.0}})
