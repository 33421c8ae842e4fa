"""Do the tests notice every sign and every coefficient of the model? `python -m benchmarks.mutations
[words] [--list] [--every K]`.

One after another, every sign, coefficient, power and comparison in the equations of motion, the certificate,
the guard, the impact map and the formulas of the structures is changed in a copy of the project, and the
tests are run on it until one fails: first those that know the file best, then those of the equations
themselves, then those of what follows from them. With `--list` nothing is run: how many there are. With
`--every` a sample of them.
"""

from __future__ import annotations

import argparse
import ast
import collections
import copy
import os
import queue
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from .measure import show, store_rows

ROOT = Path(__file__).parent.parent
FILES = [
    f"{folder}/{name}.py"
    for folder, names in {
        "_engine": "bounds certificate coefficients energy guard model transitions",
        "_restrainers": "base damper dimensions inerter tendon together",
        "_structures": "building podium restitution superstructures",
        "_excitations": "ground",
        "_outputs": "deformation drift floor_acceleration margin rotation shear",
    }.items()
    for name in names.split()
]
# Changes that change nothing, or nothing that can be held against them: (file, part of the line, change) and
# why.
HARMLESS: dict[tuple[str, str, str], str] = {
    ("_engine/coefficients.py", "finfo", "64 → 70.4"): "rounding that is allowed to the threshold",
    ("_engine/bounds.py", "vertical = 0.0", "0.0 → 0.1"): "stands for none, and is not looked at",
    ("_restrainers/combined.py", "0.5 * (low + top)", "0.5 → 0.55"): "where the search begins",
    ("_restrainers/combined.py", "np.asarray(0.0).dtype", "0.0 → 0.1"): "only its type counts",
}
STAGES = (
    ("engine/test_certificate.py",),
    ("engine/test_model.py", "test_structures.py"),
    (
        "engine/test_closed_forms.py",
        "engine/test_edges.py",
        "engine/test_accuracy.py",
        "engine/test_hard_cases.py",
    ),
    ("engine/test_restrainers.py", "engine/test_vertical.py", "engine/test_modes.py"),
)
# Tests that know a file best, (words of its name) → (files of tests, words of theirs): seconds instead of
# minutes, as no scene is solved in most. Run first; with `--stages 0` nothing else.
NEAREST = {
    "_restrainers/": (
        ("engine/test_restrainers.py",),
        "exact_numbers or one_joint or potential or from_dimensions or stability_angle_has or steep",
    ),
    "_structures/building.py": (("engine/test_modes.py",), "modes_of or what_is_left_out or bad_input"),
    "_structures/superstructures.py": (
        ("engine/test_modes.py", "engine/test_restrainers.py", "test_structures.py"),
        "frequenc or exact_numbers",
    ),
    "_structures/podium.py": (
        ("test_structures.py", "engine/test_restrainers.py", "engine/test_modes.py"),
        "exact_numbers or uplift_follows or dimensions or frequenc or equivalent_block",
    ),
    "_excitations/ground.py": (
        ("engine/test_first_uplift.py", "engine/test_vertical.py"),
        "pairs or first_uplift or jumps_of_both",
    ),
}
OPERATORS = {ast.Add: (ast.Sub, "+ → -"), ast.Sub: (ast.Add, "- → +")}
COMPARISONS = {
    ast.Gt: (ast.Lt, "> → <"),
    ast.Lt: (ast.Gt, "< → >"),
    ast.GtE: (ast.Lt, ">= → <"),
    ast.Eq: (ast.NotEq, "== → !="),
}


class Mutant(NamedTuple):
    file: str
    function: str
    line: int
    change: str
    text: str  # the line of source
    source: str  # of the whole changed file


def mutants() -> Iterator[Mutant]:
    for file in FILES:
        text = (ROOT / "rockjax" / file).read_text()
        tree = ast.parse(text)
        classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
        for node in [*tree.body, *(method for one in classes for method in one.body)]:
            if isinstance(node, ast.FunctionDef) and not node.name.startswith(("__", "_repr")):
                yield from _of_function(file, text, tree, node)


def _of_function(file: str, text: str, tree: ast.Module, function: ast.FunctionDef) -> Iterator[Mutant]:
    skip = {
        id(n)
        for part in (function.args, function.returns, *function.decorator_list)
        if part
        for n in ast.walk(part)
    }
    skip |= {id(n) for call in ast.walk(function) if isinstance(call, ast.JoinedStr) for n in ast.walk(call)}
    powers = {
        id(n.right) for n in ast.walk(function) if isinstance(n, ast.BinOp) and isinstance(n.op, ast.Pow)
    }
    lines = text.splitlines()
    for number, node in enumerate(ast.walk(function)):
        if id(node) in skip:
            continue
        for change, apply in _changes(node, id(node) in powers):
            clone = copy.deepcopy(tree)
            twin = next(
                n for n in ast.walk(clone) if isinstance(n, ast.FunctionDef) and n.lineno == function.lineno
            )
            apply(list(ast.walk(twin))[number])
            ast.fix_missing_locations(clone)
            line = getattr(node, "lineno", function.lineno)
            yield Mutant(file, function.name, line, change, lines[line - 1].strip(), ast.unparse(clone))


