"""Kinds of checks of fragility, annual frequency and probabilities of overturning.

A scene is the structure under one motion.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rockjax._boundaries.margin import DEFAULT_WIDTH, ROUNDING_ALLOWANCE
from rockjax._lognormal import Lognormal
from rockjax._problem import models
from rockjax._problem.reading import Reader
from rockjax._problem.risk import check_structure, fragility_of
from rockjax._report.cells import number_cell, slug
from rockjax._report.entry import CheckKeys, Entry
from rockjax._report.problem import RESTITUTION, MotionSet, Problem
from rockjax._report.scales import just_below, overturning_slopes
from rockjax._report.scenes import Scenes
from rockjax._report.store import fingerprint
from rockjax._report.tables import Column, Quantity, Table, Text, TextCell
from rockjax._report.units import kind_of_unit
from rockjax._results import did_not_finish
from rockjax._risk.annual import MIN_EXTRAPOLATED, annual_frequency
from rockjax._risk.gaussian import Envelope, GaussianMotion
from rockjax._risk.hazard import Hazard
from rockjax._risk.rocking import failure_probability
from rockjax._structures import Podium
from rockjax._units import unit_of_measure

from .base import Kind, Values, one_value, unanswered_scenes
from .searches import UNFINISHED

if TYPE_CHECKING:
    import xarray

INTERVAL = 1.96  # standard errors on each side of a 95 % interval of a normal distribution
UNTESTED = "assumptions are not tested"


@dataclasses.dataclass(frozen=True)
class FragilityKind(Kind):
    """A check of the median overturning intensity of a set: the median of the least intensities at which the
    motions overturn the columns. The settings are in the table `[fragility]` of the problem file.

    `other_curves`: end of the message that this table is missing, with other sources of a fragility curve
    """

    other_curves: str = ""
    no_laws: str = "each law would need a fragility analysis"

    def read(self, keys: CheckKeys, reader: Reader, file: models.Problem, podium: Podium) -> dict[str, Any]:
        arguments = super().read(keys, reader, file, podium)
        return arguments | {"measure": measure_of_file(file)}

    def quantity_of(self, keys: CheckKeys, file: models.Problem) -> str:
        del keys
        return kind_of_unit(unit_of_measure(measure_of_file(file)[0]))

    def missing(self, entry: Entry, problem: Problem) -> str:
        reasons = [super().missing(entry, problem)]
        if entry.motions and "fragility" not in problem.given:
            reasons.append(f"The file has no table [fragility]{self.other_curves}.")
        return " ".join(filter(None, reasons))

    def curve(self, entry: Entry, scenes: Scenes) -> Any:
        """Return the result of `rockjax.fragility` for the set, with the rotations and the boundaries of the
        incremental dynamic analysis, and with three more variables along `record`. `scale` is the least
        factor on each motion that overturns the columns. `largest_scale` is the largest searched factor below
        the first scene that did not finish. `is_open` is True if scenes below the capacity did not finish."""
        problem, motions = scenes.problem, scenes.motion_set(str(entry.motions))
        measure = entry.arguments["measure"]
        settings = problem.fragility.model_dump(), measure
        names = problem.variables
        inputs_hash = fingerprint(problem.podium, motions.identities, problem.options, settings, names)
        return scenes.store.get(
            f"fragility.{motions.name}.{_label(measure)}",
            inputs_hash,
            lambda: _fragility(scenes, motions.name, measure),
        )

    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, variation: str = "") -> Values:
        del law, variation
        curve = self.curve(entry, scenes)
        interval: tuple[float, ...] = ()
        if "interval" in curve:
            bounds = curve["interval"].sel(quantity="median_capacity").values
            if np.isfinite(bounds).all():
                interval = (*map(float, bounds), scenes.problem.fragility.confidence)
        value, unanswered = float(curve["median_capacity"]), _unfinished_records(curve)
        return one_value(value, unanswered=unanswered, interval=interval)

    def known_slopes(self, entry: Entry, scenes: Scenes) -> dict[str, float]:
        curve = self.curve(entry, scenes)
        if "median_sensitivity" not in curve:
            return {}
        slopes = curve["median_sensitivity"]
        known = zip(slopes["parameter"].values, slopes.values, strict=True)
        return {_input(str(y)): -float(z) for y, z in known}

    def tested_scenes(self, entry: Entry, scenes: Scenes) -> xarray.Dataset | None:
        curve = self.curve(entry, scenes)
        factors = just_below(curve["scale"].values, curve["largest_scale"].values)
        name, label = str(entry.motions), _label(entry.arguments["measure"])
        return scenes.peaks_with_factors(f"boundary.{name}.fragility {label}", name, factors)

    def tables(self, entry: Entry, values: Values, scenes: Scenes) -> list[Table]:
        del values
        curve = self.curve(entry, scenes)
        median_kind = kind_of_unit(curve["at"].attrs["units"])
        names = {"median_capacity": (f"Median overturning {curve.attrs['measure']}", median_kind)}
        rows = []
        for name, (title, kind) in (names | {"dispersion": ("Dispersion", "number")}).items():
            rows.append((title, float(curve[name]), kind))
            confidence, bounds = scenes.problem.fragility.confidence, curve["interval"].sel(quantity=name)
            for bound in ("lower", "upper"):
                share = Quantity(confidence, "ratio", is_input=True)
                label = f"{title}, ", share, f" interval, {bound}"
                rows.append((label, float(bounds.sel(bound=bound)), kind))
        name = f"fragility-{slug(str(entry.motions))}-{slug(_label(entry.arguments['measure']))}"
        return [_table(name, f"Fragility of the set {entry.motions}", rows)]


@dataclasses.dataclass(frozen=True)
class AnnualKind(FragilityKind):
    """A check of the annual frequency of overturning, from a hazard curve and a fragility curve. If the table
    `[risk]` gives no fragility curve, the curve is computed from the set of motions."""

    other_curves: str = ", no risk.fragility, and no risk.median and risk.dispersion"

    def read(self, keys: CheckKeys, reader: Reader, file: models.Problem, podium: Podium) -> dict[str, Any]:
        arguments = Kind.read(self, keys, reader, file, podium)
        name = arguments.pop("hazard", None) or file.risk.hazard
        with reader.errors_at("risk"):
            curve = fragility_of(file.risk, lambda name: reader.folder / name)
            if curve is not None:
                check_structure(curve, podium, file.risk.fragility or "the curve")
                arguments["curve"] = curve
        if name is None:
            return arguments
        hazard = Hazard.from_file(reader.folder / name, site=file.risk.site).in_si()
        return arguments | {"hazard": hazard, "measure": measure_of_file(file)}

    def quantity_of(self, keys: CheckKeys, file: models.Problem) -> str:
        del keys, file
        return self.quantity

    def uses_motions(self, arguments: Mapping[str, Any]) -> bool:
        return "curve" not in arguments

    def missing(self, entry: Entry, problem: Problem) -> str:
        reasons = [super().missing(entry, problem)]
        if "hazard" not in entry.arguments:
            reasons.append("The file has no hazard curve; give risk.hazard, or the key hazard of the check.")
        return " ".join(filter(None, reasons))

    def curve(self, entry: Entry, scenes: Scenes) -> Any:
        given = entry.arguments.get("curve")
        return super().curve(entry, scenes) if given is None else given

    def _annual(self, entry: Entry, scenes: Scenes) -> xarray.Dataset:
        """Return a dataset of the annual frequency.

        It has `frequency` [1/year], `return_period` [years], `probability` within the years of `[risk]` [–],
        the share `extrapolated` that comes from beyond the hazard curve [–], and `sensitivity` along
        `parameter`, which has the derivatives in `AnnualFrequency.sensitivities` [–].
        """
        import xarray

        curve, hazard = self.curve(entry, scenes), entry.arguments["hazard"]
        years = scenes.problem.risk.years
        inputs_hash = fingerprint(hazard, _numbers_of(curve), years)

        def solve() -> xarray.Dataset:
            annual = annual_frequency(curve, hazard)
            names = ("frequency", "return_period", "extrapolated")
            data: dict[str, Any] = {name: float(getattr(annual, name)) for name in names}
            data["probability"] = float(annual.probability(years))
            data["sensitivity"] = "parameter", np.array(list(map(float, annual.sensitivities.values())))
            return xarray.Dataset(data, coords={"parameter": np.array(list(annual.sensitivities), str)})

        return scenes.store.get(f"annual.{entry.id}", inputs_hash, solve)

    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, variation: str = "") -> Values:
        del law, variation
        remark = "" if entry.motions else f"curve of [risk], {UNTESTED}"
        unanswered = _unfinished_records(self.curve(entry, scenes)) if entry.motions else ()
        return one_value(
            float(self._annual(entry, scenes)["frequency"]), unanswered=unanswered, remark=remark
        )

    def known_slopes(self, entry: Entry, scenes: Scenes) -> dict[str, float]:
        slopes = self._annual(entry, scenes)["sensitivity"]
        known = zip(slopes["parameter"].values, slopes.values, strict=True)
        return {_input(str(y)): float(z) for y, z in known if y not in ("median", "dispersion")}

    def tested_scenes(self, entry: Entry, scenes: Scenes) -> xarray.Dataset | None:
        return super().tested_scenes(entry, scenes) if entry.motions else None

    def tables(self, entry: Entry, values: Values, scenes: Scenes) -> list[Table]:
        data, years = self._annual(entry, scenes), scenes.problem.risk.years
        rows = [
            ("Annual frequency λ_f", float(data["frequency"]), "rate"),
            ("Return period", float(data["return_period"]), "return period"),
            (
                ("Probability in ", Quantity(years, "return period", is_input=True)),
                float(data["probability"]),
                "ratio",
            ),
            ("Share from beyond the hazard curve", float(data["extrapolated"]), "ratio"),
        ]
        for name, value in zip(data["parameter"].values, data["sensitivity"].values, strict=True):
            symbol = "d ln λ_f/dβ" if name == "dispersion" else f"d ln λ_f/d ln {name}"
            rows.append((symbol, float(value), "number"))
        annual = _table(f"annual-{slug(entry.id)}", f"Annual frequency, check {entry.id}", rows)
        if entry.motions:
            return [*super().tables(entry, values, scenes), annual]
        kind = kind_of_unit(entry.arguments["hazard"].units)
        median, dispersion = _numbers_of(self.curve(entry, scenes))[:2]
        rows = [("Median", median, kind), ("Dispersion", dispersion, "number")]
        return [_table("fragility-given", "Fragility of [risk]", rows), annual]

    def notices(self, entry: Entry, scenes: Scenes) -> Iterator[Text]:
        unused = [name for name in ("motions", "vertical") if getattr(entry.keys, name)]
        if unused and not entry.motions:
            yield f"{entry.id} does not use its keys ({', '.join(unused)}): [risk] gives the fragility curve."
        share = float(self._annual(entry, scenes)["extrapolated"])
        if share > MIN_EXTRAPOLATED:
            text = f" of the annual frequency of {entry.id} comes from beyond the hazard curve."
            yield Quantity(share, "ratio"), text


@dataclasses.dataclass(frozen=True)
class ShareKind(Kind):
    """A check of the share of the motions of a set that overturn the columns. All motions are multiplied by
    the key `intensity`."""

    @property
    def has_variants(self) -> bool:
        return True

    def outputs(self, entry: Entry) -> tuple[str, ...]:
        del entry
        return ("peak_rotation",)

    def _scenes(
        self, entry: Entry, scenes: Scenes, law: str | None = None, variation: str = ""
    ) -> xarray.Dataset:
        return scenes.peaks(str(entry.motions), law, variation, float(entry.arguments.get("intensity", 1.0)))

    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, variation: str = "") -> Values:
        data = self._scenes(entry, scenes, law, variation)
        unanswered, overturned = tuple(unanswered_scenes(data)), data["overturned"].values.astype(bool)
        share = float(np.mean(overturned))
        certain = float(np.mean(overturned & (np.array(unanswered) == "")))
        return one_value(share, share - certain, unanswered=unanswered, error_factor=1.0)

    def tested_scenes(self, entry: Entry, scenes: Scenes) -> xarray.Dataset | None:
        return self._scenes(entry, scenes)

    def tables(self, entry: Entry, values: Values, scenes: Scenes) -> list[Table]:
        del values
        data, names = self._scenes(entry, scenes), scenes.motion_set(str(entry.motions)).names
        outcomes = map(_outcome_cell, data["overturned"].values, unanswered_scenes(data))
        rows = [(TextCell(name), outcome) for name, outcome in zip(names, outcomes, strict=True)]
        factor = float(entry.arguments.get("intensity", 1.0))
        scaled = f"Motions of the set {entry.motions} × ", Quantity(factor, "number", is_input=True)
        caption = *scaled, f", check {entry.id}"
        return [Table(f"share-{slug(entry.id)}", caption, (Column("Motion"), Column("Columns")), tuple(rows))]


def _outcome_cell(is_overturned: bool, unanswered: str) -> TextCell:
    """Return a cell with the outcome of a scene. `unanswered`: its text from `unanswered_scenes`."""
    if unanswered:
        return TextCell(unanswered.replace("_", " "), "unanswered")
    return TextCell("overturned", "overturned") if is_overturned else TextCell("survives", "holds")


@dataclasses.dataclass(frozen=True)
class FailureKind(Kind):
    """A check of the probability that a random motion overturns the columns, estimated by sampling."""

    no_laws: str = "each law would need all samples"

    def read(self, keys: CheckKeys, reader: Reader, file: models.Problem, podium: Podium) -> dict[str, Any]:
        arguments = super().read(keys, reader, file, podium)
        if "motion" in arguments:
            given = arguments["motion"].as_arguments()
            if "envelope" in given:
                given["envelope"] = Envelope(**given["envelope"].as_arguments())
            arguments["motion"] = GaussianMotion(**given)
        # Failure is overturning or, if the option `overturn_ratio` is below 1, a rotation |θ|/α above this
        # ratio.
        ratio = file.options.overturn_ratio
        return arguments | ({"limit": ("rotation", ratio)} if ratio is not None and ratio < 1 else {})

    def missing(self, entry: Entry, problem: Problem) -> str:
        if "motion" not in entry.arguments:
            return "The check has no random motion; give its key motion."
        return super().missing(entry, problem)

    def _data(self, entry: Entry, scenes: Scenes) -> xarray.Dataset:
        """Return a dataset of the estimated probability: `probability`, `standard_error`, `scenes` (number of
        solved scenes), `converged`, and `interval` (the 95 % interval)."""
        import xarray

        settings = {
            name: entry.arguments[name] for name in ("cov", "seed", "limit") if name in entry.arguments
        }
        podium, motion = scenes.problem.podium, entry.arguments["motion"]

        def solve() -> xarray.Dataset:
            scenes.describe(f"samples of {entry.id}")
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # the check reports "not converged"
                result = failure_probability(podium, motion, **settings)
            names = ("probability", "standard_error", "scenes", "converged")
            data: dict[str, Any] = {name: float(getattr(result, name)) for name in names}
            return xarray.Dataset(data | {"interval": ("bound", np.array(result.interval))})

        return scenes.store.get(f"failure.{entry.id}", fingerprint(podium, motion, settings), solve)

    def values(self, entry: Entry, scenes: Scenes, law: str | None = None, variation: str = "") -> Values:
        del law, variation
        data = self._data(entry, scenes)
        unanswered = () if float(data["converged"]) else ("estimate not converged",)
        value, error = float(data["probability"]), float(data["standard_error"])
        low, high = map(float, data["interval"])
        # The interval is not symmetric. The check passes only if value ± the longer side satisfies the limit.
        has_interval = error > 0 and math.isfinite(high)
        factor = max(high - value, value - low) / error if has_interval else INTERVAL
        return one_value(value, error, unanswered=unanswered, remark=UNTESTED, error_factor=factor)

    def scope(self, entry: Entry, problem: Problem) -> str:
        del entry, problem
        return "random motion"

    def tables(self, entry: Entry, values: Values, scenes: Scenes) -> list[Table]:
        del values
        data = self._data(entry, scenes)
        rows = [
            ("Probability of failure", float(data["probability"]), "number"),
            ("Standard error", float(data["standard_error"]), "number"),
            *(
                (f"95 % interval, {y}", float(data["interval"][k]), "number")
                for k, y in enumerate(("lower", "upper"))
            ),
            ("Scenes", float(data["scenes"]), "count"),
        ]
        return [_table(f"failure-{slug(entry.id)}", f"Probability of failure, check {entry.id}", rows)]


def measure_of_file(file: models.Problem) -> tuple[str, float | None]:
    """Return the name and the period [s] of the intensity measure in `[fragility]`. The period is None for a
    measure without one. If the file has no table `[fragility]`, the measure is "scale", the factor on the
    motions."""
    settings = file.fragility
    has_table = "fragility" in file.model_fields_set
    return (settings.measure, settings.measure_period) if has_table else ("scale", None)


def _input(parameter: str) -> str:
    """Return the name of an input in the summary: the key under [structure], or the parameter of
    [fragility]."""
    return parameter.removeprefix("structure.")


def _label(measure: tuple[str, float | None]) -> str:
    """Return the name of an intensity measure with its period, without dots."""
    name, period = measure
    return name if period is None else f"{name}-{period:g}".replace(".", "-")


def _fragility(scenes: Scenes, name: str, named_measure: tuple[str, float | None]) -> xarray.Dataset:
    """Compute the result of `FragilityKind.curve`.

    - `scenes`: the scenes of the problem; `name`: name of the set of motions
    - `named_measure`: name and period [s] of the intensity measure
    """
    from rockjax._motions.motion import Motions
    from rockjax._studies.curve import fragility
    from rockjax._studies.fragility import incremental_dynamic_analysis, levels_of, measure_of

    problem, motions, settings = scenes.problem, scenes.motion_set(name), scenes.problem.fragility
    scenes.describe(f"fragility of {name}")
    suite = Motions(motions.members)  # pyright: ignore[reportArgumentType]
    measure = measure_of(*named_measure, suite)
    levels = levels_of(problem.podium, suite, measure, settings.intensity, settings.levels)
    analysis = incremental_dynamic_analysis(
        problem.podium,
        suite,
        levels,
        measure=measure,
        names=motions.names,
        sensitivities=settings.sensitivities,
        options=problem.options,
        progress=scenes,
    )
    if settings.method == "capacities":
        analysis = _with_sensitivities(analysis, problem, motions)
    curve = fragility(analysis, method=settings.method, confidence=settings.confidence)
    return _with_search(curve, analysis)


def _with_sensitivities(analysis: xarray.Dataset, problem: Problem, motions: MotionSet) -> xarray.Dataset:
    """Return an incremental dynamic analysis with the derivatives of the capacities with respect to the
    inputs of the structure, beside those with respect to the parameters in `[fragility]`."""
    names, factors = problem.variables, (analysis["capacity"] / analysis["measure"]).values
    slopes = np.full((len(names), factors.size), np.nan)
    for k in np.flatnonzero(np.isfinite(factors)):
        excitation, factor = motions.excitations[k], float(factors[k])
        found = overturning_slopes(problem, excitation, factor, problem.options)
        slopes[:, k] = found[: len(names)] / factor
    labels = [name if name == RESTITUTION else f"structure.{name}" for name in names]
    if "sensitivity" in analysis:
        labels = [*analysis["parameter"].values, *labels]
        slopes = np.concatenate([analysis["sensitivity"].values, slopes])
        analysis = analysis.drop_dims("parameter")
    analysis = analysis.assign(sensitivity=(("parameter", "record"), slopes))
    return analysis.assign_coords(parameter=labels)


def _with_search(curve: xarray.Dataset, analysis: xarray.Dataset) -> xarray.Dataset:
    """Return a fragility curve with the variables that `FragilityKind.curve` adds.

    - `curve`, `analysis`: the curve, and the incremental dynamic analysis to which it was fitted
    """
    levels, capacity = analysis["intensity"].values, analysis["capacity"].values
    is_finished = ~did_not_finish(analysis["result"].values)
    count = np.logical_and.accumulate(is_finished, axis=1).sum(axis=1)
    if curve.attrs["method_of_fit"] == "stripes":
        # The fit uses the outcomes at all levels, but no capacities.
        is_open = ~is_finished.all(axis=1)
    else:
        below = levels < np.where(np.isnan(capacity), np.inf, capacity)[:, None]
        allowed = ROUNDING_ALLOWANCE * DEFAULT_WIDTH * levels[-1]
        is_open = np.any(~is_finished & below, axis=1) | (analysis["certain_width"].values > allowed)
    ends = {"scale": capacity, "largest_scale": np.append(0.0, levels)[count]}
    ends = {name: y / analysis["measure"].values for name, y in ends.items()} | {"is_open": is_open}
    drawn = {name: analysis[name] for name in ("peak_rotation", "overturned", "result", "boundaries")}
    return curve.assign(drawn | {name: ("record", y) for name, y in ends.items()})


def _unfinished_records(curve: Any) -> tuple[str, ...]:
    """Return for each motion of a fragility curve the reason why its capacity is not certain, or ""."""
    return tuple(np.where(curve["is_open"].values.astype(bool), UNFINISHED, "").tolist())


def _numbers_of(curve: Any) -> list[float]:
    """Return the numbers of a fragility curve that determine the annual frequency and its derivatives. The
    first is the median, and the second is the dispersion."""
    if isinstance(curve, Lognormal):
        return list(map(float, curve))
    names = ("median_capacity", "dispersion", "no_damage_limit", "min_intensity", "max_intensity")
    numbers = [float(curve[name]) for name in names if name in curve]
    return numbers + [
        y for name in curve.data_vars if "sensitivity" in str(name) for y in curve[name].values.tolist()
    ]


def _table(name: str, caption: str, rows: Sequence[tuple[Text, float, str]]) -> Table:
    cells = tuple((TextCell(text), number_cell(value, kind)) for text, value, kind in rows)
    return Table(name, caption, (Column("Quantity"), Column("Value")), cells)
