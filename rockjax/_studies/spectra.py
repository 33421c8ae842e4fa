"""Rocking spectra: peak responses over the dimensionless frequency and acceleration of pulses.

A scene is one podium under one pulse.
"""

from __future__ import annotations

import concurrent.futures
import threading
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from rockjax import _results as results
from rockjax._batch.batch import responses, warn_of_failures
from rockjax._checks import (
    as_axis,
    as_strings,
    format_value,
    require_instance,
    require_not_negative,
    require_positive,
)
from rockjax._excitations.base import AbstractExcitation
from rockjax._machine.memory import BYTES_PER_SCENE, BYTES_PER_SENSITIVITY, require_memory
from rockjax._machine.threads import TABLE_MODULES, import_in_background, submit
from rockjax._motions.convert import as_pulse
from rockjax._options import Options
from rockjax._outputs.base import JOINTS
from rockjax._parameters.registry import as_variable, variable_attributes
from rockjax._parameters.variants import pulse_period
from rockjax._responses.arguments import check_types, warn_of_small_restitution
from rockjax._responses.datasets import derived_numbers, describe
from rockjax._responses.peak import Peak, data_variables, parameter_axis
from rockjax._responses.sensitivities import check_sensitivities
from rockjax._results import REST, Interrupted
from rockjax._structures import Podium

if TYPE_CHECKING:
    import xarray


def rocking_spectrum(
    podium: Podium,
    pulse: Callable[[Any, Any], AbstractExcitation],
    frequency_ratio,
    acceleration_ratio,
    *,
    options: Options = Options(),
    progress: Any = False,
    resume: xarray.Dataset | None = None,
    sensitivities: Sequence[str] = (),
) -> xarray.Dataset:
    """Compute peak responses of one podium over a grid of pulses.

    - `podium`: podium with scalar parameters
    - `pulse`: a pulse class such as `rockjax.Ricker`, or any function (a_p, T_p) ↦ excitation
    - `frequency_ratio`: ω_p/p with ω_p = 2π/T_p, shape (n,), > 0
    - `acceleration_ratio`: a_p/(g tan α), shape (m,), ≥ 0
    - `options`: options of the scenes; `options.outputs` selects the variables
    - `progress`: `True` for a progress bar, or any object with a method `update(number_of_scenes)`
    - `resume`: an incomplete spectrum, the `partial` of the [`rockjax.Interrupted`][] that Ctrl-C raised;
      only the missing scenes of this spectrum are solved. None to solve all scenes
    - `sensitivities`: parameters y for which y ∂/∂y of every requested peak is computed, as in
      [`rockjax.peak_responses`][]: `"alpha"`, `"gamma"`, …, `"a_p"`, `"T_p"`. The other parameters are held
      constant, so a_p and T_p do not change with the parameters of the podium

    Returns a Dataset with the dims `acceleration_ratio` and `frequency_ratio`. Its variables are

    - the answers that every scene has, such as `overturned`
    - the answers that `options.outputs` requests, see [`rockjax.Peak`][]; `"errors"` gives
      `peak_rotation_error` … and `undecided`
    - the sensitivities of requested peaks, such as `peak_rotation_sensitivity` (additional dim `parameter`)

    The coordinates `T_p` [s] and `a_p` [m/s²] are the same axes with dimensions. With the output
    `"axial_force"`, a further coordinate `dead_load` is the axial force at rest divided by the weight of a
    column, N/(m_c g), averaged over the columns. The attributes contain parameters, options and versions.

    Ctrl-C raises [`rockjax.Interrupted`][]; its `partial` is the incomplete spectrum, or None if no scene was
    solved. Raises `ValueError` for axes that are empty, not 1-D, not finite or out of range, for
    sensitivities to unknown parameters, and for a spectrum to resume that was computed with other
    sensitivities or another podium, pulse, axis, option or version.
    """
    resumed = None if resume is None else [resume]
    try:
        (spectrum,) = _spectra(
            "rocking_spectrum",
            [podium],
            pulse,
            frequency_ratio,
            acceleration_ratio,
            options,
            progress,
            resumed,
            sensitivities,
        )
    except Interrupted as interrupted:
        raise Interrupted(str(interrupted), interrupted.partial[0]) from None
    return spectrum


