"""From one tracked trial to its `State`s: strokes averaged over the crank angle, and the start-up over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from sawbench.bench.converter import rounding_variance
from sawbench.bench.processed import CrankAngle, TrackedTrial
from sawbench.bench.recording import Floats, Signal
from sawbench.bench.units import CHANNEL_BY_NAME, DISPLACEMENT, MOTOR_CURRENT
from sawbench.diagnosis.inference.asynchronous import is_mains
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.signal_health import coarse_step
from sawbench.modeling.parts.mechanism import Mechanism
from sawbench.modeling.state import START_UP_STEP_S, TWO_PI, State, TrialSetting, angle_derivative
from sawbench.processing.binning import AngleGrid, time_cell_means
from sawbench.processing.noise import white_noise_std
from sawbench.processing.settled import MOVING_RAD_S

N_POINTS = 128
N_HARMONICS = 40
MIN_SAMPLES_PER_BIN = 1.5
# So many units of whole turns, or up to twice as many, where the samples allow it.
_TARGET_UNITS = 16
_NUMBERS = SETTINGS.reading
# A spline takes 1.4 % off a wave of four samples, 0.06 % off one of eight; longer steps than this miss samples.
_SAMPLES_A_HARMONIC, _LONGEST_STEP = 4, 2.5
# Of the highest current of a start-up: that much shows that it flows.
_BEGUN = 0.05
# Of a cubic spline, and of a mean over a time of a start-up.
_LEAST_SAMPLES, _SAMPLES_A_MEAN = 4, 2
# So many points of a spline in a cell: their middle is that of the cell even where they lie alike in every stroke.
_SPLINE_POINTS_A_BIN = 6
START_UP_S = 0.4
# A start-up is compared in time bins that begin with this width.
_LONGEST_GAP_S = 3e-3
# Channels of a recording and where they stand in a state.
CHANNEL_OF_STATE: Final = MappingProxyType(
    {
        "motor_current_a": "current_a",
        "force_n": "force_n",
        "battery_voltage_v": "battery_voltage_v",
        "battery_current_a": "battery_current_a",
    }
)
_NONE: Final = np.zeros(1)


def lay_grid(angle: CrankAngle, start_s: float, end_s: float, slowest_rate_hz: float) -> AngleGrid | None:
    """Choose units of whole turns between two times, long enough to fill every bin.

    Returns
    -------
    AngleGrid or None
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
    per_unit = min(max(needed, n_turns // _TARGET_UNITS, 1), n_turns)
    return AngleGrid(first_turn=first, n_rows=n_turns // per_unit, n_bins=N_POINTS, turns_per_row=per_unit)


def fold(grid: AngleGrid, placed: NDArray[np.int64], values: Floats) -> Floats:
    """Mean of the samples in each cell, band-limited to `N_HARMONICS`, shape (n_units, n_points).

    The droop of the bin average is undone. Empty cells are interpolated over the turn.
    """
    mean, cells = grid.means(placed, values), np.arange(grid.n_bins)
    for unit in np.flatnonzero(np.isnan(mean).any(axis=1)):
        filled = np.flatnonzero(~np.isnan(mean[unit]))
        if len(filled) >= 2:
            mean[unit] = np.interp(cells, filled, mean[unit][filled], period=grid.n_bins)
    return band_limit(np.nan_to_num(mean))


def band_limit(waves: Floats, n_harmonics: int = N_HARMONICS) -> Floats:
    """Keep the first harmonics of periodic rows and undo the droop of the bin average."""
    n_points = waves.shape[-1]
    spectrum = np.fft.rfft(waves, axis=-1)
    order = np.arange(spectrum.shape[-1])
    spectrum = spectrum / np.sinc(order / n_points)
    spectrum[..., n_harmonics + 1 :] = 0.0
    return np.fft.irfft(spectrum, n_points, axis=-1)


def _gained_a_turn(waves: Floats, turns: Floats) -> Floats:
    """How far the mean of rows goes up from one turn to the next, shape (n_rows,); `turns` counts them."""
    n = len(waves)
    return _NONE if n < 2 else np.gradient(waves.mean(axis=1), turns, edge_order=1 if n == 2 else 2)


def derivative_over_turns(waves: Floats, gained: Floats, n_harmonics: int = N_HARMONICS) -> Floats:
    """Derivative with respect to the crank angle of rows that begin each turn where the one before has left off.

    A row that is taken for periodic falls back at its end by what a turn gains; that is no part of the derivative.

    Parameters
    ----------
    waves : ndarray, shape (n_rows, n_points)
        At the middles of equal parts of the turn, with `n_harmonics` harmonics.
    gained : ndarray, shape (n_rows,) or (1,)
        From one turn to the next.
    n_harmonics : int

    Examples
    --------
    >>> angle = (np.arange(64) + 0.5) / 64 * TWO_PI
    >>> ramp = 0.5 - sum(np.sin(k * angle) / (np.pi * k) for k in range(1, 9))  # 0 to 1 in a turn, of 8 harmonics
    >>> rate = derivative_over_turns((np.sin(angle) + 0.3 * ramp)[None], np.array([0.3]), 8)
    >>> bool(np.allclose(rate, np.cos(angle) + 0.3 / TWO_PI))
    True
    """
    n_points = waves.shape[-1]
    fall = np.zeros(n_points // 2 + 1, dtype=np.complex128)
    fall[: n_harmonics + 1] = n_points / TWO_PI * np.exp(1j * np.pi / n_points * np.arange(n_harmonics + 1))
    return angle_derivative(waves) + gained[:, None] * np.fft.irfft(fall, n_points)


def lock_to_angle(state: State) -> tuple[str, complex, float] | None:
    """How force (in wood) or current (in air) repeats with the crank angle from unit to unit.

    A displacement that belongs to another trial drifts against the other channels: the phases of their first or
    second harmonic then scatter over the turn.

    Returns
    -------
    (str, complex, float) or None
        Which wave was judged; its mean phase, and as modulus how well the units agree (1 perfectly); its angular
        frequency, rad/s. None where there is nothing to judge by: the harmonic is weak, or the mains may hum at its
        frequency.
    """
    # In air the force is noise, and the reciprocating mass gives the current its second harmonic.
    name, wave, order = "current in air", state.current_a, 2
    if not state.setting.is_idle:
        name, order = "current", 1
        if state.force_n is not None:
            name, wave = "force", state.force_n
            swing_n = 2.0 / N_POINTS * float(np.abs(np.fft.rfft(wave, axis=1)[:, 1]).mean())
            if swing_n < _NUMBERS.least_swing_n:
                return None
    if wave is None:
        return None
    harmonics = np.fft.rfft(wave, axis=1)
    rate_hz = float(state.speed_rad_s.mean()) / TWO_PI
    resolution_hz = rate_hz / float(state.n_strokes.mean())
    if is_mains(order * rate_hz, within_hz=2.0 * resolution_hz):
        return None
    # The first odd harmonics of the current in air are small: they hold noise, hum and drift.
    odd = np.abs(harmonics[:, 1:8:2]).mean(axis=0)
    if state.setting.is_idle and np.abs(harmonics[:, order]).mean() < _NUMBERS.clear_harmonic * np.median(odd):
        return None
    parts = harmonics[:, order]
    size = float(np.abs(parts).sum())
    return (name, complex(parts.sum() / size), TWO_PI * order * rate_hz) if size > 0 else None


def running_state(trial: TrackedTrial, setting: TrialSetting) -> State | None:
    """Average the settled strokes of a trial in units of a few turns.

    Parameters
    ----------
    trial : TrackedTrial
        With a crank angle.
    setting : TrialSetting

    Returns
    -------
    State or None
        None where fewer than two turns are complete. Slow states are still zero.
    """
    angle, steady = trial.angle, trial.steady
    assert angle is not None and steady is not None
    turns = float(np.diff(np.interp([steady.settled_s, steady.end_s], angle.time_s, angle.angle_rad))[0]) / TWO_PI
    period_s = (steady.end_s - steady.settled_s) / max(turns, 1.0)
    measured = _state_channels(trial)
    present = {name: between_samples(signal, period_s) for name, signal in measured.items()}
    slowest = min([s.rate_hz for s in present.values()], default=0.0)
    grid = lay_grid(angle, steady.settled_s, steady.end_s, slowest)
    if grid is None:
        return None
    # The speed too has samples in every cell: of a rate that strokes divide, the same cells would stay empty for ever.
    crank = between_samples(
        Signal(channel="crank_speed", unit="rad/s", time_s=angle.time_s, values=angle.speed_rad_s), period_s
    )
    tracked = grid.place_samples(angle.time_s, angle.angle_rad, crank.time_s)
    is_covered = grid.coverage(tracked) > _NUMBERS.least_coverage
    placed = {}
    for name, signal in present.items():
        at_samples = grid.place_samples(angle.time_s, angle.angle_rad, signal.time_s)
        at_samples[_in_gap(signal.time_s, angle.time_s, np.pi / (2.0 * np.median(angle.speed_rad_s)))] = -1
        has_samples = grid.coverage(at_samples) > _NUMBERS.least_coverage
        # A channel that is mostly away is missing; one that drops out now and then costs the strokes it misses.
        if 2 * (has_samples & is_covered).sum() > is_covered.sum():
            placed[name] = at_samples
            is_covered &= has_samples
    if is_covered.sum() < 2 <= grid.n_rows or not is_covered.any():
        return None
    # The mean over angle of 1/speed is the time a turn takes: fold the slowness, not the speed.
    speed = 1.0 / fold(grid, tracked, 1.0 / np.maximum(crank.values, 1e-3))[is_covered]
    waves = {
        name: fold(grid, at_samples, present[name].values * CHANNEL_BY_NAME[name].si_factor)[is_covered]
        for name, at_samples in placed.items()
    }
    turns = grid.first_turn + (np.flatnonzero(is_covered) + 0.5) * grid.turns_per_row
    middle_s = np.interp(turns * TWO_PI, angle.angle_rad, angle.time_s)[:, None]
    acceleration = speed * derivative_over_turns(speed, _gained_a_turn(speed, turns))
    # Speed and current settle; the force is the same at its dead centres, whatever the stroke.
    rates = {
        name: speed * derivative_over_turns(wave, _gained_a_turn(wave, turns) if name == MOTOR_CURRENT.name else _NONE)
        for name, wave in waves.items()
    }
    motion = (np.broadcast_to(grid.middles_rad, speed.shape), speed, acceleration)
    state = _assemble("running", setting, motion, waves, rates, middle_s)
    missed = _missed_stroke(trial, angle, grid)
    return replace(
        state,
        n_strokes=np.full(len(speed), float(grid.turns_per_row)),
        ripple_std_rad=angle.ripple_std_rad,
        resolved_orders={
            CHANNEL_OF_STATE[name]: signal.rate_hz * period_s / _SAMPLES_A_HARMONIC
            for name, signal in measured.items()
            if present[name] is not signal
        },
        blade_excess_m_s=None if missed is None else speed * angle_derivative(missed[is_covered]),
        stroke_std_m=np.zeros(0) if missed is None else _std_by_steps(trial, angle, grid),
    )


def between_samples(signal: Signal, period_s: float) -> Signal:
    """Fill every cell of every turn of a channel that is too slow for it, by a cubic spline through its samples.

    Means over the samples alone would mix strokes: each cell would hold other strokes than the next one, and a
    hardness that changes from stroke to stroke would look like harmonics of all of them.

    Parameters
    ----------
    signal : Signal
    period_s : float
        Of a turn, s.

    Returns
    -------
    Signal
        The same where a turn has samples enough; harmonics of four samples and more are right, of a channel with fewer
        a turn only the mean is. Nothing is put where samples are missing.

    Notes
    -----
    A mean stroke pieced together from many would show more harmonics, but nothing would say how far they are off.
    """
    per_turn = signal.rate_hz * period_s
    if per_turn >= MIN_SAMPLES_PER_BIN * N_POINTS or len(signal.time_s) < _LEAST_SAMPLES:
        return signal
    part = np.arange(n := int(np.ceil(_SPLINE_POINTS_A_BIN * N_POINTS / per_turn))) / n
    step_s = np.diff(signal.time_s)[:, None]
    at_s = (signal.time_s[:-1, None] + step_s * part)[(step_s < _LONGEST_STEP * np.median(step_s)) | (part == 0.0)]
    return replace(signal, time_s=at_s, values=_spline(signal, at_s), raw=None)


def _spline(signal: Signal, at_s: Floats) -> Floats:
    """Values between samples; before the first and after the last one, those."""
    from scipy.interpolate import CubicSpline

    return CubicSpline(signal.time_s, signal.values)(np.clip(at_s, signal.time_s[0], signal.time_s[-1]))


def _state_channels(trial: TrackedTrial) -> Mapping[str, Signal]:
    return {name: trial.channels[name] for name in CHANNEL_OF_STATE if name in trial.channels}


def _missed_stroke(trial: TrackedTrial, angle: CrankAngle, grid: AngleGrid) -> Floats | None:
    """What the displacement goes beyond that of the tracked angle, m, shape (n_units, n_points)."""
    signal = trial.channels.get(DISPLACEMENT.name)
    if signal is None:
        return None
    turned = np.interp(signal.time_s, angle.time_s, angle.angle_rad)
    crank = Mechanism(radius_m=angle.radius_m, rod_length_m=angle.rod_length_m)
    beyond = DISPLACEMENT.si_factor * signal.values - crank.displacement(turned)
    at_samples = grid.place(turned)
    at_samples[np.abs(beyond) > _NUMBERS.spike_share * angle.radius_m] = -1
    return fold(grid, at_samples, beyond)


def _std_by_steps(trial: TrackedTrial, angle: CrankAngle, grid: AngleGrid) -> Floats:
    """Standard uncertainty of the mean displacement in each cell by coarse steps, m, shape (n_points,); or (0,).

    A cell that holds a part of a step is as wrong as one value; one that passes m steps, by the mth part of that.
    """
    signal = trial.channels[DISPLACEMENT.name]
    noise = white_noise_std(signal.values, signal.time_s)
    step = coarse_step(signal, noise)
    if not step:
        return np.zeros(0)
    # The noise holds that of the steps.
    scatter = np.sqrt(max(noise**2 - step**2 / 12.0, 0.0))
    std_m = DISPLACEMENT.si_factor * np.sqrt(rounding_variance(step, scatter))
    crank = Mechanism(radius_m=angle.radius_m, rod_length_m=angle.rod_length_m)
    passed = np.abs(crank.lever(grid.middles_rad)) * (TWO_PI / N_POINTS) / (DISPLACEMENT.si_factor * step)
    return std_m / np.maximum(passed, 1.0)


def _in_gap(time_s: Floats, angle_time_s: Floats, longest_s: float) -> np.ndarray:
    """Whether a sample lies where the angle was not measured for longer than a quarter turn."""
    after = np.clip(np.searchsorted(angle_time_s, time_s), 1, len(angle_time_s) - 1)
    return angle_time_s[after] - angle_time_s[after - 1] > longest_s


def start_up_state(trial: TrackedTrial, setting: TrialSetting) -> State | None:
    """Signals of the spin-up on a 1 ms grid, shape (1, n_times), or None where it was not recorded.

    A channel that is slower than the grid is there by a spline; the state says how long the means are that it resolves.
    """
    angle, steady = trial.angle, trial.steady
    assert angle is not None and steady is not None
    start_s = steady.first_motion_s
    present = _state_channels(trial)
    starts_at_rest = start_s > angle.time_s[0] or angle.speed_rad_s[0] < MOVING_RAD_S
    if not starts_at_rest or "motor_current_a" not in present or start_s + START_UP_S > angle.time_s[-1]:
        return None
    edges = start_s + np.arange(0.0, START_UP_S + START_UP_STEP_S / 2, START_UP_STEP_S)
    middle = 0.5 * (edges[1:] + edges[:-1])
    # A channel that drops out during the spin-up counts as missing there.
    present = {n: s for n, s in present.items() if not _drops_out(s.time_s, edges[0], edges[-1])}
    if "motor_current_a" not in present or _drops_out(angle.time_s, edges[0], edges[-1]):
        return None
    slow = {n: s for n, s in present.items() if s.rate_hz < 0.9 / START_UP_STEP_S}
    means = {n: time_cell_means(s.time_s, s.values, edges) for n, s in present.items() if n not in slow}
    means |= {n: _spline(s, middle) for n, s in slow.items()}
    waves = {n: wave[None, :] for n, wave in means.items()}
    crank = np.interp(middle, angle.time_s, angle.angle_rad)[None, :]
    speed = time_cell_means(angle.time_s, angle.speed_rad_s, edges)[None, :]
    rates = {n: np.gradient(w, START_UP_STEP_S, axis=1) for n, w in waves.items()}
    motion = (crank, speed, np.gradient(speed, START_UP_STEP_S, axis=1))
    state = _assemble("start_up", setting, motion, waves, rates, np.array([[start_s]]))
    resolved_s = {CHANNEL_OF_STATE[n]: _SAMPLES_A_MEAN / s.rate_hz for n, s in slow.items()}
    voltage = state.motor_voltage_v * share_switched_on(means["motor_current_a"])
    return replace(state, motor_voltage_v=voltage, ripple_std_rad=angle.ripple_std_rad, resolved_s=resolved_s)


def share_switched_on(current_a: Floats) -> Floats:
    """Share of each cell of a start-up, shape (n,), in which the motor is switched on: current flows from then on.

    Readings that come late are those of a motor without voltage at first, although the crank is in motion.

    Parameters
    ----------
    current_a : ndarray, shape (n,)
        Means of the cells.
    """
    rises = np.diff(current_a)
    # Of a cell in which the current begins the mean is less than half of the rise to the next one.
    flows = (current_a[:-1] >= _BEGUN * current_a.max()) & (current_a[:-1] >= 0.5 * rises)
    first = int(np.argmax(flows))
    onset = first + 0.5 - current_a[first] / rises[first] if flows[first] and rises[first] > 0.0 else 0.0
    return np.clip(np.arange(1, len(current_a) + 1) - onset, 0.0, 1.0)


def _drops_out(time_s: Floats, start_s: float, end_s: float) -> bool:
    """Whether samples are missing between two times for longer than the spin-up can be interpolated."""
    inside = time_s[max(np.searchsorted(time_s, start_s) - 1, 0) : np.searchsorted(time_s, end_s) + 1]
    longest_s = max(_LONGEST_GAP_S, _LONGEST_STEP * float(np.median(np.diff(time_s))))
    return len(inside) < 2 or float(np.diff(inside).max()) > longest_s


def _assemble(
    kind: Literal["running", "start_up"],
    setting: TrialSetting,
    motion: tuple[Floats, Floats, Floats],
    waves: Mapping[str, Floats],
    rates: Mapping[str, Floats],
    time_s: Floats,
) -> State:
    """State of one stroke a row; `motion` is angle, speed and acceleration, `waves` and `rates` are by channel."""
    voltage = waves.get("battery_voltage_v")
    angle_rad, speed_rad_s, acceleration_rad_s2 = motion
    nothing = np.zeros_like(time_s)
    return State(
        kind=kind,
        setting=setting,
        angle_rad=np.asarray(angle_rad),
        speed_rad_s=speed_rad_s,
        acceleration_rad_s2=acceleration_rad_s2,
        current_a=waves.get("motor_current_a"),
        current_rate_a_s=rates.get("motor_current_a"),
        force_n=waves.get("force_n"),
        force_rate_n_s=rates.get("force_n"),
        battery_voltage_v=voltage,
        battery_current_a=waves.get("battery_current_a"),
        motor_voltage_v=np.full(speed_rad_s.shape, np.nan) if voltage is None else setting.duty * voltage,
        time_s=time_s,
        cut_distance_m=nothing,
        charge_used_as=nothing,
        n_strokes=np.ones(len(time_s)),
    )
