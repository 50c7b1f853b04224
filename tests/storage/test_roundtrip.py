"""Whatever is written is read back, every bit of it; whatever is cut off costs only what was cut off."""

from __future__ import annotations

import struct
import tempfile
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sawbench.bench.errors import RecordingError
from sawbench.bench.recording import Event, SampleBlock, Trial
from sawbench.storage.codec import decode_block, decode_event, encode_block, encode_event
from sawbench.storage.reader import iter_blocks, read_recording
from sawbench.storage.recover import recover_recording
from sawbench.storage.schemas import sample_block_pb2
from sawbench.storage.writer import RecordingWriter

pytestmark = pytest.mark.unit

STARTED_AT = datetime(2026, 3, 2, 9, 0, 0, 123456, tzinfo=UTC)
CHANNELS = ("force_n", "displacement_mm", "Kanal 1")
finite = st.floats(allow_nan=False, allow_infinity=False)
times = st.floats(min_value=-1e6, max_value=1e6)
counts = st.integers(min_value=-(2**31), max_value=2**31 - 1).map(float)
singles = st.floats(allow_nan=False, allow_infinity=False, width=32)


def bits(values):
    return None if values is None else np.asarray(values, dtype=np.float64).tobytes()


def fields_of(block):
    scalars = (block.device, block.channel, block.unit, block.first_index, block.period_s)
    return (*scalars, bits(block.time_s), bits(block.values), bits(block.raw))


@st.composite
def blocks(draw):
    n = draw(st.integers(min_value=1, max_value=12))

    def column(of):
        return np.array(draw(st.lists(of, min_size=n, max_size=n)))

    period_s = draw(st.one_of(st.none(), st.floats(min_value=1e-6, max_value=10.0)))
    if period_s is not None and draw(st.booleans()):
        time_s = draw(times) + np.arange(n) * period_s
        # Another way to the same times, as a driver may count them: rounded differently.
        if draw(st.booleans()):
            time_s = np.array([time_s[0] + period_s * k for k in range(n)]) * (1 + 2**-52)
    else:
        time_s = column(times)
    channel = draw(st.sampled_from(CHANNELS))
    return SampleBlock(
        device=f"device of {channel}",
        channel=channel,
        unit="N",
        first_index=draw(st.integers(min_value=0, max_value=2**63)),
        time_s=time_s,
        values=column(finite),
        raw=draw(st.sampled_from([None, *map(column, (finite, counts, singles))])),
        period_s=period_s,
    )


@settings(derandomize=True, max_examples=300, deadline=None)
@given(blocks())
def test_every_bit_of_a_block_comes_back(block):
    assert fields_of(decode_block(encode_block(block, 1_772_442_000_123_456_000))) == fields_of(block)


@pytest.mark.parametrize("n", [1, 15, 16, 2100])
@pytest.mark.parametrize(("raw", "field"), [(np.pi, "raw"), (0.5, "raw_float"), (None, "raw")])
def test_a_block_is_the_bytes_that_protobuf_itself_writes(n, raw, field):
    values, raws = np.linspace(-1, 1, n) / 3, None if raw is None else raw * np.arange(1, n + 1)
    offsets = np.sort(np.random.default_rng(n).uniform(0, 1, n))
    offsets[0] = 0.0
    block = SampleBlock(
        device="cell", channel="force_n", unit="N", first_index=7, time_s=offsets, values=values, raw=raws
    )
    message = sample_block_pb2.SampleBlock(device="cell", channel="force_n", unit="N", first_index=7)
    message.stamp.SetInParent()
    message.time_s.extend(offsets.tolist())
    message.values.extend(values.tolist())
    if raws is not None:
        getattr(message, field).extend(raws.tolist())
    assert encode_block(block, 0) == message.SerializeToString()


@settings(derandomize=True, max_examples=60, deadline=None)
@given(
    st.builds(
        Event,
        kind=st.sampled_from(["gap", "note", "device", "interrupted", "warning"]),
        time_s=times,
        text=st.text(max_size=30),
        device=st.text(max_size=5),
        channel=st.sampled_from(["", *CHANNELS]),
        end_s=st.one_of(st.none(), times),
    )
)
def test_events_come_back(event):
    assert decode_event(encode_event(event, 0)) == event


