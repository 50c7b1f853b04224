"""`sawbench tare`: zero the load cell, with provenance."""

from __future__ import annotations

import contextlib
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
from sawbench.commands.options import calibration_book_path, config_option, json_option
from sawbench.commands.terminal import emit, stepper
from sawbench.inputs import config_for, default_config_path

if TYPE_CHECKING:
    from sawbench.acquisition.devices.device import Device
    from sawbench.acquisition.resting_channel import RestingChannel

NEVER_S: Final = 1e9


@click.command(name="tare", epilog="Example: sawbench tare --seconds 5 --operator Kim --note 'blade mounted'")
@click.option("--channel", default="force_n", show_default=True, help="Channel to zero.")
@click.option("--seconds", type=click.FloatRange(0.5, 600.0), default=5.0, show_default=True, help="Average over this.")
@click.option("--tolerance", type=click.FloatRange(0, min_open=True), help="Maximum allowed drift, channel's unit.")
@click.option("--operator", default="", help="Who does it.")
@click.option("--note", default="", help="Kept with the tare.")
@config_option
@click.option("--simulated", is_flag=True, help="Tare the simulated bench; it has a calibration book of its own.")
@click.option("--seed", default=0, show_default=True, help="Of the simulated bench.")
@click.option("--force", is_flag=True, help="Take a reading that is too large for a zero.")
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
    from sawbench.acquisition.calibration_book import BookEntry, add_entry, build_calibrated, calibrations_of, read_book
    from sawbench.acquisition.resting_channel import tare
    from sawbench.commands.recording_session import check_devices, simulated_bench
    from sawbench.storage.writer import software_version

    config_path = config_path or default_config_path()
    loaded = config_for(None, config_path)
    check_devices(loaded)
    path = calibration_book_path(config_path, simulated=simulated)
    # The zero is found anew, so that former tares do not matter, not even ones that no longer fit.
    book = calibrations_of(read_book(path), channel)
    bench = (
        simulated_bench(config_path, material="none", duty=None, seed=seed, trigger_after_s=NEVER_S)
        if simulated
        else contextlib.nullcontext({})
    )
    with bench as endpoints:
        devices, configured = build_calibrated(loaded.config, book, endpoints)
        resting = read_resting(devices, channel, seconds=seconds, tolerance=tolerance, saying="taring")
    result = tare(resting, resting.channel.calibration, force=force)
    entry = BookEntry(
        kind="tare",
        device=resting.device,
        channel=channel,
        made_at=datetime.now(UTC),
        result=result,
        configured=configured[resting.device, channel],
        zero_std_raw=resting.raw_std,
        seconds=resting.found.seconds,
        instrument={"port": resting.port, **resting.facts},
        software=software_version(),
        operator=operator,
        note=note,
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
    add_entry(path, entry)
    emit({"book": path, **entry.model_dump(mode="json")}, f"{describe(resting)}\nkept in {path}", as_json=as_json)
    return 0


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
        f"that is 0 from now on\n"
        f"{found.n_samples} samples in {found.seconds:.1f} s, worth {found.n_effective:.0f} independent ones; noise "
        f"{found.noise_std:.2g} {unit} (1 std), drift {found.drift_per_s * 60:+.2g} +/- "
        f"{found.drift_std_per_s * 60:.1g} {unit}/min"
    )
