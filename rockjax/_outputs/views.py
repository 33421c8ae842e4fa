"""Views of a scene for the outputs: moments, steps, impacts, and parts that are skipped.

A scene is one podium under one excitation. Outputs read these views instead of the loop state. An output has
an accumulator, the value so far, and updates it from each view.

An event is an uplift, an impact or overturning. A breakpoint is a time at which the ground motion has a jump
or a kink, and a piece is the ground motion between two breakpoints. The time of an event or a breakpoint
depends on the parameters. A *stamp* is the value of such a time, held constant under differentiation. z is
the time since the start of a step divided by the length of the step. (L1) and (L2) are in docs/floors.md.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rockjax._engine.attempt import Attempt
from rockjax._engine.coefficients import Coefficients, Vibration, not_none, summed, weighted
from rockjax._engine.guard import Guard
from rockjax._engine.hermite import Quintic, is_long, middle, quintic
from rockjax._engine.model import acceleration, beam, beam_absolute_acceleration, beam_acceleration
from rockjax._engine.ratio import safe_ratio
from rockjax._engine.state import LoopState, Scene
from rockjax._engine.transitions import Jolt
from rockjax._excitations.base import Shaking
from rockjax._outputs.maxima import (
    END_ZONE,
    END_ZONE_ACCELERATIONS,
    ROUNDING_ANGLE,
    Cubic,
    End,
    Maximum,
    Sizes,
    cubic,
    larger,
    largest,
    quartic,
    spring,
)
from rockjax._programs.barrier import barrier
from rockjax._results import State
from rockjax._types import Flag, Index, Value, Values, Vector

from .turning_points import margin_at_turn


class Moment(NamedTuple):
    """An instant of a scene.

    - `c`: constants of the podium
    - `sigma`: contact mode σ ∈ {−1, 0, 1}
    - `t`: time [s]
    - `ground`: ü_g, or ü_g and v̈_g [m/s²]
    - `x`, `v`, `a`: positions, velocities and accelerations. The positions are θ [rad] and the displacement
      u_t of the superstructure relative to the ground [m], an array over the modes if there are several. If
      no superstructure vibrates, each of the three has only the entry of θ
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
        """Deformation u_t − u_b of the superstructure, with the displacement u_b of the beam [m]; an array
        over the modes if there are several."""
        return self.x[1] - beam(self.c, self.sigma, self.x[0], self.v[0])[0]


def deck_acceleration(moment: Moment) -> Value:
    """Return the absolute horizontal acceleration a_b of the deck (the beam), (L1) [m/s²]."""
    return beam_absolute_acceleration(moment.c, moment.sigma, moment.ground, moment.x, moment.v, moment.a)


Quantity = Callable[[Moment], Any]  # returns values, or a tuple of values


class Turn(NamedTuple):
    """A maximum of |θ| inside a step; both fields are inf if there is none."""

    margin: Value  # overturning margin of this turning point [–]
    slowing: Value  # angular deceleration −σθ̈ [rad/s²]


class Start(NamedTuple):
    """The start of a scene: the prepared scene, the initial state, the start time [s], and a function that
    returns the `Moment` at the start time."""

    scene: Scene
    initial: State
    t: Value
    moment: Callable[[], Moment]


class Span(NamedTuple):
    """Times of a step [s].

    - `h`: length of the step
    - `long`: whether the step is long enough for accurate curvatures of polynomials (`hermite.is_long`)
    - `before`: time from the start of the step to the event or breakpoint there. Its value is always zero;
      only its derivatives are used
    - `after`: time from the end of the step to the event or breakpoint there. Its value is zero, or small if
      the step ends close to an event

    `before` and `after` have the derivatives of the times of these events and breakpoints.
    """

    h: Value
    long: Flag
    before: Value
    after: Value


class Course(NamedTuple):
    """A quantity over a step: a polynomial in z, and (value, rate in time) at both ends."""

    path: Any  # a `Path`
    start: tuple[Values, Values]
    end: tuple[Values, Values]

    def summed(self, weights: Values) -> Course:
        """Return the sum over the modes with the given weights."""
        return jax.tree.map(lambda values: weighted(weights, values), self)


Jet = tuple[Values, Values, Values]  # a quantity with its first two derivatives in time


