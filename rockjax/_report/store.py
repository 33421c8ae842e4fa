"""Storage of computed datasets in a file, so that a repeated report does not compute them again."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import re
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from rockjax._machine.threads import submit, wait_for_imports
from rockjax._programs.key import NoKeyError, source_hash
from rockjax._responses.datasets import describe_versions
from rockjax._results import Interrupted

if TYPE_CHECKING:
    import xarray


def fingerprint(*values: Any) -> str:
    """Return a hash of pytrees, of the versions of the libraries and of the source of this package. A leaf
    that is neither a number nor an array is hashed by its `repr`."""
    entries: list[str] = [_versions(), _source()]
    for value in values:
        leaves, treedef = jax.tree.flatten(value)
        entries.append(str(treedef))
        for leaf in leaves:
            if isinstance(leaf, bool | int | float | np.ndarray | np.generic | jax.Array):
                array = np.ascontiguousarray(leaf)
                entries.append(f"{array.dtype.str}{array.shape}{hashlib.sha256(array.tobytes()).hexdigest()}")
            else:
                entries.append(repr(leaf))
    return hashlib.sha256("\n".join(entries).encode()).hexdigest()


@functools.cache
def _versions() -> str:
    """Return the versions of the libraries, which take milliseconds to find."""
    return json.dumps(describe_versions(), sort_keys=True)


def _source() -> str:
    """Return a hash of the source of this package. If the source is unknown, return a text that no other
    process has, so that other processes do not use the stored datasets of this one."""
    try:
        return source_hash()
    except NoKeyError:
        return _name_of_process()


@functools.cache
def _name_of_process() -> str:
    return uuid.uuid4().hex


# Arguments of `Store.get`: name, fingerprint, and function that computes the dataset.
Stored = tuple[str, str, Callable[[], "xarray.Dataset"]]
_GROUP_NAME = re.compile(r"[\w .()-]{1,100}")
MIN_WRITE_INTERVAL = 30.0  # least time between two writes of an unfinished store [s]


class Store:
    """Datasets by name, each with the fingerprint (hash) of its inputs.

    `get` computes a dataset, or returns it if it is stored. `start` computes it in another thread, while this
    thread computes other datasets.

    - `path`: file NAME.nc of the datasets; None keeps all datasets in memory. Datasets of an earlier report
      are read from NAME.nc, and from the file NAME.partial.nc of an unfinished report
    """

    def __init__(self, path: Path | None = None):
        self.path, self.computed, self.last_write = path, 0, time.monotonic()
        self._written = 0  # number of computed datasets that the file `path` has
        self.data: dict[str, xarray.Dataset] = {}
        self._started: dict[str, tuple[str, Future]] = {}  # name → fingerprint, dataset to come
        self._stop = threading.Event()
        self._used: set[str] = set()  # names of the datasets that `get` has returned
        for candidate in () if path is None else (path, _partial(path)):
            self._load(candidate)

    def _load(self, path: Path) -> None:
        """Read the datasets of an earlier report from a file. A file that is missing or damaged is ignored.
        Raises `ValueError` if the file has the results of another command, which the report would replace."""
        if not path.exists():
            return
        import xarray

        loaded, kind = {}, "report"
        try:
            # The datasets have no times and no packed numbers, so xarray need not look for them.
            groups = xarray.open_groups(path, engine="netcdf4", decode_times=False, mask_and_scale=False)
            kind = groups["/"].attrs.get("kind", kind)
            for data in groups.values():
                if "fingerprint" in data.attrs:
                    loaded[data.attrs["name"]] = data.load()
            for data in groups.values():  # after all have been read, because all groups share the open file
                data.close()
        except (OSError, ValueError, KeyError, RuntimeError):  # netCDF4 raises RuntimeError
            return
        if kind != "report":
            raise ValueError(
                f"{path} holds results of kind {kind!r}, which the report would replace; choose another name "
                "for the report, or move this file"
            )
        self.data |= loaded

    def get(self, name: str, inputs_hash: str, compute: Callable[[], xarray.Dataset]) -> xarray.Dataset:
        """Return a dataset. Compute it, unless a dataset with the same name and fingerprint is stored.

        - `name`: name of the dataset, whose parts are separated by ".", such as "peaks.design"
        - `inputs_hash`: fingerprint of the inputs of the dataset
        - `compute`: function that computes the dataset
        """
        self._used.add(name)
        if self._has(name, inputs_hash):
            return self.data[name]
        started_hash, future = self._started.pop(name, ("", None))
        data = future.result() if future is not None and started_hash == inputs_hash else compute()
        self._add(name, inputs_hash, data)
        if time.monotonic() - self.last_write > MIN_WRITE_INTERVAL:
            # A failed write is tried again later, and the last write reports its error.
            self.last_write = time.monotonic()
            with contextlib.suppress(OSError):
                self.save_unfinished()
        return data

    @property
    def used(self) -> dict[str, xarray.Dataset]:
        """The datasets that `get` has returned. Others may come from an earlier report with other inputs."""
        return {name: data for name, data in self.data.items() if name in self._used}

    def _add(self, name: str, inputs_hash: str, data: xarray.Dataset) -> None:
        data.attrs |= {"name": name, "fingerprint": inputs_hash}
        self.data[name] = data
        self.computed += 1

    def start(self, name: str, inputs_hash: str, compute: Callable[[], xarray.Dataset]) -> bool:
        """Start to compute a dataset in another thread, unless it is stored. A later call of `get` waits for
        it.

        The arguments are those of `get`. `compute` should call `raise_if_stopped` from time to time. Returns
        False if the dataset is stored, otherwise True.
        """
        if self._has(name, inputs_hash):
            return False
        if self._started.get(name, ("",))[0] != inputs_hash:
            self._started[name] = inputs_hash, submit(compute)
        return True

    def raise_if_stopped(self) -> None:
        """Raise `Interrupted` if an exception, such as that of Ctrl-C, has ended the report."""
        if self._stop.is_set():
            raise Interrupted("stopped", None)

    def _has(self, name: str, inputs_hash: str) -> bool:
        stored = self.data.get(name)
        return stored is not None and stored.attrs["fingerprint"] == inputs_hash

    def text(self, name: str, inputs_hash: str, compute: Callable[[], str]) -> str:
        """Do the same as `get` for a text: `compute` returns a string, and so does this method."""
        return str(self.get(name, inputs_hash, lambda: _dataset_of_text(compute()))["text"].values)

    def start_text(self, name: str, inputs_hash: str, compute: Callable[[], str]) -> bool:
        """Do the same as `start` for a text, which a later call of `text` returns."""
        return self.start(name, inputs_hash, lambda: _dataset_of_text(compute()))

    @contextlib.contextmanager
    def saved_on_interruption(self) -> Iterator[None]:
        """If an exception, such as Ctrl-C, ends the `with` block, stop the computations in other threads and
        write an unfinished store. If the exception is that a file cannot be written, an unfinished store that
        cannot be written either is no further error."""
        try:
            yield
        except BaseException as error:
            self._stop.set()
            with contextlib.suppress(*[OSError] if isinstance(error, OSError) else []):
                self.save_unfinished()
            raise

    def save_unfinished(self) -> None:
        """Write all datasets, including finished ones of other threads, to NAME.partial.nc. A later run
        continues the report from this file. Write nothing if the store has no path, or if no dataset was
        computed since `save`."""
        for name, (inputs_hash, future) in list(self._started.items()):
            if future.done() and future.exception() is None:
                del self._started[name]
                self._add(name, inputs_hash, future.result())
        if self.path is not None and self.computed > self._written:
            self._write(_partial(self.path))
        self.last_write = time.monotonic()

    def save(self) -> Path | None:
        """Write all datasets to the file `path`, unless the file has them already, and remove
        NAME.partial.nc. Return the path. If the store has no path, do nothing and return None."""
        if self.path is None:
            return None
        if self.computed or _partial(self.path).exists() or not self.path.exists():
            self._write(self.path)
            self._written = self.computed
        _partial(self.path).unlink(missing_ok=True)
        return self.path

    def _write(self, path: Path) -> None:
        import xarray

        from rockjax._files import CONVENTIONS, write_atomically

        # A DataTree opens the file once, while `_files.write_dataset` would open it again for every group.
        # Names that are too long for a group, or have characters such as "/", are replaced by their hash.
        names = {name: name if _GROUP_NAME.fullmatch(name) else fingerprint(name) for name in self.data}
        groups = {names[name]: data for name, data in self.data.items()}
        wait_for_imports()
        attrs = {"title": "Scenes of a report", "kind": "report", "Conventions": CONVENTIONS}
        tree = xarray.DataTree.from_dict({"/": xarray.Dataset(attrs=attrs), **groups})
        write_atomically(path, lambda name: tree.to_netcdf(name, engine="netcdf4"))


def _dataset_of_text(text: str) -> xarray.Dataset:
    """Return a dataset whose variable `text` is a text."""
    import xarray

    return xarray.Dataset({"text": ((), text)})


def dataset_of(arrays: Mapping[str, Any]) -> xarray.Dataset:
    """Return a dataset of arrays (name → array) that share no dimensions."""
    import xarray

    values = {name: np.asarray(y) for name, y in arrays.items()}
    dims = {name: tuple(f"{name}_axis{k}" for k in range(y.ndim)) for name, y in values.items()}
    return xarray.Dataset({name: (dims[name], y) for name, y in values.items()})


def _partial(path: Path) -> Path:
    return path.with_suffix(".partial.nc")
