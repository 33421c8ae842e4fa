"""Views of a scene: what an output may ask of a step, of an impact, or of a stretch that is passed over.

An output never reads the loop's state. It gets one of these views, the record that it returned before, and
returns a new one.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.attempt import Attempt
from rockjax._engine.coefficients import Coefficients, Vibration, present, summed, weighted
from rockjax._engine.guard import Guard
from rockjax._engine.hermite import Quintic, is_long, quintic
from rockjax._engine.model import acceleration, beam, beam_absolute, beam_acceleration
from rockjax._engine.ratio import safe_ratio
from rockjax._engine.state import LoopState, Scene
from rockjax._excitations.base import Shaking
from rockjax._outputs.maxima import (
    WELL_INSIDE,
    WELL_INSIDE_CUBIC,
    WELL_INSIDE_QUINTIC,
    End,
    Maximum,
    Sizes,
    cubic,
    largest,
    spring,
)
from rockjax._programs.barrier import barrier
from rockjax._results import State
from rockjax._types import Flag, Index, Value, Values, Vector

from .turning_points import margin_at_turn


class Moment(NamedTuple):
    """An instant of a scene.

    - `c`: constants of the podium
    - `sigma`: mode σ ∈ {−1, 0, 1}
    - `t`: time [s]
    - `ground`: ü_g, or ü_g and v̈_g [m/s²]
    - `x`, `v`, `a`: positions (θ [rad], u_t [m]), velocities and accelerations
    """

    c: Coefficients
    sigma: Value
    t: Value
    ground: Value | Shaking
    x: Vector
    v: Vector
    a: Vector

    @property
    def deformation(self) -> Values:
        """Deformation u_t − u_b of the superstructure [m], of each mode if there are several."""
        return self.x[1] - beam(self.c, self.sigma, self.x[0], self.v[0])[0]


Quantity = Callable[[Moment], Values]


class Turn(NamedTuple):
    """A turning point |θ| = θ_m within a step; inf if there is none."""

    margin: Value  # the overturning margin of that point alone
    slowing: Value  # its angular deceleration −σθ̈ [rad/s²]


class Start(NamedTuple):
    """The start of a scene: the prepared scene, the initial state, its time, and the moment."""

    scene: Scene
    initial: State
    t: Value
    moment: Callable[[], Moment]


class Span(NamedTuple):
    """The length of a step [s], whether it is long enough for its polynomials, and how far past its time
    stamps it begins and ends [s]."""

    h: Value
    long: Flag
    before: Value
    after: Value


class Course(NamedTuple):
    """A quantity over a step: its polynomial, and its value and rate at both ends."""

    path: Any  # a `Path`
    first: tuple[Values, Values]
    last: tuple[Values, Values]

    def summed(self, weights: Values) -> Course:
        """Return the weighted sum over the modes."""
        return jax.tree.map(lambda values: weighted(weights, values), self)


Jet = tuple[Values, Values, Values]  # a quantity with its first two derivatives in time


class Step:
    """A trial step as outputs see it: both ends, the mode, and polynomials of quantities in between.

    - `scene`: the prepared scene
    - `refines`: whether the method is of higher order than the polynomials, so that maxima are landed on
    - `state`: state at the start of the step
    - `ground_at`: t ↦ ground acceleration on the present piece of the excitation [m/s²]
    - `trial`, `guard`: the step and its guard
    - `before`, `after`: times after its time stamps at which the step begins and ends [s]
    """

    def __init__(
        self,
        scene: Scene,
        refines: bool,
        state: LoopState,
        ground_at: Any,
        trial: Attempt,
        guard: Guard,
        before: Value,
        after: Value,
    ):
        self.scene, self.refines, self.ground_at = scene, refines, ground_at
        self.state, self.trial, self.guard = state, trial, guard
        self._courses: dict[Quantity, Course] = {}
        self.span = Span(trial.h, is_long(trial.h, scene.max_step), before, after)

    @property
    def c(self) -> Coefficients:
        """Constants of the podium."""
        return self.scene.c

    @property
    def sigma(self) -> Value:
        """Mode σ ∈ {−1, 0, 1} of the step."""
        return self.state.sigma

    @property
    def has_peak(self) -> Flag:
        """True if |θ| has a maximum inside the step, at the guard's turning point."""
        return (self.sigma != 0) & self.guard.rising & self.guard.turned

    def course(self, quantity: Quantity) -> Course:
        """Return a quantity over the step as a cubic. Automatic differentiation gives its rates in time."""
        if quantity in self._courses:  # outputs share it
            return self._courses[quantity]
        state, trial, c, sigma = self.state, self.trial, self.c, self.sigma

        def at_state(t, x, v):
            ground = self.ground_at(t)
            a = barrier(acceleration(c, sigma, ground, x, v))
            return quantity(Moment(c, sigma, t, ground, x, v, a))

        one = jnp.ones_like(trial.h)
        first = jax.jvp(at_state, (state.t, state.x, state.v), (one, state.v, trial.a0))
        end = trial.end
        last = jax.jvp(at_state, (state.t + trial.h, end.x, end.v), (one, end.v, end.a))
        first, last = barrier((first, last))
        path = cubic(first[0], first[1], last[0], last[1], trial.h)
        found = self._courses[quantity] = Course(path, first, last)
        return found

    @functools.cached_property
    def _jets(self) -> tuple[Jet, Jet]:
        """Deformation of each mode with two derivatives in time, at both ends of the step."""
        c, sigma, end = self.c, self.sigma, self.trial.end

        def jet(x: Vector, v: Vector, a: Vector) -> Jet:
            u_b, u_b_dot = beam(c, sigma, x[0], v[0])
            u_b_ddot = beam_acceleration(c, sigma, x[0], v[0], a[0])
            return x[1] - u_b, v[1] - u_b_dot, a[1] - u_b_ddot

        return barrier((jet(self.state.x, self.state.v, self.trial.a0), jet(end.x, end.v, end.a)))

    @functools.cached_property
    def _deformation_path(self) -> Quintic:
        first, last = self._jets
        return quintic(*first, *last, self.span.h)

    @functools.cached_property
    def deformations(self) -> Course:
        """Deformation of each mode over the step, as a quintic [m]."""
        (d0, r0, _), (d1, r1, _) = self._jets
        return Course(self._deformation_path, (d0, r0), (d1, r1))

    @functools.cached_property
    def spring_forces(self) -> Course:
        """Force of the spring and damper of each mode over its mass, Eq. (7) [m/s²]."""
        modes: Vibration = present(self.c.vibration)
        first, last = barrier(
            [
                (modes.omega2 * d + modes.damping * r, modes.omega2 * r + modes.damping * s)
                for d, r, s in self._jets
            ]
        )
        path = spring(self._deformation_path, modes.omega2, modes.damping, self.span.h)
        return Course(path, first, last)

    @functools.cached_property
    def _base(self) -> Course | None:
        """Absolute acceleration of the mass that moves with the beam; None without such mass."""
        modal = self.c.modal
        if modal is None or modal.residual is None:
            return None
        of_beam = self.course(lambda m: beam_absolute(m.c, m.sigma, m.ground, m.x, m.v, m.a))
        zero = jnp.zeros_like(self.span.h)
        path = of_beam.path
        return of_beam._replace(path=Quintic(path.c0, path.c1, path.c2, path.c3, zero, zero))

    @property
    def inside_of_forces(self) -> float:
        """Part of the step at both ends within which a maximum of carried forces need not be landed on."""
        return WELL_INSIDE_QUINTIC if self._base is None else WELL_INSIDE_CUBIC

    def carrier(self) -> Callable[[Values], Course]:
        """Return the function from weights of the modes to Σ w_i F_i + (Σ w_i − 1) a_b over the step
        [m/s²], the spring forces and the part of the mass that moves with the beam."""
        springs, base = self.spring_forces, self._base

        def carried(weights: Values) -> Course:
            of_springs = springs.summed(weights)
            if base is None:
                return of_springs
            base_weight = summed(weights) - 1.0
            return jax.tree.map(
                lambda of_spring, of_base: of_spring + base_weight * of_base, of_springs, base
            )

        return carried

    def cut_at_turn(self, lands: Flag) -> Value:
        """Return the fraction of the step at which to end it where `lands` holds: at the guard's turning
        point, unless that is so close to an end that the polynomial is accurate enough; inf elsewhere."""
        turn = self.guard.turn
        return jnp.where(lands & (turn > WELL_INSIDE) & (turn < 1 - WELL_INSIDE), turn, jnp.inf)

    def largest(
        self,
        course: Course,
        record: Values,
        inside: float = WELL_INSIDE_CUBIC,
        lands: bool = True,
        sizes: Sizes = "absolute",
    ) -> Maximum:
        """Return the largest absolute value of a quantity over the step, and where to shorten the step to
        land on it.

        - `course`: the quantity over the step
        - `record`: largest absolute value so far
        - `inside`: part of the step at both ends within which a maximum need not be landed on
        - `lands`: whether maxima are landed on at all
        - `sizes`: "absolute" for |f|, "signed" for f, "both" for −f and then f in records and values
        """
        ends = End(*course.first, self.span.before), End(*course.last, self.span.after)
        return largest(course.path, self.span.h, self.span.long, record, ends, inside, lands, sizes)

    def time_to_turn(self, z: Value) -> Value:
        """Return the time from the start of the step to its turning point of θ near `z`, which moves with the
        parameters [s].

        Over a short step the slopes of the quintic are differences of nearly equal numbers; there the speeds
        and accelerations at both ends give the derivative of the time.
        """
        trial, path, end = self.trial, self.guard.path, self.trial.end
        speed = cubic(self.state.v[0], trial.a0[0], end.v[0], end.a[0], trial.h)
        off, of_ends = (
            jnp.clip(safe_ratio(value, slope, slope != 0), -1.0, 1.0) * trial.h
            for value, slope in ((path.slope(z), path.curvature(z)), (speed.value(z), speed.slope(z)))
        )
        of_ends -= jax.lax.stop_gradient(of_ends)
        return z * trial.h - jnp.where(self.span.long, off, of_ends)

    @functools.cached_property
    def turn(self) -> Turn:
        """Margin and deceleration of the maximum of |θ|; inf without one."""
        h, sigma, trial = self.span.h, self.sigma, self.trial
        span = self.time_to_turn(self.guard.turn)
        z = safe_ratio(span, h, h > 0)
        theta = self.guard.path.value(z)
        x, v = (sigma * theta,), (jnp.zeros_like(h),)
        if self.c.vibration is not None:
            first = self.state.x[1], self.state.v[1], trial.a0[1]
            last = trial.end.x[1], trial.end.v[1], trial.end.a[1]
            sway = quintic(*first, *last, h)
            rate = cubic(*first[1:], *last[1:], h).value(z)
            slope = safe_ratio(sway.slope(z), h, h > 0)
            x, v = (*x, sway.value(z)), (*v, jnp.where(self.span.long, slope, rate))
        slowing = -sigma * acceleration(self.c, sigma, self.ground_at(self.state.t + span), x, v)[0]
        here = margin_at_turn(self.c, self.scene.overturn_angle, theta, slowing)
        return barrier(Turn(*(jnp.where(self.has_peak, y, jnp.inf) for y in (here, slowing))))


