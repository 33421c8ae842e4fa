"""Hazard curves and fragility models in files: CSV, OpenQuake's hazard-curve CSV, and NRML 0.5."""

from __future__ import annotations

import csv
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._files import write_whole
from rockjax._structures import STANDARD_GRAVITY
from rockjax._texts import read_text

from .units import SI

if TYPE_CHECKING:
    import xarray

NRML = "http://openquake.org/xmlns/nrml/0.5"
_HEADER = re.compile(r"^\s*(?P<measure>[^\[]+?)\s*\[\s*(?P<units>[^\]]+?)\s*\]\s*$")


def read_hazard(path: str | Path, site: int | None) -> dict[str, Any]:
    """The arguments of the `Hazard` in a file."""
    rows = [row for row in csv.reader(read_text(path).splitlines()) if any(cell.strip() for cell in row)]
    comments = [row for row in rows if row[0].lstrip().startswith("#")]
    rows = [row for row in rows if not row[0].lstrip().startswith("#")]
    if not rows:
        raise ValueError(f"{path}: is empty; expected a hazard curve")
    if any(cell.strip().startswith("poe-") for cell in rows[0]):
        found = _openquake(path, rows, ",".join(cell for row in comments for cell in row), site)
    else:
        if site is not None:
            raise ValueError(
                f"{path}: site is for OpenQuake's files of several sites; this one holds one curve"
            )
        found = _two_columns(path, rows)
    units = found["units"]
    if units not in SI:
        raise ValueError(
            f"{path}: units {units!r} of {found['measure']} are unknown; known are {', '.join(SI)}"
        )
    factor, found["units"] = SI[units]
    found["intensity"] = np.asarray(found["intensity"]) * factor
    return found


def _two_columns(path: str | Path, rows: list[list[str]]) -> dict[str, Any]:
    header = _HEADER.match(rows[0][0]) if len(rows[0]) == 2 else None
    if header is None:
        raise ValueError(
            f"{path}: expected two columns with a header that names the measure and its unit, such as "
            f"'PGA [g],annual_rate', got {','.join(rows[0])[:60]!r}"
        )
    try:
        x, rate = np.array([[float(cell) for cell in row] for row in rows[1:]]).T
    except ValueError as error:
        raise ValueError(
            f"{path}: every line after the header must hold an intensity and an annual rate: {error}"
        ) from None
    return {"intensity": x, "annual_rate": rate, "measure": header["measure"], "units": header["units"]}


def _openquake(path: str | Path, rows: list[list[str]], comment: str, site: int | None) -> dict[str, Any]:
    header = [cell.strip() for cell in rows[0]]
    columns = [i for i, cell in enumerate(header) if cell.startswith("poe-")]
    years = re.search(r"investigation_time\s*=\s*([0-9.eE+]+)", comment)
    imt = re.search(r"imt\s*=\s*['\"]?([A-Za-z]+(?:\([0-9.]+\))?)", comment)
    if years is None or imt is None:
        raise ValueError(
            f"{path}: the first line must say investigation_time and imt, as OpenQuake writes them"
        )
    curves = rows[1:]
    if len(curves) > 1 and site is None:
        raise ValueError(
            f"{path}: holds the curves of {len(curves)} sites; choose one with site=0 … {len(curves) - 1}"
        )
    if site is not None and not 0 <= site < len(curves):
        raise ValueError(f"{path}: site must be in 0 … {len(curves) - 1}, got {site!r}")
    x = np.array([float(header[i].removeprefix("poe-")) for i in columns])
    poe = np.array([float(curves[site or 0][i]) for i in columns])
    if np.any((poe < 0) | (poe > 1)):
        raise ValueError(
            f"{path}: probabilities of exceedance must be in 0 … 1, got {poe.min():g} … {poe.max():g}"
        )
    # What is certain, or never happens, has no rate: such points say nothing about the curve.
    known = (poe > 0) & (poe < 1)
    if known.sum() < 2:
        raise ValueError(f"{path}: needs at least two probabilities between 0 and 1, got {int(known.sum())}")
    measure, units = _measure(path, imt[1])
    return {
        "intensity": x[known],
        "annual_rate": -np.log1p(-poe[known]) / float(years[1]),
        "measure": measure,
        "units": units,
    }


def _measure(path: str | Path, imt: str) -> tuple[str, str]:
    """OpenQuake's intensity measure type in the words of this package, and its units there."""
    if imt == "PGA":
        return "PGA", "g"
    if imt == "PGV":
        return "PGV", "cm s-1"
    if imt.startswith("SA("):
        return f"Sa({float(imt[3:-1]):g} s)", "g"
    raise ValueError(f"{path}: intensity measure {imt!r} is not read; PGA, PGV and SA(T) are")


def _imt(measure: str) -> tuple[str, float]:
    """OpenQuake's name of a measure, and the unit there in SI."""
    if measure == "PGA":
        return "PGA", STANDARD_GRAVITY
    if measure == "PGV":
        return "PGV", 0.01
    period = re.fullmatch(r"Sa\(([0-9.eE+-]+) s\)", measure)
    if period is None:
        raise ValueError(
            f"write_fragility_model: OpenQuake has no intensity measure "
            f"{measure!r}; PGA, PGV and Sa(T s) are known"
        )
    return f"SA({float(period[1]):g})", STANDARD_GRAVITY


