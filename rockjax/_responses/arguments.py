"""Checks and conversion of the arguments of functions that solve scenes.

A scene is one podium under one ground motion.
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from rockjax._checks import (
    array_module,
    as_float,
    check_dtype,
    concrete,
    float_type,
    require,
    require_instance,
)
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.pulses import AbstractPulse
from rockjax._options import Options
from rockjax._restrainers.combined import apparent_mass
from rockjax._results import REST, State
from rockjax._structures import STANDARD_GRAVITY, Podium
from rockjax._structures.impulses import LARGEST_ECCENTRICITY, impulse_eccentricity
from rockjax._structures.modes import repeat_scalar, split_row, with_fields
from rockjax._structures.restitution import CompatibleRestitution, GivenRestitution
from rockjax._unit_warnings import warn_about_units


def check_types(owner: str, podium, options, name: str = "podium") -> None:
    """Raise `ValueError` if the podium or the options have a wrong class, if their arrays do not have JAX's
    default floating-point type, or if `rtol` is too small for this type.

    - `owner`: name of the calling function, for messages
    - `podium`, `options`: a `Podium` and `Options`
    - `name`: name of the argument `podium` in messages
    """
    require_instance(owner, name, podium, Podium, "a rockjax.Podium")
    require_instance(owner, "options", options, Options, "rockjax.Options")
    for argument, value in ((name, podium), ("options", options)):
        check_dtype(owner, argument, value)
    check_precision(options)


def check_precision(options: Options) -> None:
    """Raise `ValueError` if `rtol` is too small for JAX's default floating-point type."""
    least, accepted = _least_tolerance(float_type())
    require("Options", "rtol", options.rtol, lambda v: v >= least, accepted)


@functools.cache
def _least_tolerance(dtype: np.dtype) -> tuple[float, str]:
    """Return the least `rtol` of a floating-point type, and the requirement as part of an error message."""
    least = 20 * float(np.finfo(dtype).eps)
    return least, f">= {least:.1e} in {dtype} (raise rtol, or enable float64 with jax_enable_x64)"


def check_single(owner: str, podium: Podium) -> None:
    """Raise `ValueError` for a batch of podiums. Arrays over modes, stories and columns are allowed."""
    if any(np.ndim(y) for y in jax.tree.leaves(podium.split_rows())):
        raise ValueError(
            f"{owner}: podium must have scalar parameters; call the function once for each podium"
        )


def as_start(owner: str, initial, podium: Podium) -> State:
    """Convert the initial state of the scenes to arrays.

    - `owner`: name of the calling function, for messages
    - `initial`: initial state
    - `podium`: structure of the scenes

    If the superstructure has an axis of modes, `u_t` and `u_t_dot` become tuples with one array for each
    mode. A scalar applies to all modes, as if all floors moved by this amount. Raises `ValueError` for a
    wrong class, and for a `u_t` or `u_t_dot` that is neither a scalar nor has one value for each mode.
    """
    require_instance(owner, "initial", initial, State, "a rockjax.State")
    top = podium.superstructure
    if initial is REST and REST.theta.dtype == float_type() and (top is None or not top.has_mode_axis):
        return initial  # unchanged, because a copy to the device would take most of the time of a small batch
    initial = jax.tree.map(functools.partial(as_float, label=f"{owner}: initial"), initial)
    if top is None or not top.has_mode_axis:
        return initial
    count = top.count
    rows = {name: split_row(repeat_scalar(getattr(initial, name), count)) for name in ("u_t", "u_t_dot")}
    for name, values in rows.items():
        if len(values) != count:
            raise ValueError(
                f"{owner}: initial.{name} must be one number or one for each of the {count} modes along its "
                f"last axis, got {len(values)}"
            )
    return with_fields(initial, rows)


def as_end(owner: str, t_end) -> Array | None:
    """Return the end of the scenes [s] as an array; None, the default end, stays None."""
    return None if t_end is None else as_float(t_end, f"{owner}: t_end")


def check_range(owner: str, podium: Podium, excitation: AbstractExcitation, t_end, options: Options) -> None:
    """Check the floating-point type of the excitation, the overturn ratio, and the end of the scenes.

    - `owner`: name of the calling function, for messages
    - `podium`, `excitation`, `options`: structure, ground motion and options of the scenes
    - `t_end`: end of the scenes [s], or None

    Raises `ValueError` in three cases: an array of the excitation does not have JAX's default floating-point
    type; `check_overturn_ratio` rejects the overturn ratio; or `t_end` is not finite, or not after the start
    of the excitation, in a batch of any of its excitations. Values that JAX traces are not checked.
    """
    check_dtype(owner, "excitation", excitation)
    check_overturn_ratio(owner, podium, options)
    if t_end is None:
        return
    start, end = concrete(excitation.support[0]), concrete(t_end)
    if start is None:
        return
    if end is not None:
        try:
            start, t_end = np.broadcast_arrays(start, end)
        except ValueError:
            return  # the caller reports shapes that do not broadcast
    which = "the excitation at" if start.size == 1 else "every excitation; the latest starts at"
    accepted = f"finite and after the start of {which} {start.max():.6g} s"
    require(owner, "t_end", t_end, lambda v: v > start, accepted)


