"""Work on single files, as the workers of a batch are given it: what comes back is small, whatever was read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sawbench.bench.errors import InputError
from sawbench.storage.digest import sha256_of
from sawbench.storage.places import AMENDMENTS, Place, find_file, on_disk, place_of

if TYPE_CHECKING:
    from sawbench.bench.config import LoadedConfig
    from sawbench.bench.processed import ProcessedTrial
    from sawbench.modeling.cycle_observation import FitMethod
    from sawbench.modeling.results import CuttingFit


def result_path(place: Place, out_dir: Place) -> Place:
    """Return where the HDF5 file of a recording goes."""
    return out_dir / f"{place.stem}.h5"


def process_file(
    place: Place, *, config: LoadedConfig | None, out_dir: Place | None = None, overwrite: bool = False
) -> ProcessedTrial:
    """Process a recording, and write the result as HDF5 where a folder is given.

    A result that is there already is returned as it stands where it is of the same bytes, configuration and software,
    unless `overwrite` is set.

    Returns
    -------
    ProcessedTrial
        Without what is as long as the recording: angle and channels.

    Raises
    ------
    InputError
        If it is not a recording, the configuration is not valid, or the result cannot be written.
    """
    from sawbench.analysis import load_and_process
    from sawbench.archive.trials import light
    from sawbench.storage.results import write_processed

    target = None if out_dir is None else result_path(place, out_dir)
    if target is not None and not overwrite and find_file(target) is not None:
        return _kept(target, _key(place, config, sha256_of(place)))
    processed = load_and_process(place, config).processed
    if target is not None:
        write_processed(processed, target, overwrite, key=_key(place, config, processed.source_sha256))
    return light(processed)


def _kept(target: Place, key: str) -> ProcessedTrial:
    """Read what an earlier run has written."""
    from sawbench.archive.trials import light
    from sawbench.storage.results import key_of_processed, read_processed

    with on_disk(target) as local:
        if key_of_processed(local) != key:
            raise InputError(
                "exists already, and is not of this recording, configuration and software",
                where=target,
                remedy="name another folder, or overwrite with --force",
            )
        return light(read_processed(local))


def _key(place: Place, config: LoadedConfig | None, sha256: str) -> str:
    """Key of everything that the result of a recording depends on."""
    from sawbench.archive.journal import key_of
    from sawbench.bench.source_identity import analysis_identity
    from sawbench.inputs import default_config_file

    amendments = place_of(f"{place}{AMENDMENTS}")
    amended = None if find_file(amendments) is None else sha256_of(amendments)
    used = sha256_of(default_config_file()) if config is None else config.sha256
    return key_of(analysis_identity(), sha256, amended, used)


def fit_file(
    place: Place, *, config: LoadedConfig | None, method: FitMethod | None = None, skips_idle: bool = False
) -> tuple[str, CuttingFit | None]:
    """Fit a recording.

    Returns
    -------
    trial : str
    fit : CuttingFit or None
        None where the blade ran in air and `skips_idle` is set.

    Raises
    ------
    InputError
        If it is no cutting trial, or lacks what the fit needs.
    """
    from sawbench.analysis import fit_trial, load_and_process

    analysed = load_and_process(place, config)
    trial = analysed.recording.trial
    if skips_idle and trial.is_idle:
        return trial.trial_id, None
    return trial.trial_id, fit_trial(analysed, method)[0]
