"""Floor response spectra: closed forms, an independent reference, derivatives, suites, invalid inputs."""

import math
from typing import Any

import numpy as np
import pytest

import rockjax as rj
from rockjax import _results as results
from rockjax import plots
from rockjax._oscillators import Load, largest
from rockjax._responses.floor import PieceMotions, Pieces, in_direction, load_of, with_beam
from rockjax._responses.floor_end import Ending, bound_after_end, ratio_after_end
from rockjax._responses.floor_slopes import Slopes, slope_of_load
from tests import restrained
from tests.reference_contents import oscillators_on_floors
from tests.reference_floors import largest_displacements
from tests.scenes import shaking

FINE = rj.Options(rtol=1e-12, atol=1e-14)
FRAME = rj.Podium(alpha=0.15, R=1.5, gamma=10.0, lam=1 / 3)
TOP = FRAME.replace(superstructure=rj.Elastic(30.0, 0.5, 0.05))


def spectrum(podium, excitation, periods, **more: Any):
    return rj.floor_spectrum(podium, excitation, np.asarray(periods), **{"options": FINE, **more})


def load(terms, kick=0.0, length=40.0):
    """Return the load of a floor with piecewise constant acceleration and a velocity jump at the start."""
    count = len(terms)
    none = np.zeros(count)
    kicks = np.where(np.arange(count) == 0, kick, 0.0)
    start = length * np.arange(count)
    return Load(start, np.full(count, length), np.array(terms)[:, None], kicks, none, none)


@pytest.mark.parametrize(
    ("zeta", "kick", "kick_acceleration", "step", "step_acceleration"),
    [
        (0.05, 0.9266920209946192, 0.9313448608105514, 0.8544678930067565, 0.8587581017750918),
        (0.02, 0.9694541431464898, 0.9702302238177588, 0.9390895628611485, 0.9398413356638947),
    ],
)
def test_a_kick_and_a_step_have_their_closed_forms(zeta, kick, kick_acceleration, step, step_acceleration):
    T, damping = np.array([0.3, 1.0]), np.full(2, zeta)
    omega = 2 * math.pi / T
    found = largest(load([0.0], kick=-0.7), T, damping, True)
    np.testing.assert_allclose(found.values[0], kick * 0.7 / omega, rtol=1e-12)
    np.testing.assert_allclose(found.values[1], kick_acceleration * 0.7 * omega, rtol=1e-12)
    before, after = -0.4, 0.9
    found = largest(load([before, after], length=300.0), T, damping, True)
    np.testing.assert_allclose(found.values[0] * omega**2, after + (after - before) * step, rtol=1e-9)
    np.testing.assert_allclose(found.values[1], after + (after - before) * step_acceleration, rtol=1e-9)


def test_a_strongly_damped_oscillator_feels_a_kick_at_once():
    found = largest(load([0.0], kick=0.5), np.array([1.0]), np.array([0.7]), False)
    np.testing.assert_allclose(found.values[1], 2 * 0.7 * 2 * math.pi * 0.5, rtol=1e-12)


def test_full_contact_passes_the_ground_motion_on():
    found = spectrum(FRAME, rj.OneSine(1.0, 0.8), [0.5, 1.5], damping=[0.0, 0.02, 0.05])
    S_d, S_a = found["relative_displacement"][0], found["absolute_acceleration"][0]
    np.testing.assert_allclose(S_d[[2, 0], 0], [0.01459471099265536, 0.01676373968931122], rtol=1e-11)
    np.testing.assert_allclose(S_d[1, 1], 0.07941081624380533, rtol=1e-11)
    np.testing.assert_allclose(S_a[[2, 0], 0], [2.311311812234842, 2.647223664261477], rtol=1e-11)
    np.testing.assert_allclose(S_a[1, 1], 1.394454688752405, rtol=1e-11)
    assert (found["remaining_ratio"] <= 1).all()
    early = spectrum(FRAME, rj.OneSine(1.0, 0.8), [0.5, 1.5], damping=[0.0, 0.02, 0.05], t_end=0.8)
    for name in (
        "relative_displacement",
        "absolute_acceleration",
        "peak_time",
    ):  # including the next turning points
        np.testing.assert_allclose(early[name], found[name], rtol=1e-9)
    assert (early["remaining_ratio"] == 1).any()
    record = rj.Motion(np.asarray(shaking(peak=0.7).acceleration), 0.02)
    of_record = spectrum(FRAME, record, [0.1, 1.0])["pseudo_acceleration"][0, 0]
    exact = rj.intensity_measures(record, periods=(0.1, 1.0))["Sa"]
    np.testing.assert_allclose(of_record, exact, rtol=1e-9)


