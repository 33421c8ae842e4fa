"""Results of scenes (how a scene ended) with their codes, the state of a structure, and statistics of
scenes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from rockjax._tree import Module

from ._checks import as_number

if TYPE_CHECKING:
    import xarray


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
        "infinities and extreme values."
    )
    history_full = (
        "The history needs more steps than Options.history; raise this option (outside jit it grows "
        "automatically)."
    )
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


# Codes of the results inside the integration loop. A scene without a result has the code RUNNING. Scenes with
# a code above OVERTURNED did not finish.
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
# Attributes of the dataset variables that contain result codes, as the CF conventions prescribe for flags.
FLAGS = {"flag_values": np.arange(len(NAMES), dtype=np.int8), "flag_meanings": " ".join(NAMES)}


def result_of(code: Int[Array | np.ndarray, "*batch"]) -> RESULTS:
    """Return the result with a code, or the results of an array of codes."""
    return jax.tree.unflatten(_RESULT, [code])


_RESULT = jax.tree.structure(RESULTS.settled)


def code_of(result: RESULTS) -> Int[Array | np.ndarray, "*batch"]:
    """Return the code of a result, or the codes of a batch."""
    return result._value


def did_not_finish(code: Any) -> Any:
    """Return whether a scene with this code did not finish; elementwise for arrays of codes."""
    return code > OVERTURNED


def outcomes(data: xarray.Dataset) -> xarray.DataArray:
    """Return the outcomes of the scenes of a dataset: 1 if the podium overturns, 0 if it does not, and NaN
    (unknown) if the scene did not finish."""
    overturned = data["overturned"].astype(float)
    return overturned.where(~did_not_finish(data["result"])) if "result" in data else overturned


def explain(code: int) -> str:
    """Return the name and the message of the result with a code. For a scene that did not finish, the message
    names the cure."""
    return f"{NAMES[code]}: {RESULTS[getattr(RESULTS, NAMES[code])]}"


def explain_failures(codes) -> str:
    """Return a message about the scenes that did not finish: their number, and the cause and the cure for
    each of their results. The message is empty if all scenes finished.

    - `codes`: codes of results, of any shape
    """
    codes = np.asarray(codes)
    failures, counts = np.unique(codes[did_not_finish(codes)], return_counts=True)
    if not failures.size:
        return ""
    causes = [f"{count} {explain(int(code))}" for code, count in zip(failures, counts, strict=True)]
    return f"{counts.sum()} of {codes.size} scenes did not finish. {' '.join(causes)}"


class Interrupted(KeyboardInterrupt):
    """Raised if Ctrl-C stops a computation.

    - `partial`: the incomplete answer, of the same type as the complete answer, or None if there is no answer
      yet. Unsolved scenes have the result `interrupted`, and NaN in place of numbers
    """

    def __init__(self, message: str, partial: Any):
        super().__init__(message)
        self.partial = partial


class State(Module):
    """State of the structure.

    - `theta`, `theta_dot`: rotation [rad] and its rate [rad/s]
    - `u_t`, `u_t_dot`: displacement of the top mass relative to the ground [m] and its rate [m/s].
      Without an elastic superstructure, `u_t` and `u_t_dot` have no effect. For a superstructure with several
      modes, the last axis has the displacement or rate of each mode; a scalar means that all floors have this
      displacement or rate
    """

    theta: Float[Array, "*times"] = eqx.field(converter=as_number("State: theta"), default=0.0)
    theta_dot: Float[Array, "*times"] = eqx.field(converter=as_number("State: theta_dot"), default=0.0)
    u_t: Float[Array, "*times"] = eqx.field(converter=as_number("State: u_t"), default=0.0)
    u_t_dot: Float[Array, "*times"] = eqx.field(converter=as_number("State: u_t_dot"), default=0.0)


# The state at rest. Its arrays are NumPy arrays, because a JAX array would start JAX's backend on import.
REST = jax.tree.map(lambda y: np.zeros(y.shape, y.dtype), jax.eval_shape(State))


class Stats(Module):
    """Statistics of a scene.

    - `steps`: number of accepted steps
    - `rejected`: number of trial steps that were rejected for accuracy or to land on an event
    - `end_time`: time at which the scene ended [s]
    """

    steps: Int[Array, "*batch"]
    rejected: Int[Array, "*batch"]
    end_time: Float[Array, "*batch"]
