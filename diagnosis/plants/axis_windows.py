"""Recordings of an axis whose motion is not periodic (one move, a chirp, random set points), as states over time.

The balance of forces holds at every instant and needs no period. Displacement, drive and load pass the same filter
without phase (a Butterworth run back and forth), so that the balance stays true for what is left of them, and speed and
acceleration are differences of the filtered displacement: the usual way to identify the inverse model of robot axes
(Gautier 1997). The record is cut into windows that are compared by their Fourier coefficients, as a cycle is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from sawbench.bench.recording import Floats, Signal
from sawbench.diagnosis.inference.settings import SETTINGS
from sawbench.diagnosis.plants.axis_motion import n_points
from sawbench.modeling.machines.linear_axis import AxisState
from sawbench.modeling.state import TWO_PI, TrialSetting

_LEAST_SAMPLES: Final = 64
_MOST_WINDOWS: Final = 16
_N_POINTS: Final = n_points(128)
# Power over the floor from which on a frequency belongs to the motion, the share of all power that such have at least,
# and the largest share of the Nyquist frequency.
_OVER_FLOOR: Final = 10.0
_MOTION_SHARE: Final = 0.5
_MOST_OF_NYQUIST: Final = 0.5
_FILTER_ORDER: Final = 4
# Share of the drive's variance that the compared harmonics of a window are to hold.
_HELD_SHARE: Final = 0.95


@dataclass(frozen=True, kw_only=True, slots=True)
class Windows:
    """Where the windows of a trial lie.

    Attributes
    ----------
    edges_s : ndarray, shape (n_windows + 1,)
    cutoff_hz : float
        Up to there the displacement is motion, above it noise.
    """

    edges_s: Floats
    cutoff_hz: float


def find_windows(displacement: Signal, drive: Signal, n_harmonics: int) -> tuple[Windows | None, str]:
    """Cut a trial into windows.

    Parameters
    ----------
    displacement, drive : Signal
    n_harmonics : int
        That are compared of each window: windows are short enough for these to hold most of the drive's force.

    Returns
    -------
    windows : Windows or None
    reason : str
        Why there are none ("" otherwise).
    """
    if len(displacement.time_s) < _LEAST_SAMPLES or float(np.ptp(displacement.values)) == 0.0:
        return None, "its displacement does not move"
    frequency_hz, power = _spectrum(displacement)
    floor = float(np.median(power[len(power) // 2 :]))
    above = np.flatnonzero(power > _OVER_FLOOR * floor)
    if not len(above) or power[: above[-1] + 1].sum() < _MOTION_SHARE * power.sum():
        return None, "its displacement is noise without motion"
    nyquist_hz = 0.5 * displacement.rate_hz
    cutoff_hz = float(np.clip(frequency_hz[above[-1]], frequency_hz[1], _MOST_OF_NYQUIST * nyquist_hz))
    drive_hz, drive_power = _spectrum(drive)
    held = np.cumsum(drive_power) / drive_power.sum()
    needed_hz = float(drive_hz[int(np.searchsorted(held, _HELD_SHARE))])
    start_s, end_s = max(displacement.time_s[0], drive.time_s[0]), min(displacement.time_s[-1], drive.time_s[-1])
    # The filter knows nothing of what comes before the first sample and after the last.
    margin_s = min(1.0 / cutoff_hz, 0.1 * (end_s - start_s))
    start_s, end_s = start_s + margin_s, end_s - margin_s
    count = int(np.clip(np.ceil((end_s - start_s) * needed_hz / n_harmonics), 1, _MOST_WINDOWS))
    return Windows(edges_s=np.linspace(start_s, end_s, count + 1), cutoff_hz=cutoff_hz), ""


def _spectrum(signal: Signal) -> tuple[Floats, Floats]:
    """Power over frequency of the samples put on an even grid, less a straight line, averaged over neighbours."""
    n = len(signal.time_s)
    even = np.interp(np.linspace(signal.time_s[0], signal.time_s[-1], n), signal.time_s, signal.values)
    line = np.linspace(even[0], even[-1], n)
    power = np.abs(np.fft.rfft((even - line) * np.hanning(n))) ** 2
    width = max(1, len(power) // 200)
    averaged = np.convolve(power, np.ones(width) / width, "same")
    frequency_hz: Floats = np.fft.rfftfreq(n, signal.duration_s / (n - 1)).astype(np.float64)
    return frequency_hz, averaged


def window_states(
    windows: Windows, setting: TrialSetting, signals: Mapping[str, Signal | None], newton: float
) -> list[AxisState]:
    """Put the windows of a trial on a grid, one state each.

    Parameters
    ----------
    windows : Windows
    setting : TrialSetting
    signals : mapping of str to Signal or None
        "displacement" in mm, "drive" in A or N, "load" in N or None.
    newton : float
        Force for one unit of the drive, N.

    Returns
    -------
    list of AxisState
        Arrays of shape (1, n_points).
    """
    displacement, load = signals["displacement"], signals["load"]
    drive = signals["drive"]
    assert displacement is not None
    assert drive is not None
    step_s = 1.0 / displacement.rate_hz
    time_s = np.arange(displacement.time_s[0], displacement.time_s[-1] + 0.5 * step_s, step_s)
    position_m = 1e-3 * _filtered(displacement, time_s, windows.cutoff_hz)
    velocity = np.gradient(position_m, time_s)
    tracks = {
        "position_m": position_m,
        "velocity_m_s": velocity,
        "acceleration_m_s2": np.gradient(velocity, time_s),
        "drive_n": newton * _filtered(drive, time_s, windows.cutoff_hz),
    }
    if load is not None:
        tracks["force_n"] = _filtered(load, time_s, windows.cutoff_hz)
        tracks["force_rate_n_s"] = np.gradient(tracks["force_n"], time_s)
    found = [
        _window(setting, time_s, tracks, start_s, end_s)
        for start_s, end_s in zip(windows.edges_s[:-1], windows.edges_s[1:], strict=True)
    ]
    tops = [float(np.abs(state.velocity_m_s).max()) for state in found]
    least = SETTINGS.axis.standstill_share * max(tops)
    return [state for state, top in zip(found, tops, strict=True) if top >= least]


def _filtered(signal: Signal, time_s: Floats, cutoff_hz: float) -> Floats:
    from scipy.signal import butter, sosfiltfilt

    rate_hz = 1.0 / (time_s[1] - time_s[0])
    sections = butter(_FILTER_ORDER, cutoff_hz, fs=rate_hz, output="sos")
    return sosfiltfilt(sections, np.interp(time_s, signal.time_s, signal.values))


def _window(
    setting: TrialSetting, time_s: Floats, tracks: Mapping[str, Floats], start_s: float, end_s: float
) -> AxisState:
    """One window: means over its cells, so that nothing above the grid is taken for something below it."""
    edges_s = np.linspace(start_s, end_s, _N_POINTS + 1)
    middle_s = 0.5 * (edges_s[1:] + edges_s[:-1])
    step_s = time_s[1] - time_s[0]

    def cells(track: Floats) -> Floats:
        if edges_s[1] - edges_s[0] < 2.0 * step_s:
            return np.interp(middle_s, time_s, track)[None]
        total = np.concatenate([[0.0], np.cumsum(0.5 * (track[1:] + track[:-1]))]) * step_s
        return (np.diff(np.interp(edges_s, time_s, total)) / (edges_s[1] - edges_s[0]))[None]

    found = {name: cells(track) for name, track in tracks.items()}
    shape, at_s = (1, _N_POINTS), np.array([[0.5 * (start_s + end_s)]])
    return AxisState(
        kind="running",
        setting=setting,
        angle_rad=((np.arange(_N_POINTS) + 0.5) * TWO_PI / _N_POINTS)[None],
        speed_rad_s=np.full(shape, TWO_PI / (end_s - start_s)),
        acceleration_rad_s2=np.zeros(shape),
        current_a=None,
        current_rate_a_s=None,
        force_n=found.get("force_n"),
        force_rate_n_s=found.get("force_rate_n_s"),
        battery_voltage_v=None,
        battery_current_a=None,
        motor_voltage_v=np.full(shape, np.nan),
        time_s=at_s,
        cut_distance_m=np.zeros_like(at_s),
        charge_used_as=np.zeros_like(at_s),
        n_strokes=np.ones(1),
        position_m=found["position_m"],
        velocity_m_s=found["velocity_m_s"],
        acceleration_m_s2=found["acceleration_m_s2"],
        drive_n=found["drive_n"],
        is_cyclic=False,
    )
