"""The machine as the kernels see it, in crank coordinates: its parts put together.

With the crank angle a, the crank speed W = da/dt, the gear ratio G and the lever g(a) = dy/da:

    L di/dt = e - R_x i - k_e G W                                  (Eq. 12, `parts.dc_motor`)
    J(a) dW/dt = G k_m i - d(a) W - T(a) - m_a g g' W^2             (Eq. 13 times G, `parts.crank`)

d(a) gathers the motor's damping and the linear cutting force, T(a) a measured one. e and R_x gather the supply, so that
the battery's own resistance is solved, not iterated: a fixed duty d gives R_x = R + d^2 R_b / eta.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from sawbench.modeling import slots
from sawbench.modeling.compilation import kernel
from sawbench.modeling.dormand_prince import FRACTIONS
from sawbench.modeling.parts import converter, crank, eq16, linear, measured, ocv_table, scotch_yoke, slider_crank

TWO_PI = 2.0 * math.pi


class Machine(NamedTuple):
    """What every evaluation needs of a parameter vector, SI units, at the crank."""

    resistance: float  # R_x
    per_inductance: float
    back_emf: float  # k_e G
    torque_constant: float  # k_m G
    damping: float  # b G^2
    rotating_inertia: float
    mass: float
    radius: float
    rod: float  # 0: Scotch yoke
    gear: float
    k_fc: float
    force_scale: float
    cutting_sign: float
    mode: float
    duty: float
    voltage: float
    forward_voltage: float
    current_share: float  # battery current per motor current at the fixed duty, or at a duty of 1
    nominal_voltage: float
    beta: float
    capacity_ratio: float
    battery_resistance: float
    sag_resistance: float  # of the battery, per ampere of duty times motor current
    source_resistance: float  # part of R_x that is the battery's
    per_capacity: float


@kernel()
def machine(p):
    """Gather a parameter vector."""
    gear, duty, efficiency = p[slots.GEAR], p[slots.DUTY], p[slots.EFFICIENCY]
    share = converter.battery_current(1.0, 1.0, efficiency)
    source_resistance = 0.0
    if p[slots.MODE] == slots.FIXED_DUTY:
        share = converter.battery_current(duty, 1.0, efficiency)
        source_resistance = duty * share * p[slots.BATTERY_RESISTANCE]
    elif p[slots.MODE] == slots.FIXED_VOLTAGE:
        share = 0.0
    return Machine(
        p[slots.RESISTANCE] + source_resistance,
        1.0 / p[slots.INDUCTANCE],
        p[slots.BACK_EMF] * gear,
        p[slots.TORQUE_CONSTANT] * gear,
        p[slots.DAMPING] * gear * gear,
        crank.rotating_inertia(p[slots.ROTOR_INERTIA], p[slots.YOKE_INERTIA], gear),
        p[slots.MASS],
        p[slots.RADIUS],
        p[slots.ROD],
        gear,
        p[slots.K_FC],
        p[slots.FORCE_SCALE],
        p[slots.CUTTING_SIGN],
        p[slots.MODE],
        duty,
        p[slots.VOLTAGE],
        p[slots.DIODE],
        share,
        p[slots.NOMINAL_VOLTAGE],
        p[slots.BETA],
        p[slots.CAPACITY_RATIO],
        p[slots.BATTERY_RESISTANCE],
        p[slots.BATTERY_RESISTANCE] / efficiency,
        source_resistance,
        1.0 / p[slots.CAPACITY],
    )


@kernel()
def open_circuit(m, ocv, soc):
    """Open-circuit voltage of the battery, its first and half its second derivative over the charge, V.

    From the table `ocv`, shape (n, 4), where it has rows; else Eq. 16.
    """
    if len(ocv) > 0:
        return ocv_table.voltage(ocv, soc)
    ratio = m.capacity_ratio
    value, slope, bend = eq16.voltage(m.nominal_voltage, m.beta, 1.0 - (1.0 - soc) * ratio)
    return value, slope * ratio, bend * ratio * ratio


@kernel()
def drive(m, ocv, soc):
    """Gather what `source` needs of a state of charge: three terms of a power series over the charge, V.

    Of the voltage e for a fixed voltage or duty, of the open-circuit voltage for a held voltage. Within one
    step the three terms are exact to rounding, and save a division in every stage.
    """
    if m.mode == slots.FIXED_VOLTAGE:
        return m.voltage, 0.0, 0.0
    value, first, second = open_circuit(m, ocv, soc)
    if m.mode == slots.FIXED_DUTY:
        return converter.motor_voltage(m.duty, value, m.forward_voltage), m.duty * first, m.duty * second
    return value, first, second


@kernel()
def source(m, curve, away, current):
    """Voltage e of Eq. 12 and battery current, V and A, at a charge `away` from where `curve` is `drive`."""
    value = curve[0] + away * (curve[1] + away * curve[2])
    if m.mode != slots.HELD_VOLTAGE:
        return value, m.current_share * current
    sag = m.sag_resistance * current
    duty = converter.holding_duty(value, sag, m.voltage, m.forward_voltage)
    return m.voltage if duty < 1.0 else value - sag, duty * current * m.current_share


@kernel()
def source_slopes(m, curve, current):
    """`source` at the place of `curve`, and the derivatives of e and battery current by the motor current."""
    e, battery_current = source(m, curve, 0.0, current)
    if m.mode != slots.HELD_VOLTAGE:
        return e, battery_current, 0.0, m.current_share
    if e != m.voltage:
        return e, battery_current, -m.sag_resistance, m.current_share
    sag = m.sag_resistance * current
    duty = converter.holding_duty(curve[0], sag, m.voltage, m.forward_voltage)
    bend = m.sag_resistance * duty * duty / (curve[0] + m.forward_voltage - 2.0 * sag * duty)
    return e, battery_current, 0.0, (duty + current * bend) * m.current_share


@kernel()
def source_rate(m, curve, away, soc_rate):
    """de/dt of Eq. 12, V/s; arguments as in `source`."""
    if m.mode == slots.HELD_VOLTAGE:
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
def levers(m, sine, cosine):
    """Lever g of the mechanism and its slope g', m."""
    if m.rod > 0.0:
        return slider_crank.lever(sine, cosine, m.radius, m.rod)
    return scotch_yoke.lever(sine, cosine, m.radius)


