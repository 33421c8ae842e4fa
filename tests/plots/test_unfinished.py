"""Plots of made-up datasets with scenes that did not finish, whose peaks are zero or partial."""

from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray
from matplotlib.collections import PolyCollection
from matplotlib.contour import ContourSet

import rockjax as rj
from rockjax import _results as results
from rockjax import plots
from rockjax._responses.datasets import describe_podium
from rockjax._results import END_OF_TIME, OUT_OF_STEPS, OVERTURNED, WEIGHTLESS
from rockjax._studies import grid_boundaries
from rockjax.plots import _from_file
from tests.scenes import PODIUMS


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


def spectrum() -> xarray.Dataset:
    """Return a spectrum of which the highest two rows are weightless and one corner overturns."""
    x, y = np.linspace(1.0, 8.0, 8), np.linspace(1.0, 12.0, 6)
    result = np.full((y.size, x.size), END_OF_TIME)
    result[2:4, :2], result[4:] = OVERTURNED, WEIGHTLESS
    dims = "acceleration_ratio", "frequency_ratio"
    peaks = np.where(result == WEIGHTLESS, 0.0, 0.05 * y[:, None] + 0 * x)
    return xarray.Dataset(
        {
            "peak_rotation": (dims, peaks),
            "peak_rotation_sensitivity": ((*dims, "parameter"), peaks[..., None]),
            "least_axial_force": ((*dims, "joint"), 11 - 40 * peaks[..., None]),
            "overturned": (dims, result == OVERTURNED),
            "result": (dims, result),
        },
        coords={
            "frequency_ratio": x,
            "acceleration_ratio": y,
            "parameter": ["alpha"],
            "dead_load": ("joint", [10.0]),
        },
        attrs={"kind": "rocking-spectrum", "pulse": "Ricker with vertical ratio 0.7", "p_rad_s": 2.2}
        | describe_podium(PODIUMS["frame"]),
    )


@pytest.mark.parametrize("name", ["rotation", "sensitivity", "lift-off"])
def test_spectra_hatch_scenes_that_did_not_finish(name):
    figure = _from_file.PICTURES["rocking-spectrum"][name].draw(spectrum())
    ax = figure.axes[0]
    (hatched,) = (y for y in ax.collections if y.get_hatch())
    cells = np.ma.getmaskarray(hatched.get_array())
    np.testing.assert_array_equal(~cells, spectrum()["result"].values == WEIGHTLESS)
    for drawn in ax.collections:
        if isinstance(drawn, ContourSet):
            assert all(path.vertices[:, 1].max(initial=0.0) <= 7.7 for path in drawn.get_paths())
        elif drawn is not hatched:
            assert np.ma.getmaskarray(drawn.get_array())[4:].all()
    assert ax.texts[0].get_text() == "overturned\nhatched: did not finish"


def test_the_curves_of_records_end_at_scenes_that_did_not_finish():
    dims, result = ("record", "intensity"), np.array([[END_OF_TIME, WEIGHTLESS], [END_OF_TIME, OVERTURNED]])
    analysis = xarray.Dataset(
        {
            "peak_rotation": (dims, [[0.3, 0.0], [0.4, 1.0]]),
            "overturned": (dims, result == OVERTURNED),
            "result": (dims, result),
            "boundaries": (("record", "boundary"), [[np.nan], [1.5]]),
        },
        coords={"intensity": ("intensity", [1.0, 2.0], {"units": "m s-2"})},
        attrs={"measure": "PGA", "overturn_ratio": 1.0},
    )
    ax = plots.incremental_dynamic_analysis(analysis)
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), [0.0, 0.3, np.nan])
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels[-1] == "left out: 1 of 4 scenes, which did not finish"


def test_peaks_of_scenes_that_did_not_finish_are_crosses():
    result = np.array([END_OF_TIME, OVERTURNED, WEIGHTLESS, OUT_OF_STEPS, END_OF_TIME])
    data = xarray.Dataset(
        {
            "peak_rotation": ("motion", [0.4, 1.0, 0.0, 0.9, 0.6]),
            "overturned": ("motion", result == OVERTURNED),
            "result": ("motion", result),
        },
        coords={"motion": list("abcde")},
    )
    (ax,) = plots.peaks(data).axes
    drawn = {line.get_label(): line for line in ax.lines}
    np.testing.assert_array_equal(drawn["did not finish"].get_ydata(), [2, 3])
    np.testing.assert_array_equal(drawn["until overturning"].get_xydata(), [[1.0, 1]])
    np.testing.assert_array_equal(ax.lines[0].get_xydata(), [[0.4, 0], [0.6, 4]])
    assert ax.lines[-1].get_xdata() == [0.5, 0.5]  # the median
    numbers = data.drop_vars("peak_rotation").assign(impacts=("motion", np.arange(5.0)))
    with pytest.raises(ValueError, match="has no peaks to draw"):
        plots.peaks(numbers)


