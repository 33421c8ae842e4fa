"""The simplified methods for a podium and ground motions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import jax
import numpy as np

from rockjax._checks import as_strings, concrete, require_instance, require_number
from rockjax._excitations.ground import GroundMotion
from rockjax._motions.convert import AnyMotions, as_motions, single_motions
from rockjax._motions.record import Record
from rockjax._responses.arguments import check_single
from rockjax._structures import Podium

from .base import Case, MethodResult
from .block import Block
from .registry import METHODS

OWNER = "simplified_methods"


def simplified_methods(
    podium: Podium,
    motions: AnyMotions,
    *,
    friction: float | None = None,
    vertical: float | None = None,
    confidence_factor: float = 1.0,
    methods: Sequence[str] | None = None,
) -> tuple[MethodResult, ...]:
    """Apply simplified methods of practice to a podium and ground motions, outside jit.

    The methods are Eqs. (P1) to (P7) of docs/practice.md. They are for comparison with the exact answer
    ([`rockjax.peak_responses`][]) and do not replace it. Each result states how reliable its method is. Only
    (P2) includes vibrations of the superstructure; the other methods treat the superstructure as rigid. Only
    (P6) includes vertical motion, by the largest vertical acceleration A_v.

    - `podium`: a single podium, with any superstructure. No method computes anything for a podium with
      tendons, dampers or inerters
    - `motions`: n sampled motions: a [`rockjax.Motion`][], [`rockjax.Motions`][], records or a list of them
    - `friction`: coefficient of friction μ, ≥ 0 [–]. Without μ, (P6) computes nothing
    - `vertical`: largest vertical ground acceleration A_v, ≥ 0 [m/s²]. The default is the largest
      acceleration of the vertical components, if every motion has a sampled vertical component; otherwise A_v
      is unknown, and (P6) computes nothing
    - `confidence_factor`: confidence factor FC in (P7), ≥ 1 [–]
    - `methods`: names of methods, in the order of the results; by default all: `"static"` (P1),
      `"spectral_uplift"` (P2), `"priestley"` (P3), `"fema_356"` (P4), `"asce_43_05_rocking"` (P5),
      `"asce_43_05_sliding"` (P6), `"circolare_displacement"` and `"circolare_force"` (P7)

    Returns one [`rockjax.MethodResult`][] for each method. Its field `missing` states which parts are not
    computed, and why. Response spectra are exact for motions that are linear between samples.

    Raises `ValueError` for a podium with arrays of parameters or traced parameters, for motions without
    samples, for numbers out of range and for unknown methods.
    """
    require_instance(OWNER, "podium", podium, Podium, "a rockjax.Podium")
    _require_single(podium)
    if isinstance(motions, Iterable) and not isinstance(motions, Sequence):
        motions = list(motions)
    horizontal = tuple(as_motions(OWNER, motions, "motions"))
    if friction is not None:
        friction = require_number(OWNER, "friction", friction, lambda v: v >= 0, "None or finite and >= 0")
    if vertical is not None:
        vertical = require_number(
            OWNER, "vertical", vertical, lambda v: v >= 0, "None or finite and >= 0 m/s²"
        )
    factor = require_number(
        OWNER, "confidence_factor", confidence_factor, lambda v: v >= 1, "finite and >= 1"
    )
    names = tuple(METHODS) if methods is None else as_strings(OWNER, "methods", methods)
    for name in names:
        if name not in METHODS:
            raise ValueError(f"{OWNER}: methods must be among {', '.join(METHODS)}, got {name!r}")
    if vertical is None:
        vertical = _vertical_peak(motions)
    case = Case(podium, Block.from_podium(podium), horizontal, friction, vertical, factor)
    return tuple(METHODS[name].evaluate(case) for name in names)


def _require_single(podium: Podium) -> None:
    """Raise `ValueError` for a batch of podiums, and for traced parameters."""
    if any(concrete(leaf) is None for leaf in jax.tree.leaves(podium)):
        raise ValueError(f"{OWNER}: podium must have concrete numbers; call {OWNER} outside jit and grad")
    check_single(OWNER, podium)


def _vertical_peak(motions: AnyMotions) -> float | None:
    """Return the largest vertical acceleration of all motions [m/s²]; None if the vertical component of a
    motion is missing or has no samples."""
    peaks = []
    for member in single_motions(OWNER, motions, "motions").members:
        component = member.vertical if isinstance(member, GroundMotion) else None
        if not isinstance(component, Record):
            return None
        peaks.append(abs(float(component.scale)) * float(np.abs(np.asarray(component.acceleration)).max()))
    return max(peaks)
