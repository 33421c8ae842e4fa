"""Sweeps: answers equal those of a batch and are stored in chunks; faults are tested with real processes,
files and signals."""

import contextlib
import importlib.util
import json
import linecache
import math
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray

import rockjax as rj
from rockjax._sweep import chunks as _chunks
from rockjax._sweep.layout import ChunkLayout
from rockjax._sweep.spec import make_spec
from rockjax._sweep.store import Store
from tests.scenes import PODIUMS, limited_files

pytest.importorskip("resource")  # limits and signals are POSIX

OUTPUTS = ("peak_rotation",)
OPTIONS = rj.Options(outputs=OUTPUTS)
GRID = rj.grid(
    PODIUMS["rigid"],
    rj.Ricker(1.0, 1.0),
    tan_alpha=np.linspace(0.1, 0.2, 4),
    acceleration_ratio=np.linspace(1, 8, 20),
    frequency_ratio=np.linspace(1, 8, 15),
)
SMALL_GRID = rj.grid(PODIUMS["rigid"], rj.Ricker(1.0, 1.0), tan_alpha=[0.1, 0.15])
CHUNK = 300  # 4 chunks, one for each slenderness


def sweep(store, grid=GRID, **more):
    given = {"outputs": OUTPUTS, "chunk": CHUNK, "progress": False} | more
    return rj.sweep(*grid, store=store, **given)


@pytest.fixture(scope="module")
def batch():
    return rj.peak_responses(*GRID[:2], options=OPTIONS)


def assert_equal(data, batch):
    np.testing.assert_array_equal(data["peak_rotation"], batch.peak_rotation)
    np.testing.assert_array_equal(data["overturned"], batch.overturned)
    np.testing.assert_array_equal(data["impacts"], batch.impacts)
    assert set(np.unique(data["result"])) <= {0, 1, 2}


@pytest.fixture
def solved_chunks(monkeypatch):
    """Return the numbers of the solved chunks."""
    solved = []
    solve = _chunks.Job.solve

    def counting(self, k, *args):
        solved.append(k)
        return solve(self, k, *args)

    monkeypatch.setattr(_chunks.Job, "solve", counting)
    return solved


@pytest.mark.parametrize(
    ("shape", "chunk"), [((7,), 3), ((4, 5, 6), 30), ((4, 5, 6), 7), ((4, 5, 6), 1000), ((3, 1, 8), 8)]
)
def test_chunks_hold_every_scene_once(shape, chunk):
    layout = ChunkLayout.from_chunk_size(shape, chunk)
    assert math.prod(layout.chunk_shape) <= chunk
    times = np.zeros(shape, int)
    sizes = layout.sizes()
    for k in range(layout.chunk_count):
        box = layout.box(k)
        times[box] += 1
        assert times[box].size == sizes[k]
        scenes = np.arange(times.size).reshape(shape)[box].reshape(-1)
        assert np.all(layout.chunk_of(scenes) == k)
        assert np.all(np.diff(scenes) > 0)
    assert np.all(times == 1)


def test_a_sweep_of_a_building_under_a_suite(tmp_path):
    building = rj.ShearBuilding.uniform(2, 20.0, 0.4)
    podium = rj.Podium(0.2, 1.5, 5.0, building)
    suite = rj.synthetic_motions(2, seed=1, duration=4.0, dt=0.02)
    scenes = rj.grid(podium, suite, scale=[1.0, 1.5], R=[1.4, 1.5])
    outputs = ["peak_rotation", "peak_drift"]
    data = rj.sweep(*scenes, store=tmp_path / "x.zarr", outputs=outputs, progress=False)
    assert dict(data.sizes) == {"motion": 2, "scale": 2, "R": 2, "story": 2}
    options = rj.Options(outputs=tuple(outputs))
    peak = rj.peak_response(podium.replace(R=1.4), suite[1].scaled(1.5), options=options)
    scene = data.sel(scale=1.5, R=1.4).isel(motion=1)
    np.testing.assert_allclose(scene["peak_rotation"], peak.peak_rotation, rtol=1e-9)
    np.testing.assert_allclose(scene["peak_drift"], peak.peak_drift, rtol=1e-9)
    batch = podium.replace(R=np.array([1.4, 1.5]))
    with pytest.raises(ValueError, match="structure must be a single podium"):
        rj.grid(batch, suite, scale=[1.0])


def test_a_grid_is_every_combination():
    podium = PODIUMS["elastic"]
    grid = rj.grid(
        podium,
        rj.Ricker(1.0, 1.0),
        R=[1.0, 2.0],
        T_s=[0.2, 0.4, 0.5],
        frequency_ratio=[2.0, 3.0],
        scale=[1.0, 2.0],
    )
    assert grid.shape == (2, 3, 2, 2)
    assert grid.size == 24
    assert list(grid.coords) == ["R", "T_s", "frequency_ratio", "scale"]
    assert grid.structures.superstructure.T_s.shape == (1, 3, 1, 1)
    two = podium.replace(R=2.0)
    T_p = np.broadcast_to(grid.excitations.T_p, grid.shape)
    np.testing.assert_allclose(T_p[1, 0, 1, 0], 2 * np.pi / (3.0 * two.p))
    np.testing.assert_allclose(np.ravel(grid.excitations.a_p), [1.0, 2.0])
    assert "24 scenes" in repr(grid)
    assert "R: 2 from 1 to 2" in repr(grid)
    widths = rj.grid(podium, rj.Rest(), width=[0.4, 0.5], height=[3.0])
    np.testing.assert_allclose(np.ravel(widths.structures.width), [0.4, 0.5])
    np.testing.assert_allclose(np.ravel(widths.structures.height), 3.0)
    gammas = rj.grid(
        podium, rj.MavroeidisPapageorgiou(1.0, 1.0, 2.0, 0.0), gamma=[1.0, 2.0], **{"excitation.gamma": [3.0]}
    )
    assert gammas.structures.gamma.shape == (2, 1)
    assert gammas.excitations.gamma.shape == (1, 1)


