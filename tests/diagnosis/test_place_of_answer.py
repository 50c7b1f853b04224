"""The place that a report names first is that of what its answer rests on."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from sawbench.diagnosis.answer import gap_report
from sawbench.diagnosis.answer.where import Spot
from sawbench.diagnosis.inference.asynchronous import Finding

pytestmark = pytest.mark.unit

IN_MEAN_STROKES = Spot(
    equation="supply", channel="battery_current_a", share=1.0, crank_angle_rad=((4.45, 4.97),), grows_with=()
)
WANDERS = Finding(log_evidence=200.0, text="the duty wanders", channel="motor_current_a", equation="electrical")


@pytest.mark.parametrize(
    ("verdict", "resembles", "left_over", "equations"),
    [
        pytest.param("unknown", WANDERS.text, 9.0, ["electrical"], id="it is the answer"),
        pytest.param("unknown", "another law", 9.0, ["supply", "electrical"], id="another law is the answer"),
        pytest.param("effect", WANDERS.text, 9.0, ["supply", "electrical"], id="an effect is the answer"),
        pytest.param("effect", "", 0.0, ["electrical"], id="mean strokes hold no gap"),
    ],
)
def test_what_varies_within_trials_is_the_place_where_the_answer_rests_on_it(
    monkeypatch, verdict, resembles, left_over, equations
):
    """As seen: the motor's voltages did not balance, and a small gap of the mean strokes at the battery came first."""
    monkeypatch.setattr(gap_report, "locate", lambda problem, posterior: [IN_MEAN_STROKES])
    posterior = SimpleNamespace(
        best=SimpleNamespace(members=()), finding=WANDERS, verdict=verdict, resembles=resembles,
        of=lambda name: SimpleNamespace(left_over=left_over),
    )  # fmt: skip
    found = gap_report._where(SimpleNamespace(quiet=1.0), posterior)
    assert [one["equation"] for one in found] == equations
    assert found[0]["share"] == 1.0
