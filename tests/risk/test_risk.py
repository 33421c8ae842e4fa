"""Hazard, annual frequency and Gaussian ground motions, compared with quadrature, closed forms and published
values."""

import dataclasses
import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from scipy import signal
from scipy.integrate import quad
from scipy.stats import chi2, norm

import rockjax as rj
from rockjax._risk import search
from rockjax._risk.limit_state import FunctionLimitState
from rockjax._risk.reliability import estimate_probability, first_order_probability, starting_directions
from rockjax._risk.structure import OPTIONS, StructureLimitState, _by_location, parse_limit

POINTS = np.array([0.1, 0.7, 2.0, 5.0])
RATES = np.array([1e-1, 2e-2, 1e-3, 1e-4])
HAZARD = rj.Hazard(POINTS, RATES)


def by_quadrature(share, breaks=()):
    """Return ∫ F |dλ| by quadrature over ln x in each segment."""
    s, log_rate = np.log(POINTS), np.log(RATES)
    k = -np.diff(log_rate) / np.diff(s)

    def density(y):
        i = np.clip(np.searchsorted(s, y) - 1, 0, k.size - 1)
        return k[i] * np.exp(log_rate[i] - k[i] * (y - s[i]))

    ends = np.unique(np.r_[-45.0, s, np.log(np.asarray(breaks, float)), s[-1] + 40])
    pieces = [
        quad(lambda y: share(np.exp(y)) * density(y), a, b, epsabs=0, epsrel=1e-12, limit=500)[0]
        for a, b in itertools.pairwise(ends)
    ]
    return sum(pieces)


def lognormal(median, dispersion):
    return lambda x: norm.cdf(np.log(x / median) / dispersion)


def fragility(measure="PGA", units="m s-2"):
    of = {"units": units}
    return xarray.Dataset(
        {
            "median_capacity": ((), 1.5, of),
            "dispersion": ((), 0.4, {"units": "1"}),
            "median_sensitivity": ("parameter", [2.0, -0.5]),
        },
        coords={"parameter": ["alpha", "gamma"], "at": ("at", np.linspace(0.1, 5, 20), of)},
        attrs={"kind": "fragility", "measure": measure},
    )


def analysis(share, levels):
    """Return an analysis of ten records, of which the fractions `share` overturn at the levels."""
    overturned = np.arange(10)[:, None] < np.round(10 * np.asarray(share))[None]
    return xarray.Dataset(
        {"overturned": (("record", "intensity"), overturned)},
        coords={"intensity": ("intensity", np.asarray(levels, float), {"units": "m s-2"})},
        attrs={"kind": "incremental-dynamic-analysis", "measure": "PGA"},
    )


# The hazard curve.


def test_a_hazard_is_linear_in_its_logarithms_and_goes_on_outside():
    np.testing.assert_allclose(HAZARD(jnp.asarray(POINTS)), RATES, rtol=1e-14)
    middle = np.sqrt(POINTS[1:] * POINTS[:-1])
    np.testing.assert_allclose(HAZARD(jnp.asarray(middle)), np.sqrt(RATES[1:] * RATES[:-1]), rtol=1e-14)
    power = rj.Hazard([1.0, 2.0], [1e-4, 1e-4 * 2**-2.5])
    np.testing.assert_allclose(
        power(jnp.asarray([0.01, 300.0])), 1e-4 * np.array([0.01, 300.0]) ** -2.5, rtol=1e-13
    )
    np.testing.assert_allclose(
        HAZARD.intensity_at(HAZARD(jnp.asarray([0.05, 1.1, 9.0]))), [0.05, 1.1, 9.0], rtol=1e-13
    )


@pytest.mark.parametrize(
    ("points", "rates", "expected"),
    [
        ([1.0, 1.0], [1e-2, 1e-3], "intensity must ascend, got 1 before 1"),
        ([1.0, 2.0], [1e-3, 1e-2], "must not increase with the intensity, got 0.001 before 0.01"),
        ([0.0, 2.0], [1e-2, 1e-3], "intensity must be finite and > 0, got intensity = 0.0"),
        ([1.0, 2.0], [1e-2, 0.0], "annual_rate must be finite and > 0"),
        ([1.0], [1e-2], "equal length ≥ 2"),
        ([1.0, 2.0], [1e-2, 1e-3, 1e-4], "equal length ≥ 2"),
        ([1.0, np.nan], [1e-2, 1e-3], "intensity must be finite"),
    ],
)
def test_hazards_that_make_no_sense_are_refused(points, rates, expected):
    with pytest.raises(ValueError, match=expected):
        rj.Hazard(points, rates)


# The annual frequency.


def test_the_published_number():
    x = np.geomspace(0.1, 10, 4)
    found = rj.annual_frequency(rj.Lognormal(3.5, 0.4), rj.Hazard(x, 1e-4 * x**-2.5))
    assert float(found.frequency) == pytest.approx(7.194110928567293e-6, rel=1e-13)
    assert float(found.return_period) == pytest.approx(1 / 7.194110928567293e-6, rel=1e-13)
    assert float(found.probability(50.0)) == pytest.approx(-np.expm1(-50 * 7.194110928567293e-6), rel=1e-13)
    # λ_f = k₀ m^(−k) e^(k²β²/2): d ln λ_f/d ln m = −k, d ln λ_f/dβ = k²β
    assert float(found.sensitivities["median"]) == pytest.approx(-2.5, rel=1e-12)
    assert float(found.sensitivities["dispersion"]) == pytest.approx(2.5, rel=1e-12)


@pytest.mark.parametrize(
    ("median", "dispersion"), [(1.5, 0.4), (30.0, 0.2), (0.03, 0.5), (1.5, 1e-3), (2.0, 2.5)]
)
def test_the_closed_form_is_the_integral(median, dispersion):
    found = rj.annual_frequency(rj.Lognormal(median, dispersion), HAZARD)
    breaks = median * np.exp(dispersion * np.array([-8, -3, 0, 3, 8]))
    expected = by_quadrature(lognormal(median, dispersion), breaks)
    assert float(found.frequency) == pytest.approx(expected, rel=1e-10)


def test_a_flat_segment_contributes_nothing():
    flat = rj.Hazard([0.1, 1.0, 2.0, 5.0], [1e-2, 1e-3, 1e-3, 1e-4])
    steep = rj.annual_frequency(rj.Lognormal(1.4, 0.01), flat)
    assert float(steep.frequency) == pytest.approx(1e-3, rel=1e-9)
    ends = rj.Hazard([0.1, 1.0, 2.0], [1e-2, 1e-3, 1e-3])
    # A rate that stays constant at large intensities is the limit of a rate that decreases slowly: each
    # event at the last point has an unlimited intensity.
    steep = rj.annual_frequency(rj.Lognormal(1.4, 0.01), ends)
    assert float(steep.frequency) == pytest.approx(1e-3, rel=1e-9)
    limit = rj.Hazard([0.1, 1.0, 2.0], [1e-2, 1e-3, 1e-3 * (1 - 1e-9)])
    flat, slow = (rj.annual_frequency(rj.Lognormal(3.0, 0.4), hazard) for hazard in (ends, limit))
    assert float(flat.frequency) == pytest.approx(float(slow.frequency), rel=1e-7)


def test_derivatives_agree_with_finite_differences():
    def log_frequency(log_median, dispersion):
        return jnp.log(rj.annual_frequency(rj.Lognormal(jnp.exp(log_median), dispersion), HAZARD).frequency)

    at, h = (np.log(1.5), 0.4), 1e-4
    found = rj.annual_frequency(rj.Lognormal(1.5, 0.4), HAZARD).sensitivities
    for k, name in enumerate(("median", "dispersion")):
        moved = [np.array(at) + s * h * np.eye(2)[k] for s in (-2, -1, 1, 2)]
        a, b, c, d = (float(log_frequency(*y)) for y in moved)
        difference = (a - 8 * b + 8 * c - d) / (12 * h)
        assert float(found[name]) == pytest.approx(difference, rel=1e-8)
        assert float(jax.grad(log_frequency, k)(*at)) == pytest.approx(float(found[name]), rel=1e-12)
        assert float(jax.jacfwd(log_frequency, k)(*at)) == pytest.approx(float(found[name]), rel=1e-12)


