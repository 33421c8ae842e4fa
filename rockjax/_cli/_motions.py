"""Commands for ground motion files: `rockjax motions` and `rockjax synthetic`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rockjax._files import require_writable
from rockjax._problem import models
from rockjax._problem.models import MOTION, OUTPUT

from ._options import argument, option, options_of
from ._outputs import parse_outputs
from ._request import read_records
from ._run import Console, command

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rockjax._excitations.base import AbstractExcitation
    from rockjax._motions.motion import Motion

FILE_KEYS = ("units", "dt", "component", "pattern")  # keys of options for files of records


@command(
    options_of(models.Suite, *FILE_KEYS),
    options_of(models.Measures),
    options_of(models.ByRatios, "tan_alpha", "R"),
    jax=False,
)
def motions(
    reader: Any,
    paths: Annotated[
        list[Path], argument("Files, folders, tables of files (suite.csv), or one problem file (.toml).")
    ],
    console: Console,
    output: Annotated[
        str | None,
        option(
            "--output",
            "-o",
            metavar="PATH",
            panel=OUTPUT,
            help="Prefix of the netCDF file to write, or a folder for it.",
        ),
    ] = None,
) -> None:
    """Print intensity measures of ground motions: PGA, PGV, Sa(T), Arias intensity, significant duration.

    With --tan-alpha and --R, also prints PGA/(g tan α) and p PGV/(g tan α), where p is the frequency
    parameter of the columns. With --output, writes OUTPUT.nc.

    For a problem file, lists the motions of all sets: number, name, source, sampling interval, duration, PGA
    and vertical PGA.

    \b
    Examples:
      rockjax motions suite/ more/RSN1.AT2
      rockjax motions problem.toml
      rockjax motions record.txt --units g --dt 0.01 --tan-alpha 0.15 \\
        --R 1.5 -o measures
    """
    if any(path.suffix.lower() == ".toml" for path in paths):
        list_problem(paths, reader.set_by_options, console)
        return
    files = None if output is None else parse_outputs(output, "rockjax-motions").check()
    from rockjax._motions.intensity import intensity_measures
    from rockjax._units import STANDARD_GRAVITY

    column = reader.option_values(("tan_alpha", "R"))
    if len(column) == 1:
        raise typer.BadParameter("--tan-alpha and --R belong together; give both or neither")
    podium = reader.structure(reader.check(models.ByRatios, column)) if column else None
    settings = reader.check(models.Measures, reader.option_values(("periods", "damping")))
    suite = read_records(reader, paths, reader.option_values(FILE_KEYS))
    data = intensity_measures(suite, periods=settings.periods, damping=settings.damping, podium=podium)
    accelerations = {f"Sa({T:g} s) [g]": data["Sa"].isel(period=k) for k, T in enumerate(settings.periods)}
    columns = {
        "dt [s]": data["dt"],
        "duration [s]": data["duration"],
        "PGA [g]": data["PGA"] / STANDARD_GRAVITY,
        "PGV [m/s]": data["PGV"],
        **{name: y / STANDARD_GRAVITY for name, y in accelerations.items()},
        "Arias [m/s]": data["arias_intensity"],
        "D5–95 [s]": data["D5_95"],
    }
    if podium is not None:
        columns["PGA/(g tan α)"], columns["p PGV/(g tan α)"] = (
            data["acceleration_ratio"],
            data["velocity_ratio"],
        )
    _print_table(
        console,
        [
            {"name": name} | {heading: float(y.values[k]) for heading, y in columns.items()}
            for k, name in enumerate(suite.names)
        ],
        numbers=True,
    )
    if files is not None:
        console.write(files.data(), data)


def list_problem(paths: list[Path], options: Mapping[str, tuple[str, Any]], console: Console) -> None:
    """List the motions of a problem file, with the numbers by which `--number` selects them.

    - `paths`: a list with one path, the problem file
    - `options`: options on the command line: key ↦ (flag, value)
    - `console`: prints the table

    Raises `ValueError` for several paths, for options that apply to files of records, and for a file without
    motions.
    """
    if len(paths) > 1:
        raise ValueError(
            f"rockjax motions lists one problem file without other paths, got {len(paths)} paths: "
            f"{', '.join(map(str, paths))}"
        )
    (path,) = paths
    for name, (flag, _) in options.items():
        if name not in ("paths", "quiet", "verbose", "json"):
            raise ValueError(
                f"{flag} applies to files of records, but {path} is a problem file; leave out {flag}"
            )
    from rockjax._problem.reading import Reader, load_table

    reader = Reader(path)
    problem = reader.check(models.Problem, load_table(path))
    if not problem.motions:
        reader.fail("motions", "the file has no set of motions; add one, such as [motions.design]")
    podium = None if problem.structure is None else reader.structure(problem.structure)
    rows = [
        {"set": name, "number": number} | _motion_row(member, reader.folder)
        for name in problem.motions
        for number, member in enumerate(reader.members(problem.motions, name, podium), 1)
    ]
    _print_table(console, rows)


def _print_table(console: Console, rows: list[dict[str, Any]], numbers: bool = False) -> None:
    """Print a table of motions with headings. With `numbers`, all columns except the first are aligned to the
    right."""
    from rockjax._text.tables import align_rows

    for line in align_rows(
        [tuple(rows[0]), *(tuple(map(_format_cell, row.values())) for row in rows)], numbers=numbers
    ):
        console.say(line)
    console.json_object["motions"] = rows


def _motion_row(member: Motion | AbstractExcitation, folder: Path) -> dict[str, Any]:
    """Return the row of a motion: name, source, sampling interval [s], duration [s], PGA [g] and vertical PGA
    [g]. Values that the motion does not have are None. The path of a source in `folder` is relative to
    `folder`."""
    from rockjax._excitations.ground import GroundMotion
    from rockjax._motions.motion import Motion
    from rockjax._units import STANDARD_GRAVITY

    if isinstance(member, Motion):
        source: Any = member.metadata.get("format") if member.source is None else member.source
        if isinstance(source, Path) and source.is_relative_to(folder):
            source = source.relative_to(folder)
        name, dt, duration, pga = member.name, member.dt, member.duration, member.pga
        vertical = None if member.vertical is None else member.vertical.pga
    else:
        horizontal = member.horizontal if isinstance(member, GroundMotion) else member
        name, source, dt = repr(horizontal), "pulse", None
        start, end = map(float, member.support)
        duration, pga = end - start, _pulse_pga(horizontal)
        vertical = _pulse_pga(member.vertical) if isinstance(member, GroundMotion) else None
    in_g = lambda value: None if value is None else value / STANDARD_GRAVITY
    return {
        "name": name,
        "source": None if source is None else str(source),
        "dt [s]": dt,
        "duration [s]": duration,
        "PGA [g]": in_g(pga),
        "vertical PGA [g]": in_g(vertical),
    }


def _pulse_pga(pulse: AbstractExcitation) -> float:
    """Return the PGA of a pulse [m/s²]."""
    strength = pulse.strength()  # the largest absolute acceleration
    assert strength is not None
    return float(strength)


def _format_cell(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


@command(options_of(models.Synthetic), jax=False)
def synthetic(
    reader: Any,
    console: Console,
    pulse: Annotated[
        tuple[float, float, float, float] | None,
        option(
            "--pulse",
            panel=MOTION,
            help="Velocity pulse of Mavroeidis & Papageorgiou: A [m/s], f_p [Hz], γ [–], ν [rad].",
        ),
    ] = None,
    output: Annotated[Path, option("--output", "-o", panel=OUTPUT, help="Folder to write into.")] = Path(
        "rockjax-synthetic"
    ),
) -> None:
    """Make synthetic ground motions: filtered noise under an envelope, optionally with a velocity pulse.

    Writes OUTPUT/synthetic-0001.AT2 … and OUTPUT/suite.csv, a table of these files and their parameters.

    \b
    Examples:
      rockjax synthetic --count 20 --seed 1 -o suite
      rockjax synthetic --count 5 --pulse 0.6 0.8 2 0.5 -o near-fault
    """
    import csv
    import io

    from rockjax._excitations.wavelets import MavroeidisPapageorgiou
    from rockjax._files import write_atomically
    from rockjax._motions.synthetic import synthetic_motions

    require_writable(output / "suite.csv")
    wavelet = None if pulse is None else MavroeidisPapageorgiou(*pulse)
    settings = reader.check(models.Synthetic, reader.option_values(models.Synthetic.model_fields))
    arguments = settings.model_dump(exclude={"synthetic", "scale", "vertical_ratio"})
    suite = synthetic_motions(settings.synthetic, **arguments, pulse=wavelet)
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    parameters = [key for key in suite[0].metadata if key not in ("format", "event")]
    writer.writerow(["file", "name", *parameters])
    for motion in suite:
        motion.save(output / f"{motion.name}.AT2")
        writer.writerow([f"{motion.name}.AT2", motion.name, *(motion.metadata[key] for key in parameters)])
    # The table is written last, when all files that it lists exist.
    console.add_file(
        write_atomically(
            output / "suite.csv", lambda name: Path(name).write_text(table.getvalue(), encoding="utf-8")
        )
    )
    console.say(repr(suite))
    console.say(f"wrote {len(suite)} motions and suite.csv into {output}")
    console.json_object["motions"] = suite.names
