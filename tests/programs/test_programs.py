"""Programs kept between processes: they never change an answer and never stop a call."""

import dataclasses
import errno
import logging
import os
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._programs import folder, kind, program
from rockjax._programs.kept import COUNTS, KEEPING
from rockjax._programs.program import KeptProgram, forget
from tests.compiling import compiled_by
from tests.scenes import PODIUMS
from tests.threads import wait_for


def waves(x, y, times=2):
    """Something to compile, in no time."""
    TRACED.append(times)
    return {"sum": jnp.sin(x) * times + y["a"], "x": (x, None)}


@pytest.fixture(scope="module", autouse=True)
def _only_its_own():
    """What JAX's own cache has is not kept a second time: here it holds nothing so small."""
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)
    yield
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


TRACED = []
ARGUMENTS = np.linspace(0, 1, 7), {"a": 0.25}


@pytest.fixture
def kept(monkeypatch, tmp_path):
    """A program of its own, in a folder of its own: `kept.call()` is a call as of a new process, (answer,
    traced anew)."""
    monkeypatch.setenv("ROCKJAX_CACHE_DIR", str(tmp_path / "cache"))
    waves.__module__ = "rockjax.waves"  # whose source is known
    made = KeptProgram(waves)

    class Kept:
        place = tmp_path / "cache" / "programs"

        def call(self, *arguments, **named):
            made.forget()
            before = len(TRACED)
            answer = made(*(arguments or ARGUMENTS), **named)
            wait_for(KEEPING)
            assert np.array_equal(answer["sum"], expected(*(arguments or ARGUMENTS), **named))
            return len(TRACED) > before

        def file(self):
            (found,) = self.place.glob("*.program")
            return found

    yield Kept()
    program._ALL.remove(made)


def expected(x, y, times=2):
    return jax.jit(lambda x, a: jnp.sin(x) * times + a)(x, y["a"])


def test_a_program_is_traced_once_for_its_kind(kept):
    assert kept.call()
    assert not kept.call()
    assert not kept.call(np.linspace(2, 3, 7), {"a": 0.5})  # whatever the numbers
    assert kept.call(np.linspace(0, 1, 8), {"a": 0.25})
    assert kept.call(np.linspace(0, 1, 7, dtype=np.float32), {"a": 0.25})
    assert kept.call(times=3)
    assert kept.place.stat().st_mode & 0o777 == 0o700
    assert len(folder.entries(kept.place)) == 4


def test_what_is_traced_goes_through_jit(kept):
    x, y = ARGUMENTS
    made = program._ALL[-1]
    slope = jax.grad(lambda a: made(x, {"a": a})["sum"].sum())(0.25)
    rows = jax.vmap(lambda x: made(x, y)["sum"])(x)
    assert float(slope) == 7
    np.testing.assert_array_equal(rows, jax.jit(lambda x: made(x, y)["sum"])(x))
    assert not kept.place.exists()


