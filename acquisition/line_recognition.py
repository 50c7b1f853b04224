"""What an instrument that prints lines by itself can be, from what it sent in a second or two."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from sawbench.acquisition.devices.lines import LABELLED_NUMBER, LineFormat

_FEWEST_LINES: Final = 5
# Share of the lines that must be read alike; the first one may be cut.
_LEAST_SHARE: Final = 0.9
_SEPARATORS: Final = (";", ",", "\t", None)
_MOST_COLUMNS: Final = 32
# Codes of the HX711 have 24 bits; its pin RATE gives 10 or 80 of them a second, by an oscillator good to a tenth.
_HX711_CODES: Final = 1 << 23
_HX711_RATES_HZ: Final = (10.0, 80.0)
_HX711_OSCILLATOR: Final = 0.15


@dataclass(frozen=True, kw_only=True, slots=True)
class RecognisedLines:
    """An instrument that prints lines.

    Attributes
    ----------
    driver : str
        "edge_times", "hx711" or "text_lines".
    settings : mapping of str to Any
        Of its `[devices.NAME]` table, without port and channels.
    column : int
        Of the first value, from 1.
    about : str
        What was seen.
    """

    driver: str
    settings: Mapping[str, Any]
    column: int
    about: str


def recognise_lines(received: bytes, seconds: float) -> RecognisedLines | None:
    r"""Tell the driver from received lines; None where they are no lines of numbers.

    Parameters
    ----------
    received : bytes
        Everything that came in `seconds`.
    seconds : float

    Notes
    -----
    One whole number a line that only grows is a time stamp; one within 24 bits at 10 or 80 a second an HX711; anything
    else is described as `text_lines`, with a column that counts in steps of 1 as its counter. A label in front of the
    only number ends in a colon.

    Examples
    --------
    >>> found = recognise_lines(b"".join(b"%d;0;%.3f\r\n" % (k, 0.1 * k) for k in range(100)), 1.0)
    >>> found.driver, dict(found.settings), found.column
    ('text_lines', {'rate_hz': 99.0, 'separator': ';', 'counter_column': 1}, 2)
    """
    lines = [line.decode("ascii", "replace").strip() for line in received.split(b"\n")[1:-1]]
    lines = [line for line in lines if line]
    if len(lines) < _FEWEST_LINES:
        return None
    rate_hz = float(f"{len(lines) / seconds:.3g}")
    labelled = _numbers(lines, LineFormat(columns=(1,), pattern=LABELLED_NUMBER))
    has_one = labelled is not None and not any(separator in line for line in lines for separator in ";,\t")
    if labelled is not None and has_one and all(len(line.rpartition(":")[2].split()) <= 2 for line in lines):
        return _one_number(labelled[:, 0], rate_hz)
    for separator in _SEPARATORS:
        n_columns = len(lines[-1].split(separator))
        if not 1 < n_columns <= _MOST_COLUMNS:
            continue
        numbers = _numbers(lines, LineFormat(columns=tuple(range(1, n_columns + 1)), separator=separator))
        if numbers is not None:
            return _columns(numbers, separator, rate_hz)
    return None


def _numbers(lines: list[str], line_format: LineFormat) -> np.ndarray | None:
    """Numbers of the lines that can be read, shape (n, n_columns); None where too few can."""
    rows = [row for row in map(line_format.numbers, lines) if row is not None]
    return np.array(rows) if len(rows) >= _LEAST_SHARE * len(lines) else None


def _one_number(values: np.ndarray, rate_hz: float) -> RecognisedLines:
    is_whole = bool(np.all(values == np.round(values)))
    if is_whole and np.all(np.diff(values) > 0) and float(np.ptp(values)) > 10 * len(values):
        about = f"lines with a whole number that only grows, about {rate_hz:g} a second: time stamps"
        return RecognisedLines(driver="edge_times", settings={}, column=1, about=about)
    for usual_hz in _HX711_RATES_HZ:
        if is_whole and np.abs(values).max() < _HX711_CODES and abs(rate_hz / usual_hz - 1.0) < _HX711_OSCILLATOR:
            about = f"lines with a whole number within 24 bits, {usual_hz:g} a second"
            return RecognisedLines(driver="hx711", settings={"rate_hz": usual_hz}, column=1, about=about)
    about = f"lines with a number, about {rate_hz:g} a second"
    settings = {"rate_hz": rate_hz, "pattern": LABELLED_NUMBER.pattern}
    return RecognisedLines(driver="text_lines", settings=settings, column=1, about=about)


def _columns(numbers: np.ndarray, separator: str | None, rate_hz: float) -> RecognisedLines:
    steps = np.diff(numbers, axis=0)
    # Where the counter restarts, one step is another.
    counts = np.flatnonzero(np.mean(steps == 1.0, axis=0) > _LEAST_SHARE)
    settings: dict[str, Any] = {"rate_hz": rate_hz}
    settings |= {} if separator is None else {"separator": separator}
    settings |= {"counter_column": int(counts[0]) + 1} if len(counts) else {}
    others = [k for k in range(numbers.shape[1]) if not len(counts) or k != counts[0]]
    about = f"lines of {numbers.shape[1]} numbers, about {rate_hz:g} a second"
    return RecognisedLines(driver="text_lines", settings=settings, column=others[0] + 1, about=about)