def write_fragility_model(
    path: str | Path,
    fragilities: xarray.Dataset | Sequence[xarray.Dataset],
    names: Sequence[str] | None = None,
) -> Path:
    """Write lognormal fragility curves as an OpenQuake fragility model (NRML 0.5), atomically (host).

    - `fragilities`: from [`rockjax.fragility`][], one or several over one measure; `names`: of the
      structures, by default `structure-1` …

    NRML holds mean and standard deviation of the intensity itself, in g (PGA, Sa) or cm/s (PGV); `mean` = m
    e^(β²/2), `stddev` = mean √(e^(β²) − 1). Raises `ValueError` for measures that OpenQuake does not know.
    """
    curves = list(fragilities) if isinstance(fragilities, Sequence) else [fragilities]
    names = [f"structure-{k}" for k in range(1, len(curves) + 1)] if names is None else list(names)
    if not curves or len(names) != len(curves):
        raise ValueError(
            f"write_fragility_model: needs a name for each of {len(curves)} curves, got {names!r}"
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
    for name, curve in zip(names, curves, strict=True):
        if curve.attrs.get("kind") != "fragility":
            raise ValueError(f"write_fragility_model: {name} must come from rockjax.fragility")
        imt, unit = _imt(curve.attrs["measure"])
        median, dispersion = float(curve["median_capacity"]) / unit, float(curve["dispersion"])
        mean = median * math.exp(0.5 * dispersion**2)
        at = curve["at"].values / unit
        function = ET.SubElement(
            model, f"{{{NRML}}}fragilityFunction", {"id": name, "format": "continuous", "shape": "logncdf"}
        )
        limits = {"noDamageLimit": "0", "minIML": repr(float(at[0])), "maxIML": repr(float(at[-1]))}
        ET.SubElement(function, f"{{{NRML}}}imls", {"imt": imt, **limits})
        moments = {"mean": repr(mean), "stddev": repr(mean * math.sqrt(math.expm1(dispersion**2)))}
        ET.SubElement(function, f"{{{NRML}}}params", {"ls": "overturning", **moments})
    ET.indent(root)
    return write_whole(
        path, lambda name: ET.ElementTree(root).write(name, encoding="utf-8", xml_declaration=True)
    )


def read_fragility_model(path: str | Path) -> dict[str, xarray.Dataset]:
    """The lognormal curves of an OpenQuake fragility model (NRML 0.5), in SI units, by the names of their
    structures (host).

    Several limit states of a structure are named `structure/limit state`. Each is a dataset with
    `median_capacity` and `dispersion`, as [`rockjax.annual_frequency`][] takes it. Raises `ValueError` for
    other files and other shapes of curves.
    """
    try:
        model = ET.parse(path).getroot().find(f"{{{NRML}}}fragilityModel")
    except ET.ParseError as error:
        raise ValueError(f"{path}: is no XML file: {error}") from None
    if model is None:
        raise ValueError(f"{path}: holds no fragilityModel of NRML 0.5")
    found: dict[str, xarray.Dataset] = {}
    for function in model.iter(f"{{{NRML}}}fragilityFunction"):
        name = function.get("id", f"structure-{len(found) + 1}")
        if (function.get("format"), function.get("shape")) != ("continuous", "logncdf"):
            raise ValueError(
                f"{path}: {name} is {function.get('format')} {function.get('shape') or ''}; "
                "continuous logncdf curves are read"
            )
        imls, states = function.find(f"{{{NRML}}}imls"), function.findall(f"{{{NRML}}}params")
        if imls is None or not states:
            raise ValueError(f"{path}: {name} has no imls or no params")
        for state in states:
            label = name if len(states) == 1 else f"{name}/{state.get('ls')}"
            found[label] = _curve(path, label, imls, state)
    if not found:
        raise ValueError(f"{path}: holds no fragilityFunction")
    return found


def _number(path: str | Path, name: str, element: ET.Element, key: str) -> float:
    """The number in an attribute. Raises `ValueError` that names file, structure, attribute and text."""
    text = element.get(key, "nan")
    try:
        return float(text)
    except ValueError:
        cure = "; write its decimal comma as a point" if "," in text else ""
        raise ValueError(f"{path}: {name}: attribute {key} must be a number, got {text!r}{cure}") from None


def _curve(path: str | Path, name: str, imls: ET.Element, state: ET.Element) -> xarray.Dataset:
    import xarray

    measure, units = _measure(path, imls.get("imt", ""))
    factor, si = SI[units]
    mean, deviation = (_number(path, name, state, key) for key in ("mean", "stddev"))
    if not (mean > 0 and deviation > 0):
        raise ValueError(f"{path}: {name} needs mean and stddev > 0, got {mean:g} and {deviation:g}")
    dispersion = math.sqrt(math.log1p((deviation / mean) ** 2))
    median = mean * math.exp(-0.5 * dispersion**2) * factor
    return xarray.Dataset(
        {
            "median_capacity": ((), median, {"units": si, "long_name": f"median overturning {measure}"}),
            "dispersion": (
                (),
                dispersion,
                {"units": "1", "long_name": "standard deviation of its logarithm"},
            ),
        },
        attrs={"title": "Fragility", "kind": "fragility", "measure": measure, "units": si},
    )