def test_numbers_of_the_structure_act_through_the_median():
    found = rj.annual_frequency(fragility(), HAZARD)
    slope = float(found.sensitivities["median"])
    assert found.sensitivities["alpha"] == pytest.approx(2 * slope)
    assert found.sensitivities["gamma"] == pytest.approx(-0.5 * slope)
    assert float(found.frequency) == pytest.approx(
        float(rj.annual_frequency(rj.Lognormal(1.5, 0.4), HAZARD).frequency)
    )


def test_extrapolation_is_reported():
    found = rj.annual_frequency(rj.Lognormal(30.0, 0.2), HAZARD)
    assert float(found.extrapolated) == pytest.approx(1.0)
    assert "100% of it extrapolated" in repr(found)
    inside = rj.annual_frequency(rj.Lognormal(1.5, 0.2), HAZARD)
    assert float(inside.extrapolated) < 0.05
    assert "beyond" not in repr(inside)


def test_counted_shares_are_integrated_as_they_are():
    # With a window of survival the fraction decreases again.
    levels, share = [0.3, 1.0, 2.0, 3.0, 8.0], [0, 0.2, 0.7, 0.4, 0.9]
    found = rj.annual_frequency(analysis(share, levels), HAZARD)
    expected = by_quadrature(lambda x: np.interp(x, levels, share), levels)
    assert float(found.frequency) == pytest.approx(expected, rel=1e-10)
    above = 0.9 * float(HAZARD(jnp.asarray(8.0)))  # beyond the levels …
    # … or the points.
    between = by_quadrature(lambda x: np.interp(x, levels, share) * ((x > 5.0) & (x < 8.0)), levels)
    assert float(found.extrapolated) == pytest.approx((above + between) / expected, rel=1e-8)
    with pytest.raises(ValueError, match="20% of the records overturn at the lowest level, 1"):
        rj.annual_frequency(analysis(share[1:], levels[1:]), HAZARD)
    # Scenes that did not finish do not count.
    doubled = xarray.concat([analysis(share, levels)] * 2, "record")
    doubled["overturned"][:10] = False
    doubled["result"] = doubled["overturned"].dims, np.repeat([[3] * 5, [0] * 5], 10, axis=0)
    again = rj.annual_frequency(doubled, HAZARD).frequency
    assert float(again) == pytest.approx(float(found.frequency), rel=1e-12)
    doubled["result"][:, 2] = 3
    with pytest.raises(ValueError, match="no scene finished at the level 2; raise max_steps"):
        rj.annual_frequency(doubled, HAZARD)


@pytest.mark.parametrize("levels", [[0.01, 0.02, 0.03], [0.01, 0.03, 0.4], [6.0, 8.0, 9.0]])
def test_levels_beside_the_hazard_count_once(levels):
    share = [0, 0.5, 1]
    found = rj.annual_frequency(analysis(share, levels), HAZARD)
    expected = by_quadrature(lambda x: np.interp(x, levels, share), levels)
    assert float(found.frequency) == pytest.approx(expected, rel=1e-10)
    assert 0 < float(found.extrapolated) <= 1 + 1e-12


def test_measures_and_units_must_match():
    with pytest.raises(ValueError, match=r"same intensity measure, got Sa.* and PGA"):
        rj.annual_frequency(fragility("Sa(1 s)"), HAZARD)
    in_g = rj.Hazard(POINTS / 9.80665, RATES, units="g")
    with pytest.raises(
        ValueError, match=r"same units, got 'm s-2' and 'g'; convert the hazard with hazard.in_si"
    ):
        rj.annual_frequency(fragility(), in_g)
    converted = rj.annual_frequency(fragility(), in_g.in_si()).frequency
    assert float(converted) == pytest.approx(
        float(rj.annual_frequency(fragility(), HAZARD).frequency), rel=1e-12
    )
    for curve, expected in (
        (rj.Lognormal(-1.0, 0.4), "median must be finite and > 0"),
        (rj.Lognormal(1.0, 0.0), "dispersion must be finite and > 0"),
        (rj.Lognormal(jnp.ones(4), 0.4), r"must be scalars, got shapes \(4,\) and \(\)"),
        (np.ones(3), "curve must be a rockjax.Lognormal"),
    ):
        with pytest.raises(ValueError, match=expected):
            rj.annual_frequency(curve, HAZARD)


def test_the_disaggregation_is_a_density():
    found = rj.disaggregation(rj.Lognormal(1.5, 0.4), HAZARD, at=np.geomspace(0.01, 60, 4001))
    assert np.trapezoid(found["density"], np.log(found["intensity"])) == pytest.approx(1, abs=1e-3)
    for at, words in ((2.0, "1-D array with values"), ([[1.0]], "1-D array"), ([], "1-D"), ([0.0], "> 0")):
        with pytest.raises(ValueError, match=f"disaggregation: at must be .*{words}"):
            rj.disaggregation(rj.Lognormal(1.5, 0.4), HAZARD, at=at)


# Files.


def test_hazards_in_two_columns(tmp_path):
    path = tmp_path / "site.csv"
    path.write_text("PGA [g],annual_rate\n0.1,1e-2\n0.5,1e-3\n")
    found = rj.Hazard.from_file(path)
    np.testing.assert_allclose(found.intensity, np.array([0.1, 0.5]) * 9.80665)
    assert (found.measure, found.units) == ("PGA", "m s-2")
    path.write_text("0.1,1e-2\n0.5,1e-3\n")
    with pytest.raises(ValueError, match="headings name the measure with its unit"):
        rj.Hazard.from_file(path)
    path.write_text("PGA [furlong],annual_rate\n0.1,1e-2\n0.5,1e-3\n")
    with pytest.raises(ValueError, match="unit 'furlong' in the heading 'PGA \\[furlong\\]' is not known"):
        rj.Hazard.from_file(path)


SITE_RATES, SITE_LEVELS = np.array([0.035, 0.012, 0.0034, 7.5e-4]), np.array([0.05, 0.1, 0.2, 0.4])


@pytest.mark.parametrize(
    ("heading", "unit", "exceeded"),
    [
        ("PGA [g],probability of exceedance in 50 years", 1, -np.expm1(-50 * SITE_RATES)),
        ("PGA (g),PoE 50y", 1, -np.expm1(-50 * SITE_RATES)),
        ('"pga, G","POE, 100 YEARS"', 1, -np.expm1(-100 * SITE_RATES)),
        ("PGA, g, PoE, 50 years", 1, -np.expm1(-50 * SITE_RATES)),
        ("PGA / %g,prob. of exceedance [%] / 50 yr", 100, -100 * np.expm1(-50 * SITE_RATES)),
        ("# investigation_time = 50\nPGA [g],poe", 1, -np.expm1(-50 * SITE_RATES)),
        ("PGA [cm/s2],annual probability of exceedance", 980.665, -np.expm1(-SITE_RATES)),
        ("PGA [gal],return period [years]", 980.665, 1 / SITE_RATES),
        ("PGA (m/s²),annual frequency of exceedance", 9.80665, SITE_RATES),
        ("PGA,rate\n[g],[1/year]", 1, SITE_RATES),
        ("# PGA [g],λ", 1, SITE_RATES),
        ("Hazard at the site\nPGA [g],AEP", 1, -np.expm1(-SITE_RATES)),
    ],
)
def test_headings_determine_the_columns_of_hazard_tables(tmp_path, heading, unit, exceeded):
    path = tmp_path / "site.csv"
    rows = [f"{x!r},{y!r}\n" for x, y in zip((unit * SITE_LEVELS).tolist(), exceeded.tolist(), strict=True)]
    path.write_text(heading + "\n" + "".join(rows), encoding="utf-8")
    found = rj.Hazard.from_file(path)
    np.testing.assert_allclose(found.intensity, SITE_LEVELS * 9.80665, rtol=1e-13)
    np.testing.assert_allclose(found.annual_rate, SITE_RATES, rtol=1e-12)
    assert (found.measure, found.units) == ("PGA", "m s-2")


