"""Interactive study: sliders for parameters of a structure and its ground motion, and the response.

The values of all sliders are arguments of one compiled function, so that moving a slider compiles nothing.
"""

from __future__ import annotations

import dataclasses
import functools
import io
import math
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

import rockjax as rj
from rockjax._options import DEFAULT_OUTPUTS
from rockjax._parameters.registry import STRUCTURE, motion_parameter
from rockjax._responses.arguments import check_overturn_ratio
from rockjax._responses.peak import AbstractPeak
from rockjax._units import MM_PER_M
from rockjax.internal import (
    DIMENSIONS,
    AnyMotion,
    Module,
    as_excitation,
    displayed,
    format_value,
    require_instance,
)

from ._variables import (
    Structure,
    as_bounds,
    as_podium,
    make_variables,
    numbers_as_arrays,
    parameter,
    value_of,
    with_variables,
)

if TYPE_CHECKING:
    import ipywidgets
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

OUTPUTS = (*DEFAULT_OUTPUTS, "margin")
POINTS = 1001  # points of each curve
# Time drawn after the end of the motion, multiplied by the frequency parameter `Podium.p` [–].
TIME_AFTER = 12.0
_WIDTH, _ROW_HEIGHT, _DPI = 8.0, 2.0, 80  # width and row height of the picture [in], dots per inch
PIXEL_RATIO = 2  # width of the PNG divided by its width on the page, for high-resolution screens
SLIDER_POSITIONS = 500  # largest number of steps of a slider before refinement
# Largest number of times that a step is divided by 10, so that the slider can show the initial value.
MAX_REFINEMENTS = 3


class Explorer:
    """Sliders for a structure and its ground motion, and the response.

    - `widget`: widget that a notebook shows; `sliders`: name → `ipywidgets.FloatSlider`
    - `values`: name → value in the unit of the parameter. Until its slider moves, a value is exactly the
      initial value, even if the slider shows a rounded value
    - `structure`: structure for these values, a `Podium` or `Dimensions` like the given one; `podium`: the
      same structure as a `Podium`
    - `excitation`: ground motion for these values; `peak`: peak response of the structure to this motion
    - `picture`: picture of the response as PNG, twice as wide in pixels as on the page

    If the values together define no valid structure, an error message replaces the table of peaks, and `peak`
    and `picture` do not change. `structure` and `podium` then raise a `ValueError` with this message. If the
    structure is valid, but `options.overturn_ratio` is too large for it, only the table shows the message.
    """

    def __init__(self, structure, excitation, vary: Mapping[str, tuple[float, float]], options: rj.Options):
        import ipywidgets

        self._study = _Study(numbers_as_arrays(structure), excitation, tuple(vary))
        self._options = jax.tree.map(lambda y: jnp.asarray(y, float), options)
        initial_pairs = {name: self._study.initial_value_and_unit(name) for name in vary}
        self._initial_values = {name: value for name, (value, _) in initial_pairs.items()}
        self._values = dict(self._initial_values)
        self._grids = {
            name: _Grid.containing(*bounds, self._initial_values[name]) for name, bounds in vary.items()
        }
        self.sliders = {name: _slider(name, self._grids[name], *initial_pairs[name]) for name in vary}
        self._text = ipywidgets.HTML()
        self._image = ipywidgets.Image(format="png", layout={"width": "100%", "object_fit": "contain"})
        left = ipywidgets.VBox(
            [*self.sliders.values(), self._text], layout={"flex": "0 0 25em", "overflow": "hidden"}
        )
        right = ipywidgets.Box(
            [self._image],
            layout={"flex": "1 1 0", "overflow": "hidden", "max_width": f"{_WIDTH * _DPI:.0f}px"},
        )
        self.widget = ipywidgets.HBox([left, right], layout={"align_items": "flex-start"})
        self._initial_simulation = self._solve()
        self._drawing = _Drawing(self._initial_simulation, self._study.structure)
        self._update()
        for name, slider in self.sliders.items():
            slider.observe(functools.partial(self._on_slider, name), "value")

    @property
    def values(self) -> dict[str, float]:
        return dict(self._values)

    @property
    def structure(self) -> Structure:
        return self._study.at(self._slider_values())[0]

    @property
    def podium(self) -> rj.Podium:
        return as_podium(self.structure)

    @property
    def excitation(self) -> rj.AbstractExcitation:
        return self._study.at(self._slider_values())[1]

    @property
    def peak(self) -> rj.Peak:
        return self._present_simulation.peak

    @property
    def picture(self) -> bytes:
        return self._image.value

    def _slider_values(self) -> np.ndarray:
        """Return the values of all sliders (n,)."""
        return np.array(list(self._values.values()))

    def _solve(self) -> _Simulation:
        return jax.tree.map(np.asarray, _simulate(self._study, self._slider_values(), self._options))

    def _on_slider(self, name: str, change: Mapping[str, Any]) -> None:
        """Store the value of a slider that has moved, and update table and picture."""
        value = self._grids[name].read(change["new"], self._initial_values[name])
        if value != self._values[name]:
            self._values[name] = value
            self._update()

    def _update(self) -> None:
        try:
            check_overturn_ratio("explore", self.podium, self._options)
        except ValueError as error:
            self._text.value = f"<p>{escape(str(error))}</p>"
            return
        self._present_simulation = self._solve()
        self._text.value = _peak_table(self._initial_simulation.peak, self._present_simulation.peak)
        self._image.value = self._drawing(self._present_simulation)

    def _repr_mimebundle_(self, **kwargs) -> Any:
        return self.widget._repr_mimebundle_(**kwargs)


