"""Mutation test: which wrong signs, coefficients, powers and comparisons in the model make a test fail?

    python -m benchmarks.mutations [WORD ...] [--list] [--every K] [--stages N] [--processes N]

The benchmark copies the project and changes one sign, coefficient, power or comparison at a time in the files
of `FILES`. For each change it runs tests in stages until a test fails: first the tests in `NEAREST` for the
changed file, then the stages in `STAGES`. With `--list` it counts the changes and runs no test. With
`--every K` it tries every K-th change only.
"""

from __future__ import annotations

import argparse
import ast
import collections
import os
import queue
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
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
        "_restrainers": "base damper dimensions inerter tendon combined",
        "_structures": "building podium restitution superstructures",
        "_excitations": "ground",
        "_outputs": "deformation drift floor_acceleration margin rotation shear",
    }.items()
    for name in names.split()
]
# File ↦ functions with equations. In these files, only these functions are changed.
EQUATIONS = {
    "_excitations/piecewise.py": "piece velocity_jump",
    "_oscillators.py": (
        "divided ground_load factors _oscillators _series _solve_blocks _taylor _series_of_block _delay "
        "_next_turn next_turns _slope"
    ),
    "_outputs/velocity_jump.py": "at_impact is_final _jump_bound",
    "_responses/floor.py": "bodies with_beam in_direction load_of largest_acceleration _displacement",
    "_responses/floor_course.py": "course_of",
    "_responses/floor_end.py": "ending bound_after_end ratio_after_end",
    "_responses/floor_slopes.py": "slope_of_load",
    "_responses/on_floors.py": "_rock _vibrate update",
    "_studies/floor_spectra.py": "broadened",
}
FILES += EQUATIONS
# Changes that alter no answer: (file, part of the changed line, change) and the reason.
HARMLESS: dict[tuple[str, str, str], str] = {
    ("_engine/coefficients.py", "finfo", "64 → 70.4"): "a rounding allowance of the uplift threshold",
    (
        "_engine/bounds.py",
        "vertical = 0.0",
        "0.0 → 0.1",
    ): "without vertical motion only the type of the number is read",
    ("_restrainers/combined.py", "np.asarray(0.0).dtype", "0.0 → 0.1"): "only the type of the number is read",
    ("_responses/floor.py", "roots.imag", "1e-07 → 1.1e-07"): "a rounding allowance of real roots",
    ("_oscillators.py", "counts = ", "1 → 1.1"): "the number of parts is made an integer",
    ("_oscillators.py", "counts = ", "1e-12 → 1.1e-12"): "a rounding allowance of the number of parts",
    ("_oscillators.py", "np.where(is_free, 0.0, ", "0.0 → 0.1"): "free vibration replaces this value",
    ("_oscillators.py", "np.where(is_free, peak.fraction, 0.0)", "0.0 → 0.1"): "only free vibration reads it",
    ("_responses/floor_course.py", "used_rows = ", "- → +"): "only rows after the last node change",
    ("_responses/floor_course.py", "lengths = ", "0.0 → 0.1"): "no motion follows the last node",
    ("_responses/floor_course.py", "axis=-1", "-x → x"): "the array has two axes",
    ("_responses/floor.py", "node < 0", "0 → 0.1"): "the index is an integer",
    ("_responses/floor.py", "finfo", "1.0 → 1.1"): "a rounding allowance",
    ("_responses/floor_end.py", "e = jnp.clip", "1.0 → 1.1"): "restitution factors are at most 1",
    ("_responses/floor_end.py", "jnp.where(s > 0, s, 1.0)", "1.0 → 1.1"): "without s there is no bound",
    ("_responses/floor_end.py", "integrals = ", "1.0 → 1.1"): "without damping there is no bound",
    ("_responses/floor_end.py", "loss = ", "1.0 → 1.1"): "without a loss there is no bound",
    ("_responses/floor_end.py", "loss = ", "1 → 1.1"): "without a loss there is no bound",
    ("_responses/floor_end.py", "gain = ", "1.0 → 1.1"): "without damping there is no bound",
    ("_responses/floor_end.py", "at_rest = ", "0.0 → 0.1"): "the value is multiplied by a weight of 0",
    ("_responses/floor_end.py", "ratio = later", "1.0 → 1.1"): "this ratio is not used",
    ("_excitations/piecewise.py", "index < count", "- → +"): "only indices beyond the last jump change",
    ("_responses/on_floors.py", "impacts > 0", "0 → 0.1"): "the number of impacts is an integer",
    ("_responses/on_floors.py", "started_by_impulse", "0 → 0.1"): "the value is 0 or 1",
    ("_responses/on_floors.py", "jnp.where(started, 1.0, note)", "1.0 → 1.1"): "only its sign is read",
    ("_responses/on_floors.py", "NEVER_LIFTS", "1.0 → 1.1"): "the podium under an oscillator never moves",
    ("_responses/on_floors.py", "NEVER_LIFTS", "0.0 → 0.1"): "the podium under an oscillator never moves",
    ("_responses/on_floors.py", "overturn_ratio=1.0", "1.0 → 1.1"): "this podium never overturns",
    ("_responses/on_floors.py", "atol=", "1e-17 → 1.1e-17"): "a tolerance below rounding",
    ("_excitations/piecewise.py", "is_inside = ", "0 → 0.1"): "the index is an integer",
    ("_excitations/piecewise.py", "is_inside, y, 1.0", "1.0 → 1.1"): "the value outside is replaced by 0",
    ("_excitations/piecewise.py", "row = self.coefficients", "- → +"): "only rows outside the motion change",
}
# Test files of each stage, the quickest stage first.
STAGES = (
    ("engine/test_certificate.py",),
    ("engine/test_model.py", "test_structures.py"),
    (
        "engine/test_closed_forms.py",
        "engine/test_edges.py",
        "engine/test_accuracy.py",
        "engine/test_hard_cases.py",
    ),
    (
        "engine/test_restrainers.py",
        "engine/test_vertical.py",
        "engine/test_modes.py",
        "engine/test_floors.py",
    ),
)
# Part of the path of a file ↦ its closest tests: (test files, the `-k` expression of pytest). Most of these
# tests solve no scene, so they take seconds. They run before the stages; `--stages 0` runs nothing else.
NEAREST = {
    "_restrainers/": (
        ("engine/test_restrainers.py",),
        "exact_numbers or one_joint or potential or from_dimensions or stability_angle_has or steep",
    ),
    "_structures/building.py": (("engine/test_modes.py",), "modes_of or omitted_modes_move or bad_input"),
    "_structures/superstructures.py": (
        ("engine/test_modes.py", "engine/test_restrainers.py", "test_structures.py"),
        "frequenc or exact_numbers",
    ),
    "_structures/podium.py": (
        ("test_structures.py", "engine/test_restrainers.py", "engine/test_modes.py"),
        "exact_numbers or dimensions or frequenc or equivalent_block",
    ),
    "_excitations/ground.py": (
        ("engine/test_first_uplift.py", "engine/test_vertical.py"),
        "pairs or first_uplift or jumps_of_both",
    ),
    "_oscillators.py": (
        ("test_oscillators.py", "engine/test_floor_course.py"),
        "oscillators or answers or free_vibration or divide or kick or differences",
    ),
    "_outputs/velocity_jump.py": (("engine/test_deck_outputs.py",), "test_"),
    "_responses/floor.py": (
        ("engine/test_floors.py", "studies/test_floor_spectra.py"),
        "closed_form or breakpoints or finite_jump or shear or keep or belong or inside or elastic_top",
    ),
    "_responses/floor_course.py": (("engine/test_floor_course.py",), "test_"),
    "_responses/floor_end.py": (
        ("engine/test_floor_course.py", "studies/test_floor_spectra.py"),
        "top_in_free or free_rocking or frame_without or bounds_after",
    ),
    "_responses/floor_slopes.py": (
        ("studies/test_floor_spectra.py",),
        "derivatives_agree or start_that_moves",
    ),
    "_responses/on_floors.py": (("engine/test_floor_course.py",), "block or oscillators"),
    "_excitations/piecewise.py": (("engine/test_floor_course.py",), "motion_through or block"),
    "_studies/floor_spectra.py": (("studies/test_floor_spectra.py",), "broadening"),
}
NO_TESTS = 5  # exit status of pytest if it selects no test
OPERATORS = {ast.Add: (ast.Sub, "+ → -"), ast.Sub: (ast.Add, "- → +")}
COMPARISONS = {
    ast.Gt: (ast.Lt, "> → <"),
    ast.Lt: (ast.Gt, "< → >"),
    ast.GtE: (ast.Lt, ">= → <"),
    ast.Eq: (ast.NotEq, "== → !="),
}


