"""Pictures and data of histories: they are drawn and show correct values."""

import itertools
import math
import sys

import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray
from PIL import Image
from typer.testing import CliRunner

import rockjax as rj
from rockjax import plots
from rockjax._cli import app
from rockjax._engine import model
from rockjax._engine.coefficients import coefficients
from rockjax._engine.energy import energy, potential
from rockjax._parameters.registry import MOTION, STRUCTURE
from rockjax._responses.datasets import describe_podium, podium_of
from rockjax.plots import _from_file
from rockjax.plots._panel_layout import panels_title
from rockjax.plots._style import symbol_for
from tests.scenes import PODIUMS, G, pulse, shaking

AXES = (
    "rotation_history",
    "deformation_history",
    "ground_motion",
    "phase_portrait",
    "moment_rotation",
    "energy_balance",
)


@pytest.fixture(scope="module")
def responses():
    """Return responses: rigid and elastic podiums that rock, one without a superstructure that overturns, one
    that never lifts."""
    return {
        "rigid": rj.simulate(PODIUMS["rigid"], pulse()),
        "record": rj.simulate(PODIUMS["rigid"], shaking()),
        "elastic": rj.simulate(PODIUMS["elastic"], pulse(), t_end=6.0),
        "overturned": rj.simulate(PODIUMS["frame"], rj.Ricker(6.0, 1.5)),
        "still": rj.simulate(PODIUMS["rigid"], pulse(ratio=0.5)),
    }


@pytest.fixture(scope="module")
def histories(responses):
    return {name: response.dataset() for name, response in responses.items()}


@pytest.fixture(autouse=True)
def _close():
    yield
    plots.plt.close("all")


KINDS = ("rigid", "record", "elastic", "overturned", "still")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", AXES)
def test_every_picture_of_every_scene_is_drawn(histories, kind, name):
    before = dict(matplotlib.rcParams)
    ax = getattr(plots, name)(histories[kind])
    assert ax.get_xlabel()
    assert ax.get_ylabel()
    assert dict(matplotlib.rcParams) == before
    ax.figure.canvas.draw()
    given = plots.plt.figure().add_subplot()
    assert getattr(plots, name)(histories[kind], ax=given) is given


def test_scenes_match_their_names(responses):
    assert bool(responses["overturned"].overturned)
    assert not bool(responses["still"].uplifted)
    assert int(responses["elastic"].impacts) > 3


def test_labels_are_those_of_the_field(histories):
    data = histories["elastic"]
    for name, x, y in (
        ("rotation_history", "time [s]", plots.ROTATION),
        ("deformation_history", "time [s]", "[mm]"),
        ("ground_motion", "time [s]", "[g]"),
        ("phase_portrait", plots.ROTATION, r"\dot\theta"),
        ("moment_rotation", plots.ROTATION, "M_r"),
        ("energy_balance", "time [s]", r"P(\alpha)"),
    ):
        ax = getattr(plots, name)(data)
        assert x in ax.get_xlabel()
        assert y in ax.get_ylabel()
    figure = plots.response(histories["overturned"])
    assert len(figure.axes) == 2
    assert "overturns at t =" in figure.axes[0].get_title()
    assert len(plots.response(data).axes) == 3


def line(ax, label):
    (found,) = (line for line in ax.lines if str(line.get_label()).startswith(label))
    return found.get_xdata(), found.get_ydata()


@pytest.mark.parametrize("kind", ["rigid", "elastic"])
def test_curves_hold_the_numbers(responses, histories, kind):
    response, data = responses[kind], histories[kind]
    alpha, p = float(response.podium.alpha), float(response.podium.p)
    ax = plots.rotation_history(data)
    np.testing.assert_allclose(
        ax.lines[1].get_ydata(), np.asarray(response(data["time"].values).theta) / alpha, atol=1e-12
    )
    x, y = line(ax, "peak")
    assert abs(y[0]) == pytest.approx(float(response.peak_rotation))
    assert y[0] * alpha == pytest.approx(float(response(x[0]).theta), abs=1e-9)
    x, _ = line(ax, f"{int(response.impacts)} impacts")
    np.testing.assert_array_equal(x, response.impact_times)
    # The jumps of the phase portrait have the restitution factor.
    _, jumps = line(plots.phase_portrait(data), f"{int(response.impacts)} impacts")
    e = float(response.podium.restitution_factor)
    first = jumps.reshape(-1, 3)[:5]
    np.testing.assert_allclose(first[:, 1], e * first[:, 0], rtol=1e-9)
    before = np.asarray(response(response.impact_times[:5], left=True).theta_dot)
    np.testing.assert_allclose(first[:, 0], before / (p * alpha), rtol=1e-12)


