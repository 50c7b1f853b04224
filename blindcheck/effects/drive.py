"""Effects in motor, gear and yoke. Severity 1 is a typical size; 0 is never passed."""

from __future__ import annotations

import numpy as np
from sawbench.blindcheck.effects.change import Change, Setting


def guide_friction(severity: float, setting: Setting) -> Change:
    """Add LuGre friction of the plunger's guide.

    dz/dt = v - |v| z / (z_s g(v)), F = F_c z / z_s + viscous micro-damping; g(v) = 1 + 0.4 exp(-(v /
    0.06)^2) is the Stribeck dip, z_s = 0.12 mm the presliding; F_c = 8 N.
    """
    dip = 0.4 if setting.forms == "own" else 0.0
    return Change(plant={"guide_n": 8.0 * severity}, shape={"guide_stribeck": dip})


def motor_coulomb_friction(severity: float, setting: Setting) -> Change:
    """Add dry friction of brushes and bearings.

    tau = tau_c tanh(w / 3) (1 + 0.35 exp(-(w / 60)^2)); tau_c = 5 mN m.
    """
    del setting
    return Change(plant={"brush_friction": 5e-3 * severity})


def windage_drag(severity: float, setting: Setting) -> Change:
    """Add a fan in a turbulent gap.

    tau = tau_w (w / 1000)^1.85; tau_w = 6 mN m at 1000 rad/s.
    """
    power = 1.85 if setting.forms == "own" else 2.0
    return Change(plant={"windage": 6e-3 * severity}, shape={"windage_power": power})


def load_dependent_friction(severity: float, setting: Setting) -> Change:
    """Add gear and pin friction that grows with the load torque T at the motor.

    tau = mu (1 + 0.4 exp(-|w| / 200)) (sqrt(T^2 + T_0^2) - T_0), T_0 = 4 mN m; mu = 0.06.
    """
    del setting
    return Change(plant={"mesh_mu": 0.06 * severity})


def yoke_backlash(severity: float, setting: Setting) -> Change:
    """Add play between pin and yoke: the plunger becomes a mass of its own.

    Contact spring with Hunt-Crossley loss, F = k d (1 + c d') for a penetration d beyond half the gap; k =
    8e5 N/m, c = 0.6 s/m; gap 0.25 mm.
    """
    loss = 0.6 if setting.forms == "own" else 0.2
    return Change(plant={"gap_m": 2.5e-4 * severity}, shape={"contact_loss_s_m": loss})


def gear_eccentricity(severity: float, setting: Setting) -> Change:
    """Add the tight spot of an eccentric gear.

    tau = a (exp(0.7 cos(phi - psi)) - I_0(0.7)) / 0.75, narrower than the loose spot, and a ratio error e
    cos(phi - psi); a = 16 mN m, e = 0.4 %.
    """
    phase = float(setting.rng("gear_eccentricity").uniform(0.0, 2.0 * np.pi))
    return Change(
        plant={"mesh_torque": 0.016 * severity, "mesh_error_rad": 0.004 * severity},
        shape={"mesh_phase": phase},
    )


def winding_heating(severity: float, setting: Setting) -> Change:
    """Let the winding's resistance follow a model of two thermal nodes.

    C_w T_w' = i^2 R - (T_w - T_h) / R_wh, C_h T_h' = (T_w - T_h) / R_wh + b w^2 - T_h / R_ha; resistance R
    (1 + alpha T_w), alpha = 3.9e-3 1/K. Heat carries over between trials.
    """
    shape = {} if setting.forms == "own" else {"r_wind_house": 2.4, "c_housing": 1e5}
    return Change(plant={"copper_per_k": 3.9e-3 * severity}, shape=shape)


def magnet_weakening(severity: float, setting: Setting) -> Change:
    """Let both motor constants lose flux with the housing's temperature T_h.

    Factor 1 - a T_h (1 + 0.003 T_h); a = 0.18 %/K.
    """
    del setting
    return Change(plant={"magnet_per_k": 1.8e-3 * severity})


def cogging_torque(severity: float, setting: Setting) -> Change:
    """Let the rotor's teeth snap to the magnets, as often a turn of the motor as it has slots.

    tau = a (sin(u) + q sin(2 u)) / sqrt(1 + q^2), u = slots phi_motor + psi; slots 5, 7, 9 or 12; a = 8 mN m, q = 0.25
    (0 of the textbook form).
    """
    rng = setting.rng("cogging_torque")
    return Change(
        plant={"cogging_torque": 0.008 * severity},
        shape={
            "cogging_slots": float(rng.choice([5, 7, 9, 12])),
            "cogging_phase": float(rng.uniform(0.0, 2.0 * np.pi)),
            "cogging_second": 0.25 if setting.forms == "own" else 0.0,
        },
    )
