"""The number by which a report states an effect, as the generator's form of the effect has it.

Names and units are those of the contract. An effect is left out where its form here has no such number; why, and
what counts as the true value of each, is said in docs/blind_check.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from sawbench.blindcheck.drawing import CampaignDraw
from sawbench.blindcheck.dynamics import FIELDS
from sawbench.blindcheck.plant import Floats, PlantSettings, parameter_record
from sawbench.blindcheck.sensors import zero_drift

# Where the catalogue's numbers are read off the curves of nature.
_DIODE_A, _LOSS_A, _LOSS_DUTY = 10.0, 10.0, 0.5
_RUB_M_S, _CUT_M_S, _WEAR_M, _DRIFT_S = 0.5, 0.7, 10.0, 1000.0
_COPPER_PER_K, _FLUX_PER_K = 3.9e-3, 1.5e-3


@dataclass(frozen=True, kw_only=True, slots=True)
class Reported:
    """One reported number.

    Attributes
    ----------
    name, unit : str
        As in the gap report.
    value : callable
        (fields of the plant's record by name, draw of the campaign) -> true value, in `unit`.
    absent : float
        The number where there is no such effect.
    """

    name: str
    unit: str
    value: Callable[[Mapping[str, float], CampaignDraw], float]
    absent: float = 0.0


def true_parameters(draw: CampaignDraw) -> dict[str, dict[str, Any]]:
    """Return the true value of the reported number of every hidden effect that has one.

    Returns
    -------
    dict of str to dict
        By effect: `name`, `value` and `unit`.

    Examples
    --------
    >>> from sawbench.blindcheck.drawing import draw_campaign
    >>> true_parameters(draw_campaign(3, effects={"yoke_backlash": 2.0}))
    {'yoke_backlash': {'name': 'gap_m', 'value': 0.0005, 'unit': 'm'}}
    """
    extras = dict(draw.change.shape) | dict(draw.change.plant)
    settings = PlantSettings(**dict(draw.parameters), extras=extras)  # type: ignore[arg-type]
    record = parameter_record(settings)[0]
    fields = {name: float(record[name]) for name in FIELDS}
    return {
        effect: {"name": one.name, "value": float(one.value(fields, draw)), "unit": one.unit}
        for effect in draw.effects
        if (one := REPORTED.get(effect)) is not None
    }


def _eccentric_torque(p: Mapping[str, float], _: CampaignDraw) -> float:
    """Return the part of a (exp(0.7 cos) - I_0) / 0.75 that swings once a turn: 2 a I_1(0.7) / 0.75."""
    from scipy.special import iv

    return float(p["mesh_torque"] * 2.0 * iv(1, 0.7) / 0.75)


def _brush_voltage(p: Mapping[str, float], draw: CampaignDraw) -> float:
    current = draw.working_current_a
    return p["brush_v"] * (1.0 - np.exp(-current / 0.7)) * (1.0 + 0.05 * np.log1p(current))


def _converter_loss(p: Mapping[str, float], _: CampaignDraw) -> float:
    lost_w = p["switch_v"] * _LOSS_A + p["switch_ohm"] * _LOSS_A**2 + p["idle_w"]
    return lost_w / p["v_nominal"] / (_LOSS_DUTY * _LOSS_A)


def _rubbing(p: Mapping[str, float], _: CampaignDraw) -> float:
    mid_stroke = 0.7 + 0.3 * 0.5
    return p["rub_n"] * (1.0 - np.exp(-_RUB_M_S / 0.12)) * mid_stroke / _RUB_M_S


def _chip_exponent(p: Mapping[str, float], _: CampaignDraw) -> float:
    """Return d ln k / d ln h at the chip thickness where the factor is near 1."""
    levelled = 1.0 / np.sqrt(1.0 + 1.0 / 2.2**2)
    size = p["chip_share"] * p["chip_ref_mm"] / (p["chip_ref_mm"] + p["chip_edge_mm"])
    return size * levelled**3 / (1.0 + size * (levelled - 1.0))


def _tooth_depth(p: Mapping[str, float], _: CampaignDraw) -> float:
    """Return the fundamental of the rounded sawtooth, whose series is sum q^n sin(n u) / n."""
    return p["tooth_depth"] * p["tooth_sharpness"] / np.arcsin(p["tooth_sharpness"])


def _delay(_: Mapping[str, float], draw: CampaignDraw) -> float:
    middle_s = 0.5 * float(np.median([plan.seconds for plan in draw.trials]))
    return draw.sensors.late_s + draw.sensors.late_drift * middle_s


def _drift(_: Mapping[str, float], draw: CampaignDraw) -> float:
    first_s = draw.trials[0].rest_s
    zero_n: Floats = zero_drift(np.array([0.0, _DRIFT_S]), first_s, draw.sensors, [draw.session_seed])
    return float(zero_n[1] - zero_n[0])


_NUMBERS: dict[str, Reported] = {
    "guide_friction": Reported(name="force_n", unit="N", value=lambda p, _: p["guide_n"]),
    "motor_coulomb_friction": Reported(name="torque_n_m", unit="N*m", value=lambda p, _: p["brush_friction"]),
    "windage_drag": Reported(name="torque_at_1000_rad_s_n_m", unit="N*m", value=lambda p, _: p["windage"]),
    "load_dependent_friction": Reported(name="friction_share", unit="1", value=lambda p, _: p["mesh_mu"]),
    "yoke_backlash": Reported(name="gap_m", unit="m", value=lambda p, _: p["gap_m"]),
    "gear_eccentricity": Reported(name="torque_n_m", unit="N*m", value=_eccentric_torque),
    "winding_heating": Reported(
        name="thermal_resistance_k_per_w", unit="K/W",
        value=lambda p, _: (p["r_wind_house"] + p["r_house_air"]) * p["copper_per_k"] / _COPPER_PER_K,
    ),
    # For little warming: the loss grows by 1 + 0.003 T with the temperature rise T, which differs from trial to trial.
    "magnet_weakening": Reported(
        name="thermal_resistance_k_per_w", unit="K/W",
        value=lambda p, _: p["r_house_air"] * p["magnet_per_k"] / _FLUX_PER_K,
    ),
    "blade_compliance": Reported(name="stiffness_n_per_m", unit="N/m", value=lambda p, _: p["blade_n_m"]),
    "return_stroke_rubbing": Reported(name="damping_n_s_per_m", unit="N*s/m", value=_rubbing),
    "tooth_passing_ripple": Reported(name="depth", unit="1", value=_tooth_depth),
    "cutting_speed_exponent": Reported(
        name="exponent", unit="1", value=lambda p, _: 1.0 / (1.0 + _CUT_M_S * p["inv_knee_s_m"]), absent=1.0
    ),
    "edge_force": Reported(name="force_n", unit="N", value=lambda p, _: p["edge_n"]),
    "chip_thickness": Reported(name="exponent", unit="1", value=_chip_exponent),
    "blade_wear": Reported(
        name="growth_per_10_m", unit="1", value=lambda p, _: p["wear_per_m"] * _WEAR_M ** p["wear_power"]
    ),
    "grain_variation": Reported(name="depth", unit="1", value=lambda p, _: np.sqrt(2.0) * p["grain_depth"]),
    "engagement_delay": Reported(name="fraction", unit="1", value=lambda p, _: p["delay_share"]),
    "brush_voltage_drop": Reported(name="voltage_v", unit="V", value=_brush_voltage),
    "converter_diode_drop": Reported(
        name="forward_voltage_v", unit="V", value=lambda p, _: p["diode_v"] + p["diode_ohm"] * _DIODE_A
    ),
    "converter_loss": Reported(name="loss_share", unit="1", value=_converter_loss),
    "battery_internal_resistance": Reported(
        name="extra_resistance_ohm", unit="Ohm", value=lambda p, _: p["extra_ohm"]
    ),
    "battery_polarization": Reported(
        name="polarization_resistance_ohm", unit="Ohm", value=lambda p, _: p["polar_fast_ohm"] + p["polar_slow_ohm"]
    ),
    "carriage_resonance": Reported(
        name="frequency_hz", unit="Hz", value=lambda _, draw: draw.sensors.carriage_hz[0]
    ),
    "force_sensor_lag": Reported(name="time_constant_s", unit="s", value=lambda _, draw: draw.sensors.force_lag_s),
    "current_sensor_lag": Reported(
        name="time_constant_s", unit="s", value=lambda _, draw: draw.sensors.current_lag_s
    ),
    "clock_offset": Reported(name="delay_s", unit="s", value=_delay),
    "force_offset_drift": Reported(name="drift_n_per_1000_s", unit="N", value=_drift),
}  # fmt: skip
REPORTED: Mapping[str, Reported] = MappingProxyType(_NUMBERS)
