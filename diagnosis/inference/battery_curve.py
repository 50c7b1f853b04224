"""The open-circuit curve that a battery has of its own, beside that of the configuration.

Eq. 16 is nearly flat where the voltage of real cells falls. Where a campaign used the charge, its voltage tells the
curve. Nothing tells it beyond: there it runs parallel to the configured one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from sawbench.bench.config import BatteryConfig
from sawbench.bench.recording import Floats
from sawbench.modeling.configured_battery import open_circuit_voltage
from sawbench.modeling.state import State

_AS_PER_AH: Final = 3600.0
# Deviation of the open-circuit voltage over the share of the charge that was used, 1 for one volt of each. What a full
# cell has in surplus is gone by anything up to a tenth of the charge: scales a factor of three apart.
SHAPES: Final[Mapping[str, Callable[[Floats], Floats]]] = MappingProxyType(
    {
        "open_circuit_voltage_slope_v": lambda q: q,
        "open_circuit_voltage_bend_v": lambda q: q**2,
        "open_circuit_voltage_surplus_1_v": lambda q: np.exp(-q / 0.003),
        "open_circuit_voltage_surplus_2_v": lambda q: np.exp(-q / 0.01),
        "open_circuit_voltage_surplus_3_v": lambda q: np.exp(-q / 0.03),
        "open_circuit_voltage_surplus_4_v": lambda q: np.exp(-q / 0.1),
    }
)
# Charge used at which the curve is written down: close together where it bends, full and empty.
_USED: Final = np.concatenate(
    [[0.0, 0.002, 0.005, 0.01, 0.02, 0.03, 0.045, 0.06, 0.08], np.arange(0.1, 0.91, 0.05), [0.95, 0.98, 0.99, 1.0]]
)
_LEAST_RISE: Final = 1e-6


def deviation(name: str, battery: BatteryConfig, charge_used_as: Floats) -> Floats:
    """Open-circuit voltage of one shape, V for one volt of it, in the shape of `charge_used_as`."""
    return SHAPES[name](charge_used_as / (_AS_PER_AH * battery.capacity_ah))


@dataclass(frozen=True, kw_only=True, slots=True)
class SeenCurve:
    """A battery's own curve as far as a campaign saw it, and parallel to the configured one beyond.

    Attributes
    ----------
    most_used_as : float
        Charge that the campaign used at most of one battery, A*s.
    """

    most_used_as: float

    @classmethod
    def of(cls, states: Sequence[State]) -> SeenCurve:
        """See how far the trials of a campaign used a battery."""
        return cls(most_used_as=max((float(np.max(s.charge_used_as)) for s in states), default=0.0))

    def within(self, state: State) -> State:
        """Return the state at which the shapes of the curve are to be taken."""
        return replace(state, charge_used_as=np.minimum(state.charge_used_as, self.most_used_as))

    def table(
        self, nominal: BatteryConfig, retuned: Mapping[str, Any], deviations_v: Mapping[str, float]
    ) -> dict[str, Any]:
        """Table `[battery]` that holds the curve.

        Parameters
        ----------
        nominal : BatteryConfig
            Of the configuration that the shapes belong to.
        retuned : mapping
            Table `[battery]` with the numbers that were re-tuned.
        deviations_v : mapping of str to float
            By shape, V.

        Returns
        -------
        dict
            With `open_circuit` in place of Eq. 16; its `nominal_voltage_v` is that of a full battery.
        """
        battery = BatteryConfig.model_validate(dict(retuned))
        used_as = _AS_PER_AH * battery.capacity_ah * _USED
        volts = open_circuit_voltage(battery, 1.0 - _USED)
        for name, size_v in deviations_v.items():
            volts = volts + size_v * deviation(name, nominal, np.minimum(used_as, self.most_used_as))
        share = volts[::-1] / volts[0]
        # A table rises with the charge.
        rise = _LEAST_RISE * np.arange(len(share))
        share = np.maximum.accumulate(np.maximum(share, 0.0) - rise) + rise
        found = {key: value for key, value in retuned.items() if key not in ("beta", "shape_ratio")}
        return {
            **found,
            "nominal_voltage_v": float(f"{volts[0] * share[-1]:.6g}"),
            "open_circuit": {
                "soc": [float(f"{soc:.6g}") for soc in 1.0 - _USED[::-1]],
                "share": [float(f"{one:.9g}") for one in share / share[-1]],
            },
        }
