"""Plots of one scene: histories, phase portrait, moment against rotation, and the balance of energy.

Each function takes a [`rockjax.Response`][] or the dataset of a response, which `rockjax response` writes.
Symbols and Eq. (9) to (24) are in docs/model.md.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from rockjax._engine.coefficients import coefficients
from rockjax._engine.energy import potential, potential_slope, spin_with_inerters
from rockjax._responses.datasets import podium_of
from rockjax._responses.response import Response
from rockjax._structures import Podium, Rigid
from rockjax._units import MM_PER_M

from ._style import COLOURS, ROTATION, curve_style, on_axes

if TYPE_CHECKING:
    import xarray

TIME = "time [s]"
MAX_COLOURS = 6  # largest number of curves with distinct colours; more curves use a colour scale
MAX_LEGEND_ROWS = 10
# Contact mode (0 for full contact, otherwise the sign of θ) → name and colour. The colours range from light
# to dark, so that they also differ in greyscale.
_CONTACT_MODES = {
    0: ("full contact", "#E4E4E4"),
    -1: ("rocking left", "#F2B872"),
    1: ("rocking right", "#3B7FB0"),
}


def as_history(response: Response | xarray.Dataset) -> xarray.Dataset:
    """Return the dataset of a response. Raises `ValueError` for other data."""
    if isinstance(response, Response):
        return response.dataset()
    if getattr(response, "attrs", {}).get("kind") != "response":
        raise ValueError(
            "plots: expected a rockjax.Response or its dataset, with the attribute kind = 'response'"
        )
    return response


def time_limits(data: xarray.Dataset) -> tuple[float, float]:
    """Return the limits of the time axis [s].

    The axis ends after 1.2 times the time until the last impact, or at a later peak, uplift or overturning,
    but not after the history. Without impacts it ends with the history.
    """
    t, impacts = data["time"].values, data["impact_times"].values
    if not impacts.size:
        return t[0], t[-1]
    times = [y for name, y in data.data_vars.items() if str(name).endswith("_time")]
    events = np.concatenate([np.ravel(y.values) for y in times]).tolist()
    last_event = max(time for time in events if np.isfinite(time))
    return t[0], min(t[-1], max(last_event, t[0] + 1.2 * (impacts.max() - t[0])))


def vibrates(attributes: Mapping[str, Any]) -> bool:
    """Return whether the attributes of a dataset describe an elastic superstructure."""
    return attributes["superstructure"] != "none" and attributes.get("T_s_s", 0.0) > 0


@on_axes
def rotation_history(response: Response | xarray.Dataset, ax: Axes | None = None) -> Axes:
    """Plot θ/α over time with impacts, first uplift and peak. A strip along the time axis shows full contact
    and rocking to either side."""
    assert ax is not None
    data = as_history(response)
    t, ratio = data["time"].values, data["theta"].values / data.attrs["alpha_rad"]
    ax.axhline(0, color="0.7", lw=0.6, zorder=0)
    ax.plot(t, ratio, color=COLOURS[2], ls="-", lw=1.2)
    impacts = data["impact_times"].values
    if impacts.size:
        ax.plot(
            impacts, np.zeros_like(impacts), "|", color=COLOURS[1], ms=8, label=_impact_count_label(impacts)
        )
    if bool(data["uplifted"]):
        time = float(data["uplift_time"])
        ax.plot(
            time, np.interp(time, t, ratio), "^", color=COLOURS[3], ms=6, label=f"first uplift, {time:.3g} s"
        )
    _mark_peak(data, ax)
    _draw_contact_modes(t, data["mode"].values, ax)
    ax.set(xlabel=TIME, ylabel=ROTATION, xlim=time_limits(data))
    low, high = ax.get_ylim()
    ax.set_ylim(low - 0.08 * (high - low), high + 0.32 * (high - low))  # room for the strip and the legend
    if bool(data["overturned"]):
        ax.set_title(f"overturns at t = {float(data['overturn_time']):.3f} s")
    ax.legend(loc="upper right", ncols=3, fontsize="small")
    return ax


def _impact_count_label(impacts: np.ndarray) -> str:
    return "1 impact" if impacts.size == 1 else f"{impacts.size} impacts"


def _mark_peak(data: xarray.Dataset, ax: Axes) -> None:
    """Mark the peak rotation; a history without rotation has no mark."""
    peak, time = (
        float(data[name]) if name in data else 0.0 for name in ("peak_rotation", "peak_rotation_time")
    )
    if not peak > 0:
        return
    # The peak has the sign of the larger of the two neighbouring samples.
    neighbours = data["theta"].values[
        np.clip(np.searchsorted(data["time"].values, time) + np.array([-1, 0]), 0, data.sizes["time"] - 1)
    ]
    sign = np.sign(neighbours[np.argmax(np.abs(neighbours))])
    ax.plot(time, sign * peak, "o", mfc="none", color=COLOURS[0], label=rf"peak {peak:.3g} $\alpha$")


def _draw_contact_modes(t: np.ndarray, mode: np.ndarray, ax: Axes) -> None:
    """Draw a strip of full contact and rocking along the lower edge, with names in the legend."""
    starts = np.flatnonzero(np.append(True, mode[1:] != mode[:-1]))
    stops = np.append(starts[1:], t.size - 1)
    for contact_mode, (name, colour) in _CONTACT_MODES.items():
        spans = [(t[i], t[j] - t[i]) for i, j in zip(starts, stops, strict=True) if mode[i] == contact_mode]
        if spans:
            ax.broken_barh(
                spans, (0, 0.045), transform=ax.get_xaxis_transform(), facecolor=colour, lw=0, label=name
            )


@on_axes
def deformation_history(response: Response | xarray.Dataset, ax: Axes | None = None) -> Axes:
    """Plot the deformation u_t − u_b of the superstructure over time [mm]; for a superstructure with several
    modes, the deformation of each mode; for a building, the drift of each story. Without an elastic
    superstructure the deformation is 0."""
    assert ax is not None
    data = as_history(response)
    name = "drift" if "drift" in data else "deformation"
    if data[name].ndim > 1:
        title = "story" if name == "drift" else "mode"
        _draw_lines(data, data[name].values * MM_PER_M, title, f"{name} [mm]", ax)
        return ax
    return _draw_line(
        data, data["deformation"].values * MM_PER_M, "deformation\n$u_t - u_b$ [mm]", COLOURS[3], ax
    )


@on_axes
def ground_motion(response: Response | xarray.Dataset, ax: Axes | None = None) -> Axes:
    """Plot the horizontal and, if there is one, the vertical ground acceleration over time [g]."""
    assert ax is not None
    data, label = as_history(response), r"$\ddot u_g$ [g]"
    g = data.attrs["g_m_s2"]
    if "vertical_acceleration" in data:
        label = r"$\ddot u_g$, $\ddot v_g$ [g]"
        vertical = data["vertical_acceleration"].values / g
        ax.plot(data["time"].values, vertical, color=COLOURS[1], lw=0.9, label=r"vertical $\ddot v_g$")
        ax.plot([], [], color=COLOURS[0], ls="-", lw=1.2, label=r"horizontal $\ddot u_g$")
        ax.legend(loc="upper right", fontsize="small")
    return _draw_line(data, data["ground_acceleration"].values / g, label, COLOURS[0], ax)


def _draw_lines(data: xarray.Dataset, values: np.ndarray, title: str, label: str, ax: Axes) -> None:
    """Draw one line for each mode or story.

    - `data`: history
    - `values`: values to draw, shape (times, modes or stories)
    - `title`: title of the legend
    - `label`: label of the vertical axis
    - `ax`: axes to draw into

    With more than `MAX_COLOURS` lines, the colours range from dark for the first line to light for the last.
    """
    ax.axhline(0, color="0.7", lw=0.6, zorder=0)
    count = values.shape[1]
    for k, row in enumerate(values.T):
        style = (
            curve_style(k)
            if count <= MAX_COLOURS
            else curve_style(k) | {"color": plt.get_cmap("viridis")(0.9 * k / count)}
        )
        ax.plot(data["time"].values, row, label=f"{k + 1}", lw=1.0, **style)
    ax.set(xlabel=TIME, ylabel=label, xlim=time_limits(data))
    ax.legend(
        title=title,
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        ncols=math.ceil(count / MAX_LEGEND_ROWS),
        fontsize="small",
        handlelength=1.6,
    )


def _draw_line(data: xarray.Dataset, values: np.ndarray, label: str, colour: str, ax: Axes) -> Axes:
    """Draw values over time as one line in `ax`, and return `ax`."""
    t = data["time"].values
    ax.axhline(0, color="0.7", lw=0.6, zorder=0)
    ax.plot(t, values, color=colour, ls="-", lw=1.2)
    ax.set(xlabel=TIME, ylabel=label, xlim=time_limits(data))
    return ax


@on_axes
def phase_portrait(response: Response | xarray.Dataset, ax: Axes | None = None) -> Axes:
    """Plot θ̇/(pα) against θ/α: the motion with its jumps at impacts, saddle points and separatrices.

    At the saddle points, the columns are in unstable equilibrium. Without tendons, the saddle points are
    θ = ±α, Eq. (24). With tendons they are ±θ_s, with the stability angle θ_s (see docs/control.md). The
    separatrices pass through the saddle points. They are the motions with a rigid superstructure and without
    ground motion, impacts and dampers. Without tendons and inerters their equation is
    ½(1+λ+4γ+4η)R²θ̇² = P(α) − P(θ), from Eqs. (18) and (19). P is the potential energy divided by the mass
    N m_c of all columns.
    """
    assert ax is not None
    data = as_history(response)
    alpha, unit = data.attrs["alpha_rad"], data.attrs["alpha_rad"] * data.attrs["p_rad_s"]
    times, before, after = (
        data[name].values for name in ("impact_times", "theta_dot_before", "theta_dot_after")
    )
    # The curve ends at the rate before an impact and restarts at the rate after it.
    gap = np.full_like(times, np.nan)
    zero = np.zeros_like(times)
    t = np.concatenate([data["time"].values, times, times, times])
    order = np.argsort(t, kind="stable")
    x = np.concatenate([data["theta"].values / alpha, zero, gap, zero])[order]
    y = np.concatenate([data["theta_dot"].values, before, gap, after])[order] / unit

    saddle = float(podium_of(data.attrs).stability_angle) / alpha
    limit = 1.15 * max(min(saddle, 3.0), float(np.nanmax(np.abs(x))))
    ratio = np.linspace(-limit, limit, 801)
    rate = separatrix(data, ratio * alpha) / unit
    for sign in (1, -1):
        ax.plot(
            ratio,
            sign * rate,
            color="0.55",
            ls="--",
            lw=1.0,
            label="separatrix, rigid and undamped" if sign > 0 else None,
        )
    if saddle < limit:
        symbol = r"\alpha" if saddle == 1 else r"\theta_s"
        ax.plot(
            [-saddle, saddle], [0, 0], "X", color=COLOURS[0], ms=7, label=rf"saddle, $\theta = \pm{symbol}$"
        )
    ax.plot(x, y, color=COLOURS[2], ls="-", lw=1.1, label="response")
    if times.size:
        jumps = np.stack([before, after, gap]).T.ravel() / unit
        ax.plot(
            np.zeros_like(jumps), jumps, color=COLOURS[1], ls="-", lw=2.0, label=_impact_count_label(times)
        )
    ax.set(xlabel=ROTATION, ylabel=r"$\dot\theta\,/\,(p\alpha)$", xlim=(-limit, limit))
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + 0.16 * (high - low))  # room for the legend
    ax.grid(True, alpha=0.3)
    ax.legend(loc="upper center", ncols=2, fontsize="small")
    return ax


def separatrix(data: xarray.Dataset, theta: np.ndarray) -> np.ndarray:
    """Return |θ̇| [rad/s] on the separatrices of the rigid, undamped frame, also at rotations beyond the
    saddle points. Return 0 where the potential energy exceeds its value at the saddle points.

    - `data`: dataset of a response
    - `theta`: rotations θ, shape (n,) [rad]
    """
    podium = podium_of(data.attrs)
    if podium.vibrates:
        podium = podium.replace(superstructure=Rigid(podium.eta))
    c = coefficients(podium)
    potential_energy = potential(c, jnp.where(theta < 0, -1.0, 1.0), jnp.asarray(theta))
    potential_difference = potential(c, jnp.ones(()), jnp.asarray(saddle_rotation(podium))) - potential_energy
    spin = spin_with_inerters(c, jnp.ones(()), jnp.asarray(theta))
    return np.sqrt(np.maximum(2 * np.asarray(potential_difference / spin), 0.0))


def saddle_rotation(podium: Podium) -> float:
    """Return |θ| at the saddle points [rad]: `Podium.stability_angle`, but at most π/2. The stability angle
    is α without tendons, and inf if tendons restore the columns at every rotation."""
    return min(float(podium.stability_angle), 0.5 * np.pi)


@on_axes
def moment_rotation(response: Response | xarray.Dataset, ax: Axes | None = None) -> Axes:
    """Plot the restoring moment (`Response.restoring_moment`), divided by its value at uplift, against θ/α.

    In full contact (θ = 0) the ratio is −q/q_up ∈ [−1, 1], with the demand q and its threshold q_up, Eq. (9).
    While rocking, the restoring moment is the sum of three moments about the edges: the moments of the
    weights, of the vertical inertia forces with the acceleration of Eq. (15), and of tendons, dampers and
    inerters, Eq. (C22) of docs/equations.md. Divided by the restoring moment at uplift, the moment of the
    weights is sin ψ/sin α with ψ = α − θ for θ > 0, if no tendon is prestressed: 1 at θ = 0, and 0 at θ = α.
    The thick line is the static moment of weights and tendons.
    """
    assert ax is not None
    data = as_history(response)
    alpha = data.attrs["alpha_rad"]
    ratio, moment = data["theta"].values / alpha, data["restoring_moment"].values
    limit = max(1.0, float(np.nanmax(np.abs(ratio))))
    theta = np.linspace(0, limit, 201) * alpha
    podium = podium_of(data.attrs)
    moments, label = np.sin(alpha - theta) / np.sin(alpha), r"weights alone, $\sin\psi\,/\,\sin\alpha$"
    if podium.restrainers:
        slope = np.asarray(
            jax.vmap(functools.partial(potential_slope, coefficients(podium)))(jnp.asarray(theta))
        )
        moments, label = slope / slope[0], "weights and tendons at rest"
    static_curve = np.concatenate([-theta[::-1], theta]) / alpha, np.concatenate([-moments[::-1], moments])
    ax.axhline(0, color="0.7", lw=0.6, zorder=0)
    ax.axvline(0, color="0.7", lw=0.6, zorder=0)
    ax.plot(*static_curve, color="0.7", ls="-", lw=4, label=label)
    ax.plot(ratio, moment, color=COLOURS[2], ls="-", lw=0.9, label="response")
    ax.set(
        xlabel=ROTATION,
        ylabel=r"restoring moment $M_r\,/\,M_r(\mathrm{uplift})$",
        xlim=(-1.05 * limit, 1.05 * limit),
    )
    ax.grid(True, alpha=0.3)
    ax.legend(loc="upper left")
    return ax


@on_axes
def energy_balance(response: Response | xarray.Dataset, ax: Axes | None = None) -> Axes:
    """Plot the energies of `Response.energies` over time.

    The energies are divided by P(α), the potential energy of the weights at θ = α. Without tendons, this
    energy is needed to overturn the columns from rest.

    The work of the ground equals the change of the mechanical energy plus the energy lost at impacts and in
    dampers, plus a residual. The residual measures the error of the history.
    """
    assert ax is not None
    data = as_history(response)
    attributes = data.attrs
    weight = (attributes.get("eta", 0.0) + attributes["gamma"] + 0.5) * attributes["g_m_s2"]
    unit = 2 * attributes["R_m"] * weight * (1 - np.cos(attributes["alpha_rad"]))
    names = ("input_energy", "mechanical_energy", "impact_energy", "damping_energy")
    work, mechanical, impact_loss, structure_loss = (data[name].values / unit for name in names)
    damper_loss = data["damper_energy"].values / unit if "damper_energy" in data else np.zeros_like(work)
    residual = (
        float(data["initial_energy"]) / unit + work - mechanical - impact_loss - structure_loss - damper_loss
    )
    t = data["time"].values
    curves = [
        ("work of the ground", work),
        ("mechanical energy", mechanical),
        ("lost at impacts", impact_loss),
    ]
    curves += [("lost in the superstructure's damper", structure_loss)] if vibrates(attributes) else []
    curves += [("lost in the columns' dampers", damper_loss)] if damper_loss.any() else []
    for k, (label, values) in enumerate(curves):
        ax.plot(t, values, label=label, lw=1.6 if k == 0 else 1.2, **curve_style(k))
    largest = float(np.nanmax(np.abs(residual)))
    ax.plot(
        t,
        residual,
        color="0.5",
        lw=0.8,
        ls="-",
        label=f"residual, at most {largest:.0e}" if largest else "residual, 0",
    )
    ax.set(xlabel=TIME, ylabel=r"energy / $P(\alpha)$", xlim=time_limits(data))
    ax.grid(True, alpha=0.3)
    ax.legend(loc="best")
    return ax