class Impact(NamedTuple):
    """An impact.

    - `c`: constants of the podium
    - `sigma`: mode before it
    - `t`: its time [s]
    - `ground`: ü_g, or ü_g and v̈_g after it [m/s²]
    - `x`, `v`: positions and velocities before it; θ = 0
    - `v_after`, `sigma_after`: velocities and mode after it
    """

    c: Coefficients
    sigma: Value
    t: Value
    ground: Value | Shaking
    x: Vector
    v: Vector
    v_after: Vector
    sigma_after: Value

    @property
    def speed(self) -> Value:
        """|θ̇| before the impact [rad/s]."""
        return jnp.abs(self.v[0])


class StepEnd(NamedTuple):
    """The end of an accepted step, after the transition of the automaton.

    - `step`: the step
    - `accepted`: whether it is; otherwise nothing of this counts
    - `lands`: whether it ends on an event; `hit`: an impact; `toppled`: the overturning angle
    - `after`: time past its end at which the event lies [s]
    - `now`: time of its end, which moves with the parameters [s]; `stamp`: its fixed time stamp
    - `x`, `v`: positions and velocities afterwards
    - `impact`: the impact, valid where `hit`
    """

    step: Step
    accepted: Flag
    lands: Flag
    hit: Flag
    toppled: Flag
    after: Value
    now: Value
    stamp: Value
    x: Vector
    v: Vector
    impact: Impact


