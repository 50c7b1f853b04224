"""Which effects a campaign cannot tell from those of a cause."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from sawbench.diagnosis.answer.gap_report import _alike
from sawbench.diagnosis.inference.hypothesis import named
from sawbench.diagnosis.inference.settings import SETTINGS

pytestmark = pytest.mark.unit

PROBLEM = SimpleNamespace(settings=SETTINGS)


def alike(cause, evidence, *, shared=()):
    """Names listed beside a cause, of hypotheses with these log evidences; `shared` act where the stronger does."""
    claims = [named(name, value, shared=float(name in shared)) for name, value in evidence.items()]
    return set(_alike(PROBLEM, next(h for h in claims if h.name == cause), SimpleNamespace(claims=claims)))


def test_rivals_within_the_scatter_of_the_evidence_are_listed():
    evidence = {"brush_voltage_drop": 100.0, "converter_diode_drop": 91.0, "windage_drag": 89.0}
    assert alike("brush_voltage_drop", evidence) == {"converter_diode_drop"}


def test_of_a_pair_what_the_stronger_effect_explains_says_nothing_of_the_weaker_ones():
    strong, pair = "yoke_backlash", "converter_loss + yoke_backlash"
    rivals = {"clock_offset + yoke_backlash": 16_500.0, "tooth_passing_ripple + yoke_backlash": 16_530.0}
    evidence = {strong: 16_476.0, "converter_loss": 900.0, pair: 16_520.0}
    # The one adds half as much; the other acts where the play does, whose form may add a hundred nats.
    assert alike(pair, evidence | rivals, shared={"tooth_passing_ripple + yoke_backlash"}) == set()
    assert alike(pair, evidence | rivals) == {"tooth_passing_ripple"}
