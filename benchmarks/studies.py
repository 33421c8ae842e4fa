"""Design studies, each from ten random starts: `python -m benchmarks.studies [adam] [names]`, with Adam
instead of the sequential quadratic programming.

(a) the slimmest column, (b) the lightest beam, (c) the least shear, (d) a probability, (e) a fit.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable

import numpy as np
import optax

import optimise
import rockjax as rj

OPTIONS = rj.Options(rtol=1e-8, atol=1e-10, throw=False)
G = 9.80665


def shaking(seed: int, peak: float = 3.0, n: int = 350, dt: float = 0.02) -> rj.Record:
    """A synthetic near-fault record of 7 s: a velocity pulse in enveloped noise, `peak` the largest |ü_g|
    [m/s²]."""
    rng = np.random.default_rng([7, seed])
    t = dt * np.arange(n)
    period, centre = rng.uniform(0.7, 1.4), rng.uniform(2.0, 3.0)
    pulse = np.exp(-(((t - centre) / (0.8 * period)) ** 2)) * np.sin(
        2 * np.pi * (t - centre) / period + rng.uniform(0, 6)
    )
    noise = np.convolve(rng.normal(size=n), np.hanning(9), mode="same")
    noise *= np.exp(-(((t - 2.8) / 1.6) ** 2)) / np.abs(noise).max()
    a = (pulse + 0.5 * noise) * np.minimum(1, np.minimum(t, t[::-1]) / 0.5)
    return rj.Record(peak * a / np.abs(a).max(), dt)


def _slenderness(podium: rj.Podium):
    return podium.alpha


def _beam(podium: rj.Podium):
    return podium.gamma


def _random(rng: np.random.Generator, vary: dict[str, tuple[float, float]]) -> dict[str, float]:
    return {name: float(rng.uniform(low, high)) for name, (low, high) in vary.items()}


def pulses(count: int) -> list[rj.AbstractExcitation]:
    """Symmetric Ricker pulses and full sines by turns, the longer the weaker."""
    periods = np.linspace(0.6, 1.4, (count + 1) // 2)
    amplitudes = np.linspace(4.0, 2.5, len(periods))
    pairs = zip(amplitudes, periods, strict=True)
    return [kind(a, T) for a, T in pairs for kind in (rj.Ricker, rj.OneSine)][:count]


def slimmest(seed: int = 0, count: int = 6, starts: int = 1, **how) -> optimise.Design:
    """(a) The slimmest 3 m column that keeps the peak rotation under 0.4 α for a set of pulses."""
    vary = {"width": (0.2, 1.5)}
    start = optimise.Dimensions(
        height=3.0,
        column_mass=1.5e3,
        beam_mass=30e3,
        top_mass=300e3,
        period=0.5,
        **_random(np.random.default_rng(seed), vary),
    )
    target = optimise.PeakRotation(0.4, pulses(count))
    return optimise.design(
        start, vary, _slenderness, target, seed=seed, starts=starts, options=OPTIONS, **how
    )


def lightest(
    seed: int = 0, frequencies: int = 13, ratio: float = 3.2, starts: int = 1, **how
) -> optimise.Design:
    """(b) The least γ with which no symmetric Ricker pulse with 3.5 ≤ ω_p/p ≤ 5 overturns a rigid frame below
    a multiple of g tan α. Of 3.5 there is no design."""
    vary = {"gamma": (0.0, 100.0)}
    frame = rj.Podium(alpha=math.atan(0.15), R=1.5, **_random(np.random.default_rng(seed), vary))
    T_p = 2 * math.pi / (float(frame.p) * np.linspace(3.5, 5.0, frequencies))
    target = optimise.OverturningAcceleration(ratio, rj.Ricker, T_p, ratio=True, max_acceleration_ratio=8.0)
    return optimise.design(frame, vary, _beam, target, seed=seed, starts=starts, options=OPTIONS, **how)


def unreachable(seed: int = 0, **how) -> optimise.Design:
    """(b) asked for what cannot be had."""
    return lightest(seed, ratio=3.5, **how)


def least_shear(seed: int = 0, records: int = 4, starts: int = 1, **how) -> optimise.Design:
    """(c) The least worst shear with a factor of 1.5 to overturning on every record, over slenderness and
    beam mass."""
    motions = [shaking(k) for k in range(records)]
    vary = {"width": (0.3, 0.9), "beam_mass": (5e3, 100e3)}
    start = optimise.Dimensions(
        height=3.0,
        column_mass=1.5e3,
        top_mass=100e3,
        period=0.5,
        **_random(np.random.default_rng(seed), vary),
    )
    target = optimise.OverturningScale(1.5, motions, max_scale=3.0)
    return optimise.design(
        start, vary, optimise.WorstShear(motions), target, seed=seed, starts=starts, options=OPTIONS, **how
    )


def rarely(seed: int = 0, records: int = 50, starts: int = 1, **how) -> tuple[optimise.Design, float, float]:
    """(d) The slimmest column of which under 5 % of a suite overturn; and the smoothed and the counted
    probability."""
    target = optimise.OverturningProbability(
        0.05, [shaking(k) for k in range(records)], intensity=1.3, smoothing=0.05
    )
    vary = {"width": (0.25, 1.2)}
    start = optimise.Dimensions(
        height=3.0, column_mass=1.5e3, beam_mass=30e3, **_random(np.random.default_rng(seed), vary)
    )
    answer = optimise.design(
        start, vary, _slenderness, target, seed=seed, starts=starts, options=OPTIONS, **how
    )
    return answer, target.smoothed(answer.podium), target.exact(answer.podium)


def measured(seed: int = 0, noise: float = 0.01) -> tuple[rj.Podium, rj.Ricker, np.ndarray, np.ndarray]:
    """A podium, a motion and the rotation of the one under the other, with noise of a part of its largest
    value."""
    truth = rj.Podium(alpha=0.2, R=1.8, gamma=2.0, restitution=0.93)
    motion = rj.Ricker(4.5, 1.1)
    times = np.arange(-1.5, 7.0, 0.02)
    theta = np.asarray(rj.simulate(truth, motion)(times).theta)
    rng = np.random.default_rng([11, seed])
    return truth, motion, times, theta + noise * np.abs(theta).max() * rng.normal(size=len(times))


def measured_fit(seed: int = 0, noise: float = 0.01, starts: int = 4) -> optimise.Fit:
    """(e) Slenderness and restitution factor from a noisy rotation, from a random start."""
    truth, motion, times, theta = measured(seed, noise)
    vary = {"alpha": (0.12, 0.3), "restitution": (0.8, 1.0)}
    first = truth.replace(**_random(np.random.default_rng(seed), vary))
    return optimise.fit(first, vary, motion, times, theta, starts=starts, seed=seed)


METHODS = {"sqp": "sqp", "adam": optax.adam(0.02)}


def main(chosen: list[str], runs: int = 10) -> None:
    """A row per study: ten runs from random starts, failures, and what they took; the first run compiles."""
    studies: dict[str, Callable] = {
        "slimmest": slimmest,
        "lightest": lightest,
        "unreachable": unreachable,
        "least_shear": least_shear,
        "rarely": rarely,
        "measured_fit": measured_fit,
    }
    method = next((word for word in chosen if word in METHODS), "sqp")
    chosen = [word for word in chosen if word not in METHODS]
    truth = measured()[0]
    print(f"{'study':14}{'failures':>9}{'evaluations':>12}{'scenes':>8}{'s first':>8}{'s later':>8}  answers")
    for name in chosen or studies:
        rows, remarks = [], []
        for seed in range(runs):
            began = time.perf_counter()
            # A fit is by least squares.
            answer = (
                studies[name](seed) if name == "measured_fit" else studies[name](seed, method=METHODS[method])
            )
            seconds = time.perf_counter() - began
            if isinstance(answer, optimise.Fit):
                near = all(
                    abs(answer.variables[key] - value) <= 5 * answer.errors[key]
                    for key, value in (
                        ("alpha", float(truth.alpha)),
                        ("restitution", float(truth.restitution_factor)),
                    )
                )
                rows.append((not near, 0, 0, seconds))
                remarks.append(answer.rms)
                continue
            if isinstance(answer, tuple):
                answer, smoothed, counted = answer
                name_ = f"bias {smoothed - counted:+.4f}"
                print(f"  {name} {seed}: smoothed {smoothed:.4f}, counted {counted:.4f}, {name_}")
            wanted = answer.satisfied if name != "unreachable" else str(answer.result._value) == "2"
            rows.append((not wanted, answer.stats.evaluations, answer.stats.scenes, seconds))
            remarks.append(answer.objective)
        numbers = np.array(rows, float)
        later = numbers[1:] if runs > 1 else numbers
        print(
            f"{name:14}{int(numbers[:, 0].sum()):6d}/{runs:<2d}{numbers[:, 1].mean():12.1f}"
            f"{numbers[:, 2].mean():8.0f}"
            f"{numbers[0, 3]:8.1f}{later[:, 3].mean():8.2f}  "
            f"{np.array2string(np.array(remarks), precision=5)}",
            flush=True,
        )


if __name__ == "__main__":
    main(sys.argv[1:])
