"""Tendons, dampers and inerters: exact statements, an independent integrator, balances, derivatives, bad
input."""

import math
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import rockjax as rj
from rockjax._engine import bounds, energy, model
from rockjax._engine.coefficients import coefficients
from rockjax._engine.energy import potential, potential_slope
from rockjax._problem.models import ByRatios
from rockjax._problem.reading import Reader
from rockjax._responses.datasets import describe_podium, podium_of
from tests import restrained
from tests.restrained import Frame

S: dict[str, Any] = {"alpha": 0.15, "R": 1.5, "gamma": 10.0}
ELASTIC = rj.Elastic(30.0, 0.5, 0.05)
EXACT = rj.Options(rtol=1e-12, atol=1e-14, outputs=("peak_rotation", "impacts"))
TIGHT_OPTIONS = rj.Options(
    rtol=1e-10, atol=1e-12, outputs=("peak_rotation", "peak_deformation", "peak_shear")
)


def podium(*restrainers, **changes: Any) -> rj.Podium:
    return rj.Podium(**(S | changes), restrainers=restrainers)


def all_three(tau=5.0, kappa=100.0, delta=4.0, nu=1.0, mu=8.0, **changes) -> rj.Podium:
    return podium(rj.Tendon(tau, kappa), rj.Damper(delta, nu), rj.Inerter(mu), **changes)


def free(structure, theta=0.0, theta_dot=0.0, t_end=6.0, options=EXACT):
    return rj.simulate(structure, rj.Rest(), initial=rj.State(theta, theta_dot), t_end=t_end, options=options)


# Closed forms


@pytest.mark.parametrize(
    ("structure", "name", "exact"),
    [
        (podium(), "uplift_acceleration", 1.482130186171379),
        (podium(rj.Tendon(5.0)), "uplift_acceleration", 2.187906465300608),
        (
            podium(rj.Tendon(2.0), rj.Damper(1.0), rj.Tendon(3.0, 9.0)),
            "uplift_acceleration",
            2.187906465300608,
        ),
        (podium(rj.Tendon(5.0)), "critical_stiffness", 232.4514153740789),
        (podium(rj.Damper(5.0)), "stability_angle", 0.15),
        (podium(rj.Tendon(0.0, 50.0)), "stability_angle", 0.1902249841535792),
        (podium(rj.Tendon(0.0, 100.0)), "stability_angle", 0.2592712523947803),
        (podium(rj.Tendon(0.0, 200.0)), "stability_angle", 0.8250349923859814),
        (podium(rj.Tendon(0.0, 232.4514153740789)), "stability_angle", math.pi / 2),
        (podium(rj.Tendon(0.0, 233.0)), "stability_angle", math.inf),
        (podium(rj.Tendon(5.0)), "stability_angle", 0.2207869476249633),
        (podium(rj.Tendon(20.0)), "stability_angle", 0.4317502160435035),
        (podium(rj.Tendon(5.0, 100.0)), "stability_angle", 0.3794535783373761),
        (podium(), "restitution_factor", 0.9556966787294318),
        (podium(rj.Inerter(8.0)), "restitution_factor", 0.9224590893959554),
        (podium(rj.Inerter(442.2192592357325)), "restitution_factor", 0.0),
        (podium(rj.Inerter(8.0), superstructure=ELASTIC), "restitution_factor", 0.9468055126586563),
        (
            podium(rj.Inerter(8.0), superstructure=ELASTIC, restitution="compatible"),
            "restitution_factor",
            0.8072772352569547,
        ),
        (podium(rj.Inerter(8.0), superstructure=ELASTIC), "uplifted_frequency", 23.91900220170046),
        (
            podium(rj.Inerter(8.0), rj.Tendon(0.0, 200.0), superstructure=ELASTIC),
            "uplifted_frequency",
            23.95853960689648,
        ),
    ],
)
def test_exact_numbers(structure, name, exact):
    assert float(getattr(structure, name)) == pytest.approx(exact, rel=1e-13, abs=1e-14)


