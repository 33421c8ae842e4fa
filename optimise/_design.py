"""`design`: the structure that keeps its targets and minimises an objective."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import rockjax as rj
from rockjax._progress import bar as bar_of

from ._objectives import AbstractObjective, OfPodium
from ._results import CONVERGED, INFEASIBLE, INTERRUPTED, NAMES, NOT_FINITE, RESULTS, STALLED, named
from ._sqp import Descent, End, Evaluation, Iterate, Rules, descend, prepared, rank
from ._suite import Suite, same
from ._targets import AbstractResponses, AbstractTarget
from ._variables import Structure, Variables, as_podium, variables

REFINEMENTS = 3  # rounds that pull a design inside which only the accurate simulation finds outside
VERIFIED = {"rtol": 1e-11, "atol": 1e-13}


class Outcome(NamedTuple):
    """Where one start ended: variables in user units, verified objective and worst margin, and how."""

    variables: dict[str, float]
    objective: float
    margin: float
    satisfied: bool
    result: RESULTS
    iterations: int


class Effort(NamedTuple):
    """What a design cost: `evaluations` of a design with its derivatives, `scenes` simulated for them (the search of an
    overturning acceleration counts as one), `iterations` of all starts, `seconds` with compilation."""

    evaluations: int
    scenes: int
    iterations: int
    seconds: float


class Design(eqx.Module):
    """A design and the account of it.

    - `podium`: the structure; `structure`: the same in the form it was given (`Podium` or `Dimensions`)
    - `variables`: name → value in user units; `objective`: its largest value at the design
    - `satisfied`: all margins ≥ 0 in a fresh simulation with rtol 1e-11; `margins`: target → margins there [–]
    - `multipliers`: target → what the objective would fall by per unit of margin given away, that is per relative
      loosening of the limit [unit of the objective]; 0 for targets that do not bind, NaN where not satisfied
    - `result`: an `optimise.RESULTS`; `starts`: an `Outcome` of every start, this design's at `best`
    - `history`: an `Iterate` per iteration and start; `stats`: an `Effort`
    """

    podium: rj.Podium
    structure: Structure
    variables: dict[str, float]
    objective: float
    satisfied: bool
    margins: dict[str, np.ndarray]
    multipliers: dict[str, np.ndarray]
    result: RESULTS
    history: tuple[Iterate, ...]
    stats: Effort
    starts: tuple[Outcome, ...]
    best: int
    bounds: dict[str, tuple[float, float]]
    units: dict[str, str]
    minimised: str

    @property
    def failing(self) -> dict[str, float]:
        """Targets that are not satisfied, worst first: name → worst margin, negative [–]."""
        worst = {name: float(np.min(values)) for name, values in self.margins.items()}
        return {name: value for name, value in sorted(worst.items(), key=lambda item: item[1]) if not value >= 0}

    def __repr__(self):
        from ._report import table

        return table(self)

    def _repr_html_(self) -> str:
        from ._report import html

        return html(self)


def design(
    podium: Structure,
    vary: Mapping[str, tuple[float, float]],
    minimise: AbstractObjective | Callable[[rj.Podium], Any] | None = None,
    targets: AbstractTarget | Sequence[AbstractTarget] = (),
    *,
    method: Literal["sqp"] = "sqp",
    starts: int = 1,
    seed: int = 0,
    options: rj.Options = rj.Options(),
    tolerance: float = 1e-6,
    max_iterations: int = 60,
    progress: Any = False,
) -> Design:
    """The structure that keeps all targets and minimises an objective, by sequential quadratic programming (host).

    - `podium`: where to start from; what is not varied stays. An `optimise.Dimensions` lets masses vary
    - `vary`: name → (lowest, highest) in user units. Fields of a `Podium` (`alpha`, `R`, `gamma`, `lam`, `restitution`,
      `superstructure.eta`, `superstructure.T_s`, `superstructure.zeta`) or its `width` and `height`, of which one keeps the
      other; of `Dimensions` its numbers. A positive range wider than a factor of 10 is scaled logarithmically
    - `minimise`: an objective, or a function podium → number or vector, of which the largest entry counts. None looks for
      the nearest design that satisfies the targets
    - `targets`: what must hold. Those on the same motions share their simulations
    - `starts`: so many starting points, side by side: `podium` and a Latin hypercube drawn by `seed`
    - `options`: of the simulations; their `outputs` and `throw` are set as needed
    - `tolerance`: of the optimality conditions in scaled variables, and of margins [–]
    - `progress`: `True` for a progress bar, or anything with `update(iterations)`

    A design that cannot be satisfied is returned all the same, with `satisfied = False`, as the one whose worst violation
    is least. Raises `ValueError` for inputs that make no sense. Ctrl-C raises [`rockjax.Interrupted`][], whose `partial` is
    the best design seen until then, verified like any other.
    """
    began = time.perf_counter()
    _check(method, starts, tolerance, max_iterations)
    targets = (targets,) if isinstance(targets, AbstractTarget) else tuple(targets)
    for k, target in enumerate(targets):
        if not isinstance(target, AbstractTarget):
            raise ValueError(f"design: targets[{k}] must be a target such as optimise.PeakRotation, got {target!r}")
    if minimise is not None and not isinstance(minimise, AbstractObjective) and not callable(minimise):
        raise ValueError(f"design: minimise must be an objective or a function of the podium, got {minimise!r}")
    if minimise is None and not targets:
        raise ValueError("design: nothing to do: give minimise, targets or both")
    varied = variables(podium, vary)
    objective = minimise if isinstance(minimise, AbstractObjective) or minimise is None else OfPodium(minimise)
    options = options.replace(throw=False)
    problem = _problem(varied, objective, targets)
    points = _points(varied, starts, seed)
    accurate = options.replace(**{name: min(value, getattr(options, name)) for name, value in VERIFIED.items()})
    history: list[Iterate] = []
    ended: dict[int, End] = {}
    stopped = False
    # At most: the first evaluation, one an iteration, and those that verify.
    with bar_of(max_iterations + 2, "evaluations", progress) as bar:
        evaluate = _Evaluator(problem, options, points, tolerance, bar)
        try:
            first = evaluate(points)
        except KeyboardInterrupt:
            raise rj.Interrupted("stopped before the first evaluation", None) from None
        sizes = _names(targets, evaluate.sizes)
        scale = _scale([e for e in first if e.finite])
        rules = Rules(scale, tolerance, 0.25, tolerance, max_iterations)
        try:
            _run({k: descend(x, rules, history, k) for k, x in enumerate(points)}, evaluate, points, first, ended)
            evaluate.options = _traced(accurate)
            found = _verified(ended, evaluate, scale)
        except KeyboardInterrupt:
            stopped = True
            evaluate.options = _traced(accurate)
            ended |= {k: _so_far(k, evaluate, rules, history) for k in range(starts) if k not in ended}
            found = evaluate(_places(ended))
    ends = [ended[k] for k in range(starts)]
    effort = evaluate.effort(ends, began)
    design = _design(varied, objective, sizes, ends, found, scale, history, effort, podium)
    if stopped:
        raise rj.Interrupted(f"stopped after {effort.iterations} iterations", design)
    return design


def _verified(ended: dict[int, End], evaluate: _Evaluator, scale: float) -> list[Evaluation]:
    """What holds at the ends in the accurate simulation; designs that stopped just outside there are moved inside."""
    tolerance = evaluate.inside
    found = evaluate(_places(ended))
    for _ in range(REFINEMENTS):
        missing = {k: _missing(ended[k], e, tolerance) for k, e in enumerate(found)}
        # Aim further inside by what is missing.
        again = {
            k: descend(ended[k].x, Rules(scale, tolerance + 2 * short, 1e-2, tolerance, 12), [], k)
            for k, short in missing.items()
            if short
        }
        if not again:
            break
        _run(again, evaluate, _places(ended), found, ended)
        found = evaluate(_places(ended))
    return found


def _places(ended: dict[int, End]) -> np.ndarray:
    return np.stack([ended[k].x for k in range(len(ended))])


def _so_far(k: int, evaluate: _Evaluator, rules: Rules, history: list[Iterate]) -> End:
    """The best point that a start has seen; nobody knows its multipliers."""
    x, there = evaluate.best[k]
    iterations = sum(row.start == k for row in history)
    return End(x, np.full(len(there.c), np.nan), INTERRUPTED, iterations, prepared(there, rules))


def _check(method, starts, tolerance, max_iterations) -> None:
    if method != "sqp":
        raise ValueError(f"design: method must be 'sqp', got {method!r}")
    for name, value in (("starts", starts), ("max_iterations", max_iterations)):
        if not isinstance(value, int) or value < 1:
            raise ValueError(f"design: {name} must be a whole number ≥ 1, got {name} = {value!r}")
    if not 1e-10 <= tolerance <= 1e-2:
        raise ValueError(f"design: tolerance must be in [1e-10, 1e-2], got tolerance = {tolerance!r}")


class _Problem(eqx.Module):
    """What is differentiated. Suites are held once; `uses` says which one an item reads, −1 for those with none."""

    variables: Variables
    objective: AbstractObjective | None
    targets: tuple[AbstractTarget, ...]
    suites: tuple[Suite, ...]
    uses: tuple[int, ...] = eqx.field(static=True)  # of the targets, then the objective
    outputs: tuple[tuple[str, ...], ...] = eqx.field(static=True)  # of the suites
    scenes: int = eqx.field(static=True)

    def __call__(self, x: Float[Array, " n"], options: rj.Options) -> tuple[Float[Array, " k"], list[Float[Array, " m"]]]:
        """Values of the objective and margins of every target."""
        podium = self.variables.podium(x)
        peaks = [s.responses(podium, options, o) for s, o in zip(self.suites, self.outputs, strict=True)]

        def of(item, use: int, alone: Callable):
            return item.read(peaks[use], options) if use >= 0 else alone(podium, options)

        margins = [jnp.atleast_1d(of(t, use, t.margins)) for t, use in zip(self.targets, self.uses, strict=False)]
        if self.objective is None:
            return jnp.sum((x - self.variables.start()) ** 2)[None], margins
        return of(self.objective, self.uses[-1], self.objective.values), margins


def _problem(varied: Variables, objective: AbstractObjective | None, targets: tuple[AbstractTarget, ...]) -> _Problem:
    suites: list[Suite] = []
    outputs: list[set[str]] = []
    uses: list[int] = []
    stripped: list[Any] = []
    scenes = 0
    for item in (*targets, objective):
        if isinstance(item, AbstractResponses):
            place = next((k for k, suite in enumerate(suites) if same(suite, item.suite)), len(suites))
            if place == len(suites):
                suites.append(item.suite)
                outputs.append(set())
                scenes += len(item.suite)
            outputs[place] |= set(item.outputs)
            uses.append(place)
            item = eqx.tree_at(lambda i: i.suite, item, None)
        else:
            uses.append(-1)
            scenes += 0 if item is None else item.scenes
        # Python numbers would each be compiled in.
        stripped.append(jax.tree.map(lambda y: jnp.asarray(y, float) if isinstance(y, float) else y, item))
    wanted = tuple(tuple(sorted(names)) for names in outputs)
    return _Problem(varied, stripped[-1], tuple(stripped[:-1]), tuple(suites), tuple(uses), wanted, scenes)


@eqx.filter_jit
def _evaluated(problem: _Problem, options: rj.Options, points: Float[Array, "starts n"]):
    """(values, margins of every target), their Jacobians, and the values again, of all points."""

    def at(x):
        def twice(x):
            answer = problem(x, options)
            return answer, answer

        return jax.jacfwd(twice, has_aux=True)(x)

    return jax.vmap(at)(points)


def _traced(options: rj.Options) -> rj.Options:
    """Options whose numbers are not compiled in."""
    return jax.tree.map(lambda y: jnp.asarray(y, float), options)


class _Evaluator:
    """Evaluates a point of every start at once, so that one compilation serves; remembers the best, counts what it does.

    Better is what violates margins less, so far `inside`, and of two that satisfy them what has the lower objective.
    """

    def __init__(self, problem: _Problem, options: rj.Options, points: np.ndarray, inside: float, bar):
        self.problem, self.width, self.inside, self.bar = problem, len(points), inside, bar
        self.options = _traced(options)
        self.evaluations, self.sizes = 0, []
        self.best: list[tuple[np.ndarray, Evaluation]] = []

    def __call__(self, points: np.ndarray, count: int | None = None) -> list[Evaluation]:
        """Evaluations at points (width, n), of which `count` are asked for."""
        slopes, values = _evaluated(self.problem, self.options, jnp.asarray(points))
        (f, margins), (f_slope, slopes) = jax.tree.map(np.asarray, (values, slopes))
        self.sizes = [margin.shape[1] for margin in margins]
        self.evaluations += self.width if count is None else count
        none = np.zeros((self.width, 0)), np.zeros((self.width, 0, points.shape[1]))
        c, c_slope = (np.concatenate([blank, *ys], axis=1) for blank, ys in zip(none, (margins, slopes), strict=True))
        found = [Evaluation(*parts) for parts in zip(f, c, f_slope, c_slope, strict=True)]
        seen = list(zip(np.array(points), found, strict=True))
        self.best = [min(pair, key=self._standing) for pair in zip(self.best or seen, seen, strict=True)]
        self.bar.update(1)
        return found

    def _standing(self, seen: tuple[np.ndarray, Evaluation]) -> tuple[float, float]:
        _, there = seen
        return rank(there._replace(c=there.c - self.inside)) if there.finite else (np.inf, np.inf)

    def effort(self, ends: list[End], began: float) -> Effort:
        scenes = self.evaluations * self.problem.scenes
        return Effort(self.evaluations, scenes, sum(end.iterations for end in ends), time.perf_counter() - began)


def _points(varied: Variables, starts: int, seed: int) -> np.ndarray:
    """The given structure, and a Latin hypercube."""
    rng = np.random.default_rng(seed)
    n = len(varied.names)
    strata = np.stack([rng.permutation(starts - 1) for _ in range(n)], axis=1) if starts > 1 else np.zeros((0, n))
    sample = (strata + rng.uniform(size=strata.shape)) / max(starts - 1, 1)
    return np.concatenate([np.asarray(varied.start())[None], sample])


def _scale(first: list[Evaluation]) -> float:
    """So large are changes of the objective across the box, by its slopes at the starts."""
    slopes = [float(np.max(np.abs(e.f_slope))) for e in first]
    slopes = [slope for slope in slopes if slope > 0]
    if slopes:
        return float(np.median(slopes))
    return max([float(np.max(np.abs(e.f))) for e in first if np.any(e.f != 0)], default=1.0)


def _names(targets: tuple[AbstractTarget, ...], sizes: list[int]) -> dict[str, int]:
    """Name → number of margins, in order; a name that comes twice is numbered."""
    names: dict[str, int] = {}
    for target, size in zip(targets, sizes, strict=True):
        own = target.name or target.describe()
        name, k = own, 2
        while name in names:
            name, k = f"{own} ({k})", k + 1
        names[name] = size
    return names


def _run(
    descents: dict[int, Descent], evaluate: _Evaluator, points: np.ndarray, first: list[Evaluation], ends: dict[int, End]
) -> None:
    """Drive descents side by side, whose first points are evaluated already; an end is put down as soon as it is there."""
    points = np.array(points)

    def goes_on(k: int, evaluation: Evaluation | None) -> bool:
        try:
            points[k] = next(descents[k]) if evaluation is None else descents[k].send(evaluation)
        except StopIteration as stop:
            ends[k] = stop.value
            return False
        return True

    running = [k for k in descents if goes_on(k, None)]
    evaluations = first
    while running := [k for k in running if goes_on(k, evaluations[k])]:
        evaluations = evaluate(points, len(running))


def _missing(end: End, found: Evaluation, tolerance: float) -> float:
    """What a design lacks that its own simulation called satisfied, 0 for all others."""
    if end.result in (INFEASIBLE, NOT_FINITE) or not found.finite or found.violation == 0:
        return 0.0
    return found.violation if found.violation <= 1e3 * tolerance else 0.0


def _design(varied, objective, sizes, ends, found, scale, history, effort: Effort, given: Structure) -> Design:
    outcomes = []
    for end, e in zip(ends, found, strict=True):
        finite = bool(np.isfinite(e.c).all() and np.isfinite(e.f).all())
        satisfied = finite and e.violation == 0
        code = end.result if finite else NOT_FINITE
        if code in (CONVERGED, STALLED) and not satisfied:
            code = INFEASIBLE
        if code == INFEASIBLE and satisfied:
            code = STALLED
        values = np.asarray(varied.values(end.x))
        numbers = dict(zip(varied.names, map(float, values), strict=True))
        worst = float(np.min(e.c, initial=np.inf))
        outcomes.append(Outcome(numbers, float(np.max(e.f)), worst, satisfied, named(code), end.iterations))

    def order(k: int):
        outcome = outcomes[k]
        if not np.isfinite([outcome.objective, outcome.margin if sizes else 0.0]).all():
            return (2, 0.0)
        return (0, outcome.objective) if outcome.satisfied else (1, -outcome.margin)

    best = min(range(len(outcomes)), key=order)
    parts = np.cumsum([0, *sizes.values()])
    spans = [slice(a, b) for a, b in itertools.pairwise(parts)]
    final = outcomes[best]
    prices = scale * ends[best].multipliers if final.satisfied else np.full(parts[-1], np.nan)
    # From the user's own structure, whose plain numbers stay what they are.
    structure = variables(given, dict(zip(varied.names, zip(*_bounds(varied), strict=True), strict=True))).structure(
        ends[best].x
    )
    return Design(
        podium=as_podium(structure),
        structure=structure,
        variables=final.variables,
        objective=final.objective,
        satisfied=final.satisfied,
        margins={name: found[best].c[span] for name, span in zip(sizes, spans, strict=True)},
        multipliers={name: prices[span] for name, span in zip(sizes, spans, strict=True)},
        result=final.result,
        history=tuple(history),
        stats=effort,
        starts=tuple(outcomes),
        best=best,
        bounds=dict(zip(varied.names, zip(*_bounds(varied), strict=True), strict=True)),
        units=dict(zip(varied.names, varied.units, strict=True)),
        minimised="distance from the start" if objective is None else objective.describe(),
    )


def _bounds(varied: Variables) -> tuple[list[float], list[float]]:
    return np.asarray(varied.lower).tolist(), np.asarray(varied.upper).tolist()


def result_name(result: RESULTS) -> str:
    """The name of a result."""
    return NAMES[int(result._value)]
