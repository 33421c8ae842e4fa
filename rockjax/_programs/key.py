"""Keys of stored programs, as strings: equal keys mean the same program, in every process.

A key contains the structure of the arguments (classes, static fields, shapes and types of arrays and
numbers), the versions of the libraries, a hash of the source of `rockjax` and `optimise`, JAX's settings, and
the processor. User-defined classes and functions have no key, because the same name may mean other code in
another process. `program.py` identifies programs with such arguments by the text of the lowered program. A
user-defined function that is wrapped in `TracedFunction` has a key.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import sys
import time
from collections.abc import Callable, Iterable
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType
from typing import Any

import jax
import numpy as np

_OWN_PACKAGES = ("rockjax", "optimise")  # identified by their source
_LIBRARIES = ("jax", "jaxlib", "numpy", "equinox", "diffrax", "optimistix", "lineax")  # identified by version
_FOLDERS_WITHOUT_PROGRAMS = ("_cli", "plots")  # folders whose source affects no compiled program
# Entries of /proc/cpuinfo that identify the processor.
_PROCESSOR = ("vendor_id", "cpu family", "model", "model name", "stepping", "flags", "features", "cpu part")
# JAX's settings are ignored if their name contains one of these words.
_IGNORED_SETTINGS = ("cache", "log", "dump", "traceback", "profil", "hash")
_IMPORTED = time.time()  # a source file that was changed later may differ from the code of this process


class NoKeyError(Exception):
    """Raised for an object that has no key."""


class TracedFunction:
    """A user-defined function that has a key: the text of the lowered program of the function and its
    derivative. A function that calls Python (`jax.pure_callback`) has no key, because the text does not
    contain the called function; it equals only itself.

    - `function`: the function
    - `examples`: example arguments for lowering, pytrees of arrays or of `jax.ShapeDtypeStruct`. The function
      may also be called with other shapes
    """

    def __init__(self, function: Callable, *examples: Any):
        def with_derivatives(*primals):
            return jax.jvp(function, primals, primals)

        self.function = function
        self.text = jax.jit(with_derivatives).lower(*examples).as_text()

    def __call__(self, *arguments: Any) -> Any:
        return self.function(*arguments)

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        return isinstance(other, TracedFunction) and self.text == other.text and not calls_python(self.text)

    def __hash__(self) -> int:
        return hash(self.text)


def calls_python(text: str) -> bool:
    """Return whether the text of a lowered program contains a call of a Python function."""
    return "callback" in text


def describe(value: Any) -> str:
    """Return the key of a static value. Raises `NoKeyError` for a value without a key."""
    if value is None:
        return "None"
    if isinstance(value, TracedFunction):
        if calls_python(value.text):
            raise NoKeyError(f"{value.function!r} calls Python")
        return f"traced:{value.text}"
    if isinstance(value, type | FunctionType):
        return _qualified_name(value)
    if isinstance(value, np.dtype):
        return value.str
    if isinstance(value, jax.tree_util.PyTreeDef):
        return _structure(value)
    name = _qualified_name(type(value))
    if isinstance(value, bool | int | float | complex | str | bytes | np.generic):
        return f"{name}:{value!r}"
    if isinstance(value, tuple | list | frozenset):
        parts = map(describe, value)
        return f"{name}({','.join(sorted(parts) if isinstance(value, frozenset) else parts)})"
    if isinstance(value, dict):
        return f"{name}({','.join(f'{describe(k)}={describe(v)}' for k, v in value.items())})"
    # Objects of classes not written in Python, such as `range`, have no `__dict__`, but may hide fields.
    has_slots = any(getattr(base, "__slots__", ()) for base in type(value).__mro__)
    if type(value) is not object and (getattr(value, "__dict__", None) != {} or has_slots):
        raise NoKeyError(f"{value!r}")
    return f"{name}()"  # an object without fields


def _qualified_name(obj: Any) -> str:
    """Return the full name of a class or function.

    Raises `NoKeyError` if the object cannot be imported by that name, such as a local function, or if its
    package is not identified by source or version.
    """
    module, name = obj.__module__ or "", obj.__qualname__  # the module is None for code run by `exec`
    importable = sys.modules.get(module)
    for attribute in name.split("."):
        importable = getattr(importable, attribute, None)
    if module.split(".")[0] not in (*_OWN_PACKAGES, *_LIBRARIES, "builtins") or importable is not obj:
        raise NoKeyError(f"{module}.{name}")
    return f"{module}.{name}"


def _structure(tree: Any) -> str:
    """Return the key of a tree structure."""
    node = tree.node_data()
    if node is None:
        return "*" if tree.num_leaves else "-"
    node_type, static = node
    children = ",".join(map(_structure, tree.children()))
    return (
        "None" if node_type is type(None) else f"{_qualified_name(node_type)}[{describe(static)}]({children})"
    )


def describe_shapes(leaves: Iterable[Any]) -> str:
    """Return the shapes and types of arrays and numbers as a string."""
    types = map(jax.typeof, leaves)
    return ";".join(f"{type_.dtype}{type_.shape}{'~' if type_.weak_type else ''}" for type_ in types)


def describe_machine() -> str:
    """Return a string with the versions, settings and processor on which a compiled program depends."""
    settings = [
        (name, getattr(jax.config, name, value))
        for name, value in sorted(jax.config.values.items())
        if not any(word in name for word in _IGNORED_SETTINGS)
    ]
    return f"{_describe_versions()}\n{os.environ.get('XLA_FLAGS', '')} {settings!r}"


@functools.cache
def _describe_versions() -> str:
    device = jax.local_devices(backend="cpu")[0]
    libraries = [f"{name} {version(name)}" for name in _LIBRARIES]
    # The compiled program may use all features of the processor. If the features are unknown, the key
    # contains the name of the machine instead.
    try:
        lines = Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()
        processor = [line for line in lines if line.split(":")[0].strip().lower() in _PROCESSOR]
    except OSError:
        processor = []
    processor = processor or [platform.processor(), platform.node()]
    return f"{libraries} {sys.version}\n{platform.system()} {platform.machine()} {processor} " + (
        f"{device.device_kind} {device.client.platform_version}"
    )


@functools.cache
def source_hash() -> str:
    """Return a hash of the source and the JSON tables of `rockjax` and `optimise`, except the folders
    `_FOLDERS_WITHOUT_PROGRAMS`. Raises `NoKeyError` if a package has no source files, or if a file was
    changed after this process had imported rockjax."""
    digest = hashlib.sha256()
    for package in _OWN_PACKAGES:
        spec = find_spec(package)
        origin = spec.origin if spec else None
        if origin is None or not Path(origin).is_file():
            raise NoKeyError(f"no source of {package}")
        folder = Path(origin).parent
        for file in sorted([*folder.rglob("*.py"), *folder.glob("*/*.json")]):
            path = file.relative_to(folder)
            if path.parts[0] not in _FOLDERS_WITHOUT_PROGRAMS:
                if file.stat().st_mtime > _IMPORTED:
                    raise NoKeyError(f"{file} was changed during this process")
                digest.update(f"{package}/{path.as_posix()}\0".encode())
                digest.update(file.read_bytes())
    return digest.hexdigest()