class Rest:
    """Full contact of a rigid podium, in which nothing moves until its next uplift.

    - `scene`: the prepared scene
    - `start`, `end`: times between which the columns rest [s]; they move with the parameters
    - `short`: how long before `end` it stops, zero unless the ground acceleration jumps there [s]
    """

    def __init__(self, scene: Scene, start: Value, end: Value, short: Value):
        self.scene, self.start, self.end, self.short = scene, start, end, short

    @functools.cached_property
    def largest_ground_acceleration(self) -> Value:
        """Largest |ü_g| during the rest [m/s²].

        It is 0 after the end of the motion. At an end of the interval, a jump or a kink, the largest value
        moves with that time; at a smooth maximum, its time does not matter to first order.
        """
        constant, excitation = jax.lax.stop_gradient, self.scene.excitation
        first, last = constant(self.start), constant(self.end) - self.short
        stays = (last > first) & (first < constant(excitation.support[1]))
        time = jnp.clip(constant(self.scene.lookahead.highest_time(first, last)), first, last)
        edge = excitation.breakpoint(excitation.before(excitation.locate(time)))
        moving_time = jnp.where(constant(edge) == time, edge, time)
        moving_time = jnp.where(time == first, self.start, jnp.where(time == last, self.end, moving_time))
        size = jnp.abs(excitation(time + (moving_time - constant(moving_time))))
        return jnp.where(stays, size, 0.0)