def rocking_spectra(
    podiums: Sequence[Podium],
    pulse: Callable[[Any, Any], AbstractExcitation],
    frequency_ratio,
    acceleration_ratio,
    *,
    options: Options = Options(),
    progress: Any = False,
    resume: Sequence[xarray.Dataset | None] | None = None,
    sensitivities: Sequence[str] = (),
) -> list[xarray.Dataset]:
    """Compute rocking spectra of several podiums over the same axes.

    Podiums of the same structure (the same classes of superstructure, restitution law and restrainers) share
    one batch, which is faster than separate spectra. Ctrl-C raises [`rockjax.Interrupted`][]; its `partial`
    is a list with the incomplete spectrum of each podium, or None for a podium without solved scenes.

    - `podiums`: podiums with scalar parameters
    - `pulse`, `frequency_ratio`, `acceleration_ratio`, `options`, `progress`, `sensitivities`: as for
      [`rockjax.rocking_spectrum`][]
    - `resume`: None to solve all scenes, or the `partial` of the exception: a list with an incomplete
      spectrum or None for each podium. For an incomplete spectrum, only its missing scenes are solved; for
      None, all scenes of the podium are solved

    Returns a spectrum for each podium, as from [`rockjax.rocking_spectrum`][]. Raises `ValueError` as that
    function does.
    """
    owner = "rocking_spectra"
    require_instance(owner, "podiums", podiums, list | tuple, "a list of rockjax.Podium")
    axes = frequency_ratio, acceleration_ratio
    return _spectra(owner, podiums, pulse, *axes, options, progress, resume, sensitivities)


def _spectra(
    owner: str,
    podiums: Sequence[Podium],
    pulse: Callable[[Any, Any], AbstractExcitation],
    frequency_ratio,
    acceleration_ratio,
    options: Options,
    progress: Any,
    resume: Sequence[xarray.Dataset | None] | None,
    sensitivities: Sequence[str],
) -> list[xarray.Dataset]:
    """Compute the spectra of `rocking_spectra`. `owner` is the name of the calling function, for messages."""
    for podium in podiums:
        check_types(owner, podium, options)
        warn_of_small_restitution(podium, stacklevel=4)
    pulse = as_pulse(owner, pulse)
    axes = _axes(owner, frequency_ratio, acceleration_ratio)
    if any(jnp.ndim(y) for y in jax.tree.leaves([podium.split_rows() for podium in podiums])):
        raise ValueError(
            f"{owner}: a podium must have scalar parameters; give rocking_spectra a list of podiums, or use "
            "peak_responses"
        )
    names = as_strings(owner, "sensitivities", sensitivities)
    for podium in podiums if names else ():
        check_sensitivities(owner, podium, pulse(1.0, 1.0), names)
    total = len(podiums) * axes["frequency_ratio"].size * axes["acceleration_ratio"].size
    require_memory(owner, total, BYTES_PER_SCENE + len(names) * BYTES_PER_SENSITIVITY)
    groups = list(group_by_structure(podiums).values())
    import_in_background(*TABLE_MODULES)
    derived = [derived_numbers(podium) for podium in podiums]

    resumed = _check_resumed(owner, resume, podiums, pulse, axes, options, names)
    stop = threading.Event()

    def solve(members: list[int]) -> list[xarray.Dataset | None]:
        T_p = np.stack([pulse_period(derived[k]["p_rad_s"], axes["frequency_ratio"]) for k in members])
        a_p = np.stack([axes["acceleration_ratio"] * derived[k]["g_tan_alpha_m_s2"] for k in members])
        combined = stack_podiums([podiums[k] for k in members], lambda y: y[:, None, None])
        pulse_parameters = a_p[:, :, None], T_p[:, None, :]
        shape = np.broadcast_shapes(*(y.shape for y in pulse_parameters))
        unsolved = np.stack([_find_unsolved(resumed[k], shape[1:]) for k in members])
        if not unsolved.any():
            return [resumed[k] for k in members]
        if not unsolved.all():  # solve only the unsolved scenes, as a flat batch
            select = lambda y: np.broadcast_to(y, shape)[unsolved] if np.ndim(y) else y
            combined, pulse_parameters = jax.tree.map(select, (combined, pulse_parameters))
        try:
            motions = pulse(*pulse_parameters)
            peaks = responses(combined, motions, REST, None, options, progress, stop, sensitivities=names)
            warn_of_failures(peaks, stacklevel=2)
        except Interrupted as interrupted:
            if interrupted.partial is None:
                return [resumed[k] for k in members]
            peaks = interrupted.partial
        if not unsolved.all():
            peaks = jax.tree.map(lambda y: _place_values(y, unsolved), peaks)
        member_peaks = [jax.tree.map(lambda y, j=j: y[j], peaks) for j in range(len(members))]
        return [
            _merge_resumed(
                resumed[k], _dataset(podiums[k], pulse, axes, a_p[j], T_p[j], member_peaks[j], options)
            )
            for j, k in enumerate(members)
        ]

    solved = _solve_groups(solve, groups, stop)
    # After Ctrl-C, groups that were not submitted keep their resumed spectra.
    solved += [[resumed[k] for k in members] for members in groups[len(solved) :]]
    spectra = {k: data for pair in zip(groups, solved, strict=True) for k, data in zip(*pair, strict=True)}
    ordered = [spectra[k] for k in sorted(spectra)]
    size = (axes["acceleration_ratio"].size, axes["frequency_ratio"].size)
    unsolved_count = sum(int(_find_unsolved(data, size).sum()) for data in ordered)
    if unsolved_count or stop.is_set():
        total = len(podiums) * size[0] * size[1]
        raise Interrupted(f"stopped with {total - unsolved_count} of {total} scenes solved", ordered)
    return [data for data in ordered if data is not None]


