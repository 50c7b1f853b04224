"""Decides by the file's kind how it is imported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from bench.errors import InputError
from bench.recording import Event, Recording, Signal, Trial
from storage.importers.table import FramesNeedDbc, signals_of
from storage.reader import sha256_of, write_recording
from storage.writer import software_version

CSV_SUFFIXES: Final = (".csv", ".tsv", ".txt")
HDF5_SUFFIXES: Final = (".h5", ".hdf5", ".hdf")
MF4_SUFFIXES: Final = (".mf4", ".mdf")
LOG_SUFFIXES: Final = (".log",)


@dataclass(frozen=True, kw_only=True, slots=True)
class ImportReport:
    """What an import wrote.

    Attributes
    ----------
    paths : tuple of Path
        One recording a trial, in the order of the campaign.
    warnings : tuple of str
        Each begins with the name of its table; also in the recording as events.
    n_samples : int
        Over all channels of all trials.
    """

    paths: tuple[Path, ...]
    warnings: tuple[str, ...]
    n_samples: int


def import_path(
    path: str | Path,
    out_dir: str | Path,
    *,
    overwrite: bool = False,
    on_trial: Callable[[int, int, str], None] | None = None,
) -> ImportReport:
    """Turn a campaign or a single table into recordings.

    Parameters
    ----------
    path : str or Path
        `campaign.toml`, or a CSV, HDF5 or MF4 file.
    out_dir : str or Path
        Folder for `<table's stem>.mcap`; made if missing.
    overwrite : bool
    on_trial : callable, optional
        Called with trials done, trials in all and the name of the next one, for a progress bar.

    Returns
    -------
    ImportReport

    Raises
    ------
    InputError
        If the file is missing, of another kind, or its content is wrong; nothing is written then, except the
        trials of a campaign before the wrong one.
    ConfigError
        If the campaign or its configuration is not valid.
    RecordingError
        If a recording exists and `overwrite` is False; no trial is imported then.
    FramesNeedDbc
        If the file holds CAN frames.
    """
    path, out_dir = Path(path), Path(out_dir)
    suffix = path.suffix.lower()
    config_toml = ""
    provenance: dict[str, str] = {}
    if suffix == ".toml":
        from storage.importers.campaign import load_campaign

        campaign, config = load_campaign(path)
        config_toml = config.text if config else ""
        provenance = {"campaign": path.name, "campaign_sha256": sha256_of(path)}
        jobs = [(path.parent / entry.file, entry.trial()) for entry in campaign.trial]
    else:
        jobs = [(path, Trial(trial_id=path.stem, source=f"import of {path.name}"))]
    _refuse_existing([out_dir / f"{trial.trial_id}.mcap" for _, trial in jobs], overwrite=overwrite)
    paths, warnings, n_samples = [], [], 0
    for number, (table, trial) in enumerate(jobs):
        if on_trial is not None:
            on_trial(number, len(jobs), trial.trial_id)
        about = provenance | ({"trial_number": str(number + 1)} if provenance else {})
        recording = _read(table, trial, config_toml, about)
        paths.append(write_recording(recording, out_dir / f"{trial.trial_id}.mcap", overwrite))
        warnings += [f"{table.name}: {event.text}" for event in recording.events]
        n_samples += sum(len(signal.values) for signal in recording.signals.values())
    return ImportReport(paths=tuple(paths), warnings=tuple(warnings), n_samples=n_samples)


def _refuse_existing(paths: list[Path], *, overwrite: bool) -> None:
    existing = [path for path in paths if path.exists()]
    if existing and not overwrite:
        raise InputError(
            f"{len(existing)} of {len(paths)} recordings exist already and are not overwritten",
            where=existing[0],
            remedy="choose another folder with --out, or give --force to replace them",
        )


def _read(path: Path, trial: Trial, config_toml: str, about: dict[str, str]) -> Recording:
    signals, warnings = read_signals(path, is_idle=trial.is_idle)
    start_s = min((float(signal.time_s[0]) for signal in signals.values()), default=0.0)
    return Recording(
        trial=trial,
        signals=signals,
        events=tuple(Event(kind="warning", time_s=start_s, text=text) for text in warnings),
        config_toml=config_toml,
        provenance={
            "imported_by": software_version(),
            "source_file": path.name,
            "source_sha256": sha256_of(path),
            **about,
        },
    )


def read_signals(path: Path, *, is_idle: bool = False) -> tuple[dict[str, Signal], list[str]]:
    """Read the signals of a single table.

    Parameters
    ----------
    path : Path
    is_idle : bool
        The blade ran in air.

    Returns
    -------
    signals : dict of str to Signal
    warnings : list of str

    Raises
    ------
    InputError
        As `import_path`.
    """
    suffix = path.suffix.lower()
    if suffix in MF4_SUFFIXES:
        from storage.importers.mf4_signals import read_mf4_signals

        return read_mf4_signals(path, is_idle=is_idle)
    if suffix in CSV_SUFFIXES:
        from storage.importers.csv_table import read_csv_table

        return signals_of(read_csv_table(path), is_idle=is_idle)
    if suffix in HDF5_SUFFIXES:
        from storage.importers.hdf5_table import read_hdf5_table

        return signals_of(read_hdf5_table(path), is_idle=is_idle)
    if suffix in LOG_SUFFIXES:
        raise FramesNeedDbc("is a log of CAN frames", where=path, remedy="give the DBC that describes the frames")
    if suffix == ".mcap":
        raise InputError("is a recording already", where=path, remedy="`sawbench info` shows what is in it")
    known = ", ".join((".toml", *CSV_SUFFIXES, *HDF5_SUFFIXES, *MF4_SUFFIXES, *LOG_SUFFIXES))
    raise InputError(f"is of an unknown kind; known are {known}", where=path)
