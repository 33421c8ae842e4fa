"""Simplified methods (P…) of docs/practice.md, compared with exact answers of rigid blocks.

`python -m benchmarks.practice [N]` solves about N scenes (10⁶ by default): blocks of α = 10, 15, 20° and
2π/p = 2 … 8 s under synthetic motions, half of them with a pulse of 0.6–3.5 s, scaled to
PGA/(g tan α) = 1.2 … 6. It prints the tables of docs/practice.md and writes benchmarks/results/practice.json.

`python -m benchmarks.practice elastic [N]` compares (P1) and (P2) with the exact uplift of N elastic
buildings (10⁴ by default), and writes benchmarks/results/practice-elastic.json.
`python -m benchmarks.practice circolare [MOTIONS]` repeats only the rows of (P7) that state the ratio of PGA
or the rotation of the method, under all motions (or some of them), and replaces these rows of practice.json.

All blocks of one α share the response spectra of a motion: the periods of the methods (P3) to (P5) are
inversely proportional to p, and p and the periods form geometric sequences. All spectral values are therefore
exact; only the roots between two points of a scan are interpolated.
"""

from __future__ import annotations

import dataclasses
import datetime
import functools
import math
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import rockjax as rj
from rockjax._practice import asce_rocking, fema, priestley
from rockjax._practice.block import Block
from rockjax._practice.circolare import SLV, Mechanism
from rockjax._practice.roots import HIGHEST, LOWEST
from rockjax._practice.spectra import spectrum
from rockjax._practice.spectral_uplift import modes_of
from rockjax._results import code_of, did_not_finish

from .measure import G, options, show, store_rows, stored_rows

SLENDERNESS = np.radians([10.0, 15.0, 20.0])  # α [rad]
SIZES = 40  # number of values of 2π/p
SHORTEST, LONGEST = 2.0, 8.0  # range of 2π/p [s]
STEPS = {"(P3)": 9, "(P4)": 9, "(P5)": 15, "(P7)": 9}  # steps of a scan between two values of p
Q = 2.0  # behaviour factor of (P7)
RATIOS = np.union1d(np.geomspace(1.2, 6.0, 28), Q)  # PGA/(g tan α)
LEAST_STEPS = 1000  # smallest number of steps of a scan
FULL = 287  # number of motions of 10⁶ scenes
LEAST_ROTATION = 0.01  # θ/α above which rotations are compared
DT, DURATION, PGA = 0.02, 20.0, 0.3 * G
ROTATION_COLUMNS = (
    "method",
    "scenes",
    "unsafe",
    "overturnings missed",
    "false overturnings",
    "5 %",
    "50 %",
    "95 %",
    "several answers",
)
UPLIFT_COLUMNS = ("method", "buildings", "unsafe", "least", "5 %", "50 %", "95 %", "largest")
ACCEPTANCE_COLUMNS = (
    "method",
    "scenes",
    "pass",
    "of these above 0.4 α",
    "of these overturned",
    "of those that fail within 0.4 α",
)


@dataclasses.dataclass(frozen=True)
class Scan:
    """Periods and rotations of a scan that all sizes of a block share.

    - `phi`: rotations θ/α of the scan, shape (n,) [–]
    - `periods`: periods of all sizes, ascending, shape (n + steps (SIZES − 1),) [s]
    - `steps`: number of steps between two sizes; the periods of size k begin at index k·`steps`
    """

    phi: np.ndarray
    periods: np.ndarray
    steps: int

    @classmethod
    def of(cls, period: Callable[[np.ndarray], np.ndarray], steps: int) -> Scan:
        """Return the scan of a method.

        - `period`: period of the block with 2π/p = 2 s for each rotation θ/α, ascending [s]
        - `steps`: number of steps between two sizes
        """
        ratio = (LONGEST / SHORTEST) ** (1 / (steps * (SIZES - 1)))
        dense_phi = 1 - np.geomspace(1 - LOWEST, 1 - HIGHEST, 20001)
        first, last = period(np.array([LOWEST, HIGHEST]))
        count = math.ceil(math.log(last / first) / math.log(ratio))
        assert count >= LEAST_STEPS
        periods = last * ratio ** np.arange(-count, steps * (SIZES - 1) + 1)
        phi = np.exp(np.interp(np.log(periods[: count + 1]), np.log(period(dense_phi)), np.log(dense_phi)))
        for _ in range(3):  # secant steps to the rotations of these periods
            change = 1e-6 * (1 - phi)
            slope = (period(phi + change) - period(phi)) / change
            phi = np.clip(phi - (period(phi) - periods[: count + 1]) / slope, 1e-3, HIGHEST)
        np.testing.assert_allclose(period(phi), periods[: count + 1], rtol=1e-6)
        return cls(phi, periods, steps)

    def windows(self, values: np.ndarray) -> np.ndarray:
        """Return the values at the periods of each size, shape (SIZES, n)."""
        return np.lib.stride_tricks.sliding_window_view(values, self.phi.size)[:: self.steps]


