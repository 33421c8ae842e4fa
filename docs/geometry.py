"""Draw docs/images/geometry.png, the geometry of a rocked podium: `python docs/geometry.py`."""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Arc, Polygon

from rockjax._files import write_figure
from rockjax.plots import COLOURS

B, H = 0.55, 1.15  # half a column, stockier than a real one so that angles can be seen
ALPHA, R = np.arctan2(B, H), np.hypot(B, H)
THETA = 0.45 * ALPHA
PSI = ALPHA - THETA
# Distance between pivots, thickness of the beam, height of the superstructure, size of its mass.
SPAN, BEAM, STOREY, TOP = 4.2, 0.34, 1.7, 0.5
SWAY = 0.42  # deformation of the superstructure
BLACK, VERMILION, BLUE, GREEN = COLOURS[:4]
GREY = "0.62"

u_b = 2 * R * (np.sin(ALPHA) - np.sin(PSI))
v_b = 2 * R * (np.cos(PSI) - np.cos(ALPHA))


def column(pivot: float, theta: float) -> np.ndarray:
    """Return the corners of a column that is turned clockwise about its lower right corner, at (pivot, 0)."""
    corners = np.array([[0, 0], [-2 * B, 0], [-2 * B, 2 * H], [0, 2 * H]])
    turn = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
    return corners @ turn.T + [pivot, 0]


def podium(ax, theta: float, across: float, up: float, sway: float, **style) -> None:
    for pivot in (0.0, SPAN):
        ax.add_patch(Polygon(column(pivot, theta), closed=True, **style))
    left, base = -2 * B - 0.25 + across, 2 * H + up
    width = SPAN + 2 * B + 0.5
    ax.add_patch(
        Polygon(
            [[left, base], [left + width, base], [left + width, base + BEAM], [left, base + BEAM]], **style
        )
    )
    middle = left + width / 2
    s = np.linspace(0, 1, 50)
    bend = sway * (1.5 * s**2 - 0.5 * s**3)
    ax.plot(
        middle + bend,
        base + BEAM + STOREY * s,
        color=style["edgecolor"],
        lw=style["lw"],
        ls=style["ls"],
        zorder=2,
    )
    x, y = middle + sway, base + BEAM + STOREY
    ax.add_patch(plt.Circle((x, y + TOP / 2), TOP / 2, **style))


def arrow(ax, start, end, label, at, colour=BLACK) -> None:
    ax.annotate(
        "",
        end,
        start,
        arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 0},
    )
    ax.text(*at, label, color=colour, ha="center", va="center", fontsize=13)


def angle(ax, centre, radius, first, last, label, colour, beyond=0.17) -> None:
    """Draw an arc between two directions, which are measured from the vertical to the left [rad]."""
    lo, hi = np.degrees([np.pi / 2 + first, np.pi / 2 + last])
    ax.add_patch(Arc(centre, 2 * radius, 2 * radius, theta1=lo, theta2=hi, color=colour, lw=1.6, zorder=4))
    middle = np.radians((lo + hi) / 2)
    at = np.add(centre, (radius + beyond) * np.array([np.cos(middle), np.sin(middle)]))
    ax.text(*at, label, color=colour, ha="center", va="center", fontsize=13, zorder=5)