def test_hazard_tables_in_latin_1_and_with_decimal_commas(tmp_path):
    path = tmp_path / "site.csv"
    path.write_bytes("# Straße\nPGA [g];PoE in 50 years;\n0,1;0,4\n1;0,005\n".encode("latin-1"))
    found = rj.Hazard.from_file(path)
    np.testing.assert_allclose(found.intensity, [0.980665, 9.80665])
    np.testing.assert_allclose(found.annual_rate, -np.log1p([-0.4, -0.005]) / 50)


def test_columns_of_hazard_tables_come_in_any_order_beside_an_index(tmp_path):
    path = tmp_path / "site.csv"
    path.write_text("no.,annual_rate,Sa(0.3) (g)\n1,0.035,0.05\n2,0.012,0.1\n")
    found = rj.Hazard.from_file(path)
    np.testing.assert_allclose(found.annual_rate, [0.035, 0.012])
    np.testing.assert_allclose(found.intensity, np.array([0.05, 0.1]) * 9.80665)
    assert found.measure == "Sa(0.3 s)"


@pytest.mark.parametrize(
    ("heading", "words"),
    [
        ("PGA [g],poe", "'poe': the probability needs an investigation time"),
        ("PGA [g],probability of exceedance", "'probability of exceedance': the probability needs"),
        ("PGA [g],PoE in 0 years", "'PoE in 0 years': the investigation time must be > 0"),
        ("PGA [g],rate in 50 years", "'rate in 50 years': rates must be annual"),
        ("PGA [g],exceedance", "how often it is exceeded, .*; got 'PGA \\[g\\]', 'exceedance'"),
        ("PGA,annual_rate", "measure with its unit, .*; got 'PGA', 'annual_rate'"),
        ("PGA [cm/s],annual_rate", r"'PGA \[cm/s\]': cm/s is not a unit of acceleration"),
        ("PGA [g],probability of non-exceedance in 50 years", "non-exceedance in 50 years': the column must"),
        ("PGA [g],log10 annual rate", "'log10 annual rate': the column must have rates"),
        ("PGA [g],return period [s]", r"'return period \[s\]': s is not a unit of return period"),
    ],
)
def test_headings_of_hazard_tables_that_are_not_understood_are_quoted(tmp_path, heading, words):
    path = tmp_path / "site.csv"
    path.write_text(heading + "\n0.1,0.4\n0.5,0.1\n")
    with pytest.raises(ValueError, match=words):
        rj.Hazard.from_file(path)


@pytest.mark.parametrize(
    "heading", ["PGA [g] annual_rate", "# PGA [g]   annual rate", "PGA   rate\n[g]  [1/yr]"]
)
def test_hazard_tables_with_blanks_and_with_descending_rows(tmp_path, heading):
    path = tmp_path / "site.txt"
    rows = [f"{x!r}   {y!r}\n" for x, y in zip(SITE_LEVELS.tolist(), SITE_RATES.tolist(), strict=True)]
    for lines in (rows, rows[::-1]):
        path.write_text("\n".join([heading, *lines]))
        found = rj.Hazard.from_file(path)
        np.testing.assert_allclose(found.intensity, SITE_LEVELS * 9.80665, rtol=1e-13)
        np.testing.assert_allclose(found.annual_rate, SITE_RATES, rtol=1e-13)


