"""A jigsaw integrated in time from Eq. 12-13, apart from the model, with a place for every piece of extra physics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from sawbench.bench.config import BatteryConfig, PlantConfig
from sawbench.modeling.effects.catalogue import MEMORIES
from sawbench.modeling.residuals import Baseline, residuals
from sawbench.modeling.state import State, TrialSetting
from scipy.integrate import solve_ivp

R, L, KE, KM, B = 0.176, 0.00321, 0.007383, 0.005632, 3.4274e-06
JM, JC, MASS, RADIUS, GEAR = 2.4e-05, 2.38e-05, 0.239, 0.01, 9.333333333333334
R_BATTERY, DUTY, K_CUT, E_OPEN = 0.02, 0.4375, 240.0, 18.0
N_POINTS = 128
END_S = 1.1


def _plant() -> PlantConfig:
    return PlantConfig.model_validate(
        {
            "resistance_ohm": R,
            "inductance_h": L,
            "back_emf_constant_v_s_per_rad": KE,
            "torque_constant_n_m_per_a": KM,
            "rotor_inertia_kg_m2": JM,
            "yoke_inertia_kg_m2": JC,
            "reciprocating_mass_kg": MASS,
            "crank_radius_m": RADIUS,
            "motor_damping_n_m_s_per_rad": B,
            "gear_ratio": GEAR,
        }
    )


BASELINE = Baseline(
    plant=_plant(),
    battery=BatteryConfig(
        nominal_voltage_v=18.0, capacity_ah=1.5, beta=0.99, internal_resistance_ohm=R_BATTERY, cutoff_soc=0.2
    ),
    cutting_sign=-1,
)


def _linear_cut(speed_m_s, travelled_m, force_n):
    """Force on the cutting half; `force_n` is the state of a cutting law with memory."""
    return K_CUT * speed_m_s


@dataclass(unsafe_hash=True)
class Machine:
    """Eq. 12-13 in the crank's frame, with a place for every piece of extra physics.

    What only a reading or the converter does is left out of comparisons: such machines move alike.
    """

    duty: float = DUTY
    cuts: bool = True
    cut: Callable = _linear_cut  # (speed into the wood >= 0, travelled, memory) -> N
    rub: Callable = lambda speed: 0.0  # speed of the return stroke -> N, against the motion
    guide: Callable = lambda v: 0.0  # plunger velocity -> N against the motion
    drag: Callable = lambda w, load: 0.0  # motor speed, load torque at the motor -> N m
    once: Callable = lambda angle: 0.0  # crank angle -> N m at the motor
    lost_voltage: Callable = lambda i, w: 0.0
    resistance: float = R
    flux: float = 1.0
    battery_resistance: float = R_BATTERY
    open_voltage: float = E_OPEN
    charge_used_as: float = 0.0
    # what the converter takes beside duty * i, A
    lost_current: Callable = field(default=lambda duty, i: 0.0, compare=False)
    memory_s: float = 0.0  # tau of a cutting law with memory
    unloads: bool = False
    lag_force_s: float = 0.0
    lag_current_s: float = 0.0
    ring: tuple[float, float] | None = None  # natural frequency, damping of the carriage
    ring_share: float = 1.0  # of the force that goes through it
    late: dict = field(default_factory=dict, compare=False)  # channel -> s
    # the angle is read too large: order, cos and sin part in rad
    bend: tuple[tuple[int, float, float], ...] = field(default=(), compare=False)

    def forces(self, angle, speed, memory):
        v = RADIUS * speed * np.sin(angle)
        into = max(-v, 0.0)
        if not self.cuts:
            return v, 0.0
        if self.memory_s:
            return v, memory
        # cutting half pi..2 pi: the blade comes back from 2 r
        travelled = 2 * RADIUS - RADIUS * (1 - np.cos(angle))
        cutting = self.cut(into, travelled, memory) if v < 0 else 0.0
        return v, cutting - (self.rub(v) if v > 0 else 0.0)

    def read_angle(self, angle):
        return angle + sum(a * np.cos(k * angle) + b * np.sin(k * angle) for k, a, b in self.bend)

    def read_speed(self, angle, speed):
        return speed * (1 + sum(k * (b * np.cos(k * angle) - a * np.sin(k * angle)) for k, a, b in self.bend))

    def rhs(self, t, y):
        i, w, angle, memory, i_read, f_read, f_read_rate = y.tolist()
        v, force = self.forces(angle, w, memory)
        # power that the blade takes from the crank: cutting while v < 0, rubbing (force < 0) while v > 0
        blade = -force * RADIUS * np.sin(angle)
        battery_voltage = self.open_voltage - self.battery_resistance * self.duty * i
        voltage = self.duty * battery_voltage - self.lost_voltage(i, GEAR * w)
        di = (voltage - self.resistance * i - KE * self.flux * GEAR * w) / L
        braking = self.guide(v) * RADIUS * abs(np.sin(angle))
        motor = KM * self.flux * i - B * GEAR * w - self.drag(GEAR * w, blade / GEAR) - self.once(angle)
        inertia = JM * GEAR**2 + JC + MASS * RADIUS**2 * np.sin(angle) ** 2
        swing = MASS * RADIUS**2 * np.sin(angle) * np.cos(angle) * w**2
        dw = (GEAR * motor - blade - braking - swing) / inertia
        dm = 0.0
        if self.memory_s:
            drive = K_CUT * (-v if self.unloads else max(-v, 0.0))
            dm = (drive - memory) / self.memory_s
            if self.unloads and memory <= 0.0:
                dm = max(dm, -memory / 1e-4)
        dr = (i - i_read) / self.lag_current_s if self.lag_current_s else 0.0
        if self.ring:
            wn, zeta = 2 * np.pi * self.ring[0], self.ring[1]
            return [di, dw, w, dm, dr, f_read_rate, wn**2 * (force - f_read) - 2 * zeta * wn * f_read_rate]
        df = (force - f_read) / self.lag_force_s if self.lag_force_s else 0.0
        return [di, dw, w, dm, dr, df, 0.0]

    def run(self, n_units: int = 2) -> State:
        """Two equal units of the settled stroke, as `running_state` would give them without noise."""
        exact, late = moved(self), self.late
        t = np.arange(END_S - 0.3, END_S, 1e-4)
        crank = self.read_angle(exact(t - late.get("displacement", 0.0))[2])
        grid = (np.arange(N_POINTS) + 0.5) * 2 * np.pi / N_POINTS
        at = np.interp(grid + 2 * np.pi * np.ceil(crank[0] / (2 * np.pi)), crank, t)
        h = 2e-6

        def read(function, delay):
            return function(at - delay), (function(at + h - delay) - function(at - h - delay)) / (2 * h)

        def true_force(time):
            return np.array([self.forces(a, w, m)[1] for _, w, a, m, *_ in exact(time).T])

        def force(time):
            if self.ring:
                return true_force(time) + self.ring_share * (exact(time)[5] - true_force(time))
            return exact(time)[5] if self.lag_force_s else true_force(time)

        def current(time):
            return exact(time)[4 if self.lag_current_s else 0]

        def battery_current(time):
            i = exact(time)[0]
            return self.duty * i + np.array([self.lost_current(self.duty, x) for x in i])

        def battery_voltage(time):
            return self.open_voltage - self.battery_resistance * self.duty * exact(time)[0]

        def crank_speed(time):
            return self.read_speed(exact(time)[2], exact(time)[1])

        can = late.get("can", 0.0)
        motor_s, battery_s = late.get("motor", can), late.get("battery", can)
        speed, acceleration = read(crank_speed, late.get("displacement", 0.0))
        i, i_rate = read(current, motor_s)
        f, f_rate = read(force, late.get("force", 0.0))
        voltage = battery_voltage(at - battery_s)
        rows = lambda wave: np.broadcast_to(wave, (n_units, N_POINTS))  # noqa: E731
        return make_state(
            self, angle_rad=rows(grid), speed_rad_s=rows(speed), acceleration_rad_s2=rows(acceleration),
            current_a=rows(i), current_rate_a_s=rows(i_rate), force_n=rows(f), force_rate_n_s=rows(f_rate),
            battery_voltage_v=rows(voltage), battery_current_a=rows(battery_current(at - battery_s)),
            motor_voltage_v=rows(self.duty * voltage),
        )  # fmt: skip


@lru_cache(maxsize=8)
def moved(machine: Machine):
    """State over time, from 80 rad/s on, interpolated: machines that move alike are integrated once."""
    return solve_ivp(
        machine.rhs, (0.0, END_S), [5.0, 80.0, 0.0, 0.0, 5.0, 0.0, 0.0], rtol=1e-8, atol=1e-8, max_step=5e-4,
        dense_output=True,
    ).sol  # fmt: skip


def make_state(machine: Machine, **waves) -> State:
    n_units = len(waves["angle_rad"])
    column = np.ones((n_units, 1))
    setting = TrialSetting(
        label="t", index=0, duty=machine.duty, is_idle=not machine.cuts, stock="oak", feed_m_s=0.004,
        thickness_m=0.02, operating_point="p", session_s=500.0,
    )  # fmt: skip
    held = {"motor_current_squared_a2": 120.0, "crank_speed_squared_rad2_s2": 8000.0, "battery_current_a": 4.0}
    return State(
        kind="running", setting=setting, time_s=column * [[2.0]], cut_distance_m=5.0 * column,
        charge_used_as=machine.charge_used_as * column, n_strokes=np.ones(n_units),
        slow={memory: held[memory.drive] * column for memory in MEMORIES},
        k_guess_n_s_per_m=K_CUT if machine.cuts else 0.0, peak_force_n=180.0,
        top_current_a=float(np.max(waves["current_a"])), **waves,
    )  # fmt: skip


def gap(state: State) -> dict:
    """Residuals less the expected force: what the baseline with the right k_Fc leaves."""
    found = residuals(BASELINE, state)
    return {**found, "cutting": found["cutting"] - BASELINE.expected_force(state)}


# Sizes below which a residual counts as none, in the unit of its equation.
SMALL = {"electrical": 2e-3, "mechanical": 5e-5, "cutting": 0.2, "supply": 1e-4, "converter": 1e-4}


def compare(seen: dict, claimed: dict, tolerance: float) -> None:
    n_compared = 0
    for equation, wave in seen.items():
        expected = claimed.get(equation, np.zeros_like(wave))
        error = np.sqrt(np.mean((wave - expected) ** 2))
        size = np.sqrt(np.mean(wave**2))
        assert error <= tolerance * size + SMALL[equation], (equation, error, size)
        n_compared += size > 5 * SMALL[equation]
    assert n_compared, "the simulated effect left no residual: the comparison says nothing"
