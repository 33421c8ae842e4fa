"""Ensembles: draws, empirical distributions compared with closed forms and scipy, invalid inputs."""

import numpy as np
import pytest
import xarray
from scipy import stats

import rockjax as rj
from rockjax._studies import empirical
from rockjax._studies.distributions import generator
from tests.scenes import PODIUMS, G, pulse, shaking

RIGID = PODIUMS["rigid"]
UPLIFT = float(RIGID.uplift_ground_acceleration)
N = 400


def at_rest(seed=1, n=N, low=0.1, high=0.9):
    """Return an ensemble under pulses that never lift the columns; the shear is a_p/g, whose distribution is
    known."""
    spread = {"a_p": stats.uniform(low * UPLIFT, (high - low) * UPLIFT)}
    return rj.ensemble(RIGID, rj.Ricker(1.0, 0.5), spread=spread, n=n, seed=seed)


def overturning(seed=1, n=N, **more):
    """Return an ensemble with amplitudes around the overturning boundary of a block."""
    given = {"spread": {"acceleration_ratio": stats.uniform(1.0, 2.0)}, "n": n, "seed": seed}
    return rj.ensemble(PODIUMS["block"], rj.OneSine(1.0, 0.8), **given | more)


@pytest.fixture(scope="module")
def still():
    return at_rest()


@pytest.fixture(scope="module")
def toppled():
    return overturning()


def test_a_linear_map_of_a_parameter_has_the_known_distribution(still):
    np.testing.assert_allclose(still.peaks.peak_shear, still.draws["a_p"] / G, rtol=1e-9)
    true = stats.uniform(0.1 * UPLIFT / G, 0.8 * UPLIFT / G)
    cdf = still.cdf("peak_shear", confidence=0.999)
    assert np.all((cdf["lower"] <= true.cdf(cdf["at"])) & (true.cdf(cdf["at"]) <= cdf["upper"]))
    np.testing.assert_allclose(cdf["probability"], np.arange(1, N + 1) / N)
    quantiles = still.quantiles("peak_shear", [0.1, 0.5, 0.9], confidence=0.999)
    assert np.all(quantiles["lower"] <= true.ppf(quantiles["probability"]))
    assert np.all(true.ppf(quantiles["probability"]) <= quantiles["upper"])


def test_the_share_that_lifts_is_that_above_the_threshold():
    """A rigid podium lifts if and only if a_p exceeds g tan α, so P = F(a_p/g) for random tan α."""
    law = stats.lognorm(0.2, scale=0.15)
    found = rj.ensemble(RIGID, rj.Ricker(0.15 * G, 1.0), spread={"tan_alpha": law}, n=N, seed=3)
    np.testing.assert_array_equal(found.peaks.uplifted, found.draws["tan_alpha"] < 0.15)
    cdf = found.cdf("uplift_time", at=[1e9], confidence=0.999)
    assert cdf["lower"] <= law.cdf(0.15) <= cdf["upper"]


def test_half_width_of_the_band(still):
    assert empirical.band_half_width(10_000, 0.95) == pytest.approx(0.0136, abs=5e-5)
    assert still.cdf("peak_shear").attrs["half_width"] == pytest.approx(np.sqrt(np.log(40) / (2 * N)))


def test_bands_have_the_stated_coverage():
    rng = np.random.default_rng(0)
    missed = 0
    for _ in range(400):
        values = rng.uniform(size=50)
        sample = empirical.Sample(values, np.zeros(50, bool))
        x = np.r_[values, values * (1 - 1e-9)]  # the distance is largest at the values, or just before them
        found = empirical.distribution(sample, x, 0.8)
        missed += bool(np.any(found.lower > x) | np.any(found.upper < x))
    assert 0.1 < missed / 400 <= 0.2 + 3 * np.sqrt(0.2 * 0.8 / 400)


def test_quantiles_and_their_intervals_are_those_of_scipy():
    values = np.random.default_rng(1).normal(size=300)
    sample = empirical.Sample(values, np.zeros(300, bool))
    q = np.array([0.02, 0.3, 0.5, 0.9])
    found = empirical.quantiles(sample, q, 0.9)
    np.testing.assert_array_equal(found.value, np.quantile(values, q, method="inverted_cdf"))
    for k, p in enumerate(q):
        low, high = stats.quantile_test(values, p=p).confidence_interval(0.9)
        assert found.lower[k] in (low, np.sort(values)[np.searchsorted(np.sort(values), low) + 1])
        assert found.upper[k] == pytest.approx(high)
    few = empirical.quantiles(empirical.Sample(values[:5], np.zeros(5, bool)), np.array([0.01, 0.99]), 0.95)
    assert few.lower[0] == -np.inf
    assert few.upper[1] == np.inf


