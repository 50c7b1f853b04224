"""The writer: names, copies, previews, flushing, and what a killed program leaves behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from sawbench.bench.errors import InputError, RecordingError
from sawbench.bench.recording import Event, SampleBlock, Trial
from sawbench.storage.describe import describe_recording
from sawbench.storage.reader import read_recording
from sawbench.storage.writer import NO_START_TIME, RecordingWriter

pytestmark = pytest.mark.unit

ROOT = Path(__file__).parents[2]
STARTED_AT = datetime(2026, 3, 2, 9, 0, tzinfo=UTC)


def open_writer(path, **options):
    defaults = {
        "trial": Trial(trial_id="T1", material="oak", duty=0.4375, repetition=2),
        "config_toml": "[cutting]\ncutting_half = 'zero_to_pi'\n",
        "provenance": {"clock": "host"},
        "started_at": STARTED_AT,
    }
    return RecordingWriter(path=path, **(defaults | options))


def block(start, n=10, *, channel="force_n", rate_hz=1000.0, **changes):
    made = {
        "device": "cell",
        "channel": channel,
        "unit": "N",
        "first_index": start,
        "time_s": (start + np.arange(n)) / rate_hz,
        "values": np.arange(start, start + n, dtype=float),
        "period_s": 1 / rate_hz,
    }
    return SampleBlock(**(made | changes))


def test_the_file_has_its_name_only_when_it_is_finished(tmp_path):
    path = tmp_path / "new folder" / "T1.mcap"
    with open_writer(path) as writer:
        writer.write_block(block(0))
        assert [p.name for p in path.parent.iterdir()] == ["T1.mcap.part"]
    assert [p.name for p in path.parent.iterdir()] == ["T1.mcap"]


def test_settings_and_provenance_come_back(tmp_path):
    writer = open_writer(tmp_path / "T1.mcap")
    writer.write_event(Event(kind="note", time_s=1.5, text="äöü"))
    path = writer.close(provenance={"clock": "aligned to 20 us", "gaps": "0"})
    recording = read_recording(path)
    assert recording.trial == Trial(trial_id="T1", material="oak", duty=0.4375, repetition=2, started_at=STARTED_AT)
    assert recording.config_toml == "[cutting]\ncutting_half = 'zero_to_pi'\n"
    assert recording.provenance["clock"] == "aligned to 20 us"
    assert recording.provenance["software"].startswith("sawbench")
    assert recording.events == (Event(kind="note", time_s=1.5, text="äöü"),)
    assert recording.is_complete


def test_an_existing_recording_is_kept_unless_told(tmp_path):
    path = tmp_path / "T1.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(RecordingError, match="--force"):
        open_writer(path)
    assert path.read_bytes() == b"precious"
    assert not list(tmp_path.glob("*.part"))
    with open_writer(path, overwrite=True):
        assert path.read_bytes() == b"precious"
    assert read_recording(path).is_complete


def test_a_part_file_is_never_touched(tmp_path):
    part = tmp_path / "T1.mcap.part"
    part.write_bytes(b"crashed")
    with pytest.raises(RecordingError, match="sawbench recover"):
        open_writer(tmp_path / "T1.mcap", overwrite=True)
    assert part.read_bytes() == b"crashed"


def test_a_file_that_appears_meanwhile_is_not_replaced(tmp_path):
    path = tmp_path / "T1.mcap"
    writer = open_writer(path)
    writer.write_block(block(0))
    path.write_bytes(b"somebody else")
    with pytest.raises(RecordingError, match="already exists"):
        writer.close()
    assert path.read_bytes() == b"somebody else"
    assert read_recording(tmp_path / "T1.mcap.part").is_complete


def test_the_second_copy_is_the_same_file(tmp_path):
    path = tmp_path / "T1.mcap"
    with open_writer(path, second_copy=tmp_path / "stick") as writer:
        writer.write_block(block(0))
    assert (tmp_path / "stick" / "T1.mcap").read_bytes() == path.read_bytes()


class FullDisk:
    """Stands for an open file whose disk has no room left."""

    def __init__(self, replaced):
        replaced.flush()
        self._replaced = replaced

    def write(self, content):
        raise OSError(28, "No space left on device")

    def flush(self):
        pass

    def fileno(self):
        return self._replaced.fileno()

    def tell(self):
        return self._replaced.tell()

    def close(self):
        self._replaced.close()


def test_a_full_disk_is_said_and_what_was_written_stays(tmp_path):
    path = tmp_path / "T1.mcap"
    with pytest.raises(RecordingError, match="No space left") as caught, open_writer(path) as writer:
        writer.write_block(block(0))
        writer.flush()
        file = writer._output._first
        file._stream = FullDisk(file._stream)
        writer.write_block(block(10))
        writer.flush()
    assert "free disk space" in str(caught.value)
    # The trial ran: no wrong usage, which would have been 2.
    assert caught.value.exit_code == 1
    recording = read_recording(tmp_path / "T1.mcap.part")
    assert np.array_equal(recording.signal("force_n").values, np.arange(10.0))
    assert not path.exists()


def test_a_second_copy_in_the_folder_of_the_recording_is_refused(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path, target_is_directory=True)
    for folder in (tmp_path, tmp_path / "link"):
        with pytest.raises(RecordingError, match="folder of the recording too"):
            open_writer(tmp_path / "t.mcap", second_copy=folder)
    assert [path.name for path in tmp_path.iterdir()] == ["link"]


def test_a_lost_second_copy_is_an_event_and_no_more(tmp_path):
    path = tmp_path / "T1.mcap"
    with open_writer(path, second_copy=tmp_path / "stick") as writer:
        writer.write_block(block(0))
        copy = writer._output._second
        copy._stream = FullDisk(copy._stream)
        writer.write_block(block(10))
        writer.flush()
        writer.write_block(block(20))
    recording = read_recording(path)
    assert recording.is_complete
    assert len(recording.signal("force_n").values) == 30
    assert [event.kind for event in recording.events] == ["warning"]
    assert "second copy" in recording.events[0].text


def test_a_second_copy_that_two_threads_find_lost_is_one_event(tmp_path):
    path = tmp_path / "T1.mcap"
    with open_writer(path, second_copy=tmp_path / "stick") as writer:
        output = writer._output
        copy = output._second

        def pulled_out(*_):
            # While this thread waits in the system call the one that syncs meets the same error.
            copy.write = refused
            output.sync()
            refused()

        def refused(*_):
            raise OSError(5, "Input/output error")

        copy.write, copy.sync = pulled_out, refused
        writer.write_block(block(0))
        writer.flush()
        writer.write_block(block(10))
    recording = read_recording(path)
    assert len(recording.signal("force_n").values) == 20
    assert [event.text.partition("stick")[0][:16] for event in recording.events] == ["the second copy "]


def test_the_second_copy_is_finished_where_the_disk_fails_at_the_end(tmp_path):
    def refused():
        raise OSError(5, "Input/output error")

    writer = open_writer(tmp_path / "T1.mcap", second_copy=tmp_path / "stick")
    writer.write_block(block(0))
    writer._output._first.sync = refused
    with pytest.raises(RecordingError, match="Input/output error"):
        writer.close()
    assert not writer.path.exists()
    recording = read_recording(tmp_path / "stick" / "T1.mcap")
    assert recording.is_complete
    assert np.array_equal(recording.signal("force_n").values, np.arange(10.0))


def test_an_exception_is_the_reason_in_the_record(tmp_path):
    path = tmp_path / "T1.mcap"
    with pytest.raises(ValueError, match="boom"), open_writer(path) as writer:
        writer.write_block(block(0))
        raise ValueError("boom")
    recording = read_recording(path)
    assert not recording.is_complete
    assert [(event.kind, event.text) for event in recording.events] == [("interrupted", "ValueError: boom")]
    assert len(recording.signal("force_n").values) == 10


def test_a_closed_writer_says_so(tmp_path):
    writer = open_writer(tmp_path / "T1.mcap")
    assert writer.close() == writer.close()
    with pytest.raises(RecordingError, match="closed"):
        writer.write_block(block(0))


@pytest.mark.parametrize("change", [{"unit": "kN"}, {"device": "other cell"}])
def test_a_channel_keeps_its_unit_and_device(tmp_path, change):
    with open_writer(tmp_path / "T1.mcap") as writer:
        writer.write_block(block(0))
        with pytest.raises(InputError, match="force_n"):
            writer.write_block(block(10, **change))


@pytest.mark.parametrize(
    "option",
    [
        {"preview_rate_hz": 0.0},
        {"preview_rate_hz": 101.0},
        {"flush_every_s": 0.0},
        {"started_at": datetime(2026, 3, 2, 9, 0)},
    ],
)
def test_wrong_settings_are_refused_before_a_file_exists(tmp_path, option):
    with pytest.raises(InputError):
        open_writer(tmp_path / "T1.mcap", **option)
    assert not list(tmp_path.iterdir())


def test_without_a_start_time_log_times_count_from_1970_and_it_is_said(tmp_path):
    path = tmp_path / "T1.mcap"
    with open_writer(path, started_at=None) as writer:
        writer.write_block(block(0, time_s=np.arange(10) - 0.5, period_s=None))
    recording = read_recording(path)
    assert recording.provenance["log_time"] == NO_START_TIME
    assert recording.trial.started_at is None
    assert recording.signal("force_n").time_s[0] == -0.5
    with path.open("rb") as stream:
        assert make_reader(stream).get_summary().statistics.message_start_time == 0


def test_every_flush_interval_the_samples_are_in_the_file(tmp_path):
    now_s = [0.0]
    # So long an interval that only the simulated clock can make a flush due.
    writer = open_writer(tmp_path / "T1.mcap", clock=lambda: now_s[0], flush_every_s=1000.0)
    part = tmp_path / "T1.mcap.part"
    for k in range(4):
        now_s[0] = 300.0 * k
        writer.write_block(block(10 * k))
    assert "force_n" not in read_recording(part).signals
    now_s[0] = 1200.0
    writer.write_block(block(40))
    assert len(read_recording(part).signal("force_n").values) == 50
    now_s[0] = 1500.0
    writer.write_block(block(50))
    assert len(read_recording(part).signal("force_n").values) == 50
    writer.close()


def test_samples_that_nothing_follows_are_flushed_too(tmp_path):
    flushed = threading.Event()

    class Watched(RecordingWriter):
        def _flush(self):
            super()._flush()
            flushed.set()

    path = tmp_path / "T1.mcap"
    writer = Watched(
        path=path,
        trial=Trial(trial_id="T1"),
        config_toml="",
        provenance={},
        started_at=None,
        flush_every_s=0.02,
    )
    with writer:
        with writer._lock:  # the flush of the write itself is not due or has not run
            writer.write_block(block(0))
            flushed.clear()
            writer._is_dirty = True
        assert flushed.wait(timeout=10)
        assert len(read_recording(tmp_path / "T1.mcap.part").signal("force_n").values) == 10


def test_samples_wait_for_three_quarters_of_a_flush_interval_at_most(tmp_path, monkeypatch):
    """They are over a tenth of a second old when they come, and a kill may cost one interval in all."""
    now_s, waiting_since_s, waited_s = [0.0], [], []
    writer = open_writer(tmp_path / "T1.mcap", clock=lambda: now_s[0], flush_every_s=1.0)
    writer._stopping.set()
    writer._flusher.join()
    flush = writer._mcap.flush

    def flushed():
        waited_s.extend(now_s[0] - since_s for since_s in waiting_since_s)
        waiting_since_s.clear()
        flush()

    def wait(seconds):
        """Blocks come just after the thread looked, and it is woken a little late."""
        waiting_since_s.append(now_s[0])
        writer.write_block(block(round(1e6 * now_s[0])))
        now_s[0] += 1.04 * seconds
        return now_s[0] > 10.0

    monkeypatch.setattr(writer._mcap, "flush", flushed)
    monkeypatch.setattr(writer, "_stopping", SimpleNamespace(wait=wait, set=lambda: None))
    writer._flush_regularly()
    assert len(waited_s) > 30
    assert max(waited_s) <= 0.75
    writer.close()


def test_threads_may_share_a_writer(tmp_path):
    path = tmp_path / "T1.mcap"
    channels = ["a", "b", "c", "d"]
    with open_writer(path) as writer:

        def write(channel):
            for k in range(50):
                writer.write_block(block(10 * k, channel=channel))

        threads = [threading.Thread(target=write, args=(channel,)) for channel in channels]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    recording = read_recording(path)
    for channel in channels:
        assert np.array_equal(recording.signal(channel).values, np.arange(500.0))
        assert not recording.signal(channel).gaps


def decoded_with_the_schema_in_the_file(path):
    """Decode as another program does: with nothing but what the file says about itself."""
    factories = {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            if schema.id not in factories:
                pool = descriptor_pool.DescriptorPool()
                for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                    pool.Add(file)
                factories[schema.id] = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            yield channel.topic, message.log_time, factories[schema.id].FromString(message.data)


def test_other_programs_can_decode_the_file(tmp_path):
    path = tmp_path / "T1.mcap"
    with open_writer(path, preview_rate_hz=50.0) as writer:
        for k in range(10):
            writer.write_block(block(10 * k, raw=np.arange(10.0) - 5))
        writer.write_event(Event(kind="note", time_s=0.05, text="knot"))
    found = {}
    for topic, log_time, message in decoded_with_the_schema_in_the_file(path):
        found.setdefault(topic, []).append((log_time, message))
    log_time, first = found["/signals/force_n"][0]
    start_ns = int(STARTED_AT.timestamp()) * 10**9
    assert log_time == start_ns
    assert (first.stamp.seconds, first.stamp.nanos) == divmod(start_ns, 10**9)
    assert list(first.values) == list(range(10))
    assert list(first.raw_counts) == list(range(-5, 5))
    assert (first.period_s, list(first.time_s)) == (0.001, [])
    # 100 samples in 0.1 s are five intervals of 20 samples.
    rows = [(m.min, m.mean, m.max, m.unit) for _, m in found["/preview/force_n"]]
    assert rows == [(20 * k, 20 * k + 9.5, 20 * k + 19, "N") for k in range(5)]
    assert [t - start_ns for t, _ in found["/preview/force_n"]] == [10_000_000 + 20_000_000 * k for k in range(5)]
    assert found["/events"][0][1].text == "knot"


KILLED = """
import os, signal, sys
import numpy as np
from sawbench.bench.recording import SampleBlock, Trial
from sawbench.storage.writer import RecordingWriter

