"""Checks of a podium, an excitation and options."""

from __future__ import annotations

import functools

import jax
import numpy as np
from jaxtyping import Array

from rockjax._checks import as_float, check_dtype, concrete, float_type, require, require_instance
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.pulses import AbstractPulse
from rockjax._options import Options
from rockjax._results import REST, State
from rockjax._structures import STANDARD_GRAVITY, Podium
from rockjax._structures.modes import as_many, parts, with_fields
from rockjax._unit_warnings import warn_about_units


def check_types(owner: str, podium, options, name: str = "podium") -> None:
    """Raise `ValueError`, in the name of `owner`, for arguments of other types.

    - `owner`: name of the calling function, for messages
    - `podium`, `options`: a `Podium` and `Options`
    - `name`: name of the argument `podium` in messages
    """
    require_instance(owner, name, podium, Podium, "a rockjax.Podium")
    require_instance(owner, "options", options, Options, "rockjax.Options")
    for part, value in ((name, podium), ("options", options)):
        check_dtype(owner, part, value)
    check_precision(options)


def check_precision(options: Options) -> None:
    """Raise `ValueError` for tolerances that the default floating-point type cannot reach."""
    least, accepted = _least_tolerance(float_type())
    require("Options", "rtol", options.rtol, lambda v: v >= least, accepted)


@functools.cache
def _least_tolerance(kind: np.dtype) -> tuple[float, str]:
    """Return the least tolerance of a floating-point type, and its text."""
    least = 20 * float(np.finfo(kind).eps)
    return least, f">= {least:.1e} in {kind} (loosen it, or enable float64 with jax_enable_x64)"


def check_single(owner: str, podium: Podium) -> None:
    """Raise `ValueError` for a batch of podiums; axes of modes and stories are allowed."""
    if any(np.ndim(y) for y in jax.tree.leaves(podium.split())):
        raise ValueError(f"{owner}: podium must hold single numbers; call it once for each podium")


def as_start(owner: str, initial, podium: Podium) -> State:
    """Return the initial state as arrays, with a number for every scene in each.

    Displacements and velocities of several modes are split along their axis; a single number applies to all
    of them, as if all floors moved by it.
    """
    require_instance(owner, "initial", initial, State, "a rockjax.State")
    top = podium.superstructure
    if initial is REST and REST.theta.dtype == float_type() and (top is None or not top.has_mode_axis):
        return initial  # unchanged, because transfers to the device dominate in small batches
    initial = jax.tree.map(functools.partial(as_float, what=f"{owner}: initial"), initial)
    if top is None or not top.has_mode_axis:
        return initial
    count = top.count
    rows = {name: parts(as_many(getattr(initial, name), count)) for name in ("u_t", "u_t_dot")}
    for name, values in rows.items():
        if len(values) != count:
            raise ValueError(
                f"{owner}: initial.{name} must be one number or one for each of the {count} modes along its "
                f"last axis, got {len(values)}"
            )
    return with_fields(initial, rows)


def as_end(owner: str, t_end) -> Array | None:
    return None if t_end is None else as_float(t_end, f"{owner}: t_end")


def check_range(owner: str, podium: Podium, excitation: AbstractExcitation, t_end, options: Options) -> None:
    """Check concrete numbers against each other.

    - `owner`: name of the calling function, for messages
    - `podium`, `excitation`, `options`: of the scenes
    - `t_end`: end of the scenes [s], or None

    Raises `ValueError` for an `overturn_ratio` above π/(2α), for a margin that does not exist, and for a
    `t_end` before the excitation.
    """
    check_dtype(owner, "excitation", excitation)
    alpha, ratio = concrete(podium.alpha), concrete(options.overturn_ratio)
    if alpha is not None and ratio is not None:
        limit = float(np.pi / 2 / alpha.max())
        require(owner, "options.overturn_ratio", ratio, lambda v: v <= limit, f"<= π/(2α) = {limit:.6g}")
    if "margin" in options.outputs and ratio is not None and np.any(ratio > 1):
        _check_margin(owner, podium, ratio)
    if t_end is None:
        return
    start = concrete(excitation.support[0])
    if start is not None and start.ndim == 0:
        require(
            owner,
            "t_end",
            t_end,
            lambda v: v > start,
            f"after the start of the excitation at {float(start):.6g} s",
        )


def _check_margin(owner: str, podium: Podium, ratio: np.ndarray) -> None:
    """Raise `ValueError` for an overturn ratio without margin: past the stability angle a column may still
    return."""
    limit = concrete(podium.stability_angle / podium.alpha)
    if limit is not None:
        least = float(limit.min())
        accepted = (
            f"<= θ_s/α = {least:.6g} for the margin: past the stability angle a column may still come back"
        )
        require(owner, "options.overturn_ratio", ratio, lambda v: v <= least, accepted)


IN_G = 0.05, 1.0  # range of amplitudes of strong motion in g; in m/s² they lift almost no structure


def doubt_amplitude(owner: str, podium: Podium, excitation: AbstractExcitation) -> None:
    """Warn of a pulse that cannot lift the columns but would if its amplitude were in g.

    Only amplitudes of at most two digits, as typed by hand, are checked; computed ones are not.
    """
    size = concrete(excitation.a_p) if isinstance(excitation, AbstractPulse) else None
    if size is None or not IN_G[0] <= abs(size) < IN_G[1] or float(f"{float(size):.2g}") != float(size):
        return
    lifts, g = concrete(podium.uplift_ground_acceleration), concrete(podium.g)
    if lifts is not None and g is not None and abs(size) < lifts <= abs(size) * g:
        warn_about_units(
            f"{owner}: a_p = {float(size):g} m/s² is {abs(float(size / g)):.3g} g, and the columns lift at "
            f"{float(lifts / g):.3g} g; was it meant in g? rockjax takes m/s²: "
            f"a_p = {float(size):g} * {STANDARD_GRAVITY}",
            stacklevel=4,
        )
