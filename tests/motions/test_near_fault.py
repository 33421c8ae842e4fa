"""Pulses in records: fits recover given pulses, and tables are read."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj

DT = 0.01
TIMES = np.arange(0.0, 15.0, DT)
PULSE = rj.MavroeidisPapageorgiou(A=0.9, f_p=0.7, gamma=2.3, nu=1.1)


def record(noise=0.0, pulse=PULSE, at=6.0):
    wave = np.convolve(np.random.default_rng(0).normal(size=TIMES.size), np.hanning(9) / 5, "same")
    return np.asarray(pulse(jnp.asarray(TIMES - at))) + noise * wave * np.exp(-(((TIMES - 6.0) / 4.0) ** 2))


def pulse_numbers(fit):
    return np.array([float(y) for y in (fit.pulse.A, fit.pulse.f_p, fit.pulse.gamma, fit.pulse.nu, fit.time)])


@pytest.mark.parametrize("quantity", ["velocity", "displacement"])
def test_a_pulse_is_found_again(quantity):
    # Straight lines between samples differ slightly from the pulse.
    fit = rj.fit_pulse(rj.Motion(record(), DT), quantity=quantity)
    expected = [0.9, 0.7, 2.3, 1.1, 6.0]
    assert float(fit.share) > 0.9999
    assert np.allclose(pulse_numbers(fit), expected, rtol=5e-3, atol=5e-3)


def test_a_pulse_in_noise_explains_its_share_and_leaves_the_noise():
    motion = rj.Motion(record(noise=0.3), DT)
    fit = rj.fit_pulse(motion)
    assert float(fit.pulse.A) == pytest.approx(0.9, rel=0.1)
    assert float(fit.pulse.f_p) == pytest.approx(0.7, rel=0.05)
    left = motion.velocity - np.asarray(fit.velocity(motion.time))
    assert float(fit.share) == pytest.approx(1 - left @ left / (motion.velocity @ motion.velocity), abs=1e-9)
    residual = fit.residual(motion)
    assert np.abs(residual.velocity).max() < 0.5 * motion.pgv
    # No other pulse of this kind fits better.
    for name in ("A", "f_p", "gamma", "nu"):
        for factor in (0.99, 1.01):
            pulse = dataclasses.replace(fit.pulse, **{name: factor * getattr(fit.pulse, name)})
            moved = dataclasses.replace(fit, pulse=pulse)
            away = motion.velocity - np.asarray(moved.velocity(motion.time))
            assert away @ away > left @ left


def test_a_fit_has_derivatives_by_the_samples():
    samples = jnp.asarray(record(noise=0.2))
    fit = rj.fit_pulse(rj.Motion(np.asarray(samples), DT))
    direction = jnp.asarray(np.sin(3.0 * TIMES) * np.exp(-((TIMES - 6.0) ** 2)))

    def numbers(s):
        found = rj.refit_pulse(samples + s * direction, DT, fit)
        return jnp.stack([found.pulse.A, found.pulse.f_p, found.pulse.gamma, found.pulse.nu, found.time])

    both = jax.jit(lambda s: (numbers(s), jax.jacfwd(numbers)(s)))
    h = 1e-3
    (low, _), (_, slope), (high, _) = (both(s) for s in (-h, 0.0, h))
    assert np.allclose(slope, (high - low) / (2 * h), rtol=1e-4, atol=1e-6)
    assert float(jax.grad(lambda s: numbers(s)[0])(0.0)) == pytest.approx(float(slope[0]), rel=1e-9)


def test_a_table_of_pulses(tmp_path):
    path = tmp_path / "pulses.csv"
    path.write_text(
        "# two pulses\nname,A_cm_s,f_p,gamma,nu_deg\nImperial Valley,87.5,0.3,1.8,90\nKobe,70,1.1,2.2,-45\n"
    )
    pulses, names = rj.read_pulses(path)
    assert names == ("Imperial Valley", "Kobe")
    assert np.allclose(pulses.A, [0.875, 0.7])
    assert np.allclose(pulses.nu, [math.pi / 2, -math.pi / 4])
    path.write_text("A, f_p, gamma, nu, name,\n1,0.3,1.8,0,  Kobe\n,,,,\n1,1.1,2.2,0\n")
    assert rj.read_pulses(path).names == ("Kobe", "2")
    # The pulses form an ordinary batch.
    peaks = rj.peak_responses(rj.Podium(alpha=0.2, R=1.0), pulses)
    assert peaks.peak_rotation.shape == (2,)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("A,f_p,gamma,nu\n", "has no pulses"),
        ("A,f_p,gamma\n1,1,2\n", "column nu or nu_deg is missing"),
        ("A,f_p,gamma,nu\n1,fast,2,0\n", "pulse 1: f_p must be a finite number, got 'fast'"),
        ("A,f_p,gamma,nu\n1,1,0.5,0\n", "gamma must be finite and > 1"),
        ("A,f_p,gamma,nu\n1,1,2,0,5\n", ":2: the line has 5 cells, but there are 4 headings"),
        ("A,A,f_p,gamma,nu\n1,2,1,2,0\n", ":1: two columns have the same name"),
        ("A,A_cm_s,f_p,gamma,nu\n1,200,1,2,0\n", "columns A and A_cm_s exclude each other"),
    ],
)
def test_errors_of_tables_name_the_fault(tmp_path, text, words):
    path = tmp_path / "pulses.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=words):
        rj.read_pulses(path)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: rj.fit_pulse(PULSE), "samples a motion at times t"),
        (lambda: rj.fit_pulse(rj.Motion(np.zeros(10), DT)), "zero throughout"),
        (lambda: rj.fit_pulse(rj.Motion(record(), DT), quantity="jerk"), "'velocity' or 'displacement'"),
        (lambda: rj.fit_pulse(rj.Motion(record(), DT), shortest=2.0, longest=1.0), "longer than shortest"),
        (lambda: rj.fit_pulse([rj.Motion(record(), DT)] * 2), "must be one motion, got 2"),
        (lambda: rj.refit_pulse(record(), DT, PULSE), "refit_pulse: start must be a rockjax.PulseFit"),
    ],
)
def test_errors_of_fits_name_the_fault(call, words):
    with pytest.raises(ValueError, match=words):
        call()
