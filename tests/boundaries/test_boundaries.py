"""Searches for the first boundary, for artificial margins with known windows and for records."""

import math
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._boundaries import crossings
from rockjax._boundaries.first import FirstBoundary, first_boundary
from tests.scenes import PODIUMS, G

WIDTH = 1e-3
OPTIONS = rj.Options(rtol=1e-9, atol=1e-11)


class Motion(NamedTuple):
    """Artificial margins for scales up to 1: no uplift up to `lifts`, windows of overturning, intervals
    without an answer, a dip."""

    windows: Any = ()
    wrong: Any = ()  # windows that only scenes of lower accuracy see
    unanswered: Any = ()
    too_coarse: Any = ()  # intervals without an answer of scenes of lower accuracy
    lifts: Any = 0.1
    dip: Any = 1.0  # margin at the dip at 0.4321

    def margin(self, y, sharp, xp=np):
        value = xp.where(y <= self.lifts, 1.0, 0.6 + 0.3 * xp.cos(9 * y) * xp.sin(400 * y))
        value = xp.minimum(value, self.dip + 40 * xp.abs(y - 0.4321))
        for level, stretches in ((-0.2, self.windows), (xp.nan, self.unanswered)):
            for lo, hi in stretches:
                value = xp.where((y >= lo) & (y < hi), level, value)
        for level, stretches in ((-0.2, self.wrong), (xp.nan, self.too_coarse)):
            for lo, hi in stretches:
                value = xp.where((y >= lo) & (y < hi) & ~sharp, level, value)
        return value

    def reach(self, y):
        """Return zero: nothing is known about larger scales."""
        return np.zeros_like(y)

    def padded(self) -> "Motion":
        """Return the motion with three intervals of every kind, so that one compiled program serves all
        cases."""
        fill = lambda part: jnp.array([*part, *[(2.0, 2.0)] * (3 - len(part))])
        stretches = map(fill, (self.windows, self.wrong, self.unanswered, self.too_coarse))
        return Motion(*stretches, jnp.asarray(self.lifts), jnp.asarray(self.dip))

    def first(self) -> float:
        return min((lo for lo, _ in self.windows), default=math.inf)


def scanned(motions, monkeypatch, first_only: bool = True) -> crossings.Scan:
    """Scan in a batch, with a line for each motion."""
    lines = np.arange(len(motions))

    def margins(plane, x, y, options, progress, reaches):
        sharp = np.full(y.shape, options.rtol == OPTIONS.rtol)
        value = np.select([x == k for k in range(len(motions))], [m.margin(y, sharp) for m in motions])
        assert reaches
        reach = np.select([x == k for k in lines], [m.reach(y) for m in motions])
        return value, np.full(y.shape, 3), reach

    monkeypatch.setattr(crossings, "margins", margins)
    monkeypatch.setattr(crossings, "_has_edge_distances", lambda *_: True)
    nothing = cast(crossings.Plane, None)
    ends = 0.0, 1.0
    return crossings.scan(nothing, lines, ends, 32, OPTIONS, False, False, first_only, WIDTH)


def in_program(motion: Motion) -> FirstBoundary:
    return _search(motion.padded())


@jax.jit
def _search(motion: Motion) -> FirstBoundary:
    def row(scales, sharp):
        return motion.margin(scales, sharp, jnp), jnp.full(scales.shape, 3, jnp.int32)

    return first_boundary(row, jnp.ones(()), jnp.asarray(0.95 * WIDTH))


def drawn(count: int, seed: int) -> list[Motion]:
    """Return random windows above the uplift, at least as wide as the width and mostly little wider."""
    rng = np.random.default_rng(seed)
    motions = []
    for _ in range(count):
        begin = rng.uniform(0.1, 0.99, rng.integers(1, 4))
        motions.append(Motion([(a, a + WIDTH * (1 + 3 * rng.uniform() ** 3)) for a in begin]))
    return motions


def test_no_window_wider_than_the_width_is_missed_in_a_batch(monkeypatch):
    motions = drawn(150, 1)
    found = scanned(motions, monkeypatch)
    assert found.crossings.table(len(motions))[0][:, 0] == pytest.approx(
        [m.first() for m in motions], rel=1e-9
    )
    assert np.all(found.certain_width <= WIDTH)
    assert found.scenes < len(motions) * (1 / WIDTH + 500)


def test_no_window_wider_than_the_width_is_missed_in_a_program():
    for motion in drawn(30, 2):
        found = in_program(motion)
        assert float(found.scale) == pytest.approx(motion.first(), rel=1e-9)
        assert float(found.certain_width) <= WIDTH
        assert int(found.impacts) == 3


def test_a_program_ends_after_many_unconfirmed_windows():
    """Only scenes of lower accuracy overturn in these windows."""
    rows = []

    def row(scales, sharp):
        rows.append(sharp)
        assert len(rows) < 200, "the search does not end"
        motion = Motion(wrong=[(a, a + 3 * WIDTH) for a in np.linspace(0.2, 0.9, 9)])
        margin = motion.margin(scales, sharp, jnp)
        return margin, jnp.full(scales.shape, 3, jnp.int32)

    with jax.disable_jit():
        found = first_boundary(row, jnp.ones(()), jnp.asarray(0.95 * WIDTH))
    assert not np.isfinite(found.scale)
    assert float(found.dip) == pytest.approx(0.3, abs=1e-5)


