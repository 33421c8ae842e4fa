"""The zarr store of a sweep: arrays that xarray opens, in chunks of scenes that are written one by one.

The root contains the results, one array for each, with the axes of the sweep as dimensions. The group
`inputs` contains every number of the scenes; the group `progress` one row for each chunk, written after the
chunk's results. A chunk without a row is missing, and one whose results do not match the row's checksum is
damaged. Every process writes the same bytes for a chunk, so it may be written twice, by two processes at
once, or again after a fault.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import json
import math
import os
import shutil
import tempfile
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rockjax import _results as results

if TYPE_CHECKING:
    import xarray
    import zarr

Box = tuple[slice, ...]
FORMAT = 1
_IDENTITY = "sweep"  # attribute with everything that identifies a sweep
_LONG_INPUT = 1_000_000  # inputs with more entries than this are stored in chunks


class TakenError(Exception):
    """Raised if another process was the first to make a store at a path."""


class ChunkRecord(NamedTuple):
    """Record of a finished chunk: checksum, wall time [s], trial steps, and number of scenes that did not
    finish."""

    checksum: float
    seconds: float
    steps: float
    failed: float


class ChunkLayout(NamedTuple):
    """A grid of scenes divided into chunks: boxes that follow each other in the order of the scenes.

    - `shape`: scenes along each axis; `block`: those of a chunk
    """

    shape: tuple[int, ...]
    block: tuple[int, ...]

    @classmethod
    def of(cls, shape: Sequence[int], chunk: int) -> ChunkLayout:
        """Return chunks of at most `chunk` scenes, and about as many: the last axes in full, the first one by
        one."""
        block, remaining = [], max(1, chunk)
        for n in reversed(shape):
            block.append(min(n, remaining))
            remaining = remaining // n if remaining >= n else 1
        return cls(tuple(shape), tuple(reversed(block)))

    @property
    def chunks_along(self) -> tuple[int, ...]:
        return tuple(-(-n // b) for n, b in zip(self.shape, self.block, strict=True))

    @property
    def number(self) -> int:
        """Number of chunks."""
        return math.prod(self.chunks_along)

    def box(self, k: int) -> Box:
        """Return the part of the grid that is chunk k."""
        corner = np.unravel_index(k, self.chunks_along)
        starts = [int(j) * b for j, b in zip(corner, self.block, strict=True)]
        return tuple(slice(i, min(i + b, n)) for i, b, n in zip(starts, self.block, self.shape, strict=True))

    def sizes(self) -> np.ndarray:
        """Return the number of scenes in every chunk, shape (number,)."""
        axis_sizes = [
            np.minimum(b, n - b * np.arange(m))
            for n, b, m in zip(self.shape, self.block, self.chunks_along, strict=True)
        ]
        return np.prod(np.meshgrid(*axis_sizes, indexing="ij"), axis=0).reshape(-1)

    def chunk_of(self, scenes: np.ndarray) -> np.ndarray:
        """Return the chunks that contain scenes, by the indices of the scenes in the order of the grid."""
        place = np.unravel_index(scenes, self.shape)
        return np.ravel_multi_index(
            [j // b for j, b in zip(place, self.block, strict=True)], self.chunks_along
        )


class Variable(NamedTuple):
    """A result: its type, the attributes of its array, and its further axes besides those of the grid, with
    their lengths."""

    dtype: np.dtype
    attrs: dict[str, Any]
    extra_dims: dict[str, int]

    @property
    def fill_value(self) -> Any:
        """Value that marks a scene that has not been solved."""
        if "flag_meanings" in self.attrs:
            return results.INTERRUPTED
        return {"f": np.nan, "b": False, "i": -1}[self.dtype.kind]


def variable_for(values: np.ndarray, attrs: Mapping[str, Any], extra_dims: Sequence[str]) -> Variable:
    """Return the variable in which results of a table of scenes are stored; counts do not need 64 bits."""
    dtype = np.dtype(np.int32) if values.dtype.kind == "i" and values.dtype.itemsize > 4 else values.dtype
    plain_attrs = {name: y.tolist() if isinstance(y, np.ndarray) else y for name, y in attrs.items()}
    return Variable(dtype, plain_attrs, dict(zip(extra_dims, values.shape[1:], strict=True)))


def checksum(parts: Mapping[str, np.ndarray]) -> float:
    """Return the CRC-32 of the results of a chunk, in the order of their names."""
    crc = 0
    for name in sorted(parts):
        crc = zlib.crc32(np.ascontiguousarray(parts[name]).view(np.uint8), crc)
    return float(crc)


def fingerprint(identity: Mapping[str, Any]) -> str:
    """Return a text that identifies a sweep."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]