def _solve_groups(solve: Callable[[list[int]], Any], groups: list[list[int]], stop: threading.Event) -> list:
    """Return the results of `solve` for groups of podiums. A group is a list of indices of podiums.

    Each group has its own thread, so one group is compiled while another runs. Ctrl-C sets `stop`. Groups
    that were not submitted before Ctrl-C have no result; they are the last ones.
    """
    futures = []
    try:
        for members in groups:
            futures.append(submit(solve, members))
        concurrent.futures.wait(futures)
    except KeyboardInterrupt:
        stop.set()
    return [future.result() for future in futures]


def group_by_structure(podiums: Sequence[Podium]) -> dict[Any, list[int]]:
    """Group the indices of podiums by the structure of their pytrees. The podiums of a group can share a
    batch.

    Podiums with a vibrating superstructure come first, because their programs take longest to compile.
    """
    groups: dict[Any, list[int]] = {}
    for k, podium in sorted(enumerate(podiums), key=lambda indexed: not indexed[1].vibrates):
        groups.setdefault(jax.tree.structure(podium.split_rows()), []).append(k)
    return groups


def stack_podiums(podiums: Sequence[Podium], per_podium: Callable[[np.ndarray], np.ndarray]) -> Podium:
    """Combine podiums of the same structure into one podium with array parameters.

    - `podiums`: n podiums
    - `per_podium`: function that turns a parameter of the podiums, shape (n,), into an array that broadcasts
      with the scenes

    Parameters that are equal in all podiums remain scalars; the others become arrays.
    """
    stack = lambda *y: y[0] if len(set(map(float, y))) == 1 else per_podium(np.asarray(y))
    return jax.tree.map(stack, *(podium.split_rows() for podium in podiums))


def boundary_axis(table: np.ndarray) -> tuple[str, np.ndarray, dict[str, str]]:
    """Return the coordinate along the columns of a table of boundaries."""
    return "boundary", np.arange(1, table.shape[1] + 1), {"long_name": "number of the boundary, from below"}


def _axes(owner: str, frequency_ratio, acceleration_ratio) -> dict[str, np.ndarray]:
    """Return both axes by name as arrays. Raise `ValueError` if an axis is not 1-D, is empty, or has a value
    that is not finite or out of range."""
    arguments = {"frequency_ratio": frequency_ratio, "acceleration_ratio": acceleration_ratio}
    axes = {name: as_axis(owner, name, values) for name, values in arguments.items()}
    require_positive(owner, frequency_ratio=axes["frequency_ratio"])
    require_not_negative(owner, acceleration_ratio=axes["acceleration_ratio"])
    return axes


def _check_resumed(
    owner: str,
    resume,
    podiums: Sequence[Podium],
    pulse,
    axes: dict[str, np.ndarray],
    options: Options,
    sensitivities: Sequence[str],
) -> list:
    """Return the spectrum to resume, or None, for each podium.

    - `owner`: name of the calling function, for messages
    - `resume`, `podiums`, `pulse`, `options`, `sensitivities`: as for `rocking_spectra`
    - `axes`: the axes by name

    Raises `ValueError` for a spectrum that was computed with other arguments.
    """
    if isinstance(resume, str) or not isinstance(resume, Iterable | None):
        raise ValueError(f"{owner}: resume must be a list of spectra or None, got {format_value(resume)}")
    resumed = list(resume) if resume is not None else [None] * len(podiums)
    if len(resumed) != len(podiums):
        raise ValueError(
            f"{owner}: resume must have one spectrum or None for each of the {len(podiums)} podiums, got "
            f"{len(resumed)}"
        )
    for podium, data in zip(podiums, resumed, strict=True):
        if data is not None:
            check_resumes(owner, data, _attributes(podium, pulse, options), axes)
            check_resumed_parameters(owner, data, sensitivities)
    return resumed


def _find_unsolved(resumed: xarray.Dataset | None, shape: tuple[int, ...]) -> np.ndarray:
    """Return a mask of the unsolved scenes of a spectrum to resume. Without such a spectrum, all scenes of a
    grid of this `shape` are unsolved."""
    return np.ones(shape, bool) if resumed is None else np.asarray(resumed["result"] == results.INTERRUPTED)


