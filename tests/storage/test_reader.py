"""The reader: gaps, damage, other programs' files, files that are no recordings."""

from __future__ import annotations

import os
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import zstandard
from sawbench.bench.errors import RecordingError, WritingError
from sawbench.bench.recording import Event, Gap, Recording, SampleBlock, Signal, Trial
from sawbench.storage.assembly import find_time_jumps
from sawbench.storage.container import MAGIC
from sawbench.storage.describe import describe_recording
from sawbench.storage.digest import sha256_of
from sawbench.storage.reader import read_recording, write_recording
from sawbench.storage.recover import recover_recording
from sawbench.storage.writer import RecordingWriter

pytestmark = pytest.mark.unit

SHARED = Path(os.environ.get("SAWBENCH_SHARED") or Path(__file__).parents[3] / "shared") / "data"
ROSBAGS = SHARED / "mcap_rosbag2"


def write(path, *items, flush_after=()):
    writer = RecordingWriter(
        path=path,
        trial=Trial(trial_id="T1"),
        config_toml="",
        provenance={},
        started_at=None,
        flush_every_s=1e9,
    )
    with writer:
        for number, item in enumerate(items):
            if isinstance(item, Event):
                writer.write_event(item)
            else:
                writer.write_block(item)
            if number in flush_after:
                writer.flush()
    return path


def block(first_index, time_s, *, raw=None):
    time_s = np.asarray(time_s, dtype=float)
    return SampleBlock(
        device="cell",
        channel="force_n",
        unit="N",
        first_index=first_index,
        time_s=time_s,
        values=np.sin(time_s),
        raw=raw,
    )


def test_a_jump_of_the_index_is_a_gap_with_the_reason_the_recorder_gave(tmp_path):
    told = Event(kind="device", time_s=0.0105, end_s=0.013, text="cable pulled", device="cell")
    path = write(tmp_path / "a.mcap", block(100, np.arange(10) / 1000), told, block(115, np.arange(15, 25) / 1000))
    gaps = read_recording(path).signal("force_n").gaps
    assert gaps == (Gap(start_s=0.009, end_s=0.015, n_missing=5, reason="cable pulled"),)


def test_a_jump_of_the_time_alone_is_a_gap(tmp_path):
    path = write(tmp_path / "a.mcap", block(0, np.arange(10) / 1000), block(10, np.arange(30, 50) / 1000))
    assert read_recording(path).signal("force_n").gaps == (
        Gap(start_s=0.009, end_s=0.030, n_missing=20, reason="the time jumps"),
    )


def test_a_device_that_counts_anew_leaves_a_gap(tmp_path):
    path = write(tmp_path / "a.mcap", block(500, np.arange(10) / 1000), block(0, np.arange(20, 40) / 1000))
    (gap,) = read_recording(path).signal("force_n").gaps
    assert (gap.start_s, gap.end_s, gap.n_missing) == (0.009, 0.020, 10)
    assert "restarted" in gap.reason


def test_time_that_steps_back_is_left_out_and_said(tmp_path):
    path = write(tmp_path / "a.mcap", block(0, [0.0, 0.1, 0.2, 0.3]), block(4, [0.25, 0.3, 0.4, 0.5]))
    recording = read_recording(path)
    assert recording.signal("force_n").time_s.tolist() == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    (event,) = recording.events
    assert event.kind == "warning"
    assert "2 samples" in event.text


def test_raw_values_of_only_some_blocks_are_left_out_and_said(tmp_path):
    path = write(tmp_path / "a.mcap", block(0, [0.0, 0.1], raw=np.array([7.0, 8.0])), block(2, [0.2, 0.3]))
    recording = read_recording(path)
    assert recording.signal("force_n").raw is None
    assert "raw values" in recording.events[0].text


def test_a_slow_change_of_rate_is_no_jump():
    spin_up = np.cumsum(np.concatenate((np.linspace(0.3, 0.07, 15), np.full(100, 0.07))))
    assert find_time_jumps(spin_up).size == 0
    lost = np.delete(np.arange(1000) / 5000, [400, 700, 701])
    assert find_time_jumps(lost).tolist() == [400, 699]


def test_jitter_is_no_jump_but_ten_missing_samples_are():
    rng = np.random.default_rng(2)
    time_s = (np.arange(5000) + rng.uniform(-0.2, 0.2, 5000)) / 1000
    assert find_time_jumps(time_s).size == 0
    assert find_time_jumps(np.delete(time_s, np.s_[2000:2010])).tolist() == [2000]


