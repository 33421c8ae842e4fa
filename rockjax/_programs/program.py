"""Functions that are traced and compiled once for each kind of arguments, in this process and in later
ones."""

from __future__ import annotations

import contextlib
import functools
import logging
import pickle
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer

from rockjax._threads import precision

from . import folder, kind

_LOG = logging.getLogger("rockjax")
_ARRAYS = np.ndarray | np.generic | jax.Array  # tracers are instances, too
_NUMBERS = _ARRAYS | bool | int | float
# A quarter less compiling; the programs take the same time, for most of what LLVM does at its higher levels
# is done by then.
_QUICK = {"xla_backend_optimization_level": 1}
_PATIENCE = 2.0  # s of compiling, after which it is said
AHEAD = "rockjax program ahead"  # name of threads that make one before it is called
COUNTS = {"loaded": 0, "compiled": 0}  # programs in this process, for those who want to know


class _Fixed(NamedTuple):
    """What a program is compiled for besides the shapes and types of its arrays."""

    structure: Any
    leaves: tuple[Any, ...]  # those that are not passed: functions, texts, …; None where one is
    named: tuple[tuple[str, Any], ...]


class KeptProgram:
    """A compiled function of pytrees of arrays and numbers; what else is in them, and `fixed` arguments, is
    compiled in.

    Known arguments on the CPU run a program that is kept between processes (see `folder`): loading it needs
    neither tracing nor compiling, and it gives the same answers to the last bit. Everything else, traced
    arguments above all, goes through `jax.jit` as ever. With `arrays_only`, numbers of Python are compiled in
    as well.
    """

    def __init__(
        self,
        function: Callable,
        *,
        donate: Sequence[int] = (),
        arrays_only: bool = False,
        compiler_options: dict[str, Any] | None = None,
        name: str | None = None,
    ):
        functools.update_wrapper(self, function)
        self.name = name or f"{function.__module__}.{function.__qualname__}"
        self._how = f"donated {tuple(donate)}, compiler options {compiler_options}, {_QUICK}"
        self._function, self._donate, self._options = function, tuple(donate), compiler_options
        self._passed = _ARRAYS if arrays_only else _NUMBERS
        self._traced: dict[_Fixed, Any] = {}
        self._ready: dict[Hashable, Callable] = {}
        self._making: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()
        _ALL.append(self)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        passed, fixed = self._split(arguments, named)
        if not all(map(_is_here, passed)) or not _usual():
            return self._jitted(fixed)(*passed)
        key = fixed, tuple(map(_type, passed)), _present_settings()
        ready = self._ready.get(key) or self._make(key, passed, fixed)
        try:
            return ready(*passed)
        except jax.errors.JaxRuntimeError as error:
            if "NOT_FOUND" not in str(error):
                raise
            _LOG.debug("a kept program is not whole: %s", error)
        return self._make_again(key, passed, fixed)(*passed)

    def ahead(self, *arguments: Any, **named: Any) -> None:
        """Load or compile, while something else goes on, what will be called with arguments of these
        kinds."""
        passed, fixed = self._split(arguments, named)
        if not all(map(_is_here, passed)) or not _usual():
            return
        key = fixed, tuple(map(_type, passed)), _present_settings()
        if key in self._ready:
            return

        def make() -> None:
            with contextlib.suppress(Exception), precision(key[2][0]):  # errors are said where it is called
                if _present_settings() == key[2]:  # a thread has the usual ones
                    self._make(key, passed, fixed)

        threading.Thread(target=make, name=AHEAD).start()

    def traced(self, *arguments: Any, **named: Any) -> Any:
        """The same through `jax.jit`, for those who trace."""
        passed, fixed = self._split(arguments, named)
        return self._jitted(fixed)(*passed)

    def _split(self, arguments: tuple, named: dict[str, Any]) -> tuple[list, _Fixed]:
        leaves, structure = jax.tree.flatten(arguments)
        kept = tuple(None if isinstance(y, self._passed) else y for y in leaves)
        passed = [y for y, other in zip(leaves, kept, strict=True) if other is None]
        return passed, _Fixed(structure, kept, tuple(sorted(named.items())))

    def _jitted(self, fixed: _Fixed) -> Any:
        """The function of what is passed alone."""
        with self._lock:
            if fixed not in self._traced:
                self._traced[fixed] = self._of_passed(fixed)
            return self._traced[fixed]

    def _of_passed(self, fixed: _Fixed) -> Any:
        def function(*passed):
            rest = iter(passed)
            leaves = [next(rest) if y is None else y for y in fixed.leaves]
            return self._function(*jax.tree.unflatten(fixed.structure, leaves), **dict(fixed.named))

        function.__name__ = self._function.__name__
        argument = [k for k, part in enumerate(fixed.structure.children()) for _ in range(part.num_leaves)]
        passed = [k for k, y in zip(argument, fixed.leaves, strict=True) if y is None]
        donated = [i for i, k in enumerate(passed) if k in self._donate]
        return jax.jit(function, donate_argnums=donated, compiler_options=self._options)

    def _make(self, key: Hashable, passed: list, fixed: _Fixed) -> Callable:
        with self._lock:
            lock = self._making.setdefault(key, threading.Lock())
        with lock:  # one thread compiles, the others wait for it
            if key not in self._ready:
                self._ready[key] = self._kept(passed, fixed)
            return self._ready[key]

    def _make_again(self, key: Hashable, passed: list, fixed: _Fixed) -> Callable:
        """In the place of a program that lacks some of its code: XLA notices only when it is run."""
        with self._lock:
            lock = self._making.setdefault(key, threading.Lock())
        with lock:
            lowered = self._jitted(fixed).lower(*passed)
            place = store()
            if place:
                folder.discard(place, self._text(passed, fixed) or self._text_of(lowered))
            self._ready[key], _ = _compiled(lowered)
            return self._ready[key]

    def _kept(self, passed: list, fixed: _Fixed) -> Callable:
        """The program from the folder; compiled, and kept there, where there is none."""
        place = store()
        text = self._text(passed, fixed) if place else None
        found = _load(place, text) if place and text else None
        if found is not None:
            return found
        with _said(place):
            lowered = self._jitted(fixed).lower(*passed)
            if place and not text:
                text = self._text_of(lowered)
                found = _load(place, text)
            if found is not None:
                return found
            compiled, whole = _compiled(lowered)
        COUNTS["compiled"] += 1
        if place and text and whole:
            _keep(place, text, compiled)
        return compiled

    def _text(self, passed: list, fixed: _Fixed) -> str | None:
        try:
            what = f"{kind.describe(tuple(fixed))}\n{kind.numbers(passed)}"
            return f"{self.name}\n{self._how}\n{kind.source()}\n{kind.machine()}\n{what}"
        except kind.Unknown as unknown:
            _LOG.debug("%s is traced in every process: no name in all of them has %s", self.name, unknown)
            return None

    def _text_of(self, lowered: Any) -> str:
        """With classes of the user's own, a program is known by what tracing has made of them."""
        return f"{self.name}\n{self._how}\n{kind.machine()}\n{lowered.as_text()}"

    def forget(self) -> None:
        """Let go of what this process holds."""
        with self._lock:
            self._traced.clear()
            self._ready.clear()
            self._making.clear()


