"""Plots of ensembles: empirical distribution functions with confidence bands, and the quantiles of two
ensembles against each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from rockjax._checks import format_value, require_instance
from rockjax._studies.ensemble import CONFIDENCE, Ensemble
from rockjax._units import displayed

from ._fragility import BAND_OPACITY, LEGEND_ABOVE
from ._style import COLOURS, curve_style, on_axes

if TYPE_CHECKING:
    import xarray

MAX_POINTS = 1000  # largest number of quantiles of a curve
MARKED_PROBABILITIES = (0.05, 0.16, 0.5, 0.84, 0.95)  # quantiles drawn with intervals


@on_axes
def ensemble(
    ensembles: Ensemble | xarray.Dataset | Mapping[str, Ensemble | xarray.Dataset],
    ax: Axes | None = None,
    output: str = "peak_rotation",
    component: int | None = None,
    confidence: float = CONFIDENCE,
) -> Axes:
    """Plot empirical distribution functions of an output with confidence bands, a curve for each ensemble.

    - `ensembles`: a [`rockjax.Ensemble`][] or its dataset; or a dict label → ensemble for several curves
    - `ax`: axes to draw into
    - `output`, `component`, `confidence`: as for `Ensemble.cdf`

    Peaks of overturned scenes count as +∞, so the curve of a peak ends at the fraction of surviving scenes.
    Answers named `least_…` of overturned scenes count as −∞, so the curve of such an answer starts at the
    fraction of overturned scenes. Raises `ValueError` as `Ensemble.cdf` does.
    """
    assert ax is not None
    is_single = isinstance(ensembles, Ensemble) or hasattr(ensembles, "data_vars")
    members = _members({"": ensembles} if is_single else ensembles)
    samples = [y.sample(output, component).values for y in members.values()]
    low, high = _limits(np.concatenate(samples), output, members)
    for k, (label, member) in enumerate(members.items()):
        at = np.unique(np.r_[low, samples[k][np.isfinite(samples[k])], high])
        curve, style = member.cdf(output, component=component, at=at, confidence=confidence), curve_style(k)
        ax.fill_between(
            at, curve["lower"], curve["upper"], step="post", color=style["color"], alpha=BAND_OPACITY, lw=0
        )
        curve_label = f"{_legend_entry(label, member)}, {confidence:.0%} band"
        ax.step(at, curve["probability"], where="post", label=curve_label, **style)
    ax.set(
        xlabel=_heading(next(iter(members.values())), output, component),
        ylabel="probability of not exceeding",
        xlim=(low, high),
        ylim=(0, 1),
    )
    ax.grid(alpha=0.3)
    ax.legend(**LEGEND_ABOVE)
    return ax


@on_axes
def quantile_quantile(
    ensembles: Mapping[str, Ensemble | xarray.Dataset],
    ax: Axes | None = None,
    output: str = "peak_rotation",
    component: int | None = None,
    confidence: float = CONFIDENCE,
) -> Axes:
    """Plot the quantiles of an output in two ensembles against each other, at equal probabilities.

    - `ensembles`: dict label → ensemble with two entries; the first is on the horizontal axis
    - `ax`: axes to draw into
    - `output`, `component`: as for `Ensemble.quantiles`
    - `confidence`: confidence level of the intervals of the marked quantiles

    Ensembles with the same distribution follow the dotted diagonal. Quantiles that are infinite in one of the
    ensembles, because of overturned scenes, are not drawn. Raises `ValueError` unless there are two
    ensembles, and as `Ensemble.quantiles` does.
    """
    assert ax is not None
    if not isinstance(ensembles, Mapping) or hasattr(ensembles, "data_vars") or len(ensembles) != 2:
        raise ValueError(
            "plots.quantile_quantile: ensembles must be a dict label → ensemble with two entries, got "
            f"{format_value(ensembles)}"
        )
    members = _members(ensembles)
    count = min(MAX_POINTS, *(y.size for y in members.values()))
    q = (np.arange(count) + 0.5) / count
    curve = np.stack([y.quantiles(output, q, component=component)["quantile"] for y in members.values()])
    is_drawn = np.isfinite(curve).all(axis=0)
    low, high = _limits(curve[:, is_drawn], output, members)
    ax.plot([low, high], [low, high], ":", color="0.5", lw=1, label="equal distributions")
    range_note = "" if is_drawn.all() else f" up to {is_drawn.mean():.0%}"
    ax.plot(*curve[:, is_drawn], color=COLOURS[2], ls="-", lw=1, label=f"quantiles{range_note}")
    marked_quantiles = [
        y.quantiles(output, MARKED_PROBABILITIES, component=component, confidence=confidence)
        for y in members.values()
    ]
    points, lower, upper = (
        np.stack([data[name] for data in marked_quantiles]) for name in ("quantile", "lower", "upper")
    )
    is_finite = np.isfinite(points).all(axis=0)
    points, lower, upper = (np.clip(y[:, is_finite], low, high) for y in (points, lower, upper))
    bars = np.stack([points - lower, upper - points], axis=1)
    ax.errorbar(
        *points,
        xerr=bars[0],
        yerr=bars[1],
        fmt="o",
        ms=4,
        lw=1,
        color=COLOURS[1],
        label=f"with {confidence:.0%} intervals",
    )
    for probability, x, y in zip(np.array(MARKED_PROBABILITIES)[is_finite], *points, strict=True):
        ax.annotate(f"{probability:.0%}", (x, y), (4, -11), textcoords="offset points", fontsize=8)
    (first, second), limits = members, (low, high)
    ax.set_title(_heading(members[first], output, component))
    ax.set(xlabel=first, ylabel=second, xlim=limits, ylim=limits, aspect="equal")
    ax.grid(alpha=0.3)
    ax.legend(loc="best")
    return ax


def _members(ensembles: Any) -> dict[str, Ensemble]:
    """Return ensembles by label; datasets become ensembles. Raises `ValueError` for other types."""
    require_instance("plots", "ensembles", ensembles, Mapping, "a rockjax.Ensemble or a dict of them")
    return {label: y if isinstance(y, Ensemble) else Ensemble(y) for label, y in ensembles.items()}


def _limits(values: np.ndarray, output: str, members: Mapping[str, Ensemble]) -> tuple[float, float]:
    """Return the limits of the axis: from 0 to the overturn ratio for rotations, otherwise the range of the
    finite values with some padding."""
    if output == "peak_rotation":
        return 0.0, max(float(y.data.attrs["overturn_ratio"]) for y in members.values())
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    padding = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return low - padding, high + padding


def _legend_entry(label: str, member: Ensemble) -> str:
    """Return the label of an ensemble with its numbers of scenes."""
    counts = member.counts
    parts = [f"{counts['scenes']} scenes", f"{100 * counts['overturned'] / counts['scenes']:.3g}% overturned"]
    words = {"undecided": "undecided", "unanswered": "did not finish"}
    parts += [f"{counts[name]} {text}" for name, text in words.items() if counts[name]]
    return f"{label}: {', '.join(parts)}".removeprefix(": ")


def _heading(member: Ensemble, output: str, component: int | None) -> str:
    """Return an axis label: name and unit of an output."""
    if output == "peak_rotation":
        return r"peak rotation $\max|\theta|\,/\,\alpha$"
    values = member.data[output]
    is_worst = values.ndim > 1 and component is None
    suffix = "" if values.ndim == 1 else ", worst" if is_worst else f", {values.dims[1]} {component}"
    return f"{values.attrs['long_name']}{suffix} [{displayed(values.attrs['units'])}]"