def test_uplift_follows_the_slow_ground_motion():
    # Quasi-statically all masses move with the ground: g tan α (1 + τ/w).
    for top in (None, rj.Rigid(30.0), ELASTIC):
        structure = podium(rj.Tendon(5.0), superstructure=top)
        w = 10.5 + (0 if top is None else 30.0)
        expected = 9.80665 * math.tan(0.15) * (1 + 5 / w)
        assert float(structure.uplift_ground_acceleration) == pytest.approx(expected, rel=1e-14)


def test_elongation():
    c = coefficients(podium(rj.Tendon(1.0)))
    for theta in (0.1, -0.1):
        found = model.elongation(c, jnp.sign(theta), jnp.asarray(theta))
        assert 1.5 * float(found.stretch) == pytest.approx(0.04481276231035240, rel=1e-15)
        slope = jax.grad(lambda a, s=np.sign(theta): model.elongation(c, jnp.asarray(s), a).stretch)(theta)
        assert float(found.lever) == pytest.approx(float(slope), rel=1e-14)


def test_one_joint_is_half_as_long():
    """Fact 2, from the energy of a spring of stiffness 1: ½ (ℓ/R)²."""
    for joints, length in ((2, 0.04481276231035240), (1, 0.02240638115517620)):
        tendon = rj.Tendon(0.0, 1.0, joints=joints)
        stretch = model.elongation(coefficients(podium(tendon)), jnp.ones(()), jnp.asarray(0.1)).stretch
        assert 1.5 * math.sqrt(2 * float(tendon.potential(stretch))) == pytest.approx(length, rel=1e-15)


def test_one_joint_is_the_table_of_equivalents():
    stretch, rate, slip = jnp.asarray(0.02), jnp.asarray(0.3), jnp.asarray(1e-9)
    pairs = (
        (rj.Tendon(6.0, 40.0, joints=1), rj.Tendon(3.0, 10.0)),
        (rj.Damper(4.0, 0.5, joints=1), rj.Damper(4.0 / 2**1.5, 0.5)),
        (rj.Damper(4.0, joints=1), rj.Damper(1.0)),
    )
    for one, both in pairs:
        assert float(one.force(stretch, rate, slip)) == pytest.approx(
            float(both.force(stretch, rate, slip)), rel=1e-13
        )
        assert float(one.potential(stretch)) == pytest.approx(float(both.potential(stretch)), rel=1e-14)
        assert float(one.power(rate, slip)) == pytest.approx(float(both.power(rate, slip)), rel=1e-13)
    assert float(podium(rj.Inerter(8.0, joints=1)).restitution_factor) == float(
        podium(rj.Inerter(2.0)).restitution_factor
    )


def test_potential_and_its_slope():
    tau, kappa, w, s, R, g = 5.0, 100.0, 10.5, math.sin(0.15), 1.5, 9.80665
    c = coefficients(podium(rj.Tendon(tau, kappa)))
    for A in (1e-9, 0.05, 0.3, 1.2):
        V = (
            R
            * g
            * 4
            * math.sin(A / 2)
            * (w * math.sin(0.15 - A / 2) + tau * s + 2 * kappa * s**2 * math.sin(A / 2))
        )
        slope = (
            R
            * g
            * (2 * w * math.sin(0.15 - A) + 2 * tau * s * math.cos(A / 2) + 4 * kappa * s**2 * math.sin(A))
        )
        for side in (1.0, -1.0):
            assert float(potential(c, jnp.asarray(side), jnp.asarray(side * A))) == pytest.approx(
                V, rel=1e-13
            )
        assert float(potential_slope(c, jnp.asarray(A))) == pytest.approx(slope, rel=1e-13)
    assert float(potential(c, jnp.zeros(()), jnp.zeros(()))) == 0


