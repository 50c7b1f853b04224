"""Effects between blade and workpiece. Severity 1 is a typical size; 0 is never passed."""

from __future__ import annotations

import numpy as np
from sawbench.blindcheck.effects.change import Change, Setting


def blade_compliance(severity: float, setting: Setting) -> Change:
    """Put a Kelvin-Voigt blade between plunger and teeth.

    k d + c (v - v_tip) = F(v_tip), d' = v - v_tip; k = 1.6e5 N/m, c = 25 N s/m. The teeth still move
    forward for a while after the plunger has turned round, so the force decays.
    """
    del setting
    return Change(shape={"blade_n_m": 1.6e5 / severity})


def return_stroke_rubbing(severity: float, setting: Setting) -> Change:
    """Let the blade's flanks rub in the kerf on the return half.

    F = -F_r (1 - exp(-|v| / 0.12)) (0.7 + 0.3 x / stroke); F_r = 14 N.
    """
    del setting
    return Change(plant={"rub_n": 14.0 * severity})


def tooth_passing_ripple(severity: float, setting: Setting) -> Change:
    """Let each tooth bite and let go, at fixed positions of the blade.

    Factor 1 + a S(2 pi x / p + psi), S(u) = atan2(q sin u, 1 - q cos u) / asin(q) a rounded sawtooth, q =
    0.75; a = 0.22, p 2.2-3.6 mm.
    """
    rng = setting.rng("tooth_passing_ripple")
    return Change(
        plant={"tooth_depth": 0.22 * severity},
        shape={
            "tooth_pitch_m": float(rng.uniform(2.2e-3, 3.6e-3)),
            "tooth_phase": float(rng.uniform(0.0, 2.0 * np.pi)),
            "tooth_sharpness": 0.75 if setting.forms == "own" else 1e-3,
        },
    )


def cutting_speed_exponent(severity: float, setting: Setting) -> Change:
    """Let the cutting force saturate with speed.

    F = k v (1 + v_0 / v_s) / (1 + v / v_s), v_0 = 0.7 m/s, v_s = 0.8 m/s / severity; the local exponent
    falls from 1 at rest to about 0.5 at the peak.
    """
    del setting
    return Change(plant={"inv_knee_s_m": 1.25 * severity})


def edge_force(severity: float, setting: Setting) -> Change:
    """Add the ploughing force of a blunt edge on the cutting half, in proportion to the width.

    F = k v + F_0 v / sqrt(v^2 + 0.02^2); F_0 = 35 N.
    """
    del setting
    return Change(plant={"edge_n": 35.0 * severity})


def chip_thickness(severity: float, setting: Setting) -> Change:
    """Let the force follow the feed per stroke h.

    k (1 + s (h - h_0) / (h_0 + h_e)), h_0 = 0.27 mm, edge radius h_e = 0.08 mm, h levelling off at 0.6 mm;
    s = 0.75.
    """
    del setting
    return Change(plant={"chip_share": 0.75 * severity})


def blade_wear(severity: float, setting: Setting) -> Change:
    """Wear the blade fast at first and slowly later, carried over between trials.

    k (1 + w sqrt(S)), S the distance cut in m; w = 0.028 / sqrt(m).
    """
    if setting.forms == "plain":
        return Change(plant={"wear_per_m": 0.005 * severity}, shape={"wear_power": 1.0})
    return Change(plant={"wear_per_m": 0.028 * severity})


def grain_variation(severity: float, setting: Setting) -> Change:
    """Vary the resistance along the feed path as wood does.

    Factor 1 + a g(feed path), g coloured noise around the ring distance, unit variance; a = 0.10.
    """
    del setting
    return Change(plant={"grain_depth": 0.10 * severity})


def engagement_delay(severity: float, setting: Setting) -> Change:
    """Cut nothing in the first part of the cutting stroke.

    Factor (1 + tanh(10 (x / (stroke f) - 1))) / 2, smooth because the teeth do not all arrive at once; f = 0.12 of
    the stroke. The blur is a share of f: a little of the effect moves little of the force.
    """
    del setting
    return Change(plant={"delay_share": min(0.12 * severity, 0.6)})