def test_several_motions_are_an_axis():
    podium = PODIUMS["rigid"]
    motions = rj.synthetic_motions(3, seed=0, duration=4.0, dt=0.02)
    grid = rj.grid(podium, motions, scale=[1.0, 2.0], alpha=[0.1, 0.2])
    assert grid.shape == (3, 2, 2)
    assert list(grid.coords["motion"]) == motions.names
    assert grid.excitations.which.shape == (3, 1, 1)
    for assert_equal in (list(motions), [motions[0].record(), *motions[1:]], rj.Records.of(motions)):
        np.testing.assert_array_equal(
            rj.grid(podium, assert_equal, alpha=[0.1]).excitations.table, grid.excitations.table
        )
    chosen = rj.grid(podium, rj.Records.of(motions).pick([2, 0]).scaled(2.0), alpha=[0.1]).excitations
    np.testing.assert_allclose(chosen.table, 2 * grid.excitations.table[np.array([2, 0])])
    assert rj.grid(podium, motions[0], alpha=[0.1]).shape == (1,)
    pulses = rj.grid(podium, [rj.Ricker(1.0, 0.5), rj.Ricker(2.0, 0.7)], alpha=[0.1, 0.2, 0.3])
    np.testing.assert_array_equal(np.ravel(pulses.excitations.T_p), [0.5, 0.7])
    assert pulses.shape == (2, 3)
    for bad, words in (
        ([rj.Ricker(1.0, 0.5), rj.OneSine(1.0, 0.5)], "one kind, got OneSine, Ricker"),
        ([], "must hold at least one motion, got none"),
        (rj.Ricker([1.0, 2.0], 0.5), "a_p is an array"),
        ("file.csv", r"must be a rockjax motion .* got 'file.csv'; rockjax.read_motion\(path\) reads"),
    ):
        with pytest.raises(ValueError, match=words):
            rj.grid(podium, bad, alpha=[0.1])


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ({"alpha": [0.1], "tan_alpha": [0.1]}, "alpha and tan_alpha describe the same"),
        ({"width": [0.1], "R": [1.0]}, "R and width describe the same"),
        ({"a_p": [1.0], "acceleration_ratio": [1.0]}, "a_p and acceleration_ratio describe the same"),
        ({"T_s": [0.5]}, "axes must each be one of"),
        ({"thickness": [0.9]}, "axes must each be one of"),
        ({"alpha": [[0.1]]}, "1-D array"),
        ({"alpha": []}, "1-D array"),
        ({"alpha": [2.0]}, r"alpha must be in \(0, π/2\)"),
        ({"frequency_ratio": [0.0]}, "frequency_ratio must be finite and > 0"),
        ({"width": [-1.0]}, "width must be finite and > 0"),
    ],
)
def test_axes_that_make_no_sense_are_refused(axes, words):
    with pytest.raises(ValueError, match=words):
        rj.grid(PODIUMS["rigid"], rj.Ricker(1.0, 1.0), **axes)


def test_a_sweep_is_the_batch_and_is_there_the_next_time(tmp_path, batch, solved_chunks):
    data = sweep(tmp_path / "a.zarr")
    assert sorted(solved_chunks) == [0, 1, 2, 3]
    assert_equal(data, batch)
    assert data["peak_rotation"].dims == ("tan_alpha", "acceleration_ratio", "frequency_ratio")
    assert data["alpha"].dims == ("tan_alpha",)
    assert data["a_p"].dims == ("tan_alpha", "acceleration_ratio")
    np.testing.assert_allclose(data["T_p"], np.ravel(GRID.excitations.T_p))
    assert data["peak_rotation"].attrs["units"] == "1"
    assert data["T_p"].attrs["units"] == "s"
    assert data.attrs["kind"] == "sweep"
    assert data.attrs["rockjax_version"] == rj.__version__
    assert data["steps"].chunks is not None  # lazy
    again = sweep(str(tmp_path / "a.zarr"), chunk=None)
    assert len(solved_chunks) == 4
    xarray.testing.assert_identical(again, data)
    xarray.testing.assert_identical(
        again, xarray.open_zarr(tmp_path / "a.zarr", consolidated=False)[list(again.data_vars)]
    )
    assert [path.name for path in tmp_path.iterdir()] == ["a.zarr"]