def test_symbols_of_formulas_are_those_of_the_table():
    assert symbol_for("structure.alpha") == "α" == STRUCTURE["alpha"].symbol
    assert symbol_for("tan_alpha") == r"\tan α"
    assert symbol_for("superstructure.T_s") == "T_s"
    assert symbol_for("vertical_ratio") == r"\ddot{v}_g/\ddot{u}_g"
    assert symbol_for("restrainers.of_my_own") == "of_my_own"
    figure = plt.figure()
    for name in (*STRUCTURE, *MOTION):
        figure.text(0.5, 0.5, f"${symbol_for(name)}$")
    figure.canvas.draw()  # matplotlib parses each text


@pytest.mark.parametrize("kind", KINDS)
def test_time_axes_end_soon_after_the_last_impact(responses, histories, kind):
    response, data = responses[kind], histories[kind]
    start, end = data["time"].values[[0, -1]]
    if int(response.impacts):
        last = float(response.impact_times[-1])
        end = min(end, start + 1.2 * (last - start))
        assert last <= end
    for name in ("rotation_history", "deformation_history", "ground_motion", "energy_balance"):
        assert getattr(plots, name)(data).get_xlim() == pytest.approx((start, end))
    assert plots.response(response).axes[-1].get_xlim() == pytest.approx((start, end))


def test_time_axes_show_peaks_after_the_last_impact(histories):
    data = histories["elastic"].isel(impact=slice(1))
    assert data["impact_times"].values[0] < float(data["peak_rotation_time"])
    assert plots.rotation_history(data).get_xlim()[1] >= float(data["peak_rotation_time"])
    data["overturn_time"] = float(data["time"][-1])
    assert plots.rotation_history(data).get_xlim()[1] == float(data["time"][-1])


@pytest.mark.parametrize("count", [2, 6, 8, 14, 30])
def test_every_story_is_in_the_legend(histories, count):
    """Each story has a distinct curve; the legend is beside the axes and inside the figure."""
    data = histories["elastic"]
    drift = np.outer(data["deformation"], np.linspace(1.0, 0.5, count))
    ax = plots.deformation_history(data.assign(drift=(("time", "story"), drift)))
    legend = ax.get_legend()
    assert [text.get_text() for text in legend.get_texts()] == [str(k + 1) for k in range(count)]
    assert legend.get_title().get_text() == "story"
    looks = {(line.get_color(), line.get_linestyle()) for line in ax.lines[1:]}
    assert len(looks) == count
    ax.figure.canvas.draw()
    box = legend.get_window_extent()
    assert ax.get_window_extent().x1 <= box.x0
    assert box.x1 <= ax.figure.bbox.x1
    assert ax.figure.bbox.y0 <= box.y0
    assert box.y1 <= ax.figure.bbox.y1


@pytest.mark.parametrize(
    ("median", "dispersion", "scale"),
    [(3.5, 0.05, 1.0), (0.003, 0.2, 1e-3), (4.0, 0.45, 1.0), (0.7, 0.02, 0.2), (350.0, 0.1, 100.0)],
)
def test_tick_labels_of_the_risk_picture_do_not_overlap(median, dispersion, scale):
    hazard = rj.Hazard(scale * np.geomspace(0.2, 16.0, 7), np.geomspace(0.11, 1e-5, 7))
    figure = plots.risk(rj.disaggregation(rj.Lognormal(median, dispersion), hazard))
    figure.canvas.draw()
    axis = figure.axes[-1].xaxis
    labels = [label for label in axis.get_ticklabels(which="both") if label.get_text()]
    low, high = axis.get_view_interval()
    boxes = sorted(
        (label.get_window_extent() for label in labels if low <= label.get_position()[0] <= high),
        key=lambda box: box.x0,
    )
    assert len(boxes) >= 2
    assert all(one.x1 < other.x0 for one, other in itertools.pairwise(boxes))


