import os
import subprocess
import sys

import numpy as np
import pytest
import xarray

import rockjax as rj
from rockjax import plots
from rockjax._files import write_atomically
from rockjax._studies import spectra
from tests.scenes import PODIUMS, G, pulse

X, Y = np.linspace(1.5, 8, 7), np.linspace(1, 8, 6)


@pytest.fixture(scope="module")
def spectrum():
    return rj.rocking_spectrum(PODIUMS["rigid"], rj.Ricker, X, Y)


@pytest.mark.smoke
def test_axes_units_and_values(spectrum):
    assert spectrum["peak_rotation"].dims == ("acceleration_ratio", "frequency_ratio")
    p = float(PODIUMS["rigid"].p)
    np.testing.assert_allclose(spectrum["T_p"], 2 * np.pi / (X * p))
    np.testing.assert_allclose(spectrum["a_p"], Y * G * 0.15)
    for i, j in ((1, 2), (3, 6), (5, 0)):
        peak = rj.peak_response(PODIUMS["rigid"], rj.Ricker(float(spectrum.a_p[i]), float(spectrum.T_p[j])))
        assert float(spectrum["peak_rotation"][i, j]) == pytest.approx(float(peak.peak_rotation), abs=1e-9)
        assert bool(spectrum["overturned"][i, j]) == bool(peak.overturned)
        assert int(spectrum["result"][i, j]) == rj._results.NAMES.index(
            "overturned" if peak.overturned else "settled"
        )
    for name in ("alpha_rad", "R_m", "gamma", "eta", "pulse", "rtol", "rockjax_version", "jax_version"):
        assert name in spectrum.attrs
    assert all("units" in spectrum[name].attrs for name in spectrum.variables)


def test_only_requested_outputs():
    o = rj.Options(outputs=("peak_rotation",))
    data = rj.rocking_spectrum(
        PODIUMS["elastic"], lambda a, T: rj.Gabor(a, T, 2.0), [4.0], [2.0, 3.0], options=o
    )
    assert "peak_shear" not in data
    assert "peak_rotation" in data


def test_minimum_overturning(spectrum):
    least = rj.minimum_overturning(spectrum)
    over = spectrum["overturned"].values
    for j in range(len(X)):
        expected = Y[np.argmax(over[:, j])] if over[:, j].any() else np.nan
        np.testing.assert_equal(float(least[j]), expected)
    assert np.isnan(float(least[-1]))


def test_survives_a_file(spectrum, tmp_path):
    path = write_atomically(tmp_path / "s.nc", lambda name: spectrum.to_netcdf(name, engine="netcdf4"))
    with xarray.open_dataset(path) as back:
        np.testing.assert_array_equal(back["peak_rotation"], spectrum["peak_rotation"])
        assert back.attrs["pulse"] == "Ricker"


def test_pictures_have_the_axes_of_the_field(spectrum):
    ax = plots.rocking_spectrum(spectrum)
    assert "omega_p" in ax.get_xlabel()
    assert "tan" in ax.get_ylabel()
    plots.dimensional_axes(spectrum, ax)
    bar = plots.rotation_bar(ax, pad=0.2)
    assert "peak rotation" in bar.ax.get_ylabel()
    assert bar.mappable in ax.collections
    with pytest.raises(ValueError, match="hold no rocking spectrum"):
        plots.rotation_bar(bar.ax.figure.add_subplot())
    curve = plots.overturning_curve(spectrum, label="rigid")
    assert curve.lines[0].get_label() == "rigid"
    assert {line.get_marker() for line in curve.lines[1:]} <= {"^"}  # where nothing overturns beside it
    figure = plots.response(rj.simulate(PODIUMS["elastic"], pulse(), t_end=2.0))
    assert [ax.get_ylabel()[:5] for ax in figure.axes] == [r"$\the", "defor", r"$\ddo"]
    plots.plt.close("all")


def test_pictures_of_sensitivities(spectrum):
    slopes = spectrum["peak_rotation"].expand_dims({"parameter": ["alpha", "T_p"]}, axis=-1)
    data = spectrum.assign(peak_rotation_sensitivity=slopes * [-3.0, 0.3])
    ax = plots.sensitivity_spectrum(data, parameter="T_p")
    (cells,) = ax.collections
    drawn = np.ma.asarray(cells.get_array()).reshape(Y.size, X.size)
    np.testing.assert_array_equal(drawn.mask, spectrum["overturned"])
    np.testing.assert_allclose(drawn.compressed(), 0.3 * spectrum["peak_rotation"].values[~drawn.mask])
    panels = data.expand_dims({"eta_over_gamma": [10.0], "T_s": [0.0]})
    figure = plots.sensitivity_spectra(panels)
    titles = [ax.get_title() for ax in figure.axes]
    assert [title.split("$")[1] for title in titles if title] == [r"\ln α", r"\ln T_p"]
    with pytest.raises(ValueError, match=r"no sensitivities of the peak rotation to 'R', only to \['alpha'"):
        plots.sensitivity_spectrum(data, parameter="R")
    with pytest.raises(ValueError, match="to any parameter; compute"):
        plots.sensitivity_spectrum(spectrum)
    plots.plt.close("all")


