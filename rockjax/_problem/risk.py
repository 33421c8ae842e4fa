"""The fragility curve that the table `[risk]` of a problem file gives, and its comparison with a podium."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from rockjax._lognormal import Lognormal
from rockjax._responses.datasets import describe_podium
from rockjax._structures import Podium

from . import models


def fragility_of(settings: models.Risk, find: Callable[[str], Path]) -> Any:
    """Return the fragility curve of `[risk]`: the curve from a file if `fragility` names one, a lognormal
    distribution if `median` and `dispersion` are given, otherwise None.

    - `settings`: the table `[risk]`
    - `find`: function that turns a file name of the table into a path

    Raises `ValueError` if the file cannot be read or contains no fragility curve, if both a file and values
    are given, or if only one of `median` and `dispersion` is given. For a model (.xml), `ValueError` is also
    raised if `structure` is unknown, or missing although the model has several structures; for other curves,
    if `structure` is given.
    """
    parameters = [value for value in (settings.median, settings.dispersion) if value is not None]
    if settings.structure is not None and not (settings.fragility or "").lower().endswith(".xml"):
        raise ValueError("`structure` applies only to a fragility model of OpenQuake (.xml); leave it out")
    if settings.fragility is None:
        if len(parameters) == 1:
            raise ValueError("a fragility curve needs both median and dispersion")
        return Lognormal(*map(jnp.asarray, parameters)) if parameters else None
    if parameters:
        raise ValueError(
            "`fragility` names a file, which replaces `median` and `dispersion`; give either the file or the "
            "two values"
        )
    path = find(settings.fragility)
    if path.suffix.lower() == ".xml":
        from rockjax._risk.files import read_fragility_model

        return _curve_of_model(path, read_fragility_model(path), settings.structure)
    from rockjax.plots._from_file import load

    data = load(path)
    if data.attrs["kind"] != "fragility":
        raise ValueError(
            f"{path} contains a dataset of kind {data.attrs['kind']!r}, not a fragility curve; "
            "`rockjax fragility` writes files with fragility curves"
        )
    return data


def check_structure(curve: Any, podium: Podium, name: str) -> None:
    """Raise `ValueError` if a fragility curve belongs to another structure, apart from the elevation.

    - `curve`: result of `fragility_of`. A curve that does not state the parameters of its structure, such as
      a curve of OpenQuake, passes
    - `podium`: the structure
    - `name`: name of the curve's file, for the message

    The elevation is not compared, because it changes only the forces in the joints, not overturning.
    """
    attrs = getattr(curve, "attrs", {})
    if "alpha_rad" not in attrs:
        return
    for key, value in describe_podium(podium).items():
        other = attrs.get(key)
        is_equal = (
            other == value if isinstance(value, str) or other is None else np.isclose(other, value, 1e-9, 0)
        )
        if key != "elevation" and not is_equal:
            raise ValueError(
                f"{name} is for another structure: {key} is {other} there and {value} here; compute the "
                "curve again with `rockjax fragility`"
            )


def _curve_of_model(path: Path, model: dict[str, Any], structure: str | None) -> Any:
    """Return the curve of a structure in a model, a dict name → curve. `structure` is the name; None stands
    for the only structure. Raises `ValueError` for an unknown name, and for None if there are several
    structures."""
    if structure is None and len(model) > 1:
        raise ValueError(
            f"{path} has several structures; choose one of {', '.join(model)} by `structure` in [risk] or by "
            "--structure"
        )
    name = next(iter(model)) if structure is None else structure
    if name not in model:
        raise ValueError(f"{path} has no structure {name!r}; choose one of {', '.join(model)}")
    return model[name]