def explore(
    structure: Structure,
    excitation: AnyMotion,
    vary: Mapping[str, tuple[float, float]],
    *,
    options: rj.Options = rj.Options(),
) -> Explorer:
    """Explore a structure and its response with sliders in a notebook; needs ipywidgets (extra `notebook`).

    - `structure`: a `rockjax.Podium` or an `optimise.Dimensions`; `excitation`: any motion. Parameters that
      are not varied keep their values
    - `vary`: name → (lowest, highest) in the unit of the parameter. A name denotes a parameter of the
      structure, as in [`optimise.design`][], or a scalar field of the motion, such as `a_p` and `T_p` of a
      pulse or `scale` of a record. If structure and motion share a name, the name denotes the parameter of
      the structure
    - `options`: options of the simulations; their `outputs` and `throw` are ignored

    The picture shows the initial response in grey and the present one in colour. Only the first picture
    compiles a program. Raises `ValueError` for other structures, motions and options, for unknown names, and
    for ranges that are invalid or do not contain the initial value.
    """
    if not isinstance(structure, Structure):
        raise ValueError(
            "explore: structure must be a rockjax.Podium or an optimise.Dimensions, got "
            f"{format_value(structure)}"
        )
    require_instance("explore", "options", options, rj.Options, "rockjax.Options")
    excitation = as_excitation("explore", excitation)
    if not isinstance(vary, Mapping) or not vary:
        raise ValueError(
            'explore: vary must name at least one parameter with its bounds, e.g. {"T_p": (0.5, 1.5)}'
        )
    motion_names = _motion_names(structure, excitation, tuple(vary))
    structure_bounds = {name: bounds for name, bounds in vary.items() if name not in motion_names}
    if structure_bounds:
        make_variables(structure, structure_bounds, "explore")  # raises for unknown names and invalid bounds
    study = _Study(structure, excitation, tuple(vary))
    for name, pair in vary.items():
        low, high = as_bounds("explore", name, pair)
        value, _ = study.initial_value_and_unit(name)
        if not low <= value <= high or not low < high:
            raise ValueError(
                f"explore: vary[{name!r}] must be a range that contains the present value {value:g}, got "
                f"({low:g}, {high:g})"
            )
        for bound in (low, high) if name in motion_names else ():
            try:
                dataclasses.replace(excitation, **{name: bound})
            except ValueError as error:
                raise ValueError(
                    f"explore: vary[{name!r}] = ({low:g}, {high:g}) exceeds the admissible range: {error}"
                ) from None
    options = options.replace(outputs=_outputs(options), throw=False)
    check_overturn_ratio("explore", as_podium(structure), options)
    return Explorer(structure, excitation, dict(vary), options)


def _outputs(options: rj.Options) -> tuple[str, ...]:
    """Return the outputs to request. The overturning margin, the last of `OUTPUTS`, is requested only with
    engine="flat" and overturn_ratio ≤ 1. With other options, it is not defined for every structure."""
    return OUTPUTS if float(options.overturn_ratio) <= 1 and options.engine == "flat" else OUTPUTS[:-1]


def _motion_names(
    structure: Structure, excitation: rj.AbstractExcitation, names: tuple[str, ...]
) -> list[str]:
    """Return the `names` of scalar fields of the motion that are not names of parameters of the structure."""
    fields = {field.name: getattr(excitation, field.name) for field in dataclasses.fields(excitation)}
    parameters = STRUCTURE if isinstance(structure, rj.Podium) else DIMENSIONS
    scalars = [name for name, y in fields.items() if eqx.is_inexact_array(y) and y.ndim == 0]
    return [name for name in names if name in scalars and name not in parameters]


