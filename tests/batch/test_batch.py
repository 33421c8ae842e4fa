import itertools
import threading
import types
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._batch import batch
from rockjax._batch.exchange import DoneScenes
from rockjax._machine import memory
from rockjax._machine.threads import run_in_threads
from rockjax._responses.arguments import check_range
from tests.scenes import PODIUMS, G, elastic, options, shaking

FIELDS = (
    "peak_rotation",
    "peak_deformation",
    "peak_shear",
    "uplift_time",
    "overturn_time",
    "smallest_impact_speed",
)


def amplitudes(n):
    return np.linspace(0.5, 6.0, n) * G * 0.15


def assert_close(a, b, rtol=1e-7):
    for name in FIELDS:
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=rtol, atol=1e-9, equal_nan=True)
    np.testing.assert_array_equal(a.overturned, b.overturned)
    np.testing.assert_array_equal(a.uplifted, b.uplifted)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rigid", "elastic"])
def test_one_scene_is_its_place_in_the_batch(name):
    podium = PODIUMS[name]
    a_p = amplitudes(13)
    batch = rj.peak_responses(podium, rj.Ricker(a_p, 1.0), options=options(1e-10, "tsit5"))
    single = [rj.peak_response(podium, rj.Ricker(a, 1.0), options=options(1e-10, "tsit5")) for a in a_p]
    assert_close(batch, jax.tree.map(lambda *y: np.stack(y), *single))
    mapped = jax.vmap(lambda a: rj.peak_response(podium, rj.Ricker(a, 1.0), options=options(1e-10, "tsit5")))(
        jnp.asarray(a_p)
    )
    assert_close(batch, mapped)
    assert batch.overturned.any()
    assert not batch.overturned.all()


def test_answers_that_do_not_fit_are_refused_before_they_are_begun(tmp_path, monkeypatch):
    output = r"100000000\d\d scenes need about 1\.\d* TiB of memory, but only .* are free.* rockjax\.sweep"
    axis = np.linspace(1.0, 8.0, 100_000)
    with pytest.raises(ValueError, match="rocking_spectrum: " + output):
        rj.rocking_spectrum(PODIUMS["rigid"], rj.Ricker, axis, axis)
    with pytest.raises(ValueError, match="peak_responses: " + output):
        rj.peak_responses(PODIUMS["rigid"], rj.Ricker(axis[:, None], axis))
    for file, text in {
        "proc/meminfo": "MemTotal: 8000 kB\nMemAvailable:    4000 kB\n",
        "sys/fs/cgroup/memory.max": "3000000\n",
        "sys/fs/cgroup/memory.current": "2500000\n",
        "sys/fs/cgroup/memory.stat": "anon 1000000\ninactive_file 1500000\nworkingset 5\n",
    }.items():
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(text)
    monkeypatch.setattr(memory, "SYSTEM_ROOT", tmp_path)
    few = rj.Records.of([rj.Record(np.ones(50), 0.01)])
    for owner, work in {
        "overturning_spectrum: 12900 scenes": lambda: rj.overturning_spectrum(
            PODIUMS["rigid"], rj.Ricker, np.linspace(1.0, 8.0, 100)
        ),
        "synthetic_motions: 100 motions": lambda: rj.synthetic_motions(100, seed=1),
        "incremental_dynamic_analysis: 20129 scenes": lambda: rj.incremental_dynamic_analysis(
            PODIUMS["rigid"], few, np.linspace(1.0, 2.0, 20_000)
        ),
    }.items():
        with pytest.raises(
            ValueError, match=rf"{owner} need about .* of memory, but only 1\.91 MiB are free; request"
        ):
            work()


