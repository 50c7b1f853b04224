"""What a load cell's filter takes off the ripple of the force where its delay is known: that is no gap.

An amplifier has a filter, and a converter of some hundred samples a second sends the mean of the time between two.
Loggers take such a delay out and stamp a mean at the middle of its time: nothing is late then, but the force is rounded
where it changes fast. The motor feels the force as it is, so that the mechanical equation misses the difference too. A
force that is late is an effect (`force_sensor_lag`), and so is a late clock. What is rounded reaches into the return
stroke on either side of the cut: where nothing is seen of that, there is no filter.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from typing import Final

import numpy as np
from sawbench.diagnosis.inference.common_filter import butterworth_in_time
from sawbench.diagnosis.inference.nuisance import Nuisance
from sawbench.diagnosis.standard_error import exceeds_its_error
from sawbench.modeling.effects.effect import TransferFunction
from sawbench.modeling.effects.transfer import Spectrum, average, force_reading
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

# Corners of filters of amplifiers, and their orders; times over which a converter averages.
_CORNERS_HZ: Final = (200.0, 400.0, 800.0)
_ORDERS: Final = (2, 4)
_MEAN_S: Final = (1e-3, 2e-3, 4e-3)
# One of each, or between two.
_FILTER_STD: Final = 1.0 / np.sqrt(len(_CORNERS_HZ) * len(_ORDERS))
_MEAN_STD: Final = 1.0 / np.sqrt(len(_MEAN_S))


def force_filter_nuisances(baseline: Baseline, states: Sequence[State]) -> Iterator[Nuisance]:
    """List what filters and means whose delay is taken out may take off the force.

    Parameters
    ----------
    baseline : Baseline
    states : sequence of State
        Of the campaign.

    Yields
    ------
    Nuisance
        Of each corner and order, and of each time; none where the force is not rounded.
    """
    if not is_rounded(baseline, states):
        return
    for corner_hz, order in product(_CORNERS_HZ, _ORDERS):
        name = f"low-pass of force_n, {corner_hz:g} Hz, order {order}"
        yield _nuisance(name, _FILTER_STD, butterworth_in_time(corner_hz, order))
    for period_s in _MEAN_S:
        yield _nuisance(f"mean of force_n over {1e3 * period_s:g} ms", _MEAN_STD, average(period_s))


def is_rounded(baseline: Baseline, states: Sequence[State]) -> bool:
    """Whether the force of the cuts reaches into the return strokes before and after, as behind a mean.

    Parameters
    ----------
    baseline : Baseline
    states : sequence of State
        Those without a force, of starts and in air do not count.
    """
    rounded = []
    for state in states:
        if state.kind == "running" and state.force_n is not None and not state.setting.is_idle:
            expected = baseline.expected_force(state)
            returns = expected == 0.0
            change = Spectrum(expected, state).through(average(_MEAN_S[1])) * returns
            force_n = (state.force_n - state.force_n[returns].mean()) * returns
            # The return stroke follows the cut on one side of its middle, and precedes it on the other.
            is_beyond = baseline.mechanism.displacement(state.angle_rad) > baseline.radius_m
            rounded.append([float(np.sum(change * force_n * side)) for side in (is_beyond, ~is_beyond)])
    return len(rounded) > 1 and all(exceeds_its_error(side) for side in np.transpose(rounded))


def _nuisance(name: str, std: float, transfer: TransferFunction) -> Nuisance:
    signature = partial(_rounded, transfer=transfer)
    return Nuisance(name=name, std=std, signature=signature, is_shared=True)


def _rounded(baseline: Baseline, state: State, *, transfer: TransferFunction) -> Signature:
    if state.force_n is None:
        return {}
    return force_reading(baseline, state, Spectrum(baseline.expected_force(state), state).through(transfer))
