"""Specification of a sweep: parameters of its scenes, names and labels of its axes, and options.

A scene is one structure under one ground motion.
"""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from rockjax._checks import as_strings, format_value, require_instance
from rockjax._motions.convert import as_batch
from rockjax._options import Options
from rockjax._outputs.base import AbstractOutput
from rockjax._parameters.registry import variable_attributes
from rockjax._responses.arguments import as_end, as_start, check_range, check_types, warn_of_small_restitution
from rockjax._responses.datasets import describe_versions
from rockjax._responses.sensitivities import check_sensitivities

from .layout import ChunkLayout
from .scene_arrays import SceneArrays
from .store import FORMAT, GROUPS, Store, Variable, digest, fingerprint


class SweepSpec(NamedTuple):
    """Specification of a sweep."""

    scene_arrays: SceneArrays  # parameters of the scenes
    dims: tuple[str, ...]  # names of the axes
    labels: dict[str, np.ndarray]  # labels along the axes, by name
    options: Options
    is_float64: bool  # precision of the scenes: float64, otherwise float32
    sensitivities: tuple[str, ...] = ()  # parameters y for which y ∂/∂y of the peaks is computed
    label_attributes: Mapping[str, dict[str, str]] = {}  # attributes of the labels, by name of the axis

    @property
    def shape(self) -> tuple[int, ...]:
        return self.scene_arrays.shape

    @property
    def scenes(self) -> int:
        """Number of scenes."""
        return self.scene_arrays.size

    def identity(self, layout: ChunkLayout) -> dict[str, Any]:
        """Return the identity of this sweep: JSON values, equal only for sweeps with equal results."""
        excluded = ("throw", "history", "_stride")  # options that do not change results
        fields = [field.name for field in dataclasses.fields(Options) if field.name not in excluded]
        values = {name: getattr(self.options, name) for name in fields}
        entries = {
            "format": FORMAT,
            # Results do not depend on the version of Diffrax, from which the engine takes only coefficients.
            **{name: text for name, text in describe_versions().items() if name != "diffrax_version"},
            "precision": "float64" if self.is_float64 else "float32",
            "pytree": str(jax.tree.structure(self.scene_arrays.skeleton)),
            "dims": list(self.dims),
            "shape": list(self.shape),
            "chunk": list(layout.chunk_shape),
            "values": {name: digest(y) for name, y in self.scene_arrays.arrays.items()},
            "labels": {name: digest(y) for name, y in self.labels.items()},
            "options": {
                name: y if isinstance(y, str) else repr(_to_python_number(y)) for name, y in values.items()
            },
            "sensitivities": list(self.sensitivities),
            "user_outputs": [_output_digest(y) for y in self.options.outputs if not isinstance(y, str)],
        }
        if user_classes := self._user_classes():
            entries["user_classes"] = user_classes
        return entries | {"fingerprint": fingerprint(entries)}

    def _user_classes(self) -> list[str]:
        """Return the name and the source digest of each class of a user in the structures and excitations."""
        structure = jax.tree.structure(self.scene_arrays.skeleton[:2])
        classes = dict.fromkeys(y for y in _node_classes(structure) if not _is_own(y))
        return [f"{y.__qualname__} {_source_digest(y)}" for y in classes]


def _node_classes(structure: Any) -> Iterator[type]:
    """Yield the classes of the nodes of a pytree, from its root."""
    node = structure.node_data()
    if node is not None:
        yield node[0]
    for child in structure.children():
        yield from _node_classes(child)


def _is_own(y: type) -> bool:
    """Return whether a class is from rockjax or built in, and not from a user."""
    return y.__module__.startswith(("rockjax.", "builtins"))


def _source_digest(user_class: type) -> str:
    """Return a digest of the source code of a user's class and its base classes.

    A changed digest shows that the code has changed. Return "" if none of these classes has a source file.
    """
    sources = []
    for base in user_class.__mro__:
        if not _is_own(base):
            with contextlib.suppress(OSError, TypeError):
                sources.append(inspect.getsource(base))
    return fingerprint({"source": sources}) if sources else ""


def _output_digest(output: AbstractOutput) -> str:
    """Return the source digest of the class of a user's output, followed by its attributes if it has any."""
    attributes = [f" {name}={_attribute_text(y)}" for name, y in sorted(vars(output).items())]
    return _source_digest(type(output)) + "".join(attributes)


def _attribute_text(value: Any) -> str:
    """Return a text that is the same in every process for equal attributes of an output."""
    if isinstance(value, jax.Array | np.ndarray):
        return digest(np.asarray(value))
    return re.sub(r" at 0x[0-9a-fA-F]+", "", repr(value))  # addresses differ between processes


def _to_python_number(y: Any) -> Any:
    return y.item() if isinstance(y, jax.Array | np.ndarray | np.generic) else y


def make_spec(
    structures, excitations, coords, initial, t_end, options: Options, outputs, sensitivities=()
) -> SweepSpec:
    """Return the specification of a sweep.

    - `structures`, `excitations`, `coords`, `initial`, `t_end`, `options`, `outputs`, `sensitivities`: as for
      [`rockjax.sweep`][]

    Raises `ValueError` for invalid arguments.
    """
    require_instance("sweep", "options", options, Options, "rockjax.Options")
    options = options if outputs is None else options.replace(outputs=outputs)
    check_types("sweep", structures, options, "structures")
    warn_of_small_restitution(structures, stacklevel=4)
    excitations = as_batch("sweep", excitations)
    check_range("sweep", structures, excitations, t_end, options)
    if options.engine != "flat":
        raise ValueError(f"sweep: options.engine must be 'flat', got {options.engine!r}")
    initial, t_end = as_start("sweep", initial, structures), as_end("sweep", t_end)
    scene_arrays = SceneArrays.from_arguments("sweep", structures.split_rows(), excitations, initial, t_end)
    dims, labels = _axes(coords, scene_arrays.shape)
    names = check_sensitivities("sweep", structures, excitations, sensitivities)
    is_float64 = bool(jax.config.jax_enable_x64)  # pyright: ignore[reportAttributeAccessIssue]
    attributes = getattr(coords, "attributes", {})
    return SweepSpec(scene_arrays, dims, labels, options, is_float64, names, attributes)


