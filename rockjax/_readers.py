"""Ground motions from files: PEER's .AT2, NumPy's .npy, and text with one column or two.

Whatever is wrong with a file is a `ValueError` of one line that names the file, the line where there is one, and the cause.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ._structures import STANDARD_GRAVITY

UNITS = {"g": STANDARD_GRAVITY, "m/s2": 1.0, "cm/s2": 1e-2, "gal": 1e-2, "mm/s2": 1e-3}
EVEN = 1e-3  # times in files are rounded: so much of a step may they be off

_AT2_COUNT = re.compile(r"NPTS\s*=?\s*(\d{1,9})(?!\d)", re.I), re.compile(r"DT\s*=?\s*([\d.]+(?:[ED][+-]?\d+)?)", re.I)
_AT2_PLAIN = re.compile(r"^\s*(\d{1,9})\s+([\d.]+(?:[ED][+-]?\d+)?)\s+NPTS\s*,?\s*DT", re.I)
_AT2_UNITS = re.compile(r"UNITS\s+OF\s+(\S+)", re.I)
_SEPARATORS = re.compile(r"[,;\s]+")


class Motion(NamedTuple):
    """What a file holds: accelerations [m/s²] every `dt` [s]."""

    acceleration: np.ndarray
    dt: float


def read(path: str | Path, units: str | None, dt: float | None) -> Motion:
    """The ground motion in a file; `units` and `dt` where the file does not say them itself.

    Raises `ValueError` that names the file, the line and the cause.
    """
    path = Path(path)
    if units is not None and units not in UNITS:
        raise ValueError(f"{path}: units must be one of {', '.join(UNITS)}, got {units!r}")
    if dt is not None and not (np.isfinite(dt) and dt > 0):
        raise ValueError(f"{path}: dt must be finite and > 0 s, got {dt!r}")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}") from None
    if not content.strip():
        raise ValueError(f"{path}: is empty")
    if path.suffix.lower() == ".npy":
        return _columns(path, _array(path), None, units, dt)
    lines = _text(path, content).splitlines()
    if path.suffix.lower() == ".at2":
        return _at2(path, lines, units, dt)
    rows, numbers = _rows(path, lines)
    return _columns(path, rows, numbers, units, dt)


def _text(path: Path, content: bytes) -> str:
    strange = re.search(rb"[\x00-\x08\x0e-\x1f\x7f]", content)
    if strange:
        line = content.count(b"\n", 0, strange.start()) + 1
        raise ValueError(f"{path}:{line}: is not text: byte 0x{content[strange.start()]:02x} at offset {strange.start()}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")  # names of stations in headers


def _array(path: Path) -> np.ndarray:
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise ValueError(f"{path}: is not a NumPy array of numbers: {_first_line(error)}") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu" or array.ndim not in (1, 2):
        raise ValueError(f"{path}: is not a NumPy array of numbers in one column or two")
    return np.asarray(array, float).reshape(len(array), -1)


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _number(path: Path, line: int, word: str) -> float:
    """A number of a file; Fortran's exponent D is one as well, Python's underscore is none."""
    try:
        value = float(word.upper().replace("D", "E")) if "_" not in word else None
    except ValueError:
        value = None
    if value is None:
        raise ValueError(f"{path}:{line}: {_short(word)} is not a number")
    if not np.isfinite(value):
        raise ValueError(f"{path}:{line}: {_short(word)} is not a finite number")
    return value


def _short(word: str) -> str:
    return repr(word if len(word) <= 40 else word[:37] + "...")


def _at2(path: Path, lines: list[str], units: str | None, dt: float | None) -> Motion:
    head = lines[:8]
    for k, line in enumerate(head):  # noqa: B007
        plain = _AT2_PLAIN.match(line)
        count, step = (
            (plain[1], plain[2]) if plain else (match and match[1] for match in (p.search(line) for p in _AT2_COUNT))
        )
        if count and step:
            break
    else:
        raise ValueError(f"{path}: has no line with NPTS and DT among its first {len(head)}: is this an .AT2 file?")
    count, own_dt = int(count), _number(path, k + 1, step)
    if not own_dt > 0:
        raise ValueError(f"{path}:{k + 1}: DT must be > 0 s, got {own_dt:g}")
    if dt is not None and abs(dt - own_dt) > EVEN * own_dt:
        raise ValueError(f"{path}:{k + 1}: DT is {own_dt:g} s, but dt = {dt:g} s was given; leave dt out")
    said = next((match[1].strip(".,") for match in map(_AT2_UNITS.search, lines[:k]) if match), None)
    own = {"G": "g", "CM/S2": "cm/s2", "CM/SEC2": "cm/s2", "M/S2": "m/s2", "GAL": "gal"}.get(said.upper()) if said else None
    if own is None and units is None:
        found = f"gives the unit as {_short(said)}" if said else "does not give the unit"
        raise ValueError(f"{path}: its header {found}; say units='g', one of {', '.join(UNITS)}")
    if own is not None and units is not None and UNITS[own] != UNITS[units]:
        raise ValueError(f"{path}: its header gives the unit as {own}, but units={units!r} was given; leave units out")
    values = [_number(path, i, word) for i, line in enumerate(lines[k + 1 :], start=k + 2) for word in line.split()]
    if len(values) != count:
        cause = "is it cut short?" if len(values) < count else "what are the others?"
        raise ValueError(f"{path}:{k + 1}: NPTS is {count}, but {len(values)} values follow: {cause}")
    return _finished(path, np.array(values), own_dt, units or own)


def _rows(path: Path, lines: list[str]) -> tuple[np.ndarray, list[int]]:
    """The rows of a table of numbers, and which lines they are: without comments and one row of headings."""
    rows: list[list[float]] = []
    numbers: list[int] = []
    heading = False
    for i, line in enumerate(lines, start=1):
        text = line.strip()
        if not text or text[0] in "#%!":
            continue
        words = [word for word in _SEPARATORS.split(text) if word]
        try:
            row = [_number(path, i, word) for word in words]
        except ValueError:
            if rows or heading or any(character.isdigit() for character in words[0] if words):
                raise
            heading = True
            continue
        if not row:
            raise ValueError(f"{path}:{i}: holds no number")
        if rows and len(row) != len(rows[0]):
            raise ValueError(f"{path}:{i}: has {len(row)} columns where the lines before have {len(rows[0])}")
        rows.append(row)
        numbers.append(i)
    if not rows:
        raise ValueError(f"{path}: holds no numbers")
    return np.array(rows), numbers


def _columns(path: Path, rows: np.ndarray, numbers: list[int] | None, units: str | None, dt: float | None) -> Motion:
    if units is None:
        raise ValueError(f"{path}: does not say in what units; give units='g', one of {', '.join(UNITS)}")
    if rows.shape[1] > 2:
        raise ValueError(f"{path}: has {rows.shape[1]} columns; one (acceleration) or two (time, acceleration) can be read")
    if rows.shape[1] == 1:
        if dt is None:
            raise ValueError(f"{path}: has one column and no times: dt is missing")
        return _finished(path, rows[:, 0], float(dt), units)
    times, values = rows.T
    if len(times) < 2:
        return _finished(path, values, 1.0, units)  # says what is wrong with it
    step = (times[-1] - times[0]) / (len(times) - 1)
    off = np.flatnonzero(~(np.abs(np.diff(times) - step) <= max(EVEN * step, 4e-16 * np.abs(times).max())))
    if not step > 0 or len(off):
        k = int(off[0]) + 1 if len(off) else 1
        where = f"{path}:{numbers[k]}" if numbers else f"{path}: row {k + 1}"
        raise ValueError(
            f"{where}: times must rise in equal steps, got {times[k - 1]:.9g} s and then {times[k]:.9g} s where the mean "
            f"step is {step:.6g} s; resample the record"
        )
    if dt is not None and abs(dt - step) > EVEN * step:
        raise ValueError(f"{path}: dt = {dt:g} s was given, but the times in it are {step:g} s apart; leave dt out")
    return _finished(path, values, float(step), units)


def _finished(path: Path, values: np.ndarray, dt: float, units: str | None) -> Motion:
    if len(values) < 2:
        raise ValueError(f"{path}: holds {len(values)} sample; a record has at least two")
    if not np.isfinite(values).all():
        raise ValueError(f"{path}: sample {int(np.argmin(np.isfinite(values))) + 1} is not a finite number")
    assert units is not None
    return Motion(UNITS[units] * values, dt)
