"""What may be mistuned without anything being wrong with the model: parameters, gains, offsets, angle zero.

Each entry gives the change of the residuals for one unit of the parameter's error, and the standard
uncertainty the configuration (or the sensor class) grants it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.battery_curve import deviation
from sawbench.diagnosis.inference.beyond.bent_displacement import N_BEND_HARMONICS, bend_of_displacement
from sawbench.diagnosis.inference.nuisance import Nuisance, Reading, SignatureFunction
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.residuals import (
    Baseline,
    Signature,
    inertia_torque,
    is_angle_known,
    plunger_swing,
    residuals,
    summed,
)
from sawbench.modeling.state import TWO_PI, State, TrialSetting, angle_derivative

# Of the radius, for the derivative of a torque that is a smooth function of it.
_RADIUS_STEP = 1e-4
# Gains of amplifiers and of the reference of a converter, which warm up.
DRIFTING: Final = ("motor_current_gain", "force_gain", "battery_current_gain", "battery_voltage_gain")
# Zeros of current probes, which warm up too; that of the force has a nuisance of its own (`zero_wander`).
_DRIFTING_ZEROS: Final = ("motor_current_offset_a", "battery_current_offset_a")


def nuisances_of(baseline: Baseline) -> tuple[Nuisance, ...]:
    """List every nuisance that is shared by all trials of a campaign.

    Parameters
    ----------
    baseline : Baseline

    Returns
    -------
    tuple of Nuisance
    """
    return (
        *_plant_nuisances(baseline), *_battery_nuisances(baseline), *_sensor_nuisances(baseline), *_bend_nuisances(),
        *_reversal_nuisances(),
    )  # fmt: skip


def of_known(known: KnownEffect) -> Nuisance:
    """How far the magnitude of a known effect may be off, in standard uncertainties."""
    return Nuisance(name=known.name, std=1.0, signature=known.uncertainty)


def _plant_nuisances(baseline: Baseline) -> list[Nuisance]:
    plant, gear = baseline.plant, baseline.gear

    def motor_speed(state: State) -> Floats:
        return gear * state.speed_rad_s

    signatures: dict[str, SignatureFunction] = {
        # A larger true value than the nominal one leaves what the baseline did not subtract.
        "resistance_ohm": lambda _, s: _electrical(s.current_a, +1),
        "inductance_h": lambda _, s: _electrical(s.current_rate_a_s, +1),
        "back_emf_constant_v_s_per_rad": lambda _, s: {"electrical": motor_speed(s)},
        "torque_constant_n_m_per_a": _torque_constant_signature,
        "motor_damping_n_m_s_per_rad": lambda _, s: {"mechanical": motor_speed(s)},
        "rotor_inertia_kg_m2": lambda b, s: {"mechanical": inertia_torque(b, s, rotor=1.0)},
        "yoke_inertia_kg_m2": lambda b, s: {"mechanical": inertia_torque(b, s, yoke=1.0)},
        "reciprocating_mass_kg": lambda b, s: {"mechanical": inertia_torque(b, s, mass=1.0)},
        "crank_radius_m": _radius_signature,
    }
    return [
        Nuisance(
            name=name,
            nominal=getattr(plant, name).nominal,
            std=max(getattr(plant, name).std, 1e-3 * abs(getattr(plant, name).nominal)),
            is_plant=True,
            signature=signature,
        )
        for name, signature in signatures.items()
    ]


def _electrical(values: Floats | None, sign: int) -> Signature:
    return {} if values is None else {"electrical": sign * values}


def _torque_constant_signature(baseline: Baseline, state: State) -> Signature:
    """Current that the measured motion and force ask for, instead of the measured one.

    With the measured current, scaling every torque of the equation by the same factor would scale its residual,
    noise included, and the fit would always shrink them all. With this one that direction does nothing, as it
    must: an equation without a constant term says nothing of its scale.
    """
    residual = residuals(baseline, state).get("mechanical")
    if residual is None or state.current_a is None:
        return {}
    return {"mechanical": residual / baseline.plant.torque_constant_n_m_per_a.nominal - state.current_a}


def _radius_signature(baseline: Baseline, state: State) -> Signature:
    force_n = 0.0 if state.force_n is None else state.force_n
    mass_kg, step_m = baseline.plant.reciprocating_mass_kg.nominal, _RADIUS_STEP * baseline.radius_m

    def torque(radius_m: float) -> Floats:
        """At the crank, for plunger and blade force."""
        mechanism = replace(baseline.mechanism, radius_m=radius_m)
        load = baseline.cutting_sign * force_n * mechanism.lever(state.angle_rad)
        return mass_kg * plunger_swing(mechanism, state) + load

    rise = torque(baseline.radius_m + step_m) - torque(baseline.radius_m - step_m)
    return {"mechanical": rise / (2.0 * step_m * baseline.gear)}


def _battery_nuisances(baseline: Baseline) -> list[Nuisance]:
    """Numbers of the battery and deviations of its curve, in the balance in which its voltage stands."""
    return [replace(one, signature=_where_voltage_stands(one.signature)) for one in _of_supply(baseline)]


def _where_voltage_stands(of_supply: SignatureFunction) -> SignatureFunction:
    """In the motor's voltage where that of the battery was not measured, for it is the model's there."""

    def signature(baseline: Baseline, state: State) -> Signature:
        found = of_supply(baseline, state)
        if state.battery_voltage_v is not None or "supply" not in found:
            return found
        return {"electrical": -state.setting.duty * found["supply"]}

    return signature


def _of_supply(baseline: Baseline) -> list[Nuisance]:
    battery = baseline.battery
    if battery is None:
        return []
    rel_std = SETTINGS.sensors.battery_rel_std

    def by_capacity(b: Baseline, s: State) -> Signature:
        # With a larger capacity the voltage after a charge is that of the stated one after less of it.
        step = 1e-3
        rise = b.open_circuit_voltage(s.charge_used_as / (1.0 + step)) - b.open_circuit_voltage(s.charge_used_as)
        return {"supply": np.broadcast_to(rise / step / battery.capacity_ah, s.angle_rad.shape)}

    return [
        Nuisance(
            name="internal_resistance_ohm",
            nominal=battery.internal_resistance_ohm,
            std=max(rel_std["internal_resistance_ohm"] * battery.internal_resistance_ohm, 5e-4),
            is_plant=True,
            signature=_internal_resistance,
            is_effect=True,
        ),
        Nuisance(
            name="nominal_voltage_v",
            nominal=battery.nominal_voltage_v,
            std=rel_std["nominal_voltage_v"] * battery.nominal_voltage_v,
            is_plant=True,
            signature=lambda b, s: {
                "supply": np.broadcast_to(
                    b.open_circuit_voltage(s.charge_used_as) / battery.nominal_voltage_v, s.angle_rad.shape
                )
            },
        ),
        Nuisance(
            name="capacity_ah",
            nominal=battery.capacity_ah,
            std=rel_std["capacity_ah"] * battery.capacity_ah,
            is_plant=True,
            signature=by_capacity,
        ),
        *(
            Nuisance(
                name=name, std=share * battery.nominal_voltage_v,
                signature=partial(_open_circuit_curve, name=name), is_curve=True,
            )
            for name, share in SETTINGS.sensors.battery_curve.items()
        ),
    ]  # fmt: skip


def _internal_resistance(baseline: Baseline, state: State) -> Signature:
    """By the battery's current, and where that was not measured by the motor's."""
    del baseline
    if state.battery_current_a is not None:
        return {"supply": -state.battery_current_a}
    return {} if state.current_a is None else {"supply": -state.setting.duty * state.current_a}


def _open_circuit_curve(baseline: Baseline, state: State, name: str) -> Signature:
    """Open-circuit voltage that goes with the charge used as no curve of two numbers does."""
    assert baseline.battery is not None
    volts = deviation(name, baseline.battery, state.charge_used_as)
    return {"supply": np.broadcast_to(volts, state.angle_rad.shape)}


def further_batteries(baseline: Baseline, settings: Iterable[TrialSetting]) -> list[Nuisance]:
    """List what every battery after the first differs by from it: packs of one type are not alike.

    Parameters
    ----------
    baseline : Baseline
    settings : iterable of TrialSetting
        Of every trial.
    """
    further = sorted({setting.battery for setting in settings} - {0})
    return [_of_battery(nuisance, number) for number in further for nuisance in _battery_nuisances(baseline)]


def _of_battery(nuisance: Nuisance, number: int) -> Nuisance:
    def signature(baseline: Baseline, state: State) -> Signature:
        return nuisance.signature(baseline, state) if state.setting.battery == number else {}

    return replace(
        nuisance, name=f"{nuisance.name} of battery {number + 1}", nominal=0.0, std=float(np.sqrt(2.0)) * nuisance.std,
        is_plant=False, is_effect=False, signature=signature,
    )  # fmt: skip


def _reversal_nuisances() -> list[Nuisance]:
    """Force that is missing where the cut begins and where it ends: no law of cutting holds where the blade stands."""
    return [
        Nuisance(
            name=f"force at the {place} of the cut", std=1.0, signature=_missing_beside(is_start=place == "start"),
        )
        for place in ("start", "end")
    ]  # fmt: skip


def _missing_beside(*, is_start: bool) -> SignatureFunction:
    """All of the force within a few degrees of the dead centre at which the cutting half begins, or ends."""

    def signature(baseline: Baseline, state: State) -> Signature:
        if state.force_n is None or state.setting.is_idle:
            return {}
        since = np.mod(state.angle_rad - (0.0 if baseline.cutting_sign > 0 else np.pi), TWO_PI)
        away = (since if is_start else np.pi - since) / SETTINGS.workpieces.reversal_rad
        return {"cutting": np.where(away > 0.0, -baseline.expected_force(state) * np.exp(-(away**2)), 0.0)}

    return signature


def _bend_nuisances() -> list[Nuisance]:
    """A displacement that is not quite straight between its ends; what is far from straight is beyond the catalogue.

    A sensor by itself is bent to one side, which is the first harmonic, or as the letter S, which is the second: as
    far, and as often. Electronics that straighten it leave a curve that crosses zero a few times: its harmonics fall as
    1/k only.
    """
    falls = {order: 1.0 if order <= 2 else 1.0 / order for order in range(1, N_BEND_HARMONICS + 1)}
    return [
        Nuisance(
            name=f"displacement_bend_{order}_rad", std=order**2 * fall * SETTINGS.sensors.bend_std_rad,
            signature=lambda baseline, state, order=order: bend_of_displacement(baseline, state, order),
        )
        for order, fall in falls.items()
    ]  # fmt: skip


def _sensor_nuisances(baseline: Baseline) -> list[Nuisance]:
    """Gains, offsets and the angle's zero.

    The gain of what an equation is solved for enters with what the equation says, not with the reading: with the
    reading, a gain of -100 % would make every misfit vanish, and large misfits would be "explained" so. The zero of a
    current sensor is stated in shares of its range, which goes with the machine's currents.
    """
    gains: dict[str, SignatureFunction] = {
        "motor_current_gain": _motor_current_gain,
        "force_gain": _force_gain,
        "battery_current_gain": _battery_current_gain,
        "battery_voltage_gain": _battery_voltage_gain,
    }
    zeros: dict[str, SignatureFunction] = {
        "motor_current_offset_a": _motor_current_offset,
        "force_offset_n": force_offset,
        "battery_current_offset_a": _battery_current_offset,
        "battery_voltage_offset_v": _battery_voltage_offset,
    }
    sensors = SETTINGS.sensors
    zero_a = sensors.current_zero_share * baseline.usual_current_a
    stds = {name: max(std, zero_a) if name.endswith("_offset_a") else std for name, std in sensors.std.items()}

    def shared(name: str, signature: SignatureFunction) -> Nuisance:
        return Nuisance(name=name, std=stds[name], signature=signature, is_zero=name in zeros)

    return [
        *(shared(name, signature) for name, signature in {**gains, **zeros, "angle_zero_rad": angle_shift}.items()),
        *(
            Nuisance(
                name=warm_up_of(name, time_s), std=stds[name], signature=_warming({**gains, **zeros}[name], time_s),
            )
            for name in (*DRIFTING, *_DRIFTING_ZEROS)
            for time_s in sensors.drift_times_s
        ),
    ]  # fmt: skip


def warm_up_of(name: str, time_s: float) -> str:
    """Name of the nuisance for the change of a gain or a zero while its amplifier warms up with a time constant."""
    return f"{name}, warm-up over {time_s:g} s"


def still_to_warm_up(baseline: Baseline, at_s: Floats, time_s: float) -> Floats:
    """How far a gain or zero is from what it is at the end of the campaign, over what it is at the beginning.

    Parameters
    ----------
    baseline : Baseline
    at_s : ndarray, s
        From the beginning of the campaign.
    time_s : float
        Time constant with which the amplifier warms up.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> still_to_warm_up(SimpleNamespace(session_s=600.0), np.array([0.0, 600.0]), 600.0).tolist()
    [1.0, 0.0]
    """
    last = math.exp(-baseline.session_s / time_s)
    return (np.exp(-at_s / time_s) - last) / (1.0 - last)


def _warming(off: SignatureFunction, time_s: float) -> SignatureFunction:
    """Of a gain or zero that is off by one in the beginning and comes to its final value as the amplifier warms up."""

    def signature(baseline: Baseline, state: State) -> Signature:
        left = still_to_warm_up(baseline, state.setting.session_s + state.time_s, time_s)
        return {equation: left * wave for equation, wave in off(baseline, state).items()}

    return signature


def _motor_current_gain(baseline: Baseline, state: State) -> Signature:
    if state.current_a is None or state.current_rate_a_s is None:
        return {}
    plant = baseline.plant
    asked = _torque_constant_signature(baseline, state).get("mechanical", np.zeros(1))
    drop = plant.resistance_ohm.nominal * state.current_a + plant.inductance_h.nominal * state.current_rate_a_s
    return {
        "electrical": -drop,
        "mechanical": -plant.torque_constant_n_m_per_a.nominal * asked,
        "converter": -state.setting.duty * state.current_a,
    }


def _motor_current_offset(baseline: Baseline, state: State) -> Signature:
    ones = np.ones_like(state.angle_rad)
    return {
        "electrical": -baseline.plant.resistance_ohm.nominal * ones,
        "mechanical": baseline.plant.torque_constant_n_m_per_a.nominal * ones,
        "converter": -state.setting.duty * ones,
    }


def _motor_current_rate(baseline: Baseline, state: State) -> Signature:
    return {"electrical": -baseline.plant.inductance_h.nominal * np.ones_like(state.angle_rad)}


def _force_gain(baseline: Baseline, state: State) -> Signature:
    if state.force_n is None:
        return {}
    expected_n = baseline.expected_force(state)
    return {"mechanical": -baseline.load_torque(state, expected_n), "cutting": expected_n}


def force_offset(baseline: Baseline, state: State) -> Signature:
    """Change of the residuals for one newton on the zero of the force."""
    return force_reads(baseline, state, np.ones_like(state.angle_rad))


def force_reads(baseline: Baseline, state: State, too_much_n: Floats) -> Signature:
    """Change of the residuals where the reading of the force has a wave on it, N, of the state's shape."""
    return {"mechanical": -baseline.load_torque(state, too_much_n), "cutting": too_much_n}


