"""The certificate: a proof, from the energy, that no requested output of a scene (one podium under one
excitation) can change any more, so that the scene may end early."""

from __future__ import annotations

from rockjax._excitations.base import Shaking
from rockjax._types import Flag, Index, Value

from .bounds import Bounds
from .state import LoopState, Plan, Scene


def certificate(scene: Scene, plan: Plan, state: LoopState, piece: Index, ground: Value | Shaking) -> Flag:
    """Return whether no requested output can change during the rest of the excitation and after it.

    This is the case if the columns stay inside the potential well (see `bounds.py`) or never lift again, and
    every output confirms that its accumulator (its value up to the present time) can no longer change.
    Columns that never lifted must rest for good, because every scene also answers whether and when they lift.

    - `scene`: the prepared scene; `plan`: settings that are fixed at compilation, such as the outputs
    - `state`: state after a step
    - `piece`: piece of the excitation after the step
    - `ground`: ground acceleration at the end of the step on that piece [m/s²], ü_g or, with vertical motion,
      a `Shaking` with ü_g and v̈_g
    """
    bounds = Bounds.after_step(scene, state, piece, ground, plan.follows_contact)
    final = bounds.stays_inside | bounds.rests
    if plan.follows_contact:
        final &= state.uplifted | bounds.rests
    for output, accumulator in zip(plan.outputs, state.accumulators, strict=True):
        final &= output.is_final(bounds, accumulator)
    return final
