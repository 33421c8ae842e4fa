"""Reading of the ground motion in a file, and conversion of its samples to m/s²."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rockjax._checks import format_value, refuse_sentinels, require_instance, require_number
from rockjax._units import ACCELERATIONS, RECORD_UNITS, unit_of

from .accelerogram import RAW, Accelerogram
from .formats import TIME_TOLERANCE, parse


def check_arguments(path: Path, units, dt, component) -> None:
    """Raise `ValueError`, which names the file or folder `path`, unless `units` is a key of `RECORD_UNITS`,
    `dt` is > 0 [s] and `component` is the number or name of a channel. Each may be None."""
    if not isinstance(component, int | str | None):
        raise ValueError(
            f"{path}: component must be the number or name of a channel, got {format_value(component)}"
        )
    if units is not None and units not in RECORD_UNITS:
        raise ValueError(f"{path}: units must be one of {', '.join(RECORD_UNITS)}, got {format_value(units)}")
    if dt is not None:
        require_number(str(path), "dt", dt, lambda v: v > 0, "finite and > 0 s")


def read(
    path: str | Path, units: str | None, dt: float | None, component: int | str | None = None
) -> Accelerogram:
    """Read the ground motion in a file, without plausibility checks. The arguments are as for
    [`rockjax.read_motion`][].

    The metadata of the result contain the file header, the unit of the file as `units`, and for raw data the
    entry `processing`. Raises a `ValueError` that names the file, the cause and, where possible, the line.
    """
    require_instance("read_motion", "path", path, str | Path, "the path of a file")
    path = Path(path)
    check_arguments(path, units, dt, component)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: the file cannot be read: {error.strerror}") from None
    except ValueError as error:  # the name contains a NUL
        raise ValueError(f"{path}: the file cannot be read: {error}") from None
    if not content.strip():
        raise ValueError(f"{path}: the file is empty")
    parsed = parse(path, content, component)
    file_units = parsed.units
    if file_units is None and units is None:
        if parsed.stated_unit:
            problem = f"the file gives the unit as {parsed.stated_unit!r}"
        elif parsed.metadata["format"] == "PEER":
            problem = "the header does not give the unit"
        else:
            problem = "the file does not state the unit of its samples"
        raise ValueError(
            f"{path}: {problem}; give units (on the command line --units): one of {', '.join(RECORD_UNITS)}"
        )
    unit_location = parsed.unit_location or f"{path}: the header"
    if file_units is None and unit_of(parsed.stated_unit) is not None:
        raise ValueError(
            f"{unit_location} gives the unit as {parsed.stated_unit}, which is not a unit of acceleration; "
            f"known units are {', '.join(ACCELERATIONS)}"
        )
    if file_units is not None and units is not None and ACCELERATIONS[file_units] != RECORD_UNITS[units]:
        raise ValueError(
            f"{unit_location} gives the unit as {file_units}, but units = {units} was given; leave units out"
        )
    values = parsed.values
    if len(values) < 2:
        raise ValueError(f"{path}: a record needs at least two samples, got {len(values)}")
    if parsed.dt is None and dt is None:
        cause = parsed.dt_statement or f"{path}: the file has one column and no times"
        raise ValueError(f"{cause}; give dt (on the command line --dt), in seconds")
    if parsed.dt is not None and dt is not None and abs(dt - parsed.dt) > TIME_TOLERANCE * parsed.dt:
        raise ValueError(f"{parsed.dt_statement}, but dt = {dt:g} s was given; leave dt out")
    unit = units or file_units
    assert unit is not None
    refuse_sentinels(str(path), values)
    with np.errstate(over="ignore"):
        values = ACCELERATIONS[unit] * values
    if not np.isfinite(values).all():
        raise ValueError(f"{path}: sample {int(np.argmin(np.isfinite(values))) + 1} is not a finite number")
    interval = parsed.dt if parsed.dt is not None else float(dt or 0)
    notes = {"units": unit}
    if parsed.raw_location:
        notes["processing"] = f"{RAW} ({parsed.raw_location})"
    return Accelerogram(values, interval, path.stem, path, parsed.metadata | notes)
