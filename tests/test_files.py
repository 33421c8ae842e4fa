"""Atomic writes of files, and interruption by Ctrl-C without losses, in real processes."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import numpy as np
import pytest
import xarray

import rockjax as rj
from rockjax._batch import batch as _batch
from rockjax._batch import executors
from rockjax._cli import _checkpoint
from rockjax._files import write_atomically

from .scenes import PODIUMS

X, Y = np.linspace(1, 8, 24), np.linspace(1, 12, 30)
OPTIONS = rj.Options(outputs=("peak_rotation",))


@pytest.mark.parametrize("error", [RuntimeError("NetCDF: HDF error"), OSError("disk full")])
def test_a_failed_write_keeps_the_old_file(tmp_path, error):
    target = tmp_path / "deep" / "x.txt"

    def fails(name):
        with open(name, "w") as file:
            file.write("half")
        raise error

    with pytest.raises(OSError, match=rf"x\.txt could not be written: {error}"):
        write_atomically(target, fails)
    assert list(target.parent.iterdir()) == []
    write_atomically(target, lambda name: Path(name).write_text("old"))
    with pytest.raises(OSError, match=str(error)):
        write_atomically(target, fails)
    assert [path.name for path in target.parent.iterdir()] == ["x.txt"]
    assert target.read_text() == "old"
    with pytest.raises(OSError, match=r"could not be written: (Not a directory|File exists)"):
        write_atomically(target / "below", fails)


def test_the_error_of_a_file_within_another_names_the_file_once(tmp_path):
    """The error of an inner file is passed on, and a text that resembles it is a cause like any other."""

    def fails(name):
        raise OSError("its annex could not be written")

    with pytest.raises(OSError, match=r"page could not be written: its annex could not be written$"):
        write_atomically(tmp_path / "page", fails)
    with pytest.raises(OSError, match=r"annex could not be written: its annex") as caught:
        write_atomically(tmp_path / "page", lambda name: write_atomically(tmp_path / "annex", fails))
    assert "page" not in str(caught.value).removeprefix(str(tmp_path))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="limits of a process are POSIX")
def test_a_full_disk_is_reported_and_leaves_no_half_file(tmp_path):
    """A limit on the size of files makes writing fail after the first kilobytes, like a full disk."""
    script = """
        import resource, signal, sys
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        from rockjax._cli import main
        import rockjax.plots
        from rockjax._cli import _run
        _run.configure_jax = lambda console: resource.setrlimit(resource.RLIMIT_FSIZE, (9000, 9000))
        flags = ["--points", "12", "--T-s", "0", "--eta-over-gamma", "1", "-q", "-o", "out"]
        sys.argv = ["rockjax", "spectrum", *flags]
        main()
    """
    done = run(script, tmp_path)
    assert done.returncode == 1, done.stderr
    assert (
        "out.nc could not be written" in done.stderr or "out-rotation.png could not be written" in done.stderr
    )
    assert "Traceback" not in done.stderr
    assert "rotation" not in " ".join(os.listdir(tmp_path))
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".out")]


def run(script, folder):
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
    )


class StopsAfter:
    """Progress bar that acts like Ctrl-C after a number of finished scenes."""

    def __init__(self, scenes):
        self.left = scenes

    def update(self, count):
        before, self.left = self.left, self.left - count
        if before > 0 >= self.left:
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)


def interrupted(call):
    with pytest.raises(KeyboardInterrupt) as stopped:
        call()
    assert isinstance(stopped.value, rj.Interrupted)
    return stopped.value


def test_ctrl_c_in_a_batch_keeps_solved_scenes(monkeypatch):
    monkeypatch.setattr(_batch, "CHUNK", 128)
    motions = rj.Ricker(np.linspace(1.0, 8.0, 4000), 0.8)
    complete = rj.peak_responses(PODIUMS["rigid"], motions, options=OPTIONS)
    some = interrupted(
        lambda: rj.peak_responses(PODIUMS["rigid"], motions, options=OPTIONS, progress=StopsAfter(300))
    ).partial
    left = np.asarray(some.result == rj.RESULTS.interrupted)
    assert 0 < left.sum() < 4000 - 300
    np.testing.assert_array_equal(some.peak_rotation[~left], complete.peak_rotation[~left])
    assert np.isnan(some.peak_rotation[left]).all()


def test_ctrl_c_while_lanes_are_prepared_has_no_answers(monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(executors, "idle_lanes", stop)
    podium, motions = PODIUMS["rigid"], rj.Ricker(np.array([2.0, 3.0]), 1.0)
    for solve in (
        lambda: rj.peak_responses(podium, motions),
        lambda: _batch.raw_responses(podium, motions, rj.Options(), False, False),
    ):
        assert interrupted(solve).partial is None


def test_ctrl_c_does_not_wait_for_a_scene_that_takes_minutes():
    """The superstructure of the last scene vibrates a million times while the columns rock."""
    podium = rj.Podium(0.2, 1.5, 3.0, rj.Elastic(5.0, np.where(np.arange(40) == 39, 1e-6, 0.5), 0.0))
    some = interrupted(
        lambda: rj.peak_responses(
            podium, rj.Ricker(4.0, 0.8), options=OPTIONS.replace(max_steps=10**9), progress=StopsAfter(39)
        )
    ).partial
    left = np.asarray(some.result == rj.RESULTS.interrupted)
    assert list(np.flatnonzero(left)) == [39]
    assert np.isfinite(some.peak_rotation[:39]).all()


def test_a_process_that_ignores_ctrl_c_goes_on():
    """Background jobs of a shell ignore Ctrl-C."""
    script = """
        import os, signal
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        import rockjax as rj
        class Bar:
            def update(self, count):
                os.kill(os.getpid(), signal.SIGINT)
        motions = rj.Ricker([1.0, 2.0, 3.0], 0.8)
        print(rj.peak_responses(rj.Podium(0.15, 1.5), motions, progress=Bar()).peak_rotation.shape)
    """
    ended = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout == "(3,)\n"


@pytest.mark.slow
def test_an_interrupted_spectrum_goes_on(monkeypatch, tmp_path):
    monkeypatch.setattr(_batch, "CHUNK", 128)
    podiums = [PODIUMS["block"], PODIUMS["rigid"], PODIUMS["rigid"].replace(R=2.0)]
    complete = rj.rocking_spectra(podiums, rj.Ricker, X, Y, options=OPTIONS)
    some = interrupted(
        lambda: rj.rocking_spectra(podiums, rj.Ricker, X, Y, options=OPTIONS, progress=StopsAfter(200))
    )
    assert "scenes solved" in str(some)
    path = _checkpoint.save(tmp_path / "a.partial.nc", some.partial)
    expected = _checkpoint.load(path, 3)
    count = Counts()
    again = rj.rocking_spectra(podiums, rj.Ricker, X, Y, options=OPTIONS, progress=count, resume=expected)
    solved = sum(int((data["result"] != 6).sum()) for data in expected if data is not None)
    assert 200 <= solved < 3 * X.size * Y.size
    assert count.total == 3 * X.size * Y.size - solved
    for a, b in zip(again, complete, strict=True):
        xarray.testing.assert_equal(a.drop_vars("steps"), b.drop_vars("steps"))
        assert a.attrs == b.attrs
    for change, words in (
        ({"options": OPTIONS.replace(rtol=1e-7)}, "rtol = 1e-08, not 1e-07"),
        ({"podiums": [podiums[0].replace(R=3.0), *podiums[1:]]}, "R_m"),
        ({"x": X + 0.1}, "other values of frequency_ratio"),
        ({"podiums": podiums[:2]}, "one spectrum or None for each of the 2 podiums"),
    ):
        given = {"podiums": podiums, "x": X, "options": OPTIONS} | change
        with pytest.raises(ValueError, match=words):
            rj.rocking_spectra(
                given["podiums"], rj.Ricker, given["x"], Y, options=given["options"], resume=again
            )


class Counts:
    total = 0

    def update(self, count):
        self.total += count


def test_partial_files_of_other_runs_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"--resume needs .*none.partial.nc, which does not exist"):
        _checkpoint.load(tmp_path / "none.partial.nc", 2)
    (tmp_path / "bad.nc").write_bytes(b"not netCDF")
    with pytest.raises(ValueError, match="is not the file of an interrupted run"):
        _checkpoint.load(tmp_path / "bad.nc", 2)
    path = _checkpoint.save(tmp_path / "two.nc", [None, xarray.Dataset({"a": 1.0})])
    with pytest.raises(ValueError, match="results of 2 podiums, but this run has 3"):
        _checkpoint.load(path, 3)
    assert _checkpoint.load(path, 2)[0] is None


def test_partial_files_keep_attributes_as_they_are(tmp_path):
    """Attributes are Python numbers, also if a complete spectrum is read back, because messages and
    comparisons use them."""
    path = _checkpoint.save(
        tmp_path / "a.nc", [xarray.Dataset(attrs={"rtol": 1e-8, "columns": 4, "law": "paper"})]
    )
    (expected,) = _checkpoint.load(path, 1)
    assert expected is not None
    assert {name: type(value) for name, value in expected.attrs.items()} == {
        "rtol": float,
        "columns": int,
        "law": str,
    }


@pytest.mark.slow
def test_ctrl_c_on_the_command_line_and_resume(tmp_path):
    """A real process receives SIGINT: it exits with status 130, writes one file and prints how to resume. The
    resumed result equals an uninterrupted one."""
    flags = ["--points", "40", "--T-s", "0", "--eta-over-gamma", "5,10", "--rtol", "1e-9"]
    script = """
        import signal, sys
        import os
        from rockjax import _progress
        from rockjax._batch import batch
        batch.CHUNK = 128
        seen = 0
        class Bar(_progress.Bar):
            def update(self, count=1):
                global seen
                seen += count
                if seen - count <= 300 < seen and "--resume" not in sys.argv:
                    os.kill(os.getpid(), signal.SIGINT)
                return super().update(count)
        _progress.Bar = Bar
        from rockjax._cli import main
        main()
    """
    command = [sys.executable, "-c", textwrap.dedent(script), "spectrum", *flags, "-o", "out"]
    call = lambda *more: subprocess.run(
        [*command, *more], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    first = call()
    assert first.returncode == 130, first.stderr
    assert "repeat the command with --resume to continue" in first.stderr
    assert "Traceback" not in first.stderr
    assert os.listdir(tmp_path) == ["out.partial.nc"]
    second = call("--resume")
    assert second.returncode == 0, second.stderr
    assert sorted(os.listdir(tmp_path)) == ["out-overturning.png", "out-rotation.png", "out.nc"]
    data = xarray.load_dataset(tmp_path / "out.nc")
    assert int((data["result"] > 2).sum()) == 0
    podium = PODIUMS["rigid"].replace(alpha=np.arctan(0.15))
    options = rj.Options(outputs=("peak_rotation",), rtol=1e-9, atol=1e-11)
    one = rj.rocking_spectrum(
        podium, rj.Ricker, np.linspace(1, 8, 40), np.linspace(1, 12, 40), options=options
    )
    np.testing.assert_allclose(
        data.sel(eta_over_gamma=10)["peak_rotation"].squeeze(), one["peak_rotation"], atol=1e-10
    )
