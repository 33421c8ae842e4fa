"""The functions `peak_response` (without a history) and `simulate` (with a history), which solve one scene:
one podium under one ground motion."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from rockjax import _results as results
from rockjax._checks import as_array, concrete, require
from rockjax._engine.flat import Nodes
from rockjax._engine.solve import solve
from rockjax._excitations.ground import check_weight
from rockjax._motions.convert import AnyMotion, as_excitation
from rockjax._motions.motion import Motions
from rockjax._motions.provenance import describe_origin
from rockjax._options import Options
from rockjax._programs.program import nans_allowed
from rockjax._results import REST, State
from rockjax._structures import Podium

from .arguments import (
    as_end,
    as_start,
    check_range,
    check_types,
    warn_of_amplitude_in_g,
    warn_of_small_restitution,
)
from .estimate import Errors, errors, second_options
from .on_floors import SecondarySystems, answers_on_floors
from .peak import Peak, peak_fields
from .response import Response

CAPACITY = 2**15  # initial capacity of a history outside jit, in steps


def peak_response(
    podium: Podium,
    excitation: AnyMotion,
    *,
    initial: State = REST,
    t_end: float | Array | None = None,
    options: Options = Options(),
    on_floors: SecondarySystems = (),
) -> Peak:
    """Compute the peak response of one scene, without history.

    The function works under `jit` and `vmap`, and under `grad`, `jacfwd` and `jvp` with respect to all arrays
    in `podium`, `excitation`, `initial` and `t_end`. For many scenes outside `jit`, use
    [`rockjax.peak_responses`][].

    - `podium`: a single podium; only modes, stories and columns may have an axis
    - `excitation`: a pulse, a wavelet, a record, a `Motion`, or any other [`rockjax.AbstractExcitation`][]
    - `initial`: state at the start of the excitation's support
    - `t_end`: latest end of the scene [s]; by default max(30/p, 10 T_s) after the end of the excitation, with
      the frequency parameter p of the podium and the longest period T_s of the superstructure, or 30/p if the
      superstructure does not vibrate
    - `options`: accuracy, requested outputs and limits
    - `on_floors`: light secondary systems on the floors, [`rockjax.Contents`][] and [`rockjax.Oscillator`][],
      one or a sequence of them. Their answers are the field `on_floors` of the result. The other fields do
      not depend on these systems

    Raises `ValueError` for invalid inputs and, with `options.throw`, `RuntimeError` for a scene that does not
    finish. Values that JAX traces, as under `jit`, are not checked; check `result` then.
    """
    arguments = _arguments("peak_response", podium, excitation, initial, t_end, options)
    floats, integers, _ = _solve(*arguments, None)
    return Peak(
        **peak_fields(podium, floats, integers, options, throw=options.throw),
        errors=_errors(arguments, floats, integers),
        on_floors=answers_on_floors("peak_response", *arguments, on_floors),
    )


def simulate(
    podium: Podium,
    excitation: AnyMotion,
    *,
    initial: State = REST,
    t_end: float | Array | None = None,
    options: Options = Options(),
    on_floors: SecondarySystems = (),
) -> Response:
    """Compute the response history of one scene until `t_end` or overturning. Without an elastic
    superstructure, the history also ends when the columns rest for good.

    - `podium`, `excitation`, `initial`, `t_end`, `options`, `on_floors`: as for [`rockjax.peak_response`][];
      under `jit` the history has a capacity of `options.history` steps, otherwise it grows as needed

    Peaks and estimated errors equal those of `peak_response` within the tolerance, unless rocking is chaotic;
    the output `"errors"` detects chaotic rocking. `impacts` counts all impacts up to the end of the history;
    in `peak_response` this number may be NaN or approximate unless requested. Raises the same exceptions as
    `peak_response`.
    """
    arguments = _arguments("simulate", podium, excitation, initial, t_end, options)
    (motion,) = excitation if isinstance(excitation, Motions) else (excitation,)
    # Every capacity needs a program of its own, so the first capacity is large enough for most scenes.
    largest_capacity = options.max_steps + 2
    is_concrete = not any(isinstance(y, Tracer) for y in jax.tree.leaves(arguments))
    capacity = min(max(options.history, CAPACITY), largest_capacity) if is_concrete else options.history
    while True:
        floats, integers, nodes = _solve(*arguments, capacity)
        is_full = concrete(integers["code"]) == results.HISTORY_FULL
        if not is_full or capacity >= largest_capacity:
            break
        capacity = min(4 * capacity, largest_capacity)
    assert nodes is not None
    nodes, impact_times = _used_nodes(nodes, integers["impacts"])
    return Response(
        **peak_fields(podium, floats, integers, options, throw=options.throw, history=True),
        errors=_errors(arguments, floats, integers),
        on_floors=answers_on_floors("simulate", *arguments, on_floors),
        impact_times=impact_times,
        podium=podium,
        excitation=arguments[1],
        nodes=nodes,
        options=options,
        origin=describe_origin(motion),
    )


def _used_nodes(nodes: Nodes, impacts: Array) -> tuple[Nodes, Array]:
    """Return the used nodes, and the times of impacts in ascending order. If the number of used nodes is
    traced, return all nodes, and the times of impacts padded with NaN."""
    count = concrete(nodes.used)
    if count is None or count.ndim:
        return nodes, jnp.sort(nodes.impact_time)  # NaN last
    used = int(count)
    if any(isinstance(y, Tracer) for y in jax.tree.leaves(nodes)):
        nodes = jax.tree.map(lambda y: y[:used] if jnp.ndim(y) else y, nodes)
        return nodes, jnp.sort(nodes.impact_time)[: int(impacts)]
    # NumPy saves time here, because outside jit every jnp operation compiles separately for every length.
    nodes = jax.tree.map(lambda y: as_array(np.asarray(y)[:used]) if jnp.ndim(y) else y, nodes)
    return nodes, as_array(np.sort(np.asarray(nodes.impact_time))[: int(impacts)])


def _solve(podium, excitation, initial, t_end, options, capacity):
    """Return the outputs of the scene as two dicts by name (floats; integers and flags), and the nodes of the
    history (None if `capacity` is None)."""
    (floats, nodes), (integers, node_integers) = solve(podium, excitation, initial, t_end, options, capacity)
    if nodes is not None:
        nodes = nodes._replace(piece=node_integers[0], used=node_integers[1])
    return floats, integers, nodes


def _errors(arguments, floats, integers) -> Errors | None:
    """Return the estimated errors from a second solution, or None if they are not requested."""
    podium, excitation, initial, t_end, options = arguments
    if "errors" not in options.outputs:
        return None
    constants = jax.lax.stop_gradient((podium, excitation, initial, t_end))
    second_floats, second_integers, _ = _solve(*constants, second_options(options), None)
    with nans_allowed():
        return errors((floats, integers), (second_floats, second_integers), options, jnp)


def _arguments(owner: str, podium, excitation, initial, t_end, options):
    """Convert the arguments to arrays, and check the values that are not traced by JAX."""
    check_types(owner, podium, options)
    excitation = as_excitation(owner, excitation)
    initial, t_end = as_start(owner, initial, podium), as_end(owner, t_end)
    for name, requirement, tree in (
        ("podium", "must have scalar parameters", podium.split_rows()),
        ("initial", "must have scalar fields", initial),
        ("t_end", "must be a scalar", t_end),
    ):
        shapes = {jnp.shape(y) for y in jax.tree.leaves(tree)} - {()}
        if shapes:
            raise ValueError(
                f"{owner}: {name} {requirement}, got arrays of shape {', '.join(map(str, shapes))}; "
                f"for batches use rockjax.peak_responses or jax.vmap"
            )
    for name in ("theta", "theta_dot", "u_t", "u_t_dot"):
        for value in jax.tree.leaves(getattr(initial, name)):
            require(owner, f"initial.{name}", value, np.isfinite, "finite")
    check_range(owner, podium, excitation, t_end, options)
    check_weight(owner, excitation, podium.g)
    warn_of_amplitude_in_g(owner, podium, excitation)
    warn_of_small_restitution(podium, stacklevel=4)
    return podium, excitation, initial, t_end, options
