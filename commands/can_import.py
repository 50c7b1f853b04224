"""A log of CAN frames to one recording: which signals are taken, of which DBC, in which units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from sawbench.bench.errors import ConfigError, InputError

if TYPE_CHECKING:
    from sawbench.acquisition.calibration import Calibration
    from sawbench.acquisition.devices.dbc_can import DbcCanSettings
    from sawbench.bench.config import LoadedConfig
    from sawbench.bench.recording import Trial
    from sawbench.storage.importers import ImportReport, TableMap


@dataclass(frozen=True, kw_only=True, slots=True)
class CanLog:
    """One log and what the user said about it.

    Attributes
    ----------
    path, out_dir : Path
    trial : Trial
    config : LoadedConfig, optional
        Its `[devices.*]` with the driver `dbc_can` say which signal is which channel.
    table_map : TableMap, optional
        Channel -> `Message.Signal`, with unit and sign; goes before the configuration.
    signals : tuple of str
        `CHANNEL=MESSAGE.SIGNAL`, as `--signal` takes it; goes before everything.
    overwrite : bool
    """

    path: Path
    out_dir: Path
    trial: Trial
    config: LoadedConfig | None
    table_map: TableMap | None
    signals: tuple[str, ...]
    overwrite: bool

    def dbc_of_config(self) -> Path:
        """Return the DBC that the configuration names.

        Raises
        ------
        InputError
            If there is none, or several.
        """
        found = sorted({device.dbc for device in self._devices()})
        if len(found) == 1:
            return Path(found[0])
        raise InputError(
            f"contains CAN frames, and the configuration names several DBCs: {', '.join(found)}"
            if found
            else "contains CAN frames, which need a DBC to be decoded",
            where=self.path,
            remedy="add --dbc FILE.dbc (and --signal CHANNEL=MESSAGE.SIGNAL), or --config FILE with one [devices.*] "
            "table for CAN",
        )

    def imported(self, dbc: Path) -> ImportReport:
        """Decode the log and write the recording.

        Raises
        ------
        InputError
            If the log, the DBC or a signal is wrong, or a unit cannot be converted.
        """
        from sawbench.acquisition.can_logs import decode_can_log
        from sawbench.storage.importers import ColumnRule, ImportReport, convert_signal
        from sawbench.storage.reader import write_recording

        wanted, calibrations = self._wanted(dbc), self._calibrations(dbc)
        rules = self.table_map.columns if self.table_map else {}
        decoded = decode_can_log(self.path, dbc, wanted or None)
        signals, taken = dict(decoded.signals), {}
        for name, column in wanted.items():
            rule = rules.get(name) or ColumnRule(column=column)
            if name in calibrations:
                calibrated = replace(signals[name], values=calibrations[name].apply(signals[name].values), unit="")
                signals[name], words = convert_signal(calibrated, rule, where=self.path)
                taken[name] = f"{words}, calibrated: {calibrations[name].source or 'as configured in [devices.*]'}"
            else:
                signals[name], taken[name] = convert_signal(signals[name], rule, where=self.path)
        recording = replace(
            decoded,
            signals=signals,
            trial=replace(self.trial, started_at=decoded.trial.started_at),
            config_toml=self.config.text if self.config else "",
            provenance={
                **decoded.provenance,
                **{f"column of {channel}": words for channel, words in taken.items()},
                **({"map": self.table_map.as_toml()} if self.table_map else {}),
            },
        )
        target = self.out_dir / f"{self.trial.trial_id}.mcap"
        return ImportReport(
            paths=(write_recording(recording, target, overwrite=self.overwrite),),
            warnings=tuple(event.text for event in recording.events if event.kind == "warning"),
            n_samples=sum(len(signal.values) for signal in signals.values()),
            taken={target.name: taken or {name: f"signal {name}" for name in signals}},
        )

    def _wanted(self, dbc: Path) -> dict[str, str]:
        """Channel -> signal; empty: every numeric signal under its own name."""
        stated = {}
        for text in self.signals:
            channel, equals, signal = text.partition("=")
            if not equals or "." not in signal:
                raise InputError(f"--signal is {text!r}, expected CHANNEL=MESSAGE.SIGNAL")
            stated[channel] = signal
        if stated:
            return stated
        if self.table_map is not None and self.table_map.columns:
            return {name: str(rule.column) for name, rule in self.table_map.columns.items()}
        return {channel.name: signal for device in self._devices(dbc) for channel, signal in device.signals.items()}

    def _calibrations(self, dbc: Path) -> dict[str, Calibration]:
        """Corrections of the DBC's values that the configuration states, by channel."""
        if self.signals or (self.table_map is not None and self.table_map.columns):
            return {}
        return {channel.name: found for device in self._devices(dbc) for channel, found in device.calibration.items()}

    def _devices(self, dbc: Path | None = None) -> list[DbcCanSettings]:
        """Settings of the `[devices.*]` that read CAN: those with this DBC, else all."""
        from sawbench.acquisition.devices import validate_table
        from sawbench.acquisition.devices.dbc_can import DbcCanSettings

        if self.config is None:
            return []
        config = self.config.config
        tables = {name: table for name, table in config.devices.items() if table.get("driver") == "dbc_can"}
        try:
            settings = [validate_table(n, table, channels=config.known_channels)[1] for n, table in tables.items()]
        except ConfigError as error:
            raise ConfigError(error.what, where=f"{self.config.path}: {error.where}", remedy=error.remedy) from error
        found = [device for device in settings if isinstance(device, DbcCanSettings)]
        return [device for device in found if dbc is not None and Path(device.dbc).name == dbc.name] or found
