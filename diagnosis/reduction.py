"""From one recording to its `State`s: strokes averaged over the crank angle, and the start-up over time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bench.processed import CrankAngle
from bench.recording import Floats, Recording
from bench.units import CHANNEL_BY_NAME, DISPLACEMENT
from diagnosis.state import TWO_PI, State, TrialSetting

N_POINTS = 128
N_HARMONICS = 40
MIN_SAMPLES_PER_BIN = 1.5
_MIN_COVERAGE = 0.5
# A crank that is slower stands.
MOVING_RAD_S = 2.0
START_UP_S = 0.4
START_UP_STEP_S = 1e-3
# Channels of a recording and where they stand in a state.
CHANNEL_OF_STATE: Final = MappingProxyType(
    {
        "motor_current_a": "current_a",
        "force_n": "force_n",
        "battery_voltage_v": "battery_voltage_v",
        "battery_current_a": "battery_current_a",
    }
)
# Turns this much longer than usual are no running strokes; two more before them belong to the stop.
_SLOW_TURN = 1.5
_STOPPING_TURNS = 2
_SPIN_UP_S = 0.8
# A harmonic counts in a signature as far as its power is above that many times its own variance.
_NOISE_MARGIN = 3.0
_MIN_ROWS_TO_SHRINK = 4
# Displacement that far from the tracked one, as a share of the radius, is a spike; play is less.
_SPIKE = 0.1
# Below it the force says nothing of the angle.
_LEAST_SWING_N = 3.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Grid:
    """Which sample belongs to which unit and angle bin.

    Attributes
    ----------
    first_turn : int
        Turn number at which the first unit starts.
    turns_per_unit : int
    n_units : int
    """

    first_turn: int
    turns_per_unit: int
    n_units: int

    def place(self, angle_rad: Floats, n_points: int = N_POINTS) -> np.ndarray:
        """Flat index unit * n_points + bin of each sample, -1 outside."""
        turns = angle_rad / TWO_PI - self.first_turn
        unit = np.floor(turns / self.turns_per_unit).astype(np.int64)
        part = turns - np.floor(turns)
        cell = np.minimum((part * n_points).astype(np.int64), n_points - 1)
        flat = unit * n_points + cell
        flat[(unit < 0) | (unit >= self.n_units)] = -1
        return flat


def lay_grid(
    angle: CrankAngle, start_s: float, end_s: float, slowest_rate_hz: float, *, target_units: int = 16
) -> Grid | None:
    """Choose units of whole turns between two times, long enough to fill every bin.

    Returns
    -------
    Grid or None
        None where there are not two complete turns.
    """
    inside = (angle.time_s >= start_s) & (angle.time_s <= end_s)
    if inside.sum() < 8:
        return None
    turns = angle.angle_rad[inside] / TWO_PI
    first, last = int(np.ceil(turns[0])), int(np.floor(turns[-1]))
    n_turns = last - first
    if n_turns < 2:
        return None
    period_s = (angle.time_s[inside][-1] - angle.time_s[inside][0]) / (turns[-1] - turns[0])
    needed = int(np.ceil(MIN_SAMPLES_PER_BIN * N_POINTS / max(slowest_rate_hz * period_s, 1e-9)))
    per_unit = min(max(needed, n_turns // target_units, 1), n_turns)
    return Grid(first_turn=first, turns_per_unit=per_unit, n_units=n_turns // per_unit)


def fold(values: Floats, flat: np.ndarray, n_units: int, n_points: int = N_POINTS) -> Floats:
    """Mean of the samples in each bin, band-limited to `N_HARMONICS`, shape (n_units, n_points).

    The droop of the bin average is undone. Empty bins are interpolated over the turn.
    """
    keep = flat >= 0
    size = n_units * n_points
    count = np.bincount(flat[keep], minlength=size).reshape(n_units, n_points)
    total = np.bincount(flat[keep], weights=values[keep], minlength=size).reshape(n_units, n_points)
    mean = total / np.maximum(count, 1)
    for unit in np.flatnonzero((count == 0).any(axis=1)):
        filled = np.flatnonzero(count[unit])
        if len(filled) >= 2:
            mean[unit] = np.interp(np.arange(n_points), filled, mean[unit][filled], period=n_points)
    return band_limit(mean)


def band_limit(waves: Floats, n_harmonics: int = N_HARMONICS) -> Floats:
    """Keep the first harmonics of periodic rows and undo the droop of the bin average."""
    n_points = waves.shape[-1]
    spectrum = np.fft.rfft(waves, axis=-1)
    order = np.arange(spectrum.shape[-1])
    spectrum = spectrum / np.sinc(order / n_points)
    spectrum[..., n_harmonics + 1 :] = 0.0
    return np.fft.irfft(spectrum, n_points, axis=-1)


def smooth_state(state: State, blocks: Floats, *, radius_m: float, n_harmonics: int = 5) -> State:
    """State to compute signatures from: averaged over the units, the crank's motion limited to a few harmonics.

    A residual and a signature that share the same noise would shrink every parameter of the equation they stand
    in (errors in variables); averaging first takes that noise out of the signature.

    Parameters
    ----------
    state : State
    blocks : ndarray, shape (n_blocks, n_units)
        Averages units into time blocks; only the slow states differ from block to block.
    radius_m : float
        Of the crank: what the speed loses in harmonics, the blade's velocity keeps.
    n_harmonics : int

    Returns
    -------
    State
        Arrays of shape (n_blocks, n_points); a start-up comes back as it is.
    """
    if state.kind != "running":
        return state
    shape = (len(blocks), state.angle_rad.shape[1])

    def mean(wave: Floats | None, n: int, *, shrunk: bool = True) -> Floats | None:
        if wave is None:
            return None
        rows = np.fft.rfft(wave, axis=1)
        spectrum = rows.mean(axis=0) * (_signal_share(rows) if shrunk else 1.0)
        spectrum[n + 1 :] = 0.0
        return np.broadcast_to(np.fft.irfft(spectrum, shape[1]), shape)

    speed = mean(state.speed_rad_s, n_harmonics, shrunk=False)
    assert speed is not None
    changes: dict[str, Any] = {"speed_rad_s": speed, "acceleration_rad_s2": speed * angle_derivative(speed)}
    if state.blade_excess_m_s is not None and len(state.speed_rad_s) < _MIN_ROWS_TO_SHRINK:
        changes["blade_excess_m_s"] = None
    elif state.blade_excess_m_s is not None:
        beyond = (state.speed_rad_s - speed[:1]) * radius_m * np.sin(state.angle_rad) + state.blade_excess_m_s
        changes["blade_excess_m_s"] = mean(beyond, N_HARMONICS)
    for name in ("current_a", "current_rate_a_s", "battery_current_a"):
        changes[name] = mean(getattr(state, name), 2 * n_harmonics)
    for name in ("force_n", "force_rate_n_s"):
        changes[name] = mean(getattr(state, name), N_HARMONICS)
    for name in ("angle_rad", "battery_voltage_v", "motor_voltage_v", "time_s", "cut_distance_m", "charge_used_as"):
        wave = getattr(state, name)
        changes[name] = None if wave is None else blocks @ wave
    changes["slow"] = {name: blocks @ track for name, track in state.slow.items()}
    changes["n_strokes"] = (blocks > 0) @ state.n_strokes
    return replace(state, **changes)


def _signal_share(spectra: NDArray[np.complex128]) -> Floats:
    """Factor on each harmonic of the mean of rows: 1 where it is certain, 0 where it is no more than noise.

    Squared noise in a signature is evidence out of nothing wherever the residual holds the same noise.
    """
    n = len(spectra)
    if n < _MIN_ROWS_TO_SHRINK:
        return np.ones(spectra.shape[1])
    variance = np.sum(np.abs(np.diff(spectra, axis=0)) ** 2, axis=0) / (2.0 * (n - 1) * n)
    power = np.maximum(np.abs(spectra.mean(axis=0)) ** 2, 1e-30)
    share = np.clip(1.0 - _NOISE_MARGIN * variance / power, 0.0, 1.0)
    share[0] = 1.0
    return share


def angle_derivative(waves: Floats) -> Floats:
    """Derivative of periodic rows with respect to the crank angle."""
    n_points = waves.shape[-1]
    spectrum = np.fft.rfft(waves, axis=-1)
    spectrum *= 1j * np.arange(spectrum.shape[-1])
    return np.fft.irfft(spectrum, n_points, axis=-1)


def first_motion_s(angle: CrankAngle) -> float:
    """Time at which the crank begins to turn; the first sample where it turns all along."""
    return float(angle.time_s[np.argmax(angle.speed_rad_s > MOVING_RAD_S)])


def steady_part(angle: CrankAngle, moving_s: float) -> tuple[float, float]:
    """Longest stretch in which the blade neither stands nor spins down.

    Parameters
    ----------
    angle : CrankAngle
    moving_s : float
        Time of the first motion.

    Returns
    -------
    start_s, end_s : float
        `moving_s` and the end of the record where nothing interrupts the trial.
    """
    turns = np.arange(np.ceil(angle.angle_rad[0] / TWO_PI), np.floor(angle.angle_rad[-1] / TWO_PI) + 1)
    ends_s = np.interp(TWO_PI * turns, angle.angle_rad, angle.time_s)
    ends_s = ends_s[ends_s >= moving_s]
    last_s = float(angle.time_s[-1])
    if len(ends_s) < 3:
        return moving_s, last_s
    usual_s = float(np.median(np.diff(ends_s)))
    # The spin-up is no stop; a record may end within a turn.
    edges_s = np.concatenate([[moving_s], ends_s, [last_s]])
    slow = np.diff(edges_s) > _SLOW_TURN * usual_s
    slow &= edges_s[1:] > moving_s + _SPIN_UP_S
    best, start, length = (0, len(slow)), 0, -1
    for stop in [*np.flatnonzero(slow).tolist(), len(slow)]:
        if stop - start > length:
            length, best = stop - start, (start, stop)
        start = stop + 1
    first, last = best
    if last < len(slow):
        last = max(last - _STOPPING_TURNS, first)
    return float(edges_s[first]), float(edges_s[last])


def lock_to_angle(state: State) -> tuple[str, complex] | None:
    """How force (in wood) or current (in air) repeats with the crank angle from unit to unit.

    A displacement that belongs to another trial drifts against the other channels: the phases of their first or
    second harmonic then scatter over the turn.

    Parameters
    ----------
    state : State

    Returns
    -------
    (str, complex) or None
        Which wave was judged; its mean phase, and as modulus how well the units agree (1 perfectly). None where
        there is nothing to judge by.
    """
    # In air the force is noise, and the reciprocating mass gives the current its second harmonic.
    name, wave, order = "current in air", state.current_a, 2
    if not state.setting.is_idle:
        name, order = "current", 1
        if state.force_n is not None:
            name, wave = "force", state.force_n
            swing_n = 2.0 / N_POINTS * float(np.abs(np.fft.rfft(wave, axis=1)[:, 1]).mean())
            if swing_n < _LEAST_SWING_N:
                return None
    if wave is None:
        return None
    parts = np.fft.rfft(wave, axis=1)[:, order]
    size = float(np.abs(parts).sum())
    return (name, complex(parts.sum() / size)) if size > 0 else None


def running_state(
    recording: Recording, angle: CrankAngle, setting: TrialSetting, start_s: float, end_s: float
) -> State | None:
    """Average the running strokes of a trial in units of a few turns.

    Parameters
    ----------
    recording : Recording
    angle : CrankAngle
    setting : TrialSetting
    start_s, end_s : float
        The settled part of the trial.

    Returns
    -------
    State or None
        None where fewer than two turns are complete. Slow states are still zero.
    """
    present = {n: recording.signals[n] for n in CHANNEL_OF_STATE if n in recording.signals}
    slowest = min([s.rate_hz for s in present.values()], default=0.0)
    grid = lay_grid(angle, start_s, end_s, slowest)
    if grid is None:
        return None
    flat = grid.place(angle.angle_rad)
    is_covered = _coverage(flat, grid.n_units) > _MIN_COVERAGE
    placed = {}
    for name, signal in present.items():
        at_samples = grid.place(np.interp(signal.time_s, angle.time_s, angle.angle_rad))
        at_samples[_in_gap(signal.time_s, angle.time_s, np.pi / (2.0 * np.median(angle.speed_rad_s)))] = -1
        has_samples = _coverage(at_samples, grid.n_units) > _MIN_COVERAGE
        # A channel that is mostly away is missing; one that drops out now and then costs the strokes it misses.
        if 2 * (has_samples & is_covered).sum() > is_covered.sum():
            placed[name] = at_samples
            is_covered &= has_samples
    if is_covered.sum() < 2 <= grid.n_units or not is_covered.any():
        return None
    # The mean over angle of 1/speed is the time a turn takes: fold the slowness, not the speed.
    speed = 1.0 / fold(1.0 / np.maximum(angle.speed_rad_s, 1e-3), flat, grid.n_units)[is_covered]
    waves = {
        name: fold(present[name].values * CHANNEL_BY_NAME[name].si_factor, at_samples, grid.n_units)[is_covered]
        for name, at_samples in placed.items()
    }
    points = (np.arange(N_POINTS) + 0.5) * TWO_PI / N_POINTS
    turns = grid.first_turn + (np.flatnonzero(is_covered) + 0.5) * grid.turns_per_unit
    middle_s = np.interp(turns * TWO_PI, angle.angle_rad, angle.time_s)[:, None]
    state = _assemble(
        "running", setting, np.broadcast_to(points, speed.shape), speed, speed * angle_derivative(speed), waves,
        {name: speed * angle_derivative(wave) for name, wave in waves.items()},
        middle_s, np.full(len(speed), float(grid.turns_per_unit)),
    )  # fmt: skip
    missed = _missed_stroke(recording, angle, grid)
    return state if missed is None else replace(state, blade_excess_m_s=speed * angle_derivative(missed[is_covered]))


def _missed_stroke(recording: Recording, angle: CrankAngle, grid: Grid) -> Floats | None:
    """What the displacement goes beyond that of the tracked angle, m, shape (n_units, n_points)."""
    signal = recording.signals.get(DISPLACEMENT.name)
    if signal is None:
        return None
    turned = np.interp(signal.time_s, angle.time_s, angle.angle_rad)
    beyond = DISPLACEMENT.si_factor * signal.values - angle.radius_m * (1.0 - np.cos(turned))
    at_samples = grid.place(turned)
    at_samples[np.abs(beyond) > _SPIKE * angle.radius_m] = -1
    return fold(beyond, at_samples, grid.n_units)


def _coverage(flat: np.ndarray, n_units: int) -> Floats:
    """Share of the angle bins of each unit that hold a sample, shape (n_units,)."""
    filled = np.zeros(n_units * N_POINTS)
    filled[flat[flat >= 0]] = 1.0
    return filled.reshape(n_units, N_POINTS).mean(axis=1)


def _in_gap(time_s: Floats, angle_time_s: Floats, longest_s: float) -> np.ndarray:
    """Whether a sample lies where the angle was not measured for longer than a quarter turn."""
    after = np.clip(np.searchsorted(angle_time_s, time_s), 1, len(angle_time_s) - 1)
    return angle_time_s[after] - angle_time_s[after - 1] > longest_s


def start_up_state(recording: Recording, angle: CrankAngle, setting: TrialSetting, start_s: float) -> State | None:
    """Signals of the spin-up on a 1 ms grid, shape (1, n_times), or None where it was not recorded."""
    present = {n: recording.signals[n] for n in CHANNEL_OF_STATE if n in recording.signals}
    if "motor_current_a" not in present or start_s + START_UP_S > angle.time_s[-1]:
        return None
    edges = start_s + np.arange(0.0, START_UP_S + START_UP_STEP_S / 2, START_UP_STEP_S)
    middle = 0.5 * (edges[1:] + edges[:-1])
    if any(s.rate_hz < 0.9 / START_UP_STEP_S for s in present.values()):
        return None
    # A channel that drops out during the spin-up counts as missing there.
    present = {
        n: s for n, s in present.items()
        if len(np.unique(np.searchsorted(edges, s.time_s))) - 2 > _MIN_COVERAGE * len(middle)
    }  # fmt: skip
    if "motor_current_a" not in present:
        return None
    waves = {n: bin_means(s.time_s, s.values, edges)[None, :] for n, s in present.items()}
    crank = np.interp(middle, angle.time_s, angle.angle_rad)[None, :]
    speed = bin_means(angle.time_s, angle.speed_rad_s, edges)[None, :]
    rate = {n: np.gradient(w, START_UP_STEP_S, axis=1) for n, w in waves.items()}
    return _assemble(
        "start_up", setting, crank, speed, np.gradient(speed, START_UP_STEP_S, axis=1), waves, rate,
        np.array([[start_s]]), np.ones(1),
    )  # fmt: skip


def bin_means(time_s: Floats, values: Floats, edges: Floats) -> Floats:
    """Mean between neighbouring edges of the line through the samples, shape (len(edges) - 1,).

    With about one sample a cell, the mean of the samples alone would be that of another time.
    """
    before, after = min(time_s[0], edges[0]) - 1e-9, max(time_s[-1], edges[-1]) + 1e-9
    t = np.concatenate([[before], time_s, [after]])
    v = np.concatenate([values[:1], values, values[-1:]])
    area = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
    k = np.clip(np.searchsorted(t, edges, side="right") - 1, 0, len(t) - 2)
    into = edges - t[k]
    slope = (v[k + 1] - v[k]) / np.maximum(t[k + 1] - t[k], 1e-12)
    return np.diff(area[k] + (v[k] + 0.5 * slope * into) * into) / np.diff(edges)


def _assemble(kind, setting, angle_rad, speed, acceleration, waves, rates, time_s, n_strokes) -> State:
    voltage = waves.get("battery_voltage_v")
    nothing = np.zeros_like(time_s)
    return State(
        kind=kind,
        setting=setting,
        angle_rad=np.asarray(angle_rad),
        speed_rad_s=speed,
        acceleration_rad_s2=acceleration,
        current_a=waves.get("motor_current_a"),
        current_rate_a_s=rates.get("motor_current_a"),
        force_n=waves.get("force_n"),
        force_rate_n_s=rates.get("force_n"),
        battery_voltage_v=voltage,
        battery_current_a=waves.get("battery_current_a"),
        motor_voltage_v=np.full(speed.shape, np.nan) if voltage is None else setting.duty * voltage,
        time_s=time_s,
        cut_distance_m=nothing,
        charge_used_as=nothing,
        n_strokes=n_strokes,
    )
