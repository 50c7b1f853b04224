"""Which plant a configuration describes, and its recordings reduced to that plant's states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from sawbench.bench.config import LoadedConfig
from sawbench.bench.recording import Recording
from sawbench.diagnosis.campaign import Campaign, reduce_campaign
from sawbench.diagnosis.plants.linear_axis import reduce_axis
from sawbench.modeling.machines.table import machine_of

_REDUCE: Final = {"crank": reduce_campaign, "linear_axis": reduce_axis}


def reduce_recordings(
    recordings: Sequence[Recording],
    loaded: LoadedConfig,
    *,
    on_trial: Callable[[int, int, str], None] | None = None,
) -> Campaign:
    """Reduce a campaign for the plant that its configuration describes.

    Parameters
    ----------
    recordings : sequence of Recording
    loaded : LoadedConfig
        Of a machine in `modeling.machines.table`.
    on_trial : callable, optional
        (done, total, name).

    Raises
    ------
    ConfigError
        If it describes no machine.
    InputError
        If no trial can be diagnosed.
    """
    machine = machine_of(loaded.config, path=loaded.path)
    return _REDUCE[machine.frame](recordings, loaded, on_trial=on_trial)
