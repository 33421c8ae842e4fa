"""Checks of a podium, an excitation and options together."""

from __future__ import annotations

import numpy as np

from rockjax._checks import check_dtype, concrete, require
from rockjax._excitations.base import AbstractExcitation
from rockjax._options import Options
from rockjax._structures import Podium


def check_types(owner: str, podium, excitation, options) -> None:
    for name, value, kind in (
        ("podium", podium, Podium),
        ("excitation", excitation, AbstractExcitation),
        ("options", options, Options),
    ):
        if not isinstance(value, kind):
            raise ValueError(f"{owner}: {name} must be a rockjax {kind.__name__}, got {value!r}")
        check_dtype(owner, name, value)
    options.check_precision()


def check_range(owner: str, podium: Podium, excitation: AbstractExcitation, t_end, options: Options) -> None:
    """What can be said of concrete numbers together."""
    alpha, ratio = concrete(podium.alpha), concrete(options.overturn_ratio)
    if alpha is not None and ratio is not None:
        limit = float(np.pi / 2 / alpha.max())
        require(owner, "options.overturn_ratio", ratio, lambda v: v <= limit, f"<= π/(2α) = {limit:.6g}")
    if t_end is None:
        return
    start = concrete(excitation.support[0])
    if start is not None and start.ndim == 0:
        require(owner, "t_end", t_end, lambda v: v > start, f"after the start of the excitation at {float(start):.6g} s")
