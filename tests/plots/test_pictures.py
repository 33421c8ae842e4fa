"""Pictures of boundaries, ensembles and designs: their content, and legends that cover nothing."""

from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray
from matplotlib.collections import PolyCollection

import optimise
import rockjax as rj
from rockjax import plots
from rockjax._responses.datasets import describe_podium
from rockjax._studies.grid_boundaries import with_boundaries
from rockjax.plots import _from_file
from rockjax.plots._panel_layout import grid_of_panels
from rockjax.plots._spectra import dimensional_axes
from tests.scenes import PODIUMS

X = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
NAN = np.nan


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


def spectrum(**attrs) -> xarray.Dataset:
    """Return an overturning spectrum with a jump between 2 and 3, an end after 5, and two windows, of which
    one continues to the next frequency."""
    boundaries = [
        [1.0, 2.0, 2.5],
        [1.1, 2.2, 2.6],
        [2.0, NAN, NAN],
        [2.1, 3.0, NAN],
        [2.2, NAN, NAN],
        [NAN, NAN, NAN],
    ]
    return xarray.Dataset(
        {
            "minimum": ("frequency_ratio", [row[0] for row in boundaries]),
            "boundaries": (("frequency_ratio", "boundary"), boundaries),
        },
        coords={"frequency_ratio": X, "boundary": [1, 2, 3]},
        attrs={
            "kind": "overturning-spectrum",
            "pulse": "Ricker",
            "alpha_rad": 0.15,
            "R_m": 1.5,
            "gamma": 10.0,
            "p_rad_s": 2.2,
            "max_acceleration_ratio": 12.0,
        }
        | attrs,
    )


def texts(figure) -> str:
    found = [ax.get_title() for ax in figure.axes] + [figure.get_suptitle()]
    for legend in [*figure.legends, *(ax.get_legend() for ax in figure.axes)]:
        found += [text.get_text() for text in legend.get_texts()] if legend else []
    return "\n".join(found)


def test_jumps_ends_and_windows_are_drawn_and_named():
    ax = plots.overturning_spectrum(spectrum(), label="rigid")
    assert ax.get_legend_handles_labels()[1] == [
        "rigid",
        "jump to another branch",
        "ends: no overturning beyond,\nup to 12",
        "windows of survival",
    ]
    curve, bridge = ax.lines[0], ax.lines[1]
    assert np.isnan(curve.get_ydata()[2])  # a gap between 2 and 3 …
    np.testing.assert_array_equal(
        bridge.get_xydata(), [[2.0, 1.1], [3.0, 2.0]]
    )  # … with a dotted line across
    (end,) = [line for line in ax.lines if line.get_marker() == "^" and len(line.get_xdata())]
    np.testing.assert_array_equal(end.get_xydata(), [[5.0, 2.2]])
    drawn = next(c for c in ax.collections if isinstance(c, PolyCollection) and c.get_paths())
    corners = [path.vertices[:4].tolist() for path in drawn.get_paths()]
    assert [[1.0, 2.0], [1.0, 2.5], [2.0, 2.6], [2.0, 2.2]] in corners
    assert [[4.0, 3.0], [4.0, 12.0], [3.5, 12.0], [3.5, 3.0]] in corners  # up to the end of the search
    plots.overturning_spectrum(spectrum(), ax, label="again")
    assert ax.get_legend_handles_labels()[1].count("windows of survival") == 1


def test_a_lone_point_of_a_curve_is_marked():
    boundaries = np.full((6, 1), NAN)
    boundaries[2] = 9.8
    data = spectrum().drop_dims("boundary")
    data["boundaries"] = ("frequency_ratio", "boundary"), boundaries
    data["minimum"] = "frequency_ratio", boundaries[:, 0]
    marks = [line for line in plots.overturning_spectrum(data).lines if line.get_marker() == "^"]
    np.testing.assert_array_equal(marks[0].get_xydata(), [[3.0, 9.8]])


def test_a_curve_without_marks_has_no_entries_for_them():
    single = ("frequency_ratio", "boundary"), np.linspace(1.0, 1.5, 6)[:, None]
    complete = (
        spectrum()
        .drop_dims("boundary")
        .assign(boundaries=single, minimum=("frequency_ratio", single[1][:, 0]))
    )
    assert plots.overturning_spectrum(complete, label="one").get_legend_handles_labels()[1] == ["one"]


