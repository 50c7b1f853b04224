"""Blocks, events and metadata to bytes and back, bit for bit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Final

import numpy as np
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Event, Floats, SampleBlock, Trial
from sawbench.storage.schemas import event_pb2, preview_pb2, sample_block_pb2

PROFILE: Final = "sawbench"
FORMAT_VERSION: Final = 1
SIGNAL_TOPIC: Final = "/signals/"
PREVIEW_TOPIC: Final = "/preview/"
EVENT_TOPIC: Final = "/events"
MESSAGE_TYPES: Final = {
    "sawbench.SampleBlock": sample_block_pb2.SampleBlock,
    "sawbench.Preview": preview_pb2.Preview,
    "sawbench.Event": event_pb2.Event,
}
_NS: Final = 1_000_000_000
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_MAX_ULP: Final = 64
# Wire type of protobuf: a length, and so many bytes.
_WITH_LENGTH: Final = 2


def schema_data(message_type: str) -> bytes:
    """Return the self-contained schema of a message type: its file and everything it imports.

    Parameters
    ----------
    message_type : str
        A key of `MESSAGE_TYPES`.

    Returns
    -------
    bytes
        A serialised `google.protobuf.FileDescriptorSet`.
    """
    files: dict[str, FileDescriptor] = {}

    def collect(descriptor: FileDescriptor) -> None:
        for dependency in descriptor.dependencies:
            collect(dependency)
        files.setdefault(descriptor.name, descriptor)

    collect(MESSAGE_TYPES[message_type].DESCRIPTOR.file)
    descriptors = FileDescriptorSet()
    for descriptor in files.values():
        descriptor.CopyToProto(descriptors.file.add())
    return descriptors.SerializeToString()


def epoch_ns(started_at: datetime | None) -> int:
    """Return the UTC time of a recording's zero in ns since 1970 (0 where it is unknown)."""
    if started_at is None:
        return 0
    if started_at.tzinfo is None:
        raise InputError(f"started_at {started_at.isoformat()} has no time zone", remedy="add one, for example +00:00")
    since = started_at - _EPOCH
    return (since.days * 86400 + since.seconds) * _NS + since.microseconds * 1000


def log_time_ns(origin_ns: int, time_s: float) -> int:
    """Return the MCAP log time of `time_s`: ns since 1970, not below 0."""
    log_time = origin_ns + round(time_s * _NS)
    if log_time >= 2**63:
        raise InputError(
            f"time {time_s:.6g} s is more than 292 years after the epoch",
            remedy="give times in seconds, not in milliseconds or nanoseconds",
        )
    return max(0, log_time)


def _stamp(origin_ns: int, time_s: float) -> Timestamp:
    seconds, nanos = divmod(origin_ns + round(time_s * _NS), _NS)
    return Timestamp(seconds=seconds, nanos=nanos)


def encode_block(block: SampleBlock, origin_ns: int) -> bytes:
    """Serialise a block.

    Parameters
    ----------
    block : SampleBlock
        At least one sample.
    origin_ns : int
        UTC of the recording's zero, ns since 1970.

    Returns
    -------
    bytes
        A `sawbench.SampleBlock`; `decode_block` returns the same block, every bit of it.
    """
    start_s = float(block.time_s[0])
    message = sample_block_pb2.SampleBlock(
        stamp=_stamp(origin_ns, start_s),
        device=block.device,
        channel=block.channel,
        unit=block.unit,
        first_index=block.first_index,
        start_s=start_s,
        period_s=block.period_s or 0.0,
    )
    _append(message, "values", block.values)
    ulp = np.zeros(0, dtype=np.int64)
    if block.period_s:
        ulp = _ulp_distance(block.time_s, _grid(start_s, block.period_s, len(block.time_s)))
    if not block.period_s or (np.abs(ulp) > _MAX_ULP).any():
        offsets = block.time_s - start_s
        ulp = _ulp_distance(block.time_s, start_s + offsets)
        _append(message, "time_s", offsets)
    if ulp.any():
        message.time_ulp.extend(ulp.tolist())
    _put_raw(message, block.raw)
    return message.SerializeToString()


def decode_block(data: bytes) -> SampleBlock:
    """Return the block that `encode_block` was given.

    Raises
    ------
    InputError
        If the arrays of the message contradict each other.
    google.protobuf.message.DecodeError
        If `data` is no SampleBlock.
    """
    message = sample_block_pb2.SampleBlock.FromString(data)
    values = np.array(message.values, dtype=np.float64)
    if len(message.time_s):
        time_s = message.start_s + np.array(message.time_s, dtype=np.float64)
    else:
        time_s = _grid(message.start_s, message.period_s, len(values))
    if len(message.time_ulp):
        shifted = time_s.view(np.int64) + np.array(message.time_ulp, dtype=np.int64)
        time_s = shifted.view(np.float64)
    return SampleBlock(
        device=message.device,
        channel=message.channel,
        unit=message.unit,
        first_index=message.first_index,
        time_s=time_s,
        values=values,
        raw=_get_raw(message),
        period_s=message.period_s or None,
    )


def is_equally_spaced(time_s: Floats, period_s: float) -> bool:
    """Return whether `time_s[0] + k * period_s` gives the times up to rounding."""
    distance = _ulp_distance(time_s, _grid(float(time_s[0]), period_s, len(time_s)))
    return bool((np.abs(distance) <= _MAX_ULP).all())


