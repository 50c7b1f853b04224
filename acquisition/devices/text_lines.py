"""Any instrument that sends lines of text: columns, commands and timing stand in the configuration alone."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from typing import Final, Literal

from pydantic import Field, field_validator, model_validator
from sawbench.acquisition.devices.device import inputs_within
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.devices.lines import LineFormat, LineFramer
from sawbench.acquisition.devices.row_emulator import RowEmulator, described
from sawbench.acquisition.devices.row_instrument import RowInstrument, RowProtocol, columns_of
from sawbench.acquisition.devices.sample_rows import RowTiming
from sawbench.acquisition.devices.serial_instrument import SerialTable
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.simulation.sensor import EmulatedSensor
from sawbench.bench.errors import ConfigError

_MOST_COLUMNS: Final = 64


class TextLinesSettings(SerialTable):
    r"""`[devices.NAME]` with `driver = "text_lines"`.

    Exactly one of `rate_hz`, `time_column` and `question` tells the time of the samples.

    Attributes
    ----------
    channels : mapping of Channel to ChannelTable
        Bench channel -> column of the line (from 1) as `input`, calibration, raw range.
    rate_hz : float
        Lines per second, where the instrument samples at a constant rate.
    time_column : int, optional
        Column with the instrument's own time stamp.
    tick_s : float
        Step of the time stamp, s.
    time_bits : int, optional
        After which the time stamp begins at 0 again: 32 for micros() and millis() of an Arduino.
    counter_column : int, optional
        Column that counts the lines, so that lost ones are known; needs `rate_hz`.
    counter_bits : int
        After which the counter begins at 0 again.
    question : str
        Sent for each line, where the instrument answers only.
    start, stop : str
        Begin and end the transmission. An instrument that always sends has no `stop`.
    separator : str, optional
        Between columns; any white space where it is not given.
    pattern : str, optional
        Regular expression whose groups are the columns, in place of a separator.
    decimal : {".", ","}
        Decimal sign.
    line_end : str
        At the end of a line; "\n" does for "\r\n" too.
    """

    driver: str = "text_lines"
    rate_hz: float = Field(default=0.0, ge=0, le=20_000)
    time_column: int | None = Field(default=None, ge=1, le=_MOST_COLUMNS)
    tick_s: float = Field(default=1e-6, gt=0, le=1)
    time_bits: int | None = Field(default=None, ge=8, le=53)
    counter_column: int | None = Field(default=None, ge=1, le=_MOST_COLUMNS)
    counter_bits: int = Field(default=16, ge=4, le=53)
    question: str = ""
    start: str = ""
    stop: str = ""
    separator: str | None = Field(default=None, min_length=1)
    pattern: str | None = None
    decimal: Literal[".", ","] = "."
    line_end: str = Field(default="\n", min_length=1)

    @field_validator("pattern")
    @classmethod
    def _pattern_is_one(cls, pattern: str | None) -> str | None:
        try:
            n_groups = 1 if pattern is None else re.compile(pattern).groups
        except re.error as error:
            raise ValueError(f"is not a regular expression: {error}") from error
        if not n_groups:
            raise ValueError("has no group: put the numbers in parentheses")
        return pattern

    @model_validator(mode="after")
    def _fits_together(self) -> TextLinesSettings:
        inputs_within(self.channels, _MOST_COLUMNS, "columns")
        told_by = [bool(self.rate_hz), self.time_column is not None, bool(self.question)]
        if sum(told_by) != 1:
            raise ValueError(
                "give exactly one of rate_hz, time_column and question: it defines the time of the samples"
            )
        if self.counter_column is not None and not self.rate_hz:
            raise ValueError("counter_column needs rate_hz")
        if self.stop and not self.start:
            raise ValueError("stop needs start: a stopped instrument has to be started again")
        if self.separator == self.decimal == ",":
            raise ValueError('separator "," and decimal "," cannot be told apart: set another separator, or a pattern')
        if self.pattern is not None:
            n_groups = re.compile(self.pattern).groups
            if max(self.line_format.columns) > n_groups:
                raise ValueError(
                    f"pattern has {n_groups} groups, but group {max(self.line_format.columns)} is configured"
                )
            if self.separator is not None:
                raise ValueError("give either pattern or separator, not both")
        return self

    @property
    def line_format(self) -> LineFormat:
        """Where the numbers are."""
        behind = self.time_column if self.time_column is not None else self.counter_column
        return LineFormat(
            columns=columns_of([table.input for table in self.channels.values()], behind),
            separator=self.separator,
            pattern=None if self.pattern is None else re.compile(self.pattern),
            line_end=self.line_end,
            has_decimal_comma=self.decimal == ",",
        )

    @property
    def protocol(self) -> RowProtocol:
        """What is sent and received."""
        has_stamp, has_counter = self.time_column is not None, self.counter_column is not None
        return RowProtocol(
            new_framer=lambda is_begun: LineFramer(self.line_format, is_begun=is_begun),
            timing=RowTiming(
                rate_hz=self.rate_hz,
                tick_s=self.tick_s if has_stamp else None,
                tick_bits=self.time_bits if has_stamp else None,
                counter_bits=self.counter_bits if has_counter else None,
            ),
            question=self.question.encode(),
            start=self.start.encode(),
            stop=self.stop.encode(),
        )


class TextLines(RowInstrument[TextLinesSettings]):
    """One instrument; see `RowInstrument`."""

    MODEL = "text lines"
    STREAM = "lines"

    def __init__(self, name: str, settings: TextLinesSettings, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(name, settings, settings.protocol, clock=clock)


def emulate(name: str, settings: TextLinesSettings, plant: PlantStream, clock_error_ppm: float) -> RowEmulator:
    """Build the instrument of one validated table, seen from the other side.

    Raises
    ------
    ConfigError
        If its lines are described by a regular expression.
    """
    if settings.pattern is not None:
        raise ConfigError(
            "an instrument with `pattern` cannot be emulated", where=f"[devices.{name}]", remedy="use separator"
        )
    sensors = tuple(EmulatedSensor.of(channel, table) for channel, table in settings.channels.items())
    columns = max(settings.line_format.columns)

    def render(readings: Sequence[float], index: int, time_s: float) -> bytes:
        cells = ["0"] * columns
        for sensor, reading in zip(sensors, readings, strict=True):
            cells[sensor.input - 1] = f"{reading:.9g}".replace(".", settings.decimal)
        if settings.counter_column is not None:
            cells[settings.counter_column - 1] = str(index % (1 << settings.counter_bits))
        if settings.time_column is not None:
            ticks = round(time_s / settings.tick_s)
            cells[settings.time_column - 1] = str(ticks % (1 << (settings.time_bits or 53)))
        return ((settings.separator or " ").join(cells) + settings.line_end).encode()

    return described(settings, plant, sensors, render=render, as_sent=str.encode, clock_error_ppm=clock_error_ppm)


INSTRUMENT: Final = Instrument(
    settings=TextLinesSettings,
    make=TextLines,
    emulate=emulate,
    example={
        "rate_hz": 500.0,
        "separator": ";",
        "counter_column": 1,
        "start": "START\n",
        "stop": "STOP\n",
        "channels": {"force_n": {"input": 3, "raw_range": [-3.5, 3.5], "calibration": {"scale": 250.0}}},
    },
    is_searched=False,
)
