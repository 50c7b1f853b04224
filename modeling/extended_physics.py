"""The machine with everything the baseline leaves out: rates of an extended state, and what is seen of it.

Every effect is a slot of the parameter vector and vanishes at its default. The crank turns one way, so the
sign of the blade's motion is the half turn it is in; where an effect needs the sign of the motion itself
(dry friction at rest) a tanh of the crank speed stands for it, `STILL` rad/s wide, a four-hundredth of a
working speed: the crank then creeps where a real one sticks.

Approximations, by slot: a backlash holds the blade still until the pin has crossed it, the mass stays
coupled (no impact); blade compliance delays the linear law, F + k_Fc/k_b dF/dt = law; the chip
thickness takes the stroke rate of the turn before; the magnets are as warm as the winding; cutting_exponent
is smoothed below SLOW m/s, the brush drop below FAINT A.
"""

from __future__ import annotations

import math

from modeling import slots
from modeling.compilation import kernel
from modeling.machine import TWO_PI, levers, sine_cosine, spline_force
from modeling.mechanisms import scotch_yoke, slider_crank

STILL = 0.2
SLOW = 0.005
FAINT = 0.1

# The state, then integrals for the energy balance.
CURRENT, SPEED, ANGLE, SOC, FORCE, HEAT, RC, POLARIZATION, DISTANCE = range(9)
SUPPLIED, COPPER, CONVERTED, DAMPED, CUT, OTHER, MOTOR_CHARGE = range(9, 16)
N_STATES = 9
N_ALL = 16

# Rows of what an observer sees.
SEEN_FORCE, SEEN_DISPLACEMENT, SEEN_MOTOR_VOLTAGE, SEEN_BATTERY_VOLTAGE, SEEN_BATTERY_CURRENT = range(5)
N_SEEN = 5


@kernel()
def supply(p, ocv, soc, sagged, current):
    """Motor voltage, battery voltage, battery current: V, V, A; `sagged` is lost in RC elements, V."""
    if p[slots.MODE] == slots.FIXED_VOLTAGE:
        return p[slots.VOLTAGE], p[slots.VOLTAGE], current
    n_pieces = len(ocv)
    if n_pieces > 0:
        place = max(min(int(soc * n_pieces), n_pieces - 1), 0)
        u = soc - place / n_pieces
        inner = ocv[place, 0] + u * (ocv[place, 1] + u * (ocv[place, 2] + u * ocv[place, 3]))
    else:
        filled = max(1.0 - (1.0 - soc) * p[slots.CAPACITY_RATIO], 0.0)
        inner = p[slots.NOMINAL_VOLTAGE] * filled / (1.0 - p[slots.BETA] * (1.0 - filled))
    inner -= sagged
    resistance = p[slots.BATTERY_RESISTANCE] + p[slots.EXTRA_RESISTANCE]
    below = 1.0 / p[slots.EFFICIENCY]
    drop = p[slots.DIODE]
    if p[slots.MODE] == slots.FIXED_DUTY:
        battery_current = p[slots.DUTY] * current * below
        terminal = inner - resistance * battery_current
        return p[slots.DUTY] * (terminal + drop) - drop, terminal, battery_current
    return trimmed(inner, resistance, below, drop, p[slots.VOLTAGE], current)


@kernel()
def trimmed(inner, resistance, below, drop, wanted, current):
    """`supply` of a converter that trims its duty to hold a wanted motor voltage, or is fully on."""
    head = inner + drop
    square = head * head - 4.0 * resistance * below * current * (wanted + drop)
    duty = 1.0
    if square >= 0.0:
        duty = 2.0 * (wanted + drop) / (head + math.sqrt(square))
        if not 0.0 <= duty <= 1.0:
            duty = 1.0
    battery_current = duty * current * below
    terminal = inner - resistance * battery_current
    return duty * (terminal + drop) - drop, terminal, battery_current


@kernel()
def brush(p, current):
    """Voltage across the brushes, V."""
    return p[slots.BRUSH] * math.tanh(current / FAINT) if p[slots.BRUSH] != 0.0 else 0.0


@kernel()
def limited_supply(p, ocv, soc, sagged, current, back_emf_and_drops):
    """`supply` while the current limit holds: the motor gets just what keeps its current."""
    volt, terminal, battery_current = supply(p, ocv, soc, sagged, current)
    if back_emf_and_drops >= volt or p[slots.MODE] == slots.FIXED_VOLTAGE:
        return min(volt, back_emf_and_drops), terminal, battery_current
    # Power keeps: the battery gives the motor's share of the reduced voltage.
    inner = terminal + (p[slots.BATTERY_RESISTANCE] + p[slots.EXTRA_RESISTANCE]) * battery_current
    return trimmed(
        inner,
        p[slots.BATTERY_RESISTANCE] + p[slots.EXTRA_RESISTANCE],
        1.0 / p[slots.EFFICIENCY],
        p[slots.DIODE],
        max(back_emf_and_drops, 0.0),
        current,
    )


