"""Reading of the ground motion in a file, with its units."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rockjax._checks import of_kind, refuse_sentinels, shown, single
from rockjax._units import ACCELERATIONS, RECORD_UNITS, unit_of

from .accelerogram import RAW, Accelerogram
from .formats import EVEN, parse


def check_reading(path: Path, units, dt, component) -> None:
    """Raise `ValueError` for invalid arguments of reading.

    - `path`: file; `units`: a key of `RECORD_UNITS`, or None; `dt`: > 0 [s], or None; `component`: number or
      name of a channel, or None
    """
    if not isinstance(component, int | str | None):
        raise ValueError(f"{path}: component must be the number or name of a channel, got {shown(component)}")
    if units is not None and units not in RECORD_UNITS:
        raise ValueError(f"{path}: units must be one of {', '.join(RECORD_UNITS)}, got {shown(units)}")
    if dt is not None:
        single(str(path), "dt", dt, lambda v: v > 0, "finite and > 0 s")


def read(
    path: str | Path, units: str | None, dt: float | None, component: int | str | None = None
) -> Accelerogram:
    """Read the ground motion in a file, without plausibility checks.

    - `path`: file
    - `units`: unit of the samples, if the file does not state it
    - `dt`: sampling interval [s], if the file states neither it nor times
    - `component`: number or name of a channel, if the file has several

    Raises `ValueError` that names the file, the line and the cause.
    """
    of_kind("read_motion", "path", path, str | Path, "the path of a file")
    path = Path(path)
    check_reading(path, units, dt, component)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:  # a NUL in the name
        raise ValueError(f"{path}: cannot be read: {error}") from None
    if not content.strip():
        raise ValueError(f"{path}: is empty")
    found = parse(path, content, component)
    own = found.units
    if own is None and units is None:
        said = f"gives the unit as {found.said!r}" if found.said else "does not say in what units"
        said = (
            "its header does not give the unit"
            if found.metadata["format"] == "PEER" and not found.said
            else said
        )
        raise ValueError(
            f"{path}: {said}; give units (on the command line --units): one of {', '.join(RECORD_UNITS)}"
        )
    says = found.says_units or f"{path}: its header"
    other = unit_of(found.said)
    if own is None and other is not None:
        raise ValueError(
            f"{says} gives the unit as {found.said}, which is not a unit of acceleration; known are "
            f"{', '.join(ACCELERATIONS)}"
        )
    if own is not None and units is not None and ACCELERATIONS[own] != RECORD_UNITS[units]:
        raise ValueError(f"{says} gives the unit as {own}, but units = {units} was given; leave units out")
    values = found.values
    if len(values) < 2:
        raise ValueError(f"{path}: holds {len(values)} sample; a record has at least two")
    if found.dt is None and dt is None:
        cause = found.says_dt or f"{path}: has one column and no times"
        raise ValueError(f"{cause}; give dt (on the command line --dt), in seconds")
    if found.dt is not None and dt is not None and abs(dt - found.dt) > EVEN * found.dt:
        raise ValueError(f"{found.says_dt}, but dt = {dt:g} s was given; leave dt out")
    unit = units or own
    assert unit is not None
    refuse_sentinels(str(path), values)
    with np.errstate(over="ignore"):
        values = ACCELERATIONS[unit] * values
    if not np.isfinite(values).all():
        raise ValueError(f"{path}: sample {int(np.argmin(np.isfinite(values))) + 1} is not a finite number")
    step = found.dt if found.dt is not None else float(dt or 0)
    notes = {"units": unit} | ({"processing": f"{RAW} ({found.raw})"} if found.raw else {})
    return Accelerogram(values, step, path.stem, path, found.metadata | notes)
