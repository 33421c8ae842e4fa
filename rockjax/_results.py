"""Results, states and statistics of scenes."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from rockjax._tree import Module

from ._checks import as_number


class RESULTS(eqx.Enumeration):
    """Named results of a scene."""

    settled = "No requested output can change any more."
    end_of_time = "The scene reached t_end."
    overturned = "|θ| reached overturn_ratio·α."
    out_of_steps = (
        "The scene did not finish within max_steps steps; raise max_steps or loosen the tolerances."
    )
    not_finite = (
        "A state or a parameter is not finite; check podium, excitation and initial state for NaN, "
        "infinities "
        "and extreme values."
    )
    history_full = "The history is longer than Options.history; raise it (outside jit it grows by itself)."
    interrupted = "The computation was stopped before this scene had ended; resume it."
    chattering = (
        "The columns bounced until max_steps, on ever shorter hops, because impacts take almost no energy; "
        "use a restitution further below 1, a larger rest_velocity or an earlier t_end."
    )
    too_stiff = (
        "The superstructure vibrates too fast for max_steps steps to reach the end of the scene; "
        "make it Rigid, end the scene earlier, or raise max_steps."
    )
    weightless = (
        "g + v̈_g is not positive at all times: joints could open vertically, which the model excludes; "
        "scale the vertical motion down."
    )


# Codes inside the loop; a scene that continues has none of the results.
RUNNING = -1
(
    SETTLED,
    END_OF_TIME,
    OVERTURNED,
    OUT_OF_STEPS,
    NOT_FINITE,
    HISTORY_FULL,
    INTERRUPTED,
    CHATTERING,
    TOO_STIFF,
    WEIGHTLESS,
) = range(10)
NAMES = (
    *("settled", "end_of_time", "overturned", "out_of_steps", "not_finite", "history_full", "interrupted"),
    *("chattering", "too_stiff", "weightless"),
)


def named(code: Int[Array | np.ndarray, "*batch"]) -> RESULTS:
    """Return the results of codes from the loop, the index of each member in its definition."""
    return jax.tree.unflatten(_RESULT, [code])


_RESULT = jax.tree.structure(RESULTS.settled)


def code_of(result: RESULTS) -> Int[Array | np.ndarray, "*batch"]:
    """Return the codes of one result or of a batch of them."""
    return result._value


def explain(code: int) -> str:
    """Return the name of a result, and its message with the cure."""
    return f"{NAMES[code]}: {RESULTS[getattr(RESULTS, NAMES[code])]}"


def explain_failures(codes) -> str:
    """Return how many scenes did not finish, and the cause and cure of each kind; empty if all finished.

    - `codes`: codes of results, of any shape
    """
    kinds, counts = np.unique(np.asarray(codes)[np.asarray(codes) > OVERTURNED], return_counts=True)
    if not kinds.size:
        return ""
    causes = [f"{count} {explain(int(kind))}" for kind, count in zip(kinds, counts, strict=True)]
    return f"{counts.sum()} of {np.size(codes)} scenes did not finish. {' '.join(causes)}"


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a computation.

    - `partial`: the answer so far, None if there is none. It has the form of the complete answer; unsolved
      scenes have the result `interrupted` and NaN for numbers.
    """

    def __init__(self, message: str, partial: Any):
        super().__init__(message)
        self.partial = partial


class State(Module):
    """State of the structure: rotation, its rate, displacement of the top mass relative to the ground, its
    rate.

    `theta` [rad], `theta_dot` [rad/s], `u_t` [m], `u_t_dot` [m/s]; the last two are unused (0) without an
    elastic superstructure. With several modes they are u_i and u̇_i along the last axis; a single number
    applies to all modes, as if all floors moved by it.
    """

    theta: Float[Array, "*times"] = eqx.field(converter=as_number("State: theta"), default=0.0)
    theta_dot: Float[Array, "*times"] = eqx.field(converter=as_number("State: theta_dot"), default=0.0)
    u_t: Float[Array, "*times"] = eqx.field(converter=as_number("State: u_t"), default=0.0)
    u_t_dot: Float[Array, "*times"] = eqx.field(converter=as_number("State: u_t_dot"), default=0.0)


# NumPy arrays: a JAX array would start the backend on import.
REST = jax.tree.map(lambda y: np.zeros(y.shape, y.dtype), jax.eval_shape(State))


class Stats(Module):
    """Cost of a scene: accepted `steps`, `rejected` trials (for accuracy, or to land on an event),
    `end_time` [s]."""

    steps: Int[Array, "*batch"]
    rejected: Int[Array, "*batch"]
    end_time: Float[Array, "*batch"]
