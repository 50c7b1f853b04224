"""The jigsaw: equations of motion with every deviation that a campaign may hide, in fixed steps (RK4).

    L di/dt      = U - R i - k_e (w - w_mount) - V_brush
    J(phi) dw/dt = k_m i - b (w - w_mount) - friction - load at the gear
    dphi/dt      = w / gear (1 - slip)
    x            = r (1 - cos phi),  v = dx/dt              (Scotch yoke)
    F            = k c(x, t) v^p ... on the cutting half    (reading of the force sensor, before its errors)

The baseline is that of the paper that the product models as well; every deviation is a group of parameters that a zero
switches off. Forms are those of the field where a source is given, and assumed elsewhere. They differ from the forms
that the diagnosis fits, on purpose: friction is LuGre with a Stribeck dip, play is a second body, the diode is a
polynomial, heat has two nodes.

Sources: Canudas de Wit et al. 1995 (LuGre), doi:10.1109/9.376053; Hunt and Crossley 1975 (contact),
doi:10.1115/1.3423596; the paper's Eq. 16 (battery).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.independent_bench.parameters import Plant

Floats = NDArray[np.float64]

STEP_S: Final = 2.5e-5
# Hardness of the piece is a table over time in steps of this, s.
HARDNESS_STEP_S: Final = 0.01
# Rows of the signals: N (> 0: the blade cuts), m, A, V, A, rad at the crank, rad/s at the motor.
N_SIGNALS: Final = 7
FORCE, POSITION, MOTOR_A, BATTERY_V, BATTERY_A, CRANK_ANGLE, MOTOR_SPEED = range(N_SIGNALS)
# State: A, rad/s (motor), rad (crank), C drawn, K and K of the winding's two nodes, K of the magnets, V and V of the
# polarization's two relaxations, m of the bristles, m of the blade's deflection, m and m/s of the plunger (with play),
# 1 of the limiter's duty, 1 of the belt's slip, rad and rad/s of the motor's mount, m cut.
N_STATES: Final = 18
(
    CURRENT, SPEED, ANGLE, CHARGE, WINDING, CASING, MAGNET, FAST_V, SLOW_V, BRISTLE, DEFLECTION, PLUNGER, PLUNGER_SPEED,
    LIMITER, SLIPPED, MOUNT, MOUNT_SPEED, CUT,
) = range(N_STATES)  # fmt: skip

_COPPER_PER_K: Final = 0.0039
_TURN: Final = 2.0 * math.pi
# Speed over which a sign turns round, rad/s at the motor; above it friction is that of a turning machine.
_TURNING: Final = 3.0


_compiled = njit(cache=True, error_model="numpy")


@_compiled
def _switched(time_s, run):
    """Share of the duty that the ramp of the switch lets through, 0 to 1."""
    u = (time_s - run.on_s) / run.ramp_s
    return 0.0 if u <= 0.0 else 1.0 if u >= 1.0 else u * u * (3.0 - 2.0 * u)


@_compiled
def _supply(y, switched, p):
    """Voltage at the motor (V), voltage (V) and current (A) of the battery."""
    current, battery, converter = y[CURRENT], p.battery, p.converter
    soc = 1.0 - y[CHARGE] / battery.charge_c
    open_v = battery.nominal_voltage_v * soc / (1.0 - battery.beta * (1.0 - soc))
    duty = p.run.duty * switched
    if p.limiter.current_a > 0.0:
        duty = max(0.0, duty - y[LIMITER])
    battery_a = duty * current
    if converter.loss_share > 0.0:
        rest = converter.square * duty * current * abs(current) / 10.0 + converter.quiescent_a * switched
        battery_a = battery_a * (1.0 + converter.loss_share * converter.linear) + converter.loss_share * rest
    extra = p.extra_resistance.resistance_ohm * (1.0 + p.extra_resistance.growth * (1.0 - soc))
    battery_v = open_v - (battery.internal_resistance_ohm + extra) * battery_a - y[FAST_V] - y[SLOW_V]
    motor_v = duty * battery_v
    if p.diode.voltage_v > 0.0 and switched > 0.0:
        x = current / 10.0
        forward_v = p.diode.voltage_v * (p.diode.constant + p.diode.linear * x + p.diode.square * x * x)
        motor_v -= forward_v * (switched - duty) * math.tanh(current / 0.15)
    return motor_v, battery_v, battery_a


@_compiled
def _motor(y, p):
    """Resistance (Ohm), back-EMF constant (V s/rad), torque constant (N m/A) and brush voltage (V) as they are now."""
    current = y[CURRENT]
    resistance = p.machine.resistance_ohm * (1.0 + _COPPER_PER_K * (y[WINDING] + y[CASING]))
    flux = 1.0 - p.magnets.loss_per_k * y[MAGNET]
    if p.armature.share > 0.0:
        loaded = (current / p.armature.current_a) ** 2
        flux *= 1.0 - p.armature.share * 1.6 * loaded / (1.0 + 0.6 * loaded)
    brush_v = 0.0
    if p.brushes.voltage_v > 0.0:
        growth = 1.0 + p.brushes.growth * math.log(1.0 + abs(current) / 5.0)
        brush_v = p.brushes.voltage_v * math.tanh(current / p.brushes.scale_a) * growth
    machine = p.machine
    return resistance, machine.back_emf_constant_v_s_per_rad * flux, machine.torque_constant_n_m_per_a * flux, brush_v


@_compiled
def _coefficient(time_s, x, crank_speed, cut_m, p, hardness):
    """Specific cutting coefficient at this place of blade and workpiece, N s/m."""
    found = p.run.cutting_coefficient_n_s_per_m * hardness
    stroke = 2.0 * p.machine.crank_radius_m
    if p.chip.exponent > 0.0:
        chip_mm = min(p.run.feed_mm_s / (max(crank_speed, 3.0) / _TURN), 3.0 * p.chip.reference_mm)
        found *= ((chip_mm + p.chip.floor_mm) / (p.chip.reference_mm + p.chip.floor_mm)) ** p.chip.exponent
    if p.wear.growth_per_10_m > 0.0:
        break_in_m = p.wear.break_in_m * (1.0 - math.exp(-cut_m / p.wear.break_in_m))
        worn_m = cut_m * (1.0 - p.wear.break_in_share) + p.wear.break_in_share * break_in_m
        found *= 1.0 + p.wear.growth_per_10_m * worn_m / 10.0
    if p.packing.growth > 0.0 and time_s > p.run.on_s:
        found *= 1.0 + p.packing.growth * (1.0 - math.exp(-(time_s - p.run.on_s) / p.packing.time_s))
    if p.teeth.depth > 0.0:
        a = _TURN * x / p.teeth.pitch_m + p.teeth.phase_rad
        found *= 1.0 + p.teeth.depth * (math.sin(a) + p.teeth.second_share * math.sin(2.0 * a + 0.7))
    if p.engagement.fraction > 0.0:
        travelled = stroke - x if p.run.cutting_sign < 0.0 else x
        z = (travelled - p.engagement.fraction * stroke) / p.engagement.width_m
        found /= 1.0 + math.exp(-max(-40.0, min(40.0, z)))
    return found


@_compiled
def _law(k, speed, p, hardness):
    """Force over a cutting speed > 0 (m/s), N."""
    law = p.law
    if law.logarithm > 0.0:
        scale = law.reference_m_s / math.log(1.0 + law.logarithm)
        force = k * scale * math.log(1.0 + law.logarithm * speed / law.reference_m_s)
    elif law.exponent != 1.0:
        rounded = (speed * speed + 4e-4) ** (0.5 * (law.exponent - 1.0))
        force = k * law.reference_m_s ** (1.0 - law.exponent) * rounded * speed
    else:
        force = k * speed
    if p.edge.force_n > 0.0:
        force += p.edge.force_n * hardness * math.tanh(speed / p.edge.speed_m_s)
    return force


@_compiled
def _rubbing(speed, p, hardness):
    """Force over a speed > 0 (m/s) on the way back, N."""
    rubbing, force = p.rubbing, 0.0
    if rubbing.damping_n_s_per_m > 0.0:
        rounded = (speed * speed + 1e-4) ** (0.5 * (rubbing.exponent - 1.0))
        force += rubbing.damping_n_s_per_m * hardness * 0.8 ** (1.0 - rubbing.exponent) * rounded * speed
    if rubbing.dry_n > 0.0:
        force += rubbing.dry_n * hardness * math.tanh(speed / 0.03)
    return force


@_compiled
def _spring(k, speed, deflection, blade):
    """Force of the blade's spring in series with the teeth (N), and the rate of its deflection (m/s)."""
    stiffness = 1.0 / blade.compliance_m_per_n
    if deflection <= 0.0 and speed <= 0.0:
        return 0.0, -deflection / 1e-3
    force = max(stiffness * deflection * (1.0 + blade.hardening_per_m * deflection), 0.0)
    return force, speed - force / max(k, 5.0)