def test_values_of_hazard_tables_that_make_no_sense_are_refused(tmp_path):
    path = tmp_path / "site.csv"
    for text, words in (
        ("PGA [g],PoE in 50 years\n0.1,4\n0.5,0.1\n", "in 0 … 1, got 0.1 … 4"),
        ("PGA [g],return period [years]\n0.1,0\n0.5,100\n", "must be > 0, got 0"),
        ("PGA [g],annual_rate\n0.1,1e-2\n0.5,few\n", ":3: expected a number in column 2, got 'few'"),
        ("PGA [g],annual_rate\n0.1,1e-2\n0.5\n", ":3: expected a number in column 2, got ''"),
        ("PGA [cm/s2],annual_rate\n12,5,0,01\n20,5,0,001\n", ":2: the line has more numbers than the 2 head"),
        ("PGA [g],annual_rate\n0.1,1e-2\n0.5,1e-3,7\n0.6,1e-4\n", ":3: the line has more numbers"),
        ("PGA [g],annual_rate\n0.1,1e-3\n0.5,1e-2\n", r"site\.csv: Hazard: annual_rate must not increase"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=words):
            rj.Hazard.from_file(path)


OPENQUAKE = """#,,,,,"generated_by='OpenQuake 3.16', kind='mean', investigation_time=50.0, imt='SA(0.5)'"
lon,lat,depth,poe-0.0500000,poe-0.1000000,poe-0.4000000,poe-2.0000000
10.1,45.2,0.0,9.0E-01,5.0E-01,1.0E-02,0.0E+00
11.1,45.2,0.0,1.0E+00,6.0E-01,2.0E-02,1.0E-04
"""


def test_hazards_of_openquake(tmp_path):
    path = tmp_path / "hazard_curve-mean.csv"
    path.write_text(OPENQUAKE)
    with pytest.raises(ValueError, match="curves of 2 sites; choose one by site = 0"):
        rj.Hazard.from_file(path)
    first, second = (rj.Hazard.from_file(path, site=k) for k in (0, 1))
    np.testing.assert_allclose(first.annual_rate, -np.log([0.1, 0.5, 0.99]) / 50)
    # Points with probabilities 0 or 1 contain no information.
    np.testing.assert_allclose(second.intensity, np.array([0.1, 0.4, 2.0]) * 9.80665)
    assert first.measure == "Sa(0.5 s)"
    lines = OPENQUAKE.splitlines(keepends=True)
    for text, words in (
        ("".join(lines[:2]), "the file has headings, but no curve below them"),
        (OPENQUAKE.replace("investigation", "risk_investigation"), "must state investigation_time and imt"),
        (OPENQUAKE.replace("poe-0.4", "poe-few"), ":2: expected a number in column 6, got 'few"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=words):
            rj.Hazard.from_file(path, site=0)


def test_fragilities_are_written_for_openquake_and_read_back(tmp_path):
    path = rj.write_fragility_model(tmp_path / "model.xml", [fragility(), fragility()], names=["a", "b"])
    text = path.read_text()
    mean = float(1.5 / 9.80665 * np.exp(0.08))
    assert f'mean="{mean!r}"' in text
    assert 'imt="PGA"' in text
    found = rj.read_fragility_model(path)
    assert list(found) == ["a", "b"]
    again = found["b"]
    assert float(again["median_capacity"]) == pytest.approx(1.5, rel=1e-14)
    assert float(again["dispersion"]) == pytest.approx(0.4, rel=1e-14)
    expected = float(rj.annual_frequency(fragility(), HAZARD).frequency)
    assert float(rj.annual_frequency(again, HAZARD).frequency) == pytest.approx(expected, rel=1e-12)
    (tmp_path / "no.xml").write_text("<nrml/>")
    with pytest.raises(ValueError, match="has no fragilityModel"):
        rj.read_fragility_model(tmp_path / "no.xml")
    with pytest.raises(ValueError, match=r"missing\.xml: the file cannot be read: No such file"):
        rj.read_fragility_model(tmp_path / "missing.xml")
    with pytest.raises(ValueError, match=r"intensity measure must be .*got 'scale'"):
        rj.write_fragility_model(tmp_path / "x.xml", fragility("scale", "1"))


@pytest.mark.parametrize(
    ("measure", "units", "expected"),
    [
        ("PGA", "g", 1.5 * 9.80665),
        ("PGA", "cm/s2", 0.015),
        ("PGV", "cm/s", 0.015),
        ("Sa(0.5 s)", "m/s²", 1.5),
    ],
)
def test_fragilities_in_any_unit_are_written(tmp_path, measure, units, expected):
    path = rj.write_fragility_model(tmp_path / "model.xml", fragility(measure, units))
    found = rj.read_fragility_model(path)["structure-1"]
    assert float(found["median_capacity"]) == pytest.approx(expected, rel=1e-14)
    assert float(found["dispersion"]) == pytest.approx(0.4, rel=1e-14)


@pytest.mark.parametrize(
    ("curves", "names", "words"),
    [
        ([fragility(), fragility()], ["a", "a"], "names must be different strings, one for each of 2"),
        ([fragility(), fragility()], [1, 2], "names must be different strings"),
        ([fragility(), fragility()], "ab", "names must be a list of strings, got 'ab'"),
        ({"a": fragility()}, None, "the curve of structure-1 must be a dataset.*got dict"),
        (rj.Lognormal(1.0, 0.4), None, "the curve of structure-1 must be a dataset.*got float"),
        (fragility("PGV", "m s-2"), None, "'m s-2' is not a unit of the intensity measure PGV"),
        (fragility("PGA", "furlong"), None, "'furlong' is not a unit of the intensity measure PGA"),
        (fragility().assign(dispersion=np.nan), None, "structure-1: dispersion must be finite and > 0"),
    ],
)
def test_models_that_cannot_be_read_back_are_not_written(tmp_path, curves, names, words):
    with pytest.raises(ValueError, match=words):
        rj.write_fragility_model(tmp_path / "model.xml", curves, names)
    assert not list(tmp_path.iterdir())


MODEL = """<nrml xmlns="http://openquake.org/xmlns/nrml/0.5"><fragilityModel id="m">
<limitStates>collapse</limitStates><fragilityFunction id="A" format="continuous" shape="logncdf">
<imls imt="PGA" %s/><params ls="collapse" mean="0.30" stddev="0.15"/></fragilityFunction>
</fragilityModel></nrml>"""


def openquake(x, no_damage=0.0, lowest=0.0, highest=0.0):
    """Return P of the model above at x [g] by the rules of OpenQuake, in which 0 means no limit."""
    dispersion = np.sqrt(np.log1p(0.25))
    x = min(x, highest) if highest else x
    x = max(x, lowest) if lowest else x
    return 0.0 if x <= no_damage else norm.cdf(np.log(x / 0.3 * np.exp(0.5 * dispersion**2)) / dispersion)


@pytest.mark.parametrize(
    "limits",
    [
        {"noDamageLimit": 0.2, "minIML": 0.05, "maxIML": 5.0},
        {"noDamageLimit": 0.1, "minIML": 0.1, "maxIML": 0.8},
        {"noDamageLimit": 0.02, "minIML": 0.005, "maxIML": 0.3},
        {"minIML": 0.15, "maxIML": 3.0},
        {"noDamageLimit": 0.1, "minIML": 0.2, "maxIML": 0.4},
        {"minIML": 0.005, "maxIML": 0.004 * 1000},
        {"noDamageLimit": 0.0, "minIML": 0.0, "maxIML": 0.6},
        {"noDamageLimit": 0.25},
        {"maxIML": 9.0},
        {"maxIML": 0.02},
        {"minIML": 40.0},
        {"noDamageLimit": 10.0},
        {},
    ],
    ids=str,
)
def test_limits_of_openquake_are_followed_and_written(tmp_path, limits):
    path = tmp_path / "model.xml"
    path.write_text(MODEL % " ".join(f'{key}="{value}"' for key, value in limits.items()))
    points, rates = np.array([0.05, 0.1, 0.3, 1.0, 3.0]), np.array([0.03, 0.01, 2e-3, 2e-4, 1e-5])
    hazard = rj.Hazard(points * 9.80665, rates)
    arguments = [limits.get(key, 0.0) for key in ("noDamageLimit", "minIML", "maxIML")]
    # If P stays > 0 at low intensities, the integral starts at the first given point, or where P begins to
    # increase.
    floor = arguments[1] > arguments[0]
    low = np.log(min(points[0], arguments[1]) if floor else 1e-6)
    breaks = sorted(y for y in np.log([*points, *(x for x in arguments if x)]) if y > low)
    ends = [low, *breaks, np.log(1e4)]

    def slope(s):
        k = -np.diff(np.log(rates)) / np.diff(np.log(points))
        i = np.clip(np.searchsorted(np.log(points), s) - 1, 0, 3)
        return float(k[i] * hazard(np.exp(s) * 9.80665))

    pieces = [
        quad(lambda s: openquake(np.exp(s), *arguments) * slope(s), a, b, epsabs=0, epsrel=1e-9, limit=200)[0]
        for a, b in itertools.pairwise(ends)
    ]
    exact = sum(pieces)
    outside = sum(y for a, y in zip(ends, pieces, strict=False) if not np.log(0.05) <= a < np.log(3.0))
    curve = rj.read_fragility_model(path)["A"]
    found = rj.annual_frequency(curve, hazard)
    assert float(found.frequency) == pytest.approx(exact, rel=1e-7)
    assert float(found.extrapolated) == pytest.approx(outside / exact, rel=1e-6)
    table = rj.disaggregation(curve, hazard, at=9.80665 * np.geomspace(1e-3, 400, 20_001))
    assert np.trapezoid(table["density"], np.log(table["intensity"])) == pytest.approx(1, abs=5e-3)
    # Writing and reading preserves the curve and the limits of the file.
    again = rj.read_fragility_model(rj.write_fragility_model(tmp_path / "again.xml", curve, ["A"]))["A"]
    assert float(rj.annual_frequency(again, hazard).frequency) == pytest.approx(exact, rel=1e-7)
    text = (tmp_path / "again.xml").read_text()
    for key, value in limits.items():
        assert f'{key}="{value:g}"' in text or not value
    assert ("noDamageLimit" in text) == bool(arguments[0])


def test_limits_do_not_come_from_the_range_of_a_picture(tmp_path):
    plotted = fragility().assign_coords(at=np.array([0.5, 1.0, 1.5]))
    again = rj.read_fragility_model(rj.write_fragility_model(tmp_path / "model.xml", plotted))["structure-1"]
    expected = float(rj.annual_frequency(fragility(), HAZARD).frequency)
    assert float(rj.annual_frequency(again, HAZARD).frequency) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ('noDamageLimit="0,1"', "A: attribute noDamageLimit must be a number, got '0,1'; write its decimal"),
        ('minIML="-0.1" maxIML="5"', "A: attribute minIML must be finite and >= 0, got '-0.1'"),
        ('minIML="5" maxIML="5"', "A: minIML 5 must be below maxIML 5"),
        ('noDamageLimit="6" maxIML="5"', "A: noDamageLimit 6 must be below maxIML 5"),
        ('imlUnit="m/s2"', "A: imlUnit must be 'g'.*got 'm/s2'"),
        ('minIml="0.1"', "A: minIml must be the attribute minIML of imls"),
        ('/><params ls="b" noDamageLimit="0.1"', "A: noDamageLimit must be the attribute noDamageLimit of"),
        ("/><maxIML>2</maxIML><params", "A: maxIML must be the attribute maxIML of imls"),
    ],
)
def test_limits_that_make_no_sense_are_refused(tmp_path, attributes, words):
    path = tmp_path / "model.xml"
    path.write_text(MODEL % attributes)
    with pytest.raises(ValueError, match=words):
        rj.read_fragility_model(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("PGA", "SA(0,3)"), r"must be PGA, PGV or SA\(T\), got 'SA\(0,3\)'"),
        (("PGA", "SA(-1)"), "must be PGA, PGV or SA"),
        (("<nrml", '<?xml version="1.0" encoding="EBCDIC-XX"?><nrml'), "not valid XML: unknown encoding"),
        (("<nrml", '<?xml version="1.0" encoding="shift_jis"?><nrml'), "not valid XML: multi-byte"),
        (("<nrml", "<!-- Straße -->\n<nrml"), ":1: the text is not UTF-8: byte 0xdf"),
    ],
)
def test_models_of_unknown_encodings_and_measures_are_refused(tmp_path, change, words):
    path = tmp_path / "model.xml"
    path.write_bytes((MODEL % "").replace(*change).encode("latin-1"))
    with pytest.raises(ValueError, match=rf"model\.xml.*{words}"):
        rj.read_fragility_model(path)


