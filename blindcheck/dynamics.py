"""The plant's equations of motion, written on their own for the blind check (numba).

State, one row of `STATE_NAMES`; parameters, one record of `RECORD`; an extra term vanishes at its default 0.

Baseline: L di/dt = U - R i - k_e w;  J_r(phi) dw/dt = k_m i - b w - J_r'/2 w^2 + E x'(phi) / gear, with
the force E of the surroundings on the plunger, and J_r the kinetic energy of rotor, crank and plunger over w^2 / 2
(Lagrange); x = r (1 - cos phi) of a Scotch yoke, `_travel` of a slider crank; cutting force k_Fc v while the blade
moves in the cutting direction; U = duty V_b, i_b = duty i; V_b = V_nom s / (1 - beta (1 - s)) - R_b i_b,
s the state of charge. What the extra terms stand for is said in `blindcheck.effects`.
"""

from __future__ import annotations

from math import asin, asinh, atan2, cos, exp, log1p, pi, sin, sqrt, tanh

import numpy as np
from numba import njit

STATE_NAMES = (
    "current_a", "speed_rad_s", "crank_rad", "charge_as", "polar_fast_v", "polar_slow_v", "winding_k",
    "housing_k",
    "bristle_m", "lost_motion_m", "plunger_m_s", "deflection_m", "cut_path_m", "feed_path_mm", "limit_duty",
    "stroke_rate_hz", "grease_k", "whip_m", "whip_m_s",
)  # fmt: skip
N_STATES = len(STATE_NAMES)
CURRENT, SPEED, CRANK, CHARGE, POLAR_FAST, POLAR_SLOW, WINDING, HOUSING = range(8)
BRISTLE, LOST, PLUNGER, DEFLECTION, CUT_PATH, FEED_PATH, LIMIT, RATE, GREASE, WHIP, WHIP_V = range(8, N_STATES)

OUTPUT_NAMES = ("force_n", "plunger_m", "current_a", "battery_v", "battery_a", "crank_rad", "speed_rad_s")
N_OUTPUTS = len(OUTPUT_NAMES)

FIELDS = (
    # baseline
    "resistance", "inductance", "k_e", "k_m", "rotor_inertia", "yoke_inertia", "mass", "radius", "rod",
    "damping", "gear",
    "v_nominal", "capacity_as", "beta", "r_battery", "duty", "held_v", "is_on", "k_fc", "cut_direction",
    "cuts",
    "feed_mm_s", "width_ratio",
    # heat: capacities J/K, resistances K/W, couplings 1/K
    "c_winding", "c_housing", "r_wind_house", "r_house_air", "copper_per_k", "magnet_per_k",
    # drive
    "guide_n", "guide_presliding_m", "guide_stribeck", "brush_friction", "windage", "windage_power",
    "mesh_mu",
    "gap_m", "contact_n_m", "contact_loss_s_m", "mesh_error_rad", "mesh_torque", "mesh_phase",
    # cutting
    "blade_n_m", "blade_n_s_m", "rub_n", "tooth_depth", "tooth_pitch_m", "tooth_phase", "tooth_sharpness",
    "inv_knee_s_m", "knee_ref_m_s", "edge_n", "chip_share", "chip_ref_mm", "chip_edge_mm", "wear_per_m",
    "wear_power", "grain_depth", "delay_share",
    # supply
    "brush_v", "diode_v", "diode_ohm", "switch_v", "switch_ohm", "idle_w", "limit_a", "extra_ohm",
    "extra_soc",
    "polar_fast_ohm", "polar_fast_s", "polar_slow_ohm", "polar_slow_s", "polar_kinetic_v",
    "surplus_v", "surplus_share", "plateau_v",
    # outside the catalogue
    "sway_depth", "sway_hz", "alternate_depth", "ripple_v", "ripple_hz", "duty_wander",
    "grease_torque", "whip_kg", "whip_hz", "soft_start_s", "bounce_ohm",
    "cogging_torque", "cogging_slots", "cogging_phase", "cogging_second",
)  # fmt: skip
# Open-circuit voltage at evenly spaced states of charge from 0 to 1; zeros where Eq. 16 holds.
N_OPEN_CIRCUIT = 401
RECORD = np.dtype([*((name, np.float64) for name in FIELDS), ("open_circuit_v", np.float64, (N_OPEN_CIRCUIT,))])
TABLE_STEP_MM = 0.05
WANDER_STEP_S = 0.004