def test_places_are_as_close_as_the_width_and_no_closer(monkeypatch):
    """Without edge distances, the spacing equals the width."""
    monkeypatch.setattr(crossings, "DIP_DIVISIONS", 1)  # dips are not refined
    inspected = []
    margin = Motion.margin

    def noted(self, y, sharp, xp=np):
        inspected.append(np.array(y))
        return margin(self, y, sharp, xp)

    monkeypatch.setattr(Motion, "margin", noted)
    found = scanned([Motion(lifts=0.45)], monkeypatch)
    steps = np.diff(np.unique(np.round(np.concatenate(inspected), 12)))
    steps = steps[np.cumsum(steps) > 0.46]
    assert np.all(steps < 0.95 * WIDTH * (1 + 1e-9))
    assert np.all(steps > 0.9 * WIDTH)
    assert np.all(found.certain_width <= 0.95 * WIDTH)


class Smooth(Motion):
    """Margins with informative derivatives: two waves, of which the shorter is some widths long."""

    def margin(self, y, sharp, xp=np):
        return xp.where(y <= self.lifts, 1.0, self.least(y)[0])

    def reach(self, y):
        value, slope = self.least(y)
        return np.maximum(value, 0.0) / np.maximum(np.abs(slope), 1e-9)

    def least(self, y):
        """Return a margin that is below `dip` at 0.4321 and about 0.7 elsewhere, with its slope."""
        long, short = 0.5 + 0.3 * np.cos(9 * y), 12 * WIDTH
        z = (y - 0.4321) / short
        bump = (0.65 - self.dip) * np.exp(-(z**2))
        return long - bump, -2.7 * np.sin(9 * y) + 2 * z * bump / short


def test_windows_that_derivatives_tell_of_are_found_from_few_scales(monkeypatch):
    """Windows about six widths wide are found with a quarter of the scales."""
    motions = [Smooth(dip=dip) for dip in np.linspace(0.2, 0.9, 12)]
    found = scanned(motions, monkeypatch)
    first, _ = found.crossings.table(len(motions))
    y = np.linspace(0.1, 1.0, 200_001)
    for k, motion in enumerate(motions):
        over = y[motion.margin(y, True) <= 0]
        expected = over[0] if over.size else math.nan
        assert first[k, 0] == pytest.approx(expected, abs=1e-5, nan_ok=True)
    assert np.all(found.certain_width <= WIDTH)
    assert found.scenes < len(motions) * 0.25 / WIDTH


def test_no_scale_below_the_uplift_is_evaluated(monkeypatch):
    quiet = scanned([Motion(lifts=0.9)], monkeypatch)
    assert quiet.scenes < 400
    assert not quiet.crossings.y.size
    assert not np.isfinite(in_program(Motion(lifts=0.9)).scale)


def test_stretches_without_an_answer_at_low_accuracy_are_solved_again(monkeypatch):
    """Solved more accurately, their scenes finish, so the search is certain up to the boundary."""
    motion = Motion([(0.7, 0.8)], too_coarse=[(0.3, 0.32)])
    found = scanned([motion], monkeypatch)
    assert found.crossings.y[0] == pytest.approx(0.7, rel=1e-9)
    assert found.certain_width[0] <= WIDTH
    assert found.finished_to[0] > 0.7
    assert found.last_unfinished[0] == -math.inf


def test_boundaries_do_not_depend_on_the_other_lines(monkeypatch):
    motions = drawn(40, 3)
    together = scanned(motions, monkeypatch).crossings.first(len(motions))[0]
    alone = [scanned([motion], monkeypatch).crossings.y[0] for motion in motions[:12]]
    np.testing.assert_array_equal(together[:12], alone)


@pytest.mark.parametrize("search", ["batch", "program"])
def test_stretches_without_an_answer_are_not_certain(search, monkeypatch):
    motion = Motion([(0.7, 0.8)], unanswered=[(0.3, 0.32)])
    if search == "batch":
        found = scanned([motion], monkeypatch)
        first, certain = found.crossings.y[0], found.certain_width[0]
        assert 0.3 - 2 * WIDTH < found.finished_to[0] < 0.3
        assert 0.32 - 2 * WIDTH < found.last_unfinished[0] < 0.32
    else:
        program = in_program(motion)
        first, certain = program.scale, program.certain_width
        assert 0.3 - 2 * WIDTH < program.finished_to < 0.3
        assert in_program(Motion(unanswered=[(0.3, 0.32)])).finished_to == program.finished_to
        assert in_program(Motion([(0.2, 0.3)], unanswered=[(0.3, 0.32)])).finished_to == 1
    assert first == pytest.approx(0.7, rel=1e-9)
    assert 0.02 <= certain < 0.02 + 2 * WIDTH


