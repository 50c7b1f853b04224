"""Names of operating points: distinct, and readable where a setting is not stated."""

from __future__ import annotations

import pytest
from sawbench.bench.recording import Trial
from sawbench.diagnosis.campaign import _operating_point

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(
    ("stated", "name"),
    [
        ({"thickness_mm": 20.0, "feed_mm_s": 4.0}, "oak, 20 mm, feed 4 mm/s, duty 0.44"),
        ({"thickness_mm": 2.5, "feed_mm_s": 1.7999999999999998}, "oak, 2.5 mm, feed 1.8 mm/s, duty 0.44"),
        ({"thickness_mm": 20.0}, "oak, 20 mm, feed not stated, duty 0.44"),
        ({"feed_mm_s": 4.0}, "oak, thickness not stated, feed 4 mm/s, duty 0.44"),
        ({"material": None}, "material not stated, thickness not stated, feed not stated, duty 0.44"),
    ],
)
def test_what_nobody_stated_is_said_so(stated, name):
    trial = {"trial_id": "t", "source": "bench", "material": "oak", "duty": 0.44, **stated}
    assert _operating_point(Trial(**trial)) == name
