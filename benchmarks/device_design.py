"""Tendons, dampers and inerters sized by exact gradients, each from ten starts.

`python -m benchmarks.device_design [force] [stiffness] [damper] [inerter] [building] [vertical] [figures]`.

- force: the least prestress of tendons that keeps the rotation below 0.4 α
- stiffness: the least prestress for several stiffnesses of the tendons, the least stiffness without
  prestress, and the prestress and stiffness for the least force
- damper: coefficient and exponent for the least rotation, with a limit on the shear
- inerter: the inertance for the least rotation, and the least inertance for 0.4 α
- building: width of the columns and prestress under a five-storey building, for the least drift and the least
  base shear, compared with the building on a fixed base
- vertical: needs `--records FOLDER` with horizontal and vertical components of stations, which
  `rockjax.read_suite(FOLDER).paired()` reads. Every pair is scaled so that its horizontal PGA is a multiple
  of g tan α. The first table compares peak rotations with and without the vertical component. The second
  table has the least prestress for 0.4 α under the shorter pairs, with and without the vertical component,
  and the results of a scan over the prestress
- figures: draws the pictures of `docs/device-design.md` from the tables of the other studies

Every design is simulated again by `rockjax.peak_responses` at rtol = 1e-12. Central differences check that
the design is optimal.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from scipy.stats import wilcoxon

import optimise
import rockjax as rj
from optimise._descent import Evaluation
from optimise._objectives import AbstractObjective, PodiumFunction
from optimise._optimality import optimality
from optimise._suite import Suite
from optimise._targets import AbstractResponses
from optimise._variables import make_variables
from rockjax import plots
from rockjax._files import write_figure

from .measure import IMAGES, report, show, store_rows, stored_rows
from .studies import OPTIONS, shaking

STARTS = 10
LIMIT = 0.4  # largest max|θ|/α
COLUMN, WEIGHT = 1500.0, 1500.0 * 9.80665  # mass [kg] and weight [N] of a column
RIGID: dict[str, Any] = {"width": 0.45, "height": 3.0, "column_mass": COLUMN, "beam_mass": 30e3}
ELASTIC: dict[str, Any] = RIGID | {"top_mass": 300e3, "period": 0.5}
ABOVE_GAP = 190e3  # prestress [N] above the gap in which the rotation exceeds the limit again
STIFFNESSES = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 4.0)  # divided by the critical stiffness
SHEARS = (0.35, 0.36, 0.38, 0.4)  # limits of the shear, divided by m_t g
LARGEST_INERTANCE = 900e3  # [kg], 600 times the mass of a column
CHECK_OPTIONS = rj.Options(
    rtol=1e-12, atol=1e-14, outputs=("peak_rotation", "margin", "peak_shear"), throw=False, max_steps=100_000
)
DAMPED = OPTIONS.replace(rtol=1e-7, atol=1e-9)  # with ν < 1 tighter tolerances need many more steps
STEP = 1e-6  # step of central differences, in scaled variables
Motions = list[rj.AbstractExcitation]
Device = TypeVar("Device", rj.Tendon, rj.Inerter)


def records() -> Motions:
    """Return ten synthetic near-fault records of 7 s with a PGA of 4 m/s²."""
    return [shaking(k, 4.0) for k in range(10)]


def pulses(count: int = 8) -> Motions:
    """Return symmetric Ricker pulses; longer pulses are weaker."""
    pairs = zip(np.linspace(4.5, 2.5, count), np.linspace(0.5, 1.6, count), strict=True)
    return [rj.Ricker(float(a), float(T)) for a, T in pairs]


def short_pulses() -> Motions:
    """Return six symmetric Ricker pulses that do not overturn the podium with the superstructure."""
    pairs = zip((5.0, 4.5, 4.0, 3.7, 3.4, 3.2), (0.5, 0.65, 0.8, 0.95, 1.1, 1.2), strict=True)
    return [rj.Ricker(a, T) for a, T in pairs]


SUITES: dict[str, Callable[[], Motions]] = {"records": records, "pulses": pulses}


def first_device(podium: rj.Podium, device_class: type[Device]) -> Device:
    """Return the first restrainer of a class."""
    return next(device for device in podium.restrainers if isinstance(device, device_class))


def prestress(podium: rj.Podium):
    """Return τ = P₀/(m_c g)."""
    return first_device(podium, rj.Tendon).prestress


def stiffness(podium: rj.Podium):
    """Return κ = K R/(m_c g) divided by its critical value."""
    return first_device(podium, rj.Tendon).stiffness / podium.critical_stiffness


def force_at(podium: rj.Podium, rotation):
    """Return the force of a tendon divided by m_c g; `rotation` is divided by α."""
    tendon, half = first_device(podium, rj.Tendon), rotation * podium.alpha / 2
    return tendon.prestress + 4 * tendon.stiffness * jnp.sin(podium.alpha) * jnp.sin(half)


def force_at_limit(podium: rj.Podium):
    return force_at(podium, LIMIT)


def inertance(podium: rj.Podium):
    """Return μ = b/m_c."""
    return first_device(podium, rj.Inerter).inertance


class Problem(NamedTuple):
    """Arguments of `optimise.design`, and the motions of the targets."""

    base: optimise.Dimensions
    vary: dict[str, tuple[float, float]]
    minimise: AbstractObjective
    targets: tuple[optimise.AbstractTarget, ...]
    motions: Motions
    options: rj.Options = OPTIONS  # options of the search

    def solve(self) -> optimise.Design:
        return optimise.design(
            self.base, self.vary, self.minimise, self.targets, starts=STARTS, options=self.options
        )


def fresh_peaks(podium: rj.Podium, motions: Motions, options: rj.Options = CHECK_OPTIONS) -> rj.Peak:
    """Return the peak responses to motions of one kind."""
    (group,) = Suite.of(motions).groups
    return rj.peak_responses(podium, group, options=options)


def simulate_again(problem: Problem, podium: rj.Podium) -> tuple[np.ndarray, np.ndarray, rj.Peak]:
    """Return objective values, target margins and peak responses from a new simulation."""
    items = [item for item in (problem.minimise, *problem.targets) if isinstance(item, AbstractResponses)]
    outputs = {*CHECK_OPTIONS.outputs, *(name for item in items for name in item.outputs)}
    tight = CHECK_OPTIONS.replace(outputs=tuple(sorted(outputs)))
    peaks = fresh_peaks(podium, problem.motions, tight)

    def evaluate(item, method: str) -> np.ndarray:
        reads_peaks = isinstance(item, AbstractResponses)
        values = item.read(peaks, tight) if reads_peaks else getattr(item, method)(podium, tight)
        return np.atleast_1d(values)

    margins = [evaluate(target, "margins") for target in problem.targets]
    return evaluate(problem.minimise, "values"), np.concatenate([np.zeros(0), *margins]), peaks


class Check(NamedTuple):
    """Results of a new simulation of a design."""

    margin: float  # smallest margin
    rotation: float  # largest max|θ|/α
    shear: float  # largest shear
    motion: int  # index of the motion with the largest rotation
    price: float  # shadow price, by central differences
    residual: float  # residual of the optimality conditions, by central differences


def check(problem: Problem, answer: optimise.Design) -> Check:
    varied = make_variables(answer.structure, problem.vary)
    x = np.asarray(varied.start())
    f, c, peaks = simulate_again(problem, varied.podium(jnp.asarray(x)))
    slopes: tuple[list, list] = [], []
    for k in range(len(x)):
        ends = [np.clip(x + sign * STEP * np.eye(len(x))[k], 0, 1) for sign in (-1, 1)]
        below, above = (simulate_again(problem, varied.podium(jnp.asarray(y))) for y in ends)
        for column, a, b in zip(slopes, below[:2], above[:2], strict=True):
            column.append((b - a) / (ends[1][k] - ends[0][k]))
    scale = max(abs(float(f.max())), 1e-12)
    current = Evaluation(f / scale, c, np.stack(slopes[0], -1) / scale, np.stack(slopes[1], -1))
    conditions = optimality(x, current, [], 1.0, 1e3, 0.0)
    return Check(
        float(c.min(initial=np.inf)),
        float(np.max(peaks.peak_rotation)),
        float(np.max(peaks.peak_shear)),
        int(np.argmax(peaks.peak_rotation)),
        scale * float(conditions.multipliers.sum()),
        conditions.residual,
    )


def row_of(name: str, problem: Problem) -> dict:
    """Return the row of a design from ten starts. `same` counts starts within 1e-4 of the best objective."""
    start_time = time.process_time()
    answer = problem.solve()
    objectives = [start.objective for start in answer.starts if start.satisfied]
    same = [abs(y - answer.objective) <= 1e-4 * abs(answer.objective) for y in objectives]
    checked = check(problem, answer)
    row = {
        "study": name,
        **answer.variables,
        "objective": answer.objective,
        "satisfied": len(objectives),
        "same": sum(same),
        "ends": [start.objective for start in answer.starts],
        "at bound": [name for name in problem.vary if _at_bound(problem, answer, name)],
        "price": {name: float(np.sum(y)) for name, y in answer.multipliers.items()},
        "evaluations": answer.stats.evaluations,
        "scenes": answer.stats.scenes,
        "result": str(optimise.RESULTS[answer.result]),
        **{f"fresh {key}": value for key, value in checked._asdict().items()},
    }
    row["cpu s"] = time.process_time() - start_time
    print({key: value for key, value in row.items() if key != "ends"}, flush=True)
    return row | tendon_of(answer.podium, checked.rotation)


def _at_bound(problem: Problem, answer: optimise.Design, name: str) -> bool:
    low, high = problem.vary[name]
    value = answer.variables[name]
    return min(value - low, high - value) <= 1e-6 * (high - low)


def tendon_of(podium: rj.Podium, rotation: float) -> dict:
    """Return the parameters and the largest force of a tendon, divided by m_c g; empty without tendons."""
    if not any(isinstance(device, rj.Tendon) for device in podium.restrainers):
        return {}
    return {
        "prestress": float(prestress(podium)),
        "stiffness": float(stiffness(podium)),
        "largest force": float(force_at(podium, rotation)),
        "lifts at": float(podium.uplift_ground_acceleration) / float(podium.g),
    }


def least_force(motions: Motions, over_critical: float = 0.0, from_force: float = 0.0) -> Problem:
    """Return the problem of the least prestress with max|θ| ≤ 0.4 α.

    - `motions`: the motions
    - `over_critical`: stiffness of the tendons divided by the critical stiffness
    - `from_force`: lower bound of the prestress [N]
    """
    plain = rj.Podium.from_dimensions(**RIGID)
    slope = over_critical * float(plain.critical_stiffness) * WEIGHT / float(plain.R)
    base = optimise.Dimensions(**RIGID, tendon_force=50e3, tendon_stiffness=slope)
    return Problem(
        base,
        {"tendon_force": (from_force, 400e3)},
        PodiumFunction(prestress),
        (optimise.PeakRotation(LIMIT, motions),),
        motions,
    )


def least_stiffness(motions: Motions) -> Problem:
    """Return the problem of the least stiffness of tendons without prestress."""
    base = optimise.Dimensions(**RIGID, tendon_stiffness=20e6)
    vary, target = {"tendon_stiffness": (1e5, 1e9)}, optimise.PeakRotation(LIMIT, motions)
    return Problem(base, vary, PodiumFunction(stiffness), (target,), motions)


def least_largest_force(motions: Motions) -> Problem:
    """Return the problem of prestress and stiffness for the least force at the limit of the rotation."""
    base = optimise.Dimensions(**RIGID, tendon_force=50e3, tendon_stiffness=1e6)
    vary = {"tendon_force": (0.0, 400e3), "tendon_stiffness": (0.0, 5e6)}
    target = optimise.PeakRotation(LIMIT, motions)
    return Problem(base, vary, PodiumFunction(force_at_limit), (target,), motions)


def least_rotation(shear: float) -> Problem:
    """Return the problem of the damper coefficient and exponent for the least rotation with limited shear."""
    motions = short_pulses()
    base = optimise.Dimensions(**ELASTIC, damper_coefficient=2e6, damper_exponent=0.8)
    vary = {"damper_coefficient": (1e5, 3e7), "damper_exponent": (0.6, 1.0)}
    target = optimise.PeakShear(shear, motions)
    return Problem(base, vary, optimise.WorstRotation(motions), (target,), motions, DAMPED)


def best_inertance(motions: Motions, law: str | float) -> Problem:
    """Return the problem of the inertance for the least rotation, with a law of restitution."""
    base = optimise.Dimensions(**RIGID, inertance=100e3, restitution=law)
    vary = {"inertance": (0.0, LARGEST_INERTANCE)}
    return Problem(base, vary, optimise.WorstRotation(motions), (), motions)


def least_inertance(motions: Motions, law: str | float) -> Problem:
    """Return the problem of the least inertance with max|θ| ≤ 0.4 α."""
    problem = best_inertance(motions, law)
    target = optimise.PeakRotation(LIMIT, problem.motions)
    return problem._replace(minimise=PodiumFunction(inertance), targets=(target,))


def force_rows() -> list[dict]:
    cases = {"least": 0.0, "above the gap": ABOVE_GAP}
    return [
        row_of(name, least_force(motions(), from_force=start)) | {"suite": suite}
        for suite, motions in SUITES.items()
        for name, start in cases.items()
        if suite == "records" or name == "least"
    ]


def stiffness_rows() -> list[dict]:
    rows = []
    for suite, motions in SUITES.items():
        suite = motions()
        problems = {"prestress alone": least_force(suite)}
        problems |= {f"κ = {ratio:g} κ_cr": least_force(suite, ratio) for ratio in STIFFNESSES}
        problems |= {"stiffness alone": least_stiffness(suite), "both": least_largest_force(suite)}
        rows += [row_of(name, problem) | {"suite": suite} for name, problem in problems.items()]
    return rows


def damper_rows() -> list[dict]:
    return [row_of(f"V_s ≤ {shear:g} m_t g", least_rotation(shear)) | {"shear": shear} for shear in SHEARS]


def inerter_rows() -> list[dict]:
    factor = float(rj.Podium.from_dimensions(**RIGID).restitution_factor)  # without an inerter
    laws: dict[str, str | float] = {"Eq. C12": "paper", "given": factor}
    rows = []
    for suite, motions in SUITES.items():
        for name, law in laws.items():
            if name == "Eq. C12" or suite == "records":
                row = row_of("least rotation", best_inertance(motions(), law))
                rows.append(row | {"suite": suite, "law": name})
        row = row_of("least inertance", least_inertance(motions(), "paper"))
        rows.append(row | {"suite": suite, "law": "Eq. C12"})
    return rows


STORIES, HEIGHT = 5, 3.0
BUILDING = optimise.Dimensions(
    width=0.6, height=3.0, column_mass=2700.0, columns=4, beam_mass=30e3,
    story_masses=[20e3] * STORIES, story_stiffnesses=[12e6] * STORIES, story_heights=[HEIGHT] * STORIES,
)  # fmt: skip
VARY = {"width": (0.3, 1.2), "tendon_force": (0.0, 200e3)}
SEARCH = OPTIONS.replace(rtol=1e-7, atol=1e-9)


def demands(podium: rj.Podium, motions: Motions) -> dict[str, float]:
    """Return the largest demands of the motions on a building."""
    outputs = ("peak_rotation", "peak_drift", "peak_shear", "peak_floor_acceleration")
    peak = fresh_peaks(podium, motions, SEARCH.replace(outputs=outputs))
    return {
        "drift [%]": 100 * float(np.max(np.asarray(peak.peak_drift))),
        "base shear": float(np.max(np.asarray(peak.peak_shear))),
        "floor acceleration [g]": float(np.max(np.asarray(peak.peak_floor_acceleration))) / 9.80665,
        "rotation": float(np.max(np.asarray(peak.peak_rotation))),
    }


def building_rows() -> list[dict]:
    motions: Motions = [shaking(k, 3.0) for k in range(10)]
    target = optimise.PeakRotation(LIMIT, motions)
    objectives = {
        "least drift": optimise.WorstDrift(motions),
        "least base shear": optimise.WorstShear(motions),
    }
    rows = []
    for name, objective in objectives.items():
        row = row_of(name, Problem(BUILDING, VARY, objective, (target,), motions, SEARCH))
        sized = BUILDING.replace(width=row["width"], tendon_force=row["tendon_force"])
        rows.append(row | demands(sized.podium(), motions))
    initial = BUILDING.podium()
    fixed = initial.replace(alpha=1.5)  # columns that do not lift
    return rows + [{"study": n} | demands(p, motions) for n, p in (("as drawn", initial), ("fixed", fixed))]


DT = 0.02  # sampling interval of all motions [s]
ARIAS_RANGE = (0.01, 0.97)  # retained range of the Arias intensity of the horizontal component
RATIOS = (1.5, 2.0, 3.0)  # PGA divided by g tan α
SIZES = (0.5, 1.0, 2.0)  # size of the columns divided by that of the other studies
DESIGN_RATIO = 2.0  # ratio for designs
LEAST_ROTATION = 1e-3  # smaller max|θ|/α are not compared
SHORT_LENGTH = 2000  # designs use pairs with fewer samples
SCAN = np.linspace(60e3, 130e3, 701)  # prestress [N], from no satisfied limit to all satisfied
SCANNED = "least of the scan [N]", "throughout from [N]", "satisfied between", "changes"
Pairs = list[rj.GroundMotion]


def read(folder: Path) -> rj.Motions:
    """Return the pairs of a folder, resampled to `DT` and cut to the strong motion."""
    return rj.read_suite(folder).paired().map(lambda pair: pair.resampled(DT).trimmed(*ARIAS_RANGE))


def vertical_of(motion: rj.Motion) -> rj.Motion:
    """Return the vertical component of a motion. Raises `ValueError` without one."""
    if motion.vertical is None:
        raise ValueError(f"{motion.name} has no vertical component")
    return motion.vertical


def pairs_of(motions: rj.Motions, pga: float) -> Pairs:
    """Return pairs of equal length, padded with zeros and scaled to a horizontal PGA [m/s²]."""
    size = max(len(y) for motion in motions for y in (motion, vertical_of(motion)))

    def record(samples: np.ndarray, scale: float) -> rj.Record:
        return rj.Record(np.pad(scale * samples, (0, size - len(samples))), DT)

    return [
        rj.GroundMotion(
            record(motion.acceleration, pga / motion.pga),
            record(vertical_of(motion).acceleration, pga / motion.pga),
        )
        for motion in motions
    ]


def horizontal(pairs: Pairs) -> list[rj.AbstractExcitation]:
    return [pair.horizontal for pair in pairs]


def compare_components(motions: rj.Motions, size: float, ratio: float) -> list[dict]:
    """Return a row for every pair: rotations with and without the vertical component, and PGAs."""
    podium = rj.Podium.from_dimensions(**RIGID)
    podium = podium.replace(R=size * podium.R)
    pairs = pairs_of(motions, ratio * float(podium.g * jnp.tan(podium.alpha)))
    with_vertical, without = (fresh_peaks(podium, list(ms), OPTIONS) for ms in (pairs, horizontal(pairs)))
    return [
        {
            "record": motion.name,
            "component": str(motion.metadata.get("component")),
            "PGA [g]": motion.pga / 9.80665,
            "V/H": vertical_of(motion).pga / motion.pga,
            "R [m]": float(podium.R),
            "ratio": ratio,
            "with": float(with_vertical.peak_rotation[k]),
            "without": float(without.peak_rotation[k]),
            "overturned with": bool(with_vertical.overturned[k]),
            "overturned without": bool(without.overturned[k]),
        }
        for k, motion in enumerate(motions)
    ]


def summary(rows: list[dict]) -> dict:
    """Return statistics of the effect of the vertical component, for pairs that rock and survive with and
    without it."""
    surviving = [row for row in rows if not (row["overturned with"] or row["overturned without"])]
    pairs = np.array([[row["with"], row["without"]] for row in surviving if row["without"] > LEAST_ROTATION])
    logs = np.log(pairs[:, 0] / pairs[:, 1])
    test: Any = wilcoxon(logs)
    return {
        "pairs": len(rows),
        "compared": len(logs),
        "median": float(np.exp(np.median(logs))),
        "smallest": float(np.exp(logs.min())),
        "largest": float(np.exp(logs.max())),
        "larger with": int(np.sum(logs > 0)),
        "p": float(test.pvalue),
        "overturned with": sum(row["overturned with"] for row in rows),
        "overturned without": sum(row["overturned without"] for row in rows),
    }


def scan_prestress(case: list[rj.AbstractExcitation]) -> dict[str, float]:
    """Return results of a scan over the prestress: the least value that satisfies the limit, the value above
    which all values satisfy it, the share of satisfying values between the two, and the number of changes."""
    podiums = rj.Podium.from_dimensions(**RIGID, tendon_force=jnp.asarray(SCAN))
    peaks = [rj.peak_responses(podiums, motion, options=OPTIONS) for motion in case]
    satisfied = np.all([(p.peak_rotation <= LIMIT) & ~p.overturned for p in peaks], axis=0)
    first, last = np.argmax(satisfied), len(SCAN) - np.argmin(satisfied[::-1])
    changes = np.sum(satisfied[1:] != satisfied[:-1])
    values = SCAN[first], SCAN[last], satisfied[first:last].mean(), changes
    return dict(zip(SCANNED, map(float, values), strict=True))


def designs(motions: rj.Motions) -> list[dict]:
    """Return designs of the least prestress for the shorter pairs, with and without vertical component."""
    podium = rj.Podium.from_dimensions(**RIGID)
    short = rj.Motions(tuple(motion for motion in motions if len(motion) < SHORT_LENGTH))
    print(f"{len(short)} pairs of less than {SHORT_LENGTH} samples", flush=True)
    pairs = pairs_of(short, DESIGN_RATIO * float(podium.g * jnp.tan(podium.alpha)))
    cases: dict[str, list[rj.AbstractExcitation]] = {"with": list(pairs), "without": horizontal(pairs)}
    return [row_of(name, least_force(case)) | scan_prestress(case) for name, case in cases.items()]


def vertical(folder: Path) -> None:
    motions = read(folder)
    print(f"{len(motions)} pairs, {min(map(len, motions))} to {max(map(len, motions))} samples", flush=True)
    tables = [compare_components(motions, size, ratio) for size in SIZES for ratio in RATIOS]
    rows = [row for table in tables for row in table]
    report("device-vertical", rows)
    show([{"R [m]": t[0]["R [m]"], "ratio": t[0]["ratio"]} | summary(t) for t in (*tables, rows)])
    rows = designs(motions)
    store_rows("device-vertical-design", rows)
    show(rows, [name for name in (*COLUMNS, *SCANNED) if name in rows[0]])


# -------------------------------------------------------------------------------- pictures
ROTATION_LABEL = r"largest $|\theta|\,/\,\alpha$ of all motions"
FORCE_LABEL = r"$P_0\,/\,(m_c g)$"
NAMES = {"records": "ten records", "pulses": "eight pulses"}
DRAWN = CHECK_OPTIONS.replace(rtol=1e-8, atol=1e-10)  # the checks have compiled these programs


def rotations(podiums: list[rj.Podium], motions) -> np.ndarray:
    """Return the peak rotations of podiums (rows) under motions (columns)."""
    return np.stack([np.asarray(fresh_peaks(y, motions, DRAWN).peak_rotation) for y in podiums])


def mark_limit(ax) -> None:
    ax.axhline(LIMIT, color="0.5", lw=0.8, ls="-", zorder=0)


def draw_force() -> Figure:
    """Draw peak rotations against the prestress, and histories without and with the least prestress."""
    figure = plt.figure(figsize=(9.5, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    design, above = (row for row in stored_rows("device-force") if row["suite"] == "records")
    sizes = np.linspace(0, 250e3, 251)
    peaks = rotations(
        [rj.Podium.from_dimensions(**RIGID, tendon_force=jnp.asarray(P)) for P in sizes], records()
    )
    left.plot(sizes / 1e3, peaks, color="0.75", lw=0.7, ls="-")
    left.plot(sizes / 1e3, peaks.max(axis=1), color=plots.COLOURS[0], ls="-", label="largest of ten records")
    for k, row in enumerate((design, above)):
        label = ("least prestress", "from 190 kN on")[k]
        force, rotation = row["tendon_force"] / 1e3, row["fresh rotation"]
        left.plot(force, rotation, "os"[k], ls="", color=plots.COLOURS[k + 1], label=label, zorder=3)
    mark_limit(left)
    left.set(
        xlabel=r"prestress of a tendon $P_0$ [kN]",
        ylabel=r"peak $|\theta|\,/\,\alpha$",
        xlim=(0, 250),
        ylim=(0, 1.05),
    )
    left.legend(loc="lower left")
    worst = records()[design["fresh motion"]]
    times = np.linspace(0, 9, 901)
    grey, red, green = (
        {"color": colour, "ls": "-"} for colour in ("0.6", plots.COLOURS[1], plots.COLOURS[3])
    )
    cases = ((0.0, grey), (design["tendon_force"], red), (ABOVE_GAP, green))
    for P, line_style in cases:
        podium = rj.Podium.from_dimensions(**RIGID, tendon_force=jnp.asarray(P))
        history = rj.simulate(podium, worst, options=rj.Options(throw=False))(times)
        label = f"$P_0$ = {P / 1e3:.0f} kN"
        right.plot(times, np.asarray(history.theta) / float(podium.alpha), label=label, **line_style)
    for limit in (-LIMIT, LIMIT):
        right.axhline(limit, color="0.5", lw=0.8, ls="-", zorder=0)
    right.set(xlabel=r"$t$ [s]", ylabel=plots.ROTATION, ylim=(-1.2, 1.2), xlim=(0, 9))
    right.legend(loc="lower right")
    return figure


def draw_stiffness() -> Figure:
    """Draw the least prestress and the largest force against the stiffness."""
    figure = plt.figure(figsize=(9.5, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for k, suite in enumerate(SUITES):
        rows = [row for row in stored_rows("device-stiffness") if row["suite"] == suite]
        designs = [row for row in rows if row["study"] == "prestress alone" or row["study"].startswith("κ")]
        line_style = {"color": plots.COLOURS[k + 1], "ls": plots.STYLES[k], "marker": "os"[k], "ms": 4}
        x = [row["stiffness"] for row in designs]
        left.plot(x, [row["prestress"] for row in designs], label=NAMES[suite], **line_style)
        right.plot(x, [row["largest force"] for row in designs], label=NAMES[suite], **line_style)
        alone = next(row for row in rows if row["study"] == "stiffness alone")
        right.plot(
            alone["stiffness"], alone["largest force"], "D", color=line_style["color"], ms=7, mfc="none"
        )
    right.plot([], [], "D", color="0.4", mfc="none", label="stiffness alone")
    left.set(
        xlabel=r"stiffness $\kappa\,/\,\kappa_{cr}$", ylabel="least prestress " + FORCE_LABEL, ylim=(0, None)
    )
    right.set(xlabel=r"stiffness $\kappa\,/\,\kappa_{cr}$", xscale="symlog", yscale="log")
    right.set_ylabel(r"largest force $P_\mathrm{max}\,/\,(m_c g)$")
    right.set_xlim(0, 50)
    right.set_xticks([0, 1, 10], ["0", "1", "10"])
    right.set_yticks([4, 10, 20, 50, 100], ["4", "10", "20", "50", "100"])
    right.minorticks_off()
    for ax in (left, right):
        ax.grid(alpha=0.3)
        ax.legend()
    return figure


def draw_damper() -> Figure:
    """Draw the largest rotation and shear for coefficients and exponents of the dampers, with the designs."""
    figure = plt.figure(figsize=(6.2, 4.2), layout="constrained")
    ax = figure.subplots()
    sizes, powers = np.geomspace(2e6, 3e7, 10), np.linspace(0.6, 1.0, 5)
    responses = [[fresh_peaks(_damped(C, power), short_pulses(), DRAWN) for C in sizes] for power in powers]
    worst = np.array([[float(np.max(response.peak_rotation)) for response in row] for row in responses])
    shear = np.array([[float(np.max(response.peak_shear)) for response in row] for row in responses])
    filled = ax.contourf(sizes / 1e6, powers, worst, levels=np.arange(0, 0.71, 0.05))
    figure.colorbar(filled, ax=ax, label=r"largest $|\theta|\,/\,\alpha$ of six pulses")
    rows = stored_rows("device-damper")
    lines = ax.contour(
        sizes / 1e6, powers, shear, levels=[row["shear"] for row in rows], colors="k", linewidths=0.8
    )
    ax.clabel(lines, fmt="%.3f", fontsize=7)
    for row in rows:
        if row["satisfied"]:
            ax.plot(
                row["damper_coefficient"] / 1e6,
                row["damper_exponent"],
                "o",
                color=plots.COLOURS[1],
                mec="w",
                clip_on=False,
            )
    ax.set(xscale="log", xlabel=r"coefficient $C$ [MN(s/m)$^\nu$]", ylabel=r"exponent $\nu$")
    ax.set_xticks([2, 5, 10, 20, 30], ["2", "5", "10", "20", "30"])
    ax.minorticks_off()
    ax.set_title(r"lines: largest shear $V_s\,/\,(m_t g)$; points: least rotation under them")
    return figure


def _damped(C: float, power: float) -> rj.Podium:
    return rj.Podium.from_dimensions(
        **ELASTIC, damper_coefficient=jnp.asarray(C), damper_exponent=jnp.asarray(power)
    )


def draw_inerter() -> Figure:
    """Draw the largest rotation against the inertance for both laws of restitution, with the designs."""
    figure = plt.figure(figsize=(9.5, 3.8), layout="constrained")
    rows = stored_rows("device-inerter")
    ratios = np.linspace(0, LARGEST_INERTANCE / COLUMN, 61)
    plain = float(rj.Podium.from_dimensions(**RIGID).restitution_factor)
    for ax, suite in zip(figure.subplots(1, 2, sharey=True), SUITES, strict=True):
        for k, (name, law) in enumerate({"Eq. C12": "paper", "given": plain}.items()):
            podiums = [
                rj.Podium.from_dimensions(**RIGID, inertance=jnp.asarray(COLUMN * mu), restitution=law)
                for mu in ratios
            ]
            line_style = {"color": plots.COLOURS[k + 1], "ls": plots.STYLES[k]}
            label = r"$e$ by (C12)" if law == "paper" else f"$e$ = {plain:.3f} given"
            ax.plot(ratios, rotations(podiums, SUITES[suite]()).max(axis=1), label=label, **line_style)
            for row in rows:
                if (row["suite"], row["law"]) == (suite, name) and row["satisfied"]:
                    shape = "o" if row["study"] == "least inertance" else "s"
                    ax.plot(
                        row["inertance"] / COLUMN,
                        row["fresh rotation"],
                        shape,
                        color=line_style["color"],
                        clip_on=False,
                    )
        mark_limit(ax)
        ax.set(
            xlabel=r"inertance $\mu = b\,/\,m_c$", title=NAMES[suite], xlim=(0, ratios[-1]), ylim=(0, 1.05)
        )
        ax.legend()
    figure.axes[0].set_ylabel(ROTATION_LABEL)
    return figure


def draw_vertical() -> Figure:
    """Draw peak rotations with the vertical component against peak rotations without it."""
    figure = plt.figure(figsize=(4.6, 4.2), layout="constrained")
    ax = figure.subplots()
    rows = stored_rows("device-vertical")
    for k, ratio in enumerate(sorted({row["ratio"] for row in rows})):
        chosen = [row for row in rows if row["ratio"] == ratio]
        x, y = (np.array([row[name] for row in chosen]) for name in ("without", "with"))
        label = rf"PGA = {ratio:g} $g\tan\alpha$"
        ax.plot(x, y, "osD^"[k], color=plots.COLOURS[k + 1], ms=4, mfc="none", label=label, clip_on=False)
    ax.plot([1e-3, 1], [1e-3, 1], color="0.5", lw=0.8, ls="-", zorder=0)
    ax.set(xscale="log", yscale="log", xlim=(1e-3, 1.0), ylim=(1e-3, 1.0), aspect="equal")
    ax.set(
        xlabel=r"peak $|\theta|\,/\,\alpha$, horizontal component alone",
        ylabel=r"peak $|\theta|\,/\,\alpha$ with the vertical one",
    )
    ax.grid(alpha=0.3)
    ax.legend(loc="upper left")
    return figure


PICTURES: dict[str, Callable[[], Figure]] = {
    "force": draw_force,
    "stiffness": draw_stiffness,
    "damper": draw_damper,
    "inerter": draw_inerter,
    "vertical": draw_vertical,
}


STUDIES: dict[str, Callable[[], list[dict]]] = {
    "force": force_rows,
    "stiffness": stiffness_rows,
    "damper": damper_rows,
    "inerter": inerter_rows,
    "building": building_rows,
}
COLUMNS = (
    "suite", "law", "study", "width", "tendon_force", "tendon_stiffness", "inertance", "damper_coefficient",
    "damper_exponent", "objective", "largest force", "drift [%]", "base shear", "floor acceleration [g]",
    "rotation", "satisfied", "same", "fresh margin", "fresh rotation", "fresh shear", "fresh residual",
    "evaluations", "scenes", "cpu s",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("studies", nargs="*", help=", ".join([*STUDIES, "vertical", "figures"]))
    parser.add_argument("--records", type=Path, metavar="FOLDER", help="records of the study `vertical`")
    arguments = parser.parse_args()
    for name in arguments.studies or STUDIES:
        if name == "vertical":
            vertical(arguments.records)
            continue
        if name == "figures":
            with plt.style.context(plots.STYLE):
                for picture, draw in PICTURES.items():
                    write_figure(IMAGES / f"device-{picture}.png", draw())
            continue
        rows = STUDIES[name]()
        store_rows(f"device-{name}", rows)
        show(rows, [name for name in COLUMNS if any(name in row for row in rows)])


if __name__ == "__main__":
    main()
