"""What networks and databases write: PEER's .AT2, CSMIP and COSMOS volumes 2, ESM, K-NET and KiK-net, tables, waveforms.

Judged for this: gmprocess reads them all and brings over a hundred packages, quakeio brings OpenSees for one of them, and
neither says in which line a file is wrong; ObsPy reads K-NET, from a header without a flaw, but none of the other texts.
So the texts are read here, and what ObsPy alone reads well, binary waveforms such as miniSEED and SAC, is left to it.

Whatever is wrong with a file is a `ValueError` of one line that names the file, the line where there is one, and the cause.
"""

from __future__ import annotations

import dataclasses
import io
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rockjax._structures import STANDARD_GRAVITY

UNITS = {"g": STANDARD_GRAVITY, "m/s2": 1.0, "cm/s2": 1e-2, "gal": 1e-2, "mm/s2": 1e-3}
EVEN = 1e-3  # times in files are rounded: so much of a step may they be off
# Read by ObsPy, which is told the format: left to find it out, it would unpickle whatever it is given.
WAVEFORMS = {".mseed": "MSEED", ".miniseed": "MSEED", ".sac": "SAC", ".gse2": "GSE2"}

_NUMBER = r"[\d.]+(?:[ED][+-]?\d+)?"
_AT2_COUNT = re.compile(r"NPTS\s*=?\s*(\d{1,9})(?!\d)", re.I), re.compile(rf"DT\s*=?\s*({_NUMBER})", re.I)
_AT2_PLAIN = re.compile(rf"^\s*(\d{{1,9}})\s+({_NUMBER})\s+NPTS\s*,?\s*DT", re.I)
_AT2_UNITS = re.compile(r"UNITS\s+OF\s+(\S+)", re.I)
_DATE = re.compile(r"(?<!\d)(\d{1,4}[/-]\d{1,2}[/-]\d{1,4})(?!\d)")
_CSMIP = re.compile(r"\s*CORRECTED ACCELEROGRAM\b(?:.*?CHAN\s*(\d{1,6})\s*:\s*(.*?)\s*(?:FROM\s*)?$)?", re.I)
_CSMIP_DATA = re.compile(rf"\s*(\d{{1,9}})\s+POINTS OF ACCEL DATA EQUALLY SPACED AT\s*({_NUMBER})\s*SEC", re.I)
_COSMOS = re.compile(r"\s*(CORRECTED|UNCORRECTED|RAW)\s+(ACCELERATION|VELOCITY|DISPLACEMENT)\b.*\(FORMAT V", re.I)
_COSMOS_DATA = re.compile(r"\s*(\d{1,9})\s+ACCELERATION\s+PTS\b.*?UNITS\s*=\s*([^\s(,]+)", re.I)
_FORTRAN = re.compile(r"\((\d{1,3})[FEI](\d{1,3})(?:\.\d+)?\)", re.I)
_BAND = re.compile(r"([\d.]+)\s+AND\s+([\d.]+)")
_KEY = re.compile(r"([A-Z][A-Z0-9_/^]*):\s*(.*?)\s*$")
_SEPARATORS = re.compile(r"[,;\s]+")
_KNET_KEYS = 18  # columns of a key of the header
_KIKNET = dict(zip("123456", ("NS1", "EW1", "UD1", "NS2", "EW2", "UD2"), strict=True))


@dataclasses.dataclass
class Samples:
    """What a file holds, in its own units: `units` is None and `dt` is None where it does not say them."""

    values: np.ndarray
    dt: float | None
    units: str | None
    metadata: dict[str, Any]
    said: str | None = None  # the unit in the words of the file
    says_dt: str = ""  # where the file says dt, and in what words


