"""File formats of networks and databases, one module each; a new one adds a module and a line in `FORMATS`.

The text formats are parsed here, because existing packages have many dependencies or do not report the line
of an error. Binary waveforms, such as miniSEED and SAC, are read by ObsPy.
"""

from __future__ import annotations

from pathlib import Path

from rockjax._text.reading import decode

from . import afad, cosmos, csmip, esm, geonet, knet, peer, smc, table, unsupported, waveforms
from .base import TIME_TOLERANCE, Component, Samples

# In the order in which they are tried.
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
    """Return the samples in a file, in the format that its suffix or its first lines indicate."""
    suffix = path.suffix.lower()
    if suffix in waveforms.WAVEFORMS:
        return waveforms.read(path, content, component)
    if suffix == ".npy":
        return table.read_array(path, component)
    lines = decode(path, content).splitlines() or [""]
    found = next(each for each in FORMATS if each.recognises(path, lines))
    return found.read(path, lines, component)