def test_the_ground_moves_the_deck_vertically():
    pair = rj.GroundMotion(rj.OneSine(1.0, 0.8), rj.OneSine(2.0, 0.8))
    found = spectrum(FRAME, pair, [0.5], direction="vertical")
    np.testing.assert_allclose(found["relative_displacement"], 2 * 0.01459471099265536, rtol=1e-11)
    assert found["peak_velocity_jump"] == 0


@pytest.mark.parametrize("damping", [0.0, 0.05, 0.3])
def test_the_response_after_the_end_stays_below_its_bound(damping):
    more = {"damping": damping, "initial": rj.State(theta=0.1)}
    at_end = spectrum(FRAME, rj.Rest(), [0.1, 0.5, 2.0], t_end=40.0, **more)["relative_displacement"]
    for end in (0.5, 1.5, 6.0):
        found = spectrum(FRAME, rj.Rest(), [0.1, 0.5, 2.0], t_end=end, **more)
        bound = found["relative_displacement"] * np.maximum(1.0, found["remaining_ratio"])
        assert (found["remaining_ratio"] > 1).all()
        assert (at_end <= bound).all()
        assert (bound < 200 * at_end).all()


def test_bounds_after_the_end_have_closed_forms():
    """(L16) for columns at rest and (L17) for free rocking, with X and r of fact 5."""
    damping, weights = np.array([0.0, 0.05]), np.array([0.5, -2.0, 0.0, 0.05])
    rests = Ending(np.True_, np.array([0.1, 0.2, np.inf, 1.0]), 0.0, 0.0, 0.9)
    assert bound_after_end(rests, weights, damping, False) == pytest.approx(0.5)
    assert np.all(bound_after_end(rests, weights, damping, True) == 0)
    assert np.all(bound_after_end(rests, 0 * weights, damping, False) == 0)
    rocks = Ending(np.False_, np.zeros(0), 0.3, 0.4, 0.95)
    damped = 2 * 0.9266920209946192 * 0.7 / (1 - 0.8544678930067565)
    free = np.zeros(0)
    np.testing.assert_allclose(bound_after_end(rocks, free, damping, False), [16.3, damped], rtol=1e-12)
    elastic = bound_after_end(rocks._replace(restitution=1.0), free, damping, False)
    np.testing.assert_allclose(elastic, [np.inf, damped], rtol=1e-12)
    assert np.all(bound_after_end(rocks, free, damping, True) == np.inf)
    ratios = ratio_after_end(np.array([0.01, 0.02, 0.0]), np.array([0.04, 0.0, 0.0]))
    np.testing.assert_allclose(ratios, [0.25, np.inf, 0.0], rtol=1e-12)


def test_an_elastic_top_in_full_contact_has_its_closed_form():
    factor = 1.0123  # an amplitude that is not a round number in g
    found = spectrum(TOP, rj.OneSine(0.5 * factor, 0.8), [0.2, 0.5], damping=[0.02, 0.05], level=["deck", 1])
    S_d = found["relative_displacement"].sel(level="1")
    np.testing.assert_allclose(
        found["peak_acceleration"].sel(level="1"), factor * 1.155655906117421, rtol=1e-9
    )
    np.testing.assert_allclose(S_d[0, 1], factor * 0.03408399214250126, rtol=1e-9)
    np.testing.assert_allclose(S_d[1, 0], factor * 0.001286129870811430, rtol=1e-9)
    assert found["peak_velocity_jump"].sel(level="1") == 0
    assert (found["remaining_ratio"].sel(level="deck") <= 1).all()
    assert np.isfinite(found["remaining_ratio"].sel(level="1")).all()
    early = spectrum(TOP, rj.OneSine(0.5 * factor, 0.8), [0.2, 0.5], damping=[0.02, 0.05], level=1, t_end=0.8)
    bound = early["relative_displacement"] * np.maximum(1.0, early["remaining_ratio"])
    assert (S_d <= bound[0] * (1 + 1e-9)).all()
    assert (bound[0] < 40 * S_d).all()


