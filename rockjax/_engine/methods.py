"""Names of integration methods, and the Diffrax solvers that they stand for."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import diffrax

# Names of methods, and of their Diffrax classes. Importing Diffrax is slow, so the flat engine reads stored
# tableaus instead, and `solver_of` imports Diffrax only when called.
METHODS = {"tsit5": "Tsit5", "dopri8": "Dopri8", "dopri5": "Dopri5", "bosh3": "Bosh3", "kvaerno5": "Kvaerno5"}
EXPLICIT = ("tsit5", "dopri8", "dopri5", "bosh3")


def solver_of(method: str | diffrax.AbstractSolver) -> diffrax.AbstractSolver:
    """Return the Diffrax solver with the given method name. A Diffrax solver is returned as it is. Raises
    `ValueError` for unknown names."""
    import diffrax

    if isinstance(method, diffrax.AbstractSolver):
        return method
    if method not in METHODS:
        raise ValueError(
            f"Options: method must be one of {sorted(METHODS)} or a Diffrax solver, got {method!r}"
        )
    return getattr(diffrax, METHODS[method])()
