"""What the processing found, as HDF5 and as one row of a table."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from sawbench.bench.errors import InputError
from sawbench.bench.folded import FoldedCycle
from sawbench.bench.processed import (
    ChannelQuality,
    CrankAngle,
    Cut,
    PeriodCandidate,
    PeriodEstimate,
    Phase,
    ProcessedTrial,
    RemovedForce,
    SteadyPart,
    StrokeOffset,
)
from sawbench.bench.units import CHANNEL_BY_NAME, CHANNELS
from sawbench.storage.codec import trial_from_metadata, trial_to_metadata
from sawbench.storage.output import folder_held, write_whole
from sawbench.storage.places import Place, find_file, read_bytes

_FORMAT: Final = "sawbench processed trial"
_FORMAT_VERSION: Final = 1
_ANGLE_UNITS: Final = {
    "time_s": "s",
    "angle_rad": "rad",
    "speed_rad_s": "rad/s",
    "angle_std_rad": "rad",
    "ripple_std_rad": "rad",
}
_ANGLE_NUMBERS: Final = ("radius_m", "source", "is_absolute", "rod_length_m")
Attributes = Mapping[str, Any]


def write_processed(processed: ProcessedTrial, path: str | Place, overwrite: bool = False, *, key: str = "") -> Place:
    """Write a processed trial to HDF5.

    Every dataset carries its unit in the attribute `unit`; numbers that are no arrays are attributes whose
    name ends in the unit.

    Parameters
    ----------
    processed : ProcessedTrial
    path : str or Path
    overwrite : bool
    key : str
        Of everything that the result depends on; `key_of_processed` returns it.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the file exists and `overwrite` is False, or cannot be written.
    """
    import h5py

    content = io.BytesIO()
    with h5py.File(content, "w") as store:
        store.attrs["format"] = _FORMAT
        store.attrs["format_version"] = _FORMAT_VERSION
        store.attrs["key"] = key
        _put(store.create_group("trial"), trial_to_metadata(processed.trial))
        for name in ("status", "peak_force_n", "peak_force_std_n", "source_path", "source_sha256", "frame"):
            _put(store, {name: getattr(processed, name)})
        store.attrs["warnings"] = list(processed.warnings)
        _put_period(store, processed.period)
        _put_angle(store, processed.angle)
        _put_rows(store.create_group("phases"), processed.phases, ("kind", "start_s", "end_s"))
        if processed.steady is not None:
            steady = processed.steady
            _put_rows(store.create_group("steady"), (steady,), [name for name in SteadyPart.__slots__ if name != "cut"])
            if steady.cut is not None:
                _put_rows(store.create_group("cut"), (steady.cut,), Cut.__slots__)
        for folded in processed.folded.values():
            _put_folded(store.require_group("folded").create_group(folded.channel), folded)
        if processed.cutting_force is not None:
            _put_folded(store.create_group("cutting_force"), processed.cutting_force)
        if processed.removed is not None:
            _put_rows(store.create_group("removed"), (processed.removed,), RemovedForce.__slots__)
        for name in ("mean_values", "rms_values"):
            _put(store.create_group(name), getattr(processed, name))
        _put_rows(store.create_group("quality"), processed.quality, ChannelQuality.__slots__)
        _put_rows(store.create_group("offsets"), processed.offsets, StrokeOffset.__slots__)
    return write_whole(path, content.getvalue(), overwrite=overwrite, makes_folder=True)


def _put(group: Any, pairs: Attributes) -> None:
    """Write attributes; None is left out."""
    for name, value in pairs.items():
        if value is not None:
            group.attrs[name] = value


def _put_rows(group: Any, rows: tuple[Any, ...], names: Iterable[str]) -> None:
    """Write each row as a numbered group of attributes."""
    for number, row in enumerate(rows):
        found = {name: getattr(row, name) for name in names}
        lists = {name: list(value) if isinstance(value, tuple) else value for name, value in found.items()}
        _put(group.create_group(f"{number:04d}"), lists)


def _put_period(store: Any, period: PeriodEstimate | None) -> None:
    if period is None:
        return
    group = store.create_group("period")
    names = [name for name in PeriodEstimate.__slots__ if name != "rivals"]
    _put(group, {name: getattr(period, name) for name in names})
    _put_rows(group, period.rivals, PeriodCandidate.__slots__)


def _put_angle(store: Any, angle: CrankAngle | None) -> None:
    if angle is None:
        return
    group = store.create_group("angle")
    _put(group, {name: getattr(angle, name) for name in _ANGLE_NUMBERS})
    for name, unit in _ANGLE_UNITS.items():
        if len(getattr(angle, name)):
            _put_array(group, name, getattr(angle, name), unit)


def _put_folded(group: Any, folded: FoldedCycle) -> None:
    _put(group, {"channel": folded.channel, "unit": folded.unit, "n_cycles": folded.n_cycles})
    units = {"angle_rad": "rad", "mean": folded.unit, "std": folded.unit, "count": ""}
    for name, unit in units.items():
        _put_array(group, name, getattr(folded, name), unit)


def _put_array(group: Any, name: str, values: Any, unit: str) -> None:
    group.create_dataset(name, data=values, compression="gzip", shuffle=True).attrs["unit"] = unit


def key_of_processed(path: Path) -> str:
    """Return the key that `write_processed` was given; empty where there is none, or no processed trial."""
    import h5py

    try:
        with h5py.File(path, "r") as store:
            return str(store.attrs.get("key", ""))
    except OSError:
        return ""


def read_processed(path: str | Path) -> ProcessedTrial:
    """Read what `write_processed` wrote.

    Raises
    ------
    InputError
        If the file is missing, is not HDF5, or is not a processed trial of this version.
    """
    import h5py

    path = Path(path)
    if not path.exists():
        raise InputError("no such file", where=path, remedy="create it with `sawbench process`")
    try:
        with h5py.File(path, "r") as store:
            if store.attrs.get("format") != _FORMAT or _python(store.attrs)["format_version"] > _FORMAT_VERSION:
                raise InputError(
                    "is HDF5, but not a processed trial of a supported version",
                    where=path,
                    remedy="create it with `sawbench process`",
                )
            return _read_trial(store)
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"is not a processed trial, or is damaged: {error}", where=path) from error


def _read_trial(store: Any) -> ProcessedTrial:
    attributes = _python(store.attrs)
    folded = [_get_folded(group) for group in store["folded"].values()] if "folded" in store else []
    order = {name: position for position, name in enumerate(CHANNEL_BY_NAME)}
    folded.sort(key=lambda cycle: order.get(cycle.channel, len(order)))
    removed = _get_rows(store["removed"], RemovedForce) if "removed" in store else ()
    steady = _get_rows(store["steady"], SteadyPart) if "steady" in store else ()
    cut = _get_rows(store["cut"], Cut)[0] if "cut" in store else None
    return ProcessedTrial(
        trial=trial_from_metadata(_python(store["trial"].attrs)),
        status=attributes["status"],
        period=_get_period(store),
        angle=_get_angle(store),
        phases=_get_rows(store["phases"], Phase),
        folded={cycle.channel: cycle for cycle in folded},
        cutting_force=_get_folded(store["cutting_force"]) if "cutting_force" in store else None,
        removed=removed[0] if removed else None,
        steady=replace(steady[0], cut=cut) if steady else None,
        peak_force_n=attributes.get("peak_force_n"),
        peak_force_std_n=attributes.get("peak_force_std_n"),
        mean_values=_python(store["mean_values"].attrs),
        rms_values=_python(store["rms_values"].attrs),
        quality=_get_rows(store["quality"], ChannelQuality),
        offsets=_get_rows(store["offsets"], StrokeOffset) if "offsets" in store else (),
        warnings=tuple(attributes["warnings"]),
        source_path=attributes["source_path"],
        source_sha256=attributes["source_sha256"],
        frame=attributes.get("frame", "crank"),
    )


def _python(attributes: Attributes) -> dict[str, Any]:
    """Return attributes as plain numbers, texts and tuples."""
    return {name: _plain(value) for name, value in attributes.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return tuple(value.tolist())
    return value.item() if isinstance(value, np.generic) else value


def _get_rows(group: Any, kind: type[Any]) -> tuple[Any, ...]:
    return tuple(kind(**_python(entry.attrs)) for _, entry in sorted(group.items()))


def _get_period(store: Any) -> PeriodEstimate | None:
    if "period" not in store:
        return None
    group = store["period"]
    return PeriodEstimate(**_python(group.attrs), rivals=_get_rows(group, PeriodCandidate))


def _get_angle(store: Any) -> CrankAngle | None:
    if "angle" not in store:
        return None
    group = store["angle"]
    return CrankAngle(**_python(group.attrs), **{name: group[name][()] for name in _ANGLE_UNITS if name in group})


def _get_folded(group: Any) -> FoldedCycle:
    arrays = {name: group[name][()] for name in ("angle_rad", "mean", "std", "count")}
    return FoldedCycle(**_python(group.attrs), **arrays)


def summary_row(processed: ProcessedTrial) -> dict[str, str | float | int | None]:
    """Return one line about a trial; None where something was not found.

    Returns
    -------
    dict
        Column name, ending in its unit, to value. Every trial has the same columns.
    """
    trial, period, removed = processed.trial, processed.period, processed.removed
    row: dict[str, str | float | int | None] = {
        "trial_id": trial.trial_id,
        "material": trial.material,
        "duty": trial.duty,
        "thickness_mm": trial.thickness_mm,
        "feed_mm_s": trial.feed_mm_s,
        "blade": trial.blade,
        "battery": trial.battery,
        "repetition": trial.repetition,
        "started_at": trial.started_at.isoformat() if trial.started_at else None,
        "status": processed.status,
        "stroke_period_s": period.period_s if period else None,
        "stroke_period_std_s": period.period_std_s if period else None,
        "stroke_rate_hz": period.rate_hz if period else None,
        "n_cycles": period.n_cycles if period else None,
        "confidence": period.confidence if period else None,
        "peak_force_n": processed.peak_force_n,
        "peak_force_std_n": processed.peak_force_std_n,
        "removed_mean_n": removed.mean_n if removed else None,
        "removed_share_of_impulse": removed.share_of_impulse if removed else None,
    }
    for kind, values in (("mean", processed.mean_values), ("rms", processed.rms_values)):
        row |= {f"{kind}_{channel.name}": values.get(channel.name) for channel in CHANNELS}
    row["n_missing"] = sum(quality.n_missing for quality in processed.quality)
    row["warnings"] = "; ".join(processed.warnings)
    row["source_path"] = processed.source_path
    row["source_sha256"] = processed.source_sha256
    return row


def append_summary_rows(trials: Iterable[ProcessedTrial], path: Place) -> Place:
    """Add a line about each trial to a CSV table; a line with the same `source_path` is replaced.

    The table is written whole under another name and then renamed: a reader never sees half of it.

    Parameters
    ----------
    trials : iterable of ProcessedTrial
    path : Path or StoreFile
        Made with its header if missing.

    Returns
    -------
    Path or StoreFile

    Raises
    ------
    InputError
        If the file has other columns: it is another table.
    """
    added = [
        {name: "" if value is None else str(value) for name, value in summary_row(trial).items()} for trial in trials
    ]
    if not added:
        return path
    with folder_held(path) if isinstance(path, Path) else nullcontext():
        return _with_rows(path, added)


def _with_rows(path: Place, added: list[dict[str, str]]) -> Place:
    columns, replaced = list(added[0]), {row["source_path"] for row in added}
    rows: list[dict[str, str]] = []
    if find_file(path) is not None:
        reader = csv.DictReader(io.StringIO(read_bytes(path).decode(), newline=""))
        if list(reader.fieldnames or ()) != columns:
            raise InputError(
                "has other columns than the summary of `sawbench process`",
                where=path,
                remedy="move the file to another folder, or give another folder with --out",
            )
        rows = [other for other in reader if other["source_path"] not in replaced]
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, fieldnames=columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows([*rows, *added])
    return write_whole(path, text.getvalue(), overwrite=True, makes_folder=True)
