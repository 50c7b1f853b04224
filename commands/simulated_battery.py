"""The charge that a battery of the simulated bench has lost: what its recordings say was drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sawbench.acquisition.series.rejected import REJECTED
from sawbench.bench.errors import RecordingError
from sawbench.storage.places import list_recordings
from sawbench.storage.reader import read_recording

_AS_PER_AH = 3600.0


def drawn_ah(folder: Path, battery: str | None) -> float:
    """Return the charge drawn from a battery by the recordings of a folder and by those rejected there.

    Trials without a stated battery share one, as `sawbench diagnose` takes it.

    Parameters
    ----------
    folder : Path
        Need not exist.
    battery : str, optional
        Identifier.

    Returns
    -------
    float, Ah
    """
    total_as = 0.0
    for file in [*list_recordings(folder), *list_recordings(folder / REJECTED)]:
        try:
            recording = read_recording(str(file.place))
        except RecordingError:
            # Another program's file: the command that reads the campaign says so.
            continue
        current = recording.signals.get("battery_current_a")
        if recording.trial.battery == battery and current is not None:
            total_as += float(np.trapezoid(current.values, current.time_s))
    return max(total_as, 0.0) / _AS_PER_AH
