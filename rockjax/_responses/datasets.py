"""Results as data: what a file of results says of itself, and peaks and histories as datasets."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from rockjax import _results as results
from rockjax._excitations.base import AbstractExcitation
from rockjax._options import OUTPUTS, Options
from rockjax._results import AbstractPeak
from rockjax._structures import Elastic, GivenRestitution, Podium, Rigid

if TYPE_CHECKING:
    import xarray

    from .response import Energies, Response

# name: (field of `Peak`, unit, description, output it belongs to)
VARIABLES = {
    "peak_rotation": ("1", "peak rotation max|θ|/α", "peak_rotation"),
    "peak_rotation_time": ("s", "time of the peak rotation", "peak_rotation"),
    "exceeded_alpha": ("1", "rotation reached α", None),
    "overturned": ("1", "rotation reached overturn_ratio α", None),
    "overturn_time": ("s", "time of overturning", None),
    "uplifted": ("1", "columns left full contact", None),
    "uplift_time": ("s", "time of the first uplift", None),
    "impacts": ("1", "impacts until the scene ended", None),
    "peak_deformation": ("m", "peak deformation of the superstructure max|u_t − u_b|", "peak_deformation"),
    "peak_shear": ("1", "peak shear of the superstructure over its weight max|V_s|/(m_t g)", "peak_shear"),
    "margin": ("1", "overturning margin", "margin"),
    "smallest_impact_speed": ("rad s-1", "least |θ̇| at an impact before the peak rotation", None),
}


@jax.jit
def _derive(podium: Podium) -> dict[str, Any]:
    return {
        "restitution_factor": podium.restitution_factor,
        "p_rad_s": podium.p,
        "uplift_acceleration_m_s2": podium.uplift_acceleration,
        "g_tan_alpha": podium.g * jnp.tan(podium.alpha),
    }


def derived_numbers(podium: Podium) -> dict[str, float]:
    """Derived numbers of a podium, in one small program."""
    return {name: float(value) for name, value in _derive(podium).items()}


def describe(podium: Podium, pulse, options: Options) -> dict[str, Any]:
    """What a spectrum is of, for the attributes of a file."""
    return {"pulse": getattr(pulse, "__name__", repr(pulse)), **describe_podium(podium), **describe_options(options)}


def peak_variables(peaks: AbstractPeak, outputs: Sequence[str]) -> Iterator[tuple[str, np.ndarray, dict[str, Any]]]:
    """(name, values, attributes) of the scalars of a peak or a batch of them, those that the outputs ask for."""
    for name, (unit, description, output) in VARIABLES.items():
        if output is None or output in outputs:
            yield name, np.asarray(getattr(peaks, name)), {"units": unit, "long_name": description}
    if peaks.errors is not None:
        for name in ("peak_rotation", "peak_deformation", "peak_shear"):
            unit, description, output = VARIABLES[name]
            if output in outputs:
                error = np.asarray(getattr(peaks.errors, name))
                yield f"{name}_error", error, {"units": unit, "long_name": f"estimated error of the {description}"}
        flags = {"units": "1", "long_name": "the class is open within ten times the estimated error"}
        yield "undecided", np.asarray(peaks.errors.undecided), flags
    code = np.asarray(results.code_of(peaks.result), np.int8)
    flags = {"flag_values": np.arange(len(results.NAMES), dtype=np.int8), "flag_meanings": " ".join(results.NAMES)}
    yield "result", code, {"units": "1", "long_name": "how the scene ended", **flags}
    yield "steps", np.asarray(peaks.stats.steps + peaks.stats.rejected), {"units": "1", "long_name": "trial steps"}


def describe_podium(podium: Podium) -> dict[str, Any]:
    """The parameters of a podium, for the attributes of a file."""
    top = podium.superstructure
    law, derived = podium.restitution, derived_numbers(podium)
    return {
        "alpha_rad": float(podium.alpha),
        "R_m": float(podium.R),
        "gamma": float(podium.gamma),
        "superstructure": "none" if top is None else type(top).__name__.lower(),
        **({} if top is None else {"eta": float(top.eta)}),
        **({"T_s_s": float(top.T_s), "zeta": float(top.zeta)} if isinstance(top, Elastic) else {}),
        **({"T_s_s": 0.0} if isinstance(top, Rigid) else {}),
        "lambda": float(podium.lam),
        "restitution": float(law.e) if isinstance(law, GivenRestitution) else repr(law).strip("'"),
        "g_m_s2": float(podium.g),
        **{name: derived[name] for name in ("restitution_factor", "p_rad_s", "uplift_acceleration_m_s2")},
    }


def podium_of(attributes: Mapping[str, Any]) -> Podium:
    """The podium that `describe_podium` described."""
    kinds = {
        "none": lambda: None,
        "rigid": lambda: Rigid(attributes["eta"]),
        "elastic": lambda: Elastic(attributes["eta"], attributes["T_s_s"], attributes["zeta"]),
    }
    return Podium(
        alpha=attributes["alpha_rad"],
        R=attributes["R_m"],
        gamma=attributes["gamma"],
        superstructure=kinds[attributes["superstructure"]](),
        lam=attributes["lambda"],
        restitution=attributes["restitution"],
        g=attributes["g_m_s2"],
    )


def describe_excitation(excitation: AbstractExcitation) -> dict[str, Any]:
    """Name and numbers of a ground motion, for the attributes of a file; arrays are left out."""
    names = {"a_p": "a_p_m_s2", "A": "A_m_s2", "T_p": "T_p_s", "f_p": "f_p_Hz", "dt": "dt_s", "t_start": "t_start_s"}
    numbers = {field.name: getattr(excitation, field.name) for field in dataclasses.fields(excitation)}
    return {"pulse": type(excitation).__name__} | {
        names.get(name, f"pulse_{name}"): float(y) for name, y in numbers.items() if isinstance(y, jax.Array) and y.ndim == 0
    }


def describe_options(options: Options) -> dict[str, Any]:
    """Tolerances, method and versions, for the attributes of a file."""
    return {
        "method": options.method if isinstance(options.method, str) else type(options.method).__name__,
        "rtol": float(options.rtol),
        "atol": float(options.atol),
        "overturn_ratio": float(options.overturn_ratio),
        **describe_versions(),
    }


def describe_versions() -> dict[str, str]:
    """What the numbers were made with, for the attributes of a file."""
    from rockjax import __version__

    # Diffrax itself takes long to import.
    return {"rockjax_version": __version__, "jax_version": jax.__version__, "diffrax_version": version("diffrax")}


def peaks(peak: AbstractPeak) -> xarray.Dataset:
    """The scalars of one scene, or of a batch with the dims `scene_0`, `scene_1`, …"""
    import xarray

    dims = tuple(f"scene_{k}" for k in range(np.ndim(peak.peak_rotation)))
    data = xarray.Dataset({name: (dims, values, attrs) for name, values, attrs in peak_variables(peak, OUTPUTS)})
    data.attrs = {"title": "Peak responses", "kind": "peaks", **describe_versions()}
    return data


# name: (unit, description)
_SERIES = {
    "theta": ("rad", "rotation of the columns θ"),
    "theta_dot": ("rad s-1", "rate of rotation"),
    "u_t": ("m", "displacement of the top mass relative to the ground u_t"),
    "u_t_dot": ("m s-1", "velocity of the top mass relative to the ground"),
    "deformation": ("m", "deformation of the superstructure u_t − u_b"),
    "ground_acceleration": ("m s-2", "ground acceleration ü_g"),
    "restoring_moment": ("1", "restoring moment over its value at uplift"),
    "mode": ("1", "full contact (0) or rocking to the side of the sign"),
    "mechanical_energy": ("m2 s-2", "mechanical energy relative to the ground per N m_c"),
    "input_energy": ("m2 s-2", "work of the ground since the start per N m_c"),
    "impact_energy": ("m2 s-2", "energy lost at the impacts since the start per N m_c"),
    "damping_energy": ("m2 s-2", "energy lost in the damper since the start per N m_c"),
}

_IMPACTS = {
    "impact_times": ("s", "times of the impacts"),
    "theta_dot_before": ("rad s-1", "rate of rotation before the impact"),
    "theta_dot_after": ("rad s-1", "rate of rotation after the impact"),
}


def history(
    response: Response, t: np.ndarray, samples: Mapping[str, Any], energies: Energies, impacts: Mapping[str, Any]
) -> xarray.Dataset:
    """The dataset of `Response.dataset`, from what was computed at times t."""
    import xarray

    values = dict(samples) | {
        "ground_acceleration": response.excitation(t),
        "mechanical_energy": energies.mechanical,
        "input_energy": energies.input,
        "impact_energy": energies.impacts,
        "damping_energy": energies.damping,
    }
    data = xarray.Dataset(
        {
            name: ("time", np.asarray(values[name]), {"units": unit, "long_name": description})
            for name, (unit, description) in _SERIES.items()
        },
        coords={"time": ("time", t, {"units": "s", "long_name": "time"})},
    )
    data["mode"].attrs |= {"flag_values": [-1.0, 0.0, 1.0], "flag_meanings": "rocking_left full_contact rocking_right"}
    for name, (unit, description) in _IMPACTS.items():
        data[name] = ("impact", np.asarray(impacts[name]), {"units": unit, "long_name": description})
    unit = {"units": "m2 s-2", "long_name": "mechanical energy at the start per N m_c"}
    data["initial_energy"] = ((), np.asarray(energies.initial), unit)
    for name, scalar, attrs in peak_variables(response, response.options.outputs):
        data[name] = ((), scalar, attrs)
    data.attrs = {"title": "Response history", "kind": "response", **describe_excitation(response.excitation)}
    data.attrs |= describe_podium(response.podium) | describe_options(response.options)
    return data
