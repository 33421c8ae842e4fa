"""The command `rockjax design`: registered in pyproject.toml under `rockjax.extensions`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ._problem import problem_of as problem_of
from ._problem import problem_schema as problem_schema
from ._results import RESULTS as RESULTS

if TYPE_CHECKING:
    import rockjax as rj

    from ._answer import Design
    from ._problem import Problem


def design_command(
    problem: Problem,
    output: Path,
    quiet: bool = False,
    suffix: str = ".png",
) -> tuple[Design, list[Path], rj.Interrupted | None]:
    """Solve a design problem; write the design to `output`.json, and its pictures to `output`-convergence
    and, if the problem has motions, to `output`-response, with the file extension `suffix`.

    Returns the design, the paths of the written files, and the `rockjax.Interrupted` error if the search was
    interrupted, otherwise None. After an interruption, the returned design is the attribute `partial` of this
    error. Raises `rockjax.Interrupted` if the search is interrupted before there is a design.
    """
    import rockjax as rj
    from rockjax._files import as_json, write_atomically, write_figure

    from ._pictures import before_after, convergence
    from ._variables import as_podium

    interruption = None
    try:
        design = problem.design(progress=not quiet)
    except rj.Interrupted as error:
        if error.partial is None:
            raise
        design, interruption = error.partial, error
    text = as_json(design_record(design)) + "\n"
    written = [write_atomically(f"{output}.json", lambda name: Path(name).write_text(text, encoding="utf-8"))]
    figure: Any = convergence(design).figure
    written.append(write_figure(f"{output}-convergence{suffix}", figure))
    motions = [motion for group in problem.motions.values() for motion in group]
    if motions:
        motion = _decisive_motion(problem, design, motions)
        picture = before_after(as_podium(problem.podium), design, motion, problem.options)
        written.append(write_figure(f"{output}-response{suffix}", picture))
    return design, written, interruption


def _decisive_motion(problem: Problem, design: Design, motions: list) -> Any:
    """Return the motion with the smallest margin of all targets on peak responses (`AbstractResponseTarget`)
    that have margins for each motion. If there is none, return the one of `motions` under which the design
    has the smallest overturning margin."""
    from ._suite import Suite
    from ._targets import AbstractResponseTarget

    worst_motions = []
    for target, margins in zip(problem.targets, design.margins.values(), strict=True):
        # A target with one margin for all motions, such as a probability, does not distinguish motions.
        if isinstance(target, AbstractResponseTarget) and margins.size % len(target.suite) == 0:
            worst_margins = margins.reshape(len(target.suite), -1).min(axis=1)  # of each motion
            motion = target.suite.motion(int(np.argmin(worst_margins)))
            worst_motions.append((worst_margins.min(), motion))
    if worst_motions:
        return min(worst_motions, key=lambda pair: pair[0])[1]
    overturning_margins = Suite.of(motions).overturning_margins(design.podium, problem.options)
    return motions[int(np.argmin(np.nan_to_num(overturning_margins, nan=np.inf)))]


def joint_peaks(problem: Problem, design: Design) -> Any:
    """Return the peak forces in the joints under all motions of a problem, as attributes of an object. The
    command `rockjax design` uses these forces to warn of joints that slide or open. Return None if the podium
    has no elevation (positions of columns and heights of masses) or the problem has no motions."""
    from types import SimpleNamespace

    from rockjax._cli._joints import OUTPUTS, VARIABLES

    from ._suite import Suite

    motions = [motion for group in problem.motions.values() for motion in group]
    if design.podium.elevation is None or not motions:
        return None
    names = ("overturned", "result", *VARIABLES)
    return SimpleNamespace(**Suite.of(motions).peaks(design.podium, problem.options, OUTPUTS, names))


def design_record(design) -> dict[str, Any]:
    """Return a design as a dictionary for a JSON file."""
    from ._results import result_name

    podium = design.podium
    superstructure = podium.superstructure
    podium_values: dict[str, Any] = {
        name: float(getattr(podium, name))
        for name in ("alpha", "R", "gamma", "lam", "g", "restitution_factor")
    }
    podium_values |= {"width": float(podium.width), "height": float(podium.height)}
    if superstructure is not None:
        podium_values |= {f"superstructure.{name}": value for name, value in vars(superstructure).items()}
    podium_values["restrainers"] = [{"kind": type(y).__name__} | vars(y) for y in podium.restrainers]
    if podium.elevation is not None:
        values = vars(podium.elevation).items()
        podium_values["elevation"] = {name: value for name, value in values if not name.startswith("_")}
    return {
        "result": result_name(design.result),
        "satisfied": design.satisfied,
        "minimised": design.minimised,
        "objective": design.objective,
        "variables": design.variables,
        "units": design.units,
        "bounds": design.bounds,
        "podium": podium_values,
        "margins": design.margins,
        "multipliers": design.multipliers,
        "failing": design.failing,
        "overturned": design.overturned,
        "starts": [outcome._asdict() | {"result": result_name(outcome.result)} for outcome in design.starts],
        "best": design.best,
        "stats": design.stats._asdict(),
        "history": [row._asdict() for row in design.history],
    }
