"""Sweeps: throughput with local processes, overhead of chunks, memory: `python -m benchmarks.sweeps`.

Times are the shortest of several runs. They are also divided by the time of a batch of the same scenes.
`python -m benchmarks.sweeps large SCENES STORE` runs one large sweep; the same command continues
an interrupted one.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

import rockjax as rj

from .measure import report

OUTPUTS = ("peak_rotation",)
RUNS = 3


def grid(alphas: int, points: int) -> rj.Grid:
    """Return a grid of rigid podiums under Ricker pulses."""
    podium = rj.Podium(alpha=0.15, R=1.5, gamma=10.0, superstructure=rj.Rigid(50.0))
    return rj.grid(
        podium,
        rj.Ricker(1.0, 1.0),
        alpha=np.linspace(0.1, 0.25, alphas),
        acceleration_ratio=np.linspace(1.0, 8.0, points),
        frequency_ratio=np.linspace(1.0, 8.0, points),
    )


def sweep(scenes: rj.Grid, folder: Path, **more: Any) -> float:
    """Return the wall time of a sweep [s] without its pilot, by resuming a store that contains no chunk."""
    store = folder / "a.zarr"
    shutil.rmtree(store, ignore_errors=True)
    settings = {"store": store, "outputs": OUTPUTS, "progress": False} | more
    _create_store(scenes, settings)
    start = time.perf_counter()
    rj.sweep(*scenes, **settings)
    return time.perf_counter() - start


def _create_store(scenes: rj.Grid, settings: dict[str, Any]) -> None:
    """Create a store without solved chunks."""
    from rockjax._sweep.chunks import Job

    solve = Job.solve

    def stop(*_):
        raise KeyboardInterrupt

    Job.solve = stop  # pyright: ignore[reportAttributeAccessIssue]
    try:
        rj.sweep(*scenes, **{name: value for name, value in settings.items() if name != "client"})
    except KeyboardInterrupt:
        pass
    finally:
        Job.solve = solve


def overhead(folder: Path) -> list[dict]:
    """Compare a sweep in this process with one batch, for several sizes of its chunks."""
    from rockjax._sweep.store import Store

    scenes = grid(150, 100)  # 1 500 000
    options = rj.Options(outputs=OUTPUTS)
    solve_batch = lambda: rj.peak_responses(*scenes[:2], options=options)
    solve_batch()
    sizes = 10_000, 100_000, None
    best, batch, chunk_counts = dict.fromkeys(sizes, np.inf), np.inf, {}
    for _ in range(RUNS):  # the cases alternate, so that other load of the machine affects all of them
        batch = min(batch, timed(solve_batch))
        for chunk in sizes:
            best[chunk] = min(best[chunk], sweep(scenes, folder, chunk=chunk))
            store = Store.open(folder / "a.zarr")
            assert store is not None
            chunk_counts[chunk] = store.layout.chunk_count
    rows = [{"scenes a chunk": "all, the batch path", "chunks": 1, "s": batch, "over the batch": 0.0}]
    for chunk in sizes:
        size = scenes.size // chunk_counts[chunk]
        label = f"{size} (default)" if chunk is None else str(size)
        row = {"scenes a chunk": label, "chunks": chunk_counts[chunk], "s": best[chunk]}
        rows.append(row | {"over the batch": best[chunk] / batch - 1})
    slope = (best[sizes[0]] - best[None]) / (chunk_counts[sizes[0]] - chunk_counts[None])
    print(f"{slope * 1e3:.0f} ms per chunk")
    return rows


def timed(function) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def processes(folder: Path) -> list[dict]:
    """Time the same sweep on 1, 2 and 5 local processes."""
    from distributed import Client, LocalCluster

    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder / "programs")
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.5"
    scenes = grid(150, 100)  # 1 500 000
    local_seconds = min(sweep(scenes, folder, chunk=50_000) for _ in range(RUNS))
    rows = [{"workers": "this process", "s": local_seconds, "scenes / s": scenes.size / local_seconds}]
    for count in (1, 2, 5):
        local = LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None)  # pyright: ignore[reportArgumentType]
        with local, Client(local) as client:
            sweep(grid(10, 100), folder, chunk=1000, client=client)  # compiles everywhere
            best = min(sweep(scenes, folder, chunk=50_000, client=client) for _ in range(RUNS))
        rows.append({"workers": str(count), "s": best, "scenes / s": scenes.size / best})
        print(rows[-1], flush=True)
    for row in rows:
        row["over one"] = rows[1]["s"] / row["s"]
    return rows


MEMORY = """
import json, sys
from pathlib import Path
from benchmarks.sweeps import memory_of
print(json.dumps(memory_of(int(sys.argv[1]), Path(sys.argv[2]))))
"""


def memory_of(alphas: int, folder: Path) -> dict:
    """Return the largest resident memory in the first tenth, the last tenth and all of a sweep [MiB]."""
    import psutil

    samples: list[tuple[float, float]] = []
    stop = threading.Event()
    process = psutil.Process()

    def watch():
        while not stop.wait(0.05):
            samples.append((time.perf_counter(), process.memory_info().rss / 2**20))

    thread = threading.Thread(target=watch)
    scenes = grid(alphas, 100)
    _create_store(
        scenes, {"store": folder / "m.zarr", "outputs": OUTPUTS, "progress": False, "chunk": 50_000}
    )
    thread.start()
    rj.sweep(*scenes, store=folder / "m.zarr", outputs=OUTPUTS, progress=False, chunk=50_000)
    stop.set()
    thread.join()
    values = np.array([value for _, value in samples])
    largest = [float(tenth.max()) for tenth in np.array_split(values, 10) if len(tenth)]
    return {
        "scenes": scenes.size,
        "first tenth [MiB]": largest[0],
        "last tenth [MiB]": largest[-1],
        "most [MiB]": float(values.max()),
    }


def memory(folder: Path) -> list[dict]:
    rows = []
    for alphas in (10, 30, 100, 300):
        store_folder = folder / f"memory-{alphas}"
        store_folder.mkdir()
        completed = subprocess.run(
            [sys.executable, "-c", MEMORY, str(alphas), str(store_folder)],
            capture_output=True,
            text=True,
            check=True,
        )
        rows.append(json.loads(completed.stdout.splitlines()[-1]))
        print(rows[-1], flush=True)
    return rows


def large(scenes: int, store: Path) -> list[dict]:
    """Return processor time, disk space and memory of a sweep of `scenes` rigid scenes."""
    import psutil

    points = 1000
    scenes_grid = grid(max(1, scenes // points**2), points)
    before = os.times()
    data = rj.sweep(*scenes_grid, store=store, outputs=OUTPUTS, progress=sys.stderr.isatty())
    after, process = os.times(), psutil.Process()
    assert not isinstance(data, rj.SweepPlan)
    result = data["result"].astype("int64")
    return [
        {
            "scenes": scenes_grid.size,
            "cpu s": after.user + after.system - before.user - before.system,
            "wall s": after.elapsed - before.elapsed,
            "memory [MiB]": process.memory_info().rss / 2**20,
            "peak memory [MiB]": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10,
            "disk [MiB]": sum(file.stat().st_size for file in store.rglob("*") if file.is_file()) / 2**20,
            "files": sum(1 for file in store.rglob("*") if file.is_file()),
            "overturned": int((result == 2).sum()),
            "without an answer": int((result > 2).sum()),
        }
    ]


def main() -> None:
    if sys.argv[1:2] == ["large"]:
        report("sweeps-large", large(int(float(sys.argv[2])), Path(sys.argv[3])))
        return
    studies = {"overhead": overhead, "processes": processes, "memory": memory}
    with tempfile.TemporaryDirectory() as folder:
        for name in sys.argv[1:] or studies:
            report(f"sweeps-{name}", studies[name](Path(folder)))


if __name__ == "__main__":
    main()
