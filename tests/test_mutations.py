"""The lists of files, tests and harmless changes in `benchmarks/mutations.py` are up to date."""

import re
import sys
from pathlib import Path

import pytest

if sys.version_info < (3, 12):
    pytest.skip("the benchmarks need Python 3.12", allow_module_level=True)
pytest.importorskip("tqdm")

from benchmarks import mutations

TESTS = Path(__file__).parent
# These files contain no sign, coefficient, power or comparison.
WITHOUT_CHANGES = {"_engine/certificate.py", "_restrainers/inerter.py"}


def test_every_file_has_changes():
    assert {mutant.file for mutant in mutations.mutants()} >= set(mutations.FILES) - WITHOUT_CHANGES


def test_every_harmless_change_exists():
    found = [mutations.harmless_reason(mutant) for mutant in mutations.mutants()]
    assert set(mutations.HARMLESS.values()) == set(filter(None, found))


def test_every_stage_contains_its_tests():
    for stage in mutations.STAGES:
        assert [name for name in stage if not (TESTS / name).exists()] == []
    for files, expression in mutations.NEAREST.values():
        names = re.findall(
            r"def (test_\w+)", "".join((TESTS / file).read_text(encoding="utf-8") for file in files)
        )
        words = expression.split(" or ")
        assert [word for word in words if not any(word in name for name in names)] == []


def test_a_change_changes_one_line():
    mutant = next(
        m for m in mutations.mutants() if m.file == "_restrainers/tendon.py" and m.change == "+ → -"
    )
    assert "return self.prestress - self.stiffness * stretch" in mutant.source()
