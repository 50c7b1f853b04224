"""Files here and in object stores: what `s3://bucket/name` and a path on the disk have in common.

A file in a store is copied to this machine for as long as it is read, and written whole, as stores do. Everything
else works on the disk. Only this module knows fsspec.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Final

from sawbench.bench.errors import InputError, RecordingError, SawbenchError

# Corrections of a recording lie beside it, under its name with this ending (`storage/amendments.py`).
AMENDMENTS: Final = ".amendments.jsonl"
# A batch whose results are files keeps a journal in their folder (`archive/journal.py`).
JOURNAL: Final = "batch.jsonl"
_MARK: Final = "://"
# What stores say of a version of a file, the most telling first.
_STAMPS: Final = ("ETag", "etag", "md5Hash", "mtime", "LastModified", "created")
# Whose errors say that a store refuses or cannot be reached.
_OF_STORES: Final = ("botocore", "aiohttp", "aiobotocore")


@dataclass(frozen=True, order=True, slots=True)
class StoreFile:
    """A file or folder of an object store, as a URL such as `s3://lab/recordings/oak-01.mcap`."""

    url: str

    def __str__(self) -> str:
        return self.url

    def __truediv__(self, name: str) -> StoreFile:
        return StoreFile(f"{self.url.rstrip('/')}/{name}")

    @property
    def name(self) -> str:
        """Last part of the URL."""
        return PurePosixPath(self.url).name

    @property
    def stem(self) -> str:
        """Name without its suffix."""
        return PurePosixPath(self.url).stem


Place = Path | StoreFile


@dataclass(frozen=True, kw_only=True, slots=True)
class FoundFile:
    """A file, and what tells that it is still the same without reading it.

    Attributes
    ----------
    place : Place
    size_bytes : int
    stamp : str
        Time of the last change, or the store's own checksum.
    is_amended : bool
        Of a recording: settings of it are corrected in a file beside it.
    """

    place: Place
    size_bytes: int
    stamp: str
    is_amended: bool = False

    def absolute(self) -> FoundFile:
        """Return the file under a name that holds in every folder and, on a shared disk, on every machine."""
        return replace(self, place=self.place.absolute()) if isinstance(self.place, Path) else self


def place_of(text: str | Place) -> Place:
    """Return a path for a path and a `StoreFile` for a URL.

    Examples
    --------
    >>> place_of("s3://lab/oak.mcap").name, place_of("recordings/oak.mcap").name
    ('oak.mcap', 'oak.mcap')
    """
    text = str(text)
    if text.startswith("file://"):
        return Path(text.removeprefix("file://"))
    return StoreFile(text) if _MARK in text else Path(text)


def with_suffix(place: Place, suffix: str) -> Place:
    """Return the same name with another suffix."""
    if isinstance(place, Path):
        return place.with_suffix(suffix)
    return StoreFile(f"{place.url.removesuffix(place.name)}{PurePosixPath(place.name).with_suffix(suffix)}")


def list_files(folder: Place, pattern: str = "*") -> list[FoundFile]:
    """List the files of a folder whose names match, in the order of their names; none if there is no such folder.

    Parameters
    ----------
    folder : Place
    pattern : str
        `**/` goes into folders.

    Raises
    ------
    InputError
        If the store cannot be reached or refuses.
    """
    if isinstance(folder, Path):
        return [_on_disk(path) for path in sorted(folder.glob(pattern)) if path.is_file()]
    with _store(folder) as (store, path):
        found = store.glob(f"{path.rstrip('/')}/{pattern}", detail=True)
        return [
            _in_store(StoreFile(store.unstrip_protocol(name)), about)
            for name, about in sorted(found.items())
            if about["type"] == "file"
        ]


def find_file(place: Place) -> FoundFile | None:
    """Return the file at a place, None where there is none."""
    if isinstance(place, Path):
        return _on_disk(place) if place.exists() and not place.is_dir() else None
    with _store(place) as (store, path):
        try:
            about = store.info(path)
        except FileNotFoundError:
            return None
        return _in_store(place, about) if about["type"] == "file" else None


def list_recordings(folder: Place) -> list[FoundFile]:
    """List the finished recordings of a folder; the stamp of one that was amended tells of its amendments too."""
    amended = {str(file.place): file for file in list_files(folder, f"*.mcap{AMENDMENTS}")}
    return [_with(file, amended.get(f"{file.place}{AMENDMENTS}")) for file in list_files(folder, "*.mcap")]


def find_recording(place: Place) -> FoundFile | None:
    """Return the recording at a place, None where there is no file; see `list_recordings`."""
    file = find_file(place)
    return None if file is None else _with(file, find_file(place_of(f"{place}{AMENDMENTS}")))


def _with(file: FoundFile, amendments: FoundFile | None) -> FoundFile:
    if amendments is None:
        return file
    return replace(file, stamp=f"{file.stamp}+{amendments.stamp}", is_amended=True)


def _on_disk(path: Path) -> FoundFile:
    about = path.stat()
    return FoundFile(place=path, size_bytes=about.st_size, stamp=str(about.st_mtime_ns))


def _in_store(place: StoreFile, about: dict[str, Any]) -> FoundFile:
    stamp = next((about[key] for key in _STAMPS if key in about), "")
    return FoundFile(place=place, size_bytes=int(about["size"]), stamp=str(stamp).strip('"'))


@contextmanager
def on_disk(place: Place) -> Iterator[Path]:
    """Give a path under which the file can be read; a copy of a file in a store lasts as long as the block.

    Errors of the block name the place, not the copy.

    Raises
    ------
    RecordingError
        If the file is not there.
    """
    if isinstance(place, Path):
        yield place
        return
    with tempfile.TemporaryDirectory(prefix="sawbench-") as folder:
        copy = Path(folder) / place.name
        with _store(place) as (store, path):
            try:
                store.get_file(path, str(copy))
            except FileNotFoundError:
                raise RecordingError("no such file", where=place, remedy="check the URL") from None
            with suppress(FileNotFoundError):
                store.get_file(path + AMENDMENTS, f"{copy}{AMENDMENTS}")
        try:
            yield copy
        except SawbenchError as error:
            if error.where is not None:
                error.where = error.where.replace(str(copy), place.url)
            error.what = error.what.replace(str(copy), place.url)
            raise


def read_bytes(place: Place) -> bytes:
    """Return the content of a file.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    if isinstance(place, Path):
        return place.read_bytes()
    with _store(place) as (store, path):
        return store.cat_file(path)