now_s = [0.0]
writer = RecordingWriter(path=sys.argv[1], trial=Trial(trial_id="T1", material="oak"), config_toml="x = 1",
    provenance={}, started_at=None, clock=lambda: now_s[0], flush_every_s=1.0)
for k in range(370):
    now_s[0] = (k + 1) / 100
    for channel in ("force_n", "displacement_mm"):
        index = np.arange(50 * k, 50 * k + 50)
        writer.write_block(SampleBlock(device="d", channel=channel, unit="", first_index=50 * k,
            time_s=index / 5000, values=index, period_s=1 / 5000))
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")
def test_sigkill_costs_at_most_one_flush_interval(tmp_path):
    """Simulated clock: 3.7 s of 2 x 5 kHz, killed without warning between two flushes."""
    path = tmp_path / "T1.mcap"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    killed = subprocess.run([sys.executable, "-c", KILLED, str(path)], env=environment, check=False)
    assert killed.returncode == -signal.SIGKILL
    assert not path.exists()
    recording = read_recording(tmp_path / "T1.mcap.part")
    assert not recording.is_complete
    assert recording.events[-1].kind == "interrupted"
    assert (recording.trial.material, recording.config_toml) == ("oak", "x = 1")
    for channel in ("force_n", "displacement_mm"):
        kept = recording.signal(channel)
        assert 2.7 * 5000 <= len(kept.values) <= 3.7 * 5000
        assert np.array_equal(kept.values, np.arange(len(kept.values)))
        assert not kept.gaps


