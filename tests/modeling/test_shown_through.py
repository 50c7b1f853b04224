"""What a sensor that distorts its reading makes of what an effect adds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sawbench.modeling.effects.catalogue import EFFECT_BY_NAME
from sawbench.modeling.effects.known import KnownEffect
from sawbench.modeling.effects.transfer import delay, low_pass, shown_through

from tests.rigs.jigsaw_in_time import BASELINE, Machine

DELAY_S = 1.7e-3


@pytest.fixture(scope="module")
def state():
    """Strokes at one speed: an order of the stroke is a frequency."""
    strokes = Machine(duty=0.4375, cuts=True).run(3)
    return replace(strokes, speed_rad_s=np.full_like(strokes.speed_rad_s, 80.0))


def test_a_delayed_wave_is_the_wave_of_an_earlier_angle(state):
    angle = (np.arange(state.angle_rad.shape[1]) + 0.5) * 2.0 * np.pi / state.angle_rad.shape[1]
    wave = np.broadcast_to(3.0 + np.cos(2.0 * angle) + 0.4 * np.sin(7.0 * angle), state.angle_rad.shape)
    earlier = angle - 80.0 * DELAY_S
    (shown,) = shown_through(BASELINE, state, [{"electrical": wave}], {"electrical": delay(DELAY_S)})
    assert shown["electrical"] == pytest.approx(
        np.broadcast_to(3.0 + np.cos(2.0 * earlier) + 0.4 * np.sin(7.0 * earlier), wave.shape), abs=1e-9
    )


def test_a_force_that_is_read_wrongly_is_missing_in_the_torque(state):
    """The motor carries the force itself: what the reading lacks of it, the balance of torques lacks with its lever."""
    angle = np.broadcast_to(state.angle_rad, state.speed_rad_s.shape)
    force = 5.0 * np.sin(3.0 * angle)
    (shown,) = shown_through(BASELINE, state, [{"cutting": force}], {"cutting": low_pass(2e-3)})
    lacking = shown["cutting"] - force
    assert np.abs(lacking).max() > 1.0
    assert shown["mechanical"] == pytest.approx(-BASELINE.load_torque(state, lacking))


def test_what_a_sensor_does_not_read_stays(state):
    wave = np.ones_like(state.speed_rad_s)
    (shown,) = shown_through(BASELINE, state, [{"supply": wave}], {"cutting": delay(DELAY_S)})
    assert shown.keys() == {"supply"}
    assert np.array_equal(shown["supply"], wave)


@pytest.mark.parametrize(
    ("device", "late", "early"),
    [
        (0.0, ["cutting"], []),
        (1.0, ["electrical"], []),
        (2.0, [], ["cutting", "electrical"]),
        (3.0, [], ["electrical"]),
    ],
)
def test_what_comes_late_by_which_clock(state, device, late, early):
    """By a late displacement all else looks early; the amplifier is late with the displacement."""
    clock = EFFECT_BY_NAME["clock_offset"]
    transfers = clock.distorts(state, np.ones(1), device=device, tau_s=DELAY_S, drifts=0.0)
    assert sorted(transfers) == sorted([*late, *early])
    frequency = np.array([[30.0]])
    for name, transfer in transfers.items():
        expected = -2.0 * np.pi * 30.0 * DELAY_S * (1.0 if name in late else -1.0)
        assert np.angle(transfer(frequency))[0, 0] == pytest.approx(expected)


def test_what_is_known_of_a_late_force_and_of_its_law_is_late_as_a_whole(state):
    """The reading is the force of the true law, by an FFT in time, as its speed is constant; not the sum of two."""
    clock = KnownEffect(effect=EFFECT_BY_NAME["clock_offset"], value=DELAY_S, form={"device": 0.0, "drifts": 0.0})
    law = KnownEffect(effect=EFFECT_BY_NAME["edge_force"], value=12.0, form={"by_stock": 0.0, "onset_m_s": 0.05})
    ideal = BASELINE.expected_force(state) + law.signature(BASELINE, state)["cutting"]
    orders = np.arange(ideal.shape[1] // 2 + 1)
    spectrum = np.fft.rfft(ideal, axis=1) * np.exp(-1j * orders * 80.0 * DELAY_S)
    spectrum[:, -1] = 0.0  # at half the sampling rate a delay has no phase
    ideal_late = np.fft.irfft(spectrum, ideal.shape[1], axis=1)
    both = replace(BASELINE, known=(law, clock)).known_signature(state)["cutting"]
    in_turn = replace(BASELINE, known=(clock, law)).known_signature(state)["cutting"]
    assert both == pytest.approx(in_turn)
    assert both == pytest.approx(ideal_late - BASELINE.expected_force(state), abs=0.02 * np.abs(both).max())
    alone = law.signature(BASELINE, state)["cutting"] + clock.signature(BASELINE, state)["cutting"]
    assert np.abs(both - alone).max() > 0.3 * np.abs(both).max()