def test_spectra_of_a_pulse_agree_with_the_reference():
    found = spectrum(FRAME, rj.Ricker(3.2, 1.0), [0.05, 0.5, 2.0], t_end=8.0)
    exact = [5.42355969, 5.68864346, 8.75070007]
    np.testing.assert_allclose(found["pseudo_acceleration"].values.ravel(), exact, rtol=2e-9)
    np.testing.assert_allclose(found["peak_acceleration"], 1.486677823722, rtol=1e-9)
    np.testing.assert_allclose(found["peak_velocity_jump"], 0.0282409011033, rtol=1e-9)
    vertical = spectrum(FRAME, rj.Ricker(3.2, 1.0), [0.05, 0.5, 2.0], t_end=8.0, direction="vertical")
    np.testing.assert_allclose(
        vertical["pseudo_acceleration"].values.ravel()[:2], [21.63090363, 2.85445778], rtol=2e-9
    )
    np.testing.assert_allclose(vertical["peak_velocity_jump"], 0.188412381969, rtol=1e-9)


def test_stiff_oscillators_follow_the_largest_velocity_jump():
    found = spectrum(FRAME, rj.Rest(), [0.001, 0.01], t_end=6.0, initial=rj.State(theta=0.1))
    over_omega = found["pseudo_acceleration"][0, 0] * found["period"] / (2 * math.pi)
    np.testing.assert_allclose(over_omega, [0.031546576601, 0.0335110042553], rtol=1e-9)
    limit = 0.9266920209946192 * float(found["peak_velocity_jump"][0])
    assert limit == pytest.approx(0.03135633805208661, rel=1e-9)


def test_slow_oscillators_follow_the_displacement_of_the_ground():
    found = spectrum(FRAME, rj.Ricker(1.0, 1.0), [1e4], damping=0.0, t_end=20.0)
    np.testing.assert_allclose(found["relative_displacement"], 0.05066059182116889, rtol=1e-6)


def test_slender_columns_have_the_linearised_spectrum():
    alpha = 1e-3
    block = rj.Podium(alpha=alpha, R=3 * 9.80665 / 16, lam=1 / 3, restitution=0.9)
    start = rj.State(theta=alpha / 2)
    found = spectrum(block, rj.Rest(), [0.5], initial=start, t_end=6.0)
    size = float(found["relative_displacement"].item()) / (2 * float(block.R) * alpha)
    assert size == pytest.approx(0.09561023890232810, rel=2e-6)
    assert float(found["peak_time"].item()) == pytest.approx(3.543932538, rel=1e-5)
    impacts = rj.simulate(block, rj.Rest(), initial=start, t_end=6.0, options=FINE).impact_times[:2]
    np.testing.assert_allclose(impacts, [0.6584789484624084, 1.702377397029442], rtol=2e-6)


def test_oscillators_on_the_deck_are_modes_without_mass():
    periods = np.array([0.3, 1.0])
    light = FRAME.replace(superstructure=rj.Modes(np.zeros(2), periods, 0.05))
    peak = rj.peak_response(light, rj.Ricker(3.2, 1.0), t_end=6.0, options=FINE)
    found = spectrum(FRAME, rj.Ricker(3.2, 1.0), periods, t_end=6.0)
    np.testing.assert_allclose(found["relative_displacement"][0, 0], peak.peak_deformation, rtol=1e-9)
    # The same oscillators: from a spectrum of the deck, and as an additional mode.
    same = spectrum(light, rj.Ricker(3.2, 1.0), periods, t_end=6.0)
    np.testing.assert_allclose(same["relative_displacement"], found["relative_displacement"], rtol=1e-9)
    mode = rj.simulate(light, rj.Ricker(3.2, 1.0), t_end=6.0, options=FINE).floor(
        weights=np.array([1.0, 0.0])
    )
    of_mode = spectrum(light, rj.Ricker(3.2, 1.0), periods, t_end=6.0, weights=np.array([1.0, 0.0]))
    assert of_mode["peak_acceleration"].item() == pytest.approx(mode.peak_acceleration, rel=1e-12)
    assert of_mode["level"].values.tolist() == ["weights"]


