"""Hazard curves and fragility models in files: CSV, OpenQuake's hazard-curve CSV, and NRML 0.5.

NRML is the XML format of OpenQuake. OpenQuake calls intensity measures imt, and intensities iml. P is the
probability of failure at an intensity.
"""

from __future__ import annotations

import csv
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rockjax._checks import as_strings, require_positive
from rockjax._files import write_atomically
from rockjax._motions.formats.table import split_headings
from rockjax._motions.headings import Heading, parse_heading
from rockjax._motions.intensity import period_of
from rockjax._parameters.registry import as_variable
from rockjax._text.reading import read_text
from rockjax._units import INTENSITY_UNITS, STANDARD_GRAVITY, UNITS, in_si, unit_of, unit_of_measure

if TYPE_CHECKING:
    import xarray

NRML = "http://openquake.org/xmlns/nrml/0.5"
MIN_IML = "1e-10"  # minIML written for a curve that has none [unit of the file]
# A curve with the median m and the dispersion β, but without an upper limit, is written with
# maxIML = m e^(7β), where 1 − P = 1e-12. If a lower limit of the curve is above m, this limit replaces m.
MAX_DEVIATIONS = 7.0


def read_hazard(path: str | Path, site: int | None) -> dict[str, Any]:
    """Return the arguments of `Hazard`, by name, from a file; the arguments are as for `Hazard.from_file`."""
    lines = read_text(path).splitlines()
    rows = [_Row.parse(number, line, _delimiter(lines)) for number, line in enumerate(lines, 1)]
    rows = [row for row in rows if any(row.cells)]
    comments = [row for row in rows if row.is_comment]
    rows = [row for row in rows if not row.is_comment]
    if not rows:
        raise ValueError(f"{path}: the file is empty; expected a hazard curve")
    if sum(cell.startswith("poe-") for cell in rows[0].cells) > 1:
        return _read_openquake(path, rows, comments, site)
    if site is not None:
        raise ValueError(
            f"{path}: site applies only to hazard-curve files of OpenQuake; this file has another format, so "
            "leave site out"
        )
    return _read_two_columns(path, rows, comments)


class _Row(NamedTuple):
    """A line of a table: its number from 1, its text and its cells."""

    line: int
    text: str
    cells: list[str]

    @classmethod
    def parse(cls, number: int, line: str, delimiter: str) -> _Row:
        cells = line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter), [])
        cells = [cell.strip() for cell in cells]
        if delimiter != ",":  # then a comma in a number is a decimal comma
            cells = [
                with_point if _as_number(with_point := cell.replace(",", ".")) is not None else cell
                for cell in cells
            ]
        return cls(number, line, cells)

    @property
    def is_comment(self) -> bool:
        return self.text.lstrip().startswith(("#", '"#'))

    @property
    def has_numbers(self) -> bool:
        first = next(filter(None, self.cells), "")
        return _as_number(first) is not None

    def number(self, path: str | Path, column: int) -> float:
        """Return the number in the column with this index. If there is none, raises a `ValueError` that names
        file, line, column and cell."""
        cell = self.cells[column] if column < len(self.cells) else ""
        number = _as_number(cell)
        if number is None:
            raise ValueError(f"{path}:{self.line}: expected a number in column {column + 1}, got {cell!r}")
        return number


def _delimiter(lines: list[str]) -> str:
    """Return the delimiter of a table: the first of semicolon, tab, comma and blank that the last line that
    is not empty contains; a comma if it contains none of them."""
    last_line = next((line for line in reversed(lines) if line.strip()), "")
    return next((mark for mark in ";\t, " if mark in last_line.strip()), ",")


