"""Rocking podium structures: simulation of uplift, rocking and impacts in JAX, with exact derivatives."""

import os as _os
import sys as _sys
from importlib import import_module as _import_module
from importlib.metadata import version as _installed
from typing import TYPE_CHECKING, Any

from ._version import __version__ as __version__

if TYPE_CHECKING:
    from ._batch.batch import peak_responses
    from ._boundaries.boundary import (
        Boundary,
        overturning_acceleration,
        overturning_boundary,
        overturning_scale,
    )
    from ._excitations.base import AbstractExcitation, AbstractLookahead, Rest
    from ._excitations.pulses import AbstractPulse, AntisymmetricRicker, HalfSine, OneCosine, OneSine, Ricker
    from ._excitations.wavelets import Gabor, MavroeidisPapageorgiou
    from ._motions.accelerogram import RecordWarning
    from ._motions.measures import intensity_measures
    from ._motions.motion import Motion, Motions
    from ._motions.readers import read_motion, read_suite
    from ._motions.record import Record
    from ._motions.records import Records
    from ._motions.synthetic import synthetic_motions
    from ._options import Options
    from ._plausibility import PlausibilityWarning
    from ._responses.history import Energies
    from ._responses.peak import Peak
    from ._responses.response import Response
    from ._responses.sensitivities import Sensitivities
    from ._responses.simulate import peak_response, simulate
    from ._restrainers.damper import Damper
    from ._restrainers.inerter import Inerter
    from ._restrainers.tendon import Tendon
    from ._results import RESULTS, Errors, Interrupted, State, Stats
    from ._risk.annual import AnnualFrequency, annual_frequency, disaggregation
    from ._risk.files import read_fragility_model, write_fragility_model
    from ._risk.gaussian import Envelope, GaussianMotion, RandomPulse
    from ._risk.hazard import Hazard
    from ._risk.reliability import FailureProbability, reliability
    from ._risk.rocking import DesignPoint, design_points, failure_probability
    from ._structures import Elastic, Podium, Rigid
    from ._studies.curve import fragility
    from ._studies.fragility import Measure, incremental_dynamic_analysis, overturning_distribution
    from ._studies.lognormal import Lognormal
    from ._studies.overturning_spectrum import overturning_spectrum
    from ._studies.spectra import minimum_overturning, rocking_spectra, rocking_spectrum
    from ._sweep.grid import Grid, grid
    from ._sweep.sweep import SweepPlan, sweep


__all__ = [
    "RESULTS",
    "AbstractExcitation",
    "AbstractLookahead",
    "AbstractPulse",
    "AnnualFrequency",
    "AntisymmetricRicker",
    "Boundary",
    "Damper",
    "DesignPoint",
    "Elastic",
    "Energies",
    "Envelope",
    "Errors",
    "FailureProbability",
    "Gabor",
    "GaussianMotion",
    "Grid",
    "HalfSine",
    "Hazard",
    "Inerter",
    "Interrupted",
    "Lognormal",
    "MavroeidisPapageorgiou",
    "Measure",
    "Motion",
    "Motions",
    "OneCosine",
    "OneSine",
    "Options",
    "Peak",
    "PlausibilityWarning",
    "Podium",
    "RandomPulse",
    "Record",
    "RecordWarning",
    "Records",
    "Response",
    "Rest",
    "Ricker",
    "Rigid",
    "Sensitivities",
    "State",
    "Stats",
    "SweepPlan",
    "Tendon",
    "annual_frequency",
    "design_points",
    "disaggregation",
    "failure_probability",
    "fragility",
    "grid",
    "incremental_dynamic_analysis",
    "intensity_measures",
    "minimum_overturning",
    "overturning_acceleration",
    "overturning_boundary",
    "overturning_distribution",
    "overturning_scale",
    "overturning_spectrum",
    "peak_response",
    "peak_responses",
    "read_fragility_model",
    "read_motion",
    "read_suite",
    "reliability",
    "rocking_spectra",
    "rocking_spectrum",
    "simulate",
    "sweep",
    "synthetic_motions",
    "write_fragility_model",
]