def test_quantile_intervals_cover_their_quantile():
    rng = np.random.default_rng(2)
    values = np.sort(rng.uniform(size=(2000, 60)), axis=1)
    q = np.array([0.1, 0.5, 0.84])
    covered = np.zeros(3)
    for row in values:
        found = empirical.quantiles(empirical.Sample(row, np.zeros(60, bool)), q, 0.9)
        covered += (found.lower <= q) & (q <= found.upper)
    assert np.all(covered / 2000 >= 0.9 - 3 * np.sqrt(0.09 / 2000))
    assert np.all(covered / 2000 <= 0.97)


def test_overturned_scenes_are_beyond_every_rotation(toppled):
    fell = toppled.overturned
    assert 0.1 < fell.mean() < 0.9
    assert np.all(np.isinf(toppled.sample().values[fell]))
    assert np.all(toppled.sample().values[~fell] < 1.0)
    assert float(toppled.cdf(at=[1.0])["probability"][0]) == pytest.approx(1 - fell.mean())
    assert toppled.cdf(at=[0.5, 1e9])["probability"][1] < 1.0
    assert np.isinf(toppled.quantiles(probability=1 - 0.5 * fell.mean())["quantile"][0])
    share, low, high = toppled.overturning_probability(0.9)
    expected = stats.binomtest(int(fell.sum()), N).proportion_ci(0.9)
    assert (share, low, high) == pytest.approx((fell.mean(), expected.low, expected.high))


def test_margins_continue_beyond_overturning_and_least_answers_fall_to_minus_infinity():
    found = overturning(options=rj.Options(outputs=("peak_rotation", "margin")), n=50)
    np.testing.assert_array_equal(found.sample("margin").values, found.peaks.margin)
    assert found.sample("margin").values.min() < 0
    data = found.data.assign(
        least_axial_force=found.data["peak_rotation"].assign_attrs(ancillary_variables="overturned")
    )
    assert np.all(np.isneginf(rj.Ensemble(data).sample("least_axial_force").values[found.overturned]))


def test_unknown_scenes_are_counted_and_widen_every_bound(toppled):
    data = toppled.data.copy(deep=True)
    data["result"].values[:8] = 3
    data["peak_rotation"].values[:8] = np.nan
    data["overturned"].values[:8] = False
    data["undecided"] = "scene", np.arange(N) < 20  # the first eight are unanswered as well
    found = rj.Ensemble(data)
    assert found.counts | {"overturned": 0} == {
        "scenes": N,
        "overturned": 0,
        "undecided": 12,
        "unanswered": 8,
    }
    half_width = empirical.band_half_width(N, 0.95)
    reference = toppled.sample().values[20:]
    for x in (0.1, 0.5):
        cdf = found.cdf(at=[x])
        at_most = np.sum(reference <= x)
        assert float(cdf["lower"][0]) == pytest.approx(max(at_most / N - half_width, 0))
        assert float(cdf["upper"][0]) == pytest.approx((at_most + 20) / N + half_width)
    assert found.overturning_probability()[1] < toppled.overturning_probability()[1]
    wide, narrow = found.quantiles(probability=0.2), toppled.quantiles(probability=0.2)
    assert wide["lower"][0] < narrow["lower"][0]
    assert wide["upper"][0] > narrow["upper"][0]
    assert "8 did not finish, 12 undecided" in repr(found)
    assert "0 did not finish, undecided not checked ('errors')" in repr(toppled)


@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 2), (3, 7), (40, 60)])
def test_samples_that_do_not_overlap_have_their_exact_probability(n, m):
    low, high = np.arange(n) - 100.0, np.arange(m) + 0.0
    first, second = (empirical.Sample(values, values > np.inf) for values in (low, high))
    exact = stats.ks_2samp(low, high, method="exact").pvalue
    assert empirical.compare(first, second, 0.95).p_value == pytest.approx(exact, rel=1e-9)


def test_the_comparison_is_that_of_scipy(toppled):
    other = overturning(seed=2)
    found = toppled.compare(other)
    expected = stats.ks_2samp(toppled.sample().values, other.sample().values, method="asymp")
    assert found.statistic == pytest.approx(expected.statistic)
    assert found.p_value == pytest.approx(expected.pvalue)
    assert found.p_value > 0.01
    assert found.lower == 0.0
    stronger = overturning(seed=3, spread={"acceleration_ratio": stats.uniform(1.6, 2.0)})
    found = toppled.compare(stronger)
    assert found.p_value < 1e-6
    # Overturned scenes are ties at infinity, so only finite values determine the distance.
    assert found.at < 1.0
    assert 0 < found.lower < found.statistic < found.upper <= 1


