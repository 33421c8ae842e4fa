"""The command `rockjax design problem.toml`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np


def design_command(
    problem: Path, output: Path, starts: int | None = None, seed: int | None = None, quiet: bool = False
) -> bool:
    """Solve a design problem and write OUTPUT.json, OUTPUT-convergence.png and, with motions, OUTPUT-response.png.

    Returns whether the targets are satisfied.

    `starts` and `seed` replace those of the file. Raises `ValueError` that names what is wrong with the file.
    """
    from rockjax._files import write_figure, write_whole

    from ._problem import load
    from ._report import before_after, convergence
    from ._suite import Suite
    from ._variables import as_podium

    given = load(problem)
    changes = {name: value for name, value in (("starts", starts), ("seed", seed)) if value is not None}
    design = given.design(progress=not quiet, **changes)
    text = json.dumps(account(design), indent=2, ensure_ascii=False) + "\n"
    written = [write_whole(f"{output}.json", lambda name: Path(name).write_text(text, encoding="utf-8"))]
    figure: Any = convergence(design).figure
    written.append(write_figure(f"{output}-convergence.png", figure))
    motions = [motion for group in given.motions.values() for motion in group]
    if motions:
        # The motion that comes closest to overturning the design.
        margins = Suite(motions).margins(design.podium, given.options)
        before = as_podium(given.podium)
        picture = before_after(before, design, motions[int(np.nanargmin(margins))])
        written.append(write_figure(f"{output}-response.png", picture))
    if not quiet:
        print(design)
        for path in written:
            print(f"wrote {path}")
    return design.satisfied


def account(design) -> dict[str, Any]:
    """Everything about a design in numbers and words, for a JSON file; what is not finite is null."""
    from ._design import result_name

    def plain(y) -> Any:
        if isinstance(y, dict):
            return {key: plain(value) for key, value in y.items()}
        if isinstance(y, list | tuple):
            return [plain(value) for value in y]
        if isinstance(y, np.ndarray):
            return plain(y.tolist())
        if isinstance(y, float | np.floating):
            return float(y) if np.isfinite(y) else None
        return y.item() if isinstance(y, np.generic) else y

    podium = design.podium
    top = podium.superstructure
    ratios = {name: float(getattr(podium, name)) for name in ("alpha", "R", "gamma", "lam", "g", "restitution_factor")}
    ratios |= {"width": float(podium.width), "height": float(podium.height)}
    if top is not None:
        ratios |= {f"superstructure.{name}": float(getattr(top, name)) for name in vars(top)}
    return plain(
        {
            "result": result_name(design.result),
            "satisfied": design.satisfied,
            "minimised": design.minimised,
            "objective": design.objective,
            "variables": design.variables,
            "units": design.units,
            "bounds": design.bounds,
            "podium": ratios,
            "margins": design.margins,
            "multipliers": design.multipliers,
            "failing": design.failing,
            "starts": [outcome._asdict() | {"result": result_name(outcome.result)} for outcome in design.starts],
            "best": design.best,
            "stats": design.stats._asdict(),
            "history": [row._asdict() for row in design.history],
        }
    )