def _as_number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def _read_two_columns(path: str | Path, rows: list[_Row], comments: list[_Row]) -> dict[str, Any]:
    """Return the arguments of `Hazard` from a table with two columns: intensities; and rates, return periods
    or probabilities."""
    data_rows = [k for k, row in enumerate(rows) if row.has_numbers]
    first = data_rows[0] if data_rows else len(rows)
    count = max(len(row.cells) for row in rows[first:] or rows)
    # A line with a single cell is a title.
    heading_rows = [row for row in rows[:first] if sum(map(bool, row.cells)) > 1] or comments[-1:]
    heading_texts = _headings(
        [split_headings(row.text, count) or _uncommented(row) for row in heading_rows], rows
    )
    headings = [parse_heading(str(path), text) for text in heading_texts]
    columns = [k for k, heading in enumerate(headings) if heading.kind not in ("index", "time")]
    rate_columns = [k for k in columns if headings[k].kind in ("probability", "rate", "return period")]
    intensity_columns = [k for k in columns if k not in rate_columns]
    heading_text = ", ".join(repr(text) for text in heading_texts) or repr(rows[0].text[:60])
    if len(rate_columns) != 1 or len(intensity_columns) != 1 or headings[intensity_columns[0]].unit is None:
        raise ValueError(
            f"{path}: expected two columns, whose headings name the measure with its unit, and how often it "
            "is exceeded, such as 'PGA [g],annual_rate', 'PGA [g],PoE in 50 years' or 'PGA [g],return "
            f"period [years]'; got {heading_text}"
        )
    intensity_heading, rate_heading = headings[intensity_columns[0]], headings[rate_columns[0]]
    factor, units = _si_unit(path, intensity_heading)
    for row in rows[first:]:
        if any(_as_number(cell) is not None for cell in row.cells[len(headings) :]):
            raise ValueError(
                f"{path}:{row.line}: the line has more numbers than the {len(headings)} headings; separate "
                "columns with semicolons if commas are decimal commas"
            )
    values = np.array(
        [[row.number(path, k) for k in (intensity_columns[0], rate_columns[0])] for row in rows[first:]]
    )
    levels, rates = _annual_rates(path, rate_heading, values.reshape(-1, 2), _investigation_years(comments))
    if levels.size and levels[0] > levels[-1]:
        levels, rates = levels[::-1], rates[::-1]
    measure = intensity_heading.quantity
    return {"intensity": levels * factor, "annual_rate": rates, "measure": measure, "units": units}


def _uncommented(row: _Row) -> list[str]:
    """Return the cells of a row; if it is a comment, without the leading #."""
    return [row.cells[0].lstrip('"# '), *row.cells[1:]]


def _headings(lines: list[list[str]], rows: list[_Row]) -> list[str]:
    """Return the headings of the columns of a table. The first of `lines` contains names, further lines
    contain units. If a heading contains a comma, `lines` has it in two cells, and they are joined again."""
    cells = [cell.strip() for cell in lines[0]] if lines else []
    for line in lines[1:]:
        units = [text.strip(" []()") for text in line] + [""] * (len(cells) - len(line))
        cells = [f"{cell} [{unit}]" if unit else cell for cell, unit in zip(cells, units, strict=False)]
    columns = len(rows[-1].cells)
    while len(cells) > columns:
        continued = (
            k for k in range(1, len(cells)) if unit_of(cells[k]) or re.match(r"[\d.]+ *y|in ", cells[k])
        )
        k = next(continued, None)
        if k is None:
            break
        cells[k - 1 : k + 1] = [f"{cells[k - 1]}, {cells[k]}"]
    return cells


def _si_unit(path: str | Path, heading: Heading) -> tuple[float, str]:
    """Return the factor from a heading's unit to the SI unit, and the name of the SI unit."""
    factor_and_unit = in_si(heading.unit or "")
    if factor_and_unit is None:
        raise ValueError(
            f"{path}: heading {heading.text.strip()!r}: unit must be one of {', '.join(INTENSITY_UNITS)}, "
            f"got {heading.unit!r}"
        )
    return factor_and_unit


def _investigation_years(comments: list[_Row]) -> float | None:
    """Return the investigation time in the comments of a file [years]; None if they state none."""
    match = re.search(
        r"(?<!risk.)investigation[ _]time\W{0,4}([0-9.eE+]+)", " ".join(row.text for row in comments), re.I
    )
    return None if match is None else float(match[1])


