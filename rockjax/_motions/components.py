"""Recognition of the vertical component by its name in a file header or by the name of the file."""

from __future__ import annotations

import re

_UP_NAME = re.compile(
    r"(?:u|up|ud|upd|updo|updown|upwards?|v|ver|vert|vertical[ae]?|vertikal|vrtc?|vt|vtl|vertup|z|zdir|zaxis"
    r"|accz|compz|düşey)\d*"
)
_DOWN_NAME = re.compile(r"(?:dn|dwn|down|downwards?|vertdown)\d*")
# Channel codes: one letter each for band, instrument and orientation (HNZ, BHZ). Digits before or after the
# letters are the code of a location.
_CHANNEL_CODE = re.compile(r"(?:\d{2})?[a-z]{2}z\d{0,2}|\d{2}z")
# Suffixes of the names of vertical motions. Suffixes that also end ordinary words, such as names of places
# (LA PAZ, SANTA CRUZ), count only after a separator or a digit, or as the whole name.
_VERTICAL_SUFFIX = re.compile(
    r"(?:[-_. ]?(?P<distinctive>VERTICAL|VRT|DWN|[BH][HLN]Z\d{0,2})"
    r"|(?:^|[-_. ]|(?<=\d))(?P<common>VERT|VER|U-?D\d?|UP|DOWN|[A-Z][GHLN]Z\d{0,2}|V|Z))\.?$",
    re.IGNORECASE,
)


def _normalise(name: str) -> str:
    """Return the letters and digits of a name, in lower case."""
    return re.sub(r"[\W_]", "", name.casefold())


def is_vertical(name: str) -> bool:
    """Return whether a name means a vertical component: the whole name, its first or last word, or the part
    after its last dot must be a word such as `Up`, `U-D`, `UD1`, `VERT.`, `DWN` or `HNZ`. Case and
    punctuation do not matter."""
    # AZ is an acceleration along z; before a number it is an azimuth.
    return _normalise(name) == "az" or any(map(_matches_vertical, _parts(name)))


def _parts(name: str) -> list[str]:
    """Return the parts of a name that may state the direction, normalised."""
    words = name.split() or [""]
    return [_normalise(part) for part in (name, words[0], words[-1], name.split(".")[-1])]


def _matches_vertical(normalised: str) -> bool:
    return any(pattern.fullmatch(normalised) for pattern in (_UP_NAME, _DOWN_NAME, _CHANNEL_CODE))


def points_down(name: str) -> bool:
    """Return whether a vertical component is positive downwards according to its name, such as `DWN`."""
    return any(map(_DOWN_NAME.fullmatch, _parts(name)))


def split_name(name: str) -> tuple[str, str]:
    """Split the name of a motion into a stem and the suffix of a vertical component. If the name has no such
    suffix, the stem is the whole name and the suffix is empty."""
    match = _VERTICAL_SUFFIX.search(name)
    return (name[: match.start()], match["distinctive"] or match["common"]) if match else (name, "")
