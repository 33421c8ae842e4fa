"""Agreement of results from several methods: `python -m benchmarks.agreement [scenes] [seed] [kind …]`.

By default, answers about motion and superstructure are compared; with `--forces`, forces in the joints.

The scenes are random. A kind of scene is a combination of superstructure, devices, direction and motion, such
as `elastic-power-vertical-steps`; an argument selects all kinds that contain its words. The motions are
rougher than earthquakes (noise of a few samples with offsets, steps, pulses) or zero. About 40 % of the
podiums start with a rotation, and some of these also with a velocity or deformation. Some scenes end early.

Answers at three tolerances are compared with each other. Derivatives with respect to α and the scale of the
motion are compared with central differences at several steps. Central differences "settle" if three
successive values, each extrapolated from two steps, agree. With `--ways`, answers are also compared with
solutions that count all impacts, have no derivatives, or use `tsit5`. `--faults FOLDER` writes each fault to
a file, which `python -m benchmarks.agreement --again FILE` solves again.

A difference that exceeds the limits gets one of these names. NaN in a finished scene is always a FAULT, and
so is a scene with the result `not_finite`.

- not compared: the scene did not finish
- tie: two peaks are equal, and the derivative belongs to one of them
- flagged: the error estimate (`errors`) is of this size, or the scene is undecided
- grazing: central differences do not settle, and an impact of the scene is nearly grazing
- unsettled: central differences do not settle without such an impact, because another peak is close; or
  they settle, but change again with smaller steps, with which they agree with the derivative
- converges: the error of a derivative is below 100 times the limit, and below the limit at all smaller
  tolerances
- slow: a damper has an exponent ν < 1, so that the slope of its force is nearly infinite at rest. The error
  of a derivative is below 1000 times the limit, decreases from each tolerance to the next, and is below ten
  times the limit at the last
- FAULT: none of these
"""

from __future__ import annotations

import argparse
import collections
import functools
import itertools
import json
import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import rockjax as rj
from rockjax import _results as results
from rockjax._excitations.pulses import PULSES
from rockjax._outputs.registry import VARIABLES

# Superstructures; "truncated" is a building without its last mode, "unkept" a building without modes.
TOPS = ("none", "rigid", "elastic", "modes", "building", "truncated", "unkept")
DEVICES = ("free", "linear", "power")
DIRECTIONS = ("horizontal", "vertical")
SAMPLED = ("rough", "steps", "rest")  # sampled motions, which share one compiled program
MOTIONS = (*SAMPLED, *PULSES)
STORIES = 3
OUTPUTS = {  # names of answers
    "none": ("peak_rotation", "margin"),
    "rigid": ("peak_rotation", "margin", "peak_shear"),
    "elastic": ("peak_rotation", "margin", "peak_shear", "peak_deformation"),
    "building": (
        "peak_rotation",
        "margin",
        "peak_shear",
        "peak_deformation",
        "peak_drift",
        "peak_floor_acceleration",
    ),
    "unkept": ("peak_rotation", "margin", "peak_shear", "peak_floor_acceleration"),
}
OUTPUTS |= {"modes": OUTPUTS["elastic"], "truncated": OUTPUTS["building"]}
FORCES = (
    "peak_rotation",
    "peak_friction",
    "least_axial_force",
    "peak_axial_force",
    "peak_foundation_shear",
    "peak_impact_friction",
    "least_impulse_share",
)

RECORDS, SAMPLES, SPACING = 40, 200, 0.02
TOLERANCES = (1e-8, 1e-10, 1e-12)
PARAMETERS = ("alpha", "scale")
STEPS = (3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6)  # steps of ln α and of the logarithm of the scale
SMALLER_STEPS = (3e-6, 1e-6, 3e-7, 1e-7)  # steps for derivatives that differ from settled differences
# Limits of the difference of two answers: RELATIVE times the answer plus ABSOLUTE. The margin is already a
# fraction of a capacity, so its limit is RELATIVE.
RELATIVE, ABSOLUTE = 1e-5, 1e-8
MAX_STEPS = 20_000  # largest number of steps of a scene; scenes that need more are not compared
NOT_COMPARED = "not compared"
SAFETY = 10.0  # an answer is flagged if its estimated error times this factor reaches the difference
GRAZES = 1e-3  # an impact is nearly grazing if its speed is below this multiple of pα


