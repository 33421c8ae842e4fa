"""Time of the first uplift under every pulse, compared with a root of a separate formula.

Long before a pulse, all states and derivatives are below rounding. A step whose length follows from the error
estimate could then jump into the pulse, and the columns would lift late. The pulses are written separately
here. Without an elastic superstructure, SciPy finds the uplift as a root of the pulse; with one, as a root of
the demand from Duhamel's integral.
"""

import itertools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import rockjax as rj
from rockjax._engine.fast_forward.rest import advance_to_uplift
from rockjax._engine.flat import is_running
from rockjax._engine.scene import plan_for, prepare
from rockjax._engine.step import step
from rockjax._responses.floor_course import without_fast_forwards

ALPHA, R, GAMMA, ETA = 0.15, 1.5, 10.0, 20.0
UPLIFT = 9.80665 * math.tan(ALPHA)
CYCLES, PHASE = 4.0, 0.7  # of the wavelets, Gabor and Mavroeidis–Papageorgiou
NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)
TIMES = (0.05, 0.8, 20.0)  # T_p [s]
RATIOS = (1.02, -1.6, 4.0, -30.0)  # a_p/(g tan α)


class Formula(NamedTuple):
    """ü_g/a_p as a function of t/T_p from `start` to `end`; zero outside if it is compact."""

    of: Callable
    start: float
    end: float
    compact: bool
    make: Callable[..., rj.AbstractExcitation]

    def __call__(self, tau):
        return np.where((tau >= self.start) & (tau <= self.end) | (not self.compact), self.of(tau), 0.0)


def _antisymmetric(tau):
    shape = lambda z: (z**2 - 3) * z * np.exp(-(z**2) / 2)
    return shape(2 * math.pi * tau / math.sqrt(3)) / -shape(math.sqrt(3 - math.sqrt(6)))


def _mavroeidis(tau, cycles=CYCLES):
    wide, turn = 2 * math.pi * tau / cycles, 2 * math.pi * tau + PHASE
    return -0.5 * (np.sin(wide) * np.cos(turn) / cycles + (1 + np.cos(wide)) * np.sin(turn))


def _gabor(tau, cycles=CYCLES):
    turn = 2 * math.pi * tau
    return np.exp(-0.5 * (turn / cycles) ** 2) * np.cos(turn + PHASE)


_sine, _cosine = (lambda tau: np.sin(2 * math.pi * tau)), (lambda tau: np.cos(2 * math.pi * tau))
_ricker = lambda tau: (1 - 2 * (math.pi * tau) ** 2) * np.exp(-((math.pi * tau) ** 2))
PULSES = {
    "Ricker": Formula(_ricker, -2.2, 2.2, False, rj.Ricker),
    "AntisymmetricRicker": Formula(_antisymmetric, -2.75, 2.75, False, rj.AntisymmetricRicker),
    "Gabor": Formula(_gabor, -5.8, 5.8, False, lambda a, T: rj.Gabor(a, T, CYCLES, PHASE)),
    "MavroeidisPapageorgiou": Formula(
        _mavroeidis, -0.5 * CYCLES, 0.5 * CYCLES, True,
        lambda a, T: rj.MavroeidisPapageorgiou(a * T / (2 * math.pi), 1 / T, CYCLES, PHASE),
    ),
    "OneSine": Formula(_sine, 0.0, 1.0, True, rj.OneSine),
    "OneCosine": Formula(_cosine, 0.0, 1.0, True, rj.OneCosine),
    "HalfSine": Formula(_sine, 0.0, 0.5, True, rj.HalfSine),
}  # fmt: skip


def first_root(over: Callable, start: float, end: float, samples: int) -> float:
    """Return the first upward zero of `over`; `start` if it begins above zero, NaN if it has none."""
    times = np.linspace(start, end, samples)
    above = np.flatnonzero(over(times) > 0)
    if not above.size:
        return math.nan
    k = above[0]
    root: Any = brentq(over, times[k - 1], times[k], xtol=1e-16) if k else start
    return float(root)


def uplifts() -> Callable:
    """Return a function motion ↦ time of the first uplift of a rigid podium, from the first step of the
    engine."""
    podium, options = rj.Podium(ALPHA, R, GAMMA), rj.Options()
    plan = plan_for(podium, options, history=False)

    @jax.jit
    def uplift(motion):
        scene, state = prepare(podium, motion, rj.State(), None, options, plan)
        return jnp.where(
            state.uplifted, state.uplift_time, advance_to_uplift(scene, plan, state)[0].uplift_time
        )

    return uplift


