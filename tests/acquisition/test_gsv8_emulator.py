"""The emulated GSV-8 answers as the maker's library expects; same sources as `test_gsv8.py`."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from sawbench.acquisition.devices.gsv8_emulator import Gsv8Emulator
from sawbench.acquisition.simulation.sensor import EmulatedSensor

pytestmark = pytest.mark.contract


class Ramp:
    """Value = 250 N/s * t, so raw = t in mV/V at 250 N per mV/V."""

    def read(self, channel, time_s):
        assert channel == "force_n"
        return 250.0 * time_s

    def trigger(self, time_s):
        raise AssertionError(time_s)


def amplifier(**options):
    return Gsv8Emulator(Ramp(), (EmulatedSensor(channel="force_n", input=1, scale=250.0),), rate_hz=1000.0, **options)


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [
        ("aa902385", "aa500085"),
        ("aa902485", "aa500085"),
        ("aa91010085", "aa54000813000185"),
        ("aa908a85", "aa5400447a000085"),
        ("aa948b45bb800085", "aa500085"),
        ("aa948b4841eb0085", "aa505485"),
        ("aa947f0000000085", "aa504085"),
        ("aa91230085", "aa505b85"),
        ("aa91010000", "aa504285"),
        ("aa910c0285", "aa505185"),
    ],
)
def test_answers(request_hex, answer_hex):
    assert amplifier().receive(bytes.fromhex(request_hex), 0.0).hex() == answer_hex


def test_a_request_may_come_in_pieces_and_after_noise():
    unit = amplifier()
    assert unit.receive(b"\x00\x17\xaa\x90", 0.0) == b""
    assert unit.receive(b"\x24\x85", 0.0) == bytes.fromhex("aa500085")
    assert unit.is_streaming


def test_samples_are_those_of_its_own_clock():
    unit = amplifier(clock_error_ppm=100.0)
    unit.receive(bytes.fromhex("aa902485"), 2.0)
    stream = unit.advance(2.0) + unit.advance(7.0) + unit.advance(12.0)
    frames = [stream[k : k + 8] for k in range(0, len(stream), 8)]
    # 10 s at 1000.1 Hz, and the sample at the start itself.
    assert len(frames) == 10_002
    raw = np.array([struct.unpack(">f", f[3:7])[0] for f in frames])
    assert {f[:3] for f in frames} == {b"\xaa\x10\xb0"}
    assert raw[0] == pytest.approx(2.0)
    assert np.diff(raw[:5]) == pytest.approx(np.full(4, 1e-3 / 1.0001), abs=3e-7)


def test_zero_is_taken_off():
    unit = amplifier()
    unit.receive(bytes.fromhex("aa902485"), 0.0)
    unit.advance(1.0)
    unit.receive(bytes.fromhex("aa910c0185"), 1.0)
    (first,) = struct.unpack(">f", unit.advance(1.0015)[3:7])
    assert first == pytest.approx(0.001, abs=1e-6)