@pytest.mark.parametrize("seed", range(6))
def test_random_scenes_agree_with_an_independent_integrator(seed):
    rng = np.random.default_rng(seed)
    elastic, on_top = seed % 2 == 1, seed % 4 == 1
    alpha, R, gamma = rng.uniform(0.1, 0.25), rng.uniform(1.0, 3.0), rng.uniform(2.0, 15.0)
    eta = rng.uniform(1.0, 20.0) if elastic else 0.0
    T_s, T_p = rng.uniform(0.2, 0.8), rng.uniform(0.6, 1.5)
    a_p, zeta = 9.80665 * math.tan(alpha) * rng.uniform(1.4, 2.2), rng.uniform(0.0, 0.2)
    periods = np.sort(np.exp(rng.uniform(np.log(0.05), np.log(4.0), 5)))
    top = rj.Elastic(eta, T_s, 0.05) if elastic else None
    podium = rj.Podium(alpha=alpha, R=R, gamma=gamma, lam=1 / 3, superstructure=top)
    end = 1.5 * T_p
    found = rj.floor_spectrum(
        podium,
        rj.Ricker(a_p, T_p),
        periods,
        damping=zeta,
        level=1 if on_top else "deck",
        t_end=end,
        options=rj.Options(),
    )
    e = float(podium.restitution_factor)
    exact = largest_displacements(alpha, R, gamma, eta, T_s, 0.05, e, a_p, T_p, end, periods, zeta, on_top)
    np.testing.assert_allclose(found["relative_displacement"][0, 0], exact, rtol=1e-6)


@pytest.mark.parametrize(("a_p", "overturns"), [(2.2, False), (3.0, True)])
def test_floors_of_a_building_agree_with_an_independent_integrator(a_p, overturns):
    """Stories, mode weights and the vertical direction, also for a podium that overturns."""
    building = rj.ShearBuilding([3.0, 3.0, 2.0], [900.0, 700.0, 500.0], modes=2)
    podium, periods = FRAME.replace(superstructure=building), np.array([0.08, 0.4, 1.5])
    pulse = restrained.one_sine(a_p, 0.9)
    motion = rj.GroundMotion(rj.OneSine(a_p, 0.9), rj.OneSine(0.4 * a_p, 0.9))
    more: Any = {"damping": 0.03, "t_end": 2.0}
    weights, levels, stories = np.array([0.7, -0.4]), ["deck", 1, 3], np.asarray(building.story_weights)
    spectra = [
        spectrum(podium, motion, periods, level=levels, **more),
        spectrum(podium, motion, periods, weights=weights, **more),
        spectrum(podium, motion, periods, direction="vertical", **more),
    ]
    horizontal = np.zeros(2), stories[0], stories[2], weights
    floors = [*((row, "horizontal") for row in horizontal), (np.zeros(2), "vertical")]
    motions = pulse, lambda t: 0.4 * pulse(t)
    scene: Any = {"floors": floors, "breaks": (0.0, 0.9)}
    frame = restrained.frame_of(podium)
    exact, overturn_time = oscillators_on_floors(frame, periods, 0.03, 2.0, *motions, **scene)
    found = np.concatenate([each["relative_displacement"].values[:, 0] for each in spectra])
    np.testing.assert_allclose(found, exact, rtol=1e-6)
    assert np.isfinite(overturn_time) == overturns
    np.testing.assert_allclose(spectra[0]["overturn_time"], overturn_time, rtol=1e-9)


