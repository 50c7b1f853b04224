"""The battery that a configuration describes: Eq. 16, or a table of its open-circuit voltage."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from sawbench.modeling.parts import eq16, ocv_table
from sawbench.modeling.parts.eq16 import Eq16Battery
from sawbench.modeling.parts.ocv_table import TableBattery

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray
    from sawbench.bench.config import BatteryConfig

AnyBattery = Eq16Battery | TableBattery


def battery_from_config(config: BatteryConfig) -> AnyBattery:
    """Return the battery of a `[battery]` table."""
    if config.open_circuit is None:
        return Eq16Battery.from_config(config)
    share = _share_table(config.open_circuit.soc, config.open_circuit.share)
    return TableBattery(
        soc=share.soc,
        ocv_v=config.nominal_voltage_v * share.ocv_v,
        capacity_ah=config.capacity_ah,
        internal_resistance_ohm=config.internal_resistance_ohm,
    )


def open_circuit_voltage(config: BatteryConfig, soc: ArrayLike) -> NDArray[np.float64]:
    """Open-circuit voltage of a `[battery]` table at states of charge (0..1), V, in the shape of `soc`."""
    at = np.asarray(soc, dtype=np.float64)
    if config.open_circuit is None:
        return eq16.voltage.py_func(config.nominal_voltage_v, config.beta, 1.0 - (1.0 - at) / config.shape_ratio)[0]
    pieces = _share_table(config.open_circuit.soc, config.open_circuit.share).ocv_table()
    return config.nominal_voltage_v * ocv_table.voltage.py_func(pieces, at)[0]


@lru_cache(maxsize=8)
def _share_table(soc: tuple[float, ...], share: tuple[float, ...]) -> TableBattery:
    """Table of a battery of 1 V and 1 Ah: its spline is made once."""
    return TableBattery(soc=np.array(soc), ocv_v=np.array(share), capacity_ah=1.0)
