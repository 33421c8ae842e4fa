"""File formats of networks and databases, one module each; `FORMATS` lists the text formats.

The modules parse text formats themselves, because existing packages have many dependencies or do not report
the line of an error. For binary waveforms, such as miniSEED and SAC, `waveforms` uses the package ObsPy.
"""

from __future__ import annotations

from pathlib import Path

from rockjax._text.reading import decode

from . import afad, cosmos, csmip, esm, geonet, knet, peer, smc, table, unsupported, waveforms
from .base import TIME_TOLERANCE, Component, Samples

# The first format that recognises a file reads it; the last one, `table`, recognises every file.
FORMATS = (
    peer.FORMAT,
    geonet.FORMAT,
    smc.FORMAT,
    *unsupported.FORMATS,
    csmip.FORMAT,
    cosmos.FORMAT,
    unsupported.VOLUME_1,
    unsupported.VOLUME_2,
    knet.FORMAT,
    esm.FORMAT,
    afad.FORMAT,
    unsupported.ITACA,
    table.FORMAT,
)

__all__ = ["FORMATS", "TIME_TOLERANCE", "Samples", "parse"]


def parse(path: Path, content: bytes, component: Component) -> Samples:
    """Read the samples in a file. The suffix or the first lines of the file determine its format. A
    `component` of None is valid only if the file has one channel. Raises a `ValueError` that names the file,
    the cause and, where possible, the line."""
    suffix = path.suffix.lower()
    if suffix in waveforms.WAVEFORMS:
        return waveforms.read(path, content, component)
    if suffix == ".npy":
        return table.read_array(path, component)
    lines = decode(path, content).splitlines() or [""]
    file_format = next(candidate for candidate in FORMATS if candidate.recognises(path, lines))
    return file_format.read(path, lines, component)
