"""Arguments of a wrong type for all public functions: the error names the argument and the valid values."""

import datetime
import inspect

import numpy as np
import pytest

import optimise
import rockjax as rj

from .scenes import PODIUMS, pulse, shaking

PODIUM, MOTION = PODIUMS["rigid"], rj.Motion(np.array([0.0, 1.0, -1.0, 0.0]), 0.1)
BOX = {"alpha": (0.1, 0.3)}
# The other arguments of each function. Arguments that accept anything, or that Python checks, are not tested.
VALID = {
    rj.Podium: {"alpha": 0.2, "R": 1.0},
    rj.Podium.from_dimensions: {"width": 0.4, "height": 2.0, "column_mass": 100.0},
    rj.Elastic: {"eta": 1.0, "T_s": 0.5},
    rj.Rigid: {"eta": 1.0},
    rj.Ricker: {"a_p": 3.0, "T_p": 1.0},
    rj.HalfSine: {"a_p": 3.0, "T_p": 1.0},
    rj.Gabor: {"a_p": 1.0, "T_p": 1.0},
    rj.MavroeidisPapageorgiou: {"A": 1.0, "f_p": 1.0},
    rj.Record: {"acceleration": [0.0, 1.0], "dt": 0.1},
    rj.Records.of: {"records": [shaking(20)]},
    rj.Motion: {"acceleration": [0.0, 1.0], "dt": 0.1},
    rj.Motions: {"motions": (MOTION,)},
    MOTION.scaled: {"factor": 1.0},
    MOTION.resampled: {"dt": 0.1},
    MOTION.baseline_corrected: {"order": 1},
    MOTION.trimmed: {"lower": 0.1, "upper": 0.9},
    MOTION.save: {"path": "a.csv"},
    rj.Motions((MOTION,)).scaled_to: {"measure": "PGA", "value": 1.0},
    rj.Options: {},
    rj.State: {},
    rj.peak_response: {"podium": PODIUM, "excitation": pulse()},
    rj.simulate: {"podium": PODIUM, "excitation": pulse()},
    rj.peak_responses: {"podiums": PODIUM, "excitations": pulse()},
    rj.overturning_acceleration: {"podium": PODIUM, "pulse": rj.Ricker, "T_p": 1.0},
    rj.overturning_scale: {"podium": PODIUM, "excitation": pulse()},
    rj.overturning_boundary: {"podium": PODIUM, "excitation": pulse()},
    rj.overturning_spectrum: {"podium": PODIUM, "pulse": rj.Ricker, "frequency_ratio": [2.0]},
    rj.rocking_spectrum: {
        "podium": PODIUM,
        "pulse": rj.Ricker,
        "frequency_ratio": [2.0],
        "acceleration_ratio": [2.0],
    },
    rj.rocking_spectra: {
        "podiums": [PODIUM],
        "pulse": rj.Ricker,
        "frequency_ratio": [2.0],
        "acceleration_ratio": [2.0],
    },
    rj.minimum_overturning: {},
    rj.incremental_dynamic_analysis: {"podium": PODIUM, "records": [MOTION], "intensity": [1.0]},
    rj.overturning_distribution: {"podium": PODIUM, "records": [MOTION]},
    rj.fragility: {},
    rj.contents_fragility: {
        "podium": PODIUM,
        "contents": rj.Contents(0.2, 0.5),
        "records": [MOTION],
        "intensity": [1.0],
    },
    rj.write_pelicun: {"path": "there_is_none.csv"},
    rj.intensity_measures: {"motion": MOTION},
    rj.read_motion: {"path": "there_is_none.AT2"},
    rj.read_suite: {"path": "there_is_none"},
    rj.Record.from_file: {"path": "there_is_none.AT2"},
    rj.synthetic_motions: {"count": 1, "seed": 1},
    rj.simplified_methods: {"podium": PODIUM, "motions": MOTION},
    rj.Contents: {"alpha": 0.2, "R": 0.5},
    rj.Contents.from_dimensions: {"width": 0.4, "height": 1.8},
    rj.Oscillator: {"period": 0.3},
    rj.ensemble: {"podium": PODIUM, "motions": pulse(), "spread": {"R": 1.0}, "n": 2},
    rj.grid: {"structure": PODIUM, "excitation": pulse()},
    rj.sweep: {"structures": PODIUM, "excitations": pulse(), "store": "there_is_none"},
    optimise.PeakRotation: {"limit": 0.3, "excitations": pulse()},
    optimise.PeakShear: {"limit": 0.3, "excitations": pulse()},
    optimise.PeakDeformation: {"limit": 0.3, "excitations": pulse()},
    optimise.PeakDrift: {"limit": 0.03, "excitations": pulse()},
    optimise.PeakFloorAcceleration: {"limit": 5.0, "excitations": pulse()},
    optimise.PeakFriction: {"limit": 0.3, "excitations": pulse()},
    optimise.PeakFoundationShear: {"limit": 0.3, "excitations": pulse()},
    optimise.LeastAxialForce: {"at_least": 0.1, "excitations": pulse()},
    optimise.ContentsRotation: {"limit": 0.5, "excitations": pulse(), "contents": rj.Contents(0.2, 0.5)},
    optimise.FloorSpectrum: {"limit": 9.0, "excitations": pulse(), "oscillators": rj.Oscillator(0.3)},
    optimise.NoOverturning: {"excitations": pulse()},
    optimise.OverturningAcceleration: {"at_least": 1.0, "pulse": rj.Ricker, "T_p": 1.0},
    optimise.OverturningScale: {"at_least": 1.0, "excitations": pulse()},
    optimise.AnnualFrequency: {
        "at_most": 1e-3,
        "hazard": rj.Hazard([0.5, 8.0], [1e-2, 1e-4]),
        "suite": [MOTION, MOTION],
    },
    optimise.FailureProbability: {"at_most": 1e-3, "motion": rj.GaussianMotion(11, 0.1, 0.01)},
    optimise.FreshSamples: {"motions": [rj.Record([0.0, 1.0, 0.0], 0.1), rj.Record([0.0, 2.0, 0.0], 0.1)]},
    optimise.MedianCapacity: {"at_least": 1.0, "suite": [pulse(), pulse()]},
    optimise.OverturningProbability: {"at_most": 0.1, "suite": [pulse()]},
    optimise.WorstRotation: {"excitations": pulse()},
    optimise.WorstShear: {"excitations": pulse()},
    optimise.WorstDeformation: {"excitations": pulse()},
    optimise.WorstDrift: {"excitations": pulse()},
    optimise.WorstFloorAcceleration: {"excitations": pulse()},
    optimise.Dimensions: {"width": 0.4, "height": 2.0, "column_mass": 100.0},
    optimise.design: {"podium": PODIUM, "vary": BOX, "minimise": lambda podium: podium.alpha},
    optimise.design_chart: {},
    optimise.fit: {
        "podium": PODIUM,
        "vary": BOX,
        "excitation": pulse(),
        "times": [1.0, 2.0],
        "theta": [0.0, 0.1],
    },
    optimise.explore: {"structure": PODIUM, "excitation": pulse(), "vary": BOX},
    optimise.load: {},
    optimise.convergence: {},
    optimise.before_after: {"before": PODIUM, "excitation": pulse()},
    optimise.plot_chart: {},
}
ANYTHING = {"progress", "name", "metadata", "source", "ax", "client", "self", "throw", "ratio", "dry_run"}
WRONG = {"text": "wrong", "date": datetime.date(2020, 1, 1)}
# Valid text, or a path that is only looked up.
RIGHT = {("path", "text"), ("measure", "text"), ("method", "text"), ("store", "text"), ("component", "text")}
CASES = [
    pytest.param(function, name, value, id=f"{function.__qualname__}-{name}-{kind}")
    for function in VALID
    for name, parameter in inspect.signature(function).parameters.items()
    if name not in ANYTHING and name[0] != "_" and parameter.kind != parameter.VAR_KEYWORD
    for kind, value in WRONG.items()
    if (name, kind) not in RIGHT
]


@pytest.mark.parametrize(("function", "name", "wrong"), CASES)
def test_an_argument_of_a_wrong_kind_is_named(function, name, wrong, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ValueError, TypeError)) as error:
        function(**VALID[function] | {name: wrong})
    output = str(error.value)
    assert name in output or "missing" in output, output
