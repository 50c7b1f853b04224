"""Clocks that are late by milliseconds: a large share of a fast stroke, which looks like channels of other trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from sawbench.bench.plausible import Bounds
from sawbench.bench.recording import Floats, Recording
from sawbench.bench.units import DISPLACEMENT, FORCE
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.plausibility import Suspicion, blade_power_w, check, idle_current_between
from sawbench.diagnosis.trial_names import some
from sawbench.diagnosis.trial_reading import Readings, read_trial, tracks_of
from sawbench.modeling.residuals import Baseline

# By which a clock may be late (`modeling.effects.clock_offset`), the least first.
_DELAYS_S: Final = tuple(sign * 1e-3 * ms for ms in range(1, 11) for sign in (1, -1))


def keep_what_a_late_clock_does(
    recordings: Sequence[Recording],
    readings: Readings,
    baseline: Baseline,
    idle: Mapping[float, Bounds],
    found: dict[str, Suspicion],
    warnings: list[str],
) -> None:
    """Believe cuts whose force takes too little power, where one delay gives all cuts theirs: a gap that has a name.

    A delay of some milliseconds is a quarter of a fast stroke: it takes power from all cuts, from the fast ones most.
    One of half a stroke would be a wrong sign; so it is less than a quarter of the slowest.
    """
    contradicted = [name for name, one in found.items() if {fault.kind for fault in one.faults} == {"blade power"}]
    cuts = [
        r for r in recordings
        if not r.trial.is_idle and {FORCE.name, DISPLACEMENT.name} <= r.signals.keys()
        and (r.trial.trial_id not in found or r.trial.trial_id in contradicted)
    ]  # fmt: skip
    cuts.sort(key=lambda r: r.trial.trial_id not in contradicted)
    contradicted = [r.trial.trial_id for r in cuts if r.trial.trial_id in contradicted]
    if not contradicted or len(cuts) < SETTINGS.noise.least_trials:
        return
    rates_hz = [rate_hz for r in cuts if (rate_hz := readings.of(r).rate_hz) is not None]
    longest_s = 0.25 / min(rates_hz, default=np.inf)

    def is_right(recording: Recording, delay_s: float) -> bool:
        tracks = tracks_of(recording)
        time_s, force_n = tracks[FORCE.name]
        moved = read_trial({**tracks, FORCE.name: (time_s - delay_s, force_n)})
        before_w, after_w = blade_power_w(baseline, readings.of(recording)), blade_power_w(baseline, moved)
        gains = before_w is not None and after_w is not None and after_w > before_w
        in_air = idle_current_between(idle, recording.trial.duty or 0.0)
        return gains and not check(baseline, recording.trial, moved, in_air).faults

    for delay_s in (delay_s for delay_s in _DELAYS_S if abs(delay_s) < longest_s):
        if all(is_right(recording, delay_s) for recording in cuts):
            warnings.append(
                f"{some(contradicted)}: {found[contradicted[0]].text}: with the force at least"
                f" {abs(1e3 * delay_s):.0f} ms {'earlier' if delay_s > 0 else 'later'} it would fit in all cuts: the"
                " clocks of the devices may differ"
            )
            for name in contradicted:
                del found[name]
            return


def without_common_delay(locks: Floats, rad_s: Floats) -> Floats:
    """Phases of waves without the delay that makes them agree best.

    Parameters
    ----------
    locks : ndarray of complex, shape (n_trials,)
        With the phase of each wave at the crank angle.
    rad_s : ndarray, shape (n_trials,)
        Angular frequency of each.

    Examples
    --------
    >>> late = without_common_delay(np.exp(-0.003j * np.array([100.0, 300.0])), np.array([100.0, 300.0]))
    >>> bool(abs(np.angle(late[1] / late[0])) < 1e-6)
    True
    """
    tried = np.array([0.0, *_DELAYS_S])
    moved = locks * np.exp(1j * np.outer(tried, rad_s))
    agreement = np.abs((moved / np.abs(moved)).sum(axis=1))
    return moved[int(np.argmax(agreement))]