def test_the_picture_of_a_design_point():
    block = rj.Podium(0.2, 1.0)
    point = rj.DesignPoint(np.zeros(3), 2.5, shaking(), 1, False, {"alpha": 3.0})
    figure = plots.design_point(point, block)
    title = figure.get_suptitle()
    assert all(words in title for words in ("2.50", "1 impact,", "edge"))
    assert [ax.get_ylabel() for ax in figure.axes] == [plots.ROTATION, r"$\ddot u_g$ [g]"]


def test_saddles_and_separatrices():
    """θ = ±α is an unstable equilibrium, and motion along a separatrix comes to rest there."""
    podium = PODIUMS["rigid"]
    c = coefficients(podium)
    for sigma in (1.0, -1.0):
        at = lambda theta, sigma=sigma: model.acceleration(
            c, jnp.asarray(sigma), jnp.zeros(()), (theta,), (jnp.zeros(()),)
        )[0]
        value, slope = jax.value_and_grad(at)(sigma * c.alpha)
        assert float(value) == pytest.approx(0, abs=1e-12)
        assert float(slope) > 0
    top = float(potential(c, jnp.ones(()), c.alpha))
    theta = np.array([-0.6, 0.2, 1.1]) * float(podium.alpha)
    rates = plots._histories.separatrix(xarray.Dataset(attrs=describe_podium(podium)), theta)
    for x, rate in zip(theta, rates, strict=True):
        held = energy(c, jnp.sign(jnp.asarray(x)), (jnp.asarray(x),), (jnp.asarray(rate),))
        assert float(held) == pytest.approx(top, rel=1e-12)
    # Eq. (24) for a block without ground motion: θ̇² = (3g/2R)(1 − cos ψ).
    block = xarray.Dataset(attrs=describe_podium(PODIUMS["block"]))
    rate = plots._histories.separatrix(block, np.array([0.1]))[0]
    assert rate == pytest.approx(math.sqrt(1.5 * G / 2.0 * (1 - math.cos(0.2))))


def test_restoring_moment(responses, histories):
    """The moment agrees with virtual work of each mass and is continuous at uplift."""
    response = responses["elastic"]
    podium = response.podium
    alpha, R, g, gamma, eta = (float(y) for y in (podium.alpha, podium.R, podium.g, podium.gamma, podium.eta))
    t, h = np.linspace(0.1, 1.5, 7), 1e-4
    assert np.all(np.asarray(response.mode(t)) != 0)

    def beam_height(t):
        theta, sigma = np.asarray(response(t).theta), np.asarray(response.mode(t))
        return 2 * R * np.cos(sigma * alpha - theta)

    rises = (beam_height(t + h) - 2 * beam_height(t) + beam_height(t - h)) / h**2
    psi = np.asarray(response.mode(t)) * alpha - np.asarray(response(t).theta)
    above = (gamma + eta) * (g + rises) * 2 * R * np.sin(psi)
    columns = (g + rises / 2) * R * np.sin(psi)
    uplift = (gamma + eta + 0.5) * g * 2 * R * np.sin(alpha)
    np.testing.assert_allclose(response.restoring_moment(t), (above + columns) / uplift, rtol=1e-4)
    start = float(response.uplift_time)
    here, there = (float(response.restoring_moment(start + d)) for d in (-1e-7, 1e-7))
    assert abs(here) == pytest.approx(1, abs=1e-4)
    assert there == pytest.approx(here, abs=1e-4)
    # In full contact the moment balances the demand, in every piece of a record.
    data = histories["record"]
    down = data["mode"].values == 0
    asked = -data["ground_acceleration"].values / (G * 0.15)
    assert down.sum() > 100
    np.testing.assert_allclose(data["restoring_moment"].values[down], asked[down], atol=1e-9)
    assert np.max(np.abs(asked[down])) <= 1 + 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_energy_balance_closes(responses, histories, kind):
    response, data = responses[kind], histories[kind]
    given, held, struck, damped = (
        data[f"{name}_energy"].values for name in ("input", "mechanical", "impact", "damping")
    )
    scale = np.max(np.abs(given)) + 1e-300
    assert np.max(np.abs(float(data["initial_energy"]) + given - held - struck - damped)) <= 1e-7 * scale
    assert np.all(np.diff(struck) >= -1e-12 * scale)
    assert np.all(np.diff(damped) >= -1e-12 * scale)
    # The loss at an impact by Eqs. (18), (27): rotation, and vertical motion of the top mass.
    c = coefficients(response.podium)
    weight = 0.5 * float(c.spin) + 0.5 * float(c.eta) * float(c.two_R * c.sin_alpha) ** 2
    losses = (1 - float(c.restitution) ** 2) * weight * data["theta_dot_before"].values ** 2
    assert struck[-1] == pytest.approx(np.sum(losses), rel=1e-5)
    ends = np.searchsorted(data["time"].values, data["impact_times"].values[:3])
    np.testing.assert_allclose(struck[ends], np.cumsum(losses[:3]), rtol=1e-6)