def _annual_rates(
    path: str | Path, heading: Heading, table: np.ndarray, years: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return intensities, in the unit of the table, and their annual rates [1/year]. Points whose probability
    of exceedance is 0 or 1 are left out.

    - `heading`: heading of the second column
    - `table`: intensities in the first column; rates, return periods [years] or probabilities in the second,
      shape (n, 2)
    - `years`: investigation time of probabilities, used if their heading states none [years]; None if unknown
    """
    quoted = f"{path}: heading {heading.text.strip()!r}"
    if re.search(r"\b(?:non|not)\b[\s_-]*exc|\bsurviv|\blog(?:10)?\b|\bln\b", heading.text, re.I):
        raise ValueError(
            f"{quoted}: the column must have rates, return periods or probabilities of exceedance; convert it"
        )
    x, values = table[:, 0], table[:, 1] * (UNITS["%"].factor if heading.unit == "%" else 1.0)
    if heading.kind == "rate":
        if re.search(r"\d\s*-?\s*(?:years?|yrs?|a)\b", heading.text, re.I):
            raise ValueError(
                f"{quoted}: rates must be annual; convert them and call the column 'annual_rate'"
            )
        return x, values
    if heading.kind == "return period":
        if np.any(values <= 0):
            raise ValueError(f"{quoted}: return periods must be > 0, got {values.min():g}")
        return x, 1 / values
    years = years if heading.years is None else heading.years
    if years is None:
        raise ValueError(
            f"{quoted}: the probability needs an investigation time; write for instance 'PoE in 50 years'"
        )
    return _rates_of_probabilities(quoted, x, values, years)


def _rates_of_probabilities(
    owner: str, x: np.ndarray, poe: np.ndarray, years: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return intensities and their annual rates −ln(1 − p)/t [1/year], without points with p = 0 or 1. `poe`
    are the probabilities of exceedance p in the investigation time t, `years`; `x` and `poe` have the shape
    (n,)."""
    if not (np.isfinite(years) and years > 0):
        raise ValueError(f"{owner}: the investigation time must be > 0 years, got {years:g}")
    if np.any(~((poe >= 0) & (poe <= 1))):
        raise ValueError(
            f"{owner}: probabilities of exceedance must be in 0 … 1, got {poe.min():g} … {poe.max():g}"
        )
    # At p = 0 and p = 1, ln λ is not finite.
    is_usable = (poe > 0) & (poe < 1)
    if is_usable.sum() < 2:
        raise ValueError(
            f"{owner}: a curve needs at least two probabilities > 0 and < 1, but this one has "
            f"{int(is_usable.sum())}"
        )
    return x[is_usable], -np.log1p(-poe[is_usable]) / years


def _read_openquake(
    path: str | Path, rows: list[_Row], comments: list[_Row], site: int | None
) -> dict[str, Any]:
    """Return the arguments of `Hazard` from one row of a hazard-curve CSV of OpenQuake."""
    columns = [k for k, cell in enumerate(rows[0].cells) if cell.startswith("poe-")]
    years = _investigation_years(comments)
    imt = re.search(r"imt\s*[=:]\s*['\"]?([A-Za-z]+(?:\([0-9.]+\))?)", " ".join(row.text for row in comments))
    if years is None or imt is None:
        raise ValueError(
            f"{path}: a comment must state investigation_time and imt, as in the first line of OpenQuake's "
            "files"
        )
    curves = rows[1:]
    if not curves:
        raise ValueError(f"{path}: the file has headings, but no curve below them")
    if len(curves) > 1 and site is None:
        raise ValueError(
            f"{path}: the file has the curves of {len(curves)} sites; choose one by site = 0 … "
            f"{len(curves) - 1}"
        )
    if not 0 <= (site or 0) < len(curves):
        raise ValueError(f"{path}: site must be in 0 … {len(curves) - 1}, got {site!r}")
    # Some versions of OpenQuake append a colon and the data type to the name of a column.
    levels = [cell.removeprefix("poe-").split(":")[0] for cell in rows[0].cells]
    # Intensities are read as cells of the heading row, so that errors name the line and column of the file.
    heading_row = rows[0]._replace(cells=levels)
    x = np.array([heading_row.number(path, k) for k in columns])
    poe = np.array([curves[site or 0].number(path, k) for k in columns])
    x, rates = _rates_of_probabilities(str(path), x, poe, years)
    measure, unit = _measure(path, imt[1])
    factor, units = UNITS[unit].factor, unit_of_measure(measure)
    return {"intensity": x * factor, "annual_rate": rates, "measure": measure, "units": units}


def _measure(path: str | Path, imt: str) -> tuple[str, str]:
    """Return rockjax's name of the measure that OpenQuake calls `imt`, and OpenQuake's unit of it."""
    if imt == "PGA":
        return "PGA", "g"
    if imt == "PGV":
        return "PGV", "cm/s"
    if match := re.fullmatch(r"SA\((\d+\.?\d*|\.\d+)\)", imt):
        return f"Sa({float(match[1]):g} s)", "g"
    raise ValueError(f"{path}: intensity measure must be PGA, PGV or SA(T), got {imt!r}")


def _imt(measure: str) -> tuple[str, float]:
    """Return OpenQuake's name of a measure, and the factor that converts OpenQuake's unit to SI."""
    period = period_of("write_fragility_model", measure)
    name = measure if period is None else f"SA({period:g})"
    return name, UNITS["cm/s"].factor if measure == "PGV" else STANDARD_GRAVITY


def si_factor(owner: str, measure: str, units: str) -> float:
    """Return the factor that converts the units of an intensity measure to SI. Raises `ValueError`, with
    `owner` in the message, if `units` is not a unit of the measure."""
    factor, si_unit = in_si(units) or (1.0, None)
    if si_unit != unit_of_measure(measure):
        raise ValueError(f"{owner}: {units!r} is not a unit of the intensity measure {measure}")
    return factor


def write_fragility_model(
    path: str | Path,
    fragilities: xarray.Dataset | Sequence[xarray.Dataset],
    names: Sequence[str] | None = None,
) -> Path:
    """Write lognormal fragility curves as an OpenQuake fragility model (NRML 0.5), atomically.

    - `path`: file to write
    - `fragilities`: one or more datasets of [`rockjax.fragility`][] or [`rockjax.read_fragility_model`][]
    - `names`: names of the structures, one for each dataset and all different; None for `structure-1` …

    NRML describes a curve by the mean and the standard deviation of the intensity, in g (PGA, Sa) or cm/s
    (PGV). With the median m and the dispersion β, `mean` = m e^(β²/2) and `stddev` = mean √(e^(β²) − 1).
    Limits that were read from a file are written unchanged. OpenQuake requires both minIML and maxIML. A
    curve without minIML gets minIML = 1e-10. A curve without maxIML gets maxIML = m e^(7β), where the
    probability of failure is 1 − 1e-12. If a lower limit is above m, this limit replaces m.

    Returns the path. Raises `ValueError` for other datasets, for measures other than PGA, PGV and Sa(T s),
    and if `names` are not different strings, one for each dataset.
    """
    owner = "write_fragility_model"
    curves = list(fragilities) if isinstance(fragilities, Sequence) else [fragilities]
    labels = [f"structure-{k}" for k in range(1, len(curves) + 1)]
    labels = labels if names is None else list(as_strings(owner, "names", names))
    are_strings = all(isinstance(label, str) for label in labels)
    if not curves or not are_strings or len(labels) != len(curves) or len({*labels}) != len(labels):
        raise ValueError(
            f"{owner}: names must be different strings, one for each of {len(curves)} curves, got {names!r}"
        )
    ET.register_namespace("", NRML)
    root = ET.Element(f"{{{NRML}}}nrml")
    model = ET.SubElement(
        root,
        f"{{{NRML}}}fragilityModel",
        {"id": "rockjax", "assetCategory": "structures", "lossCategory": "structural"},
    )
    ET.SubElement(model, f"{{{NRML}}}description").text = "Overturning of rocking structures"
    ET.SubElement(model, f"{{{NRML}}}limitStates").text = "overturning"
    for name, curve in zip(labels, curves, strict=True):
        if getattr(curve, "attrs", {}).get("kind") != "fragility":
            raise ValueError(
                f"{owner}: the curve of {name} must be a dataset of rockjax.fragility or "
                f"rockjax.read_fragility_model, got {type(curve).__name__}"
            )
        measure, units = curve.attrs["measure"], curve["median_capacity"].attrs["units"]
        imt, factor = _imt(measure)
        factor /= si_factor(owner, measure, units)
        median, dispersion = float(curve["median_capacity"]) / factor, float(curve["dispersion"])
        require_positive(f"{owner}: {name}", median=median, dispersion=dispersion)
        mean = median * math.exp(0.5 * dispersion**2)
        function = ET.SubElement(
            model, f"{{{NRML}}}fragilityFunction", {"id": name, "format": "continuous", "shape": "logncdf"}
        )
        ET.SubElement(function, f"{{{NRML}}}imls", {"imt": imt, **_limits_to_write(curve, factor)})
        moments = {"mean": repr(mean), "stddev": repr(mean * math.sqrt(math.expm1(dispersion**2)))}
        ET.SubElement(function, f"{{{NRML}}}params", {"ls": "overturning", **moments})
    ET.indent(root)
    return write_atomically(
        path, lambda name: ET.ElementTree(root).write(name, encoding="utf-8", xml_declaration=True)
    )


def read_fragility_model(path: str | Path) -> dict[str, xarray.Dataset]:
    """Return the lognormal curves of an OpenQuake fragility model (NRML 0.5), in SI units.

    - `path`: file to read

    Returns a dict of datasets, one for each curve. The key is the name of the structure, or
    `structure/limit state` if the structure has several limit states. A dataset has `median_capacity` and
    `dispersion`, and can be the `curve` of [`rockjax.annual_frequency`][]. It also has those of the limits
    `min_intensity` (minIML), `max_intensity` (maxIML) and `no_damage_limit` that the file contains. A limit
    of 0 means no limit, as in OpenQuake. With the probability of failure P:

    - Below `min_intensity` and above `max_intensity`, P equals its value at the limit.
    - Up to `no_damage_limit`, P = 0. If `min_intensity` is larger, `no_damage_limit` has no effect.

    Raises `ValueError` for other files, other shapes of curves, invalid numbers, and a maxIML that is not
    above both minIML and noDamageLimit.
    """
    try:
        model = ET.parse(path).getroot().find(f"{{{NRML}}}fragilityModel")
    except OSError as error:
        raise ValueError(f"{path}: the file cannot be read: {error.strerror or error}") from None
    except (ET.ParseError, LookupError, ValueError) as error:  # the last two are unknown encodings
        read_text(path, utf8_only=True)  # raises an error that names the line if the text is not UTF-8
        raise ValueError(f"{path}: the file is not valid XML: {error}") from None
    if model is None:
        raise ValueError(f"{path}: the file has no fragilityModel of NRML 0.5")
    curves: dict[str, xarray.Dataset] = {}
    for function in model.iter(f"{{{NRML}}}fragilityFunction"):
        name = function.get("id", f"structure-{len(curves) + 1}")
        if (function.get("format"), function.get("shape")) != ("continuous", "logncdf"):
            raise ValueError(
                f"{path}: {name} must be a continuous logncdf curve, got {function.get('format')} "
                f"{function.get('shape') or ''}"
            )
        imls, states = function.find(f"{{{NRML}}}imls"), function.findall(f"{{{NRML}}}params")
        if imls is None or not states:
            raise ValueError(f"{path}: {name} has no imls or no params")
        _require_limits_in_imls(path, name, imls, [function, *function])
        for state in states:
            label = name if len(states) == 1 else f"{name}/{state.get('ls')}"
            if label in curves:
                raise ValueError(f"{path}: the file has two curves of {label}; names must be different")
            curves[label] = _curve(path, label, imls, state)
    if not curves:
        raise ValueError(f"{path}: the file has no fragilityFunction")
    return curves


def _number(path: str | Path, name: str, element: ET.Element, key: str) -> float:
    """Return the number in the attribute `key` of an element; NaN if the element does not have the attribute.
    If it is not a number, raises a `ValueError` that names file, structure and attribute."""
    text = element.get(key, "nan")
    try:
        return float(text)
    except ValueError:
        cure = "; write its decimal comma as a point" if "," in text else ""
        raise ValueError(f"{path}: {name}: attribute {key} must be a number, got {text!r}{cure}") from None


# Names of the limits in NRML → names in datasets.
LIMITS = {
    "noDamageLimit": "no_damage_limit",
    "minIML": "min_intensity",
    "maxIML": "max_intensity",
}


def _require_limits_in_imls(
    path: str | Path, name: str, imls: ET.Element, elements: Sequence[ET.Element]
) -> None:
    """Raise `ValueError` if one of the elements of a curve, as element or as attribute, has a limit that
    OpenQuake would not find: outside `imls`, or in another spelling."""
    spellings = {key.casefold(): key for key in LIMITS}
    for element in elements:
        tag = element.tag.rpartition("}")[2]
        names = [tag, *(key for key in element.attrib if element is not imls or key not in LIMITS)]
        if misplaced := next((key for key in names if key.casefold() in spellings), None):
            raise ValueError(
                f"{path}: {name}: {misplaced} must be the attribute {spellings[misplaced.casefold()]} of imls"
            )


def _limits(path: str | Path, name: str, imls: ET.Element) -> dict[str, float]:
    """Return the limits of a curve by their names in datasets, in the unit of the file. Limits of 0 are left
    out."""
    limits = {key: _number(path, name, imls, key) for key in LIMITS if imls.get(key) is not None}
    for key, limit in limits.items():
        if not 0 <= limit < math.inf:
            raise ValueError(
                f"{path}: {name}: attribute {key} must be finite and >= 0, got {imls.get(key)!r}"
            )
    highest = limits.get("maxIML", 0.0)
    for key in ("noDamageLimit", "minIML"):
        if 0 < highest <= limits.get(key, 0.0):
            raise ValueError(f"{path}: {name}: {key} {limits[key]:g} must be below maxIML {highest:g}")
    return {LIMITS[key]: limit for key, limit in limits.items() if limit > 0}


def _limits_to_write(curve: xarray.Dataset, factor: float) -> dict[str, str]:
    """Return the limits of a curve as attributes of NRML; `factor` is OpenQuake's unit in units of the
    curve."""
    largest = max(float(curve[name]) for name in ("median_capacity", *LIMITS.values()) if name in curve)
    highest = largest / factor * math.exp(MAX_DEVIATIONS * float(curve["dispersion"]))
    stated = {key: f"{float(curve[name]) / factor:.15g}" for key, name in LIMITS.items() if name in curve}
    return {"minIML": MIN_IML, "maxIML": f"{highest:.15g}"} | stated


def _curve(path: str | Path, name: str, imls: ET.Element, state: ET.Element) -> xarray.Dataset:
    """Return the dataset of a limit state from its `params` and the `imls` of its structure."""
    import xarray

    measure, units = _measure(path, imls.get("imt", ""))
    factor, si_unit = UNITS[units].factor, unit_of_measure(measure)
    if (stated := imls.get("imlUnit")) is not None and unit_of(stated) != units:
        raise ValueError(
            f"{path}: {name}: imlUnit must be {units!r}, OpenQuake's unit of {measure}, got {stated!r}"
        )
    mean, deviation = (_number(path, name, state, key) for key in ("mean", "stddev"))
    require_positive(f"{path}: {name}", mean=mean, stddev=deviation)
    dispersion = math.sqrt(math.log1p((deviation / mean) ** 2))
    median = mean * math.exp(-0.5 * dispersion**2) * factor
    limits = {
        key: ((), limit * factor, {"units": si_unit}) for key, limit in _limits(path, name, imls).items()
    }
    return xarray.Dataset(
        {
            "median_capacity": as_variable((), median, si_unit, f"median overturning {measure}"),
            "dispersion": as_variable((), dispersion, "1", "standard deviation of the logarithm"),
            **limits,
        },
        attrs={"title": "Fragility", "kind": "fragility", "measure": measure, "units": si_unit},
    )
