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

from ._batch.batch import peak_responses
from ._boundaries.boundary import Boundary, overturning_acceleration, overturning_boundary, overturning_scale
from ._excitations.base import AbstractExcitation, AbstractOutlook, Rest
from ._excitations.pulses import AbstractPulse, AntisymmetricRicker, HalfSine, OneCosine, OneSine, Ricker
from ._excitations.wavelets import Gabor, MavroeidisPapageorgiou
from ._motions.intensity import intensity_measures
from ._motions.motion import Motion, Motions, RecordWarning
from ._motions.readers import read_motion, read_suite
from ._motions.record import Record
from ._motions.records import Records
from ._motions.synthetic import synthetic_motions
from ._options import Options
from ._responses.response import Energies, Response
from ._responses.simulate import peak_response, simulate
from ._results import RESULTS, Errors, Interrupted, Peak, State, Stats
from ._structures import Elastic, Podium, Rigid
from ._studies.curve import fragility
from ._studies.fragility import Measure, incremental_dynamic_analysis, overturning_distribution
from ._studies.lognormal import Lognormal
from ._studies.overturning_spectrum import overturning_spectrum
from ._studies.spectra import minimum_overturning, rocking_spectra, rocking_spectrum
from ._sweep.grid import Grid, grid
from ._sweep.sweep import SweepPlan, sweep

__version__ = "0.1.0"

__all__ = [
    "RESULTS",
    "AbstractExcitation",
    "AbstractOutlook",
    "AbstractPulse",
    "AntisymmetricRicker",
    "Boundary",
    "Elastic",
    "Energies",
    "Errors",
    "Gabor",
    "Grid",
    "HalfSine",
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
    "read_motion",
    "read_suite",
    "rocking_spectra",
    "rocking_spectrum",
    "simulate",
    "sweep",
    "synthetic_motions",
]