def _place_values(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return an array with the values at the True entries of a mask, and zeros elsewhere."""
    full = np.zeros((*where.shape, *values.shape[1:]), values.dtype)
    full[where] = values
    return full


def _merge_resumed(resumed: xarray.Dataset | None, new: xarray.Dataset) -> xarray.Dataset:
    """Return the new spectrum with the solved scenes of the resumed spectrum filled in."""
    if resumed is None:
        return new
    solved = ~_find_unsolved(resumed, ())
    for name, values in new.data_vars.items():
        is_solved = solved.reshape(solved.shape + (1,) * (values.ndim - solved.ndim))
        values.values[...] = np.where(is_solved, resumed[name].values, values.values)
    return new


def check_resumes(
    owner: str, spectrum: xarray.Dataset, attributes: dict[str, Any], axes: dict[str, np.ndarray]
) -> None:
    """Raise `ValueError` unless a spectrum to resume has these attributes and axes.

    - `owner`: name of the calling function, for messages
    - `spectrum`: spectrum to resume
    - `attributes`, `axes`: required values of attributes and axes, by name
    """
    if not hasattr(spectrum, "coords"):
        raise ValueError(
            f"{owner}: resume must be the partial of rockjax.Interrupted, got {format_value(spectrum)}"
        )
    for name, values in axes.items():
        if name not in spectrum.coords or not np.array_equal(spectrum[name].values, values):
            raise ValueError(
                f"{owner}: the spectrum to resume has other values of {name}; repeat the interrupted call "
                "with the same arguments"
            )
    for name, value in attributes.items():
        attribute = spectrum.attrs.get(name)
        if attribute != value:
            raise ValueError(
                f"{owner}: the spectrum to resume was computed with {name} = {attribute!r}, not {value!r}; "
                "repeat the interrupted call with the same arguments"
            )


def check_resumed_parameters(owner: str, spectrum: xarray.Dataset, sensitivities: Sequence[str]) -> None:
    """Raise `ValueError` unless a spectrum to resume has sensitivities to exactly these parameters."""
    if (list(spectrum["parameter"].values) if "parameter" in spectrum.coords else []) != list(sensitivities):
        raise ValueError(
            f"{owner}: the spectrum to resume has other sensitivities; repeat the interrupted call with the "
            "same arguments"
        )


def _dataset(podium: Podium, pulse, axes, a_p, T_p, peaks: Peak, options: Options) -> xarray.Dataset:
    """Return the spectrum of one podium.

    - `podium`, `pulse`, `options`: as for `rocking_spectrum`
    - `axes`: dimensionless axes by name
    - `a_p`, `T_p`: the same axes with dimensions [m/s²], [s]
    - `peaks`: peak responses, shape (accelerations, frequencies)
    """
    import xarray

    dims = ("acceleration_ratio", "frequency_ratio")
    dataset = xarray.Dataset(
        data_variables(peaks, options.outputs, dims),
        coords={
            **parameter_axis(peaks.sensitivities),
            **{name: (name, axes[name], variable_attributes(name)) for name in reversed(dims)},
            "T_p": ("frequency_ratio", T_p, variable_attributes("T_p")),
            "a_p": ("acceleration_ratio", a_p, variable_attributes("a_p")),
        },
    )
    if "least_axial_force" in dataset:
        long_name = "axial force of the mean column at rest N/(m_c g)"
        dataset.coords["dead_load"] = as_variable(JOINTS, np.asarray(podium.dead_load), "1", long_name)
    dataset.attrs = _attributes(podium, pulse, options)
    return dataset


def _attributes(podium: Podium, pulse, options: Options) -> dict[str, Any]:
    return {"title": "Rocking spectrum", "kind": "rocking-spectrum", **describe(podium, pulse, options)}


def minimum_overturning(dataset: xarray.Dataset) -> xarray.DataArray:
    """Return the least overturning acceleration ratio of a rocking spectrum at each frequency.

    The ratio is NaN where no ratio of the grid overturns. Raises `ValueError` if `dataset` is not a rocking
    spectrum.
    """
    if getattr(dataset, "attrs", {}).get("kind") != "rocking-spectrum":
        raise ValueError(
            "minimum_overturning: dataset must come from rockjax.rocking_spectrum, got "
            f"{format_value(dataset)}"
        )
    ratio = dataset["acceleration_ratio"].where(dataset["overturned"])
    least = ratio.min("acceleration_ratio")
    least.attrs = {"units": "1", "long_name": "minimum overturning a_p/(g tan α), read off the grid"}
    return least
