"""The commands around ground motion files: `rockjax motions` and `rockjax synthetic`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._given import component as channel
from ._given import numbers
from ._options import GRID, MOTION, OUTPUT, Component, SamplingInterval, Units, said
from ._outputs import outputs, require_writable
from ._run import Report, argument, option

if TYPE_CHECKING:
    from rockjax._excitations.base import AbstractExcitation
    from rockjax._motions.motion import Motion, Motions

Pattern = Annotated[
    str | None, option("--pattern", panel=MOTION, help="Which files of folders, such as '*.AT2'.")
]


def motions(
    paths: Annotated[
        list[Path], argument("Files, folders, tables of files (suite.csv), or one problem file (.toml).")
    ],
    report: Report,
    units: Units = None,
    dt: SamplingInterval = None,
    component: Component = None,
    pattern: Pattern = None,
    periods: Annotated[
        str, option("--periods", panel=GRID, help="Periods of Sa(T) [s], separated by commas.")
    ] = "0.2,0.5,1,2",
    damping: Annotated[float, option("--damping", panel=GRID, help="Damping ratio of Sa(T) [–].")] = 0.05,
    tan_alpha: Annotated[float | None, said("tan_alpha", "; with --R")] = None,
    R: Annotated[float | None, said("R", "; with --tan-alpha")] = None,
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
    """Intensity measures of ground motions: PGA, PGV, Sa(T), Arias intensity, significant duration.

    With --tan-alpha and --R also PGA/(g tan α) and p PGV/(g tan α). Writes OUTPUT.nc where OUTPUT is given.
    Of a problem file it lists all sets of motions: the number of each motion, its name, source, sampling
    interval, duration and PGA.

    \b
    Examples:
      rockjax motions suite/ more/RSN1.AT2
      rockjax motions problem.toml
      rockjax motions record.txt --units g --dt 0.01 --tan-alpha 0.15 \\
        --R 1.5 -o measures
    """
    import math

    if any(path.suffix.lower() == ".toml" for path in paths):
        others = {"--units": units, "--dt": dt, "--component": component, "--pattern": pattern}
        others |= {"--tan-alpha": tan_alpha, "--R": R, "--output": output}
        list_problem(paths, [name for name, value in others.items() if value is not None], report)
        return
    to = None if output is None else outputs(output, "rockjax-motions").check()
    from rockjax._motions.intensity import intensity_measures
    from rockjax._structures import STANDARD_GRAVITY, Podium
    from rockjax._text.tables import lines

    if (tan_alpha is None) != (R is None):
        raise typer.BadParameter("--tan-alpha and --R go together")
    if tan_alpha is not None and not (tan_alpha > 0 and math.isfinite(tan_alpha)):
        raise ValueError(f"--tan-alpha: must be finite and > 0, got {tan_alpha:g}")
    podium = None if tan_alpha is None or R is None else Podium(math.atan(tan_alpha), R)
    wanted = numbers("periods", periods)
    found = read(paths, units and units.value, dt, component, pattern)
    data = intensity_measures(found, periods=wanted, damping=damping, podium=podium)
    columns: list[tuple[str, list[float]]] = [
        ("dt [s]", data["dt"].values.tolist()),
        ("duration [s]", data["duration"].values.tolist()),
        ("PGA [g]", (data["PGA"].values / STANDARD_GRAVITY).tolist()),
        ("PGV [m/s]", data["PGV"].values.tolist()),
        *(
            (f"Sa({T:g} s) [g]", (data["Sa"].isel(period=k).values / STANDARD_GRAVITY).tolist())
            for k, T in enumerate(wanted)
        ),
        ("Arias [m/s]", data["arias_intensity"].values.tolist()),
        ("D5–95 [s]", data["D5_95"].values.tolist()),
    ]
    if podium is not None:
        columns += [
            ("PGA/(g tan α)", data["acceleration_ratio"].values.tolist()),
            ("p PGV/(g tan α)", data["velocity_ratio"].values.tolist()),
        ]
    rows = [("name", *(name for name, _ in columns))]
    rows += [(name, *(f"{values[k]:.4g}" for _, values in columns)) for k, name in enumerate(found.names)]
    for line in lines(rows, numbers=True):
        report.say(line)
    report.facts["motions"] = [
        {"name": name} | {key: values[k] for key, values in columns} for k, name in enumerate(found.names)
    ]
    if to is not None:
        report.write(to.data(), data)


def read(
    paths: list[Path], units: str | None, dt: float | None, component: str | None, pattern: str | None
) -> Motions:
    """Motions of files, folders and tables."""
    from rockjax._motions.motion import Motions
    from rockjax._motions.readers import is_table, read_motion, read_suite

    which, found = channel(component), []
    for path in paths:
        if path.is_dir():
            found += list(read_suite(path, units=units, dt=dt, component=which, pattern=pattern))
        elif is_table(path):
            found += list(read_suite(path, units=units, dt=dt, component=which))
        else:
            found.append(read_motion(path, units=units, dt=dt, component=which))
    return Motions(tuple(found))


def list_problem(paths: list[Path], options: list[str], report: Report) -> None:
    """List the motions of a problem file, with the numbers that `--number` chooses them by."""
    if len(paths) > 1:
        raise ValueError(
            f"rockjax motions: a problem file is listed by itself, got {len(paths)} paths: "
            f"{', '.join(map(str, paths))}"
        )
    (path,) = paths
    if options:
        raise ValueError(f"{options[0]}: is of motion files; {path} is a problem file, which holds all of it")
    from rockjax._problem import Reader, load_table
    from rockjax._text.tables import lines

    reader, table = Reader(path), load_table(path)
    reader.whole(table)
    sets = reader.sets(table.get("motions", {}))
    if not sets:
        reader.fail("motions", "holds no set of motions")
    podium = reader.structure(table["structure"]) if "structure" in table else None
    facts = [
        {"set": name, "number": number} | _listed(member, reader.folder)
        for name, entries in sets.items()
        for number, member in enumerate(reader.members(entries, f"motions.{name}", podium), 1)
    ]
    for line in lines([tuple(facts[0]), *(tuple(map(_cell, row.values())) for row in facts)]):
        report.say(line)
    report.facts["motions"] = facts


def _listed(member: Motion | AbstractExcitation, folder: Path) -> dict[str, Any]:
    """What a list says of a motion."""
    from rockjax._excitations.ground import GroundMotion
    from rockjax._motions.motion import Motion
    from rockjax._structures import STANDARD_GRAVITY

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
        duration, pga = end - start, _largest(horizontal)
        vertical = _largest(member.vertical) if isinstance(member, GroundMotion) else None
    in_g = lambda value: None if value is None else value / STANDARD_GRAVITY
    return {
        "name": name,
        "source": None if source is None else str(source),
        "dt [s]": dt,
        "duration [s]": duration,
        "PGA [g]": in_g(pga),
        "vertical PGA [g]": in_g(vertical),
    }


def _largest(pulse: AbstractExcitation) -> float:
    """PGA of a pulse [m/s²]."""
    strength = pulse.strength()
    assert strength is not None
    return float(strength)


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def synthetic(
    report: Report,
    count: Annotated[int, option("--count", panel=MOTION, min=1, help="How many motions.")] = 20,
    seed: Annotated[
        int, option("--seed", panel=MOTION, min=0, help="The same seed gives the same motions.")
    ] = 0,
    dt: Annotated[float, option("--dt", panel=MOTION, help="Sampling interval [s].")] = 0.01,
    duration: Annotated[float, option("--duration", panel=MOTION, help="Duration [s].")] = 20.0,
    pga: Annotated[
        float, option("--pga", panel=MOTION, help="Peak acceleration of the noise [m/s²].")
    ] = 2.94,
    pulse: Annotated[
        tuple[float, float, float, float] | None,
        option(
            "--pulse",
            panel=MOTION,
            help="Velocity pulse of Mavroeidis & Papageorgiou: A [m/s], f_p [Hz], γ [–], ν [rad].",
        ),
    ] = None,
    omega_g: Annotated[
        float, option("--omega-g", panel=MOTION, help="Frequency of the soil ω_g [rad/s].")
    ] = 15.0,
    zeta_g: Annotated[
        float, option("--zeta-g", panel=MOTION, help="Damping ratio of the soil ζ_g [–].")
    ] = 0.6,
    output: Annotated[Path, option("--output", "-o", panel=OUTPUT, help="Folder to write into.")] = Path(
        "rockjax-synthetic"
    ),
) -> None:
    """Synthetic ground motions: filtered noise under an envelope, and a velocity pulse where wanted.

    Writes OUTPUT/synthetic-0001.AT2 … and OUTPUT/suite.csv, the table of them with all parameters.

    \b
    Examples:
      rockjax synthetic --count 20 --seed 1 -o suite
      rockjax synthetic --count 5 --pulse 0.6 0.8 2 0.5 -o near-fault
    """
    import csv
    import io

    from rockjax._excitations.wavelets import MavroeidisPapageorgiou
    from rockjax._files import write_whole
    from rockjax._motions.synthetic import synthetic_motions

    require_writable(output / "suite.csv")
    wavelet = None if pulse is None else MavroeidisPapageorgiou(*pulse)
    made = synthetic_motions(
        count, seed=seed, dt=dt, duration=duration, pga=pga, pulse=wavelet, omega_g=omega_g, zeta_g=zeta_g
    )
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    parameters = [key for key in made[0].metadata if key not in ("format", "event")]
    writer.writerow(["file", "name", *parameters])
    for motion in made:
        motion.save(output / f"{motion.name}.AT2")
        writer.writerow([f"{motion.name}.AT2", motion.name, *(motion.metadata[key] for key in parameters)])
    # Last, so that a folder with a table is complete.
    report.wrote(
        write_whole(
            output / "suite.csv", lambda name: Path(name).write_text(table.getvalue(), encoding="utf-8")
        )
    )
    report.say(repr(made))
    report.say(f"wrote {len(made)} motions and suite.csv into {output}")
    report.facts["motions"] = made.names