def test_legends_of_boundaries_are_inside_the_figure():
    figure = _from_file.PICTURES["overturning-spectrum"]["boundaries"].draw(spectrum())
    figure.canvas.draw()
    assert "ends: no overturning" in texts(figure)
    assert figure.legends[0].get_window_extent().x1 <= figure.bbox.x1


@pytest.mark.parametrize("rows", [1, 8])
def test_headings_do_not_overlap_titles_of_panels(rows):
    data = spectrum(pulse="Ricker with vertical ratio 0.5")
    with plt.style.context(plots.STYLE):
        figure, axes, _ = grid_of_panels(rows, 1, 3.0, 2.4, right=1.2, panels=data)
        axes[0, 0].set(title="title", xlim=(1.0, 8.0), ylim=(0.0, 12.0))
        dimensional_axes(data, axes[0, 0])
    figure.canvas.draw()
    assert axes[0, 0].title.get_window_extent().y1 <= figure._suptitle.get_window_extent().y0


@pytest.mark.parametrize("draw", [plots.rocking_spectrum, plots.lift_off_spectrum])
def test_contours_of_a_single_point_are_refused(draw):
    dims = "acceleration_ratio", "frequency_ratio"
    point = xarray.Dataset(
        {
            "peak_rotation": (dims, [[0.5]]),
            "overturned": (dims, [[False]]),
            "least_axial_force": ((*dims, "joint"), [[[1.0]]]),
            "dead_load": ("joint", [1.0]),
        },
        coords={"acceleration_ratio": [3.0], "frequency_ratio": [2.0]},
    )
    with pytest.raises(ValueError, match="at least two frequencies and two accelerations, got 1 and 1"):
        draw(point)


def test_the_colours_of_a_spectrum_include_rotations_above_alpha():
    dims = "acceleration_ratio", "frequency_ratio"
    data = xarray.Dataset(
        {"peak_rotation": (dims, np.full((2, 2), 1.4)), "overturned": (dims, np.zeros((2, 2), bool))},
        coords={"acceleration_ratio": [3.0, 4.0], "frequency_ratio": [2.0, 3.0]},
        attrs={"overturn_ratio": 1.5},
    )
    (contours,) = plots.rocking_spectrum(data).collections
    assert contours.levels[-1] == contours.norm.vmax == 1.5
    assert any(path.vertices.size for path in contours.get_paths())


def test_sensitivities_that_are_zero_need_no_warning(recwarn):
    zero = ("parameter", "frequency_ratio"), np.zeros((1, 6))
    data = spectrum().assign(sensitivity=zero).assign_coords(parameter=["gamma"])
    figure = _from_file.PICTURES["overturning-spectrum"]["sensitivity"].draw(data)
    low, high = figure.axes[0].get_ylim()
    assert low < 0 < high
    assert not recwarn.list


@pytest.mark.parametrize(
    ("attrs", "words"),
    [
        ({"gamma": 0.0}, "solitary block"),
        ({"gamma": 10.0}, "no superstructure"),
        ({"gamma": 0.0, "eta": 5.0}, r"$\gamma = 0$, $\eta = 5$"),
        ({"gamma": 10.0, "eta": 50.0}, r"$\eta/\gamma = 5$"),
    ],
)
def test_panels_name_the_superstructure(attrs, words):
    figure = _from_file.PICTURES["overturning-spectrum"]["boundaries"].draw(spectrum(**attrs))
    assert words in texts(figure)
    assert r"\eta/\gamma = 0$" not in texts(figure)
    assert (r"\gamma = 0$," in figure.get_suptitle()) is (attrs == {"gamma": 0.0, "eta": 5.0})
    figure.canvas.draw()
    (legend,) = figure.legends
    assert not any(legend.get_window_extent().overlaps(ax.get_window_extent()) for ax in figure.axes)


