"""Waveforms that ObsPy reads: miniSEED, SAC, GSE2."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np

from .base import Component, Samples, choose, first_line

WAVEFORMS = {".mseed": "MSEED", ".miniseed": "MSEED", ".sac": "SAC", ".gse2": "GSE2"}


def read(path: Path, content: bytes, component: Component) -> Samples:
    """A trace of whatever ObsPy reads; its units are for the user to know."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the plug-ins it looks up
            import obspy
    except ImportError:
        raise ValueError(
            f"{path}: {path.suffix} is read by ObsPy; install it with: pip install 'rockjax[records]'"
        ) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            traces = list(obspy.read(io.BytesIO(content), format=WAVEFORMS[path.suffix.lower()]))
    except Exception as error:  # of whatever kind its plug-ins raise
        raise ValueError(f"{path}: ObsPy cannot read it: {first_line(error)}") from None
    if not traces:
        raise ValueError(f"{path}: holds no trace")
    chosen = choose(path, [(k, trace.stats.channel) for k, trace in enumerate(traces, start=1)], component)
    trace = traces[chosen]
    if isinstance(trace.data, np.ma.MaskedArray):
        raise ValueError(f"{path}: {trace.id} has gaps")
    metadata = {
        "format": str(trace.stats.get("_format", "")),
        "date": str(trace.stats.starttime),
        "station": f"{trace.stats.network}.{trace.stats.station}".strip("."),
        "component": trace.stats.channel,
    }
    values = np.asarray(trace.data, float) * trace.stats.calib
    dt = float(trace.stats.delta)
    return Samples(values, dt, None, metadata, None, f"{path}: the sampling interval is {dt:g} s")
