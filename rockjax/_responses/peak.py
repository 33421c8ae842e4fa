"""Peaks of a scene (one podium under one ground motion): the class `Peak`, its text and HTML, and its
variables in datasets.

An *answer* is a value of an output. One requested output can have several answers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from rockjax import _results as results
from rockjax._checks import as_array, concrete
from rockjax._files import CONVENTIONS
from rockjax._options import OUTPUTS, Options
from rockjax._outputs.base import JOINT_NAMES, JOINTS, AbstractOutput, Variable
from rockjax._outputs.registry import VARIABLES, variables_of
from rockjax._outputs.values import by_name
from rockjax._results import RESULTS, Stats
from rockjax._structures import Podium
from rockjax._text import tables
from rockjax._tree import Module

from .datasets import describe_versions
from .estimate import Errors
from .floor_answers import floor_rows, floor_variables
from .sensitivities import Sensitivities, slope_name

if TYPE_CHECKING:
    import xarray

# Peaks of a scene that overturned cover only the time until overturning.
UNTIL_OVERTURNING = "until overturning"

OPEN_JOINT_NOTE = (
    "a joint would open, or the beam would lift off at an impact: the model does not hold from then on"
)
MEAN_COLUMN_NOTE = "closed in the mean column; give an elevation for forces of single columns"

# Answers of every scene, independent of the requested outputs.
ALWAYS = {
    name: (Variable(name, unit, description, until_overturning=False), None)
    for name, unit, description in (
        ("exceeded_alpha", "1", "rotation reached α"),
        ("overturned", "1", "rotation reached overturn_ratio·α"),
        ("overturn_time", "s", "time of overturning"),
        ("uplifted", "1", "columns left full contact"),
        ("uplift_time", "s", "time of the first uplift"),
        ("impacts", "1", "number of impacts until rest, overturning or t_end, NaN where unknown"),
        ("smallest_impact_speed", "rad s-1", "least |θ̇| at an impact before the peak rotation"),
    )
}


def all_variables(outputs: Sequence[str | AbstractOutput] = ()) -> dict[str, tuple[Variable, str | None]]:
    """Return all answers that a scene can have, as name → (`Variable`, output). To get an answer, request the
    named output; for answers of every scene, `output` is None.

    - `outputs`: requested outputs; user-defined outputs add answers
    """
    return {**VARIABLES, **ALWAYS, **variables_of(outputs)}


class AbstractPeak(Module):
    """Peaks and result of a scene. (L1) and (L3) are equations of docs/floors.md.

    Peaks of a scene that overturned cover only the time until overturning. Answers that were not requested
    are NaN unless stated otherwise.

    - `peak_rotation`: max|θ|/α, at most `overturn_ratio` [–]; `peak_rotation_time`: time at which this
      rotation is first reached [s]
    - `exceeded_alpha`: True if |θ| reached α; `overturned`: True if |θ| reached `overturn_ratio`·α, at
      `overturn_time` [s] (NaN if not)
    - `uplifted`: True if the columns left full contact, first at `uplift_time` [s] (NaN if not)
    - `impacts`: number of impacts until rest, overturning or `t_end`; NaN if the scene did not finish, or may
      have ended before this number was final. For the exact number, request `"impacts"` or compute a history.
      Otherwise, under a rigid superstructure or none, the last bounces before rest are not simulated, and a
      formula gives their number to within one or two
    - `peak_deformation`: peak deformation of the superstructure, max|u_t − u_b| with the displacements u_t of
      its top mass and u_b of the beam [m]; 0 if there is no elastic superstructure. Several modes are along
      the last axis
    - `peak_shear`: largest shear at the base of the superstructure divided by its weight, max|V_s|/(m_t g)
      [–]; 0 if there is no superstructure. An impact exerts an impulse on the residual mass, the mass that
      belongs to no mode; `peak_shear` and `peak_floor_acceleration` leave out this impulse
    - `peak_drift`: largest drift of each story of a building [m]; `peak_floor_acceleration`: largest absolute
      horizontal acceleration of each floor [m/s²]. Both have a last axis of stories from the bottom, and are
      None if there are no stories
    - `peak_deck_acceleration`: largest absolute horizontal acceleration |a_b| of the deck (the beam), (L1)
      [m/s²]; `peak_velocity_jump`: largest jump |Δv_b| of the deck's horizontal velocity at an impact, (L3)
      [m/s]. No peak acceleration includes these jumps. Both answers are None unless requested
    - `peak_friction`: largest friction demand |T|/N of the joints [–], with the horizontal force T and the
      axial force N of a joint; inf if a joint would open
    - `least_axial_force`, `peak_axial_force`: least and largest N/(m_c g) of the joints [–], compression
      positive, with the weight m_c g of a column
    - `peak_impact_friction`: largest |J_T|/J_N of the joints at an impact [–], with the horizontal impulse
      J_T and the axial impulse J_N; `least_impulse_share`: least J_N of a column, divided by the mean J_N of
      all columns [–]
    - `peak_foundation_shear`: largest horizontal force on the foundation, divided by the total weight [–].
      The five answers of joints before this one are those of the worst column, with the bottom and the top
      joint along the last axis. All six answers are None unless requested
    - `margin`: overturning margin [–], NaN unless requested: 1 if the columns never lift, 0 on the
      overturning boundary, and negative if the columns overturn; the faster they fall, the lower it is
    - `impacts_before_peak`: number of impacts before the peak rotation, NaN unless requested. The derivatives
      of the peak rotation hold as long as this number stays the same
    - `smallest_impact_speed`: least |θ̇⁻| of the impacts before the peak rotation [rad/s]; inf if there are
      none. Derivatives of the motion after an impact grow like 1/|θ̇⁻|
    - `values`: answers of the outputs by name. Each of them is also an attribute: `peak.peak_shear` is
      `peak.values["peak_shear"]`
    - `on_floors`: answers of light secondary systems on the floors, [`rockjax.ContentsAnswer`][] and
      [`rockjax.OscillatorAnswer`][], in the order in which they were given
    - `errors`: estimated errors, an [`rockjax.Errors`][]; None unless requested
    - `result`: how the scene ended, a [`rockjax.RESULTS`][]
    - `stats`: numbers of steps, and the end of the scene, a [`rockjax.Stats`][]
    - `has_elevation`: True if answers of the joints are those of the worst column; False if the podium has no
      elevation, so that they are those of the mean column, or if no such answer was requested
    """

    values: dict[str, Any]
    exceeded_alpha: Bool[Array, "*batch"]
    overturned: Bool[Array, "*batch"]
    overturn_time: Float[Array, "*batch"]
    uplifted: Bool[Array, "*batch"]
    uplift_time: Float[Array, "*batch"]
    impacts: Float[Array, "*batch"]
    smallest_impact_speed: Float[Array, "*batch"]
    errors: Errors | None
    result: RESULTS
    stats: Stats
    user_outputs: tuple[AbstractOutput, ...] = eqx.field(static=True, default=(), kw_only=True)
    has_elevation: bool = eqx.field(static=True, default=False, kw_only=True)
    on_floors: tuple[Any, ...] = eqx.field(default=(), kw_only=True)

    def __getattr__(self, name: str) -> Any:
        return by_name(self, name)

    @property
    def joints_closed(self) -> Bool[Array, "*batch"]:
        """True if no joint would open and no impact would lift the beam off a column, according to the
        answers `least_axial_force` and `least_impulse_share`. Answers that were not requested are ignored.
        Without `least_axial_force`, `peak_friction` must be finite; a joint with N = 0 and T ≠ 0 then counts
        as open. Without an elevation, forces are those of the mean column, so a single column may open
        although this is True. False if the scene did not finish, such as one with the result `weightless`."""
        is_closed = ~results.did_not_finish(jnp.asarray(results.code_of(self.result)))
        for name in ("least_axial_force", "least_impulse_share"):
            values = self.values.get(name)
            if values is not None:
                is_closed &= jnp.all(values >= 0, axis=-1)
        demand = self.values.get("peak_friction")
        if demand is None or self.values.get("least_axial_force") is not None:
            return is_closed
        return is_closed & jnp.all(jnp.isfinite(demand), axis=-1)

    def __repr__(self):
        return _text(self)

    def _repr_html_(self):
        return _html(self)


class Peak(AbstractPeak):
    __doc__ = (
        "Peak response of one scene, or of a batch of any shape.\n"
        + (AbstractPeak.__doc__ or "")
        + """
    - `sensitivities`: derivatives of the peaks, a [`rockjax.Sensitivities`][]; None unless requested of
      `peak_responses`
    """
    )

    sensitivities: Sensitivities | None = None

    def dataset(self) -> xarray.Dataset:
        """Return the answers as a dataset with `units` and `long_name`. A batch has the dims
        `scene_0`, `scene_1`, …"""
        import xarray

        dims = tuple(f"scene_{k}" for k in range(np.ndim(self.stats.steps)))
        outputs = (*OUTPUTS, *self.user_outputs)
        data = xarray.Dataset(data_variables(self, outputs, dims), coords=parameter_axis(self.sensitivities))
        data.attrs = {
            "title": "Peak responses",
            "kind": "peaks",
            **describe_versions(),
            "Conventions": CONVENTIONS,
        }
        return data


def peak_fields(
    podium: Podium, floats, integers, options: Options, *, throw: bool = False, history: bool = False
) -> dict[str, Any]:
    """Return fields of the `AbstractPeak` of a scene or a batch by name: all except `errors` and `on_floors`.

    - `podium`: structure, or a batch of structures
    - `floats`, `integers`: outputs of the scenes by name
    - `options`: options of the scenes
    - `throw`: whether to raise `RuntimeError` for a scene that did not finish
    - `history`: whether the scenes have a history; such scenes continue even if all outputs are final
    """
    code = integers["code"]
    if throw:
        raise_if_unfinished(code)
    stats = Stats(steps=integers["steps"], rejected=integers["rejected"], end_time=floats["end_time"])
    values = {name: floats[name] for name in all_variables(options.outputs) if name in floats}
    always = {name: values.pop(name) for name in ("overturn_time", "uplift_time", "smallest_impact_speed")}
    return {
        "values": values,
        **always,
        **{name: integers[name] for name in ("exceeded_alpha", "overturned", "uplifted")},
        "impacts": _impacts(floats, integers, options, history),
        "result": results.result_of(code),
        "stats": stats,
        "user_outputs": tuple(y for y in options.outputs if not isinstance(y, str)),
        "has_elevation": options.of_joints and podium.elevation is not None,
    }


def _impacts(floats, integers, options: Options, history: bool):
    """Return the number of impacts, or NaN where it may not be final. Arguments as for `peak_fields`.

    A scene with the result `settled` ended when all outputs were final. Its number of impacts is final in
    three cases: the number was requested; the scene has a history; or the columns never lifted. In the third
    case the number is zero: the scene ends only when no uplift can follow.
    """
    answers = integers["code"], integers["impacts"], integers["uplifted"]
    is_traced, is_jax = any(isinstance(y, Tracer) for y in answers), isinstance(answers[1], jax.Array)
    # NumPy saves time here, because outside jit every jnp operation compiles separately.
    code, count, uplifted = answers if is_traced else map(np.asarray, answers)
    is_final = (code == results.OVERTURNED) | (code == results.END_OF_TIME)
    if history or "impacts" in options.outputs:
        is_final |= code == results.SETTLED
    else:
        is_final |= (code == results.SETTLED) & ~uplifted
    numpy = jnp if is_traced else np
    impacts = numpy.where(is_final, count.astype(floats["end_time"].dtype), np.nan)
    return as_array(impacts) if is_jax and not is_traced else impacts


def raise_if_unfinished(code: Array) -> None:
    """Raise `RuntimeError` about the first scene that did not finish. Traced codes are not checked."""
    codes = concrete(code)
    if codes is None:
        return
    failed = np.argwhere(results.did_not_finish(codes))
    if len(failed):
        first = tuple(int(k) for k in failed[0])
        name = results.NAMES[int(codes[first])]
        where = f" at index {first} ({len(failed)} of {codes.size} scenes)" if codes.ndim else ""
        message = results.RESULTS[getattr(results.RESULTS, name)]
        raise RuntimeError(
            f"rockjax: scene ended '{name}'{where}. {message} (Options(throw=False) returns the result "
            "instead)"
        )


def peak_variables(
    peaks: AbstractPeak, outputs: Sequence[str | AbstractOutput]
) -> Iterator[tuple[str, np.ndarray, dict[str, Any]]]:
    """Yield (name, values, attributes) of each dataset variable of peaks: the requested answers with their
    estimated errors, the answers of every scene, `undecided`, `result` and `steps`.

    - `peaks`, `outputs`: answers of a scene or a batch, and its requested outputs
    """
    requested = {y if isinstance(y, str) else y.name for y in outputs}
    variables = all_variables(outputs)
    for name, (variable, output) in variables.items():
        values = getattr(peaks, name)
        if values is not None and (output is None or output in requested):
            attrs = {
                "units": variable.unit,
                "long_name": variable.description,
                **_overturning_attrs(variable),
            }
            yield name, np.asarray(values), attrs
    if peaks.errors is not None:
        for name, (variable, output) in variables.items():
            error = peaks.errors.values.get(name)
            if error is not None and output in requested:
                error = np.asarray(error)
                yield (
                    f"{name}_error",
                    error,
                    {"units": variable.unit, "long_name": f"estimated error of the {variable.description}"},
                )
        attrs = {
            "units": "1",
            "long_name": "ten times the estimated error could change whether the columns overturn, or the "
            "rocking is chaotic, or a solution did not finish",
        }
        yield "undecided", np.asarray(peaks.errors.undecided), attrs
    code = np.asarray(results.code_of(peaks.result), np.int8)
    yield "result", code, {"units": "1", "long_name": "result of the scene", **results.FLAGS}
    yield (
        "steps",
        np.asarray(peaks.stats.steps + peaks.stats.rejected),
        {"units": "1", "long_name": "trial steps"},
    )


def _overturning_attrs(variable: Variable) -> dict[str, str]:
    """Return the attributes that state that a peak covers only the time until overturning; empty for other
    answers."""
    if not variable.until_overturning:
        return {}
    return {
        "ancillary_variables": "overturned",
        "comment": f"for scenes that overturned, the value {UNTIL_OVERTURNING}",
    }


def data_variables(
    peaks: Peak, outputs: Sequence[str | AbstractOutput], dims: tuple[str, ...]
) -> dict[str, Any]:
    """Return the variables of a dataset: the peaks, the answers of secondary systems on floors and, if there
    are any, the sensitivities of the peaks along the dim `parameter`.

    - `peaks`, `outputs`: answers of a scene or a batch, and its requested outputs
    - `dims`: dims of the scenes; empty if the caller adds these dims
    """
    scenes = np.ndim(peaks.stats.steps)
    data: dict[str, Any] = {
        name: ((*dims, *own_axis(name, values.ndim - scenes, outputs)), values, attrs)
        for name, values, attrs in peak_variables(peaks, outputs)
    }
    slopes = {} if peaks.sensitivities is None else peaks.sensitivities.values
    for name, (variable, _) in variables_of(outputs).items():
        if name in slopes:
            attrs = {
                "units": variable.unit,
                "long_name": f"derivative of the {variable.description} with respect to parameter y, times y",
            }
            values = np.asarray(slopes[name])
            own = own_axis(name, values.ndim - scenes - 1, outputs)
            data[slope_name(name)] = (*dims, *own, "parameter"), values, attrs
    return data | floor_variables(peaks.on_floors, dims)


def own_axis(name: str, dimensions: int, outputs: Sequence[str | AbstractOutput] = ()) -> tuple[str, ...]:
    """Return, in a tuple, the dim that an answer (or its error) has in addition to the dims of the scenes:
    modes, stories, joints, or `<answer>_component` for a user-defined output without `axis`. The tuple is
    empty for a scalar answer.

    - `name`: name of the variable
    - `dimensions`: number of dimensions without those of scenes and parameters, 0 or 1
    - `outputs`: requested outputs
    """
    if not dimensions:
        return ()
    answer = name.removesuffix("_error")
    return (all_variables(outputs)[answer][0].axis or f"{answer}_component",)


def parameter_axis(sensitivities: Sensitivities | None) -> dict[str, Any]:
    """Return the coordinate `parameter` of sensitivities, or an empty dict if there are no sensitivities."""
    return {} if sensitivities is None else {"parameter": list(sensitivities.parameters)}


def _text(peak: AbstractPeak) -> str:
    """Return a table of one scene as text; for a batch, only its size and the number of overturned scenes."""
    headline, rows = _summary(peak)
    return "\n".join(
        [headline, *(f"  {label:<16} {value}" if value else f"  {label}" for label, value in rows)]
    )


def _html(peak: AbstractPeak) -> str:
    """Return the peaks as an HTML table."""
    headline, rows = _summary(peak)
    return f"<p><b>{escape(headline)}</b></p>" + (tables.html(rows) if rows else "")


def _summary(peak: AbstractPeak) -> tuple[str, list[tuple[str, str]]]:
    """Return a headline, and rows (label, value)."""
    class_name = type(peak).__name__
    codes = None if concrete(peak.peak_rotation) is None else concrete(results.code_of(peak.result))
    if codes is None:
        return f"{class_name}(traced)", []
    if codes.ndim:
        overturned = int(np.sum(np.asarray(peak.overturned)))
        until = f": their peaks are {UNTIL_OVERTURNING}" if overturned else ""
        return f"{class_name}({codes.size} scenes, shape {codes.shape}, {overturned} overturned{until})", []
    error = "" if peak.errors is None else f" ± {float(peak.errors.peak_rotation):.1e}"
    rotation = f"{float(peak.peak_rotation):.6g}{error} α at t = {float(peak.peak_rotation_time):.6g} s"
    rows = [("peak rotation", rotation)]
    if peak.errors is not None and peak.errors.undecided:
        rows.append(
            (
                "undecided: within ten times the estimated error the columns may or may not overturn, or the "
                "rocking is chaotic; tighten rtol and atol",
                "",
            )
        )
    if peak.overturned:
        rows.append(("overturned at", f"{float(peak.overturn_time):.6g} s"))
    rows.append(
        ("uplift at", f"{float(peak.uplift_time):.6g} s") if peak.uplifted else ("never uplifted", "")
    )
    uncounted = "not counted to the end (request the output 'impacts')"
    rows.append(("impacts", uncounted if np.isnan(peak.impacts) else f"{int(peak.impacts)}"))
    until = f" {UNTIL_OVERTURNING}" if peak.overturned else ""
    count = np.size(peak.peak_deformation)
    modes = f" (modes 1 to {count})" if count > 1 else ""
    if not np.all(np.isnan(peak.peak_deformation)):
        rows.append(("deformation", f"{_format(peak.peak_deformation)} m{modes}{until}"))
    if not np.isnan(peak.peak_shear):
        rows.append(("shear", f"{float(peak.peak_shear):.6g} of the weight of the superstructure{until}"))
    rows += _rows_of_joints(peak)
    if peak.peak_drift is not None and peak.peak_floor_acceleration is not None:
        rows.append(("drifts", f"{_format(peak.peak_drift)} m{until}"))
        rows.append(("floors", f"{_format(peak.peak_floor_acceleration)} m/s²{until}"))
    rows += floor_rows(peak.on_floors)
    rows.append(("steps", f"{int(peak.stats.steps)} accepted, {int(peak.stats.rejected)} rejected"))
    end = f", t = {float(peak.stats.end_time):.6g} s" if codes == results.END_OF_TIME else ""
    return f"{class_name}: {results.NAMES[int(codes)]}{end}", rows


def _rows_of_joints(peak: AbstractPeak) -> list[tuple[str, str]]:
    """Return rows (label, value) for the requested answers of joints and foundation."""
    requested = [(y, VARIABLES[name][0]) for name, y in peak.values.items() if name in VARIABLES]
    rows = [
        (variable.symbol, f"{_format(value)} ({', '.join(JOINT_NAMES)})")
        for value, variable in requested
        if variable.axis == JOINTS
    ]
    shear = peak.values.get("peak_foundation_shear")
    rows += [] if shear is None else [(VARIABLES["peak_foundation_shear"][0].symbol, _format(shear))]
    if not rows:
        return []
    closed = "closed" if peak.has_elevation else MEAN_COLUMN_NOTE
    return [*rows, ("joints", closed if peak.joints_closed else OPEN_JOINT_NOTE)]


def _format(values) -> str:
    """Return one or more numbers as text, separated by commas."""
    return ", ".join(f"{float(y):.6g}" for y in np.ravel(np.asarray(values)))
