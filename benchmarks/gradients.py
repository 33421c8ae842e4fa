"""Derivatives: `python -m benchmarks.gradients cost`, and `python -m benchmarks.gradients modes [scenes]`.

`cost` compares the time of the value and the gradient with respect to five parameters with the time of the
value alone. `modes` compares forward with reverse derivatives of many rigid and elastic scenes, batched by
`jax.vmap`: under pulses with respect to every scalar parameter, and under records (about twenty times fewer
scenes) with respect to all samples. For samples, it compares the forward derivative along a random direction
with the component of the reverse gradient in this direction, relative to the sum of |terms| of that
component. Where they differ by more than `CLOSE`, it repeats the forward derivative with samples changed by a
unit in the last place. `unexplained` counts differences that are more than ten times larger than the effect
of this change.
"""

from __future__ import annotations

import sys
import time

import jax
import jax.numpy as jnp
import numpy as np

import rockjax as rj

from .measure import PERIODS, family, options, podium, report, shortest_time, store_rows


def cost() -> None:
    rows = []
    settings = options(1e-8)
    for name in PERIODS:
        structure = podium(family(name, 2))
        y = jnp.array([0.15, 1.5, 10.0, 3.5, 1.0])

        def peak(y, structure=structure):
            varied = structure.replace(alpha=y[0], R=y[1], gamma=y[2])
            return rj.peak_response(varied, rj.Ricker(y[3], y[4]), options=settings).peak_rotation

        value_and_grad = jax.value_and_grad(peak)
        points = y * (1 + 0.2 * jax.random.uniform(jax.random.key(0), (256, 1)))
        cases = {
            "one scene": (peak, value_and_grad, y),
            "256 scenes": (jax.vmap(peak), jax.vmap(value_and_grad), points),
        }
        for kind, (*functions, point) in cases.items():
            times = [
                shortest_time(lambda f=jax.jit(f), y=point: jax.block_until_ready(f(y))) for f in functions
            ]
            rows.append(_row(name, kind, *times))
        # A batch in refilled lanes, on all cores.
        pulses = family(name, 40)
        motion, names = rj.Ricker(pulses.a_p, pulses.T_p), ("alpha", "R", "gamma", "a_p", "T_p")
        solve = lambda n: rj.peak_responses(podium(pulses), motion, options=settings, sensitivities=n)  # noqa: B023
        times = [shortest_time(lambda n=n: solve(n)) for n in ((), names)]  # noqa: B023
        rows.append(_row(name, f"batch of {len(pulses)}", *times))
    report("gradients", rows)


def _row(family: str, kind: str, value: float, with_gradient: float) -> dict:
    times = {"value [ms]": value * 1e3, "with gradient [ms]": with_gradient * 1e3}
    return {"family": family, "kind": kind} | times | {"ratio": with_gradient / value}


SAMPLES, DT = 60, 0.05  # number of samples and sampling interval of the records [s]
CLOSE = 1e-12  # smaller relative differences are rounding
PERTURBATIONS = 16  # number of random changes of the samples
BATCH = 256  # number of scenes in one call of a program
OPTIONS = rj.Options(max_steps=4000, throw=False)


def structure_of(y: jax.Array, elastic: bool) -> rj.Podium:
    """Return the podium with the parameters y = (α, R, γ, η), followed by (T_s, ζ) if elastic."""
    top = rj.Elastic(y[3], y[4], y[5]) if elastic else rj.Rigid(y[3])
    return rj.Podium(y[0], y[1], y[2], top)


def peaks_under_pulse(y: jax.Array, elastic: bool) -> jax.Array:
    peak = rj.peak_response(structure_of(y, elastic), rj.Ricker(y[-2], y[-1]), options=OPTIONS)
    return jnp.stack([peak.peak_rotation, peak.peak_rotation_time, peak.peak_shear])


def slopes_by_parameters(y: jax.Array, elastic: bool) -> tuple[jax.Array, jax.Array]:
    function = lambda y: peaks_under_pulse(y, elastic)
    return jax.jacfwd(function)(y), jax.jacrev(function)(y)


def peaks_under_record(y: jax.Array, samples: jax.Array, elastic: bool) -> jax.Array:
    peak = rj.peak_response(structure_of(y, elastic), rj.Record(samples, DT), options=OPTIONS)
    return jnp.stack([peak.peak_rotation, peak.peak_rotation_time, peak.peak_shear])


