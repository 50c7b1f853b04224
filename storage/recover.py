"""Salvages a truncated or damaged recording into a new, orderly file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mcap.records import Attachment, Channel, McapRecord, Message, Metadata
from mcap.writer import LIBRARY_IDENTIFIER, Writer
from sawbench.bench.errors import RecordingError, WritingError
from sawbench.storage.codec import EVENT_TOPIC, MESSAGE_TYPES, PROFILE, encode_event, log_time_ns, schema_data
from sawbench.storage.container import Scan, read_records
from sawbench.storage.content import Content, damage_events, take_record
from sawbench.storage.output import PartFile
from sawbench.storage.writer import software_version

_NS: Final = 1_000_000_000


@dataclass(frozen=True, kw_only=True, slots=True)
class RecoveryReport:
    """What a recovery saved and what is gone.

    Attributes
    ----------
    path : Path
        The new file.
    n_messages_kept : int
    n_messages_lost : int
        As far as the file still says; what the cut-off end held beyond that is not known.
    n_chunks_kept, n_chunks_bad : int
    seconds_lost : float
        Time covered by the damaged chunks that still say so, s.
    is_tail_cut : bool
        The end of the file is missing: up to one flush interval (1 s) more may be lost.
    problems : tuple of str
        Every damage in words.
    """

    path: Path
    n_messages_kept: int
    n_messages_lost: int
    n_chunks_kept: int
    n_chunks_bad: int
    seconds_lost: float
    is_tail_cut: bool
    problems: tuple[str, ...]


def recover_recording(path: str | Path, out: str | Path, overwrite: bool = False) -> RecoveryReport:
    """Copy everything readable of an MCAP file into a new one.

    Parameters
    ----------
    path : str or Path
        Any MCAP file, also a `.part` file; it is not changed.
    out : str or Path
        Another file.
    overwrite : bool

    Raises
    ------
    RecordingError
        If `path` is not an MCAP file or holds nothing readable, or if `out` exists or is `path`.
    WritingError
        If `out` cannot be written, for example because the disk is full; nothing of it is left.
    """
    path, out = Path(path), Path(out)
    if out.resolve() == path.resolve():
        raise RecordingError("a recording cannot be recovered to its own file", where=path, remedy="give another file")
    _refuse_part(path, out)
    content = Content(path=path)
    target = PartFile(out, overwrite=overwrite)
    try:
        copier = _Copier(Writer(target, enable_data_crcs=True), content)  # type: ignore[arg-type]
        for record in read_records(path, content.scan):
            copier.take(record)
        if not content.trial_pairs and not copier.n_messages:
            raise RecordingError("contains nothing that can be recovered", where=path)
        copier.finish()
        target.finish()
    except OSError as error:
        target.discard()
        raise WritingError.of(error, where=out) from error
    except BaseException:
        target.discard()
        raise
    return _report(out, content.scan, copier)


def _refuse_part(path: Path, out: Path) -> None:
    """Refuse where the `.part` file of `out` is there; what to do is another thing than for a recording."""
    part = out.with_name(f"{out.name}.part")
    if not part.exists():
        return
    if part.resolve() == path.resolve():
        raise RecordingError(
            "this name belongs to the file that is recovered, which is never replaced",
            where=out,
            remedy="give --out another name or folder; without --out it is the name with -recovered",
        )
    raise RecordingError(
        "already exists: a recovery or recording of this name runs, or was interrupted",
        where=part,
        remedy=f"if it was an interrupted recovery, delete it: {path.name} still has everything; or give another --out",
    )


def _report(out: Path, scan: Scan, copier: _Copier) -> RecoveryReport:
    lost = [damage for damage in scan.damages if damage.is_chunk]
    spans = [(d.end_ns - d.start_ns) / _NS for d in lost if d.start_ns is not None and d.end_ns is not None]
    return RecoveryReport(
        path=out,
        n_messages_kept=copier.n_messages,
        n_messages_lost=sum(damage.n_messages or 0 for damage in lost) + copier.n_unknown,
        n_chunks_kept=scan.n_chunks,
        n_chunks_bad=sum(damage.n_bytes > 0 for damage in lost),
        seconds_lost=float(sum(spans)),
        is_tail_cut=any(damage.is_tail for damage in scan.damages),
        problems=tuple(damage.what for damage in scan.damages),
    )


class _Copier:
    """Writes what a damaged file holds into another file, under new ids."""

    def __init__(self, writer: Writer, content: Content) -> None:
        self._writer = writer
        self._content = content
        self._is_started = False
        self._schema_ids: dict[str, int] = {}
        self._channel_ids: dict[tuple[str, str, str], int] = {}
        self._last_ns = 0
        self.n_messages = 0
        self.n_unknown = 0

    def take(self, record: McapRecord) -> None:
        """Copy one record."""
        take_record(self._content, record)
        self._start()
        if isinstance(record, Message):
            self._copy_message(record)
        elif isinstance(record, Metadata) and record.name not in ("topic", "finish"):
            self._writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            self._writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )

    def finish(self) -> None:
        """Say in the new file what is missing in it, and finish it."""
        content = self._content
        self._start()
        if content.is_sawbench:
            last_s = (self._last_ns - content.origin_ns) / _NS
            for event in damage_events(content, last_s):
                log_time = log_time_ns(content.origin_ns, event.time_s)
                message = encode_event(event, content.origin_ns)
                self._writer.add_message(self._topic(EVENT_TOPIC, "sawbench.Event"), log_time, message, log_time)
            recovered = {"recovered_from": content.path.name, "recovered_by": software_version()}
            self._writer.add_metadata("provenance", recovered)
            self._writer.add_metadata("finish", {"is_complete": str(content.is_complete).lower()})
        self._writer.finish()

    def _start(self) -> None:
        if not self._is_started:
            has_header = bool(self._content.profile or self._content.library)
            profile = self._content.profile if has_header else PROFILE
            self._writer.start(profile=profile, library=f"{software_version()} {LIBRARY_IDENTIFIER}")
            self._is_started = True

    def _copy_message(self, message: Message) -> None:
        topic, message_type = self._content.topics.get(message.channel_id, ("", ""))
        channel = self._content.channels.get(message.channel_id)
        if channel is None and message_type not in MESSAGE_TYPES:
            self.n_unknown += 1
            return
        channel_id = self._topic(topic, message_type, channel)
        self._writer.add_message(channel_id, message.log_time, message.data, message.publish_time, message.sequence)
        self._last_ns = max(self._last_ns, message.log_time)
        self.n_messages += 1

    def _topic(self, topic: str, message_type: str, channel: Channel | None = None) -> int:
        """Return the id of a topic in the new file; where its announcement was lost, ours is made again."""
        encoding = channel.message_encoding if channel else "protobuf"
        key = (topic, message_type, encoding)
        if key not in self._channel_ids:
            schema_id = self._schema(message_type, channel)
            about = channel.metadata if channel else {}
            self._channel_ids[key] = self._writer.register_channel(topic, encoding, schema_id, about)
            if message_type in MESSAGE_TYPES:
                pairs = {"id": str(self._channel_ids[key]), "topic": topic, "type": message_type}
                self._writer.add_metadata("topic", pairs)
        return self._channel_ids[key]

    def _schema(self, message_type: str, channel: Channel | None) -> int:
        if channel is not None and channel.schema_id == 0:
            return 0
        if message_type not in self._schema_ids:
            schema = self._content.schemas.get(channel.schema_id) if channel else None
            encoding = schema.encoding if schema else "protobuf"
            content = schema.data if schema else schema_data(message_type)
            self._schema_ids[message_type] = self._writer.register_schema(message_type, encoding, content)
        return self._schema_ids[message_type]
