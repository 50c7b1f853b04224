"""How the voltage of real cells goes with the charge used, in the first third of it.

V / V_full = 1 + the shapes of `SHAPES`, each with its coefficient, over the charge used, at constant current.
`SETTINGS.sensors.battery_curve` lets the curve of a configured battery be off by that, as Eq. 16 is nearly flat there.
Then, how far the voltage later in the discharge is missed by a flat curve, by one that was fitted to the first part and
held from there (`SeenCurve`), and by that fit continued.

python -m benchmarks.battery_curve --cells DIR
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from sawbench.diagnosis.inference.battery_curve import SHAPES
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.measured_discharge import MeasuredDischarge

from benchmarks.battery_cells import read_cells

CAPACITY_AS = 5.0 * 3600.0
# The current settles, and the battery of a campaign is hardly used beyond.
FIRST, LAST = 0.002, 0.35
# Of the voltage: a battery's within a campaign; and points that a fit of the shapes needs no more of.
NOISE, N_FITTED, N_EVEN = 1e-3, 60, 200


def used_of(discharge: MeasuredDischarge) -> np.ndarray:
    """Charge used over the capacity, at every sample."""
    step_as = 0.5 * np.diff(discharge.time_s) * np.abs(discharge.current_a[1:] + discharge.current_a[:-1])
    return np.concatenate([[0.0], np.cumsum(step_as)]) / CAPACITY_AS


def shapes_of(used: np.ndarray) -> np.ndarray:
    """The level, and every shape of `SHAPES`, shape (n, 1 + len(SHAPES))."""
    return np.column_stack([np.ones_like(used), *(shape(used) for shape in SHAPES.values())])


def curve_of(discharge: MeasuredDischarge) -> np.ndarray:
    """Coefficients of one discharge, relative to the voltage of the full cell, and what they leave of it."""
    used = used_of(discharge)
    inside = (used > FIRST) & (used < LAST)
    q = used[inside]
    even = np.linspace(q[0], q[-1], N_EVEN)
    volts = np.interp(even, q, discharge.voltage_v[inside])
    volts /= volts[0]
    design = shapes_of(even)
    level, *shape = np.linalg.lstsq(design, volts, rcond=None)[0]
    return np.array([*shape, np.std(volts - design @ np.array([level, *shape]))]) / level


def missed(discharge: MeasuredDischarge, seen: float, later: float) -> np.ndarray:
    """Relative miss of the voltage at `later` of the charge: flat, held, continued; fitted up to `seen` of it."""
    used = used_of(discharge)
    inside = np.flatnonzero((used > FIRST) & (used < seen))
    inside = inside[:: max(len(inside) // N_FITTED, 1)]
    volts = discharge.voltage_v / discharge.voltage_v[inside[0]]
    prior = np.array([1.0, *SETTINGS.sensors.battery_curve.values()])
    design = shapes_of(used[inside]) * prior
    normal = design.T @ design / NOISE**2 + np.eye(len(prior))
    found = prior * np.linalg.solve(normal, design.T @ (volts[inside] - 1.0) / NOISE**2)
    held, continued = 1.0 + shapes_of(np.array([seen, later * used[-1]])) @ found
    return np.array([volts[inside].mean(), held, continued]) - np.interp(later * used[-1], used, volts)


def words(numbers: np.ndarray) -> str:
    """Coefficients by shape; last what the shapes leave of the voltage."""
    names = [name.removeprefix("open_circuit_voltage_").removesuffix("_v") for name in SHAPES]
    return (
        ", ".join(f"{name} {number:.3f}" for name, number in zip(names, numbers, strict=False))
        + f"; left {numbers[-1]:.2%}"
    )


def main() -> None:
    """Print the curve of every discharge, the root mean square of each number, and that of what is missed later."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=Path, required=True, help="folder of the LG M50 rate tests")
    found = []
    cells = read_cells(parser.parse_args().cells)
    for temperature, rates in cells.items():
        for rate, discharge in rates.items():
            found.append(curve_of(discharge))
            print(f"{temperature} degC, {rate}: {words(found[-1])}")
    print(f"root mean square: {words(np.sqrt(np.mean(np.square(found), axis=0)))}")
    discharges = [discharge for rates in cells.values() for discharge in rates.values()]
    for seen in (0.03, 0.06, 0.12, 0.25):
        for later in (0.3, 0.5, 0.75):
            errors = [missed(d, seen, later) for d in discharges if later * used_of(d)[-1] > seen]
            flat, held, continued = 100.0 * np.sqrt(np.mean(np.square(errors), axis=0))
            print(
                f"fitted to {seen:.0%} of the charge, at {later:.0%} of the discharge:"
                f" flat {flat:.1f} %, held {held:.1f} %, continued {continued:.1f} %"
            )


if __name__ == "__main__":
    main()