def _grid(start_s: float, period_s: float, n: int) -> Floats:
    return start_s + np.arange(n, dtype=np.float64) * np.float64(period_s)


def _ulp_distance(time_s: Floats, predicted_s: Floats) -> NDArray[np.int64]:
    """Return how many representable numbers lie between (wraps, so that adding it always inverts)."""
    return time_s.view(np.int64) - predicted_s.view(np.int64)


def _put_raw(message: sample_block_pb2.SampleBlock, raw: Floats | None) -> None:
    """Store `raw` in the smallest of the three forms that gives every bit back."""
    if raw is None:
        return
    bits = raw.view(np.int64)
    if (np.abs(raw) < 2**31).all():
        counts = raw.astype(np.int32)
        if np.array_equal(counts.astype(np.float64).view(np.int64), bits):
            message.raw_counts.extend(counts.tolist())
            return
    with np.errstate(over="ignore"):
        singles = raw.astype(np.float32)
    if np.array_equal(singles.astype(np.float64).view(np.int64), bits):
        _append(message, "raw_float", singles)
    else:
        _append(message, "raw", raw)


def _append(message: sample_block_pb2.SampleBlock, field: str, numbers: NDArray[np.float64 | np.float32]) -> None:
    """Append to a repeated field the bytes that are stored; protobuf itself takes an object for each number."""
    content = numbers.astype(numbers.dtype.newbyteorder("<"), copy=False).tobytes()
    key = sample_block_pb2.SampleBlock.DESCRIPTOR.fields_by_name[field].number << 3 | _WITH_LENGTH
    message.MergeFromString(_varint(key) + _varint(len(content)) + content)


def _varint(number: int) -> bytes:
    """A number as protobuf writes it, seven bits a byte, the lowest first."""
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes((*out, number))


def _get_raw(message: sample_block_pb2.SampleBlock) -> Floats | None:
    for stored in (message.raw_counts, message.raw_float, message.raw):
        if len(stored):
            return np.array(stored, dtype=np.float64)
    return None


def encode_event(event: Event, origin_ns: int) -> bytes:
    """Serialise an event as a `sawbench.Event`; `origin_ns` as in `encode_block`."""
    return event_pb2.Event(
        stamp=_stamp(origin_ns, event.time_s),
        kind=event.kind,
        time_s=event.time_s,
        text=event.text,
        device=event.device,
        channel=event.channel,
        end_s=event.end_s,
    ).SerializeToString()


def decode_event(data: bytes) -> Event:
    """Return the event that `encode_event` was given."""
    message = event_pb2.Event.FromString(data)
    kind: Any = message.kind
    return Event(
        kind=kind,
        time_s=message.time_s,
        text=message.text,
        device=message.device,
        channel=message.channel,
        end_s=message.end_s if message.HasField("end_s") else None,
    )


def encode_preview(interval: tuple[float, float, float, float], unit: str, origin_ns: int) -> bytes:
    """Serialise an interval of `storage.preview` (time in s, values in `unit`) as a `sawbench.Preview`."""
    time_s, lowest, mean, highest = interval
    return preview_pb2.Preview(
        stamp=_stamp(origin_ns, time_s), min=lowest, mean=mean, max=highest, unit=unit
    ).SerializeToString()


_NUMBERS: Final = ("duty", "thickness_mm", "feed_mm_s")
_TEXTS: Final = ("trial_id", "material", "blade", "battery", "operator", "notes", "batch", "source")


def trial_to_metadata(trial: Trial) -> dict[str, str]:
    """Return a trial as the text pairs of an MCAP metadata record; what nobody said is left out.

    Examples
    --------
    >>> trial_to_metadata(Trial(trial_id="T1", duty=0.5))["duty"]
    '0.5'
    """
    pairs = {"format_version": str(FORMAT_VERSION)}
    for name in _TEXTS:
        if getattr(trial, name) is not None:
            pairs[name] = getattr(trial, name)
    for name in _NUMBERS:
        if getattr(trial, name) is not None:
            pairs[name] = repr(float(getattr(trial, name)))
    if trial.repetition is not None:
        pairs["repetition"] = str(int(trial.repetition))
    if trial.started_at is not None:
        pairs["started_at"] = trial.started_at.isoformat()
    if trial.amendments:
        pairs["amendments"] = "\n".join(trial.amendments)
    return pairs


def trial_from_metadata(pairs: Mapping[str, str]) -> Trial:
    """Return the trial that `trial_to_metadata` was given.

    Raises
    ------
    InputError
        If the record was written by a newer sawbench.
    KeyError, ValueError
        If the record is damaged.
    """
    version = int(pairs.get("format_version", "1"))
    if version > FORMAT_VERSION:
        raise InputError(
            f"is in format version {version}; this sawbench reads up to {FORMAT_VERSION}",
            remedy="update sawbench",
        )
    found: dict[str, Any] = {name: pairs[name] for name in _TEXTS if name in pairs}
    found |= {name: float(pairs[name]) for name in _NUMBERS if name in pairs}
    if not all(math.isfinite(found[name]) for name in _NUMBERS if name in found):
        raise ValueError("a setting is not finite")
    if "repetition" in pairs:
        found["repetition"] = int(pairs["repetition"])
    if "started_at" in pairs:
        found["started_at"] = datetime.fromisoformat(pairs["started_at"])
    if "amendments" in pairs:
        found["amendments"] = tuple(pairs["amendments"].split("\n"))
    return Trial(**{"trial_id": pairs["trial_id"], **found})
