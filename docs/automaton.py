"""Draw docs/images/automaton.png, the hybrid automaton of the model: `python docs/automaton.py`."""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from rockjax._files import write_figure
from rockjax.plots import COLOURS

WIDTH, HEIGHT = 2.3, 0.8
STATES = {
    "Full contact": ((0.0, 0.0), r"$\sigma = 0$"),
    "Rocking": ((6.1, 0.0), r"$\sigma = \pm 1$"),
    "Settled": ((0.0, -2.5), "no wanted output can change"),
    "Overturned": ((6.1, -2.5), r"$|\theta| = $ overturn_ratio $\alpha$"),
}


def state(ax, name: str, colour: str) -> None:
    (x, y), about = STATES[name]
    corner = (x - WIDTH / 2, y - HEIGHT / 2)
    box = FancyBboxPatch(corner, WIDTH, HEIGHT, boxstyle="round,pad=0.05", fc="0.96", ec=colour, lw=1.6)
    ax.add_patch(box)
    ax.text(x, y + 0.16, name, ha="center", va="center", fontsize=12, weight="bold")
    ax.text(x, y - 0.2, about, ha="center", va="center", fontsize=9)


def transition(ax, start, end, label: str, at, curve: float = 0.0, **text) -> None:
    arrow = {
        "arrowstyle": "-|>",
        "mutation_scale": 14,
        "lw": 1.3,
        "shrinkA": 0,
        "shrinkB": 0,
        "color": "black",
    }
    ax.add_patch(FancyArrowPatch(start, end, connectionstyle=f"arc3,rad={curve}", **arrow))
    ax.text(*at, label, fontsize=9.5, **({"ha": "center", "va": "center"} | text))


def draw() -> plt.Figure:
    figure, ax = plt.subplots(figsize=(9.2, 4.6), layout="constrained")
    for name, colour in zip(STATES, COLOURS, strict=False):
        state(ax, name, colour)
    edge = WIDTH / 2 + 0.05
    transition(
        ax,
        (edge, 0.2),
        (6.1 - edge, 0.2),
        r"uplift: $|q|$ exceeds $q_{up}$, $\sigma = -\mathrm{sign}\,q$",
        (3.05, 0.42),
    )
    transition(
        ax,
        (6.1 - edge, -0.2),
        (edge, -0.2),
        "impact that leaves less\nthan the rest velocity, $|q| \\leq q_{up}$",
        (2.75, -0.62),
    )
    transition(
        ax,
        (5.5, 0.45),
        (6.7, 0.45),
        r"impact: $\dot\theta \to e\,\dot\theta$, then $\sigma \to -\sigma$",
        (6.1, 1.28),
        curve=-1.0,
    )
    transition(ax, (0, -0.45), (0, -2.05), "energy\ncertificate", (-0.15, -1.25), ha="right")
    transition(ax, (6.1, -0.45), (6.1, -2.05), "rotation reaches\nthe criterion", (6.25, -1.25), ha="left")
    transition(ax, (5.1, -0.45), (0.7, -2.05), "energy certificate", (3.4, -1.62))
    ax.set(xlim=(-1.9, 8.0), ylim=(-3.0, 1.5), aspect="equal")
    ax.axis("off")
    return figure


if __name__ == "__main__":
    target = Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).parent / "images" / "automaton.png"
    print(write_figure(target, draw()))