def test_sizes_and_mirrors_change_nothing_else():
    pulse, periods = rj.Ricker(3.2, 1.0), np.array([0.2, 1.0])
    found = spectrum(FRAME, pulse, periods, t_end=4.0)
    larger = rj.Ricker(3.2, math.sqrt(2))
    size = spectrum(FRAME.replace(R=3.0), larger, math.sqrt(2) * periods, t_end=4 * math.sqrt(2))
    mirror = spectrum(FRAME, rj.Ricker(-3.2, 1.0), periods, t_end=4.0)
    for name, factor in (("pseudo_acceleration", 1.0), ("relative_displacement", 2.0)):
        np.testing.assert_allclose(size[name].values, factor * found[name].values, rtol=1e-8)
        np.testing.assert_allclose(mirror[name].values, found[name].values, rtol=1e-12)
    np.testing.assert_allclose(
        size["peak_velocity_jump"], math.sqrt(2) * found["peak_velocity_jump"], rtol=1e-8
    )


def check_derivatives(podium_of, excitation_of, values, **more):
    """Compare sensitivities with central differences of settled solutions."""
    names, periods = list(values), np.array([0.05, 0.3, 1.0, 3.0])
    base = np.array(list(values.values()))

    def at(numbers, **extra):
        named = dict(zip(names, numbers, strict=True))
        return spectrum(
            podium_of(**named), excitation_of(**named), periods, damping=[0.05, 0.0], **more, **extra
        )

    found = at(base, sensitivities=names)
    assert found["parameter"].values.tolist() == names
    for k, name in enumerate(names):
        ends = [at(base * np.where(np.arange(base.size) == k, 1 + h, 1.0)) for h in (1e-6, -1e-6)]
        for quantity in ("pseudo_acceleration", "absolute_acceleration", "relative_displacement"):
            change = (ends[0][quantity] - ends[1][quantity]) / 2e-6
            slope = found[f"{quantity}_sensitivity"].sel(parameter=name)
            np.testing.assert_allclose(slope, change, rtol=1e-5, atol=1e-5 * float(found[quantity].max()))


@pytest.mark.parametrize("direction", ["horizontal", "vertical"])
def test_derivatives_agree_with_differences(direction):
    check_derivatives(
        lambda alpha, gamma, **_: FRAME.replace(alpha=alpha, gamma=gamma),
        lambda a_p, T_p, **_: rj.Ricker(a_p, T_p),
        {"alpha": 0.15, "gamma": 10.0, "a_p": 3.2, "T_p": 1.0},
        t_end=4.0,
        direction=direction,
    )


@pytest.mark.slow
def test_derivatives_of_stories_under_a_jumping_ground_agree_with_differences():
    masses, stiffnesses = np.array([12.0, 10.0, 8.0]), np.array([4000.0, 3500.0, 2500.0])

    def podium(alpha, story_stiffness_2, **_):
        k = np.where(np.arange(3) == 1, story_stiffness_2, stiffnesses)
        return FRAME.replace(alpha=alpha, superstructure=rj.ShearBuilding(masses, k, modes=2))

    check_derivatives(
        podium,
        lambda a_p, T_p, **_: rj.OneCosine(a_p, T_p),
        {"alpha": 0.15, "story_stiffness_2": 3500.0, "a_p": 4.0, "T_p": 0.8},
        t_end=3.0,
        level=["deck", 1, 3],
    )


@pytest.mark.parametrize(("direction", "kick"), [("horizontal", -0.6), ("vertical", -0.3)])
def test_a_start_that_moves_omits_the_first_acceleration(direction, kick):
    """(L8) at the start, where a⁻ = 0, so the jump is −a⁺ t'."""
    terms, zeros = np.array([[[2.0, 1.0]], [[3.0, 0.5]]]), np.zeros((2, 2))
    pieces = Pieces(np.array([0.0, 1.0]), np.ones(2), np.zeros(2, int), np.zeros(2, bool))
    motion, still = (PieceMotions(y, zeros) for y in (terms, 0 * terms))
    none = np.zeros(0)  # modes
    load = load_of(pieces, motion, in_direction(with_beam(none), direction))
    slope = Slopes(still, np.array([0.3, 0.0]), zeros, {})
    found = slope_of_load(load, pieces, motion, slope, none, none, direction)
    np.testing.assert_allclose(found.kick, [kick, 0.0], rtol=1e-15)