class Step:
    """A trial step as outputs see it: both ends, the contact mode, and polynomials of quantities over the
    step.

    - `scene`: the prepared scene
    - `ends_on_maxima`: whether steps end on maxima of the rotation and of deformations; this is necessary if
      the method has a higher order than the polynomials
    - `state`: state at the start of the step
    - `ground_at`: t ↦ ground acceleration on the current piece of the excitation [m/s²]
    - `trial`: the step
    - `guard`: the quantity that ends the contact mode of the step (`rockjax._engine.guard`): σθ while rocking
    - `before`, `after`: as in `Span`
    """

    def __init__(
        self,
        scene: Scene,
        ends_on_maxima: bool,
        state: LoopState,
        ground_at: Any,
        trial: Attempt,
        guard: Guard,
        before: Value,
        after: Value,
    ):
        self.scene, self.ends_on_maxima, self.ground_at = scene, ends_on_maxima, ground_at
        self.state, self.trial, self.guard = state, trial, guard
        self._courses: dict[tuple[Quantity, bool], list[Course]] = {}  # results of `courses`
        self.span = Span(trial.h, is_long(trial.h, scene.max_step), before, after)

    @property
    def c(self) -> Coefficients:
        """Constants of the podium."""
        return self.scene.c

    @property
    def sigma(self) -> Value:
        """Contact mode σ ∈ {−1, 0, 1} of the step."""
        return self.state.sigma

    @property
    def has_peak(self) -> Flag:
        """True if |θ| has a maximum inside the step, which is then at z = `guard.turn`."""
        return (self.sigma != 0) & self.guard.rising & self.guard.turned

    @property
    def peak_exceeds_ends(self) -> Flag:
        """True if |θ| has a maximum inside the step that exceeds |θ| at both ends by more than rounding."""
        at_ends = jax.lax.stop_gradient(self.sigma * self.state.x[0]), self.guard.end_value
        rounding = ROUNDING_ANGLE * jnp.finfo(self.guard.turn_value.dtype).eps
        return self.has_peak & (self.guard.turn_value > jnp.maximum(*at_ends) * (1 + rounding))

    def course(self, quantity: Quantity) -> Course:
        """Return a quantity over the step as a cubic. Automatic differentiation gives the rates in time."""
        (course,) = self.courses(quantity)
        return course

    def courses(self, quantity: Quantity, through_middle: bool = False) -> list[Course]:
        """Return the values of a quantity over the step as cubics, in the order of the tuple that `quantity`
        returns. In batches a tuple of scalars is much faster than an array.

        With `through_middle`, return quartics through the values in the middle of the step instead of cubics.
        Quartics have more accurate extrema, so fewer steps are shortened to end on extrema.
        """
        key = quantity, through_middle
        if key in self._courses:  # several outputs may use the same quantity
            return self._courses[key]
        state, trial, c, sigma = self.state, self.trial, self.c, self.sigma

        def at_state(t, x, v):
            ground = barrier(self.ground_at(t))
            a = barrier(acceleration(c, sigma, ground, x, v))
            return quantity(Moment(c, sigma, t, ground, x, v, a))

        one, after = jnp.ones_like(trial.h), trial.end
        start = jax.jvp(at_state, (state.t, state.x, state.v), (one, state.v, trial.a0))
        end = jax.jvp(at_state, (state.t + trial.h, after.x, after.v), (one, after.v, after.a))
        start, end = barrier((start, end))
        jets = zip(*[jax.tree.leaves(y) for y in (*start, *end)], strict=True)
        courses = [
            Course(cubic(f0, rate0, f1, rate1, trial.h), (f0, rate0), (f1, rate1))
            for f0, rate0, f1, rate1 in jets
        ]
        if through_middle:
            values = jax.tree.leaves(barrier(at_state(*self._middle)))
            courses = [
                course._replace(path=barrier(quartic(course.path, value, self.span.long)))
                for course, value in zip(courses, values, strict=True)
            ]
        self._courses[key] = courses
        return courses

    @functools.cached_property
    def _middle(self) -> tuple[Value, Vector, Vector]:
        """Time, positions and velocities in the middle of the step, from the quintics through both ends."""
        state, trial, end, h = self.state, self.trial, self.trial.end, self.trial.h
        x, v = [], []
        for x0, v0, a0, x1, v1, a1 in zip(state.x, state.v, trial.a0, end.x, end.v, end.a, strict=True):
            position, velocity = middle(x0, v0, a0, x1, v1, a1, h)
            x.append(position)
            v.append(velocity)
        return barrier((state.t + 0.5 * h, tuple(x), tuple(v)))

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
        start, end = self._jets
        return quintic(*start, *end, self.span.h)

    @functools.cached_property
    def deformations(self) -> Course:
        """Deformation of each mode over the step, as a quintic [m]."""
        (d0, r0, _), (d1, r1, _) = self._jets
        return Course(self._deformation_path, (d0, r0), (d1, r1))

    @functools.cached_property
    def spring_forces(self) -> Course:
        """Force of each mode's spring and damper divided by the modal mass, Eq. (7) [m/s²]."""
        modes: Vibration = not_none(self.c.vibration)
        start, end = barrier(
            [
                (modes.omega2 * d + modes.damping * r, modes.omega2 * r + modes.damping * s)
                for d, r, s in self._jets
            ]
        )
        path = spring(self._deformation_path, modes.omega2, modes.damping, self.span.h)
        return Course(path, start, end)

    @functools.cached_property
    def _residual_acceleration(self) -> Course | None:
        """Absolute acceleration of the residual mass (mass of the superstructure that belongs to no mode),
        which moves with the beam; None without a residual mass."""
        modal = self.c.modal
        if modal is None or modal.residual is None:
            return None
        deck = self.course(deck_acceleration)
        zero, path = jnp.zeros_like(self.span.h), deck.path
        return deck._replace(path=Quintic(path.c0, path.c1, path.c2, path.c3, zero, zero))

    def inertia_force(self) -> Callable[[Values], Course]:
        """Return a function of the weights w_i of the modes on a floor. The function returns
        Σ w_i F_i + (Σ w_i − 1) a_b over the step [m/s²], the negative of the acceleration of the floor, (L2).
        F_i are `spring_forces`, and a_b is the acceleration of the deck. Without a residual mass, the term
        with a_b is left out."""
        springs, base = self.spring_forces, self._residual_acceleration

        def force(weights: Values) -> Course:
            of_springs = springs.summed(weights)
            if base is None:
                return of_springs
            base_weight = summed(weights) - 1.0
            return jax.tree.map(
                lambda of_spring, of_base: of_spring + base_weight * of_base, of_springs, base
            )

        return force

    def cut_at_turn(self, shortens_step: Flag) -> Value:
        """Return the position z of the guard's turning point, at which the next trial must end. If not
        `shortens_step`, or if the turning point is in an end zone of `maxima.py`, return inf: the next trial
        is not shortened."""
        turn = self.guard.turn
        return jnp.where(shortens_step & (turn > END_ZONE) & (turn < 1 - END_ZONE), turn, jnp.inf)

    def largest(
        self,
        course: Course,
        accumulator: Any,
        end_zone: float = END_ZONE_ACCELERATIONS,
        shortens_step: bool = True,
        sizes: Sizes = "absolute",
    ) -> Maximum:
        """Return the `Maximum` of a quantity f over the step.

        - `course`: the quantity over the step
        - `accumulator`: largest value so far
        - `end_zone`: fraction of the step at both ends where a maximum needs no shorter step
        - `shortens_step`: whether the next trial ends on a maximum that may exceed the accumulator. If f
          turns twice in the step, the next trial may be shorter in any case (`maxima.largest`)
        - `sizes`: "absolute" for max|f|, "signed" for max f, "both" for a pair of max(−f) and max f;
          `accumulator` has the same form
        """
        span, ends = self.span, self._ends(course)
        return largest(course.path, span.h, span.long, accumulator, ends, end_zone, shortens_step, sizes)

    def _ends(self, course: Course) -> tuple[End, End]:
        return End(*course.start, self.span.before), End(*course.end, self.span.after)

    def largest_forces(
        self,
        groups: Sequence[Sequence[Course]],
        accumulators: Sequence[Any],
        unit: Value,
        sizes: Sizes = "absolute",
    ) -> Maximum:
        """Return the `Maximum` of groups of forces in the joints over the step: the largest value of each
        group, and the least `retry_fraction`.

        - `groups`: the forces over the step, such as those of both end columns
        - `accumulators`: largest value so far of each group, divided by `unit`, like the result
        - `unit`: the unit of the accumulators [m/s²]
        - `sizes`: as for `largest`
        """
        values, fractions = [], []
        for group, accumulator in zip(groups, accumulators, strict=True):
            so_far = jax.tree.map(lambda y: y * unit, accumulator)
            each = [self.largest(course, so_far, sizes=sizes) for course in group]
            rows = [maximum.value for maximum in each]
            worst = functools.reduce(lambda a, b: jax.tree.map(larger, b, a), rows)
            values.append(jax.tree.map(lambda y: y / unit, worst))
            fractions += [maximum.retry_fraction for maximum in each]
        return Maximum(tuple(values), functools.reduce(jnp.minimum, fractions))

    @functools.cached_property
    def _speed(self) -> Cubic:
        """θ̇ over the step, from the speeds and accelerations at both ends [rad/s]."""
        trial, end = self.trial, self.trial.end
        return cubic(self.state.v[0], trial.a0[0], end.v[0], end.a[0], trial.h)

    def time_to_turn(self, z: Value) -> Value:
        """Return the time from the start of the step to the turning point of θ near `z` [s]. The time can be
        differentiated.

        Over a very short step, the slopes of the quintic are differences of nearly equal numbers. The time
        then follows from the speeds and accelerations at both ends. The derivative of the time with respect
        to a parameter is −θ̇'/θ̈ at the turning point, where θ̇' is the derivative of θ̇ with respect to the
        parameter. In a very short step, the quotient θ̇'/θ̈ is interpolated between both ends: a damper with a
        small exponent changes θ̇' and θ̈ suddenly near the turning point, but not their quotient.
        """
        constant = jax.lax.stop_gradient
        newton = lambda value, slope: jnp.clip(safe_ratio(value, slope, slope != 0), -1.0, 1.0)
        trial, path, speed = self.trial, self.guard.path, self._speed
        root = z
        for _ in range(3):
            root = constant(root - newton(speed.value(root), speed.slope(root)))
        ends = (self.state.v[0], trial.a0[0]), (trial.end.v[0], trial.end.a[0])
        shifts = [safe_ratio(v - constant(v), constant(a), constant(a) != 0) for v, a in ends]
        in_short_step = root * trial.h - ((1 - root) * shifts[0] + root * shifts[1])
        in_long_step = (z - newton(path.slope(z), path.curvature(z))) * trial.h
        # `in_long_step` needs only the slope and the curvature of the quintic. Their rounding errors are
        # small even in steps ten times shorter than `span.long` requires.
        long = is_long(trial.h, 0.1 * self.scene.max_step)
        return jnp.where(long, in_long_step, in_short_step)

    @functools.cached_property
    def turn(self) -> Turn:
        """The maximum of |θ| inside the step."""
        h, sigma, trial, long = self.span.h, self.sigma, self.trial, self.span.long
        span = self.time_to_turn(self.guard.turn)
        z = safe_ratio(span, h, h > 0)
        theta = jnp.where(
            long, self.guard.path.value(z), sigma * (self.state.x[0] + h * self._speed.integral(z))
        )
        x, v = (sigma * theta,), (jnp.zeros_like(h),)
        if self.c.vibration is not None:
            start = self.state.x[1], self.state.v[1], trial.a0[1]
            end = trial.end.x[1], trial.end.v[1], trial.end.a[1]
            u_t, rate = quintic(*start, *end, h), cubic(*start[1:], *end[1:], h)
            slope = safe_ratio(u_t.slope(z), h, h > 0)
            x = *x, jnp.where(long, u_t.value(z), start[0] + h * rate.integral(z))
            v = *v, jnp.where(long, slope, rate.value(z))
        slowing = -sigma * acceleration(self.c, sigma, self.ground_at(self.state.t + span), x, v)[0]
        margin = margin_at_turn(self.c, self.scene.overturn_angle, theta, slowing)
        return barrier(Turn(*(jnp.where(self.has_peak, y, jnp.inf) for y in (margin, slowing))))


