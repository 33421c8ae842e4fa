"""Synthetic ground motions: filtered white noise with an envelope, optionally with a velocity pulse.

The filter of Kanai (1957) and Tajimi (1960) is a soil layer with the frequency ω_g and damping ratio ζ_g. The
high-pass filter of Clough & Penzien (1993), with the frequency ω_f and damping ratio ζ_f, makes velocity and
displacement finite. If the white noise has the spectral density S_0, the filtered noise has the spectral
density S(ω) with

    S(ω)/S_0 = (1 + 4ζ_g² r²)/((1 − r²)² + 4ζ_g² r²) · s⁴/((1 − s²)² + 4ζ_f² s²),  r = ω/ω_g, s = ω/ω_f.

The envelope is that of Saragoni & Hart (1974) in the form of Boore (1983). For a motion of the duration t_n,
it has its maximum of 1 at the time ε t_n, and decreases to η at the time t_n. In the last 5 % of the
duration, it is also multiplied by a taper that ends at zero. The pulse follows Mavroeidis & Papageorgiou
(2003).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable

import numpy as np

from rockjax._checks import format_value, require_instance, require_number, require_whole
from rockjax._excitations.wavelets import MavroeidisPapageorgiou
from rockjax._machine.memory import require_memory
from rockjax._units import STANDARD_GRAVITY

from .convert import require_single
from .motion import Motion, Motions

_TAPER = 0.05  # length of the taper at the end of the envelope, divided by the duration


@dataclasses.dataclass(frozen=True)
class Soil:
    """Parameters of the spectral density. The defaults describe the firm soil of Der Kiureghian & Neuenhofer
    (1992).

    - `omega_g`, `zeta_g`: frequency [rad/s] and damping ratio [–] of the soil
    - `omega_f`, `zeta_f`: frequency [rad/s] and damping ratio [–] of the high-pass filter
    """

    omega_g: float = 15.0
    zeta_g: float = 0.6
    omega_f: float = 1.5
    zeta_f: float = 0.6


def spectral_density(omega, soil: Soil) -> np.ndarray:
    """Return S(ω)/S_0 [–] at the circular frequencies `omega` [rad/s], with the shape of `omega`."""
    r2, s2 = (omega / soil.omega_g) ** 2, (omega / soil.omega_f) ** 2
    ground = (1 + 4 * soil.zeta_g**2 * r2) / ((1 - r2) ** 2 + 4 * soil.zeta_g**2 * r2)
    return ground * s2**2 / ((1 - s2) ** 2 + 4 * soil.zeta_f**2 * s2)


def envelope(t: np.ndarray, duration: float, peak: float, end: float) -> np.ndarray:
    """Return Saragoni & Hart's envelope with the taper, shape (n,) [–].

    - `t`: times from 0 to the duration, shape (n,) [s]
    - `duration`: duration t_n [s]
    - `peak`: ε, the time at which the envelope is 1, divided by the duration [–]
    - `end`: η, the value at the end if there were no taper [–]
    """
    b = -peak * math.log(end) / (1 + peak * (math.log(peak) - 1))
    s = t / (peak * duration)
    with np.errstate(divide="ignore"):
        shape = np.exp(b * (1 + np.log(s) - s))
    taper = np.clip((duration - t) / (_TAPER * duration), 0, 1)
    return shape * 0.5 * (1 - np.cos(math.pi * taper))


def _normal(seed: int, k: int, count: int) -> np.ndarray:
    """Return `count` standard normal numbers for motion k. The method of Box & Muller computes them from bits
    of the generator PCG64, which are the same in every version of NumPy; the numbers of
    `Generator.standard_normal` may change."""
    bits = np.random.PCG64(np.random.SeedSequence([seed, k])).random_raw(2 * count)
    u, v = ((bits >> np.uint64(11)).astype(float) + 0.5).reshape(2, count) * 2.0**-53
    return np.sqrt(-2 * np.log(u)) * np.cos(2 * math.pi * v)


def _noise(seed: int, k: int, count: int, dt: float, soil: Soil) -> np.ndarray:
    """Return stationary noise for motion k (from 0), shape (count,) [–]. Its spectral density is proportional
    to `spectral_density`. The result of a filter by FFT is periodic. Therefore noise of twice the length is
    filtered, and its first half is returned."""
    white = np.fft.rfft(_normal(seed, k, 2 * count))
    omega = 2 * math.pi * np.fft.rfftfreq(2 * count, dt)
    return np.fft.irfft(white * np.sqrt(spectral_density(omega, soil)), 2 * count)[:count]


def _end_at_rest(acceleration: np.ndarray, dt: float, weight: np.ndarray, at_origin: bool) -> np.ndarray:
    """Return an acceleration, shape (n,) [m/s²], corrected so that the motion ends with zero velocity and,
    with `at_origin`, zero displacement. The subtracted correction is `weight`, shape (n,) [–], times a
    constant or, with `at_origin`, times a straight line."""

    def final_values(a):
        motion = Motion(a, dt)
        return np.array([motion.velocity[-1], motion.displacement[-1]][: 1 + at_origin])

    shapes = [weight * np.linspace(0, 1, len(weight)) ** k for k in range(1 + at_origin)]
    c = np.linalg.solve(
        np.stack([final_values(shape) for shape in shapes], axis=1), final_values(acceleration)
    )
    return acceleration - sum(factor * shape for factor, shape in zip(c, shapes, strict=True))


def synthetic_motions(
    count: int,
    *,
    seed: int,
    dt: float = 0.01,
    duration: float = 20.0,
    pga: float = 0.3 * STANDARD_GRAVITY,
    pulse: MavroeidisPapageorgiou | Iterable[MavroeidisPapageorgiou] | None = None,
    omega_g: float = 15.0,
    zeta_g: float = 0.6,
    omega_f: float = 1.5,
    zeta_f: float = 0.6,
    envelope_peak: float = 0.2,
    envelope_end: float = 0.05,
) -> Motions:
    """Return synthetic ground motions: Clough & Penzien's noise with Saragoni & Hart's envelope, and
    optionally a pulse.

    - `count`: number of motions, ≥ 1. A larger count adds motions and does not change the first ones
    - `seed`: whole number ≥ 0. Equal seeds give equal motions, up to rounding, with every version of NumPy
    - `dt`: sampling interval, > 0 [s]
    - `duration`: duration, at least 49 dt (50 samples) [s]
    - `pga`: peak acceleration of the noise, without the pulse, > 0 [m/s²]
    - `pulse`: a [`rockjax.MavroeidisPapageorgiou`][] for all motions, or a list with a pulse or None for each
      motion; None for no pulse. A pulse is centred on the peak of the envelope, or as near to this peak as
      the duration permits. Mavroeidis & Papageorgiou (2003) find an amplitude A of about 1 m/s close to the
      fault, and log10(1/f_p) = 0.5 M_w − 2.9 with the frequency f_p [Hz] and the moment magnitude M_w
    - `omega_g`, `zeta_g`: frequency [rad/s] and damping ratio [–] of the soil, > 0 (Kanai 1957, Tajimi 1960);
      15 rad/s and 0.6 describe firm soil
    - `omega_f`, `zeta_f`: frequency [rad/s] and damping ratio [–] of the high-pass filter, > 0 (Clough &
      Penzien 1993)
    - `envelope_peak`: time at which the envelope (Saragoni & Hart 1974) is 1, divided by the duration; > 0
      and < 1 [–]
    - `envelope_end`: value of the envelope at the end, > 0 and < 1 [–]. A taper reduces the envelope to zero
      in the last 5 % of the duration

    Velocity and displacement of the noise are zero at the start and at the end. For this purpose, the
    envelope times a straight line is subtracted from the acceleration. The velocity of the pulse is also zero
    at the end, but its displacement is not zero for every phase. The names are synthetic-0001,
    synthetic-0002, …. The metadata state that the motions are synthetic, and contain all parameters.

    Raises `ValueError` for parameters outside their ranges, and for a pulse longer than the motion.
    """
    positive = {"dt": dt, "duration": duration, "pga": pga}
    positive |= {"omega_g": omega_g, "zeta_g": zeta_g, "omega_f": omega_f, "zeta_f": zeta_f}
    owner = "synthetic_motions"
    for name, value in positive.items():
        require_number(owner, name, value, lambda v: v > 0, "finite and > 0")
    for name, value in {"envelope_peak": envelope_peak, "envelope_end": envelope_end}.items():
        require_number(owner, name, value, lambda v: 0 < v < 1, "> 0 and < 1")
    count, seed = require_whole(owner, "count", count, 1), require_whole(owner, "seed", seed, 0)
    samples = round(duration / dt) + 1
    if samples < 50:
        raise ValueError(
            f"synthetic_motions: duration must be at least 49 dt (50 samples), got {duration:g} s and dt = "
            f"{dt:g} s"
        )
    # Memory for the samples of the noise and of two filtered copies, 8 bytes each.
    require_memory(owner, count, 3 * 8 * samples, noun="motions", advice="request fewer or shorter motions")
    pulses = [pulse] * count if pulse is None or isinstance(pulse, MavroeidisPapageorgiou) else pulse
    if isinstance(pulses, str) or not isinstance(pulses, Iterable):
        raise ValueError(
            f"{owner}: pulse must be a rockjax.MavroeidisPapageorgiou or several, got {format_value(pulse)}"
        )
    pulses = list(pulses)
    for element in pulses:
        require_instance(
            owner,
            "pulse",
            element,
            MavroeidisPapageorgiou | None,
            "a rockjax.MavroeidisPapageorgiou or several",
        )
        if element is not None:
            require_single(owner, element, "pulse")
    if len(pulses) != count:
        raise ValueError(
            f"synthetic_motions: pulse must be one, or one for each of {count} motions, got {len(pulses)}"
        )
    soil = Soil(omega_g, zeta_g, omega_f, zeta_f)
    t = np.arange(samples) * dt
    weight = envelope(t, t[-1], envelope_peak, envelope_end)
    motions = []
    for k, pulse_k in enumerate(pulses):
        noise = weight * _noise(int(seed), k, samples, dt, soil)
        acceleration = _end_at_rest(noise, dt, weight, at_origin=True)
        acceleration *= pga / np.abs(acceleration).max()
        if pulse_k is not None:
            acceleration = acceleration + _pulse(pulse_k, t, envelope_peak)
        metadata = {
            "format": "synthetic",
            "event": "synthetic",
            "seed": int(seed),
            "motion": k + 1,
            "pga_m_s2": pga,
        }
        metadata |= {"model": "Clough-Penzien, Saragoni-Hart"} | dataclasses.asdict(soil)
        metadata |= {"envelope_peak": envelope_peak, "envelope_end": envelope_end}
        if pulse_k is not None:
            parameters = ("A", "f_p", "gamma", "nu")
            metadata |= {f"pulse_{name}": float(getattr(pulse_k, name)) for name in parameters}
        motions.append(Motion(acceleration, dt, f"synthetic-{k + 1:04d}", None, metadata))
    return Motions(tuple(motions))


def _pulse(pulse: MavroeidisPapageorgiou, t: np.ndarray, peak: float) -> np.ndarray:
    """Return the samples of a pulse [m/s²] at the times `t`, shape (n,) [s], from 0, corrected within its
    duration so that it ends with zero velocity. `peak` is the time of the peak of the envelope, divided by
    the duration [–]. Raises `ValueError` for a pulse that is longer than the motion."""
    A, f_p, gamma, nu = (float(x) for x in (pulse.A, pulse.f_p, pulse.gamma, pulse.nu))
    half = 0.5 * gamma / f_p
    if 2 * half > t[-1]:
        raise ValueError(
            f"synthetic_motions: a pulse of {2 * half:g} s does not fit into a duration of {t[-1]:g} s; "
            "raise the duration or shorten the pulse"
        )
    from_centre = t - min(max(peak * t[-1], half), t[-1] - half)
    is_inside = np.abs(from_centre) <= half
    omega = 2 * math.pi * f_p
    phase = omega * from_centre
    rate = np.sin(phase / gamma) * np.cos(phase + nu) / gamma
    rate += (1 + np.cos(phase / gamma)) * np.sin(phase + nu)
    window = np.where(is_inside, 1 + np.cos(phase / gamma), 0.0)
    samples = np.where(is_inside, -0.5 * A * omega * rate, 0.0)
    return _end_at_rest(samples, t[1] - t[0], window, at_origin=False)
