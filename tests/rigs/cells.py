"""Discharges of a cell that no model of the package is made after: Shepherd's curve, a resistance and an RC pair.

    V = E0 - K Q / (Q - q) + A exp(-B q / Q) - R0 i - u,   du/dt = (R1 i - u) / tau

Source: Shepherd, J. Electrochem. Soc. 112 (1965) 657; Tremblay, Dessaint, World Electric Vehicle J. 3 (2009) 289.
"""

from __future__ import annotations

import numpy as np


def shepherd_discharge(
    current_a: float, *, capacity_ah: float = 2.0, start: float = 1.0, scale: float = 1.0, noise_v: float = 0.0,
    resistance_ohm: float = 0.02, cutoff_v: float = 3.0, seed: int = 0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Time (s), current (A) and voltage (V) of a discharge at a constant current down to the cut-off.

    `start` is the state of charge it starts from, `scale` multiplies the capacity. 2000 equal steps of a whole charge.
    """
    capacity_as = 3600.0 * capacity_ah * scale
    step_s = capacity_as / current_a / 2000.0
    rng = np.random.default_rng(seed)
    charge, slow_v, rows = (1.0 - start) * capacity_as, 0.0, []
    while charge < 0.9995 * capacity_as:
        left = 1.0 - charge / capacity_as
        open_v = 3.75 - 0.012 / left + 0.42 * np.exp(-3.5 * charge / capacity_as)
        voltage_v = open_v - resistance_ohm * current_a - slow_v
        rows.append((len(rows) * step_s, current_a, voltage_v + noise_v * rng.standard_normal()))
        if voltage_v <= cutoff_v:
            break
        charge += current_a * step_s
        slow_v += step_s / 40.0 * (0.01 * current_a - slow_v)
    time_s, current, voltage = np.array(rows).T
    return time_s, current, voltage
