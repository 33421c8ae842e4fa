"""Readers of ground motions: `read_motion` for one file, `read_suite` for a folder or a table of files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from rockjax._checks import require_instance, require_number
from rockjax._text.reading import csv_rows, csv_table, decode, read_text

from .accelerogram import warn_if_implausible
from .files import check_arguments, read
from .motion import Motion, Motions

TABLE = "suite.csv"  # optional table of the files in a folder
_COLUMNS = ("file", "name", "scale", "units", "dt", "component")
# Headings that look like those of columns with numbers or units, which must not be taken for metadata.
_COLUMN_LIKE = re.compile(r"(scale|unit|dt)s?(?![a-z])", re.I)


def read_motion(
    path: str | Path, *, units: str | None = None, dt: float | None = None, component: int | str | None = None
) -> Motion:
    """Read the ground motion in a file, with the contents of the file header.

    The suffix of the file or its first lines determine the format:

    - PEER (`.AT2`)
    - volume 2 (corrected data) of CSMIP, COSMOS and GeoNet (`.V2`, `.V2c`, `.V2A`)
    - SMC
    - ESM, ITACA and AFAD with a header of lines `KEY: value`, and the older text format of AFAD
    - K-NET and KiK-net (`.NS`, `.EW`, `.UD`, `.NS1` …)
    - text with one column of accelerations, or with columns of times and accelerations. Lines that begin with
      `#`, `%` or `!` are comments. A line of headings, such as `time [ms],Acc (cm/s2)`, is optional. Blanks,
      commas, semicolons or tabs separate the columns
    - NumPy (`.npy`)
    - miniSEED, SAC and GSE2; these formats need ObsPy, which the extra `rockjax[records]` installs

    The arguments:

    - `path`: file to read
    - `units`: unit of the samples, `"g"`, `"m/s2"`, `"cm/s2"`, `"gal"` or `"mm/s2"`; required if the file
      does not state the unit
    - `dt`: sampling interval, > 0 [s]; required if the file contains neither the interval nor times
    - `component`: number or name of a channel, such as `1`, `"Up"` or `"HNE"`; required if the file has
      several channels. Any usual name of the vertical component selects the vertical channel

    Raises `ValueError` for a file that cannot be read as a ground motion, for unknown headings, for missing
    samples, and if `units` or `dt` contradicts the file. The message names the file, the cause and, where
    possible, the line. If a channel must be chosen, the message lists the channels.

    Warns ([`rockjax.RecordWarning`][]) if the file is damaged, if its data are raw (not corrected), or if the
    values look wrong: a PGA outside 1e-4 g to 3 g, or with `units="m/s2"` outside 0.05 g to 3 g; a sampling
    interval outside 1e-4 s to 0.1 s; or a final velocity of more than a fifth of PGV.
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

    - `path`: a folder or a table. All files of a folder, except hidden ones, are read in the order of their
      names. If the folder contains a table `suite.csv`, this table is read instead
    - `units`, `dt`, `component`: as in [`rockjax.read_motion`][], for all files; cells of the table have
      priority
    - `scale`: factor on all motions [–]; it multiplies the column `scale` of the table
    - `pattern`: only for a folder: a pattern such as `"*.AT2"`. Only files with matching names are read, and
      `suite.csv` is ignored. None for all files

    A table is a `.csv` file with a row of headings and a row for each ground motion. The column `file`
    contains the path of the file, relative to the folder of the table. The columns `name`, `scale`, `units`,
    `dt` and `component` are optional; an empty cell counts as missing. The cells of other columns become
    metadata, and replace metadata of the same name from the file. Semicolons or tabs may separate the cells.

    Raises `ValueError` for an invalid argument or table, for a folder without files, and if any file cannot
    be read. The message lists all files that cannot be read, each with the cause.
    """
    require_instance("read_suite", "path", path, str | Path, "the path of a folder or table")
    require_instance("read_suite", "pattern", pattern, str | None, "a pattern such as '*.AT2', or None")
    path = Path(path)
    check_arguments(path, units, dt, component)
    scale = require_number(str(path), "scale", scale, np.isfinite, "finite")
    path, rows = _files_to_read(path, pattern)
    motions, problems = [], []
    for location, row in rows:
        row_dt, row_scale = _parse_cell(location, row, "dt"), _parse_cell(location, row, "scale")
        row_units = row.get("units", units)
        try:
            motion = read(
                row["file"], row_units, dt if row_dt is None else row_dt, row.get("component", component)
            )
        except ValueError as error:
            problems.append(str(error))
            continue
        warn_if_implausible(motion, row["file"], stacklevel=3, unit_from_user=row_units is not None)
        extra_columns = {key: value for key, value in row.items() if key not in _COLUMNS}
        name, metadata = row.get("name", motion.name), dict(motion.metadata) | extra_columns
        motion = Motion(motion.acceleration, motion.dt, name, motion.source, metadata)
        factor = scale * (1.0 if row_scale is None else row_scale)
        motions.append(motion.scaled(factor) if factor != 1 else motion)
    if problems:
        hint = "; a pattern such as '*.AT2' (on the command line --pattern) selects files"
        summary = f"{path}: {len(problems)} of {len(rows)} files cannot be read"
        summary += hint if pattern is None and path.is_dir() else ""
        raise ValueError("\n  ".join([summary, *problems]))
    return Motions(tuple(motions))


def _files_to_read(path: Path, pattern: str | None) -> tuple[Path, list[tuple[str, dict[str, str]]]]:
    """Return the folder or table that `read_suite` reads and, for each file, its location for messages and
    its cells of the table by heading."""
    if pattern is not None and not path.is_dir():
        raise ValueError(f"{path}: pattern applies to folders, but this is not a folder; leave pattern out")
    table = path / TABLE if path.is_dir() else path
    if pattern is None and (table.is_file() or not path.is_dir()):
        return table, _read_table(table)
    try:
        files = sorted(p for p in path.glob(pattern or "*") if p.is_file() and not p.name.startswith("."))
    except (ValueError, NotImplementedError, OSError) as error:
        raise ValueError(f"{path}: pattern {pattern!r} is not valid: {error}") from None
    if not files:
        raise ValueError(f"{path}: the folder has no file" + (f" {pattern}" if pattern else ""))
    return path, [(str(file), {"file": str(file)}) for file in files]


def is_table(path: Path) -> bool:
    """Return whether a file is a table of files, and not a motion: a `.csv` whose first row contains the
    heading `file`."""
    if path.suffix.lower() != ".csv":
        return False
    try:
        with path.open("rb") as stream:
            _, names = next(csv_rows(path, decode(path, stream.read(4096))), (1, []))
    except (OSError, ValueError):
        return False  # read_suite or read_motion will report the cause
    return "file" in names


def _read_table(path: Path) -> list[tuple[str, dict[str, str]]]:
    """Return the rows of a table of files. Each row is a pair: its location (path and line) for messages, and
    a dictionary from heading to cell without the empty cells. Raises `ValueError` for an invalid table."""
    names, iterator = csv_table(path, read_text(path))
    if "file" not in names:
        raise ValueError(
            f"{path}:1: the table needs a row of headings with the column 'file'; known columns are "
            f"{', '.join(_COLUMNS)}"
        )
    for name in names:
        if name not in _COLUMNS and (column := _COLUMN_LIKE.match(name)):
            expected = next(each for each in _COLUMNS if each.startswith(column[1].lower()))
            meaning = {"scale": "factors", "units": "units", "dt": "intervals in s"}[expected]
            raise ValueError(
                f"{path}: the heading {name!r} is not known; if the column contains {meaning}, call it "
                f"{expected!r}"
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
    """Return the number in the cell of the column `name`; None for an empty cell. Raises `ValueError` if the
    text is not a finite number."""
    try:
        value = float(row[name]) if name in row else None
    except ValueError:
        value = float("nan")
    if value is not None and not np.isfinite(value):
        raise ValueError(f"{location}: {name} must be a finite number, got {row[name]!r}")
    return value
