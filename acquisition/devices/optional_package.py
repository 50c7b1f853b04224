"""Packages that a single instrument needs: imported when it is used, with one clear message where they are missing."""

from __future__ import annotations

import importlib
from typing import Any

from sawbench.bench.errors import ConfigError


def import_optional(module: str, *, extra: str, where: str) -> Any:
    """Import `module`, whose package the extra `extra` of sawbench installs.

    Parameters
    ----------
    module, extra : str
    where : str
        Device, for the message.

    Returns
    -------
    module

    Raises
    ------
    ConfigError
        If the package is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ConfigError(
            f"needs the Python package {module.partition('.')[0]}, which is not installed",
            where=where,
            remedy=f"install it: pip install 'sawbench[{extra}]'",
        ) from error