@pytest.mark.slow
def test_order_size_and_lanes_do_not_matter(monkeypatch):
    podium = elastic(0.4)
    a_p = amplitudes(700)
    complete = rj.peak_responses(podium, rj.Ricker(a_p, 0.9), options=options(1e-10, "tsit5"))
    backwards = rj.peak_responses(podium, rj.Ricker(a_p[::-1], 0.9), options=options(1e-10, "tsit5"))
    assert_close(complete, jax.tree.map(lambda y: y[::-1], backwards), rtol=1e-6)
    monkeypatch.setattr(rj._batch.batch, "LANES", 48)
    monkeypatch.setattr(rj._batch.batch, "CHUNK", 96)
    chunks = rj.peak_responses(podium, rj.Ricker(a_p, 0.9), options=options(1e-10, "tsit5"))
    assert_close(complete, chunks, rtol=1e-6)
    alone = rj.peak_responses(podium, rj.Ricker(a_p, 0.9), options=options(1e-10, "tsit5"), threads=1)
    assert_close(chunks, alone, rtol=1e-12)


@pytest.mark.slow
def test_everything_broadcasts():
    R = np.array([1.0, 1.5, 2.5])
    podiums = rj.Podium(alpha=0.2, R=R[:, None], gamma=3.0)
    peaks = rj.peak_responses(podiums, rj.OneSine(np.array([3.0, 5.0]), 0.9), initial=rj.State(0.01))
    assert peaks.peak_rotation.shape == (3, 2)
    single = rj.peak_response(rj.Podium(0.2, 1.5, 3.0), rj.OneSine(5.0, 0.9), initial=rj.State(0.01))
    assert peaks.peak_rotation[1, 1] == pytest.approx(float(single.peak_rotation), rel=1e-9)
    one = rj.peak_responses(PODIUMS["rigid"], rj.Ricker(3.0, 1.0))
    assert one.peak_rotation.shape == ()
    assert "6 scenes" in repr(peaks)
    with pytest.raises(ValueError, match="broadcast"):
        rj.peak_responses(rj.Podium(0.2, R), rj.OneSine(np.ones(4), 1.0))


@pytest.mark.slow
def test_records_shared_and_of_their_own():
    records = [shaking(120, seed=k) for k in range(3)]
    scales = np.array([0.5, 1.0, 1.5])
    shared = rj.peak_responses(PODIUMS["rigid"], rj.Record(records[0].acceleration, 0.02, scales))
    own = rj.peak_responses(PODIUMS["rigid"], rj.Record(np.stack([r.acceleration for r in records]), 0.02))
    for k in range(3):
        a = rj.peak_response(PODIUMS["rigid"], rj.Record(records[0].acceleration, 0.02, scales[k]))
        b = rj.peak_response(PODIUMS["rigid"], records[k])
        assert shared.peak_rotation[k] == pytest.approx(float(a.peak_rotation), rel=1e-8)
        assert own.peak_rotation[k] == pytest.approx(float(b.peak_rotation), rel=1e-8)


@pytest.mark.slow
def test_one_scene_without_answer_does_not_cost_the_others():
    podium = elastic(0.5)
    with pytest.warns(RuntimeWarning, match="out_of_steps"):
        peaks = rj.peak_responses(
            podium,
            rj.Ricker(np.array([0.0, 3.0]), 1.0),
            options=rj.Options(max_steps=150, outputs=("peak_rotation",)),
        )
    assert peaks.peak_rotation.shape == (2,)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rj.peak_responses(podium, rj.Ricker(np.array([0.0, 3.0]), 1.0))


def test_no_compilation_when_only_numbers_change():
    podium = PODIUMS["rigid"]
    rj.peak_response(podium, rj.Ricker(3.0, 1.0))
    rj.peak_responses(podium, rj.Ricker(amplitudes(20), 1.0))
    with jax.log_compiles(), _no_compiles():
        changed = podium.replace(alpha=0.16, gamma=11.0)
        o = rj.Options(rtol=1e-7, atol=1e-9, overturn_ratio=1.1)
        rj.peak_response(changed, rj.Ricker(3.1, 1.1), options=o)
        rj.peak_responses(changed, rj.Ricker(amplitudes(20) * 1.01, 1.1), options=o)
        rj.peak_responses(changed, rj.Ricker(amplitudes(41) * 1.01, 1.1), options=o)