@njit(cache=True)
def _lookup(table, position):
    """Linear interpolation in a periodic table at a position counted in cells."""
    cell = int(np.floor(position))
    part = position - cell
    n = len(table)
    return (1.0 - part) * table[cell % n] + part * table[(cell + 1) % n]


@njit(cache=True)
def _travel(phi, p):
    """Position of the pin along the stroke, m, and its first and second derivative by the crank angle, m.

    A rod of length l > 0 leans by r sin(phi) over its length; x = r (1 - cos phi) + l - sqrt(l^2 - r^2 sin^2 phi).
    Without one (0) the crank pin slides in a yoke.
    """
    s, c = sin(phi), cos(phi)
    x, slope, bend = p.radius * (1.0 - c), p.radius * s, p.radius * c
    if p.rod > 0.0:
        side = p.radius * s
        height = sqrt(p.rod * p.rod - side * side)
        lean = side * p.radius * c / height
        x += p.rod - height
        slope += lean
        bend += (p.radius * p.radius * (c * c - s * s) + lean * lean) / height
    return x, slope, bend


@njit(cache=True)
def _cutting_force(v_tip, x_tip, gain, p):
    """Force on the workpiece along the cutting direction, N; `gain` in N s/m with all slow factors."""
    if p.cuts == 0.0:
        return 0.0
    if v_tip <= 0.0:
        speed = -v_tip
        return -p.rub_n * (1.0 - exp(-speed / 0.12)) * (0.7 + 0.3 * x_tip / (2.0 * p.radius))
    force = gain * v_tip
    if p.inv_knee_s_m > 0.0:
        force *= (1.0 + p.knee_ref_m_s * p.inv_knee_s_m) / (1.0 + v_tip * p.inv_knee_s_m)
    if p.edge_n != 0.0:
        force += p.edge_n * p.width_ratio * (gain / p.k_fc) * v_tip / sqrt(v_tip * v_tip + 0.0004)
    if p.tooth_depth != 0.0:
        angle = 2.0 * pi * x_tip / p.tooth_pitch_m + p.tooth_phase
        saw = atan2(p.tooth_sharpness * sin(angle), 1.0 - p.tooth_sharpness * cos(angle))
        force *= 1.0 + p.tooth_depth * saw / asin(p.tooth_sharpness)
    if p.delay_share > 0.0:
        travelled = x_tip / (2.0 * p.radius)
        if p.cut_direction < 0.0:
            travelled = 1.0 - travelled
        force *= 0.5 * (1.0 + tanh(10.0 * (travelled / p.delay_share - 1.0)))
    return force


@njit(cache=True)
def _cutting_gain(t, y, p, strokes, grain):
    """Slow factors on k_Fc: stroke scatter, wear, chip thickness, grain, sway; N s/m."""
    stroke = int(np.floor(y[2] / (2.0 * pi)))
    gain = p.k_fc * strokes[stroke % len(strokes)]
    if p.wear_per_m != 0.0:
        gain *= 1.0 + p.wear_per_m * max(y[12], 0.0) ** p.wear_power
    if p.chip_share != 0.0:
        chip_mm = p.feed_mm_s / (max(y[15], 0.0) + 1.0)
        chip_mm /= sqrt(1.0 + (chip_mm / (2.2 * p.chip_ref_mm)) ** 2)
        gain *= max(1.0 + p.chip_share * (chip_mm - p.chip_ref_mm) / (p.chip_ref_mm + p.chip_edge_mm), 0.05)
    if p.grain_depth != 0.0:
        gain *= max(1.0 + p.grain_depth * _lookup(grain, y[13] / TABLE_STEP_MM), 0.05)
    if p.sway_depth != 0.0:
        gain *= 1.0 + p.sway_depth * sin(2.0 * pi * p.sway_hz * t)
    if p.alternate_depth != 0.0:
        gain *= 1.0 + p.alternate_depth * (1.0 if stroke % 2 == 0 else -1.0)
    return gain


