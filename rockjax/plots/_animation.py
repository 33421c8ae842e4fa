"""Animation of the rocking podium, and its export to a file. Symbols are those of docs/model.md."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from rockjax._checks import require
from rockjax._files import write_atomically
from rockjax._responses.datasets import podium_of
from rockjax._responses.response import Response

from ._histories import TIME, as_history, vibrates
from ._style import COLOURS, ROTATION, in_style

if TYPE_CHECKING:
    import xarray


class _Animation(FuncAnimation):
    """An animation that Jupyter displays with playback controls."""

    def __init__(self, figure: Figure, *arguments: Any, **options: Any):
        self.figure = figure
        super().__init__(figure, *arguments, **options)

    def _repr_html_(self) -> str:
        plt.close(self.figure)  # otherwise Jupyter would also show the static figure
        return self.to_jshtml()


def animation(
    response: Response | xarray.Dataset,
    *,
    columns: int = 2,
    exaggerate: float = 1.0,
    speed: float = 1.0,
    fps: float = 25.0,
    start: float | None = None,
    end: float | None = None,
    moving_ground: bool = False,
) -> _Animation:
    """Animate the rocking podium, above a plot of its rotation history. By default the animation is in real
    time and to scale.

    - `response`: a [`rockjax.Response`][] or its dataset
    - `columns`: number of columns to draw, ≥ 1; it does not affect the response
    - `exaggerate`: factor on the drawn rotation, deformation and ground displacement, > 0 [–]; the picture
      states the factor
    - `speed`: seconds of the scene per second of the animation, > 0
    - `fps`: frames per second of the animation, > 0
    - `start`, `end`: part of the scene to show [s], by default the whole scene
    - `moving_ground`: whether to draw the horizontal displacement of the ground. It is ü_g integrated twice,
      from rest at the start of the history

    Columns of width 2B and height 2H rotate about their edges. The beam moves by u_b and v_b, Eq. (13). An
    elastic superstructure moves by its deformation u_t − u_b relative to the beam. Each floor of a building
    moves by the sum of the drifts of the stories below it. Of several modes without floors only the first is
    drawn. The drawn sizes of beam and superstructure are arbitrary, except for the heights of stories.

    Returns an animation that Jupyter displays. Raises `ValueError` for arguments out of range.
    """
    owner = "plots.animation"
    if not isinstance(columns, int) or columns < 1:
        raise ValueError(f"{owner}: columns must be a whole number ≥ 1, got {columns!r}")
    for name, value in (("exaggerate", exaggerate), ("speed", speed), ("fps", fps)):
        require(owner, name, value, lambda v: v > 0, "finite and > 0")
    data = as_history(response)
    t = data["time"].values
    start_time, end_time = (t[0] if start is None else start), (t[-1] if end is None else end)
    if not t[0] <= start_time < end_time <= t[-1]:
        raise ValueError(
            f"{owner}: start and end must satisfy {t[0]:g} <= start < end <= {t[-1]:g} s, the ends of the "
            f"history, got {start_time:g} and {end_time:g}"
        )
    times = np.arange(start_time, end_time + 1e-9, speed / fps)
    with in_style():
        stage = _Stage(data, times, columns, exaggerate, speed, moving_ground)
        return _Animation(stage.figure, stage.show, frames=times.size, interval=1000 / fps, blit=False)


def save_animation(
    path: str | Path, response: Response | xarray.Dataset, *, dpi: float = 100, **options
) -> Path:
    """Write the animation of [`rockjax.plots.animation`][] to a file, atomically. Returns the path.

    - `path`: file to write, `.gif` or `.mp4`; `.mp4` needs ffmpeg, from the system or the package
      `imageio-ffmpeg`
    - `response`: a [`rockjax.Response`][] or its dataset
    - `dpi`: resolution, in dots per inch
    - `options`: further arguments of [`rockjax.plots.animation`][]

    Raises `ValueError` for other suffixes and `RuntimeError` if ffmpeg is needed and missing.
    """
    path, fps = Path(path), options.get("fps", 25.0)
    if path.suffix not in (".gif", ".mp4"):
        raise ValueError(f"plots.save_animation: the name must end in .gif or .mp4, got {path.name!r}")
    program = _ffmpeg() if path.suffix == ".mp4" else ""
    podium_animation = animation(response, **options)
    try:
        with plt.rc_context({"animation.ffmpeg_path": program} if program else {}):
            writer = FFMpegWriter(fps=fps) if program else PillowWriter(fps=fps)
            return write_atomically(path, lambda name: podium_animation.save(name, writer=writer, dpi=dpi))
    finally:
        plt.close(podium_animation.figure)


def _ffmpeg() -> str:
    """Return the path of ffmpeg: from the system if installed there, otherwise from `imageio-ffmpeg`."""
    if FFMpegWriter.isAvailable():
        return FFMpegWriter.bin_path()
    try:
        return importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        raise RuntimeError(
            "plots.save_animation: .mp4 needs ffmpeg, which was not found; run `pip install imageio-ffmpeg`, "
            "or write a .gif"
        ) from None


def _ground_displacement(data: xarray.Dataset) -> np.ndarray:
    """Return the ground displacement at the times of a history [m], from rest at the start."""
    from scipy.integrate import cumulative_trapezoid

    t = data["time"].values
    velocity = cumulative_trapezoid(data["ground_acceleration"].values, t, initial=0)
    return cumulative_trapezoid(velocity, t, initial=0)


class _Stage:
    """Figure of an animation. The method `show` draws one frame."""

    def __init__(
        self, data: xarray.Dataset, times, columns: int, exaggerate: float, speed: float, moving_ground: bool
    ):
        attributes, t = data.attrs, data["time"].values
        self.times, self.alpha, self.R = times, attributes["alpha_rad"], attributes["R_m"]
        self.width, self.height = 2 * self.R * np.sin(self.alpha), 2 * self.R * np.cos(self.alpha)
        exaggerated = lambda values: exaggerate * np.interp(times, t, values)
        theta = data["theta"].values
        self.theta, self.floors = exaggerated(theta), _floors(data, self.height)
        self.floor_shifts = (
            np.stack([exaggerated(floor.shift) for floor in self.floors])
            if self.floors
            else np.zeros((0, times.size))
        )
        self.ground = exaggerated(_ground_displacement(data)) if moving_ground else np.zeros_like(times)
        self.ratio = np.interp(times, t, theta) / self.alpha
        spacing = max(0.9 * self.height, 2.5 * self.width)
        self.foot_positions = spacing * (np.arange(columns) - 0.5 * (columns - 1))
        self.half_beam = 0.5 * spacing * (columns - 1) + 0.8 * self.width
        self.beam_depth = 0.09 * self.height

        self.figure = plt.figure(figsize=(5.2, 5.6), layout="constrained")
        frame_axes, history_axes = self.figure.subplots(2, 1, height_ratios=(4, 1))
        self._build(frame_axes, attributes)
        notes = ["to scale" if exaggerate == 1 else f"motion × {exaggerate:g}"]
        notes += [] if speed == 1 else [f"{speed:g} × real time"]
        corner = {"transform": frame_axes.transAxes, "va": "top"}
        frame_axes.text(0.98, 0.98, "\n".join(notes), ha="right", color="0.35", **corner)
        self.clock = frame_axes.text(0.02, 0.98, "", **corner)
        history_axes.axhline(0, color="0.7", lw=0.6)
        history_axes.plot(t, theta / self.alpha, color=COLOURS[2], ls="-", lw=1.0)
        (self.cursor,) = history_axes.plot([], [], "o", color=COLOURS[1], ms=5)
        history_axes.set(xlabel=TIME, ylabel=ROTATION, xlim=(times[0], times[-1]))
        # Matplotlib computes the layout for the first frame; later frames keep it.
        self.show(0)
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")

    def _build(self, ax: Axes, attributes) -> None:
        """Add the polygons and lines of the structure, and set the limits of the axes."""

        def add_polygon(colour: str, **options) -> Polygon:
            polygon = Polygon(
                np.zeros((4, 2)), closed=True, facecolor=colour, lw=1.0, **{"edgecolor": COLOURS[0]} | options
            )
            ax.add_patch(polygon)
            return polygon

        self.columns = [add_polygon("0.82") for _ in self.foot_positions]
        self.beam = add_polygon("0.6")
        self.box = None  # a rigid superstructure
        if attributes["superstructure"] != "none" and not vibrates(attributes):
            self.box = add_polygon(COLOURS[2], alpha=0.75)
        self.slabs = [add_polygon(COLOURS[2], alpha=0.75) for _ in self.floors]
        self.column_lines = [
            [ax.plot([], [], color=COLOURS[0], ls="-", lw=2)[0] for _ in range(2)] for _ in self.floors
        ]
        beam_shift, lift = self._beam_displacement(np.arange(self.times.size))
        max_shift = float(
            np.max(np.abs(beam_shift + self.ground + np.vstack([0 * self.ground[None], self.floor_shifts])))
        )
        top_height = 0.45 * self.height if self.box is not None else 0.0
        if self.floors:
            top_height = self.floors[-1].level + self.floors[-1].depth
        highest = self.height + self.beam_depth + top_height + float(np.max(lift))
        soil = self.width * 0.6
        x = max(self.half_beam + max_shift + 0.1 * self.height, 0.55 * (highest + soil))
        # The soil ends outside the picture, even when the ground moves; hatching makes the motion visible.
        soil_end = x + float(np.max(np.abs(self.ground)))
        self.soil_corners = np.array([(-soil_end, 0), (soil_end, 0), (soil_end, -soil), (-soil_end, -soil)])
        self.soil = add_polygon("0.93", edgecolor="0.4", hatch="///")
        ax.set(xlim=(-x, x), ylim=(-soil, 1.12 * highest), aspect="equal", xlabel="[m]", ylabel="[m]")

    def _beam_displacement(self, k):
        """Return the displacement (u_b, v_b) of the beam relative to the ground at frames k [m], Eq. (13)."""
        theta = self.theta[k]
        psi = np.where(theta < 0, -1, 1) * self.alpha - theta
        lift = 2 * self.R * (np.cos(psi) - np.cos(self.alpha))
        return 2 * self.R * (np.where(theta < 0, -1, 1) * np.sin(self.alpha) - np.sin(psi)), lift

    def show(self, k: int) -> list:
        """Draw frame k and return the artists that moved."""
        theta, ground = self.theta[k], self.ground[k]
        u, v = (float(y) for y in self._beam_displacement(k))
        half, sign = 0.5 * self.width, -1 if theta < 0 else 1
        # Corners of an upright column, relative to the edge about which it rotates.
        upright = np.array([(-half, 0), (half, 0), (half, self.height), (-half, self.height)]) - (
            sign * half,
            0,
        )
        # A positive rotation is clockwise, about the right edge.
        rotation_matrix = np.array([(np.cos(theta), -np.sin(theta)), (np.sin(theta), np.cos(theta))])
        for foot, patch in zip(self.foot_positions, self.columns, strict=True):
            patch.set_xy(upright @ rotation_matrix + (foot + sign * half + ground, 0))
        base, beam_x = self.height + v, u + ground
        self.beam.set_xy(_box(beam_x, base, self.half_beam, self.beam_depth))
        base += self.beam_depth
        if self.box is not None:
            self.box.set_xy(_box(beam_x, base, 0.8 * self.half_beam, 0.45 * self.height))
        self._show_floors(k, beam_x, base)
        self.soil.set_xy(self.soil_corners + np.array([ground, 0]))
        self.clock.set_text(f"t = {self.times[k]:6.2f} s")
        self.cursor.set_data([self.times[k]], [self.ratio[k]])
        return [*self.columns, self.beam, self.soil, self.clock, self.cursor]

    def _show_floors(self, k: int, beam_x: float, base: float) -> None:
        """Draw, at frame k, the masses on the beam and the columns below them. The beam has its middle at
        `beam_x` and its top at `base` [m]."""
        z, lower_shift, foot = np.linspace(0, 1, 21), 0.0, 0.0
        for floor, shift, slab, column_lines in zip(
            self.floors, self.floor_shifts[:, k], self.slabs, self.column_lines, strict=True
        ):
            deflection = lower_shift + (shift - lower_shift) * (3 - 2 * z) * z**2
            for line, offset in zip(column_lines, (-0.75, 0.75), strict=True):
                line.set_data(
                    beam_x + offset * floor.width * self.half_beam + deflection,
                    base + foot + (floor.level - foot) * z,
                )
            slab.set_xy(_box(beam_x + shift, base + floor.level, floor.width * self.half_beam, floor.depth))
            lower_shift, foot = shift, floor.level + floor.depth


def _box(x: float, y: float, half_width: float, height: float) -> np.ndarray:
    """Return the corners of a rectangle from the middle of its lower edge."""
    left, right = x - half_width, x + half_width
    return np.array([(left, y), (right, y), (right, y + height), (left, y + height)])


class _Floor(NamedTuple):
    """A mass that moves relative to the beam, on two flexible columns."""

    shift: np.ndarray  # displacement relative to the beam at all times [m]
    level: float  # height of the lower edge above the beam [m]
    depth: float  # height of the drawn box [m]
    width: float  # width divided by the width of the beam [–]


def _floors(data: xarray.Dataset, height: float) -> list[_Floor]:
    """Return the masses that vibrate on the beam: floors of a building, a single mass, or the first mode.

    `height`: full height of a column [m]
    """
    if "drift" in data:
        shifts = data["drift"].values.cumsum(axis=1).T
        heights = getattr(podium_of(data.attrs).superstructure, "heights", None)
        story_heights = np.full(len(shifts), 0.6 * height) if heights is None else np.asarray(heights)
        depth = 0.15 * float(np.min(story_heights))
        levels = np.cumsum(story_heights) - depth
        return [_Floor(*pair, depth, 0.75) for pair in zip(shifts, map(float, levels), strict=True)]
    if not vibrates(data.attrs):
        return []
    deformation = data["deformation"].values
    shift = deformation if deformation.ndim == 1 else deformation[:, 0]
    return [_Floor(shift, 0.8 * height, 0.3 * height, 0.6)]