def slopes_by_samples(y: jax.Array, elastic: bool) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return derivatives along a direction, by forward and by reverse mode, and the sum of |terms|."""
    y, samples, direction = jnp.split(y, [y.size - 2 * SAMPLES, y.size - SAMPLES])
    function = lambda samples: peaks_under_record(y, samples, elastic)
    _, forward = jax.jvp(function, (samples,), (direction,))
    terms = jax.jacrev(function)(samples) * direction
    return forward, jnp.sum(terms, axis=1), jnp.sum(jnp.abs(terms), axis=1)


def structures(n: int, elastic: bool, rng: np.random.Generator) -> list[np.ndarray]:
    alpha = rng.uniform(0.08, 0.35, n)
    y = [alpha, rng.uniform(0.8, 5.0, n), rng.uniform(0.0, 12.0, n), rng.uniform(1.0, 100.0, n)]
    return y + ([rng.uniform(0.1, 1.5, n), rng.uniform(0.0, 0.1, n)] if elastic else [])


def random_pulses(n: int, elastic: bool) -> np.ndarray:
    rng = np.random.default_rng([3, elastic])
    y = structures(n, elastic, rng)
    return np.stack([*y, 9.80665 * np.tan(y[0]) * rng.uniform(1.0, 9.0, n), rng.uniform(0.3, 3.0, n)], axis=1)


def random_records(n: int, elastic: bool) -> np.ndarray:
    """Return structures, samples of smoothed noise with the PGA of the pulses, and directions."""
    rng = np.random.default_rng([4, elastic])
    y = structures(n, elastic, rng)
    smooth = lambda row: np.convolve(row, np.hanning(9), mode="same")
    noise = np.apply_along_axis(smooth, 1, rng.normal(size=(n, SAMPLES)))
    noise *= (9.80665 * np.tan(y[0]) * rng.uniform(1.0, 9.0, n) / np.abs(noise).max(axis=1))[:, None]
    return np.concatenate([np.stack(y, axis=1), noise, rng.normal(size=(n, SAMPLES))], axis=1)


def compare_modes(name: str, function, y: np.ndarray) -> dict:
    program = jax.jit(jax.vmap(function))
    start = time.process_time()

    def solve(y: np.ndarray) -> list[np.ndarray]:
        batches = [program(y[k : k + BATCH]) for k in range(0, len(y), BATCH)]
        return [np.concatenate(list(map(np.asarray, values))) for values in zip(*batches, strict=True)]

    forward, reverse, *sizes = solve(y)
    size = sizes[0] if sizes else np.abs(forward).max(axis=-1, keepdims=True)
    difference = np.abs(forward - reverse) / np.where(size > 0, size, 1.0)
    is_different = difference > CLOSE
    row = {
        "scenes": name,
        "number": len(y),
        "derivatives": forward.size,
        "not zero": float(np.mean(forward != 0)),
        "not finite": int((~np.isfinite(forward)).sum() + (~np.isfinite(reverse)).sum()),
        "largest difference": float(np.nanmax(difference)),
        "over 1e-12": int(is_different.sum()),
    }
    if sizes:
        scenes = np.flatnonzero(is_different.any(axis=1))
        rounding = _rounding_effect(solve, y[scenes], forward[scenes]) / np.where(size > 0, size, 1.0)[scenes]
        row["of these rotation"], row["its time"], row["shear"] = map(int, is_different.sum(axis=0))
        row["unexplained"] = int((difference[scenes] > np.maximum(CLOSE, 10 * rounding)).sum())
    return row | {"cpu s": time.process_time() - start}


def _rounding_effect(solve, y: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """Return the largest change of forward derivatives if samples change by a unit in the last place."""
    rng = np.random.default_rng(0)
    largest = np.zeros_like(forward)
    samples = slice(-2 * SAMPLES, -SAMPLES)
    for _ in range(PERTURBATIONS if len(y) else 0):
        # Batches are filled up, because a batch of another size would need another program.
        changed = np.resize(y, (-(-len(y) // BATCH) * BATCH, y.shape[1]))
        changed[:, samples] *= 1 + np.finfo(float).eps * rng.integers(-1, 2, changed[:, samples].shape)
        largest = np.maximum(largest, np.abs(solve(changed)[0][: len(y)] - forward))
    return largest


def modes(count: int = 10_240) -> None:
    n, n_records = (max(BATCH, round(share / BATCH) * BATCH) for share in (count / 2, count / 40))
    kinds = {
        "rigid, numbers": (lambda y: slopes_by_parameters(y, False), random_pulses(n, False)),
        "elastic, numbers": (lambda y: slopes_by_parameters(y, True), random_pulses(n, True)),
        "rigid, samples": (lambda y: slopes_by_samples(y, False), random_records(n_records, False)),
        "elastic, samples": (lambda y: slopes_by_samples(y, True), random_records(n_records, True)),
    }
    rows = []
    for name, (function, y) in kinds.items():
        rows.append(compare_modes(name, function, y))
        store_rows("modes", rows)
    report("modes", rows, rows[-1])


if __name__ == "__main__":
    command, *arguments = sys.argv[1:]
    {"cost": cost, "modes": modes}[command](*map(int, arguments))
