"""What a campaign may hide: for every effect its magnitude at severity 1 and what it draws.

`CATALOGUE` are effects of the catalogue that the product is to name, under its ids; `UNLISTED` are effects that no
catalogue lists, to be called unknown. Magnitudes at severity 1 are those of the catalogue. An effect of severity 0
changes nothing. `cogging_torque` of the catalogue is left out: between the slots of these motors it lies at some 600 Hz
and leaves 0.1 mA in the current, which no instrument shows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

import numpy as np

from benchmarks.independent_bench import instruments, plans
from benchmarks.independent_bench import parameters as parts
from benchmarks.independent_bench.benches import Bench, Rings
from benchmarks.independent_bench.instruments import Instruments, SensorErrors
from benchmarks.independent_bench.parameters import Plant
from benchmarks.independent_bench.plans import Plan

_TURN = 2.0 * math.pi


@dataclass(frozen=True, kw_only=True, slots=True)
class Setting:
    """What of the campaign the magnitude of an effect refers to.

    Attributes
    ----------
    cutting_speed_m_s : float
        0.8 of the largest speed of the blade under load.
    chip_mm : float
        Feed per stroke under load, mean of the feeds.
    peak_torque_n_m : float
        Largest load at the motor.
    current_a : float
        Of the motor under load.
    inrush_a : float
        Of the motor when it is switched on at the highest duty.
    devices : tuple of str
    """

    cutting_speed_m_s: float
    chip_mm: float
    peak_torque_n_m: float
    current_a: float
    inrush_a: float
    devices: tuple[str, ...]


def setting_of(bench: Bench, plan: Plan, measured_by: Instruments) -> Setting:
    """Work out what magnitudes refer to, from the reference wood at the middle duty."""
    machine, crank_speed = bench.machine, bench.crank_speed_rad_s
    peak_n = bench.reference_coefficient_n_s_per_m * machine.crank_radius_m * crank_speed
    peak_torque_n_m = peak_n * machine.crank_radius_m / machine.gear_ratio
    return Setting(
        cutting_speed_m_s=0.8 * machine.crank_radius_m * crank_speed,
        chip_mm=float(np.mean(plan.feeds_mm_s)) / (crank_speed / _TURN),
        peak_torque_n_m=peak_torque_n_m,
        current_a=1.15 * peak_torque_n_m / 4.0 / machine.torque_constant_n_m_per_a,
        inrush_a=0.72 * plan.top_duty * bench.battery.nominal_voltage_v / machine.resistance_ohm,
        devices=tuple(measured_by.devices),
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class Change:
    """What an effect draws.

    Attributes
    ----------
    plant : mapping of str to NamedTuple
        Groups of `Plant` that take the place of those that are switched off.
    sensors : mapping of str to float or str
        Fields of `SensorErrors`.
    rings : Rings
    number : tuple of str and float, optional
        Name and true value of the number that a gap report states of this effect, where both mean the same: the form
        here has this number as a plain parameter. None elsewhere.
    note : str
        What the severity alone does not say.
    """

    plant: Mapping[str, NamedTuple] = field(default_factory=dict)
    sensors: Mapping[str, Any] = field(default_factory=dict)
    rings: Rings = field(default_factory=Rings)
    number: tuple[str, float] | None = None
    note: str = ""


_Draw = Callable[[float, np.random.Generator, Setting], Change]


@dataclass(frozen=True, kw_only=True, slots=True)
class Effect:
    """Row of the table.

    Attributes
    ----------
    equation : str
        Where it acts; two effects of a pair act in different equations. Empty for one that no catalogue lists.
    at_one : str
        Magnitude at severity 1.
    draw : callable
        Of severity, generator and setting.
    asks : frozenset of str
        What plan and instruments must have for it to be seen.
    highest : float
        Severity that is not exceeded.
    """

    equation: str
    at_one: str
    draw: _Draw
    asks: frozenset[str] = frozenset()
    highest: float = 2.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Hidden:
    """Everything that the effects of a campaign change.

    Attributes
    ----------
    plant : Plant
        Of the intact bench, with the groups of the effects.
    sensors : SensorErrors
    rings : Rings
    numbers : dict of str to dict
        By effect: name and true value, see `Change.number`.
    notes : tuple of str
    """

    plant: Plant
    sensors: SensorErrors = field(default_factory=SensorErrors)
    rings: Rings = field(default_factory=Rings)
    numbers: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def hide(effects: Mapping[str, float], intact: Plant, rng: np.random.Generator, setting: Setting) -> Hidden:
    """Draw what the effects change, by their severities."""
    hidden = Hidden(plant=intact)
    for name, severity in effects.items():
        change = EFFECTS[name].draw(severity, rng, setting)
        number = {} if change.number is None else {name: dict([change.number])}
        hidden = Hidden(
            plant=hidden.plant._replace(**change.plant),
            sensors=replace(hidden.sensors, **change.sensors),
            rings=change.rings if change.rings.depth > 0.0 else hidden.rings,
            numbers={**hidden.numbers, **number},
            notes=(*hidden.notes, *([f"{name}: {change.note}"] if change.note else [])),
        )
    return hidden


# ---- mechanical


def _guide_friction(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    guide = parts.GuideFriction(
        force_n=5.0 * severity,
        static_ratio=rng.uniform(1.25, 1.6),
        stribeck_m_s=rng.uniform(0.04, 0.1),
        asymmetry=rng.uniform(-0.1, 0.1),
    )
    return Change(plant={"guide": guide}, number=("force_n", guide.force_n))


def _motor_coulomb_friction(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    friction = parts.MotorFriction(
        torque_n_m=0.005 * severity, static_share=rng.uniform(0.2, 0.5), stribeck_rad_s=rng.uniform(40.0, 90.0)
    )
    return Change(plant={"friction": friction}, number=("torque_n_m", friction.torque_n_m))


def _windage_drag(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    windage = parts.Windage(torque_n_m=0.006 * severity, exponent=rng.uniform(1.75, 2.15))
    return Change(
        plant={"windage": windage},
        number=("torque_at_1000_rad_s_n_m", windage.torque_n_m),
        note=f"torque over speed to the power of {windage.exponent:.2f}",
    )


def _load_dependent_friction(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    at_pin = float(rng.choice([0.0, 0.3]))
    friction = parts.LoadFriction(mesh_share=0.08 * severity * (1.0 - at_pin), pin_share=0.16 * severity * at_pin)
    note = f"mesh friction of the whole torque, that of the masses included; {at_pin:.0%} of it at the pin"
    return Change(plant={"load_friction": friction}, note=note)


def _yoke_backlash(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    play = parts.Play(gap_m=2.5e-4 * severity, stiffness_n_per_m=rng.uniform(1e6, 2e6))
    return Change(plant={"play": play}, number=("gap_m", play.gap_m))


def _gear_eccentricity(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    eccentricity = parts.Eccentricity(
        torque_n_m=0.003 * severity,
        phase_rad=rng.uniform(0.0, _TURN),
        second_share=rng.uniform(0.05, 0.25),
        second_phase_rad=rng.uniform(0.0, _TURN),
    )
    return Change(plant={"eccentricity": eccentricity}, number=("torque_n_m", eccentricity.torque_n_m))


# ---- cutting


def _blade_compliance(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    blade = parts.Blade(compliance_m_per_n=severity / 2.33e5, hardening_per_m=rng.uniform(0.0, 200.0))
    return Change(plant={"blade": blade}, note=f"stiffness 2.33e5 N/m / {severity:.2f}, growing with deflection")


def _return_stroke_rubbing(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    viscous = rng.uniform(0.3, 1.0)
    rubbing = parts.Rubbing(
        damping_n_s_per_m=25.0 * severity * viscous,
        exponent=rng.uniform(0.6, 1.0),
        dry_n=17.5 * severity * (1.0 - viscous),
    )
    return Change(plant={"rubbing": rubbing}, note=f"{viscous:.0%} viscous, the rest dry")


def _tooth_passing_ripple(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    teeth = parts.Teeth(
        depth=0.15 * severity,
        pitch_m=rng.uniform(0.002, 0.004),
        phase_rad=rng.uniform(0.0, _TURN),
        second_share=rng.uniform(0.1, 0.35),
    )
    return Change(plant={"teeth": teeth}, number=("depth", teeth.depth), note=f"pitch {1e3 * teeth.pitch_m:.1f} mm")


def _cutting_speed_exponent(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    reference_m_s = setting.cutting_speed_m_s
    if rng.random() < 0.5:
        law = parts.SpeedLaw(exponent=0.632**severity, reference_m_s=reference_m_s)
        number = ("exponent", law.exponent)
        return Change(plant={"law": law}, number=number, note=f"exponent {law.exponent:.3f}, rounded at zero")
    law = parts.SpeedLaw(logarithm=math.expm1(1.9 * severity), reference_m_s=reference_m_s)
    return Change(plant={"law": law}, note=f"logarithm of 1 + {law.logarithm:.2f} v / {reference_m_s:.2f} m/s")


def _edge_force(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    edge = parts.Edge(force_n=40.0 * severity, speed_m_s=rng.uniform(0.015, 0.06))
    return Change(plant={"edge": edge}, number=("force_n", edge.force_n))


def _chip_thickness(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    floor = rng.uniform(0.0, 0.15)
    chip = parts.Chip(exponent=0.6 * severity, reference_mm=setting.chip_mm, floor_mm=floor * setting.chip_mm)
    return Change(plant={"chip": chip}, note=f"exponent {chip.exponent:.2f} on h + {floor:.2f} of the usual h")


def _blade_wear(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    wear = parts.Wear(
        growth_per_10_m=0.1 * severity, break_in_share=rng.uniform(0.0, 0.8), break_in_m=rng.uniform(12.0, 25.0)
    )
    return Change(plant={"wear": wear}, note=f"{wear.break_in_share:.0%} of it saturates over {wear.break_in_m:.0f} m")


def _grain_variation(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    rings = Rings(depth=0.12 * severity, spacing_mm=rng.uniform(2.0, 8.0))
    note = f"rings of wandering spacing, {rings.spacing_mm:.1f} mm on average"
    return Change(rings=rings, number=("depth", rings.depth), note=note)


def _engagement_delay(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    engagement = parts.Engagement(fraction=0.16 * severity, width_m=rng.uniform(1.5e-4, 5e-4))
    return Change(plant={"engagement": engagement}, number=("fraction", engagement.fraction))


# ---- electrical


def _winding_heating(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    fast = rng.uniform(0.55, 0.8)
    heating = parts.Heating(
        fast_k_per_w=4.0 * severity * fast,
        fast_s=rng.uniform(20.0, 50.0),
        slow_k_per_w=4.0 * severity * (1.0 - fast),
        slow_s=rng.uniform(200.0, 500.0),
    )
    note = f"two nodes: {fast:.0%} within {heating.fast_s:.0f} s, the rest within {heating.slow_s:.0f} s"
    return Change(plant={"heating": heating}, note=note)


def _magnet_weakening(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    magnets = parts.Magnets(heating_k_per_w=3.0 * severity, time_s=rng.uniform(50.0, 150.0))
    return Change(plant={"magnets": magnets}, note=f"one node, {magnets.time_s:.0f} s")


def _brush_voltage_drop(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    brushes = parts.Brushes(voltage_v=0.8 * severity, scale_a=rng.uniform(0.4, 1.2), growth=rng.uniform(0.0, 0.1))
    return Change(plant={"brushes": brushes})


def _converter_diode_drop(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    return Change(plant={"diode": parts.Diode(voltage_v=0.7 * severity)})


def _current_limit(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    if severity <= 0.0:
        return Change()
    limiter = parts.Limiter(
        current_a=(0.85 - 0.15 * severity) * setting.inrush_a,
        gain_per_a=rng.uniform(0.03, 0.1),
        lag_s=rng.uniform(0.002, 0.006),
    )
    return Change(plant={"limiter": limiter}, note=f"soft limit above {limiter.current_a:.1f} A, with a lag")


# ---- supply


def _converter_loss(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    linear = rng.uniform(0.5, 0.9)
    converter = parts.Converter(
        loss_share=0.08 * severity, linear=linear, square=0.7 * (1.0 - linear), quiescent_a=1.2 * (1.0 - linear)
    )
    note = f"{linear:.0%} with the current, the rest with its square and a quiescent current"
    return Change(plant={"converter": converter}, note=note)


def _battery_internal_resistance(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    extra = parts.ExtraResistance(resistance_ohm=0.04 * severity, growth=rng.uniform(0.0, 0.8))
    return Change(plant={"extra_resistance": extra}, number=("extra_resistance_ohm", extra.resistance_ohm))


def _battery_polarization(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    fast = rng.uniform(0.5, 0.8)
    polarization = parts.Polarization(
        fast_ohm=0.04 * severity * fast,
        fast_s=rng.uniform(1.5, 8.0),
        slow_ohm=0.04 * severity * (1.0 - fast),
        slow_s=rng.uniform(25.0, 60.0),
    )
    note = f"two relaxations: {fast:.0%} of {polarization.fast_s:.1f} s, the rest of {polarization.slow_s:.0f} s"
    return Change(plant={"polarization": polarization}, note=note)


# ---- sensing


def _carriage_resonance(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    errors = {"ringing_period_s": severity / 153.0, "ringing_damping": rng.uniform(0.04, 0.12)}
    number = ("frequency_hz", 153.0 / severity) if severity > 0.0 else None
    return Change(sensors=errors, number=number, note=f"damping {errors['ringing_damping']:.2f}")


def _preload_lift_off(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    return Change(sensors={"preload_share": 1.0 - 0.13 * severity if severity > 0.0 else 0.0})


def _force_sensor_lag(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    errors = {"force_delay_s": 1.39e-3 * severity, "force_damping": rng.uniform(0.75, 1.1)}
    return Change(sensors=errors, number=("time_constant_s", errors["force_delay_s"]), note="second order")


def _current_sensor_lag(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    errors = {"current_delay_s": 1.39e-3 * severity, "current_damping": rng.uniform(0.75, 1.1)}
    return Change(sensors=errors, number=("time_constant_s", errors["current_delay_s"]), note="second order")


def _clock_offset(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    errors = {"late_device": str(rng.choice(setting.devices)), "late_s": 1.58e-3 * severity}
    return Change(sensors=errors, number=("delay_s", errors["late_s"]), note=f"late: {errors['late_device']}")


def _force_offset_drift(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    rate = 4.0 * severity * float(rng.choice([-1.0, 1.0]))
    errors = {"drift_n_per_1000_s": rate, "drift_time_s": rng.uniform(500.0, 1500.0)}
    return Change(sensors=errors, note=f"exponential, {errors['drift_time_s']:.0f} s")


# ---- effects that no catalogue lists


def _belt_slip(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    return Change(plant={"slip": parts.Slip(share=0.05 * severity, torque_n_m=setting.peak_torque_n_m)})


def _end_of_stroke_spring(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    return Change(plant={"bumper": parts.Bumper(stiffness_n_per_m15=2e6 * severity)})


def _motor_mount_resonance(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    if severity <= 0.0:
        return Change()
    inertia, frequency_hz, damping = 8e-5, rng.uniform(24.0, 40.0), 0.06 / severity
    rate = _TURN * frequency_hz
    mount = parts.Mount(
        inertia_kg_m2=inertia,
        stiffness_n_m_per_rad=inertia * rate**2,
        damping_n_m_s_per_rad=2.0 * damping * inertia * rate,
    )
    return Change(plant={"mount": mount}, note=f"{frequency_hz:.0f} Hz, damping {damping:.3f}")


def _armature_reaction(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    return Change(plant={"armature": parts.Armature(share=0.06 * severity, current_a=setting.current_a)})


def _chip_packing(severity: float, rng: np.random.Generator, setting: Setting) -> Change:
    return Change(plant={"packing": parts.Packing(growth=0.22 * severity, time_s=rng.uniform(1.5, 3.0))})


def _row(equation: str, at_one: str, draw: _Draw, *asks: str, highest: float = 2.0) -> Effect:
    return Effect(equation=equation, at_one=at_one, draw=draw, asks=frozenset(asks), highest=highest)


_DUTIES, _FEEDS, _HEAT, _STARTS = plans.DUTIES, plans.FEEDS, plans.HEAT, plans.STARTS
_FORCE, _CAN = instruments.FAST_FORCE, instruments.FAST_CAN

CATALOGUE: Final[Mapping[str, Effect]] = {
    "winding_heating": _row("electrical", "4 K/W", _winding_heating, _HEAT),
    "magnet_weakening": _row("electrical", "3 K/W, 0.15 %/K", _magnet_weakening, _HEAT),
    "brush_voltage_drop": _row("electrical", "0.8 V", _brush_voltage_drop, _DUTIES),
    "converter_diode_drop": _row("electrical", "0.7 V at 10 A", _converter_diode_drop, _DUTIES),
    "current_limit": _row("electrical", "70 % of the inrush", _current_limit, _DUTIES),
    "guide_friction": _row("mechanical", "5 N", _guide_friction),
    "motor_coulomb_friction": _row("mechanical", "5 mN m", _motor_coulomb_friction, _DUTIES),
    "windage_drag": _row("mechanical", "6 mN m at 1000 rad/s", _windage_drag, _DUTIES),
    "load_dependent_friction": _row("mechanical", "8 % of the torque", _load_dependent_friction),
    "yoke_backlash": _row("mechanical", "0.25 mm", _yoke_backlash),
    "gear_eccentricity": _row("mechanical", "3 mN m", _gear_eccentricity),
    "blade_compliance": _row("cutting", "1 / (2.33e5 N/m)", _blade_compliance, _FORCE),
    "return_stroke_rubbing": _row("cutting", "25 N s/m", _return_stroke_rubbing),
    "tooth_passing_ripple": _row("cutting", "15 % of the force", _tooth_passing_ripple, _FORCE),
    "cutting_speed_exponent": _row("cutting", "exponent 0.632", _cutting_speed_exponent, _DUTIES),
    "edge_force": _row("cutting", "40 N", _edge_force),
    "chip_thickness": _row("cutting", "exponent 0.6", _chip_thickness, _FEEDS, highest=1.5),
    "blade_wear": _row("cutting", "10 % per 10 m", _blade_wear),
    "grain_variation": _row("cutting", "12 % of the force", _grain_variation, _FEEDS),
    "engagement_delay": _row("cutting", "16 % of the cutting half", _engagement_delay),
    "converter_loss": _row("supply", "8 %", _converter_loss),
    "battery_internal_resistance": _row("supply", "40 mOhm", _battery_internal_resistance),
    "battery_polarization": _row("supply", "40 mOhm", _battery_polarization, _HEAT),
    "carriage_resonance": _row("sensing", "153 Hz", _carriage_resonance, _FORCE),
    "preload_lift_off": _row("sensing", "at 87 % of the largest force", _preload_lift_off),
    "force_sensor_lag": _row("sensing", "1.39 ms", _force_sensor_lag, _FORCE),
    "current_sensor_lag": _row("sensing", "1.39 ms", _current_sensor_lag, _FORCE, _CAN),
    "clock_offset": _row("sensing", "1.58 ms", _clock_offset, _FORCE),
    "force_offset_drift": _row("sensing", "4 N in 1000 s", _force_offset_drift),
}
UNLISTED: Final[Mapping[str, Effect]] = {
    "belt_slip": _row("", "5 % at the usual peak torque", _belt_slip),
    "end_of_stroke_spring": _row("", "2e6 N/m^1.5 over the last 2.5 mm", _end_of_stroke_spring),
    "motor_mount_resonance": _row("", "damping ratio 0.06", _motor_mount_resonance),
    "armature_reaction": _row("", "6 % of the flux at the usual current", _armature_reaction),
    "chip_packing": _row("", "22 % within seconds of every cut", _chip_packing, _STARTS),
}
EFFECTS: Final[Mapping[str, Effect]] = {**CATALOGUE, **UNLISTED}
