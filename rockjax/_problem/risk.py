"""The fragility curve of the table `[risk]` of a problem file, and a check that it belongs to a podium."""

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
    """Return the fragility curve of the table `[risk]`.

    The key `fragility` names the file of a curve: a file of `rockjax fragility`, or a model of OpenQuake
    (.xml) with the curves of one or several structures. Alternatively, `median` and `dispersion` define a
    lognormal distribution. Without any of these keys, the result is None.

    - `settings`: the table `[risk]`
    - `find`: function that turns a file name of the table into a path

    Raises `ValueError` in these cases:

    - if the file cannot be read, or contains no fragility curve
    - if both a file and values are given, or only one of `median` and `dispersion`
    - for a model with several structures, if the key `structure` is missing
    - if `structure` names no structure of the model, or is given for a curve that is not in a model
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
    """Raise `ValueError` if a fragility curve belongs to a structure with other parameters.

    - `curve`: result of `fragility_of`. If the curve does not state the parameters of its structure, like a
      curve of OpenQuake, no error is raised
    - `podium`: the structure
    - `name`: name of the file of the curve, for the message

    The elevation is not compared, because it changes the forces in the joints, but not overturning.
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
    """Return the curve of one structure in a model.

    - `path`: file of the model, for messages
    - `model`: name of a structure ↦ curve
    - `structure`: name of the structure; None for the only structure of the model

    Raises `ValueError` for an unknown name, and for None if the model has several structures.
    """
    if structure is None and len(model) > 1:
        raise ValueError(
            f"{path} has several structures; choose one of {', '.join(model)} by `structure` in [risk] or by "
            "--structure"
        )
    name = next(iter(model)) if structure is None else structure
    if name not in model:
        raise ValueError(f"{path} has no structure {name!r}; choose one of {', '.join(model)}")
    return model[name]
