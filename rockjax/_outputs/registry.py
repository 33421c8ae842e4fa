"""The registry of outputs by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .axial_force import AxialForce
from .base import AbstractOutput, Variable
from .deck_acceleration import PeakDeckAcceleration
from .deformation import PeakDeformation
from .drift import PeakDrift
from .floor_acceleration import PeakFloorAcceleration
from .foundation_shear import PeakFoundationShear
from .friction import PeakFriction
from .impact_friction import ImpactFriction
from .impacts import EnergeticImpacts, Impacts
from .impacts_before_peak import ImpactsBeforePeak
from .margin import Margin
from .rotation import PeakRotation
from .shear import PeakShear
from .velocity_jump import PeakVelocityJump

if TYPE_CHECKING:
    from rockjax._structures import Podium

REGISTRY: dict[str, AbstractOutput] = {
    output.name: output
    for output in (
        PeakRotation(),
        PeakDeformation(),
        PeakShear(),
        PeakDrift(),
        PeakFloorAcceleration(),
        Impacts(),
        Margin(),
        PeakFriction(),
        AxialForce(),
        PeakFoundationShear(),
        ImpactFriction(),
        PeakDeckAcceleration(),
        PeakVelocityJump(),
        ImpactsBeforePeak(),
        EnergeticImpacts(),
    )
}

BUILDING_OUTPUTS = ("peak_shear", "peak_drift", "peak_floor_acceleration", "peak_velocity_jump")
JOINT_OUTPUTS = ("peak_friction", "axial_force", "impact_friction", "peak_foundation_shear")

# All answers by name, each with its properties and the name of the output that computes it.
VARIABLES: dict[str, tuple[Variable, str]] = {
    variable.name: (variable, name) for name, output in REGISTRY.items() for variable in output.variables
}


def variables_of(outputs) -> dict[str, tuple[Variable, str]]:
    """Return the answers of outputs by name, in the form of `VARIABLES`.

    - `outputs`: names in the registry, or instances of outputs
    """
    instances = [REGISTRY[y] if isinstance(y, str) else y for y in outputs]
    return {variable.name: (variable, output.name) for output in instances for variable in output.variables}


def suitable_outputs(podium: Podium) -> tuple[str, ...]:
    """Return the names of the outputs that a designer needs for a podium. They always include the rotation,
    the impacts and the estimated errors. A superstructure adds the outputs of `BUILDING_OUTPUTS` that apply
    to it, or its deformation if it is a single oscillator. An elevation adds the forces in the joints."""
    names, top = ["peak_rotation", "impacts", "impacts_before_peak", "errors"], podium.superstructure
    if top is not None:
        names += [name for name in BUILDING_OUTPUTS if REGISTRY[name].applies(podium)]
        names += ["peak_deformation"] if podium.vibrates and not top.has_mode_axis else []
    return (*names, *(JOINT_OUTPUTS if podium.elevation is not None else ()))


def name_if_registered(output: AbstractOutput) -> str | AbstractOutput:
    """Return the name of an output if it is in the registry, else the output itself."""
    return output.name if REGISTRY.get(output.name) == output else output