@pytest.mark.parametrize("name", PULSES)
def test_rigid_podiums_lift_at_the_root_of_the_pulse(name):
    pulse = PULSES[name]
    uplift = uplifts()
    for T_p in TIMES:
        for ratio in RATIOS:
            exact = first_root(lambda tau, a=ratio: abs(a * pulse(tau)) - 1, pulse.start, pulse.end, 2001)
            found = float(uplift(pulse.make(ratio * UPLIFT, T_p)))
            assert found == pytest.approx(exact * T_p, rel=1e-12, abs=1e-15 * T_p, nan_ok=True)
            assert not math.isnan(exact) or name == "MavroeidisPapageorgiou"


@pytest.mark.slow(but=["Ricker", "Gabor", "OneCosine"])
@pytest.mark.parametrize("name", PULSES)
def test_pairs_lift_at_the_root_of_the_combined_signal(name):
    """The combined signal is |ü_g| − v̈_g tan α; the vertical motion begins before or after the horizontal
    one. The other pulses are slow here; the test before has them alone."""
    pulse, ricker = PULSES[name], PULSES["Ricker"]
    pair = lambda ratio, T_p, T_v: rj.GroundMotion(pulse.make(ratio * UPLIFT, T_p), rj.Ricker(-6.0, T_v))
    uplift = uplifts()
    for T_p in TIMES:
        for ratio in RATIOS:
            for T_v in (0.3 * T_p, 2.0 * T_p):
                over = lambda tau, a=ratio, T_v=T_v / T_p: (
                    abs(a * pulse(tau)) + 6.0 / 9.80665 * ricker(tau / T_v) - 1
                )
                exact = first_root(over, pulse.start, pulse.end, 4001)
                found = float(uplift(pair(ratio, T_p, T_v)))
                assert found == pytest.approx(exact * T_p, rel=1e-12, abs=1e-14 * T_p, nan_ok=True)


@pytest.mark.parametrize("name", ["Gabor", "MavroeidisPapageorgiou"])
def test_full_contact_that_is_integrated_ends_at_the_root_of_the_wavelet(name):
    """No error estimate limits steps in full contact, but they are shorter than a period of the wavelet."""
    podium, options = rj.Podium(ALPHA, R, GAMMA), rj.Options()
    plan = without_fast_forwards(plan_for(podium, options, history=False))

    @jax.jit
    def uplift(a_p, T_p, cycles):
        pulses = {
            "Gabor": lambda: rj.Gabor(a_p, T_p, cycles, PHASE),
            "MavroeidisPapageorgiou": lambda: rj.MavroeidisPapageorgiou(
                a_p * T_p / (2 * math.pi), 1 / T_p, cycles, PHASE
            ),
        }
        scene, state = prepare(podium, pulses[name](), rj.State(), None, options, plan)
        is_still = lambda state: ~state.uplifted & is_running(state, 500)
        return jax.lax.while_loop(is_still, lambda state: step(scene, plan, state)[0], state).uplift_time

    shapes: dict[str, Callable] = {"Gabor": _gabor, "MavroeidisPapageorgiou": _mavroeidis}
    for cycles in (4.0, 12.0):
        start, end = (-1.45 * cycles, 1.45 * cycles) if name == "Gabor" else (-0.5 * cycles, 0.5 * cycles)
        highest = np.abs(shapes[name](np.linspace(start, end, 100_001), cycles)).max()
        for T_p, ratio in itertools.product((0.3, 0.6), (1.02, 1.04, -1.1)):
            a_p = ratio / highest
            over = lambda tau, a=a_p, cycles=cycles: np.abs(a * shapes[name](tau, cycles)) - 1
            exact = first_root(over, start, end, 20_001)
            found = float(uplift(a_p * UPLIFT, T_p, cycles))
            assert found == pytest.approx(exact * T_p, abs=1e-6 * T_p)


