"""The verbs: `simulate` with history, `peak_response` without."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from rockjax import _results as results
from rockjax._checks import as_float, concrete, of_kind, require
from rockjax._engine.solve import solve
from rockjax._excitations.base import AbstractExcitation
from rockjax._motions.convert import AnyMotion, as_excitation
from rockjax._options import Options
from rockjax._results import Errors, Peak, State, Stats
from rockjax._structures import Podium

from .estimate import companion, errors
from .response import Response

REST = State()


def peak_response(
    podium: Podium,
    excitation: AnyMotion,
    *,
    initial: State = REST,
    t_end: float | Array | None = None,
    options: Options = Options(),
) -> Peak:
    """Peak response of one scene, without history.

    Works under `jit`, `vmap`, `grad`, `jacfwd`, `jvp`, with respect to every number in `podium`, `excitation`, `initial`
    and `t_end`. For many scenes on the host see [`rockjax.peak_responses`][].

    - `excitation`: a pulse, a wavelet, a record, a `Motion`; or any other [`rockjax.AbstractExcitation`][]
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
    excitation: AnyMotion,
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
    check_types(owner, podium, options)
    excitation = as_excitation(owner, excitation)
    initial, t_end = as_start(owner, initial), as_end(owner, t_end)
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


def check_types(owner: str, podium, options, name: str = "podium") -> None:
    of_kind(owner, name, podium, Podium, "a rockjax.Podium")
    of_kind(owner, "options", options, Options, "rockjax.Options")
    options.check_precision()


def as_start(owner: str, initial) -> State:
    """The initial state as arrays."""
    of_kind(owner, "initial", initial, State, "a rockjax.State")
    return jax.tree.map(functools.partial(as_float, what=f"{owner}: initial"), initial)


def as_end(owner: str, t_end) -> Array | None:
    return None if t_end is None else as_float(t_end, f"{owner}: t_end")


def check_range(owner: str, podium: Podium, excitation: AbstractExcitation, t_end, options: Options) -> None:
    """What can be said of concrete numbers together."""
    alpha, ratio = concrete(podium.alpha), concrete(options.overturn_ratio)
    if alpha is not None and ratio is not None:
        limit = float(np.pi / 2 / alpha.max())
        require(owner, "options.overturn_ratio", ratio, lambda v: v <= limit, f"<= π/(2α) = {limit:.6g}")
    if t_end is None:
        return
    start = concrete(excitation.support[0])
    if start is not None and start.ndim == 0:
        require(owner, "t_end", t_end, lambda v: v > start, f"after the start of the excitation at {float(start):.6g} s")