def test_unknown_values_lower_the_distance_that_is_certain():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=200), rng.normal(1.5, size=300)
    is_open = np.arange(200) < 10
    reference = empirical.Sample(first, np.zeros(200, bool)), empirical.Sample(second, np.zeros(300, bool))
    certain = empirical.compare(*reference, 0.95)
    open_ones = empirical.compare(empirical.Sample(first, is_open), reference[1], 0.95)
    assert open_ones.statistic == certain.statistic
    assert open_ones.p_value > certain.p_value
    assert open_ones.lower < certain.lower
    assert open_ones.upper > certain.upper
    placed = []
    for _ in range(200):  # for all unknown values the distance is between the bounds
        values = np.where(is_open, rng.normal(scale=3, size=200), first)
        placed.append(stats.ks_2samp(values, second).statistic)
    widths = sum(empirical.band_half_width(size, 0.975) for size in (200, 300))
    assert open_ones.lower + widths <= min(placed) + 1e-12
    assert max(placed) <= open_ones.upper - widths + 1e-12


def test_equal_seeds_give_equal_draws_of_each_parameter(still):
    again = at_rest(n=N)
    np.testing.assert_array_equal(again.draws["a_p"], still.draws["a_p"])
    np.testing.assert_array_equal(again.peaks.peak_shear, still.peaks.peak_shear)
    assert np.all(at_rest(seed=2).draws["a_p"] != still.draws["a_p"])
    law = stats.norm(0.3, 0.01)
    both = rj.ensemble(
        PODIUMS["block"], rj.Rest(), spread={"R": stats.norm(2.0, 0.1), "alpha": law}, n=5, seed=4
    )
    np.testing.assert_array_equal(both.draws["alpha"], law.rvs(5, random_state=generator(4, "alpha")))
    with pytest.raises(ValueError, match="both ensembles have the seed 1"):
        still.compare(again)


def test_no_spread_gives_equal_scenes():
    found = rj.ensemble(
        PODIUMS["block"], pulse(ratio=4.0), spread={"alpha": 0.3, "R": stats.norm(2.0, 0.0)}, n=7
    )
    single = rj.peak_response(PODIUMS["block"], pulse(ratio=4.0))
    assert np.ptp(found.sample().values) == 0.0
    np.testing.assert_allclose(found.sample().values, float(single.peak_rotation), rtol=1e-9)
    assert float(found.quantiles(probability=0.5)["quantile"][0]) == found.sample().values[0]


def test_every_scene_draws_one_motion():
    motions = rj.synthetic_motions(3, seed=3, duration=4.0, dt=0.04, pga=3.0)
    block = rj.Podium(alpha=0.2, R=1.0)
    found = rj.ensemble(block, motions, spread={"scale": stats.uniform(0.8, 0.4)}, n=30, seed=5)
    assert set(found.data["motion"].values) == set(motions.names)
    k = 11
    motion = motions[motions.names.index(found.data["motion"].values[k])].scaled(found.draws["scale"][k])
    peak = rj.peak_response(block, motion.record())
    assert float(found.peaks.peak_rotation[k]) == pytest.approx(float(peak.peak_rotation), rel=1e-6)
    podium, motion, initial = found.scene(k)
    again = rj.peak_response(podium, motion, initial=initial)
    assert float(found.peaks.peak_rotation[k]) == pytest.approx(float(again.peak_rotation), rel=1e-9)
    np.testing.assert_array_equal(found.scene(0)[1](1.0), found.scene(np.int64(0))[1](1.0))
    pulses = [rj.Ricker(2.0, 1.0), rj.Ricker(4.0, 1.0)]
    found = rj.ensemble(RIGID, pulses, spread={}, n=20)
    heights = {"Ricker(2, 1)": 0, "Ricker(4, 1)": 0}
    for label, shear in zip(found.data["motion"].values, found.peaks.peak_rotation, strict=True):
        heights[label] = max(heights[label], shear)
    assert len(set(found.peaks.peak_rotation.tolist())) == 2
    assert heights["Ricker(4, 1)"] > heights["Ricker(2, 1)"]