class Mutant(NamedTuple):
    """One change of one file.

    - `file`: the file, relative to `rockjax/`
    - `function`, `function_line`: name and first line of the function that contains the change
    - `line`, `text`: number and text of the changed line
    - `change`: the change in words, such as "+ → -"
    - `node_index`: index of the changed node in `ast.walk` of the function
    - `apply`: function that changes this node in place
    """

    file: str
    function: str
    function_line: int
    line: int
    text: str
    change: str
    node_index: int
    apply: Callable[[Any], None]

    def source(self) -> str:
        """Return the source of the changed file."""
        tree = ast.parse((ROOT / "rockjax" / self.file).read_text(encoding="utf-8"))
        function = next(
            node
            for node in ast.walk(tree)
            if isinstance(node, ast.FunctionDef) and node.lineno == self.function_line
        )
        self.apply(list(ast.walk(function))[self.node_index])
        return ast.unparse(ast.fix_missing_locations(tree))


def mutants() -> Iterator[Mutant]:
    """Yield all changes of the functions and methods in `FILES`."""
    for file in FILES:
        text = (ROOT / "rockjax" / file).read_text(encoding="utf-8")
        tree = ast.parse(text)
        classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
        for node in [*tree.body, *(method for cls in classes for method in cls.body)]:
            if not isinstance(node, ast.FunctionDef) or node.name.startswith(("__", "_repr")):
                continue
            if file not in EQUATIONS or node.name in EQUATIONS[file].split():
                yield from _mutants_of_function(file, text.splitlines(), node)