def test_gaps_of_a_recording_survive_writing_and_reading(tmp_path):
    time_s = np.concatenate((np.arange(3000), np.arange(3007, 9000))) / 5000
    signal = Signal(
        channel="force_n",
        unit="N",
        time_s=time_s,
        values=np.cos(time_s),
        raw=np.arange(len(time_s), dtype=float),
        gaps=(Gap(start_s=time_s[2999], end_s=time_s[3000], n_missing=7, reason="checksum"),),
        device="cell",
    )
    other = Signal(channel="motor_current_a", unit="A", time_s=np.arange(1800) / 1000, values=np.ones(1800))
    recording = Recording(trial=Trial(trial_id="T"), signals={"force_n": signal, "motor_current_a": other})
    once = read_recording(write_recording(recording, tmp_path / "a.mcap"))
    twice = read_recording(write_recording(once, tmp_path / "b.mcap"))
    for back in (once, twice):
        found = back.signal("force_n")
        assert found.gaps == signal.gaps
        assert np.array_equal(found.time_s, time_s)
        assert np.array_equal(found.values, signal.values)
        assert np.array_equal(found.raw, signal.raw)
        assert not back.signal("motor_current_a").gaps
        assert [(e.kind, e.text) for e in back.events] == [("gap", "checksum")]


def test_the_description_counts_what_is_there(tmp_path):
    note = Event(kind="note", time_s=0.0, text="hello")
    path = write(tmp_path / "a.mcap", note, block(0, np.arange(100) / 1000), block(105, np.arange(105, 201) / 1000))
    info = describe_recording(path)
    (channel,) = info.channels
    assert (channel.channel, channel.unit, channel.device) == ("force_n", "N", "cell")
    assert (channel.n_samples, channel.rate_hz, channel.duration_s) == (196, 1000.0, 0.2)
    assert [gap.n_missing for gap in channel.gaps] == [5]
    assert info.is_complete
    assert info.problems == ()
    assert not info.has_config
    assert info.size_bytes == path.stat().st_size
    assert {t.topic: t.n_messages for t in info.topics}["/signals/force_n"] == 2
    assert info.events == (note,)


def test_a_lost_chunk_is_a_gap_that_says_what_was_in_it(tmp_path):
    path = write(
        tmp_path / "a.mcap",
        *(block(100 * k, np.arange(100 * k, 100 * k + 100) / 1000) for k in range(4)),
        flush_after=(0, 1, 2, 3),
    )
    content = bytearray(path.read_bytes())
    chunks = [at for at in range(len(content)) if content[at : at + 8] == b"\x04\x00\x00\x00zstd"]
    content[chunks[0] + 300] ^= 0x10  # the first chunk is the one that announces the topics
    content[chunks[2] + 300] ^= 0x10
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    recording = read_recording(damaged)
    assert not recording.is_complete
    signal = recording.signal("force_n")
    assert np.array_equal(signal.time_s, np.r_[100:200, 300:400] / 1000)
    (gap,) = signal.gaps
    assert (gap.start_s, gap.end_s, gap.n_missing) == (0.199, 0.3, 100)
    assert "checksum" in gap.reason or "damaged" in gap.reason
    assert "messages lost" in gap.reason

    report = recover_recording(damaged, tmp_path / "saved.mcap")
    # Five chunks: one a flush, and the preview interval that closing completes.
    assert (report.n_chunks_kept, report.n_chunks_bad, report.is_tail_cut) == (3, 2, False)
    # Each lost second chunk held its block and the preview intervals that it completed.
    whole = sum(topic.n_messages for topic in describe_recording(path).topics)
    assert report.n_messages_kept + report.n_messages_lost == whole
    assert report.n_messages_lost >= 2
    assert 0.1 < report.seconds_lost < 0.3
    saved = read_recording(report.path)
    assert np.array_equal(saved.signal("force_n").values, signal.values)
    assert saved.signal("force_n").gaps == signal.gaps
    assert not saved.is_complete
    assert saved.provenance["recovered_from"] == "damaged.mcap"


