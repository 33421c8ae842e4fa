"""`rockjax fragility`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rockjax._problem import models
from rockjax._problem.models import MOTION

from ._joints import joint_warnings, request_joints
from ._options import (
    SINGLE_DEFAULTS,
    Output,
    accuracy_options,
    argument,
    option,
    options_of,
    structure_options,
)
from ._outputs import Outputs, parse_outputs
from ._request import Request, read_records
from ._run import Console, command

if TYPE_CHECKING:
    import xarray

    import rockjax as rj
    from rockjax._motions.motion import Motions

FILE_KEYS = ("units", "dt", "component", "pattern", "paired")  # keys of options for files of records
# Key of an option ↦ source of motions that uses it.
SOURCES = dict.fromkeys(FILE_KEYS, "files on the command line") | {
    "seed": "--synthetic",
    "motions": "a set of the problem file",
}


@command(
    structure_options(**SINGLE_DEFAULTS),
    options_of(models.Suite, *FILE_KEYS),
    options_of(models.Fragility),
    accuracy_options(rtol=1e-9, overturn_ratio=1.0),
)
def fragility(
    request: Request,
    console: Console,
    inputs: Annotated[
        list[Path] | None,
        argument(
            "Records: files, folders, tables (suite.csv); a problem file (.toml), alone or with records.",
            show_default=False,
        ),
    ] = None,
    synthetic: Annotated[
        int | None,
        option("--synthetic", panel=MOTION, min=2, help="Number of synthetic motions, instead of files."),
    ] = None,
    output: Output = "rockjax-fragility",
) -> None:
    """Compute a fragility curve: the probability of overturning against the intensity of records.

    Scales every record to all intensity levels, and finds the least intensity at which each record overturns
    the columns (incremental dynamic analysis). Fits a lognormal curve with confidence intervals. Prints
    median, dispersion and sensitivities of the median. Writes OUTPUT.nc (the curve, with the analysis as a
    group), OUTPUT-fragility.png and OUTPUT-ida.png. If the problem file has contents (blocks on floors),
    prints their fragility curves as a table, stores them in a group of OUTPUT.nc and draws
    OUTPUT-contents.png. Ctrl-C saves nothing.

    \b
    Examples:
      rockjax fragility --synthetic 20 --seed 1
      rockjax fragility suite/ --tan-alpha 0.2 --R 2 --measure PGV \\
        --sensitivities alpha,gamma -o podium
      rockjax fragility suite/ --eta 0 --measure Sa --measure-period 1 \\
        --intensity 0.5 12 --method stripes
      rockjax fragility --example fragility --levels 40
    """
    import rockjax as rj
    from rockjax._motions.convert import make_unique
    from rockjax._studies.fragility import levels_of

    contents = request.contents()
    pictures = ("fragility", "ida", *(("contents",) if contents else ()))
    files = parse_outputs(output, "rockjax-fragility").check(pictures)
    podium, settings = request.podium(), request.settings
    options = request_joints(podium, request.options())
    suite = _suite(request, synthetic, inputs or [])
    measure = _measure(settings, suite)
    levels = levels_of(podium, suite, measure, settings.intensity, settings.levels)
    console.note(
        f"{len(suite)} records of up to {max(map(len, suite))} samples at {levels.size} levels; then the "
        "least overturning intensity of each record"
    )
    with console.progress(None, "scenes") as bar:  # the number of scenes is not known in advance
        analysis = rj.incremental_dynamic_analysis(
            podium,
            suite,
            levels,
            measure=measure,
            names=make_unique(suite.names),
            sensitivities=settings.sensitivities,
            options=options,
            progress=bar,
        )
        curves = None
        if contents:
            curves = rj.contents_fragility(
                podium,
                contents,
                suite,
                levels,
                damage_states=settings.damage_states,
                overturned=settings.overturned,  # "drop" or "exceed"
                measure=measure,
                names=make_unique(suite.names),
                confidence=settings.confidence,
                options=options,
                progress=bar,
            )
    _report_curves(console, files, analysis, settings, curves)
    console.say_warnings(joint_warnings(podium, analysis, settings.friction))


def _report_curves(
    console: Console,
    files: Outputs,
    analysis: xarray.Dataset,
    settings: models.Fragility,
    contents: xarray.Dataset | None,
) -> None:
    """Fit the curve of the podium, print it and write all files.

    - `console`, `files`: printed output, and paths of the files
    - `analysis`: incremental dynamic analysis of the podium
    - `settings`: the table `[fragility]`, overridden by options
    - `contents`: result of `contents_fragility`; None if the problem file has no contents
    """
    import numpy as np

    from rockjax._results import did_not_finish
    from rockjax._units import displayed_or_empty

    name, unit = analysis.attrs["measure"], displayed_or_empty(analysis["intensity"].attrs["units"])
    unit_suffix = f" {unit}" if unit else ""
    low, high = (float(analysis["intensity"][k]) for k in (0, -1))
    count, overturning = analysis.sizes["record"], int(analysis["capacity"].notnull().sum())
    failed = int(did_not_finish(analysis["result"]).sum())
    console.say(
        f"{count} records at "
        f"{analysis.sizes['intensity']} levels of {name} from {low:.3g} to {high:.3g}{unit_suffix}: "
        f"{analysis.attrs['scenes']} scenes, {overturning} of the records overturn"
    )
    console.json_object |= {
        "records": count,
        "overturning_records": overturning,
        "scenes": analysis.attrs["scenes"],
        "measure": name,
    }
    curve = _curve(console, analysis, settings)
    groups = {} if contents is None else {"contents": contents}
    if contents is not None:
        _report_contents(console, contents, unit_suffix)
        console.draw(files.picture("contents"), "contents_fragility", contents)
    if curve is None:
        # Without a curve, the analysis is still written: it is expensive, and shows which levels would allow
        # a fit.
        console.write(files.data(), analysis, groups)
        console.draw(files.picture("ida"), "incremental_dynamic_analysis", analysis)
        return
    console.write(files.data(), curve, {"analysis": analysis} | groups)
    console.draw(files.picture("fragility"), "fragility", curve)
    console.draw(files.picture("ida"), "incremental_dynamic_analysis", analysis)
    median, dispersion = float(curve["median_capacity"]), float(curve["dispersion"])
    median_note = dispersion_note = ""
    console.json_object |= {"units": unit or "1", "median": median, "dispersion": dispersion}
    if "interval" in curve:
        median_bounds, dispersion_bounds = np.asarray(curve["interval"].transpose("quantity", "bound"))
        interval = f", {settings.confidence:.0%} interval"
        median_note = f"{interval} {median_bounds[0]:.4g} to {median_bounds[1]:.4g}"
        dispersion_note = f"{interval} {dispersion_bounds[0]:.3f} to {dispersion_bounds[1]:.3f}"
        console.json_object |= {
            "median_interval": list(median_bounds),
            "dispersion_interval": list(dispersion_bounds),
            "confidence": settings.confidence,
        }
    console.say(f"median overturning {name}: {median:.4g}{unit_suffix}{median_note}")
    console.say(f"dispersion: {dispersion:.3f}{dispersion_note}")
    if "median_sensitivity" in curve:
        slopes = dict(
            zip(curve["parameter"].values.tolist(), curve["median_sensitivity"].values.tolist(), strict=True)
        )
        for parameter, value in slopes.items():
            console.say(f"d ln(median)/d ln {parameter}: {value:.4g}")
        console.json_object["median_sensitivity"] = slopes
    if failed:
        from rockjax._results import explain_failures

        console.error(explain_failures(analysis["result"]))


def _report_contents(console: Console, data: xarray.Dataset, unit_suffix: str) -> None:
    """Print a table of the fragility curves of contents.

    - `console`: prints the table
    - `data`: result of `contents_fragility`
    - `unit_suffix`: a space and the unit of the intensity; empty without a unit
    """
    from rockjax._text.tables import align_rows

    rows = [["contents", "max|φ|/α_c", f"median {data.attrs['measure']}{unit_suffix}", "dispersion"]]
    entries: list[dict[str, Any]] = []
    for name in data["contents"].values.tolist():
        for state in data["damage_state"].values.tolist():
            curve = data.sel(contents=name, damage_state=state)
            median, dispersion = float(curve["median_capacity"]), float(curve["dispersion"])
            rows.append([name, f"{state:g}" if state else "rocks", f"{median:.4g}", f"{dispersion:.3f}"])
            entries.append({"name": name, "damage_state": state, "median": median, "dispersion": dispersion})
    for line in align_rows(rows):
        console.say(line)
    console.json_object["contents"] = entries


def _curve(console: Console, analysis: xarray.Dataset, settings: models.Fragility) -> xarray.Dataset | None:
    """Return the fragility curve.

    If its confidence intervals cannot be computed, the curve has none. If no curve can be fitted, the result
    is None. In both cases, the function prints the cause and sets the exit status to 1.
    """
    import rockjax as rj

    try:
        return rj.fragility(analysis, method=settings.method, confidence=settings.confidence)
    except ValueError as error:
        try:
            curve = rj.fragility(analysis, method=settings.method, confidence=None)
        except ValueError:
            console.error(f"no curve: {error}")
            return None
        console.error(str(error))
        return curve


def _suite(request: Request, synthetic: int | None, paths: list[Path]) -> Motions:
    """Return the motions: records from files, synthetic motions, or a set of the problem file.

    - `request`: problem of the command
    - `synthetic`: number of synthetic motions; None for none
    - `paths`: files, folders and tables of records on the command line
    """
    from rockjax._motions.synthetic import synthetic_motions

    if paths and synthetic is not None:
        raise ValueError("--synthetic and files of records are alternatives; give one")
    sets = request.problem.motions
    if not (sets or paths or synthetic):
        raise ValueError(
            "rockjax fragility needs records: files, folders or tables, --synthetic N, or a problem file "
            "with [motions]"
        )
    source = "--synthetic" if synthetic else "files on the command line" if paths else SOURCES["motions"]
    for name in request.option_values(SOURCES):
        if SOURCES[name] != source:
            in_file = f", or set {name} in the table of the set" if source == SOURCES["motions"] else ""
            raise ValueError(f"--{name} applies only to {SOURCES[name]}; leave it out{in_file}")
    if synthetic is not None:
        return synthetic_motions(synthetic, seed=request.settings.seed)
    if paths:
        file_options = request.option_values(FILE_KEYS)
        paired = file_options.pop("paired", False)
        motions = read_records(request.reader, paths, file_options)
        return motions.paired() if paired else motions
    return request.reader.records(sets, request.motion_set_name(request.settings.motions, "motions"))


def _measure(settings: models.Fragility, suite: Motions) -> rj.Measure:
    from rockjax._studies.fragility import measure_of

    name = settings.measure
    if name != "Sa" and settings.measure_period is not None:
        raise ValueError(
            f"--measure-period applies only to Sa; leave it out, or use --measure Sa instead of {name}"
        )
    if name == "Sa" and settings.measure_period is None:
        raise ValueError("--measure Sa needs --measure-period, such as --measure-period 1")
    return measure_of(name, settings.measure_period, suite)
