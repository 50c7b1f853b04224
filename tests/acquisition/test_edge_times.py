"""Edges of an inductive switch: their times by the microcontroller's clock, strokes per second between them."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.acquisition.devices import validate_table
from sawbench.acquisition.instrument_clock import InstrumentClock
from sawbench.bench.units import Channel

from tests.rigs.dialogue import opened

pytestmark = pytest.mark.contract

RATE = Channel(name="stroke_rate_hz", unit="Hz", label="stroke rate", plausible=(0, 100))


def switch(monkeypatch, **options):
    def make(name, table, clock):
        instrument, settings = validate_table(name, table, channels={RATE.name: RATE})
        return instrument.make(name, settings, clock)

    table = {"driver": "edge_times", "port": "COM3", "channels": {RATE.name: {"input": 1}}, **options}
    device, _ = opened(monkeypatch, make, table)
    device.decode(b"\n", 0.0)
    return device


def read(device, *edges):
    """Times and strokes per second of (stamp, arrival) pairs."""
    chunks = [chunk for stamp, arrival_s in edges for chunk in device.decode(b"%d\r\n" % stamp, arrival_s)]
    return [t for c in chunks for t in c.time_s.tolist()], [v for c in chunks for v in c.raw[:, 0].tolist()]


def test_each_edge_is_a_sample_at_its_own_time(monkeypatch):
    # A stroke every 50 ms from micros() = 4294900000 on, which begins at 0 again; 0.5 ms on the way, one 20 ms late.
    edges = [((4_294_900_000 + 50_000 * k) % 2**32, 5.0 + 0.05 * k + (0.02 if k == 6 else 0.0005)) for k in range(40)]
    times_s, strokes_hz = read(switch(monkeypatch), *edges)
    # The first edge has none before it.
    assert strokes_hz == pytest.approx([20.0] * 39)
    assert times_s == pytest.approx((5.0005 + 0.05 * np.arange(1, 40)).tolist(), abs=2e-4)


def test_marks_of_a_stroke_are_counted_together(monkeypatch):
    device = switch(monkeypatch, edges_per_stroke=2)
    assert read(device, (0, 1.0), (25_000, 1.025), (50_000, 1.05))[1] == pytest.approx([20.0, 20.0])


def test_a_broken_line_gives_no_stroke_of_double_length(monkeypatch):
    device = switch(monkeypatch)
    read(device, (0, 1.0), (50_000, 1.05))
    device.decode(b"1\xff0000\r\n", 1.1)
    chunks = [*device.decode(b"150000\r\n", 1.15), *device.decode(b"200000\r\n", 1.2)]
    assert [chunk.raw[0, 0] for chunk in chunks] == pytest.approx([20.0])
    assert chunks[0].n_lost == 1


def test_a_stamp_that_lost_a_digit_gives_no_stroke_of_double_length_either(monkeypatch):
    device = switch(monkeypatch)
    read(device, (10_000_000, 1.0), (10_050_000, 1.05))
    chunks = [c for stamp, at_s in ((1_010_000, 1.1), (10_150_000, 1.15), (10_200_000, 1.2))
              for c in device.decode(b"%d\r\n" % stamp, at_s)]  # fmt: skip
    assert [chunk.raw[0, 0] for chunk in chunks] == pytest.approx([20.0])
    assert chunks[0].n_lost == 1


def test_rest_is_said_and_is_no_stroke(monkeypatch):
    device = switch(monkeypatch, slowest_hz=1.0)
    read(device, (0, 1.0), (50_000, 1.05))
    assert device.decode(b"", 2.0) == []
    (rest,) = device.decode(b"", 2.4)
    assert rest.raw.tolist() == [[0.0]]
    assert 1.05 < float(rest.time_s[0]) < 2.4
    # The first edge behind the rest ends no stroke.
    assert read(device, (3_000_000, 4.0), (3_040_000, 4.04))[1] == pytest.approx([25.0])


def test_a_damaged_stamp_is_left_out_and_a_restart_is_followed():
    clock = InstrumentClock(tick_s=1e-6, n_bits=32)
    _, is_used = clock.times(np.array([1e6, 1.1e6]), 3.1)
    assert is_used.tolist() == [True, True]
    # A digit became another: 8.2 s, 0.1 s after 1.1 s.
    assert clock.times(np.array([8.2e6]), 3.2)[1].tolist() == [False]
    times_s, is_used = clock.times(np.array([1.3e6]), 3.3)
    assert is_used.tolist() == [True]
    assert times_s == pytest.approx([3.3], abs=1e-3)
    # Switched off and on: the stamps begin at 0.
    assert clock.times(np.array([10.0]), 9.0)[1].tolist() == [False]
    times_s, is_used = clock.times(np.array([100_010.0]), 9.1)
    assert is_used.tolist() == [True]
    assert times_s == pytest.approx([9.1], abs=1e-6)