@pytest.mark.parametrize("n_chunks", [1, 4])
@pytest.mark.parametrize("stated_ns", [(2**64 - 1, 2**64 - 1), (10**18, 2 * 10**18)])
def test_times_of_a_damaged_chunk_that_cannot_be_are_not_believed(tmp_path, n_chunks, stated_ns):
    whole = write(
        tmp_path / "a.mcap",
        *(block(100 * k, np.arange(100 * k, 100 * k + 100) / 1000) for k in range(n_chunks)),
        flush_after=range(n_chunks),
    )
    content = bytearray(whole.read_bytes())
    marks = [at for at in range(len(content)) if content[at : at + 8] == b"\x04\x00\x00\x00zstd"]
    head = marks[n_chunks // 2] - 28
    content[head : head + 16] = struct.pack("<QQ", *stated_ns)
    content[head + 300] ^= 0x10
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    report = recover_recording(damaged, tmp_path / "saved.mcap")
    assert report.n_chunks_bad == 1
    assert report.seconds_lost == 0.0
    for path in (damaged, report.path):
        recording = read_recording(path)
        assert all(event.time_s < 1.0 for event in recording.events)
        kept = recording.signal("force_n").time_s if n_chunks > 1 else []
        assert len(kept) == 100 * (n_chunks - 1)


@pytest.mark.skipif(os.name != "posix", reason="needs a limit of file sizes")
def test_recovery_to_a_full_disk_leaves_nothing_and_says_where(tmp_path):
    """Half a file would stand in the way of the next try, as a recording that runs."""
    import resource

    path, out = write(tmp_path / "a.mcap", block(0, [0.0, 0.1])), tmp_path / "saved.mcap"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    try:
        with pytest.raises(WritingError, match=r"saved\.mcap: cannot be written: File too large") as caught:
            recover_recording(path, out)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert caught.value.exit_code == 1 and "free disk space, or give a file on another disk" in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]
    assert recover_recording(path, out).n_messages_kept


def test_a_part_file_in_the_way_of_a_recovery_is_told_from_its_source(tmp_path):
    """It said to recover it: that is what was being done."""
    source = write(tmp_path / "a.mcap", block(0, [0.0, 0.1])).rename(tmp_path / "a.mcap.part")
    with pytest.raises(RecordingError, match="the name with -recovered") as caught:
        recover_recording(source, tmp_path / "a.mcap", overwrite=True)
    assert "sawbench recover" not in str(caught.value)
    (tmp_path / "b.mcap.part").write_bytes(b"killed")
    with pytest.raises(RecordingError, match=r"b\.mcap\.part: already exists.*\n.*delete it: a\.mcap\.part still has"):
        recover_recording(source, tmp_path / "b.mcap", overwrite=True)
    assert (tmp_path / "b.mcap.part").read_bytes() == b"killed"
    assert recover_recording(source, tmp_path / "c.mcap").n_messages_kept


def test_recovery_never_harms_its_source(tmp_path):
    path = write(tmp_path / "a.mcap", block(0, [0.0, 0.1]))
    with pytest.raises(RecordingError, match="to its own file"):
        recover_recording(path, path, overwrite=True)
    (tmp_path / "b.mcap").write_bytes(b"x")
    with pytest.raises(RecordingError, match="--force"):
        recover_recording(path, tmp_path / "b.mcap")
    with pytest.raises(RecordingError, match="not an MCAP file"):
        recover_recording(tmp_path / "b.mcap", tmp_path / "c.mcap")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "b.mcap"]


@pytest.mark.parametrize("content", [b"", b"time_s,force_n\n0,1\n", MAGIC[:5]])
@pytest.mark.parametrize("read", [read_recording, describe_recording])
def test_a_file_that_is_no_recording(tmp_path, content, read):
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match="is not a recording"):
        read(path)


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(RecordingError, match="no such file"):
        read_recording(tmp_path / "none.mcap")
    with pytest.raises(RecordingError, match="cannot be read"):
        read_recording(tmp_path)
    with pytest.raises(RecordingError):
        sha256_of(tmp_path / "none.mcap")


def test_a_newer_format_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("sawbench.storage.codec.FORMAT_VERSION", 2)
    path = write(tmp_path / "a.mcap", block(0, [0.0, 0.1]))
    monkeypatch.undo()
    with pytest.raises(RecordingError, match="update sawbench"):
        read_recording(path)


def test_the_hash_is_sha256(tmp_path):
    path = tmp_path / "abc"
    path.write_bytes(b"abc")
    assert sha256_of(path) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