class _Study(Module):
    """A structure and a motion, with the names of their varied parameters."""

    structure: Structure
    excitation: rj.AbstractExcitation
    names: tuple[str, ...] = eqx.field(static=True)

    def at(self, values: Any) -> tuple[Structure, rj.AbstractExcitation]:
        """Return the structure and the motion for values (n,) in the order of `names`."""
        structure_values = dict(zip(self.names, values, strict=True))
        motion_values = {
            name: structure_values.pop(name)
            for name in _motion_names(self.structure, self.excitation, self.names)
        }
        structure = with_variables(self.structure, structure_values) if structure_values else self.structure
        return structure, dataclasses.replace(self.excitation, **motion_values)

    def initial_value_and_unit(self, name: str) -> tuple[float, str]:
        """Return the initial value of a parameter and its unit."""
        if name in _motion_names(self.structure, self.excitation, self.names):
            return float(getattr(self.excitation, name)), displayed(motion_parameter(name).unit)
        value: Any = value_of(self.structure, name)
        return float(value), displayed(parameter(self.structure, name).unit)


class _Simulation(Module):
    """Peaks of the response of the podium, and curves over time.

    - `peak`: the peaks; `t`: times (n,) of the curves [s]; `rotation`: rotation θ/α of the columns [–]
    - `deformation`: deformation of the superstructure [m]; `ground_acceleration`: horizontal ground
      acceleration ü_g [g]
    """

    peak: rj.Peak
    t: Float[Array, " n"]
    rotation: Float[Array, " n"]
    deformation: Float[Array, " n"]
    ground_acceleration: Float[Array, " n"]


@eqx.filter_jit
def _simulate(study: _Study, values: Float[ArrayLike, " n"], options: rj.Options) -> _Simulation:
    """Simulate the response for the slider values (n,), and compute its curves."""
    structure, excitation = study.at(values)
    podium = as_podium(structure)
    response = rj.simulate(podium, excitation, options=options)
    start, end = excitation.support
    t = jnp.linspace(start, end + TIME_AFTER / podium.p, POINTS)
    peak = rj.Peak(
        **{field.name: getattr(response, field.name) for field in dataclasses.fields(AbstractPeak)}
    )
    ground_acceleration = excitation.horizontal if isinstance(excitation, rj.GroundMotion) else excitation
    rotation, deformation = response(t).theta / podium.alpha, _deformation(response, podium, t)
    return _Simulation(peak, t, rotation, deformation, ground_acceleration(t) / podium.g)


