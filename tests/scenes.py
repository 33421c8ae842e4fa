"""Structures, motions, an interrupting progress bar and a full disk that several tests use."""

import contextlib
import math
import signal

import jax
import numpy as np

import rockjax as rj
from rockjax._engine.scene import plan_for, prepare
from rockjax._engine.step import trial

G = 9.80665
ALPHA = math.atan(0.15)
PODIUMS = {
    "block": rj.Podium(alpha=0.3, R=2.0),
    "frame": rj.Podium(alpha=0.2, R=1.8, gamma=4.0, lam=0.3),
    "rigid": rj.Podium(alpha=ALPHA, R=1.5, gamma=10.0, superstructure=rj.Rigid(100.0)),
    "elastic": rj.Podium(alpha=ALPHA, R=1.5, gamma=10.0, superstructure=rj.Elastic(100.0, 0.5, 0.05)),
}


def elastic(T_s: float, eta: float = 100.0, zeta: float = 0.05) -> rj.Podium:
    return PODIUMS["elastic"].replace(superstructure=rj.Elastic(eta, T_s, zeta))


def pulse(kind=rj.Ricker, ratio: float = 2.5, T_p: float = 1.0):
    """Return a pulse with the amplitude ratio · g tan α for tan α = 0.15."""
    return kind(ratio * G * 0.15, T_p)


def shaking(n: int = 400, dt: float = 0.02, peak: float = 3.5, seed: int = 0) -> rj.Record:
    """Return a synthetic record: noise with an envelope, and a pulse."""
    rng = np.random.default_rng(seed)
    t = dt * np.arange(n)
    noise = np.convolve(rng.normal(size=n), np.hanning(9), mode="same")
    a = np.exp(-(((t - 2.5) / 1.5) ** 2)) * (np.sin(2 * np.pi * 1.1 * t) + 0.3 * noise / np.abs(noise).max())
    return rj.Record(peak * a / np.abs(a).max(), dt)


def options(rtol: float, method: str = "dopri8", **more) -> rj.Options:
    return rj.Options(rtol=rtol, atol=0.01 * rtol, method=method, **more)


def _operations(jaxpr) -> int:
    """Return the number of operations of a program, including the functions that it calls."""
    count = 0
    for equation in jaxpr.eqns:
        inner = [getattr(y, "jaxpr", y) for y in equation.params.values() if hasattr(y, "jaxpr")]
        count += sum(map(_operations, inner)) if inner else 1
    return count


def operations_of_trial(podium: rj.Podium, motion: rj.AbstractExcitation, options: rj.Options) -> int:
    """Return the number of operations of a trial step of a scene; an operation on a row of modes counts
    once."""
    structure = podium.split_rows()
    plan = plan_for(structure, options, history=False)
    start = lambda: prepare(structure, motion, rj.State(), None, options, plan)
    scene, state = jax.eval_shape(start)
    return _operations(jax.make_jaxpr(lambda scene, state: trial(scene, plan, state))(scene, state).jaxpr)


@contextlib.contextmanager
def limited_files(size):
    """Limit the size of files [bytes], so that writing fails as on a full disk."""
    import resource  # limits and signals are POSIX

    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)


class Stops:
    """Progress bar that interrupts the computation after a number of evaluations."""

    def __init__(self, after):
        self.left = after

    def update(self, count):
        self.left -= count
        if self.left == 0:
            raise KeyboardInterrupt