@pytest.mark.slow
def test_sensitivities_are_those_of_the_batch(tmp_path):
    names = ("alpha", "a_p")
    data = sweep(tmp_path / "sweep", sensitivities=names)
    batch = rj.peak_responses(*GRID[:2], options=OPTIONS, sensitivities=names)
    slopes = data["peak_rotation_sensitivity"]
    assert slopes.dims == (*GRID.coords, "parameter")
    assert list(data["parameter"].values) == list(names)
    np.testing.assert_allclose(slopes, batch.sensitivities.peak_rotation, rtol=1e-9, atol=1e-9)
    assert np.abs(slopes).max() > 1
    xarray.testing.assert_identical(data.load(), sweep(tmp_path / "sweep", sensitivities=names).load())
    with pytest.raises(
        ValueError, match=r"sensitivities is \['alpha', 'a_p'\] in the store and \[\] in this call"
    ):
        sweep(tmp_path / "sweep")


def test_a_table_of_scenes(tmp_path, batch):
    """Arrays of one length form a table of scenes; common values are attributes."""
    a_p = np.broadcast_to(GRID.excitations.a_p, GRID.shape)[1].ravel()
    T_p = np.broadcast_to(GRID.excitations.T_p, GRID.shape)[1].ravel()
    podium = PODIUMS["rigid"].replace(alpha=np.ravel(GRID.structures.alpha)[1])
    data = rj.sweep(podium, rj.Ricker(a_p, T_p), store=tmp_path / "t.zarr", outputs=OUTPUTS, progress=False)
    assert data["peak_rotation"].dims == ("scene",)
    np.testing.assert_array_equal(data["a_p"], a_p)
    assert data.attrs["structures.R"] == float(podium.R)
    np.testing.assert_allclose(data["peak_rotation"], batch.peak_rotation[1].ravel(), atol=1e-12)


def test_only_missing_or_damaged_chunks_are_solved_again(tmp_path, batch, solved_chunks):
    store = tmp_path / "a.zarr"
    sweep(store)
    solved_chunks.clear()
    chunks = store / "peak_rotation" / "c"
    (store / "progress" / "rows" / "c" / "0" / "0").unlink()  # killed before it finished
    with open(chunks / "1" / "0" / "0", "r+b") as file:  # a flipped bit
        file.seek(40)
        byte = file.read(1)
        file.seek(40)
        file.write(bytes([byte[0] ^ 4]))
    (store / "overturned" / "c" / "2" / "0" / "0").unlink()
    with pytest.warns(RuntimeWarning, match=r"chunk \d is damaged and is solved again") as output:
        data = sweep(store)
    assert len(output) == 2
    assert sorted(solved_chunks) == [0, 1, 2]
    assert_equal(data, batch)
    solved_chunks.clear()
    shutil.copy(chunks / "0" / "0" / "0", chunks / "3" / "0" / "0")  # complete, but from another chunk
    (chunks / "2" / "0" / "0").write_bytes((chunks / "2" / "0" / "0").read_bytes()[:100])
    with pytest.warns(RuntimeWarning, match="damaged"):
        data = sweep(store)
    assert sorted(solved_chunks) == [2, 3]
    assert_equal(data, batch)


def test_a_store_of_something_else_is_refused(tmp_path, monkeypatch):
    store = tmp_path / "a.zarr"
    data = sweep(store)
    changed = GRID.structures.replace(gamma=11.0)
    for call, words in (
        ({"grid": (changed, *GRID[1:])}, "the values of structures.gamma differ"),
        (
            {"grid": (GRID.structures, GRID.excitations.scaled(1.1), GRID.coords)},
            "the values of excitations.a_p differ",
        ),
        (
            {"grid": (GRID.structures, rj.OneSine(GRID.excitations.a_p, GRID.excitations.T_p), GRID.coords)},
            "pytree is .*OneSine.* in this call",
        ),
        (
            {"grid": (*GRID[:2], GRID.coords | {"tan_alpha": np.arange(4.0)})},
            "labels of tan_alpha differ",
        ),
        ({"options": rj.Options(rtol=1e-7)}, "options.rtol is 1e-08 in the store and 1e-07"),
        ({"outputs": ("peak_rotation", "peak_shear")}, "options.outputs is "),
        ({"chunk": 600}, r"chunk is \[1, 20, 15\] in the store and \[2, 20, 15\]"),
        ({"t_end": 30.0}, "pytree is "),
    ):
        with pytest.raises(ValueError, match=words):
            sweep(store, **call)
    monkeypatch.setattr(rj._version, "__version__", "9.9")
    with pytest.raises(
        ValueError, match=f"rockjax_version is {data.attrs['rockjax_version']} in the store and 9.9"
    ):
        sweep(store)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").touch()
    (tmp_path / "file").write_text("text")
    xarray.Dataset({"x": 1.0}).to_zarr(tmp_path / "other.zarr", consolidated=False)
    for name in ("full", "file", "other.zarr"):
        with pytest.raises(
            ValueError, match=rf"{name} (exists and is not the store of a sweep|is a zarr store without)"
        ):
            sweep(tmp_path / name)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        ({"chunk": 0}, "chunk must be a whole number"),
        ({"client": "tcp://x"}, "client must be a dask.distributed.Client"),
        ({"options": rj.Options(engine="segments")}, "engine must be 'flat'"),
        (
            {"grid": (*GRID[:2], ("a", "b"))},
            r"coords must name each axis .* shape is \(4, 20, 15\), got \['a', 'b'\]",
        ),
        ({"grid": (*GRID[:2], ("a", "b", "a"))}, "names an axis twice"),
        ({"grid": (*GRID[:2], "abc")}, "must be a list of the names"),
        ({"grid": (*GRID[:2], ("a", "b", 1))}, "must name axes by strings without '/', got 1"),
        ({"grid": (*GRID[:2], ("a", "b/c", "d"))}, "must name axes by strings without '/', got 'b/c'"),
        ({"grid": (*GRID[:2], ("a", "b", "result"))}, "must not name an axis 'result'"),
        ({"grid": (*GRID[:2], ("peak_rotation", "b", "c"))}, "must not name an axis 'peak_rotation'"),
        ({"grid": (*GRID[:2], ("a", "inputs", "c"))}, "must not name an axis 'inputs'"),
        (
            {"grid": (*GRID[:2], ("a", "parameter", "c")), "sensitivities": ["alpha"]},
            "must not name an axis 'parameter'",
        ),
        (
            {"grid": (*GRID[:2], {"a": np.array([None, 1, 2, 3]), "b": np.arange(20), "c": np.arange(15)})},
            r"coords\['a'\] must be numbers, datetime64 or strings, got None among them",
        ),
        ({"t_end": np.nan}, "sweep: t_end must be finite and after the start"),
        ({"grid": (*GRID[:2], {"a": [1], "b": np.arange(20), "c": np.arange(15)})}, "must have 4 labels"),
        ({"grid": (GRID.structures, rj.Ricker(np.ones((3, 1, 1)), 1.0), None)}, "do not broadcast"),
        ({"grid": (GRID.structures, 3.0, None)}, "excitations must be a rockjax motion"),
    ],
)
def test_calls_that_make_no_sense_are_refused(tmp_path, call, words):
    with pytest.raises(ValueError, match=words):
        sweep(tmp_path / "a.zarr", **call)
    assert not list(tmp_path.iterdir())


