"""Superstructures of several modes, and buildings: exact statements, an independent integrator, derivatives,
bad input."""

import math
import tomllib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import rockjax as rj
from rockjax._parameters import variants
from rockjax._problem.models import ByRatios
from rockjax._problem.reading import Reader
from rockjax._responses.datasets import describe_podium, podium_of
from tests import restrained
from tests.restrained import Frame
from tests.scenes import operations_of_trial

S: dict[str, Any] = {"alpha": 0.15, "R": 1.5, "gamma": 10.0}
TIGHT_OPTIONS = rj.Options(rtol=1e-10, atol=1e-12)
BUILDING = rj.ShearBuilding(masses=(3.0, 3.0, 2.0), stiffnesses=(900.0, 700.0, 500.0))
TWO_MODES = rj.Modes((24.0, 6.0), (0.5, 0.15), (0.05, 0.03))
PULSE, T_P = 3.2, 0.8


def podium(top, *restrainers, **changes: Any) -> rj.Podium:
    return rj.Podium(**(S | changes), superstructure=top, restrainers=restrainers)


def frame_of(modes: rj.Modes, shapes=(), **changes) -> Frame:
    """Return the frame for the independent integrator."""
    zeta = np.broadcast_to(modes.zeta, modes.eta.shape)
    rows = tuple(tuple(map(float, mode)) for mode in zip(modes.eta, modes.T, zeta, strict=True))
    shapes = tuple(tuple(map(float, floor)) for floor in shapes)
    return Frame(modes=rows, residual=float(modes.residual), shapes=shapes, **changes)


def independent(frame: Frame, a_p=PULSE, T_p=T_P, vertical=0.0, end=1.6) -> restrained.Answer:
    motion = restrained.one_sine(a_p, T_p)
    return restrained.simulate(frame, end, motion, lambda t: vertical * motion(t), breaks=(T_p,))


# Closed forms


def test_modes_of_a_building():
    np.testing.assert_allclose(
        BUILDING.frequencies, [7.896410779362220, 19.42901022285029, 27.26707890290569], rtol=4e-15
    )
    np.testing.assert_allclose(
        BUILDING.modes.eta, [7.017884164530126, 0.7316389491433886, 0.2504768863264851], rtol=4e-15
    )
    np.testing.assert_allclose(
        BUILDING.shapes[:, 0], [0.4862091767870631, 0.9814063402971900, 1.307518806638683], rtol=4e-15
    )
    np.testing.assert_allclose(BUILDING.shapes.sum(axis=-1), 1.0, rtol=1e-14)
    np.testing.assert_allclose(BUILDING.modes.T, 2 * math.pi / BUILDING.frequencies)


def test_modes_of_a_uniform_building():
    n, mass, stiffness = 7, 2.0, 800.0
    building = rj.ShearBuilding([mass] * n, [stiffness] * n)
    i = np.arange(1, n + 1)
    exact = 2 * math.sqrt(stiffness / mass) * np.sin((2 * i - 1) * math.pi / (4 * n + 2))
    np.testing.assert_allclose(building.frequencies, exact, rtol=1e-13)
    shares = rj.ShearBuilding([1.0, 1.0], [5.0, 5.0]).modes.eta / 2
    np.testing.assert_allclose(shares, [0.9472135954999579, 0.05278640450004206], rtol=1e-14)
    made = rj.ShearBuilding.uniform(n, eta=n * mass, T=2 * math.pi / exact[0], height=3.0)
    np.testing.assert_allclose(made.masses, mass, rtol=1e-14)
    np.testing.assert_allclose(made.stiffnesses, stiffness, rtol=1e-13)


def test_frequencies_on_lifted_columns():
    with_tendons = podium(TWO_MODES, rj.Tendon(0.0, 200.0))
    np.testing.assert_allclose(
        with_tendons.uplifted_frequencies,
        [0.8497020432078319, 18.98264872574874, 53.16244379694630],
        rtol=1e-12,
    )
    one = podium(rj.Modes([30.0], [0.5]), rj.Inerter(8.0))
    np.testing.assert_allclose(one.uplifted_frequency, 23.91900220170046, rtol=1e-14)
    assert one.uplifted_frequencies[0] == 0
    stiff = podium(rj.Modes([30.0], [0.5]), rj.Inerter(8.0), rj.Tendon(0.0, 200.0))
    np.testing.assert_allclose(
        stiff.uplifted_frequencies, [0.8475826926652488, 23.95853960689648], rtol=1e-12
    )