def _deformation(response: rj.Response, podium: rj.Podium, t: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return the deformation of the superstructure at times t (n,), shape (n,) [m]. For a building, this is
    the displacement of the roof relative to the beam; with several modes, the deformation of mode 1."""
    if isinstance(podium.superstructure, rj.ShearBuilding):
        return jnp.sum(response.drift(t), axis=-1)
    deformation = response.deformation(t)
    return deformation if deformation.ndim == 1 else deformation[:, 0]


def _deformation_label(podium: rj.Podium) -> str:
    """Return the axis label of `_deformation`."""
    if isinstance(podium.superstructure, rj.ShearBuilding):
        return "roof\n[mm]"
    return "mode 1\n[mm]" if isinstance(podium.superstructure, rj.Modes) else "deformation\n[mm]"


class _Grid(NamedTuple):
    """Positions of a slider: `low`, `low + step`, … up to `high`. A browser rounds every value to the nearest
    position, even the initial value."""

    low: float
    high: float
    step: float

    @classmethod
    def containing(cls, low: float, high: float, value: float) -> _Grid:
        """Return a grid from `low` to `high`, if possible with the position `value`. The step is 1, 2 or 5
        times a power of 10: the least such step that gives at most `SLIDER_POSITIONS` steps. While `value` is
        not a position, the step is divided by 10, at most `MAX_REFINEMENTS` times."""
        rough_step = (high - low) / SLIDER_POSITIONS
        unit = 10.0 ** math.floor(math.log10(rough_step))
        step = unit * next(factor for factor in (1, 2, 5, 10) if factor * unit >= 0.999 * rough_step)
        grids = [cls(low, high, float(f"{step / 10**k:.12g}")) for k in range(MAX_REFINEMENTS + 1)]
        return next((grid for grid in grids if grid.has_position(value)), grids[-1])

    def has_position(self, value: float) -> bool:
        """Return whether a value is a position."""
        position = (value - self.low) / self.step
        return abs(position - round(position)) < 1e-6

    def read(self, shown_value: float, initial_value: float) -> float:
        """Return the value of the parameter for the value that its slider shows: at the position nearest to
        the initial value, the initial value, otherwise the shown value."""
        if not self.has_position(shown_value):
            return shown_value
        shown_value = float(f"{shown_value:.12g}")  # browsers compute positions in floating point
        return initial_value if abs(shown_value - initial_value) <= 0.5001 * self.step else shown_value


def _slider(name: str, grid: _Grid, value: float, unit: str) -> ipywidgets.FloatSlider:
    import ipywidgets

    unit = f" [{unit}]" if unit else ""
    return ipywidgets.FloatSlider(
        value=value,
        min=grid.low,
        max=grid.high,
        step=grid.step,
        description=f"{name}{unit}",
        readout_format=".6",
        style={"description_width": "9em"},
        layout={"width": "100%"},
    )


class _Drawing:
    """Figure of the initial and the present response. A call redraws the present response."""

    def __init__(self, initial: _Simulation, structure: Structure):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        from rockjax.plots import COLOURS, ROTATION, STYLE, plt

        podium = as_podium(structure)
        rows = [
            (lambda s: np.asarray(s.rotation), ROTATION, COLOURS[2]),
            (lambda s: MM_PER_M * np.asarray(s.deformation), _deformation_label(podium), COLOURS[3]),
            (lambda s: np.asarray(s.ground_acceleration), r"$\ddot u_g$ [g]", COLOURS[0]),
        ]
        if not podium.vibrates:
            del rows[1]
        with plt.style.context(STYLE):
            # The space around the axes is fixed, because a layout engine would take longer than the drawing.
            self.figure = Figure(figsize=(_WIDTH, _ROW_HEIGHT * len(rows)), dpi=_DPI)
            FigureCanvasAgg(self.figure)
            axes = self.figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
            self.figure.subplots_adjust(left=0.11, right=0.98, top=0.97, bottom=0.25 / len(rows), hspace=0.12)
            self.curves: list[tuple[Axes, Line2D, Any]] = []
            for ax, (quantity, label, colour) in zip(axes, rows, strict=True):
                ax.plot(np.asarray(initial.t), quantity(initial), color="0.6", ls="--", label="initial")
                (line,) = ax.plot([], [], color=colour, ls="-", label="now")
                ax.set_ylabel(label)
                ax.grid(visible=True)
                self.curves.append((ax, line, quantity))
            axes[0].set_ylim(-1.05, 1.05)
            axes[0].legend(loc="upper right", ncols=2)
            axes[-1].set_xlabel("time [s]")

    def __call__(self, simulation: _Simulation) -> bytes:
        """Draw a response and return the picture as PNG."""
        for ax, line, quantity in self.curves:
            line.set_data(np.asarray(simulation.t), quantity(simulation))
            if ax.get_autoscaley_on():
                ax.relim()
            ax.autoscale_view(scalex=False)
        self.curves[0][0].set_xlim(float(simulation.t[0]), float(simulation.t[-1]))
        file = io.BytesIO()
        self.figure.savefig(file, format="png", dpi=PIXEL_RATIO * _DPI, pil_kwargs={"compress_level": 1})
        return file.getvalue()


# Heading of a row of the table → (field of the peak, factor that converts it to the unit of the heading).
_ROWS = {
    "peak rotation [α]": ("peak_rotation", 1.0),
    "overturning margin": ("margin", 1.0),
    "impacts": ("impacts", 1.0),
    "peak deformation [mm]": ("peak_deformation", MM_PER_M),
    "peak drift [mm]": ("peak_drift", MM_PER_M),
    "peak floor acceleration [m/s²]": ("peak_floor_acceleration", 1.0),
    "peak shear / weight": ("peak_shear", 1.0),
}


def _peak_table(initial: rj.Peak, present: rj.Peak) -> str:
    """Return an HTML table of the initial and the present peaks."""

    def formatted_peak(peak: rj.Peak, field: str, factor: float) -> str:
        return f"{factor * float(np.max(getattr(peak, field))):.3g}"  # the largest of all modes or stories

    available = {
        name: field_and_factor
        for name, field_and_factor in _ROWS.items()
        if getattr(initial, field_and_factor[0]) is not None
    }
    rows = [
        (name, *(formatted_peak(peak, *field_and_factor) for peak in (initial, present)))
        for name, field_and_factor in available.items()
    ]
    rows += [("result", _describe_end(initial), _describe_end(present))]
    cell = '<td style="padding: 1px 6px; text-align: left">'
    heading = "".join(f"{cell}<b>{title}</b></td>" for title in ("", "initial", "now"))
    rows_of_cells = ["".join(f"{cell}{text}</td>" for text in row) for row in rows]
    return (
        '<table style="line-height: 1.4">'
        + "".join(f"<tr>{cells}</tr>" for cells in (heading, *rows_of_cells))
        + "</table>"
    )


def _describe_end(peak: rj.Peak) -> str:
    if bool(peak.overturned):
        return f"overturns at {float(peak.overturn_time):.3g} s"
    survivals = (rj.RESULTS.settled, rj.RESULTS.end_of_time)
    has_survived = any(bool(peak.result == result) for result in survivals)
    return "survives" if has_survived else str(rj.RESULTS[peak.result])