def test_findings_of_lower_accuracy_are_confirmed(monkeypatch):
    """Windows that exist only at the lower accuracy are rejected; a window that the lower accuracy shifts is
    found at its true position."""
    motion = Motion([(0.6 - 1e-6, 0.61)], wrong=[(0.2, 0.203), (0.4, 0.4005)])
    assert scanned([motion], monkeypatch).crossings.y == pytest.approx([0.6 - 1e-6], rel=1e-9)
    assert float(in_program(motion).scale) == pytest.approx(0.6 - 1e-6, rel=1e-9)
    every = scanned([motion], monkeypatch, first_only=False).crossings
    assert every.y == pytest.approx([0.6 - 1e-6, 0.61], rel=1e-9)
    assert list(every.overturns) == [True, False]


def test_dips_are_followed_down(monkeypatch):
    """A dip between the evaluated scales is minimised, and a window narrower than the width is found."""
    dip, window = Motion([(0.7, 0.8)], dip=0.01), Motion([(0.7, 0.8)], dip=-0.001)
    assert scanned([dip], monkeypatch).dip == pytest.approx([0.01], abs=1e-3)
    assert float(in_program(dip).dip) == pytest.approx(0.01, abs=1e-3)
    opens = 0.4321 - 0.001 / 40
    assert scanned([window], monkeypatch).crossings.y == pytest.approx([opens], rel=1e-9)
    assert float(in_program(window).scale) == pytest.approx(opens, rel=1e-9)


RIGID = PODIUMS["rigid"].replace(superstructure=rj.Rigid(50.0))
TOP = 10 * G * 0.15
SHAKEN = rj.synthetic_motions(5, seed=5, duration=10.0, dt=0.02, pga=1.0).records()[4]
# The record overturns the podium at this fraction of the range; the next wider window is at 0.4077.
WINDOW = 0.288251, 0.288373


@pytest.mark.slow
def test_a_narrow_window_under_a_record_is_found():
    """The window is 1.2e-4 of the range wide, and neighbouring scales show no sign of it. Second differences
    of 128 scales would find 0.4077."""
    width = 1e-4
    found = rj.overturning_boundary(RIGID, SHAKEN, max_scale=TOP, width=width)
    assert WINDOW[0] - 5e-4 < float(found.scale) / TOP < WINDOW[0] + 1e-6
    assert float(found.certain_width) <= width * TOP
    assert not found.one_sided
    options = rj.Options(rtol=1e-11, atol=1e-13, outputs=("margin",))
    edge = SHAKEN.scaled(float(found.scale) * np.array([1 - 1e-8, 1 + 1e-8]))
    assert list(rj.peak_responses(RIGID, edge, options=options).overturned) == [False, True]
    # All scales below the window, at a quarter of the width.
    scales = np.arange(0.1 * TOP, float(found.scale) * (1 - 1e-9), 0.25 * width * TOP)
    over = np.flatnonzero(rj.peak_responses(RIGID, SHAKEN.scaled(scales), options=options).overturned)
    runs = np.split(over, np.flatnonzero(np.diff(over) > 1) + 1)
    assert max(map(len, runs)) < 5


@pytest.mark.slow
def test_windows_of_records_under_jit_and_vmap():
    least = lambda record: rj.overturning_boundary(RIGID, record, max_scale=TOP)
    found = jax.jit(least)(SHAKEN)
    assert WINDOW[0] - 5e-4 < float(found.scale) / TOP < WINDOW[0] + 1e-6
    assert float(found.certain_width) <= 1e-4 * TOP
    both = jax.tree.map(lambda y: jnp.stack([y, y]), SHAKEN)
    for search in (jax.vmap(least), jax.jit(jax.vmap(least))):
        assert np.asarray(search(both).scale) == pytest.approx(float(least(SHAKEN).scale), rel=1e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [({"width": 0.0}, "width"), ({"width": 0.5}, "width"), ({"resolution": 3}, "resolution")],
)
def test_searches_that_make_no_sense(change, words):
    with pytest.raises(ValueError, match=words):
        rj.overturning_boundary(RIGID, SHAKEN, **change)


@pytest.mark.slow
def test_a_window_that_neighbours_twice_as_far_apart_miss():
    """The window is 2.4 widths wide. The next boundary is 2.8257, where the column overturns as well."""
    podium = rj.Podium(math.atan(0.15), 1.5, 10.0, rj.Elastic(50.0, 0.2, 0.05))
    pulse = rj.MavroeidisPapageorgiou(0.15, 1.0, 3.0, 1.0)
    shaken = rj.synthetic_motions(24, seed=12, duration=10.0, dt=0.02, pga=1.0, pulse=pulse)
    record = shaken.records()[23]
    limit = 10 * G * 0.15 / float(np.abs(np.asarray(record.acceleration)).max())
    found = rj.overturning_boundary(podium, record, max_scale=limit)
    assert float(found.scale) == pytest.approx(2.819391740192, rel=1e-10)
    assert float(found.certain_width) <= 1e-4 * limit