def parse(path: Path, content: bytes, component: int | str | None) -> Samples:
    """The samples in a file of whatever format its suffix or its first lines tell."""
    suffix = path.suffix.lower()
    if suffix in WAVEFORMS:
        return _waveform(path, content, component)
    if suffix == ".npy":
        return _alone(path, component, _columns(path, _array(path), None))
    lines = _text(path, content).splitlines()
    first = lines[0] if lines else ""
    if suffix == ".at2":
        return _alone(path, component, _at2(path, lines))
    if re.match(r"\s*UNCORRECTED ACCELEROGRAM", first, re.I):
        raise ValueError(f"{path}:1: is volume 1, an uncorrected accelerogram; volume 2 (.V2) can be read")
    if _CSMIP.match(first):
        return _csmip(path, lines, component)
    if _COSMOS.match(first):
        return _cosmos(path, lines, component)
    if suffix in (".v2", ".v2c"):
        raise ValueError(f"{path}:1: is neither 'Corrected accelerogram' (CSMIP) nor 'Corrected acceleration' (COSMOS)")
    if first.startswith("Origin Time"):
        return _knet(path, lines, component)
    if any(line.startswith("SAMPLING_INTERVAL_S:") for line in lines[:80]):
        return _esm(path, lines, component)
    rows, numbers, units = _rows(path, lines)
    return _alone(path, component, _columns(path, rows, numbers, units))


def _alone(path: Path, component: int | str | None, samples: Samples) -> Samples:
    own = samples.metadata.get("component")
    if component is not None and (own is None or _plain(component) != _plain(own)):
        known = f"it is {own!r}" if own else "leave component out"
        raise ValueError(f"{path}: holds one motion, not component {component!r}; {known}")
    return samples


def _plain(name: int | str) -> str:
    return re.sub(r"[^a-z0-9]", "", str(name).casefold())


def _choose(path: Path, channels: Sequence[tuple[int, str]], component: int | str | None) -> int:
    """Which of several channels, (number, name), is meant."""
    if component is None and len(channels) == 1:
        return 0
    if isinstance(component, int):
        found = [k for k, (number, _) in enumerate(channels) if number == component]
    elif component is not None:
        found = [k for k, (_, name) in enumerate(channels) if _plain(component) == _plain(name)]
        found = found or [k for k, (_, name) in enumerate(channels) if name and _plain(component) == _plain(name.split()[0])]
    else:
        found = []
    if len(found) != 1:
        listed = ", ".join(f"{number} ({name})" for number, name in channels)
        asked = "" if component is None else f", {len(found) or 'none'} of them {component!r}"
        raise ValueError(
            f"{path}: holds {len(channels)} channels{asked}: {listed}; choose one by its number or name, such as "
            f"component {channels[0][0]} (on the command line --component)"
        )
    return found[0]


def _text(path: Path, content: bytes) -> str:
    strange = re.search(rb"[\x00-\x08\x0e-\x1f\x7f]", content)
    if strange:
        line = content.count(b"\n", 0, strange.start()) + 1
        raise ValueError(f"{path}:{line}: is not text: byte 0x{content[strange.start()]:02x} at offset {strange.start()}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")  # names of stations in headers


def _array(path: Path) -> np.ndarray:
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise ValueError(f"{path}: is not a NumPy array of numbers: {first_line(error)}") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu" or array.ndim not in (1, 2):
        raise ValueError(f"{path}: is not a NumPy array of numbers in one column or two")
    return np.asarray(array, float).reshape(len(array), -1)


def first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _number(path: Path, line: int, word: str) -> float:
    """A number of a file; Fortran's exponent D is one as well, Python's underscore is none."""
    try:
        value = float(word.upper().replace("D", "E")) if "_" not in word else None
    except ValueError:
        value = None
    if value is None:
        raise ValueError(f"{path}:{line}: {_short(word)} is not a number")
    if not np.isfinite(value):
        raise ValueError(f"{path}:{line}: {_short(word)} is not a finite number")
    return value


def _short(word: str) -> str:
    return repr(word if len(word) <= 40 else word[:37] + "...")


def _interval(path: Path, line: int, word: str, name: str) -> float:
    value = _number(path, line, word)
    if not value > 0:
        raise ValueError(f"{path}:{line}: {name} must be > 0 s, got {value:g}")
    return value