def _changes(node: ast.AST, power: bool) -> Iterator[tuple[str, Any]]:
    def operator(new):
        def apply(n):
            n.op = new()

        return apply

    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        new, words = OPERATORS[type(node.op)]
        yield words, operator(new)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield "-x → x", operator(ast.UAdd)
    elif isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARISONS:
        new, words = COMPARISONS[type(node.ops[0])]

        def compare(n):
            n.ops = [new()]

        yield words, compare
    elif (
        isinstance(node, ast.Constant)
        and isinstance(node.value, int | float)
        and not isinstance(node.value, bool)
    ):
        other = node.value + 1 if power else (round(1.1 * node.value, 12) if node.value else 0.1)

        def constant(n):
            n.value = other

        yield f"{node.value} → {other}", constant


def stages_of(mutant: Mutant, stages: int) -> Iterator[list[str]]:
    """Arguments of pytest for one stage after another."""
    for words, (files, names) in NEAREST.items():
        if words in mutant.file:
            yield ["-k", names, *(f"tests/{name}" for name in files)]
    for stage in STAGES[:stages]:
        yield [f"tests/{name}" for name in stage]


def noticed_by(mutant: Mutant, copy_of: Path, stages: int) -> str:
    """Which test notices, if any."""
    target = copy_of / "rockjax" / mutant.file
    original = target.read_text()
    plain = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    command = [sys.executable, "-m", "pytest", *plain, "-m", "not slow"]
    environment = os.environ | {"PYTHONPATH": str(copy_of), "MPLBACKEND": "Agg"}
    try:
        target.write_text(mutant.source)
        for stage in stages_of(mutant, stages):
            done = subprocess.run(
                [*command, *stage], cwd=copy_of, env=environment, capture_output=True, text=True, timeout=1200
            )
            if done.returncode:
                lines = done.stdout.splitlines()
                failed = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
                return (failed or lines[-1:] or ["crash"])[0].split(" - ")[0].split("::")[-1]
    except subprocess.TimeoutExpired:
        return "does not end"
    finally:
        target.write_text(original)
    return ""


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("words", nargs="*", help="of file, function and change: those that have all")
    arguments.add_argument("--list", action="store_true", help="count them")
    arguments.add_argument("--every", type=int, default=1, help="one of so many")
    arguments.add_argument(
        "--stages", type=int, default=len(STAGES), help="of the tests, the quickest first: fewer notice less"
    )
    arguments.add_argument("--processes", type=int, default=2, help="side by side")
    given = arguments.parse_args()
    words = given.words
    chosen = [m for m in mutants() if all(w in f"{m.file} {m.function} {m.change}" for w in words)]
    if given.list:
        counts = collections.Counter((m.file, m.function) for m in chosen)
        listed = [{"file": file, "function": name, "changes": k} for (file, name), k in counts.items()]
        total = {"file": "all", "function": "", "changes": len(chosen)}
        show([*listed, total])
        return
    chosen = chosen[:: given.every]
    copies: queue.Queue[Path] = queue.Queue()
    with tempfile.TemporaryDirectory() as folder:
        for k in range(given.processes):
            place = Path(folder) / str(k)
            for part in ("rockjax", "optimise", "tests", "docs"):
                shutil.copytree(ROOT / part, place / part, ignore=shutil.ignore_patterns("__pycache__"))
            for name in ("pyproject.toml", "README.md"):
                shutil.copy(ROOT / name, place / name)
            copies.put(place)

        def one(mutant: Mutant) -> str:
            place = copies.get()
            try:
                return noticed_by(mutant, place, given.stages)
            finally:
                copies.put(place)
                bar.update()

        with tqdm(total=len(chosen), unit=" mutants") as bar, ThreadPoolExecutor(given.processes) as pool:
            found = list(pool.map(one, chosen))
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    survivors = []
    for mutant, test in zip(chosen, found, strict=True):
        place = {"file": mutant.file, "function": mutant.function}
        row = rows.setdefault(
            (mutant.file, mutant.function), place | {"changes": 0, "noticed": 0, "harmless": 0}
        )
        row["changes"] += 1
        row["noticed"] += bool(test)
        if not test:
            reasons = (
                why
                for (file, part, change), why in HARMLESS.items()
                if file == mutant.file and part in mutant.text and change == mutant.change
            )
            why = next(reasons, "")
            row["harmless"] += bool(why)
            where = f"{mutant.file}:{mutant.line}"
            survivors.append({"where": where, "change": mutant.change, "line": mutant.text, "why": why})
    table = list(rows.values())
    sums = {k: sum(r[k] for r in table) for k in ("changes", "noticed", "harmless")}
    table.append({"file": "all", "function": ""} | sums)
    show(table)
    print("\nnot noticed:" if survivors else "\nevery change is noticed")
    for row in survivors:
        print(f"  {row['where']}  {row['change']}:  {row['line']}  {row['why']}")
    if not words and given.every == 1:
        store_rows("mutations", [*table, {"survivors": survivors}])


if __name__ == "__main__":
    main()