@njit(cache=True)
def _tip_speed(v_cut, deflection, x, gain, p):
    """Speed of the tooth line behind a compliant blade: k d + c (v - v_tip) = F(v_tip)."""
    pull = p.blade_n_m * deflection + p.blade_n_s_m * v_cut
    v_tip = pull / (gain + p.blade_n_s_m)
    for _ in range(4):
        slope = gain
        if abs(v_tip) > 1e-6:
            slope = max(_cutting_force(v_tip, x, gain, p) / v_tip, 0.0)
        v_tip = 0.5 * v_tip + 0.5 * pull / (slope + p.blade_n_s_m)
    return v_tip


@njit(cache=True)
def _guide_friction(v, bristle, p, dy):
    """LuGre friction of the plunger guide, N, against +x; fills the bristle's rate."""
    if p.guide_n == 0.0:
        dy[8] = 0.0
        return 0.0
    level = 1.0 + p.guide_stribeck * exp(-((v / 0.06) ** 2))
    rate = v - abs(v) * bristle / (level * p.guide_presliding_m)
    dy[8] = rate
    stiffness = p.guide_n / p.guide_presliding_m
    return stiffness * bristle + 0.15 * sqrt(stiffness) * rate * exp(-((v / 0.05) ** 2))


@njit(cache=True)
def _supply(t, y, p, wander, out):
    """Motor voltage, V; writes the battery's voltage and current to `out`, its rates are the caller's."""
    i = y[0]
    charge = min(max(1.0 - y[3] / p.capacity_as, 1e-6), 1.0)
    if p.open_circuit_v[N_OPEN_CIRCUIT - 1] > 0.0:
        place = charge * (N_OPEN_CIRCUIT - 1)
        cell = min(int(place), N_OPEN_CIRCUIT - 2)
        low, high = p.open_circuit_v[cell], p.open_circuit_v[cell + 1]
        v_open = low + (place - cell) * (high - low) - y[4] - y[5]
    else:
        v_open = p.v_nominal * charge / (1.0 - p.beta * (1.0 - charge)) - y[4] - y[5]
    if p.surplus_v != 0.0:
        used = 1.0 - charge
        v_open += p.surplus_v / (1.0 + used / p.surplus_share) ** 2 - p.plateau_v * tanh(used / 0.25)
    if p.ripple_v != 0.0:
        v_open += p.ripple_v * (sin(2.0 * pi * p.ripple_hz * t) + 0.3 * sin(4.0 * pi * p.ripple_hz * t + 1.0))
    r_battery = p.r_battery + p.extra_ohm * (1.0 + p.extra_soc * (1.0 - charge))
    if p.is_on == 0.0:
        out[3] = v_open
        out[4] = 0.0
        return 0.0
    duty = p.duty
    if p.duty_wander != 0.0:
        duty *= 1.0 + p.duty_wander * _lookup(wander, t / WANDER_STEP_S)
    if p.soft_start_s > 0.0:
        duty *= 1.0 - exp(-max(t, 0.0) / p.soft_start_s)
    if p.limit_a > 0.0:
        duty = max(duty - 0.03 * max(i - p.limit_a, 0.0) - y[14], 0.0)
    if p.held_v > 0.0:
        v_battery = 0.5 * (v_open + sqrt(max(v_open * v_open - 4.0 * r_battery * p.held_v * i, 0.0)))
        duty = p.held_v / max(v_battery, 1e-3)
    i_battery = duty * i
    if p.switch_v != 0.0 or p.switch_ohm != 0.0 or p.idle_w != 0.0:
        i_battery += (p.switch_v * abs(i) + p.switch_ohm * i * i + p.idle_w) / max(v_open, 1.0)
    v_battery = v_open - r_battery * i_battery
    if p.polar_kinetic_v != 0.0:
        v_battery -= p.polar_kinetic_v * asinh(i_battery / 2.0)
    out[3] = v_battery
    out[4] = i_battery
    motor_v = duty * v_battery
    if p.diode_v != 0.0 or p.diode_ohm != 0.0:
        motor_v -= (1.0 - duty) * (p.diode_v * log1p(max(i, 0.0) / 0.4) / log1p(25.0) + p.diode_ohm * i)
    return motor_v


