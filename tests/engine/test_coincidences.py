"""Events, breakpoints and ends of scenes that coincide up to rounding: answers and derivatives are
continuous.

Each scene is a vmapped batch over the distance between two times, from units in the last place to larger
distances. If the ground motion jumps at an impact, the one-sided derivatives differ, and the derivative must
equal one of them.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from tests.scenes import G, options, shaking

TIGHT_OPTIONS = options(1e-12, "dopri8", history=256, throw=False)
ULPS = (-64, -5, -2, -1, 0, 1, 2, 5, 64)
FAR_OFFSET = 1e-9  # reference distance for the comparisons


def around(x: float) -> np.ndarray:
    """Return times around x at distances of units in the last place, and one time before and one after at
    FAR_OFFSET."""
    return np.array([x - FAR_OFFSET, *(x + k * np.spacing(x) for k in ULPS), x + FAR_OFFSET])


def side_by_side(function, y, times) -> tuple[np.ndarray, np.ndarray]:
    """Return `function(y, time)` and its Jacobian with respect to y at all times, from one solution."""

    def at(time):
        def twice(y):
            value = function(y, time)
            return value, value

        slopes, values = jax.jacfwd(twice, has_aux=True)(y)
        return values, slopes

    values, slopes = jax.jit(jax.vmap(at))(jnp.asarray(times))
    return np.asarray(values), np.asarray(slopes)


def continuous(function, y, times, rtol: float = 1e-6) -> np.ndarray:
    """Check that `function(y, time)`, an array of answers, and its Jacobian with respect to y are continuous.
    Return the Jacobians."""
    values, slopes = side_by_side(function, y, times)
    assert np.all(np.isfinite(values))
    assert np.all(np.isfinite(slopes))
    scale = np.abs(values).max(axis=0) + np.abs(slopes).max(axis=(0, 2))
    assert np.all(np.abs(values - values[0]) <= 100 * FAR_OFFSET * scale)
    largest = np.abs(slopes).max(axis=(0, 2))
    apart = np.minimum(*(np.abs(slopes - slopes[k]).max(axis=2) for k in (0, -1)))
    assert np.all(apart <= rtol * largest), (apart / largest).max(axis=0)
    return slopes


def coincide(event_time, x: float) -> float:
    """Return the fixed point x = event_time(x), to rounding."""
    for _ in range(60):
        x, before = float(event_time(x)), x
        if x == before:
            break
    return x


def own_motion(kind: str):
    """Return a function (parameters, time of a breakpoint) ↦ motion."""
    count = 16
    if kind in ("kink", "jump"):
        # The impact is at a sample in the middle of the record, or at the last one, after which the ground is
        # at rest.
        samples = {
            "kink": np.r_[np.full(count, 0.5), 0.5 + 1.5 * np.sin(np.linspace(0, 6, count))],
            "jump": np.full(17, 0.3),
        }
        return lambda y, time: rj.Record(samples[kind], time / count * y[5], y[3])
    share = {"HalfSine": 2.0}.get(kind, 1.0)
    return lambda y, time: getattr(rj, kind)(0.4 * y[3], share * time * y[5])


@pytest.mark.parametrize(
    "kind",
    [
        "jump",
        *(
            pytest.param(kind, marks=pytest.mark.slow)
            for kind in ("kink", "OneSine", "HalfSine", "OneCosine")
        ),
    ],
)
@pytest.mark.slow(but=["jump"])
def test_an_impact_on_a_breakpoint(kind):
    """The state long after the impact depends continuously on all parameters."""
    motion = own_motion(kind)
    y = jnp.array([0.3, 2.0, 0.93, 1.0, 0.05, 1.0])

    def response(y, time):
        podium = rj.Podium(y[0], y[1], restitution=y[2])
        return rj.simulate(podium, motion(y, time), initial=rj.State(y[4]), t_end=2.5, options=TIGHT_OPTIONS)

    def late(y, time):
        state = response(y, time)(2.45)
        return jnp.stack([state.theta, state.theta_dot])

    impact = jax.jit(lambda time: response(y, time).impact_times[1])
    time = coincide(impact, 0.9)
    slopes = continuous(late, y, around(time))
    jumps = kind in ("jump", "OneCosine")
    assert bool(np.abs(slopes[0] - slopes[-1]).max() > 1e-5 * np.abs(slopes).max()) is jumps


@pytest.mark.slow
def test_the_end_on_a_sample_or_the_end_of_the_motion():
    """Peaks that still grow at the end have the derivative of the end time, also if the end is at a
    sample."""
    y = jnp.array([0.2, 2.0, 0.93, 2.648, 1.0, 10.0, 0.4, 1.0])
    o = options(1e-12, "dopri8", throw=False)
    samples = shaking(120, 0.05, peak=1.0).acceleration

    def peaks(y, time):
        podium = rj.Podium(y[0], y[1], 10.0, rj.Elastic(y[5], y[6], 0.05), restitution=y[2])
        peak = rj.peak_response(podium, rj.Record(samples, 0.05 * y[4], y[3]), t_end=time * y[7], options=o)
        return jnp.stack([peak.peak_rotation, peak.peak_deformation, peak.peak_shear])

    slopes = continuous(peaks, y, around(0.05 * 40))
    assert np.abs(slopes[..., 7]).min() > 1e-3  # with respect to the end time


@pytest.mark.slow
def test_the_end_on_an_uplift():
    """Deformation and shear still grow at the uplift, so their values at the end have the derivative of the
    end time."""
    y = jnp.array([0.2, 2.0, 0.93, 3.0, 10.0, 0.4, 1.0])
    o = options(1e-12, "dopri8", throw=False)

    def peak(y, time):
        podium = rj.Podium(y[0], y[1], 10.0, rj.Elastic(y[4], y[5], 0.05), restitution=y[2])
        return rj.peak_response(podium, rj.OneSine(y[3], 1.0), t_end=time * y[6], options=o)

    def peaks(y, time):
        answer = peak(y, time)
        return jnp.stack([answer.peak_deformation, answer.peak_shear])

    uplift = float(peak(y, 2.0).uplift_time)
    slopes = continuous(peaks, y, around(uplift))
    assert np.abs(slopes[..., 6]).min() > 1e-3


@pytest.mark.slow
def test_an_uplift_on_a_sample():
    """The uplift time has the derivative of the piece in which the ground acceleration exceeds the threshold,
    whether the next sample is lower or higher."""
    block, following = rj.Podium(0.2, 2.0), (0.6, 1.4)
    threshold = float(block.uplift_acceleration) * (1 + 64 * np.finfo(float).eps)
    y = jnp.array([1.0, 0.1, 0.0])

    def answers(y, scale_and_next):
        scale, after = scale_and_next
        samples = jnp.concatenate([jnp.linspace(0, 1, 5), after[None], jnp.array([2.0, -1.5, 0.3])])
        peak = rj.peak_response(
            block, rj.Record(samples, y[1], scale * y[0], y[2]), t_end=2.0, options=TIGHT_OPTIONS
        )
        return jnp.stack([peak.peak_rotation, jnp.where(peak.uplifted, peak.uplift_time, 0.0)])

    scales = threshold + np.spacing(threshold) * np.array([1, 2, 5, 64, 4_000_000])
    cases = [(scale, after) for after in following for scale in scales]
    values, slopes = side_by_side(answers, y, cases)
    np.testing.assert_allclose(values[:, 1], 0.4, rtol=1e-8)
    for same in np.split(slopes, len(following)):
        np.testing.assert_allclose(same, np.broadcast_to(same[-1], same.shape), rtol=1e-6, atol=1e-9)
        # the last increase of the record: a(t) = scale · t/(4 dt)
        np.testing.assert_allclose(same[-1, 1], [-0.4, 4.0, 1.0], rtol=1e-8)


@pytest.mark.slow
def test_the_end_before_the_first_uplift():
    """A record under an elastic superstructure, cut between two samples."""
    podium = rj.Podium(0.15, 1.5, 10.0, rj.Elastic(100.0, 0.5))
    o = rj.Options(outputs=("peak_rotation",), max_steps=1000)
    ends = np.array([0.01, 0.02, 0.315, 0.5, 0.611, 0.9])
    peaks = rj.peak_responses(podium, shaking(400, 0.02, peak=0.35 * G), t_end=ends, options=o)
    np.testing.assert_array_equal(peaks.stats.end_time, ends)
    assert not peaks.uplifted.any()
