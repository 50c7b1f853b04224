"""`sawbench check`: whether the bench is fit to record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
from sawbench.commands.options import bench_config_option, calibration_book_path, json_option
from sawbench.commands.terminal import emit, stepper, table
from sawbench.inputs import config_for, default_config_path

if TYPE_CHECKING:
    from sawbench.acquisition.preflight import ChannelCheck, Finding, Preflight
    from sawbench.bench.config import LoadedConfig

# When the simulated tool is switched on for --running.
_AT_ONCE_S: Final = 0.1


@click.command(name="check", epilog="Example: sawbench check --seconds 3 --simulated")
@bench_config_option
@click.option(
    "--seconds", type=click.FloatRange(0.5, 600.0), default=3.0, show_default=True, help="Observation time, s."
)
@click.option("--running", "is_running", is_flag=True, help="The tool is running: do not check noise and zero.")
@click.option("--simulated", is_flag=True, help="Check the simulated bench instead of real instruments.")
@click.option("--seed", default=0, show_default=True, help="Seed of the simulated bench.")
@json_option
def command(
    config_path: Path | None, seconds: float, is_running: bool, simulated: bool, seed: int, as_json: bool
) -> int:
    """Open every instrument, look for a few seconds, and say in plain words what is wrong and what to do.

    The tool should be at rest, or say --running. Exit code 1 where something is not reliable.
    """
    from sawbench.commands.recording_session import NEVER_S, bench_ports, check_devices

    config_path = config_path or default_config_path()
    loaded = config_for(None, config_path)
    check_devices(loaded)
    book = calibration_book_path(config_path, simulated=simulated)
    trigger_after_s = _AT_ONCE_S if is_running else NEVER_S
    with bench_ports(config_path, simulated=simulated, seed=seed, trigger_after_s=trigger_after_s) as endpoints:
        found = look(loaded, book, endpoints, seconds=seconds, is_running=is_running)
    emit(
        {"is_good": found.is_good, "seconds": seconds, "channels": found.channels, "findings": found.findings},
        describe(found),
        as_json=as_json,
    )
    return 0 if found.is_good else 1


def look(
    loaded: LoadedConfig, book: Path, endpoints: Mapping[str, str], *, seconds: float, is_running: bool = False
) -> Preflight:
    """Open every instrument, look for `seconds`, and judge; a progress bar on a terminal.

    Parameters
    ----------
    loaded : LoadedConfig
    book : Path
        Tares and calibrations to apply.
    endpoints : mapping of str to str
        Device name -> port, instead of the configured ones.
    seconds : float
    is_running : bool
        The tool is running: do not check noise and zero.
    """
    from sawbench.acquisition.calibration_book import (
        build_calibrated,
        entries_in_force,
        not_in_book,
        of_other_instruments,
        read_book,
        uncalibrated,
    )
    from sawbench.acquisition.device_probe import probe_devices
    from sawbench.acquisition.preflight import Finding, judge

    entries = read_book(book)
    devices, configured = build_calibrated(loaded.config, entries, endpoints)
    tenths = round(10 * seconds)
    with stepper("checking") as step:
        probes = probe_devices(
            devices, seconds=seconds, watch=lambda now_s: step(min(tenths, round(10 * now_s)), tenths, "")
        )
    found = judge(probes, is_running=is_running)
    lacking = [
        Finding(
            severity="fault",
            code="not_calibrated",
            device=device,
            channel=channel,
            what=error.what,
            remedy=error.remedy or "",
        )
        for device, channel, error in uncalibrated(entries, configured, loaded.config.known_channels)
    ]
    own = [
        Finding(
            severity="note",
            code="not_in_calibration_book",
            device=device,
            channel=channel,
            what=what,
            remedy=f"`sawbench calibrate --channel {channel}`, or copy the book of the bench there",
        )
        for device, channel, what in not_in_book(entries, configured, loaded.config.known_channels, book)
    ]
    facts = {probe.device: probe.facts for probe in probes}
    foreign = [
        Finding(
            severity="note",
            code="calibration_of_other_instrument",
            device=entry.device,
            channel=entry.channel,
            what=what,
            remedy=f"`sawbench {'tare' if entry.kind == 'tare' else 'calibrate --force'} --channel {entry.channel}`"
            " with this instrument, or connect the other one",
        )
        for entry, what in of_other_instruments(entries_in_force(entries, configured), facts)
    ]
    return replace(found, findings=(*lacking, *found.findings, *foreign, *own))


def describe(found: Preflight) -> str:
    """Table of the channels, then one paragraph a finding, then the verdict."""
    headers = ["channel", "device", "now", "noise", "unit", "rate Hz", "nominal", "missing", "clock ppm"]
    lines = [table(headers, [_row(c) for c in found.channels])] if found.channels else []
    lines += [_paragraph(f) for f in found.findings]
    n_faults = sum(f.severity == "fault" for f in found.findings)
    lines.append("all good" if found.is_good else f"{n_faults} fault{'s' if n_faults > 1 else ''}: not reliable")
    return "\n".join(lines)


def _row(c: ChannelCheck) -> list[str]:
    is_drift_known = c.drift_ppm is not None and c.drift_std_ppm is not None
    return [
        c.channel,
        c.device,
        "-" if c.latest is None else f"{c.latest:.4g}",
        "-" if c.noise_std is None else f"{c.noise_std:.2g}",
        c.unit,
        f"{c.rate_hz:.1f}",
        f"{c.nominal_rate_hz:g}" if c.nominal_rate_hz else "polled",
        str(c.n_missing),
        f"{c.drift_ppm:+.0f} ± {c.drift_std_ppm:.0f}" if is_drift_known else "-",
    ]


def _paragraph(f: Finding) -> str:
    whose = " ".join(name for name in (f.device, f.channel) if name)
    head = " ".join(word for word in ("FAULT" if f.severity == "fault" else "note", whose) if word)
    return f"{head}: {f.what}\n  -> {f.remedy}"
