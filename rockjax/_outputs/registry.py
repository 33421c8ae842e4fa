"""The list of outputs. An output is one module of this folder and one line here."""

from __future__ import annotations

from .axial_force import AxialForce
from .base import AbstractOutput, Variable
from .deformation import PeakDeformation
from .drift import PeakDrift
from .floor_acceleration import PeakFloorAcceleration
from .foundation_shear import PeakFoundationShear
from .friction import PeakFriction
from .impact_friction import ImpactFriction
from .impacts import EnergeticImpacts, Impacts
from .margin import Margin
from .rotation import PeakRotation
from .shear import PeakShear

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
        EnergeticImpacts(),
    )
}

# The answers by name, each with its output's name.
VARIABLES: dict[str, tuple[Variable, str]] = {
    each.name: (each, name) for name, output in REGISTRY.items() for each in output.variables
}


def variables_of(outputs) -> dict[str, tuple[Variable, str]]:
    """Return the answers of outputs by name: names of the registry, and outputs of the user's own."""
    listed = [REGISTRY[y] if isinstance(y, str) else y for y in outputs]
    return {each.name: (each, output.name) for output in listed for each in output.variables}


def name_if_registered(output: AbstractOutput) -> str | AbstractOutput:
    """Return the name of an output of the registry, and an output of the user's own as it is."""
    return output.name if REGISTRY.get(output.name) == output else output
