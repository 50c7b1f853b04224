"""A saw with known effects from rest, in time: the residuals' own terms, evaluated instant by instant.

At an instant the equations give the rates of current and speed, and force, battery voltage and battery current, each
from an equation of its own; effects enter all of them, so they are solved by substitution. scipy integrates the rates:
slower than the model without effects, and nothing is compiled.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.learned import out_of_range
from sawbench.modeling.operating_point import OperatingPoint, check_scales, state_at
from sawbench.modeling.residuals import Baseline, bare_residuals
from sawbench.modeling.state import TWO_PI, Memory, State
from sawbench.modeling.trajectory import AT_REST, InitialState, TransientStatus

_SUBSTITUTIONS: Final = 4
_RELATIVE_TOLERANCE: Final = 1e-6
_LONGEST_STEP_S: Final = 2e-3
# Slower than this at the end, the crank stands.
_STANDS_RAD_S: Final = 0.5


@dataclass(frozen=True, kw_only=True, slots=True)
class EffectRun:
    """A simulated run of a saw with known effects; every array has shape (n,).

    Attributes
    ----------
    time_s, motor_current_a, motor_speed_rad_s, crank_angle_rad, soc : ndarray
    force_n, displacement_m, battery_voltage_v, battery_current_a : ndarray
        As the sensors read them.
    status : {"ok", "stalled", "battery_empty", "not_converged"}
    message : str
    energy : None
        What an effect takes is not booked.
    """

    time_s: Floats
    motor_current_a: Floats
    motor_speed_rad_s: Floats
    crank_angle_rad: Floats
    soc: Floats
    force_n: Floats
    displacement_m: Floats
    battery_voltage_v: Floats
    battery_current_a: Floats
    status: TransientStatus
    message: str
    energy: None = field(default=None, init=False)


def simulate_with_effects(
    baseline: Baseline, point: OperatingPoint, time_s: Floats, *, initial: InitialState = AT_REST
) -> EffectRun:
    """Simulate a saw with known effects over time.

    Parameters
    ----------
    baseline : Baseline
        With a battery.
    point : OperatingPoint
        Duty or held voltage, cutting coefficient, and what the blade, the battery and the motor bring along.
    time_s : ndarray, shape (n,)
        From 0 on, increasing.
    initial : InitialState
        Its charge counts, not that of the point.

    Raises
    ------
    InputError
        If an effect takes a whole stroke to evaluate, or a campaign; the message names it.
    """
    from scipy.integrate import solve_ivp

    _refuse_whole_strokes(baseline)
    check_scales(baseline)
    model = _Instants(baseline, point, initial)
    solution = solve_ivp(
        model.rates, (0.0, max(float(time_s[-1]), 1e-9)), model.begin(), method="LSODA", t_eval=time_s,
        rtol=_RELATIVE_TOLERANCE, atol=1e-6, max_step=_LONGEST_STEP_S,
    )  # fmt: skip
    current, speed, angle, charge = solution.y[:4]
    state = model.solved(solution.t, solution.y)
    status, message = _judged(bool(solution.success), speed, model.soc(charge))
    message = "; ".join([message, *out_of_range(baseline.known, baseline, [state])])
    assert state.force_n is not None and state.battery_voltage_v is not None and state.battery_current_a is not None
    return EffectRun(
        time_s=solution.t,
        motor_current_a=current,
        motor_speed_rad_s=baseline.gear * speed,
        crank_angle_rad=angle,
        soc=model.soc(charge),
        force_n=state.force_n[:, 0],
        displacement_m=baseline.mechanism.displacement(angle),
        battery_voltage_v=state.battery_voltage_v[:, 0],
        battery_current_a=state.battery_current_a[:, 0],
        status=status,
        message=message,
    )


def _refuse_whole_strokes(baseline: Baseline) -> None:
    names = [known.effect.name for known in baseline.known if not known.effect.is_pointwise]
    if names:
        raise InputError(
            f"[effects] {', '.join(names)} cannot be simulated from rest: a whole stroke is needed to evaluate it",
            remedy="`sawbench runtime`, `fit` and `diagnose` accept it",
        )


def _judged(is_done: bool, speed_rad_s: Floats, soc: Floats) -> tuple[TransientStatus, str]:
    if not is_done:
        return "not_converged", "the integration of the model with its effects did not finish"
    if soc[-1] <= 0.0:
        return "battery_empty", "the state of charge fell below 0"
    if speed_rad_s[-max(len(speed_rad_s) // 10, 1) :].max() < _STANDS_RAD_S:
        return "stalled", "the crank stalls:  the motor cannot overcome the load and the friction"
    return "ok", "completed"


class _Instants:
    """Equations at single instants; rows of every array are instants."""

    def __init__(self, baseline: Baseline, point: OperatingPoint, initial: InitialState) -> None:
        if baseline.battery is None:
            raise InputError("a simulation with effects needs a battery", remedy="fill in [battery]")
        self.baseline, self.bare = baseline, replace(baseline, known=())
        self.initial, self.point = initial, point
        self.capacity_as = 3600.0 * baseline.battery.capacity_ah
        self.template = state_at(baseline, point)
        self.memories: tuple[Memory, ...] = tuple({m: None for k in baseline.known for m in k.effect.memories})

    def begin(self) -> Floats:
        """Current, crank speed, angle, charge used, then the slow states, shape (4 + n_memories,)."""
        initial, point = self.initial, self.point
        slow = [point.slow.get(memory, 0.0) for memory in self.memories]
        used = (1.0 - initial.soc) * self.capacity_as
        return np.array(
            [initial.current_a, initial.motor_speed_rad_s / self.baseline.gear, initial.crank_angle_rad, used, *slow]
        )

    def soc(self, charge_used_as: Floats) -> Floats:
        """State of charge."""
        return 1.0 - charge_used_as / self.capacity_as

    def rates(self, time_s: float, y: Floats) -> Floats:
        """Derivative of the states with time, of the shape of `begin`."""
        state = self.solved(np.array([time_s]), y[:, None])
        assert state.current_rate_a_s is not None and state.battery_current_a is not None
        drawn = float(state.battery_current_a[0, 0])
        drives = {
            "motor_current_squared_a2": y[0] ** 2,
            "crank_speed_squared_rad2_s2": y[1] ** 2,
            "battery_current_a": drawn,
        }
        slow = [(drives[m.drive] - held) / m.time_constant_s for m, held in zip(self.memories, y[4:], strict=True)]
        rates = (float(state.current_rate_a_s[0, 0]), float(state.acceleration_rad_s2[0, 0]), y[1], drawn)
        return np.array([*rates, *slow])

    def solved(self, time_s: Floats, y: Floats) -> State:
        """States that satisfy every equation, one row an instant, at times (n,) from states (n_states, n)."""
        plant = self.baseline.plant
        state = self._at(time_s, y)
        inertia = self.baseline.inertia_kg_m2(self.baseline.lever(state)) / self.baseline.gear
        cutting = self.point.k_fc_n_s_per_m * self.baseline.cutting_speed(state)
        for _ in range(_SUBSTITUTIONS):
            rest, added = bare_residuals(self.bare, state), self.baseline.known_signature(state)
            left = {name: wave - added.get(name, 0.0) for name, wave in rest.items()}
            assert state.current_rate_a_s is not None and state.force_n is not None
            assert state.battery_voltage_v is not None and state.battery_current_a is not None
            voltage = state.battery_voltage_v - left["supply"]
            duty = self._duty(voltage)
            state = replace(
                state,
                setting=replace(state.setting, duty=duty),  # type: ignore[arg-type]
                current_rate_a_s=state.current_rate_a_s + left["electrical"] / plant.inductance_h.nominal,
                acceleration_rad_s2=state.acceleration_rad_s2 + left["mechanical"] / inertia,
                force_n=state.force_n - (left["cutting"] - cutting),
                battery_voltage_v=voltage,
                battery_current_a=state.battery_current_a - left["converter"],
                motor_voltage_v=duty * voltage,
            )
        return state

    def _duty(self, battery_voltage_v: Floats) -> float | Floats:
        held_v = self.point.held_voltage_v
        return self.template.setting.duty if held_v is None else np.minimum(held_v / battery_voltage_v, 1.0)

    def _at(self, time_s: Floats, y: Floats) -> State:
        """States to start the substitution from."""
        point, baseline = self.point, self.baseline
        current, speed, angle, used = (row[:, None] for row in y[:4])
        assert baseline.battery is not None
        voltage = baseline.open_circuit_voltage(used)
        duty = self._duty(voltage)
        turned = (angle - self.initial.crank_angle_rad) / TWO_PI
        travel_m = 2.0 * baseline.radius_m * turned if point.k_fc_n_s_per_m > 0.0 else 0.0 * turned
        nothing = np.zeros_like(current)
        return replace(
            self.template,
            kind="instant",
            setting=replace(self.template.setting, duty=duty),  # type: ignore[arg-type]
            angle_rad=angle,
            speed_rad_s=speed,
            acceleration_rad_s2=nothing,
            current_a=current,
            current_rate_a_s=nothing,
            force_n=nothing,
            force_rate_n_s=nothing,
            battery_voltage_v=voltage,
            battery_current_a=duty * current,
            motor_voltage_v=duty * voltage,
            time_s=point.time_s + time_s[:, None],
            charge_used_as=used,
            cut_distance_m=point.cut_distance_m + travel_m,
            slow={memory: row[:, None] for memory, row in zip(self.memories, y[4:], strict=True)},
        )