@kernel()
def displacement(p, is_second, sine, cosine):
    """Blade displacement with the backlash's play, m."""
    if p[slots.ROD] > 0.0:
        pin = slider_crank.displacement(sine, cosine, p[slots.RADIUS], p[slots.ROD])
    else:
        pin = scotch_yoke.displacement(sine, cosine, p[slots.RADIUS])
    gap = p[slots.BACKLASH]
    if gap <= 0.0:
        return pin
    if is_second:
        return min(pin + 0.5 * gap, 2.0 * p[slots.RADIUS] - 0.5 * gap)
    return max(pin - 0.5 * gap, 0.5 * gap)


@kernel()
def cutting_law(p, spline, place, turn, speed, blade_at, t, distance, moving):
    """Cutting force that the law asks for, N, at a blade speed in the cutting direction, m/s.

    `place` is (is_second, is_cutting, is_engaged, is_free, is_limited, chip).
    """
    force = 0.0
    if place[1] and place[2] and not place[3]:
        along = max(speed, 0.0)
        k = p[slots.K_FC]
        if p[slots.EXPONENT] == 1.0:
            force = k * along
        else:
            reference = p[slots.REFERENCE_SPEED]
            smooth = (along * along + SLOW * SLOW) / (reference * reference)
            force = k * along * smooth ** (0.5 * (p[slots.EXPONENT] - 1.0))
        force += p[slots.EDGE_FORCE] * moving
    if p[slots.FORCE_SCALE] != 0.0 and place[2] and not place[3]:
        force += p[slots.FORCE_SCALE] * spline_force(spline, turn) * moving
    if force == 0.0:
        return 0.0
    gain = place[5] * (1.0 + p[slots.WEAR] * distance)
    if p[slots.GRAIN] != 0.0:
        fed = p[slots.FEED] * t
        gain *= 1.0 + p[slots.GRAIN] * math.sin(TWO_PI * fed / p[slots.GRAIN_LENGTH] + p[slots.GRAIN_PHASE])
    if p[slots.TOOTH] != 0.0:
        gain *= 1.0 + p[slots.TOOTH] * math.sin(TWO_PI * blade_at / p[slots.TOOTH_PITCH] + p[slots.TOOTH_PHASE])
    return force * gain


