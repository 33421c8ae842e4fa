"""Pictures of datasets from files that rockjax wrote, for `rockjax plot`. Each kind of dataset has its
pictures."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rockjax import plots
from rockjax._extensions import extension
from rockjax._files import write_figure
from rockjax._outputs.registry import VARIABLES

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class Picture:
    """A picture of a dataset.

    - `draw`: function dataset → figure or axes; for an animation, (path, dataset) → path
    - `default`: whether the picture is drawn if no picture is requested by name
    - `required_variable`: variable that the dataset must have
    - `is_animation`: whether the picture is an animation
    - `group`: group of the file that contains the data; None for the root
    """

    draw: Callable[..., Any]
    default: bool = True
    required_variable: str | None = None
    is_animation: bool = False
    group: str | None = None


def _with_panel_dims(draw: Callable[[xarray.Dataset], Figure]) -> Callable[[xarray.Dataset], Figure]:
    """Return a function like `draw` that also accepts the spectrum of a single podium and draws it as one
    panel. Such a spectrum lacks the dims `eta_over_gamma` and `T_s`."""

    def figure(data: xarray.Dataset) -> Figure:
        if "eta_over_gamma" not in data.dims:
            eta, gamma = data.attrs.get("eta", 0.0), data.attrs["gamma"]
            ratio = eta / gamma if gamma else float("inf") if eta else 0.0
            data = data.expand_dims({"eta_over_gamma": [ratio], "T_s": [data.attrs.get("T_s_s", 0.0)]})
        return draw(data)

    return figure


# Pictures: kind of the dataset → name of the picture → picture.
PICTURES: dict[str, dict[str, Picture]] = {
    "rocking-spectrum": {
        "rotation": Picture(_with_panel_dims(plots.spectra)),
        "overturning": Picture(_with_panel_dims(plots.overturning_curves)),
        "sensitivity": Picture(
            _with_panel_dims(plots.sensitivity_spectra), required_variable="peak_rotation_sensitivity"
        ),
        "lift-off": Picture(_with_panel_dims(plots.lift_off_spectra), required_variable="least_axial_force"),
    },
    "overturning-spectrum": {
        "boundaries": Picture(_with_panel_dims(plots.overturning_boundaries)),
        "sensitivity": Picture(_with_panel_dims(plots.sensitivities), required_variable="sensitivity"),
    },
    "response": {
        "response": Picture(plots.response),
        "phase-portrait": Picture(plots.phase_portrait, default=False),
        "moment-rotation": Picture(plots.moment_rotation, default=False),
        "energy": Picture(plots.energy_balance, default=False),
        "stories": Picture(plots.stories, default=False, required_variable="peak_drift"),
        "joint-forces": Picture(plots.joint_forces, default=False, required_variable="joint_axial_force"),
        "friction-demand": Picture(
            plots.friction_demand, default=False, required_variable="joint_axial_force"
        ),
        "animation": Picture(plots.save_animation, default=False, is_animation=True),
    },
    "peaks": {"peaks": Picture(plots.peaks, required_variable="motion")},
    "incremental-dynamic-analysis": {"ida": Picture(plots.incremental_dynamic_analysis)},
    "fragility": {
        "fragility": Picture(plots.fragility),
        "ida": Picture(plots.incremental_dynamic_analysis, group="analysis"),
        "contents": Picture(plots.contents_fragility, group="contents"),
    },
    "contents-fragility": {"contents": Picture(plots.contents_fragility)},
    "risk": {"risk": Picture(plots.risk)},
    "ensemble": {
        name.replace("_", "-"): Picture(
            functools.partial(plots.ensemble, output=name), required_variable=name
        )
        for name in VARIABLES
        if name != "peak_rotation_time"
    },
    "floor-spectrum": {"floors": Picture(plots.floor_spectrum)},
    "record-spectrum": {"record-spectrum": Picture(plots.record_spectrum)},
    "design-chart": {"chart": Picture(lambda data: extension("design-chart")(data))},
}


def load(path: str | Path) -> xarray.Dataset:
    """Return the dataset in a file that rockjax wrote. Raises `ValueError`, which names the cause, for other
    files and for files of interrupted runs."""
    import xarray

    if not Path(path).is_file():
        raise ValueError(f"{path}: there is no such file")
    try:
        data = xarray.load_dataset(path, engine="netcdf4")
    except (OSError, RuntimeError, ValueError, AttributeError) as error:
        raise ValueError(
            f"{path}: the file cannot be read as netCDF: {getattr(error, 'strerror', None) or error}"
        ) from None
    if data.attrs.get("title") == "Interrupted run":
        raise ValueError(f"{path}: the run was interrupted; finish it with --resume, then draw it")
    if "kind" not in data.attrs:
        raise ValueError(f"{path}: the file has no attribute 'kind', so rockjax did not write it")
    if data.attrs["kind"] not in PICTURES:
        raise ValueError(
            f"{path}: the kind of the dataset must be one of {', '.join(PICTURES)}; "
            f"got {data.attrs['kind']!r}"
        )
    return data


def _groups(path: str | Path) -> dict[str, xarray.Dataset]:
    """Return the groups of a netCDF file by name."""
    import netCDF4
    import xarray

    with netCDF4.Dataset(path) as file:
        names = list(file.groups)
    return {name: xarray.load_dataset(path, group=name, engine="netcdf4") for name in names}


def redraw(
    path: str | Path, prefix: str | Path | None = None, names: Sequence[str] = (), suffix: str = ".png"
) -> list[Path]:
    """Write the pictures of a dataset to files PREFIX-NAME.png. Animations have the suffix .gif.

    - `path`: file that rockjax wrote
    - `prefix`: PREFIX, by default the path without its suffix
    - `names`: names of the pictures (NAME); by default all pictures whose field `default` is True
    - `suffix`: suffix that replaces ".png"; it does not apply to animations

    Returns the written paths. Raises `ValueError` for files that rockjax did not write, and for names of
    pictures that the file does not have.
    """
    data = load(path)
    groups = _groups(path)
    available = {
        name: picture
        for name, picture in PICTURES[data.attrs["kind"]].items()
        if (picture.required_variable is None or picture.required_variable in data)
        and (picture.group is None or picture.group in groups)
    }
    unknown = [name for name in names if name not in available]
    if unknown:
        raise ValueError(
            f"{path}: the pictures of this {data.attrs['kind']} are {', '.join(available)}; "
            f"got {unknown[0]!r}"
        )
    prefix = Path(path).with_suffix("") if prefix is None else prefix
    written = []
    for name in names or [name for name, picture in available.items() if picture.default]:
        picture = available[name]
        dataset = data if picture.group is None else groups[picture.group]
        if picture.is_animation:
            written.append(picture.draw(f"{prefix}-{name}.gif", dataset))
            continue
        result = picture.draw(dataset)  # a figure or axes
        written.append(write_figure(f"{prefix}-{name}{suffix}", getattr(result, "figure", result)))
    return written