class _no_compiles:
    def __enter__(self):
        import logging

        self.messages = []
        self.handler = logging.Handler()
        self.handler.emit = lambda record: self.messages.append(record.getMessage())
        logging.getLogger("jax").addHandler(self.handler)

    def __exit__(self, *_):
        import logging

        logging.getLogger("jax").removeHandler(self.handler)
        big = [m for m in self.messages if "Compiling" in m and ("solve" in m or "advance" in m)]
        assert not big


@pytest.mark.slow
def test_lanes_are_busy_and_no_scene_is_lost():
    """With refilled lanes, at least nine of ten trials advance a scene, for every mixture of scenes."""
    from rockjax._batch.batch import run_batch
    from rockjax._batch.scenes import broadcast

    a_p = np.random.default_rng(0).permutation(amplitudes(20_000))
    for podium in (PODIUMS["rigid"], elastic(0.5)):
        scenes, _ = broadcast("", podium, rj.Ricker(a_p, 1.0), rj.State(), None)
        floats, integers, tally = run_batch(scenes, options(1e-6, "tsit5", outputs=("peak_rotation",)), False)
        assert tally.useful > 0.9 * tally.possible
        assert np.all(integers["code"] <= 2)
        assert np.all(np.isfinite(floats["peak_rotation"]))