def test_a_title_of_many_lines_covers_nothing():
    """The title names vertical motion, a building and devices, above the panels."""
    devices = rj.Tendon(0.8), rj.Damper(0.4)
    podium = rj.Podium(0.2, 1.5, 3.0, rj.ShearBuilding.uniform(5, 10.0, 0.5), restrainers=devices)
    panels = spectrum(pulse="Ricker with vertical ratio 0.5", **describe_podium(podium))
    figure = _from_file.PICTURES["overturning-spectrum"]["boundaries"].draw(panels)
    figure.canvas.draw()
    lowest = figure._suptitle.get_window_extent().y0
    assert figure.get_suptitle().count("\n") == 3
    assert all(lowest > ax.title.get_window_extent().y1 for ax in figure.axes)


def test_boundaries_of_a_grid_are_narrowed_down():
    podiums = [PODIUMS["frame"], PODIUMS["frame"].replace(gamma=20.0)]
    options = rj.Options(outputs=("peak_rotation",))
    x, y = np.array([0.5, 2.0, 7.5]), np.linspace(1.0, 6.0, 11)
    spectra = rj.rocking_spectra(podiums, rj.Ricker, x, y, options=options)
    for podium, before, found in zip(
        podiums, spectra, with_boundaries(spectra, podiums, rj.Ricker, options=options), strict=True
    ):
        xarray.testing.assert_identical(found.drop_vars(["minimum", "boundaries", "boundary"]), before)
        assert np.isnan(found["minimum"].values[2])
        unit = float(podium.g) * np.tan(float(podium.alpha))
        for k in range(2):
            places = found["boundaries"].values[k]
            places = places[np.isfinite(places)]
            sides = places[:, None] + np.array([-1e-4, 1e-4])
            T_p = 2 * np.pi / (x[k] * float(podium.p))
            overturned = np.asarray(
                rj.peak_responses(podium, rj.Ricker(sides * unit, T_p), options=options).overturned
            )
            assert overturned[::2].tolist() == [[False, True]] * len(overturned[::2])
            assert overturned[1::2].tolist() == [[True, False]] * len(overturned[1::2])
            assert found["minimum"].values[k] == places[0]


def test_a_grid_that_overturns_from_its_lowest_row_begins_there():
    options = rj.Options(outputs=("peak_rotation",))
    (data,) = rj.rocking_spectra([PODIUMS["frame"]], rj.Ricker, [1.0], [6.0, 8.0], options=options)
    assert data["overturned"].values.all()
    (found,) = with_boundaries([data], [PODIUMS["frame"]], rj.Ricker, options=options)
    assert found["minimum"].values.tolist() == [6.0]


def analysis() -> tuple[xarray.Dataset, xarray.Dataset]:
    levels = np.array([1.0, 2.0, 3.0])
    of = {"units": "m s-2", "long_name": "PGA"}
    boundaries = np.array([[1.5, 2.5], [2.2, NAN]])
    complete = xarray.Dataset(
        {
            "peak_rotation": (("record", "intensity"), np.array([[0.2, 1.0, 0.6], [0.1, 0.5, 1.0]])),
            "overturned": (("record", "intensity"), np.array([[False, True, False], [False, False, True]])),
            "boundaries": (("record", "boundary"), boundaries),
            "capacity": ("record", boundaries[:, 0]),
        },
        coords={"intensity": ("intensity", levels, of), "record": ["a", "b"]},
        attrs={"measure": "PGA", "overturn_ratio": 1.0},
    )
    at = np.linspace(0.1, 3.0, 9)
    curve = xarray.Dataset(
        {
            "probability": ("at", at / 3),
            "lower": ("at", at / 4),
            "upper": ("at", np.minimum(1, at / 2.5)),
            "observed": ("intensity", [0.0, 0.5, 0.5]),
            "median_capacity": 1.8,
            "dispersion": 0.3,
            "capacity": ("record", boundaries[:, 0]),
        },
        coords={"at": ("at", at, of), "intensity": ("intensity", levels, of)},
        attrs={"measure": "PGA", "confidence": 0.9},
    )
    return complete, curve


def legend_is_clear_of(ax) -> bool:
    ax.figure.canvas.draw()
    return not ax.get_legend().get_window_extent().overlaps(ax.get_window_extent())


def test_a_fragility_names_its_band_and_says_why_stripes_lie_under_it():
    _, curve = analysis()
    ax = plots.fragility(curve)
    assert legend_is_clear_of(ax)
    shown = texts(ax.figure)
    assert "90% band" in shown
    assert "records survive again" in shown
    plots.fragility(curve, ax, label="other", colour="red")
    assert texts(ax.figure).count("records survive again") == 1
    assert texts(ax.figure).count("90% band") == 2
    never = curve.assign(observed=("intensity", [0.0, 0.5, 1.0]))
    assert "survive again" not in texts(plots.fragility(never).figure)


