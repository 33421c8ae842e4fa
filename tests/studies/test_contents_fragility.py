"""Fragility of blocks on floors: comparison with blocks on the ground, counts, table for pelicun, invalid
inputs."""

import csv
import functools
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import scipy.stats
import xarray

import rockjax as rj
from rockjax import plots
from tests.scenes import shaking

SUITE = [shaking(150, 0.02, 3.0 + 0.1 * k, k) for k in range(6)]
FRAME = rj.Podium(alpha=0.15, R=1.5, gamma=10.0)
# Slender blocks, and one that no impact of the deck lifts: tan α_c > (1 − e)/((1 + e) tan α).
BLOCKS = {
    "slender": rj.Contents(0.06, 0.8),
    "small": rj.Contents(0.08, 0.3),
    "stocky": rj.Contents(0.35, 0.5),
}
LEVELS = np.array([0.7, 1.2, 1.7, 2.5, 6.0, 9.0])
OPTIONS = rj.Options(outputs=("peak_rotation",))


@functools.cache
@pytest.mark.filterwarnings("ignore:contents_fragility")
def on_frame(overturned: Any) -> xarray.Dataset:
    return rj.contents_fragility(FRAME, BLOCKS, SUITE, LEVELS, overturned=overturned, options=OPTIONS)


@pytest.mark.filterwarnings("ignore:contents_fragility")
def test_on_a_podium_that_never_lifts_a_block_has_the_fragility_of_one_on_the_ground():
    never_lifts, block = rj.Podium(alpha=1.2, R=1.5, gamma=10.0), rj.Podium(0.2, 0.5)
    levels, states = np.array([2.3, 2.4, 2.5, 2.65, 2.75, 3.0]), (0.3, 1.0)
    contents = {name: rj.Contents(0.2, 0.5) for name in BLOCKS}
    found = rj.contents_fragility(never_lifts, contents, SUITE, levels, damage_states=states, options=OPTIONS)
    coarse: Any = {"options": OPTIONS, "resolution": 32, "width": 0.1}
    analysis = rj.incremental_dynamic_analysis(block, SUITE, levels, **coarse)
    for state, limit in zip(states, (("peak_rotation", 0.3), None), strict=True):
        curve, one = rj.fragility(analysis, method="stripes", limit=limit), found.sel(damage_state=state)
        assert 0 < float(curve["observed"].mean()) < 1
        for name in ("median_capacity", "dispersion", "observed", "interval", "probability", "lower"):
            for other in contents:
                same = one[name].sel(contents=other)
                np.testing.assert_allclose(same, curve[name], rtol=1e-9, err_msg=name)
    assert np.all(found["counted"] == len(SUITE))


@pytest.mark.filterwarnings("ignore:contents_fragility")
def test_counts_and_curves():
    """Blocks do not affect the podium, counts follow their definition, and curves maximise the binomial
    likelihood."""
    data = on_frame("drop")
    which = np.arange(len(SUITE), dtype=np.int32)[:, None]
    table = rj.Records.of(SUITE)
    scale = LEVELS / table.magnitudes().max(axis=1)[:, None]
    plain = rj.peak_responses(FRAME, table.pick_scaled(which, scale), options=OPTIONS)
    assert np.array_equal(data["peak_rotation"], plain.peak_rotation)
    assert 0 < plain.overturned.sum() < plain.overturned.size
    exceed = on_frame("exceed")
    for name in BLOCKS:
        rotation = data["contents_peak_rotation"].sel(contents=name).values
        for state in data["damage_state"].values:
            reached = rotation > 0 if state == 0 else rotation >= state
            stands = ~plain.overturned
            with np.errstate(invalid="ignore"):
                shares = (reached & stands).sum(axis=0) / stands.sum(axis=0)
            here = {"contents": name, "damage_state": state}
            np.testing.assert_array_equal(data["observed"].sel(here), shares)
            np.testing.assert_array_equal(exceed["observed"].sel(here), (reached | ~stands).mean(axis=0))
            assert np.all(data["counted"].sel(contents=name) == stands.sum(axis=0))
            median = float(exceed["median_capacity"].sel(here))
            if np.isfinite(median):
                events = (reached | ~stands).sum(axis=0)

                def loss(y, events=events):
                    p = scipy.stats.norm.cdf((np.log(LEVELS) - y[0]) / np.exp(y[1]))
                    return -scipy.stats.binom.logpmf(events, len(SUITE), p).sum()

                best = scipy.optimize.minimize(loss, [np.log(median), -1.0], tol=1e-12).x
                found = [median, float(exceed["dispersion"].sel(here))]
                np.testing.assert_allclose(np.exp(best), found, rtol=1e-4)
    assert np.isfinite(exceed["median_capacity"]).sum() >= 4


@pytest.mark.filterwarnings("ignore:contents_fragility")
def test_impacts_that_end_the_rocking_do_not_start_a_block():
    """Fact 17: no impact of the deck starts a block less slender than (1 − e)/((1 + e) tan α)."""
    data = on_frame("drop").sel(contents="stocky")
    assert data["uplifted"].any()
    assert not data["contents_uplifted"].any()


