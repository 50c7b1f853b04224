"""What every row of `INSTRUMENTS` keeps: driver, settings and emulator together."""

from __future__ import annotations

import contextlib
import inspect
import os
import re
import sys

import numpy as np
import pytest
from pydantic import BaseModel
from sawbench.acquisition.calibration import Calibration
from sawbench.acquisition.devices import INSTRUMENTS, build_devices, load_instrument, validate_table
from sawbench.acquisition.simulation.plant_stream import SWITCH_CHANNEL
from sawbench.bench.config import BenchConfig
from sawbench.bench.errors import ConfigError, DeviceError
from sawbench.bench.units import CHANNEL_BY_NAME

from tests.rigs.resting import resting_bench

pytestmark = pytest.mark.contract

DRIVERS = tuple(INSTRUMENTS)
# The others are read through a package of their maker: `test_maker_packages.py`.
EMULATED = tuple(driver for driver in DRIVERS if load_instrument(driver).emulate is not None)
needs_pty = pytest.mark.skipif(os.name != "posix", reason="this system has no pty")


def sine(time_s, _noise):
    """Within what every example can mean: 2..18 in the unit of the channel."""
    return 10.0 + 8.0 * np.sin(40.0 * time_s)


# Declared beside those of the program, for instruments that measure neither force nor displacement.
FURTHER = {"stroke_rate_hz": {"unit": "Hz", "range": [0, 200]}}
# Driver -> lowest and highest value where it is not that of the sine: one edge a turn at 40 rad/s.
MEASURED = {"edge_times": (6.3, 6.43)}


def config_for(driver, port="/nowhere/at/all"):
    example = load_instrument(driver).example
    return BenchConfig(channels=FURTHER, devices={"thing": {"driver": driver, "port": port, **example}})


def build(driver, **options):
    (device,) = build_devices(config_for(driver), **options)
    return device


@contextlib.contextmanager
def streaming(driver):
    """Give the device, open and started, and the rig with its emulator, on a pty and in simulated time."""
    behaviour = dict.fromkeys((*CHANNEL_BY_NAME, SWITCH_CHANNEL), sine)
    with resting_bench(behaviour, config=config_for(driver)) as rig:
        device = build(driver, endpoints=rig.ports, clock=rig.clock)
        try:
            device.open()
            device.start()
            yield device, rig
        finally:
            device.stop()


def read_samples(device, rig, *, n_samples=60, seconds=0.2):
    """Calibrated values of the first channel over some of the rig's time, and the chunks they came in."""
    values, chunks = [], []
    begun_s = rig.clock()
    for _ in range(5000):
        new = device.read()
        chunks += new
        for chunk in new:
            values += list(device.streams[0].channels[0].calibration.apply(chunk.raw[:, 0]))
        if len(values) >= n_samples and rig.clock() - begun_s >= seconds:
            return np.array(values), chunks
    raise AssertionError(f"{len(values)} of {n_samples} samples")


@pytest.mark.parametrize("driver", DRIVERS)
def test_settings_are_frozen_strict_and_documented(driver):
    table = config_for(driver).devices["thing"]
    channels = config_for(driver).known_channels
    instrument, settings = validate_table("thing", table, channels=channels)
    model = instrument.settings
    with pytest.raises(ValueError, match="frozen"):
        settings.port = "COM9"
    with pytest.raises(ConfigError, match="prot"):
        validate_table("thing", {**table, "prot": "COM9"}, channels=channels)
    with pytest.raises(ConfigError, match="port"):
        validate_table("thing", {k: v for k, v in table.items() if k != "port"}, channels=channels)
    bases = model.__mro__[: model.__mro__.index(BaseModel)]
    explained = "\n".join(inspect.cleandoc(base.__doc__ or "") for base in bases)
    described = re.findall(r"^([\w, ]+) : ", explained, re.M)
    assert set(model.model_fields) - {"driver"} == set(", ".join(described).split(", "))
    required = {name for name, field in model.model_fields.items() if field.is_required()}
    assert required <= {"port", "channels", "signals", "sync", "fields"}


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
    known = config_for(driver).known_channels
    for stream in build(driver).streams:
        assert stream.rate_hz >= 0
        for channel in stream.channels:
            assert channel.unit == known[channel.name].unit
            low, high = channel.valid_range
            assert low < high


@pytest.mark.parametrize("driver", EMULATED)
def test_a_missing_port_is_said_with_device_port_and_remedy(driver):
    device = build(driver)
    with pytest.raises(DeviceError, match="thing on /nowhere/at/all") as caught:
        device.open()
    assert caught.value.remedy
    device.stop()


@pytest.mark.parametrize("driver", DRIVERS)
def test_an_endpoint_replaces_the_port(driver):
    assert build(driver, endpoints={"thing": "socket://127.0.0.1:5"}).port == "socket://127.0.0.1:5"


