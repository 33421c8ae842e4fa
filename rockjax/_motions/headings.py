"""Headings of columns in files: quantity, unit and investigation time.

The investigation time is the time to which a probability refers, such as 50 years in `poe in 50 years`.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from rockjax._units import UNITS, unit_of

# Kinds of quantities, and patterns of their headings. The first pattern that matches determines the kind.
_QUANTITIES = [
    ("probability", r"\b(?:poe|pe|aep|prob\w*|pexc\w*|wahrsch\w*|likelihood|chance)(?:\b|\d)"
                    r"|\bp\([a-z>]"),
    ("return period", r"\breturn period|\brp\b|\bt r\b|\bwiederkehr|\b(?:retour|ritorno|retorno)\b"),
    ("rate", r"\brates?\b|\b(?:annual|mean|exceedance)\b.*\bfreq|\bfrequency of|\b(?:maf|mafe|afe)\b"
             r"|\blambda\b|λ"),
    ("acceleration", r"\bpga\b|\bp?sa\b|\bpeak ground acc|\bspectral acc"),
    ("velocity", r"\bpgv\b|\bpeak ground vel"),
    ("displacement", r"\bpgd\b|\bpeak ground disp"),
    ("index", r"^(?:|index|idx|no\.?|nr\.?|n|i|k|#|id|row|step|points?|samples?|sample (?:no|number|index)\.?"
              r"|unnamed:? ?\d*|count|number)$"),
    ("time", r"^(?:t|(?:[a-z]+ )?times?|time ?stamp|zeit|tempo|temps|tiempo|zaman|seconds?|sec)$"),
    ("acceleration", r"^(?:a|ag|a g|a\(t\)|a[xyz]|[üu]g?|x ?ddot|ug ?ddot)$|\b(?:acc|acel|besch|ivme)"),
    ("velocity", r"^v(?:g|\(t\))?$|\b(?:vel|vit|geschw)"),
    ("displacement", r"^(?:d|dg|d\(t\))$|\b(?:disp|desp|dépl|depl|spost|versch)"),
]  # fmt: skip
# Kind of quantity ↦ dimensions (`Unit.dimension`) that its unit may have. For a kind that is not listed, the
# dimension must have the same name as the kind.
_DIMENSIONS = {
    "probability": {"ratio"},
    "rate": {"rate", "ratio"},
    "index": {"ratio", "counts"},
    "acceleration": {"acceleration", "counts"},
    "velocity": {"velocity", "counts"},
}
# A spectral value with its period: Sa(0.3), SA(T=1.0 s).
_SPECTRAL_VALUE = re.compile(r"\b(P?S[ad])[ _]?\(\s*(?:T\d?\s*=\s*)?([\d.]+)\s*(?:s|sec)?\s*\)", re.I)
_YEARS = re.compile(  # investigation time: "in 50 years"
    r"[\[(]?\s*(?:\b(?:in|en|over|during|for|per|within)\s+)?"
    r"(?<![\d.])(\d+(?:\.\d+)?)[\s-]*(?:years?|yrs?|y|a|jahren?|ans|anni|años)\b\s*[\])]?",
    re.I,
)
_BRACKETS = re.compile(r"\s*(?:\[([^\[\]]*)\]|\(([^()]*(?:\([^()]*\))?[^()]*)\))\s*")
# Parentheses that contain a direction, not a unit: (N-S), (x), (H1), (N90E), (090).
_QUALIFIER = re.compile(
    r"(?:[nsewxyzhv]\d?|n-?s|e-?w|u-?d|up|down|[ns]\d{1,2}[ew]|\d{2,3}|[a-z]{2}[nezxy123])$", re.I
)
_SEPARATOR = re.compile(r"\s*[,/]\s*|[\s_]+(?:in\s+)?")  # between quantity and unit


class Heading(NamedTuple):
    """The meaning of a heading.

    - `text`: the heading as written in the file
    - `quantity`: the heading without unit and investigation time. Peaks are always spelled `PGA`, `PGV` or
      `PGD`, and spectral values like `Sa(1 s)`
    - `kind`: `time`, `index`, `acceleration`, `velocity`, `displacement`, `probability`, `rate`, `return
      period`, `ratio`, `counts`; an empty string if neither words nor unit determine the kind
    - `unit`: a key of `rockjax._units.UNITS`; None if the heading has no unit
    - `years`: investigation time of a probability [years]; None if the heading has no such time
    """

    text: str
    quantity: str
    kind: str
    unit: str | None
    years: float | None


def parse_heading(location: str, text: str) -> Heading:
    """Return quantity, unit and investigation time of a heading, such as `PGA [g]`, `Acc (cm/s2)`, `time,
    ms`, `a / g`, `accel_mg`, `Sa(0.3) (g)` or `probability of exceedance in 50 years`. Raises `ValueError`,
    which quotes the heading, for an unknown unit in brackets, and for a unit that does not match the
    quantity."""
    words = " ".join(text.split()).strip("\"' ")
    years, standard_name = None, None
    if _match_quantity(words) == "probability":
        if match := _YEARS.search(words.replace("_", " ")):
            years, words = float(match[1]), words[: match.start()] + " " + words[match.end() :]
        elif re.search(r"annual|\baep\b|yearly|per (?:year|annum)", words, re.I):
            years, words = 1.0, re.sub(r"\s*per (?:year|annum)", "", words, flags=re.I)
    if match := _SPECTRAL_VALUE.search(words):
        standard_name = f"{'Sd' if match[1][-1] in 'dD' else 'Sa'}({float(match[2]):g} s)"
        words = words.replace(match[0], match[1])
    quantity, unit = _split(location, text, words.strip(" ,;:/"))
    kind = _match_quantity(quantity) if quantity else ""
    if kind in ("", "index") and unit:
        kind = UNITS[unit].dimension
    elif unit and UNITS[unit].dimension not in _DIMENSIONS.get(kind, {kind}):
        suitable = [name for name, other in UNITS.items() if other.dimension in _DIMENSIONS.get(kind, {kind})]
        raise ValueError(
            f"{location}: heading {text.strip()!r}: {unit} is not a unit of {kind}; use one of "
            f"{', '.join(suitable)}"
        )
    if not quantity and not unit:
        kind = "index"
    if peak := re.fullmatch(r"pg([avd])|peak ground (acc|vel|disp)[a-z]*", quantity, re.I):
        standard_name = f"PG{(peak[1] or peak[2])[0]}".upper()
    return Heading(text, standard_name or quantity, kind, unit, years)


def _match_quantity(words: str) -> str:
    """Return the kind of quantity that words name; an empty string if they name no known kind."""
    normalised = " ".join(words.replace("_", " ").casefold().split())
    return next((kind for kind, pattern in _QUANTITIES if re.search(pattern, normalised)), "")


def _split(location: str, text: str, words: str) -> tuple[str, str | None]:
    """Split `words`, the heading without investigation time and spectral period, into quantity and unit. The
    unit is None if there is none. Raises `ValueError`, which quotes the whole heading `text`, for an unknown
    unit in brackets."""
    if (unit := unit_of(words)) and not _match_quantity(words):
        return "", unit
    all_brackets = list(_BRACKETS.finditer(words))
    for brackets in reversed(all_brackets):  # words may follow the unit: Acc [g] corrected
        unit = unit_of(brackets[1] or brackets[2])
        if unit and (unit != "1" or brackets.end() == len(words)):  # Channel (1) is no ratio
            quantity = words[: brackets.start()].rstrip(" ,/_")
            return f"{quantity} {words[brackets.end() :]}".strip(), unit
    if all_brackets and all_brackets[-1].end() == len(words):
        brackets = all_brackets[-1]
        in_brackets = (brackets[1] or brackets[2] or "").strip()
        is_direction = _QUALIFIER.match(in_brackets) and _match_quantity(words[: brackets.start()]) != "time"
        if brackets[1] is None and (_is_symbol(words) or is_direction or words.casefold().startswith("p(")):
            return words, None
        raise ValueError(
            f"{location}: the unit {in_brackets!r} in the heading {text.strip()!r} is not known; use one of "
            f"{', '.join(UNITS)}"
        )
    if _is_symbol(words):
        return words, None
    for match in _SEPARATOR.finditer(words):
        quantity, remainder = words[: match.start()], words[match.end() :]
        unit = unit_of(remainder)
        if unit is None or not quantity:
            continue
        # After a comma or slash, every unit is accepted. After a blank or underscore, the word may be a
        # direction, such as the S in `N S`. It is then accepted as a unit only if its dimension fits the
        # quantity, or if it contains a slash.
        kind = _match_quantity(quantity)
        fits = UNITS[unit].dimension in _DIMENSIONS.get(kind, {kind})
        if fits or "/" in remainder or match[0].strip(" _in"):
            return quantity, unit
    return words, None


def _is_symbol(words: str) -> bool:
    """Return whether a heading is a symbol such as `a_g` or `a(t)`, in which g and t are not units."""
    return re.fullmatch(r"[a-zü]+(?:_g|\(t\))", words, re.I) is not None and len(words) <= 4
