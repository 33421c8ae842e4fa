"""Floor response spectra: largest responses of oscillators on the deck and on floors.

A scene is one podium under one ground motion. The equations (L…) are in docs/floors.md and docs/equations.md.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import ArrayLike, Float

from rockjax import _results as results
from rockjax._checks import as_axis, as_float, format_value, require, require_number
from rockjax._excitations.base import AbstractExcitation
from rockjax._machine.threads import TABLE_MODULES, import_in_background
from rockjax._motions.convert import AnyMotions, single_motions
from rockjax._motions.motion import Motion, Motions
from rockjax._motions.provenance import describe_origin
from rockjax._motions.records import Records
from rockjax._options import Options, canonical_options
from rockjax._oscillators import largest
from rockjax._parameters.registry import as_variable
from rockjax._programs.program import StoredProgram
from rockjax._progress import bar
from rockjax._responses.arguments import as_start, check_single, check_types
from rockjax._responses.datasets import describe_excitation, describe_options, describe_podium
from rockjax._responses.floor import (
    DECK,
    check_direction,
    floor_weights,
    in_direction,
    largest_acceleration,
    load_of,
    pieces_of,
    with_beam,
)
from rockjax._responses.floor_course import NEVER_LIFTS, end_with_oscillators
from rockjax._responses.floor_end import Ending, bound_after_end, ending, ratio_after_end
from rockjax._responses.floor_slopes import (
    capacity_for,
    motions_with_slopes,
    slope_of_load,
    solve_with_slopes,
)
from rockjax._responses.response import Response
from rockjax._responses.sensitivities import check_sensitivities, slope_name
from rockjax._responses.simulate import simulate
from rockjax._results import REST, State
from rockjax._structures import Podium

if TYPE_CHECKING:
    import xarray

# Variables of the dataset: name → (unit, meaning). The variables of SPECTRA and PER_OSCILLATOR have the dims
# level, damping and period, those of PER_LEVEL only the dim level, and those of PER_SCENE none of these dims.
SPECTRA = {
    "pseudo_acceleration": ("m s-2", "pseudo-acceleration ω² max|x|"),
    "absolute_acceleration": ("m s-2", "largest absolute acceleration of the oscillator"),
    "relative_displacement": ("m", "largest displacement relative to the floor max|x|"),
}
PER_OSCILLATOR = {
    "peak_time": ("s", "time at which the displacement is largest"),
    "remaining_ratio": (
        "1",
        "bound of |x| after the end of the scene, divided by max|x|; the spectrum is final if at most 1",
    ),
}
PER_LEVEL = {
    "peak_acceleration": ("m s-2", "largest acceleration of the floor without velocity jumps"),
    "peak_velocity_jump": ("m s-1", "largest velocity jump of the floor"),
}
PER_SCENE = {
    "overturned": ("1", "the podium overturned; spectra cover the time until then and are lower bounds"),
    "overturn_time": ("s", "time of overturning"),
    "result": ("1", "result of the scene"),
}


_default_end = StoredProgram(end_with_oscillators)


def floor_spectrum(
    podium: Podium,
    excitation: AnyMotions,
    periods: Float[ArrayLike, " n"],
    *,
    damping: float | Sequence[float] = 0.05,
    level: str | int | Sequence[str | int] = DECK,
    weights: Float[ArrayLike, " modes"] | None = None,
    direction: str = "horizontal",
    initial: State = REST,
    t_end: float | None = None,
    options: Options = Options(),
    fixed_base: bool = False,
    sensitivities: Sequence[str] = (),
    progress: Any = False,
) -> xarray.Dataset:
    """Compute floor response spectra under one ground motion or a suite, (L5) to (L10).

    Oscillators start at rest relative to their floor and do not affect it. The velocity jumps of the floor at
    impacts are included exactly.

    - `podium`: podium with scalar parameters
    - `excitation`: one motion; or a suite (`Motions`, `Records` or a list), which adds the dim `motion`
    - `periods`: periods T_e of the oscillators, shape (n,), > 0 [s]
    - `damping`: damping ratios ζ of the oscillators, one or several, in [0, 1) [–]
    - `level`: `"deck"` (the beam), the number of a story from 1 at the bottom, or a list of levels
    - `weights`: weights of the modes that define a floor, (L2), shape (modes,) [–]; they replace `level`.
      None for the floors of `level`
    - `direction`: `"horizontal"` or `"vertical"`
    - `initial`, `options`: initial state and options of the scenes. The fixed base starts with θ = θ̇ = 0
    - `t_end`: latest end of the scenes [s]; by default as for [`rockjax.simulate`][], but at least 5 times
      the longest T_e after the end of the ground motion
    - `fixed_base`: also compute the spectra of the ground, `ground_pseudo_acceleration` …, and of the same
      floors on a base that never lifts, `fixed_base_pseudo_acceleration` …
    - `sensitivities`: parameters y for which y ∂/∂y of the spectra is computed as well, (L8), as in
      [`rockjax.peak_responses`][]
    - `progress`: `True` for a progress bar over the motions, or any object with a method `update(number)`

    Returns a Dataset. For a single motion it has no dim `motion`. The spectra have the dims (motion, level,
    damping, period). In the list, ω = 2π/T_e, and x is the displacement of an oscillator relative to its
    floor:

    - `pseudo_acceleration`: ω² max|x| [m/s²]
    - `absolute_acceleration`: largest absolute acceleration of the oscillator [m/s²]
    - `relative_displacement`: max|x| [m]; `peak_time`: time at which max|x| is first reached [s]
    - `remaining_ratio`: upper bound of |x| after the end of the scene, divided by max|x| [–]; inf if no bound
      is known. The spectrum is final where this ratio is at most 1
    - `pseudo_acceleration_sensitivity` …: sensitivities, with the further dim `parameter`

    Variables of floors have the dims (motion, level):

    - `peak_acceleration`: peak acceleration of the floor without velocity jumps [m/s²]
    - `peak_velocity_jump`: largest velocity jump of the floor [m/s]

    Variables of scenes have the dim motion:

    - `overturned`, `overturn_time`: whether the podium overturned, and the time of overturning [s]. The
      spectra of a scene that overturns cover only the time until then
    - `result`: the result of the scene on the podium or, if the scene on the fixed base does not finish, the
      result of the latter. Without `options.throw`, the spectra of a scene that does not finish cover only
      the time until the scene stopped

    Raises `ValueError` for invalid inputs and, with `options.throw`, `RuntimeError` for a scene that does not
    finish.
    """
    owner = "floor_spectrum"
    check_types(owner, podium, options)
    check_single(owner, podium)
    members, names = single_motions(owner, excitation, "excitation")
    is_suite = isinstance(excitation, Motions | Records) or not isinstance(
        excitation, AbstractExcitation | Motion
    )
    T = as_axis(owner, "periods", np.atleast_1d(periods))
    zeta = as_axis(owner, "damping", np.atleast_1d(damping))
    require(owner, "periods", T, lambda v: v > 0, "finite and > 0 s")
    require(owner, "damping", zeta, lambda v: (v >= 0) & (v < 1), "in [0, 1)")
    levels = list(level) if isinstance(level, list | tuple | np.ndarray) else [level]
    if not levels:
        raise ValueError(f"{owner}: level must name at least one level, got none")
    weights_by_level = {str(y): np.asarray(floor_weights(owner, podium, y)) for y in levels}
    if weights is not None:
        levels, weights_by_level = [], {"weights": np.asarray(floor_weights(owner, podium, DECK, weights))}
    check_direction(owner, direction)
    end = None if t_end is None else require_number(owner, "t_end", t_end, np.isfinite, "finite")
    start = as_start(owner, initial, podium)
    for member in members:
        sensitivities = check_sensitivities(owner, podium, member, sensitivities)
    import_in_background(*TABLE_MODULES)
    stories = {str(y): y for y in levels if y != DECK} if sensitivities else {}
    request = _Request(weights_by_level, stories, T, zeta, direction, tuple(sensitivities))
    labels = None if not is_suite else list(range(1, len(members) + 1)) if names is None else names

    cases = [(podium, initial, options, request)]
    if fixed_base:
        fixed_podium = podium.replace(alpha=NEVER_LIFTS, restrainers=(), elevation=None)
        # The deck of the fixed podium moves with the ground, so its spectra are those of the ground.
        weights_with_deck = {DECK: 0 * next(iter(weights_by_level.values()))} | weights_by_level
        fixed_request = request._replace(weights=weights_with_deck, stories={}, names=())
        fixed_initial = dataclasses.replace(initial, theta=0.0, theta_dot=0.0)
        cases.append((fixed_podium, fixed_initial, options.replace(overturn_ratio=1.0), fixed_request))
    spectra: list[list[_Spectrum]] = [[] for _ in cases]
    with bar(len(members), "motions", progress) as counter:
        for member in members:
            for case_spectra, (structure, state, settings, requested) in zip(spectra, cases, strict=True):
                scene_end = end
                if scene_end is None:
                    scene_end = float(_default_end(structure.split_rows(), member.common_form(), T.max()))
                response = simulate(structure, member, initial=state, t_end=scene_end, options=settings)
                case_spectra.append(_spectrum(response, start, scene_end, requested))
            counter.update(1)
    data = _dataset(request, labels, spectra[0])
    if fixed_base:
        fixed = _dataset(cases[1][3], labels, spectra[1])
        for name in SPECTRA:
            data[f"ground_{name}"] = fixed[name].sel(level=DECK, drop=True)
            data[f"fixed_base_{name}"] = fixed[name].sel(level=list(weights_by_level))
        data["result"] = data["result"].where(~results.did_not_finish(fixed["result"]), fixed["result"])
    origin = {} if is_suite else describe_excitation(members[0]) | dict(describe_origin(excitation))
    data.attrs = {
        "title": "Floor response spectra",
        "kind": "floor-spectrum",
        "direction": direction,
        **origin,
    }
    data.attrs |= describe_podium(podium) | describe_options(options)
    return data


class _Request(NamedTuple):
    """The requested spectra, the same for every scene.

    - `weights`: weights of the modes for each level, shape (modes,)
    - `stories`: number of the story for each level except the deck; empty if `names` is empty
    - `periods`, `damping`: axes of the spectra, 1-D arrays [s], [–]
    - `direction`: "horizontal" or "vertical"
    - `names`: names of the parameters for which sensitivities are computed
    """

    weights: dict[str, np.ndarray]
    stories: dict[str, Any]
    periods: np.ndarray
    damping: np.ndarray
    direction: str
    names: tuple[str, ...]


class _Spectrum(NamedTuple):
    """Variables of one scene, in three dicts name → values.

    - `values`: spectra and their sensitivities, with axes of levels, dampings, periods and, for
      sensitivities, parameters
    - `per_level`: variables of `PER_LEVEL`, with an axis of levels
    - `per_scene`: variables of `PER_SCENE`, scalars
    """

    values: dict[str, np.ndarray]
    per_level: dict[str, np.ndarray]
    per_scene: dict[str, Any]


def _spectrum(response: Response, start: State, t_end: float, request: _Request) -> _Spectrum:
    """Return the spectra of one scene.

    - `response`: history of the scene
    - `start`, `t_end`: initial state and latest end [s] of the scene
    - `request`: the requested spectra
    """
    deck = response.floor()
    scene, is_vertical = deck.scene, request.direction == "vertical"
    solution = None
    if request.names:
        solution = solve_with_slopes(
            response.podium.split_rows(),
            response.excitation.common_form(),
            start,
            as_float(t_end),
            canonical_options(response.podium, response.options),
            names=request.names,
            levels=tuple(request.stories.values()),
            history=capacity_for(int(response.nodes.used)),
        )
        # The nodes of `solution` replace those of the response, because only they have derivatives.
        scene = response.podium.split_rows(), scene[1], jax.tree.map(np.asarray, solution.nodes), *scene[3:]
    end = deck.last(t_end)
    (pieces, motion), slopes = pieces_of(scene, end), []
    if solution is not None:
        motion, slopes = motions_with_slopes(scene, solution, pieces, request.names, list(request.stories))
    ended = Ending(*(np.asarray(y) for y in ending(scene, as_float(end))))
    period, damping = (y.ravel() for y in np.meshgrid(request.periods, request.damping))
    omega, shape = 2 * np.pi / period, (request.damping.size, request.periods.size)
    values: dict[str, list[np.ndarray]] = {name: [] for name in (*SPECTRA, *PER_OSCILLATOR)}
    sensitivities: dict[str, list[np.ndarray]] = {slope_name(name): [] for name in SPECTRA}
    per_level: dict[str, list[float]] = {name: [] for name in PER_LEVEL}
    code = int(results.code_of(response.result))
    is_incomplete = bool(response.overturned) or results.did_not_finish(code)
    for level, weights in request.weights.items():
        load = load_of(pieces, motion, in_direction(with_beam(weights), request.direction))
        remaining_impulse = np.inf if is_incomplete else bound_after_end(ended, weights, damping, is_vertical)
        load_slopes = [
            slope_of_load(
                load, pieces, motion, slope, weights, slope.weights.get(level, 0 * weights), request.direction
            )
            for slope in slopes
        ]
        ends_at_rest = bool(ended.rests) and not np.any(remaining_impulse) and not is_incomplete
        peaks = largest(load, period, damping, ends_at_rest, tuple(load_slopes))
        displacement, acceleration = peaks.values
        # Bound of |x| after the end of the scene. If the floor ends at rest, max|x| already includes the free
        # vibration after the end, so the ratio is at most 1.
        later_displacement = (
            np.minimum(peaks.later, displacement)
            if ends_at_rest
            else peaks.envelope + remaining_impulse / omega
        )
        ratio = ratio_after_end(later_displacement, displacement)
        spectrum_values = omega**2 * displacement, acceleration, displacement, peaks.times[0], ratio
        slope_values = omega**2 * peaks.slopes[0], peaks.slopes[1], peaks.slopes[0]
        for name, value in zip(values, spectrum_values, strict=True):
            values[name].append(value.reshape(shape))
        for name, value in zip(sensitivities, slope_values, strict=True):
            sensitivities[name].append(np.moveaxis(value, 0, -1).reshape(*shape, -1))
        per_level["peak_acceleration"].append(largest_acceleration(load))
        per_level["peak_velocity_jump"].append(float(np.abs(load.kick).max()))
    return _Spectrum(
        {name: np.stack(y) for name, y in (values | (sensitivities if slopes else {})).items()},
        {name: np.array(y) for name, y in per_level.items()},
        {name: np.asarray(getattr(response, name)) for name in ("overturned", "overturn_time")}
        | {"result": np.int8(code)},
    )


def _dataset(request: _Request, labels: list | None, spectra: list[_Spectrum]) -> xarray.Dataset:
    """Return the spectra of all scenes as a dataset.

    - `request`: the requested spectra
    - `labels`: labels of the motions; None without a dim `motion`
    - `spectra`: variables of each scene
    """
    import xarray

    def joined(values: list) -> np.ndarray:
        return values[0] if labels is None else np.stack(values)

    motion_dims = () if labels is None else ("motion",)
    dims = (*motion_dims, "level", "damping", "period")
    slopes = {
        slope_name(name): (unit, f"derivative of the {meaning} with respect to parameter y, times y")
        for name, (unit, meaning) in SPECTRA.items()
    }
    data = {}
    for name, (unit, meaning) in (SPECTRA | PER_OSCILLATOR | slopes).items():
        if name in spectra[0].values:
            parameter_dim = ("parameter",) if name in slopes else ()
            values = joined([y.values[name] for y in spectra])
            data[name] = as_variable((*dims, *parameter_dim), values, unit, meaning)
    for name, (unit, meaning) in PER_LEVEL.items():
        data[name] = as_variable(dims[:-2], joined([y.per_level[name] for y in spectra]), unit, meaning)
    for name, (unit, meaning) in PER_SCENE.items():
        data[name] = as_variable(motion_dims, joined([y.per_scene[name] for y in spectra]), unit, meaning)
    data["result"][2].update(results.FLAGS)
    coords: dict[str, Any] = {
        "level": list(request.weights),
        "damping": as_variable("damping", request.damping, "1", "damping ratio of the oscillator ζ"),
        "period": as_variable("period", request.periods, "s", "period of the oscillator T_e"),
    }
    coords |= {} if labels is None else {"motion": labels}
    coords |= {"parameter": list(request.names)} if request.names else {}
    return xarray.Dataset(data, coords=coords)


def broadened(spectrum: xarray.Dataset, ratio: float = 0.15) -> xarray.Dataset:
    """Return a floor spectrum with broadened peaks. The value at each period T is the largest value of the
    spectrum between the periods T/(1+β) and T/(1−β), (L11).

    - `spectrum`: result of [`rockjax.floor_spectrum`][] or [`rockjax.envelope`][], with ascending periods
    - `ratio`: β, in [0, 1) [–]; 0.15 is usual for nuclear facilities

    Between its periods, the spectrum is interpolated linearly in log T. It is not extrapolated. The result
    has only the variables `pseudo_acceleration`, `absolute_acceleration` and `relative_displacement`, and the
    `overturned`, `overturn_time` and `result` of the scenes, because spectra of scenes that overturned or did
    not finish are lower bounds. Raises `ValueError` for another dataset, for periods that do not ascend, and
    for a ratio out of range.
    """
    owner = "broadened"
    ratio = require_number(owner, "ratio", ratio, lambda v: 0 <= v < 1, "in [0, 1)")
    names = _spectra_of(owner, spectrum)
    T = spectrum["period"].values
    if np.any(np.diff(T) <= 0):
        raise ValueError(f"{owner}: the periods of the spectrum must ascend, got {T}")
    log = np.log(T)
    low, high = (np.clip(log + y, log[0], log[-1]) for y in (-np.log1p(ratio), -np.log1p(-ratio)))
    inside = (log >= low[:, None]) & (log <= high[:, None])

    def broaden(values: np.ndarray) -> np.ndarray:
        at_ends = np.maximum(np.interp(low, log, values), np.interp(high, log, values))
        return np.maximum(at_ends, np.where(inside, values, -np.inf).max(axis=1))

    flags = [name for name in ("overturned", "overturn_time", "result") if name in spectrum]
    data = spectrum[[*names, *flags]].copy(deep=True)
    for name in names:
        axis = data[name].dims.index("period")
        data[name].values[...] = np.apply_along_axis(broaden, axis, spectrum[name].values)
    data.attrs["broadened"] = ratio
    return data


def envelope(
    spectra: xarray.Dataset,
    over: str = "motion",
    *,
    quantile: float | None = None,
    overturned: Literal["raise", "drop"] = "raise",
) -> xarray.Dataset:
    """Return the envelope or a quantile of floor spectra over motions or levels, at each period.

    - `spectra`: result of [`rockjax.floor_spectrum`][]
    - `over`: dim along which the envelope or the quantile is taken, `"motion"` or `"level"`
    - `quantile`: quantile in [0, 1], such as 0.84 [–]; None for the largest value
    - `overturned`: `"raise"` raises an error if scenes overturned, because their spectra are lower bounds;
      `"drop"` leaves out such scenes, and is possible only over `"motion"`

    The result has only the variables `pseudo_acceleration`, `absolute_acceleration` and
    `relative_displacement`. Raises `ValueError` if scenes overturned and are not dropped, if all scenes
    overturned, if a scene did not finish, and for other invalid inputs.
    """
    owner = "envelope"
    names = _spectra_of(owner, spectra, "overturned", "result")
    if over not in ("motion", "level") or over not in spectra.dims:
        raise ValueError(f"{owner}: over must be a dim of the spectra, 'motion' or 'level', got {over!r}")
    if overturned not in ("raise", "drop"):
        raise ValueError(f"{owner}: overturned must be 'raise' or 'drop', got {overturned!r}")
    if quantile is not None:
        require_number(owner, "quantile", quantile, lambda v: 0 <= v <= 1, "in [0, 1]")
    data = spectra[names]
    unfinished = np.atleast_1d(results.did_not_finish(spectra["result"].values))
    if unfinished.any():
        raise ValueError(
            f"{owner}: {unfinished.sum()} of {unfinished.size} scenes did not finish, so their spectra are "
            "only lower bounds; their variable 'result' names the cause"
        )
    is_overturned = np.atleast_1d(spectra["overturned"].values)
    if is_overturned.any():
        if overturned == "raise" or over != "motion" or is_overturned.all():
            raise ValueError(
                f"{owner}: {int(is_overturned.sum())} of {is_overturned.size} scenes overturned, so their "
                "spectra are only lower bounds; leave them out with over='motion' and overturned='drop', or "
                "scale the motions down"
            )
        data = data.isel(motion=np.flatnonzero(~is_overturned))
    result = (
        data.max(over, keep_attrs=True)
        if quantile is None
        else data.quantile(quantile, over, keep_attrs=True)
    )
    result.attrs["envelope"] = over if quantile is None else f"{quantile:g} quantile over {over}"
    result.attrs["scenes"] = int((~is_overturned).sum())
    return result


def _spectra_of(owner: str, spectra: Any, *required: str) -> list[str]:
    """Return the names of the spectra in a dataset. Raises `ValueError` if there are none, or if the dataset
    lacks one of the `required` variables."""
    variables = getattr(spectra, "data_vars", ())
    names = [name for name in SPECTRA if name in variables]
    if not names or any(name not in variables for name in required):
        raise ValueError(
            f"{owner}: the spectra must be a result of rockjax.floor_spectrum, got {format_value(spectra)}"
        )
    return names
