"""How files are written: a recording to a `.part` file, with a copy if asked; all others whole or not at all."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, overload

from sawbench.bench.errors import InputError, RecordingError
from sawbench.storage.places import Place, StoreFile, write_to_store

# No mistake of whoever gave the name.
_FULL = (errno.ENOSPC, errno.EDQUOT)


@overload
def write_whole(
    path: str | Path, content: str | bytes, *, overwrite: bool = False, makes_folder: bool = False
) -> Path: ...
@overload
def write_whole(
    path: str | Place, content: str | bytes, *, overwrite: bool = False, makes_folder: bool = False
) -> Place: ...
def write_whole(
    path: str | Place, content: str | bytes, *, overwrite: bool = False, makes_folder: bool = False
) -> Place:
    """Write a file whole or not at all.

    What cannot be replaced, such as `/dev/stdout`, is written to directly; a link stays, and its target is replaced.

    Parameters
    ----------
    path : str, Path or StoreFile
    content : str or bytes
        Text is written in UTF-8, its line ends as they are.
    overwrite : bool
    makes_folder : bool
        Make its folder where it is missing.

    Returns
    -------
    Path or StoreFile

    Raises
    ------
    InputError
        If the file exists and `overwrite` is not set, or cannot be written there.
    OSError
        If the disk is full.
    """
    # A name of a file that is not UTF-8 may stand in a text.
    data = content.encode(errors="backslashreplace") if isinstance(content, str) else content
    if isinstance(path, StoreFile):
        return write_to_store(path, data, overwrite=overwrite)
    with whole_file(Path(path), overwrite=overwrite, makes_folder=makes_folder) as stream:
        stream.write(data)
    return Path(path)


@contextmanager
def whole_file(path: Path, *, overwrite: bool = False, makes_folder: bool = False) -> Iterator[BinaryIO]:
    """Open a file of this machine for writing, which is there once the block has ended without an error.

    Parameters and errors are those of `write_whole`.

    Yields
    ------
    file object
        Also to be read, except where the file cannot be replaced.
    """
    if path.exists() and not overwrite:
        raise InputError("already exists", where=path, remedy="give another file name, or overwrite with --force")
    try:
        if makes_folder:
            path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and not path.is_file():
            with path.open("wb") as stream:
                yield stream
        else:
            with _replacing(path.resolve()) as stream:
                yield stream
    except OSError as error:
        if error.errno in _FULL:
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise InputError(f"cannot be written: {error.strerror or error}", where=path) from error


@contextmanager
def _replacing(target: Path) -> Iterator[BinaryIO]:
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    os.close(handle)
    beside = Path(name)
    try:
        with beside.open("w+b") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        beside.chmod(target.stat().st_mode & 0o777 if target.exists() else 0o644)
        beside.replace(target)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise


@contextmanager
def folder_held(path: Path) -> Iterator[None]:
    """Keep out others that do this for a file of the same folder, while one is read, changed and replaced.

    Waits for them; the lock ends with this process, however that ends. On systems without `fcntl` it does nothing.

    Parameters
    ----------
    path : Path
        The file; it is replaced, so the lock is on its folder.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    try:
        folder = os.open(path.parent, os.O_RDONLY)
    except OSError:
        # Where there is no folder to open, writing says so.
        yield
        return
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        yield
    finally:
        os.close(folder)


