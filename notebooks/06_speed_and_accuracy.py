# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Speed and accuracy
#
# How does the run time depend on the accuracy? All times below are measured on the machine that runs the
# notebook, and other processes affect them. [Performance](../docs/performance.md) has careful measurements
# and comparisons with other solvers.

# %%
import os
import time

import matplotlib.pyplot as plt
import numpy as np

import rockjax as rj
from rockjax import plots

REDUCED = os.environ.get("ROCKJAX_NOTEBOOKS") == "reduced"  # small grids and a rigid building, for the tests

building = rj.Rigid(eta=100.0) if REDUCED else rj.Elastic(eta=100.0, T_s=0.5)
podium = rj.Podium(alpha=np.arctan(0.15), R=1.5, gamma=10.0, superstructure=building)
n = 16 if REDUCED else 60
grid = np.linspace(1, 8, n), np.linspace(1, 12, n)  # ω_p/p and a_p/(g tan α)


def timed(run, repeats=3):
    """Return the result, and the shortest time of several runs [s]."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        answer = run()
        times.append(time.perf_counter() - start)
    return answer, min(times)


def spectrum(rtol, *outputs):
    options = rj.Options(rtol=rtol, atol=0.01 * rtol, outputs=outputs)
    return rj.rocking_spectrum(podium, rj.Ricker, *grid, options=options)


# %% [markdown]
# ## The first call
#
# The first call compiles a program. Later calls use it for other podiums with the same classes of
# superstructure and restitution, other parameters of the pulse and other tolerances.

# %%
_, first = timed(lambda: spectrum(1e-8, "peak_rotation"), repeats=1)
_, later = timed(lambda: spectrum(1e-8, "peak_rotation"))
each = 1e6 * later / n**2
print(
    f"first {first:.2f} s, later "
    f"{later:.3f} s: {each:.1f} µs for each of {n**2} scenes, {os.cpu_count()} cores"
)

# %% [markdown]
# ## Run time against error
#
# The same spectrum is solved with decreasing tolerances and compared with `rtol=1e-13`. The errors are errors
# of $\max|\theta|/\alpha$ in the scenes that survive at both tolerances.

# %%
reference = spectrum(1e-13, "peak_rotation")
tolerances = 10.0 ** -np.arange(3, 13, 3 if REDUCED else 1)
rows = []
for rtol in tolerances:
    answer, seconds = timed(lambda rtol=rtol: spectrum(rtol, "peak_rotation"))
    is_comparable = ~answer.overturned & ~reference.overturned
    error = np.abs(answer.peak_rotation - reference.peak_rotation).values[is_comparable]
    changed = int((answer.overturned != reference.overturned).sum())
    rows.append((rtol, 1e6 * seconds / n**2, np.median(error), np.percentile(error, 99), changed))

print(" rtol    µs/scene   median error   99 % below   outcomes that differ")
for row in rows:
    print("{:.0e}   {:7.2f}       {:.1e}      {:.1e}   {:10d}".format(*row))

# %%
_, cost, median, high, _ = np.array(rows).T
ax = plt.figure(figsize=(6, 3.6), layout="constrained").add_subplot()
ax.semilogx(median, cost, "o-", color=plots.COLOURS[2], label="median")
ax.semilogx(high, cost, "s--", color=plots.COLOURS[1], label="99 % below")
ax.set(xlabel=r"error of $\max|\theta|\,/\,\alpha$", ylabel="time per scene [µs]", ylim=(0, None))
ax.invert_xaxis()
ax.grid(alpha=0.3)
legend = ax.legend()

# %% [markdown]
# An additional digit takes little additional time, because the method is of order eight. The errors decrease
# with the tolerance down to rounding, except close to the overturning boundary, which amplifies small errors.
#
# ## Outputs
#
# A scene ends as soon as no requested output can change. The peak rotation is final early. If impacts are
# counted, the scene must be solved until the columns rest.

# %%
selections = [("peak_rotation",), ("peak_rotation", "impacts")]
selections += (
    [] if REDUCED else [("peak_rotation", "margin"), ("peak_rotation", "peak_deformation", "peak_shear")]
)
for outputs in selections:
    spectrum(1e-8, *outputs)  # compiles
    answer, seconds = timed(lambda outputs=outputs: spectrum(1e-8, *outputs))
    steps = float(answer.steps.mean())
    print(f"{1e6 * seconds / n**2:8.1f} µs/scene  {steps:6.0f} steps  {', '.join(outputs)}")

# %% [markdown]
# ## Errors without a reference
#
# In practice there is no reference. `"errors"` estimates the error of each scene by a second solution. The
# picture compares estimated and true errors at a tolerance of 1e-6:

# %%
checked = spectrum(1e-6, "peak_rotation", "errors")
is_comparable = (
    ~checked.overturned & ~reference.overturned & np.isfinite(checked.peak_rotation_error)
).values
true = np.abs(checked.peak_rotation - reference.peak_rotation).values[is_comparable]
estimate = checked.peak_rotation_error.values[is_comparable]
is_positive = (true > 0) & (estimate > 0)

ax = plt.figure(figsize=(5, 4), layout="constrained").add_subplot()
ax.loglog(true[is_positive], estimate[is_positive], ".", ms=3, color=plots.COLOURS[2])
ends = np.array([1e-14, 1e-2])
ax.plot(ends, ends, color=plots.COLOURS[0], linestyle="--", label="estimate = error")
ax.set(xlabel=r"error of $\max|\theta|\,/\,\alpha$", ylabel="estimated error", xlim=ends, ylim=ends)
ax.grid(alpha=0.3)
ax.legend()
print(f"error below ten times its estimate in {np.mean(true <= 10 * estimate):.2%} of the scenes")
print(f"{int(checked.undecided.sum())} scenes undecided")

# %% [markdown]
# ## A single scene
#
# A single scene takes longer than a scene of a batch, because a batch solves several scenes by the same
# vector instructions, and the call itself takes time.

# %%
pulse = rj.Ricker(a_p=3.0, T_p=1.0)
only = rj.Options(outputs=("peak_rotation",))
rj.peak_response(podium, pulse, options=only)  # compiles
_, seconds = timed(
    lambda: rj.peak_response(podium, pulse, options=only).peak_rotation.block_until_ready(), repeats=20
)
print(f"{1e3 * seconds:.2f} ms for one scene")

# %% [markdown]
# ## Next
#
# - [Performance](../docs/performance.md): methods, other solvers, batches up to a million scenes
# - [Verification](../docs/verification.md): checks of the solver and of the error estimates
# - [Sharp bits](../docs/sharp-bits.md): changes that need another compilation
