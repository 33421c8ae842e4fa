"""`rockjax peaks`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rockjax._problem import models

from ._joints import check_restitution_by_line, joint_warnings
from ._options import PULSE_DEFAULTS, SINGLE_DEFAULTS, Output, accuracy_options, options_of, structure_options
from ._outputs import SINGLE_PICTURE, parse_outputs
from ._request import Request
from ._response import impact_law
from ._run import Console, command

if TYPE_CHECKING:
    import xarray


@command(
    structure_options(**SINGLE_DEFAULTS),
    options_of(models.Pulses, **PULSE_DEFAULTS),
    options_of(models.Record),
    options_of(models.Peaks),
    accuracy_options(rtol=1e-8, overturn_ratio=1.0, method="dopri8"),
)
def peaks(request: Request, console: Console, output: Output = "rockjax-peaks") -> None:
    """Compute peaks of rotation, building and joints under each motion of a set, with estimated errors.

    Prints a row for each motion. If a motion overturns the columns, its row has the peaks until overturning
    and the time of overturning. A set may contain both records and pulses. Writes OUTPUT.nc and, if at least
    one requested output is a peak, OUTPUT.png.

    \b
    Examples:
      rockjax peaks problem.toml --motion design
      rockjax peaks problem.toml --outputs peak_rotation,peak_drift --factor 1.5
      rockjax peaks --record suite/RSN1.AT2 --eta 0 -o study
    """
    import numpy as np
    import xarray

    import rockjax as rj
    from rockjax._motions.convert import combine_motions, group_by_kind, single_motions
    from rockjax._motions.provenance import describe_motions
    from rockjax._outputs.registry import REGISTRY, suitable_outputs, variables_of
    from rockjax._responses.datasets import describe_options, describe_podium
    from rockjax._responses.peak import data_variables
    from rockjax._results import explain_failures
    from rockjax._text.tables import align_rows

    files = parse_outputs(output, "rockjax-peaks")
    podium, settings = request.podium(), request.settings
    motions = request.motion_or_set(podium, mixed=True)
    members, labels = single_motions("peaks", motions, "motions")
    options = request.options(outputs=tuple(settings.outputs or suitable_outputs(podium)))
    for name in options.outputs:
        if isinstance(name, str) and name in REGISTRY and not REGISTRY[name].applies(podium):
            raise ValueError(f"peaks.outputs: this structure has no {name}; leave it out")
    check_restitution_by_line()
    has_picture = any(variable.until_overturning for variable, _ in variables_of(options.outputs).values())
    files.check(SINGLE_PICTURE if has_picture else ())
    parts, groups = [], group_by_kind(members).values()
    with console.progress(len(members), "motions") as bar:
        for indices in groups:
            motion = combine_motions("peaks", [members[k] for k in indices], "motions")
            result = rj.peak_responses(
                podium, motion.scaled(settings.factor), t_end=settings.t_end, options=options, progress=bar
            )
            parts.append(xarray.Dataset(data_variables(result, options.outputs, ("motion",))))
    order = np.argsort(np.concatenate(list(groups)))
    data = xarray.concat(parts, "motion").isel(motion=order).assign_coords(motion=labels)
    data.attrs = {
        "title": "Peaks under the motions of a set",
        "kind": "peaks",
        "factor": settings.factor,
        **describe_motions(motions),
        **describe_podium(podium),
        **describe_options(options),
    }
    console.write(files.data(), data)
    if has_picture:
        console.draw(files.picture(), "peaks", data)
    console.json_object |= console.say_scenes(data, len(members))
    console.say(f"  {impact_law(data.attrs)}")
    rows = _rows(data)
    headings = tuple("overturning" if name == "overturn_time [s]" else name for name in rows[0])
    for line in align_rows([headings, *map(_cells, rows)], numbers=True):
        console.say(f"  {line}")
    console.json_object["motions"] = rows
    console.say_warnings(joint_warnings(podium, data, settings.friction), indent="  ")
    if message := explain_failures(data["result"]):
        console.error(message)


def _rows(data: xarray.Dataset) -> list[dict[str, Any]]:
    """Return a row for each motion: its name, the result of its scene, the time of overturning or None, the
    number of impacts if it was computed, and the worst value of each output over modes, stories or joints."""
    from rockjax._outputs.base import worst_component
    from rockjax._outputs.registry import VARIABLES
    from rockjax._results import NAMES
    from rockjax._units import displayed

    times = data["overturn_time"].values
    columns = {
        "motion": data["motion"].values.astype(str),
        "result": [NAMES[int(y)] for y in data["result"]],
        "overturn_time [s]": [None if math.isnan(y) else float(y) for y in times],
    }
    if "impacts" in data:
        columns["impacts"] = data["impacts"].values
    for name, (variable, _) in VARIABLES.items():
        if name in data and variable.until_overturning:
            unit = displayed(variable.unit)
            columns[f"{variable.symbol or name} [{unit}]"] = worst_component(name, data[name].values)
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    """Return the cells of a row. The column of the overturning time states the time until which the peaks of
    an overturned scene hold."""
    time = row["overturn_time [s]"]
    until = "–" if time is None else f"until {time:.4g} s"
    return tuple(until if name == "overturn_time [s]" else _format_cell(y) for name, y in row.items())


def _format_cell(value: Any) -> str:
    if isinstance(value, str):
        return value
    if math.isnan(value):
        return "no value"
    return f"{float(value):.4g}" if math.isfinite(value) else "infinite"
