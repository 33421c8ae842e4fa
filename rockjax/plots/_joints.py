"""Plots of the forces in the joints: over time for one scene, and against frequency and amplitude for the
pulses of a spectrum.

The plots show whether joints stay closed and do not slide, as the model assumes. Symbols are those of
docs/model.md and docs/forces.md.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import CenteredNorm
from matplotlib.figure import Figure

from rockjax._responses.datasets import podium_of
from rockjax._responses.response import Response, with_joints

from ._histories import TIME, as_history, time_limits
from ._outcomes import hatch_unfinished, survives
from ._spectra import draw_panels, plane_of
from ._style import ACCELERATION_RATIO, COLOURS, FREQUENCY_RATIO, OVERTURNED_COLOUR, on_axes, styled

if TYPE_CHECKING:
    import xarray

OPEN_COLOUR = "#F7D9CC"  # background of times at which a joint would be open, N < 0
LEVELS = (-1.0, -0.8, -0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8, 1.0)  # N divided by the dead load
_LINES = {"bottom": "-", "top": "--"}  # joint → line style
# If a joint opens, the friction axis is not extended for demands above this multiple of max(tan α, μ).
_MAX_AXIS = 4.0


def _history_with_joints(response: Response | xarray.Dataset) -> xarray.Dataset:
    """Return the dataset of a response, with the forces in the joints. Joints without dead load, such as the
    top joint of a solitary block, are left out. Raises `ValueError` for a dataset without forces in the
    joints."""
    data = as_history(response)
    if "joint_axial_force" not in data:
        if not isinstance(response, Response):
            raise ValueError(
                "plots: the dataset has no forces in the joints; simulate with an output such as "
                "Options(outputs=('axial_force',)), or pass the rockjax.Response"
            )
        data = with_joints(data, response)
    data = data.assign_coords(dead_load=("joint", np.asarray(podium_of(data.attrs).dead_load)))
    return data.isel(joint=data["dead_load"].values > 0)


@on_axes
def joint_forces(response: Response | xarray.Dataset, ax: Axes | None = None) -> Axes:
    """Plot the axial forces N/(m_c g) of both end columns over time, with the mass m_c of a column. Lines
    mark the dead load: the axial force at rest, averaged over the columns.

    The forces of the other columns lie between the forces of the end columns. For a podium without an
    elevation, only the forces averaged over the columns (the “mean column”) are known and drawn. Times at
    which a joint would be open, N < 0, are shaded. The model does not hold after the first such time.

    - `response`: a [`rockjax.Response`][], or its dataset if an output of the joints was requested
    - `ax`: axes to draw into

    Raises `ValueError` for a dataset without forces in the joints.
    """
    assert ax is not None
    data = _history_with_joints(response)
    t, forces, loads = (data[name].values for name in ("time", "joint_axial_force", "dead_load"))
    joints = list(map(str, data["joint"].values))
    ax.axhline(0, color="0.3", lw=0.8, zorder=1)
    for (name, column), colour in zip(_end_columns(data).items(), (COLOURS[2], COLOURS[1]), strict=False):
        for k, joint in enumerate(joints):
            label = None if k else name
            ax.plot(t, forces[:, column, k], color=colour, ls=_LINES[joint], lw=1.0, label=label)
    for load, joint in zip(loads, joints, strict=True):
        label = "dead load" if joint == joints[0] else None
        ax.axhline(load, color="0.55", ls=_LINES[joint], lw=0.9, zorder=1, label=label)
    if len(joints) > 1:
        ax.plot([], [], color="0.55", ls=_LINES["top"], lw=1.0, label="at the top joint")
    _mark_least(data, ax)
    _shade_open_joints(data, ax)
    ax.set(xlabel=TIME, ylabel=r"axial force $N\,/\,(m_c g)$", xlim=time_limits(data))
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + 0.45 * (high - low))  # room for the legend
    ax.legend(loc="upper right", ncols=3, fontsize="small", framealpha=1.0)
    return ax


def _end_columns(data: xarray.Dataset) -> dict[str, int]:
    """Return the indices of the end columns by name; without an elevation, the index of the mean column."""
    elevation = podium_of(data.attrs).elevation
    if elevation is None:
        return {"mean column": 0}
    positions = np.asarray(elevation.offsets)
    return {"left column": int(np.argmin(positions)), "right column": int(np.argmax(positions))}


def _mark_least(data: xarray.Dataset, ax: Axes) -> None:
    """Mark the sample with the least ratio of axial force to dead load. The label gives the exact least ratio
    if the output `"axial_force"` was requested, otherwise the ratio of the sample."""
    forces, loads = data["joint_axial_force"].values, data["dead_load"].values
    ratios = np.where(np.isnan(forces), np.inf, forces) / loads
    k, column, joint = np.unravel_index(np.argmin(ratios), ratios.shape)
    least_forces = data["least_axial_force"].values if "least_axial_force" in data else forces[k, column]
    label = f"least, {np.min(least_forces / loads):.2f} of the dead load".replace("-", "−")
    ax.plot(data["time"].values[k], forces[k, column, joint], "o", mfc="none", color=COLOURS[0], label=label)


def _shade_open_joints(data: xarray.Dataset, ax: Axes) -> None:
    """Shade the times at which a joint would be open."""
    t = data["time"].values
    is_open = np.any(data["joint_axial_force"].values < 0, axis=(1, 2))
    if not is_open.any():
        return
    ends = np.concatenate([t[:1], 0.5 * (t[1:] + t[:-1]), t[-1:]])  # half-way between samples
    changes = np.flatnonzero(np.diff(is_open, prepend=False, append=False)).reshape(-1, 2)
    spans = [(float(ends[i]), float(ends[j] - ends[i])) for i, j in changes]
    transform = ax.get_xaxis_transform()
    ax.broken_barh(
        spans, (0, 1), transform=transform, facecolor=OPEN_COLOUR, lw=0, zorder=0, label="a joint is open"
    )


@on_axes
def friction_demand(
    response: Response | xarray.Dataset, ax: Axes | None = None, friction: float | None = None
) -> Axes:
    """Plot the friction demand |T|/N of the worst column over time at both joints, and |J_T|/J_N at impacts.
    T and N are the shear and the axial force of a joint; J_T and J_N are their impulses at an impact.

    A dotted line marks tan α. The demand of frames with a heavy beam rarely exceeds tan α. Times at which
    a joint would be open are shaded. Near these times the demand grows without bound and leaves the axes.

    - `response`: a [`rockjax.Response`][], or its dataset if an output of the joints was requested
    - `ax`: axes to draw into
    - `friction`: friction coefficient μ of the joints [–], drawn as a line

    Raises `ValueError` for a dataset without forces in the joints.
    """
    assert ax is not None
    data = _history_with_joints(response)
    t, limits = data["time"].values, [math.tan(data.attrs["alpha_rad"])]
    demand = data["joint_friction"].max("column", skipna=False)
    for k, joint in enumerate(map(str, demand["joint"].values)):
        values = demand.sel(joint=joint).values
        finite = np.where(np.isfinite(values), values, np.nan)
        ax.plot(t, finite, color=COLOURS[2 - k], ls=_LINES[joint], lw=1.0, label=f"{joint} joint")
    ax.axhline(limits[0], color="0.4", ls=":", lw=1.2, label=rf"$\tan\alpha = {limits[0]:.3g}$")
    if friction is not None:
        limits.append(friction)
        ax.axhline(friction, color=COLOURS[3], ls="-.", lw=1.2, label=rf"$\mu = {friction:g}$")
    impacts = data["impact_friction"].max(["column", "joint"]).values
    is_closed = np.isfinite(impacts)
    times = data["impact_times"].values
    if is_closed.any():
        ax.plot(
            times[is_closed],
            impacts[is_closed],
            ".",
            color=COLOURS[0],
            ms=4,
            label=r"impacts, $|J_T|\,/\,J_N$",
        )
    if not is_closed.all():
        at_top = {"transform": ax.get_xaxis_transform(), "clip_on": False}
        opening_times, ones = times[~is_closed], np.ones(np.sum(~is_closed))
        ax.plot(opening_times, ones, "v", color=COLOURS[0], ms=5, label="impact that opens a joint", **at_top)
    _shade_open_joints(data, ax)
    highest = max(ax.dataLim.y1, *limits, 0.0)
    if not np.all(demand.values < np.inf):
        highest = min(highest, _MAX_AXIS * max(limits))
    ax.set(xlabel=TIME, ylabel=r"friction demand $|T|\,/\,N$", xlim=time_limits(data))
    ax.set_ylim(0, 1.45 * highest)  # room for the legend
    ax.legend(loc="upper right", ncols=3, fontsize="small", framealpha=1.0)
    return ax


@on_axes
def lift_off_spectrum(dataset: xarray.Dataset, ax: Axes | None = None, levels=LEVELS) -> Axes:
    """Plot the least axial force divided by the dead load, against ω_p/p and a_p/(g tan α). Of the bottom and
    the top joint, the smaller ratio is drawn.

    At the black line the least axial force is 0. Beyond this line the beam would lift off a column, or
    a column would lift off the ground, and the model does not hold. Cells of pulses that overturn the columns
    are grey, and cells of scenes that did not finish are hatched.

    - `dataset`: rocking spectrum of one podium with the output `"axial_force"`
    - `ax`: axes to draw into
    - `levels`: limits of the colours

    Raises `ValueError` for a spectrum without axial forces, or with a single frequency or acceleration.
    """
    assert ax is not None
    if "least_axial_force" not in dataset:
        raise ValueError(
            "lift_off_spectrum: the dataset has no axial forces; compute it with "
            "rockjax.rocking_spectrum(…, options=Options(outputs=('peak_rotation', 'axial_force')))"
        )
    loads = dataset["dead_load"].where(dataset["dead_load"] > 0)
    ratios = (dataset["least_axial_force"] / loads).min("joint").where(survives(dataset))
    values = ratios.transpose("acceleration_ratio", "frequency_ratio").values
    x, y = plane_of("lift_off_spectrum", dataset)
    ax.set_facecolor(OVERTURNED_COLOUR)
    ax.contourf(x, y, values, levels=levels, cmap="RdBu", norm=CenteredNorm(halfrange=1.0), extend="both")
    hatch_unfinished(dataset, ax)
    if np.nanmin(values) < 0 < np.nanmax(values):
        ax.contour(x, y, values, levels=[0.0], colors="k", linewidths=1.0)
    ax.set(xlabel=FREQUENCY_RATIO, ylabel=ACCELERATION_RATIO, xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    return ax


@styled
def lift_off_spectra(panels: xarray.Dataset) -> Figure:
    """Plot least axial forces: one row per η/γ, one column per T_s.

    `panels` is a rocking spectrum with the output `"axial_force"` and the further dims `eta_over_gamma` and
    `T_s`.
    """
    positions = [value for name, value in panels.attrs.items() if name.startswith("position_")]
    title = f"{len(positions)} columns over {np.ptp(positions):g} m" if positions else ""
    bar = {"label": r"least axial force $N$ / dead load", "ticks": LEVELS}
    return draw_panels(panels, lift_off_spectrum, title, **bar)
