"""Stress campaign of random scenes.

    python -m benchmarks.stress [scenes] [seed] [words of groups] [--control] [--every K] [--store FOLDER]

The campaign draws random structures, motions, initial states, tolerances and methods, in groups that share
one compiled program. With `--control`, the groups have restrainers, vertical motion or several modes. Each
scene is solved at the requested tolerance with an error estimate, and for the reference at a much smaller
tolerance. `tests/restrained.py` solves a sample of the scenes with its own equations of motion, integrator
and events; the formula, the span and the breakpoints of the pulse, the restitution factor and the modes of
the superstructure come from rockjax. With `--store`, each batch is a sweep in this folder. The same command
continues an interrupted campaign, and repeats the report of a finished campaign.

The campaign looks for results without a name, NaN, values out of range, scenes that do not finish, outcomes
that change without a flag, and errors beyond the estimate. It also counts trial steps. For each failure, it
prints examples: lines of Python that repeat the scene.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import math
import multiprocessing
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

import rockjax as rj
from rockjax._responses.peak import peak_variables
from rockjax._results import NAMES, NOT_FINITE, OVERTURNED, code_of, did_not_finish

from . import stress_control as control
from .measure import log_uniform, mix_in, show, store_rows

OUTPUTS = ("peak_rotation", "peak_deformation", "peak_shear", "errors")
TOLERANCES = tuple(10.0**-k for k in range(3, 13))
FINER = 1e-3  # tolerance of the reference divided by that of the scene
REFERENCE_STEPS = 50_000  # max_steps of the reference
REQUESTED_STEPS = rj.Options().max_steps  # max_steps at the requested tolerance; `--steps` sets another limit
VIBRATION = 3e5  # [rad], see `vibration`; scenes with less vibration must finish
PER_GROUP = 3  # number of tolerances in each group
CHUNK = 65536  # number of scenes in a chunk of a sweep; an interruption loses at most a chunk
Answers = dict[str, np.ndarray]
SUPERSTRUCTURES = ("none", "rigid", "elastic")
LAWS = ("paper", "compatible", "given")
PULSES = ("Ricker", "AntisymmetricRicker", "OneSine", "OneCosine", "HalfSine")
MOTIONS = (*PULSES, "MavroeidisPapageorgiou", "Gabor", "Rest", "record", "offset record", "coarse record")
# Smallest tolerance for each method of lower order.
METHOD_TOLERANCES = {"tsit5": 1e-12, "dopri5": 1e-11, "bosh3": 1e-6}
QUANTITIES = ("peak_rotation", "peak_deformation", "peak_shear")


@dataclasses.dataclass(frozen=True)
class Group:
    """Kind of scenes that share one compiled program."""

    top: str  # superstructure
    law: str  # law of restitution, one of `LAWS`
    motion: str  # one of `MOTIONS`
    method: str = "dopri8"
    added: str = ""  # restrainers or vertical motion, one of `stress_control.ADDED`, or neither

    @property
    def name(self) -> str:
        return f"{self.top}, {self.law}, {self.motion}, {self.method}" + (self.added and f", {self.added}")

    @property
    def controlled(self) -> bool:
        """True if the group belongs to `--control`."""
        return bool(self.added) or self.top == "modes"


def groups() -> Iterator[Group]:
    for top, law, motion in itertools.product(SUPERSTRUCTURES, LAWS, MOTIONS):
        yield Group(top, law, motion)
    for method, top, motion in itertools.product(
        METHOD_TOLERANCES, ("rigid", "elastic"), ("Ricker", "OneCosine", "record")
    ):
        yield Group(top, "paper", motion, method)


def control_groups() -> Iterator[Group]:
    for top, law, motion, added in control.groups():
        yield Group(top, law, motion, added=added)


# ----------------------------------------------------------------------------------------------------- scenes
def samples(motion: str) -> np.ndarray:
    """Return the samples of a synthetic record with peak 1; the records differ in length and roughness."""
    n, seed = {"record": (240, 1), "offset record": (400, 2), "coarse record": (24, 3)}[motion]
    rng = np.random.default_rng(seed)
    t = np.arange(n) / n
    rough = rng.normal(size=n)
    if motion != "coarse record":
        rough = np.convolve(rough, np.hanning(7), mode="same")
    a = np.sin(18 * t) * np.exp(-(((t - 0.4) / 0.2) ** 2)) + 0.3 * rough / np.abs(rough).max()
    if motion == "offset record":
        a = a + 0.2
    return a / np.abs(a).max()


@dataclasses.dataclass(frozen=True)
class Batch:
    """Scenes of one group at one tolerance."""

    podium: rj.Podium
    motion: rj.AbstractExcitation
    initial: rj.State
    options: rj.Options

    def solve(self, options: rj.Options) -> rj.Peak:
        return rj.peak_responses(self.podium, self.motion, initial=self.initial, options=options)

    def answers(self, options: rj.Options, store: Path | None, name: str) -> Answers:
        """Return the answers as name → array, solved by a sweep if there is a store."""
        if store is None:
            return {name: values for name, values, _ in peak_variables(self.solve(options), options.outputs)}
        data = rj.sweep(
            self.podium, self.motion, store=store / f"{name}.zarr", chunk=CHUNK, progress=False,
            initial=self.initial, options=options,
        )  # fmt: skip
        assert not isinstance(data, rj.SweepPlan)
        return {str(key): np.asarray(values) for key, values in data.data_vars.items()}


def podiums(rng: np.random.Generator, group: Group, n: int) -> rj.Podium:
    alpha = log_uniform(rng, 0.01, control.WIDEST if group.controlled else 1.2, n)
    gamma = mix_in(rng, log_uniform(rng, 1e-3, 1e3, n), (0.0, 1000.0))
    eta = mix_in(rng, log_uniform(rng, 1e-3, 1e3, n), (0.0, 1000.0))
    zeta = mix_in(rng, log_uniform(rng, 1e-3, 1.0, n), (0.0, 0.05, 1.0), 0.5)
    T_s = mix_in(rng, log_uniform(rng, 0.01, 10.0, n), (0.01, 10.0))
    tops: dict[str, Callable[[], Any]] = {
        "none": lambda: None,
        "rigid": lambda: rj.Rigid(eta),
        "elastic": lambda: rj.Elastic(eta, T_s, zeta),
        "modes": lambda: control.modes(rng, eta, T_s, zeta),
    }
    top = tops[group.top]()
    e = mix_in(rng, rng.uniform(0.5, 1.0, n), (0.0, 1e-9, 0.2, 1.0), 0.3)
    podium = rj.Podium(
        alpha=alpha,
        R=log_uniform(rng, 0.05, 50.0, n),
        gamma=gamma,
        superstructure=top,
        lam=mix_in(rng, rng.uniform(0.0, 1.0, n), (1 / 3,), 0.8),
        restitution=e if group.law == "given" else group.law,
        g=mix_in(rng, np.full(n, 9.80665), (1.62, 3.71), 0.1),
    )
    return control.restrained_podium(rng, podium, group.added) if group.added else podium


def motions(rng: np.random.Generator, group: Group, podium: rj.Podium, n: int) -> rj.AbstractExcitation:
    """Return motions from 0.99 to 50 times the uplift threshold, with frequencies from 0.2 p to 40 p."""
    lifts = np.where(rng.random(n) < 0.5, podium.uplift_demand, podium.g * np.tan(podium.alpha))
    factor = mix_in(rng, log_uniform(rng, 0.99, 50.0, n), (1 - 1e-9, 1.0, 1 + 1e-9, 1.001), 0.1)
    a = np.asarray(lifts) * factor * rng.choice([-1.0, 1.0], n)
    T = 2 * math.pi / (np.asarray(podium.p) * log_uniform(rng, 0.2, 40.0, n))
    horizontal = _horizontal(rng, group, a, T)
    if "vertical" in group.added:
        return control.with_vertical(rng, horizontal, T, np.asarray(podium.g))
    return horizontal


def _horizontal(
    rng: np.random.Generator, group: Group, a: np.ndarray, T: np.ndarray
) -> rj.AbstractExcitation:
    n = len(a)
    if group.motion in PULSES:
        return getattr(rj, group.motion)(a, T)
    if group.motion == "Gabor":
        return rj.Gabor(a, T, rng.uniform(1.0, 4.0, n), rng.uniform(0, 2 * math.pi, n))
    if group.motion == "MavroeidisPapageorgiou":
        return rj.MavroeidisPapageorgiou(
            a * T / (2 * math.pi), 1 / T, rng.uniform(1.01, 4.0, n), rng.uniform(0, 6.28, n)
        )
    if group.motion == "Rest":
        return rj.Rest()
    record = samples(group.motion)
    return rj.Record(record, 6 * T / len(record), scale=a)


def batch(group: Group, rtol: float, n: int, seed: int) -> Batch:
    rng = np.random.default_rng([seed, *group.name.encode(), round(-math.log10(rtol))])
    podium = podiums(rng, group, n)
    motion = motions(rng, group, podium, n)
    ratio = float(rng.choice(control.RATIOS if group.controlled else (1.0, 1.0, 0.5, 1.3)))
    is_displaced = np.ones(n, bool) if group.motion == "Rest" else rng.random(n) < 0.15
    alpha, p = np.asarray(podium.alpha), np.asarray(podium.p)
    theta = np.where(rng.random(n) < 0.3, 0.0, rng.uniform(-1, 1, n)) * min(ratio, 1.0) * alpha
    theta_dot = np.where(rng.random(n) < 0.5, 0.0, rng.normal(size=n)) * p * alpha
    sway = 0.3 * rng.normal(size=n) * np.asarray(podium.width)
    speed = sway * p
    initial = [np.where(is_displaced, y, 0.0) for y in (theta, theta_dot, sway, speed)]
    if group.top == "modes":
        initial[2:] = (np.tile(y[:, None], control.MODES) for y in initial[2:])
    options = rj.Options(
        rtol=rtol,
        atol=0.01 * rtol,
        method=group.method,
        outputs=OUTPUTS,
        overturn_ratio=ratio,
    )
    return Batch(podium, motion, rj.State(*initial), options)


def scene(batch: Batch, k: int | np.ndarray) -> tuple[rj.Podium, rj.AbstractExcitation, rj.State]:
    """Return scene k of a batch with scalar parameters, or the scenes of several indices k."""

    def pick(y):
        y = np.asarray(y)
        return jnp.asarray(y[k] if y.ndim and y.shape[0] == len(batch.initial.theta) else y)

    podium, motion = jax.tree.map(pick, batch.podium), control.over_parts(batch.motion, pick)
    return podium, motion, jax.tree.map(pick, batch.initial)


def repeat(group: Group, rtol: float, n: int, seed: int, k: int) -> str:
    """Return the Python expression that repeats a scene."""
    arguments = ", ".join(repr(getattr(group, field.name)) for field in dataclasses.fields(group))
    return f"s.scene(s.batch(s.Group({arguments}), {rtol:g}, {n}, {seed}), {k})"


# --------------------------------------------------------------------------------------------------- verdicts
Job = tuple[Group, float, int, int, int]  # the arguments of `repeat`


@dataclasses.dataclass
class Findings:
    """Counts over the scenes of a group."""

    scenes: int = 0
    results: dict[str, int] = dataclasses.field(default_factory=dict)
    failures: dict[str, int] = dataclasses.field(default_factory=dict)
    examples: list[tuple[str, str]] = dataclasses.field(default_factory=list)
    # True error of the rotation divided by its estimate.
    ratios: list[np.ndarray] = dataclasses.field(default_factory=list)
    flips: int = 0  # scenes that overturn at only one of the two tolerances, requested or reference
    unflagged: int = 0  # flips without the flag `undecided`
    undecided: int = 0
    compared: int = 0  # scenes with an answer at both tolerances
    trials: list[np.ndarray] = dataclasses.field(default_factory=list)
    beyond: int = 0  # scenes with a vibration of more than `VIBRATION`
    within: int = 0  # unfinished scenes with a vibration of at most `VIBRATION`
    seconds: float = 0.0

    def fail(self, cause: str, failed: np.ndarray, line: Callable[[int], str]) -> None:
        """Count failures of a cause; `line` returns the Python line that repeats a scene."""
        count = int(failed.sum())
        if not count:
            return
        self.failures[cause] = self.failures.get(cause, 0) + count
        for k in np.flatnonzero(failed)[:2]:
            self.examples.append((cause, line(int(k))))


# ------------------------------------------------------------------------------- independent implementation
def against_reference(job: Job) -> tuple[float, float, bool, bool]:
    """Return (error, estimate, whether the outcomes agree, undecided) of one scene. The error of a scene that
    did not finish is infinite."""
    group, rtol, n, seed, k = job
    scenes = batch(group, rtol, n, seed)
    podium, motion, initial = scene(scenes, k)
    peak = rj.peak_response(podium, motion, initial=initial, options=scenes.options.replace(throw=False))
    # The reference continues beyond the end of the scene, so that the certificate is tested as well.
    end = min(
        float(peak.stats.end_time) + 3 / float(podium.p), float(motion.support[1]) + 30 / float(podium.p)
    )
    limit = float(scenes.options.overturn_ratio * podium.alpha)
    reference = control.by_scipy(podium, motion, initial, end, limit)
    if did_not_finish(int(code_of(peak.result))):
        return math.inf, 0.0, True, False
    errors = peak.errors
    assert errors is not None
    same = bool(peak.overturned) == math.isfinite(reference.overturn_time)
    error = abs(float(peak.peak_rotation) - reference.peak)
    return error, float(errors.peak_rotation), same, bool(errors.undecided)


def sample_for_reference(
    seed: int, number: int, candidates: list[Group]
) -> list[tuple[Group, float, int, int, int]]:
    """Return scenes that SciPy can solve in seconds: neither stiff nor with many impacts."""
    rng = np.random.default_rng(seed)
    jobs = []
    chosen = [g for g in candidates if g.motion in PULSES and g.method == "dopri8"]
    while len(jobs) < number:
        group, rtol, n = chosen[rng.integers(len(chosen))], float(rng.choice([1e-9, 1e-10])), 64
        scenes = batch(group, rtol, n, seed + 1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            peak = scenes.solve(scenes.options.replace(max_steps=3000))
        is_easy = np.asarray(peak.stats.steps) < 1000
        # `impacts` is NaN if they were not counted to the end; the number of steps then bounds them.
        is_easy &= ~(np.asarray(peak.impacts) >= 100)
        # SciPy detects events by changes of sign between steps, and misses shorter lifts.
        is_easy &= np.asarray(peak.peak_rotation) > 1e-6
        survives = ~np.asarray(peak.overturned)
        standing, overturned = (rng.permutation(np.flatnonzero(is_easy & y)) for y in (survives, ~survives))
        jobs += [(group, rtol, n, seed + 1, int(k)) for k in (*standing[:3], *overturned[:1])]
    return jobs[:number]


ROUNDING = 1e-13  # error of max|θ|/α that an estimate need not cover


OUT_OF_STEPS = [NAMES.index(name) for name in ("out_of_steps", "chattering", "too_stiff")]


def vibration(batch: Batch) -> np.ndarray:
    """Return the vibration on lifted columns, Eq. (31), until the end of each scene [rad].

    If the damping ratio of this vibration is above 2, the rate of decay replaces the frequency.
    """
    top, shape = batch.podium.superstructure, np.shape(batch.initial.theta)
    if not isinstance(top, rj.Elastic | rj.Modes):
        return np.zeros(shape)
    start, excitation_end = (np.asarray(y) for y in batch.motion.support)
    frequency = np.asarray(batch.podium.uplifted_frequency)
    if isinstance(top, rj.Modes):
        longest, damping = control.longest_vibration(batch.podium)
    else:
        longest, damping = np.asarray(top.T_s), np.asarray(top.zeta) * frequency / np.asarray(top.omega_s)
    after = np.maximum(30 / np.asarray(batch.podium.p), 10 * longest)  # `default_end`
    return np.broadcast_to(
        frequency * (excitation_end - start + after) * np.maximum(1.0, 0.5 * damping), shape
    )


def judge(
    findings: Findings, scenes: Batch, peak: Answers, reference: Answers, line: Callable[[int], str]
) -> None:
    code, true_code = peak["result"], reference["result"]
    findings.scenes += code.size
    for k, name in enumerate(NAMES):
        findings.results[name] = findings.results.get(name, 0) + int((code == k).sum())
    findings.fail("no named result", (code < 0) | (code >= len(NAMES)), line)
    for kind in OUT_OF_STEPS:
        findings.fail(f"steps: {NAMES[kind]}", code == kind, line)
    findings.fail("not finite", code == NOT_FINITE, line)
    for kind in range(NOT_FINITE + 1, len(NAMES)):
        if kind not in OUT_OF_STEPS:
            findings.fail(f"result: {NAMES[kind]}", code == kind, line)
    answered, has_reference = code <= OVERTURNED, true_code <= OVERTURNED
    ratio = float(scenes.options.overturn_ratio)
    # The largest value of all modes; NaN if the value of a mode is NaN.
    values = {name: np.reshape(peak[name], (code.size, -1)).max(axis=-1) for name in QUANTITIES}
    for name, value in values.items():
        findings.fail(f"{name} is not finite", answered & ~np.isfinite(value), line)
        findings.fail(f"{name} is negative", answered & (value < 0), line)
    rotation, overturned = values["peak_rotation"], peak["overturned"].astype(bool)
    uplifted = peak["uplifted"].astype(bool)
    findings.fail("rotation beyond overturning", answered & (rotation > ratio * (1 + 1e-12)), line)
    findings.fail(
        "overturned below the limit", answered & overturned & (rotation < ratio * (1 - 1e-12)), line
    )
    findings.fail("overturned is not the result", answered & (overturned != (code == 2)), line)
    findings.fail(
        "overturned without a time", answered & (overturned != np.isfinite(peak["overturn_time"])), line
    )
    findings.fail("uplifted without a time", answered & (uplifted != np.isfinite(peak["uplift_time"])), line)
    findings.fail("rotation without uplift", answered & ~uplifted & (rotation > 0), line)
    findings.trials.append(peak["steps"][answered])

    is_compared = answered & has_reference
    findings.compared += int(is_compared.sum())
    undecided = peak["undecided"].astype(bool)
    flips = is_compared & (overturned != reference["overturned"].astype(bool))
    findings.flips += int(flips.sum())
    findings.unflagged += int((flips & ~undecided).sum())
    findings.fail("the outcome changes without a flag", flips & ~undecided, line)
    findings.undecided += int((undecided & answered).sum())
    agrees = is_compared & ~flips
    error = np.abs(rotation - reference["peak_rotation"])[agrees]
    estimate = peak["peak_rotation_error"][agrees]
    findings.ratios.append(np.maximum(error - ROUNDING, 0.0) / np.maximum(estimate, 1e-300))


def run(
    number: int,
    group: Group,
    per_group: int,
    seed: int,
    store: Path | None = None,
    steps: int = REQUESTED_STEPS,
) -> Findings:
    findings = Findings()
    start = time.perf_counter()
    possible = [rtol for rtol in TOLERANCES if rtol >= METHOD_TOLERANCES.get(group.method, 0.0) * 0.99]
    # Tolerances are spread over the range, and all groups together use each tolerance equally often.
    first = number % len(possible)
    tolerances = sorted(
        {possible[(first + k * len(possible) // PER_GROUP) % len(possible)] for k in range(PER_GROUP)}
    )
    n = -(-per_group // len(tolerances))
    for rtol in tolerances:
        scenes = batch(group, rtol, n, seed)
        name = f"{group.name.replace(', ', '-').replace(' ', '-')}-{rtol:g}"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # scenes without an answer are counted here
            peak = scenes.answers(scenes.options.replace(max_steps=steps), store, f"{name}-asked")
            tight = max(FINER * rtol, FINER * METHOD_TOLERANCES.get(group.method, 0.0), 1e-13)
            finer = scenes.options.replace(
                rtol=tight, atol=0.01 * tight, outputs=QUANTITIES, max_steps=REFERENCE_STEPS
            )
            truth = scenes.answers(finer, store, f"{name}-truth")
            is_unfinished = np.isin(peak["result"], OUT_OF_STEPS)
            beyond = vibration(scenes) > VIBRATION
            findings.beyond += int(beyond.sum())
            findings.within += int((is_unfinished & ~beyond).sum())
        judge(findings, scenes, peak, truth, lambda k, rtol=rtol: repeat(group, rtol, n, seed, k))
    findings.seconds = time.perf_counter() - start
    return findings


def table(selections: dict[str, list[Findings]]) -> list[dict[str, Any]]:
    rows = []
    for name, findings in selections.items():
        ratios = np.concatenate([ratio for f in findings for ratio in f.ratios])
        trials = np.concatenate([count for f in findings for count in f.trials])
        total = sum(f.scenes for f in findings)
        rows.append(
            {
                "scenes": name,
                "number": total,
                **{
                    kind: sum(f.results.get(kind, 0) for f in findings)
                    for kind in ("settled", "end_of_time", "overturned")
                },
                **{
                    NAMES[k].replace("_", " "): sum(f.results.get(NAMES[k], 0) for f in findings)
                    for k in OUT_OF_STEPS
                },
                "beyond": sum(f.beyond for f in findings),
                "within, out of steps": sum(f.within for f in findings),
                "not finite": sum(f.results.get("not_finite", 0) for f in findings),
                "compared": sum(f.compared for f in findings),
                "within 10 x": float(np.mean(ratios <= 10)),
                "undecided": sum(f.undecided for f in findings) / total,
                "flips": sum(f.flips for f in findings),
                "unflagged": sum(f.unflagged for f in findings),
                "trials median": float(np.median(trials)),
                "trials most": int(trials.max()),
            }
        )
    return rows


def compared_with_reference(seed: int, number: int, candidates: list[Group]) -> dict[str, Any]:
    """Compare random scenes with the independent implementation, in separate processes."""
    if not number:
        return {}
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        jobs = sample_for_reference(seed, number, candidates)
        results = list(tqdm(pool.map(against_reference, jobs, chunksize=4), total=number, unit=" references"))
    rows = np.array(results, float)
    answer, is_failure = count_reference_errors(rows)
    print("\nagainst the independent implementation:", answer)
    for k in np.flatnonzero(is_failure)[:10]:
        print(f"    error {rows[k, 0]:.1e}, estimate {rows[k, 1]:.1e}: {repeat(*jobs[k])}")
    return answer


def count_reference_errors(rows: np.ndarray) -> tuple[dict[str, Any], np.ndarray]:
    """Return the summary of the answers of `against_reference`, shape (n, 4), and a mask of failures (n,)."""
    error, estimate, same, undecided = rows.T
    same = same.astype(bool)
    # The reference itself is accurate to about 1e-10. NaN is beyond every estimate.
    beyond = same & ~(error <= 10 * estimate + 3e-10)
    other_class = ~same & (undecided == 0)
    answer = {
        "reference scenes": len(rows),
        "other class": int(other_class.sum()),
        "beyond estimate": int(beyond.sum()),
        "median error": float(np.median(error[same])),
        "largest error": float(error[same].max()),
    }
    return answer, beyond | other_class


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="?", type=float, default=200_000)
    parser.add_argument("seed", nargs="?", type=int, default=0)
    parser.add_argument("words", nargs="*", help="run only groups whose names contain all of these words")
    parser.add_argument(
        "--every", type=int, default=1, help="run every K-th group only, to compile fewer programs"
    )
    parser.add_argument(
        "--references", type=int, default=120, help="scenes for the independent implementation"
    )
    parser.add_argument(
        "--control", action="store_true", help="run groups with restrainers, vertical motion or several modes"
    )
    parser.add_argument("--store", type=Path, help="folder of sweeps, from which a campaign continues")
    parser.add_argument(
        "--steps", type=int, default=REQUESTED_STEPS, help="max_steps at the requested tolerance"
    )
    arguments = parser.parse_args()
    scenes, seed, words = int(arguments.scenes), arguments.seed, arguments.words
    every_group = control_groups() if arguments.control else groups()
    chosen = [
        group for group in every_group if all(word in group.name.replace(",", "").split() for word in words)
    ]
    chosen = chosen[:: arguments.every]
    per_group = -(-scenes // len(chosen))
    start = time.perf_counter()
    findings: dict[Group, Findings] = {}
    # Two groups at a time: one compiles while another runs.
    with ThreadPoolExecutor(2) as pool, tqdm(total=len(chosen), unit=" groups") as bar:

        def run_group(number: int, group: Group) -> None:
            findings[group] = run(number, group, per_group, seed, arguments.store, arguments.steps)
            bar.update()

        list(pool.map(run_group, range(len(chosen)), chosen))
    selections = {"all": list(findings.values())}
    for top in control.TOPS if arguments.control else SUPERSTRUCTURES:
        selections[top] = [f for g, f in findings.items() if g.top == top and g.method == "dopri8"]
    for added in control.ADDED:
        name = "all devices" if added == "all" else added
        selections[name] = [f for g, f in findings.items() if g.added == added]
    for motion in MOTIONS:
        selections[motion] = [f for g, f in findings.items() if g.motion == motion and g.method == "dopri8"]
    for method in METHOD_TOLERANCES:
        selections[method] = [f for g, f in findings.items() if g.method == method]
    rows = table({name: members for name, members in selections.items() if members})
    show(rows)
    failures: dict[str, int] = {}
    for f in findings.values():
        for cause, count in f.failures.items():
            failures[cause] = failures.get(cause, 0) + count
    print("\nfailures by cause:", failures or "none")
    for cause in failures:
        lines = [line for f in findings.values() for what, line in f.examples if what == cause]
        print(f"  {cause}: from benchmarks import stress as s")
        for line in lines[:6]:
            print(f"    {line}")
    compared = chosen if arguments.control else list(groups())
    comparison = compared_with_reference(seed, arguments.references if not words else 0, compared)
    slowest = sorted(findings, key=lambda g: -findings[g].seconds)[:5]
    print("slowest groups:", ", ".join(f"{g.name}: {findings[g].seconds:.0f} s" for g in slowest))
    print(f"{time.perf_counter() - start:.0f} s")
    if not words:
        store_rows("stress" + "-control" * arguments.control, [*rows, {"failures": failures, **comparison}])


if __name__ == "__main__":
    main()
