"""Rocking podium structures: simulation of uplift, rocking and impacts in JAX, with exact derivatives."""

import os as _os
from importlib.metadata import version as _version

if _version("jaxlib").startswith("0.10."):
    # These expand the barriers between Runge–Kutta stages too early, and then compute every stage many times over.
    _flag = "--xla_disable_hlo_passes=cse_barrier_expander"
    if "xla_disable_hlo_passes" not in _os.environ.get("XLA_FLAGS", ""):
        _os.environ["XLA_FLAGS"] = f"{_os.environ.get('XLA_FLAGS', '')} {_flag}".strip()

import jax as _jax

# Rocking is chaotic enough without rounding at 1e-7: float64 unless the user's environment says otherwise.
if "JAX_ENABLE_X64" not in _os.environ:
    _jax.config.update("jax_enable_x64", True)

from ._batch import peak_responses
from ._excitations import AbstractExcitation, AbstractOutlook, Rest
from ._fragility import Measure, fragility, incremental_dynamic_analysis, overturning_distribution
from ._grid import Grid, grid
from ._intensity import intensity_measures
from ._lognormal import Lognormal
from ._motions import Motion, Motions, RecordWarning
from ._options import Options
from ._overturning import Boundary, overturning_acceleration, overturning_boundary, overturning_scale
from ._overturning_spectrum import overturning_spectrum
from ._pulses import AbstractPulse, AntisymmetricRicker, HalfSine, OneCosine, OneSine, Ricker
from ._readers import read_motion, read_suite
from ._record import Record
from ._records import Records
from ._response import Energies, Response
from ._results import RESULTS, Errors, Interrupted, Peak, State, Stats
from ._risk.annual import AnnualFrequency, annual_frequency, disaggregation
from ._risk.files import read_fragility_model, write_fragility_model
from ._risk.gaussian import Envelope, GaussianMotion, RandomPulse
from ._risk.hazard import Hazard
from ._simulate import peak_response, simulate
from ._spectra import minimum_overturning, rocking_spectra, rocking_spectrum
from ._structures import Elastic, Podium, Rigid
from ._sweep import SweepPlan, sweep
from ._synthetic import synthetic_motions
from ._wavelets import Gabor, MavroeidisPapageorgiou

__version__ = "0.1.0"

__all__ = [
    "RESULTS",
    "AbstractExcitation",
    "AbstractOutlook",
    "AbstractPulse",
    "AnnualFrequency",
    "AntisymmetricRicker",
    "Boundary",
    "Elastic",
    "Energies",
    "Envelope",
    "Errors",
    "Gabor",
    "GaussianMotion",
    "Grid",
    "HalfSine",
    "Hazard",
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
    "Podium",
    "RandomPulse",
    "Record",
    "RecordWarning",
    "Records",
    "Response",
    "Rest",
    "Ricker",
    "Rigid",
    "State",
    "Stats",
    "SweepPlan",
    "annual_frequency",
    "disaggregation",
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
    "rocking_spectra",
    "rocking_spectrum",
    "simulate",
    "sweep",
    "synthetic_motions",
    "write_fragility_model",
]
