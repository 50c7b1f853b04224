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


def simulated_cycle(
    loaded: LoadedConfig, k_fc_n_s_per_m: float, duty: float | None, *, n_points: int = 256
) -> dict[str, Any]:
    """One settled stroke of the model over the crank angle, to lay over a measured one.

    Returns
    -------
    dict
        `angle_rad`, `force_n`, `motor_current_a`, each of shape (n_points,).
    """
    import numpy as np

    from modeling.transient import simulate

    run = simulate(
        parameters_of(loaded),
        supply=supply_of(loaded, duty),
        cutting=cutting_of(loaded, k_fc_n_s_per_m),
        duration_s=1.5,
        rate_hz=20_000.0,
    )
    turns = run.crank_angle_rad / (2.0 * np.pi)
    last = np.floor(turns[-1]) - 1.0
    angle = (np.arange(n_points) + 0.5) * 2.0 * np.pi / n_points
    at = 2.0 * np.pi * last + angle
    return {
        "angle_rad": angle,
        "force_n": np.interp(at, run.crank_angle_rad, run.force_n),
        "motor_current_a": np.interp(at, run.crank_angle_rad, run.motor_current_a),
    }
