"""Do several ways lead to the same answers? `python -m benchmarks.agreement [scenes] [seed] [podium …]`.

Random podiums under motions that are rougher than earthquakes: noise of a few samples, with offsets, in steps
that jump, and pulses; half of the podiums begin at rest, others turned or turning, and some scenes end early.
Each scene is solved as usual, with all impacts counted, with one output alone, and by `tsit5` at a hundredth
of the tolerance, and whatever differs by more than errors do is shown. Where rocking is chaotic errors grow
as well: there both methods come closer to each other at smaller tolerances. And where two peaks are equal, as
those of both halves of a sine can be, either may be taken for the first.
"""

from __future__ import annotations

import math
import sys
from typing import Any, NamedTuple

import numpy as np

import rockjax as rj
from rockjax._excitations.pulses import PULSES

OUTPUTS = {
    "none": ("peak_rotation", "margin"),
    "rigid": ("peak_rotation", "margin", "peak_shear"),
    "elastic": ("peak_rotation", "margin", "peak_shear", "peak_deformation"),
}
MOTIONS = ("record", "steps", *PULSES)
TIMES = ("peak_rotation_time", "uplift_time", "overturn_time")
RECORDS, SAMPLES, SPACING = 40, 200, 0.02
RTOL = 1e-10
RELATIVE, ABSOLUTE = 1e-5, 1e-8  # beyond which two answers differ


class Scenes(NamedTuple):
    """A batch of scenes of one kind."""

    podium: rj.Podium
    motion: rj.AbstractExcitation
    initial: rj.State
    t_end: np.ndarray


def scenes(podium: str, motion: str, count: int, seed: int) -> Scenes:
    rng = np.random.default_rng([seed, *map(ord, podium + motion)])
    draw = lambda low, high: rng.uniform(low, high, count)
    side = lambda: rng.choice([-1.0, 1.0], count)
    top: dict[str, Any] = {
        "none": None,
        "rigid": rj.Rigid(10 ** draw(-1, 2)),
        "elastic": rj.Elastic(10 ** draw(-1, 2), 10 ** draw(-1, 0.5), draw(0.01, 0.2)),
    }
    alpha, gamma = draw(0.05, 0.5), rng.choice([0.01, 0.5, 2.0, 10.0, 50.0], count)
    structure = rj.Podium(
        alpha, 10 ** draw(-0.3, 1), gamma, superstructure=top[podium], restitution=draw(0.3, 0.98)
    )
    lifts, p = np.asarray(structure.uplift_ground_acceleration), np.asarray(structure.p)
    strength = lifts * np.where(draw(0, 1) < 0.4, draw(0.9, 1.5), draw(1, 6)) * side()
    if motion in PULSES:
        shaking: rj.AbstractExcitation = PULSES[motion](strength, 2 * math.pi / (p * draw(1, 12)))
    else:
        table = rj.Records.of([rj.Record(row, SPACING) for row in _rows(rng, motion == "steps")])
        shaking = table.pick(rng.integers(0, RECORDS, count)).scaled(strength)
    theta = np.where(draw(0, 1) < 0.4, alpha * 10 ** draw(-8, -0.3) * side(), 0.0)
    rate = np.where((theta != 0) & (draw(0, 1) < 0.5), p * alpha * draw(-0.5, 0.5), 0.0)
    start, end = (np.asarray(y) for y in shaking.support)
    late = np.where(draw(0, 1) < 0.4, (end - start) * draw(0.3, 2.5), (end - start) * 3 + 30 / p)
    return Scenes(structure, shaking, rj.State(theta=theta, theta_dot=rate), start + late)


def _rows(rng: np.random.Generator, steps: bool) -> list[np.ndarray]:
    rows = []
    for k in range(RECORDS):
        row = np.convolve(rng.normal(size=SAMPLES + 8), np.hanning(9), "valid")
        row = row / np.abs(row).max() + (rng.uniform(-0.3, 0.3) if k % 3 == 0 else 0.0)
        rows.append(np.repeat(row[::25], 25)[:SAMPLES] if steps else row)
    return rows


def differences(podium: str, motion: str, count: int, seed: int) -> list[str]:
    """A line for each way and answer that differ, with the first of the scenes."""
    batch, outputs = scenes(podium, motion, count, seed), OUTPUTS[podium]
    usual = rj.Options(rtol=RTOL, atol=0.01 * RTOL, outputs=outputs, throw=False)
    ways = {
        "all impacts": usual.replace(outputs=(*outputs, "impacts")),
        "one output": usual.replace(outputs=outputs[-1:]),
        "tsit5": usual.replace(rtol=0.01 * RTOL, atol=1e-4 * RTOL, method="tsit5"),
    }

    def answers(options: rj.Options) -> rj.Peak:
        return rj.peak_responses(
            batch.podium, batch.motion, initial=batch.initial, t_end=batch.t_end, options=options
        )

    found, lines = answers(usual), []
    for way, options in ways.items():
        other = answers(options)
        for name in outputs[-1:] if way == "one output" else (*outputs, *TIMES):
            ours, theirs = (np.asarray(getattr(each, name)) for each in (found, other))
            off = np.abs(ours - theirs) > RELATIVE * np.abs(theirs) + ABSOLUTE
            differ = np.flatnonzero(off | (np.isnan(ours) != np.isnan(theirs)))
            if differ.size:
                first = differ[0]
                words = f"scene {first}: {ours[first]:.12g} for {theirs[first]:.12g}"
                lines.append(f"{podium}, {motion}, {way}, {name}: {differ.size} of {count}, {words}")
    return lines


def main() -> None:
    numbers = [int(y) for y in sys.argv[1:3]]
    count, seed = (*numbers, *(2000, 1)[len(numbers) :])
    for podium in sys.argv[3:] or OUTPUTS:
        for motion in MOTIONS:
            lines = differences(podium, motion, count, seed)
            print(*(lines or [f"{podium}, {motion}: {count} scenes agree"]), sep="\n", flush=True)


if __name__ == "__main__":
    main()
