"""Independent computation of joint forces from free bodies.

Columns, beam and floors are separate rigid bodies and point masses, cut free at every joint. Their equations
of motion are one linear system for θ̈ and the joint forces of all columns. The motion comes from
`tests.restrained`. Masses are divided by the mass of a column.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.linalg

import rockjax as rj
from tests import restrained
from tests.restrained import Frame


@dataclasses.dataclass
class Mass:
    """A floor or a mode: a point mass per column, its height above the tops of the columns [m], and its
    displacement for a unit deformation of each mode."""

    mass: float
    height: float
    shape: tuple[float, ...] = ()


@dataclasses.dataclass
class Device:
    """A device of each column: force, stiffness, coefficient and exponent of the damper, and inertance,
    divided by m_c."""

    force: float = 0.0
    stiffness: float = 0.0
    coefficient: float = 0.0
    exponent: float = 1.0
    inertance: float = 0.0

    def pull(self, length, rate, bend):
        """Return the force at an elongation with its rate; `bend` is the part of the second rate that does
        not contain θ̈."""
        damper = self.coefficient * np.abs(rate) ** self.exponent * np.sign(rate)
        return self.force + self.stiffness * length + damper + self.inertance * bend


@dataclasses.dataclass
class Forces:
    """Forces on the bodies above the joints divided by m_c, axes (times, joints, columns), bottom joint
    first."""

    T: np.ndarray
    N: np.ndarray
    theta_ddot: np.ndarray
    eccentricity: np.ndarray
    V: np.ndarray
    W: np.ndarray


@dataclasses.dataclass
class Structure:
    """A podium, for the motion and for the forces.

    - `frame`: the podium for the motion, with equivalent devices over both joints and dampers of one exponent
    - `over_both`, `over_one`: devices over both joints, and in the bottom joint
    """

    frame: Frame
    masses: tuple[Mass, ...]
    positions: tuple[float, ...] = ()  # empty: forces of the mean column
    over_both: tuple[Device, ...] = ()
    over_one: tuple[Device, ...] = ()

    @property
    def x(self) -> np.ndarray:
        x = np.array(self.positions or (0.0,))
        return x - x.mean()

    @property
    def weight(self) -> float:
        """The total weight per column, divided by m_c."""
        return (1 + sum(m.mass for m in self.masses)) * self.frame.g

    # ------------------------------------------------------------------------------------------ joint forces
    def forces(self, s: int, y: np.ndarray, h: np.ndarray, v: np.ndarray) -> Forces:
        """Return the forces in states y (times, …) of `restrained`, under the ground accelerations h and
        v."""
        return self._rocking(s, y, h, v) if s else self._contact(y, h, v)

    def _modes(self, s: int, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the deformations of the modes, and the accelerations of the beam due to their springs,
        (times, modes)."""
        f, n = self.frame, len(self.frame.modes)
        w = np.array([2 * math.pi / k[1] for k in f.modes])
        z = np.array([k[2] for k in f.modes])
        psi = s * f.alpha - y[:, 0]
        u_b = 2 * f.R * (s * math.sin(f.alpha) - np.sin(psi))
        rate_b = 2 * f.R * y[:, 1] * np.cos(psi)
        d = y[:, 2 : 2 + n] - u_b[:, None]
        rate = y[:, 2 + n : 2 + 2 * n] - rate_b[:, None]
        return d, w**2 * d + 2 * z * w * rate

    def _rocking(self, s, y, h, v) -> Forces:
        f, x, times = self.frame, self.x, len(y)
        n = len(x)
        B, H = f.R * math.sin(f.alpha), f.R * math.cos(f.alpha)
        theta, omega = y[:, 0], y[:, 1]
        c, sn, g_v = np.cos(theta), np.sin(theta), f.g + v
        turned = lambda a, b: (
            a * c + b * sn,
            -a * sn + b * c,
        )  # a vector of the column, rotated clockwise by θ
        centre = turned(
            -s * B, H
        )  # from the edge on the ground; the edge at the beam is as far from the centre
        by_theta, by_theta2 = turned(H, s * B), tuple(-q for q in centre)
        # The centre of a joint opens by 2B sin(|θ|/2), which is the elongation of its devices.
        along = np.sin(theta / 2), np.cos(theta / 2)
        opening = 2 * B * np.sin(s * theta / 2)
        rate = s * B * np.cos(theta / 2) * omega
        bend, per = (
            -0.5 * B * np.sin(s * theta / 2) * omega**2,
            s * B * np.cos(theta / 2),
        )  # second rate
        both, both_per = np.zeros(times), np.zeros(times)
        for each in self.over_both:  # devices across both joints
            both, both_per = (
                both + each.pull(2 * opening, 2 * rate, 2 * bend),
                both_per + each.inertance * 2 * per,
            )
        one, one_per = both, both_per
        for each in self.over_one:
            one, one_per = one + each.pull(opening, rate, bend), one_per + each.inertance * per
        # Unknowns: T and N below, T and N above of all columns, θ̈. Rows: forces and moments of the columns.
        system, right = np.zeros((times, 4 * n + 1, 4 * n + 1)), np.zeros((times, 4 * n + 1))
        angular, row = 4 * n, 0
        feet, heads = turned(0.0, -H), turned(0.0, H)  # middles of both faces from the centre
        couple = lambda f_b, f_t: (
            -(feet[0] * along[1] - feet[1] * along[0]) * f_b
            + (heads[0] * along[1] - heads[1] * along[0]) * f_t
        )
        for i in range(n):
            tb, nb, tt, nt = (i + k * n for k in range(4))
            for k, (below, above) in enumerate(((tb, tt), (nb, nt))):
                system[:, row, below], system[:, row, above] = 1.0, -1.0
                system[:, row, angular] = -by_theta[k] - along[k] * (one_per - both_per)
                right[:, row] = (h, g_v)[k] + by_theta2[k] * omega**2 + along[k] * (one - both)
                row += 1
            system[:, row, tb], system[:, row, nb] = centre[1], -centre[0]  # at −centre
            system[:, row, tt], system[:, row, nt] = centre[1], -centre[0]  # the opposite at +centre
            system[:, row, angular] = f.lam * f.R**2 + couple(one_per, both_per)
            right[:, row] = -couple(one, both)
            row += 1
        # Beam and floors: the part of their forces that is proportional to θ̈, and the rest.
        beam, beam_per = h + 2 * by_theta2[0] * omega**2, 2 * by_theta[0]
        rise, rise_per = g_v + 2 * by_theta2[1] * omega**2, 2 * by_theta[1]
        d, springs = self._modes(s, y)
        tops, heights = np.zeros((2, times)), np.zeros((2, times))
        total = 0.0
        shift = np.zeros((2, times))
        for m in self.masses:
            shape = np.array(m.shape)
            part = 1.0 - shape.sum()
            across = np.stack([part * beam - springs @ shape if len(shape) else beam, part * beam_per])
            tops, heights = tops + m.mass * across, heights + m.mass * m.height * across
            total += m.mass
            if len(shape):
                shift += m.mass * (d @ shape) * np.stack([rise, rise_per])
        for k, (first, expected, rates) in enumerate(
            ((2 * n, tops[0], tops[1]), (3 * n, total * rise, total * rise_per))
        ):
            system[:, row, first : first + n] = 1.0
            system[:, row, angular] = -n * (rates + along[k] * both_per)
            right[:, row] = n * (expected + along[k] * both)
            row += 1
        if n > 1:
            # The contacts of the beam are at a distance B from the centre lines; moments are about the mean
            # of the column tops.
            system[:, row, 3 * n : 4 * n] = x - s * B
            system[:, row, angular] = n * (heights[1] - shift[1])
            right[:, row] = n * (shift[0] - heights[0])
            row += 1
        row = self._share(system, row)
        assert row == 4 * n + 1
        found = np.linalg.solve(system, right[..., None])[..., 0]
        found_T, found_N = _joints(found, n)
        f_b = one + one_per * found[:, angular]
        V, W = (q[:, 0].mean(axis=-1) - f_b * a for q, a in zip((found_T, found_N), along, strict=True))
        return Forces(found_T, found_N, found[:, angular], np.full(times, float(s)), V, W)

    def _share(self, system: np.ndarray, row: int) -> int:
        """Return the share of each column under a rigid beam on equally stiff columns: N at the top is linear
        in the position of the column."""
        n = len(self.x)
        if n > 2:
            free = scipy.linalg.null_space(np.stack([np.ones(n), self.x]))
            for column in free.T:
                system[..., row, 3 * n : 4 * n] = column
                row += 1
        return row

    def _faces(self, tangent, normal, spin, tops, rise, moment, pulls, side=1.0):
        """Return the resultants of faces in contact with a common eccentricity: forces or impulses (times,
        4n), and ξ.

        - `tangent`, `normal`, `spin`: resultant force and moment (clockwise) on each column
        - `tops`, `rise`, `moment`: resultant on the beam with its floors, per column; the moment
          anticlockwise
        - `pulls`: forces of the devices at the bottom and at the top
        """
        f, x, times = self.frame, self.x, len(tangent)
        n = len(x)
        B, H = f.R * math.sin(f.alpha), f.R * math.cos(f.alpha)

        def solved(xi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            system, right = np.zeros((times, 4 * n, 4 * n)), np.zeros((times, 4 * n))
            moments, row = np.zeros((times, n, 4 * n)), 0
            for i in range(n):
                tb, nb, tt, nt = (i + k * n for k in range(4))
                system[:, row, tb], system[:, row, tt], right[:, row] = 1.0, -1.0, tangent
                row += 1
                system[:, row, nb], system[:, row, nt] = 1.0, -1.0
                right[:, row] = normal + pulls[0] - pulls[1]
                row += 1
                moments[:, i, tb] = moments[:, i, tt] = -H  # clockwise
                moments[:, i, nb] = moments[:, i, nt] = -side * xi * B
            for i in range(n - 1):
                system[:, row] = moments[:, i + 1] - moments[:, i]
                row += 1
            for first, expected in ((2 * n, tops), (3 * n, rise + pulls[1])):
                system[:, row, first : first + n], right[:, row] = 1.0, n * expected
                row += 1
            if n > 1:
                system[:, row, 3 * n : 4 * n] = x - (side * xi * B)[:, None]
                right[:, row] = n * moment
                row += 1
            row = self._share(system, row)
            assert row == 4 * n
            found = np.linalg.solve(system, right[..., None])[..., 0]
            return found, np.einsum("tij,tj->t", moments, found) - n * spin

        zero, one = np.zeros(times), np.ones(times)
        off, less = solved(zero)[1], solved(one)[1]
        xi = off / (off - less)  # the sum of all moments is linear in it
        return solved(xi)[0], xi

    def _contact(self, y, h, v) -> Forces:
        f, n = self.frame, len(self.x)
        d, springs = self._modes(0, y)
        g_v, none = f.g + v, np.zeros(len(y))
        tops, moment, total = none, none, 0.0
        for m in self.masses:
            shape = np.array(m.shape)
            across = (1.0 - shape.sum()) * h - (springs @ shape if len(shape) else 0.0)
            tops, total = tops + m.mass * across, total + m.mass
            moment = moment - m.mass * m.height * across + m.mass * g_v * (d @ shape if len(shape) else 0.0)
        both = sum(each.force for each in self.over_both)
        one = both + sum(each.force for each in self.over_one)
        found, xi = self._faces(h, g_v, none, tops, total * g_v, moment, (one, both))
        T, N = _joints(found, n)
        return Forces(T, N, none, xi, T[:, 0].mean(axis=-1), N[:, 0].mean(axis=-1) - one)

    # ------------------------------------------------------------------------------------------- impulses
    def impulses(self, s: int, y: np.ndarray, e: float | None = None):
        """Return (J_T, J_N), each (joints, columns), and ξ_J at an impact, from the contact mode `s` and the
        state `y` before it."""
        f, n = self.frame, len(self.x)
        e = max(f.restitution, 0.0) if e is None else e
        B, H = f.R * math.sin(f.alpha), f.R * math.cos(f.alpha)
        before, after = y[1], e * y[1]
        # Velocities of the centres of columns; the beam is twice as fast.
        across, up = H * after - H * before, -s * B * after - s * B * before
        y = np.array([y], float)
        y[0, 0] = 0.0
        d = self._modes(s, y)[0][0]
        tops = rise = moment = 0.0
        for m in self.masses:
            shape = np.array(m.shape)
            jump = (1.0 - shape.sum()) * 2 * across  # modes do not jump
            tops, rise = tops + m.mass * jump, rise + m.mass * 2 * up
            moment += m.mass * (2 * up * (d @ shape if len(shape) else 0.0) - m.height * jump)
        both = sum(each.inertance for each in self.over_both) * 2 * up
        one = both + sum(each.inertance for each in self.over_one) * up
        row = lambda q: np.array([float(q)])
        spin = f.lam * f.R**2 * (after - before)
        found, xi = self._faces(
            row(across), row(up), row(spin), row(tops), row(rise), row(moment), (one, both), -float(s)
        )
        T, N = _joints(found, n)
        return T[0], N[0], float(xi[0])


def _joints(found: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return T and N with axes (times, joints, columns)."""
    parts = found[:, : 4 * n].reshape(len(found), 2, 2, n)
    return parts[:, :, 0], parts[:, :, 1]


# -------------------------------------------------------------------------------------- peaks of scenes
@dataclasses.dataclass
class Peaks:
    """Peaks of a scene in the form of the package: joints along an axis, worst column."""

    friction: Any = None  # angles; `finish` converts them
    least_axial: Any = None
    most_axial: Any = None
    shear: float = 0.0
    impact_friction: Any = None
    least_share: Any = None
    least_axial_time: Any = None
    friction_time: Any = None
    answer: Any = None


class _Watch:
    """Observer that collects peaks over the stretches of a scene."""

    def __init__(self, structure: Structure, horizontal: Callable, vertical: Callable, per_step: int):
        self.structure, self.h, self.v, self.per_step = structure, horizontal, vertical, per_step
        self.best: np.ndarray | None = None
        self.when: np.ndarray | None = None
        self.of_impacts = np.array([0.0, 0.0, -1.0, -1.0])

    def quantities(self, s: int, found, clip, t: np.ndarray) -> np.ndarray:
        """Return, along the first axis, the angles, −N and N of both joints and |V|, each of the worst
        column."""
        inside = np.array([clip(time) for time in t])
        h = np.array([self.h(time) for time in inside])
        v = np.array([self.v(time) for time in inside])
        y = found.sol(t).T
        if t[0] == found.t[0]:
            y[0] = found.y[:, 0]
        if t[-1] == found.t[-1]:
            y[-1] = found.y[:, -1]
        f = self.structure.forces(s, y, h, v)
        bare = (np.abs(f.T) < 1e-13) & (np.abs(f.N) < 1e-13)
        angles = np.where(bare, 0.0, np.arctan2(np.abs(f.T), f.N))
        rows = [angles.max(axis=-1), (-f.N).max(axis=-1), f.N.max(axis=-1), np.abs(f.V)[:, None]]
        return np.concatenate(rows, axis=-1).T

    def stretch(self, s: int, found, clip) -> None:
        steps = np.linspace(0.0, 1.0, self.per_step, endpoint=False)
        t = (found.t[:-1, None] + np.diff(found.t)[:, None] * steps).ravel()
        t = np.append(t, found.t[-1])
        values = self.quantities(s, found, clip, t)
        best = values.max(axis=1)
        places = values.argmax(axis=1)
        when = t[places]
        if self.best is None or self.when is None:
            self.best, self.when = np.full(len(best), -np.inf), np.full(len(best), np.nan)
        for q, k in enumerate(places):
            if not 0 < k < len(t) - 1 or best[q] < self.best[q] - 1e-2 * abs(self.best[q]):
                continue
            at = lambda time, q=q: self.quantities(s, found, clip, time)[q]
            best[q], when[q] = _zoom(at, float(t[k - 1]), float(t[k + 1]))
        more = best > self.best
        self.when, self.best = np.where(more, when, self.when), np.where(more, best, self.best)

    def impact(self, s: int, y: np.ndarray) -> None:
        T, N, _ = self.structure.impulses(s, y)
        bare = np.abs(N) < 1e-14 * np.abs(N).max()
        angles = np.where(bare, 0.0, np.arctan2(np.abs(T), N)).max(axis=-1)
        share = np.where(bare, 1.0, N / np.where(bare, 1.0, N.mean(axis=-1, keepdims=True))).min(axis=-1)
        self.of_impacts = np.maximum(self.of_impacts, np.concatenate([angles, -share]))


def _zoom(values: Callable, low: float, high: float) -> tuple[float, float]:
    """Return the largest value between two times, and its time, from two finer grids and a parabola."""
    near = found = np.zeros(3)
    k = 1
    for _ in range(2):
        near = np.linspace(low, high, 33)
        found = values(near)
        k = min(max(int(found.argmax()), 1), len(near) - 2)
        low, high = near[k - 1], near[k + 1]
    a, b, c = found[k - 1 : k + 2]
    top = b + (a - c) ** 2 / (8 * (2 * b - a - c)) if 2 * b > a + c else b
    return max(found.max(), top), float(near[k])


def peaks(structure: Structure, end, horizontal, vertical=lambda t: 0.0, per_step: int = 6, **scene) -> Peaks:
    """Return the peaks of one scene; the arguments are those of `restrained.simulate`."""
    watch = _Watch(structure, horizontal, vertical, per_step)
    answer = restrained.simulate(structure.frame, end, horizontal, vertical, watch=watch, **scene)
    best, g = watch.best, structure.frame.g
    assert best is not None
    assert watch.when is not None
    friction = lambda angles: np.where(angles < math.pi / 2, np.tan(np.minimum(angles, 1.57)), np.inf)
    return Peaks(
        friction(best[:2]), -best[2:4] / g, best[4:6] / g, best[6] / structure.weight,
        friction(watch.of_impacts[:2]), -watch.of_impacts[2:],
        watch.when[2:4], watch.when[:2], answer,
    )  # fmt: skip


# -------------------------------------------------------------------------------------- from podiums
def structure_of(podium: rj.Podium) -> Structure:
    """Return the structure with the parameters of a podium."""
    alpha, R, gamma, lam, g = (float(getattr(podium, name)) for name in ("alpha", "R", "gamma", "lam", "g"))
    p = math.sqrt(0.75 * g / R)
    elevation, top = podium.elevation, podium.superstructure
    assert elevation is None or isinstance(elevation, rj.Elevation)
    depth = 0.0 if elevation is None else float(elevation.beam_depth)
    given = np.zeros(1) if elevation is None else np.atleast_1d(np.asarray(elevation.top_height, float))
    masses, modes, residual = [Mass(gamma, 0.5 * depth)], (), 0.0
    if isinstance(top, rj.Rigid):
        masses.append(Mass(float(top.eta), depth + given[0]))
        residual = float(top.eta)
    elif isinstance(top, rj.Elastic):
        modes = ((float(top.eta), float(top.T_s), float(top.zeta)),)
        masses.append(Mass(float(top.eta), depth + given[0], (1.0,)))
    elif isinstance(top, rj.Modes | rj.ShearBuilding):
        form = top if isinstance(top, rj.Modes) else top.modes
        zeta = np.broadcast_to(form.zeta, np.shape(form.eta))
        modes = tuple(tuple(map(float, row)) for row in zip(form.eta, form.T, zeta, strict=True))
        residual = float(form.residual)
        if isinstance(top, rj.Modes):
            heights = np.broadcast_to(given, len(modes))
            for k, row in enumerate(modes):
                masses.append(Mass(row[0], depth + heights[k], tuple(np.eye(len(modes))[k])))
            above = 0.0 if elevation is None else float(elevation.residual_height)
            masses.append(Mass(residual, depth + above, (0.0,) * len(modes)))
        else:
            floors = given if top.heights is None else np.cumsum(np.asarray(top.heights, float))
            floors = np.broadcast_to(floors, len(np.asarray(top.masses)))
            shapes = np.asarray(top.shapes)[:, : len(modes)]
            for m, height, shape in zip(np.asarray(top.masses), floors, shapes, strict=True):
                masses.append(Mass(float(m), depth + float(height), tuple(map(float, shape))))
    equivalent, nu = np.zeros(4), 1.0
    over: dict[int, list[Device]] = {1: [], 2: []}
    for each in podium.restrainers:
        if isinstance(each, rj.Tendon):
            P, stiffness = float(each.prestress), float(each.stiffness)
            device, parts = Device(g * P, g / R * stiffness), (0.5 * P, 0.25 * stiffness, 0.0, 0.0)
            groups = P, stiffness, 0.0, 0.0
        elif isinstance(each, rj.Damper):
            nu, delta = float(each.exponent), float(each.coefficient)
            device = Device(coefficient=g * delta / (R * p) ** nu, exponent=nu)
            groups, parts = (0.0, 0.0, delta, 0.0), (0.0, 0.0, delta / 2 ** (1 + nu), 0.0)
        else:
            assert isinstance(each, rj.Inerter)
            mu = float(each.inertance)
            device, groups, parts = Device(inertance=mu), (0.0, 0.0, 0.0, mu), (0.0, 0.0, 0.0, mu / 4)
        over[each.joints].append(device)
        equivalent += groups if each.joints == 2 else parts
    tau, kappa, delta, mu = map(float, equivalent)
    e = float(podium.restitution_factor)
    frame = Frame(
        alpha, R, gamma if modes else gamma + residual, lam, modes, residual if modes else 0.0,
        (), tau, kappa, delta, nu, mu, e, g,
    )  # fmt: skip
    positions = () if elevation is None else tuple(map(float, np.asarray(elevation.columns)))
    return Structure(frame, tuple(masses), positions, tuple(over[2]), tuple(over[1]))
