"""Stored programs never change an answer and never prevent a call."""

import errno
import logging
import os
import threading
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._programs import key, program, store
from rockjax._programs.program import COUNTS, StoredProgram, finish_writing, forget
from tests.compiling import compiled_by
from tests.scenes import PODIUMS

TRACED = []
ARGUMENTS = np.linspace(0, 1, 7), {"a": 0.25}


def waves(x, y, times=2):
    TRACED.append(times)
    return {"sum": jnp.sin(x) * times + y["a"], "x": (x, None)}


@pytest.fixture(scope="module", autouse=True)
def _no_small_programs_in_the_cache_of_jax():
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)
    yield
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


class Stored:
    """A program in a separate folder; each call acts like a new process."""

    def __init__(self, root):
        self.root, self.folder = root, root / "programs"
        self.program = StoredProgram(waves)

    def call(self, x=ARGUMENTS[0], y=ARGUMENTS[1], **named) -> bool:
        """Return whether the call traces the function, and check its answer."""
        self.program.forget()
        before = len(TRACED)
        answer = self.program(x, y, **named)
        finish_writing()
        direct = jax.jit(lambda x, a: jnp.sin(x) * named.get("times", 2) + a)(x, y["a"])
        np.testing.assert_array_equal(answer["sum"], direct)
        return len(TRACED) > before

    def file(self):
        (found,) = self.folder.glob("*")
        return found


@pytest.fixture
def stored(monkeypatch, tmp_path):
    monkeypatch.setenv("ROCKJAX_CACHE_DIR", str(tmp_path / "cache"))
    waves.__module__ = "rockjax.waves"  # part of a package whose source is hashed
    made = Stored(tmp_path / "cache")
    yield made
    program._PROGRAMS.remove(made.program)


def test_a_program_is_traced_once_for_its_kind(stored):
    assert stored.call()
    assert not stored.call()
    assert not stored.call(np.linspace(2, 3, 7), {"a": 0.5})  # for all values
    assert stored.call(np.linspace(0, 1, 8))
    assert stored.call(np.linspace(0, 1, 7, dtype=np.float32))
    assert stored.call(times=3)
    assert stored.folder.stat().st_mode & 0o777 == 0o700
    assert len(store.entries()) == 4


def test_traced_arguments_go_through_jit(stored):
    x, y = ARGUMENTS
    slope = jax.grad(lambda a: stored.program(x, {"a": a})["sum"].sum())(0.25)
    rows = jax.vmap(lambda x: stored.program(x, y)["sum"])(x)
    assert float(slope) == 7
    np.testing.assert_array_equal(rows, jax.jit(lambda x: stored.program(x, y)["sum"])(x))
    assert not stored.folder.exists()