def test_varying_parameters_are_coordinates(tmp_path):
    """An axis of one value, a parameter of the motion with the name of a podium's parameter, and labels that
    differ from the values."""
    motion = rj.MavroeidisPapageorgiou(2.0, 1.0, 2.0, 0.0)
    grid = rj.grid(
        PODIUMS["rigid"], motion, gamma=np.linspace(5, 10, 200), R=[2.0], **{"excitation.gamma": [2.0, 3.0]}
    )
    coords = grid.coords | {"gamma": np.arange(200)}
    data = rj.sweep(*grid[:2], coords, store=tmp_path / "a.zarr", outputs=OUTPUTS, progress=False)
    np.testing.assert_array_equal(data["gamma"], np.arange(200))
    np.testing.assert_allclose(data["structures.gamma"], np.linspace(5, 10, 200))
    assert data["structures.gamma"].dims == ("gamma",)
    assert data["R"].dims == ("R",)
    assert data["excitations.gamma"].dims == ("excitation.gamma",)
    assert set(np.unique(data["result"])) <= {0, 1, 2}


def test_a_url(tmp_path, batch):
    assert_equal(sweep("memory://rockjax/a.zarr"), batch)
    with pytest.raises(ValueError, match="values of structures"):
        sweep("memory://rockjax/a.zarr", (GRID.structures.replace(gamma=11.0), *GRID[1:]))
    assert_equal(sweep(f"file://{tmp_path}/a.zarr"), batch)
    assert_equal(sweep(tmp_path / "a.zarr"), batch)
    (tmp_path / "b.zarr").mkdir()
    assert_equal(sweep(tmp_path / "b.zarr"), batch)  # an empty folder is treated like none


def test_missing_packages_are_named_before_solving(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "zarr" else 1)
    with pytest.raises(
        ImportError, match=r"a sweep needs zarr; install with: pip install 'rockjax\[sweep\]'"
    ):
        sweep(tmp_path / "a.zarr")


def test_another_sweep_in_the_place_is_left_alone(tmp_path, monkeypatch):
    """A worker is still solving when its store is removed and created again for another sweep."""
    store = tmp_path / "a.zarr"
    other = GRID.structures.replace(gamma=11.0)
    solve = _chunks.solve_scenes

    def replaced(*args):
        if not store.exists():  # the pilot run
            return solve(*args)
        monkeypatch.setattr(_chunks, "solve_scenes", solve)
        peaks = solve(*args)
        shutil.rmtree(store)
        sweep(store, (other, *GRID[1:]))
        return peaks

    monkeypatch.setattr(_chunks, "solve_scenes", replaced)
    with pytest.raises(RuntimeError, match="another sweep has replaced this one"):
        sweep(store)
    assert_equal(
        sweep(store, (other, *GRID[1:])), rj.peak_responses(other, GRID.excitations, options=OPTIONS)
    )


