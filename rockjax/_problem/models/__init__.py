"""Models of problem files: type, range and description of each key.

A model is a pydantic class with a field for each key of a table. The keys of parameters, such as `gamma`, are
generated from `_parameters/registry.py`. Error messages, the JSON schema, the page on problem files and the
options of the command line are generated from the models. This package does not import JAX.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field

from .fields import ACCURACY, STRUCTURE, Count, Index, Keys, Name, Positive, Source, key
from .fields import GRID as GRID
from .fields import MACHINES as MACHINES
from .fields import MOTION as MOTION
from .fields import OUTPUT as OUTPUT
from .fields import Bounds as Bounds
from .fields import Flag as Flag
from .fields import Periods as Periods
from .fields import PulseName as PulseName
from .fields import Text as Text
from .fields import described_as as described_as
from .fields import require_one as require_one
from .grids import Ensemble, Sweep
from .grids import LognormalSpread as LognormalSpread
from .grids import Normal as Normal
from .grids import Uniform as Uniform
from .motions import Measures as Measures
from .motions import MotionSet
from .motions import Pulses as Pulses
from .motions import Record as Record
from .motions import Suite as Suite
from .motions import Synthetic as Synthetic
from .reports import GaussianKeys as GaussianKeys
from .reports import JointKeys, Project, ReportKeys
from .structures import Building as Building
from .structures import ByDimensions as ByDimensions
from .structures import ByRatios as ByRatios
from .structures import Contents, Oscillator, Structure
from .structures import Elevation as Elevation
from .structures import ModesOfSuperstructure as ModesOfSuperstructure
from .structures import Superstructure as Superstructure
from .studies import FRICTION, Floors, Fragility, Options, Overturning, Peaks, Response, Risk, Spectrum


class Problem(Keys):
    """A problem file: tables that several commands share, and a table for each command."""

    structure: Structure | None = key(None, "The structure, by ratios or by dimensions.")
    motions: dict[Name, MotionSet] = key({}, "Sets of motions, by names that you choose.")
    contents: list[Contents] = key([], "Blocks on the floors, for response, fragility and design.")
    oscillators: list[Oscillator] = key([], "Oscillators on the floors, for response and design.")
    options: Options = Field(default_factory=Options)
    response: Response = Field(default_factory=Response)
    peaks: Peaks = Field(default_factory=Peaks)
    floors: Floors = Field(default_factory=Floors)
    spectrum: Spectrum = Field(default_factory=Spectrum)
    overturning: Overturning = Field(default_factory=Overturning)
    fragility: Fragility = Field(default_factory=Fragility)
    risk: Risk = Field(default_factory=Risk)
    sweep: Sweep = Field(default_factory=Sweep)
    ensemble: Ensemble = Field(default_factory=Ensemble)

    project: Project = Field(default_factory=Project)
    joints: JointKeys = Field(default_factory=JointKeys)
    report: ReportKeys = Field(default_factory=ReportKeys)
    sources: dict[str, Source] = key({}, "Where inputs come from: key of this file → source, for the report.")
    checks: Any = key(None, "Checks of the report.")
    # Keys of `rockjax design`. The package `optimise` has models that check their contents.
    starts: Count | None = key(None, "Number of starting points; by default 1.", ACCURACY)
    seed: Index | None = key(None, "Seed of the starting points; by default 0.", ACCURACY)
    tolerance: Positive | None = key(None, "Tolerance of the optimality conditions [–].")
    max_iterations: Count | None = key(None, "Maximum number of iterations of a start.")
    friction: Positive | None = key(None, FRICTION, STRUCTURE)
    vary: Any = key(None, "Design variables.")
    minimise: Any = key(None, "Objective.")
    targets: Any = key(None, "Conditions that the design must satisfy.")
