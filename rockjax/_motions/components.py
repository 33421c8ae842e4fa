"""Names of the vertical component in headers and in names of files."""

from __future__ import annotations

import re

_UP_NAME = re.compile(
    r"(?:u|up|ud|upd|updo|updown|upwards?|v|ver|vert|vertical|verticale|vrtc?|vt|vtl|vertup|z|zdir|zaxis"
    r"|accz|az|compz|düşey)\d*"
)
_DOWN_NAME = re.compile(r"(?:dn|dwn|down|downwards?|vertdown)\d*")
# Codes of channels: band, instrument, orientation (HNZ, BHZ), optionally with a location before or after.
_CHANNEL_CODE = re.compile(r"(?:\d{2})?[a-z]{2}z\d{0,2}|\d{2}z")
# Ends of names that ordinary words rarely have; longer ones first.
_VERTICAL_SUFFIX = re.compile(
    r"[-_. ]?(VERTICAL|VERT|VRT|VER|U-?D\d?|UP|DWN|DOWN|[A-Z]{2}Z\d{0,2}|V|Z)\.?$", re.IGNORECASE
)


def _normalise(name: str) -> str:
    return re.sub(r"[\W_]", "", name.casefold())


def is_vertical(name: str) -> bool:
    """Return whether a component is vertical: `Up`, `U-D`, `UD1`, `VERT.`, `VRT`, `DWN`, `HNZ`, `BHZ00` …"""
    return any(
        _is_vertical(_normalise(part)) for part in (name, (name.split() or [""])[0], name.split(".")[-1])
    )


def _is_vertical(normalised: str) -> bool:
    return any(pattern.fullmatch(normalised) for pattern in (_UP_NAME, _DOWN_NAME, _CHANNEL_CODE))


def points_down(name: str) -> bool:
    """Return whether a vertical component is positive downwards."""
    return any(_DOWN_NAME.fullmatch(_normalise(part)) for part in (name, (name.split() or [""])[0]))


def split_name(name: str) -> tuple[str, str]:
    """Return the name of a motion without its vertical component, and that component; empty if it has
    none."""
    found = _VERTICAL_SUFFIX.search(name)
    return (name[: found.start()], found[1]) if found else (name, "")