@pytest.mark.parametrize(
    "top", [TWO_MODES, rj.Modes([24.0, 0.0], [0.5, 0.15]), rj.Modes([20.0, 10.0], [0.5, 0.5]), BUILDING]
)
def test_the_largest_frequency_on_lifted_columns_alone(top):
    """It is the largest eigenvalue, also for equal modes and modes without mass."""
    for devices in ((), (rj.Tendon(1.0, 50.0), rj.Inerter(3.0))):
        structure = podium(top, *devices)
        found, expected = structure.fastest_frequency(), structure.uplifted_frequency
        assert float(found) == pytest.approx(float(expected), rel=1e-14)


def test_omitted_modes_move_with_the_beam():
    retained = rj.ShearBuilding(BUILDING.masses, BUILDING.stiffnesses, modes=1)
    assert retained.modes.residual == pytest.approx(float(BUILDING.modes.eta[1:].sum()), rel=1e-14)
    assert float(podium(retained).eta) == pytest.approx(8.0)
    paper, complete = (podium(top).restitution_factor for top in (retained, BUILDING))
    assert float(paper) == pytest.approx(float(complete), rel=1e-15)
    compatible = [podium(top, restitution="compatible").restitution_factor for top in (retained, BUILDING)]
    assert float(compatible[0]) > float(compatible[1])
    none = podium(rj.ShearBuilding(BUILDING.masses, BUILDING.stiffnesses, modes=0))
    rigid = podium(rj.Rigid(8.0))
    pulse = rj.OneSine(2.5, 0.8)
    a: Any = rj.peak_response(none, pulse)
    b = rj.peak_response(rigid, pulse)
    assert float(a.peak_rotation) == float(b.peak_rotation)
    np.testing.assert_array_equal(a.peak_drift, 0.0)
    np.testing.assert_allclose(a.peak_floor_acceleration, float(b.peak_shear) * 9.80665, rtol=1e-15)


# One mode, equal modes, modes without mass


@pytest.mark.slow
def test_one_mode_is_an_elastic_superstructure_to_the_last_bit():
    pulses = rj.OneSine(np.linspace(2.0, 5.0, 40), 0.8)
    one, elastic = podium(rj.Modes([30.0], [0.5], 0.04)), podium(rj.Elastic(30.0, 0.5, 0.04))
    for a, b in (
        (rj.peak_responses(one, pulses), rj.peak_responses(elastic, pulses)),
        (rj.peak_response(one, rj.OneSine(3.0, 0.8)), rj.peak_response(elastic, rj.OneSine(3.0, 0.8))),
    ):
        np.testing.assert_array_equal(a.peak_rotation, b.peak_rotation)
        np.testing.assert_array_equal(a.peak_shear, b.peak_shear)
        np.testing.assert_array_equal(a.stats.steps, b.stats.steps)
        np.testing.assert_array_equal(np.asarray(a.peak_deformation)[..., 0], b.peak_deformation)
        assert np.shape(a.peak_deformation) == (*np.shape(b.peak_deformation), 1)


def check_same(found: rj.Peak, complete: rj.Peak) -> None:
    """Check that rotation and shear are equal."""
    assert float(found.peak_rotation) == pytest.approx(float(complete.peak_rotation), abs=1e-9)
    assert float(found.peak_shear) == pytest.approx(float(complete.peak_shear), abs=1e-9)


def tight(top, a_p=PULSE) -> Any:
    return rj.peak_response(podium(top), rj.OneSine(a_p, T_P), t_end=20.0, options=TIGHT_OPTIONS)


def test_modes_of_one_period_are_one_mode():
    complete, parts = tight(rj.Elastic(30.0, 0.5)), tight(rj.Modes((20.0, 10.0), (0.5, 0.5)))
    check_same(parts, complete)
    np.testing.assert_allclose(parts.peak_deformation, complete.peak_deformation, atol=1e-10)


def test_a_mode_without_mass_changes_nothing():
    complete, top = tight(rj.Elastic(30.0, 0.5)), rj.Modes((0.0, 30.0), (0.2, 0.5))
    more = tight(top)
    check_same(more, complete)
    assert float(more.peak_deformation[1]) == pytest.approx(float(complete.peak_deformation), abs=1e-10)
    # At rest each mode vibrates independently, and the bound of its deformation does not depend on its mass.
    assert tight(top, 2.0).result == rj.RESULTS.settled
    none = tight(rj.Modes((0.0, 0.0), (0.2, 0.5)))
    assert np.isfinite(none.peak_shear)
    assert np.all(np.isfinite(none.peak_deformation))


