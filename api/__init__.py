"""Test-bench software for battery jigsaws: record, process, model, and diagnose the sim-to-real gap.

The Python interface is seven functions; each takes a file or the result of the one before:

>>> import sawbench
>>> run = sawbench.simulate(k_fc_n_s_per_m=200.0, duration_s=0.5)
>>> trial = sawbench.process(run.recording(material="oak"))
>>> trial.processed.status
'cutting'
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sawbench.functions import compare, diagnose, fit, process, read, runtime, simulate

__all__ = ["compare", "diagnose", "fit", "process", "read", "runtime", "simulate"]

PACKAGES = (
    "bench", "storage", "acquisition", "processing", "modeling", "diagnosis", "blindcheck", "reporting",
    "visualization", "panel", "commands",
)  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import the functions when one is first asked for: `import sawbench` and `sawbench --help` stay fast."""
    if name in __all__:
        from sawbench import functions

        return getattr(functions, name)
    raise AttributeError(f"module 'sawbench' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
