"""Independent reference for floors: frames with a rigid top, no top or one elastic mode, and oscillators on
the deck or on the top, solved as one system of equations by SciPy's DOP853 with events."""

import math

import numpy as np
from scipy.integrate import solve_ivp

G = 9.80665


def largest_displacements(alpha, R, gamma, eta, T_s, zeta_s, e, a_p, T_p, t_end, periods, damping, on_top):
    """Return max|x| of oscillators under a symmetric Ricker pulse, from rest.

    - `eta`: mass ratio of the elastic top, 0 for none; `on_top`: whether oscillators stand on it
    """
    lam, count = 1 / 3, len(periods)
    p2 = 3 * G / (4 * R)
    omega, omega_s = 2 * math.pi / np.asarray(periods), 2 * math.pi / T_s
    start, tan = -2.5 * T_p, math.tan(alpha)

    def ground(t):
        s = 2 * math.pi**2 * t**2 / T_p**2
        return a_p * (1 - s) * math.exp(-s / 2)

    def spring(sigma, y):
        psi = sigma * alpha - y[0]
        u_b, v_b = 2 * R * (sigma * math.sin(alpha) - math.sin(psi)), 2 * R * y[1] * math.cos(psi)
        return omega_s**2 * (y[2] - u_b) + 2 * zeta_s * omega_s * (y[3] - v_b)

    def field(t, y, sigma):
        theta, theta_dot, u_dot = y[0], y[1], y[3]
        psi, u_g, force = sigma * alpha - theta, ground(t), spring(sigma, y)
        s, c = math.sin(psi), math.cos(psi)
        pull = 3 * eta / (2 * R) * force
        moment = s * (3 * eta * theta_dot**2 * c - p2 * (2 * eta + 2 * gamma + 1))
        moment += c * (pull - p2 * (2 * gamma + 1) / G * u_g)
        inertia = 3 * gamma + 0.75 * (1 + lam) + 3 * eta * s**2
        theta_ddot = abs(sigma) * moment / inertia
        deck = u_g + 2 * R * (theta_ddot * c + theta_dot**2 * s)
        x, x_dot = y[4 : 4 + count], y[4 + count :]
        a = -force if on_top else deck
        x_ddot = -a - 2 * damping * omega * x_dot - omega**2 * x
        return np.concatenate([[theta_dot * abs(sigma), theta_ddot, u_dot, -u_g - force], x_dot, x_ddot])

    def demand(t, y):
        return ground(t) - 2 * eta / (1 + 2 * gamma) * spring(0.0, y)

    threshold = G * tan * (1 + 2 * gamma + 2 * eta) / (1 + 2 * gamma)
    turns = [lambda t, y, sigma, k=k: y[4 + count + k] for k in range(count)]

    def closes(t, y, sigma):
        return sigma * y[0] if sigma else threshold - abs(demand(t, y))

    closes.terminal, closes.direction = True, -1  # pyright: ignore[reportFunctionMemberAccess]
    t, y, sigma, largest = start, np.zeros(4 + 2 * count), 0.0, np.zeros(count)
    while t < t_end:
        settings = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14, "max_step": 0.02}
        found = solve_ivp(field, (t, t_end), y, args=(sigma,), events=[closes, *turns], **settings)
        for k in range(count):
            at = [*(abs(z[4 + k]) for z in found.y_events[1 + k]), abs(found.y[4 + k, -1])]
            largest[k] = max(largest[k], *at)
        t, y = found.t[-1], found.y[:, -1].copy()
        if found.status != 1:
            break
        if sigma == 0:
            sigma = -np.sign(demand(t, y))
            y[0], y[1] = 1e-15 * sigma, 0.0
            continue
        y[0] = 0.0
        if not on_top:
            y[4 + count :] -= 2 * R * math.cos(alpha) * (e - 1) * y[1]
        y[1] *= e
        sigma = -sigma
        y[0] = 1e-18 * sigma
        assert abs(y[1]) > 1e-3, "the reference does not follow columns to rest"
    return largest