def test_the_initial_state_is_an_imperfection():
    """Columns released from θ₀ rock back, so the peak is |θ₀|/α."""
    spread = {"initial.theta": stats.norm(0.0, 0.05)}
    found = rj.ensemble(PODIUMS["block"], rj.Rest(), spread=spread, n=20, seed=1)
    np.testing.assert_allclose(
        found.peaks.peak_rotation, np.abs(found.draws["initial.theta"]) / 0.3, rtol=1e-9
    )
    with pytest.raises(ValueError, match=r"initial.theta\|/α must be < 1 in every scene, got"):
        rj.ensemble(PODIUMS["block"], rj.Rest(), spread={"initial.theta": stats.norm(0.0, 0.3)}, n=100)
    modes = rj.Podium(alpha=0.2, R=1.0, gamma=5.0, superstructure=rj.Modes([3.0, 1.0], [0.4, 0.1], 0.05))
    assert found.scene(3)[2].theta == found.draws["initial.theta"][3]
    found = rj.ensemble(modes, rj.Rest(), spread={"initial.u_t": stats.uniform(0.001, 0.001)}, n=3, t_end=0.5)
    # All floors have the same initial displacement, and the columns do not rock.
    np.testing.assert_allclose(
        found.peaks.peak_deformation, np.repeat(found.draws["initial.u_t"][:, None], 2, 1), rtol=1e-6
    )
    worst, second = found.sample("peak_deformation"), found.sample("peak_deformation", component=2)
    assert np.all(worst.values >= second.values)
    with pytest.raises(ValueError, match="component must be at most 2 for peak_deformation"):
        found.sample("peak_deformation", component=3)


def test_ensembles_are_read_again(toppled, tmp_path):
    path = tmp_path / "a.nc"
    toppled.dataset().to_netcdf(path, engine="netcdf4")
    again = rj.Ensemble(xarray.load_dataset(path))
    xarray.testing.assert_identical(again.cdf(), toppled.cdf())
    np.testing.assert_array_equal(again.draws["acceleration_ratio"], toppled.draws["acceleration_ratio"])
    assert repr(again) == repr(toppled)
    assert "<table>" in again._repr_html_()
    lines = repr(toppled).splitlines()
    assert lines[0].startswith(f"Ensemble of {N} scenes: ")
    assert lines[1].split() == ["drawn", "mean", "std", "least", "largest"]
    assert lines[-3].split()[0] == "peak_rotation"


def test_an_interruption_leaves_the_answers_so_far():
    class Stop:
        def update(self, count):
            raise KeyboardInterrupt

    with pytest.raises(rj.Interrupted) as error:
        overturning(n=4000, progress=Stop())
    partial = error.value.partial
    assert isinstance(partial, rj.Ensemble)
    assert partial.size == 4000
    assert 0 < partial.unanswered.sum() < 4000
    assert partial.cdf(at=[0.5])["upper"] - partial.cdf(at=[0.5])["lower"] > partial.unanswered.mean()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"spread": {"alhpa": 0.2}}, "got 'alhpa'; did you mean 'alpha'"),
        ({"spread": {"initial.thta": 0.0}}, "did you mean 'initial.theta'"),
        ({"spread": {"alpha": 0.2, "tan_alpha": 0.2}}, "describe the same quantity"),
        ({"spread": {"restitution": 1.9}}, r"spread\['restitution'\] must be in \[0, 1\]"),
        ({"spread": {"initial.u_t": 0.1}}, "got 'initial.u_t'"),
        ({"spread": {}}, "nothing is random"),
        (
            {"spread": {"alpha": stats.norm(0.15, 0.1)}},
            r"spread\['alpha'\] must be in \(0, π/2\) rad, but \d+ of 400",
        ),
        (
            {"spread": {"R": stats.norm(1.0, 1.0)}},
            r"spread\['R'\] must be finite and > 0, but \d+ of 400 draws",
        ),
        ({"spread": {"T_p": stats.norm(0.1, 1.0)}}, r"spread\['T_p'\] must be finite and > 0"),
        (
            {"spread": {"a_p": stats.cauchy(0.1, 1.0).ppf(np.ones(N))}},
            r"spread\['a_p'\] must be finite, but 400",
        ),
        ({"spread": {"R": "wide"}}, r"spread\['R'\] must be a frozen distribution"),
        ({"spread": {"R": stats.norm}}, r"spread\['R'\] must be a frozen distribution"),
        ({"spread": {"R": [1.0, 2.0]}}, r"or 400 draws, got an array of shape \(2,\)"),
        ({"spread": [("R", 1.0)]}, "spread must be a dict"),
        ({"n": 0}, "n must be a whole number >= 1"),
        ({"seed": -1}, "seed must be a whole number >= 0"),
        ({"podium": RIGID.replace(R=np.array([1.0, 2.0]))}, "scalar parameters"),
        ({"motions": "file.AT2"}, "motions must be a rockjax motion"),
    ],
)
def test_invalid_arguments_are_rejected_before_solving(change, words, monkeypatch):
    monkeypatch.setattr("rockjax._studies.ensemble.peak_responses", None)
    given = {"podium": RIGID, "motions": rj.Ricker(1.0, 1.0), "spread": {"R": 1.0}, "n": N} | change
    with pytest.raises(ValueError, match=words):
        rj.ensemble(given.pop("podium"), given.pop("motions"), **given)


