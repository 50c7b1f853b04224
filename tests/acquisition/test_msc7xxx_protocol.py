"""MSC7xxx byte dialogue. Vector of the maker: 0.88 V, no scaled value, controller 7E."""

from __future__ import annotations

import pytest
from sawbench.acquisition.devices import serial_instrument
from sawbench.acquisition.devices.msc7xxx import Msc7xxx, Msc7xxxDecoder, Msc7xxxSettings, question
from sawbench.bench.errors import DeviceError

pytestmark = pytest.mark.contract

QUESTION = bytes.fromhex("10 7E 01 4C CB 16")
REPLY = bytes.fromhex("68 0B 0B 68 01 7E 08 AE 47 61 3F 00 00 00 00 1C 16")


def test_the_makers_vector():
    assert question(0x7E) == QUESTION
    (values,) = Msc7xxxDecoder(address=0x7E).feed(REPLY)
    assert values.voltage_v == pytest.approx(0.88, abs=1e-7)
    assert values.scaled == 0.0


def test_split_anywhere():
    for cut in range(len(REPLY)):
        decoder = Msc7xxxDecoder(address=0x7E)
        assert len(decoder.feed(REPLY[:cut]) + decoder.feed(REPLY[cut:])) == 1
        assert decoder.n_discarded_bytes == 0


@pytest.mark.parametrize("position", range(len(REPLY)))
def test_one_wrong_byte_is_never_a_value(position):
    damaged = bytearray(REPLY)
    damaged[position] ^= 0x11
    decoder = Msc7xxxDecoder(address=0x7E)
    values = decoder.feed(bytes(damaged) + REPLY + REPLY)
    assert [round(v.voltage_v, 6) for v in values] in ([0.88, 0.88], [0.88])
    assert decoder.n_discarded_bytes > 0


class Port:
    def __init__(self, answers):
        self.answers = answers
        self.sent = []

    def open(self):
        pass

    def write(self, data):
        self.sent.append(data)

    def read(self):
        return self.answers.pop(0) if self.answers else b""

    def close(self):
        pass


def device_with(monkeypatch, answers):
    port = Port(answers)
    ticks = iter(range(10_000))
    monkeypatch.setattr(serial_instrument, "SerialPort", lambda *_a, **_k: port)
    table = {"port": "COM4", "channels": {"displacement_mm": {"input": 1, "calibration": {"scale": 2.5}}}}
    settings = Msc7xxxSettings.model_validate(table)
    return Msc7xxx("stroke", settings, clock=lambda: next(ticks) * 0.01), port


def test_a_sample_has_the_middle_of_question_and_answer_as_its_time(monkeypatch):
    device, port = device_with(monkeypatch, [REPLY, REPLY[:5], REPLY[5:]])
    device.open()
    (chunk,) = device.read()
    assert port.sent == [QUESTION, QUESTION]
    assert chunk.raw[0, 0] == pytest.approx(0.88)
    assert chunk.time_s[0] < chunk.arrival_s[0]


def test_silence_is_an_error_at_opening(monkeypatch):
    device, _ = device_with(monkeypatch, [])
    with pytest.raises(DeviceError, match="did not answer address 7E"):
        device.open()
