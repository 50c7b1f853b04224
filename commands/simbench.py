"""`sawbench simbench`: the simulated instruments, in a process and on ports of their own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from sawbench.bench.units import CHANNEL_BY_NAME, Channel
from sawbench.commands.options import bench_config_option, refuse_unwritable

if TYPE_CHECKING:
    from sawbench.bench.config import BatteryConfig, LoadedConfig
    from sawbench.blindcheck.settings import PlantSettings

# Which [plant] key of the configuration is which setting of the simulated plant: the same names.
_PLANT_KEYS = (
    "resistance_ohm",
    "inductance_h",
    "back_emf_constant_v_s_per_rad",
    "torque_constant_n_m_per_a",
    "rotor_inertia_kg_m2",
    "yoke_inertia_kg_m2",
    "reciprocating_mass_kg",
    "crank_radius_m",
    "motor_damping_n_m_s_per_rad",
)
_BATTERY_KEYS = ("nominal_voltage_v", "capacity_ah", "internal_resistance_ohm")
_LARGEST_DEVIATION = 2.0
# The battery management switches off.
_EMPTY_AT = 0.95


@click.command(name="simbench", epilog="Example: sawbench simbench --material oak --seed 3")
@bench_config_option
@click.option("--material", default="oak", show_default=True, help="A material of the simulated bench, or none (air).")
@click.option("--duty", type=click.FloatRange(0, 1, min_open=True), help="PWM duty; default: the configuration's.")
@click.option("--seed", default=0, show_default=True, help="Seed of the true plant, the wood and the sensor noise.")
@click.option(
    "--trigger-after", default=1.0, show_default=True, help="Time from the start of streaming to switching on, s."
)
@click.option("--transport", type=click.Choice(["auto", "pty", "tcp"]), default="auto", show_default=True)
@click.option("--load", "load_text", metavar="CHANNEL=VALUE", help="A known load or displacement added at a sensor.")
@click.option(
    "--drawn-ah", type=click.FloatRange(min=0.0), default=0.0, help="Charge drawn from the battery before, Ah."
)
@click.option(
    "--truth", "truth_path", type=click.Path(path_type=Path, dir_okay=False),
    help="Write the true values to this file; recordings never contain them.",
)  # fmt: skip
def command(
    config_path: Path | None,
    material: str,
    duty: float | None,
    seed: int,
    trigger_after: float,
    transport: str,
    load_text: str | None,
    drawn_ah: float,
    truth_path: Path | None,
) -> None:
    """Emulate the instruments of the configuration and print their ports as one line of JSON.

    The plant behind them is not exactly the nominal one: its parameters are drawn from the stated
    uncertainties. It runs until standard input closes, or until Ctrl-C.
    """
    import json

    from sawbench.acquisition.simulation.bench_server import run_bench
    from sawbench.acquisition.simulation.held_load import HeldLoad
    from sawbench.blindcheck.streaming import StreamingPlant
    from sawbench.inputs import config_for
    from sawbench.storage.output import write_whole

    loaded = config_for(None, config_path)
    if loaded.config.effects:
        names = ", ".join(loaded.config.effects)
        click.echo(
            f"{loaded.path}: the simulated bench does not simulate the [effects] {names}: they are ignored", err=True
        )
    settings = true_settings(loaded, material=material, duty=duty, seed=seed, drawn_ah=drawn_ah)
    if truth_path is not None:
        refuse_unwritable(truth_path, force=False)
        write_whole(truth_path, json.dumps(truth_of(settings), indent=2) + "\n")
    plant = StreamingPlant(settings)
    run_bench(
        plant if load_text is None else HeldLoad(plant, *load_of(load_text, loaded.config.known_channels)),
        loaded.config,
        transport=transport,  # type: ignore[arg-type]
        trigger_after_s=trigger_after,
        clock_error_ppm={name: 20.0 * (-1) ** k for k, name in enumerate(loaded.config.devices)},
    )


def load_of(text: str, channels: Mapping[str, Channel] = CHANNEL_BY_NAME) -> tuple[str, float]:
    """Read `CHANNEL=VALUE`; `channels` are those of the bench.

    Raises
    ------
    InputError
        If it is something else.

    Examples
    --------
    >>> load_of("force_n=50")
    ('force_n', 50.0)
    """
    from sawbench.bench.errors import InputError

    channel, _, value = text.partition("=")
    try:
        load = float(value)
    except ValueError:
        load = float("nan")
    if channel not in channels or not abs(load) < float("inf"):
        raise InputError(f"--load is {text!r}, expected CHANNEL=VALUE", remedy=f"channels are {', '.join(channels)}")
    return channel, load


def true_settings(
    loaded: LoadedConfig, *, material: str, duty: float | None, seed: int, drawn_ah: float = 0.0
) -> PlantSettings:
    """Draw the plant of the simulated bench from the nominal values and their stated uncertainties.

    Parameters
    ----------
    loaded : LoadedConfig
    material : str
    duty : float, optional
    seed : int
        Seed 0 is a plant like any other, not the nominal one.
    drawn_ah : float
        Charge drawn from the battery before, Ah.

    Raises
    ------
    InputError
        If there is no such material, or the battery is empty.
    """
    import numpy as np
    from sawbench.bench.errors import InputError
    from sawbench.blindcheck.settings import MATERIALS, PlantSettings

    if material not in MATERIALS:
        raise InputError(
            f"the simulated bench has no material {material!r}",
            remedy=f"choose one of {', '.join(MATERIALS)}",
        )
    plant, battery = loaded.plant(), loaded.battery()
    if drawn_ah >= _EMPTY_AT * battery.capacity_ah:
        raise InputError(
            f"the simulated battery is empty: {drawn_ah:.2f} Ah drawn of {battery.capacity_ah:g} Ah",
            remedy="insert another one (--battery, or another identifier in the plan)",
        )
    # The tool is the same whatever it cuts: its draw does not depend on the material or the trial.
    rng = np.random.default_rng(20250815)
    drawn = {}
    for key in _PLANT_KEYS:
        value = getattr(plant, key)
        deviation = float(np.clip(rng.standard_normal(), -_LARGEST_DEVIATION, _LARGEST_DEVIATION))
        drawn[key] = value.nominal * (1.0 + value.rel_std * deviation)
    return PlantSettings.for_material(
        material,
        **drawn,
        **{key: getattr(battery, key) for key in _BATTERY_KEYS},
        **_open_circuit(battery),
        gear_ratio=plant.gear_ratio,
        rod_length_m=plant.rod_length_m if plant.mechanism == "slider_crank" else None,
        cutting_half=loaded.config.cutting.cutting_half,
        duty=loaded.config.converter.default_duty if duty is None else duty,
        initial_soc=1.0 - drawn_ah / battery.capacity_ah,
        seed=seed,
    )


def _open_circuit(battery: BatteryConfig) -> dict[str, Any]:
    """Eq. 16 as the paper has it, else the curve at even states of charge."""
    import numpy as np
    from sawbench.blindcheck.dynamics import N_OPEN_CIRCUIT
    from sawbench.modeling.configured_battery import open_circuit_voltage

    if battery.open_circuit is None and battery.shape_ratio == 1.0:
        return {"beta": battery.beta}
    curve = open_circuit_voltage(battery, np.linspace(0.0, 1.0, N_OPEN_CIRCUIT))
    return {"open_circuit_v": tuple(curve.tolist())}


def truth_of(settings: PlantSettings) -> dict[str, float | str]:
    """Plain values of the settings, for the truth file."""
    import dataclasses

    return {
        field.name: getattr(settings, field.name)
        for field in dataclasses.fields(settings)
        if isinstance(getattr(settings, field.name), float | int | str)
    }