def test_frequencies_of_equal_modes():
    """Twenty modes, of which three have one period and one has no mass: frequencies agree with the
    eigenvalues of the linear equations, and derivatives are finite."""
    T = np.linspace(1.2, 0.1, 20)
    eta = np.linspace(6.0, 0.3, 20)
    T[5:8], eta[11] = 0.7, 0.0
    devices = rj.Tendon(1.0, 60.0), rj.Inerter(3.0)
    found = podium(rj.Modes(eta, T), *devices)
    # q = (u_b, deformations): T and V are quadratic forms; ½(1+λ+4γ+4μ sin²α)R²θ̇², u_b = 2R cos α θ.
    sin, cos, p2 = math.sin(0.15), math.cos(0.15), 0.75 * 9.80665 / 1.5
    spin = (4 / 3 + 40 + 4 * 3.0 * sin**2 + 4 * eta.sum() * sin**2) / (4 * cos**2)
    mass = np.zeros((21, 21))
    mass[0, 0] = spin + eta.sum()
    mass[0, 1:] = mass[1:, 0] = eta
    mass[1:, 1:] = np.diag(np.where(eta > 0, eta, 1.0))  # without mass: a separate mode
    stiff = np.diag(np.r_[4 * p2 / 3 * 60.0 * sin**2 / cos**2, np.diag(mass)[1:] * (2 * math.pi / T) ** 2])
    expected = np.sqrt(scipy.linalg.eigh(stiff, mass, eigvals_only=True))
    np.testing.assert_allclose(found.uplifted_frequencies, expected, rtol=1e-11)
    assert float(found.fastest_frequency()) == pytest.approx(expected[-1], rel=1e-12)
    # For equal and different modes, and from zero mass: compare with differences along some directions.
    for rotating in (0, 1, -1):  # simple roots
        frequency = lambda eta, T, k=rotating: podium(rj.Modes(eta, T), *devices).uplifted_frequencies[k]
        slopes = jax.grad(frequency, (0, 1))(jnp.asarray(eta), jnp.asarray(T))
        for k in (0, 6, 11):
            y = np.eye(20)[k]
            up = [float(frequency(eta + h * y, T)) for h in (0.0, 1e-3, 2e-3)]
            assert float(slopes[0][k]) == pytest.approx((4 * up[1] - 3 * up[0] - up[2]) / 2e-3, abs=1e-6)
            down, above = (float(frequency(eta, T + h * y)) for h in (-1e-5, 1e-5))
            assert float(slopes[1][k]) == pytest.approx((above - down) / 2e-5, rel=1e-5, abs=1e-6)


@pytest.mark.slow
def test_derivatives_of_equal_modes():
    """For two modes of one period only the sum of the masses matters; the period of a mode without mass has
    no effect."""
    pulse = rj.OneSine(PULSE, T_P)

    def peak(y):
        structure = podium(rj.Modes(y[:2], y[2:]))
        return rj.peak_response(structure, pulse, t_end=1.6, options=TIGHT_OPTIONS).peak_rotation

    slope = jax.jit(jax.grad(peak))
    both = slope(jnp.array([20.0, 10.0, 0.5, 0.5]))
    alone = slope(jnp.array([0.0, 30.0, 0.5, 0.5]))
    assert float(both[0]) == pytest.approx(float(both[1]), rel=1e-7)
    assert float(both[2]) == pytest.approx(2 * float(both[3]), rel=1e-7)
    assert float(alone[2]) == 0
    assert float(alone[3]) == pytest.approx(float(both[2] + both[3]), rel=1e-7)
    np.testing.assert_allclose(alone[:2], float(both[0]), rtol=1e-7)


# An independent integrator


def check(found, answer, several=1e-8) -> None:
    assert 0.1 < answer.peak < 0.95
    assert abs(float(found.peak_rotation) - answer.peak) <= 1e-8
    assert abs(float(found.uplift_time) - answer.uplift_time) <= 1e-10
    np.testing.assert_allclose(found.peak_deformation, answer.deformations, rtol=0, atol=1e-9)
    assert abs(float(found.peak_shear) - answer.shear) <= several
    if found.peak_drift is not None:
        np.testing.assert_allclose(found.peak_drift, answer.drifts, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.peak_floor_acceleration, answer.floors, rtol=0, atol=10 * several)