def test_models_with_equal_names_or_infinite_numbers_are_refused(tmp_path):
    path, (start, function) = tmp_path / "model.xml", (MODEL % "").split("<fragilityFunction")
    function, end = function.split("</fragilityModel>")
    function = "<fragilityFunction" + function
    for text, words in (
        (function * 2, "the file has two curves of A; names must be different"),
        (function.replace("0.30", "inf"), "A: mean must be finite and > 0, got mean = inf"),
        (function.replace("0.15", "inf"), "A: stddev must be finite and > 0, got stddev = inf"),
    ):
        path.write_text(start + text + "</fragilityModel>" + end)
        with pytest.raises(ValueError, match=words):
            rj.read_fragility_model(path)


# Gaussian ground motions.

MOTION = rj.GaussianMotion(601, 0.02, 0.01)


def test_the_map_has_the_known_entries():
    one = MOTION.acceleration(jnp.zeros(601).at[100].set(1.0))
    assert float(one[101]) == pytest.approx(0.5873645662598321, rel=1e-13)
    assert float(one[150]) == pytest.approx(-0.01665145486809714, rel=1e-12)
    assert not np.any(one[:101])


def test_its_spread_is_exact():
    spread = MOTION.standard_deviation()
    assert float(spread[200]) == pytest.approx(0.96681, abs=5e-6)
    _, transpose = jax.vjp(MOTION.acceleration, jnp.zeros(601))
    (row,) = transpose(jnp.zeros(601).at[200].set(1.0))
    assert float(jnp.linalg.norm(row)) == pytest.approx(float(spread[200]), rel=1e-12)
    long = rj.GaussianMotion(4001, 0.02, 0.01, envelope=lambda t: jnp.ones_like(t))
    assert float(long.standard_deviation()[-1]) == pytest.approx(
        0.96899, rel=2e-3
    )  # for noise that is constant over dt


def test_its_spread_has_derivatives():
    """The standard deviation is proportional to √S₀. At the first sample it is 0."""
    few = rj.GaussianMotion(31, 0.08, 0.02)

    def largest(S_0):
        spread = dataclasses.replace(few, S_0=S_0).standard_deviation()
        return jnp.max(spread) + spread[0]

    value, slope = jax.value_and_grad(largest)(0.02)
    assert float(slope) == pytest.approx(0.5 * float(value) / 0.02, rel=1e-10)


def test_motions_are_linear_repeatable_and_batched():
    u = MOTION.samples(4, seed=3)
    motions = MOTION.acceleration(u)
    np.testing.assert_allclose(MOTION.acceleration(2 * u[0] - u[1]), 2 * motions[0] - motions[1], atol=1e-12)
    np.testing.assert_allclose(MOTION.scaled(1.7).acceleration(u[2]), 1.7 * motions[2], rtol=1e-12)
    np.testing.assert_array_equal(MOTION.samples(4, seed=3), u)
    assert MOTION.record(u).acceleration.shape == (4, 601)


@pytest.mark.slow
def test_response_spectra_of_sampled_motions():
    motion = rj.GaussianMotion(201, 0.04, 0.01)
    periods = (0.0, 0.4, 1.0)
    found = motion.response_spectrum(periods, count=60, seed=2)
    assert np.all(found["fractile_16"] < found["median"])
    assert np.all(found["median"] < found["fractile_84"])
    assert float(found["dispersion"].min()) > 0.05
    # At T = 0 the values are the largest accelerations.
    largest = np.abs(motion.acceleration(motion.samples(60, seed=2))).max(axis=1)
    assert float(found["median"][0]) == pytest.approx(float(np.median(largest)), rel=1e-6)
    # Twice the motion has twice the spectrum and the same dispersion.
    twice = motion.scaled(2.0).response_spectrum(periods, count=60, seed=2)
    np.testing.assert_allclose(twice["median"], 2 * found["median"], rtol=1e-9)
    np.testing.assert_allclose(twice["dispersion"], found["dispersion"], rtol=1e-9)
    with pytest.raises(ValueError, match="count must be a whole number >= 2"):
        motion.response_spectrum(count=1)
    with pytest.raises(ValueError, match=r"GaussianMotion\.response_spectrum: periods must be"):
        motion.response_spectrum((-1.0,))


def test_derivatives_of_the_map():
    u = MOTION.samples(1, seed=5)[0]

    def energy(motion):
        return jnp.sum(motion.acceleration(u) ** 2)

    slopes = jax.grad(energy)(MOTION)
    assert float(slopes.S_0) == pytest.approx(float(energy(MOTION)) / 0.01, rel=1e-12)
    h = 1e-5
    for name in ("omega_g", "zeta_g", "omega_f", "zeta_f"):
        y = float(getattr(MOTION, name))
        up, down = (energy(rj.GaussianMotion(601, 0.02, 0.01, **{name: y * (1 + s * h)})) for s in (1, -1))
        assert float(getattr(slopes, name)) == pytest.approx(float(up - down) / (2 * h * y), rel=1e-6)


LAYER, LOW = rj.Filter.layer(6.0, 0.1), rj.Filter.low_pass(30.0)


def test_filters_in_series_are_those_of_the_transfer_function():
    """Comparison with SciPy's filter: the product of all polynomials, with an input that is constant over
    each interval."""
    filters = (LAYER, rj.Filter([0.3, 2.0, 50.0], [4.0, 90.0]), LOW)
    motion = rj.GaussianMotion(301, 0.02, 0.01, filters=filters)
    ground = [-2 * 0.6 * 15.0, -(15.0**2)], [1.0, 2 * 0.6 * 15.0, 15.0**2]
    above, below = np.polymul([1.0, 0.0, 0.0], ground[0]), np.polymul(ground[1], [1.0, 1.8, 2.25])
    for one in filters:
        above = np.polymul(above, np.asarray(one.numerator))
        below = np.polymul(below, np.asarray([1.0, *one.denominator]))
    system = signal.cont2discrete(signal.tf2ss(-above, below), 0.02, method="zoh")
    u = np.asarray(motion.samples(1, seed=4)[0])
    noise = u * np.asarray(motion.envelope(motion.t)) * np.sqrt(2 * np.pi * 0.01 / 0.02)
    expected = signal.dlsim(system, noise)[1][:, 0]
    np.testing.assert_allclose(motion.acceleration(u), expected, atol=1e-9 * np.abs(expected).max())
    turned = rj.GaussianMotion(301, 0.02, 0.01, filters=filters[::-1])
    np.testing.assert_allclose(turned.acceleration(u), expected, atol=1e-9 * np.abs(expected).max())


def test_pass_bands_of_filters():
    steady = {"envelope": lambda t: jnp.ones_like(t)}
    plain = rj.GaussianMotion(2001, 0.02, 0.01, **steady).standard_deviation()[-1]
    layered = rj.GaussianMotion(2001, 0.02, 0.01, filters=(LAYER,), **steady)
    _, transpose = jax.vjp(layered.acceleration, jnp.zeros(2001))
    (row,) = transpose(jnp.zeros(2001).at[-1].set(1.0))
    assert float(jnp.linalg.norm(row)) == pytest.approx(float(layered.standard_deviation()[-1]), rel=1e-10)
    # Filters with ω far above or far below all frequencies of the motion have no effect.
    through = (rj.Filter.low_pass(3e4), rj.Filter.high_pass(1e-4), rj.Filter.layer(3e4, 0.7))
    same = rj.GaussianMotion(2001, 0.02, 0.01, filters=through, **steady)
    assert float(same.standard_deviation()[-1]) == pytest.approx(float(plain), rel=1e-3)
    less = rj.GaussianMotion(2001, 0.02, 0.01, filters=(rj.Filter.low_pass(3.0),), **steady)
    assert float(less.standard_deviation()[-1]) < 0.3 * float(plain)


