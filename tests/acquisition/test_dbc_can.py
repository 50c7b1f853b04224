"""Messages of a CAN bus as they are read live, against what SAE J1939-71 says of values that are none."""

from __future__ import annotations

import numpy as np
import pytest
from sawbench.acquisition.device_probe import probe_devices
from sawbench.acquisition.devices.dbc_can import DbcCan, DbcCanSettings
from sawbench.acquisition.preflight import judge
from sawbench.acquisition.stream_recorder import StreamRecorder
from sawbench.acquisition.transports.can_batch import CanBatch, ParsedFrame
from sawbench.bench.recording import Event, SampleBlock

pytestmark = pytest.mark.unit

DBC = (
    'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 2566844926 Power: 8 A\n'
    ' SG_ Volt : 0|16@1+ (0.05,0) [0|3276.75] "V" A\n'
    'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    'BA_DEF_DEF_ "VFrameFormat" "J1939PG";\nBA_DEF_ "ProtocolType" STRING;\nBA_DEF_DEF_ "ProtocolType" "J1939";\n'
    'BA_ "VFrameFormat" BO_ 2566844926 3;\n'
)
GROUP = 0x18FEF100


@pytest.fixture
def device(tmp_path):
    (tmp_path / "j1939.dbc").write_text(DBC)
    given = {"port": "x", "dbc": str(tmp_path / "j1939.dbc"), "signals": {"battery_voltage_v": "Power.Volt"}}
    return DbcCan("power", DbcCanSettings.model_validate({**given, "rate_hz": {"Power": 100}}))


def batch(frames, first=0):
    """`frames`: (source address, number); 10 ms apart."""
    parsed = [
        ParsedFrame(GROUP | source, True, number.to_bytes(2, "little") + b"\xff" * 6) for source, number in frames
    ]
    return CanBatch.of(parsed, [50.0 + (first + k) * 0.01 for k in range(len(frames))])


def test_what_is_not_available_is_no_number(device):
    # Two bytes: up to FAFF a value, FExx an error, FFxx not available.
    (chunk,) = device.decode(batch([(0, 360), (0, 0xFAFF), (0, 0xFE00), (0, 0xFFFF), (0, 360)]))
    assert chunk.raw[:, 0] == pytest.approx([18.0, 3212.75, np.nan, np.nan, 18.0], nan_ok=True)


def test_what_is_not_available_is_a_gap_in_the_recording(device):
    recorder = StreamRecorder("power", device.streams[0])
    recorder.begin(50.0, None)
    numbers = [360] * 400
    numbers[250:260] = [0xFFFF] * 10
    items = []
    for k in range(0, 400, 5):
        for chunk in device.decode(batch([(0, number) for number in numbers[k : k + 5]], k)):
            items += recorder.push(chunk)
    items += recorder.finish(4.0, "over")
    values = np.concatenate([item.values for item in items if isinstance(item, SampleBlock)])
    assert set(values) == {18.0}
    gaps = [item for item in items if isinstance(item, Event)]
    assert {gap.kind for gap in gaps} == {"gap"} and recorder.status()[0].n_missing == 10
    assert [gaps[0].time_s, gaps[-1].end_s] == pytest.approx([2.5, 2.59], abs=0.001)


def test_one_of_several_sources_is_read_and_the_others_are_warned_of(device):
    recorder = StreamRecorder("power", device.streams[0])
    chunks = device.decode(batch([(0x17, 360)]))
    for k in range(1, 200):
        chunks += device.decode(batch([(0x2A, 0), (0x17, 360)], k))
    assert {value for chunk in chunks for value in chunk.raw[:, 0]} == {18.0}
    assert sum(len(chunk.raw) for chunk in chunks) == 200
    items = [item for chunk in chunks for item in recorder.push(chunk)]
    assert items == []
    (warning,) = [item for item in recorder.begin(50.0, None) if isinstance(item, Event)]
    assert warning.kind == "warning"
    assert warning.text == "Power: source address 2A sends it too; 17 is read, which came first"


class TwoSources:
    """A bus on which two nodes send the group in turn every 10 ms; every read takes 0.1 s."""

    time_source, n_discarded_bytes, facts = "of the test", 0, {}

    def __init__(self):
        self.now_s = 50.0
        self.n_read = 0

    def open(self):
        pass

    def close(self):
        pass

    def read(self):
        self.now_s += 0.1
        self.n_read += 10
        return batch([(0x17, 360), (0x2A, 0)] * 5, self.n_read)


def test_check_says_what_the_driver_warned_of(device, monkeypatch):
    bus = TwoSources()
    monkeypatch.setattr(device, "_bus", bus)
    probes = probe_devices([device], seconds=2.0, clock=lambda: bus.now_s)
    (note,) = [finding for finding in judge(probes).findings if finding.code == "driver_warning"]
    assert (note.severity, note.device) == ("note", "power")
    assert "source address 2A" in note.what