def test_energies_at_any_times(responses):
    response = responses["elastic"]
    t = np.linspace(-1.0, 5.0, 12).reshape(3, 4)
    energies = response.energies(t)
    assert energies.residual.shape == (3, 4)
    np.testing.assert_allclose(energies.mechanical, response.energy(t), rtol=1e-9)
    assert np.isnan(float(response.energies(np.array([-90.0])).input[0]))


def test_energy_balance_from_an_initial_state():
    """In free rocking, impacts dissipate the initial energy."""
    response = rj.simulate(PODIUMS["frame"], rj.Ricker(0.0, 1.5), initial=rj.State(0.1))
    data = response.dataset()
    start = float(data["initial_energy"])
    assert start == pytest.approx(float(potential(coefficients(response.podium), 1.0, jnp.asarray(0.1))))
    np.testing.assert_allclose(data["mechanical_energy"] + data["impact_energy"], start, rtol=1e-7)
    assert float(data["impact_energy"][-1]) == pytest.approx(start, rel=1e-6)


@pytest.mark.slow
def test_states_are_differentiable():
    at = lambda alpha: rj.simulate(PODIUMS["rigid"].replace(alpha=alpha), pulse())(0.9).theta
    alpha = float(PODIUMS["rigid"].alpha)
    difference = (float(at(alpha + 1e-6)) - float(at(alpha - 1e-6))) / 2e-6
    assert float(jax.jacfwd(at)(alpha)) == pytest.approx(difference, rel=1e-4)


def test_history_survives_a_file(responses, histories, tmp_path):
    data = histories["elastic"]
    data.to_netcdf(tmp_path / "r.nc", engine="netcdf4")
    back = xarray.load_dataset(tmp_path / "r.nc")
    xarray.testing.assert_identical(back.drop_attrs(), data.drop_attrs())
    response = responses["elastic"]
    assert repr(podium_of(back.attrs)) == repr(response.podium)
    assert all("units" in data[name].attrs and "long_name" in data[name].attrs for name in data.variables)
    assert back.attrs["kind"] == "response"
    assert back.attrs["a_p_m_s2"] == float(response.excitation.a_p)
    assert float(back["peak_rotation"]) == float(response.peak_rotation)
    some = response.dataset([0.0, 0.5])
    np.testing.assert_allclose(some["theta"], response(np.array([0.0, 0.5])).theta)
    with pytest.raises(ValueError, match=r"1-D array of times, got shape \(\)"):
        response.dataset(0.5)


def test_peaks_as_data_and_as_text():
    motions = rj.Ricker(np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), 1.0)
    peaks = rj.peak_responses(PODIUMS["rigid"], motions)
    data = peaks.dataset()
    assert data["peak_rotation"].dims == ("scene_0", "scene_1")
    np.testing.assert_array_equal(data["peak_rotation"], peaks.peak_rotation)
    assert "6 scenes" in peaks._repr_html_()
    one = jax.tree.map(lambda y: y[1, 0], peaks)
    assert one.dataset()["peak_rotation"].dims == ()
    assert f"{float(one.peak_rotation):.6g} α" in one._repr_html_()
    assert "<table>" in one._repr_html_()


def test_structures_and_motions_are_readable():
    assert repr(rj.Ricker(3.7, 1.0)) == "Ricker(a_p=3.7, T_p=1)"
    assert repr(rj.Rest()) == "Rest()"
    assert "superstructure=Elastic(eta=100, T_s=0.5, zeta=0.05)" in repr(PODIUMS["elastic"])
    assert "restitution=0.9" in repr(PODIUMS["block"].replace(restitution=0.9))
    assert "shape (400,)" in repr(shaking())
    seen = []
    jax.jit(lambda a: seen.append(repr(rj.Ricker(a, 1.0))) or a)(2.0)
    assert seen == ["Ricker(a_p=traced, T_p=1)"]


