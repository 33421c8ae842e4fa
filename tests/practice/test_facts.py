"""Facts of the simplified methods, computed separately with 30 digits; all printed digits are correct."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import rockjax as rj
from rockjax._practice import asce_rocking, asce_sliding, fema, priestley
from rockjax._practice.block import Block
from rockjax._practice.circolare import SLC, SLV, Mechanism
from rockjax._practice.roots import find_roots
from rockjax._practice.static import beam_displacement

G = 9.80665
SLENDERNESS = np.radians([10, 15, 20])


def example(gamma=5.291005291005291, eta=26.984126984126984) -> Block:
    return Block.from_podium(rj.Podium(math.atan(0.7 / 3), 0.5 * math.hypot(0.7, 3), gamma, rj.Rigid(eta)))


def housner(alpha: float) -> float:
    """Return the velocity factor e of Housner's block [–]."""
    return float(rj.Podium(alpha, 1.0).restitution_factor)


def same(value, printed: str):
    """Assert that numbers agree with printed ones to half a unit of their last digit, or rounding of e."""
    values, words = np.atleast_1d(value), printed.split()
    assert len(values) == len(words)
    for number, word in zip(values, words, strict=True):
        digits = len(word.partition(".")[2])
        assert abs(number - float(word)) <= 0.5000001 * 10.0**-digits, (number, word)


def test_1_static():
    block = example()
    same(block.threshold, "2.288218333")
    same(beam_displacement(block, block.alpha), "0.7")
    same(beam_displacement(block, 0.4 * block.alpha), "0.2776336120")
    assert beam_displacement(block, 0.467476379 * block.alpha) == pytest.approx(0.3248819502, abs=1e-9)


def test_2_and_3_housners_block_and_its_damping():
    e = np.array([housner(alpha) for alpha in SLENDERNESS])
    same(e**2, "0.9115847324 0.8091345264 0.6798552161")
    same([100 * priestley.damping(y) for y in e], "3.147404815 7.200863008 13.11976431")
    same([100 * fema.damping(y) for y in e], "1.809221376 4.019237886 7.018666706")


def test_4_and_6_decay_of_free_rocking():
    """`damping` approximates the ratio β = ln(φ_0/φ_n)/(nπ) after n impacts, Eq. (10) of Makris and
    Konstantinidis (2003), with the amplitude φ_n = 1 − √(1 − e²ⁿ[1−(1−φ_0)²]) by Housner (1963)."""
    e, phi = housner(SLENDERNESS[1]), 0.5
    amplitude = lambda n: 1 - math.sqrt(1 - e ** (2 * n) * (1 - (1 - phi) ** 2))
    two, six = (100 * math.log(phi / amplitude(n)) / (n * math.pi) for n in (2, 6))
    same([two, six], "8.858718038 7.963519534")
    assert 1 - 100 * priestley.damping(e) / two == pytest.approx(0.19, abs=0.005)
    same(amplitude(4), "0.1762723587")


def test_5_period():
    T = priestley.period(np.array([0.1, 0.3, 0.5, 0.7, 0.9]), 1.0)
    same(T, "1.868581232 3.582352398 5.267831588 7.495280970 11.97289138")


def test_7_and_8_equivalent_block():
    block = example()
    p = math.sqrt(0.75 * G / block.R)
    same([block.equivalent_R / block.R, block.p / p], "1.492372266 0.8185805386")
    e = block.restitution
    same(e, "0.8969973090")
    same([100 * priestley.damping(e), 100 * fema.damping(e)], "7.391764353 4.120107641")
    tall = Block.from_podium(rj.Podium(math.atan(0.15), 1.0, 10.0, rj.Rigid(100.0)))
    same([tall.restitution, tall.equivalent_R / tall.R], "0.9560234601 1.497737557")


def constant_velocity(V: float, block: Block):
    """Return F(φ) − φ of (P3) for the spectrum S_d = VT/2π."""
    length = block.half_height * block.alpha
    return lambda phi: V * priestley.period(phi, block.p) / (2 * math.pi) / length - phi


