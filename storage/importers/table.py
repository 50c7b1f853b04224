"""What every importer ends in: columns over one time, checked, as signals with their gaps."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats, Gap, Signal
from sawbench.bench.units import CHANNEL_BY_NAME, TIME_COLUMN, Channel
from sawbench.storage.assembly import find_time_jumps
from sawbench.storage.importers.raw_table import data_row
from sawbench.storage.importers.unit_conversion import NAME_OF_STEM, stored_unit

# Slower than this no stroke of a jigsaw can be seen: the times are probably not in seconds.
_SLOWEST_INTERVAL_S: Final = 0.05
_LARGEST_SHARE_OUTSIDE: Final = 0.01
_OVERLOAD: Final = 1e30  # SCPI-99, 7.2.1.5, has 9.9e37 for infinity and 9.91e37 for no number, here in any unit
# Where that many samples of a channel have another number of rows between them, the rows are not its own.
_SHARE_OF_OWN_ROWS: Final = 0.02
# Likeness of a name that is written wrong to the right one; 'force_2_n' is another channel than 'force_n'.
_MISSPELT: Final = 0.9


class FramesNeedDbc(InputError):
    """The file holds CAN frames: `acquisition.can_logs` reads it with a DBC."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Table:
    """Columns that are taken for channels, in the units in which they are stored, before any check.

    Attributes
    ----------
    path : Path
    time_s : ndarray, shape (n,), s
    columns : mapping of str to ndarray, shape (n,)
        NaN where a cell is empty.
    units : mapping of str to str
        By column; absent where nobody said.
    place : callable
        Says where a row, counted from 0, stands in the file.
    """

    path: Path
    time_s: Floats
    columns: Mapping[str, Floats]
    units: Mapping[str, str] = field(default_factory=dict)
    place: Callable[[int], str] = data_row


def signals_of(
    table: Table, *, is_idle: bool = False, is_saw: bool = True, expected: Collection[str] = ()
) -> tuple[dict[str, Signal], list[str]]:
    """Check a table and turn its columns into signals.

    Values are taken as they are. What looks like another unit is a warning, as is an unknown or empty column.

    Parameters
    ----------
    table : Table
    is_idle : bool
        The blade ran in air: a force near zero is then no sign of another unit.
    is_saw : bool
        Values are compared with what a saw can produce; another machine has other forces and travels.
    expected : collection of str
        Channels that a map or the configuration asks for: they need not be known.

    Returns
    -------
    signals : dict of str to Signal
        Unknown columns keep their name and unit.
    warnings : list of str

    Raises
    ------
    InputError
        If the time has an empty cell, does not increase or is not finite, or if a value is infinite.
    """
    _check_time(table)
    jumps = find_time_jumps(table.time_s)
    signals: dict[str, Signal] = {}
    warnings = _time_warnings(table.time_s)
    for name, cells in table.columns.items():
        if np.isinf(cells).any():
            raise InputError(f"column {name} is infinite", where=_where(table, np.isinf(cells)))
        is_overload = np.abs(cells) >= _OVERLOAD
        warnings += _overload_warnings(name, is_overload, table)
        values = np.where(is_overload, np.nan, cells)
        if np.isnan(values).all():
            warnings.append(f"column {name} is empty and left out")
            continue
        channel = CHANNEL_BY_NAME.get(name)
        if channel is None:
            warnings += _unknown_column(name, is_asked_for=name in expected)
        unit = channel.unit if channel else table.units.get(name) or (stored_unit(name) if name in expected else "")
        signal = _signal(name, unit, table.time_s, values, jumps)
        if channel is not None and is_saw:
            warnings += _value_warnings(channel, signal.values, is_idle=is_idle)
        signals[name] = signal
        warnings += _end_warnings(signal, table.time_s)
    return signals, [*warnings, *_gap_warning(signals)]


def _gap_warning(signals: Mapping[str, Signal]) -> list[str]:
    """Say in one line what is missing: whole rows mostly, of channels that have as many samples or fewer."""
    channels: dict[str, list[str]] = {}
    for name, signal in signals.items():
        if signal.gaps:
            n_missing = sum(gap.n_missing for gap in signal.gaps)
            many = "gap" if len(signal.gaps) == 1 else "gaps"
            channels.setdefault(f"{n_missing} in {len(signal.gaps)} {many}", []).append(name)
    said = "; ".join(f"{missing} ({', '.join(names)})" for missing, names in channels.items())
    return [f"samples are missing: {said}"] if said else []


def _overload_warnings(name: str, is_overload: NDArray[np.bool_], table: Table) -> list[str]:
    if not is_overload.any():
        return []
    first = table.place(int(np.argmax(is_overload)))
    cells = f"{int(is_overload.sum())} cells beyond {_OVERLOAD:g}"
    return [f"{name}: {cells}, as instruments mark an overload, are taken as missing; the first is in {first}"]


def _end_warnings(signal: Signal, time_s: Floats) -> list[str]:
    """Say that a channel begins later than its table, or ends before: no gap is between two of its samples there."""
    usual_s = 1.5 * float(np.median(np.diff(signal.time_s))) if len(signal.time_s) > 1 else 0.0
    late_s, early_s = signal.time_s[0] - time_s[0], time_s[-1] - signal.time_s[-1]
    said = [f"begins {late_s:.3g} s after the table"] * int(late_s > usual_s)
    said += [f"ends {early_s:.3g} s before the table"] * int(early_s > usual_s)
    return [f"{signal.channel} {' and '.join(said)}: cells are empty"] if said else []


