"""One device's clock is late by 0.1 to 10 ms: its channels come as a pure delay, F_m(t) = F(t - tau).

late force         the load cell alone: cutting and (through the reading) mechanical residual
late CAN           motor current, battery voltage and current together: U - R i - L di/dt is the back-EMF of
                   tau ago, k_m i the torque of tau ago; the converter stays right
late displacement  angle and speed of tau ago: force and CAN look early
late amplifier     of force and displacement together: CAN alone looks early

Positive tau: late. Forms: a constant delay; a delay that drifts over the session (tau at 1000 s, clocks not
aligned again between trials); one that drifts within each trial (tau at 10 s). No amplitude is lost, unlike
in a lag. Latencies of USB, serial and CAN chains 0.1 to 10 ms, quartz clocks 10 to 100 ppm: assumed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.modeling.effects.effect import Effect, Prepared, Strength, TransferFunction, Words
from sawbench.modeling.effects.transfer import AXIS_TIMES_S, Spectrum, delay, force_error
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

if TYPE_CHECKING:
    from sawbench.modeling.machines.linear_axis import AxisBaseline, AxisState

FORCE, CAN, DISPLACEMENT, AMPLIFIER = 0.0, 1.0, 2.0, 3.0
_DEVICES = (FORCE, CAN, DISPLACEMENT, AMPLIFIER)
_SESSION_UNIT_S, _TRIAL_UNIT_S = 1000.0, 10.0


def _prepared(baseline: Baseline, state: State) -> Callable[..., tuple[Signature, ...]]:
    force = baseline.expected_force(state)
    late_force = _delays(force, state)
    late_can = _late_can(baseline, state)

    def signature(device: float, tau_s: float, drifts: float) -> tuple[Signature, ...]:
        delay_s = _delay_s(state, tau_s, drifts)
        if device == FORCE:
            return (force_error(baseline, state, late_force(delay_s) - force),)
        # Early CAN beside a displacement that sets the time is late CAN with the other sign.
        found = late_can(delay_s if device == CAN else -delay_s)
        if device == DISPLACEMENT:
            for name, wave in force_error(baseline, state, late_force(-delay_s) - force).items():
                found[name] = found.get(name, 0.0) + wave
        return (found,)

    return signature


def _delay_s(state: State, tau_s: float, drifts: float) -> Floats | float:
    session_s, trial_s = state.setting.session_s + state.time_s, state.time_s
    return tau_s * (1.0, session_s / _SESSION_UNIT_S, trial_s / _TRIAL_UNIT_S)[int(drifts)]


def _distorts(state: State, _: Floats, device: float, tau_s: float, drifts: float) -> Mapping[str, TransferFunction]:
    """Of the motor current the signature takes what is measured: only the voltage that is missing comes late."""
    delay_s = _delay_s(state, tau_s, drifts)
    late, early = delay(delay_s), delay(-delay_s)
    of_device: dict[float, Mapping[str, TransferFunction]] = {
        FORCE: {"cutting": late},
        CAN: {"electrical": late},
        DISPLACEMENT: {"cutting": early, "electrical": early},
        AMPLIFIER: {"electrical": early},
    }
    return of_device[device]


def _delays(wave: Floats, state: State) -> Callable[[Floats | float], Floats]:
    """Of a delay in s: the wave that much later."""
    spectrum = Spectrum(wave, state)
    return lambda delay_s: spectrum.through(delay(delay_s))


def _late_can(baseline: Baseline, state: State) -> Callable[[Floats | float], Signature]:
    if state.current_a is None:
        return lambda _: {}
    plant, current_a = baseline.plant, state.current_a
    emf = plant.back_emf_constant_v_s_per_rad.nominal * baseline.gear * state.speed_rad_s
    late_current, late_emf = _delays(current_a, state), _delays(emf, state)
    return lambda delay_s: {
        "electrical": late_emf(delay_s) - emf,
        "mechanical": plant.torque_constant_n_m_per_a.nominal * (current_a - late_current(-delay_s)),
    }


def _shapes() -> tuple[dict[str, float], ...]:
    constant = [(0.0, tau) for tau in np.geomspace(1e-4, 1e-2, 16)]
    drifting = [(kind, tau) for kind in (1.0, 2.0) for tau in np.geomspace(3e-4, 3e-2, 8)]
    return tuple(
        {"device": device, "tau_s": float(tau), "drifts": kind}
        for device in _DEVICES
        for kind, tau in constant + drifting
    )


def _axis_signature(axis: AxisBaseline, state: AxisState, device: float, tau_s: float) -> tuple[Signature, ...]:
    if not state.is_cyclic:
        return ({},)
    if device == FORCE:
        if state.force_n is None:
            return ({},)
        return ({"mechanical": state.force_n - _delays(state.force_n, state)(tau_s)},)
    required = axis.required_force(state)
    if device == CAN:
        return ({"mechanical": _delays(required, state)(tau_s) - required},)
    motion = required - (0.0 if state.force_n is None else state.force_n)
    return ({"mechanical": motion - _delays(motion, state)(tau_s)},)


def _on_axis(_: AxisBaseline) -> Effect:
    """Of an axis the devices are the load, the drive and the displacement."""
    return replace(
        EFFECT,
        equation="one device: y_m(t) = y(t - tau)",
        signature=_axis_signature,
        shapes=tuple({"device": d, "tau_s": tau} for d in (FORCE, CAN, DISPLACEMENT) for tau in AXIS_TIMES_S),
        confused_with=("force_sensor_lag", "current_sensor_lag"),
        told_apart_by="a sweep of the cycle rate; no amplitude is lost",
        background=None,
        distorts=None,
    )


EFFECT = Effect(
    name="clock_offset",
    place="sensing",
    equation="channels of one device: y_m(t) = y(t - tau)",
    words=Words(
        happens="the clock of one device is delayed",
        measure="the arrival time of one pulse at each device",
        mend="synchronise the clocks of the devices",
    ),
    parts=("clocks",),
    strength=Strength(name="delay_s", unit="s", typical=1.0, low=0.7, high=1.4, usual=1e-3, source="assumed"),
    signature=Prepared(_prepared),
    shapes=_shapes(),
    continuous=("tau_s",),
    shape_strength=lambda amplitude, shape: amplitude * shape["tau_s"],
    carries=("tau_s",),
    is_pointwise=False,
    grows_with=("speed",),
    confused_with=("force_sensor_lag", "current_sensor_lag", "blade_compliance"),
    told_apart_by="every channel of the device by the same time, at several speeds; no amplitude is lost",
    background=tuple(({"device": d, "tau_s": 1e-4, "drifts": 0.0}, 0.5) for d in (FORCE, CAN, DISPLACEMENT)),
    variants={"linear_axis": _on_axis},
    distorts=_distorts,
)