def check_overturn_ratio(owner: str, podium: Podium, options: Options) -> None:
    """Raise `ValueError` if `overturn_ratio` exceeds π/(2α), or if the overturning margin is requested and a
    ratio above 1 exceeds θ_s/α, with the stability angle θ_s of the columns, (C7) of docs/equations.md. The
    message names `owner`."""
    alpha, ratio = concrete(podium.alpha), concrete(options.overturn_ratio)
    if alpha is not None and ratio is not None:
        limit = float(np.pi / 2 / alpha.max())
        require(owner, "options.overturn_ratio", ratio, lambda v: v <= limit, f"<= π/(2α) = {limit:.6g}")
    if "margin" in options.outputs and ratio is not None and np.any(ratio > 1):
        _check_margin(owner, podium, ratio)


def _check_margin(owner: str, podium: Podium, ratio: np.ndarray) -> None:
    """Raise `ValueError` if the overturn ratio exceeds θ_s/α. There is no margin then: a column beyond the
    stability angle θ_s may still return while the ground moves, so its outcome is open."""
    limit = concrete(podium.stability_angle / podium.alpha)
    if limit is not None:
        least = float(limit.min())
        accepted = (
            f"<= θ_s/α = {least:.6g} for the margin: beyond the stability angle a column may still return"
        )
        require(owner, "options.overturn_ratio", ratio, lambda v: v <= least, accepted)


IN_G = 0.05, 1.0  # amplitudes in this range [m/s²] lift almost no structure; they may be meant in g


def warn_of_amplitude_in_g(owner: str, podium: Podium, excitation: AbstractExcitation) -> None:
    """Warn if a pulse is too weak to lift the columns, but would lift them if its amplitude a_p were in g.

    Only amplitudes in the range `IN_G` with at most two significant digits are checked. Amplitudes with more
    digits were probably computed.
    """
    amplitude = concrete(excitation.a_p) if isinstance(excitation, AbstractPulse) else None
    if (
        amplitude is None
        or not IN_G[0] <= abs(amplitude) < IN_G[1]
        or float(f"{float(amplitude):.2g}") != float(amplitude)
    ):
        return
    uplift, g = concrete(podium.uplift_ground_acceleration), concrete(podium.g)
    if uplift is not None and g is not None and abs(amplitude) < uplift <= abs(amplitude) * g:
        warn_about_units(
            f"{owner}: a_p = {float(amplitude):g} m/s² is {abs(float(amplitude / g)):.3g} g, and the "
            f"columns lift at {float(uplift / g):.3g} g; was a_p meant in g? rockjax takes m/s²: "
            f"a_p = {float(amplitude):g} * {STANDARD_GRAVITY}",
            stacklevel=4,
        )


def warn_of_small_restitution(podium: Podium, stacklevel: int) -> None:
    """Warn of given restitution factors below that of rigid faces, (C13) of docs/equations.md.

    At an impact, the edges about which the columns rotated before would need tension: ξ_J > 1, (F13). Podiums
    with traced values are not checked.

    - `podium`: a structure, or a batch of structures
    - `stacklevel`: stack level as in `warnings.warn`, counted from this function
    """
    if not isinstance(podium.restitution, GivenRestitution) or array_module(podium) is not np:
        return
    mu = apparent_mass(podium.restrainers)
    given = podium.restitution.e, podium.alpha, *podium.mass_ratios, podium.lam, 0.0 if mu is None else mu
    values: list[Any] = list(np.broadcast_arrays(*map(np.asarray, given)))
    e, alpha, gamma, eta, lam, mu = values
    sin2 = np.sin(alpha) ** 2
    eccentricity = impulse_eccentricity(sin2, gamma, eta, lam, mu, e)
    is_small = eccentricity > LARGEST_ECCENTRICITY
    if not np.any(is_small):
        return
    worst = np.unravel_index(np.argmax(np.where(is_small, eccentricity, 0.0)), e.shape)
    where = f" in {int(is_small.sum())} of {e.size} structures; the worst" if e.size > 1 else ""
    least = np.asarray(CompatibleRestitution().factor(sin2, gamma, eta, lam, mu))[worst]
    warn_about_units(
        f"restitution factor too small for rigid faces{where}: e = {e[worst]:.4g} < {least:.4g}, so the old "
        f"edges would need tension at an impact (impact_eccentricity = {eccentricity[worst]:.3g} > 1); give "
        "restitution='compatible' or a larger factor, unless the faces deform",
        stacklevel,
    )