@_compiled
def _cutting(time_s, x, speed, crank_speed, y, p, hardness):
    """Force of the workpiece on the blade (N, > 0 where it cuts), and the rate of the blade's deflection (m/s)."""
    force, rate = 0.0, 0.0
    if p.run.cutting_coefficient_n_s_per_m <= 0.0:
        return force, rate
    k = _coefficient(time_s, x, crank_speed, y[CUT], p, hardness)
    if p.blade.compliance_m_per_n > 0.0:
        force, rate = _spring(k, speed, y[DEFLECTION], p.blade)
    elif speed > 0.0:
        force = _law(k, speed, p, hardness)
    if speed < 0.0:
        force -= _rubbing(-speed, p, hardness)
    return force, rate


@_compiled
def _guide(v, bristle, guide):
    """Friction of the guide (N, against v) and the rate of the bristles (m/s)."""
    if guide.force_n <= 0.0:
        return 0.0, 0.0
    dip = 1.0 + (guide.static_ratio - 1.0) * math.exp(-((v / guide.stribeck_m_s) ** 2))
    limit = guide.force_n * dip * (1.0 + guide.asymmetry * (1.0 if v > 0.0 else -1.0))
    stiffness = guide.force_n / 4e-5
    rate = v - stiffness * abs(v) / limit * bristle
    return stiffness * bristle + 15.0 * rate, rate


