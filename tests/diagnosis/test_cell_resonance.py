"""A load cell that rings by itself is found beside whatever else there is, and is no gap; nothing else is one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.diagnosis.answer.signals import signal_findings
from sawbench.diagnosis.campaign import with_known
from sawbench.diagnosis.inference.cell_resonance import with_cell_resonance
from sawbench.diagnosis.inference.posterior import judge_weighed
from sawbench.diagnosis.signal_health import ChannelHealth

from tests.rigs.jigsaw_in_time import K_CUT, RADIUS
from tests.rigs.scattered_strokes import problem_of, strokes

pytestmark = pytest.mark.pipeline

RING_HZ, DAMPING = 690.0, 0.05


def campaign_of(states):
    health = ChannelHealth(
        channel="force_n", seconds=10.0, rate_hz=5000.0, noise=0.5, step=0.0, spikes=0, impacts=0,
        missing_share=0.0, jitter_share=0.0,
    )  # fmt: skip
    return replace(problem_of(states).campaign, health=(health,))


@pytest.fixture(scope="module")
def ringing():
    return campaign_of(strokes(ring=(RING_HZ, DAMPING)))


@pytest.fixture(scope="module")
def found(ringing):
    return with_cell_resonance(ringing)


def test_a_cell_that_rings_is_found_and_no_gap(found):
    (ring,) = found.problem.campaign.plant.known
    assert ring.name == "load_cell_resonance.frequency_hz"
    assert ring.value == pytest.approx(RING_HZ, abs=max(0.01 * RING_HZ, 3.0 * ring.std))
    assert ring.form["damping"] == pytest.approx(DAMPING, rel=0.3)
    assert judge_weighed(found).verdict == "no_gap"


def test_it_is_listed_among_the_signals(found):
    (listed,) = [one for one in signal_findings(found.problem.campaign, None) if one["finding"] == "resonance"]
    assert listed["channel"] == "force_n"
    assert listed["frequency_hz"] == pytest.approx(RING_HZ, rel=0.01)
    assert listed["magnitude"] == pytest.approx(0.5 / DAMPING, rel=0.3)
    assert f"{listed['frequency_hz']:.0f} Hz" in listed["words"]


def test_one_that_the_configuration_states_is_not_looked_for_again(ringing, found):
    (ring,) = found.problem.campaign.plant.known
    stated = with_known(ringing, (ring.at(RING_HZ),))
    (again,) = with_cell_resonance(stated).problem.campaign.plant.known
    assert again.value == RING_HZ


def test_the_law_of_cutting_is_named_behind_a_cell_that_rings():
    law = 0.6
    cut = strokes(cut=lambda speed, travelled, force: 170.0 * speed**law, ring=(RING_HZ, DAMPING))
    weighed = with_cell_resonance(campaign_of(cut))
    (ring,) = weighed.problem.campaign.plant.known
    assert ring.value == pytest.approx(RING_HZ, rel=0.02)
    best = judge_weighed(weighed).best
    assert best.effects == ("cutting_speed_exponent",)
    assert best.members[0].strength == pytest.approx(law, abs=0.1)


def test_a_narrow_one_behind_sharper_edges_is_found():
    """It falls between the forms, and an edge force that rings is another wave than the two side by side."""
    ring_hz, damping = 623.0, 0.015
    cut = strokes(
        cut=lambda speed, travelled, force: K_CUT * speed + 60.0 * np.tanh(speed / 0.08), ring=(ring_hz, damping)
    )
    (ring,) = with_cell_resonance(campaign_of(cut)).problem.campaign.plant.known
    assert ring.value == pytest.approx(ring_hz, rel=0.01)
    assert ring.form["damping"] < 2.0 * damping


def test_one_above_the_carriages_frequencies_is_found():
    ring_hz = 426.0
    cut = strokes(cut=lambda speed, travelled, force: (K_CUT * speed + 20.0) * (speed > 0.0), ring=(ring_hz, DAMPING))
    (ring,) = with_cell_resonance(campaign_of(cut)).problem.campaign.plant.known
    assert ring.value == pytest.approx(ring_hz, rel=0.02)


def _late(speed, travelled, force):
    return K_CUT * speed * np.clip((travelled / (2.0 * RADIUS) - 0.3) / 0.03 + 0.5, 0.0, 1.0)


def test_a_light_mode_among_the_frequencies_of_the_carriage_is_found_and_no_gap():
    """It has a twelfth of the force, and rings where the blade begins to cut late."""
    ring_hz, share = 290.0, 0.08
    light = with_cell_resonance(campaign_of(strokes(cut=_late, ring=(ring_hz, DAMPING), ring_share=share)))
    (ring,) = light.problem.campaign.plant.known
    assert ring.value == pytest.approx(ring_hz, rel=0.02)
    assert ring.form["share"] == pytest.approx(share, abs=0.02)
    best = judge_weighed(light).best
    assert best.effects == ("engagement_delay",)


@pytest.mark.parametrize(
    "machine",
    [
        {},
        {"cut": _late},
        {"cut": lambda speed, travelled, force: 170.0 * speed**0.6},
        {"cut": lambda speed, travelled, force: (K_CUT * speed + 12.0) * (speed > 0.0)},
        {"ring": (330.0, 0.04)},
        {"ring": (400.0, 0.06)},
        {"ring": (240.0, 0.05), "ring_share": 0.4},
    ],
    ids=["intact", "late teeth", "law", "edge force", "fast carriage", "just below the range", "a part of the force"],
)
def test_nothing_else_is_taken_for_it(machine):
    assert with_cell_resonance(campaign_of(strokes(**machine))).problem.campaign.plant.known == ()


def test_what_the_force_was_not_sampled_for_is_not_looked_for(ringing):
    (health,) = ringing.health
    slow = replace(ringing, health=(replace(health, rate_hz=900.0),))
    assert with_cell_resonance(slow).problem.campaign.plant.known == ()