class Oscillator(NamedTuple):
    """A superstructure on columns in full contact, in units of the pulse's period."""

    turn: float  # ω_s T_p
    zeta: float

    def over(self, pulse: Formula, ratio: float, tau: float, upwards: float = 0.0) -> float:
        """Return |q| divided by its threshold, minus 1 and v̈_g/g, with q from Duhamel's integral by Gauss's
        rule on short panels."""
        length = min(1 / 6, math.pi / self.turn)
        edges = np.linspace(pulse.start, tau, 2 + math.ceil((tau - pulse.start) / length))
        half = 0.5 * np.diff(edges)[:, None]
        s = edges[:-1, None] + half * (1 + NODES)
        ago = tau - s
        decay, damped = np.exp(-self.zeta * self.turn * ago), self.turn * math.sqrt(max(1 - self.zeta**2, 0))
        if damped:
            sine = np.sin(damped * ago) / damped
            kernel = decay * sine
            rate = decay * (np.cos(damped * ago) - self.zeta * self.turn * sine)
        else:
            kernel, rate = decay * ago, decay * (1 - self.turn * ago)
        push = half * WEIGHTS * ratio * pulse(s)
        u, speed = -np.sum(push * kernel), -np.sum(push * rate)
        spring = self.turn**2 * u + 2 * self.zeta * self.turn * speed
        q = ratio * pulse(tau) - 2 * ETA / (1 + 2 * GAMMA) * spring
        return float(abs(q)) * (1 + 2 * GAMMA) / (1 + 2 * GAMMA + 2 * ETA) - 1 - upwards


def elastic_scenes(
    pulse: Formula, vertical: float = 0.0, n: int = 24
) -> tuple[rj.Podium, Any, np.ndarray, list[float]]:
    """Return podiums with stiff to soft superstructures, half of them critically damped, their pulses and
    their uplift times divided by T_p. `vertical` is the amplitude of a vertical Ricker pulse of 0.7 T_p
    divided by g."""
    rng = np.random.default_rng(3)
    T_p, period = rng.uniform(0.1, 3.0, n), np.exp(rng.uniform(math.log(0.05), math.log(10.0), n))
    zeta = np.where(np.arange(n) % 2, 1.0, 0.05)
    ratio = rng.uniform(1.3, 4.0, n) * np.maximum(1.0, np.minimum(period, 5.0)) * rng.choice([-1, 1], n)
    podium = rj.Podium(ALPHA, R, GAMMA, rj.Elastic(np.full(n, ETA), period * T_p, zeta))
    exact = []
    for k in range(n):
        top = Oscillator(2 * math.pi / period[k], zeta[k])
        over = np.vectorize(
            lambda tau, top=top, k=k: top.over(
                pulse, ratio[k], tau, vertical * float(PULSES["Ricker"](tau / 0.7))
            )
        )
        exact.append(first_root(over, pulse.start, pulse.end - 1e-12, 400))
    motion = pulse.make(ratio * UPLIFT, T_p)
    if vertical:
        motion = rj.GroundMotion(motion, rj.Ricker(np.full(n, vertical * 9.80665), 0.7 * T_p))
    return podium, motion, T_p, exact


@pytest.mark.slow(but=["Ricker-dopri8"])
@pytest.mark.parametrize(
    ("name", "method"),
    [*((name, "dopri8") for name in PULSES), ("Ricker", "tsit5"), ("Gabor", "dopri5"), ("Ricker", "bosh3")],
)
def test_elastic_podiums_lift_when_the_demand_says(name, method):
    podium, motion, T_p, exact = elastic_scenes(PULSES[name])
    for rtol in (1e-6, 1e-8) if method == "bosh3" else (1e-6, 1e-8, 1e-10, 1e-12):
        options = rj.Options(rtol=rtol, atol=0.01 * rtol, method=method, outputs=("peak_rotation",))
        found = np.asarray(rj.peak_responses(podium, motion, options=options).uplift_time)
        # A stiff superstructure moves little, so `atol` matters more than `rtol`.
        within = {"dopri8": 20, "bosh3": 2000}.get(method, 100) * rtol + 2e-13
        np.testing.assert_allclose(found / T_p, exact, rtol=0, atol=within)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Ricker", "Gabor", "OneSine"])
def test_elastic_podiums_under_pairs_lift_when_the_demand_says(name):
    podium, motion, T_p, exact = elastic_scenes(PULSES[name], vertical=-0.4)
    for rtol in (1e-8, 1e-12):
        options = rj.Options(rtol=rtol, atol=0.01 * rtol, outputs=("peak_rotation",))
        found = np.asarray(rj.peak_responses(podium, motion, options=options).uplift_time)
        np.testing.assert_allclose(found / T_p, exact, rtol=0, atol=20 * rtol + 2e-13)