def test_the_second_client_to_start_a_store_goes_on_with_that_of_the_first(
    tmp_path, batch, solved_chunks, monkeypatch
):
    """Both clients find no store; while the second prepares one, the store of the first appears."""
    store = tmp_path / "a.zarr"
    create = Store.create

    def late(*args):
        monkeypatch.setattr(Store, "create", create)
        sweep(store, chunk=CHUNK)
        return create(*args)

    monkeypatch.setattr(Store, "create", late)
    # Measured times determine the chunk size, so the second client may prefer another size.
    monkeypatch.setattr("rockjax._sweep.pilot.Pilot.chunk_size", lambda *_: 2 * CHUNK)
    assert_equal(sweep(store, chunk=None), batch)
    assert sorted(solved_chunks) == [0, 1, 2, 3]
    assert [path.name for path in tmp_path.iterdir()] == ["a.zarr"]
    # A different sweep is rejected.
    other = tmp_path / "b.zarr"

    def another(*args):
        monkeypatch.setattr(Store, "create", create)
        shutil.copytree(store, other)
        return create(*args)

    monkeypatch.setattr(Store, "create", another)
    with pytest.raises(ValueError, match=r"b\.zarr contains another sweep \(the values of structures.gamma"):
        sweep(other, (GRID.structures.replace(gamma=11.0), *GRID[1:]))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.zarr", "b.zarr"]


@pytest.mark.parametrize("harm", ["emptied", "changed"])
def test_a_chunk_with_a_damaged_row_is_solved_again(tmp_path, small_store, batch, solved_chunks, harm):
    store = tmp_path / "a.zarr"
    shutil.copytree(small_store, store)
    row = store / "progress" / "rows" / "c" / "1" / "0"
    content = row.read_bytes()
    row.write_bytes(b"" if harm == "emptied" else content[:-5] + bytes(y ^ 1 for y in content[-5:]))
    data = sweep(store)
    assert solved_chunks == [1]
    assert_equal(data, batch)
    (store / "progress" / "expected" / "c" / "0").write_bytes(b"")
    with pytest.raises(ValueError, match=r"a\.zarr: a part of it cannot be read .*move the store away"):
        sweep(store)


def test_a_sample_without_steps_has_a_finite_plan(tmp_path):
    plan = sweep(tmp_path / "x", SMALL_GRID, initial=rj.State(theta=0.3), dry_run=True)
    assert plan.steps == 0
    assert plan.core_seconds == plan.seconds == 0


@pytest.mark.parametrize(
    "name",
    [
        "zarr.json",
        "peak_rotation/zarr.json",
        "progress/zarr.json",
        "progress/rows/zarr.json",
        "T_p/zarr.json",
    ],
)
@pytest.mark.parametrize(
    "content", [b'{"zarr_format": 3, "node', b"", b"\xff\xfe\x00"], ids=["cut", "empty", "bytes"]
)
def test_damaged_metadata_are_named(tmp_path, small_store, name, content):
    store = tmp_path / "a.zarr"
    shutil.copytree(small_store, store)
    (store / name).write_bytes(content)
    with pytest.raises(ValueError, match=rf"a\.zarr: .*{name} is damaged.*move the store away") as caught:
        sweep(store)
    assert not isinstance(caught.value, json.JSONDecodeError)


@pytest.fixture(scope="module")
def small_store(tmp_path_factory):
    store = tmp_path_factory.mktemp("small") / "a.zarr"
    sweep(store)
    return store


def test_metadata_of_something_else_are_named(tmp_path, small_store):
    store = tmp_path / "a.zarr"
    shutil.copytree(small_store, store)
    (store / "zarr.json").write_text('{"zarr_format": 3, "node_type": "group", "attributes": 3}')
    with pytest.raises(ValueError, match=r"a\.zarr: .*move the store away"):
        sweep(store)


def test_a_dry_run_writes_nothing_and_estimates_the_cost(tmp_path):
    plan = sweep(tmp_path / "a.zarr", dry_run=True)
    assert not list(tmp_path.iterdir())
    data = sweep(tmp_path / "a.zarr")
    size = sum(path.stat().st_size for path in (tmp_path / "a.zarr").rglob("*") if path.is_file())
    assert (plan.scenes, plan.chunks, plan.chunk, plan.done) == (1200, 4, (1, 20, 15), 0)
    assert plan.steps == pytest.approx(float(data["steps"].sum()), rel=0.2)
    assert plan.core_seconds > 0
    assert 0.5 * size < plan.disk < 2 * size
    assert plan.memory > 50e6
    assert "1200 (4 × 20 × 15)" in repr(plan)
    done = sweep(tmp_path / "a.zarr", dry_run=True)
    assert (done.done, done.steps, done.seconds) == (1200, 0.0, 0.0)


def test_costly_chunks_come_first(tmp_path, solved_chunks):
    sweep(tmp_path / "a.zarr", chunk=75)
    expected = Store.open(tmp_path / "a.zarr").expected
    assert sorted(solved_chunks) == list(range(16))
    assert np.all(np.diff(expected[solved_chunks]) <= 0)
    assert expected.max() > 1.05 * expected.min()


def test_scenes_without_an_answer_are_counted(tmp_path):
    options = rj.Options(outputs=OUTPUTS, max_steps=25)
    with pytest.warns(RuntimeWarning, match="of 1200 scenes did not finish"):
        data = sweep(tmp_path / "a.zarr", options=options)
    assert 0 < int((data["result"] == 3).sum()) < 1200