def test_9_roots_on_a_spectrum_of_constant_velocity():
    block = Block(SLENDERNESS[1], 0.75 * G / 4, 1 / 3, 0.0, 0.9, G)
    assert block.p == pytest.approx(2.0, rel=1e-14)
    for V, printed in ((0.2, "0.03874233152 0.9986407409"), (0.3, "0.09131618715 0.9833457231")):
        roots = find_roots(constant_velocity(V, block))
        same([*roots.stable, *roots.unstable], printed)
        assert roots.overturns
    same(priestley.period(roots.stable, block.p), "0.8892845261")


def test_10_largest_stable_root_on_a_spectrum_of_constant_velocity():
    block = example()
    shape = lambda phi: priestley.period(np.asarray(phi), 4.0)  # cosh⁻¹[1/(1−φ)]
    slope = lambda phi: shape(phi) - phi / ((1 - phi) * math.sqrt(1 - (1 - phi) ** 2))
    root: Any = brentq(slope, 0.3, 0.8, xtol=1e-15)
    same(root, "0.577029311342")
    C = root / float(shape(root))
    same(C, "0.383272082791")
    for factor, count in ((1 - 1e-5, 1), (1 + 1e-5, 0)):
        V = factor * C * math.pi * block.p * block.half_height * block.alpha / 2
        roots = find_roots(constant_velocity(V, block))
        assert len(roots.stable) == len(roots.unstable) == count
        assert roots.overturns


def test_11_12_and_13_asce_capacities():
    tan_alpha = 0.15
    theta = np.arctan(tan_alpha) * np.array([0.25, 0.5, 0.75, 1.0])
    same(asce_rocking.capacity(theta, tan_alpha), ".2627125397 .2253123754 .1878254362 .1502777184")
    same(asce_rocking.frequency(theta, tan_alpha, 1.0), ".3621235870 .2371340602 .1767799423 .1369410687")
    same(asce_rocking.damping(housner(math.atan(tan_alpha))), "0.01068326072")
    same(asce_rocking.damping(housner(math.atan(1 / 3))), "0.05166230047")
    for slope in (tan_alpha, 1 / 3):
        e = 1 - 2 * slope**2 / asce_rocking.inertia_factor(slope)
        assert housner(math.atan(slope)) == pytest.approx(e, rel=1e-14)


def test_14_asce_at_half_the_slenderness():
    theta = 0.5 * math.atan(1 / 3)
    same(asce_rocking.rise(theta, 1 / 3), "0.04048153864")
    same(asce_rocking.capacity(theta, 1 / 3), "0.5032661245")
    assert asce_rocking.capacity(1e-12, 1 / 3) == pytest.approx(2 / 3, rel=1e-11)


def test_15_asce_sliding():
    mu = asce_sliding.effective_friction(0.6, 0.2 * G, G)
    same(mu, "0.552")
    same(2 * mu * G, "10.8265416")


def test_16_and_17_circolare():
    mechanism = Mechanism.from_block(example(), 1.0)
    same([*mechanism, mechanism.displacement_at(SLV)], "0.9925446304 2.305405987 0.6946605860 0.2778642344")
    same([mechanism.period(SLV), mechanism.period(SLC)], "2.365517394 3.294827798")
    column = Mechanism.from_block(example(0.0, 0.0), 1.0)
    same([column.period(SLV), column.period(SLC)], "1.685383806 2.347498872")


def test_18_largest_acceleration_of_the_mechanism():
    ratio = lambda carried: (
        Mechanism.from_block(example(carried, 0.0), 1.0).acceleration / example().threshold
    )
    assert ratio(0.5) == pytest.approx(9 / 8, rel=1e-15)
    carried = np.concatenate([np.linspace(0, 2, 2001), np.geomspace(2, 1e4, 100)])
    ratios = [ratio(y) for y in carried]
    assert carried[np.argmax(ratios)] == 0.5
    methods = [
        rj.simplified_methods(
            rj.Podium(0.2, 1.0, y), rj.Record([0.0, 1.0], 0.1), methods=["circolare_force"]
        )[0]
        for y in (0.0, 0.5, 100.0)
    ]
    assert [method.values["alpha_0"].value for method in methods] == [math.tan(0.2)] * 3
