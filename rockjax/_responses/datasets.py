"""Attributes of result files: parameters, options and versions.

`podium_of` recreates the podium from the attributes.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from typing import Any

import jax
import numpy as np

from rockjax import _version
from rockjax._excitations.base import AbstractExcitation
from rockjax._excitations.ground import GroundMotion
from rockjax._files import CONVENTIONS
from rockjax._motions.provenance import describe_record, sha256
from rockjax._motions.record import Record
from rockjax._options import Options
from rockjax._parameters import variants
from rockjax._parameters.registry import attribute_name, motion_parameter
from rockjax._programs.program import ARRAYS, StoredProgram
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


@StoredProgram
def _derive(podium: Podium) -> dict[str, Any]:
    return {
        "restitution_factor": podium.restitution_factor,
        "p_rad_s": podium.p,
        "uplift_demand_m_s2": podium.uplift_demand,
        "uplift_ground_acceleration_m_s2": podium.uplift_ground_acceleration,
        "g_tan_alpha_m_s2": g_tan_alpha(podium.alpha, podium.g),
    }


def derived_numbers(podium: Podium) -> dict[str, float]:
    """Compute quantities that follow from the parameters of a podium, for the attributes of a file."""
    return {name: float(value) for name, value in _derive(podium).items()}


def describe(podium: Podium, pulse, options: Options) -> dict[str, Any]:
    """Return the attributes of a file with a spectrum.

    - `podium`, `options`: structure and options of the scenes
    - `pulse`: class of the pulses, or a function (a_p, T_p) ↦ excitation. The attribute `pulse_sha256`, the
      checksum of two excitations, identifies a function; it is left out if the function cannot return them
    """
    return {
        "pulse": getattr(pulse, "__name__", repr(pulse)),
        **({} if isinstance(pulse, type) else _checksum_of_pulse(pulse)),
        **describe_podium(podium),
        **describe_options(options),
    }


def _checksum_of_pulse(pulse: Callable[[Any, Any], AbstractExcitation]) -> dict[str, str]:
    """Return the attribute `pulse_sha256`, the SHA-256 of the excitations of a function (a_p, T_p) ↦
    excitation for two pairs of arguments. Functions of the same name may return different excitations. Return
    no attribute if the function raises an error for these arguments."""
    try:
        leaves, structure = jax.tree.flatten(pulse(np.array([1.0, 2.0]), np.array([1.0, 3.0])))
    except Exception:  # the function may accept only other arguments; answers must not be lost
        return {}
    values = [sha256(y) if isinstance(y, ARRAYS | float | int) else repr(y) for y in leaves]
    # The representation of a function contains its address, which differs between processes.
    text = re.sub(r" at 0x[0-9a-f]+", "", "\n".join([repr(structure), *values]))
    return {"pulse_sha256": hashlib.sha256(text.encode()).hexdigest()}


def describe_podium(podium: Podium) -> dict[str, Any]:
    """Return the parameters of a podium and derived quantities, for the attributes of a file."""
    top = podium.superstructure
    law, derived = podium.restitution, derived_numbers(podium)
    parameters = [
        parameter for parameter in variants.parameters_of(podium).values() if parameter.attribute_path
    ]
    return {
        **{
            attribute_name(parameter): float(variants.read(podium, parameter.name))
            for parameter in parameters
        },
        **_describe_superstructure(top),
        **({"T_s_s": 0.0} if isinstance(top, Rigid) else {}),
        **({} if isinstance(law, GivenRestitution) else {"restitution": repr(law).strip("'")}),
        **({"restrainers": _restrainers_as_json(podium.restrainers)} if podium.restrainers else {}),
        **(
            {"elevation": _fields_as_json(podium.elevation)}
            if isinstance(podium.elevation, Elevation)
            else {}
        ),
        **derived,
    }


def _describe_superstructure(top: AbstractSuperstructure | None) -> dict[str, Any]:
    """Return the attributes of a superstructure: the name of its class, or "none".

    If the fields have an axis of modes or stories, the attributes also contain the mass ratio η and all
    fields as JSON; for a `ShearBuilding` the number of stories; and for a superstructure that vibrates the
    longest period [s].
    """
    attributes: dict[str, Any] = {"superstructure": "none" if top is None else type(top).__name__.lower()}
    if top is None or not top.rows:
        return attributes
    attributes["eta"] = float(top.mass_ratio)
    if isinstance(top, ShearBuilding):
        attributes["stories"] = top.stories
    if top.oscillators is not None:
        attributes["T_s_s"] = float(np.max(np.asarray(top.oscillators.T_s)))
    return attributes | {"superstructure_numbers": _fields_as_json(top)}


def _fields_as_json(structure: AbstractSuperstructure | Elevation) -> str:
    """Return the fields of a superstructure or an elevation as JSON."""
    values = {field.name: getattr(structure, field.name) for field in dataclasses.fields(structure)}
    return json.dumps(
        {name: y if isinstance(y, int) or y is None else np.asarray(y).tolist() for name, y in values.items()}
    )


def _restrainers_as_json(restrainers: Sequence[AbstractRestrainer]) -> str:
    """Return a JSON list with a dict for each restrainer: its fields, and the name of its class as `kind`."""
    rows = []
    for restrainer in restrainers:
        values = {field.name: getattr(restrainer, field.name) for field in dataclasses.fields(restrainer)}
        fields = {name: y if isinstance(y, int) else float(y) for name, y in values.items()}
        rows.append({"kind": type(restrainer).__name__} | fields)
    return json.dumps(rows)


def _restrainers_from_json(text: str) -> tuple[AbstractRestrainer, ...]:
    rows = json.loads(text)
    return tuple(KINDS[row["kind"]](**{name: y for name, y in row.items() if name != "kind"}) for row in rows)


def podium_of(attributes: Mapping[str, Any]) -> Podium:
    """Return the podium from the attributes that `describe_podium` has returned."""
    makers = {
        "none": lambda: None,
        "rigid": lambda: Rigid(attributes["eta"]),
        "elastic": lambda: Elastic(attributes["eta"], attributes["T_s_s"], attributes["zeta"]),
    }
    makers |= {
        name.lower(): lambda cls=cls: cls(**json.loads(attributes["superstructure_numbers"]))
        for name, cls in SUPERSTRUCTURES.items()
        if cls.rows
    }
    elevation = attributes.get("elevation")
    return Podium(
        alpha=attributes["alpha_rad"],
        R=attributes["R_m"],
        gamma=attributes["gamma"],
        superstructure=makers[attributes["superstructure"]](),
        lam=attributes["lambda"],
        restitution=attributes["restitution"],
        g=attributes["g_m_s2"],
        restrainers=_restrainers_from_json(attributes.get("restrainers", "[]")),
        elevation=Elevation(**json.loads(elevation)) if elevation else None,
    )


def describe_excitation(excitation: AbstractExcitation) -> dict[str, Any]:
    """Return the attributes of a ground motion: its class, its scalar parameters and, for a record, further
    properties. Attributes of a vertical component start with `vertical_`."""
    if isinstance(excitation, GroundMotion):
        vertical = {f"vertical_{name}": y for name, y in describe_excitation(excitation.vertical).items()}
        return describe_excitation(excitation.horizontal) | vertical
    values = {field.name: getattr(excitation, field.name) for field in dataclasses.fields(excitation)}
    record_attributes = describe_record(excitation) if isinstance(excitation, Record) else {}
    return {"pulse": type(excitation).__name__, **record_attributes} | {
        _motion_attribute(name): float(y)
        for name, y in values.items()
        if isinstance(y, ARRAYS) and y.ndim == 0
    }


def _motion_attribute(name: str) -> str:
    attribute = attribute_name(motion_parameter(name))
    # A name without a unit gets a prefix, because a parameter of the podium may have the same name.
    return f"pulse_{name}" if attribute == name else attribute


def describe_options(options: Options) -> dict[str, Any]:
    """Return the options that affect the answers, and the versions, for the attributes of a file."""
    rest_velocity = options.rtol if options.rest_velocity is None else options.rest_velocity
    return {
        "engine": options.engine,
        "method": options.method if isinstance(options.method, str) else type(options.method).__name__,
        "rtol": float(options.rtol),
        "atol": float(options.atol),
        "overturn_ratio": float(options.overturn_ratio),
        "rest_velocity": float(rest_velocity),
        "max_steps": options.max_steps,
        "outputs": " ".join(output.name for output in options.requested),
        **describe_versions(),
        "Conventions": CONVENTIONS,
    }


def describe_versions() -> dict[str, str]:
    """Return the versions of rockjax, JAX and Diffrax, for the attributes of a file."""
    # The version of Diffrax comes from the metadata of the package, because importing Diffrax is slow.
    return {
        "rockjax_version": _version.__version__,
        "jax_version": jax.__version__,
        "diffrax_version": version("diffrax"),
    }
