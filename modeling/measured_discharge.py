"""Measured discharges of a battery: found in what a tester logged, and ended at a common cut-off voltage."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.errors import InputError

Floats = NDArray[np.float64]
# A current below this share of the largest is a rest.
_REST_SHARE: Final = 0.02
# A discharge that delivers less than this share of the most charged one of its log is no whole one.
_WHOLE_SHARE: Final = 0.5


@dataclass(frozen=True, kw_only=True, slots=True)
class MeasuredDischarge:
    """One discharge from full charge.

    Attributes
    ----------
    time_s, current_a, voltage_v : ndarray, shape (n,)
        Current positive when the battery delivers.
    label : str
    start_temperature_c : float or None
        Of the cell when the discharge began: that of its surroundings, before it warmed itself.
    cycle : float or None
        Charges and discharges that the cell had been through.

    Examples
    --------
    >>> discharge = MeasuredDischarge(time_s=[0, 3600], current_a=[2, 2], voltage_v=[4.0, 3.0], label="cell")
    >>> discharge.charge_a_s.tolist(), discharge.mean_current_a
    ([0.0, 7200.0], 2.0)
    """

    time_s: Floats
    current_a: Floats
    voltage_v: Floats
    label: str = "discharge"
    start_temperature_c: float | None = None
    cycle: float | None = None

    def __post_init__(self) -> None:
        for name in ("time_s", "current_a", "voltage_v"):
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.ndim != 1 or len(array) < 2 or array.shape != np.shape(self.time_s):
                raise InputError(f"{name} has shape {array.shape}, expected two values or more", where=self.label)
            if not np.isfinite(array).all():
                raise InputError(f"{name} has values that are not finite", where=self.label)
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if np.diff(self.time_s).min() < 0:
            raise InputError("time_s decreases", where=self.label)
        if not self.charge_a_s[-1] > 0:
            raise InputError(
                "delivers no charge",
                where=self.label,
                remedy="give the current positive when the battery delivers",
            )

    @property
    def charge_a_s(self) -> Floats:
        """Charge delivered until each sample, A*s, shape (n,)."""
        mean_a = 0.5 * (self.current_a[1:] + self.current_a[:-1])
        return np.concatenate([[0.0], np.cumsum(np.diff(self.time_s) * mean_a)])

    @property
    def duration_s(self) -> float:
        """From the first to the last sample, s."""
        return float(self.time_s[-1] - self.time_s[0])

    @property
    def mean_current_a(self) -> float:
        """Charge over duration, A."""
        return float(self.charge_a_s[-1] / self.duration_s)

    def ended_at(self, cutoff_voltage_v: float) -> MeasuredDischarge:
        """Return the discharge until its voltage first falls to the cut-off, the last sample interpolated.

        Raises
        ------
        InputError
            If the voltage starts below the cut-off or never falls to it.
        """
        below = np.flatnonzero(self.voltage_v <= cutoff_voltage_v)
        if not len(below) or below[0] == 0:
            first, last = float(self.voltage_v[0]), float(self.voltage_v.min())
            raise InputError(
                f"runs from {first:.4g} V to {last:.4g} V: it does not reach the cut-off of {cutoff_voltage_v:.4g} V",
                where=self.label,
                remedy="leave out this discharge, or give a cut-off voltage that all discharges reach",
            )
        k = int(below[0])
        high, low = float(self.voltage_v[k - 1]), float(self.voltage_v[k])
        share = (high - cutoff_voltage_v) / (high - low)
        ended = {
            name: np.append(values[:k], values[k - 1] + share * (values[k] - values[k - 1]))
            for name in ("time_s", "current_a", "voltage_v")
            for values in (getattr(self, name),)
        }
        return replace(self, **ended)


@dataclass(frozen=True, kw_only=True, slots=True)
class BatteryLog:
    """What a battery tester logged: charges, rests and discharges one after the other.

    Attributes
    ----------
    time_s, current_a, voltage_v : ndarray, shape (n,)
        The current with a sign, positive on discharge or on charge.
    label : str
    temperature_c, cycle : ndarray, shape (n,), or None
    """

    time_s: Floats
    current_a: Floats
    voltage_v: Floats
    label: str
    temperature_c: Floats | None = None
    cycle: Floats | None = None


def discharges_in(log: BatteryLog) -> tuple[list[MeasuredDischarge], list[str]]:
    """Find the whole discharges in a log: from the first current after a charge to the last before the next one.

    Which sign of the current discharges is told from the voltage, which then falls. Rests inside a discharge stay.

    Returns
    -------
    discharges : list of MeasuredDischarge
    notes : list of str
        What was turned round or left out.

    Raises
    ------
    InputError
        If the log has no discharge.

    Examples
    --------
    >>> log = BatteryLog(
    ...     time_s=np.arange(6.0), current_a=np.array([0, -2, -2, 0, 1, 1.0]),
    ...     voltage_v=np.array([4.1, 4.0, 3.5, 3.9, 4.0, 4.1]), label="cell",
    ... )
    >>> found, notes = discharges_in(log)
    >>> found[0].time_s.tolist(), found[0].current_a.tolist(), notes
    ([0.0, 1.0], [2.0, 2.0], ['cell: the current is negative on discharge; its sign was reversed'])
    """
    largest_a = float(np.abs(log.current_a).max(initial=0.0))
    spans_by_sign = {sign: _spans(sign * log.current_a, _REST_SHARE * largest_a) for sign in (1, -1)}
    falling = {
        sign: [span for span in spans if log.voltage_v[span[1]] < log.voltage_v[span[0]]]
        for sign, spans in spans_by_sign.items()
    }
    sign = max(falling, key=lambda s: max((_moved(log, span) for span in falling[s]), default=0.0))
    if largest_a == 0.0 or not falling[sign]:
        raise InputError(
            "contains no discharge: the voltage never falls while a current flows in one direction",
            where=log.label,
            remedy="check which columns are current and voltage; the current must have a sign",
        )
    notes = [f"{log.label}: the current is negative on discharge; its sign was reversed"] if sign < 0 else []
    most = max(_moved(log, span) for span in falling[sign])
    whole = [span for span in falling[sign] if _moved(log, span) >= _WHOLE_SHARE * most]
    if len(whole) < len(falling[sign]):
        n_short = len(falling[sign]) - len(whole)
        notes.append(f"{log.label}: left out {n_short} that deliver less than {_WHOLE_SHARE:.0%} of the largest one")
    return [_cut_out(log, span, sign, number, len(whole)) for number, span in enumerate(whole, start=1)], notes


def _spans(current_a: Floats, threshold_a: float) -> list[tuple[int, int]]:
    """First and last sample of each stretch of positive current, two or more, that no negative one interrupts."""
    charges = np.concatenate(([-1], np.flatnonzero(current_a < -threshold_a), [len(current_a)]))
    spans = []
    for before, after in itertools.pairwise(charges):
        active = np.flatnonzero(current_a[before + 1 : after] > threshold_a)
        if len(active) > 1:
            spans.append((int(before + 1 + active[0]), int(before + 1 + active[-1])))
    return spans


def _moved(log: BatteryLog, span: tuple[int, int]) -> float:
    part = slice(span[0], span[1] + 1)
    return float(abs(np.trapezoid(log.current_a[part], log.time_s[part])))


def _cut_out(log: BatteryLog, span: tuple[int, int], sign: int, number: int, count: int) -> MeasuredDischarge:
    part = slice(span[0], span[1] + 1)
    time_s = log.time_s[part]
    return MeasuredDischarge(
        time_s=time_s - time_s[0],
        current_a=sign * log.current_a[part],
        voltage_v=log.voltage_v[part],
        label=f"{log.label} #{number}" if count > 1 else log.label,
        start_temperature_c=None if log.temperature_c is None else float(log.temperature_c[span[0]]),
        cycle=None if log.cycle is None else float(log.cycle[span[0]]),
    )


def common_cutoff(discharges: Sequence[MeasuredDischarge]) -> float:
    """Return the voltage that all discharges fall to: the highest of their lowest voltages, V."""
    return max(float(d.voltage_v.min()) for d in discharges)
