"""Structures: the column, the podium, its superstructure and its laws of restitution."""

from rockjax._units import STANDARD_GRAVITY

from .building import ShearBuilding, superstructure_of
from .column import g_tan_alpha, slenderness_and_size
from .contents import Contents, Oscillator
from .dimensions import Dimensions
from .elevation import Elevation
from .modes import Modes
from .podium import Podium
from .restitution import GivenRestitution
from .superstructures import AbstractSuperstructure, Elastic, Rigid

# Classes of superstructures by name. Add new superstructures here.
SUPERSTRUCTURES: dict[str, type[AbstractSuperstructure]] = {
    superstructure.__name__: superstructure for superstructure in (Elastic, Rigid, Modes, ShearBuilding)
}

__all__ = [
    "STANDARD_GRAVITY",
    "SUPERSTRUCTURES",
    "AbstractSuperstructure",
    "Contents",
    "Dimensions",
    "Elastic",
    "Elevation",
    "GivenRestitution",
    "Modes",
    "Oscillator",
    "Podium",
    "Rigid",
    "ShearBuilding",
    "g_tan_alpha",
    "slenderness_and_size",
    "superstructure_of",
]