@settings(derandomize=True, max_examples=25, deadline=None)
@given(st.lists(blocks(), max_size=8))
def test_any_sequence_of_blocks_comes_back_from_a_file(written):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trial.mcap"
        with open_writer(path) as writer:
            for block in written:
                writer.write_block(block)
        assert [fields_of(block) for block in iter_blocks(path)] == [fields_of(block) for block in written]
        assert read_recording(path).is_complete


def open_writer(path, **settings_):
    return RecordingWriter(
        path=path,
        trial=Trial(trial_id="T1", material="oak", duty=0.4375),
        config_toml="[cutting]\n",
        provenance={"host": "bench"},
        started_at=STARTED_AT,
        **settings_,
    )


N_PER_BLOCK = 100
N_BLOCKS = 40


@pytest.fixture(scope="module")
def flushed_file(tmp_path_factory):
    """A whole recording with a flush after every second block, and where each flush ended."""
    path = tmp_path_factory.mktemp("flushed") / "trial.mcap"
    rng = np.random.default_rng(5)
    ends = []
    with open_writer(path, flush_every_s=1e9) as writer:
        for k in range(N_BLOCKS):
            start = k * N_PER_BLOCK
            writer.write_block(
                SampleBlock(
                    device="cell",
                    channel="force_n",
                    unit="N",
                    first_index=start,
                    time_s=start / 5000 + np.arange(N_PER_BLOCK) / 5000,
                    values=rng.normal(size=N_PER_BLOCK),
                    period_s=1 / 5000,
                )
            )
            if k % 2:
                writer.flush()
                ends.append((path.with_name("trial.mcap.part").stat().st_size, start + N_PER_BLOCK))
    return path, ends


@settings(derandomize=True, max_examples=60, deadline=None)
@given(share=st.floats(min_value=0.0, max_value=1.0))
def test_a_cut_costs_only_what_was_cut_off(flushed_file, share):
    whole_path, ends = flushed_file
    content = whole_path.read_bytes()
    size = int(share * len(content))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cut.mcap.part"
        path.write_bytes(content[:size])
        expected = max((n for end, n in ends if end <= size), default=0)
        # The magic, then the header record: one byte for its kind and eight for its length.
        header_end = 17 + int.from_bytes(content[9:17], "little")
        if size < header_end:
            with pytest.raises(RecordingError):
                read_recording(path)
            return
        recording = read_recording(path)
        signal = recording.signals.get("force_n")
        assert (len(signal.values) if signal else 0) >= expected
        if size < len(content):
            assert not recording.is_complete
            assert recording.events[-1].text
        if expected:
            assert recording.trial.material == "oak"
            assert not signal.gaps
            report = recover_recording(path, Path(folder) / "saved.mcap")
            saved = read_recording(report.path)
            assert bits(saved.signals["force_n"].values) == bits(signal.values)
            assert saved.is_complete == recording.is_complete


@settings(derandomize=True, max_examples=100, deadline=None)
@given(share=st.floats(min_value=0.0, max_value=1.0, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_is_noticed_and_costs_one_flush_at_most(flushed_file, share, bit):
    content = flushed_file[0].read_bytes()
    place = int(share * len(content))
    damaged = bytearray(content)
    damaged[place] ^= 1 << bit
    whole = np.random.default_rng(5).normal(size=N_PER_BLOCK * N_BLOCKS)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flipped.mcap"
        path.write_bytes(damaged)
        if place < 8:
            with pytest.raises(RecordingError, match="not an MCAP file"):
                read_recording(path)
            return
        recording = read_recording(path)
        signal = recording.signals["force_n"]
        assert len(signal.values) >= N_PER_BLOCK * (N_BLOCKS - 2)
        # What is left is at its place: the sample at each time is the one that was written there.
        index = np.rint(signal.time_s * 5000).astype(int)
        assert np.array_equal(signal.values, whole[index])
        if place < summary_start(content):
            assert not recording.is_complete


def summary_start(content):
    """Return where the data section ends, as the footer says: 8 bytes of magic, 20 of footer from the end."""
    return struct.unpack("<Q", content[-28:-20])[0]
