"""Design points of structures, compared with exact results: onset of uplift, the equivalent block, and
derivatives of β from repeated searches."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._programs.program import COUNTS, finish_writing, forget
from rockjax._risk import search
from rockjax._risk.limit_state import FunctionLimitState
from rockjax._risk.structure import OPTIONS, StructureLimitState, parse_limit

MOTION = rj.GaussianMotion(31, 0.08, 0.02)
BLOCK = rj.Podium(alpha=0.2, R=1.0)
ELASTIC = rj.Podium(alpha=0.2, R=1.5, gamma=2.0, superstructure=rj.Elastic(5.0, 0.4, 0.05))


@pytest.mark.slow
def test_first_order_is_exact_for_the_onset_of_uplift():
    """The demand of a podium in full contact at a given time is linear in u, so β = q_up/|∇q|, and the motion
    of the design point lifts the columns at that time."""
    at = 1.7
    options = rj.Options(rtol=1e-12, atol=1e-14)

    @jax.jit
    @jax.value_and_grad
    def demand(u):
        """Return q/q_up for columns that have not lifted."""
        response = rj.simulate(ELASTIC, MOTION.record(0.1 * u), t_end=at + 0.05, options=options)
        return -10 * response.restoring_moment(at)

    u = MOTION.samples(2, seed=1)
    values, rows = zip(*(demand(y) for y in u), strict=True)
    row = np.asarray(rows[0])
    np.testing.assert_allclose(rows[1], row, atol=1e-9 * np.abs(row).max())
    for value, y in zip(values, u, strict=True):
        assert float(value) == pytest.approx(float(row @ np.asarray(y)), rel=1e-8)
    limit = FunctionLimitState(lambda y: 1 - jnp.asarray(row) @ y, 31)
    found = search.design_points(limit, np.stack([row, row[::-1]]), 100.0)
    assert found.aligned[0]
    assert found.beta[0] == pytest.approx(1 / np.linalg.norm(row), rel=1e-9)
    np.testing.assert_allclose(found.u[0], row / (row @ row), atol=1e-8)
    lifted = rj.simulate(ELASTIC, MOTION.record(found.u[0] * (1 + 1e-9)))
    assert float(lifted.uplift_time) == pytest.approx(at, abs=1e-4)


@pytest.mark.slow
def test_programs_of_slopes_are_kept():
    """Programs of G and its derivatives are stored, except derivatives with respect to the parameters of a
    podium, whose result is a tree of modules."""
    u = np.asarray(MOTION.samples(3, seed=4))
    of = lambda limit: StructureLimitState(
        BLOCK, MOTION, parse_limit("test", limit, BLOCK)
    ).with_sensitivities(u)
    first = of(("rotation", 0.3))
    finish_writing()
    compiled = COUNTS["compiled"]
    forget()
    again = of(("rotation", 0.3))
    of(("rotation", 0.4))
    assert COUNTS["compiled"] == compiled
    assert jax.tree.all(jax.tree.map(np.array_equal, first, again))
    assert set(first[2]) >= {"alpha", "R", "S_0", "omega_g"}


@pytest.mark.parametrize("factor", [2.5, 4.0])
def test_a_frame_has_the_limit_state_of_its_equivalent_block(factor):
    """G is equal for each u, and so are P and the design points."""
    frame = rj.Podium(alpha=0.2, R=0.8, gamma=3.0, superstructure=rj.Rigid(4.0))
    motion = MOTION.scaled(factor)
    u = np.asarray(motion.samples(64, seed=2))
    values = [
        StructureLimitState(podium, motion, parse_limit("test", "overturning", podium)).values(u)
        for podium in (frame, frame.equivalent_block())
    ]
    np.testing.assert_allclose(values[0], values[1], atol=1e-7)
    assert 0 < (values[0] <= 0).sum() < 64


@pytest.mark.slow
def test_parameters_of_random_pulses_have_sensitivities():
    """The numbers of a pulse may be Python floats. Without names of parameters, `log_slopes` needs no
    sensitivities."""

    def limit_state(median: float) -> StructureLimitState:
        pulse = rj.RandomPulse(rj.Lognormal(median, 0.3), rj.Lognormal(1.2, 0.2), centre=1.2)
        motion = dataclasses.replace(MOTION, pulse=pulse)
        return StructureLimitState(BLOCK, motion, parse_limit("test", "overturning", BLOCK))

    limit, h = limit_state(0.4), 1e-4
    u = np.random.default_rng(2).normal(scale=0.5, size=(2, limit.dimension))
    values, slope, by_location = limit.with_sensitivities(u)
    np.testing.assert_allclose(values, limit.values(u), rtol=1e-6)
    up, down = (limit_state(0.4 + sign * h).values(u) for sign in (1, -1))
    np.testing.assert_allclose(by_location["pulse.amplitude.median"], (up - down) / (2 * h), rtol=1e-3)
    value, along, by_name = limit.log_slopes(u, ())
    np.testing.assert_allclose(value, values, rtol=1e-6)
    np.testing.assert_allclose(along, np.sum(slope * u, axis=1), rtol=1e-9)
    assert by_name.shape == (2, 0)


@pytest.mark.slow
def test_slopes_of_the_distance_are_those_of_design_points_found_again(monkeypatch):
    limit = parse_limit("test", ("rotation", 0.2), BLOCK)
    point = rj.design_points(BLOCK, MOTION, limit=("rotation", 0.2), starts=2)[0]
    assert point.smooth
    options = OPTIONS.replace(rtol=1e-12, atol=1e-14)
    h = 2e-3
    monkeypatch.setattr(search, "ALIGNED", 1e-12)

    def found(podium, motion):
        again = search.design_points(StructureLimitState(podium, motion, limit, options), point.u[None])
        return float(again.beta[0])

    for name in ("alpha", "R", "S_0", "omega_g", "zeta_g"):
        of_podium = hasattr(BLOCK, name)
        complete = BLOCK if of_podium else MOTION
        y = float(getattr(complete, name))
        moved = [dataclasses.replace(complete, **{name: y * (1 + s * h)}) for s in (1, -1)]
        up, down = (found(w, MOTION) if of_podium else found(BLOCK, w) for w in moved)
        slope = (up - down) / (2 * h * y)
        # 1e-5 of the slope, or of β where the slope is small, because distances are found to 1e-8.
        assert point.sensitivities[name] == pytest.approx(slope, rel=1e-5, abs=1e-5 * point.beta / y), name
