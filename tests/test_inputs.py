"""Invalid inputs raise a `ValueError` before tracing, which names the argument, the value and the valid
values."""

import dataclasses
import math

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj

from .scenes import PODIUMS, pulse

VALID = {"alpha": 0.2, "R": 1.5}
TWO_RECORDS = rj.Records.of([rj.Record([0.0, y, -y, 0.0], 0.1) for y in (1.0, 2.0)])


@pytest.mark.smoke
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"alpha": 0.0}, ["alpha", "0.0", "π/2"]),
        ({"alpha": -0.1}, ["alpha", "-0.1"]),
        ({"alpha": math.pi / 2}, ["alpha", "1.57"]),
        ({"alpha": math.nan}, ["alpha", "nan"]),
        ({"R": 0.0}, ["R", "> 0"]),
        ({"R": math.inf}, ["R", "inf"]),
        ({"gamma": -1.0}, ["gamma", "-1.0", ">= 0"]),
        ({"lam": -0.1}, ["lam"]),
        ({"g": 0.0}, ["g"]),
        ({"restitution": "papper"}, ["restitution", "papper", "compatible"]),
        ({"restitution": 1.1}, ["restitution", "1.1"]),
        ({"restitution": -0.1}, ["restitution", "-0.1"]),
        ({"superstructure": 3.0}, ["superstructure", "Elastic"]),
        ({"alpha": "0.2"}, ["0.2"]),
        ({"alpha": np.array([0.2, -0.3])}, ["alpha", "-0.3"]),
    ],
)
def test_podium(changes, words):
    with pytest.raises(ValueError) as error:
        rj.Podium(**{**VALID, **changes})
    for word in words:
        assert word in str(error.value)


@pytest.mark.smoke
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rj.Elastic(1.0, 0.0), ["T_s", "0.0", "Rigid"]),
        (lambda: rj.Elastic(-1.0, 0.5), ["eta", "-1.0"]),
        (lambda: rj.Elastic(1.0, 0.5, -0.05), ["zeta", "-0.05"]),
        (lambda: rj.Rigid(-1.0), ["eta", "-1.0"]),
        (lambda: rj.Podium.from_dimensions(0.0, 3.0, 100.0), ["width", "0.0"]),
        (lambda: rj.Podium.from_dimensions(0.4, 3.0, 100.0, beam_mass=-1.0), ["beam_mass", "-1.0"]),
        (lambda: rj.Podium.from_dimensions(0.4, 3.0, 100.0, columns=0), ["columns", "0"]),
        (lambda: rj.Ricker(1.0, 0.0), ["Ricker", "T_p", "0.0"]),
        (lambda: rj.OneSine(math.inf, 1.0), ["OneSine", "a_p", "inf"]),
        (lambda: rj.MavroeidisPapageorgiou(1.0, 1.0, gamma=0.9), ["gamma", "0.9", "> 1"]),
        (lambda: rj.Gabor(1.0, 1.0, gamma=0.0), ["gamma"]),
        (lambda: rj.Record([], 0.01), ["acceleration", "two samples"]),
        (lambda: rj.Record([1.0, math.nan, 2.0], 0.01), ["acceleration", "nan", "sample 1"]),
        (lambda: rj.Record([1.0, 2.0], 0.0), ["dt", "0.0"]),
        (lambda: rj.Options(rtol=1e-16), ["rtol", "1e-16"]),
        (lambda: rj.Options(atol=0.0), ["atol", "0.0"]),
        (lambda: rj.Options(rtol=0.5), ["rtol", "0.5"]),
        (lambda: rj.Options(method="tsit6"), ["method", "tsit6", "tsit5"]),
        (lambda: rj.Options(method="kvaerno5"), ["Kvaerno5", "segments"]),
        (lambda: rj.Options(method=diffrax.Euler()), ["Euler", "error estimate"]),
        (lambda: rj.Options(engine="quick"), ["engine", "quick"]),
        (lambda: rj.Options(outputs=("rotation",)), ["outputs", "rotation", "peak_rotation"]),
        (lambda: rj.Options(max_steps=0), ["max_steps"]),
        (lambda: rj.Options(overturn_ratio=-1.0), ["overturn_ratio", "-1.0"]),
        (lambda: rj.peak_response(3.0, pulse()), ["podium", "3.0"]),
        (lambda: rj.peak_response(PODIUMS["rigid"], None), ["excitation", "None"]),
        (lambda: rj.peak_response(PODIUMS["rigid"], pulse(), t_end=-3.0), ["t_end", "-3.0"]),
        (
            lambda: rj.simulate(PODIUMS["rigid"], pulse(), initial=rj.State(math.nan)),
            ["initial.theta", "nan"],
        ),
        (
            lambda: rj.peak_response(PODIUMS["rigid"], rj.Ricker(1.0, np.ones(3)), t_end=np.ones(3)),
            ["t_end", "(3,)"],
        ),
        (
            lambda: rj.peak_responses(PODIUMS["rigid"], pulse(), t_end=-3.0),
            ["t_end", "-3.0", "after the start"],
        ),
        (
            lambda: rj.peak_responses(PODIUMS["rigid"], pulse(), t_end=np.array([1.0, math.nan])),
            ["t_end", "nan"],
        ),
        (
            lambda: rj.overturning_spectrum(PODIUMS["block"], rj.Ricker, [2.0], sensitivities=["R", "R"]),
            ["name each parameter once", "R"],
        ),
        (
            lambda: rj.overturning_spectrum(
                PODIUMS["block"], rj.Ricker, [2.0], max_acceleration_ratio=np.ones(2)
            ),
            ["max_acceleration_ratio must be one number", "(2,)"],
        ),
        (
            lambda: rj.record_spectrum(PODIUMS["block"], TWO_RECORDS, [2.0], max_scale=[1.0, 2.0]),
            ["max_scale must be one number", "(2,)"],
        ),
        (lambda: TWO_RECORDS.scaled(math.nan), ["Records", "scale", "nan"]),
        (
            lambda: rj.grid(PODIUMS["rigid"], TWO_RECORDS, scale=[1.0, math.inf]),
            ["scale", "inf"],
        ),
        (
            lambda: rj.peak_response(PODIUMS["block"], pulse(), options=rj.Options(overturn_ratio=6.0)),
            ["π/(2α)", "6.0"],
        ),
        (lambda: rj.rocking_spectrum(PODIUMS["rigid"], rj.Ricker, [0.0], [1.0]), ["frequency_ratio", "0.0"]),
        (
            lambda: rj.rocking_spectrum(PODIUMS["rigid"], rj.Ricker, [1.0], [[1.0]]),
            ["acceleration_ratio", "1-D"],
        ),
    ],
)
def test_value_errors_name_the_fault(make, words):
    with pytest.raises(ValueError) as error:
        make()
    for word in words:
        assert word in str(error.value)


