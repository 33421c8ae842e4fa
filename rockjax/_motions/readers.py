"""Readers of one ground motion from a file, and of several from a folder or table."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rockjax._checks import require_instance, require_number
from rockjax._text.reading import csv_rows, csv_table, decode, read_text

from .accelerogram import warn_if_implausible
from .files import check_arguments, read
from .motion import Motion, Motions

TABLE = "suite.csv"  # optional table of the files in a folder
_COLUMNS = ("file", "name", "scale", "units", "dt", "component")


def read_motion(
    path: str | Path, *, units: str | None = None, dt: float | None = None, component: int | str | None = None
) -> Motion:
    """Read the ground motion in a file, with the contents of the file header.

    The suffix or the first lines determine the format: PEER's `.AT2`; volume 2 (corrected data) of CSMIP,
    COSMOS and GeoNet (`.V2`, `.V2c`, `.V2A`); SMC; ESM, ITACA and AFAD (`KEY: value`), AFAD's older text;
    K-NET and KiK-net (`.NS`, `.EW`, `.UD`, `.NS1` …); text with one column, or with times and accelerations;
    NumPy's `.npy`; and miniSEED, SAC and GSE2 with ObsPy, which the extra `rockjax[records]` installs. Text
    may have comments (`#`, `%`, `!`) and headings such as `time [ms],Acc (cm/s2)`; blanks, commas, semicolons
    or tabs separate its columns.

    - `path`: file to read
    - `units`: `"g"`, `"m/s2"`, `"cm/s2"`, `"gal"` or `"mm/s2"`; required if the file does not state its unit
    - `dt`: sampling interval, > 0 [s]; required if the file contains neither the interval nor times
    - `component`: number or name of a channel, such as `1`, `"Up"` or `"HNE"`, if the file has several.
      Any usual name of the vertical component selects the vertical channel

    Raises `ValueError` for a file that cannot be read as a ground motion, for headings that are unknown or
    contradict `units` or `dt`, and for gaps. The message names the file, the cause and, where possible, the
    line. If a channel must be chosen, the message lists the channels.

    Warns ([`rockjax.RecordWarning`][]) if the file is damaged, if its data are raw, or if the values look
    wrong: a PGA outside 1e-4 g to 3 g (with `units="m/s2"`, outside 0.05 g to 3 g), a sampling interval
    outside 1e-4 s to 0.1 s, or a final velocity of more than a fifth of PGV.
    """
    motion = read(path, units, dt, component)
    warn_if_implausible(motion, str(path), stacklevel=3, unit_from_user=units is not None)
    return Motion(motion.acceleration, motion.dt, motion.name, motion.source, motion.metadata)


def read_suite(
    path: str | Path,
    *,
    units: str | None = None,
    dt: float | None = None,
    scale: float = 1.0,
    component: int | str | None = None,
    pattern: str | None = None,
) -> Motions:
    """Read the ground motions in a folder, or in a table of files.

    - `path`: a folder, or a table. All files of a folder, except hidden ones, are read in the order of their
      names; if the folder contains a `suite.csv`, this table is read instead. A table is a `.csv` with a row
      of headings: `file` (relative to the table) and, optionally, `name`, `scale`, `units`, `dt` and
      `component`. Empty cells count as missing. Other columns become metadata and replace those of the file
    - `units`, `dt`, `component`: as in [`rockjax.read_motion`][], for all files; cells of the table have
      priority
    - `scale`: factor on all motions [–], multiplied by the column `scale` of the table
    - `pattern`: pattern such as `"*.AT2"`; only files of the folder whose names match are read, and
      `suite.csv` is ignored. None for all files

    Raises `ValueError`, which lists all files that cannot be read, each with the cause.
    """
    require_instance("read_suite", "path", path, str | Path, "the path of a folder or table")
    require_instance("read_suite", "pattern", pattern, str | None, "a pattern such as '*.AT2', or None")
    path = Path(path)
    check_arguments(path, units, dt, component)
    scale = require_number(str(path), "scale", scale, np.isfinite, "finite")
    if path.is_dir():
        if pattern is None and (path / TABLE).is_file():
            path = path / TABLE
        else:
            try:
                files = sorted(
                    p for p in path.glob(pattern or "*") if p.is_file() and not p.name.startswith(".")
                )
            except (ValueError, NotImplementedError, OSError) as error:
                raise ValueError(f"{path}: pattern {pattern!r} is not valid: {error}") from None
            if not files:
                raise ValueError(f"{path}: the folder has no file" + (f" {pattern}" if pattern else ""))
            return _read_all(
                path,
                [(str(file), {"file": str(file)}) for file in files],
                units,
                dt,
                scale,
                component,
                advises_pattern=pattern is None,
            )
    elif pattern is not None:
        raise ValueError(f"{path}: pattern applies to folders, but this is not a folder; leave pattern out")
    return _read_all(path, _read_table(path), units, dt, scale, component, advises_pattern=False)


def is_table(path: Path) -> bool:
    """Return whether a file is a table of files, not a motion: a `.csv` with the heading `file` in the first
    row."""
    if path.suffix.lower() != ".csv":
        return False
    try:
        with path.open("rb") as stream:
            _, names = next(csv_rows(path, decode(path, stream.read(4096))), (1, []))
    except (OSError, ValueError):
        return False  # read_suite or read_motion will report the cause
    return "file" in names


def _read_table(path: Path) -> list[tuple[str, dict[str, str]]]:
    """Return each row of a table of files: the location (path and line), for messages, and the non-empty
    cells by heading."""
    names, iterator = csv_table(path, read_text(path))
    if "file" not in names:
        raise ValueError(
            f"{path}:1: the table needs a row of headings with the column 'file'; known columns are "
            f"{', '.join(_COLUMNS)}"
        )
    rows = list(iterator)
    if not rows:
        raise ValueError(f"{path}: the table lists no file; add a line for each file below the headings")
    for location, row in rows:
        if "file" not in row:
            raise ValueError(f"{location}: the cell of the column 'file' is empty")
        for name in ("scale", "dt"):
            _parse_cell(location, row, name)
        row["file"] = str(path.parent / row["file"])
    return rows


def _parse_cell(location: str, row: dict[str, str], name: str) -> float | None:
    """Return the number in the cell of the column `name`; None for an empty cell. Raises `ValueError` for
    other text than a finite number."""
    try:
        value = float(row[name]) if name in row else None
    except ValueError:
        value = float("nan")
    if value is not None and not np.isfinite(value):
        raise ValueError(f"{location}: {name} must be a finite number, got {row[name]!r}")
    return value


def _read_all(
    path: Path,
    rows: list[tuple[str, dict[str, str]]],
    units,
    dt,
    scale: float,
    component,
    *,
    advises_pattern: bool,
) -> Motions:
    """Read the files of a folder or table.

    - `path`: the folder or table; `rows`: for each file, its location for messages, and its table cells
    - `units`, `dt`, `scale`, `component`: as for `read_suite`
    - `advises_pattern`: whether the message about unreadable files advises the argument `pattern`
    """
    motions, problems = [], []
    for location, row in rows:
        row_dt, row_scale = _parse_cell(location, row, "dt"), _parse_cell(location, row, "scale")
        try:
            motion = read(
                row["file"],
                row.get("units", units),
                dt if row_dt is None else row_dt,
                row.get("component", component),
            )
        except ValueError as error:
            problems.append(str(error))
            continue
        warn_if_implausible(
            motion, row["file"], stacklevel=4, unit_from_user=row.get("units", units) is not None
        )
        extra_columns = {key: value for key, value in row.items() if key not in _COLUMNS}
        motion = Motion(
            motion.acceleration,
            motion.dt,
            row.get("name", motion.name),
            motion.source,
            dict(motion.metadata) | extra_columns,
        )
        factor = scale * (1.0 if row_scale is None else row_scale)
        motions.append(motion.scaled(factor) if factor != 1 else motion)
    if problems:
        hint = (
            "; a pattern such as '*.AT2' (on the command line --pattern) selects files"
            if advises_pattern
            else ""
        )
        raise ValueError(
            "\n  ".join([f"{path}: {len(problems)} of {len(rows)} files cannot be read{hint}", *problems])
        )
    return Motions(tuple(motions))
