"""Tables of the periodic stroke over k_Fc and state of charge, so that a live estimate only interpolates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.config import BatteryConfig, ConverterConfig, PlantConfig
from sawbench.bench.errors import InputError
from sawbench.modeling.configured_battery import open_circuit_voltage
from sawbench.modeling.periodic_cycle import COLUMNS, PLANT_NAMES, CuttingHalf, periodic_cycles

Floats = NDArray[np.float64]
K_GRID: Final = np.concatenate([[0.0], np.geomspace(10.0, 2000.0, 40)])
N_SOC: Final = 25


@dataclass(frozen=True, kw_only=True, slots=True)
class StrokeTables:
    """What a live estimate looks up.

    Attributes
    ----------
    torque_constant, gear_ratio, damping, radius_m : float
    raw_k : ndarray, shape (n_k,)
        k_Fc that the mean torques alone would give for `K_GRID`.
    soc : ndarray, shape (n_soc,) or None
        From the cut-off to 1.
    battery_current_a, battery_voltage_v : ndarray, shape (n_k, n_soc) or None
        Mean of a stroke; the voltage is that at the terminals.
    remaining_s : ndarray, shape (n_k, n_soc) or None
        Runtime from each state of charge to the cut-off, by charge or by voltage; below 0 beyond it.
    capacity_a_s : float or None
    """

    torque_constant: float
    gear_ratio: float
    damping: float
    radius_m: float
    raw_k: Floats
    soc: Floats | None = None
    battery_current_a: Floats | None = None
    battery_voltage_v: Floats | None = None
    remaining_s: Floats | None = None
    capacity_a_s: float | None = None

    def from_current(self, mean_current_a: float, period_s: float) -> float:
        """k_Fc from the time means of one stroke, N*s/m."""
        speed = 2.0 * np.pi / period_s
        raw = _from_torques(mean_current_a, speed, self.torque_constant, self.gear_ratio, self.damping, self.radius_m)
        return float(np.interp(raw, self.raw_k, K_GRID)) if raw > self.raw_k[0] else float(raw - self.raw_k[0])

    def damping_share(self, k_fc: float) -> float:
        """Torque of the motor's damping over the torque of the cut."""
        cutting = 0.25 * max(k_fc, 1e-3) * self.radius_m**2
        return self.damping * self.gear_ratio**2 / cutting

    def battery_current(self, k_fc: float, soc: float) -> float:
        """Mean battery current, A."""
        return self._look_up(self.battery_current_a, k_fc, soc)

    def battery_voltage(self, k_fc: float, soc: float) -> float:
        """Mean voltage at the battery's terminals, V."""
        return self._look_up(self.battery_voltage_v, k_fc, soc)

    def remaining(self, k_fc: float, soc: float) -> float:
        """Runtime from `soc` to the cut-off, s; 0 beyond it."""
        return max(self._look_up(self.remaining_s, k_fc, soc), 0.0)

    def _look_up(self, table: Floats | None, k_fc: float, soc: float) -> float:
        if table is None or self.soc is None:
            raise InputError("there is no battery, so there is no runtime")
        k_fc = min(max(k_fc, K_GRID[0]), K_GRID[-1])
        n = min(int(np.searchsorted(K_GRID, k_fc, side="right")) - 1, len(K_GRID) - 2)
        share = (k_fc - K_GRID[n]) / (K_GRID[n + 1] - K_GRID[n])
        low, high = np.interp(soc, self.soc, table[n]), np.interp(soc, self.soc, table[n + 1])
        return float(low + share * (high - low))


def _from_torques(current_a, speed_rad_s, torque_constant, gear_ratio, damping, radius_m):
    torque = gear_ratio * (torque_constant * current_a - damping * gear_ratio * speed_rad_s)
    return 4.0 * torque / (radius_m**2 * speed_rad_s)


def stroke_tables(
    plant: PlantConfig,
    *,
    battery: BatteryConfig | None = None,
    converter: ConverterConfig | None = None,
    duty: float | None = None,
    cutting_half: CuttingHalf = "pi_to_2pi",
) -> StrokeTables:
    """Solve the periodic stroke on a grid of k_Fc and state of charge.

    Without a battery only the current's correction is tabulated, at half the 18 V of the paper's tool: it
    depends on the voltage by less than 0.1 %.

    Raises
    ------
    InputError
        If there is a battery but neither a duty nor a held voltage.
    """
    held_v = None
    if converter is not None and converter.mode == "held_voltage":
        held_v = converter.voltage_v
    soc, open_v, voltage_v, source_ohm = _supply(battery, held_v, duty)
    current_a, speed_rad_s = _grid_means(plant, voltage_v, source_ohm, cutting_half)
    raw_k = _from_torques(
        current_a[:, -1],
        speed_rad_s[:, -1],
        plant.torque_constant_n_m_per_a.nominal,
        plant.gear_ratio,
        plant.motor_damping_n_m_s_per_rad.nominal,
        plant.crank_radius_m.nominal,
    )
    base = StrokeTables(
        torque_constant=plant.torque_constant_n_m_per_a.nominal,
        gear_ratio=plant.gear_ratio,
        damping=plant.motor_damping_n_m_s_per_rad.nominal,
        radius_m=plant.crank_radius_m.nominal,
        raw_k=raw_k,
        soc=soc,
    )
    if battery is None:
        return base
    if held_v is not None:
        power_w = held_v * current_a
        drawn_a = (
            2.0
            * power_w
            / (open_v + np.sqrt(np.maximum(open_v**2 - 4.0 * battery.internal_resistance_ohm * power_w, 0.0)))
        )
    else:
        assert duty is not None  # `_supply` refuses a battery without
        drawn_a = duty * current_a
    return with_draw(base, battery, drawn_a, open_v - battery.internal_resistance_ohm * drawn_a)


