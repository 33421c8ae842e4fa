"""Overturning margin, boundaries and their derivatives: published roots, an independent integrator, finite
differences."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rockjax as rj
from rockjax._boundaries import implicit
from rockjax._boundaries.boundary import BOUNDARY
from rockjax._boundaries.crossings import scan
from tests import restrained
from tests.scenes import ALPHA, PODIUMS, G, options, shaking

UNIT = G * 0.15
MARGIN = rj.Options(rtol=1e-11, atol=1e-13, outputs=("peak_rotation", "margin"))
FRAME = rj.Podium(alpha=ALPHA, R=1.5, gamma=110.0)  # of Section 4


SMALL_SLENDERNESS = 1e-4  # slenderness at which the equations are practically linear


def block(alpha, p, e=None):
    return rj.Podium(alpha, R=0.75 * 9.81 / p**2, g=9.81, **({} if e is None else {"restitution": e}))


THIRD = math.atan(1 / 3)


def block_p(b: float, h: float) -> float:
    """Return p of a block of half width b and half height h."""
    return math.sqrt(0.75 * 9.81 / math.hypot(b, h))


# Solitary blocks under one pulse: (α, p, e, pulse, T_p, root of the linearised equations, of the full ones),
# in g.
ROOTS = {
    "half-sine, b=.2 h=.6": (THIRD, block_p(0.2, 0.6), None, rj.HalfSine, 1.0, 0.554586, 0.574724),
    "one-cosine, b=.5 h=1.5": (THIRD, block_p(0.5, 1.5), None, rj.OneCosine, 1.0, None, 0.625845),
    "one-sine, b=.5 h=1.5": (THIRD, block_p(0.5, 1.5), 0.85, rj.OneSine, 1.0, 0.451540, 0.468727),
    "one-cosine, p=2 α=15°": (math.radians(15), 2.0, None, rj.OneCosine, 2.0, None, 0.315034),
    "one-sine, α=.25 p=2.14": (0.25, 2.14, 0.9, rj.OneSine, 2 * math.pi / 5 / 2.14, 3.0186 * 0.25, None),
}


@pytest.mark.smoke
@pytest.mark.slow(but=["*p=2*"])
@pytest.mark.parametrize("name", ROOTS)
def test_published_roots(name):
    alpha, p, e, pulse, T_p, linear, full = ROOTS[name]
    if full is not None:
        a_p = rj.overturning_acceleration(block(alpha, p, e), pulse, T_p)
        assert float(a_p) / 9.81 == pytest.approx(full, abs=6e-7)
    if linear is not None:
        a_p = rj.overturning_acceleration(block(SMALL_SLENDERNESS, p, e), pulse, T_p)
        printed = 6e-7 if name != "one-sine, α=.25 p=2.14" else 2e-5
        assert float(a_p) / 9.81 * alpha / math.tan(SMALL_SLENDERNESS) == pytest.approx(linear, abs=printed)


def test_windows_of_survival():
    """The block at ω_p = 15.7 with velocity factor .9: overturns from 2.22322 g, survives again
    2.61697–3.43694 g.

    The second value requires a criterion by which columns may pass α and return.
    """
    podium = block(0.25, 2.14, 0.9)
    pulse = lambda a_p, T_p: rj.OneSine(a_p, T_p)

    def plane(x, y):
        return podium, pulse(y * 9.81, 2 * np.pi / x)

    wide = BOUNDARY.replace(overturn_ratio=2.0)
    found = scan(plane, [15.7], (0.0, 4.5), 128, wide).crossings
    assert found.y[0] == pytest.approx(2.22322, abs=1e-5)
    assert found.y[1:3] == pytest.approx([2.61697, 3.43694], abs=1e-5)
    assert list(found.overturns[:3]) == [True, False, True]
    least = rj.overturning_acceleration(
        podium, rj.OneSine, 2 * math.pi / 15.7, max_acceleration_ratio=16.0, options=wide
    )
    assert float(least) / 9.81 == pytest.approx(found.y[0], rel=1e-10)


def test_thin_bands_are_found():
    """All fifteen changes of the frame of Section 4 at ω_p/p = 2, some of them 5e-4 apart; a finer scan finds
    no more."""
    p = float(FRAME.p)
    at = lambda n: scan(
        lambda x, y: (FRAME, rj.Ricker(y * UNIT, 2 * np.pi / (x * p))), [2.0], (0.0, 12.0), n, BOUNDARY
    )
    coarse, fine = at(128), at(2048)
    assert len(coarse.crossings.y) == 15
    assert coarse.crossings.y == pytest.approx(fine.crossings.y, rel=1e-10)
    assert coarse.scenes < 0.7 * fine.scenes  # below the first change both have the spacing of `width`
    assert list(coarse.crossings.overturns) == [k % 2 == 0 for k in range(15)]
    published = scan(
        lambda x, y: (FRAME, rj.Ricker(y * UNIT, x)), [1.4187], (0.0, 12.0), 128, BOUNDARY
    ).crossings.y
    assert published[[0, 1, -1]] == pytest.approx([2.1038, 2.3107, 2.528], abs=1e-4)


@pytest.mark.slow(but=["rigid-bracket0"])
@pytest.mark.parametrize(("name", "bracket"), [("rigid", (2.8, 2.95)), ("elastic", (2.5, 2.7))])
def test_against_bisection_with_an_independent_integrator(name, bracket):
    podium, T_p = PODIUMS[name], 1.0
    lo, hi = bracket
    for _ in range(22):
        middle = 0.5 * (lo + hi)
        a_p = middle * UNIT
        motion = restrained.ricker(a_p, T_p)
        answer = restrained.simulate(restrained.frame_of(podium), 6.0, motion, start=-2.2 * T_p)
        lo, hi = (lo, middle) if math.isfinite(answer.overturn_time) else (middle, hi)
    ours = float(rj.overturning_acceleration(podium, rj.Ricker, T_p)) / UNIT
    assert ours == pytest.approx(0.5 * (lo + hi), abs=2 * (hi - lo) + 1e-9)


@pytest.mark.slow(but=["elastic"])
@pytest.mark.parametrize("name", ["block", "frame", "rigid", "elastic"])
def test_margin_vanishes_on_the_boundary_and_has_one_slope_there(name):
    podium = PODIUMS[name]
    boundary = float(rj.overturning_acceleration(podium, rj.Ricker, 1.2))
    near = boundary * (1 + np.array([-1e-2, -1e-4, -1e-7, 1e-7, 1e-4, 1e-2]))
    peaks = rj.peak_responses(podium, rj.Ricker(near, 1.2), options=MARGIN)
    assert list(peaks.overturned) == [False] * 3 + [True] * 3
    assert np.all(np.diff(peaks.margin) < 0)
    assert np.all((np.asarray(peaks.margin) > 0) == ~np.asarray(peaks.overturned))
    slopes = np.asarray(peaks.margin) / (near - boundary)
    # The slopes are equal if only gravity acts. Here the pulse still acts on the block, and an elastic top
    # still sways.
    assert slopes[2] == pytest.approx(slopes[3], rel=1e-4 if name in ("frame", "rigid") else 0.05)
    assert np.abs(peaks.margin[2]) < 1e-5


@pytest.mark.slow
def test_margin_far_from_the_boundary():
    """The margin is 1 without uplift and decreases far beyond the boundary, with matching derivatives."""
    podium = PODIUMS["rigid"]
    ratios = np.linspace(0.5, 9.0, 60)
    peaks = rj.peak_responses(podium, rj.Ricker(ratios * UNIT, 1.0), options=MARGIN)
    assert np.all(np.asarray(peaks.margin)[ratios < 0.99] == 1)
    lifted = np.asarray(peaks.margin)[ratios > 1.2]
    assert np.all(np.diff(lifted) < 0)
    assert lifted[-1] < -5
    slope = jax.grad(lambda a: rj.peak_response(podium, rj.Ricker(a, 1.0), options=MARGIN).margin)
    for ratio in (1.5, 2.5, 4.0, 8.0):
        h = 1e-5 * UNIT
        at = lambda s, ratio=ratio: float(
            rj.peak_response(podium, rj.Ricker(ratio * UNIT + s, 1.0), options=MARGIN).margin
        )
        assert float(slope(ratio * UNIT)) == pytest.approx((at(h) - at(-h)) / (2 * h), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["frame", "elastic"])
def test_margin_changes_nothing_else(name):
    podium, motions = PODIUMS[name], rj.Ricker(np.linspace(1, 4, 40) * UNIT, 1.0)
    plain = rj.peak_responses(podium, motions, options=MARGIN.replace(outputs=("peak_rotation",)))
    both = rj.peak_responses(podium, motions, options=MARGIN)
    assert np.asarray(both.peak_rotation) == pytest.approx(np.asarray(plain.peak_rotation), abs=1e-9)
    assert np.array_equal(both.overturned, plain.overturned)
    single = rj.peak_response(podium, rj.Ricker(2.0 * UNIT, 1.0), options=MARGIN)
    alone = rj.peak_response(podium, rj.Ricker(2.0 * UNIT, 1.0), options=MARGIN.replace(outputs=("margin",)))
    assert float(single.margin) == pytest.approx(float(alone.margin), rel=1e-9)
    history = rj.simulate(podium, rj.Ricker(2.0 * UNIT, 1.0), options=MARGIN)
    assert float(history.margin) == pytest.approx(float(single.margin), rel=1e-9)


def test_margin_of_released_columns():
    """Free rocking from rest has its initial energy: M = 1 − V(θ₀)/V(α)."""
    podium, theta = PODIUMS["block"], 0.2
    alpha = float(podium.alpha)
    peak = rj.peak_response(podium, rj.Rest(), initial=rj.State(theta), options=MARGIN)
    left = (1 - math.cos(alpha - theta)) / (1 - math.cos(alpha))
    assert float(peak.margin) == pytest.approx(left, rel=1e-12)
    fallen = rj.peak_response(podium, rj.Rest(), initial=rj.State(0.29, 1.0), options=MARGIN)
    kinetic = 0.5 * 1.0**2
    spare = float(podium.p) ** 2 * (1 - math.cos(alpha - 0.29))
    depth = float(podium.p) ** 2 * (1 - math.cos(alpha))
    assert float(fallen.margin) == pytest.approx((spare - kinetic) / depth, rel=1e-9)


def random_structures(count, kind, rng):
    """Return random (podium, T_p) of one kind, from ranges of practice."""
    for _ in range(count):
        top = {
            "none": None,
            "rigid": rj.Rigid(rng.uniform(1, 100)),
            "elastic": rj.Elastic(rng.uniform(1, 100), rng.uniform(0.1, 1.0), 0.05),
        }[kind]
        podium = rj.Podium(rng.uniform(0.1, 0.35), rng.uniform(1, 4), rng.uniform(0, 20), top)
        yield podium, jnp.asarray(2 * math.pi / (rng.uniform(1.0, 4.0) * float(podium.p)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "pulse", "number"),
    [("none", rj.Ricker, 20), ("rigid", rj.AntisymmetricRicker, 20), ("elastic", rj.Ricker, 10)],
)
def test_derivatives_of_the_boundary_for_random_structures(kind, pulse, number):
    """Derivatives with respect to every parameter of random structures agree to 1e-5 with central differences
    of boundaries from batches, unless the boundary is at a fold.
    """
    drawn = [
        jax.tree.flatten(pair)
        for pair in random_structures(number, kind, np.random.default_rng([3, len(kind)]))
    ]
    structure = drawn[0][1]
    here = np.array([[float(y) for y in leaves] for leaves, _ in drawn])
    count, numbers = here.shape
    # Change the logarithm of every parameter of every structure by ±h and ±2h.
    h = 1e-5
    steps = h * np.array([1, -1, 2, -2])
    # Axes: structure, step, changed parameter, parameter.
    moved = here[:, None, None] * (1 + steps[:, None, None] * np.eye(numbers))
    table = moved.reshape(-1, numbers)

    def plane(line, y):
        podium, T_p = jax.tree.unflatten(structure, list(table[np.asarray(line, int)].T))
        return podium, pulse(y * podium.g * jnp.tan(podium.alpha), T_p)

    found = scan(plane, np.arange(len(table)), (0.0, 10.0), 128, BOUNDARY, first_only=True).crossings
    least = np.full(len(table), np.inf)
    np.minimum.at(least, found.line, found.y)
    podium = jax.tree.unflatten(structure, list(table.T))[0]
    least = (least * np.asarray(podium.g * jnp.tan(podium.alpha))).reshape(count, 4, numbers)

    def exact(podium, T_p):
        ask = lambda podium, T_p: rj.overturning_acceleration(podium, pulse, T_p, max_acceleration_ratio=10.0)
        return jax.value_and_grad(ask, (0, 1))(podium, T_p)

    worst, checked, folds = 0.0, 0, 0
    for k in range(count):
        value, gradient = exact(*jax.tree.unflatten(structure, [jnp.asarray(y) for y in here[k]]))
        slopes = np.array([float(g) for g in jax.tree.leaves(gradient)]) * here[k]
        if not math.isfinite(value):
            assert np.all(slopes == 0)
            continue
        up, down, far_up, far_down = least[k]
        near, far = (up - down) / (2 * h), (far_up - far_down) / (4 * h)
        size = np.abs(slopes).max()  # of derivatives with respect to logarithms
        own_error, error = np.abs(far - near) / size, np.abs(slopes - near) / size
        smooth = own_error < 1e-5  # otherwise close to a fold, or the minimum jumps between the differences
        checked, folds = checked + smooth.size, folds + int((~smooth).sum())
        worst = max(worst, error[smooth].max(initial=0.0))
        assert np.all(error[smooth] < 1e-5 + own_error[smooth]), k
    assert checked >= 5 * number
    assert folds < 0.15 * checked
    print(
        f"{checked} derivatives, worst error "
        f"{worst:.1e} of the largest, {folds} too close to a fold for differences"
    )


@pytest.mark.slow
def test_modes_jit_and_vmap_agree():
    podium = PODIUMS["frame"]

    def least(y):
        return rj.overturning_acceleration(podium.replace(alpha=y[0], gamma=y[1]), rj.Ricker, y[2])

    y = jnp.array([0.2, 4.0, 1.0])
    forward, reverse = jax.jacfwd(least)(y), jax.grad(least)(y)
    batch = jax.vmap(jax.value_and_grad(least))(jnp.stack([y, 1.01 * y]))
    assert np.asarray(reverse) == pytest.approx(np.asarray(forward), rel=1e-12)
    assert float(batch[0][0]) == pytest.approx(float(least(y)), rel=1e-11)
    assert np.asarray(batch[1][0]) == pytest.approx(np.asarray(forward), rel=1e-7)


def test_nothing_overturns():
    """The result is +inf with zero derivative and a flag, never NaN."""
    podium = PODIUMS["frame"]
    least = lambda alpha: rj.overturning_acceleration(
        podium.replace(alpha=alpha), rj.Ricker, 0.2, max_acceleration_ratio=2.0
    )
    value, slope = jax.value_and_grad(least)(0.2)
    assert value == math.inf
    assert slope == 0
    boundary = rj.overturning_boundary(podium, rj.Ricker(1.0, 0.2), max_scale=1.0)
    assert not boundary.found
    assert not boundary.one_sided


@pytest.mark.slow
def test_the_jump_to_another_branch_is_flagged():
    """Where the lower branch of the frame is about to open, the dip of the margin below the minimum
    vanishes."""
    p = float(FRAME.p)
    boundary = lambda x: rj.overturning_boundary(
        FRAME, rj.Ricker(UNIT, 2 * math.pi / (x * p)), max_scale=12.0
    )
    # The fold of the lower branch, by bisection of the jump.
    lo, hi = 1.9, 2.2
    assert float(boundary(lo).scale) < 2.2 < float(boundary(hi).scale)
    for _ in range(30):
        middle = 0.5 * (lo + hi)
        lo, hi = (middle, hi) if float(boundary(middle).scale) < 2.28 else (lo, middle)
    assert not boundary(hi + 0.1).one_sided
    assert boundary(hi + 1e-7).one_sided
    assert float(boundary(hi + 1e-7).dip) < 1e-4 < float(boundary(hi + 0.1).dip)


@pytest.mark.parametrize("alpha", [0.2, 0.205, 0.21])
def test_boundaries_without_a_margin_have_derivatives_at_loose_tolerances(alpha):
    """With `overturn_ratio` > 1, the time of overturning replaces the margin. It is NaN on the surviving side
    of the boundary."""
    options = rj.Options(rtol=1e-10, atol=1e-12, overturn_ratio=1.2)

    def slope(options):
        scale = lambda alpha: rj.overturning_scale(
            PODIUMS["frame"].replace(alpha=alpha), rj.Ricker(1.0, 1.0), max_scale=20.0, options=options
        )
        return float(jax.grad(scale)(alpha))

    loose = options.replace(rtol=1e-6, atol=1e-8)
    assert slope(loose) == pytest.approx(slope(options), rel=1e-4) != 0.0


@pytest.mark.slow
def test_scale_of_a_record():
    podium, record = PODIUMS["rigid"], shaking()
    scale = float(rj.overturning_scale(podium, record, max_scale=8.0))
    assert math.isfinite(scale)
    peaks = rj.peak_responses(
        podium, record.scaled(np.array([scale * (1 - 1e-8), scale * (1 + 1e-8)])), options=MARGIN
    )
    assert list(peaks.overturned) == [False, True]
    slope = jax.grad(lambda alpha: rj.overturning_scale(podium.replace(alpha=alpha), record, max_scale=8.0))(
        ALPHA
    )
    h = 1e-6
    at = lambda alpha: float(rj.overturning_scale(podium.replace(alpha=alpha), record, max_scale=8.0))
    assert float(slope) == pytest.approx((at(ALPHA + h) - at(ALPHA - h)) / (2 * h), rel=1e-5)


@pytest.mark.slow
def test_spectra_agree_with_single_boundaries_and_with_similarity():
    x = np.linspace(1.0, 6.0, 76)
    scanned = rj.overturning_spectrum(FRAME, rj.Ricker, x, sensitivities=("alpha", "gamma", "R", "T_p"))
    both = np.isfinite(scanned["minimum"].values)
    # By similarity, a_ov is a function of T_p p.
    slopes = (
        scanned["sensitivity"].sel(parameter="R").values,
        scanned["sensitivity"].sel(parameter="T_p").values,
    )
    assert slopes[0][both] == pytest.approx(-0.5 * slopes[1][both], rel=1e-6)
    exact = float(rj.overturning_acceleration(FRAME, rj.Ricker, float(scanned["T_p"][30]))) / UNIT
    assert float(scanned["minimum"][30]) == pytest.approx(exact, rel=1e-10)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"frequency_ratio": [[1.0]]}, "1-D"),
        ({"frequency_ratio": [-1.0]}, "frequency_ratio must be finite and > 0"),
        ({"max_acceleration_ratio": 0.0}, "max_acceleration_ratio must be finite and > 0"),
        ({"sensitivities": ("T_s",)}, "sensitivities must each be one of"),
        ({"resolution": 3}, "resolution must be a whole number"),
    ],
)
def test_bad_spectra_are_refused(change, words):
    arguments = {"frequency_ratio": [2.0, 3.0]} | change
    with pytest.raises(ValueError, match=words):
        rj.overturning_spectrum(FRAME, rj.Ricker, **arguments)


def test_spectra_without_any_boundary():
    """If nothing overturns at high frequencies, the result is NaN without an error."""
    found = rj.overturning_spectrum(FRAME, rj.Ricker, [7.0, 7.5, 8.0])
    assert np.all(np.isnan(found["minimum"]))
    assert np.all(found["impacts"] == -1)


def test_text_of_boundaries():
    found = rj.overturning_boundary(PODIUMS["rigid"], rj.Ricker(1.0, 1.0), max_scale=10.0)
    assert f"overturns from {float(found.scale):.10g} after {int(found.impacts)} impacts" in repr(found)
    none = rj.overturning_boundary(PODIUMS["rigid"], rj.Ricker(1.0, 1.0), max_scale=1.0)
    assert "no overturning scale found" in repr(none)
    assert float(none.finished_to) == 1


def test_a_derivative_that_cannot_be_computed_is_unknown(monkeypatch):
    """Without a boundary the derivative is zero."""
    monkeypatch.setattr(implicit, "_residual", lambda podium, *_: podium.alpha * jnp.nan)
    arguments = PODIUMS["rigid"], rj.Ricker(1.0, 1.0), jnp.ones(()), (BOUNDARY, jnp.asarray(1e-3))
    leaves, structure = jax.tree.flatten(arguments)
    leaves = [jnp.asarray(y, float) if isinstance(y, float) else y for y in leaves]
    varied = tuple(k == 0 for k in range(len(leaves)))

    def change(scale, tangent=1.0):
        return implicit.boundary_change(
            leaves, [jnp.asarray(tangent)], jnp.asarray(scale), structure, varied, True
        )

    assert np.isnan(change(1.0))
    assert change(jnp.inf) == 0
    assert np.isnan(jax.grad(change, argnums=1)(1.0, 1.0))


def test_bad_boundaries_are_refused():
    with pytest.raises(ValueError, match=r"must be scalar; for several use jax\.vmap"):
        rj.overturning_acceleration(FRAME, rj.Ricker, [1.0, 2.0])
    with pytest.raises(ValueError, match="T_p must be finite and > 0"):
        rj.overturning_acceleration(FRAME, rj.Ricker, -1.0)
    with pytest.raises(ValueError, match="max_scale must be finite and > 0"):
        rj.overturning_boundary(FRAME, rj.Ricker(1.0, 1.0), max_scale=-2.0)
    with pytest.raises(ValueError, match="needs engine='flat'"):
        rj.Options(outputs=("margin",), engine="segments")
    with pytest.raises(ValueError, match="overturn_ratio must be <= θ_s/α = 1 for the margin"):
        rj.peak_response(
            rj.Podium(alpha=0.3, R=2.0),
            rj.Ricker(3.0, 1.0),
            options=rj.Options(outputs=("margin",), overturn_ratio=1.5),
        )
    assert options(1e-8).outputs  # the default is unchanged


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pulse", "T_p", "printed"),
    [
        (rj.Ricker, 3.14, 0.314),
        (rj.AntisymmetricRicker, 3.14, 0.262),
        (rj.AntisymmetricRicker, 2 * np.pi / 2.60, 0.285),
    ],
)
def test_the_frame_of_zhou_du_and_han(pulse, T_p, printed):
    """Least overturning acceleration in g of Zhou, Du & Han (2019), to the last printed digit."""
    frame = rj.Podium(alpha=np.arctan(1.5 / 7), R=3.58, gamma=13.23)
    sine = np.sin(frame.alpha) ** 2
    theirs = (1 - 1.5 * sine + 3 * 13.23 * np.cos(2 * frame.alpha)) / (1 + 3 * 13.23)
    assert float(frame.restitution_factor) == pytest.approx(float(theirs), abs=1e-12)
    ratio = np.r_[np.linspace(0.1, printed - 0.001, 63), printed + 0.001]
    peaks = rj.peak_responses(
        frame, pulse(ratio * float(frame.g), T_p), options=rj.Options(outputs=("peak_rotation",))
    )
    assert np.asarray(peaks.overturned).tolist() == 63 * [False] + [True]
