"""From opened trials to the gap report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sawbench.bench.errors import InputError
from sawbench.plain import plain

if TYPE_CHECKING:
    from sawbench.analysis import OpenedTrial
    from sawbench.bench.config import LoadedConfig


def diagnose_trials(
    trials: Sequence[OpenedTrial],
    loaded: LoadedConfig | None = None,
    *,
    until_closed: bool = False,
    plan: int = 0,
    on_step: Callable[[int, int, str], None] | None = None,
) -> dict[str, Any]:
    """Diagnose the sim-to-real gap of a campaign.

    Parameters
    ----------
    trials : sequence of OpenedTrial
    loaded : LoadedConfig, optional
        Default: that of the first trial.
    until_closed : bool
        Add causes one by one to the model until nothing more closes.
    plan : int
        Trials to propose, 0 to 20.
    on_step : callable, optional
        (done, total, what).

    Returns
    -------
    dict
        `gap_report.json`, as plain values.

    Raises
    ------
    InputError
        If nothing can be diagnosed; the message says why for every trial.
    """
    from importlib.metadata import version

    import scipy.linalg  # noqa: F401  # a limit holds for what is loaded, and scipy brings a linear algebra of its own
    from sawbench.diagnosis.answer.gap_report import diagnose
    from threadpoolctl import threadpool_limits

    if not trials:
        raise InputError("there is no trial to diagnose", remedy="give recordings or a folder with recordings")
    loaded = loaded or trials[0].loaded
    provenance = {
        "recordings": {_name(trial): trial.sha256 for trial in trials},
        "config_sha256": loaded.sha256,
        "software": f"sawbench {version('sawbench')}",
        "is_simulated": any("simulated" in trial.recording.trial.source for trial in trials),
    }
    amended = {_name(trial): words for trial in trials if (words := list(trial.recording.trial.amendments))}
    if amended:
        provenance["amendments"] = amended
    recordings = [trial.recording for trial in trials]
    # The products of matrices here are small: threads of the linear algebra would cost more than they save.
    with threadpool_limits(limits=1, user_api="blas"):
        return plain(
            diagnose(
                recordings, loaded, provenance=provenance, until_closed=until_closed, n_planned=plan, on_step=on_step
            )
        )  # fmt: skip


def _name(trial: OpenedTrial) -> str:
    path = trial.recording.path
    return Path(path).name if path else f"{trial.recording.trial.trial_id} (not from a file)"