def _mutants_of_function(file: str, lines: list[str], function: ast.FunctionDef) -> Iterator[Mutant]:
    signature = [function.args, function.returns, *function.decorator_list]
    ignored = {id(node) for part in signature if part for node in ast.walk(part)}
    messages = [node for node in ast.walk(function) if isinstance(node, ast.JoinedStr)]
    ignored |= {id(node) for message in messages for node in ast.walk(message)}
    exponents = {
        id(node.right)
        for node in ast.walk(function)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow)
    }
    for index, node in enumerate(ast.walk(function)):
        if id(node) in ignored:
            continue
        for change, apply in _changes(node, id(node) in exponents):
            line = getattr(node, "lineno", function.lineno)
            text = lines[line - 1].strip()
            yield Mutant(file, function.name, function.lineno, line, text, change, index, apply)


def _changes(node: ast.AST, is_exponent: bool) -> Iterator[tuple[str, Callable[[Any], None]]]:
    """Yield the possible changes of a node, as (description, function that changes the node in place)."""

    def set_field(name: str, value: Any) -> Callable[[Any], None]:
        return lambda target: setattr(target, name, value)

    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        operator, change = OPERATORS[type(node.op)]
        yield change, set_field("op", operator())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield "-x → x", set_field("op", ast.UAdd())
    elif isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARISONS:
        comparison, change = COMPARISONS[type(node.ops[0])]
        yield change, set_field("ops", [comparison()])
    elif (
        isinstance(node, ast.Constant)
        and isinstance(node.value, int | float)
        and not isinstance(node.value, bool)
    ):
        other = node.value + 1 if is_exponent else float(f"{1.1 * node.value or 0.1:.12g}")
        yield f"{node.value} → {other}", set_field("value", other)


def stages_of(mutant: Mutant, stages: int) -> Iterator[list[str]]:
    """Yield the arguments of pytest for each stage of tests."""
    for path, (files, expression) in NEAREST.items():
        if path in mutant.file:
            yield ["-k", expression, *(f"tests/{name}" for name in files)]
    for stage in STAGES[:stages]:
        yield [f"tests/{name}" for name in stage]