class SceneKind(NamedTuple):
    """Kind of the scenes of a batch."""

    top: str  # one of `TOPS`
    devices: str  # one of `DEVICES`
    direction: str  # one of `DIRECTIONS`
    motion: str  # one of `MOTIONS`

    def __str__(self):
        return "-".join(self)

    @classmethod
    def from_name(cls, name: str) -> SceneKind:
        return cls(*name.split("-", 3))  # the name of a motion may contain "-"

    @classmethod
    def matching(cls, words) -> Iterator[SceneKind]:
        """Yield the kinds that contain all parts of one of the words, such as `elastic-steps`."""
        for parts in itertools.product(TOPS, DEVICES, DIRECTIONS, MOTIONS):
            kind = cls(*parts)
            if not words or any(set(word.split("-")) <= set(str(kind).split("-")) for word in words):
                yield kind


class Scenes(NamedTuple):
    """A batch of scenes of one kind."""

    podium: rj.Podium
    motion: Any
    initial: rj.State
    t_end: np.ndarray

    def varied(self, alpha, scale) -> Scenes:
        """Return the scenes with α and the motion multiplied by factors."""
        alphas = np.asarray(self.podium.alpha) * alpha
        scales = np.broadcast_to(scale, np.broadcast_shapes(np.shape(scale), alphas.shape))
        R = np.broadcast_to(self.podium.R, alphas.shape)  # the check of the elevation multiplies it by sin α
        podium = self.podium.replace(alpha=alphas, R=R)
        return self._replace(podium=podium, motion=self.motion.scaled(scales))

    def scene(self, k: int) -> Scenes:
        """Return scene k, with its record."""
        select = lambda tree: jax.tree.map(lambda y: np.asarray(y)[k] if np.ndim(y) else y, tree)

        def select_motion(motion):
            if isinstance(motion, rj.GroundMotion):
                return rj.GroundMotion(select_motion(motion.horizontal), select_motion(motion.vertical))
            if not isinstance(motion, rj.Records):
                return select(motion)
            row = int(motion.which[k])
            return rj.Record(
                motion.acceleration[row], SPACING, motion.scale[k], t_start=float(motion.starts[row])
            )

        return Scenes(select(self.podium), select_motion(self.motion), select(self.initial), self.t_end[k])

    def only(self, k: int) -> Scenes:
        """Return scene k as a batch of one scene."""
        return self.scene(k).as_batch()

    def as_batch(self) -> Scenes:
        """Return a single scene as a batch of one scene."""
        return self._replace(motion=self.motion.scaled(np.ones(1)), t_end=np.reshape(self.t_end, 1))