def test_peaks_of_two_modes_with_tendon_damper_and_vertical_motion():
    structure = podium(TWO_MODES, rj.Tendon(5.0, 60.0), rj.Damper(3.0))
    motion = rj.GroundMotion(rj.OneSine(2.8, T_P), rj.OneSine(0.4 * 2.8, T_P))
    found = rj.peak_response(structure, motion, t_end=1.6, options=TIGHT_OPTIONS)
    check(found, independent(frame_of(TWO_MODES, tau=5.0, kappa=60.0, delta=3.0), 2.8, vertical=0.4))


@pytest.mark.slow(but=["2"])
@pytest.mark.parametrize("modes", [None, 2])
def test_peaks_of_a_building(modes):
    building = rj.ShearBuilding(BUILDING.masses, BUILDING.stiffnesses, 0.04, modes)
    found = rj.peak_response(podium(building), rj.OneSine(2.2, T_P), t_end=1.6, options=TIGHT_OPTIONS)
    check(found, independent(frame_of(building.modes, building.shapes), 2.2))


# Derivatives


def derivative(frame_at, h, **motion) -> float:
    """Return the derivative of the independent peak rotation, from central differences of two widths."""
    slope = lambda h: (
        (independent(frame_at(h), **motion).peak - independent(frame_at(-h), **motion).peak) / (2 * h)
    )
    return (4 * slope(h) - slope(2 * h)) / 3


@pytest.mark.slow
def test_derivatives_with_respect_to_every_number_of_modes():
    """Forward and reverse derivatives agree with differences of the independent integrator."""
    pulse = rj.OneSine(2.8, T_P)
    y = jnp.array([24.0, 6.0, 0.5, 0.15, 0.05, 0.03, 1.5])

    def peak(y):
        modes = rj.Modes(y[:2], y[2:4], y[4:6], y[6])
        return rj.peak_response(podium(modes), pulse, t_end=1.6, options=TIGHT_OPTIONS).peak_rotation

    forward, reverse = jax.jacfwd(peak)(y), jax.grad(peak)(y)
    np.testing.assert_allclose(forward, reverse, rtol=1e-12)
    for k, size in enumerate(y):

        def perturbed_frame(h, k=k):
            z = np.asarray(y).copy()
            z[k] += h
            return Frame(modes=((z[0], z[2], z[4]), (z[1], z[3], z[5])), residual=z[6])

        exact = derivative(perturbed_frame, 2e-4 * float(size), a_p=2.8, end=1.6)
        assert abs(float(forward[k]) - exact) * float(size) < 1e-6, k


