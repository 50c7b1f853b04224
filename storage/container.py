"""The MCAP container, read so that damage costs what is damaged and nothing else.

The readers of the mcap library stop at the first broken byte. This scan checks every chunk on its own and
looks for the next chunk behind a place where the framing itself is broken.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Final

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    Schema,
    Statistics,
)
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream
from sawbench.bench.errors import RecordingError

MAGIC: Final = b"\x89MCAP0\r\n"
_FRAME: Final = struct.Struct("<BQ")
_CHUNK_HEAD: Final = struct.Struct("<QQQI")
_MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
_RECORDS: Final = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.METADATA: Metadata,
    Opcode.ATTACHMENT: Attachment,
    Opcode.DATA_END: DataEnd,
    Opcode.STATISTICS: Statistics,
    Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.MESSAGE: Message,
}
_NOT_READ: Final = {
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
    Opcode.SUMMARY_OFFSET,
}
_FIRST_PRIVATE_OPCODE: Final = 0x80
_FOOTER_LENGTH: Final = 20
_LET_GO_BYTES: Final = 16 << 20
# Chunks that claim to unpack to more than this, on top of a ratio that no signal reaches, are not unpacked.
_UNPACKED_ALLOWANCE: Final = 8 << 20
_LARGEST_RATIO: Final = 100
# The compression of a chunk sits at a fixed place in it; "zstd" is what sawbench writes.
_CHUNK_MARK: Final = struct.pack("<I4s", 4, b"zstd")
BROKEN: Final = (
    McapError,
    CRCValidationError,
    struct.error,
    UnicodeDecodeError,
    zstandard.ZstdError,
    MemoryError,
    OverflowError,
    RuntimeError,
)


@dataclass(kw_only=True, slots=True)
class Damage:
    """One place where bytes of a file were lost.

    Attributes
    ----------
    offset, n_bytes : int
        Where in the file, and how much of it.
    what : str
    start_ns, end_ns : int or None
        Log times the lost messages lay between, where the chunk still says so.
    n_messages : int or None
        Messages lost, where the index behind the chunk still says so.
    is_tail : bool
        The file ends here without the end record it should have.
    is_chunk : bool
        Whether messages were (or may have been) lost.
    """

    offset: int
    n_bytes: int
    what: str
    start_ns: int | None = None
    end_ns: int | None = None
    n_messages: int | None = None
    is_tail: bool = False
    is_chunk: bool = True


@dataclass(kw_only=True, slots=True)
class Scan:
    """What a pass over a file found besides its records; filled while the records are read.

    Attributes
    ----------
    damages : list of Damage
    is_finished : bool
        Whether the file has its end record.
    n_chunks : int
        Chunks that were read whole.
    n_unpacked : int
        Bytes that they held.
    earliest_ns, latest_ns : int or None
        Log times that they state.
    """

    damages: list[Damage] = field(default_factory=list)
    is_finished: bool = False
    n_chunks: int = 0
    n_unpacked: int = 0
    earliest_ns: int | None = None
    latest_ns: int | None = None

    def take_times_of(self, chunk: Chunk) -> None:
        """Note when the messages of a whole chunk are from."""
        if chunk.message_end_time:  # 0 where it holds none
            start_ns, end_ns = chunk.message_start_time, chunk.message_end_time
            self.earliest_ns = start_ns if self.earliest_ns is None else min(self.earliest_ns, start_ns)
            self.latest_ns = end_ns if self.latest_ns is None else max(self.latest_ns, end_ns)

    def forget_impossible_times(self) -> None:
        """Drop times of damages further from the whole chunks than these are long: that header is damaged too."""
        if self.earliest_ns is None or self.latest_ns is None:
            return
        length_ns = self.latest_ns - self.earliest_ns
        for damage in self.damages:
            if damage.start_ns is not None and damage.end_ns is not None:
                before_ns, after_ns = self.earliest_ns - damage.start_ns, damage.end_ns - self.latest_ns
                if max(before_ns, after_ns) > length_ns:
                    damage.start_ns = damage.end_ns = None


def read_records(path: Path, scan: Scan) -> Iterator[McapRecord]:
    """Yield every readable record of an MCAP file, chunks already taken apart.

    Parameters
    ----------
    path : Path
    scan : Scan
        Receives the damages.

    Yields
    ------
    Header, Schema, Channel, Message, Metadata, Attachment or Statistics

    Raises
    ------
    RecordingError
        If the file cannot be opened or is not an MCAP file.
    """
    try:
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise RecordingError(
                    "is not a recording: it is not an MCAP file",
                    where=path,
                    remedy="import tables and logs with `sawbench import`",
                )
            with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
                yield from _scan_records(content, scan)
    except FileNotFoundError:
        raise RecordingError("no such file", where=path, remedy="check the path") from None
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror or error}", where=path) from error


def _scan_records(content: mmap.mmap, scan: Scan) -> Iterator[McapRecord]:
    offset, size = len(MAGIC), len(content)
    is_in_summary, let_go = False, 0
    broken_chunk: Damage | None = None
    while offset < size and content[offset : offset + len(MAGIC)] != MAGIC:
        let_go = _let_go(content, let_go, offset)
        frame = _frame_at(content, offset)
        if frame is None:
            offset = _skip_to_next_chunk(content, offset, offset, scan)
            continue
        opcode, start, end = frame
        if opcode == Opcode.FOOTER:
            scan.is_finished = True
        if opcode not in _RECORDS:  # a later version's records are skipped, as the format demands
            offset = end
            continue
        stream = ReadDataStream(BytesIO(content[start:end]))
        try:
            record = _parse(opcode, stream, end - start)
            records = _unpack(record, end, scan) if isinstance(record, Chunk) else [record]
        except BROKEN as error:
            broken_chunk = _broken_record(content, opcode, start, end, error)
            scan.damages.append(broken_chunk)
            is_framed = stream.count == end - start
            offset = end if is_framed else _skip_to_next_chunk(content, offset, start, scan)
            continue
        if isinstance(record, Chunk):
            broken_chunk = None
            offset = start + stream.count  # where a damaged length disagrees, the checksum confirms this
        elif stream.count == end - start:
            offset = end
        else:
            offset = _skip_to_next_chunk(content, offset, start, scan)
            continue
        if isinstance(record, MessageIndex):
            _count_lost(broken_chunk, record)
        elif isinstance(record, DataEnd):
            is_in_summary = True
            _check_data_section(content, start - _FRAME.size, record, scan)
        elif not is_in_summary or isinstance(record, Statistics):
            yield from records
    _check_end(scan, offset, size)


def _let_go(content: mmap.mmap, done: int, offset: int) -> int:
    """Hand the pages behind `offset` back to the system: those of a long file would count as memory in use."""
    if offset - done < _LET_GO_BYTES or not hasattr(content, "madvise"):
        return done
    upto = offset - offset % mmap.PAGESIZE
    content.madvise(mmap.MADV_DONTNEED, done, upto - done)
    return upto


def _unpack(chunk: Chunk, n_read: int, scan: Scan) -> list[McapRecord]:
    """Records of a chunk, unless it claims more bytes than the file can honestly hold up to here.

    Raises
    ------
    McapError
        If it does.
    """
    claimed = chunk.uncompressed_size
    if chunk.compression == "zstd":
        claimed = max(claimed, zstandard.frame_content_size(chunk.data))
    if scan.n_unpacked + claimed > _UNPACKED_ALLOWANCE + _LARGEST_RATIO * n_read:
        raise McapError(f"claims to unpack to {claimed} bytes")
    records = _taken_apart(chunk)
    scan.take_times_of(chunk)
    scan.n_chunks += 1
    scan.n_unpacked += chunk.uncompressed_size
    if not chunk.uncompressed_crc:
        what = f"a chunk of {len(chunk.data)} bytes has no checksum: its samples are not verified"
        scan.damages.append(Damage(offset=n_read, n_bytes=0, what=what, is_chunk=False))
    return records


def _taken_apart(chunk: Chunk) -> list[McapRecord]:
    """Records of a chunk, its checksum compared; messages in one step each, for there are thousands."""
    stream, n_bytes = get_chunk_data_stream(chunk, validate_crc=True)
    content = stream.read(n_bytes)
    records: list[McapRecord] = []
    end = 0
    while end < n_bytes:
        opcode, length = _FRAME.unpack_from(content, end)
        start = end + _FRAME.size
        end = start + length
        if end > n_bytes:
            raise EndOfFile
        if opcode == Opcode.MESSAGE:
            channel_id, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(content, start)
            data = content[start + _MESSAGE_HEAD.size : end]
            records.append(Message(channel_id, log_time, data, publish_time, sequence))
        elif opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
            records.append(_parse(opcode, ReadDataStream(BytesIO(content[start:end])), length))
    return records


def _parse(opcode: int, stream: ReadDataStream, length: int) -> McapRecord:
    if opcode == Opcode.MESSAGE:
        return Message.read(stream, length)
    return _RECORDS[Opcode(opcode)].read(stream)


def _frame_at(content: mmap.mmap, offset: int) -> tuple[int, int, int] | None:
    """Return opcode, start and end of the record at `offset`, None where there cannot be one."""
    if offset + _FRAME.size > len(content):
        return None
    opcode, length = _FRAME.unpack_from(content, offset)
    start = offset + _FRAME.size
    if start + length > len(content):
        return None
    # A chunk is known by its content, so that a damaged opcode does not hide it.
    if content[start + _CHUNK_HEAD.size : start + _CHUNK_HEAD.size + len(_CHUNK_MARK)] == _CHUNK_MARK:
        return int(Opcode.CHUNK), start, start + length
    known = opcode in _RECORDS or opcode in _NOT_READ or (opcode == Opcode.FOOTER and length == _FOOTER_LENGTH)
    return (opcode, start, start + length) if known or opcode >= _FIRST_PRIVATE_OPCODE else None


def _skip_to_next_chunk(content: mmap.mmap, offset: int, search_from: int, scan: Scan) -> int:
    """Note that the framing is lost at `offset` and return where the next whole chunk begins."""
    to_mark = _FRAME.size + _CHUNK_HEAD.size
    position = search_from + to_mark
    while (position := content.find(_CHUNK_MARK, position + 1)) >= 0:
        candidate = position - to_mark
        if content[candidate] == Opcode.CHUNK and _frame_at(content, candidate) is not None:
            what = f"{candidate - offset} bytes before a chunk are damaged"
            scan.damages.append(Damage(offset=offset, n_bytes=candidate - offset, what=what))
            return candidate
    what = f"the file is cut off or damaged from byte {offset} on"
    damage = Damage(offset=offset, n_bytes=len(content) - offset, what=what, is_tail=True)
    _add_chunk_times(damage, content, offset)
    scan.damages.append(damage)
    return len(content)


def _add_chunk_times(damage: Damage, content: mmap.mmap, offset: int) -> None:
    head = offset + _FRAME.size
    if content[offset] == Opcode.CHUNK and head + _CHUNK_HEAD.size <= len(content):
        start_ns, end_ns, _, _ = _CHUNK_HEAD.unpack_from(content, head)
        if start_ns <= end_ns < 2**63:
            damage.start_ns, damage.end_ns = start_ns, end_ns


def _broken_record(content: mmap.mmap, opcode: int, start: int, end: int, error: BaseException) -> Damage:
    is_chunk = opcode == Opcode.CHUNK
    reason = "checksum does not match" if isinstance(error, CRCValidationError) else "content is damaged"
    name = "chunk" if is_chunk else Opcode(opcode).name.lower() + " record"
    damage = Damage(
        offset=start,
        n_bytes=end - start,
        what=f"{name} of {end - start} bytes: {reason}",
        is_chunk=is_chunk,
    )
    if is_chunk:
        _add_chunk_times(damage, content, start - _FRAME.size)
    return damage


def _count_lost(broken_chunk: Damage | None, index: MessageIndex) -> None:
    """Add the messages that the index behind a broken chunk lists."""
    if broken_chunk is not None and broken_chunk.is_chunk:
        broken_chunk.n_messages = (broken_chunk.n_messages or 0) + len(index.records)


def _check_data_section(content: mmap.mmap, end: int, data_end: DataEnd, scan: Scan) -> None:
    if not data_end.data_section_crc or scan.damages:
        return
    checksum, let_go = 0, 0
    for start in range(0, end, _LET_GO_BYTES):
        checksum = zlib.crc32(content[start : min(start + _LET_GO_BYTES, end)], checksum)
        let_go = _let_go(content, let_go, start)
    if checksum != data_end.data_section_crc:
        what = (
            "the file does not match its checksum although each chunk matches its own: settings or index are"
            " damaged, or "
            "chunks were exchanged; the samples are not verified"
        )
        scan.damages.append(Damage(offset=0, n_bytes=0, what=what, is_chunk=False))


def _check_end(scan: Scan, offset: int, size: int) -> None:
    scan.forget_impossible_times()
    n_behind = size - offset - len(MAGIC)
    if scan.is_finished and n_behind > 0:
        what = f"{n_behind} bytes after the end of the recording are not read: another file was appended"
        scan.damages.append(Damage(offset=offset, n_bytes=n_behind, what=what, is_chunk=False))
    elif not scan.is_finished and n_behind >= 0:
        what = (
            f"another file begins at byte {offset}: the {size - offset} bytes from there on are not read, and what is "
            "before it has no checksum as a whole: the samples are not verified"
        )
        scan.damages.append(Damage(offset=offset, n_bytes=size - offset, what=what, is_tail=True))
    elif not scan.is_finished and not any(damage.is_tail for damage in scan.damages):
        what = "the end record is missing: the program that wrote it was stopped"
        scan.damages.append(Damage(offset=size, n_bytes=0, what=what, is_tail=True))