@pytest.fixture(scope="module")
def suite():
    """Return three motions, of which the last overturns the podium."""
    motions = [rj.Ricker(a, 1.0) for a in (1.0, 3.2, 30.0)]
    return rj.floor_spectrum(FRAME, motions, np.geomspace(0.1, 2.0, 8), options=FINE, t_end=4.0)


def test_suites_have_a_dim_of_motions_and_an_envelope(suite):
    assert suite["pseudo_acceleration"].dims == ("motion", "level", "damping", "period")
    assert suite["overturned"].values.tolist() == [False, False, True]
    assert np.isinf(suite["remaining_ratio"][2]).all()
    alone = spectrum(FRAME, rj.Ricker(3.2, 1.0), suite["period"].values, t_end=4.0)
    np.testing.assert_allclose(suite["pseudo_acceleration"][1], alone["pseudo_acceleration"], rtol=1e-12)
    with pytest.raises(ValueError, match="1 of 3 scenes overturned"):
        rj.envelope(suite)
    largest = rj.envelope(suite, overturned="drop")["pseudo_acceleration"]
    np.testing.assert_array_equal(largest, suite["pseudo_acceleration"][:2].max("motion"))
    median = rj.envelope(suite, quantile=0.5, overturned="drop")["pseudo_acceleration"]
    np.testing.assert_allclose(median, suite["pseudo_acceleration"][:2].mean("motion"))


@pytest.mark.parametrize("fixed_base", [False, True])
def test_unfinished_scenes_are_named_and_have_no_envelope(suite, fixed_base):
    options = FINE.replace(max_steps=40, throw=False)
    motions, T = [rj.Ricker(a, 1.0) for a in (0.01, 3.2)], suite["period"].values
    data = rj.floor_spectrum(FRAME, motions, T, options=options, t_end=4.0, fixed_base=fixed_base)
    assert results.NAMES[int(data["result"][1])] == "out_of_steps"
    assert np.isinf(data["remaining_ratio"][1]).all()
    assert "out_of_steps" in data["result"].attrs["flag_meanings"]
    assert not results.did_not_finish(suite["result"]).any()
    with pytest.raises(ValueError, match=r"\d of 2 scenes did not finish"):
        rj.envelope(data, overturned="drop")


def test_broadening_is_the_running_maximum_over_log_periods(suite):
    one = suite.isel(motion=1)
    broad = rj.broadened(one, 0.15)
    T, S = one["period"].values, one["pseudo_acceleration"].values.ravel()
    fine = np.exp(np.linspace(np.log(T[0]), np.log(T[-1]), 200001))
    values = np.interp(np.log(fine), np.log(T), S)
    for k, period in enumerate(T):
        inside = (fine >= period / 1.15) & (fine <= period / 0.85)
        assert float(broad["pseudo_acceleration"][0, 0, k]) == pytest.approx(values[inside].max(), rel=1e-4)
    np.testing.assert_allclose(rj.broadened(one, 0.0)["pseudo_acceleration"], one["pseudo_acceleration"])
    for name in ("overturned", "overturn_time", "result"):
        assert (broad[name] == one[name]).all() or np.isnan(one[name]).all()
    with pytest.raises(ValueError, match=r"broadened: ratio must be in \[0, 1\), got ratio = 1"):
        rj.broadened(one, 1.0)


def test_spectra_of_the_ground_and_of_a_fixed_base_are_beside_them():
    pulse, periods = rj.OneSine(2.0, 0.8), np.geomspace(0.1, 2.0, 6)
    found = spectrum(TOP, pulse, periods, level=["deck", 1], fixed_base=True, t_end=6.0)
    weak = rj.OneSine(2.0 / 16, 0.8)  # in full contact
    ground = 16 * spectrum(FRAME, weak, periods, t_end=6.0)
    fixed = 16 * spectrum(TOP, weak, periods, level=["deck", 1], t_end=6.0)
    for name in ("pseudo_acceleration", "absolute_acceleration", "relative_displacement"):
        np.testing.assert_allclose(found[f"ground_{name}"], ground[name][0], rtol=1e-8)
        np.testing.assert_allclose(found[f"fixed_base_{name}"], fixed[name], rtol=1e-8)
    figure = plots.floor_spectrum(found, "absolute_acceleration")
    deck, top = figure.axes
    assert [line.get_label() for line in top.lines[:3]] == ["ground", "fixed base", "podium"]
    drawn = np.asarray(top.lines[2].get_ydata()) * float(TOP.g)
    np.testing.assert_allclose(drawn, found["absolute_acceleration"].sel(level="1")[0])
    assert [line.get_label() for line in deck.lines] == ["ground", "podium"]
    with pytest.raises(ValueError, match=r"floor_spectrum: damping must be one of \[0.05\], got 0.1"):
        plots.floor_spectrum(found, damping=0.1)
    with pytest.raises(ValueError, match="quantity must be one of"):
        plots.floor_spectrum(found, "velocity")


