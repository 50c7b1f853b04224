"""TOML files as any editor leaves them: read to tables, or one clear error."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from sawbench.bench.errors import ConfigError


def read_toml_text(path: Path, *, remedy: str = "check the path") -> str:
    """Return the text of a TOML file without its byte order mark.

    Parameters
    ----------
    path : Path
    remedy : str
        What to do if there is no such file.

    Raises
    ------
    ConfigError
        If the file is missing, cannot be read or is not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise ConfigError("no such file", where=path, remedy=remedy) from None
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"is not UTF-8 text: byte {error.start} is {error.object[error.start]:#04x}",
            where=path,
            remedy="save it as UTF-8",
        ) from error
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror or error}", where=path) from error


def parse_toml(text: str, *, where: str | Path) -> dict[str, Any]:
    r"""Return the tables of a TOML text.

    Raises
    ------
    ConfigError
        If it is not valid TOML.

    Examples
    --------
    >>> parse_toml("duty = 0.5", where="campaign.toml")
    {'duty': 0.5}
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"is not valid TOML: {error}", where=where, remedy=_remedy(text, str(error))) from error
    except RecursionError:
        raise ConfigError(
            "is not valid TOML: brackets are nested too deeply", where=where, remedy="check for unclosed brackets"
        ) from None


def _remedy(text: str, said: str) -> str:
    """What to do about an error of `tomllib`, which says the line."""
    found = re.search(r"at line (\d+)", said)
    line = text.splitlines()[int(found[1]) - 1] if found else ""
    if re.search(r"=\s*[+-]?\d+,\d", line):
        return "write the number with a decimal point"
    return "keep one of the two: the key stands there already" if "overwrite" in said else "correct that line"
