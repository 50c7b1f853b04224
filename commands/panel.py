"""`sawbench panel`: the operator panel, a local web page for the bench computer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import click
from sawbench.bench.errors import InputError, SawbenchError
from sawbench.commands.options import bench_config_option, calibration_book_path, refuse_unwritable_folder
from sawbench.inputs import config_for, default_config_path

_PORT: Final = 8765
_NEEDED: Final = ("starlette", "uvicorn")


@click.command(name="panel", epilog="Example: sawbench panel --simulated")
@bench_config_option
@click.option(
    "--recordings", type=click.Path(path_type=Path, file_okay=False), help="Folder; default: the configuration's."
)
@click.option(
    "--plans", type=click.Path(path_type=Path, file_okay=False, exists=True), default=Path(), show_default=True,
    help="Folder with plans of series.",
)  # fmt: skip
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address to serve; other than 127.0.0.1: reachable from the network, with a token.",
)
@click.option("--port", type=click.IntRange(0, 65535), default=_PORT, show_default=True, help="Port; 0: any free port.")
@click.option("--simulated", is_flag=True, help="Use the simulated bench instead of real instruments.")
@click.option("--browser/--no-browser", default=True, help="Open the page in a browser if there is a display.")
def command(
    config_path: Path | None, recordings: Path | None, plans: Path, host: str, port: int, simulated: bool, browser: bool
) -> int:
    """Serve the operator panel: check, tare, calibrate, record, series, results, corrections, compare, diagnose.

    Every button runs a command of sawbench as a process of its own; a closed page or the end of the panel ends no
    recording. Ctrl-C ends the panel.
    """
    _require_packages()
    from sawbench.commands.recording_session import check_devices
    from sawbench.commands.terminal import has_display
    from sawbench.panel.app import PanelSettings, build_app
    from sawbench.panel.commands_of import BenchOptions
    from sawbench.panel.security import LOOPBACK, new_secret
    from sawbench.panel.server import bound, serve

    chosen = config_path or default_config_path()
    loaded = config_for(None, chosen)
    check_devices(loaded)
    folder = recordings or Path(loaded.config.recording.directory)
    refuse_unwritable_folder(folder)
    settings = PanelSettings(
        options=BenchOptions(recordings=folder, config_path=config_path, simulated=simulated),
        plans=plans,
        bench=lambda: bench_facts(chosen, simulated=simulated),
        refusal=refusal,
        second_copy=loaded.config.recording.second_copy,
    )
    token = "" if host in LOOPBACK else new_secret()
    socket = bound(host, port)
    address = f"http://{_shown(host)}:{socket.getsockname()[1]}/" + (f"?token={token}" if token else "")
    click.echo(f"operator panel: {address}\nCtrl-C stops the panel; a running recording continues")
    if browser and has_display():
        click.launch(address)
    serve(build_app(settings, token=token), socket)
    return 0


def bench_facts(config_path: Path, *, simulated: bool) -> Mapping[str, Any]:
    """Return what the panel shows of the bench; what is wrong with the configuration is said in `problem`."""
    from datetime import UTC, datetime

    from sawbench.acquisition.calibration_book import (
        CalibrationBook,
        age,
        build_calibrated,
        entries_in_force,
        read_book,
    )
    from sawbench.bench.config import load_config

    facts: dict[str, Any] = {"config": str(config_path), "devices": [], "channels": [], "in_force": [], "problem": ""}
    try:
        config = load_config(config_path).config
        devices, configured = build_calibrated(config, CalibrationBook())
        for device in devices:
            channels = [channel.name for stream in device.streams for channel in stream.channels]
            row = {"name": device.name, "kind": type(device).__name__, "channels": ", ".join(channels),
                   "port": "simulated" if simulated else device.port}  # fmt: skip
            facts["devices"].append(row)
            facts["channels"] += channels
        book = read_book(calibration_book_path(config_path, simulated=simulated))
        now, units = datetime.now(UTC), {name: known.unit for name, known in config.known_channels.items()}
        facts["in_force"] = [
            {**entry.model_dump(), "unit": units.get(entry.channel, ""), "age": age(entry, now)}
            for entry in entries_in_force(book, configured)
        ]
    except SawbenchError as error:
        facts["problem"] = str(error)
    return facts


def refusal(arguments: Sequence[str]) -> str:
    """Say what is wrong with arguments of `sawbench`, as far as its options tell; empty where nothing is.

    Examples
    --------
    >>> refusal(["record", "--material=oak", "--duty=1.5"])
    "Invalid value for '--duty': 1.5 is not in the range 0<x<=1."
    >>> refusal(["record", "--material=oak"])
    ''
    """
    from sawbench.commands.main import cli

    group: Any = cli
    rest = list(arguments)
    try:
        while isinstance(group, click.Group):
            found = group.get_command(click.Context(group), rest[0])
            if found is None:
                return f"there is no command {rest[0]!r}"
            group, rest = found, rest[1:]
        group.make_context(arguments[0], rest)
    except click.ClickException as error:
        return error.format_message()
    return ""


def _require_packages() -> None:
    from importlib.util import find_spec

    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing:
        raise InputError(
            f"the panel needs packages that are not installed: {', '.join(missing)}",
            remedy='install them with: pip install "sawbench[panel]"',
        )


def _shown(host: str) -> str:
    import socket

    if host in {"0.0.0.0", "::"}:
        return socket.gethostname()
    return f"[{host}]" if ":" in host else host
