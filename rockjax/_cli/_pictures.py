"""Pictures, drawn in processes of their own where that is safe.

They load what draws, and draw, while the command goes on; threads of one interpreter would do it in turn.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

COPIES = 2  # as many pictures at a time


class _Wanted(NamedTuple):
    """`rockjax.plots.<draw>(data)` as a file."""

    path: str | Path
    draw: str
    data: Any

    def make(self) -> Path:
        from rockjax import plots
        from rockjax._files import write_figure

        return write_figure(self.path, getattr(plots, self.draw)(self.data).figure)


class Pictures:
    """Pictures of a command: drawn at once, or after `apart` beside it."""

    def __init__(self) -> None:
        os.environ["MPLBACKEND"] = "Agg"  # without a screen; Matplotlib itself takes a while, and can wait
        self._pipes: list[Connection] = []
        self._asked: list[_Wanted] = []

    def apart(self) -> None:
        """Have pictures drawn by copies of this process, as long as it has no threads, which a copy would
        lack."""
        safe = sys.platform == "linux" and threading.active_count() == 1 and "jax" not in sys.modules
        if not safe or self._pipes:
            return
        import multiprocessing

        sys.stdout.flush()
        sys.stderr.flush()
        ours, theirs = zip(*(multiprocessing.Pipe() for _ in range(COPIES)), strict=True)
        copy = multiprocessing.get_context("fork").Process(target=_serve, args=(ours, theirs))
        try:
            copy.start()
        except OSError:  # no further process is allowed: drawn here
            _close((*ours, *theirs))
            return
        _close(theirs)
        self._pipes = list(ours)

        def end() -> None:
            """However the command ends: what is being drawn is drawn to its end, which Python waits for."""
            _close(ours)
            if not self._asked:
                copy.terminate()

        atexit.register(end)

    def draw(self, path: str | Path, draw: str, data: Any) -> list[Path]:
        """Draw a picture, and give the files that are there since; those of the others come with `rest`."""
        wanted = _Wanted(path, draw, data)
        if not self._pipes:
            return [wanted.make()]
        with contextlib.suppress(OSError):  # it is gone: `rest` draws instead
            self._pipe_of(len(self._asked)).send(wanted)
        self._asked.append(wanted)
        return []

    def rest(self) -> list[Path]:
        """Wait for all that are drawn beside. Raises what drawing or writing them raised."""
        made = []
        for number, wanted in enumerate(self._asked):
            try:
                answer = self._pipe_of(number).recv()
            except (EOFError, OSError):  # it was stopped from outside
                answer = wanted.make()
            if isinstance(answer, BaseException):
                raise answer
            made.append(answer)
        self._asked.clear()
        return made

    def _pipe_of(self, number: int) -> Connection:
        """Copies draw in turn."""
        return self._pipes[number % len(self._pipes)]


def _close(pipes: Iterable[Connection]) -> None:
    for pipe in pipes:
        pipe.close()


def _warm_up() -> None:
    """Load what data are read with, and what Matplotlib looks for when it draws for the first time, formulas
    too."""
    import io

    import numpy as np
    import xarray

    from rockjax.plots import plt
    from rockjax.plots._style import ACCELERATION_RATIO, FREQUENCY_RATIO

    figure, ax = plt.subplots()
    ax.contourf(xarray.DataArray(np.eye(2)).where(True))
    ax.set(xlabel=FREQUENCY_RATIO, ylabel=ACCELERATION_RATIO)
    figure.savefig(io.BytesIO())
    plt.close(figure)


def _serve(theirs: Sequence[Connection], pipes: Sequence[Connection]) -> None:
    """Draw what is asked for until the other ends close, each pipe in a process. Ctrl-C is for the command,
    which then closes them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _close(theirs)
    os.environ["OMP_NUM_THREADS"] = "1"  # NumPy's library has no threads either, then
    _warm_up()
    for k in range(1, len(pipes)):
        copy = 1
        with contextlib.suppress(OSError):  # no further process: its pipe is closed, and the command draws
            copy = os.fork()
        if not copy:
            _close(pipe for other, pipe in enumerate(pipes) if other != k)
            _draw_all(pipes[k])
            os._exit(0)
    _close(pipes[1:])
    _draw_all(pipes[0])
    with contextlib.suppress(ChildProcessError):
        while True:
            os.wait()


def _draw_all(pipe: Connection) -> None:
    while True:
        try:
            wanted = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            answer: Any = wanted.make()
        except Exception as error:
            answer = error
        try:
            pipe.send(answer)
        except OSError:
            return
        except Exception:  # an error that cannot be sent
            pipe.send(RuntimeError(str(answer)))
