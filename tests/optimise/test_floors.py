"""Targets on secondary systems of floors: margins, their derivatives, invalid inputs."""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import optimise
import rockjax as rj
from rockjax import _results as results

PODIUM = rj.Podium(0.15, 1.5, 10.0, rj.Elastic(30.0, 0.5), restitution="compatible")
SUITE = [rj.Ricker(2.4, 1.0), rj.Ricker(3.0, 0.8)]
BLOCKS = rj.Contents(0.4, 0.5), rj.Contents(0.1, 0.8)
OSCILLATORS = rj.Oscillator(0.3), rj.Oscillator(0.3, direction="vertical")
OPTIONS = rj.Options(rtol=1e-10, atol=1e-12)
ENDS = results.SETTLED, results.OUT_OF_STEPS
TARGETS = optimise.ContentsRotation(0.5, SUITE, BLOCKS), optimise.FloorSpectrum(9.0, SUITE, OSCILLATORS)


class Answer(NamedTuple):
    peak_rotation: Any
    margin: Any
    pseudo_acceleration: Any
    overturned: Any
    result: Any
    on_floors: tuple


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS, ids=lambda target: type(target).__name__)
def test_margins_and_their_derivatives(target):
    """Margins agree with single scenes, and derivatives with differences, also for a block that overturns."""
    options = OPTIONS

    def margins(alpha):
        return target.margins(dataclasses.replace(PODIUM, alpha=alpha), options)

    found = np.asarray(margins(jnp.asarray(0.15)))
    peaks = [rj.peak_response(PODIUM, motion, options=options, on_floors=target.systems) for motion in SUITE]
    name = "peak_rotation" if isinstance(target, optimise.ContentsRotation) else "pseudo_acceleration"
    sizes = [float(getattr(answer, name)) for peak in peaks for answer in peak.on_floors]
    stands = found > (target.limit - 1) / target.limit if name == "peak_rotation" else np.ones(4, bool)
    np.testing.assert_allclose(found[stands], (1 - np.array(sizes) / target.limit)[stands], rtol=1e-7)
    slope = np.asarray(jax.jacfwd(margins)(jnp.asarray(0.15)))
    h = 1e-6  # with a larger difference another impact starts the second block
    difference = np.asarray(margins(jnp.asarray(0.15 + h)) - margins(jnp.asarray(0.15 - h))) / (2 * h)
    np.testing.assert_allclose(slope, difference, rtol=1e-5, atol=1e-5)
    assert np.all(slope != 0)


def test_only_the_motion_that_overturns_the_columns_limits_margins():
    """The margins of a motion are consecutive, one for each block."""
    target = optimise.ContentsRotation(0.5, [rj.Ricker(8.0, 1.0), rj.Ricker(0.5, 1.0)], BLOCKS)
    margins = np.asarray(target.margins(PODIUM, OPTIONS))
    assert margins.shape == (4,)
    assert np.all(margins[:2] < 0)
    np.testing.assert_array_equal(margins[2:], 1.0)  # under the weak motion neither block rocks


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: type(target).__name__)
def test_margins_of_systems_without_an_answer_are_nan(target, monkeypatch):
    """The simulation of the second system does not finish."""

    def respond(podium, motion, *, options, on_floors):
        zero = motion.T_p * 0
        has_ended, has_not = (results.result_of(zero.astype(int) + code) for code in ENDS)
        answer = Answer(zero, zero + 1, zero, zero > 0, has_ended, ())
        return answer._replace(on_floors=(answer, answer._replace(result=has_not)))

    monkeypatch.setattr(rj, "peak_response", respond)
    np.testing.assert_array_equal(target.margins(PODIUM, OPTIONS), [1.0, np.nan] * 2)


def test_bad_input_is_named():
    for make, words in (
        (lambda: optimise.ContentsRotation(1.0, SUITE, BLOCKS), "limit must be"),
        (lambda: optimise.ContentsRotation(0.5, SUITE, OSCILLATORS), "contents must be"),
        (
            lambda: optimise.ContentsRotation(0.5, SUITE, rj.Contents(0.2, 0.5, overturn_ratio=1.1)),
            "overturn_ratio of contents must be <= 1",
        ),
        (lambda: optimise.FloorSpectrum(0.0, SUITE, OSCILLATORS), "limit must be"),
        (lambda: optimise.FloorSpectrum(3.0, SUITE, ()), "oscillators must be"),
    ):
        with pytest.raises(ValueError, match=words):
            make()
