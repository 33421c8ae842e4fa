"""Skipped bounces that certainly end at rest."""

import jax
import numpy as np
import pytest

import rockjax as rj
from tests.scenes import PODIUMS, G

PODIUM = PODIUMS["rigid"]
# With a number for the restitution, all values of it share programs.
GIVEN = PODIUM.replace(restitution=float(PODIUM.restitution_factor))
OUTPUTS = ("peak_rotation", "peak_shear", "margin")
LIFTS = 0.15 * G  # ground acceleration that lifts the columns slowly: g tan α [m/s²]


def followed(options: rj.Options) -> rj.Options:
    """Return options with which no bounce is skipped, because impacts are counted."""
    return options.replace(outputs=(*options.outputs, "impacts"))


@pytest.mark.slow(but=["Ricker"])
@pytest.mark.parametrize("pulse", [rj.Ricker, rj.OneCosine])
def test_pulses_have_the_same_peaks(pulse):
    options = rj.Options(outputs=OUTPUTS)
    ratios, periods = np.linspace(1.02, 4.0, 40)[:, None], np.array([0.4, 1.0, 2.5])
    pulses = pulse(ratios * LIFTS, periods)
    found = rj.peak_responses(GIVEN, pulses, options=options)
    expected = rj.peak_responses(GIVEN, pulses, options=followed(options))
    np.testing.assert_array_equal(found.overturned, expected.overturned)
    for name in (*OUTPUTS, "peak_rotation_time", "uplift_time"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9, atol=1e-12)
    assert (found.impacts[found.overturned] <= expected.impacts[found.overturned] + 2).all()


def test_a_row_of_bounces_before_the_main_lobe_takes_few_trials():
    """Columns come to rest between two lobes of a Ricker pulse."""
    options = rj.Options(outputs=OUTPUTS)
    pulses = rj.Ricker(np.linspace(3.332, 3.345, 6), np.ones(6))
    podium = GIVEN.replace(alpha=0.15)
    found = rj.peak_responses(podium, pulses, options=options)
    expected = rj.peak_responses(podium, pulses, options=followed(options))
    assert expected.stats.steps.min() > 300
    assert found.stats.steps.max() < 100


def test_derivatives_of_pulses_are_the_same():
    """Columns come to rest after bounces, before the main lobe; derivatives in forward and reverse mode."""
    options = rj.Options(rtol=1e-11, atol=1e-13, outputs=("peak_rotation",))

    def slopes(transform, options):
        def peak(alpha, a_p):
            podium = PODIUM.replace(alpha=alpha)
            return rj.peak_response(podium, rj.Ricker(a_p, 1.0), options=options).peak_rotation

        return np.array(transform(peak, (0, 1))(float(PODIUM.alpha), 2.26 * LIFTS))

    expected = slopes(jax.jacfwd, followed(options))
    assert np.abs(expected).min() > 1e-3
    np.testing.assert_allclose(slopes(jax.grad, options), expected, rtol=1e-7)


def test_shear_after_a_motion_that_ends_with_a_jump():
    """The motion ends with a jump from a large acceleration, which causes no shear afterwards."""
    ratio, options = 2.0, rj.Options(outputs=("peak_rotation", "peak_shear"))
    pulse = rj.OneCosine(ratio * LIFTS, 0.4)
    history = rj.simulate(PODIUM, pulse, options=options)
    dense = history.base_shear(np.linspace(0, float(history.stats.end_time), 200_001)[1:])
    expected = float(np.abs(dense).max())
    assert expected < 0.8 * ratio * LIFTS / float(PODIUM.g)
    assert float(history.peak_shear) == pytest.approx(expected, rel=1e-5)
    record = rj.Record(ratio * LIFTS * np.cos(2 * np.pi * np.arange(41) / 40), 0.01)
    for shaking in (pulse, record):
        found = rj.peak_response(PODIUM, shaking, options=followed(options))
        assert float(found.peak_shear) == pytest.approx(expected, rel=1e-5)


