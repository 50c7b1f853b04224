"""Work on single files, as the workers of a batch are given it: what comes back is small, whatever was read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sawbench.storage.places import Place

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

    Returns
    -------
    ProcessedTrial
        Without what is as long as the recording: angle and channels.

    Raises
    ------
    InputError
        If it is no recording, the configuration is not valid, or the result cannot be written.
    """
    from sawbench.analysis import load_and_process
    from sawbench.archive.trials import light
    from sawbench.storage.results import write_processed

    processed = load_and_process(place, config).processed
    if out_dir is not None:
        write_processed(processed, result_path(place, out_dir), overwrite=overwrite)
    return light(processed)


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
    from sawbench.analysis import fit_trial, open_trial, process_opened

    opened = open_trial(place, config)
    trial = opened.recording.trial
    if skips_idle and trial.is_idle:
        return trial.trial_id, None
    return trial.trial_id, fit_trial(process_opened(opened), method)[0]
