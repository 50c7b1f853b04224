"""Where in a turn the laws change: a backlash crossed, the blade engaged, the dead centres."""

from __future__ import annotations

import math

from modeling import slots
from modeling.compilation import kernel
from modeling.machine import sine_cosine
from modeling.mechanisms import scotch_yoke, slider_crank


@kernel()
def travel_angle(p, from_top, fraction):
    """Angle after a dead centre at which the blade has travelled a fraction of the stroke, rad."""
    if fraction <= 0.0:
        return 0.0
    if fraction >= 1.0:
        return math.pi
    low, high = 0.0, math.pi
    for _ in range(60):
        middle = 0.5 * (low + high)
        sine, cosine = sine_cosine(middle)
        if from_top:
            sine, cosine = -sine, -cosine
        if p[slots.ROD] > 0.0:
            at = slider_crank.displacement(sine, cosine, p[slots.RADIUS], p[slots.ROD])
        else:
            at = scotch_yoke.displacement(sine, cosine, p[slots.RADIUS])
        done = 1.0 - at / (2.0 * p[slots.RADIUS]) if from_top else at / (2.0 * p[slots.RADIUS])
        if done < fraction:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@kernel()
def breaks(p, edges):
    """Fill `edges`, shape (2, 2): a half turn a row, where a backlash is crossed, where the blade engages."""
    cuts_first = p[slots.CUTTING_SIGN] > 0.0
    for half in range(2):
        gap = p[slots.BACKLASH] / (2.0 * p[slots.RADIUS])
        edges[half, 0] = travel_angle(p, half == 1, gap)
        is_cutting = (half == 0) == cuts_first
        edges[half, 1] = travel_angle(p, half == 1, p[slots.ENGAGEMENT]) if is_cutting else 0.0


@kernel()
def place_at(p, edges, turns, angle, is_limited, chip):
    """Return the law that holds at an angle after a dead centre, and the angle at which it changes."""
    half = int(turns % 2)
    is_second = half == 1
    is_cutting = is_second != (p[slots.CUTTING_SIGN] > 0.0)
    is_free = angle < edges[half, 0] - 1e-13
    is_engaged = angle >= edges[half, 1] - 1e-13
    until = math.pi
    if is_free:
        until = min(until, edges[half, 0])
    if not is_engaged:
        until = min(until, edges[half, 1])
    return (is_second, is_cutting, is_engaged, is_free, is_limited, chip), until
