"""Pictures of the forces in the joints show the computed values and the times at which joints open."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray
from matplotlib.colors import to_hex

import rockjax as rj
from rockjax import plots
from rockjax._responses.datasets import describe_podium, podium_of
from rockjax.plots import _from_file
from tests.scenes import pulse

# Of the three columns, the first is the right one and the second the left one.
ELEVATION = rj.Elevation([6.0, -3.0, 0.0], 0.6, 8.4)
RIGID = rj.Podium(0.15, 1.5, 10.0, rj.Rigid(50.0), elevation=ELEVATION)
HIGH = RIGID.replace(elevation=rj.Elevation([6.0, -3.0, 0.0], 0.6, 40.0))
BLOCK = rj.Podium(alpha=0.3, R=2.0)
OPTIONS = rj.Options(outputs=("peak_rotation", "axial_force", "peak_friction", "impact_friction"))
PICTURES = ("joint_forces", "friction_demand")


@pytest.fixture(scope="module")
def responses():
    """Return responses with closed joints, with opening joints, and of a block without requested forces."""
    return {
        "holds": rj.simulate(RIGID, pulse(), options=OPTIONS),
        "opens": rj.simulate(HIGH, pulse(), options=OPTIONS),
        "block": rj.simulate(BLOCK, pulse()),
    }


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


def labelled(ax):
    return dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))


def spans(ax):
    """Return the shaded time spans."""
    (shaded,) = (y for y in ax.collections if y.get_label() == "a joint is open")
    assert to_hex(shaded.get_facecolor()[0]) == plots._joints.OPEN_COLOUR.lower()
    return [(path.vertices[:, 0].min(), path.vertices[:, 0].max()) for path in shaded.get_paths()]


def test_pictures_leave_datasets_unchanged(responses):
    data = responses["holds"].dataset()
    names = set(data.variables)
    for name in PICTURES:
        getattr(plots, name)(data)
    assert set(data.variables) == names


@pytest.mark.parametrize("kind", ["holds", "opens", "block"])
@pytest.mark.parametrize("name", PICTURES)
def test_every_picture_is_drawn(responses, kind, name):
    ax = getattr(plots, name)(responses[kind])
    assert ax.get_xlabel() == "time [s]"
    assert "N" in ax.get_ylabel()
    ax.figure.canvas.draw()
    given = plt.figure().add_subplot()
    assert getattr(plots, name)(responses[kind], ax=given) is given


def test_curves_are_the_forces_of_the_end_columns(responses):
    response = responses["holds"]
    ax = plots.joint_forces(response.dataset())
    curves = labelled(ax)
    assert list(curves) == [
        "left column",
        "right column",
        "dead load",
        "at the top joint",
        f"least, {np.min(response.least_axial_force / RIGID.dead_load):.2f} of the dead load",
    ]
    for name, column in (("left column", 1), ("right column", 0)):
        t, N = curves[name].get_data()
        np.testing.assert_array_equal(N, response.joint_forces(t).axial[:, column, 0])
    assert curves["dead load"].get_ydata()[0] == 61.0
    # Both columns carry the dead load before the motion; the marked force is the least of all.
    t, N = curves["left column"].get_data()
    assert N[0] == pytest.approx(61.0)
    assert list(curves.values())[-1].get_ydata()[0] == pytest.approx(
        np.min(np.asarray(response.least_axial_force)), rel=0.02
    )


@pytest.mark.parametrize("name", PICTURES)
def test_open_joints_are_shaded(responses, name):
    response = responses["opens"]
    assert np.min(np.asarray(response.least_axial_force)) < 0
    ax = getattr(plots, name)(response)
    found = spans(ax)
    t = np.linspace(*response.span, 4001)
    is_open = np.any(np.asarray(response.joint_forces(t).axial) < 0, axis=(1, 2))
    shaded = np.any([(a <= t) & (t <= b) for a, b in found], axis=0)
    np.testing.assert_array_equal(shaded, is_open)
    assert np.all(np.isfinite(ax.get_ylim()))
    assert "a joint is open" not in labelled(getattr(plots, name)(responses["holds"]))


def test_friction_is_that_of_the_worst_column(responses):
    response = responses["holds"]
    ax = plots.friction_demand(response, friction=0.4)
    curves = labelled(ax)
    for k, name in enumerate(("bottom joint", "top joint")):
        t, demand = curves[name].get_data()
        np.testing.assert_array_equal(demand, np.max(np.asarray(response.friction(t)), axis=1)[:, k])
        assert np.max(demand) == pytest.approx(float(response.peak_friction[k]), rel=0.02)
    assert curves[r"$\tan\alpha = 0.151$"].get_ydata()[0] == pytest.approx(np.tan(0.15))
    assert curves[r"$\mu = 0.4$"].get_ydata()[0] == 0.4
    t, struck = curves[r"impacts, $|J_T|\,/\,J_N$"].get_data()
    np.testing.assert_array_equal(t, response.impact_times)
    np.testing.assert_allclose(np.max(struck), np.max(np.asarray(response.peak_impact_friction)), rtol=1e-12)


def test_friction_near_open_joints_does_not_set_the_axis(responses):
    ax = plots.friction_demand(responses["opens"])
    assert ax.get_ylim()[1] <= 1.45 * 4 * np.tan(0.15) * (1 + 1e-12)
    assert all(np.all(np.isfinite(line.get_ydata()) | np.isnan(line.get_ydata())) for line in ax.lines)
    assert labelled(ax)["impact that opens a joint"].get_xdata().size
    held = plots.friction_demand(responses["holds"])
    assert "impact that opens a joint" not in labelled(held)


def test_a_block_has_one_joint(responses):
    curves = labelled(plots.joint_forces(responses["block"]))
    assert list(curves)[:2] == ["mean column", "dead load"]
    assert "top joint" not in labelled(plots.friction_demand(responses["block"]))


def test_a_dataset_without_forces_is_refused(responses):
    for name in PICTURES:
        with pytest.raises(ValueError, match=r"no forces in the joints; simulate with .*axial_force"):
            getattr(plots, name)(responses["block"].dataset())


def test_the_figure_of_a_response_has_the_forces_that_were_requested(responses, tmp_path):
    figure = plots.response(responses["holds"])
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert len(labels) == 4
    assert "axial force" in labels[1]
    assert "friction" in labels[2]
    assert len(plots.response(responses["block"]).axes) == 2
    responses["holds"].dataset().to_netcdf(tmp_path / "r.nc")
    written = _from_file.redraw(tmp_path / "r.nc", names=["joint-forces", "friction-demand"])
    assert [path.name for path in written] == ["r-joint-forces.png", "r-friction-demand.png"]


def test_elevations_are_written_and_read_again():
    round_ends = rj.Podium.from_dimensions(
        width=0.45, height=3.0, column_mass=1.5e3, beam_mass=30e3, end_radius=0.75, positions=[-3.0, 3.0]
    )
    for podium in (RIGID, round_ends, BLOCK):
        assert repr(podium_of(describe_podium(podium))) == repr(podium)
    np.testing.assert_array_equal(podium_of(describe_podium(round_ends)).elevation._raised, 1.5)


def spectrum() -> xarray.Dataset:
    """Return a spectrum whose least forces decrease with the frequency, faster at the top joint than at the
    bottom joint."""
    x, y = np.linspace(1.0, 8.0, 8), np.linspace(1.0, 12.0, 6)
    share = np.broadcast_to(1 - x / 4, (y.size, x.size))
    return xarray.Dataset(
        {
            "least_axial_force": (
                ("acceleration_ratio", "frequency_ratio", "joint"),
                np.stack([61 * (1 - x / 8) + 0 * share, 60 * share], axis=-1),
            ),
            "overturned": (("acceleration_ratio", "frequency_ratio"), share > 0.7),
        },
        coords={"frequency_ratio": x, "acceleration_ratio": y, "dead_load": ("joint", [61.0, 60.0])},
        attrs={"kind": "rocking-spectrum", "pulse": "Ricker", "p_rad_s": 2.2, **describe_podium(RIGID)},
    )


def test_the_line_of_lift_off():
    ax = plots.lift_off_spectrum(spectrum())
    assert (ax.get_xlabel(), ax.get_ylabel()) == (plots.FREQUENCY_RATIO, plots.ACCELERATION_RATIO)
    assert to_hex(ax.get_facecolor()) == to_hex(plots._style.OVERTURNED_COLOUR)
    _, line = ax.collections
    (zero,) = line.get_paths()
    np.testing.assert_allclose(zero.vertices[:, 0], 4.0)  # where the top joint opens
    none = spectrum()
    none["least_axial_force"] = abs(none["least_axial_force"]) + 1
    assert len(plots.lift_off_spectrum(none).collections) == 1
    with pytest.raises(ValueError, match=r"no axial forces; compute it with .*'axial_force'"):
        plots.lift_off_spectrum(none.drop_vars("least_axial_force"))


def test_panels_of_lift_off_name_the_columns(tmp_path):
    figure = _from_file.PICTURES["rocking-spectrum"]["lift-off"].draw(spectrum())
    assert figure.get_suptitle().startswith("3 columns over 9 m")
    assert "axial force" in figure.axes[-1].get_ylabel()
    figure.canvas.draw()


def test_a_spectrum_holds_the_dead_load():
    options = rj.Options(outputs=("peak_rotation", "axial_force"))
    data = rj.rocking_spectrum(RIGID, rj.Ricker, [2.0, 6.0], [0.5, 1.5, 2.0], options=options)
    np.testing.assert_array_equal(data["dead_load"], RIGID.dead_load)
    assert data["dead_load"].attrs["units"] == "1"
    plots.lift_off_spectrum(data).figure.canvas.draw()
