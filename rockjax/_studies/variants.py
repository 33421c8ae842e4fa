"""Random variants of a podium, its ground motion and its initial state."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from rockjax._checks import require
from rockjax._excitations.base import AbstractExcitation
from rockjax._parameters.registry import INITIAL
from rockjax._responses.variants import pick_motions, with_parameters
from rockjax._results import State
from rockjax._structures import Dimensions, Podium


class Variants(NamedTuple):
    """Random variants of a scene (one podium under one ground motion).

    - `structure`, `initial`: structure and initial state. In each variant, drawn values replace some of their
      parameters
    - `motion`: a motion, or a batch of k motions, shape (k,)
    - `motion_index`: index of the drawn motion of each scene, shape (n,); None for a single motion
    """

    structure: Podium | Dimensions
    motion: AbstractExcitation
    initial: State
    motion_index: np.ndarray | None

    def scenes(
        self, draws: Mapping[str, np.ndarray], scene: Any = slice(None)
    ) -> tuple[Podium, AbstractExcitation, State]:
        """Return the podiums, motions and initial states of all scenes, or of one scene.

        - `draws`: drawn values of parameters by name, shape (n,); for one scene, numbers
        - `scene`: index of the scene; by default all scenes

        Raises `ValueError` for values out of range, and if a drawn initial |θ| is not smaller than α.
        """
        motion = self.motion
        if self.motion_index is not None:
            motion = pick_motions(motion, np.asarray(self.motion_index[scene]))
        parameters = {name: values for name, values in draws.items() if name not in INITIAL}
        podium, motion = with_parameters("ensemble", self.structure, motion, parameters)
        superstructure, changes = podium.superstructure, {}
        for name in draws.keys() & INITIAL.keys():
            field, values = INITIAL[name].attribute_path, draws[name]
            if field.startswith("u_t") and superstructure is not None and superstructure.has_mode_axis:
                values = values[..., None].repeat(superstructure.count, -1)
            changes[field] = values
        if "theta" in changes:
            ratio = np.abs(changes["theta"]) / np.asarray(podium.alpha)
            require("ensemble", "|initial.theta|/α", ratio, lambda y: y < 1, "< 1 in every scene")
        return podium, motion, dataclasses.replace(self.initial, **changes) if changes else self.initial
