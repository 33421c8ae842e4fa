"""Datasets that are computed in another thread while a report computes others."""

import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import xarray

import rockjax as rj
from rockjax._files import write_dataset
from rockjax._machine.threads import import_in_background
from rockjax._report.scenes import Needs, Scenes
from rockjax._report.store import Store, fingerprint


def numbers(value):
    return xarray.Dataset({"y": ((), value)})


def test_a_started_dataset_is_computed_once():
    store, threads = Store(), []

    def compute():
        threads.append(threading.current_thread())
        return numbers(2.0)

    assert store.start("a", "inputs", compute)
    assert store.start("a", "inputs", compute)
    assert float(store.get("a", "inputs", compute)["y"]) == 2.0
    assert len(threads) == 1
    assert threads[0] is not threading.main_thread()
    assert not store.start("a", "inputs", compute)  # stored


def test_a_started_dataset_of_other_inputs_is_not_used():
    store = Store()
    store.start("a", "old inputs", lambda: numbers(1.0))
    assert float(store.get("a", "inputs", lambda: numbers(2.0))["y"]) == 2.0
    store.start("a", "newer inputs", lambda: numbers(3.0))
    assert float(store.get("a", "newer inputs", lambda: numbers(4.0))["y"]) == 3.0


def test_a_failed_write_of_unfinished_datasets_is_tried_again(tmp_path, monkeypatch):
    """The dataset is returned, and the last write reports the error."""

    def fail(store, path):
        raise OSError("no space left")

    store = Store(tmp_path / "page.nc")
    monkeypatch.setattr(Store, "_write", fail)
    store.last_write = -np.inf
    assert float(store.get("a", "inputs", lambda: numbers(2.0))["y"]) == 2.0
    assert np.isfinite(store.last_write)
    with pytest.raises(OSError, match="no space left"):
        store.save()


def test_used_datasets_are_those_of_this_report():
    store = Store()
    store.data["older"] = numbers(1.0)
    store.get("a", "inputs", lambda: numbers(2.0))
    assert list(store.used) == ["a"]


def test_a_damaged_partial_file_leaves_the_file(tmp_path):
    store = Store(tmp_path / "page.nc")
    store.get("a", "inputs", lambda: numbers(2.0))
    store.save()
    (tmp_path / "page.partial.nc").write_bytes(b"not a netCDF file")
    assert list(Store(tmp_path / "page.nc").data) == ["a"]


def test_an_error_in_another_thread_is_raised():
    def compute():
        raise ValueError("no such motion")

    store = Store()
    store.start("a", "inputs", compute)
    with pytest.raises(ValueError, match="no such motion"):
        store.get("a", "inputs", compute)


def test_an_interruption_stops_started_computations(tmp_path):
    """Datasets that were computed before the interruption are written."""
    store, began, ended = Store(tmp_path / "page.nc"), threading.Event(), threading.Event()

    def compute():
        began.set()
        try:
            while True:
                store.raise_if_stopped()
        except rj.Interrupted:
            ended.set()
            raise

    store.get("b", "inputs", lambda: numbers(np.pi))

    def interrupt():
        assert began.wait(10)
        raise KeyboardInterrupt

    store.start("a", "inputs", compute)
    with pytest.raises(KeyboardInterrupt), store.saved_on_interruption():
        interrupt()
    assert ended.wait(10)
    assert list(Store(tmp_path / "page.nc").data) == ["b"]


@pytest.mark.parametrize("name", ["peaks.a/b", "peaks.проект", "slopes." + 300 * "x", "slopes./", "a b (1)"])
def test_every_name_is_read_back(tmp_path, name):
    """Also beside a name that is its beginning, and with coordinates of another length."""
    store = Store(tmp_path / "page.nc")
    for size, key in enumerate(("peaks.a", "slopes.x", name), 1):
        data = numbers(2.0).assign_coords(x=np.arange(size))
        store.get(key, key, lambda data=data: data)
    store.save()
    again = Store(tmp_path / "page.nc")
    assert again.data.keys() == store.data.keys()
    for key, data in store.data.items():
        assert again.data[key].equals(data)