@kernel()
def extended_rates(p, c, spline, ocv, place, t, y, slow, k):  # noqa: PLR0915
    """Fill `k`, shape (N_ALL,), with the rates over time of `y`; slow quantities are read from `slow`.

    `slow` is `y` itself, or a frozen state for a periodic stroke. `y[ANGLE]` counts from the last dead
    centre.
    """
    i, w = y[CURRENT], y[SPEED]
    gear = p[slots.GEAR]
    sine, cosine = sine_cosine(y[ANGLE])
    turn = y[ANGLE]
    if place[0]:
        sine, cosine, turn = -sine, -cosine, turn + math.pi
    g, bend = levers(c, sine, cosine)
    lever = 0.0 if place[3] else g
    moving = 1.0 if w > 20.0 * STILL else math.tanh(w / STILL)
    blade = lever * w
    # Electrical equation.
    warm = slow[HEAT]
    resistance = p[slots.RESISTANCE] * (1.0 + p[slots.RESISTANCE_TEMPERATURE] * warm)
    magnet = 1.0 + p[slots.MAGNET_TEMPERATURE] * warm
    back_emf = p[slots.BACK_EMF] * magnet * gear * w
    drops = brush(p, i)
    sagged = slow[RC] + slow[POLARIZATION]
    if place[4]:
        needed = resistance * i + back_emf + drops
        volt, _, battery_current = limited_supply(p, ocv, slow[SOC], sagged, i, needed)
        k[CURRENT] = 0.0
        volt = needed
    else:
        volt, _, battery_current = supply(p, ocv, slow[SOC], sagged, i)
        k[CURRENT] = (volt - resistance * i - back_emf - drops) / p[slots.INDUCTANCE]
    # Cutting force and every other load.
    sign = c[4]
    law = cutting_law(
        p,
        spline,
        place,
        turn,
        sign * blade,
        displacement(p, place[0], sine, cosine),
        t,
        slow[DISTANCE],
        moving,
    )
    force = law
    k[FORCE] = 0.0
    if p[slots.COMPLIANCE] > 0.0:
        force = y[FORCE]
        k[FORCE] = (law - force) / (p[slots.COMPLIANCE] * p[slots.K_FC])
    cut = force * sign * lever
    loss = p[slots.MOTOR_COULOMB] * gear * moving + p[slots.WINDAGE] * gear * gear * gear * w * math.fabs(w)
    loss += p[slots.LOAD_FRICTION] * math.fabs(cut) * moving
    if p[slots.ECCENTRICITY] != 0.0:
        loss += p[slots.ECCENTRICITY] * math.sin(turn + p[slots.ECCENTRICITY_PHASE])
    guide = p[slots.GUIDE_COULOMB]
    if p[slots.GUIDE_STATIC] > guide:
        ratio = blade / p[slots.GUIDE_SPEED]
        guide += (p[slots.GUIDE_STATIC] - guide) * math.exp(-ratio * ratio)
    if not place[1]:
        guide += p[slots.RUBBING_CONSTANT]
        loss += p[slots.RUBBING_VISCOUS] * lever * lever * w
    loss += guide * math.fabs(lever) * moving
    damping = p[slots.DAMPING] * gear * gear * w
    torque = p[slots.TORQUE_CONSTANT] * magnet * gear * i
    inertia = p[slots.ROTOR_INERTIA] * gear * gear + p[slots.YOKE_INERTIA] + p[slots.MASS] * g * g
    k[SPEED] = (torque - damping - cut - loss - p[slots.MASS] * g * bend * w * w) / inertia
    k[ANGLE] = w
    # Slow quantities.
    k[SOC] = 0.0 if p[slots.MODE] == slots.FIXED_VOLTAGE else -battery_current / p[slots.CAPACITY]
    k[HEAT] = 0.0
    if p[slots.HEAT_CAPACITY] > 0.0:
        k[HEAT] = (resistance * i * i - warm / p[slots.THERMAL_RESISTANCE]) / p[slots.HEAT_CAPACITY]
    k[RC] = (p[slots.RC_RESISTANCE] * battery_current - slow[RC]) / p[slots.RC_TIME]
    k[POLARIZATION] = (p[slots.POLARIZATION_RESISTANCE] * battery_current - slow[POLARIZATION]) / p[
        slots.POLARIZATION_TIME
    ]
    k[DISTANCE] = max(sign * blade, 0.0) if place[1] and place[2] else 0.0
    # Where the power goes.
    k[SUPPLIED] = volt * i
    k[COPPER] = resistance * i * i
    k[CONVERTED] = back_emf * i - torque * w
    k[DAMPED] = damping * w
    k[CUT] = cut * w
    k[OTHER] = loss * w + drops * i
    k[MOTOR_CHARGE] = i


@kernel()
def observe(p, c, spline, ocv, place, t, y, seen):
    """Fill `seen`, shape (N_SEEN,): force, displacement, motor voltage, battery voltage, battery current."""
    sine, cosine = sine_cosine(min(max(y[ANGLE], 0.0), math.pi))
    turn = y[ANGLE]
    if place[0]:
        sine, cosine, turn = -sine, -cosine, turn + math.pi
    g, _ = levers(c, sine, cosine)
    lever = 0.0 if place[3] else g
    w = y[SPEED]
    moving = 1.0 if w > 20.0 * STILL else math.tanh(w / STILL)
    at = displacement(p, place[0], sine, cosine)
    if p[slots.COMPLIANCE] > 0.0:
        force = y[FORCE]
    else:
        force = cutting_law(p, spline, place, turn, c[4] * lever * w, at, t, y[DISTANCE], moving)
    if not place[1] and not place[3]:
        force -= p[slots.RUBBING_VISCOUS] * math.fabs(lever * w) + p[slots.RUBBING_CONSTANT] * moving
    seen[SEEN_FORCE] = force
    seen[SEEN_DISPLACEMENT] = at
    sagged = y[RC] + y[POLARIZATION]
    if place[4]:
        resistance = p[slots.RESISTANCE] * (1.0 + p[slots.RESISTANCE_TEMPERATURE] * y[HEAT])
        magnet = 1.0 + p[slots.MAGNET_TEMPERATURE] * y[HEAT]
        needed = resistance * y[CURRENT] + p[slots.BACK_EMF] * magnet * p[slots.GEAR] * w + brush(p, y[CURRENT])
        values = limited_supply(p, ocv, y[SOC], sagged, y[CURRENT], needed)
    else:
        values = supply(p, ocv, y[SOC], sagged, y[CURRENT])
    seen[SEEN_MOTOR_VOLTAGE], seen[SEEN_BATTERY_VOLTAGE], seen[SEEN_BATTERY_CURRENT] = values
