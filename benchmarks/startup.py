"""Time to the first answer of a process: `python -m benchmarks.startup [names of rows]`.

A "first" process starts without stored programs. A "later" process of the same user finds them; its time is
the shortest of several runs. The table has wall times, and CPU times of all threads of the process, which
depend less on other processes. Both are also divided by J, the time of `import jax`. Rows named in the
command replace stored rows.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile

from .measure import show, store_rows, stored_rows

PODIUM = """
import jax, numpy as np, rockjax as rj
podium = rj.Podium(alpha=0.15, R=1.5, gamma=10.0, superstructure=rj.Elastic(eta=100.0, T_s=0.5, zeta=0.05))
pulse = rj.Ricker(a_p=2.0, T_p=1.0)
peak = lambda podium, motion: rj.peak_response(podium, motion).peak_rotation
least_a_p = lambda podium, T_p: rj.overturning_acceleration(podium, rj.Ricker, T_p)
least_scale = lambda podium, motion: rj.overturning_scale(podium, motion)
slope = lambda answer, *args: jax.grad(lambda alpha: answer(podium.replace(alpha=alpha), *args))(0.15)
ready = lambda value: value.block_until_ready()
"""
RECORDS = (
    PODIUM
    + """
noise = np.random.default_rng(1).normal(size=(8, 1200))
samples = lambda k, count: 3 * np.convolve(noise[k, :count], np.hanning(12) / 6, "same")
record = lambda k, count: rj.Record(samples(k, count), 0.01)
"""
)
DESIGN = (
    PODIUM
    + """
import optimise
column = optimise.Dimensions(
    width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3, top_mass=300e3, period=0.5
)
pulses = [rj.Ricker(4.0, 0.6), rj.Ricker(3.25, 1.0), rj.Ricker(2.5, 1.4)]
stronger = [pulse.scaled(1.5) for pulse in pulses]
targets = [optimise.PeakRotation(0.4, pulses), optimise.NoOverturning(stronger)]
"""
)
ALL_SAMPLES = (
    "ready(jax.grad(lambda samples: peak(podium, rj.Record(samples, 0.01)))(jax.numpy.asarray(samples({}))))"
)
ANALYSIS = (
    "rj.incremental_dynamic_analysis(podium, [record(k, 1000) for k in range(8)], np.linspace(0.5, 12, 12))"
)

# Name of a row ↦ (code before the timed part, timed code).
ROWS = {
    "import jax": ("", "import jax"),
    "import rockjax": ("", "import rockjax"),
    "peak_response": (PODIUM, "ready(peak(podium, pulse))"),
    "its gradient": (PODIUM, "ready(slope(peak, pulse))"),
    "simulate": (PODIUM, "ready(rj.simulate(podium, pulse).times)"),
    "rocking_spectrum": (
        PODIUM,
        "rj.rocking_spectrum(podium, rj.Ricker, np.linspace(1, 8, 20), np.linspace(1, 12, 20))",
    ),
    "overturning_acceleration": (PODIUM, "ready(least_a_p(podium, 1.0))"),
    "gradient of it": (PODIUM, "ready(slope(least_a_p, 1.0))"),
    "overturning_spectrum": (PODIUM, "rj.overturning_spectrum(podium, rj.Ricker, np.linspace(1, 8, 29))"),
    "design": (
        DESIGN,
        "optimise.design(column, {'width': (0.2, 1.5)}, lambda podium: podium.alpha, targets, starts=4)",
    ),
    "analysis of 8 records": (RECORDS, ANALYSIS),
    "gradient by all samples": (RECORDS, ALL_SAMPLES.format("0, 1000")),
    "peak of a record": (RECORDS, "ready(peak(podium, record(0, 1000)))"),
    "… of a second": (
        RECORDS + "ready(peak(podium, record(0, 1000)))",
        "ready(peak(podium, record(1, 1100)))",
    ),
    "gradient of a record's peak": (RECORDS, "ready(slope(peak, record(0, 1000)))"),
    "… of a second's": (
        RECORDS + "ready(slope(peak, record(0, 1000)))",
        "ready(slope(peak, record(1, 1100)))",
    ),
    "boundary of a record": (RECORDS, "ready(least_scale(podium, record(0, 1000)))"),
    "… of another": (
        RECORDS + "ready(least_scale(podium, record(0, 1000)))",
        "ready(least_scale(podium, record(1, 1100)))",
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
    """Return wall and CPU time of a row in a new process [s]."""
    environment = os.environ | {"ROCKJAX_CACHE_DIR": folder, "MPLBACKEND": "Agg"}
    # These are the defaults of users: no compilation cache of JAX, and stored bytecode of Python.
    for name_of_setting in ("JAX_COMPILATION_CACHE_DIR", "PYTHONDONTWRITEBYTECODE"):
        environment.pop(name_of_setting, None)
    if name in ROWS:
        before, timed = ROWS[name]
        script = SCRIPT.format(before=before, timed=timed)
    else:
        command = [part.format(folder=folder) for part in COMMANDS[name]]
        timed = (
            f"subprocess.run({[sys.executable, '-m', 'rockjax', *command]!r}, check=True, "
            f"stdout=subprocess.DEVNULL)"
        )
        timed += "\nused = resource.getrusage(resource.RUSAGE_CHILDREN)\ncpu -= used.ru_utime + used.ru_stime"
        script = SCRIPT.format(before="import resource, subprocess", timed=timed)
    completed = subprocess.run(
        [sys.executable, "-c", script], check=True, env=environment, capture_output=True, text=True
    )
    wall, cpu = json.loads(completed.stdout.splitlines()[-1])
    return wall, cpu


def main(names: list[str], repetitions: int = 3) -> None:
    rows = {} if not names else {row["what"]: row for row in stored_rows("startup")}
    import_time = [
        min(times) for times in zip(*(run("import jax", "") for _ in range(repetitions + 1)), strict=True)
    ]
    for name in names or [*ROWS, *COMMANDS]:
        with tempfile.TemporaryDirectory() as folder:
            first = run(name, folder)
            later = [run(name, folder) for _ in range(repetitions)]
        wall, cpu = (min(times) for times in zip(*later, strict=True))
        row = {"what": name, "first CPU [s]": first[1]}
        row |= {"later CPU [s]": cpu, "later [J of CPU]": cpu / import_time[1]}
        rows[name] = row | {"first [s]": first[0], "later [s]": wall, "later [J]": wall / import_time[0]}
        print(rows[name], flush=True)
        store_rows("startup", list(rows.values()))
    show(list(rows.values()))


if __name__ == "__main__":
    main(sys.argv[1:])
