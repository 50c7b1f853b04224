"""Commands that take a moment and whose answer is waited for."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from typing import Final

_PATIENCE_S: Final = 60.0


def run_now(arguments: Sequence[str]) -> str:
    """Run a command of sawbench; return why it refused, empty where it is done."""
    call = [sys.executable, "-m", "sawbench.commands.main", *arguments]
    try:
        ended = subprocess.run(
            call, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_PATIENCE_S, check=False
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {_PATIENCE_S:g} s"
    return "" if ended.returncode == 0 else ended.stderr.strip().removeprefix("sawbench: error: ") or "it failed"
