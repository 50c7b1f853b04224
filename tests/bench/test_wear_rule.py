"""One rule says when a blade is changed, for plans and for reports."""

from __future__ import annotations

import pytest
from sawbench.acquisition.series.plan import SeriesPlan
from sawbench.bench.wear_rule import BLADE_GROWTH_LIMIT, is_worn
from sawbench.reporting.grouping import Setting
from sawbench.reporting.wear import WornTrial

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(("growth", "worn"), [(0.19, False), (0.20, True), (0.21, True), (-0.3, False)])
def test_report_and_plan_change_a_blade_from_the_same_growth_on(growth, worn):
    plan = SeriesPlan.model_fields["blade_growth_limit"].default
    trial = WornTrial(
        blade="B1", material="oak", name="t1", setting=Setting(duty=0.44, thickness_mm=20.0, feed_mm_s=4.0), cut_m=1.0,
        growth=growth, growth_std=0.01,
    )  # fmt: skip
    assert plan == BLADE_GROWTH_LIMIT == 0.20
    assert is_worn(growth, plan) is trial.is_worn is worn