def draw() -> plt.Figure:
    figure, ax = plt.subplots(figsize=(7.6, 6.1), layout="constrained")
    podium(ax, 0.0, 0.0, 0.0, 0.0, facecolor="none", edgecolor=GREY, lw=1.1, ls="--", zorder=1)
    podium(ax, THETA, u_b, v_b, SWAY, facecolor="0.93", edgecolor=BLACK, lw=1.6, ls="-", zorder=2)
    ax.plot([-2.3, SPAN + 1.9], [0, 0], color=BLACK, lw=2)
    ax.add_patch(
        Polygon(
            [[-2.3, 0], [SPAN + 1.9, 0], [SPAN + 1.9, -0.16], [-2.3, -0.16]],
            facecolor="none",
            hatch="////",
            lw=0,
        )
    )

    # Angles at the pivot of the right column, between its diagonal, its side and the vertical.
    pivot = np.array([SPAN, 0.0])
    corner = column(SPAN, THETA)[2]
    ax.plot(*np.stack([pivot, corner]).T, color=BLUE, lw=1.4, zorder=3)
    ax.plot(SPAN * np.ones(2), [0, 3.05], color=BLACK, lw=0.9, ls=":", zorder=3)
    ax.plot(*pivot, "o", color=BLACK, ms=5, zorder=5)
    ax.plot(*(pivot + corner) / 2, "+", color=BLUE, ms=11, mew=1.8, zorder=5)
    for share, beside in ((0.78, [0.16, 0.03]), (0.40, [-0.16, -0.03])):
        place = pivot + share * (corner - pivot) + beside
        ax.text(*place, "$R$", color=BLUE, fontsize=13, ha="center", va="center")
    angle(ax, pivot, 1.30, 0.0, PSI, r"$\psi$", VERMILION)
    angle(ax, pivot, 1.85, -THETA, 0.0, r"$\theta$", VERMILION)
    angle(ax, pivot, 0.72, -THETA, PSI, r"$\alpha$", GREEN)
    ax.text(SPAN + 0.12, -0.38, "pivot", ha="center", fontsize=11)

    # Dimensions of the left column.
    left = column(0.0, THETA)
    beside = 0.13 * np.array([-np.cos(THETA), np.sin(THETA)])
    arrows = {"arrowstyle": "<|-|>", "color": BLACK, "lw": 0.9, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", left[2] + beside, left[1] + beside, arrowprops=arrows)
    ax.text(*((left[1] + left[2]) / 2 + [-0.48, 0]), "$2H$", ha="center", va="center", fontsize=13)
    ax.text(*((left[0] + left[1]) / 2 + [0.14, 0.22]), "$2B$", ha="center", va="center", fontsize=13)

    # Displacements.
    edge, base = -2 * B - 0.25, 2 * H
    ax.plot([edge, edge], [base + BEAM, base + 1.05], color=GREY, lw=0.9)
    ax.plot([edge + u_b] * 2, [base + v_b + BEAM, base + 1.05], color=BLACK, lw=0.9)
    arrow(ax, (edge, base + 0.95), (edge + u_b, base + 0.95), "$u_b$", (edge + u_b / 2, base + 1.15))
    far = SPAN + 0.25
    ax.plot([far, far + 1.3], [base, base], color=GREY, lw=0.9)
    ax.plot([far + u_b, far + 1.3], [base + v_b, base + v_b], color=BLACK, lw=0.9)
    arrow(ax, (far + 1.15, base), (far + 1.15, base + v_b), "$v_b$", (far + 1.4, base + v_b / 2))
    centre = (SPAN - 2 * B) / 2
    height = base + BEAM + STOREY + TOP + 0.55
    ax.plot([centre] * 2, [base + BEAM + STOREY + TOP, height + 0.1], color=GREY, lw=0.9)
    ax.plot([centre + u_b + SWAY] * 2, [base + v_b + BEAM + STOREY + TOP, height + 0.1], color=BLACK, lw=0.9)
    arrow(
        ax,
        (centre, height),
        (centre + u_b + SWAY, height),
        "$u_t$",
        (centre + (u_b + SWAY) / 2, height + 0.2),
    )
    ax.text(
        centre + u_b + SWAY + 0.62,
        base + v_b + BEAM + STOREY + TOP / 2,
        "$m_t$",
        ha="center",
        va="center",
        fontsize=13,
    )
    ax.text(centre + u_b + 0.9, base + v_b + BEAM / 2, "$m_b$", ha="center", va="center", fontsize=13)
    ax.text(*(left.mean(axis=0) + 0.1), "$m_c,\\ I_c$", ha="center", va="center", fontsize=13)
    arrow(ax, (-2.2, -0.42), (-1.2, -0.42), r"$\ddot u_g$", (-1.0, -0.42))
    ax.set(xlim=(-2.4, SPAN + 2.1), ylim=(-0.6, height + 0.45), aspect="equal")
    ax.axis("off")
    return figure


if __name__ == "__main__":
    target = Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).parent / "images" / "geometry.png"
    print(write_figure(target, draw()))
