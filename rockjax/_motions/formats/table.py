"""Columns of text, and NumPy's .npy."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from .base import EVEN, Component, Format, Samples, alone, first_line, number, unit

_SEPARATORS = re.compile(r"[,;\s]+")


def _array(path: Path) -> np.ndarray:
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise ValueError(f"{path}: is not a NumPy array of numbers: {first_line(error)}") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu" or array.ndim not in (1, 2):
        raise ValueError(f"{path}: is not a NumPy array of numbers in one column or two")
    return np.asarray(array, float).reshape(len(array), -1)


def _rows(path: Path, lines: list[str]) -> tuple[np.ndarray, list[int], str | None]:
    """The rows of a table of numbers, which lines they are, and the unit in brackets at the end of one row of
    headings."""
    rows: list[list[float]] = []
    numbers: list[int] = []
    heading: str | None = None
    for i, line in enumerate(lines, start=1):
        text = line.strip()
        if not text or text[0] in "#%!":
            continue
        words = [word for word in _SEPARATORS.split(text) if word]
        try:
            row = [number(path, i, word) for word in words]
        except ValueError:
            if rows or heading is not None or any(character.isdigit() for character in words[0] if words):
                raise
            heading = text
            continue
        if not row:
            raise ValueError(f"{path}:{i}: holds no number")
        if rows and len(row) != len(rows[0]):
            raise ValueError(f"{path}:{i}: has {len(row)} columns where the lines before have {len(rows[0])}")
        rows.append(row)
        numbers.append(i)
    if not rows:
        raise ValueError(f"{path}: holds no numbers")
    unit = re.search(r"\[([^\[\]]*)\]$", heading or "")
    return np.array(rows), numbers, unit[1] if unit else None


def columns(path: Path, rows: np.ndarray, numbers: list[int] | None, said: str | None = None) -> Samples:
    if rows.shape[1] > 2:
        raise ValueError(
            f"{path}: has {rows.shape[1]} columns; one (acceleration) or two (time, acceleration) can be read"
        )
    metadata = {"format": "table"}
    if rows.shape[1] == 1:
        return Samples(rows[:, 0], None, unit(said), metadata, said)
    times, values = rows.T
    if len(times) < 2:
        return Samples(values, None, unit(said), metadata, said)
    step = (times[-1] - times[0]) / (len(times) - 1)
    off = np.flatnonzero(~(np.abs(np.diff(times) - step) <= max(EVEN * step, 4e-16 * np.abs(times).max())))
    if not step > 0 or len(off):
        k = int(off[0]) + 1 if len(off) else 1
        where = f"{path}:{numbers[k]}" if numbers else f"{path}: row {k + 1}"
        raise ValueError(
            f"{where}: times must rise in equal steps, got "
            f"{times[k - 1]:.9g} s and then {times[k]:.9g} s where the mean "
            f"step is {step:.6g} s; resample the record"
        )
    return Samples(
        values, float(step), unit(said), metadata, said, f"{path}: the times in it are {step:g} s apart"
    )


def read_array(path: Path, component: Component) -> Samples:
    return alone(path, component, columns(path, _array(path), None))


def _read(path: Path, lines: list[str], component: Component) -> Samples:
    rows, numbers, units = _rows(path, lines)
    return alone(path, component, columns(path, rows, numbers, units))


FORMAT = Format("table", lambda path, lines: True, _read)