class PartFile:
    """A file that has its final name only once it is whole.

    Parameters
    ----------
    path : Path
        Final name; `<path>.part` is written until `finish`.
    overwrite : bool
        Whether `finish` may replace an existing file.

    Raises
    ------
    RecordingError
        If the file exists and `overwrite` is False, or if a `.part` file exists: that one belongs to a
        recording that is running or was interrupted and is never touched.
    """

    def __init__(self, path: Path, *, overwrite: bool) -> None:
        self.path = path
        self.part_path = path.with_name(path.name + ".part")
        self._overwrite = overwrite
        self._refuse_existing()
        try:
            # Where the folder is a file, opening says so.
            with suppress(FileExistsError):
                path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self.part_path.open("xb")
        except FileExistsError:
            raise RecordingError(
                "already exists: a recording is running, or was interrupted",
                where=self.part_path,
                remedy="recover it with `sawbench recover`, then move it to another folder, or give another name",
            ) from None
        except OSError as error:
            raise RecordingError(
                f"cannot be written: {error.strerror or error}",
                where=self.part_path,
                remedy="check that the folder exists and is writable",
            ) from error

    def _refuse_existing(self) -> None:
        if self.path.exists() and not self._overwrite:
            raise RecordingError(
                "already exists and is not overwritten",
                where=self.path,
                remedy="give another file name, or replace it with --force",
            )

    def write(self, content: bytes) -> int:
        """Append `content`; return its length."""
        return self._stream.write(content)

    def tell(self) -> int:
        """Return the bytes written so far."""
        return self._stream.tell()

    def flush(self) -> None:
        """Hand everything to the operating system: from here on the death of this program loses nothing."""
        self._stream.flush()

    def sync(self) -> None:
        """Wait until what was flushed is on the disk: from here on a power cut loses nothing."""
        os.fsync(self._stream.fileno())

    def finish(self) -> Path:
        """Close the file and give it its final name.

        Raises
        ------
        RecordingError
            If a file of that name appeared meanwhile; the `.part` file is whole and stays.
        """
        self._stream.flush()
        self.sync()
        self._stream.close()
        self._refuse_existing()
        self.part_path.replace(self.path)
        return self.path

    def abandon(self) -> None:
        """Close the file and leave what was written under its `.part` name."""
        self._stream.close()

    def discard(self) -> None:
        """Close and delete what was written."""
        # On a full disk closing fails too: what is not written yet is not wanted any more.
        with suppress(OSError):
            self._stream.close()
        self.part_path.unlink(missing_ok=True)


class Output:
    """The stream the MCAP writer writes to: one file, or one file and its copy.

    The copy never harms the recording: when writing it fails, it is given up and `copy_problem` says why.

    Parameters
    ----------
    path : Path
    second_copy : Path, optional
        Folder for the copy; made if missing.
    overwrite : bool

    Raises
    ------
    RecordingError
        As `PartFile`, for either file; or if the copy is to be in the folder of the recording.
    """

    def __init__(self, path: Path, *, second_copy: Path | None, overwrite: bool) -> None:
        self.copy_problem: str | None = None
        self._first = PartFile(path, overwrite=overwrite)
        self._second: PartFile | None = None
        if second_copy is not None:
            if second_copy.resolve() == path.parent.resolve():
                self._first.discard()
                raise RecordingError(
                    "is the folder of the recording too: a second copy there would be the same file",
                    where=second_copy,
                    remedy="name a folder on another disk as `second_copy`",
                )
            try:
                self._second = PartFile(second_copy / path.name, overwrite=overwrite)
            except RecordingError:
                self._first.discard()
                raise

    def write(self, content: bytes) -> int:
        """Append to both files."""
        with self._then_copy("write", content):
            return self._first.write(content)

    def tell(self) -> int:
        """Return the bytes written so far."""
        return self._first.tell()

    def flush(self) -> None:
        """Flush both files."""
        with self._then_copy("flush"):
            self._first.flush()

    def sync(self) -> None:
        """Wait until both files are on their disks."""
        with self._then_copy("sync"):
            self._first.sync()

    def finish(self) -> Path:
        """Give both files their final names; return that of the first."""
        with self._then_copy("finish"):
            return self._first.finish()

    def abandon(self) -> None:
        """Close both files under their `.part` names."""
        with self._then_copy("abandon"):
            self._first.abandon()

    @contextmanager
    def _then_copy(self, action: str, *arguments: bytes) -> Iterator[None]:
        """Do the same with the copy afterwards, also where the first file fails: the copy is for that."""
        try:
            yield
        finally:
            # Another thread may give it up meanwhile, and has said why then.
            second = self._second
            if second is not None:
                try:
                    getattr(second, action)(*arguments)
                except (OSError, ValueError, RecordingError) as error:
                    self._second = None
                    self.copy_problem = (
                        self.copy_problem or f"the second copy {second.part_path} was abandoned: {error}"
                    )
                    with suppress(OSError):
                        second.abandon()