def first_failure(mutant: Mutant, project: Path, stages: int) -> str:
    """Return the test that fails on a mutant, or "" if all pass.

    - `project`: folder of a copy of the project, whose file is changed and then restored
    - `stages`: number of stages of `STAGES` to run

    Raises `RuntimeError` if a stage contains no test.
    """
    target = project / "rockjax" / mutant.file
    original = target.read_text(encoding="utf-8")
    plain = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    command = [sys.executable, "-m", "pytest", *plain, "-m", "not slow"]
    environment = os.environ | {"PYTHONPATH": str(project), "MPLBACKEND": "Agg"}
    try:
        target.write_text(mutant.source(), encoding="utf-8")
        for stage in stages_of(mutant, stages):
            run = subprocess.run(
                [*command, *stage], cwd=project, env=environment, capture_output=True, text=True, timeout=1200
            )
            if run.returncode == NO_TESTS:
                raise RuntimeError(f"pytest selects no test for {' '.join(stage)}; correct NEAREST")
            if run.returncode:
                lines = run.stdout.splitlines()
                failed = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
                return (failed or lines[-1:] or ["crash"])[0].split(" - ")[0].split("::")[-1]
    except subprocess.TimeoutExpired:
        return "timeout"
    finally:
        target.write_text(original, encoding="utf-8")
    return ""


def harmless_reason(mutant: Mutant) -> str:
    """Return the reason of `HARMLESS` for a mutant, or "" if it is not listed there."""
    reasons = (
        reason
        for (file, text, change), reason in HARMLESS.items()
        if file == mutant.file and text in mutant.text and change == mutant.change
    )
    return next(reasons, "")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "words", nargs="*", help="try only changes whose file, function and change contain all of these words"
    )
    parser.add_argument("--list", action="store_true", help="count the changes and run no test")
    parser.add_argument("--every", type=int, default=1, help="try every K-th change only")
    parser.add_argument(
        "--stages",
        type=int,
        default=len(STAGES),
        help="number of stages of tests, the quickest first; with fewer stages fewer changes are noticed",
    )
    parser.add_argument("--processes", type=int, default=2, help="number of copies tested at the same time")
    arguments = parser.parse_args()
    words = arguments.words
    chosen = [m for m in mutants() if all(w in f"{m.file} {m.function} {m.change}" for w in words)]
    if arguments.list:
        counts = collections.Counter((m.file, m.function) for m in chosen)
        listed = [{"file": file, "function": name, "changes": k} for (file, name), k in counts.items()]
        total = {"file": "all", "function": "", "changes": len(chosen)}
        show([*listed, total])
        return
    chosen = chosen[:: arguments.every]
    copies: queue.Queue[Path] = queue.Queue()
    with tempfile.TemporaryDirectory() as folder:
        for k in range(arguments.processes):
            project = Path(folder) / str(k)
            for part in ("rockjax", "optimise", "tests", "docs", "benchmarks"):
                shutil.copytree(ROOT / part, project / part, ignore=shutil.ignore_patterns("__pycache__"))
            for name in ("pyproject.toml", "README.md"):
                shutil.copy(ROOT / name, project / name)
            copies.put(project)

        def test(mutant: Mutant) -> str:
            project = copies.get()
            try:
                return first_failure(mutant, project, arguments.stages)
            finally:
                copies.put(project)
                bar.update()

        with (
            tqdm(total=len(chosen), unit=" mutants") as bar,
            ThreadPoolExecutor(arguments.processes) as pool,
        ):
            failures = list(pool.map(test, chosen))
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    survivors = []
    for mutant, failure in zip(chosen, failures, strict=True):
        row = rows.setdefault(
            (mutant.file, mutant.function),
            {"file": mutant.file, "function": mutant.function, "changes": 0, "noticed": 0, "harmless": 0},
        )
        row["changes"] += 1
        row["noticed"] += bool(failure)
        if not failure:
            reason = harmless_reason(mutant)
            row["harmless"] += bool(reason)
            where = f"{mutant.file}:{mutant.line}"
            survivors.append({"where": where, "change": mutant.change, "line": mutant.text, "why": reason})
    table = list(rows.values())
    sums = {k: sum(r[k] for r in table) for k in ("changes", "noticed", "harmless")}
    table.append({"file": "all", "function": ""} | sums)
    show(table)
    print("\nnot noticed:" if survivors else "\nevery change is noticed")
    for row in survivors:
        print(f"  {row['where']}  {row['change']}:  {row['line']}  {row['why']}")
    if not words and arguments.every == 1:
        store_rows("mutations", [*table, {"survivors": survivors}])


if __name__ == "__main__":
    main()