@pytest.mark.smoke
def test_replace_checks_as_well():
    with pytest.raises(ValueError, match="alpha"):
        dataclasses.replace(PODIUMS["rigid"], alpha=2.0)


def test_a_batch_where_one_scene_is_wanted_says_so():
    with pytest.raises(ValueError, match="peak_responses"):
        rj.peak_response(rj.Podium(np.array([0.2, 0.3]), 1.5), pulse())


@pytest.mark.parametrize("bad", [-0.1, jnp.nan])
def test_under_jit_the_result_says_so(bad):
    peak = jax.jit(lambda a: rj.peak_response(rj.Podium(a, 1.5), pulse()))(bad)
    assert peak.result == rj.RESULTS.not_finite


def test_out_of_steps_is_raised_outside_and_named_inside():
    o = rj.Options(max_steps=10)
    with pytest.raises(RuntimeError, match="out_of_steps"):
        rj.peak_response(PODIUMS["elastic"], pulse(), options=o)
    quiet = rj.peak_response(PODIUMS["elastic"], pulse(), options=o.replace(throw=False))
    assert quiet.result == rj.RESULTS.out_of_steps
    inside = jax.jit(lambda a: rj.peak_response(PODIUMS["elastic"], rj.Ricker(a, 1.0), options=o))(3.0)
    assert inside.result == rj.RESULTS.out_of_steps


def test_history_grows_outside_jit_and_says_so_inside():
    o = rj.Options(history=16)
    response = rj.simulate(PODIUMS["rigid"], pulse(), options=o)
    assert response.times.shape[0] > 16
    assert np.all(np.isfinite(response.times))
    inside = jax.jit(lambda a: rj.simulate(PODIUMS["rigid"], rj.Ricker(a, 1.0), options=o))(3.0)
    assert inside.result == rj.RESULTS.history_full