def test_film_has_its_frames_and_moves_as_the_podium(responses, histories, tmp_path):
    data = histories["elastic"]
    path = plots.save_animation(
        tmp_path / "a.gif", data, start=0.0, end=0.4, fps=10, dpi=40, exaggerate=2.0, columns=3
    )
    with Image.open(path) as picture:
        assert picture.n_frames == 5
        assert picture.info["duration"] == 100
    film = plots.animation(responses["rigid"], start=0.0, end=0.2, fps=10, moving_ground=True, speed=0.5)
    assert film.figure.axes[0].texts[0].get_text() == "to scale\n0.5 × real time"
    assert film._repr_html_().count("data:image/png") == 5  # 0, 0.05, … s
    assert not plots.plt.get_fignums()
    assert list(tmp_path.iterdir()) == [path]


def test_film_is_drawn_to_scale(histories):
    data = histories["rigid"]
    times = np.array([0.3, 0.9])
    stage = plots._animation._Stage(data, times, 2, 1.0, 1.0, False)
    podium = PODIUMS["rigid"]
    c = coefficients(podium)
    for k, t in enumerate(times):
        stage.show(k)
        theta = jnp.interp(t, data["time"].values, data["theta"].values)
        column, beam = stage.columns[0].get_xy(), stage.beam.get_xy()
        np.testing.assert_allclose(np.linalg.norm(column[1] - column[0]), float(podium.width))
        np.testing.assert_allclose(np.linalg.norm(column[2] - column[1]), float(podium.height))
        assert column[:, 1].min() == pytest.approx(0, abs=1e-12)
        assert column[:, 1].max() == pytest.approx(beam[:, 1].min())
        moved = float(model.beam(c, jnp.sign(theta), theta, jnp.zeros(()))[0])
        assert beam[:4, 0].mean() == pytest.approx(moved, abs=1e-12)


def test_film_of_a_building_has_its_floors(histories):
    """The positions of floors are the sums of the drifts, at the heights of the stories."""
    data = histories["elastic"]
    drift = np.stack([data["deformation"].values, 0.5 * data["deformation"].values], axis=1)
    building = rj.ShearBuilding([1.0, 1.0], [100.0, 100.0], heights=[3.0, 2.0])
    attributes = describe_podium(PODIUMS["elastic"].replace(superstructure=building))
    data = data.assign(drift=(("time", "story"), drift)).assign_attrs(attributes)
    times = np.array([0.3, 0.9])
    stage = plots._animation._Stage(data, times, 2, 2.0, 1.0, False)
    for k, t in enumerate(times):
        stage.show(k)
        sways = [2.0 * np.interp(t, data["time"], y) for y in drift.cumsum(axis=1).T]
        beam = stage.beam.get_xy()
        for slab, sway, level in zip(stage.slabs, sways, (3.0, 5.0), strict=True):
            corners = slab.get_xy()
            assert corners[:4, 0].mean() - beam[:4, 0].mean() == pytest.approx(sway)
            assert corners[:, 1].max() - beam[:, 1].max() == pytest.approx(level)
        for lines, slab in zip(stage.column_lines, stage.slabs, strict=True):
            assert lines[0].get_ydata()[-1] == pytest.approx(slab.get_xy()[:, 1].min())


def test_invalid_animations_name_the_reason(histories, tmp_path, monkeypatch):
    data = histories["rigid"]
    for change, words in (
        ({"columns": 0}, "columns must be a whole number ≥ 1"),
        ({"exaggerate": -1.0}, "exaggerate must be finite and > 0"),
        ({"start": 3.0, "end": 2.0}, "start and end must satisfy .* <= start < end <= .* s"),
    ):
        with pytest.raises(ValueError, match=words):
            plots.animation(data, **change)
    with pytest.raises(ValueError, match=r"must end in \.gif or \.mp4, got 'a\.avi'"):
        plots.save_animation(tmp_path / "a.avi", data)
    monkeypatch.setattr(plots._animation.FFMpegWriter, "isAvailable", lambda: False)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(RuntimeError, match=r"needs ffmpeg.*pip install imageio-ffmpeg"):
        plots.save_animation(tmp_path / "a.mp4", data)
    with pytest.raises(ValueError, match="kind = 'response'"):
        plots.phase_portrait(xarray.Dataset())
    assert not list(tmp_path.iterdir())


RUN = CliRunner()