@pytest.mark.slow
def test_derivatives_with_respect_to_masses_and_stiffnesses():
    pulse, masses, stiffnesses = (
        rj.OneSine(2.2, T_P),
        np.array([3.0, 3.0, 2.0]),
        np.array([900.0, 700.0, 500.0]),
    )
    y = jnp.asarray(np.concatenate([masses, stiffnesses]))

    def answers(y):
        building = rj.ShearBuilding(y[:3], y[3:], modes=2)
        found: Any = rj.peak_response(podium(building), pulse, t_end=1.6, options=TIGHT_OPTIONS)
        return jnp.append(found.peak_drift, found.peak_rotation)

    forward, reverse = jax.jacfwd(answers)(y), jax.jacrev(answers)(y)
    np.testing.assert_allclose(forward, reverse, rtol=1e-10, atol=1e-12)

    def perturbed_building(h):
        building = rj.ShearBuilding(masses * (1 + h * np.arange(3)), stiffnesses * (1 - h), modes=2)
        answer = independent(frame_of(building.modes, building.shapes), 2.2)
        return np.append(answer.drifts, answer.peak)

    slope = lambda h: (perturbed_building(h) - perturbed_building(-h)) / (2 * h)
    exact = (4 * slope(1e-4) - slope(2e-4)) / 3
    direction = np.concatenate([masses * np.arange(3), -stiffnesses])
    np.testing.assert_allclose(forward @ direction, exact, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_size_and_time_scale():
    """Fact 22, for all parts: 2R ∂_R + Σ T_i ∂_{T_i} + T_p ∂_{T_p} + T_v ∂_{T_v} of the peak is 0."""

    def peak(R, T, T_p, T_v):
        structure = podium(rj.Modes((24.0, 6.0), T), rj.Tendon(5.0, 60.0), rj.Damper(3.0), R=R)
        motion = rj.GroundMotion(rj.OneSine(2.8, T_p), rj.OneSine(1.1, T_v))
        return rj.peak_response(structure, motion, options=TIGHT_OPTIONS).peak_rotation

    perturbed_frame = (1.5, jnp.array([0.5, 0.15]), T_P, 0.5)
    by_R, *by_times = jax.grad(peak, (0, 1, 2, 3))(*perturbed_frame)
    terms = [
        2 * 1.5 * float(by_R),
        *(float(jnp.sum(y * by)) for y, by in zip(perturbed_frame[1:], by_times, strict=True)),
    ]
    assert min(map(abs, terms)) > 1e-4
    assert sum(terms) == pytest.approx(0, abs=1e-7 * max(map(abs, terms)))


# All functions


@pytest.mark.slow
def test_batches_histories_and_segments_agree():
    structure = podium(BUILDING)
    pulses = rj.OneSine(np.linspace(1.5, 3.0, 70), T_P)
    peaks: Any = rj.peak_responses(structure, pulses)
    assert peaks.peak_drift.shape == peaks.peak_deformation.shape == (70, 3)
    k = 40
    pulse = rj.OneSine(float(pulses.a_p[k]), T_P)
    one: Any = rj.peak_response(structure, pulse)
    history = rj.simulate(structure, pulse)
    segments = rj.peak_response(structure, pulse, options=rj.Options(engine="segments", method="tsit5"))
    for found in (one, history, segments):
        loose = 1e-6 if found is segments else 1e-9
        for name in (
            "peak_rotation",
            "peak_deformation",
            "peak_shear",
            "peak_drift",
            "peak_floor_acceleration",
        ):
            expected = np.asarray(getattr(peaks, name))[k]
            np.testing.assert_allclose(getattr(found, name), expected, rtol=loose, atol=loose)
    t = np.linspace(0.0, float(one.stats.end_time), 20_001)
    np.testing.assert_allclose(np.abs(history.drift(t)).max(axis=0), one.peak_drift, rtol=1e-4)
    np.testing.assert_allclose(
        np.abs(history.floor_acceleration(t)).max(axis=0), one.peak_floor_acceleration, rtol=1e-3
    )
    assert float(np.abs(history.base_shear(t)).max()) == pytest.approx(float(one.peak_shear), rel=1e-3)
    assert float(jnp.abs(history.energies(t[-1]).residual)) < 1e-8
    data = history.dataset(t[:50])
    assert data["drift"].dims == ("time", "story")
    assert data["deformation"].dims == ("time", "vibration_mode")


@pytest.mark.slow
def test_twenty_stories():
    """All modes, and the lowest two, also in batches."""
    for modes in (None, 2):
        building = rj.ShearBuilding.uniform(20, eta=30.0, T=1.2, modes=modes)
        found = rj.peak_response(podium(building), rj.OneSine(2.5, T_P), t_end=1.6, options=TIGHT_OPTIONS)
        check(found, independent(frame_of(building.modes, building.shapes), 2.5))


def test_cost_of_a_mode():
    """Modes are rows of arrays, so their number changes only the lengths in the program."""
    of_trial = lambda top: operations_of_trial(podium(top), rj.OneSine(3.0, 1.0), rj.Options())
    one = of_trial(rj.Elastic(30.0, 0.5))
    assert of_trial(rj.Modes([30.0], [0.5])) == one
    of_many = [of_trial(rj.Modes([30.0 / n] * n, np.linspace(0.6, 0.1, n))) for n in (2, 20)]
    assert of_many[0] == of_many[1] < 1.05 * one


def test_parameters_by_name():
    structure = podium(rj.ShearBuilding(BUILDING.masses, BUILDING.stiffnesses, 0.04, 2))
    assert {"story_mass_3", "story_stiffness_1", "story_damping"} <= set(variants.parameters_of(structure))
    changed: Any = variants.with_values(structure, {"story_mass_2": 9.0}).superstructure
    np.testing.assert_array_equal(changed.masses, [3.0, 9.0, 2.0])
    assert float(variants.read(structure, "story_stiffness_3")) == 500.0
    modes = podium(rj.Modes([6.0, 2.0], [0.5, 0.2], [0.05, 0.03], residual=0.5))
    assert {"eta_1", "T_2", "zeta_2", "residual"} <= set(variants.parameters_of(modes))
    with pytest.raises(ValueError, match="story_mass_4"):
        variants.read(structure, "story_mass_4")
    for each in (structure, modes):
        again = podium_of(describe_podium(each))
        jax.tree.map(np.testing.assert_array_equal, again, each)


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ("{ eta = [24.0, 6.0], T = [0.5, 0.15], zeta = [0.05, 0.03] }", TWO_MODES),
        ("{ masses = [3.0, 3.0, 2.0], stiffnesses = [900.0, 700.0, 500.0] }", BUILDING),
        ("{ eta = 8.0, T_s = 0.5, stories = 2 }", rj.ShearBuilding.uniform(2, 8.0, 0.5)),
    ],
)
def test_problem_files(table, expected):
    read = Reader().check(ByRatios, tomllib.loads(f"alpha = 0.1\nR = 1.0\nsuperstructure = {table}"))
    jax.tree.map(np.testing.assert_array_equal, Reader().structure(read).superstructure, expected)


