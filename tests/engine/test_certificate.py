"""Bounds of (C19) and (C20), computed separately: each output becomes final exactly at the value that the
bound gives, in scenes that have not ended."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._engine.certificate import certificate
from rockjax._engine.energy import energy, potential
from rockjax._engine.scene import plan_for, prepare

ALPHA, R, G = 0.15, 1.5, 9.80665
P2 = 0.75 * G / R
DEVICES = rj.Tendon(5.0, 60.0), rj.Damper(3.0, 0.5), rj.Inerter(8.0)
RIGID = rj.Podium(ALPHA, R, 2.0, rj.Rigid(8.0))  # moves like a frame of γ = 10
FRAME = rj.Podium(ALPHA, R, 10.0)
ELASTIC = FRAME.replace(superstructure=rj.Elastic(30.0, 0.5, 0.05))
MODES = FRAME.replace(superstructure=rj.Modes((24.0, 6.0), (0.5, 0.15), (0.05, 0.03), 1.5))
BUILDING = FRAME.replace(superstructure=rj.ShearBuilding((3.0, 3.0, 2.0), (900.0, 700.0, 500.0), 0.04, 2))


class Bounds:
    """Bounds on the later motion of a podium from a state."""

    def __init__(self, podium: rj.Podium, horizontal: float, vertical: float, theta: float, swing: float):
        self.podium, self.a, self.a_v = podium, horizontal, vertical
        top: Any = podium.superstructure
        modes = top.modes if isinstance(top, rj.Modes | rj.ShearBuilding) else None
        one = isinstance(top, rj.Elastic)
        rows = (
            (top.eta, top.T_s, top.zeta) if one else (modes.eta, modes.T, modes.zeta) if modes else ((),) * 3
        )
        count = 1 if one else len(rows[0])
        self.eta, T, self.zeta = (np.broadcast_to(np.asarray(y, float), count) for y in rows)
        self.omega = 2 * math.pi / T
        self.residual = float(modes.residual) if modes else 0.0
        self.gamma, self.mass = 10.0 + self.residual, self.eta.sum()
        self.w, self.spin = self.gamma + self.mass + 0.5, 4 / 3 + 4 * self.gamma
        self.rests = theta == 0
        options = rj.Options()
        wanted = [f"peak_{name}" for name in ("rotation", "deformation", "shear")]
        if isinstance(top, rj.ShearBuilding):
            wanted += ["peak_drift", "peak_floor_acceleration"]
        self.wanted = wanted
        # Half a period of each motion; at its start the full impulse remains.
        self.motion: Any = rj.HalfSine(horizontal, 2.0)
        if vertical:
            self.motion = rj.GroundMotion(self.motion, rj.HalfSine(vertical, 2.0))
        self.impulse_v = vertical * 2 / math.pi
        self.u = np.full(count, swing) if count else np.zeros(1)
        self.speed = self.u * (0.0 if theta else 3.0)
        swings = (self.u, self.speed) if modes else (self.u[0], self.speed[0])
        self.initial = rj.State(theta, 0.02 if theta else 0.0, *swings)
        plan = plan_for(podium.split_rows(), options.replace(outputs=tuple(wanted)), history=False)
        self.scene, self.state = prepare(podium.split_rows(), self.motion, self.initial, None, options, plan)
        self.c = self.scene.c
        self.well = ALPHA if not podium.restrainers else min(float(podium.stability_angle), ALPHA)
        self.steepest = max(math.sin(ALPHA), math.sin(self.well - ALPHA))
        self.now = float(energy(self.c, self.state.sigma, self.state.x, self.state.v))

    @property
    def impulse(self) -> float:
        """Return the remaining ∫|ü_g| dt."""
        return self.a * 2 / math.pi

    @property
    def max_energy(self) -> float:
        """Return the bound on the energy, (C19)."""
        C = math.sqrt((1 + 2 * self.gamma) ** 2 / (2 * self.spin) + self.mass / 2)
        C_v = 2 * self.w * self.steepest / math.sqrt(2 * (self.spin + 4 * self.mass * self.steepest**2))
        if self.rests:
            C, C_v = math.sqrt(self.mass / 2), 0.0
        return (math.sqrt(self.now) + C * self.impulse + C_v * self.impulse_v) ** 2

    @property
    def turning(self) -> float:
        """Return the bound on |θ̇|."""
        return math.sqrt(2 * self.max_energy / (self.spin * R**2))

    def swings(self) -> np.ndarray:
        """Return the bound on √(u̇² + ω²u²) of several modes at rest."""
        return np.sqrt(self.speed**2 + (self.omega * self.u) ** 2) + self.impulse

    def sum_of(self, weights: np.ndarray, beam: float = 0.0) -> float:
        """Return the bound on Σ w_i y_i, where y_i² is twice the energy of mode i divided by η_i."""
        if self.rests and len(weights) > 1:
            return float(np.abs(weights) @ self.swings())
        return math.sqrt(
            2 * self.max_energy * (float(np.sum(weights**2 / self.eta)) + (0 if self.rests else beam))
        )

    def springs(self, weights: np.ndarray) -> float:
        """Return the bound on Σ w_i F_i."""
        beam = (4 * float(weights @ (self.zeta * self.omega))) ** 2 / self.spin
        return self.sum_of(weights * self.omega * np.sqrt(1 + 4 * self.zeta**2), beam)

    def angular(self) -> float:
        """Return θ̈_max + ϑ² max|sin ψ|, (C20), where ϑ² has the factor sin ψ by Eq. (14)."""
        s, rate = math.sin(ALPHA), self.turning
        moment = P2 * (2 * self.w * (1 + self.a_v / G) * self.steepest + (2 * self.gamma + 1) * self.a / G)
        if self.podium.restrainers:
            moment += 2 * P2 * s * (5.0 + 4 * 60.0 * s * math.sin(self.well / 2))
            moment += (
                P2 * 3.0 * (2 * s) ** 1.5 * math.sqrt(rate / math.sqrt(P2)) + 0.75 * 8.0 * s**2 * rate**2
            )
        if len(self.eta):
            moment += 1.5 * self.mass * rate**2 + 3 * self.springs(self.eta) / (2 * R)
        return moment / (3 * self.gamma + 1.0) + self.steepest * rate**2

    def base(self) -> float:
        """Return the bound on the absolute acceleration of the beam."""
        return self.a + (0.0 if self.rests else 2 * R * self.angular())

    def absolute(self, weights: np.ndarray) -> float:
        """Return the bound on Σ w_i F_i including the mass that moves with the beam."""
        left = abs(1 - weights.sum()) * self.base() if self.residual else 0.0
        return self.springs(weights) + left

    def accumulators(self) -> dict[str, Any]:
        """Return the least accumulators for which all outputs are final."""
        found: dict[str, Any] = {"peak": self.rotation()}
        if not len(self.eta):
            return found | {"shear": self.base() / G}
        unit = np.eye(len(self.eta)) / self.omega
        found["deformation"] = np.array([self.sum_of(row) for row in unit])
        shares = self.eta / (self.mass + self.residual)
        found["shear"] = self.absolute(shares) / G
        top = self.podium.superstructure
        if isinstance(top, rj.ShearBuilding):
            shapes = np.asarray(top.shapes)[:, :2]
            stories = np.diff(shapes, axis=0, prepend=0.0)
            found["drifts"] = np.array([self.sum_of(row / self.omega) for row in stories])
            found["floors"] = np.array([self.absolute(row) for row in shapes])
        if isinstance(top, rj.Elastic):
            found["deformation"] = found["deformation"][0]
        return found

    def rotation(self) -> float:
        """Return |θ| at which V equals the bound on the energy."""
        if self.rests:
            return 0.0
        V = lambda A: float(potential(self.c, jnp.ones(()), jnp.asarray(A)))
        low, high = 0.0, self.well
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if V(middle) < self.max_energy else (low, middle)
        return high

    def certain(self, output: str, **accumulators: Any) -> bool:
        """Return whether a single output is final with these accumulators."""
        names = {"peak": "peak_rotation", "margin": "margin", "drifts": "peak_drift"}
        names["floors"] = "peak_floor_acceleration"
        name_of = lambda short: names.get(short, f"peak_{short}")
        options = rj.Options(outputs=(name_of(output),))
        plan = plan_for(self.podium.split_rows(), options, history=False)
        expected = {"peak_rotation": self.state.peak} | {
            name_of(k): jnp.asarray(y) for k, y in accumulators.items()
        }
        state = self.state._replace(accumulators=tuple(expected[each.name] for each in plan.outputs))
        ground = self.motion.piece(state.piece)(state.t)
        return bool(certificate(self.scene, plan, state, state.piece, ground))


SCENES = {
    "rigid": (RIGID, 0.05, 0.0, 0.03, 0.0),
    "rigid, devices, vertical": (RIGID.replace(restrainers=DEVICES), 0.05, 0.04, 0.03, 0.0),
    "elastic": (ELASTIC, 0.02, 0.0, 0.03, 0.085),
    "elastic, devices, vertical": (ELASTIC.replace(restrainers=DEVICES), 0.02, 0.01, 0.03, 0.085),
    "elastic at rest": (ELASTIC, 0.05, 0.0, 0.0, 0.002),
    "modes, devices, vertical": (MODES.replace(restrainers=DEVICES), 0.02, 0.01, 0.03, 0.088),
    "modes at rest": (MODES, 0.05, 0.3, 0.0, 0.002),
    "building": (BUILDING, 0.02, 0.0, 0.03, 0.088),
    "building at rest": (BUILDING, 0.05, 0.0, 0.0, 0.002),
}


@pytest.mark.parametrize("name", SCENES)
def test_records_from_which_on_outputs_are_certain(name):
    bounds = Bounds(*SCENES[name])
    accumulators = bounds.accumulators()
    assert bounds.rests or 0.03 < accumulators["peak"] < bounds.well
    for output, level in accumulators.items():
        if output == "peak" and bounds.rests:
            continue
        least = np.asarray(level)
        assert bounds.certain(output, **{output: least * (1 + 1e-9)})
        for k in np.ndindex(least.shape):  # every element must be final
            low = np.array(least * (1 + 1e-9))
            low[k] *= 1 - 2e-9
            assert not bounds.certain(output, **{output: low}), (output, k)


@pytest.mark.parametrize("name", ["rigid", "rigid, devices, vertical"])
def test_margins_that_are_certain(name):
    """A margin is final unless the energy could come closer to the overturning energy than this margin."""
    bounds = Bounds(*SCENES[name])
    top = float(potential(bounds.c, jnp.ones(()), jnp.asarray(ALPHA)))
    least = 1 - bounds.max_energy / top
    assert 0 < least < 1
    assert bounds.certain("margin", margin=least * (1 - 1e-9), peak=1.0)
    assert not bounds.certain("margin", margin=least * (1 + 1e-9), peak=1.0)


@pytest.mark.parametrize("name", ["elastic at rest", "modes at rest"])
def test_columns_that_rest_for_good(name):
    """Columns in full contact rest for good unless the largest demand of vibration and ground motion together
    lifts them."""
    podium, _, vertical, _, swing = SCENES[name]

    bounds = Bounds(podium, 1.0, vertical, 0.0, swing)

    def spare(a: float) -> float:
        bounds.a = a
        stiff = bounds.omega * np.sqrt(1 + 4 * bounds.zeta**2)
        if len(stiff) > 1:
            springs = float(bounds.eta @ (stiff * bounds.swings()))
        else:
            springs = math.sqrt(2 * bounds.max_energy * float(np.sum(bounds.eta * stiff**2)))
        tilted = math.tan(ALPHA) * (1 + 2 * bounds.gamma + 2 * bounds.mass) / (1 + 2 * bounds.gamma)
        demand = a + 2 / (1 + 2 * bounds.gamma) * springs + tilted * vertical
        return tilted * G - demand

    low, high = 0.0, 20.0
    assert spare(low) > 0 > spare(high)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if spare(middle) > 0 else (low, middle)
    for a, certain in ((low * (1 - 1e-9), True), (high * (1 + 1e-9), False)):
        assert Bounds(podium, a, vertical, 0.0, swing).certain("peak", peak=0.0) is certain


@pytest.mark.parametrize("devices", [(), DEVICES, (rj.Tendon(5.0),)])
def test_nothing_is_certain_above_the_well(devices):
    """Nothing is final if the energy could reach the top of the potential well, or if the column is beyond
    it."""
    podium = RIGID.replace(restrainers=devices)
    bounds = Bounds(podium, 1.0, 0.0, 0.03, 0.0)
    top = math.sqrt(float(potential(bounds.c, jnp.ones(()), jnp.asarray(bounds.well))))
    start = math.sqrt(bounds.now)
    a = (top - start) / (math.sqrt(bounds.max_energy) - start)
    assert Bounds(podium, a * (1 - 1e-9), 0.0, 0.03, 0.0).certain("peak", peak=1.0)
    assert not Bounds(podium, a * (1 + 1e-9), 0.0, 0.03, 0.0).certain("peak", peak=1.0)


def test_an_uplift_after_all_peaks_are_certain():
    """The deformation of the first ten seconds remains the largest, and then a single sample of 5 m/s², above
    the threshold g tan α (½+γ+η)/(½+γ) = 1.623 m/s², lifts the columns."""
    t = np.arange(1750) * 0.02
    samples = np.where(t < 10.0, np.sin(np.pi * t), 0.0)
    samples[1500] = 5.0
    podium = rj.Podium(ALPHA, R, 10.0, rj.Elastic(1.0, 2.0, 0.05))
    for outputs in (("peak_deformation",), ("peak_rotation", "peak_deformation")):
        found = rj.peak_response(podium, rj.Record(samples, 0.02), options=rj.Options(outputs=outputs))
        assert bool(found.uplifted)
        assert 29.98 < float(found.uplift_time) < 30.0
        assert 0.1 < float(np.max(found.peak_deformation)) < 1.0