def with_draw(tables: StrokeTables, battery: BatteryConfig, drawn_a: Floats, voltage_v: Floats) -> StrokeTables:
    """Return the tables with a battery current and the runtime that follows from it.

    Parameters
    ----------
    tables : StrokeTables
        With states of charge.
    battery : BatteryConfig
    drawn_a, voltage_v : ndarray, shape (n_k, n_soc)
        Mean battery current, and voltage at the terminals.
    """
    assert tables.soc is not None
    capacity_a_s = 3600.0 * battery.capacity_ah
    remaining_s = _runtime(tables.soc, drawn_a, capacity_a_s)
    if battery.cutoff_voltage_v is not None:
        # On the way down from full the first crossing counts.
        lowest_yet = np.minimum.accumulate(voltage_v[:, ::-1], axis=1)[:, ::-1]
        ends = [np.interp(battery.cutoff_voltage_v, volts, tables.soc) for volts in lowest_yet]
        beyond_s = [np.interp(end, tables.soc, row) for end, row in zip(ends, remaining_s, strict=True)]
        remaining_s = remaining_s - np.array(beyond_s)[:, None]
    return replace(
        tables,
        battery_current_a=drawn_a,
        battery_voltage_v=voltage_v,
        remaining_s=remaining_s,
        capacity_a_s=capacity_a_s,
    )


def _supply(
    battery: BatteryConfig | None, held_v: float | None, duty: float | None
) -> tuple[Floats | None, Floats, Floats, float]:
    """States of charge, open-circuit voltage, motor voltage, and battery resistance as the motor sees it."""
    if battery is not None and held_v is None and duty is None:
        raise InputError(
            "the remaining runtime needs the duty",
            remedy="give the duty, or [converter] mode = 'held_voltage'",
        )
    if battery is None:
        soc, open_v, resistance_ohm = None, np.array([9.0]), 0.0
    else:
        soc = np.linspace(battery.cutoff_soc, 1.0, N_SOC)
        open_v = open_circuit_voltage(battery, soc)
        resistance_ohm = battery.internal_resistance_ohm
    if held_v is not None:
        return soc, open_v, np.full_like(open_v, held_v), 0.0
    ratio = 1.0 if duty is None else duty
    return soc, open_v, ratio * open_v, ratio**2 * resistance_ohm


def _grid_means(
    plant: PlantConfig, voltage_v: Floats, source_ohm: float, cutting_half: CuttingHalf
) -> tuple[Floats, Floats]:
    """Time means of current and speed, shape (n_k, n_voltages)."""
    k, u = np.meshgrid(K_GRID, voltage_v, indexing="ij")
    values = {name: np.full(k.size, getattr(plant, name).nominal) for name in PLANT_NAMES}
    values["resistance_ohm"] = values["resistance_ohm"] + source_ohm
    values |= {"k_fc_n_s_per_m": k.ravel(), "voltage_v": u.ravel()}
    current_a, speed, is_valid = periodic_cycles(
        np.column_stack([values[name] for name in COLUMNS]),
        gear_ratio=plant.gear_ratio,
        cutting_half=cutting_half,
        rod_length_m=plant.rod_length_m if plant.mechanism == "slider_crank" else None,
    )
    if not is_valid.all():
        worst = int(np.argmin(is_valid))
        raise InputError(
            f"the model has no steady stroke at k_Fc = {k.ravel()[worst]:.0f} N*s/m and {u.ravel()[worst]:.2f} V",
            remedy="check [plant], the duty and the battery voltage",
        )
    pace = 1.0 / speed
    mean_current = (current_a * pace).mean(axis=1) / pace.mean(axis=1)
    return mean_current.reshape(k.shape), (1.0 / pace.mean(axis=1)).reshape(k.shape)


def _runtime(soc: Floats, drawn_a: Floats, capacity_a_s: float) -> Floats:
    """Integral of Q dSOC / i_b from the cut-off up, by a cubic through the nodes."""
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(soc, capacity_a_s / drawn_a, axis=1).antiderivative()(soc))
