"""NI-DAQmx and LabJack: what is asked of the makers' packages, and what comes of their answers and errors."""

from __future__ import annotations

import inspect
import sys
import types

import numpy as np
import pytest
from sawbench.acquisition.devices import validate_table
from sawbench.acquisition.simulation.bench_server import make_instruments
from sawbench.bench.config import BenchConfig
from sawbench.bench.errors import ConfigError, DeviceError, OtherInstrumentError

pytestmark = pytest.mark.contract

TABLES = {
    "ni_daqmx": {"driver": "ni_daqmx", "port": "Dev1", "rate_hz": 1000.0},
    "labjack": {"driver": "labjack", "port": "ANY", "rate_hz": 1000.0},
}
TWO = {"force_n": {"input": 3}, "displacement_mm": {"input": 1}}


def device(driver, **changes):
    instrument, settings = validate_table("cell", {**TABLES[driver], "channels": TWO, **changes})
    return instrument.make("cell", settings, lambda: 7.0)


class Refused(Exception):
    """Base of the stand-ins' errors."""


class Recorder:
    """Takes any call, keeps it, and gives what was laid down for its name."""

    def __init__(self, name, calls, answers):
        self._name, self._calls, self._answers = name, calls, answers

    def __getattr__(self, name):
        return self._answers[name] if name in self._answers else Recorder(name, self._calls, self._answers)

    def __call__(self, *given, **named):
        self._calls.append((self._name, given, named))
        return self


@pytest.fixture
def nidaqmx(monkeypatch):
    """A stand-in of `nidaqmx`; gives the calls and the answers, which a test may change."""
    calls, answers = [], {"avail_samp_per_chan": 50, "samp_clk_rate": 1000.0}

    class Reader:
        def __init__(self, stream):
            pass

        def read_many_sample(self, samples, number_of_samples_per_channel, timeout):
            if "error" in answers:
                raise Refused(answers["error"])
            assert samples.shape == (2, number_of_samples_per_channel)
            samples[:] = np.array([[1.0], [2.0]]) + np.arange(number_of_samples_per_channel) / 100

    def found(name):
        if "error" in answers:
            raise Refused(answers["error"])
        return types.SimpleNamespace(product_type="USB-6211", serial_num=0x1A2B3C)

    constants = Recorder("constants", [], {})
    modules = {
        "nidaqmx": types.SimpleNamespace(
            Task=lambda: Recorder("task", calls, answers), errors=types.SimpleNamespace(Error=Refused)
        ),
        "nidaqmx.system": types.SimpleNamespace(Device=found),
        "nidaqmx.constants": constants,
        "nidaqmx.stream_readers": types.SimpleNamespace(AnalogMultiChannelReader=Reader),
    }
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    return calls, answers


def test_a_task_of_ni_is_built_read_and_closed(nidaqmx):
    calls, _ = nidaqmx
    ni = device("ni_daqmx", serial_number="1A2B3C", largest=5.0)
    ni.open()
    ni.start()
    (chunk,) = ni.read()
    ni.stop()
    ni.stop()
    assert chunk.raw.shape == (50, 2)
    assert chunk.raw[:2].tolist() == [[1.0, 2.0], [1.01, 2.01]]
    assert chunk.arrival_s.tolist() == [7.0]
    added = [(given[0], named["min_val"], named["max_val"]) for name, given, named in calls if "voltage" in name]
    assert added == [("Dev1/ai2", -5.0, 5.0), ("Dev1/ai0", -5.0, 5.0)]
    (timing,) = [(given, named["samps_per_chan"]) for name, given, named in calls if name == "cfg_samp_clk_timing"]
    assert timing == ((1000.0,), 4000)
    assert [name for name, _, _ in calls][-2:] == ["start", "close"]
    assert ni.describe()["model"] == "USB-6211"


def test_a_bridge_of_ni_is_measured_in_millivolts_per_volt(nidaqmx):
    calls, _ = nidaqmx
    device("ni_daqmx", kind="bridge", largest=2.5, excitation_v=10.0).open()
    bridges = [named for name, _, named in calls if name == "add_ai_bridge_chan"]
    assert [(b["max_val"], b["voltage_excit_val"], b["units"]._name) for b in bridges] == [
        (2.5, 10.0, "MILLIVOLTS_PER_VOLT")
    ] * 2


def test_what_ni_refuses_is_one_clear_error(nidaqmx):
    _, answers = nidaqmx
    with pytest.raises(OtherInstrumentError, match="1A2B3C, the configuration names FF"):
        device("ni_daqmx", serial_number="FF").open()
    answers["samp_clk_rate"] = 800.0
    with pytest.raises(DeviceError, match="uses 800 Hz"):
        device("ni_daqmx").open()
    answers["samp_clk_rate"] = 1000.0
    ni = device("ni_daqmx")
    ni.open()
    answers["error"] = "samples were overwritten"
    with pytest.raises(DeviceError, match="samples were overwritten"):
        ni.read()
    with pytest.raises(DeviceError, match="NI-DAQmx is installed"):
        device("ni_daqmx").open()


