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
# # Risk
#
# How often do columns overturn? This notebook computes the annual frequency from a fragility curve and the
# hazard of a site, and the probability under a random ground motion. [Risk](../docs/risk.md) has the formulas
# and discusses the accuracy of the estimates.

# %%
import os

import matplotlib.pyplot as plt
import numpy as np

import optimise
import rockjax as rj
from rockjax import plots

REDUCED = os.environ.get("ROCKJAX_NOTEBOOKS") == "reduced"  # small samples, for the tests

# %% [markdown]
# ## From a fragility curve to an annual frequency
#
# A hazard curve is the annual rate at which an intensity is exceeded; a fragility curve is the probability
# that columns overturn at this intensity. Their integral is the annual frequency of overturning.

# %%
hazard = rj.Hazard([0.5, 1, 2, 4, 8, 16], [3.5e-2, 1.2e-2, 3.4e-3, 7.5e-4, 1.2e-4, 1.1e-5])
curve = rj.Lognormal(median=4.0, dispersion=0.45)
risk = rj.annual_frequency(curve, hazard)
print(risk)
print(f"a median higher by 1 %: {float(risk.sensitivities['median']):+.2f} % of the frequency")
print(f"a dispersion higher by .01: {float(risk.sensitivities['dispersion']):+.2f} % of the frequency")
plots.risk(rj.disaggregation(curve, hazard))

# %% [markdown]
# Which median leads to a target frequency, such as $4\cdot10^{-4}$ per year? The frequency is nearly a power
# of the median, so a few Newton steps in logarithms find it.

# %%
target, median = 4e-4, 4.0
for _ in range(5):
    risk = rj.annual_frequency(rj.Lognormal(median, 0.45), hazard)
    median *= float((target / risk.frequency) ** (1 / risk.sensitivities["median"]))
print(f"a median of {median:.3f} m/s² leads to {float(risk.frequency):.2e} per year")

# %% [markdown]
# ## A random ground motion
#
# `GaussianMotion` maps vectors of standard normal variables to records. Every record has another peak and
# another response spectrum.

# %%
motion = rj.GaussianMotion(n=121, dt=0.04, S_0=0.02)
records = motion.record(motion.samples(5, seed=1))
fig, ax = plt.subplots(figsize=(8, 3.5), layout="constrained")
for row in np.asarray(records.acceleration):
    ax.plot(0.04 * np.arange(row.size), row, lw=0.8)
ax.plot(0.04 * np.arange(121), motion.standard_deviation(), "k--", label="standard deviation")
ax.set(xlabel="time [s]", ylabel=r"$\ddot u_g$ [m/s²]")
ax.legend()

# %% [markdown]
# ## Probability of overturning
#
# Subset simulation expresses the probability of a rare event as a product of larger probabilities. Monte
# Carlo simulation leads to the same result, but needs many more scenes if the event is rare.

# %%
block = rj.Podium(alpha=0.2, R=1.0)
cov = 0.3 if REDUCED else 0.1
for method in ("subset", "monte-carlo"):
    found = rj.failure_probability(block, motion, method=method, cov=cov, seed=1)
    low, high = found.interval
    print(f"{method}: {found.probability:.3g}, 95 % between {low:.3g} and {high:.3g}, {found.scenes} scenes")

# %% [markdown]
# The probability decreases with $\alpha$, because stockier columns overturn less often.

# %%
alphas = np.linspace(0.18, 0.24, 2 if REDUCED else 5)
estimates = [
    rj.failure_probability(block.replace(alpha=alpha), motion, method="subset", cov=max(cov, 0.15), seed=1)
    for alpha in alphas
]
fig, ax = plt.subplots(figsize=(5.5, 4), layout="constrained")
middle = np.array([estimate.probability for estimate in estimates])
spread = np.abs(np.array([estimate.interval for estimate in estimates]).T - middle)
ax.errorbar(np.tan(alphas), middle, yerr=spread, fmt="o-", capsize=3)
ax.set(xlabel=r"$\tan\alpha$", ylabel="probability of overturning", yscale="log")

# %% [markdown]
# ## A design for a target
#
# The aim is the slimmest block that overturns with a probability of at most 5 %. During the search, the
# probability comes from failures along fixed directions of the random variables, with exact derivatives. An
# independent sample verifies the result.


# %%
def slenderness(podium):
    return podium.alpha


target = optimise.FailureProbability(0.05, motion, cov=0.4 if REDUCED else 0.15, rays=12 if REDUCED else 48)
answer = optimise.design(block, {"alpha": (0.12, 0.4)}, slenderness, target)
print(answer)

# %% [markdown]
# ## Next
#
# - [Risk](../docs/risk.md): files of hazard curves, design points, limit states with known answers
# - [`05_records_and_fragility`](05_records_and_fragility.py): fragility curves from records
# - [Design](../docs/design.md): columns for an annual frequency, or for a probability under a random motion
