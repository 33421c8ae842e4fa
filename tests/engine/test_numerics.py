import subprocess
import sys

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._batch.batch import run_batch
from rockjax._batch.scenes import broadcast
from rockjax._engine import hermite
from rockjax._engine.methods import EXPLICIT, solver_of
from rockjax._engine.runge_kutta import step
from rockjax._engine.scene import plan_for
from rockjax._engine.tableaus import nystrom, tableau
from rockjax._sincos import cos, sin, sincos
from tests.scenes import PODIUMS


def test_sincos_to_rounding():
    x = jnp.linspace(-np.pi / 2, np.pi / 2, 20001)
    s, c = jax.vmap(sincos)(x)
    np.testing.assert_allclose(s, np.sin(x), rtol=0, atol=3e-16)
    np.testing.assert_allclose(c, np.cos(x), rtol=0, atol=3e-16)
    tiny = jnp.asarray(1e-9)
    assert float(sincos(tiny)[0]) == float(tiny)
    ds, dc = jax.vmap(jax.jacfwd(sincos))(x)
    np.testing.assert_allclose(ds, np.cos(x), atol=3e-16)
    np.testing.assert_allclose(dc, -np.sin(x), atol=3e-16)


@pytest.mark.parametrize("most", [3.0, 1e3, 1e6, 1e9])
def test_sine_and_cosine_of_any_phase(most):
    """Errors are at most the rounding of the phase, and for small phases the rounding of the sine."""
    x = np.concatenate([np.random.default_rng(0).uniform(-most, most, 20001), np.pi * np.arange(-9, 9) / 2])
    rounding = 4e-16 + 3e-16 * np.abs(x) * (np.abs(x) > 3e6)
    for ours, expected, slope in ((sin, np.sin, np.cos), (cos, np.cos, lambda x: -np.sin(x))):
        assert (np.abs(jax.vmap(ours)(x) - expected(x)) <= rounding).all()
        assert (np.abs(jax.vmap(jax.grad(ours))(x) - slope(x)) <= rounding).all()
        assert (np.abs(jax.vmap(jax.grad(jax.grad(ours)))(x) + expected(x)) <= rounding).all()
    small = x[:2000] * 1e-12
    np.testing.assert_allclose(jax.vmap(sin)(small), np.sin(small), rtol=3e-16)
    assert np.isnan(sin(jnp.asarray(np.nan)))
    assert np.isnan(cos(jnp.asarray(np.inf)))


SOLVERS = [
    diffrax.Tsit5(),
    diffrax.Dopri8(),
    diffrax.Dopri5(),
    diffrax.Bosh3(),
    diffrax.Heun(),
    diffrax.Ralston(),
]


