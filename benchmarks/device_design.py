"""Tendons, dampers and inerters sized by exact gradients, each from ten starts:
`python -m benchmarks.device_design [force] [stiffness] [damper] [inerter]`.

(force) the least prestress that keeps the rotation under 0.4 α; (stiffness) the same beside tendons of given
stiffness, stiffness alone, and both together; (damper) coefficient and exponent for the least rotation under
a limit of the shear; (inerter) the inertance for the least rotation, and the least inertance for 0.4 α.

Every answer is simulated anew by `rockjax.peak_responses` at rtol = 1e-12, with central differences for
whether it is optimal.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import optimise
import rockjax as rj
from optimise._descent import Evaluation
from optimise._objectives import AbstractObjective, OfPodium
from optimise._optimality import optimality
from optimise._suite import Suite
from optimise._targets import AbstractResponses
from optimise._variables import variables

from .measure import keep, show
from .studies import OPTIONS, shaking

STARTS = 10
LIMIT = 0.4  # of max|θ|/α
COLUMN, WEIGHT = 1500.0, 1500.0 * 9.80665  # of a column [kg], [N]
RIGID: dict[str, Any] = {"width": 0.45, "height": 3.0, "column_mass": COLUMN, "beam_mass": 30e3}
ELASTIC: dict[str, Any] = RIGID | {"top_mass": 300e3, "period": 0.5}
ABOVE = 190e3  # [N]: with a little less than that the records rotate the columns further
STIFFNESSES = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 4.0)  # over the critical one
SHEARS = (0.35, 0.36, 0.38, 0.4)
LARGEST_INERTANCE = 900e3  # [kg], 600 masses of a column
TIGHT = rj.Options(
    rtol=1e-12, atol=1e-14, outputs=("peak_rotation", "margin", "peak_shear"), throw=False, max_steps=100_000
)
DAMPED = OPTIONS.replace(rtol=1e-7, atol=1e-9)  # with ν < 1 each digit costs steps
STEP = 1e-6  # of central differences, in scaled variables
Motions = list[rj.AbstractExcitation]


def records() -> Motions:
    """Ten synthetic near-fault records of 7 s with a peak of 4 m/s²."""
    return [shaking(k, 4.0) for k in range(10)]


def pulses(count: int = 8) -> Motions:
    """Symmetric Ricker pulses, the longer the weaker."""
    pairs = zip(np.linspace(4.5, 2.5, count), np.linspace(0.5, 1.6, count), strict=True)
    return [rj.Ricker(float(a), float(T)) for a, T in pairs]


def short_pulses() -> Motions:
    """Six symmetric Ricker pulses that do not overturn the podium with the superstructure."""
    pairs = zip((5.0, 4.5, 4.0, 3.7, 3.4, 3.2), (0.5, 0.65, 0.8, 0.95, 1.1, 1.2), strict=True)
    return [rj.Ricker(a, T) for a, T in pairs]


SUITES: dict[str, Callable[[], Motions]] = {"records": records, "pulses": pulses}


def prestress(podium: rj.Podium):
    """τ = P₀/(m_c g)."""
    return podium.restrainers[0].prestress


def stiffness(podium: rj.Podium):
    """κ = K R/(m_c g), over the critical one."""
    return podium.restrainers[0].stiffness / podium.critical_stiffness


def force_at(podium: rj.Podium, rotation):
    """Force of a tendon over m_c g at a rotation over α."""
    tendon, half = podium.restrainers[0], rotation * podium.alpha / 2
    return tendon.prestress + 4 * tendon.stiffness * jnp.sin(podium.alpha) * jnp.sin(half)


def force_at_limit(podium: rj.Podium):
    return force_at(podium, LIMIT)


def inertance(podium: rj.Podium):
    """μ = b/m_c."""
    return podium.restrainers[0].inertance


class Problem(NamedTuple):
    """A design problem: what `optimise.design` takes, and the motions by themselves."""

    base: optimise.Dimensions
    vary: dict[str, tuple[float, float]]
    minimise: AbstractObjective
    targets: tuple[optimise.AbstractTarget, ...]
    motions: Motions
    options: rj.Options = OPTIONS  # of the search

    def solve(self) -> optimise.Design:
        return optimise.design(
            self.base, self.vary, self.minimise, self.targets, starts=STARTS, options=self.options
        )


def fresh_peaks(podium: rj.Podium, motions: Motions, options: rj.Options = TIGHT) -> rj.Peak:
    """Peak responses to motions of one kind, one scene each."""
    (group,) = Suite.of(motions).groups
    return rj.peak_responses(podium, group, options=options)


def fresh(problem: Problem, podium: rj.Podium) -> tuple[np.ndarray, np.ndarray, rj.Peak]:
    """Values of the objective, margins of the targets, and the responses that they are of."""
    read_off = [item for item in (problem.minimise, *problem.targets) if isinstance(item, AbstractResponses)]
    outputs = {*TIGHT.outputs, *(name for item in read_off for name in item.outputs)}
    tight = TIGHT.replace(outputs=tuple(sorted(outputs)))
    peaks = fresh_peaks(podium, problem.motions, tight)

    def of(item, alone: str) -> np.ndarray:
        read = isinstance(item, AbstractResponses)
        return np.atleast_1d(item.read(peaks, tight) if read else getattr(item, alone)(podium, tight))

    margins = [of(target, "margins") for target in problem.targets]
    return of(problem.minimise, "values"), np.concatenate([np.zeros(0), *margins]), peaks


class Check(NamedTuple):
    """A design simulated anew: worst margin, largest rotation over α and shear, motion of that rotation;
    shadow prices and the `residual` of the optimality conditions by central differences."""

    margin: float
    rotation: float
    shear: float
    motion: int
    price: float
    residual: float


def check(problem: Problem, answer: optimise.Design) -> Check:
    varied = variables(answer.structure, problem.vary)
    x = np.asarray(varied.start())
    f, c, peaks = fresh(problem, varied.podium(jnp.asarray(x)))
    slopes: tuple[list, list] = [], []
    for k in range(len(x)):
        ends = [np.clip(x + side * STEP * np.eye(len(x))[k], 0, 1) for side in (-1, 1)]
        below, above = (fresh(problem, varied.podium(jnp.asarray(y))) for y in ends)
        for found, a, b in zip(slopes, below, above, strict=False):
            found.append((b - a) / (ends[1][k] - ends[0][k]))
    scale = max(abs(float(f.max())), 1e-12)
    here = Evaluation(f / scale, c, np.stack(slopes[0], -1) / scale, np.stack(slopes[1], -1))
    found = optimality(x, here, [], 1.0, 1e3, 0.0)
    return Check(
        float(c.min(initial=np.inf)),
        float(np.max(peaks.peak_rotation)),
        float(np.max(peaks.peak_shear)),
        int(np.argmax(peaks.peak_rotation)),
        scale * float(found.multipliers.sum()),
        found.residual,
    )


def row_of(name: str, problem: Problem) -> dict:
    """A design from ten starts as a row: where they ended, what it took, what holds of it."""
    began = time.process_time()
    answer = problem.solve()
    good = [start.objective for start in answer.starts if start.satisfied]
    same = [abs(y - answer.objective) <= 1e-4 * abs(answer.objective) for y in good]
    at = {name: low for name, (low, high) in problem.vary.items()}
    found = check(problem, answer)
    row = {
        "study": name,
        **answer.variables,
        "objective": answer.objective,
        "satisfied": len(good),
        "same": sum(same),
        "ends": [start.objective for start in answer.starts],
        "at bound": [name for name in at if _at_bound(problem, answer, name)],
        "price": {name: float(np.sum(y)) for name, y in answer.multipliers.items()},
        "evaluations": answer.stats.evaluations,
        "scenes": answer.stats.scenes,
        "result": str(optimise.RESULTS[answer.result]),
        **{f"fresh {key}": value for key, value in found._asdict().items()},
    }
    row["cpu s"] = time.process_time() - began
    print({key: value for key, value in row.items() if key != "ends"}, flush=True)
    return row | tendon_of(answer.podium, found.rotation)


def _at_bound(problem: Problem, answer: optimise.Design, name: str) -> bool:
    low, high = problem.vary[name]
    value = answer.variables[name]
    return min(value - low, high - value) <= 1e-6 * (high - low)


def tendon_of(podium: rj.Podium, rotation: float) -> dict:
    """What the tendon of a column has to carry, in m_c g; nothing without one."""
    if not any(isinstance(device, rj.Tendon) for device in podium.restrainers):
        return {}
    return {
        "prestress": float(prestress(podium)),
        "stiffness": float(stiffness(podium)),
        "largest force": float(force_at(podium, rotation)),
        "lifts at": float(podium.uplift_ground_acceleration) / float(podium.g),
    }


def least_force(motions: Motions, over_critical: float = 0.0, from_force: float = 0.0) -> Problem:
    """The least prestress [N], from one on, with which no motion rotates the columns by more than 0.4 α,
    beside a stiffness of the tendons over the critical one."""
    plain = rj.Podium.from_dimensions(**RIGID)
    slope = over_critical * float(plain.critical_stiffness) * WEIGHT / float(plain.R)
    base = optimise.Dimensions(**RIGID, tendon_force=50e3, tendon_stiffness=slope)
    return Problem(
        base,
        {"tendon_force": (from_force, 400e3)},
        OfPodium(prestress),
        (optimise.PeakRotation(LIMIT, motions),),
        motions,
    )


def least_stiffness(motions: Motions) -> Problem:
    """The same by stiffness alone."""
    base = optimise.Dimensions(**RIGID, tendon_stiffness=20e6)
    vary, target = {"tendon_stiffness": (1e5, 1e9)}, optimise.PeakRotation(LIMIT, motions)
    return Problem(base, vary, OfPodium(stiffness), (target,), motions)


def least_largest_force(motions: Motions) -> Problem:
    """Prestress and stiffness together, for the least force at the limit of rotation."""
    base = optimise.Dimensions(**RIGID, tendon_force=50e3, tendon_stiffness=1e6)
    vary = {"tendon_force": (0.0, 400e3), "tendon_stiffness": (0.0, 5e6)}
    target = optimise.PeakRotation(LIMIT, motions)
    return Problem(base, vary, OfPodium(force_at_limit), (target,), motions)


def least_rotation(shear: float) -> Problem:
    """Coefficient and exponent of the dampers for the least rotation under a limit of the shear."""
    motions = short_pulses()
    base = optimise.Dimensions(**ELASTIC, damper_coefficient=2e6, damper_exponent=0.8)
    vary = {"damper_coefficient": (1e5, 3e7), "damper_exponent": (0.6, 1.0)}
    target = optimise.PeakShear(shear, motions)
    return Problem(base, vary, optimise.WorstRotation(motions), (target,), motions, DAMPED)


def best_inertance(motions: Motions, law: str | float) -> Problem:
    """The inertance for the least rotation, by a law of restitution."""
    base = optimise.Dimensions(**RIGID, inertance=100e3, restitution=law)
    vary = {"inertance": (0.0, LARGEST_INERTANCE)}
    return Problem(base, vary, optimise.WorstRotation(motions), (), motions)


def least_inertance(motions: Motions, law: str | float) -> Problem:
    """The least inertance that keeps the rotation under 0.4 α."""
    problem = best_inertance(motions, law)
    target = optimise.PeakRotation(LIMIT, problem.motions)
    return problem._replace(minimise=OfPodium(inertance), targets=(target,))


def force_rows() -> list[dict]:
    cases = {"least": 0.0, "above the gap": ABOVE}
    return [
        row_of(name, least_force(motions(), from_force=start)) | {"suite": suite}
        for suite, motions in SUITES.items()
        for name, start in cases.items()
        if suite == "records" or name == "least"
    ]


def stiffness_rows() -> list[dict]:
    rows = []
    for suite, motions in SUITES.items():
        given = motions()
        problems = {"prestress alone": least_force(given)}
        problems |= {f"κ = {part:g} κ_cr": least_force(given, part) for part in STIFFNESSES}
        problems |= {"stiffness alone": least_stiffness(given), "both": least_largest_force(given)}
        rows += [row_of(name, problem) | {"suite": suite} for name, problem in problems.items()]
    return rows


def damper_rows() -> list[dict]:
    return [row_of(f"V_s ≤ {shear:g} m_t g", least_rotation(shear)) | {"shear": shear} for shear in SHEARS]


def inerter_rows() -> list[dict]:
    without = float(rj.Podium.from_dimensions(**RIGID).restitution_factor)
    laws: dict[str, str | float] = {"Eq. C12": "paper", "given": without}
    rows = []
    for suite, motions in SUITES.items():
        for name, law in laws.items():
            if name == "Eq. C12" or suite == "records":
                row = row_of("least rotation", best_inertance(motions(), law))
                rows.append(row | {"suite": suite, "law": name})
        row = row_of("least inertance", least_inertance(motions(), "paper"))
        rows.append(row | {"suite": suite, "law": "Eq. C12"})
    return rows


STUDIES: dict[str, Callable[[], list[dict]]] = {
    "force": force_rows,
    "stiffness": stiffness_rows,
    "damper": damper_rows,
    "inerter": inerter_rows,
}
FORMATS = {
    "suite": "", "law": "", "study": "", "tendon_force": ".0f", "tendon_stiffness": ".4g", "inertance": ".0f",
    "damper_coefficient": ".4g", "damper_exponent": ".4f", "objective": ".6g", "largest force": ".3f",
    "satisfied": "d", "same": "d", "fresh margin": ".1e", "fresh rotation": ".5f", "fresh shear": ".5f",
    "fresh residual": ".1e", "evaluations": "d", "scenes": "d", "cpu s": ".0f",
}  # fmt: skip


def main() -> None:
    for name in sys.argv[1:] or STUDIES:
        rows = STUDIES[name]()
        show(rows, {key: form for key, form in FORMATS.items() if any(key in row for row in rows)})
        keep(f"device-{name}", rows)


if __name__ == "__main__":
    main()
