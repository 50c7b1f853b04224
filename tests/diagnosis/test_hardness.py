"""What shapes a cut goes with the force of the piece that is cut, not with that of the whole stock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.diagnosis.campaign import Campaign, with_known
from sawbench.diagnosis.inference.effect_columns import effect_columns
from sawbench.diagnosis.inference.linear_problem import build_problem
from sawbench.diagnosis.inference.posterior import judge
from sawbench.diagnosis.plants.jigsaw import Jigsaw

from tests.rigs.jigsaw_in_time import BASELINE, K_CUT, RADIUS, Machine
from tests.rigs.scattered_strokes import N_UNITS

pytestmark = pytest.mark.pipeline

# Duty, whether it cuts, and feed.
TRIALS = ((0.4375, True, 0.002), (0.35, True, 0.006), (0.55, True, 0.003), (0.4375, False, 0.0), (0.4375, True, 0.006))


def guessed(states):
    campaign = Campaign(plant=Jigsaw(baseline=BASELINE), states=tuple(states), k_guess_n_s_per_m={}, warnings=())
    return with_known(campaign, [])


def test_a_piece_is_as_hard_as_its_force_and_not_as_the_zero_of_the_load_cell():
    state, harder = Machine().run(), 1.2
    states = [
        replace(state, force_n=k * state.force_n + zero_n, setting=replace(state.setting, label=label))
        for label, k, zero_n in (("soft", 1.0, 0.0), ("hard", harder, 5.0))
    ]
    soft, hard = (s.hardness for s in guessed(states).states)
    assert hard / soft == pytest.approx(harder, rel=1e-6)
    assert soft + hard == pytest.approx(2.0, rel=1e-6)


def in_chips(late, exponent=0.5, seed=3):
    """Five trials whose cut grows with the chip, and begins a little late; with the noise of sensors."""
    rng = np.random.default_rng(seed)
    for number, (duty, cuts, feed_m_s) in enumerate(TRIALS):
        k = K_CUT * (feed_m_s / duty / (0.004 / 0.4375)) ** exponent if cuts else 0.0
        state = Machine(
            duty=duty, cuts=cuts, cut=lambda speed, travelled, _, k=k: k * speed * (travelled > late * 2 * RADIUS)
        ).run(N_UNITS)
        setting = replace(
            state.setting, label=f"t{number}", index=number, feed_m_s=feed_m_s, session_s=120.0 * number,
            stock="oak" if cuts else "none", operating_point=f"{duty} {cuts} {feed_m_s}",
        )  # fmt: skip
        noise = {"force_n": 0.2, "current_a": 0.01, "battery_voltage_v": 0.005, "battery_current_a": 0.01}
        noisy = {name: getattr(state, name) + std * rng.standard_normal((N_UNITS, 128)) for name, std in noise.items()}
        yield replace(state, setting=setting, **noisy)


def test_a_bite_that_is_a_little_late_leaves_no_gap_beside_a_force_that_goes_with_the_chip():
    """As seen: what the late bite took off each trial's own force was unknown beside the chip's thickness."""
    problem = build_problem(guessed(in_chips(late=0.0067)))
    found = judge(problem, effect_columns(problem))
    assert found.verdict == "effect"
    assert found.hypotheses[0].name == "chip_thickness"
    assert found.hypotheses[0].left_over < problem.quiet