def turns(response: rj.Response, count: int) -> list[float]:
    """Return |θ| at the first turning points between impacts."""
    times = [float(t) for t in response.impact_times[: count + 1]]
    speed = lambda t: float(response(t).theta_dot)
    at: list[Any] = [brentq(speed, a + 1e-6, b - 1e-6, xtol=1e-14) for a, b in pairwise(times)]
    return [abs(float(response(t).theta)) for t in at]


def test_free_rocking_without_dampers():
    """Fact 10: peaks V(θ_k) = e^(2k) V(θ_0) and impact times by quadrature. Fact 12: an initial velocity at θ
    = 0."""
    structure = podium(rj.Tendon(5.0, 100.0), rj.Inerter(8.0))
    response = free(structure, 0.12, t_end=4.0)
    exact = [0.6714846049952811, 1.853861181248221, 2.906731325298647, 3.851639334878372]
    np.testing.assert_allclose(response.impact_times[:4], exact, rtol=0, atol=2e-11)
    c, e = coefficients(structure), float(structure.restitution_factor)
    V = lambda A: float(potential(c, jnp.ones(()), jnp.asarray(A)))
    peaks = (0.09889978020873698, 0.08210706439530056)
    np.testing.assert_allclose(turns(response, 2), peaks, rtol=1e-10)
    for k, peak in enumerate(peaks, start=1):
        assert V(peak) == pytest.approx(e ** (2 * k) * V(0.12), rel=1e-13)
    kicked = free(structure, 0.0, 0.4)
    assert float(kicked.peak_rotation) * 0.15 == pytest.approx(0.1344072677336077, rel=2e-12)


@pytest.mark.parametrize(
    ("theta", "ratio"), [(1e-2, 1.010834330638666), (1e-4, 1.000106434461270)], ids=["1e-2", "1e-4"]
)
def test_small_rocking_has_a_quarter_period_of_its_own(theta, ratio):
    """Fact 11: √(2θ_0/a_0) with a_0 = 2g(w+τ) sin α/(R J(0)), times a factor for the finite rotation."""
    structure, s = podium(rj.Tendon(5.0, 100.0), rj.Inerter(8.0)), math.sin(0.15)
    J = 1 + 1 / 3 + 4 * 10 + 4 * 8 * s**2
    quarter = math.sqrt(2 * theta / (2 * 9.80665 * (10.5 + 5) * s / (1.5 * J)))
    response = free(structure, theta, t_end=1.5 * quarter)
    assert float(response.impact_times[0]) == pytest.approx(ratio * quarter, rel=1e-11)


def test_stiffness_alone_is_a_block_of_another_slenderness():
    """Fact 13: stiffness without prestress acts like another slenderness."""
    response = free(podium(rj.Tendon(0.0, 100.0), rj.Inerter(0.0), restitution=0.9), 0.12, t_end=5.0)
    np.testing.assert_allclose(
        response.impact_times[:2], [0.8881320405066459, 2.322148878570861], rtol=0, atol=2e-11
    )
    np.testing.assert_allclose(turns(response, 2), (0.09058844276080437, 0.07006119462903617), rtol=1e-10)


@pytest.mark.parametrize(
    ("structure", "impact", "taken", "within"),
    [
        (podium(rj.Damper(4.0)), 1.2633101941107874, 0.22129734707364254, 1e-11),
        (podium(rj.Damper(4.0, 0.5)), 1.3196453142216, 1.2886115576640, 1e-9),
        (all_three(), 0.6732724051589194, 0.4140209814315648, 1e-11),
    ],
    ids=["linear", "square root", "with tendons and inerters"],
)
@pytest.mark.slow(but=["square root"])
def test_energy_dissipated_by_dampers(structure, impact, taken, within):
    response = free(structure, 0.12, t_end=6.0)
    assert float(response.impact_times[0]) == pytest.approx(impact, abs=20 * within)
    assert float(response.damper_energy(6.0)) == pytest.approx(taken, abs=20 * within)
    energies = response.energies(np.linspace(0, 6, 50))
    assert np.max(np.abs(energies.residual)) < 20 * within
    assert np.all(np.diff(energies.dampers) >= 0)


