"""Pictures of reports: conversion of figures to SVG, and the drawing of the structure to scale."""

from __future__ import annotations

import io
import itertools
import math
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import escape

from rockjax._structures.building import ShearBuilding
from rockjax._structures.elevation import SAME_LINE
from rockjax._structures.podium import Podium

from .tables import Quantity, plain_part
from .units import Units

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMN, BEAM = "#cfd8e3", "#e6e9ee"
# Colour in figures → variable of page.css, which has different values in the light and the dark theme.
VARIABLES = {
    "#d55e00": "--c-red",
    "#0072b2": "--c-blue",
    "#009e73": "--c-green",
    "#cc79a7": "--c-pink",
    "#e69f00": "--c-orange",
    "#f7d9cc": "--c-shade",
    "#ffffff": "--bg",
    COLUMN: "--col",
    BEAM: "--beam",
}
# Parts of matplotlib's SVG that `to_svg` removes or replaces.
_SVG_START = re.compile(r"^.*?<svg\b[^>]*viewBox=\"([^\"]*)\"[^>]*>", re.DOTALL)
_REMOVED_ELEMENTS = re.compile(
    r"\s*<metadata>.*?</metadata>|\s*<style\b.*?</style>|\s*<defs>\s*</defs>", re.DOTALL
)
_FONT_FAMILY = re.compile(r"font-family: [^;\"]*")
_ID_OR_REFERENCE = re.compile(r'(\bid="|url\(#|\bxlink:href="#)')
_COLOUR = re.compile(r"\b(fill|stroke): (#[0-9a-f]{6})(?:; \1-opacity: ([0-9.]+))?")
LARGEST_SCALE = 1.45  # pixels per point of the largest picture on a page, so that texts have a common size
_DECIMALS = {"m": 2, "cm": 1, "mm": 0}  # unit → decimals of dimensions in drawings
_MARKED_FLOORS = 12  # up to this number of floors, each floor is marked with its mass


def to_svg(figure: Figure, prefix: str, title: str, description: str) -> str:
    """Return a figure as SVG for a page, and close the figure.

    - `figure`: a matplotlib figure
    - `prefix`: start of all ids in the SVG, unique on the page. It has lower-case letters, digits and "-",
      and starts with a letter
    - `title`: short title; `description`: text for readers who cannot see the figure

    Texts are not converted to outlines. Black becomes the text colour of the page, a grey becomes this colour
    with an opacity, and a colour in `VARIABLES` becomes a variable of page.css. Other colours are lighter in
    the dark theme. Equal figures give equal strings. Raises `ValueError` for an invalid prefix.
    """
    import matplotlib.pyplot as plt

    if not re.fullmatch(r"[a-z][a-z0-9-]*", prefix):
        raise ValueError(
            f"to_svg: prefix must have lower-case letters, digits and '-', the first a letter; got {prefix!r}"
        )
    target = io.StringIO()
    try:
        with plt.rc_context({"svg.fonttype": "none", "svg.hashsalt": prefix}):
            figure.savefig(target, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    finally:
        plt.close(figure)
    content = target.getvalue()
    match = _SVG_START.match(content)
    assert match is not None
    content = _REMOVED_ELEMENTS.sub("", content[match.end() :])
    content = re.sub(r"<!--.*?-->\s*", "", content, flags=re.DOTALL)
    content = _ID_OR_REFERENCE.sub(rf"\1{prefix}-", content).replace("xlink:href", "href")
    content = _FONT_FAMILY.sub("font-family: var(--sans)", content)
    content = _COLOUR.sub(_apply_theme, content)
    content = re.sub(r'\bd="[^"]*"', _round_coordinates, content)
    width = LARGEST_SCALE * float(match[1].split()[2])
    head = (
        f'<svg role="img" aria-labelledby="{prefix}-title {prefix}-desc" viewBox="{match[1]}" '
        'xmlns="http://www.w3.org/2000/svg" fill="currentColor" '
        f'style="stroke-linejoin:round;stroke-linecap:butt;max-width:{width:.0f}px">'
        f'<title id="{prefix}-title">{escape(title)}</title>'
        f'<desc id="{prefix}-desc">{escape(description)}</desc>'
    )
    return head + content.strip()


def _apply_theme(match: re.Match[str]) -> str:
    """Replace a colour in `VARIABLES` by its variable, and a grey by the text colour of the page with an
    opacity. In the dark theme, any other colour is mixed with the text colour (`--own` of page.css)."""
    name, colour, opacity = match[1], match[2], float(match[3] or 1)
    red, green, blue = colour[1:3], colour[3:5], colour[5:]
    if colour in VARIABLES:
        colour = f"var({VARIABLES[colour]})"
    elif red == green == blue:
        colour, opacity = "currentColor", round(opacity * (1 - int(red, 16) / 255), 3)
    else:
        colour = f"color-mix(in srgb, {colour} var(--own), currentColor)"
    return f"{name}: {colour}" + (f"; {name}-opacity: {opacity:g}" if opacity != 1 else "")


def _round_coordinates(match: re.Match[str]) -> str:
    """Return the `d` attribute of an SVG path with coordinates rounded to 0.01 pt, on one line."""
    path = re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.2f}".rstrip("0").rstrip("."), match[0])
    return re.sub(r"\s*\n", " ", path)


