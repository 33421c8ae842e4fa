"""Independent solution for blocks and oscillators on floors, with the motion of `tests.restrained` and its
own equations of a block and of an oscillator.

The floor's acceleration and its jumps come from the states between the events of the podium. Blocks and
oscillators are integrated with SciPy's DOP853 from event to event.
"""

import dataclasses
import math
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from tests import restrained
from tests.restrained import Frame, _event, _Motion

TIGHT: dict[str, Any] = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-15, "max_step": 0.01}


@dataclasses.dataclass
class Block:
    alpha: float
    R: float
    lam: float = 1 / 3
    vertical: bool = True
    e: float | None = None

    @property
    def restitution(self):
        return 1 - 2 * math.sin(self.alpha) ** 2 / (1 + self.lam) if self.e is None else self.e


@dataclasses.dataclass
class Found:
    peak: float = 0.0  # of α_c
    uplift_time: float = math.nan
    overturn_time: float = math.nan
    by_impulse: bool = False
    impacts: int = 0


class Stretches:
    """Observer of a scene that stores the stretches between events and the velocity jumps of the deck."""

    def __init__(self, frame: Frame):
        self.frame, self.stretches, self.jumps = frame, [], {}

    def stretch(self, s, found, clip):
        self.stretches.append((s, found, clip))

    def impact(self, s, y):
        f = self.frame
        across, up = 2 * f.R * math.cos(f.alpha) * y[1], 2 * f.R * math.sin(f.alpha) * abs(y[1])
        e = max(f.restitution, 0.0)
        self.jumps[len(self.stretches)] = -(1 - e) * across, (1 + e) * up


def floor_accelerations(m: _Motion, weights, s, found, clip, t: float) -> tuple[float, float]:
    """Return the horizontal and vertical acceleration of the floor with these mode weights."""
    f, y, inside = m.frame, found.sol(t), clip(t)
    rate = (m.rocking if s else m.contact)(inside, y, s)
    psi, theta_dot, theta_ddot = s * f.alpha - y[0], y[1], rate[1]
    deck, up = m.h(inside), m.v(inside)
    if s:
        deck += 2 * f.R * (theta_ddot * math.cos(psi) + theta_dot**2 * math.sin(psi))
        up += 2 * f.R * (theta_ddot * math.sin(psi) - theta_dot**2 * math.cos(psi))
    modes = rate[2 + m.n : 2 + 2 * m.n] + m.h(inside)
    weights = np.asarray(weights)
    return float(weights @ modes) + (1 - weights.sum()) * deck, up


def oscillators_on_floors(frame: Frame, periods, zeta: float, end, horizontal, vertical, *, floors, **scene):
    """Return max|x| of oscillators on each floor, and the time at which the podium overturned. A floor is a
    pair of mode weights and a direction, "horizontal" or "vertical"."""
    watch = Stretches(frame)
    answer = restrained.simulate(frame, end, horizontal, vertical, watch=watch, **scene)
    m, omega = _Motion(frame, horizontal, vertical), 2 * math.pi / np.asarray(periods)
    count, largest = omega.size, []
    turns = [_event(lambda t, y, *_, k=k: y[count + k], 0, False) for k in range(count)]

    def flow(t, y, weights, row, stretch: tuple[Any, Any, Any]):
        a = floor_accelerations(m, weights, *stretch, t)[row]
        return np.concatenate([y[count:], -a - 2 * zeta * omega * y[count:] - omega**2 * y[:count]])

    for weights, direction in floors:
        y, sizes, row = np.zeros(2 * count), np.zeros(count), int(direction == "vertical")
        for k, stretch in enumerate(watch.stretches):
            across, up = watch.jumps.get(k, (0.0, 0.0))
            y[count:] -= up if row else (1 - sum(weights)) * across
            times, arguments = stretch[1].t[[0, -1]], (weights, row, stretch)
            piece = solve_ivp(flow, times, y, events=turns, args=arguments, **TIGHT)
            y = piece.y[:, -1].copy()
            for j in range(count):
                tops = [abs(state[j]) for state in piece.y_events[j]]
                sizes[j] = max(sizes[j], *tops, abs(y[j]))
        largest.append(sizes)
    return np.array(largest), answer.overturn_time