@pytest.mark.parametrize("harm", ["cut", "changed", "emptied", "another"])
def test_a_damaged_program_is_compiled_again(kept, harm):
    kept.call()
    file = kept.file()
    content = bytearray(file.read_bytes())
    if harm == "another":  # a whole one, under a wrong name
        file.unlink()
        kept.call(times=3)
        kept.file().rename(file)
    else:
        content[len(content) // 2] ^= 1
        file.write_bytes({"cut": content[: len(content) // 2], "changed": content, "emptied": b""}[harm])
    assert kept.call()
    assert not kept.call()


def test_a_program_that_cannot_be_loaded_is_compiled_again(kept, monkeypatch):
    kept.call()
    with monkeypatch.context() as patch:
        patch.setattr(folder, "read", lambda *_: b"the format of another library")
        assert kept.call()
    assert not kept.call()


@pytest.mark.parametrize("what", ["version", "_processor", "_settings"])
def test_another_version_processor_or_setting_is_another_program(kept, monkeypatch, what):
    kept.call()
    kind._made_of.cache_clear()
    monkeypatch.setattr(kind, what, lambda *_: "another")
    assert kept.call()
    kind._made_of.cache_clear()
    monkeypatch.undo()


def test_changed_source_is_another_program(kept, monkeypatch):
    kept.call()
    monkeypatch.setattr(kind, "source", lambda: "edited")
    assert kept.call()


@pytest.mark.parametrize("file", ["step.py", "tableaus.json"])
def test_modules_and_numbers_beside_them_are_source(file, tmp_path, monkeypatch):
    copy = tmp_path / "rockjax" / "_engine"
    copy.mkdir(parents=True)
    (copy.parent / "__init__.py").write_text("")
    for name in ("step.py", "tableaus.json"):
        (copy / name).write_text(name)
    spec = SimpleNamespace(origin=str(copy.parent / "__init__.py"))
    monkeypatch.setattr(kind, "find_spec", lambda _: spec)
    source = kind.source.__wrapped__
    before = source()
    assert source() == before
    (copy / file).write_text("edited")
    assert source() != before


@pytest.mark.parametrize("mode", [0o777, 0o720, 0o702])
def test_nothing_is_read_where_others_can_write(kept, mode, caplog):
    kept.call()
    kept.place.chmod(mode)
    with caplog.at_level(logging.DEBUG, "rockjax"):
        assert kept.call()
    assert "others can write" in caplog.text
    kept.place.chmod(0o700)
    kept.file().chmod(0o666)
    assert kept.call()  # and written anew
    assert kept.file().stat().st_mode & 0o777 == 0o600
    assert not kept.call()


def test_nothing_is_read_that_belongs_to_others(kept, monkeypatch):
    kept.call()
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert kept.call()


def test_a_folder_that_cannot_be_made_stops_nothing(kept, tmp_path):
    (tmp_path / "cache").write_text("a file")
    assert kept.call()
    assert kept.call()


def test_a_full_disk_stops_nothing(kept, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    assert kept.call()
    assert not list(kept.place.iterdir())  # nothing half-written is left


def test_the_size_is_limited(kept, monkeypatch):
    kept.call()
    size = kept.file().stat().st_size
    monkeypatch.setenv("ROCKJAX_CACHE_SIZE", str(2.5 * size / 2**20))
    for age, times in enumerate((3, 4, 5, 6)):
        for k, entry in enumerate(folder.entries(kept.place)):
            os.utime(entry.path, (1000 * age + k, 1000 * age + k))
        assert kept.call(times=times)
        assert len(folder.entries(kept.place)) == 2
    assert not kept.call(times=6)
    monkeypatch.setenv("ROCKJAX_CACHE_SIZE", "much")
    assert not kept.call(times=6)
    assert kept.call(times=9)  # no limit that could be kept to: not written, and answered


def test_one_setting_turns_it_off(kept, monkeypatch):
    monkeypatch.setenv("ROCKJAX_CACHE", "off")
    assert kept.call()
    assert kept.call()
    assert not kept.place.exists()


def test_the_folder_is_where_the_user_says(monkeypatch, tmp_path):
    monkeypatch.delenv("ROCKJAX_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert folder.path() == tmp_path / "rockjax"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert folder.path().name == "rockjax"
    assert folder.path().is_absolute()


def test_a_program_is_made_ready_ahead(kept):
    """By another thread, under the settings of this one; and who calls it meanwhile waits for that one."""
    made, before = program._ALL[-1], len(TRACED)
    made.ahead(*ARGUMENTS)
    made.ahead(*ARGUMENTS, times=3)
    answers = made(*ARGUMENTS), made(*ARGUMENTS, times=3)
    assert len(TRACED) == before + 2
    for times, answer in zip((2, 3), answers, strict=True):
        np.testing.assert_array_equal(answer["sum"], expected(*ARGUMENTS, times=times))
    with jax.numpy_rank_promotion("warn"):  # which that thread would not have
        made.ahead(*ARGUMENTS, times=4)
    wait_for(program.AHEAD)
    assert len(TRACED) == before + 2


def test_functions_of_the_users_own_are_known_by_what_they_do(kept):
    """Written anew in every process, with numbers of their own, and with derivatives of their own."""
    made = lambda factor: kind.TracedFunction(lambda podium: factor * jnp.tan(podium.alpha), PODIUMS["block"])
    assert kind.describe(made(2.0)) == kind.describe(made(2.0)) != kind.describe(made(3.0))
    assert made(2.0) == made(2.0) != made(3.0)
    assert float(made(2.0)(PODIUMS["block"])) == 2 * float(jnp.tan(PODIUMS["block"].alpha))
    held = kind.TracedFunction(
        lambda podium: 2 * jnp.tan(jax.lax.stop_gradient(podium.alpha)), PODIUMS["block"]
    )
    assert held.text != made(2.0).text
    assert kind.describe((held,)) != kind.describe((made(2.0),))


def test_threads_compile_a_program_once(kept):
    made, before = program._ALL[-1], len(TRACED)
    answers = []
    threads = [threading.Thread(target=lambda: answers.append(made(*ARGUMENTS)["sum"])) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(TRACED) == before + 1
    assert all(np.array_equal(answers[0], y) for y in answers)


def test_functions_of_no_module_have_no_name():
    names: dict = {}
    exec("def ask(x):\n    return x", {"__name__": None}, names)
    for thing in (names["ask"], lambda x: x):
        with pytest.raises(kind.Unknown):
            kind.describe(thing)


def test_classes_of_the_user_are_known_by_what_they_compute(kept):
    """A function of the user's may change while its name stays."""

    def law(x):
        return 2 * x

    made = KeptProgram(lambda law, x: law(x))
    try:
        assert float(made(law, 3.0)) == 6
        made.forget()
        law = lambda x: 3 * x
        law.__qualname__ = "law"
        assert float(made(law, 3.0)) == 9
        with pytest.raises(kind.Unknown):
            kind.describe(law)
    finally:
        program._ALL.remove(made)


def test_compiling_that_takes_long_is_said_once(kept, monkeypatch, caplog):
    monkeypatch.setattr(program, "_PATIENCE", 0.0)
    program._SAID.clear()
    caplog.set_level(logging.WARNING, logger="rockjax")  # a quiet command in this process has raised it
    for times in (2, 3, 4):
        kept.call(times=times)
    said = [record for record in caplog.records if "compiling" in record.getMessage()]
    assert len(said) == 1
    assert said[0].name == "rockjax"
    assert said[0].levelno == logging.WARNING  # shown in notebooks without any setting


SCRIPT = """
import rockjax as rj, numpy as np
podium = rj.Podium(alpha=0.15, R=1.5, gamma=10.0, superstructure=rj.Rigid(eta=100.0))
peaks = rj.peak_responses(podium, rj.Ricker(np.array([1.0, 2.0, 3.0]), 1.0))
alone = rj.peak_response(podium, rj.Ricker(2.0, 1.0)).peak_rotation
print([float(y).hex() for y in (*peaks.peak_rotation, alone)])
from rockjax._programs.kept import COUNTS
print(COUNTS)
"""


@pytest.mark.slow
def test_several_processes_at_once(tmp_path):
    """They write the same programs at the same time; all answer the same, and so does one that compiles for
    itself."""
    # Without a cache of JAX's own, which a sweep of the command line leaves to processes.
    environment = {name: y for name, y in os.environ.items() if not name.startswith("JAX_COMPILATION_CACHE")}
    environment["ROCKJAX_CACHE_DIR"] = str(tmp_path)
    command = [sys.executable, "-c", SCRIPT]
    alone = subprocess.run(
        command, env=environment | {"ROCKJAX_CACHE": "off"}, capture_output=True, text=True, check=True
    )
    both = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    answers = [process.communicate()[0].splitlines() for process in both]
    later = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    assert {answer[0] for answer in (*answers, later)} == {alone.stdout.splitlines()[0]}
    assert later[1] == "{'loaded': 2, 'compiled': 0}"
    assert not later[2:]


def test_derivatives_of_known_numbers_are_those_of_jit():
    podium = PODIUMS["rigid"]

    def peak(alpha, a_p):
        return rj.peak_response(podium.replace(alpha=alpha), rj.Ricker(a_p, 1.0)).peak_rotation

    point = 0.15, 3.0
    traced = jax.jit(jax.grad(peak, (0, 1)))(*point)
    for found in (
        jax.grad(peak, (0, 1))(*point),
        jax.jacfwd(peak, (0, 1))(*point),
        jax.jacrev(peak, (0, 1))(*point),
    ):
        np.testing.assert_allclose(found, traced, rtol=1e-12)
    _, along = jax.jvp(peak, point, (1.0, 2.0))
    assert float(along) == pytest.approx(float(traced[0] + 2 * traced[1]), rel=1e-12)
    counts = dict(COUNTS)
    jax.grad(lambda R: rj.peak_response(podium.replace(R=R), rj.Ricker(3.0, 1.0)).margin)(1.6)
    assert counts == COUNTS  # whichever derivative it is
    with pytest.raises(NotImplementedError, match="first derivatives only"):
        jax.grad(jax.grad(peak))(*point)


def test_kept_answers_are_those_of_this_process():
    podium, motion = PODIUMS["rigid"], rj.Ricker(3.0, 1.0)
    first = rj.peak_response(podium, motion)
    forget()
    again = rj.peak_response(podium, motion)
    traced = jax.jit(lambda a_p: rj.peak_response(podium, rj.Ricker(a_p, 1.0)))(3.0)
    assert jax.tree.all(jax.tree.map(lambda a, b: np.array_equal(a, b, equal_nan=True), first, again))
    assert float(first.peak_rotation) == pytest.approx(float(traced.peak_rotation), rel=1e-12)


def test_records_of_other_lengths_share_programs():
    """And however much fills one up, its answers are the same to the last bit."""
    from rockjax._motions.record import PaddedRecord

    samples = 8 * np.convolve(np.random.default_rng(1).normal(size=1300), np.hanning(12) / 6, "same")
    podium, options = PODIUMS["rigid"], rj.Options(rtol=1e-6, atol=1e-8)
    peak = lambda motion: rj.peak_response(podium, motion, options=options)
    long = peak(rj.Record(samples, 0.01))
    counts = dict(COUNTS)
    short = peak(rj.Record(samples[:290], 0.01))
    assert counts == COUNTS
    assert int(long.stats.steps) != int(short.stats.steps)
    more = np.pad(samples[:290], (0, 512 - 290))
    again = peak(PaddedRecord(more, 0.01, count=290))
    assert jax.tree.all(jax.tree.map(lambda a, b: np.array_equal(a, b, equal_nan=True), short, again))
    traced = jax.jit(lambda dt: peak(rj.Record(samples[:290], dt)))(0.01)
    assert float(traced.peak_rotation) == pytest.approx(float(short.peak_rotation), rel=1e-12)
    assert int(traced.impacts) == int(short.impacts)


def _noise(count: int, seed: int) -> np.ndarray:
    return 8 * np.convolve(np.random.default_rng(seed).normal(size=count), np.hanning(12) / 6, "same")


def _in_pair(count: int, dt: float, factor: float):
    horizontal = rj.Motion(factor * _noise(count, 2), dt)
    return dataclasses.replace(horizontal, vertical=rj.Motion(0.2 * _noise(count // 2, 3), dt))


@pytest.mark.parametrize(
    "motion",
    [lambda count, dt, factor: rj.Motion(factor * _noise(count, 1), dt, name=f"{count}"), _in_pair],
    ids=["horizontal", "with a vertical motion"],
)
def test_further_motions_of_a_set_compile_nothing(motion, caplog):
    """Of other lengths, sampling intervals, strengths and names, which lead to other numbers of steps and
    impacts: a peak, a history and its dataset."""
    podium = rj.Podium(0.25, 3.0, 10.0, rj.Elastic(30.0, 0.3, 0.05))

    def solve(each):
        peak = rj.peak_response(podium, each)
        response = rj.simulate(podium, each)
        data = response.dataset()
        assert float(data["peak_rotation"]) == pytest.approx(float(peak.peak_rotation), rel=1e-6)
        return response.times.size, data.sizes["impact"]

    first = solve(motion(600, 0.01, 0.5))
    caplog.clear()
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        others = [
            solve(motion(count, dt, factor))
            for count, dt, factor in (
                (2500, 0.01, 0.5),
                (5000, 0.005, 0.5),
                (300, 0.02, 0.6),
                (800, 0.01, 0.05),
            )
        ]
    assert not [record.message for record in caplog.records if "Finished XLA compilation" in record.message]
    assert len({first, *others}) == 5  # no two are alike
    assert max(steps for steps, _ in others) > 4096


def test_suites_of_other_sizes_share_programs():
    """Of other numbers of records, and other lengths: the table is filled up, and says the same."""
    podium, options = PODIUMS["rigid"], rj.Options(rtol=1e-6, atol=1e-8)
    noise = 8 * np.random.default_rng(1).normal(size=(5, 120)).cumsum(axis=1)
    records = [rj.Record(noise[k, : 120 - 7 * k], 0.02) for k in range(5)]
    peaks = lambda members: rj.peak_responses(podium, rj.Records.of(members), options=options)
    whole = peaks(records)
    counts = dict(COUNTS)
    part = peaks(records[1:4])
    assert counts == COUNTS
    np.testing.assert_array_equal(part.peak_rotation, whole.peak_rotation[1:4])
    alone = [rj.peak_response(podium, record, options=options).peak_rotation for record in records]
    np.testing.assert_allclose(whole.peak_rotation, np.array(alone), rtol=1e-9)


@pytest.mark.parametrize("kind", ["rigid", "block"])
def test_options_that_ask_for_the_same_share_programs(kind):
    """Whatever the order of outputs, with or without those that the podium does not have."""
    podium, pulse = PODIUMS[kind], rj.Ricker(3.0, 0.8)
    shear = ("peak_shear",) if kind == "rigid" else ()
    same = [
        {"throw": False},
        {"history": 64},
        {"outputs": (*shear, "peak_rotation")},
        {"outputs": ("peak_deformation", "peak_rotation", "peak_floor_acceleration", *shear)},
    ]
    batch = lambda **chosen: rj.peak_responses(
        podium, rj.Ricker(np.linspace(1, 6, 3), 0.8), options=rj.Options(**chosen)
    )
    one = lambda **chosen: rj.peak_response(podium, pulse, options=rj.Options(**chosen))
    for peaks in (one, batch):
        plain = peaks()
        counts = dict(COUNTS)
        for chosen in same:
            found = peaks(**chosen)
            np.testing.assert_array_equal(found.peak_rotation, plain.peak_rotation)
            np.testing.assert_array_equal(found.peak_shear, plain.peak_shear)
        assert counts == COUNTS


def broken(*passed):
    raise jax.errors.JaxRuntimeError("NOT_FOUND: Function add_fusion not found (type id: 1)")


def test_an_answer_of_modules_is_not_kept(monkeypatch, tmp_path):
    """Such a program would be loaded, and fail when it is called."""
    monkeypatch.setenv("ROCKJAX_CACHE_DIR", str(tmp_path))
    made = KeptProgram(_steeper, name="tests.steeper")
    for _ in range(2):
        answer = made(PODIUMS["rigid"], 2.0)
        assert float(answer.alpha) == 2 * float(PODIUMS["rigid"].alpha)
        wait_for(KEEPING)
        made.forget()
    program._ALL.remove(made)


def _steeper(podium, factor):
    return podium.replace(alpha=factor * podium.alpha)


def test_a_broken_program_of_the_users_own_classes_is_taken_away(kept, monkeypatch):
    """XLA notices only when such a program is run."""
    made = KeptProgram(lambda law, x: law(x))
    try:
        assert float(made(lambda x: 5 * x, 3.0)) == 15
        wait_for(KEEPING)
        assert len(folder.entries(kept.place)) == 1
        made.forget()
        with monkeypatch.context() as patch:
            patch.setattr(program, "load", lambda place, text: broken)
            assert float(made(lambda x: 5 * x, 3.0)) == 15
        assert not folder.entries(kept.place)
    finally:
        program._ALL.remove(made)


def test_a_program_without_its_code_is_compiled_again(kept, monkeypatch):
    """XLA notices only when such a program is run."""
    assert kept.call()
    with monkeypatch.context() as patch:
        patch.setattr(program, "load", lambda place, text: broken)
        assert kept.call()  # traced anew, with the right answer
    assert kept.call()  # what was broken is gone from the folder
    assert not kept.call()


@pytest.mark.slow
def test_what_comes_from_the_cache_of_jax_is_not_kept(tmp_path):
    """Kept, it would be without its code: XLA writes out only what it has compiled itself."""
    code = (
        "import jax, rockjax as rj\n"
        "from rockjax._programs.kept import COUNTS\n"
        "peak = rj.peak_response(rj.Podium(0.2, 1.0), rj.Ricker(4.0, 1.0), "
        "options=rj.Options(method='bosh3'))\n"
        "print(peak.peak_rotation.item().hex(), COUNTS['loaded'])"
    )
    settings = {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "jax"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }

    def run(folder):
        env = os.environ | settings | {"ROCKJAX_CACHE_DIR": str(tmp_path / folder)}
        done = subprocess.run(
            [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
        )
        return done.stdout.split()

    first, again = run("one"), run("one")
    assert again == [first[0], "1"]
    # Another folder of programs, as after a change of the source: JAX's own cache has them.
    assert run("two") == [first[0], "0"]
    assert run("two") == [first[0], "0"]


def test_importing_leaves_settings_of_jax_open():
    """What runs where is decided when JAX's backend starts: until then its platform can be chosen."""
    asked = (
        "import jax, rockjax\n"
        "from jax.extend import backend\n"
        "jax.config.update('jax_num_cpu_devices', 3)\n"  # an error once it has started
        "print(len(backend.backends()['cpu'].devices()))"
    )
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["3"]


def test_threads_trace_one_after_another(kept):
    """Or the first would get to compiling only when all are done; and two that need each other's programs do
    not wait for ever."""
    from rockjax._programs.turns import is_mine, turn

    made, answers = program._ALL[-1], []
    other = threading.Thread(target=lambda: made(*ARGUMENTS), daemon=True)

    def tracing():
        with turn():
            assert is_mine()
            other.start()
            while not made._making:  # the other holds the lock of this program, and waits for its turn
                time.sleep(0.01)
            time.sleep(0.2)
            assert other.is_alive()
            answers.append(made(*ARGUMENTS))
        assert not is_mine()

    first = threading.Thread(target=tracing, daemon=True)
    first.start()
    for thread in (first, other):
        thread.join(60)
        assert not thread.is_alive()
    np.testing.assert_array_equal(answers[0]["sum"], expected(*ARGUMENTS))


def test_a_program_that_needs_lapack_finds_it_in_a_later_process(tmp_path):
    """JAX looks for it when something is lowered, which a later process does not do: calling it ended the
    process."""
    script = (
        "import numpy as np, jax, rockjax\n"
        "from rockjax._programs.kept import COUNTS\n"
        "from rockjax._programs.program import KeptProgram\n"
        "solve = KeptProgram(lambda a, b: jax.numpy.linalg.solve(a, b), name='rockjax.solve')\n"
        "print(solve(np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([3.0, 4.0])), COUNTS['loaded'])"
    )
    environment = os.environ | {"ROCKJAX_CACHE_DIR": str(tmp_path / "cache")}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    for loaded in (0, 1):
        done = subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
        )
        assert done.stdout.split() == ["[1.", "1.]", str(loaded)]


SUITE = [rj.Record(4 * np.sin(np.linspace(0, 12 + k, 150 + 9 * k)), 0.02) for k in range(3)]
ALONE = {
    "a pulse": lambda: rj.peak_response(PODIUMS["rigid"], rj.Ricker(3.0, 1.0)),
    "a boundary": lambda: rj.overturning_acceleration(PODIUMS["rigid"], rj.Ricker, 1.0, width=1e-2),
    "a record's boundary": lambda: rj.overturning_boundary(PODIUMS["rigid"], SUITE[0], width=1e-2),
    "an analysis": lambda: rj.incremental_dynamic_analysis(
        PODIUMS["rigid"], SUITE, np.linspace(1, 9, 4), width=1e-2, resolution=32
    ),
    "a spectrum": lambda: rj.rocking_spectrum(PODIUMS["rigid"], rj.Ricker, [1.0, 2.0, 3.0], [2.0, 4.0]),
}


@pytest.mark.parametrize("name", ALONE)
def test_nothing_but_kept_programs_is_compiled(name, caplog):
    """Of JAX every operation on its own is a program for every shape, made anew in every process: 10 to 30 ms
    each."""
    ALONE[name]()
    assert not compiled_by(ALONE[name], caplog)
