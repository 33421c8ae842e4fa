"""Ablation of optimisations: `python -m benchmarks.ablation [piece …]`.

The benchmark switches off one optimisation ("piece") at a time in a separate process, and alternates timings
between this process and one with all pieces. It reports the shortest time without a piece divided by the
shortest time with it. Each process compiles its own programs, which gives the CPU seconds of compilation. Run
nothing else on the machine meanwhile.

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

    off: Callable[[], None]  # switch it off in this process, before anything is traced
    modules: tuple[str, ...]  # modules that implement it
    rows: tuple[str, ...] = ()  # words of the rows that it can change; empty for all rows


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
    """Make every plan without a fast-forward."""
    made = scene.plan_for

    def without(*given: Any, **named: Any) -> Any:
        plan = made(*given, **named)
        return dataclasses.replace(plan, fast_forwards=tuple(y for y in plan.fast_forwards if y != name))

    _replace(made, without)


def _no_certificate() -> None:
    _replace(certificate.certificate, lambda *given, **named: jnp.zeros((), bool))


def _no_refill() -> None:
    """Refill lanes only when all of them have ended."""
    lanes.PATIENCE = 1.0


def _no_nystrom() -> None:
    _replace(tableaus.tableau_for, lambda method, velocities: tableaus.tableau(method))


def _no_sines() -> None:
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
    "own sine and cosine": Piece(_no_sines, ("_sincos.py",)),
}


# ------------------------------------------------------------------------------------------------------- rows
@functools.cache
def _suite() -> Suite:
    return Suite()


def _panel(period: float, outputs: tuple[str, ...] | None, points: int = 100) -> Callable[[], Any]:
    pulses = family("rigid" if period == 0 else f"T_s = {period:g} s", points)
    how = options(1e-8) if outputs else rj.Options()
    motions = rj.Ricker(pulses.a_p, pulses.T_p)
    return lambda: rj.peak_responses(podium(pulses), motions, options=how)


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
    """Return the arithmetic operations of one trial per scene, in the compiled program."""
    operations = {}
    for name, period in (("rigid", 0.0), ("elastic", 0.5)):
        structure = podium(Family(period, np.zeros(0), np.zeros(0)))
        motion, how = rj.Record(np.sin(np.arange(100)), 0.02), rj.Options()
        structure = structure.split()
        plan = scene.plan_for(structure, how, history=False)
        start = functools.partial(scene.prepare, structure, motion, REST, None, how, plan)
        one, state = jax.jit(start)()
        side = jax.tree.map(lambda y: jnp.broadcast_to(y, (LANES, *jnp.shape(y))), state)
        step = lambda lane, one=one, plan=plan: trial(one, plan, lane)[0]
        made = jax.jit(jax.vmap(step)).lower(side).compile()
        cost: Any = made.cost_analysis()
        operations[f"operations, {name}"] = round(cost["flops"] / LANES)
    return operations


def work(piece: str) -> None:
    """Read rows from the standard input; print their wall times, and the CPU time of the first call [s]."""
    if piece:
        PIECES[piece].off()
    made: dict[str, Callable[[], Any]] = {}
    for line in sys.stdin:
        name = line.strip()
        if name == "operations":
            print(json.dumps(operations()), flush=True)
            continue
        first = None
        if name not in made:
            made[name] = ROWS[name]()
            start = time.process_time()
            made[name]()
            first = time.process_time() - start
        start = time.perf_counter()
        made[name]()
        print(json.dumps([time.perf_counter() - start, first]), flush=True)


class Worker:
    """A process in which one optimisation is switched off; none if its name is ""."""

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


def ratios(name: str, piece: Piece, whole: Worker) -> dict[str, Any]:
    """Return ratios without/with the piece: times, CPU seconds of first calls, operations of a trial."""
    row: dict[str, Any] = {"piece": name, "lines": lines_of(piece)}
    without = Worker(name)
    try:
        counts = whole("operations"), without("operations")
        row |= {key: counts[1][key] / counts[0][key] for key in counts[0]}
        for what in ROWS:
            if piece.rows and not any(word in what for word in piece.rows):
                continue
            times, firsts = [math.inf, math.inf], [math.nan, math.nan]
            for _ in range(RUNS):
                for k, worker in enumerate((whole, without)):
                    took, first = worker(what)
                    times[k] = min(times[k], took)
                    firsts[k] = FIRSTS.setdefault((what, k and name), first)
            row |= {what: times[1] / times[0], f"first, {what}": firsts[1] / firsts[0]}
    finally:
        without.close()
    return row


FIRSTS: dict[tuple[str, Any], Any] = {}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pieces", nargs="*")
    parser.add_argument("--worker")
    given = parser.parse_args()
    if given.worker is not None:
        work(given.worker)
        return
    whole = Worker("")
    rows = {row["piece"]: row for row in stored_rows_if_any("ablation")}
    try:
        for name in given.pieces or PIECES:
            rows[name] = ratios(name, PIECES[name], whole)
            print(json.dumps(rows[name]), flush=True)
            store_rows("ablation", list(rows.values()))
    finally:
        whole.close()
    columns = {
        key: "" if key == "piece" else "d" if key == "lines" else ".2f" for key in ("piece", "lines", *ROWS)
    }
    show(list(rows.values()), columns)


if __name__ == "__main__":
    main()