def _battery_current_gain(baseline: Baseline, state: State) -> Signature:
    if state.battery_current_a is None or baseline.battery is None:
        return {}
    drop = baseline.battery.internal_resistance_ohm * state.battery_current_a
    drawn = state.battery_current_a if state.current_a is None else state.setting.duty * state.current_a
    return {"converter": drawn, "supply": drop}


def _battery_current_offset(baseline: Baseline, state: State) -> Signature:
    ones = np.ones_like(state.angle_rad)
    if baseline.battery is None:
        return {"converter": ones}
    return {"converter": ones, "supply": baseline.battery.internal_resistance_ohm * ones}


def _battery_voltage_gain(baseline: Baseline, state: State) -> Signature:
    if state.battery_voltage_v is None:
        return {}
    plant, found = baseline.plant, Signature()
    if state.current_a is not None and state.current_rate_a_s is not None:
        drop = plant.resistance_ohm.nominal * state.current_a + plant.inductance_h.nominal * state.current_rate_a_s
        emf = plant.back_emf_constant_v_s_per_rad.nominal * baseline.gear * state.speed_rad_s
        found["electrical"] = drop + emf
    if state.battery_current_a is not None and baseline.battery is not None:
        drop = baseline.battery.internal_resistance_ohm * state.battery_current_a
        found["supply"] = baseline.open_circuit_voltage(state.charge_used_as) - drop
    return found


