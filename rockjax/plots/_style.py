"""Style of the plots: colours, line styles and labels."""

from __future__ import annotations

import functools
import math
import re
import unicodedata
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import matplotlib.pyplot as plt
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, StrMethodFormatter

from rockjax._parameters.registry import find_entry

P = ParamSpec("P")
T = TypeVar("T")

ACCELERATION_RATIO = r"$a_p\,/\,(g\,\tan\alpha)$"
FREQUENCY_RATIO = r"$\omega_p\,/\,p$"
ROTATION = r"$\theta\,/\,\alpha$"
# Colours of Okabe & Ito, distinct for colour-blind readers; line styles distinguish curves in greyscale.
COLOURS = ("#000000", "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00")
STYLES = ("-", "--", "-.", ":")

OVERTURNED_COLOUR = "0.85"  # colour of cells that overturned


def symbol_for(parameter: str) -> str:
    """Return the symbol of a parameter for formulas in plots."""
    entry = find_entry(parameter)
    if entry is None:
        return parameter.rpartition(".")[2]
    # Letters with two dots, as in ü_g, become \ddot{u}.
    symbol = re.sub("(.)\N{COMBINING DIAERESIS}", r"\\ddot{\1}", unicodedata.normalize("NFD", entry.symbol))
    return symbol.replace("tan ", r"\tan ")


# Settings for `plt.style.context(plots.STYLE)` or `plt.style.use(plots.STYLE)`.
STYLE: dict[str, Any] = {
    "axes.prop_cycle": cycler(color=COLOURS[:4]) + cycler(linestyle=STYLES),
    "axes.axisbelow": True,
    "axes.linewidth": 0.8,
    "axes.titlesize": 10,
    "axes.labelsize": 10,
    "figure.titlesize": 11,
    "font.size": 9,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.6,
    "image.cmap": "viridis_r",
    "legend.fontsize": 8,
    "legend.title_fontsize": 8,
    "legend.framealpha": 0.85,
    "lines.linewidth": 1.3,
    "savefig.dpi": 150,
}


def in_style():
    """Return a context manager that applies `STYLE`.

    The backend of Matplotlib is loaded first. Loading it may switch on the interactive mode, in which
    notebooks show figures. If the backend were loaded inside the context, the end of the context would switch
    this mode off again.
    """
    plt.draw_if_interactive()
    return plt.style.context(STYLE)


def styled(draw: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function that makes a figure, so that the figure has the style `STYLE` and the user's
    settings are unchanged."""

    @functools.wraps(draw)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> T:
        with in_style():
            return draw(*args, **kwargs)

    return wrapper


def on_axes(draw: Callable[P, Axes]) -> Callable[P, Axes]:
    """Decorate a function (data, ax=None, …), so that it makes new axes with the style `STYLE` if `ax` is
    None."""

    @functools.wraps(draw)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> Axes:
        if (args[1] if len(args) > 1 else kwargs.get("ax")) is not None:
            return draw(*args, **kwargs)
        with in_style():
            ax = plt.figure(layout="constrained").add_subplot()
            return draw(*args[:1], **{**kwargs, "ax": ax})  # pyright: ignore[reportCallIssue]

    return wrapper


def curve_style(k: int) -> dict[str, Any]:
    """Return colour and line style of the k-th curve."""
    return {"color": COLOURS[k % len(COLOURS)], "linestyle": STYLES[k % len(STYLES)]}


def label_log_x(ax: Axes) -> None:
    """Label a logarithmic x axis with plain numbers 1, 2, 5, 10, ….

    An axis shorter than a decade also has the label 3. An axis of more than 2.5 decades keeps its labels.
    Call this function after setting the limits.
    """
    low, high = ax.get_xlim()
    decades = math.log10(high / low)
    if decades > 2.5:
        return
    ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5) if decades < 1 else (1, 2, 5)))
    ax.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    ax.xaxis.set_minor_formatter("")
