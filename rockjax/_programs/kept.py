"""What is kept between processes: compiled programs and values, each under a text that says all that it
depends on.

Whatever is wrong with what is kept, it is as if it were not there.
"""

from __future__ import annotations

import functools
import logging
import pickle
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from rockjax._machine.threads import meanwhile

from . import folder, kind
from .settings import device
from .turns import turn

_LOG = logging.getLogger("rockjax")
# How programs are compiled that do not say otherwise: a quarter less compiling, and they take the same time,
# for most of what LLVM does at its higher levels is done by then.
QUICK = {"xla_backend_optimization_level": 1}
KEEPING = "rockjax program being kept"  # name of threads that write one
COUNTS = {"loaded": 0, "compiled": 0}  # programs in this process, for those who want to know
ANEW = threading.Event()  # set while nothing is kept, see `program.anew`


def remembered(name: str, what: Any, make: Callable[[], Any]) -> Any:
    """What `make()` gives for a fixed argument, kept like a program: trees of NumPy arrays, lists and named
    tuples."""
    place = store()
    try:
        text = f"{name}\n{kind.source()}\n{kind.machine()}\n{kind.describe(what)}" if place else None
    except kind.Unknown:
        text = None
    if not place or not text:
        return make()
    content = _content(place, text)
    if content is not None:
        try:
            return pickle.loads(content)
        except Exception as error:  # a class that is no longer there
            _LOG.debug("what is kept of %s cannot be loaded: %r", name, error)
    with turn():
        value = make()
    try:
        folder.write(place, text, pickle.dumps(value))
    except Exception as error:
        _LOG.debug("nothing can be kept: %s", error)
    return value


def store() -> Path | None:
    """The folder of kept programs; None where none are kept."""
    return folder.path() / "programs" if folder.enabled() and not ANEW.is_set() else None


def _content(place: Path, text: str) -> bytes | None:
    """What is kept under a text, if it can be trusted."""
    try:
        return folder.read(place, text)
    except folder.Damaged as damaged:
        _LOG.debug("%s", damaged)
        folder.discard(place, text)
    except OSError as error:
        _LOG.debug("no kept programs are read: %s", error)
    return None


def load(place: Path, text: str) -> Callable | None:
    """A kept program. Whatever is wrong with it, it is compiled again."""
    from jax.experimental.serialize_executable import deserialize_and_load

    content = _content(place, text)
    if content is None:
        return None
    try:
        program, arguments, answers = pickle.loads(content)
        if b"lapack" in program:
            _find_lapack()
        found = deserialize_and_load(program, arguments, answers, execution_devices=[device()])
    except Exception as error:  # another library's format, a class that is no longer there
        _LOG.debug("a kept program cannot be loaded: %r", error)
        folder.discard(place, text)
        return None
    COUNTS["loaded"] += 1
    return found


@functools.cache
def _find_lapack() -> None:
    """JAX looks for LAPACK when it lowers the first program that needs it. One that is only loaded would call
    what is not there, and take the process with it."""
    jax.jit(jax.numpy.linalg.cholesky).lower(np.eye(1))


def keep(place: Path, text: str, compiled: Any) -> None:
    """Keep a program, where that is possible, while it is already used: a process waits for it at its
    end."""
    meanwhile(lambda: _keep(place, text, compiled), KEEPING)


def _keep(place: Path, text: str, compiled: Any) -> None:
    from jax.experimental.serialize_executable import serialize

    try:
        program, arguments, answers = serialize(compiled)
        # A tree of modules is none any more once it has been written, and fails when the program is called.
        again = pickle.loads(pickle.dumps(answers))
        jax.tree.unflatten(again, range(again.num_leaves))
        folder.write(place, text, pickle.dumps((program, arguments, answers)))
    except Exception as error:  # a full disk; a program with what cannot be kept in it
        _LOG.debug("a program cannot be kept: %r", error)


_FOUND = threading.local()


@functools.cache
def _listen() -> None:
    def happened(event: str, **_) -> None:
        if event == "/jax/compilation_cache/cache_hits":
            _FOUND.elsewhere = True

    jax.monitoring.register_event_listener(happened)


def compile_quickly(lowered: Any, options: dict[str, Any]) -> tuple[Any, bool]:
    """The compiled program, and whether it can be kept: not where JAX's own cache had it, if that is in use.

    On the CPU XLA writes out only what it has compiled itself. What it has loaded would be kept without its
    code.
    """
    _listen()
    _FOUND.elsewhere = False
    _without_places(lowered)
    compiled = lowered.compile(compiler_options=options)
    return compiled, not _FOUND.elsewhere


def _without_places(lowered: Any) -> None:
    """Forget from which lines of source each operation comes: a third of a program's size, and a tenth of its
    loading."""
    from jaxlib.mlir import passmanager

    module = lowered.compiler_ir()
    with module.context:
        passmanager.PassManager.parse("builtin.module(strip-debuginfo)").run(module.operation)