def test_ctrl_c_keeps_complete_chunks_and_the_same_call_continues(
    tmp_path, batch, solved_chunks, monkeypatch
):
    solve, seen = _chunks.Job.solve, []

    def stopping(self, k, *args):
        seen.append(k)
        if len(seen) == 3:
            signal.raise_signal(signal.SIGINT)
        return solve(self, k, *args)

    monkeypatch.setattr(_chunks.Job, "solve", stopping)
    with pytest.raises(rj.Interrupted, match=r"stopped with 2 of 4 chunks in .*repeat the call") as stopped:
        sweep(tmp_path / "a.zarr")
    partial = stopped.value.partial
    assert int((partial["result"] == 6).sum()) == 600
    assert int(partial["peak_rotation"].isnull().sum()) == 600
    monkeypatch.undo()
    done = [k for k, row in enumerate(Store.open(tmp_path / "a.zarr").rows()) if np.isfinite(row[0])]
    assert sorted(done) == sorted(seen[:2])
    assert_equal(sweep(tmp_path / "a.zarr"), batch)


def test_ctrl_c_during_the_sample_has_no_result(tmp_path, monkeypatch):
    def stopped(self, spec):
        raise rj.Interrupted("stopped with 3 of 256 scenes solved", "peaks of the sample")

    monkeypatch.setattr("rockjax._sweep.sweep.LocalRunner.pilot", stopped)
    with pytest.raises(rj.Interrupted, match="while a sample of the scenes was solved; no results") as found:
        sweep(tmp_path / "a.zarr")
    assert found.value.partial is None
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_reported_and_nothing_is_lost(tmp_path, batch):
    store = tmp_path / "a.zarr"
    with limited_files(600), pytest.raises(OSError, match="could not be written"):
        sweep(store)  # not even the store can be written
    assert not list(tmp_path.iterdir())
    sweep(store)
    (store / "progress" / "rows" / "c" / "1" / "0").unlink()
    for path in store.rglob("c/1/0/0"):
        path.unlink()
    with (
        limited_files(1000),
        pytest.raises(OSError, match=r"could not be written: .*; 3 of 4 chunks are stored; repeat the call"),
    ):
        sweep(store)
    assert not list(store.rglob("*.partial"))
    assert_equal(sweep(store), batch)


SCRIPT = """
    import sys
    import numpy as np
    import rockjax as rj
    from tests.sweep import test_sweep as t

    store, scheduler = sys.argv[1:]
    if scheduler:
        from distributed import Client
        with Client(scheduler_file=scheduler) as client:
            t.sweep(store, t.LARGE, chunk=t.LARGE_CHUNK, client=client)
    else:
        t.sweep(store, t.LARGE, chunk=t.LARGE_CHUNK)
"""
LARGE = rj.grid(
    PODIUMS["rigid"],
    rj.Ricker(1.0, 1.0),
    alpha=np.linspace(0.1, 0.2, 30),
    acceleration_ratio=np.linspace(1, 8, 60),
    frequency_ratio=np.linspace(1, 8, 60),
)
LARGE_CHUNK = 3600
ROOT = Path(__file__).parents[2]


def start(command, folder, cache):
    environment = os.environ | {
        "JAX_PLATFORMS": "cpu",
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        "JAX_COMPILATION_CACHE_DIR": str(cache),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "5s",
        "DASK_TEMPORARY_DIRECTORY": str(folder),
    }
    with open(folder / "log.txt", "a") as log:
        return subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)


def wait_for(condition, process, folder, seconds=240):
    end = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, (folder / "log.txt").read_text()[-2000:]
        assert time.monotonic() < end, (folder / "log.txt").read_text()[-2000:]
        time.sleep(0.01)


def rows_of(store):
    """Return the chunks whose rows are written. (A folder without a file belongs to an interrupted write.)"""
    return {path.parent.name for path in (store / "progress" / "rows" / "c").glob("*/0")}


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("programs")


@pytest.fixture(scope="module")
def large():
    return rj.peak_responses(*LARGE[:2], options=OPTIONS)


def test_a_killed_process_loses_only_the_chunk_it_was_at(tmp_path, cache, large, solved_chunks):
    store = tmp_path / "a.zarr"
    process = start([sys.executable, "-c", textwrap.dedent(SCRIPT), str(store), ""], tmp_path, cache)
    wait_for(lambda: len(rows_of(store)) >= 3, process, tmp_path)
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    done = {int(name) for name in rows_of(store)}
    assert 3 <= len(done) < 30
    data = sweep(store, LARGE, chunk=LARGE_CHUNK)
    assert sorted(solved_chunks) == sorted(set(range(30)) - done)
    assert_equal(data, large)


