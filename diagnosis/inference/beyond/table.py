"""Causes of simple form that the catalogue does not hold: where one of them wins, the verdict is "unknown".

Every part of the bench has a law that model and catalogue take as ideal: a stiff shaft, a flux of any current, a
straight sensor. A catalogue that is bent to the nearest cause would name play where a shaft twists, a gear off its
centre where a spring ends the stroke, dry friction where grease warms up. One law a part, of one measured quantity and
with one or two numbers, is weighed beside the free discrepancy, so that what it explains better than any effect of the
catalogue is left to nobody, and the report says what it resembles.
"""

from __future__ import annotations

from typing import Final

from sawbench.diagnosis.inference.beyond.bent_displacement import BENT_DISPLACEMENT
from sawbench.diagnosis.inference.beyond.cutting import PINCHING_KERF, UNEVEN_CUT
from sawbench.diagnosis.inference.beyond.drive import (
    FALLING_FLUX,
    REGULATED_DUTY,
    SOFT_START,
    SOFTENING_FRICTION,
    SPRUNG_PLUNGER,
    WARMING_FRICTION,
    YIELDING_TRANSMISSION,
)
from sawbench.diagnosis.inference.beyond.sensing import BENT_READING, CREEPING_ZERO, CROSSTALK
from sawbench.diagnosis.inference.beyond.sensor_mount import SENSOR_MOUNT
from sawbench.diagnosis.inference.beyond.supply import ANOTHER_DISCHARGE
from sawbench.modeling.effects.effect import Effect

BEYOND_CATALOGUE: Final[tuple[Effect, ...]] = (
    BENT_DISPLACEMENT,
    BENT_READING,
    CREEPING_ZERO,
    CROSSTALK,
    SENSOR_MOUNT,
    PINCHING_KERF,
    UNEVEN_CUT,
    WARMING_FRICTION,
    SOFTENING_FRICTION,
    YIELDING_TRANSMISSION,
    SPRUNG_PLUNGER,
    FALLING_FLUX,
    REGULATED_DUTY,
    SOFT_START,
    ANOTHER_DISCHARGE,
)
