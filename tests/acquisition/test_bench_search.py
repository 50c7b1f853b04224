"""Ports and what answers at them: emulated instruments, in simulated time."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest
from sawbench.acquisition import bench_search
from sawbench.acquisition.bench_search import FoundPort, example_table, find_ports, identify
from sawbench.acquisition.devices import load_instrument, validate_table
from sawbench.acquisition.simulation.bench_server import make_instruments
from sawbench.bench.config import BenchConfig, load_config

from benchmarks import protocol_emulated
from tests.rigs.resting import CONFIG, RestingTool

pytestmark = pytest.mark.contract


def test_ports_without_hardware_are_left_out_and_can_channels_come_last(monkeypatch):
    ports = [
        SimpleNamespace(device="COM7", description="USB serial", hwid="USB VID:PID=0403:6001"),
        SimpleNamespace(device="COM1", description="n/a", hwid="n/a"),
        SimpleNamespace(device="COM3", description=None, hwid="PNP0501"),
    ]
    monkeypatch.setattr(bench_search.list_ports, "comports", lambda: ports)
    monkeypatch.setattr(
        "can.detect_available_configs", lambda _interfaces: [{"interface": "socketcan", "channel": "can0"}]
    )
    assert find_ports() == (
        FoundPort(interface="serial", port="COM3"),
        FoundPort(interface="serial", port="COM7", about="USB serial"),
        FoundPort(interface="socketcan", port="can0"),
    )


class OwnTime(threading.local):
    """In each thread the time of the plug that it uses, which reading moves on: nothing depends on the machine."""

    now_s = 0.0

    def __call__(self):
        return self.now_s


class Plug:
    """An emulated instrument that answers in the thread that reads it; without one, a port where nothing answers."""

    def __init__(self, clock, instrument=None):
        self._clock, self._instrument, self._waiting, self._now_s = clock, instrument, b"", 0.0

    def write(self, data):
        if self._instrument is not None:
            self._waiting += self._instrument.receive(data, self._now_s)

    def read(self):
        self._now_s += 0.005
        self._clock.now_s += 0.005
        if self._instrument is not None:
            self._waiting += self._instrument.advance(self._now_s)
        waiting, self._waiting = self._waiting, b""
        return waiting


def test_each_instrument_is_known_by_its_samples(monkeypatch):
    clock = OwnTime()
    emulated = make_instruments(RestingTool(), load_config(CONFIG).config)
    plugs = {name: Plug(clock, emulated[name]) for name in ("power", "stroke_sensor", "load_cell")}
    plugs["dead"] = Plug(clock)
    monkeypatch.setattr(protocol_emulated, "PLUGS", {f"emulated://{name}": plug for name, plug in plugs.items()})
    ports = [FoundPort(interface="serial", port=f"emulated://{name}") for name in (*plugs, "missing")]
    found = identify(ports, clock=clock)
    assert [f.driver for f in found] == ["dbc_can", "gsv8", "gsv8"]
    assert [f.place for f in found] == ports[:3]
    can, stroke, cell = found
    assert can.serial_number is None
    assert stroke.serial_number and cell.serial_number and stroke.serial_number != cell.serial_number
    # At rest: 4 mm behind 2.5 mm/V are 1.6 V.
    assert stroke.about.startswith("GSV-8, reads 1.6")


ASKED = ("gsv8", "gsv3", "dbc_can", "msc7xxx", "loadstar", "mantracourt", "mantracourt_can", "cia404")
PRINTING = ("hx711", "text_lines")


def test_every_driver_that_can_be_told_is_found(monkeypatch):
    clock = OwnTime()
    tables = {driver: {"driver": driver, "port": "x", **example_table(driver)} for driver in ASKED}
    tables |= {driver: {"driver": driver, "port": "x", **load_instrument(driver).example} for driver in PRINTING}
    # It has to send by itself: this one is not started.
    tables["text_lines"] = {k: v for k, v in tables["text_lines"].items() if k not in {"start", "stop"}}
    plugs = {}
    for name, table in tables.items():
        (emulated,) = make_instruments(RestingTool(), BenchConfig(devices={name: table})).values()
        plugs[name] = Plug(clock, emulated)
    monkeypatch.setattr(protocol_emulated, "PLUGS", {f"emulated://{name}": plug for name, plug in plugs.items()})
    found = identify([FoundPort(interface="serial", port=f"emulated://{name}") for name in plugs], clock=clock)
    assert {f.place.port.removeprefix("emulated://"): f.driver for f in found} == {name: name for name in tables}
    lines = next(f for f in found if f.driver == "text_lines").proposed()
    assert lines["separator"] == ";" and lines["counter_column"] == 1
    assert lines["rate_hz"] == pytest.approx(500.0, rel=0.03)
    for one in found:
        validate_table("d", {**one.proposed(), "port": "x"})