@_compiled
def _bumper(x, v, p):
    """Force of the spring at the outer dead centre, N."""
    depth = x - (2.0 * p.machine.crank_radius_m - p.bumper.length_m)
    if p.bumper.stiffness_n_per_m15 <= 0.0 or depth <= 0.0:
        return 0.0
    return p.bumper.stiffness_n_per_m15 * depth**1.5 * (1.0 if v > 0.0 else 1.0 - p.bumper.loss_share)


@_compiled
def _contact(ahead, closing, play):
    """Force of the pin on the yoke (N), `ahead` (m) of it and closing in (m/s): softer where it just touches."""
    depth = abs(ahead) - 0.5 * play.gap_m
    if depth <= 0.0:
        return 0.0
    side = 1.0 if ahead > 0.0 else -1.0
    force = depth * play.stiffness_n_per_m * min(1.0, 0.4 + depth / 2e-5)
    return side * max(0.0, force + 250.0 * side * closing * min(1.0, depth / 1e-5))


@_compiled
def _drag(speed, angle, load, on_plunger, p):
    """Torque at the motor that friction, fan and an eccentric gear take beside the motor's damping, N m."""
    torque, turning = 0.0, math.tanh(speed / _TURNING)
    if p.friction.torque_n_m > 0.0:
        dip = p.friction.static_share * math.exp(-((speed / p.friction.stribeck_rad_s) ** 2))
        torque += p.friction.torque_n_m * (1.0 + dip) * turning
    if p.windage.torque_n_m > 0.0:
        torque += p.windage.torque_n_m * (abs(speed) / 1000.0) ** p.windage.exponent * (1.0 if speed > 0.0 else -1.0)
    e = p.eccentricity
    if e.torque_n_m > 0.0:
        wave = math.sin(angle + e.phase_rad) + e.second_share * math.sin(2.0 * angle + e.second_phase_rad)
        torque += e.torque_n_m * wave * turning
    if p.load_friction.mesh_share > 0.0:
        torque += p.load_friction.mesh_share * (math.sqrt(load * load + 1e-6) - 1e-3) * turning
    if p.load_friction.pin_share > 0.0:
        lever = p.machine.crank_radius_m * abs(math.cos(angle)) / p.machine.gear_ratio
        torque += p.load_friction.pin_share * abs(on_plunger) * lever * turning
    return torque


