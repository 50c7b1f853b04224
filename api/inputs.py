"""Which recordings and which configuration are meant."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar, overload

from sawbench.bench.errors import InputError
from sawbench.storage.places import AMENDMENTS, JOURNAL, FoundFile, Place, find_recording, list_recordings

if TYPE_CHECKING:
    from sawbench.bench.config import LoadedConfig
    from sawbench.bench.recording import Recording

P = TypeVar("P", bound=Place)
DEFAULT_CONFIG: Final = Path("bench_config.toml")
_LOG: Final = logging.getLogger("sawbench")


def shipped_config() -> Path:
    """Configuration that is installed with sawbench."""
    import sawbench.bench

    return Path(sawbench.bench.__path__[0]) / "default_config.toml"


@overload
def find_recordings(paths: Iterable[Path]) -> list[Path]: ...  # pyright: ignore[reportOverlappingOverload]
@overload
def find_recordings(paths: Iterable[Place]) -> list[Place]: ...
def find_recordings(paths: Iterable[Place]) -> Sequence[Place]:
    """Expand directories to the finished recordings in them, in the order of their names; see `find_files`."""
    return [file.place for file in find_files(paths)]


def without_own_files(paths: Sequence[P]) -> Sequence[P]:
    """Leave out what sawbench writes beside recordings, which `recordings/*` names too: journals and amendments.

    Where nothing else is named, they stay: what is read says that they are not recordings.

    Parameters
    ----------
    paths : sequence of Path or StoreFile
    """
    return [path for path in paths if path.name != JOURNAL and not path.name.endswith(AMENDMENTS)] or paths


def find_files(paths: Iterable[Place]) -> list[FoundFile]:
    """Expand directories to the finished recordings in them, in the order of their names.

    Parameters
    ----------
    paths : iterable of Path or StoreFile
        Files, or directories that hold recordings, on the disk or in an object store; see `without_own_files`.

    Raises
    ------
    InputError
        If a path does not exist or a directory has no recording.
    """
    found: list[FoundFile] = []
    for path in without_own_files(list(paths)):
        file = find_recording(path)
        if file is not None:
            found.append(file)
            continue
        inside = list_recordings(path)
        if not inside and isinstance(path, Path) and not path.is_dir():
            raise InputError("no such file", where=path)
        if not inside:
            raise InputError(
                "has no .mcap file",
                where=path,
                remedy="give the folder of the recordings, or create recordings with `sawbench import`",
            )
        found += inside
    return list({file.place: file for file in found}.values())


def config_for(recording: Recording | None, config_path: Path | LoadedConfig | None) -> LoadedConfig:
    """Choose the configuration: the named one, the recording's own, ./bench_config.toml, or the shipped one.

    Parameters
    ----------
    recording : Recording, optional
    config_path : Path or LoadedConfig, optional
        The file that was named, or what was read from it.

    Raises
    ------
    ConfigError
        If the configuration cannot be read or is not valid.
    """
    from sawbench.bench.config import LoadedConfig, load_config, parse_config
    from sawbench.bench.unusual_numbers import unusual_numbers

    if isinstance(config_path, LoadedConfig):
        return config_path
    if config_path is None and recording is not None and recording.config_toml:
        loaded = parse_config(recording.config_toml, where=f"configuration inside {recording.path}")
    else:
        loaded = load_config(config_path or default_config_path())
    for text in unusual_numbers(loaded.config):
        _say_once(f"{loaded.path}: {text}")
    return loaded


def default_config_file() -> Path:
    """./bench_config.toml, else the one of the package; says nothing, for what only asks whether it changed."""
    return DEFAULT_CONFIG if DEFAULT_CONFIG.exists() else shipped_config()


def default_config_path() -> Path:
    """./bench_config.toml, else the one that ships with sawbench."""
    if DEFAULT_CONFIG.exists():
        return DEFAULT_CONFIG
    _say_once(f"no {DEFAULT_CONFIG} in this folder: using the one of the package")
    return shipped_config()


@cache
def _say_once(text: str) -> None:
    """Warn of what holds for many recordings, once a process."""
    _LOG.warning("%s", text)
