"""Forward against reverse derivatives over many scenes: `python -m benchmarks.modes [scenes]`.

Rigid and elastic podiums under pulses, with respect to every number, one program each, batched by `jax.vmap`.
"""

from __future__ import annotations

import sys
import time

import jax
import jax.numpy as jnp
import numpy as np

import rockjax as rj

from .measure import keep, show

PART = 256  # scenes that go through a program side by side
HOW = rj.Options(max_steps=4000, throw=False)


def podium(y: jax.Array, elastic: bool) -> rj.Podium:
    top = rj.Elastic(y[3], y[4], y[5]) if elastic else rj.Rigid(y[3])
    return rj.Podium(y[0], y[1], y[2], top)


def of_pulse(y: jax.Array, elastic: bool) -> jax.Array:
    peak = rj.peak_response(podium(y, elastic), rj.Ricker(y[-2], y[-1]), options=HOW)
    return jnp.stack([peak.peak_rotation, peak.peak_rotation_time, peak.peak_shear])


def by_numbers(y: jax.Array, elastic: bool) -> tuple[jax.Array, jax.Array]:
    function = lambda y: of_pulse(y, elastic)
    return jax.jacfwd(function)(y), jax.jacrev(function)(y)


def numbers(n: int, elastic: bool) -> np.ndarray:
    rng = np.random.default_rng([3, elastic])
    alpha = rng.uniform(0.08, 0.35, n)
    y = [alpha, rng.uniform(0.8, 5.0, n), rng.uniform(0.0, 12.0, n), rng.uniform(1.0, 100.0, n)]
    y += [rng.uniform(0.1, 1.5, n), rng.uniform(0.0, 0.1, n)] if elastic else []
    return np.stack(
        [*y, 9.80665 * np.tan(alpha) * rng.uniform(1.0, 9.0, n), rng.uniform(0.3, 3.0, n)], axis=1
    )


def compared(name: str, function, y: np.ndarray) -> dict:
    program = jax.jit(jax.vmap(function))
    began = time.process_time()
    parts = [program(y[k : k + PART]) for k in range(0, len(y), PART)]
    forward, reverse = (np.concatenate([np.asarray(part[k]) for part in parts]) for k in (0, 1))
    size = np.abs(forward).max(axis=-1, keepdims=True)
    apart = np.abs(forward - reverse) / np.where(size > 0, size, 1.0)
    return {
        "scenes": name,
        "number": len(y),
        "derivatives": forward.size,
        "not zero": float(np.mean(forward != 0)),
        "not finite": int((~np.isfinite(forward)).sum() + (~np.isfinite(reverse)).sum()),
        "largest difference": float(np.nanmax(apart)),
        "over 1e-12": int((apart > 1e-12).sum()),
        "cpu s": time.process_time() - began,
    }


def main(count: int = 10_240) -> None:
    part = lambda share: max(PART, round(share * count / PART) * PART)
    kinds = {
        "rigid, numbers": (lambda y: by_numbers(y, False), numbers(part(0.5), False)),
        "elastic, numbers": (lambda y: by_numbers(y, True), numbers(part(0.5), True)),
    }
    rows = []
    for name, (function, y) in kinds.items():
        rows.append(compared(name, function, y))
        keep("modes", rows)
    show(
        rows,
        {"scenes": "", "number": "d", "derivatives": ",d", "not zero": ".3f", "not finite": "d"}
        | {"largest difference": ".1e", "over 1e-12": "d", "cpu s": ".0f"},
    )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
