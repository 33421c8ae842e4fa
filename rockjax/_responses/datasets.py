"""Attributes of result files: parameters, tolerances and versions."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import jax
import numpy as np

from rockjax import _version
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import GroundMotion
from rockjax._files import CONVENTIONS
from rockjax._motions.provenance import describe_record
from rockjax._motions.record import Record
from rockjax._options import Options
from rockjax._parameters import variants
from rockjax._parameters.table import attribute_name, motion_parameter
from rockjax._programs.program import ARRAYS, KeptProgram
from rockjax._restrainers import KINDS
from rockjax._restrainers.base import AbstractRestrainer
from rockjax._structures import (
    SUPERSTRUCTURES,
    AbstractSuperstructure,
    Elastic,
    Elevation,
    GivenRestitution,
    Podium,
    Rigid,
    ShearBuilding,
    g_tan_alpha,
)


@KeptProgram
def _derive(podium: Podium) -> dict[str, Any]:
    return {
        "restitution_factor": podium.restitution_factor,
        "p_rad_s": podium.p,
        "uplift_demand_m_s2": podium.uplift_demand,
        "uplift_ground_acceleration_m_s2": podium.uplift_ground_acceleration,
        "g_tan_alpha_m_s2": g_tan_alpha(podium.alpha, podium.g),
    }


def derived_numbers(podium: Podium) -> dict[str, float]:
    """Return derived numbers of a podium, computed in one small program."""
    return {name: float(value) for name, value in _derive(podium).items()}


def describe(podium: Podium, pulse, options: Options) -> dict[str, Any]:
    """Return the parameters of a spectrum as attributes of a file."""
    return {
        "pulse": getattr(pulse, "__name__", repr(pulse)),
        **describe_podium(podium),
        **describe_options(options),
    }


def describe_podium(podium: Podium) -> dict[str, Any]:
    """Return the parameters of a podium, for the attributes of a file."""
    top = podium.superstructure
    law, derived = podium.restitution, derived_numbers(podium)
    parameters = [parameter for parameter in variants.parameters_of(podium).values() if parameter.place]
    return {
        **{
            attribute_name(parameter): float(variants.read(podium, parameter.name))
            for parameter in parameters
        },
        **_described(top),
        **({"T_s_s": 0.0} if isinstance(top, Rigid) else {}),
        **({} if isinstance(law, GivenRestitution) else {"restitution": repr(law).strip("'")}),
        **({"restrainers": _as_text(podium.restrainers)} if podium.restrainers else {}),
        **({"elevation": _numbers(podium.elevation)} if isinstance(podium.elevation, Elevation) else {}),
        **derived,
    }


def _described(top: AbstractSuperstructure | None) -> dict[str, Any]:
    """Return the kind of a superstructure, and its arrays."""
    about: dict[str, Any] = {"superstructure": "none" if top is None else type(top).__name__.lower()}
    if top is None or not top.rows:
        return about
    about["eta"] = float(top.mass_ratio)
    if isinstance(top, ShearBuilding):
        about["stories"] = top.stories
    if top.oscillators is not None:
        about["T_s_s"] = float(np.max(np.asarray(top.oscillators.T_s)))  # the longest
    return about | {"superstructure_numbers": _numbers(top)}


def _numbers(part: AbstractSuperstructure | Elevation) -> str:
    """Return the fields of a part of the structure as JSON, for an attribute of a file."""
    numbers = {field.name: getattr(part, field.name) for field in dataclasses.fields(part)}
    plain = {
        name: y if isinstance(y, int) or y is None else np.asarray(y).tolist() for name, y in numbers.items()
    }
    return json.dumps(plain)


def _as_text(restrainers: Sequence[AbstractRestrainer]) -> str:
    """Return restrainers as JSON, for an attribute of a file."""
    numbers = [
        {field.name: getattr(each, field.name) for field in dataclasses.fields(each)} for each in restrainers
    ]
    return json.dumps(
        [
            {"kind": type(each).__name__}
            | {name: y if isinstance(y, int) else float(y) for name, y in own.items()}
            for each, own in zip(restrainers, numbers, strict=True)
        ]
    )


def _of_text(text: str) -> tuple[AbstractRestrainer, ...]:
    rows = json.loads(text)
    return tuple(KINDS[row["kind"]](**{name: y for name, y in row.items() if name != "kind"}) for row in rows)


def podium_of(attributes: Mapping[str, Any]) -> Podium:
    """Return the podium from the attributes that `describe_podium` returned."""
    kinds = {
        "none": lambda: None,
        "rigid": lambda: Rigid(attributes["eta"]),
        "elastic": lambda: Elastic(attributes["eta"], attributes["T_s_s"], attributes["zeta"]),
    }
    kinds |= {
        name.lower(): lambda kind=kind: kind(**json.loads(attributes["superstructure_numbers"]))
        for name, kind in SUPERSTRUCTURES.items()
        if kind.rows
    }
    elevation = attributes.get("elevation")
    return Podium(
        alpha=attributes["alpha_rad"],
        R=attributes["R_m"],
        gamma=attributes["gamma"],
        superstructure=kinds[attributes["superstructure"]](),
        lam=attributes["lambda"],
        restitution=attributes["restitution"],
        g=attributes["g_m_s2"],
        restrainers=_of_text(attributes.get("restrainers", "[]")),
        elevation=Elevation(**json.loads(elevation)) if elevation else None,
    )


def describe_excitation(excitation: AbstractExcitation) -> dict[str, Any]:
    """Return name and numbers of a ground motion, for the attributes of a file; arrays are left out."""
    if isinstance(excitation, GroundMotion):
        vertical = {f"vertical_{name}": y for name, y in describe_excitation(excitation.vertical).items()}
        return describe_excitation(excitation.horizontal) | vertical
    numbers = {field.name: getattr(excitation, field.name) for field in dataclasses.fields(excitation)}
    samples = describe_record(excitation) if isinstance(excitation, Record) else {}
    return {"pulse": type(excitation).__name__, **samples} | {
        _of_motion(name): float(y) for name, y in numbers.items() if isinstance(y, ARRAYS) and y.ndim == 0
    }


def _of_motion(name: str) -> str:
    named = attribute_name(motion_parameter(name))
    return f"pulse_{name}" if named == name else named  # a ratio could be of the podium


def describe_options(options: Options) -> dict[str, Any]:
    """Return tolerances, method and versions, for the attributes of a file."""
    return {
        "method": options.method if isinstance(options.method, str) else type(options.method).__name__,
        "rtol": float(options.rtol),
        "atol": float(options.atol),
        "overturn_ratio": float(options.overturn_ratio),
        **describe_versions(),
        "Conventions": CONVENTIONS,
    }


def describe_versions() -> dict[str, str]:
    """Return the versions that computed a result as attributes of a file."""
    # The metadata of the package, because Diffrax itself is slow to import.
    return {
        "rockjax_version": _version.__version__,
        "jax_version": jax.__version__,
        "diffrax_version": version("diffrax"),
    }
