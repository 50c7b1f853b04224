"""The periodic stroke of a saw with its known effects, at an operating point that nobody measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.state import TWO_PI, Memory, State, TrialSetting
from sawbench.modeling.stroke import Prediction, predict

N_POINTS: Final = 128
# Of a duty that holds the motor's voltage: each time some per cent of the last change are left.
_TRIMMINGS: Final = 5
_LEAST_VOLTAGE_V: Final = 0.1
# Over these a wave along the feed averages out.
_MANY_STROKES: Final = 1e6


@dataclass(frozen=True, kw_only=True, slots=True)
class OperatingPoint:
    """What a stroke is predicted for.

    Attributes
    ----------
    k_fc_n_s_per_m : float
        0: the blade runs in air.
    duty : float, optional
        Of a fixed duty.
    held_voltage_v : float, optional
        Motor voltage that the converter holds, instead of a duty.
    battery_voltage_v : float, optional
        At the terminals, where it was measured; else the battery's model gives it.
    charge_used_as, cut_distance_m : float
        Taken from the battery, and cut by the blade, before.
    time_s : float
        Since the start of the trial.
    feed_m_s, thickness_m : float
        NaN where nobody said.
    slow : mapping of Memory to float
        Slow states; 0 where there is none.
    """

    k_fc_n_s_per_m: float
    duty: float | None = None
    held_voltage_v: float | None = None
    battery_voltage_v: float | None = None
    charge_used_as: float = 0.0
    cut_distance_m: float = 0.0
    time_s: float = 0.0
    feed_m_s: float = np.nan
    thickness_m: float = np.nan
    slow: Mapping[Memory, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if (self.duty is None) == (self.held_voltage_v is None):
            raise InputError("an operating point needs a duty, or a motor voltage that is held")


def check_scales(baseline: Baseline) -> None:
    """Refuse effects whose form is stated relative to a campaign that is not at hand.

    Raises
    ------
    InputError
        That names the effect and the key it lacks.
    """
    for known in baseline.known:
        lacking = [name for name in known.effect.scales if name not in known.scales]
        if lacking:
            raise InputError(
                f"[effects] {known.effect.name} is stated relative to the {lacking[0]} of a campaign, which only"
                " `diagnose` has",
                remedy=f"add {lacking[0]} to its entry; improved_model.toml of `sawbench diagnose` has it",
            )


def _check_feed(baseline: Baseline, point: OperatingPoint) -> None:
    """Refuse effects of the feed where nobody said the feed."""
    for known in baseline.known:
        if "feed" in known.effect.grows_with and not point.feed_m_s > 0.0 and point.k_fc_n_s_per_m > 0.0:
            raise InputError(
                f"[effects] {known.effect.name} needs the feed, which is unknown",
                remedy="use a recording whose trial states feed_mm_s",
            )


def periodic_stroke(baseline: Baseline, point: OperatingPoint, *, start: Prediction | None = None) -> Prediction:
    """Solve for the stroke of a baseline with its known effects.

    Parameters
    ----------
    baseline : Baseline
    point : OperatingPoint
    start : Prediction, optional
        Of a point nearby.

    Returns
    -------
    Prediction
        Shape (1, 128) over the crank angle.

    Raises
    ------
    InputError
        If an effect needs what the point does not say.
    """
    _check_feed(baseline, point)
    if point.battery_voltage_v is not None:
        baseline = replace(baseline, battery=None)
    state = state_at(baseline, point)
    k_fc = point.k_fc_n_s_per_m
    found = predict(baseline, state, (), wood_n_s_per_m=k_fc, start=start)
    if point.held_voltage_v is None:
        return found
    for _ in range(_TRIMMINGS):
        voltage = found.state.battery_voltage_v
        if voltage is None or not found.is_settled:
            break
        duty = np.minimum(point.held_voltage_v / np.maximum(voltage, _LEAST_VOLTAGE_V), 1.0)
        # A duty over the stroke, as a wave in place of a number.
        setting = replace(state.setting, duty=duty)  # type: ignore[arg-type]
        found = predict(baseline, replace(state, setting=setting), (), wood_n_s_per_m=k_fc, start=found)
    return found


def mean_over_time(stroke: State, wave: Floats | None) -> float:
    """Mean of a wave of a stroke over time, not over the angle."""
    if wave is None:
        raise ValueError("this stroke has no such channel")
    return float(np.average(wave[0], weights=1.0 / stroke.speed_rad_s[0]))


def state_at(baseline: Baseline, point: OperatingPoint) -> State:
    """State to search from, shape (1, 128): even speed and current that balance the mean torques."""
    angle = ((np.arange(N_POINTS) + 0.5) * TWO_PI / N_POINTS)[None, :]
    ones = np.ones_like(angle)
    open_v = point.battery_voltage_v
    if open_v is None:
        open_v = float(baseline.open_circuit_voltage(np.array(point.charge_used_as)))
    duty = point.duty
    if duty is None:
        assert point.held_voltage_v is not None
        duty = min(point.held_voltage_v / open_v, 1.0)
    plant, gear = baseline.plant, baseline.gear
    lever = baseline.mechanism.lever(angle)
    cut = point.k_fc_n_s_per_m * float(np.mean(np.where(baseline.cutting_sign * lever > 0.0, lever**2, 0.0)))
    drag = plant.motor_damping_n_m_s_per_rad.nominal * gear**2 + cut
    torque_per_a = plant.torque_constant_n_m_per_a.nominal * gear
    back_emf = plant.back_emf_constant_v_s_per_rad.nominal * gear
    speed = duty * open_v / (back_emf + plant.resistance_ohm.nominal * drag / torque_per_a) * ones
    current = drag / torque_per_a * speed
    is_idle = point.k_fc_n_s_per_m == 0.0
    slow = {memory: 0.0 for known in baseline.known for memory in known.effect.memories} | dict(point.slow)
    return State(
        kind="running",
        setting=TrialSetting(
            label="predicted", index=0, duty=duty, is_idle=is_idle, stock="air" if is_idle else "predicted",
            feed_m_s=point.feed_m_s, thickness_m=point.thickness_m, operating_point="predicted", session_s=0.0,
        ),
        angle_rad=angle,
        speed_rad_s=speed,
        acceleration_rad_s2=0.0 * ones,
        current_a=current,
        current_rate_a_s=0.0 * ones,
        force_n=point.k_fc_n_s_per_m * np.maximum(baseline.cutting_sign * lever * speed, 0.0),
        force_rate_n_s=0.0 * ones,
        battery_voltage_v=open_v * ones,
        battery_current_a=duty * current,
        motor_voltage_v=duty * open_v * ones,
        time_s=np.full((1, 1), point.time_s),
        cut_distance_m=np.full((1, 1), point.cut_distance_m),
        charge_used_as=np.full((1, 1), point.charge_used_as),
        n_strokes=np.array([_MANY_STROKES]),
        slow={memory: np.full((1, 1), value) for memory, value in slow.items()},
        k_guess_n_s_per_m=point.k_fc_n_s_per_m,
    )  # fmt: skip
