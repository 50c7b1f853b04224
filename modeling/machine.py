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
from modeling.compilation import kernel
from modeling.mechanisms import scotch_yoke, slider_crank

TWO_PI = 2.0 * math.pi


@kernel()
def machine(p):
    """Gather what every evaluation needs from a parameter vector, as one tuple of 20 floats."""
    duty = p[slots.DUTY]
    below = 1.0 / p[slots.EFFICIENCY]
    drop = p[slots.DIODE]
    gear = p[slots.GEAR]
    extra = 0.0
    share = below  # of the motor current, or of duty times motor current, that the battery gives
    if p[slots.MODE] == slots.FIXED_DUTY:
        extra = duty * duty * p[slots.BATTERY_RESISTANCE] * below
        share = duty * below
    elif p[slots.MODE] == slots.FIXED_VOLTAGE:
        share = 0.0
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
        share,  # 15
        1.0 / p[slots.CAPACITY],  # 16
        extra,  # 17
        p[slots.SAG],  # 18
        p[slots.BRUSH_OFFSET],  # 19
    )


@kernel()
def open_circuit(m, ocv, soc):
    """Open-circuit voltage of the battery, its first and half its second derivative over the charge, V.

    From the table `ocv`, shape (n, 4): cubic pieces on equal parts of [0, 1], where it has rows; else Eq. 16.
    """
    n_pieces = len(ocv)
    if n_pieces > 0:
        place = max(min(int(soc * n_pieces), n_pieces - 1), 0)
        u = soc - place / n_pieces
        c = ocv[place]
        value = c[0] + u * (c[1] + u * (c[2] + u * c[3]))
        return value - m[18], c[1] + u * (2.0 * c[2] + 3.0 * u * c[3]), c[2] + 3.0 * u * c[3]
    filled = max(1.0 - (1.0 - soc) * m[12], 0.0)
    below = 1.0 / (1.0 - m[11] * (1.0 - filled))
    slope = m[10] * (1.0 - m[11]) * below * below * m[12]
    return m[10] * filled * below - m[18], slope, -slope * m[11] * below * m[12]


@kernel()
def drive(m, ocv, soc):
    """Gather what `source` needs of a state of charge: three terms of a power series over the charge, V.

    Of the voltage e for a fixed voltage or duty, of the open-circuit voltage for a held voltage. Within one
    step the three terms are exact to rounding, and save a division in every stage.
    """
    if m[7] == slots.FIXED_VOLTAGE:
        return m[9] - m[19], 0.0, 0.0
    value, first, second = open_circuit(m, ocv, soc)
    if m[7] == slots.FIXED_DUTY:
        return m[8] * (value + m[14]) - m[14] - m[19], m[8] * first, m[8] * second
    return value, first, second


@kernel()
def source(m, curve, away, current):
    """Voltage e of Eq. 12 and battery current, V and A, at a charge `away` from where `curve` is `drive`.

    For a held voltage U the duty solves d (E + V_f - R_b d i / eta) = U + V_f; where it would pass 1 the
    converter is fully on.
    """
    value = curve[0] + away * (curve[1] + away * curve[2])
    if m[7] != slots.HELD_VOLTAGE:
        return value, m[15] * current
    sag = m[13] * current
    wanted = m[9] + m[14]
    head = value + m[14]
    square = head * head - 4.0 * sag * wanted
    if square >= 0.0:
        duty = 2.0 * wanted / (head + math.sqrt(square))
        if 0.0 <= duty <= 1.0:
            return m[9] - m[19], duty * current * m[15]
    return value - sag - m[19], current * m[15]


@kernel()
def source_slopes(m, curve, current):
    """`source` at the place of `curve`, and the derivatives of e and battery current by the motor current."""
    e, battery_current = source(m, curve, 0.0, current)
    if m[7] != slots.HELD_VOLTAGE:
        return e, battery_current, 0.0, m[15]
    if e != m[9] - m[19]:
        return e, battery_current, -m[13], m[15]
    head = curve[0] + m[14]
    root = math.sqrt(head * head - 4.0 * m[13] * current * (m[9] + m[14]))
    duty = 2.0 * (m[9] + m[14]) / (head + root)
    return e, battery_current, 0.0, (duty + current * m[13] * duty * duty / root) * m[15]


