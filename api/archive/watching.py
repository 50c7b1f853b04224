"""A folder that recordings arrive in: evaluate what is whole, keep a comparison current."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from sawbench.archive.trials import Archive
from sawbench.storage.places import FoundFile, Place, list_recordings

if TYPE_CHECKING:
    from sawbench.archive.batch import Workers


@dataclass(kw_only=True, slots=True)
class Watch:
    """Looks at a folder, again and again.

    Attributes
    ----------
    folder : Path or StoreFile
        Recordings have the suffix `.mcap`; the recorder's `.part` files are left alone until they are renamed.
    archive : Archive
    workers : Workers
    on_change : callable
        Called after the table changed: writes the page.
    """

    folder: Place
    archive: Archive
    workers: Workers
    on_change: Callable[[], None]
    _seen: dict[Place, FoundFile] = field(default_factory=dict)
    _owes_page: bool = True

    def look(self, *, waits: bool = True) -> list[tuple[FoundFile, str]]:
        """Evaluate what is new and at rest; return it with the reason why it failed, if it did.

        Parameters
        ----------
        waits : bool
            Leave a file alone until a second look finds it unchanged: a copy may be half done. One that changes
            later is evaluated again.

        Raises
        ------
        SawbenchError, OSError
            If the folder or the archive cannot be reached; the next look continues where this one stopped.
        """
        files = [file.absolute() for file in list_recordings(self.folder)]
        at_rest = [file for file in files if not waits or self._seen.get(file.place) == file]
        self._seen = {file.place: file for file in files}
        waiting = self.archive.missing(at_rest)
        done = []
        for outcome in self.archive.evaluate(waiting, self.workers):
            error = outcome.error or (outcome.value or {}).get("error") or ""
            done.append((outcome.item.file, str(error)))
        self._owes_page = self._owes_page or bool(done)
        if self._owes_page and self.archive.table.exists():
            self.on_change()
            self._owes_page = False
        return done