def _axes(coords, shape: tuple[int, ...]) -> tuple[tuple[str, ...], dict[str, np.ndarray]]:
    """Return the names of the axes, and the labels along the axes by name."""
    if coords is None:
        return ("scene",) if len(shape) == 1 else tuple(f"scene_{k}" for k in range(len(shape))), {}
    if isinstance(coords, str):
        raise ValueError(
            f"sweep: coords must be a list of the names of the axes, got {coords!r}; give [{coords!r}]"
        )
    dims = as_strings("sweep", "coords", coords)
    for name in dims:
        if not isinstance(name, str) or not name or "/" in name:  # zarr would read a slash as a group
            raise ValueError(f"sweep: coords must name axes by strings without '/', got {name!r}")
    if len(dims) != len(shape):
        raise ValueError(
            f"sweep: coords must name each axis of the scenes, whose shape is {shape}, got {list(dims)}"
        )
    if len(set(dims)) < len(dims):
        raise ValueError(f"sweep: coords names an axis twice: {list(dims)}")
    labels = {name: _as_labels(name, y) for name, y in coords.items()} if isinstance(coords, Mapping) else {}
    for (name, y), n in zip(labels.items(), shape, strict=False):
        if y.shape != (n,):
            raise ValueError(f"sweep: coords[{name!r}] must have {n} labels, got shape {y.shape}")
    return dims, labels


def _as_labels(name: str, values) -> np.ndarray:
    """Return the labels of an axis as an array. Strings in an array of objects, such as those of pandas,
    become an array of strings, because the bytes of objects are addresses."""
    labels = np.asarray(values)
    if labels.dtype.kind not in "OT":
        return labels
    for label in labels.flat:
        if not isinstance(label, str):
            raise ValueError(
                f"sweep: coords[{name!r}] must be numbers, datetime64 or strings, got {format_value(label)} "
                "among them; convert the labels to strings"
            )
    return labels.astype(str)


def check_axis_names(dims: tuple[str, ...], variables: Mapping[str, Variable]) -> None:
    """Raise `ValueError` if the store needs the name of an axis for another purpose: for an array of answers,
    an axis of such an array, or a group.

    - `dims`: names of the axes of the sweep
    - `variables`: arrays of answers, by name
    """
    taken = {*variables, *(dim for y in variables.values() for dim in y.extra_dims), *GROUPS}
    for name in dims:
        if name in taken:
            raise ValueError(
                f"sweep: coords must not name an axis {name!r}, because the store uses this name; give "
                "another name"
            )


def check_same(store: Store, spec: SweepSpec, chunk: int | None) -> None:
    """Raise `ValueError` unless a store contains this sweep, in chunks of at most `chunk` scenes (of any size
    if `chunk` is None)."""
    layout = store.layout if chunk is None else ChunkLayout.from_chunk_size(spec.shape, chunk)
    differences = list(_differences(store.identity, spec.identity(layout)))
    if differences:
        raise ValueError(
            f"{store.path} contains another sweep ({'; '.join(differences[:4])}); give another path, remove "
            "the store, or repeat the call that created it"
        )


def _differences(stored: Mapping[str, Any], requested: Mapping[str, Any]) -> Iterator[str]:
    """Yield a description of each difference between two identities of sweeps."""

    def describe(name: str, old, new) -> str:
        return f"{name} is {old} in the store and {new} in this call"

    for name in requested:
        old, new = stored.get(name), requested.get(name)
        if isinstance(old, dict) and isinstance(new, dict):
            for key in {**old, **new}:
                if old.get(key) != new.get(key):
                    option_difference = describe(f"options.{key}", old.get(key), new.get(key))
                    yield option_difference if name == "options" else f"the {name} of {key} differ"
        elif old != new and name != "fingerprint":
            yield describe(name, old, new)


def sweep_coords(spec: SweepSpec) -> Iterator[tuple[str, Any]]:
    """Yield the coordinates of the dataset of a sweep: name and (dims, values, attributes).

    The coordinates are the labels of the axes, the names of the sensitivities, and the parameters that vary
    between scenes. A parameter has the dims of the axes along which it varies.
    """
    for name, labels in spec.labels.items():
        axis_attrs = (
            {"units": "1", "long_name": "ground motion"}
            if name == "motion"
            else spec.label_attributes.get(name) or variable_attributes(name)
        )
        yield name, ((name,), labels, axis_attrs)
    if spec.sensitivities:
        attrs = {"long_name": "parameter y of the sensitivities"}
        yield "parameter", ("parameter", np.array(spec.sensitivities), attrs)
    used_names = {*spec.labels, *spec.dims, "parameter"}
    for name, y in spec.scene_arrays.varying().items():
        short_name = name.rsplit(".", 1)[-1]
        dims = tuple(d for d, n in zip(spec.dims, y.shape, strict=True) if n > 1)
        values = y.reshape([n for n in y.shape if n > 1])
        if dims == (short_name,) and np.array_equal(values, spec.labels.get(short_name, [])):
            continue  # equal to the labels
        yield (name if short_name in used_names else short_name), (dims, values, variable_attributes(name))
        used_names.add(short_name)