def write_to_store(place: StoreFile, content: bytes, *, overwrite: bool) -> StoreFile:
    """Write a file of a store whole; see `output.write_whole`."""
    with _store(place) as (store, path):
        if not overwrite and store.exists(path):
            raise InputError("already exists", where=place, remedy="give another file name, or overwrite with --force")
        try:
            store.pipe_file(path, content)
        except FileNotFoundError:  # some stores have folders, and all have buckets, that must be there first
            store.makedirs(path.rpartition("/")[0], exist_ok=True)
            store.pipe_file(path, content)
    return place


def remove(place: Place) -> None:
    """Delete a file; one that is gone already is no error."""
    if isinstance(place, Path):
        place.unlink(missing_ok=True)
        return
    with _store(place) as (store, path):
        if store.exists(path):
            store.rm_file(path)


@contextmanager
def _store(place: StoreFile) -> Iterator[tuple[Any, str]]:
    """Give the file system of a store and the path in it; what it refuses is said in words."""
    import fsspec

    kind = place.url.partition(_MARK)[0]
    try:
        store, path = fsspec.core.url_to_fs(place.url, use_listings_cache=False)
    except ImportError as error:
        raise InputError(
            f"{kind}:// needs a package that is not installed: {error}",
            where=place,
            remedy="pip install 'sawbench[cluster]' for s3, or the fsspec package of this store",
        ) from error
    except ValueError as error:
        raise InputError(f"has an unknown format of store: {error}", where=place, remedy="use s3://...") from error
    try:
        yield store, path
    except FileNotFoundError:
        raise RecordingError("no such file or bucket", where=place, remedy="check the URL") from None
    except SawbenchError:
        raise
    except Exception as error:
        if not isinstance(error, OSError) and type(error).__module__.partition(".")[0] not in _OF_STORES:
            raise
        raise InputError(
            f"the store cannot be used: {type(error).__name__}: {error}",
            where=place,
            remedy="check the address of the store and the access keys (environment, or ~/.aws)",
        ) from error
