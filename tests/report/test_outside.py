"""Checks of effects outside the model are never made, with or without a limit."""

import math

import pytest

from rockjax._report.entry import CheckKeys
from rockjax._report.kinds import KINDS


@pytest.mark.parametrize("name", ["sliding-displacement", "soil-rotation", "two-directions"])
def test_a_limit_is_optional_and_kept(name):
    kind = KINDS[name]
    limit = lambda **given: kind.limit(CheckKeys(kind=name, **given), kind.quantity, 9.81)
    assert kind.has_limit
    assert math.isnan(limit())
    assert limit(limit=0.5) == 0.5
    with pytest.raises(
        ValueError, match=f"{name} needs exactly one of limit and at_most, got limit and at_most"
    ):
        limit(limit=1.0, at_most=2.0)