@_compiled
def _slow_rates(y, d, battery_a, loss_w, p):
    """Rates of temperatures (K/s) and of the battery's relaxations (V/s)."""
    d[WINDING] = (p.heating.fast_k_per_w * loss_w - y[WINDING]) / p.heating.fast_s
    d[CASING] = (p.heating.slow_k_per_w * loss_w - y[CASING]) / p.heating.slow_s
    d[MAGNET] = (p.magnets.heating_k_per_w * loss_w - y[MAGNET]) / p.magnets.time_s
    d[FAST_V] = (p.polarization.fast_ohm * battery_a - y[FAST_V]) / p.polarization.fast_s
    d[SLOW_V] = (p.polarization.slow_ohm * battery_a - y[SLOW_V]) / p.polarization.slow_s
    d[CHARGE] = battery_a


@_compiled
def _link_rates(y, d, motor_torque, load, p):
    """Rates of the limiter's duty (1/s), of the belt's slip (1/s) and of the motor's mount (rad/s, rad/s^2)."""
    d[LIMITER] = d[SLIPPED] = d[MOUNT] = d[MOUNT_SPEED] = 0.0
    if p.limiter.current_a > 0.0:
        over_a = max(0.0, y[CURRENT] - p.limiter.current_a)
        d[LIMITER] = (min(p.run.duty, p.limiter.gain_per_a * over_a) - y[LIMITER]) / p.limiter.lag_s
    if p.slip.share > 0.0:
        q = load / p.slip.torque_n_m
        d[SLIPPED] = (max(-0.2, min(0.3, p.slip.share * q * (1.0 + 0.5 * abs(q)))) - y[SLIPPED]) / 0.002
    if p.mount.inertia_kg_m2 > 0.0:
        held = p.mount.stiffness_n_m_per_rad * y[MOUNT] + p.mount.damping_n_m_s_per_rad * y[MOUNT_SPEED]
        d[MOUNT] = y[MOUNT_SPEED]
        d[MOUNT_SPEED] = (-motor_torque - 0.6 * load - held) / p.mount.inertia_kg_m2


@_compiled
def _derivative(time_s, y, d, signals, p, hardness):
    """Rates `d` of the state `y`, shape (N_STATES,), and the `signals`, shape (N_SIGNALS,), at a time."""
    m, current, speed, angle = p.machine, y[CURRENT], y[SPEED], y[ANGLE]
    sine, cosine, per_turn = math.sin(angle), math.cos(angle), 1.0 / m.gear_ratio
    crank_speed = speed * per_turn * (1.0 - y[SLIPPED])
    switched = _switched(time_s, p.run)
    motor_v, battery_v, battery_a = _supply(y, switched, p)
    resistance, back_emf, torque_constant, brush_v = _motor(y, p)
    turned = speed - y[MOUNT_SPEED]
    d[CURRENT] = (motor_v - resistance * current - back_emf * turned - brush_v) / m.inductance_h

    pin_x, pin_v = m.crank_radius_m * (1.0 - cosine), m.crank_radius_m * crank_speed * sine
    has_play = p.play.gap_m > 0.0
    x, v = (y[PLUNGER], y[PLUNGER_SPEED]) if has_play else (pin_x, pin_v)
    force, d[DEFLECTION] = _cutting(time_s, x, p.run.cutting_sign * v, crank_speed, y, p, hardness)
    friction, d[BRISTLE] = _guide(v, y[BRISTLE], p.guide)
    on_plunger = -p.run.cutting_sign * force - friction - _bumper(x, v, p)

    lever = m.crank_radius_m * sine * per_turn
    inertia = m.rotor_inertia_kg_m2 + m.yoke_inertia_kg_m2 * per_turn * per_turn
    d[PLUNGER] = d[PLUNGER_SPEED] = 0.0
    if has_play:
        pushed = _contact(pin_x - x, pin_v - v, p.play)
        d[PLUNGER], d[PLUNGER_SPEED] = v, (pushed + on_plunger) / m.reciprocating_mass_kg
        load = pushed * lever
    else:
        # The mass is felt through the lever: J(phi), and half dJ/dphi times the square of the speed.
        inertia += m.reciprocating_mass_kg * lever * lever
        change = m.reciprocating_mass_kg * m.crank_radius_m**2 * sine * cosine * per_turn**3
        load = change * speed * speed - on_plunger * lever

    motor_torque = torque_constant * current - m.motor_damping_n_m_s_per_rad * turned
    d[SPEED] = (motor_torque - _drag(speed, angle, load, on_plunger, p) - load) / inertia
    if speed < 0.0 and time_s < p.run.on_s:
        d[SPEED] = 0.0  # nothing turns a machine that is switched off
    d[ANGLE] = crank_speed
    d[CUT] = max(p.run.cutting_sign * v, 0.0) if p.run.cutting_coefficient_n_s_per_m > 0.0 else 0.0
    _slow_rates(y, d, battery_a, resistance * current * current, p)
    _link_rates(y, d, motor_torque, load, p)
    signals[FORCE], signals[POSITION], signals[MOTOR_A] = force, x, current
    signals[BATTERY_V], signals[BATTERY_A] = battery_v, battery_a
    signals[CRANK_ANGLE], signals[MOTOR_SPEED] = angle, speed