# Message counts as the data's README states them from the recordings' own metadata.
@pytest.mark.skipif(not ROSBAGS.is_dir(), reason="shared data absent")
@pytest.mark.parametrize(("pattern", "n_messages"), [("*talker*", 20), ("*wbag*", 1246), ("*seek*", 5)])
def test_mcap_files_of_other_programs(tmp_path, pattern, n_messages):
    (path,) = ROSBAGS.glob(pattern)
    info = describe_recording(path)
    assert not info.is_sawbench
    assert info.is_complete
    assert info.trial is None
    assert sum(topic.n_messages for topic in info.topics) == n_messages
    with pytest.raises(RecordingError, match="not a sawbench recording") as caught:
        read_recording(path)
    assert info.topics[0].topic in str(caught.value)
    report = recover_recording(path, tmp_path / "copy.mcap")
    assert report.n_messages_kept == n_messages
    assert not describe_recording(report.path).is_sawbench


def test_a_signal_that_never_comes_back_has_its_gap(tmp_path):
    path = tmp_path / "cut.mcap"
    time_s = np.arange(1000) * 1e-3
    block = SampleBlock(device="cell", channel="force_n", unit="N", first_index=0, time_s=time_s, values=time_s)
    with RecordingWriter(
        path=path, trial=Trial(trial_id="cut"), config_toml="", provenance={}, started_at=None
    ) as writer:
        writer.write_block(block)
        text = "about 1001 samples missing: the link broke"
        writer.write_event(Event(kind="gap", time_s=0.999, end_s=2.0, text=text, device="cell", channel="force_n"))
    (gap,) = read_recording(path).signal("force_n").gaps
    assert (gap.start_s, gap.end_s, gap.n_missing, gap.reason) == (0.999, 2.0, 1001, text)
    assert describe_recording(path).channels[0].gaps == (gap,)
    # Written again, nothing is added and nothing lost.
    again = write_recording(read_recording(path), tmp_path / "again.mcap")
    assert read_recording(again).signal("force_n").gaps == (gap,)


def chunk_record(data, *, uncompressed_size, crc=0, compression=b"zstd"):
    """A chunk record, written from the format's description."""
    body = struct.pack("<QQQI", 0, 1, uncompressed_size, crc)
    body += struct.pack("<I", len(compression)) + compression + struct.pack("<Q", len(data)) + data
    return b"\x06" + struct.pack("<Q", len(body)) + body


@pytest.fixture
def whole(tmp_path):
    path = tmp_path / "whole.mcap"
    write(path, block(0, np.arange(200) * 1e-3))
    return path


def test_a_decompression_bomb_is_not_unpacked(whole):
    content = whole.read_bytes()
    bomb = zstandard.compress(bytes(1 << 30))
    header_end = 17 + int.from_bytes(content[9:17], "little")
    for claimed in (1 << 30, 100):
        record = chunk_record(bomb, uncompressed_size=claimed)
        whole.write_bytes(content[:header_end] + record + content[header_end:])
        tracemalloc.start()
        recording = read_recording(whole)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert not recording.is_complete
        assert peak < 1 << 27
        assert len(recording.signal("force_n").values) == 200


def test_a_chunk_without_checksum_is_not_vouched_for(whole):
    content = whole.read_bytes()
    header_end = 17 + int.from_bytes(content[9:17], "little")
    record = chunk_record(zstandard.compress(b""), uncompressed_size=0)
    whole.write_bytes(content[:header_end] + record + content[header_end:])
    info = describe_recording(whole)
    assert not info.is_complete
    assert any("no checksum" in problem for problem in info.problems)
    assert not any("samples are whole" in problem for problem in info.problems)


def test_another_recording_in_the_middle_is_said(whole):
    content = whole.read_bytes()
    header_end = 17 + int.from_bytes(content[9:17], "little")
    whole.write_bytes(content[:header_end] + content + content[header_end:])
    info = describe_recording(whole)
    assert not info.is_complete
    (problem,) = [text for text in info.problems if f"another file begins at byte {header_end}" in text]
    assert f"{2 * len(content) - header_end} bytes" in problem and "are not verified" in problem


def test_two_recordings_glued_together_are_said(whole):
    content = whole.read_bytes()
    whole.write_bytes(content + content)
    info = describe_recording(whole)
    assert not info.is_complete
    assert any(f"{len(content)} bytes after the end" in problem for problem in info.problems)
