"""Do several ways lead to the same answers? `python -m benchmarks.agreement [scenes] [seed] [kind …]`.

Random scenes of every kind: what stands on the columns, what holds them, with and without vertical motion,
under motions that are rougher than earthquakes (noise of a few samples with offsets, steps that jump, pulses)
or none. Half of the podiums begin turned, turning or swaying, and some scenes end early. A kind is
`elastic-power-vertical-steps`, for instance; parts of such names choose all kinds that have them.

Answers at three tolerances are compared with each other, and derivatives by α and by the scale of the motion
with central differences that settle: three in a row agree, each of two steps. With `--ways`, answers are
compared as well with all impacts counted, without derivatives, and with `tsit5`. With `--faults FOLDER`, each
fault is written there, and `python -m benchmarks.agreement --again FILE` solves it again.

Whatever differs by more than errors do has one of these names:

- tie: two peaks are equal, and the derivative is that of one of them
- flagged: the estimate (`errors`) says that the answer is off by so much, or that the scene is undecided
- grazing: differences do not settle, after an impact of hardly any speed
- unsettled: likewise, without one: peaks of other impacts or another mode are close by
- converges: a derivative that is off by less than ten times the limit, and right at the tightest tolerance
- FAULT: none of these
"""

from __future__ import annotations

import argparse
import collections
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

