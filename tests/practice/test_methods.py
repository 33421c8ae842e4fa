"""Simplified methods: roots, spectra, the bound of (P2), arguments."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import rockjax as rj
from benchmarks.practice import largest_demand
from rockjax._oscillators import RESPONSES
from rockjax._practice import asce_sliding, spectra
from rockjax._practice.registry import METHODS
from rockjax._practice.roots import find_roots
from rockjax._practice.spectral_uplift import effective_acceleration

G = 9.80665
BLOCK = rj.Podium(0.2, 2.0, 1.0, rj.Rigid(2.0))
BUILDING = BLOCK.replace(superstructure=rj.Elastic(2.0, 0.5))
MOTIONS = rj.synthetic_motions(3, seed=5, dt=0.02, duration=8.0, pga=4.0)
THRESHOLD = G * math.tan(0.2)


def one(name: str, podium=BLOCK, motions: Any = MOTIONS, **options) -> Any:
    (result,) = rj.simplified_methods(podium, motions, methods=[name], **options)
    return result


def test_all_roots_are_found_and_the_largest_is_the_answer():
    stable, unstable = np.array([0.1, 0.4, 0.75]), np.array([0.2, 0.6])
    excess = lambda phi: (
        -np.prod([phi - y for y in (*stable, *unstable)], axis=0) * (1 + np.sin(3 * phi) ** 2)
    )
    roots = find_roots(excess)
    np.testing.assert_allclose(roots.stable, stable, atol=1e-10)
    np.testing.assert_allclose(roots.unstable, unstable, atol=1e-10)
    assert roots.answer == pytest.approx(0.75, abs=1e-10)
    assert not roots.overturns
    falls = find_roots(lambda phi: excess(phi) * (0.9 - phi))
    assert falls.answers == (*falls.stable, 1.0)
    assert falls.answer == 1
    assert falls.overturns


def test_without_a_root_the_answer_is_no_uplift_or_overturning():
    assert find_roots(lambda phi: -phi).answers == ()
    assert find_roots(lambda phi: -phi).answer == 0
    assert find_roots(lambda phi: phi).answers == (1.0,)
    assert find_roots(lambda phi: phi - 0.999).overturns


def test_a_step_with_three_roots_gives_the_largest():
    width = 0.989 / 1000  # fraction of a step of the scan
    places = 0.5 + width * (np.array([0.2, 0.5, 0.8]) - math.fmod(0.49, width) / width)
    roots = find_roots(lambda phi: -np.prod([phi - y for y in places], axis=0))
    assert roots.answer == pytest.approx(places[2], abs=1e-9)


def answers_at_substeps(motion, T, zeta, parts=40):
    """Return the largest |x| and |2ζωẋ+ω²x| at substeps of each sample and during 20 periods of free
    vibration, by the matrix exponential for a linear load."""
    w = 2 * math.pi / T
    system = np.zeros((4, 4))
    system[0, 1], system[1] = 1.0, [-(w**2), -2 * zeta * w, -1.0, 0.0]
    system[2, 3] = 1.0
    step = expm(system * motion.dt / parts)
    rest = math.ceil(20 * T / motion.dt)
    loads = [*motion.acceleration, *np.zeros(rest)]
    loads.insert(len(motion), 0.0)
    y, found = np.zeros(2), []
    for k in range(len(loads) - 1):
        if k == len(motion) - 1:  # after the motion
            continue
        state = np.array([*y, loads[k], (loads[k + 1] - loads[k]) / motion.dt])
        for _ in range(parts):
            found.append(state[:2])
            state = step @ state
        y = state[:2]
    x, v = np.array(found).T
    return np.abs(x).max(), np.abs(2 * zeta * w * v + w**2 * x).max()


@pytest.mark.parametrize(("T", "zeta"), [(0.07, 0.1), (0.5, 0.02), (3.0, 0.3)])
def test_spectra_are_exact(T, zeta):
    motion = dataclasses.replace(MOTIONS[0], acceleration=MOTIONS[0].acceleration[50:150])
    expected = np.array(answers_at_substeps(motion, T, zeta))
    exact = np.array([spectra.spectrum(motion, T, zeta, response)[0] for response in RESPONSES])
    np.testing.assert_allclose(exact, expected, rtol=1e-4)  # accuracy of the substeps
    assert np.all(exact >= expected * (1 - 1e-12))


def test_the_largest_spectral_displacement_is_that_of_a_fine_grid():
    for motion in MOTIONS:
        for longest in (0.3, 1.1, 2.4):
            found = spectra.largest_displacement(motion, longest, 0.08)
            values = spectra.spectrum(motion, np.linspace(longest / 50, longest, 5000), 0.08, "displacement")
            assert found >= values.max() * (1 - 1e-8)
            assert found <= values.max() * (1 + 1e-5)


def buildings(count: int, seed: int):
    """Return random buildings of three modes, and random motions with few samples."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        eta = rng.exponential(10.0, 3) * (rng.random(3) < 0.7)
        T, zeta, residual = np.exp(rng.uniform(-3, 1.5, 3)), rng.uniform(0, 0.3, 3), rng.choice([0.0, 5.0])
        top = rj.Modes(eta, T, zeta, residual)
        podium = rj.Podium(rng.uniform(0.05, 0.4), 2.0, rng.choice([0.0, rng.exponential(5.0)]), top)
        samples = np.cumsum(rng.normal(size=30)) * rng.normal(size=30)
        yield podium, rj.Motion(samples, rng.choice([0.01, 0.1]))


