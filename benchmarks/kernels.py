"""What XLA makes of the batch program for a GPU that is not there: `JAX_PLATFORMS=cpu python -m
benchmarks.kernels`.

Compiles ahead of time for the GPU described below: kernels and arithmetic of one trial, and memory of a
device. It needs `pip install "jax[cuda13]"`, and neither a GPU nor its driver. What it cannot tell is how
long anything takes.
"""

from __future__ import annotations

import collections
import re
import time

import jax
import numpy as np
from jax.experimental import topologies
from jax.sharding import NamedSharding
from jax.sharding import PartitionSpec as P

import rockjax as rj
from rockjax._batch.batch import layout
from rockjax._batch.executors import DeviceExecutor, _on_mesh
from rockjax._batch.lanes import idle
from rockjax._batch.scenes import Numbers, broadcast

from .families import family
from .measure import keep, options, podium, show

# As NVIDIA's data sheet and the occupancy tables of compute capability 9.0 have it.
H200 = """
gpu_device_info {
  cuda_compute_capability { major: 9 }
  core_count: 132  fpus_per_core: 128  clock_rate_ghz: 1.98
  threads_per_block_limit: 1024  threads_per_warp: 32  threads_per_core_limit: 2048
  registers_per_core_limit: 65536  registers_per_block_limit: 65536
  shared_memory_per_block: 49152  shared_memory_per_core: 233472  shared_memory_per_block_optin: 232448
  block_dim_limit_x: 2147483647  block_dim_limit_y: 65535  block_dim_limit_z: 65535
  memory_bandwidth: 4800000000000  l2_cache_size: 52428800  device_memory_size: 150121545728
}
platform_name: "CUDA"  runtime_version { major: 13 }  dnn_version_info { major: 9 minor: 10 }
device_description_str: "NVIDIA H200"
"""
FAMILIES = ("rigid", "T_s = 0.5 s")
POINTS = 1000
TRIAL = '"jit(advance_all)/while/body/while"'  # the loop whose body is a trial of all lanes
NO_ARITHMETIC = {
    "parameter",
    "get-tuple-element",
    "tuple",
    "constant",
    "bitcast",
    "broadcast",
    "copy",
    "reshape",
    "slice",
}
CALLS = {"fusion", "call", "opt-barrier"}


def program(name: str, device: jax.Device):
    """The batch program for a family of scenes, lowered for the device, and the number of its lanes."""
    pulses = family(name, POINTS)
    scenes, _ = broadcast("", podium(pulses), rj.Ricker(pulses.a_p, pulses.T_p), rj.State(), None)
    how, who = options(1e-8), DeviceExecutor([device])
    plan = layout(scenes, who)
    dealt, common = (NamedSharding(who.mesh, place) for place in (P("scenes"), P()))

    def shape(y, place):
        return jax.ShapeDtypeStruct(
            np.shape(y), jax.dtypes.canonicalize_dtype(np.asarray(y).dtype), sharding=place
        )

    leaves = scenes.part(Numbers(0, 1, plan.size), plan.size)
    places = [common if rows is None else dealt for rows in scenes.rows]
    numbers = shape(np.zeros(1, int), dealt)
    lowered = _on_mesh(who.mesh).lower(
        jax.tree.map(lambda y: shape(y, dealt), idle(scenes, how, plan).tree()),
        [shape(y, place) for y, place in zip(leaves, places, strict=True)],
        numbers, 1, numbers, 0, jax.tree.map(lambda y: shape(y, common), how), layout=plan,
    )  # fmt: skip
    return lowered, plan.lanes


def trial(text: str) -> tuple[int, int]:
    """Kernels of the body of the innermost loop, and its instructions that compute, from the text of an HLO
    module."""
    computations: dict[str, list[str]] = collections.defaultdict(list)
    name = ""
    for line in text.splitlines():
        if found := re.match(r"(?:ENTRY )?%?([\w.\-]+) .*\{$", line):
            name = found[1]
        elif line.startswith("  "):
            computations[name].append(line)

    def arithmetic(name: str) -> int:
        total = 0
        for line in computations[name]:
            operation = re.search(r" ([a-z][\w\-]*)\(", line.partition(" = ")[2])
            kind = operation[1] if operation else "tuple"
            called = re.findall(r"(?:calls|to_apply)=%?([\w.\-]+)", line)
            total += sum(map(arithmetic, called)) + (kind not in NO_ARITHMETIC | CALLS)
        return total

    loops = [line for line in text.splitlines() if " while(" in line and TRIAL in line]
    (body,) = {re.search(r"body=%?([\w.\-]+)", line)[1] for line in loops}  # pyright: ignore[reportOptionalSubscript]
    return sum(" fusion(" in line for line in computations[body]), arithmetic(body)


def main() -> None:
    target = topologies.get_topology_desc("", platform="cuda", target_config=H200, topology="1x1x1")
    (device,) = target.devices
    rows = []
    for name in FAMILIES:
        lowered, lanes = program(name, device)
        began = time.perf_counter()
        compiled = lowered.compile()
        took = time.perf_counter() - began
        (_, written), (kernels, done) = (
            trial(text) for text in (lowered.as_text("hlo", debug_info=True), compiled.as_text())
        )
        memory = compiled.memory_analysis()
        used = memory.argument_size_in_bytes + memory.output_size_in_bytes + memory.temp_size_in_bytes
        rows.append(
            {
                "family": name, "lanes": lanes, "kernels": kernels, "written": written, "computed": done,
                "MiB": used / 2**20, "compile [s]": took,
            }
        )  # fmt: skip
    print(f"for one {device.device_kind}")
    show(
        rows,
        {
            "family": "",
            "lanes": "d",
            "kernels": "d",
            "written": "d",
            "computed": "d",
            "MiB": ".0f",
            "compile [s]": ".0f",
        },
    )
    keep("kernels", rows)


if __name__ == "__main__":
    main()
