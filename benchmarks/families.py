"""The scenes that are measured: the grid of Fig. 6 at η/γ = 10, one family per superstructure."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

G = 9.80665
PERIODS = {"rigid": 0.0, "T_s = 0.1 s": 0.1, "T_s = 0.5 s": 0.5, "T_s = 1 s": 1.0}


@dataclasses.dataclass(frozen=True)
class Family:
    """One podium under symmetric Ricker pulses: a_p [m/s²] and T_p [s] of every scene, shape (n,)."""

    T_s: float  # 0 is rigid
    a_p: np.ndarray
    T_p: np.ndarray
    alpha: float = math.atan(0.15)
    R: float = 1.5
    gamma: float = 10.0
    eta: float = 100.0
    zeta: float = 0.05
    lam: float = 1 / 3

    def __len__(self) -> int:
        return len(self.a_p)

    def some(self, count: int) -> Family:
        """Evenly spread scenes of the family, for peers that need seconds for each."""
        chosen = np.linspace(0, len(self) - 1, count).round().astype(int)
        return dataclasses.replace(self, a_p=self.a_p[chosen], T_p=self.T_p[chosen])


def family(name: str, points: int) -> Family:
    """The family on points × points pulses: 1 ≤ ω_p/p ≤ 8, 1 ≤ a_p/(g tan α) ≤ 12."""
    p = math.sqrt(0.75 * G / Family.R)
    frequency, acceleration = np.meshgrid(np.linspace(1, 8, points), np.linspace(1, 12, points))
    return Family(
        PERIODS[name],
        a_p=(acceleration * G * math.tan(Family.alpha)).ravel(),
        T_p=(2 * math.pi / (frequency * p)).ravel(),
    )
