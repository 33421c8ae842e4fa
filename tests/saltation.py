"""Gradients of peaks of a rigid block to 30 digits, from a separate integrator: `python -m tests.saltation`
writes the table.

This module does not use the package. A solitary block rocks under a sine or cosine of one period, from rest
or from a given state:

    θ'' = −(3g/4R) [sin(σα − θ) + (ü_g/g) cos(σα − θ)]

The solution is a Taylor series of order 40 with mpmath. Every coefficient carries its first derivatives with
respect to the parameters at fixed times (the variational equations, term by term). At an impact, where θ = 0,
the saltation matrix maps the derivatives: with δt = −δθ/θ̇ the state before becomes x⁺ = R(x⁻), δx⁺ = DR (δx⁻
+ f⁻ δt) − f⁺ δt. Where the ground motion has a jump or a kink, R is the identity and δt is the change of the
time of the jump or kink.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

TABLE = Path(__file__).with_name("saltation.json")
PARAMETERS = ("alpha", "R", "restitution", "a_p", "T_p", "theta_0", "theta_dot_0")
_SCENES = (
    ("sine", "OneSine", "0.2", "2.0", "0.93", "3.5", "1.1", "0.05", "0.1"),
    ("cosine, jump after the first impact", "OneCosine", "0.25", "1.5", "0.9", "-3.0", "0.8", "0.06", "0.0"),
    ("sine, after three impacts", "OneSine", "0.2", "2.0", "0.93", "-1.8", "1.5", "0.01", "0.0"),
)
SCENES: dict[str, dict[str, str]] = {
    name: dict(zip(("pulse", *PARAMETERS), numbers, strict=True)) for name, *numbers in _SCENES
}
G = "9.80665"
ORDER = 40
DIGITS = 50  # of the computation; the table has 30


class Dual:
    """A number and its derivatives with respect to the parameters."""

    def __init__(self, value, slopes):
        self.value, self.slopes = value, list(slopes)

    def __add__(self, other):
        return Dual(self.value + other.value, [a + b for a, b in zip(self.slopes, other.slopes, strict=True)])

    def __sub__(self, other):
        return self + other * -1

    def __mul__(self, other):
        if not isinstance(other, Dual):
            return Dual(self.value * other, [a * other for a in self.slopes])
        pairs = zip(self.slopes, other.slopes, strict=True)
        return Dual(self.value * other.value, [a * other.value + self.value * b for a, b in pairs])

    def __truediv__(self, other):
        ratio = self.value / other.value
        return Dual(
            ratio, [(a - ratio * b) / other.value for a, b in zip(self.slopes, other.slopes, strict=True)]
        )


def chain(value, slope, inner: Dual) -> Dual:
    """Return f(inner) as a dual, from the values of f and f' at inner."""
    return Dual(value, [slope * a for a in inner.slopes])


class Block:
    """A scene with its parameters as duals, and its motion as Taylor series."""

    def __init__(self, scene: dict[str, str]):
        from mpmath import mp

        self.mp = mp
        count = len(PARAMETERS)
        given = [mp.mpf(scene[name]) for name in PARAMETERS]
        unit = lambda k: [mp.mpf(int(i == k)) for i in range(count)]
        self.alpha, self.R, self.e, self.a_p, self.T_p, self.theta, self.rate = (
            Dual(value, unit(k)) for k, value in enumerate(given)
        )
        self.zero = Dual(mp.mpf(0), [mp.mpf(0)] * count)
        self.cosine = scene["pulse"] == "OneCosine"
        self.p2 = Dual(mp.mpf(3) * mp.mpf(G) / 4, [mp.mpf(0)] * count) / self.R
        self.omega = Dual(2 * mp.pi, [mp.mpf(0)] * count) / self.T_p
        self.shakes = True

    def ground(self, t, terms: int) -> list[Dual]:
        """Return the Taylor coefficients of ü_g/g at the fixed time t."""
        if not self.shakes:
            return [self.zero] * terms
        mp = self.mp
        angle = self.omega * t
        sin, cos = (
            chain(mp.sin(angle.value), mp.cos(angle.value), angle),
            chain(mp.cos(angle.value), -mp.sin(angle.value), angle),
        )
        # The shape and its derivative with respect to the angle.
        now, after = (cos, sin * -1) if self.cosine else (sin, cos)
        scale, series = self.a_p * (1 / mp.mpf(G)), []
        for k in range(terms):
            series.append(scale * now)
            now, after = after, now * -1
            scale = scale * self.omega * (mp.mpf(1) / (k + 1))
        return series

    def taylor(self, t, side: int, theta: Dual, rate: Dual) -> list[Dual]:
        """Return the Taylor coefficients of θ at the fixed time t."""
        mp = self.mp
        angle = self.alpha * side - theta
        sin = [chain(mp.sin(angle.value), mp.cos(angle.value), angle)]
        cos = [chain(mp.cos(angle.value), -mp.sin(angle.value), angle)]
        shaking = self.ground(t, ORDER)
        series = [theta, rate]
        for k in range(ORDER - 1):
            load = sin[k]
            for j in range(k + 1):
                load = load + shaking[j] * cos[k - j]
            series.append(self.p2 * load * (mp.mpf(-1) / ((k + 1) * (k + 2))))
            # (sin ψ)' = −θ' cos ψ, (cos ψ)' = θ' sin ψ
            s = c = self.zero
            for j in range(k + 1):
                s = s - series[j + 1] * cos[k - j] * (j + 1)
                c = c + series[j + 1] * sin[k - j] * (j + 1)
            sin.append(s * (mp.mpf(1) / (k + 1)))
            cos.append(c * (mp.mpf(1) / (k + 1)))
        return series