def test_filters_have_derivatives_and_are_named():
    u = MOTION.samples(1, seed=5)[0]

    def energy(omega):
        return jnp.sum(through_layer(omega).acceleration(u) ** 2)

    def through_layer(omega):
        return rj.GaussianMotion(601, 0.02, 0.01, filters=[rj.Filter.layer(omega, 0.1)])

    h = 1e-5
    expected = (energy(6.0 + h) - energy(6.0 - h)) / (2 * h)
    assert float(jax.grad(energy)(6.0)) == pytest.approx(float(expected), rel=1e-6)
    slopes = jax.grad(lambda motion: jnp.sum(motion.acceleration(u)))(through_layer(6.0))
    named = _by_location(jax.tree.map(lambda y: y[None], slopes))
    alone = rj.GaussianMotion(31, 0.1, 0.01, filters=rj.Filter.layer(6.0, 0.1))
    assert eqx.tree_equal(alone.filters, through_layer(6.0).filters)
    assert named["filters[0].denominator[1]"] == slopes.filters[0].denominator[1]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rj.Filter([1.0, 0.0], [1.0, 1.0]), "numerator must have shape"),
        (lambda: rj.Filter([1.0, 0.0, 0.0], [0.0, 1.0]), "denominator must be"),
        (lambda: rj.Filter.low_pass(-1.0), "Filter.low_pass: omega must be"),
        (
            lambda: rj.GaussianMotion(31, 0.1, 0.01, filters=[3.0]),
            "filters must be one or more instances of rockjax.Filter",
        ),
        (
            lambda: rj.GaussianMotion(31, 0.1, 0.01, filters=3.0),
            "filters must be one or more instances of rockjax.Filter",
        ),
    ],
)
def test_filters_that_make_no_sense_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_a_random_pulse_on_top():
    pulse = rj.RandomPulse(rj.Lognormal(0.4, 0.3), rj.Lognormal(1.2, 0.2), centre=4.0)
    motion = rj.GaussianMotion(601, 0.02, 0.01, pulse=pulse)
    assert motion.dimension == 604
    quiet = jnp.zeros(604)
    expected = rj.MavroeidisPapageorgiou(0.4, 1 / 1.2, 2.0, np.pi)
    t = np.asarray(motion.t) - 4.0
    np.testing.assert_allclose(motion.acceleration(quiet), expected(t), atol=1e-12)
    louder = motion.acceleration(quiet.at[601].set(1.0))
    np.testing.assert_allclose(louder, np.exp(0.3) * np.asarray(motion.acceleration(quiet)), atol=1e-12)


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ({"n": 1}, "n must be a whole number >= 2"),
        ({"n": 10.0}, "n must be a whole number >= 2"),
        ({"S_0": 0.0}, "S_0 must be finite and > 0"),
        ({"dt": -0.1}, "dt must be finite and > 0"),
        ({"omega_f": np.nan}, "omega_f must be finite and > 0"),
        ({"envelope": 1.0}, "envelope must be a function of time"),
    ],
)
def test_gaussian_motions_that_make_no_sense_are_refused(numbers, expected):
    with pytest.raises(ValueError, match=expected):
        rj.GaussianMotion(**({"n": 101, "dt": 0.02, "S_0": 0.01} | numbers))
    with pytest.raises(ValueError, match=r"u must have shape \(…, 601\)"):
        MOTION.acceleration(jnp.zeros(600))


# Reliability: limit states with known answers.

ROOT2 = np.sqrt(2.0)


def resistance_and_load(u):
    return (200 + 10 * u[0]) - (100 + 20 * u[1])


def parabola(x):
    return 2.5 - (x[0] + x[1]) / ROOT2 + 0.1 * (x[0] - x[1]) ** 2


def four_branches(x):
    bend = 3 + 0.1 * (x[0] - x[1]) ** 2
    along, across = (x[0] + x[1]) / ROOT2, x[0] - x[1]
    return jnp.min(jnp.stack([bend - along, bend + along, across + 7 / ROOT2, 7 / ROOT2 - across]))


DIRECTION = np.random.default_rng(1).standard_normal(300)


def plane(u):
    return 3.5 - jnp.asarray(DIRECTION / np.linalg.norm(DIRECTION)) @ u


EXACT = {
    "resistance and load": (resistance_and_load, 2, 3.872108215522042e-6),
    "parabola": (parabola, 2, 4.207305511299618e-3),
    "four branches": (four_branches, 2, 2.222795066194432e-3),
    "plane": (plane, 300, norm.cdf(-3.5)),
}


def test_design_points_of_known_limit_states():
    limit = FunctionLimitState(resistance_and_load, 2)
    (u,), _, (beta,), (aligned,) = search.design_points(limit, np.eye(2))
    assert beta == pytest.approx(4.47213595499958, rel=1e-12)
    np.testing.assert_allclose(np.array([200, 100]) + np.array([10, 20]) * u, [180, 180], rtol=1e-9)
    assert aligned
    limit = FunctionLimitState(plane, 300)
    found = search.design_points(limit, np.random.default_rng(0).standard_normal((2, 300)))
    np.testing.assert_allclose(found.u[0], 3.5 * DIRECTION / np.linalg.norm(DIRECTION), atol=1e-9)
    limit = FunctionLimitState(four_branches, 2)
    found = search.design_points(limit, starting_directions(limit, 16, 0))
    np.testing.assert_allclose(found.beta, [3, 3, 3.5, 3.5], rtol=1e-6)


@pytest.mark.parametrize("method", ["importance", "line", "subset"])
@pytest.mark.parametrize("name", EXACT)
def test_probabilities_of_known_limit_states(name, method):
    G, dimension, truth = EXACT[name]
    found = rj.reliability(G, dimension, method=method, seed=4)
    assert found.converged
    assert found.standard_error <= 0.1 * found.probability
    # Three standard errors; subset simulation has an additional bias.
    assert abs(found.probability - truth) < 3 * found.standard_error + 1e-6 * truth
    assert rj.reliability(G, dimension, method=method, seed=4).probability == found.probability


@pytest.mark.parametrize(
    ("G", "exact"),
    [
        (lambda x: jnp.minimum(1.0, 3.5 - x), norm.sf(3.5)),
        (lambda x: jnp.where(x < 2.2, 1.0, 3.5 - x), norm.sf(3.5)),
        (lambda x: jnp.where(x > 2.5, -1.0, 1.0), norm.sf(2.5)),
        (lambda x: jnp.where(x > 2.5, -1.0, jnp.inf), norm.sf(2.5)),
    ],
    ids=["continuous", "with a jump", "two values", "infinite"],
)
def test_subset_simulation_of_limit_states_that_are_constant_for_most_samples(G, exact):
    """Like motions that lift no column: G = 1."""
    found = rj.reliability(lambda u: G(u.sum() / np.sqrt(20)), 20, seed=2)
    assert found.converged
    assert abs(found.probability - exact) < 3 * found.standard_error


def test_intervals_of_subset_simulation_have_the_stated_coverage():
    """Sixteen seeds for a plane in 60 dimensions: with 95 % intervals two misses are rare, and four are an
    error."""
    normal = jnp.asarray(DIRECTION[:60] / np.linalg.norm(DIRECTION[:60]))
    limit = FunctionLimitState(lambda u: 3.0 - normal @ u, 60)
    runs = [
        estimate_probability("test", limit, np.zeros((0, 60)), "subset", 0.2, k, 100_000, False)
        for k in range(16)
    ]
    p = np.array([run.probability for run in runs])
    held = [run.interval[0] <= norm.sf(3.0) <= run.interval[1] for run in runs]
    assert all(run.converged for run in runs)
    assert sum(held) >= 14
    assert 0.05 < p.std(ddof=1) / p.mean() < 0.25
    assert p.mean() == pytest.approx(norm.sf(3.0), rel=0.15)


def test_monte_carlo_and_its_interval():
    found = rj.reliability(parabola, 2, method="monte-carlo", cov=0.2, seed=1)
    low, high = found.interval
    assert low < EXACT["parabola"][2] < high
    assert found.effective_sample_size == round(found.probability * found.scenes)