@njit(cache=True)
def _magnet(y, p):
    """Share of the magnets' flux that is left at the housing's temperature."""
    return 1.0 - p.magnet_per_k * y[7] * (1.0 + 0.003 * y[7])


@njit(cache=True)
def _current_rate(t, y, p, wander, motor_v):
    """Return di/dt, A/s."""
    i, w = y[0], y[1]
    resistance = p.resistance * (1.0 + p.copper_per_k * y[6])
    if p.bounce_ohm != 0.0:
        resistance += p.bounce_ohm * max(_lookup(wander, t / WANDER_STEP_S + 0.5 * len(wander)), 0.0)
    emf = p.k_e * _magnet(y, p) * w
    drop = 0.0
    if p.brush_v != 0.0:
        size = abs(i)
        drop = p.brush_v * (1.0 - exp(-size / 0.7)) * (1.0 + 0.05 * log1p(size)) * (1.0 if i > 0.0 else -1.0)
    rate = (motor_v - drop - resistance * i - emf) / p.inductance
    if p.is_on == 0.0 and i <= 0.0 and rate < 0.0:
        return 0.0
    return rate


@njit(cache=True)
def _drag_torque(y, p):
    """Speed-dependent losses at the motor shaft, N m, against +w."""
    w = y[1]
    torque = p.damping * w
    if p.brush_friction != 0.0:
        torque += p.brush_friction * tanh(w / 3.0) * (1.0 + 0.35 * exp(-((w / 60.0) ** 2)))
    if p.windage != 0.0:
        torque += p.windage * (abs(w) / 1000.0) ** p.windage_power * (1.0 if w > 0.0 else -1.0)
    if p.grease_torque != 0.0:
        torque += p.grease_torque * exp(-y[16] / 6.0) * sqrt(abs(w) / 1000.0) * (1.0 if w > 0.0 else -1.0)
    if p.mesh_torque != 0.0:
        torque += p.mesh_torque * (exp(0.7 * cos(y[2] - p.mesh_phase)) - 1.1263) / 0.75 * tanh(w / 3.0)
    if p.cogging_torque != 0.0:
        angle = p.cogging_slots * y[2] * p.gear + p.cogging_phase
        wave = sin(angle) + p.cogging_second * sin(2.0 * angle)
        torque += p.cogging_torque * wave / sqrt(1.0 + p.cogging_second * p.cogging_second)
    return torque


# Size: compiled, so what it takes and gives are numbers and arrays, each on its own.
@njit(cache=True)
def _blade_side(t, y, v, x, pin_m_s2, p, strokes, grain, dy, out):
    """Force of guide, blade and workpiece on the plunger, N, +x, and the speed of the tooth line, m/s.

    `x`, `v`: position and speed of the plunger; `pin_m_s2`: acceleration of the pin at steady speed. Fills the rates
    of bristle, deflection and whip, and the force and position outputs.
    """
    v_tip = p.cut_direction * v
    gain = _cutting_gain(t, y, p, strokes, grain)
    dy[11] = 0.0
    if p.blade_n_m > 0.0 and p.cuts != 0.0:
        v_tip = _tip_speed(p.cut_direction * v, y[11], x, gain, p)
        dy[11] = p.cut_direction * v - v_tip
    force = _cutting_force(v_tip, x, gain, p)
    dy[17] = 0.0
    dy[18] = 0.0
    if p.whip_kg > 0.0:
        natural = 2.0 * pi * p.whip_hz
        dy[17] = y[18]
        dy[18] = -natural * natural * y[17] - 0.05 * natural * y[18] - pin_m_s2
        force += p.whip_kg * natural * natural * y[17]
    out[0] = force
    out[1] = x
    return -_guide_friction(v, y[8], p, dy) - p.cut_direction * force, v_tip


