"""Coarse steps and hum, as far as averaging over strokes leaves them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sawbench.diagnosis.inference import sensor_faults
from sawbench.diagnosis.inference.asynchronous import Line
from sawbench.diagnosis.inference.features import HARMONICS, N_BLOCKS, Layout
from sawbench.diagnosis.inference.sensor_faults import SensorFaults
from sawbench.diagnosis.plants.jigsaw import Jigsaw
from sawbench.diagnosis.signal_health import ChannelHealth

from tests.rigs.jigsaw_in_time import BASELINE
from tests.rigs.scattered_strokes import strokes

pytestmark = pytest.mark.unit

STEP_V, N_UNITS = 0.02, 64
LAYOUT = Layout(kind="running", equations=("cutting", "supply"), n_harmonics=HARMONICS)
SUPPLY_MEAN = LAYOUT.slices["supply"].start


@pytest.fixture(scope="module")
def state():
    found = next(s for s in strokes() if s.kind == "running" and not s.setting.is_idle)
    wave = np.ones((N_UNITS, 1)) * found.angle_rad[:1]
    return replace(
        found, angle_rad=wave, speed_rad_s=0.0 * wave + found.speed_rad_s.mean(), battery_voltage_v=0.0 * wave,
        force_n=0.0 * wave, n_strokes=np.full(N_UNITS, 4.0),
    )  # fmt: skip


def faults(*health, monkeypatch=None, lines=()):
    if monkeypatch is not None:
        monkeypatch.setattr(sensor_faults, "hum_lines", lambda trials: list(lines))
    campaign = SimpleNamespace(plant=Jigsaw(baseline=BASELINE), health=health, off_stroke=())
    return SensorFaults(campaign)


def coarse(channel, step):
    return ChannelHealth(
        channel=channel, seconds=5.0, rate_hz=1000.0, noise=0.001, step=step, spikes=0, impacts=0, missing_share=0.0,
        jitter_share=0.0,
    )  # fmt: skip


def test_sound_sensors_add_nothing(state):
    assert not faults(coarse("battery_voltage_v", 0.0)).variance(LAYOUT, state).any()


def test_a_step_that_nothing_blurs_is_as_wrong_as_rounding_a_constant(state):
    """Rounding values that lie anywhere in a step, and every trial elsewhere: q^2 / 12, of which the line is most."""
    rng = np.random.default_rng(1)
    exact = rng.uniform(0.0, 1.0, 20000)
    rounded = np.mean((STEP_V * (np.round(exact / STEP_V) - exact / STEP_V)) ** 2)
    (found,) = faults(coarse("battery_voltage_v", STEP_V)).roundings(state)
    assert 0.5 * rounded < found.std**2 < 1.1 * rounded
    # Higher harmonics are as wrong at most; that of the mean is one number of the trial, no noise of its time blocks.
    noise = faults(coarse("battery_voltage_v", STEP_V)).variance(LAYOUT, state)
    assert noise[SUPPLY_MEAN] == 0.0 and noise[SUPPLY_MEAN + 1] == pytest.approx(found.std**2)


def test_rounding_is_that_of_its_own_trial(state):
    (found,) = faults(coarse("battery_voltage_v", STEP_V)).roundings(state)
    elsewhere = replace(state, setting=replace(state.setting, label="another trial"))
    assert found.signature(BASELINE, state)["supply"] == pytest.approx(1.0)
    assert found.signature(BASELINE, elsewhere) == {}


def test_a_reading_that_drifts_over_steps_is_rounded_anew_in_every_block(state):
    drift = np.linspace(0.0, 3.0 * STEP_V, N_UNITS)[:, None]
    drifting = replace(state, battery_voltage_v=drift + 0.0 * state.angle_rad)
    found = faults(coarse("battery_voltage_v", STEP_V))
    assert found.roundings(drifting) == []
    assert found.variance(LAYOUT, drifting)[SUPPLY_MEAN] > 0.0


def test_strokes_that_scatter_blur_the_step(state):
    """Means over 256 strokes of rounded values, against what is stated: of the same order down to a hundredth."""
    rng = np.random.default_rng(2)
    for scatter in (0.15, 0.3):
        exact = rng.uniform(0.0, STEP_V, 400)[:, None]
        read = STEP_V * np.round((exact + scatter * STEP_V * rng.standard_normal((400, 20000))) / STEP_V)
        true = float(np.mean((read.mean(axis=1) - exact[:, 0]) ** 2))
        units = scatter * STEP_V * rng.standard_normal((N_UNITS, state.angle_rad.shape[1])) / 2.0
        blurred = replace(state, battery_voltage_v=units)
        (found,) = faults(coarse("battery_voltage_v", STEP_V)).roundings(blurred)
        assert 0.5 * true < found.std**2 < 2.0 * true


@pytest.mark.parametrize(("orders_off", "expected"), [(0.0, 0.5), (0.01, None), (0.4, 0.0)])
def test_hum_stays_where_the_stroke_rate_is_a_fraction_of_it(state, monkeypatch, orders_off, expected):
    rate_hz = 50.0 / (4.0 + orders_off)
    at = replace(state, speed_rad_s=0.0 * state.speed_rad_s + 2.0 * np.pi * rate_hz)
    line = Line(channel="force_n", frequency_hz=50.0, amplitude=2.0)
    found = faults(monkeypatch=monkeypatch, lines=[line]).variance(LAYOUT, at)
    of_fourth = found[LAYOUT.slices["cutting"].start + 4] / line.amplitude**2
    if expected is None:
        # A block of 64 strokes turns such a line by 0.64 of a turn: |sin(x) / x|, x = pi 0.64.
        left = np.sin(np.pi * 0.64) / (np.pi * 0.64)
        assert 0.5 < of_fourth / (0.5 * left**2) < 2.0
    else:
        assert of_fourth == pytest.approx(expected, abs=2e-3)
    assert found[LAYOUT.slices["cutting"].start + 1] < 1e-3 * line.amplitude**2


def test_hum_of_the_motor_current_is_a_voltage_of_resistance_and_inductance(state, monkeypatch):
    """The equation holds the rate of the current: 2 A at 50 Hz are 2 (R + i 2 pi 50 L) V, whatever the stroke rate."""
    plant, layout = BASELINE.plant, Layout(kind="running", equations=("electrical", "mechanical"))
    line = Line(channel="motor_current_a", frequency_hz=50.0, amplitude=2.0)
    for order in (2, 4):
        at = replace(
            state, speed_rad_s=0.0 * state.speed_rad_s + 2.0 * np.pi * 50.0 / order, current_a=0.0 * state.angle_rad
        )
        found = faults(monkeypatch=monkeypatch, lines=[line]).variance(layout, at)
        impedance = plant.resistance_ohm.nominal + 2j * np.pi * 50.0 * plant.inductance_h.nominal
        at_order = layout.slices["electrical"].start + order
        assert found[at_order] == pytest.approx(0.5 * abs(2.0 * impedance) ** 2, rel=1e-6)
        torque = layout.slices["mechanical"].start + order
        constant = plant.torque_constant_n_m_per_a.nominal
        assert found[torque] == pytest.approx(0.5 * (2.0 * constant) ** 2, rel=1e-6)


def test_hum_spreads_over_harmonics_where_the_speed_changes_within_the_stroke(state, monkeypatch):
    """Against the means over many strokes of hum in time, of any phase."""
    rate_hz, amplitude = 50.0 / 6.945, 2.0
    angle = state.angle_rad[0]
    speed = 2.0 * np.pi * rate_hz * (1.0 + 0.12 * np.cos(angle))
    at = replace(state, speed_rad_s=np.broadcast_to(speed, state.speed_rad_s.shape))
    line = Line(channel="force_n", frequency_hz=50.0, amplitude=amplitude)
    found = faults(monkeypatch=monkeypatch, lines=[line]).variance(LAYOUT, at)[LAYOUT.slices["cutting"]]
    seconds = (2.0 * np.pi / len(angle)) / speed
    at_s = np.cumsum(seconds) - 0.5 * seconds
    n_strokes = int(at.n_strokes.sum()) // N_BLOCKS
    starts_s = np.sum(seconds) * np.arange(n_strokes)
    squares = np.zeros(10)
    for phase in 2.0 * np.pi * (np.arange(40) + 0.5) / 40:
        mean = amplitude * np.cos(2.0 * np.pi * 50.0 * (at_s + starts_s[:, None]) + phase).mean(axis=0)
        squares += np.array([(2.0 * np.mean(mean * np.cos(k * angle))) ** 2 for k in range(10)]) / 40
    assert squares[6] > 0.1 * squares[7]
    for order in range(4, 10):
        assert 0.5 < found[order] / squares[order] < 2.0, order
