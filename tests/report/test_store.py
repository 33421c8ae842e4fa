"""Datasets that are computed in another thread while a report computes others."""

import threading

import numpy as np
import pytest
import xarray

import rockjax as rj
from rockjax._report.store import Store


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