def test_times_beyond_any_clock_are_refused(tmp_path):
    with open_writer(tmp_path / "T1.mcap") as writer, pytest.raises(InputError, match="milliseconds"):
        writer.write_block(block(0, time_s=1.77e18 + np.arange(10) * 1e9, period_s=None))


def test_time_zones_are_kept(tmp_path):
    from datetime import timezone

    local = datetime(2026, 3, 2, 10, 0, tzinfo=timezone(timedelta(hours=1)))
    with open_writer(tmp_path / "T1.mcap", started_at=local):
        pass
    info = describe_recording(tmp_path / "T1.mcap")
    assert info.trial.started_at == STARTED_AT
    assert info.trial.started_at.utcoffset() == timedelta(hours=1)


def test_the_index_of_a_long_recording_stays_small_and_is_whole(tmp_path):
    writer = open_writer(tmp_path / "long.mcap")
    for second in range(200):
        writer.write_block(block(1000 * second))
        writer.flush()
    kept = writer._mcap._Writer__chunk_indices
    # An hour of two chunks a second with nine topics is to stay below 2 MB; here two topics a chunk.
    assert 200 * 80 < len(kept.content) < 200 * 130
    writer.close()
    with (tmp_path / "long.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    chunks = summary.chunk_indexes
    assert len(chunks) == summary.statistics.chunk_count == 201
    assert all(a.chunk_start_offset + a.chunk_length < b.chunk_start_offset for a, b in pairwise(chunks))
    # The reader of the library finds every block through the index.
    with (tmp_path / "long.mcap").open("rb") as stream:
        assert sum(1 for _ in make_reader(stream).iter_messages(topics=["/signals/force_n"])) == 200
