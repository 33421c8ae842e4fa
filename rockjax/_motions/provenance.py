"""Provenance of the records of a result: name, source, sampling, PGA (peak ground acceleration) and checksum.

Result files store these values as attributes. The checksum is the SHA-256 of the samples.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from rockjax._excitations.ground import GroundMotion
from rockjax._parameters.registry import as_variable

from .convert import flatten_motions
from .motion import Motion, Motions
from .record import Record
from .records import RecordPairs, Records


def sha256(samples: Any) -> str:
    """Return the SHA-256 of the bytes of samples [m/s²] in little-endian float64."""
    return hashlib.sha256(np.ascontiguousarray(samples, "<f8").tobytes()).hexdigest()


def describe_record(record: Record) -> dict[str, Any]:
    """Return attributes that identify a record: number of samples, dt [s], PGA with the factor `scale`
    [m/s²], and checksum of the samples without this factor."""
    samples = np.asarray(record.acceleration, float)
    return {
        "record_samples": samples.size,
        "record_dt_s": float(record.dt),
        "record_pga_m_s2": float(abs(record.scale)) * float(np.abs(samples).max(initial=0.0)),
        "record_sha256": sha256(samples),
    }


def describe_origin(motion: Any) -> tuple[tuple[str, str | float], ...]:
    """Return the name of a `Motion` as an attribute, and its source, scale factor and seed if it has them.
    The attributes of a vertical component have the prefix `vertical_`. For other excitations, return an empty
    tuple."""
    if not isinstance(motion, Motion):
        return ()
    attributes: dict[str, Any] = {"record_name": motion.name}
    if motion.source is not None:
        attributes["record_source"] = str(motion.source)
    for key in ("scale", "seed"):
        if key in motion.metadata:
            attributes[f"record_{key}"] = motion.metadata[key]
    vertical = describe_origin(motion.vertical)
    return (*attributes.items(), *((f"vertical_{name}", value) for name, value in vertical))


def describe_motions(excitations: Any) -> dict[str, Any]:
    """Return attributes that describe one record or several. For several records, the value of each attribute
    is a list with one element per record. For other excitations, return an empty dictionary.

    - `Record`: number of samples, dt, PGA and checksum
    - `Motion`, `Motions`: in addition, the attributes of `describe_origin`
    - `Records`, `RecordPairs`: dt, PGA and checksum
    - a list of motions: the attributes of its records. A motion without an attribute has the value "", NaN
      for a number, or 1 for a scale factor. For a list without records, the result is empty

    If there is a vertical component, samples, dt, PGA and checksum are those of the horizontal one.
    """
    if isinstance(excitations, Motion):
        record = excitations.record()
        record = record.horizontal if isinstance(record, GroundMotion) else record
        assert isinstance(record, Record)
        return describe_record(record) | dict(describe_origin(excitations))
    if isinstance(excitations, list | tuple | Motions):
        rows = [describe_motions(y) for y in flatten_motions("describe_motions", excitations, "excitations")]
        names = dict.fromkeys(name for row in rows for name in row)
        return {name: [row.get(name, _missing(name)) for row in rows] for name in names}
    if isinstance(excitations, GroundMotion) and not isinstance(excitations, RecordPairs):
        return describe_motions(excitations.horizontal)
    if isinstance(excitations, Records | RecordPairs):
        coords = record_coords(excitations)
        names = {"dt": "record_dt_s", "PGA": "record_pga_m_s2", "sha256": "record_sha256"}
        return {name: np.asarray(coords[key][1]).tolist() for key, name in names.items()}
    is_single = isinstance(excitations, Record) and np.ndim(excitations.acceleration) == 1
    return describe_record(excitations) if is_single and not np.ndim(excitations.scale) else {}


_NUMBERS = ("record_samples", "record_dt_s", "record_pga_m_s2")


def _missing(name: str) -> str | float:
    """Return the value of an attribute for motions without it: 1 for a scale factor, NaN for other numbers,
    except the seed, otherwise ""."""
    if name.endswith("record_scale"):
        return 1.0
    return float("nan") if name in _NUMBERS else ""


def record_coords(records: Records | RecordPairs, argument: Any = None) -> dict[str, Any]:
    """Return dataset coordinates along the dimension `record` that identify records: dt [s], PGA [m/s²] and
    checksum of every record; for pairs, of the horizontal record. If `argument`, the motions from which the
    table was made, gives a source file or a seed for every record, these are further coordinates."""
    table = records.horizontal if isinstance(records, GroundMotion) else records
    assert isinstance(table, Records)
    rows = [
        np.asarray(row, float)[: int(count)]
        for row, count in zip(np.asarray(table.acceleration), np.asarray(table.counts), strict=True)
    ]
    pga = np.array([np.abs(row).max(initial=0.0) for row in rows])
    members = [] if argument is None else flatten_motions("record_coords", argument, "motions")
    origins = [dict(describe_origin(motion)) for motion in members]
    optional = {}
    for name, long_name in (("source", "file of the record"), ("seed", "seed of the synthetic motion")):
        values = [origin[f"record_{name}"] for origin in origins if f"record_{name}" in origin]
        if len(values) == len(rows):
            optional[name] = ("record", values, {"long_name": long_name})
    return optional | {
        "dt": as_variable("record", np.asarray(table.intervals), "s", "sampling interval"),
        "PGA": as_variable("record", pga, "m s-2", "largest ground acceleration of the record"),
        "sha256": ("record", list(map(sha256, rows)), {"long_name": "SHA-256 of the samples, <f8 in m/s²"}),
    }
