"""`sawbench calibrate`: known loads or lengths at a channel -> gain and zero with their uncertainty."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from sawbench.bench.errors import InputError, UntrustedResult
from sawbench.bench.units import CHANNEL_BY_NAME, FORCE
from sawbench.commands.link import current_link
from sawbench.commands.options import bench_config_option, calibration_book_path, json_option
from sawbench.commands.tare import read_resting
from sawbench.commands.terminal import emit, table
from sawbench.inputs import config_for, default_config_path
from sawbench.plain import plain

if TYPE_CHECKING:
    from sawbench.acquisition.calibration import Calibration
    from sawbench.acquisition.calibration_fit import CalibrationPoint, StraightLine
    from sawbench.acquisition.resting_channel import RestingChannel
    from sawbench.bench.config import LoadedConfig

STANDARD_GRAVITY_M_S2: Final = 9.80665


@dataclass(frozen=True, kw_only=True, slots=True)
class Session:
    """What every point needs."""

    loaded: LoadedConfig
    config_path: Path
    book: Path
    channel: str
    seconds: float
    tolerance: float | None
    unit: str
    factor: float
    reference_std: float
    simulated: bool
    seed: int


@click.command(
    name="calibrate",
    epilog="Example: sawbench calibrate --kilograms --point 0 --point 10 --point 20 --point 10 --point 0",
)
@click.option("--channel", default="force_n", show_default=True, help="Channel to calibrate.")
@click.option(
    "--point", "values", type=float, multiple=True, help="Known value; repeat in the order of the measurements."
)
@click.option(
    "--from", "table_path", type=click.Path(path_type=Path, dir_okay=False), help="CSV reference,raw[,..._std]."
)
@click.option("--kilograms", is_flag=True, help="The points are masses in kg, suspended from the sensor.")
@click.option(
    "--gravity", type=click.FloatRange(9.7, 9.9), default=STANDARD_GRAVITY_M_S2, show_default=True, help="m/s2"
)
@click.option(
    "--reference-std",
    type=click.FloatRange(0),
    default=0.0,
    help="Standard uncertainty of each known value, in its unit.",
)
@click.option(
    "--reference-rel-std", type=click.FloatRange(0, 1), default=0.001, show_default=True, help="Common to all."
)
@click.option(
    "--seconds", type=click.FloatRange(0.5, 600.0), default=3.0, show_default=True, help="Averaging time per point, s."
)
@click.option("--tolerance", type=click.FloatRange(0, min_open=True), help="Maximum allowed drift, channel's unit.")
@click.option(
    "--largest-deviation", type=click.FloatRange(0, 1), default=0.01, show_default=True,
    help="Maximum allowed nonlinearity and hysteresis, share of the range.",
)  # fmt: skip
@click.option("--operator", default="", help="Name of the operator.")
@click.option("--note", default="", help="Note stored with the calibration: weights, certificate, temperature.")
@bench_config_option
@click.option("--simulated", is_flag=True, help="Calibrate the simulated bench; the loads are applied automatically.")
@click.option("--seed", default=0, show_default=True, help="Seed of the simulated bench.")
@click.option(
    "--force", is_flag=True, help="Replace a calibration (the old one stays in the history), or store a doubtful one."
)
@json_option
def command(
    channel: str,
    values: tuple[float, ...],
    table_path: Path | None,
    kilograms: bool,
    gravity: float,
    reference_std: float,
    reference_rel_std: float,
    seconds: float,
    tolerance: float | None,
    largest_deviation: float,
    operator: str,
    note: str,
    config_path: Path | None,
    simulated: bool,
    seed: int,
    force: bool,
    as_json: bool,
) -> int:
    """Take known loads one after the other, fit a straight line, keep it for every later recording.

    Without --point and --from it asks for the values; with both, the table's points come first. Take zero and the
    largest load too; up and then down again shows the hysteresis. A doubtful calibration is not kept, unless
    --force is given.
    """
    from sawbench.acquisition.calibration_book import add_entry
    from sawbench.acquisition.calibration_fit import fit_line, judge_line, require_gain, require_sound
    from sawbench.commands.recording_session import check_devices

    if kilograms and channel != "force_n":
        raise InputError(f"--kilograms is for force_n, not {channel}", remedy="give the points in the channel's unit")
    config_path = config_path or default_config_path()
    loaded = config_for(None, config_path)
    check_devices(loaded)
    path = calibration_book_path(config_path, simulated=simulated)
    device_name, former, configured = lines_in_force(loaded, path, channel, force=force)
    unit = loaded.config.known_channels[channel].unit
    session = Session(
        loaded=loaded, config_path=config_path, book=path, channel=channel, seconds=seconds, tolerance=tolerance,
        unit="kg" if kilograms else unit, factor=gravity if kilograms else 1.0,
        reference_std=reference_std, simulated=simulated, seed=seed,
    )  # fmt: skip
    is_read = bool(values) or table_path is None
    with kept_until_stored(session, table_points(table_path, values, reference_std)) as taken:
        instrument = {} if table_path is None else {"points": str(table_path)}
        instrument |= take_points(session, values, taken) if is_read else {}
        points = [_scaled(p, session.factor) for p in taken]
        line = fit_line(points, common_rel_std=reference_rel_std)
        complaints = judge_line(line, former, largest_deviation=largest_deviation)
        said = describe(points, line, former, channel, unit)
        where = f"{device_name} {channel}"
        if complaints and not force:
            click.echo(said, err=True)
        require_gain(line, where=where)
        require_sound(complaints, where=where, force=force)
        entry = book_entry(
            points, line, former, configured, device=device_name, channel=channel,
            seconds=seconds if is_read else None, instrument=instrument, operator=operator, note=note,
        )  # fmt: skip
        add_entry(path, entry)
    emit(
        {"book": path, "unit": unit, "complaints": complaints, "fit": line_rows(line), **entry.model_dump(mode="json")},
        f"{said}\nstored in {path}",
        as_json=as_json,
    )
    return 1 if complaints else 0


def lines_in_force(
    loaded: LoadedConfig, path: Path, channel: str, *, force: bool
) -> tuple[str, Calibration, Calibration]:
    """Device of a channel, the calibration in force (that of the book before the configuration's), the configured one.

    Raises
    ------
    InputError
        If the book at `path` has a calibration of the channel and `force` is not set.
    """
    from sawbench.acquisition.calibration_book import CalibrationBook, build_calibrated, read_book
    from sawbench.acquisition.resting_channel import device_with

    book = read_book(path)
    devices, configured = build_calibrated(loaded.config, CalibrationBook())
    name = device_with(devices, channel).name
    made = [e for e in book.in_force(name, channel) if e.kind == "calibration"]
    if made and not force:
        raise InputError(
            f"{channel} already has a calibration, {made[0].title}",
            where=path,
            remedy="replace it with --force; the old one stays in the history",
        )
    return name, made[0].result if made else configured[name, channel], configured[name, channel]


def table_points(
    table_path: Path | None, values: tuple[float, ...], reference_std: float = 0.0
) -> list[CalibrationPoint]:
    """Read the points of the table, none without one; refuse known values that tell no line before a load hangs.

    Parameters
    ----------
    table_path : Path, optional
    values : tuple of float
        Known values of the points to come.
    reference_std : float
        Standard uncertainty of each known value; it holds where the table states none.

    Raises
    ------
    InputError
        If table and `reference_std` state different uncertainties, or the known values tell no line.
    """
    from sawbench.acquisition.calibration_fit import read_points, require_loads

    points = [] if table_path is None else list(read_points(table_path))
    if reference_std:
        other = [p.reference_std for p in points if p.reference_std not in {0.0, reference_std}]
        if other:
            raise InputError(
                f"the column reference_std states {other[0]:g}, --reference-std {reference_std:g}",
                where=table_path,
                remedy="leave out the option or the column",
            )
        points = [replace(p, reference_std=reference_std) for p in points]
    if values:
        require_loads([*(p.reference for p in points), *values])
    return points


@contextlib.contextmanager
def kept_until_stored(session: Session, before: list[CalibrationPoint]) -> Iterator[list[CalibrationPoint]]:
    """Give the list of points, in the unit of the session, which begins with `before`.

    Where anything fails before they are stored, and some were measured, they are written to a table for `--from`: loads
    that hung once need not be hung again.
    """
    points = list(before)
    try:
        yield points
    except BaseException:
        if len(points) > len(before):
            _keep_for_later(session, points)
        raise


def take_points(session: Session, values: tuple[float, ...], points: list[CalibrationPoint]) -> dict[str, str]:
    """Read one resting mean a load; a reading that does not rest is taken again.

    Parameters
    ----------
    session : Session
    values : tuple of float
        Known values, in the unit of the session; without any the operator is asked, who types what hangs already.
    points : list of CalibrationPoint
        In the unit of the session; each new one is added at once.

    Returns
    -------
    dict of str to str
        What the instrument says of itself.

    Raises
    ------
    SawbenchError
        If the instrument fails.
    """
    from sawbench.acquisition.calibration_fit import CalibrationPoint

    instrument = dict[str, str]()
    for reference in values or _asked(session.channel, session.unit):
        if values and not session.simulated:
            _ask(f"apply {reference:g} {session.unit}, let it settle, press Enter")
        resting = _read_point(session, reference, n_before=len(points))
        unit = resting.channel.calibration.raw_unit
        click.echo(f"{reference:g} {session.unit}: {resting.raw_mean:.7g} ± {resting.raw_std:.2g} {unit}", err=True)
        points.append(
            CalibrationPoint(
                reference=reference,
                raw=resting.raw_mean,
                raw_std=resting.raw_std,
                reference_std=session.reference_std,
            )
        )
        instrument = {"port": resting.port, **resting.facts}
    return instrument


def _read_point(session: Session, reference: float, *, n_before: int) -> RestingChannel:
    """Read the channel under a load; at a real bench again and again until it rests or the operator gives up."""
    from sawbench.acquisition.calibration_book import CalibrationBook, build_calibrated
    from sawbench.commands.recording_session import bench_ports

    while True:
        bench = bench_ports(
            session.config_path, simulated=session.simulated, seed=session.seed + n_before,
            load=(session.channel, session.factor * reference),
        )  # fmt: skip
        with bench as endpoints:
            devices, _ = build_calibrated(session.loaded.config, CalibrationBook(), endpoints)
            try:
                return read_resting(
                    devices, session.channel, seconds=session.seconds, tolerance=session.tolerance,
                    saying=f"{reference:g} {session.unit},",
                )  # fmt: skip
            except UntrustedResult as error:
                if session.simulated:
                    raise
                click.echo(str(error), err=True)
        _ask(f"let {reference:g} {session.unit} settle, press Enter to read it again (Ctrl-C ends)")


def _ask(text: str) -> str:
    """Say what to do or to type; the answer, which may be empty."""
    link = current_link()
    if link is None:
        return click.prompt(text, default="", show_default=False, err=True)
    answer = link.ask(text)
    if answer is None:
        raise KeyboardInterrupt("stopped by the operator")
    return answer


def _keep_for_later(session: Session, points: list[CalibrationPoint]) -> None:
    from sawbench.acquisition.calibration_fit import write_points

    path = session.book.with_name(f"calibration-points-{session.channel}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.csv")
    write_points(path, points)
    options = (" --simulated" if session.simulated else "") + (" --kilograms" if session.unit == "kg" else "")
    click.echo(
        f"the {len(points)} points measured so far are stored in {path}\n"
        f"  -> continue with: sawbench calibrate --channel {session.channel}{options} --from {path}, "
        "and --point ... for each further load",
        err=True,
    )


def book_entry(
    points: list[CalibrationPoint],
    line: StraightLine,
    former: Calibration,
    configured: Calibration,
    **facts: Any,
) -> Any:
    """Return the entry of the calibration book."""
    from sawbench.acquisition.calibration import Calibration
    from sawbench.acquisition.calibration_book import BookEntry
    from sawbench.storage.writer import software_version

    result = Calibration(
        scale=line.gain,
        zero_raw=line.zero_raw,
        raw_unit=former.raw_unit,
        rel_std=line.gain_rel_std,
        source=f"{len(points)} points, sawbench calibrate",
    )
    return BookEntry(
        kind="calibration",
        made_at=datetime.now(UTC),
        result=result,
        configured=configured,
        zero_std_raw=line.zero_std_raw,
        software=software_version(),
        details={"fit": _known(line_rows(line)), "points": [_known(plain(p)) for p in points]},
        **facts,
    )


def line_rows(line: StraightLine) -> dict[str, Any]:
    """Every number of the fit."""
    return {**plain(line), "zero_raw": line.zero_raw, "zero_std_raw": line.zero_std_raw}


def describe(points: list[CalibrationPoint], line: StraightLine, former: Calibration, channel: str, unit: str) -> str:
    """Points with residuals, then the line."""
    from sawbench.reporting.quantities import format_quantity

    raw_unit = former.raw_unit or "raw"
    rows = [
        [f"{p.reference:g}", f"{p.raw:.7g}", f"{p.raw_std:.2g}" if p.raw_std else "-", f"{r:+.3g}"]
        for p, r in zip(points, line.residuals, strict=True)
    ]
    # Points from a table that lie on a line to the last digit have no scatter to state an uncertainty from.
    zero_std = max(line.zero_std_raw, 1e-6 * max(abs(p.raw) for p in points))
    offset_std = max(line.offset_std, 1e-6 * max(abs(p.reference) for p in points))
    gain_std = max(line.gain_rel_std, 1e-6) * abs(line.gain)
    former_gain = former.slope_at(former.zero_raw)
    change = f"{line.gain / former_gain - 1.0:+.2%} relative to the previous one; " if former_gain else ""
    hysteresis = (
        "not determined (no loading and unloading)"
        if line.hysteresis is None
        else f"{line.hysteresis:.3%} of the range"
    )
    chi2 = (
        ""
        if line.chi2_per_degree is None
        else f"; scatter {line.chi2_per_degree**0.5:.2g} times the stated uncertainty"
    )
    return "\n".join(
        [
            table([f"load {unit}", raw_unit, "1 std", f"deviation {unit}"], rows),
            f"{channel}: gain {format_quantity(line.gain, gain_std, f'{unit}/({raw_unit})')}, "
            f"{change}zero at {format_quantity(line.zero_raw, zero_std, raw_unit)}",
            f"offset {format_quantity(line.offset, offset_std, unit)}, covariance with the gain "
            f"{line.covariance:.2g}{chi2}",
            f"nonlinearity {line.nonlinearity:.3%} of the range; hysteresis {hysteresis}",
        ]
    )


def _asked(channel: str, unit: str) -> Iterator[float]:
    """Ask for known values until an empty answer."""
    label = CHANNEL_BY_NAME[channel].label if channel in CHANNEL_BY_NAME else channel
    what = "load" if channel == FORCE.name else "value"
    while True:
        said = _ask(f"{label}: apply a known {what}, let it settle, and type it in {unit}; empty to end")
        if not said.strip():
            return
        try:
            value = float(said.replace(",", "."))
        except ValueError:
            value = math.nan
        if math.isfinite(value):
            yield value
        else:
            click.echo(f"{said!r} is not a number", err=True)


def _scaled(point: CalibrationPoint, factor: float) -> CalibrationPoint:
    return replace(point, reference=factor * point.reference, reference_std=factor * point.reference_std)


def _known(rows: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in rows.items() if value is not None}
