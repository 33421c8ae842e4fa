"""Comparison with other solvers on the same scenes in one run: `python -m benchmarks.compare`.

A target is a limit of the 99th percentile of the error. For each target, each solver uses the largest
tolerance that reaches it. SciPy, heyoka and the Diffrax version solve fewer, evenly spaced scenes, and the
target limits their largest error. Times per scene are those of the fastest run. `pip install -e ".[bench]"`
installs the other solvers.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable

import jax
import numpy as np

import rockjax as rj

from .measure import (
    PERIODS,
    Family,
    errors,
    family,
    options,
    podium,
    report,
    rockjax_peaks,
    rotations_and_outcomes,
    shortest_time,
)

TARGETS = (1e-6, 1e-8, 1e-10)
TOLERANCES = [10.0**-k for k in np.arange(4.0, 13.01, 0.5)]
Solve = Callable[[Family, float], tuple[np.ndarray, np.ndarray]]


def largest_tolerance(solve: Solve, scenes: Family, target: float) -> float | None:
    """Return the largest tolerance with which the error does not exceed the target; None if there is none.

    The error is the 99th percentile, or the largest error if there are fewer than 400 scenes.
    """
    measure = "p99" if len(scenes) >= 400 else "max"
    for rtol in TOLERANCES:
        if rtol > 1e3 * target:
            continue
        error = errors(solve(scenes, rtol), scenes)
        if error[measure] <= target and error["flips"] == 0:
            return rtol
    return None


def segments(scenes: Family, rtol: float) -> tuple[np.ndarray, np.ndarray]:
    """Solve by one vmapped `diffeqsolve` with an event for each segment, as in the Diffrax documentation."""
    settings = options(rtol, engine="segments")
    return rotations_and_outcomes(_segments(podium(scenes), rj.Ricker(scenes.a_p, scenes.T_p), settings))


@jax.jit
def _segments(structure: rj.Podium, motions: rj.Ricker, settings: rj.Options) -> rj.Peak:
    return jax.vmap(lambda a_p, T_p: rj.peak_response(structure, rj.Ricker(a_p, T_p), options=settings))(
        motions.a_p, motions.T_p
    )


def peers() -> dict[str, tuple[Solve, int, int]]:
    """Return name of a peer ↦ (solver, number of scenes or 0 for all, number of timed runs)."""
    from .peers import heyoka_events, numba_loop, scipy_events

    return {
        "numba loop, DOP853": (numba_loop.solve, 0, 5),
        "heyoka": (heyoka_events.solve, 36, 2),
        "SciPy DOP853": (lambda s, r: scipy_events.solve(s, r, "DOP853"), 9, 1),
        "SciPy LSODA": (lambda s, r: scipy_events.solve(s, r, "LSODA"), 9, 1),
        "Diffrax, a solve per segment": (segments, 36, 2),
    }


def families(points: int, names: list[str]) -> list[dict]:
    rows = []
    for name in PERIODS:
        all_scenes = family(name, points)
        for target in TARGETS:
            tolerance = largest_tolerance(rockjax_peaks, all_scenes, target)
            if tolerance is None:
                continue
            our_time = shortest_time(lambda s=all_scenes, r=tolerance: rockjax_peaks(s, r)) / len(all_scenes)
            row = {"family": name, "error": target, "peer": "rockjax", "rtol": tolerance}
            rows.append(row | {"us": our_time * 1e6, "ratio": 1.0})
            for peer in names:
                solve, count, runs = peers()[peer]
                if target < 1e-8 and count:
                    continue  # it would take hours and lead to similar ratios
                scenes = all_scenes.thinned(count) if count else all_scenes
                rtol = largest_tolerance(solve, scenes, target)
                row = {"family": name, "error": target, "peer": peer, "rtol": rtol, "us": None, "ratio": None}
                if rtol is not None:
                    seconds = shortest_time(lambda solve=solve, s=scenes, r=rtol: solve(s, r), runs) / len(
                        scenes
                    )
                    row |= {"us": seconds * 1e6, "ratio": seconds / our_time}
                rows.append(row)
                print(row, flush=True)
    return rows


def compare_fig6() -> list[dict]:
    """Compare rockjax with the numba loop for all of Fig. 6: 12 panels of 10 000 scenes, on all cores."""
    from .peers import numba_loop

    panels = [
        dataclasses.replace(family(name, 100), eta=eta) for eta in (10.0, 50.0, 100.0) for name in PERIODS
    ]
    frequency, acceleration = np.linspace(1, 8, 100), np.linspace(1, 12, 100)
    structures = [podium(panel) for panel in panels]
    rows = []
    for target in TARGETS:

        def solve_by_rockjax(rtol: float):
            return rj.rocking_spectra(structures, rj.Ricker, frequency, acceleration, options=options(rtol))

        def solve_by_numba(rtol: float):
            return [numba_loop.solve(panel, rtol) for panel in panels]

        tolerances = [max_tolerance(solve, panels[8:], target) for solve in (rockjax_peaks, numba_loop.solve)]
        times = [
            shortest_time(lambda r=tolerances[0]: solve_by_rockjax(r)),
            shortest_time(lambda r=tolerances[1]: solve_by_numba(r)),
        ]
        row = {"error": target, "rtol": tolerances[0], "rockjax [s]": times[0]}
        row |= {"rtol numba": tolerances[1], "numba [s]": times[1], "ratio": times[1] / times[0]}
        rows.append(row)
        print(rows[-1], flush=True)
    default = shortest_time(
        lambda: rj.rocking_spectra(structures, rj.Ricker, frequency, acceleration, options=options(1e-8))
    )
    return [*rows, {"error": None, "rtol": 1e-8, "rockjax [s]": default}]


def max_tolerance(solve: Solve, panels: list[Family], target: float) -> float:
    """Return the largest tolerance that reaches the target on every panel."""
    tolerances = [largest_tolerance(solve, panel, target) for panel in panels]
    assert all(rtol is not None for rtol in tolerances), (target, tolerances)
    return min(rtol for rtol in tolerances if rtol is not None)


def main(points: str = "40", *names: str) -> None:
    start = time.perf_counter()
    rows = families(int(points), list(names) or list(peers()))
    report(f"compare-{points}", rows)
    report("fig6", compare_fig6())
    print(f"{time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main(*sys.argv[1:])
