"""What each skip saves, and that it changes nothing: `python -m benchmarks.skips [points]`.

Each row runs a family with one skip taken away.
"""

from __future__ import annotations

import contextlib
import dataclasses
import sys
from unittest import mock

import jax
import numpy as np

import rockjax as rj
from rockjax._batch import chunk as _chunk
from rockjax._batch import lanes as _lanes
from rockjax._engine import contact as _contact
from rockjax._engine import step as _step
from rockjax._excitations.pulses import _PulseLookahead
from rockjax._programs.program import anew

from .families import PERIODS, Family, family
from .measure import keep, options, podium, shortest, show

RTOL = 1e-8


def peaks(scenes: Family, **more) -> np.ndarray:
    motions = rj.Ricker(scenes.a_p, scenes.T_p)
    return np.asarray(rj.peak_responses(podium(scenes), motions, options=options(RTOL, **more)).peak_rotation)


def never(scene, plan, lane, piece, ground):
    return lane.t < -jax.numpy.inf


impulse = _PulseLookahead.impulse


def unknown_before_the_end(self, t, piece):
    """The certificate only after the excitation."""
    return jax.numpy.where(t < self.T_p * self.pulse.span[1], jax.numpy.inf, impulse(self, t, piece))


SKIPS = {
    "full contact crossed in panels": lambda: mock.patch.object(
        _chunk, "cross_full_contact", lambda scene, plan, lane: lane
    ),
    "certificate before the end of the pulse": lambda: mock.patch.object(
        _PulseLookahead, "impulse", unknown_before_the_end
    ),
    "certificate at all": lambda: mock.patch.object(_step, "certificate", never),
    "lanes refilled": lambda: mock.patch.object(_lanes, "PATIENCE", 2.0),
    "only the wanted outputs": contextlib.nullcontext,
    "chatter ended at rest velocity": contextlib.nullcontext,
}
WITHOUT = {
    "only the wanted outputs": {"outputs": ("peak_rotation", "peak_deformation", "peak_shear", "impacts")},
    "chatter ended at rest velocity": {"rest_velocity": 1e-13},
}


def weak(points: int) -> dict:
    """Pulses too weak to lift anything, with and without the proof of it before the first step."""
    scenes = family("T_s = 0.5 s", points)
    scenes = dataclasses.replace(scenes, a_p=0.1 * scenes.a_p)
    found = peaks(scenes)
    quick = shortest(lambda: peaks(scenes))
    with (
        anew(),
        mock.patch.object(_contact, "certificate", never),
        mock.patch.object(_step, "certificate", never),
    ):
        slow = shortest(lambda: peaks(scenes), 3)
        difference = float(np.abs(found - peaks(scenes)).max())
    row = {"family": "T_s = 0.5 s, a tenth of it", "skip": "scenes that provably never lift"}
    row |= {"with": quick / len(scenes) * 1e6, "without": slow / len(scenes) * 1e6}
    return row | {"saves": slow / quick, "difference": difference}


def main(points: int = 60) -> None:
    rows = []
    for name in PERIODS:
        scenes = family(name, points)
        with_all = peaks(scenes)
        quick = shortest(lambda s=scenes: peaks(s))
        for skip, patched in SKIPS.items():
            if name == "rigid" and "panels" in skip:
                continue
            with anew(), patched():
                found = peaks(scenes, **WITHOUT.get(skip, {}))
                slow = shortest(lambda s=scenes, skip=skip: peaks(s, **WITHOUT.get(skip, {})), 3)
            row = {
                "family": name,
                "skip": skip,
                "with": quick / len(scenes) * 1e6,
                "without": slow / len(scenes) * 1e6,
            }
            row |= {"saves": slow / quick, "difference": float(np.abs(found - with_all).max())}
            rows.append(row)
            print(row, flush=True)
        if name == "rigid":
            # The same frame as a four-state scene whose top mass weighs nothing.
            light = rj.Podium(scenes.alpha, scenes.R, scenes.gamma + scenes.eta, rj.Elastic(0.0, 0.5))
            run = lambda s=scenes, p=light: rj.peak_responses(
                p, rj.Ricker(s.a_p, s.T_p), options=options(RTOL)
            )
            found = np.asarray(run().peak_rotation)
            slow = shortest(run)
            row = {"family": name, "skip": "two states, and uplift as a root of the pulse"}
            row |= {
                "with": quick / len(scenes) * 1e6,
                "without": slow / len(scenes) * 1e6,
                "saves": slow / quick,
            }
            rows.append(row | {"difference": float(np.abs(found - with_all).max())})
    rows.append(weak(points))
    keep("skips", rows)
    show(
        rows, {"family": "", "skip": "", "with": ".2f", "without": ".2f", "saves": ".2f", "difference": ".0e"}
    )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
