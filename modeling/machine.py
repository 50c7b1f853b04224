"""The equations of the baseline machine as the kernels see them, in crank coordinates.

With the crank angle a, the crank speed W = da/dt, the gear ratio G, g(a) = dy/da and g'(a):

    L di/dt = e - R_x i - k_e G W                                         (Eq. 12)
    J(a) dW/dt = G k_m i - b G^2 W - T_c(a, W) - m_a g g' W^2             (Eq. 13 times G)
    J(a) = G^2 J_m + J_c + m_a g^2                                        (Eq. 6 times G^2)
    T_c = k_Fc g^2 W on the cutting half, or F(a) s g                     (Eq. 9)

e and R_x gather the supply, so that the battery's own resistance is solved, not iterated:
a fixed duty d gives e = d E - (1 - d) V_f and R_x = R + d^2 R_b / eta.
"""

from __future__ import annotations

import math

from modeling import slots
from modeling.batteries.eq16 import voltage
from modeling.compilation import kernel
from modeling.mechanisms import scotch_yoke, slider_crank

TWO_PI = 2.0 * math.pi


@kernel()
def machine(p):
    """Gather what every evaluation needs from a parameter vector, as one tuple of 18 floats."""
    duty = p[slots.DUTY]
    below = 1.0 / p[slots.EFFICIENCY]
    drop = p[slots.DIODE]
    gear = p[slots.GEAR]
    extra = 0.0
    if p[slots.MODE] == slots.FIXED_DUTY:
        extra = duty * duty * p[slots.BATTERY_RESISTANCE] * below
    return (
        p[slots.RESISTANCE] + extra,  # 0: R_x
        1.0 / p[slots.INDUCTANCE],  # 1
        p[slots.BACK_EMF] * gear,  # 2
        p[slots.TORQUE_CONSTANT] * gear,  # 3
        p[slots.DAMPING] * gear * gear,  # 4
        p[slots.ROTOR_INERTIA] * gear * gear + p[slots.YOKE_INERTIA],  # 5
        p[slots.MASS],  # 6
        p[slots.MODE],  # 7
        duty,  # 8
        p[slots.VOLTAGE],  # 9
        p[slots.NOMINAL_VOLTAGE],  # 10
        p[slots.BETA],  # 11
        p[slots.CAPACITY_RATIO],  # 12
        p[slots.BATTERY_RESISTANCE] * below,  # 13: per ampere of duty * motor current
        drop,  # 14
        below,  # 15
        1.0 / p[slots.CAPACITY],  # 16
        extra,  # 17
    )


@kernel()
def source(m, soc, current):
    """Voltage e of Eq. 12 and battery current, V and A.

    For a held voltage U the duty solves d (E + V_f - R_b d i / eta) = U + V_f; where it would pass 1 the converter
    is fully on.
    """
    mode = m[7]
    if mode == slots.FIXED_VOLTAGE:
        return m[9], 0.0
    ocv, _ = voltage(m[10], m[11], 1.0 - (1.0 - soc) * m[12])
    if mode == slots.FIXED_DUTY:
        return m[8] * (ocv + m[14]) - m[14], m[8] * current * m[15]
    sag = m[13] * current
    wanted = m[9] + m[14]
    head = ocv + m[14]
    square = head * head - 4.0 * sag * wanted
    if square >= 0.0:
        duty = 2.0 * wanted / (head + math.sqrt(square))
        if 0.0 <= duty <= 1.0:
            return m[9], duty * current * m[15]
    return ocv - sag, current * m[15]


@kernel()
def source_rate(m, soc, soc_rate):
    """de/dt of Eq. 12, V/s."""
    if m[7] != slots.FIXED_DUTY:
        return 0.0
    _, slope = voltage(m[10], m[11], 1.0 - (1.0 - soc) * m[12])
    return m[8] * slope * m[12] * soc_rate


@kernel()
def levers(p, sine, cosine):
    """g and g' of the mechanism in the vector, m."""
    if p[slots.ROD] > 0.0:
        return slider_crank.lever(sine, cosine, p[slots.RADIUS], p[slots.ROD])
    return scotch_yoke.lever(sine, cosine, p[slots.RADIUS])


@kernel()
def spline_force(spline, turn):
    """Force of a measured table at an angle in [0, 2*pi), N; `spline` as MeasuredForce.spline gives it."""
    n_nodes = len(spline)
    if n_nodes == 0:
        return 0.0
    width = TWO_PI / n_nodes
    place = int(turn / width)
    place = max(min(place, n_nodes - 1), 0)
    u = turn - place * width
    return spline[place, 0] + u * (spline[place, 1] + u * (spline[place, 2] + u * spline[place, 3]))


@kernel()
def load(p, m, spline, turn, is_cutting):
    """What the mechanical equation needs at an angle in [0, 2*pi]: 1/J, m g g', torque per speed, speed-free torque."""
    g, slope = levers(p, math.sin(turn), math.cos(turn))
    per_speed = m[4]
    constant = 0.0
    if is_cutting:
        per_speed += p[slots.K_FC] * g * g
    if p[slots.FORCE_SCALE] != 0.0:
        constant = p[slots.FORCE_SCALE] * spline_force(spline, turn) * p[slots.CUTTING_SIGN] * g
    return 1.0 / (m[5] + m[6] * g * g), m[6] * g * slope, per_speed, constant


@kernel()
def fill_tables(p, m, spline, n_steps, fractions, tables):
    """Fill `tables`, shape (n_steps, n_stages, 4), with `load` at the stages of equal steps from angle 0."""
    step = TWO_PI / n_steps
    half = n_steps // 2
    cuts_first = p[slots.CUTTING_SIGN] > 0.0
    for n in range(n_steps):
        is_cutting = (n < half) == cuts_first
        for s in range(len(fractions)):
            values = load(p, m, spline, (n + fractions[s]) * step, is_cutting)
            for c in range(4):
                tables[n, s, c] = values[c]
