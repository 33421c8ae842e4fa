"""The zarr store of a sweep: arrays of results that xarray opens, written chunk by chunk.

The root group contains the result arrays, whose dimensions are the axes of the sweep. The group `inputs`
contains the parameters of the scenes. The group `progress` contains one row for each chunk, which is written
after the results of the chunk. A chunk without a row is unsolved. If the results of a chunk do not match the
checksum in its row, the chunk is damaged. A chunk may be written again, or by two processes at once, because
its results do not depend on the process.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rockjax import _results as results

from .layout import ChunkLayout
from .paths import atomic_folder, expand_path, is_local, zarr_store

if TYPE_CHECKING:
    import xarray
    import zarr

FORMAT = 1  # version of the store format
GROUPS = "inputs", "progress"  # names of the groups of a store
DAMAGE = OSError, RuntimeError, ValueError  # raised by zarr's codecs for damaged bytes
_IDENTITY = "sweep"  # attribute of the group `progress` that contains the identity of the sweep
_LONG_INPUT = 1_000_000  # inputs and 1-D coordinates with more values are stored in several chunks


class ChunkRow(NamedTuple):
    """Row of a solved chunk in the group `progress`."""

    checksum: float  # CRC-32 of the results, see the function `checksum`
    seconds: float  # wall time [s]
    steps: float  # number of trial steps
    failed: float  # number of scenes that did not finish


class Variable(NamedTuple):
    """Properties of an array of results."""

    dtype: np.dtype
    attrs: dict[str, Any]
    extra_dims: dict[str, int]  # lengths of the axes after those of the grid, by name

    @property
    def fill_value(self) -> Any:
        """Value of unsolved scenes."""
        if "flag_meanings" in self.attrs:
            return results.INTERRUPTED
        return {"f": np.nan, "b": False, "i": -1}[self.dtype.kind]


def variable_for(values: np.ndarray, attrs: Mapping[str, Any], extra_dims: Sequence[str]) -> Variable:
    """Return the variable that stores results; 64-bit integers become 32-bit integers.

    - `values`: results of a 1-D batch, shape (scenes, …)
    - `attrs`: attributes of the array
    - `extra_dims`: names of the axes after the first
    """
    dtype = np.dtype(np.int32) if values.dtype.kind == "i" and values.dtype.itemsize > 4 else values.dtype
    plain_attrs = {name: y.tolist() if isinstance(y, np.ndarray) else y for name, y in attrs.items()}
    return Variable(dtype, plain_attrs, dict(zip(extra_dims, values.shape[1:], strict=True)))


def checksum(arrays: Mapping[str, np.ndarray]) -> float:
    """Return the CRC-32 of the results of a chunk, taken in the order of their names."""
    crc = 0
    for name in sorted(arrays):
        crc = zlib.crc32(np.ascontiguousarray(arrays[name]).view(np.uint8), crc)
    return float(crc)


def fingerprint(identity: Mapping[str, Any]) -> str:
    """Return a hash of the identity of a sweep."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]


def digest(y: np.ndarray) -> str:
    """Return a string with type, shape and hash of an array."""
    y = np.ascontiguousarray(y)
    return f"{y.dtype.str}{list(y.shape)} {hashlib.sha256(y.tobytes()).hexdigest()[:16]}"


