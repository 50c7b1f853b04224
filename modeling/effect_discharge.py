"""A whole discharge of a saw with known effects: its periodic strokes over the state of charge, and its slow states.

    T = integral of dQ / i_b(Q)

by Gauss's rule over the charge, where i_b is the mean battery current of the periodic stroke that carries the heat,
polarisation and wear which the discharge has built up until then. These are integrated along the discharge and the
strokes solved again until the runtime stands. The spin-up, some tenths of a second, is not counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.polynomial import legendre
from sawbench.bench.errors import InputError
from sawbench.bench.recording import Floats
from sawbench.modeling.discharge import N_CURVE_POINTS, Discharge, DischargeCurves, EndedBy, quadrature_error
from sawbench.modeling.effects.current_limit import beyond_limit
from sawbench.modeling.effects.learned import out_of_range
from sawbench.modeling.operating_point import OperatingPoint, check_scales, mean_over_time, periodic_stroke
from sawbench.modeling.residuals import Baseline
from sawbench.modeling.state import TWO_PI, Memory
from sawbench.modeling.stroke import Prediction

N_NODES: Final = 8
_MOST_PASSES: Final = 8
_SETTLED: Final = 1e-4
_N_HISTORY: Final = 400
# The end of a discharge stands where it moves by less than this share of the capacity.
_SAME_END: Final = 1e-7
_MOST_ENDS: Final = 12


@dataclass(frozen=True, kw_only=True, slots=True)
class _Means:
    """Of the strokes at the nodes, over time; shape (n_nodes,) each."""

    battery_a: Floats
    motor_a: Floats
    motor_squared_a2: Floats
    crank_squared_rad2_s2: Floats
    battery_v: Floats
    rate_hz: Floats


def discharge_with_effects(
    baseline: Baseline,
    point: OperatingPoint,
    *,
    cutoff_soc: float = 0.2,
    cutoff_voltage_v: float | None = None,
    n_nodes: int = N_NODES,
    start: Prediction | None = None,
) -> Discharge:
    """Run the battery down from the charge of an operating point.

    Parameters
    ----------
    baseline : Baseline
        With a battery.
    point : OperatingPoint
        Where it starts: charge used, distance cut, slow states.
    cutoff_soc : float
    cutoff_voltage_v : float, optional
        Ends earlier where the battery voltage, mean over a stroke, falls to this.
    n_nodes : int
    start : Prediction, optional
        Of a stroke nearby, to search from.

    Raises
    ------
    InputError
        Without a battery, with a cut-off above the start, or where an effect cannot be predicted without a campaign.
    """
    if baseline.battery is None:
        raise InputError("a discharge needs a battery", remedy="fill in [battery]")
    check_scales(baseline)
    capacity_as = 3600.0 * baseline.battery.capacity_ah
    end_as = capacity_as * (1.0 - cutoff_soc)
    if point.charge_used_as >= end_as:
        raise InputError(f"cutoff_soc {cutoff_soc} must be below the state of charge at the start")
    run = _Run(baseline, point, n_nodes, start)
    means = run.to(end_as)
    moved_as = 0.0
    if means is not None and cutoff_voltage_v is not None:
        for _ in range(_MOST_ENDS):
            before_as, last_as = run.span_as, run.charge_at_voltage(means.battery_v, cutoff_voltage_v, end_as)
            moved_as = abs(last_as - point.charge_used_as - before_as)
            if moved_as < _SAME_END * capacity_as:
                break
            means = run.to(max(last_as, point.charge_used_as + 1e-6 * capacity_as))
            if means is None:
                break
    if means is None:
        return _stalled()
    states = [stroke.state for stroke in run.strokes if stroke is not None]
    runtime_s, span_as = run.integral(1.0 / means.battery_a), run.span_as
    numerical_error_s = quadrature_error(1.0 / means.battery_a[::-1], span_as) + moved_as / float(means.battery_a[-1])
    ended_by: EndedBy = "voltage" if point.charge_used_as + span_as < end_as else "soc"
    return Discharge(
        runtime_s=runtime_s,
        mean_battery_current_a=span_as / runtime_s,
        mean_motor_current_a=run.integral(means.motor_a / means.battery_a) / runtime_s,
        n_strokes=run.integral(means.rate_hz / means.battery_a),
        ended_by=ended_by,
        status="ok",
        message="reached the cut-off",
        numerical_error_s=numerical_error_s,
        notes=(*out_of_range(baseline.known, baseline, states), *beyond_limit(baseline.known, states)),
        _make_curves=lambda: run.curves(means, capacity_as),
    )


class _Run:
    """Strokes at the nodes of one discharge, from a start to an end that may be moved."""

    def __init__(self, baseline: Baseline, point: OperatingPoint, n_nodes: int, start: Prediction | None) -> None:
        self.baseline, self.point = baseline, point
        self.places, self.weights = legendre.leggauss(n_nodes)
        self.has_history = any(
            k.effect.memories or k.effect.strokes is not None or "time" in k.effect.grows_with for k in baseline.known
        )
        self.memories: tuple[Memory, ...] = tuple({m: None for k in baseline.known for m in k.effect.memories})
        self.strokes: list[Prediction | None] = [start] * n_nodes
        self.span_as = 0.0

    def to(self, end_as: float) -> _Means | None:
        """Means at the nodes of a discharge that ends there; None where the machine stalls before."""
        self.span_as = end_as - self.point.charge_used_as
        points = [replace(self.point, charge_used_as=float(used)) for used in self._at_nodes()]
        means, before_s = self._solve(points), 0.0
        for _ in range(_MOST_PASSES if self.has_history else 0):
            if means is None:
                break
            runtime_s = self.integral(1.0 / means.battery_a)
            if abs(runtime_s - before_s) < _SETTLED * runtime_s:
                break
            before_s = runtime_s
            means = self._solve(self._with_history(points, means))
        return means

    def integral(self, values: Floats) -> float:
        """Integral over the charge of what is known at the nodes."""
        return float(0.5 * self.span_as * self.weights @ values)

    def charge_at_voltage(self, voltage_v: Floats, cutoff_v: float, end_as: float) -> float:
        """Charge used at which the voltage has fallen to the cut-off, `end_as` at most.

        What the load takes off the open-circuit voltage is interpolated, and held beyond the last stroke.
        """
        from scipy.optimize import brentq

        taken_v = self.baseline.open_circuit_voltage(self._at_nodes()) - voltage_v
        used_as = np.linspace(self.point.charge_used_as, end_as, _N_HISTORY)

        def above_v(used: Floats) -> Floats:
            share = np.minimum(2.0 * (used - self.point.charge_used_as) / self.span_as - 1.0, 1.0)
            return self.baseline.open_circuit_voltage(used) - self._between(taken_v, share) - cutoff_v

        below = above_v(used_as) <= 0.0
        if not below.any():
            return end_as
        first = int(np.argmax(below))
        if first == 0:
            return float(used_as[0])
        return float(brentq(lambda used: above_v(np.array([used]))[0], used_as[first - 1], used_as[first]))

    def curves(self, means: _Means, capacity_as: float) -> DischargeCurves:
        """Means along the discharge."""
        share = np.linspace(-1.0, 1.0, N_CURVE_POINTS)
        return DischargeCurves(
            time_s=self._times(means, share),
            soc=1.0 - (self.point.charge_used_as + 0.5 * (share + 1.0) * self.span_as) / capacity_as,
            battery_voltage_v=self._between(means.battery_v, share),
            battery_current_a=self._between(means.battery_a, share),
            motor_current_a=self._between(means.motor_a, share),
            stroke_rate_hz=self._between(means.rate_hz, share),
        )

    def _at_nodes(self) -> Floats:
        return self.point.charge_used_as + 0.5 * (self.places + 1.0) * self.span_as

    def _solve(self, points: Sequence[OperatingPoint]) -> _Means | None:
        near: Prediction | None = None
        for n, point in enumerate(points):
            near = periodic_stroke(self.baseline, point, start=self.strokes[n] or near)
            if not near.is_settled:
                return None
            self.strokes[n] = near
        means = _means([stroke for stroke in self.strokes if stroke is not None])
        return means if np.all(means.battery_a > 0.0) else None

    def _between(self, values: Floats, share: Floats) -> Floats:
        """Value of the polynomial through the nodes, at places from -1 (start) to 1 (end)."""
        fitted = legendre.legfit(self.places, values, len(values) - 1)
        return np.asarray(legendre.legval(share, fitted), dtype=np.float64)

    def _times(self, means: _Means, share: Floats) -> Floats:
        slowness = legendre.legint(legendre.legfit(self.places, 1.0 / means.battery_a, len(self.places) - 1), lbnd=-1)
        return np.asarray(0.5 * self.span_as * legendre.legval(share, slowness), dtype=np.float64)

    def _with_history(self, points: Sequence[OperatingPoint], means: _Means) -> list[OperatingPoint]:
        """Operating points with what the discharge has built up before each."""
        share = np.linspace(-1.0, 1.0, _N_HISTORY)
        time_s = self._times(means, share)
        travel_m = 2.0 * self.baseline.radius_m * self._between(means.rate_hz, share)
        is_cutting = self.point.k_fc_n_s_per_m > 0.0
        cut_m = np.concatenate([[0.0], np.cumsum(0.5 * (travel_m[1:] + travel_m[:-1]) * np.diff(time_s))])
        drives = {
            "motor_current_squared_a2": means.motor_squared_a2,
            "crank_speed_squared_rad2_s2": means.crank_squared_rad2_s2,
            "battery_current_a": means.battery_a,
        }
        tracks = {
            memory: _followed(
                self._between(drives[memory.drive], share), time_s, memory.time_constant_s,
                self.point.slow.get(memory, 0.0),
            )
            for memory in self.memories
        }  # fmt: skip
        return [
            replace(
                point,
                time_s=self.point.time_s + float(np.interp(place, share, time_s)),
                cut_distance_m=self.point.cut_distance_m + float(np.interp(place, share, cut_m)) * is_cutting,
                slow={memory: float(np.interp(place, share, track)) for memory, track in tracks.items()},
            )
            for point, place in zip(points, self.places, strict=True)
        ]


def _followed(drive: Floats, time_s: Floats, time_constant_s: float, begin: float) -> Floats:
    """First-order memory of a drive that is even over each interval."""
    held = np.empty_like(drive)
    held[0] = begin
    keep = np.exp(-np.diff(time_s) / time_constant_s)
    middle = 0.5 * (drive[1:] + drive[:-1])
    for n in range(len(keep)):
        held[n + 1] = middle[n] + (held[n] - middle[n]) * keep[n]
    return held


def _means(strokes: Sequence[Prediction]) -> _Means:
    rows = []
    for stroke in strokes:
        state = stroke.state
        assert state.current_a is not None
        rows.append(
            (
                mean_over_time(state, state.battery_current_a),
                mean_over_time(state, state.current_a),
                mean_over_time(state, state.current_a**2),
                mean_over_time(state, state.speed_rad_s**2),
                mean_over_time(state, state.battery_voltage_v),
                float(1.0 / np.mean(TWO_PI / state.speed_rad_s)),
            )
        )
    return _Means(**dict(zip(_Means.__dataclass_fields__, np.array(rows).T, strict=True)))


def _stalled() -> Discharge:
    nothing = np.zeros(0)
    return Discharge(
        runtime_s=0.0,
        mean_battery_current_a=0.0,
        mean_motor_current_a=0.0,
        n_strokes=0.0,
        ended_by="stall",
        status="stalled",
        message="the model with its effects has no periodic stroke down to the cut-off",
        numerical_error_s=0.0,
        _make_curves=lambda: DischargeCurves(**dict.fromkeys(DischargeCurves.__dataclass_fields__, nothing)),
    )
