"""`rockjax fragility`."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ._given import Given, names, problem_file
from ._motions import Pattern, read
from ._options import (
    ACCURACY,
    GRID,
    MOTION,
    Component,
    Example,
    Output,
    Rtol,
    SamplingInterval,
    Structure,
    Units,
)
from ._outputs import Outputs, outputs
from ._run import Flags, Report, argument, flag, option, prepare

if TYPE_CHECKING:
    import xarray

    import rockjax as rj
    from rockjax._motions.motion import Motions

HIGHEST = 6.0  # PGA over g tan α: up to there the suite is scaled, where nothing else is said
STATISTICS = "Statistics"


class MeasureName(enum.StrEnum):
    PGA = "PGA"
    PGV = "PGV"
    Sa = "Sa"
    scale = "scale"


class FitName(enum.StrEnum):
    capacities = "capacities"
    stripes = "stripes"


@dataclass
class Suite(Flags):
    synthetic: Annotated[
        int | None,
        option("--synthetic", panel=MOTION, min=2, help="So many synthetic motions, instead of files."),
    ] = None
    units: Units = None
    dt: SamplingInterval = None
    component: Component = None
    pattern: Pattern = None
    paired: Annotated[
        bool,
        option("--paired", panel=MOTION, help="Each horizontal record with the vertical one of its station."),
    ] = False
    motions: Annotated[
        str | None,
        option(
            "--motions", panel=MOTION, help="Which set of motions of the problem file, where it has several."
        ),
    ] = None


@dataclass
class Levels(Flags):
    measure: Annotated[
        MeasureName,
        option(
            "--measure",
            panel=GRID,
            help="Intensity: PGA, PGV, Sa at --measure-period, or the factor on the records.",
        ),
    ] = MeasureName.PGA
    measure_period: Annotated[
        float | None, option("--measure-period", panel=GRID, help="Period of Sa [s].")
    ] = None
    intensity: Annotated[
        tuple[float, float] | None,
        option(
            "--intensity",
            panel=GRID,
            help=(
                "Lowest and highest level, in units of the measure: [m/s²], [m/s], [–]. By default up to "
                "the level at which "
                "the median PGA of the suite is 6 g tan α."
            ),
        ),
    ] = None
    levels: Annotated[int, option("--levels", panel=GRID, min=1, help="Number of levels.")] = 20


@dataclass
class Statistics(Flags):
    method: Annotated[
        FitName,
        option(
            "--method",
            panel=STATISTICS,
            help="Fit of the least overturning intensities, or of the counts at the levels.",
        ),
    ] = FitName.capacities
    confidence: Annotated[
        float, option("--confidence", panel=STATISTICS, help="Of the intervals and bands, in 0…1 [–].")
    ] = 0.9
    seed: Annotated[int, option("--seed", panel=STATISTICS, min=0, help="Seed of synthetic motions.")] = 0
    sensitivities: Annotated[
        str,
        option(
            "--sensitivities",
            panel=STATISTICS,
            help="Parameters y of d ln(median)/d ln y, separated by commas.",
        ),
    ] = ""


@dataclass
class Tolerance(Flags):
    limit: Annotated[
        float, option("--limit", panel=ACCURACY, help="Limit state max|θ|/α [–]; 1 is overturning.")
    ] = 1.0
    rtol: Rtol = 1e-9


def fragility(
    structure: Structure,
    suite: Suite,
    levels: Levels,
    statistics: Statistics,
    accuracy: Tolerance,
    report: Report,
    inputs: Annotated[
        list[Path] | None,
        argument(
            "Records: files, folders, tables (suite.csv). And, or, a problem file (.toml).",
            show_default=False,
        ),
    ] = None,
    example: Example = None,
    output: Output = "rockjax-fragility",
) -> None:
    """A fragility curve: the probability that a suite of records overturns the structure, over their
    intensity.

    Every record is scaled to all levels, and the least intensity that overturns is found for each
    (incremental dynamic analysis); a lognormal curve is fitted, with confidence intervals. Prints median,
    dispersion and sensitivities of the median; writes OUTPUT.nc (the curve, and the analysis as its group),
    OUTPUT-fragility.png and OUTPUT-ida.png. Ctrl-C keeps nothing; it takes a minute the first time, then
    less.

    \b
    Examples:
      rockjax fragility --synthetic 20 --seed 1
      rockjax fragility suite/ --tan-alpha 0.2 --R 2 --measure PGV \\
        --sensitivities alpha,gamma -o podium
      rockjax fragility suite/ --eta 0 --measure Sa --measure-period 1 \\
        --intensity 0.5 12 --method stripes
      rockjax fragility --example fragility --levels 40
    """
    prepare(report)
    import numpy as np

    import rockjax as rj
    from rockjax._motions.convert import distinct
    from rockjax._structures import g_tan_alpha

    problems = [path for path in inputs or [] if path.suffix.lower() == ".toml"]
    paths = [path for path in inputs or [] if path not in problems]
    if len(problems) > 1:
        raise ValueError(f"{problems[1]}: is a second problem file; give one")
    to = outputs(output, "rockjax-fragility").check(("fragility", "ida"))
    problem = problem_file(problems[0] if problems else None, example)
    given = Given("fragility", problem, structure, suite, levels, statistics, accuracy)
    podium = given.podium(structure)
    suite, levels, statistics = given.settings(suite), given.settings(levels), given.settings(statistics)
    found = _suite(given, suite, statistics.seed, paths)
    options = given.options(accuracy)
    if not 0 < statistics.confidence < 1:
        raise ValueError(f"--confidence: must be in (0, 1), got {statistics.confidence:g}")
    measure = _measure(levels, found)
    if levels.intensity is None:
        highest = (
            HIGHEST
            * float(g_tan_alpha(podium.alpha, podium.g))
            * float(np.median(measure.values / np.array([m.pga for m in found])))
        )
        low, high = highest / levels.levels, highest
    else:
        low, high = levels.intensity
        if not 0 < low <= high:
            raise ValueError(f"--intensity: must have 0 < lowest <= highest, got {low:g} and {high:g}")
    x = np.linspace(low, high, levels.levels)
    report.note(
        f"{len(found)} records of up to "
        f"{max(map(len, found))} samples × {x.size} levels, and their boundaries"
    )
    with report.progress(None, "scenes") as bar:  # how many there will be shows only on the way
        analysis = rj.incremental_dynamic_analysis(
            podium,
            found,
            x,
            measure=measure,
            names=distinct(found.names),
            sensitivities=names(statistics.sensitivities),
            options=options,
            progress=bar,
        )
    _finish(report, to, analysis, statistics)


def _finish(report: Report, to: Outputs, analysis: xarray.Dataset, statistics: Statistics) -> None:
    import numpy as np

    from rockjax._text.tables import units

    name, of = analysis.attrs["measure"], units(analysis["intensity"].attrs["units"])
    in_units = f" {of}" if of else ""
    low, high = (float(analysis["intensity"][k]) for k in (0, -1))
    count, reached = analysis.sizes["record"], int(analysis["capacity"].notnull().sum())
    failed = int((analysis["result"] > 2).sum())
    report.say(
        f"{count} records at "
        f"{analysis.sizes['intensity']} levels of {name} from {low:.3g} to {high:.3g}{in_units}: "
        f"{analysis.attrs['scenes']} scenes, {reached} of the records overturn"
    )
    report.facts |= {
        "records": count,
        "overturning_records": reached,
        "scenes": analysis.attrs["scenes"],
        "measure": name,
    }
    curve = _curve(report, analysis, statistics)
    if curve is None:
        # The analysis has cost something, and says where to go on.
        report.write(to.data(), analysis)
        report.draw(to.picture("ida"), "incremental_dynamic_analysis", analysis)
        return
    report.write(to.data(), curve, {"analysis": analysis})
    report.draw(to.picture("fragility"), "fragility", curve)
    report.draw(to.picture("ida"), "incremental_dynamic_analysis", analysis)
    median, dispersion = float(curve["median_capacity"]), float(curve["dispersion"])
    of_median = of_dispersion = ""
    report.facts |= {"units": of or "1", "median": median, "dispersion": dispersion}
    if "interval" in curve:
        (a, b), (c, d) = np.asarray(curve["interval"].transpose("quantity", "bound"))
        share = f", {statistics.confidence:.0%} interval"
        of_median, of_dispersion = f"{share} {a:.4g} to {b:.4g}", f"{share} {c:.3f} to {d:.3f}"
        report.facts |= {
            "median_interval": [a, b],
            "dispersion_interval": [c, d],
            "confidence": statistics.confidence,
        }
    report.say(f"median overturning {name}: {median:.4g}{in_units}{of_median}")
    report.say(f"dispersion: {dispersion:.3f}{of_dispersion}")
    if "median_sensitivity" in curve:
        prices = dict(
            zip(curve["parameter"].values.tolist(), curve["median_sensitivity"].values.tolist(), strict=True)
        )
        for parameter, value in prices.items():
            report.say(f"d ln(median)/d ln {parameter}: {value:.4g}")
        report.facts["median_sensitivity"] = prices
    if failed:
        report.error(f"{failed} scenes ended without an answer")


def _curve(report: Report, analysis: xarray.Dataset, statistics: Statistics) -> xarray.Dataset | None:
    """The curve with its intervals; without them, or nothing, where the records do not say more."""
    import rockjax as rj

    method = statistics.values()["method"]
    try:
        return rj.fragility(analysis, method=method, confidence=statistics.confidence)
    except ValueError as error:
        try:
            curve = rj.fragility(analysis, method=method, confidence=None)
        except ValueError:
            report.error(f"no curve: {error}")
            return None
        report.error(str(error))
        return curve


def _suite(given: Given, suite: Suite, seed: int, paths: list[Path]) -> Motions:
    """The records that are meant: files, synthetic ones, or a set of the problem file."""
    from rockjax._motions.synthetic import synthetic_motions

    sets = given.reader.sets(given.table.get("motions", {}))
    if paths and suite.synthetic is not None:
        raise ValueError("--synthetic: give files or synthetic motions, not both")
    if suite.synthetic is not None:
        return synthetic_motions(suite.synthetic, seed=seed)
    if paths:
        found = read(paths, suite.values()["units"], suite.dt, suite.component, suite.pattern)
        return found.paired() if suite.paired else found
    if not sets:
        raise ValueError(
            "needs records: files, folders or tables, --synthetic N, or a problem file with [motions]"
        )
    for name in ("units", "dt", "component", "pattern", "paired"):
        if name in suite.given:
            raise ValueError(f"{flag(name)}: is for files that are named here, not in the problem file")
    name = suite.motions
    if name is None and len(sets) > 1:
        given.reader.fail(
            "fragility",
            f"motions is missing: which of {', '.join(sets)}? ([fragility] motions, or --motions)",
        )
    name = next(iter(sets)) if name is None else name
    return given.reader.recorded_set(
        given.reader.set_named(name, "fragility.motions", sets), f"motions.{name}"
    )


def _measure(levels: Levels, found: Motions) -> rj.Measure:
    import numpy as np

    import rockjax as rj
    from rockjax._motions.intensity import measured_as

    name = levels.values()["measure"]
    if name != "Sa" and levels.measure_period is not None:
        raise ValueError(f"--measure-period: has no meaning for {name}; it is of Sa")
    if name == "Sa" and levels.measure_period is None:
        raise ValueError("--measure Sa: needs --measure-period, such as --measure-period 1")
    if name == "scale":
        return rj.Measure(name, np.ones(len(found)), "1")
    label = f"Sa({levels.measure_period:g} s)" if name == "Sa" else name
    values = np.array([measured_as(motion, label) for motion in found])
    return rj.Measure(label, values, "m s-1" if name == "PGV" else "m s-2")
