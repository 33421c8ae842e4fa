"""Tools for the models of problem files: functions that define keys, types of values, and the base class of
all tables."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    Strict,
    ValidationError,
    WrapValidator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from rockjax._excitations.names import PULSE_CLASSES

# Headings under which the help of the command line lists options.
STRUCTURE, MOTION, GRID, ACCURACY, OUTPUT = "Structure", "Ground motion", "Grid", "Accuracy", "Output"
STATISTICS, CURVE, HAZARD, MACHINES = "Statistics", "Fragility", "Hazard", "Machines"


class Flag(NamedTuple):
    """The command-line option that sets a key.

    - `panel`: heading above the option in the help
    - `name`: name of the option; "" if the option has the name of the key

    A `Flag` is stored as `json_schema_extra` of a pydantic field. Pydantic calls such an object with the JSON
    schema of the field, so that it can change the schema. A `Flag` does not change it.
    """

    panel: str
    name: str = ""

    def __call__(self, schema: Any) -> None:
        """Leave the schema unchanged."""


def key(default: Any, meaning: str, panel: str = "", name: str = "") -> Any:
    """Return the pydantic field of a key. If `panel` is given, the key is also an option of the command line.

    - `default`: default value; `...` for a required key
    - `meaning`: description of the key, with the unit
    - `panel`: heading of the option in the help
    - `name`: name of the option, if it differs from the key
    """
    return Field(default, description=meaning, json_schema_extra=Flag(panel, name) if panel else None)


def described_as(accepted: str) -> WrapValidator:
    """Return a validator that replaces every error by "must be {accepted}"."""

    def check(value: Any, handler: Any) -> Any:
        try:
            return handler(value)
        except ValidationError:
            raise PydanticCustomError("rejected", "must be {accepted}", {"accepted": accepted}) from None

    return WrapValidator(check)


def satisfying(holds: Callable[[Any], bool]) -> AfterValidator:
    """Return a validator that rejects values for which `holds` is false."""

    def check(value: Any) -> Any:
        if not holds(value):
            raise ValueError
        return value

    return AfterValidator(check)


Number = Annotated[float, described_as("a number")]
Positive = Annotated[float, Field(gt=0), described_as("a number > 0")]
NotNegative = Annotated[float, Field(ge=0), described_as("a number >= 0")]
Count = Annotated[int, Field(ge=1), described_as("a whole number ≥ 1")]
Index = Annotated[int, Field(ge=0), described_as("a whole number ≥ 0")]
Points = Annotated[int, Field(ge=2), described_as("a whole number ≥ 2")]
Label = Annotated[int | str, described_as("a whole number or text")]
Numbers = Annotated[list[Number], Field(min_length=1), described_as("a list of numbers")]
Positives = Annotated[list[Positive], Field(min_length=1), described_as("a list of numbers > 0")]
NotNegatives = Annotated[list[NotNegative], Field(min_length=1), described_as("a list of numbers >= 0")]
OneOrMore = Annotated[float | Numbers, described_as("a number or a list of numbers")]
# A list or a number, as which an option of the command line reads this type.
Heights = Annotated[Numbers | float, described_as("a number or a list of numbers")]
Periods = Annotated[Positive | Positives, described_as("a number > 0 or a list of such numbers")]
DampingRatios = Annotated[NotNegative | NotNegatives, described_as("a number >= 0 or a list of such numbers")]
Share = Annotated[float, Field(gt=0, lt=1), described_as("a number in (0, 1)")]
_ENDS = "two numbers [lowest, highest] with"
Ends = Annotated[tuple[float, float], Strict(False)]
Bounds = Annotated[Ends, described_as("two numbers [lowest, highest]")]
Frequencies = Annotated[
    Ends, satisfying(lambda y: 0 < y[0] < y[1]), described_as(f"{_ENDS} 0 < lowest < highest")
]
Amplitudes = Annotated[
    Ends, satisfying(lambda y: 0 <= y[0] < y[1]), described_as(f"{_ENDS} 0 <= lowest < highest")
]
Levels = Annotated[
    Ends, satisfying(lambda y: 0 < y[0] <= y[1]), described_as(f"{_ENDS} 0 < lowest <= highest")
]
# Texts that look like a missing value in a table of a report. Names and texts in problem files must not match
# this pattern.
NO_VALUE = re.compile(r"[\s\-–—−.…]*|None|[-+−]?\s*(?i:nan|inf|infinity|∞|null|nat)")
_TEXT = "a text other than a blank, a dash, nan, inf or None"
Name = Annotated[str, satisfying(lambda y: not NO_VALUE.fullmatch(y)), described_as(_TEXT)]
Text = Annotated[str, satisfying(lambda y: not y or not NO_VALUE.fullmatch(y)), described_as(_TEXT)]
Source = Annotated[
    Text, described_as(f'{_TEXT}; a path before it needs quotes, as in "structure.width" = "drawing 1"')
]
if TYPE_CHECKING:
    PulseName = str
else:
    PulseName = Literal[tuple(PULSE_CLASSES)]


class Keys(BaseModel):
    """Base class of the tables of a problem file. Unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _check_names(cls, given: Any) -> Any:
        valid = [field.alias or name for name, field in cls.model_fields.items()]
        for name in given if isinstance(given, dict) else ():
            if name not in valid:
                near = difflib.get_close_matches(str(name), valid, 1)
                hint = f"did you mean {near[0]}?" if near else f"valid keys are {', '.join(valid)}"
                raise PydanticCustomError("unknown", "unknown key; {hint}", {"hint": hint, "key": str(name)})
        return given

    def as_arguments(self, *without: str) -> dict[str, Any]:
        """Return key ↦ value for all keys that the table sets, except keys with the value None and the keys
        in `without`."""
        names = [name for name in type(self).model_fields if name in self.model_fields_set - set(without)]
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}


def require_one(given: Mapping[str, Any], *names: str) -> str:
    """Return the key among `names` whose value in `given` is not None. Raises `ValueError` unless there is
    exactly one such key."""
    found = [name for name in names if given.get(name) is not None]
    if len(found) != 1:
        raise ValueError(f"needs {' or '.join(names)}" + (", not both" if found else ""))
    return found[0]
