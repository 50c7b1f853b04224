"""The channels every part of sawbench agrees on: name, unit, what it measures.

The names are those of the trial tables (`campaign.toml`), of the MCAP topics and of the gap report.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, kw_only=True, slots=True)
class Channel:
    """One measured quantity.

    Attributes
    ----------
    name : str
        Identifier; ends in the unit it is stored in.
    unit : str
        Unit of the stored values (UCUM-like short form).
    label : str
        Words for a plot axis.
    si_factor : float
        Stored value times this factor is the value in SI units.
    plausible : tuple of float
        Lowest and highest value, in `unit`, that a jigsaw bench can produce; outside of it the channel
        is probably swapped or in another unit.
    """

    name: str
    unit: str
    label: str
    si_factor: float = 1.0
    plausible: tuple[float, float]


FORCE: Final = Channel(name="force_n", unit="N", label="cutting force", plausible=(-5000.0, 5000.0))
DISPLACEMENT: Final = Channel(
    name="displacement_mm", unit="mm", label="blade displacement", si_factor=1e-3, plausible=(-200.0, 200.0)
)
MOTOR_CURRENT: Final = Channel(name="motor_current_a", unit="A", label="motor current", plausible=(-200.0, 200.0))
BATTERY_VOLTAGE: Final = Channel(name="battery_voltage_v", unit="V", label="battery voltage", plausible=(0.0, 100.0))
BATTERY_CURRENT: Final = Channel(name="battery_current_a", unit="A", label="battery current", plausible=(-200.0, 200.0))
# They follow from each other, and are read by different sensors.
ELECTRICAL: Final = (MOTOR_CURRENT.name, BATTERY_VOLTAGE.name, BATTERY_CURRENT.name)

CHANNELS: Final[tuple[Channel, ...]] = (
    FORCE,
    DISPLACEMENT,
    MOTOR_CURRENT,
    BATTERY_VOLTAGE,
    BATTERY_CURRENT,
)
CHANNEL_BY_NAME: Final = {channel.name: channel for channel in CHANNELS}
TIME_COLUMN: Final = "time_s"