def test_plot_draws_every_file_again(histories, tmp_path):
    x, y = np.linspace(2, 4, 3), np.linspace(1, 8, 4)
    spectrum = rj.rocking_spectrum(PODIUMS["rigid"], rj.Ricker, x, y)
    boundaries = xarray.Dataset(
        {
            "minimum": ("frequency_ratio", [2.0, 3.0, 4.0]),
            "boundaries": (("frequency_ratio", "boundary"), np.ones((3, 3))),
        },
        coords={"frequency_ratio": x, "boundary": [1, 2, 3]},
        attrs=spectrum.attrs | {"kind": "overturning-spectrum", "max_acceleration_ratio": 12.0},
    )
    assert boundaries.attrs["pulse"] == "Ricker"
    for name, data, pictures in (
        ("s", spectrum, ["rotation", "overturning"]),
        ("o", boundaries, ["boundaries"]),
        ("r", histories["elastic"], ["response"]),
    ):
        data.to_netcdf(tmp_path / f"{name}.nc")
        result = RUN.invoke(app, ["plot", str(tmp_path / f"{name}.nc")])
        assert result.exit_code == 0, result.output
        assert sorted(path.stem for path in tmp_path.glob(f"{name}-*.png")) == sorted(
            f"{name}-{p}" for p in pictures
        )
    requested = [
        "plot",
        str(tmp_path / "r.nc"),
        "-o",
        str(tmp_path / "sub" / "x"),
        "--kind",
        "energy,phase-portrait",
    ]
    assert RUN.invoke(app, requested).exit_code == 0
    assert sorted(path.name for path in (tmp_path / "sub").iterdir()) == [
        "x-energy.png",
        "x-phase-portrait.png",
    ]


def test_plot_refuses_other_files(histories, tmp_path):
    histories["rigid"].to_netcdf(tmp_path / "r.nc")
    (tmp_path / "text.nc").write_text("no netCDF")
    xarray.Dataset({"a": 1.0}).to_netcdf(tmp_path / "other.nc")
    xarray.Dataset(attrs={"kind": "weather"}).to_netcdf(tmp_path / "weather.nc")
    xarray.Dataset(attrs={"title": "Interrupted run"}).to_netcdf(tmp_path / "s.partial.nc")
    for name, names, words in (
        ("none.nc", [], "there is no such file"),
        ("text.nc", [], "cannot be read as netCDF"),
        ("other.nc", [], "the file has no attribute 'kind', so rockjax did not write it"),
        ("weather.nc", [], "the kind of the dataset must be one of rocking-spectrum"),
        ("s.partial.nc", [], "finish it with --resume"),
        ("r.nc", ["rotation"], r"pictures of this response are response, phase-portrait.*got 'rotation'"),
    ):
        with pytest.raises(ValueError, match=words):
            _from_file.redraw(tmp_path / name, None, names)
    assert not list(tmp_path.glob("*.png"))


def test_files_know_their_command(tmp_path):
    flags = ["response", "--T-s", "0", "--t-end", "2", "-o", str(tmp_path / "r")]
    result = RUN.invoke(app, flags)
    assert result.exit_code == 0, result.output
    with xarray.open_dataset(tmp_path / "r.nc") as data:
        assert data.attrs["command"] == " ".join(["rockjax", *flags])
        assert data.attrs["kind"] == "response"


def test_the_title_names_the_restrainers():
    devices = (rj.Tendon(1.36, 0.0), rj.Damper(4.54), rj.Damper(2.0, 0.5), rj.Inerter(8.0))
    attributes = describe_podium(rj.Podium(0.15, 1.5, 10.0, restrainers=devices))
    title = panels_title(xarray.Dataset(attrs={"pulse": "Ricker with vertical ratio 0.5"} | attributes))
    first, _, last = title.split("\n")
    assert first == "Ricker pulse with vertical ratio 0.5"
    assert last == ("tendon $τ = 1.36$; damper $δ = 4.54$; damper $δ = 2$, $ν = 0.5$; inerter $μ = 8$")


def test_title_says_how_many_stories():
    about = {"pulse": "Ricker"}
    building = rj.Podium(0.15, 1.5, 10.0, rj.ShearBuilding.uniform(5, 30.0, 0.5))
    panels = [
        xarray.Dataset(attrs=about | describe_podium(each)) for each in (building, rj.Podium(0.15, 1.5))
    ]
    assert [", 5 stories" in panels_title(each) for each in panels] == [True, False]