def test_wrong_arguments_of_results_are_refused(toppled):
    for call, words in (
        (lambda: toppled.cdf("peak_rotatoin"), "did you mean 'peak_rotation'"),
        (lambda: toppled.cdf("overturned"), "output must be one of"),
        (lambda: toppled.cdf(confidence=95), r"confidence must be in \(0, 1\)"),
        (lambda: toppled.cdf(at=[[1.0]]), "at must be one-dimensional"),
        (lambda: toppled.cdf(at=[1.0, np.nan]), "at must not contain NaN"),
        (lambda: toppled.quantiles(probability=[0.5, 1.0]), r"probability must be in \(0, 1\)"),
        (lambda: toppled.quantiles(probability=[[0.5]]), "probability must be one-dimensional"),
        (lambda: toppled.cdf(component=1), "has no components"),
        (lambda: toppled.compare(3.0), "other must be a rockjax.Ensemble"),
        (lambda: toppled.scene(N), f"k must be less than {N}"),
        (lambda: rj.Ensemble(toppled.data).scene(0), "an ensemble from a file"),
        (lambda: rj.Ensemble(xarray.Dataset()), "must be a dataset of rockjax.ensemble"),
    ):
        with pytest.raises(ValueError, match=words):
            call()


def test_pictures_of_distributions(toppled):
    ax = rj.plots.ensemble({"A": toppled, "B": overturning(seed=2).dataset()})
    assert ax.get_xlim() == (0.0, 1.0)
    entries = [text.get_text() for text in ax.get_legend().get_texts()]
    assert entries[0] == f"A: {N} scenes, {100 * toppled.overturned.mean():.3g}% overturned, 95% band"
    x, y = ax.lines[0].get_data()
    assert np.all(np.diff(y) >= 0)
    assert y[-1] == pytest.approx(1 - toppled.overturned.mean())
    assert (x[0], x[-1]) == (0.0, 1.0)
    ax = rj.plots.ensemble(toppled.data, output="peak_shear", ax=ax)
    assert ax.get_xlabel() == "peak shear of the superstructure divided by its weight max|V_s|/(m_t g) [–]"
    with pytest.raises(ValueError, match=r"ensembles must be a rockjax\.Ensemble or a dict"):
        rj.plots.ensemble(3.0)


def test_pictures_of_quantiles(still, toppled):
    other = at_rest(seed=2, low=0.2, high=1.0)
    ax = rj.plots.quantile_quantile({"weak": still, "strong": other}, output="peak_shear")
    diagonal, curve = ax.lines[:2]
    assert np.array_equal(*diagonal.get_data())
    np.testing.assert_allclose(curve.get_data()[0], np.sort(still.sample("peak_shear").values))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("weak", "strong")
    assert [text.get_text() for text in ax.texts] == ["5%", "16%", "50%", "84%", "95%"]
    ax = rj.plots.quantile_quantile({"a": toppled, "b": toppled})
    standing = 1 - toppled.overturned.mean()
    assert ax.get_legend().get_texts()[1].get_text() == f"quantiles up to {standing:.0%}"
    assert "84%" not in [text.get_text() for text in ax.texts]
    with pytest.raises(ValueError, match="dict label → ensemble with two entries"):
        rj.plots.quantile_quantile({"a": toppled})


@pytest.mark.slow
def test_elastic_podiums_under_records_with_errors():
    motion = shaking()
    found = rj.ensemble(
        PODIUMS["elastic"],
        motion,
        spread={"T_s": stats.lognorm(0.1, scale=0.5), "scale": stats.lognorm(0.3)},
        n=200,
        options=rj.Options(outputs=("peak_rotation", "errors")),
    )
    assert found.undecided.sum() == np.sum(found.peaks.errors.undecided & ~found.unanswered)
    assert "undecided" in repr(found)
