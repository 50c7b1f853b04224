"""National Instruments devices with analogue inputs, through NI's package `nidaqmx` and its driver NI-DAQmx.

One task, clocked by the device, read without a break: its sample count is exact, and an overflow ends the task with an
error instead of losing samples.
"""

from __future__ import annotations

import math
from typing import Any, Final, Literal

import numpy as np
from pydantic import Field, model_validator
from sawbench.acquisition.devices.device import Chunk, inputs_within
from sawbench.acquisition.devices.instrument import Instrument
from sawbench.acquisition.devices.optional_package import import_optional
from sawbench.acquisition.devices.package_instrument import PackageInstrument, PackageTable

_EXTRA: Final = "ni"
_READ_S: Final = 0.02
_BUFFER_S: Final = 4.0
_LONGEST_WAIT_S: Final = 2.0


class NiDaqmxSettings(PackageTable):
    """`[devices.NAME]` with `driver = "ni_daqmx"`.

    Attributes
    ----------
    port : str
        Device or module as NI MAX names it: `Dev1`, `cDAQ1Mod1`.
    channels : mapping of Channel to ChannelTable
        Bench channel -> analogue input as `input`: 1 is ai0. Raw unit: V, or mV/V for bridge.
    rate_hz : float
        Samples per second and channel.
    kind : {"voltage", "bridge"}
        What all inputs of the table measure.
    largest : float
        Largest raw value to be measured, V or mV/V; the device takes its next larger range.
    terminals : {"default", "differential", "single_ended"}
        How voltage inputs are wired.
    excitation_v : float
        Of bridges, by the device, V.
    serial_number : str, optional
        Of the device, hexadecimal as NI MAX writes it; another one is refused.
    """

    driver: str = "ni_daqmx"
    rate_hz: float = Field(default=6000.0, gt=0, le=1_000_000)
    kind: Literal["voltage", "bridge"] = "voltage"
    largest: float = Field(default=10.0, gt=0)
    terminals: Literal["default", "differential", "single_ended"] = "default"
    excitation_v: float = Field(default=2.5, gt=0)

    @model_validator(mode="after")
    def _inputs_exist(self) -> NiDaqmxSettings:
        inputs_within(self.channels, 80)
        return self


class NiDaqmx(PackageInstrument[NiDaqmxSettings]):
    """One device or module; see `PackageInstrument` for the parameters."""

    MODEL = "NI-DAQmx"

    def open(self) -> None:
        """Reserve the inputs and set the sample clock; see `Device.open`."""
        nidaqmx = import_optional("nidaqmx", extra=_EXTRA, where=f"[devices.{self.name}]")
        system = import_optional("nidaqmx.system", extra=_EXTRA, where=f"[devices.{self.name}]")
        constants = import_optional("nidaqmx.constants", extra=_EXTRA, where=f"[devices.{self.name}]")
        rate_hz = self._settings.rate_hz
        try:
            device = system.Device(self.port)
            self._facts = {"model": str(device.product_type), "serial_number": f"{device.serial_num:X}"}
            self._require_number(self._facts["serial_number"])
            self._handle = nidaqmx.Task()
            for table in self._settings.channels.values():
                self._add_channel(constants, f"{self.port}/ai{table.input - 1}")
            self._handle.timing.cfg_samp_clk_timing(
                rate_hz,
                sample_mode=constants.AcquisitionType.CONTINUOUS,
                samps_per_chan=math.ceil(_BUFFER_S * rate_hz),
            )
            chosen_hz = float(self._handle.timing.samp_clk_rate)
        except nidaqmx.errors.Error as error:
            raise self._refused(error) from error
        if abs(chosen_hz / rate_hz - 1.0) > 0.02:
            raise self._error(f"was set to {rate_hz:g} Hz but uses {chosen_hz:g} Hz", "set rate_hz to that")

    def start(self) -> None:
        """Start sampling."""
        nidaqmx = import_optional("nidaqmx", extra=_EXTRA, where=f"[devices.{self.name}]")
        try:
            self._handle.start()
        except nidaqmx.errors.Error as error:
            raise self._refused(error) from error

    def read(self) -> list[Chunk]:
        """Return the samples that arrived; wait for 20 ms of them, or for one."""
        nidaqmx = import_optional("nidaqmx", extra=_EXTRA, where=f"[devices.{self.name}]")
        readers = import_optional("nidaqmx.stream_readers", extra=_EXTRA, where=f"[devices.{self.name}]")
        if self._handle is None:
            raise self._error("is not open", "call open() first")
        try:
            stream = self._handle.in_stream
            n = max(int(stream.avail_samp_per_chan), math.ceil(_READ_S * self._settings.rate_hz))
            samples = np.empty((len(self._settings.channels), n))
            readers.AnalogMultiChannelReader(stream).read_many_sample(
                samples, number_of_samples_per_channel=n, timeout=_LONGEST_WAIT_S
            )
        except nidaqmx.errors.Error as error:
            raise self._refused(error) from error
        return self._chunks(np.ascontiguousarray(samples.T))

    def _close(self, handle: Any) -> None:
        nidaqmx = import_optional("nidaqmx", extra=_EXTRA, where=f"[devices.{self.name}]")
        try:
            handle.close()
        except nidaqmx.errors.Error:
            # Unplugged: there is no task any more.
            return

    def _add_channel(self, constants: Any, channel: str) -> None:
        inputs, limit = self._handle.ai_channels, self._settings.largest
        if self._settings.kind == "bridge":
            inputs.add_ai_bridge_chan(
                channel,
                min_val=-limit,
                max_val=limit,
                units=constants.BridgeUnits.MILLIVOLTS_PER_VOLT,
                bridge_config=constants.BridgeConfiguration.FULL_BRIDGE,
                voltage_excit_source=constants.ExcitationSource.INTERNAL,
                voltage_excit_val=self._settings.excitation_v,
            )
            return
        wired = {
            "default": constants.TerminalConfiguration.DEFAULT,
            "differential": constants.TerminalConfiguration.DIFF,
            "single_ended": constants.TerminalConfiguration.RSE,
        }
        inputs.add_ai_voltage_chan(
            channel, terminal_config=wired[self._settings.terminals], min_val=-limit, max_val=limit
        )

    def _refused(self, error: Exception) -> Exception:
        remedy = "check name, range and rate in NI MAX, and that NI-DAQmx is installed"
        return self._error(f"NI-DAQmx error: {error}", remedy)


INSTRUMENT: Final = Instrument(
    settings=NiDaqmxSettings,
    make=NiDaqmx,
    example={"channels": {"force_n": {"input": 1, "raw_range": [-10, 10], "calibration": {"scale": 50.0}}}},
    is_searched=False,
)
