"""From the prompt to the picture: `python -m benchmarks.startup`. A grid of 20 × 20, cold and with a warm cache."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time

from .measure import keep, show


def run(folder: str, points: int) -> float:
    began = time.perf_counter()
    command = [sys.executable, "-m", "rockjax", "spectrum", "--quiet", "--points", str(points), "-o", f"{folder}/study"]
    subprocess.run(command, check=True, env=os.environ | {"XDG_CACHE_HOME": folder, "MPLBACKEND": "Agg"})
    return time.perf_counter() - began


def main() -> None:
    rows = []
    for points in (20, 100):
        cold, warm = [], []
        for _ in range(2):
            with tempfile.TemporaryDirectory() as folder:
                cold.append(run(folder, points))
                warm += [run(folder, points) for _ in range(3)]
        rows.append({"grid": f"12 × {points} × {points}", "cold [s]": min(cold), "warm [s]": min(warm)})
    keep("startup", rows)
    show(rows, {"grid": "", "cold [s]": ".1f", "warm [s]": ".1f"})


if __name__ == "__main__":
    main()
