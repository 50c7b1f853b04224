"""Effects in battery, converter and brushes. Severity 1 is a typical size; 0 is never passed."""

from __future__ import annotations

from sawbench.blindcheck.effects.change import Change, Setting


def brush_voltage_drop(severity: float, setting: Setting) -> Change:
    """Take the voltage of a contact film off the motor.

    V = V_0 (1 - exp(-|i| / 0.7)) (1 + 0.05 ln(1 + |i|)) sgn(i); V_0 = 0.9 V.
    """
    del setting
    return Change(plant={"brush_v": 0.9 * severity})


def converter_diode_drop(severity: float, setting: Setting) -> Change:
    """Take the freewheel diode's voltage off while it conducts.

    (1 - duty) (V_d ln(1 + i / 0.4) / ln 26 + r i); V_d = 0.65 V, r = 12 mohm.
    """
    del setting
    return Change(plant={"diode_v": 0.65 * severity, "diode_ohm": 0.012 * severity})


def converter_loss(severity: float, setting: Setting) -> Change:
    """Let the battery pay for switching, conduction and idling of the converter.

    i_b = duty i + (V_sw |i| + r i^2 + P_0) / V; V_sw = 0.35 V, r = 12 mohm, P_0 = 0.6 W.
    """
    del setting
    return Change(plant={"switch_v": 0.35 * severity, "switch_ohm": 0.012 * severity, "idle_w": 0.6 * severity})


def current_limit(severity: float, setting: Setting) -> Change:
    """Pull the duty back above i_max by a PI controller.

    With e = i - i_max: duty - 0.03 e - p, p' = 1.5 e, decaying with 1/8 s below; i_max = 21 A /
    sqrt(severity), or as far below the start-up peak of another tool.
    """
    return Change(shape={"limit_a": setting.usual_limit_a * severity**-0.5})


def battery_internal_resistance(severity: float, setting: Setting) -> Change:
    """Add battery resistance that grows as the battery empties.

    dR (1 + 0.6 (1 - s)), s the state of charge; dR = 45 mohm.
    """
    return Change(plant={"extra_ohm": 0.045 * severity}, shape={"extra_soc": 0.6 if setting.forms == "own" else 0.0})


def battery_polarization(severity: float, setting: Setting) -> Change:
    """Add two relaxations, a short ladder for diffusion.

    v' = (R i_b - v) / T each: 20 mohm at 2 s and 28 mohm at 22 s; they recover between trials.
    """
    if setting.forms == "plain":
        return Change(plant={"polar_fast_ohm": 0.04 * severity}, shape={"polar_fast_s": 8.0})
    return Change(plant={"polar_fast_ohm": 0.02 * severity, "polar_slow_ohm": 0.028 * severity})
