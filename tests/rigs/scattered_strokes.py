"""A campaign of jigsaw strokes integrated in time, with the scatter of wood and of sensors, and its linear problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.inference.linear_problem import build_problem
from sawbench.diagnosis.plants.jigsaw import Jigsaw

from tests.rigs.jigsaw_in_time import BASELINE, Machine

N_UNITS = 12
TRIALS = ((0.4375, True, 0.004), (0.35, True, 0.004), (0.55, True, 0.006), (0.4375, False, 0.0), (0.4375, True, 0.004))


def strokes(seed=21, **machine):
    """Five trials of twelve units with the scatter of wood and of sensors; `machine`: fields of `Machine`."""
    rng = np.random.default_rng(seed)
    found, known = [], {}
    for number, (duty, cuts, feed_m_s) in enumerate(TRIALS):
        state = known.setdefault((duty, cuts), Machine(duty=duty, cuts=cuts, **machine).run(N_UNITS))

        def noisy(wave, size):
            return wave + size * rng.standard_normal(wave.shape)

        setting = replace(
            state.setting, label=f"t{number}", index=number, feed_m_s=feed_m_s, session_s=120.0 * number,
            stock="oak" if cuts else "none",
            operating_point=f"{duty} {cuts} {feed_m_s}",
        )  # fmt: skip
        hardness = 1.0 + 0.03 * rng.standard_normal((N_UNITS, 1))
        found.append(
            replace(
                state,
                setting=setting,
                force_n=noisy(hardness * state.force_n, 0.5),
                current_a=noisy(state.current_a, 0.02),
                battery_voltage_v=noisy(state.battery_voltage_v, 0.005),
                battery_current_a=noisy(state.battery_current_a, 0.02),
            )
        )
    return found


def problem_of(states):
    campaign = Campaign(plant=Jigsaw(baseline=BASELINE), states=tuple(states), k_guess_n_s_per_m={}, warnings=())
    return build_problem(campaign)


def friction(state):
    return {"mechanical": -0.006 * (1.0 + 0.1 * state.speed_rad_s / 80.0)}
