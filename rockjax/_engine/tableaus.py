"""Butcher tableaus (coefficients) of explicit Runge–Kutta methods.

The tableaus of the explicit methods in `methods.py` are stored in `tableaus.json`, because importing Diffrax
is slow. The stored tableaus are copies of Diffrax's, as a test verifies; `write` writes the file again. Any
other explicit Diffrax solver provides its own tableau.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .methods import EXPLICIT, solver_of

if TYPE_CHECKING:
    import diffrax

STORED = Path(__file__).with_suffix(".json")
ORDER_8 = "dopri8"  # name of the method of order 8


@dataclasses.dataclass(frozen=True, eq=False)
class Tableau:
    """A Butcher tableau for second-order systems, as NumPy constants of the compiled step.

    Instances are compared by identity; each method has one instance.
    """

    order: int  # order of the method
    estimate: int  # order of the error estimate
    c: np.ndarray  # times of the stages since the start of the step, divided by the length of the step
    A: np.ndarray  # weights of the accelerations in the stage velocities
    AA: np.ndarray  # weights of the accelerations in the stage positions
    b: np.ndarray  # weights of the accelerations in the final velocities
    bA: np.ndarray  # weights of the accelerations in the final positions
    error: np.ndarray  # weights of the accelerations in the error estimate of velocities
    errorA: np.ndarray  # weights of the accelerations in the error estimate of positions
    fsal: bool  # True if the last stage is the acceleration at the end of the step


@functools.cache
def tableau(method: str | diffrax.AbstractERK) -> Tableau:
    """Return the tableau of an explicit method. `method` is a name or a Diffrax solver, as in
    [`rockjax.Options`][]."""
    stored = _stored().get(method) if isinstance(method, str) else None
    entries = coefficients_of(solver_of(method)) if stored is None else stored
    stages = len(entries["a"]) + 1
    A = np.zeros((stages, stages))
    for i, row in enumerate(entries["a"], start=1):
        A[i, :i] = row
    b, error, c = (np.array(entries[name]) for name in ("b", "error", "c"))
    order = entries["order"]
    return Tableau(order, order - 1, c, A, A @ A, b, b @ A, error, error @ A, entries["fsal"])


def tableau_for(method: str | diffrax.AbstractERK, depends_on_velocities: bool) -> Tableau:
    """Return the tableau with which to integrate.

    - `method`: name of an explicit method, or an explicit Diffrax solver
    - `depends_on_velocities`: whether accelerations depend on velocities. If they do not, a Nyström method of
      the same order with fewer stages replaces `"dopri8"`
    """
    return nystrom() if method == ORDER_8 and not depends_on_velocities else tableau(method)


@functools.cache
def nystrom() -> Tableau:
    """Return RKN8(6)9FM of Dormand, El-Mikkawy and Prince (IMA J. Numer. Anal. 7, 1987, 423–430).

    The method has order 8 and computes eight accelerations in each step. It is valid only if accelerations do
    not depend on velocities. Unlike in a Runge–Kutta method, `AA` is not the square of `A`; `A` is zero.
    """
    rows = [
        (1 / 800,),
        (1 / 600, 1 / 300),
        (9 / 200, -9 / 100, 9 / 100),
        (-66701 / 197352, 28325 / 32892, -2665 / 5482, 2170 / 24669),
        (227015747 / 304251000, -54897451 / 30425100, 12942349 / 10141700, -9499 / 304251, 539 / 9250),
        (
            *(-1131891597 / 901789000, 41964921 / 12882700, -6663147 / 3220675),
            *(270954 / 644135, -108 / 5875, 114 / 1645),
        ),
        (
            *(13836959 / 3667458, -17731450 / 1833729, 1063919505 / 156478208),
            *(-33213845 / 39119552, 13335 / 28544, -705 / 14272, 1645 / 57088),
        ),
        (223 / 7938, 0, 1175 / 8064, 925 / 6048, 41 / 448, 925 / 14112, 1175 / 72576),
    ]
    c = np.array([0, 1 / 20, 1 / 10, 3 / 10, 1 / 2, 7 / 10, 9 / 10, 1, 1])
    stages = np.zeros((9, 9))
    for k, row in enumerate(rows, start=1):
        stages[k, : len(row)] = row
    positions = stages[-1]
    middle = 5875 / 36288, 4625 / 21168, 41 / 224, 4625 / 21168, 5875 / 36288
    velocities = np.array([223 / 7938, 0, *middle, 223 / 7938, 0])
    # Weights of an embedded method of order 6, for the error estimate.
    middle = 1610737 / 44674560, 10023263 / 33505920, -497221 / 12409600, 10023263 / 78180480
    positions_sixth = np.array([7987313 / 109941300, 0, *middle, 1610737 / 402071040, 0, 0])
    middle = 1610737 / 40207104, 10023263 / 23454144, -497221 / 6204800, 10023263 / 23454144
    last = 1610737 / 40207104, -4251941 / 54970650, 3 / 20
    velocities_sixth = np.array([7987313 / 109941300, 0, *middle, *last])
    errors = velocities - velocities_sixth, positions - positions_sixth
    return Tableau(8, 6, c, np.zeros((9, 9)), stages, velocities, positions, *errors, fsal=True)


def coefficients_of(solver: diffrax.AbstractSolver) -> dict[str, Any]:
    """Return the tableau of an explicit Diffrax solver as a dict that JSON can store."""
    import diffrax

    source, order = getattr(solver, "tableau", None), solver.order(None)  # pyright: ignore[reportArgumentType]
    assert isinstance(source, diffrax.ButcherTableau)
    assert order is not None
    return {
        "order": int(order),
        "c": [0.0, *np.asarray(source.c, float).tolist()],
        "a": [np.asarray(row, float).tolist() for row in source.a_lower],
        "b": np.asarray(source.b_sol, float).tolist(),
        "error": np.asarray(source.b_error, float).tolist(),
        "fsal": bool(source.fsal),
    }


@functools.cache
def _stored() -> dict[str, dict[str, Any]]:
    return json.loads(STORED.read_text(encoding="utf-8"))


def write() -> None:
    """Write the tableaus of the installed Diffrax to `tableaus.json`."""
    from rockjax._files import write_atomically

    tables = {name: coefficients_of(solver_of(name)) for name in EXPLICIT}
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(entries)}" for name, entries in tables.items())
    write_atomically(STORED, lambda name: Path(name).write_text(f"{{\n{lines}\n}}\n", encoding="utf-8"))