class Impact(NamedTuple):
    """An impact.

    - `c`: constants of the podium
    - `sigma`: contact mode before the impact
    - `t`: time of the impact, not held constant under differentiation [s]
    - `ground`: ü_g, or ü_g and v̈_g, after the impact [m/s²]
    - `x`, `v`: positions and velocities before the impact; θ = 0
    - `v_after`: velocities just after the impact, even if the bounces that follow it are skipped
    - `sigma_after`: contact mode after the impact
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
    """The end of a step, after the transition to the next contact mode.

    - `step`: the step
    - `accepted`: whether the step is accepted; otherwise the loop discards the updated accumulators
    - `lands`, `hit`, `toppled`: whether the step ends on an event, on an impact, on overturning
    - `after`: as in `Span` [s]
    - `now`: time of the event if the step ends on one, else time of the end of the step [s]
    - `stamp`: the same time, held constant under differentiation [s]
    - `x`, `v`: positions and velocities after the transition
    - `impact`: the impact, valid where `hit`
    - `jolt`: the jump of the ground's velocity at the end of the step; None if the motion has no jumps
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
    jolt: Jolt | None


class Rest:
    """Full contact of a rigid podium up to its next uplift.

    - `scene`: the prepared scene
    - `start`, `end`: times between which the columns rest, not held constant under differentiation [s]
    - `excluded`: duration before `end` that is left out [s]. If the ground acceleration jumps at `end`, its
      value at `end` is already that after the jump, and does not belong to the rest. Without a jump,
      `excluded` is 0
    """

    def __init__(self, scene: Scene, start: Value, end: Value, excluded: Value):
        self.scene, self.start, self.end, self.excluded = scene, start, end, excluded

    @functools.cached_property
    def largest_ground_acceleration(self) -> Value:
        """Largest |ü_g| during the rest [m/s²]; 0 if the rest begins after the excitation.

        If the maximum is at an end of the rest or at a breakpoint, the time of this point depends on the
        parameters, and the derivatives of the result include this effect. At a smooth maximum, the time has
        no effect on derivatives.
        """
        return jnp.where(self._is_shaken, jnp.abs(self._extreme(None)), 0.0)

    @functools.cached_property
    def extreme_ground_accelerations(self) -> tuple[Value, Value]:
        """Smallest and largest ü_g during the rest [m/s²], differentiated like `largest_ground_acceleration`.
        Both are 0 if the rest begins after the excitation. Not valid unless `lasts`."""
        end = jax.lax.stop_gradient(self.scene.excitation.support[1])
        becomes_still = self._end > end

        def extreme(side: float) -> Value:
            value = self._extreme(jnp.full_like(self._end, side))
            value = jnp.where(becomes_still & (side * value < 0), 0.0, value)
            return jnp.where(self._is_shaken, value, 0.0)

        return extreme(-1.0), extreme(1.0)

    @property
    def lasts(self) -> Flag:
        """True if the rest lasts longer than an instant."""
        return self._end > jax.lax.stop_gradient(self.start)

    @property
    def _end(self) -> Value:
        return jax.lax.stop_gradient(self.end) - self.excluded

    @property
    def _is_shaken(self) -> Flag:
        constant = jax.lax.stop_gradient
        return self.lasts & (constant(self.start) < constant(self.scene.excitation.support[1]))

    def _extreme(self, side: Value | None) -> Value:
        """Return ü_g [m/s²] at the time in the rest at which |ü_g| (if `side` is None) or `side`·ü_g is
        largest."""
        constant, excitation = jax.lax.stop_gradient, self.scene.excitation
        start, end = constant(self.start), self._end
        stamp = jnp.clip(constant(self.scene.lookahead.highest_time(start, end, side)), start, end)
        breakpoint = excitation.breakpoint(excitation.before(excitation.locate(stamp)))
        time = jnp.where(constant(breakpoint) == stamp, breakpoint, stamp)
        time = jnp.where(stamp == start, self.start, jnp.where(stamp == end, self.end, time))
        return excitation(stamp + (time - constant(time)))

    def raised(self, accumulator: Value, values: Sequence[Value]) -> Value:
        """Return the largest of the accumulator and `values`, which occur during the rest. Unless `lasts`,
        return the accumulator."""
        for value in values:
            accumulator = jnp.where(self.lasts & (value > accumulator), value, accumulator)
        return accumulator


