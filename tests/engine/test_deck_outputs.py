"""Peak acceleration and largest velocity jump of the deck: closed forms, histories, derivatives, batches."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj

FRAME = rj.Podium(alpha=0.15, R=1.5, gamma=10.0, lam=1 / 3)
PULSE = rj.Ricker(3.2, 1.0)
BOTH = "peak_deck_acceleration", "peak_velocity_jump"
FINE = rj.Options(rtol=1e-12, atol=1e-14, rest_velocity=1e-12, outputs=BOTH)
BUILDING = rj.ShearBuilding((3.0, 3.0, 2.0), (900.0, 700.0, 500.0), modes=1)
RESTRAINERS = rj.Tendon(2.0, 20.0), rj.Damper(1.0), rj.Inerter(3.0)
PODIUMS = {
    "rigid": FRAME.replace(superstructure=rj.Rigid(5.0)),
    "elastic": FRAME.replace(superstructure=rj.Elastic(30.0, 0.5, 0.05)),
    "truncated": FRAME.replace(superstructure=BUILDING),
    "restrained": FRAME.replace(restrainers=RESTRAINERS),
    "vertical": FRAME.replace(superstructure=rj.Rigid(5.0)),
}


def answers(peak) -> list[float]:
    return [float(getattr(peak, name)) for name in BOTH]


def test_free_rocking_has_its_closed_form():
    """The supremum of |a_b| is that of the infinitely many impacts; the first impact has the largest jump."""
    peak = rj.peak_response(FRAME, rj.Rest(), initial=rj.State(theta=0.1), t_end=200.0, options=FINE)
    np.testing.assert_allclose(answers(peak), [1.472403095026547, 0.03383684907358092], rtol=1e-11)


def test_an_impact_that_ends_rocking_stops_the_deck():
    """With e = 0 the jump is the velocity before the only impact."""
    podium = FRAME.replace(restitution=0.0)
    peak = rj.peak_response(podium, rj.Rest(), initial=rj.State(theta=0.05), t_end=200.0, options=FINE)
    assert float(peak.peak_velocity_jump) == pytest.approx(0.6036118453365736, rel=1e-11)


def test_a_pulse_has_the_peaks_of_the_reference():
    peak = rj.peak_response(FRAME, PULSE, t_end=8.0, options=FINE)
    np.testing.assert_allclose(answers(peak), [1.486677823722, 0.0282409011033], rtol=1e-11)


@pytest.mark.parametrize("rest_velocity", [0.05, 0.3])
def test_jumps_include_that_of_coming_to_rest(rest_velocity):
    options = FINE.replace(rest_velocity=rest_velocity)
    peak = rj.peak_response(FRAME, PULSE, options=options)
    deck = rj.simulate(FRAME, PULSE, options=options).floor()
    assert float(peak.peak_velocity_jump) == pytest.approx(deck.peak_velocity_jump, rel=1e-10)


def test_nothing_moves_but_the_ground():
    """Without uplift, the fast-forward skips the complete motion."""
    peak = rj.peak_response(FRAME, rj.Ricker(1.0, 1.0), options=FINE)
    np.testing.assert_allclose(answers(peak), [1.0, 0.0], rtol=1e-12)


@pytest.mark.slow(but=["truncated"])
@pytest.mark.parametrize("kind", PODIUMS)
def test_peaks_agree_with_the_motion_of_the_deck(kind):
    """Peaks of a scene that ends early agree with its history and with the polynomials of the deck's
    motion."""
    podium, motion = PODIUMS[kind], PULSE
    if kind == "vertical":
        motion = rj.GroundMotion(PULSE, rj.Ricker(1.6, 0.4))
    peak = rj.peak_response(podium, motion, options=FINE)
    response = rj.simulate(podium, motion, options=FINE)
    deck = response.floor()
    assert len(deck.impulse_times) > 2
    expected = deck.peak_acceleration, deck.peak_velocity_jump
    np.testing.assert_allclose(answers(response), expected, rtol=1e-7)
    np.testing.assert_allclose(answers(peak), answers(response), rtol=1e-9)
    if kind == "truncated":  # a floor has a fraction 1 − ΣW_i of the jump of the deck
        shares = [0.5137908, 0.0185937, 0.3075188]
        jumps = [response.floor(story).peak_velocity_jump for story in (1, 2, 3)]
        np.testing.assert_allclose(jumps, float(peak.peak_velocity_jump) * np.array(shares), rtol=1e-5)


@pytest.mark.slow(but=["rigid"])
@pytest.mark.parametrize("kind", ["rigid", "elastic", "truncated", "restrained"])
def test_derivatives_agree_with_differences(kind):
    """Derivatives in forward and reverse mode, and sensitivities of a batch."""
    podium = PODIUMS[kind]

    def peaks(values):
        changed = podium.replace(alpha=values[0], R=values[1])
        peak = rj.peak_response(changed, rj.Ricker(3.2, values[2]), options=FINE)
        return jnp.stack([getattr(peak, name) for name in BOTH])

    at, h = np.array([0.15, 1.5, 1.0]), 1e-5
    steps = h * at * np.eye(3)
    differences = np.stack([np.asarray(peaks(at + y) - peaks(at - y)) / (2 * h) for y in steps], axis=1)
    forward = np.asarray(jax.jacfwd(peaks)(jnp.asarray(at))) * at
    np.testing.assert_allclose(forward, differences, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(np.asarray(jax.jacrev(peaks)(jnp.asarray(at))) * at, forward, rtol=1e-9)
    pulses = rj.Ricker(np.array([3.2, 2.5]), 1.0)
    batch = rj.peak_responses(podium, pulses, options=FINE, sensitivities=("alpha", "R"))
    found = [getattr(batch.sensitivities, name)[0] for name in BOTH]
    np.testing.assert_allclose(found, forward[:, :2], rtol=1e-6, atol=1e-8)
    if kind == "rigid":  # R → sR, T_p → √s T_p keeps accelerations and multiplies velocities by √s
        scaled = 2 * forward[:, 1] + forward[:, 2]
        np.testing.assert_allclose(scaled, [0.0, float(peaks(at)[1])], atol=1e-8)


def test_batches_have_datasets_and_estimated_errors():
    options = rj.Options(outputs=("peak_rotation", "errors", *BOTH))
    podium, sizes = PODIUMS["rigid"], np.array([1.0, 2.5, 3.2])
    data = rj.peak_responses(podium, rj.Ricker(sizes, 1.0), options=options).dataset()
    assert [data[name].attrs["units"] for name in BOTH] == ["m s-2", "m s-1"]
    fine = [answers(rj.peak_response(podium, rj.Ricker(a_p, 1.0), options=FINE)) for a_p in sizes]
    for name, exact in zip(BOTH, np.transpose(fine), strict=True):
        error = np.abs(data[name].values - exact)
        assert np.all(error <= 10 * data[f"{name}_error"].values + 1e-11)


@pytest.mark.slow
def test_both_engines_agree():
    options = rj.Options(rtol=1e-10, atol=1e-12, outputs=("peak_deck_acceleration",))
    for kind in ("rigid", "elastic"):
        flat, other = (
            rj.peak_response(PODIUMS[kind], PULSE, options=options.replace(engine=engine))
            for engine in ("flat", "segments")
        )
        np.testing.assert_allclose(other.peak_deck_acceleration, flat.peak_deck_acceleration, rtol=1e-6)
        assert flat.peak_velocity_jump is None
    with pytest.raises(ValueError, match="'peak_velocity_jump' needs engine='flat'"):
        rj.Options(engine="segments", outputs=BOTH)