@pytest.mark.parametrize("count", [150, pytest.param(10_000, marks=pytest.mark.slow)])
def test_no_building_lifts_below_the_spectral_bound(count):
    """The demand is linear in the motion, so the motion divided by `largest_demand` just lifts the
    columns."""
    ratios = []
    for podium, motion in buildings(count, seed=count):
        bound = effective_acceleration(podium, motion) / (G * math.tan(podium.alpha))
        ratios.append(bound / largest_demand(podium, motion))
    assert min(ratios) >= 1 - 1e-9
    assert min(ratios) < 1.02  # PGA governs in some cases
    assert max(ratios) > 1.5


def test_the_spectral_bound_against_simulations():
    demand = one("spectral_uplift", BUILDING).demand
    below = [motion.scaled(0.999 * THRESHOLD / a) for motion, a in zip(MOTIONS, demand, strict=True)]
    result = one("spectral_uplift", BUILDING, below)
    assert result.passes
    np.testing.assert_allclose(result.utilisation, 0.999, rtol=1e-12)
    peaks = rj.peak_responses(BUILDING, [*below, *rj.Motions(tuple(below)).map(lambda y: y.scaled(2.0))])
    assert np.all(np.asarray(peaks.peak_rotation)[:3] == 0)
    assert np.all(np.asarray(peaks.peak_rotation)[3:] > 0)


def test_a_rigid_building_lifts_at_the_static_threshold():
    results: Any = rj.simplified_methods(BLOCK, MOTIONS, methods=["static", "spectral_uplift"])
    static, uplift = results
    np.testing.assert_allclose(static.demand, uplift.demand, rtol=1e-14)
    assert static.capacity == pytest.approx(THRESHOLD, rel=1e-14)
    assert not static.passes
    assert one("static", motions=MOTIONS.map(lambda y: y.scaled(0.9 * THRESHOLD / 4))).passes


def test_results_name_everything_and_have_no_gaps():
    results: Any = rj.simplified_methods(BUILDING, MOTIONS, friction=0.5, vertical=1.0)
    assert [result.name for result in results] == list(METHODS)
    assert [result.equation for result in results] == [*(f"(P{k})" for k in range(1, 8)), "(P7)"]
    for result in results:
        assert result.motions == ("synthetic-0001", "synthetic-0002", "synthetic-0003")
        assert result.demand.shape == (3,)
        assert np.all(np.isfinite(result.demand))
        assert result.reliability.endswith(".")
        assert result.title in repr(result)
        for value, unit, meaning in result.values.values():
            assert np.shape(value) in ((), (3,))
            assert unit
            assert meaning
        if result.rotation_ratio is not None:
            assert [max(y, default=0.0) for y in result.answers] == list(result.rotation_ratio)
            assert result.passes == bool(np.all(result.rotation_ratio < 1))
    assert {result.name: result.passes for result in results}["asce_43_05_sliding"] is None


def test_a_large_motion_overturns_and_no_motion_does_nothing():
    names = ["priestley", "fema_356", "asce_43_05_rocking"]
    results: Any = rj.simplified_methods(BLOCK, MOTIONS.map(lambda y: y.scaled(100)), methods=names)
    for result in results:
        assert np.all(result.rotation_ratio == 1)
        assert result.passes is False
        assert np.all(result.stable_roots >= 1)
    nothing = rj.Record([0.0, 0.0, 0.0], 0.1)
    for result in rj.simplified_methods(BLOCK, nothing, vertical=0.0, friction=0.1):
        assert result.passes or result.passes is None
        assert result.governing_demand == 0


def test_sizes_scale():
    """If lengths are multiplied by c and times by √c, accelerations and rotations stay the same."""
    c = 4.0
    larger = BUILDING.replace(R=BUILDING.R * c, superstructure=rj.Elastic(2.0, 0.5 * math.sqrt(c)))
    slower = [rj.Motion(motion.acceleration, motion.dt * math.sqrt(c)) for motion in MOTIONS]
    names = [name for name in METHODS if name != "asce_43_05_sliding"]  # its periods end at 10 s
    results: Any = rj.simplified_methods(BUILDING, MOTIONS, methods=names)
    scaled: Any = rj.simplified_methods(larger, slower, methods=names)
    for a, b in zip(results, scaled, strict=True):
        factor = c if a.unit == "m" else 1.0
        np.testing.assert_allclose(b.demand, factor * a.demand, rtol=1e-7)
        assert b.capacity == pytest.approx(factor * a.capacity, rel=1e-12)