def test_boundaries_of_a_grid_lie_between_scenes_that_finished(monkeypatch):
    overturns = lambda ratio: ratio > 4.0
    monkeypatch.setattr(grid_boundaries, "_outcome_function", lambda *_: overturns)
    data, podium = spectrum(), PODIUMS["frame"]
    data["result"][0, 5] = OUT_OF_STEPS
    data["overturned"][1, 5] = True
    (found,) = grid_boundaries.with_boundaries([data], [podium], None, options=None)
    np.testing.assert_allclose(found["boundaries"][:2], [[4.0, np.nan]] * 2, atol=1e-3)
    # The lowest scene that finished overturns; the next survives, at 5.4.
    assert found["minimum"][5] == found["acceleration_ratio"][1] == 3.2
    assert np.isnan(found["minimum"].values[[2, 3, 4, 6, 7]]).all()
    assert found.sizes["boundary"] == 2


def test_scenes_of_a_bisection_that_did_not_finish_cause_a_warning(monkeypatch):
    codes = np.array([0, OUT_OF_STEPS])
    peaks = SimpleNamespace(result=results.result_of(codes), overturned=codes == 2)
    monkeypatch.setattr(grid_boundaries, "responses", lambda *_: peaks)
    index = np.zeros(2, int)
    overturns = grid_boundaries._outcome_function(
        [PODIUMS["frame"]], [spectrum()], rj.Ricker, index, index, rj.Options(), False
    )
    with pytest.warns(RuntimeWarning, match="1 of 2 scenes did not finish"):
        assert not overturns(np.array([3.0, 4.0])).any()


def test_windows_of_survival_end_at_scenes_that_did_not_finish():
    data = spectrum()
    nothing = np.full(6, np.nan)
    boundaries = np.stack([[4.0, 4.0, *nothing], [6.0, 6.0, *nothing]], axis=-1)
    data = data.assign(
        boundaries=(("frequency_ratio", "boundary"), boundaries),
        minimum=("frequency_ratio", boundaries[:, 0]),
    )
    ax = plots.overturning_curve(data)
    (windows,) = (y for y in ax.collections if isinstance(y, PolyCollection) and y.get_paths())
    assert max(path.vertices[:, 1].max() for path in windows.get_paths()) == pytest.approx(7.6)
    assert "ends: no overturning beyond,\nup to 7.6" in ax.get_legend_handles_labels()[1]


def floor_spectra() -> xarray.Dataset:
    """Return spectra of five motions, of which the last overturns and the one before is weightless."""
    result = np.array([END_OF_TIME, END_OF_TIME, END_OF_TIME, WEIGHTLESS, OVERTURNED])
    peaks, dims = np.array([1.0, 2.0, 3.0, 40.0, 50.0]), ("motion", "level", "damping", "period")
    return xarray.Dataset(
        {
            "pseudo_acceleration": (dims, peaks[:, None, None, None] * np.array([1.0, 2.0, 1.5, 0.5])),
            "peak_acceleration": (("motion", "level"), peaks[:, None]),
            "peak_velocity_jump": (("motion", "level"), np.where(result == OVERTURNED, 0.3, 0.0)[:, None]),
            "overturned": ("motion", result == OVERTURNED),
            "result": ("motion", result),
        },
        coords={"level": ["1"], "damping": [0.05], "period": np.geomspace(0.1, 2.0, 4)},
        attrs={"g_m_s2": 10.0},
    )


def test_the_mark_of_the_peak_acceleration_leaves_out_the_motions_that_the_curves_leave_out():
    (ax,) = plots.floor_spectrum(floor_spectra()).axes
    *curves, median, mark = ax.lines
    assert len(curves) == 3
    np.testing.assert_allclose(median.get_ydata(), [0.2, 0.4, 0.3, 0.1])
    np.testing.assert_allclose(mark.get_ydata(), 0.2)
    (ax,) = plots.floor_spectrum(floor_spectra()[{"motion": [3, 4]}]).axes
    (nothing,) = ax.lines
    assert nothing.get_label() == "podium: no motion survives"
    ax.figure.canvas.draw()


@pytest.mark.parametrize(
    ("motion", "label"), [(0, "podium"), (3, "podium, did not finish"), (4, "podium, until overturning")]
)
def test_floor_spectra_of_one_motion_name_its_outcome(motion, label):
    (ax,) = plots.floor_spectrum(floor_spectra()[{"motion": motion}]).axes
    assert ax.lines[0].get_label() == label