def elevation_units(units: Units) -> str:
    """Return the sentence on the units of lengths in the drawing of `elevation_drawing`."""
    unit, column_unit = units.unit("length"), units.unit("displacement")
    return f"Lengths in {unit} (column at the right: in {column_unit})."


def elevation_drawing(
    podium: Podium,
    units: Units,
    *,
    column_mass: float | None = None,
    columns: int = 2,
    rotation: float | None = None,
    label: str = "",
    size: tuple[float, float] | None = None,
) -> Figure:
    """Return a drawing to scale: the structure with dimensions and masses, and beside it one rotated column.

    - `podium`: a single podium. The distances of the columns have dimension lines only if `podium.elevation`
      has their positions. The stories have dimension lines only if their heights are given
    - `units`: units of the numbers in the drawing
    - `column_mass`: mass of one column [kg]; None omits all masses
    - `columns`: number of columns N, used if `podium.elevation` is None
    - `rotation`: rotation of a column of `podium` [rad]. Its absolute value is drawn beside the structure;
      None draws an upright column
    - `label`: source of the rotation, such as "motion 9"; "" for none
    - `size`: width and height of a column [m], if they differ from those of `podium` because the ends of the
      column are round, (R5)
    """
    import matplotlib.pyplot as plt

    from rockjax.plots._style import in_style

    with in_style():
        figure = plt.figure(figsize=(7.4, 5.9), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(2, 1))
        for axes in (left, right):
            axes.set_axis_off()
        size = (float(podium.width), float(podium.height)) if size is None else size
        _draw_structure(left, podium, units, column_mass, columns, size)
        _draw_column(right, podium, units, rotation, label, size)
    return figure


def _draw_structure(
    ax: Axes,
    podium: Podium,
    units: Units,
    column_mass: float | None,
    columns: int,
    size: tuple[float, float],
) -> None:
    """Draw ground, columns, beam and floors, with dimensions at the left and below, and masses at the right.

    - `ax`: axes to draw into
    - `podium`, `units`, `column_mass`, `columns`, `size`: as for `elevation_drawing`
    """
    width, height = size
    positions, count, has_positions = _column_positions(podium, width, height, columns)
    depth = float(podium.elevation.beam_depth) if podium.elevation is not None else 0.0  # pyright: ignore
    has_beam = podium.superstructure is not None or float(podium.gamma) > 0  # a solitary block has no beam
    drawn_depth = (depth or 0.12 * height) if has_beam else 0.0
    left, right = positions[0] - 0.9 * width, positions[-1] + 0.9 * width
    levels, masses, has_heights = _floors(podium, height, count * (column_mass or 0.0))
    levels = height + drawn_depth + levels
    top = max([height + drawn_depth, *levels])
    gap = 0.035 * max(top, right - left)

    ax.plot([left - 3 * gap, right + 3 * gap], [0, 0], color="#000000", ls="-", lw=1.6)
    for x in np.arange(left - 3 * gap, right + 3 * gap, gap):
        ax.plot([x, x - 0.4 * gap], [0, -0.5 * gap], color="#000000", ls="-", lw=0.5)
    for x in positions:
        _draw_rectangle(ax, x - width / 2, 0, width, height, COLUMN)
    if has_beam:
        _draw_rectangle(ax, left, height, right - left, drawn_depth, BEAM)
    slab = 0.006 * top
    for below, level in itertools.pairwise([height + drawn_depth, *levels]):
        for x in positions:
            ax.plot([x, x], [below, level], color="#000000", ls="-", lw=0.8)
        _draw_rectangle(ax, left, level - slab, right - left, 2 * slab, BEAM)

    if column_mass is not None:
        mass_text = lambda mass: plain_part(Quantity(float(mass), "mass", is_input=True), units)
        _draw_text(ax, right + gap, height / 2, f"{count} × {mass_text(column_mass)}")
        if beam_mass := float(podium.gamma) * count * column_mass:
            _draw_text(ax, right + gap, height + drawn_depth / 2, mass_text(_rounded_mass(beam_mass)))
        floor_masses = [mass_text(_rounded_mass(mass)) for mass in masses]
        for level, text in _mass_notes(levels.tolist(), floor_masses):
            _draw_text(ax, right + gap, level, text)

    length_text = lambda value: _dimension_text(value, "length", units)
    heights = [(0.0, height, length_text(height))]
    if depth:
        heights.append((height, height + depth, length_text(depth)))
    if has_heights:
        heights += _story_dimensions(height + drawn_depth, levels, length_text)
    for start, end, text in heights:
        x = left - 1.6 * gap
        _draw_dimension(ax, (x, start), (x, end), text, is_short=end - start < 1.5 * gap)
    if has_heights and depth:
        _draw_dimension(ax, (left - 5.8 * gap, 0), (left - 5.8 * gap, top), length_text(top))
    if has_positions:
        for start, end in itertools.pairwise(positions):
            _draw_dimension(ax, (start, -2 * gap), (end, -2 * gap), length_text(end - start))
    ax.set(aspect="equal", xlim=(left - 7.2 * gap, right + 5.5 * gap), ylim=(-3.8 * gap, top + gap))


