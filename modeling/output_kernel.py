"""Quantities that follow from current, speed, angle and charge: blade, force, voltages, stored energy."""

from __future__ import annotations

import math

import numpy as np

from modeling import slots
from modeling.compilation import kernel
from modeling.frozen_effects import simple_force
from modeling.machine import TWO_PI, cutter, drive, levers, machine, open_circuit, source, spline_force
from modeling.mechanisms import scotch_yoke, slider_crank
from modeling.turn_segments import breaks


@kernel()
def blade(p, spline, angle, motor_speed):
    """Displacement, blade velocity and cutting force, shape (3, n): m, m/s, N (Eqs. 1, 3, 9)."""
    c = cutter(p)
    out = np.empty((3, len(angle)))
    for k in range(len(angle)):
        turn = angle[k] - TWO_PI * math.floor(angle[k] / TWO_PI)
        sine, cosine = math.sin(turn), math.cos(turn)
        if p[slots.ROD] > 0.0:
            out[0, k] = slider_crank.displacement(sine, cosine, p[slots.RADIUS], p[slots.ROD])
        else:
            out[0, k] = scotch_yoke.displacement(sine, cosine, p[slots.RADIUS])
        g, _ = levers(c, sine, cosine)
        velocity = g * motor_speed[k] / p[slots.GEAR]
        out[1, k] = velocity
        force = 0.0
        if p[slots.CUTTING_SIGN] * sine > 0.0:
            force = p[slots.K_FC] * p[slots.CUTTING_SIGN] * velocity
        if p[slots.FORCE_SCALE] != 0.0 and motor_speed[k] > 0.0:
            force += p[slots.FORCE_SCALE] * spline_force(spline, turn)
        out[2, k] = force
    return out


@kernel()
def electric(p, ocv, current, soc):
    """Motor voltage, battery voltage and battery current, shape (3, n): V, V, A."""
    m = machine(p)
    out = np.empty((3, len(current)))
    for k in range(len(current)):
        e, battery_current = source(m, drive(m, ocv, soc[k]), 0.0, current[k])
        out[0, k] = e - m[17] * current[k]
        if p[slots.MODE] == slots.FIXED_VOLTAGE:
            out[1, k] = out[0, k]
            out[2, k] = current[k]
        else:
            out[1, k] = open_circuit(m, ocv, soc[k])[0] - p[slots.BATTERY_RESISTANCE] * battery_current
            out[2, k] = battery_current
    return out


@kernel()
def stored_energy(p, current, crank_speed, angle):
    """Magnetic and kinetic energy, J (Eq. 5)."""
    m = machine(p)
    c = cutter(p)
    g, _ = levers(c, math.sin(angle), math.cos(angle))
    return 0.5 * p[slots.INDUCTANCE] * current * current + 0.5 * (m[5] + m[6] * g * g) * crank_speed * crank_speed


@kernel()
def play_velocity(p, angle, motor_speed):
    """Blade velocity with the backlash's play, m/s: 0 until the pin has crossed it."""
    c = cutter(p)
    edges = np.empty((2, 2))
    breaks(p, edges)
    out = np.empty(len(angle))
    for k in range(len(angle)):
        turn = angle[k] - TWO_PI * math.floor(angle[k] / TWO_PI)
        half = 1 if turn >= math.pi else 0
        g, _ = levers(c, math.sin(turn), math.cos(turn))
        is_free = turn - half * math.pi < edges[half, 0]
        out[k] = 0.0 if is_free else g * motor_speed[k] / p[slots.GEAR]
    return out


@kernel()
def simple_forces(p, spline, angle, motor_speed):
    """Cutting force of an effective vector at crank angles in [0, 2*pi), N, shape (n,)."""
    out = np.empty(len(angle))
    for k in range(len(angle)):
        out[k] = simple_force(p, spline, angle[k], motor_speed[k] / p[slots.GEAR])
    return out