class Sample(NamedTuple):
    """A sample of a record that is passed without a trial: θ rises or falls all the way.

    - `c`: constants of the podium; `sigma`: the mode
    - `h`: length of the sample [s]
    - `first`, `last`: ground acceleration [m/s²] (linear in between), positions, velocities and accelerations
      at both ends
    """

    c: Coefficients
    sigma: Value
    h: Value
    first: tuple[Value, Vector, Vector, Vector]
    last: tuple[Value, Vector, Vector, Vector]


class Bounces(NamedTuple):
    """Bounces of a rigid podium that end at rest and are not followed.

    - `c`: constants of the podium
    - `overturn_angle`: α_o [rad]
    - `ground`: bound of |ü_g| [m/s²]
    - `height`: bound of |θ| [rad]
    - `speed`: bound of |θ̇| [rad/s]
    """

    c: Coefficients
    overturn_angle: Value
    ground: Value
    height: Value
    speed: Value


class Ended(NamedTuple):
    """A scene at its end.

    - `scene`: the prepared scene
    - `x`, `v`, `t`: positions, velocities and time at the end
    - `code`: result code
    - `overturn_time`: [s], NaN without overturning
    """

    scene: Scene
    t: Value
    x: Vector
    v: Vector
    code: Index
    overturn_time: Value
