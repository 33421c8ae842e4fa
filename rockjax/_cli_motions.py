"""The commands around ground motion files: `rockjax motions` and `rockjax synthetic`."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ._motions import Motions

# Units without brackets, which the help would take for markup.
Component = Annotated[str | None, typer.Option(help="Number or name of the channel, where files have several.")]


def register(app: typer.Typer) -> None:
    app.command()(motions)
    app.command()(synthetic)


def motions(
    paths: Annotated[list[Path], typer.Argument(help="Files, folders, tables of files (suite.csv).")],
    units: Annotated[str | None, typer.Option(help="g, m/s2, cm/s2, gal or mm/s2, where files do not say it.")] = None,
    dt: Annotated[float | None, typer.Option(help="Sampling interval in s, where files do not say it.")] = None,
    component: Component = None,
    pattern: Annotated[str | None, typer.Option(help="Which files of folders, such as '*.AT2'.")] = None,
    periods: Annotated[str, typer.Option(help="Periods of Sa(T) in s, separated by commas.")] = "0.2,0.5,1,2",
    damping: Annotated[float, typer.Option(help="Damping ratio of Sa(T).")] = 0.05,
    tan_alpha: Annotated[float | None, typer.Option("--tan-alpha", help="Column slenderness tan α; with --R.")] = None,
    R: Annotated[float | None, typer.Option("--R", help="Half diagonal of a column R in m; with --tan-alpha.")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Prefix of the netCDF file to write.")] = None,
) -> None:
    """Intensity measures of ground motions: PGA, PGV, Sa(T), Arias intensity, significant duration.

    With --tan-alpha and --R also PGA/(g tan α) and p PGV/(g tan α). Writes OUTPUT.nc where OUTPUT is given.
    """
    import math

    from ._files import write_dataset
    from ._intensity import intensity_measures
    from ._motions import Motions, aligned
    from ._structures import STANDARD_GRAVITY, Podium

    if (tan_alpha is None) != (R is None):
        raise typer.BadParameter("--tan-alpha and --R go together")
    podium = None if tan_alpha is None or R is None else Podium(math.atan(tan_alpha), R)
    try:
        wanted = [float(part) for part in periods.split(",")]
    except ValueError:
        raise typer.BadParameter(f"expected periods separated by commas, got {periods!r}") from None
    found = Motions(tuple(motion for path in paths for motion in _read(path, units, dt, component, pattern)))
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
    for line in aligned(rows):
        typer.echo(line)
    if output is not None:
        typer.echo(f"wrote {write_dataset(f'{output}.nc', data)}")


def _read(path: Path, units: str | None, dt: float | None, component: str | None, pattern: str | None) -> Motions:
    """Motions of a file, a folder or a table; warnings become lines."""
    from ._motions import Motions
    from ._readers import is_table, read_motion, read_suite

    which = int(component) if component is not None and component.isdecimal() else component
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        if path.is_dir():
            found = read_suite(path, units=units, dt=dt, component=which, pattern=pattern)
        elif is_table(path):
            found = read_suite(path, units=units, dt=dt, component=which)
        else:
            found = Motions((read_motion(path, units=units, dt=dt, component=which),))
    for warning in said:
        typer.echo(f"rockjax: warning: {warning.message}", err=True)
    return found


def synthetic(
    count: Annotated[int, typer.Option(min=1, help="How many motions.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same motions.")] = 0,
    dt: Annotated[float, typer.Option(help="Sampling interval in s.")] = 0.01,
    duration: Annotated[float, typer.Option(help="Duration in s.")] = 20.0,
    pga: Annotated[float, typer.Option(help="Peak acceleration of the noise in m/s².")] = 2.94,
    pulse: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(help="Velocity pulse of Mavroeidis & Papageorgiou: A in m/s, f_p in Hz, γ, ν in rad."),
    ] = None,
    omega_g: Annotated[float, typer.Option("--omega-g", help="Frequency of the soil ω_g in rad/s.")] = 15.0,
    zeta_g: Annotated[float, typer.Option("--zeta-g", help="Damping ratio of the soil ζ_g.")] = 0.6,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write into.")] = Path("rockjax-synthetic"),
) -> None:
    """Synthetic ground motions: filtered noise under an envelope, and a velocity pulse where wanted.

    Writes OUTPUT/synthetic-0001.AT2 … and OUTPUT/suite.csv, the table of them with all parameters.
    """
    import csv
    import io

    from ._files import write_whole
    from ._synthetic import synthetic_motions
    from ._wavelets import MavroeidisPapageorgiou

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
    write_whole(output / "suite.csv", lambda name: Path(name).write_text(table.getvalue(), encoding="utf-8"))
    typer.echo(repr(made))
    typer.echo(f"wrote {len(made)} motions and suite.csv into {output}")
