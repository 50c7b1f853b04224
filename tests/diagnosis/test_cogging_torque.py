"""A cogging torque is named on a campaign that has it: a saw without a gear, integrated here."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.bench.config import BatteryConfig, PlantConfig
from sawbench.diagnosis.campaign import Campaign
from sawbench.diagnosis.inference.columns import catalogue_columns
from sawbench.diagnosis.inference.linear_problem import build_problem
from sawbench.diagnosis.inference.posterior import judge
from sawbench.diagnosis.plants.jigsaw import Jigsaw
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME, MEMORIES
from sawbench.modeling.residuals import Baseline, residuals
from sawbench.modeling.state import State, TrialSetting
from scipy.integrate import solve_ivp

# A slow motor with a large flux that drives the crank itself: a wave of the slots repeats with the stroke.
R, L, FLUX, DAMPING, ROTOR, YOKE, MASS, RADIUS = 0.5, 2e-3, 0.07, 2e-5, 2e-4, 5e-5, 0.24, 0.01
K_CUT, E_0, R_B, SLOTS, COGGING_N_M, PHASE = 60.0, 18.0, 0.02, 5, 0.02, 0.7
N_UNITS, N_POINTS = 12, 128
GRID = (np.arange(N_POINTS) + 0.5) * 2.0 * np.pi / N_POINTS
BASELINE = Baseline(
    plant=PlantConfig.model_validate(
        {
            "resistance_ohm": {"nominal": R, "rel_std": 0.05},
            "inductance_h": {"nominal": L, "rel_std": 0.1},
            "back_emf_constant_v_s_per_rad": {"nominal": FLUX, "rel_std": 0.02},
            "torque_constant_n_m_per_a": {"nominal": FLUX, "rel_std": 0.03},
            "rotor_inertia_kg_m2": {"nominal": ROTOR, "rel_std": 0.05},
            "yoke_inertia_kg_m2": {"nominal": YOKE, "rel_std": 0.05},
            "reciprocating_mass_kg": {"nominal": MASS, "rel_std": 0.02},
            "crank_radius_m": {"nominal": RADIUS, "rel_std": 0.003},
            "motor_damping_n_m_s_per_rad": {"nominal": DAMPING, "rel_std": 0.3},
            "gear_ratio": 1.0,
        }
    ),
    battery=BatteryConfig(
        nominal_voltage_v=E_0, capacity_ah=1.5, beta=0.99, internal_resistance_ohm=R_B, cutoff_soc=0.2
    ),
    cutting_sign=-1,
)


def settled_stroke(duty: float, cuts: bool, cogging_n_m: float) -> dict[str, np.ndarray]:
    """One stroke of the settled machine on the grid of the crank angle: motion and current with their rates."""
    k = K_CUT if cuts else 0.0

    def rates(_, y):
        current, speed, angle = y
        lever, slope = RADIUS * np.sin(angle), RADIUS * np.cos(angle)
        force = k * max(-lever * speed, 0.0)
        slots = cogging_n_m * np.sin(SLOTS * angle + PHASE)
        torque = FLUX * current - DAMPING * speed - slots + force * lever - MASS * lever * slope * speed**2
        voltage = duty * (E_0 - R_B * duty * current)
        return [(voltage - R * current - FLUX * speed) / L, torque / (ROTOR + YOKE + MASS * lever**2), speed]

    def turned(t, y):
        return y[2] - 40.0 * np.pi

    turned.terminal = True
    exact = solve_ivp(rates, (0.0, 20.0), [5.0, 60.0, 0.0], events=turned, rtol=1e-9, atol=1e-9, max_step=2e-3,
                      dense_output=True)  # fmt: skip
    t = np.linspace(0.0, exact.t[-1], 200_000)
    at = np.interp(GRID + 38.0 * np.pi, exact.sol(t)[2], t)
    y = exact.sol(at)
    dy = np.array([rates(0.0, column) for column in y.T]).T
    return {"speed": y[1], "acceleration": dy[1], "current": y[0], "rate": dy[0],
            "force": k * np.maximum(-RADIUS * np.sin(GRID) * y[1], 0.0)}  # fmt: skip


def trial(number: int, duty: float, cuts: bool, cogging_n_m: float, noise: float = 1.0) -> State:
    rng = np.random.default_rng(number)
    stroke = settled_stroke(duty, cuts, cogging_n_m)

    def rows(wave, std):
        return wave + noise * std * rng.standard_normal((N_UNITS, N_POINTS))

    hardness = 1.0 + 0.02 * noise * rng.standard_normal((N_UNITS, 1))
    current, one = stroke["current"], np.ones((N_UNITS, 1))
    voltage = rows(E_0 - R_B * duty * current, 0.005)
    setting = TrialSetting(
        label=f"t{number}", index=number, duty=duty, is_idle=not cuts, stock="oak" if cuts else "air", feed_m_s=0.004,
        thickness_m=0.02, operating_point=f"{duty} {cuts}", session_s=60.0 * number,
    )  # fmt: skip
    return State(
        kind="running", setting=setting, angle_rad=np.broadcast_to(GRID, (N_UNITS, N_POINTS)),
        speed_rad_s=rows(stroke["speed"], 0.0), acceleration_rad_s2=rows(stroke["acceleration"], 0.0),
        current_a=rows(current, 0.02), current_rate_a_s=rows(stroke["rate"], 0.0),
        force_n=rows(hardness * stroke["force"], 0.5), force_rate_n_s=rows(0.0 * GRID, 0.0),
        battery_voltage_v=voltage, battery_current_a=rows(duty * current, 0.02),
        motor_voltage_v=duty * voltage, time_s=np.linspace(1.0, 9.0, N_UNITS)[:, None], cut_distance_m=0.0 * one,
        charge_used_as=0.0 * one, n_strokes=np.full(N_UNITS, 8.0), slow=dict.fromkeys(MEMORIES, 0.0 * one),
        k_guess_n_s_per_m=K_CUT if cuts else 0.0, peak_force_n=40.0,
    )  # fmt: skip


PLAN = [(duty, cuts) for duty in (0.25, 0.35, 0.45) for cuts in (False, True) for _ in range(2)]


def judged(cogging_n_m: float):
    states = tuple(trial(k, duty, cuts, cogging_n_m) for k, (duty, cuts) in enumerate(PLAN))
    campaign = Campaign(plant=Jigsaw(baseline=BASELINE), states=states, k_guess_n_s_per_m={"oak": K_CUT}, warnings=())
    problem = build_problem(campaign)
    return judge(problem, catalogue_columns(problem, campaign.plant.effects)).hypotheses


@pytest.mark.contract
@pytest.mark.parametrize("cuts", [True, False])
def test_the_torque_of_the_slots_is_what_the_residual_misses(cuts):
    state = trial(0, 0.35, cuts, COGGING_N_M, noise=0.0)
    sine, cosine = EFFECT_BY_NAME["cogging_torque"].signatures(BASELINE, state, {"slots": float(SLOTS)})
    claimed = COGGING_N_M * (np.cos(PHASE) * sine["mechanical"] + np.sin(PHASE) * cosine["mechanical"])
    assert np.allclose(residuals(BASELINE, state)["mechanical"], claimed, atol=1e-4 * COGGING_N_M)


@pytest.mark.slow
def test_it_is_named_with_its_size_where_it_is_and_not_where_it_is_not():
    first = judged(COGGING_N_M)[0]
    assert first.effects == ("cogging_torque",)
    assert first.probability > 0.9
    (member,) = first.members
    assert member.strength == pytest.approx(COGGING_N_M, rel=0.1)
    assert judged(0.0)[0].effects == ()
