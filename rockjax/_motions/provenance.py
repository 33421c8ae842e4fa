"""Identity of the record of a result: its name, source and distinguishing numbers."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from rockjax._excitations.ground import GroundMotion

from .motion import Motion
from .record import Record
from .records import RecordPairs, Records


def sha256(samples: Any) -> str:
    """SHA-256 of samples [m/s²], as little-endian float64."""
    return hashlib.sha256(np.ascontiguousarray(samples, "<f8").tobytes()).hexdigest()


def describe_record(record: Record) -> dict[str, Any]:
    """Samples of a record for the attributes of a file: their number, dt, PGA times the scale of the record,
    checksum without that."""
    samples = np.asarray(record.acceleration, float)
    return {
        "record_samples": samples.size,
        "record_dt_s": float(record.dt),
        "record_pga_m_s2": float(abs(record.scale)) * float(np.abs(samples).max(initial=0.0)),
        "record_sha256": sha256(samples),
    }


def origin(motion: Any) -> tuple[tuple[str, str | float], ...]:
    """Name, source, factor and seed of a `Motion` and of its vertical one, for the attributes of a file;
    nothing of other excitations."""
    if not isinstance(motion, Motion):
        return ()
    found: dict[str, Any] = {"record_name": motion.name}
    if motion.source is not None:
        found["record_source"] = str(motion.source)
    for key in ("scale", "seed"):
        if key in motion.metadata:
            found[f"record_{key}"] = motion.metadata[key]
    vertical = origin(motion.vertical)
    return (*found.items(), *((f"vertical_{name}", value) for name, value in vertical))


def record_coords(records: Records | RecordPairs) -> dict[str, Any]:
    """Coordinates along `record` that tell records from others: dt, PGA, checksum of the samples."""
    table = records.horizontal if isinstance(records, GroundMotion) else records
    assert isinstance(table, Records)
    rows = [
        np.asarray(row, float)[: int(count)]
        for row, count in zip(np.asarray(table.acceleration), np.asarray(table.counts), strict=True)
    ]
    pga = np.array([np.abs(row).max(initial=0.0) for row in rows])
    about = {"units": "m s-2", "long_name": "largest ground acceleration of the record"}
    return {
        "dt": ("record", np.asarray(table.intervals), {"units": "s", "long_name": "sampling interval"}),
        "PGA": ("record", pga, about),
        "sha256": ("record", list(map(sha256, rows)), {"long_name": "SHA-256 of the samples, <f8 in m/s²"}),
    }
