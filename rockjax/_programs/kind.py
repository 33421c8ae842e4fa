"""What a kept program was made for, as text: equal texts mean the same program, and all that goes into one is
in it.

A kind of scene is the structure of its arguments (classes, what is fixed in them, shapes and types of their
numbers), the versions of the libraries and the source of this package, the settings of JAX, and the
processor. Classes and functions of the user's own have no such text: they may change from one process to the
next without their names changing.
"""

from __future__ import annotations

import enum
import functools
import hashlib
import os
import platform
import sys
from collections.abc import Callable, Iterable
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType
from typing import Any

import jax
import numpy as np

# What stands in these is in the text by their source, and what stands in those by their versions.
_OWN = ("rockjax", "optimise")
_LIBRARIES = ("jax", "jaxlib", "numpy", "equinox", "diffrax", "optimistix", "lineax")
_WITHOUT = ("_cli", "plots")  # folders whose source is in no program
# In the names of JAX's settings that do not change a program.
_SAY_NOTHING = ("cache", "log", "dump", "traceback", "profil", "hash")


class Unknown(Exception):
    """Something has no text that means the same in every process."""


class TracedFunction:
    """A function of the user's own that is known in every process: by what tracing makes of it and of its
    derivatives.

    `like` are trees of arrays of numbers, or of their shapes, that it is given. Whoever gives it others still
    gets the right answer, under the name that belongs to these.
    """

    def __init__(self, function: Callable, *like: Any):
        def with_derivatives(*primals):
            return jax.jvp(function, primals, primals)

        self.function = function
        self.text = jax.jit(with_derivatives).lower(*like).as_text()

    def __call__(self, *arguments: Any) -> Any:
        return self.function(*arguments)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, TracedFunction) and self.text == other.text

    def __hash__(self) -> int:
        return hash(self.text)


def describe(value: Any) -> str:
    """A fixed part of the arguments as text. Raises `Unknown` for what may differ from process to process."""
    if isinstance(value, TracedFunction):
        return f"traced:{value.text}"
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        if type(value).__module__ != "builtins" and not isinstance(value, enum.Enum):
            raise Unknown(f"{value!r}")
        return f"{type(value).__name__}:{value!r}"
    if isinstance(value, type | FunctionType):
        return _name(value)
    if isinstance(value, np.dtype):
        return f"dtype:{value.str}"
    if isinstance(value, jax.tree_util.PyTreeDef):
        return _structure(value)
    if isinstance(value, tuple | list | frozenset):
        parts = [describe(part) for part in value]
        parts = sorted(parts) if isinstance(value, frozenset) else parts
        kind = type(value).__name__ if type(value).__module__ == "builtins" else _name(type(value))
        return f"{kind}({','.join(parts)})"
    if isinstance(value, dict):
        return f"dict({','.join(f'{describe(k)}={describe(v)}' for k, v in value.items())})"
    if not getattr(value, "__dict__", None) and not _slots(type(value)):
        return f"{_name(type(value))}()"  # nothing in it
    raise Unknown(f"{value!r}")


def _slots(kind: type) -> bool:
    return any(getattr(base, "__slots__", ()) for base in kind.__mro__)


def _name(thing: Any) -> str:
    """The name of a class or function at the top of a module whose source is known."""
    module, name = thing.__module__ or "", thing.__qualname__  # None in code that is run from a text
    found = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    if module.split(".")[0] not in (*_OWN, *_LIBRARIES, "builtins") or found is not thing:
        raise Unknown(f"{module}.{name}")
    return f"{module}.{name}"


def _structure(tree: Any) -> str:
    node = tree.node_data()
    if node is None:
        return "*" if tree.num_leaves else "-"
    kind, fixed = node
    if kind is type(None):
        return "None"
    children = ",".join(_structure(child) for child in tree.children())
    return f"{_name(kind)}[{describe(fixed)}]({children})"


def numbers(leaves: Iterable[Any]) -> str:
    """Shapes and types of arrays and numbers."""
    kinds = map(jax.typeof, leaves)
    return ";".join(f"{kind.dtype}{kind.shape}{'~' if kind.weak_type else ''}" for kind in kinds)


def machine() -> str:
    """What a program depends on besides what is traced: versions, settings, processor."""
    return f"{_made_of()}\n{_settings()}"


def _settings() -> str:
    settings = [
        (name, getattr(jax.config, name, value))
        for name, value in sorted(jax.config.values.items())
        if not any(w in name for w in _SAY_NOTHING)
    ]
    return f"{os.environ.get('XLA_FLAGS', '')} {settings!r}"


@functools.cache
def _made_of() -> str:
    device = jax.local_devices(backend="cpu")[0]
    versions = [f"{name} {version(name)}" for name in _LIBRARIES]
    runs_on = f"{device.platform} {device.device_kind} {device.client.platform_version} {_processor()}"
    return f"{versions} {sys.version}\n{runs_on}"


@functools.cache
def source() -> str:
    """A hash of the package's source, numbers in files beside it included. Raises `Unknown` where there is
    none to read."""
    digest = hashlib.sha256()
    for package in _OWN:
        spec = find_spec(package)
        origin = spec.origin if spec else None
        if origin is None or not Path(origin).is_file():
            raise Unknown(f"no source of {package}")
        folder = Path(origin).parent
        for name in sorted([*folder.rglob("*.py"), *folder.glob("*/*.json")]):
            part = name.relative_to(folder)
            if part.parts[0] not in _WITHOUT:
                digest.update(f"{package}/{part.as_posix()}\0".encode())
                digest.update(name.read_bytes())
    return digest.hexdigest()


def _processor() -> str:
    """What a compiler looks at of this machine; where that is not known, the machine itself."""
    try:
        lines = Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()
        wanted = (
            "vendor_id",
            "cpu family",
            "model",
            "stepping",
            "flags",
            "features",
            "cpu implementer",
            "cpu part",
        )
        found = [line for line in lines if line.split(":")[0].strip().lower() in (*wanted, "model name")]
    except OSError:
        found = []
    return f"{platform.system()} {platform.machine()} " + (
        " ".join(found) or f"{platform.processor()} {platform.node()}"
    )