def test_progress_counts_the_scenes():
    """A progress bar needs only a method `update`, and may already have counted other work."""

    class Counter:
        def __init__(self):
            self.total, self.n = 0, 10**6

        def update(self, number):
            self.total += number

    counter = Counter()
    found = rj.reliability(parabola, 2, method="monte-carlo", cov=0.2, seed=1, progress=counter)
    assert counter.total == found.scenes
    del counter.n
    rj.reliability(parabola, 2, method="monte-carlo", cov=0.2, seed=1, progress=counter)
    assert counter.total == 2 * found.scenes


def ball(u):
    """Limit state with failure outside a ball, P = 1e-3, without a preferred direction, as in rocking."""
    return chi2.isf(1e-3, u.size) - jnp.sum(u**2)


def test_the_default_method_is_right_where_failure_has_no_direction():
    for seed in range(4):
        found = rj.reliability(ball, 20, seed=seed)
        assert (found.method, found.converged) == ("subset", True)
        assert abs(found.probability - 1e-3) < 2.5 * found.standard_error


@pytest.mark.parametrize(
    ("G", "dimension", "arguments", "words"),
    [
        (
            ball,
            20,
            {"method": "importance", "max_scenes": 50_000},
            "'importance' .* use method='subset', or",
        ),
        # An estimate of 4e-4, whose coefficient of variation of 16 % meets the request.
        (ball, 10, {"method": "importance", "cov": 0.2, "seed": 3}, "a few with large weights make up"),
        (parabola, 2, {"method": "importance", "max_scenes": 400, "cov": 0.01}, ", not 0.01; use"),
        (
            parabola,
            2,
            {"method": "line", "max_scenes": 400, "cov": 0.01},
            "method='subset', or a larger max_s",
        ),
        (parabola, 2, {"max_scenes": 1000}, "'subset' has not converged .* use a larger max_scenes"),
        (lambda u: 1.0 + u[0] ** 2, 2, {}, "no scene fails; use stronger motions"),
    ],
    ids=["far", "heavy tail", "importance", "line", "subset", "never"],
)
def test_an_estimate_that_has_not_converged_warns_and_has_no_interval(G, dimension, arguments, words):
    with pytest.warns(RuntimeWarning, match=f"reliability: the probability .*{words}"):
        found = rj.reliability(G, dimension, **arguments)
    assert not found.converged
    assert np.isnan(found.interval).all()
    assert "no interval) from" in repr(found)


def test_counting_has_an_interval_whether_it_has_converged_or_not():
    with pytest.warns(RuntimeWarning, match="'monte-carlo' has not converged"):
        found = rj.reliability(parabola, 2, method="monte-carlo", max_scenes=4000, seed=1)
    assert found.interval[0] < EXACT["parabola"][2] < found.interval[1]


def test_first_order_beside_the_sampled_probability():
    plane_found = rj.reliability(plane, 300, method="importance")
    assert plane_found.first_order == pytest.approx(norm.cdf(-3.5), rel=1e-9)
    assert not plane_found.disagrees
    bent = rj.reliability(lambda x: 2.5 - x[0] + 2.0 * x[1] ** 2, 2, method="importance")
    assert bent.first_order > 1.5 * bent.probability
    assert bent.disagrees
    assert "disagrees" in repr(bent)


def test_two_planes_are_added_up_exactly():
    # P(x > a or y > b) for correlated normal variables, compared with quadrature.
    u = np.array([[2.0, 0.0], [1.2, 1.6]])
    found = search.DesignPoints(u, u / 2, np.array([2.0, 2.0]), np.array([True, True]))
    both = quad(lambda x: norm.pdf(x) * norm.sf((2 - 0.6 * x) / 0.8), 2, 12, epsrel=1e-12)[0]
    assert first_order_probability(found) == pytest.approx(2 * norm.sf(2) - both, rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (
            {"method": "form"},
            "method must be one of 'importance', 'line', .*, got 'form'",
        ),
        ({"cov": 0}, "cov must be in"),
        ({"seed": -1}, "seed must be a whole number >= 0"),
        ({"starts": 0}, "starts must be a whole number >= 1"),
        ({"dimension": 0}, "dimension must be a whole number >= 1"),
        ({"G": 1.0}, "G must be a function of u"),
        ({"G": lambda u: 2 - u}, r"G must return a scalar for u of shape \(2,\)"),
        ({"G": lambda u: 2 - u[:1], "method": "subset"}, "G must return a scalar"),
        ({"G": lambda u: None, "method": "subset"}, "G must return a scalar.*got None"),
        ({"cov": "a"}, "cov must be in"),
        ({"G": lambda u: u[0] - 1}, "fails at u = 0"),
        ({"G": lambda u: 20 - u[0]}, "found no failure within 9 standard deviations"),
        ({"G": lambda u: jnp.log(u[0] - 10)}, "G is NaN at a distance"),
    ],
)
def test_arguments_that_make_no_sense_are_refused(arguments, expected):
    with pytest.raises(ValueError, match=expected):
        rj.reliability(**({"G": parabola, "dimension": 2, "method": "importance"} | arguments))


def test_ctrl_c_keeps_the_estimate_so_far(monkeypatch):
    values, calls = FunctionLimitState.values, []

    def stopped(self, u):
        calls.append(len(u))
        if len(calls) > 12:
            raise KeyboardInterrupt
        return values(self, u)

    monkeypatch.setattr(FunctionLimitState, "values", stopped)
    with pytest.raises(rj.Interrupted) as caught:
        rj.reliability(parabola, 2, method="monte-carlo", cov=0.001)
    assert caught.value.partial.probability > 0
    assert not caught.value.partial.converged


class Moved(FunctionLimitState):
    """G(u, b) with its derivative with respect to b."""

    def __init__(self, G, b, dimension):
        super().__init__(lambda u: G(u, b), dimension)
        self._by_b = jax.vmap(jax.value_and_grad(G, (0, 1)), (0, None))
        self.b = b

    def with_sensitivities(self, u):
        value, (slope, of_b) = self._by_b(jnp.asarray(u), self.b)
        return np.asarray(value), np.asarray(slope), {"b": np.asarray(of_b)}


def z(u):
    return jnp.sum(u) / jnp.sqrt(u.size)


def bowl(u, b):
    return b - z(u) + 0.1 * (u[0] - u[1]) ** 2


def window(u, b):
    """Limit state with failure between b and 3, so every line leaves failure again."""
    return (z(u) - b) * (z(u) - 3.0)


def step(u, b):
    return jnp.where(z(u) < b, 1.0, -1.0) - 1e-3 * z(u)


@pytest.mark.parametrize(
    ("G", "dimension", "exact"),
    [
        (bowl, 2, -quad(lambda w: norm.pdf(w) * norm.pdf(2.0 + 0.2 * w * w), -9, 9)[0]),
        (window, 5, -norm.pdf(2.0)),
    ],
)
def test_derivatives_of_probabilities_are_surface_integrals(G, dimension, exact):
    limit = Moved(G, 2.0, dimension)
    found = estimate_probability(
        "test", limit, starting_directions(limit, 8, 0), "line", 0.03, 1, 100_000, False
    )
    slope, error = found.sensitivities["b"]
    assert found.jumps == 0
    assert abs(slope - exact) < 3 * error + 1e-3 * abs(exact)
    assert error < 0.05 * abs(exact)


def test_derivatives_report_jumps_of_the_limit_state():
    limit = Moved(step, 2.0, 3)
    found = estimate_probability(
        "test", limit, starting_directions(limit, 8, 0), "line", 0.1, 1, 100_000, False
    )
    assert found.probability == pytest.approx(norm.sf(2.0), rel=0.1)
    assert found.jumps == pytest.approx(1.0)
    assert found.sensitivities["b"] == (0.0, 0.0)


# Rocking structures: a block, and an equivalent frame.

NOISE = rj.GaussianMotion(121, 0.04, 0.02)
BLOCK = rj.Podium(alpha=0.2, R=1.0)


