"""Specification of a sweep: the numbers of its scenes, the names and labels of their axes, and the
options."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from rockjax._checks import as_strings, require_instance
from rockjax._motions.convert import as_batch
from rockjax._options import Options
from rockjax._parameters.table import variable_attributes
from rockjax._responses.arguments import as_end, as_start, check_range, check_types
from rockjax._responses.datasets import describe_versions
from rockjax._responses.sensitivities import of_scenes

from .scene_arrays import SceneArrays
from .store import FORMAT, ChunkLayout, Store, digest, fingerprint


class SweepSpec(NamedTuple):
    """The numbers of the scenes of a sweep, the names and labels of their axes, and the options to solve
    them."""

    numbers: SceneArrays
    dims: tuple[str, ...]
    labels: dict[str, np.ndarray]
    options: Options
    precision: bool
    sensitivities: tuple[str, ...] = ()

    @property
    def shape(self) -> tuple[int, ...]:
        return self.numbers.shape

    @property
    def scenes(self) -> int:
        return self.numbers.size

    def identity(self, layout: ChunkLayout) -> dict[str, Any]:
        """Return everything that identifies this sweep, as JSON."""
        left_out = ("throw", "history", "_stride")
        fields = [field.name for field in dataclasses.fields(Options) if field.name not in left_out]
        values = {name: getattr(self.options, name) for name in fields}
        entries = {
            "format": FORMAT,
            **{name: text for name, text in describe_versions().items() if name != "diffrax_version"},
            "precision": "float64" if self.precision else "float32",
            "kinds": str(jax.tree.structure(self.numbers.skeleton)),
            "dims": list(self.dims),
            "shape": list(self.shape),
            "chunk": list(layout.block),
            "numbers": {name: digest(y) for name, y in self.numbers.arrays.items()},
            "labels": {name: digest(y) for name, y in self.labels.items()},
            "options": {
                name: y if isinstance(y, str) else repr(_to_python_number(y)) for name, y in values.items()
            },
            "sensitivities": list(self.sensitivities),
        }
        return entries | {"fingerprint": fingerprint(entries)}


def _to_python_number(y: Any) -> Any:
    return y.item() if isinstance(y, jax.Array | np.ndarray | np.generic) else y


def make_study(
    structures, excitations, coords, initial, t_end, options: Options, outputs, sensitivities=()
) -> SweepSpec:
    """Return the specification of a sweep, from the arguments of [`rockjax.sweep`][].

    - `structures`, `excitations`, `coords`, `initial`, `t_end`, `options`, `outputs`, `sensitivities`: as for
      [`rockjax.sweep`][]

    Raises `ValueError` for invalid arguments.
    """
    require_instance("sweep", "options", options, Options, "rockjax.Options")
    options = options if outputs is None else options.replace(outputs=outputs)
    check_types("sweep", structures, options, "structures")
    excitations = as_batch("sweep", excitations)
    check_range("sweep", structures, excitations, None, options)
    if options.engine != "flat":
        raise ValueError(f"sweep: options.engine must be 'flat', got {options.engine!r}")
    initial, t_end = as_start("sweep", initial, structures), as_end("sweep", t_end)
    numbers = SceneArrays.of("sweep", structures.split(), excitations, initial, t_end)
    dims, labels = _axes(coords, numbers.shape)
    names = of_scenes("sweep", structures, excitations, sensitivities)
    return SweepSpec(numbers, dims, labels, options, bool(jax.config.jax_enable_x64), names)  # pyright: ignore[reportAttributeAccessIssue]


def _axes(coords, shape: tuple[int, ...]) -> tuple[tuple[str, ...], dict[str, np.ndarray]]:
    if coords is None:
        return ("scene",) if len(shape) == 1 else tuple(f"scene_{k}" for k in range(len(shape))), {}
    if isinstance(coords, str):
        raise ValueError(
            f"sweep: coords must be the names of the axes, got one text {coords!r}; give [{coords!r}]"
        )
    dims = as_strings("sweep", "coords", coords)
    if len(dims) != len(shape):
        raise ValueError(
            f"sweep: coords names {len(dims)} axes, {list(dims)}, but the scenes have the shape {shape}"
        )
    if len(set(dims)) < len(dims):
        raise ValueError(f"sweep: coords names an axis twice: {list(dims)}")
    labels = {name: np.asarray(y) for name, y in coords.items()} if isinstance(coords, Mapping) else {}
    for (name, y), n in zip(labels.items(), shape, strict=False):
        if y.shape != (n,):
            raise ValueError(f"sweep: coords[{name!r}] must hold {n} labels, got the shape {y.shape}")
    return dims, labels


def check_same(store: Store, study: SweepSpec, chunk: int | None) -> None:
    """Raise `ValueError` unless a store belongs to exactly this sweep."""
    layout = store.layout if chunk is None else ChunkLayout.of(study.shape, chunk)
    differences = list(_differences(store.identity, study.identity(layout)))
    if differences:
        raise ValueError(
            f"{store.path}: holds another sweep: "
            f"{'; '.join(differences[:4])}; give another path, remove it, or make the "
            "call that it was made with"
        )


def _differences(stored: Mapping[str, Any], requested: Mapping[str, Any]) -> Iterator[str]:
    """Describe the differences of two sweeps: numbers and labels by their names, all else by its values."""
    for name in requested:
        before, now = stored.get(name), requested.get(name)
        if isinstance(before, dict) and isinstance(now, dict):
            keys = [key for key in {**before, **now} if before.get(key) != now.get(key)]
            for key in keys:
                option_difference = f"options.{key}: {before.get(key)} there, {now.get(key)} here"
                yield option_difference if name == "options" else f"the {name} of {key} are others"
        elif before != now and name != "fingerprint":
            yield f"{name}: {before} there, {now} here"


def sweep_coords(study: SweepSpec) -> Iterator[tuple[str, Any]]:
    """Return the labels of the axes and of sensitivities, and every number that varies between scenes along
    the axes on which it does."""
    for name, labels in study.labels.items():
        axis_attrs = (
            {"units": "1", "long_name": "ground motion"} if name == "motion" else variable_attributes(name)
        )
        yield name, ((name,), labels, axis_attrs)
    if study.sensitivities:
        yield "parameter", ("parameter", np.array(study.sensitivities), {"long_name": "y of sensitivities"})
    taken = {*study.labels, *study.dims, "parameter"}
    for name, y in study.numbers.varying().items():
        short = name.rsplit(".", 1)[-1]
        dims = tuple(d for d, n in zip(study.dims, y.shape, strict=True) if n > 1)
        values = y.reshape([n for n in y.shape if n > 1])
        if dims == (short,) and np.array_equal(values, study.labels.get(short, [])):
            continue  # already the labels
        yield (name if short in taken else short), (dims, values, variable_attributes(name))
        taken.add(short)
