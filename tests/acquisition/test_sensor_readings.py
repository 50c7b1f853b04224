"""Sensors of a simulated bench read as the configuration says."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.acquisition.simulation.sensor_readings import SensorReadings
from sawbench.bench.config import SensorConfig

pytestmark = pytest.mark.unit


class Steady:
    triggered_s = None

    def read(self, channel, time_s):
        return np.full(len(time_s), {"force_n": 100.0, "motor_current_a": 5.0}[channel])

    def trigger(self, time_s):
        self.triggered_s = time_s


def test_a_stated_sensor_reads_its_gain_and_offset_and_others_the_truth():
    plant = Steady()
    seen = SensorReadings(plant, {"force_n": SensorConfig(gain=1.02, offset=3.0)})
    time_s = np.arange(4.0)
    assert seen.read("force_n", time_s) == pytest.approx(105.0)
    assert seen.read("motor_current_a", time_s) == pytest.approx(5.0)
    seen.trigger(2.5)
    assert plant.triggered_s == 2.5
