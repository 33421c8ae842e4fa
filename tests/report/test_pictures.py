"""Pictures of reports: SVG that fits into a page, and the drawing of the structure to scale."""

import re
import xml.etree.ElementTree as ET

import matplotlib.pyplot as plt
import numpy as np
import pytest

import rockjax as rj
from rockjax._report.pictures import elevation_drawing, elevation_units, to_svg
from rockjax._report.units import Units

from . import sample

UNITS = Units.parse("kN,m,deg,g,mm")
SVG = "{http://www.w3.org/2000/svg}"


def line():
    figure = plt.figure(figsize=(4, 3))
    ax = figure.add_subplot()
    ax.plot([0, 1], [0, 1], color="#D55E00", label=r"$\theta/\alpha$")
    ax.plot([0, 1], [1, 0], color="#000000")
    ax.plot([0, 1], [0.5, 0.5], color="0.6")
    ax.plot([0, 1], [0.2, 0.2], color="#440154")
    ax.set_xlabel("time <s>")
    ax.legend()
    return figure


def podium(stories=8, **given):
    dimensions = {
        "width": 0.7,
        "height": 3.0,
        "column_mass": 4725.0,
        "beam_mass": 400e3,
        "positions": sorted([-7.5, -2.5, 2.5, 7.5] * 4),
        "beam_depth": 0.6,
        "story_masses": [260e3] * (stories - 1) + [220e3],
        "story_stiffnesses": [500e6] * stories,
        "story_heights": [3.2] + [3.0] * (stories - 1),
    }
    return rj.Podium.from_dimensions(**dimensions | given)


def texts(svg):
    return ["".join(element.itertext()).strip() for element in ET.fromstring(svg).iter(f"{SVG}text")]


def test_a_figure_becomes_a_part_of_a_page():
    svg = to_svg(line(), "spectra", "Spectra <1>", "The largest is 0.47 & rising")
    root = ET.fromstring(svg)
    assert [root.find(f"{SVG}title").text, root.find(f"{SVG}desc").text] == [
        "Spectra <1>",
        "The largest is 0.47 & rising",
    ]
    assert root.get("aria-labelledby") == "spectra-title spectra-desc"
    ids = [element.get("id") for element in root.iter() if element.get("id")]
    assert len(set(ids)) == len(ids)
    assert all(name.startswith("spectra-") for name in ids)
    targets = re.findall(r'url\(#([^)]*)\)|href="#([^"]*)"', svg)
    assert {a or b for a, b in targets} <= set(ids)
    assert "time <s>" in texts(svg)
    assert not re.search(r"<style|<metadata|<!--|<\?xml|xlink|#d55e00|#000000|#999999", svg)
    assert {"var(--c-red)", "currentColor"} <= set(re.findall(r"stroke: ([^;\"]*)", svg))
    assert "stroke: currentColor; stroke-opacity: 0.4" in svg  # grey 0.6
    assert "stroke: color-mix(in srgb, #440154 var(--own), currentColor)" in svg
    assert not plt.get_fignums()


def test_the_same_figure_gives_the_same_svg():
    assert to_svg(line(), "a", "b", "c") == to_svg(line(), "a", "b", "c")
    with pytest.raises(ValueError, match="prefix must have lower-case letters"):
        to_svg(line(), "A 1", "b", "c")


def test_pictures_share_no_ids():
    one, two = (to_svg(line(), prefix, "Line", "A line") for prefix in ("one", "two"))
    assert sample.page(svg=one, drawing=two)
    with pytest.raises(ValueError, match=r"anchors must differ, got one-axes_1, "):
        sample.page(svg=one, right=one)


def test_the_drawing_has_dimensions_and_masses():
    figure = elevation_drawing(
        podium(), UNITS, column_mass=4725.0, rotation=0.467476379 * 0.22923193, label="motion 9"
    )
    shown = texts(to_svg(figure, "elevation", "Elevation", "Four lines of columns"))
    expected = {
        "3.00": 1,
        "0.60": 1,
        "3.20": 1,
        "7 × 3.00 = 21.00": 1,
        "27.80": 1,
        "5.00": 3,
        "16 × 4.725\u00a0t": 1,
        "400\u00a0t": 1,
        "260\u00a0t": 7,
        "220\u00a0t": 1,
        "2B = 700": 1,
        "2H = 3000": 1,
    }
    assert {text: shown.count(text) for text in expected} == expected
    assert "325" in shown  # u_b of Eq. (13)
    assert "top displaced by 324.9\u00a0mm," in " ".join(shown)
    assert "θ = 6.140° = 0.4675 α" in " ".join(shown)
    assert "(motion 9)" in " ".join(shown)