def test_columns_lift_before_a_jump_is_felt():
    """The ground moves vertically first, so the columns are in full contact when the horizontal motion starts
    with a jump."""
    vertical = rj.Record(0.1 * np.sin(np.arange(150) / 8), 0.01, t_start=-1.0)
    motion = rj.GroundMotion(rj.OneCosine(2.0 * LIFTS, 0.4), vertical)
    options = rj.Options(outputs=("peak_rotation", "peak_shear"))
    found = float(rj.peak_response(PODIUM, motion, options=options).peak_shear)
    alone = float(rj.peak_response(PODIUM, rj.OneCosine(2.0 * LIFTS, 0.4), options=options).peak_shear)
    assert found == pytest.approx(alone, rel=0.05)


@pytest.mark.parametrize("spacing", [0.1, 1.0])
@pytest.mark.parametrize("ratio", [0.2, 0.5, 0.9, 0.99])
def test_hops_that_are_higher_than_all_before_them_are_followed(ratio, spacing):
    """Columns that are released against the ground acceleration strike the ground fast and rock far to the
    other side, where their turning point has a smaller margin."""
    record = rj.Record(np.append(np.full(4, ratio * LIFTS), 0.0), spacing)
    podium = GIVEN.replace(restitution=0.7) if ratio < 0.5 else GIVEN
    options = rj.Options(outputs=("peak_rotation", "margin"))
    for start in (1e-8, 1e-6, 1e-4):
        initial = rj.State(theta=start * podium.alpha)
        found, expected = (
            rj.peak_response(podium, record, initial=initial, options=each)
            for each in (options, followed(options))
        )
        assert (float(expected.peak_rotation) > 1.5 * start) == (ratio >= 0.5)
        assert float(found.peak_rotation) == pytest.approx(float(expected.peak_rotation), rel=1e-8)
        assert float(expected.margin) < 1
        assert float(found.margin) == pytest.approx(float(expected.margin), abs=1e-13)


def test_columns_thrown_up_by_a_jump_turn_within_their_first_step():
    """Columns start at rest, where the slope of every path is zero without a turning point."""
    record = rj.Record(LIFTS * np.array([1.06, 0.71, 0.28, -0.02, 0.0]), 0.02)
    options = rj.Options(outputs=("peak_rotation", "margin"))
    expected = rj.peak_response(PODIUM, record, options=rj.Options(method="tsit5", rtol=1e-13, atol=1e-15))
    assert 0.005 < float(expected.peak_rotation_time) < 0.01
    for rtol in (1e-4, 1e-10):
        found = rj.peak_response(PODIUM, record, options=options.replace(rtol=rtol))
        assert float(found.peak_rotation) == pytest.approx(float(expected.peak_rotation), rel=1e-6)
        assert float(found.peak_rotation_time) == pytest.approx(float(expected.peak_rotation_time), rel=1e-6)


def test_derivatives_at_the_end_of_bounces_do_not_depend_on_the_tolerance():
    """The shear is largest in the last bounces, just before the columns come to rest."""
    tendon = rj.Tendon([13.2711, 11.6865, 1.4892, 1.0], 0.0)
    damper = rj.Damper([0.0, 0.0, 0.0, 1.0], 0.7)  # takes smaller steps, also without strength
    podium = rj.Podium(
        [0.1499, 0.1946, 0.1635, 0.2],
        [1.0261, 1.3974, 6.2721, 2.0],
        0.5,
        rj.Rigid(1.0),
        restitution=[0.6731, 0.4038, 0.4367, 0.5],
        restrainers=(tendon, damper),
    )
    pulses = rj.OneSine([12.2836, 14.5636, 3.2019, 1.0], [3.2714, 3.8308, 4.7201, 1.0])

    def slopes(rtol):
        options = rj.Options(rtol=rtol, atol=1e-2 * rtol, outputs=("peak_shear",))
        peaks = rj.peak_responses(podium, pulses, options=options, sensitivities=("alpha",))
        return peaks.sensitivities.peak_shear[:3]

    expected = slopes(1e-10)
    np.testing.assert_allclose(slopes(1e-9), expected, rtol=1e-6)
    np.testing.assert_allclose(slopes(1e-13), expected, rtol=1e-6)
