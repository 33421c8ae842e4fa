"""Failures while a report is written: the older report stays intact, exit statuses are right, and there is no
traceback."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import pytest
import xarray

from rockjax import _files
from rockjax._cli import main
from rockjax._report import report
from rockjax._report._formats import html
from rockjax._report.store import Store
from tests.scenes import limited_files

pytest.importorskip("resource")  # limits and signals are POSIX
NAMES = ("page.html", "page.json", "page.nc")


@pytest.fixture
def older(solved, tmp_path):
    """Return a problem file beside an older report, whose scenes lack those of the motions."""
    path, page = solved.copy(tmp_path, solved.text)
    page.write_text("older page", encoding="utf-8")
    page.with_suffix(".json").write_text("{}", encoding="utf-8")
    store = Store(tmp_path / "page.nc")
    del store.data["peaks.design"]
    store.computed = 1
    store.save()
    return path


def contents(path):
    """Return the contents of the files beside a problem file."""
    return {name: (path.parent / name).read_bytes() for name in NAMES}


@pytest.fixture
def run(older, monkeypatch, capsys):
    """Return a function that runs the command, and returns its exit status and its message."""
    monkeypatch.chdir(older.parent)
    monkeypatch.setenv("COLUMNS", "400")

    def call(*more):
        words = ["rockjax", "report", "problem.toml", "-o", "page.html", "-q", *more]
        monkeypatch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code or 0, capsys.readouterr().err

    return call


def assert_complete(solved, folder):
    """Check that a folder has the files of the solved report, except for the command line, and no others."""
    found, expected = (json.loads((y / "page.json").read_bytes()) for y in (folder, solved.folder))
    assert found | {"origin": None} == expected | {"origin": None}
    assert (folder / "page.html").read_text(encoding="utf-8").endswith("</html>\n")
    assert set(Store(folder / "page.nc").data) == set(Store(solved.folder / "page.nc").data)
    assert {path.name for path in folder.iterdir()} == {"problem.toml", "hazard.csv", *NAMES}


def fail_at(patch, place, error):
    """Raise an error at a stage of the command, or after half of a file is written."""
    write = Path.write_bytes

    def refuse(*arguments, **keywords):
        raise error

    def write_half(path, content):
        if path.suffix != place:
            return write(path, content)
        write(path, content[: len(content) // 2])
        raise error

    if place in (".html", ".json", ".xlsx", ".csv"):
        patch.setattr(Path, "write_bytes", write_half)
        return
    stages = {
        "scenes": (Store, "_add"),
        "sections": (report, "page_of"),
        "page": (html, "render"),
        ".nc": (xarray.DataTree, "to_netcdf"),
        "new names": (_files.os, "replace"),
    }
    patch.setattr(*stages[place], refuse)


@pytest.mark.parametrize("place", ["scenes", "sections", "page", ".html", ".json", ".nc", "new names"])
def test_ctrl_c_at_every_stage_keeps_the_older_report(solved, older, run, monkeypatch, place):
    before = contents(older)
    with monkeypatch.context() as patch:
        fail_at(patch, place, KeyboardInterrupt())
        status, message = run()
    assert (status, "Traceback" in message) == (130, False)
    assert contents(older) == before
    assert not list(older.parent.glob(".rockjax-*"))
    assert run()[0] == 1
    assert_complete(solved, older.parent)


@pytest.mark.parametrize("place", [".html", ".json", ".nc", "new names"])
def test_a_full_disk_keeps_the_older_report(solved, older, run, monkeypatch, place):
    before = contents(older)
    with monkeypatch.context() as patch:
        fail_at(patch, place, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
        status, message = run()
    assert status == 1
    assert message.startswith("rockjax: page.")
    assert message.endswith(" could not be written: No space left on device\n")
    assert message.count("could not be written") == 1
    assert contents(older) == before
    assert run()[0] == 1
    assert_complete(solved, older.parent)


def test_files_that_the_system_refuses_keep_the_older_report(older, run):
    """The error comes from the system, in the middle of a file."""
    before = contents(older)
    with limited_files(50_000):
        status, message = run()
    assert status == 1
    assert "could not be written: File too large" in message
    assert contents(older) == before


def start_process(folder):
    """Start the command in another process, which uses the programs that this process has compiled."""
    words = [sys.executable, "-m", "rockjax", "report", "problem.toml", "-o", "page.html", "-q"]
    cache = {
        name.upper(): str(getattr(jax.config, name))
        for name in ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    }
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(words, cwd=folder, env=os.environ | cache, **pipes)


def end_process(process):
    """Wait for the end of a process, and return its exit status and its messages."""
    with process:
        try:
            messages = "".join(process.communicate(timeout=600))
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    return process.returncode, messages


@pytest.mark.slow
def test_two_processes_write_one_report(solved, older):
    processes = [start_process(older.parent) for _ in range(2)]
    assert [end_process(process) for process in processes] == [(1, "")] * 2
    assert_complete(solved, older.parent)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_ctrl_c_of_a_process_at_ten_moments(solved, tmp_path):
    """The older report stays, the solved scenes are stored, and the same command continues from them. A
    signal that comes while files are written takes effect when the new report is complete."""
    folders = [tmp_path / str(k) for k in range(11)]
    for folder in folders:
        folder.mkdir()
        solved.copy(folder, solved.text)
        (folder / "page.nc").unlink()
        for name in NAMES[:2]:
            (folder / name).write_text("older", encoding="utf-8")
    start = time.monotonic()
    end_process(start_process(folders[10]))
    duration, interrupted = time.monotonic() - start, 0
    assert_complete(solved, folders[10])
    stored = Store(solved.folder / "page.nc").data.keys()
    for k, folder in enumerate(folders[:10], 1):
        process = start_process(folder)
        time.sleep(duration * (k + 2) / 13)
        process.send_signal(signal.SIGINT)
        status, message = end_process(process)
        if (folder / "page.nc").exists():
            assert_complete(solved, folder)
            continue
        interrupted += 1
        assert (status, "Traceback" in message) == (130, False), message
        assert {(folder / name).read_text(encoding="utf-8") for name in NAMES[:2]} == {"older"}
        assert Store(folder / "page.nc").data.keys() <= stored
        names = {path.name for path in folder.iterdir()}
        assert names <= {"problem.toml", "hazard.csv", "page.html", "page.json", "page.partial.nc"}
    assert interrupted >= 5
    last = [folder for folder in folders if (folder / "page.partial.nc").exists()][-1]
    end_process(start_process(last))
    assert_complete(solved, last)


@pytest.mark.parametrize("place", [".xlsx", ".csv"])
def test_other_files_that_cannot_be_written_leave_a_complete_report(solved, older, run, monkeypatch, place):
    (older.parent / "page.csv").mkdir()
    with monkeypatch.context() as patch:
        fail_at(patch, place, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
        status, message = run("--xlsx", "page.xlsx", "--csv", "page.csv")
    assert status == 1
    assert f"{place} could not be written: No space left on device" in message
    assert list((older.parent / "page.csv").glob("*.csv")) == [] or place == ".xlsx"
    assert not (older.parent / "page.xlsx").exists()
    assert json.loads((older.parent / "page.json").read_bytes())["title"] == "Podium of four columns"


@pytest.mark.parametrize(
    ("more", "name"), [((), "page.html"), (("--xlsx", "no/x.xlsx"), "no/x.xlsx"), (("--csv", "no"), "no/")]
)
def test_a_folder_without_permission_is_reported_before_scenes_are_solved(
    older, run, monkeypatch, more, name
):
    """Files of the folder `no`, or of all folders, cannot be created."""
    before, create = contents(older), _files.tempfile.TemporaryFile

    def refuse(dir):
        if not more or Path(dir).name == "no":
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))
        return create(dir=dir)

    (older.parent / "no").mkdir()
    monkeypatch.setattr(_files.tempfile, "TemporaryFile", refuse)
    monkeypatch.setattr(report, "evaluate_with_store", None)
    status, message = run(*more)
    assert status == 1
    assert name in message
    assert "could not be written: Read-only file system" in message
    assert contents(older) == before
