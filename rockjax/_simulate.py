"""The verbs: `simulate` with history, `peak_response` without."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from . import _results as results
from ._checks import as_float, concrete, require
from ._estimate import companion, errors
from ._excitations import AbstractExcitation
from ._flat import Nodes
from ._model import acceleration, beam, coefficients, energy
from ._options import Options
from ._results import AbstractPeak, Errors, Peak, State, Stats
from ._runge_kutta import step, tableau
from ._solve import solve
from ._structures import Elastic, Podium

REST = State()


class Response(AbstractPeak):
    """Time history of one scene: everything in [`rockjax.Peak`][], and the motion itself.

    `response(t)` is the state at any times within the scene, with the accuracy of the solve: one step of the method from
    the nearest node before. At an impact it is the state after it, with `left=True` the one before.

    - `impact_times`: when the columns struck the ground, ascending, padded with NaN under `jit` [s]
    - `times`: nodes of the history, padded with inf under `jit` [s]
    """

    impact_times: Float[Array, " impacts"]
    podium: Podium
    excitation: AbstractExcitation
    nodes: Nodes
    options: Options

    @property
    def times(self) -> Float[Array, " nodes"]:
        return self.nodes.t

    def __call__(self, t: Float[ArrayLike, "*times"], left: bool = False) -> State:
        """State at times t [s]; NaN before the start and after the end of the scene.

        A rigid scene that has settled is at rest for good, so it has no end.
        """
        t = as_float(t)
        theta, theta_dot, u_t, u_t_dot = jax.vmap(lambda s: self._at(s, left))(t.ravel())
        return State(*(y.reshape(t.shape) for y in (theta, theta_dot, u_t, u_t_dot)))

    def _at(self, t, left: bool):
        x, v, _ = self._motion(t, left)
        elastic = isinstance(self.podium.superstructure, Elastic)
        zero = jnp.where(jnp.isfinite(x[0]), 0.0, x[0])
        return x[0], v[0], x[1] if elastic else zero, v[1] if elastic else zero

    def _motion(self, t, left: bool):
        nodes, c = self.nodes, coefficients(self.podium)
        # The segments engine may have any solver; its nodes are bridged by an explicit one.
        explicit = (self.options if self.options.engine == "flat" else Options(method="dopri8")).solver
        k = jnp.searchsorted(nodes.t, t, side="left" if left else "right") - 1
        k = jnp.clip(k, 0, nodes.used - 1)
        x, v = tuple(y[k] for y in nodes.x), tuple(y[k] for y in nodes.v)
        start, sigma = nodes.t[k], nodes.sigma[k]
        ground = self.excitation.piece(nodes.piece[k])

        def field(t, x, v):
            return acceleration(c, sigma, ground(t), x, v)

        a = field(start, x, v)
        tab = tableau(explicit)  # pyright: ignore[reportArgumentType]
        trial = step(tab, field, start, t - start, x, v, a)
        at_rest = (self.result == results.RESULTS.settled) & (not c.elastic)
        inside = (t >= nodes.t[0]) & ((t <= self.stats.end_time) | at_rest)
        x, v = (tuple(jnp.where(inside, y, jnp.nan) for y in ys) for ys in (trial.x, trial.v))
        return x, v, sigma

    def deformation(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """Deformation of the superstructure u_t − u_b [m]; 0 without an elastic one."""
        return self._map(t, lambda c, x, v, sigma: x[1] - beam(c, sigma, x[0], v[0])[0] if c.elastic else 0.0 * x[0])

    def energy(self, t: Float[ArrayLike, "*times"]) -> Float[Array, "*times"]:
        """Mechanical energy relative to the ground per N m_c [m²/s²], Eqs. (16)–(19)."""
        return self._map(t, lambda c, x, v, sigma: energy(c, sigma, x, v))

    def _map(self, t: Float[ArrayLike, "*times"], quantity) -> Float[Array, "*times"]:
        t = as_float(t)
        c = coefficients(self.podium)

        def at(s):
            x, v, sigma = self._motion(s, left=False)
            return quantity(c, x, v, sigma)

        return jax.vmap(at)(t.ravel()).reshape(t.shape)


def peak_response(
    podium: Podium,
    excitation: AbstractExcitation,
    *,
    initial: State = REST,
    t_end: float | Array | None = None,
    options: Options = Options(),
) -> Peak:
    """Peak response of one scene, without history.

    Works under `jit`, `vmap`, `grad`, `jacfwd`, `jvp`, with respect to every number in `podium`, `excitation`, `initial`
    and `t_end`. For many scenes on the host see [`rockjax.peak_responses`][].

    - `initial`: the state at the start of the excitation's support
    - `t_end`: when to stop at the latest [s]; by default the end of the support plus 30/p, or 10 T_s if that is longer

    Raises `ValueError` for inputs that make no sense and, with `options.throw`, `RuntimeError` for a scene that ends
    without an answer, where values are concrete. Under `jit` look at `result`.
    """
    arguments = _arguments("peak_response", podium, excitation, initial, t_end, options)
    floats, integers, _ = _solved(*arguments, None)
    return Peak(**fields(floats, integers, options.throw), errors=_errors(arguments, floats, integers))


def simulate(
    podium: Podium,
    excitation: AbstractExcitation,
    *,
    initial: State = REST,
    t_end: float | Array | None = None,
    options: Options = Options(),
) -> Response:
    """Response history of one scene, to `t_end`, overturning, or (rigid) rest for good.

    Arguments and errors are those of [`rockjax.peak_response`][]; the peaks are the same numbers. Impacts are counted to
    the end of the history. Under `jit` the history holds `options.history` steps, outside as many as it needs.
    """
    arguments = _arguments("simulate", podium, excitation, initial, t_end, options)
    capacity = options.history
    while True:
        floats, integers, nodes = _solved(*arguments, capacity)
        full = concrete(integers["code"]) == results.HISTORY_FULL
        if not full or capacity >= options.max_steps + 1:
            break
        capacity = min(4 * capacity, options.max_steps + 1)
    assert nodes is not None
    impact_times = jnp.sort(nodes.impact_time)  # NaN last
    count = concrete(nodes.used)
    if count is not None and count.ndim == 0:
        used = int(count)
        nodes = jax.tree.map(lambda y: y[:used] if jnp.ndim(y) else y, nodes)
        impact_times = impact_times[: int(integers["impacts"])]
    return Response(
        **fields(floats, integers, options.throw),
        errors=_errors(arguments, floats, integers),
        impact_times=impact_times,
        podium=podium,
        excitation=excitation,
        nodes=nodes,
        options=options,
    )


def _solved(podium, excitation, initial, t_end, options, history):
    (floats, smooth), (integers, rest) = solve(podium, excitation, initial, t_end, options, history)
    nodes = None if smooth is None else smooth._replace(piece=rest[0], used=rest[1])
    return floats, integers, nodes


def _errors(arguments, floats, integers) -> Errors | None:
    """The estimated errors of a solution, by a second one."""
    podium, excitation, initial, t_end, options = arguments
    if "errors" not in options.outputs:
        return None
    constants = jax.lax.stop_gradient((podium, excitation, initial, t_end))
    second, counts, _ = _solved(*constants, companion(options), None)
    return errors((floats, integers), (second, counts), options.overturn_ratio, jnp)


def fields(floats, integers, throw: bool = False) -> dict:
    """The fields of a `Peak` from the answers of its lanes."""
    code = integers["code"]
    if throw:
        raise_without_answer(code)
    stats = Stats(integers["steps"], integers["rejected"], floats["end_time"])
    names = (
        "peak_rotation",
        "peak_rotation_time",
        "overturn_time",
        "uplift_time",
        "peak_deformation",
        "peak_shear",
        "margin",
        "smallest_impact_speed",
    )
    flags = ("exceeded_alpha", "overturned", "uplifted", "impacts")
    return {
        **{name: floats[name] for name in names},
        **{name: integers[name] for name in flags},
        "result": results.named(code),
        "stats": stats,
    }


def raise_without_answer(code: Array) -> None:
    """Raise `RuntimeError` if any (concrete) scene ended without an answer, naming the first."""
    codes = concrete(code)
    if codes is None:
        return
    failed = np.argwhere(codes > results.OVERTURNED)
    if len(failed):
        first = tuple(int(k) for k in failed[0])
        name = results.NAMES[int(codes[first])]
        where = f" at index {first} ({len(failed)} of {codes.size} scenes)" if codes.ndim else ""
        message = results.RESULTS[getattr(results.RESULTS, name)]
        raise RuntimeError(f"rockjax: scene ended '{name}'{where}. {message} (Options(throw=False) returns it instead)")


def _arguments(owner: str, podium, excitation, initial, t_end, options):
    """The arguments as arrays, checked where they are concrete."""
    check_types(owner, podium, excitation, options)
    initial = jax.tree.map(as_float, initial)
    t_end = None if t_end is None else as_float(t_end)
    for name, tree in (("podium", podium), ("initial", initial), ("t_end", t_end)):
        shapes = {jnp.shape(y) for y in jax.tree.leaves(tree)} - {()}
        if shapes:
            raise ValueError(
                f"{owner}: {name} must hold single numbers, got arrays of shape {shapes}; "
                f"for batches use rockjax.peak_responses or jax.vmap"
            )
    for name, value in zip(("theta", "theta_dot", "u_t", "u_t_dot"), jax.tree.leaves(initial), strict=True):
        require(owner, f"initial.{name}", value, np.isfinite, "finite")
    check_range(owner, podium, excitation, t_end, options)
    return podium, excitation, initial, t_end, options


def check_types(owner: str, podium, excitation, options) -> None:
    for name, value, kind in (
        ("podium", podium, Podium),
        ("excitation", excitation, AbstractExcitation),
        ("options", options, Options),
    ):
        if not isinstance(value, kind):
            raise ValueError(f"{owner}: {name} must be a rockjax {kind.__name__}, got {value!r}")
    options.check_precision()


def check_range(owner: str, podium: Podium, excitation: AbstractExcitation, t_end, options: Options) -> None:
    """What can be said of concrete numbers together."""
    alpha, ratio = concrete(podium.alpha), concrete(options.overturn_ratio)
    if alpha is not None and ratio is not None:
        limit = float(np.pi / 2 / alpha.max())
        require(owner, "options.overturn_ratio", ratio, lambda v: v <= limit, f"<= π/(2α) = {limit:.6g}")
    start = concrete(excitation.support[0])
    if t_end is not None and start is not None and start.ndim == 0:
        require(owner, "t_end", t_end, lambda v: v > start, f"after the start of the excitation at {float(start):.6g} s")
