"""Functions that are traced and compiled once for each kind of arguments, in this process and in later
ones."""

from __future__ import annotations

import contextlib
import functools
import logging
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from rockjax._machine.threads import meanwhile

from . import folder, kind
from .compiling import compiling
from .kept import ANEW, COUNTS, QUICK, compile_quickly, keep, load, store
from .settings import ARRAYS, nans_allowed, present_settings, types_here, usual
from .turns import is_mine, turn

_LOG = logging.getLogger("rockjax")
_NUMBERS = ARRAYS | bool | int | float
_PATIENCE = 2.0  # s of compiling, after which it is said
AHEAD = "rockjax program ahead"  # name of threads that make one before it is called


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
        words: str = "the program for this kind of scene",
    ):
        functools.update_wrapper(self, function)
        self.name = name or f"{function.__module__}.{function.__qualname__}"
        self._words = words  # what a progress bar calls it
        self._function, self._donate, self._options = function, tuple(donate), compiler_options or {}
        self._kept_options = QUICK | self._options
        self._how = f"donated {self._donate}, compiler options {self._kept_options}"
        self._passed = ARRAYS if arrays_only else _NUMBERS
        self._traced: dict[_Fixed, Any] = {}
        self._ready: dict[Hashable, Callable] = {}
        self._making: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()
        _ALL.append(self)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        passed, fixed = self._split(arguments, named)
        types = types_here(passed)
        if types is None:
            return self._jitted(fixed)(*passed)
        with nans_allowed():
            return self._run(passed, fixed, types)

    def _run(self, passed: list, fixed: _Fixed, types: Hashable) -> Any:
        if not usual():
            return self._jitted(fixed)(*passed)
        key = fixed, types, present_settings()
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
        types = types_here(passed)
        if types is None or not usual():
            return
        key = fixed, types, present_settings()
        if key in self._ready:
            return

        def make() -> None:
            if present_settings() == key[2]:  # a thread has the usual ones
                self._make(key, passed, fixed)

        meanwhile(make, AHEAD)

    def traced(self, *arguments: Any, **named: Any) -> Any:
        """The same through `jax.jit`, for those who trace."""
        passed, fixed = self._split(arguments, named)
        return self._jitted(fixed)(*passed)

    def _split(self, arguments: tuple, named: dict[str, Any]) -> tuple[list, _Fixed]:
        leaves, structure = jax.tree.flatten(arguments)
        passes = [type(y) is np.ndarray or isinstance(y, self._passed) for y in leaves]
        passed = [y for y, goes in zip(leaves, passes, strict=True) if goes]
        kept = tuple(None if goes else y for y, goes in zip(leaves, passes, strict=True))
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
        return jax.jit(function, donate_argnums=donated, compiler_options=self._options or None)

    def _make(self, key: Hashable, passed: list, fixed: _Fixed) -> Callable:
        with self._lock:
            lock = self._making.setdefault(key, threading.Lock())
        # One thread compiles and the others wait for it, but for one that is tracing what calls this.
        with contextlib.nullcontext() if is_mine() else lock:
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
            self._ready[key], _ = compile_quickly(lowered, self._kept_options)
            return self._ready[key]

    def _kept(self, passed: list, fixed: _Fixed) -> Callable:
        """The program from the folder; compiled, and kept there, where there is none."""
        place = store()
        text = self._text(passed, fixed) if place else None
        found = load(place, text) if place and text else None
        if found is not None:
            return found
        with _said(place), compiling(self._words):
            with turn():
                lowered = self._jitted(fixed).lower(*passed)
            if place and not text:
                text = self._text_of(lowered)
                found = load(place, text)
            if found is not None:
                return found
            compiled, whole = compile_quickly(lowered, self._kept_options)
        COUNTS["compiled"] += 1
        if place and text and whole:
            keep(place, text, compiled)
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


_ALL: list[KeptProgram] = []


def forget() -> None:
    """Let go of all programs that this process holds; those in the folder stay."""
    for program in _ALL:
        program.forget()


@contextlib.contextmanager
def anew() -> Iterator[None]:
    """Inside, everything is traced and compiled anew and nothing is kept: for those who exchange parts of the
    package."""
    ANEW.set()
    forget()
    jax.clear_caches()
    try:
        yield
    finally:
        forget()
        jax.clear_caches()
        ANEW.clear()


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
