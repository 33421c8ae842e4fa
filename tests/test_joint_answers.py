"""Answers of the joints in peaks: whether joints stay closed, and the rows of the text and of the HTML."""

import warnings
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax import _results as results
from rockjax._report.assumptions import ASSUMPTIONS
from rockjax._responses.arguments import warn_of_small_restitution
from rockjax._responses.peak import MEAN_COLUMN_NOTE, OPEN_JOINT_NOTE, Peak


def peak(has_elevation: bool = True, **values: Any) -> Peak:
    """Return made-up peaks of one scene with answers of the joints."""
    zero, flag = jnp.zeros(()), jnp.asarray(False)
    names = "peak_rotation", "peak_rotation_time", "peak_deformation", "peak_shear"
    others = dict.fromkeys(names, zero)
    return Peak(
        values=others | {name: jnp.asarray(y, float) for name, y in values.items()},
        exceeded_alpha=flag, overturned=flag, overturn_time=zero, uplifted=flag, uplift_time=zero,
        impacts=zero, smallest_impact_speed=zero, errors=None, result=results.result_of(jnp.asarray(0)),
        stats=rj.Stats(jnp.asarray(1), jnp.asarray(0), zero), has_elevation=has_elevation,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("values", "is_closed"),
    [
        ({}, True),
        ({"least_axial_force": (0.0, 0.1)}, True),
        ({"least_axial_force": (0.1, -1e-9)}, False),
        ({"least_axial_force": (np.nan, np.nan)}, False),
        ({"least_impulse_share": (0.0, 1.0)}, True),
        ({"least_impulse_share": (1.0, -0.1)}, False),
        ({"peak_friction": (0.1, 9.0)}, True),
        ({"peak_friction": (0.1, np.inf)}, False),
        ({"peak_friction": (np.nan, 0.1)}, False),
        # N = 0 with T ≠ 0 is closed, although the friction demand is infinite.
        ({"least_axial_force": (0.1, 0.0), "peak_friction": (0.1, np.inf)}, True),
        ({"least_axial_force": (0.1, 0.1), "least_impulse_share": (1.0, -0.1)}, False),
    ],
)
def test_joints_are_closed_according_to_the_requested_answers(values, is_closed):
    assert bool(peak(**values).joints_closed) is is_closed


def test_a_batch_has_a_flag_for_each_scene():
    batch = peak(least_axial_force=[[0.1, 0.2], [0.1, -0.2]])
    assert np.array_equal(batch.joints_closed, [True, False])


@pytest.mark.parametrize(
    ("least", "has_elevation", "note"),
    [(0.1, True, "closed"), (0.1, False, MEAN_COLUMN_NOTE), (-0.1, True, OPEN_JOINT_NOTE)],
)
def test_rows_of_joints(least, has_elevation, note):
    given = peak(
        has_elevation, peak_friction=(0.25, 0.125), least_axial_force=(2.0, least), peak_foundation_shear=0.5
    )
    lines = repr(given).splitlines()
    for label, value in (
        ("max |T|/N", "0.25, 0.125 (bottom, top)"),
        ("min N/(m_c g)", f"2, {least:g} (bottom, top)"),
        ("joints", note),
    ):
        assert f"  {label:<16} {value}" in lines
        assert value in given._repr_html_()
    assert any(line.endswith(" 0.5") for line in lines)


def test_no_rows_without_answers():
    lines = repr(peak(peak_deformation=np.nan, peak_shear=np.nan))
    assert not any(label in lines for label in ("joints", "deformation", "shear"))


def test_scenes_know_whether_they_have_an_elevation():
    """Forces of a scene without an elevation are those of the mean column."""
    podium = rj.Podium(0.25, 1.2, 1.0, restitution=0.8)
    with_columns = podium.replace(elevation=rj.Elevation([-1.0, 1.0]))
    options, motion = rj.Options(outputs=("axial_force",)), rj.Ricker(0.1, 0.5)
    with pytest.warns(rj.PlausibilityWarning, match=r"e = 0\.8 < 0\.88") as caught:
        found = [rj.peak_response(each, motion, options=options) for each in (podium, with_columns)]
    assert {warning.filename for warning in caught} == {__file__}
    assert [each.has_elevation for each in found] == [False, True]
    assert MEAN_COLUMN_NOTE in repr(found[0])
    assert "joints           closed\n" in repr(found[1])


def messages_of(podium: rj.Podium) -> list[str]:
    """Return the warnings about the restitution factor of a podium."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_small_restitution(podium, 2)
    return [str(warning.message) for warning in caught]


BUILDING = rj.ShearBuilding((3.0, 3.0, 2.0), (900.0, 700.0, 500.0), modes=2)


@pytest.mark.parametrize(
    "podium",
    [
        rj.Podium(0.25, 1.2),
        rj.Podium(0.15, 1.5, 10.0, rj.Rigid(50.0), lam=0.5),
        rj.Podium(0.15, 1.5, 10.0, rj.Elastic(50.0, 0.5)),
        rj.Podium(0.15, 1.5, 10.0, BUILDING, restrainers=(rj.Tendon(1.0), rj.Inerter(2.0, joints=1))),
    ],
)
def test_restitution_below_that_of_compatible_impacts_warns(podium):
    """The factor of the law "compatible" is the least one that causes no warning, and ξ_J = 1 there."""
    least = float(podium.replace(restitution="compatible").restitution_factor)
    for law in ("paper", "compatible", least, least + 1e-6):
        assert not messages_of(podium.replace(restitution=law))
    small = podium.replace(restitution=0.9 * least)
    (message,) = messages_of(small)
    assert f"rigid faces: e = {0.9 * least:.4g} < {least:.4g}, so" in message
    assert f"impact_eccentricity = {float(small.impact_eccentricity):.3g} > 1" in message
    assert jax.jit(lambda R: R + len(messages_of(small.replace(R=R))))(1.0) == 1.0


def test_warnings_of_a_batch_count_the_structures(monkeypatch):
    """Block of α = 0.25: the least factor is 1 − 1.5 sin²α = 0.9082."""
    monkeypatch.setattr("rockjax._batch.batch.responses", lambda *_: found)
    found = SimpleNamespace(result=results.result_of(jnp.zeros((2, 3), int)))
    factors = np.array([[0.91, 0.9, 0.85], [np.nan, 0.95, 0.908]])
    small = rj.Podium(0.25, 1.2).replace(restitution=np.array(0.95))
    small = eqx.tree_at(lambda podium: podium.restitution.e, small, factors)
    with pytest.warns(rj.PlausibilityWarning, match=r"in 3 of 6 structures; the worst: e = 0\.85 < 0\.9082"):
        rj.peak_responses(small, rj.Ricker(3.0, 1.0))


def test_reports_state_a_factor_that_is_too_small_for_rigid_faces():
    (law,) = (each for each in ASSUMPTIONS if each.id == "A6")
    rigid = rj.Podium(0.25, 1.2)
    compatible = float(rigid.restitution_factor)
    for factor, is_stated in ((0.99 * compatible, True), (compatible, False), (1.0, False)):
        for laws in ((), ("compatible",)):
            podium = rigid.replace(restitution=factor)
            problem: Any = SimpleNamespace(podium=podium, report=SimpleNamespace(laws=laws))
            data: Any = None
            assert ("too small for rigid faces" in str(law.test(problem, data))) is is_stated