# Independent integration

SCENES = {
    "all": (Frame(tau=5.0, kappa=100.0, delta=4.0, mu=8.0), all_three(), 3.2),
    "power law": (Frame(tau=5.0, kappa=100.0, delta=4.0, nu=0.5, mu=8.0), all_three(nu=0.5), 3.6),
    "elastic": (
        Frame(modes=((30.0, 0.5, 0.05),), tau=5.0, kappa=300.0, delta=4.0, mu=8.0),
        all_three(kappa=300.0, superstructure=ELASTIC),
        3.2,
    ),
}


@pytest.mark.parametrize(
    "name", [pytest.param("all"), pytest.param("power law"), pytest.param("elastic", marks=pytest.mark.slow)]
)
@pytest.mark.slow(but=["elastic"])
def test_peaks_of_an_independent_integration(name):
    frame, structure, a_p = SCENES[name]
    answer = restrained.simulate(frame, 2.0, restrained.one_sine(a_p, 0.8), breaks=(0.8,), rest=1e-8)
    peak = rj.peak_response(structure, rj.OneSine(a_p, 0.8), t_end=2.0, options=TIGHT_OPTIONS)
    restrained.check_peaks(peak, answer, frame, rotation=2e-9)


def test_defaults_are_near_too():
    frame, structure, a_p = SCENES["power law"]
    answer = restrained.simulate(frame, 2.0, restrained.one_sine(a_p, 0.8), breaks=(0.8,), rest=1e-8)
    options = rj.Options(outputs=("peak_rotation",))
    assert float(
        rj.peak_response(structure, rj.OneSine(a_p, 0.8), options=options).peak_rotation
    ) == pytest.approx(answer.peak, abs=1e-6)


@pytest.mark.slow
def test_segments_engine():
    structure, options = (
        all_three(),
        rj.Options(rtol=1e-10, atol=1e-12, engine="segments", outputs=("peak_rotation",)),
    )
    motion = rj.OneSine(3.2, 0.8)
    flat = rj.peak_response(structure, motion, options=TIGHT_OPTIONS)
    assert float(rj.peak_response(structure, motion, options=options).peak_rotation) == pytest.approx(
        float(flat.peak_rotation), abs=1e-9
    )


# Exact statements about scenes


def test_nothing_added_changes_nothing():
    motion = rj.OneSine(2.2, 0.8)
    bare = rj.peak_response(podium(), motion, options=TIGHT_OPTIONS)
    zero = rj.peak_response(all_three(0.0, 0.0, 0.0, 1.0, 0.0), motion, options=TIGHT_OPTIONS)
    assert float(bare.peak_rotation) < 1
    assert float(zero.peak_rotation) == pytest.approx(float(bare.peak_rotation), rel=1e-11)
    assert float(zero.uplift_time) == float(bare.uplift_time)


def test_a_podium_without_restrainers_does_not_look_at_them(monkeypatch):
    def never(*_):
        raise AssertionError("restrainers were looked at")

    for name in ("elongation", "_restraint"):
        monkeypatch.setattr(model, name, never)
    monkeypatch.setattr(bounds, "restraint_bound", never)
    monkeypatch.setattr(energy, "elongation", never)
    from rockjax._engine.solve import _solve

    for top in (None, ELASTIC):
        options = rj.Options(outputs=("peak_rotation", "margin"))
        trace = lambda podium, options=options: _solve(
            podium, rj.OneSine(2.2, 0.8), rj.State(), None, options
        )
        jax.make_jaxpr(trace)(podium(superstructure=top))
    with pytest.raises(AssertionError, match="looked at"):
        jax.make_jaxpr(trace)(podium(rj.Damper(1.0)))


