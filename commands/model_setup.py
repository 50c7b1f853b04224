"""From the configuration to the parts of the model: parameters, supply, cutting force."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bench.errors import InputError

if TYPE_CHECKING:
    from bench.config import LoadedConfig
    from commands.analysis import AnalysedTrial
    from modeling.cutting_forces.linear import LinearCutting
    from modeling.parameters import JigsawParameters
    from modeling.results import CuttingFit


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

    return LinearCutting(k_fc_n_s_per_m=k_fc_n_s_per_m, cutting_half=loaded.config.cutting.cutting_half)


def fitted_cycle(trial: AnalysedTrial, fit: CuttingFit, *, n_points: int = 256) -> dict[str, Any]:
    """One settled stroke of the fitted model as the sensors would show it, to lay over the measured one.

    Plant constants, sensor gains, the force's zero and the angle's zero are those of the fit; the motor gets
    the measured battery voltage, as in the fit. What the fit did not estimate keeps its nominal value.

    Parameters
    ----------
    trial : AnalysedTrial
    fit : CuttingFit
    n_points : int

    Returns
    -------
    dict
        `angle_rad`, `force_n`, `motor_current_a`, each of shape (n_points,).
    """
    import numpy as np

    from commands.analysis import measured_cycles
    from modeling.cycle_observation import drive_of
    from modeling.periodic_cycle import PLANT_NAMES
    from modeling.supplies import FixedVoltage
    from modeling.transient import simulate

    config = trial.loaded.config
    known = {} if fit.estimates is None else dict(zip(fit.estimates.names, fit.estimates.values, strict=True))
    parameters = parameters_of(trial.loaded)
    own = {name: float(known[name]) for name in PLANT_NAMES if name in known}
    drive = drive_of(measured_cycles(trial), config.battery, config.converter)
    own["resistance_ohm"] = own.get("resistance_ohm", parameters.resistance_ohm) + drive.source_resistance_ohm
    run = simulate(
        parameters.replace(**own),
        supply=FixedVoltage(voltage_v=drive.voltage_v / known.get("voltage_gain", 1.0)),
        cutting=cutting_of(trial.loaded, fit.k_fc_n_s_per_m),
        duration_s=1.5,
        rate_hz=20_000.0,
    )
    # The last whole turn but one, as an angle sensor sees it whose zero is off by `angle_zero_rad`.
    n_turns = np.floor(run.crank_angle_rad[-1] / (2.0 * np.pi))
    angle = (np.arange(n_points) + 0.5) * 2.0 * np.pi / n_points
    at = 2.0 * np.pi * (n_turns - 2.0) + angle - known.get("angle_zero_rad", 0.0)
    force_n = np.interp(at, run.crank_angle_rad, run.force_n)
    current_a = np.interp(at, run.crank_angle_rad, run.motor_current_a)
    return {
        "angle_rad": angle,
        "force_n": known.get("force_gain", 1.0) * force_n + known.get("force_offset_n", 0.0),
        "motor_current_a": known.get("current_gain", 1.0) * current_a,
    }