@needs_pty
@pytest.mark.parametrize("driver", EMULATED)
def test_what_the_emulator_sends_the_driver_reads(driver):
    with streaming(driver) as (device, rig):
        values, chunks = read_samples(device, rig)
    low, high = device.streams[0].channels[0].valid_range
    assert all(chunk.n_lost == 0 for chunk in chunks)
    assert np.all((values >= low) & (values <= high))
    # The sine goes from 2 to 18; scaling, quantisation and framing cost half a step of it.
    resolution = max(0.05, device.streams[0].channels[0].resolution)
    lowest, highest = MEASURED.get(driver, (2.0 - resolution, 18.0 + resolution))
    assert np.all((values >= lowest) & (values <= highest))
    assert driver in MEASURED or np.ptp(values) > 5.0
    assert device.n_discarded_bytes == 0


@needs_pty
@pytest.mark.parametrize("driver", EMULATED)
def test_an_opened_instrument_says_what_it_is_and_can_be_opened_again(driver):
    with streaming(driver) as (device, rig):
        assert len(device.describe()) >= 2
        device.stop()
        device.open()
        device.start()
        assert len(read_samples(device, rig)[0]) >= 60


@needs_pty
@pytest.mark.parametrize("driver", EMULATED)
def test_garbage_never_raises_and_good_frames_after_it_are_read_again(driver):
    rng = np.random.default_rng(20)
    with streaming(driver) as (device, rig):
        for _ in range(60):
            rig.inject("thing", rng.integers(0, 256, int(rng.integers(1, 400)), dtype=np.uint8).tobytes())
            device.read()
        # What garbage and frames made together is still in the buffers; what comes after has to be sound.
        read_samples(device, rig)
        values, chunks = read_samples(device, rig)
    lowest, highest = MEASURED.get(driver, (1.9, 18.1))
    assert np.all((values > lowest) & (values < highest))
    assert sum(chunk.n_lost for chunk in chunks) == 0


PACKAGE = """
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.devices.msc7xxx import INSTRUMENT as shipped

INSTRUMENT = Instrument(settings=shipped.settings, make=shipped.make, emulate=shipped.emulate, example=shipped.example)
NO_INSTRUMENT = 7
"""


@pytest.fixture
def installed_package(tmp_path, monkeypatch):
    """A package of a laboratory, as an installer leaves it on the path."""
    (tmp_path / "lab_cell.py").write_text(PACKAGE)
    about = tmp_path / "lab_cell-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-cell\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[sawbench.instruments]\nlab_cell = lab_cell:INSTRUMENT\nlab_seven = lab_cell:NO_INSTRUMENT\n"
        "lab_gone = lab_gone:INSTRUMENT\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    sys.modules.pop("lab_cell", None)


@needs_pty
def test_an_instrument_of_another_package_needs_no_change_here(installed_package):
    with streaming("lab_cell") as (device, rig):
        assert len(read_samples(device, rig)[0]) >= 60


@pytest.mark.parametrize(
    ("driver", "message"),
    [("lab_seven", "is not an Instrument but a int"), ("lab_gone", "cannot be imported"), ("lab_cel", "'lab_cell'")],
)
def test_a_wrong_entry_point_is_one_clear_message(installed_package, driver, message):
    with pytest.raises(ConfigError, match=message) as caught:
        validate_table("thing", {"driver": driver, "port": "x"})
    assert "[devices.thing]" in str(caught.value)


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
            "force_n is provided by two devices: a and b",
        ),
        (
            {
                n: {"driver": "gsv8", "port": "x", "channels": {c: {"input": 1}}}
                for n, c in (("a", "force_n"), ("b", "displacement_mm"))
            },
            r"\[devices.b\]: port x is that of \[devices.a\] too",
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


@pytest.mark.parametrize(
    "shared", [{"port": "socket://10.0.0.7:4001"}, {"port": "can0", "interface": "socketcan"}], ids=["server", "bus"]
)
def test_a_server_and_a_bus_serve_several_instruments(shared):
    signals = {"a": {"motor_current_a": "MotorStatus.MotorCurrent"}, "b": {"battery_voltage_v": "BatteryVoltage"}}
    tables = {n: {"driver": "dbc_can", "signals": mapped, **shared} for n, mapped in signals.items()}
    assert len(build_devices(BenchConfig(devices=tables))) == 2


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


@needs_pty
@pytest.mark.parametrize("driver", EMULATED)
def test_a_link_that_comes_back_finds_the_same_number(driver):
    """The recorder asks for it when the instrument streams, and compares it once the port is open again."""
    with streaming(driver) as (device, _):
        number = device.describe().get("serial_number")
        device.stop()
        device.open()
        assert device.describe().get("serial_number") == number
