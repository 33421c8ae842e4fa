"""Models of the table `[options]`, and of the tables of the commands for responses, spectra, fragility and
risk."""

from __future__ import annotations

from typing import Literal

from .fields import (
    ACCURACY,
    CURVE,
    GRID,
    HAZARD,
    MOTION,
    OUTPUT,
    STATISTICS,
    STRUCTURE,
    Amplitudes,
    Count,
    Frequencies,
    Index,
    Keys,
    Label,
    Levels,
    NotNegative,
    NotNegatives,
    Number,
    Points,
    Positive,
    PulseName,
    Share,
    key,
)


class Options(Keys):
    """Settings of the solver, as in `rockjax.Options`."""

    rtol: Positive | None = key(None, "Relative tolerance of the step-size control [–].", ACCURACY)
    atol: Positive | None = key(None, "Absolute tolerance [–]; by default 0.01 rtol.")
    method: str | None = key(None, "Runge–Kutta method: dopri8, tsit5, dopri5, bosh3 …", ACCURACY)
    engine: str | None = key(None, "Integration loop: flat or segments.")
    overturn_ratio: Positive | None = key(None, "Limit state max|θ|/α [–].", ACCURACY, "--limit")
    rest_velocity: Positive | None = key(
        None, "Columns come to rest at an impact that leaves at most this |θ̇|/(pα) [–]."
    )
    max_steps: Count | None = key(None, "Maximum number of trial steps of a scene.")
    outputs: list[str] | None = key(None, "Requested outputs, unless the table of the command has its own.")
    history: Count | None = key(None, "Number of steps that a history can hold under jit.")
    throw: bool | None = key(None, "Raise an error if a scene does not finish.")


class OneMotion(Keys):
    """Keys that select a motion."""

    motion: str | None = key(None, "Name of the set of motions, if the file has several.", MOTION)
    number: Count | None = key(None, "Number of the motion in the set, if the set has several.", MOTION)


FRICTION = "Friction coefficient μ of the joints, for a warning [–]."


class Response(OneMotion):
    """Table of `rockjax response`."""

    t_end: Number | None = key(
        None, "End of the scene [s]; by default max(30/p, 10 T_s) after the motion.", GRID
    )
    friction: Positive | None = key(None, FRICTION, STRUCTURE)


class Peaks(OneMotion):
    """Table of `rockjax peaks`. Without `number`, all motions of a set are used."""

    outputs: list[str] | None = key(
        None,
        "Requested outputs: peak_rotation, peak_shear …; by default all outputs for the building and the "
        "joints of the structure.",
        GRID,
    )
    factor: Positive = key(1.0, "Factor on the motions [–].", MOTION)
    friction: Positive | None = key(None, FRICTION, STRUCTURE)
    t_end: Number | None = key(
        None, "End of the scene [s]; by default max(30/p, 10 T_s) after the motion.", GRID
    )


class Floors(OneMotion):
    """Table of `rockjax floors`. Without `number`, all motions of a set are used."""

    levels: list[Label] | None = key(
        None, "Levels: deck, or numbers of stories; by default the deck and all stories.", GRID
    )
    periods: Frequencies = key((0.05, 5.0), "Range of the periods of the oscillators T_e [s].", GRID)
    points: Points = key(100, "Number of periods, at equal ratios.", GRID)
    oscillator_damping: NotNegatives = key([0.05], "Damping ratios of the oscillators [–].", GRID)
    direction: Literal["horizontal", "vertical"] = key("horizontal", "Direction of the motion.", GRID)
    t_end: Number | None = key(
        None, "End of the scenes [s]; by default at least 5 times the longest T_e after the motion.", GRID
    )
    sensitivities: list[str] = key([], "Parameters y; y ∂S/∂y is computed for every spectrum S.", GRID)


