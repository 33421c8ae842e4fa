"""Peaks at events, and turning points in very short steps: values and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import rockjax as rj

ALPHA = 0.2
RIGID = rj.Podium(alpha=ALPHA, R=2.0, gamma=0.5, superstructure=rj.Rigid(1.0))
UPLIFT = 9.80665 * np.tan(ALPHA)  # uplift acceleration of the rigid podium [m/s²]
SHEAR = rj.Options(outputs=("peak_shear",))


def triangle(dt=0.1, t_start=0.0, samples=(0.0, 0.7, 1.0, 0.7, 0.0), scale=1.0) -> rj.Record:
    return rj.Record(jnp.asarray(samples), dt, scale=scale, t_start=t_start)


SINE = tuple(np.sin(np.linspace(0, 2 * np.pi, 41)))
# Motions under which the shear is largest at the first uplift.
AT_UPLIFT = {
    "one-sine": lambda f: rj.OneSine(4.97 * f, 1.0),
    "one-sine, longer": lambda f: rj.OneSine(5.0 * f, 2.0),
    "record": lambda f: triangle(0.025, samples=SINE, scale=4.97 * f),
    "pair": lambda f: rj.GroundMotion(rj.OneSine(6.0 * f, 1.5), rj.Rest()),
}


@pytest.mark.slow(but=["one-sine"])
@pytest.mark.parametrize("motion", AT_UPLIFT)
def test_shear_at_uplift_moves_with_the_uplift(motion):
    """V/(m g) = tan α at the uplift, for every motion."""

    def peak_shear(alpha, factor):
        return rj.peak_response(
            RIGID.replace(alpha=alpha), AT_UPLIFT[motion](factor), options=SHEAR
        ).peak_shear

    value, slopes = jax.value_and_grad(peak_shear, argnums=(0, 1))(ALPHA, 1.0)
    assert float(value) == pytest.approx(np.tan(ALPHA), rel=1e-9)
    np.testing.assert_allclose(slopes, (1 / np.cos(ALPHA) ** 2, 0.0), atol=1e-9)


@pytest.mark.slow
def test_shear_at_uplift_in_batches_and_in_reverse_mode():
    batch = rj.peak_responses(
        RIGID, rj.OneSine([4.97, 5.964], 1.0), options=SHEAR, sensitivities=("alpha", "T_p", "scale")
    )
    expected = [[ALPHA / np.cos(ALPHA) ** 2, 0.0, 0.0]] * 2
    np.testing.assert_allclose(batch.sensitivities.peak_shear, expected, atol=1e-9)

    def of_samples(samples):
        return rj.peak_response(RIGID, rj.Record(samples, 0.025), options=SHEAR).peak_shear

    slope = jax.grad(of_samples)(4.97 * jnp.asarray(SINE))
    np.testing.assert_allclose(slope, 0.0, atol=1e-9)


def test_shear_at_a_sample_moves_with_the_sample():
    """The largest sample of a motion without uplift is at a kink, at a jump at the start, or at a jump at the
    end."""
    for samples in ((0.0, 1.0, 0.0), (1.0, 0.4, 0.0), (0.0, 0.4, 1.0)):

        def peak_shear(dt, t_start, scale, samples=samples):
            motion = triangle(dt, t_start, samples, scale)
            return 9.80665 * rj.peak_response(RIGID, motion, options=SHEAR).peak_shear

        slopes = jax.grad(peak_shear, argnums=(0, 1, 2))(0.1, 0.3, 1.5)
        np.testing.assert_allclose(slopes, (0.0, 0.0, 1.0), atol=1e-9)


def test_shear_at_the_end_of_a_scene_moves_with_the_end():
    """The peak is ü_g(t_end) of an increasing motion without uplift."""

    def peak_shear(t_end, T_p):
        motion = rj.OneSine(1.5, T_p)
        return 9.80665 * rj.peak_response(RIGID, motion, t_end=t_end, options=SHEAR).peak_shear

    omega = 2 * np.pi / 1.3
    rate = 1.5 * omega * np.cos(omega * 0.2)
    slopes = jax.grad(peak_shear, argnums=(0, 1))(jnp.asarray(0.2), jnp.asarray(1.3))
    np.testing.assert_allclose(slopes, (rate, -rate * 0.2 / 1.3), rtol=1e-9)


STEEP = {
    "rigid": (rj.Rigid(2.0), rj.Ricker(2.9, 0.8)),
    "elastic": (rj.Elastic(2.0, 0.4), rj.Ricker(2.5, 0.9)),
    "two modes": (rj.Modes([1.5, 0.5], [0.5, 0.12], 0.05), rj.OneSine(2.6, 0.8)),
    "record": (rj.Elastic(5.0, 0.3), triangle(0.15, samples=(0.0, 2.0, -3.0, 4.0, -1.0, 0.5, 0.0))),
}


@pytest.mark.slow
@pytest.mark.parametrize("scene", STEEP)
def test_turning_points_with_power_law_dampers(scene):
    """The overturning margin and its derivatives at all tolerances."""
    top, motion = STEEP[scene]
    damper = rj.Damper(0.3, np.array([[0.33], [0.8]]))
    podium = rj.Podium(ALPHA, 2.0, 0.5, superstructure=top, restrainers=(damper,))
    h = 1e-5
    factors = np.array([1.0, 1 + h, 1 - h, 1 + 2 * h, 1 - 2 * h])

    def margins(rtol):
        options = rj.Options(rtol=rtol, atol=0.01 * rtol, outputs=("margin",))
        found = rj.peak_responses(podium, motion.scaled(factors), options=options, sensitivities=("scale",))
        return np.asarray(found.margin), np.asarray(found.sensitivities.margin)[:, 0, 0]

    best, _ = margins(1e-11)
    assert ((best > 0) & (best < 1)).all()
    slopes = [(best[:, k] - best[:, k + 1]) / (2 * h * (k + 1) / 2) for k in (1, 3)]
    np.testing.assert_allclose(*slopes, rtol=2e-5, atol=1e-6)  # derivatives converge
    for rtol in (1e-8, 1e-10, 1e-12, 1e-13):
        value, slope = margins(rtol)
        np.testing.assert_allclose(value, best, rtol=max(1e-8, 30 * rtol))
        if rtol >= 1e-12:  # for smaller tolerances rounding dominates
            np.testing.assert_allclose(slope, slopes[0], rtol=3e-5, atol=1e-6)


@pytest.mark.slow
def test_time_of_a_peak_with_a_power_law_damper():
    podium = rj.Podium(ALPHA, 2.0, 0.5, superstructure=rj.Rigid(2.0), restrainers=(rj.Damper(0.3, 0.4),))

    def peak_time(factor, rtol=1e-11):
        options = rj.Options(rtol=rtol, atol=0.01 * rtol, outputs=("peak_rotation",))
        return rj.peak_response(podium, rj.Ricker(2.9 * factor, 0.8), options=options).peak_rotation_time

    expected = float(peak_time(1 + 1e-5) - peak_time(1 - 1e-5)) / 2e-5
    assert abs(expected) > 1e-3
    for rtol in (1e-8, 1e-10, 1e-12):
        assert float(jax.grad(peak_time)(1.0, rtol)) == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("top", [rj.Rigid(2.0), rj.Elastic(2.0, 0.4)], ids=["rigid", "elastic"])
def test_restrainers_of_no_strength_are_none(top):
    """Answers are bitwise identical, and derivatives with respect to the strengths exist."""
    idle = (rj.Damper(0.0, 0.33), rj.Tendon(0.0), rj.Inerter(0.0))
    motion = rj.Ricker(4.2, 1.2)
    bare = rj.Podium(ALPHA, 2.0, 0.5, superstructure=top)
    held = bare.replace(restrainers=idle)
    for one, other in (
        (rj.peak_response(bare, motion), rj.peak_response(held, motion)),
        (rj.peak_responses(bare, motion), rj.peak_responses(held, motion)),
    ):
        assert float(one.peak_rotation) == float(other.peak_rotation)
        assert int(one.stats.steps) == int(other.stats.steps)
    of_both = ("alpha", "coefficient")
    found = rj.peak_responses(held, motion, sensitivities=of_both).sensitivities.peak_rotation
    alone = rj.peak_responses(bare, motion, sensitivities=("alpha",)).sensitivities.peak_rotation
    np.testing.assert_allclose(found, [float(alone[..., 0]), 0.0], rtol=1e-6)


def largest_deformation(samples, dt, T_s, zeta, until) -> float:
    """Return max|u| of an oscillator under a motion that is linear between samples, by the matrix
    exponential."""
    omega, fine = 2 * np.pi / T_s, 200
    system = np.zeros((4, 4))  # state: u, u̇, ü_g and its slope
    system[0, 1], system[2, 3], system[1, 2] = 1.0, 1.0, -1.0
    system[1, :2] = -(omega**2), -2 * zeta * omega
    onward = scipy.linalg.expm(system * dt / fine)
    y, found = np.zeros(4), [np.zeros(2)]
    for k in range(round(until / dt)):
        last = k >= len(samples) - 1
        y[2:] = (0.0, 0.0) if last else (samples[k], (samples[k + 1] - samples[k]) / dt)
        for _ in range(fine):
            y = onward @ y
            found.append(y[:2].copy())
    u, v = np.asarray(found).T
    # Cubics between the nodes.
    turns = np.flatnonzero(v[:-1] * v[1:] < 0)
    h, best = dt / fine, np.abs(u).max()
    for k in turns:
        z = np.linspace(0, 1, 400)
        bend, twist = (
            3 * (u[k + 1] - u[k]) - h * (2 * v[k] + v[k + 1]),
            2 * (u[k] - u[k + 1]) + h * (v[k] + v[k + 1]),
        )
        best = max(best, np.abs(u[k] + z * (h * v[k] + z * (bend + z * twist))).max())
    return best


@pytest.mark.parametrize(
    ("T_s", "zeta", "seed"),
    [(0.017, 0.01, 0), (0.03, 0.05, 1), (0.045, 0.02, 2), (0.11, 0.01, 3), (0.027, 0.11, 4)],
)
def test_stiff_superstructures_in_full_contact(T_s, zeta, seed):
    """The response is linear without events: the largest deformation is accurate at the default tolerance,
    also with several extrema between two samples."""
    rng = np.random.default_rng(seed)
    samples = np.convolve(rng.normal(size=108), np.hanning(9), "valid")
    samples *= 0.5 / np.abs(samples).max()
    podium = rj.Podium(ALPHA, 1.6, 2.0, superstructure=rj.Elastic(1.0, T_s, zeta))
    peak = rj.peak_response(podium, rj.Record(samples, 0.02), t_end=3.0)
    assert not bool(peak.uplifted)
    expected = largest_deformation(samples, 0.02, T_s, zeta, 3.0)
    assert float(peak.peak_deformation) == pytest.approx(expected, rel=1e-7)


@pytest.mark.slow
def test_floor_accelerations_in_the_last_bounces():
    """With residual mass and hops of 1e-11 s, derivatives do not depend on the tolerance."""
    building = rj.ShearBuilding(np.array([3.0, 8.0, 1.2]), np.array([2750.0, 1780.0, 1090.0]), 0.13, modes=2)
    podium = rj.Podium(0.42, 0.65, 0.01, superstructure=building, restitution=0.73)
    samples = np.repeat([0.02, 0.43, -0.42, 0.48, 0.43, -0.11, -0.73, -0.41], 25)

    def slope(rtol):
        options = rj.Options(rtol=rtol, atol=0.01 * rtol, outputs=("peak_floor_acceleration",))
        motions = [rj.Record(samples * size, 0.02) for size in (15.0, 23.0, -20.0)]
        found = rj.peak_responses(podium, motions, options=options, sensitivities=("scale",))
        return np.asarray(found.sensitivities.peak_floor_acceleration)

    best = slope(1e-9)
    for rtol in (1e-10, 1e-12):
        np.testing.assert_allclose(slope(rtol), best, rtol=1e-4, atol=1e-4)
