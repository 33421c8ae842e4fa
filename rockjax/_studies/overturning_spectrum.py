"""Overturning spectra: boundaries between survival and overturning as a function of the pulse frequency.

A scene is one podium under one pulse. Its outcome is survival or overturning.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from rockjax._boundaries.boundary import (
    BOUNDARY,
    MAX_ACCELERATION_RATIO,
    ONE_SIDED_BELOW,
    check_limit,
    check_search,
)
from rockjax._boundaries.crossings import Scan, scan
from rockjax._boundaries.implicit import log_sensitivities
from rockjax._boundaries.margin import DEFAULT_WIDTH
from rockjax._checks import as_axis, require_positive
from rockjax._excitations.base import AbstractExcitation
from rockjax._machine.memory import REQUEST_FEWER, require_memory
from rockjax._machine.threads import TABLE_MODULES, import_in_background
from rockjax._motions.convert import as_pulse
from rockjax._options import Options
from rockjax._parameters.registry import as_variable, variable_attributes
from rockjax._parameters.sensitivities import check_parameters
from rockjax._parameters.variants import pulse_period
from rockjax._responses.arguments import check_single, check_types, warn_of_small_restitution
from rockjax._responses.datasets import derived_numbers, describe
from rockjax._structures import Podium

from .spectra import boundary_axis, check_resumed_parameters, check_resumes

if TYPE_CHECKING:
    import xarray


def overturning_spectrum(
    podium: Podium,
    pulse: Callable[[Any, Any], AbstractExcitation],
    frequency_ratio,
    *,
    max_acceleration_ratio: float = MAX_ACCELERATION_RATIO,
    sensitivities: Sequence[str] = (),
    resolution: int = 128,
    width: float = DEFAULT_WIDTH,
    options: Options = BOUNDARY,
    progress: Any = False,
) -> xarray.Dataset:
    """Find the pulse accelerations at which a podium changes between survival and overturning.

    - `podium`: podium with scalar parameters
    - `pulse`: a pulse class such as `rockjax.Ricker`, or any function (a_p, T_p) ↦ excitation
    - `frequency_ratio`: ω_p/p with ω_p = 2π/T_p, shape (n,), > 0
    - `max_acceleration_ratio`: end of the search, a_p/(g tan α), > 0 [–]
    - `sensitivities`: parameters y for which the derivative of the minimum with respect to ln y is computed:
      `"T_p"`, and parameters of the podium, such as `"alpha"`, `"R"`, `"T_s"`. The other parameters are held
      constant
    - `resolution`: number of equal intervals of the acceleration; the search starts with the ends of these
      intervals. Intervals in which the overturning margin may cross zero are divided further
    - `width`: the search for the minimum is designed to find every interval of overturning accelerations that
      is wider than this share of `max_acceleration_ratio`, in (0, 0.1]
    - `options`: options of the scenes
    - `progress`: `True` for progress bars, or any object with a method `update(number_of_scenes)`

    Returns a Dataset over `frequency_ratio`, with accelerations divided by g tan α:

    - `minimum`: a_ov/(g tan α) with the least overturning acceleration a_ov [m/s²]; NaN if there is none
    - `boundaries` (additional dim `boundary`): accelerations at which the outcome changes, ascending, padded
      with NaN. With the default options their relative error is about 1e-10
    - `impacts` (additional dim `boundary`): number of impacts before overturning, in a scene on the
      overturned side of the boundary; −1 where there is no boundary
    - `one_sided`: True where a small change of the parameters may make the minimum jump to a much lower
      acceleration
    - `certain_width`: largest width of an interval of overturning accelerations below the minimum that the
      search may have missed
    - `sensitivity` (additional dim `parameter`): (d a_ov/d ln y)/(g tan α); g tan α is not differentiated

    Raises `ValueError` for invalid inputs, and `RuntimeError` if at some frequency no scene finishes.
    """
    owner = "overturning_spectrum"
    check_types(owner, podium, options)
    warn_of_small_restitution(podium, stacklevel=3)
    pulse = as_pulse(owner, pulse)
    x = as_axis(owner, "frequency_ratio", frequency_ratio)
    require_positive(owner, frequency_ratio=x)
    check_limit(owner, "max_acceleration_ratio", max_acceleration_ratio)
    check_single(owner, podium)
    check_search(owner, width, resolution)
    check_parameters(owner, podium, sensitivities, more=["T_p"])
    require_memory(owner, x.size * (resolution + 1), advice=REQUEST_FEWER)
    derived = derived_numbers(podium)
    g_tan_alpha, p = derived["g_tan_alpha_m_s2"], derived["p_rad_s"]

    def plane(x, y):
        """Return the scenes at frequency ratios x and acceleration ratios y."""
        return podium, pulse(y * g_tan_alpha, pulse_period(p, x))

    max_ratio = float(max_acceleration_ratio)
    import_in_background(*TABLE_MODULES)
    search = scan(plane, x, (0.0, max_ratio), resolution, options, progress, width=width)
    data = _dataset(podium, pulse, x, search, derived, options)
    data.attrs |= {"max_acceleration_ratio": max_ratio, "scenes": search.scenes}
    if sensitivities:
        a_p, T_p = data["minimum"].values * g_tan_alpha, data["T_p"].values
        slopes = log_sensitivities(podium, a_p, {"T_p": T_p}, tuple(sensitivities), options, pulse=pulse)
        slopes, dims = data["minimum"].values * slopes, ("parameter", "frequency_ratio")
        long_name = "d a_ov/d ln y divided by g tan α, along the minimum"
        data["sensitivity"] = as_variable(dims, slopes, "1", long_name)
        data = data.assign_coords(parameter=list(sensitivities))
    return data


def check_overturning_resumes(
    spectrum: xarray.Dataset,
    podium: Podium,
    pulse,
    frequency_ratio,
    max_acceleration_ratio,
    sensitivities,
    options: Options,
) -> None:
    """Raise `ValueError` unless a spectrum to resume was computed with these arguments.

    - `spectrum`: spectrum to resume
    - `podium`, `pulse`, `frequency_ratio`, `max_acceleration_ratio`, `sensitivities`, `options`: as for
      `overturning_spectrum`
    """
    owner = "overturning_spectrum"
    attributes = _attributes(podium, pulse, options) | {
        "max_acceleration_ratio": float(max_acceleration_ratio)
    }
    check_resumes(owner, spectrum, attributes, {"frequency_ratio": frequency_ratio})
    check_resumed_parameters(owner, spectrum, sensitivities)


def _attributes(podium: Podium, pulse, options: Options) -> dict[str, Any]:
    return {
        "title": "Overturning spectrum",
        "kind": "overturning-spectrum",
        **describe(podium, pulse, options),
    }


def _dataset(podium: Podium, pulse, x, search: Scan, derived, options: Options) -> xarray.Dataset:
    """Return the spectrum as a dataset.

    - `podium`, `pulse`, `options`: as for `overturning_spectrum`
    - `x`: frequency ratios, shape (n,)
    - `search`: result of the search for boundaries at these ratios
    - `derived`: the `derived_numbers` of the podium
    """
    import xarray

    boundaries, impacts = search.crossings.table(x.size)
    T_p = pulse_period(derived["p_rad_s"], x)
    minimum, axis = boundaries[:, 0], "frequency_ratio"
    dims, one_sided = (axis, "boundary"), search.dip < ONE_SIDED_BELOW
    jumps = "the minimum is about to jump to another branch"
    undetected = "largest width of an undetected interval that overturns"
    minimum_a_p = minimum * derived["g_tan_alpha_m_s2"]
    data = xarray.Dataset(
        {
            "minimum": as_variable(axis, minimum, "1", "least overturning a_p/(g tan α)"),
            "boundaries": as_variable(dims, boundaries, "1", "a_p/(g tan α)"),
            "impacts": as_variable(dims, impacts, "1", "impacts before overturning"),
            "one_sided": as_variable(axis, one_sided, "1", jumps),
            "certain_width": as_variable(axis, search.certain_width, "1", undetected),
        },
        coords={
            "boundary": boundary_axis(boundaries),
            axis: (axis, x, variable_attributes(axis)),
            "T_p": (axis, T_p, variable_attributes("T_p")),
            "minimum_a_p": as_variable(axis, minimum_a_p, "m s-2", "least overturning pulse acceleration"),
        },
    )
    data.attrs = _attributes(podium, pulse, options)
    return data