def test_the_drawing_is_to_scale():
    left, right = elevation_drawing(podium(), UNITS, rotation=0.1).axes
    boxes = [patch.get_bbox() for patch in left.patches]
    columns = [box for box in boxes if box.height == pytest.approx(3.0)]
    assert [box.width for box in columns] == pytest.approx([0.7] * 4)
    assert [(box.x0 + box.x1) / 2 for box in columns] == pytest.approx([-7.5, -2.5, 2.5, 7.5])
    assert {ax.get_aspect() for ax in (left, right)} == {1.0}
    corners = right.patches[0].get_xy()[:4]
    sides = [((a - b) ** 2).sum() ** 0.5 for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]
    assert sides == pytest.approx([0.7, 3.0, 0.7, 3.0])
    assert min(corner[1] for corner in corners) == pytest.approx(0.0)
    plt.close("all")


def test_a_solitary_block_has_no_beam():
    (block,) = elevation_drawing(rj.Podium(0.15, 1.5), UNITS, columns=1).axes[0].patches
    assert block.get_bbox().height == pytest.approx(3.0 * np.cos(0.15))
    assert len(elevation_drawing(rj.Podium(0.15, 1.5, 1.0), UNITS, columns=1).axes[0].patches) == 2
    plt.close("all")


@pytest.mark.parametrize(
    "structure",
    [
        rj.Podium(0.15, 1.5),
        rj.Podium(0.15, 1.5, 10.0, rj.Rigid(50.0)),
        rj.Podium(0.15, 1.5, 10.0, rj.Elastic(50.0, 0.5)),
        rj.Podium(0.15, 1.5, 10.0, rj.Modes([30.0, 5.0], [0.5, 0.1])),
        podium(40),
        podium(story_heights=None, positions=None, beam_depth=0.0, columns=3),
    ],
)
def test_every_structure_has_a_drawing(structure):
    for rotation in (None, 0.0, -0.05, 2.0):
        figure = elevation_drawing(structure, UNITS, column_mass=1e3, rotation=rotation)
        assert "NaN" not in to_svg(figure, "drawing", "Drawing", "A podium")
    assert elevation_units(UNITS) == "Lengths in m (column at the right: in mm)."


def test_a_rotation_beyond_the_stability_angle_is_drawn():
    """If `overturn_ratio` exceeds 1, columns may return from such rotations."""
    alpha = float(podium().alpha)
    figure = elevation_drawing(podium(), UNITS, rotation=1.2 * alpha, label=r"M$\q$")
    shown = " ".join(texts(to_svg(figure, "elevation", "Elevation", "A column")))
    assert r"= 1.200 α (M$\q$)" in shown
    assert (
        f"top displaced by {2000 * 1.5402922 * (np.sin(alpha) + np.sin(0.2 * alpha)):.1f}\u00a0mm," in shown
    )
    plt.close("all")


def test_columns_with_round_ends_have_their_own_size():
    """The model has flat ends: with r_c = H/2 its columns are twice as large and rotate half as much."""
    round_ends = podium(end_radius=0.75)
    assert float(round_ends.height) == pytest.approx(6.0)
    figure = elevation_drawing(round_ends, UNITS, rotation=0.05, size=(0.7, 3.0))
    left, right = figure.axes
    columns = [patch.get_bbox() for patch in left.patches if patch.get_bbox().height == pytest.approx(3.0)]
    assert [box.width for box in columns] == pytest.approx([0.7] * 4)
    corners = right.patches[0].get_xy()[:4]
    side = corners[2] - corners[1]
    assert np.hypot(*side) == pytest.approx(3.0)
    assert np.arctan2(*side) == pytest.approx(0.1)
    # The bottom edge rolls on an arc with the radius r_c = 0.75 m.
    assert corners[1] == pytest.approx([0.7 + 0.75 * (0.1 - np.sin(0.1)), 0.75 * (1 - np.cos(0.1))])
    shown = " ".join(texts(to_svg(figure, "elevation", "Elevation", "A column")))
    assert {"2B = 700", "2H = 3000"} <= set(re.findall(r"2[BH] = \d+", shown))
    assert "θ = 5.730° = 0.2181 θ_o" in shown
    alpha, R = np.arctan(0.7 / 3.0), np.hypot(0.7, 3.0)
    u_top = 2000 * R * (np.sin(alpha) - np.sin(alpha - 0.05))
    assert f"top displaced by {u_top:.1f}\u00a0mm," in shown
