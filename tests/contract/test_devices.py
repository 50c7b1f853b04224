"""What every entry of `DRIVERS` keeps, and every emulator beside it."""

from __future__ import annotations

import inspect
import re

import numpy as np
import pytest

from acquisition.calibration import Calibration
from acquisition.devices import DRIVERS, build_devices, device_class, validate_table
from acquisition.simulation.bench_server import make_instruments
from acquisition.transports.can_batch import CanBatch
from acquisition.transports.slcan import SlcanDecoder
from bench.config import BenchConfig
from bench.errors import ConfigError, DeviceError
from bench.units import CHANNEL_BY_NAME

CALIBRATION = {"scale": 2.5, "offset": 0.5, "raw_unit": "V"}
TABLES = {
    "gsv8": {"channels": {"displacement_mm": {"input": 2, "raw_range": [-10, 10], "calibration": CALIBRATION}}},
    "msc7xxx": {"channels": {"displacement_mm": {"input": 1, "raw_range": [-10, 10], "calibration": CALIBRATION}}},
    "dbc_can": {"signals": {"motor_current_a": "MotorStatus.MotorCurrent"}},
}


class Sine:
    def read(self, channel, time_s):
        assert channel in CHANNEL_BY_NAME
        return 10.0 + 8.0 * np.sin(40.0 * np.asarray(time_s))

    def trigger(self, time_s):
        raise AssertionError(time_s)


def config_for(driver, port="/nowhere/at/all"):
    return BenchConfig(devices={"thing": {"driver": driver, "port": port, **TABLES[driver]}})


def build(driver, **options):
    (device,) = build_devices(config_for(driver), **options)
    return device


def test_every_driver_is_covered_here():
    assert set(TABLES) == set(DRIVERS)


@pytest.mark.parametrize("driver", DRIVERS)
def test_settings_are_frozen_strict_and_documented(driver):
    model = device_class(driver).Settings
    settings = validate_table("thing", config_for(driver).devices["thing"])[1]
    with pytest.raises(ValueError, match="frozen"):
        settings.port = "COM9"
    with pytest.raises(ConfigError, match="prot"):
        validate_table("thing", {**config_for(driver).devices["thing"], "prot": "COM9"})
    with pytest.raises(ConfigError, match="port"):
        validate_table("thing", {"driver": driver, **TABLES[driver]})
    described = re.findall(r"^    (\w+) : ", inspect.getdoc(model).replace("\n", "\n    "), re.M)
    assert set(model.model_fields) - {"driver"} == set(described)
    required = {name for name, field in model.model_fields.items() if field.is_required()}
    assert required <= {"port", "channels", "signals"}


@pytest.mark.parametrize("driver", DRIVERS)
def test_building_touches_nothing_and_stopping_is_always_allowed(driver):
    device = build(driver)
    assert device.name == "thing"
    assert device.port == "/nowhere/at/all"
    device.stop()
    device.stop()
    assert device.describe()["time_source"]


@pytest.mark.parametrize("driver", DRIVERS)
def test_channels_have_unit_and_range(driver):
    for stream in build(driver).streams:
        assert stream.rate_hz >= 0
        for channel in stream.channels:
            assert channel.unit == CHANNEL_BY_NAME[channel.name].unit
            low, high = channel.valid_range
            assert low < high


@pytest.mark.parametrize("driver", DRIVERS)
def test_a_missing_port_is_said_with_device_port_and_remedy(driver):
    device = build(driver)
    with pytest.raises(DeviceError, match="thing on /nowhere/at/all") as caught:
        device.open()
    assert caught.value.remedy
    device.stop()


@pytest.mark.parametrize("driver", DRIVERS)
def test_an_endpoint_replaces_the_port(driver):
    assert build(driver, endpoints={"thing": "socket://127.0.0.1:5"}).port == "socket://127.0.0.1:5"


def decode(driver, device, received, arrival_s):
    if driver == "dbc_can":
        decoder = device.__dict__.setdefault("decoder_of_test", SlcanDecoder())
        return device.decode(CanBatch.of(decoder.feed(received), arrival_s))
    if driver == "msc7xxx":
        return device.decode(received, arrival_s - 0.001, arrival_s)
    return device.decode(received, arrival_s)


@pytest.mark.parametrize("driver", DRIVERS)
def test_garbage_never_raises(driver):
    rng = np.random.default_rng(20)
    device = build(driver)
    for k in range(300):
        decode(
            driver,
            device,
            rng.integers(0, 256, int(rng.integers(1, 400)), dtype=np.uint8).tobytes(),
            float(k),
        )