def test_an_interruption_keeps_what_other_threads_have_computed(tmp_path):
    store = Store(tmp_path / "page.nc")
    store.start("a", "inputs", lambda: numbers(2.0))
    store._started["a"][1].result(10)
    with pytest.raises(KeyboardInterrupt), store.saved_on_interruption():
        raise KeyboardInterrupt
    again = Store(tmp_path / "page.nc")
    assert list(again.data) == ["a"]
    again.save()  # nothing is computed, but the unfinished file is newer
    assert list(Store(tmp_path / "page.nc").data) == ["a"]


def test_an_interruption_of_the_second_solution_keeps_the_first(tmp_path, monkeypatch):
    """The scenes with blocks on floors have a second solution, which estimates the errors of the blocks."""
    (tmp_path / "problem.toml").write_text(f'{PROBLEM}[motions.set]\nkind = "ricker"\na_p = 2.0\nT_p = 1.0\n')
    problem, solved = rj.read_problem(tmp_path / "problem.toml"), []
    name, dims = next(iter(problem.motions)), ("motion", "contents")
    needed = {name: Needs({}, {("contents", "shelf"): "a block"})}

    def solve(scenes, podium, excitations, options, dims_of_batch, on_floors):
        if solved == [problem.options.rtol]:
            solved.append("interrupted")
            raise KeyboardInterrupt
        solved.append(options.rtol)
        rotation = [[0.5 + (options.rtol == problem.options.rtol)]]
        return xarray.Dataset(
            {"contents_peak_rotation": (dims, rotation), "contents_overturned": (dims, [[False]])}
        )

    monkeypatch.setattr(Scenes, "solve", solve)
    store = Store(tmp_path / "page.nc")
    with pytest.raises(KeyboardInterrupt), store.saved_on_interruption():
        Scenes(problem, store, needed).peaks(name)
    data = Scenes(problem, Store(tmp_path / "page.nc"), needed).peaks(name)
    assert data["contents_peak_rotation_error"].values == [[1.0]]
    assert len(solved) == 3


def test_an_interruption_after_the_file_is_written_leaves_no_other_file(tmp_path):
    store = Store(tmp_path / "page.nc")
    store.get("a", "inputs", lambda: numbers(2.0))
    store.save()
    with pytest.raises(KeyboardInterrupt), store.saved_on_interruption():
        raise KeyboardInterrupt
    assert [path.name for path in tmp_path.iterdir()] == ["page.nc"]


def test_a_complete_unfinished_file_replaces_an_older_report(tmp_path):
    for value in (1.0, 2.0):
        store = Store(tmp_path / "page.nc")
        store.get("a", str(value), lambda value=value: numbers(value))
        store.save() if value == 1.0 else store.save_unfinished()
    Store(tmp_path / "page.nc").save()
    assert float(Store(tmp_path / "page.nc").data["a"]["y"]) == 2.0


def test_results_of_another_command_are_not_replaced(tmp_path):
    path = tmp_path / "study.nc"
    numbers(1.0).assign_attrs(kind="fragility").to_netcdf(path)
    with pytest.raises(ValueError, match="holds results of kind 'fragility'"):
        Store(path)
    path.rename(tmp_path / "page.partial.nc")
    with pytest.raises(ValueError, match="holds results of kind 'fragility'"):
        Store(tmp_path / "page.nc")


@pytest.mark.parametrize("is_report", [False, True])
def test_files_are_written_after_imports_in_other_threads(tmp_path, monkeypatch, is_report):
    name = f"slow_module_{is_report}"
    (tmp_path / f"{name}.py").write_text(
        "import time\ntime.sleep(0.5)\nis_complete = True\n", encoding="utf-8"
    )
    monkeypatch.syspath_prepend(tmp_path)
    import_in_background(name)
    if is_report:
        Store(tmp_path / "page.nc").save()
    else:
        write_dataset(tmp_path / "study.nc", numbers(1.0))
    assert sys.modules[name].is_complete


