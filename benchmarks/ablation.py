"""Ablation of optimisations: `python -m benchmarks.ablation [piece …]`.

The benchmark switches off one optimisation ("piece") at a time in a separate process. It alternates timings
between this process and a process with all pieces. It reports the shortest time without the piece divided by
the shortest time with it, and the same ratio of the CPU times of first calls, which compile. Run nothing else
on the machine meanwhile.

Writes `benchmarks/results/ablation.json`.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import importlib
import json
import math
import os
import pkgutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import rockjax as rj
from rockjax import _sincos
from rockjax._batch import lanes, scenes
from rockjax._engine import certificate, scene, tableaus
from rockjax._engine.step import trial
from rockjax._programs.barrier import barrier
from rockjax._results import REST

from .measure import Family, family, options, podium, show, store_rows, stored_rows_if_any
from .records import Suite

RUNS = 7
LANES = 64


# ----------------------------------------------------------------------------------------------------- pieces
class Piece(NamedTuple):
    """One optimisation."""

    switch_off: Callable[[], None]  # switches the piece off in this process, before anything is traced
    modules: tuple[str, ...]  # modules that implement the piece
    rows: tuple[str, ...] = ()  # only rows with one of these words are timed; empty for all rows


def _replace(original: Any, replacement: Any) -> None:
    """Replace a function of rockjax in every module that imports it."""
    count = 0
    for module in pkgutil.walk_packages(rj.__path__, "rockjax."):
        if module.name == "rockjax.__main__":
            continue
        holder = importlib.import_module(module.name)
        for name in [name for name, value in vars(holder).items() if value is original]:
            setattr(holder, name, replacement)
            count += 1
    assert count, original


def _no_fast_forward(name: str) -> None:
    """Remove a fast-forward from every plan."""
    plan_for = scene.plan_for

    def without(*arguments: Any, **options: Any) -> Any:
        plan = plan_for(*arguments, **options)
        return dataclasses.replace(plan, fast_forwards=tuple(y for y in plan.fast_forwards if y != name))

    _replace(plan_for, without)


def _no_certificate() -> None:
    _replace(certificate.certificate, lambda *_, **__: jnp.zeros((), bool))


def _no_refill() -> None:
    """Refill lanes only when all of them have ended."""
    lanes.WAITING_SHARE = 1.0


def _no_nystrom() -> None:
    _replace(tableaus.tableau_for, lambda method, velocities: tableaus.tableau(method))


def _no_polynomial_sines() -> None:
    _replace(_sincos.sincos, lambda psi: (jnp.sin(psi), jnp.cos(psi)))
    _replace(_sincos.sin, jnp.sin)
    _replace(_sincos.cos, jnp.cos)


PIECES = {
    "sample passing": Piece(
        lambda: _no_fast_forward("samples"), ("_engine/fast_forward/samples.py",), ("records",)
    ),
    "bounce skipping": Piece(lambda: _no_fast_forward("bounces"), ("_engine/fast_forward/bounces.py",)),
    "certificate": Piece(_no_certificate, ("_engine/bounds.py", "_engine/certificate.py")),
    "lane refill": Piece(_no_refill, ("_batch/exchange.py",)),
    "lane sorting": Piece(lambda: _replace(scenes._order, lambda *_: None), ("_batch/scenes.py",)),
    "barriers": Piece(lambda: _replace(barrier, lambda values: values), ("_programs/barrier.py",)),
    "Nyström method": Piece(_no_nystrom, ("_engine/tableaus.py",)),
    "own sine and cosine": Piece(_no_polynomial_sines, ("_sincos.py",)),
}


# ------------------------------------------------------------------------------------------------------- rows
@functools.cache
def _suite() -> Suite:
    return Suite()


def _panel(period: float, outputs: tuple[str, ...] | None, points: int = 100) -> Callable[[], Any]:
    pulses = family("rigid" if period == 0 else f"T_s = {period:g} s", points)
    settings = options(1e-8) if outputs else rj.Options()
    motions = rj.Ricker(pulses.a_p, pulses.T_p)
    return lambda: rj.peak_responses(podium(pulses), motions, options=settings)


def _records(period: float) -> Callable[[], Any]:
    structure = podium(Family(period, np.zeros(0), np.zeros(0)))
    return lambda: _suite().solve(structure, options(1e-8))


def _analysis() -> Callable[[], Any]:
    structure = podium(Family(0.5, np.zeros(0), np.zeros(0)))
    return lambda: rj.incremental_dynamic_analysis(structure, _suite().records, _suite().intensity)


def _boundary() -> Callable[[], Any]:
    structure = podium(Family(0.5, np.zeros(0), np.zeros(0)))
    record = rj.Record(_suite().samples[0], 0.01)
    return lambda: float(rj.overturning_scale(structure, record))


def _peak(differentiate: bool) -> Callable[[], Any]:
    structure = podium(Family(0.5, np.zeros(0), np.zeros(0)))
    peak = lambda alpha: rj.peak_response(structure.replace(alpha=alpha), rj.Ricker(2.0, 1.0)).peak_rotation
    function = jax.value_and_grad(peak) if differentiate else peak
    return lambda: jax.block_until_ready(function(0.15))


ROWS: dict[str, Callable[[], Callable[[], Any]]] = {
    "Fig. 6 rigid, rotation": lambda: _panel(0.0, ("peak_rotation",)),
    "Fig. 6 elastic, rotation": lambda: _panel(0.5, ("peak_rotation",)),
    "Fig. 6 rigid, default outputs": lambda: _panel(0.0, None),
    "Fig. 6 elastic, default outputs": lambda: _panel(0.5, None),
    "100 rigid pulses": lambda: _panel(0.0, ("peak_rotation",), 10),
    "484 rigid pulses": lambda: _panel(0.0, ("peak_rotation",), 22),
    "records 20 × 50 rigid": lambda: _records(0.0),
    "records 20 × 50 elastic": lambda: _records(0.5),
    "IDA of 20 records": _analysis,
    "boundary on a record": _boundary,
    "peak": lambda: _peak(False),
    "gradient": lambda: _peak(True),
}


# ---------------------------------------------------------------------------------------------------- workers
def operations() -> dict[str, int]:
    """Return the number of arithmetic operations per scene and trial step in the compiled program."""
    counts = {}
    for name, period in (("rigid", 0.0), ("elastic", 0.5)):
        structure = podium(Family(period, np.zeros(0), np.zeros(0)))
        motion, settings = rj.Record(np.sin(np.arange(100)), 0.02), rj.Options()
        structure = structure.split_rows()
        plan = scene.plan_for(structure, settings, history=False)
        start = functools.partial(scene.prepare, structure, motion, REST, None, settings, plan)
        prepared, state = jax.jit(start)()
        lanes_state = jax.tree.map(lambda y: jnp.broadcast_to(y, (LANES, *jnp.shape(y))), state)
        step = lambda lane, prepared=prepared, plan=plan: trial(prepared, plan, lane)[0]
        program = jax.jit(jax.vmap(step)).lower(lanes_state).compile()
        cost: Any = program.cost_analysis()
        counts[f"operations, {name}"] = round(cost["flops"] / LANES)
    return counts


def work(piece: str) -> None:
    """Read names of rows from the standard input. Print the wall time [s], and at first also the CPU time."""
    if piece:
        PIECES[piece].switch_off()
    prepared_rows: dict[str, Callable[[], Any]] = {}
    for line in sys.stdin:
        name = line.strip()
        if name == "operations":
            print(json.dumps(operations()), flush=True)
            continue
        first = None
        if name not in prepared_rows:
            prepared_rows[name] = ROWS[name]()
            start = time.process_time()
            prepared_rows[name]()
            first = time.process_time() - start
        start = time.perf_counter()
        prepared_rows[name]()
        print(json.dumps([time.perf_counter() - start, first]), flush=True)


class Worker:
    """A process in which one optimisation is switched off, or none for the name ""."""

    def __init__(self, piece: str):
        self.folder = tempfile.TemporaryDirectory()
        environment = os.environ | {"ROCKJAX_CACHE_DIR": self.folder.name, "MPLBACKEND": "Agg"}
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.ablation", "--worker", piece],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment,
        )  # fmt: skip

    def __call__(self, row: str) -> Any:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(row, file=self.process.stdin, flush=True)
        return json.loads(self.process.stdout.readline())

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()
        self.folder.cleanup()


def lines_of(piece: Piece) -> int:
    root = Path(rj.__path__[0])
    return sum(len((root / name).read_text().splitlines()) for name in piece.modules)


def ratios(name: str, piece: Piece, complete: Worker) -> dict[str, Any]:
    """Return ratios without/with the piece: times, CPU seconds of first calls, operations of a trial step."""
    row: dict[str, Any] = {"piece": name, "lines": lines_of(piece)}
    reduced = Worker(name)
    try:
        counts = complete("operations"), reduced("operations")
        row |= {key: counts[1][key] / counts[0][key] for key in counts[0]}
        for row_name in ROWS:
            if piece.rows and not any(word in row_name for word in piece.rows):
                continue
            times, first_calls = [math.inf, math.inf], [math.nan, math.nan]
            for _ in range(RUNS):
                for k, worker in enumerate((complete, reduced)):
                    seconds, first_call = worker(row_name)
                    times[k] = min(times[k], seconds)
                    first_calls[k] = FIRST_CALLS.setdefault((row_name, k and name), first_call)
            row |= {row_name: times[1] / times[0], f"first, {row_name}": first_calls[1] / first_calls[0]}
    finally:
        reduced.close()
    return row


FIRST_CALLS: dict[tuple[str, Any], Any] = {}  # (row, piece or 0) ↦ CPU time of the first call [s]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pieces", nargs="*")
    parser.add_argument("--worker")
    arguments = parser.parse_args()
    if arguments.worker is not None:
        work(arguments.worker)
        return
    complete = Worker("")
    rows = {row["piece"]: row for row in stored_rows_if_any("ablation")}
    try:
        for name in arguments.pieces or PIECES:
            rows[name] = ratios(name, PIECES[name], complete)
            print(json.dumps(rows[name]), flush=True)
            store_rows("ablation", list(rows.values()))
    finally:
        complete.close()
    columns = {
        key: "" if key == "piece" else "d" if key == "lines" else ".2f" for key in ("piece", "lines", *ROWS)
    }
    show(list(rows.values()), columns)


if __name__ == "__main__":
    main()
