"""CANopen transmitters of the device profile CiA 404, through the package `canopen`.

The node is asked by SDO which transmit PDO holds its process values (6130h real, 7130h 16 bit, 8130h 24 bit, 9130h
32 bit) and how many decimal digits they have (6132h), is told its period (event timer, 18xxh sub-index 5), and then
sends by itself. Sources: CiA 301; manuals of Baumer DSRT 22DJ and esd CAN-CBX-THERMO, device profile sections.
"""

from __future__ import annotations

import logging
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator
from sawbench.acquisition.devices.can_instrument import CanInstrument, CanTable, require_slcan
from sawbench.acquisition.devices.cia404_emulator import Cia404Emulator
from sawbench.acquisition.devices.device import BenchChannel, ChannelTable, Chunk, Stream, inputs_within
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.devices.optional_package import import_optional
from sawbench.acquisition.simulation.plant_stream import PlantStream
from sawbench.acquisition.simulation.sensor import EmulatedSensor
from sawbench.acquisition.transports.can_batch import CanBatch, ParsedFrame
from sawbench.acquisition.transports.can_bus import CanSource
from sawbench.bench.errors import DeviceError

# Process values -> type of number.
PROCESS_VALUES: Final = MappingProxyType({0x6130: "real", 0x7130: "integer", 0x8130: "integer", 0x9130: "integer"})
_PROFILE: Final = 404
_N_PDO: Final = 4
_PDO_IS_OFF: Final = 1 << 31
_CYCLIC: Final = 0xFF
_ANSWER_WAIT_S: Final = 0.3
_START, _STOP, _PRE_OPERATIONAL = 0x01, 0x02, 0x80


class Cia404Settings(CanTable):
    """`[devices.NAME]` with `driver = "cia404"`.

    Attributes
    ----------
    bitrate : int
        Of the bus, bit/s; 125000 as most nodes are delivered.
    node : int
        Of the transmitter, 1 to 127.
    channels : mapping of Channel to ChannelTable
        Bench channel -> channel of the transmitter (sub-index, from 1); raw values are in its physical unit.
    rate_hz : float
        Process values per second: 1000 divided by a whole number of milliseconds.
    serial_number : str, optional
        Of the transmitter (1018h); another one is refused.
    """

    HAS_OWN_NUMBER = True

    driver: str = "cia404"
    bitrate: int = Field(default=125_000, gt=0)
    node: int = Field(default=1, ge=1, le=127)
    channels: dict[BenchChannel, ChannelTable] = Field(min_length=1)
    rate_hz: float = Field(default=100.0, gt=0, le=1000)

    @field_validator("rate_hz")
    @classmethod
    def _is_whole_milliseconds(cls, rate_hz: float) -> float:
        period_ms = 1000.0 / rate_hz
        if abs(period_ms - round(period_ms)) > 1e-3 * period_ms:
            raise ValueError(f"the period has to be a whole number of milliseconds, it is {period_ms:g}")
        return rate_hz

    @model_validator(mode="after")
    def _inputs_exist(self) -> Cia404Settings:
        inputs_within(self.channels, 199)
        return self