def test_tables_are_made_while_another_thread_imports_their_modules():
    pytest.importorskip("distributed")
    words = (
        "import xarray, rockjax._machine.threads as threads; "
        "threads.import_in_background(*threads.TABLE_MODULES); "
        "import dask.base; xarray.Dataset({'x': 1.0}); threads.wait_for_imports(); import distributed"
    )
    found = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr


def test_an_error_of_the_netcdf_library_leaves_the_report(tmp_path, monkeypatch):
    store = Store(tmp_path / "page.nc")
    store.get("a", "inputs", lambda: numbers(2.0))
    store.save()

    def open_groups(*_, **__):
        raise RuntimeError("NetCDF: HDF error")

    monkeypatch.setattr(xarray, "open_groups", open_groups)
    assert Store(tmp_path / "page.nc").data == {}


def test_other_source_of_this_package_has_another_fingerprint(monkeypatch):
    before = fingerprint(1.0)
    assert fingerprint(1.0) == before
    monkeypatch.setattr("rockjax._report.store.source_hash", lambda: "edited")
    assert fingerprint(1.0) != before


PROBLEM = """
[structure]
width = 0.6
height = 3.0
column_mass = 2700.0
beam_mass = 60e3
[[checks]]
kind = "by-others"
text = "soil"
reference = "G-02"
"""


def test_the_home_folder_has_the_store_of_a_report(tmp_path, monkeypatch):
    for name in ("HOME", "USERPROFILE"):
        monkeypatch.setenv(name, str(tmp_path))
    path = tmp_path / "problem.toml"
    path.write_text(PROBLEM)
    numbers(1.0).assign_attrs(kind="fragility").to_netcdf(tmp_path / "page.nc")
    for command in (lambda: rj.report(path, "~/page.html"), lambda: rj.evaluate(path, store="~/page.nc")):
        with pytest.raises(ValueError, match="holds results of kind 'fragility'"):
            command()


def test_scenes_are_kept_if_the_page_cannot_be_written(tmp_path, monkeypatch):
    path, page, write = tmp_path / "problem.toml", tmp_path / "page.html", Path.write_bytes

    def refuse(name, content):
        if name.suffix == ".html":
            raise OSError(28, "No space left on device")
        return write(name, content)

    path.write_text(PROBLEM)
    monkeypatch.setattr(Path, "write_bytes", refuse)
    with pytest.raises(OSError, match=r"page\.html could not be written: No space left"):
        rj.report(path, page, skip=("methods",))
    assert (tmp_path / "page.partial.nc").exists()


def test_a_folder_at_the_path_of_the_page_is_reported_before_anything_is_solved(tmp_path, monkeypatch):
    path = tmp_path / "problem.toml"
    path.write_text(PROBLEM)
    monkeypatch.setattr("rockjax._report.report.evaluate_with_store", None)
    for suffix in (".html", ".json", ".nc"):
        page = tmp_path / f"folder-at{suffix}"
        page.mkdir()
        with pytest.raises(OSError, match=rf"folder-at\{suffix} could not be written: it is a folder"):
            rj.report(path, page.with_suffix(".html"), skip=("methods",))
        page.rmdir()


def test_an_error_of_a_file_is_not_replaced_by_that_of_the_unfinished_store(tmp_path, monkeypatch):
    """A full disk refuses the unfinished store as well; after Ctrl-C, its error is the only one."""

    def refuse(store, path):
        raise OSError("page.partial.nc could not be written")

    monkeypatch.setattr(Store, "_write", refuse)
    for error, expected in ((OSError("page.html"), "^page.html"), (KeyboardInterrupt(), "page.partial.nc")):
        store = Store(tmp_path / "page.nc")
        store.get("a", "inputs", lambda: numbers(2.0))
        with pytest.raises(OSError, match=expected), store.saved_on_interruption():
            raise error