def _check_time(table: Table) -> None:
    time_s = table.time_s
    if not len(time_s):
        raise InputError("has no data rows", where=table.path)
    if not np.isfinite(time_s).all():
        raise InputError(
            f"{TIME_COLUMN} is empty or not a finite number",
            where=_where(table, ~np.isfinite(time_s)),
            remedy="remove the row",
        )
    step = np.diff(time_s)
    if len(step) and step.min() <= 0:
        row = int(np.flatnonzero(step <= 0)[0]) + 1
        is_repeated = step.min() == 0
        raise InputError(
            f"{TIME_COLUMN} does not increase: {time_s[row - 1]:.9g} s is followed by {time_s[row]:.9g} s",
            where=f"{table.path}, {table.place(row)}",
            remedy="drop the repeated rows, or have them dropped by a map (--map): [table] repeated_times = 'drop'"
            if is_repeated
            else "sort the rows by time, or import the parts before and after as trials of their own",
        )


def _where(table: Table, is_wrong: NDArray[np.bool_]) -> str:
    """Return the first row that is wrong, for an error."""
    return f"{table.path}, {table.place(int(np.argmax(is_wrong)))}"


def _signal(name: str, unit: str, time_s: Floats, values: Floats, jumps: NDArray[np.int64]) -> Signal:
    """Return the filled cells of a column; where cells or rows are missing between them is a gap."""
    rows = np.flatnonzero(~np.isnan(values))
    kept_s = time_s[rows]
    gaps: list[Gap] = []
    if len(rows) > 1:
        # A slower channel fills every n-th row: a gap is where it fills none. Instruments with clocks of their own fill
        # rows of their own, as many as there are between two of another: there the times tell.
        steps = np.diff(rows)
        stride, period_s = float(np.median(steps)), float(np.median(np.diff(kept_s)))
        if np.mean(steps != stride) > _SHARE_OF_OWN_ROWS:
            empty = find_time_jumps(kept_s) - 1
        else:
            empty = np.flatnonzero(np.rint(steps / stride) > 1)
        # A jump of the time belongs to the interval between the filled rows around it.
        jumped = np.searchsorted(rows, jumps, side="left") - 1
        jumped = jumped[(jumped >= 0) & (jumped < len(steps))]
        for k in np.union1d(empty, jumped).tolist():
            n_missing = round(float(kept_s[k + 1] - kept_s[k]) / period_s) - 1
            reason = "the time jumps" if k in jumped else "empty cells"
            if n_missing > 0:
                gap = Gap(start_s=float(kept_s[k]), end_s=float(kept_s[k + 1]), n_missing=n_missing, reason=reason)
                gaps.append(gap)
    return Signal(channel=name, unit=unit, time_s=kept_s, values=values[rows], gaps=tuple(gaps))


def _unknown_column(name: str, *, is_asked_for: bool) -> list[str]:
    """Say so of a name that nobody asked for, and of one that a map or configuration has nearly right."""
    close = difflib.get_close_matches(name.lower(), CHANNEL_BY_NAME, n=1, cutoff=_MISSPELT if is_asked_for else 0.6)
    of_stem = NAME_OF_STEM.get(name.lower())
    close = close or [known for known in (of_stem,) if known in CHANNEL_BY_NAME]
    if is_asked_for and not close:
        return []
    hint = f"; did you mean {close[0]!r}?" if close else ""
    return [f"column {name} is not a known channel; it is kept under its own name{hint}"]


def _time_warnings(time_s: Floats) -> list[str]:
    if len(time_s) < 3:
        return []
    interval_s = float(np.median(np.diff(time_s)))
    if interval_s < _SLOWEST_INTERVAL_S:
        return []
    return [
        f"{TIME_COLUMN} increases by {interval_s:.4g} per sample: in seconds this is too slow to resolve a "
        'stroke; if it is in milliseconds, state it in a map: time_s = { column = ..., unit = "ms" }'
    ]


def _value_warnings(channel: Channel, values: Floats, *, is_idle: bool) -> list[str]:
    lowest, highest = channel.plausible
    warnings = []
    n_outside = int(np.sum((values < lowest) | (values > highest)))
    if n_outside:
        is_many = n_outside > _LARGEST_SHARE_OUTSIDE * len(values)
        share = f"{100 * n_outside / len(values):.0f} %" if is_many else f"{n_outside} of {len(values)}"
        check = "check the unit and the channel" if is_many else "an overload, or a damaged sample"
        warnings.append(
            f"{channel.name}: {share} of the values are outside {lowest:g} to {highest:g} "
            f"{channel.unit} (largest {np.abs(values).max():.4g}); {check}"
        )
    largest = float(np.abs(values).max())
    if channel.name == "force_n" and 0.0 < largest < 1.0 and not is_idle:
        warnings.append(f"force_n never exceeds {largest:.3g} N; if it is in kN, state it in a map (--map)")
    stroke = float(np.ptp(values))
    if channel.name == "displacement_mm" and 1e-3 < stroke < 0.5:
        warnings.append(f"displacement_mm moves by only {stroke:.3g} mm; if it is in metres, state it in a map (--map)")
    return warnings
