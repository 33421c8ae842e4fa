"""Progress bars: their text before the first scenes finish, and the type of bar."""

import contextlib
import io
import subprocess
import sys
import time

import pytest

import rockjax as rj
from rockjax import _progress
from rockjax._programs.program import compiling, current_compilation, forget
from rockjax._progress import bar


def test_the_time_before_the_first_update_does_not_count(capsys):
    shown = io.StringIO()
    with bar(10, "scenes", True, file=shown, mininterval=0) as made:
        assert "preparing:   0%" in shown.getvalue()
        time.sleep(0.3)
        before = shown.tell()
        made.update(4)
        made.update(5)
        assert made.format_dict["elapsed"] < 0.2
        assert made.n == 9
        assert "90%" in shown.getvalue()[before:]
    assert "preparing" not in shown.getvalue()[before:]
    assert capsys.readouterr().err == ""


def test_a_bar_ends_full_unless_something_stops_it():
    for stop, last in ((None, "100%"), (KeyboardInterrupt, " 40%")):
        shown = io.StringIO()
        with (
            contextlib.suppress(KeyboardInterrupt),
            bar(10, "iterations", True, file=shown, mininterval=0) as made,
        ):
            made.update(4)
            if stop:
                raise stop
        assert last in shown.getvalue().split("\r")[-1]


def test_bars_of_notebooks_are_widgets_and_end_full(tmp_path):
    """Runs in a separate kernel, because tqdm selects the type of bar when it is imported."""
    pytest.importorskip("ipywidgets")
    pytest.importorskip("ipykernel")
    code = "\n".join(
        [
            "import sys, ipykernel.zmqshell",
            "from rockjax._progress import bar",
            "with bar(60, 'iterations', True, display=False) as made:",
            "    made.update(12)",
            "_, drawn, numbers = made.container.children",
            "assert (drawn.value, drawn.max, drawn.bar_style) == (12, 12, 'success'), drawn",
            "assert '12/12' in numbers.value, numbers.value",
            # The bars of sweeps too.
            "import rockjax as rj, tqdm.notebook",
            "made, begin = [], tqdm.notebook.tqdm_notebook.__init__",
            "def beginning(bar, *a, **k): made.append(bar); begin(bar, *a, **k | {'display': False})",
            "tqdm.notebook.tqdm_notebook.__init__ = beginning",
            "scenes = rj.grid(rj.Podium(0.15, 1.5), rj.Ricker(1.0, 1.0), acceleration_ratio=[1.5, 2.0])",
            "rj.sweep(*scenes, store=sys.argv[1], progress=True)",
            "bars = [bar for bar in made if 'chunks' in getattr(bar, 'desc', '')]",
            "assert bars and all(bar.n == bar.total > 0 for bar in bars), made",
        ]
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.zarr")], check=True)


def test_the_clock_goes_on_while_nothing_is_through(monkeypatch):
    monkeypatch.setattr(_progress, "TICK", 0.05)
    shown = io.StringIO()
    with bar(10, "scenes", True, file=shown) as made:
        time.sleep(0.6)
        assert shown.getvalue().count("preparing:   0%") >= 4
        assert "[00:00<?" in shown.getvalue()
        made.update(1)
        before = shown.tell()
        time.sleep(0.6)
        assert shown.getvalue()[before:].count("10%") >= 4
    ended = shown.tell()
    time.sleep(0.2)
    assert shown.tell() == ended


@pytest.mark.parametrize("total", [10, None])
def test_a_bar_names_the_compiled_program(monkeypatch, total):
    monkeypatch.setattr(_progress, "TICK", 0.05)
    shown = io.StringIO()
    with bar(total, "scenes", True, file=shown, unit_scale=True, mininterval=0) as made:
        with compiling("the program of a history"):
            before = shown.tell()
            time.sleep(0.4)
            meanwhile = shown.getvalue()[before:]
            assert meanwhile.count("compiling the program of a history [00:00]") >= 3
            assert "scenes" not in meanwhile
            assert "0.00" not in meanwhile
        before = shown.tell()
        time.sleep(0.2)
        assert "compiling" not in shown.getvalue()[before + 1 :].split("\r", 2)[-1]
        made.update(4)
        with compiling("something else"):  # while scenes are being solved
            before = shown.tell()
            time.sleep(0.2)
            assert "4.00" in shown.getvalue()[before:]
            assert "compiling" not in shown.getvalue()[before:]
    assert current_compilation() is None


def test_batches_say_that_they_compile(monkeypatch):
    """A separate bar is shown during compilation, here for a kind of lanes that no other test compiles."""
    monkeypatch.setattr(_progress, "TICK", 0.05)
    shown = io.StringIO()
    scenes = rj.Podium(0.15, [1.5, 2.0]), rj.OneSine(4.0, 1.0)
    monkeypatch.setenv("ROCKJAX_CACHE", "off")
    forget()
    with contextlib.redirect_stderr(shown):
        rj.peak_responses(*scenes, progress=True)
    assert "compiling the program for batches of this kind of scene [" in shown.getvalue()
    last = shown.getvalue().split("\r")[-1]
    assert "100%" in last
    assert "compiling" not in last


def test_a_bar_that_is_not_wanted_is_silent(capsys):
    with bar(10, "scenes", False) as made:
        made.update(4)
    assert capsys.readouterr().err == ""


def test_a_bar_of_the_caller_stays_open():
    class Counter:
        total = 0

        def update(self, count):
            self.total += count

    counter = Counter()
    with bar(3, "scenes", counter) as made:
        made.update(3)
    assert counter.total == 3
    assert made is counter
