"""Pictures that a process of their own draws, while the command goes on."""

import multiprocessing
import subprocess
import sys

import numpy as np
import pytest

import rockjax as rj
from rockjax._cli._pictures import Pictures
from rockjax._files import write_dataset
from tests.scenes import PODIUMS

SCRIPT = """
import multiprocessing, os, signal, sys
from pathlib import Path
sys.argv = ["rockjax", *sys.argv[1:]]  # as the command line, which loads JAX late
import rockjax
from rockjax._cli._pictures import Pictures

what, data, here, beside = sys.argv[1:]
pictures = Pictures()
pictures.apart()
(helper,) = multiprocessing.active_children()
import xarray
data = xarray.load_dataset(data)
if what == "killed":
    os.kill(helper.pid, signal.SIGKILL)
    helper.join()
made = pictures.draw(beside, "rocking_spectrum", data) + pictures.draw(beside, "rocking_spectrum", data)
assert made == [], made
try:
    made = pictures.rest()
except OSError as error:
    sys.exit(str(error))
assert made == [Path(beside)] * 2 and pictures.rest() == []
assert ("matplotlib" in sys.modules) == (what == "killed"), "who has drawn?"
assert "jax" not in sys.modules
assert Pictures().draw(here, "rocking_spectrum", data) == [Path(here)]  # at once
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    spectrum = rj.rocking_spectrum(PODIUMS["rigid"], rj.Ricker, np.linspace(1, 4, 5), np.linspace(1, 6, 5))
    return write_dataset(tmp_path_factory.mktemp("data") / "spectrum.nc", spectrum)


def run(*arguments):
    return subprocess.run(
        [sys.executable, "-c", SCRIPT, *map(str, arguments)], capture_output=True, text=True, timeout=120
    )


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere pictures are drawn by the command itself")
@pytest.mark.parametrize("what", ["drawn", "killed"])
def test_pictures_drawn_beside_are_the_same(what, data, tmp_path):
    """Also where the process that draws them has been killed."""
    here, beside = tmp_path / "here.png", tmp_path / "beside.png"
    done = run(what, data, here, beside)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert beside.read_bytes() == here.read_bytes()
    assert sorted(tmp_path.iterdir()) == [beside, here]


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere pictures are drawn by the command itself")
def test_what_cannot_be_written_is_said(data, tmp_path):
    (tmp_path / "file").write_text("in the way")
    done = run("drawn", data, tmp_path / "here.png", tmp_path / "file" / "beside.png")
    assert done.returncode == 1
    assert "could not be written" in done.stderr


def test_a_process_with_threads_draws_by_itself():
    """A copy of it would lack them."""
    before = multiprocessing.active_children()
    Pictures().apart()
    assert multiprocessing.active_children() == before
