"""The errors a user can meet, each carrying the exit code of the command line."""

from __future__ import annotations


class SawbenchError(Exception):
    """Base of every error that is meant for the user.

    Parameters
    ----------
    what : str
        What failed, with what was got and its unit.
    where : str or Path, optional
        Anything whose text names it: file, place in a store, device, channel or time the failure belongs to.
    remedy : str, optional
        What to do next, one sentence.
    """

    exit_code = 1

    def __init__(self, what: str, *, where: object = None, remedy: str | None = None) -> None:
        self.what = what
        self.where = None if where is None else str(where)
        self.remedy = remedy
        super().__init__(str(self))

    @property
    def failure(self) -> str:
        """Where and what, without the remedy."""
        return f"{self.where}: {self.what}" if self.where else self.what

    def __str__(self) -> str:
        return f"{self.failure}\n  -> {self.remedy}" if self.remedy else self.failure


class InputError(SawbenchError):
    """The input or the usage is wrong: a file, a value, an option (exit code 2)."""

    exit_code = 2


class ConfigError(InputError):
    """`bench_config.toml` or `campaign.toml` is not valid (exit code 2)."""


class RecordingError(InputError):
    """A file is not a recording, or is damaged beyond what was asked (exit code 2)."""


class WritingError(RecordingError):
    """The disk refuses what has to be written, for example because it is full (exit code 1)."""

    exit_code = 1

    @classmethod
    def of(cls, error: BaseException, *, where: object, kept: str = "") -> WritingError:
        """Say that a file cannot be written, why, and what to do.

        Parameters
        ----------
        error : BaseException
            What the system or a library said.
        where : str or Path
            The file.
        kept : str, optional
            What becomes of the data written so far; by default nothing of them is left.

        Examples
        --------
        >>> print(WritingError.of(OSError(28, "No space left on device"), where="oak-01.rrd"))
        oak-01.rrd: cannot be written: No space left on device
          -> free disk space, or give a file on another disk
        """
        remedy = "free disk space, or give a file on another disk" + (f"; {kept}" if kept else "")
        return cls(f"cannot be written: {getattr(error, 'strerror', None) or error}", where=where, remedy=remedy)


class DeviceError(SawbenchError):
    """An instrument is missing, silent or speaks something else (exit code 1)."""


class NoAnswerError(DeviceError):
    """The port of an instrument opens, but no answer that makes sense comes out of it (exit code 1)."""


class OtherInstrumentError(DeviceError):
    """What answers is not the instrument that is meant: its serial number is another one (exit code 1)."""


class UntrustedResult(SawbenchError):
    """The computation ran, but its result must not be relied on (exit code 1)."""