@dataclass(frozen=True, kw_only=True, slots=True)
class PdoValue:
    """Where one process value is in its PDO.

    Attributes
    ----------
    first_byte, n_bytes : int
    is_real : bool
    digits : int
        Decimal digits of an integer.
    """

    first_byte: int
    n_bytes: int
    is_real: bool
    digits: int

    def read(self, payload: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Return the values of frames, shape (n,); `payload` has shape (n, 8)."""
        cells = np.ascontiguousarray(payload[:, self.first_byte : self.first_byte + self.n_bytes])
        if self.is_real:
            return cells.view("<f4")[:, 0].astype(np.float64)
        weights = 256 ** np.arange(self.n_bytes, dtype=np.int64)
        codes = cells.astype(np.int64) @ weights
        half = 1 << (8 * self.n_bytes - 1)
        return ((codes + half) % (2 * half) - half) / 10.0**self.digits


class Cia404(CanInstrument[Cia404Settings]):
    """One transmitter; see `CanInstrument`."""

    MODEL = "CiA 404"
    STREAM = "process_values"

    def __init__(self, name: str, settings: Cia404Settings, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(name, settings, clock=clock)
        self._node: Any = None  # canopen.RemoteNode; the package is imported when a node is opened
        self._cob_id = -1
        self._values: tuple[PdoValue, ...] = ()
        self._facts: dict[str, str] = {}

    @property
    def streams(self) -> tuple[Stream, ...]:
        """One stream: all configured channels, which come in one PDO."""
        return self._one_stream(self._settings.channels, self._settings.rate_hz)

    def open(self) -> None:
        """Identify the node, find its process values, set its period; see `Device.open`."""
        canopen = import_optional("canopen", extra="canopen", where=f"[devices.{self.name}]")
        # What it would print of a transfer that failed is said by the errors below.
        logging.getLogger("canopen").setLevel(logging.CRITICAL)
        self._bus.open()
        network = canopen.Network(_SdoBus(self._bus, self._settings.node, clock=self._clock))
        network.bus.network = network
        self._node = network.add_node(canopen.RemoteNode(self._settings.node, canopen.ObjectDictionary()))
        self._node.nmt.send_command(_PRE_OPERATIONAL)
        profile = self._ask(0x1000, 0) & 0xFFFF
        if profile != _PROFILE:
            raise self._error(f"the node has device profile {profile}, not {_PROFILE}", "check `node`")
        number = str(self._ask(0x1018, 4, or_else=0) or "")
        self._require_number(number)
        pdo = self._find_values()
        self._set_period(pdo)
        self._facts = {"serial_number": number} if number else {}

    def start(self) -> None:
        """Let the node send."""
        self._node.nmt.send_command(_START)

    def decode(self, batch: CanBatch) -> list[Chunk]:
        """Turn frames into chunks; no input or output."""
        n_bytes = max((value.first_byte + value.n_bytes for value in self._values), default=0)
        is_ours = (batch.identifier == np.uint32(self._cob_id)) & (batch.length >= n_bytes)
        if not self._values or not is_ours.any():
            return []
        payload = batch.payload[is_ours]
        raw = np.stack([value.read(payload) for value in self._values], axis=1)
        return [Chunk(stream=self.STREAM, raw=raw, arrival_s=batch.arrival_s[is_ours])]

    def stop(self) -> None:
        """Let the node stop sending, and leave the bus."""
        try:
            if self._node is not None:
                self._node.nmt.send_command(_STOP)
        except DeviceError:
            # Unplugged: nothing is left to be told to stop.
            pass
        finally:
            self._node = None
            super().stop()

    def describe(self) -> dict[str, str]:
        """Node, rate, where its times come from."""
        return {
            "model": self.MODEL,
            "node": str(self._settings.node),
            "rate_hz": f"{self._settings.rate_hz:g}",
            "time_source": self._bus.time_source,
            **self._facts,
        }

    def _find_values(self) -> int:
        """Find the PDO that holds all configured channels; return its place, from 0."""
        wanted = [table.input for table in self._settings.channels.values()]
        for pdo in range(_N_PDO):
            cob_id = self._ask(0x1800 + pdo, 1, or_else=_PDO_IS_OFF)
            mapped = {} if cob_id & _PDO_IS_OFF else self._mapping(pdo)
            if all(channel in mapped for channel in wanted):
                self._cob_id = cob_id & 0x7FF
                self._values = tuple(mapped[channel] for channel in wanted)
                return pdo
        raise self._error(
            f"no transmit PDO of the node contains the process values of its channels {', '.join(map(str, wanted))}",
            "map them (6130h, 7130h, 8130h or 9130h) into one PDO with the maker's program, or correct `input`",
        )

    def _mapping(self, pdo: int) -> dict[int, PdoValue]:
        values: dict[int, PdoValue] = {}
        first_byte = 0
        for entry in range(1, self._ask(0x1A00 + pdo, 0, or_else=0) + 1):
            mapped = self._ask(0x1A00 + pdo, entry)
            index, channel, n_bytes = mapped >> 16, mapped >> 8 & 0xFF, (mapped & 0xFF) // 8
            if index in PROCESS_VALUES:
                is_real = PROCESS_VALUES[index] == "real"
                digits = 0 if is_real else self._ask(0x6132, channel, or_else=0)
                values[channel] = PdoValue(first_byte=first_byte, n_bytes=n_bytes, is_real=is_real, digits=digits)
            first_byte += n_bytes
        return values

    def _set_period(self, pdo: int) -> None:
        """Set transmission type and event timer; a node without them keeps its own, which the rate will show."""
        from canopen import SdoAbortedError

        period_ms = round(1000.0 / self._settings.rate_hz)
        for sub_index, value in ((2, bytes([_CYCLIC])), (5, struct.pack("<H", period_ms))):
            try:
                self._sdo(lambda s=sub_index, v=value: self._node.sdo.download(0x1800 + pdo, s, v))
            except SdoAbortedError:
                continue

    def _ask(self, index: int, sub_index: int, *, or_else: int | None = None) -> int:
        """Read an unsigned number; `or_else` where the node has no such object."""
        from canopen import SdoAbortedError

        try:
            return int.from_bytes(self._sdo(lambda: self._node.sdo.upload(index, sub_index)), "little")
        except SdoAbortedError as error:
            if or_else is not None:
                return or_else
            what = f"does not provide object {index:04X}h:{sub_index:02X}: {error}"
            raise self._error(what, "check that the node is a transmitter of CiA 404") from error

    def _sdo(self, transfer: Callable[[], Any]) -> Any:
        from canopen import SdoCommunicationError

        try:
            return transfer()
        except SdoCommunicationError as error:
            raise self._no_answer(
                f"node {self._settings.node} does not answer",
                "check power, `node` and `bitrate`, the two 120 ohm terminators, and CAN high and low",
            ) from error


class _SdoBus:
    """As much of a python-can bus as `canopen.Network` sends with; reads the answer of the node itself, no thread."""

    channel_info = "sawbench"

    def __init__(self, source: CanSource, node: int, *, clock: Callable[[], float]) -> None:
        self._source = source
        self._request, self._answer = 0x600 + node, 0x580 + node
        self._clock = clock
        self.network: Any = None

    def send(self, message: Any) -> None:
        """Send; where it is a request to the node, wait for its answer and hand it to `canopen`."""
        self._source.send(ParsedFrame(message.arbitration_id, message.is_extended_id, bytes(message.data)))
        if message.arbitration_id != self._request:
            return
        deadline_s = self._clock() + _ANSWER_WAIT_S
        while self._clock() < deadline_s:
            batch = self._source.read()
            found = np.flatnonzero(batch.identifier == np.uint32(self._answer))
            for k in found:
                payload = bytearray(batch.payload[k, : batch.length[k]].tobytes())
                self.network.notify(self._answer, payload, float(batch.arrival_s[k]))
            if len(found):
                return


def emulate(name: str, settings: Cia404Settings, plant: PlantStream, clock_error_ppm: float) -> Cia404Emulator:
    """Build an slcan adapter with the transmitter of one validated table behind it."""
    require_slcan(name, settings.interface)
    sensors = tuple(EmulatedSensor.of(channel, table) for channel, table in settings.channels.items())
    return Cia404Emulator(
        plant, sensors, name=name, node=settings.node, bitrate=settings.bitrate, clock_error_ppm=clock_error_ppm
    )


INSTRUMENT: Final = Instrument(
    settings=Cia404Settings,
    make=Cia404,
    emulate=emulate,
    example={"channels": {"force_n": {"input": 1, "raw_range": [-2000, 2000], "calibration": {"raw_unit": "N"}}}},
    package="canopen",
)
