"""The fragility curve of the table `[risk]`."""

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
    """Return the curve of `[risk]`: a dataset from a file, a lognormal distribution, or None without either.

    - `settings`: the table `[risk]`
    - `find`: function that turns a file name of the table into a path

    Raises `ValueError` if the file contains no fragility curve, if both a file and values are given, or
    if only one of median and dispersion is given.
    """
    parameters = [value for value in (settings.median, settings.dispersion) if value is not None]
    if settings.fragility is None:
        if len(parameters) == 1:
            raise ValueError("a fragility curve needs both median and dispersion")
        return Lognormal(*map(jnp.asarray, parameters)) if parameters else None
    if parameters:
        raise ValueError("fragility replaces median and dispersion; give the file or the values")
    path = find(settings.fragility)
    if path.suffix.lower() == ".xml":
        from rockjax._risk.files import read_fragility_model

        return _curve_of_model(path, read_fragility_model(path), settings.structure)
    from rockjax.plots._from_file import load

    data = load(path)
    if data.attrs["kind"] != "fragility":
        raise ValueError(
            f"{path} contains a {data.attrs['kind']}, not a fragility; `rockjax fragility` writes one"
        )
    return data


def check_structure(curve: Any, podium: Podium, name: str) -> None:
    """Raise `ValueError` if a fragility curve, from the file `name`, belongs to another structure.

    Curves without parameters of a structure, such as those of OpenQuake, are not compared.
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
    """Return the curve of a named structure; without a name, of the only structure of the model."""
    if structure is None and len(model) > 1:
        raise ValueError(f"{path} has several structures; choose one of {', '.join(model)} with --structure")
    name = next(iter(model)) if structure is None else structure
    if name not in model:
        raise ValueError(f"{path} has no structure {name!r}; choose one of {', '.join(model)}")
    return model[name]