def test_sensitivities_that_make_no_sense_are_refused(spectrum):
    arguments = PODIUMS["rigid"], rj.Ricker, X, Y
    with pytest.raises(ValueError, match=r"rocking_spectrum: sensitivities must each be one of .*'T_s'"):
        rj.rocking_spectrum(*arguments, sensitivities=["T_s"])
    with pytest.raises(ValueError, match=r"rocking_spectra: sensitivities must each be one of .*'T_s'"):
        rj.rocking_spectra([arguments[0]], *arguments[1:], sensitivities=["T_s"])
    with pytest.raises(ValueError, match="the spectrum to resume has other sensitivities"):
        rj.rocking_spectrum(*arguments, sensitivities=["alpha"], resume=spectrum)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rest_velocity": 1e-2}, "rest_velocity = 1e-08, not 0.01"),
        ({"max_steps": 1000}, "max_steps = 1000000, not 1000"),
        ({"engine": "segments"}, "engine = 'flat', not 'segments'"),
        ({"outputs": ("peak_rotation", "impacts")}, "outputs = .*, not 'peak_rotation impacts'"),
    ],
)
def test_a_spectrum_with_other_options_is_not_resumed(spectrum, change, words):
    with pytest.raises(ValueError, match=f"was computed with {words}"):
        rj.rocking_spectrum(PODIUMS["rigid"], rj.Ricker, X, Y, options=rj.Options(**change), resume=spectrum)
    xarray.testing.assert_equal(
        rj.rocking_spectrum(PODIUMS["rigid"], rj.Ricker, X, Y, resume=spectrum), spectrum
    )


def test_a_spectrum_of_another_function_is_not_resumed(spectrum):
    """Functions of the same name are distinguished by their pulses."""
    of = lambda pulse: spectra._attributes(PODIUMS["rigid"], pulse, rj.Options())
    first, again, other = (
        of(lambda a, T: rj.Ricker(a, T)),
        of(lambda amplitude, period: rj.Ricker(amplitude, period)),
        of(lambda a, T: rj.Ricker(a, 2 * T)),
    )
    assert first == again
    assert first["pulse"] == other["pulse"]
    assert "pulse_sha256" not in spectrum.attrs
    assert "pulse_sha256" not in of(lambda a, T: rj.Ricker(float(a), float(T)))  # not for arrays
    with pytest.raises(ValueError, match="was computed with pulse_sha256 = "):
        rj.rocking_spectrum(
            PODIUMS["rigid"], lambda a, T: rj.OneSine(a, T), X, Y, resume=spectrum.assign_attrs(first)
        )


@pytest.mark.slow
def test_command_line_sensitivities(tmp_path):
    kind = ("--points", "6", "--eta-over-gamma", "10", "--T-s", "0", "--sensitivities", "alpha,a_p")
    done = run("spectrum", *kind, "-o", "s", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    axes = np.linspace(1, 8, 6), np.linspace(1, 12, 6)
    how = rj.Options(outputs=("peak_rotation",))
    names = ["alpha", "a_p"]
    podium = PODIUMS["rigid"]
    direct = rj.rocking_spectrum(podium, rj.Ricker, *axes, options=how, sensitivities=names)
    with xarray.open_dataset(tmp_path / "s.nc") as data:
        found = data["peak_rotation_sensitivity"].squeeze(["eta_over_gamma", "T_s"])
        assert list(found["parameter"].values) == names
        np.testing.assert_allclose(found, direct["peak_rotation_sensitivity"], rtol=1e-9, atol=1e-9)
    assert (tmp_path / "s-sensitivity.png").read_bytes()[:4] == b"\x89PNG"


def run(*arguments, cwd, **more):
    environment = {**os.environ, "MPLBACKEND": "Agg"}
    return subprocess.run(
        [sys.executable, "-m", "rockjax", *arguments],
        cwd=cwd,
        capture_output=True,
        text=True,
        env=environment,
        **more,
    )


def test_no_podiums_have_no_spectra():
    assert rj.rocking_spectra([], rj.Ricker, [2.0], [3.0]) == []