def test_only_prestress_moves_uplift():
    motion = rj.OneSine(3.2, 0.8)
    time = lambda *args: float(rj.peak_response(all_three(*args), motion, options=TIGHT_OPTIONS).uplift_time)
    assert time(5.0, 0.0, 0.0, 1.0, 0.0) == time(5.0, 400.0, 9.0, 1.0, 20.0)


@pytest.mark.slow
def test_equivalent_block_goes_on():
    structure = all_three(nu=0.5, superstructure=rj.Rigid(3.0), lam=0.4)
    motion = rj.OneSine(3.6, 0.8)
    frame, block = (
        rj.peak_response(y, motion, options=TIGHT_OPTIONS) for y in (structure, structure.equivalent_block())
    )
    assert 0.1 < float(frame.peak_rotation) < 1
    assert float(block.peak_rotation) == pytest.approx(float(frame.peak_rotation), rel=1e-8)


def test_mirror():
    structure, options = all_three(), TIGHT_OPTIONS
    one, other = (rj.peak_response(structure, rj.OneSine(a, 0.8), options=options) for a in (3.2, -3.2))
    assert float(one.peak_rotation) == pytest.approx(float(other.peak_rotation), rel=1e-13)


def test_energy_only_falls_without_ground_motion():
    E = np.asarray(free(all_three(), 0.12, options=EXACT).energy(np.linspace(0, 6, 400)))
    assert np.all(np.diff(E) <= 1e-12)


@pytest.mark.slow
def test_settled_answers_stand():
    """With the deeper potential well, scenes that the certificate ends early have the answers of complete
    scenes."""
    motion = rj.OneSine(np.linspace(2.5, 5.5, 12), 0.8)
    structure = all_three(delta=0.5)
    short = rj.peak_responses(structure, motion, options=TIGHT_OPTIONS)
    complete = rj.peak_responses(
        structure, motion, options=TIGHT_OPTIONS.replace(outputs=("peak_rotation", "peak_shear", "impacts"))
    )
    np.testing.assert_allclose(short.peak_rotation, complete.peak_rotation, rtol=1e-12)
    np.testing.assert_array_equal(short.overturned, complete.overturned)
    assert 0 < np.sum(short.overturned) < 12
    assert np.sum(short.stats.steps) < 0.8 * np.sum(complete.stats.steps)


# Overturning


def test_a_stiff_tendon_brings_columns_back_from_any_rotation():
    structure = podium(rj.Tendon(1.0, 300.0), rj.Inerter(0.0))
    options = EXACT.replace(overturn_ratio=math.pi / 2 / 0.15)
    assert math.isinf(float(structure.stability_angle))
    peak = rj.peak_response(structure, rj.Rest(), initial=rj.State(theta_dot=1.5), t_end=9.0, options=options)
    assert not peak.overturned
    assert peak.exceeded_alpha
    c = coefficients(structure)
    energy = 0.5 * float(c.spin) * 1.5**2
    highest = potential(c, jnp.ones(()), peak.peak_rotation * 0.15)
    assert float(highest) == pytest.approx(energy, rel=1e-11)