@pytest.mark.slow
def test_the_limit_state_of_a_block():
    limit = StructureLimitState(BLOCK, NOISE, parse_limit("test", "overturning", BLOCK))
    u = NOISE.samples(40, seed=2)
    value = limit.values(np.asarray(u))
    records = [NOISE.record(row) for row in u]
    options = rj.Options(outputs=("margin",), rtol=1e-11, atol=1e-13)
    for k in (0, 17, 39):
        expected = rj.peak_response(BLOCK, records[k], options=options)
        assert value[k] == pytest.approx(float(expected.margin), abs=1e-7)
        assert (value[k] <= 0) == bool(expected.overturned)
    np.testing.assert_allclose(limit.values(-np.asarray(u)), value, atol=1e-9)  # symmetric in u
    # Derivatives with respect to a sample and to the parameters of structure and ground.
    near = np.asarray(u[:8]) * 0.9
    value, slope, named = limit.with_sensitivities(near)
    best = int(np.argmin(np.abs(value - 0.5)))
    along, h = np.random.default_rng(3).standard_normal(limit.dimension), 1e-5
    up, down = limit.values(np.stack([near[best] + h * along, near[best] - h * along]))
    assert slope[best] @ along == pytest.approx((up - down) / (2 * h), rel=1e-5, abs=1e-7)
    for name, complete, exact in (("alpha", BLOCK, named["alpha"]), ("S_0", NOISE, named["S_0"])):
        y = float(getattr(complete, name))
        moved = [dataclasses.replace(complete, **{name: y * (1 + s * h)}) for s in (1, -1)]
        pairs = [(p, NOISE) if name == "alpha" else (BLOCK, p) for p in moved]
        up, down = (StructureLimitState(p, m, limit.limit).values(near[best : best + 1])[0] for p, m in pairs)
        assert float(exact[best]) == pytest.approx((up - down) / (2 * h * y), rel=1e-4, abs=1e-6)


@pytest.mark.slow
def test_probabilities_of_a_block():
    subset = rj.failure_probability(BLOCK, NOISE, method="subset", cov=0.2, seed=1)
    counted = rj.failure_probability(BLOCK, NOISE, method="monte-carlo", cov=0.2, seed=1)
    error = np.hypot(subset.standard_error, counted.standard_error)
    assert abs(subset.probability - counted.probability) < 3 * error


PODIUM = rj.Podium(alpha=0.15, R=1.5, gamma=5.0, superstructure=rj.Elastic(20.0, 0.4, 0.05))
# Counted failures, and the number of motions.
MONTE_CARLO = {
    "block": (BLOCK, rj.GaussianMotion(61, 0.06, 0.02), 1120, 100_000),
    "rare block": (BLOCK, rj.GaussianMotion(61, 0.06, 0.0114), 1890, 18_000_000),
    "podium": (PODIUM, rj.GaussianMotion(601, 0.02, 0.004), 32, 400_000),
}


@pytest.mark.slow(but=["block-0"])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", MONTE_CARLO)
def test_probabilities_of_rocking_structures_are_those_counted(name, seed):
    """The default method agrees with counts; importance sampling finds a ninth of the probability of the
    elastic podium."""
    podium, motion, failures, scenes = MONTE_CARLO[name]
    found = rj.failure_probability(podium, motion, cov=0.2, seed=seed)
    counted, error = failures / scenes, math.sqrt(failures) / scenes
    assert found.converged
    assert abs(found.probability - counted) < 2.5 * math.hypot(found.standard_error, error)


DEVICES = rj.Podium(0.15, 1.5, 10.0, restrainers=(rj.Tendon(5.0, 60.0), rj.Damper(4.0)))
STORIES = rj.ShearBuilding(masses=(3.0, 2.0), stiffnesses=(900.0, 500.0))


def test_derivatives_are_named_by_where_the_numbers_are():
    """Includes parameters of a building and of restrainers, each with a separate derivative."""
    trees = DEVICES.replace(superstructure=STORIES), NOISE
    named = _by_location(*jax.tree.map(lambda y: jnp.stack([y, y + 1.0]), trees))
    np.testing.assert_array_equal(named["superstructure.stiffnesses[1]"], [500.0, 501.0])
    np.testing.assert_array_equal(named["restrainers[0].prestress"], [5.0, 6.0])
    assert {"alpha", "superstructure.masses[0]", "restrainers[1].coefficient", "S_0"} <= set(named)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*has not converged in:RuntimeWarning")
@pytest.mark.parametrize(
    ("podium", "limit", "output", "name", "place"),
    [
        (
            DEVICES,
            ("rotation", 0.1),
            "peak_rotation",
            "restrainers[0].prestress",
            lambda podium: podium.restrainers[0].prestress,
        ),
        (
            DEVICES.replace(superstructure=STORIES),
            ("drift", 0.03),
            "peak_drift",
            "superstructure.masses[1]",
            lambda podium: podium.superstructure.masses,
        ),
    ],
    ids=["rotation", "drift"],
)
def test_design_points_of_restrained_podiums(podium, limit, output, name, place):
    """The motion reaches the limit, and a derivative of β equals the derivative of the peak divided by its
    slope along the motion."""
    motion = rj.GaussianMotion(31, 0.08, 0.02)
    first = rj.design_points(podium, motion, limit=limit, starts=2)[0]
    assert first.smooth
    options = OPTIONS.replace(outputs=(output, "impacts"))
    peak = rj.peak_response(podium, first.record, options=options)
    assert float(np.max(getattr(peak, output))) == pytest.approx(limit[1], rel=1e-6)
    assert first.mode == int(peak.impacts)

    def value(factor, size):
        last = np.ndim(place(podium)) - 1
        numbers = place(podium) if last < 0 else place(podium).at[1].set(size)
        frame = eqx.tree_at(place, podium, jnp.asarray(size) if last < 0 else numbers)
        record = motion.record(jnp.asarray(first.u * factor))
        return float(np.max(getattr(rj.peak_response(frame, record, options=options), output)))

    size, h = float(np.ravel(place(podium))[-1]), 1e-5
    along = (value(1 + h, size) - value(1 - h, size)) / (2 * h * first.beta)
    across = (value(1.0, size * (1 + h)) - value(1.0, size * (1 - h))) / (2 * h * size)
    assert first.sensitivities[name] == pytest.approx(-across / along, rel=1e-3)
    # Line sampling with derivatives with respect to all parameters, compared with subset simulation.
    arguments: dict = {"limit": limit, "cov": 0.3, "max_scenes": 3000, "starts": 2}
    line, subset = (rj.failure_probability(podium, motion, method=y, **arguments) for y in ("line", "subset"))
    spread = np.hypot(line.standard_error, subset.standard_error)
    assert abs(line.probability - subset.probability) < 4 * spread
    assert set(line.sensitivities) == set(first.sensitivities)
    assert all(np.isfinite(pair).all() for pair in line.sensitivities.values())


def test_a_limit_is_one_number():
    with pytest.raises(ValueError, match=r"limit 'rotation' .* must be finite and > 0, got .*\[0.1, 0.2\]"):
        parse_limit("test", ("rotation", [0.1, 0.2]), BLOCK)


def test_limits_that_a_structure_has_not_are_refused():
    for limit, expected in (
        ("falling", "limit must be 'overturning' or one of"),
        (("shear", 0.2), "needs a superstructure; this podium has none"),
        (("rotation", 1.0), "'rotation' must be < 1"),
        (("rotation", -0.1), "must be finite and > 0"),
    ):
        with pytest.raises(ValueError, match=expected):
            rj.failure_probability(BLOCK, NOISE, limit=limit)
    traced = lambda value: rj.failure_probability(BLOCK, NOISE, limit=("friction", value)).probability
    with pytest.raises(ValueError, match="limit 'friction' must be a number, not a traced value"):
        jax.jit(traced)(0.4)
    with pytest.raises(ValueError, match=r"motion must be a rockjax.GaussianMotion, got Ricker"):
        rj.failure_probability(BLOCK, rj.Ricker(1.0, 1.0))