def state_at(series: list[Dual], h) -> tuple[Dual, Dual, Dual]:
    """Return (θ, θ̇, θ̈) a fixed time h after the centre of the expansion."""
    theta = rate = bend = series[0] * 0
    for k in reversed(range(len(series))):
        theta = theta * h + series[k]
        if k >= 1:
            rate = rate * h + series[k] * k
        if k >= 2:
            bend = bend * h + series[k] * (k * (k - 1))
    return theta, rate, bend


def root(f, low, high, mp):
    """Return the zero of f in [low, high] to working precision, by bisection and then secants."""
    below = f(low)
    for _ in range(60):
        middle = (low + high) / 2
        if f(middle) * below > 0:
            low = middle
        else:
            high = middle
    return mp.findroot(f, (low, high), tol=mp.mpf(10) ** (-2 * DIGITS + 12))


def solve(scene: dict[str, str], until: str = "2.6") -> dict[str, Any]:
    """Return the peak rotation divided by α, its time, and their gradients."""
    from mpmath import mp

    mp.dps = DIGITS
    block = Block(scene)
    theta, rate, t, step = block.theta, block.rate, mp.mpf(0), mp.mpf(1) / 16
    side, impacts = 1, []
    best: tuple[Any, Any, Dual] = (abs(theta.value), t, theta)
    end, pulse_end = mp.mpf(until), block.T_p
    while t < end:
        stop = pulse_end.value if block.shakes and t + step >= pulse_end.value else t + step
        series, h = block.taylor(t, side, theta, rate), stop - t
        angle = lambda s, series=series: state_at(series, s)[0].value
        speed = lambda s, series=series: state_at(series, s)[1].value
        falls = side * angle(h) < 0
        if falls:
            h = root(angle, h / 1000 if theta.value == 0 else mp.mpf(0), h, mp)
        if side * speed(mp.mpf(0)) > 0 > side * speed(h):
            top = root(speed, mp.mpf(0), h, mp)
            crest = state_at(series, top)[0]
            if abs(crest.value) > best[0]:
                best = (abs(crest.value), t + top, crest)
        before = state_at(series, h)
        theta, rate = before[0], before[1]
        t = t + h
        if falls:
            impacts.append(t)
            slip = Dual(mp.mpf(0), [-a / rate.value for a in theta.slopes])  # δt
            rate = block.e * (rate + slip * before[2].value)
            side, theta = -side, block.zero
            after = block.taylor(t, side, theta, rate)[2].value * 2
            theta, rate = theta - slip * rate.value, rate - slip * after
        elif block.shakes and stop == pulse_end.value:
            block.shakes = False
            after = block.taylor(t, side, theta, rate)[2].value * 2
            slip = Dual(mp.mpf(0), pulse_end.slopes)
            rate = rate + slip * (before[2].value - after)
    _, when, crest = best
    peak = (crest if crest.value > 0 else crest * -1) / block.alpha
    text = lambda x: mp.nstr(x, 30)
    return {
        **scene,
        "impacts": [text(x) for x in impacts],
        "peak_time": text(when),
        "peak_rotation": text(peak.value),
        "gradient": {name: text(slope) for name, slope in zip(PARAMETERS, peak.slopes, strict=True)},
    }


def main() -> None:
    answers = {name: solve(scene) for name, scene in SCENES.items()}
    TABLE.write_text(json.dumps(answers, indent=1) + "\n")
    print(json.dumps(answers, indent=1))


if __name__ == "__main__":
    main()