class Store:
    """An open store of a sweep."""

    def __init__(self, path: str, group: zarr.Group):
        self.path = path
        self.group = group
        self.identity: dict[str, Any] = _read_identity(group)  # see `SweepSpec.identity`
        self.layout = ChunkLayout(tuple(self.identity["shape"]), tuple(self.identity["chunk"]))
        self.variables: list[str] = list(self.identity["variables"])
        self._arrays: dict[str, Any] = {name: group[name] for name in self.variables}
        self._rows: Any = group["progress/rows"]

    @classmethod
    def open(cls, path: str | Path) -> Store | None:
        """Return the store at a path; None if the path does not exist or is an empty folder.

        Raises `ValueError` for a file, for a folder with other contents, and for damaged metadata of a store.
        """
        path = expand_path(path)
        if is_local(path) and not Path(path).exists():
            return None
        not_a_sweep = ValueError(
            f"{path} exists and is not the store of a sweep; give another path or remove it"
        )
        if is_local(path) and not Path(path).is_dir():
            raise not_a_sweep
        with _explain_damage(path):
            try:
                group = _zarr().open_group(zarr_store(path), mode="r+")
            except FileNotFoundError:
                if is_local(path) and any(Path(path).iterdir()):
                    raise not_a_sweep from None
                return None
            if _read_identity(group):
                return cls(path, group)
        raise ValueError(
            f"{path} is a zarr store without a complete sweep definition; give another path or remove it"
        )

    @classmethod
    def create(
        cls,
        path: str | Path,
        identity: Mapping[str, Any],
        dims: Sequence[str],
        coords: xarray.Dataset,
        variables: Mapping[str, Variable],
        inputs: Mapping[str, np.ndarray],
        expected: np.ndarray,
        attrs: Mapping[str, Any],
    ) -> Store:
        """Create a new store without results, atomically.

        - `path`: folder or URL
        - `identity`: identity of the sweep (`SweepSpec.identity`)
        - `dims`: names of the axes
        - `coords`: coordinates of the results
        - `variables`: arrays of results, by name
        - `inputs`: parameters of the scenes, by name
        - `expected`: expected trial steps of every chunk, shape (chunks,)
        - `attrs`: attributes of the dataset

        If another process has created a store at the path meanwhile, raises `TakenError` and leaves that
        store unchanged.
        """
        path = expand_path(path)
        zarr = _zarr()
        layout = ChunkLayout(tuple(identity["shape"]), tuple(identity["chunk"]))
        with atomic_folder(path) as temporary:
            chunk_lengths = dict(zip(dims, layout.chunk_shape, strict=True))
            # Short 1-D coordinates are stored as one chunk, others in the chunks of the results.
            coord_encoding = {
                name: {"chunks": _coord_chunks(array, chunk_lengths)}
                for name, array in coords.variables.items()
            }
            new_store = zarr_store(temporary)
            coords.to_zarr(new_store, mode="w", zarr_format=3, consolidated=False, encoding=coord_encoding)
            group = zarr.open_group(new_store, mode="r+")
            array_options: Any = {"compressors": _codecs()}
            for name, variable in variables.items():
                group.create_array(
                    name,
                    shape=(*layout.shape, *variable.extra_dims.values()),
                    dtype=variable.dtype,
                    chunks=(*layout.chunk_shape, *variable.extra_dims.values()),
                    fill_value=variable.fill_value,
                    dimension_names=(*dims, *variable.extra_dims),
                    attributes=variable.attrs,
                    **array_options,
                )
            for name, values in inputs.items():
                chunks = values.shape if values.size <= _LONG_INPUT else _input_chunks(values.shape, layout)
                input_options = {"shape": values.shape, "dtype": values.dtype, "chunks": chunks}
                group.create_array(f"inputs/{name}", **input_options, **array_options)[...] = values
            progress = group.create_group("progress")
            progress.create_array(
                "rows",
                shape=(layout.chunk_count, len(ChunkRow._fields)),
                dtype="f8",
                chunks=(1, len(ChunkRow._fields)),
                fill_value=np.nan,
                attributes={"columns": list(ChunkRow._fields)},
                **array_options,
            )
            progress.create_array(
                "expected", shape=expected.shape, dtype="f8", chunks=expected.shape, **array_options
            )[...] = expected
            group.attrs.update(attrs)
            progress.attrs[_IDENTITY] = {**identity, "variables": list(variables)}
        store = cls.open(path)
        assert store is not None
        return store

    def inputs(self) -> dict[str, Any]:
        """Return the parameters of the scenes by name. Long arrays that are stored in several chunks are read
        only when they are sliced."""
        group: Any = self.group["inputs"]
        with _explain_damage(self.path):
            return {
                name: array if array.size > _LONG_INPUT and array.chunks != array.shape else array[...]
                for name, array in group.arrays()
            }

    @property
    def expected(self) -> np.ndarray:
        """Expected trial steps of every chunk, shape (chunks,)."""
        array: Any = self.group["progress/expected"]
        with _explain_damage(self.path):
            return np.asarray(array[...])

    def rows(self) -> np.ndarray:
        """Return the rows of all chunks, shape (chunks, 4); NaN for unsolved chunks and damaged rows."""
        try:
            return np.asarray(self._rows[...])
        except DAMAGE:
            return np.stack([self._row_or_nan(k) for k in range(self.layout.chunk_count)])

    def row(self, k: int) -> ChunkRow | None:
        """Return the row of a chunk; None for an unsolved chunk or a damaged row."""
        row = ChunkRow(*map(float, self._row_or_nan(k)))
        return None if np.isnan(row.checksum) else row

    def _row_or_nan(self, k: int) -> np.ndarray:
        """Return the row of a chunk, shape (4,); NaN for an unsolved chunk or a damaged row."""
        try:
            return np.asarray(self._rows[k])
        except DAMAGE:
            return np.full(len(ChunkRow._fields), np.nan)

    def mark_unsolved(self, k: int) -> None:
        """Remove the row of a chunk."""
        self._rows[k] = np.full(len(ChunkRow._fields), np.nan)

    def is_intact(self, k: int, row: np.ndarray) -> bool:
        """Return True if the results of a chunk match the checksum in its row."""
        box = self.layout.box(k)
        try:
            return (
                checksum({name: np.asarray(self._arrays[name][box]) for name in self.variables})
                == ChunkRow(*row).checksum
            )
        except DAMAGE:
            return False

    def write(
        self, k: int, arrays: Mapping[str, np.ndarray], seconds: float, steps: float, failed: float
    ) -> ChunkRow:
        """Write the results of a chunk, and then its row.

        - `k`: index of the chunk
        - `arrays`: results by name, with the shape of the chunk
        - `seconds`: wall time [s]
        - `steps`: number of trial steps
        - `failed`: number of scenes that did not finish

        Returns the row. Raises `RuntimeError` if another sweep has replaced the store meanwhile.
        """
        with _explain_damage(self.path):
            identity = _read_identity(_zarr().open_group(zarr_store(self.path), mode="r"))
        if identity != self.identity:
            raise RuntimeError(
                f"{self.path}: another sweep has replaced this one; give each sweep a different path"
            )
        box = self.layout.box(k)
        arrays = {name: np.asarray(arrays[name]).astype(self._arrays[name].dtype) for name in self.variables}
        for name, values in arrays.items():
            self._arrays[name][box] = values
        row = ChunkRow(checksum(arrays), seconds, steps, failed)
        self._rows[k] = np.array(row)
        return row

    def dataset(self) -> xarray.Dataset:
        """Return the sweep as a lazy dataset. Unsolved scenes have the result `interrupted` and NaN in place
        of floating-point numbers (−1 in place of integers, False in place of booleans)."""
        import xarray

        with _explain_damage(self.path):
            return xarray.open_zarr(zarr_store(self.path), consolidated=False, chunks={})[self.variables]


