"""Failures of single files, where a command goes through many: one bad file must not cost the results of the others."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import click
from sawbench.bench.errors import SawbenchError


class Failures:
    """Collects what went wrong with single files.

    Parameters
    ----------
    n_files : int
        Of a single file the error is the command's own.
    """

    def __init__(self, n_files: int) -> None:
        self._n_files = n_files
        self._found: list[SawbenchError] = []

    @contextmanager
    def collected(self) -> Iterator[None]:
        """Say an error of the body at once and go on, unless there is a single file."""
        try:
            yield
        except SawbenchError as error:
            if self._n_files == 1:
                raise
            click.echo(f"sawbench: error: {error}", err=True)
            self._found.append(error)

    def exit_code(self, *, is_trusted: bool) -> int:
        """Exit code of the command: of the worst failure, else 0 or, where a result is not reliable, 1."""
        return max((error.exit_code for error in self._found), default=0 if is_trusted else 1)