def _column_positions(
    podium: Podium, width: float, height: float, columns: int
) -> tuple[np.ndarray, int, bool]:
    """Return the different positions x of the columns [m], the number of columns, and whether the positions
    are known.

    Columns in one line across the plane have the same position. Unknown positions are chosen for the drawing.

    - `podium`: the structure; `width`, `height`: size of a column [m]
    - `columns`: number of columns, used if `podium.elevation` is None
    """
    if podium.elevation is None:
        spacing = max(0.9 * height, 2.5 * width)
        return spacing * (np.arange(columns) - 0.5 * (columns - 1)), columns, False
    positions = np.sort(np.asarray(podium.elevation.offsets, float))
    is_new = np.diff(positions, prepend=-np.inf) > SAME_LINE * np.ptp(positions)
    return positions[is_new], positions.size, True


def _floors(podium: Podium, height: float, total_column_mass: float) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return the heights of the floors above the beam [m], the masses of the floors [kg], and whether the
    heights are known.

    Unknown heights are chosen for the drawing. A superstructure that is not a `ShearBuilding` is drawn as one
    mass.

    - `podium`: the structure; `height`: height of a column [m]
    - `total_column_mass`: mass of all columns [kg]
    """
    superstructure = podium.superstructure
    if superstructure is None:
        return np.zeros(0), np.zeros(0), False
    if isinstance(superstructure, ShearBuilding):
        masses = np.asarray(superstructure.masses, float) * total_column_mass
        has_heights = superstructure.heights is not None
        story_heights = (
            np.asarray(superstructure.heights, float) if has_heights else np.full(masses.size, 0.6 * height)
        )
        return np.cumsum(story_heights), masses, has_heights
    level = 0.0
    if podium.elevation is not None:
        level = float(np.max(np.asarray(podium.elevation.top_height, float)))  # pyright: ignore
    mass = float(np.asarray(superstructure.mass_ratio)) * total_column_mass
    return np.array([level or 0.8 * height]), np.array([mass]), level > 0


def _rounded_mass(mass: float) -> float:
    """Return a mass without the rounding errors of its computation from ratios."""
    return float(f"{mass:.6g}")


def _mass_notes(levels: Sequence[float], masses: Sequence[str]) -> list[tuple[float, str]]:
    """Return the height [m] and the text of each note on masses. If there are more than `_MARKED_FLOORS`
    floors, adjacent floors of equal mass share a note."""
    if len(masses) <= _MARKED_FLOORS:
        return list(zip(levels, masses, strict=True))
    notes, start = [], 0
    for mass, run in itertools.groupby(masses):
        count = len(list(run))
        middle = 0.5 * (levels[start] + levels[start + count - 1])
        notes.append((middle, mass if count == 1 else f"{count} × {mass}"))
        start += count
    return notes


def _story_dimensions(
    base: float, levels: np.ndarray, length_text: Callable[[float], str]
) -> list[tuple[float, float, str]]:
    """Return (lower end [m], upper end [m], text) of the dimension lines of the stories. Adjacent stories of
    equal height share a line."""
    ends = [base, *map(float, levels)]
    heights = [length_text(upper - lower) for lower, upper in itertools.pairwise(ends)]
    dimensions, start = [], 0
    for height, run in itertools.groupby(heights):
        count = len(list(run))
        lower, upper = ends[start], ends[start + count]
        text = height if count == 1 else f"{count} × {height} = {length_text(upper - lower)}"
        dimensions.append((lower, upper, text))
        start += count
    return dimensions


def _draw_column(
    ax: Axes, podium: Podium, units: Units, rotation: float | None, label: str, size: tuple[float, float]
) -> None:
    """Draw a column at rest and rotated about its right bottom edge, with its dimensions. A column with round
    ends has rolled to the right; the arcs of its ends are not drawn.

    - `ax`: axes to draw into
    - `podium`, `units`, `rotation`, `label`, `size`: as for `elevation_drawing`
    """
    alpha, R = float(podium.alpha), float(podium.R)
    width, height = size
    enlargement = float(podium.height) / height
    # Rotations of the column with flat ends that `podium` has, and of the drawn column, (R5).
    model_angle = abs(rotation or 0.0)
    angle, radius = model_angle * enlargement, 0.5 * height * (1 - 1 / enlargement)
    gap = 0.07 * height
    length_text = lambda value: _dimension_text(value, "displacement", units)
    ax.plot([-gap, width + 2.5 * gap], [0, 0], color="#000000", ls="-", lw=1.6)
    upright = np.array([(0, 0), (width, 0), (width, height), (0, height)])
    pivot = np.array([width, radius])  # centre of the arc of a round end
    rotation_matrix = np.array([(math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))])
    corners = (upright - pivot) @ rotation_matrix + pivot + np.array([radius * angle, 0])
    if angle:
        from matplotlib.patches import Polygon

        ax.plot(*np.vstack([upright, upright[:1]]).T, color="#000000", ls="--", lw=0.8)
        ax.add_patch(Polygon(corners, closed=True, facecolor=COLUMN, edgecolor="#000000", lw=1.0, alpha=0.9))
        u_top = 2 * R * (math.sin(alpha) - math.sin(alpha - model_angle))
        rise = 2 * R * (math.cos(alpha - model_angle) - math.cos(alpha))
        _draw_dimension(ax, (0, height + rise + gap), (u_top, height + rise + gap), length_text(u_top))
        quantity_text = lambda value, kind: plain_part(Quantity(value, kind), units)
        unit = "α" if math.isclose(enlargement, 1) else "θ_o"  # angle at which the column overturns
        texts = [
            "column at its largest rotation",
            f"θ = {quantity_text(angle, 'angle')} = {quantity_text(model_angle / alpha, 'number')} {unit}",
            *([f"({label})"] if label else []),
            f"top displaced by {quantity_text(u_top, 'displacement')},",
            f"raised by {quantity_text(rise, 'displacement')};",
            "true to scale",
        ]
    else:
        _draw_rectangle(ax, 0, 0, width, height, COLUMN)
        texts = ["column at rest"]
    _draw_dimension(ax, (-gap, 0), (-gap, height), f"2H = {length_text(height)}")
    _draw_dimension(ax, (0, -gap), (width, -gap), f"2B = {length_text(width)}")
    # Labels are texts of the problem file, which may contain "$".
    ax.text(width / 2, -2.2 * gap, "\n".join(texts), ha="center", va="top", fontsize=9, parse_math=False)
    right = max(width + 4 * gap, corners[:, 0].max() + gap)
    ax.set(aspect="equal", xlim=(-4 * gap, right), ylim=(-8 * gap, height + 3 * gap))


def _dimension_text(value: float, kind: str, units: Units) -> str:
    """Return a length [m] as text, in the unit of the page for `kind`, with the decimals in `_DECIMALS`."""
    return f"{units.show(value, kind):.{_DECIMALS[units.unit(kind)]}f}"


def _draw_rectangle(ax: Axes, x: float, y: float, width: float, height: float, colour: str) -> None:
    from matplotlib.patches import Rectangle

    ax.add_patch(Rectangle((x, y), width, height, facecolor=colour, edgecolor="#000000", lw=0.8, zorder=2))


def _draw_text(ax: Axes, x: float, y: float, text: str) -> None:
    ax.text(x, y, text, ha="left", va="center", fontsize=9)


def _draw_dimension(
    ax: Axes, start: tuple[float, float], end: tuple[float, float], text: str, *, is_short: bool = False
) -> None:
    """Draw a dimension line with oblique ticks. The text is above a horizontal line, or to the left of a
    vertical one.

    - `ax`: axes to draw into; `start`, `end`: ends of the line (x, y) [m]; `text`: the text
    - `is_short`: whether a vertical line is shorter than its text. The text is then horizontal
    """
    (x0, y0), (x1, y1) = start, end
    is_vertical = x0 == x1
    ax.plot([x0, x1], [y0, y1], color="#000000", ls="-", lw=0.6, marker=(2, 2, -45), ms=7)
    ax.annotate(
        text,
        ((x0 + x1) / 2, (y0 + y1) / 2),
        (-5 if is_short else -2, 0) if is_vertical else (0, 2),
        textcoords="offset points",
        ha="right" if is_vertical else "center",
        va="center" if is_vertical else "bottom",
        rotation=90 if is_vertical and not is_short else 0,
        fontsize=9,
    )
