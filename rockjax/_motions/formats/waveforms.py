"""Binary waveforms, read by ObsPy: miniSEED, SAC, GSE2."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from .base import Component, Samples, abbreviate, choose_channel, first_line

# Categories of warnings that concern the code of ObsPy, and not the data.
_CODE_WARNINGS = (
    DeprecationWarning,
    PendingDeprecationWarning,
    FutureWarning,
    ImportWarning,
    ResourceWarning,
)
WAVEFORMS = {".mseed": "MSEED", ".miniseed": "MSEED", ".sac": "SAC", ".gse2": "GSE2"}


def read(path: Path, content: bytes, component: Component) -> Samples:
    """Read the samples of a channel with ObsPy. These formats do not state the unit of the samples. Raises
    `ValueError` if ObsPy is not installed or cannot read the file, or if the channel has gaps, overlaps or a
    sampling interval that changes."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings of ObsPy's plug-ins
            import obspy
    except ImportError:
        raise ValueError(
            f"{path}: {path.suffix} files need ObsPy; install it with: pip install 'rockjax[records]'"
        ) from None
    file_format = WAVEFORMS[path.suffix.lower()]
    # By default, ObsPy rounds the interval in SAC files to microseconds.
    options = {"round_sampling_interval": False} if file_format == "SAC" else {}
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            traces: list[Any] = list(obspy.read(io.BytesIO(content), format=file_format, **options))
    except Exception as error:  # plug-ins may raise anything
        # If ObsPy does not recognise the format, its message quotes the stream.
        is_unrecognised = "BytesIO" in str(error)
        cause = "" if is_unrecognised else f" ({abbreviate(' '.join(str(error).split()), 120)})"
        raise ValueError(
            f"{path}: ObsPy cannot read the file: it is damaged, cut short or has another format{cause}"
        ) from None
    if not traces:
        raise ValueError(f"{path}: the file contains no trace")
    segments: dict[str, list[Any]] = {}  # traces of each channel
    for trace in traces:
        segments.setdefault(trace.id, []).append(trace)
    channels = [(k, channel[0].stats.channel) for k, channel in enumerate(segments.values(), start=1)]
    trace = _join(path, list(segments.values())[choose_channel(path, channels, component)])
    is_counts = trace.data.dtype.kind in "iu" and trace.stats.calib == 1
    metadata = {
        "format": str(trace.stats.get("_format", "")),
        "date": str(trace.stats.starttime),
        "station": f"{trace.stats.network}.{trace.stats.station}".strip("."),
        "component": trace.stats.channel,
    }
    data_warnings = [warning for warning in caught if not issubclass(warning.category, _CODE_WARNINGS)]
    excess = len(content) % trace.stats.mseed.record_length if "mseed" in trace.stats else 0
    if data_warnings:
        metadata["damaged"] = (
            f"ObsPy warns {len(data_warnings)} times: {first_line(data_warnings[0].message)}"
        )
    elif excess:
        metadata["damaged"] = f"its last {excess} bytes are an incomplete data block; the file was cut short"
    values = np.asarray(trace.data, float) * trace.stats.calib
    dt = float(trace.stats.delta)
    if file_format == "SAC":
        dt = float(str(np.float32(dt)))  # the interval is float32 in SAC: 0.01, not 0.0099999998
    if not dt > 0:
        raise ValueError(f"{path}: the sampling interval must be > 0 s, got {dt:g}")
    dt_statement = f"{path}: the sampling interval is {dt:g} s"
    raw_location = "whole numbers" if is_counts else ""
    return Samples(values, dt, None, metadata, None, dt_statement, raw_location=raw_location)


def _join(path: Path, segments: list[Any]) -> Any:
    """Return the traces of a channel, joined to one trace. Raises `ValueError` for gaps and overlaps, and for
    a sampling interval that changes."""
    import obspy

    stream = obspy.Stream(segments)
    if len({segment.stats.delta for segment in segments}) > 1:
        raise ValueError(
            f"{path}: the sampling interval of {segments[0].id} changes; resample the channel, or keep "
            "only the part with the motion"
        )
    if gaps := stream.get_gaps():
        start, end, missing = gaps[0][4], gaps[0][5], int(gaps[0][7])
        kind = "gaps" if missing > 0 else "overlaps"
        raise ValueError(
            f"{path}: {segments[0].id} has {len(gaps)} {kind}, the first of {abs(missing)} samples from "
            f"{start} to {end}; keep only the part with the motion"
        )
    trace: Any = next(iter(stream.merge()))
    if isinstance(trace.data, np.ma.MaskedArray):
        raise ValueError(f"{path}: {trace.id} has gaps; keep only the part with the motion")
    return trace