# Invalid inputs


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: rj.Modes(30.0, [0.5]), "Modes: eta must be an array with a number for each mode"),
        (lambda: rj.Modes([], []), "Modes: eta must be an array"),
        (lambda: rj.Modes([30.0, 2.0], [0.5]), "Modes: T must be as long as eta, which has 2 modes, got 1"),
        (lambda: rj.Modes([30.0], [0.5], [0.1, 0.1]), "Modes: zeta must be as long as eta"),
        (lambda: rj.Modes([30.0, -1.0], [0.5, 0.2]), "Modes: eta must be finite and >= 0, got eta = -1.0"),
        (lambda: rj.Modes([30.0, 1.0], [0.5, 0.0]), "Modes: T must be finite and > 0, got T = 0.0"),
        (lambda: rj.Modes([30.0], [0.5], -0.1), "Modes: zeta must be finite and >= 0, got zeta = -0.1"),
        (lambda: rj.Modes([30.0], [0.5], residual=-1.0), "Modes: residual must be finite and >= 0"),
        (lambda: rj.Modes(["a"], [0.5]), "Modes: eta must be a number or an array of numbers"),
        (lambda: rj.Modes.of_total(30.0, [30.0, 1.0], [0.5, 0.2]), "at least the sum of eta, 31, got 30"),
        (lambda: rj.ShearBuilding([1.0, 0.0], [9.0, 9.0]), "masses must be finite and > 0, got masses = 0.0"),
        (lambda: rj.ShearBuilding([1.0, 1.0], [9.0, -9.0]), "stiffnesses must be finite and > 0"),
        (lambda: rj.ShearBuilding([1.0, 1.0], [9.0]), "stiffnesses must be as long as masses, which has 2"),
        (lambda: rj.ShearBuilding([1.0], [9.0], modes=2), "modes must be in 0 … 1, the number of stories"),
        (lambda: rj.ShearBuilding([1.0], [9.0], modes=-1), "modes must be a whole number >= 0"),
        (lambda: rj.ShearBuilding([1.0], [9.0], damping=[0.1, 0.1]), "damping must be one number or one for"),
        (lambda: rj.ShearBuilding([1.0], [9.0], heights=[0.0]), "heights must be finite and > 0"),
        (lambda: rj.ShearBuilding(1.0, 9.0), "masses must be an array with a number for each story"),
        (
            lambda: rj.peak_response(podium(TWO_MODES), rj.Rest(), initial=rj.State(u_t=[0.1, 0.1, 0.1])),
            "initial.u_t must be one number or one for each of the 2 modes",
        ),
        (lambda: rj.peak_response(podium(rj.Modes([[1.0], [2.0]], [0.5])), rj.Rest()), "must have scalar"),
    ],
)
def test_bad_input(make, says):
    with pytest.raises(ValueError, match=says.replace(".", r"\.").replace("(", r"\(")):
        make()


def test_a_total_that_modes_fill_but_for_rounding():
    modes = rj.Modes.of_total(0.3, [0.1, 0.2], [0.5, 0.2])
    assert float(modes.residual) == 0
    assert float(rj.Modes.of_total(1.0, [0.1, 0.2], [0.5, 0.2]).residual) == pytest.approx(0.7)