@_compiled
def _hardness_at(time_s, table):
    place = time_s / HARDNESS_STEP_S
    j = int(place)
    return table[-1] if j >= len(table) - 1 else table[j] + (place - j) * (table[j + 1] - table[j])


@_compiled
def _integrate(p, y, n_steps, hardness):
    found = np.empty((N_SIGNALS, n_steps))
    d, middle, signals = np.empty((4, N_STATES)), np.empty(N_STATES), np.empty(N_SIGNALS)
    for step in range(n_steps):
        time_s = step * STEP_S
        now = _hardness_at(time_s, hardness)
        for stage in range(4):
            ahead_s = (0.0, 0.5 * STEP_S, 0.5 * STEP_S, STEP_S)[stage]
            for q in range(N_STATES):
                middle[q] = y[q] + (ahead_s * d[stage - 1, q] if stage else 0.0)
            _derivative(time_s + ahead_s, middle, d[stage], signals, p, now)
            if stage == 0:
                found[:, step] = signals
        for q in range(N_STATES):
            y[q] += STEP_S / 6.0 * (d[0, q] + 2.0 * d[1, q] + 2.0 * d[2, q] + d[3, q])
        y[DEFLECTION] = max(y[DEFLECTION], 0.0)
    return found


# What the compiled functions read: one record, a record in it for every group.
_RECORD: Final = np.dtype(
    [(name, [(field, np.float64) for field in group._fields]) for name, group in Plant()._asdict().items()]
)


def integrate(p: Plant, y: Floats, n_steps: int, hardness: Floats) -> Floats:
    """Integrate a trial from its start.

    Parameters
    ----------
    p : Plant
    y : ndarray, shape (N_STATES,)
        State at the start; holds the state at the end afterwards.
    n_steps : int
        Of `STEP_S`.
    hardness : ndarray, shape (n,)
        Of the piece over time, in steps of `HARDNESS_STEP_S`, 1 on average; the last value holds on.

    Returns
    -------
    ndarray, shape (N_SIGNALS, n_steps)
        Signals at the start of every step.

    Examples
    --------
    >>> signals = integrate(Plant(), np.zeros(N_STATES), 40_000, np.ones(1))
    >>> bool(signals[MOTOR_SPEED, -1] > 900.0)
    True
    """
    record = np.array([tuple(map(tuple, p))], dtype=_RECORD)[0]
    return _integrate(record, y, n_steps, hardness)


def rested(y: Floats, p: Plant, rest_s: float) -> Floats:
    """Return the slow state after a rest; the machine itself stands still, the charge and the cut stay.

    Parameters
    ----------
    y : ndarray, shape (N_STATES,)
    p : Plant
    rest_s : float

    Returns
    -------
    ndarray, shape (N_STATES,)
    """
    kept = np.zeros(N_STATES)
    kept[[CHARGE, CUT]] = y[[CHARGE, CUT]]
    times = {
        WINDING: p.heating.fast_s, CASING: p.heating.slow_s, MAGNET: p.magnets.time_s, FAST_V: p.polarization.fast_s,
        SLOW_V: p.polarization.slow_s,
    }  # fmt: skip
    for place, time_s in times.items():
        kept[place] = y[place] * math.exp(-rest_s / time_s)
    return kept
