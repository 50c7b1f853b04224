"""What the filter of a recorder takes off the edges of a force: that is no gap.

A recorder has a filter before its converter, the same for all of its channels. Nothing is late there, force against
displacement, and equations that are sums of channels hold as before. But a force that begins and ends at the dead
centres has kinks, which the filter rounds, and the angles of the cutting half are those of a smooth motion, which it
leaves alone: the cutting law alone misses the rounding. A filter of the force alone makes it late: that is an effect
(`force_sensor_lag`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats
from sawbench.diagnosis.inference.nuisance import Nuisance, SignatureFunction
from sawbench.modeling.effects.effect import TransferFunction
from sawbench.modeling.effects.transfer import Complexes, Spectrum, delay, low_pass
from sawbench.modeling.residuals import Baseline, Signature
from sawbench.modeling.state import State

# Corners of filters before a converter, and their orders. One of first order, which loses amplitude long before its
# corner, is what a late clock and a lag of the force leave together.
_CORNERS_HZ: Final = (400.0, 650.0, 1000.0)
_ORDERS: Final = (2, 4)
# One of them, or between two.
_STD: Final = 1.0 / np.sqrt(len(_CORNERS_HZ) * len(_ORDERS))


def common_filter_nuisances() -> Iterator[Nuisance]:
    """List what filters that all channels have in common may take off the force.

    Yields
    ------
    Nuisance
        Of each corner and order.
    """
    for corner_hz, order in product(_CORNERS_HZ, _ORDERS):
        transfer = butterworth_in_time(corner_hz, order)
        yield Nuisance(
            name=f"common filter, {corner_hz:g} Hz, order {order}", std=_STD,
            signature=filtered([(1.0, transfer)]), transfer=transfer,
        )  # fmt: skip


def filtered(filters: Sequence[tuple[float, TransferFunction]]) -> SignatureFunction:
    """What several filters, each times an amplitude, change of the force: of that one spectrum is enough for all.

    Parameters
    ----------
    filters : sequence of (float, callable)
        Amplitude, and frequency in Hz -> complex gain.
    """

    def transfer(f: Floats) -> Complexes:
        return 1.0 + np.sum([size * (gain(f) - 1.0) for size, gain in filters], axis=0)

    return partial(_rounded, transfer=transfer)


def butterworth_in_time(corner_hz: float, order: int) -> TransferFunction:
    """Low-pass of Butterworth, with the delay of slow signals taken off.

    Parameters
    ----------
    corner_hz : float
        Where half of the power is left.
    order : int
        Even.

    Returns
    -------
    callable
        Frequency in Hz, of any shape -> complex gain of that shape.
    """
    dampings = np.sin(0.5 * np.pi * np.arange(1, order, 2) / order)
    late_s = [float(damping) / (np.pi * corner_hz) for damping in dampings]
    parts = [delay(-sum(late_s)), *map(low_pass, late_s, dampings)]
    return lambda f: np.prod([part(f) for part in parts], axis=0)


def _rounded(baseline: Baseline, state: State, *, transfer: TransferFunction) -> Signature:
    if state.force_n is None:
        return {}
    expected = baseline.expected_force(state)
    return {"cutting": Spectrum(expected, state).through(transfer) - expected}