def test_tendons_at_the_critical_stiffness():
    """Just below, at and above κ_cr, columns with an initial velocity turn at the rotation that V predicts,
    up to π/2, and fall beyond the top of V."""
    critical, ratio = float(podium().critical_stiffness), 0.5 * math.pi / 0.15
    options = EXACT.replace(overturn_ratio=ratio)
    angles = []
    for change in (-1e-9, 0.0, 1e-9):
        structure = podium(rj.Tendon(0.0, critical * (1 + change)), rj.Inerter(0.0))
        angles.append(float(structure.stability_angle))
        c = coefficients(structure)
        # V/(2Rgw sin α) is sin A at κ_cr; the rest is the change with κ.
        V = lambda A, change=change: math.sin(A) + change * (1 - math.cos(A)) / math.tan(0.15)
        for height, overturns in ((0.3, False), (0.999, False), (1.001, True)):
            speed = math.sqrt(height * 2 * 1.5 * 9.80665 * 10.5 * math.sin(0.15) / (0.5 * float(c.spin)))
            kick = rj.State(theta_dot=speed)
            peak = rj.peak_response(structure, rj.Rest(), initial=kick, t_end=9.0, options=options)
            assert bool(peak.overturned) is overturns
            if not overturns:
                turn = brentq(lambda A, V=V, height=height: V(A) - height, 0.0, 1.6, xtol=1e-15)
                assert float(peak.peak_rotation) * 0.15 == pytest.approx(turn, rel=1e-10)
    # tan θ_s = sin α/(cos α − 2κ sin²α/w)
    assert angles[0] == pytest.approx(0.5 * math.pi - 1e-9 / math.tan(0.15), abs=1e-14)
    assert angles[1] == pytest.approx(0.5 * math.pi, abs=1e-14)
    assert math.isinf(angles[2])


@pytest.mark.parametrize("nu", [0.999999, 0.5, 0.25])
def test_steep_dampers_at_turning_points(nu):
    """Columns are released from a rotation, where the slope of the damper force is infinite, and pass turning
    points on both sides. The reference restarts the integration at each turning point."""
    response = free(podium(rj.Damper(1.0, nu)), 0.12, t_end=6.0)
    answer = restrained.simulate(Frame(delta=1.0, nu=nu), 6.0, state=(0.12,), rest=1e-8)
    few = answer.impacts[:3]
    assert len(few) == 3
    np.testing.assert_allclose(response.impact_times[:3], few, rtol=0, atol=2e-9)
    assert np.all(np.diff(response.damper_energy(np.linspace(0, 6, 100))) >= 0)
    assert float(response.damper_energy(6.0)) == pytest.approx(answer.damper, abs=2e-8)


@pytest.mark.slow
def test_margin_has_the_sign_of_the_verdict_up_to_the_stability_angle():
    structure = podium(rj.Tendon(5.0), rj.Damper(0.2))
    ratio = float(structure.stability_angle) / 0.15
    options = rj.Options(outputs=("peak_rotation", "margin"), overturn_ratio=ratio)
    peaks = rj.peak_responses(structure, rj.OneSine(np.linspace(2.0, 6.0, 30), 0.8), options=options)
    assert 3 < np.sum(peaks.overturned) < 27
    np.testing.assert_array_equal(peaks.margin < 0, peaks.overturned)
    assert np.all(peaks.margin[peaks.stats.steps == 1] == 1)
    # At rest at the top of the potential well the margin is zero.
    low = rj.peak_response(structure, rj.Rest(), initial=rj.State(theta=0.9 * 0.15 * ratio), options=options)
    V = lambda A: float(potential(coefficients(structure), jnp.ones(()), jnp.asarray(A)))
    assert float(low.margin) == pytest.approx(1 - V(0.9 * 0.15 * ratio) / V(0.15 * ratio), rel=1e-9)


@pytest.mark.slow
def test_boundary_with_tendons():
    structure = podium(rj.Tendon(5.0), rj.Damper(0.2))
    options = rj.Options(rtol=1e-10, atol=1e-12)
    boundary = rj.overturning_boundary(structure, rj.OneSine(1.0, 0.8), max_scale=6.0, options=options)
    scale = float(boundary.scale)
    low, high = (
        restrained.simulate(
            Frame(tau=5.0, delta=0.2), 4.0, restrained.one_sine(a, 0.8), breaks=(0.8,), rest=1e-8
        )
        for a in (scale * (1 - 2e-8), scale * (1 + 2e-8))
    )
    assert low.peak < 1 < high.peak  # V' > 0 at α, so the peak passes the limit with a finite slope


