"""Recordings that are set aside: moved to the folder `rejected` beside them, never deleted or overwritten."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

from sawbench.storage.amendments import amendments_path
from sawbench.storage.places import list_recordings

REJECTED: Final = "rejected"


def uncounted(recordings: Iterable[Path]) -> list[str]:
    """Say which trials were set aside beside recordings: they used battery and blade too.

    Parameters
    ----------
    recordings : iterable of Path
        Of a campaign.

    Returns
    -------
    list of str
        A sentence for each folder that holds some.
    """
    said = []
    for folder in sorted({path.parent for path in recordings}):
        if n := len(list_recordings(folder / REJECTED)):
            trials = "1 rejected trial is" if n == 1 else f"{n} rejected trials are"
            said.append(
                f"{trials} in {folder.name}/{REJECTED}: the charge and the cutting distance used there are not counted,"
                " so state of charge and wear of the trials behind them are uncertain"
            )
    return said


def free_place(path: Path, trial_id: str) -> Path:
    """Return the first free name for a recording, or for what its recorder left of it, among the rejected ones.

    Parameters
    ----------
    path : Path
    trial_id : str
        What the name of the file begins with.
    """
    ending, number = path.name.removeprefix(trial_id), 1
    while (found := path.parent / REJECTED / f"{trial_id}-{number}{ending}").exists():
        number += 1
    return found


def move(path: Path, target: Path) -> None:
    """Move a recording, with its amendments.

    Raises
    ------
    OSError
        If it cannot be moved.
    """
    target.parent.mkdir(exist_ok=True)
    path.rename(target)
    if (amendments := amendments_path(path)).exists():
        amendments.rename(amendments_path(target))


def move_to_rejected(path: Path, trial_id: str, *, target: Path | None = None, second_copy: str | None = None) -> Path:
    """Move a recording, and its second copy, to the rejected ones beside it.

    Parameters
    ----------
    path : Path
    trial_id : str
    target : Path, optional
        Default: the first free name.
    second_copy : str, optional
        Folder with second copies, as the configuration names it.

    Returns
    -------
    Path
        Where it is now.
    """
    target = target or free_place(path, trial_id)
    if second_copy is not None and (copy := Path(second_copy) / path.name).exists():
        move(copy, free_place(copy, trial_id))
    move(path, target)
    return target
