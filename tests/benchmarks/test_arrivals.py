"""The table of late links: a few of its patterns hold, and a pattern that breaks the promise is said."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.arrivals import draw, with_loss, without_loss
from tests.rigs.arrivals import late

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_patterns_of_the_page_hold(seed):
    pattern = draw(seed)
    assert without_loss(pattern).problem == ""
    assert with_loss(pattern).problem == ""


def test_a_link_that_is_late_for_longer_breaks_the_promise_and_is_said():
    pattern = replace(draw(0), seed=77, rate_hz=1000.0, lateness=late(0.1, 4.0))
    assert "seed 77: 2 said" in without_loss(pattern).problem