TOPS = ("none", "rigid", "elastic", "modes", "building", "truncated", "unkept")
DEVICES = ("free", "linear", "power")
DIRECTIONS = ("horizontal", "vertical")
SAMPLED = ("rough", "steps", "rest")  # one program for all of them
MOTIONS = (*SAMPLED, *PULSES)
STORIES = 3
OUTPUTS = {
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

RECORDS, SAMPLES, SPACING = 40, 200, 0.02
TOLERANCES = (1e-8, 1e-10, 1e-12)
PARAMETERS = ("alpha", "scale")
STEPS = (3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6)  # of ln α and of the logarithm of the scale
RELATIVE, ABSOLUTE = 1e-5, 1e-8  # beyond which two answers differ
MOST_STEPS = 20_000  # of a scene, whose answers are left out else
SAFETY = 10.0  # times the estimated error
GRAZES = 1e-3  # of pα


class SceneClass(NamedTuple):
    """What a batch of scenes has in common."""

    top: str
    devices: str
    direction: str
    motion: str

    def __str__(self):
        return "-".join(self)

    @classmethod
    def matching(cls, words) -> Iterator[SceneClass]:
        """All kinds in whose names all parts of one of the words are."""
        for parts in itertools.product(TOPS, DEVICES, DIRECTIONS, MOTIONS):
            if not words or any(set(word.split("-")) <= set(parts) for word in words):
                yield cls(*parts)


class Scenes(NamedTuple):
    """A batch of scenes of one kind."""

    podium: rj.Podium
    motion: Any
    initial: rj.State
    t_end: np.ndarray

    def varied(self, alpha, scale) -> Scenes:
        """With α and the motion times factors."""
        alphas = np.asarray(self.podium.alpha) * alpha
        scales = np.broadcast_to(scale, np.broadcast_shapes(np.shape(scale), alphas.shape))
        return self._replace(podium=self.podium.replace(alpha=alphas), motion=self.motion.scaled(scales))

    def scene(self, k: int) -> Scenes:
        """One of them, with its own record."""
        one = lambda tree: jax.tree.map(lambda y: np.asarray(y)[k] if np.ndim(y) else y, tree)

        def select_motion(motion):
            if isinstance(motion, rj.GroundMotion):
                return rj.GroundMotion(select_motion(motion.horizontal), select_motion(motion.vertical))
            if not isinstance(motion, rj.Records):
                return one(motion)
            row = int(motion.which[k])
            return rj.Record(
                motion.acceleration[row], SPACING, motion.scale[k], t_start=float(motion.starts[row])
            )

        return Scenes(one(self.podium), select_motion(self.motion), one(self.initial), self.t_end[k])


def scenes(scene_class: SceneClass, count: int, seed: int) -> Scenes:
    """Random scenes; the same for the same arguments."""
    rng = np.random.default_rng([seed, *map(ord, str(scene_class))])
    draw = lambda low, high, *more: rng.uniform(low, high, (count, *more))
    side = lambda *more: rng.choice([-1.0, 1.0], (count, *more))
    alpha, gamma = draw(0.05, 0.5), rng.choice([0.01, 0.5, 2.0, 10.0, 50.0], count)
    structure = rj.Podium(
        alpha,
        10 ** draw(-0.3, 1),
        gamma,
        superstructure=_top(scene_class.top, draw),
        restitution=draw(0.3, 0.98),
        restrainers=_devices(scene_class.devices, draw),
    )
    lifts, p = np.asarray(structure.uplift_ground_acceleration), np.asarray(structure.p)
    strength = lifts * np.where(draw(0, 1) < 0.4, draw(0.9, 1.5), draw(1, 6)) * side()
    size = structure.g * draw(0.01, 0.95) * side()
    if scene_class.motion in PULSES:
        period = 2 * math.pi / (p * draw(1, 12))
        horizontal: Any = PULSES[scene_class.motion](strength, period)
        vertical: Any = rj.Ricker(size, period * draw(0.1, 1))
    else:
        make_records = lambda start: rj.Records.of(
            [rj.Record(row, SPACING, t_start=start) for row in _rows(rng, scene_class.motion == "steps")]
        ).pick(rng.integers(0, RECORDS, count))
        motion_factor = 0.0 if scene_class.motion == "rest" else 1.0
        horizontal = make_records(0.0).scaled(strength * motion_factor)
        vertical = make_records(0.1).scaled(size)
    motion = horizontal if scene_class.direction == "horizontal" else rj.GroundMotion(horizontal, vertical)
    turned = (draw(0, 1) < 0.4) | (scene_class.motion == "rest")
    theta = np.where(turned, alpha * 10 ** draw(-8, -0.3) * side(), 0.0)
    rate = np.where(turned & (draw(0, 1) < 0.5), p * alpha * draw(-0.5, 0.5), 0.0)
    start, end = (np.asarray(y) for y in motion.support)
    late = np.where(draw(0, 1) < 0.4, (end - start) * draw(0.3, 2.5), (end - start) * 3 + 30 / p)
    return Scenes(structure, motion, _initial(structure, turned, theta, rate, draw), start + late)


def _top(name: str, draw) -> Any:
    eta, zeta = 10 ** draw(-1, 2), draw(0.01, 0.2)
    if name == "none":
        return None
    if name == "rigid":
        return rj.Rigid(eta)
    if name == "elastic":
        return rj.Elastic(eta, 10 ** draw(-1.5, 0.5), zeta)
    if name == "modes":
        shares = draw(0.05, 1, STORIES + 1)
        parts = eta[:, None] * shares / shares.sum(axis=1, keepdims=True)
        return rj.Modes(parts[:, :-1], 10 ** draw(-1.6, 0.2, STORIES), draw(0.01, 0.2, STORIES), parts[:, -1])
    retained = {"building": STORIES, "truncated": STORIES - 1, "unkept": 0}[name]
    masses = 10 ** draw(-1, 1, STORIES)
    stiffnesses = masses * 10 ** draw(1, 3.5, 1) * draw(0.3, 2, STORIES)
    return rj.ShearBuilding(
        masses, stiffnesses, draw(0.01, 0.2, retained) if retained else 0.05, modes=retained
    )


def _devices(name: str, draw) -> tuple[Any, ...]:
    """Each of them is of no strength in some scenes."""
    some = lambda values: np.where(draw(0, 1) < 0.75, values, 0.0)
    if name == "free":
        return ()
    exponent = 1.0 if name == "linear" else draw(0.2, 1)
    return (
        rj.Tendon(some(10 ** draw(-1, 2)), some(10 ** draw(0, 2))),
        rj.Damper(some(10 ** draw(-1, 1.7)), exponent),
        rj.Inerter(some(10 ** draw(-1, 1.5))),
    )


def _initial(podium: rj.Podium, turned, theta, rate, draw) -> rj.State:
    count = getattr(podium.superstructure, "count", 0)
    if not podium.vibrates:
        return rj.State(theta=theta, theta_dot=rate)
    mode_shape = (count,) if isinstance(podium.superstructure, rj.Modes | rj.ShearBuilding) else ()
    sway = np.asarray(podium.R * np.sin(podium.alpha)) * turned * (draw(0, 1) < 0.5)
    sway = sway.reshape(-1, *[1] * len(mode_shape))
    return rj.State(theta, rate, sway * draw(-0.3, 0.3, *mode_shape), sway * draw(-1, 1, *mode_shape))


def _rows(rng: np.random.Generator, steps: bool) -> list[np.ndarray]:
    rows = []
    for k in range(RECORDS):
        row = np.convolve(rng.normal(size=SAMPLES + 8), np.hanning(9), "valid")
        row = row / np.abs(row).max() + (rng.uniform(-0.3, 0.3) if k % 3 == 0 else 0.0)
        rows.append(np.repeat(row[::25], 25)[:SAMPLES] if steps else row)
    return rows


def solve(batch: Scenes, outputs: tuple[str, ...], rtol: float, method="dopri8", **more) -> rj.Peak:
    options = rj.Options(
        rtol=rtol, atol=0.01 * rtol, outputs=outputs, method=method, max_steps=MOST_STEPS, throw=False
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # scenes without an answer
        return rj.peak_responses(
            batch.podium, batch.motion, initial=batch.initial, t_end=batch.t_end, options=options, **more
        )


def columns(answers: Any, names: tuple[str, ...], shape: tuple[int, ...], last: int = 0) -> np.ndarray:
    """The named answers, (columns, *shape, …): those of modes and stories are a column each. They have `last`
    axes behind these."""
    rows = []
    for name in names:
        values = np.asarray(getattr(answers, name))
        behind = values.shape[values.ndim - last :]
        rows.append(np.moveaxis(values.reshape(*shape, -1, *behind), len(shape), 0))
    return np.concatenate(rows)


def labels(answers: Any, names: tuple[str, ...]) -> list[str]:
    found = []
    for name in names:
        values = np.asarray(getattr(answers, name))
        found += [name] if values.ndim == 1 else [f"{name}[{j}]" for j in range(values.shape[-1])]
    return found


class Differences(NamedTuple):
    """Central differences over ln α and the logarithm of the scale, (columns, scenes, parameters)."""

    values: np.ndarray
    settled: np.ndarray
    sides: tuple[np.ndarray, np.ndarray]  # one-sided ones, where they differ however small the step, else NaN


def differentiate(batch: Scenes, outputs: tuple[str, ...]) -> Differences:
    """By solutions at the tightest tolerance. Of two steps in a row each, the error of second order is taken
    out; of these values, the three in a row that agree best."""
    h = np.array(STEPS)
    ones = np.ones((len(h), 1))
    up, down = 1 + h[:, None], 1 - h[:, None]
    alpha = np.concatenate([ones[:1], up, down, ones, ones])
    scale = np.concatenate([ones[:1], ones, ones, up, down])
    shape = (len(alpha), len(batch.t_end))
    peaks = solve(
        batch.varied(alpha, scale), outputs, TOLERANCES[-1], sensitivities=PARAMETERS
    )  # one program
    found = columns(peaks, outputs, shape)
    centre, shifted = found[:, :1], found[:, 1:]
    each = shifted.reshape(len(found), len(PARAMETERS), 2, len(h), shape[1])
    after = (each[:, :, 0] - centre[:, None]) / h[:, None]
    before = (centre[:, None] - each[:, :, 1]) / h[:, None]
    central = (after + before) / 2
    smaller = central[:, :, 1:]
    extrapolated = smaller + (smaller - central[:, :, :-1]) / ((h[:-1] / h[1:]) ** 2 - 1)[:, None]
    threes = np.stack([extrapolated[:, :, k : len(h) - 3 + k] for k in range(3)])
    spread = np.ptp(threes, axis=0)
    best = np.argmin(np.where(np.isnan(spread), np.inf, spread), axis=2)[:, :, None]
    of_best = lambda y: np.moveaxis(np.take_along_axis(y, best, axis=2)[:, :, 0], 1, -1)
    value, size = of_best(np.median(threes, axis=0)), np.abs(centre[:, 0, :, None])
    within = RELATIVE * (np.abs(value) + size) + ABSOLUTE
    # Of a smooth answer the two sides differ by so much less at a smaller step.
    gap = np.abs(after - before)
    kinked = of_best(gap[:, :, 3:] > 0.7 * gap[:, :, 2:-1]) & (of_best(gap[:, :, 3:]) > within)
    after, before = (np.where(kinked, of_best(y[:, :, 3:]), np.nan) for y in (after, before))
    return Differences(value, of_best(spread) < 0.5 * within, (after, before))


class Difference(NamedTuple):
    """An answer or a derivative that is off."""

    scene_class: SceneClass
    scene: int
    answer: str  # with the parameter, where it is a derivative
    route: str
    ours: float
    right: float
    name: str

    def __str__(self):
        return (
            f"{self.scene_class}, scene {self.scene}: {self.answer} at {self.route} is {self.ours:.12g} for "
            f"{self.right:.12g} ({self.name})"
        )


def compare(scene_class: SceneClass, batch: Scenes, with_ways: bool = False) -> list[Difference]:
    """All answers and derivatives of a batch that are off."""
    outputs, count = OUTPUTS[scene_class.top], (len(batch.t_end),)
    peaks = {rtol: solve(batch, outputs, rtol, sensitivities=PARAMETERS) for rtol in TOLERANCES}
    loose, right, tight = (columns(peak, outputs, count) for peak in peaks.values())
    # The tightest is right, unless the others agree on something else.
    alone = 10 * np.abs(loose - right) < np.abs(tight - right)
    right = np.where(alone | np.isnan(tight), right, tight)
    limit = RELATIVE * np.abs(right) + ABSOLUTE
    differences = differentiate(batch, outputs)
    slow = np.asarray(peaks[TOLERANCES[-1]].smallest_impact_speed / (batch.podium.p * batch.podium.alpha))
    names = labels(peaks[TOLERANCES[0]], outputs)
    codes = [results.code_of(y.result) for y in peaks.values()]
    answered = np.max(codes, axis=0) <= results.OVERTURNED
    unsettled = {
        "grazing": ~differences.settled & (slow < GRAZES)[:, None],
        "unsettled": ~differences.settled,
    }
    deviations: list[Difference] = []

    def add(answers, route, ours, right, is_off, named):
        for place in map(tuple, np.argwhere(is_off).tolist()):
            column, scene, *parameter = place
            answer = answers[column]
            if parameter:
                answer = f"d {answer}/d ln {PARAMETERS[parameter[0]]}"
            name = next((name for name, where in named.items() if where[place]), "FAULT")
            deviations.append(Difference(scene_class, scene, answer, route, ours[place], right[place], name))

    def judge(route, rtol, values):
        is_off = ~(np.abs(values - right) <= limit) & answered
        if is_off.any():
            named = {name: where.any(axis=-1) for name, where in unsettled.items()}
            flagged = flags(scene_class, batch, rtol, np.maximum(limit, np.abs(values - right)))
            add(names, route, values, right, is_off, {"flagged": flagged, **named})

    within = RELATIVE * (np.abs(differences.values) + np.abs(right)[..., None]) + ABSOLUTE
    slopes = {rtol: columns(y.sensitivities, outputs, count, last=1) for rtol, y in peaks.items()}
    errors = {rtol: np.abs(y - differences.values) for rtol, y in slopes.items()}
    for rtol, peak in peaks.items():
        judge(f"{rtol:g}", rtol, columns(peak, outputs, count))
        wrong = ~(errors[rtol] <= within) & answered[:, None]
        if wrong.any():
            near = [np.abs(slopes[rtol] - side) <= 100 * within for side in differences.sides]
            converges = (errors[rtol] <= 10 * within) & (errors[TOLERANCES[-1]] <= within)
            flagged = np.broadcast_to(flags(scene_class, batch, rtol, limit)[..., None], wrong.shape)
            named = {"tie": near[0] | near[1], "flagged": flagged, **unsettled, "converges": converges}
            add(names, f"{rtol:g}", slopes[rtol], differences.values, wrong, named)
    if with_ways:
        for route, rtol, asked, method in (
            ("no derivatives", TOLERANCES[1], outputs, "dopri8"),
            ("all impacts", TOLERANCES[1], (*outputs, "impacts"), "dopri8"),
            ("tsit5", TOLERANCES[2], outputs, "tsit5"),
        ):
            judge(route, rtol, columns(solve(batch, asked, rtol, method), outputs, count))
    return deviations


def flags(scene_class: SceneClass, batch: Scenes, rtol: float, error: np.ndarray) -> np.ndarray:
    """Where estimates allow for errors as large as `error`, (columns, scenes). The margin's is that of the
    rotation."""
    outputs = OUTPUTS[scene_class.top]
    errors: Any = solve(batch, (*outputs, "errors"), rtol).errors
    estimated = tuple("peak_rotation" if name == "margin" else name for name in outputs)
    size = columns(errors, estimated, (len(batch.t_end),))
    return np.asarray(errors.undecided) | (SAFETY * size >= np.where(np.isnan(error), np.inf, error))


def write(difference: Difference, scene: Scenes, folder: Path) -> None:
    """A scene with all its numbers, as `--again` reads it."""
    leaves = [np.asarray(leaf).tolist() for leaf in jax.tree.leaves(scene)]
    serialised = difference._replace(
        scene_class=str(difference.scene_class), ours=float(difference.ours), right=float(difference.right)
    )
    words = "-".join(
        (str(difference.scene_class), str(difference.scene), *difference.answer.replace("/", " by ").split())
    )
    path = folder / f"{words}.json"
    path.write_text(json.dumps(serialised._asdict() | {"leaves": leaves}))


def read(path: Path) -> tuple[SceneClass, Scenes]:
    """The scene of a file, as a batch of one."""
    data = json.loads(path.read_text())
    scene_class = SceneClass(*data["scene_class"].split("-"))
    like = scenes(scene_class, 1, 0).scene(0)
    leaves = [
        np.asarray(y, np.asarray(z).dtype) for y, z in zip(data["leaves"], jax.tree.leaves(like), strict=True)
    ]
    one = jax.tree.unflatten(jax.tree.structure(like), leaves)
    return scene_class, one._replace(motion=one.motion.scaled(np.ones(1)), t_end=np.reshape(one.t_end, 1))


def table(scene_class: SceneClass, deviations: list[Difference], count: int) -> list[str]:
    """How many scenes are off in all and in each answer, by name, and a fault of each answer."""

    def scenes_of(some: list[Difference]) -> str:
        each = collections.Counter(name for name, _ in {(y.name, y.scene) for y in some})
        return ", ".join(f"{number} {name}" for name, number in each.most_common()) or "all agree"

    by_answer: dict[str, list[Difference]] = {}
    for each in deviations:
        by_answer.setdefault(each.answer, []).append(each)
    lines = [f"{scene_class}: {count} scenes, {scenes_of(deviations)}"]
    lines += [f"  {answer}: {scenes_of(some)}" for answer, some in by_answer.items()]
    faults = {y.answer: y for y in deviations if y.name == "FAULT"}
    return lines + [f"  {y}" for y in faults.values()]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scenes", type=int, nargs="?", default=1000)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    parser.add_argument("kinds", nargs="*")
    parser.add_argument("--ways", action="store_true")
    parser.add_argument("--faults", type=Path)
    parser.add_argument("--again", type=Path)
    given = parser.parse_args()
    if given.again:
        scene_class, batch = read(given.again)
        print(*compare(scene_class, batch, given.ways), sep="\n")
        return
    for scene_class in SceneClass.matching(given.kinds):
        batch = scenes(scene_class, given.scenes, given.seed)
        deviations = compare(scene_class, batch, given.ways)
        print(*table(scene_class, deviations, given.scenes), sep="\n", flush=True)
        if given.faults:
            given.faults.mkdir(parents=True, exist_ok=True)
            for each in deviations:
                if each.name == "FAULT":
                    write(each, batch.scene(each.scene), given.faults)


if __name__ == "__main__":
    main()
