"""Effects in carriage, load cell, amplifiers and clocks. Severity 1 is a typical size; 0 is never passed."""

from __future__ import annotations

from sawbench.blindcheck.effects.change import Change, Setting


def carriage_resonance(severity: float, setting: Setting) -> Change:
    """Put two modes between teeth and load cell.

    w^2 / (s^2 + 2 d w s + w^2) each, carrying 60 % and 20 % of the force; the first at 90-220 Hz with
    damping 3-6 %, the second 2.1-2.7 times higher.
    """
    rng = setting.rng("carriage_resonance")
    first = float(rng.uniform(90.0, 220.0))
    second = first * float(rng.uniform(2.1, 2.7))
    share = (0.6 * severity, 0.2 * severity) if setting.forms == "own" else (0.8 * severity, 0.0)
    scale = min(1.0, 1.0 / sum(share))
    damping = (float(rng.uniform(0.03, 0.06)), 0.05)
    return Change(
        sensors={
            "carriage_share": (share[0] * scale, share[1] * scale),
            "carriage_hz": (first, second),
            "carriage_damping": damping,
        }
    )


def preload_lift_off(severity: float, setting: Setting) -> Change:
    """Lift the carriage off where the force exceeds the spindle's preload P.

    Above P the reading keeps 7 % of the slope, rounded over 4 N; P = peak (1 - 0.18 severity).
    """
    return Change(sensors={"preload_n": setting.peak_force_n * max(1.0 - 0.18 * severity, 0.3)})


def force_sensor_lag(severity: float, setting: Setting) -> Change:
    """Put a Butterworth low-pass of 2nd order into the force amplifier.

    1 / (1 + sqrt(2) s/w + (s/w)^2); delay sqrt(2) / w = 1 ms.
    """
    return Change(sensors={"force_lag_s": 1e-3 * severity, "lag_order": 2 if setting.forms == "own" else 1})


def current_sensor_lag(severity: float, setting: Setting) -> Change:
    """Put a Butterworth low-pass of 2nd order into the current amplifier.

    1 / (1 + sqrt(2) s/w + (s/w)^2); delay sqrt(2) / w = 1 ms.
    """
    return Change(sensors={"current_lag_s": 1e-3 * severity, "lag_order": 2 if setting.forms == "own" else 1})


def clock_offset(severity: float, setting: Setting) -> Change:
    """Make one device's clock late and let it drift.

    Delay d + e t within a trial; d = 1.8 ms, |e| up to 40 us/s.
    """
    rng = setting.rng("clock_offset")
    device = ("force", "displacement", "electrical")[int(rng.integers(3))]
    drift = float(rng.uniform(-4e-5, 4e-5)) * severity if setting.forms == "own" else 0.0
    return Change(sensors={"late_device": device, "late_s": 1.8e-3 * severity, "late_drift": drift})


def force_offset_drift(severity: float, setting: Setting) -> Change:
    """Let the zero of the force drift over the session.

    z = A (1 - exp(-t / 900 s)) + a random walk; A = 9 N either way.
    """
    sign = 1.0 if setting.rng("force_offset_drift").random() < 0.5 else -1.0
    walk = 2.0 * severity if setting.forms == "own" else 0.0
    return Change(sensors={"drift_n": 9.0 * severity * sign, "walk_n": walk})