@pytest.mark.slow
def test_killed_clients_workers_and_schedulers(tmp_path, cache, large):
    """A cluster of real processes, each killed by its own id; the same call continues every time."""
    from distributed import Client

    file = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    scheduler = start(
        [*dask, "scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)], tmp_path, cache
    )
    workers = []
    try:
        wait_for(file.exists, scheduler, tmp_path)
        flags = ["--scheduler-file", str(file), "--nthreads", "1", "--no-dashboard", "--no-nanny"]
        workers = [start([*dask, "worker", *flags], tmp_path, cache) for _ in range(2)]

        first = tmp_path / "a.zarr"
        client = start(
            [sys.executable, "-c", textwrap.dedent(SCRIPT), str(first), str(file)], tmp_path, cache
        )
        wait_for(lambda: len(rows_of(first)) >= 3, client, tmp_path)
        os.kill(client.pid, signal.SIGKILL)
        client.wait()

        with Client(scheduler_file=str(file), timeout=10) as here:
            found = KillsOnce(workers[0].pid, first, len(rows_of(first)) + 3)
            with found:
                assert_equal(sweep(first, LARGE, chunk=LARGE_CHUNK, client=here), large)
            assert found.killed
            workers[0].wait()
            rows = Store.open(first).rows()
            assert np.isfinite(rows).all()

            second = tmp_path / "b.zarr"
            found = KillsOnce(scheduler.pid, second, 3)
            with found, pytest.raises(RuntimeError, match=r"the scheduler is lost.* repeat the call"):
                sweep(second, LARGE, chunk=LARGE_CHUNK, client=here)
            assert found.killed
        assert 3 <= len(rows_of(second)) < 30
        assert_equal(sweep(second, LARGE, chunk=LARGE_CHUNK), large)
    finally:
        for process in (scheduler, *workers):
            process.kill()
            process.wait()


class KillsOnce:
    """Thread that kills a process when a store holds a number of chunks."""

    def __init__(self, pid, store, chunks):
        import threading

        self.killed = False
        self.over = threading.Event()

        def watch():
            while not self.over.wait(0.01):
                if len(rows_of(store)) >= chunks:
                    os.kill(pid, signal.SIGKILL)
                    self.killed = True
                    return

        self.thread = threading.Thread(target=watch)

    def __enter__(self):
        self.thread.start()

    def __exit__(self, *_):
        self.over.set()
        self.thread.join()


def test_the_command(tmp_path, capsys):
    from rockjax._cli import app

    problem = tmp_path / "problem.toml"
    problem.write_text(
        textwrap.dedent("""
            [structure]
            tan_alpha = 0.15
            R = 1.5
            gamma = 5.0
            superstructure = { eta = 20.0 }
            [motions.pulses]
            kind = "ricker"
            a_p = [3.0, 4.0]
            T_p = [0.8, 1.2]
            [sweep.axes]
            tan_alpha = { from = 0.1, to = 0.2, points = 8 }
            gamma = [5.0, 10.0]
        """)
    )

    def run(*arguments):
        with pytest.raises(SystemExit) as done, contextlib.chdir(tmp_path):
            app(["sweep", *map(str, arguments)])
        return done.value.code, capsys.readouterr()

    axes = ["--axis", "gamma=4:16:3:log", "--axis", "scale=" + ",".join(map(str, np.linspace(0.5, 2, 10)))]
    code, output = run(problem, *axes, "-q", "--json", "--dry-run")
    assert code == 0, output
    assert json.loads(output.out)["shape"] == [2, 8, 3, 10]
    assert sorted(os.listdir(tmp_path)) == ["problem.toml"]
    code, output = run(problem, *axes, "-o", "study.zarr")
    assert code == 0, output
    assert "480 scenes" in output.out
    assert "wrote study.zarr" in output.out
    data = xarray.open_zarr(tmp_path / "study.zarr", consolidated=False)
    np.testing.assert_allclose(data["gamma"], [4.0, 8.0, 16.0])
    assert data["peak_rotation"].dims == ("motion", "tan_alpha", "gamma", "scale")
    one = rj.peak_response(
        rj.Podium(np.arctan(0.1), 1.5, 8.0, rj.Rigid(20.0)), rj.Ricker(4.0, 1.2).scaled(2.0), options=OPTIONS
    )
    np.testing.assert_allclose(data["peak_rotation"][1, 0, 1, -1], one.peak_rotation, atol=1e-10)
    for arguments, words in (
        ([problem, "--axis", "gamma=1:2"], "--axis needs numbers separated by commas"),
        ([problem, "--axis", "gamma"], "needs NAME=VALUES"),
        ([problem, "--axis", "gamma=-1,2:3:4:log"], "needs numbers"),
        ([problem, "--axis", "gamma=0:2:3:log"], "equal ratios need from and to > 0"),
        ([problem, "--axis", "T_s=1,2"], "axes must each be one of"),
        ([problem, "--workers", "1", "--scheduler", "x"], "alternatives; give one"),
        ([], "needs an axis"),
    ):
        with pytest.raises(ValueError, match=words), contextlib.chdir(tmp_path), warnings.catch_warnings():
            app(["sweep", *map(str, arguments)], standalone_mode=False)


@pytest.mark.parametrize(
    "name",
    [
        "run #3.zarr",
        "what?.zarr",
        "2026-09-01T10:30:00.zarr",
        "a::b.zarr",
        "50% [new] *.zarr",
        "#/?.zarr",
        "~nobody here/a.zarr",
        "x" * 250 + ".zarr",
    ],
)
def test_a_store_is_written_where_its_path_says(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    data = sweep(name, SMALL_GRID)
    assert np.isfinite(data["peak_rotation"]).all()
    assert [str(path.parent) for path in Path().rglob("inputs")] == [name]
    assert np.isfinite(sweep(Path(name), SMALL_GRID)["peak_rotation"]).all()


def test_the_home_folder_in_a_path(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    sweep("~/sweeps/a.zarr", SMALL_GRID)
    assert (tmp_path / "home" / "sweeps" / "a.zarr" / "zarr.json").exists()
    assert not Path("~").exists()


@pytest.mark.parametrize("name", ["a\0b.zarr", "x" * 256, "file/a.zarr"])
def test_a_path_that_cannot_be_is_refused_before_anything_is_solved(tmp_path, monkeypatch, name):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr("rockjax._sweep.runners.pilot", None)
    with pytest.raises(OSError, match=r"could not be written|too long"):
        sweep(f"{tmp_path}/{name}", SMALL_GRID)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_labels_of_pandas_are_the_same_in_another_process():
    names = "".join(["first", " axis"]), "second axis"  # the first string is a new object
    specs = [
        make_spec(*SMALL_GRID[:2], {"tan_alpha": np.array(labels, dtype)}, rj.State(), None, OPTIONS, None)
        for labels, dtype in ((names, object), (["first axis", "second axis"], object), (names, str))
    ]
    fingerprints = {
        spec.identity(ChunkLayout.from_chunk_size(spec.shape, 1))["fingerprint"] for spec in specs
    }
    assert len(fingerprints) == 1


# ----------------------------------------------------------------------------------------- classes of users
BEAM_SPEED = """
import jax.numpy as jnp
import rockjax as rj


class PeakBeamSpeed(rj.AbstractOutput):
    name, unit, description = "peak_beam_speed", "m s-1", "peak horizontal speed of the beam"

    def quantity(self, moment):
        psi = moment.sigma * moment.c.alpha - moment.x[0]
        return moment.c.two_R * moment.v[0] * jnp.cos(psi)
"""


def users_class(path, source, name="PeakBeamSpeed"):
    """Return the class of a file with this source."""
    path.write_text(source)
    spec = importlib.util.spec_from_file_location("users_output", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["users_output"] = module
    linecache.clearcache()
    spec.loader.exec_module(module)
    return getattr(module, name)


def test_sweeps_have_outputs_of_users(tmp_path, monkeypatch):
    """Answers equal those of a batch, with units; a later run continues; changed code makes another sweep."""
    monkeypatch.setitem(sys.modules, "users_output", None)
    outputs, store = ("peak_rotation", users_class(tmp_path / "a.py", BEAM_SPEED)()), tmp_path / "own"
    data = sweep(store, SMALL_GRID, outputs=outputs, chunk=1)
    batch = rj.peak_responses(*SMALL_GRID[:2], options=rj.Options(outputs=outputs))
    np.testing.assert_array_equal(data["peak_beam_speed"], batch.peak_beam_speed)
    assert data["peak_beam_speed"].attrs["units"] == "m s-1"
    outputs = ("peak_rotation", users_class(tmp_path / "b.py", BEAM_SPEED)())
    np.testing.assert_array_equal(
        sweep(store, SMALL_GRID, outputs=outputs, chunk=1).peak_beam_speed, data.peak_beam_speed
    )
    changed = "peak_rotation", users_class(tmp_path / "c.py", BEAM_SPEED.replace("two_R", "g"))()
    with pytest.raises(ValueError, match="another sweep"):
        sweep(store, SMALL_GRID, outputs=changed, chunk=1)


def test_attributes_of_outputs_of_users_make_another_sweep(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "users_output", None)
    own = users_class(tmp_path / "a.py", BEAM_SPEED)

    def identity(factor):
        output = own()
        output.factor = factor
        options = OPTIONS.replace(outputs=("peak_rotation", output))
        spec = make_spec(SMALL_GRID.structures, rj.Ricker(2.0, 1.0), None, rj.State(), None, options, None)
        return spec.identity(ChunkLayout.from_chunk_size(spec.shape, 1))

    for first, other in ((1.0, 2.0), (np.zeros(5000), np.arange(5000.0)), (object(), (1.0, "a"))):
        assert identity(first) == identity(first) != identity(other)


def test_changed_code_of_pulses_and_devices_of_users_is_another_sweep(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "users_output", None)

    def identity(pulse=rj.Ricker, device=rj.Tendon):
        podium = SMALL_GRID.structures.replace(restrainers=(device(0.1, 1.0),))
        spec = make_spec(podium, pulse(2.0, 1.0), None, rj.State(), None, OPTIONS, None)
        return spec.identity(ChunkLayout.from_chunk_size(spec.shape, 1))

    assert "user_classes" not in identity()
    for base in ("Ricker", "Tendon"):
        source = f"import rockjax as rj\n\n\nclass Own(rj.{base}):\n    factor = 1.0\n"
        sources = source, source, source.replace("1.0", "2.0")
        argument = "pulse" if base == "Ricker" else "device"
        first, same, changed = (
            identity(**{argument: users_class(tmp_path / f"{base}_{k}.py", y, "Own")})
            for k, y in enumerate(sources)
        )
        assert first["user_classes"][0].startswith("Own ")
        assert first == same
        assert first["fingerprint"] != changed["fingerprint"]
