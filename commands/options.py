"""Options that several subcommands share, and how they find their configuration and recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import bench
from bench.errors import InputError

if TYPE_CHECKING:
    from bench.config import LoadedConfig
    from bench.recording import Recording

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]
DEFAULT_CONFIG = Path("bench_config.toml")
SHIPPED_CONFIG = Path(bench.__file__).with_name("default_config.toml")

config_option: Decorator = click.option(
    "--config",
    "config_path",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Bench configuration; default: that of the recording, else ./bench_config.toml, else the one that ships.",
)
json_option: Decorator = click.option("--json", "as_json", is_flag=True, help="Print machine-readable JSON.")
force_option: Decorator = click.option("--force", is_flag=True, help="Overwrite files that exist.")
recordings_argument: Decorator = click.argument(
    "paths", metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path)
)


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
    """Choose the configuration: `--config`, else the recording's own, else ./bench_config.toml, else the shipped one.

    Parameters
    ----------
    recording : Recording, optional
    config_path : Path, optional
        What `--config` named.

    Returns
    -------
    LoadedConfig
    """
    from bench.config import load_config, parse_config

    if config_path is not None:
        return load_config(config_path)
    if recording is not None and recording.config_toml:
        return parse_config(recording.config_toml, where=f"configuration inside {recording.path}")
    return load_config(default_config_path())


def default_config_path() -> Path:
    """./bench_config.toml, else the one that ships with sawbench."""
    if DEFAULT_CONFIG.exists():
        return DEFAULT_CONFIG
    click.echo(f"no {DEFAULT_CONFIG} here: using the one that ships with sawbench", err=True)
    return SHIPPED_CONFIG


def calibration_book_path(config_path: Path, *, simulated: bool) -> Path:
    """Place of the tares and calibrations that belong to a configuration."""
    from acquisition.calibration_book import book_path

    return book_path(config_path, simulated=simulated, shipped=SHIPPED_CONFIG)


def refuse_unwritable(path: Path, *, force: bool) -> None:
    """Raise, before any work is done, if `path` exists without `--force` or its folder does not.

    Raises
    ------
    InputError
    """
    refuse_existing(path, force=force)
    if not path.parent.is_dir():
        raise InputError("the folder does not exist", where=path, remedy=f"make {path.parent} first")


def refuse_existing(path: Path, *, force: bool) -> None:
    """Raise if `path` exists and `--force` was not given.

    Raises
    ------
    InputError
    """
    if path.exists() and not force:
        raise InputError("exists already", where=path, remedy="name another file, or overwrite with --force")