def test_a_fixed_base_does_not_rotate_at_the_start():
    start = rj.State(theta=0.03, theta_dot=0.1)
    calls = [{"initial": initial, "fixed_base": True, "t_end": 4.0} for initial in (rj.State(), start)]
    still, rotated = (spectrum(FRAME, rj.Ricker(3.2, 1.0), [0.3, 1.0], **call) for call in calls)
    for name in ("ground_pseudo_acceleration", "fixed_base_absolute_acceleration"):
        np.testing.assert_array_equal(rotated[name], still[name])
    assert not np.allclose(rotated["pseudo_acceleration"], still["pseudo_acceleration"], rtol=0.01)


def test_pictures_of_suites_leave_out_motions_that_overturn(suite):
    (ax,) = plots.floor_spectrum(suite, "relative_displacement").axes
    labels = [str(line.get_label()) for line in ax.lines]
    assert sum(not label.startswith("_") for label in labels) == 1
    assert len(labels) == 3
    median = suite["relative_displacement"][:2].median("motion").values.ravel()
    np.testing.assert_allclose(np.asarray(ax.lines[-1].get_ydata()), median)


def test_progress_counts_motions():
    class Counter:
        total = 0

        def update(self, count):
            self.total += count

    counter = Counter()
    motions = [rj.Ricker(1.0, 1.0), rj.Ricker(1.1, 1.0)]
    for fixed_base in (False, True):
        counter.total = 0
        spectrum(FRAME, motions, [0.5], t_end=4.0, progress=counter, fixed_base=fixed_base)
        assert counter.total == 2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"periods": [0.0, 1.0]}, "periods must be finite and > 0 s, got periods = 0.0"),
        ({"periods": [math.inf]}, "periods must be finite and > 0 s, got periods = inf"),
        ({"periods": []}, "periods must be a 1-D array with values"),
        ({"damping": 1.0}, r"damping must be in \[0, 1\), got damping = 1.0"),
        ({"damping": [-0.1]}, r"damping must be in \[0, 1\), got damping = -0.1"),
        ({"level": "roof"}, "level must be 'deck' or a story from 1 to 1, got level = 'roof'"),
        ({"level": ["deck", 2]}, "got level = 2"),
        ({"level": []}, "level must name at least one level"),
        ({"weights": np.ones(2)}, "weights must have one value for each of the 1 modes"),
        ({"direction": "up"}, "direction must be one of"),
        ({"t_end": math.nan}, "t_end must be finite"),
        ({"sensitivities": ["beta"]}, "sensitivities must each be one of"),
        ({"excitation": []}, "excitation must hold at least one motion"),
    ],
)
def test_bad_input_is_refused(changes, message):
    arguments = {"podium": TOP, "excitation": rj.Ricker(1.0, 1.0), "periods": [0.5]} | changes
    with pytest.raises(
        ValueError, match=f"floor_spectrum: {message}" if "got level" not in message else message
    ):
        rj.floor_spectrum(**arguments)


def test_envelopes_refuse_other_datasets_and_dims(suite):
    with pytest.raises(ValueError, match="over must be a dim of the spectra"):
        rj.envelope(suite, over="period")
    with pytest.raises(ValueError, match=r"must be a result of rockjax.floor_spectrum"):
        rj.envelope(None)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=r"must be a result of rockjax.floor_spectrum"):
        rj.envelope(rj.envelope(suite, overturned="drop"), over="level")
    with pytest.raises(ValueError, match="must ascend"):
        rj.broadened(suite.isel(period=slice(None, None, -1)))
