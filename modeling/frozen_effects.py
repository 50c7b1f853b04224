"""Effects that a periodic stroke can carry at the speed of the baseline.

With slow quantities frozen, most effects only change coefficients: a torque free of speed, a torque per
speed, one in proportion to the speed's square, a resistance, a voltage. Those are written into the load
tables and into an effective parameter vector, and the baseline's own kernels do the rest. The others (a
cutting exponent, a Stribeck dip, blade compliance, a current limit, backlash, delayed engagement) need the
extended kernel; see `is_simple`.
"""

from __future__ import annotations

import math

from modeling import slots
from modeling.compilation import kernel
from modeling.machine import TWO_PI, cutter, levers, sine_cosine, spline_force
from modeling.mechanisms import scotch_yoke, slider_crank


@kernel()
def is_simple(p):
    """Whether a periodic stroke of this vector needs no more than tables and an effective vector."""
    return (
        p[slots.EXPONENT] == 1.0
        and p[slots.GUIDE_STATIC] <= p[slots.GUIDE_COULOMB]
        and p[slots.COMPLIANCE] == 0.0
        and p[slots.CURRENT_LIMIT] == 0.0
        and p[slots.BACKLASH] == 0.0
        and p[slots.ENGAGEMENT] == 0.0
    )


@kernel()
def changes_load(p):
    """Whether any effect changes the load tables."""
    return (
        p[slots.GUIDE_COULOMB] != 0.0
        or p[slots.MOTOR_COULOMB] != 0.0
        or p[slots.WINDAGE] != 0.0
        or p[slots.LOAD_FRICTION] != 0.0
        or p[slots.ECCENTRICITY] != 0.0
        or p[slots.RUBBING_VISCOUS] != 0.0
        or p[slots.RUBBING_CONSTANT] != 0.0
        or p[slots.TOOTH] != 0.0
        or p[slots.EDGE_FORCE] != 0.0
    )


@kernel()
def freeze(p, warm, sagged, distance, turn_s, out):
    """Fill `out` with an effective vector: slow quantities and the chip of a turn of `turn_s` put into it.

    `warm` is the winding's rise of temperature, K; `sagged` the voltage across RC elements, V; `distance`
    cut before, m. Grain averages out over a frozen stroke.
    """
    out[:] = p
    gain = 1.0 + p[slots.WEAR] * distance
    if p[slots.CHIP_EXPONENT] != 0.0:
        gain *= (p[slots.FEED] * turn_s / p[slots.CHIP_REFERENCE]) ** p[slots.CHIP_EXPONENT]
    magnet = 1.0 + p[slots.MAGNET_TEMPERATURE] * warm
    out[slots.K_FC] *= gain
    out[slots.FORCE_SCALE] *= gain
    out[slots.EDGE_FORCE] *= gain
    out[slots.RESISTANCE] *= 1.0 + p[slots.RESISTANCE_TEMPERATURE] * warm
    out[slots.BACK_EMF] *= magnet
    out[slots.TORQUE_CONSTANT] *= magnet
    out[slots.BATTERY_RESISTANCE] += p[slots.EXTRA_RESISTANCE]
    out[slots.SAG] = sagged
    out[slots.BRUSH_OFFSET] = p[slots.BRUSH]


@kernel()
def add_effects(p, n_steps, fractions, tables):
    """Add what effects change to tables that hold the baseline's load."""
    if not changes_load(p):
        return
    c = cutter(p)
    gear = p[slots.GEAR]
    half = n_steps // 2
    step = TWO_PI / n_steps
    rubbing = 1.0 + p[slots.LOAD_FRICTION]
    damping = p[slots.DAMPING] * gear * gear
    windage = p[slots.WINDAGE] * gear * gear * gear
    for n in range(n_steps):
        is_second = n >= half
        is_cutting = is_second != (c[4] > 0.0)
        for s in range(len(fractions)):
            part = (n - half * is_second + fractions[s]) * step
            sine, cosine = sine_cosine(part)
            turn = part
            if is_second:
                sine, cosine, turn = -sine, -cosine, part + math.pi
            g, _ = levers(c, sine, cosine)
            row = tables[n, s]
            per_speed = row[2] - damping
            constant = row[3]
            if is_cutting:
                constant += p[slots.EDGE_FORCE] * math.fabs(g)
            gain = rubbing
            if p[slots.TOOTH] != 0.0:
                if p[slots.ROD] > 0.0:
                    at = slider_crank.displacement(sine, cosine, p[slots.RADIUS], p[slots.ROD])
                else:
                    at = scotch_yoke.displacement(sine, cosine, p[slots.RADIUS])
                gain *= 1.0 + p[slots.TOOTH] * math.sin(TWO_PI * at / p[slots.TOOTH_PITCH] + p[slots.TOOTH_PHASE])
            per_speed *= gain
            constant *= gain
            guide = p[slots.GUIDE_COULOMB]
            if not is_cutting:
                guide += p[slots.RUBBING_CONSTANT]
                per_speed += p[slots.RUBBING_VISCOUS] * g * g
            constant += guide * math.fabs(g) + p[slots.MOTOR_COULOMB] * gear
            constant += p[slots.ECCENTRICITY] * math.sin(turn + p[slots.ECCENTRICITY_PHASE])
            row[1] += windage
            row[2] = damping + per_speed
            row[3] = constant


@kernel()
def simple_force(p, spline, turn, speed):
    """Cutting force of an effective vector at an angle in [0, 2*pi) and a crank speed, N."""
    c = cutter(p)
    sine, cosine = math.sin(turn), math.cos(turn)
    g, _ = levers(c, sine, cosine)
    along = c[4] * g * speed
    if c[4] * sine > 0.0:
        force = c[2] * along + p[slots.EDGE_FORCE]
        if c[3] != 0.0:
            force += c[3] * spline_force(spline, turn)
        if p[slots.TOOTH] != 0.0:
            if p[slots.ROD] > 0.0:
                at = slider_crank.displacement(sine, cosine, p[slots.RADIUS], p[slots.ROD])
            else:
                at = scotch_yoke.displacement(sine, cosine, p[slots.RADIUS])
            force *= 1.0 + p[slots.TOOTH] * math.sin(TWO_PI * at / p[slots.TOOTH_PITCH] + p[slots.TOOTH_PHASE])
        return force
    force = -p[slots.RUBBING_VISCOUS] * math.fabs(along) - p[slots.RUBBING_CONSTANT]
    if c[3] != 0.0:
        force += c[3] * spline_force(spline, turn)
    return force
