"""An independent implementation, written from the Lagrangian with masses in kg: SciPy's DOP853 at 1e-12.

Own right-hand sides, own events, own bookkeeping; nothing of the package but the numbers of a structure.
"""

import dataclasses
import math

import numpy as np
from scipy.integrate import solve_ivp

import rockjax as rj


@dataclasses.dataclass
class Answer:
    peak_rotation: float = 0.0
    peak_deformation: float = 0.0
    peak_shear: float = 0.0
    uplift_time: float = math.nan
    overturn_time: float = math.nan
    impact_times: list = dataclasses.field(default_factory=list)


def simulate(
    podium: rj.Podium, acceleration, start, end, breaks=(), initial=(0.0, 0.0, 0.0, 0.0), rest=1e-12
) -> Answer:
    alpha, R, g, lam = (float(getattr(podium, k)) for k in ("alpha", "R", "g", "lam"))
    top = podium.superstructure
    m_c, columns = 700.0, 2
    m_b = float(podium.gamma) * columns * m_c
    m_t = 0.0 if top is None else float(top.eta) * columns * m_c
    elastic = isinstance(top, rj.Elastic)
    if isinstance(top, rj.Rigid):
        m_b, m_t = m_b + m_t, 0.0
    w = 2 * math.pi / float(top.T_s) if elastic else 0.0
    z = float(top.zeta) if elastic else 0.0
    N = columns
    e = float(podium.restitution_factor)
    p = math.sqrt(3 * g / (4 * R))
    weight = 2 * R * g * (m_t + m_b + 0.5 * N * m_c)

    def force(s, y):
        """Spring and damper, V_s of Eq. (7) with the deformation against the beam."""
        th, om, u, ud = y
        psi = s * alpha - th
        u_b, v_b = 2 * R * (s * math.sin(alpha) - math.sin(psi)), 2 * R * om * math.cos(psi)
        return m_t * (w**2 * (u - u_b) + 2 * z * w * (ud - v_b)), u - u_b

    def rocking(t, y, s):
        th, om, _, ud = y
        psi = s * alpha - th
        sn, cs, a = math.sin(psi), math.cos(psi), acceleration(t)
        F, _ = force(s, y)
        # Eq. (23) with absolute masses
        inertia = 4 * R**2 * m_b + N * m_c * R**2 * (1 + lam) + 4 * R**2 * m_t * sn**2
        moment = (
            4 * R**2 * m_t * om**2 * cs * sn
            - weight * sn
            - 2 * R * a * (m_b + 0.5 * N * m_c) * cs
            + 2 * R * F * cs
        )
        return [om, moment / inertia, ud, -a - (F / m_t if m_t else 0.0)]

    def contact(t, y):
        return [0.0, 0.0, y[3], -acceleration(t) - 2 * z * w * y[3] - w**2 * y[2]]

    def demand(t, y):
        """Eq. (8), divided by the beam and half the columns."""
        return acceleration(t) - m_t * (w**2 * y[2] + 2 * z * w * y[3]) / (m_b + 0.5 * N * m_c)

    limit = g * math.tan(alpha) * (m_t + m_b + 0.5 * N * m_c) / (m_b + 0.5 * N * m_c)
    out = Answer(peak_rotation=abs(initial[0]) / alpha)
    y, t = np.array(initial, float), start
    s = int(np.sign(y[0]) or np.sign(y[1]))
    stops = sorted({b for b in breaks if start < b < end} | {end})
    eps = 1e-12
    while t < end:
        stop = next(b for b in stops if b > t)
        # One-sided at breakpoints: look just inside.
        if s == 0 and abs(demand(t + eps, y)) > limit:
            s = -int(np.sign(demand(t + eps, y)))
            if math.isnan(out.uplift_time):
                out.uplift_time = t
        before, s0 = t, s

        def clip(tt, lo=t, hi=stop):
            return min(max(tt, lo + eps), hi - eps)

        def inner(f, s0=s0, clip=clip):
            return lambda time, state: f(clip(time), state, s0) if s0 else f(clip(time), state)

        events = []
        if s:
            hit = lambda tt, yy, s=s: s * yy[0]
            hit.terminal, hit.direction = True, -1
            fall = lambda tt, yy, s=s: s * yy[0] - alpha
            fall.terminal, fall.direction = True, 1
            events = [hit, fall, lambda tt, yy: yy[1]]
            kick = rocking(t + eps, y, s)[1]
            hop = abs(y[1] / kick) if y[0] == 0 and y[1] * kick < 0 else 1.0
            first = min(1e-3 / p, 0.3 * hop, stop - t)
        else:
            lift = lambda tt, yy, clip=clip: abs(demand(clip(tt), yy)) - limit
            lift.terminal, lift.direction = True, 1
            events = [lift]
            first = min(1e-3, stop - t)
        flow = inner(rocking) if s else inner(contact)
        solution = solve_ivp(
            flow, (t, stop), y, method="DOP853", rtol=1e-12, atol=1e-14, events=events, first_step=first,
            max_step=0.02, dense_output=elastic,
        )  # fmt: skip
        if s:
            for yy in solution.y_events[2]:
                out.peak_rotation = max(out.peak_rotation, abs(yy[0]) / alpha)
        if elastic:
            tt = np.linspace(before, solution.t[-1], 40 * len(solution.t))
            path = solution.sol(tt)
            for name, f in (
                ("peak_deformation", lambda yy, s=s: abs(force(s, yy)[1])),
                ("peak_shear", lambda yy, s=s: abs(force(s, yy)[0]) / (m_t * g)),
            ):
                values = np.array([f(yy) for yy in path.T])
                k = int(values.argmax())
                best = values[k]
                if 0 < k < len(values) - 1:
                    # parabola through three samples a fortieth of a step apart
                    a_, b_, c_ = values[k - 1], values[k], values[k + 1]
                    best = b_ + (a_ - c_) ** 2 / (8 * (2 * b_ - a_ - c_)) if 2 * b_ > a_ + c_ else b_
                setattr(out, name, max(getattr(out, name), best))
        t, y = solution.t[-1], solution.y[:, -1].copy()
        out.peak_rotation = max(out.peak_rotation, abs(y[0]) / alpha)
        if solution.status != 1:
            t = stop
            continue
        if not s:
            s = -int(np.sign(demand(clip(t), y)))
            y[0] = y[1] = 0.0
            if math.isnan(out.uplift_time):
                out.uplift_time = t
        elif len(solution.t_events[1]):
            out.overturn_time, out.peak_rotation = t, 1.0
            break
        else:
            out.impact_times.append(t)
            y[0], y[1] = 0.0, max(e, 0.0) * y[1]
            if abs(y[1]) > rest * p * alpha:
                s = int(np.sign(y[1]))
            else:
                y[1], s = 0.0, 0
    return out
