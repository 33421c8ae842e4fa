"""Annotations hold at run time, and numbers of different types are combined only on purpose."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_types_shapes_and_dtypes_of_every_kind_of_scene():
    root = Path(__file__).parents[2]
    run = subprocess.run(
        [sys.executable, "-m", "tests.engine.typed"],
        cwd=root,
        env=os.environ | {"PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=300,
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines()[-2:] == ["derivatives", "a vector is no number"]
