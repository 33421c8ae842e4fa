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
        rows.append(_batch(name))
    keep("gradients", rows)
    show(rows, {"family": "", "kind": "", "value [ms]": ".2f", "with gradient [ms]": ".2f", "ratio": ".2f"})


def _batch(name: str, points: int = 40) -> dict:
    """Value and five derivatives of a whole batch through the refilled lanes, on all cores."""
    pulses = family(name, points)
    structure, motion = podium(pulses), rj.Ricker(pulses.a_p, pulses.T_p)
    how = options(1e-8)
    names = ("alpha", "R", "gamma", "a_p", "T_p")
    value, both = (
        shortest(lambda n=n: rj.peak_responses(structure, motion, options=how, sensitivities=n))
        for n in ((), names)
    )
    row = {"family": name, "kind": f"batch of {points**2}", "value [ms]": value * 1e3}
    return row | {"with gradient [ms]": both * 1e3, "ratio": both / value}


if __name__ == "__main__":
    main()
