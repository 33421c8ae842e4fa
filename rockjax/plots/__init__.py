"""Pictures. Functions that take an `Axes` (or make one) return it, the others a `Figure`; nothing is shown or
saved here.

Figures made here have the style `STYLE`; settings and axes of the user stay as they are.
"""

import matplotlib.pyplot as plt

from ._animation import animation, save_animation
from ._boundaries import (
    overturning_boundaries,
    overturning_curve,
    overturning_curves,
    overturning_spectrum,
    sensitivities,
)
from ._fragility import fragility, incremental_dynamic_analysis
from ._histories import (
    deformation_history,
    energy_balance,
    ground_motion,
    moment_rotation,
    phase_portrait,
    response,
    rotation_history,
)
from ._records import record_spectrum
from ._risk import design_point, risk
from ._sensitivities import sensitivity_spectra, sensitivity_spectrum
from ._spectra import dimensional_axes, rocking_spectrum, rotation_bar, spectra
from ._stories import stories
from ._style import ACCELERATION_RATIO, COLOURS, FREQUENCY_RATIO, ROTATION, STYLE, STYLES

__all__ = [
    "ACCELERATION_RATIO",
    "COLOURS",
    "FREQUENCY_RATIO",
    "ROTATION",
    "STYLE",
    "STYLES",
    "animation",
    "deformation_history",
    "design_point",
    "dimensional_axes",
    "energy_balance",
    "fragility",
    "ground_motion",
    "incremental_dynamic_analysis",
    "moment_rotation",
    "overturning_boundaries",
    "overturning_curve",
    "overturning_curves",
    "overturning_spectrum",
    "phase_portrait",
    "plt",
    "record_spectrum",
    "response",
    "risk",
    "rocking_spectrum",
    "rotation_bar",
    "rotation_history",
    "save_animation",
    "sensitivities",
    "sensitivity_spectra",
    "sensitivity_spectrum",
    "spectra",
    "stories",
]
