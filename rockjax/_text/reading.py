"""Text files in the encodings that editors and spreadsheets write."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterator
from pathlib import Path

# Byte order marks → encodings. UTF-32 precedes UTF-16, because the little-endian mark of UTF-32 begins with
# that of UTF-16.
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:e[+-]?\d+)?", re.I)
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f\x7f]")


def read_text(path: str | Path, *, utf8_only: bool = False) -> str:
    """Return the text of a file, decoded by `decode`. Raises `ValueError`, with the file and the cause, if
    the file cannot be read or is not text."""
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: the file cannot be read: {error.strerror}") from None
    except ValueError as error:  # the path contains a NUL character
        raise ValueError(f"{path}: the file cannot be read: {error}") from None
    return decode(path, content, utf8_only=utf8_only)


def decode(path: str | Path, content: bytes, *, utf8_only: bool = False) -> str:
    """Return the text in the bytes of a file.

    - `path`: path of the file, for error messages
    - `content`: bytes in UTF-8, or in UTF-16 or UTF-32 with a byte order mark. Other bytes are read as
      Windows-1252, because some files have names of stations in this encoding
    - `utf8_only`: whether to reject content in Windows-1252

    Raises `ValueError`, with the file, the line and the cause, if the content is not text.
    """
    if content.startswith((b"\x1f\x8b", b"PK\x03\x04")):
        raise ValueError(
            f"{path}: the file is packed (gzip, zip or .xlsx); unpack it, or save a spreadsheet as CSV"
        )
    if content.rstrip().endswith(b"\x1a"):
        content = content.rstrip(b"\x1a \t\r\n")  # CP/M and DOS mark the end of a file by 0x1a
    encoding = next((name for mark, name in _MARKS if content.startswith(mark)), None)
    try:
        text = content.decode(encoding or "utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        if encoding or utf8_only:
            raise ValueError(
                f"{path}:{line}: the text is not {(encoding or 'utf-8').removesuffix('-sig').upper()}: byte "
                f"0x{content[error.start]:02x} at offset {error.start}; save the file as UTF-8"
            ) from None
        text = content.decode("cp1252", errors="replace")
    if control := _CONTROL.search(text):
        line = text.count("\n", 0, control.start()) + 1
        cure = "; if it is UTF-16, save it as UTF-8" if text.count("\0") > len(text) / 4 else ""
        raise ValueError(
            f"{path}:{line}: the file is not text: character 0x{ord(control[0]):02x} at offset "
            f"{control.start()}{cure}"
        )
    return text


def csv_rows(path: str | Path, text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and the cells of each row of a CSV table. Empty rows, blanks around cells, and
    empty cells at the end of a row are left out. If the first row contains a semicolon or a tab, it separates
    the cells, and a comma in a number is a decimal comma. Raises `ValueError`, with the path, for text that
    is not CSV."""
    first_row = text.strip().partition("\n")[0]
    delimiter = next((mark for mark in ";\t" if mark in first_row), ",")
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if delimiter != ",":
                cells = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells]
            while cells and not cells[-1]:
                cells.pop()
            if cells:
                yield reader.line_num, cells
    except csv.Error as error:
        raise ValueError(f"{path}: the file is not a CSV table: {error}") from None


def csv_table(path: str | Path, text: str) -> tuple[list[str], Iterator[tuple[str, dict[str, str]]]]:
    """Return the headings in the first row of a CSV table, and an iterator over the other rows.

    For each row, the iterator yields the location (path and line), and a dict heading → cell of the cells
    that are not empty. Raises `ValueError` for equal headings. The iterator raises `ValueError` for a row
    with more cells than headings.
    """
    rows = csv_rows(path, text)
    first_line, names = next(rows, (1, []))
    if len(set(names)) != len(names):
        raise ValueError(f"{path}:{first_line}: two columns have the same name; rename or remove one")
    return names, _by_heading(path, names, rows)


def _by_heading(
    path: str | Path, names: list[str], rows: Iterator[tuple[int, list[str]]]
) -> Iterator[tuple[str, dict[str, str]]]:
    for line, cells in rows:
        if len(cells) > len(names):
            raise ValueError(
                f"{path}:{line}: the line has {len(cells)} cells, but there are {len(names)} headings; "
                "quote cells that contain commas"
            )
        yield f"{path}:{line}", {name: cell for name, cell in zip(names, cells, strict=False) if cell}