def digest(y: np.ndarray) -> str:
    """Return a text that identifies the numbers of an array."""
    y = np.ascontiguousarray(y)
    return f"{y.dtype.str}{list(y.shape)} {hashlib.sha256(y.tobytes()).hexdigest()[:16]}"


class Store:
    """An open store. `identity` identifies its sweep, as JSON."""

    def __init__(self, path: str, group: zarr.Group):
        self.path = path
        self.group = group
        self.identity: dict[str, Any] = _read_identity(group)
        self.layout = ChunkLayout(tuple(self.identity["shape"]), tuple(self.identity["chunk"]))
        self.variables: list[str] = list(self.identity["variables"])
        self._arrays: dict[str, Any] = {name: group[name] for name in self.variables}
        self._rows: Any = group["progress/rows"]

    @classmethod
    def open(cls, path: str | Path) -> Store | None:
        """Return the store at a path, None if there is nothing.

        Raises `ValueError` if there is something else, and if the metadata of the store cannot be read.
        """
        path = expand_path(path)
        if is_local(path) and not Path(path).exists():
            return None
        foreign = ValueError(f"{path}: exists and is no store of a sweep; give another path, or remove it")
        if is_local(path) and not Path(path).is_dir():
            raise foreign
        with _explain_damage(path):
            try:
                group = _zarr().open_group(_zarr_store(path), mode="r+")
            except FileNotFoundError:
                if is_local(path) and any(Path(path).iterdir()):
                    raise foreign from None
                return None
            if _read_identity(group):
                return cls(path, group)
        raise ValueError(
            f"{path}: is a zarr store, but not of a whole sweep; give another path, or remove it"
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
        - `identity`: everything that identifies the sweep, with `shape` and `chunk`
        - `dims`: names of the axes; `coords`: their coordinates
        - `variables`: results, by name
        - `inputs`: numbers of the scenes, by name
        - `expected`: expected trial steps of every chunk, (chunks,)
        - `attrs`: attributes of the dataset

        Raises `TakenError` if another process was faster; its store is left unchanged.
        """
        path = expand_path(path)
        zarr = _zarr()
        layout = ChunkLayout(tuple(identity["shape"]), tuple(identity["chunk"]))
        with _atomic_folder(path) as temporary:
            blocks = dict(zip(dims, layout.block, strict=True))
            # Axes are stored in full, numbers of every scene in the chunks of the results.
            coord_encoding = {
                name: {"chunks": _coord_chunks(array, blocks)} for name, array in coords.variables.items()
            }
            zarr_store = _zarr_store(temporary)
            coords.to_zarr(zarr_store, mode="w", zarr_format=3, consolidated=False, encoding=coord_encoding)
            group = zarr.open_group(zarr_store, mode="r+")
            array_options: Any = {"compressors": _codecs()}
            for name, variable in variables.items():
                group.create_array(
                    name,
                    shape=(*layout.shape, *variable.extra_dims.values()),
                    dtype=variable.dtype,
                    chunks=(*layout.block, *variable.extra_dims.values()),
                    fill_value=variable.fill_value,
                    dimension_names=(*dims, *variable.extra_dims),
                    attributes=variable.attrs,
                    **array_options,
                )
            for name, values in inputs.items():
                size = values.shape if values.size <= _LONG_INPUT else _input_chunks(values.shape, layout)
                input_options = {"shape": values.shape, "dtype": values.dtype, "chunks": size}
                group.create_array(f"inputs/{name}", **input_options, **array_options)[...] = values
            progress = group.create_group("progress")
            progress.create_array(
                "rows",
                shape=(layout.number, len(ChunkRecord._fields)),
                dtype="f8",
                chunks=(1, len(ChunkRecord._fields)),
                fill_value=np.nan,
                attributes={"columns": list(ChunkRecord._fields)},
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
        """Return the numbers of the scenes; long arrays stay in the store until they are sliced."""
        group: Any = self.group["inputs"]
        return {
            name: array if array.size > _LONG_INPUT and array.chunks != array.shape else array[...]
            for name, array in group.arrays()
        }

    @property
    def expected(self) -> np.ndarray:
        """Return the expected trial steps of every chunk, shape (chunks,)."""
        array: Any = self.group["progress/expected"]
        return np.asarray(array[...])

    def rows(self) -> np.ndarray:
        """Return the `ChunkRecord` of every chunk, NaN for those that are not done, shape (chunks, 4)."""
        return np.asarray(self._rows[...])

    def row(self, k: int) -> ChunkRecord | None:
        """Return the row of a chunk, None if it is not done."""
        row = ChunkRecord(*map(float, self._rows[k]))
        return None if np.isnan(row.checksum) else row

    def forget(self, k: int) -> None:
        """Mark a chunk as not done, so that it is solved again."""
        self._rows[k] = np.full(len(ChunkRecord._fields), np.nan)

    def is_intact(self, k: int, row: np.ndarray) -> bool:
        """Return whether the results of a chunk match the checksum in its row."""
        box = self.layout.box(k)
        try:
            return (
                checksum({name: np.asarray(self._arrays[name][box]) for name in self.variables})
                == ChunkRecord(*row).checksum
            )
        except (
            OSError,
            RuntimeError,
            ValueError,
        ):  # zarr's codecs raise these for damaged bytes
            return False

    def write(
        self, k: int, parts: Mapping[str, np.ndarray], seconds: float, steps: float, failed: float
    ) -> ChunkRecord:
        """Write the results of a chunk, and then its row.

        - `k`: index of the chunk
        - `parts`: results by name, of the shape of the chunk
        - `seconds`: wall time [s]; `steps`: trial steps; `failed`: number of scenes that did not finish

        Returns the row. Raises `RuntimeError` if another sweep has replaced the store meanwhile.
        """
        with _explain_damage(self.path):
            identity = _read_identity(_zarr().open_group(_zarr_store(self.path), mode="r"))
        if identity != self.identity:
            raise RuntimeError(
                f"{self.path}: another sweep has replaced this one; give each sweep a path of its own"
            )
        box = self.layout.box(k)
        parts = {name: np.asarray(parts[name]).astype(self._arrays[name].dtype) for name in self.variables}
        for name, values in parts.items():
            self._arrays[name][box] = values
        row = ChunkRecord(checksum(parts), seconds, steps, failed)
        self._rows[k] = np.array(row)
        return row

    def dataset(self) -> xarray.Dataset:
        """Return the sweep as a lazy dataset; scenes that have not been solved are NaN with the result
        `interrupted`."""
        import xarray

        with _explain_damage(self.path):
            return xarray.open_zarr(_zarr_store(self.path), consolidated=False, chunks={})[self.variables]


def _read_identity(group: zarr.Group) -> dict[str, Any]:
    """Return the identity of the sweep of a store; empty for other stores, and for an incomplete one."""
    attrs: Any = group["progress"].attrs if "progress" in group else {}
    return dict(attrs.get(_IDENTITY, {}))


def _input_chunks(shape: tuple[int, ...], layout: ChunkLayout) -> tuple[int, ...]:
    """Return chunks for numbers whose first axes are those of the grid, aligned with the chunks of the
    results; others are not divided."""
    axes = len(layout.shape)
    if any(n not in (1, m) for n, m in zip(shape, layout.shape, strict=False)) or len(shape) < axes:
        return shape
    return tuple(min(n, b) for n, b in zip(shape, layout.block, strict=False)) + shape[axes:]


def _coord_chunks(array: xarray.Variable, blocks: Mapping[str, int]) -> tuple[int, ...]:
    names = [str(name) for name in array.dims]
    return tuple(
        n if len(names) == 1 and n < _LONG_INPUT else blocks[name]
        for name, n in zip(names, array.shape, strict=True)
    )


def expand_path(path: str | Path) -> str:
    """Return a path as text with the home folder in place of `~`; URLs other than of files are unchanged."""
    text = str(path).removeprefix("file://")
    return os.path.expanduser(text) if is_local(text) else text


def is_local(path: str) -> bool:
    return "://" not in path


def require_creatable(path: str | Path) -> None:
    """Raise `OSError` if no store can be made at a path: tested by making a folder of that name and removing
    it."""
    path = expand_path(path)
    if not is_local(path):
        return
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError):  # another process is making the store
            os.mkdir(path)
            with contextlib.suppress(OSError):
                os.rmdir(path)
    except (OSError, ValueError) as error:
        raise OSError(f"{path} could not be written: {getattr(error, 'strerror', None) or error}") from error


def _zarr_store(path: str) -> Any:
    """Return the store object that zarr and xarray open at a path; as plain text they would parse it as a
    URL, at `#`, `?` and `:`."""
    if not is_local(path):
        return path
    from zarr.storage import LocalStore

    return LocalStore(path)


@contextlib.contextmanager
def _atomic_folder(path: str) -> Iterator[str]:
    """Provide a folder beside the target, which is renamed to it once complete. (Behind a URL the attributes
    are written last.)"""
    if not is_local(path):
        yield path
        return
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = tempfile.mkdtemp(prefix=".sweep-", dir=target.parent)  # short: names have at most 255 bytes
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o777 & ~umask)
        _rename(temporary, target)
    except BaseException as error:
        _remove(temporary)
        if isinstance(error, OSError):
            raise OSError(f"{path} could not be written: {error.strerror or error}") from error
        raise


def _remove(folder: str) -> None:
    """Remove a folder into which threads of zarr may still be writing: they may create it again, so it has to
    stay away for a while."""
    absent = 0
    for _ in range(60):
        shutil.rmtree(folder, ignore_errors=True)
        absent = 0 if os.path.exists(folder) else absent + 1
        if absent == 6:
            return
        time.sleep(0.05)


def _rename(temporary: str, target: Path) -> None:
    """Rename a folder to the target. Raises `TakenError` if the target has been created meanwhile."""
    try:
        os.rename(temporary, target)
    except OSError as error:
        # Linux reports that the folder is not empty, other systems that it exists, or that access is denied.
        if target.is_dir() and any(target.iterdir()):
            raise TakenError(target) from error
        raise


@contextlib.contextmanager
def _explain_damage(path: str) -> Iterator[None]:
    """Raise `ValueError` that names the store, the file and the cure for metadata that zarr cannot read."""
    try:
        yield
    except (ValueError, KeyError, TypeError) as error:
        damaged = _first_damaged_file(path) if is_local(path) else None
        if damaged is None and str(error).startswith(path):
            raise  # already a clear message
        cause = f"{damaged} is damaged" if damaged else f"its metadata cannot be read ({error})"
        raise ValueError(
            f"{path}: {cause}, so that this sweep cannot be gone on with; put the file back from a copy, or "
            f"move "
            "the store away: the same call then begins a new one"
        ) from error


def _first_damaged_file(path: str) -> Path | None:
    """Return the first metadata file that is not JSON."""
    for file in sorted(Path(path).rglob("zarr.json")):
        try:
            json.loads(file.read_bytes())
        except ValueError:
            return file
    return None


def _codecs() -> list[Any]:
    """Return the codecs: compression, and a checksum that zarr verifies when it reads a chunk.

    LZ4 on shuffled bytes compresses these results as well as Zstandard does, and is faster.
    """
    from zarr.codecs import BloscCodec, Crc32cCodec

    return [BloscCodec(cname="lz4", shuffle="shuffle"), Crc32cCodec()]


def compressed_size(parts: Mapping[str, np.ndarray]) -> int:
    """Return the number of bytes that results take in a store."""
    zarr = _zarr()
    total = 0
    for values in parts.values():
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
    """Raise `ImportError` that names the packages to install, if some are missing."""
    missing = [name for name in ("zarr", "dask", "psutil") if importlib.util.find_spec(name) is None]
    if missing:
        raise ImportError(f"a sweep needs {', '.join(missing)}; install with: pip install 'rockjax[sweep]'")


def _zarr() -> Any:
    import zarr

    return zarr
