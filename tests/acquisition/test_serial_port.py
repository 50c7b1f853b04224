"""Ports and the USB adapters at them: an adapter that is another one is refused, wherever it was plugged in."""

from __future__ import annotations

import os
from types import SimpleNamespace

import pytest
from sawbench.acquisition.device_probe import probe_devices
from sawbench.acquisition.devices import build_devices, validate_table
from sawbench.acquisition.preflight import judge
from sawbench.acquisition.transports import serial_port
from sawbench.acquisition.transports.serial_port import SerialPort
from sawbench.bench.config import BenchConfig
from sawbench.bench.errors import ConfigError, DeviceError, OtherInstrumentError

pytestmark = pytest.mark.unit


class OpenPort:
    """What pyserial gives for a port that is there."""

    def __init__(self):
        self.is_open = True
        self.in_waiting = 0

    def read(self, _n):
        return b""

    def write(self, _data):
        pass

    def flush(self):
        pass

    def close(self):
        self.is_open = False


@pytest.mark.skipif(os.name != "posix", reason="a terminal is a thing of POSIX")
@pytest.mark.parametrize("call", [SerialPort.drop_waiting, lambda port: port.write(b"?")])
def test_a_terminal_that_is_gone_is_a_lost_link(call, monkeypatch):
    """Its flush and its emptying raise termios.error, which would end the driver instead of the link."""
    ours, theirs = os.openpty()
    port = SerialPort(os.ttyname(theirs), device="cell")
    port.open()
    # Unplugged between the bytes and the wait for their end.
    monkeypatch.setattr(port._port, "write", len)
    os.close(theirs)
    os.close(ours)
    with pytest.raises(DeviceError, match=r"connection was lost: Input/output error"):
        call(port)
    port.close()


@pytest.fixture
def plugged(monkeypatch):
    """Let ports exist: name -> serial number of its adapter; gives what was opened."""

    def plug(adapters):
        opened = []

        def open_port(url, **_options):
            if url not in adapters:
                raise FileNotFoundError(2, "No such file or directory", url)
            opened.append(OpenPort())
            return opened[-1]

        ports = [SimpleNamespace(device=name, serial_number=number) for name, number in adapters.items()]
        monkeypatch.setattr(serial_port.serial, "serial_for_url", open_port)
        monkeypatch.setattr(serial_port.list_ports, "comports", lambda: ports)
        return opened

    return plug


@pytest.mark.skipif(os.name != "posix", reason="this system has no select on files")
def test_one_read_gives_all_that_has_arrived_although_a_terminal_hands_out_less_at_a_time(monkeypatch):
    """What stays behind would be late by one more read, and by one more with every further one."""
    ours, theirs = os.pipe()
    read = os.read
    monkeypatch.setattr(serial_port.os, "read", lambda descriptor, n: read(descriptor, min(n, 4095)))
    with os.fdopen(ours, "rb") as port, os.fdopen(theirs, "wb", buffering=0) as instrument:
        sent = bytes(range(250)) * 40
        instrument.write(sent)
        assert serial_port._read_at_once(port) == sent


def test_the_adapter_that_is_named_is_taken_and_said(plugged):
    plugged({"COM3": "A1", "COM4": None})
    port = SerialPort("COM3", device="power", serial_number="A1")
    port.open()
    assert port.facts == {"serial_number": "A1"}
    nameless = SerialPort("COM4", device="power")
    nameless.open()
    assert nameless.facts == {}


def test_another_adapter_is_refused_and_the_port_given_free(plugged):
    opened = plugged({"COM3": "B2"})
    with pytest.raises(OtherInstrumentError, match=r"power on COM3.*is B2.*names A1") as caught:
        SerialPort("COM3", device="power", serial_number="A1").open()
    assert "serial_number" in caught.value.remedy
    assert not opened[0].is_open


def test_it_is_said_where_the_right_adapter_is(plugged):
    plugged({"COM3": "B2", "COM7": "A1"})
    with pytest.raises(OtherInstrumentError) as caught:
        SerialPort("COM3", device="power", serial_number="A1").open()
    assert "COM7" in caught.value.remedy and "[devices.power]" in caught.value.remedy


def test_an_adapter_without_number_is_not_the_one_that_is_named(plugged):
    plugged({"COM3": None})
    with pytest.raises(OtherInstrumentError, match="not known"):
        SerialPort("COM3", device="power", serial_number="A1").open()


def test_a_port_that_is_not_there_is_no_other_instrument(plugged):
    plugged({"COM7": "A1"})
    with pytest.raises(DeviceError, match="no such port; ports on this machine: COM7") as caught:
        SerialPort("COM3", device="power", serial_number="A1").open()
    assert not isinstance(caught.value, OtherInstrumentError)


@pytest.mark.skipif(os.name != "posix", reason="links to ports are a matter of Linux")
def test_a_link_to_the_port_finds_its_adapter(plugged, tmp_path):
    device, link = tmp_path / "ttyACM0", tmp_path / "by-id"
    link.symlink_to(device)
    plugged({str(device): "A1", str(link): None})
    port = SerialPort(str(link), device="power", serial_number="A1")
    port.open()
    assert port.facts == {"serial_number": "A1"}


CAN = {"driver": "dbc_can", "port": "COM3", "signals": {"motor_current_a": "MotorStatus.MotorCurrent"}}


def test_check_names_the_other_instrument(plugged):
    plugged({"COM3": "B2"})
    cell = {"driver": "gsv3", "port": "COM3", "serial_number": "A1", "channels": {"force_n": {"input": 1}}}
    devices = build_devices(BenchConfig(devices={"load_cell": cell}))
    found = judge(probe_devices(devices, seconds=0.1))
    (fault,) = [f for f in found.findings if f.severity == "fault"]
    assert (fault.code, fault.device) == ("other_instrument", "load_cell")
    assert "B2" in fault.what and "A1" in fault.what


def test_simulated_instruments_need_not_be_the_ones_that_are_named():
    _, settings = validate_table("power", {**CAN, "serial_number": "A1"}, endpoint="socket://127.0.0.1:5000")
    assert settings.serial_number is None


@pytest.mark.parametrize(
    "table",
    [
        CAN,
        {
            "driver": "mantracourt_can",
            "port": "can0",
            "channels": {"force_n": {"input": 1, "calibration": {"scale": 1.0}}},
        },
    ],
    ids=lambda table: table["driver"],
)
def test_a_number_that_is_never_compared_is_refused(table):
    with pytest.raises(ConfigError, match="slcan alone"):
        validate_table("power", {**table, "interface": "socketcan", "serial_number": "A1"})
