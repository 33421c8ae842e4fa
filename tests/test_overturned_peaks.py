"""Peaks of overturned scenes cover the time until overturning, and all texts and pictures state this."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

import rockjax as rj
from rockjax import plots

BUILDING = rj.Podium(0.15, 1.5, 10.0, rj.ShearBuilding([3.0, 2.0], [900.0, 500.0], heights=[3.0, 3.0]))
FALLS, STANDS = rj.OneSine(9.0, 1.0), rj.OneSine(1.0, 0.8)
WORDS = "until overturning"


@pytest.fixture(scope="module")
def overturning():
    return rj.simulate(BUILDING, FALLS)


@pytest.fixture(scope="module")
def standing():
    return rj.simulate(BUILDING, STANDS)


def test_a_peak_says_so(overturning, standing):
    assert overturning.overturned
    lines = repr(overturning).splitlines()
    for label in ("deformation", "shear", "drifts", "floors"):
        (line,) = (line for line in lines if line.strip().startswith(label))
        assert line.endswith(WORDS)
    assert WORDS in overturning._repr_html_()
    assert WORDS not in repr(standing)


def test_a_batch_says_so():
    block = rj.Podium(0.15, 1.5)
    assert repr(rj.peak_responses(block, rj.Ricker([1.0, 2.0, 30.0], 1.0))) == (
        f"Peak(3 scenes, shape (3,), 1 overturned: their peaks are {WORDS})"
    )
    assert WORDS not in repr(rj.peak_responses(block, rj.Ricker([1.0, 2.0, 3.0], 0.1)))


def test_datasets_refer_to_the_flag(overturning):
    data = overturning.dataset(np.linspace(0, 0.1, 3))
    batch = rj.peak_responses(rj.Podium(0.15, 1.5), rj.Ricker([1.0, 30.0], 1.0)).dataset()
    for name in ("peak_rotation", "peak_deformation", "peak_shear", "peak_drift", "peak_floor_acceleration"):
        for each in (data, batch):
            if name in each:
                assert each[name].attrs["ancillary_variables"] == "overturned"
                assert each[name].attrs["comment"] == f"for scenes that overturned, the value {WORDS}"
    assert bool(data["overturned"])
    assert batch["overturned"].values.tolist() == [False, True]


def test_a_picture_of_stories_says_so(overturning, standing):
    for beside, texts in (
        (None, [WORDS]),
        ({"weak": standing}, [WORDS, "weak"]),
        ({"strong": overturning}, [WORDS, f"strong, {WORDS}"]),
    ):
        figure = plots.stories(overturning, beside=beside)
        legend = figure.axes[0].get_legend()
        assert [text.get_text() for text in legend.get_texts()] == texts
        plt.close(figure)
    assert plots.stories(standing).axes[0].get_legend() is None
