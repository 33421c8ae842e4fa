"""What a gradient with respect to five numbers costs beside the value: `python -m benchmarks.gradients`."""

from __future__ import annotations

import jax
import jax.numpy as jnp

import rockjax as rj

from .families import PERIODS, family
from .measure import keep, options, podium, shortest, show


def main() -> None:
    rows = []
    how = options(1e-8)
    for name in PERIODS:
        structure = podium(family(name, 2))
        y = jnp.array([0.15, 1.5, 10.0, 3.5, 1.0])

        def peak(y, structure=structure):
            varied = structure.replace(alpha=y[0], R=y[1], gamma=y[2])
            return rj.peak_response(varied, rj.Ricker(y[3], y[4]), options=how).peak_rotation

        many = y * (1 + 0.2 * jax.random.uniform(jax.random.key(0), (256, 1)))
        for kind, value, point in (("one scene", peak, y), ("256 scenes", jax.vmap(peak), many)):
            both = jax.value_and_grad(peak) if kind == "one scene" else jax.vmap(jax.value_and_grad(peak))
            times = [
                shortest(lambda f=jax.jit(f), p=point: jax.block_until_ready(f(p))) for f in (value, both)
            ]
            rows.append(
                {
                    "family": name,
                    "kind": kind,
                    "value [ms]": times[0] * 1e3,
                    "with gradient [ms]": times[1] * 1e3,
                }
            )
            rows[-1]["ratio"] = times[1] / times[0]
    keep("gradients", rows)
    show(rows, {"family": "", "kind": "", "value [ms]": ".2f", "with gradient [ms]": ".2f", "ratio": ".2f"})


if __name__ == "__main__":
    main()