def block_on_floor(frame: Frame, block: Block, end, horizontal, vertical=lambda t: 0.0, *, weights, **scene):
    """Return the response of a block on a floor; the arguments of the scene are those of
    `restrained.simulate`."""
    watch = Stretches(frame)
    restrained.simulate(frame, end, horizontal, vertical, watch=watch, **scene)
    m, out, b, g = _Motion(frame, horizontal, vertical), Found(), block, frame.g
    P2, tan, alpha = g / ((1 + b.lam) * b.R), math.tan(b.alpha), b.alpha
    phi, rate, side = 0.0, 0.0, 0
    for k, (s, found, clip) in enumerate(watch.stretches):
        across, up = watch.jumps.get(k, (0.0, 0.0))
        across, up = (1 - sum(weights)) * across, up if b.vertical else 0.0
        motion = lambda t, s=s, found=found, clip=clip: [
            y * (1.0, float(b.vertical))[i]
            for i, y in enumerate(floor_accelerations(m, weights, s, found, clip, t))
        ]
        t, stop = found.t[0], found.t[-1]
        if across or up:
            if side:
                psi = side * alpha - phi
                rate -= P2 / g * (math.cos(psi) * across + math.sin(psi) * up)
                if phi == 0 and side * rate < 0:
                    rate, side, out.impacts = b.restitution * rate, -side, out.impacts + 1
            elif abs(across) > up * tan:
                side = -int(np.sign(across))
                rate = side * P2 / g * (math.cos(alpha) * abs(across) - math.sin(alpha) * up)
                if math.isnan(out.uplift_time):
                    out.uplift_time, out.by_impulse = t, True

        def flow(t, y, motion=motion):
            a, a_w = motion(t)
            psi = side * alpha - y[0]  # noqa: B023
            return [y[1], -P2 * ((1 + a_w / g) * math.sin(psi) + a / g * math.cos(psi))]

        def demand(t, motion=motion):
            a, a_w = motion(t)
            return abs(a) - (g + a_w) * tan

        while t < stop:
            if not side:
                times = np.linspace(t, stop, max(3, math.ceil((stop - t) / 2e-4)))
                values = np.array([demand(x) for x in times])
                if values[0] > 0:
                    lifts = t
                elif np.any(values > 0):
                    j = int(np.argmax(values > 0))
                    lifts = float(brentq(demand, times[j - 1], times[j], xtol=1e-15))  # pyright: ignore[reportArgumentType]
                else:
                    break
                t, side = lifts, -int(np.sign(motion(lifts)[0]))
                phi = rate = 0.0
                out.uplift_time = t if math.isnan(out.uplift_time) else out.uplift_time
            events = [
                _event(lambda t, y, side=side: side * y[0], -1),
                _event(lambda t, y, side=side: side * y[0] - alpha, 1),
                _event(lambda t, y: y[1], 0, False),
            ]
            first = min(1e-6, stop - t) if phi == 0 else None
            piece = solve_ivp(flow, (t, stop), [phi, rate], events=events, first_step=first, **TIGHT)
            tops = [abs(y[0]) for y in piece.y_events[2]]
            out.peak = max(out.peak, *(y / alpha for y in [*tops, abs(piece.y[0, -1])]))
            t, phi, rate = piece.t[-1], *piece.y[:, -1]
            if piece.status != 1:
                t = stop
            elif len(piece.t_events[1]):
                out.overturn_time, out.peak = t, 1.0
                return out
            else:
                out.impacts += 1
                phi, rate = 0.0, b.restitution * rate
                side = int(np.sign(rate)) if abs(rate) > 1e-10 * math.sqrt(P2) * alpha else 0
                rate = rate if side else 0.0
    return out
