"""The command line: `rockjax spectrum`, `overturning`, `response`, `plot`, `design`; `motions` and `synthetic` elsewhere."""

from __future__ import annotations

import enum
import importlib
import os
import shlex
import threading
import time
from contextvars import ContextVar
from pathlib import Path
from typing import Annotated

import typer
import typer.core

from rockjax import _cli_motions

_COMMAND: ContextVar[str] = ContextVar("command")


class _Commands(typer.core.TyperGroup):
    """Keeps the command line as it was given, for the files that it makes."""

    def parse_args(self, ctx, args):
        _COMMAND.set(shlex.join(["rockjax", *args]))
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_Commands,
    help="Rocking podium structures: spectra, overturning boundaries, responses, design. SI units and ratios.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


class PulseName(enum.StrEnum):
    ricker = "ricker"
    antisymmetric_ricker = "antisymmetric-ricker"
    one_sine = "one-sine"
    one_cosine = "one-cosine"
    half_sine = "half-sine"


class RestitutionName(enum.StrEnum):
    paper = "paper"
    compatible = "compatible"


TanAlpha = Annotated[float, typer.Option("--tan-alpha", help="Column slenderness tan α = B/H [–].")]
Radius = Annotated[float, typer.Option("--R", help="Half diagonal of a column R [m].")]
Gamma = Annotated[float, typer.Option("--gamma", help="Mass ratio of the beam γ = m_b/(N m_c) [–].")]
Zeta = Annotated[float, typer.Option("--zeta", help="Damping ratio of the superstructure ζ [–].")]
MassRatios = Annotated[str, typer.Option("--eta-over-gamma", help="Mass ratios η/γ, separated by commas.")]
Periods = Annotated[str, typer.Option("--T-s", help="Superstructure periods T_s [s]; 0 is rigid.")]
Frequencies = Annotated[tuple[float, float], typer.Option("--frequency", help="Range of ω_p/p.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar, no summary.")]
Pulse = Annotated[PulseName, typer.Option("--pulse", help="Ground motion.")]
Law = Annotated[RestitutionName, typer.Option("--restitution", help="Law of the impact: Eq. (27), or compatible with (26).")]
Method = Annotated[str, typer.Option("--method", help="Runge–Kutta method: dopri8, tsit5, dopri5, bosh3.")]
Tolerance = Annotated[float, typer.Option("--rtol", help="Relative tolerance of the step-size control.")]
Output = Annotated[Path, typer.Option("--output", "-o", help="Prefix of the files to write.")]


Resume = Annotated[bool, typer.Option("--resume", help="Go on where Ctrl-C stopped the same command.")]


def _interrupted(output: Path, datasets: list, message: str) -> typer.Exit:
    """Keep what is there, and say how to go on."""
    from rockjax import _partial

    if any(data is not None for data in datasets):
        kept = _partial.save(_partial.path_of(output), datasets)
        typer.echo(f"\nrockjax: {message}; kept in {kept}: the same command with --resume goes on from there", err=True)
    else:
        typer.echo(f"\nrockjax: {message}; nothing to keep", err=True)
    return typer.Exit(130)


def _write(path: str, data) -> Path:
    """Write a dataset with the command that made it."""
    from rockjax._files import write_dataset

    data.attrs["command"] = _COMMAND.get()
    return write_dataset(path, data)


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise typer.BadParameter(f"expected numbers separated by commas, got {text!r}") from None


def _pulse(name: PulseName):
    from rockjax._pulses import PULSES

    return PULSES[name.value]


