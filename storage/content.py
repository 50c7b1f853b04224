"""The messages and settings of an MCAP file, however damaged it is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from google.protobuf.message import DecodeError
from mcap.records import Channel, Header, McapRecord, Message, Metadata, Schema
from sawbench.bench.errors import InputError, RecordingError
from sawbench.bench.recording import Event, SampleBlock, Trial
from sawbench.storage.codec import (
    MESSAGE_TYPES,
    PROFILE,
    decode_block,
    decode_event,
    epoch_ns,
    trial_from_metadata,
)
from sawbench.storage.container import Damage, Scan, read_records


@dataclass(kw_only=True, slots=True)
class Content:
    """What a file holds besides its samples; filled while `iter_messages` runs.

    Attributes
    ----------
    path : Path
    profile, library : str
        From the header: "sawbench" marks our recordings; the library is what wrote the file.
    trial_pairs, config_toml, provenance, finish
        The metadata records.
    schemas, channels : dict
        As announced in the file, by id.
    topics : dict of int to (str, str)
        Topic and message type by channel id; ours are known even where the announcement was lost.
    n_messages : dict of int to int
        Messages read, by channel id.
    scan : Scan
    problems : list of str
        Settings or messages that could not be understood.
    """

    path: Path
    profile: str = ""
    library: str = ""
    trial_pairs: dict[str, str] = field(default_factory=dict)
    config_toml: str | None = None
    provenance: dict[str, str] = field(default_factory=dict)
    finish: dict[str, str] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    topics: dict[int, tuple[str, str]] = field(default_factory=dict)
    n_messages: dict[int, int] = field(default_factory=dict)
    scan: Scan = field(default_factory=Scan)
    problems: list[str] = field(default_factory=list)

    @property
    def is_sawbench(self) -> bool:
        """Whether sawbench wrote the file."""
        is_marked = self.profile == PROFILE or "format_version" in self.trial_pairs
        return is_marked or any(message_type in MESSAGE_TYPES for _, message_type in self.topics.values())

    @property
    def is_complete(self) -> bool:
        """Whether the trial was finished in order and every byte is there."""
        return self.finish.get("is_complete") == "true" and self.scan.is_finished and not self.scan.damages

    @property
    def origin_ns(self) -> int:
        """UTC of the recording's zero, ns since 1970 (0 where unknown)."""
        try:
            return epoch_ns(trial_from_metadata(self.trial_pairs).started_at)
        except (InputError, KeyError, ValueError):
            return 0

    def trial(self) -> Trial:
        """Return the settings of the trial; what is damaged is left out and noted in `problems`.

        Raises
        ------
        RecordingError
            If a newer sawbench wrote the file.
        """
        try:
            return trial_from_metadata(self.trial_pairs)
        except InputError as error:
            raise RecordingError(error.what, where=self.path, remedy=error.remedy) from error
        except (KeyError, ValueError):
            self.problems.append("the settings of the trial are lost; its name is taken from the file")
            name = self.path.name.removesuffix(".part").removesuffix(".mcap")
            return Trial(trial_id=name, source="damaged recording")


def iter_messages(content: Content) -> Iterator[tuple[str, Message]]:
    """Yield message type and message, in the order of the file.

    Parameters
    ----------
    content : Content
        With its `path`; receives the rest.

    Raises
    ------
    RecordingError
        If the file is not an MCAP file.
    """
    for record in read_records(content.path, content.scan):
        take_record(content, record)
        if isinstance(record, Message):
            yield content.topics.get(record.channel_id, ("", ""))[1], record


def take_record(content: Content, record: McapRecord) -> None:
    """Keep in `content` what a record says about the file."""
    if isinstance(record, Message):
        content.n_messages[record.channel_id] = content.n_messages.get(record.channel_id, 0) + 1
    elif isinstance(record, Channel):
        schema = content.schemas.get(record.schema_id)
        content.channels[record.id] = record
        content.topics[record.id] = (record.topic, schema.name if schema else "")
    elif isinstance(record, Schema):
        content.schemas[record.id] = record
    elif isinstance(record, Metadata):
        _take_metadata(content, record)
    elif isinstance(record, Header):
        content.profile, content.library = record.profile, record.library


def _take_metadata(content: Content, record: Metadata) -> None:
    pairs = record.metadata
    if record.name == "trial":
        content.trial_pairs = pairs
    elif record.name == "config":
        content.config_toml = pairs.get("toml")
    elif record.name == "provenance":
        content.provenance |= pairs
    elif record.name == "finish":
        content.finish = pairs
    elif record.name == "topic" and pairs.get("id", "").isdigit():
        content.topics.setdefault(int(pairs["id"]), (pairs.get("topic", ""), pairs.get("type", "")))


def iter_samples(content: Content) -> Iterator[SampleBlock | Event]:
    """Yield the blocks and events of a sawbench recording, in the order of the file.

    Raises
    ------
    RecordingError
        If the file is not an MCAP file.
    """
    for message_type, message in iter_messages(content):
        try:
            if message_type == "sawbench.SampleBlock":
                yield decode_block(message.data)
            elif message_type == "sawbench.Event":
                yield decode_event(message.data)
        except (DecodeError, InputError, ValueError) as error:
            content.problems.append(f"a {message_type} at {message.log_time} ns cannot be read: {error}")


def require_sawbench(content: Content) -> None:
    """Refuse a file that was read and turned out to be somebody else's.

    Raises
    ------
    RecordingError
        That names the topics the file has.
    """
    if content.is_sawbench:
        return
    topics = ", ".join(sorted(topic for topic, _ in content.topics.values()))
    raise RecordingError(
        "is an MCAP file but not a sawbench recording; "
        + (f"its topics are {topics}" if topics else "it has no topics"),
        where=content.path,
        remedy="`sawbench info` shows its content; record with sawbench or import a table",
    )


def damage_events(content: Content, last_s: float) -> list[Event]:
    """Say as events what of the file was lost.

    Parameters
    ----------
    content : Content
        After all messages were read.
    last_s : float
        Time of the last sample, s on the recording's clock.
    """
    origin_ns = content.origin_ns
    events = [_damage_event(damage, origin_ns, last_s) for damage in content.scan.damages]
    events += [Event(kind="warning", time_s=last_s, text=problem) for problem in content.problems]
    return events


def _damage_event(damage: Damage, origin_ns: int, last_s: float) -> Event:
    kind = "interrupted" if damage.is_tail else "gap" if damage.is_chunk else "warning"
    text = damage.what + (f"; {damage.n_messages} messages lost" if damage.n_messages else "")
    if damage.start_ns is None or damage.end_ns is None:
        return Event(kind=kind, time_s=last_s, text=text)
    start_s, end_s = ((ns - origin_ns) * 1e-9 for ns in (damage.start_ns, damage.end_ns))
    return Event(kind=kind, time_s=start_s, end_s=end_s, text=text)
