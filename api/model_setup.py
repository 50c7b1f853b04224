"""From the configuration to the parts of the model: parameters, supply, cutting force."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sawbench.bench.errors import InputError

if TYPE_CHECKING:
    from sawbench.bench.config import BenchConfig, LoadedConfig
    from sawbench.bench.recording import Floats
    from sawbench.modeling.configured_battery import AnyBattery
    from sawbench.modeling.effect_transient import EffectRun
    from sawbench.modeling.parameters import JigsawParameters
    from sawbench.modeling.parts.linear import LinearCutting
    from sawbench.modeling.trajectory import Trajectory
    from sawbench.modeling.transient import InitialState

_MOST_SAMPLES = 1e7


def parameters_of(loaded: LoadedConfig) -> JigsawParameters:
    """Plant parameters at their nominal values."""
    from sawbench.modeling.parameters import JigsawParameters

    return JigsawParameters.from_config(loaded.plant())


def battery_of(loaded: LoadedConfig) -> AnyBattery:
    """The battery of the configuration."""
    from sawbench.modeling.configured_battery import battery_from_config

    return battery_from_config(loaded.battery())


def supply_of(loaded: LoadedConfig, duty: float | None) -> Any:
    """Fixed duty or held voltage, as the configuration says.

    Parameters
    ----------
    loaded : LoadedConfig
    duty : float, optional
        The trial's duty; default: the configuration's.
    """
    from sawbench.modeling.supplies import FixedDuty, HeldVoltage

    converter = loaded.config.converter
    if converter.mode == "held_voltage":
        if converter.voltage_v is None:
            raise InputError("[converter] mode held_voltage needs voltage_v", where=loaded.path)
        return HeldVoltage(voltage_v=converter.voltage_v, battery=battery_of(loaded))
    return FixedDuty(duty=converter.default_duty if duty is None else duty, battery=battery_of(loaded))


def cutting_of(loaded: LoadedConfig, k_fc_n_s_per_m: float) -> LinearCutting:
    """The linear cutting force on the configured half."""
    from sawbench.modeling.parts.linear import LinearCutting

    return LinearCutting(k_fc_n_s_per_m=k_fc_n_s_per_m, cutting_half=loaded.config.cutting.cutting_half)


def simulated_run(
    loaded: LoadedConfig,
    *,
    k_fc_n_s_per_m: float,
    duty: float | None,
    duration_s: float,
    rate_hz: float,
    initial: InitialState,
    compiles: bool = True,
) -> Trajectory | EffectRun:
    """Run the configured model from rest, with its known effects; see `sawbench.modeling.transient.simulate`.

    Raises
    ------
    InputError
        If more samples are asked for than are allowed, or an effect cannot be simulated in time.
    """
    from sawbench.modeling.machines.saw_baseline import baseline_of
    from sawbench.modeling.transient import sample_times, simulate

    if duration_s * rate_hz > _MOST_SAMPLES:
        raise InputError(
            f"{duration_s:g} s at {rate_hz:g} Hz are {duration_s * rate_hz:.2g} samples, at most"
            f" {_MOST_SAMPLES:.0e} are allowed",
            remedy="use a shorter time or a lower rate",
        )
    baseline = baseline_of(loaded)
    if baseline.known:
        from sawbench.modeling.effect_transient import simulate_with_effects
        from sawbench.modeling.operating_point import OperatingPoint

        supply = supply_of(loaded, duty)
        point = OperatingPoint(
            k_fc_n_s_per_m=k_fc_n_s_per_m,
            duty=getattr(supply, "duty", None),
            held_voltage_v=getattr(supply, "voltage_v", None),
        )
        return simulate_with_effects(baseline, point, sample_times(duration_s, rate_hz, None), initial=initial)
    return simulate(
        parameters_of(loaded),
        supply=supply_of(loaded, duty),
        cutting=cutting_of(loaded, k_fc_n_s_per_m),
        duration_s=duration_s,
        rate_hz=rate_hz,
        initial=initial,
        compiles=compiles,
    )


def bench_channels(run: Trajectory | EffectRun, config: BenchConfig) -> dict[str, Floats]:
    """What the bench would measure of a run: channel name -> values, shape (n,), in the unit of the name."""
    true = {
        "force_n": run.force_n,
        "displacement_mm": 1e3 * run.displacement_m,
        "motor_current_a": run.motor_current_a,
        "battery_voltage_v": run.battery_voltage_v,
        "battery_current_a": run.battery_current_a,
    }
    sensors = config.sensors
    return {name: sensors[name].reading(values) if name in sensors else values for name, values in true.items()}
