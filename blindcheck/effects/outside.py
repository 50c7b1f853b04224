"""Effects that no catalogue lists; an honest diagnosis calls them unknown. Severity 1 is a clear one."""

from __future__ import annotations

from sawbench.blindcheck.effects.change import Change, Setting


def hand_sway(severity: float, setting: Setting) -> Change:
    """Let the operator press unevenly, in time and not along the feed.

    k (1 + a sin(2 pi f t)), f 0.7-1.6 Hz; a = 0.15.
    """
    return Change(
        plant={"sway_depth": 0.15 * severity},
        shape={"sway_hz": float(setting.rng("hand_sway").uniform(0.7, 1.6))},
    )


def alternating_strokes(severity: float, setting: Setting) -> Change:
    """Let every other stroke cut deeper.

    k (1 +- a); a = 0.10.
    """
    del setting
    return Change(plant={"alternate_depth": 0.10 * severity})


def supply_ripple(severity: float, setting: Setting) -> Change:
    """Add a beat of the converter to the battery voltage.

    V + a (sin 2 pi f t + 0.3 sin 4 pi f t), f 40-90 Hz; a = 0.12 V.
    """
    return Change(
        plant={"ripple_v": 0.12 * severity},
        shape={"ripple_hz": float(setting.rng("supply_ripple").uniform(40.0, 90.0))},
    )


def duty_wander(severity: float, setting: Setting) -> Change:
    """Let a worn trigger modulate the duty.

    duty (1 + a n(t)), n noise with a memory of 15 ms; a = 0.04.
    """
    del setting
    return Change(plant={"duty_wander": 0.04 * severity})


def grease_warming(severity: float, setting: Setting) -> Change:
    """Add stiff grease that softens as shearing warms it.

    tau = g exp(-T / 6) sqrt(w / 1000), T' = 2e-4 w - T / 60; g = 12 mN m.
    """
    del setting
    return Change(plant={"grease_torque": 0.012 * severity})


def blade_whip(severity: float, setting: Setting) -> Change:
    """Let the blade swing, driven by the stroke.

    q'' + 0.05 w q' + w^2 q = -a_plunger, force m w^2 q; m = 60 g of blade and holder, 35-60 Hz.
    """
    return Change(
        plant={"whip_kg": 0.06 * severity},
        shape={"whip_hz": float(setting.rng("blade_whip").uniform(35.0, 60.0))},
    )


def soft_start(severity: float, setting: Setting) -> Change:
    """Ramp the duty up by an electronic soft start that the bench does not know.

    duty (1 - exp(-t / T)); T = 80 ms.
    """
    del setting
    return Change(shape={"soft_start_s": 0.08 * severity})


def brush_bounce(severity: float, setting: Setting) -> Change:
    """Let the brushes lift at random.

    R + r max(n(t), 0), n noise with a memory of 15 ms; r = 0.06 ohm.
    """
    del setting
    return Change(plant={"bounce_ohm": 0.06 * severity})


def loose_pin_impacts(severity: float, setting: Setting) -> Change:
    """Let a loose pin strike after each dead centre.

    The load cell rings at 450-800 Hz and decays in 3 ms; 25 N.
    """
    return Change(
        sensors={
            "pin_n": 25.0 * severity,
            "pin_hz": float(setting.rng("loose_pin_impacts").uniform(450.0, 800.0)),
        }
    )


def carriage_stick_slip(severity: float, setting: Setting) -> Change:
    """Let the carriage creep and let go while the tool runs.

    Sawtooth of the force reading, 12 N, period 0.3-0.7 s.
    """
    return Change(
        sensors={
            "slip_n": 12.0 * severity,
            "slip_s": float(setting.rng("carriage_stick_slip").uniform(0.3, 0.7)),
        }
    )


def rotor_unbalance(severity: float, setting: Setting) -> Change:
    """Let the load cell feel an eccentric rotor.

    F = a (w / 1000)^2 sin(phi_motor); a = 6 N.
    """
    del setting
    return Change(sensors={"unbalance_n": 6.0 * severity})


def interference_bursts(severity: float, setting: Setting) -> Change:
    """Add bursts of interference to every channel.

    4 ms long, 25 times the noise, a few a second.
    """
    return Change(
        sensors={
            "burst_size": 25.0 * severity,
            "burst_rate_hz": float(setting.rng("interference_bursts").uniform(2.0, 6.0)),
        }
    )


def displacement_bow(severity: float, setting: Setting) -> Change:
    """Bend the displacement sensor's characteristic.

    x + c (x - 10 mm)^2; c = 4e-3 /mm.
    """
    del setting
    return Change(sensors={"bow_per_mm": 4e-3 * severity})


def current_crosstalk(severity: float, setting: Setting) -> Change:
    """Couple the motor current into the load cell's cable.

    F + c i; c = 0.8 N/A.
    """
    del setting
    return Change(sensors={"crosstalk_n_per_a": 0.8 * severity})


def commutation_ripple(severity: float, setting: Setting) -> Change:
    """Let the brushes short the current at each segment.

    i (1 + a (|sin(5 phi_motor / 2)| - 2/pi)); a = 0.08.
    """
    del setting
    return Change(sensors={"commutation": 0.08 * severity})