@kernel()
def source_rate(m, curve, away, soc_rate):
    """de/dt of Eq. 12, V/s; arguments as in `source`."""
    if m[7] == slots.HELD_VOLTAGE:
        return 0.0
    return (curve[1] + 2.0 * away * curve[2]) * soc_rate


C2, C4, C6, C8, C10 = -1 / 2, 1 / 24, -1 / 720, 1 / 40320, -1 / 3628800
C12, C14, C16, C18, C20 = (
    1 / math.factorial(12),
    -1 / math.factorial(14),
    1 / math.factorial(16),
    -1 / math.factorial(18),
    1 / math.factorial(20),
)
S3, S5, S7, S9, S11 = -1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800
S13, S15, S17, S19 = (
    1 / math.factorial(13),
    -1 / math.factorial(15),
    1 / math.factorial(17),
    -1 / math.factorial(19),
)


@kernel()
def sine_cosine(half_turn):
    """Sine and cosine of an angle in [0, pi], rad, to rounding.

    Taylor polynomials about pi/2, summed in pairs so that the terms need not wait for each other: several
    times faster than two calls to the library, which must reduce any angle.
    """
    z = half_turn - 0.5 * math.pi
    q = z * z
    q2 = q * q
    q4 = q2 * q2
    q8 = q4 * q4
    cosine = (1.0 + C2 * q + q2 * (C4 + C6 * q)) + q4 * ((C8 + C10 * q) + q2 * (C12 + C14 * q))
    cosine += q8 * (C16 + C18 * q + C20 * q2)
    sine = (1.0 + S3 * q + q2 * (S5 + S7 * q)) + q4 * ((S9 + S11 * q) + q2 * (S13 + S15 * q))
    sine += q8 * (S17 + S19 * q)
    return cosine, -z * sine


@kernel()
def cutter(p):
    """Gather mechanism and cutting force: radius, rod, k_Fc, force scale, sign of the cutting half."""
    return p[slots.RADIUS], p[slots.ROD], p[slots.K_FC], p[slots.FORCE_SCALE], p[slots.CUTTING_SIGN]


@kernel()
def levers(c, sine, cosine):
    """G and g' of the mechanism, m; `c` is `cutter`."""
    if c[1] > 0.0:
        return slider_crank.lever(sine, cosine, c[0], c[1])
    return scotch_yoke.lever(sine, cosine, c[0])


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
def load_at(c, m, spline, sine, cosine, turn, is_cutting):
    """Return what the mechanical equation needs: 1/J, m g g', torque per speed, torque free of speed."""
    g, slope = levers(c, sine, cosine)
    per_speed = m[4]
    constant = 0.0
    if is_cutting:
        per_speed += c[2] * g * g
    if c[3] != 0.0:
        constant = c[3] * spline_force(spline, turn) * c[4] * g
    return 1.0 / (m[5] + m[6] * g * g), m[6] * g * slope, per_speed, constant


@kernel()
def load(c, m, spline, is_second, part, is_cutting):
    """`load_at` at `part` rad (0..pi) after the first or second dead centre of a turn."""
    sine, cosine = sine_cosine(part)
    if is_second:
        return load_at(c, m, spline, -sine, -cosine, part + math.pi, is_cutting)
    return load_at(c, m, spline, sine, cosine, part, is_cutting)


@kernel()
def fill_tables(p, m, spline, n_steps, fractions, tables):
    """Fill `tables`, shape (n_steps, n_stages, 4), with `load_at` at the stages of equal steps from angle 0.

    Each angle is the sum of a step's and a stage's, so that their sines and cosines are few.
    """
    c = cutter(p)
    step = TWO_PI / n_steps
    half = n_steps // 2
    cuts_first = c[4] > 0.0
    for s in range(len(fractions)):
        stage_sine, stage_cosine = sine_cosine(fractions[s] * step)
        for n in range(half):
            tables[n, s, 0], tables[n, s, 1] = stage_sine, stage_cosine
    for n in range(half):
        step_sine, step_cosine = sine_cosine(n * step)
        for s in range(len(fractions)):
            low, high = tables[n, s], tables[n + half, s]
            sine = step_sine * low[1] + step_cosine * low[0]
            cosine = step_cosine * low[1] - step_sine * low[0]
            angle = (n + fractions[s]) * step
            low[0], low[1], low[2], low[3] = load_at(c, m, spline, sine, cosine, angle, cuts_first)
            angle += math.pi
            high[0], high[1], high[2], high[3] = load_at(c, m, spline, -sine, -cosine, angle, not cuts_first)
