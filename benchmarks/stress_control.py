"""Scenes of the stress campaign with `--control`: restrainers, vertical motion, three modes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

import rockjax as rj
from tests import restrained

from .measure import log_uniform, mix_in

TOPS = ("none", "rigid", "elastic", "modes")
ADDED = (
    "tendon",
    "damper",
    "power-damper",
    "inerter",
    "all",
    "vertical",
    "all vertical",
    "power-damper vertical",
)
MOTIONS = ("Ricker", "OneCosine", "record")
LAWS = ("paper", "compatible", "given")
MODES = 3
WIDEST = 0.5  # largest α, because `overturn_ratio` may be 3
RATIOS = (1.0, 1.0, 0.5, 3.0)  # values of `overturn_ratio`


def groups() -> Iterator[tuple[str, str, str, str]]:
    """Yield (superstructure, law, motion, addition), with one law for each combination of the other three."""
    for k, top in enumerate(TOPS):
        for j, added in enumerate(ADDED if top != "modes" else ("", *ADDED)):
            for i, motion in enumerate(MOTIONS):
                yield top, LAWS[(i + j + k) % len(LAWS)], motion, added


def modes(rng: np.random.Generator, eta: np.ndarray, T_s: np.ndarray, zeta: np.ndarray) -> rj.Modes:
    """Return modes with periods up to T_s; in some scenes two periods are equal or a mode has no mass."""
    n = len(eta)
    shares = rng.dirichlet(np.ones(MODES + 1), n)
    shares[rng.random(n) < 0.1, 1] = 0.0
    shorter = log_uniform(rng, 0.05, 1.0, 2 * n).reshape(n, 2)
    shorter[rng.random(n) < 0.1] = 1.0
    periods = T_s[:, None] * np.c_[np.ones(n), shorter]
    return rj.Modes(
        eta[:, None] * shares[:, :MODES], periods, np.tile(zeta[:, None], MODES), eta * shares[:, -1]
    )


def restrained_podium(rng: np.random.Generator, podium: rj.Podium, added: str) -> rj.Podium:
    """Return the podium with devices.

    Prestress is up to ten times the weight, and stiffness up to twice the critical stiffness. Dampers have up
    to several times critical damping and exponents from 0.3, inerters up to a thousand masses of a column.
    """
    alpha = np.asarray(podium.alpha)
    n = len(alpha)
    weight = np.asarray(podium.gamma + podium.eta) + 0.5
    has_all = "all" in added
    devices: list[Any] = []
    if has_all or "tendon" in added:
        kappa = mix_in(rng, rng.uniform(0.0, 2.0, n), (0.0, 1 - 1e-9, 1.0, 1 + 1e-9), 0.3)
        tau = mix_in(rng, weight * log_uniform(rng, 1e-3, 10.0, n), (0.0,))
        devices.append(rj.Tendon(tau, kappa * np.asarray(podium.critical_stiffness)))
    if has_all or "damper" in added:
        nu = rng.uniform(0.3, 0.999, n) if "power" in added else np.ones(n)
        strength = mix_in(rng, log_uniform(rng, 1e-3, 10.0, n), (0.0,))
        delta = strength * weight / (2 * np.sin(alpha) * alpha) ** nu
        devices.append(rj.Damper(delta, nu if "power" in added else 1.0))
    if has_all or "inerter" in added:
        devices.append(rj.Inerter(mix_in(rng, log_uniform(rng, 1e-3, 1e3, n), (0.0,))))
    return podium.replace(restrainers=tuple(devices))


def with_vertical(
    rng: np.random.Generator, motion: rj.AbstractExcitation, T: np.ndarray, g: np.ndarray
) -> rj.GroundMotion:
    """Return the motion with a vertical component that is below g and has other periods."""
    n = len(T)
    size = g * mix_in(rng, rng.uniform(-0.95, 0.95, n), (0.0, -0.999999, 0.999999))
    T = T * log_uniform(rng, 0.1, 3.0, n)
    if not isinstance(motion, rj.Record):
        return rj.GroundMotion(motion, rj.Ricker(size, T))
    a = np.asarray(motion.acceleration)
    return rj.GroundMotion(motion, rj.Record(a[::-3] / np.abs(a[::-3]).max(), 6 * T / len(a), scale=size))


def by_scipy(
    podium: rj.Podium, motion: rj.AbstractExcitation, initial: rj.State, end: float, limit: float
) -> restrained.Answer:
    """Solve a scene by an independent implementation, up to |θ| = `limit`."""
    frame, start = restrained.frame_of(podium), float(motion.support[0])
    components = [motion.horizontal, motion.vertical] if isinstance(motion, rj.GroundMotion) else [motion]
    breaks = [float(b) for component in components for b in np.asarray(component.breakpoints)]
    u, speed = (np.broadcast_to(np.asarray(y), len(frame.modes)) for y in (initial.u_t, initial.u_t_dot))
    state = (float(initial.theta), float(initial.theta_dot), *u, *speed)
    return restrained.simulate(
        frame, end, *map(_acceleration, components), breaks=breaks, start=start, state=state, limit=limit
    )


def _acceleration(motion: rj.AbstractExcitation):
    if isinstance(motion, rj.Rest):
        return lambda t: 0.0
    assert isinstance(motion, rj.AbstractPulse)
    a_p, T_p, (low, high) = float(motion.a_p), float(motion.T_p), motion.span
    is_inside = lambda tau: not motion.compact or low <= tau <= high
    return lambda t: a_p * float(motion.shape(np.float64(t / T_p))) if is_inside(t / T_p) else 0.0


def longest_vibration(podium: rj.Podium) -> tuple[np.ndarray, np.ndarray]:
    """Return the longest period of the modes [s], and the largest damping ratio ζ_iω_up/ω_i after uplift."""
    top = podium.superstructure
    assert isinstance(top, rj.Modes)
    damping = (
        np.asarray(podium.uplifted_frequency)[:, None]
        * np.asarray(top.zeta)
        * np.asarray(top.T)
        / (2 * math.pi)
    )
    return np.max(np.asarray(top.T), axis=-1), np.max(damping, axis=-1)


def over_parts(motion: rj.AbstractExcitation, pick) -> rj.AbstractExcitation:
    """Return a motion with `pick` applied to every parameter of a batch, except to samples of records."""
    if isinstance(motion, rj.GroundMotion):
        return rj.GroundMotion(*(over_parts(part, pick) for part in (motion.horizontal, motion.vertical)))
    if isinstance(motion, rj.Record):
        return rj.Record(motion.acceleration, pick(motion.dt), pick(motion.scale))
    numbers = {field.name: pick(getattr(motion, field.name)) for field in dataclasses.fields(motion)}
    return dataclasses.replace(motion, **numbers)
