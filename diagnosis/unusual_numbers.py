"""Settings of trials that were probably stated in another unit, and rates too low for the strokes.

They refuse nothing: a trial may be unusual, which then explains a refusal.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from types import MappingProxyType
from typing import Final

from sawbench.bench.errors import InputError
from sawbench.bench.plausible import is_outside
from sawbench.bench.recording import Recording, Trial
from sawbench.diagnosis.plausibility import too_slow
from sawbench.diagnosis.trial_names import some
from sawbench.modeling.residuals import Baseline

_TRIAL: Final = MappingProxyType({"thickness_mm": (0.3, 300.0), "feed_mm_s": (0.05, 200.0)})


def unusual_settings(trials: Sequence[Trial]) -> list[str]:
    """Name the settings of trials that lie outside of what is cut with battery tools, each with its trials.

    Examples
    --------
    >>> unusual_settings([Trial(trial_id="a", thickness_mm=0.02), Trial(trial_id="b", thickness_mm=20.0)])
    ['a: thickness_mm = 0.02 is unusual: 0.3 to 300 are usual; check its unit']
    """
    found: dict[tuple[str, float], list[str]] = {}
    for trial, key in product(trials, _TRIAL):
        value = getattr(trial, key)
        if value and is_outside(value, _TRIAL[key]):
            found.setdefault((key, value), []).append(trial.trial_id)
    usual = {key: f"{low:g} to {high:g}" for key, (low, high) in _TRIAL.items()}
    return [
        f"{some(names)}: {key} = {value:g} is unusual: {usual[key]} are usual; check its unit"
        for (key, value), names in found.items()
    ]


def slow_channels(recordings: Sequence[Recording], baseline: Baseline) -> list[str]:
    """Name channels with too few samples for each stroke at the speed without load, each with its trials.

    Parameters
    ----------
    recordings : sequence of Recording
    baseline : Baseline
    """
    found: dict[str, list[tuple[str, str]]] = {}
    for recording in recordings:
        rates_hz = {name: signal.rate_hz for name, signal in recording.signals.items()}
        for channel, words in too_slow(baseline, recording.trial, rates_hz).items():
            found.setdefault(channel, []).append((recording.trial.trial_id, words))
    return [f"{some([name for name, _ in said])}: {said[0][1]}" for said in found.values()]


@contextmanager
def naming(unusual: Sequence[str]) -> Iterator[None]:
    """Let a refusal name unusual numbers first: they may be the reason."""
    try:
        yield
    except InputError as error:
        if not unusual:
            raise
        remedy = "; ".join([*unusual, *([error.remedy] if error.remedy else [])])
        raise InputError(error.what, where=error.where, remedy=remedy) from error