def _read_identity(group: zarr.Group) -> dict[str, Any]:
    """Return the identity of the sweep in a zarr group; empty if there is none."""
    attrs: Any = group["progress"].attrs if "progress" in group else {}
    return dict(attrs.get(_IDENTITY, {}))


def _input_chunks(shape: tuple[int, ...], layout: ChunkLayout) -> tuple[int, ...]:
    """Return the shape of the chunks in which an input is stored.

    Along the axes of the grid, these chunks are as long as those of the results. An input without the axes of
    the grid is a single chunk.
    """
    grid_ndim = len(layout.shape)
    if any(n not in (1, m) for n, m in zip(shape, layout.shape, strict=False)) or len(shape) < grid_ndim:
        return shape
    return tuple(min(n, b) for n, b in zip(shape, layout.chunk_shape, strict=False)) + shape[grid_ndim:]


def _coord_chunks(array: xarray.Variable, chunk_lengths: Mapping[str, int]) -> tuple[int, ...]:
    names = [str(name) for name in array.dims]
    return tuple(
        n if len(names) == 1 and n < _LONG_INPUT else chunk_lengths[name]
        for name, n in zip(names, array.shape, strict=True)
    )


@contextlib.contextmanager
def _explain_damage(path: str) -> Iterator[None]:
    """Return a context that replaces zarr's errors about damaged metadata and arrays by a `ValueError`, which
    names the file, if it is known, and the remedy."""
    try:
        yield
    except (ValueError, KeyError, TypeError, RuntimeError) as error:
        damaged = _first_damaged_file(path) if is_local(path) else None
        if damaged is None and str(error).startswith(path):
            raise  # its message already names the store
        cause = f"{damaged} is damaged" if damaged else f"a part of it cannot be read ({error})"
        raise ValueError(
            f"{path}: {cause}, so this sweep cannot be resumed; restore the file from a copy, or move the "
            "store away and repeat the call to start again"
        ) from error


def _first_damaged_file(path: str) -> Path | None:
    """Return the first metadata file that is not valid JSON; None if all files are valid."""
    for file in sorted(Path(path).rglob("zarr.json")):
        try:
            json.loads(file.read_bytes())
        except ValueError:
            return file
    return None


def _codecs() -> list[Any]:
    """Return the codecs of all arrays: compression, and a checksum that zarr verifies on reading."""
    from zarr.codecs import BloscCodec, Crc32cCodec

    return [BloscCodec(cname="lz4", shuffle="shuffle"), Crc32cCodec()]


def compressed_size(arrays: Mapping[str, np.ndarray]) -> int:
    """Return the size that results have in a store after compression [bytes]."""
    zarr = _zarr()
    total = 0
    for values in arrays.values():
        values = values.reshape(-1)
        array = zarr.create_array(
            zarr.storage.MemoryStore(),
            shape=values.shape,
            dtype=values.dtype,
            chunks=values.shape,
            compressors=_codecs(),
        )
        array[...] = values
        total += array.nbytes_stored()
    return total


def require_zarr() -> None:
    """Raise `ImportError` if packages that sweeps need are not installed. The message names them."""
    missing = [name for name in ("zarr", "dask", "psutil") if importlib.util.find_spec(name) is None]
    if missing:
        raise ImportError(f"a sweep needs {', '.join(missing)}; install with: pip install 'rockjax[sweep]'")


def _zarr() -> Any:
    """Return the package zarr, which is imported only for sweeps."""
    import zarr

    return zarr