def scenes(kind: SceneKind, count: int, seed: int) -> Scenes:
    """Return random scenes of a kind; equal arguments give equal scenes."""
    rng = np.random.default_rng([seed, *map(ord, str(kind))])
    uniform = lambda low, high, *more: rng.uniform(low, high, (count, *more))
    random_sign = lambda *more: rng.choice([-1.0, 1.0], (count, *more))
    alpha, gamma = uniform(0.05, 0.5), rng.choice([0.01, 0.5, 2.0, 10.0, 50.0], count)
    structure = rj.Podium(
        alpha,
        10 ** uniform(-0.3, 1),
        gamma,
        superstructure=_top(kind.top, uniform),
        restitution=uniform(0.3, 0.98),
        restrainers=_devices(kind.devices, uniform),
    )
    uplift, p = np.asarray(structure.uplift_ground_acceleration), np.asarray(structure.p)
    strength = uplift * np.where(uniform(0, 1) < 0.4, uniform(0.9, 1.5), uniform(1, 6)) * random_sign()
    size = structure.g * uniform(0.01, 0.95) * random_sign()
    if kind.motion in PULSES:
        period = 2 * math.pi / (p * uniform(1, 12))
        horizontal: Any = PULSES[kind.motion](strength, period)
        vertical: Any = rj.Ricker(size, period * uniform(0.1, 1))
    else:
        make_records = lambda start: rj.Records.of(
            [rj.Record(row, SPACING, t_start=start) for row in _rows(rng, kind.motion == "steps")]
        ).pick(rng.integers(0, RECORDS, count))
        motion_factor = 0.0 if kind.motion == "rest" else 1.0
        horizontal = make_records(0.0).scaled(strength * motion_factor)
        vertical = make_records(0.1).scaled(size)
    motion = horizontal if kind.direction == "horizontal" else rj.GroundMotion(horizontal, vertical)
    is_rotated = (uniform(0, 1) < 0.4) | (kind.motion == "rest")
    theta = np.where(is_rotated, alpha * 10 ** uniform(-8, -0.3) * random_sign(), 0.0)
    rate = np.where(is_rotated & (uniform(0, 1) < 0.5), p * alpha * uniform(-0.5, 0.5), 0.0)
    start, end = (np.asarray(y) for y in motion.support)
    duration = np.where(uniform(0, 1) < 0.4, (end - start) * uniform(0.3, 2.5), (end - start) * 3 + 30 / p)
    initial = _initial(structure, is_rotated, theta, rate, uniform)
    structure = structure.replace(elevation=_elevation(structure, uniform))
    return Scenes(structure, motion, initial, start + duration)


def _top(name: str, uniform) -> Any:
    eta, zeta = 10 ** uniform(-1, 2), uniform(0.01, 0.2)
    if name == "none":
        return None
    if name == "rigid":
        return rj.Rigid(eta)
    if name == "elastic":
        return rj.Elastic(eta, 10 ** uniform(-1.5, 0.5), zeta)
    if name == "modes":
        shares = uniform(0.05, 1, STORIES + 1)
        masses = eta[:, None] * shares / shares.sum(axis=1, keepdims=True)
        T, zeta = 10 ** uniform(-1.6, 0.2, STORIES), uniform(0.01, 0.2, STORIES)
        return rj.Modes(masses[:, :-1], T, zeta, masses[:, -1])
    retained = {"building": STORIES, "truncated": STORIES - 1, "unkept": 0}[name]
    masses = 10 ** uniform(-1, 1, STORIES)
    stiffnesses = masses * 10 ** uniform(1, 3.5, 1) * uniform(0.3, 2, STORIES)
    return rj.ShearBuilding(
        masses, stiffnesses, uniform(0.01, 0.2, retained) if retained else 0.05, modes=retained
    )


def _devices(name: str, uniform) -> tuple[Any, ...]:
    """Return a tendon, a damper and an inerter; each parameter is zero in a quarter of the scenes."""
    or_zero = lambda values: np.where(uniform(0, 1) < 0.75, values, 0.0)
    if name == "free":
        return ()
    exponent = 1.0 if name == "linear" else uniform(0.2, 1)
    return (
        rj.Tendon(or_zero(10 ** uniform(-1, 2)), or_zero(10 ** uniform(0, 2))),
        rj.Damper(or_zero(10 ** uniform(-1, 1.7)), exponent),
        rj.Inerter(or_zero(10 ** uniform(-1, 1.5))),
    )


def _elevation(podium: rj.Podium, uniform) -> rj.Elevation:
    """Return three columns at different distances and masses at random heights; joints open in part of the
    scenes."""
    width, height = 2 * podium.R * np.sin(podium.alpha), 2 * podium.R * np.cos(podium.alpha)
    gaps = np.asarray(width)[:, None] * (1 + 10 ** uniform(-1, 1, 2))
    columns = np.cumsum(np.pad(gaps, ((0, 0), (1, 0))), axis=1)
    count = getattr(podium.superstructure, "height_count", None)
    top_height = np.asarray(height)[:, None] * np.cumsum(uniform(0.2, 1, count or 1), axis=1)
    return rj.Elevation(
        columns, height * uniform(0, 0.3), top_height if count else top_height[:, 0], height * uniform(0, 1)
    )


