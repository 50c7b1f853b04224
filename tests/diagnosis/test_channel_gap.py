"""The gap by channel is that of the harmonics to which the models were fitted."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.diagnosis.answer.channel_gap import _cycle, _Strokes
from sawbench.diagnosis.inference.features import HARMONICS, Layout
from sawbench.modeling.stroke import Prediction, mean_stroke

from tests.rigs.drawn_states import BASELINE, running

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(
    ("order", "resolved", "is_seen"),
    [(20, {}, True), (20, {"force_n": 25.4}, True), (40, {}, False), (20, {"force_n": 15.0}, False)],
)
def test_a_form_is_held_to_the_harmonics_that_are_compared_and_sampled(order, resolved, is_seen):
    """Teeth pass about forty times a stroke: a form that is fitted to 32 harmonics goes on above them."""
    state = running(resolved_orders=resolved)
    stroke = mean_stroke(state)
    teeth = replace(stroke, force_n=stroke.force_n + 20.0 * np.cos(order * stroke.angle_rad))
    found = {
        name: Prediction(state=one, wood_n_s_per_m=240.0, is_settled=True)
        for name, one in (("retuned", stroke), ("with_effect", teeth))
    }
    part = SimpleNamespace(
        state=state, layout=Layout(kind="running", equations=("cutting", "supply"), n_harmonics=HARMONICS)
    )
    cycle = _cycle(BASELINE, part, _Strokes(stroke=stroke, found=found))
    error = np.sqrt(np.mean(cycle.error("with_effect", "force_n") ** 2))
    assert error == pytest.approx(20.0 / np.sqrt(2.0) if is_seen else 0.0, abs=1e-9)
    assert np.allclose(cycle.error("retuned", "force_n"), 0.0)