@pytest.mark.parametrize("name", ["block", "elastic"])
@pytest.mark.parametrize("threads", [1, 2, 3, 8])
@pytest.mark.parametrize("total", [1, 7, 63, 64, 65, 100, 129, 484, 2047, 2048, 2049, 5000])
def test_every_scene_is_dealt_to_a_thread_once(total, threads, name):
    """Chunks fit the lanes, and all threads get equal work, except for remainders that fill no lanes or are
    too small for a thread."""
    from rockjax._batch.batch import QUICK_SCENES_PER_LANE, _chunks, layout
    from rockjax._batch.executors import ThreadExecutor
    from rockjax._batch.scenes import broadcast

    scenes, _ = broadcast("", PODIUMS[name], rj.Ricker(np.arange(1.0, total + 1), 1.0), rj.State(), None)
    assert scenes.is_quick == (name == "block")
    executor = ThreadExecutor(threads)
    made = layout(scenes, executor)
    chunks = list(_chunks(scenes, made, executor))
    dealt = [chunk.at(np.arange(chunk.scenes)) for chunk in chunks]
    np.testing.assert_array_equal(np.sort(np.concatenate(dealt)), np.arange(total))
    sizes = np.array([chunk.scenes for chunk in chunks])
    assert np.all((sizes > 0) & (sizes <= made.size))
    busy = min(threads, -(-total // (made.lanes * (QUICK_SCENES_PER_LANE if scenes.is_quick else 1))))
    assert len(chunks) >= busy
    by_thread = [sizes[k::busy].sum() for k in range(busy)]
    assert max(by_thread) - min(by_thread) <= len(chunks)


@pytest.mark.slow(but=["rigid"])
@pytest.mark.parametrize("name", ["rigid", "elastic"])
def test_a_thread_that_is_alone_solves_the_chunks_of_the_others(name, monkeypatch):
    """This includes a thread that has already reduced its lanes because its own work was ending."""
    from concurrent.futures import Future

    from rockjax._batch import executors
    from rockjax._machine import threads

    def in_turn(work):
        done = Future()
        done.set_result(work())
        return done

    podium, motions = PODIUMS[name], rj.Ricker(amplitudes(300), 1.0)
    together = rj.peak_responses(podium, motions, threads=3)
    monkeypatch.setattr(threads, "submit", in_turn)
    monkeypatch.setattr(executors, "MAX_LAST_TRIALS", 10)
    alone = rj.peak_responses(podium, motions, threads=3)
    for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("name", ["rigid", "elastic"])
def test_one_program_serves_batches_of_all_sizes(name):
    from rockjax._programs.program import COUNTS

    of = lambda n: rj.peak_responses(PODIUMS[name], rj.Ricker(np.linspace(2.0, 6.0, n), 1.0), threads=1)
    many = of(200)
    before = COUNTS["compiled"] + COUNTS["loaded"]
    for n in (1, 7, 64):
        assert np.all(np.isfinite(of(n).peak_rotation))
    assert COUNTS["compiled"] + COUNTS["loaded"] == before
    few = rj.peak_responses(PODIUMS[name], rj.Ricker(np.linspace(2.0, 6.0, 200)[:9], 1.0), threads=1)
    np.testing.assert_allclose(few.peak_rotation, many.peak_rotation[:9], rtol=1e-7)


def test_rows_are_stored_once_however_many_scenes_share_them():
    from rockjax._batch.scenes import SceneIndices, broadcast

    scenes, shape = broadcast(
        "", PODIUMS["rigid"], rj.Record(np.ones((3, 1, 500)), 0.02, np.ones(400)), rj.State(), None
    )
    assert shape == (3, 400)
    filled_up = 2048
    assert sum(np.asarray(y).size for y in scenes.leaves) < 3 * filled_up + 400 + 50
    assert all(0 in rows.strides for rows in scenes.rows if rows is not None)
    own = scenes.leaves_of_chunk(SceneIndices(395, 1, 10), 64)
    assert all(y.shape[0] == 64 for y, rows in zip(own, scenes.rows, strict=True) if rows is not None)


def test_scenes_begin_in_the_order_of_their_motions_strength():
    """The order of the batch has no effect. Scenes under strong motions end soon, so they are started
    last."""
    from rockjax._batch.scenes import MAX_SORTED_SCENES, SceneIndices, broadcast

    a_p = np.random.default_rng(0).permutation(amplitudes(200)) * np.where(np.arange(200) % 2, 1, -1)
    of = lambda motion: broadcast("", PODIUMS["rigid"], motion, rj.State(), None)[0]
    scenes = of(rj.Ricker(a_p, 1.0))
    (started,) = [y for y in scenes.leaves_of_chunk(SceneIndices(0, 2, 100), 100) if np.ndim(y)]
    assert np.all(np.diff(np.abs(started)) >= 0)
    np.testing.assert_array_equal(np.sort(scenes.in_grid(np.arange(200))), np.arange(200))
    record = np.sin(np.linspace(0, 6, 50))
    suite = rj.Records.of([rj.Record(record, 0.02), rj.Record(-3 * record, 0.02)])
    grid = suite.pick(np.arange(2)[:, None]).scaled(np.array([1.0, 2.0, 4.0]))
    np.testing.assert_array_equal(of(grid).in_grid(np.arange(6)), [0, 1, 3, 2, 4, 5])
    assert of(rj.GroundMotion(grid, grid)).order is not None
    # The order stays unchanged if all scenes have one motion, and in large batches.
    assert of(rj.Ricker(np.ones(MAX_SORTED_SCENES + 1), 1.0)).order is None
    assert of(rj.Rest()).order is None


@pytest.mark.parametrize("name", ["rigid", "elastic"])
def test_the_order_changes_no_answer(name):
    podium, a_p = PODIUMS[name], amplitudes(300)
    shuffled = np.random.default_rng(1).permutation(300)
    sorted_ones, others = (
        rj.peak_responses(podium, rj.Ricker(y, 1.0)) for y in (a_p, np.asarray(a_p)[shuffled])
    )
    for name in ("peak_rotation", "peak_rotation_time", "overturn_time", "uplift_time"):
        np.testing.assert_array_equal(getattr(sorted_ones, name)[shuffled], getattr(others, name))
    np.testing.assert_array_equal(sorted_ones.stats.steps[shuffled], others.stats.steps)


def test_the_segments_engine_is_not_silently_replaced():
    with pytest.raises(ValueError, match="engine"):
        rj.peak_responses(
            PODIUMS["rigid"], rj.Ricker(amplitudes(3), 1.0), options=rj.Options(engine="segments")
        )


@pytest.mark.slow
def test_podiums_of_several_kinds_share_one_call():
    x, y = np.linspace(2, 6, 5), np.linspace(1, 5, 4)
    podiums = [elastic(0.3), PODIUMS["rigid"], elastic(0.6), PODIUMS["block"]]
    together = rj.rocking_spectra(podiums, rj.Ricker, x, y, options=options(1e-9, "tsit5"))
    for podium, spectrum in zip(podiums, together, strict=True):
        alone = rj.rocking_spectrum(podium, rj.Ricker, x, y, options=options(1e-9, "tsit5"))
        np.testing.assert_allclose(spectrum.peak_rotation, alone.peak_rotation, rtol=1e-7, atol=1e-9)
        assert spectrum.attrs == alone.attrs


def test_an_error_in_one_thread_stops_the_others():
    stop, number, stopped = threading.Event(), itertools.count(), []

    def work():
        if next(number):
            raise RuntimeError("second")
        stopped.append(stop.wait(5.0))

    with pytest.raises(RuntimeError, match="second"):
        run_in_threads(work, 2, stop, raises=True)
    assert stopped == [True]


@pytest.mark.parametrize("unsolved", [None, 1])
def test_scenes_without_a_second_solution_count_as_unfinished(monkeypatch, unsolved):
    """Ctrl-C comes before the second solution, which estimates the errors, or during it."""
    stop, calls = threading.Event(), []

    def interrupted(scenes, options, progress, stop, *more):
        answers = run_batch(scenes, options, progress, None, *more)
        calls.append(answers)
        if unsolved is None or len(calls) == 2:
            stop.set()
        if len(calls) == 2:
            answers[1]["code"][unsolved] = rj.RESULTS.interrupted._value
        return answers

    run_batch = batch.run_batch
    monkeypatch.setattr(batch, "run_batch", interrupted)
    options = rj.Options(outputs=("peak_rotation", "errors"))
    arguments = PODIUMS["block"], rj.OneSine(np.linspace(2.0, 3.0, 3), 1.0), rj.State(), None, options, False
    with pytest.raises(rj.Interrupted) as error:
        batch.responses(*arguments, stop)
    partial = error.value.partial
    if unsolved is None:
        assert partial is None
        assert "second solution" in str(error.value)
    else:
        assert np.isnan(partial.peak_rotation).tolist() == [False, True, False]
        assert (partial.result == rj.RESULTS.interrupted).tolist() == [False, True, False]


def test_every_scene_ends_after_the_start_of_its_motion():
    pulses = rj.Ricker(3.2, np.array([1.0, 0.7]))  # start at -2.2 s and at -1.54 s
    words = (
        r"t_end must be finite and after the start of every excitation; the latest starts at -1\.54 s, got"
    )
    for t_end in (-2.0, [-1.0, -1.6], [[-1.0], [-1.6]]):
        with pytest.raises(ValueError, match=words):
            rj.peak_responses(PODIUMS["rigid"], pulses, t_end=np.array(t_end))
    check_range("peak_responses", PODIUMS["rigid"], pulses, np.array([-2.0, -1.0]), rj.Options())


def test_the_tally_counts_the_lanes_of_all_devices():
    """Two devices with 8 lanes each make 5 and 3 trials; the second device waits."""
    from rockjax._batch.batch import _Answers

    scenes = types.SimpleNamespace(total=4, in_grid=lambda index: index)
    answers = _Answers(scenes, 8)  # pyright: ignore[reportArgumentType]
    counts = {name: np.array(y) for name, y in {"used": [1, 2], "trials": [5, 3], "useful": [30, 20]}.items()}
    index = np.array([0, -1, 1, 2])
    answers.store(DoneScenes(index, {}, {"code": index}, running=np.array([0, 0]), **counts))  # pyright: ignore
    assert (answers.useful, answers.possible) == (50, 80)
