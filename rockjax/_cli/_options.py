"""Options of the command line.

Most options set a key of the problem file. They are made from the models in `rockjax/_problem/models/`, which
describe the keys: each key with a `Flag` has an option.
"""

from __future__ import annotations

import types
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

import typer

from rockjax._problem import models
from rockjax._problem.models import OUTPUT, Flag

# Default values of options, by key: SINGLE for commands with one structure, PANEL for spectra, which draw
# each structure in a panel of the picture, and PULSE for pulses.
SINGLE_DEFAULTS = {
    "tan_alpha": 0.15,
    "R": 1.5,
    "gamma": 10.0,
    "eta": 100.0,
    "T_s": 0.5,
    "zeta": 0.05,
    "restitution": "paper",
}
PANEL_DEFAULTS = {name: SINGLE_DEFAULTS[name] for name in ("tan_alpha", "R", "gamma", "zeta", "restitution")}
PULSE_DEFAULTS = {"acceleration_ratio": 2.5, "T_p": 1.0}


def option(*names: str, panel: str, help: str, **option_arguments: Any) -> Any:
    """Return a Typer option. The help lists it under the heading `panel`. The brackets of units in `help` are
    escaped, because Typer would read them as markup."""
    return typer.Option(*names, help=help.replace("[", r"\["), rich_help_panel=panel, **option_arguments)


def argument(help: str, **option_arguments: Any) -> Any:
    """Return a Typer argument. Brackets in `help` are escaped, as in `option`."""
    return typer.Argument(help=help.replace("[", r"\["), **option_arguments)


Output = Annotated[
    str,  # not Path, which would drop a trailing slash; the slash marks a folder
    option(
        "--output",
        "-o",
        metavar="PATH",
        panel=OUTPUT,
        help="Prefix of the files to write, or a folder for them. The extension of a file name, such as "
        "x.pdf, sets the format of the pictures.",
    ),
]
Resume = Annotated[
    bool, option("--resume", panel=OUTPUT, help="Continue a run that Ctrl-C stopped, with the same options.")
]
Example = Annotated[
    Literal[
        "annual-frequency",
        "column",
        "ensemble",
        "floors",
        "fragility",
        "report",
        "response",
        "risk",
        "spectrum",
        "sweep",
    ]
    | None,
    option("--example", panel=OUTPUT, help="Use a problem file of the rockjax package."),
]
ProblemFile = Annotated[
    Path | None,
    argument(
        "Problem file (TOML) with structure, motions and options; options of the command line override it.",
        show_default=False,
    ),
]
Quiet = Annotated[bool, option("--quiet", "-q", panel=OUTPUT, help="Show no progress bar and no summary.")]
Verbose = Annotated[
    bool,
    option(
        "--verbose",
        "-v",
        panel=OUTPUT,
        help="Report numbers of scenes and of compiled programs, and the folder of the cache.",
    ),
]
Json = Annotated[bool, option("--json", panel=OUTPUT, help="Print only one JSON object with the summary.")]


class Option(NamedTuple):
    """An option of the command line that sets a key of the problem file."""

    annotation: Any  # type for Typer
    default: Any  # default value for Typer; None for an option without default
    flag: str  # name, such as "--points"
    convert: Callable[[str, Any], Any]  # (flag, value from Typer) ↦ value of the key


def options_of(model: type[models.Keys], *names: str, **defaults: Any) -> dict[str, Option]:
    """Return the options for the keys of a model, by key.

    - `model`: pydantic model of a table of problem files
    - `names`: keys for which options are made; by default all keys with a `Flag`
    - `defaults`: default values that replace those of the model, by key
    """
    options = {}
    for name, field in model.model_fields.items():
        schema = field.json_schema_extra
        if not isinstance(schema, Flag) or (names and name not in names):
            continue
        option_type, convert, option_arguments = _option_type(field.annotation)
        default = defaults.get(name, None if field.is_required() else field.default)
        if isinstance(default, list):
            default = ",".join(y if isinstance(y, str) else f"{y:g}" for y in default)
        flag = schema.name or f"--{name.replace('_', '-')}"
        option_annotation = option(flag, panel=schema.panel, help=field.description or "", **option_arguments)
        options[name] = Option(
            Annotated[option_type if default is not None else option_type | None, option_annotation],
            default,
            flag,
            convert,
        )
    return options


def structure_options(**defaults: Any) -> dict[str, Option]:
    """Return the options of structures, which are given by ratios or by dimensions. `defaults` are default
    values by key."""
    structures = (models.ByRatios, models.Superstructure, models.ByDimensions)
    return {name: entry for model in structures for name, entry in options_of(model, **defaults).items()}


def accuracy_options(**defaults: Any) -> dict[str, Option]:
    """Return the options for the keys of the table `[options]` in `defaults`, with these default values."""
    return options_of(models.Options, *defaults, **defaults)


def _option_type(annotation: Any) -> tuple[Any, Callable[[str, Any], Any], dict[str, Any]]:
    """Return the Typer type for a key, the function `Option.convert`, and keyword arguments of `option`.

    - `annotation`: type of the key in its model
    """
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _option_type(arguments[0])
    if origin is list:
        return str, _parse_numbers if _option_type(arguments[0])[0] is float else _split_names, {}
    if origin in (Union, types.UnionType):
        members = [_option_type(member) for member in arguments if member is not types.NoneType]
        choices = [
            choice for member in members if get_origin(member[0]) is Literal for choice in get_args(member[0])
        ]
        if len(members) > 1 and choices:
            return str, _parse_number_or_text, {"autocompletion": lambda: choices}
        if len(members) > 1 and members[0][1] is _parse_numbers:
            return str, _parse_one_or_more, {}
        if str in arguments:  # names such as 090 are not converted to numbers
            return str, lambda _, value: value, {}
        return members[0]
    return annotation, lambda _, value: value, {}


def _parse_numbers(flag: str, text: str) -> list[float]:
    try:
        return [float(number) for number in text.split(",")]
    except ValueError:
        raise typer.BadParameter(f"{flag} needs numbers separated by commas, got {text!r}") from None


def _parse_one_or_more(flag: str, text: str) -> float | list[float]:
    numbers = _parse_numbers(flag, text)
    return numbers if len(numbers) > 1 else numbers[0]


def _split_names(_: str, text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _parse_number_or_text(_: str, text: str) -> int | float | str:
    for number_type in (int, float):
        try:
            return number_type(text)
        except ValueError:
            pass
    return text
