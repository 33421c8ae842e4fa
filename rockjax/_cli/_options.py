"""Options of the command line: those made from the models of problem files, and a few without a key."""

from __future__ import annotations

import types
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

import typer

from rockjax._problem import models
from rockjax._problem.models import OUTPUT, Flag

SINGLE_DEFAULTS = {
    "tan_alpha": 0.15,
    "R": 1.5,
    "gamma": 10.0,
    "eta": 100.0,
    "T_s": 0.5,
    "zeta": 0.05,
    "restitution": "paper",
}
PANELS = {name: SINGLE_DEFAULTS[name] for name in ("tan_alpha", "R", "gamma", "zeta", "restitution")}
PULSE = {"acceleration_ratio": 2.5, "T_p": 1.0}


def option(*names: str, panel: str, help: str, **option_arguments: Any) -> Any:
    """Return an option. Brackets in its help are escaped, because they enclose units and are not markup."""
    return typer.Option(*names, help=help.replace("[", r"\["), rich_help_panel=panel, **option_arguments)


def argument(help: str, **option_arguments: Any) -> Any:
    """Return an argument. Brackets in its help are escaped, because they enclose units and are not markup."""
    return typer.Argument(help=help.replace("[", r"\["), **option_arguments)


Output = Annotated[
    str,  # text, because a trailing slash matters
    option(
        "--output",
        "-o",
        metavar="PATH",
        panel=OUTPUT,
        help="Prefix of the files to write, a folder for them, or a file name whose extension is the format "
        "of the pictures, such as x.pdf.",
    ),
]
Resume = Annotated[
    bool, option("--resume", panel=OUTPUT, help="Continue where Ctrl-C stopped the same command.")
]
Example = Annotated[
    Literal["annual-frequency", "column", "fragility", "response", "risk", "spectrum", "sweep"] | None,
    option(
        "--example", panel=OUTPUT, help="Use a problem file that comes with rockjax, instead of your own."
    ),
]
ProblemFile = Annotated[
    Path | None,
    argument(
        "Problem file (TOML) with structure, motions and options; options given here override it.",
        show_default=False,
    ),
]
Quiet = Annotated[bool, option("--quiet", "-q", panel=OUTPUT, help="No progress bar, no summary.")]
Verbose = Annotated[
    bool,
    option(
        "--verbose",
        "-v",
        panel=OUTPUT,
        help="Report what is solved and compiled, and where programs are kept.",
    ),
]
Json = Annotated[
    bool, option("--json", panel=OUTPUT, help="Print the summary as one JSON object, and nothing else.")
]


class Option(NamedTuple):
    """An option of the command line.

    - `annotation`: its type for Typer; `default`: its default value; `flag`: its name
    - `value`: conversion (flag, typed string) → value
    """

    annotation: Any
    default: Any
    flag: str
    value: Callable[[str, Any], Any]


def options_of(model: type[models.Keys], *names: str, **defaults: Any) -> dict[str, Option]:
    """Return the options of a model: key → option.

    - `model`: model of a table; `names`: keys for which options are made, by default all that have a panel
    - `defaults`: key → default that replaces the default of the model
    """
    options = {}
    for name, field in model.model_fields.items():
        schema = field.json_schema_extra
        if not isinstance(schema, Flag) or (names and name not in names):
            continue
        kind, value, option_arguments = _option_type(field.annotation)
        default = defaults.get(name, None if field.is_required() else field.default)
        if isinstance(default, list):
            default = ",".join(y if isinstance(y, str) else f"{y:g}" for y in default)
        flag = schema.name or f"--{name.replace('_', '-')}"
        option_annotation = option(flag, panel=schema.panel, help=field.description or "", **option_arguments)
        options[name] = Option(
            Annotated[kind if default is not None else kind | None, option_annotation], default, flag, value
        )
    return options


def structure_options(**defaults: Any) -> dict[str, Option]:
    """Return an option for every parameter of a structure, by ratios or by dimensions."""
    kinds = (models.ByRatios, models.Superstructure, models.ByDimensions)
    return {name: entry for model in kinds for name, entry in options_of(model, **defaults).items()}


def accuracy(**defaults: Any) -> dict[str, Option]:
    """Return the accuracy options that `defaults` names, with these defaults."""
    return options_of(models.Options, *defaults, **defaults)


def _option_type(annotation: Any) -> tuple[Any, Callable[[str, Any], Any], dict[str, Any]]:
    """Return the command-line type of a key, the conversion of its string, and arguments of its option."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _option_type(arguments[0])
    if origin is list:
        return str, _numbers if _option_type(arguments[0])[0] is float else _names, {}
    if origin in (Union, types.UnionType):
        members = [_option_type(member) for member in arguments if member is not types.NoneType]
        words = [
            word for member in members if get_origin(member[0]) is Literal for word in get_args(member[0])
        ]
        if len(members) > 1 and (words or str in arguments):
            return str, _number_or_text, {"autocompletion": lambda: words} if words else {}
        return members[0]
    return annotation, lambda _, value: value, {}


def _numbers(flag: str, text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise typer.BadParameter(f"{flag}: expected numbers separated by commas, got {text!r}") from None


def _names(_: str, text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _number_or_text(_: str, text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text
