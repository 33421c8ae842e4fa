"""Pictures, drawn in a process of their own where that is safe.

It loads what draws, and draws, while the command goes on; threads of one interpreter would do it in turn.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from multiprocessing.connection import Connection


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
        self._pipe: Connection | None = None
        self._asked: list[_Wanted] = []

    def apart(self) -> None:
        """Have pictures drawn by a copy of this process, as long as it has no threads, which a copy would
        lack."""
        safe = sys.platform == "linux" and threading.active_count() == 1 and "jax" not in sys.modules
        if not safe or self._pipe is not None:
            return
        import multiprocessing

        sys.stdout.flush()
        sys.stderr.flush()
        ours, theirs = multiprocessing.Pipe()
        try:
            multiprocessing.get_context("fork").Process(target=_serve, args=(ours, theirs)).start()
        except OSError:  # no further process is allowed: drawn here
            return
        theirs.close()
        self._pipe = ours
        # However the command ends: the copy then ends what it draws, and itself, which Python waits for.
        atexit.register(ours.close)

    def draw(self, path: str | Path, draw: str, data: Any) -> list[Path]:
        """Draw a picture, and give the files that are there since; those of the others come with `rest`."""
        wanted = _Wanted(path, draw, data)
        if self._pipe is None:
            return [wanted.make()]
        self._asked.append(wanted)
        with contextlib.suppress(OSError):  # it is gone: `rest` draws instead
            self._pipe.send(wanted)
        return []

    def rest(self) -> list[Path]:
        """Wait for all that are drawn beside. Raises what drawing or writing them raised."""
        made = []
        for wanted in self._asked:
            try:
                assert self._pipe is not None
                answer = self._pipe.recv()
            except (EOFError, OSError):  # it was stopped from outside
                answer = wanted.make()
            if isinstance(answer, BaseException):
                raise answer
            made.append(answer)
        self._asked.clear()
        return made


def _warm_up() -> None:
    """Load what data are read with, and what Matplotlib looks for when it draws for the first time."""
    import io

    import numpy as np
    import xarray

    from rockjax.plots import plt

    figure, ax = plt.subplots()
    ax.contourf(xarray.DataArray(np.eye(2)).where(True))
    figure.savefig(io.BytesIO())
    plt.close(figure)


def _serve(theirs: Connection, pipe: Connection) -> None:
    """Draw what is asked for until the other end closes. Ctrl-C is for the command, which then closes it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    theirs.close()
    _warm_up()
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