def _prepare() -> None:
    """Compiled programs are kept between runs; pictures are made without a screen."""
    import jax
    import matplotlib

    matplotlib.use("Agg")
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(base / "rockjax"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def _podiums(tan_alpha: float, R: float, gamma: float, ratios, periods, zeta: float, law: RestitutionName) -> list:
    """One podium per mass ratio η/γ and period T_s, 0 for a rigid superstructure."""
    import math

    import rockjax as rj

    podiums = []
    for ratio in ratios:
        for period in periods:
            top = rj.Rigid(ratio * gamma) if period == 0 else rj.Elastic(ratio * gamma, period, zeta)
            podiums.append(rj.Podium(math.atan(tan_alpha), R, gamma, top, restitution=law.value))
    return podiums


def _panels(datasets: list, ratios, periods):
    """The datasets of `_podiums` put together, with the dims `eta_over_gamma` and `T_s`."""
    import numpy as np
    import xarray

    each = iter(datasets)
    # Where one has more boundaries than another.
    join = {
        "combine_attrs": "drop_conflicts",
        "join": "outer",
        "fill_value": {"impacts": -1, "boundaries": np.nan},
        "coords": "different",
        "compat": "equals",
        "data_vars": "all",
    }
    rows = [
        xarray.concat([next(each).assign_coords(T_s=period, eta_over_gamma=ratio) for period in periods], "T_s", **join)
        for ratio in ratios
    ]
    return xarray.concat(rows, "eta_over_gamma", **join)


@app.command()
def spectrum(
    tan_alpha: TanAlpha = 0.15,
    R: Radius = 1.5,
    gamma: Gamma = 10.0,
    eta_over_gamma: MassRatios = "1,5,10",
    T_s: Periods = "0,0.1,0.5,1",
    zeta: Zeta = 0.05,
    pulse: Pulse = PulseName.ricker,
    restitution: Law = RestitutionName.paper,
    frequency: Frequencies = (1.0, 8.0),
    acceleration: Annotated[tuple[float, float], typer.Option(help="Range of a_p/(g tan α).")] = (1.0, 12.0),
    points: Annotated[int, typer.Option(min=2, help="Points along each axis.")] = 100,
    method: Method = "dopri8",
    rtol: Tolerance = 1e-8,
    output: Output = Path("rockjax-spectrum"),
    resume: Resume = False,
    quiet: Quiet = False,
) -> None:
    """Rocking spectra and minimum overturning curves over a grid of pulses.

    With no flags: the 12 panels of the paper's Fig. 6 and its Fig. 7. Writes OUTPUT.nc, OUTPUT-rotation.png and
    OUTPUT-overturning.png. Ctrl-C keeps the scenes that are solved in OUTPUT.partial.nc; --resume solves the others.
    """
    began = time.perf_counter()
    _prepare()
    # What draws and writes is loaded while the scenes are worked out.
    threading.Thread(target=lambda: importlib.import_module("rockjax.plots")).start()
    import numpy as np
    from tqdm import tqdm

    import rockjax as rj
    from rockjax import _partial

    options = rj.Options(outputs=("peak_rotation",), rtol=rtol, atol=0.01 * rtol, method=method)
    ratios, periods = _numbers(eta_over_gamma), _numbers(T_s)
    x, y = np.linspace(*frequency, points), np.linspace(*acceleration, points)
    total = len(ratios) * len(periods) * points**2
    podiums = _podiums(tan_alpha, R, gamma, ratios, periods, zeta, restitution)
    known = _partial.load(_partial.path_of(output), len(podiums)) if resume else None
    try:
        with tqdm(total=total, unit=" scenes", unit_scale=True, disable=quiet) as bar:
            spectra = rj.rocking_spectra(podiums, _pulse(pulse), x, y, options=options, progress=bar, resume=known)
    except rj.Interrupted as stopped:
        raise _interrupted(output, stopped.partial, str(stopped)) from None
    from rockjax import plots
    from rockjax._files import write_figure

    panels = _panels(spectra, ratios, periods)
    panels["T_s"].attrs = {"units": "s", "long_name": "superstructure period T_s, 0 is rigid"}
    panels["eta_over_gamma"].attrs = {"units": "1", "long_name": "mass ratio η/γ"}
    panels.attrs["zeta"] = zeta
    written = [_write(f"{output}.nc", panels)]
    for suffix, draw in (("rotation", plots.spectra), ("overturning", plots.overturning_curves)):
        written.append(write_figure(f"{output}-{suffix}.png", draw(panels)))
    _partial.path_of(output).unlink(missing_ok=True)
    if quiet:
        return
    failed = int((panels["result"] > 2).sum())
    overturned = float(panels["overturned"].mean())
    typer.echo(f"{total} scenes: {overturned:.1%} overturned, {failed} without an answer")
    least = rj.minimum_overturning(panels).min("frequency_ratio")
    for ratio in ratios:
        line = ", ".join(f"T_s = {T:g} s: {float(least.sel(eta_over_gamma=ratio, T_s=T)):.2f}" for T in periods)
        typer.echo(f"least overturning a_p/(g tan α) on the grid, η/γ = {ratio:g}: {line}")
    for path in written:
        typer.echo(f"wrote {path}")
    typer.echo(f"{time.perf_counter() - began:.1f} s")


@app.command()
def overturning(
    tan_alpha: TanAlpha = 0.15,
    R: Radius = 1.5,
    gamma: Gamma = 10.0,
    eta_over_gamma: MassRatios = "1,5,10",
    T_s: Periods = "0,0.1,0.5,1",
    zeta: Zeta = 0.05,
    pulse: Pulse = PulseName.ricker,
    restitution: Law = RestitutionName.paper,
    frequency: Frequencies = (1.0, 8.0),
    max_acceleration: Annotated[float, typer.Option(help="End of the search, a_p/(g tan α).")] = 12.0,
    points: Annotated[int, typer.Option(min=2, help="Frequencies.")] = 141,
    sensitivities: Annotated[str, typer.Option(help="Parameters y of d a_ov/d ln y; empty for none.")] = "alpha,gamma",
    rtol: Tolerance = 1e-11,
    output: Output = Path("rockjax-overturning"),
    resume: Resume = False,
    quiet: Quiet = False,
) -> None:
    """Exact overturning boundaries over pulse frequency, with the windows of survival above them.

    With no flags: the paper's Fig. 7, from boundaries instead of a grid. Writes OUTPUT.nc, OUTPUT-boundaries.png and,
    with sensitivities, OUTPUT-sensitivity.png. Ctrl-C keeps the podiums that are done in OUTPUT.partial.nc; --resume goes
    on with the others.
    """
    began = time.perf_counter()
    _prepare()
    threading.Thread(target=lambda: importlib.import_module("rockjax.plots")).start()
    import numpy as np
    from tqdm import tqdm

    import rockjax as rj
    from rockjax import _partial
    from rockjax._overturning_spectrum import check_overturning_resumes

    ratios, periods = _numbers(eta_over_gamma), _numbers(T_s)
    names = [name.strip() for name in sensitivities.split(",") if name.strip()]
    x = np.linspace(*frequency, points)
    podiums = _podiums(tan_alpha, R, gamma, ratios, periods, zeta, restitution)
    options = rj.Options(rtol=rtol, atol=0.01 * rtol)
    found: list = _partial.load(_partial.path_of(output), len(podiums)) if resume else [None] * len(podiums)
    for k, podium in enumerate(tqdm(podiums, unit=" podiums", disable=quiet)):
        if found[k] is not None:
            check_overturning_resumes(found[k], podium, _pulse(pulse), x, max_acceleration, names, options)
            continue
        try:
            found[k] = rj.overturning_spectrum(
                podium, _pulse(pulse), x, max_acceleration_ratio=max_acceleration, sensitivities=names, options=options
            )
        except KeyboardInterrupt:
            raise _interrupted(output, found, f"stopped with {k} of {len(podiums)} podiums done") from None
    from rockjax import plots
    from rockjax._files import write_figure

    panels = _panels(found, ratios, periods)
    panels.attrs["zeta"] = zeta
    written = [_write(f"{output}.nc", panels)]
    pictures = {"boundaries": plots.overturning_boundaries(panels)}
    if names:
        pictures["sensitivity"] = plots.sensitivities(panels)
    for suffix, figure in pictures.items():
        written.append(write_figure(f"{output}-{suffix}.png", figure))
    _partial.path_of(output).unlink(missing_ok=True)
    if quiet:
        return
    least = panels["minimum"].min("frequency_ratio")
    for ratio in ratios:
        line = ", ".join(f"T_s = {T:g} s: {float(least.sel(eta_over_gamma=ratio, T_s=T)):.4f}" for T in periods)
        typer.echo(f"least overturning a_p/(g tan α), η/γ = {ratio:g}: {line}")
    windows = int((panels["boundaries"].count("boundary") > 1).sum())
    typer.echo(f"{sum(data.attrs['scenes'] for data in found)} scenes; windows of survival at {windows} frequencies")
    for path in written:
        typer.echo(f"wrote {path}")
    typer.echo(f"{time.perf_counter() - began:.1f} s")


@app.command()
def response(
    tan_alpha: TanAlpha = 0.15,
    R: Radius = 1.5,
    gamma: Gamma = 10.0,
    eta: Annotated[float, typer.Option(help="Mass ratio of the superstructure η = m_t/(N m_c); 0 is none.")] = 100.0,
    T_s: Annotated[float, typer.Option("--T-s", help="Superstructure period T_s [s]; 0 is rigid.")] = 0.5,
    zeta: Zeta = 0.05,
    pulse: Pulse = PulseName.ricker,
    acceleration_ratio: Annotated[float, typer.Option(help="a_p/(g tan α).")] = 2.5,
    T_p: Annotated[float, typer.Option("--T-p", help="Pulse period T_p [s].")] = 1.0,
    t_end: Annotated[float | None, typer.Option("--t-end", help="End of the history [s].")] = None,
    restitution: Law = RestitutionName.paper,
    method: Method = "dopri8",
    rtol: Tolerance = 1e-8,
    output: Output = Path("rockjax-response"),
) -> None:
    """One time history: rotation, deformation of the superstructure, ground acceleration. Writes OUTPUT.nc and .png."""
    _prepare()
    import math

    import rockjax as rj
    from rockjax import plots
    from rockjax._files import write_figure

    top = None if eta == 0 else rj.Rigid(eta) if T_s == 0 else rj.Elastic(eta, T_s, zeta)
    podium = rj.Podium(math.atan(tan_alpha), R, gamma, top, restitution=restitution.value)
    motion = _pulse(pulse)(acceleration_ratio * float(podium.g) * tan_alpha, T_p)
    options = rj.Options(rtol=rtol, atol=0.01 * rtol, method=method)
    history = rj.simulate(podium, motion, t_end=t_end, options=options)
    data = history.dataset()
    typer.echo(repr(history))
    typer.echo(f"wrote {_write(f'{output}.nc', data)}")
    typer.echo(f"wrote {write_figure(f'{output}.png', plots.response(data))}")


@app.command()
def plot(
    file: Annotated[Path, typer.Argument(help="A netCDF file that rockjax has written.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Prefix of the pictures; by default the file without its ending.")
    ] = None,
    kind: Annotated[
        str, typer.Option("--kind", help="Pictures, separated by commas; by default those that the command drew.")
    ] = "",
) -> None:
    """Draw a file again: spectra, overturning spectra, responses, design charts.

    Writes OUTPUT-KIND.png. Kinds of a rocking spectrum: rotation, overturning; of an overturning spectrum: boundaries,
    sensitivity; of a response: response, phase-portrait, moment-rotation, energy, and film, a GIF.
    """
    _prepare()
    from rockjax._redraw import redraw

    for path in redraw(file, output, [name.strip() for name in kind.split(",") if name.strip()]):
        typer.echo(f"wrote {path}")


@app.command()
def design(
    problem: Annotated[
        Path, typer.Argument(help="The problem: structure, variables, targets, motions (TOML).", exists=True)
    ],
    starts: Annotated[int | None, typer.Option(min=1, help="Starting points; replaces those of the file.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the starting points; replaces that of the file.")] = None,
    output: Output = Path("rockjax-design"),
    quiet: Quiet = False,
) -> None:
    """Size a podium: variables within bounds, targets on overturning, rotation, shear, an objective to minimise.

    Prints variables, targets with their margins and prices; writes OUTPUT.json, OUTPUT-convergence.png and, before and
    after, OUTPUT-response.png. Ends with 1 where no design satisfies the targets.
    """
    _prepare()
    from optimise._cli import design_command

    if not design_command(problem, output, starts, seed, quiet):
        raise typer.Exit(1)


_cli_motions.register(app)


def main() -> None:
    try:
        app()
    except ValueError as error:
        typer.echo(f"rockjax: {error}", err=True)
        raise SystemExit(2) from None
    except (OSError, RuntimeError) as error:
        typer.echo(f"rockjax: {error}", err=True)
        raise SystemExit(1) from None


if __name__ == "__main__":
    main()