@pytest.mark.parametrize("method", EXPLICIT)
def test_kept_tableaus_are_those_of_diffrax(method):
    ours, theirs = tableau(method), tableau(solver_of(method))
    assert (ours.order, ours.fsal) == (theirs.order, theirs.fsal)
    for name in ("c", "A", "AA", "b", "bA", "error", "errorA"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


def test_only_the_solvers_of_users_are_read_from_diffrax():
    """Importing Diffrax takes a large part of the time of the first answer."""
    script = (
        "import sys, jax, rockjax as rj\n"
        "podium = lambda alpha: rj.Podium(alpha=alpha, R=1.5, gamma=10.0)\n"
        "peak = lambda alpha: rj.peak_response(podium(alpha), rj.Ricker(a_p=2.0, T_p=1.0)).peak_rotation\n"
        "jax.eval_shape(jax.grad(peak), 0.15)\n"
        "print('diffrax' in sys.modules)"
    )
    output = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert output.stdout.split() == ["False"]


def test_rigid_columns_that_nothing_brakes_take_the_nystrom_method():
    def of(podium, **options):
        return plan_for(podium, rj.Options(**options), history=False).tableau

    rigid, damper = PODIUMS["rigid"], rj.Damper(coefficient=1e3)
    assert of(rigid) is of(PODIUMS["block"]) is nystrom()
    for podium in (PODIUMS["elastic"], rigid.replace(restrainers=(damper,))):
        assert of(podium) is tableau("dopri8")
    assert of(rigid, method="tsit5") is tableau("tsit5")
    assert of(rigid, method=diffrax.Dopri8()) is tableau(diffrax.Dopri8())
    assert of(rigid, engine="segments") is tableau("dopri8")


@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-11])
def test_nystrom_method_is_as_accurate_as_the_runge_kutta_method(rtol):
    """Rigid columns under pulses that they survive, including bounces: both methods have equal errors and
    similar numbers of trials."""
    podium = PODIUMS["rigid"]
    pulses = rj.Ricker(np.linspace(2.0, 6.0, 200), np.linspace(0.4, 0.9, 200))
    outputs = ("peak_rotation", "impacts")

    def errors(method):
        options = rj.Options(rtol=rtol, atol=1e-2 * rtol, method=method, outputs=outputs)
        scenes, _ = broadcast("test", podium, pulses, rj.State(), None)
        floats, integers, tally = run_batch(scenes, options, False)
        found = np.where(integers["overturned"], np.nan, floats["peak_rotation"])
        return np.nanquantile(np.abs(found - truth) / podium.alpha, 0.99), tally.useful

    tight = rj.Options(rtol=1e-13, atol=1e-15, method=diffrax.Dopri8(), outputs=outputs)
    answers = rj.peak_responses(podium, pulses, options=tight)
    truth = np.where(answers.overturned, np.nan, answers.peak_rotation)
    assert np.mean(truth > 0.05 * podium.alpha) > 0.3
    (ours, trials), (theirs, trials_of_theirs) = errors("dopri8"), errors(diffrax.Dopri8())
    assert ours < max(1.5 * theirs, 2e-14)
    assert ours < 0.1 * rtol
    assert trials < 1.1 * trials_of_theirs


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda s: type(s).__name__)
def test_step_has_the_order_of_its_method_and_is_the_step_of_diffrax(solver):
    def field(t, x, v):
        return (-jnp.sin(x[0]) - 0.1 * v[0] + jnp.cos(2 * t),)

    tab = tableau(solver)
    x, v = (jnp.asarray(0.4),), (jnp.asarray(-0.2),)
    a = field(0.3, x, v)
    one = lambda h: step(tab, field, jnp.asarray(0.3), jnp.asarray(h), x, v, a)
    term = diffrax.ODETerm(lambda t, y, _: jnp.stack([y[1], field(t, (y[0],), (y[1],))[0]]))
    y0 = jnp.stack([x[0], v[0]])
    state = solver.init(term, 0.3, 0.5, y0, None)
    theirs, error, *_ = solver.step(term, 0.3, 0.5, y0, None, state, made_jump=False)
    ours = one(0.2)
    np.testing.assert_allclose([ours.x[0], ours.v[0]], theirs, rtol=1e-13)
    np.testing.assert_allclose(
        np.abs([ours.x_error[0], ours.v_error[0]]), np.abs(error), rtol=1e-3, atol=1e-15
    )
    np.testing.assert_allclose(ours.a[0], field(0.5, ours.x, ours.v)[0], rtol=1e-12)
    exact = diffrax.diffeqsolve(
        term, diffrax.Dopri8(), 0.3, 1.3, 0.01, y0,
        stepsize_controller=diffrax.PIDController(rtol=1e-14, atol=1e-14), max_steps=100_000,
    ).ys[0]  # fmt: skip

    def many(n):
        xs, vs, t = x, v, 0.3
        for _ in range(n):
            new = step(tab, field, jnp.asarray(t), jnp.asarray(1 / n), xs, vs, field(t, xs, vs))
            xs, vs, t = new.x, new.v, t + 1 / n
        return abs(float(xs[0] - exact[0]))

    coarse, fine = (4, 8) if tab.order < 8 else (2, 4)
    assert np.log2(many(coarse) / many(fine)) > tab.order - 0.6


def test_quintic_joins_both_ends():
    p = hermite.quintic(*(jnp.asarray(y) for y in (0.3, -1.2, 2.0, 0.9, 0.4, -3.0)), jnp.asarray(0.5))
    for z, value, slope, curvature in ((0.0, 0.3, -1.2, 2.0), (1.0, 0.9, 0.4, -3.0)):
        assert float(p.value(z)) == pytest.approx(value)
        assert float(p.slope(z)) / 0.5 == pytest.approx(slope)
        assert float(p.curvature(z)) / 0.25 == pytest.approx(curvature)


def test_roots_are_found_and_stay_found():
    """The root is accurate enough for the next trial, also near the ends of the bracket, and further
    iterations do not leave it."""
    rng = np.random.default_rng(1)

    @jax.jit
    @jax.vmap
    def root(c):
        p = hermite.Quintic(*c)
        return hermite.crossing(p, jnp.zeros(()), jnp.ones(()))

    roots = 10.0 ** rng.uniform(-4, -0.001, 2000)
    # (r − z)(1 + b z²): one root and curvature
    b = rng.uniform(-0.5, 2.0, 2000)
    zero = np.zeros_like(b)
    c = np.stack([roots, zero - 1, b * roots, -b, zero, zero], axis=1)
    np.testing.assert_allclose(root(jnp.asarray(c)), roots, rtol=1e-6)


def turning_point(polynomial, rising):
    return hermite.turning_point_or_dip(polynomial, jnp.asarray(True), rising)[0]


