"""Functions that all benchmarks share: scenes, timing, errors relative to a reference, and tables.

The measured scenes are the grid of Fig. 6 at η/γ = 10, one family per superstructure.
"""

from __future__ import annotations

import dataclasses
import json
import math
import platform
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

import rockjax as rj
from rockjax._results import code_of, did_not_finish

RESULTS = Path(__file__).parent / "results"
IMAGES = Path(__file__).parent.parent / "docs" / "images"
ROTATION = ("peak_rotation",)
G = 9.80665
PERIODS = {"rigid": 0.0, "T_s = 0.1 s": 0.1, "T_s = 0.5 s": 0.5, "T_s = 1 s": 1.0}


@dataclasses.dataclass(frozen=True)
class Family:
    """One podium under symmetric Ricker pulses with a_p [m/s²] and T_p [s], shape (scenes,)."""

    T_s: float  # 0 for a rigid superstructure
    a_p: np.ndarray
    T_p: np.ndarray
    alpha: float = math.atan(0.15)
    R: float = 1.5
    gamma: float = 10.0
    eta: float = 100.0
    zeta: float = 0.05
    lam: float = 1 / 3

    def __len__(self) -> int:
        return len(self.a_p)

    def thinned(self, count: int) -> Family:
        """Return `count` evenly spaced scenes of the family, for slow solvers."""
        indices = np.linspace(0, len(self) - 1, count).round().astype(int)
        return dataclasses.replace(self, a_p=self.a_p[indices], T_p=self.T_p[indices])


def family(name: str, points: int) -> Family:
    """Return the family on points × points pulses: 1 ≤ ω_p/p ≤ 8, 1 ≤ a_p/(g tan α) ≤ 12."""
    p = math.sqrt(0.75 * G / Family.R)
    frequency, acceleration = np.meshgrid(np.linspace(1, 8, points), np.linspace(1, 12, points))
    return Family(
        PERIODS[name],
        a_p=(acceleration * G * math.tan(Family.alpha)).ravel(),
        T_p=(2 * math.pi / (frequency * p)).ravel(),
    )


def log_uniform(rng: np.random.Generator, low: float, high: float, n: int) -> np.ndarray:
    return np.exp(rng.uniform(math.log(low), math.log(high), n))


def mix_in(
    rng: np.random.Generator, values: np.ndarray, special: tuple[float, ...], share: float = 0.15
) -> np.ndarray:
    """Return the values; special values replace a random fraction `share` of them."""
    replacements = rng.choice(special, len(values))
    return np.where(rng.random(len(values)) < share, replacements, values)


def shortest_time(function: Callable[[], Any], runs: int = 5) -> float:
    """Return the shortest wall time of several runs [s], after one run that compiles."""
    function()
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
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
    return rotations_and_outcomes(peaks)


def rotations_and_outcomes(peaks: rj.Peak) -> tuple[np.ndarray, np.ndarray]:
    """Return max|θ|/α and whether the columns overturn. The rotation of a scene that did not finish is NaN,
    because its peak is incomplete."""
    return np.where(did_not_finish(code_of(peaks.result)), np.nan, peaks.peak_rotation), np.asarray(
        peaks.overturned
    )


_references: dict[tuple, tuple[np.ndarray, np.ndarray]] = {}


def reference(family: Family) -> tuple[np.ndarray, np.ndarray]:
    """Return (peaks, overturned) from an implementation that shares no code with rockjax, at rtol = 1e-13."""
    from .peers import numba_loop

    key = (family.T_s, family.eta, family.a_p.tobytes(), family.T_p.tobytes())
    if key not in _references:
        _references[key] = numba_loop.solve(family, 1e-13)
    return _references[key]


def errors(results: tuple[np.ndarray, np.ndarray], family: Family) -> dict[str, float]:
    """Return the median, 99th percentile and maximum of the error of max|θ|/α, and the number of scenes whose
    outcome differs from the reference (`flips`)."""
    return difference_quantiles(results, reference(family))


def difference_quantiles(
    results: tuple[np.ndarray, np.ndarray], expected: tuple[np.ndarray, np.ndarray]
) -> dict[str, float]:
    """Compare two pairs (peaks, overturned); return a dictionary like `errors`. If a peak is NaN, so are the
    errors."""
    same = results[1] == expected[1]
    error = np.abs(results[0] - expected[0])[same]
    return {
        "median": float(np.median(error)),
        "p99": float(np.quantile(error, 0.99)),
        "max": float(error.max()),
        "flips": int((~same).sum()),
    }


def store_rows(name: str, rows: list[dict]) -> None:
    """Store a table together with the versions of Python, JAX and rockjax."""
    import jax

    RESULTS.mkdir(exist_ok=True)
    machine = {"python": platform.python_version(), "jax": jax.__version__, "rockjax": rj.__version__}
    text = json.dumps({"machine": machine | {"cores": _cores()}, "rows": rows}, indent=1)
    (RESULTS / f"{name}.json").write_text(text + "\n")


def stored_rows(name: str) -> list[dict]:
    """Return the rows of a stored table."""
    return json.loads((RESULTS / f"{name}.json").read_text())["rows"]


def stored_rows_if_any(name: str) -> list[dict]:
    """Return the rows of a stored table, or an empty list if there is none."""
    return stored_rows(name) if (RESULTS / f"{name}.json").exists() else []


def _cores() -> int:
    from rockjax._batch.executors import workers

    return workers()


def show(rows: list[dict], columns: Iterable[str] = ()) -> None:
    """Print rows as a Markdown table, with `columns` or, by default, all columns of the first row."""
    columns = list(columns or rows[0])
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    for row in rows:
        print("| " + " | ".join(_text(row.get(key)) for key in columns) + " |")


def _text(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def report(name: str, rows: list[dict], columns: Iterable[str] = ()) -> None:
    """Store a table and print it."""
    store_rows(name, rows)
    show(rows, columns)