@pytest.mark.parametrize(
    ("attrs", "label"),
    [
        ({}, "probability of overturning"),
        ({"overturn_ratio": 0.4}, "probability of |θ|/α ≥ 0.4"),
        ({"limit_state": "peak_friction > 0.3"}, "probability of overturning\nor peak_friction > 0.3"),
    ],
)
def test_a_fragility_names_its_limit_state(attrs, label):
    _, curve = analysis()
    ax = plots.fragility(curve.assign_attrs(attrs))
    assert ax.get_ylabel() == label
    assert ("first failure of the records" in texts(ax.figure)) == bool(attrs)


def test_a_risk_states_the_share_from_beyond_the_hazard_curve():
    hazard = rj.Hazard([1.0, 3.0, 6.0], [0.02, 0.002, 0.0004], measure="PGA", units="m s-2")
    data = rj.disaggregation(rj.Lognormal(8.0, 0.4), hazard)
    share = data.attrs["extrapolated"]
    assert share > 0.5
    title = plots.risk(data).axes[2].get_title(loc="left")
    assert f"{share:.0%} of it from beyond the given points" in title


@pytest.mark.parametrize(
    ("ratios", "labels"),
    [
        ([1.0, 1.0], ["rocks", r"$|\varphi|$ reaches 0.5 $\alpha_c$", "overturns"]),
        ([1.0, 1.5], ["rocks", r"$|\varphi|$ reaches 0.5 $\alpha_c$", r"$|\varphi|$ reaches $\alpha_c$"]),
        ([0.5, 0.5], ["rocks", "overturns"]),
    ],
)
def test_damage_states_are_called_overturning_where_every_block_overturns(ratios, labels):
    _, curve = analysis()
    curve = curve.drop_vars(["capacity", "lower", "upper"])
    data = curve.expand_dims(contents=["a", "b"], damage_state=[0.0, 0.5, 1.0][: len(labels)])
    data.coords["contents_overturn_ratio"] = "contents", ratios
    (legend,) = plots.contents_fragility(data).legends
    assert [text.get_text() for text in legend.get_texts()] == labels


def test_an_incremental_dynamic_analysis_has_nothing_beyond_the_limit_state():
    complete, _ = analysis()
    ax = plots.incremental_dynamic_analysis(complete)
    assert max(np.nanmax(line.get_xdata()) for line in ax.lines) == 1.0
    assert ax.get_xlim() == (0.0, 1.0)
    assert "survival windows" in texts(ax.figure)
    assert legend_is_clear_of(ax)


def test_convergence_has_units_and_tells_starts_apart():
    row = lambda start, iteration, objective, margin: SimpleNamespace(
        start=start, iteration=iteration, objective=objective, margin=margin
    )

    def design(minimised: str) -> optimise.Design:
        return optimise.Design(
            podium=PODIUMS["rigid"],
            structure=PODIUMS["rigid"],
            variables={"width": 0.26},
            objective=0.26,
            satisfied=True,
            margins={},
            multipliers={},
            result=optimise.RESULTS.converged,
            history=tuple(row(s, i, 0.3 - 0.01 * i * (s + 1), i - 1.0) for s in range(3) for i in range(3)),
            stats=None,  # pyright: ignore[reportArgumentType]
            starts=(None, None, None),  # pyright: ignore[reportArgumentType]
            best=1,
            bounds={"width": (0.1, 1.0)},
            units={"width": "m"},
            minimised=minimised,
        )

    ax = optimise.convergence(design("width"))
    assert ax.get_ylabel() == "width [m]"
    labels = texts(ax.figure).strip().splitlines()
    assert labels[:3] == ["start 1, the design", "start 0", "start 2"]
    entries = ax.get_legend().legend_handles[:3]
    assert len({(line.get_color(), line.get_linestyle(), line.get_marker()) for line in entries}) == 3
    assert entries[0].get_color() == plots.COLOURS[0]
    assert legend_is_clear_of(ax)
    assert optimise.convergence(design("alpha")).get_ylabel() == "alpha [rad]"
