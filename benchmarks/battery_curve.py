"""How the voltage of real cells goes with the charge used, in the first third of it.

V / V_full = 1 + slope q + bend q^2 + surplus exp(-q / 0.03), q the charge used over the capacity, at constant current.
`SETTINGS.sensors.battery_curve` lets the curve of a configured battery be off by that, as Eq. 16 is nearly flat there.

python -m benchmarks.battery_curve --cells DIR
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from sawbench.diagnosis.inference.nuisances import SURPLUS_GONE_BY
from sawbench.modeling.measured_discharge import MeasuredDischarge

from benchmarks.battery_cells import read_cells

CAPACITY_AS = 5.0 * 3600.0
# The current settles, and the battery of a campaign is hardly used beyond.
FIRST, LAST = 0.002, 0.35


def curve_of(discharge: MeasuredDischarge) -> np.ndarray:
    """Slope, bend and surplus of one discharge, relative to the voltage of the full cell."""
    step_as = 0.5 * np.diff(discharge.time_s) * np.abs(discharge.current_a[1:] + discharge.current_a[:-1])
    used = np.concatenate([[0.0], np.cumsum(step_as)]) / CAPACITY_AS
    inside = (used > FIRST) & (used < LAST)
    q = used[inside]
    design = np.column_stack([np.ones_like(q), q, q**2, np.exp(-q / SURPLUS_GONE_BY)])
    level, *shape = np.linalg.lstsq(design, discharge.voltage_v[inside], rcond=None)[0]
    return np.array(shape) / level


def main() -> None:
    """Print the curve of every discharge, and the root mean square of each number."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=Path, required=True, help="folder of the LG M50 rate tests")
    found = []
    for temperature, rates in read_cells(parser.parse_args().cells).items():
        for rate, discharge in rates.items():
            found.append(curve_of(discharge))
            slope, bend, surplus = found[-1]
            print(f"{temperature} degC, {rate}: slope {slope:.3f}, bend {bend:.3f}, surplus {surplus:.4f}")
    slope, bend, surplus = np.sqrt(np.mean(np.square(found), axis=0))
    print(f"root mean square: slope {slope:.2f}, bend {bend:.2f}, surplus {surplus:.3f}")


if __name__ == "__main__":
    main()
