"""The registry of simplified methods by name."""

from __future__ import annotations

from .asce_rocking import AsceRocking
from .asce_sliding import AsceSliding
from .base import AbstractMethod
from .circolare_displacement import CircolareDisplacement
from .circolare_force import CircolareForce
from .fema import Fema
from .priestley import Priestley
from .spectral_uplift import SpectralUplift
from .static import Static

METHODS: dict[str, AbstractMethod] = {
    method.name: method
    for method in (
        Static(),
        SpectralUplift(),
        Priestley(),
        Fema(),
        AsceRocking(),
        AsceSliding(),
        CircolareDisplacement(),
        CircolareForce(),
    )
}