class _Panels(Keys):
    """Keys of the commands that compute a spectrum for each superstructure, with the same kind of pulse."""

    pulse: PulseName = key("ricker", "Kind of the pulse.", MOTION)
    vertical_ratio: Number | None = key(
        None, "Ratio of vertical to horizontal ground acceleration [–].", MOTION
    )
    frequency_ratio: Frequencies = key((1.0, 8.0), "Range of ω_p/p [–].", GRID, "--frequency")
    eta_over_gamma: NotNegatives = key([1.0, 5.0, 10.0], "Mass ratios η/γ [–]: a panel for each.", STRUCTURE)
    T_s: NotNegatives = key([0.0, 0.1, 0.5, 1.0], "Periods [s] for each mass ratio; 0 is rigid.", STRUCTURE)


class Spectrum(_Panels):
    """Table of `rockjax spectrum`. The plot has one panel if the file has a structure and sets
    neither `eta_over_gamma` nor `T_s`."""

    acceleration_ratio: Amplitudes = key((1.0, 12.0), "Range of a_p/(g tan α) [–].", GRID, "--acceleration")
    points: Points = key(100, "Points along each axis.", GRID)
    sensitivities: list[str] = key([], "Parameters y of the derivatives ∂(max|θ|/α)/∂ ln y.", GRID)


class Overturning(_Panels):
    """Table of `rockjax overturning`."""

    max_acceleration_ratio: Positive = key(12.0, "Largest a_p/(g tan α) [–].", GRID, "--max-acceleration")
    points: Points = key(141, "Number of frequencies.", GRID)
    sensitivities: list[str] = key(["alpha", "gamma"], "Parameters y of the derivatives d a_ov/d ln y.", GRID)


class Fragility(Keys):
    """Table of `rockjax fragility`."""

    motions: str | None = key(None, "Name of the set of motions, if the file has several.", MOTION)
    measure: Literal["PGA", "PGV", "Sa", "scale"] = key(
        "PGA", "Intensity: PGA, PGV, Sa at --measure-period, or the factor on the records.", GRID
    )
    measure_period: Positive | None = key(None, "Period of Sa [s].", GRID)
    intensity: Levels | None = key(
        None,
        "Lowest and highest level, in units of the measure: [m/s²], [m/s], [–]. By default up to the level "
        "at which the median PGA of the suite is 6 g tan α.",
        GRID,
    )
    levels: Count = key(20, "Number of levels.", GRID)
    method: Literal["capacities", "stripes"] = key(
        "capacities",
        "Fit of the lowest overturning intensities, or of the numbers of overturned records at the levels.",
        STATISTICS,
    )
    confidence: Share = key(0.9, "Confidence level of intervals and bands, in (0, 1) [–].", STATISTICS)
    seed: Index = key(0, "Seed of --synthetic motions.", STATISTICS)
    damage_states: NotNegatives = key(
        [0.0, 0.5, 1.0], "Damage states of the contents: thresholds of max|φ|/α_c [–].", STATISTICS
    )
    overturned: Literal["drop", "exceed"] = key(
        "drop", "Leave out scenes in which the podium overturns, or count them as damage of the contents."
    )
    sensitivities: list[str] = key([], "Parameters y of the derivatives d ln(median)/d ln y.", STATISTICS)
    friction: Positive | None = key(None, FRICTION, STRUCTURE)


class Risk(Keys):
    """Table of `rockjax risk`."""

    fragility: str | None = key(None, "File of `rockjax fragility` (.nc) or of OpenQuake (.xml).", CURVE)
    structure: str | None = key(None, "Name of the structure in a file (.xml) of several structures.", CURVE)
    median: Positive | None = key(None, "Median of the curve, in SI units, instead of a file.", CURVE)
    dispersion: Positive | None = key(None, "Logarithmic standard deviation, with the median [–].", CURVE)
    hazard: str | None = key(None, "Hazard curve: a CSV file with two columns, or OpenQuake's file.", HAZARD)
    site: Index | None = key(None, "Row of the site in an OpenQuake hazard file, counted from 0.", HAZARD)
    years: NotNegative = key(50.0, "Period of the reported probability of failure [years].", OUTPUT)
