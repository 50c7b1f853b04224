"""Which plant a configuration describes, and its recordings reduced to that plant's states."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from bench.config import LoadedConfig
from bench.recording import Recording
from diagnosis.campaign import Campaign, reduce_campaign
from diagnosis.plants.linear_axis import reduce_axis


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
        With a `[linear_axis]` table the plant is a linear axis, else the jigsaw of `[plant]`.
    on_trial : callable, optional
        (done, total, name).

    Returns
    -------
    Campaign

    Raises
    ------
    InputError
        If no trial can be diagnosed.
    """
    if loaded.config.linear_axis is not None:
        return reduce_axis(recordings, loaded, on_trial=on_trial)
    return reduce_campaign(recordings, loaded, on_trial=on_trial)