class Sample(NamedTuple):
    """A sampling interval of a record that may be skipped without a trial step. θ is monotone in the
    interval.

    - `c`: constants of the podium; `sigma`: the contact mode
    - `h`: length of the interval [s]
    - `start`, `end`: ground acceleration [m/s²] (linear in between), positions, velocities and accelerations
    """

    c: Coefficients
    sigma: Value
    h: Value
    start: tuple[Value, Vector, Vector, Vector]
    end: tuple[Value, Vector, Vector, Vector]


class Bounces(NamedTuple):
    """Bounces of a rigid podium (with a rigid superstructure or none) that end at rest and may be skipped.

    - `c`: constants of the podium
    - `overturn_angle`: α_o [rad]
    - `ground`, `height`, `speed`: bounds on |ü_g| [m/s²], |θ| [rad] and |θ̇| [rad/s] during the bounces
    - `min_impact_speed`: the columns rest after an impact if |θ̇| before it is at most this speed [rad/s]
    """

    c: Coefficients
    overturn_angle: Value
    ground: Value
    height: Value
    speed: Value
    min_impact_speed: Value


class Ended(NamedTuple):
    """A scene at its end.

    - `scene`: the prepared scene
    - `x`, `v`, `t`: positions, velocities and time at the end
    - `code`: result code, `rockjax._results`
    - `overturn_time`: time of overturning [s]; NaN if the columns do not overturn
    """

    scene: Scene
    t: Value
    x: Vector
    v: Vector
    code: Index
    overturn_time: Value