def _unit(said: str | None) -> str | None:
    """The unit that a header means, where it is one of ours."""
    words = re.sub(r"[\s^*.]", "", said or "").lower().replace("sec", "s").replace("/s/s", "/s2")
    return words if words in UNITS else None


def _counted(path: Path, line: int, name: str, count: int, values: list[float]) -> np.ndarray:
    if len(values) != count:
        cause = "is it cut short?" if len(values) < count else "what are the others?"
        raise ValueError(f"{path}:{line}: {name} is {count}, but {len(values)} values follow: {cause}")
    return np.array(values)


def _words(path: Path, lines: list[str], start: int) -> list[float]:
    """All numbers from the line with the index `start` on."""
    return [_number(path, i, word) for i, line in enumerate(lines[start:], start=start + 1) for word in line.split()]


def _fixed(path: Path, lines: list[str], start: int, count: int, text: str) -> np.ndarray:
    """`count` numbers in columns of fixed width, which may touch one another, below the line that tells the format."""
    found = _FORTRAN.search(text)
    per_line, width = (int(found[1]), int(found[2])) if found else (8, 10)
    if not (per_line and width):
        raise ValueError(f"{path}:{start}: {_short(found[0] if found else '')} is not a format of numbers")
    values: list[float] = []
    for i in range(start, min(start + -(-count // per_line), len(lines))):
        line = lines[i].rstrip()
        due = min(per_line, count - len(values))
        row = [line[k : k + width].strip() for k in range(0, len(line), width)]
        if len(row) != due:
            raise ValueError(f"{path}:{i + 1}: holds {len(row)} columns of {width} characters where {due} are due")
        values += [_number(path, i + 1, word) for word in row]
    return _counted(path, start, "the number of points", count, values)


def _matches(pattern: re.Pattern, lines: list[str], start: int, end: int) -> tuple[int, re.Match] | None:
    return next(((k, match) for k in range(start, end) if (match := pattern.match(lines[k]))), None)


def _at2(path: Path, lines: list[str]) -> Samples:
    head = lines[:8]
    for k, line in enumerate(head):  # noqa: B007
        plain = _AT2_PLAIN.match(line)
        count, step = (
            (plain[1], plain[2]) if plain else (match and match[1] for match in (p.search(line) for p in _AT2_COUNT))
        )
        if count and step:
            break
    else:
        raise ValueError(f"{path}: has no line with NPTS and DT among its first {len(head)}: is this an .AT2 file?")
    dt = _interval(path, k + 1, step, "DT")
    said = next((match[1].strip(".,") for match in map(_AT2_UNITS.search, lines[:k]) if match), None)
    metadata: dict[str, Any] = {"format": "PEER"}
    title = [part.strip() for part in lines[1].split(",")] if k > 1 else []
    if len(title) >= 3:  # event and date, station, component
        event = ", ".join(part for part in title[:-2] if part)
        date = _DATE.search(event)
        metadata |= {
            "event": event.replace(date[1], "").strip(" ,") if date else event,
            "date": date[1] if date else "",
            "station": title[-2],
            "component": title[-1],
        }
    values = _counted(path, k + 1, "NPTS", int(count), _words(path, lines, k + 1))
    return Samples(values, dt, _unit(said), metadata, said, f"{path}:{k + 1}: DT is {dt:g} s")


def _csmip(path: Path, lines: list[str], component: int | str | None) -> Samples:
    """Volume 2 of CSMIP: per channel 25 lines of text, integers, reals, then acceleration, velocity, displacement."""
    starts = [(k, match) for k, line in enumerate(lines) if (match := _CSMIP.match(line))]
    channels = [(int(match[1] or n), match[2] or "") for n, (_, match) in enumerate(starts, start=1)]
    chosen = _choose(path, channels, component)
    start = starts[chosen][0]
    end = starts[chosen + 1][0] if chosen + 1 < len(starts) else len(lines)
    found = _matches(_CSMIP_DATA, lines, start, end)
    if found is None:
        raise ValueError(f"{path}:{start + 1}: channel {channels[chosen][0]} has no line 'N points of accel data'")
    k, match = found
    said = re.search(r"UNITS:\s*([^)]*)\)|,\s*IN\s+(\S+)", lines[k], re.I)
    said = (said[1] or said[2]).strip(" .") if said else None
    head = [line.rstrip() for line in lines[start:k]] + [""] * 25
    band = re.search(r"FILTERED.*?([\d.]+)\s+AND\s+([\d.]+)", head[14], re.I)
    station, code = head[6].split("  ")[0].strip(), re.search(r"STATION\s+(?:NO|ID)\.?\s+(\S+)", head[5], re.I)
    date = _DATE.search(head[4]) or _DATE.search(head[3])
    metadata = {
        "format": "CSMIP",
        "event": head[2].split("  ")[0].strip(),
        "date": date[1] if date else "",
        "station": " ".join(part for part in (code[1] if code else "", station) if part),
        "component": channels[chosen][1],
        "channel": channels[chosen][0],
        **_corners(band),
    }
    values = _fixed(path, lines, k + 1, int(match[1]), lines[k])
    dt = _interval(path, k + 1, match[2], "the interval")
    return Samples(values, dt, _unit(said), metadata, said, f"{path}:{k + 1}: the interval is {dt:g} s")


def _corners(band: re.Match | None) -> dict[str, float]:
    """Corner frequencies of the filters [Hz], where both are numbers."""
    try:
        return {"high_pass_Hz": float(band[1]), "low_pass_Hz": float(band[2])} if band else {}
    except ValueError:
        return {}


def _cosmos(path: Path, lines: list[str], component: int | str | None) -> Samples:
    """COSMOS format 1.20: per channel text, integer header, real header, comments, data, each with a line that says so."""
    sections = [(k, match) for k, line in enumerate(lines) if (match := _COSMOS.match(line))]
    ends = [k for k, _ in sections[1:]] + [len(lines)]
    found = [(start, end) for (start, match), end in zip(sections, ends, strict=True) if match[2].upper() == "ACCELERATION"]
    if not found:
        raise ValueError(f"{path}:1: holds {sections[0][1][2].lower()}, not acceleration")
    channels = []
    for n, (start, end) in enumerate(found, start=1):
        said = re.search(
            r"STA CHAN\s*(\d{1,6}|\S*?)\s*:\s*(.*?)\s*(?:\(|$)", " ".join(lines[start + 8 : min(start + 9, end)]), re.I
        )
        channels.append((int(said[1]) if said and said[1].isdecimal() else n, said[2] if said else ""))
    chosen = _choose(path, channels, component)
    start, end = found[chosen]
    data = _matches(_COSMOS_DATA, lines, start, end)
    reals = _matches(re.compile(r"\s*(\d{1,9})\s+REAL-HEADER VALUES\b", re.I), lines, start, end)
    if data is None or reals is None:
        missing = "Real-header values" if reals is None else "acceleration pts"
        raise ValueError(f"{path}:{start + 1}: channel {channels[chosen][0]} has no line 'N {missing}'")
    k, match = data
    r, header = reals[0], _fixed(path, lines, reals[0] + 1, int(reals[1][1]), lines[reals[0]])
    if len(header) < 62 or not header[61] > 0:
        raise ValueError(f"{path}:{r + 1}: real-header value 62, the sampling interval, must be > 0 ms")
    head = [line.rstrip() for line in lines[start:r]] + [""] * 13
    band = re.search(r"FILTERED BELOW\s*([\d.]+).*?ABOVE\s*([\d.]+)", head[11], re.I)
    station, date = re.search(r"CODE:\s*(.*)", head[4], re.I), _DATE.search(head[7])
    metadata = {
        "format": "COSMOS",
        "event": re.sub(r"^\s*Record of\s*", "", head[1], flags=re.I).strip(),
        "date": date[1] if date else "",
        "station": " ".join(station[1].split()) if station else "",
        "component": channels[chosen][1],
        "channel": channels[chosen][0],
        **_corners(band),
    }
    values = _fixed(path, lines, k + 1, int(match[1]), lines[k])
    dt = float(header[61]) * 1e-3
    says_dt = f"{path}:{r + 1}: real-header value 62 is {1e3 * dt:g} ms"
    return Samples(values, dt, _unit(match[2]), metadata, match[2], says_dt)


def _esm(path: Path, lines: list[str], component: int | str | None) -> Samples:
    """ESM, ITACA and AFAD (DYNA 1.2): 64 lines KEY: value, then one value a line."""
    header: dict[str, tuple[int, str]] = {}
    end = 0
    for k, line in enumerate(lines):
        match = _KEY.match(line)
        if match is None:
            if line.strip():
                break
            continue
        header[match[1]], end = (k + 1, match[2]), k + 1
    for key in ("SAMPLING_INTERVAL_S", "NDATA", "UNITS"):
        if key not in header:
            raise ValueError(f"{path}: its header has no {key}")
    kind = header.get("DATA_TYPE", (1, ""))
    if kind[1] not in ("", "ACCELERATION"):
        raise ValueError(f"{path}:{kind[0]}: holds {_short(kind[1])}, not ACCELERATION")
    line, count = header["NDATA"]
    if not re.fullmatch(r"\d{1,9}", count, re.ASCII):
        raise ValueError(f"{path}:{line}: NDATA must be a whole number, got {_short(count)}")
    step_line, step = header["SAMPLING_INTERVAL_S"]
    dt = _interval(path, step_line, step, "SAMPLING_INTERVAL_S")
    said = header["UNITS"][1]
    own = {key: value for key, (_, value) in header.items() if value}
    metadata: dict[str, Any] = {
        "format": "ESM",
        "event": " ".join(own.get(key, "") for key in ("EVENT_NAME", "EVENT_ID")).strip(),
        "date": own.get("EVENT_DATE_YYYYMMDD", ""),
        "station": ".".join(own[key] for key in ("NETWORK", "STATION_CODE") if key in own),
        "component": own.get("STREAM", ""),
        **_corners(_BAND.match(f"{own.get('LOW_CUT_FREQUENCY_HZ', '')} AND {own.get('HIGH_CUT_FREQUENCY_HZ', '')}")),
        **{key.lower(): value for key, value in own.items()},
    }
    values = _counted(path, line, "NDATA", int(count), _words(path, lines, end))
    says_dt = f"{path}:{step_line}: SAMPLING_INTERVAL_S is {dt:g} s"
    return _alone(path, component, Samples(values, dt, _unit(said), metadata, said, says_dt))


def _knet(path: Path, lines: list[str], component: int | str | None) -> Samples:
    """K-NET and KiK-net: keys in 18 columns up to Memo., then counts, of which the scale factor makes gal."""
    header: dict[str, tuple[int, str]] = {}
    for k, line in enumerate(lines):
        header[line[:_KNET_KEYS].strip()] = k + 1, line[_KNET_KEYS:].strip()
        if line.startswith("Memo"):
            break
    else:
        raise ValueError(f"{path}: its header has no Memo., after which the values begin")
    end = k + 1
    for key in ("Sampling Freq(Hz)", "Duration Time(s)", "Scale Factor"):
        if key not in header:
            raise ValueError(f"{path}: its header has no {key}")
    line, text = header["Sampling Freq(Hz)"]
    frequency = _number(path, line, re.sub(r"\s*Hz$", "", text))
    if not (frequency > 0 and np.isfinite(1 / frequency)):
        raise ValueError(f"{path}:{line}: the sampling frequency must be > 0 Hz, got {text}")
    factor_line, text = header["Scale Factor"]
    factor = re.fullmatch(r"(\S+?)\s*\(gal\)\s*/\s*(\S+)", text)
    if factor is None:
        raise ValueError(f"{path}:{factor_line}: Scale Factor must read like 2000(gal)/8388608, got {_short(text)}")
    counts = _number(path, factor_line, factor[2])
    if not counts > 0:
        raise ValueError(f"{path}:{factor_line}: Scale Factor must divide by a number > 0, got {_short(text)}")
    duration_line, text = header["Duration Time(s)"]
    count = round(min(_number(path, duration_line, text) * frequency, 1e9))
    direction = header.get("Dir.", (0, ""))[1]
    value = lambda key: header.get(key, (0, ""))[1]
    metadata = {
        "format": "K-NET",
        "event": f"M {value('Mag.')}" if value("Mag.") else "",
        "date": value("Origin Time"),
        "station": value("Station Code"),
        "component": _KIKNET.get(direction, direction),
        **{key: text for key, (_, text) in header.items() if key and text},
    }
    values = _counted(path, duration_line, "duration times frequency", count, _words(path, lines, end))
    with np.errstate(over="ignore"):
        values = values * np.divide(_number(path, factor_line, factor[1]), counts)
    says_dt = f"{path}:{line}: the sampling frequency is {frequency:g} Hz"
    return _alone(path, component, Samples(values, 1 / frequency, "gal", metadata, "gal", says_dt))


def _waveform(path: Path, content: bytes, component: int | str | None) -> Samples:
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
    chosen = _choose(path, [(k, trace.stats.channel) for k, trace in enumerate(traces, start=1)], component)
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


def _rows(path: Path, lines: list[str]) -> tuple[np.ndarray, list[int], str | None]:
    """The rows of a table of numbers, which lines they are, and the unit in brackets at the end of one row of headings."""
    rows: list[list[float]] = []
    numbers: list[int] = []
    heading: str | None = None
    for i, line in enumerate(lines, start=1):
        text = line.strip()
        if not text or text[0] in "#%!":
            continue
        words = [word for word in _SEPARATORS.split(text) if word]
        try:
            row = [_number(path, i, word) for word in words]
        except ValueError:
            if rows or heading is not None or any(character.isdigit() for character in words[0] if words):
                raise
            heading = text
            continue
        if not row:
            raise ValueError(f"{path}:{i}: holds no number")
        if rows and len(row) != len(rows[0]):
            raise ValueError(f"{path}:{i}: has {len(row)} columns where the lines before have {len(rows[0])}")
        rows.append(row)
        numbers.append(i)
    if not rows:
        raise ValueError(f"{path}: holds no numbers")
    unit = re.search(r"\[([^\[\]]*)\]$", heading or "")
    return np.array(rows), numbers, unit[1] if unit else None


def _columns(path: Path, rows: np.ndarray, numbers: list[int] | None, said: str | None = None) -> Samples:
    if rows.shape[1] > 2:
        raise ValueError(f"{path}: has {rows.shape[1]} columns; one (acceleration) or two (time, acceleration) can be read")
    metadata = {"format": "table"}
    if rows.shape[1] == 1:
        return Samples(rows[:, 0], None, _unit(said), metadata, said)
    times, values = rows.T
    if len(times) < 2:
        return Samples(values, None, _unit(said), metadata, said)
    step = (times[-1] - times[0]) / (len(times) - 1)
    off = np.flatnonzero(~(np.abs(np.diff(times) - step) <= max(EVEN * step, 4e-16 * np.abs(times).max())))
    if not step > 0 or len(off):
        k = int(off[0]) + 1 if len(off) else 1
        where = f"{path}:{numbers[k]}" if numbers else f"{path}: row {k + 1}"
        raise ValueError(
            f"{where}: times must rise in equal steps, got {times[k - 1]:.9g} s and then {times[k]:.9g} s where the mean "
            f"step is {step:.6g} s; resample the record"
        )
    return Samples(values, float(step), _unit(said), metadata, said, f"{path}: the times in it are {step:g} s apart")
