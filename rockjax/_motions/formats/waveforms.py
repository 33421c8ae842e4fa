"""Waveforms that ObsPy reads: miniSEED, SAC, GSE2."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from .base import Component, Samples, choose_channel, first_line

_CODE_WARNINGS = (
    DeprecationWarning,
    PendingDeprecationWarning,
    FutureWarning,
    ImportWarning,
    ResourceWarning,
)
WAVEFORMS = {".mseed": "MSEED", ".miniseed": "MSEED", ".sac": "SAC", ".gse2": "GSE2"}


def read(path: Path, content: bytes, component: Component) -> Samples:
    """Read a trace with ObsPy; its units must be given by the user."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # from ObsPy's plug-ins
            import obspy
    except ImportError:
        raise ValueError(
            f"{path}: {path.suffix} is read by ObsPy; install it with: pip install 'rockjax[records]'"
        ) from None
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            traces: list[Any] = list(obspy.read(io.BytesIO(content), format=WAVEFORMS[path.suffix.lower()]))
    except Exception as error:  # plug-ins may raise anything
        cause = "it is of another format, or cut short" if "BytesIO" in str(error) else first_line(error)
        raise ValueError(f"{path}: ObsPy cannot read it: {cause}") from None
    if not traces:
        raise ValueError(f"{path}: holds no trace")
    pieces: dict[str, list[Any]] = {}  # of each channel
    for trace in traces:
        pieces.setdefault(trace.id, []).append(trace)
    channels = [(k, channel[0].stats.channel) for k, channel in enumerate(pieces.values(), start=1)]
    trace = _joined(path, list(pieces.values())[choose_channel(path, channels, component)])
    is_counts = trace.data.dtype.kind in "iu" and trace.stats.calib == 1
    metadata = {
        "format": str(trace.stats.get("_format", "")),
        "date": str(trace.stats.starttime),
        "station": f"{trace.stats.network}.{trace.stats.station}".strip("."),
        "component": trace.stats.channel,
    }
    data_warnings = [each for each in caught if not issubclass(each.category, _CODE_WARNINGS)]
    beyond = len(content) % trace.stats.mseed.record_length if "mseed" in trace.stats else 0
    if data_warnings:
        metadata["damaged"] = (
            f"ObsPy warns {len(data_warnings)} times: {first_line(data_warnings[0].message)}"
        )
    elif beyond:
        metadata["damaged"] = f"its last {beyond} bytes are no whole record; it was cut short"
    values = np.asarray(trace.data, float) * trace.stats.calib
    dt = float(trace.stats.delta)
    dt_place = f"{path}: the sampling interval is {dt:g} s"
    return Samples(values, dt, None, metadata, None, dt_place, raw_place="whole numbers" if is_counts else "")


def _joined(path: Path, pieces: list[Any]) -> Any:
    """Return the pieces of a channel as one trace. Raises `ValueError` that names the first gap."""
    import obspy

    stream = obspy.Stream(pieces)
    if len({piece.stats.delta for piece in pieces}) > 1:
        raise ValueError(
            f"{path}: {pieces[0].id} changes its sampling interval; resample it, or cut out the part that "
            "holds the motion"
        )
    if gaps := stream.get_gaps():
        start, end, missing = gaps[0][4], gaps[0][5], int(gaps[0][7])
        found = f"{len(gaps)} gaps" if missing > 0 else f"{len(gaps)} overlaps"
        raise ValueError(
            f"{path}: {pieces[0].id} has {found}, the first of {abs(missing)} samples from {start} to {end}; "
            "cut out the part that holds the motion"
        )
    trace: Any = next(iter(stream.merge()))
    if isinstance(trace.data, np.ma.MaskedArray):
        raise ValueError(f"{path}: {trace.id} has gaps; cut out the part that holds the motion")
    return trace
