"""What all measurements share: the shortest of several runs, errors against a reference, tables that are
kept."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import rockjax as rj

from .families import Family

RESULTS = Path(__file__).parent / "results"
IMAGES = Path(__file__).parent.parent / "docs" / "images"
ROTATION = ("peak_rotation",)


def shortest(function: Callable[[], Any], runs: int = 5) -> float:
    """Wall time of the shortest of several runs [s], after one that compiles."""
    function()
    times = []
    for _ in range(runs):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return min(times)


def podium(family: Family) -> rj.Podium:
    top = rj.Rigid(family.eta) if family.T_s == 0 else rj.Elastic(family.eta, family.T_s, family.zeta)
    return rj.Podium(family.alpha, family.R, family.gamma, top, family.lam)


def options(rtol: float, method: str = "dopri8", **more) -> rj.Options:
    return rj.Options(**({"rtol": rtol, "atol": 0.01 * rtol, "method": method, "outputs": ROTATION} | more))


def rockjax_peaks(
    family: Family, rtol: float, method: str = "dopri8", **more
) -> tuple[np.ndarray, np.ndarray]:
    peaks = rj.peak_responses(
        podium(family), rj.Ricker(family.a_p, family.T_p), options=options(rtol, method, **more)
    )
    return np.asarray(peaks.peak_rotation), np.asarray(peaks.overturned)


_known: dict[tuple, tuple[np.ndarray, np.ndarray]] = {}


def reference(family: Family) -> tuple[np.ndarray, np.ndarray]:
    """(peaks, overturned) by an implementation that shares nothing with this project, at rtol 1e-13."""
    from .peers import numba_loop

    key = (family.T_s, family.eta, family.a_p.tobytes(), family.T_p.tobytes())
    if key not in _known:
        _known[key] = numba_loop.solve(family, 1e-13)
    return _known[key]


def errors(found: tuple[np.ndarray, np.ndarray], family: Family) -> dict[str, float]:
    """Quantiles of |error of max|θ|/α| over the scenes, and how many changed between standing and
    overturned."""
    return apart(found, reference(family))


def apart(found: tuple[np.ndarray, np.ndarray], truth: tuple[np.ndarray, np.ndarray]) -> dict[str, float]:
    """The same of (peaks, overturned) against others."""
    same = found[1] == truth[1]
    error = np.abs(found[0] - truth[0])[same]
    return {
        "median": float(np.median(error)),
        "p99": float(np.quantile(error, 0.99)),
        "max": float(error.max()),
        "flips": int((~same).sum()),
    }


def keep(name: str, rows: list[dict]) -> None:
    """Store a table beside the versions it was measured with."""
    import jax

    RESULTS.mkdir(exist_ok=True)
    machine = {"python": platform.python_version(), "jax": jax.__version__, "rockjax": rj.__version__}
    text = json.dumps({"machine": machine | {"cores": _cores()}, "rows": rows}, indent=1)
    (RESULTS / f"{name}.json").write_text(text + "\n")


def kept(name: str) -> list[dict]:
    """The rows of a table that was stored before."""
    return json.loads((RESULTS / f"{name}.json").read_text())["rows"]


def kept_so_far(name: str) -> list[dict]:
    """The same, none where there is no such table yet."""
    return kept(name) if (RESULTS / f"{name}.json").exists() else []


def _cores() -> int:
    from rockjax._batch.executors import workers

    return workers()


def show(rows: list[dict], columns: dict[str, str]) -> None:
    """Print rows as a Markdown table; `columns` maps keys to formats."""
    print("| " + " | ".join(columns) + " |")
    print("|" + "---|" * len(columns))
    for row in rows:
        print(
            "| "
            + " | ".join(
                format(row[key], form) if row.get(key) is not None else "" for key, form in columns.items()
            )
            + " |"
        )