@njit(cache=True)
def _shaft_rates(y, v, pin, ratio, environment, p, dy):
    """Fill the rates of the motor speed and, where the yoke has play, of the plunger.

    `pin`: of `_travel`.
    """
    w, phi = y[1], y[2]
    _, slope, bend = pin
    v_pin = slope * w * ratio
    load = environment
    mass = p.mass
    dy[9] = 0.0
    dy[10] = 0.0
    if p.gap_m > 0.0:
        mass = 0.0
        load = _contact(y[9], v - v_pin, p)
        dy[9] = v - v_pin
        dy[10] = (environment - load) / p.mass
    moving = p.yoke_inertia + mass * slope * slope
    ratio_slope = -p.mesh_error_rad * sin(phi - p.mesh_phase) / p.gear
    inertia_slope = 2.0 * ratio * ratio * (ratio_slope * moving + ratio * mass * slope * bend)
    load_torque = load * slope * ratio
    torque = p.k_m * _magnet(y, p) * y[0] - _drag_torque(y, p) + load_torque - 0.5 * inertia_slope * w * w
    if p.mesh_mu != 0.0:
        rub = sqrt(load_torque * load_torque + 1.6e-5) - 0.004
        torque -= p.mesh_mu * (1.0 + 0.4 * exp(-abs(w) / 200.0)) * rub * tanh(w / 3.0)
    dy[1] = torque / (p.rotor_inertia + ratio * ratio * moving)


@njit(cache=True)
def evaluate(t, y, p, strokes, grain, wander, dy, out):
    """Fill the rates `dy` and the outputs `out` at time `t` (s after switching on) and state `y`.

    `strokes`: factor on k_Fc per stroke; `grain`: unit-variance texture along the feed path, one value per
    `TABLE_STEP_MM`; `wander`: unit-variance noise in time, one value per `WANDER_STEP_S`.
    """
    ratio = (1.0 + p.mesh_error_rad * cos(y[2] - p.mesh_phase)) / p.gear
    crank_speed = y[1] * ratio
    pin = _travel(y[2], p)
    v, x = pin[1] * crank_speed, pin[0]
    if p.gap_m > 0.0:
        v, x = y[10], x + y[9]
    environment, v_tip = _blade_side(t, y, v, x, pin[2] * crank_speed * crank_speed, p, strokes, grain, dy, out)
    _shaft_rates(y, v, pin, ratio, environment, p, dy)
    motor_v = _supply(t, y, p, wander, out)
    dy[0] = _current_rate(t, y, p, wander, motor_v)
    dy[2] = crank_speed
    dy[3] = out[4]
    _slow_rates(y, p, v_tip, out, dy)
    out[2] = y[0]
    out[5] = y[2]
    out[6] = y[1]


@njit(cache=True)
def _contact(lost, closing, p):
    """Force of the plunger on the pin, N, +x: a spring with Hunt-Crossley loss beyond half the gap."""
    depth = abs(lost) - 0.5 * p.gap_m
    if depth <= 0.0:
        return 0.0
    side = 1.0 if lost > 0.0 else -1.0
    return side * max(p.contact_n_m * depth * (1.0 + p.contact_loss_s_m * side * closing), 0.0)


@njit(cache=True)
def _slow_rates(y, p, v_tip, out, dy):
    """Rates of polarization, heat, wear, feed, current limit and filtered stroke rate."""
    i, w = y[0], y[1]
    dy[4] = (p.polar_fast_ohm * out[4] - y[4]) / p.polar_fast_s if p.polar_fast_ohm > 0.0 else 0.0
    dy[5] = (p.polar_slow_ohm * out[4] - y[5]) / p.polar_slow_s if p.polar_slow_ohm > 0.0 else 0.0
    exchange = (y[6] - y[7]) / p.r_wind_house
    dy[6] = (p.resistance * i * i - exchange) / p.c_winding
    dy[7] = (exchange + p.damping * w * w - y[7] / p.r_house_air) / p.c_housing
    dy[12] = v_tip if p.cuts != 0.0 and v_tip > 0.0 else 0.0
    dy[13] = p.feed_mm_s if p.cuts != 0.0 and p.is_on != 0.0 else 0.0
    dy[14] = 0.0
    if p.limit_a > 0.0:
        dy[14] = 1.5 * (i - p.limit_a) if i > p.limit_a else -8.0 * y[14]
    dy[15] = (dy[2] / (2.0 * pi) - y[15]) / 0.15
    dy[16] = w * 2e-4 - y[16] / 60.0 if p.grease_torque != 0.0 else 0.0
