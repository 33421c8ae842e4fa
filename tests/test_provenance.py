"""Results state their record, the restitution law and the masses."""

import hashlib
import json
import sys

import numpy as np
import pytest
import xarray

import rockjax as rj
from rockjax._cli import main
from rockjax._motions.provenance import describe_motions
from tests.scenes import G

BLOCK = rj.Podium(0.15, 1.5)
SAMPLES = np.sin(np.linspace(0, 6 * np.pi, 61)) * 2.0
QUICK = rj.Options(rtol=1e-6, atol=1e-8)


def digest(samples):
    return hashlib.sha256(np.asarray(samples, "<f8").tobytes()).hexdigest()


def attributes(motion):
    return rj.simulate(BLOCK, motion, options=QUICK).dataset(np.linspace(0, 1, 3)).attrs


def test_a_record_without_a_name_is_known_by_its_samples():
    found = attributes(rj.Record(SAMPLES, 0.05, 1.5))
    assert found["record_sha256"] == digest(SAMPLES)
    assert found["record_dt_s"] == 0.05
    assert found["record_pga_m_s2"] == pytest.approx(1.5 * np.abs(SAMPLES).max())
    assert found["record_samples"] == 61
    assert "record_name" not in found


def test_motions_have_names_sources_and_seeds(tmp_path):
    (motion,) = rj.synthetic_motions(1, seed=7, duration=4.0)
    found = attributes(motion.scaled(2.0))
    assert (found["record_name"], found["record_seed"], found["record_scale"]) == ("synthetic-0001", 7, 2.0)
    path = motion.save(tmp_path / "a.AT2")
    read = rj.read_motion(tmp_path / "a.AT2")
    assert path is None or path == tmp_path / "a.AT2"
    found = attributes(rj.Motions((read,)))
    assert found["record_source"] == str(tmp_path / "a.AT2")
    assert found["record_sha256"] == digest(read.acceleration)
    assert "record_name" not in attributes(rj.Ricker(2.0, 1.0))


def test_attributes_that_only_some_motions_have():
    plain, paired = (
        rj.Motion(SAMPLES, 0.05, "a"),
        rj.Motion(SAMPLES, 0.05, "b", vertical=rj.Motion(SAMPLES, 0.05, "v")),
    )
    found = describe_motions(
        rj.Motions((plain, paired.scaled(2.0), *rj.synthetic_motions(1, seed=7, duration=4.0)))
    )
    assert found["record_name"] == ["a", "b", "synthetic-0001"]
    assert found["record_scale"] == [1.0, 2.0, 1.0]
    assert found["vertical_record_name"] == ["", "v", ""]
    assert found["vertical_record_scale"] == [1.0, 2.0, 1.0]
    assert found["record_seed"] == ["", "", 7]


def test_lists_of_motions_keep_sources_and_seeds():
    (motion,) = rj.synthetic_motions(1, seed=7, duration=4.0)
    assert describe_motions([motion, motion]) == describe_motions(rj.Motions((motion, motion)))
    mixed = describe_motions([[rj.Ricker(2.0, 1.0)], motion, rj.Record(SAMPLES, 0.05)])
    assert mixed["record_name"] == ["", "synthetic-0001", ""]
    assert mixed["record_seed"] == ["", 7, ""]
    assert mixed["record_sha256"] == ["", digest(motion.acceleration), digest(SAMPLES)]
    assert np.isnan(mixed["record_dt_s"][0])
    assert describe_motions([rj.Ricker(2.0, 1.0)]) == {}


@pytest.mark.parametrize("labelled", [False, True])
def test_sweeps_keep_sources_and_seeds(tmp_path, labelled):
    pytest.importorskip("zarr")
    (motion,) = rj.synthetic_motions(1, seed=7, duration=4.0)
    grid = rj.grid(BLOCK, [motion] if labelled else motion, scale=[0.1, 0.2])
    attrs = rj.sweep(*grid, store=tmp_path / "a.zarr", options=QUICK, progress=False).attrs
    assert np.ravel(attrs["record_name"]).tolist() == ["synthetic-0001"]
    assert np.ravel(attrs["record_seed"]).tolist() == [7]
    assert np.ravel(attrs["record_sha256"]).tolist() == [digest(motion.acceleration)]


def test_an_analysis_of_a_suite_tells_its_records_apart():
    motions = rj.synthetic_motions(2, seed=1, dt=0.05, duration=3.0)
    found = rj.incremental_dynamic_analysis(
        BLOCK, motions, [1.0, 6.0], width=0.05, resolution=32, options=QUICK
    )
    assert found["sha256"].values.tolist() == [digest(motion.acceleration) for motion in motions]
    np.testing.assert_allclose(found["PGA"], [motion.pga for motion in motions])
    assert found["dt"].values.tolist() == [0.05, 0.05]


@pytest.fixture
def call(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.txt").write_text("\n".join(f"{a:.4f}" for a in SAMPLES / G))

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["rockjax", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        assert not ended.value.code
        return capsys.readouterr().out

    return run


RESPONSE = "response --record a.txt --units g --dt 0.05 --scale 2 --rtol 1e-6 -o a"
DRAWN = "--width 0.45 --height 3 --column-mass 1500 --columns 4 --beam-mass 30e3 --restitution compatible"


def test_the_command_names_the_simulated_scene(call, tmp_path):
    output = call(*RESPONSE.split(), *DRAWN.split())
    motion = rj.read_motion(tmp_path / "a.txt", units="g", dt=0.05).scaled(2.0)
    checksum, amount = digest(motion.acceleration), f"PGA = {motion.pga / G:.4g} g, scale 2"
    for words in (
        f"a, {tmp_path / 'a.txt'}, dt = 0.05 s, {amount}, SHA-256 {checksum}",
        "compatible, e = 0.9",
        "0.15 g of slow ground motion",
        "N = 4 columns, column mass 1500 kg, beam mass 30000 kg",
    ):
        assert words in output
    with xarray.open_dataset("a.nc") as data:
        assert (data.attrs["columns"], data.attrs["column_mass_kg"]) == (4, 1500.0)
        assert data.attrs["record_sha256"] == checksum
        assert data.attrs["restitution"] == "compatible"


def test_json_has_the_same(call):
    inputs = json.loads(call(*RESPONSE.split(), "--json"))["inputs"]
    assert inputs["record_name"] == "a"
    assert "columns" not in inputs
