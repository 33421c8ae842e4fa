"""An output of one module becomes a check, with its numbers in all files, without a change of the report."""

import json
import re

import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax import _options
from rockjax._outputs.registry import REGISTRY, VARIABLES
from rockjax._report._formats import FORMATS
from rockjax._report.kinds import KINDS
from rockjax._report.kinds.peaks import peak_kinds


class PeakBeamSpeed(rj.AbstractOutput):
    name, unit, description = "peak_beam_speed", "m s-1", "peak speed of the beam"

    def quantity(self, moment):
        psi = moment.sigma * moment.c.alpha - moment.x[0]
        return moment.c.two_R * moment.v[0] * jnp.cos(psi)


FILE = """
[structure]
width = 0.6
height = 3.0
column_mass = 2700.0
beam_mass = 60e3
[motions.pulses]
kind = "ricker"
a_p = 3.5
T_p = 1.0
[[checks]]
kind = "peak-rotation"
limit = 0.5
[[checks]]
kind = "peak-beam-speed"
limit = 2.0
"""


@pytest.fixture
def _registered(monkeypatch):
    """Add the output to the registry, from which the names of outputs and the kinds of checks are made."""
    output = PeakBeamSpeed()
    monkeypatch.setitem(REGISTRY, output.name, output)
    monkeypatch.setattr(_options, "OUTPUTS", tuple(REGISTRY))
    (variable,) = output.variables
    monkeypatch.setitem(VARIABLES, variable.name, (variable, output.name))
    for kind in peak_kinds():
        if kind.name not in KINDS:
            monkeypatch.setitem(KINDS, kind.name, kind)


@pytest.mark.usefixtures("_registered")
def test_a_new_output_is_a_check(tmp_path):
    path = tmp_path / "problem.toml"
    path.write_text(FILE, encoding="utf-8")
    report = rj.report(path, tmp_path / "page.html", skip=("spread", "methods"))
    check = report.evaluation.checks[1]
    history = report.evaluation.scenes.history("pulses", 0)
    theta, rate = history["theta"].values, history["theta_dot"].values
    speed = np.hypot(0.6, 3.0) * np.abs(rate) * np.cos(np.arctan(0.2) - np.abs(theta))
    # The speed is largest just before an impact, between two times of the history. ψ is then α, and cos α is
    # 3.0/hypot(0.6, 3.0).
    assert check.value == pytest.approx(3.0 * np.abs(history["theta_dot_before"].values).max(), rel=1e-8)
    assert speed.max() <= check.value * (1 + 1e-8)
    assert (check.result, check.utilisation) == ("PASS", check.value / 2.0)
    # 2R θ̇ is proportional to the width at small angles and grows with the motion.
    assert check.sensitivities["motion"] > 0
    assert check.sensitivities.keys() == report.evaluation.checks[0].sensitivities.keys()
    entry = json.loads((tmp_path / "page.json").read_text(encoding="utf-8"))["checks"][1]
    assert entry["name"] == "Peak speed of the beam"
    assert (entry["value"]["value"], entry["value"]["unit"]) == (check.value, "m/s")
    assert entry["value"]["error"] == check.error > 0
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Peak speed of the beam" in page
    tables = {
        name: content.decode("utf-8-sig")
        for name, content in FORMATS["csv"](report.page, report.units).items()
    }
    for name in ("summary.csv", "errors.csv", "influences-c2.csv"):
        assert name in tables, tables.keys()
    assert repr(check.value) in tables["summary.csv"]
    assert re.search("(?i)peak speed of the beam", tables["errors.csv"])


@pytest.mark.usefixtures("_registered")
def test_a_file_that_does_not_ask_for_a_new_output_names_it(solved):
    assert "peak-beam-speed" in rj.report(solved.report.evaluation).html
    assert "peak-beam-speed" not in solved.report.html
