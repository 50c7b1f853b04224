"""The simulated bench is the machine that the configuration says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sawbench.bench.config import parse_config
from sawbench.blindcheck.streaming import StreamingPlant
from sawbench.commands.simbench import true_settings

pytestmark = pytest.mark.unit

SHIPPED = (Path(__file__).parents[2] / "bench_config.toml").read_text(encoding="utf-8")
CRANK = SHIPPED.replace("[plant]", '[plant]\nmechanism = "slider_crank"\nrod_length_m = 0.025', 1)


def midway_share(config_text: str) -> float:
    """Share of a stroke's time that the plunger spends below the middle of its stroke, running idle."""
    settings = true_settings(parse_config(config_text), material="none", duty=0.4, seed=1)
    stream = StreamingPlant(settings)
    stream.trigger(0.0)
    displacement_mm = stream.read("displacement_mm", np.arange(0.5, 2.5, 2e-4))
    return float(np.mean(displacement_mm < settings.crank_radius_m * 1e3))


def test_a_slider_crank_is_served_as_one():
    assert midway_share(SHIPPED) == pytest.approx(0.5, abs=0.02)
    # Of x = r (1 - cos) + l - sqrt(l^2 - r^2 sin^2): half of the stroke is passed where r^2 - 2 r l cos = 0.
    assert midway_share(CRANK) == pytest.approx(np.arccos(0.01 / (2 * 0.025)) / np.pi, abs=0.02)


def test_a_rod_in_the_configuration_of_a_scotch_yoke_is_left_aside():
    rod = SHIPPED.replace("[plant]", "[plant]\nrod_length_m = 0.025", 1)
    assert true_settings(parse_config(rod), material="none", duty=None, seed=0).rod_length_m is None