# Where everything is: imported when it is first asked for.
_MODULES = {
    "_batch.batch": ("peak_responses",),
    "_boundaries.boundary": (
        "Boundary",
        "overturning_acceleration",
        "overturning_boundary",
        "overturning_scale",
    ),
    "_excitations.base": (
        "AbstractExcitation",
        "AbstractLookahead",
        "Rest",
    ),
    "_excitations.pulses": (
        "AbstractPulse",
        "AntisymmetricRicker",
        "HalfSine",
        "OneCosine",
        "OneSine",
        "Ricker",
    ),
    "_excitations.wavelets": (
        "Gabor",
        "MavroeidisPapageorgiou",
    ),
    "_motions.measures": ("intensity_measures",),
    "_motions.accelerogram": ("RecordWarning",),
    "_motions.motion": (
        "Motion",
        "Motions",
    ),
    "_motions.readers": (
        "read_motion",
        "read_suite",
    ),
    "_motions.record": ("Record",),
    "_motions.records": ("Records",),
    "_motions.synthetic": ("synthetic_motions",),
    "_options": ("Options",),
    "_plausibility": ("PlausibilityWarning",),
    "_responses.history": ("Energies",),
    "_responses.peak": ("Peak",),
    "_responses.response": ("Response",),
    "_responses.sensitivities": ("Sensitivities",),
    "_responses.simulate": (
        "peak_response",
        "simulate",
    ),
    "_results": (
        "RESULTS",
        "Errors",
        "Interrupted",
        "State",
        "Stats",
    ),
    "_restrainers.damper": ("Damper",),
    "_restrainers.inerter": ("Inerter",),
    "_restrainers.tendon": ("Tendon",),
    "_risk.annual": (
        "AnnualFrequency",
        "annual_frequency",
        "disaggregation",
    ),
    "_risk.files": (
        "read_fragility_model",
        "write_fragility_model",
    ),
    "_risk.gaussian": (
        "Envelope",
        "GaussianMotion",
        "RandomPulse",
    ),
    "_risk.hazard": ("Hazard",),
    "_risk.reliability": (
        "FailureProbability",
        "reliability",
    ),
    "_risk.rocking": (
        "DesignPoint",
        "design_points",
        "failure_probability",
    ),
    "_structures": (
        "Elastic",
        "Podium",
        "Rigid",
    ),
    "_studies.curve": ("fragility",),
    "_studies.fragility": (
        "Measure",
        "incremental_dynamic_analysis",
        "overturning_distribution",
    ),
    "_studies.lognormal": ("Lognormal",),
    "_studies.overturning_spectrum": ("overturning_spectrum",),
    "_studies.spectra": (
        "minimum_overturning",
        "rocking_spectra",
        "rocking_spectrum",
    ),
    "_sweep.grid": (
        "Grid",
        "grid",
    ),
    "_sweep.sweep": (
        "SweepPlan",
        "sweep",
    ),
}
_WHERE = {name: module for module, names in _MODULES.items() for name in names}


_RENAMED = {"AbstractOutlook": "AbstractLookahead"}


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        import warnings

        new = _RENAMED[name]
        warnings.warn(f"rockjax.{name} is called rockjax.{new} now", DeprecationWarning, stacklevel=2)
        return __getattr__(new)
    if name not in _WHERE:
        raise AttributeError(f"module 'rockjax' has no attribute {name!r}")
    value = getattr(_import_module(f".{_WHERE[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _is_command() -> bool:
    """Whether this process is the command line, `rockjax …` or `python -m rockjax …`: its help needs no
    JAX."""
    if _sys.argv[:1] == ["-m"]:
        return ("-m", "rockjax") in zip(_sys.orig_argv, _sys.orig_argv[1:], strict=False)
    return _os.path.basename(_sys.argv[0] if _sys.argv else "") in ("rockjax", "rockjax.exe")


if _installed("jaxlib").startswith("0.10.") and "xla_disable_hlo_passes" not in _os.environ.get(
    "XLA_FLAGS", ""
):
    # These expand the barriers between Runge–Kutta stages too early, and then compute every stage many times
    # over.
    _flag = "--xla_disable_hlo_passes=cse_barrier_expander"
    _os.environ["XLA_FLAGS"] = f"{_os.environ.get('XLA_FLAGS', '')} {_flag}".strip()

# Rocking is chaotic enough without rounding at 1e-7: float64 unless the user's environment says otherwise.
if _is_command():
    _os.environ.setdefault(
        "JAX_ENABLE_X64", "1"
    )  # for JAX when it is imported, and for the processes of a sweep
else:
    import jax as _jax

    if "JAX_ENABLE_X64" not in _os.environ:
        _jax.config.update("jax_enable_x64", True)
    for _module in ("_responses.simulate", "_batch.batch"):  # what nearly everybody needs
        _import_module(f".{_module}", __name__)
