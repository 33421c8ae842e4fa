"""How long the first answer of a process takes: `python -m benchmarks.startup`, or with names of rows.

"First" has nothing kept, "later" is a further process of the same user. CPU seconds of the process and all its threads,
which say the same on a busy machine, and wall time, the shortest of several, in units of J, the time of `import jax`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile

from .measure import keep, show

PODIUM = """
import rockjax as rj
podium = rj.Podium(alpha=0.15, R=1.5, gamma=10.0, superstructure=rj.Elastic(eta=100.0, T_s=0.5, zeta=0.05))
pulse = rj.Ricker(a_p=2.0, T_p=1.0)
"""
RECORDS = """
import numpy as np
noise = np.random.default_rng(1).normal(size=(8, 1200))
record = lambda k, n: rj.Record(2 * np.convolve(noise[k, :n], np.hanning(12) / 6, "same"), 0.01)
"""
GRADIENT = "jax.block_until_ready(jax.grad(lambda alpha: {}(podium.replace(alpha=alpha), {}))(0.15))"
PEAK = "(lambda p, e: rj.peak_response(p, e).peak_rotation)"
BOUNDARY = "(lambda p, T_p: rj.overturning_acceleration(p, rj.Ricker, T_p))"

# What is there before, and what is timed.
ROWS = {
    "import jax": ("", "import jax"),
    "import rockjax": ("", "import rockjax"),
    "peak_response": (PODIUM, "rj.peak_response(podium, pulse).peak_rotation.block_until_ready()"),
    "its gradient": ("import jax\n" + PODIUM, GRADIENT.format(PEAK, "pulse")),
    "simulate": (PODIUM, "rj.simulate(podium, pulse).times.block_until_ready()"),
    "rocking_spectrum": (
        PODIUM + "import numpy as np",
        "rj.rocking_spectrum(podium, rj.Ricker, np.linspace(1, 8, 20), np.linspace(1, 12, 20))",
    ),
    "overturning_acceleration": (PODIUM, "float(rj.overturning_acceleration(podium, rj.Ricker, 1.0))"),
    "gradient of it": ("import jax\n" + PODIUM, GRADIENT.format(BOUNDARY, "1.0")),
    "overturning_spectrum": (
        PODIUM + "import numpy as np",
        "rj.overturning_spectrum(podium, rj.Ricker, np.linspace(1, 8, 29))",
    ),
    "peak_response to a record": (PODIUM + RECORDS, "rj.peak_response(podium, record(0, 1000)).peak_rotation"),
    "… to another of another length": (
        PODIUM + RECORDS + "rj.peak_response(podium, record(0, 1000))",
        "rj.peak_response(podium, record(1, 1100)).peak_rotation",
    ),
}
COMMANDS = {
    "rockjax --help": ["--help"],
    "rockjax spectrum": ["spectrum", "--quiet", "--points", "20", "-o", "{folder}/study"],
}
SCRIPT = """
import json, time
{before}
wall, cpu = time.perf_counter(), time.process_time()
{timed}
print(json.dumps([time.perf_counter() - wall, time.process_time() - cpu]))
"""


def run(name: str, folder: str) -> tuple[float, float]:
    """Wall and CPU seconds of a row in a new process."""
    environment = os.environ | {"ROCKJAX_CACHE_DIR": folder, "MPLBACKEND": "Agg"}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    if name in ROWS:
        before, timed = ROWS[name]
        script = SCRIPT.format(before=before, timed=timed)
    else:
        command = [part.format(folder=folder) for part in COMMANDS[name]]
        timed = f"subprocess.run({[sys.executable, '-m', 'rockjax', *command]!r}, check=True, stdout=subprocess.DEVNULL)"
        timed += "\nused = resource.getrusage(resource.RUSAGE_CHILDREN)\ncpu -= used.ru_utime + used.ru_stime"
        script = SCRIPT.format(before="import resource, subprocess", timed=timed)
    done = subprocess.run([sys.executable, "-c", script], check=True, env=environment, capture_output=True, text=True)
    wall, cpu = json.loads(done.stdout.splitlines()[-1])
    return wall, cpu


def main(names: list[str], again: int = 3) -> None:
    rows = []
    unit = min(run("import jax", "") for _ in range(again + 1))
    for name in names or [*ROWS, *COMMANDS]:
        with tempfile.TemporaryDirectory() as folder:
            first = run(name, folder)
            later = [run(name, folder) for _ in range(again)]
        wall, cpu = (min(times) for times in zip(*later, strict=True))
        row = {"what": name, "first CPU [s]": first[1], "later CPU [s]": cpu, "later [J of CPU]": cpu / unit[1]}
        rows.append(row | {"first [J]": first[0] / unit[0], "later [J]": wall / unit[0]})
        print(rows[-1], flush=True)
    keep("startup", rows)
    digits = {name: ".2f" for name in rows[0] if name != "what"}
    show(rows, {"what": "", **digits})


if __name__ == "__main__":
    main(sys.argv[1:])
