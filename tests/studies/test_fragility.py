"""Ensembles: records in one table, incremental dynamic analysis, fragility curves and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import scipy.stats
import xarray

import rockjax as rj
from rockjax import _lognormal
from rockjax._studies import fragility
from rockjax._studies.curve import MIN_RECORDS
from rockjax._studies.fragility import DEFAULT_OPTIONS
from rockjax._studies.intervals import Capacities, profile_intervals
from tests.scenes import PODIUMS, shaking

BLOCK = rj.Podium(alpha=0.2, R=1.0)
fit_capacities, fit_counts = jax.jit(_lognormal.fit_capacities), jax.jit(_lognormal.fit_counts)


def suite() -> list[rj.Record]:
    """Return records of different lengths and intervals, one with a negative scale and one that starts
    later."""
    one, two, three = shaking(120, 0.02, 3.0, 1), shaking(260, 0.01, 4.0, 2), shaking(75, 0.04, 3.5, 3)
    return [one, two.scaled(-1.5), rj.Record(three.acceleration + 0.1, three.dt, t_start=2.0)]


RECORDS = suite()
TABLE = rj.Records.of(RECORDS)


@pytest.mark.slow
def test_a_wide_width_needs_no_more_places_than_the_first():
    """The search refines changes among the first evaluated scales."""
    levels = np.linspace(1.0, 12.0, 3)
    rough = rj.incremental_dynamic_analysis(BLOCK, TABLE, levels, width=0.1, resolution=64)
    close = rj.incremental_dynamic_analysis(BLOCK, TABLE, levels, width=1e-3, resolution=64)
    assert np.all(close["certain_width"] <= 1e-3 * 12.0)
    assert np.all(rough["capacity"] >= close["capacity"] * (1 - 1e-9))


# --------------------------------------------------------------------------------------- records in one table
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["rigid", "elastic"])
def test_a_table_answers_as_its_records_do(kind):
    podium = PODIUMS[kind]
    scales = np.linspace(0.4, 3.0, 30)
    options = rj.Options(outputs=("peak_rotation", "peak_shear") if kind == "rigid" else ("peak_rotation",))
    together = rj.peak_responses(podium, TABLE.pick(np.arange(3)[:, None]).scaled(scales), options=options)
    assert together.peak_rotation.shape == (3, 30)
    assert 0 < together.overturned.sum() < 90
    for j, record in enumerate(RECORDS):
        alone = rj.peak_responses(podium, record.scaled(scales), options=options)
        for name in ("peak_rotation", "peak_shear", "uplift_time", "overturned"):
            a, b = getattr(together, name)[j], getattr(alone, name)
            np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-9, err_msg=f"{name} of record {j}")


def test_a_table_is_the_same_motion():
    t = np.linspace(-1.0, 8.0, 400)
    for j, record in enumerate(RECORDS):
        one = TABLE.pick(j)
        np.testing.assert_allclose(one(t), record(t), rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(one(record.breakpoints), record(record.breakpoints), rtol=1e-13)
        np.testing.assert_allclose(one.support, record.support)
        reference = np.asarray(one.breakpoints)
        np.testing.assert_allclose(reference[: record.acceleration.size], record.breakpoints)
        assert np.all(reference[record.acceleration.size :] == np.inf)
    assert len(list(TABLE)) == len(TABLE) == 3


@pytest.mark.slow
def test_derivatives_of_a_scene_of_a_table():
    podium = PODIUMS["rigid"]

    @jax.jit
    @jax.grad
    def slopes(numbers, motion):
        alpha, scale = numbers
        return rj.peak_response(podium.replace(alpha=alpha), motion.scaled(scale)).peak_rotation

    both = [slopes((podium.alpha, jnp.asarray(1.1)), motion) for motion in (TABLE.pick(1), RECORDS[1])]
    assert all(slope != 0 for slope in both[0])
    np.testing.assert_allclose(*both, rtol=1e-7)


@pytest.mark.slow
def test_segments_engine_takes_a_table():
    options = rj.Options(rtol=1e-10, atol=1e-12, engine="segments")
    motion = TABLE.pick(2).scaled(1.3)
    a, b = rj.peak_response(BLOCK, motion, options=options), rj.peak_response(BLOCK, motion)
    assert float(a.peak_rotation) == pytest.approx(float(b.peak_rotation), abs=1e-7)
    assert b.peak_rotation > 0


@pytest.mark.slow(but=["0.5-2", "2.0-65", "20.0-300"])
@pytest.mark.parametrize("n", [2, 3, 64, 65, 300])
@pytest.mark.parametrize("threshold", [0.5, 2.0, 20.0])
def test_next_exceedance_against_fine_sampling(n, threshold):
    rng = np.random.default_rng(n)
    record = rj.Record(rng.normal(size=n), 0.1, scale=-1.5)
    lookahead = record.lookahead(jnp.asarray(threshold))
    samples = 0.1 * np.arange(n)
    begin = np.sort(np.concatenate([rng.uniform(-0.2, samples[-1], 100), samples[:-1]]))
    found = np.asarray(jax.jit(jax.vmap(lambda t: lookahead.next_exceedance(t, record.locate(t))))(begin))
    fine = np.union1d(np.linspace(-0.2, samples[-1], 30001), samples)
    above = fine[np.abs(np.asarray(record(fine))) > threshold]
    for t, next_time in zip(begin, found, strict=True):
        later = above[above >= t]
        if not len(later):
            assert next_time >= samples[-1] - 1e-9 or next_time == np.inf
            continue
        assert t <= next_time <= later[0] + 1e-9
        assert later[0] - next_time <= 2 * (samples[-1] + 0.2) / 30000
        assert abs(float(record(next_time))) >= threshold * (1 - 1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rj.Records.of([]), "at least one record"),
        (lambda: rj.Records.of([RECORDS[0], rj.Ricker(1.0, 1.0)]), "entry 1 must be a rockjax.Record"),
        (lambda: rj.Records.of([RECORDS[0].scaled(np.ones(3))]), "single record"),
        (lambda: TABLE.pick(3), "from 0 to 2"),
        (lambda: TABLE.pick(1.0), "whole numbers"),
    ],
)
def test_tables_that_make_no_sense(make, words):
    with pytest.raises(ValueError, match=words):
        make()


# ---------------------------------------------------------------------------------------------- distributions
def test_fits_are_those_of_scipy():
    rng = np.random.default_rng(1)
    capacity = 0.8 * np.exp(0.4 * rng.normal(size=60))
    plain = fit_capacities(jnp.asarray(capacity), jnp.full(60, 9.0))
    assert float(plain.median) == pytest.approx(np.exp(np.log(capacity).mean()), rel=1e-9)
    assert float(plain.dispersion) == pytest.approx(np.log(capacity).std(), rel=1e-9)

    limit = 1.0
    reference = capacity < limit
    censored = fit_capacities(jnp.where(reference, capacity, jnp.inf), jnp.full(60, limit))

    def loss(y):
        log = np.log(np.where(reference, capacity, limit))
        likelihood = scipy.stats.norm(y[0], np.exp(y[1]))
        return -np.where(reference, likelihood.logpdf(log), likelihood.logsf(log)).sum()

    tight = {"xatol": 1e-10, "fatol": 1e-12, "maxiter": 10_000}
    best = np.exp(scipy.optimize.minimize(loss, [0.0, -1.0], method="Nelder-Mead", options=tight).x)
    np.testing.assert_allclose(censored, best, rtol=1e-6)

    levels, trials = np.linspace(0.2, 2, 10), np.full(10, 40.0)
    events = rng.binomial(40, scipy.stats.norm.cdf(np.log(levels / 0.8) / 0.4)).astype(float)

    def counts(y):
        z = (np.log(levels) - y[0]) / np.exp(y[1])
        return -np.sum(events * scipy.stats.norm.logcdf(z) + (trials - events) * scipy.stats.norm.logsf(z))

    best = np.exp(scipy.optimize.minimize(counts, [0.0, -1.0], method="Nelder-Mead", options=tight).x)
    np.testing.assert_allclose(fit_counts(levels, events, trials), best, rtol=1e-6)


@pytest.mark.parametrize(
    ("observed", "censored", "distance"),
    [([1.0, 1.7, 3.0], 97, 25.0), ([1.0, 1.03, 1.08], 12, 1.7), ([1.0, 1.001, 0.999], 3, 3000.0)],
)
def test_fits_exist_however_many_capacities_are_censored(observed, censored, distance):
    """At the maximum, the derivatives of the likelihood are zero, whatever the unit of the capacities."""
    log = np.log([*observed, *[max(observed) * distance] * censored])
    is_observed = np.arange(log.size) < len(observed)
    for unit in (1e-3, 1.0, 1e4):
        capacity = jnp.asarray(np.where(is_observed, unit * np.exp(log), np.inf))
        median, dispersion = map(float, fit_capacities(capacity, jnp.asarray(unit * np.exp(log))))
        z = (log - np.log(median / unit)) / dispersion
        slope = np.where(is_observed, z, np.exp(scipy.stats.norm.logpdf(z) - scipy.stats.norm.logsf(z)))
        np.testing.assert_allclose([slope.mean(), (slope * z - is_observed).mean()], 0, atol=1e-7)


def test_derivatives_of_a_fit():
    capacity = jnp.array([0.5, 0.62, 0.9, 0.75, jnp.inf, jnp.inf])
    limit = jnp.ones(6)
    jacobian = jax.jit(jax.jacrev(_lognormal.fit_capacities))(capacity, limit)
    for k, name in enumerate(("median", "dispersion")):
        gradient = jacobian[k]
        for j in range(4):
            step = 1e-6 * jnp.eye(6)[j]
            up, down = (fit_capacities(capacity + s * step, limit)[k] for s in (1, -1))
            assert float(gradient[j]) == pytest.approx(float(up - down) / 2e-6, rel=1e-5), name


@pytest.mark.parametrize(
    "capacity", [[0.5, np.inf, np.inf], [np.inf] * 3, [0.4, 0.4, 0.4]], ids=["one", "none", "all the same"]
)
def test_invalid_fits_are_nan(capacity):
    """Derivatives raise no error; if NaN is replaced, the derivatives with respect to the capacities are
    zero."""
    capacity, limit = jnp.asarray(capacity), jnp.ones(3)
    assert np.isnan(fit_capacities(capacity, limit).median)

    def median(capacity):
        found = _lognormal.fit_capacities(capacity, limit).median
        return jnp.where(jnp.isnan(found), 3.0, found)

    for of in (jax.jacfwd, jax.jacrev):
        np.testing.assert_array_equal(jax.jit(of(median))(capacity), np.zeros(3))


WITHOUT_MAXIMUM = {
    "half at all levels": (
        [10] * 8,
        "the same share of the records, 50%, overturns at all levels from 1 to 8",
    ),
    "a twentieth at all levels": ([1] * 8, "the same share of the records, 5%"),
    "as many at the ends": ([8, 9, 10, 11, 11, 10, 9, 8], "hardly rises with the intensity, from 40% at 1"),
    "one more at the last level": (
        [5] * 7 + [6],
        "hardly rises with the intensity, from 25% at 1 to 30% at 8",
    ),
    "falling": ([8, 7, 6, 5, 4, 3, 2, 1], "falls with the intensity, from 40% at 1 to 5% at 8"),
    "falling from all to none": ([20] * 4 + [0] * 4, "falls with the intensity, from 100% at 1 to 0% at 8"),
    "separated": ([0] * 4 + [20] * 4, "too far apart"),
    "separated by one level": ([0] * 3 + [7] + [20] * 4, "too far apart"),
    "none": ([0] * 8, "no record overturns at the levels up to 8"),
    "all": ([20] * 8, "all records overturn at all levels from 1 on; lower"),
}


@pytest.mark.parametrize("name", WITHOUT_MAXIMUM)
def test_counts_without_a_maximum_of_the_likelihood_are_rejected_with_the_reason(name):
    events, words = WITHOUT_MAXIMUM[name]
    levels, overturned = np.arange(1.0, 9.0), np.arange(20)[:, None] < np.array(events)
    assert np.isnan(fit_counts(levels, np.asarray(events, float), np.full(8, 20.0))).all()
    stripe_analysis = xarray.Dataset(
        {
            "overturned": (("record", "intensity"), overturned),
            "capacity": ("record", np.where(overturned.any(1), 1.0, np.nan)),
        },
        coords={"intensity": ("intensity", levels, {"units": "m s-2"})},
        attrs={"kind": "incremental-dynamic-analysis", "measure": "PGA"},
    )
    with pytest.raises(ValueError, match=words):
        rj.fragility(stripe_analysis, method="stripes", confidence=None)


@pytest.mark.parametrize("events", [[0, 20] * 4, [0, 0, 0, 1, 0, 20, 20, 20], [1, 0, 0, 0, 0, 0, 0, 20]])
def test_counts_that_rise_and_fall_are_fitted_where_the_likelihood_is_greatest(events):
    levels = np.arange(1.0, 9.0)

    def loss(y):
        z = np.log(levels / np.exp(y[0])) / np.exp(y[1])
        return -np.sum(
            events * scipy.stats.norm.logcdf(z) + (20 - np.array(events)) * scipy.stats.norm.logsf(z)
        )

    tight = {"xatol": 1e-10, "fatol": 1e-12, "maxiter": 10_000}
    best = np.exp(scipy.optimize.minimize(loss, [1.5, -0.5], method="Nelder-Mead", options=tight).x)
    found = fit_counts(levels, np.asarray(events, float), np.full(8, 20.0))
    np.testing.assert_allclose(found, best, rtol=1e-6)


# --------------------------------------------------------------------------------------------------- analysis
@pytest.fixture(scope="module")
def analysis():
    motions = rj.synthetic_motions(8, seed=3, duration=8.0, dt=0.02, pulse=None)
    table = rj.Records.of(motions.records())
    levels = np.linspace(1.0, 14.0, 14)
    data = rj.incremental_dynamic_analysis(
        BLOCK, table, levels, names=motions.names, sensitivities=["alpha", "R"], resolution=64
    )
    return table, data


@pytest.mark.slow
def test_boundaries_are_where_the_verdict_changes(analysis):
    table, data = analysis
    places = data["boundaries"].values
    line, number = np.nonzero(np.isfinite(places))
    scale = places[line, number] / data["measure"].values[line]
    below, above = (
        rj.peak_responses(
            BLOCK, table.pick(line.astype(np.int32)).scaled(scale * side), options=DEFAULT_OPTIONS
        ).overturned
        for side in (1 - 1e-9, 1 + 1e-9)  # the capacity of record 4 is the end of a window 3e-6 wide
    )
    assert line.size > 8
    np.testing.assert_array_equal(below, number % 2 == 1)
    np.testing.assert_array_equal(above, number % 2 == 0)
    np.testing.assert_array_equal(data["capacity"], places[:, 0])


def test_the_responses_are_those_of_the_scaled_records(analysis):
    table, data = analysis
    level = data["intensity"].values[3]
    motion = table.pick(2)
    unit = float(jnp.max(jnp.abs(motion.table[2])))
    assert float(data["measure"][2]) == pytest.approx(unit)
    peak = rj.peak_response(BLOCK, motion.scaled(level / unit), options=DEFAULT_OPTIONS)
    assert float(data["peak_rotation"][2, 3]) == pytest.approx(float(peak.peak_rotation), rel=1e-9)
    assert data.attrs["measure"] == "PGA"
    assert data["capacity"].attrs["units"] == "m s-2"


def test_sensitivities_of_capacities_against_bisection(analysis):
    """Sensitivities agree with bisection of the boundary for slightly different alpha or R."""
    table, data = analysis
    h = 1e-6
    for parameter in ("alpha", "R"):
        slopes = data["sensitivity"].sel(parameter=parameter).values
        for j in (0, 2, 7):  # no other boundary within 3e-4; record 4 has another one below
            ends = []
            for sign in (1, -1):
                podium = BLOCK.replace(**{parameter: getattr(BLOCK, parameter) * np.exp(sign * h)})
                lo, hi = (float(data["capacity"][j]) * (1 + s * 2e-4) for s in (-1, 1))
                while hi - lo > 1e-12 * hi:
                    places = np.linspace(lo, hi, 66)
                    motion = table.pick(np.full(66, j, np.int32)).scaled(places / float(data["measure"][j]))
                    first = int(
                        np.argmax(rj.peak_responses(podium, motion, options=DEFAULT_OPTIONS).overturned)
                    )
                    assert first > 0
                    lo, hi = places[first - 1], places[first]
                ends.append(np.log(0.5 * (lo + hi)))
            assert slopes[j] == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=2e-4, abs=2e-5), (
                parameter,
                j,
            )


def test_fragility_of_capacities(analysis):
    _, data = analysis
    curve = rj.fragility(data)
    log = np.log(data["capacity"].values)
    assert np.isfinite(log).all()
    assert float(curve["median_capacity"]) == pytest.approx(np.exp(log.mean()), rel=1e-9)
    assert float(curve["dispersion"]) == pytest.approx(log.std(), rel=1e-9)
    # All records have equal weights, so the derivative of the median is the mean of theirs.
    np.testing.assert_allclose(curve["median_sensitivity"], data["sensitivity"].mean("record"), rtol=1e-8)
    exact = scipy.stats.lognorm(log.std(), scale=np.exp(log.mean())).cdf(curve["at"])
    np.testing.assert_allclose(curve["probability"], exact, atol=1e-9)
    assert np.all((curve["lower"] <= curve["probability"]).values)
    assert np.all((curve["probability"] <= curve["upper"]).values)
    # Without censored records, intervals are Student's and the χ² interval for normal samples.
    expected = scipy.stats.t(7, log.mean(), scipy.stats.sem(log)).interval(0.9)
    np.testing.assert_allclose(np.log(curve["interval"].sel(quantity="median_capacity")), expected, rtol=1e-9)
    expected = np.sqrt(8 * log.var() / scipy.stats.chi2(7).ppf([0.95, 0.05]))
    np.testing.assert_allclose(curve["interval"].sel(quantity="dispersion"), expected, rtol=1e-9)
    assert curve["interval"].attrs["records"] == curve["interval"].attrs["overturning_records"] == 8
    # The band at P = 0.5 is the interval of the median.
    at = rj.fragility(data, at=curve["interval"].sel(quantity="median_capacity").values)
    np.testing.assert_allclose([at["upper"][0], at["lower"][1]], 0.5, atol=1e-9)
    alone = rj.fragility(data, confidence=None)
    assert not {"interval", "lower", "upper"} & set(alone.data_vars)
    xarray.testing.assert_equal(
        alone, curve[list(alone.data_vars)].drop_vars(["quantity", "bound"], errors="ignore")
    )


def test_fragility_of_stripes_is_the_fit_of_its_counts(analysis):
    _, data = analysis
    curve = rj.fragility(data, method="stripes")
    overturned = data["overturned"].values.astype(float)
    levels, counts = data["intensity"].values, overturned.sum(axis=0)
    fit = fit_counts(levels, counts, np.full(counts.size, 8.0))
    assert float(curve["median_capacity"]) == pytest.approx(float(fit.median))
    np.testing.assert_allclose(curve["observed"], counts / 8)
    # The jackknife over records.
    logs = np.log([fit_counts(levels, counts - row, np.full(counts.size, 7.0)).median for row in overturned])
    middle = 8 * np.log(fit.median) - 7 * logs.mean()
    half = scipy.stats.t(7).ppf(0.95) * np.sqrt(7 / 8 * np.sum((logs - logs.mean()) ** 2))
    bounds = curve["interval"].sel(quantity="median_capacity")
    np.testing.assert_allclose(np.log(bounds), [middle - half, middle + half], rtol=1e-6)


def test_scenes_that_did_not_finish_do_not_count_in_stripes(analysis):
    _, data = analysis
    unknown = data.assign(overturned=data["overturned"] & False, result=data["result"] * 0 + 3)
    both = xarray.concat([data, unknown], "record", data_vars="minimal", coords="minimal")
    expected, found = (rj.fragility(y, method="stripes", confidence=None) for y in (data, both))
    for name in ("median_capacity", "dispersion", "observed", "probability"):
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-9)
    both["result"][:, 0] = 3  # a level without finished scenes
    curve = rj.fragility(both, limit=("peak_rotation", 0.5), confidence=None)
    assert np.isnan(curve["observed"].values).tolist() == [True] + [False] * (curve["observed"].size - 1)


def test_records_that_never_overturn_are_censored(analysis):
    table, data = analysis
    levels = np.sort(data["capacity"].values)[[0, 4]] * [1.0, 1.001]
    low = rj.incremental_dynamic_analysis(BLOCK, table, levels, resolution=64)
    reference = np.isfinite(low["capacity"].values)
    assert reference.sum() >= MIN_RECORDS
    assert reference.sum() < 8
    curve = rj.fragility(low)
    assert float(curve["median_capacity"]) > np.exp(np.log(low["capacity"].values[reference]).mean())
    assert curve["interval"].attrs["overturning_records"] == reference.sum()
    with pytest.raises(ValueError, match="raise the highest intensity"):
        rj.fragility(rj.incremental_dynamic_analysis(BLOCK, table, levels[:1] / 2, resolution=64))


def test_a_fit_to_capacities_with_unknown_derivatives_has_none():
    capacity = np.array([0.5, 0.8, 1.3, np.inf])
    fit = lambda x: _lognormal.fit_capacities(x, jnp.full(4, 2.0)).median
    median, known = jax.jvp(fit, (capacity,), (np.array([0.5, 0.8, 1.3, 0.0]),))
    # The censored capacity keeps its bound, so the median grows less than in proportion to the others.
    assert 0 < known < median
    _, unknown = jax.jvp(fit, (capacity,), (np.array([0.5, np.nan, 1.3, 0.0]),))
    assert np.isnan(unknown)


def test_records_with_unfinished_scenes_are_censored_below_them():
    """Capacities above 0.9 are unknown, and then also those above 0.3 of four records."""
    levels, capacity = np.array([0.3, 0.6, 0.9, 1.2]), np.geomspace(0.2, 3.0, 12)
    low = stripe_analysis(np.where(capacity < 0.9, capacity, 9.0), levels[:3])
    high = stripe_analysis(np.where(capacity < 0.9, capacity, 9.0), levels)
    high["result"] = ("record", "intensity"), np.where((levels > 0.9) & (capacity > 0.9)[:, None], 9, 0)
    at = [0.5, 1.0]
    xarray.testing.assert_allclose(
        rj.fragility(high, at=at).drop_dims("intensity"), rj.fragility(low, at=at).drop_dims("intensity")
    )
    high["result"][-4:, 1] = 9  # an unfinished scene below a finished one
    log = np.log(capacity[capacity < 0.9])
    limits = np.log(np.where(np.arange(12) < 8, 0.9, 0.3)[capacity > 0.9])

    def loss(y):
        normal = scipy.stats.norm(y[0], np.exp(y[1]))
        return -normal.logpdf(log).sum() - normal.logsf(limits).sum()

    best = scipy.optimize.minimize(loss, [0.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-9}).x
    curve = rj.fragility(high)
    np.testing.assert_allclose([curve["median_capacity"], curve["dispersion"]], np.exp(best), rtol=1e-6)
    # A capacity above a scene that did not finish is not exact either.
    found_above = high.assign(capacity=high["capacity"].where(np.arange(12) < 11, 1.1))
    again = rj.fragility(found_above)
    assert float(again["median_capacity"]) == pytest.approx(float(curve["median_capacity"]), rel=1e-12)
    # On the bounds of the median, the profile likelihood is below its maximum by the quantile of Student's t.
    fall = 6 * np.log1p(scipy.stats.t(11).ppf(0.95) ** 2 / 11)
    for bound in np.log(curve["interval"].sel(quantity="median_capacity").values):
        profile = scipy.optimize.minimize_scalar(lambda y, bound=bound: loss([bound, y])).fun
        assert profile - loss(best) == pytest.approx(fall, rel=1e-6)
    high["result"][-1, 0] = 9
    # Nothing is known of a record whose lowest scene did not finish.
    high = high.assign_coords(record=np.arange(1, 13))
    with pytest.warns(RuntimeWarning, match=r"record 12 is left out .* 0.3 did not finish.*weightless"):
        without = rj.fragility(high)
    expected = rj.fragility(high.isel(record=slice(11)))
    for name in ("median_capacity", "dispersion", "interval"):
        np.testing.assert_array_equal(without[name], expected[name])
    high["result"][:, 0] = 9
    with (
        pytest.warns(RuntimeWarning, match="is left out"),
        pytest.raises(ValueError, match=r"1 of 11 records overturn below .* did not finish.*weightless"),
    ):
        rj.fragility(high.isel(record=slice(1, 12)))


def test_limits_refer_to_peaks_that_the_structure_has():
    data = stripe_analysis([0.8, 1.2, 9.0], [0.5, 1.0, 2.0])
    peaks = {
        "peak_rotation": 0.5,
        "peak_rotation_time": 2.0,
        "peak_rotation_error": 1e-9,
        "peak_shear": np.nan,
    }
    for name, value in peaks.items():
        data[name] = data["overturned"] * 0.0 + value
        if name != "peak_rotation":
            with pytest.raises(ValueError, match=rf"one of the peaks .*\['peak_rotation'\], got \('{name}'"):
                rj.fragility(data, limit=(name, 1.0))


def test_a_distribution_censors_records_below_scenes_that_did_not_finish(monkeypatch):
    def boundary(podium, motion, **_):
        scale = jnp.array([jnp.inf, 5.0, 4.0])[motion.which]
        finished_to = jnp.array([2.0, 3.0, 10.0])[motion.which]
        found = rj.Boundary(scale, True, 0, 1.0, False, 2.0, finished_to)
        return jax.tree.map(jnp.asarray, found)

    monkeypatch.setattr(fragility, "overturning_boundary", boundary)
    monkeypatch.setattr(fragility, "fit_capacities", lambda capacity, limit: (capacity, limit))
    found = rj.overturning_distribution(BLOCK, TABLE, max_scale=10.0, measure=np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(found[0], [np.inf, np.inf, 12.0])
    np.testing.assert_allclose(found[1], [2.0, 6.0, 30.0])


@pytest.mark.parametrize(("count", "levels"), [(1, [12.0]), (2, [0.5, 12.0])])
def test_a_single_level_is_the_highest(count, levels):
    motions = rj.synthetic_motions(1, seed=3, duration=2.0, dt=0.02)
    measure = fragility.measure_of("PGA", None, motions)
    np.testing.assert_allclose(fragility.levels_of(BLOCK, motions, measure, (0.5, 12.0), count), levels)


# -------------------------------------------------------------------------------------------------- intervals
def stripe_analysis(capacity, levels) -> xarray.Dataset:
    """Return the part of an analysis that `fragility` uses."""
    capacity = np.asarray(capacity, float)
    return xarray.Dataset(
        {
            "capacity": ("record", np.where(capacity <= levels[-1], capacity, np.nan)),
            "overturned": (("record", "intensity"), np.asarray(levels) >= capacity[:, None]),
        },
        coords={"intensity": ("intensity", levels, {"units": "1"})},
        attrs={"kind": "incremental-dynamic-analysis", "measure": "scale"},
    )


@pytest.mark.slow(but=["10-1.2"])
@pytest.mark.parametrize(("count", "limit"), [(5, 100.0), (10, 1.2), (40, 1.0)])
def test_intervals_have_the_stated_coverage(count, limit):
    """1000 samples, with no, a third or half of the records censored. A fraction of .9 has a standard error
    of .0095."""
    rng = np.random.default_rng(count)
    drawn = np.exp(0.4 * rng.normal(size=(1000, count)))
    drawn = np.where(drawn < limit, drawn, np.inf)
    fits = jax.jit(jax.vmap(_lognormal.fit_capacities))(drawn, np.full_like(drawn, limit))
    median, dispersion = (np.asarray(y) for y in fits)
    good = np.isfinite(median)
    of = Capacities.from_values(drawn[good], limit)
    found = profile_intervals(of, median[good], dispersion[good], np.array([[0.6], [1.6]]), 0.9)
    held = lambda bounds, truth: np.mean((bounds[0] <= truth) & (truth <= bounds[1]), axis=-1)
    shares = [held(found.log_median, 0), held(found.log_dispersion, np.log(0.4))]
    shares += list(held(found.probit, np.log([[0.6], [1.6]]) / 0.4))
    assert good.mean() > 0.99
    np.testing.assert_allclose(shares, 0.9, atol=0.03)


def test_few_records_cause_a_warning():
    with pytest.warns(RuntimeWarning, match="rest on only 2 records that overturn"):
        curve = rj.fragility(stripe_analysis([0.8, 1.2, 9.0], [0.5, 1.0, 2.0]))
    low, high = curve["interval"].sel(quantity="median_capacity").values
    assert high / low > 10
    assert curve["interval"].attrs["overturning_records"] == 2
    with pytest.warns(RuntimeWarning, match="rest on only 4 records"):
        rj.fragility(stripe_analysis([0.4, 0.8, 1.2, 1.6], np.linspace(0.1, 2, 20)), method="stripes")


def test_an_interval_that_is_none_is_refused():
    """Two records at three levels: one record alone does not determine a dispersion, so the jackknife
    fails."""
    few = stripe_analysis([0.4, 0.8, 0.9, 1.1, 1.2, 1.3], [0.5, 1.0])
    with pytest.raises(
        ValueError, match=r"6 fits that each omit one record, but \d of these fits .* confidence=None"
    ):
        rj.fragility(few, method="stripes")
    assert "interval" not in rj.fragility(few, method="stripes", confidence=None)


@pytest.mark.slow
def test_the_distribution_is_differentiable():
    """Sampled pulses have smooth first boundaries close to those of the pulses."""
    periods = np.array([0.8, 1.0, 1.3])
    t = np.arange(-100, 101) * 0.02
    few = rj.Records.of([rj.Record(rj.Ricker(1.0, T)(t), 0.02) for T in periods])
    unit = np.array([1.0, 1.0, 2.0])

    def log_median(log_alpha):
        podium = BLOCK.replace(alpha=BLOCK.alpha * jnp.exp(log_alpha))
        return jnp.log(
            rj.overturning_distribution(podium, few, max_scale=15.0, measure=unit, resolution=64).median
        )

    both = jax.jit(lambda log_alpha: jax.jvp(log_median, (log_alpha,), (1.0,)))
    exact = jax.jit(jax.vmap(lambda T: rj.overturning_acceleration(BLOCK, rj.Ricker, T)))(periods)
    h = 1e-4
    (low, _), (value, slope), (high, _) = (both(step) for step in (-h, 0.0, h))
    assert float(value) == pytest.approx(np.log(exact * unit).mean(), abs=2e-3)
    assert float(slope) == pytest.approx(float(high - low) / (2 * h), rel=1e-5)


@pytest.mark.parametrize(
    ("measure", "words"),
    [
        (2.0, r"one value for each of the 3 records, got shape \(\)"),
        ([1.0, 2.0], r"one value for each of the 3 records, got shape \(2,\)"),
        ([1.0, -2.0, 1.0], "values must be finite and > 0 for every record"),
        ([1.0, np.nan, 1.0], "values must be finite and > 0 for every record"),
    ],
)
def test_measures_of_distributions_that_make_no_sense(measure, words):
    with pytest.raises(ValueError, match=words):
        rj.overturning_distribution(BLOCK, TABLE, measure=measure)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"intensity": [2.0, 1.0]}, "ascending"),
        ({"intensity": [-1.0, 1.0]}, "> 0"),
        ({"measure": "PGV"}, "must be 'PGA', 'scale' or a rockjax.Measure"),
        ({"measure": rj.Measure("Sa", np.ones(2), "m s-2")}, "one value for each of the 3 records"),
        ({"measure": rj.Measure("Sa", [1.0, 0.0, 1.0], "m s-2")}, "> 0 for every record"),
        ({"names": ["a", "a", "b"]}, "3 different strings"),
        ({"sensitivities": ["eta"]}, "sensitivities must each be one of"),
        ({"resolution": 3}, "resolution"),
        ({"podium": rj.Podium(np.array([0.1, 0.2]), 1.0)}, "scalar parameters"),
    ],
)
def test_analyses_that_make_no_sense(change, words):
    arguments = {"podium": BLOCK, "records": TABLE, "intensity": [1.0, 2.0]} | change
    with pytest.raises(ValueError, match=words):
        rj.incremental_dynamic_analysis(**arguments)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"method": "probit"}, "'capacities' or 'stripes'"),
        ({"confidence": 90}, "confidence"),
        ({"confidence": "90 %"}, "confidence"),
        ({"analysis": BLOCK}, "must come from rockjax.incremental_dynamic_analysis, got a Podium"),
        ({"at": [0.0, 1.0]}, "at must be"),
        ({"limit": ("peak_rotation", np.nan)}, "limit peak_rotation must be a finite number"),
        ({"limit": ("peak_rotation", [0.5] * 12)}, "limit peak_rotation must be a finite number"),
    ],
)
def test_curves_that_make_no_sense(analysis, change, words):
    with pytest.raises(ValueError, match=words):
        rj.fragility(**{"analysis": analysis[1]} | change)