def started_instrument(driver):
    instrument = make_instruments(Sine(), config_for(driver))["thing"]
    commands = {"gsv8": b"\xaa\x90\x24\x85", "dbc_can": b"S6\rO\r", "msc7xxx": b"\x10\x7e\x01\x4c\xcb\x16"}
    instrument.receive(commands[driver], 0.0)
    return instrument, commands[driver]


def bytes_of(driver, instrument, command, now_s):
    return instrument.receive(command, now_s) if driver == "msc7xxx" else instrument.advance(now_s)


def device_for(driver):
    device = build(driver)
    if driver == "gsv8":
        # As after `open`: the amplifier announced two values a frame.
        device._framer = device._new_framer(2, "float32")
    return device


@pytest.mark.parametrize("driver", DRIVERS)
def test_what_the_emulator_sends_the_driver_reads(driver):
    instrument, command = started_instrument(driver)
    device = device_for(driver)
    values = []
    for k in range(1, 60):
        chunks = decode(driver, device, bytes_of(driver, instrument, command, 0.005 * k), 0.005 * k)
        for chunk in chunks:
            assert chunk.n_lost == 0
            values += list(device.streams[0].channels[0].calibration.apply(chunk.raw[:, 0]))
    low, high = device.streams[0].channels[0].valid_range
    assert len(values) >= 59
    assert np.all((np.array(values) >= low) & (np.array(values) <= high))
    # The sine goes from 2 to 18; scaling, quantisation and framing cost half a step of it (0.0025 A).
    assert max(values) == pytest.approx(18.0, abs=0.06)
    assert min(values) == pytest.approx(2.0, abs=0.06)


@pytest.mark.parametrize("driver", DRIVERS)
def test_good_frames_after_garbage_are_read_again(driver):
    instrument, command = started_instrument(driver)
    device = device_for(driver)
    first = sum(len(c.raw) for c in decode(driver, device, bytes_of(driver, instrument, command, 0.05), 0.05))
    decode(driver, device, bytes(range(256)) * 2 + b"\r", 0.06)
    n_after = 0
    for k in range(1, 20):
        data = bytes_of(driver, instrument, command, 0.06 + 0.05 * k)
        n_after += sum(len(c.raw) for c in decode(driver, device, data, 0.06 + 0.05 * k))
    assert first > 0
    assert n_after >= 19 - 1
    assert device.n_discarded_bytes > 0 or driver == "dbc_can"


@pytest.mark.parametrize(
    ("devices", "message"),
    [
        ({}, "no .devices"),
        ({"a": {"driver": "gsv9", "port": "x"}}, "did you mean 'gsv8'"),
        ({"a": {"port": "x"}}, "no key driver"),
        (
            {"a": {"driver": "gsv8", "port": "x", "channels": {"forse_n": {"input": 1}}}},
            "unknown channel 'forse_n'",
        ),
        ({"a": {"driver": "gsv8", "port": "x", "channels": {"force_n": {"input": 0}}}}, "1..15"),
        (
            {"a": {"driver": "gsv8", "port": "x", "channels": {"force_n": {}}}},
            "missing key 'channels.force_n.input'",
        ),
        (
            {n: {"driver": "gsv8", "port": n, "channels": {"force_n": {"input": 1}}} for n in "ab"},
            "force_n comes from two devices: a and b",
        ),
        (
            {"a": {"driver": "dbc_can", "port": "x", "signals": {"force_n": "MotorStatus.MotorCurrent"}}},
            "is in 'A'",
        ),
        ({"a": {"driver": "dbc_can", "port": "x", "signals": {"force_n": "MotorStatus.Speed"}}}, "no signal"),
        (
            {"a": {"driver": "dbc_can", "port": "x", "dbc": "no.dbc", "signals": {"force_n": "M.S"}}},
            "no such DBC",
        ),
    ],
)
def test_a_wrong_table_is_one_clear_message(devices, message):
    with pytest.raises(ConfigError, match=message):
        build_devices(BenchConfig(devices=devices))


def test_an_unknown_endpoint_is_said():
    with pytest.raises(ConfigError, match="no device 'thin'"):
        build_devices(config_for("gsv8"), {"thin": "COM1"})


def test_calibration_polynomial_and_statement():
    calibration = Calibration(polynomial=(1.0, 2.0, 3.0), zero_raw=1.0, raw_unit="V", source="certificate 7")
    assert calibration.apply([1.0, 2.0]).tolist() == [1.0, 6.0]
    assert "certificate 7" in calibration.statement("force_n", "N")
    with pytest.raises(ValueError, match="not both"):
        Calibration(polynomial=(1.0,), scale=2.0)
    with pytest.raises(ValueError, match="must not be 0"):
        Calibration(scale=0.0)
