"""Progress bars: what they say before the first scenes are through, and whose bar it is."""

import io
import time

from rockjax._progress import bar


def test_a_bar_does_not_count_what_comes_before_the_first_update(capsys):
    shown = io.StringIO()
    with bar(10, "scenes", True, file=shown, mininterval=0) as made:
        assert "preparing:   0%" in shown.getvalue()
        time.sleep(0.3)
        before = shown.tell()
        made.update(4)
        made.update(5)
        assert made.format_dict["elapsed"] < 0.2
        assert made.n == 9
    assert "preparing" not in shown.getvalue()[before:]
    assert "90%" in shown.getvalue()[before:]
    assert capsys.readouterr().err == ""


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