# Derivatives


def test_derivatives_by_every_number_of_a_restrainer():
    motion, values = rj.OneSine(3.6, 0.8), jnp.array([5.0, 100.0, 4.0, 0.5, 8.0])

    def peak(numbers):
        return rj.peak_response(all_three(*numbers), motion, t_end=2.0, options=TIGHT_OPTIONS).peak_rotation

    forward, reverse = jax.jacfwd(peak)(values), jax.jacrev(peak)(values)
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)

    def other(numbers):
        frame = Frame(**dict(zip(("tau", "kappa", "delta", "nu", "mu"), map(float, numbers), strict=True)))
        return restrained.simulate(frame, 1.6, restrained.one_sine(3.6, 0.8), breaks=(0.8,), rest=1e-8).peak

    for k, y in enumerate(np.asarray(values)):
        h = 1e-3 * y
        at = [other(np.asarray(values) + step * h * np.eye(5)[k]) for step in (-2, -1, 1, 2)]
        slope = (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * h)
        assert float(forward[k]) == pytest.approx(slope, rel=2e-6, abs=1e-9)


@pytest.mark.slow
def test_size_and_time_scale():
    """Fact 22: R → sR with all times × √s changes no rotation, so 2R ∂_R + T_p ∂_{T_p} of the peak is 0."""

    def peak(R, T_p):
        return rj.peak_response(
            all_three(nu=0.5, R=R), rj.OneSine(3.6, T_p), t_end=2.0, options=TIGHT_OPTIONS
        ).peak_rotation

    by_R, by_T = jax.grad(peak, (0, 1))(1.5, 0.8)
    assert 2 * 1.5 * float(by_R) + 0.8 * float(by_T) == pytest.approx(0, abs=1e-7 * abs(float(by_T)))
    # Energies are multiplied by s.
    small, large = (free(all_three(R=1.5 * s), 0.12, t_end=2.0 * math.sqrt(s)) for s in (1.0, 4.0))
    assert float(large.damper_energy(4.0)) == pytest.approx(4 * float(small.damper_energy(2.0)), rel=1e-11)


def test_stability_angle_has_derivatives():
    angle = lambda tau, kappa: podium(rj.Tendon(tau, kappa)).stability_angle
    by_tau, by_kappa = jax.grad(angle, (0, 1))(5.0, 100.0)
    h = 1e-3
    assert float(by_tau) == pytest.approx(
        float(angle(5 + h, 100.0) - angle(5 - h, 100.0)) / (2 * h), rel=1e-6
    )
    assert float(by_kappa) == pytest.approx(
        float(angle(5.0, 100 + h) - angle(5.0, 100 - h)) / (2 * h), rel=1e-6
    )


# Types of arguments


def test_from_dimensions():
    N, mass = 4, 700.0
    structure = rj.Podium.from_dimensions(
        0.45, 3.0, mass, beam_mass=N * 7000.0, columns=N, tendon_force=2e4, tendon_stiffness=3e6,
        damper_coefficient=5e3, damper_exponent=0.5, inertance=5600.0,
    )  # fmt: skip
    R, g = float(structure.R), 9.80665
    tendon, damper, inerter = structure.restrainers
    assert isinstance(tendon, rj.Tendon)
    assert isinstance(damper, rj.Damper)
    assert isinstance(inerter, rj.Inerter)
    assert float(tendon.prestress) == pytest.approx(2e4 / (mass * g), rel=1e-14)
    assert float(tendon.stiffness) == pytest.approx(3e6 * R / (mass * g), rel=1e-14)
    assert float(damper.coefficient) == pytest.approx(
        5e3 * (R * float(structure.p)) ** 0.5 / (mass * g), rel=1e-14
    )
    assert float(damper.exponent) == 0.5
    assert float(inerter.inertance) == pytest.approx(8.0, rel=1e-14)
    linear = rj.Podium.from_dimensions(0.45, 3.0, mass, damper_coefficient=5e3)
    (damper,) = linear.restrainers
    assert isinstance(damper, rj.Damper)
    assert damper.linear
    assert float(damper.coefficient) == pytest.approx(0.75 * 5e3 / (mass * float(linear.p)), rel=1e-14)
    assert rj.Podium.from_dimensions(0.45, 3.0, mass).restrainers == ()