def _initial(podium: rj.Podium, is_rotated, theta, rate, uniform) -> rj.State:
    count = getattr(podium.superstructure, "count", 0)
    if not podium.vibrates:
        return rj.State(theta=theta, theta_dot=rate)
    mode_shape = (count,) if isinstance(podium.superstructure, rj.Modes | rj.ShearBuilding) else ()
    size = np.asarray(podium.R * np.sin(podium.alpha)) * is_rotated * (uniform(0, 1) < 0.5)
    size = size.reshape(-1, *[1] * len(mode_shape))
    return rj.State(theta, rate, size * uniform(-0.3, 0.3, *mode_shape), size * uniform(-1, 1, *mode_shape))


def _rows(rng: np.random.Generator, steps: bool) -> list[np.ndarray]:
    rows = []
    for k in range(RECORDS):
        row = np.convolve(rng.normal(size=SAMPLES + 8), np.hanning(9), "valid")
        row = row / np.abs(row).max() + (rng.uniform(-0.3, 0.3) if k % 3 == 0 else 0.0)
        rows.append(np.repeat(row[::25], 25)[:SAMPLES] if steps else row)
    return rows


def solve(batch: Scenes, answers: tuple[str, ...], rtol: float, method="dopri8", **more) -> rj.Peak:
    outputs = tuple(dict.fromkeys(VARIABLES[y][1] if y in VARIABLES else y for y in answers))
    options = rj.Options(
        rtol=rtol, atol=0.01 * rtol, outputs=outputs, method=method, max_steps=MAX_STEPS, throw=False
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # scenes that do not finish
        warnings.simplefilter("ignore", rj.PlausibilityWarning)  # random restitution factors
        return rj.peak_responses(
            batch.podium, batch.motion, initial=batch.initial, t_end=batch.t_end, options=options, **more
        )


def columns(answers: Any, names: tuple[str, ...], shape: tuple[int, ...], last: int = 0) -> np.ndarray:
    """Return named answers, shape (columns, *shape, …), with one column for each mode, story or joint of an
    answer.

    - `answers`: peaks, sensitivities or errors
    - `names`: names of the answers
    - `shape`: shape of the batch
    - `last`: number of axes after those of modes, stories and joints
    """
    rows = []
    for name in names:
        values = np.asarray(getattr(answers, name))
        last_shape = values.shape[values.ndim - last :]
        rows.append(np.moveaxis(values.reshape(*shape, -1, *last_shape), len(shape), 0))
    return np.concatenate(rows)


def finite_columns(peaks: rj.Peak, names: tuple[str, ...], shape: tuple[int, ...]) -> np.ndarray:
    """Return columns of peaks, with 0 for an infinite friction demand, whose derivative is 0."""
    values = columns(peaks, names, shape)
    return np.where(np.isinf(values), 0.0, values)


def labels(answers: Any, names: tuple[str, ...]) -> list[str]:
    """Return the names of the columns."""
    column_names = []
    for name in names:
        values = np.asarray(getattr(answers, name))
        column_names += [name] if values.ndim == 1 else [f"{name}[{j}]" for j in range(values.shape[-1])]
    return column_names


class Differences(NamedTuple):
    """Central differences for ln α and the logarithm of the scale, shape (columns, scenes, parameters)."""

    values: np.ndarray
    settled: np.ndarray
    # Forward and backward differences if they do not approach each other with smaller steps; else NaN.
    sides: tuple[np.ndarray, np.ndarray]


def differentiate(batch: Scenes, outputs: tuple[str, ...], steps: tuple[float, ...] = STEPS) -> Differences:
    """Return derivatives by finite differences of solutions at the tightest tolerance.

    Richardson extrapolation from two successive steps eliminates the error of second order. The result is the
    median of the three successive values that agree best.
    """
    h = np.array(steps)
    ones = np.ones((len(h), 1))
    up, down = 1 + h[:, None], 1 - h[:, None]
    alpha = np.concatenate([ones[:1], up, down, ones, ones])
    scale = np.concatenate([ones[:1], ones, ones, up, down])
    shape = (len(alpha), len(batch.t_end))
    peaks = solve(batch.varied(alpha, scale), outputs, TOLERANCES[-1])
    answers = finite_columns(peaks, outputs, shape)
    centre, shifted = answers[:, :1], answers[:, 1:]
    by_side = shifted.reshape(len(answers), len(PARAMETERS), 2, len(h), shape[1])
    forward = (by_side[:, :, 0] - centre[:, None]) / h[:, None]
    backward = (centre[:, None] - by_side[:, :, 1]) / h[:, None]
    central = (forward + backward) / 2
    smaller = central[:, :, 1:]
    extrapolated = smaller + (smaller - central[:, :, :-1]) / ((h[:-1] / h[1:]) ** 2 - 1)[:, None]
    triples = np.stack([extrapolated[:, :, k : len(h) - 3 + k] for k in range(3)])
    spread = np.ptp(triples, axis=0)
    best = np.argmin(np.where(np.isnan(spread), np.inf, spread), axis=2)[:, :, None]
    at_best = lambda y: np.moveaxis(np.take_along_axis(y, best, axis=2)[:, :, 0], 1, -1)
    value, size = at_best(np.median(triples, axis=0)), np.abs(centre[:, 0, :, None])
    limit = RELATIVE * (np.abs(value) + size) + ABSOLUTE
    # If an answer is smooth, the difference of the two sides decreases with the step.
    gap = np.abs(forward - backward)
    has_kink = at_best(gap[:, :, 3:] > 0.7 * gap[:, :, 2:-1]) & (at_best(gap[:, :, 3:]) > limit)
    forward, backward = (np.where(has_kink, at_best(y[:, :, 3:]), np.nan) for y in (forward, backward))
    return Differences(value, at_best(spread) < 0.5 * limit, (forward, backward))


class Difference(NamedTuple):
    """An answer or a derivative whose error exceeds the limit."""

    kind: SceneKind
    scene: int
    answer: str  # name of the answer, or of its derivative with the parameter
    route: str  # tolerance or method
    ours: float  # compared value; the code of the result if the scene did not finish
    right: float  # reference value; NaN if the scene did not finish
    name: str  # one of the names at the top of this module

    def __str__(self):
        return (
            f"{self.kind}, scene {self.scene}: {self.answer} at {self.route} is {self.ours:.12g}, not "
            f"{self.right:.12g} ({self.name})"
        )


def compare(
    kind: SceneKind, batch: Scenes, outputs: tuple[str, ...], with_ways: bool = False
) -> list[Difference]:
    """Return the answers and derivatives of a batch whose errors exceed the limits."""
    count = (len(batch.t_end),)
    peaks = {rtol: solve(batch, outputs, rtol, sensitivities=PARAMETERS) for rtol in TOLERANCES}
    loose, reference, tight = (finite_columns(peak, outputs, count) for peak in peaks.values())
    # The answer at the tightest tolerance is taken as correct, unless the two others agree on another value.
    is_outlier = 10 * np.abs(loose - reference) < np.abs(tight - reference)
    reference = np.where(is_outlier | np.isnan(tight), reference, tight)
    names = labels(peaks[TOLERANCES[0]], outputs)
    limit = RELATIVE * np.abs(reference) + ABSOLUTE
    limit[[name == "margin" for name in names]] = RELATIVE
    differences = differentiate(batch, outputs)
    speed = np.asarray(peaks[TOLERANCES[-1]].smallest_impact_speed / (batch.podium.p * batch.podium.alpha))
    codes = [results.code_of(y.result) for y in peaks.values()]
    answered = ~results.did_not_finish(np.max(codes, axis=0))
    unsettled = {
        "grazing": ~differences.settled & (speed < GRAZES)[:, None],
        "unsettled": ~differences.settled,
    }
    deviations: list[Difference] = []

    @functools.cache
    def with_smaller_steps(scene: int) -> np.ndarray:
        single = batch if count == (1,) else batch.only(scene)  # `--again` has a batch of one scene
        return differentiate(single, outputs, SMALLER_STEPS).values[:, 0]

    def add(answers, route, ours, reference, is_off, masks):
        for index in map(tuple, np.argwhere(is_off).tolist()):
            column, scene, *parameter = index
            answer = answers[column]
            if parameter:
                answer = f"d {answer}/d ln {PARAMETERS[parameter[0]]}"
            causes = () if np.isnan(ours[index]) else masks.items()
            name = next((name for name, mask in causes if mask[index]), "FAULT")
            if parameter and name == "FAULT":
                error = abs(ours[index] - with_smaller_steps(scene)[column, parameter[0]])
                name = "unsettled" if error <= slope_limit[index] else name
            deviations.append(Difference(kind, scene, answer, route, ours[index], reference[index], name))

    def judge(route, rtol, peak):
        deviations.extend(unfinished(kind, route, peak))
        values = finite_columns(peak, outputs, count)
        has_answer = answered & ~results.did_not_finish(results.code_of(peak.result))
        is_off = ~(np.abs(values - reference) <= limit) & has_answer
        if is_off.any():
            masks = {name: mask.any(axis=-1) for name, mask in unsettled.items()}
            flagged = flags(outputs, batch, rtol, np.maximum(limit, np.abs(values - reference)))
            add(names, route, values, reference, is_off, {"flagged": flagged, **masks})

    slope_limit = RELATIVE * (np.abs(differences.values) + np.abs(reference)[..., None]) + ABSOLUTE
    slopes = {rtol: columns(y.sensitivities, outputs, count, last=1) for rtol, y in peaks.items()}
    errors = {rtol: np.abs(y - differences.values) for rtol, y in slopes.items()}
    ordered = np.stack([errors[rtol] for rtol in TOLERANCES])
    is_slow = np.all(np.diff(ordered, axis=0) < 0, axis=0) & (ordered[-1] <= 10 * slope_limit)
    is_slow &= kind.devices == "power"
    for rtol, peak in peaks.items():
        judge(f"{rtol:g}", rtol, peak)
        wrong = ~(errors[rtol] <= slope_limit) & answered[:, None]
        if wrong.any():
            on_side = [np.abs(slopes[rtol] - side) <= 100 * slope_limit for side in differences.sides]
            tighter = [errors[other] <= slope_limit for other in TOLERANCES if other < rtol]
            converges = (errors[rtol] <= 100 * slope_limit) & np.all(tighter, axis=0) & (len(tighter) > 0)
            flagged = np.broadcast_to(flags(outputs, batch, rtol, limit)[..., None], wrong.shape)
            slow = is_slow & (errors[rtol] <= 1000 * slope_limit)
            masks = {"tie": on_side[0] | on_side[1], "flagged": flagged, **unsettled}
            masks |= {"converges": converges, "slow": slow}
            add(names, f"{rtol:g}", slopes[rtol], differences.values, wrong, masks)
    if with_ways:
        for route, rtol, requested, method in (
            ("no derivatives", TOLERANCES[1], outputs, "dopri8"),
            ("all impacts", TOLERANCES[1], (*outputs, "impacts"), "dopri8"),
            ("tsit5", TOLERANCES[2], outputs, "tsit5"),
        ):
            judge(route, rtol, solve(batch, requested, rtol, method))
    return deviations


def unfinished(kind: SceneKind, route: str, peak: rj.Peak) -> list[Difference]:
    """Return an entry for each scene of a batch that did not finish."""
    codes = np.asarray(results.code_of(peak.result))
    name_of = lambda code: "FAULT" if code == results.NOT_FINITE else NOT_COMPARED
    return [
        Difference(kind, int(k), "result", route, float(codes[k]), np.nan, name_of(codes[k]))
        for k in np.flatnonzero(results.did_not_finish(codes))
    ]


def flags(outputs: tuple[str, ...], batch: Scenes, rtol: float, error: np.ndarray) -> np.ndarray:
    """Return a mask of answers whose estimated errors cover `error`, shape (columns, scenes).

    For the margin, the estimate of the rotation is used.
    """
    errors: Any = solve(batch, (*outputs, "errors"), rtol).errors
    estimated = tuple("peak_rotation" if name == "margin" else name for name in outputs)
    size = columns(errors, estimated, (len(batch.t_end),))
    return np.asarray(errors.undecided) | (SAFETY * size >= np.where(np.isnan(error), np.inf, error))


def write(difference: Difference, scene: Scenes, folder: Path) -> None:
    """Write a scene with all parameters to a file, which `--again` reads."""
    leaves = [np.asarray(leaf).tolist() for leaf in jax.tree.leaves(scene)]
    serialised = difference._replace(
        kind=str(difference.kind), ours=float(difference.ours), right=float(difference.right)
    )
    words = "-".join(
        (str(difference.kind), str(difference.scene), *difference.answer.replace("/", " by ").split())
    )
    path = folder / f"{words}.json"
    path.write_text(json.dumps(serialised._asdict() | {"leaves": leaves}))


def read(path: Path) -> tuple[SceneKind, Scenes]:
    """Return the scene of a file, as a batch of one scene."""
    data = json.loads(path.read_text())
    kind = SceneKind.from_name(data["kind"])
    template = scenes(kind, 1, 0).scene(0)
    leaves = [
        np.asarray(y, np.asarray(z).dtype)
        for y, z in zip(data["leaves"], jax.tree.leaves(template), strict=True)
    ]
    return kind, jax.tree.unflatten(jax.tree.structure(template), leaves).as_batch()


def table(kind: SceneKind, deviations: list[Difference], count: int) -> list[str]:
    """Return lines with the number of scenes for each name of a difference, and one fault of each answer."""

    def count_scenes(differences: list[Difference]) -> str:
        counts = collections.Counter(name for name, _ in {(y.name, y.scene) for y in differences})
        return ", ".join(f"{count} {name}" for name, count in counts.most_common()) or "all agree"

    by_answer: dict[str, list[Difference]] = {}
    for deviation in deviations:
        by_answer.setdefault(deviation.answer, []).append(deviation)
    lines = [f"{kind}: {count} scenes, {count_scenes(deviations)}"]
    lines += [f"  {answer}: {count_scenes(members)}" for answer, members in by_answer.items()]
    faults = {y.answer: y for y in deviations if y.name == "FAULT"}
    return lines + [f"  {y}" for y in faults.values()]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", type=int, nargs="?", default=1000)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    parser.add_argument("kinds", nargs="*")
    parser.add_argument("--forces", action="store_true")
    parser.add_argument("--ways", action="store_true")
    parser.add_argument("--faults", type=Path)
    parser.add_argument("--again", type=Path)
    arguments = parser.parse_args()
    outputs_of = lambda kind: FORCES if arguments.forces else OUTPUTS[kind.top]
    if arguments.again:
        kind, batch = read(arguments.again)
        print(*compare(kind, batch, outputs_of(kind), arguments.ways), sep="\n")
        return
    for kind in SceneKind.matching(arguments.kinds):
        batch = scenes(kind, arguments.scenes, arguments.seed)
        deviations = compare(kind, batch, outputs_of(kind), arguments.ways)
        print(*table(kind, deviations, arguments.scenes), sep="\n", flush=True)
        if arguments.faults:
            arguments.faults.mkdir(parents=True, exist_ok=True)
            for deviation in deviations:
                if deviation.name == "FAULT":
                    write(deviation, batch.scene(deviation.scene), arguments.faults)


if __name__ == "__main__":
    main()
