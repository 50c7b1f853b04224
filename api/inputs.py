"""Which recordings and which configuration are meant."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from sawbench.bench.errors import InputError

if TYPE_CHECKING:
    from sawbench.bench.config import LoadedConfig
    from sawbench.bench.recording import Recording

DEFAULT_CONFIG: Final = Path("bench_config.toml")
_LOG: Final = logging.getLogger("sawbench")


def shipped_config() -> Path:
    """Configuration that is installed with sawbench."""
    import sawbench.bench

    return Path(sawbench.bench.__path__[0]) / "default_config.toml"


def find_recordings(paths: Iterable[Path]) -> list[Path]:
    """Expand directories to the finished recordings in them, in the order of their names.

    Parameters
    ----------
    paths : iterable of Path
        Files, or directories that hold `.mcap` files.

    Returns
    -------
    list of Path

    Raises
    ------
    InputError
        If a path does not exist or a directory holds no recording.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(path.glob("*.mcap"))
            if not inside:
                raise InputError(
                    "holds no .mcap file",
                    where=path,
                    remedy="name the directory the recordings are in, or make some with `sawbench import`",
                )
            found += inside
        elif path.exists():
            found.append(path)
        else:
            raise InputError("no such file", where=path)
    return list(dict.fromkeys(found))


def config_for(recording: Recording | None, config_path: Path | None) -> LoadedConfig:
    """Choose the configuration: the named one, the recording's own, ./bench_config.toml, or the shipped one.

    Parameters
    ----------
    recording : Recording, optional
    config_path : Path, optional
        The file that was named.

    Returns
    -------
    LoadedConfig

    Raises
    ------
    ConfigError
        If the configuration cannot be read or is not valid.
    """
    from sawbench.bench.config import load_config, parse_config

    if config_path is not None:
        return load_config(config_path)
    if recording is not None and recording.config_toml:
        return parse_config(recording.config_toml, where=f"configuration inside {recording.path}")
    return load_config(default_config_path())


def default_config_path() -> Path:
    """./bench_config.toml, else the one that ships with sawbench."""
    if DEFAULT_CONFIG.exists():
        return DEFAULT_CONFIG
    _LOG.warning("no %s here: using the one that ships with sawbench", DEFAULT_CONFIG)
    return shipped_config()
