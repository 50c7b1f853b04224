"""`sawbench tare`: zero the load cell, with provenance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click
from sawbench.commands.options import bench_config_option, calibration_book_path, json_option
from sawbench.commands.terminal import emit, stepper
from sawbench.inputs import config_for, default_config_path

if TYPE_CHECKING:
    from sawbench.acquisition.calibration_book import BookEntry
    from sawbench.acquisition.devices.device import Device
    from sawbench.acquisition.resting_channel import RestingChannel
    from sawbench.bench.config import LoadedConfig


@click.command(name="tare", epilog="Example: sawbench tare --seconds 5 --operator Kim --note 'blade mounted'")
@click.option("--channel", default="force_n", show_default=True, help="Channel to zero.")
@click.option("--seconds", type=click.FloatRange(0.5, 600.0), default=5.0, show_default=True, help="Averaging time, s.")
@click.option("--tolerance", type=click.FloatRange(0, min_open=True), help="Maximum allowed drift, channel's unit.")
@click.option("--operator", default="", help="Name of the operator.")
@click.option("--note", default="", help="Note stored with the tare.")
@bench_config_option
@click.option("--simulated", is_flag=True, help="Tare the simulated bench, which has its own calibration book.")
@click.option("--seed", default=0, show_default=True, help="Seed of the simulated bench.")
@click.option("--force", is_flag=True, help="Accept a reading that is too large for a zero.")
@json_option
def command(
    channel: str,
    seconds: float,
    tolerance: float | None,
    operator: str,
    note: str,
    config_path: Path | None,
    simulated: bool,
    seed: int,
    force: bool,
    as_json: bool,
) -> int:
    """Average the unloaded sensor and keep that as its zero, for every later recording.

    Refused while the value moves or drifts. The former zeros stay in the calibration book.
    """
    from sawbench.commands.recording_session import bench_ports, check_devices

    config_path = config_path or default_config_path()
    loaded = config_for(None, config_path)
    check_devices(loaded)
    asked = TareRequest(
        book=calibration_book_path(config_path, simulated=simulated),
        channel=channel,
        seconds=seconds,
        tolerance=tolerance,
        operator=operator,
        note=note,
        force=force,
    )
    with bench_ports(config_path, simulated=simulated, seed=seed) as endpoints:
        entry, resting = take_tare(loaded, endpoints, asked)
    kept = f"{describe(resting)}\nstored in {asked.book}"
    emit({"book": asked.book, **entry.model_dump(mode="json")}, kept, as_json=as_json)
    return 0


@dataclass(frozen=True, kw_only=True, slots=True)
class TareRequest:
    """What is zeroed and how.

    Attributes
    ----------
    book : Path
        Calibration book that the zero is kept in.
    channel : str
    seconds : float
        Averaged over this long.
    tolerance : float, optional
        Maximum allowed drift, in the channel's unit.
    operator, note : str
    force : bool
        Accept a reading that is too large for a zero.
    """

    book: Path
    channel: str = "force_n"
    seconds: float = 5.0
    tolerance: float | None = None
    operator: str = ""
    note: str = ""
    force: bool = False


def take_tare(
    loaded: LoadedConfig, endpoints: Mapping[str, str], asked: TareRequest
) -> tuple[BookEntry, RestingChannel]:
    """Average the unloaded sensor and keep that as its zero in the calibration book.

    Parameters
    ----------
    loaded : LoadedConfig
    endpoints : mapping of str to str
        Device name -> port, instead of the configured ones.
    asked : TareRequest

    Returns
    -------
    entry : BookEntry
        What was kept.
    resting : RestingChannel
        What was read.

    Raises
    ------
    UntrustedResult
        If the value moves, drifts, or is too large for a zero.
    """
    from sawbench.acquisition.calibration_book import BookEntry, add_entry, build_calibrated, calibrations_of, read_book
    from sawbench.acquisition.resting_channel import tare
    from sawbench.storage.writer import software_version

    # The zero is found again, so that former tares do not matter, not even ones that no longer fit.
    book = calibrations_of(read_book(asked.book), asked.channel)
    devices, configured = build_calibrated(loaded.config, book, endpoints)
    resting = read_resting(devices, asked.channel, seconds=asked.seconds, tolerance=asked.tolerance, saying="taring")
    entry = BookEntry(
        kind="tare",
        device=resting.device,
        channel=asked.channel,
        made_at=datetime.now(UTC),
        result=tare(resting, resting.channel.calibration, force=asked.force),
        configured=configured[resting.device, asked.channel],
        zero_std_raw=resting.raw_std,
        seconds=resting.found.seconds,
        instrument={"port": resting.port, **resting.facts},
        software=software_version(),
        operator=asked.operator,
        note=asked.note,
        details={
            "offset": resting.found.mean,
            "offset_std": resting.found.std,
            "unit": resting.channel.unit,
            "noise_std": resting.found.noise_std,
            "n_samples": resting.found.n_samples,
            "n_effective": resting.found.n_effective,
            "drift_per_s": resting.found.drift_per_s,
            "drift_std_per_s": resting.found.drift_std_per_s,
        },
    )
    add_entry(asked.book, entry)
    return entry, resting


def read_resting(
    devices: list[Device], channel: str, *, seconds: float, tolerance: float | None, saying: str
) -> RestingChannel:
    """Read the instrument that gives `channel` and average that channel; a progress bar says `saying`.

    Raises
    ------
    UntrustedResult
        If it does not rest, or the instrument has a fault.
    """
    from sawbench.acquisition.device_probe import probe_devices
    from sawbench.acquisition.resting_channel import device_with, resting_channel

    device = device_with(devices, channel)
    tenths = round(10 * seconds)
    with stepper(saying) as step:
        (probe,) = probe_devices(
            [device], seconds=seconds, watch=lambda now_s: step(min(tenths, round(10 * now_s)), tenths, channel)
        )
    return resting_channel(probe, channel, tolerance=tolerance)


def describe(resting: RestingChannel) -> str:
    """Offset with uncertainty, scatter, drift."""
    from sawbench.reporting.quantities import format_quantity

    found, unit = resting.found, resting.channel.unit
    return (
        f"{resting.channel.name}: the unloaded sensor read {format_quantity(found.mean, found.std, unit)}; "
        f"this is the new zero\n"
        f"{found.n_samples} samples in {found.seconds:.1f} s, equivalent to {found.n_effective:.0f} independent"
        " samples; noise "
        f"{found.noise_std:.2g} {unit} (1 std), drift {found.drift_per_s * 60:+.2g} ± "
        f"{found.drift_std_per_s * 60:.1g} {unit}/min"
    )