def _battery_voltage_offset(_: Baseline, state: State) -> Signature:
    if state.battery_voltage_v is None:
        return {}
    ones = np.ones_like(state.angle_rad)
    return {"electrical": state.setting.duty * ones, "supply": ones}


READINGS: Final[Mapping[str, Reading]] = MappingProxyType(
    {
        "force_n": Reading(attribute="force_n", signature=force_offset),
        "motor_current_a": Reading(attribute="current_a", signature=_motor_current_offset, of_rate=_motor_current_rate),
        "battery_voltage_v": Reading(attribute="battery_voltage_v", signature=_battery_voltage_offset),
        "battery_current_a": Reading(attribute="battery_current_a", signature=_battery_current_offset),
    }
)


def reads_too_much(baseline: Baseline, state: State, channel: str, by: Floats) -> Signature:
    """Change of the residuals where a channel reads too much by a wave, in its SI unit and of the state's shape."""
    reading = READINGS[channel]
    found: Signature = {name: by * wave for name, wave in reading.signature(baseline, state).items()}
    if reading.of_rate is not None and state.kind == "running" and is_angle_known(state):
        rate = state.speed_rad_s * angle_derivative(by)
        found = summed([found, {name: rate * wave for name, wave in reading.of_rate(baseline, state).items()}])
    return found


def angle_shift(baseline: Baseline, state: State, step_rad: float = 1e-4) -> Signature:
    """Change of the residuals per radian of error in the zero of the crank angle, by central difference.

    The force of the linear cutting law comes early or late with it: the cutting residual less that force is meant.
    """
    up = replace(state, angle_rad=state.angle_rad + step_rad)
    down = replace(state, angle_rad=state.angle_rad - step_rad)
    high, low = residuals(baseline, up), residuals(baseline, down)
    found: Signature = {name: (high[name] - low[name]) / (2.0 * step_rad) for name in high}
    if "cutting" in found:
        found["cutting"] = (baseline.expected_force(down) - baseline.expected_force(up)) / (2.0 * step_rad)
    return found
