"""From the configuration to the parts of the model: parameters, supply, cutting force."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bench.errors import InputError

if TYPE_CHECKING:
    from bench.config import LoadedConfig
    from modeling.cutting_forces.linear import LinearCutting
    from modeling.parameters import JigsawParameters


def parameters_of(loaded: LoadedConfig) -> JigsawParameters:
    """Plant parameters at their nominal values."""
    from modeling.parameters import JigsawParameters

    return JigsawParameters.from_config(loaded.plant())


def battery_of(loaded: LoadedConfig) -> Any:
    """The battery of Eq. 16."""
    from modeling.batteries.eq16 import Eq16Battery

    return Eq16Battery.from_config(loaded.battery())


def supply_of(loaded: LoadedConfig, duty: float | None) -> Any:
    """Fixed duty or held voltage, as the configuration says.

    Parameters
    ----------
    loaded : LoadedConfig
    duty : float, optional
        The trial's duty; default: the configuration's.
    """
    from modeling.supplies import FixedDuty, HeldVoltage

    converter = loaded.config.converter
    if converter.mode == "held_voltage":
        if converter.voltage_v is None:
            raise InputError("[converter] mode held_voltage needs voltage_v", where=loaded.path)
        return HeldVoltage(voltage_v=converter.voltage_v, battery=battery_of(loaded))
    return FixedDuty(duty=converter.default_duty if duty is None else duty, battery=battery_of(loaded))


def cutting_of(loaded: LoadedConfig, k_fc_n_s_per_m: float) -> LinearCutting:
    """The linear cutting force on the configured half."""
    from modeling.cutting_forces.linear import LinearCutting

    return LinearCutting(
        k_fc_n_s_per_m=k_fc_n_s_per_m, cutting_half=loaded.config.cutting.cutting_half
    )