@dataclasses.dataclass(frozen=True)
class Answers:
    """Largest θ/α of a method (1 for overturning) and number of stable answers, shape (sizes, ratios)."""

    rotation: np.ndarray
    count: np.ndarray

    @classmethod
    def of(cls, phi: np.ndarray, critical: np.ndarray, factors: np.ndarray) -> Answers:
        """Return the answers of all sizes and ratios.

        - `phi`: rotations of the scan, shape (n,) [–]
        - `critical`: factor on the motion for which each rotation is an answer of the method, (sizes, n)
        - `factors`: factors on the motion, shape (ratios,)
        """
        is_above = factors[:, None] > critical[:, None, :]
        falls = is_above[..., :-1] & ~is_above[..., 1:]  # stable answers
        count = falls.sum(axis=-1)
        last = falls.shape[-1] - 1 - np.argmax(falls[..., ::-1], axis=-1)
        rows = np.arange(critical.shape[0])[:, None]
        low, high = critical[rows, last], critical[rows, last + 1]
        fraction = np.clip((factors - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)
        rotation = np.where(count > 0, phi[last] + fraction * (phi[last + 1] - phi[last]), 0.0)
        overturns = is_above[..., -1]
        return cls(np.where(overturns, 1.0, rotation), count + overturns)


def blocks(alpha: float) -> list[Block]:
    """Return the blocks of a slenderness, in ascending size."""
    e = float(rj.Podium(alpha, 1.0).restitution_factor)
    sizes = 0.75 * G * (np.geomspace(SHORTEST, LONGEST, SIZES) / (2 * math.pi)) ** 2
    return [Block(alpha, float(R), 1 / 3, 0.0, e, G) for R in sizes]


def motions(count: int, seed: int = 1) -> rj.Motions:
    """Return synthetic motions, half of them with a pulse."""
    rng = np.random.default_rng(seed)
    pulses = [
        rj.MavroeidisPapageorgiou(
            rng.uniform(0.3, 1.2),
            1 / math.exp(rng.uniform(math.log(0.6), math.log(3.5))),
            rng.uniform(1.2, 3.0),
            rng.uniform(0, 2 * math.pi),
        )
        for _ in range(count // 2)
    ]
    sampled = functools.partial(rj.synthetic_motions, dt=DT, duration=DURATION, pga=PGA)
    plain = sampled(count - count // 2, seed=seed)
    return rj.Motions((*plain, *sampled(count // 2, seed=seed + 1, pulse=pulses)))


class Slenderness:
    """All blocks of one slenderness, with the scans of the methods."""

    def __init__(self, alpha: float):
        self.alpha = alpha
        self.blocks = blocks(alpha)
        first, tan_alpha = self.blocks[0], math.tan(alpha)
        e = first.restitution
        self.unit = G * tan_alpha  # unit of PGA in `RATIOS` [m/s²]
        rocking = Scan.of(lambda phi: priestley.period(phi, first.p), STEPS["(P3)"])
        asce_period = lambda phi: 1 / asce_rocking.frequency(alpha * phi, tan_alpha, G / first.half_height)
        asce = Scan.of(asce_period, STEPS["(P5)"])
        self.scans = {"(P3)": rocking, "(P4)": rocking, "(P5)": asce}
        self.damping = {
            "(P3)": priestley.damping(e), "(P4)": fema.damping(e), "(P5)": asce_rocking.damping(e)
        }  # fmt: skip
        self.mechanisms = [Mechanism.from_block(block, 1.0) for block in self.blocks]

    def answers(self, motion: rj.Motion) -> dict[str, Answers]:
        """Return the answers of (P3) to (P5) for a motion at all ratios."""
        factors = RATIOS * self.unit / motion.pga
        answers = {}
        for name, scan in self.scans.items():
            is_asce = name == "(P5)"
            response = "acceleration" if is_asce else "displacement"
            values = spectrum(motion, scan.periods, self.damping[name], response)
            if is_asce:
                theta = self.alpha * scan.phi
                capacity = G * asce_rocking.capacity(theta, math.tan(self.alpha))
                critical = capacity / scan.windows(values)
            else:
                lengths = np.array([block.half_height * self.alpha for block in self.blocks])
                critical = lengths[:, None] * scan.phi / scan.windows(values)
            answers[name] = Answers.of(scan.phi, critical, factors)
        return answers

    def displacement_ratio(
        self, periods: np.ndarray, largest: np.ndarray, motion: rj.Motion, ratios: np.ndarray
    ) -> np.ndarray:
        """Return the demand of (P7) divided by d_0, shape (sizes, ratios).

        - `periods`: periods [s]; `largest`: largest S_d up to each period, at 8 % damping [m]
        - `ratios`: PGA/(g tan α) of the scaled motion
        """
        demand = np.array(
            [np.interp(y.period(SLV), periods, largest) / y.displacement for y in self.mechanisms]
        )
        return demand[:, None] * ratios * self.unit / motion.pga

    def exact(self, records: rj.Records, peaks: np.ndarray, ratios: np.ndarray) -> np.ndarray:
        """Return the exact max|θ|/α, shape (motions, sizes, ratios): 1 for overturning, NaN for scenes that
        did not finish, which the tables omit."""
        R = np.array([block.R for block in self.blocks])[:, None]
        factor = ratios * self.unit / peaks[:, None, None]
        picked = records.pick(np.arange(peaks.size)[:, None, None])
        responses = rj.peak_responses(
            rj.Podium(self.alpha, R), picked.scaled(factor), options=options(1e-7), threads=1
        )
        finished = ~did_not_finish(code_of(responses.result))
        return np.where(finished, np.where(responses.overturned, 1.0, responses.peak_rotation), np.nan)


def rotation_row(name: str, rotation: np.ndarray, count: np.ndarray, exact: np.ndarray) -> dict[str, Any]:
    """Return the row of a method that gives a rotation."""
    finished = np.isfinite(exact)
    rotation, count, exact = rotation[finished], count[finished], exact[finished]
    overturned = exact == 1
    rocks = ~overturned & (exact > LEAST_ROTATION)
    quantiles = np.quantile(rotation[rocks] / exact[rocks], [0.05, 0.5, 0.95])
    return {
        "method": name,
        "scenes": exact.size,
        "unsafe": float(np.mean(rotation < exact)),
        "overturnings missed": float(np.mean(rotation[overturned] < 1)),
        "false overturnings": float(np.mean(rotation[~overturned] == 1)),
        "5 %": float(quantiles[0]),
        "50 %": float(quantiles[1]),
        "95 %": float(quantiles[2]),
        "several answers": float(np.mean(count > 1)),
    }


def acceptance_row(name: str, passes: np.ndarray, exact: np.ndarray) -> dict[str, Any]:
    """Return the row of a method that accepts or refuses a scene, with the limit θ/α ≤ 0.4."""
    finished = np.isfinite(exact)
    passes, exact = passes[finished], exact[finished]
    return {
        "method": name,
        "scenes": exact.size,
        "pass": float(passes.mean()),
        "of these above 0.4 α": float(np.mean(exact[passes] > 0.4)),
        "of these overturned": float(np.mean(exact[passes] == 1)),
        "of those that fail within 0.4 α": None if passes.all() else float(np.mean(exact[~passes] <= 0.4)),
    }


def circolare_rows(displacement: np.ndarray, exact: np.ndarray, ratios: np.ndarray) -> list[dict[str, Any]]:
    """Return the rows of (P7) that state the ratio of PGA or the rotation of the method.

    - `displacement`: demand divided by d_0, shape (motions, slenderness, sizes, ratios). It is also the
      rotation θ/α of the method, because d_0 is the displacement at θ = α, to first order in α
    - `exact`: exact max|θ|/α of the same scenes, 1 for overturning, NaN for scenes that did not finish
    - `ratios`: PGA/(g tan α), among them `Q`
    """
    at_limit, name = exact[..., ratios == Q], f"(P7) q = 2, PGA = {Q:.2f} g tan α"
    rotation = np.minimum(displacement, 1.0)
    return [
        acceptance_row(name, np.ones(at_limit.shape, bool), at_limit),
        rotation_row("(P7) rotation", rotation, np.ones(exact.shape, int), exact),
    ]


def displacements(families: list[Slenderness], suite: rj.Motions, ratios: np.ndarray) -> np.ndarray:
    """Return the demand of (P7) divided by d_0, shape (motions, slenderness, sizes, ratios)."""
    longest = max(each.period(SLV) for family in families for each in family.mechanisms)
    periods = np.geomspace(2 * DT, longest, 1200)
    rows = []
    for motion in suite:
        largest = np.maximum.accumulate(spectrum(motion, periods, SLV.damping, "displacement"))
        rows.append([family.displacement_ratio(periods, largest, motion, ratios) for family in families])
    return np.array(rows)


def exact_rotations(families: list[Slenderness], suite: rj.Motions, ratios: np.ndarray) -> np.ndarray:
    """Return the exact max|θ|/α, shape (motions, slenderness, sizes, ratios), as `Slenderness.exact`."""
    records, peaks = rj.Records.of(list(suite)), np.array([motion.pga for motion in suite])
    return np.stack([family.exact(records, peaks, ratios) for family in families], axis=1)


def circolare(count: int = FULL) -> None:
    """Repeat only the rows of `circolare_rows`.

    - `count`: number of motions, evenly spaced in the motions of the survey
    """
    start = time.process_time()
    suite = motions(FULL)[:: max(1, FULL // count)]
    families = [Slenderness(alpha) for alpha in SLENDERNESS]
    exact = exact_rotations(families, suite, RATIOS)
    rows = circolare_rows(displacements(families, suite, RATIOS), exact, RATIOS)
    _describe(rows, exact, start)
    names = {row["method"] for row in rows}
    others = [row for row in stored_rows("practice") if row["method"] not in names]
    store_rows("practice", others + rows)
    show(rows[:1], ACCEPTANCE_COLUMNS)
    show(rows[1:], ROTATION_COLUMNS)


def _describe(rows: list[dict[str, Any]], exact: np.ndarray, start: float) -> None:
    """Add number of motions, unfinished and overturned scenes, date and CPU time to rows."""
    for row in rows:
        row |= {
            "motions": exact.shape[0],
            "not finished": int(np.isnan(exact).sum()),
            "exact overturned": float(np.nanmean(np.where(np.isnan(exact), np.nan, exact == 1))),
            "date": datetime.date.today().isoformat(),
            "CPU s": round(time.process_time() - start),
        }


def building(rng: np.random.Generator) -> rj.Podium:
    """Return a random building of 1 to 8 equal stories, T_1 = 0.1 … 2 s, ζ = 2 … 5 %, γ = 1 … 30 and
    η/γ = 1 … 10, on columns of a slenderness of the survey."""
    log_uniform = lambda low, high: math.exp(rng.uniform(math.log(low), math.log(high)))
    gamma = log_uniform(1.0, 30.0)
    stories, eta, T = int(rng.integers(1, 9)), gamma * log_uniform(1.0, 10.0), log_uniform(0.1, 2.0)
    top = rj.ShearBuilding.uniform(stories, eta, T, rng.uniform(0.02, 0.05)).modes
    return rj.Podium(float(rng.choice(SLENDERNESS)), 2.0, gamma, top)


def largest_demand(podium: rj.Podium, motion: rj.Motion, parts: int = 6) -> float:
    """Return the largest |q|/q_up of a building with modes on resting columns, Eq. (9), at `parts` instants
    of each sampling interval h.

    With z = ẋ + ζωx + iω_d x, each mode is z⁺ = e^{λh}z − ∫e^{λ(h−s)}ü_g ds.
    """
    from scipy.signal import lfilter

    top: Any = podium.superstructure
    w, eta = 2 * np.pi / np.asarray(top.T), np.asarray(top.eta)
    zeta = np.broadcast_to(top.zeta, eta.shape)
    gamma = float(podium.gamma) + float(top.residual)
    h, count = motion.dt / parts, len(motion)
    a = np.interp(np.arange(parts * (count - 1) + 1) / parts, np.arange(count), motion.acceleration)
    q = a.copy()
    for omega, damping, mass in zip(w, zeta, eta, strict=True):
        pole = omega * (-damping + 1j * math.sqrt(1 - damping**2))
        decay = np.exp(pole * h)
        both, slope = (decay - 1) / pole, (decay - 1 - pole * h) / (pole**2 * h)
        z: Any = lfilter([-slope, slope - both], [1, -decay], a)
        z -= lfilter([1], [1, -decay], a[0] * np.append(-slope, np.zeros(a.size - 1)))  # starts from rest
        x = z.imag / pole.imag
        q -= (
            2 * mass / (1 + 2 * gamma) * (omega**2 * x + 2 * damping * omega * (z.real - damping * omega * x))
        )
    ratio = (1 + 2 * gamma + 2 * float(eta.sum())) / (1 + 2 * gamma)
    return float(np.abs(q).max()) / (G * math.tan(podium.alpha) * ratio)


def uplift_ratios(podium: rj.Podium, motion: rj.Motion) -> dict[str, float]:
    """Return, by method, the least PGA that lifts the columns divided by that of the method [–]."""
    unit = G * math.tan(podium.alpha)
    demand = largest_demand(podium, motion) * unit
    gamma, eta = map(float, podium.mass_ratios)
    eta_i, T_i, zeta_i = modes_of(podium)
    terms = np.array(
        [(1 + 2 * gamma) * motion.pga, *(2 * eta_i * spectrum(motion, T_i, zeta_i, "acceleration"))]
    )
    total = 1 + 2 * gamma + 2 * eta
    return {
        "(P1)": motion.pga / demand,
        "(P2)": float(terms.sum()) / total / demand,
        "(P2) with SRSS": float(np.sqrt((terms**2).sum())) / total / demand,
    }


def elastic(count: int = 10**4) -> None:
    """Compare (P1) and (P2) with the exact uplift of elastic buildings, each under one motion."""
    start, rng, suite = time.process_time(), np.random.default_rng(2), motions(100)
    found = [uplift_ratios(building(rng), suite[k % len(suite)]) for k in range(count)]
    rows = []
    for name in found[0]:
        ratios = np.array([row[name] for row in found])
        quantiles = np.quantile(ratios, [0.0, 0.05, 0.5, 0.95, 1.0]).tolist()
        rows.append(
            {
                "method": name,
                "buildings": count,
                "motions": len(suite),
                "unsafe": float(np.mean(ratios < 1 - 1e-9)),
            }
            | dict(zip(UPLIFT_COLUMNS[3:], quantiles, strict=True))
            | {"date": datetime.date.today().isoformat(), "CPU s": round(time.process_time() - start)}
        )
    store_rows("practice-elastic", rows)
    show(rows, UPLIFT_COLUMNS)


def main(scenes: int = 10**6) -> None:
    start = time.process_time()
    count = max(2, round(scenes / (SLENDERNESS.size * SIZES * RATIOS.size)))
    suite = motions(count)
    families = [Slenderness(alpha) for alpha in SLENDERNESS]
    exact = exact_rotations(families, suite, RATIOS)
    print(f"exact answers of {exact.size} scenes after {time.process_time() - start:.0f} s", flush=True)
    for k, j, i, r in np.argwhere(np.isnan(exact)):
        print(f"not finished: motion {k}, slenderness {j}, size {i}, ratio {r}", flush=True)
    rotation = {name: np.empty(exact.shape) for name in ("(P3)", "(P4)", "(P5)")}
    answers = {name: np.empty(exact.shape, int) for name in rotation}
    for k, motion in enumerate(suite):
        for j, family in enumerate(families):
            for name, method_answers in family.answers(motion).items():
                rotation[name][k, j], answers[name][k, j] = method_answers.rotation, method_answers.count
    displacement = displacements(families, suite, RATIOS)
    rows = [rotation_row(name, rotation[name], answers[name], exact) for name in rotation]
    rows += [
        acceptance_row("(P7) displacement", displacement <= SLV.share, exact),
        acceptance_row("(P7) q = 2", np.broadcast_to(RATIOS <= Q, exact.shape), exact),
        *circolare_rows(displacement, exact, RATIOS),
    ]
    _describe(rows, exact, start)
    store_rows("practice", rows)
    show([*rows[:3], rows[-1]], ROTATION_COLUMNS)
    show(rows[3:-1], ACCEPTANCE_COLUMNS)


if __name__ == "__main__":
    parts = {"elastic": elastic, "circolare": circolare}
    part = parts.get(sys.argv[1]) if sys.argv[1:] else None
    numbers = [int(float(y)) for y in sys.argv[(1 if part is None else 2) :]]
    (part or main)(*numbers)