def test_the_confidence_factor_reduces_the_acceleration():
    first, second = (one("circolare_force", confidence_factor=y) for y in (1.0, 1.35))
    assert second.capacity == pytest.approx(first.capacity / 1.35, rel=1e-14)


def test_sliding_needs_friction_and_vertical_motion():
    bare = one("asce_43_05_sliding")
    assert bare.capacity is None
    assert bare.demand is None
    assert any("friction" in reason for reason in bare.missing)
    assert any("vertical" in reason for reason in bare.missing)
    assert any("sliding distance" in reason for reason in bare.missing)
    assert "not computed" in repr(bare)
    paired = [dataclasses.replace(motion, vertical=motion.scaled(0.25)) for motion in MOTIONS]
    made = one("asce_43_05_sliding", motions=paired, friction=0.6)
    assert made.values["A_v"].value == pytest.approx(1.0, rel=1e-12)
    assert made.capacity == pytest.approx(1.2 * (G - 0.4), rel=1e-12)
    again = one("asce_43_05_sliding", motions=[motion.record() for motion in paired], friction=0.6)
    assert again.capacity == made.capacity


def test_the_sliding_frequency_is_the_lowest_at_the_capacity():
    motion = MOTIONS[1]
    for level in (3.0, 6.0):
        f = asce_sliding.sliding_demand(motion, level)[1]
        assert spectra.spectrum(motion, 1 / f, 0.1, "acceleration")[0] == pytest.approx(level, rel=1e-4)
        longer = np.linspace(1.001 / f, 10, 500)
        assert spectra.spectrum(motion, longer, 0.1, "acceleration").max() < level
    assert math.isnan(asce_sliding.sliding_demand(motion, 100.0)[1])


def test_tables_keep_their_factors_and_their_selection():
    table = rj.Records.of(MOTIONS.records())
    for records, motions in (
        (table.scaled(2.0), [motion.scaled(2.0) for motion in MOTIONS]),
        (table.pick([2, 0]).scaled([0.5, 3.0]), [MOTIONS[2].scaled(0.5), MOTIONS[0].scaled(3.0)]),
        (table.pick(1), [MOTIONS[1]]),
    ):
        expected = [motion.pga for motion in motions]
        np.testing.assert_allclose(one("static", motions=records).demand, expected, rtol=1e-12)
        np.testing.assert_allclose([float(np.abs(y.strength())) for y in records], expected, rtol=1e-12)


def test_restrainers_and_an_inelastic_impact_are_reasons_not_to_make_a_method():
    for result in rj.simplified_methods(BLOCK.replace(restrainers=(rj.Tendon(0.1, 1.0),)), MOTIONS):
        assert result.passes is None
        assert "tendons" in result.missing[0]
    for name in ("priestley", "asce_43_05_rocking"):
        result = one(name, BLOCK.replace(restitution=0.0))
        assert result.passes is None
        assert "damping" in result.missing[0]
    assert one("fema_356", BLOCK.replace(restitution=0.0)).passes is not None
    damped = BLOCK.replace(superstructure=rj.Elastic(2.0, 0.5, 1.2))
    assert "damping" in one("spectral_uplift", damped).missing[0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"podium": rj.Podium(np.array([0.1, 0.2]), 1.0)}, ["podium", "scalar"]),
        (
            {"podium": BLOCK.replace(superstructure=rj.Elastic(20.0, [0.3, 0.5, 0.7]))},
            ["podium", "scalar", "once for each podium"],
        ),
        ({"podium": "a"}, ["podium", "rockjax.Podium"]),
        ({"motions": rj.Ricker(3.0, 1.0)}, ["motions", "rockjax.Motion"]),
        ({"motions": []}, ["motions", "at least one"]),
        ({"friction": -0.1}, ["friction", "-0.1"]),
        ({"vertical": math.nan}, ["vertical", "nan"]),
        ({"confidence_factor": 0.9}, ["confidence_factor", ">= 1", "0.9"]),
        ({"methods": "static"}, ["methods", "list"]),
        ({"methods": ["statics"]}, ["methods", "spectral_uplift", "'statics'"]),
    ],
)
def test_bad_input(change, words):
    arguments: Any = {"podium": BLOCK, "motions": MOTIONS} | change
    with pytest.raises(ValueError) as error:
        rj.simplified_methods(**arguments)
    assert all(word in str(error.value) for word in words), str(error.value)
