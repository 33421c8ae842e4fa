"""The commands that boundaries and designs are asked from, as a user runs them."""

import math

import numpy as np
import pytest
import xarray
from typer.testing import CliRunner

import optimise
import rockjax as rj
from rockjax._cli import app

RUN = CliRunner()


@pytest.mark.slow
def test_overturning_writes_its_spectrum_and_pictures(tmp_path):
    prefix = tmp_path / "study"
    flags = ["--points", "9", "--T-s", "0", "--eta-over-gamma", "1,5", "--sensitivities", "alpha", "-o", str(prefix)]
    result = RUN.invoke(app, ["overturning", *flags])
    assert result.exit_code == 0, result.output
    data = xarray.load_dataset(f"{prefix}.nc")
    assert data.sizes["eta_over_gamma"] == 2
    assert data.sizes["T_s"] == 1
    podium = rj.Podium(math.atan(0.15), 1.5, 10.0, rj.Rigid(50.0))
    one = data.sel(eta_over_gamma=5.0, T_s=0.0).isel(frequency_ratio=2)
    exact = float(rj.overturning_acceleration(podium, rj.Ricker, float(one["T_p"]))) / (float(podium.g) * 0.15)
    assert float(one["minimum"]) == pytest.approx(exact, rel=1e-10)
    for suffix in ("boundaries", "sensitivity"):
        assert (tmp_path / f"study-{suffix}.png").read_bytes().startswith(b"\x89PNG")
    assert "least overturning a_p/(g tan α), η/γ = 5" in result.output


def test_design_that_cannot_be_ends_with_one(tmp_path):
    problem = tmp_path / "problem.toml"
    problem.write_text(
        "[structure]\nalpha = 0.1\nR = 2.0\n[vary]\nalpha = [0.05, 0.12]\n"
        '[motions.pulses]\nkind = "ricker"\na_p = 6.0\nT_p = 1.5\n'
        '[[targets]]\nkind = "no-overturning"\nmotions = "pulses"\n'
    )
    result = RUN.invoke(app, ["design", str(problem), "-o", str(tmp_path / "out")])
    assert result.exit_code == 1
    assert "not satisfied: no overturning" in result.output
    assert (tmp_path / "out.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize("method", ["scan", "trace"])
def test_chart_of_the_slimmest_safe_column(method):
    block = rj.Podium(alpha=0.15, R=1.5)
    T_p = np.linspace(0.5, 0.9, 7)
    chart = optimise.design_chart(block, ("alpha", (0.05, 0.4)), rj.Ricker, 3.0, T_p, method=method, scans=3)
    least = chart["least_safe"].values[0]
    safe, fallen = (
        rj.peak_responses(block.replace(alpha=least * side), rj.Ricker(3.0, T_p)).overturned for side in (1 + 1e-7, 1 - 1e-7)
    )
    assert not np.any(safe)
    assert np.all(fallen)
    # By similarity: where α is least safe for a_p, a_p is the least that overturns α.
    again = rj.overturning_acceleration(block.replace(alpha=least[3]), rj.Ricker, T_p[3])
    assert float(again) == pytest.approx(3.0, rel=1e-9)


def test_charts_say_what_they_cannot_draw():
    block = rj.Podium(alpha=0.15, R=1.5)
    ask = lambda **more: optimise.design_chart(
        block, **({"vary": ("alpha", (0.1, 0.2)), "pulse": rj.Ricker, "a_p": 3.0, "T_p": [0.5, 1.0]} | more)
    )
    for change, words in (
        ({"vary": "alpha"}, "vary must be like"),
        ({"vary": ("beta", (0.1, 0.2))}, "names 'beta'"),
        ({"T_p": [1.0, 0.5]}, "ascending"),
        ({"a_p": -1.0}, "a_p must be finite and > 0"),
        ({"method": "draw"}, "method must be"),
    ):
        with pytest.raises(ValueError, match=words):
            ask(**change)
