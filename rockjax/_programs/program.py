"""Functions that are traced and compiled once for each kind of arguments, in this process and in later ones."""

from __future__ import annotations

import contextlib
import functools
import logging
import pickle
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from . import folder, kind

_LOG = logging.getLogger("rockjax")
_PATIENCE = 2.0  # s of compiling, after which it is said
_WAITING = (
    "compiling a program for this kind of scene; it is kept, and the next time it is only loaded "
    '(logging.getLogger("rockjax").setLevel("ERROR") silences this)'
)


class Program:
    """A compiled function of pytrees of arrays and numbers; `fixed` names arguments that it is compiled for.

    Concrete arguments on the CPU run a program that is kept between processes (see `folder`): loading it needs neither
    tracing nor compiling, and it gives the same answers to the last bit. Everything else, traced arguments above all, goes
    through `traced`, which is `jax.jit` of the function.
    """

    def __init__(
        self,
        function: Callable,
        fixed: Sequence[str] = (),
        donate: Sequence[int] = (),
        compiler_options: dict[str, Any] | None = None,
    ):
        functools.update_wrapper(self, function)
        self.name = f"{function.__module__}.{function.__qualname__}"
        self._how = f"donated {tuple(donate)}, compiler options {compiler_options}"
        self._function, self._donate, self._options = function, tuple(donate), compiler_options
        self.traced = jax.jit(
            function, static_argnames=tuple(fixed), donate_argnums=self._donate, compiler_options=compiler_options
        )
        self._ready: dict[Hashable, Callable] = {}
        self._making: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()
        _ALL.append(self)

    def __call__(self, *arguments: Any, **fixed: Any) -> Any:
        leaves, structure = jax.tree.flatten(arguments)
        if not all(map(_is_here, leaves)) or not _usual():
            return self.traced(*arguments, **fixed)
        key = structure, tuple(map(jax.typeof, leaves)), tuple(sorted(fixed.items())), _present_settings()
        ready = self._ready.get(key) or self._make(key, arguments, fixed)
        return ready(*leaves)

    def _make(self, key: Hashable, arguments: tuple, fixed: dict[str, Any]) -> Callable:
        with self._lock:
            lock = self._making.setdefault(key, threading.Lock())
        with lock:  # one thread compiles, the others wait for it
            if key not in self._ready:
                self._ready[key] = self._kept(arguments, fixed)
            return self._ready[key]

    def _kept(self, arguments: tuple, fixed: dict[str, Any]) -> Callable:
        """The program of the leaves of its arguments, from the folder; compiled, and kept there, where there is none."""
        place = store()
        leaves, structure = jax.tree.flatten(arguments)
        text = self._text(structure, leaves, fixed) if place else None
        found = _load(place, text) if place and text else None
        if found is not None:
            return found
        with _said():
            lowered = self._of_leaves(structure, fixed).lower(*leaves)
            if place and not text:  # with classes of the user's own: known by what tracing has made of them
                text = f"{self.name}\n{self._how}\n{kind.machine()}\n{lowered.as_text()}"
                found = _load(place, text)
            compiled = found or lowered.compile()
        if place and text and found is None:
            _keep(place, text, compiled)
        return compiled

    def _of_leaves(self, structure: Any, fixed: dict[str, Any]) -> Any:
        def function(*leaves):
            return self._function(*jax.tree.unflatten(structure, leaves), **fixed)

        function.__name__ = self._function.__name__
        sizes = [part.num_leaves for part in structure.children()]
        donated = [sum(sizes[:k]) + i for k in self._donate for i in range(sizes[k])]
        return jax.jit(function, donate_argnums=donated, compiler_options=self._options)

    def _text(self, structure: Any, leaves: list, fixed: dict[str, Any]) -> str | None:
        try:
            what = f"{kind.describe(structure)}\n{kind.numbers(leaves)}\n{kind.describe(fixed)}"
            return f"{self.name}\n{self._how}\n{kind.source()}\n{kind.machine()}\n{what}"
        except kind.Unknown as unknown:
            _LOG.debug("%s is traced in every process: no name in all of them has %s", self.name, unknown)
            return None

    def forget(self) -> None:
        """Let go of what this process holds."""
        with self._lock:
            self._ready.clear()
            self._making.clear()


_ALL: list[Program] = []


def forget() -> None:
    """Let go of all programs that this process holds; those in the folder stay."""
    for program in _ALL:
        program.forget()


def store() -> Path | None:
    """The folder of kept programs; None where none are kept."""
    return folder.path() / "programs" if folder.enabled() else None


def _load(place: Path, text: str) -> Callable | None:
    """A kept program. Whatever is wrong with it, it is compiled again."""
    from jax.experimental.serialize_executable import deserialize_and_load

    try:
        content = folder.read(place, text)
    except folder.Damaged as damaged:
        _LOG.debug("%s", damaged)
        folder.discard(place, text)
        return None
    except OSError as error:
        _LOG.debug("no kept programs are read: %s", error)
        return None
    if content is None:
        return None
    try:
        program, arguments, answers = pickle.loads(content)
        return deserialize_and_load(program, arguments, answers, execution_devices=[_device()])
    except Exception as error:  # another library's format, a class that is no longer there
        _LOG.debug("a kept program cannot be loaded: %r", error)
        folder.discard(place, text)
        return None


def _keep(place: Path, text: str, compiled: Any) -> None:
    """Keep a program, where that is possible."""
    from jax.experimental.serialize_executable import serialize

    try:
        folder.write(place, text, pickle.dumps(serialize(compiled)))
    except Exception as error:  # a full disk; a program with what cannot be kept in it
        _LOG.debug("a program cannot be kept: %r", error)


@functools.cache
def _device() -> Any:
    return jax.local_devices(backend="cpu")[0]


@functools.cache
def _sharding() -> jax.sharding.Sharding:
    return jax.sharding.SingleDeviceSharding(_device())


def _is_here(leaf: Any) -> bool:
    """Whether it is a number or array on the CPU that programs are kept for."""
    if isinstance(leaf, jax.Array):
        return not isinstance(leaf, Tracer) and leaf.sharding == _sharding()
    return isinstance(leaf, np.ndarray | np.generic | bool | int | float)


def _usual() -> bool:
    """Whether programs run as usual: on one CPU, and not looked into by one of JAX's settings for debugging."""
    settings: Any = jax.config
    chosen = settings.jax_default_device
    if jax.default_backend() != "cpu" or not (chosen is None or chosen == "cpu" or chosen == _device()):
        return False
    unusual = settings.jax_disable_jit, settings.jax_debug_nans, settings.jax_debug_infs, settings.jax_check_tracer_leaks
    return not any(unusual) and jax.process_count() == 1


def _present_settings() -> Hashable:
    """Settings that a program is traced under and that may change within a process."""
    settings: Any = jax.config
    return (
        settings.jax_enable_x64,
        settings.jax_default_matmul_precision,
        settings.jax_numpy_dtype_promotion,
        settings.jax_numpy_rank_promotion,
    )


@contextlib.contextmanager
def _said() -> Iterator[None]:
    """Say, once in a process, that what takes so long is compiling."""
    timer = threading.Timer(_PATIENCE, _say)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@functools.cache
def _say() -> None:
    _LOG.warning(_WAITING)
