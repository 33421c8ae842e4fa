"""Failing output streams cause no traceback and no loss of files."""

import json
import os
import subprocess
import sys

import pytest

RECORD = "0.0\n0.1\n-0.1\n0.0\n" * 20


@pytest.fixture
def motions(tmp_path):
    """Run `rockjax motions`, which prints α and writes a file, in a shell with redirections."""
    (tmp_path / "Köln.txt").write_text(RECORD)

    def call(redirections="", options="", **environment):
        command = '"$PYTHON" -m rockjax motions Köln.txt --units g --dt 0.01 -o Köln'
        return subprocess.run(
            ["bash", "-c", f"{command} {options} {redirections}"],
            cwd=tmp_path,
            env=os.environ | {"PYTHON": sys.executable} | environment,
            capture_output=True,
            timeout=120,
        )

    yield call
    assert (tmp_path / "Köln.nc").exists()


RATIOS = "--tan-alpha 0.15 --R 1.5"


@pytest.mark.parametrize("encoding", ["cp1252", "iso8859-2", "latin-1:strict", "cp437"])
def test_letters_that_stdout_does_not_have_are_escaped(motions, encoding):
    ended = motions(options=RATIOS, PYTHONIOENCODING=encoding)
    assert ended.returncode == 0
    assert not ended.stderr
    assert ended.stdout.decode(encoding.split(":")[0]).splitlines()[-1].startswith("wrote K")
    assert encoding == "cp437" or b"g tan \\u03b1" in ended.stdout


def test_json_is_valid_in_every_encoding(motions):
    ended = motions(options="--json", PYTHONIOENCODING="ascii")
    assert ended.returncode == 0
    assert json.loads(ended.stdout)["files"] == ["Köln.nc"]


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_streams_are_no_error(motions, closed):
    ended = motions(closed, RATIOS)
    assert ended.returncode == 0
    assert b"Traceback" not in ended.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="Linux has /dev/full")
def test_a_full_disk_is_reported_after_the_files_are_written(motions):
    ended = motions("> /dev/full", RATIOS)
    assert ended.returncode == 1
    assert ended.stderr == b"rockjax: standard output could not be written: No space left on device\n"


def test_a_reader_of_errors_that_has_gone_is_no_error(motions):
    ended = motions("--verbose 2> >(true); exit $?", RATIOS)
    assert ended.returncode == 0