_FOUND = threading.local()


@functools.cache
def _listen() -> None:
    def happened(event: str, **_) -> None:
        if event == "/jax/compilation_cache/cache_hits":
            _FOUND.elsewhere = True

    jax.monitoring.register_event_listener(happened)


def _compiled(lowered: Any) -> tuple[Any, bool]:
    """The compiled program, and whether it can be kept: not where JAX's own cache had it, if that is in use.

    On the CPU XLA writes out only what it has compiled itself. What it has loaded would be kept without its
    code.
    """
    _listen()
    _FOUND.elsewhere = False
    _without_places(lowered)
    compiled = lowered.compile(compiler_options=_QUICK)
    return compiled, not _FOUND.elsewhere


def _without_places(lowered: Any) -> None:
    """Forget from which lines of source each operation comes: a third of a program's size, and a tenth of its
    loading."""
    from jaxlib.mlir import passmanager

    module = lowered.compiler_ir()
    with module.context:
        passmanager.PassManager.parse("builtin.module(strip-debuginfo)").run(module.operation)


_ALL: list[KeptProgram] = []


def forget() -> None:
    """Let go of all programs that this process holds; those in the folder stay."""
    for program in _ALL:
        program.forget()


@contextlib.contextmanager
def anew() -> Iterator[None]:
    """Inside, everything is traced and compiled anew and nothing is kept: for those who exchange parts of the
    package."""
    _ANEW.set()
    forget()
    jax.clear_caches()
    try:
        yield
    finally:
        forget()
        jax.clear_caches()
        _ANEW.clear()


_ANEW = threading.Event()


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
    value = make()
    try:
        folder.write(place, text, pickle.dumps(value))
    except Exception as error:
        _LOG.debug("nothing can be kept: %s", error)
    return value


def store() -> Path | None:
    """The folder of kept programs; None where none are kept."""
    return folder.path() / "programs" if folder.enabled() and not _ANEW.is_set() else None


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


def _load(place: Path, text: str) -> Callable | None:
    """A kept program. Whatever is wrong with it, it is compiled again."""
    from jax.experimental.serialize_executable import deserialize_and_load

    content = _content(place, text)
    if content is None:
        return None
    try:
        program, arguments, answers = pickle.loads(content)
        found = deserialize_and_load(program, arguments, answers, execution_devices=[_device()])
    except Exception as error:  # another library's format, a class that is no longer there
        _LOG.debug("a kept program cannot be loaded: %r", error)
        folder.discard(place, text)
        return None
    COUNTS["loaded"] += 1
    return found


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
    return True  # of NumPy or Python


def _type(leaf: Any) -> Hashable:
    """What a program is compiled for of a number or an array: arrays of NumPy and of JAX are the same."""
    if isinstance(leaf, _ARRAYS):
        return leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)
    return type(leaf)


def _usual() -> bool:
    """Whether programs run as usual: on one CPU, and not looked into by one of JAX's settings for
    debugging."""
    settings: Any = jax.config
    chosen = settings.jax_default_device
    if jax.default_backend() != "cpu" or not (chosen is None or chosen == "cpu" or chosen == _device()):
        return False
    unusual = (
        settings.jax_disable_jit,
        settings.jax_debug_nans,
        settings.jax_debug_infs,
        settings.jax_check_tracer_leaks,
    )
    return not any(unusual) and jax.process_count() == 1


def _present_settings() -> tuple[Any, ...]:
    """Settings that a program is traced under and that may change within a process."""
    settings: Any = jax.config
    return (
        settings.jax_enable_x64,
        settings.jax_default_matmul_precision,
        settings.jax_numpy_dtype_promotion,
        settings.jax_numpy_rank_promotion,
    )


@contextlib.contextmanager
def _said(place: Path | None) -> Iterator[None]:
    """Say, once in a process, that what takes so long is compiling."""
    timer = threading.Timer(_PATIENCE, _say, [place])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


_SAID = threading.Event()


def _say(place: Path | None) -> None:
    if not _SAID.is_set():
        _SAID.set()
        then = (
            f"it is kept in {place}, and the next time only loaded"
            if place
            else "it is not kept (ROCKJAX_CACHE is off)"
        )
        _LOG.warning("compiling a program for this kind of scene, which may take some seconds; %s", then)