def test_linear_dampers_have_no_exponent_in_the_program():
    assert len(jax.tree.leaves(rj.Damper(4.0))) == 1
    assert len(jax.tree.leaves(rj.Damper(4.0, 0.5))) == 2
    assert rj.Damper(4.0).exponent == 1.0
    assert not rj.Damper(4.0, jnp.ones(())).linear


def test_written_and_read_again():
    structure = all_three(nu=0.5, superstructure=ELASTIC)
    assert repr(podium_of(describe_podium(structure))) == repr(structure)
    assert "Tendon" in structure._repr_html_()
    assert "prestress" in structure._repr_html_()
    data = free(all_three(), 0.12).dataset()
    assert float(data["damper_energy"][-1]) == pytest.approx(0.4140209814315648, abs=1e-9)
    assert "damper_energy" not in free(podium(), 0.12).dataset()


def test_problem_files():
    read = lambda table: Reader().structure(Reader().check(ByRatios, table))
    column = {"alpha": 0.15, "R": 1.5, "gamma": 10.0}
    structure = read(
        column | {"stiffness": 100.0, "prestress": 5.0, "coefficient": 4.0, "inertance_ratio": 8.0}
    )
    assert repr(structure) == repr(all_three())
    assert repr(read(column | {"stiffness": 100.0}).restrainers) == repr((rj.Tendon(0.0, 100.0),))
    assert read(column).restrainers == ()
    with pytest.raises(ValueError, match="exponent also needs coefficient"):
        read(column | {"exponent": 0.5})
    with pytest.raises(ValueError, match="prestress: must be a number >= 0"):
        read(column | {"prestress": -1.0})


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rj.Tendon(-1.0), "Tendon: prestress must be finite and >= 0, got prestress = -1.0"),
        (lambda: rj.Tendon(1.0, math.inf), "Tendon: stiffness must be finite"),
        (lambda: rj.Damper(math.nan), "Damper: coefficient must be finite"),
        (lambda: rj.Damper(1.0, 0.0), r"Damper: exponent must be in \(0, 1\], got exponent = 0.0"),
        (lambda: rj.Damper(1.0, 1.5), "Damper: exponent"),
        (lambda: rj.Inerter(-2.0), "Inerter: inertance"),
        (lambda: rj.Inerter(2.0, joints=3), "Inerter: joints must be 1 or 2, got joints = 3"),
        (lambda: rj.Tendon(2.0, joints=True), "Tendon: joints"),
        (lambda: rj.Podium(0.2, 2.0, restrainers=rj.Tendon(1.0)), "Podium: restrainers must be a tuple"),
        (
            lambda: rj.Podium(0.2, 2.0, restrainers=(1.0,)),
            "Podium: restrainers must be a tuple of Tendon, Damper, Inerter",
        ),
        (lambda: rj.Podium.from_dimensions(0.4, 3.0, 700.0, tendon_force=-1.0), "tendon_force"),
        (
            lambda: rj.Podium.from_dimensions(0.4, 3.0, 700.0, damper_coefficient=1.0, damper_exponent=1.05),
            "damper_exponent",
        ),
    ],
)
def test_bad_input(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_no_margin_past_the_stability_angle():
    options = rj.Options(outputs=("margin",), overturn_ratio=1.6)
    with pytest.raises(ValueError, match=r"overturn_ratio must be <= θ_s/α = 1\.47"):
        rj.peak_response(podium(rj.Tendon(5.0)), rj.OneSine(3.0, 0.8), options=options)