def test_the_first_of_two_crossings_is_found():
    """The path crosses zero twice, the second time just before the end of the step: the parabola (z_1 −
    z)(z_2 − z) with a cubic part, for all sizes of z_1 and of 1 − z_2."""
    first = 10.0 ** -np.arange(1.0, 12.0)[:, None, None]
    second = 1 - 10.0 ** -np.arange(1.0, 12.0)[:, None]
    cubic = np.linspace(-0.3, 0.3, 7)
    # (z − z_1)(z − z_2)(1 + cubic·z) with the sign for which it ends below zero
    c0, c1, c2 = first * second, -(first + second), 1.0
    drop = (1 - first) * (1 - second) * (1 + cubic) + 1e-13
    path = hermite.Quintic(*np.broadcast_arrays(c0, c1 + cubic * c0, c2 + cubic * c1, cubic - drop, 0.0, 0.0))
    earliest = path.c0 / sum(np.abs(c) for c in path[1:])
    z = hermite.crossing(path, earliest, np.ones_like(earliest))
    np.testing.assert_allclose(z, np.broadcast_to(first, z.shape), rtol=0.2)


def test_turning_points():
    p = hermite.quintic(*(jnp.asarray(y) for y in (0.0, 1.0, 0.5, 0.1, -2.0, -3.0)), jnp.asarray(1.0))
    z = turning_point(p, jnp.asarray(True))
    assert abs(float(p.slope(z))) < 1e-7
    assert not turns_twice(p, True, False)
    wave = hermite.quintic(*(jnp.asarray(y) for y in (0.0, 1.0, -20.0, 0.1, 1.0, 20.0)), jnp.asarray(1.0))
    assert turns_twice(wave, True, True)


def turns_twice(path: hermite.Quintic, rising: bool, rising_after: bool) -> bool:
    turned, flags = jnp.asarray(rising != rising_after), (jnp.asarray(rising), jnp.asarray(rising_after))
    _, dips = hermite.turning_point_or_dip(path, turned, flags[0])
    return bool(hermite.turns_more_than_once(path, *flags, dips))


def of_slope(*coefficients) -> hermite.Quintic:
    """Return the path with the slope c0 + c1 z + …"""
    path = [0.0, *(c / (k + 1) for k, c in enumerate(coefficients))]
    return hermite.Quintic(*map(jnp.asarray, (*path, *[0.0] * (6 - len(path)))))


@pytest.mark.parametrize("turn", [1e-4, 0.0055, 0.3, 0.97])
@pytest.mark.parametrize("curved", [0.0, 0.8, -0.8, None])
def test_turning_points_close_to_the_ends(turn, curved):
    """A slope (a − z)(1 + bz), in both directions; with b = 1/a the path begins without curvature, as before
    a touch of the ground."""
    curved = 1 / turn if curved is None else curved
    for sign in (1.0, -1.0):
        path = of_slope(*(sign * np.array([turn, turn * curved - 1, -curved])))
        z = turning_point(path, jnp.asarray(sign > 0))
        assert float(z) == pytest.approx(turn, rel=1e-6)


@pytest.mark.parametrize("start", [(0.0, 0.7), (0.0, 0.0, 0.7), (0.0, -1e-17, 0.7), (0.0, 1e-17, 0.7)])
def test_the_start_at_rest_is_no_turning_point(start):
    """Slopes z(a − z) and z²(a − z), the second with rounding errors."""
    for sign in (1.0, -1.0):
        path = of_slope(*(sign * np.array([*start, -1.0])))
        assert float(turning_point(path, jnp.asarray(sign > 0))) == pytest.approx(0.7, rel=1e-6)


@pytest.mark.parametrize("curved", [0.0, 0.9, -0.6, 3.0])
@pytest.mark.parametrize("between", [(0.53, 0.6), (0.02, 0.06), (0.26, 0.49), (0.7, 0.95)])
def test_two_turning_points_close_to_each_other(between, curved):
    """Both turning points are between evaluated positions: (z − a)(z − b)(1 + cz), and a variant without a
    zero."""
    (a, b), lift = between, (between[1] - between[0]) ** 2
    for shift, twice in ((0.0, True), (0.5, False)):
        for sign in (1.0, -1.0):
            parabola = np.array([a * b + shift * lift, -a - b, 1.0])
            path = of_slope(*(sign * np.convolve(parabola, [1.0, curved])))
            assert turns_twice(path, sign > 0, sign > 0) is twice


def test_backend_computes_right_numbers():
    """The backend does not have the compiler fault of jax#39103: jit(vmap(matvec → reduce))."""
    rng = np.random.default_rng(0)
    for n in (3, 5, 8, 13):
        A, x = rng.normal(size=(n, n)), rng.normal(size=(64, n))
        f = lambda y, A=A: jnp.sum((jnp.asarray(A) @ y) ** 2)
        np.testing.assert_allclose(jax.jit(jax.vmap(f))(jnp.asarray(x)), ((x @ A.T) ** 2).sum(1), rtol=1e-12)