def curves(measure="PGA", units="m s-2", missing=False) -> xarray.Dataset:
    medians = np.array([[1.5, 3.25], [2.0, np.nan if missing else 4.0]])
    dims = "contents", "damage_state"
    return xarray.Dataset(
        {
            "median_capacity": (dims, medians, {"units": units}),
            "dispersion": (dims, np.array([[0.25, 0.5], [0.25, 0.5]])),
        },
        coords={
            "contents": ["cabinet", "shelf.tall"],
            "damage_state": [0.5, 1.0],
            "intensity": ("intensity", [1.0], {"units": units}),
        },
        attrs={"kind": "contents-fragility", "measure": measure, "units": units},
    )


def test_table_for_pelicun(tmp_path):
    path = rj.write_pelicun(tmp_path / "damage.csv", curves(missing=True))
    with open(path, newline="") as file:
        cabinet, shelf = csv.DictReader(file)
    head = {"Demand-Type": "Peak Ground Acceleration", "Demand-Unit": "mps2", "Demand-Offset": "0"}
    head |= {"Demand-Directional": "1", "LS1-Family": "lognormal", "LS1-Theta_1": "0.25"}
    second = {"LS2-Family": "lognormal", "LS2-Theta_0": "3.25", "LS2-Theta_1": "0.5"}
    assert cabinet == head | {"ID": "cabinet", "Incomplete": "0", "LS1-Theta_0": "1.5"} | second
    empty = dict.fromkeys(second, "")
    assert shelf == head | {"ID": "shelf.tall", "Incomplete": "1", "LS1-Theta_0": "2.0"} | empty
    assert list(tmp_path.iterdir()) == [path]
    for measure, units, words in (
        ("PGV", "m s-1", ["Peak Ground Velocity", "mps"]),
        ("Sa(0.5 s)", "m s-2", ["Spectral Acceleration|0.5", "mps2"]),
        ("PGA", "g", ["Peak Ground Acceleration", "mps2"]),
        ("PGV", "cm/s", ["Peak Ground Velocity", "mps"]),
    ):
        with open(rj.write_pelicun(path, curves(measure, units)), newline="") as file:
            row = next(csv.DictReader(file))
        assert [row["Demand-Type"], row["Demand-Unit"]] == words
        factor = {"g": 9.80665, "cm/s": 0.01}.get(units, 1.0)
        assert float(row["LS2-Theta_0"]) == pytest.approx(3.25 * factor, rel=1e-14)
    with pytest.raises(ValueError, match="'g' is not a unit of the intensity measure PGV"):
        rj.write_pelicun(path, curves("PGV", "g"))
    with pytest.raises(ValueError, match="intensity measure must be PGA"):
        rj.write_pelicun(path, curves("scale", "1"))
    with pytest.raises(ValueError, match="must come from"):
        rj.write_pelicun(path, xarray.Dataset())


def test_annual_frequency_of_one_curve():
    hazard = rj.Hazard([0.5, 8.0], [1e-2, 1e-4])
    one = curves().sel(contents="cabinet", damage_state=1.0)
    expected = rj.annual_frequency(rj.Lognormal(jnp.asarray(3.25), jnp.asarray(0.5)), hazard).frequency
    np.testing.assert_allclose(rj.annual_frequency(one, hazard).frequency, expected, rtol=1e-12)
    with pytest.raises(ValueError, match="one curve of"):
        rj.annual_frequency(curves(), hazard)


@pytest.mark.filterwarnings("ignore:contents_fragility")
def test_picture_and_file(tmp_path):
    data = on_frame("exceed")
    figure = plots.contents_fragility(data)
    assert [ax.get_title() for ax in figure.axes] == list(BLOCKS)
    data.to_netcdf(tmp_path / "contents.nc")
    again = xarray.load_dataset(tmp_path / "contents.nc")
    xarray.testing.assert_identical(again["median_capacity"], data["median_capacity"])
    from rockjax.plots._from_file import redraw

    assert [path.name for path in redraw(tmp_path / "contents.nc")] == ["contents-contents.png"]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"contents": rj.Oscillator(0.3)}, "contents must be"),
        ({"contents": {1: rj.Contents(0.2, 0.5)}}, "contents must be"),
        ({"contents": ()}, "contents must be"),
        ({"contents": rj.Contents(0.2, np.array([0.5, 1.0]))}, "contents must have scalar parameters"),
        ({"contents": rj.Contents(0.2, 0.5, level=1)}, "level must be"),
        ({"damage_states": (0.5, 0.5)}, "damage_states must be"),
        ({"damage_states": (0.5, 1.5)}, "damage_states must be from 0 to the overturn_ratio 1"),
        ({"overturned": "keep"}, "overturned must be"),
        ({"confidence": 1.0}, "confidence must be"),
        ({"at": 0.0}, "at must be"),
        ({"intensity": [2.0, 1.0]}, "intensity must be"),
        ({"measure": "Sa"}, "measure must be"),
    ],
)  # fmt: skip
def test_bad_input_is_named(changed, words):
    arguments = {"podium": FRAME, "contents": rj.Contents(0.2, 0.5), "records": SUITE, "intensity": LEVELS}
    with pytest.raises(ValueError, match=words):
        rj.contents_fragility(**(arguments | changed))