@kernel()
def load_at(m, spline, sine, cosine, turn, is_cutting):
    """Return what the mechanical equation needs: 1/J, m g g', torque per speed, torque free of speed."""
    g, slope = levers(m, sine, cosine)
    drag = m.damping
    constant = 0.0
    if is_cutting:
        drag = drag + g * linear.force(m.k_fc, g)
    if m.force_scale != 0.0:
        constant = m.force_scale * measured.spline_force(spline, turn) * m.cutting_sign * g
    inverse_inertia = 1.0 / crank.inertia(m.rotating_inertia, m.mass, g)
    return inverse_inertia, crank.swing(m.mass, g, slope), drag, constant


@kernel()
def load(m, spline, is_second, part, is_cutting):
    """`load_at` at `part` rad (0..pi) after the first or second dead centre of a turn."""
    sine, cosine = sine_cosine(part)
    if is_second:
        return load_at(m, spline, -sine, -cosine, part + math.pi, is_cutting)
    return load_at(m, spline, sine, cosine, part, is_cutting)


@kernel()
def load_tables(m, spline, n_steps):
    """`load_at` at the stages of equal steps from angle 0, shape (n_steps, n_stages, 4).

    Each angle is the sum of a step's and a stage's, so that their sines and cosines are few.
    """
    tables = np.empty((n_steps, len(FRACTIONS), 4))
    step = TWO_PI / n_steps
    half = n_steps // 2
    cuts_first = m.cutting_sign > 0.0
    for s in range(len(FRACTIONS)):
        stage_sine, stage_cosine = sine_cosine(FRACTIONS[s] * step)
        for n in range(n_steps):
            is_second = n >= half
            step_sine, step_cosine = sine_cosine((n - half if is_second else n) * step)
            sine = step_sine * stage_cosine + step_cosine * stage_sine
            cosine = step_cosine * stage_cosine - step_sine * stage_sine
            sign = -1.0 if is_second else 1.0
            angle = (n + FRACTIONS[s]) * step
            row = tables[n, s]
            is_cutting = is_second != cuts_first
            row[0], row[1], row[2], row[3] = load_at(m, spline, sign * sine, sign * cosine, angle, is_cutting)
    return tables