@pytest.mark.parametrize("harm", ["cut", "changed", "emptied", "another", "foreign"])
def test_a_damaged_program_is_compiled_again(stored, harm, monkeypatch):
    stored.call()
    file = stored.file()
    content = bytearray(file.read_bytes())
    if harm == "another":  # an intact program under a wrong name
        file.unlink()
        stored.call(times=3)
        stored.file().rename(file)
    elif harm == "foreign":  # a valid checksum, but another library version
        monkeypatch.setattr(store, "read", lambda _: b"something else")
        assert stored.call()
        monkeypatch.undo()
        monkeypatch.setenv("ROCKJAX_CACHE_DIR", str(stored.root))
        return
    else:
        content[len(content) // 2] ^= 1
        file.write_bytes({"cut": content[: len(content) // 2], "changed": content, "emptied": b""}[harm])
    assert stored.call()
    assert not stored.call()


@pytest.mark.parametrize("what", ["version", "describe_machine", "source_hash"])
def test_another_version_setting_or_source_is_another_program(stored, monkeypatch, what):
    stored.call()
    key._describe_versions.cache_clear()
    with monkeypatch.context() as patch:
        patch.setattr(key, what, lambda *_: "another")
        assert stored.call()
        if what == "version":
            key._describe_versions.cache_clear()
    assert not stored.call()


@pytest.mark.parametrize("file", ["step.py", "tableaus.json"])
def test_modules_and_tables_of_numbers_are_source(file, tmp_path, monkeypatch):
    copy = tmp_path / "rockjax" / "_engine"
    copy.mkdir(parents=True)
    (copy.parent / "__init__.py").write_text("")
    for name in ("step.py", "tableaus.json"):
        (copy / name).write_text(name)
    monkeypatch.setattr(key, "_IMPORTED", np.inf)
    spec = SimpleNamespace(origin=str(copy.parent / "__init__.py"))
    monkeypatch.setattr(key, "find_spec", lambda _: spec)
    before = key.source_hash.__wrapped__()
    assert key.source_hash.__wrapped__() == before
    (copy / file).write_text("edited")
    assert key.source_hash.__wrapped__() != before
    written = (copy / file).stat().st_mtime
    os.utime(copy / file, (written + 20.0, written + 20.0))
    monkeypatch.setattr(key, "_IMPORTED", written + 10.0)
    with pytest.raises(key.NoKeyError, match=f"{file} was changed"):  # the process may run other code
        key.source_hash.__wrapped__()


def test_numpy_scalars_have_their_values_as_keys():
    for kind in (np.int64, np.bool_, np.float32):
        assert key.describe(kind(0)) == key.describe(kind(0)) != key.describe(kind(1))


@pytest.mark.parametrize(
    "value", [range(3), np.sin, slice(1), np.ones(2)], ids=["range", "ufunc", "slice", "array"]
)
def test_objects_with_hidden_fields_have_no_key(value):
    with pytest.raises(key.NoKeyError):
        key.describe(value)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="Windows has access lists")
def test_nothing_is_read_that_others_own_or_can_write(stored, monkeypatch, caplog):
    stored.call()
    for mode in (0o777, 0o720, 0o702):
        stored.folder.chmod(mode)
        with caplog.at_level(logging.DEBUG, "rockjax"):
            assert stored.call()
        assert "other users can write" in caplog.text
    stored.folder.chmod(0o700)
    stored.file().chmod(0o666)
    assert stored.call()  # and stored again
    assert stored.file().stat().st_mode & 0o777 == 0o600
    assert not stored.call()
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert stored.call()


@pytest.mark.parametrize("trouble", ["no folder", "full disk", "off", "no limit"])
def test_a_store_that_cannot_be_used_stops_nothing(stored, monkeypatch, trouble):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    if trouble == "no folder":
        stored.root.write_text("a file")
    elif trouble == "full disk":
        monkeypatch.setattr(os, "replace", full)
    else:
        monkeypatch.setenv(
            *{"off": ("ROCKJAX_CACHE", "off"), "no limit": ("ROCKJAX_CACHE_SIZE", "much")}[trouble]
        )
    assert stored.call()
    assert stored.call()
    assert not list(stored.folder.glob("*"))  # no incomplete file remains


def test_the_size_is_limited_and_the_store_can_be_cleared(stored, monkeypatch):
    stored.call()
    size = stored.file().stat().st_size
    monkeypatch.setenv("ROCKJAX_CACHE_SIZE", str(2.5 * size / 2**20))
    for age, times in enumerate((3, 4, 5, 6)):
        for k, entry in enumerate(store.entries()):
            os.utime(entry.path, (1000 * age + k, 1000 * age + k))
        assert stored.call(times=times)
        assert len(store.entries()) == 2
    assert not stored.call(times=6)
    assert store.clear() == 2
    assert stored.call(times=6)


def test_the_folder_is_where_the_user_says(monkeypatch, tmp_path):
    monkeypatch.delenv("ROCKJAX_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert store.root() == tmp_path / "rockjax"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert store.root().name == "rockjax"
    assert store.root().is_absolute()


def test_threads_share_a_program_and_one_can_make_it_ahead(stored):
    stored.program.prepare(*ARGUMENTS)
    before, answers = len(TRACED), []
    threads = [threading.Thread(target=lambda: answers.append(stored.program(*ARGUMENTS))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(TRACED) <= before + 1
    assert all(np.array_equal(answers[0]["sum"], y["sum"]) for y in answers)
    with jax.numpy_rank_promotion("warn"):  # another thread does not have this setting
        stored.program.prepare(*ARGUMENTS, times=4)
    assert 4 not in TRACED[before:]


def test_a_thread_that_traces_does_not_wait_for_one_that_waits_to_trace(stored):
    answers = []
    other = threading.Thread(target=lambda: stored.program(*ARGUMENTS), daemon=True)

    def tracing():
        with program._tracing():
            other.start()
            while not stored.program._locks:  # wait until the other thread holds the lock
                pass
            answers.append(stored.program(*ARGUMENTS))

    first = threading.Thread(target=tracing, daemon=True)
    first.start()
    for thread in (first, other):
        thread.join(60)
        assert not thread.is_alive()
    assert len(answers) == 1


def test_user_functions_are_identified_by_their_computation(stored):
    """Functions with the same name may compute different values."""
    made = lambda factor: key.TracedFunction(lambda podium: factor * jnp.tan(podium.alpha), PODIUMS["block"])
    assert key.describe(made(2.0)) == key.describe(made(2.0)) != key.describe(made(3.0))
    assert made(2.0) == made(2.0) != made(3.0)
    held = lambda podium: 2 * jnp.tan(jax.lax.stop_gradient(podium.alpha))  # with other derivatives
    assert key.TracedFunction(held, PODIUMS["block"]) != made(2.0)
    shape = jax.ShapeDtypeStruct((), float)

    def calling(factor):
        called = lambda alpha: np.asarray(factor * alpha)
        outer = jax.custom_jvp(lambda podium: jax.pure_callback(called, shape, podium.alpha))
        outer.defjvp(lambda primals, tangents: (outer(*primals), tangents[0].alpha))
        return key.TracedFunction(outer, PODIUMS["block"])

    alike = calling(2.0)
    assert alike == alike != calling(3.0)  # Python functions do not appear in the computation
    with pytest.raises(key.NoKeyError):
        key.describe(alike)
    applied = StoredProgram(lambda law, x: law(x))
    for loaded, factor in ((0, 2), (0, 3), (1, 2)):
        before = COUNTS["loaded"]
        law = lambda x, factor=factor: factor * x
        assert float(applied(law, 3.0)) == 3 * factor
        assert COUNTS["loaded"] == before + loaded
        finish_writing()
        with pytest.raises(key.NoKeyError):
            key.describe(law)
    program._PROGRAMS.remove(applied)


def _steeper(podium, factor):
    return podium.replace(alpha=factor * podium.alpha)


def test_an_answer_of_modules_is_not_stored(stored):
    """Such a program could be loaded, but its call would fail."""
    made = StoredProgram(_steeper, name="tests.steeper")
    for _ in range(2):
        assert float(made(PODIUMS["rigid"], 2.0).alpha) == 2 * float(PODIUMS["rigid"].alpha)
        finish_writing()
        made.forget()
    program._PROGRAMS.remove(made)
    assert not store.entries()


@pytest.mark.parametrize("extra", [(), {}], ids=["tuple", "dictionary"])
def test_answers_of_another_form_are_another_program(stored, extra):
    """User functions are identified by their trace, which does not contain empty branches of the output
    tree."""
    made = StoredProgram(lambda law, x: law(x), name="tests.forms")
    assert made(lambda x: (2 * x,), 3.0) == (6.0,)
    finish_writing()
    made.forget()
    assert made(lambda x: (2 * x, extra), 3.0) == (6.0, extra)
    program._PROGRAMS.remove(made)


def test_unused_arguments_belong_to_the_kind(stored):
    """The trace of a user function does not contain unused arguments."""
    made = StoredProgram(lambda law, x: law(x), name="tests.unused")
    for arguments in (3.0,), (3.0, 4.0):
        assert made(lambda x: 2 * x[0], arguments) == 6.0
        finish_writing()
        made.forget()
    program._PROGRAMS.remove(made)


def test_long_compilation_is_reported_once(stored, monkeypatch, caplog):
    monkeypatch.setattr(program, "_ANNOUNCE_AFTER", 0.0)
    program._ANNOUNCED.clear()
    caplog.set_level(
        logging.WARNING, logger="rockjax"
    )  # a quiet command in this process may have changed the level
    for times in (2, 3, 4):
        stored.call(times=times)
    (output,) = [record for record in caplog.records if "compiling" in record.getMessage()]
    assert (output.name, output.levelno) == ("rockjax", logging.WARNING)  # notebooks show it by default


def test_derivatives_and_loaded_answers_are_those_of_jit():
    podium = PODIUMS["rigid"]

    def peak(alpha, a_p):
        return rj.peak_response(podium.replace(alpha=alpha), rj.Ricker(a_p, 1.0)).peak_rotation

    point = 0.15, 3.0
    first = peak(*point)
    slopes = jax.grad(peak, (0, 1))(*point)
    counts = dict(COUNTS)
    jax.grad(lambda R: rj.peak_response(podium.replace(R=R), rj.Ricker(3.0, 1.0)).margin)(1.6)
    assert counts == COUNTS  # for every derivative
    finish_writing()
    forget()
    assert float(peak(*point)) == float(first)
    assert float(jax.jit(peak)(*point)) == pytest.approx(float(first), rel=1e-12)
    np.testing.assert_allclose(slopes, jax.jit(jax.grad(peak, (0, 1)))(*point), rtol=1e-12)


def _noise(count: int) -> np.ndarray:
    return 8 * np.convolve(np.random.default_rng(1).normal(size=count), np.hanning(12) / 6, "same")


def test_further_records_and_suites_compile_nothing():
    """Records may differ in length, sampling interval, strength, name and number."""
    podium = PODIUMS["rigid"]

    def solve(records) -> int:
        peaks = rj.peak_responses(podium, rj.Records.of(records))
        alone = [rj.peak_response(podium, record).peak_rotation for record in records]
        np.testing.assert_allclose(peaks.peak_rotation, alone, rtol=1e-9)
        return rj.simulate(podium, records[0]).dataset().sizes["impact"]

    first = solve([rj.Motion(_noise(600), 0.01, name="a"), rj.Motion(_noise(900), 0.01)])
    counts = dict(COUNTS)
    second = solve([rj.Motion(0.6 * _noise(1300), 0.02, name=f"{k}") for k in range(5)])
    assert counts == COUNTS
    assert first != second


def test_options_that_ask_for_the_same_share_programs():
    """The order of outputs has no effect, nor have outputs that do not apply to the podium, nor a number for
    the rest velocity."""
    podium = PODIUMS["rigid"]
    same = [
        {"throw": False},
        {"rest_velocity": 1e-8},
        {"history": 64},
        {"outputs": ("peak_deformation", "peak_rotation", "peak_floor_acceleration", "peak_shear")},
    ]
    batch = lambda **chosen: rj.peak_responses(
        podium, rj.Ricker(np.linspace(1, 6, 3), 0.8), options=rj.Options(**chosen)
    )
    one = lambda **chosen: rj.peak_response(podium, rj.Ricker(3.0, 0.8), options=rj.Options(**chosen))
    for peaks in (one, batch):
        plain = peaks()
        counts = dict(COUNTS)
        for chosen in same:
            np.testing.assert_array_equal(peaks(**chosen).peak_shear, plain.peak_shear)
        assert counts == COUNTS


SUITE = [rj.Record(4 * np.sin(np.linspace(0, 12 + k, 150 + 9 * k)), 0.02) for k in range(3)]
SINGLE_CALLS = {
    "a pulse": lambda: rj.peak_response(PODIUMS["rigid"], rj.Ricker(3.0, 1.0)),
    "a record's boundary": lambda: rj.overturning_boundary(PODIUMS["rigid"], SUITE[0], width=1e-2),
    "an analysis": lambda: rj.incremental_dynamic_analysis(
        PODIUMS["rigid"], SUITE, np.linspace(1, 9, 4), width=1e-2, resolution=32
    ),
    "a spectrum": lambda: rj.rocking_spectrum(PODIUMS["rigid"], rj.Ricker, [1.0, 2.0, 3.0], [2.0, 4.0]),
}


@pytest.mark.parametrize("name", SINGLE_CALLS)
def test_nothing_but_stored_programs_is_compiled(name, caplog):
    """Outside jit, every JAX operation compiles separately in every process, which takes 10 to 30 ms."""
    SINGLE_CALLS[name]()
    assert not compiled_by(SINGLE_CALLS[name], caplog)
