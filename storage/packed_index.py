"""The index of the chunks of a file that is being written, kept as the bytes that it becomes."""

from __future__ import annotations

from collections.abc import Iterator

from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex
from mcap.writer import Writer

# The library gives no way to hand it a list of one's own.
_ATTRIBUTE = "_Writer__chunk_indices"


class _Written:
    """Records that are bytes already."""

    def __init__(self, content: bytearray) -> None:
        self._content = content

    def write(self, stream: RecordBuilder) -> None:
        stream.write(self._content)


class PackedChunkIndex:
    """What the library's writer needs of a list of its chunk indexes, in a tenth of the memory.

    A recording has two chunks a second. As the library keeps them, the index of an hour takes over 10 MB.
    """

    def __init__(self) -> None:
        self.content = bytearray()

    def append(self, index: ChunkIndex) -> None:
        """Take the index of a chunk that was written."""
        builder = RecordBuilder()
        index.write(builder)
        self.content += builder.end()

    def __iter__(self) -> Iterator[_Written]:
        """Give all of them as one."""
        yield _Written(self.content)


def pack_index(writer: Writer) -> None:
    """Let `writer`, which has written nothing yet, keep its index packed."""
    if hasattr(writer, _ATTRIBUTE):
        setattr(writer, _ATTRIBUTE, PackedChunkIndex())