@pytest.fixture
def ljm(monkeypatch):
    """A stand-in of `labjack.ljm`."""
    calls, answers = [], {"rate_hz": 1000.0, "values": [1.0, 2.0, -9999.0, -9999.0, 3.0, 4.0], "kind": 7}

    def keep(name, result=None):
        def call(*given):
            calls.append((name, *given))
            if answers.get("error") == name:
                raise Refused("LJM library error code 1239 LJME_RECONNECT_FAILED")
            return result() if callable(result) else result

        return call

    module = types.SimpleNamespace(
        LJMError=Refused,
        constants=types.SimpleNamespace(DUMMY_VALUE=-9999),
        openS=keep("openS", 17),
        getHandleInfo=keep("getHandleInfo", lambda: (answers["kind"], 1, 470012345, 0, 0, 64)),
        eWriteName=keep("eWriteName"),
        namesToAddresses=keep("namesToAddresses", ([4, 0], [3, 3])),
        eStreamStart=keep("eStreamStart", lambda: answers["rate_hz"]),
        eStreamRead=keep("eStreamRead", lambda: (answers["values"], 0, 0)),
        eStreamStop=keep("eStreamStop"),
        close=keep("close"),
    )
    monkeypatch.setitem(sys.modules, "labjack", types.SimpleNamespace(ljm=module))
    monkeypatch.setitem(sys.modules, "labjack.ljm", module)
    return calls, answers


def test_a_stream_of_labjack_is_started_read_and_stopped(ljm):
    calls, _ = ljm
    labjack = device("labjack", serial_number="470012345", is_differential=True)
    labjack.open()
    labjack.start()
    (chunk,) = labjack.read()
    labjack.stop()
    # Scans that the device lost are -9999: no numbers, so that the recorder marks a gap of known length.
    assert np.isnan(chunk.raw[1]).all()
    assert chunk.raw[[0, 2]].tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert ("eWriteName", 17, "AIN2_NEGATIVE_CH", 3) in calls
    assert ("namesToAddresses", 2, ["AIN2", "AIN0"]) in calls
    assert ("eStreamStart", 17, 20, 2, [4, 0], 1000.0) in calls
    assert [call[0] for call in calls][-2:] == ["eStreamStop", "close"]
    assert labjack.describe()["model"] == "T7"


def test_a_single_ended_input_of_a_t7_is_measured_against_ground_whatever_was_set_before(ljm):
    calls, answers = ljm
    device("labjack").open()
    # T-Series datasheet, analogue inputs: 199 is GND.
    written = {call[2]: call[3] for call in calls if call[0] == "eWriteName" and "NEGATIVE" in call[2]}
    assert written == {"AIN2_NEGATIVE_CH": 199, "AIN0_NEGATIVE_CH": 199}
    calls.clear()
    answers["kind"] = 4
    device("labjack").open()
    assert not [call for call in calls if call[0] == "eWriteName" and "NEGATIVE" in call[2]]


def test_what_labjack_refuses_is_one_clear_error(ljm):
    _, answers = ljm
    with pytest.raises(OtherInstrumentError, match="470012345, the configuration names 1"):
        device("labjack", serial_number="1").open()
    labjack = device("labjack")
    labjack.open()
    answers["rate_hz"] = 500.0
    with pytest.raises(DeviceError, match="uses 500 Hz"):
        labjack.start()
    for call, act in (("eStreamRead", labjack.read), ("openS", labjack.open)):
        answers["error"] = call
        with pytest.raises(DeviceError, match="LJME_RECONNECT_FAILED"):
            act()
    answers["error"] = "eStreamStop"
    labjack.stop()


@pytest.mark.parametrize(("driver", "package"), [("ni_daqmx", "nidaqmx"), ("labjack", "labjack.ljm")])
def test_a_missing_package_is_said_with_its_command(driver, package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ConfigError, match=r"pip install 'sawbench\[(ni|labjack)\]'"):
        device(driver).open()


@pytest.mark.parametrize("driver", TABLES)
def test_the_simulated_bench_says_that_it_has_no_emulator(driver):
    with pytest.raises(ConfigError, match="has no emulator"):
        make_instruments(None, BenchConfig(devices={"cell": {**TABLES[driver], "channels": TWO}}))


def test_the_packages_have_what_is_called():
    task = pytest.importorskip("nidaqmx", reason="the extra `ni` is not installed").Task
    from nidaqmx.stream_readers import AnalogMultiChannelReader
    from nidaqmx.system import Device
    from nidaqmx.task.collections import AIChannelCollection

    assert {"start", "close", "timing", "in_stream", "ai_channels"} <= set(dir(task))
    assert {"product_type", "serial_num"} <= set(dir(Device))
    bridge = inspect.signature(AIChannelCollection.add_ai_bridge_chan).parameters
    assert {"min_val", "max_val", "units", "bridge_config", "voltage_excit_source", "voltage_excit_val"} <= set(bridge)
    read = inspect.signature(AnalogMultiChannelReader.read_many_sample).parameters
    assert {"number_of_samples_per_channel", "timeout"} <= set(read)
